"""The command `simulate`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.common import Common, takes
from kinectbench.cli.progress_bars import recording_bars
from kinectbench.core import SettingsError

PRESET = "orbit-v1"
OBJECT = "such as chair:seed=3, of --families; default: the preset's, most chair:seed=0"
FRAMES = "number of frames; default: the preset's, most have 300"
SEED = "draws everything but the object; default: the preset's, most 0"
FORMAT = "tum (default; of a .bag: bag), folder, bag, bag_compressed, ros2_sqlite, ros2_mcap, or a plug-in's"


@takes("overrides", "jobs", "as_json")
def simulate_command(
    common: Common,
    out: Annotated[Path | None, typer.Argument(help="the recording: a folder, or a .bag")] = None,
    object_name: Annotated[str | None, typer.Option("--object", help=OBJECT)] = None,
    mesh: Annotated[Path | None, typer.Option(help="a mesh file in metres, instead of an object")] = None,
    preset: Annotated[str, typer.Option(help="see --presets")] = PRESET,
    frames: Annotated[int | None, typer.Option(min=1, help=FRAMES)] = None,
    seed: Annotated[int | None, typer.Option(min=0, help=SEED)] = None,
    form: Annotated[str | None, typer.Option("--format", help=FORMAT)] = None,
    presets: Annotated[bool, typer.Option("--presets", help="list the presets")] = False,
    families: Annotated[bool, typer.Option("--families", help="list the families of objects")] = False,
    contact_sheets: Annotated[
        Path | None, typer.Option(help="draw twelve objects of each family into this folder")
    ] = None,
    samples: Annotated[Path | None, typer.Option(help="write the sample recordings here")] = None,
    demo: Annotated[Path | None, typer.Option(help="write the demo's further recordings here")] = None,
) -> None:
    """Write a simulated recording, with the exact truth beside it in <name>.truth/."""
    from kinectbench.lab.simulate.objects import families as object_families
    from kinectbench.lab.simulate.presets import PRESETS, simulate_named
    from kinectbench.lab.simulate.truth import is_truth, read_truth, truth_folder

    if presets:
        width = max(map(len, PRESETS))
        rows = {name: text for name, (text, _) in PRESETS.items()}
        common.tell(rows, (f"{name:<{width}}  {text}" for name, text in rows.items()))
        return
    if families:
        common.tell(names := sorted(object_families()), names)
        return
    changes = _changes(object_name, mesh, frames, seed, form)
    others = bool(out or changes or common.overrides or preset != PRESET)
    _check_alone({"--contact-sheets": contact_sheets, "--samples": samples, "--demo": demo}, others)
    if contact_sheets is not None:
        from kinectbench.lab.simulate.objects.contact_sheets import write_contact_sheets

        common.tell_written(*write_contact_sheets(contact_sheets))
        return
    if out is not None and is_truth(truth_folder(out)):
        console.lines("note", [f"{out}: replaces the simulated recording that is there"], "yellow")
    with recording_bars() as progress:
        written = simulate_named(
            out,
            preset,
            changes,
            common.overrides or (),
            samples,
            demo,
            lambda name, *done: progress(name, "simulate", *done),
            common.workers,
        )
    if mesh is not None:
        console.lines(
            "note", [f"{mesh}: {read_truth(truth_folder(path)).origin}" for path in written], "yellow"
        )
    common.tell_written(*written)


def _changes(
    object_name: str | None, mesh: Path | None, frames: int | None, seed: int | None, form: str | None
) -> dict[str, object]:
    """Return the given options as {key of SimulationSpec: value}; each value replaces that of the preset."""
    if mesh is not None and object_name is not None:
        raise SettingsError("simulate: give --object or --mesh, not both")
    path = None if frames is None else {"frames": frames}
    given = {"object": object_name, "mesh": mesh and str(mesh), "path": path, "seed": seed, "format": form}
    return {key: value for key, value in given.items() if value is not None}


def _check_alone(folders: Mapping[str, Path | None], others: bool) -> None:
    """Refuse more than one of --contact-sheets, --samples and --demo, and any of them with other options.

    `folders` has the values of these three by name, None if not given. `others` tells whether any other
    option is given.
    """
    alone = [name for name, folder in folders.items() if folder is not None]
    if len(alone) > 1 or (alone and others):
        raise SettingsError(
            f"simulate: {alone[0]} stands alone: leave out OUT, the options of a recording and --set"
        )
