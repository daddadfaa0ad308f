"""Errors of fits: stated errors against deviations of fits of synthetic spectra."""

from __future__ import annotations

import numpy as np
import pytest

from splits.retrieval.least_squares import apply_priors
from splits.retrieval.residual_covariance import (
    NEIGHBOUR_CORRELATIONS,
    estimate_fit_covariance,
    estimate_misfit_variances,
)
from splits.retrieval.sand_fit import estimate_parameter_errors
from splits.retrieval.sand_parameters import UnitCube
from splits.retrieval.state_vector import ParameterRange, StateVector

UNIFORM = np.sqrt(1.0 / 12.0)
SILENT_MODEL = np.zeros((25, 25))


def draw_states(best, covariance):
    """Return draws around a best place of the unit cube."""
    names = [f"x{i}" for i in range(len(best))]
    free = StateVector.from_ranges(
        names, None, dict.fromkeys(names, ParameterRange(0.0, 1.0, "itself"))
    )
    return apply_priors(free, best, covariance, 1).draws.states


def compute_covariance(jacobians, misfit, own):
    """Return the covariance of coordinates."""
    held = np.zeros(jacobians[0].shape[1], dtype=bool)
    return estimate_fit_covariance(jacobians, misfit, own, held).state


def make_jacobian(count, coordinates):
    """Return smooth derivatives of a spectrum."""
    x = np.linspace(0.0, 1.0, count)[:, np.newaxis]
    return np.cos(np.pi * x * np.arange(coordinates))


def draw_autoregressive_series(rng, count, alike, number):
    """Return autoregressive series of unit variance."""
    found = rng.normal(size=(number, count))
    for i in range(1, count):
        found[:, i] = alike * found[:, i - 1] + np.sqrt(1.0 - alike**2) * found[:, i]
    return found


@pytest.mark.parametrize(
    ("count", "coordinates", "alike"),
    [(25, 3, 0.5), (25, 3, 0.75), (25, 7, 0.75), (61, 3, 0.0), (61, 7, 0.5), (61, 7, 0.75),
     (61, 3, 0.9), (601, 7, 0.75), (601, 7, 0.95)],
)  # fmt: skip
def test_fits_to_smooth_misfits_are_off_by_their_errors(count, coordinates, alike):
    jacobian = make_jacobian(count, coordinates)
    off, stated = [], []
    for e in 0.1 * draw_autoregressive_series(np.random.default_rng(4), count, alike, 100):
        off.append(np.linalg.lstsq(jacobian, e)[0])
        misfit = jacobian @ off[-1] - e
        covariance = compute_covariance([jacobian] * 2, misfit, np.zeros((count, count)))
        stated.append(np.sqrt(np.diag(covariance)))
    z = np.sqrt(np.mean((np.array(off) / np.array(stated)) ** 2))
    # 100 fits know an rms to 7 % if their errors are one: three of these; and how alike neighbours
    # are is known badly from a short spectrum, so that errors are rather too large.
    assert 0.6 < z < 1.0 + 3.0 * 0.07


def test_variances_of_a_long_series_are_those_of_its_correlation():
    for alike in (0.0, 0.75):
        misfit = draw_autoregressive_series(np.random.default_rng(5), 4000, alike, 1)[0]
        variances = estimate_misfit_variances(misfit, make_jacobian(4000, 3))
        assert variances.sum() == pytest.approx(1.0, rel=0.15)
        # A correlation is known to √((1 − r²)/4000): four of these.
        near = np.abs(NEIGHBOUR_CORRELATIONS - alike) < 0.065
        assert variances[near].sum() > 0.99 * variances.sum()
    alternating = np.where(np.arange(20) % 2, 1.0, -1.0)
    # As if it were independent, at most.
    assert 0.0 < estimate_misfit_variances(alternating, np.zeros((20, 0))).sum() < 1.2


def test_noise_counts_by_batch_of_rays():
    jacobian, misfit = (
        make_jacobian(12, 3),
        1e-3 * draw_autoregressive_series(np.random.default_rng(6), 12, 0.0, 1)[0],
    )
    plain, one, two = (
        compute_covariance([jacobian, jacobian], misfit, noise.T @ noise)
        for noise in (np.zeros((1, 12)), np.ones((1, 12)), np.repeat(np.eye(2), 6, axis=1))
    )
    halves = [
        compute_covariance([jacobian, jacobian], misfit, np.outer(half, half)) - plain
        for half in np.repeat(np.eye(2), 6, axis=1)
    ]
    # Halves of the spectrum that err by themselves add their variances; one error does not.
    np.testing.assert_allclose(two - plain, halves[0] + halves[1], atol=1e-5)
    inverse = np.linalg.pinv(jacobian) @ np.ones(12)
    np.testing.assert_allclose(one - plain, np.outer(inverse, inverse), atol=1e-5)


def test_noise_of_derivatives_passes_neither_for_knowledge_nor_for_error():
    rng = np.random.default_rng(3)
    exact = np.outer(np.ones(61), [0.3, 0.0])
    misfit = 0.01 * draw_autoregressive_series(rng, 61, 0.0, 1)[0]
    noise = np.outer(rng.normal(0.0, 0.005 / np.sqrt(32), 32), np.ones(61))
    best = np.full(2, 0.5)
    own = noise.T @ noise
    known = draw_states(best, compute_covariance([exact] * 2, misfit, own))[:, 0].std()
    found = []
    for _ in range(20):
        off = 0.05 * rng.normal(size=(4, 1, 2)) * np.linspace(0.5, 1.0, 61)[:, np.newaxis]
        found.append(draw_states(best, compute_covariance(exact + off, misfit, own)).std(axis=0))
    sd = np.array(found)
    np.testing.assert_allclose(sd[:, 1], UNIFORM, rtol=0.04)
    # What the other may do after all, as far as four Jacobians know, adds to that.
    assert np.median(sd[:, 0]) == pytest.approx(known, rel=0.25)


@pytest.mark.parametrize("edge", [0.0, 0.5, 1.0])
def test_unconstrained_coordinates_are_as_wide_as_the_cube(edge):
    best = np.array([edge, 0.3])
    misfit = 0.01 * draw_autoregressive_series(np.random.default_rng(7), 25, 0.0, 1)[0]
    covariance = compute_covariance([np.outer(np.ones(25), [0.0, 1.0])] * 2, misfit, SILENT_MODEL)
    off = draw_states(best, covariance)[:, 0] - edge
    # 400 draws know an rms to some 4 %: three of these.
    assert np.sqrt(np.mean(off**2)) == pytest.approx(np.hypot(UNIFORM, edge - 0.5), rel=0.12)


@pytest.mark.parametrize("best", [[0.5, 0.4, 0.3], [0.0, 0.4, 1.0], [0.0, 0.0, 0.0]])
def test_draws_are_those_of_a_normal_distribution_cut_off_by_the_cube(best):
    rng = np.random.default_rng(8)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    covariance = (axes * np.array([0.03, 0.2, 1.5]) ** 2) @ axes.T
    drawn = rng.multivariate_normal(best, covariance, 2_000_000)
    drawn = drawn[((drawn >= 0.0) & (drawn <= 1.0)).all(axis=1)]
    assert len(drawn) > 2000
    found = draw_states(np.array(best), covariance)
    error = np.sqrt(drawn.var(axis=0) * (1.0 / len(drawn) + 1.0 / len(found)))
    assert (np.abs(found.mean(axis=0) - drawn.mean(axis=0)) < 3.3 * error).all()
    np.testing.assert_allclose(found.std(axis=0), drawn.std(axis=0), rtol=0.08)


@pytest.mark.parametrize("sd", [0.1, 0.3, 1.0])
def test_fits_that_end_at_a_bound_state_their_error(sd):
    rng = np.random.default_rng(9)
    truth = rng.random(20_000)
    found = np.clip(rng.normal(truth, sd), 0.0, 1.0)
    grid = np.linspace(0.0, 0.5, 6)
    squares = [np.mean((draw_states(g[np.newaxis], np.eye(1) * sd**2) - g) ** 2) for g in grid]
    stated = np.interp(np.minimum(found, 1.0 - found), grid, squares)
    face = (found == 0.0) | (found == 1.0)
    for ends in (face, ~face):
        ratio = np.sqrt(stated[ends].mean() / ((found - truth)[ends] ** 2).mean())
        # A normal distribution that is cut off is not quite theirs: at a face it is the wider.
        assert 0.93 < ratio < 1.3


def test_constrained_parameters_are_distinguished_from_others():
    cube = UnitCube({})
    sd = np.where(np.array(cube.names) == "iron_oxide", 0.02, 10.0)
    best = np.full(7, 0.5)
    found = estimate_parameter_errors(cube, best, draw_states(best, np.diag(sd**2)))
    assert [name for name, p in found.items() if p.constrained] == ["iron_oxide"]
    # A coordinate's 0.02 times ln 100, the logarithm of the range.
    assert found["iron_oxide"].stderr == pytest.approx(0.005 * 0.02 * np.log(100.0), rel=0.1)
    assert found["hematite_ratio"].value == 0.5


@pytest.mark.parametrize(("edge", "known", "unknown"), [(0.5, 0.13, 0.16), (0.0, 0.26, 0.33)])
def test_half_of_not_having_measured_is_more_at_an_end_of_the_range(edge, known, unknown):
    cube = UnitCube({})
    for sd, determined in ((known, True), (unknown, False)):
        best = np.where(np.array(cube.names) == "hematite_ratio", edge, 0.5)
        draws = draw_states(best, np.eye(7) * sd**2)
        assert (
            estimate_parameter_errors(cube, best, draws)["hematite_ratio"].constrained == determined
        )
