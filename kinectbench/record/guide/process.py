"""The guide in a process of its own, so that no work of it keeps the recorder from a frame."""

import json
import multiprocessing
import os
import signal
import time
import warnings
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinectbench.core.errors import CaptureError, SettingsError, StorageError
from kinectbench.core.storage import pretty_json, replaced_file
from kinectbench.core.types import Float64
from kinectbench.record.guide.guide import Guide, Snapshot, mesh_bytes
from kinectbench.record.guide.server import PageServer
from kinectbench.record.interface import Frame, Setup
from kinectbench.record.quiet import in_a_line
from kinectbench.settings.pick import PICK_FILE, PickSettings

# The process is there after 2 to 5 s: libraries are loaded, and compiled functions read.
START_S = 120.0
# A lost camera sees the last picture that had a pose; its longer side, pixels.
PICTURE_PX = 320
# The process gives way to the recorder.
NICER = 5
# The newest pictures that can be clicked: of the last second and a half.
KEPT_PICTURES = 6
NO_CLICK = "that picture is gone: click the one that is shown"
# The radius of the ring around what was picked, pixels of the small picture.
RING_PX = 12
# The newest figures of so many frames are kept for whoever measures.
KEPT_FIGURES = 20_000


class Said(NamedTuple):
    """What the guide says of a frame.

    Attributes:
        number: of the frame.
        sentence: one line.
        done_s: when, by the monotonic clock of this machine.
        T_world_camera: (4, 4), the first frame defines the world; None: the camera is lost.
    """

    number: int
    sentence: str
    done_s: float
    T_world_camera: Float64 | None


class GuideProcess:
    """An observer of a recording: it hands frames to the guide's process, and keeps what it says.

    Attributes:
        url: of the page.
        sentence: what is to be done now; "" before the first frame.
        said: of the newest frames.
    """

    def __init__(self, port: int = 0, folder: Path | None = None) -> None:
        """Start the process (spawned: threads do not survive a fork) and its page.

        Args:
            port: of the page; 0: one that is free.
            folder: the recording, where it is written what was clicked; None: it is written nowhere.

        Raises:
            SettingsError: the port cannot be had.
            CaptureError: the process does not start.
        """
        context = multiprocessing.get_context("spawn")
        self._mine, theirs = context.Pipe()
        self._process = context.Process(target=_run, args=(theirs, port, folder), name="guide", daemon=True)
        self._process.start()
        theirs.close()
        self.sentence, self.said = "", deque[Said](maxlen=KEPT_FIGURES)
        answer = "failed", "does not answer"
        try:
            if self._mine.poll(START_S):
                answer = self._mine.recv()
        except EOFError:
            answer = "failed", "ended at its start"
        kind, url = answer
        self.url: str = url
        if kind != "url":
            self.close()
            raise SettingsError(self.url) if kind == "port" else CaptureError(f"guide: {self.url}")

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def see(self, number: int, frame: Frame, setup: Setup) -> None:
        """Have a frame looked at, and wait for what is said of it."""
        try:
            self._mine.send((number, frame, setup))
            kind, what = self._mine.recv()
        except (EOFError, OSError) as error:
            raise CaptureError("the guide's process ended; the recording goes on") from error
        if kind == "failed":
            raise CaptureError(f"the guide ended: {what}; the recording goes on")
        self.said.append(what)
        self.sentence = what.sentence

    def close(self) -> None:
        """End the process, and its page."""
        with suppress(OSError):
            self._mine.close()
        self._process.join(timeout=10)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()


def _run(connection: Connection, port: int, folder: Path | None) -> None:
    """In the process: serve the page, and look at one frame after another until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the recorder
    warnings.simplefilter("ignore")  # the terminal has one line: that of the recorder
    with suppress(OSError):
        os.nice(NICER)
    shown = _Shown(folder)
    answers = {"state": shown.state, "mesh": shown.mesh, "picture": shown.picture}
    answers["picked"] = shown.picked
    try:
        server = PageServer(answers, port, {"pick": shown.pick})
    except SettingsError as error:
        connection.send(("port", str(error)))
        return
    connection.send(("url", server.url))
    with suppress(EOFError, OSError):
        while True:
            number, frame, setup = connection.recv()
            try:
                snapshot = shown.take(number, frame, setup)
                said = Said(number, snapshot.advice.sentence, time.monotonic(), snapshot.T_world_camera)
            except Exception as error:
                connection.send(("failed", in_a_line(error)))
                return
            connection.send(("said", said))


class _Shown:
    """What the page asks for; it is made when it is asked for."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._guide: Guide | None = None
        self._last: Snapshot | None = None
        self._picture: tuple[int, Frame] | None = None
        # By their numbers, the newest pictures that were asked for: what is clicked is one of them.
        self._asked: dict[int, Frame] = {}
        self._picked: tuple[PickSettings, Frame] | None = None

    def take(self, number: int, frame: Frame, setup: Setup) -> Snapshot:
        """Have the guide look at a frame."""
        if self._guide is None:
            self._guide = Guide(setup)
        self._last = self._guide.take(number, frame)
        if not self._last.lost or self._picture is None:
            self._picture = number, frame
        return self._last

    def state(self, query: str) -> tuple[str, bytes] | None:
        """Figures of the last frame."""
        last, guide, picture = self._last, self._guide, self._picture
        if last is None or guide is None or picture is None:
            return None
        self._asked = dict([*self._asked.items(), picture][-KEPT_PICTURES:])
        value: dict[str, object] = {"number": last.number, "kind": last.advice.kind}
        value |= {"sentence": last.advice.sentence, "lost": last.lost, "looks": last.looks}
        value |= {"picture": picture[0], "picked": self._picked and self._picked[0].model_dump(mode="json")}
        value |= {"distance_m": last.distance_m, "speed_mps": last.speed_mps, **guide.shown()}
        to_go_rad = last.advice.turn_rad
        value["turn_rad"] = -to_go_rad if to_go_rad and last.advice.kind == "left" else to_go_rad
        value["pose"] = None if last.T_floor_camera is None else last.T_floor_camera.tolist()
        return "application/json", json.dumps(value).encode()

    def mesh(self, query: str) -> tuple[str, bytes] | None:
        """The object as it was last looked at."""
        seen = self._guide.seen if self._guide is not None else None
        return None if seen is None else ("application/octet-stream", mesh_bytes(seen.mesh))

    def pick(self, body: bytes) -> str:
        """The object was clicked: `{"picture": number, "x": share of its width, "y": of its height}`.

        Returns:
            Why it is not taken, in a sentence; "": it is.
        """
        try:
            said = json.loads(body)
            number, across, down = int(said["picture"]), float(said["x"]), float(said["y"])
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            return NO_CLICK
        frame, guide = self._asked.get(number), self._guide
        if frame is None or guide is None or not (0 <= across < 1 and 0 <= down < 1):
            return NO_CLICK
        height, width = frame.depth.shape
        pixel = int(across * width), int(down * height)
        picked = PickSettings(frame=number, pixel=pixel)

        def keep() -> None:
            if self._folder is not None:
                with replaced_file(self._folder / PICK_FILE) as temporary:
                    temporary.write_text(pretty_json(picked.model_dump(mode="json")), encoding="utf-8")
            self._picked = picked, frame

        try:
            return guide.pick(frame, pixel, keep)
        except StorageError as error:
            return f"it is not kept: {error}"

    def picture(self, query: str) -> tuple[str, bytes] | None:
        """The picture of that number, of the newest that have a pose."""
        frame = self._asked.get(int(query)) if query.isdecimal() and len(query) < 10 else None
        return None if frame is None else _jpeg(frame)

    def picked(self, query: str) -> tuple[str, bytes] | None:
        """The picture that was clicked, with a ring around the pixel."""
        return None if self._picked is None else _jpeg(self._picked[1], self._picked[0].pixel)


def _jpeg(frame: Frame, marked: tuple[int, int] | None = None) -> tuple[str, bytes] | None:
    """A frame as a small picture: colour, or depth as grey; a pixel of its depth is marked by a ring."""
    import cv2

    if isinstance(frame.color, tuple):
        image = cv2.imdecode(np.frombuffer(frame.color[1], np.uint8), cv2.IMREAD_COLOR)
    elif frame.color is not None:
        image = np.ascontiguousarray(frame.color[..., ::-1])
    else:
        most = max(int(frame.depth.max()), 1)
        image = (frame.depth.astype(np.float32) * (255 / most)).astype(np.uint8)
    if image is None:
        return None
    scale = PICTURE_PX / max(image.shape[:2])
    small = cv2.resize(np.asarray(image), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if marked is not None:
        shares = (marked[0] + 0.5) / frame.depth.shape[1], (marked[1] + 0.5) / frame.depth.shape[0]
        at = round(shares[0] * small.shape[1]), round(shares[1] * small.shape[0])
        small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR) if small.ndim == 2 else small
        for thickness_px, bgr in ((5, (255, 255, 255)), (2, (60, 28, 192))):
            cv2.circle(small, at, RING_PX, bgr, thickness_px)
    return "image/jpeg", cv2.imencode(".jpg", small)[1].tobytes()
