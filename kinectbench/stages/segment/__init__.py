"""The closed solid shape, its labels and its quality."""
