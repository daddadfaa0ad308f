"""Writing of tables of directions in the universal BRDF format (BiRD), version 1.0.

The format is JSON with one list per variable and one entry per geometry and wavelength.  Its schema
is https://github.com/BiRD-project/BiRD_view/tree/master/BRDF_JSON_schema; Lanevski et al. (2022),
Color Research and Application 47, 1177-1192, describe it.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.provenance import get_package_version
from splits.core.validation import invalid, join_names
from splits.tables.axes import INCIDENCE, check_axis_values
from splits.tables.directions import AZIMUTH, POLAR, REFLECTANCE_FACTOR, select_reflectance_factor

SCHEMA_URL = (
    "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/"
    "brdf_json_schema_v1.0.json"
)
REQUIRED_PROVENANCE = ("organization", "location", "email", "contact_person")
OPTIONAL_PROVENANCE = ("website", "phone", "comments")
REQUIRED_LOCATION = ("country", "city", "street", "building_nr", "postal_code")
OPTIONAL_LOCATION = ("county", "room_nr", "coordinates")


def write_bird(
    dataset: xr.Dataset,
    path: str | Path,
    provenance: Mapping[str, Any],
    description: str = "",
    **at: Any,
) -> None:
    """Write a table of directions as a universal BRDF file (BiRD).

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance_factor`` over ``incidence_deg``, ``polar_deg`` and ``azimuth_deg``.
    path : path
        Output file, usually with the suffix ``.brdf``, written atomically.
    provenance : mapping
        Origin of the data, which the format requires: ``organization``, ``email``,
        ``contact_person``, and ``location``, a mapping of ``country``, ``city``, ``street``,
        ``building_nr`` and ``postal_code``.  All values are text.  ``website``, ``phone``,
        ``comments``, and in the location ``county``, ``room_nr`` and ``coordinates`` are optional.
    description : str, optional
        Description of the data; by default the title of the table.
    **at
        Node of each other axis of the table.

    Raises
    ------
    ValueError
        For a missing or unknown entry of the provenance, a missing axis, an angle with fewer than
        two nodes, azimuths that do not extend from 0° to 180°, or gaps.

    Notes
    -----
    The BRDF (1/sr) is the reflectance factor over π, and its uncertainty ``uBRDF`` is one standard
    error.  ``phi_i`` is 0 at all points, the side of the sun, and ``phi_r`` is 180° minus and plus
    the azimuth of this package, so that forward scattering is at ``phi_r`` = 180°.
    """
    origin = _check_provenance(provenance)
    subset = select_reflectance_factor(dataset, at)
    data = _make_data(_mirror_azimuths(subset))
    axes = [str(name) for name in dataset[REFLECTANCE_FACTOR].dims]
    nodes = check_axis_values(at, axes)
    text = json.dumps(
        {"metadata": _make_metadata(dataset, data, origin, description, nodes), "data": data},
        ensure_ascii=False,
        allow_nan=False,
        default=str,
    )
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _check_provenance(provenance: Any) -> dict[str, Any]:
    """Return the entries of the provenance after a check of names and values."""
    origin = _check_texts(
        "provenance", provenance, REQUIRED_PROVENANCE, OPTIONAL_PROVENANCE, exempt="location"
    )
    location = _check_texts(
        "provenance.location", origin["location"], REQUIRED_LOCATION, OPTIONAL_LOCATION
    )
    return origin | {"location": location}


def _check_texts(
    key: str, entries: Any, required: tuple[str, ...], optional: tuple[str, ...], exempt: str = ""
) -> dict[str, Any]:
    """Return entries with all required and no unknown names, and text as values."""
    if not isinstance(entries, Mapping):
        raise invalid(key, entries, f"a mapping with {join_names(required)}")
    missing = [name for name in required if name not in entries]
    if missing:
        raise invalid(key, list(entries), f"with {join_names(missing)} too")
    for name, value in entries.items():
        if name not in required + optional:
            raise invalid(key, list(entries), f"of {join_names(required + optional)}")
        if name != exempt and (not isinstance(value, str) or not value):
            raise invalid(f"{key}.{name}", value, "text")
    return dict(entries)


def _mirror_azimuths(subset: xr.Dataset) -> xr.Dataset:
    """Return directions over azimuths of the format: from 0 (side of the sun) to 360°."""
    azimuth = subset[AZIMUTH].values.astype(float)
    half = subset.assign_coords({AZIMUTH: 180.0 - azimuth}).isel({AZIMUTH: slice(None, None, -1)})
    other_half = subset.assign_coords({AZIMUTH: 180.0 + azimuth}).isel({AZIMUTH: slice(1, -1)})
    return xr.concat([half, other_half], AZIMUTH)


def _make_data(directions: xr.Dataset) -> dict[str, Any]:
    """Return the variables of the format, one entry per geometry and wavelength."""
    dims = (INCIDENCE, POLAR, AZIMUTH, "wavelength")
    incidence, polar, azimuth, wavelength = (
        grid.ravel().tolist()
        for grid in np.meshgrid(*(directions[name].values for name in dims), indexing="ij")
    )
    data = {
        "theta_i": {"unit": "deg", "values": incidence},
        "phi_i": {"unit": "deg", "values": [0.0] * len(incidence)},
        "theta_r": {"unit": "deg", "values": polar},
        "phi_r": {"unit": "deg", "values": azimuth},
        "wavelength_i": {"unit": "nm", "values": wavelength},
    }
    for name, quantity in (
        ("BRDF", REFLECTANCE_FACTOR),
        ("uBRDF", f"{REFLECTANCE_FACTOR}_stderr"),
    ):
        if quantity in directions:
            values = directions[quantity].transpose(*dims).values.astype(float).ravel() / np.pi
            data[name] = {"unit": "1/sr", "values": [float(f"{x:.7g}") for x in values]}
    return data


def _make_metadata(
    dataset: xr.Dataset,
    data: dict[str, Any],
    provenance: dict[str, Any],
    description: str,
    nodes: dict[str, Any],
) -> dict[str, Any]:
    """Return the metadata that the schema requires."""
    medium = str(dataset.attrs.get("medium", "layer"))
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "schema": SCHEMA_URL,
        "id": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, json.dumps([nodes, data], default=str))}",
        "type": "BRDF",
        "timestamp": str(dataset.attrs.get("date_created", now)),
        "provenance": provenance,
        "description": description or str(dataset.attrs.get("title", "Table of directions")),
        "method": "simulation",
        "instrumentation": "NA",
        "software": {
            "name": "splits",
            "version": str(dataset.attrs.get("splits_version", get_package_version())),
            "description": "Light transport in particulate layers",
        },
        "sample": {
            "name": medium,
            "type": "diffuse reflectance sample",
            "dimensions": {},
            "shape": "plane-parallel layer",
            "zero_azimuth_location": "side of the sun",
            "properties_symmetry": "isotropic",
            "adhoc_section": {
                name: value if isinstance(value, str) else float(value)
                for name, value in nodes.items()
            },
        },
        "environment": "NA",
    }
