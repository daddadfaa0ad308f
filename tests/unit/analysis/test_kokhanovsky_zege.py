"""A published law of snow as a table."""

from __future__ import annotations

import numpy as np
import pytest
import snowoptics
from formula_tables import make_table

from splits.analysis.theory.kokhanovsky_zege import make_law_table
from splits.core.validation import InvalidValue
from splits.materials.impurities import make_impurities

W = np.array([500.0, 1000.0, 1300.0])
AREA, RADIUS, SOOT = (
    "specific_surface_area_m2_kg",
    "optical_radius_um",
    "impurities_ng_g.black_carbon",
)


def blank(**axes):
    """Return a table over some axes."""
    return make_table(lambda *point: np.full(W.size, 0.5), axes, w=W)


def test_clean_snow_equals_that_of_the_package():
    found = make_law_table(blank(**{AREA: [5.0, 20.0], "incidence_deg": [30.0, 60.0]}))
    assert found.axes == [AREA, "incidence_deg", "wavelength"]
    for i, area in enumerate((5.0, 20.0)):
        for j, beam in enumerate((30.0, 60.0)):
            theirs = snowoptics.albedo_direct_KZ04(1e-9 * W, np.radians(beam), area)
            np.testing.assert_allclose(found.dataset.reflectance.values[i, j], theirs, rtol=1e-12)


def test_a_radius_stands_for_its_area():
    one = make_law_table(blank(**{AREA: [10.0, 20.0]})).dataset.reflectance.values
    radii = [3e6 / (917.0 * 20.0), 3e6 / (917.0 * 10.0)]
    other = make_law_table(blank(**{RADIUS: radii})).dataset.reflectance.values
    np.testing.assert_allclose(other[::-1], one, rtol=1e-12)


def test_impurities_absorb_as_in_the_package():
    """2 c M/SSA more of 1 − ω, whose root the logarithm of albedo goes as."""
    found = make_law_table(
        blank(**{AREA: [20.0, 30.0], SOOT: [0.0, 100.0]})
    ).dataset.reflectance.values
    clean, dirty = np.log(found[0])
    per_ice = make_impurities({"black_carbon": 100.0}, {})[0].compute_absorption_per_kg_ice(W)
    k = 3.0 / 7.0 * (1.0 + 2.0)
    more = 16.0 / 3.0 * 2.0 * per_ice / 20.0 / (1.0 - snowoptics.default_g)
    np.testing.assert_allclose((dirty / k) ** 2 - (clean / k) ** 2, more, rtol=1e-9)


def test_axes_outside_the_law_are_left_out_at_zero():
    given = blank(**{AREA: [5.0, 20.0], "liquid_water_content": [0.0, 0.1]})
    assert make_law_table(given).axes == [AREA, "wavelength"]
    with pytest.raises(InvalidValue, match="liquid_water_content"):
        make_law_table(blank(**{AREA: [5.0, 20.0], "liquid_water_content": [0.05, 0.1]}))
    with pytest.raises(InvalidValue, match=AREA):
        make_law_table(blank(saturation=[0.0, 0.5]))
