"""Render what a static camera sees of an object that turns on a turntable or is moved by a hand.

A camera path gives the camera's pose relative to the object, in frame `room`, which here moves with the
object. From this pose the object is rendered; everything else is rendered from the static camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinectbench.core.geometry import Camera, OrientedBox, box_mesh
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.lab.simulate.objects.shapes import surface, turned
from kinectbench.lab.simulate.render import Renderer, Rendering
from kinectbench.lab.simulate.scene import Item
from kinectbench.lab.simulate.spec import PathSettings

# Size of a fist and forearm below the object, and its height above a table.
ARM_M = (0.07, 0.06, 0.35)
ARM_RGB = (0.75, 0.56, 0.45)
# A turntable's plate is wider than the object by this much.
PLATE_RGB = (0.85, 0.85, 0.82)
PLATE_RATIO = 1.25
GRIP_M = 0.015
HELD_M = 0.8


@dataclass(frozen=True)
class StillRenderer:
    """Renders moving items and static surroundings, each from its own pose, into one image.

    It has the methods of `Renderer`. The object is lit as if the light moved with it.

    Attributes:
        own: renderer of the object, and of the arm or the plate that moves with it.
        around: renderer of everything else.
        T_room_still: (4, 4), the static pose of the camera rig, from which `around` is rendered.
    """

    own: Renderer
    around: Renderer
    T_room_still: Float64

    def render(self, camera: Camera, T_room_rig: Float64, T_rig_camera: Float64 | None = None) -> Rendering:
        """Render one frame like `Renderer.render`; `T_room_rig` is the rig's pose relative to the object."""
        own = self.own.render(camera, T_room_rig, T_rig_camera)
        around = self.around.render(camera, self.T_room_still, T_rig_camera)
        nearer = (own.depth_m > 0) & ((around.depth_m == 0) | (own.depth_m < around.depth_m))
        return Rendering(
            np.where(nearer, own.depth_m, around.depth_m),
            np.where(nearer[..., None], own.color_rgb, around.color_rgb),
            nearer & own.mask,
            np.where(nearer, own.cos_incidence, around.cos_incidence),
            np.where(nearer, own.albedo, around.albedo),
        )

    def visible(
        self, points_room: Float64, normals_room: Float64, camera: Camera, T_room_camera: Float64
    ) -> Bools:
        """Return whether a camera sees each point, like `Renderer.visible`; only moving items occlude."""
        return self.own.visible(points_room, normals_room, camera, T_room_camera)


def still_renderer(
    items: Sequence[Item], texture: Float32, T_room_first: Float64, settings: PathSettings
) -> StillRenderer:
    """Make a renderer whose camera stays where the path starts, while the object moves.

    Args:
        items: items of the scene, with the object at the origin.
        texture: texture of all surfaces.
        T_room_first: (4, 4), the path's first pose.
        settings: settings of the path, with `moves` set to "turntable" or "hand".
    """
    own = [item for item in items if item.role == "subject"]
    T_room_still = T_room_first.copy()
    if settings.moves == "hand":
        arm = OrientedBox((0.0, 0.0, GRIP_M - ARM_M[2] / 2), ARM_M)
        own.append(Item("clutter", box_mesh(arm), ARM_RGB, 0.2))
        T_room_still[2, 3] += HELD_M
    elif settings.plate_m > 0:
        vertices = np.concatenate([item.mesh.vertices for item in own])
        wide_m = PLATE_RATIO * float(np.linalg.norm(vertices[:, :2], axis=1).max())
        low_m = -settings.plate_m
        plate = surface(turned([(0.0, low_m), (wide_m, low_m), (wide_m, 0.0), (0.0, 0.0)]))
        own.append(Item("clutter", plate, PLATE_RGB, 0.3))
        T_room_still[2, 3] += settings.plate_m
    around = [item for item in items if item.role != "subject"]
    return StillRenderer(Renderer(own, texture), Renderer(around, texture), T_room_still)


def turning_only(settings: PathSettings) -> PathSettings:
    """Return path settings in which only the turntable moves; settings without turntable stay unchanged."""
    if settings.moves != "turntable":
        return settings
    still = {
        "swing_rad": 0.0,
        "low_pass_share": 0.0,
        "turn_rad": 0.0,
        "shake_m": 0.0,
        "shake_rad": 0.0,
        "reach_share": 0.0,
        "jolt_m": 0.0,
    }
    return settings.model_copy(update={**still, "jolt_rad": 0.0})
