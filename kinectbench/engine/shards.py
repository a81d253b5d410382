"""Parts of a benchmark for batch systems: which recordings the third of forty runs works on."""

import re
from dataclasses import dataclass

from kinectbench.core.errors import SettingsError
from kinectbench.core.storage import sha256_text

# Array jobs of batch systems have some thousands of tasks at most; this only bounds what is read.
MOST_SHARDS = 10**6
WANTED = f"give I/N, such as 3/40 for the third of 40 parts, with I from 1 to N, and N at most {MOST_SHARDS}"


@dataclass(frozen=True)
class Shard:
    """One of several disjoint parts that together are all recordings.

    Which part a recording belongs to depends on its id alone: it stays there when others come or go. Parts
    have about as many recordings each; one may have none.

    Attributes:
        number: from 1 to `of`.
        of: how many parts there are.
    """

    number: int
    of: int

    def holds(self, recording: str) -> bool:
        """Whether the recording of this id belongs to this part."""
        return int(sha256_text(recording)[:16], 16) % self.of == self.number - 1

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


def parse_shard(text: str) -> Shard:
    """The part that `I/N` names.

    Raises:
        SettingsError: the text is something else, or there is no such part.
    """
    match = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text, re.ASCII)
    number, of = map(int, match.groups()) if match else (0, 0)
    if not 1 <= number <= of <= MOST_SHARDS:
        raise SettingsError(f"--shard {text}: {WANTED}")
    return Shard(number, of)
