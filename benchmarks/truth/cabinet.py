"""A real object: a drawer cabinet alone on a bare floor, its trajectory measured by motion capture.

DATA is a folder of real recordings with `tum_fr3_cabinet` in it (58 frames of TUM RGB-D's
freiburg3_cabinet, TUM layout). The given world's floor is z = 0, so the floor found can be checked; a
cabinet's faces are flat, so the surface can be; the rest is what the stages say of themselves.

With --bag the same frames are built from a ROS 1 bag, too, and must give the same bytes. The bag holds its
depth as raw 16UC1, its colour as it is (JPEG CompressedImage), a CameraInfo with each depth image and the
trajectory as PoseStamped; it is built with `camera: {depth_scale: 5000}`.
"""

import argparse
import os
import resource
import sys
from pathlib import Path

import numpy as np
from builds import built, read_json, run_on_build, stage_seconds
from faces import Face, measure_faces
from figures import Figure, arguments, at_least, at_most, equals, stated
from ingest_writers import BagWriter
from numpy.typing import NDArray

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.geometry import OrientedBox
from kinectbench.core.geometry.mesh import read_own_ply
from kinectbench.core.images import read_gray
from kinectbench.core.trajectory.stamps import parse_stamp_ns
from kinectbench.core.trajectory.text_rows import text_rows
from kinectbench.engine.stages import Job
from kinectbench.settings.models import BenchmarkSettings
from kinectbench.stages.sample_views.views import read_views
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.object_model import read_object

ID = "cabinet"
FOLDER = "tum_fr3_cabinet"
BAG_ID = "bag"
MAX_FLOOR_OFFSET_M = 0.010
MAX_FLOOR_TILT_DEG = 1.0
MAX_SIDE_DIFFERENCE_M = 0.008
MAX_FACE_RMS_M = 0.003
MIN_FLAT_FACES = 4
VIEWS = 50


def data_argument(parser: argparse.ArgumentParser) -> None:
    """The folder of real recordings."""
    default = os.environ.get("KINECTBENCH_DATA")
    parser.add_argument(
        "data", type=Path, nargs="?" if default else None, default=default, help="default: $KINECTBENCH_DATA"
    )


def cabinet_settings(data: Path) -> BenchmarkSettings:
    """The cabinet alone, with the defaults and its trajectory trusted."""
    path = str((data / FOLDER).resolve())
    recording = {"id": ID, "path": path, "category": "cabinet", "trajectory": "trust"}
    return BenchmarkSettings.model_validate({"name": "cabinet", "recordings": [recording]})


def object_figures(job: Job) -> list[Figure]:
    """One object, alone on the floor of the given world."""
    from scipy import ndimage

    model = read_object(job.build / "object")
    pieces = ndimage.label(model.shape.solid)[1]
    lowest = np.flatnonzero(model.shape.solid.any(axis=(0, 1)))[0]
    below_m = model.shape.grid.T_world_grid[2, 3] + lowest * model.shape.grid.voxel_size_m
    offset_m, tilt_deg = floor_against_world(model.floor, model.box)
    return [
        equals("chosen", model.quality.selection, "automatic"),
        equals("pieces of the solid (6-connected)", int(pieces), 1),
        at_most("underside of the solid off z = 0, m", abs(float(below_m)), MAX_FLOOR_OFFSET_M),
        stated("box, m", [*model.box.size_m]),
        at_most("floor off z = 0 below the object's centre, m", offset_m, MAX_FLOOR_OFFSET_M),
        at_most("floor tilted from z = 0, degrees", tilt_deg, MAX_FLOOR_TILT_DEG),
        at_most("box of odd and of even frames: largest difference of a side, m", *_sides(model.quality)),
        stated("solids of odd and of even frames: IoU", model.quality.repeatability_iou),
        stated("surface's standard deviation, m", model.surface_sigma_m),
    ]


def floor_against_world(floor: Floor, box: OrientedBox) -> tuple[float, float]:
    """How far (m) and by what angle (degrees) the floor is off z = 0 of the world, below a box's centre."""
    a, b, c, d = floor.plane_world
    x, y, _ = floor.T_world_floor[:3, :3] @ np.array([*box.center_m[:2], 0.0]) + floor.T_world_floor[:3, 3]
    return abs(float((a * x + b * y + d) / c)), float(np.degrees(np.arccos(min(1.0, abs(c)))))


def _sides(quality: QualityFile) -> tuple[float, float]:
    """The largest difference of any of the six sides' places, in the boxes' common yaw; and the bar."""
    odd, even = (_places(each.box()) for each in (quality.box_odd, quality.box_even) if each)
    return float(np.abs(odd - even).max()), MAX_SIDE_DIFFERENCE_M


def _places(box: OrientedBox) -> NDArray[np.float64]:
    middle = box.T_floor_box[:3, :3].T @ np.array(box.center_m)
    half = np.array(box.size_m) / 2
    return np.concatenate([middle - half, middle + half])


def face_figures(job: Job) -> list[Figure]:
    """Flatness of the top and the four sides, of the closed mesh and of the fused scene."""
    model = read_object(job.build / "object")
    found = []
    for name, path in (("object", "object/mesh.ply"), ("scene", "reconstruction/mesh.ply")):
        vertices = read_own_ply(job.build / path).vertices
        faces = measure_faces(vertices, model.box, model.floor.T_floor_world)
        flat = sum(face.rms_m <= MAX_FACE_RMS_M for face in faces)
        words = f"{name}'s mesh: faces of five flat to 3 mm rms"
        found.append(at_least(words, flat, MIN_FLAT_FACES) if name == "object" else stated(words, flat))
        trimmed = sum(face.trimmed_rms_m <= MAX_FACE_RMS_M for face in faces)
        found.append(stated(f"{words}, trimmed", trimmed))
        found.append(stated(f"{name}'s mesh: rms, trimmed (vertices, share kept)", [*map(_words, faces)]))
    return found


def _words(face: Face) -> str:
    rms, trimmed = 1000 * face.rms_m, 1000 * face.trimmed_rms_m
    return f"{face.side:>3}  {rms:.2f} mm, {trimmed:.2f} mm ({face.vertices}, {face.kept:.1%})"


def tracking_figures(job: Job) -> list[Figure]:
    """Frames left out."""
    health = read_json(job.build / "trajectory" / "health.json")
    reasons = [f"frame {row['frame']}: {row['reason']}" for row in health["rejected"]]
    return [
        equals("frame 0 is left out", 0 in [row["frame"] for row in health["rejected"]], True),
        stated("frames left out", reasons),
        stated("frames without a pose", health["lost"]),
        stated("frames agree within, mm (median)", health["median_shift_mm"]),
    ]


def pair_figures(job: Job) -> list[Figure]:
    """Views and pairs, and how well the depth fits the shape."""
    views, table = read_views(job.build / "views"), read_json(job.build / "pairs" / "pairs.json")
    containment = [row["containment"] for row in table["pairs"]]
    residual = [row["residual_m"] for row in table["pairs"]]
    made = [row for row in table["pairs"] if (job.build / "pairs" / f"{row['view']}.npz").is_file()]
    return [
        equals("views with a mask", sum(bool(view.mask.any()) for view in views), VIEWS),
        equals("pairs", len(made), VIEWS),
        stated("pairs refused", [f"{row['view']}: {row['reason']}" for row in table["refused"]]),
        stated("containment: mean, least", [float(np.mean(containment)), min(containment)]),
        stated("residual, m: median, largest", [float(np.median(residual)), max(residual)]),
    ]


def wrap(folder: Path, bag_file: Path) -> None:
    """Write a TUM folder with camera.json and groundtruth.txt as a bag, nothing decoded but depth's PNG."""
    camera = read_json(folder / "camera.json")
    with BagWriter(bag_file, "LZ4", chunk_bytes=1 << 20) as bag:
        for _, row in text_rows(folder / "depth.txt"):
            stamp, name = row.split()
            depth = read_gray(folder / name)
            stamp_ns = parse_stamp_ns(stamp, name)
            bag.image("/camera/depth_registered/image_raw", stamp_ns, depth, "16UC1")
            bag.info("/camera/depth_registered/camera_info", stamp_ns, camera)
        for _, row in text_rows(folder / "rgb.txt"):
            stamp, name = row.split()
            data = (folder / name).read_bytes()
            bag.compressed("/camera/rgb/image_color/compressed", parse_stamp_ns(stamp, name), data, "jpeg")
        for _, row in text_rows(folder / "groundtruth.txt"):
            stamp, *numbers = row.split()
            values = [float(number) for number in numbers]
            bag.pose("/camera/pose", parse_stamp_ns(stamp, "groundtruth.txt"), values[:3], values[3:])


def with_bag(settings: BenchmarkSettings, bag_file: Path) -> BenchmarkSettings:
    """The cabinet's settings and, beside it, the bag as a second recording."""
    (recording,) = settings.recordings
    changed = {"id": BAG_ID, "path": str(bag_file), "camera": {"depth_scale": 5000.0}, "object": recording.id}
    rows = [recording.model_dump(), recording.model_dump() | changed]
    return BenchmarkSettings.model_validate(settings.model_dump() | {"recordings": rows})


def compare(folder: Path, bag: Path) -> list[Figure]:
    """Two `build/<recording>/` folders: the files of views and pairs that differ, by name."""
    found = []
    for stage, pattern in (("pairs", "*.npz"), ("views", "*.depth.png"), ("views", "*.mask.png")):
        names = {path.name for root in (folder, bag) for path in (root / stage).glob(pattern)}
        different = [name for name in sorted(names) if not _same(folder / stage / name, bag / stage / name)]
        found.append(stated(f"{stage}/{pattern}: files", len(names)))
        found.append(equals(f"{stage}/{pattern}: missing or different in the other", different, []))
    return found


def _same(a: Path, b: Path) -> bool:
    return a.is_file() and b.is_file() and a.read_bytes() == b.read_bytes()


def measure(data: Path, root: Path, bag: bool) -> list[Figure]:
    """Build the cabinet and look at what came out."""
    (job,) = built(cabinet_settings(data), root)
    # ru_maxrss: kilobytes on Linux, bytes on macOS
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
    seconds = stage_seconds(job)
    return [
        *tracking_figures(job),
        *object_figures(job),
        *face_figures(job),
        *pair_figures(job),
        stated("build, s", round(sum(seconds.values()), 1)),
        stated("    by stage", [f"{name} {value:.1f}" for name, value in seconds.items()]),
        stated("peak memory of this process after the build, MB", round(peak_mb)),
        *(bag_figures(data, root) if bag else ()),
    ]


def bag_figures(data: Path, root: Path) -> list[Figure]:
    """Write the bag, build it beside the folder, and compare."""
    settings = cabinet_settings(data)
    bag_file = root / "cabinet.bag"
    wrap(Path(settings.recordings[0].path), bag_file)
    folder, bag = built(with_bag(settings, bag_file.resolve()), root)
    return [stated("the bag, MB", round(bag_file.stat().st_size / 1e6, 1)), *compare(folder.build, bag.build)]


def main() -> None:
    parser = arguments(__doc__)
    data_argument(parser)
    parser.add_argument("--bag", action="store_true", help="build the same frames from a bag, and compare")
    run_on_build(parser, lambda options, root: measure(options.data, root, options.bag))


if __name__ == "__main__":
    main()
