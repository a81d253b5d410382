"""Poses over time: the trajectory as a value, its files, and the comparison of two trajectories."""
