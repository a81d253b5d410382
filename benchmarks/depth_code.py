"""The code of depth images against PNG: size, and CPU time to read a frame back, of 16-bit PNGs."""

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from figures import Figure, arguments, at_least, at_most, equals, run, told

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.depth_code import decode_depth, encode_depth

FRAMES = 20
ROUNDS = 15


def best_ms(work: Callable[[], object], frames: int) -> float:
    """The least CPU time of several rounds, a frame."""
    times = []
    for _ in range(ROUNDS):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return min(times) * 1000 / frames


def measure(folder: Path) -> list[Figure]:
    """The first frames of a folder."""
    names = sorted([*folder.glob("depth/*.png"), *folder.glob("*.depth.png")])[:FRAMES]
    pngs = [name.read_bytes() for name in names]
    if not pngs:
        raise RecordingError(f"{folder}: holds no depth/*.png or *.depth.png")
    images = [cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED) for png in pngs]
    codes = [encode_depth(image) for image in images]
    same = sum(np.array_equal(decode_depth(c), i) for c, i in zip(codes, images, strict=True))
    png_ms = best_ms(
        lambda: [cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED) for png in pngs], len(pngs)
    )
    code_ms = best_ms(lambda: [decode_depth(code) for code in codes], len(codes))
    name = folder.name
    return [
        equals(f"{name}: frames that come back to the bit", same, len(pngs)),
        at_most(
            f"{name}: size, share of the recorded PNG's", sum(map(len, codes)) / sum(map(len, pngs)), 1.0
        ),
        told(f"{name}: PNG, ms CPU a frame", png_ms),
        told(f"{name}: this code, ms CPU a frame", code_ms),
        at_least(f"{name}: times as fast", png_ms / code_ms, 3.5),
    ]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER", help="recordings with PNG depth")
    options = parser.parse_args()
    run(options, lambda: [figure for folder in options.folders for figure in measure(folder)])


if __name__ == "__main__":
    main()
