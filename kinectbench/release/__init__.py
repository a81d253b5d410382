"""Publish a benchmark as a release, check a release, and read it."""
