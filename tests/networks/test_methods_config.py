"""Configurations: those of the package, and one line for everything that is wrong in somebody's own."""

from collections.abc import Callable
from pathlib import Path

import pytest
from raising import raises

from kinectbench.core.errors import SettingsError
from kinectbench.networks.config import (
    AdversarialSettings,
    MethodSettings,
    NetworkSettings,
    find_config,
    packaged_configs,
    read_config,
    write_config,
)

Tiny = Callable[..., Path]


def test_the_package_has_the_papers_methods() -> None:
    assert set(packaged_configs()) == {
        *("3d-recgan++-code", "3d-recgan++-paper", "3d-recae", "3d-epn", "varley", "han-like", "recae-small")
    }


@pytest.mark.parametrize("name", packaged_configs())
def test_a_packaged_configuration_is_called_as_its_file(name: str, tmp_path: Path) -> None:
    config = find_config(name)
    assert config.name == name
    write_config(config, tmp_path / "written.yaml")
    assert read_config(tmp_path / "written.yaml") == config


def test_both_readings_of_beta_are_there() -> None:
    """The paper weighs the reconstruction by 0.2, its code by 80 of 100."""
    paper, code = (find_config(f"3d-recgan++-{name}").adversarial for name in ("paper", "code"))
    assert paper is not None and code is not None
    assert (paper.beta, paper.loss_scale, paper.epsilon) == (0.2, 1.0, "sample")
    assert (code.beta, code.loss_scale, code.epsilon) == (0.8, 100.0, "voxel")


WRONG = {
    "a key": (("batch: 2", "bacth: 2"), r"tiny.yaml:4: training.bacth: unknown key; did you mean 'batch'"),
    "a value": (
        ("batch: 2", "batch: 0"),
        r"tiny.yaml:4: training.batch: found 0; wanted a whole number from 1",
    ),
    "a network": (("3d-recae", "unet"), r"tiny.yaml:2: network.kind: found 'unet'; wanted one of 3d-recgan"),
    "a name": (("name: tiny", "name: a/b"), r"tiny.yaml:1: name: use letters"),
    "a discriminator": (("3d-recae", "3d-recgan++"), r"tiny.yaml:1: adversarial belongs to 3d-recgan"),
    "a side": (("3d-recae", "varley"), r"tiny.yaml:2: network: output_cells cannot be chosen for varley"),
    "weights": (
        ("3d-recae, channel_divisor: 32, output_cells: 64", "varley, initial_weights: he"),
        r"tiny.yaml:2: network: initial_weights cannot be chosen for varley",
    ),
    "an object": (
        ("batch: 2", "batch: 2, leave_out: chair"),
        r"tiny.yaml:4: training.leave_out: found 'chair'; wanted a list, each entry text",
    ),
    "no class": (
        ("3d-recae, channel_divisor: 32, output_cells: 64", "own"),
        r"tiny.yaml:2: network: class_path belongs to kind: own, and own needs it",
    ),
    "a class of another": (("3d-recae,", "3d-recae, class_path: 'a:B',"), r"class_path belongs to kind: own"),
    "no path": (
        ("3d-recae, channel_divisor: 32, output_cells: 64", "own, class_path: nets.py"),
        r"tiny.yaml:2: network: class_path must be like package.module:Class",
    ),
    "missing": (("name: tiny\n", ""), r"tiny.yaml:1: name: missing; wanted text"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_with_its_line(tiny: Tiny, name: str) -> None:
    replaced, words = WRONG[name]
    with pytest.raises(SettingsError, match=words) as error:
        read_config(tiny(replaced))
    assert len(error.value.lines) == 1


@pytest.mark.parametrize("content", [b"", b"- a\n", b"\xff\xfe", b"a: [", b"name: &a [*a]\n"])
def test_what_is_no_configuration_is_told(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "mine.yaml"
    path.write_bytes(content)
    with pytest.raises(SettingsError, match=r"mine\.yaml") as error:
        read_config(path)
    assert len(error.value.lines) == 1


def test_a_configuration_that_is_not_there_is_told() -> None:
    with raises(SettingsError, "settings.wrong-value", match="3d-epn"):
        find_config("nowhere")
    with raises(SettingsError, "settings.wrong-value", match="'recae-small'"):
        find_config("recae-smal")


def test_of_very_many_errors_some_are_shown(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("name: a\n" + "".join(f"k{number}: 1\n" for number in range(5000)))
    with pytest.raises(SettingsError) as error:
        read_config(path)
    assert len(error.value.lines) == 21 and error.value.lines[-1].endswith("and 4981 more errors")


def test_numbers_to_choose_from_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("name: a\nnetwork: {kind: 3d-recae, output_cells: 1.0e+99}\n")
    with raises(SettingsError, "settings.wrong-value", match=r"1e\+99.*64.*256"):
        read_config(path)


def test_the_documentation_shows_every_key_with_its_default(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "methods.md").read_text(encoding="utf-8")
    shown = text.partition("```yaml\n")[2].partition("```")[0]
    path = tmp_path / "shown.yaml"
    path.write_text(shown, encoding="utf-8")
    assert read_config(path) == MethodSettings(name="my-recae", network=NetworkSettings(kind="3d-recae"))
    every = shown.replace("# adversarial:", "adversarial:").replace("#   ", "  ")
    path.write_text(every.replace("kind: 3d-recae", "kind: 3d-recgan++"), encoding="utf-8")
    gan = read_config(path)
    assert gan.adversarial == AdversarialSettings(beta=0.8)
    keys = {key for part in gan.model_dump().values() if isinstance(part, dict) for key in part}
    assert all(f" {key}: " in every for key in keys)
