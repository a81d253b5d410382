"""kinectbench: real RGB-D recordings in, a benchmark for single-view shape completion out.

The command `kinectbench` makes benchmarks and scores predictions. A network is scored from Python, too:

    dataset = kinectbench.load("benchmark")
    scorer = kinectbench.Scorer(dataset)
    for split in ("validation", "test"):
        for pair in dataset.split(split):
            scorer.update(pair["pair_id"], predict(pair["partial"]))
    table = scorer.result()
"""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from kinectbench._version import __version__ as __version__

if TYPE_CHECKING:
    from kinectbench.scoring.api import Dataset as Dataset
    from kinectbench.scoring.api import Scorer as Scorer
    from kinectbench.scoring.api import decode_sample as decode_sample
    from kinectbench.scoring.api import load as load

__all__ = ["Dataset", "Scorer", "decode_sample", "load"]


def __getattr__(name: str) -> Any:
    """Import `load`, `Dataset`, `Scorer` and `decode_sample` lazily, so that the command line starts fast."""
    if name in __all__:
        from kinectbench.scoring import api

        return getattr(api, name)
    raise AttributeError(f"module 'kinectbench' has no attribute '{name}'")


def __dir__() -> list[str]:
    """Return the module's names, with those that are imported lazily."""
    return sorted({*globals(), *__all__})


class _MovedApi(ModuleType):
    """The module `kinectbench.api`, where `load`, `Dataset` and `Scorer` once were; it still works."""

    def __getattr__(self, name: str) -> Any:
        from kinectbench.scoring import api

        return getattr(api, name)


api = sys.modules[f"{__name__}.api"] = _MovedApi(f"{__name__}.api")
