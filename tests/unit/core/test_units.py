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
     ("kg * m^-3", "kg m-3", 1.0), ("rad", "degree", 57.29577951), ("Kg/m3", "kg m-3", 1.0),
     ("kg m⁻³", "kg m-3", 1.0), ("kg·m⁻³", "kg m-3", 1.0), ("G/CM³", "kg m-3", 1000.0),
     ("m²/Kg", "m2 kg-1", 1.0), ("M2/KG", "m2 kg-1", 1.0), ("℃", "degC", 1.0),
     ("Micron", "um", 1.0), ("μm", "um", 1.0), ("Cm", "m", 0.01), ("in", "m", 0.0254),
     ("ft", "m", 0.3048), ("kg m−3", "kg m-3", 1.0),
     ("cells / mL", "ml-1", 1.0), ("L-1", "ml-1", 1e-3)],
)  # fmt: skip
def test_values_are_converted(unit, target, expected):
    assert convert_units("x", np.array(1.0), unit, target) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("unit", "target"),
    [("M", "m"), ("Mm", "m"), ("Mm", "um"), ("Mg m-3", "kg m-3"), ("Mg/kg", "1e-9"),
     ("kg", "kg m-3"), ("C", "degC"), (1, "m")],
)  # fmt: skip
def test_other_units_are_rejected(unit, target):
    assert not is_unit(unit, target)
    with pytest.raises(InvalidValue, match=r"x.units = .*must be one of"):
        convert_units("x", np.ones(2), unit, target)
