"""Readers of recordings: one file per format, a registry, and writing a `Sequence` to disk."""
