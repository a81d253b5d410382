"""Commands before a build: `formats`, `inspect` and `init`."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.common import CANNOT_BE_USED, DEFAULT_CONFIG, Common, takes
from kinectbench.cli.progress_bars import step_shown
from kinectbench.core import NAME, RESULTS, SettingsError, listed, replaced_file, scanned

if TYPE_CHECKING:
    from kinectbench.doctor import Diagnosis
    from kinectbench.settings.models import RecordingSettings

# Texts of `formats` for each kind of evidence.
EVIDENCE = {
    "recording": "a real recording",
    "copy": "a real recording whose licence lets it be copied",
    "writer": "nothing real, but files written by the format's own description",
}
# Files that mark a folder as no recording: a simulation's truth, a benchmark, a release, an export, results.
MARKS = ("truth.json", "benchmark.yaml", "benchmark.json", "export.json", "scores.json", "triage.json")
# Largest number of entries of a folder that a mistyped path is compared with: 0.1 ms each (measured).
MOST_COMPARED_PATHS = 2000
# Largest number of folders left out by `init` that are named: three lines of a terminal.
SHOWN_LEFT_OUT = 12
STYLES = {"stops": "red", "warning": "yellow", "note": "dim"}


@takes("as_json")
def init_command(
    common: Common,
    folder: Annotated[Path, typer.Argument(help="recordings are looked for here and below")],
    force: Annotated[bool, typer.Option("--force", help="add to a benchmark.yaml what it lacks")] = False,
) -> None:
    """Write a commented benchmark.yaml for the recordings found in a folder."""
    target, said = write_benchmark(folder, "run `kinectbench build`", force=force)
    common.tell([str(target)], said)


def write_benchmark(folder: Path, then: str, *, force: bool = False) -> tuple[Path, list[str]]:
    """Write a benchmark.yaml for a folder's recordings; return its path, and lines to print about it.

    Args:
        folder: it and the folders below are searched.
        then: what follows after somebody has filled in a new file, for the last line.
        force: whether recordings are added to a file that is there.

    Raises:
        SettingsError: there is no such folder or no recording, or the file is there or has an error.
    """
    from kinectbench.settings.reading import read_bytes
    from kinectbench.stages.ingest.readers import find_recordings, name_suffixes

    target = folder / "benchmark.yaml"
    if not folder.is_dir():
        raise SettingsError(
            f"{folder}: no such folder; give the folder that holds the recordings", what="no-file"
        )
    if target.exists() and not force:
        raise SettingsError(
            f"{target}: is there already; edit it, or use --force to add the recordings that it lacks",
            what="already-exists",
        )
    written = read_bytes(target) if target.exists() else None
    recordings = find_recordings(folder)
    rows = [(path.relative_to(folder).as_posix(), name) for path, name in recordings]
    suffixes = name_suffixes()
    left_out = _without_recording(folder, [path for path, _ in recordings], suffixes)
    if left_out:
        names = listed((path.relative_to(folder).as_posix() for path in left_out), SHOWN_LEFT_OUT)
        why = "`kinectbench inspect FOLDER` says why"
        console.lines("note", [f"left out, as no recording of a known format: {names}; {why}"], "yellow")
    text, said = _benchmark_text(target, written, rows, suffixes, then)
    with replaced_file(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return target, said


def _benchmark_text(
    target: Path, written: bytes | None, rows: Sequence[tuple[str, str]], suffixes: Sequence[str], then: str
) -> tuple[str, list[str]]:
    """Return the text of a benchmark.yaml for the found recordings, and lines to print about it.

    Args:
        target: path of the benchmark.yaml.
        written: content of the existing file, to which new recordings are added; None if there is no file.
        rows: (path relative to the file's folder, name of the format) of each recording.
        suffixes: endings of paths, such as ".bag", that are left out of ids.
        then: as in `write_benchmark`.

    Raises:
        SettingsError: there are no recordings, or the existing file has an error.
    """
    from kinectbench.settings.reading import as_text
    from kinectbench.settings.template import extended_benchmark, init_benchmark

    fresh = init_benchmark(target.parent, rows, suffixes)
    all_of = f"{len(rows)} recording{'s' * (len(rows) != 1)}"
    what = "category, object and underside of each, license and source"
    said = [f"wrote {target}", f"{all_of}: fill in {what}, then {then}"]
    if written is None:
        return fresh, said
    try:
        done = extended_benchmark(target, as_text(written, str(target)), rows, suffixes)
    except SettingsError as error:
        remedy = "mend it, or move it away and run `kinectbench init`"
        raise SettingsError(f"{error.lines[0]}; nothing is written: {remedy}", what=error.what) from None
    names = ", ".join(done.missing[:SHOWN_LEFT_OUT])
    lost = [f"in {target}, but not found here: {names}" + ", …" * (len(done.missing) > SHOWN_LEFT_OUT)]
    console.lines("note", lost if names else [], "yellow")
    new = f"{done.added} recording{'s' * (done.added != 1)}"
    return done.text, [f"{target}: added {new} of {len(rows)} found; what was in it stays"]


def _without_recording(folder: Path, recordings: Sequence[Path], suffixes: Sequence[str]) -> list[Path]:
    """Return folders, and files with one of the `suffixes`, that may be recordings but of no known format.

    Nothing inside a returned folder is returned. The following are ignored: hidden files and folders; folders
    with results, a simulation's truth, a benchmark.yaml, a release or an export; folders beside a
    pyproject.toml.
    """
    known = set(recordings)
    holding = {parent for path in recordings for parent in path.relative_to(folder).parents}
    left, waiting = list[Path](), [] if folder in known else [folder]
    while waiting:
        parent = waiting.pop(0)
        ours = parent == folder or (parent / "benchmark.yaml").is_file()
        for child in _children(parent):
            skipped = ours and (child.name in RESULTS or child.name.lower() == "masks")
            if child in known or child.name.startswith(".") or skipped:
                continue
            if child.relative_to(folder) in holding:
                waiting.append(child)
            elif child.is_dir():
                program = (parent / "pyproject.toml").is_file()
                left += [] if program or any((child / mark).is_file() for mark in MARKS) else [child]
            elif child.is_file() and child.name.lower().endswith(tuple(suffixes)):
                left.append(child)
    return sorted(left)


def _children(folder: Path) -> list[Path]:
    """Return the sorted paths in a folder; empty if it is unreadable."""
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


@takes("as_json")
def formats_command(common: Common) -> None:
    """List the recording formats, how each is recognised, and on which data it was verified."""
    from kinectbench.stages.ingest.readers import FORMATS, reader_of

    rows, lines = [], []
    for name in FORMATS:
        reader = reader_of(name)
        facts = {"is": reader.looks_for, "evidence": reader.evidence, "verified": reader.verified or None}
        rows.append({"format": name, **facts})
        which = f": {reader.verified}" if reader.verified else ""
        lines += [f"{name}: {reader.looks_for}", f"    verified on: {EVIDENCE[reader.evidence]}{which}"]
    common.tell(rows, lines)


@takes("as_json")
def inspect_command(
    common: Common,
    recording: Annotated[str, typer.Argument(help="folder or file, or an id of the benchmark.yaml here")],
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="of its camera, such as fx=525; as under `camera:`"),
    ] = None,
    page: Annotated[Path | None, typer.Option(help="write a page with a contact sheet to this file")] = None,
    follow_links: Annotated[bool, typer.Option("--follow-links", help="follow links inside it")] = False,
) -> int:
    """Report in seconds what is wrong with a recording, and the remedy; builds nothing."""
    from kinectbench.doctor import inspect as look_over
    from kinectbench.settings.models import CameraSettings, TrackingSettings
    from kinectbench.settings.overrides import settings_from_options

    known = _of_benchmark(recording)
    camera_settings = known.camera.model_dump(exclude_unset=True) if known and known.camera else {}
    camera = settings_from_options(CameraSettings, camera_settings, overrides or [], "camera")
    path = DEFAULT_CONFIG.parent / known.path if known else Path(recording)
    given = camera if camera_settings or overrides else None
    with step_shown("inspect") as step:
        diagnosis, look = look_over(
            path,
            given,
            mode=known.trajectory_mode if known else None,
            fusion=Common().settings.fusion if known else None,
            own_pixels=known is not None and known.segment_by is not None,
            plane_world=known.plane_world if known else None,
            boxed=known is not None and known.box is not None,
            tracking=Common().settings.tracking if known else TrackingSettings(),
            follow_links=follow_links or (known is not None and known.follow_links),
            step=step,
        )
    if look is None and not path.exists():
        found = tuple(
            replace(each, advice=_near(path.as_posix() if known else recording, ids=not known))
            for each in diagnosis.findings
        )
        diagnosis = replace(diagnosis, findings=found)
    if page is not None:
        from kinectbench.doctor.page import write_diagnosis_page

        write_diagnosis_page(diagnosis, look, page)
    if common.as_json:
        findings = [asdict(finding) for finding in diagnosis.findings]
        console.say_json({"verdict": diagnosis.verdict, **diagnosis.facts, "findings": findings})
    else:
        _show(diagnosis)
        if page is not None:
            console.say(f"page: {page.resolve()}")
    return CANNOT_BE_USED if diagnosis.stops else 0


def _of_benchmark(name: str) -> "RecordingSettings | None":
    """Return the settings of the recording with this id in the local benchmark; None if there is none.

    A file or folder of this name has priority: then None is returned, too.
    """
    if not NAME.fullmatch(name) or not DEFAULT_CONFIG.is_file() or Path(name).exists():
        return None
    return next((known for known in Common().settings.recordings if known.id == name), None)


def _near(name: str, *, ids: bool) -> str:
    """Return a hint with the file or folder that is most similar to a name, or recording id; "" if none is.

    Only with `ids`, ids of the local benchmark are compared, too; of a large folder, some entries are.
    """
    path, known = Path(name), list[str]()
    if ids and NAME.fullmatch(name) and DEFAULT_CONFIG.is_file():
        known = [each.id for each in Common().settings.recordings]
    with suppress(OSError):
        entries = islice(scanned(path.parent), MOST_COMPARED_PATHS)
        known += sorted((path.parent / each.name).as_posix() for each in entries if each.name != path.name)
    near = get_close_matches(name, known, 1)
    return f"did you mean '{near[0]}'?" if near else ""


def _show(diagnosis: "Diagnosis") -> None:
    from rich.text import Text

    from kinectbench.doctor.finding import fact_lines

    console.say(*(f"{name}: {value}" for name, value in fact_lines(diagnosis.facts)))
    for finding in diagnosis.findings:
        head = Text(f"{finding.severity}: {finding.name}: ", style=STYLES[finding.severity])
        advice = f"; {finding.advice}" if finding.advice else ""
        # Texts of recordings are untrusted, so no markup is interpreted.
        text = Text.assemble(head, console.one_line(f"{finding.what}{advice}"))
        console.out.print(text, highlight=False, soft_wrap=True)
    console.say(f"verdict: {diagnosis.verdict}")
