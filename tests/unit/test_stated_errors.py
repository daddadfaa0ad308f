"""Datasets of instruments and theories declare their standard errors."""

import pytest
from chi2 import NEEDS_JIT
from stated_errors import list_variables_with_errors

import splits
from splits.analysis.theory.spectra import correct_dense_packing, solve_discrete_ordinates
from splits.core.discovery import list_instrument_names

LAYER = splits.ParticleLayer(optical_thickness=1.0, ground=None, polarized=True)
SURFACE = {"rms_height_m": 1.0, "wave_number_per_m": 0.1, "waves": 8, "correlation": "gaussian"}
WAVES = splits.ParticleLayer(depth_m=100.0, surface=SURFACE)
TOTALS = {"reflectance", "transmittance"}
ANGLES = {"brdf", "btdf", "reflectance_factor", "anisotropy_factor", *TOTALS}
ANGLES |= {"specular_reflectance", "direct_transmittance"}
STOKES = {
    f"{name}_{parameter}"
    for name in ("brdf", "btdf")
    for parameter in ("q", "u", "v", "dolp", "aolp")
}
FEW_DIRECTIONS = {"polar_deg": [0.0, 40.0], "azimuth_deg": [0.0, 180.0]}
GRAINS = {"single_scattering_albedo", "asymmetry_parameter", "legendre_moment", "wet_fraction"}
GRAINS |= {"displacement_along_incident", "displacement_along_exit", "mean_square_displacement"}
BUDGET = {*TOTALS, "absorptance"}
CASES = {
    "spectrophotometer": (splits.Snow(), ([600.0],), {"max_stderr": 0.1}, BUDGET),
    "spectrophotometer, derivatives": (
        splits.Snow(), ([600.0],),
        {"max_stderr": 0.1, "jacobian": ["impurities_ng_g.black_carbon"]},
        BUDGET | {"reflectance_jacobian", "transmittance_jacobian"},
    ),
    "spectrophotometer, several": (
        {"a": splits.Snow()}, ([600.0],), {"max_stderr": 0.1}, BUDGET,
    ),
    "goniophotometer": (splits.Snow(), ([600.0],), {"rays": 1, **FEW_DIRECTIONS}, ANGLES),
    "goniophotometer, diffuse": (
        splits.Snow(), ([600.0], "diffuse"), {"rays": 1, **FEW_DIRECTIONS},
        {"reflectance_factor", "transmittance_factor", "anisotropy_factor", *TOTALS},
    ),
    "goniophotometer, bins": (
        LAYER, ([600.0],), {"rays": 1000, "estimator": "bins", "n_bins": (2, 4)}, ANGLES | STOKES,
    ),
    "goniophotometer, next event": (
        LAYER, ([600.0], 30.0), {"rays": 1000, "estimator": "next_event", **FEW_DIRECTIONS},
        ANGLES | STOKES,
    ),
    "beam_spread": (
        splits.Snow(), ([900.0],), {"rays": 1},
        {"profile", "profile_map", "mean_radius", "quantile_radius", "fraction"},
    ),
    "time_of_flight": (
        splits.Snow(), ([900.0],), {"rays": 1, "depth_m": [0.01]},
        {"return_rate", "path_length", "late_fraction"} | {
            f"{name}{suffix}" for suffix in ("", "_by_depth")
            for name in ("fraction", "mean_delay", "delay_spread", "delay_skewness")
        },
    ),
    "irradiance_profile": (
        splits.Snow(depth_m=0.01), ([600.0],), {"depth_m": [0.005], "max_stderr": 0.1},
        {"downward_irradiance", "upward_irradiance", "absorptance", "actinic_flux",
         "absorptance_of_material"},
    ),
    "single_scattering": (splits.Snow(), ([600.0],), {"moments": 2, "rays": 2}, GRAINS),
    "lens": (
        WAVES, (),
        {"screen_depth_m": [5.0], "radius_m": 0.5, "centre_on": "origin", "realizations": 3},
        {"contraction", "concentration"},
    ),
    "surface_map": (WAVES, (), {"half_width_m": 10.0, "points": 2, "realizations": 2}, set()),
}  # fmt: skip


@NEEDS_JIT
@pytest.mark.parametrize("case", CASES)
def test_instruments_declare_their_errors(case):
    medium, arguments, settings, expected = CASES[case]
    dataset = getattr(splits, case.split(",")[0])(medium, *arguments, **settings)
    assert list_variables_with_errors(dataset) == expected


def test_all_instruments_are_covered():
    sky_functions = {"albedo", "hdrf", "radiation_profile"}
    assert {case.split(",")[0] for case in CASES} == {*list_instrument_names()} - sky_functions


@NEEDS_JIT
def test_theories_declare_their_errors():
    optics = correct_dense_packing(
        splits.single_scattering(splits.Snow(), [600.0], moments=4, rays=2)
    )
    assert list_variables_with_errors(optics) == GRAINS | {"extinction", "optical_thickness"}
    assert list_variables_with_errors(solve_discrete_ordinates(optics, streams=4)) == BUDGET
