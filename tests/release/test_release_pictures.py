"""The pictures of a release's page: a shape looks the same however its grid lies in memory."""

import base64
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from read_pictures import decoded_picture
from synthetic_release import synthetic_settings

from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.geometry.mesh import read_own_ply, write_ply
from kinectbench.release.publish.index_page import CLAY, PAPER, seen_from_the_front, seen_from_the_right
from kinectbench.release.publish.publish import publish


@pytest.mark.parametrize("share", [0.0, 0.002, 0.3])
def test_a_picture_does_not_depend_on_the_order_in_memory(share: float) -> None:
    cells = np.random.default_rng(0).random((24, 20, 16)) < share
    for seen in (seen_from_the_front, seen_from_the_right):
        pictures = [
            seen(np.ascontiguousarray(cells.transpose(axes)).transpose(np.argsort(axes)), CLAY)
            for axes in ((0, 1, 2), (2, 1, 0), (1, 2, 0))
        ]
        assert all((picture == pictures[0]).all() for picture in pictures)
        assert (pictures[0] == PAPER).all() == (not cells.any())


def test_what_is_nearer_hides_what_is_behind() -> None:
    near = np.zeros((16, 16, 16), bool)
    near[12:, 4:12, 4:12] = True  # to the right
    both = near.copy()
    both[:4, 4:12, 4:12] = True
    assert (seen_from_the_right(near, CLAY) == seen_from_the_right(both, CLAY)).all()
    assert (seen_from_the_front(near, CLAY) != seen_from_the_front(both, CLAY)).any()


@pytest.mark.parametrize("hidden", [False, True])
def test_the_page_begins_with_the_objects(hidden: bool, analytic: Path, tmp_path: Path) -> None:
    """At most one warning stands before them, and none of what is held back turns."""
    options = PublishOptions(hold_back=("test",) if hidden else (), thresholds=None)
    names = ["chair_02", "table_02"]
    settings = synthetic_settings(license="unspecified", publish={"color": True})
    page = (
        publish(settings, analytic / "build", tmp_path / "b", names, options).folder / "index.html"
    ).read_text()
    turning = re.findall(r'aria-label="object of (\w+);', page)
    assert turning == (["table_02"] if hidden else names)
    assert "passed over</th>" in page and "refused" not in page
    begin = page.index('class="turn"')
    assert page[:begin].count('class="alert"') == 1 <= page[begin:].count('class="alert"')
    assert begin < page.index("<img") < page.index("<table")


@pytest.mark.parametrize("color", [False, True])
def test_objects_have_colour_only_where_it_is_published(color: bool, analytic: Path, tmp_path: Path) -> None:
    build = Path(shutil.copytree(analytic / "build", tmp_path / "build"))
    shape = read_own_ply(build / "chair_02/object/mesh.ply")
    red = np.tile(np.array([220, 10, 10], np.uint8), (len(shape.vertices), 1))
    (build / "chair_02/reconstruction").mkdir(exist_ok=True)
    write_ply(replace(shape, colors=red), build / "chair_02/reconstruction/mesh.ply")
    settings = synthetic_settings(publish={"color": color})
    page = (publish(settings, build, tmp_path / "b", ["chair_02"]).folder / "index.html").read_text()
    (strip,) = re.findall(r'class="turn".*?src="data:image/jpeg;base64,([^"]+)"', page)
    blue, _, red_of = decoded_picture(base64.b64decode(strip)).T.astype(int)
    assert (red_of - blue > 100).any() == color
