"""The paper's published figures, against some that were typed by hand from its tables."""

from dataclasses import replace

import pytest
from score_rows import row, table

from kinectbench.cli.score_tables import score_table
from kinectbench.core.artefacts.scores import ScoreSettings
from kinectbench.report.paper_table import paper_markdown, paper_tables
from kinectbench.report.tables import published_table
from kinectbench.scoring.published import PARAMETERS, REAL, SYNTHETIC, UNSEEN, published_beside

# (number of the table, method, category, IoU, CE)
TYPED = [
    ("Table 1 (", "Han et al.", "couch", 0.446, 0.165),
    ("Table 2 (", "3D-RecAE", "table", 0.610, 0.058),
    ("Table 3 (", "Varley et al.", "chair", 0.317, 0.132),
    ("Table 4 (", "3D-RecGAN++", "couch", 0.643, 0.091),
    ("Tables 5", "3D-RecAE", "car", 0.557, 0.110),
    ("Tables 5", "3D-EPN", "guitar", 0.351, 0.036),
    ("Tables 5", "Han et al.", "plane", 0.306, 0.031),
    ("Tables 7", "Varley et al.", "firearm", 0.274, 0.028),
    ("Tables 7", "3D-RecGAN++", "monitor", 0.555, 0.074),
    ("Tables 7", "3D-EPN", "faucet", 0.439, 0.087),
    ("Table 9 (", "3D-RecGAN++ of couch", "bench", 0.429, 0.070),
    ("Table 9 (", "3D-RecGAN++ of table", "couch", 0.402, 0.260),
    ("Table 10", "3D-EPN", "couch", 0.508, 0.413),
]


@pytest.mark.parametrize(("number", "method", "category", "iou", "ce"), TYPED)
def test_figures_are_those_that_are_printed(
    number: str, method: str, category: str, iou: float, ce: float
) -> None:
    (of,) = [of for of in (REAL, *SYNTHETIC) if of.title.startswith(number)]
    (entry,) = [entry for entry in of.rows if entry.method == method]
    at = of.categories.index(category)
    assert (entry.iou[at], entry.ce[at]) == (iou, ce)
    assert len(entry.iou) == len(entry.ce) == len(of.categories)


def test_one_categorys_networks_are_those_of_the_first_table() -> None:
    """The diagonal of Table 9 is the first row of Table 1; parameters are those of Table 12."""
    first, trained_on_one = SYNTHETIC[0], SYNTHETIC[-1]
    assert first.rows[0].iou == tuple(row.iou[at] for at, row in enumerate(trained_on_one.rows))
    assert first.rows[0].ce == tuple(row.ce[at] for at, row in enumerate(trained_on_one.rows))
    assert PARAMETERS == {"3D-EPN": 52.4, "Varley et al.": 430.3, "Han et al.": 7.5, "3D-RecGAN++": 167.1}


def test_tables_stand_beside_their_own_categories_and_views() -> None:
    def titles(views: int, *categories: str) -> list[str]:
        return [of.title[:30] for of in published_beside([f"m-{views}"], categories)]

    assert [len(titles(125, "chair")), len(titles(216, "chair"))] == [3, 2]
    assert [of.categories for of in published_beside(["m-216"], ["car"])] == [UNSEEN]
    assert len(titles(125, "car", "bench")) == 4 and titles(125, "lamp") == []
    assert published_beside(["chair_01"], ["lamp"]) == (REAL,)
    assert published_table(SYNTHETIC[4]).categories == UNSEEN


def test_unseen_categories_have_their_published_rows_and_parameters() -> None:
    rows = [replace(row("car", n, 0, 0.3), protocol="paper", recording=f"car_{n}-125") for n in range(2)]
    found = paper_tables([table("net", rows)])
    text = paper_markdown(found)
    assert "Tables 5 and 6" in text and "| 0.555 | 0.102 |" in text and "Table 1 " not in text
    assert text.endswith("Han et al. 7.5, 3D-RecGAN++ 167.1\n") and "millions (Table 12)" in text
    settings = ScoreSettings(protocols=("paper",))
    made = table("net", rows).model_copy(update={"settings": settings, "thresholds": {"car": 0.5}})
    shown = score_table([made], published=True)
    assert "Table 12" in str(shown.caption) and "0.484 / 0.173" in [*shown.columns[-1].cells]
