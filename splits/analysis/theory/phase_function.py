"""Phase functions from Legendre moments, with or without diffraction, for other transfer codes."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import xarray as xr
from numpy.polynomial.legendre import legvander

from splits.core.arrays import as_1d_array, check_array_range, check_no_gaps
from splits.core.declarations import Quantity
from splits.core.inputs import NUMBERS_SCHEMA, Numbers
from splits.core.keywords import declare_function
from splits.core.uncertainty import Variable, compute_jackknife_stderr, make_variable
from splits.core.validation import invalid, join_names
from splits.io.netcdf import to_netcdf_attributes

ALBEDO, ASYMMETRY, MOMENT = "single_scattering_albedo", "asymmetry_parameter", "legendre_moment"
DEFAULT_ANGLES_DEG = tuple(np.linspace(0.0, 180.0, 361).tolist())


SphereRadius = Annotated[
    float | None,
    Quantity("radius of spheres with the projected area of the grains", "um", low=0.1, high=1e6),
]


@declare_function
def with_diffraction(optics: xr.Dataset, radius_um: SphereRadius = None) -> xr.Dataset:
    """Return single-scattering properties that include diffraction by the grains.

    A large grain diffracts as much light as it intercepts.  Diffraction doubles the extinction by
    grains and scatters into a peak a few tenths of a degree wide, which hardly changes the results
    of radiative transfer.

    Parameters
    ----------
    optics : xarray.Dataset
        Output of `splits.single_scattering`.
    radius_um : float, optional
        Radius of spheres with the same projected area as the grains (µm), 0.1 to 1e6; by default
        the optical radius of the medium.  Grains are assumed in air, where the peak is widest.

    Returns
    -------
    xarray.Dataset
        Extinction, optical thickness, single-scattering albedo, asymmetry parameter and moments
        with diffraction, and their errors.  About 4π radius/wavelength moments resolve the peak.
        The scattering matrix is left out.

    Raises
    ------
    ValueError
        For another kind of dataset, or one that includes diffraction.

    Notes
    -----
    Moments of the peak are those of a circular aperture in the Fraunhofer limit, equal to its
    optical transfer function: χ_l = (2/π)(arccos t − t √(1 − t²)), t = √(l(l + 1))/2x, x = 2π r/λ
    (Goodman 2005, Introduction to Fourier Optics, chapter 6; Legendre polynomials are approximated
    by J_0).
    """
    optics = check_moments(optics)
    if optics.attrs["diffraction"] != "none":
        raise invalid("optics", optics.attrs["diffraction"], "without diffraction yet")
    if radius_um is None:
        medium_radius = optics.attrs.get(f"{optics.attrs['medium']}_optical_radius_um")
        if medium_radius is None:
            raise invalid("radius_um", None, "given for a medium that has no optical radius")
        radius_um = float(medium_radius)
    grains = float(optics.attrs["extinction_by_grains_per_m"])
    peak = compute_diffraction_moments(radius_um, optics.wavelength.values, optics.order.values)
    extinction = optics.extinction.values
    total_extinction = extinction + grains
    scattered = optics[ALBEDO].values * extinction

    def mix(albedo: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """Return moments of all scattered light."""
        by_optics = (albedo * extinction)[..., np.newaxis]
        return np.asarray((by_optics * moment + grains * peak) / (by_optics + grains))

    jackknife_name, bound_name = f"{MOMENT}_jackknife", f"{MOMENT}_interpolation_error_bound"
    moment = mix(optics[ALBEDO].values, optics[MOMENT].values)
    jackknife = mix(optics[f"{ALBEDO}_jackknife"].values, optics[jackknife_name].values)
    fraction = (scattered / (scattered + grains))[:, np.newaxis]
    bound = fraction * optics[bound_name].values
    error = np.hypot(compute_jackknife_stderr(jackknife), bound)
    albedo_error = extinction / total_extinction * optics[f"{ALBEDO}_stderr"].values
    thickness: dict[str, Variable] = {}
    if "optical_thickness" in optics:
        thickness = make_variable(
            "optical_thickness", "wavelength",
            optics.optical_thickness.values * total_extinction / extinction, None,
            "optical thickness of extinction",
        )  # fmt: skip
    dims = ("wavelength", "order")
    variables = {
        **make_variable(
            "extinction", "wavelength", total_extinction, None, "extinction coefficient", "m-1"
        ),
        **thickness,
        **make_variable(
            ALBEDO, "wavelength", (scattered + grains) / total_extinction, albedo_error,
            "single-scattering albedo",
        ),
        **make_variable(
            ASYMMETRY, "wavelength", moment[:, 1], error[:, 1], "asymmetry parameter"
        ),
        **make_variable(MOMENT, dims, moment, error, "Legendre moment of the phase function"),
        jackknife_name: (("batch", *dims), jackknife, optics[jackknife_name].attrs),
        bound_name: (dims, bound, optics[bound_name].attrs),
    }  # fmt: skip
    attributes = {**optics.attrs, "diffraction": f"Fraunhofer, radius {radius_um:g} um"}
    coordinates = {name: optics.coords[name] for name in ("wavelength", "order")}
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(attributes))


def compute_diffraction_moments(
    radius_um: float, wavelength_nm: np.ndarray, order: np.ndarray
) -> np.ndarray:
    """Return Legendre moments of light diffracted by large spheres, shape (wavelengths, orders)."""
    size = 2.0 * np.pi * radius_um * 1e3 / wavelength_nm[:, np.newaxis]
    t = np.minimum(np.sqrt(order * (order + 1.0)) / (2.0 * size), 1.0)
    return np.asarray((2.0 / np.pi) * (np.arccos(t) - t * np.sqrt((1.0 - t) * (1.0 + t))))


ScatteringAngles = Annotated[
    Numbers,
    Quantity(
        "scattering angle", "degree", schema=NUMBERS_SCHEMA,
        check=lambda key, angles: check_array_range(
            key, as_1d_array(key, angles, "numbers in degrees"), 0.0, 180.0, "degrees"
        ),
    ),
]  # fmt: skip


@declare_function
def phase_function(
    optics: xr.Dataset, angle_deg: ScatteringAngles = DEFAULT_ANGLES_DEG
) -> xr.Dataset:
    """Return the phase function by scattering angle.

    It is smoothed by the narrowest nonnegative peak that the number of moments represents, since
    truncated sums oscillate around narrow features.  The full width at half maximum of that peak is
    about 475° divided by the number of moments.  Smoothing reduces the mean cosine, for 64 moments
    by 0.3 %.

    Parameters
    ----------
    optics : xarray.Dataset
        Output of `splits.single_scattering` or `with_diffraction`.
    angle_deg : array_like
        Scattering angles, 0 to 180 degrees.

    Returns
    -------
    xarray.Dataset
        ``phase_function`` (1/sr) over ``wavelength`` and ``angle``, normalized to 1 over all
        directions, and its standard error.

    Raises
    ------
    ValueError
        For another kind of dataset, or angles outside the range.
    """
    optics = check_moments(optics)
    angles = np.asarray(angle_deg)
    terms = _make_legendre_terms(np.cos(np.radians(angles)), int(optics.order[-1]))
    value = optics[MOMENT].values @ terms
    noise = compute_jackknife_stderr(optics[f"{MOMENT}_jackknife"].values @ terms)
    bound = optics[f"{MOMENT}_interpolation_error_bound"].values @ np.abs(terms)
    variables = make_variable(
        "phase_function", ("wavelength", "angle"), np.maximum(value, 0.0),
        np.hypot(noise, bound), "phase function", "sr-1",
    )  # fmt: skip
    attributes = {"long_name": "scattering angle", "units": "degree"}
    axes = {"wavelength": optics.wavelength, "angle": ("angle", angles, attributes)}
    return xr.Dataset(variables, axes, to_netcdf_attributes(dict(optics.attrs)))


def _make_legendre_terms(mu: np.ndarray, max_order: int) -> np.ndarray:
    """Return the factors of moments, shape (orders, angles)."""
    factors = (2.0 * np.arange(max_order + 1) + 1.0) * _compute_damping_factors(max_order)
    return np.asarray(factors[:, np.newaxis] / (4.0 * np.pi) * legvander(mu, max_order).T)


def _compute_damping_factors(max_order: int) -> np.ndarray:
    """Return the moments of the narrowest nonnegative polynomial peak up to an even order.

    Among nonnegative polynomials, the square of Σ (2k + 1) P_k(x) P_k(μ) of half the order has the
    largest mean cosine x, the largest zero of the next polynomial, where Gauss quadrature puts all
    of its weight on one node.
    """
    from scipy.special import roots_legendre

    half = max_order // 2
    zeros, _ = roots_legendre(half + 1)
    at_zero = legvander(zeros[-1:], half)[0]
    mu, weight = roots_legendre(max_order + 1)
    polynomials = legvander(mu, max_order)
    root = polynomials[:, : half + 1] @ ((2.0 * np.arange(half + 1) + 1.0) * at_zero)
    moments = (weight * root**2) @ polynomials
    return np.asarray(moments / moments[0])


def choose_resolving_angles(n_moments: int) -> np.ndarray:
    """Return angles (degrees) between which a phase function is nearly linear.

    The spacing is a tenth of the narrowest peak near 0° and increases to half a degree.
    """
    min_step = min(47.5 / max(n_moments, 1), 0.5)
    angles = [0.0]
    while angles[-1] < 180.0:
        angles.append(angles[-1] + min(max(min_step, 0.03 * angles[-1]), 0.5))
    angles[-1] = 180.0
    return np.array(angles)


def check_moments(optics: xr.Dataset) -> xr.Dataset:
    """Return optics with ascending moments along the last axis; reject other datasets."""
    attrs = optics.attrs if isinstance(optics, xr.Dataset) else {"title": type(optics).__name__}
    if "diffraction" not in attrs or f"{MOMENT}_jackknife" not in optics:
        title = attrs.get("title", "a dataset")
        raise invalid("optics", title, "the output of splits.single_scattering")
    if not {"wavelength", "order"} <= {*optics.dims}:
        raise invalid(
            "optics",
            f"over {join_names(map(str, optics.dims))}",
            "over wavelength and order",
            "select lists, which keep the dimensions",
        )
    check_no_gaps("optics", optics)
    optics = optics.sortby("order").transpose(..., "wavelength", "order")
    if not np.array_equal(optics.order, np.arange(optics.sizes["order"])):
        allowed = "0, 1, 2, … up to some order"
        raise invalid("optics.order", optics.order.values.tolist(), allowed)
    return optics


def to_eradiate(optics: xr.Dataset, angle_deg: Any = None) -> xr.Dataset:
    """Return single-scattering properties in the format of eradiate's particle layers ("Aer v1").

    A smoothed phase function with linear interpolation between angles has a slightly smaller
    asymmetry than its moments.  Scattering is reduced accordingly, so that transport scattering and
    absorption per metre are conserved (similarity relation of van de Hulst).

    Parameters
    ----------
    optics : xarray.Dataset
        As for `phase_function`.
    angle_deg : array_like, optional
        Scattering angles from 0 to 180 degrees; by default enough for the moments.

    Returns
    -------
    xarray.Dataset
        ``sigma_t`` (1/m) and ``albedo`` over ``w`` (nm), and ``phase`` (1/sr) over ``w``, ``mu``
        (ascending), ``i`` and ``j``: the element of unpolarized light, normalized to 1.
        ``optical_thickness`` over ``w`` is included for eradiate's ``tau_ref`` at ``w_ref``.

    Raises
    ------
    ValueError
        For angles that do not resolve a peak, so that the normalization deviates by more than 1 %.
    """
    optics = check_moments(optics)
    angles = choose_resolving_angles(int(optics.order[-1])) if angle_deg is None else angle_deg
    function = phase_function(optics, angles).sortby("angle", ascending=False)
    mu = np.cos(np.radians(function.angle.values))
    phase = function.phase_function.values
    total = 2.0 * np.pi * np.trapezoid(phase, mu, axis=1)
    if np.abs(total - 1.0).max() > 0.01:
        allowed = "fine enough to normalize the phase function within 1 %"
        raise invalid("angle_deg", f"{len(mu)} angles", allowed, "leave them out")
    phase = phase / total[:, np.newaxis]
    forward = 2.0 * np.pi * np.trapezoid(phase * mu, mu, axis=1)
    extinction = optics.extinction.values
    scattered = extinction * optics[ALBEDO].values
    absorbed = extinction - scattered
    scattered = scattered * (1.0 - optics[MOMENT].values[:, 1]) / (1.0 - forward)
    ratio = (scattered + absorbed) / extinction
    thickness = {}
    if "optical_thickness" in optics:
        values = optics.optical_thickness.values * ratio
        thickness["optical_thickness"] = ("w", values, {"units": "dimensionless"})
    return xr.Dataset(
        {
            "sigma_t": ("w", scattered + absorbed, {"units": "m^-1"}),
            "albedo": ("w", scattered / (scattered + absorbed), {"units": "dimensionless"}),
            "phase": (
                ("w", "mu", "i", "j"), phase[:, :, np.newaxis, np.newaxis],
                {"units": "steradian^-1"},
            ),
            **thickness,
        },
        {
            "w": ("w", optics.wavelength.values, {"units": "nm"}),
            "mu": ("mu", mu, {"units": "dimensionless"}),
            "i": ("i", [0]),
            "j": ("j", [0]),
        },
        {"title": "Particle radiative properties", "source": optics.attrs.get("source", "splits")},
    )  # fmt: skip
