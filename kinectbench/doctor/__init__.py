"""The doctor (the command `inspect`): finds a recording's faults within seconds, before anything is built."""

from kinectbench.doctor.examine import inspect
from kinectbench.doctor.finding import Diagnosis, Finding

__all__ = ["Diagnosis", "Finding", "inspect"]
