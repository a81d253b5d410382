"""A long recording with the guide takes bounded memory: old keyframes' images lie on the disk."""

from copy import copy
from pathlib import Path

import numpy as np
import pytest
from drawn_camera import DrawnCamera, drawn
from numpy.typing import NDArray

from kinectbench.record.guide import tracker as tracking
from kinectbench.record.guide.old_on_disk import OldOnDisk
from kinectbench.record.guide.tracker import LiveTracker


def test_what_was_set_first_is_on_the_disk_and_comes_back(tmp_path: Path) -> None:
    images, kept = OldOnDisk[NDArray[np.uint16]](tmp_path, most=3), dict[int, NDArray[np.uint16]]()
    for index in range(10):
        images[index] = kept[index] = np.random.default_rng(index).integers(0, 999, (4, 6), np.uint16)
    before = copy(images)
    images[2] = kept[2] + 1
    del images[0], images[9]
    assert images.pop(5, None) is not None and images.pop(77, None) is None and images.get(0) is None
    assert len(images._memory) <= 3 and sorted(images) == [1, 2, 3, 4, 6, 7, 8] and len(images) == 7
    assert (images[2] == kept[2] + 1).all()
    assert sorted(before) == [*range(10)] and all((before[index] == kept[index]).all() for index in kept)
    assert list(tmp_path.iterdir()) == []  # the file has no name


def test_the_tracker_finds_the_same_with_few_images_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tracked(most: int) -> tuple[LiveTracker, NDArray[np.float64]]:
        monkeypatch.setattr(tracking, "OldOnDisk", lambda folder: OldOnDisk(folder, most))
        found = LiveTracker(DrawnCamera().open(), tmp_path)
        for index in range(12):
            found.take(drawn(index))
        return found, found.so_far().graph().T_world

    all_in_memory, expected = tracked(100)
    few, placed = tracked(1)
    np.testing.assert_array_equal(few.poses()[1], all_in_memory.poses()[1])
    np.testing.assert_array_equal(placed, expected)
    read = few._follower.maps._read
    assert isinstance(read, OldOnDisk) and len(read._memory) == 1 < len(read)
