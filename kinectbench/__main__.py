"""`python -m kinectbench` is the command line."""

from kinectbench.cli import main

if __name__ == "__main__":
    main()
