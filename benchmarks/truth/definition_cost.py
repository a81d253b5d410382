"""What the definition of air costs: how much air of each family's exact mesh no camera could tell from solid.

No recording is needed. Figures are means over the seeds.
"""

import argparse
import time

import numpy as np
from figures import Figure, arguments, run, stated

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


def measure(options: argparse.Namespace) -> list[Figure]:
    """Means over the seeds of each family."""
    tasks = [(family, seed) for family in options.families for seed in options.seeds]
    with worker_pool(options.workers) as pool:
        done = [found.result() for found in submit_all(pool, cost, tasks)]
    figures = []
    for family in options.families:
        rows = np.array([row for (of, _), row in zip(tasks, done, strict=True) if of == family])
        closed, slit, iou, cpu_s = (float(mean) for mean in rows.mean(axis=0))
        figures += [
            stated(f"{family}: IoU of the seeable to the exact solid", iou),
            stated(f"{family}: closed, % of the volume", 100 * closed),
            stated(f"{family}: not judged, % of the volume", 100 * slit),
            stated(f"{family}: CPU s an object", cpu_s),
        ]
    return figures


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--families", nargs="+", choices=tuple(families()), default=tuple(families()))
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    run(options, lambda: measure(options))


if __name__ == "__main__":
    main()
