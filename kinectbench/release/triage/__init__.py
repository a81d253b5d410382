"""Which recordings of a build are trustworthy, which need a review, and which show one object."""
