"""Families of objects and formats of recordings that serve tests, benchmarks and the choice of rules."""
