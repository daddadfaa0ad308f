"""The asymptotic law of Kokhanovsky and Zege (2004) as a table."""

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


def make_blank_table(**axes):
    """Return a table of constant reflectance over given axes."""
    return make_table(lambda *point: np.full(W.size, 0.5), axes, w=W)


def test_clean_snow_matches_snowoptics():
    table = make_law_table(make_blank_table(**{AREA: [5.0, 20.0], "incidence_deg": [30.0, 60.0]}))
    assert table.axes == [AREA, "incidence_deg", "wavelength"]
    for i, area in enumerate((5.0, 20.0)):
        for j, beam in enumerate((30.0, 60.0)):
            expected = snowoptics.albedo_direct_KZ04(1e-9 * W, np.radians(beam), area)
            np.testing.assert_allclose(table.dataset.reflectance.values[i, j], expected, rtol=1e-12)


def test_optical_radius_is_equivalent_to_area():
    from_areas = make_law_table(make_blank_table(**{AREA: [10.0, 20.0]})).dataset.reflectance.values
    radii = [3e6 / (917.0 * 20.0), 3e6 / (917.0 * 10.0)]
    from_radii = make_law_table(make_blank_table(**{RADIUS: radii})).dataset.reflectance.values
    np.testing.assert_allclose(from_radii[::-1], from_areas, rtol=1e-12)


def test_impurities_add_the_expected_absorption():
    """Impurities add 2 c M/SSA to 1 − ω, and ln(albedo) is proportional to √(1 − ω)."""
    reflectance = make_law_table(
        make_blank_table(**{AREA: [20.0, 30.0], SOOT: [0.0, 100.0]})
    ).dataset.reflectance.values
    clean, dirty = np.log(reflectance[0])
    absorption = make_impurities({"black_carbon": 100.0}, {})[0].compute_absorption_per_kg_ice(W)
    k = 3.0 / 7.0 * (1.0 + 2.0)
    expected = 16.0 / 3.0 * 2.0 * absorption / 20.0 / (1.0 - snowoptics.default_g)
    np.testing.assert_allclose((dirty / k) ** 2 - (clean / k) ** 2, expected, rtol=1e-9)


def test_axes_outside_the_law_are_dropped_at_zero():
    table = make_blank_table(**{AREA: [5.0, 20.0], "liquid_water_content": [0.0, 0.1]})
    assert make_law_table(table).axes == [AREA, "wavelength"]
    with pytest.raises(InvalidValue, match="liquid_water_content"):
        make_law_table(make_blank_table(**{AREA: [5.0, 20.0], "liquid_water_content": [0.05, 0.1]}))
    with pytest.raises(InvalidValue, match=AREA):
        make_law_table(make_blank_table(saturation=[0.0, 0.5]))
