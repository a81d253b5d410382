"""Write a recording frame by frame, on threads, as a folder in the format of the TUM RGB-D benchmark.

A row is added to `depth.txt` or `rgb.txt` only when its image is complete. So the folder can be read at any
time; after a crash, it has all frames up to the last row.
"""

import os
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np

from kinectbench.core import SettingsError, pretty_json, reachable, storage_errors
from kinectbench.core.trajectory.stamps import format_stamp
from kinectbench.record.interface import Frame, Setup
from kinectbench.stages.ingest.images import encode_png
from kinectbench.stages.ingest.readers.tum import DEPTH_AXES

# 640x480 with uncompressed colour takes 21 ms of a processor: two threads do 30 Hz; two more wait for the
# disk.
THREADS = 4
# Largest number of bytes of frames that wait to be written: five seconds of 640x480 with uncompressed colour,
# two of 1280x720.
BACKLOG_BYTES = 256 << 20
HEADERS = {
    "depth": "# timestamp filename",
    "rgb": "# timestamp filename",
    "accelerometer": "# timestamp ax ay az",
}


def check_new(folder: Path) -> None:
    """Refuse a folder that is not empty: two recordings are never mixed.

    Raises:
        SettingsError: the folder holds something, or is no folder.
    """
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if folder.exists() or folder.is_symlink():
        raise SettingsError(f"{folder}: is there already; name a new folder for the recording")


class FolderWriter:
    """Writes frames into a new folder; `add` never waits for the disk."""

    def __init__(self, folder: Path, setup: Setup, device: str) -> None:
        """Create the folder.

        Args:
            folder: a missing or empty folder.
            setup: the device's cameras, for camera.json.
            device: the name of the device, for camera.json.

        Raises:
            SettingsError: the folder is not empty, or another recorder was first.
            StorageError: the folder cannot be created.
        """
        check_new(folder)
        with storage_errors(folder), reachable(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with storage_errors(folder):
            try:
                (folder / "depth").mkdir()  # only one of two recorders succeeds
            except FileExistsError as error:
                said = f"{folder}: another recorder has begun there; name a new folder"
                raise SettingsError(said) from error
            (folder / "rgb").mkdir()
            (folder / "camera.json").write_text(pretty_json(_camera_json(setup, device)), encoding="utf-8")
        self.folder = folder
        self.error: Exception | None = None
        self.added = self.listed = self.dropped = 0
        self._lists: dict[str, int] = {}
        self._waiting_bytes = 0
        self._whole: dict[int, tuple[tuple[str, str], ...]] = {}
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="record")

    def add(self, frame: Frame) -> int | None:
        """Queue a frame for writing; return its number, or None if the queue is full: it is dropped."""
        with self._lock:
            if self._waiting_bytes + frame.nbytes > BACKLOG_BYTES and self._waiting_bytes:
                self.dropped += 1
                return None
            self._waiting_bytes += frame.nbytes
        number, self.added = self.added, self.added + 1
        self._pool.submit(self._write, number, frame)
        return number

    def close(self) -> None:
        """Wait until all frames are written. After an error, frames that were not started are left out.

        After a KeyboardInterrupt, this can be called again.
        """
        self._pool.shutdown(wait=True)
        while self._lists:
            os.close(self._lists.popitem()[1])

    def _write(self, number: int, frame: Frame) -> None:
        """Write a frame's images; then add rows to the lists, in the order of frames.

        Rows are added up to the first frame whose images are not complete yet. After an error, no further
        frame is started, but frames that were started before are completed.
        """
        try:
            if self.error is None:
                self._whole[number] = self._images(number, frame)
                with self._lock:
                    while self.listed in self._whole:
                        self._add_rows(self._whole.pop(self.listed))
                        self.listed += 1
        except Exception as error:  # a full disk, or an image that cannot be encoded
            self.error = self.error or error
        finally:
            with self._lock:
                self._waiting_bytes -= frame.nbytes

    def _images(self, number: int, frame: Frame) -> tuple[tuple[str, str], ...]:
        """Write a frame's images; return its rows for the lists: (name such as "rgb", row), depth last."""
        rows = [
            ("accelerometer", f"{format_stamp(s)} {x!r} {y!r} {z!r}") for s, (x, y, z) in frame.accelerations
        ]
        if frame.color is not None:
            suffix, data = frame.color if isinstance(frame.color, tuple) else (".png", _png(frame.color))
            stamp_ns = frame.stamp_ns if frame.color_stamp_ns is None else frame.color_stamp_ns
            rows.append(("rgb", self._image("rgb", f"{number:06d}{suffix}", stamp_ns, data)))
        depth = encode_png(frame.depth, fast=True)
        rows.append(("depth", self._image("depth", f"{number:06d}.png", frame.stamp_ns, depth)))
        return tuple(rows)

    def _image(self, kind: str, name: str, stamp_ns: int, data: bytes) -> str:
        """Write an image into the folder `kind`; return its row of the list of images: stamp and file."""
        file = self.folder / kind / name
        try:
            file.write_bytes(data)
        except OSError:
            file.unlink(missing_ok=True)
            raise
        return f"{format_stamp(stamp_ns)} {kind}/{name}"

    def _add_rows(self, rows: Sequence[tuple[str, str]]) -> None:
        for name, row in rows:
            if name not in self._lists:
                how = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
                self._lists[name] = os.open(self.folder / f"{name}.txt", how, 0o666)
                _append(self._lists[name], HEADERS[name])
            _append(self._lists[name], row)


def _append(handle: int, row: str) -> None:
    """Append a row to a file without buffering; if that raises an OSError, no part of the row stays."""
    data = f"{row}\n".encode()
    before = os.fstat(handle).st_size
    try:
        while data:
            data = data[os.write(handle, data) :]
    except OSError:
        os.ftruncate(handle, before)
        raise


def _png(rgb: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> bytes:
    return encode_png(np.ascontiguousarray(rgb[..., ::-1]), fast=True)


def _camera_json(setup: Setup, device: str) -> dict[str, object]:
    """Return the content of camera.json for the reader of TUM folders."""
    said: dict[str, object] = asdict(setup.camera)
    said |= {"depth_scale": setup.depth_scale, "color_registered": setup.color_registered, "device": device}
    said["accelerometer_axes"] = DEPTH_AXES
    color = setup.color_calibration
    if color is not None:
        said["color_camera"] = asdict(color.camera) | {"distortion": list(color.distortion)}
        said["T_color_depth"] = color.T_color_depth.tolist()
    return said
