"""What a benchmark.yaml may say: models, defaults, words for what is wrong with one."""
