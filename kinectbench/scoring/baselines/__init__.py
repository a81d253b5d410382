"""Reference methods, from trivial on."""
