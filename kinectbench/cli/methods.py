"""The commands `train`, `predict` and `convert`: networks; they need torch."""

import math
from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli.common import Common, takes


def _known_configs(incomplete: str) -> list[str]:
    """Names for the shell to complete."""
    from kinectbench.scoring.methods.config_file import packaged_configs

    return [name for name in packaged_configs() if name.startswith(incomplete)]


Device = Annotated[
    str | None, typer.Option(help="cpu, cuda, or another of torch's; default: the GPU if there is one")
]
Release = Annotated[Path, typer.Argument(metavar="RELEASE", help="a published benchmark")]


@takes("wait", "as_json")
def train(
    common: Common,
    config: Annotated[
        str,
        typer.Argument(
            metavar="CONFIG", help="a YAML file, or a name of ours", autocompletion=_known_configs
        ),
    ],
    data: Annotated[list[Path], typer.Option(help="the release to learn from; again for one more")],
    out: Annotated[Path, typer.Option(help="a new folder, or that of a training to go on with")],
    minutes: Annotated[
        float | None, typer.Option(min=0, help="stop after so long; run again to go on")
    ] = None,
    device: Device = None,
) -> None:
    """Train a network on a release; run it again to go on where it stopped."""
    from kinectbench.cli import console
    from kinectbench.scoring.methods.registry import require_torch

    require_torch()
    from kinectbench.core.artefacts.method import TrainingFile
    from kinectbench.core.untrusted import printable
    from kinectbench.release.release import open_release
    from kinectbench.scoring.methods.config_file import find_config
    from kinectbench.scoring.methods.data import unknown_objects
    from kinectbench.scoring.methods.train import train as run
    from kinectbench.settings.words import listed

    if minutes is not None and math.isnan(minutes):
        raise typer.BadParameter("is no number", param_hint="--minutes")
    settings, releases = find_config(config), [open_release(folder) for folder in data]
    limit = None if minutes is None or math.isinf(minutes) else minutes
    if unknown := unknown_objects(releases, settings.training.leave_out):
        said = f"training.leave_out: {listed(map(printable, unknown))}: in no release that was given"
        console.lines(settings.name, [said], "yellow")
    with console.bar(f"train {settings.name}") as progress:
        state = run(
            settings,
            releases,
            out,
            minutes=limit,
            device=device,
            wait=common.wait,
            progress=progress,
            watch=lambda row: console.lines(settings.name, [row.told()], "green"),
        )
    in_all = TrainingFile.read(out).steps_in_all
    told = {"folder": str(out), "steps": state.step, "steps_in_all": in_all}
    told["seconds"] = round(state.seconds, 1)
    done, more = f"{state.step} steps", ""
    if in_all != state.step:
        done, more = f"{state.step} of {in_all} steps", "; run the same command again to go on"
    common.tell(told, [f"{done} in {state.seconds:.0f} s: {out}{more}"])


@takes("as_json")
def predict(
    common: Common,
    method: Annotated[
        str,
        typer.Argument(
            metavar="METHOD", help="a folder of `train` or `convert`, or recae-small: comes trained"
        ),
    ],
    release: Release,
    out: Annotated[Path, typer.Option(help="folder of methods")] = Path("predictions"),
    threshold: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="write packed bits, set above it; default: probabilities"),
    ] = None,
    device: Device = None,
) -> None:
    """Write a trained network's predictions, and method.json beside them."""
    from kinectbench.cli import console
    from kinectbench.scoring.methods.registry import require_torch

    require_torch()
    from kinectbench.release.release import open_release
    from kinectbench.scoring.methods.predict import notes
    from kinectbench.scoring.methods.predict import predict as run
    from kinectbench.scoring.methods.processes import chosen_device
    from kinectbench.scoring.methods.trained import folder_of, open_trained

    folder, where = folder_of(method), chosen_device(device)
    benchmark = open_release(release)
    trained = open_trained(folder, where)

    def say(line: str) -> None:
        console.lines(trained.config.name, [line], "yellow")

    for line in notes(trained, benchmark):
        say(line)
    with console.bar(f"predict {trained.config.name}") as progress:
        written = run(trained, benchmark, out, threshold=threshold, device=where, progress=progress, say=say)
    common.tell_written(written)


@takes("as_json")
def convert(
    common: Common,
    kind: Annotated[
        str, typer.Argument(metavar="KIND", help="recgan: the checkpoint of 3D-RecGAN++'s authors")
    ],
    model: Annotated[Path, typer.Argument(metavar="MODEL_DIR", help="holds <name>.index and <name>.data-…")],
    out: Annotated[Path, typer.Option(help="the method's folder, for `predict`")],
) -> None:
    """Make a method of a network that others trained; TensorFlow is not needed."""
    from dataclasses import asdict

    from kinectbench.core.errors import SettingsError
    from kinectbench.scoring.methods.registry import require_torch

    require_torch()
    from kinectbench.scoring.methods.convert import CONVERTERS

    if kind not in CONVERTERS:
        raise SettingsError(f"no kind of checkpoint '{kind}': choose {', '.join(CONVERTERS)}")
    made = CONVERTERS[kind](model, out)
    common.tell({**asdict(made), "folder": str(made.folder)}, made.lines)
