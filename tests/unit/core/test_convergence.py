"""Warnings about requested errors that are not reached, by every public function with one."""

from __future__ import annotations

import inspect
import warnings

import pytest
import xarray as xr

import splits
from splits.core.convergence import (
    ERROR_NAMES,
    REMEDIES,
    describe_missed_error,
    nest_runs,
)
from splits.simulation.strata import STOP_REASONS

NATURAL = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1)
LAYER = splits.ParticleLayer(1.0, 0.9, 0.0)
SKY, W = "midlatitude_winter", [600, 700]
ORDINATES = {"solver": "discrete_ordinates", "threads": 1}
ONE_ROUND = {"solver": "monte_carlo", "max_rays": 1, "threads": 1}


def make_packs():
    columns = {"thickness_m": 0.1, "density_kg_m3": 300.0, "specific_surface_area_m2_kg": 20.0}
    variables = {name: (("time", "layer"), [[value]]) for name, value in columns.items()}
    return splits.SnowPacks(xr.Dataset(variables, {"time": ["pit"]}))


def make_layer(optical_thickness):
    return splits.ParticleLayer(optical_thickness, 0.9, 0.0)


THICKNESS, GRAINS = {"optical_thickness": [1.0, 2.0]}, {"optical_radius_um": [100, 200]}
VIEWS = {"polar_deg": [0, 30], "azimuth_deg": [0, 180]}
CALLS = {
    ("albedo", "solver_error"): ((NATURAL, SKY, W), {"max_stderr": 1e-6, **ORDINATES}),
    ("build_table", "solver_error"): (
        (splits.Snow.natural, GRAINS, W), {"max_stderr": 1e-6, **ORDINATES},
    ),
    ("build_table directions", "solver_error"): (
        (splits.Snow.natural, GRAINS | VIEWS, W), {"max_stderr": 1e-6, **ORDINATES},
    ),
    ("build_table", "max_rays"): ((make_layer, THICKNESS, W), {"max_stderr": 1e-4, **ONE_ROUND}),
    ("goniophotometer", "solver_error"): (
        (NATURAL, W, 60), {"relative_stderr": 1e-4, **ORDINATES},
    ),
    ("goniophotometer", "max_rays"): ((LAYER, W, 60), {"relative_stderr": 1e-3, **ONE_ROUND}),
    ("hdrf", "solver_error"): ((NATURAL, SKY, W), {"relative_stderr": 1e-4, **ORDINATES}),
    ("irradiance_profile", "solver_error"): (
        (NATURAL, W, [0.02]), {"max_stderr": 1e-6, **ORDINATES},
    ),
    ("irradiance_profile", "max_rays"): ((LAYER, W, [0.5]), {"max_stderr": 1e-3, **ONE_ROUND}),
    ("radiation_profile", "solver_error"): (
        (NATURAL, SKY, [0.02], W), {"max_stderr": 1e-6, "total_w_m2": 400, **ORDINATES},
    ),
    ("spectrophotometer", "solver_error"): ((NATURAL, W), {"max_stderr": 1e-6, **ORDINATES}),
    ("spectrophotometer", "max_rays"): ((LAYER, W), {"max_stderr": 1e-4, **ONE_ROUND}),
    ("spectrophotometer several", "max_rays"): (
        ({"a": LAYER, "b": LAYER},  W), {"max_stderr": 1e-4, **ONE_ROUND},
    ),
}  # fmt: skip
NOT_DATASETS = {"retrieve"}
"""Functions whose error limits only that of the spectra from which they find a state."""


@pytest.mark.parametrize(("name", "reason"), CALLS)
def test_a_missed_error_gives_one_warning(name, reason):
    function = getattr(splits, name.split()[0])
    values, keywords = CALLS[name, reason]
    (key,) = ERROR_NAMES.keys() & keywords.keys()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = function(*values, **keywords)
    assert result.attrs["stop_reason"] == reason
    # Tables also warn of intervals that are too wide, which is another error.
    (warning,) = (one for one in caught if "interpolation" not in str(one.message))
    message = str(warning.message)
    assert message.startswith(f"{function.__name__}: the largest ")
    assert f"is {result.attrs[f'{key}_reached']:.3g}, " in message
    assert f"{key} = {keywords[key]:g}; " in message
    assert f"set a larger {key}" in message or f"or a larger {key}" in message
    assert warning.category is UserWarning
    # The warning shows the line of the user's call.
    assert warning.filename == __file__
    # The larger error that was reached gives none.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        function(*values, **keywords | {key: 0.5})


def test_every_function_with_a_requested_error_is_tested():
    functions = {name: getattr(splits, name) for name in splits.__all__}
    requesting = {
        name
        for name, one in functions.items()
        if inspect.isfunction(one)
        and not ERROR_NAMES.keys().isdisjoint(inspect.signature(one).parameters)
    }
    assert requesting - NOT_DATASETS == {name.split()[0] for name, _ in CALLS}


def test_snowpacks_of_a_season_warn_too():
    with pytest.warns(UserWarning, match=r"spectrophotometer: the largest .* max_stderr = 1e-06; "):
        splits.spectrophotometer(make_packs(), W, max_stderr=1e-6)


def test_every_reason_but_the_requested_ends_has_a_remedy():
    assert REMEDIES.keys() == set(STOP_REASONS) - {"converged", "fixed_rays"}


@pytest.mark.parametrize("reason", STOP_REASONS)
@pytest.mark.parametrize("key", ERROR_NAMES)
def test_the_message_of_a_reason_names_both_numbers_and_what_to_do(key, reason):
    reached = {f"{key}_reached": 0.0345, "rays": 1000, "stop_reason": reason}
    message = describe_missed_error({key: 0.01, **reached})
    if reason in REMEDIES:
        assert "0.0345" in message and f"{key} = 0.01" in message and ": set " in message
        assert "{" not in message
    else:
        assert message == ""
    # Without a requested error, nothing is missed.
    assert describe_missed_error(reached) == ""


def test_runs_within_another_do_not_warn():
    with nest_runs() as is_outermost, warnings.catch_warnings():
        warnings.simplefilter("error")
        assert is_outermost
        splits.spectrophotometer(LAYER, W, max_stderr=1e-4, **ONE_ROUND)
        with nest_runs() as is_outermost:
            assert not is_outermost
    with nest_runs() as is_outermost:
        assert is_outermost
