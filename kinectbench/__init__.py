"""kinectbench: real RGB-D recordings in, a benchmark for single-view shape completion out."""

__version__ = "0.1.0"
