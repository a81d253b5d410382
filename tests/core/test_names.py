"""Names of recordings, objects and categories: what they may be, and which cannot stand together."""

import pytest
from pydantic import TypeAdapter, ValidationError
from raising import raises

from kinectbench.core.artefacts.provenance import ThresholdsFile
from kinectbench.core.artefacts.scores import OVERALL
from kinectbench.core.artefacts.targets import COLUMNS, check_names, parse_targets
from kinectbench.core.errors import ReleaseError
from kinectbench.core.names import RESERVED, Category, Name, Named, StoredCategory, first_clash
from kinectbench.scoring.compare import ALL
from kinectbench.settings.models import BenchmarkSettings

# (recording, object, category) of two recordings, and what is wrong with them.
CLASHES = [
    (("a", "a", "chair"), ("b", "b", "Chair"), "the categories 'chair' and 'Chair' differ by case only"),
    (("a", "a", "chair"), ("A", "x", "chair"), "the recordings 'a' and 'A' differ by case only"),
    (("a", "o", "chair"), ("b", "O", "chair"), "the objects 'o' and 'O' differ by case only"),
    (("a", "o", "chair"), ("b", "o", "table"), "object 'o' is in two categories, 'chair' and 'table'"),
]
FINE = [("a", "a", "chair"), ("b", "a", "chair"), ("chair", "chair", "phone"), ("a2", "a", "chair")]


def test_what_means_are_called_is_no_category() -> None:
    assert {OVERALL, ALL} == set(RESERVED)
    for name in (*RESERVED, "Overall", "ALL"):
        for kind in (Category, StoredCategory):
            with pytest.raises(ValidationError, match="is what the mean over all categories is called"):
                TypeAdapter(kind).validate_python(name)
        assert TypeAdapter(Name).validate_python(name) == name  # a recording may be called so
    for name in ("overall_chair", "small", "phone"):
        assert TypeAdapter(Category).validate_python(name) == name


@pytest.mark.parametrize("kind", [Name, Category])
@pytest.mark.parametrize("name", ["publish.json", "Scores.CSV", "baselines"])
def test_files_of_ours_name_nothing(kind: type[str], name: str) -> None:
    with pytest.raises(ValidationError, match="files and folders of kinectbench have such names"):
        TypeAdapter(kind).validate_python(name)


@pytest.mark.parametrize(("first", "second", "said"), CLASHES)
def test_clashes_are_refused_wherever_names_are_read(
    first: tuple[str, str, str], second: tuple[str, str, str], said: str
) -> None:
    between = ("c", "c", "sofa")
    clash = first_clash(Named(*row) for row in (between, first, first, second))
    assert clash is not None and clash.problem.startswith(said)
    assert (clash.row, clash.earlier) == (3, 1)
    rows = [
        ",".join((r, o, "000", c, "test", f"pairs/{r}/000.npz", "0" * 64, "")) for r, o, c in (first, second)
    ]
    targets = parse_targets("\n".join((",".join(COLUMNS), *rows, "")), "targets.csv")
    with raises(ReleaseError, "release.damaged", match=f"targets.csv: {said}"):
        check_names(targets, "targets.csv")
    recordings = [{"id": r, "path": "p", "object": o, "category": c} for r, o, c in (first, second)]
    with pytest.raises(ValidationError, match=said):
        BenchmarkSettings.model_validate({"name": "b", "recordings": recordings})


def test_names_that_go_together() -> None:
    assert first_clash(Named(*row) for row in FINE) is None


@pytest.mark.parametrize(
    ("thresholds", "said"),
    [
        ('{"chair": 0.5, "overall": 0.4}', "'overall' is what the mean"),
        ('{"chair": 0.5, "Chair": 0.4}', "the categories 'chair' and 'Chair' differ by case only"),
    ],
)
def test_of_a_threshold_file(thresholds: str, said: str) -> None:
    with raises(ReleaseError, "release.damaged", match=said):
        ThresholdsFile.parse(f'{{"thresholds": {thresholds}}}', "thresholds.json")
