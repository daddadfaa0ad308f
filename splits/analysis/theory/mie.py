"""Scattering matrices of spheres of a size distribution, by Mie theory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.theory.phase_function import ALBEDO, ASYMMETRY, choose_resolving_angles
from splits.analysis.theory.sphere_sizes import GammaSizes, GivenSizes
from splits.analysis.theory.sphere_sums import AngularFunctions, SphereSums, import_miepython
from splits.core.arrays import (
    as_1d_array,
    check_array_range,
    check_increasing,
    find_labels,
    match_labels,
)
from splits.core.keywords import reject_unknown_arguments
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import InvalidValue, check_range, invalid
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.materials import make_refractive_index, parse_refractive_index
from splits.materials.library import MATERIALS
from splits.media.particle_layer import ANGLE, ELEMENTS
from splits.simulation.run_options import check_wavelengths, make_wavelength_coordinate

MATERIAL = "spheres"
"""Name of the material in messages on its refractive index."""
MAX_SIZE_PARAMETER = 1e4
MIN_CONTRAST = 1e-6
"""Smallest difference of a relative refractive index from 1."""
SIZE_ARGUMENTS = "effective_radius_um, effective_variance", "radius_um, number_density"
MEANS = {
    ALBEDO: "single-scattering albedo",
    ASYMMETRY: "asymmetry parameter",
    "extinction_efficiency": "extinction cross-section per projected area",
    "scattering_efficiency": "scattering cross-section per projected area",
}
"""Names of the variables over wavelength, and their labels."""


@reject_unknown_arguments
def compute_mie_matrix(
    wavelength_nm: Any,
    index: Any,
    effective_radius_um: float | None = None,
    effective_variance: float | None = None,
    *,
    radius_um: Any = None,
    number_density: Any = None,
    angle_deg: Any = None,
    tolerance: float = 3e-3,
) -> xr.Dataset:
    """Compute the scattering matrix of homogeneous spheres by Mie theory.

    Diffraction is included.  The package miepython computes the series, see the extra ``mie``.

    Parameters
    ----------
    wavelength_nm : array_like, shape (wavelengths,)
        Strictly increasing vacuum wavelengths (nm), 200 to 100 000.
    index : complex, array_like, str, mapping, path or RefractiveIndex
        Refractive index n + ik of the spheres relative to the medium around them, n > 0, k ≥ 0 and
        not 1: a number; a number for each wavelength; the name of a material, such as "water"; or
        another input of `splits.materials.parse_refractive_index`.
    effective_radius_um, effective_variance : float, optional
        Effective radius a (µm, 1e-4 to 1e5) and effective variance b (0.001 to 0.499) of the gamma
        distribution n(r) ∝ r^((1 − 3b)/b) exp(−r/(ab)) of Hansen & Travis (1974), Eq 2.56.
    radius_um, number_density : array_like, shape (radii,), optional
        Instead of the above: radii (µm, 1e-4 to 1e5) and the number of spheres of each, in any
        unit.  For a continuous distribution, it includes the weights of the quadrature.
    angle_deg : array_like, shape (angles,), optional
        Strictly increasing scattering angles, 0 to 180 degrees; by default enough to resolve the
        peak of diffraction by the largest spheres.
    tolerance : float
        Accuracy of the quadrature over the gamma distribution, 1e-6 to 0.1, see the notes.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength``: ``single_scattering_albedo``, ``asymmetry_parameter``,
        ``extinction_efficiency`` and ``scattering_efficiency``, the cross-sections of all spheres
        divided by their projected area.  Over ``wavelength`` and ``angle_deg`` (degrees), the
        elements of the scattering matrix ``P11``, ``P12``, ``P33``, ``P34``, ``P22`` and ``P44``
        as `splits.single_scattering` has them: the mean of ``P11`` over all directions is 1.  The
        dataset at one wavelength is a `scattering_matrix` of `splits.ParticleLayer`.  The attribute
        ``radii`` is the number of radii at each wavelength.

    Raises
    ------
    ValueError
        For a value outside its range, a size parameter above `MAX_SIZE_PARAMETER`, or a quadrature
        that does not reach the tolerance.
    ModuleNotFoundError
        Without the package miepython.

    Notes
    -----
    The size parameter is 2π radius/wavelength, as in air or vacuum.  Radii multiplied by the index
    of another medium around the spheres give the size parameters in that medium.

    The number of radii is doubled until the efficiencies and the asymmetry parameter, and the
    elements of the matrix divided by P11, averaged over the angles, change by at most `tolerance`.
    Single angles deviate more, because spheres of some radii have narrow resonances.

    Numba compiles the functions of miepython when they are first used, which takes about 15 s once,
    unless the environment variable ``MIEPYTHON_USE_JIT`` is 0.

    P34 has the sign of `docs/theory/polarization.md` and of the matrices of grains, Im(S2 S1*) with
    the amplitudes of Bohren & Huffman (1983).  It is the opposite for authors whose V is positive
    for the other handedness, such as Emde et al. (2015) and libRadtran.

    References
    ----------
    Bohren & Huffman (1983), Absorption and Scattering of Light by Small Particles, chapter 4.
    Hansen & Travis (1974), Space Sci. Rev. 16, 527.

    Examples
    --------
    >>> droplets = splits.compute_mie_matrix([800], "water", 10.0, 0.1)
    >>> layer = splits.ParticleLayer(scattering_matrix=droplets.isel(wavelength=0))
    """
    wavelengths = check_wavelengths(wavelength_nm)
    indices = _read_index(index, wavelengths, find_labels(wavelength_nm))
    tolerance = check_range("tolerance", tolerance, 1e-6, 0.1)
    by_moments = (effective_radius_um, effective_variance) != (None, None)
    if by_moments == (radius_um is not None or number_density is not None):
        given = "both" if by_moments else "none"
        raise invalid("sizes", given, f"either {' or '.join(SIZE_ARGUMENTS)}")
    sizes = (
        GammaSizes.from_input(effective_radius_um, effective_variance, tolerance)
        if by_moments
        else GivenSizes.from_input(radius_um, number_density)
    )
    size_per_um = 2.0 * np.pi * 1e3 / wavelengths
    max_size = float(size_per_um[0] * sizes.largest_um)
    if max_size > MAX_SIZE_PARAMETER:
        allowed = f"at most {MAX_SIZE_PARAMETER:g} for the largest sphere"
        raise invalid("size parameter", max_size, allowed, "geometric optics is for larger spheres")
    angles = _read_angles(angle_deg, max_size)
    functions = AngularFunctions(angles, max_size)
    sums, radii = zip(
        *(
            sizes.sum_spheres(complex(one), float(factor), functions)
            for one, factor in zip(indices, size_per_um, strict=True)
        ),
        strict=True,
    )
    attributes = {
        "title": "Scattering matrix: spheres",
        "method": f"Mie theory, miepython {import_miepython().__version__}",
        "diffraction": "included",
        "refractive_index_real": indices.real,
        "refractive_index_imaginary": indices.imag,
        **sizes.describe(),
        "radii": radii,
        **make_provenance("compute_mie_matrix"),
    }
    return _make_dataset(wavelengths, angles, sums).assign_attrs(to_netcdf_attributes(attributes))


def _read_index(index: Any, wavelengths: np.ndarray, labels: pd.Index | None) -> np.ndarray:
    """Return the refractive index at each wavelength; `labels` are those of the wavelengths."""
    if isinstance(index, str) and index in MATERIALS:
        values = make_refractive_index(index)(wavelengths)
    elif isinstance(index, list | tuple) or np.ndim(index):
        values = _read_index_array(index)
        values = values[match_labels("index", find_labels(index), [wavelengths, labels])]
    else:
        try:
            values = parse_refractive_index(MATERIAL, index, MATERIALS)(wavelengths)
        except InvalidValue as error:
            if not error.key.startswith("refractive_index"):
                raise
            key = f"index{error.key.partition(']')[2]}"
            raise invalid(key, error.value, error.allowed, error.hint) from None
    if values.shape != wavelengths.shape:
        allowed = f"one number, or {wavelengths.size}, one for each wavelength"
        raise invalid("index", f"{values.size} numbers", allowed)
    is_valid = (values.real > 0.0) & (values.imag >= 0.0) & (np.abs(values - 1.0) > MIN_CONTRAST)
    if not is_valid.all():
        allowed = "n + ik with n > 0 and k >= 0, and not 1"
        raise invalid("index", complex(values[~is_valid][0]), allowed, "relative to the medium")
    return values


def _read_index_array(index: Any) -> np.ndarray:
    """Return the refractive indices of a sequence of real or complex numbers."""
    complex_array = index if np.ma.isMaskedArray(index) else np.asarray(index)
    if complex_array.dtype.kind != "c":
        return as_1d_array("index", index, "complex numbers").astype(complex)
    filled = np.ma.filled(complex_array, np.nan)
    real, imaginary = (
        as_1d_array("index", part, "finite numbers") for part in (filled.real, filled.imag)
    )
    values: np.ndarray = real + 1j * imaginary
    return values


def _read_angles(angle_deg: Any, max_size: float) -> np.ndarray:
    """Return scattering angles (degrees) for spheres of a largest size parameter."""
    if angle_deg is not None:
        angles = as_1d_array("angle_deg", angle_deg, "numbers in degrees")
        check_increasing("angle_deg", angles)
        return check_array_range("angle_deg", angles, 0.0, 180.0, "degrees")
    # Structures of backscattering are as narrow as the peak of diffraction.
    forward = choose_resolving_angles(int(np.ceil(2.0 * max_size)))
    forward = forward[forward < 90.0]
    return np.concatenate([forward, [90.0], 180.0 - forward[::-1]])


def _make_dataset(
    wavelengths: np.ndarray, angles: np.ndarray, sums: Sequence[SphereSums]
) -> xr.Dataset:
    """Return means over spheres, without attributes of the dataset."""
    area, extinction, scattering, forward = (
        np.array([getattr(one, name) for one in sums]) for name in SphereSums._fields[:-1]
    )
    means = scattering / extinction, forward / scattering, extinction / area, scattering / area
    variables: dict[str, Variable] = {}
    for (name, label), values in zip(MEANS.items(), means, strict=True):
        variables |= make_variable(name, "wavelength", values, None, label)
    matrix = np.stack([one.matrix / one.scattering for one in sums], axis=1)
    p11, p12, p33, p34 = matrix
    # Of spheres, P22 = P11 and P44 = P33.
    for name, element in zip(ELEMENTS, (p11, p12, p33, p34, p11, p33), strict=True):
        label = f"element {name} of the scattering matrix"
        variables |= make_variable(name, ("wavelength", ANGLE), element, None, label)
    angle_attributes = {"long_name": "scattering angle", "units": "degree"}
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        ANGLE: (ANGLE, angles, angle_attributes),
    }
    return xr.Dataset(variables, coordinates)
