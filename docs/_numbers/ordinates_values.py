"""Errors of discrete ordinates in documents, from the tables of grains of the package."""

from __future__ import annotations

import numpy as np

import splits
from _numbers.formatting import QuotedNumber, QuotedValue
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import compute_optics_error

WAVELENGTHS_NM = np.arange(400.0, 2501.0, 10.0)


def _compute_smallest_error(liquid_water_content: float) -> QuotedValue:
    """Return the error of natural snow that no number of streams reduces."""
    snow = splits.Snow.natural(
        specific_surface_area_m2_kg=20, liquid_water_content=liquid_water_content
    )
    error = compute_optics_error(make_granular_stack(snow, WAVELENGTHS_NM))
    return float(error.max()), None, ""


ORDINATES_NUMBERS = {
    "ordinates.smallest.dry": QuotedNumber("", lambda _: _compute_smallest_error(0.0), ".1e"),
    "ordinates.smallest.wet": QuotedNumber("", lambda _: _compute_smallest_error(0.02), ".1e"),
}
"""Numbers of `_numbers.values`."""
