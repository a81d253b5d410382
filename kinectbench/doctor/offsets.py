"""Offsets between clocks, found while a recording is ingested: what to write into benchmark.yaml."""

from collections.abc import Iterator

from kinectbench.doctor.clocks import check_partners
from kinectbench.doctor.delays import check_color_delay, check_trajectory_delay
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.look import Gathering, frames_to_read
from kinectbench.doctor.trajectory import fit_trajectory
from kinectbench.ingest.recording import RawFrame, Recording


class OffsetWatch:
    """Looks on while frames are written, so that none is read twice for it."""

    def __init__(self, recording: Recording) -> None:
        """Look at the frames that `inspect` would read."""
        self._recording = recording
        self._gathering = Gathering(recording, frames_to_read(len(recording)), whole=0)

    def see(self, index: int, frame: RawFrame) -> None:
        """Take a frame as it was recorded."""
        self._gathering.take(index, frame)

    def warnings(self) -> list[str]:
        """A line for each offset, with what to write into benchmark.yaml."""
        told = (found for found in self._findings() if found.severity == "warning")
        return [f"{found.where}: {found.what}; {found.advice}" for found in told if "delay_s" in found.advice]

    def _findings(self) -> Iterator[Finding]:
        look = self._gathering.look()
        given = self._recording.given_trajectory
        yield from check_partners(look)
        yield from check_color_delay(look)
        fit = fit_trajectory(look)
        # Poses that are meant otherwise fit at no time; `track` says so, on all frames.
        if fit is not None and given is not None and not fit.reading.changes:
            yield from check_trajectory_delay(look, given, fit.reading, fit.pairs)
