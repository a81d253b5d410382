"""`baseline` replaces what it wrote, and nothing else."""

from pathlib import Path

from raising import raises

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.errors import SettingsError
from kinectbench.release.release import Release
from kinectbench.scoring.baselines.predict import BY, write_baselines


def test_a_folder_that_baseline_did_not_write_is_refused(release: Release, tmp_path: Path) -> None:
    """Someone's own method may have a baseline's name: its predictions stay as they are."""
    target = release.targets[0]
    own = tmp_path / "partial" / target.recording / f"{target.view}.npz"
    own.parent.mkdir(parents=True)
    own.write_bytes(b"own")
    others = (
        MethodFile(name="partial", version="2.1"),
        MethodFile(name="ours", version=BY + "1"),
        MethodFile(name="partial", version=BY + "1", settings={"config": {}}),  # a network's
    )
    for method in (None, *others):
        if method:
            (tmp_path / "partial" / "method.json").write_text(method.text(), encoding="utf-8")
        with raises(
            SettingsError,
            "settings.other-content",
            match=r"partial: has no method\.json of `baseline`; remove or rename it",
        ):
            write_baselines(release, tmp_path, ["empty", "partial"])
        assert own.read_bytes() == b"own" and not (tmp_path / "empty").exists()
