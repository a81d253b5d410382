"""The guide in a separate process, so that its work never delays the recorder."""

import json
import multiprocessing
import os
import signal
import time
import warnings
from collections import deque
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import CaptureError, SettingsError, StorageError, pretty_json, replaced_file
from kinectbench.core.encoded_images import decoded_image
from kinectbench.core.types import Float64
from kinectbench.record.guide.guide import Guide, Snapshot, mesh_bytes
from kinectbench.record.guide.server import PageServer
from kinectbench.record.interface import Frame, Setup, in_a_line
from kinectbench.settings.pick import PICK_FILE, PickSettings

# Time for the process to start: 2 to 5 s are usual, to load libraries and compiled functions.
START_S = 120.0
# Longer side, pixels, of the picture that a lost camera gets: the last frame that had a pose.
PICTURE_PX = 320
# Niceness: the recorder gets the processor first.
NICER = 5
# Number of newest pictures that can be clicked: the last second and a half.
KEPT_PICTURES = 6
NO_CLICK = "that picture is gone: click the one that is shown"
# Radius of the ring around the clicked pixel, pixels of the small picture.
RING_PX = 12
# Number of newest frames whose figures are kept for measurements.
KEPT_FIGURES = 20_000


class Said(NamedTuple):
    """The guide's answer to a frame.

    Attributes:
        number: number of the frame.
        sentence: one line.
        done_s: when the guide was done, by the monotonic clock of this machine, seconds.
        T_world_camera: (4, 4), camera to the tracker's world at that time; None: the camera is lost.
    """

    number: int
    sentence: str
    done_s: float
    T_world_camera: Float64 | None


class GuideProcess:
    """An observer of a recording: sends frames to the guide's process, and keeps the guide's sentences.

    Attributes:
        url: URL of the page.
        sentence: the current advice; "" before the first frame.
        said: what the guide said after each frame, for the newest frames.
    """

    def __init__(self, port: int = 0, folder: Path | None = None) -> None:
        """Start the process (spawned: threads do not survive a fork) and its page.

        Args:
            port: port of the page; 0: any free port.
            folder: the recording, in which a click is stored; None: clicks are not stored.

        Raises:
            SettingsError: the port is not available.
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
        """Id of the process."""
        return self._process.pid

    def see(self, number: int, frame: Frame, setup: Setup) -> None:
        """Send a frame to the guide, and wait for its answer.

        Raises:
            CaptureError: the guide has ended.
        """
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
        """End the process and its page."""
        with suppress(OSError):
            self._mine.close()
        self._process.join(timeout=10)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()


def _run(connection: Connection, port: int, folder: Path | None) -> None:
    """Run the guide's process: serve the page, and process frames until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the recorder
    warnings.simplefilter("ignore")  # the recorder owns the terminal
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
                break
            connection.send(("said", said))
    os._exit(0)  # a reconstruction that nobody waits for would hold the build up


class _Shown:
    """Answers the page's requests from the current state of the guide."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._guide: Guide | None = None
        self._last: Snapshot | None = None
        self._picture: tuple[int, Frame] | None = None
        # The newest pictures that were requested, by number: a click is on one of them.
        self._asked: dict[int, Frame] = {}
        self._picked: tuple[PickSettings, Frame] | None = None

    def take(self, number: int, frame: Frame, setup: Setup) -> Snapshot:
        """Give a frame to the guide, and return the state that the page shows after it."""
        if self._guide is None:
            self._guide = Guide(setup)
        self._last = self._guide.take(number, frame)
        if not self._last.lost or self._picture is None:
            # A click means a pixel of depth, which colour beside it does not show.
            self._picture = number, frame if setup.color_registered else replace(frame, color=None)
        return self._last

    def state(self, query: str) -> tuple[str, bytes] | None:
        """Return content type and JSON of the state that the page shows; None before the first frame.

        The mesh and the picture are separate requests. `query` is not used.
        """
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
        """Return content type and `mesh_bytes` of the last reconstruction; None before the first one."""
        seen = self._guide.seen if self._guide is not None else None
        return None if seen is None else ("application/octet-stream", mesh_bytes(seen.mesh))

    def pick(self, body: bytes) -> str:
        """Handle a click on the object: JSON `{"picture": number, "x": ..., "y": ...}`.

        x and y are fractions of the picture's width and height. The picked depth pixel lies at the same
        fractions of the depth image.

        Returns:
            A sentence why the click is not accepted; "" if it is.
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
        """Return the picture with the number `query` if it is among the newest of `state`; else None."""
        frame = self._asked.get(int(query)) if query.isdecimal() and len(query) < 10 else None
        return None if frame is None else _jpeg(frame)

    def picked(self, query: str) -> tuple[str, bytes] | None:
        """Return the clicked picture, with a ring around the clicked pixel; None before a click."""
        return None if self._picked is None else _jpeg(self._picked[1], self._picked[0].pixel)


def _jpeg(frame: Frame, marked: tuple[int, int] | None = None) -> tuple[str, bytes] | None:
    """Encode a frame's colour, or grey depth without colour, as a small JPEG; draw a ring around `marked`.

    `marked` is a depth pixel (column, row), or None.

    Returns:
        Content type and file; None if colour is damaged.
    """
    import cv2

    image: NDArray[np.generic]
    if isinstance(frame.color, tuple):
        try:
            image = decoded_image(frame.color[1], cv2.IMREAD_COLOR)
        except ValueError:
            return None
    elif frame.color is not None:
        image = np.ascontiguousarray(frame.color[..., ::-1])
    else:
        seen = frame.depth[frame.depth > 0]
        # The median is mid-grey; with the farthest as white, a single pixel may make all else black.
        grey = frame.depth * (127.5 / float(np.median(seen)) if len(seen) else 0.0)
        image = np.minimum(grey, 255).astype(np.uint8)
    scale = PICTURE_PX / max(image.shape[:2])
    small = cv2.resize(np.asarray(image), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if marked is not None:
        shares = (marked[0] + 0.5) / frame.depth.shape[1], (marked[1] + 0.5) / frame.depth.shape[0]
        at = round(shares[0] * small.shape[1]), round(shares[1] * small.shape[0])
        small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR) if small.ndim == 2 else small
        for thickness_px, bgr in ((5, (255, 255, 255)), (2, (60, 28, 192))):
            cv2.circle(small, at, RING_PX, bgr, thickness_px)
    return "image/jpeg", cv2.imencode(".jpg", small)[1].tobytes()
