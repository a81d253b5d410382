"""Define the options that commands share as one value, `Common`, which also prints results."""

import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cached_property, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Concatenate

import typer

from kinectbench.cli import STOPPED, console
from kinectbench.core import KinectBenchError, SettingsError, followed
from kinectbench.core.store.address import shown, url_of

if TYPE_CHECKING:
    from kinectbench.engine.executor import Executor
    from kinectbench.engine.shards import Shard
    from kinectbench.settings.models import BenchmarkSettings

# Exit statuses, as docs/commands.md lists them.
CANNOT_BE_USED = 1
SOME_FAILED = 3
# Parameters of commands, besides the shared ones, that may be URLs.
AT_URLS = ("release",)
# Options that name a file or folder to be written.
WRITTEN = ("out", "save_thresholds")
DEFAULT_CONFIG = Path("benchmark.yaml")


class OnInterrupt:
    """The message printed after an interrupt (Ctrl-C).

    A command changes it if running it again would not continue its work.
    """

    words = STOPPED


on_interrupt = OnInterrupt()


@dataclass(frozen=True)
class Common:
    """The options that many commands share; an option that a command does not offer has its default.

    Attributes:
        benchmark: a release to work on; None: the release of the benchmark that `config` describes.
        config: the file with the benchmark's settings; the folder build/ is beside it.
        overrides: settings that replace those of the file, each `SECTION.KEY=VALUE`.
        jobs: the number of processes; None: one per core.
        force: whether to make artefacts again that are current.
        wait: whether to wait for another run in the same folder; if not, stop with an error.
        as_json: whether standard output is JSON.
        shard: the part of the recordings to work on, `I/N`; None: all.
        cluster: the address of a cluster, or `local:N`; None: processes of this machine.
        time_limit: how long a recording may take, seconds; None: no limit.
        verbose: whether all warnings are shown, instead of only the one to handle first.
    """

    benchmark: Annotated[
        Path | None, typer.Option("--benchmark", help="a release; default: benchmark/, made if absent")
    ] = None
    config: Annotated[Path, typer.Option("--config", "-c", help="the benchmark's settings")] = DEFAULT_CONFIG
    overrides: Annotated[
        list[str] | None, typer.Option("--set", metavar="SECTION.KEY=VALUE", help="override a setting")
    ] = None
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", "-j", min=1, help="processes; default: one per core; of one recording 8 threads at most"
        ),
    ] = None
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="make again what is current; build: all stages; publish: the release alone"
        ),
    ] = False
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="wait for another run here, or stop and say whose it is")
    ] = True
    as_json: Annotated[bool, typer.Option("--json", help="print JSON for machines")] = False
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N", help="work on part I of N only, as task I of a batch system's array of N; from 1"
        ),
    ] = None
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="a Dask cluster: tcp://HOST:PORT, a scheduler's file, or local:N here"
        ),
    ] = None
    time_limit: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", min=1, help="a recording that takes longer fails; default: none"),
    ] = None
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="show all warnings, not only what to see to first")
    ] = False

    @property
    def place(self) -> Path:
        """The folder or URL of benchmark.yaml as a path; relative paths in the file start there."""
        return self.config.parent

    @property
    def root(self) -> Path:
        """The folder of benchmark.yaml; relative paths in the file start there.

        Raises:
            SettingsError: the benchmark is in a store (at a URL), where only some commands work.
        """
        url = url_of(self.place)
        if url is not None:
            raise SettingsError(
                f"--config {shown(url)}: this command works on folders of this machine; in a store build and "
                "its stages, publish, verify and gc do; `kinectbench fetch` brings a release here",
                what="bad-url",
            )
        return self.place

    def beside(self, name: str) -> Path:
        """Return a results folder's path: beside benchmark.yaml, or with `--benchmark` in the current one.

        Raises:
            SettingsError: this is in a release, or in a store.
        """
        path = Path(name) if self.benchmark else self.root / name
        refuse_in_release(path)
        return path

    @property
    def options(self) -> list[str]:
        """The options (`--config`, `--set`) that choose the same settings on another command line."""
        given = [word for override in self.overrides or () for word in ("--set", override)]
        url = url_of(self.config)
        place = str(self.config) if url is None else shown(url)
        return given if self.config == DEFAULT_CONFIG else ["--config", place, *given]

    @property
    def workers(self) -> int:
        """The number of processes: as requested, or else one per core."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        return self.jobs or cores or 1

    @property
    def part(self) -> "Shard | None":
        """The part of the recordings that `--shard` names; None: all.

        Raises:
            SettingsError: the value of `--shard` is invalid.
        """
        from kinectbench.engine.shards import parse_shard

        return None if self.shard is None else parse_shard(self.shard)

    @contextmanager
    def executor(self) -> Iterator["Executor | None"]:
        """Connect to the requested cluster during a `with` block and yield it (None if none is requested).

        Raises:
            SettingsError, ClusterError: the address is invalid, or nothing answers there.
        """
        if self.cluster is None:
            yield None
            return
        from kinectbench.engine.cluster import cluster

        with cluster(self.cluster) as connected:
            slots = connected.slots()
            workers, page = f"{slots} worker{'s' * (slots != 1)} at {self.cluster}", connected.dashboard
            console.lines("cluster", [f"{workers}; dashboard: {page}" if page else workers], "green")
            if not slots:
                console.lines(
                    "waiting", ["for a worker, 15 minutes at most: start one by `dask worker`"], "yellow"
                )
            yield connected

    @cached_property
    def settings(self) -> "BenchmarkSettings":
        """The settings of the benchmark, read once per command.

        Raises:
            SettingsError: the file or an override is wrong.
            StorageError: a store cannot be read.
        """
        from kinectbench.settings.file import load_benchmark

        return load_benchmark(self.config, self.overrides or ())

    def tell(self, value: object, lines: Iterable[str]) -> None:
        """Print a result on standard output: `value` as JSON with `--json`, else `lines`."""
        if self.as_json:
            console.say_json(value)
        else:
            console.say(*lines)

    def tell_written(self, *paths: Path) -> None:
        """Print which files or folders were written."""
        self.tell([str(path) for path in paths], (f"wrote {path}" for path in paths))

    def tell_problems(self, problems: list[str], well: str, shown: list[str] | None = None) -> None:
        """Print one line per problem on standard error, at most a thousand; if there are none, print `well`.

        Args:
            problems: the problems; with `--json` they are also printed on standard output.
            well: the line that is printed if there are no problems.
            shown: the lines for standard error; default: `problems`.
        """
        self.tell(console.at_most(problems), () if problems else [well])
        console.lines("error", problems if shown is None else shown, "red")


Command = Callable[..., None]


def takes(
    *names: str, at_url: bool = False, makes_release: bool = False
) -> Callable[[Callable[Concatenate[Common, ...], int | None]], Command]:
    """Return a decorator that adds options of `Common` to a command, which gets a `Common` as first argument.

    Typer reads options from a function's signature. The decorated function's signature has the command's own
    parameters and the named fields of `Common`. If the command returns an exit status, the process ends with
    it.

    Args:
        names: names of the fields.
        at_url: whether the command also works on a benchmark in a store; if not, `--config URL` is an error.
        makes_release: whether what it writes is a release, which may replace one.
    """
    shared = [field for field in fields(Common) if field.name in names]
    assert len(shared) == len(names), f"not all of {names} are fields of Common"

    def decorate(command: Callable[Concatenate[Common, ...], int | None]) -> Command:
        """Return the function that typer sees, with the command's own options and the shared ones."""

        @wraps(command)
        def run(**options: Any) -> None:
            """Call the command with the shared options as a `Common`, and exit with its status."""
            common = Common(**{field.name: options.pop(field.name, field.default) for field in shared})
            if not at_url:
                _ = common.root
            _refuse_urls(options)
            for path in map(options.get, WRITTEN):
                if isinstance(path, Path):
                    refuse_in_release(path, makes_release=makes_release)
            status = command(common, **options)
            if status:
                raise typer.Exit(status)

        _, *own = inspect.signature(command).parameters.values()
        parameters = own + [
            inspect.Parameter(
                field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=field.type
            )
            for field in shared
        ]
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return run

    return decorate


def _refuse_urls(options: Mapping[str, object]) -> None:
    """Raise an error if an option that takes a local path is a URL; its parts would become folder names."""
    for name, value in options.items():
        url = url_of(value) if isinstance(value, Path) and name not in AT_URLS else None
        if url is not None:
            raise SettingsError(
                f"{name} {shown(url)}: wanted a path of this machine, not a URL", what="bad-url"
            )


def refuse_in_release(path: Path, *, makes_release: bool = False) -> None:
    """Raise an error if a path is in a release, which would then no longer be the published one.

    Args:
        path: the file or folder to be written.
        makes_release: whether it becomes a release; then it may replace one as a whole.
    """
    place = followed(path)
    for folder in place.parents if makes_release else (place, *place.parents):
        if _is_release(folder):
            raise SettingsError(
                f"{path}: in a release, {folder.name}/, which must stay as it was published; "
                "name another place",
                what="already-exists",
            )


def _is_release(folder: Path) -> bool:
    from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
    from kinectbench.core.artefacts.targets import SHA256SUMS

    try:
        return (folder / BENCHMARK_JSON).is_file() and (folder / SHA256SUMS).is_file()
    except OSError:  # a name that is too long, or a folder that may not be read
        return False


def _known_ids(context: typer.Context, incomplete: str) -> list[str]:
    """Return the recording ids that begin with `incomplete`; none if benchmark.yaml is unreadable."""
    common = Common(config=context.params.get("config") or DEFAULT_CONFIG)
    try:
        known = [recording.id for recording in common.settings.recordings]
    except (KinectBenchError, OSError):
        return []
    return [name for name in known if name.startswith(incomplete)]


Ids = Annotated[
    list[str] | None,
    typer.Argument(metavar="[RECORDING]...", help="ids; default: all", autocompletion=_known_ids),
]
Baselines = Annotated[bool, typer.Option(help="show the baselines beside the methods")]
Predictions = Annotated[
    list[Path],
    typer.Argument(help="one method's folder, or a folder of methods; several are checked in turn"),
]
