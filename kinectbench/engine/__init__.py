"""Runs the stages: skips current artefacts, reports failures, continues after a kill."""
