"""The pages list every setting of `simulate` and `synthesize`, with its default's description."""

import re
from pathlib import Path
from typing import get_args

import pytest

from kinectbench.commands_truth import FORMATS
from kinectbench.config import Settings
from kinectbench.simulate.spec import Format, SimulationSpec
from kinectbench.synthesize.settings import SynthesisSettings

DOCS = Path(__file__).resolve().parents[1] / "docs"


def keys(model: type[Settings], prefix: str = "") -> list[tuple[str, str]]:
    found = []
    for name, field in model.model_fields.items():
        if isinstance(field.default, Settings):
            found += keys(type(field.default), f"{name}.")
        else:
            found.append((f"{prefix}{name}", str(field.description)))
    return found


def test_help_and_page_name_every_format_of_simulate() -> None:
    assert get_args(Format) == FORMATS
    lines = (DOCS / "simulation.md").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith("| `format` | `")]
    assert tuple(name for name in re.findall(r"`(\w+)`", line) if name != "format") == FORMATS


@pytest.mark.parametrize(
    ("page", "model"), [("simulation.md", SimulationSpec), ("synthetic.md", SynthesisSettings)]
)
def test_every_setting_is_listed(page: str, model: type[Settings]) -> None:
    lines = (DOCS / page).read_text().splitlines()
    for key, description in keys(model):
        assert any(
            line.startswith(f"| `{key}` |") and line.endswith(f"| {description} |") for line in lines
        ), key
