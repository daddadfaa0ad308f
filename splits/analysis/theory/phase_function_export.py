"""Export of phase functions to Eradiate and libRadtran."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.theory.phase_function import (
    ALBEDO,
    MOMENT,
    check_moments,
    choose_resolving_angles,
    phase_function,
)
from splits.core.atomic import atomic_write
from splits.core.validation import invalid


def to_eradiate(optics: xr.Dataset, angle_deg: Any = None) -> xr.Dataset:
    """Return single-scattering properties in the format of eradiate's particle layers ("Aer v1").

    A smoothed phase function with linear interpolation between angles has a slightly smaller
    asymmetry than its moments.  Scattering is reduced accordingly, so that transport scattering and
    absorption per metre are conserved (similarity relation of van de Hulst).

    Parameters
    ----------
    optics : xarray.Dataset
        As for `phase_function`.
    angle_deg : array_like, optional
        Scattering angles from 0 to 180 degrees; by default enough for the moments.

    Returns
    -------
    xarray.Dataset
        ``sigma_t`` (1/m) and ``albedo`` over ``w`` (nm), and ``phase`` (1/sr) over ``w``, ``mu``
        (ascending), ``i`` and ``j``: the element of unpolarized light, normalized to 1.
        ``optical_thickness`` over ``w`` is included for eradiate's ``tau_ref`` at ``w_ref``.

    Raises
    ------
    ValueError
        For angles that do not resolve a peak, so that the normalization deviates by more than 1 %.
    """
    optics = check_moments(optics)
    angles = choose_resolving_angles(int(optics.order[-1])) if angle_deg is None else angle_deg
    function = phase_function(optics, angles).sortby("angle", ascending=False)
    mu = np.cos(np.radians(function.angle.values))
    phase = function.phase_function.values
    total = 2.0 * np.pi * np.trapezoid(phase, mu, axis=1)
    if np.abs(total - 1.0).max() > 0.01:
        allowed = "fine enough to normalize the phase function within 1 %"
        raise invalid("angle_deg", f"{len(mu)} angles", allowed, "leave them out")
    phase = phase / total[:, np.newaxis]
    forward = 2.0 * np.pi * np.trapezoid(phase * mu, mu, axis=1)
    extinction = optics.extinction.values
    scattered = extinction * optics[ALBEDO].values
    absorbed = extinction - scattered
    scattered = scattered * (1.0 - optics[MOMENT].values[:, 1]) / (1.0 - forward)
    ratio = (scattered + absorbed) / extinction
    thickness = {}
    if "optical_thickness" in optics:
        values = optics.optical_thickness.values * ratio
        thickness["optical_thickness"] = ("w", values, {"units": "dimensionless"})
    return xr.Dataset(
        {
            "sigma_t": ("w", scattered + absorbed, {"units": "m^-1"}),
            "albedo": ("w", scattered / (scattered + absorbed), {"units": "dimensionless"}),
            "phase": (
                ("w", "mu", "i", "j"), phase[:, :, np.newaxis, np.newaxis],
                {"units": "steradian^-1"},
            ),
            **thickness,
        },
        {
            "w": ("w", optics.wavelength.values, {"units": "nm"}),
            "mu": ("mu", mu, {"units": "dimensionless"}),
            "i": ("i", [0]),
            "j": ("j", [0]),
        },
        {"title": "Particle radiative properties", "source": optics.attrs.get("source", "splits")},
    )  # fmt: skip


def write_libradtran(optics: xr.Dataset, path: str | Path) -> None:
    """Write the optical properties of a layer for libRadtran's ``wc_files`` and ``ic_files``.

    Each line has wavelength (nm), extinction (1/km), single-scattering albedo, moments from 0 on.

    Parameters
    ----------
    optics : xarray.Dataset
        As for `phase_function`.
    path : path
        The file is written atomically.
    """
    optics = check_moments(optics)
    columns = [optics.wavelength.values, 1e3 * optics.extinction.values, optics[ALBEDO].values]
    table = np.column_stack([*columns, optics[MOMENT].values])
    with atomic_write(path) as temporary_path:
        np.savetxt(
            temporary_path, table, fmt="%.8g", header="nm, 1/km, albedo, Legendre moments from 0 on"
        )
