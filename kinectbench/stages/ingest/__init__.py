"""Readers of recordings: one file per format, a registry, and the writing of a Sequence to disk."""
