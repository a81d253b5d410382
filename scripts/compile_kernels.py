"""Compile the kernels once, so that the first build need not: a sample recording goes from frames to scores.

Numba keeps what it compiles beside the sources; later processes load it. What a benchmark compiles depends on
the types of its arrays alone, so a single recording with two views is enough. scripts/setup.sh runs this.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
YAML = """\
name: kernels
license: CC0-1.0
recordings:
  - {{id: chair_01, path: "{path}", category: chair, split: test}}
views: {{count: 2}}
"""
# One process: several would compile the same kernels side by side.
COMMANDS = (
    ("simulate", "simulated", "--object", "chair:seed=1", "--frames", "2", "--set", "save_depth=false"),
    ("build", "--jobs", "1"),
    # How good two views of coarse voxels are does not matter here.
    ("publish", "--jobs", "1", "--allow-poor"),
    ("score", "--jobs", "1"),
)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        text = YAML.format(path=ROOT / "recordings" / "chair_01")
        (Path(folder) / "benchmark.yaml").write_text(text)
        for arguments in COMMANDS:
            words = [sys.executable, "-m", "kinectbench", *arguments]
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
            if done.returncode:
                sys.exit(f"kinectbench {' '.join(arguments)}: {done.stderr.strip()}")


if __name__ == "__main__":
    main()
