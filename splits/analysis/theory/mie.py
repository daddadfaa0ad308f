"""Scattering matrices of spheres of a size distribution, by Mie theory.

The series coefficients a_n and b_n and the angular functions π_n and τ_n are those of the package
miepython.  A sphere of size parameter x = 2π r/λ has the amplitudes (Bohren & Huffman 1983,
Absorption and Scattering of Light by Small Particles, section 4.4)

    S1 = Σ_n (2n + 1)/(n(n + 1)) (a_n π_n + b_n τ_n)
    S2 = Σ_n (2n + 1)/(n(n + 1)) (a_n τ_n + b_n π_n)

and, with the scattering plane as reference, the matrix

    P11 = P22 = ½(|S2|² + |S1|²)    P12 = ½(|S2|² − |S1|²)    P33 + i P34 = S2 S1*    P44 = P33

whose integral over directions is the scattering cross-section times the squared wave number.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from types import ModuleType
from typing import Annotated, Any, NamedTuple

import numba
import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.theory.phase_function import ALBEDO, ASYMMETRY, choose_resolving_angles
from splits.core.arrays import (
    align_to_labels,
    as_1d_array,
    check_array_range,
    check_increasing,
    find_labels,
    match_labels,
)
from splits.core.declarations import Quantity
from splits.core.inputs import Numbers, check_wavelengths, declare_numbers
from splits.core.keywords import declare_function
from splits.core.optional import import_optional
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import InvalidValue, check_relations, invalid
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.materials import make_refractive_index, parse_refractive_index
from splits.materials.library import MATERIALS
from splits.media.particle_layer import ANGLE, ELEMENTS
from splits.simulation.run_options import make_wavelength_coordinate

COMPILATION_SWITCH = "MIEPYTHON_USE_JIT"
"""Variable of the environment by which miepython compiles its functions."""
BATCH = 64
"""Number of spheres whose amplitudes are computed at once."""


class SphereSums(NamedTuple):
    """Sums over spheres, weighted by projected area.

    Attributes
    ----------
    area, extinction, scattering, forward : float
        Sums of 1, of the efficiencies of extinction and scattering, and of the latter times the
        asymmetry parameter.
    matrix : float, shape (4, angles)
        Sums of P11, P12, P33 and P34 of the module, times 4/x²: the mean of P11 over directions is
        the sum of the scattering efficiencies.
    """

    area: float
    extinction: float
    scattering: float
    forward: float
    matrix: np.ndarray

    def add(self, other: SphereSums) -> SphereSums:
        """Return the sums over the spheres of both."""
        return SphereSums(
            self.area + other.area,
            self.extinction + other.extinction,
            self.scattering + other.scattering,
            self.forward + other.forward,
            self.matrix + other.matrix,
        )

    def measure_change(self, other: SphereSums) -> float:
        """Return the largest relative difference between means over spheres.

        For elements of the matrix, it is the mean over angles of the difference divided by P11.
        """
        means = [(s.extinction / s.area, s.scattering / s.area) for s in (self, other)]
        efficiencies = max(abs(one / two - 1.0) for one, two in zip(*means, strict=True))
        asymmetry = abs(self.forward / self.scattering - other.forward / other.scattering)
        one, two = self.matrix / self.scattering, other.matrix / other.scattering
        return float(max(efficiencies, asymmetry, *(np.abs(one - two) / two[0]).mean(axis=1)))


class AngularFunctions:
    """Functions π_n and τ_n times (2n + 1)/(n(n + 1)) at scattering angles.

    Parameters
    ----------
    angle_deg : float, shape (angles,)
    max_size : float
        Largest size parameter.
    """

    def __init__(self, angle_deg: np.ndarray, max_size: float) -> None:
        mie = import_miepython()
        n_terms = len(mie.coefficients(1.5 + 0.0j, max_size)[0])
        pi, tau = (np.zeros((angle_deg.size, n_terms)) for _ in range(2))
        for row, cosine in enumerate(np.cos(np.radians(angle_deg))):
            mie.pi_tau(float(cosine), pi[row], tau[row])
        n = np.arange(1.0, n_terms + 1.0)
        factor = (2.0 * n + 1.0) / (n * (n + 1.0))
        self.pi, self.tau = (factor * pi).T, (factor * tau).T


def import_miepython() -> ModuleType:
    """Return the package miepython; raise ModuleNotFoundError with its installation command.

    Its functions are compiled unless the environment says otherwise, which miepython reads when it
    is imported for the first time.
    """
    is_chosen = COMPILATION_SWITCH in os.environ or numba.config.DISABLE_JIT  # type: ignore[attr-defined]
    if is_chosen:
        return import_optional("miepython", "mie", "Mie theory needs")
    os.environ[COMPILATION_SWITCH] = "1"
    try:
        return import_optional("miepython", "mie", "Mie theory needs")
    finally:
        del os.environ[COMPILATION_SWITCH]


def sum_spheres(
    index: complex, size: np.ndarray, area: np.ndarray, functions: AngularFunctions
) -> SphereSums:
    """Return sums over spheres.

    Parameters
    ----------
    index : complex
        Refractive index n + ik relative to the surrounding medium.
    size : float, shape (spheres,)
        Size parameters.
    area : float, shape (spheres,)
        Projected areas in any unit, times the numbers of spheres.
    functions : AngularFunctions
    """
    mie = import_miepython()
    # miepython takes n − ik; the coefficients that it returns are those of n + ik.
    extinction, scattering, _, asymmetry = mie.efficiencies_mx(np.conj(index), size)
    matrix = np.zeros((4, functions.pi.shape[1]))
    for start in range(0, size.size, BATCH):
        part = slice(start, start + BATCH)
        s1, s2 = _compute_amplitudes(index, size[part], functions)
        weight = 4.0 * area[part] / size[part] ** 2
        perpendicular, parallel = weight @ np.abs(s1) ** 2, weight @ np.abs(s2) ** 2
        product = weight @ (s2 * s1.conj())
        mean, difference = 0.5 * (parallel + perpendicular), 0.5 * (parallel - perpendicular)
        # P11, P12, P33 and P34.
        matrix += np.stack([mean, difference, product.real, product.imag])
    return SphereSums(
        area.sum(), area @ extinction, area @ scattering, area @ (scattering * asymmetry), matrix
    )


def _compute_amplitudes(
    index: complex, size: np.ndarray, functions: AngularFunctions
) -> tuple[np.ndarray, np.ndarray]:
    """Return S1 and S2 of spheres, shape (spheres, angles)."""
    mie = import_miepython()
    series = [mie.coefficients(np.conj(index), x) for x in size]
    n_terms = max(one.shape[1] for one in series)
    a, b = np.zeros((2, size.size, n_terms), dtype=complex)
    for row, (a_n, b_n) in enumerate(series):
        a[row, : a_n.size], b[row, : b_n.size] = a_n, b_n
    pi, tau = functions.pi[:n_terms], functions.tau[:n_terms]

    def multiply(terms: np.ndarray, function: np.ndarray) -> np.ndarray:
        """Return the product of a complex and a real matrix, by two real products."""
        return np.asarray(terms.real @ function + 1j * (terms.imag @ function))

    return multiply(a, pi) + multiply(b, tau), multiply(a, tau) + multiply(b, pi)


RADIUS_RANGE_UM = (1e-4, 1e5)
VARIANCE_RANGE = (1e-3, 0.499)
EXCLUDED_FRACTION = 1e-7
"""Fraction of a gamma distribution that is left out at each of its ends."""
MIN_INTERVALS, MAX_INTERVALS = 64, 65536
"""Smallest and largest number of intervals of the quadrature over a gamma distribution."""


@dataclass(frozen=True)
class GivenSizes:
    """Spheres of given radii.

    Attributes
    ----------
    radius_um : float, shape (radii,)
        Increasing.
    number_density : float, shape (radii,)
        Numbers of spheres, at least one of them above 0.
    """

    radius_um: np.ndarray
    number_density: np.ndarray

    @classmethod
    def from_input(cls, radius_um: Any, number_density: Any) -> GivenSizes:
        """Return sizes from the arguments of a user; None counts every radius once."""
        radius = as_1d_array("radius_um", radius_um, "numbers in micrometres")
        check_increasing("radius_um", radius)
        check_array_range("radius_um", radius, *RADIUS_RANGE_UM, "um")
        if number_density is None:
            if radius.size > 1:
                raise invalid("number_density", None, "given for several radii")
            return cls(radius, np.ones(1))
        number = np.atleast_1d(
            align_to_labels("number_density", number_density, radius, find_labels(radius_um))
        )
        check_array_range("number_density", number, 0.0, np.inf)
        if number.shape != radius.shape or not number.any():
            allowed = f"{radius.size} numbers, one for each radius, not all of them 0"
            raise invalid("number_density", number.tolist(), allowed)
        return cls(radius, number)

    @property
    def largest_um(self) -> float:
        """Largest radius (µm)."""
        return float(self.radius_um[-1])

    def sum_spheres(
        self, index: complex, size_per_um: float, functions: AngularFunctions
    ) -> tuple[SphereSums, int]:
        """Return sums over the spheres, and the number of radii; see `GammaSizes.sum_spheres`."""
        area = self.number_density * self.radius_um**2
        return sum_spheres(index, size_per_um * self.radius_um, area, functions), area.size


@dataclass(frozen=True)
class GammaSizes:
    """Gamma distribution n(r) ∝ r^((1 − 3b)/b) exp(−r/(ab)), Hansen & Travis (1974), Eq 2.56.

    Projected area r² n(r) has a gamma distribution of the shape 1/b and the mean a.

    Attributes
    ----------
    effective_radius_um : float
        Effective radius a.
    effective_variance : float
        Effective variance b.
    tolerance : float
        Change of the means at which the quadrature ends.
    """

    effective_radius_um: float
    effective_variance: float
    tolerance: float

    @property
    def relative_limits(self) -> tuple[float, float]:
        """Smallest and largest radius of the quadrature, divided by the effective radius.

        They exclude `EXCLUDED_FRACTION` of the area of the smallest spheres, and of the squared
        area, to which the light that is scattered straight ahead is proportional, of the largest.
        """
        from scipy.special import gammainccinv, gammaincinv

        shape = 1.0 / self.effective_variance
        low = gammaincinv(shape, EXCLUDED_FRACTION)
        high = gammainccinv(shape + 2.0, EXCLUDED_FRACTION)
        return float(low) / shape, float(high) / shape

    @property
    def largest_um(self) -> float:
        """Largest radius of the quadrature (µm)."""
        return self.effective_radius_um * self.relative_limits[1]

    def sum_spheres(
        self, index: complex, size_per_um: float, functions: AngularFunctions
    ) -> tuple[SphereSums, int]:
        """Return sums over the distribution, and the number of radii.

        The trapezoidal rule converges faster than any power of its interval for smooth functions
        that vanish at both ends.  Its intervals are halved until the means change by at most the
        tolerance.

        Parameters
        ----------
        index : complex
            Refractive index relative to the surrounding medium.
        size_per_um : float
            Size parameter per radius (1/µm).
        functions : AngularFunctions

        Raises
        ------
        ValueError
            If more than `MAX_INTERVALS` intervals are needed.
        """
        low, high = self.relative_limits

        def sum_at(fraction: np.ndarray) -> SphereSums:
            """Return the sums at fractions of the range of radii."""
            radius = low + (high - low) * fraction
            # The exponential is 1 at the effective radius and does not underflow.
            exponent = (np.log(radius) + 1.0 - radius) / self.effective_variance
            area = np.exp(exponent) / radius
            size = size_per_um * self.effective_radius_um * radius
            return sum_spheres(index, size, area, functions)

        intervals = MIN_INTERVALS
        sums = sum_at(np.arange(intervals + 1) / intervals)
        while intervals < MAX_INTERVALS:
            finer = sums.add(sum_at((np.arange(intervals) + 0.5) / intervals))
            intervals *= 2
            if finer.measure_change(sums) <= self.tolerance:
                return finer, intervals + 1
            sums = finer
        hint = "or a larger effective_variance, smaller spheres"
        allowed = f"one that {MAX_INTERVALS + 1} radii reach"
        raise invalid("tolerance", self.tolerance, allowed, hint)


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


EffectiveRadius = Annotated[
    float | None,
    Quantity(
        "effective radius of the spheres", "um", low=RADIUS_RANGE_UM[0], high=RADIUS_RANGE_UM[1]
    ),
]
EffectiveVariance = Annotated[
    float | None,
    Quantity("effective variance of the spheres", low=VARIANCE_RANGE[0], high=VARIANCE_RANGE[1]),
]
MatrixAngles = Annotated[
    Numbers, declare_numbers("scattering angle", "degree", "degrees", 0.0, 180.0)
]
QuadratureTolerance = Annotated[
    float, Quantity("change of the means at which the quadrature ends", low=1e-6, high=0.1)
]


@declare_function
def compute_mie_matrix(
    wavelength_nm: Any,
    index: Any,
    effective_radius_um: EffectiveRadius = None,
    effective_variance: EffectiveVariance = None,
    *,
    radius_um: Any = None,
    number_density: Any = None,
    angle_deg: MatrixAngles | None = None,
    tolerance: QuadratureTolerance = 3e-3,
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
    wavelengths = check_wavelengths("wavelength_nm", wavelength_nm)
    indices = _read_index(index, wavelengths, find_labels(wavelength_nm))
    moments = {
        "effective_radius_um": effective_radius_um, "effective_variance": effective_variance,
    }  # fmt: skip
    by_moments = any(one is not None for one in moments.values())
    by_radii = radius_um is not None or number_density is not None
    given, allowed = "both" if by_moments else "none", f"either {' or '.join(SIZE_ARGUMENTS)}"
    check_relations(
        (by_moments != by_radii, "sizes", given, allowed),
        *(
            (by_radii or value is not None, key, None, "given, as the other one is")
            for key, value in moments.items()
        ),
    )
    sizes = (
        GivenSizes.from_input(radius_um, number_density)
        if effective_radius_um is None or effective_variance is None
        else GammaSizes(effective_radius_um, effective_variance, tolerance)
    )
    size_per_um = 2.0 * np.pi * 1e3 / wavelengths
    max_size = float(size_per_um[0] * sizes.largest_um)
    if max_size > MAX_SIZE_PARAMETER:
        allowed = f"at most {MAX_SIZE_PARAMETER:g} for the largest sphere"
        raise invalid("size parameter", max_size, allowed, "geometric optics is for larger spheres")
    angles = np.asarray(angle_deg)
    if angle_deg is None:
        # Structures of backscattering are as narrow as the peak of diffraction.
        forward = choose_resolving_angles(int(np.ceil(2.0 * max_size)))
        forward = forward[forward < 90.0]
        angles = np.concatenate([forward, [90.0], 180.0 - forward[::-1]])
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
        **asdict(sizes),
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
            if error.key.startswith("refractive_index"):
                error.key = f"index{error.key.partition(']')[2]}"
            raise
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
    return np.asarray(real + 1j * imaginary)


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
