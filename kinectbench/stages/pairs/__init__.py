"""The partial and the full shape of each view."""
