"""Export of releases to other layouts, and import from them."""
