"""A typed model for each file of `build/`, of a release and of scores: nothing else reads or writes them."""
