"""What quality.json estimates, against values computed by hand."""

import pytest

from kinectbench.shape.quality import estimated_iou


def test_estimated_iou():
    assert estimated_iou(1.0, 0.0) == 1
    assert estimated_iou(0.96, 0.0) == pytest.approx(1 - 0.082)
    assert estimated_iou(0.96, 0.05) == pytest.approx(1 - 0.082 - 0.0885)
    assert estimated_iou(0.3, 0.5) == 0
    assert estimated_iou(0.95, 0.02) < estimated_iou(0.95, 0.01) < estimated_iou(0.99, 0.01)
