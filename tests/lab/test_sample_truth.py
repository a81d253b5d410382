"""The sample recordings, built with a few views each: the bars of benchmarks/truth/sample_truth.py."""

import pytest
from builds import built
from figures import missed
from sample_truth import REPOSITORY, PairAgainstTruth, against_truth, figures_of, settings_with_truth
from slow import slow

pytestmark = pytest.mark.xdist_group("sample_truth")


SETTINGS = settings_with_truth(REPOSITORY, ["views.count=5"])


@pytest.fixture(scope="module", params=["chair_01", slow("table_01")])
def results(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, list[PairAgainstTruth]]:
    one = [recording for recording in SETTINGS.recordings if recording.id == request.param]
    settings = SETTINGS.model_copy(update={"recordings": one})
    (job,) = built(settings, tmp_path_factory.mktemp("sample"), workers=1)
    return {job.recording.id: against_truth(job)}


def test_both_samples_have_truth() -> None:
    assert [recording.id for recording in SETTINGS.recordings] == ["chair_01", "table_01"]


def test_five_pairs(results: dict[str, list[PairAgainstTruth]]) -> None:
    assert [len(pairs) for pairs in results.values()] == [5]


def test_the_bars_are_met(results: dict[str, list[PairAgainstTruth]]) -> None:
    assert missed(figures_of(results)) == []


def test_every_pair(results: dict[str, list[PairAgainstTruth]]) -> None:
    for pair in (pair for pairs in results.values() for pair in pairs):
        assert pair.full > 0.85
        assert pair.known > 0.85
        assert pair.shell < 0.5 * pair.full  # a surface is no solid
        assert pair.mask > 0.9
        assert pair.not_known < 0.17
