"""Triage: find the recordings of a build that need a review, are to be rejected, or show the same object."""
