"""The released index of 3D-RecGAN++, and a checkpoint of a sixteenth of its channels with random values."""

from pathlib import Path

import numpy as np

from kinectbench.core.types import Float32

RELEASED = Path(__file__).parents[1] / "networks" / "recgan_released" / "model.cptk.index"


def narrow_recgan() -> dict[str, Float32]:
    """Random values for all tensors of a network of a sixteenth of the channels, as TensorFlow lays them."""
    from kinectbench.networks.convert import mapping
    from kinectbench.networks.tensor_bundle import open_bundle

    bundle = open_bundle(RELEASED)
    sizes = {
        1: 1,
        8: 4,
        16: 4,
        17: 5,
        32: 4,
        64: 4,
        128: 8,
        256: 16,
        512: 32,
        1024: 64,
        2000: 125,
        32768: 2048,
    }
    # What two layers give together is narrowed one by one.
    joined = {"aeu/d2_w": 16 + 16, "aeu/d3_w": 8 + 8, "aeu/d4_w": 4 + 4}
    generator = np.random.default_rng(0)
    found = {}
    for name in mapping():
        shape = bundle.tensors[name].shape
        if len(shape) == 5:
            channels = [sizes[shape[3]], joined.get(name, sizes[shape[4]])]
            shape = (4, 4, 4, *channels)
        else:
            shape = tuple(sizes[count] for count in shape)
        # So that what comes in comes out about as strong: of a transposed convolution 8 cells meet in one.
        terms = 8 * shape[-1] if name.startswith("aeu/d") else int(np.prod(shape[:-1]))
        scale = np.sqrt(2.9 / terms) if len(shape) > 1 else 0.1
        found[name] = generator.normal(0, scale, shape).astype(np.float32)
    return found
