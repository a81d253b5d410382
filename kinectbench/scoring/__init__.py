"""Metrics, protocols, thresholds, submissions, tables."""
