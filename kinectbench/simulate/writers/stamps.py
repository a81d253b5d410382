"""What becomes of a frame's stamp in each format."""

from kinectbench.simulate.spec import Format

NS_PER_S = 10**9
MICROSECONDS = ("tum", "klg", "sens", "stray")


def stamp_as_read(file_format: Format, index: int, stamp_ns: int) -> int:
    """The stamp in nanoseconds under which a reader finds a frame (own rule).

    Bags keep stamps, TUM folders, .klg and .sens keep microseconds, Redwood's names twelve digits of them.
    7-Scenes, plain folders and BOP scenes have none: there a frame's number counts seconds. 3D Scanner App
    has seconds as a float.

    Args:
        file_format: of the recording.
        index: the frame's place among those that were written, from 0.
        stamp_ns: of the frame as written, nanoseconds.
    """
    if file_format in ("7scenes", "folder", "bop"):
        return index * NS_PER_S
    if file_format == "scanner_app":
        return round(stamp_ns / NS_PER_S * NS_PER_S)
    if file_format == "redwood":
        return stamp_ns // 1000 % 10**12 * 1000
    return stamp_ns // 1000 * 1000 if file_format in MICROSECONDS else stamp_ns
