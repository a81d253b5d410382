"""What `evaluate RECORDING TRUTH` finds: by id, by path, by build folder; or one line that says why not."""

from pathlib import Path

import pytest

from kinectbench.core.errors import KinectBenchError, SettingsError
from kinectbench.lab.evaluate.run import find_built, folder_beside
from kinectbench.lab.simulate.truth import truth_folder

YAML = "name: b\nrecordings:\n  - {id: chair, path: recordings/chair.bag, category: chair}\n"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "benchmark.yaml").write_text(YAML)
    for truth in ("chair", "other"):
        (tmp_path / f"recordings/{truth}.truth").mkdir(parents=True)
        (tmp_path / f"recordings/{truth}.truth/truth.json").write_text("{}")
    (tmp_path / "recordings/chair.bag").write_text("")
    (tmp_path / "recordings/other").mkdir()
    (tmp_path / "recordings/alone").mkdir()
    (tmp_path / "elsewhere/chair").mkdir(parents=True)
    (tmp_path / "build/chair/sequence").mkdir(parents=True)
    return tmp_path


def test_by_id_by_build_folder_and_by_path(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = root / "benchmark.yaml"
    by_id = find_built("chair", None, config, [])
    assert by_id.build == root / "build/chair"
    assert by_id.truth == root / "recordings/chair.truth"
    assert by_id.job is not None
    folder = find_built(str(root / "build/chair"), None, config, [])
    assert folder.truth == by_id.truth
    assert folder.job is None
    monkeypatch.chdir(root)
    path = find_built("recordings/other", None, Path("none.yaml"), ["views.count=7"])
    assert path.build == Path("build/other")
    assert path.truth == Path("recordings/other.truth")
    assert path.job is not None
    assert path.job.settings.views.count == 7
    listed = find_built("recordings/chair.bag", None, Path("benchmark.yaml"), ["views.count=7"]).job
    assert listed is not None and listed.recording.id == "chair" and listed.settings.views.count == 7
    assert find_built("chair", Path("recordings/other.truth"), config, []).truth == Path(
        "recordings/other.truth"
    )


def test_an_evaluation_lies_beside_build_from_wherever_it_is_called(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = root / "evaluation/chair"
    for here, name in ("", "build/chair"), ("build", "chair"), ("build/chair", "."):
        monkeypatch.chdir(root / here)
        assert folder_beside(Path(name)) == wanted


def test_the_recording_may_be_the_folder_one_is_in(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (root / "recordings/other/depth").mkdir(parents=True, exist_ok=True)
    for here, name in ("other", "."), ("other/depth", ".."):
        monkeypatch.chdir(root / "recordings" / here)
        assert truth_folder(Path(name)) == root.resolve() / "recordings/other.truth"
    with pytest.raises(SettingsError):
        truth_folder(Path("/"))


@pytest.mark.parametrize(
    ("recording", "config", "says"),
    [
        ("chiar", "benchmark.yaml", "no recording 'chiar'; did you mean 'chair'"),
        ("chair", "none.yaml", "no recording 'chair'; give a simulated recording's path"),
        ("recordings/alone", "benchmark.yaml", "alone.truth: no truth there"),
        ("build/chair", "none.yaml", "its truth is not known"),
        ("elsewhere/chair", "benchmark.yaml", "has other settings for it; name one of its ids"),
    ],
)
def test_nothing_is_found(
    root: Path, monkeypatch: pytest.MonkeyPatch, recording: str, config: str, says: str
) -> None:
    monkeypatch.chdir(root)
    with pytest.raises(KinectBenchError, match=says) as caught:
        find_built(recording, None, Path(config), [])
    assert "\n" not in str(caught.value)
