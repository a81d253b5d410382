"""Baselines: simple methods, beginning with trivial ones, to which other methods are compared."""
