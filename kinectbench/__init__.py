"""kinectbench: real RGB-D recordings in, a benchmark for single-view shape completion out."""

__version__ = "0.1.0"

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kinectbench.api import Dataset as Dataset
    from kinectbench.api import Scorer as Scorer
    from kinectbench.api import load as load

__all__ = ["Dataset", "Scorer", "load"]


def __getattr__(name: str) -> Any:
    """`load`, `Dataset` and `Scorer`, imported when they are asked for: the command line stays quick."""
    if name in __all__:
        from kinectbench import api

        return getattr(api, name)
    raise AttributeError(f"module 'kinectbench' has no attribute '{name}'")
