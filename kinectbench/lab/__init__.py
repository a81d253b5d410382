"""Recordings with known truth, and the comparison of builds with it."""
