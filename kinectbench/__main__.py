"""Run the command line, as `kinectbench` or `python -m kinectbench`."""

import sys

from kinectbench.cli import STOPPED


def enter() -> None:
    """Run the command line; Ctrl-C while its modules are imported gets the same line as later."""
    try:
        from kinectbench.cli.main import main
    except KeyboardInterrupt:
        sys.stderr.write(f"error: {STOPPED}\n")
        sys.exit(130)  # `main`'s status, too
    main()


if __name__ == "__main__":
    enter()
