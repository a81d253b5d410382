"""A mesh of the object that somebody else measured or drew: laid onto what was built, and judged."""
