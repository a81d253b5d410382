"""Read a configuration from a YAML file, with one line for every error; write one completely."""

from pathlib import Path

import yaml

from kinectbench.core import SettingsError, printable
from kinectbench.networks.config import MethodSettings
from kinectbench.settings.words import suggestion
from kinectbench.settings.yaml_model import read_model

FOLDER = Path(__file__).parent / "configs"
SUFFIX = ".yaml"


def packaged_configs() -> tuple[str, ...]:
    """Return the names of the configurations in the package, sorted."""
    return tuple(sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}")))


def find_config(name: str) -> MethodSettings:
    """Read a configuration by its name in the package, or by its path.

    Raises:
        SettingsError: there is no such configuration, or two have this name; or one line for each error in
            it.
    """
    path = Path(name)
    if name in packaged_configs():
        if path.is_file():
            raise SettingsError(f"{name}: of the package, and a file here; for that write ./{name}")
        return read_config(FOLDER / f"{name}{SUFFIX}")
    if not path.is_file():
        shown = printable(name)
        raise SettingsError(
            f"{shown}: no such file, and no configuration of ours; {suggestion(name, packaged_configs())}"
        )
    return read_config(path)


def read_config(path: Path) -> MethodSettings:
    """Read and check a configuration.

    Raises:
        SettingsError: the file cannot be read, or one line for each error: file and line, key, what is
            allowed.
    """
    return read_model(path, MethodSettings, "name: my-method")


def write_config(config: MethodSettings, path: Path) -> None:
    """Write a configuration with all defaults; `read_config` reads it back, also in older versions."""
    values = config.model_dump(mode="json")
    if config.training.category is None:
        del values["training"]["category"]
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    path.write_text(text, encoding="utf-8")
