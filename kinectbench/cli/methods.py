"""The commands `train`, `predict`, `convert` and `reproduce` for networks; they need torch."""

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from kinectbench.cli import console
from kinectbench.cli.build import exit_status, find_release
from kinectbench.cli.common import SOME_FAILED, Common, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import SettingsError, listed, printable

if TYPE_CHECKING:
    from kinectbench.core.artefacts.method import UnfinishedFile
    from kinectbench.core.types import Split
    from kinectbench.networks.trained import Trained
    from kinectbench.release.release import Release as OpenRelease


Word = TypeVar("Word", bound=str)


def _known_configs(incomplete: str) -> list[str]:
    """Return the packaged configurations whose names begin with `incomplete`, for completion in the shell."""
    from kinectbench.networks.config import packaged_configs

    return [name for name in packaged_configs() if name.startswith(incomplete)]


Device = Annotated[
    str | None, typer.Option(help="cpu, cuda, or another of torch's; default: the GPU if there is one")
]
Threshold = Annotated[
    float | None, typer.Option(min=0, max=1, help="write packed bits, set above it; default: probabilities")
]
Precision = Annotated[
    str, typer.Option(help="of probabilities: packed (8 bits, exact at all thresholds) or float16")
]
Score = Annotated[bool, typer.Option("--score", help="score each view at once, and write no predictions")]
Release = Annotated[Path, typer.Argument(metavar="RELEASE", help="a published benchmark")]


@takes("wait", "as_json")
def train_command(
    common: Common,
    config: Annotated[
        str,
        typer.Argument(
            metavar="CONFIG", help="a YAML file, or a name of ours", autocompletion=_known_configs
        ),
    ],
    data: Annotated[list[Path], typer.Option(help="the release to learn from; again for one more")],
    out: Annotated[Path, typer.Option(help="a new folder, or that of a training to go on with")],
    category: Annotated[
        str | None, typer.Option(help="learn from its pairs alone, as CONFIG-category; default: all")
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(min=0, help="stop after so long; run again to go on")
    ] = None,
    device: Device = None,
) -> None:
    """Train a network on a release; run it again to continue."""
    from kinectbench.networks.registry import require_torch

    require_torch()
    from kinectbench.core.artefacts.method import TrainingFile
    from kinectbench.networks.config import find_config
    from kinectbench.networks.data import unknown_objects
    from kinectbench.networks.train import train as run
    from kinectbench.release.release import open_release

    if minutes is not None and math.isnan(minutes):
        raise typer.BadParameter("is no number", param_hint="--minutes")
    settings, releases = find_config(config), [open_release(folder) for folder in data]
    settings = settings if category is None else settings.of_category(category)
    limit = None if minutes is None or math.isinf(minutes) else minutes
    if unknown := unknown_objects(releases, settings.training.leave_out):
        warning = f"training.leave_out: {listed(map(printable, unknown))}: in no release that was given"
        console.lines(f"{settings.name}: note", [warning], "cyan")
    with progress_bar(f"train {settings.name}") as progress:
        state = run(
            settings,
            releases,
            out,
            minutes=limit,
            device=device,
            wait=common.wait,
            progress=progress,
            watch=lambda row: console.lines(settings.name, [row.line()], "green"),
        )
    in_all = TrainingFile.read(out).steps_in_all
    summary = {"folder": str(out), "steps": state.step, "steps_in_all": in_all}
    summary["seconds"] = round(state.seconds, 1)
    done, more = f"{state.step} steps", ""
    if in_all != state.step:
        done, more = f"{state.step} of {in_all} steps", "; run the same command again to go on"
    common.tell(summary, [f"{done} in {state.seconds:.0f} s: {out}{more}"])


@takes("as_json")
def predict_command(
    common: Common,
    method: Annotated[
        str,
        typer.Argument(
            metavar="METHOD", help="a folder of `train` or `convert`, or recae-small: comes trained"
        ),
    ],
    release: Release,
    out: Annotated[
        Path | None, typer.Option(help="folder of methods, predictions/; with --score: of scores, scores/")
    ] = None,
    threshold: Threshold = None,
    precision: Precision = "packed",
    split: Annotated[str | None, typer.Option(help="validation or test alone; default: both")] = None,
    score: Score = False,
    surface: Annotated[bool, typer.Option(help="with --score: surface metrics, too")] = True,
    device: Device = None,
) -> int:
    """Write predictions of a trained network, with method.json; --score writes only their scores."""
    from kinectbench.networks.registry import require_torch

    require_torch()
    from kinectbench.networks.distributed import chosen_device
    from kinectbench.networks.predict import PRECISIONS, SPLITS, notes, run_of
    from kinectbench.networks.predict import predict as run
    from kinectbench.networks.trained import folder_of, open_trained
    from kinectbench.release.release import open_release

    chosen = _chosen("--precision", precision, PRECISIONS)[0]
    splits = SPLITS if split is None else _chosen("--split", split, SPLITS)
    if score and "test" not in splits:
        raise typer.BadParameter("scores are of the test split", param_hint="--score --split validation")
    folder, where = folder_of(method), chosen_device(device)
    benchmark = open_release(release)
    trained = open_trained(folder, where)

    def say(line: str) -> None:
        console.lines(trained.config.name, [line], "yellow")

    if score:
        how = run_of(trained, benchmark, threshold, chosen)
        return _score(common, trained, benchmark, how, splits, surface, out or common.beside("scores"))
    for line in notes(trained, benchmark):
        say(line)
    failed = list[str]()
    how_to: dict[str, Any] = {"threshold": threshold, "precision": chosen, "splits": splits}
    with progress_bar(f"predict {trained.config.name}") as progress:
        how_to |= {"progress": progress, "say": say, "failed": failed.append}
        written = run(trained, benchmark, out or common.beside("predictions"), **how_to)
    console.lines(f"{trained.config.name}: error", console.by_mistake(failed), "red")
    common.tell_written(written)
    return SOME_FAILED if failed else 0


def _chosen(option: str, word: str, words: Sequence[Word]) -> tuple[Word, ...]:
    """Return an option's value `word` in a tuple; raise an error that lists `words` if it is none of them."""
    valid = tuple(known for known in words if known == word)
    if not valid:
        raise typer.BadParameter(f"'{word}': choose {' or '.join(words)}", param_hint=option)
    return valid


def _score(
    common: Common,
    trained: "Trained",
    release: "OpenRelease",
    run: "UnfinishedFile",
    splits: "Sequence[Split]",
    surface: bool,
    folder: Path,
) -> int:
    """Do the work of `predict --score`: predict and score in memory, then write the same files as `score`."""
    from kinectbench.cli.report import write_page
    from kinectbench.cli.score import baselines_of, tell_problems, tell_scores
    from kinectbench.core.artefacts.gallery import write_gallery
    from kinectbench.core.artefacts.scores import SCORES_JSON
    from kinectbench.core.voxels.resample import HALF_PIXEL
    from kinectbench.networks.score_predicted import as_written, score_predicted
    from kinectbench.report.gallery import loaded_cells

    with progress_bar(f"predict and score {trained.config.name}") as progress:
        table = score_predicted(trained, release, run, splits=splits, surface=surface, progress=progress)
    tell_problems([table])
    table.write(folder)
    with progress_bar("gallery") as progress:
        # The few views that a page shows are predicted again: all predictions would not fit in memory.
        cells = loaded_cells(
            release, lambda target: as_written(trained, release, run, target), table, progress=progress
        )
    write_gallery(cells, folder / SCORES_JSON)
    beside = baselines_of(release, folder, [table], HALF_PIXEL, common.workers)
    tell_scores(common, [table], beside, write_page(common, release, folder))
    return SOME_FAILED if table.failures else 0


@takes("as_json")
def convert_command(
    common: Common,
    kind: Annotated[
        str, typer.Argument(metavar="KIND", help="recgan: the checkpoint of 3D-RecGAN++'s authors")
    ],
    model: Annotated[Path, typer.Argument(metavar="MODEL_DIR", help="holds <name>.index and <name>.data-…")],
    out: Annotated[Path, typer.Option(help="the method's folder, for `predict`")],
) -> None:
    """Convert a network trained by others into a method; TensorFlow is not needed."""
    from kinectbench.networks.registry import require_torch

    require_torch()
    from kinectbench.networks.convert import CONVERTERS

    if kind not in CONVERTERS:
        raise SettingsError(f"no kind of checkpoint '{kind}': choose {', '.join(CONVERTERS)}")
    made = CONVERTERS[kind](model, out)
    common.tell({**asdict(made), "folder": str(made.folder)}, made.lines)


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


def _origin(release: "OpenRelease") -> str:
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
