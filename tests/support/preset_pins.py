"""What is frozen of the presets and of the furniture, as numbers and hashes.

`python tests/support/preset_pins.py` writes preset_pins.json anew: for new presets only, never to make a
test pass.
"""

import hashlib
import json
import platform
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.extras import package_version
from kinectbench.core.storage import canonical_json, sha256_text
from kinectbench.lab.simulate.objects import PAPER_FURNITURE, make_object
from kinectbench.lab.simulate.presets import PRESETS, preset_spec
from kinectbench.lab.simulate.simulate import prepare, record_frame

PINS = Path(__file__).with_name("preset_pins.json")
OBJECTS = tuple((family, seed) for family in PAPER_FURNITURE for seed in (0, 1, 2))
PACKAGES = ("numpy", "numba", "open3d", "manifold3d", "opencv-python-headless", "scipy")


def machine() -> str:
    """Names the machine and packages whose bytes are pinned: elsewhere rays differ in their last bits."""
    cpu = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = [
            line
            for line in info.read_text(encoding="utf-8").splitlines()
            if line.startswith(("model name", "flags"))
        ]
        cpu = "\n".join(sorted(set(lines)))
    return sha256_text(canonical_json([cpu, [package_version(name) for name in PACKAGES]]))[:16]


def spec_hash(name: str) -> str:
    """Of everything that a preset says."""
    return sha256_text(canonical_json(preset_spec(name, {}).model_dump(mode="json")))[:16]


def rounded_hash(values: NDArray[np.floating], decimals: int = 6) -> str:
    """Of numbers rounded, so that another machine's last bits make no difference."""
    return hashlib.sha256((np.round(values, decimals) + 0.0).astype("<f8").tobytes()).hexdigest()[:16]


def object_pin(family: str, seed: int) -> dict[str, Any]:
    mesh = make_object(family, seed).mesh
    return {
        "faces": len(mesh.faces),
        "volume_m3": round(mesh.volume_m3, 9),
        "vertices": rounded_hash(np.sort(mesh.vertices, axis=0)),
    }


def preset_pin(name: str) -> dict[str, Any]:
    """Of a preset: its spec, its true path, and two frames as they are recorded."""
    simulation = prepare(preset_spec(name, {}))
    frames = [record_frame(simulation, index).frame for index in (0, len(simulation.frames) // 2)]
    pixels = b"".join(frame.depth_m.tobytes() + frame.color_rgb.tobytes() for frame in frames)
    return {
        "spec": spec_hash(name),
        "frames": len(simulation.frames),
        "path": rounded_hash(simulation.T_world_camera),
        "valid_share": round(float(np.mean([frame.depth_m > 0 for frame in frames])), 4),
        "mean_depth_m": round(
            float(np.mean([frame.depth_m[frame.depth_m > 0].mean() for frame in frames])), 4
        ),
        "mean_color": round(float(np.mean([frame.color_rgb for frame in frames])), 2),
        "pixels": hashlib.sha256(pixels).hexdigest()[:16],
    }


def pins() -> dict[str, Any]:
    return {
        "machine": machine(),
        "objects": {f"{family}:seed={seed}": object_pin(family, seed) for family, seed in OBJECTS},
        "presets": {name: preset_pin(name) for name in PRESETS},
    }


if __name__ == "__main__":
    PINS.write_text(json.dumps(pins(), indent=1) + "\n")
