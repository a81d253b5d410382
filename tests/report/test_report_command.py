"""`kinectbench report` on several score files: one page of one truth, or one line why not."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz.releases import seal
from small_benchmark import Run, copied

from kinectbench.core.artefacts.score_marks import Verified
from kinectbench.core.untrusted import STEERING
from kinectbench.release.release import Release
from kinectbench.report.run import write_galleries
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.score import score_methods

Command = Callable[..., Run]


@pytest.fixture(scope="module")
def scored(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two submissions that were scored apart, in folders of their own, both called `net`."""
    root = tmp_path_factory.mktemp("apart")
    for team, value in (("ours", 1.0), ("theirs", 0.0)):
        for target in release.split("test"):
            path = root / team / "net" / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, np.full((2, 2, 2), value, np.float16))
        tables = score_methods(release, root / team / "net", root / team / "scores", surface=False)
        write_galleries(release, root / team / "net", tables, root / team / "scores", "half-pixel")
    return root


def test_several_merge_into_one_page(command: Command, release: Release, scored: Path) -> None:
    done = command(
        scored, "report", "--benchmark", str(release.folder), "--scores", "ours/scores/scores.json",
        "--scores", "theirs/scores", "--out", "leaders.html", "--json",
    )  # fmt: skip
    assert done.status == 0, done.err
    (page,) = json.loads(done.out)
    assert Path(page) == (scored / "leaders.html").resolve()
    text = Path(page).read_text(encoding="utf-8")
    assert 'data-value="net"' in text and 'data-value="net #2"' in text
    data = json.loads(text.partition('id="gallery-data">')[2].partition("</script>")[0])
    assert [method["name"] for method in data["methods"]] == ["net", "net #2"]


def test_a_release_may_have_a_name_that_no_benchmark_yaml_accepts(
    command: Command, release: Release, scored: Path, tmp_path: Path
) -> None:
    """As `import` gives it, by its folder; and a stranger may write anything there."""
    copy = Path(shutil.copytree(release.folder, tmp_path / "release"))
    text = (copy / "benchmark.json").read_text(encoding="utf-8")
    said = json.loads(text) | {"name": "my chairs <b> \x1b[2J"}
    (copy / "benchmark.json").write_text(json.dumps(said), encoding="utf-8")
    seal(copy)
    done = command(scored / "ours", "report", "--benchmark", str(copy), "--out", str(tmp_path / "page.html"))
    # By another name it is another benchmark: the scores here are not of it.
    assert done.status == 0 and "scores of another benchmark" in done.err and not STEERING.search(done.err)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert not STEERING.search(page.replace("\r", ""))
    assert "my chairs &lt;b&gt;" in page and "<b> \x1b" not in page


def test_with_ids_the_page_has_those_recordings_alone(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    for name, ids in (("all.html", ()), ("chair.html", ("chair",))):
        assert command(root, "report", *ids, "--out", name, "--jobs", "1").status == 0
    both, one = ((root / name).read_text(encoding="utf-8") for name in ("all.html", "chair.html"))
    assert "path: recordings/table" in both and "path: recordings/chair" in both
    assert "path: recordings/table" not in one and "path: recordings/chair" in one
    assert ">table<" in both


def test_without_names_it_is_the_folder_of_scores(command: Command, release: Release, scored: Path) -> None:
    done = command(scored / "ours", "report", "--benchmark", str(release.folder))
    assert done.status == 0 and (scored / "ours" / "scores" / "index.html").is_file()
    done = command(scored, "report", "--benchmark", str(release.folder), "--scores", "theirs/scores")
    assert done.status == 0 and (scored / "theirs" / "scores" / "index.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scores", "other/scores.json"], "scored against benchmark"),
        (["--scores", "ours/scores", "--scores", "nowhere"], "nowhere"),
        (["--scores", "theirs/net"], "theirs/net: no scores.json there"),
    ],
)
def test_what_cannot_be_compared_is_one_line(
    command: Command, release: Release, scored: Path, arguments: list[str], words: str
) -> None:
    (scored / "other").mkdir(exist_ok=True)
    content = json.loads((scored / "ours" / "scores" / "scores.json").read_text())
    (scored / "other" / "scores.json").write_text(json.dumps(content | {"benchmark_sha256": "f" * 64}))
    done = command(scored, "report", "--benchmark", str(release.folder), "--out", "no.html", *arguments)
    assert done.status != 0 and words in done.err
    assert done.err.count("error:") == 1 and "Traceback" not in done.err
    assert not (scored / "no.html").exists()


def forged(path: Path, out: Path) -> Path:
    """A table with better rows and the mark of a recheck that nobody ran, all of it consistent."""
    content = json.loads(path.read_text(encoding="utf-8"))
    for row in content["rows"]:
        row["ce"] /= 2
    for key in ("by_category", "overall", "extremes", "iou_by_threshold"):
        del content[key]
    out.write_text(json.dumps(content | {"method": "forged"}), encoding="utf-8")
    table = read_table(out)
    mark = Verified(
        date="2024-01-01",
        package_version="9.9.9",
        table_sha256=table.facts_sha256(),
        predictions_sha256=table.predictions_sha256(),
    )
    table.model_copy(update={"verified": mark}).write(out.parent, out.name)
    return out


def test_the_page_tells_who_says_that_a_table_is_verified(
    command: Command, release: Release, scored: Path, tmp_path: Path
) -> None:
    """A recheck and a forger write the same mark: the page shows both as the words of a file."""
    of_release = ("--benchmark", str(release.folder))
    predictions = str(scored / "ours" / "net")
    lie = forged(scored / "ours" / "scores" / "scores.json", tmp_path / "forged.json")
    truth, reported = tmp_path / "rechecked.json", scored / "theirs" / "scores" / "scores.json"
    shutil.copy(scored / "ours" / "scores" / "scores.json", truth)
    done = command(tmp_path, "score", "--recheck", str(truth), predictions, *of_release)
    assert done.status == 0, done.err
    before = lie.read_bytes()
    done = command(tmp_path, "score", "--recheck", str(lie), predictions, *of_release, "--json")
    assert done.status == 3 and json.loads(done.out)["standing"] == "not verified"
    assert lie.read_bytes() == before
    shown = [argument for path in (lie, truth, reported) for argument in ("--scores", str(path))]
    done = command(tmp_path, "report", *of_release, *shown, "--out", "page.html")
    assert done.status == 0, done.err
    page = " ".join((tmp_path / "page.html").read_text(encoding="utf-8").split())
    marks = [words for words in re.findall(r"<small>([^<]*)</small>", page) if words[:1] in "rv"]
    assert set(marks) == {"verified 2024-01-01, kinectbench 9.9.9", read_table(truth).standing, "reported"}
    said = (
        "Reported: as the file of scores says; verified: the file says that it was scored again from the "
        "predictions, which anybody can write; <code>score --recheck</code> tells."
    )
    scores = page.partition('<section id="scores">')[2].partition("</section>")[0]
    assert page.count(said) == scores.count(said) == 1
