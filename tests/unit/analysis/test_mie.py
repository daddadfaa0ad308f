"""Scattering matrices of spheres by Mie theory: limits, sums over sizes, inputs."""

import os
import sys

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.analysis.theory.mie import COMPILATION_SWITCH, import_miepython
from splits.core.validation import InvalidValue
from splits.materials import ConstantIndex, make_refractive_index
from splits.media.particle_layer import ELEMENTS

NM = [500.0]
INDEX = 1.5 + 0.01j


def make_gauss_angles(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return angles (degrees) and weights of the mean over directions, exact for polynomials."""
    cosine, weight = np.polynomial.legendre.leggauss(order)
    return np.degrees(np.arccos(cosine[::-1])), 0.5 * weight[::-1]


@pytest.mark.parametrize("radius_um", [1e-3, 4e-3])
def test_small_spheres_scatter_as_dipoles(radius_um):
    ds = splits.compute_mie_matrix(NM, INDEX, radius_um=radius_um).squeeze("wavelength")
    size = 2e3 * np.pi * radius_um / NM[0]
    # The first correction of the dipole is of the order of the squared size parameter.
    tolerance = size**2
    mu = np.cos(np.radians(ds.angle_deg.values))
    expected = {
        "P11": 0.75 * (1.0 + mu**2), "P12": -0.75 * (1.0 - mu**2), "P33": 1.5 * mu,
        "P34": 0.0 * mu, "P22": 0.75 * (1.0 + mu**2), "P44": 1.5 * mu,
    }  # fmt: skip
    for name in ELEMENTS:
        np.testing.assert_allclose(ds[name], expected[name], rtol=0.0, atol=tolerance)
    polarizability = (INDEX**2 - 1.0) / (INDEX**2 + 2.0)
    scattering = 8.0 / 3.0 * size**4 * abs(polarizability) ** 2
    absorption = 4.0 * size * polarizability.imag
    assert float(ds.scattering_efficiency) == pytest.approx(scattering, rel=3.0 * tolerance)
    extinction = float(ds.extinction_efficiency)
    assert extinction == pytest.approx(scattering + absorption, rel=3.0 * tolerance)
    assert float(ds.single_scattering_albedo) == pytest.approx(scattering / extinction, rel=1e-2)
    assert abs(float(ds.asymmetry_parameter)) < tolerance


@pytest.mark.parametrize("size", [0.5, 5.0, 60.0])
def test_one_sphere_has_the_matrix_and_efficiencies_of_miepython(size):
    # Amplitudes squared are polynomials of about twice the order of the last term.
    angles, weight = make_gauss_angles(2 * int(size) + 30)
    radius = size * NM[0] / (2e3 * np.pi)
    ds = splits.compute_mie_matrix(NM, INDEX, radius_um=radius, angle_deg=angles).squeeze()
    mu = np.cos(np.radians(angles))
    miepython = import_miepython()
    extinction, scattering, _, asymmetry = miepython.efficiencies_mx(INDEX.conjugate(), size)
    assert float(ds.extinction_efficiency) == pytest.approx(extinction, rel=1e-12)
    assert float(ds.scattering_efficiency) == pytest.approx(scattering, rel=1e-12)
    # Its series ends where the sums are accurate to about 1e-6.
    assert weight @ ds.P11.values == pytest.approx(1.0, abs=1e-6)
    assert weight @ (ds.P11.values * mu) == pytest.approx(asymmetry, abs=1e-6)
    assert float(ds.asymmetry_parameter) == pytest.approx(asymmetry, abs=1e-12)
    matrix = 4.0 * np.pi * miepython.phase_matrix(INDEX.conjugate(), size, mu, norm="one")
    # Its V has the opposite sign.
    expected = matrix[0, 0], matrix[0, 1], matrix[2, 2], -matrix[2, 3], matrix[1, 1], matrix[3, 3]
    for name, element in zip(ELEMENTS, expected, strict=True):
        np.testing.assert_allclose(ds[name], element, rtol=0.0, atol=1e-6 * matrix[0, 0].max())


def test_sums_over_spheres_are_weighted_by_cross_sections():
    radius, number = np.array([0.2, 0.5]), np.array([10.0, 1.0])
    angles, weight = make_gauss_angles(60)
    both = splits.compute_mie_matrix(
        NM, INDEX, radius_um=radius, number_density=number, angle_deg=angles
    )
    single = [
        splits.compute_mie_matrix(NM, INDEX, radius_um=one, angle_deg=angles) for one in radius
    ]
    area = number * radius**2
    q_sca = np.array([one.scattering_efficiency.item() for one in single])
    q_ext = np.array([one.extinction_efficiency.item() for one in single])
    assert both.extinction_efficiency.item() == pytest.approx(area @ q_ext / area.sum())
    assert both.single_scattering_albedo.item() == pytest.approx(area @ q_sca / (area @ q_ext))
    share = area * q_sca / (area @ q_sca)
    for name in ELEMENTS:
        expected = sum(s * one[name] for s, one in zip(share, single, strict=True))
        xr.testing.assert_allclose(both[name], expected)
    assert weight @ both.P11.values[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("radius_um", "variance"), [(0.01, 0.1), (0.5, 0.05), (0.5, 0.4)])
def test_gamma_distribution_is_that_of_its_density(radius_um, variance):
    """Against a fine grid of given radii; absorption broadens the resonances of single radii."""
    ds = splits.compute_mie_matrix(NM, INDEX, radius_um, variance, tolerance=1e-4)
    radius = radius_um * np.linspace(0.0, 12.0 if variance > 0.2 else 4.0, 2001)
    radius = radius[radius >= 1e-4]
    exponent = (1.0 - 3.0 * variance) / variance
    number = (radius / radius_um) ** exponent * np.exp(-radius / (radius_um * variance))
    area = number * radius**2
    mean = area @ radius / area.sum()
    assert mean == pytest.approx(radius_um, rel=1e-4)
    assert area @ (radius / mean - 1.0) ** 2 / area.sum() == pytest.approx(variance, rel=1e-3)
    grid = splits.compute_mie_matrix(
        NM, INDEX, radius_um=radius, number_density=number, angle_deg=ds.angle_deg
    )
    for name in ("asymmetry_parameter", "extinction_efficiency"):
        assert ds[name].item() == pytest.approx(grid[name].item(), rel=3e-4)
    for name in ELEMENTS:
        assert (np.abs(ds[name] - grid[name]) / grid.P11).mean() < 3e-4


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_the_quadrature_reaches_its_tolerance(tolerance):
    angles = np.linspace(0.0, 180.0, 181)
    exact, ds = (
        splits.compute_mie_matrix(NM, INDEX, 2.0, 0.1, angle_deg=angles, tolerance=t)
        for t in (tolerance / 30.0, tolerance)
    )
    assert exact.radii > ds.radii
    assert ds.extinction_efficiency.item() == pytest.approx(
        exact.extinction_efficiency.item(), rel=tolerance
    )
    for name in ELEMENTS:
        assert (np.abs(ds[name] - exact[name]) / exact.P11).mean() < tolerance


def test_default_angles_resolve_the_peak():
    ds = splits.compute_mie_matrix(NM, 1.33, 20.0, 0.2, tolerance=0.1).squeeze("wavelength")
    cosine = np.cos(np.radians(ds.angle_deg.values[::-1]))
    density = 0.5 * ds.P11.values[::-1]
    assert np.trapezoid(density, cosine) == pytest.approx(1.0, abs=2e-3)
    forward = np.trapezoid(density * cosine, cosine)
    assert forward == pytest.approx(float(ds.asymmetry_parameter), abs=2e-3)


def test_a_particle_layer_accepts_the_matrix():
    ds = splits.compute_mie_matrix([500, 600], "water", 1.0, 0.1)
    layer = splits.ParticleLayer(scattering_matrix=ds.isel(wavelength=0), polarized=True)
    matrix = layer.scattering_matrix
    np.testing.assert_array_equal(matrix.angle_deg, ds.angle_deg)
    for name, column in zip(ELEMENTS, matrix.elements.T, strict=True):
        np.testing.assert_array_equal(column, ds[name][0])


# --- refractive indices ---------------------------------------------------------------------------

WATER = make_refractive_index("water")([500.0, 800.0])
EQUIVALENT_INDICES = {
    "name": "water",
    "object": make_refractive_index("water"),
    "list": WATER.tolist(),
    "array": WATER,
    "masked": np.ma.masked_array(WATER, [False, False]),
    "series": pd.Series(WATER[::-1], [800.0, 500.0]),
    "labelled": xr.DataArray(WATER[::-1], {"wavelength": [800.0, 500.0]}, "wavelength"),
    "table": {"wavelength_nm": [500.0, 800.0], "n": WATER.real, "k": WATER.imag},
}


@pytest.mark.parametrize("index", EQUIVALENT_INDICES.values(), ids=EQUIVALENT_INDICES)
def test_equivalent_indices_give_the_same_matrix(index):
    expected = splits.compute_mie_matrix([500, 800], WATER, radius_um=0.3)
    ds = splits.compute_mie_matrix([500, 800], index, radius_um=0.3)
    xr.testing.assert_allclose(ds, expected, rtol=1e-12)
    np.testing.assert_allclose(ds.attrs["refractive_index_imaginary"], WATER.imag, rtol=1e-12)


@pytest.mark.parametrize(
    "index", [1.5, "1.5", ConstantIndex(1.5), {"n": 1.5}, [1.5], np.array(1.5)]
)
def test_constant_indices_give_the_same_matrix(index):
    expected = splits.compute_mie_matrix(NM, 1.5 + 0.0j, radius_um=0.3)
    xr.testing.assert_equal(splits.compute_mie_matrix(NM, index, radius_um=0.3), expected)


# --- messages -------------------------------------------------------------------------------------

SIZES = {"effective_radius_um": 1.0, "effective_variance": 0.1}
MESSAGES = {
    "wavelength_nm = 0.5: must be in [200, 100000] nm": {"wavelength_nm": 0.5},
    "index = (-1+0j): must be n + kj": {"index": -1.0},
    "index = (1.5-0.1j): must be n + kj": {"index": 1.5 - 0.1j},
    "index = (1.5-0.1j): must be n + ik with n > 0": {"index": [1.5 - 0.1j]},
    "index = (1+0j): must be n + ik with n > 0 and k >= 0, and not 1": {"index": 1.0},
    "index = '2 numbers': must be one number, or 1": {"index": [1.5, 1.6]},
    "index = nan: must be finite numbers": {"index": [np.nan + 1j]},
    "index = 'watr': must be one of": {"index": "watr"},
    "index.n = 'x': must be a finite number": {"index": {"n": "x"}},
    "index = 'values at [600.0]'": {"index": pd.Series([1.5], [600.0])},
    "effective_radius_um = 0.0: must be in [0.0001, 100000] µm": {"effective_radius_um": 0.0},
    "effective_radius_um = None": {"effective_radius_um": None},
    "effective_variance = 0.5: must be in [0.001, 0.499]": {"effective_variance": 0.5},
    "effective_variance = None": {"effective_variance": None},
    "sizes = 'both': must be either": {"radius_um": 1.0},
    "sizes = 'none': must be either": dict.fromkeys(SIZES),
    "radius_um = -1.0: must be in": {**dict.fromkeys(SIZES), "radius_um": -1.0},
    "number_density = None: must be given": {**dict.fromkeys(SIZES), "radius_um": [1.0, 2.0]},
    "number_density = -1.0: must be": {
        **dict.fromkeys(SIZES), "radius_um": [1.0, 2.0], "number_density": [1.0, -1.0],
    },
    "number_density = [0.0, 0.0]: must be 2 numbers": {
        **dict.fromkeys(SIZES), "radius_um": [1.0, 2.0], "number_density": [0.0, 0.0],
    },
    "number_density = [1.0]: must be 2 numbers": {
        **dict.fromkeys(SIZES), "radius_um": [1.0, 2.0], "number_density": 1.0,
    },
    "size parameter = ": {"effective_radius_um": 1e4},
    "angle_deg = 181.0: must be in [0, 180] degrees": {"angle_deg": [181.0]},
    "angle_deg = [2.0, 1.0]: must be strictly increasing": {"angle_deg": [2.0, 1.0]},
    "tolerance = 0.0: must be in [1e-06, 0.1]": {"tolerance": 0.0},
}  # fmt: skip


@pytest.mark.parametrize("message", MESSAGES)
def test_bad_inputs_have_one_clear_message(message):
    arguments = {"wavelength_nm": NM, "index": 1.5, **SIZES} | MESSAGES[message]
    with pytest.raises(InvalidValue) as error:
        splits.compute_mie_matrix(**arguments)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


def test_an_unreached_tolerance_is_reported(monkeypatch):
    monkeypatch.setattr("splits.analysis.theory.mie.MAX_INTERVALS", 128)
    with pytest.raises(InvalidValue, match=r"^tolerance = 1e-06: must be .* 129 radii"):
        splits.compute_mie_matrix(NM, 1.33, 3.0, 0.1, tolerance=1e-6)


def test_the_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "miepython", None)
    with pytest.raises(
        ModuleNotFoundError, match=r"Mie theory needs .*'\.\[mie\]' in a copy of the repository"
    ):
        splits.compute_mie_matrix(NM, 1.33, radius_um=0.1)


def test_the_environment_is_unchanged():
    before = os.environ.get(COMPILATION_SWITCH)
    splits.compute_mie_matrix(NM, 1.33, radius_um=0.1)
    assert os.environ.get(COMPILATION_SWITCH) == before
