"""Judge the solid: its quality, its estimated IoU, and what no frame saw of it."""
