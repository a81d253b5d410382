"""The names of recordings, objects and categories: valid forms, and conflicts.

Names become folders beside files of this package, and keys of averages. All code checks them here.
"""

from collections.abc import Callable, Iterable
from typing import Annotated, NamedTuple

from pydantic import AfterValidator

from kinectbench.core.storage import name_problem

# The mean over all categories has these names in tables, scores.json and `compare`.
RESERVED = ("overall", "all")
# Largest number of names to list: more than a section has keys, but fewer than a thousand recordings.
LISTED = 40


def reserved_problem(category: str) -> str | None:
    """Return why a category's name is reserved for the mean over all categories; None if it is not."""
    if category.lower() in RESERVED:
        return f"'{category}' is what the mean over all categories is called; choose another"
    return None


def category_problem(category: str) -> str | None:
    """Return why a category cannot have this name, in a few words; None if the name is valid."""
    return name_problem(category) or reserved_problem(category)


def _checked(problem: Callable[[str], str | None]) -> AfterValidator:
    def check(value: str) -> str:
        """Return a valid name; raise ValueError for another."""
        if fault := problem(value):
            raise ValueError(fault)
        return value

    return AfterValidator(check)


# A name that a person gives to a recording, an object or a benchmark; and to a category.
Name = Annotated[str, _checked(name_problem)]
Category = Annotated[str, _checked(category_problem)]
# A category from an untrusted file; it never becomes a folder beside files of this package.
StoredCategory = Annotated[str, _checked(reserved_problem)]


class Named(NamedTuple):
    """The names of a recording, of its object and of its category."""

    recording: str
    object: str
    category: str


KINDS = ("recordings", "objects", "categories")


class Clash(NamedTuple):
    """Two conflicting names.

    Attributes:
        problem: the error message.
        row: index of the row with the second name.
        earlier: index of the row with the first name.
    """

    problem: str
    row: int
    earlier: int


def unlike(kind: str, name: str, other: str) -> str:
    """Return the error message for two names of a kind, such as "objects", that differ only by case."""
    return f"the {kind} '{other}' and '{name}' differ by case only: rename one of them"


def first_clash(rows: Iterable[Named]) -> Clash | None:
    """Find the first row whose names conflict with those of an earlier row; None if no row does.

    Names that differ only by case are one folder on some disks, and look like one thing in a table. An object
    in two categories would count in both averages.

    Args:
        rows: names in their order; names may repeat.
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


# Folders that commands write beside benchmark.yaml; they are no part of a recording in the same folder.
RESULTS = frozenset(
    {
        *("build", "benchmark", "benchmark-private", "predictions", "scores", "triage", "reproduce"),
        "evaluation",
    }
)


def listed(names: Iterable[str], at_most: int = LISTED) -> str:
    """Join at most `at_most` names by commas, followed by the number of the remaining names."""
    all_of = list(names)
    more = f" and {len(all_of) - at_most} more" if len(all_of) > at_most else ""
    return ", ".join(all_of[:at_most]) + more
