"""Dataset of a goniophotometer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import Variable, make_variable
from splits.instruments.angular_estimate import AngularEstimate
from splits.simulation.run_options import make_wavelength_coordinate

BEAM_DISTRIBUTIONS = {
    "brdf": ("bidirectional reflectance distribution function", "sr-1", 0, 1.0),
    "btdf": ("bidirectional transmittance distribution function", "sr-1", 1, 1.0),
    "reflectance_factor": ("bidirectional reflectance factor", "1", 0, np.pi),
}
DIFFUSE_DISTRIBUTIONS = {
    "reflectance_factor": ("hemispherical-directional reflectance factor", "1", 0, np.pi),
    "transmittance_factor": ("hemispherical-directional transmittance factor", "1", 1, np.pi),
}
"""Labels, units and sides of distributions, and factors on the estimate, by illumination."""
BEAM_TOTALS = {
    "reflectance": ("directional-hemispherical reflectance", 0, 0),
    "transmittance": ("directional-hemispherical transmittance", 0, 1),
    "specular_reflectance": ("reflectance without scattering", 2, 0),
    "direct_transmittance": ("transmittance without scattering", 2, 1),
}
DIFFUSE_TOTALS = {
    "reflectance": ("bihemispherical reflectance", 0, 0),
    "transmittance": ("bihemispherical transmittance", 0, 1),
}
"""Labels of hemispherical quantities, their rows in the estimate, and sides, by illumination."""
STOKES_LABELS = {
    "dolp": ("degree of linear polarization", "1"),
    "aolp": ("angle of linear polarization", "degree"),
}
"""Labels and units of variables of polarized light other than Stokes parameters."""
STOKES_SIDES = {"brdf": "reflected", "btdf": "transmitted"}


def make_angular_dataset(
    estimate: AngularEstimate,
    stokes: Mapping[str, tuple[np.ndarray, np.ndarray]],
    wavelengths: np.ndarray,
    angles: tuple[np.ndarray, np.ndarray],
    attributes: dict[str, Any],
    undefined: Collection[str] = (),
) -> xr.Dataset:
    """Return the dataset of an estimate.

    Parameters
    ----------
    estimate : AngularEstimate
    stokes : dict
        Variables of polarized light and their errors by name, shape (wavelengths, directions), see
        `splits.instruments.linear_polarization.StokesEstimate`.
    wavelengths : float, shape (wavelengths,)
        nm.
    angles : (float, float)
        Polar and azimuth angles (degrees); azimuth runs fastest in directions.
    attributes : dict
        With the incidence.
    undefined : collection of str
        Variables that are left out.
    """
    polar, azimuth = angles
    grid = ("wavelength", "polar", "azimuth")
    shape = (len(wavelengths), len(polar), len(azimuth))
    is_diffuse = attributes["incidence_deg"] == "diffuse"
    distributions: dict[str, tuple[str, str, int, Any]] = {
        **(DIFFUSE_DISTRIBUTIONS if is_diffuse else BEAM_DISTRIBUTIONS),
    }
    variables: dict[str, Variable] = {}
    for name, (long_name, units, side, factor) in distributions.items():
        mean = (factor * estimate.mean[side]).reshape(shape)
        stderr = (factor * estimate.stderr[side]).reshape(shape)
        variables |= make_variable(name, grid, mean, stderr, long_name, units)
    mean, stderr = (one.reshape(shape) for one in (estimate.anisotropy, estimate.anisotropy_stderr))
    variables |= make_variable("anisotropy_factor", grid, mean, stderr, "anisotropy factor")
    for name, (values, error) in stokes.items():
        function, _, symbol = name.partition("_")
        label, units = STOKES_LABELS.get(symbol, (f"Stokes {symbol.upper()}", "sr-1"))
        label = f"{label} of {STOKES_SIDES[function]} light"
        variables |= make_variable(
            name, grid, values.reshape(shape), error.reshape(shape), label, units
        )
    for name, (long_name, row, side) in (DIFFUSE_TOTALS if is_diffuse else BEAM_TOTALS).items():
        mean, stderr = estimate.hemispherical[row : row + 2, side]
        variables |= make_variable(name, "wavelength", mean, stderr, long_name)
    azimuth_label = "angle from the direction in which the beam travels"
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "polar": ("polar", polar, {"units": "degree", "long_name": "angle from the normal"}),
        "azimuth": ("azimuth", azimuth, {"units": "degree", "long_name": azimuth_label}),
    }
    # Without a BTDF, its polarization is undefined, too.
    kept = {
        name: variable
        for name, variable in variables.items()
        if name.removesuffix("_stderr") not in undefined
        and not ("btdf" in undefined and name.startswith("btdf"))
    }
    return xr.Dataset(kept, coordinates, attributes)
