"""Poses over time: their value, their files, and how two trajectories compare."""
