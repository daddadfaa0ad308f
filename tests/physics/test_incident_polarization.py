"""Polarized incident light, and errors of the degree of polarization."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, compare_results, judge_z, scale_sample_size
from scattering_matrices import make_matrix

import splits

REFERENCE = Path(__file__).with_name("reference")
STOKES = {"I": "", "Q": "_q", "U": "_u", "V": "_v"}
INCIDENT = {"I": (1, 0, 0, 0), "Q": (1, 1, 0, 0), "U": (1, 0, 1, 0), "V": (1, 0, 0, 1)}
"""Stokes vectors whose differences from the first are the columns of a reflection matrix."""
SNOW = splits.Snow(depth_m=0.01)
THIN_LAYER = splits.ParticleLayer(
    refractive_index=1.0, optical_thickness=0.1, single_scattering_albedo=1.0,
    phase_function="rayleigh", polarized=True,
)  # fmt: skip


def judge_polarization_errors(
    runs: list[xr.Dataset], significance: float, min_directions: int
) -> None:
    """Compare the scatter of independent runs with stated errors of degree and angle.

    Directions count where the degree exceeds its mean error by a factor, so that it has no bias.
    """
    degree, stderr, angle, angle_stderr = (
        np.stack([run[name].values.ravel() for run in runs])
        for name in ("brdf_dolp", "brdf_dolp_stderr", "brdf_aolp", "brdf_aolp_stderr")
    )
    significant = degree.mean(axis=0) > significance * stderr.mean(axis=0)
    assert significant.sum() >= min_directions
    middle = np.degrees(np.angle(np.exp(2j * np.radians(angle)).mean(axis=0))) / 2.0
    turn = (angle - middle + 90.0) % 180.0 - 90.0
    n_independent = (len(runs) - 1) * int(significant.sum())
    for label, deviation, error in (
        ("degree", degree - degree.mean(axis=0), stderr),
        ("angle", turn, angle_stderr),
    ):
        z = deviation / error * np.sqrt(len(runs) / (len(runs) - 1))
        judge_z(z[:, significant], f"{label} of polarization", independent=n_independent)


@NEEDS_JIT
@pytest.mark.parametrize("incidence", [30.0, 60.0, 80.0])
def test_a_smooth_surface_reflects_fresnels_fractions(incidence):
    """Light polarized along the plane of incidence has R_p, and perpendicular to it R_s."""
    glass = splits.ParticleLayer(
        optical_thickness=1.0, single_scattering_albedo=0.0, refractive_index=1.5,
        ground=0.0, polarized=True,
    )  # fmt: skip
    cos_i = np.cos(np.radians(incidence))
    cos_t = np.sqrt(1.0 - (1.0 - cos_i**2) / 1.5**2)
    r_p = ((1.5 * cos_i - cos_t) / (1.5 * cos_i + cos_t)) ** 2
    r_s = ((cos_i - 1.5 * cos_t) / (cos_i + 1.5 * cos_t)) ** 2
    expected = {
        (1, 1, 0, 0): r_p, (1, -1, 0, 0): r_s, (2, 1, 0, 0): 0.75 * r_p + 0.25 * r_s,
        (1, 0, 1, 0): 0.5 * (r_p + r_s), (1, 0, 0, -1): 0.5 * (r_p + r_s),
    }  # fmt: skip
    z = []
    for stokes, reflectance in expected.items():
        ds = splits.spectrophotometer(
            glass, [550.0], incidence, max_stderr=0.001, stokes=stokes, seed=2
        )
        z.append((ds.reflectance.item() - reflectance) / ds.reflectance_stderr.item())
    judge_z(z, f"Fresnel reflectance at {incidence:g} degrees")


@NEEDS_JIT
@pytest.mark.parametrize("light", [(1.0, 0.0, 0.0), (0.6, -0.8, 0.0), (0.0, 0.6, 0.8)])
def test_unpolarized_light_is_the_mean_of_opposite_polarizations(light):
    bins = {"estimator": "bins", "n_bins": (3, 8), "rays": scale_sample_size(100_000)}
    vectors = (1.0, *light), (1.0, *(-value for value in light)), True
    plus, minus, unpolarized = (
        splits.goniophotometer(SNOW, [1590.0], 60.0, seed=seed, stokes=stokes, **bins)
        for seed, stokes in enumerate(vectors)
    )
    z = []
    for name in (f"brdf{suffix}" for suffix in STOKES.values()):
        errors = [one[f"{name}_stderr"].values for one in (plus, minus, unpolarized)]
        stderr = np.sqrt(0.25 * errors[0] ** 2 + 0.25 * errors[1] ** 2 + errors[2] ** 2)
        mean = 0.5 * (plus[name] + minus[name])
        z.append(((mean - unpolarized[name]).values / stderr).ravel())
    judge_z(np.concatenate(z), f"mean of ±{light}")


@NEEDS_JIT
def test_reflectance_is_that_of_the_goniophotometer():
    wavelengths = [1030.0, 1590.0]
    bins = {"estimator": "bins", "n_bins": (3, 8), "rays": scale_sample_size(50_000)}
    z = []
    for stokes in (True, (1, 1, 0, 0)):
        one = splits.goniophotometer(SNOW, wavelengths, 70.0, stokes=stokes, **bins)
        two = splits.spectrophotometer(
            SNOW, wavelengths, 70.0, max_stderr=0.003, stokes=stokes, seed=2
        )
        z.append(compare_results(one, two, "reflectance", "transmittance"))
        assert one.attrs["incident_stokes"] == two.attrs["incident_stokes"]
    judge_z(np.concatenate(z), "spectrophotometer")


@NEEDS_JIT
def test_errors_of_the_degree_of_polarization_are_those_of_independent_runs():
    rays, n_runs = scale_sample_size(50_000), 40
    runs = [
        splits.goniophotometer(
            SNOW, [1590.0], 60.0, seed=seed, stokes=True, estimator="bins", n_bins=(3, 4), rays=rays
        )
        for seed in range(n_runs)
    ]
    # The bias is removed where the degree is well above its error.
    judge_polarization_errors(runs, 5.0, min_directions=3)


@NEEDS_JIT
def test_errors_of_sparse_bins_allow_for_unseen_polarized_light():
    """Most of the rays in a bin were depolarized by the bottom; few were scattered by particles."""
    layer = replace(THIN_LAYER, ground=0.5)
    counted = splits.goniophotometer(
        layer, [550.0], 60.0, rays=5000, estimator="bins", n_bins=(8, 24)
    ).squeeze("wavelength")  # fmt: skip
    expected = splits.goniophotometer(
        layer, [550.0], 60.0, rays=200_000, estimator="next_event", polar_deg=counted.polar_deg,
        azimuth_deg=counted.azimuth_deg,
    ).squeeze("wavelength")  # fmt: skip
    lit = (counted.brdf > 0.0).values
    assert (counted.brdf_dolp_stderr.values > 0.0)[lit].all()
    for name in ("brdf_q", "brdf_u"):
        z = ((counted[name] - expected[name]) / np.hypot(
            counted[f"{name}_stderr"], expected[f"{name}_stderr"]
        )).values[lit]  # fmt: skip
        judge_z(z, f"sparse bins, {name}", bound_added=True)


@NEEDS_JIT
def test_errors_hold_at_every_angle_of_polarization():
    """Depolarized and singly scattered rays: Q and U have the same noise at angles near 22.5°."""
    layer = replace(THIN_LAYER, ground=0.3)
    n_runs, rays = 60, scale_sample_size(150_000)
    runs = [
        splits.goniophotometer(
            layer, [550.0], 60.0, rays=rays, seed=seed, estimator="bins", n_bins=(3, 16)
        ).squeeze("wavelength")
        for seed in range(n_runs)
    ]  # fmt: skip
    judge_polarization_errors(runs, 8.0, min_directions=20)


@NEEDS_JIT
def test_rare_light_and_grounds_leave_no_gaps():
    """Very weak transmitted light, and a ground through which no light leaves."""
    wavelengths = [800.0, 1000.0, 1200.0, 1300.0, 1400.0, 1500.0, 2000.0]
    bins = {"stokes": True, "estimator": "bins", "n_bins": (6, 24), "rays": 3000}
    for snow in (splits.Snow(depth_m=0.02), splits.Snow(depth_m=0.005, ground=0.3)):
        ds = splits.goniophotometer(snow, wavelengths, 30.0, **bins)
        assert all(np.isfinite(variable).all() for variable in ds.data_vars.values())
        names = [name for name in ds.data_vars if name.startswith("btdf")]
        assert bool(names) == ("btdf" in ds)


def compute_reflection_matrix(
    layer: splits.ParticleLayer, angles: tuple[float, float], seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return a reflection matrix and its errors, shape (4, 4, azimuths).

    `angles` are those of incidence and of view.
    """
    incidence, polar = angles
    runs = [
        splits.goniophotometer(
            layer, [550.0], incidence, rays=scale_sample_size(40_000), seed=seed + number,
            polar_deg=[polar], azimuth_deg=[20.0, 70.0, 140.0], estimator="next_event",
            stokes=stokes,
        ).squeeze(("wavelength", "polar_deg"))
        for number, stokes in enumerate(INCIDENT.values())
    ]  # fmt: skip
    values, errors = (
        np.array(
            [[run[f"brdf{suffix}{kind}"].values for run in runs] for suffix in STOKES.values()]
        )
        for kind in ("", "_stderr")
    )
    # The other columns are differences from that of unpolarized light.
    values[:, 1:] -= values[:, :1]
    errors[:, 1:] = np.hypot(errors[:, 1:], errors[:, :1])
    return values, errors


@NEEDS_JIT
def test_reflection_matrix_is_reciprocal():
    """R(µ, µ0, φ) = D Rᵀ(µ0, µ, φ) D with D = diag(1, 1, 1, −1), all 16 elements.

    Hovenier (1969), J. Atmos. Sci. 26, 488, relations of reciprocity and of mirror symmetry.
    """
    layer = splits.ParticleLayer(
        refractive_index=1.33, optical_thickness=1.0, single_scattering_albedo=0.98,
        ground=None, polarized=True, scattering_matrix=make_matrix(0.9),
    )  # fmt: skip
    one, one_stderr = compute_reflection_matrix(layer, (25.0, 60.0), 1)
    two, two_stderr = compute_reflection_matrix(layer, (60.0, 25.0), 11)
    sign = np.array([1.0, 1.0, 1.0, -1.0])
    reverse = np.einsum("i,j,jia->ija", sign, sign, two)
    z = (one - reverse) / np.hypot(one_stderr, np.swapaxes(two_stderr, 0, 1))
    judge_z(z, "reciprocity of the reflection matrix")


@pytest.mark.long
@NEEDS_JIT
def test_reflection_matrix_of_a_semi_infinite_layer():
    """Reflection matrices of Mishchenko et al. (1999), of orders 0 and 1 at µ = µ0 = 0.5.

    Elements of I and Q from U and V have the factor −sin mφ (de Haan et al. 1987, Eq 73), and
    those of U and V from I and Q sin mφ.  Their azimuth increases in the other sense, which
    reverses both; the intercomparison of Emde et al. (2015) determines these signs independently.
    """
    expected = {
        0: [
            [1.054548, -0.005217, 0.0, 0.0],
            [-0.005217, 0.262763, 0.0, 0.0],
            [0.0, 0.0, 0.146687, 0.032284],
            [0.0, 0.0, -0.032284, 0.208790],
        ],
        1: [
            [0.039998, 0.007864, -0.014080, -0.000034],
            [0.007864, 0.045349, 0.035117, -0.019115],
            [-0.014080, 0.035117, 0.164078, -0.032249],
            [0.000034, 0.019115, 0.032249, 0.114666],
        ],
    }
    layer = splits.ParticleLayer(
        refractive_index=1.0, ground=None, polarized=True, optical_thickness=float("inf"),
        single_scattering_albedo=1.0, scattering_matrix=REFERENCE / "half_space_coefficients.csv",
    )  # fmt: skip
    # Azimuths on both sides: a Fourier coefficient has only coefficients of orders near 24 added.
    azimuth = np.arange(0.0, 360.0, 15.0)
    runs = {
        name: splits.goniophotometer(
            layer, [550.0], 60.0, rays=50_000, polar_deg=[60.0], azimuth_deg=azimuth,
            estimator="next_event", seed=seed, stokes=stokes,
        ).squeeze(("wavelength", "polar_deg"))
        for seed, (name, stokes) in enumerate(INCIDENT.items(), start=1)
    }  # fmt: skip
    z = []
    for order, matrix in expected.items():
        for column, run in enumerate(runs.values()):
            for row, suffix in enumerate(STOKES.values()):
                columns = {0, column}
                # Elements between I, Q and U, V are odd in azimuth, the others even.
                even = sum(matrix[row][k] for k in columns if (row < 2) == (k < 2))
                odd = sum(matrix[row][k] for k in columns if (row < 2) != (k < 2))
                for function, exact in ((np.cos, even), (np.sin, odd)):
                    weight = function(order * np.radians(azimuth)) / azimuth.size
                    value = np.pi * float((run[f"brdf{suffix}"] * weight).sum())
                    # Errors of directions are taken as fully correlated, which is a bound.
                    stderr = np.pi * float((run[f"brdf{suffix}_stderr"] * np.abs(weight)).sum())
                    if stderr > 0.0:
                        z.append((value - exact) / stderr)
    judge_z(np.array(z), "semi-infinite layer", bound_added=True)
