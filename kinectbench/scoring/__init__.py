"""Score predictions: submitted files, metrics, protocols, thresholds and score tables."""
