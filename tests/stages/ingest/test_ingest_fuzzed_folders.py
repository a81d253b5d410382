"""Folders of every format with bytes of one file changed are read, or refused in one line."""

import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ingest_writers import CAMERA, every_frame, write_folder, write_seven_scenes, write_tum
from test_ingest_phones_bop import bop, scanner_app, stray
from test_ingest_scene_folders import scannet, sun3d
from test_ingest_transforms import polycam, transforms
from test_ingest_wildrgbd import wildrgbd

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import format_of, open_recording

MAKERS: dict[str, Callable[[Path], Path]] = {
    "tum": write_tum,
    "7scenes": write_seven_scenes,
    "folder": write_folder,
    "stray": lambda folder: stray(folder, video=False),
    "scanner_app": scanner_app,
    "bop": bop,
    "wildrgbd": wildrgbd,
    "nerfstudio": transforms,
    "polycam": polycam,
    "scannet": scannet,
    "sun3d": sun3d,
}
# Text that is no number, numbers that are none or too large, and other ends of lines and of JSON.
WORDS = (b"-inf", b"nan", b"1e999", b"9" * 40, b"null", b"[" * 50, b"{}", b"\n\n", b",", b'"', b"-1")
PATCHES = (b"\xff" * 8, b"\x00" * 4, *WORDS)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("whole")
    for name, make in MAKERS.items():
        make(root / name)
        assert format_of(root / name) == name
    return root


@pytest.mark.parametrize("name", MAKERS)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_fuzzed_folders_neither_crash_nor_allocate(
    tmp_path: Path, whole: Path, name: str, data: st.DataObject
) -> None:
    folder = tmp_path / "fuzzed"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(whole / name, folder)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    texts = [path for path in files if path.suffix not in (".png", ".jpg")]
    among_texts = bool(texts) and data.draw(st.booleans())
    path = data.draw(st.sampled_from(texts if among_texts else files))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        # Headers of images are in front.
        at = data.draw(st.integers(0, min(len(content), 40) if path not in texts else len(content)))
        patch = data.draw(st.one_of(st.sampled_from(PATCHES), st.binary(min_size=1, max_size=4)))
        content[at : at + len(patch) * data.draw(st.integers(0, 1))] = patch
    path.write_bytes(content)
    if format_of(folder) is None:
        return
    # A folder holds some 50 KB. The first reading of its kind may load modules, the second does not.
    assert min(peak_of_reading(folder, name), peak_of_reading(folder, name)) < 8 << 20


def peak_of_reading(folder: Path, name: str) -> int:
    """The most bytes at once while a folder is read, which may be refused in one line."""
    tracemalloc.start()
    try:
        recording = open_recording(folder, CameraSettings(**CAMERA) if name == "7scenes" else None)
        for frame in every_frame(recording):
            assert isinstance(frame, DamagedImageError) or frame.depth.dtype == np.uint16
    except RecordingError as error:
        assert "\n" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return peak


@pytest.mark.parametrize("side", [20_000, 60_000])
def test_an_image_that_says_it_is_huge_is_damaged(tmp_path: Path, side: int) -> None:
    folder = write_tum(tmp_path / "r")
    data = bytearray((folder / "depth/1.png").read_bytes())
    data[16:24] = side.to_bytes(4, "big") * 2
    (folder / "depth/1.png").write_bytes(data)
    tracemalloc.start()
    frames = list(every_frame(open_recording(folder)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert isinstance(frames[1], DamagedImageError) and peak < 8 << 20
