"""Datasets constructed from formulas, in the format of the results of the package."""

from __future__ import annotations

import numpy as np
import xarray as xr

ASYMMETRY = 0.6
ORDERS = np.arange(201)
AUTHOR = {
    "organization": "Example Institute",
    "location": {"country": "Finland", "city": "Espoo", "street": "Maarintie",
                 "building_nr": "8", "postal_code": "02150"},
    "email": "ada@example.org",
    "contact_person": "Ada Example",
}  # fmt: skip


def make_optics(albedo=0.9, noise=0.0, **attrs):
    """Return grain optics with Henyey-Greenstein moments, from 16 batches of rays."""
    w = np.array([600.0, 1300.0])
    moments = np.broadcast_to(ASYMMETRY**ORDERS, (2, ORDERS.size))
    batches = moments + noise * np.random.default_rng(1).normal(size=(16, *moments.shape))
    batches[..., 0] = 1.0
    dims = ("wavelength", "order")
    variables = {
        "extinction": ("wavelength", np.full(2, 2000.0)),
        "optical_thickness": ("wavelength", np.full(2, 20.0)),
        "single_scattering_albedo": ("wavelength", np.full(2, albedo)),
        "single_scattering_albedo_stderr": ("wavelength", np.full(2, 1e-3)),
        "single_scattering_albedo_jackknife": (("batch", "wavelength"), np.full((16, 2), albedo)),
        "legendre_moment": (dims, moments),
        "legendre_moment_jackknife": (("batch", *dims), batches),
        "legendre_moment_interpolation_bound": (dims, np.zeros_like(moments)),
    }
    attributes = {"medium": "snow", "snow_optical_radius_um": 160.0, "diffraction": "none",
             "extinction_by_grains_per_m": 2000.0} | attrs  # fmt: skip
    return xr.Dataset(variables, {"wavelength": w, "order": ORDERS}, attributes)


def make_brdf(incidence, **keywords):
    """Return a small forward-peaked BRDF in the format of the goniophotometer."""
    polar, azimuth = np.array([0.0, 40.0, 70.0]), np.array([0.0, 90.0, 180.0, 270.0])
    shape = (2, 3, 4)
    forward = np.sin(np.radians(polar))[:, np.newaxis] * np.cos(np.radians(azimuth))
    values = np.broadcast_to(0.3 + 0.05 * forward, shape) * (1.0 + incidence / 90.0)
    grid = ("wavelength", "polar", "azimuth")
    coordinates = {"wavelength": [600.0, 1300.0], "polar": polar, "azimuth": azimuth}
    variables = {"brdf": (grid, values.copy()), "brdf_stderr": (grid, np.full(shape, 0.003))}
    attrs = {
        "medium": "snow", "snow_depth_m": 0.1, "snow_facetness": np.array([0.2, 0.4]),
        "snow_asymmetry_parameter_900nm_dry": 0.678,
        "snow_asymmetry_parameter_900nm_dry_stderr": 0.001,
        "snow_interpretation_entry_point": "uniform",
        "incidence_deg": incidence, "seed": 3, "physics_sources_sha256": "0123456789abcdef",
        "date_created": "2026-11-24T12:00:00+00:00", "title": "BRDF",
    }  # fmt: skip
    return xr.Dataset(variables, coordinates, {**attrs, **keywords})
