"""`python -m kinectbench` is the command line."""

from kinectbench.cli.main import main

if __name__ == "__main__":
    main()
