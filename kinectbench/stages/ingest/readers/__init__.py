"""One reader for each format of folder or log."""
