"""Check that the grids and matrices of one published pair are as docs/format.md defines them."""

from collections.abc import Iterator, Mapping

import numpy as np

from kinectbench.core.geometry import ORTHONORMAL_TOLERANCE, is_rigid
from kinectbench.core.voxels.pair_file import (
    FULL_CELLS,
    OPTIONAL,
    Packed,
    Pair,
    PairInput,
    pack,
    packed_count,
    unpack,
)
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.solid import packed_shell
from kinectbench.core.voxels.view_grids import containment

LEAST_TRUSTED_SHARE = 0.5


def pair_problems(
    pair: Pair,
    *,
    min_containment: float,
    framing: str,
    partial_rule: str,
    unknown_shares: Mapping[str, float] = {},
    surface_sigma_m: float | None = None,
) -> Iterator[str]:
    """Yield a message for each fault of a pair; messages do not name the file.

    Args:
        pair: a pair whose keys, shapes and dtypes are checked already.
        min_containment: smallest share of the partial inside the full shape, from the benchmark's settings.
        framing: the framing in benchmark.json: cubes are fitted to the "object" or to the "view".
        partial_rule: the rule for partials in benchmark.json, "any" or "majority".
        unknown_shares: {file name: unknown share of the true shape that this file states}. Early releases
            state it in fewer files or in none.
        surface_sigma_m: the surface's standard deviation as benchmark.json states it; None if it does not.
    """
    yield from input_problems(pair, framing=framing, partial_rule=partial_rule)
    if not (np.isfinite(pair.surface_sigma_m) and pair.surface_sigma_m >= 0):
        yield f"surface_sigma_m is {pair.surface_sigma_m}, not a standard deviation"
    elif surface_sigma_m is not None and pair.surface_sigma_m != surface_sigma_m:
        yield f"surface_sigma_m is {pair.surface_sigma_m} where benchmark.json has {surface_sigma_m}"
    if not pair.full.any():
        yield "'full' is empty"
    wrong = packed_count(pair.shell ^ packed_shell(pair.full))
    if wrong:
        yield f"{wrong} cells of 'shell' are not as the surface of 'full'"
    yield from _trust_problems(pair, "known", pair.known)
    for name in OPTIONAL:
        grid: Packed | None = getattr(pair, name)
        if grid is not None and (beyond := packed_count(grid & ~pair.known)):
            yield f"{beyond} cells of '{name}' are not 'known'"
    found = pair.stated_unknown_share
    for file, said in unknown_shares.items():
        if said != found:
            yield f"{found} of the true shape is unknown where {file} has {said}"
    # These are the cells before the partial rule thinned them out; cells outside the cube are not in the
    # file.
    touched = pack(reduce_blocks(unpack(pair.partial_256), "any"))
    inside = containment(touched, pair.full)
    if inside < min_containment:
        yield f"containment is {inside:.3f}, below {min_containment}"


def input_problems(pair: Pair | PairInput, *, framing: str, partial_rule: str) -> Iterator[str]:
    """Yield a message for each fault of a pair's input (the part that is published even without truth).

    `framing` and `partial_rule` are those stated in benchmark.json, as in `pair_problems`.
    """
    for name in ("T_world_grid", "T_world_camera"):
        if not is_rigid(getattr(pair, name)):
            yield f"{name} is not a rotation and a shift"
    if not np.allclose(pair.T_world_grid[:3, :3], pair.T_world_camera[:3, :3], atol=ORTHONORMAL_TOLERANCE):
        yield "the grid's axes are not the view's"
    if not (pair.K[0, 0] > 0 and pair.K[1, 1] > 0):
        yield "the focal lengths in K are not positive"
    for name, expected in (("framing", framing), ("partial_rule", partial_rule)):
        if getattr(pair, name) != expected:
            yield f"{name} is '{getattr(pair, name)}' where the benchmark has '{expected}'"
    if not pair.partial.any():
        yield "'partial' is empty"
    if pair.partial_rule in ("any", "majority"):
        reduced = pack(reduce_blocks(unpack(pair.partial_256), pair.partial_rule))
        differ = packed_count(reduced ^ pair.partial)
        if differ:
            yield f"{differ} cells of 'partial' are not 'partial_256' reduced by '{pair.partial_rule}'"
    yield from _trust_problems(pair, "seen", pair.seen)
    yield from _behind_problems(pair)


def _trust_problems(pair: Pair | PairInput, name: str, grid: Packed) -> Iterator[str]:
    """Yield a message if less than half of `partial_256` lies in `grid`, which is `known` or `seen`.

    The surface that a view measures is both known and seen, so nearly all of `partial_256` should lie in both
    grids; every usable recording reaches one half. The release's files do not suffice to compute either grid.
    """
    cells, inside = packed_count(pair.partial_256), packed_count(pair.partial_256 & grid)
    if inside < LEAST_TRUSTED_SHARE * cells:
        yield f"only {inside} of the {cells} cells of 'partial_256' are '{name}'"


def _behind_problems(pair: Pair | PairInput) -> Iterator[str]:
    """Yield a message if `seen` contains cells behind the camera."""
    if pair.voxel_size_m > 0:
        corner_z_m = float(
            (pair.T_world_grid[:3, 3] - pair.T_world_camera[:3, 3]) @ pair.T_world_camera[:3, 2]
        )
        behind = int(np.clip(np.floor(0.5 - corner_z_m / pair.voxel_size_m), 0, FULL_CELLS))
        if unpack(pair.seen)[:, :, :behind].any():
            yield "'seen' holds cells behind the camera"
