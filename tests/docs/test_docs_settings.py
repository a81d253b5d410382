"""The pages list every setting of `simulate` and `synthesize`, with its default's description."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run

from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.writers import OWN_FORMATS, formats
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.settings.base import Settings
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

DOCS = Path(__file__).resolve().parents[2] / "docs"


def keys(model: type[Settings], prefix: str = "") -> list[tuple[str, str]]:
    found = []
    for name, field in model.model_fields.items():
        if isinstance(field.default, Settings):
            found += keys(type(field.default), f"{name}.")
        else:
            found.append((f"{prefix}{name}", str(field.description)))
    return found


def test_help_and_page_name_every_format_of_simulate(command: Callable[..., Run], tmp_path: Path) -> None:
    shown = re.findall(r"\w+", command(tmp_path, "simulate", "--help").out)
    assert [name for name in OWN_FORMATS if name not in shown] == []
    lines = (DOCS / "simulation.md").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith("| `format` | `")]
    named = [name for name in re.findall(r"`(\w+)`", line) if name != "format"]
    assert named == list(formats())


@pytest.mark.parametrize(
    ("page", "model"), [("evidence/simulation.md", SimulationSpec), ("synthetic.md", SynthesisSettings)]
)
def test_every_setting_is_listed(page: str, model: type[Settings]) -> None:
    items = [" ".join(item.split()) for item in (DOCS / page).read_text().split("\n- ")]
    for key, description in keys(model):
        assert any(
            re.match(rf"`{re.escape(key)}`( \(\S+\))?: {re.escape(description)}", item) for item in items
        ), key


def test_the_example_of_included_files_is_read_as_the_page_says(tmp_path: Path) -> None:
    text = (DOCS / "format.md").read_text()
    section = text.split("### Recordings in other files")[1].split("\n## ")[0]
    blocks = re.findall(r"```(?:yaml)?\n(.*?)```", section, re.DOTALL)
    (tmp_path / "rooms").mkdir()
    for name, block in zip(("benchmark.yaml", "rooms/kitchen.yaml", "recordings.csv"), blocks, strict=True):
        (tmp_path / name).write_text(block)
        assert name == "benchmark.yaml" or f"`{name}`" in section
    stool, first, second = load_benchmark(tmp_path / "benchmark.yaml").recordings
    assert (stool.id, stool.path) == ("stool_01", "kitchen/stool_01")
    assert first.camera is not None and first.camera.fx == 525.0 and first.split == "train"
    assert (second.camera, second.plane_world) == (None, (0, 0, 1, -0.02))


def test_the_example_of_benchmark_yaml_has_every_key_of_a_recording(tmp_path: Path) -> None:
    text = (DOCS / "format.md").read_text().split("## benchmark.yaml")[1]
    (block,) = re.findall(r"```yaml\n(.*?)```", text.split("### ")[0], re.DOTALL)
    (tmp_path / "benchmark.yaml").write_text(block)
    (recording,) = load_benchmark(tmp_path / "benchmark.yaml").recordings
    unsaid = set(RecordingSettings.model_fields) - recording.model_fields_set
    assert unsaid == {"license", "source"}, "the two are said of the whole benchmark"
    assert "include" in BenchmarkSettings.model_fields
