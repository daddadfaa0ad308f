"""Mie scattering by spheres against published matrices, and by large spheres against rays."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from scattering_matrices import compute_sphere_matrix
from scipy import special

import splits

REFERENCE = Path(__file__).with_name("reference")
ELEMENTS = ("P11", "P12", "P33", "P34")
NM = 500.0
VARIANCE = 0.1
SIZES = (250.0, 500.0, 1000.0)
ABSORBING = 1.5 + 0.5j
FORWARD = np.arange(15.0, 44.5, 1.0)
"""Angles (degrees) of reflected light and light refracted twice, at some distance from the peak of
diffraction and from the largest angle of refraction: 80.5° for the index 1.31, 96.4° for 1.5."""
SIDE = np.arange(40.0, 179.5, 1.0)
"""Angles (degrees) where the light that bends around the edges is exponentially small: they exceed
x^(−1/3) radians (Nussenzveig 1992, Diffraction Effects in Semiclassical Scattering)."""
BIN = 5
"""Number of angles over which matrices are averaged, since quadratures over sizes scatter."""
CASES = pytest.mark.parametrize(
    ("index", "angles"),
    [(1.31 + 0.0j, FORWARD), (1.5 + 0.0j, FORWARD), (ABSORBING, SIDE)],
    ids=["ice", "glass", "opaque"],
)


# --- published matrices ---------------------------------------------------------------------------


def compare_with_table(name: str, wavelength_nm: float, index: complex, **sizes) -> tuple:
    """Return differences from a table divided by its P11, shape (4, angles), and the dataset.

    The tables of Emde et al. (2015) have V of the opposite sign, and so P34.
    """
    table = pd.read_csv(REFERENCE / name, comment="#")
    ds = splits.compute_mie_matrix(
        [wavelength_nm], index, angle_deg=table.angle_deg, **sizes
    ).squeeze("wavelength")
    signs = {"P34": -1.0}
    expected = np.array([signs.get(element, 1.0) * table[element] for element in ELEMENTS])
    found = np.array([ds[element] for element in ELEMENTS])
    return (found - expected) / expected[0], ds


def test_matrix_of_published_aerosol_spheres():
    """Case A3: the published table does not name the spheres.

    The median radius, width and largest radius of their log-normal distribution and the index were
    fitted to P11 only, which leaves P12, P33 and P34 as predictions.  Combinations of the five
    numbers that change P11 by as much as its rounding change the others by up to 3e-4.
    """
    median_um, width, largest_um = 0.0271007, 2.210382, 0.1290408
    log_radius = np.linspace(np.log(0.005), np.log(largest_um), 400)
    number = np.exp(-0.5 * ((log_radius - np.log(median_um)) / np.log(width)) ** 2)
    number[-1] *= 0.5
    difference, ds = compare_with_table(
        "iprt_a3_spheres.csv", 350.0, 1.42202 + 0.002572j,
        radius_um=np.exp(log_radius), number_density=number,
    )  # fmt: skip
    largest = np.abs(difference).max(axis=1)
    print("A3, largest differences of elements, divided by P11:", largest)
    assert largest[0] < 1e-5
    assert (largest[1:] < 5e-4).all()
    # P11 determines k only to a few per cent.
    assert float(ds.single_scattering_albedo) == pytest.approx(0.97568, abs=1e-3)


def test_matrix_of_published_cloud_droplets():
    """Case A5: effective radius 10 µm, and the effective variance 0.1 of libRadtran's clouds.

    The real part of the index was fitted to P11 only, the imaginary part to the albedo.  Single
    angles deviate by the errors of both quadratures over sizes from narrow resonances.
    """
    difference, ds = compare_with_table(
        "iprt_a5_cloud.csv", 800.0, 1.3259 + 1.3e-7j, effective_radius_um=10.0,
        effective_variance=0.1, tolerance=1e-3,
    )  # fmt: skip
    mean = np.abs(difference).mean(axis=1)
    print("A5, mean differences of elements, divided by P11:", mean)
    assert (mean < 2e-3).all()
    assert float(ds.single_scattering_albedo) == pytest.approx(0.999979, abs=2e-6)
    assert float(ds.P11[0]) == pytest.approx(3557.28, rel=2e-4)


# --- large spheres --------------------------------------------------------------------------------


@cache
def compute_large(index: complex, size: float) -> xr.Dataset:
    """Return the matrix of spheres of a mean size parameter, at the angles of `CASES`."""
    radius_um = size * NM / (2e3 * np.pi)
    angles = SIDE if index == ABSORBING else FORWARD
    ds = splits.compute_mie_matrix(
        [NM], index, radius_um, VARIANCE, angle_deg=angles, tolerance=1e-3
    )
    return ds.squeeze("wavelength")


def average_over_sizes(function, size: float) -> np.ndarray:
    """Return a mean over the projected area of the gamma distribution of sizes."""
    shape = 1.0 / VARIANCE
    relative = np.linspace(0.0, 4.0, 8001)[1:]
    weight = relative ** (shape - 1.0) * np.exp(-shape * relative)
    return weight @ function(size * relative[:, np.newaxis]) / weight.sum()


def diffract(size: float) -> np.ndarray:
    """Return P11 of Fraunhofer diffraction by discs at `FORWARD`, times its efficiency of 1."""
    sine = np.sin(np.radians(FORWARD))
    return average_over_sizes(lambda x: (2.0 * special.j1(x * sine) / sine) ** 2, size)


def average_angles(matrix: np.ndarray) -> np.ndarray:
    """Return means over groups of `BIN` angles, along the last axis."""
    return matrix.reshape(len(matrix), -1, BIN).mean(axis=-1)


def remove_diffraction(index: complex, size: float) -> np.ndarray:
    """Return P11, P12, P33 and P34 per projected area without diffraction, shape (4, angles)."""
    ds = compute_large(index, size)
    matrix = np.array([ds[name] for name in ELEMENTS]) * float(ds.scattering_efficiency)
    if index != ABSORBING:
        # Diffraction does not change the polarization.
        matrix[[0, 2]] -= diffract(size)
    return matrix


def reflect(index: complex, angle_deg: np.ndarray) -> np.ndarray:
    """Return the matrix of light that opaque spheres reflect, by Fresnel's equations."""
    incidence = np.radians(90.0 - 0.5 * angle_deg)
    outside, inside = np.cos(incidence), np.sqrt(1.0 - (np.sin(incidence) / index) ** 2)
    s = (outside - index * inside) / (outside + index * inside)
    p = (index * outside - inside) / (index * outside + inside)
    square_s, square_p, product = np.abs(s) ** 2, np.abs(p) ** 2, p * s.conj()
    return np.array(
        [0.5 * (square_p + square_s), 0.5 * (square_p - square_s), product.real, product.imag]
    )


def compute_geometric_matrix(index: complex, angle_deg: np.ndarray) -> np.ndarray:
    """Return P11, P12, P33 and P34 of geometric optics per projected area, shape (4, angles)."""
    if index == ABSORBING:
        return reflect(index, angle_deg)
    fine = np.arange(0.0, 180.25, 0.5)
    matrix = compute_sphere_matrix(index.real, fine)[: len(ELEMENTS)]
    return matrix[:, np.searchsorted(fine, angle_deg)]


@CASES
def test_deviations_from_geometric_optics_are_inverse_to_the_size(index, angles):
    """The first correction of a reflected or refracted ray is of the relative order 1/x.

    It is that of the Luneburg-Kline series in the inverse wave number; its coefficient contains the
    curvatures of the wave front, of the order of the inverse radius (Nussenzveig 1992).
    Interference between rays vanishes in the mean over sizes.  Diffraction at these angles is of
    the same order.  The quadrature over sizes scatters by up to 1e-3, a third of the deviation of
    the largest spheres, so that the order of the whole range is judged: 1 ± 0.35.
    """
    geometric = compute_geometric_matrix(index, angles)
    deviations = [
        average_angles((remove_diffraction(index, size) - geometric) / geometric[0])
        for size in SIZES
    ]
    rms = np.sqrt(np.mean(np.square(deviations), axis=-1))
    print(f"index {index}, sizes {SIZES}, root mean squares of P11, P12, P33, P34 over P11:")
    print(rms)
    total = np.sqrt((rms**2).sum(axis=1))
    order = np.log(total[0] / total[-1]) / np.log(SIZES[-1] / SIZES[0])
    print("all:", total, "times size:", total * SIZES, "order:", order)
    assert (np.diff(total) < 0.0).all()
    assert 0.65 < order < 1.35
    # Coefficients of the order of 1, of four elements.
    assert (total * SIZES < 5.0).all()


@NEEDS_JIT
@CASES
def test_large_spheres_scatter_as_traced_rays(index, angles):
    """Matrices of traced grains, within five of their errors and 10/x, see the test above."""
    spheres = splits.Snow(
        facetness=(0.0,) * 4, sphericity=(1.0, 1.0, 1.0, 0.0), saturation=0.0,
        density_kg_m3=1.0, interpretation={"entry_point": "projected"},
        refractive_index={"ice": index},
    )  # fmt: skip
    traced = splits.single_scattering(spheres, [NM], moments=2, rays=400_000, stokes=True)
    traced = traced.squeeze("wavelength").sel(angle_deg=angles)
    albedo = float(traced.single_scattering_albedo)
    found = average_angles(remove_diffraction(index, SIZES[-1]))
    matrix, error = (
        albedo * average_angles(np.array([traced[f"{name}{suffix}"] for name in ELEMENTS]))
        for suffix in ("", "_stderr")
    )
    allowance = 10.0 / SIZES[-1] * found[0]
    print(
        f"index {index}, largest difference over P11:",
        np.abs((found - matrix) / found[0]).max(axis=1),
    )
    print("largest error over P11:", (error / found[0]).max(axis=1))
    assert (np.abs(found - matrix) < 5.0 * error + allowance).all()
    if index == ABSORBING:
        # The phase of reflected light, and so the sign of P34, is that of the traced grains.
        assert (found[3] / found[0]).min() < -0.4
        assert (matrix[3] / matrix[0]).min() < -0.4


@pytest.mark.parametrize("index", [1.31, 1.5])
def test_extinction_of_large_spheres_approaches_twice_the_area(index):
    """Q_ext = 2 + 1.99239 x^(−2/3) + O(1/x) (Nussenzveig & Wiscombe 1980, Phys. Rev. Lett. 45)."""
    for size in SIZES:
        edge = average_over_sizes(lambda x: 1.9923861 * x ** (-2.0 / 3.0), size)[0]
        found = float(compute_large(complex(index), size).extinction_efficiency)
        print(f"index {index}, size {size}: {found:.6f}, expected {2.0 + edge:.6f}")
        assert found == pytest.approx(2.0 + edge, abs=1.0 / size)
