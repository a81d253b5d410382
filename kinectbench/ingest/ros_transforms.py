"""tf: the tree of frames of a ROS bag, and where a camera is in it."""

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.ingest.images import DamagedImageError
from kinectbench.ingest.ros_messages import BagMessages, BagTopic
from kinectbench.ingest.ros_topics import TF

SHORTEST_QUATERNION = 1e-6


@dataclass
class _Edge:
    """A frame's place in its parent, at one or many times."""

    parent: str
    at: dict[int, NDArray[np.float64]] = field(default_factory=dict)


@dataclass(frozen=True)
class TransformTree:
    """The frames of a bag, each with its parent.

    Attributes:
        edges: of each frame that has a parent: the parent, the stamps (ns, increasing) and the (n, 4, 4)
            transforms from the frame to the parent; one of them is meant for all times.
    """

    edges: dict[str, tuple[str, NDArray[np.int64], NDArray[np.float64]]]

    def path(self, frame: str) -> list[str]:
        """The frame, its parent, and so on up to a frame without a parent."""
        found = [frame]
        while found[-1] in self.edges and self.edges[found[-1]][0] not in found:
            found.append(self.edges[found[-1]][0])
        return found

    def fixed(self, to_frame: str, from_frame: str) -> NDArray[np.float64] | None:
        """`T_to_from` between frames that do not move against each other; None if it is not known."""
        up, down = self.path(from_frame), self.path(to_frame)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        T_common_from = self._fixed_up(up[: up.index(common)])
        T_common_to = self._fixed_up(down[: down.index(common)])
        if T_common_from is None or T_common_to is None:
            return None
        return np.asarray(np.linalg.inv(T_common_to) @ T_common_from)

    def moving(self, frame: str) -> tuple[str, NDArray[np.int64], NDArray[np.float64]] | None:
        """Where a frame is over time in the root above it: its name, stamps (m,) and T_root_frame (m, 4, 4).

        It is given at the stamps of the transform that is recorded most often, the others interpolated; None
        if nothing above the frame moves.
        """
        links = [self.edges[name] for name in self.path(frame)[:-1]]
        busiest = max(links, key=lambda link: len(link[1]), default=None)
        if busiest is None or not _moves(busiest[2]):
            return None
        several = [link[1] for link in links if len(link[1]) > 1]
        first, last = max(s[0] for s in several), min(s[-1] for s in several)
        stamps = busiest[1][(busiest[1] >= first) & (busiest[1] <= last)]
        if len(stamps) == 0:
            return None
        T = np.broadcast_to(np.eye(4), (len(stamps), 4, 4))
        for _, own, transforms in links:
            T = np.stack([_at(own, transforms, stamp) for stamp in stamps.tolist()]) @ T
        return links[-1][0], stamps, T

    def _fixed_up(self, frames: list[str]) -> NDArray[np.float64] | None:
        T: NDArray[np.float64] = np.eye(4)
        for name in frames:
            transforms = self.edges[name][2]
            if _moves(transforms):
                return None
            T = transforms[0] @ T
        return T


def read_transforms(topics: tuple[BagTopic, ...], messages: BagMessages) -> TransformTree:
    """Read every tf and tf_static message; what is not finite, or has no rotation, is left out."""
    edges: dict[str, _Edge] = {}
    for topic in topics:
        if topic.type not in TF:
            continue
        for index in range(len(topic.messages)):
            try:
                message = messages.decode(topic, index)
            except DamagedImageError:
                continue
            for stamped in message.transforms:
                _take(edges, stamped)
    return TransformTree({name: _sorted(edge) for name, edge in edges.items()})


def _take(edges: dict[str, _Edge], stamped: Any) -> None:
    # tf 1 wrote names with a leading slash.
    child, parent = stamped.child_frame_id.lstrip("/"), stamped.header.frame_id.lstrip("/")
    matrix = matrix_of(stamped.transform)
    if matrix is None or child == parent:
        return
    edge = edges.setdefault(child, _Edge(parent))
    if edge.parent == parent:
        edge.at[stamped.header.stamp.sec * 10**9 + stamped.header.stamp.nanosec] = matrix


def matrix_of(transform: Any) -> NDArray[np.float64] | None:
    """The (4, 4) matrix of a geometry_msgs/Transform; None if it is not finite or has no rotation."""
    t, q = transform.translation, transform.rotation
    quaternion_xyzw, translation_m = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
    if not np.isfinite([*quaternion_xyzw, *translation_m]).all():
        return None
    if np.linalg.norm(quaternion_xyzw) < SHORTEST_QUATERNION:
        return None
    return rigid(rotation_from_quaternion_xyzw(quaternion_xyzw), translation_m)


def _sorted(edge: _Edge) -> tuple[str, NDArray[np.int64], NDArray[np.float64]]:
    stamps = sorted(edge.at)
    return edge.parent, np.array(stamps, np.int64), np.stack([edge.at[stamp] for stamp in stamps])


def _moves(transforms: NDArray[np.float64]) -> bool:
    return len(transforms) > 1 and bool(np.abs(transforms - transforms[0]).max() > 1e-6)


def _at(stamps: NDArray[np.int64], transforms: NDArray[np.float64], stamp_ns: int) -> NDArray[np.float64]:
    """A transform at a time: linear in position, along the shortest turn in rotation."""
    from scipy.spatial.transform import Rotation, Slerp

    after = min(max(bisect_left(stamps, stamp_ns), 0), len(stamps) - 1)
    if stamps[after] == stamp_ns or after == 0 or len(stamps) == 1:
        return np.asarray(transforms[after])
    share = (stamp_ns - int(stamps[after - 1])) / int(stamps[after] - stamps[after - 1])
    before_after = transforms[after - 1 : after + 1]
    rotation = Slerp([0.0, 1.0], Rotation.from_matrix(before_after[:, :3, :3]))(min(share, 1.0))
    translation_m = (1 - share) * before_after[0, :3, 3] + share * before_after[1, :3, 3]
    return rigid(rotation.as_matrix(), translation_m)
