"""Conversion of tables of directions to the tabulated BRDF of eradiate."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.validation import (
    ROUNDING_TOLERANCE,
    check_integer,
    check_number,
    invalid,
    snap_to_limits,
)
from splits.tables.axes import INCIDENCE
from splits.tables.interpolation import compute_interpolation_weights
from splits.tables.node_selection import REFLECTANCE_FACTOR, select_reflectance_factor
from splits.tables.views import AZIMUTH, POLAR, fold_azimuths

MIN_LAST_ZENITH_DEG = 60.0
"""Smallest last node of the zenith angles of a table that is converted."""


def convert_to_eradiate(
    dataset: xr.Dataset,
    wavelength: float | None = None,
    n_cosines: int = 51,
    n_azimuths: int = 72,
    **at: Any,
) -> xr.Dataset:
    """Convert a table of directions to the data of eradiate's ``MQDiffuseBSDF``.

    The format has evenly spaced cosines from 0 to 1 and one wavelength.  Values between the nodes
    of the table are interpolated by cubics in the zenith angles and in the cosine of the azimuth;
    negative ones become 0.  Beyond the last node of a zenith angle, the BRDF is that at the last
    node.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance_factor`` over ``incidence_deg``, ``polar_deg`` and ``azimuth_deg``.  Both
        zenith angles begin with 0° and extend at least to 60°.
    wavelength : float, optional
        Wavelength (nm) of the table; may be omitted for a table of one wavelength.
    n_cosines : int, from 2 to 1000
        Number of cosines of both zenith angles.
    n_azimuths : int, from 2 to 3600
        Number of azimuths.
    **at
        Node of each other axis of the table.

    Returns
    -------
    xarray.Dataset
        ``brdf`` (1/sr; the reflectance factor over π) over ``cos_theta_o`` (outgoing), ``phi_d``
        (rad) and ``cos_theta_i`` (incoming).  ``phi_d`` is the azimuth of the view minus that of
        the sun, so that 0 is the side of the sun and π is forward scattering; the azimuth of this
        package is π minus it.  The attribute ``last_zenith_deg`` has the last nodes of
        ``incidence_deg`` and ``polar_deg``.

    Raises
    ------
    ValueError
        For a wavelength outside the table, zenith angles that begin above 0° or end below 60°, an
        angle with fewer than two nodes, azimuths that do not extend from 0° to 180°, a missing
        axis, or gaps.

    Examples
    --------
    With the package eradiate: ``eradiate.scenes.bsdfs.MQDiffuseBSDF(data=d)`` for a dataset ``d``
    or the path of its netCDF file.
    """
    n_cosines = check_integer("n_cosines", n_cosines, 2, 1000)
    n_azimuths = check_integer("n_azimuths", n_azimuths, 2, 3600)
    subset = select_reflectance_factor(dataset, at)
    factor = subset[REFLECTANCE_FACTOR].isel(wavelength=_find_wavelength(subset, wavelength))
    cosines = np.linspace(0.0, 1.0, n_cosines)
    phi = np.linspace(0.0, 2.0 * np.pi, n_azimuths, endpoint=False)
    zeniths = np.degrees(np.arccos(cosines))
    incidence, polar = (
        _make_weight_matrix(name, _check_zenith_nodes(name, factor[name].values), zeniths)
        for name in (INCIDENCE, POLAR)
    )
    azimuth = _make_weight_matrix(
        AZIMUTH, factor[AZIMUTH].values.astype(float), fold_azimuths(180.0 - np.degrees(phi))
    )
    values = np.einsum(
        "op,da,in,npa->odi", polar, azimuth, incidence, factor.values.astype(float), optimize=True
    )
    brdf = np.maximum(values / np.pi, 0.0).astype(np.float32)
    last_zeniths = [float(factor[name].values[-1]) for name in (INCIDENCE, POLAR)]
    cosine = {"units": "dimensionless"}
    return xr.Dataset(
        {
            "brdf": (
                ("cos_theta_o", "phi_d", "cos_theta_i"),
                brdf,
                {"long_name": "bidirectional reflectance distribution function", "units": "1/sr"},
            )
        },
        {
            "cos_theta_o": ("cos_theta_o", cosines, cosine),
            "phi_d": ("phi_d", phi, {"units": "rad", "comment": "0 is the side of the sun"}),
            "cos_theta_i": ("cos_theta_i", cosines, cosine),
        },
        {
            "title": "Tabulated BRDF for eradiate",
            "source": dataset.attrs.get("source", "splits"),
            "wavelength_nm": float(factor.wavelength),
            "last_zenith_deg": last_zeniths,
        },
    )


def _find_wavelength(subset: xr.Dataset, wavelength: float | None) -> int:
    """Return the index of a wavelength of the table."""
    nodes = subset.wavelength.values
    if wavelength is None and nodes.size == 1:
        return 0
    allowed = f"one of the table's {nodes.size} wavelengths, from {nodes[0]:g} to {nodes[-1]:g} nm"
    if wavelength is None:
        raise invalid("wavelength", None, allowed)
    value = check_number("wavelength", wavelength, allowed)
    matches = np.flatnonzero(np.isclose(nodes, value, rtol=ROUNDING_TOLERANCE, atol=0.0))
    if not matches.size:
        raise invalid("wavelength", wavelength, allowed)
    return int(matches[0])


def _check_zenith_nodes(name: str, nodes: np.ndarray) -> np.ndarray:
    """Return the nodes of a zenith angle that covers the format well enough."""
    if snap_to_limits(nodes[:1], 0.0, 90.0)[0] != 0.0 or nodes[-1] < MIN_LAST_ZENITH_DEG:
        allowed = f"from 0 to at least {MIN_LAST_ZENITH_DEG:g}"
        raise invalid(name, nodes.tolist(), allowed, "the format covers the hemisphere")
    return nodes.astype(float)


def _make_weight_matrix(name: str, nodes: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the weights of cubic interpolation, shape (targets, nodes).

    Targets beyond the nodes get the value of the last node.
    """
    matrix = np.zeros((targets.size, nodes.size))
    for row, x in zip(matrix, np.clip(targets, nodes[0], nodes[-1]), strict=True):
        weights = compute_interpolation_weights(name, nodes, x, has_direction=True)
        row[weights.nodes] = weights.weights
    return matrix
