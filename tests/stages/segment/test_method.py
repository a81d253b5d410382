"""Whether the record of how a solid was made forgets a constant."""

import ast
import importlib
import inspect
import pkgutil
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.stages import segment
from kinectbench.stages.segment.judge import method
from kinectbench.stages.segment.solid.evidence import FloorLayers, Rules

# Modules of whose constants none is recorded, and why.
ASIDE = {
    "candidates": "boxes for a person, who chooses from them",
    "coverage_report": "warnings and what they rest on, which quality.json has",
    "depth_bias": "whose depth it is: `inverse_depth_steps` in quality.json",
    "floor": "the floor, which floor.json has with how well it was measured",
    "floor_choice": "the floor, as above; floor.json has the planes among which it was chosen",
    "given": "what a person says: it stands in the settings, and the box in quality.json",
    "hints": "which planes may be the floor: floor.json has the one that is",
    "moving": "what is chosen, not how it is made solid: `selection` in quality.json says how",
    "object": "what is chosen, as above",
    "pieces": "what is chosen, as above, and warnings, which say what they found",
    "planes": "planes of the scene, from which the floor is chosen: floor.json has the one that is",
    "scale": "how near the cameras were: floor.json has the scale",
    "quality": "warnings and the verdict, which say what they found",
}
# Constants that shape nothing but words, extents of grids, or solids that are only compared.
NO_FIGURES = {
    ("segment", "SOLIDS"): "of the progress bar",
    ("frontiers", "STREAKS"): "words of advice, as is the size of a frontier",
    ("frontiers", "STEEP"): "words of advice; `look_from` is recorded",
    ("frontiers", "LEVEL"): "words of advice; `look_from` is recorded",
    ("frontiers", "LOWER"): "words of advice; `look_from` is recorded",
    ("frontiers", "TURN_STEP_DEG"): "words of advice; `look_from` is recorded",
    ("frontiers", "HALF_TURN_DEG"): "words of advice; `look_from` is recorded",
    ("frontiers", "VIEW_DIRECTIONS"): "how finely `look_from` is reported",
    ("frontiers", "CAMERA_ELEVATION_RAD"): "which of equal directions is reported; `look_from` is recorded",
    ("frontiers", "HIT_CELLS"): "words of advice and of a warning: whether something stands in the way",
    ("frontiers", "BESIDE_CELLS"): "words of advice and of a warning, as above",
    ("frontiers", "WALL_CELLS"): "words of advice and of a warning, as above",
    ("frontiers", "TRIED_LINES"): "words of advice and of a warning, as above",
    ("frontiers", "WALL_STEEP"): "words of advice and of a warning, as above",
    ("estimate", "LEAST_CUT_SHARE"): "a warning, which says what it found, as do the estimate's reasons",
    ("estimate", "EXPECTED_SHARE"): "the estimate's reasons say what the floor cut takes off",
    ("estimate", "LEAST_LOW_M"): "words of a warning: what the setting allows",
    ("guess", "UNSEEN"): "the state of a voxel",
    ("guess", "OUTSIDE"): "the state of a voxel",
    ("guess", "INSIDE"): "the state of a voxel",
    ("guess", "NEUTRAL"): "the state of a voxel",
    ("grids", "MARGIN_M"): "extents of grids, which every volume has",
    ("grids", "MARGIN_VOXELS"): "extents of grids, as above",
    ("grids", "FLOOR_LAYERS"): "extents of grids, as above",
    ("grids", "SURROUND_FACTOR"): "extents of grids, as above",
    ("grids", "SURROUND_RADII"): "extents of grids, as above",
    ("grids", "MAX_VOXELS"): "extents of grids, as above",
    ("grids", "MAX_SURROUND_CELLS"): "extents of grids, as above",
    ("grids", "CUBE_VOXELS"): "extents of grids, as above",
    ("evidence", "BLURRED_PIXELS"): "`blurred_m` is recorded",
    ("evidence", "COARSE"): "of the solids of odd and of even frames, which are only compared",
}
PATHS = {
    name.rpartition(".")[2]: name
    for _, name, is_package in pkgutil.walk_packages(segment.__path__, f"{segment.__name__}.")
    if not is_package
}
MODULES = list(PATHS)


def module_of(name: str) -> ModuleType:
    return importlib.import_module(PATHS[name])


def parsed(module: ModuleType) -> ast.Module:
    return ast.parse(inspect.getsource(module))


def is_numeric(value: Any) -> bool:
    """A number, or a container of some."""
    if isinstance(value, dict):
        value = (*value, *value.values())
    if isinstance(value, tuple | list | set | frozenset):
        return any(is_numeric(one) for one in value)
    return isinstance(value, int | float | np.number | np.ndarray)


def constants(module: ModuleType) -> set[str]:
    """Names of the numeric constants that a module gives a value itself."""
    named: set[str] = set()
    for node in parsed(module).body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
        for target in targets:
            named |= {one.id for one in ast.walk(target) if isinstance(one, ast.Name)}
    return {name for name in named if is_numeric(getattr(module, name))}


def recorded() -> set[tuple[str, str]]:
    """Module and name of the constants that `method` records, which it writes as `module.NAME`."""
    return {
        (node.value.id, node.attr)
        for node in ast.walk(parsed(method))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in MODULES
    }


@pytest.mark.parametrize("name", [name for name in MODULES if name not in ASIDE])
def test_no_constant_of_the_solid_is_forgotten(name: str) -> None:
    found = {(name, constant) for constant in constants(module_of(name))}
    assert found - recorded() - set(NO_FIGURES) == set()


def test_every_exception_is_one() -> None:
    for name in ASIDE:
        assert constants(module_of(name)) and name not in {module for module, _ in recorded()}
    assert all(constant in constants(module_of(name)) for name, constant in NO_FIGURES)
    assert not set(NO_FIGURES) & recorded()


def test_what_a_constant_is() -> None:
    assert {"SHELL_M", "MIN_FREE_VOTES", "MIN_FREE_SHARE"} <= constants(module_of("evidence"))
    assert {"ENCLOSED", "RIM_SHARE"} <= constants(module_of("guess"))
    # Neither words nor what another module gives a value to.
    assert "NO_FLOOR" not in constants(module_of("floor")) and "REPORTED_ABOVE_SHARE" not in constants(
        module_of("floor")
    )
    assert ("evidence", "SHELL_M") in recorded() and ("evidence", "FINE") in recorded()


def test_the_rules_of_an_object_are_recorded() -> None:
    rules = Rules(FloorLayers(4, 2), limits=SensorLimits(line_width_m=0.02), underside="closed", stands=False)
    air = method.method(rules).air
    assert air is not None
    assert (air.line_width_m, air.near_m, air.underside, air.stands) == (0.02, 0.4, "closed", False)
