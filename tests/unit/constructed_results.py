"""Datasets constructed from formulas, in the format of the results of the package."""

import numpy as np
import xarray as xr

ASYMMETRY = 0.6
ORDERS = np.arange(201)


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
        "legendre_moment_interpolation_error_bound": (dims, np.zeros_like(moments)),
    }
    attributes = {"medium": "snow", "snow_optical_radius_um": 160.0, "diffraction": "none",
             "extinction_by_grains_per_m": 2000.0} | attrs  # fmt: skip
    return xr.Dataset(variables, {"wavelength": w, "order": ORDERS}, attributes)
