"""`evaluate` on builds whose errors are known: perfect, noisy, dilated, partly unknown, of another world.

The object is a chair of boxes, so that volumes and distances are known exactly.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from figures import Figure, arguments, at_least, at_most, equals, run, told
from known_builds import FRAMES, chair, known_build, make_truth, noisy, write_build

from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.lab.evaluate.evaluation import Evaluation, evaluate
from kinectbench.lab.evaluate.run import evaluate_recording
from kinectbench.lab.evaluate.surface import surface_errors, surface_figures
from kinectbench.lab.simulate.truth import Truth, write_truth

NOISE_M, SEEDS = 0.005, range(20)
DILATED_M = 0.004
UNKNOWN_ABOVE_M = 0.4
OTHER_WORLD = rigid(rotation_from_quaternion_xyzw([0.3, -0.2, 0.5, 0.7]), [1.0, -2.0, 0.5])


def near(name: str, value: float, expected: float, tolerance: float) -> Figure:
    """A figure that has to be within a tolerance of what is expected."""
    return Figure(
        name, value, f"= {expected:.5g} ± {tolerance:.2g}", bool(abs(value - expected) <= tolerance)
    )


def perfect_figures(name: str, e: Evaluation) -> Iterator[Figure]:
    """Every figure of a build that is the truth."""
    assert e.trajectory and e.trajectory.error and e.floor and e.surface and e.solid and e.masks and e.pairs
    assert e.pairs.iou and e.pairs.containment and e.pairs.true_unknown_share and e.masks.worst_valid_iou
    yield at_most(f"{name}: ATE rmse, mm", e.trajectory.error.ate_m.rmse * 1000, 1e-6)
    yield equals(f"{name}: share tracked", e.trajectory.tracked_share, 1.0)
    yield at_most(f"{name}: floor angle, rad", e.floor.angle_rad, 1e-6)
    yield at_most(f"{name}: floor height, mm", abs(e.floor.height_m) * 1000, 1e-3)
    for part, figures in (("all", e.surface.whole), ("seen", e.surface.visible)):
        assert figures.accuracy
        yield at_most(f"{name}: accuracy, {part}, mean, mm", figures.accuracy.mean_m * 1000, 1e-3)
        yield equals(f"{name}: F at 5 mm, {part}", figures.scores[0].f, 1.0)
    # A cell flips whose centre lies on a face to within the rounding of the vertices.
    yield at_least(f"{name}: IoU 256^3", e.solid.fine.iou, 0.9999)
    yield at_least(f"{name}: IoU 64^3", e.solid.coarse.iou, 0.999)
    yield equals(f"{name}: true solid labelled unknown", e.solid.fine.true_unknown_share, 0.0)
    yield equals(f"{name}: empty space labelled unknown", e.solid.fine.empty_unknown_share, 0.0)
    yield equals(f"{name}: mask IoU, worst", e.masks.worst_valid_iou, 1.0)
    yield at_least(f"{name}: pair IoU, worst", e.pairs.iou.worst, 0.9999)
    yield equals(f"{name}: containment, worst", e.pairs.containment.worst, 1.0)


def noise_figures(truth: Truth) -> Iterator[Figure]:
    """5 mm of noise on every axis of every position."""
    build = replace(known_build(truth).build, model=None, views=None)
    errors = []
    for seed in SEEDS:
        trajectory = evaluate(noisy(build, NOISE_M, seed), truth).trajectory
        assert trajectory and trajectory.error
        errors.append(trajectory.error)
    ate_mm = 1000 * np.sqrt(np.mean([e.ate_m.rmse**2 for e in errors]))
    rpe_mm = 1000 * np.sqrt(np.mean([e.rpe_frame_m.rmse**2 for e in errors]))
    # Of 3 n coordinates six are used up by the alignment; an ATE of n poses varies by 1 / sqrt(6 n).
    expected_mm = 1000 * NOISE_M * np.sqrt(3 - 6 / FRAMES)
    varies_mm = 3 * expected_mm / np.sqrt(6 * FRAMES * len(SEEDS))
    yield near(f"noise of 5 mm: ATE rmse over {len(SEEDS)} seeds, mm", float(ate_mm), expected_mm, varies_mm)
    both_mm = 1000 * NOISE_M * np.sqrt(6)
    yield near("noise of 5 mm: RPE rmse per frame, mm", float(rpe_mm), both_mm, 0.03 * both_mm)


def dilated_figures(truth: Truth) -> Iterator[Figure]:
    """A mesh that is the solid dilated by 4 mm."""
    known = known_build(truth, dilated_m=DILATED_M)
    e = evaluate(known.build, truth)
    assert e.surface and e.solid and e.pairs and e.pairs.iou and known.build.model
    assert e.surface.whole.accuracy and e.surface.whole.completeness
    name = "dilated by 4 mm"
    yield near(f"{name}: accuracy mean, mm", e.surface.whole.accuracy.mean_m * 1000, 4.0, 0.01)
    yield near(f"{name}: mean signed error, mm", e.surface.mean_signed_m * 1000, 4.0, 0.01)
    yield near(f"{name}: completeness mean, mm", e.surface.whole.completeness.mean_m * 1000, 4.01, 0.02)
    thresholds = surface_figures(surface_errors(known.build.model.shape.mesh, truth), (0.003, 0.005, 0.010))
    at_3, at_5, at_10 = (score.f for score in thresholds.whole.scores)
    yield equals(f"{name}: F at 3 mm", at_3, 0.0)
    yield at_least(f"{name}: F at 5 mm (less in concave edges)", at_5, 0.995)
    yield equals(f"{name}: F at 10 mm", at_10, 1.0)
    exact = chair().volume() / chair(DILATED_M).volume()
    yield near(f"{name}: IoU of the pairs 256^3 (ratio of the volumes)", e.pairs.iou.mean, exact, 0.001)
    yield near(f"{name}: IoU 256^3, in the object's own axes", e.solid.fine.iou, exact, 0.02)
    yield told(f"{name}: IoU 64^3, in the object's own axes", e.solid.coarse.iou)


def unknown_figures(truth: Truth) -> Iterator[Figure]:
    """Labels that are unknown above 0.4 m."""
    e = evaluate(known_build(truth, unknown_above_m=UNKNOWN_ABOVE_M).build, truth)
    assert e.solid and e.pairs and e.pairs.true_unknown_share
    solid_m3, above_m3 = chair().volume(), chair().trim_by_plane([0, 0, 1], UNKNOWN_ABOVE_M).volume()
    side_m = 0.85 * 256 / 252
    upper_m3 = (0.425 + side_m / 2 - UNKNOWN_ABOVE_M) * side_m**2
    exact, exact_empty = above_m3 / solid_m3, (upper_m3 - above_m3) / (side_m**3 - solid_m3)
    name = "unknown above 0.4 m"
    yield near(f"{name}: share of the true solid", e.solid.fine.true_unknown_share, exact, 0.01)
    yield near(f"{name}: share of empty space", e.solid.fine.empty_unknown_share, exact_empty, 0.005)
    yield near(f"{name}: share of the true solid, pairs", e.pairs.true_unknown_share.mean, exact, 0.002)
    yield equals(f"{name}: IoU 256^3 of what is known", e.solid.fine.known_iou, 1.0)


def measure(root: Path) -> list[Figure]:
    """All builds, the perfect one through the disk too."""
    truth = make_truth(root / "chair.truth")
    write_truth(truth, {})
    perfect = known_build(truth)
    write_build(perfect, root / "build")
    steps: list[Callable[[], Iterator[Figure]]] = [
        lambda: perfect_figures("perfect", evaluate(perfect.build, truth)),
        lambda: perfect_figures(
            "perfect, other world", evaluate(known_build(truth, T_built_truth=OTHER_WORLD).build, truth)
        ),
        lambda: perfect_figures(
            "perfect, on disk", evaluate_recording(root / "build", root / "chair.truth", root / "evaluation")
        ),
        lambda: noise_figures(truth),
        lambda: dilated_figures(truth),
        lambda: unknown_figures(truth),
    ]
    return [figure for step in steps for figure in step()]


def main() -> None:
    options = arguments(__doc__).parse_args()
    with tempfile.TemporaryDirectory(prefix="kinectbench-") as folder:
        run(options, lambda: measure(Path(folder)))


if __name__ == "__main__":
    main()
