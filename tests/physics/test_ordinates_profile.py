"""Fluxes in layers by discrete ordinates against another program, budgets and exact solutions."""

from __future__ import annotations

import numpy as np
import pytest
from level_fluxes import compute_profile, join_cosines

from splits.discrete_ordinates.adding import Boundary, Element, compute_budget, make_isotropic
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab

BEAMS = np.array([0.5, 0.9])
DIVIDED = ([0.3, 1.2, 2.0, 1.0], [0.95, 0.95, 0.8, 0.8], [0.6, 0.6, 0.2, 0.2])


def solve(thickness, albedo, asymmetry, ground, beams=BEAMS, n_streams=32):
    """Return the profile and the budget of layers of Henyey and Greenstein."""
    moments = np.array(asymmetry)[..., np.newaxis] ** np.arange(n_streams + 1)
    optics = LayerOptics.from_albedo(np.array(thickness, float), np.array(albedo, float), moments)
    streams, directions = Streams.from_number(n_streams), beams[np.newaxis]
    slabs = solve_slab(optics.truncate(n_streams), streams, directions)
    isotropic = make_isotropic(optics, streams, beams.size)
    elements = [Element.from_slab(slabs.select(i), isotropic[i]) for i in range(len(thickness))]
    boundaries = [Boundary.make_transparent(n_streams // 2, beams.size)] * 2
    outside = boundaries, np.broadcast_to(ground, optics.thickness.shape[1:]), n_streams // 2
    cosines = join_cosines(streams, directions)
    profile = compute_profile(elements, [*isotropic, isotropic[-1]], cosines, *outside)
    return profile, compute_budget(elements, (isotropic[0], isotropic[-1]), *outside)


def check_closure(profile, budget, tolerance=1e-12):
    net = profile.downward - profile.upward
    np.testing.assert_allclose(net[:-1] - net[1:], budget.absorption, atol=tolerance)
    np.testing.assert_allclose(profile.upward[0], budget.reflectance, atol=tolerance)
    np.testing.assert_allclose(net[-1], budget.transmittance, atol=tolerance)


@pytest.mark.parametrize("column", [0, 1, 2])
def test_fluxes_agree_with_other_program(column):
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    thickness, albedo, asymmetry = DIVIDED
    n = 32
    profile, budget = solve(*DIVIDED, 0.3)
    check_closure(profile, budget)
    moments = np.array(asymmetry)[:, np.newaxis] ** np.arange(n + 1)
    cosine, intensity, diffuse = ((0.5, 2.0, 0.0), (0.9, 1.0 / 0.9, 0.0), (1.0, 0.0, 1.0 / np.pi))[
        column
    ]
    cosines, up, down, mean = pydisort(
        np.cumsum(thickness), np.array(albedo), n, moments, cosine, intensity, 0.0, only_flux=True,
        f_arr=moments[:, n], b_neg=diffuse, BDRF_Fourier_modes=[0.3],
    )  # fmt: skip
    depth = np.append(0.0, np.cumsum(thickness))
    np.testing.assert_allclose(profile.upward[:, column], up(depth), atol=1e-12)
    np.testing.assert_allclose(profile.downward[:, column], sum(down(depth)), atol=1e-12)
    weights = np.tile(np.polynomial.legendre.leggauss(n // 2)[1] / 2.0, 2)
    np.testing.assert_allclose(np.abs(cosines[n // 2 :]), cosines[: n // 2])
    actinic = 2.0 * np.pi * weights @ mean(depth)
    actinic += profile.direct[:, column] / cosine
    np.testing.assert_allclose(profile.actinic[:, column], actinic, atol=1e-11)
    # The direct flux includes the forward peak.
    if column < 2:
        scaled = np.array(thickness) * (1.0 - np.array(albedo) * moments[:, n])
        direct = np.exp(-np.append(0.0, np.cumsum(scaled)) / cosine)
        np.testing.assert_allclose(profile.direct[:, column], direct, rtol=1e-12)


def test_divisions_do_not_change_fluxes():
    merged, _ = solve([1.5, 3.0], [0.95, 0.8], [0.6, 0.2], 0.3)
    divided, _ = solve(*DIVIDED, 0.3)
    for one, other in zip(merged, divided, strict=True):
        np.testing.assert_allclose(one, other[[0, 2, 4]], atol=1e-13)


def test_profiles_are_batched():
    rng = np.random.default_rng(2)
    shape = (3, 5)
    layers = [rng.uniform(low, high, shape) for low, high in ((0.1, 4.0), (0.6, 1.0), (0.1, 0.8))]
    ground = rng.uniform(0.0, 1.0, 5)
    profile, budget = solve(*layers, ground, n_streams=16)
    check_closure(profile, budget)
    assert profile.actinic.shape == (4, 5, 3)
    for i in range(5):
        alone, _ = solve(*(values[:, i] for values in layers), ground[i], n_streams=16)
        for one, other in zip(profile, alone, strict=True):
            np.testing.assert_allclose(one[:, i], other, rtol=1e-11)


@pytest.mark.parametrize("thickness", [0.0, 1e-8, 1.0, 1e4, 1e8])
@pytest.mark.parametrize("albedo", [0.0, 0.9, 1.0 - 1e-12, 1.0])
def test_energy_is_conserved_at_extremes(thickness, albedo):
    beams = np.cos(np.radians([0.0, 60.0, 89.9]))
    for ground in (0.0, 0.5, 1.0):
        profile, budget = solve([thickness] * 3, [albedo] * 3, [0.8] * 3, ground, beams, 16)
        for values in profile:
            assert np.isfinite(values).all()
            assert (values > -1e-14).all()
        check_closure(profile, budget)


@pytest.mark.parametrize(("thickness", "tolerance"), [(1.0, 1e-13), (1e4, 1e-11), (1e8, 1e-6)])
def test_light_from_both_sides_is_isotropic_without_absorption(thickness, tolerance):
    """At the centre, light from above and its mirror image add up to isotropic radiance."""
    profile, _ = solve([thickness] * 2, [1.0] * 2, [0.8] * 2, 0.0, n_streams=16)
    total = profile.downward[1, -1] + profile.upward[1, -1]
    assert total == pytest.approx(1.0, abs=tolerance)
    assert profile.actinic[1, -1] == pytest.approx(2.0, abs=2.0 * tolerance)


def test_white_ground_without_absorption_encloses_isotropic_light():
    profile, _ = solve([1.0, 2.0], [1.0, 1.0], [0.8, 0.3], 1.0)
    np.testing.assert_allclose(profile.downward[:, -1], 1.0, rtol=1e-12)
    np.testing.assert_allclose(profile.upward[:, -1], 1.0, rtol=1e-12)
    np.testing.assert_allclose(profile.actinic[:, -1], 4.0, rtol=1e-12)


def test_flux_in_half_space_decays_at_the_rate_of_diffusion():
    """Isotropic scattering: 2k = ω log((1 + k)/(1 − k)) for the rate k."""
    albedo, step = 0.9, 2.0
    layers = [step] * 10 + [np.inf]
    profile, budget = solve(layers, [albedo] * 11, [0.0] * 11, 0.0)
    check_closure(profile, budget)
    low, high = 1e-3, 1.0 - 1e-12
    for _ in range(60):
        k = 0.5 * (low + high)
        low, high = (k, high) if 2.0 * k > albedo * np.log((1.0 + k) / (1.0 - k)) else (low, k)
    for values in (profile.downward, profile.upward, profile.actinic):
        decay = np.log(values[9, -1] / values[10, -1]) / step
        assert decay == pytest.approx(k, abs=1e-4)
        np.testing.assert_allclose(values[-1], 0.0, atol=1e-30)
