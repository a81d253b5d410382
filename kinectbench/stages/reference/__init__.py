"""A mesh of the object from elsewhere (a scanner, CAD): registered to the built object, and judged."""
