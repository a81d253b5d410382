"""What the object is, where somebody picked it: beside the recording, and in benchmark.yaml."""

from typing import Annotated

from pydantic import Field

from kinectbench.core.untrusted import MOST_SIDE_PX
from kinectbench.settings.base import Settings

# Beside a recording's own files: what was clicked while it was recorded.
PICK_FILE = "pick.json"
# It has 40; what is much larger is another program's.
PICK_BYTES = 10_000
# A column or a row of a picture.
Place = Annotated[int, Field(ge=0, lt=MOST_SIDE_PX)]


class PickSettings(Settings):
    """A pixel of a frame's depth that shows the object; `record` writes it where it is clicked."""

    frame: int = Field(
        ge=0, description="its place among the recording's depth frames, from 0; damaged ones count"
    )
    pixel: Annotated[tuple[Place, Place], Field(strict=False)] = Field(description="column and row, from 0")
