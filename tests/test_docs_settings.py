"""The pages list every setting of `simulate` and `synthesize`, with its default's description."""

from pathlib import Path

import pytest

from kinectbench.config import Settings
from kinectbench.simulate.spec import SimulationSpec
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


@pytest.mark.parametrize(
    ("page", "model"), [("simulation.md", SimulationSpec), ("synthetic.md", SynthesisSettings)]
)
def test_every_setting_is_listed(page: str, model: type[Settings]) -> None:
    lines = (DOCS / page).read_text().splitlines()
    for key, description in keys(model):
        assert any(
            line.startswith(f"| `{key}` |") and line.endswith(f"| {description} |") for line in lines
        ), key
