"""The page as a whole: self-contained, safe, stable, and there whatever is missing."""

import base64
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from analytic_scenes import health_of
from known_builds import write_manifests
from raising import raises
from read_pictures import decoded_picture
from report_fake_build import parsed_tables, score, write_build, write_pairs, write_trajectory
from rich.console import Console

from kinectbench.cli.console import summary_table
from kinectbench.core.errors import KinectBenchError, StorageError
from kinectbench.core.voxels.pair_file import pair_bytes, read_pair
from kinectbench.engine.artefact import VERSIONS
from kinectbench.engine.pipeline import Outcome
from kinectbench.engine.stages import Job
from kinectbench.engine.summary import summary
from kinectbench.report import write_report
from kinectbench.report.recording import RecordingPart, collect
from kinectbench.settings.models import BenchmarkSettings


class Reader(HTMLParser):
    """Collects what a browser would load, the text it would show, and unbalanced tags."""

    VOID = ("meta", "link", "img")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def html(settings: BenchmarkSettings, build: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("scores") / "index.html"
    scores = [score("mirror", 0.41), score("hull", 0.38), score("half", 0.2, complete=False)]
    assert write_report(settings, build, parsed_tables(scores), out) == out
    return out.read_text(encoding="utf-8")


def test_nothing_is_loaded_from_elsewhere(html: str) -> None:
    reader = Reader(html)
    assert reader.open == []
    assert all(source.startswith(("data:", "#r")) for source in reader.sources)
    written = re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    assert not re.search(r"https?:|url\(|@import|//[a-z]", written)
    assert "default-src 'none'" in html


def test_every_image_decodes_and_the_pairs_are_twice_as_wide_as_high(html: str) -> None:
    images = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', html)
    shapes = [decoded_picture(base64.b64decode(i, validate=True)).shape for i in images]
    # The object from three sides and from where its opening would be seen, six views, three pairs; then three
    # views with colour beside depth.
    # First of all it turns.
    assert len(shapes) == 1 + 4 + 6 + 3 + 3 * 2 and shapes[0] == (160, 20 * 160, 3)
    assert html.index('class="turn"') < html.index("<table")
    assert shapes[11:14] == [(120, 240, 3)] * 3


def test_shows_figures_of_every_stage(html: str) -> None:
    text = " ".join(Reader(html).text.split())
    for words in (
        "CC-BY-4.0",
        "ab" * 32,
        "2 frames disagree with the rest",
        "median residual (mm)4.2",
        "residual of 22 mm is above 15 mm <b>",
        "Not built yet: trajectory, floor, object, views, pairs.",
        "incomplete: no averages",
        "Yang, Rosa, Markham",
        "view chair_01/003, error missing",
        "published, not comparable",
        "colour is not registered to depth",
        "chair 0.35, table 0.5",
    ):
        assert words in text, words
    assert "<b>0.410</b>" in html
    assert "0.380" in html and "<b>0.380</b>" not in html


def test_the_console_gives_the_same_figures_of_pairs(settings: BenchmarkSettings, tmp_path: Path) -> None:
    """Of pairs one of which is far off: its mean is not their median."""
    recording, folder = settings.recordings[0], tmp_path / "build" / "chair_01"
    write_pairs(folder / "pairs", 3)
    listed = json.loads((folder / "pairs" / "pairs.json").read_text())
    for row, containment, residual_m in zip(
        listed["pairs"], (0.9, 0.9912, 0.995), (0.0121, 0.0053, 0.00349), strict=True
    ):
        row.update(containment=containment, residual_m=residual_m)
    (folder / "pairs" / "pairs.json").write_text(json.dumps(listed))
    first = read_pair(folder / "pairs" / "000.npz")
    (folder / "pairs" / "000.npz").write_bytes(pair_bytes(replace(first, known=~first.full)))
    write_trajectory(folder / "trajectory", left_out=[])
    job = Job(settings, recording, tmp_path)
    write_manifests(folder, job)
    part = collect(job, folder)
    assert (part.containment, part.residual) == ("99.1 %", "5.3 mm")
    assert [tile.unknown for tile in part.tiles] == ["100.0 %", "0.0 %", "0.0 %"]
    row = summary(job, Outcome("chair_01", (), ("pairs",), None, 0.0))
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(summary_table([row], ("pairs",)))
    told = console.export_text()
    assert "99.1%" in told and " 5.3 " in told
    assert "medians over the pairs; passed over: frames that did not do" in told and "refused" not in told


def test_same_input_gives_the_same_bytes(
    html: str, settings: BenchmarkSettings, build: Path, tmp_path: Path
) -> None:
    scores = [score("mirror", 0.41), score("hull", 0.38), score("half", 0.2, complete=False)]
    again = write_report(settings, build, parsed_tables(scores), tmp_path / "scores" / "index.html")
    assert again.read_text(encoding="utf-8") == html
    assert [path.name for path in again.parent.iterdir()] == ["index.html"]


def test_names_from_strangers_are_text(settings: BenchmarkSettings, tmp_path: Path) -> None:
    hostile = "\"><script>alert(1)</script><img src=x onerror='x'>{{ 7 * 7 }}"
    folder = tmp_path / "chair_01" / "trajectory"
    folder.mkdir(parents=True)
    health = health_of(4).json_value() | {"verdict": hostile, "warnings": [hostile], hostile: hostile}
    (folder / "health.json").write_text(json.dumps(health))
    (tmp_path / "chair_01" / "pairs").mkdir()
    refused = [{"view": "003", "frame": 7, "reason": hostile}]
    (tmp_path / "chair_01" / "pairs" / "pairs.json").write_text(json.dumps({"pairs": [], "refused": refused}))
    table = score(hostile, 0.4)
    table |= {
        "benchmark_sha256": hostile,
        "warnings": [hostile],
        "failures": [{"recording": hostile, hostile: hostile}],
    }
    table |= {"thresholds": {hostile: 0.5}, "threshold_source": hostile}
    table["by_category"] = {hostile: {hostile: {"iou": 0.3, "base_rate_source": hostile}}}
    licensed = settings.model_copy(update={"license": hostile})
    reader = Reader(write_report(licensed, tmp_path, parsed_tables([table]), tmp_path / "x.html").read_text())
    assert reader.tags.count("script") == 1
    assert "img" not in reader.tags
    assert reader.text.count(hostile) >= 12
    assert "49" not in re.sub(r"#\w+", "", reader.text)


def test_nothing_built_and_no_scores(settings: BenchmarkSettings, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    out = write_report(settings, tmp_path, [], tmp_path / "x.html", lambda *news: told.append(news))
    text = Reader(out.read_text()).text
    assert text.count("Not built yet: trajectory, floor, object, views, pairs.") == 3
    assert "No predictions scored yet" in text
    assert told == [("chair_01", 0, 3), ("table_01", 1, 3), ("bench_01", 2, 3), ("", 3, 3)]


def test_tables_with_nulls(settings: BenchmarkSettings, tmp_path: Path) -> None:
    nothing = {"method": "a", "by_category": None, "overall": None, "thresholds": None, "warnings": None}
    holes = {"method": "b", "by_category": {"known": {"chair": None, "table": {"iou": None}}, "paper": None}}
    out = write_report(settings, tmp_path, parsed_tables([nothing, holes]), tmp_path / "x.html")
    assert "Protocol “known”" in Reader(out.read_text()).text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"method": None}, "scores.json: 'method'"),
        ({"by_category": 3}, "scores.json: 'by_category'"),
        ({"overall": {"known": {"iou": "high"}}}, "scores.json: 'overall.known.iou'"),
    ],
)
def test_a_bad_score_table_is_one_line(change: dict[str, Any], words: str) -> None:
    with raises(StorageError, "storage.damaged", match=re.escape(words)) as caught:
        parsed_tables([score("a", 0.1) | change])
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    write_build(folder, n_pairs=1)
    return folder


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("trajectory/health.json", b"{", "not valid JSON"),
        ("trajectory/health.json", b"[]", "should be an object"),
        ("trajectory/health.json", b"\xff\xfe{}", "cannot be read"),
        ("trajectory/trajectory.txt", b"0 1 2 3\n", "line 1: holds 4 values, not the 8 of 't tx ty tz"),
        ("trajectory/trajectory.txt", b"# only this\n", "the trajectory is empty"),
        ("trajectory/trajectory.txt", b"0 0 0 0 0 0 0 0\n", "line 1"),
        (
            "object/floor.json",
            b'{"plane_world": [0, 0, 1, 0], "T_floor_world": [[1]]}',
            "'T_floor_world': must be 4 x 4",
        ),
        ("object/mesh.ply", b"ply\n", "not a readable triangle mesh"),
        ("views/views.json", b'{"views": [{"view": "../x"}]}', "'views.0.view': String should match"),
        ("views/views.json", b'{"views": 3}', "'views': Input should be a valid array"),
        ("views/000.color.jpg", b"", "not a readable image"),
        ("views/000.mask.png", b"no", "not a readable image"),
        ("pairs/000.npz", b"no", "cannot be read as a pair file"),
        ("pairs/pairs.json", b'{"pairs": [{"view": "007"}], "refused": []}', "007.npz"),
    ],
)
def test_a_damaged_file_is_one_line(
    settings: BenchmarkSettings, small: Path, tmp_path: Path, name: str, content: bytes, words: str,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    path = small / "chair_01" / name
    kept = path.read_bytes()
    path.write_bytes(content)
    job = Job(settings, settings.recordings[0], small.parent)
    write_manifests(small / "chair_01", job)
    try:
        with pytest.raises(KinectBenchError, match=re.escape(words)) as caught:
            write_report(settings, small, [], tmp_path / "x.html")
    finally:
        path.write_bytes(kept)
        write_manifests(small / "chair_01", job)
    assert "\n" not in str(caught.value)
    assert path.parent.name in str(caught.value)
    assert capfd.readouterr().out == ""


def test_what_is_out_of_date_is_not_shown(
    settings: BenchmarkSettings, build: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shown(settings: BenchmarkSettings) -> RecordingPart:
        return collect(Job(settings, settings.recordings[0], build.parent), build / "chair_01")

    whole = shown(settings)
    assert whole.missing == () and whole.health and whole.quality and whole.plan and whole.frames
    framed = settings.pairs.model_copy(update={"framing": "view"})
    pairs = shown(settings.model_copy(update={"pairs": framed}))
    assert (
        pairs.outdated == ("pairs",)
        and pairs.missing == ()
        and pairs.tiles == ()
        and pairs.frames == whole.frames
    )
    monkeypatch.setitem(VERSIONS, "segment", VERSIONS["segment"] + 1)
    part = shown(settings)
    assert part.outdated == ("floor", "object", "views", "pairs") and part.missing == ()
    assert part.health == whole.health and part.quality is None and part.plan is None
    assert (part.object_pictures, part.frames, part.tiles, part.refused) == ((), (), (), ())


def test_pairs_failures_and_thresholds_are_shown_as_text(settings: BenchmarkSettings, tmp_path: Path) -> None:
    row = {"recording": "chair_9", "view": "000", "object": "chair_9", "category": "chair",
           "protocol": "known", "threshold": 0.5, "iou": 0.9, "coverage_shape": 0.8}  # fmt: skip
    failure = {"recording": "chair_2", "view": "004", "reason": "not an array of numbers"}
    table = score("net", 0.4) | {"rows": [row], "failures": [failure], "thresholds": {"chair": 0.35}}
    page = write_report(settings, tmp_path, parsed_tables([table]), tmp_path / "x.html").read_text()
    assert re.search(r'data-pair="chair_9/000">chair_9/000</a> 0\.900</span>', page)
    assert "chair 0.35" in page and "not an array of numbers" in page
