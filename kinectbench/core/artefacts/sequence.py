"""camera.json and frames.json of `build/<recording>/sequence/`: the camera, and the files of each frame."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from kinectbench.core.artefacts.stored import Bare, Stored, StoredPart, optional
from kinectbench.core.geometry import Camera
from kinectbench.core.types import Int64

AGAIN = "delete the folder and run `kinectbench ingest` again"


# Largest number of digests in `CameraFile.depth_sketch`; recordings of fewer frames have them all.
SKETCH_DIGESTS = 1024
# How the warning about each frame begins that could not be read.
DAMAGED_FRAME = "frame left out: "


class CameraFile(Stored):
    """camera.json: the depth camera, and facts about the whole recording."""

    FILE: ClassVar[str] = "camera.json"
    ADVICE: ClassVar[str] = AGAIN
    FORMAT_VERSION: ClassVar[int] = 2
    READABLE_VERSIONS: ClassVar[tuple[int, ...]] = (1, 2)

    format_version: int = Field(
        description="Version of the sequence folder: 1 (depth as PNG) or 2 (depth as .kbd)."
    )
    width: int = Field(description="Width of the depth images, pixels.")
    height: int = Field(description="Height of the depth images, pixels.")
    fx: float = Field(description="Focal length in x of the depth images, pixels.")
    fy: float = Field(description="Focal length in y of the depth images, pixels.")
    cx: float = Field(description="Principal point in x of the depth images, pixels.")
    cy: float = Field(description="Principal point in y of the depth images, pixels.")
    depth_scale: float = Field(gt=0, description="Native depth units per metre.")
    color_registered: bool = Field(description="Whether colour pixels lie on depth pixels.")
    registered_by: Literal["recording", "calibration"] | None = optional(
        "recording: as recorded; calibration: by ingest, with a given calibration."
    )
    source_format: str = Field(default="", description="Name of the recording's format.")
    frames: int | None = optional("Number of frames.")
    warnings: tuple[str, ...] = Field(default=(), description="What the recording's user should know.")
    doubts: tuple[str, ...] = Field(
        default=(), description="Evidence that depth_scale or intrinsics are wrong; absent: nothing."
    )
    trajectory_error: str = Field(default="", description='Why the given trajectory is not used, or "".')
    depth_sketch: tuple[str, ...] = Field(
        default=(), description="The 1024 smallest digests (BLAKE2b) of depth images, in millimetres."
    )
    up_world: tuple[float, float, float] | None = optional(
        "Unit vector: up by gravity, in the frame of the given trajectory; absent: not known."
    )
    up_cameras: tuple[tuple[int, float, float, float], ...] | None = optional(
        "[stamp in ns, x, y, z] of some frames: unit vector, up in the camera's axes, by an "
        "accelerometer; absent: none, or its place is not known."
    )

    @field_validator("format_version")
    @classmethod
    def _readable(cls, version: int) -> int:
        if version not in cls.READABLE_VERSIONS:
            raise ValueError(f"written in format version {version}")
        return version

    @property
    def damaged(self) -> int:
        """The number of frames that could not be read; `frames` does not count them."""
        return sum(line.startswith(DAMAGED_FRAME) for line in self.warnings)

    @property
    def camera(self) -> Camera:
        """The pinhole camera of the depth images."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


class FrameRow(StoredPart):
    """One frame of frames.json; paths are relative to the sequence folder."""

    index: int = Field(description="Index of the frame, from 0.")
    recorded: int | None = optional(
        "Number of the frame in the recording, from 0: damaged frames count; absent: as index."
    )
    stamp_ns: int = Field(description="Stamp of the depth image, nanoseconds.")
    depth: str = Field(description="Path of the depth image, native units, 0 = no measurement.")
    color: str | None = Field(description="Path of the colour image as it was encoded, or null.")
    mask: str | None = optional("Path of the given mask (not 0 = object), or null.")


class FramesFile(Bare):
    """frames.json: a list of frames in the order of their stamps."""

    FILE: ClassVar[str] = "frames.json"
    ADVICE: ClassVar[str] = AGAIN

    rows: tuple[FrameRow, ...] = Field(description="The frames in the order of their stamps.")

    @property
    def stamps_ns(self) -> Int64:
        """Stamp of each frame: (n,) int64, nanoseconds."""
        return np.array([row.stamp_ns for row in self.rows], np.int64)

    @property
    def recorded(self) -> tuple[int, ...]:
        """The number of each frame in the original recording, which also counts damaged frames."""
        return tuple(row.index if row.recorded is None else row.recorded for row in self.rows)
