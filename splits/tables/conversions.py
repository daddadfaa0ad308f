"""Conversion of tables to CSV, and to the data of isofit's surface model and of eradiate.

The part of a table that these programs take is selected, and its angles are checked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps
from splits.core.atomic import atomic_write
from splits.core.declarations import Quantity
from splits.core.escaping import escape_cells
from splits.core.keywords import declare_function
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    as_scalar,
    check_choice,
    check_number,
    invalid,
    snap_to_limits,
)
from splits.tables.axes import (
    ALONG,
    ANGLES,
    AZIMUTH,
    INCIDENCE,
    POLAR,
    check_axis_values,
    find_variables,
    fold_azimuths,
)
from splits.tables.interpolation import make_weight_matrix

RADIUS, SURFACE_AREA = "optical_radius_um", "specific_surface_area_m2_kg"
REFLECTANCE_FACTOR = "reflectance_factor"
DIFFUSE_REFLECTANCE_FACTOR = "diffuse_reflectance_factor"


def write_csv(dataset: xr.Dataset, path: Any) -> None:
    """Write a table as CSV, with one row per wavelength and point and the axes as columns.

    All quantities of a table of directions are in the same file.  A quantity that does not depend
    on an axis, such as ``reflectance`` on the angles of view, is repeated along this axis.  Text
    that a spreadsheet would evaluate as a formula gets an apostrophe in front.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset of a table; deviations by batch, values between nodes and means over bands are
        omitted.
    path : path
        Output file, written atomically.
    """
    names = [
        str(name)
        for name, v in dataset.data_vars.items()
        if not {"batch", "band"} & {*v.dims} and ALONG not in str(name)
    ]
    by_number_of_axes = sorted(names, key=lambda name: -dataset[name].ndim)
    dims = [str(dim) for name in by_number_of_axes for dim in dataset[name].dims]
    axes = [*dict.fromkeys(dim for dim in dims if dim != "wavelength"), "wavelength"]
    with atomic_write(path) as temporary:
        for number in range(dataset.sizes[axes[0]]):
            # One slice at a time: all rows together need many times the memory of the table.
            frame = dataset[names].isel({axes[0]: [number]}).to_dataframe(dim_order=axes)
            rows = escape_cells(frame.reset_index()[[*axes, *names]])
            rows.to_csv(temporary, mode="a", header=number == 0, index=False, float_format="%.6g")


def select_at_fixed_axes(
    dataset: xr.Dataset, quantities: Sequence[str], free_axes: list[str], at: Mapping[str, Any]
) -> xr.Dataset:
    """Return the part of a table over the free axes, with the other axes at a node."""
    axes = [str(d) for d in dataset[quantities[0]].dims if d != "wavelength"]
    for name in free_axes:
        if name == RADIUS and RADIUS not in axes and SURFACE_AREA in axes:
            hint = f"give {RADIUS} = 3e6/(917 {SURFACE_AREA}) in the grid of splits.build_table"
            raise invalid("table", f"over {', '.join(axes)}", f"over {RADIUS}", hint)
        check_choice("axis", name, axes)
    at = check_axis_values(at, axes, free_axes=free_axes)
    subset = dataset[list(quantities)]
    for name in [axis for axis in axes if axis not in free_axes]:
        values = dataset[name].values
        allowed = "one of " + ", ".join(map(str, values))
        subset = subset.isel({name: _find_node(name, values, at.get(name), allowed)})
    check_no_gaps("table", subset)
    return subset


def _find_node(name: str, nodes: np.ndarray, value: Any, allowed: str) -> int:
    """Return the index of the node of an axis that a value is, 0 if it is left out of a single."""
    if value is None and nodes.size == 1:
        return 0
    value = as_scalar(value)
    if nodes.dtype.kind in "iuf" and value is not None:
        number = check_number(name, value, allowed)
        matches = np.isclose(nodes, number, rtol=ROUNDING_TOLERANCE, atol=0.0)
    else:
        matches = nodes == str(value)
    if value is None or not matches.any():
        raise invalid(name, value, *(["given", allowed] if value is None else [allowed]))
    return int(matches.argmax())


def select_reflectance_factor(
    dataset: xr.Dataset, at: Mapping[str, Any], free_axes: Sequence[str] = ()
) -> xr.Dataset:
    """Return the bidirectional reflectance factor of a table, with other axes at a node.

    Parameters
    ----------
    dataset : xarray.Dataset
        Table with ``reflectance_factor`` over ``incidence_deg``, ``polar_deg`` and
        ``azimuth_deg``.
    at : mapping
        Node of each axis that is neither an angle nor free.
    free_axes : sequence of str
        Axes to keep in addition to the angles and the wavelength.

    Returns
    -------
    xarray.Dataset
        ``reflectance_factor``, and its standard error if the table has one, over the angles, the
        free axes and the wavelength.  Angles ascend.

    Raises
    ------
    ValueError
        For a table without directions, an angle with too few nodes, with text, or outside its
        range, azimuths that do not extend from 0° to 180°, a missing axis, or gaps.
    """
    allowed = f"with {REFLECTANCE_FACTOR} over {', '.join(ANGLES)}"
    find_variables(dataset, [REFLECTANCE_FACTOR], allowed)
    dims = list(map(str, dataset[REFLECTANCE_FACTOR].dims))
    missing = [name for name in ANGLES if name not in dims]
    if missing:
        hint = f"give {', '.join(missing)} in the grid of splits.build_table"
        raise invalid("table", f"{REFLECTANCE_FACTOR} over {', '.join(dims)}", allowed, hint)
    for name in ANGLES:
        nodes = dataset[name].values
        if nodes.dtype.kind not in "iuf" or nodes.size < 2:
            raise invalid(name, nodes.tolist(), "at least two angles")
        first, last = snap_to_limits(np.sort(nodes.astype(float)), 0.0, 180.0)[[0, -1]].tolist()
        is_azimuth = name == AZIMUTH
        if not ((first, last) == (0.0, 180.0) if is_azimuth else 0.0 <= first <= last < 90.0):
            allowed = "from 0 to 180" if is_azimuth else "at least 0, and less than 90"
            raise invalid(name, nodes.tolist(), allowed)
    both = REFLECTANCE_FACTOR, f"{REFLECTANCE_FACTOR}_stderr"
    names = tuple(name for name in both if name in dataset)
    subset = select_at_fixed_axes(dataset, names, [*ANGLES, *free_axes], at)
    return subset.sortby([*ANGLES]).transpose(*ANGLES, *free_axes, "wavelength")


MIN_LAST_ZENITH_DEG = 60.0
"""Smallest last node of the zenith angles of a table that is converted."""


CosineCount = Annotated[int, Quantity("number of cosines of both zenith angles", low=2, high=1000)]
AzimuthCount = Annotated[int, Quantity("number of azimuths", low=2, high=3600)]


@declare_function
def convert_to_eradiate(
    dataset: xr.Dataset,
    *,
    wavelength: float | None = None,
    n_cosines: CosineCount = 51,
    n_azimuths: AzimuthCount = 72,
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
    subset = select_reflectance_factor(dataset, at)
    factor, nodes = subset[REFLECTANCE_FACTOR], subset.wavelength.values
    allowed = f"one of the table's {nodes.size} wavelengths, from {nodes[0]:g} to {nodes[-1]:g} nm"
    factor = factor.isel(wavelength=_find_node("wavelength", nodes, wavelength, allowed))
    cosines = np.linspace(0.0, 1.0, n_cosines)
    phi = np.linspace(0.0, 2.0 * np.pi, n_azimuths, endpoint=False)
    zeniths = np.degrees(np.arccos(cosines))
    targets = {INCIDENCE: zeniths, POLAR: zeniths}
    for name in targets:
        nodes = factor[name].values
        if snap_to_limits(nodes[:1], 0.0, 90.0)[0] != 0.0 or nodes[-1] < MIN_LAST_ZENITH_DEG:
            allowed = f"from 0 to at least {MIN_LAST_ZENITH_DEG:g}"
            raise invalid(name, nodes.tolist(), allowed, "the format covers the hemisphere")
    targets[AZIMUTH] = fold_azimuths(180.0 - np.degrees(phi))
    incidence, polar, azimuth = (
        # Beyond the nodes, the value is that of the last one.
        make_weight_matrix(name, nodes, np.clip(values, nodes[0], nodes[-1]), has_direction=True)
        for name, values in targets.items()
        for nodes in [factor[name].values.astype(float)]
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


ISOFIT_DIMS = ("solar_zenith", "observer_zenith", "relative_azimuth", "grain_radius", "wl")
LONG_NAMES = {
    "rho_dif_dir": "hemispherical-directional reflectance factor",
    "rho_dir_dir": "bidirectional reflectance factor",
}
AXIS_ATTRIBUTES = {
    "solar_zenith": {"units": "degree"},
    "observer_zenith": {"units": "degree"},
    "relative_azimuth": {
        "units": "degree",
        "comment": "0 is the side of the sun, i.e. backscattering",
    },
    "grain_radius": {"units": "um"},
    "wl": {"units": "nm"},
}


def convert_to_isofit(dataset: xr.Dataset, **at: Any) -> xr.Dataset:
    """Convert a table to the format of isofit's surface model.

    A table of directions has both reflectances of the format.  The diffuse-directional one is the
    variable ``diffuse_reflectance_factor`` of the table.  If the table does not have this
    variable, it follows by reciprocity: the reflectance of diffuse light into a direction equals
    that of a beam from that direction into all directions.  Snow of the interpretation
    ``radiative_transfer`` is reciprocal.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` over ``incidence_deg`` and ``optical_radius_um``, or a table of directions
        with ``reflectance_factor`` over ``incidence_deg``, ``polar_deg``, ``azimuth_deg`` and
        ``optical_radius_um``.
    **at
        Node of each other axis of the table.

    Returns
    -------
    xarray.Dataset
        Variables over ``solar_zenith``, ``observer_zenith``, ``relative_azimuth`` (degrees; 180
        minus the azimuth of this package, so that 0 is the side of the sun), ``grain_radius`` (µm)
        and ``wl`` (nm): the hemispherical-directional reflectance factor ``rho_dif_dir``, which
        does not depend on the solar zenith angle and the azimuth, and for a table of directions
        the bidirectional reflectance factor ``rho_dir_dir`` of scattered light.
        ``statevec_names`` names the retrieved parameters, as isofit requires.

    Raises
    ------
    ValueError
        For a missing axis, an angle with fewer than two nodes, azimuths that do not extend from 0°
        to 180°, gaps, or, by reciprocity, polar angles beyond the angles of incidence.
    """
    values = {}
    if REFLECTANCE_FACTOR in dataset:
        part = select_reflectance_factor(dataset, at, [RADIUS])[REFLECTANCE_FACTOR]
        # Azimuths in descending order, so that relative azimuths increase.
        part = part.isel({AZIMUTH: slice(None, None, -1)}).sortby(RADIUS)
        values["rho_dir_dir"] = part.values
        polar, relative_azimuth = part[POLAR].values, 180.0 - part[AZIMUTH].values
        diffuse = _select_diffuse_factor(dataset, at, polar)
    else:
        names = [INCIDENCE, RADIUS]
        found = find_variables(dataset, ["reflectance"], "with reflectance")
        part = select_at_fixed_axes(dataset, found, names, at).reflectance
        part = part.transpose(*names, "wavelength")
        polar, relative_azimuth = part[INCIDENCE].values, np.array([0.0, 180.0])
        diffuse = part.values
    rows = (
        part[INCIDENCE].values, polar, relative_azimuth, part[RADIUS].values,
        part.wavelength.values,
    )  # fmt: skip
    shape = tuple(row.size for row in rows)
    values["rho_dif_dir"] = np.broadcast_to(diffuse[np.newaxis, :, np.newaxis], shape)
    variables = {
        name: (ISOFIT_DIMS, values[name].astype(np.float32), {"long_name": label, "units": "1"})
        for name, label in LONG_NAMES.items()
        if name in values
    }
    return xr.Dataset(
        {"statevec_names": ("n_state", ["grain_radius"]), **variables},
        {name: (name, row, AXIS_ATTRIBUTES[name])
         for name, row in zip(ISOFIT_DIMS, rows, strict=True)},
        {"title": "Surface table for isofit", "source": dataset.attrs.get("source", "splits")},
    )  # fmt: skip


def _select_diffuse_factor(
    dataset: xr.Dataset, at: Mapping[str, Any], polar_deg: np.ndarray
) -> np.ndarray:
    """Return the reflectance of diffuse light over polar angle, size and wavelength."""
    names = DIFFUSE_REFLECTANCE_FACTOR, "reflectance"
    name, *_ = find_variables(dataset, names, f"with {names[0]}, or with {names[1]}")
    angle = POLAR if name == DIFFUSE_REFLECTANCE_FACTOR else INCIDENCE
    subset = select_at_fixed_axes(dataset, (name,), [angle, RADIUS], at)[name]
    subset = subset.sortby([angle, RADIUS]).transpose(angle, RADIUS, "wavelength")
    if angle == POLAR:
        return np.asarray(subset.values)
    limits = subset[INCIDENCE].values[[0, -1]]
    if polar_deg[0] < limits[0] or polar_deg[-1] > limits[1]:
        allowed = f"from {limits[0]:g} to {limits[1]:g}, as far as {INCIDENCE} goes"
        hint = f"or a table with {DIFFUSE_REFLECTANCE_FACTOR}"
        raise invalid(POLAR, polar_deg.tolist(), allowed, hint)
    weights = make_weight_matrix(INCIDENCE, subset[INCIDENCE].values, polar_deg)
    return np.asarray(np.tensordot(weights, subset.values, 1))
