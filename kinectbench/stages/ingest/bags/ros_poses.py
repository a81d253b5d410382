"""The trajectory of a ROS bag: from a topic of poses, or from tf, the tree of coordinate frames."""

import math
from array import array
from dataclasses import dataclass

import numpy as np

from kinectbench.core import RecordingError
from kinectbench.core.geometry import interpolate_rigid, rotation_from_quaternion_xyzw
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.trajectory_file import (
    FARTHEST_M,
    TimedPose,
    read_given,
    trajectory_from_poses,
)
from kinectbench.core.types import Float64, Int64
from kinectbench.stages.ingest.bags.message_decoding import BagTopic, Message, RosBag
from kinectbench.stages.ingest.bags.ros_topics import ODOMETRY, POSE, TF, ImageTopic
from kinectbench.stages.ingest.images import DamagedImageError

Given = tuple[GivenTrajectory | None, list[str]]
MaybeGiven = tuple[GivenTrajectory | None, list[str], str]
# The quaternion of a pose has length 1; that of an empty message has 0.
SHORTEST_QUATERNION = 1e-6


@dataclass(frozen=True)
class TransformTree:
    """The coordinate frames of a bag, each with its parent.

    Attributes:
        edges: for each frame with a parent: the parent, the stamps (ns, increasing), and the (n, 4, 4)
            transforms from the frame to the parent; a single transform holds for all times.
    """

    edges: dict[str, tuple[str, Int64, Float64]]

    def path(self, frame: str) -> list[str]:
        """Return the frame, its parent, and so on up to the root."""
        chain = [frame]
        while chain[-1] in self.edges and self.edges[chain[-1]][0] not in chain:
            chain.append(self.edges[chain[-1]][0])
        return chain

    def fixed(self, to_frame: str, from_frame: str) -> Float64 | None:
        """Return `T_to_from` (4, 4) between two frames, if it is known and does not change; else None."""
        if not (to_frame and from_frame):
            return None
        up, down = self.path(from_frame), self.path(to_frame)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        T_common_from = self._fixed_up(up[: up.index(common)])
        T_common_to = self._fixed_up(down[: down.index(common)])
        if T_common_from is None or T_common_to is None:
            return None
        return np.asarray(np.linalg.inv(T_common_to) @ T_common_from)

    def moving(self, frame: str) -> GivenTrajectory | None:
        """Return the motion of a frame relative to the root of its tree, the world.

        Of the moving transforms on the path to the root, the one with the most stamps gives the stamps. The
        others are interpolated. Return None if no transform on this path moves, or their times do not
        overlap.
        """
        links = [self.edges[name] for name in self.path(frame)[:-1]]
        moving = [own for _, own, transforms in links if _moves(transforms)]
        if not moving:
            return None
        busiest = max(moving, key=len)
        first, last = max(own[0] for own in moving), min(own[-1] for own in moving)
        stamps = busiest[(busiest >= first) & (busiest <= last)]
        if len(stamps) == 0:
            return None
        T = np.broadcast_to(np.eye(4), (len(stamps), 4, 4))
        for _, own, transforms in links:
            T = _at(own, transforms, stamps) @ T
        return GivenTrajectory(stamps, np.ascontiguousarray(T))

    def _fixed_up(self, frames: list[str]) -> Float64 | None:
        T: Float64 = np.eye(4)
        for name in frames:
            transforms = self.edges[name][2]
            if _moves(transforms):
                return None
            T = transforms[0] @ T
        return T


def read_transforms(bag: RosBag) -> TransformTree:
    """Read every tf and tf_static message; a frame keeps its first parent; invalid transforms are skipped."""
    # For each frame: its parent, the stamps of its transforms, and seven numbers of each. A robot's bag has
    # millions of transforms: the matrices are made at once.
    parents: dict[str, str] = {}
    placed: dict[str, tuple[array[int], array[float]]] = {}
    read = (message for topic in bag.topics if topic.type in TF for message in bag.whole(topic))
    for stamped in (stamped for message in read for stamped in message.transforms):
        # tf 1 wrote names with a leading slash.
        child, parent = stamped.child_frame_id.lstrip("/"), stamped.header.frame_id.lstrip("/")
        numbers, stamp = _numbers_of(stamped.transform), stamped.header.stamp
        named = child and parent and child != parent
        if numbers is not None and named and parents.setdefault(child, parent) == parent:
            stamps_ns, rows = placed.setdefault(child, (array("q"), array("d")))
            stamps_ns.append(stamp.sec * 10**9 + stamp.nanosec)
            rows.extend(numbers)
    return TransformTree({name: (parents[name], *_by_stamp(*placed[name])) for name in placed})


def _by_stamp(stamps_ns: "array[int]", rows: "array[float]") -> tuple[Int64, Float64]:
    """Return stamps (n,), sorted, and matrices (n, 4, 4) of transforms; of equal stamps the last is kept.

    Each transform has seven numbers, as `_numbers_of` returns them.
    """
    # In reverse, because unique takes the first of equal stamps.
    stamps, first = np.unique(np.array(stamps_ns, np.int64)[::-1], return_index=True)
    return stamps, _matrices(np.array(rows).reshape(-1, 7)[::-1][first])


def matrix_of(transform: Message) -> Float64 | None:
    """Return the matrix (4, 4) of a geometry_msgs/Transform; None if its numbers are not usable."""
    numbers = _numbers_of(transform)
    return None if numbers is None else _matrices(np.array([numbers]))[0]


def _numbers_of(transform: Message) -> tuple[float, ...] | None:
    """Return translation x y z, quaternion x y z w; None if not finite, too large, or zero quaternion."""
    t, q = transform.translation, transform.rotation
    numbers = (t.x, t.y, t.z, q.x, q.y, q.z, q.w)
    if not all(abs(number) <= FARTHEST_M for number in numbers):  # false for NaN, too
        return None
    return numbers if math.hypot(*numbers[3:]) >= SHORTEST_QUATERNION else None


def _matrices(rows: Float64) -> Float64:
    """Return the matrices (n, 4, 4) of rows (n, 7): translation x y z, quaternion x y z w."""
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation_from_quaternion_xyzw(rows[:, 3:]), rows[:, :3]
    return T


def _moves(transforms: Float64) -> bool:
    return len(transforms) > 1 and bool(np.abs(transforms - transforms[0]).max() > 1e-6)


def _at(own: Int64, transforms: Float64, stamps: Int64) -> Float64:
    """Interpolate `transforms`, which have the stamps `own`, at `stamps`; return (n, 4, 4).

    Rotations take the shortest way. Before `own` the first transform holds, after it the last.
    """
    after = np.clip(np.searchsorted(own, stamps), 0, len(own) - 1)
    before = np.maximum(after - 1, 0)
    at_one = (own[after] == stamps) | (after == before)
    share = (stamps - own[before]) / np.where(at_one, 1, own[after] - own[before])
    between = interpolate_rigid(transforms[before], transforms[after], np.clip(share, 0, 1))
    return np.where(at_one[:, None, None], transforms[after], between)


def read_ros_poses(bag: RosBag, tree: TransformTree, depth: ImageTopic, named: str | None) -> MaybeGiven:
    """Read the depth camera's trajectory: (camera to world or None, warnings, why it is unusable or "").

    The settings may name the topic to read (`named`), or "tf", the tree of frames. If they name none, the
    bag's only topic of PoseStamped or Odometry is read. If there are several, none is read, with a warning;
    if there is none, tf is read. Odometry of another frame than the camera's is converted to the camera's by
    tf. If tf lacks the transform between the two, the poses are used as they are, with a warning.

    Raises:
        RecordingError: the named topic, or tf if it is named, holds no poses of the camera.
    """
    topics = [topic for topic in bag.topics if topic.type in (POSE, ODOMETRY)]
    if named is not None and named != "tf":
        chosen = [topic for topic in topics if topic.name == named]
        if not chosen:
            names = ", ".join([*(topic.name for topic in topics), "tf"])
            raise RecordingError(
                f"{bag.path}: `pose_topic: {named}` holds no poses; those that fit are: {names}",
                what="bad-topic",
            )
        topics = chosen
    if named == "tf" or not topics:
        return *_from_tree(bag, tree, depth, named), ""
    if len(topics) > 1:
        names = ", ".join(topic.name for topic in topics)
        what = f"{bag.path}: {names} all hold poses"
        return None, [f"{what}; none of them is used: name one as `pose_topic`"], ""
    return read_given(lambda: _from_topic(bag, topics[0], tree, depth))


def _from_topic(bag: RosBag, topic: BagTopic, tree: TransformTree, depth: ImageTopic) -> Given:
    name = f"{bag.path}: {topic.name}"
    rows, child = [], ""
    damaged: list[str] = []
    for index, place in enumerate(topic.messages):
        try:
            message = bag.decode(topic, index)
        except DamagedImageError as error:
            damaged.append(str(error))
            continue
        is_odometry = topic.type == ODOMETRY
        pose = message.pose.pose if is_odometry else message.pose
        child = message.child_frame_id.lstrip("/") if is_odometry else ""
        p, q = pose.position, pose.orientation
        where = f"{name}, message {index}"
        rows.append(TimedPose(place.stamp_ns, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), where))
    trajectory, warnings = trajectory_from_poses(rows, name)
    if damaged:
        warnings.append(
            f"{bag.path}: {damaged[0]}; {len(damaged)} of {len(topic.messages)} poses are left out"
        )
    camera = depth.frame_id
    if not child or child == camera:
        return trajectory, warnings
    T_child_camera = tree.fixed(child, camera)
    if T_child_camera is None:
        warnings.append(
            f"{name} holds the poses of '{child}', and tf does not say how the camera "
            f"'{camera}' lies to it: they are taken for the camera's"
        )
        return trajectory, warnings
    return GivenTrajectory(trajectory.stamps_ns, trajectory.T_world_camera @ T_child_camera), warnings


def _from_tree(bag: RosBag, tree: TransformTree, depth: ImageTopic, named: str | None) -> Given:
    moving = tree.moving(depth.frame_id) if depth.frame_id else None
    if moving is None and named == "tf":
        raise RecordingError(
            f"{bag.path}: `pose_topic: tf`, but no transform above the frame '{depth.frame_id}' of "
            f"{depth.name} moves; its frames are {', '.join(sorted(tree.edges)) or 'none'}",
            what="bad-topic",
        )
    return moving, []
