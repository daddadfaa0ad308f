"""Formulas prone to cancellation, compared with 50-digit arithmetic by mpmath.

The tolerance is a relative error of 1e-12, or the effect of the last digit of a rounded argument
(`compute_rounding_sensitivity`), which no formula in float64 can avoid.
"""

import math

import mpmath as mp
import numpy as np
import pytest
from chi2 import start_random_stream

import splits
from splits.kernels.arithmetic import Angle
from splits.kernels.grains import spheroid, surface
from splits.kernels.grains.spheroid import Spheroid
from splits.kernels.grains.surface import InteractionVariates
from splits.kernels.interface import fresnel
from splits.kernels.rng import sample_half_normal
from splits.kernels.scene import UNWEIGHTED_FACETS, UP, Vector, make_table_probabilities
from splits.materials import ice_density
from splits.materials.refractive_index import maxwell_garnett
from splits.media import grain_statistics as statistics
from splits.media.sand_composition import SEPARATE_LIMITS_M, make_size_distribution

M = mp.mpf
RELATIVE = 1e-12
EPS = 2.0**-52
QUANTILES = range(1, statistics.N_TABLE_POINTS - 1, 73)


@pytest.fixture(autouse=True)
def fifty_digits():
    with mp.workdps(50):
        yield


def compute_relative_error(value, exact):
    return float(abs((M(float(value)) - exact) / exact))


def compute_rounding_sensitivity(exact, x):
    """Return the largest relative change of exact(x) when x changes by its last digit."""
    centre = exact(M(x))
    return max(float(abs(exact(M(x) * (1 + s * M(EPS))) / centre - 1)) for s in (1, -1))


# --- shapes and sizes -------------------------------------------------------------------------


def evaluate_area(psi):
    """Return A(Ψ) of SPLITSnow Eq A.9."""
    x2 = 1 - psi**4
    return 3 * (1 + (mp.asin(mp.sqrt(x2)) / mp.sqrt(x2) if x2 else M(1)) / psi**2)


def test_surface_to_volume_ratio():
    psi = np.concatenate([np.linspace(0.1, 1.0, 181), 1.0 - np.logspace(-16, -1, 181)])
    for p, value in zip(psi, statistics.surface_to_volume_ratio(psi), strict=True):
        assert compute_relative_error(value, evaluate_area(M(float(p)))) < RELATIVE


def test_size_attenuation_for_ratios_of_1_to_1000():
    for relative_width in [0.0, *np.logspace(-16, math.log10(999.0), 150)]:
        low, high = 2e-4, 2e-4 * (1.0 + relative_width)
        a, b = M(low), M(high)
        exact = 1 / a if a == b else (1 / a - 1 / b) / mp.log(b / a)
        assert (
            compute_relative_error(statistics.compute_size_attenuation(low, high), exact) < RELATIVE
        )


@pytest.mark.parametrize("ratio", [1.0, 1.0 + 1e-12, 2.5, 1000.0])
def test_inverse_sizes_of_hit_grains(ratio):
    low, high = 1e-5, 1e-5 * ratio
    u = make_table_probabilities(statistics.N_TABLE_POINTS)
    attenuation = statistics.tabulate_hit_inverse_sizes(low, high, "cross_section")
    uniform = statistics.tabulate_hit_inverse_sizes(low, high, "uniform")
    for i in QUANTILES:
        p, a, b = M(float(u[i])), M(low), M(high)
        assert compute_relative_error(attenuation[i], (1 - p) / b + p / a) < RELATIVE
        assert compute_relative_error(uniform[i], 1 / (b - p * (b - a))) < RELATIVE


SHAPES = {
    "Table 1": (0.6, 0.95, 0.798, 0.064),
    "needle-sharp between far limits": (0.1, 1.0, 0.8, 1e-6),
    "nearly uniform": (0.1, 1.0, 0.5, 1.0),
    "at the lower limit": (0.1, 1.0, 0.1, 0.05),
    "at the sphere": (0.5, 1.0, 1.0, 0.02),
    "nearly one value": (0.3, 0.3 + 1e-9, 0.3, 0.1),
}


def integrate_bell(low, high, weight):
    low, high = max(low, M(-14)), min(high, M(14))
    return mp.quad(lambda t: mp.exp(-t * t / 2) * weight(t), mp.linspace(low, high, 9))


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_mean_and_quantiles_of_sphericity(shape):
    minimum, maximum, mean, sd = (M(x) for x in shape)
    table = statistics.tabulate_hit_sphericities(*shape)
    u = make_table_probabilities(statistics.N_TABLE_POINTS)
    low, high = (minimum - mean) / sd, (maximum - mean) / sd
    with mp.workdps(25):

        def weighted(t):
            return evaluate_area(mean + sd * t)

        total = integrate_bell(low, high, weighted)
        plain = integrate_bell(low, high, lambda t: M(1))
        assert (
            compute_relative_error(statistics.compute_shape_attenuation(*shape), total / plain / 4)
            < RELATIVE
        )
        for i in (1, 100, 512, 900, statistics.N_TABLE_POINTS - 2):
            score = (M(float(table[i])) - mean) / sd
            gap = integrate_bell(low, score, weighted) / total - M(float(u[i]))
            slope = mp.exp(-score * score / 2) * weighted(score) / total / sd
            # A probability near 1 is rounded to EPS, which shifts the quantile.
            assert abs(gap / slope / table[i]) < RELATIVE + float(EPS / slope / table[i])


@pytest.mark.parametrize(
    "limits", [(0.2, 0.4, 0.3, 0.072), (0.0, 1.0, 0.5, 1.0), (0.0, 1.0, 0.0, 0.3), (0, 1, 1, 0.01)]
)
def test_truncated_normal(limits):
    minimum, maximum, mean, sd = (M(x) for x in limits)
    table = statistics.tabulate_truncated_normal(*map(float, limits))
    u = make_table_probabilities(statistics.N_TABLE_POINTS)
    low, high = (minimum - mean) / sd, (maximum - mean) / sd
    total = mp.ncdf(high) - mp.ncdf(low)
    for i in QUANTILES:
        score = (M(float(table[i])) - mean) / sd
        gap = (mp.ncdf(score) - mp.ncdf(low)) / total - M(float(u[i]))
        # Relative to the range, as facetness starts at 0.
        assert abs(gap * total * sd / mp.npdf(score)) < RELATIVE * (maximum - minimum)


@pytest.mark.parametrize("sd", [5e-324, 1e-308, 1e-20])
def test_negligible_deviation_gives_a_single_value(sd):
    limits = (0.6, 0.95, 0.8, sd)
    assert (
        compute_relative_error(
            statistics.compute_shape_attenuation(*limits), evaluate_area(M(0.8)) / 4
        )
        < RELATIVE
    )
    for table in (
        statistics.tabulate_truncated_normal(*limits),
        statistics.tabulate_hit_sphericities(*limits),
    ):
        assert (
            compute_relative_error(table[1], M(0.8)) < RELATIVE
            and compute_relative_error(table[-2], M(0.8)) < RELATIVE
        )
        assert table.min() >= 0.6 and table.max() <= 0.95


TEXTURES = [
    (0.0, 0.15, 0.85), (0.0, 0.0, 1.0), (0.1, 0.0, 0.9), (0.01, 0.135, 0.855), (0.0, 1e-3, 0.999),
    (1e-4 * (1 + 1e-9), 0.0, 1 - 1e-4 * (1 + 1e-9)),
]  # fmt: skip


@pytest.mark.parametrize("texture", TEXTURES, ids=str)
@pytest.mark.parametrize("tail", [1e-6, 1e-4, 0.01])
def test_soil_sizes(texture, tail):
    bounds = [min(max(b, tail), 1 - tail) for b in (tail, texture[0], sum(texture[:2]), 1 - tail)]
    for piece in make_size_distribution(texture, tail).separates:
        x0, x1, mean, sd = (
            mp.log(piece.min_size_m),
            mp.log(piece.max_size_m),
            M(piece.log_mean),
            M(piece.log_sd),
        )
        i = SEPARATE_LIMITS_M.index(piece.min_size_m)
        for x, bound in ((x0, bounds[i]), (x1, bounds[i + 1])):
            assert float(abs(mp.ncdf((x - mean) / sd) - M(bound))) < RELATIVE * max(bound, 1e-3)
        with mp.workdps(25):

            def shape(x, power, x0=x0, mean=mean, sd=sd):
                return mp.exp(-(((x - mean) / sd) ** 2) / 2 + power * (x - x0))

            def integral(end, power, x0=x0, shape=shape):
                return mp.quad(lambda y: shape(y, power), mp.linspace(x0, end, 12))

            inverse = integral(x1, -1)
            assert (
                compute_relative_error(
                    piece.mean_inverse_size_per_m, inverse / integral(x1, 0) / M(piece.min_size_m)
                )
                < RELATIVE
            )
            u = np.array([1e-6, 0.1, 0.5, 0.9, 1.0 - 1e-6])
            for p, size in zip(u, piece.compute_hit_sizes(u), strict=True):
                x = mp.log(M(float(size)))
                slope = shape(x, -1) / inverse
                gap = integral(x, -1) / inverse - M(float(p))
                assert abs(gap / slope) < RELATIVE + 4.0 * float(EPS / slope)


# --- materials --------------------------------------------------------------------------------

MIXTURES = [
    (1.54, 2.9 + 0.05j), (1.54, 1.54 + 1e-9j), (1.54 + 1e-6j, 1.54), (1.56 + 5e-4j, 2.3 + 0.01j),
    (2.9 + 1j, 1.5), (1.5, 0.3 + 3j), (1.54, 1.54 + 1e-9),
]  # fmt: skip


@pytest.mark.parametrize(("matrix", "inclusion"), MIXTURES, ids=str)
def test_maxwell_garnett_is_accurate_in_n_and_k(matrix, inclusion):
    for fraction in (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 0.5, 0.9, 1 - 1e-6, 1 - 1e-12, 1.0):
        outer, inner, f = mp.mpc(matrix) ** 2, mp.mpc(inclusion) ** 2, M(fraction)
        contrast, total = inner - outer, inner + 2 * outer
        exact = mp.sqrt(outer * (total + 2 * f * contrast) / (total - f * contrast))
        mixed = complex(maxwell_garnett(matrix, inclusion, fraction))
        assert compute_relative_error(mixed.real, exact.real) < RELATIVE
        if abs(exact.imag) > 1e-40:
            assert compute_relative_error(mixed.imag, exact.imag) < RELATIVE
        else:
            assert mixed.imag == 0.0


@pytest.mark.parametrize("below", [915.9, 0.9, 1e-6, 1e-10])
def test_porosity_is_accurate_up_to_solid_ice(below):
    ice = ice_density(-1.0)
    snow = splits.Snow(density_kg_m3=ice - below)
    assert (
        compute_relative_error(snow.porosity, (M(ice) - M(snow.density_kg_m3)) / M(ice)) < RELATIVE
    )
    distance = M(ice) / M(snow.density_kg_m3) / M(snow.attenuation_per_m)
    assert compute_relative_error(snow.mean_grain_distance_m, distance) < RELATIVE


# --- Fresnel ----------------------------------------------------------------------------------


def compute_exact_reflectance(n1, n2, k2, cos_i):
    m = mp.mpc(n2, k2) / M(n1)
    q = mp.sqrt(m * m - 1 + cos_i * cos_i)
    s = abs((cos_i - q) / (cos_i + q)) ** 2
    return (s + abs((m * m * cos_i - q) / (m * m * cos_i + q)) ** 2) / 2


COSINES = np.concatenate([np.logspace(-12, 0, 49), 1.0 - np.logspace(-15, -1, 29)])
INDICES = [
    (1.0, 1.31, 0.0), (1.31, 1.0, 0.0), (1.0, 1.31, 1e-12), (1.31, 1.0, 1e-12), (1.0, 1.0, 1.0),
    (1.0, 1.0, 3.0), (1.0, 1.31, 3.0), (1.0, 0.3, 3.0), (1.5, 1.31, 0.0), (1.0, 300.0, 0.0),
]  # fmt: skip
NEARLY_MATCHED = [
    (1.0, 1.0 + 1e-9, 0.0), (1.0, 1.0 - 1e-9, 0.0), (1.31, 1.31 * (1.0 + 1e-9), 0.0),
    (1.0, 1.0, 1e-12), (1.31, 1.31, 1e-9),
]  # fmt: skip


def check_reflectance(indices, cosines):
    for cos_i in map(float, cosines):
        exact = compute_exact_reflectance(*indices, M(cos_i))
        allowed = RELATIVE + 4.0 * compute_rounding_sensitivity(
            lambda c: compute_exact_reflectance(*indices, c), cos_i
        )
        assert compute_relative_error(fresnel(*indices, cos_i)[0], exact) < allowed, cos_i


@pytest.mark.parametrize("indices", [*INDICES, *NEARLY_MATCHED], ids=str)
def test_reflectance_from_normal_to_grazing(indices):
    check_reflectance(indices, COSINES)


@pytest.mark.parametrize(("n1", "n2"), [(1.31, 1.0), (1.5, 1.31), (300.0, 1.0)])
def test_reflectance_about_the_critical_angle(n1, n2):
    critical = math.sqrt((n1 - n2) * (n1 + n2)) / n1
    offsets = np.logspace(-15, -2, 27)
    cosines = critical * np.concatenate([1.0 + offsets, 1.0 - offsets])
    check_reflectance((n1, n2, 0.0), cosines[cosines <= 1.0])


def test_transmittance_at_grazing_incidence():
    # 1 − R = 2 cosθ (1 + n²)/√(n² − 1) to first order, above the resolution of R itself.
    n = 1.31
    for cos_i in np.logspace(-12, -8, 9):
        transmittance = 2.0 * cos_i * (1.0 + n * n) / math.sqrt(n * n - 1.0)
        assert 1.0 - fresnel(1.0, n, 0.0, cos_i)[0] == pytest.approx(
            transmittance, rel=1e-6, abs=4e-16
        )


# --- grains -----------------------------------------------------------------------------------


def draw_directions(rng):
    for _ in range(60):
        vectors = rng.normal(size=(3, 3))
        yield vectors / np.linalg.norm(vectors, axis=1)[:, np.newaxis]


def compute_exact_chord(q, d, w, flattening):
    """Return chord, exit point, and the amplification of rounding errors in units of EPS."""
    q, d, w = ([M(float(x)) for x in v] for v in (q, d, w))
    f = M(flattening)

    def dot(x, y, size=lambda v: v):
        return sum(size(a * b) for a, b in zip(x, y, strict=True))

    scaled = [a - f * dot(d, w) * b for a, b in zip(d, w, strict=True)]
    # The error of each component of the scaled direction is that of its largest term.
    sizes = [abs(a) + f * dot(d, w, abs) * abs(b) for a, b in zip(d, w, strict=True)]
    along, square = dot(q, scaled), dot(scaled, scaled)
    amplification = dot(q, sizes, abs) / abs(along) + 2 * dot(scaled, sizes, abs) / square
    chord = -2 * along / square
    return chord, [a + chord * b for a, b in zip(q, scaled, strict=True)], float(amplification)


@pytest.mark.parametrize("psi", [1.0, 1.0 - 1e-12, 0.8, 0.3, 0.1])
@pytest.mark.parametrize("grazing", [1.0, 1e-3, 1e-6, 1e-9])
def test_chord_is_accurate_for_grazing_rays(psi, grazing):
    flattening = 1.0 - psi * psi
    for w, s, t in draw_directions(np.random.default_rng(7)):
        # A point of the unit sphere, and a direction along the surface there.
        grain = Spheroid(Vector(*s), Vector(*w), flattening, 1.0)
        n = np.array(spheroid.compute_outward_normal(grain))
        tangent = np.cross(n, t)
        d = -grazing * n + math.sqrt(1.0 - grazing**2) * tangent / np.linalg.norm(tangent)
        exact, exact_exit, amplification = compute_exact_chord(s, d, w, flattening)
        value, exit_grain = spheroid.compute_chord(grain, Vector(*d))
        assert compute_relative_error(value, exact) < RELATIVE + 4.0 * EPS * amplification
        # This is negligible compared with the size of the grain.
        assert abs(value - float(exact)) < 1e-11 / (psi * psi)
        assert np.abs(np.array(exit_grain.q) - np.array(exact_exit, dtype=float)).max() < 1e-11


@pytest.mark.parametrize("facetness", [1e-12, 1e-8, 1e-6, 1e-3, 0.3, 1.0])
def test_tilt_of_a_facet(facetness):
    # |ξ| < 1 is the tilt, n·n' = 1 − |ξ|.
    d = Vector(0.6, 0.0, -0.8)
    smooth = surface.make_smooth_facet(d, Spheroid(UP, UP, 0.0, 1.0), 1.0)
    for ray in range(40):
        normal = sample_half_normal(start_random_stream(ray))
        tilt = 0.5 * facetness * normal
        if tilt >= 1.0:
            continue
        exact = mp.sqrt(M(tilt) * (2 - M(tilt)))
        variates = InteractionVariates(0.9, 0.5, 0.5, normal, Angle(0.6, 0.8))
        facet = surface.sample_microfacet(
            d, smooth, 0.5 * facetness, variates, False, UNWEIGHTED_FACETS
        )
        assert facet.tilt.cos == 1.0 - tilt
        assert compute_relative_error(0.6 * facet.tilt.sin, exact) < RELATIVE
