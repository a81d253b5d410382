"""The settings of a benchmark.yaml: models, defaults, and messages about errors."""
