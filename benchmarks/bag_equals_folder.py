"""The same frames as a TUM folder and as a ROS 1 bag: the pairs built from them, byte for byte.

DATA is a folder of real recordings with `tum_fr3_cabinet` in it. The bag holds its depth as raw 16UC1
images in native units, its colour as it is (JPEG CompressedImage), a CameraInfo with each depth image
and the trajectory as PoseStamped; it is built with `camera: {depth_scale: 5000}`.
"""

import sys
from pathlib import Path

import cv2
from builds import built, read_json, run_on_build
from cabinet import cabinet_settings, data_argument
from figures import Figure, arguments, equals, told

from kinectbench.core.trajectory.stamps import parse_stamp_ns
from kinectbench.core.trajectory.text_rows import text_rows
from kinectbench.settings.models import BenchmarkSettings

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from ingest_writers import BagWriter

BAG_ID = "bag"


def wrap(folder: Path, bag_file: Path) -> None:
    """Write a TUM folder with camera.json and groundtruth.txt as a bag, nothing decoded but depth's PNG."""
    camera = read_json(folder / "camera.json")
    with BagWriter(bag_file, "LZ4", chunk_bytes=1 << 20) as bag:
        for _, row in text_rows(folder / "depth.txt"):
            stamp, name = row.split()
            depth = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
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
        found.append(told(f"{stage}/{pattern}: files", len(names)))
        found.append(equals(f"{stage}/{pattern}: missing or different in the other", different, []))
    return found


def _same(a: Path, b: Path) -> bool:
    return a.is_file() and b.is_file() and a.read_bytes() == b.read_bytes()


def measure(data: Path, root: Path) -> list[Figure]:
    """Write the bag, build both, and compare."""
    settings = cabinet_settings(data)
    bag_file = root / "cabinet.bag"
    wrap(Path(settings.recordings[0].path), bag_file)
    folder, bag = built(with_bag(settings, bag_file.resolve()), root)
    return [told("the bag, MB", round(bag_file.stat().st_size / 1e6, 1)), *compare(folder.build, bag.build)]


def main() -> None:
    parser = arguments(__doc__)
    data_argument(parser)
    run_on_build(parser, lambda options, root: measure(options.data, root))


if __name__ == "__main__":
    main()
