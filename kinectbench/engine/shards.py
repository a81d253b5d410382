"""Divide a benchmark's recordings into parts, for the tasks of batch systems."""

import re
from dataclasses import dataclass

from kinectbench.core import SettingsError, sha256_text

# Largest number of parts. Array jobs of batch systems have at most some thousands of tasks.
MOST_SHARDS = 10**6
WANTED = f"give I/N, such as 3/40 for the third of 40 parts, with I from 1 to N, and N at most {MOST_SHARDS}"


@dataclass(frozen=True)
class Shard:
    """One of several disjoint parts that together contain all recordings.

    The part of a recording depends on its id alone, so it does not change if others are added or removed. The
    parts have about the same size; a part may be empty.

    Attributes:
        number: number of the part, from 1 to `of`.
        of: number of parts.
    """

    number: int
    of: int

    def holds(self, recording: str) -> bool:
        """Whether this part contains the recording with this id."""
        return int(sha256_text(recording)[:16], 16) % self.of == self.number - 1

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


def parse_shard(text: str) -> Shard:
    """Parse a part given as `I/N`.

    Raises:
        SettingsError: the text has another form, or I is not in 1 to N.
    """
    match = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text, re.ASCII)
    number, of = map(int, match.groups()) if match else (0, 0)
    if not 1 <= number <= of <= MOST_SHARDS:
        raise SettingsError(f"--shard {text}: {WANTED}")
    return Shard(number, of)
