"""Writing a release."""
