"""The views, with the object's mask in each."""
