"""Lookup tables computed from analytic spectra, so that their values are known exactly."""

import numpy as np
import xarray as xr

import splits

W = np.linspace(500.0, 1500.0, 11)


def evaluate_spectrum(size, soot_ng_g, w=W):
    """Return a snow-like reflectance that decreases with grain size and, below 1 µm, with soot."""
    ice_absorption = 10.0 ** (-4.0 + 4.0 * (w - 500.0) / 1000.0)
    soot_absorption = (500.0 / w) ** 2
    return np.exp(
        -4.0 * np.sqrt(size / 200.0 * (ice_absorption + 1e-5 * soot_ng_g * soot_absorption))
    )


def make_table(evaluate, axes, stderr=1e-4, w=W):
    """Return a table of the spectra that a function of the axes gives."""
    names, rows = list(axes), [np.asarray(row, dtype=float) for row in axes.values()]
    grids = np.meshgrid(*rows, indexing="ij")
    points = np.stack([grid.ravel() for grid in grids], axis=1)
    values = np.array([evaluate(*point) for point in points]).reshape(*grids[0].shape, w.size)
    dims = (*names, "wavelength")
    attributes = {"long_name": "reflectance", "units": "1"}
    return splits.Table(
        xr.Dataset(
            {
                "reflectance": (dims, values.astype(np.float32), attributes),
                "reflectance_stderr": (dims, np.full(values.shape, stderr, np.float32), attributes),
            },
            {**dict(zip(names, rows, strict=True)), "wavelength": w},
            {"path_sharing_axes": "none", "title": "a formula"},
        )
    )


def make_snowlike_table(stderr=1e-4):
    """Return a table of `evaluate_spectrum` whose interpolation is exact to 1e-4."""
    axes = {
        "optical_radius_um": np.geomspace(40.0, 2000.0, 14),
        "impurities_ng_g.black_carbon": np.linspace(0.0, 40.0, 14) ** 2,
        "incidence_deg": [0.0, 30.0, 60.0],
    }
    return make_table(lambda size, soot_ng_g, _: evaluate_spectrum(size, soot_ng_g), axes, stderr)
