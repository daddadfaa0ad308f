"""Phase functions by angle from their moments, with or without the peak of diffraction.

For programs that solve radiative transfer with grains of this package.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array, check_array_range, check_no_gaps
from splits.core.atomic import atomic_write
from splits.core.uncertainty import compute_jackknife_stderr, make_variable
from splits.core.validation import check_range, invalid, reject_unknown_arguments
from splits.io.netcdf import to_netcdf_attributes

ALBEDO, ASYMMETRY, MOMENT = "single_scattering_albedo", "asymmetry_parameter", "legendre_moment"
DEFAULT_ANGLES_DEG = tuple(np.linspace(0.0, 180.0, 361).tolist())


@reject_unknown_arguments
def with_diffraction(optics: xr.Dataset, radius_um: float | None = None) -> xr.Dataset:
    """Return single-scattering properties with what light does that passes a grain by.

    As much light as a large grain intercepts is diffracted at its edge.  It doubles the extinction
    by grains, and goes into a peak a few tenths of a degree wide.  What follows for radiative
    transfer is nearly the same with and without: the peak's light goes on as if nothing had been.

    Parameters
    ----------
    optics : xarray.Dataset
        As `splits.single_scattering` returns it.
    radius_um : float, optional
        Of spheres with the grains' shadows (µm), 0.1 to 1e6; by default the medium's optical
        radius, which is about that.  Grains are taken to lie in air, where the peak is widest.

    Returns
    -------
    xarray.Dataset
        Extinction, optical thickness, single-scattering albedo, asymmetry parameter and moments
        with diffraction, and errors.  For all of the peak to show some 4π radius/wavelength
        moments are needed.

    Raises
    ------
    ValueError
        For a dataset of another kind, or that has diffraction already.

    Notes
    -----
    Moments of the peak are those of a circular opening in Fraunhofer's limit, as optical transfer
    functions have it: χ_l = (2/π)(arccos t − t √(1 − t²)), t = √(l(l + 1))/2x, x = 2π r/λ
    (Goodman 2005, Introduction to Fourier Optics, chapter 6; J_0 stands for Legendre polynomials).
    """
    optics = _check_moments(optics)
    if optics.attrs["diffraction"] != "none":
        raise invalid("optics", optics.attrs["diffraction"], "without diffraction yet")
    if radius_um is None:
        own = optics.attrs.get(f"{optics.attrs['medium']}_optical_radius_um")
        if own is None:
            raise invalid("radius_um", None, "given for a medium that has no optical radius")
        radius_um = float(own)
    radius_um = check_range("radius_um", radius_um, 0.1, 1e6)
    grains = float(optics.attrs["extinction_by_grains_per_m"])
    peak = diffraction_moments(radius_um, optics.wavelength.values, optics.order.values)
    extinction = optics.extinction.values
    scattered = optics[ALBEDO].values * extinction

    def mixed(albedo: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """Return moments of all scattered light."""
        own = (albedo * extinction)[..., np.newaxis]
        found: np.ndarray = (own * moment + grains * peak) / (own + grains)
        return found

    moment = mixed(optics[ALBEDO].values, optics[MOMENT].values)
    left = mixed(optics[f"{ALBEDO}_jackknife"].values, optics[f"{MOMENT}_jackknife"].values)
    share = (scattered / (scattered + grains))[:, np.newaxis]
    missed = share * optics[f"{MOMENT}_interpolation_bound"].values
    whole_extinction = extinction + grains
    thinned = extinction / whole_extinction
    found: dict[str, Any] = {}
    found |= make_variable("extinction", "wavelength", whole_extinction, None,
                      "extinction coefficient", "m-1")  # fmt: skip
    thickness = optics.optical_thickness.values * whole_extinction / extinction
    found |= make_variable("optical_thickness", "wavelength", thickness, None,
                      "optical thickness of extinction")  # fmt: skip
    albedo = (scattered + grains) / whole_extinction
    error = thinned * optics[f"{ALBEDO}_stderr"].values
    found |= make_variable(ALBEDO, "wavelength", albedo, error, "single-scattering albedo")
    error = np.hypot(compute_jackknife_stderr(left), missed)
    dims = ("wavelength", "order")
    found |= make_variable(
        ASYMMETRY, "wavelength", moment[:, 1], error[:, 1], "asymmetry parameter"
    )
    found |= make_variable(MOMENT, dims, moment, error, "Legendre moment of the phase function")
    found[f"{MOMENT}_jackknife"] = (("batch", *dims), left, optics[f"{MOMENT}_jackknife"].attrs)
    found[f"{MOMENT}_interpolation_bound"] = (
        dims,
        missed,
        optics[f"{MOMENT}_interpolation_bound"].attrs,
    )
    facts = {**optics.attrs, "diffraction": f"Fraunhofer, radius {radius_um:g} um"}
    return xr.Dataset(found, optics.coords, to_netcdf_attributes(facts))


def diffraction_moments(
    radius_um: float, wavelength_nm: np.ndarray, order: np.ndarray
) -> np.ndarray:
    """Return Legendre moments of light diffracted by large spheres, shape (wavelengths, orders)."""
    size = 2.0 * np.pi * radius_um * 1e3 / wavelength_nm[:, np.newaxis]
    t = np.minimum(np.sqrt(order * (order + 1.0)) / (2.0 * size), 1.0)
    moments: np.ndarray = (2.0 / np.pi) * (np.arccos(t) - t * np.sqrt((1.0 - t) * (1.0 + t)))
    return moments


@reject_unknown_arguments
def phase_function(optics: xr.Dataset, angle_deg: Any = DEFAULT_ANGLES_DEG) -> xr.Dataset:
    """Return the phase function by scattering angle.

    Smoothed by the narrowest peak that so many moments can describe and that is nowhere negative:
    plain sums over moments ring around whatever is narrow.  That
    peak is some 475° over the number of moments wide at half its height.  Smoothing lowers the mean
    cosine: of 64 moments by 0.3 %.

    Parameters
    ----------
    optics : xarray.Dataset
        As `splits.single_scattering` or `with_diffraction` returns it.
    angle_deg : array_like
        Scattering angles, 0 to 180 degrees.

    Returns
    -------
    xarray.Dataset
        ``phase_function`` (1/sr) over ``wavelength`` and ``angle``, which adds up to 1 over all
        directions, and its standard error.

    Raises
    ------
    ValueError
        For a dataset of another kind, or angles out of range.
    """
    optics = _check_moments(optics)
    angles = check_array_range("angle_deg", as_1d_array("angle_deg", angle_deg), 0.0, 180.0)
    terms = _make_legendre_terms(np.cos(np.radians(angles)), int(optics.order[-1]))
    value = optics[MOMENT].values @ terms
    noise = compute_jackknife_stderr(optics[f"{MOMENT}_jackknife"].values @ terms)
    missed = optics[f"{MOMENT}_interpolation_bound"].values @ np.abs(terms)
    variables = make_variable(
        "phase_function", ("wavelength", "angle"), np.maximum(value, 0.0),
        np.hypot(noise, missed), "phase function", "sr-1",
    )  # fmt: skip
    about = {"long_name": "scattering angle", "units": "degree"}
    axes = {"wavelength": optics.wavelength, "angle": ("angle", angles, about)}
    return xr.Dataset(variables, axes, to_netcdf_attributes(dict(optics.attrs)))


def _make_legendre_terms(mu: np.ndarray, max_order: int) -> np.ndarray:
    """Return what moments are multiplied by, shape (orders, angles)."""
    damped = _compute_damping_factors(max_order)
    terms = np.empty((max_order + 1, mu.size))
    for order, polynomial in enumerate(_generate_legendre_polynomials(mu, max_order)):
        terms[order] = (2.0 * order + 1.0) * damped[order] / (4.0 * np.pi) * polynomial
    return terms


def _generate_legendre_polynomials(mu: np.ndarray, max_order: int) -> Iterator[np.ndarray]:
    """Yield Legendre's polynomials of each order."""
    before, last = np.zeros_like(mu), np.ones_like(mu)
    yield last
    for n in range(1, max_order + 1):
        before, last = last, ((2 * n - 1) * mu * last - (n - 1) * before) / n
        yield last


def _compute_damping_factors(max_order: int) -> np.ndarray:
    """Return the moments of the narrowest peak that polynomials up to an (even) order can be.

    Of all that are nowhere negative, the square of a polynomial Σ (2k + 1) P_k(x) P_k(μ) of half
    the order has the largest mean cosine, x, the largest zero of the next polynomial: there
    Gauss's quadrature puts all of its weight on one node.
    """
    half = max_order // 2
    x = np.array([_find_largest_zero(half + 1)])
    # Fejér's quadrature is exact for polynomials of fewer orders than it has nodes.
    count = 2 * max_order + 2
    angle = (np.arange(count) + 0.5) * np.pi / count
    weight = np.full(count, 2.0 / count)
    for k in range(1, count // 2 + 1):
        weight -= 4.0 / count * np.cos(2.0 * k * angle) / (4.0 * k * k - 1.0)
    mu = np.cos(angle)
    root = np.zeros(count)
    for k, (own, there) in enumerate(
        zip(
            _generate_legendre_polynomials(x, half),
            _generate_legendre_polynomials(mu, half),
            strict=True,
        )
    ):
        root += (2.0 * k + 1.0) * own * there
    peak = weight * root**2
    moments = np.array(
        [(peak * one).sum() for one in _generate_legendre_polynomials(mu, max_order)]
    )
    damped: np.ndarray = moments / moments[0]
    return damped


def _find_largest_zero(order: int) -> float:
    """Return the largest zero of a Legendre polynomial, by Newton's steps from Bessel's zero."""
    x = np.cos(2.404825557695773 / (order + 0.5))
    for _ in range(20):
        *_, before, last = [
            1.0,
            *(float(p[0]) for p in _generate_legendre_polynomials(np.array([x]), order)),
        ]
        step = last * (1.0 - x * x) / (order * (before - x * last))
        x -= step
        if abs(step) < 1e-15:
            break
    return float(x)


def choose_resolving_angles(n_moments: int) -> np.ndarray:
    """Return angles (degrees) between which a phase function of so many moments is nearly linear.

    A tenth of the narrowest peak apart near 0°, and then wider and wider, up to half a degree.
    """
    finest = min(47.5 / max(n_moments, 1), 0.5)
    angles = [0.0]
    while angles[-1] < 180.0:
        angles.append(angles[-1] + min(max(finest, 0.03 * angles[-1]), 0.5))
    angles[-1] = 180.0
    return np.array(angles)


def to_eradiate(optics: xr.Dataset, angle_deg: Any = None) -> xr.Dataset:
    """Return single-scattering properties as particle layers of eradiate take them ("Aer v1").

    A phase function that is smoothed, and linear between angles, is a little less forward than its
    moments say.  Scattering is made less by as much, so that what is turned away and what is
    absorbed per metre are as they were (van de Hulst's similarity).

    Parameters
    ----------
    optics : xarray.Dataset
        As for `phase_function`.
    angle_deg : array_like, optional
        Scattering angles from 0 to 180 degrees; by default as many as the moments need.

    Returns
    -------
    xarray.Dataset
        ``sigma_t`` (1/m) and ``albedo`` over ``w`` (nm), and ``phase`` (1/sr) over ``w``, ``mu``
        (ascending), ``i`` and ``j``: the one element of unpolarized light, which adds up to 1
        between the angles.  ``optical_thickness`` over ``w`` stands beside them: eradiate asks for
        it at one wavelength, ``tau_ref`` at ``w_ref``.

    Raises
    ------
    ValueError
        For angles that miss a peak: between which light does not add up to 1 within 1 %.
    """
    optics = _check_moments(optics)
    angles = choose_resolving_angles(int(optics.order[-1])) if angle_deg is None else angle_deg
    function = phase_function(optics, angles).sortby("angle", ascending=False)
    mu = np.cos(np.radians(function.angle.values))
    phase = function.phase_function.values
    total = 2.0 * np.pi * np.trapezoid(phase, mu, axis=1)
    if np.abs(total - 1.0).max() > 0.01:
        allowed = "fine enough that the phase function adds up to 1 within 1 %"
        raise invalid("angle_deg", f"{len(mu)} angles", allowed, "leave them out")
    phase = phase / total[:, np.newaxis]
    forward = 2.0 * np.pi * np.trapezoid(phase * mu, mu, axis=1)
    extinction = optics.extinction.values
    scattered = extinction * optics[ALBEDO].values
    absorbed = extinction - scattered
    scattered = scattered * (1.0 - optics[MOMENT].values[:, 1]) / (1.0 - forward)
    thinner = (scattered + absorbed) / extinction
    thickness = optics.optical_thickness.values * thinner
    return xr.Dataset(
        {
            "sigma_t": ("w", scattered + absorbed, {"units": "m^-1"}),
            "albedo": ("w", scattered / (scattered + absorbed), {"units": "dimensionless"}),
            "phase": (
                ("w", "mu", "i", "j"), phase[:, :, np.newaxis, np.newaxis],
                {"units": "steradian^-1"},
            ),
            "optical_thickness": ("w", thickness, {"units": "dimensionless"}),
        },
        {
            "w": ("w", optics.wavelength.values, {"units": "nm"}),
            "mu": ("mu", mu, {"units": "dimensionless"}),
            "i": ("i", [0]),
            "j": ("j", [0]),
        },
        {"title": "Particle radiative properties", "source": optics.attrs.get("source", "splits")},
    )  # fmt: skip


def write_libradtran(optics: xr.Dataset, path: str | Path) -> None:
    """Write the optical properties of a layer as libRadtran's ``wc_files`` and ``ic_files`` name.

    A line for each wavelength: nm, extinction (1/km), single-scattering albedo, moments from 0 on.

    Parameters
    ----------
    optics : xarray.Dataset
        As for `phase_function`.
    path : path
        The file appears whole or not at all.
    """
    optics = _check_moments(optics)
    columns = [optics.wavelength.values, 1e3 * optics.extinction.values, optics[ALBEDO].values]
    table = np.column_stack([*columns, optics[MOMENT].values])
    with atomic_write(path) as aside:
        np.savetxt(aside, table, fmt="%.8g", header="nm, 1/km, albedo, Legendre moments from 0 on")


def _check_moments(optics: xr.Dataset) -> xr.Dataset:
    """Return what `splits.single_scattering` returned, moments ascending and last, or refuse it."""
    attrs = optics.attrs if isinstance(optics, xr.Dataset) else {"title": type(optics).__name__}
    if "diffraction" not in attrs or f"{MOMENT}_jackknife" not in optics:
        given = attrs.get("title", "a dataset")
        raise invalid("optics", given, "what splits.single_scattering returns")
    check_no_gaps("optics", optics)
    optics = optics.sortby("order").transpose(..., "wavelength", "order")
    if not np.array_equal(optics.order, np.arange(optics.sizes["order"])):
        allowed = "0, 1, 2, … up to some order"
        raise invalid("optics.order", optics.order.values.tolist(), allowed)
    return optics
