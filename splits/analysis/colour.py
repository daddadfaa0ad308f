"""Colours of reflectance spectra: CIE 1931 tristimulus values, CIELAB and sRGB."""

from __future__ import annotations

import itertools
from functools import cache
from types import ModuleType

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import read_columns
from splits.core.inputs import ResultDataset
from splits.core.keywords import declare_function
from splits.core.optional import import_optional
from splits.core.validation import ROUNDING_TOLERANCE, invalid, join_names, snap_to_limits

STANDARD_OBSERVER = "CIE 1931 2 Degree Standard Observer"
STANDARD_ILLUMINANT = "D65"
MAX_STEP_NM = 10.0
"""Largest step of wavelengths for a colour (nm)."""
VISIBLE_RANGE_NM = (400.0, 780.0)
"""Range that a spectrum must cover.  Outside it, from 360 to 830 nm, its end values are used, which
contribute less than 1e-3 of Y."""


def _import_colour() -> ModuleType:
    # Its import sets the options with which NumPy prints to those of an old version.
    with np.printoptions():
        return import_optional("colour", "figures", "colours need")


def covers_visible(wavelength_nm: np.ndarray) -> bool:
    """Return whether increasing wavelengths (nm) suffice for a colour."""
    first, last = wavelength_nm[[0, -1]]
    low, high = snap_to_limits(VISIBLE_RANGE_NM, first, last)
    is_fine = np.diff(wavelength_nm).max(initial=0.0) <= MAX_STEP_NM * (1.0 + ROUNDING_TOLERANCE)
    return bool(first <= low and high <= last and is_fine)


def compute_tristimulus(wavelength_nm: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """Return X, Y, Z of a reflecting surface, with Y = 1 for a perfect white one.

    Parameters
    ----------
    wavelength_nm : array_like
        Equidistant, 10 nm apart or less, covering 400 to 780 nm.
    reflectance : array_like
        Same length.

    Raises
    ------
    ValueError
        If the spectrum does not cover the visible range.

    Notes
    -----
    The integration follows CIE 15 in steps of 1 nm (colour-science), for D65 and the 2° observer.
    """
    colour = _import_colour()

    columns = {"wavelength_nm": wavelength_nm, "reflectance": reflectance}
    wavelength, reflectance = read_columns("spectrum", columns)
    low, high = VISIBLE_RANGE_NM
    if not covers_visible(wavelength):
        allowed = f"over {low:g} to {high:g} nm in steps of at most {MAX_STEP_NM:g} nm"
        given = [float(wavelength[0]), float(wavelength[-1])]
        raise invalid("wavelength_nm", given, allowed, "others have no colour")
    observer = colour.MSDS_CMFS[STANDARD_OBSERVER]
    grid = observer.wavelengths
    spectrum = colour.SpectralDistribution(
        dict(zip(grid, np.interp(grid, wavelength, reflectance), strict=True))
    )
    light = colour.SDS_ILLUMINANTS[STANDARD_ILLUMINANT].copy().align(observer.shape)
    xyz = colour.sd_to_XYZ(spectrum, observer, light, method="Integration")
    return np.asarray(xyz) / 100.0


def to_cielab(xyz: np.ndarray) -> np.ndarray:
    """Return CIELAB L*, a*, b* of tristimulus values under D65."""
    colour = _import_colour()

    white = colour.CCS_ILLUMINANTS[STANDARD_OBSERVER][STANDARD_ILLUMINANT]
    return np.asarray(colour.XYZ_to_Lab(xyz, white))


def to_srgb(xyz: np.ndarray) -> np.ndarray:
    """Return sRGB in [0, 1]; colours outside its gamut are clipped."""
    colour = _import_colour()

    return np.clip(np.asarray(colour.XYZ_to_sRGB(xyz)), 0.0, 1.0)


def compute_cielab_gradient(xyz: np.ndarray) -> np.ndarray:
    """Return the derivatives of L*, a*, b* (rows) by X, Y, Z (columns)."""
    # The curvature of CIELAB scales with its argument: a fixed step loses digits in dark colours.
    steps = np.diag(1e-4 * np.maximum(xyz, 1e-4))
    return (
        (to_cielab(xyz + steps) - to_cielab(xyz - steps)) / (2.0 * np.diag(steps)[:, np.newaxis])
    ).T


@cache
def _compute_tristimulus_weights(wavelength_nm: tuple[float, ...]) -> np.ndarray:
    """Return the weights of wavelengths in X, Y, Z, shape (3, wavelengths)."""
    wavelength = np.array(wavelength_nm)
    return np.stack(
        [compute_tristimulus(wavelength, unit) for unit in np.eye(len(wavelength))], axis=1
    )


@declare_function
def make_colour_table(dataset: ResultDataset) -> pd.DataFrame:
    """Return the colour of every point of a grid.

    Errors of L*, a*, b* are propagated linearly from the spectrum, with the correlations of
    `splits.core.uncertainty.Errors.split`.  A bound on the error that is not random is
    stated separately: a* and b* are differences along the spectrum, for which it may exceed the
    scatter.  For paths, this is the error of interpolation between refractive indices.  For
    discrete ordinates, and without ``reflectance_batches``, it is the whole error.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` and its error over grid parameters and wavelength.

    Returns
    -------
    pandas.DataFrame
        A row per point: the grid's labels, X, Y, Z; L, a, b with ``_stderr``, the scatter between
        runs with other seeds, and ``_error_bound``, a bound on the rest of the error; red, green,
        blue and ``srgb`` as hexadecimal code.
    """
    if "reflectance" not in dataset:
        raise invalid("dataset", f"of {join_names(map(str, dataset))}", "with reflectance")
    dims = [str(dim) for dim in dataset.reflectance.dims if dim != "wavelength"]
    rows = []
    for labels in itertools.product(*(dataset[dim].values for dim in dims)):
        point = dataset.sel(dict(zip(dims, labels, strict=True)))
        x, r = (point[v].values for v in ("wavelength", "reflectance"))
        xyz = compute_tristimulus(x, r)
        weights = xr.DataArray(
            compute_cielab_gradient(xyz) @ _compute_tristimulus_weights(tuple(x)),
            {"wavelength": x},
            ("coordinate", "wavelength"),
        )
        scatter, bound = point.errors.split("reflectance", weights)
        code = to_srgb(xyz)
        row = dict(zip(dims, labels, strict=True))
        row |= dict(zip("XYZ", xyz, strict=True))
        for i, (name, value) in enumerate(zip("Lab", to_cielab(xyz), strict=True)):
            row[name] = value
            row[f"{name}_stderr"], row[f"{name}_error_bound"] = (
                float(scatter[i]),
                float(bound[i]),
            )
        row |= dict(zip(("red", "green", "blue"), code, strict=True))
        row["srgb"] = "#" + "".join(f"{round(255 * c):02x}" for c in code)
        rows.append(row)
    return pd.DataFrame(rows)
