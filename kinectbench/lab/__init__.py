"""Recordings with known truth, and builds held against it."""
