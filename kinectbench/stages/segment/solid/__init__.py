"""Classify the voxels around the object and make it a closed solid."""
