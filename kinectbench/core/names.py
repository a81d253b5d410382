"""The names of recordings, objects and categories: valid forms, and conflicts.

They name folders beside files of ours, and are keys of averages: all that reads or makes them asks here.
"""

from collections.abc import Callable, Iterable
from typing import Annotated, NamedTuple

from pydantic import AfterValidator

from kinectbench.core.storage import name_problem

# What tables, scores.json and `compare` call the mean over the categories.
RESERVED = ("overall", "all")


def reserved_problem(category: str) -> str | None:
    """Why averages could not name this category, in a few words; None if they can."""
    if category.lower() in RESERVED:
        return f"'{category}' is what the mean over all categories is called; choose another"
    return None


def category_problem(category: str) -> str | None:
    """Why a category cannot have this name, in a few words; None if it can."""
    return name_problem(category) or reserved_problem(category)


def _checked(problem: Callable[[str], str | None]) -> AfterValidator:
    def check(value: str) -> str:
        """The name itself; ValueError if it is none."""
        if fault := problem(value):
            raise ValueError(fault)
        return value

    return AfterValidator(check)


# What a person names a recording, an object or a benchmark; and a category.
Name = Annotated[str, _checked(name_problem)]
Category = Annotated[str, _checked(category_problem)]
# A category of an untrusted file: our files never lie beside it.
StoredCategory = Annotated[str, _checked(reserved_problem)]


class Named(NamedTuple):
    """The names of a recording."""

    recording: str
    object: str
    category: str


KINDS = ("recordings", "objects", "categories")


class Clash(NamedTuple):
    """Two conflicting names.

    Attributes:
        problem: in words.
        row: index of the one that has the second name.
        earlier: index of the first row that has the other.
    """

    problem: str
    row: int
    earlier: int


def unlike(kind: str, name: str, other: str) -> str:
    """The problem that two names of a kind, such as "objects", differ only by case, as text."""
    return f"the {kind} '{other}' and '{name}' differ by case only: rename one of them"


def first_clash(rows: Iterable[Named]) -> Clash | None:
    """The first row whose names contradict an earlier row; None if there is none.

    Recordings, objects and categories that differ by case only are one folder on some disks and one thing to
    whoever reads a table; and an object of two categories would count in both averages.

    Args:
        rows: in their order; the same names may come again.
    """
    spelled: dict[tuple[str, str], tuple[str, int]] = {}
    category_of: dict[str, tuple[str, int]] = {}
    for index, row in enumerate(rows):
        for kind, name in zip(KINDS, row, strict=True):
            other, earlier = spelled.setdefault((kind, name.lower()), (name, index))
            if other != name:
                return Clash(unlike(kind, name, other), index, earlier)
        other, earlier = category_of.setdefault(row.object, (row.category, index))
        if other != row.category:
            both = f"'{other}' and '{row.category}'"
            return Clash(
                f"object '{row.object}' is in two categories, {both}; it belongs to one", index, earlier
            )
    return None
