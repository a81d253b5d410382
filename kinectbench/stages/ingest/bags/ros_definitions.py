"""Message definitions in a bag, compiled only within bounds.

rosbags makes code of them, into which it unrolls arrays of a fixed length and the messages in them: a few
bytes of a definition may make any amount of it.
"""

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any

from kinectbench.core.untrusted import HEAD_BYTES

if TYPE_CHECKING:
    from rosbags.interfaces import Typestore

# Numbers of a fixed array: a covariance has 36; fields in all once arrays are unrolled, and
# messages in each other: stream_info of librealsense has 47 and 3.
MOST_IN_ARRAY, MOST_FIELDS, MOST_DEPTH = 64, 1000, 8


def known_types(name: str, definition: str, store: "Typestore") -> dict[str, Any]:
    """The types of a definition that a store lacks, for it to register.

    Args:
        name: of the type, in ROS 2's spelling.
        definition: its text, with those of the types in it.
        store: of the types that are known.

    Raises:
        ValueError: it is damaged, or more than is compiled; the message says what.
    """
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import TypesysError, get_types_from_msg

    if len(definition) > HEAD_BYTES:
        raise ValueError(f"a definition of {len(definition)} characters")
    try:
        types = get_types_from_msg(definition, name)
    except (TypesysError, RecursionError) as error:
        raise ValueError(f"is no definition ({type(error).__name__})") from error
    lacking = {key: value for key, value in types.items() if key not in store.fielddefs}
    fields = {key: value[1] for key, value in (store.fielddefs | lacking).items()}
    met: set[str] = set()
    if sum(1 for _ in islice(_unrolled(name, fields, met, 0), MOST_FIELDS + 1)) > MOST_FIELDS:
        raise ValueError(f"more than {MOST_FIELDS} fields")
    for own in lacking.keys() & met:
        # Each message of such a list may have no bytes, so that a list without end takes none.
        if any(kind == Nodetype.SEQUENCE and node[0][0] == Nodetype.NAME for _, (kind, node) in fields[own]):
            raise ValueError(f"{own} holds a list of messages")
    return {key: value for key, value in lacking.items() if key in met}


def _unrolled(name: str, fields: Mapping[str, Any], met: set[str], depth: int) -> Iterator[None]:
    """Once for each field of a type, and of those in it, with arrays unrolled; notes the types it meets."""
    from rosbags.interfaces import Nodetype

    if depth > MOST_DEPTH or name not in fields:
        raise ValueError(f"{name} is nested too deep, or not defined")
    met.add(name)
    for _, (kind, node) in fields[name]:
        inner, count = node if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else ((kind, node), 1)
        if kind == Nodetype.ARRAY and count > MOST_IN_ARRAY:
            raise ValueError(f"an array of {count}")
        for _ in range(count if kind == Nodetype.ARRAY else 1):
            yield
            if inner[0] == Nodetype.NAME:
                yield from _unrolled(inner[1], fields, met, depth + 1)
