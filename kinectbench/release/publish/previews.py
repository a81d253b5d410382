"""Write previews/: a small picture of each pair's view, and tables that dataset viewers read.

Each split has a folder that `ImageFolder` of Hugging Face's `datasets` can read: `metadata.jsonl` has a line
for each pair, with its picture's path in `file_name`. Source:
https://huggingface.co/docs/datasets/image_dataset
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinectbench.core import images, write_below
from kinectbench.core.artefacts.targets import SPLITS, Target, columns_of
from kinectbench.core.types import Rgb
from kinectbench.release.contents import PREVIEWS, ROWS

# Half the width of a Kinect's image.
WIDTH_PX = 320


def row_picture(target: Target) -> str:
    """Return a picture's path relative to the folder of its split: `file_name` in the pair's row."""
    return f"{target.recording}/{target.view}.jpg"


def rows_text(targets: Sequence[Target]) -> str:
    """Return a split's metadata.jsonl: a row per pair, with `file_name` and the columns of targets.csv."""
    names = columns_of(targets)
    rows = [{"file_name": row_picture(t)} | {name: getattr(t, name) for name in names} for t in targets]
    return "".join(json.dumps(row) + "\n" for row in rows)


def write_view_pictures(folder: Path, targets: Sequence[Target]) -> None:
    """Write previews/ from the images in `views/` of a release's folder.

    Raises:
        StorageError: an image is damaged.
    """
    for split in SPLITS:
        of_split = [target for target in targets if target.split == split]
        for target in of_split:
            picture = _view_picture(folder / "views" / target.recording, target.view)
            write_below(folder / PREVIEWS / split / row_picture(target), images.jpeg(picture))
        if of_split:
            write_below(folder / PREVIEWS / split / ROWS, rows_text(of_split).encode())


def _view_picture(views: Path, view: str) -> Rgb:
    """Draw a view's depth with the mask's outline, and its colour image, if any, to the right."""
    picture = depth_with_mask(views, view)
    path = views / f"{view}.color.jpg"
    if not path.is_file():
        return picture
    color = images.shrunk(images.read_color(path), WIDTH_PX)
    height = max(len(picture), len(color))
    low = [np.pad(each, ((0, height - len(each)), (0, 0), (0, 0))) for each in (picture, color)]
    return np.concatenate(low, axis=1)


def depth_with_mask(views: Path, view: str) -> Rgb:
    """Draw a view's depth with the mask's outline, as a picture about `WIDTH_PX` wide."""
    depth_mm = images.read_gray(views / f"{view}.depth.png")
    mask = images.read_gray(views / f"{view}.mask.png") > 0
    step = max(1, round(depth_mm.shape[1] / WIDTH_PX))
    small = images.depth_picture(depth_mm[::step, ::step])
    return images.overlay_mask(small, mask[::step, ::step])
