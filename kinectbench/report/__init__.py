"""A self-contained HTML page about a whole benchmark: its recordings, its pairs and the scores."""

from kinectbench.report.page import write_report

__all__ = ["write_report"]
