"""Find the floor of a scene and the object on it."""
