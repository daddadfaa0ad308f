"""Asymptotic radiative transfer theory of snow, and corrections of optics for theories.

Discrete ordinates are in `splits.analysis.theory.discrete_ordinates`.  Both theories assume point
scatterers.  In the interpretations of the papers, a ray leaves a grain at its exit point, and a
grain that overlaps the last segment or a boundary is sampled again.  In all interpretations, the
boundaries of wet pores reflect light.  docs/theory/radiative-transfer.md quantifies the effects.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.theory.error_propagation import (
    BOUND_SUFFIX,
    JACKKNIFE_SUFFIX,
    compute_interpolation_bound,
    compute_jackknife_results,
    propagate_errors,
)
from splits.core.arrays import as_1d_array, as_float_array
from splits.core.optional import import_optional
from splits.core.uncertainty import make_variable
from splits.core.validation import check_choice, check_range
from splits.simulation.deep_medium import effective_mean_free_path

EXTRAPOLATION_LENGTH = 1.072
"""Extrapolation length of a half-space times 3/2, see `kz04`."""


def correct_dense_packing(optics: xr.Dataset) -> xr.Dataset:
    """Return optics with an optical thickness corrected for path lengths inside grains.

    Radiative transfer has path lengths between grains only, while rays of the model also advance
    inside grains: see `splits.simulation.deep_medium.effective_mean_free_path`.

    Parameters
    ----------
    optics : xarray.Dataset
        From `splits.instruments.single_scattering`.

    Returns
    -------
    xarray.Dataset
        A copy with corrected ``extinction`` and ``optical_thickness``, and their standard errors
        ``…_stderr``.  The optical thickness remains proportional to depth.
    """
    ratio = _compute_packing_ratio(optics)
    jackknife, bound = (
        compute_jackknife_results(_compute_packing_ratio, optics),
        compute_interpolation_bound(_compute_packing_ratio, optics),
    )
    error = propagate_errors(_compute_packing_ratio, optics)
    variables: dict[str, Any] = {}
    for name in {"extinction", "optical_thickness"} & {*optics}:
        value, label = optics[name].values, f"{name.replace('_', ' ')}, paths in grains included"
        units = optics[name].attrs.get("units", "1")
        variables |= make_variable(name, "wavelength", value * ratio, value * error, label, units)
        variables[name + BOUND_SUFFIX] = ("wavelength", value * bound)
        if jackknife is not None:
            variables[name + JACKKNIFE_SUFFIX] = (("batch", "wavelength"), value * jackknife)
    return optics.assign(variables)


def _compute_packing_ratio(optics: xr.Dataset) -> np.ndarray:
    """Return the ratio of the mean distance between grains to that of `correct_dense_packing`."""
    return 1.0 / optics.extinction.values / effective_mean_free_path(optics)


def kz04(
    wavelength_nm: Any,
    ssa_m2_kg: float,
    incidence_deg: float | str = 0.0,
    *,
    extinction_coefficient: Any = "p2016",
    absorption_enhancement: Any = 1.6,
    asymmetry: Any = 0.845,
    density_kg_m3: float = 300.0,
    depth_m: float = np.inf,
) -> xr.Dataset:
    """Return reflectance and transmittance of dry snow by asymptotic theory (`snowoptics`).

    Reflectance of a half-space by `snowoptics.albedo_KZ04`, R∞ = exp(−y u), with y² =
    16 (1 − ω)/(3 (1 − g)) and u = 3/7 (1 + 2 cosθ), 1 under diffuse light; a finite layer of
    transport thickness x = √(3 (1 − ω)(1 − g)) τ has

        T = u sinh(y) / sinh(x + 1.072 y),    R = R∞ − T exp(−x − y).

    It is valid for weak absorption (small k d, R above about 0.6) and, if finite, τ (1 − g) > 1.

    Parameters
    ----------
    wavelength_nm : array_like
        Vacuum wavelengths (nm).
    ssa_m2_kg : float
        Specific surface area (m²/kg), see `splits.Snow.specific_surface_area_m2_kg`.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.99 degrees, or isotropic diffuse light.
    extinction_coefficient : array_like or str
        k of ice at the wavelengths, or the name of one of the package's datasets.
    absorption_enhancement, asymmetry : float or array_like
        Shape factors B and g with diffraction; the defaults are those of snowoptics, fitted to
        natural snow.  `compute_shape_factors` gives those of a medium.
    density_kg_m3 : float
        Density of the snow, for a finite depth.
    depth_m : float
        Depth above 0 (m), which may be infinite.

    Returns
    -------
    xarray.Dataset
        ``reflectance`` and ``transmittance`` over ``wavelength``.

    References
    ----------
    Kokhanovsky & Zege (2004), Applied Optics 43, 1589, doi:10.1364/AO.43.001589; for the finite
    layer Kokhanovsky & Nauss (2006), Atmospheric Chemistry and Physics 6, 5537; B and g from
    Libois et al. (2013), The Cryosphere 7, 1803.
    """
    snowoptics = import_optional("snowoptics", "theory", "analytical theories need")
    cosine = compute_incidence_cosine(incidence_deg)
    ssa = check_range("ssa_m2_kg", ssa_m2_kg, 0.0, np.inf, "m2/kg", open_low=True)
    if depth_m != np.inf:
        check_range("depth_m", depth_m, 0.0, np.inf, "m", open_low=True)
    wavelengths = as_1d_array("wavelength_nm", wavelength_nm, "numbers in nanometres")
    wavelength_m = wavelengths * 1e-9
    ni = extinction_coefficient
    if not isinstance(ni, str):
        ni = np.broadcast_to(as_float_array("extinction_coefficient", ni), wavelength_m.shape)
    shape = {"ni": ni, "B": absorption_enhancement, "g": asymmetry}
    half_space = snowoptics.albedo_KZ04(
        wavelength_m, np.arccos(cosine or 1.0), ssa, r_difftot=float(cosine is None), **shape
    )
    # The formula is singular at y = 0, where its limit is finite.
    y = np.maximum(np.sqrt(snowoptics.compute_alpha(wavelength_m, ssa, **shape)), 1e-9)
    # From snowoptics' own extinction, ρ SSA/2, and y: x/y = 3/4 (1 − g) τ.
    x = 0.0
    transmittance = np.zeros_like(y)
    if depth_m != np.inf:
        x = 0.75 * (1.0 - np.asarray(asymmetry)) * 0.5 * density_kg_m3 * ssa * depth_m * y
        escape = 1.0 if cosine is None else 3.0 / 7.0 * (1.0 + 2.0 * cosine)
        # sinh y / sinh(x + 1.072 y), without overflow.
        lower = x + EXTRAPOLATION_LENGTH * y
        transmittance = escape * np.exp(y - lower) * np.expm1(-2.0 * y) / np.expm1(-2.0 * lower)
    reflectance = half_space - transmittance * np.exp(-x - y)
    return xr.Dataset(
        {
            "reflectance": ("wavelength", reflectance),
            "transmittance": ("wavelength", transmittance),
        },
        {"wavelength": wavelengths},
        {"theory": "Kokhanovsky & Zege (2004)", "incidence_deg": incidence_deg},
    )


def compute_shape_factors(
    optics: xr.Dataset, ssa_m2_kg: float, extinction_coefficient: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the absorption enhancement B and the asymmetry g of a medium with diffraction.

    With them, `kz04` has the (1 − ω)/(1 − g) of the medium.  B is constant for weak absorption.
    Smooth ice spheres have B = 1.25 and g = 0.89.

    Parameters
    ----------
    optics : xarray.Dataset
        From `splits.instruments.single_scattering`, of a dry medium.
    ssa_m2_kg : float
        Specific surface area (m²/kg).
    extinction_coefficient : array_like
        k of ice at the wavelengths, above 0.
    """
    gamma = 4.0 * np.pi * np.asarray(extinction_coefficient) / (optics.wavelength.values * 1e-9)
    coalbedo = 1.0 - optics.single_scattering_albedo.values
    # snowoptics: 1 − ω' = 2 B γ/(SSA ρ) with ρ = 917 kg/m³, and diffraction halves 1 − ω.
    return 0.25 * coalbedo * ssa_m2_kg * 917.0 / gamma, 0.5 * (
        1.0 + optics.asymmetry_parameter.values
    )


def compute_incidence_cosine(incidence_deg: float | str) -> float | None:
    """Return the cosine of incidence, or None for diffuse light."""
    if isinstance(incidence_deg, str):
        check_choice("incidence_deg", incidence_deg, ["diffuse"])
        return None
    return float(
        np.cos(np.radians(check_range("incidence_deg", incidence_deg, 0.0, 89.99, "degrees")))
    )
