"""Memory that a network's steps use again and again is not asked for anew each time."""

import resource
import sys

import pytest
import torch

from kinectbench.networks.allocator import memory_kept

BYTES, TIMES = 32 << 20, 20


def faults() -> int:
    """Pages that the system had to give while arrays are made and freed."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(TIMES):
        torch.zeros(BYTES // 4)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc alone")
def test_freed_memory_is_used_again_within_the_block_alone() -> None:
    with memory_kept():
        faults()  # until there is enough
        kept = faults()
    given_back = faults()
    assert kept < given_back / 4
