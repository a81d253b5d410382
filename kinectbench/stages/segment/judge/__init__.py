"""Judge the solid: its quality, its estimated IoU, and its unseen parts."""
