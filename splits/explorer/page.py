"""The explorer: tables of spectra in one file of HTML that needs no server and no network."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.checks import refuse
from splits.escaping import escape_json
from splits.files import whole
from splits.lookup.interpolation import law, spaced
from splits.lookup.reading import Table
from splits.names import amount_of

LARGEST_BYTES = 5_000_000
_HERE = Path(__file__).parent


class Shown(NamedTuple):
    """A table that the page shows.

    Attributes
    ----------
    table : Table
        Of reflectance, over axes of numbers.
    file : str
        Its name, for the line of Python that the page shows.
    about : str
        What it holds, in a sentence.
    directions : xarray.Dataset, optional
        Reflectance factors over ``optical_radius_um``, ``incidence_deg``, wavelength, polar angle
        and azimuth: where the light goes; attribute ``relative_stderr_reached``.
    """

    table: Table
    file_name: str
    description: str
    directions: xr.Dataset | None = None


def write_page(tables: Mapping[str, Shown], path: str | Path) -> None:
    """Write the explorer of some tables.

    Parameters
    ----------
    tables : mapping
        From what the page calls them to the tables.
    path : path
        The file appears whole or not at all.

    Raises
    ------
    ValueError
        For an axis of texts, or tables too large for a page.
    """
    data = [_embedded(label, one) for label, one in tables.items()]
    page = (_HERE / "page.html").read_text(encoding="utf-8")
    parts = {
        "{{STYLE}}": (_HERE / "page.css").read_text(encoding="utf-8"),
        "{{SCRIPT}}": (_HERE / "page.js").read_text(encoding="utf-8"),
        "{{DATA}}": escape_json(data),
    }
    for key, text in parts.items():
        page = page.replace(key, text)
    content = page.encode("utf-8")
    if len(content) > LARGEST_BYTES:
        allowed = f"small enough for a page of {LARGEST_BYTES} bytes"
        raise refuse("explorer", f"{len(content)} bytes", allowed, "fewer nodes or wavelengths")
    with whole(path) as aside:
        aside.write_bytes(content)


def _embedded(label: str, entry: Shown) -> dict[str, Any]:
    """Return what the page holds of a table."""
    dataset = entry.table.dataset
    names = entry.table.axes[:-1]
    axes = []
    for name in names:
        nodes = dataset[name].values
        if nodes.dtype.kind != "f" or nodes.size < 2:
            raise refuse("explorer", name, "an axis of at least two numbers")
        kind, at = spaced(name, nodes)
        middle = float(nodes[np.abs(at - 0.5 * (at[0] + at[-1])).argmin()])
        about = dataset[name].attrs
        axes.append(
            {
                "name": name,
                "label": _label(name, str(about.get("long_name", name))),
                "unit": _UNITS.get(str(about.get("units", "1")), str(about.get("units", ""))),
                "nodes": nodes.tolist(),
                "law": kind,
                "start": middle,
            }
        )
        assert np.array_equal(law(kind, nodes), at)
    wavelength = dataset.wavelength.values
    return {
        "label": label,
        "file": entry.file_name,
        "about": entry.description,
        "note": "The band is two standard errors wide on either side; it holds the noise of the "
        "simulation and what reading between the nodes of the table may miss.",
        "axes": axes,
        "wavelength": wavelength.tolist(),
        "value": _packed(dataset.reflectance.values),
        "stderr": _packed(dataset.reflectance_stderr.values),
        "weights": colour_weights(wavelength).tolist(),
        "directions": None if entry.directions is None else _directions(entry.directions, names),
    }


STEEPEST_DEG = 80.0
STEP_DEG = 5.0
"""Polar angle up to which the page shows directions, and the step of that and half that around."""
_DIMS = ("optical_radius_um", "incidence_deg", "wavelength", "polar", "azimuth")


def _directions(dataset: xr.Dataset, axes: Sequence[str]) -> dict[str, Any]:
    """Return what the page holds of where light goes: every 5° from above, every 10° around."""
    found = [str(dim) for dim in dataset.reflectance_factor.dims]
    if set(found) != {*_DIMS}:
        raise refuse("explorer", found, f"reflectance factors over {', '.join(_DIMS)}")
    for name in _DIMS[:2]:
        if name not in axes:
            raise refuse("explorer", list(axes), f"a table with {name}, as its directions have")
        if dataset.sizes[name] < 2:
            raise refuse("explorer", f"{dataset.sizes[name]} {name}", "at least two of directions")
    polar, azimuth = np.arange(0.0, STEEPEST_DEG + 1.0, STEP_DEG), np.arange(0.0, 181.0, 10.0)
    if not (np.isin(polar, dataset.polar).all() and np.isin(azimuth, dataset.azimuth).all()):
        allowed = f"every {STEP_DEG:g}° to {STEEPEST_DEG:g}°, and every 10° of azimuth to 180°"
        raise refuse("explorer", "angles of directions", allowed)
    some = dataset.reflectance_factor.transpose(*_DIMS).sel(polar=polar, azimuth=azimuth)
    if not (some > 0.0).all():
        raise refuse("explorer", f"{float(some.min()):g}", "above 0 in all directions")
    nodes = {name: some[name].values.astype(float) for name in _DIMS}
    stderr = dataset.reflectance_factor_stderr.transpose(*_DIMS).sel(polar=polar, azimuth=azimuth)
    missed = np.concatenate(
        [
            _missed(some.values, axis, law(kind, nodes[name])).ravel()
            for axis, (name, kind) in enumerate(zip(_DIMS, ("logarithm", "cosine"), strict=False))
        ]
    )
    largest = np.hypot(dataset.attrs["relative_stderr_reached"], missed.max(initial=0.0))
    square = float(((stderr / some) ** 2).mean())
    typical = np.sqrt(square + (float((missed**2).mean()) if missed.size else 0.0))
    listed = {name: values.tolist() for name, values in nodes.items()}
    return listed | {
        "value": _packed(some.values), "error": float(largest), "typical": float(typical),
    }  # fmt: skip


def _missed(values: np.ndarray, axis: int, nodes: np.ndarray) -> np.ndarray:
    """Return what reading between two nodes of an axis misses, relative, near each inner node.

    Logarithms are read, linear between nodes.  A quarter of what a node is off that is left out,
    for half the distance.
    """
    rows = np.moveaxis(np.log(values), axis, 0)
    share = ((nodes[1:-1] - nodes[:-2]) / (nodes[2:] - nodes[:-2])).reshape(-1, *[1] * (rows.ndim - 1))
    found: np.ndarray = 0.25 * np.abs((1.0 - share) * rows[:-2] + share * rows[2:] - rows[1:-1])
    return found


_UNITS = {
    "1": "", "degree": "°", "um": "µm", "m2 kg-1": "m²/kg", "kg m-3": "kg/m³", "1e-9": "ng/g",
}  # fmt: skip


def _label(name: str, long_name: str) -> str:
    """Return a short name of an axis."""
    amount = amount_of(name)
    return amount[1].replace("_", " ") if amount else _LABELS.get(name, long_name)


_LABELS = {
    "depth_m": "depth",
    "ground": "albedo of the ground",
    "hematite_ratio": "hematite in iron oxide",
    "iron_oxide": "iron oxide by mass",
    "liquid_water_content": "liquid water by volume",
    "optical_radius_um": "optical radius",
    "saturation": "water in pores",
}


def _packed(values: np.ndarray) -> str:
    """Return numbers in single precision as text."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def colour_weights(wavelength: np.ndarray) -> np.ndarray:
    """Return what X, Y, Z take from each wavelength, shape (3, wavelengths).

    Spectra are linear between the wavelengths, and level beyond the last.
    """
    from splits.analysis.colour import tristimulus

    fine = np.arange(400.0, 781.0, 5.0)
    hats = np.stack([np.interp(fine, wavelength, unit) for unit in np.eye(wavelength.size)])
    return np.stack([tristimulus(fine, hat) for hat in hats], axis=1)
