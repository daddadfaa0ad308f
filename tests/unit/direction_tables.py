"""Tables of directions with analytic, reciprocal reflectance factors that peak forward."""

import numpy as np
import xarray as xr

SIZE = "optical_radius_um"
AXES = {
    SIZE: np.array([100.0, 400.0]),
    "incidence_deg": np.array([0.0, 20.0, 40.0, 60.0, 75.0]),
    "polar_deg": np.array([0.0, 15.0, 30.0, 45.0, 60.0, 75.0]),
    "azimuth_deg": np.linspace(0.0, 180.0, 13),
    "wavelength": np.array([500.0, 900.0]),
}
DIMS = {
    "reflectance": (SIZE, "incidence_deg", "wavelength"),
    "reflectance_factor": tuple(AXES),
    "anisotropy_factor": tuple(AXES),
    "diffuse_reflectance": (SIZE, "wavelength"),
    "diffuse_reflectance_factor": (SIZE, "polar_deg", "wavelength"),
    "diffuse_anisotropy_factor": (SIZE, "polar_deg", "wavelength"),
}
"""Axes of each quantity of a table of directions."""


def evaluate_factor(size, incidence_deg, polar_deg, azimuth_deg, wavelength):
    """Return the bidirectional reflectance factor."""
    cosines = np.cos(np.radians(incidence_deg)) * np.cos(np.radians(polar_deg))
    sines = np.sin(np.radians(incidence_deg)) * np.sin(np.radians(polar_deg))
    shape = 1.0 - 0.2 * cosines + 0.5 * sines * np.cos(np.radians(azimuth_deg))
    return evaluate_amplitude(size, wavelength) * shape


def evaluate_reflectance(size, zenith_deg, wavelength):
    """Return the directional-hemispherical, or hemispherical-directional, reflectance."""
    cosine = np.cos(np.radians(zenith_deg))
    return evaluate_amplitude(size, wavelength) * (1.0 - 0.4 / 3.0 * cosine)


def evaluate_amplitude(size, wavelength):
    """Return the common amplitude of all reflectances."""
    return 1.0 - 1e-4 * size - 3e-4 * (wavelength - 400.0)


def make_direction_dataset(**changes):
    """Return the dataset of a table of directions, with other axes where given."""
    axes = AXES | changes
    size, incidence, polar, azimuth, w = (
        xr.DataArray(values, dims=name) for name, values in axes.items()
    )
    factor = evaluate_factor(size, incidence, polar, azimuth, w)
    reflectance = evaluate_reflectance(size, incidence, w)
    values = {
        "reflectance": reflectance,
        "reflectance_factor": factor,
        "anisotropy_factor": factor / reflectance,
        "diffuse_reflectance": evaluate_amplitude(size, w) * (1.0 - 0.8 / 9.0),
        "diffuse_reflectance_factor": evaluate_reflectance(size, polar, w),
    }
    values["diffuse_anisotropy_factor"] = (
        values["diffuse_reflectance_factor"] / values["diffuse_reflectance"]
    )
    variables = {}
    for name, dims in DIMS.items():
        quantity = values[name].transpose(*dims).astype(np.float32)
        variables[name] = (dims, quantity.values, {"long_name": name.replace("_", " ")})
        variables[f"{name}_stderr"] = (dims, 0.01 * quantity.values)
    attrs = {
        "path_sharing_axes": "none", "medium": "snow", "snow_density_kg_m3": 300.0, "seed": 1,
        "physics_sources_sha256": "0" * 64, "date_created": "2026-01-02T03:04:05+00:00",
    }  # fmt: skip
    return xr.Dataset(variables, axes, attrs)
