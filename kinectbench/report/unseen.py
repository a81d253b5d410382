"""Draw the object with unseen parts in colour, and arrows from viewpoints that would see them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinectbench.core import images, pictures
from kinectbench.core.artefacts.object import FrontierPart
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Bools, Float64, Rgb

OBJECT_PX = 320
# Orange and blue are safe for colour-blind readers; seen parts are grey, so only unseen parts have colour.
SEEN_RGB, UNSEEN_RGB, ARROW_RGB = (184, 184, 180), (240, 150, 20), (0, 92, 160)
# Contrast of shading: openings are in the shade, where orange looks brown (chosen from pictures).
CONTRAST = 0.45
# Three viewpoints around the object, from a person's height: azimuth and elevation, degrees.
LOOKS_DEG = ((-50.0, 24.0), (70.0, 24.0), (190.0, 24.0))
# Limits of a viewpoint's elevation: from straight above or below the object is hard to recognise (chosen from
# pictures).
ELEVATIONS_DEG = (-40.0, 62.0)
LEVEL_COSINE = 0.2
# Largest number of arrows: more would hide the object.
MARKED = 4
# Length of an arrow as a share of the object's longest edge; an arrow that appears shorter than the second
# share of its length is drawn as a ring.
ARROW_SHARE, RING_SHARE = 0.4, 0.3
# An arrow beyond this cosine points to the far side, but would seem to point to the near side.
BEHIND_COSINE = -0.3


@dataclass(frozen=True)
class ObjectPicture:
    """A picture of the object from one side as a `data:` URL, and its caption, which may be ""."""

    picture: str
    caption: str


def object_pictures(
    mesh_floor: TriangleMesh, unseen: Bools, frontiers: Sequence[FrontierPart]
) -> tuple[ObjectPicture, ...]:
    """Draw the object from three sides, and from a viewpoint that looks into its first unobserved opening.

    Args:
        mesh_floor: the object's closed surface, floor frame, metres.
        unseen: mask (m,) of unmeasured faces, drawn in orange; measured faces are grey.
        frontiers: unobserved openings; the first four get a numbered arrow.
    """
    pieces = [
        (mesh_floor.keep_faces(~unseen), SEEN_RGB),
        (mesh_floor.keep_faces(unseen), UNSEEN_RGB),
    ]
    length_m = ARROW_SHARE * float(np.ptp(mesh_floor.vertices, axis=0).max())
    arrows = arrows_to(frontiers[:MARKED], length_m)
    points = np.concatenate([mesh_floor.vertices, *arrows])
    looks_deg = [*LOOKS_DEG, *(_look_deg(frontier) for frontier in frontiers[:1])]
    shown: list[ObjectPicture] = []
    for viewpoint in pictures.viewpoints_around(points, looks_deg):
        picture = pictures.render_pieces(pieces, viewpoint, OBJECT_PX, CONTRAST)
        for number, arrow in enumerate(arrows, start=1):
            draw_arrow(picture, viewpoint, arrow, str(number))
        caption = "from where 1 would be seen" if len(shown) == len(LOOKS_DEG) else ""
        shown.append(ObjectPicture(images.data_uri(picture), caption))
    return tuple(shown)


def arrows_to(frontiers: Sequence[FrontierPart], length_m: float) -> list[Float64]:
    """Return an arrow into each frontier (unobserved opening): (2, 3), tail and tip, floor frame, metres."""
    centers = [np.array(frontier.center_m) for frontier in frontiers]
    return [
        np.stack([center + length_m * np.array(frontier.look_from), center])
        for center, frontier in zip(centers, frontiers, strict=True)
    ]


def _look_deg(frontier: FrontierPart) -> tuple[float, float]:
    """Return azimuth and elevation, degrees, of a viewpoint that looks into a frontier."""
    x, y, z = frontier.look_from
    azimuth = LOOKS_DEG[0][0] if np.hypot(x, y) < LEVEL_COSINE else float(np.rad2deg(np.arctan2(y, x)))
    elevation = np.clip(np.rad2deg(np.arctan2(z, np.hypot(x, y))), *ELEVATIONS_DEG)
    return azimuth, float(elevation)


def draw_arrow(picture: Rgb, viewpoint: pictures.Viewpoint, arrow: Float64, number: str) -> None:
    """Draw into `picture` an arrow (2, 3), tail and tip, with its number at the tail.

    An arrow nearly along the line of sight is drawn as a ring; one that points to the viewer is not drawn.
    """
    import cv2

    along = arrow[1] - arrow[0]
    length_m = float(np.linalg.norm(along))
    if viewpoint.R_frame_view[:, 2] @ along < BEHIND_COSINE * length_m:
        return
    offsets = (arrow - viewpoint.center_m) @ viewpoint.R_frame_view[:, :2]
    (u0, v0), (u1, v1) = np.rint((offsets / viewpoint.half_m + 1) / 2 * len(picture)).astype(int).tolist()
    far_px = float(np.hypot(u1 - u0, v1 - v0))
    if far_px < RING_SHARE * length_m / (2 * viewpoint.half_m) * len(picture):
        for color, width in (((255, 255, 255), 5), (ARROW_RGB, 2)):
            cv2.circle(picture, (u1, v1), 17, color, width, cv2.LINE_AA)
        u0, v0 = u1, v1
    else:
        for color, width in (((255, 255, 255), 6), (ARROW_RGB, 3)):
            cv2.arrowedLine(picture, (u0, v0), (u1, v1), color, width, cv2.LINE_AA, tipLength=14 / far_px)
    cv2.circle(picture, (u0, v0), 11, ARROW_RGB, -1, cv2.LINE_AA)
    at = (u0 - 5, v0 + 6)
    cv2.putText(picture, number, at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 2, cv2.LINE_AA)
