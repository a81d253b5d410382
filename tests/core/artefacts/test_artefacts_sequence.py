"""camera.json and frames.json come back as written; older ones are read, and damage is named in one line."""

import json
from pathlib import Path

from raising import raises

from kinectbench.core.artefacts.sequence import CameraFile, FrameRow, FramesFile
from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import Camera

HEAD = {"format_version": 1, "width": 640, "height": 480, "fx": 525.0, "fy": 524.0, "cx": 319.5, "cy": 239.5}
HEAD |= {"depth_scale": 5000.0, "color_registered": True}


def test_camera_json_of_an_earlier_version_is_read_and_written_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text(json.dumps(HEAD))
    head = CameraFile.read(tmp_path)
    assert head.camera == Camera(640, 480, 525.0, 524.0, 319.5, 239.5)
    assert (head.registered_by, head.frames, head.warnings) == (None, None, ())
    assert CameraFile.parse(head.text(), "again") == head


def test_frames_json_is_a_list_of_rows(tmp_path: Path) -> None:
    rows = tuple(
        FrameRow(index=i, recorded=2 * i, stamp_ns=10 * i, depth=f"depth/{i}.kbd", color=None, mask=None)
        for i in range(3)
    )
    FramesFile(rows=rows).write(tmp_path)
    listed = json.loads((tmp_path / "frames.json").read_text())
    images = {"depth": "depth/1.kbd", "color": None, "mask": None}
    assert listed[1] == {"index": 1, "recorded": 2, "stamp_ns": 10, **images}
    again = FramesFile.read(tmp_path)
    assert again.rows == rows
    assert again.stamps_ns.tolist() == [0, 10, 20] and again.recorded == (0, 2, 4)
    for row in listed:
        del row["recorded"]  # as version 12 of `ingest` wrote it
    (tmp_path / "frames.json").write_text(json.dumps(listed))
    assert FramesFile.read(tmp_path).recorded == (0, 1, 2)
    (tmp_path / "frames.json").write_text('[{"index": 0, "stamp_ns": "0", "depth": "a", "color": null}]')
    with raises(StorageError, "storage.damaged", match=r"frames\.json: '0\.stamp_ns'"):
        FramesFile.read(tmp_path)
