"""The command `record`."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.common import CANNOT_BE_USED, DEFAULT_CONFIG, Common, on_interrupt, takes
from kinectbench.cli.progress_bars import frames_counted
from kinectbench.core import CaptureError, SettingsError
from kinectbench.engine.interrupts import interrupt_answered

if TYPE_CHECKING:
    from kinectbench.record.build_process import BuildProcess
    from kinectbench.record.guide.process import GuideProcess
    from kinectbench.record.interface import Device
    from kinectbench.record.recorder import Recorded


@takes("as_json")
def record_command(
    common: Common,
    out: Annotated[Path | None, typer.Argument(help="a new folder for the recording")] = None,
    device: Annotated[
        str | None, typer.Option("--device", metavar="NAME", help="see --list; default: what is plugged in")
    ] = None,
    devices: Annotated[bool, typer.Option("--list", help="list the devices, and what each needs")] = False,
    replayed: Annotated[
        Path | None, typer.Option("--from", metavar="RECORDING", help="a recording in place of a camera")
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=1000, help="of --from: times its own pace")] = 1.0,
    seconds: Annotated[float | None, typer.Option(min=0, help="end after so long; default: Ctrl-C")] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="of the camera of --from, such as fx=525"),
    ] = None,
    guided: Annotated[
        bool | None,
        typer.Option("--guide/--no-guide", help="a page says what is still unseen; default: on a terminal"),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="of that page; default: one that is free")] = 0,
    built: Annotated[bool, typer.Option("--build", help="then build the pairs, in the new folder")] = False,
) -> int:
    """Record with a camera into a folder that `inspect` and `build` read; Ctrl-C ends it."""
    from kinectbench.record.devices import device_to_use
    from kinectbench.record.devices.replay import Replay
    from kinectbench.record.folder import check_new
    from kinectbench.settings.models import CameraSettings
    from kinectbench.settings.overrides import settings_from_options

    if devices:
        _list(common)
        return 0
    if out is None:
        raise SettingsError("record: name a new folder for the recording, or give --list")
    if replayed is not None and device is not None:
        raise SettingsError("record: give --device or --from, not both")
    if replayed is None and (speed != 1 or overrides):
        raise SettingsError("record: --speed and --set are of --from; a camera has its own pace and values")
    if built and common.as_json:
        raise SettingsError("record: give --build or --json, not both; `kinectbench build --json` can follow")
    if replayed is not None and not replayed.exists():
        raise CaptureError(
            f"--from {replayed}: there is no such file or folder; give a recording's path, as `path:` in "
            "benchmark.yaml has it, and not its id"
        )
    given = settings_from_options(CameraSettings, {}, overrides, "camera") if overrides else None
    camera = device_to_use(device) if replayed is None else Replay(replayed, speed, given)
    check_new(out)
    with _begun(out, common.workers) if built else nullcontext() as begun:
        done, ended_s = _recorded(camera, out, seconds, port, guided)
        tell_recorded(common, done, None if replayed is None else speed)
        if done.failure:
            return CANNOT_BE_USED
        interrupt_answered()  # it has ended the recording; another one ends the build
        return _build(common, out, ended_s, begun) if built else 0


def _recorded(
    camera: "Device", out: Path, seconds: float | None, port: int, guided: bool | None
) -> "tuple[Recorded, float]":
    """Record, with the guide if wanted; return the outcome and the time of the last frame, monotonic.

    Another Ctrl-C while the guide closes does not lose the outcome.
    """
    from kinectbench.record.recorder import record

    done, last_s = None, time.monotonic()
    try:
        with _guide(port, guided, out) as guide, frames_counted(f"record {out}") as progress:

            def added(frames: int, passed_s: float) -> None:
                nonlocal last_s
                last_s = time.monotonic()
                progress(frames, passed_s, guide.sentence if guide else "")

            done = record(camera, out, seconds, [guide] if guide else [], added)
    except KeyboardInterrupt:
        if done is None:
            if not out.exists():
                on_interrupt.words = "stopped before the first frame: nothing was written"
            raise
    assert done is not None
    return done, last_s


@contextmanager
def _begun(out: Path, workers: int) -> "Iterator[BuildProcess | None]":
    """Start a process that builds while recording; yield it, or None if one of its packages is missing."""
    from kinectbench.core import missing_extra

    if missing_extra("build"):
        yield None  # the build reports it
        return
    from kinectbench.engine.parallel import MOST_THREADS
    from kinectbench.record.build_process import BuildProcess

    begun = BuildProcess(out, min(workers, MOST_THREADS))
    try:
        yield begun
    finally:
        begun.close()


@contextmanager
def _guide(port: int, wanted: bool | None, out: Path) -> "Iterator[GuideProcess | None]":
    """Run the guide, a page with advice for recording, during a `with` block; yield its process.

    Yield None if the guide is not wanted, or (with a warning) if it cannot start.
    """
    if not (console.err.is_terminal if wanted is None else wanted):
        yield None
        return
    from kinectbench.core import missing_extra
    from kinectbench.record.guide.process import GuideProcess

    guide = None
    try:
        if missing := missing_extra("build"):
            raise CaptureError(f"no guide: {missing}")
        guide = GuideProcess(port, out)
        console.lines("guide", [f"open {guide.url}"], "cyan")
    except CaptureError as error:
        console.lines("warning", [str(error)], "yellow")
    try:
        yield guide
    finally:
        if guide is not None:
            guide.close()


def _build(common: Common, out: Path, ended_s: float, begun: "BuildProcess | None") -> int:
    """Write a benchmark.yaml into the new recording's folder, build it, and print how long that took.

    `ended_s` is the time of the last frame; `begun` is the process that `_begun` started.
    """
    from kinectbench.cli.build import run_stage
    from kinectbench.cli.recordings import write_benchmark

    if begun is not None:
        begun.ended()
    quiet, config = replace(common, as_json=False), out / DEFAULT_CONFIG
    command = f"`kinectbench build --config {quote(str(config))}`"
    on_interrupt.words = f"stopped; {command} goes on from here"
    _, (wrote, to_do) = write_benchmark(out, f"run {command}, which uses it")
    console.say(wrote)
    status = run_stage(replace(quiet, config=config), "build", None, begun)
    took_s = time.monotonic() - ended_s
    console.lines("note", [f"{out}: the build ended {took_s:.0f} s after the recording", to_do], "cyan")
    return status


def _list(common: Common) -> None:
    from kinectbench.record.devices import listed_devices

    rows, lines = [], []
    for each in listed_devices():
        rows.append(each._asdict())
        state = each.absent or ", ".join(each.plugged_in) or "nothing is plugged in"
        lines.append(f"{each.name}: {each.cameras}: {state}")
    common.tell(rows, lines)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def tell_recorded(common: Common, done: "Recorded", speed: float | None) -> None:
    """Print the outcome of a recording.

    Args:
        common: the common options.
        done: the outcome.
        speed: times its own pace, of a replay; None: of a camera.
    """
    counts = {"frames": done.frames, "missed": done.missed, "dropped": done.dropped}
    value = {"folder": str(done.folder), "device": done.device, **counts, "seconds": done.seconds}
    value |= {"clock_set_back": done.set_back, "failure": done.failure or None}
    common.tell(value, [f"wrote {done.folder}: {_counted(done.frames, 'frame')} in {done.seconds:.1f} s"])
    number = f"of {done.frames + done.missed + done.dropped}"
    slower = "give a lower --speed to have them"
    usb = "try another cable and port, and close other programs"
    look = "if some are damaged, `kinectbench inspect` names them"
    late = usb if speed is None else slower if speed > 1 else look
    disk = "record to a faster one" if speed is None else slower
    missed, dropped = _counted(done.missed, "frame"), _counted(done.dropped, "frame")
    back = _counted(done.set_back, "time")
    warnings = {
        f"{missed} never arrived ({number}; too late, or damaged); {late}": done.missed,
        f"{dropped} could not be written ({number}): the disk is too slow; {disk}": done.dropped,
        f"the device's clock went back {back}; stamps go on by this machine's": done.set_back,
    }
    said = [text for text, count in warnings.items() if count]
    said += [f"an observer failed: {words}" for words in done.observers]
    console.lines("warning", [f"{done.folder}: {text}" for text in said], "yellow")
    console.lines("error", [done.failure] if done.failure else [], "red")
