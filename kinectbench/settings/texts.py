"""Texts of people that a release repeats: in its card, its licence and its pages, before strangers."""

import re
from typing import Annotated

from pydantic import AfterValidator

# Control characters but for tab and line feed, separators of lines, and what turns the direction of writing.
_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def _steers_nothing(value: str) -> str:
    if _STEERING.search(value):
        raise ValueError("it holds control characters; leave them out")
    return value


def _one_line(value: str) -> str:
    return " ".join(_steers_nothing(value).split())


Text = Annotated[str, AfterValidator(_steers_nothing)]
# What breaks a line becomes a space.
Line = Annotated[str, AfterValidator(_one_line)]
