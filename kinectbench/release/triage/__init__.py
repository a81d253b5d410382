"""Triage: which recordings of a build are trustworthy, need a review, or show the same object."""
