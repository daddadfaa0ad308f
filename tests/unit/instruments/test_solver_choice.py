"""Choice of the solver by `solver="auto"`."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.instruments.solver import AUTO, DISCRETE_ORDINATES, MONTE_CARLO, choose_solver

WAVELENGTHS = np.array([600.0, 1300.0])
NATURAL = splits.Snow.natural(specific_surface_area_m2_kg=20.0)
WET = splits.Snow.natural(specific_surface_area_m2_kg=20.0, liquid_water_content=0.05)


@pytest.mark.parametrize(
    ("media", "max_stderr", "solver"),
    [
        ([NATURAL], 0.002, DISCRETE_ORDINATES),
        ([NATURAL, WET], 0.002, DISCRETE_ORDINATES),
        ([NATURAL, splits.Snow()], 0.002, MONTE_CARLO),
        # Paths would not reach a smaller error either.
        ([NATURAL], 1e-6, DISCRETE_ORDINATES),
        # The balance of dry and wet pores has a larger error than the tables.
        ([NATURAL], 4e-4, DISCRETE_ORDINATES),
        ([WET], 4e-4, MONTE_CARLO),
    ],
)
def test_auto_chooses_discrete_ordinates_where_they_are_accurate_enough(media, max_stderr, solver):
    assert choose_solver(AUTO, media, WAVELENGTHS, max_stderr=max_stderr) == solver


def test_discrete_ordinates_by_name_state_the_error_that_they_reach():
    spectrum = splits.spectrophotometer(
        NATURAL, WAVELENGTHS, max_stderr=1e-6, solver=DISCRETE_ORDINATES
    )
    assert spectrum.attrs["max_stderr_reached"] > 1e-6
    assert spectrum.attrs["stop_reason"] == "solver_error"


def test_directions_by_paths_suggest_a_finite_depth_or_discrete_ordinates():
    with pytest.raises(ValueError, match=r"depth_m = inf.*solver discrete_ordinates"):
        splits.goniophotometer(NATURAL, [500], solver=MONTE_CARLO)
