"""Networks of strangers: configurations, checkpoints, weights and indices that are damaged, or swell.

There are none without torch, which the commands need.
"""

import shutil
import zipfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from fuzz.members import BOMB_MB, add_bomb

from hostile_cases.case import Case
from hostile_cases.releases import bomb_yaml
from hostile_cases.settings import HEAD

METHOD = "method"
TRAIN = "train {} --data benchmark --out run --device cpu"
GO_ON, ANEW = TRAIN.format("run/config.yaml"), TRAIN.format("own.yaml")
PREDICT, CONVERT = "predict run benchmark --device cpu", "convert recgan theirs --out ours"
# Torch makes this folder when it is loaded to train.
CACHE = {"TORCHINDUCTOR_CACHE_DIR": "cache"}


def cases() -> Iterator[Case]:
    if not find_spec("torch"):
        return
    yield Case("L", "a method that is whole", PREDICT, whole=METHOD, statuses=(0,), variables=CACHE)
    for name, damage in CHECKPOINTS.items():
        yield _case("M1", name, GO_ON, "run/checkpoint.pt", damage, 1)
    for name, damage in WEIGHTS.items():
        yield _case("M1", name, PREDICT, "run/weights.npz", damage, 1, errors=20)
    for name, content in INDICES.items():
        yield _case("M2", name, CONVERT, "theirs/model.index", _bytes(content), 1)
    for name, text in CONFIGS.items():
        yield _case("M3", name, ANEW, "own.yaml", _text(text), 2, errors=22)
        yield _case("M3", name, PREDICT, "run/config.yaml", _text(text), 2, errors=22)
    for name, text in COURSES.items():
        yield _case("M3", name, PREDICT, "run/training.json", _text(text), 1)


def _case(
    group: str,
    name: str,
    command: str,
    file: str,
    damage: Callable[[Path], object],
    status: int,
    errors: int = 1,
) -> Case:
    """A file of a method that is damaged; the command names it."""

    def make(folder: Path) -> None:
        (folder / file).parent.mkdir(exist_ok=True)
        damage(folder / file)

    named = f"{file}: {name}"
    return Case(group, named, command, make, METHOD, (status,), file, errors, variables=CACHE)


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8")


def _bytes(content: Callable[[], bytes]) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content())


def make_method(folder: Path) -> None:
    """`benchmark/`, a training on it in `run/` that was stopped after two of its five steps, and no more."""
    from small_method import RECORDINGS, TINY
    from synthetic_release import publish_synthetic

    from kinectbench.networks.config import read_config
    from kinectbench.networks.train import train
    from kinectbench.release.release import open_release

    folder.mkdir()
    release = open_release(publish_synthetic(folder, RECORDINGS).folder)
    shutil.rmtree(folder / "build")
    (folder / "tiny.yaml").write_text(TINY, encoding="utf-8")

    def stop(done: int, _total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    try:
        train(read_config(folder / "tiny.yaml"), [release], folder / "run", device="cpu", progress=stop)
    except KeyboardInterrupt:
        return


def _changed(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    """Another content of a checkpoint."""

    def damage(path: Path) -> None:
        import torch

        content = torch.load(path, weights_only=True)
        torch.save(change(content), path)

    return damage


def _with_state(**values: object) -> Callable[[Path], None]:
    return _changed(lambda content: content | {"state": content["state"] | values})


def _with_adam(value: object) -> Callable[[Path], None]:
    state = {0: {"step": value, "exp_avg": value, "exp_avg_sq": value}}
    return _changed(lambda content: content | {"optimisers": [{"state": state}]})


def _packed(path: Path) -> None:
    """Values that unpack to more than 1 GB: torch would unpack them."""
    with zipfile.ZipFile(path) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    with path.open("wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            if not name.endswith("data/0"):
                archive.writestr(name, content)
        name = next(name for name, _ in members if name.endswith("data/0"))
        archive.writestr(name, bytes(BOMB_MB << 20))


def _many_rows(path: Path) -> None:
    row = {"step": 1, "epoch": 0.4, "loss": 1.0}
    _with_state(rows=[dict(row) for _ in range(200_000)])(path)


CHECKPOINTS: dict[str, Callable[[Path], object]] = {
    "no bytes": lambda path: path.write_bytes(b""),
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-1000]),
    "a pickle": lambda path: path.write_bytes(b"\x80\x04cos\nsystem\n(S'id'\ntR."),
    "a list": _changed(lambda content: [content]),
    "a key more in its state": _with_state(more=1),
    "step a": _with_state(step="a"),
    "step -3": _with_state(step=-3),
    "step 10^30": _with_state(step=10**30),
    "numbers for tensors": _with_adam(3),
    "200,000 rows": _many_rows,
    "values of 1 GB": _packed,
}


def _arrays(**arrays: Any) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        np.savez_compressed(path, **arrays)

    return damage


def _npz_bomb(path: Path) -> None:
    """A value of the network, of more than 1 GB."""
    import io

    from hostile_cases.pairs import _npy

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        add_bomb(archive, buffer, zipfile.ZipInfo("to_vector.weight.npy"), _npy((BOMB_MB << 10, 1 << 10)))
    path.write_bytes(buffer.getvalue())


WEIGHTS: dict[str, Callable[[Path], object]] = {
    "no bytes": lambda path: path.write_bytes(b""),
    "a value of 1 GB": _npz_bomb,
    "of another network": _arrays(more=np.zeros(3, np.float32)),
    "high bytes first": _arrays(more=np.zeros(3, ">f4")),
    "long doubles": _arrays(more=np.zeros(3, np.longdouble)),
    "objects": _arrays(more=np.array([{}], object)),
    "text": _arrays(more=np.array(["a"])),
}


def _bundle(entries: bytes, handles: int = 1) -> bytes:
    """An index of one block, which the root names so many times."""
    from tensor_bundle_writer import MAGIC, varint

    first = _block(entries)
    handle = varint(0) + varint(len(first) - 5)
    root = _block(b"".join(_entry(0, b"", handle) for _ in range(handles)))
    places = varint(0) + varint(0) + varint(len(first)) + varint(len(root) - 5)
    return first + root + places.ljust(40, b"\0") + MAGIC


def _block(entries: bytes) -> bytes:
    from kinectbench.networks.tensor_bundle import masked_crc32c

    content = entries + bytes(4) + (1).to_bytes(4, "little") + b"\0"
    return content + masked_crc32c(content).to_bytes(4, "little")


def _entry(shared: int, key: bytes, value: bytes) -> bytes:
    from tensor_bundle_writer import varint

    return varint(shared) + varint(len(key)) + varint(len(value)) + key + value


def _of_one_prefix(size: int, count: int = 9990) -> bytes:
    return _bundle(
        _entry(0, b"k" * size, b"") + b"".join(_entry(size, b"%04d" % n, b"") for n in range(count))
    )


INDICES: dict[str, Callable[[], bytes]] = {
    "no bytes": lambda: b"",
    "4 MB of key, shared by all": lambda: _of_one_prefix(4 << 20),
    "1 MB of key, shared by all": lambda: _of_one_prefix(1 << 20),
    "4 KB of key, shared by all": lambda: _of_one_prefix(4092),
    "a block of 7 MB, 700,000 times": lambda: _bundle(_entry(0, b"k", b"") * (1 << 21), 700_000),
    "a block of 1 MB, 100,000 times": lambda: _bundle(_entry(0, b"k", b"\x12\0" * 2000) * 250, 100_000),
    "empty keys": lambda: _bundle(_entry(0, b"", b"") * 400_000),
}
CONFIGS = {
    "empty": "",
    "a list": "[]",
    "brackets": "[" * 100_000,
    "a billion laughs": HEAD + bomb_yaml(),
    "unknown keys": HEAD + "".join(f"k{number}: 1\n" for number in range(30_000)),
    "a network that is none": HEAD + "network: {kind: [], channel_divisor: .nan, output_cells: 1.0e+99}\n",
}
COURSES = {"empty": "", "a list": "[]", "brackets": "[" * 100_000, "a number": '{"name": 1}'}
