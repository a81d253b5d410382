"""Floor plane, object selection, and the masks of views."""
