"""Which recordings of a build can be trusted, which a person should look at, and which are one object."""
