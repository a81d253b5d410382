"""What a case is: a stranger's input, a command line, and how the command may end."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import cycle, islice
from pathlib import Path

MOST_MB = 500.0
# Locales without UTF-8, also where Python would take UTF-8 all the same.
POSIX = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
# Root reads everything but for these words before a command.
NOT_ROOT = "setpriv --inh-caps=-all --bounding-set=-dac_override,-dac_read_search"


def nothing(folder: Path) -> None:
    """An input that is whole."""
    del folder


@dataclass(frozen=True)
class Case:
    """One hostile input and the command that is given it.

    Attributes:
        group: the class of faults that it belongs to.
        name: in words, unique with the command.
        command: the words after `kinectbench`; `load RELEASE` reads every pair by `kinectbench.load`.
        make: writes the input into the folder in which the command runs.
        whole: what is copied there before: `release`, `built`, a format of recordings, or nothing.
        statuses: those with which it may end.
        says: a part of what it must print.
        errors: the most lines of errors; `verify` and `check` name everything that is wrong.
        most_mb: the memory that it may take, MB.
        before: words in front of the command, such as other limits.
        variables: of the environment.
        most_idle_s: by the clock, in which it may do nothing: commands wait for servers, if not for ever.
    """

    group: str
    name: str
    command: str
    make: Callable[[Path], object] = nothing
    whole: str = ""
    statuses: tuple[int, ...] = (1,)
    says: str = ""
    errors: int = 1
    most_mb: float = MOST_MB
    before: str = ""
    variables: Mapping[str, str] = field(default_factory=dict)
    most_idle_s: float = 10.0


def on(commands: str, *cases: Case) -> list[Case]:
    """The same inputs for several commands, which `commands` has in lines."""
    return [replace(case, command=line) for case in cases for line in commands.splitlines()]


def in_turn(commands: str, *cases: Case, others: int = 1) -> list[Case]:
    """Each input for the first command, and for so many of the others, which take turns."""
    first, *rest = commands.splitlines()
    turns = cycle(rest)
    return [replace(case, command=line) for case in cases for line in (first, *islice(turns, others))]
