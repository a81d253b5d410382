"""What is taken out of a release before it is written, and what is refused."""

import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from raising import raises
from read_pictures import decoded_picture
from synthetic_release import RECORDINGS, synthetic_settings, write_build, write_json

from kinectbench.core.artefacts.provenance import Removed, ThresholdsFile
from kinectbench.core.errors import ReleaseError
from kinectbench.core.jpeg_metadata import without_metadata
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.privacy import scrubbed, scrubbed_file
from kinectbench.release.publish.publish import publish

NAMES = [recording[0] for recording in RECORDINGS]


def photo() -> bytes:
    """A JPEG with a GPS position, a serial number and a comment."""
    pixels = np.random.default_rng(0).integers(0, 256, (32, 48, 3), np.uint8)
    exif = Image.Exif()
    exif.get_ifd(0x8825).update({1: "N", 2: (51.0, 45.0, 7.0)})
    exif.get_ifd(0x8769)[0xA431] = "A00366823415"
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", exif=exif, comment=b"by Jo", quality=90)
    return buffer.getvalue()


def decoded(data: bytes) -> np.ndarray:
    return np.asarray(decoded_picture(data))


def test_jpeg() -> None:
    data = photo()
    assert b"A00366823415" in data and b"by Jo" in data
    clean, removed = without_metadata(data)
    assert removed == ["EXIF (GPS position, serial number)", "comment"]
    assert b"A00366823415" not in clean and b"by Jo" not in clean
    assert not Image.open(io.BytesIO(clean)).getexif()
    np.testing.assert_array_equal(decoded(clean), decoded(data))
    assert without_metadata(clean) == (clean, [])


def segment(marker: int, payload: bytes) -> bytes:
    return bytes((0xFF, marker)) + (len(payload) + 2).to_bytes(2, "big") + payload


def test_only_what_decodes_the_pixels_is_kept_of_a_segment() -> None:
    plain, _ = without_metadata(photo())
    jfif, adobe = plain[6:20], b"Adobe" + bytes((0, 100, 0, 0, 0, 0, 1))
    assert plain[:6] + jfif == plain[:2] + segment(0xE0, jfif)
    with_thumbnail = segment(0xE0, jfif[:12] + bytes((2, 1)) + b"FACE!!") + segment(0xE0, b"JFXX\0\x13FACE")
    data = plain[:2] + with_thumbnail + segment(0xEE, adobe + b"Anna") + plain[20:]
    clean, removed = without_metadata(data)
    assert removed == ["thumbnail", "thumbnail", "APP14"]
    assert clean == plain[:20] + segment(0xEE, adobe) + plain[20:]
    np.testing.assert_array_equal(decoded(clean), decoded(data))
    assert without_metadata(clean) == (clean, [])


def test_what_follows_the_picture_is_taken_out() -> None:
    """A telephone puts a second picture behind the first; a comment may stand between scans."""
    buffer = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 256, (32, 48, 3), np.uint8)
    Image.fromarray(pixels).save(buffer, "JPEG", progressive=True)
    plain = buffer.getvalue()
    assert without_metadata(plain) == (plain, []) and plain.count(b"\xff\xda") > 1
    clean, removed = without_metadata(plain + photo())
    assert (clean, removed) == (plain, ["data after the picture"])
    comment = b"\xff\xfe\0\x0bby Jo Doe"
    second = plain.rindex(b"\xff\xda")
    between = plain[:second] + comment + plain[second:]
    assert without_metadata(between) == (plain, ["comment"])
    assert without_metadata(plain[:-2] + comment + plain[-2:]) == (plain, ["comment"])
    damaged = plain[:-200] + b"\xff\xe1\x00\x09" + plain[-196:]  # of a scan: no segment follows
    assert without_metadata(damaged) == (damaged, [])
    assert without_metadata(plain + bytes(9)) == (plain, [])  # some cameras fill up with zeros
    assert without_metadata(plain[:-2]) == (plain[:-2], [])  # and some leave the end marker out


@pytest.mark.parametrize(
    "data", [b"\xff\xd8\xff\xd9", b"", b"\x89PNG", photo()[:30], b"\xff\xd8\xff\xe1\x00\x01"]
)
def test_what_is_no_jpeg(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"JPEG|damaged"):
        without_metadata(data)


@pytest.mark.parametrize(
    ("value", "clean", "removed"),
    [
        ({"serial_number": "A1", "n": 2}, {"n": 2}, ["the key 'serial_number'"]),
        ({"a": {"gps": {"lat": 1.0}}}, {"a": {}}, ["the key 'gps'"]),
        ({"w": ["see /home/jo/chair.bag: bad"]}, {"w": ["see chair.bag: bad"]}, ["a path in 'w'"]),
        ({"w": r"C:\Users\jo\x.bag"}, {"w": "x.bag"}, ["a path in 'w'"]),
        ({"w": "ask jo@example.org"}, {"w": "ask (address removed)"}, ["an e-mail address in 'w'"]),
        ({"w": r"C:\Users\Jo Doe\x.bag: bad"}, {"w": "x.bag: bad"}, ["a path in 'w'"]),
        ({"w": r"C:\x.bag and then y/z"}, {"w": "x.bag and then y/z"}, ["a path in 'w'"]),
        ({"w": "/Users/jo doe/b/x: bad"}, {"w": "x: bad"}, ["a path in 'w'"]),
        ({"w": "at /nfs/home/jo/b/x, bad"}, {"w": "at x, bad"}, ["a path in 'w'"]),
        ({"w": "file:///home/jo/x.bag"}, {"w": "x.bag"}, ["a path in 'w'"]),
        ({"w": "no /scratch2/jo/x"}, {"w": "no x"}, ["a path in 'w'"]),
        ({"w": "no /lab3/jo/x.bag"}, {"w": "no x.bag"}, ["a path in 'w'"]),
        (
            {"w": "no /home/jo and no /Users/al"},
            {"w": "no (path removed) and no (path removed)"},
            ["a path in 'w'"],
        ),
        ({"w": "/Users/Anna Smith"}, {"w": "(path removed)"}, ["a path in 'w'"]),
        ({"w": "in '/home/Anna B Smith', bad"}, {"w": "in '(path removed)', bad"}, ["a path in 'w'"]),
        ({"w": r"C:\Users\Anna Smith"}, {"w": "(path removed)"}, ["a path in 'w'"]),
        ({"to": {"jo@example.org": 1, "n": 2}}, {"to": {"n": 2}}, ["the key '(address removed)'"]),
        # What only looks alike stays.
        ({"w": "https://example.org/home/x.html"}, {"w": "https://example.org/home/x.html"}, []),
        ({"w": "one of a/b.c and 3/4.5"}, {"w": "one of a/b.c and 3/4.5"}, []),
        ({"topic": "/camera/depth/image_raw"}, {"topic": "/camera/depth/image_raw"}, []),
        ({"serialisation": 1, "use": "tracked/lost"}, {"serialisation": 1, "use": "tracked/lost"}, []),
    ],
)
def test_json(value: object, clean: object, removed: list[str]) -> None:
    found: list[Removed] = []
    assert scrubbed(value, "f.json", found) == clean
    assert found == [Removed(file="f.json", what=what) for what in removed]


def test_keys_that_are_data_are_kept() -> None:
    """Categories are keys of thresholds.json: a phone is no phone number. Keys that no model has may be."""
    found: list[Removed] = []
    of = {"phone": 0.5, "desk_phone": 0.4, "user_chair": 0.3, "location_x": 0.2}
    beside: dict[str, Any] = {"gps": {"lat": 1.0}, "notes": {"user": "jo", "n": 1}}
    clean = scrubbed_file(ThresholdsFile(thresholds=of, **beside), "thresholds.json", found)
    assert clean.thresholds == of
    assert clean.model_extra == {"notes": {"n": 1}}
    assert [row.what for row in found] == ["the key 'gps'", "the key 'user'"]


def test_a_release_with_color(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    (tmp_path / "build/chair_02/views/000.color.jpg").write_bytes(photo())
    quality = {"repeatability_iou": 0.9, "device_serial": "A00366823415", "warnings": ["read /home/jo/x.bag"]}
    write_json(tmp_path / "build/chair_02/object/quality.json", quality)
    settings = synthetic_settings(publish={"color": True})
    summary = publish(settings, tmp_path / "build", tmp_path / "b", ["chair_02"])
    report = json.loads((tmp_path / "b" / "privacy.json").read_text())
    assert report["color"] == "published"
    assert {"file": "views/chair_02/000.color.jpg", "what": "EXIF (GPS position, serial number)"} in report[
        "removed"
    ]
    assert "removed from 2 files: the key 'device_serial'" in summary.removed  # quality.json, benchmark.json
    for path in (tmp_path / "b").rglob("*"):
        assert path.is_dir() or not any(word in path.read_bytes() for word in (b"A00366823415", b"/home/jo"))
    plain = publish(synthetic_settings(), tmp_path / "build", tmp_path / "c", ["chair_02"])
    assert json.loads((plain.folder / "privacy.json").read_text())["color"] == "left out"
    for image in (tmp_path / "build").rglob("*.jpg"):
        image.unlink()
    publish(synthetic_settings(), tmp_path / "build", tmp_path / "c", ["chair_02"])
    assert json.loads((plain.folder / "privacy.json").read_text())["color"] == "none"


def test_an_address_in_the_source_stays_in_both_places(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    said = "the Chair Lab, chairs@lab.example, /home/lab/README.md"
    settings = synthetic_settings(source=said, license=f"ask {said}")
    published = publish(settings, tmp_path / "build", tmp_path / "b", ["chair_02"])
    info = json.loads((tmp_path / "b" / "benchmark.json").read_text())
    assert info["settings"]["source"] == info["recordings"]["chair_02"]["source"] == said
    assert not any("source" in line or "license" in line for line in published.removed)
    assert verify(tmp_path / "b") == []


def test_a_damaged_photo_is_not_published(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    (tmp_path / "build/chair_02/views/000.color.jpg").write_bytes(photo()[:30])
    with raises(ReleaseError, "release.not-built", match=r"000\.color\.jpg"):
        publish(synthetic_settings(publish={"color": True}), tmp_path / "build", tmp_path / "b", ["chair_02"])


def test_a_folder_that_is_no_release_stays(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    out = tmp_path / "b"
    out.mkdir()
    publish(synthetic_settings(), tmp_path / "build", out, ["chair_02"])  # an empty one may be filled
    (out / "predictions").mkdir()
    (out / "predictions" / "000.npz").write_text("of a week")
    with raises(ReleaseError, "release.other-content", match=r"predictions/000\.npz"):
        publish(synthetic_settings(), tmp_path / "build", out, ["chair_02"])
    assert (out / "predictions" / "000.npz").is_file()
    shutil.rmtree(out)
    out.mkdir()
    (out / "thesis.txt").write_text("precious")
    with raises(ReleaseError, "release.other-content"):
        publish(synthetic_settings(), tmp_path / "build", out, NAMES)
    assert (out / "thesis.txt").read_text() == "precious"
    (out / "benchmark.json").write_text("{}")  # without SHA256SUMS nobody knows what is of the release
    with raises(ReleaseError, "release.other-content", match="SHA256SUMS"):
        publish(synthetic_settings(), tmp_path / "build", out, NAMES)
    assert (out / "thesis.txt").read_text() == "precious"


def test_a_hidden_file_beside_a_release_stays(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    out = tmp_path / "b"
    publish(synthetic_settings(), tmp_path / "build", out, ["chair_02"])
    (out / ".lock").touch()  # of a killed fetch
    (out / "pairs/.DS_Store").touch()  # of a file manager that showed the folder
    publish(synthetic_settings(), tmp_path / "build", out, ["chair_02"])
    (out / ".env").write_text("precious")
    with raises(ReleaseError, "release.other-content", match=r"\.env"):
        publish(synthetic_settings(), tmp_path / "build", out, ["chair_02"])
    assert (out / ".env").read_text() == "precious"
