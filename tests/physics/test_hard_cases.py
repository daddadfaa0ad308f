"""Hard cases through the public interface: each finite, sound, and equal to its limit.

docs/theory/hard-cases.md lists them.  `tests/physics/test_hard_paths.py` has those below the
interface.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_z_bound, judge_z
from scipy import integrate

import splits
from splits.kernels.optics.fresnel import fresnel
from splits.kernels.vectorized.eligibility import MAX_INDEX
from splits.materials.library import _DATASET_LOADERS, load_dataset
from splits.simulation.arguments import WAVELENGTH_RANGE_NM

pytestmark = NEEDS_JIT

KERNELS = ["scalar", "vectorized"]
"""Kernels that must pass; the first is the float64 reference."""

SUM = 1e-12
"""Largest gap of a sum of shares from 1."""
MATCHED = 1.4
WAVELENGTHS = (400.0, 700.0, 1500.0)


def measure(medium, wavelength_nm=WAVELENGTHS, incidence_deg=0.0, stderr=0.03, seed=1, **settings):
    """Return a sound spectrum: finite, shares within 0…1 that add up to 1, with errors."""
    ds = splits.spectrophotometer(
        medium, wavelength_nm, incidence_deg, max_stderr=stderr, seed=seed, **settings
    )
    names = ("reflectance", "transmittance", "absorptance")
    shares, errors = (np.stack([ds[f"{name}{end}"] for name in names]) for end in ("", "_stderr"))
    assert np.isfinite(shares).all() and np.isfinite(errors).all()
    assert shares.min() >= -SUM and shares.max() <= 1.0 + SUM
    assert np.abs(shares.sum(axis=0) - 1.0).max() < SUM
    assert (errors >= 0.0).all() and errors.max() <= stderr
    return shares, errors


SMOOTH = (0.0, 0.0, 0.0, 0.0)
SPHERES = (1.0, 1.0, 1.0, 0.0)
GEOMETRIES = {
    "sphericity 1": {"sphericity": SPHERES},
    "sphericity 0.3": {"sphericity": (0.3, 0.3, 0.3, 0.0)},
    "sphericity 0.1": {"sphericity": (0.1, 0.1, 0.1, 0.0), "grain_size_um": (3e3, 7.5e3)},
    "a single sphericity, sd above 0": {"sphericity": (0.8, 0.8, 0.8, 0.1)},
    "a single sphericity, sd = 0": {"sphericity": (0.6, 0.95, 0.8, 0.0)},
    "one grain size": {"grain_size_um": (500.0, 500.0)},
    "sizes 1000 : 1": {"grain_size_um": (10.0, 1e4)},
    "facetness 0": {"facetness": SMOOTH},
    "facetness 1": {"facetness": (1.0, 1.0, 1.0, 0.0)},
    "facetness 0 to 1": {"facetness": (0.0, 1.0, 0.5, 1.0)},
    "depth 0.1 mm": {"depth_m": 1e-4, "grain_size_um": (20.0, 90.0)},
    "grains that barely fit": {"depth_m": 1e-4, "grain_size_um": (99.9, 99.9)},
    "depth 10 m": {"depth_m": 10.0, "grain_size_um": (3e3, 7.5e3)},
    "density 1": {"density_kg_m3": 1.0},
    "density 916": {"density_kg_m3": 916.0},
}
ANGLES = (0.0, 89.9)


def snow(geometry, saturation=0.05, **index):
    settings = {"saturation": saturation, **GEOMETRIES.get(geometry, {})}
    return splits.Snow(**settings, refractive_index=index)


@cache
def of_ice(geometry, incidence, kernel, seed):
    return measure(snow(geometry), incidence_deg=incidence, kernel=kernel, seed=seed)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_ice_is_sound_and_kernels_agree(geometry, kernel):
    z = []
    for incidence in ANGLES:
        shares, errors = of_ice(geometry, incidence, kernel, 11)
        # Another seed of the reference: the same test also holds its stated errors to account.
        other, other_errors = of_ice(geometry, incidence, KERNELS[0], 12)
        # One wavelength, two quantities: the rest is correlated with them.
        z.append((shares - other)[:2, 1] / np.hypot(errors, other_errors)[:2, 1])
    judge_z(z, f"{kernel}, {geometry}", independent=len(ANGLES))


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("saturation", [0.0, 1.0])
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_nothing_is_lost_where_nothing_absorbs(geometry, saturation, kernel):
    for incidence in ANGLES:
        shares, _ = measure(
            snow(geometry, saturation, ice=1.31, water=1.33), 500.0, incidence, 0.1, kernel=kernel
        )
        assert abs(shares[0] + shares[1] - 1.0) < SUM


STERNER = {0.0: 0.02, 89.9: 0.001}


def plate(depth, k, incidence):
    """Return R and T of a plane plate, index MATCHED, with incoherent multiple reflections."""
    r, _, cos_t = fresnel(1.0, MATCHED, 0.0, math.cos(math.radians(incidence)))
    passed = np.exp(-4.0 * math.pi * k / (np.array(WAVELENGTHS) * 1e-9) * depth / cos_t)
    series = (1.0 - r) ** 2 * passed / (1.0 - (r * passed) ** 2)
    return np.stack([r + series * r * passed, series])


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("incidence", ANGLES)
def test_matched_indices_leave_a_plain_plate(incidence, kernel):
    gaps, stated = [], []
    for seed, geometry in enumerate(GEOMETRIES):
        medium = snow(geometry, 1.0)
        k = 700e-9 / (4.0 * math.pi * medium.depth_m)
        matched = dict.fromkeys(("ice", "water"), complex(MATCHED, k))
        shares, errors = measure(
            snow(geometry, 1.0, **matched), WAVELENGTHS, incidence, STERNER[incidence], seed,
            kernel=kernel,
        )  # fmt: skip
        gaps.append((shares[:2] - plate(medium.depth_m, k, incidence))[:, 1])
        stated.append(errors[:2, 1])
    gaps, stated = np.array(gaps), np.array(stated)
    judge_z(gaps[:, 0] / stated[:, 0], f"{kernel}, reflectance at {incidence}")
    # Towards 90 degrees one ray in 20 000 gets through, hence only all of them together.
    if incidence == 0.0:
        judge_z(gaps[:, 1] / stated[:, 1], f"{kernel}, transmittance at {incidence}")
    together = gaps.sum(axis=0) / np.sqrt((stated**2).sum(axis=0))
    judge_z(together, f"{kernel}, all geometries at {incidence}", independent=1)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_grains_of_index_1_are_not_there(geometry, kernel):
    shares, _ = measure(snow(geometry, 0.0, ice=1.0), 500.0, 30.0, 0.1, kernel=kernel)
    assert shares[:, 0].tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("incidence", [0.0, 89.9])
def test_a_beam_goes_straight_through_grains_of_index_1(incidence, kernel):
    medium = splits.Snow(saturation=0.0, depth_m=0.01, refractive_index={"ice": 1.0})
    shares, _ = measure(medium, 500.0, incidence, 0.1, kernel=kernel)
    assert shares[:, 0].tolist() == [0.0, 1.0, 0.0]


READINGS = [
    {"overlap_with_boundary": "keep"},
    {"overlap_with_previous_segment": "keep"},
    {"overlap_with_boundary": "skip"},
    {"overlap_with_previous_segment": "skip"},
    {"overlap_with_boundary": "skip", "overlap_with_previous_segment": "skip"},
    {"entry_point": "projected"},
    {"facet_sampling": "unweighted"},
    {"facet_sampling": "any"},
    {"wrong_side_ray": "mirror"},
    {"boundary_fresnel": "no"},
]


def away_under(reading, kernel, error):
    """Return how far a kernel is from the reference in four runs of reflectance, transmittance."""
    # Clear and thick, where rays that lose their way at the top show; rough, wet and absorbing.
    z = []
    # Readings hardly differ: of the same seeds, so would not what is compared.
    first = 2 * READINGS.index(reading)
    for seed, settings in enumerate(
        (
            {"depth_m": 0.02, "saturation": 0.0, "refractive_index": {"ice": 1.31}},
            {"depth_m": 0.003, "saturation": 0.5, "facetness": (0.5, 1.0, 0.8, 0.1)},
        ),
        start=first,
    ):
        for incidence in (0.0, 75.0):
            medium = splits.Snow(**settings, interpretation=reading)
            (shares, errors), (other, other_errors) = (
                measure(medium, 1500.0, incidence, error, seed + 100 * n, kernel=k)
                for n, k in enumerate((kernel, KERNELS[0]))
            )
            z.append((shares - other)[:2, 0] / np.hypot(errors, other_errors)[:2, 0])
    return np.array(z)


@pytest.mark.parametrize("kernel", KERNELS[1:])
@pytest.mark.parametrize("error", [0.003, pytest.param(0.001, marks=pytest.mark.long)])
def test_kernels_agree_under_every_reading(kernel, error):
    """At 0.003 a share that is off by 0.025 under one reading is seen in 99 of 100 cases.

    A pair errs by 0.0042, one of eight comparisons of a reading may be off by 3.2 of these, and a
    share is found below its mean by more than 2.3 in one case of 100.  Off by 0.0035 under every
    reading it brings the rms of all to its upper limit.
    """
    found = []
    for reading in READINGS:
        z = away_under(reading, kernel, error)
        print(f"{kernel}, {reading}: {z.round(2).tolist()}")
        assert np.abs(z).max() <= compute_z_bound(z.size), reading
        found.append(z)
    # Reflectance and transmittance of a pair of runs share paths.
    judge_z(found, f"{kernel}, all readings", independent=4 * len(READINGS))


# --- incidence --------------------------------------------------------------------------------


MIRRORS = {
    "sphericity": SPHERES,
    "facetness": SMOOTH,
    "depth_m": 0.01,
    "refractive_index": {"ice": 1.31, "water": 1.33},
}


# Transmittance at 89.99 degrees by 180 000 rays of either kernel, and its error.
GRAZING = 0.0331, math.sqrt(0.0331 * (1.0 - 0.0331) / 360_000)


def passed_at(medium, incidence, **settings):
    """Return transmittance and its standard error."""
    shares, errors = measure(medium, 500.0, incidence, **settings)
    return shares[1, 0], errors[1, 0]


@pytest.mark.parametrize("kernel", KERNELS)
def test_smooth_spheres_become_a_mirror_towards_90_degrees(kernel):
    # Only grains below the boundary are met, so a ray that skims it meets their tops, grazing.
    medium = splits.Snow(**MIRRORS, saturation=0.0)
    passed = [passed_at(medium, a, stderr=0.002, kernel=kernel) for a in (60, 89, 89.99)]
    assert passed[0][0] > passed[1][0] + 0.05 > passed[2][0] + 0.1
    value, error = passed[2]
    judge_z([(value - GRAZING[0]) / math.hypot(error, GRAZING[1])], f"{kernel}, grazing")


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("incidence", [89.9, 89.99])
def test_water_reflects_its_fresnel_share_near_90_degrees(incidence, kernel):
    mu = math.cos(math.radians(incidence))
    shares, errors = measure(snow("", 1.0), 500.0, incidence, 0.002, kernel=kernel)
    at_least = fresnel(1.0, complex(snow("").refractive_index["water"](500.0)).real, 0.0, mu)[0]
    assert at_least - 4.0 * errors[0, 0] < shares[0, 0] <= 1.0
    assert shares[1, 0] < 1.0 - at_least + 4.0 * errors[1, 0]


@pytest.mark.parametrize("saturation", [0.0, 1.0])
def test_incidence_of_89_9999_degrees(saturation, kernel="auto"):
    # Smooth spheres, and water's surface, let less through than at 89.99 degrees.
    # With an error of 0.007 twice as much is seen in 98 of 100 cases.
    medium = splits.Snow(**MIRRORS, saturation=saturation)
    value, error = passed_at(medium, 89.9999, stderr=0.007, kernel=kernel)
    assert value < GRAZING[0] + compute_z_bound(1) * math.hypot(error, GRAZING[1])


# --- extinction -------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", KERNELS)
def test_k_of_1e_12_absorbs_its_share_of_a_straight_path(kernel):
    # Where n = 1 the path in ice is at most the way through the slab, here 0.12 m long.
    shares, _ = measure(snow("", 0.0, ice=1.0 + 1e-12j), 500.0, kernel=kernel)
    assert shares[0, 0] < 1e-20
    assert 0.0 < shares[2, 0] < 4.0 * math.pi * 1e-12 / 500e-9 * 0.12
    # Paths do not feel such a k: by the same numbers, the same spectrum up to this absorption.
    with_k, without = (
        measure(snow("", 0.0, ice=1.31 + k), 500.0, kernel=kernel)[0] for k in (1e-12j, 0.0)
    )
    assert 0.0 < with_k[2, 0] < 1e-4
    assert np.abs(with_k - without).max() < 1e-4


def fresnel_share(index):
    """Return the mean reflectance of a smooth sphere struck by projected area."""
    return integrate.quad(
        lambda mu: 2.0 * mu * fresnel(1.0, index.real, index.imag, mu)[0], 1e-12, 1.0
    )[0]


@pytest.mark.parametrize("kernel", KERNELS)
def test_opaque_grains_absorb_what_fresnel_lets_in(kernel):
    # So few that one ray hardly ever meets two: A = (1 − exp(−depth/distance)) (1 − <R>).
    z = []
    for seed, index in enumerate((1.0 + 1.0j, 1.0 + 3.0j, 1.31 + 1.0j, 1.31 + 3.0j)):
        medium = splits.Snow(
            density_kg_m3=0.1, depth_m=0.002, saturation=0.0, sphericity=SPHERES, facetness=SMOOTH,
            refractive_index={"ice": index},
            interpretation={"entry_point": "projected", "overlap_with_boundary": "keep"},
        )  # fmt: skip
        shares, errors = measure(medium, 500.0, 0.0, 3e-5, seed, kernel=kernel)
        hit = -math.expm1(-medium.depth_m / medium.mean_grain_distance_m)
        z.append((shares[2, 0] - hit * (1.0 - fresnel_share(index))) / errors[2, 0])
    judge_z(z, "opaque spheres")


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("k", [1.0, 3.0])
def test_opaque_grains_let_nothing_through(k, kernel):
    for geometry in ("", "sphericity 0.3", "facetness 1"):
        shares, errors = measure(snow(geometry, 0.0, ice=1.0 + 1j * k), 500.0, kernel=kernel)
        assert shares[1, 0] < 3.0 * errors[1, 0]


def most_absorbed(index):
    """Return a bound on what grains absorb that are mirrors, all together.

    Where a reflection absorbs the part a, isotropic scattering in a half-infinite medium absorbs
    H(1) √a ≤ 2.908 √a of light from the zenith (Chandrasekhar 1960), scattering of asymmetry g up
    to the factor 1/√(1 − g); mirrors throw light all around, g < 1/2.
    """
    return 2.908 * math.sqrt(2.0 * (1.0 - fresnel_share(index)))


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("k", [1e3, 1e7])
def test_mirrors_absorb_hardly_anything(k, kernel):
    if k > MAX_INDEX:
        # Single precision has no room for such powers of it; "auto" takes the scalar kernel.
        kernel = "auto"
    for geometry in ("", "sphericity 0.3", "facetness 1"):
        index = 1.0 + 1j * k
        shares, errors = measure(snow(geometry, 0.0, ice=index), 500.0, 0.0, 0.01, kernel=kernel)
        assert shares[2, 0] <= most_absorbed(index) + compute_z_bound(1) * errors[2, 0]


def test_a_perfect_conductor():
    conductor = snow("", 0.0, ice=1.0 + 1e9j)
    shares, _ = measure(conductor, 500.0, kernel="auto")
    assert shares[2, 0] == 0.0
    with pytest.raises(ValueError, match="kernel = 'vectorized'"):
        measure(conductor, 500.0, kernel="vectorized")


# --- indices ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("water", [1.5, 2.5])
def test_pores_denser_than_grains_keep_energy(water, kernel):
    for geometry in ("sphericity 1", "sphericity 0.3", "facetness 1"):
        shares, _ = measure(
            snow(geometry, 1.0, ice=1.31, water=water), 500.0, 30.0, 0.01, kernel=kernel
        )
        assert abs(shares[0] + shares[1] - 1.0) < SUM
        # Bubbles scatter: neither clear nor a mirror.
        assert 0.3 < shares[0, 0] < 1.0


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("saturation", [0.0, 1.0])
@pytest.mark.parametrize("water", [1.33, 2.5])
def test_sand_dry_and_full_of_a_light_or_heavy_liquid(saturation, water, kernel):
    clear = dict.fromkeys(("quartz", "kaolinite", "hematite", "goethite"), 1.54)
    medium = splits.Sand(
        saturation=saturation, depth_m=0.01, sphericity=(0.3, 1.0, 0.8, 1.0), roundness=(0.5, 1.0),
        refractive_index={**clear, "water": water},
    )  # fmt: skip
    shares, _ = measure(medium, 700.0, 45.0, 0.05, kernel=kernel)
    assert abs(shares[0] + shares[1] - 1.0) < SUM
    coloured = splits.Sand(saturation=saturation, depth_m=0.01, refractive_index={"water": water})
    shares, _ = measure(coloured, (400.0, 700.0), 45.0, 0.03, kernel=kernel)
    assert shares[2].min() > 0.0 and shares[0, 1] > shares[0, 0]


# --- wavelengths ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("material", "name"), [(m, name) for m, known in _DATASET_LOADERS.items() for name in known]
)
def test_tables_reach_their_very_edges(material, name):
    index = load_dataset(material, name)
    table = getattr(index, "wavelength_nm", None)
    edges = getattr(index, "range_nm", None) if table is None else table[[0, -1]]
    if edges is None:
        edges = WAVELENGTH_RANGE_NM
    else:
        for edge, outwards in zip(edges, (0.0, np.inf), strict=True):
            # What rounding has taken beyond an edge is the edge, and no more than that.
            assert index([np.nextafter(edge, outwards)]) == index([edge])
            beyond = edge * (1.0 - 1e-8 if outwards == 0.0 else 1.0 + 1e-8)
            with pytest.raises(ValueError, match="wavelength_nm"):
                index([beyond])
    # As a user writes it: the printed number must not lie a rounding outside.
    at = index([float(f"{edge:.10g}") for edge in edges])
    assert np.isfinite(at).all() and (at.real > 0.0).all() and (at.imag >= 0.0).all()
    if table is not None:
        assert index(edges) == pytest.approx((index.n + 1j * index.k)[[0, -1]], rel=1e-13)


@pytest.mark.parametrize("kernel", KERNELS)
def test_spectra_reach_the_edges_of_their_tables(kernel):
    low, high = WAVELENGTH_RANGE_NM
    measure(snow(""), (low, high), kernel=kernel)
    measure(snow("", ice="warren_brandt_2008_picard_2016"), (320.0, high), kernel=kernel)
    # From goethite's first wavelength to the last of quartz.
    measure(splits.Sand(depth_m=0.01), (300.0, 2050.5), 0.0, 0.05, kernel=kernel)
