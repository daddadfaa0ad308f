"""Coins that kernels toss: free paths, reflect or refract, air or water, diffuse light."""

from __future__ import annotations

import math

import numpy as np
from chi2 import draw, judge_p, judge_z, p_of_values, scaled, tabulated_cdf
from numba import njit

import splits
from splits.media import grain_statistics
from splits.transport import facets, fresnel, grain, granular, spheroid
from splits.transport.scene import DRY_PORE, WET_PORE, Slab

COUNT = scaled(200_000)
NO_LEG = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
# Semi-major axes of SPLITSnow Table 1 (m).
LOW, HIGH = 1.5e-4, 3.75e-4
DEEP = Slab(1e4, 0.0, 1.0, False)


def binomial_z(hits, p):
    """Return how many standard errors a share of hits lies from p (exact when p is 0 or 1)."""
    share = np.mean(hits)
    if p in (0.0, 1.0):
        return 0.0 if share == p else math.inf
    return (share - p) / math.sqrt(p * (1.0 - p) / np.size(hits))


@njit
def _deep_grain(state, dx, dy, dz, grains, slab, rules, no_leg):
    """Return leg, semi-major axis, sphericity and misfit of a grain met far from boundaries."""
    leg, _, b, psi, c1, c2, c3, p1, p2, p3, _, _, _, _, _, _ = granular.next_grain(
        state, 1.0, 2.0, -5e3, dx, dy, dz, 5e3, no_leg, grains, slab, rules
    )
    miss = max(
        abs(c1 + p1 - 1.0 - leg * dx), abs(c2 + p2 - 2.0 - leg * dy), abs(c3 + p3 + 5e3 - leg * dz)
    )
    return leg, b, psi, miss


def test_free_path_and_grain_in_a_deep_medium():
    p = {}
    for entry in ("uniform", "projected"):
        snow = splits.Snow(depth_m=1e4, saturation=0.0, readings={"entry": entry})
        grains, rules = snow.grains(), snow.readings.rules()
        out = draw(
            _deep_grain, scaled(100_000), 0.48, -0.64, 0.6, grains, DEEP, rules, NO_LEG, width=4
        )
        leg, b, psi, miss = out.T
        assert miss.max() < 1e-11
        distance = snow.mean_grain_distance_m
        p[entry, "distance"] = p_of_values(leg, lambda x, d=distance: -np.expm1(-x / d))
        p[entry, "size"] = p_of_values(b, lambda s: (1 / LOW - 1 / s) / (1 / LOW - 1 / HIGH))
        limits = snow.sphericity

        def density(x, limits=limits):
            bell = np.exp(-0.5 * ((x - limits[2]) / limits[3]) ** 2)
            return grain_statistics.surface_to_volume(x) * bell

        p[entry, "sphericity"] = p_of_values(psi, tabulated_cdf(density, *limits[:2]))
    judge_p(p)


def test_grain_is_forgotten_when_the_boundary_comes_first():
    snow = splits.Snow(depth_m=1e4)
    legs = draw(
        _next_leg, scaled(50_000), snow.mean_grain_distance_m, snow.grains(), DEEP,
        snow.readings.rules(), NO_LEG,
    )  # fmt: skip
    # The boundary lies one mean distance ahead: e^-1 of all rays get there.
    reached = legs == snow.mean_grain_distance_m
    assert legs.max() == snow.mean_grain_distance_m
    judge_z([binomial_z(reached, math.exp(-1.0))], "boundary first")


@njit
def _next_leg(state, to_boundary, grains, slab, rules, no_leg):
    return granular.next_grain(
        state, 0.0, 0.0, -5e3, 0.0, 0.0, 1.0, to_boundary, no_leg, grains, slab, rules
    )[0]


@njit
def _crossed(state, mu, n1, n2):
    passed, dx, dy, dz = granular.cross_boundary(
        state, math.sqrt(1.0 - mu * mu), 0.0, mu, n1, n2, 0.0
    )
    return 1.0 if passed else 0.0, dx, dy, dz


def test_share_reflected_at_an_extended_boundary():
    z = []
    for n1, n2 in ((1.0, 1.33), (1.33, 1.0), (1.0, 1.0), (1.0, 3.0)):
        for mu in (1.0, 0.7, 0.3, 0.05, -0.9, -0.2):
            out = draw(_crossed, COUNT // 4, mu, n1, n2, width=4)
            passed, dx, dy, dz = out.T
            sine_t = n1 / n2 * math.sqrt(1.0 - mu * mu)
            reflectance, _, _ = fresnel.interface(n1, n2, 0.0, abs(mu))
            z.append(binomial_z(passed, 1.0 - reflectance))
            went = passed == 1.0
            assert (dz[~went] == -mu).all() and (dy == 0.0).all()
            assert (np.sign(dz[went]) == np.sign(mu)).all()
            assert not went.any() or np.abs(dx[went] - sine_t).max() < 1e-12
    judge_z(z, "boundary")


@njit
def _interacted(state, cos_i, n1, n2, k2, rules):
    sin_i = math.sqrt(1.0 - cos_i * cos_i)
    passed, dx, dy, dz = grain.interact(
        state, sin_i, 0.0, -cos_i, 0.0, 0.0, 1.0, 0.0, n1, 0.0, n2, k2, rules
    )
    return 1.0 if passed else 0.0, dx, dy, dz


def test_share_reflected_at_a_smooth_grain():
    rules = splits.Readings().rules()
    z = []
    for n1, n2, k2 in ((1.0, 1.31, 0.0), (1.31, 1.0, 0.0), (1.31, 1.33, 1e-3), (1.0, 1.3, 0.5)):
        for cos_i in (1.0, 0.8, 0.5, 0.1):
            passed, _, _, dz = draw(_interacted, COUNT // 4, cos_i, n1, n2, k2, rules, width=4).T
            z.append(binomial_z(passed, 1.0 - fresnel.interface(n1, n2, k2, cos_i)[0]))
            assert ((dz < 0.0) == (passed == 1.0)).all()
    judge_z(z, "grain")


@njit
def _rough(state, cos_i, n1, n2, rules):
    """Return the reflectance expected at the facet drawn, and whether the ray was reflected."""
    sin_i = math.sqrt(1.0 - cos_i * cos_i)
    _, _, _, cosine = facets.struck_facet(
        state, sin_i, 0.0, -cos_i, 0.0, 0.0, 1.0, 0.8, rules.facets
    )
    expected = fresnel.interface(n1, n2, 0.0, cosine)[0]
    passed, _, _, dz = grain.interact(
        state, sin_i, 0.0, -cos_i, 0.0, 0.0, 1.0, 0.8, n1, 0.0, n2, 0.0, rules
    )
    return expected, 0.0 if passed else 1.0, 1.0 if (dz < 0.0) == passed else 0.0


def test_share_reflected_at_a_rough_grain():
    # Reflectance averaged over facets against the share of rays reflected; whatever facet is
    # met, a ray ends up on the side of the macroscopic surface that it was sent to.
    z = []
    for wrong_side in ("lobe", "mirrored"):
        for rule in ("projected", "unweighted", "any"):
            rules = splits.Readings(facets=rule, wrong_side=wrong_side).rules()
            for n1, n2 in ((1.0, 1.31), (1.31, 1.0)):
                for cos_i in (0.9, 0.3):
                    out = draw(_rough, COUNT // 8, cos_i, n1, n2, rules, width=3)
                    expected, reflected, right_side = out.T
                    assert right_side.all()
                    error = math.sqrt((expected.var() + reflected.var()) / len(out))
                    z.append((expected.mean() - reflected.mean()) / error)
    judge_z(z, "rough grain")


@njit
def _pore(state, saturation):
    return float(grain.draw_pore(state, saturation))


def test_pore_medium_follows_saturation():
    z = []
    for saturation in (0.0, 0.05, 0.3, 1.0):
        pore = draw(_pore, COUNT, saturation)
        assert set(np.unique(pore)) <= {float(DRY_PORE), float(WET_PORE)}
        z.append(binomial_z(pore == WET_PORE, saturation))
    judge_z(z, "pore")


@njit
def _overlaps_last_leg(state, grains, slab, rules, last_leg):
    """Return whether a grain met after a reversal overlaps the leg travelled before it."""
    _, _, b, psi, c1, c2, c3, _, _, _, w1, w2, w3, _, _, _ = granular.next_grain(
        state, 0.0, 0.0, -5e3, 0.1, 0.0, math.sqrt(0.99), 5e3, last_leg, grains, slab, rules
    )
    c = b * psi * psi
    minor2, shift = 1.0 / (c * c), 1.0 / (b * b) - 1.0 / (c * c)
    lx, ly, lz, ldx, ldy, ldz, length = last_leg
    cut = spheroid.cuts_segment(
        lx - c1, ly - c2, lz - c3, ldx, ldy, ldz, length, w1, w2, w3, minor2, shift
    )
    return 1.0 if cut else 0.0


def test_no_grain_lies_on_the_last_leg_unless_kept():
    last_leg = (0.0, 0.0, -5e3 + 2e-3, 0.0, 0.0, -1.0, 2e-3)
    share = {}
    for fate in ("reject", "keep"):
        snow = splits.Snow(depth_m=1e4, readings={"grain_on_last_leg": fate})
        share[fate] = draw(
            _overlaps_last_leg, scaled(20_000), snow.grains(), DEEP, snow.readings.rules(), last_leg
        ).mean()
    assert share["reject"] == 0.0
    assert share["keep"] > 0.5
