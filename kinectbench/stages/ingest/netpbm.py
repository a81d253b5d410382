"""Decode grey Netpbm images: PGM of whole numbers (netpbm.sourceforge.net), and PFM of floats (Debevec)."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import is_too_large
from kinectbench.stages.ingest.images import DamagedImageError, OddImageError

SUFFIXES = frozenset({".pgm", ".pfm"})
# The kind, width, height, and largest value (PGM) or scale (PFM), with comments between them.
BETWEEN = rb"(?:\s|#[^\r\n]*[\r\n])+"
HEAD = re.compile(
    rb"(P5|Pf)" + BETWEEN + rb"(\d{1,6})" + BETWEEN + rb"(\d{1,6})" + BETWEEN + rb"([-+.\deE]{1,20})\s"
)
# Bytes in which a head ends, comments included: chosen here.
HEAD_BYTES = 1024


def is_netpbm(data: bytes, name: str) -> bool:
    """Whether a file is a grey or colour Netpbm image, by its first bytes or its name."""
    return data.startswith((b"P5", b"Pf", b"PF", b"P2")) or Path(name).suffix.lower() in SUFFIXES


class NetpbmHead(NamedTuple):
    """What the head of an image says.

    Attributes:
        width: pixels.
        height: pixels.
        kind: type of a value, with its order of bytes.
        rows_up: whether the lowest row comes first, as in PFM.
        begin: byte at which the values begin.
    """

    width: int
    height: int
    kind: np.dtype[np.generic]
    rows_up: bool
    begin: int


def netpbm_head(data: bytes, name: str) -> NetpbmHead:
    """Read the head of a PGM or PFM; `name` is its source, for messages.

    Raises:
        DamagedImageError: the image is damaged, truncated or too large.
        OddImageError: it is a text, in colour or 8-bit.
    """
    if data.startswith((b"PF", b"P2")):
        kind = "in colour" if data.startswith(b"PF") else "a text"
        raise OddImageError(f"{name}: is {kind}: export depth as one channel of binary values", advice="")
    match = HEAD.match(data[:HEAD_BYTES])
    try:
        most = float(match[4]) if match else np.nan
    except ValueError:
        most = np.nan
    if match is None or not np.isfinite(most) or most == 0:
        raise DamagedImageError(f"{name}: the head of the image is damaged")
    width, height, is_pgm = int(match[2]), int(match[3]), match[1] == b"P5"
    if is_pgm and most < 256:
        raise OddImageError(
            f"{name}: depth is 8-bit: export the raw depth again, not a picture of it", advice=""
        )
    if is_too_large(width, height):
        raise DamagedImageError(f"{name}: {width}x{height} are more pixels than an image may have")
    value = np.dtype(">u2" if is_pgm else "<f4" if most < 0 else ">f4")
    if not width * height or len(data) - match.end() < width * height * value.itemsize:
        raise DamagedImageError(f"{name}: the image is empty or cut off")
    return NetpbmHead(width, height, value, not is_pgm, match.end())


def decode_netpbm(data: bytes, name: str) -> NDArray[np.generic]:
    """Decode a PGM or PFM: (height, width) uint16 or float32; raise errors as `netpbm_head` does."""
    head = netpbm_head(data, name)
    values = np.frombuffer(data, head.kind, head.width * head.height, head.begin)
    rows = values.reshape(head.height, head.width).astype(head.kind.newbyteorder("="))
    return rows[::-1] if head.rows_up else rows
