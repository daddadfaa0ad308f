"""Phase functions, their samplers, and azimuths of scattered polarized light."""

import math

import mpmath as mp
import numpy as np
import pytest
from chi2 import (
    BIN_EDGES,
    compute_p_of_counts,
    draw_samples,
    judge_p,
    judge_z,
    scale_sample_size,
)
from numba import njit

from splits.kernels import interface, phase_function, scattering_matrix, stokes
from splits.kernels.interface import ComplexIndex
from splits.kernels.scene import Stokes, Vector

N_SAMPLES = scale_sample_size(200_000)
RAYLEIGH = scattering_matrix.make_rayleigh()
ASYMMETRIES = (-0.99, -0.5, 0.0, 1e-9, 0.3, 0.875, 0.99)
# A forward peak over four decades, a rainbow, an interval with one end 0, and an empty interval.
TABLE = scattering_matrix.make_tabulated(
    [1.0, 0.999, 0.97, 0.8, 0.5, 0.1, 0.0, -0.3, -0.7, -0.75, -0.8, -1.0],
    [9e3, 3e2, 2e1, 3.0, 0.5, 0.0, 0.0, 0.2, 0.3, 1.4, 0.3, 0.6],
    np.outer(np.linspace(0.1, -0.6, 12), [1.0, 0.5, 0.5, 0.2, 0.5]),
)
DEPOLARIZING = scattering_matrix.make_rayleigh(0.2)
MODELS = {f"g = {g}": scattering_matrix.make_henyey_greenstein(g) for g in ASYMMETRIES}
MODELS |= {"Rayleigh": RAYLEIGH, "depolarizing": DEPOLARIZING, "table": TABLE}

# Cosines dense at both ends, where phase functions have peaks, and the nodes of the table.
_NEAR = np.concatenate([np.logspace(-9, -1, 300), np.linspace(0.1, 1.0, 100)[1:]])
GRID = np.unique(np.concatenate([[-1.0, 1.0], 1.0 - _NEAR, _NEAR - 1.0, TABLE.cosines]))
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


@njit
def _densities(model, mu):
    out = np.empty(mu.size)
    for i in range(mu.size):
        out[i] = phase_function.evaluate_phase_function(model, mu[i])
    return out


def make_quadrature(edges):
    """Return nodes and weights of an integral over each interval between edges."""
    half = 0.5 * np.diff(edges)[:, np.newaxis]
    return edges[:-1, np.newaxis] + half * (1.0 + NODES), half * WEIGHTS


def integrate_density(model, moment=0):
    """Return the integrals of the density times a power of µ over the intervals of the grid."""
    mu, weights = make_quadrature(GRID)
    density = _densities(model, mu.ravel()).reshape(mu.shape)
    return 2.0 * np.pi * (weights * density * mu**moment).sum(axis=1)


def make_bins(model, probabilities):
    """Return bin edges on the grid nearest given probabilities, and probabilities of the bins."""
    cumulative = np.append(0.0, np.cumsum(integrate_density(model)))
    at = np.unique(np.searchsorted(cumulative, probabilities))
    at = np.concatenate([[0], at[(at > 0) & (at < GRID.size - 1)], [GRID.size - 1]])
    return GRID[at], np.diff(cumulative[at])


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_densities_have_unit_integral_and_mean_cosine_g(model):
    assert integrate_density(model).sum() == pytest.approx(1.0, rel=1e-10)
    assert integrate_density(model, 1).sum() == pytest.approx(model.g, rel=1e-10, abs=1e-14)


def test_scattering_cosines_follow_their_density():
    p, z = {}, []
    for i, (name, model) in enumerate(MODELS.items()):
        mu = draw_samples(phase_function.sample_scattering_cosine, N_SAMPLES, model, ray=i)
        assert mu.min() >= -1.0 and mu.max() <= 1.0
        edges, bin_probabilities = make_bins(model, BIN_EDGES)
        p[name] = compute_p_of_counts(np.histogram(mu, edges)[0], bin_probabilities)
        z.append((mu.mean() - model.g) / (mu.std() / math.sqrt(mu.size)))
    judge_p(p)
    judge_z(z, "mean cosine")


def test_quantiles_agree_with_high_precision():
    probabilities = [1e-15, 1e-9, 1e-3, 0.3, 0.5, 0.9, 0.999, 1.0 - 1e-9, 1.0 - 2.0**-53]
    for g in (*ASYMMETRIES, -1e-300, -0.999999, 0.999999):
        for u in probabilities:
            mu = phase_function.henyey_greenstein_quantile(g, u)
            assert -1.0 <= mu <= 1.0
            with mp.workdps(50):
                a, t = mp.mpf(g), 2 * mp.mpf(u) - 1
                top = t + a * (3 + t * t) / 2 + a * a * t + a**3 * (t * t - 1) / 2
                assert abs(top / (1 + a * t) ** 2 - mu) < 1e-15
    for u in probabilities:
        mu = phase_function.rayleigh_quantile(u)
        assert -1.0 <= mu <= 1.0
        assert (mu**3 + 3.0 * mu + 4.0) / 8.0 == pytest.approx(u, abs=3e-16)


def test_henyey_greenstein_density_agrees_with_high_precision():
    for g in (*ASYMMETRIES, 0.999999):
        for mu in (-1.0, -1.0 + 1e-9, -0.4, 0.0, 0.7, 1.0 - 1e-9, 1.0 - 1e-15, 1.0):
            with mp.workdps(50):
                a = mp.mpf(g)
                exact = (1 - a * a) / (4 * mp.pi * (1 + a * a - 2 * a * mp.mpf(mu)) ** mp.mpf(1.5))
            model = scattering_matrix.make_henyey_greenstein(g)
            assert phase_function.evaluate_phase_function(model, mu) == pytest.approx(
                float(exact), rel=2e-15
            )


def test_tabulated_phase_function():
    x = np.array([-1.0, -0.25, 0.5, 1.0])
    table = scattering_matrix.make_tabulated(x[::-1], [4.0, 0.0, 2.0, 2.0])
    # The integral over µ is 2 × 0.75 + 0.75 + 1.
    assert table.density == pytest.approx(np.array([2.0, 2.0, 0.0, 4.0]) / (6.5 * np.pi))
    assert table.cdf == pytest.approx(np.array([0.0, 1.5, 2.25, 3.25]) / 3.25)
    for mu, u in ((-0.625, 0.75), (0.125, 2.0625), (0.75, 2.5)):
        out = phase_function.table_quantile(table.cosines, table.density, table.cdf, u / 3.25)
        assert out == pytest.approx(mu, abs=1e-15)
        assert phase_function.evaluate_phase_function(table, mu) == pytest.approx(
            np.interp(mu, x, table.density)
        )
    for mu in x:
        assert phase_function.evaluate_phase_function(table, mu) == pytest.approx(
            np.interp(mu, x, table.density)
        )


def test_fine_table_of_rayleigh_has_zero_mean():
    theta = np.radians(np.arange(181.0))
    table = scattering_matrix.make_tabulated(np.cos(theta), 1.0 + np.cos(theta) ** 2)
    assert table.g == pytest.approx(0.0, abs=1e-15)
    assert phase_function.evaluate_phase_function(table, 1.0) == pytest.approx(
        3 / (8 * math.pi), rel=1e-3
    )


@njit
def _sample_direction(state, model, d, light):
    return stokes.scatter_polarized(state, model, d, light).direction


@njit
def _sample_unpolarized(state, model, d):
    return phase_function.sample_phase_function(state, model, d)


D = np.array([0.48, -0.64, 0.6])
E = np.array([0.8, 0.6, 0.0])
LIGHT = {
    "unpolarized": (0.0, 0.0, 0.0),
    "partly": (0.3, -0.5, 0.4),
    "linear": (-0.6, 0.8, 0.0),
    "circular": (0.0, 0.0, -1.0),
}
ALONG, REFERENCE = Vector(*D.tolist()), Vector(*E.tolist())
AZIMUTH_EDGES = 2.0 * np.pi * np.arange(13) / 12


def make_joint_bins(model, s, probabilities):
    """Return edges of cosines and the probabilities of (cosine, azimuth) bins.

    The density is that of `evaluate_polarized_scattering` at 2 nodes of each azimuthal bin: the
    relative error of Gauss' rule for cos2φ over 30° is 1e-4.
    """
    edges, _ = make_bins(model, probabilities)
    inner = np.unique(np.concatenate([edges, np.linspace(-1.0, 1.0, 9), TABLE.cosines]))
    mu, weights = make_quadrature(inner)
    x = np.array([-1.0, 1.0]) / math.sqrt(3.0)
    phi = AZIMUTH_EDGES[:-1, np.newaxis] + 0.5 * (AZIMUTH_EDGES[1] - AZIMUTH_EDGES[0]) * (1.0 + x)
    sides = np.cos(phi)[..., np.newaxis] * E + np.sin(phi)[..., np.newaxis] * np.cross(D, E)
    out = np.zeros((edges.size - 1, 12))
    for m, w in zip(mu.ravel(), weights.ravel(), strict=True):
        row = np.searchsorted(edges, m) - 1
        t = m * D + math.sqrt(1.0 - m * m) * sides
        for column, pair in enumerate(t):
            for one in pair:
                light, toward = Stokes(REFERENCE, *s), Vector(*one.tolist())
                density = stokes.evaluate_polarized_scattering(model, ALONG, light, toward).density
                out[row, column] += w * density * 0.5 * (AZIMUTH_EDGES[1] - AZIMUTH_EDGES[0])
    return edges, out


def count_directions(directions, edges):
    assert np.abs((directions**2).sum(axis=1) - 1.0).max() < 4e-15
    phi = np.arctan2(directions @ np.cross(D, E), directions @ E) % (2.0 * np.pi)
    mu = np.clip(directions @ D, -1.0, 1.0)
    return np.histogram2d(mu, phi, bins=(edges, AZIMUTH_EDGES))[0]


def test_directions_of_polarized_light_follow_their_density():
    p = {}
    edge_probabilities = np.arange(1, 8) / 8
    forward = scattering_matrix.make_henyey_greenstein(0.5)
    models = {
        "forward": forward, "Rayleigh": RAYLEIGH, "depolarizing": DEPOLARIZING, "table": TABLE,
    }  # fmt: skip
    for model_name, model in models.items():
        for i, (name, s) in enumerate(LIGHT.items()):
            light = Stokes(REFERENCE, *s)
            out = draw_samples(
                _sample_direction, N_SAMPLES // 2, model, ALONG, light, width=3, ray=i
            )
            edges, bin_probabilities = make_joint_bins(model, s, edge_probabilities)
            bin_probabilities /= bin_probabilities.sum()
            p[model_name, name] = compute_p_of_counts(
                count_directions(out, edges), bin_probabilities
            )
        out = draw_samples(_sample_unpolarized, N_SAMPLES // 2, model, ALONG, width=3)
        edges, bin_probabilities = make_joint_bins(model, LIGHT["unpolarized"], edge_probabilities)
        p[model_name, "scalar"] = compute_p_of_counts(
            count_directions(out, edges), bin_probabilities / bin_probabilities.sum()
        )
    judge_p(p)


@njit
def _sample_transmission(state, d, light, normal, n1, n2):
    sample = interface.sample_polarized_interface(state, d, light, normal, n1, n2)
    return 1.0 if sample.transmitted else 0.0


def test_reflected_fraction_of_polarized_light():
    z = []
    for n1, n2 in ((1.0, 1.33), (1.33, 1.0)):
        for cos_i in (0.95, 0.7, 0.3):
            side = 0.28 * E - 0.96 * np.cross(D, E)
            normal = Vector(*(-cos_i * D + math.sqrt(1.0 - cos_i * cos_i) * side).tolist())
            for s in LIGHT.values():
                media = ComplexIndex(n1, 0.0), ComplexIndex(n2, 0.0)
                beam = ALONG, Stokes(REFERENCE, *s), normal, *media
                reflectance = interface.reflect_polarized(*beam).reflectance
                transmitted = draw_samples(_sample_transmission, N_SAMPLES // 8, *beam, ray=len(z))
                if reflectance == 1.0:
                    assert not transmitted.any()
                    continue
                error = math.sqrt(reflectance * (1.0 - reflectance) / transmitted.size)
                z.append((1.0 - transmitted.mean() - reflectance) / error)
    judge_z(z, "reflected")
