"""Errors of sums over a spectrum, and warnings about requested errors that are not reached."""

import inspect
import warnings

import numpy as np
import pytest
import xarray as xr

import splits
from splits.analysis.colour import (
    compute_cielab_gradient,
    compute_tristimulus,
    make_colour_table,
    to_cielab,
)
from splits.core.keywords import ERROR_NAMES, REMEDIES, describe_missed_error, nest_runs
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.kernels.records import N_BATCHES
from splits.simulation.spectral_tally import rescale_deviations
from splits.simulation.strata import STOP_REASONS
from workflow.papers.statements import compute_steps

WAVELENGTHS = np.arange(400.0, 781.0, 10.0)
RED = WAVELENGTHS >= 600.0
ERROR = 0.01


def make_dataset(batches=None, bound=0.0, **dimensions):
    """Return a grey spectrum with an error of 0.01, from given batches and a bound."""
    shape = (*(len(v) for v in dimensions.values()), len(WAVELENGTHS))
    dims = (*dimensions, "wavelength")
    variables = {
        "reflectance": (dims, np.full(shape, 0.3)),
        "reflectance_stderr": (dims, np.full(shape, np.hypot(ERROR, bound))),
    }
    if batches is not None:
        values = np.broadcast_to(batches, (*shape[:-1], *batches.shape)).astype(np.float32)
        variables["reflectance_batches"] = ((*dimensions, "batch", "wavelength"), values)
    return xr.Dataset(variables, {**dimensions, "wavelength": WAVELENGTHS})


def make_two_node_batches():
    """Return batches of two independent ensembles: one below 600 nm, one above."""
    batches = np.zeros((N_BATCHES, len(WAVELENGTHS)))
    batches[0, ~RED] = ERROR
    batches[1, RED] = ERROR
    return batches


def test_errors_are_correlated_within_a_node_only():
    ds = make_dataset(make_two_node_batches())
    assert float(ds.errors.mean("reflectance", 400, 590)[1]) == pytest.approx(ERROR)
    assert float(ds.errors.mean("reflectance", 600, 780)[1]) == pytest.approx(ERROR)
    difference = ds.errors.make_band_weights(600, 780) - ds.errors.make_band_weights(400, 590)
    error = float(ds.errors.weighted_sum("reflectance", difference)[1])
    assert error == pytest.approx(np.sqrt(2.0) * ERROR)
    fraction = RED.mean()
    mean = float(ds.errors.mean("reflectance", 400, 780)[1])
    assert mean == pytest.approx(ERROR * np.hypot(fraction, 1.0 - fraction))


def test_interpolation_errors_are_correlated_for_equal_signs():
    ds = make_dataset(make_two_node_batches(), bound=0.004)
    weights = ds.errors.make_band_weights(600, 780) - ds.errors.make_band_weights(400, 590)
    scatter, bound = ds.errors.split("reflectance", weights)
    assert float(scatter) == pytest.approx(np.sqrt(2.0) * ERROR)
    assert float(bound) == pytest.approx(np.sqrt(2.0) * 0.004, rel=1e-4)
    separate = ds.errors.make_band_weights(400, 500) + ds.errors.make_band_weights(700, 780)
    assert float(ds.errors.split("reflectance", separate)[1]) == pytest.approx(0.008, rel=1e-4)
    error = float(ds.errors.weighted_sum("reflectance", weights)[1])
    assert error == pytest.approx(np.hypot(float(scatter), float(bound)))


def test_without_scatter_errors_are_upper_bounds():
    ds = make_dataset()
    weights = ds.errors.make_band_weights(600, 780) - ds.errors.make_band_weights(400, 590)
    scatter, bound = ds.errors.split("reflectance", weights)
    assert float(scatter) == 0.0
    assert float(bound) == pytest.approx(2.0 * ERROR)


@pytest.mark.parametrize("batches", [None, make_two_node_batches()])
def test_missing_values_give_missing_errors(batches):
    ds = make_dataset(batches).astype(float)
    for values in ds.data_vars.values():
        values[..., RED] = np.nan
    for low, high, known in ((400, 590, True), (400, 780, False), (600, 780, False)):
        assert bool(ds.errors.mean("reflectance", low, high)[1].notnull()) == known
        assert bool(ds.errors.mean("reflectance", low, high)[0].notnull()) == known
    if batches is not None:
        ds = make_dataset(batches)
        ds.reflectance_stderr[5] = np.nan
        assert ds.errors.mean("reflectance", 400, 590)[1].isnull()


def test_correlated_errors_cancel_in_a_difference():
    rng = np.random.default_rng(5)
    common, independent = rng.normal(size=(2, N_BATCHES, 1, 2))
    batches = np.concatenate([common, common + 0.1 * independent], axis=1)
    bounds = np.array([[0.3, 0.2], [0.2, 0.2]])
    dims = ("medium", "wavelength")
    dataset = xr.Dataset(
        {
            "reflectance": (dims, [[0.9, 0.8], [0.5, 0.6]]),
            "reflectance_stderr": (dims, np.sqrt((batches**2).sum(axis=0) + bounds**2)),
            "reflectance_batches": (("batch", *dims), batches),
        },
        {"medium": ["clean", "dirty"], "wavelength": [500.0, 600.0]},
    )
    change, stderr = dataset.errors.difference("reflectance", "dirty", "clean")
    np.testing.assert_allclose(change, [-0.4, -0.2])
    scatter = 0.01 * (independent[:, 0] ** 2).sum(axis=0)
    np.testing.assert_allclose(stderr, np.sqrt(scatter + np.array([0.1, 0.0]) ** 2), atol=1e-6)
    reverse, reverse_stderr = dataset.errors.difference("reflectance", "clean", "dirty")
    np.testing.assert_allclose(reverse, -change)
    np.testing.assert_allclose(reverse_stderr, stderr)


def test_a_band_without_wavelengths_is_rejected():
    with pytest.raises(ValueError, match=r"wavelength = .*some in 1200 to 1300 nm"):
        make_dataset(make_two_node_batches()).errors.mean("reflectance", 1200, 1300)


def test_colour_errors_match_sampled_scatter():
    table = make_colour_table(make_dataset(make_two_node_batches(), medium=["a"]))
    random = np.random.default_rng(1)
    deviations = np.where(RED, *random.normal(0.0, ERROR, (2, 4000, 1)))
    basis = np.stack([compute_tristimulus(WAVELENGTHS, unit) for unit in np.eye(len(WAVELENGTHS))])
    scatter = to_cielab((0.3 + deviations) @ basis).std(axis=0)
    stated = table[["L_stderr", "a_stderr", "b_stderr"]].to_numpy()[0]
    # The standard deviation of 4000 samples has a relative standard error of 1.1 %; colours are
    # slightly nonlinear.
    np.testing.assert_allclose(scatter, stated, rtol=0.05)
    assert (table[["L_error_bound", "a_error_bound", "b_error_bound"]].to_numpy() == 0.0).all()


def test_cielab_gradient_equals_finite_differences():
    for xyz in ([0.95, 1.0, 1.09], [0.2, 0.18, 0.1], [0.002, 0.002, 0.001]):
        step = 1e-3 * np.array([0.5, -0.2, 0.9]) * min(xyz)
        difference = to_cielab(np.array(xyz) + step) - to_cielab(np.array(xyz) - step)
        np.testing.assert_allclose(
            compute_cielab_gradient(np.array(xyz)) @ (2.0 * step), difference, rtol=1e-4
        )


def test_steps_of_a_grid_use_the_batches():
    step, error = compute_steps(
        make_dataset(make_two_node_batches(), x=[1.0, 2.0, 3.0]), "reflectance", "x", 400, 780
    )
    assert step.shape == error.shape == (2,)
    fraction = RED.mean()
    np.testing.assert_allclose(error, np.sqrt(2.0) * ERROR * np.hypot(fraction, 1.0 - fraction))


def test_rescaled_batches_have_the_variance_and_correlations():
    random = np.random.default_rng(2)
    raw = random.normal(size=(N_BATCHES, 3, 5))
    raw -= raw.mean(axis=0)
    raw[:, 2, 4] = 0.0
    variance = random.uniform(1e-4, 1e-2, (3, 5))
    batches = rescale_deviations(raw, variance)
    square = (batches**2).sum(axis=0)
    np.testing.assert_allclose(square.ravel()[:-1], variance.ravel()[:-1], rtol=1e-12)
    assert square[2, 4] == 0.0

    def correlation(g):
        return np.corrcoef(g[:, 0, 0], g[:, 1, 1])[0, 1]

    assert correlation(batches) == pytest.approx(correlation(raw), rel=1e-12)


@pytest.mark.parametrize("estimator", ["spectral", "analog"])
def test_batches_do_not_exceed_the_standard_error(estimator):
    ds = splits.spectrophotometer(
        splits.Snow(depth_m=0.002), [500.0, 1000.0], max_stderr=0.1, estimator=estimator, threads=1
    )
    for name in ("reflectance", "transmittance"):
        square = (ds[f"{name}_batches"].astype(float) ** 2).sum("batch")
        assert (square > 0.0).all()
        assert (square <= ds[f"{name}_stderr"] ** 2 * (1.0 + 1e-6)).all()
        largest = float(abs(ds[f"{name}_batches"].sum("batch")).max())
        assert largest < 1e-3 * float(ds[f"{name}_stderr"].max())


def test_batches_are_kept_in_grids_and_files(tmp_path):
    experiment = ExperimentConfig.model_validate(
        {
            "name": "mine",
            "medium": {"kind": "snow"},
            "instrument": {"wavelength_nm": [500, 1000]},
            "grid": {"depth_m": [0.002, 0.003]},
        }
    )
    ds = run(experiment, Accuracy(max_stderr=0.1), threads=1)
    assert ds.reflectance_batches.dims == ("depth_m", "batch", "wavelength")
    splits.save(ds, tmp_path / "mine.nc")
    loaded = splits.load(tmp_path / "mine.nc")
    xr.testing.assert_identical(loaded.reflectance_batches, ds.reflectance_batches)
    assert (loaded.errors.mean("reflectance", 400, 600)[1] > 0.0).all()


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
        (NATURAL, W), {"depth_m": [0.02], "max_stderr": 1e-6, **ORDINATES},
    ),
    ("irradiance_profile", "max_rays"): (
        (LAYER, W), {"depth_m": [0.5], "max_stderr": 1e-3, **ONE_ROUND},
    ),
    ("radiation_profile", "solver_error"): (
        (NATURAL, SKY, W),
        {"depth_m": [0.02], "max_stderr": 1e-6, "total_w_m2": 400, **ORDINATES},
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
