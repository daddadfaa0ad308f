"""Writing of tables of directions in the universal BRDF format of BiRDview."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.validation import as_scalar, invalid
from splits.io.bird_brdf import save_brdf
from splits.tables.axes import AZIMUTH, INCIDENCE, POLAR, check_axis_values
from splits.tables.conversions import REFLECTANCE_FACTOR, select_reflectance_factor

OTHER_NODES = (INCIDENCE, "wavelength")
"""Axes whose single nodes are not parameters of the medium."""


def write_bird(
    dataset: xr.Dataset,
    path: str | Path,
    provenance: Mapping[str, Any],
    license: Mapping[str, str] | None = None,
    **at: Any,
) -> None:
    """Write a table of directions in the universal BRDF format of BiRDview.

    The file has all angles and wavelengths of the table, and the directions on both sides of the
    plane of incidence; see `splits.save_brdf` for the azimuths and the metadata.  The BRDF (1/sr)
    is the reflectance factor over π.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance_factor`` over ``polar_deg`` and ``azimuth_deg``, and over ``incidence_deg``
        unless the table has one angle of incidence, with its standard error.
    path : path
        File with the suffix ``.brdf`` or ``.json``, written atomically.
    provenance : mapping
        Origin of the data, as for `splits.save_brdf`.
    license : mapping, optional
        Licence of the data, as for `splits.save_brdf`.
    **at
        Node of each other axis of the table.

    Raises
    ------
    ValueError
        For a missing axis, isotropic light, fewer than two polar angles, azimuths that do not
        extend from 0° to 180°, gaps, and incomplete provenance.
    """
    dataset = _add_incidence_axis(dataset)
    subset = select_reflectance_factor(dataset, at, min_incidences=1)
    if f"{REFLECTANCE_FACTOR}_stderr" not in subset:
        raise invalid("table", list(subset.data_vars), f"with {REFLECTANCE_FACTOR}_stderr")
    axes = [str(name) for name in dataset[REFLECTANCE_FACTOR].dims]
    nodes = {name: dataset[name].values[0] for name in axes if dataset[name].size == 1}
    nodes |= check_axis_values(at, axes)
    medium = str(dataset.attrs.get("medium", "medium"))
    attrs = {
        **dataset.attrs,
        "medium": medium,
        **{f"{medium}_{name}": nodes[name] for name in nodes if name not in OTHER_NODES},
    }
    both_sides = _add_mirrored_azimuths(subset)
    brdf = {
        name.replace(REFLECTANCE_FACTOR, "brdf"): both_sides[name].astype(float) / np.pi
        for name in map(str, both_sides.data_vars)
    }
    directions = xr.Dataset(brdf).rename({POLAR: "polar", AZIMUTH: "azimuth"})
    save_brdf(
        [
            directions.sel({INCIDENCE: angle}).assign_attrs(attrs | {"incidence_deg": angle})
            for angle in directions[INCIDENCE].values.tolist()
        ],
        path,
        provenance,
        license,
    )


def _add_incidence_axis(dataset: xr.Dataset) -> xr.Dataset:
    """Return a table with its single angle of incidence as an axis, others unchanged."""
    incidence = as_scalar(dataset.coords.get(INCIDENCE, dataset.attrs.get(INCIDENCE)))
    if INCIDENCE in dataset.dims or not isinstance(incidence, Real):
        return dataset
    without = dataset.drop_vars(INCIDENCE, errors="ignore")
    return without.expand_dims({INCIDENCE: [float(incidence)]})


def _add_mirrored_azimuths(subset: xr.Dataset) -> xr.Dataset:
    """Return directions over azimuths from 0 to less than 360°."""
    mirrored = subset.isel({AZIMUTH: slice(-2, 0, -1)})
    mirrored = mirrored.assign_coords({AZIMUTH: 360.0 - mirrored[AZIMUTH].values})
    return xr.concat([subset, mirrored], AZIMUTH)
