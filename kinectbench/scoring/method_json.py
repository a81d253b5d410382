"""Read method.json of a folder of predictions, and check its declarations."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from kinectbench.core import PredictionError, listed, printable
from kinectbench.core.artefacts.method import MethodFile, UnfinishedFile
from kinectbench.core.artefacts.provenance import nearest_step
from kinectbench.release.release import Release
from kinectbench.scoring.mesh_prediction import MESHES
from kinectbench.scoring.thresholds import STEPS_IN_WORDS

# Values that method.json may declare for predictions in the pair's grid, by key. For predictions in the
# camera frame every value of the file's format is supported.
SUPPORTED: Mapping[str, tuple[Any, ...]] = {
    "frame": ("grid",),
    "form": ("voxels", "mesh"),
    "unit": ("m",),
    "axes": ("cv",),
    "scale": ("metric",),
    "hypotheses": (1,),
    "T_camera_prediction": (None,),
}
SUFFIXES_OF = {"voxels": (".npy", ".npz"), "mesh": MESHES}
# Maximum numbers of notes, keys and files that are named, and of characters of a note that are shown.
NAMED = 20
LONGEST_NOTE = 200


def read_in_camera(folder: Path) -> MethodFile | None:
    """Read method.json; return None if its predictions are not in the camera frame, or if there is no file.

    Raises:
        PredictionError: the file cannot be read, or contradicts itself; the message is one line.
    """
    method = MethodFile.read_if_there(folder)
    return method if method is not None and method.frame == "camera" else None


def read_method(folder: Path) -> MethodFile | None:
    """Read method.json, and check that predictions in the pairs' grids can be scored.

    The result is None if the file is missing.

    Raises:
        PredictionError: the file cannot be read, has a misspelt key, or declares what is not supported yet;
            the message is one line.
    """
    method = MethodFile.read_if_there(folder)
    lines = [] if method is None else list(_not_supported(method))
    if lines:
        of_camera = method is not None and method.frame == "grid" and not lines[0].startswith("'threshold'")
        advice = "; with 'frame': 'camera' it is" * of_camera
        raise PredictionError(f"{folder / MethodFile.FILE}: {'; '.join(lines)}{advice}")
    return method


def _not_supported(method: MethodFile) -> Iterator[str]:
    """Yield a short text for each key whose value is not supported yet."""
    for key, supported in SUPPORTED.items():
        if (value := getattr(method, key)) not in supported:
            words = "leave it out" if supported == (None,) else ", ".join(map(str, supported))
            shown = "" if supported == (None,) else f" {printable(repr(value), 60)}"
            yield f"'{key}'{shown} is not supported yet (supported: {words})"
    if method.threshold is not None and nearest_step(method.threshold) is None:
        yield f"'threshold' {method.threshold:g} is not supported yet (supported: {STEPS_IN_WORDS})"


def form_problem(method: MethodFile | None, suffix: str) -> str | None:
    """Return why a file with this suffix contradicts the form in method.json; None if it does not."""
    if method is None or "form" not in method.model_fields_set or suffix in SUFFIXES_OF[method.form]:
        return None
    return f"{MethodFile.FILE} says 'form': '{method.form}', which no {suffix} is; correct one of them"


def method_problems(folder: Path, method: MethodFile | None, release: Release) -> list[str]:
    """Return signs, one line each, that a folder's predictions are incomplete or for another release."""
    if method is None:
        if (folder / UnfinishedFile.FILE).is_file():
            return [f"{UnfinishedFile.FILE}: `predict` has not completed these predictions; run it again"]
        return []
    # The public and the private half have the same inputs, so predictions for one are also valid for the
    # other.
    halves = (release.metadata.public_benchmark_sha256, release.metadata.private_benchmark_sha256)
    if method.benchmark_sha256 in (None, release.benchmark_sha256, *halves):
        return []
    made = printable(method.benchmark_sha256[:8])
    return [
        f"{MethodFile.FILE}: the predictions are for another release ({made}…, this is "
        f"{release.benchmark_sha256[:8]}…): views of the same name may differ; predict this one"
    ]


def method_lines(folder: Path, method: MethodFile | None, release: Release) -> list[str]:
    """Return the caveats of a method, one line each: `method_problems`, unknown keys, `training.notes`."""
    if method is None:
        return method_problems(folder, method, release)
    lines = list(_unknown_keys(method))
    notes = (method.training or {}).get("notes")
    if isinstance(notes, list):
        lines += [printable(note, LONGEST_NOTE) for note in notes[:NAMED] if isinstance(note, str)]
    return [*method_problems(folder, method, release), *(f"{MethodFile.FILE}: {line}" for line in lines)]


def _unknown_keys(method: MethodFile) -> Iterator[str]:
    """Yield a line about the unknown keys, if any, with the known keys that they resemble."""
    keys = [
        printable(key, 60) + (f" (did you mean {meant}?)" if (meant := method.meant(key)) else "")
        for key in method.model_extra or {}
    ]
    if keys:
        yield f"not known, and not looked at: {listed(keys, NAMED)}"


def changed_files(method: MethodFile | None, digests: Mapping[str, str]) -> list[str]:
    """Return the files whose digests differ from method.json, sorted; [] if it lists no files.

    `digests` are {file, relative to the method's folder: digest of its bytes}.
    """
    if method is None or method.files is None:
        return []
    return sorted(name for name, digest in digests.items() if method.files.get(name) != digest)


def changed_line(names: list[str], count: int) -> str:
    """Return a line that states how many of `count` files have changed (`names`), and names the first."""
    verb = "is" if len(names) == 1 else "are"
    return (
        f"{MethodFile.FILE}: {len(names)} of {count} files {verb} not what its run of `predict` wrote, such "
        f"as {names[0]}: changed since, or of another run; predict again"
    )
