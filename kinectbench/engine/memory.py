"""The expected memory of a recording's stages, from facts known before they are built."""

from itertools import islice
from math import prod

from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.errors import KinectBenchError
from kinectbench.core.store.address import url_of
from kinectbench.engine.stages import Job

# Peaks of the stages, measured one by one (`/usr/bin/time -f %M kinectbench STAGE --jobs 1`), and this sum of
# libraries, frames and voxels of the object:
#   phone, 92 frames of 256 x 192, 0.3 million voxels              0.48 GB (fuse)      0.58
#   cabinet, 58 frames of 640 x 480, 3.1 million                   0.91 GB (segment)   0.94
#   kitchen, 150 frames of 640 x 480, a chair of 3.8 million       0.95 GB (segment)   1.11
#   a simulated chair, 1000 frames of 640 x 480, 2.4 million       0.97 GB (track)     1.45
LIBRARIES_GB = 0.55
BYTES_PER_PIXEL = 2.0
BYTES_PER_VOXEL = 130.0
# Where no box is given: 2.2 GB were measured on that kitchen with the largest thing in it as the object.
UNKNOWN_VOXELS = 13e6
# The frames as PNG and JPEG files, the smallest form that there is: 0.43 to 0.46 bytes a depth pixel with its
# colour. It is an upper bound for other forms, so that at most a thousand frames of 640 x 480 are expected.
BYTES_OF_FILE_PER_PIXEL = 0.4
UNKNOWN_PIXELS = 1000 * 640 * 480
# Files of a folder that are looked at (a thousand frames have some thousands).
MOST_FILES = 10_000


def expected_gb(job: Job) -> float:
    """Peak resident memory of a recording's stages, GB; an estimate, not a bound."""
    return LIBRARIES_GB + (BYTES_PER_PIXEL * _pixels(job) + BYTES_PER_VOXEL * _voxels(job)) / 1e9


def _pixels(job: Job) -> float:
    """Pixels of all depth images, as counted by ingest, or estimated from the size of the files."""
    if url_of(job.root) is not None:
        return UNKNOWN_PIXELS
    try:
        camera = CameraFile.read(job.build / "sequence")
    except (KinectBenchError, OSError):
        camera = None
    if camera is not None and camera.frames is not None:
        return camera.frames * camera.width * camera.height
    try:
        files = job.source.rglob("*") if job.source.is_dir() else [job.source]
        size = sum(file.lstat().st_size for file in islice(files, MOST_FILES))
    except OSError:  # whoever builds it says so
        return UNKNOWN_PIXELS
    return min(size / BYTES_OF_FILE_PER_PIXEL, UNKNOWN_PIXELS)


def _voxels(job: Job) -> float:
    """Voxels of the grid from the floor around a person's box; without a box, a typical maximum."""
    from kinectbench.stages.segment.solid.grids import MARGIN_M, REFERENCE_VOXEL_M

    box = job.recording.box
    if box is None:
        return UNKNOWN_VOXELS
    edge_m = job.settings.fusion.voxel_size_m or REFERENCE_VOXEL_M
    top_m = box.center_m[2] + box.size_m[2] / 2
    return prod((side_m + 2 * MARGIN_M) / edge_m for side_m in (*box.size_m[:2], top_m))
