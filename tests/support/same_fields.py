"""Two values of one dataclass compared field by field, so that a field that is added is compared, too."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def assert_same_fields(one: Any, other: Any, within: Mapping[str, float], path: str = "") -> None:
    """Every field of two dataclasses, and of dataclasses in them, is equal.

    Args:
        one: what was written.
        other: what was read.
        within: largest difference of fields that are stored rounded, by their path such as `floor.noise_m`.
        path: of the two values.
    """
    if is_dataclass(one):
        assert type(one) is type(other), path
        for field in fields(one):
            inner = f"{path}.{field.name}" if path else field.name
            assert_same_fields(getattr(one, field.name), getattr(other, field.name), within, inner)
    elif path in within:
        np.testing.assert_allclose(other, one, rtol=0, atol=within[path], err_msg=path)
    elif isinstance(one, np.ndarray):
        assert other.dtype == one.dtype, path
        np.testing.assert_array_equal(other, one, err_msg=path)
    elif isinstance(one, float):
        np.testing.assert_equal(other, one, err_msg=path)  # NaN is NaN
    else:
        assert other == one, path
