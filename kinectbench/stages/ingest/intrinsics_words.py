"""Intrinsics in texts of other programs: a value behind each name, or OpenCV's matrix in XML."""

import re
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

from kinectbench.core import IntrinsicsError, RecordingError
from kinectbench.core.trajectory.text_rows import parse_floats
from kinectbench.stages.ingest.intrinsics import NEEDED, SAME_AS, Intrinsics, of_matrix_numbers

# Names as librealsense's rs-enumerate-devices (Fx:, PPX:) and many scripts (fx = ) print them.
NAMED_VALUE = re.compile(
    r"(?<![\w.])(fx|fy|cx|cy|ppx|ppy|width|height)[\"']?[ \t]*[:=][ \t]*([-+.\deE]{1,30})", re.IGNORECASE
)
# As librealsense's Python prints them: [ 640x480  p[cx cy]  f[fx fy]  Inverse Brown Conrady [0 0 0 0 0] ].
PRINTED = re.compile(
    r"(\d{1,5})x(\d{1,5})\s+p\[(\S{1,30}) (\S{1,30})\]\s+f\[(\S{1,30}) (\S{1,30})\]"
    r"(?:[^\[\]\n]{0,60}(\[[^\[\]\n]{0,200}\]))?"
)
PRINTED_KEYS = ("width", "height", "cx", "cy", "fx", "fy")
# Distortion: librealsense's last bracket, rs-enumerate-devices' Coeffs:, and k1, p1 and so on by name.
DISTORTION = re.compile(
    r"(?<![\w.])(?:coeffs|distortion|dist_coeffs|[kp]\d)[\"']?[ \t]*[:=]([-+.\deE,;\[\] \t]{1,300})",
    re.IGNORECASE,
)
NOT_ZERO = re.compile(r"(?<![\w.])[-+]?[\d.]*[1-9]")
COMMENT = re.compile(r"#[^\r\n]*")
# A matrix as OpenCV's FileStorage writes it in XML; the bounds keep the search short in any text.
XML_MATRIX = re.compile(
    r"<(camera_?matrix|K|M1|intrinsics?|intrinsic_matrix)\b[^>]{0,200}>.{0,400}?<data>([^<]{1,2000})</data>",
    re.IGNORECASE | re.DOTALL,
)


def intrinsics_in_words(text: str, file: Path) -> Intrinsics | None:
    """Read the pinhole camera from a text with fx, fy, cx and cy by name; None if one is missing.

    Comments, from # to the end of the line, are not read. A note tells of distortion.

    Raises:
        RecordingError: a name has two values, as of two cameras, or a size is not a number of pixels.
    """
    values: dict[str, Any] = {}
    text = COMMENT.sub("", text)
    prints = PRINTED.findall(text)
    printed = (zip(PRINTED_KEYS, words[:-1], strict=True) for words in prints)
    for said, word in chain(NAMED_VALUE.findall(text), *printed):
        key, number = SAME_AS.get(said.lower(), said.lower()), None
        with suppress(RecordingError):
            number = parse_floats([word], "")[0]
        if number is not None and values.setdefault(key, number) != number:
            raise IntrinsicsError(
                f"{file}: holds '{key}' more than once, with other numbers: which camera is that of depth? "
                "Give its fx, fy, cx, cy under `camera:`"
            )
    if not all(key in values for key in NEEDED):
        return None
    for key in ("width", "height"):
        if key in values:
            if not (values[key] > 0 and values[key].is_integer()):
                raise IntrinsicsError(f"{file}: '{key}:' is not a number of pixels; correct it")
            values[key] = int(values[key])
    coefficients = (*(words[-1] for words in prints), *DISTORTION.findall(text))
    distorted = any(NOT_ZERO.search(words) for words in coefficients)
    return Intrinsics(**values, notes=distortion_notes(file, distorted=distorted))


def distortion_notes(file: Path, *, distorted: bool) -> tuple[str, ...]:
    """Return the warning that a file states distortion, which is not taken away; () if it states none."""
    note = f"{file}: its distortion is not taken away; if depth is not rectified, undistort it first"
    return (note,) if distorted else ()


def intrinsics_in_xml(text: str, file: Path) -> Intrinsics | None:
    """Read the first pinhole matrix from OpenCV's XML; None if there is none.

    Raises:
        RecordingError: the matrix is no pinhole matrix.
    """
    for _, words in XML_MATRIX.findall(text):
        matrix = of_matrix_numbers(parse_floats(words.split(), str(file)), file)
        if matrix is not None:
            return matrix
    return None
