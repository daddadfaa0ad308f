"""Dataset of a goniophotometer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import Variable, make_variable
from splits.instruments.angular_estimate import AngularEstimate
from splits.simulation.run_options import make_wavelength_coordinate


def make_angular_dataset(
    estimate: AngularEstimate,
    stokes: Mapping[str, tuple[np.ndarray, np.ndarray]],
    wavelengths: np.ndarray,
    angles: tuple[np.ndarray, np.ndarray],
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return the dataset of an estimate.

    Parameters
    ----------
    estimate : AngularEstimate
    stokes : dict
        Stokes parameters and their errors by name, shape (wavelengths, directions).
    wavelengths : float, shape (wavelengths,)
        nm.
    angles : (float, float)
        Polar and azimuth angles (degrees); azimuth runs fastest in directions.
    attributes : dict
    """
    polar, azimuth = angles
    grid = ("wavelength", "polar", "azimuth")
    shape = (len(wavelengths), len(polar), len(azimuth))
    scattered = estimate.compute_scattered()[0][:, np.newaxis]
    anisotropy_scale = np.divide(
        np.pi, scattered, out=np.zeros_like(scattered), where=scattered > 0.0
    )
    variables: dict[str, Variable] = {}
    directional = {
        "brdf": ("bidirectional reflectance distribution function", "sr-1", 0, 1.0),
        "btdf": ("bidirectional transmittance distribution function", "sr-1", 1, 1.0),
        "reflectance_factor": ("bidirectional reflectance factor", "1", 0, np.pi),
        "anisotropy_factor": ("anisotropy factor", "1", 0, anisotropy_scale),
    }
    for name, (long_name, units, side, factor) in directional.items():
        mean = (factor * estimate.mean[side]).reshape(shape)
        stderr = (factor * estimate.stderr[side]).reshape(shape)
        variables |= make_variable(name, grid, mean, stderr, long_name, units)
    for name, (values, error) in stokes.items():
        component = name[-1].upper()
        label = f"Stokes {component} of the light of the {name[:4].upper()}"
        variables |= make_variable(
            name, grid, values.reshape(shape), error.reshape(shape), label, "sr-1"
        )
    hemispherical = {
        "reflectance": ("directional-hemispherical reflectance", 0, 0),
        "transmittance": ("directional-hemispherical transmittance", 0, 1),
        "specular_reflectance": ("reflectance without scattering", 2, 0),
        "direct_transmittance": ("transmittance without scattering", 2, 1),
    }
    for name, (long_name, row, side) in hemispherical.items():
        mean, stderr = estimate.hemispherical[row : row + 2, side]
        variables |= make_variable(name, "wavelength", mean, stderr, long_name)
    angle_attributes = {"units": "degree"}
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "polar": ("polar", polar, {**angle_attributes, "long_name": "angle from the normal"}),
        "azimuth": (
            "azimuth",
            azimuth,
            {**angle_attributes, "long_name": "angle from the direction in which the beam travels"},
        ),
    }
    return xr.Dataset(variables, coordinates, attributes)


def relabel_for_diffuse_light(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset with the quantities and terms for diffuse illumination."""
    relabelled = dataset
    if "btdf" in dataset:
        for suffix in ("", "_stderr"):
            relabelled = relabelled.assign(
                {f"transmittance_factor{suffix}": np.pi * relabelled[f"btdf{suffix}"]}
            )
    terms = {
        "reflectance_factor": "hemispherical-directional reflectance factor",
        "transmittance_factor": "hemispherical-directional transmittance factor",
        "reflectance": "bihemispherical reflectance",
        "transmittance": "bihemispherical transmittance",
    }
    for name, term in terms.items():
        if name in relabelled:
            attributes = {"long_name": term, "units": "1", "ancillary_variables": f"{name}_stderr"}
            relabelled[name].attrs = attributes
            relabelled[f"{name}_stderr"].attrs = {
                "long_name": f"standard error of {term}", "units": "1"
            }  # fmt: skip
    beam_quantities = ("brdf", "btdf", "specular_reflectance", "direct_transmittance")
    names = [name + suffix for name in beam_quantities for suffix in ("", "_stderr")]
    return relabelled.drop_vars([name for name in names if name in relabelled])
