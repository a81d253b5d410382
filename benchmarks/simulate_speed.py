"""CPU time of one simulated 640x480 frame with all effects, stage by stage.

A chair-sized scene of boxes with a ball of 80k triangles on it; depth distortion, projector shadow and all
noise, motion blur of several pixels, changing exposure, and the images encoded as a recording and its truth
keep them. Unregistered colour is a second ray cast from a camera of its own.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from figures import Figure, arguments, at_most, run, told
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, OrientedBox, TriangleMesh, rigid
from kinectbench.core.geometry.mesh import box_mesh, join
from kinectbench.lab.simulate.color import expose
from kinectbench.lab.simulate.kinect import draw_device, measure
from kinectbench.lab.simulate.objects.shapes import Piece, Subject
from kinectbench.lab.simulate.path import look_at
from kinectbench.lab.simulate.render import Renderer, Rendering, make_texture, sample_surface
from kinectbench.lab.simulate.scene import make_scene
from kinectbench.lab.simulate.simulate import SURFACE_SAMPLES
from kinectbench.lab.simulate.spec import SceneSettings, SimulationSpec
from kinectbench.lab.simulate.time_of_flight import (
    SENSORS,
    TimeOfFlightDevice,
    draw_time_of_flight,
    measure_time_of_flight,
)
from kinectbench.lab.simulate.writers.frame import RecordedFrame, png_bytes

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
REPEATS = 25
BAR_S = 0.25
TURN_RAD = 0.01


def make_rendered() -> tuple[Renderer, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """A seat on four legs with a back, and a finely meshed ball on the seat, in a room; and its samples."""
    import trimesh

    boxes = [((0, 0, 0.45), (0.45, 0.45, 0.04)), ((0, 0.2, 0.7), (0.4, 0.03, 0.45))]
    boxes += [((x, y, 0.215), (0.04, 0.04, 0.43)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    pieces = [Piece("box", box_mesh(OrientedBox(at, size)), (0.6, 0.4, 0.2)) for at, size in boxes]
    ball = trimesh.creation.icosphere(6, 0.1)
    vertices = np.asarray(ball.vertices, np.float64) + np.array([0.0, 0.0, 0.57])
    mesh = TriangleMesh(vertices, np.asarray(ball.faces, np.int32))
    pieces.append(Piece("ball", mesh, (0.1, 0.1, 0.1), 0.05))
    subject = Subject("scene", tuple(pieces), join([piece.mesh for piece in pieces]), "made here")
    rng = np.random.default_rng(0)
    scene = make_scene(subject, 0.4, 1.8, SceneSettings(), rng)
    samples = sample_surface(subject.mesh.vertices, subject.mesh.faces, SURFACE_SAMPLES, rng)
    return Renderer(scene, make_texture(rng)), samples


def cpu_s(stage: Callable[[int], object]) -> float:
    """Least CPU time of a stage over its repeats, after one to warm up: other programs only add to it."""
    stage(0)
    found = []
    for index in range(REPEATS):
        started = time.process_time()
        stage(index)
        found.append(time.process_time() - started)
    return min(found)


def time_of_flight_s(renderer: Renderer, T_room_camera: NDArray[np.float64]) -> list[Figure]:
    """What each time-of-flight sensor takes for one frame of its own size."""
    found = []
    for model in SENSORS:
        camera = SimulationSpec.model_validate({"sensor": {"model": model}}).camera
        device = draw_time_of_flight(model, camera, 1.0, 0.0, np.random.default_rng(1))
        exact = renderer.render(camera, T_room_camera)
        name = f"the errors of {model}, {camera.width}x{camera.height}, instead of the Kinect's, s"
        found.append(told(name, cpu_s(partial(_measured, exact, camera, device))))
    return found


def _measured(exact: Rendering, camera: Camera, device: TimeOfFlightDevice, index: int) -> object:
    return measure_time_of_flight(exact, camera, device, np.random.default_rng(index))


def measure_all(options: argparse.Namespace) -> Sequence[Figure]:
    """Time the stages of a frame, then add them up."""
    del options
    renderer, samples = make_rendered()
    T_room_camera = look_at(np.array([1.2, -1.0, 1.2]), np.array([0, 0, 0.45]))
    T_room_color = T_room_camera @ rigid(np.eye(3), np.array([0.025, 0, 0]))
    exact = renderer.render(CAMERA, T_room_camera)
    device = draw_device(CAMERA, 1.0, 0.0, np.random.default_rng(1))
    cosine, sine = np.cos(TURN_RAD / 2), np.sin(TURN_RAD / 2)
    half_turn = rigid(np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]), np.zeros(3))
    poses = (T_room_camera @ half_turn, T_room_camera, T_room_camera @ half_turn.T)
    depth_m = measure(exact, CAMERA, device, np.random.default_rng(2))
    color_rgb = expose(exact, CAMERA, poses, 1.1, np.random.default_rng(3))
    frame = RecordedFrame(0, depth_m, 0, color_rgb, None)
    true_mm = np.round(exact.depth_m * 1000).astype(np.uint16)
    render_s = cpu_s(lambda i: renderer.render(CAMERA, T_room_camera))
    second_s = cpu_s(lambda i: renderer.render(CAMERA, T_room_color))
    noise_s = cpu_s(lambda i: measure(exact, CAMERA, device, np.random.default_rng(i)))
    color_s = cpu_s(lambda i: expose(exact, CAMERA, poses, 1.1, np.random.default_rng(i)))
    record_s = cpu_s(lambda i: (png_bytes(frame.depth_native(5000)), frame.color_jpeg()))
    truth_s = cpu_s(lambda i: (png_bytes(true_mm), png_bytes(exact.mask.astype(np.uint8) * np.uint8(255))))
    seen_s = cpu_s(lambda i: renderer.visible(*samples, CAMERA, T_room_camera))
    registered_s = render_s + noise_s + color_s + record_s + truth_s + seen_s
    return [
        told("ray casting and shading, s", render_s),
        told("the same for unregistered colour, s", second_s),
        told("the Kinect's noise, s", noise_s),
        *time_of_flight_s(renderer, T_room_camera),
        told("blur, exposure and grain of colour, s", color_s),
        told("encoding the recording's images, s", record_s),
        told("encoding the truth's images, s", truth_s),
        told("which surface is in view, s", seen_s),
        at_most("a frame, colour registered, s", registered_s, BAR_S),
        at_most("a frame, colour unregistered, s", registered_s + second_s, BAR_S),
    ]


if __name__ == "__main__":
    chosen = arguments(__doc__).parse_args()
    run(chosen, lambda: measure_all(chosen))
