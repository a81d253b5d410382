"""Load plug-ins of the simulator: families of objects, and formats of recordings."""

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import TypeVar

from kinectbench.core import SettingsError, printable

Kind = TypeVar("Kind")


def plugins(group: str, kind: type[Kind], own: Mapping[str, Kind]) -> dict[str, Kind]:
    """Return this package's entries of a group, and the entries of other installed packages.

    Each entry point of the group is a mapping from names to instances of `kind`. To add one, write in the
    `pyproject.toml` of your own package:

        [project.entry-points."kinectbench.families"]
        mine = "my_package:FAMILIES"

    Args:
        group: group of entry points: "kinectbench.families" or "kinectbench.formats".
        kind: the class of each value.
        own: the entries of this package.

    Returns:
        {name: value}: `own`, then those of other packages in the order of their entry points' names.

    Raises:
        SettingsError: an entry point cannot be imported, is not such a mapping, or repeats a name.
    """
    by_name = dict(own)
    for point in sorted(entry_points(group=group), key=lambda point: (point.name, point.value)):
        where = f"plug-in '{point.name}' of {group} ({point.value})"
        try:
            given = point.load()
        except (Exception, SystemExit) as error:  # a module runs as it is imported
            why = printable(f"{type(error).__name__}: {error}")
            raise SettingsError(
                f"{where}: cannot be imported ({why}); mend or uninstall it", what="bad-plugin"
            ) from error
        if not isinstance(given, Mapping) or not all(isinstance(value, kind) for value in given.values()):
            raise SettingsError(
                f"{where}: is no mapping from names to {kind.__name__}; mend or uninstall it",
                what="bad-plugin",
            )
        if twice := sorted(by_name.keys() & given.keys()):
            raise SettingsError(
                f"{where}: '{twice[0]}' is there already; rename it, or uninstall this plug-in",
                what="bad-plugin",
            )
        by_name.update(given)
    return by_name
