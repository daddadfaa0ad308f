"""Optical shape factors of grains: absorption enhancement and asymmetry parameter.

For weak absorption, the shape of grains enters by two numbers only.  The absorption enhancement B
is the ratio of path lengths in ice to those of straight lines,

    1 − ω = B γ/K,    γ = 4πk/λ,

with the single-scattering albedo ω and the cross-section K per volume of grains.  The asymmetry
parameter g is that of geometric optics, without diffraction.  The albedo of a semi-infinite
snowpack depends on B/(1 − g) (Libois et al. 2013, The Cryosphere 7, 1803; Robledano et al. 2023,
Nature Communications 14, 3955).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.inputs import RayCount, Seed, Threads
from splits.core.keywords import declare_function
from splits.core.uncertainty import compute_jackknife_stderr
from splits.core.validation import check_relations
from splits.instruments.single_scattering import single_scattering
from splits.media import Snow

DEFAULT_WAVELENGTH_NM = 900.0
"""Wavelength of Robledano et al.; a grain absorbs about a hundredth of the incident light."""


class EstimatedValue(NamedTuple):
    """A value and its standard error."""

    value: float
    stderr: float


class OpticalShape(NamedTuple):
    """Optical shape factors of grains.

    Attributes
    ----------
    absorption_enhancement : EstimatedValue
        B.
    asymmetry_parameter : EstimatedValue
        g, without diffraction.
    b_over_1_minus_g : EstimatedValue
        B/(1 − g).
    """

    absorption_enhancement: EstimatedValue
    asymmetry_parameter: EstimatedValue
    b_over_1_minus_g: EstimatedValue


@declare_function
def compute_optical_shape(
    snow: Snow,
    wavelength_nm: float = DEFAULT_WAVELENGTH_NM,
    *,
    rays: RayCount = 65_536,
    seed: Seed = 1,
    threads: Threads = None,
) -> OpticalShape:
    """Return the optical shape factors of the grains of dry snow.

    Parameters
    ----------
    snow : Snow
        Snow without water or other media in its pores, and without impurities.
    wavelength_nm : float
        Wavelength (nm) at which ice absorbs weakly.
    rays : int
        As for `splits.single_scattering`, like `seed` and `threads`.
    seed : int
    threads : int, optional

    Raises
    ------
    ValueError
        For wet snow, impurities, or a wavelength at which ice does not absorb.
    """
    is_dry, impurities = not (snow.saturation or snow.pores), dict(snow.impurities_ng_g)
    k = float(snow.refractive_index["ice"](np.array([wavelength_nm]))[0].imag)
    check_relations(
        (is_dry, "saturation", snow.saturation, "0, as shape factors are those of dry grains"),
        (not (impurities or snow.algae_cells_ml), "impurities_ng_g", impurities, "empty"),
        (k > 0.0, "wavelength_nm", wavelength_nm, "where ice absorbs"),
    )
    optics = single_scattering(
        snow, [wavelength_nm], moments=1, rays=rays, seed=seed, threads=threads
    )
    scale = snow.attenuation_per_m / (4.0 * np.pi * k / (wavelength_nm * 1e-9))

    def compute_factors(albedo: np.ndarray, asymmetry: np.ndarray) -> np.ndarray:
        enhancement = (1.0 - albedo) * scale
        return np.array([enhancement, asymmetry, enhancement / (1.0 - asymmetry)])

    names = ("single_scattering_albedo", "asymmetry_parameter")
    values = compute_factors(*(optics[name].values[0] for name in names))
    jackknife = compute_factors(*(optics[f"{name}_jackknife"].values[:, 0] for name in names))
    errors = compute_jackknife_stderr(jackknife.T)
    return OpticalShape(
        *(
            EstimatedValue(float(value), float(stderr))
            for value, stderr in zip(values, errors, strict=True)
        )
    )
