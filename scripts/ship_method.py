"""Put a trained network into the package, with its weights in half precision.

    .venv/bin/python scripts/ship_method.py runs/recae-small scores/recae-small/scores.json

`kinectbench predict <name> RELEASE` then runs it. Its folder, kinectbench/scoring/methods/trained/<name>/,
holds the configuration, the weights, how they came to be, the course as a picture, and the scores that it is
shipped for.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.method import TrainingFile
from kinectbench.scoring.methods.config_file import read_config
from kinectbench.scoring.methods.run_folder import CONFIG, CURVES
from kinectbench.scoring.methods.trained import FOLDER, open_trained
from kinectbench.scoring.methods.weights import FILE, read_weights, write_weights

MOST_BYTES = 6_000_000


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, help="a folder of `kinectbench train`")
    parser.add_argument("scores", type=Path, help="scores.json of its predictions on held-out objects")
    options = parser.parse_args()
    out = FOLDER / read_config(options.run / CONFIG).name
    out.mkdir(parents=True, exist_ok=True)
    for name in (CONFIG, TrainingFile.FILE, CURVES):
        shutil.copyfile(options.run / name, out / name)
    shutil.copyfile(options.scores, out / "scores.json")
    arrays = read_weights(options.run / FILE)
    halved = {k: v.astype(np.float16) if v.dtype == np.float32 else v for k, v in arrays.items()}
    write_weights(halved, out / FILE)
    size = (out / FILE).stat().st_size
    if size > MOST_BYTES:
        shutil.rmtree(out)
        parser.error(f"{size} bytes of weights; {MOST_BYTES} is the most that the package takes")
    open_trained(out)  # it can be run
    print(f"{out}: {size} bytes of weights")


if __name__ == "__main__":
    main()
