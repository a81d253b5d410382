"""Predictions in the camera frame: surfaces, solids, registration to the truth, and the table of a method."""
