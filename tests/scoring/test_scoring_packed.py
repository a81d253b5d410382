"""Packed predictions: the same at every searched threshold, nearly the same cross-entropy."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from synthetic_release import Recordings, publish_synthetic

from kinectbench.core.errors import PredictionError
from kinectbench.core.voxels.npz import npz_bytes
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.release.release import open_release
from kinectbench.scoring.counts import THRESHOLDS, protocol_counts, tally
from kinectbench.scoring.prediction_file import CODES, LEVELS, load_prediction, packed, unpacked
from kinectbench.scoring.truth import read_packed_truth

ONE = 0x3C00
RECORDINGS: Recordings = (("chair_01", "chair", "chair_a", "test", 1),)


def every_value() -> np.ndarray:
    """(256, 256, 256): every float16 from 0 to 1 many times over."""
    bits = np.arange(256**3, dtype=np.uint32) % (ONE + 1)
    return bits.astype(np.uint16).view(np.float16).reshape((256,) * 3)


def test_no_value_crosses_a_threshold() -> None:
    """Whatever the value: the level that stands for it is above the same thresholds."""
    values = every_value()[0, 0:61].ravel()[: ONE + 1]
    assert values[0] == 0 and values[-1] == 1
    arrays = packed(every_value())
    assert arrays is not None
    levels, found = arrays[LEVELS], unpacked(arrays[LEVELS], arrays[CODES]).ravel()[: ONE + 1]
    assert (np.diff(levels) > 0).all() and levels[0] == 0 and levels[-1] == 1 and len(levels) <= 256
    for threshold in THRESHOLDS:
        np.testing.assert_array_equal(
            found.astype(np.float64) > threshold, values.astype(np.float64) > threshold
        )
    assert (found[values == 0] == 0).all() and (found[values == 1] == 1).all()


def test_a_score_of_packed_predictions(tmp_path: Path) -> None:
    """A network that is unsure near surfaces: all counts are equal, the cross-entropy within 0.1 %."""
    release = open_release(publish_synthetic(tmp_path, RECORDINGS).folder)
    (target,) = release.split("test")
    truth = read_packed_truth(release.pair_path(target), target.sha256)
    noise = np.random.default_rng(0).normal(0, 2, (256,) * 3)
    logits = np.where(unpack(truth.full), 1.5, -6) + noise
    probability = (1 / (1 + np.exp(-logits))).astype(np.float16)
    arrays = packed(probability)
    assert arrays is not None
    (tmp_path / "000.npz").write_bytes(npz_bytes(arrays))
    found = load_prediction(tmp_path / "000.npz")
    assert found.dtype == np.float16 and found.shape == probability.shape
    before, after = tally(probability, truth), tally(found, truth)
    np.testing.assert_array_equal(after.above, before.above)
    for protocol in ("known", "paper", "occluded"):
        sums = [protocol_counts(of, protocol).ce_sum for of in (before, after)]
        assert abs(sums[1] / sums[0] - 1) < 1e-3, (protocol, sums)


def test_what_is_no_probability_is_not_packed() -> None:
    """Nor what is interpolated before it is counted. Zero may have a sign."""
    values = every_value()
    assert packed(values[:64, :64, :64].copy()) is None
    for wrong in (np.nan, np.inf, -0.5, 1.5):
        values[1, 2, 3] = wrong
        assert packed(values) is None
    values[1, 2, 3] = -0.0
    arrays = packed(values)
    assert arrays is not None and arrays[CODES][1, 2, 3] == 0


GOOD_LEVELS = np.array([0.0, 0.3, 1.0], np.float16)
GOOD_CODES = np.full((4, 4, 4), 2, np.uint8)
WRONG: dict[str, tuple[np.ndarray, np.ndarray, str]] = {
    "a code too many": (GOOD_LEVELS[:2], GOOD_CODES, r"2 in codes at \(0, 0, 0\): there are 2 levels"),
    "no level": (GOOD_LEVELS[:0], GOOD_CODES, "levels must be 1 to 256 of float16 or float32"),
    "many levels": (np.zeros(257, np.float16), GOOD_CODES, "levels must be 1 to 256"),
    "levels of another kind": (np.zeros(3), GOOD_CODES, "levels must be 1 to 256 of float16 or float32"),
    "a level above one": (GOOD_LEVELS + 1, GOOD_CODES, "every value must be in"),
    "no number": (GOOD_LEVELS * np.nan, GOOD_CODES, "every value must be in"),
    "codes of another kind": (GOOD_LEVELS, GOOD_CODES.astype(np.int8), r"codes must be \(n, n, n\) uint8"),
    "no cube": (GOOD_LEVELS, GOOD_CODES[:3], r"codes must be \(n, n, n\) uint8"),
    "nothing": (GOOD_LEVELS, GOOD_CODES[:0, :0, :0], r"codes must be \(n, n, n\) uint8"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_packed_files_are_told(name: str, tmp_path: Path) -> None:
    levels, codes, message = WRONG[name]
    path = tmp_path / "000.npz"
    path.write_bytes(npz_bytes({LEVELS: levels, CODES: codes}))
    with pytest.raises(PredictionError, match=message) as caught:
        load_prediction(path, "chair_01/000")
    assert str(caught.value).startswith("chair_01/000: ") and "\n" not in str(caught.value)


def test_packed_files_of_others(tmp_path: Path) -> None:
    """In any order of arrays and axes, any side, float32 or foreign bytes; a third array is refused."""
    path = tmp_path / "000.npz"
    codes = np.arange(64, dtype=np.uint8).reshape(4, 4, 4) % 3
    for levels in (GOOD_LEVELS, GOOD_LEVELS.astype(np.float32), GOOD_LEVELS.astype(">f2")):
        np.savez(path, codes=np.asfortranarray(codes), levels=levels)
        found = load_prediction(path)
        assert found.dtype == levels.dtype.newbyteorder("=") and found.flags.c_contiguous
        np.testing.assert_array_equal(found, levels[codes])
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("more.npy", b"")
    with raises(PredictionError, "prediction.malformed", match="holds 3 arrays"):
        load_prediction(path)


def test_packed_bits_in_fortran_order(tmp_path: Path) -> None:
    """As `np.packbits(grid.transpose(2, 1, 0), axis=-1)` is saved: the same cells, in C order."""
    cells = np.random.default_rng(0).integers(0, 2, (16, 16, 16)).astype(bool)
    path = tmp_path / "000.npy"
    np.save(path, np.asfortranarray(np.packbits(cells, axis=-1)))
    found = load_prediction(path)
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, cells)


def test_one_array_of_a_packed_prediction_is_none(tmp_path: Path) -> None:
    """Codes without levels, and levels without codes: the line names both keys."""
    path = tmp_path / "000.npz"
    for arrays in ({CODES: GOOD_CODES}, {LEVELS: GOOD_LEVELS}):
        path.write_bytes(npz_bytes(arrays))
        with pytest.raises(PredictionError) as caught:
            load_prediction(path, "chair_01/000")
        said = f"chair_01/000: holds 1 array ({next(iter(arrays))}): it must hold exactly one prediction, or "
        assert str(caught.value) == f"{said}codes and levels"
