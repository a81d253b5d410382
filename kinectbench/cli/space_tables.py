"""The table of scores of predictions in the camera frame that people see in the terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kinectbench.core.artefacts.scores import OVERALL, ScoreTable

if TYPE_CHECKING:
    from kinectbench.cli.wide_table import WideTable

TITLE = "predictions in the camera frame: means over all categories"
# Key of the figure -> heading, and how it is written.
COLUMNS = {
    "chamfer_l1_m": ("Chamfer L1, m", "{:.4f}"),
    "chamfer_l2_m2": ("Chamfer L2, m²", "{:.2e}"),
    "f_score_5mm": ("F 5 mm", "{:.3f}"),
    "f_score_10mm": ("F 10 mm", "{:.3f}"),
    "f_score_20mm": ("F 20 mm", "{:.3f}"),
    "f_score_1pct": ("F 1 %", "{:.3f}"),
    "f_score_2pct": ("F 2 %", "{:.3f}"),
    "f_score_5pct": ("F 5 %", "{:.3f}"),
    "normal_consistency": ("normals", "{:.3f}"),
    "iou": ("IoU", "{:.3f}"),
}
EMPTY_NOTE = (
    "empty: not known of every view; open meshes and points have no IoU, points without normals no normals"
)


def space_table(tables: Sequence[ScoreTable]) -> "WideTable":
    """A line for each method and heading (protocol, registration, part, hypotheses); best first."""
    from rich.text import Text

    from kinectbench.cli.wide_table import WideTable

    result = WideTable(title=TITLE)
    result.add_column("protocol")
    result.add_column("method")
    for name, _ in COLUMNS.values():
        result.add_column(name, justify="right")
    headings = dict.fromkeys(name for table in tables for name in table.overall or {})
    for heading in headings:
        for table in sorted(tables, key=lambda table: _far(table, heading)):
            if OVERALL in (averages := table.averages(heading)):
                result.add_row(heading, Text(table.method), *_cells(averages[OVERALL]))
        result.add_section()
    failed = [f"{t.method}: {len(t.failures)} views failed" for t in tables if t.failures]
    left_out = dict.fromkeys(line for t in tables for name in headings if (line := t.left_out_line(name)))
    result.caption = "\n".join([*failed, *left_out, EMPTY_NOTE])
    return result


def _far(table: ScoreTable, heading: str) -> float:
    of = table.averages(heading).get(OVERALL)
    return float("inf") if of is None or of.chamfer_l1_m is None else float(of.chamfer_l1_m)


def _cells(averages: object) -> list[str]:
    found = [(getattr(averages, name), form) for name, (_, form) in COLUMNS.items()]
    return ["" if value is None else form.format(value) for value, form in found]
