"""Run the command line as `python -m kinectbench`."""

from kinectbench.cli.main import main

if __name__ == "__main__":
    main()
