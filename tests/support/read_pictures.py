"""Pictures as OpenCV reads them: a picture that it cannot read fails the test where it is read."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def read_picture(path: Path, flags: int = cv2.IMREAD_COLOR) -> NDArray[Any]:
    """Reads a picture file, BGR if it is coloured."""
    return decoded_picture(path.read_bytes(), flags)


def decoded_picture(data: bytes, flags: int = cv2.IMREAD_COLOR) -> NDArray[Any]:
    """Decodes the bytes of a picture file, BGR if it is coloured."""
    image: NDArray[Any] | None = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    assert image is not None, "OpenCV cannot read this picture"
    return image
