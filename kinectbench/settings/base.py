"""Base of all settings, and types of texts that users write in them, which a release publishes."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict

from kinectbench.core import STEERING
from kinectbench.core.untrusted_text import MOST_TEXT


class Settings(BaseModel):
    """Base of all settings: immutable, strictly typed, no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def _steers_nothing(value: str) -> str:
    if len(value) > MOST_TEXT:
        raise ValueError(f"it has {len(value)} characters; at most {MOST_TEXT} are read")
    if STEERING.search(value):
        raise ValueError("it holds control characters; leave them out")
    return value


def _one_line(value: str) -> str:
    return " ".join(_steers_nothing(value).split())


Text = Annotated[str, AfterValidator(_steers_nothing)]
# A text in which line breaks become spaces.
Line = Annotated[str, AfterValidator(_one_line)]
