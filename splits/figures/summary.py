"""A table at a glance: spectra at a few nodes of each of its axes, never all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.figures.facets import faceted
from splits.figures.spectra import spectra
from splits.figures.style import parameter_label, value_label

LINES = 6
"""Values of the axis whose spectra are lines."""
PANELS = (3, 4)
"""Values of the axes whose values have panels: below each other, and side by side."""


def summary(
    dataset: xr.Dataset,
    quantity: Sequence[str],
    at: Mapping[str, Any],
    legend: str | None = None,
) -> Figure:
    """Draw a table: lines along its longest axis, panels along the next two, the rest fixed.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.table` returns it.
    quantity : sequence of str
    at : mapping
        From axes to the node that they are shown at; of those that have neither lines nor panels
        nor a place here, the middle one.
    legend : str, optional
        Title of the legend.
    """
    axes = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    # Deviations by group of rays are not shown.
    part = dataset.drop_dims("group", errors="ignore").sel(dict(at))
    free = sorted((n for n in axes if n not in at), key=lambda n: -dataset.sizes[n])
    free = [name for name in free if dataset.sizes[name] > 1]
    lines, apart, rest = free[:1], free[1:3], free[3:]
    single = [n for n in axes if n not in at and dataset.sizes[n] == 1]
    part = part.isel({n: (dataset.sizes[n] - 1) // 2 for n in (*rest, *single)})
    part = part.isel({n: _some(dataset.sizes[n], LINES) for n in lines})
    most = PANELS if len(apart) == 2 else (PANELS[0] * PANELS[1],)
    # The shorter axis of the two is the one whose panels lie below each other.
    apart = apart[::-1]
    part = part.isel({n: _some(dataset.sizes[n], m) for n, m in zip(apart, most, strict=False)})
    fixed = {n: part[n].values.item() for n in (*at, *rest) if n in part.coords}
    note = "at " + " · ".join(
        f"{parameter_label(n)} {value_label(v, n)}" for n, v in fixed.items()
    )  # fmt: skip
    shown = part.drop_vars([n for n in (*at, *rest, *single) if n in part.coords])
    note = note if fixed else ""
    if apart:
        return faceted(shown, quantity, apart, legend, note=note)
    return spectra(shown, quantity, None, {}, None, legend, None)


def _some(size: int, max_count: int) -> np.ndarray:
    """Return places evenly over an axis, both ends among them."""
    return np.unique(np.linspace(0, size - 1, min(size, max_count)).round().astype(int))
