"""Two seconds of each fuzzer, and every input that once was a finding."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fuzz.engine import Worker, again, fuzz
from fuzzing import FUZZERS

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="memory and time are asked of /proc"),
    pytest.mark.xdist_group("fuzz"),
]
SECONDS = 5.0
REGRESSIONS = sorted((Path(__file__).parent / "fuzz" / "regressions").glob("*.tar.gz"))


@pytest.mark.parametrize("name", FUZZERS)
def test_five_seconds_find_nothing(name: str, tmp_path: Path) -> None:
    result = fuzz(FUZZERS[name], SECONDS, 0, tmp_path)
    assert result.inputs > 0
    assert [str(finding) for finding in result.findings] == []


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    made = Worker()
    yield made
    made.close()


@pytest.mark.parametrize("archive", REGRESSIONS, ids=lambda path: path.name)
def test_what_was_a_finding_is_none_any_more(archive: Path, worker: Worker, tmp_path: Path) -> None:
    ran = again(archive, worker, tmp_path)
    assert ran.fault == "", ran.detail
