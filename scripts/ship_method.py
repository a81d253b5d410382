"""Put a trained network into the package, with its weights in half precision, if it beats the simple methods.

    .venv/bin/python scripts/ship_method.py runs/recae-small object/ view/

The weights are halved first, and judged as they are shipped, on test pairs of the releases given (see
benchmarks/scoring/trained_method.py). `kinectbench predict <name> RELEASE` then runs them. The method's
folder, kinectbench/networks/trained/<name>/, holds the configuration, the weights, how they came to
be, the course as a picture, and the figures that it is shipped for.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from kinectbench.core.artefacts.method import TrainingFile
from kinectbench.networks.config import read_config
from kinectbench.networks.run_folder import CONFIG, CURVES
from kinectbench.networks.trained import FOLDER, open_trained
from kinectbench.networks.weights import FILE, read_weights, write_weights

MOST_BYTES = 6_000_000
FIGURES = "figures.json"
BENCHMARKS = Path(__file__).parents[1] / "benchmarks" / "run.py"


def halved(run: Path, out: Path) -> None:
    """What is shipped of a training, in a folder of its own."""
    for name in (CONFIG, TrainingFile.FILE, CURVES):
        shutil.copyfile(run / name, out / name)
    arrays = read_weights(run / FILE)
    write_weights(
        {k: v.astype(np.float16) if v.dtype == np.float32 else v for k, v in arrays.items()}, out / FILE
    )
    open_trained(out)  # it can be run


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, help="a folder of `kinectbench train`")
    parser.add_argument("releases", type=Path, nargs="+", help="with test objects that it never saw")
    options = parser.parse_args()
    training = TrainingFile.read(options.run)
    if training.steps != training.steps_in_all:
        parser.error(f"{options.run}: {training.steps} of {training.steps_in_all} steps are done; train on")
    with TemporaryDirectory() as folder:
        out = Path(folder) / read_config(options.run / CONFIG).name
        out.mkdir()
        halved(options.run, out)
        size = (out / FILE).stat().st_size
        if size > MOST_BYTES:
            parser.error(f"{size} bytes of weights; {MOST_BYTES} is the most that the package takes")
        words = ["trained_method", out, *options.releases, "--json", out / FIGURES]
        judged = subprocess.run([sys.executable, BENCHMARKS, *words])
        if judged.returncode:
            parser.error("it is not shipped: see the figures above")
        figures = json.loads((out / FIGURES).read_text(encoding="utf-8"))["figures"]
        (out / FIGURES).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
        shutil.rmtree(FOLDER / out.name, ignore_errors=True)
        shutil.copytree(out, FOLDER / out.name)
    print(f"{FOLDER / out.name}: {size} bytes of weights")


if __name__ == "__main__":
    main()
