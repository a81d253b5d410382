"""Files of strangers: checkpoints, weights and indices end in one line, within time and memory."""

import resource
import shutil
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from peak_memory import peak_mb
from raising import raises
from small_method import TINY
from tensor_bundle_writer import MAGIC, block, crc32c, entry, field, masked, table, varint

from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.networks import tensor_bundle
from kinectbench.networks.config import NetworkSettings, read_config
from kinectbench.networks.registry import NETWORKS, make_network
from kinectbench.networks.run_folder import CHECKPOINT, CONFIG
from kinectbench.networks.tensor_bundle import masked_crc32c, open_bundle
from kinectbench.networks.train import train
from kinectbench.networks.trained import open_trained
from kinectbench.networks.weights import read_weights, shapes_of_network, write_weights
from kinectbench.release.release import Release

Content = dict[str, Any]


@pytest.fixture
def memory_for_1_gb() -> Iterator[None]:
    """Whoever asks for 1 GB more than there is in use gets a MemoryError."""
    used = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
    kept = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + (1 << 30), kept[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, kept)


@pytest.fixture(scope="module")
def stopped(learning: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that was stopped after two of five steps."""
    root = tmp_path_factory.mktemp("stopped")
    (root / "tiny.yaml").write_text(TINY)

    def stop(done: int, _total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(read_config(root / "tiny.yaml"), [learning], root / "run", device="cpu", progress=stop)
    return root / "run"


def in_state(**values: Any) -> Callable[[Content], Any]:
    return lambda content: content | {"state": content["state"] | values}


def in_adam(name: str, value: Any) -> Callable[[Content], Any]:
    """Another value for the first parameter."""

    def change(content: Content) -> Content:
        content["optimisers"][0]["state"][0][name] = value
        return content

    return change


ROW = {"step": 1, "epoch": 0.4, "loss": 1.0}
CHANGES: dict[str, Callable[[Content], Any]] = {
    "a list": lambda content: [content],
    "a number": lambda content: 3,
    "a key more": lambda content: content | {"more": 1},
    "a key less": lambda content: {k: v for k, v in content.items() if k != "network"},
    "a network that is a list": lambda content: content | {"network": [1]},
    "releases that are a number": lambda content: content | {"benchmarks_sha256": 1},
    "releases that are numbers": lambda content: content | {"benchmarks_sha256": [1]},
    "a key more in the state": in_state(more=1),
    "a state that is a list": lambda content: content | {"state": [1]},
    "step a": in_state(step="a"),
    "step -3": in_state(step=-3),
    "step 6 of 5": in_state(step=6),
    "step 10^30": in_state(step=10**30),
    "a step that is true": in_state(step=True),
    "rows that are a number": in_state(rows=1),
    "rows that are numbers": in_state(rows=[1, 2]),
    "rows of text": in_state(rows="ab"),
    "a row of a step that was not done": in_state(rows=[ROW | {"step": 10**400}]),
    "a row twice": in_state(rows=[ROW, ROW]),
    "a row more than steps": in_state(rows=[ROW] * 3),
    "a loss of 10^300": in_state(rows=[ROW | {"loss": 1e300}]),
    "sums that are a list": in_state(sums=[1]),
    "a sum of steps": in_state(sums={"step": 1.0}),
    "sums of -1 steps": in_state(sums={"loss": 1.0, "steps": -1.0}),
    "a sum that is no number": in_state(sums={"loss": float("nan"), "steps": 1.0}),
    "an IoU that is text": in_state(best_iou="a"),
    "the best of a step to come": in_state(best_step=4),
    "seconds without end": in_state(seconds=float("inf")),
    "no optimisers": lambda content: content | {"optimisers": []},
    "an optimiser that is a number": lambda content: content | {"optimisers": [1]},
    "an optimiser without a state": lambda content: content | {"optimisers": [{}]},
    "a state of Adam that is a list": lambda content: content | {"optimisers": [{"state": [1]}]},
    "a parameter that there is not": lambda content: content | {"optimisers": [{"state": {99: {}}}]},
    "a value of Adam that is an int": in_adam("exp_avg", 3),
    "a step of Adam that is an int": in_adam("step", 3),
    "step -1 of Adam": in_adam("step", torch.tensor(-1.0)),
    "Adam of another shape": in_adam("exp_avg", torch.zeros(1).expand(10**12)),
    "Adam of another kind": in_adam("step", torch.zeros((), dtype=torch.complex64)),
    "negative squares": in_adam("exp_avg_sq", torch.full((4, 1, 4, 4, 4), -1.0)),
    "more of Adam": in_adam("max_exp_avg_sq", torch.zeros(1)),
    "a network of NaN": lambda content: (
        content | {"network": {name: values * float("nan") for name, values in content["network"].items()}}
    ),
    "a network of ints": lambda content: content | {"network": dict.fromkeys(content["network"], 1)},
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_hostile_checkpoint_is_told(stopped: Path, learning: Release, tmp_path: Path, name: str) -> None:
    path = tmp_path / CHECKPOINT
    shutil.copyfile(stopped / CONFIG, tmp_path / CONFIG)
    torch.save(CHANGES[name](torch.load(stopped / CHECKPOINT, weights_only=True)), path)
    with pytest.raises(StorageError) as error:
        train(read_config(tmp_path / CONFIG), [learning], tmp_path, device="cpu")
    assert error.value.lines == (f"{path}: cannot be read; remove it to train from the start",)


@pytest.mark.usefixtures("memory_for_1_gb")
def test_a_checkpoint_that_swells_is_told(stopped: Path, learning: Release, tmp_path: Path) -> None:
    """Torch unpacks what is packed, though it packs nothing itself."""
    shutil.copyfile(stopped / CONFIG, tmp_path / CONFIG)
    path = tmp_path / CHECKPOINT
    torch.save({"network": torch.zeros(1)}, path)
    with zipfile.ZipFile(path) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for member, content in members:
            archive.writestr(member, bytes(64 << 20) if member.endswith("data/0") else content)
    with raises(StorageError, "storage.damaged", match="cannot be read; remove it") as error:
        train(read_config(tmp_path / CONFIG), [learning], tmp_path, device="cpu")
    assert isinstance(error.value.__cause__, ValueError)


def test_what_an_optimiser_is_set_to_is_the_configurations(
    stopped: Path, learning: Release, tmp_path: Path
) -> None:
    """Of hostile settings none is taken, and the course is as it was."""
    for name in ("whole", "changed"):
        shutil.copytree(stopped, tmp_path / name)
    path = tmp_path / "changed" / CHECKPOINT
    content = torch.load(path, weights_only=True)
    content["optimisers"][0]["param_groups"] = [{"betas": "x", "params": 3}]
    torch.save(content, path)
    for name in ("whole", "changed"):
        train(read_config(stopped / CONFIG), [learning], tmp_path / name, device="cpu")
    weights = [(tmp_path / name / "weights.npz").read_bytes() for name in ("whole", "changed")]
    assert weights[0] == weights[1]


@pytest.mark.parametrize("gone", [(CONFIG,), (CONFIG, "training.json")])
def test_other_settings_do_not_go_on_where_the_configuration_is_gone(
    stopped: Path, learning: Release, tmp_path: Path, gone: tuple[str, ...]
) -> None:
    shutil.copytree(stopped, tmp_path / "run")
    (tmp_path / "other.yaml").write_text(TINY.replace("batch: 2", "batch: 2, seed: 1"))
    for name in gone:
        (tmp_path / "run" / name).unlink()
    with raises(SettingsError, "settings.other-content"):
        train(read_config(tmp_path / "other.yaml"), [learning], tmp_path / "run", device="cpu")
    assert (tmp_path / "run" / CHECKPOINT).read_bytes() == (stopped / CHECKPOINT).read_bytes()


def test_a_checkpoint_without_its_settings_goes_on(stopped: Path, learning: Release, tmp_path: Path) -> None:
    """As they were written before."""
    shutil.copytree(stopped, tmp_path / "run")
    content = torch.load(tmp_path / "run" / CHECKPOINT, weights_only=True)
    assert content.pop("config_sha256") == read_config(stopped / CONFIG).sha256
    torch.save(content, tmp_path / "run" / CHECKPOINT)
    state = train(read_config(stopped / CONFIG), [learning], tmp_path / "run", device="cpu")
    assert state.step == 5


@pytest.mark.usefixtures("memory_for_1_gb")
@pytest.mark.parametrize("member", ["down.0.bias", "more"])
def test_weights_are_bounded_by_their_network(stopped: Path, tmp_path: Path, member: str) -> None:
    shutil.copytree(stopped, tmp_path / "run")
    write_weights({member: np.zeros(1 << 23, np.float32)}, tmp_path / "run" / "weights.npz")
    with raises(StorageError, "storage.damaged", match=r"33554\d+"):
        open_trained(tmp_path / "run")


@pytest.mark.parametrize("kind", NETWORKS)
def test_a_network_without_values_has_the_shapes_of_one_with(kind: str) -> None:
    settings = NetworkSettings.model_validate({"kind": kind, "channel_divisor": 64})
    assert shapes_of_network(make_network(settings, device="meta")) == shapes_of_network(
        make_network(settings)
    )


@pytest.mark.parametrize("kind", [">f4", "longdouble", "int32", "bool", "complex64"])
def test_weights_of_other_kinds_are_told(tmp_path: Path, kind: str) -> None:
    write_weights({"a": np.ones(3, kind)}, tmp_path / "weights.npz")
    with raises(StorageError, "storage.damaged", match="float16") as error:
        read_weights(tmp_path / "weights.npz")
    assert len(error.value.lines) == 1


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [("a", 1e300, "no finite numbers"), ("b.running_var", -1.0, "negative variances")],
)
def test_weights_that_would_give_no_numbers_are_told(
    tmp_path: Path, name: str, value: float, words: str
) -> None:
    write_weights({name: np.full(3, value)}, tmp_path / "weights.npz")
    with raises(StorageError, "storage.damaged", match=words):
        read_weights(tmp_path / "weights.npz")


def test_weights_stored_column_by_column_are_told(tmp_path: Path) -> None:
    np.savez(tmp_path / "weights.npz", a=np.ones((3, 4), np.float32).T)
    with raises(StorageError, "storage.damaged", match="'a'"):
        read_weights(tmp_path / "weights.npz")


WITHIN = """
import sys
from pathlib import Path
import torch
from kinectbench.networks.weights import headers_of, set_weights
network = torch.nn.Linear(20_000, 1000)
if sys.argv[1]:
    headers_of(Path(sys.argv[1]), 1 << 30)
    set_weights(network, Path(sys.argv[1]))
    assert network.weight[-1, -1] == 0 and network.bias[-1] == 1
"""


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for the memory")
def test_weights_take_hardly_more_than_their_network(tmp_path: Path) -> None:
    """Zeros in the widest kind: a file of 160 kB that unpacks to 160 MB, for a network of 80 MB."""
    path = tmp_path / "weights.npz"
    np.savez_compressed(path, weight=np.zeros((1000, 20_000)), bias=np.ones(1000))
    assert path.stat().st_size < 200_000
    assert peak_mb(WITHIN, str(path)) < peak_mb(WITHIN, "") + 120


def raw_block(entries: bytes) -> bytes:
    content = entries + (0).to_bytes(4, "little") + (1).to_bytes(4, "little") + b"\0"
    return content + masked_crc32c(content).to_bytes(4, "little")


def raw_entry(shared: int, key: bytes, value: bytes) -> bytes:
    return varint(shared) + varint(len(key)) + varint(len(value)) + key + value


def raw_table(first: bytes, handles: int = 1) -> bytes:
    """An index of one block, which the root names so many times."""
    handle = varint(0) + varint(len(first) - 5)
    root = raw_block(b"".join(raw_entry(0, b"k%07d" % number, handle) for number in range(handles)))
    place = varint(0) + varint(0) + varint(len(first)) + varint(len(root) - 5)
    return first + root + place.ljust(40, b"\0") + MAGIC


HEADER, ONE = field(1, 1), entry((2,), 0, 8, 0)
LONG = b"k" * (1 << 20)
INDICES: dict[str, tuple[Callable[[], bytes], str]] = {
    "a long key that all others share": (
        lambda: raw_table(
            raw_block(
                raw_entry(0, b"", HEADER)
                + raw_entry(0, LONG, ONE)
                + b"".join(raw_entry(len(LONG), b"%04d" % number, ONE) for number in range(9990))
            )
        ),
        "a key or a value that is too long",
    ),
    "keys that grow": (
        lambda: raw_table(
            raw_block(b"".join(raw_entry(500 * number, b"k" * 500, b"") for number in range(2000)))
        ),
        "a key or a value that is too long",
    ),
    "a long value": (
        lambda: raw_table(raw_block(raw_entry(0, b"", HEADER) + raw_entry(0, b"a", b"\x12\0" * 400_000))),
        "a key or a value that is too long",
    ),
    "one block many times": (
        lambda: raw_table(
            raw_block(
                raw_entry(0, b"", HEADER)
                + b"".join(raw_entry(0, b"%05d" % number, ONE) for number in range(3000))
            ),
            4000,
        ),
        "it names the same block twice",
    ),
    "a block without entries many times": (
        lambda: raw_table(raw_block(b""), 9000),
        "it names the same block twice",
    ),
    "empty keys": (
        lambda: raw_table(raw_block(raw_entry(0, b"", HEADER) * 300_000)),
        "a key that is there twice",
    ),
    "one key again": (
        lambda: raw_table(raw_block(raw_entry(0, b"", HEADER) + raw_entry(0, b"a", ONE) * 2)),
        "a key that is there twice",
    ),
    "handles without end": (lambda: raw_table(raw_block(b""), 90_000), "more than 10000 entries"),
    "many tensors": (
        lambda: raw_table(
            raw_block(
                raw_entry(0, b"", HEADER)
                + b"".join(raw_entry(0, b"%06d" % number, ONE) for number in range(10_001))
            )
        ),
        "more than 10000 entries",
    ),
    "a large file": (lambda: bytes(3 << 20), "cannot be read"),
}


@pytest.mark.usefixtures("memory_for_1_gb")
@pytest.mark.parametrize("name", INDICES)
def test_an_index_costs_no_more_than_its_bytes(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, words = INDICES[name]
    path = tmp_path / "model.index"
    path.write_bytes(make())
    read = 0
    number = tensor_bundle._varint

    def counted(content: bytes, place: int) -> tuple[int, int]:
        nonlocal read
        read += 1
        return number(content, place)

    monkeypatch.setattr(tensor_bundle, "_varint", counted)
    with raises(StorageError, "storage.damaged", match=words) as error:
        open_bundle(path)
    assert len(error.value.lines) == 1 and read < 100_000


def test_two_blocks_are_read(tmp_path: Path) -> None:
    """As TensorFlow writes them where there are more tensors than one block takes."""
    first, second = block({b"": HEADER, b"a": ONE}), block({b"b": ONE})
    handles = {
        b"a0": varint(0) + varint(len(first) - 5),
        b"b0": varint(len(first)) + varint(len(second) - 5),
    }
    root = block(handles)
    place = varint(0) + varint(0) + varint(len(first + second)) + varint(len(root) - 5)
    (tmp_path / "model.index").write_bytes(first + second + root + place.ljust(40, b"\0") + MAGIC)
    assert list(open_bundle(tmp_path / "model.index").tensors) == ["a", "b"]
    assert masked(crc32c(b"")) == masked_crc32c(b"") and table({b"": HEADER})
