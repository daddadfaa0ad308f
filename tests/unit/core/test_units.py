"""Units of input data."""

from __future__ import annotations

import numpy as np
import pytest

from splits.core.units import CONVERSIONS, convert_units, is_unit
from splits.core.validation import InvalidValue


@pytest.mark.parametrize("target", CONVERSIONS)
def test_every_spelling_is_known_and_the_target_changes_nothing(target):
    values = np.array([1.0, np.nan])
    for unit in CONVERSIONS[target]:
        assert is_unit(unit, target)
        assert np.isfinite(convert_units("x", values, unit, target)[0])
    for unit in (target, None, " "):
        np.testing.assert_array_equal(convert_units("x", values, unit, target), values)


@pytest.mark.parametrize(
    ("unit", "target", "expected"),
    [("µm", "um", 1.0), ("m", "um", 1e6), ("K", "degC", -272.15), ("% by Vol", "1", 0.01),
     ("kg * m^-3", "kg m-3", 1.0), ("rad", "degree", 57.29577951),
     ("cells / mL", "ml-1", 1.0), ("L-1", "ml-1", 1e-3)],
)  # fmt: skip
def test_values_are_converted(unit, target, expected):
    assert convert_units("x", np.array(1.0), unit, target) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("unit", "target"), [("M", "m"), ("kg", "kg m-3"), ("C", "degC"), (1, "m")]
)
def test_other_units_are_rejected(unit, target):
    assert not is_unit(unit, target)
    with pytest.raises(InvalidValue, match=r"x.units = .*must be one of"):
        convert_units("x", np.ones(2), unit, target)
