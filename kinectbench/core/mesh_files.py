"""Read untrusted .obj and .ply meshes in time and memory proportional to the file's size.

Only the lines of vertices and faces of an .obj are read, and only `x`, `y`, `z` and the corner lists of faces
of a .ply. Materials, groups, textures and colours do not determine a shape, and libraries that read them need
quadratic time. Sources: Wavefront, "Advanced Visualizer", appendix B1; G. Turk, "The PLY Polygon File
Format", 1994.
"""

import re
import warnings
from array import array
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.untrusted import printable

# The surface of the largest grid has some 400,000 cell faces (6 sides of 256^2), with two triangles each.
MAX_VERTICES = MAX_TRIANGLES = 1 << 20
# A cloud of `MAX_POINTS`, as RaySt3R writes it, has 113 MB.
MAX_FILE_BYTES = 128 << 20
# Points of a cloud: 22 views that RaySt3R predicts of an object with 190,000 pixels.
MAX_POINTS = 1 << 22
# Corners of a polygon: enough for the end of a finely divided cylinder.
MAX_CORNERS = 1024
# Numbers in a text .ply: a closed surface of `MAX_TRIANGLES` has 9.4 million with normals and colours.
MAX_NUMBERS = 12 << 20
PIECE_BYTES = 1 << 20
MAX_HEADER_BYTES = 64 << 10
MAX_PROPERTIES = 100
# Lists and properties of a face: corners, texture coordinates and some numbers. Rows with lists of different
# lengths are read one by one: a million rows take 2 s for each list (measured).
MAX_LISTS, MAX_OF_FACE = 2, 16
# Rows of a .ply that are processed together: some 10 MB.
ROWS = 1 << 16

_SHORT = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_LONG = {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
TYPES = {**_SHORT, **_LONG, "float": "f4", "float32": "f4", "double": "f8", "float64": "f8"}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
OBJ_LINES = re.compile(rb"^[ \t]*[vf][ \t][^\n]*", re.MULTILINE)
SPACE = re.compile(rb"\s")
CORNER_LISTS = ("vertex_index", "vertex_indices")

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]
Normals = NDArray[np.float64] | None


def read_obj(content: bytes) -> Triangles:
    """Read the vertices (n, 3) and triangles (m, 3) of an .obj; polygons become fans of triangles.

    Raises:
        ValueError: a line of a vertex or face is malformed, a face names a missing vertex, or there are too
            many vertices or triangles.
    """
    coordinates, corners = array("d"), array("q")
    # A backslash at the end of a line continues it in the next line.
    text = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\r", b"\n")
    for number, line in enumerate(OBJ_LINES.finditer(text)):
        words = line[0].split(None, MAX_CORNERS + 1)
        try:
            if words[0] == b"v":
                x, y, z = map(float, words[1:4])
                coordinates.extend((x, y, z))
            else:
                polygon = [_corner(word, len(coordinates) // 3) for word in words[1 : MAX_CORNERS + 1]]
                for second, third in pairwise(polygon[1:]):
                    corners.extend((polygon[0], second, third))
        except (ValueError, OverflowError):
            raise ValueError(f"the line '{printable(line[0].decode('latin-1'), 40)}'") from None
        if words[0] == b"f" and len(words) > MAX_CORNERS + 1:
            raise ValueError(f"a polygon of more than {MAX_CORNERS} corners; cut it into triangles")
        _refuse_many(number, "lines", MAX_VERTICES + MAX_TRIANGLES)
        _refuse_many(len(coordinates) // 3, "vertices", MAX_VERTICES)
        _refuse_many(len(corners) // 3, "triangles", MAX_TRIANGLES)
    return _checked(np.array(coordinates).reshape(-1, 3), np.array(corners, np.int64).reshape(-1, 3))


def _corner(word: bytes, vertices: int) -> int:
    """Return the 0-based vertex index of a corner such as `7`, `7/2/1`, or `-1` (the last vertex so far)."""
    index = int(word.partition(b"/")[0])
    return index - 1 if index > 0 else vertices + index if index < 0 else -1


def read_ply(content: bytes) -> Triangles:
    """Read the vertices (n, 3) and triangles (m, 3) of a .ply, text or binary; polygons become fans.

    Raises:
        ValueError: the header is malformed or claims more than the file holds, no faces follow the vertices,
            lists stand before the faces, a face names a missing vertex, or there are too many vertices or
            triangles.
    """
    vertices, triangles, _ = _read_ply(content, MAX_VERTICES)
    if triangles is None:
        raise ValueError("no faces after its vertices; an empty prediction is a grid of zeros")
    return _checked(vertices, triangles)


def read_ply_surface(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64], Normals]:
    """Read vertices (n, 3), triangles (m, 3) and vertex normals (n, 3), None if not stored, of a .ply.

    A point cloud has zero triangles.

    Raises:
        ValueError: as `read_ply`, or the file has no vertex.
    """
    vertices, triangles, normals = _read_ply(content, MAX_POINTS)
    if triangles is None or not len(triangles):
        return vertices, np.zeros((0, 3), np.int64), normals
    return *_checked(vertices, triangles), normals


def _read_ply(
    content: bytes, most_vertices: int
) -> tuple[NDArray[np.float64], NDArray[np.int64] | None, Normals]:
    """Read vertices, triangles (None if there are no faces), and normals (None if there are none)."""
    order, elements, offset = _header(content, most_vertices)
    data = numbers_of(content, offset) if order == "" else np.frombuffer(content, np.uint8)[offset:]
    position, vertices, normals = 0, None, None
    for element in elements:
        if element.name == "face" and vertices is not None:
            return vertices, _faces(data, position, element), normals
        if any(one.count is not None for one in element.properties):
            raise ValueError(
                f"lists of '{printable(element.name, 20)}' before the faces; write vertices first"
            )
        if position + element.rows * element.width > len(data):
            raise ValueError(f"cut short in its '{printable(element.name, 20)}'; write it again")
        rows = data[position : position + element.rows * element.width].reshape(element.rows, element.width)
        if element.name == "vertex":
            vertices = np.stack([_column(rows, element, axis) for axis in "xyz"], axis=1)
            if {"nx", "ny", "nz"} <= {one.name for one in element.properties}:
                normals = np.stack([_column(rows, element, f"n{axis}") for axis in "xyz"], axis=1)
        position += rows.size
    if vertices is None:
        raise ValueError("no vertices")
    return vertices, None, normals


@dataclass(frozen=True)
class _Property:
    """A property of an element, as the header declares it.

    The data of a text file is an array of numbers, so that a value takes one array element. The data of a
    binary file is an array of bytes.

    Attributes:
        name: name of the property.
        kind: type of its values.
        count: type of the number that states a list's length; None if the property is no list.
        text: whether the file is a text file.
    """

    name: str
    kind: np.dtype[np.generic]
    count: np.dtype[np.generic] | None
    text: bool

    @property
    def width(self) -> int:
        """Array elements that one value takes."""
        return 1 if self.text else self.kind.itemsize

    @property
    def count_width(self) -> int:
        """Array elements that a list's count takes; 0 if the property is no list."""
        return 0 if self.count is None else 1 if self.text else self.count.itemsize


@dataclass(frozen=True)
class _Element:
    """An element of the header: name, number of rows, and properties."""

    name: str
    rows: int
    properties: tuple[_Property, ...]

    @property
    def width(self) -> int:
        """Smallest number of array elements of a row, that is, with empty lists."""
        return sum(one.width if one.count is None else one.count_width for one in self.properties)


def _header(content: bytes, most_vertices: int) -> tuple[str, list[_Element], int]:
    """Parse and check the header: byte order ("" for text), elements, and offset at which the data begins."""
    malformed = ValueError("a malformed header")
    end = content.find(b"end_header", 0, MAX_HEADER_BYTES)
    line_end = content.find(b"\n", max(end, 0), MAX_HEADER_BYTES + 16)
    if end < 0 or line_end < 0:
        raise malformed
    order, elements, properties = None, list[tuple[str, int]](), list[list[_Property]]()
    lines = [line.split() for line in content[:end].decode("latin-1").splitlines()]
    try:
        for words in lines[1:]:
            if words[:1] == ["format"]:
                order = FORMATS[words[1]]
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2])))
                properties.append([])
            elif words[:1] == ["property"]:
                count, kind = (words[2], words[3]) if words[1] == "list" else (None, words[1])
                count_type = None if count is None else np.dtype(f"{order}{TYPES[count]}")
                kind_type = np.dtype(f"{order}{TYPES[kind]}")
                properties[-1].append(_Property(words[-1], kind_type, count_type, order == ""))
    except (IndexError, KeyError, ValueError, TypeError):
        raise malformed from None
    if lines[:1] != [["ply"]] or order is None or sum(map(len, properties)) > MAX_PROPERTIES:
        raise malformed
    parsed = [_Element(*facts, tuple(of)) for facts, of in zip(elements, properties, strict=True)]
    least = [element.rows * max(element.width, 1) for element in parsed]
    # In a text each number takes at least two bytes: a digit and a separator.
    if any(rows < 0 for _, rows in elements) or sum(least) > (len(content) - line_end) / (1 + (order == "")):
        raise ValueError("its header claims more than the file holds; write it again")
    for element in parsed:
        lists = sum(one.count is not None for one in element.properties)
        if lists > MAX_LISTS or (element.name == "face" and len(element.properties) > MAX_OF_FACE):
            raise ValueError(f"more than {MAX_LISTS} lists or {MAX_OF_FACE} properties of a face; write less")
        limit = {"vertex": (most_vertices, "vertices"), "face": (MAX_TRIANGLES, "faces")}.get(element.name)
        if limit:
            _refuse_many(element.rows, limit[1], limit[0])
    return order, parsed, line_end + 1


def numbers_of(content: bytes, start: int = 0) -> NDArray[np.float64]:
    """Parse the whitespace-separated numbers of a text from byte `start` on, in pieces to save memory.

    Raises:
        ValueError: a word is no number, or there are more than `MAX_NUMBERS` numbers.
    """
    numbers, count = np.empty(min(MAX_NUMBERS, (len(content) - start) // 2 + 1)), 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # raised for a word that is no number
        while start < len(content):
            space = SPACE.search(content, start + PIECE_BYTES)
            end = space.end() if space else len(content)
            words = content[start:end].strip()
            try:
                part = np.fromstring(words, sep=" ") if words else np.zeros(0)
            except (ValueError, DeprecationWarning):
                raise ValueError("a word that is no number") from None
            if count + len(part) > len(numbers):
                raise ValueError(f"more than {MAX_NUMBERS} numbers; write it as binary, or submit a grid")
            numbers[count : count + len(part)] = part
            start, count = end, count + len(part)
    return numbers[:count]


def _column(rows: NDArray[np.generic], element: _Element, name: str) -> NDArray[np.float64]:
    """Return the values of the scalar property `name` of an element in all its rows."""
    place = 0
    for one in element.properties:
        if one.name == name:
            values = rows[:, place : place + one.width]
            return (values if one.text else np.ascontiguousarray(values).view(one.kind))[:, 0].astype(float)
        place += one.width
    raise ValueError(f"vertices without {name}")


def _faces(data: NDArray[np.generic], position: int, element: _Element) -> NDArray[np.int64]:
    """Read the triangles (m, 3) of the face element, which begins at index `position` of the data."""
    made, done, triangles = list[NDArray[np.int64]](), 0, 0
    while done < element.rows:
        rows = min(ROWS, element.rows - done)
        starts, sizes, position = _lists(data, position, element, rows)
        _refuse_many(int(np.maximum(sizes - 2, 0).sum()) + triangles, "triangles", MAX_TRIANGLES)
        of = next(one for one in element.properties if one.count is not None and one.name in CORNER_LISTS)
        for size in np.unique(sizes[sizes > 2]):
            polygons = _gathered(data, starts[sizes == size], int(size), of.kind, of.text)
            # In a text any number, or NaN, may stand for a corner: such corners become -1, no vertex.
            polygons = np.where(np.abs(polygons) <= MAX_VERTICES, polygons, -1).astype(np.int64)
            firsts = np.repeat(polygons[:, :1], size - 2, axis=1)
            made.append(np.stack([firsts, polygons[:, 1:-1], polygons[:, 2:]], axis=2).reshape(-1, 3))
            triangles += len(made[-1])
        done += rows
    return np.concatenate(made) if made else np.zeros((0, 3), np.int64)


def _lists(
    data: NDArray[np.generic], position: int, element: _Element, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Offsets and lengths of the corner lists of the next `rows` faces, and the end of the last face."""
    if not any(one.count and one.name in CORNER_LISTS for one in element.properties):
        raise ValueError("faces without a list vertex_indices")
    start, size, end = _row(data, position, element)
    steps = np.arange(rows, dtype=np.int64) * (end - position)
    if position + rows * (end - position) <= len(data) and _equal_lengths(data, position, element, steps):
        return start + steps, np.full(rows, size, np.int64), position + rows * (end - position)
    starts, sizes = np.zeros(rows, np.int64), np.zeros(rows, np.int64)
    for row in range(rows):
        starts[row], sizes[row], position = _row(data, position, element)
    return starts, sizes, position


def _row(data: NDArray[np.generic], position: int, element: _Element) -> tuple[int, int, int]:
    """Offset and length of the corner list of the face at `position`, and the end of that face."""
    start = size = 0
    for one in element.properties:
        if one.count is None:
            position += one.width
            continue
        count = _count(data, position, one)
        position += one.count_width
        if one.name in CORNER_LISTS:
            start, size = position, count
        position += count * one.width
    if position > len(data):
        raise ValueError("cut short in its faces; write it again")
    return start, size, position


def _count(data: NDArray[np.generic], position: int, one: _Property) -> int:
    """Return the length of a list of the property `one`; the list begins at index `position` of `data`."""
    if position + one.count_width > len(data):
        raise ValueError("cut short in its faces; write it again")
    assert one.count is not None, "a list"
    count = float(
        data[position] if one.text else data[position : position + one.count_width].view(one.count)[0]
    )
    if not 0 <= count <= MAX_CORNERS or count != int(count):
        raise ValueError(f"a polygon of {count:g} corners; 3 to {MAX_CORNERS} can be")
    return int(count)


def _equal_lengths(
    data: NDArray[np.generic], position: int, element: _Element, steps: NDArray[np.int64]
) -> bool:
    """Whether all rows of an element have lists of the same lengths as its first row.

    Args:
        data: numbers of a text file, bytes of a binary one.
        position: index in the data where the first row begins.
        element: the element.
        steps: (n,) distance of each row's begin from `position` if all lengths are the same.
    """
    for one in element.properties:
        if one.count is None:
            position += one.width
            continue
        count = _count(data, position, one)
        if (_gathered(data, position + steps, 1, one.count, one.text) != count).any():
            return False
        position += one.count_width + count * one.width
    return True


def _gathered(
    data: NDArray[np.generic],
    positions: NDArray[np.int64],
    count: int,
    kind: np.dtype[np.generic],
    text: bool,
) -> NDArray[np.generic]:
    """Gather numbers (n, count): for each position, `count` numbers that begin there.

    Args:
        data: numbers of a text file, bytes of a binary one.
        positions: (n,) indices in the data.
        count: how many numbers to gather from each.
        kind: type of the numbers in a binary file.
        text: whether the file is a text file.
    """
    places = 1 if text else kind.itemsize
    values: NDArray[np.generic] = data[positions[:, None] + np.arange(count * places)]
    return values if text else values.view(kind)


def _checked(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> Triangles:
    """Check that each corner of a face is a vertex, and return the mesh."""
    if not len(triangles):
        raise ValueError("a mesh without faces; an empty prediction is a grid of zeros")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise ValueError("a face has a corner that is no vertex; write the mesh again")
    return vertices, triangles


def _refuse_many(count: int, what: str, most: int) -> None:
    if count > most:
        raise ValueError(f"more than {most} {what}; simplify the mesh, or submit a grid")
