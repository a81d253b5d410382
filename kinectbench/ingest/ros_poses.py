"""The trajectory of a ROS bag: a topic of poses, or tf."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import RecordingError
from kinectbench.ingest.ros_messages import BagMessages, BagTopic
from kinectbench.ingest.ros_topics import ODOMETRY, POSE, ImageTopic
from kinectbench.ingest.ros_transforms import TransformTree
from kinectbench.ingest.trajectory_file import TimedPose, read_given, trajectory_from_poses
from kinectbench.sequence import GivenTrajectory

Given = tuple[GivenTrajectory | None, list[str]]
MaybeGiven = tuple[GivenTrajectory | None, list[str], str]


def read_poses(
    path: Path,
    topics: tuple[BagTopic, ...],
    messages: BagMessages,
    tree: TransformTree,
    depth: ImageTopic,
    named: str | None,
) -> MaybeGiven:
    """The trajectory of the depth camera, camera to world; warnings; and why it cannot be used, or "".

    It is that of the topic that the settings name ("tf" for the tree of frames), or else of the one topic of
    PoseStamped or Odometry, or else of tf. Where Odometry is of another frame than the camera's, and tf says
    how both lie to each other, it is moved to the camera.

    Raises:
        RecordingError: the named topic holds no poses.
    """
    found = [topic for topic in topics if topic.type in (POSE, ODOMETRY)]
    if named is not None and named != "tf":
        chosen = [topic for topic in found if topic.name == named]
        if not chosen:
            names = ", ".join([*(topic.name for topic in found), "tf"])
            raise RecordingError(f"{path}: `pose_topic: {named}` holds no poses; those that fit are: {names}")
        found = chosen
    if named == "tf" or not found:
        return *_from_tree(path, tree, depth, named), ""
    if len(found) > 1:
        names = ", ".join(topic.name for topic in found)
        return None, [f"{path}: {names} all hold poses; none of them is used: name one as `pose_topic`"], ""
    return read_given(lambda: _from_topic(path, found[0], messages, tree, depth))


def _from_topic(
    path: Path, topic: BagTopic, messages: BagMessages, tree: TransformTree, depth: ImageTopic
) -> Given:
    rows, child = [], ""
    for index, place in enumerate(topic.messages):
        message = messages.decode(topic, index)
        is_odometry = topic.type == ODOMETRY
        pose = message.pose.pose if is_odometry else message.pose
        child = message.child_frame_id.lstrip("/") if is_odometry else ""
        p, q = pose.position, pose.orientation
        where = f"{path}: {topic.name}, message {index}"
        rows.append(TimedPose(place.stamp_ns, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), where))
    trajectory, warnings = trajectory_from_poses(rows, f"{path}: {topic.name}")
    camera = depth.frame_id.lstrip("/")
    if not child or child == camera:
        return trajectory, warnings
    T_child_camera = tree.fixed(child, camera)
    if T_child_camera is None:
        warnings.append(
            f"{path}: {topic.name} holds the poses of '{child}', and tf does not say how the camera "
            f"'{camera}' lies to it: they are taken for the camera's"
        )
        return trajectory, warnings
    return GivenTrajectory(trajectory.stamps_ns, trajectory.T_world_camera @ T_child_camera), warnings


def _from_tree(path: Path, tree: TransformTree, depth: ImageTopic, named: str | None) -> Given:
    moving = tree.moving(depth.frame_id.lstrip("/")) if depth.frame_id else None
    if moving is None:
        if named == "tf":
            raise RecordingError(
                f"{path}: `pose_topic: tf`, but no transform above the frame '{depth.frame_id}' of "
                f"{depth.name} moves; its frames are {', '.join(sorted(tree.edges)) or 'none'}"
            )
        return None, []
    _, stamps_ns, T_world_camera = moving
    return GivenTrajectory(stamps_ns, _copied(T_world_camera)), []


def _copied(T: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ascontiguousarray(T, dtype=np.float64)
