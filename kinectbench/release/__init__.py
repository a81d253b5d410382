"""Publish a benchmark, and verify one."""
