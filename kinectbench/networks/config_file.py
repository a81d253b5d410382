"""A configuration as a YAML file: read with one line for every error, and written whole."""

from pathlib import Path

import yaml
from pydantic import ValidationError

from kinectbench.core.errors import SettingsError
from kinectbench.core.untrusted import printable, quoted, read_plain_text
from kinectbench.networks.config import MethodSettings
from kinectbench.settings import yaml_nodes
from kinectbench.settings.words import field_at, model_of, suggestion, wanted

# A configuration has some thirty keys.
MOST_BYTES = 1 << 20
# Of its errors; each line takes as long as all keys.
SHOWN = 20
FOLDER = Path(__file__).parent / "configs"
SUFFIX = ".yaml"


def packaged_configs() -> tuple[str, ...]:
    """Names of the configurations in the package, sorted."""
    return tuple(sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}")))


def find_config(name: str) -> MethodSettings:
    """A configuration by its name in the package, or by its path.

    Raises:
        SettingsError: there is none, or one line for each error in it.
    """
    if name in packaged_configs():
        return read_config(FOLDER / f"{name}{SUFFIX}")
    path = Path(name)
    if not path.is_file():
        shown = printable(name)
        raise SettingsError(
            f"{shown}: no such file, and no configuration of ours; {suggestion(name, packaged_configs())}"
        )
    return read_config(path)


def read_config(path: Path) -> MethodSettings:
    """Read and check a configuration.

    Raises:
        SettingsError: it cannot be read, or one line for each error: file and line, key, what is wanted.
    """
    try:
        text = read_plain_text(path, MOST_BYTES)
    except UnicodeDecodeError:
        raise SettingsError(f"{path}: not UTF-8 text; save the file as UTF-8") from None
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror or error}") from None
    root = yaml_nodes.compose(text, str(path))
    if not isinstance(root, yaml.MappingNode):
        raise SettingsError(f"{path}: no configuration; wanted lines like 'name: my-method'")
    values = yaml_nodes.plain(root)
    try:
        return MethodSettings.model_validate(values)
    except ValidationError as error:
        found = error.errors(include_url=False)
        lines = [_line(root, one) for one in found[:SHOWN]]
        if len(found) > SHOWN:
            lines.append(f"{path}: and {len(found) - SHOWN} more errors")
        raise SettingsError(*dict.fromkeys(lines)) from None


def _line(root: yaml.Node, error: object) -> str:
    """One of pydantic's errors in plain words."""
    assert isinstance(error, dict)
    location, kind = tuple(error["loc"]), error["type"]
    annotation, constraints, used = field_at(location, MethodSettings)
    where = yaml_nodes.place(yaml_nodes.find(root, location)[0])
    key = printable(".".join(str(part) for part in location))
    begin = f"{where}: {key}: " if key else f"{where}: "
    if kind == "extra_forbidden":
        inner = model_of(annotation)
        return (
            begin + f"unknown key; {suggestion(str(location[-1]), list(inner.model_fields) if inner else [])}"
        )
    if kind == "value_error":
        return begin + str(error["msg"]).removeprefix("Value error, ")
    if kind == "missing" and used == len(location):
        return begin + f"missing; wanted {wanted(annotation, constraints)}"
    return begin + f"found {quoted(error['input'])}; wanted {wanted(annotation, constraints)}"


def write_config(config: MethodSettings, path: Path) -> None:
    """Write a configuration with all its defaults; `read_config` gives it back."""
    text = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    path.write_text(text, encoding="utf-8")
