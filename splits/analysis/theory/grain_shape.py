"""The optical shape of grains: how much they absorb and how far they turn light, for their surface.

Where little is absorbed, a grain's shape counts by two numbers only.  The absorption enhancement B
tells how much longer light stays in ice than along straight lines,

    1 − ω = B γ/K,    γ = 4πk/λ,

ω the single-scattering albedo, K the cross-section per volume of grains.  The asymmetry parameter
g is that of geometric optics, without diffraction.  The albedo of a deep pack depends on B/(1 − g)
(Libois et al. 2013, The Cryosphere 7, 1803; Robledano et al. 2023, Nature Communications 14, 3955).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_jackknife_stderr
from splits.core.validation import invalid
from splits.instruments import single_scattering
from splits.media import Snow

DEFAULT_WAVELENGTH_NM = 900.0
"""Where Robledano et al. measured; a hundredth of the light that meets a grain is absorbed."""


class EstimatedValue(NamedTuple):
    """A number and its standard error."""

    value: float
    stderr: float


class OpticalShape(NamedTuple):
    """What a shape does to light.

    Attributes
    ----------
    absorption_enhancement : Measured
        B.
    asymmetry_parameter : Measured
        g, without diffraction.
    b_over_1_minus_g : Measured
        B/(1 − g).
    """

    absorption_enhancement: EstimatedValue
    asymmetry_parameter: EstimatedValue
    b_over_1_minus_g: EstimatedValue


def compute_optical_shape(
    snow: Snow, wavelength_nm: float = DEFAULT_WAVELENGTH_NM, rays: int = 65_536, seed: int = 1,
    threads: int | None = None,
) -> OpticalShape:  # fmt: skip
    """Return the optical shape of the grains of dry snow.

    Parameters
    ----------
    snow : Snow
        Without water or other media in its pores, and without impurities.
    wavelength_nm : float
        Where ice absorbs little of what meets a grain (nm).
    rays : int
        As for `splits.single_scattering`, as the others are.
    seed : int
    threads : int, optional

    Raises
    ------
    ValueError
        For wet or dirty snow, or a wavelength at which ice does not absorb at all.
    """
    if snow.saturation > 0.0 or snow.pores:
        raise invalid("saturation", snow.saturation, "0: the shape is that of dry grains")
    if snow.impurities_ng_g or snow.algae_cells_ml:
        raise invalid("impurities_ng_g", dict(snow.impurities_ng_g), "empty")
    k = float(snow.refractive_index["ice"](np.array([wavelength_nm]))[0].imag)
    if k <= 0.0:
        raise invalid("wavelength_nm", wavelength_nm, "where ice absorbs")
    found = single_scattering(
        snow, [wavelength_nm], moments=1, rays=rays, seed=seed, threads=threads
    )
    scale = snow.attenuation_per_m / (4.0 * np.pi * k / (wavelength_nm * 1e-9))

    def shape(albedo: np.ndarray, asymmetry: np.ndarray) -> np.ndarray:
        enhancement = (1.0 - albedo) * scale
        return np.array([enhancement, asymmetry, enhancement / (1.0 - asymmetry)])

    names = ("single_scattering_albedo", "asymmetry_parameter")
    values = shape(*(found[name].values[0] for name in names))
    left_out = shape(*(found[f"{name}_jackknife"].values[:, 0] for name in names))
    errors = compute_jackknife_stderr(left_out.T)
    return OpticalShape(
        *(EstimatedValue(float(v), float(e)) for v, e in zip(values, errors, strict=True))
    )
