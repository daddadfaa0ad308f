"""Writer of the explorer: tables of spectra in one HTML file without server or network access."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.declarations import AXIS_UNITS
from splits.core.escaping import escape_json
from splits.core.validation import invalid
from splits.media.parameters import get_quantity, parse_impurity_parameter
from splits.tables.interpolation import (
    MEAN_SHARE,
    AxisInterpolation,
    apply_axis_transform,
    list_compared_coordinates,
    transform_axis,
)
from splits.tables.table import Table

MAX_PAGE_BYTES = 5_000_000
_ASSET_FOLDER = Path(__file__).parent


class ExplorerTable(NamedTuple):
    """A table of the page.

    Attributes
    ----------
    table : Table
        Table of reflectance over numeric axes.
    file_name : str
        File of the table, for the line of Python on the page.
    description : str
        Description of the table, one sentence.
    directions : xarray.Dataset, optional
        Reflectance factors over ``optical_radius_um``, ``incidence_deg``, wavelength, polar angle
        and azimuth, with the attribute ``relative_stderr_reached``.
    """

    table: Table
    file_name: str
    description: str
    directions: xr.Dataset | None = None


def write_explorer(tables: Mapping[str, ExplorerTable], path: str | Path) -> None:
    """Write the explorer of several tables.

    Parameters
    ----------
    tables : mapping
        Tables by their label on the page.
    path : path
        The file is written atomically.

    Raises
    ------
    ValueError
        For an axis of texts, or tables that exceed the size limit of the page.
    """
    data = [_serialize_table(label, entry) for label, entry in tables.items()]
    page = (_ASSET_FOLDER / "page.html").read_text(encoding="utf-8")
    parts = {
        "{{STYLE}}": (_ASSET_FOLDER / "page.css").read_text(encoding="utf-8"),
        "{{SCRIPT}}": (_ASSET_FOLDER / "page.js").read_text(encoding="utf-8"),
        "{{DATA}}": escape_json(data),
    }
    for key, text in parts.items():
        page = page.replace(key, text)
    content = page.encode("utf-8")
    if len(content) > MAX_PAGE_BYTES:
        allowed = f"small enough for a page of {MAX_PAGE_BYTES} bytes"
        raise invalid("explorer", f"{len(content)} bytes", allowed, "fewer nodes or wavelengths")
    with atomic_write(path) as temporary_path:
        temporary_path.write_bytes(content)


def _serialize_table(label: str, entry: ExplorerTable) -> dict[str, Any]:
    """Return the data of a table for the page."""
    dataset = entry.table.dataset
    names = entry.table.axes[:-1]
    interpolation = entry.table.prepare("reflectance") if names else {}
    axes = []
    for name in names:
        nodes = dataset[name].values
        if nodes.dtype.kind != "f" or nodes.size < 2:
            raise invalid("explorer", name, "an axis of at least two numbers")
        transform, transformed = transform_axis(name, nodes)
        middle = float(
            nodes[np.abs(transformed - 0.5 * (transformed[0] + transformed[-1])).argmin()]
        )
        attributes = dataset[name].attrs
        # The first node is clean or dry; directions are of such grains.
        is_addition = (
            parse_impurity_parameter(name) is not None or get_quantity(name).root_at == 0.0
        )
        axes.append(
            {
                "name": name,
                "label": _make_axis_label(name, str(attributes.get("long_name", name))),
                "unit": AXIS_UNITS.get(
                    str(attributes.get("units", "1")), str(attributes.get("units", ""))
                ),
                "nodes": nodes.tolist(),
                "law": transform,
                "start": float(nodes[0]) if is_addition else middle,
                **_serialize_interpolation(interpolation[name], names),
            }
        )
        assert np.array_equal(apply_axis_transform(transform, nodes), transformed)
    wavelength = dataset.wavelength.values
    return {
        "label": label,
        "file": entry.file_name,
        "about": entry.description,
        "note": "The band is two standard errors wide on either side; it includes the error of the "
        "values and that of interpolation between the nodes of the table.",
        "axes": axes,
        "wavelength": wavelength.tolist(),
        "value": _encode_float32(dataset.reflectance.values),
        "stderr": _encode_float32(dataset.reflectance_stderr.values),
        "weights": compute_colour_weights(wavelength).tolist(),
        "directions": None
        if entry.directions is None
        else _serialize_directions(entry.directions, names),
    }


def _serialize_interpolation(axis: AxisInterpolation, names: Sequence[str]) -> dict[str, Any]:
    """Return the coordinates and the errors of interpolation along an axis for the page."""
    coordinates = [
        [bool(is_cosine), power, origin] for is_cosine, power, origin in axis.coordinates
    ]
    measured = None
    if axis.is_measured:
        others = [
            {
                "axis": names.index(name),
                "nodes": nodes.tolist(),
                "law": axis.other_transforms.get(name, "identity"),
            }
            for name, nodes in axis.other_axes.items()
        ]
        measured = {
            "between": axis.between.tolist(), "count": axis.n_compared, "share": MEAN_SHARE,
            "others": others, "factors": _encode_float32(axis.factors[0]),
        }  # fmt: skip
    compared = list_compared_coordinates(axis.name, axis.nodes, axis.default)
    return {
        "coordinates": coordinates, "choice": axis.choice.tolist(), "measured": measured,
        "compared": [[bool(is_cosine), *rest] for is_cosine, *rest in compared],
    }  # fmt: skip


MAX_POLAR_DEG = 80.0
POLAR_STEP_DEG = 5.0
"""Largest polar angle of directions on the page, and its step (degrees)."""
_DIRECTION_DIMS = ("optical_radius_um", "incidence_deg", "wavelength", "polar_deg", "azimuth_deg")


def _serialize_directions(dataset: xr.Dataset, axes: Sequence[str]) -> dict[str, Any]:
    """Return the directions of a table for the page: every 5° in polar angle, 10° in azimuth."""
    dims = [str(dim) for dim in dataset.reflectance_factor.dims]
    if set(dims) != {*_DIRECTION_DIMS}:
        raise invalid("explorer", dims, f"reflectance factors over {', '.join(_DIRECTION_DIMS)}")
    for name in _DIRECTION_DIMS[:2]:
        if name not in axes:
            raise invalid("explorer", list(axes), f"a table with {name}, an axis of directions")
        if dataset.sizes[name] < 2:
            raise invalid("explorer", f"{dataset.sizes[name]} {name}", "at least two of directions")
    polar, azimuth = (
        np.arange(0.0, MAX_POLAR_DEG + 1.0, POLAR_STEP_DEG),
        np.arange(0.0, 181.0, 10.0),
    )
    if not (
        np.isin(polar, dataset.polar_deg).all() and np.isin(azimuth, dataset.azimuth_deg).all()
    ):
        allowed = (
            f"every {POLAR_STEP_DEG:g}° to {MAX_POLAR_DEG:g}°, and every 10° of azimuth to 180°"
        )
        raise invalid("explorer", "angles of directions", allowed)
    factor = dataset.reflectance_factor.transpose(*_DIRECTION_DIMS).sel(
        polar_deg=polar, azimuth_deg=azimuth
    )
    if not (factor > 0.0).all():
        raise invalid("explorer", f"{float(factor.min()):g}", "above 0 in all directions")
    nodes = {name: factor[name].values.astype(float) for name in _DIRECTION_DIMS}
    stderr = dataset.reflectance_factor_stderr.transpose(*_DIRECTION_DIMS).sel(
        polar_deg=polar, azimuth_deg=azimuth
    )
    # Logarithms are interpolated linearly.  The relative error of an axis near each inner node is a
    # quarter of that at a node that is left out, since the distance between nodes is halved.
    errors = []
    for axis, (name, transform) in enumerate(
        zip(_DIRECTION_DIMS, ("logarithm", "cosine"), strict=False)
    ):
        t = apply_axis_transform(transform, nodes[name])
        rows = np.moveaxis(np.log(factor.values), axis, 0)
        fraction = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
        fraction = fraction.reshape(-1, *[1] * (rows.ndim - 1))
        middle = (1.0 - fraction) * rows[:-2] + fraction * rows[2:]
        errors.append(0.25 * np.abs(middle - rows[1:-1]).ravel())
    interpolation_error = np.concatenate(errors)
    largest = np.hypot(
        dataset.attrs["relative_stderr_reached"], interpolation_error.max(initial=0.0)
    )
    noise_variance = float(((stderr / factor) ** 2).mean())
    typical = np.sqrt(
        noise_variance
        + (float((interpolation_error**2).mean()) if interpolation_error.size else 0.0)
    )
    axis_values = {name: values.tolist() for name, values in nodes.items()}
    return axis_values | {
        "value": _encode_float32(factor.values), "error": float(largest), "typical": float(typical),
    }  # fmt: skip


def _make_axis_label(name: str, long_name: str) -> str:
    """Return a short name of an axis."""
    impurity = parse_impurity_parameter(name)
    if impurity:
        return impurity[1].replace("_", " ")
    # Numbers on an axis of the ground are albedos.
    return "albedo of the ground" if name == "ground" else get_quantity(name).label or long_name


def _encode_float32(values: np.ndarray) -> str:
    """Return numbers in single precision, encoded as text."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def compute_colour_weights(wavelength: np.ndarray) -> np.ndarray:
    """Return the weights of wavelengths in X, Y, Z, shape (3, wavelengths).

    Spectra are linear between the wavelengths, and constant outside them.
    """
    from splits.analysis.colour import compute_tristimulus

    fine = np.arange(400.0, 781.0, 5.0)
    basis = np.stack([np.interp(fine, wavelength, unit) for unit in np.eye(wavelength.size)])
    return np.stack([compute_tristimulus(fine, function) for function in basis], axis=1)
