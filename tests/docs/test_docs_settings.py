"""The pages list every setting of `simulate` and `synthesize`, with its default's description."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest
from small_benchmark import Run

from kinectbench.lab.simulate import Format
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.settings.models import Settings

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
    formats = get_args(Format)
    shown = re.findall(r"\w+", command(tmp_path, "simulate", "--help").out)
    assert [name for name in formats if name not in shown] == []
    lines = (DOCS / "simulation.md").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith("| `format` | `")]
    assert tuple(name for name in re.findall(r"`(\w+)`", line) if name != "format") == formats


@pytest.mark.parametrize(
    ("page", "model"), [("simulation.md", SimulationSpec), ("synthetic.md", SynthesisSettings)]
)
def test_every_setting_is_listed(page: str, model: type[Settings]) -> None:
    lines = (DOCS / page).read_text().splitlines()
    for key, description in keys(model):
        assert any(
            line.startswith(f"| `{key}` |") and line.endswith(f"| {description} |") for line in lines
        ), key
