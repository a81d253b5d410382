"""The command line: parses options, calls the other packages, prints results. It holds no algorithms."""
