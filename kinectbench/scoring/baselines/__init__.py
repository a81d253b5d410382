"""Baselines: simple methods, some of them trivial, for comparison with other methods."""
