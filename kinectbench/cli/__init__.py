"""The command line: parses options, calls the other rooms, prints results. It holds no algorithms."""
