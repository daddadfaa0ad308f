"""Basis functions over the hemisphere, directional tallies, and principal planes."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from splits.analysis.directions import merge_angular_bins, select_principal_plane
from splits.instruments.angular_estimate import (
    MAX_POWER_RATIO,
    VARIANCE_PENALTY,
    estimate_truncation_error,
    make_direction_grid,
    select_terms,
)
from splits.instruments.angular_tallies import compute_bin_centres
from splits.kernels.tallies.distributions import (
    evaluate_basis_at,
    make_basis,
    tally_angular_bins,
    tally_expansion,
)
from splits.kernels.tallies.exits import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)

DEGREE = 24


def make_quadrature(polar=40, azimuth=64):
    """Return directions and weights that integrate over projected solid angle."""
    x, w = np.polynomial.legendre.leggauss(polar)
    mu, phi = np.meshgrid(
        0.5 * (x + 1.0), np.arange(azimuth) * 2.0 * np.pi / azimuth, indexing="ij"
    )
    weights = (0.5 * w[:, np.newaxis] * mu * 2.0 * np.pi / azimuth).ravel()
    sine = np.sqrt(1.0 - mu**2)
    directions = np.stack([sine * np.cos(phi), sine * np.sin(phi), mu], axis=-1).reshape(-1, 3)
    return directions, weights


def test_basis_is_orthonormal_over_projected_solid_angle():
    directions, weights = make_quadrature()
    values = evaluate_basis_at(make_basis(DEGREE), directions)
    product = (values * weights[:, np.newaxis]).T @ values
    assert np.abs(product - np.eye(len(product))).max() < 1e-12


def test_basis_functions_are_jacobi_polynomials():
    from scipy.special import eval_jacobi

    basis = make_basis(DEGREE)
    directions, _ = make_quadrature(7, 5)
    values = evaluate_basis_at(basis, directions)
    mu, phi = directions[:, 2], np.arctan2(directions[:, 1], directions[:, 0])
    row = 0
    for m, n_terms in enumerate(basis.n_per_m):
        for i in range(n_terms):
            expected = (
                (1.0 - mu) ** (0.5 * m) * np.cos(m * phi) * eval_jacobi(i, m, 1, 2.0 * mu - 1)
            )
            assert values[:, row] == pytest.approx(basis.norms[row] * expected, rel=1e-9, abs=1e-9)
            assert basis.degrees[row] == m + 2 * i
            row += 1
    assert row == basis.norms.size


def test_only_the_constant_term_has_an_integral():
    directions, weights = make_quadrature()
    values = evaluate_basis_at(make_basis(DEGREE), directions)
    integrals = weights @ values
    assert integrals[0] == pytest.approx(np.sqrt(np.pi), rel=1e-13)
    assert np.abs(integrals[1:]).max() < 1e-12


def make_exit_rows(directions, sides, orders, lengths):
    rows = allocate_exits(len(directions), 3)
    rows[:, EXIT_SIDE] = sides
    rows[:, EXIT_ORDER] = orders
    rows[:, EXIT_WEIGHT] = 1.0
    rows[:, EXIT_DIRECTION : EXIT_DIRECTION + 3] = directions
    rows[:, EXIT_LENGTH:] = lengths
    return rows


DIRECTIONS = np.array(
    [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.6, 0.0, -0.8], [0.0, -0.6, 0.8], [0.8, 0.0, 0.6]]
)
SIDES = [0, 0, 1, -1, 0]
ORDERS = [0, 1, 3, 1, 5]
ABSORPTION = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 100.0]])
LENGTHS = np.array([0.0, 0.0, 0.01])


def test_expansion_tally_by_side_order_and_wavelength():
    basis = make_basis(4)
    rows = make_exit_rows(DIRECTIONS, SIDES, ORDERS, LENGTHS)
    sums, unscattered = tally_expansion(rows, ABSORPTION, np.array([2, 4, 100]), basis)
    values = evaluate_basis_at(basis, DIRECTIONS)
    transmittance = np.array([1.0, np.exp(-1.0)])
    assert unscattered == pytest.approx(np.array([transmittance, [0.0, 0.0]]))
    for j, (ray, side) in enumerate(((1, 0), (2, 1), (4, 0))):
        assert sums[j, side] == pytest.approx(np.outer(transmittance, values[ray]))
        assert not sums[j, 1 - side].any()


def test_angular_bins_have_equal_projected_solid_angles():
    rows = make_exit_rows(DIRECTIONS, SIDES, ORDERS, LENGTHS)
    sums, unscattered = tally_angular_bins(rows, ABSORPTION, 5, 8, -1)
    transmittance = np.array([1.0, np.exp(-1.0)])
    assert unscattered[0, 0] == pytest.approx(transmittance)
    assert unscattered[1, 0] == pytest.approx(transmittance**2)
    # cos 0.8 and 0.6 lie in the fifth and fourth of five equal bins.
    assert sums[0, 0, :, 4, 0] == pytest.approx(transmittance)
    assert sums[0, 0, :, 3, 0] == pytest.approx(transmittance)
    assert sums[1, 1, :, 4, 0] == pytest.approx(transmittance**2)
    assert sums[0].sum() == pytest.approx(3.0 * transmittance.sum())
    polar, azimuth = compute_bin_centres((5, 8))
    assert np.cos(np.radians(polar)) == pytest.approx([0.9, 0.7, 0.5, 0.3, 0.1])
    assert azimuth.tolist() == [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]


def draw_coefficients(signal, noise, n_batches=64, seed=1):
    """Return coefficients of batches whose mean has the given noise."""
    random = np.random.default_rng(seed)
    scatter = random.normal(size=(n_batches, signal.size)) * noise * np.sqrt(n_batches)
    return signal + scatter


def test_noise_terms_are_not_selected():
    basis = make_basis(DEGREE)
    signal = np.zeros(basis.norms.size)
    signal[0] = 1.0
    counts = [
        select_terms(draw_coefficients(signal, 0.01, seed=seed), basis, False).sum()
        for seed in range(50)
    ]
    # The constant term and its neighbours, except for rare fluctuations.
    assert np.median(counts) == 4
    assert max(counts) < 40


def test_significant_terms_are_selected():
    basis = make_basis(DEGREE)
    signal = np.zeros(basis.norms.size)
    rows = {(m, i): row for row, (m, i) in enumerate(list_pairs(basis))}
    for m, i in ((0, 0), (0, 3), (1, 1), (4, 0)):
        signal[rows[m, i]] = 1.0
    coefficients = draw_coefficients(signal, 0.01)
    keep = select_terms(coefficients, basis, False)
    assert all(keep[rows[pair]] for pair in ((0, 0), (0, 3), (1, 1), (4, 0)))
    assert keep.sum() < 40
    keep_normal = select_terms(coefficients, basis, True)
    assert all(m == 0 for (m, _), row in rows.items() if keep_normal[row])
    assert VARIANCE_PENALTY > 1.0


def list_pairs(basis):
    return [(m, i) for m, n_terms in enumerate(basis.n_per_m) for i in range(n_terms)]


def evaluate_brdf(polar, azimuth):
    values = np.cos(np.radians(polar))[:, np.newaxis] + 0.01 * np.arange(len(azimuth))
    stderr = np.full(values.shape, 0.1)
    data = {"brdf": (("polar", "azimuth"), values), "brdf_stderr": (("polar", "azimuth"), stderr)}
    return xr.Dataset(data, {"polar": polar, "azimuth": azimuth})


def test_principal_plane_runs_from_backward_to_forward():
    dataset = evaluate_brdf(np.array([0.0, 30.0, 60.0]), np.array([0.0, 90.0, 180.0]))
    plane = select_principal_plane(dataset)
    assert plane.angle.values.tolist() == [-60.0, -30.0, 0.0, 30.0, 60.0]
    cosine = np.cos(np.radians([60.0, 30.0, 0.0, 30.0, 60.0]))
    assert plane.brdf.values == pytest.approx(cosine + np.array([0.02, 0.02, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match=r"azimuth_deg = .*with 0 and 180 degrees"):
        select_principal_plane(dataset.isel(azimuth=[0, 1]))


def test_merged_bins_are_weighted_means():
    polar, azimuth = compute_bin_centres((6, 12))
    dataset = evaluate_brdf(polar, azimuth)
    merged = merge_angular_bins(dataset, 3)
    weight = np.cos(np.radians(polar))[:, np.newaxis]
    assert merged.brdf.shape == (2, 4)
    first = (weight * dataset.brdf.values)[:3][:, [11, 0, 1]].sum() / (3.0 * weight[:3].sum())
    assert float(merged.brdf[0, 0]) == pytest.approx(first)
    assert merged.azimuth.values.tolist() == [0.0, 90.0, 180.0, 270.0]
    assert (merged.brdf_stderr < 0.1).all()
    with pytest.raises(ValueError, match="factor = 2: must be odd"):
        merge_angular_bins(dataset, 2)


def compute_truncated_power(ratio, per_noise, seed):
    """Return the truncation error above degree 24 of a power spectrum with a given decay.

    The power decreases by `ratio` every four degrees.  That of the last four is `per_noise` times
    its noise.
    """
    basis = make_basis(DEGREE)
    angles = make_direction_grid(np.array([0.0, 30.0, 60.0, 80.0]), np.array([0.0, 180.0]), basis)
    rng = np.random.default_rng(seed)
    amplitude = ratio ** (0.5 * (basis.degrees / 4.0)) * rng.choice([-1.0, 1.0], basis.degrees.size)
    fine = basis.degrees > DEGREE - 4
    error = np.sqrt((amplitude[fine] ** 2).sum() / np.sqrt(2.0 * fine.sum()) / per_noise)
    batches = amplitude + 8.0 * error * rng.standard_normal((64, amplitude.size))
    return estimate_truncation_error(np.stack([batches, batches], axis=1), False, angles)


def test_truncation_error_is_not_inflated_by_noise():
    seeds = range(40)
    precise, noisy = (
        [compute_truncated_power(0.25, signal_to_noise, seed).max() for seed in seeds]
        for signal_to_noise in (1e6, 6.0)
    )
    assert 0.0 < np.mean(noisy) < 1.5 * np.mean(precise)
    # A power spectrum without decay gives a large estimate.
    assert compute_truncated_power(1.0, 1e6, 0).max() > MAX_POWER_RATIO / (1.0 - MAX_POWER_RATIO)
