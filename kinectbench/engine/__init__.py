"""Runs the stages: skips artefacts that are up to date, reports failures, continues after a kill."""
