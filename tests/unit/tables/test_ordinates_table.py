"""Tables of spectra by discrete ordinates."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits

GRID = {
    "optical_radius_um": [50.0, 200.0, 800.0],
    "incidence_deg": [0.0, 60.0, 85.0],
    "liquid_water_content": [0.0, 0.05],
    "ground": [0.2, 0.6],
}
WAVELENGTHS = [500.0, 1030.0, 1500.0]


def test_table_equals_single_spectra():
    quantities = ["reflectance", "transmittance"]
    with pytest.warns(UserWarning, match=r"along depth_m between 0.02 and 0.3 has an error of 0"):
        table = splits.build_table(
            splits.Snow.natural, {**GRID, "depth_m": [0.02, 0.3]}, WAVELENGTHS, max_stderr=0.001,
            solver="discrete_ordinates", quantities=quantities,
        )  # fmt: skip
    assert table.attrs["solver"] == "discrete_ordinates"
    assert not table.isnull().any().to_array().any()
    for radius, angle, water in ((50.0, 0.0, 0.0), (800.0, 85.0, 0.05)):
        snow = splits.Snow.natural(
            optical_radius_um=radius, liquid_water_content=water, ground=0.6, depth_m=0.02
        )
        single = splits.spectrophotometer(
            snow, WAVELENGTHS, angle, 0.001, solver="discrete_ordinates"
        )
        node = table.sel(
            optical_radius_um=radius, incidence_deg=angle, liquid_water_content=water, ground=0.6,
            depth_m=0.02,
        )  # fmt: skip
        for name in quantities:
            # The number of streams of the table is that of all angles of incidence.
            error = node[f"{name}_stderr"].values + single[f"{name}_stderr"].values
            assert (np.abs(node[name].values - single[name].values) <= error).all()


def test_diffuse_light_is_an_incidence():
    table = splits.build_table(
        splits.Snow.natural, {"optical_radius_um": [100.0, 200.0]}, WAVELENGTHS, "diffuse",
        solver="auto",
    )  # fmt: skip
    snow = splits.Snow.natural(optical_radius_um=200.0)
    single = splits.spectrophotometer(snow, WAVELENGTHS, "diffuse", 0.003, solver="auto")
    np.testing.assert_allclose(table.reflectance[1], single.reflectance, rtol=1e-6)


@NEEDS_JIT
def test_tables_of_other_grains_equal_single_spectra():
    def make(depth_m):
        return splits.Snow(depth_m=depth_m, saturation=0.0, interpretation="radiative_transfer")

    settings = {"max_stderr": 0.02, "solver": "discrete_ordinates"}
    table = splits.build_table(make, {"depth_m": [0.02, 0.05]}, [1300.0], threads=2, **settings)
    single = splits.spectrophotometer(make(0.05), [1300.0], **settings)
    assert table.attrs["solver"] == single.attrs["solver"] == "discrete_ordinates"
    np.testing.assert_allclose(table.reflectance[1], single.reflectance, rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (
            {"make": splits.Snow, "grid": {"depth_m": [0.1, 0.2]}},
            "no equation of radiative transfer",
        ),
        ({"covariance": True}, "a covariance needs batches of rays"),
    ],
)
def test_refusals_give_the_reason(settings, reason):
    arguments = {"make": splits.Snow.natural, "grid": {"optical_radius_um": [100.0, 200.0]}}
    with pytest.raises(ValueError, match=reason):
        splits.build_table(
            **{**arguments, **settings}, wavelength_nm=WAVELENGTHS, solver="discrete_ordinates"
        )
