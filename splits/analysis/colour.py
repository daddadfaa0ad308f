"""Colours of reflectance spectra: CIE 1931 tristimulus values, CIELAB and sRGB."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import xarray as xr

OBSERVER = "CIE 1931 2 Degree Standard Observer"
ILLUMINANT = "D65"
VISIBLE_NM = (400.0, 780.0)
"""Range a spectrum must cover; beyond it, 360 to 830 nm, its end values are taken, which weigh less
than 1e-3 of Y."""


def tristimulus(wavelength_nm: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """Return X, Y, Z of a reflecting surface, Y = 1 for a perfect white one.

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
    Integration as of CIE 15 in steps of 1 nm by colour-science, under D65 for the 2° observer.
    """
    import colour

    wavelength = np.asarray(wavelength_nm, dtype=float)
    low, high = VISIBLE_NM
    if wavelength[0] > low or wavelength[-1] < high or np.diff(wavelength).max() > 10.0:
        raise ValueError(
            f"wavelength_nm: must cover {low:g} to {high:g} nm in steps of at most 10 nm to have "
            "a colour"
        )
    observer = colour.MSDS_CMFS[OBSERVER]
    grid = observer.wavelengths
    spectrum = colour.SpectralDistribution(
        dict(zip(grid, np.interp(grid, wavelength, reflectance), strict=True))
    )
    light = colour.SDS_ILLUMINANTS[ILLUMINANT].copy().align(observer.shape)
    xyz = colour.sd_to_XYZ(spectrum, observer, light, method="Integration")
    return np.asarray(xyz) / 100.0


def lab(xyz: np.ndarray) -> np.ndarray:
    """Return CIELAB L*, a*, b* of tristimulus values under D65."""
    import colour

    white = colour.CCS_ILLUMINANTS[OBSERVER][ILLUMINANT]
    return np.asarray(colour.XYZ_to_Lab(xyz, white))


def srgb(xyz: np.ndarray) -> np.ndarray:
    """Return sRGB in [0, 1]; a colour outside its gamut is moved to the nearest side of it."""
    import colour

    return np.clip(np.asarray(colour.XYZ_to_sRGB(xyz)), 0.0, 1.0)


def colours(dataset: xr.Dataset) -> pd.DataFrame:
    """Return the colour of every point of a grid.

    Errors of L*, a*, b* are half the distance between the colours of the spectrum one standard
    error up and one down: along a spectrum errors go together.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` and its error over grid parameters and wavelength.

    Returns
    -------
    pandas.DataFrame
        A row per point: the grid's labels, X, Y, Z, L, a, b, their ``_stderr``, red, green, blue
        and ``srgb`` as hexadecimal code.
    """
    dims = [str(d) for d in dataset.reflectance.dims if d != "wavelength"]
    rows = []
    for labels in itertools.product(*(dataset[d].values for d in dims)):
        point = dataset.sel(dict(zip(dims, labels, strict=True)))
        x, r, e = (point[v].values for v in ("wavelength", "reflectance", "reflectance_stderr"))
        xyz = tristimulus(x, r)
        spread = 0.5 * np.abs(lab(tristimulus(x, r + e)) - lab(tristimulus(x, r - e)))
        code = srgb(xyz)
        row = dict(zip(dims, labels, strict=True))
        row |= dict(zip("XYZ", xyz, strict=True))
        for name, value, error in zip("Lab", lab(xyz), spread, strict=True):
            row[name], row[f"{name}_stderr"] = value, error
        row |= dict(zip(("red", "green", "blue"), code, strict=True))
        row["srgb"] = "#" + "".join(f"{round(255 * c):02x}" for c in code)
        rows.append(row)
    return pd.DataFrame(rows)
