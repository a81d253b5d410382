"""What each network costs: parameters, multiplications, and a forward pass of one view on the CPU or a GPU.

    python benchmarks/methods_cost.py                     # two threads; each network in a process of its own
    python benchmarks/methods_cost.py --device cuda
    python benchmarks/methods_cost.py --only 3d-recgan++ --step      # a training step of one pair as well

The bar is on 3D-RecGAN++, 64^3 to 256^3: within 5 s and 2.5 GB on two cores, the best of three by the wall
clock. The CPU seconds of both threads stand beside it: on a machine that others use the wall clock says more
of them than of the network.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

MOST_SECONDS, MOST_MB = 5.0, 2500
SMALL = "recae-small"
NETWORKS = ("3d-recgan++", "3d-recae", "3d-epn", "varley", "han-like", SMALL)


def measured(name: str, device: str, threads: int, step: bool) -> dict[str, Any]:
    """The figures of one network, in this process."""
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    from kinectbench.networks.config_file import find_config
    from kinectbench.networks.data import Batch
    from kinectbench.networks.grids import TruthBatch
    from kinectbench.networks.registry import make_network
    from kinectbench.networks.steps import Learner

    torch.set_num_threads(threads)
    config = find_config("3d-recgan++-code" if name == "3d-recgan++" else name)
    network = make_network(config.network, device=device).eval()
    partial = torch.zeros(1, 1, 64, 64, 64, device=device)
    partial[..., 20:44, 20:44, 30:33] = 1
    found: dict[str, Any] = {"parameters": network.parameter_count}
    with torch.inference_mode():
        with FlopCounterMode(display=False) as counter:
            network.completed(partial)
        found["gmac"] = counter.get_total_flops() / 2e9
        walls, cpus = [], []
        for _ in range(3):
            wall, cpu = time.perf_counter(), time.process_time()
            network.completed(partial)
            _wait(device)
            walls.append(time.perf_counter() - wall)
            cpus.append(time.process_time() - cpu)
    found |= {"forward_s": min(walls), "forward_cpu_s": min(cpus), "peak_mb": _peak_mb(device)}
    if step:
        full = torch.zeros(1, 1, 256, 256, 256, dtype=torch.bool, device=device)
        full[..., 80:176, 80:176, 120:200] = True
        learner = Learner(network, config, device, (0, 1))
        batch = Batch(partial, TruthBatch(full, None))
        learner.step(batch, 0, 0)
        wall, cpu = time.perf_counter(), time.process_time()
        learner.step(batch, 1, 0)
        _wait(device)
        found |= {"step_s": time.perf_counter() - wall, "step_cpu_s": time.process_time() - cpu}
        found["step_peak_mb"] = _peak_mb(device)
    return found


def _wait(device: str) -> None:
    import torch

    if device != "cpu":
        torch.cuda.synchronize()


def _peak_mb(device: str) -> float:
    """Of this process with all its libraries, or of the GPU."""
    import torch

    if device != "cpu":
        return torch.cuda.max_memory_allocated() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--step", action="store_true", help="a training step of one pair, too")
    parser.add_argument("--only", choices=NETWORKS)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", choices=NETWORKS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options.one, options.device, options.threads, options.step)))
        return
    words = [
        "--device",
        options.device,
        "--threads",
        str(options.threads),
        *(["--step"] if options.step else []),
    ]
    rows = {}
    for name in [options.only] if options.only else NETWORKS:
        done = subprocess.run(
            [sys.executable, __file__, "--one", name, *words], stdout=subprocess.PIPE, text=True, check=True
        )
        rows[name] = row = json.loads(done.stdout)
        shown = ", ".join(
            f"{key} {value:,.2f}" if key != "parameters" else f"{value:,}" for key, value in row.items()
        )
        print(f"{name}: {shown}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    bar = rows.get("3d-recgan++")
    if bar and options.device == "cpu":
        well = bar["forward_s"] <= MOST_SECONDS and bar["peak_mb"] <= MOST_MB
        print(f"3d-recgan++ within {MOST_SECONDS} s and {MOST_MB} MB: {'pass' if well else 'FAIL'}")
        sys.exit(not well)


if __name__ == "__main__":
    main()
