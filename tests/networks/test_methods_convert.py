"""The authors' checkpoint: its released index, and a narrow one in the same format run against numpy."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from narrow_recgan import RELEASED, narrow_recgan
from plain_recgan import plain_discriminator, plain_generator
from raising import raises
from synthetic_release import synthetic_pair
from tensor_bundle_writer import block, crc32c, entry, field, masked, table, varint, write_bundle

from kinectbench.core.errors import StorageError
from kinectbench.core.types import Float32
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.networks import convert as conversion
from kinectbench.networks.convert import convert_recgan, fitting_config, mapping
from kinectbench.networks.recgan import RecGAN
from kinectbench.networks.registry import make_network
from kinectbench.networks.tensor_bundle import open_bundle
from kinectbench.networks.trained import open_trained
from kinectbench.networks.validate import completed


def test_the_released_index_holds_the_networks_of_the_paper() -> None:
    """Every tensor of generator and discriminator has the shape that ours needs, and no other is left."""
    bundle = open_bundle(RELEASED)
    names, config = mapping(), fitting_config(bundle.tensors, RELEASED)
    assert (config.network.channel_divisor, config.network.axes) == (1, "recgan")
    shapes = {
        name: tuple(values.shape)
        for name, values in make_network(config.network, device="meta").state_dict().items()
    }
    assert sorted(to.name for to in names.values()) == sorted(shapes)
    wanted = {name: to.stored_shape(shapes[to.name]) for name, to in names.items()}
    assert conversion.tensor_misfits(bundle.tensors, wanted) == []
    counts = dict.fromkeys(("aeu", "dis"), 0)
    for name in names:
        counts[name[:3]] += int(np.prod(bundle.tensors[name].shape))
    assert counts == {"aeu": 164_282_729, "dis": 2_794_488}
    left = [name for name in bundle.tensors if name not in names]
    assert len(left) == 2 * len(names) + 4 and all(
        name.endswith(conversion.OF_THE_OPTIMISER) for name in left
    )
    assert bundle.data_path().name == "model.cptk.data-00000-of-00001"
    assert sum(tensor.size for tensor in bundle.tensors.values()) == 12 * 167_077_217 + 16


def test_the_index_without_its_values_says_what_is_missing(tmp_path: Path) -> None:
    with raises(StorageError, "storage.damaged", match="model.cptk.data-00000-of-00001"):
        convert_recgan(RELEASED.parent, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Float32], Path]:
    root = tmp_path_factory.mktemp("converted")
    tensors = narrow_recgan()
    more: dict[str, np.ndarray] = {f"{name}/Adam": np.zeros_like(values) for name, values in tensors.items()}
    more |= {"beta1_power": np.array(0.5, np.float32), "global_step": np.zeros(3)}
    write_bundle(root / "theirs", tensors | more)
    made = convert_recgan(root / "theirs", root / "ours")
    assert (made.tensors, made.optimiser) == (36, 37)
    assert made.left_out == ("global_step (3,)",)
    counts = {
        part: sum(v.size for name, v in tensors.items() if name.startswith(part)) for part in ("aeu", "dis")
    }
    assert (made.generator, made.discriminator) == (counts["aeu"], counts["dis"])
    return tensors, root / "ours"


def test_the_converted_generator_is_the_plain_one(converted: tuple[dict[str, Float32], Path]) -> None:
    """At 64^3 to 256^3, in the authors' axes; a prediction is given in ours."""
    tensors, folder = converted
    trained = open_trained(folder)
    partial = unpack(synthetic_pair(2, "table").partial)
    theirs = np.ascontiguousarray(partial[::-1, ::-1])
    plain = plain_generator(tensors, theirs)
    assert plain.std() > 0.01  # or else nothing is compared
    with torch.inference_mode():
        ours = trained.network.completed(torch.from_numpy(theirs)[None, None].float())[0, 0].numpy()
    np.testing.assert_allclose(ours, plain, atol=2e-5)
    prediction = completed(trained.network, partial, trained.config, "cpu")
    np.testing.assert_allclose(prediction, plain[::-1, ::-1], atol=1e-3)


def test_the_converted_discriminator_is_the_plain_one(converted: tuple[dict[str, Float32], Path]) -> None:
    tensors, folder = converted
    network = open_trained(folder).network
    assert isinstance(network, RecGAN)
    generator = np.random.default_rng(3)
    partial, shape = generator.random((64, 64, 64)) > 0.9, generator.random((256, 256, 256)) > 0.5
    plain = plain_discriminator(tensors, partial, shape)
    with torch.inference_mode():
        grids = (torch.from_numpy(grid)[None, None].float() for grid in (partial, shape))
        ours = network.discriminator(*grids)[0].numpy()
    assert plain.std() > 0.01
    np.testing.assert_allclose(ours, plain, atol=2e-5)


def test_what_was_converted_says_where_it_is_from(converted: tuple[dict[str, Float32], Path]) -> None:
    told = json.loads((converted[1] / "training.json").read_text())
    assert told["name"] == "3d-recgan++-released" and "model.cptk.index with SHA-256 " in told["source"]


def test_every_tensor_that_does_not_fit_is_named(tmp_path: Path) -> None:
    tensors = narrow_recgan()
    del tensors["aeu/fc2_b"]
    tensors["dis/d6_w"] = tensors["dis/d6_w"][..., :-1]
    write_bundle(tmp_path / "theirs", tensors)
    with pytest.raises(StorageError) as error:
        convert_recgan(tmp_path / "theirs", tmp_path / "out")
    told = [line.partition(": ")[2] for line in error.value.lines]
    assert told == [
        "'dis/d6_w' is (4, 4, 4, 8, 15) where the network needs (4, 4, 4, 8, 16)",
        "'aeu/fc2_b' is missing",
    ]
    assert not (tmp_path / "out").exists()


def test_a_changed_value_is_found(tmp_path: Path) -> None:
    index = write_bundle(tmp_path, narrow_recgan())
    data = index.with_suffix(".data-00000-of-00001")
    content = bytearray(data.read_bytes())
    content[-5] ^= 1
    data.write_bytes(content)
    with raises(StorageError, "storage.damaged", match=r"the checksum of '\S+' is wrong; get the file again"):
        convert_recgan(tmp_path, tmp_path / "out")
    data.write_bytes(content[:1000])
    with raises(StorageError, "storage.damaged", match=r"too short for '\S+'; get the file again"):
        convert_recgan(tmp_path, tmp_path / "out")


HEADER = {b"": field(1, 1)}
ONE = HEADER | {b"a": entry((2,), 0, 8, 0)}
DAMAGED = {
    "empty": (b"", "its last bytes are others"),
    "no table": (b"x" * 100, "its last bytes are others"),
    "cut off": (RELEASED.read_bytes()[1000:], "block"),
    "a bit": (
        RELEASED.read_bytes().replace(b"beta1_power", b"beta1_pover"),
        "the checksum of a block is wrong",
    ),
    "compressed": (table(ONE, kind=1), "its blocks are compressed"),
    "no header": (table({b"a": entry((2,), 0, 8, 0)}), "it has no header"),
    "no tensors": (table(HEADER), "it names no tensors"),
    "high bytes first": (
        table({b"": field(1, 1) + field(2, 1), b"a": entry((2,), 0, 8, 0)}),
        "high bytes first",
    ),
    "slices": (table(HEADER | {b"a": field(7, b"x")}), "a tensor in slices"),
    "axes": (table(HEADER | {b"a": entry((1,) * 9, 0, 4, 0)}), "too many axes"),
    "a field cut off": (table(HEADER | {b"a": varint(2 << 3 | 2) + varint(99)}), "a field is cut off"),
    "no shard": (table({b"": b"", b"a": entry((2,), 0, 8, 0)}), "data files that there are not"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_index_is_told_in_one_line(tmp_path: Path, name: str) -> None:
    content, words = DAMAGED[name]
    (tmp_path / "model.index").write_bytes(content)
    with raises(StorageError, "storage.damaged", match=words) as error:
        convert_recgan(tmp_path, tmp_path / "out")
    assert len(error.value.lines) == 1


def test_values_that_are_not_float32_are_told(tmp_path: Path) -> None:
    tensors = narrow_recgan()
    index = write_bundle(tmp_path, tensors)
    bundle = open_bundle(index)
    entries = {
        name.encode(): entry(t.shape, t.offset, t.size, t.crc, kind=19 if name == "aeu/e1_w" else 1)
        for name, t in bundle.tensors.items()
    }
    index.write_bytes(table(HEADER | entries))
    with raises(StorageError, "storage.damaged", match="float32"):
        convert_recgan(tmp_path, tmp_path / "out")


@pytest.mark.parametrize("files", [[], ["a.index", "b.index"]])
def test_a_folder_without_one_checkpoint_is_told(tmp_path: Path, files: list[str]) -> None:
    for name in files:
        (tmp_path / name).touch()
    with raises(StorageError, "storage.damaged", match="checkpoints? there"):
        convert_recgan(tmp_path, tmp_path / "out")


def test_another_network_is_told(tmp_path: Path) -> None:
    write_bundle(tmp_path, {"other/w": np.zeros((3, 4), np.float32)})
    with raises(StorageError, "storage.damaged", match=r"3D-RecGAN\+\+"):
        convert_recgan(tmp_path, tmp_path / "out")


def test_the_checksum_is_that_of_the_standard() -> None:
    """Of RFC 3720, appendix B.4, and as both programs compute it."""
    from kinectbench.networks.tensor_bundle import masked_crc32c

    assert crc32c(bytes(32)) == 0x8A9136AA and crc32c(b"123456789") == 0xE3069283
    for text in (b"", bytes(32), b"123456789", block({b"a": b"b"})):
        assert masked_crc32c(text) == masked(crc32c(text))
