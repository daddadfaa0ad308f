"""Retrieval by discrete ordinates from a medium, without a table."""

from itertools import product

import numpy as np
import pytest
from chi2 import judge_z
from scipy.interpolate import RegularGridInterpolator

import splits
from splits.core.validation import InvalidValue
from splits.instruments.solver import MONTE_CARLO
from splits.retrieval.forward_model import LinearModel
from splits.retrieval.measurement import Measurement
from splits.retrieval.medium_model import (
    LAST_STAGE,
    MediumModel,
    make_medium_state_vector,
)

ORDINATES = "discrete_ordinates"
W = np.arange(400.0, 2001.0, 50.0)
SIZE, SOOT, WATER = "optical_radius_um", "impurities_ng_g.black_carbon", "liquid_water_content"


def make_snow(size=200.0, soot=0.0, **settings):
    """Return natural snow."""
    return splits.Snow.natural(
        optical_radius_um=size, impurities_ng_g={"black_carbon": soot}, **settings
    )


def solve(medium, incidence=50.0, w=W):
    """Return the reflectance of a medium."""
    return splits.spectrophotometer(medium, w, incidence, solver=ORDINATES).reflectance.values


def make_model(medium, ranges, incidence=50.0, solver=ORDINATES, measured=None, w=W):
    """Return the model of a retrieval."""
    measured = np.full(w.size, 0.5) if measured is None else measured
    return MediumModel(
        medium, Measurement.from_input((w, measured), 0.01),
        make_medium_state_vector(medium, ranges, None, incidence), incidence, solver, None, 1, None,
    )  # fmt: skip


CASES = {
    "dry": (make_snow(300.0, 80.0), {SIZE: (50, 1500), SOOT: (0, 500)}, {}),
    "wet": (
        make_snow(300.0, liquid_water_content=0.05), {SIZE: (50, 1500), WATER: (0, 0.15)}, {},
    ),
    "diffuse": (make_snow(300.0), {SIZE: (50, 1500)}, {"fixed": {"incidence_deg": "diffuse"}}),
    "angle": (make_snow(300.0), {SIZE: (50, 1500), "incidence_deg": (10, 80)}, {"fixed": {}}),
    "scale": (make_snow(300.0), {SIZE: (50, 1500), "scale": (0.8, 1.2)}, {}),
    "unknown noise": (make_snow(300.0), {SIZE: (50, 1500)}, {"noise": None}),
    "prior": (make_snow(300.0), {SIZE: (50, 1500)}, {"prior": {SIZE: (310.0, 20.0)}}),
    "stack": (
        splits.Stack([make_snow(80.0, depth_m=0.02), make_snow(500.0)]),
        {"layers.0.depth_m": (0.005, 0.1), "layers.1.optical_radius_um": (50, 1500)}, {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_true_values_are_retrieved(name):
    """From a spectrum without noise, the most probable values are the true ones."""
    medium, ranges, arguments = CASES[name]
    arguments = {"noise": 0.003, "fixed": {"incidence_deg": 50.0}, **arguments}
    incidence = arguments["fixed"].get("incidence_deg", 50.0)
    measured = solve(medium, incidence)
    if arguments["noise"] is None:
        measured = measured + 0.003 * np.random.default_rng(1).standard_normal(W.size)
    start = splits.media.parameters.replace_parameter(medium, *next(
        (key, 0.7 * pair[0] + 0.3 * pair[1]) for key, pair in ranges.items()
    ))  # fmt: skip
    result = splits.retrieve((W, measured), start, ranges, solver=ORDINATES, **arguments)
    for key in ranges:
        truth = {"scale": 1.0, "incidence_deg": 50.0}.get(key)
        truth = splits.media.parameters.get_parameter(medium, key) if truth is None else truth
        value = float(result.dataset.value.sel(parameter=key))
        allowed = 2.5 if arguments["noise"] is None else 0.6 if name == "prior" else 0.1
        assert abs(value - truth) < allowed * result.stderr[key], key


@pytest.mark.parametrize("noise", [0.01, None])
@pytest.mark.parametrize("size", [300.0, 800.0])
def test_exact_spectra_are_retrieved(size, noise):
    """A residual of 0 ends the descent."""
    w = np.arange(400.0, 1400.0, 50.0)
    measured = w, solve(make_snow(size), 0.0, w)
    result = splits.retrieve(measured, make_snow(100.0), {SIZE: (50, 1500)}, noise)
    assert result.values[SIZE] == pytest.approx(size, rel=2e-3)
    assert result.dataset.attrs["rmse"] < 1e-6


@pytest.mark.long
def test_draws_cover_two_optima():
    """The probability of high angles, where angle and size compensate, from the exact model.

    A low angle and the highest one explain these spectra almost equally.  The exact model is
    interpolated from a grid, with a small error of the probability.
    """
    w, random = np.arange(400.0, 1401.0, 100.0), np.random.default_rng(11)
    snow, ranges = make_snow(100.0), {SIZE: (50, 1500), SOOT: (0, 500), "incidence_deg": (0, 80)}
    truth = solve(make_snow(300.0, 100.0), 40.0, w)
    model = make_model(snow, ranges, 0.0, measured=truth, w=w)
    axes = [np.linspace(*ends) for ends in ((0.3, 0.999, 13), (0.2, 0.75, 9), (0.001, 0.999, 13))]
    exact = [model.evaluate_state(np.array(state), LAST_STAGE) for state in product(*axes)]
    interpolate = RegularGridInterpolator(
        axes, np.reshape(exact, (*map(len, axes), w.size)), method="cubic"
    )
    states = np.stack(np.meshgrid(*(np.linspace(a[0], a[-1], 70) for a in axes)), -1).reshape(-1, 3)
    modelled = interpolate(states)
    is_high = model.state_vector.to_physical(states)[:, 2] > 60.0
    z = []
    for seed in range(1, 7):
        measured = truth + 0.01 * random.standard_normal(w.size)
        result = splits.retrieve((w, measured), snow, ranges, 0.01, seed=seed)
        misfit = 1e4 * ((modelled - measured) ** 2).sum(axis=1)
        weights = np.exp(-0.5 * (misfit - misfit.min()))
        expected = weights[is_high].sum() / weights.sum()
        found = (result.dataset.draws.sel(parameter="incidence_deg").values > 60.0).mean()
        n_draws = result.dataset.attrs["effective_sample_size"]
        z.append((found - expected) / np.hypot(np.sqrt(expected * (1 - expected) / n_draws), 0.01))
        assert not any("do not cover" in line for line in result.warnings)
    judge_z(z, bound_added=True)


@pytest.mark.parametrize("name", ["dry", "wet"])
def test_jacobian_is_that_of_the_spectrum(name):
    medium, ranges, _ = CASES[name]
    model = make_model(medium, ranges)
    state = np.array([0.3, 0.6])
    inputs = model.make_inputs(state)[0]
    spectrum = splits.spectrophotometer(inputs, W, 50.0, jacobian=list(ranges), solver=ORDINATES)
    step = 1e-6 * np.eye(2)
    high, low = (model.state_vector.to_physical(state + sign * step) for sign in (1, -1))
    expected = spectrum.reflectance_jacobian.values.T * np.diag(high - low) / 2e-6
    np.testing.assert_allclose(model.jacobian(state), expected, rtol=2e-3, atol=2e-5)


def test_first_stages_use_few_wavelengths():
    model = make_model(make_snow(), {SIZE: (50, 1500)})
    state, positions = np.array([0.4]), model.select_values(1)
    assert positions.size == 16
    np.testing.assert_allclose(
        model.evaluate_state(state, 1),
        model.evaluate_state(state, LAST_STAGE)[positions],
        rtol=1e-12,
    )


def test_corners_of_each_layer_are_examined():
    medium, _, _ = CASES["stack"]
    wet, dense = "layers.1.saturation", "layers.1.density_kg_m3"
    ranges = {"layers.0.depth_m": (0.01, 0.1), wet: (0, 0.4), dense: (100, 400), "scale": (1, 2)}
    media = make_model(medium, ranges).list_extreme_media()
    assert len(media) == 1 + 2 + 4
    assert len({medium.layers[1].saturation for medium in media}) == 3


def test_bands_are_measured():
    bands = {"a": (500.0, 560.0), "b": (840.0, 900.0), "c": (1200.0, 1290.0)}
    values = [
        solve(make_snow(300.0), w=np.linspace(*limits, 31)).mean() for limits in bands.values()
    ]
    result = splits.retrieve(
        values, make_snow(), {SIZE: (50, 1500)}, 0.005, bands=bands, solver=ORDINATES,
        fixed={"incidence_deg": 50.0},
    )  # fmt: skip
    assert abs(result.values[SIZE] - 300.0) < result.stderr[SIZE]


def test_nonlinear_posterior_is_exact():
    """The posterior of a depth that reflectance hardly constrains, from the exact model."""
    random = np.random.default_rng(3)
    measured = solve(make_snow(depth_m=0.15, ground=0.2)) + 0.01 * random.standard_normal(W.size)
    medium, ranges = make_snow(depth_m=0.1, ground=0.2), {"depth_m": (0.02, 2.0)}
    result = splits.retrieve(
        (W, measured), medium, ranges, 0.01, fixed={"incidence_deg": 50.0}, solver=ORDINATES
    )
    model = make_model(medium, ranges, measured=measured)
    states = np.linspace(0.002, 0.998, 250)
    residual = model.evaluate(states[:, np.newaxis]) - measured
    covariance = 1e-4 * np.eye(W.size) + model.error_covariance(states[100:101])
    misfit = (np.linalg.solve(np.linalg.cholesky(covariance), residual.T) ** 2).sum(0)
    cumulative = np.cumsum(np.exp(-0.5 * (misfit - misfit.min())))
    low, high = ranges["depth_m"]
    quantiles = np.log(result.dataset.quantiles.values[:, 0] / low) / np.log(high / low)
    found = np.interp(quantiles, states, cumulative / cumulative[-1])
    expected = result.dataset["quantile"].values
    stderr = np.sqrt(expected * (1.0 - expected) / result.dataset.attrs["effective_sample_size"])
    judge_z((found - expected) / np.hypot(stderr, 1.0 / states.size), bound_added=True)
    assert not any("approximate" in one for one in result.warnings)


def test_quadratic_models_are_interpolated_exactly():
    state_vector = make_medium_state_vector(
        make_snow(), {SIZE: (50, 200), SOOT: (0, 100)}, None, 0.0
    )
    slopes, curvature = np.arange(6.0).reshape(3, 2), np.array([1.0, -2.0, 0.5])

    def evaluate(states):
        return states @ slopes.T + (states[:, :1] * states[:, 1:]) * curvature

    start = np.array([[0.3, 0.6]])
    linear = LinearModel(state_vector, start[0], evaluate(start)[0], slopes, np.eye(3))
    random = np.random.default_rng(1)
    states = random.random((12, 2))
    model = linear.with_deviation(states, evaluate(states))
    new = random.random((5, 2))
    np.testing.assert_allclose(model.evaluate(new), evaluate(new), atol=1e-9)
    expected = slopes + np.outer(curvature, new[0, ::-1])
    np.testing.assert_allclose(model.jacobian(new[0]), expected, atol=1e-5)


OBSTACLES = {
    "no natural snow": (splits.Snow(), {"density_kg_m3": (100, 400)}, "overlap_with_boundary"),
    "sand": (splits.Sand(), {"saturation": (0, 1)}, "overlap_with_boundary"),
    "shape": (make_snow(), {"facetness": (0.2, 0.6)}, "facetness changes the shape"),
    "water": (make_snow(density_kg_m3=300), {"saturation": (0.0, 0.8)}, "saturation of 0.7"),
    "absorption": (make_snow(), {SIZE: (50, 18_000)}, "absorbs too strongly"),
}


@pytest.mark.parametrize("name", OBSTACLES)
def test_other_media_are_simulated(name):
    medium, ranges, message = OBSTACLES[name]
    w = np.arange(400.0, 2401.0, 200.0)
    with pytest.raises(InvalidValue, match=message):
        make_model(medium, ranges, w=w)
    for solver in ("auto", MONTE_CARLO):
        model = make_model(medium, ranges, solver=solver, w=w)
        assert model.solver == MONTE_CARLO
    assert make_model(make_snow(), {WATER: (0, 0.1)}, w=w).solver == ORDINATES


def test_invalid_solvers_are_rejected():
    measured, ranges = (W, np.full(W.size, 0.5)), {SIZE: (50, 200)}
    with pytest.raises(InvalidValue, match="solver"):
        splits.retrieve(measured, make_snow(), ranges, 0.01, solver="ordinates")
    with pytest.raises(InvalidValue, match="max_stderr"):
        splits.retrieve(measured, make_snow(), ranges, 0.01, max_stderr=2.0)
