"""The command `reproduce`: run the protocol of a paper, from recordings to its table."""

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinectbench.cli import console
from kinectbench.cli.build import exit_status, find_release
from kinectbench.cli.common import Common, takes
from kinectbench.cli.methods import Device
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import SettingsError, printable

if TYPE_CHECKING:
    from kinectbench.release.release import Release

# 3D-RecGAN++, Sec. 3.6: 50 views of each real object, the cube around its full shape. `--set` overrides this.
COUNT = 50
# Largest number of characters of a name or a source in the table (chosen here).
LONGEST_NAME = 200
PAPER_REAL = (f"views.count={COUNT}", "pairs.framing=object")


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def reproduce_command(
    common: Common,
    protocol: Annotated[Literal["paper-real"], typer.Argument(help="that of 3D-RecGAN++ on real recordings")],
    device: Device = None,
) -> int:
    """Build, publish, predict and score by the paper's protocol; print its table. A stopped run is resumed.

    All networks that come trained are run. Other methods' predictions in the same folder are scored, too.
    Thresholds come from the validation split.
    """
    from kinectbench.networks.registry import require_torch

    require_torch()
    from kinectbench.core import replaced_file
    from kinectbench.networks.distributed import chosen_device
    from kinectbench.networks.predict import predict
    from kinectbench.networks.trained import FOLDER as PACKAGED
    from kinectbench.networks.trained import open_trained, packaged_methods
    from kinectbench.report.paper_table import PROTOCOL, SHELL, paper_markdown, paper_tables
    from kinectbench.scoring.score import score_methods

    asked = replace(common, overrides=[*PAPER_REAL, *(common.overrides or ())])
    release, rows = find_release(asked)
    found_count = (release.metadata.settings.views or {}).get("count")  # synthetic releases state none
    wanted = COUNT if common.benchmark else asked.settings.views.count
    if release.metadata.framing != "object" or found_count not in (None, wanted):
        raise SettingsError(
            f"{release.folder}: has framing {release.metadata.framing} and {found_count} views a recording, "
            f"where the protocol has framing object and {wanted}; publish again by `kinectbench publish "
            f"{' '.join(f'--set {override}' for override in asked.overrides or ())}`"
        )
    folder, where = common.root / "reproduce" / protocol, chosen_device(device)
    for name in packaged_methods():
        trained = open_trained(PACKAGED / name, where)
        with progress_bar(f"predict {name}") as progress:
            predict(trained, release, folder / "predictions", progress=progress)
    with progress_bar("score") as progress:
        tables = score_methods(
            release,
            folder / "predictions",
            folder / "scores",
            protocols=(PROTOCOL, SHELL),
            surface=False,
            jobs=common.workers,
            progress=progress,
        )
    found = paper_tables(tables)
    # Such as a warning that a method learnt from test objects.
    warned = [f"{table.method}: {line}" for table in tables for line in table.warnings]
    console.lines("warning", warned, "yellow")
    text = "\n".join([paper_markdown(found), f"- {_origin(release)}", *(f"- {line}" for line in warned), ""])
    with replaced_file(folder / "table.md") as temporary:
        temporary.write_text(text, encoding="utf-8")
    common.tell([asdict(table) for table in found], text.splitlines())
    return exit_status(rows)


def _origin(release: "Release") -> str:
    """Return a line to print below the table: the number of test pairs, and where they come from."""
    pairs, info = release.split("test"), release.metadata
    counted = f"{len(pairs)} pairs of {printable(info.name, LONGEST_NAME)}"
    if info.settings.recordings is None:
        return (
            f"The figures are of {counted}, which were not built of recordings here but synthesised or "
            "imported: nothing proves that they are real."
        )
    many = len({pair.recording for pair in pairs})
    stated = printable(info.settings.source or "unspecified", LONGEST_NAME)
    return f"The figures are of {counted}, built of {many} recording{'s' * (many != 1)}; source: {stated}."
