"""The folder of a network's predictions. All prediction files in it are from one run of `predict`.

The fingerprint of a run covers everything that determines the bytes of a prediction. The folder stores the
fingerprint and the digest of every file: in `.predicted.jsonl` until the run is complete, then in
method.json. A run keeps only unchanged files with its own fingerprint, and removes other predictions before
it writes.
"""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path

from pydantic import ValidationError

from kinectbench.core import (
    SettingsError,
    append_plain,
    lies_below,
    open_plain,
    read_plain_text,
    replaced_file,
    storage_errors,
    write_below,
)
from kinectbench.core.artefacts.method import PREDICTED, MethodFile, PredictedFile, UnfinishedFile
from kinectbench.release.release import Target
from kinectbench.scoring.prediction_file import blake3_of

SUFFIX = ".npz"
# {key of unfinished.json: words}, to describe how two runs differ.
WORDS = {
    "weights_sha256": "other weights",
    "config_sha256": "another configuration",
    "code_sha256": "other code of the network",
    "threshold": "another --threshold",
    "precision": "another --precision",
    "version": "another version of kinectbench",
    "torch": "another version of torch",
    "hardware": "other hardware",
}


class PredictionFolder:
    """The prediction files of one run; make this object only while holding the folder's lock.

    Args:
        folder: the method's existing folder.
        run: the run that starts or continues.
        targets: all targets that may be predicted; files of other targets are ignored.
        wanted: the targets to predict now; files of other targets are kept if they are from the same run.
        say: called with a line if predictions of another run are removed.

    Raises:
        SettingsError: the folder holds predictions for another release, files that `predict` did not write,
            or a link to another folder.
        PredictionError: method.json or unfinished.json of an earlier run cannot be read.
        StorageError: the disk is full or read-only.
    """

    def __init__(
        self,
        folder: Path,
        run: UnfinishedFile,
        targets: Sequence[Target],
        wanted: Sequence[Target],
        say: Callable[[str], None] | None = None,
    ) -> None:
        self._folder, self._run = folder, run
        done, unfinished = MethodFile.read_if_there(folder), UnfinishedFile.read_if_there(folder)
        self._check(done, unfinished, targets)
        written = self._written_before(done)
        self._kept = {
            name: digest
            for name, digest in written.items()
            if name in {_name(target) for target in targets} and self._digest(name) == digest
        }
        is_same = done is not None and done.run_sha256 == run.sha256
        # If any file has changed, wanted or not, it is removed, and the run counts as unfinished.
        is_whole = is_same and all(map(self.holds, wanted)) and self._kept.keys() == written.keys()
        self._complete = done if is_whole else None
        if self._complete is None:
            self._begin(done, unfinished, targets, say)

    def holds(self, target: Target) -> bool:
        """Return whether this run wrote a target's prediction, and the file is unchanged."""
        return _name(target) in self._kept

    def write(self, target: Target, content: bytes) -> None:
        """Write a prediction atomically, and record it for this run.

        Raises:
            StorageError: the disk is full or read-only.
        """
        name = _name(target)
        with replaced_file(self._folder / name) as temporary:
            temporary.write_bytes(content)
        self._kept[name] = blake3_of(content)
        self._note([name])

    def finish(self, method: MethodFile) -> None:
        """Write method.json with the run's hash and the digests of its files; remove the run's records.

        Args:
            method: method.json of this run. If this run predicted nothing, time and memory of the earlier run
                are kept.
        """
        sealed = {"run_sha256": self._run.sha256, "files": dict(sorted(self._kept.items()))}
        cost = {}
        if self._complete is not None:
            cost = {key: getattr(self._complete, key) for key in ("seconds_per_view", "peak_memory_mb")}
        whole = method.model_copy(update=sealed | cost)
        with replaced_file(self._folder / MethodFile.FILE) as temporary:
            write_below(temporary, whole.text().encode())
        self._clear()

    def _clear(self) -> None:
        for name in (UnfinishedFile.FILE, PREDICTED):
            (self._folder / name).unlink(missing_ok=True)

    def _check(
        self, done: MethodFile | None, unfinished: UnfinishedFile | None, targets: Sequence[Target]
    ) -> None:
        folder = self._folder
        for of in (each.benchmark_sha256 for each in (done, unfinished) if each):
            if of and of != self._run.benchmark_sha256:
                raise SettingsError(
                    f"{folder}: holds predictions for another release ({of[:8]}…); "
                    "choose another folder by --out",
                    what="other-content",
                )
        # Hidden files are the system's, or incomplete files of a run that was killed at its start.
        ours = unfinished or (done and (done.run_sha256 or "weights_sha256" in (done.settings or {})))
        if not ours and any(not path.name.startswith(".") for path in folder.iterdir()):
            raise SettingsError(
                f"{folder}: holds what `predict` did not write; choose another folder by --out, or move it "
                "away",
                what="other-content",
            )
        for name in sorted({target.recording for target in targets}):
            if not lies_below(folder / name, folder.resolve()):
                raise SettingsError(
                    f"{folder / name}: a link out of the folder; remove it", what="other-content"
                )

    def _written_before(self, done: MethodFile | None) -> dict[str, str]:
        """Return {file: digest} for files that this run wrote earlier; {} if another run wrote the folder."""
        if done is not None:
            return dict(done.files or {}) if done.run_sha256 == self._run.sha256 else {}
        written = {}
        with contextlib.suppress(OSError, UnicodeDecodeError):
            for line in read_plain_text(self._folder / PREDICTED).splitlines():
                with contextlib.suppress(ValidationError):  # an incomplete line
                    one = PredictedFile.model_validate_json(line, strict=True)
                    if one.run_sha256 == self._run.sha256:
                        written[one.file] = one.digest
        return written

    def _begin(
        self,
        done: MethodFile | None,
        unfinished: UnfinishedFile | None,
        targets: Sequence[Target],
        say: Callable[[str], None] | None,
    ) -> None:
        """Record this run, and remove the files of others; safe to repeat after the process was killed."""
        listed = {name for name in (done and done.files) or {} if name.endswith(SUFFIX)}
        before = {*listed, *map(_name, targets)} - self._kept.keys()
        with storage_errors(self._folder):
            (self._folder / PREDICTED).unlink(missing_ok=True)
        with replaced_file(self._folder / UnfinishedFile.FILE) as temporary:
            write_below(temporary, self._run.text().encode())
        with storage_errors(self._folder):
            (self._folder / MethodFile.FILE).unlink(missing_ok=True)
            removed = [name for name in sorted(before) if self._remove(name)]
        self._note(sorted(self._kept))
        if removed and say:
            say(_removed_line(self._folder, len(removed), _difference(done, unfinished, self._run)))

    def _remove(self, name: str) -> bool:
        """Remove the file `name` of another run; return whether there was such a file."""
        path = self._folder / name
        if path.is_dir() or not (path.is_symlink() or path.exists()):
            return False
        if not lies_below(path.parent, self._folder.resolve()):  # method.json may contain such a path
            return False
        path.unlink()
        return True

    def _note(self, names: Sequence[str]) -> None:
        lines = (
            PredictedFile(run_sha256=self._run.sha256, file=name, digest=self._kept[name]).line()
            for name in names
        )
        append_plain(self._folder / PREDICTED, "".join(lines))

    def _digest(self, name: str) -> str | None:
        """Return the digest of the file `name`; None if it is missing or cannot be read."""
        try:
            with open_plain(self._folder / name) as file:
                return blake3_of(file)
        except OSError:
            return None


def _name(target: Target) -> str:
    return f"{target.recording}/{target.view}{SUFFIX}"


def _difference(done: MethodFile | None, unfinished: UnfinishedFile | None, run: UnfinishedFile) -> str:
    """Describe how `run` differs from the earlier run in the folder; "" if it does not.

    The earlier run's settings are from unfinished.json or, if that is missing, from method.json (`done`).
    """
    if unfinished is not None:
        before = unfinished.json_value()
    elif done is not None:
        before = {**(done.settings or {}), "hardware": done.hardware}
        before["version"] = (done.version or "").removeprefix("kinectbench ")
    else:
        before = {}
    now = run.json_value()
    differing = [key for key in WORDS if before.get(key) != now.get(key)]
    if "threshold" in differing and "precision" in differing:
        differing.remove("precision")  # bits have no precision
    return ", ".join(WORDS[key] for key in differing)


def _removed_line(folder: Path, count: int, difference: str) -> str:
    files = "1 prediction" if count == 1 else f"{count} predictions"
    if not difference:
        return f"{folder}: removes {files} that this run did not write, or that changed since"
    return f"{folder}: removes {files} of another run ({difference}); --out keeps both"
