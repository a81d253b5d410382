"""The judge of the fuzzers sees each kind of fault, and a case of a seed is always the same input."""

import os
import random
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from bounds import within
from fuzz.damage import of_content
from fuzz.engine import Command, Damaged, Fuzzer, Worker, again, fuzz, plant
from fuzz.places import PLACES, of_folder, of_place

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory and time are asked of /proc")


def faulty(arguments: tuple[str, ...]) -> int:
    """A command with the fault of that name."""
    name = arguments[0]
    if name == "waits":
        os.open(arguments[1], os.O_RDONLY)
    while name == "spins":
        pass
    if name == "eats":
        _ = bytearray(700 << 20)
    if name == "dies":
        os.abort()
    if name == "raises":
        raise KeyError("x")
    if name == "exits":
        return 77
    if name == "is silent":
        return 1
    if name in TEXTS:
        sys.stderr.write(TEXTS[name])
    return 0


TEXTS = {
    "steers": "error: a\x1b[2Jb",
    "foreign": "libpng warning",
    "long": "error: " + "x" * 2000,
    "well": "note: a",
    "unforeseen": "error: internal error: X",
}
FAULTS = {
    "waits": "waits for ever, in ?",
    "spins": "more than 3 s of a processor, in ?",
    "eats": "memory",
    "dies": "the process ended with -6",
    "raises": "KeyError in ?",
    "exits": "exit status 77",
    "is silent": "a failure without a word",
    "steers": "control characters",
    "foreign": "words that are not the command's own",
    "long": "a line of more than 1000 characters",
    "unforeseen": "internal error",
    "well": "",
}


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    made = Worker(call=faulty, most_cpu_s=3, most_idle_s=2)
    yield made
    made.close()


@pytest.mark.xdist_group("fuzz")
@pytest.mark.parametrize("name", FAULTS)
def test_each_kind_of_fault_is_seen(worker: Worker, tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    ran = worker.run(tmp_path, Command((name, "pipe")))
    assert ran.fault == FAULTS[name]
    # The next command is run, by another process if need be.
    assert worker.run(tmp_path, Command(("well",))).fault == ""


def test_a_status_that_was_not_expected_is_seen(worker: Worker, tmp_path: Path) -> None:
    assert worker.run(tmp_path, Command(("well",), (1,))).fault == "status 0, not (1,)"


def make(folder: Path) -> None:
    (folder / "one").mkdir()
    (folder / "one" / "a.json").write_text('{"a": [1, 2, {"b": 0.5}], "c": "d"}')
    (folder / "one" / "b.txt").write_text("1 2 3\n4 5 6\n" * 20)


def damage(draw: random.Random, case: Path) -> Damaged:
    story = of_folder(draw, case, 0.0)
    return story, [Command(("raises",) if draw.random() < 0.3 else ("well",))]


TOY = Fuzzer("toys", make, lambda case: [Command(("well",))], damage)


def test_an_input_that_is_a_finding_is_kept_and_shows_it_again(worker: Worker, tmp_path: Path) -> None:
    said: list[str] = []
    result = fuzz(TOY, 0.5, 0, tmp_path / "kept", say=said.append, call=faulty)
    assert result.inputs > len(result.findings) > 0
    assert len(said) == 1 and "KeyError" in said[0]  # once for all inputs that show it
    kept = sorted((tmp_path / "kept").iterdir())
    assert 0 < len(kept) <= 3
    (tmp_path / "again").mkdir()
    assert again(kept[0], worker, tmp_path / "again").fault == "KeyError in ?"
    assert list((tmp_path / "again").iterdir()) == []


def test_a_case_is_always_the_same_input(tmp_path: Path) -> None:
    make(tmp_path)
    made = []
    for number in range(30):
        cases = [tmp_path / side / str(number) for side in "ab"]
        planted = [plant(TOY, [tmp_path / "one"], number, 0, case) for case in cases]
        files = [{path.name: path.read_bytes() for path in case.iterdir()} for case in cases]
        assert files[0] == files[1] and planted[0] == planted[1]
        made.append(str(files[0]))
    assert len(set(made)) > 25
    assert (tmp_path / "one" / "b.txt").read_text() == "1 2 3\n4 5 6\n" * 20  # what is whole stays so


@pytest.mark.parametrize("kind", PLACES)
def test_everything_may_lie_in_a_files_place(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "f"
    folder.mkdir()
    (folder / "a.txt").write_text("x")
    draw = random.Random(0)
    monkeypatch.setattr(draw, "choice", lambda words: kind if words == tuple(PLACES) else words[0])
    assert of_place(draw, folder / "a.txt", folder) == kind
    path, there = folder / "a.txt", sorted(path.name for path in folder.iterdir())
    assert there != ["a.txt"] or path.is_symlink() or not path.is_file() or path.read_bytes() != b"x"


def test_a_second_one_leaves_the_corpus_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its name may be taken by a file that is linked into every case."""
    corpus, case = tmp_path / "corpus", tmp_path / "case"
    for folder in (corpus, case):
        folder.mkdir()
    for name in ("a.txt", "index.html"):
        (corpus / name).write_text(name)
        os.link(corpus / name, case / name)
    draw = random.Random(0)
    chosen = iter(("a second one", "index.html"))
    monkeypatch.setattr(draw, "choice", lambda words: next(chosen))
    of_place(draw, case / "a.txt", case)
    assert (case / "index.html").read_text() == "a.txt"
    assert (corpus / "index.html").read_text() == "index.html"


KINDS = ["json", "csv", "txt", "bin", "zip", "png", "npy", "db3", "gz", "tar", "obj", "ply"]


@pytest.mark.parametrize("kind", KINDS)
def test_any_bytes_can_be_damaged_in_little_time(kind: str) -> None:
    with within(10):
        for number in range(40):
            content, said = of_content(random.Random(number), f"a.{kind}", os.urandom(number))
            assert isinstance(content, bytes) and said
