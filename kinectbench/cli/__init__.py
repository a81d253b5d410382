"""The command line: parses options, calls the other packages, prints results. It holds no algorithms."""

STOPPED = "stopped; run the same command again to go on from here"
