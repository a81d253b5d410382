"""The pixel that the user clicked as the object: in a file beside the recording, or in benchmark.yaml."""

from typing import Annotated

from pydantic import Field

from kinectbench.core import MOST_SIDE_PX
from kinectbench.settings.base import Settings

# File beside a recording, with the point that was clicked while recording.
PICK_FILE = "pick.json"
# Limit in bytes; the file has 40. A much larger file is from another program.
PICK_BYTES = 10_000
# A column or row of an image.
Place = Annotated[int, Field(ge=0, lt=MOST_SIDE_PX)]


class PickSettings(Settings):
    """A depth pixel of a frame that shows the object; `record` writes the one that was clicked."""

    frame: int = Field(
        ge=0, description="its index among the recording's depth frames, from 0; damaged ones count"
    )
    pixel: Annotated[tuple[Place, Place], Field(strict=False)] = Field(
        description="column and row of the pixel, from 0"
    )
