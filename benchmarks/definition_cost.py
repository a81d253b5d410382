"""What the definition of air costs: how much of the exact air of each family no camera could tell from solid.

Exact meshes, no recording.
"""

import argparse
import time
from collections.abc import Sequence

import numpy as np

from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.voxels.seeable import seeable_solid
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.lab.simulate.objects import families, make_object

SEEDS = (41, 42, 43)


def cost(task: tuple[str, int]) -> tuple[float, float, float, float]:
    """Of one object: closed and not judged, over its volume; IoU of seeable and exact solid; CPU seconds."""
    mesh = make_object(*task).mesh
    limits = SensorLimits.of_size(float(np.ptp(mesh.vertices, axis=0).max()))
    began = time.process_time()
    found = seeable_solid(mesh, np.eye(4), limits)
    return found.closed_share, found.slit_share, 1 / (1 + found.closed_share), time.process_time() - began


def main() -> int:
    """Print a row for each family."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--families", nargs="+", choices=tuple(families()), default=tuple(families()))
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    print(
        "| family | IoU of the seeable to the exact solid | closed, % of the volume | not judged, % | CPU s |"
    )
    print("|---|---|---|---|---|")
    tasks = [(family, seed) for family in asked.families for seed in asked.seeds]
    with worker_pool(asked.workers) as pool:
        done = [found.result() for found in submit_all(pool, cost, tasks)]
    for at in range(0, len(tasks), len(asked.seeds)):
        closed, slit, iou, cpu_s = zip(*done[at : at + len(asked.seeds)], strict=True)
        print(
            f"| `{tasks[at][0]}` | {row(iou, '.3f')} | {row([100 * share for share in closed], '.1f')} | "
            f"{row([100 * share for share in slit], '.1f')} | {row(cpu_s, '.1f')} |"
        )
    return 0


def row(values: Sequence[float], how: str) -> str:
    """One figure of each seed."""
    return ", ".join(f"{value:{how}}" for value in values)


if __name__ == "__main__":
    raise SystemExit(main())
