"""Reference methods, beginning with trivial ones."""
