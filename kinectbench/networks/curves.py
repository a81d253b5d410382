"""Plot the progress of a training: losses above, validation IoU below."""

from collections.abc import Sequence

from kinectbench.core.artefacts.method import TrainingRow
from kinectbench.core.pictures import INK, SOFT, figure_png, new_figure

BLUE, ORANGE = "#3b6ea5", "#c77728"
LOSSES = (("loss", INK), ("reconstruction", BLUE), ("discriminator", ORANGE))


def curves_png(name: str, rows: Sequence[TrainingRow]) -> bytes:
    """Return a PNG of a method's losses and validation IoU by step; the same rows give the same bytes."""
    figure = new_figure(7.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True)
    steps = [row.step for row in rows]
    for key, color in LOSSES:
        values = [getattr(row, key) for row in rows]
        if any(value is not None for value in values):
            above.plot(steps, values, ".-", color=color, linewidth=1.0, markersize=4, label=key)
    if rows:
        above.legend(frameon=False, fontsize=8)
    above.set_title(name, fontsize=10, loc="left")
    above.set_ylabel("loss, mean", fontsize=9)
    looked = [(row.step, row.validation_iou) for row in rows if row.validation_iou is not None]
    if looked:
        below.plot(*zip(*looked, strict=True), ".-", color=BLUE, linewidth=1.0, markersize=4)
    else:
        below.text(0.5, 0.5, "no validation pairs", color=SOFT, transform=below.transAxes, ha="center")
    below.set_ylabel("validation IoU", fontsize=9)
    below.set_xlabel("step", fontsize=9)
    for axes in (above, below):
        axes.tick_params(labelsize=8)
        axes.grid(color=SOFT, alpha=0.25, linewidth=0.5)
    return figure_png(figure)
