"""A box put into the file that a recording stands in: an included one, but no table."""

from pathlib import Path

import pytest
from test_benchmark_edit import BOX, LINE

from kinectbench.core.errors import SettingsError
from kinectbench.settings.edit import file_of, with_box

FILES = {
    "benchmark.yaml": "name: n\ninclude: [a.yaml, t.csv]\nrecordings: [{id: own, path: x, category: c}]\n",
    "a.yaml": "recordings:\n  # mine\n  - id: a\n    path: y\n    category: c\n",
    "t.csv": "id,path,category\nt,z,c\n",
}


def test_a_box_goes_to_the_file_that_the_recording_stands_in(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    config = tmp_path / "benchmark.yaml"
    assert file_of(config, "own", BOX) == config
    path = file_of(config, "a", BOX)
    assert path == tmp_path / "a.yaml"
    changed = with_box(path.read_text(), str(path), "a", BOX)
    assert changed == FILES["a.yaml"].replace("  - id: a\n", f"  - id: a\n    {LINE}\n")
    with pytest.raises(SettingsError) as caught:
        file_of(config, "t", BOX)
    assert str(caught.value) == (
        f"{tmp_path}/t.csv:2: tables are not changed; fill in its cells: box.center_m [0.1, -0.2, 0.3], "
        "box.size_m [0.5, 0.6, 0.7], box.yaw_rad -0.25"
    )
