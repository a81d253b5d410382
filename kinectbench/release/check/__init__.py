"""Checking every byte and every pair of a release."""
