"""Errors of sums over a spectrum: batches of rays give the correlation between wavelengths."""

from __future__ import annotations

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
from splits.core.uncertainty import (
    compute_band_error,
    compute_difference,
    compute_error_parts,
    compute_weighted_error,
    make_band_weights,
)
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.kernels.tallies.exits import N_BATCHES
from splits.simulation.spectral_tally import rescale_deviations
from workflow.papers.statements import compute_band_mean, compute_steps

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
    assert float(compute_band_error(ds, "reflectance", 400, 590)) == pytest.approx(ERROR)
    assert float(compute_band_error(ds, "reflectance", 600, 780)) == pytest.approx(ERROR)
    difference = make_band_weights(ds, 600, 780) - make_band_weights(ds, 400, 590)
    error = float(compute_weighted_error(ds, "reflectance", difference))
    assert error == pytest.approx(np.sqrt(2.0) * ERROR)
    fraction = RED.mean()
    mean = float(compute_band_error(ds, "reflectance", 400, 780))
    assert mean == pytest.approx(ERROR * np.hypot(fraction, 1.0 - fraction))


def test_interpolation_errors_are_correlated_for_equal_signs():
    ds = make_dataset(make_two_node_batches(), bound=0.004)
    weights = make_band_weights(ds, 600, 780) - make_band_weights(ds, 400, 590)
    scatter, bound = compute_error_parts(ds, "reflectance", weights)
    assert float(scatter) == pytest.approx(np.sqrt(2.0) * ERROR)
    assert float(bound) == pytest.approx(np.sqrt(2.0) * 0.004, rel=1e-4)
    separate = make_band_weights(ds, 400, 500) + make_band_weights(ds, 700, 780)
    assert float(compute_error_parts(ds, "reflectance", separate)[1]) == pytest.approx(
        0.008, rel=1e-4
    )
    error = float(compute_weighted_error(ds, "reflectance", weights))
    assert error == pytest.approx(np.hypot(float(scatter), float(bound)))


@pytest.mark.parametrize("batches", [None, 0.0 * make_two_node_batches()])
def test_without_scatter_errors_are_upper_bounds(batches):
    ds = make_dataset(batches)
    weights = make_band_weights(ds, 600, 780) - make_band_weights(ds, 400, 590)
    scatter, bound = compute_error_parts(ds, "reflectance", weights)
    assert float(scatter) == 0.0
    assert float(bound) == pytest.approx(2.0 * ERROR)


@pytest.mark.parametrize("batches", [None, make_two_node_batches()])
def test_missing_values_give_missing_errors(batches):
    ds = make_dataset(batches).astype(float)
    for values in ds.data_vars.values():
        values[..., RED] = np.nan
    for low, high, known in ((400, 590, True), (400, 780, False), (600, 780, False)):
        assert bool(compute_band_error(ds, "reflectance", low, high).notnull()) == known
        assert bool(compute_band_mean(ds, "reflectance", low, high).notnull()) == known
    if batches is not None:
        ds = make_dataset(batches)
        ds.reflectance_stderr[5] = np.nan
        assert compute_band_error(ds, "reflectance", 400, 590).isnull()


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
    change, stderr = compute_difference(dataset, "reflectance", "dirty", "clean")
    np.testing.assert_allclose(change, [-0.4, -0.2])
    scatter = 0.01 * (independent[:, 0] ** 2).sum(axis=0)
    np.testing.assert_allclose(stderr, np.sqrt(scatter + np.array([0.1, 0.0]) ** 2), atol=1e-6)
    reverse, reverse_stderr = compute_difference(dataset, "reflectance", "clean", "dirty")
    np.testing.assert_allclose(reverse, -change)
    np.testing.assert_allclose(reverse_stderr, stderr)


def test_a_band_without_wavelengths_is_rejected():
    for function in (compute_band_mean, compute_band_error):
        with pytest.raises(ValueError, match=r"wavelength = .*some in 1200 to 1300 nm"):
            function(make_dataset(make_two_node_batches()), "reflectance", 1200, 1300)


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
    assert (compute_band_error(loaded, "reflectance", 400, 600) > 0.0).all()
