"""Where light goes in the plane of the beam: principal planes, collectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from splits.analysis.directions import merged_cells, principal_plane
from splits.dataset import at_points
from splits.figures.lines import Lines
from splits.figures.style import BAND, Colour, Drawing, colours, style, subplots, value_label

STEEPEST_DEG = 82.5
"""Angle from the normal up to which directions are drawn; errors are held up to there."""

NAMES = {
    "brdf": "BRDF (sr⁻¹)",
    "btdf": "BTDF (sr⁻¹)",
    "reflectance_factor": "bidirectional reflectance factor",
    "anisotropy_factor": "anisotropy factor",
}
VIEWING = "viewing angle, forward positive (°)"
INSIDE = 4
"""Up to so many lines have their legend on the axes."""


def principal_planes(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("brdf",),
    at: Mapping[str, float | str] | None = None,
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw the principal plane as a polar plot and over the viewing angle, with error bands.

    Light that is transmitted goes down in the polar plot.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.goniophotometer`, or of an experiment with it.
    quantity : sequence of str
        Of `NAMES`, a row of panels each.
    at : mapping, optional
        Grid labels to hold fixed.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    ylim : (low, high), optional
        Of the second panel, and the outer radius of the first.
    """
    plane = plane_of(part_at(dataset, at))
    lines = lines_of(plane, quantity[0])
    with style():
        figure = Drawing(figsize=(8.8, 3.9 * len(quantity)), layout="constrained")
        flats = []
        for row, name in enumerate(quantity):
            polar = figure.add_subplot(len(quantity), 2, 2 * row + 1, projection="polar")
            flat = figure.add_subplot(len(quantity), 2, 2 * row + 2)
            flats.append(flat)
            down = name == "btdf"
            dark = not (plane[name] > 0.0).any()
            for one in () if dark else lines.all:
                line = part_of(plane, one.labels)
                angle = line.angle.values
                value, error = line[name].values, BAND * line[f"{name}_stderr"].values
                low = np.maximum(value - error, 0.0)
                turned = directions(angle, down)
                polar.plot(turned, np.maximum(value, 0.0), label=one.text, **one.look())
                polar.fill_between(turned, low, value + error, color=one.colour, alpha=0.3, lw=0)
                flat.plot(angle, value, label=one.text, **one.look())
                flat.fill_between(angle, low, value + error, color=one.colour, alpha=0.3, lw=0)
            half_circle(polar, ylim[1] if ylim else None, down)
            if dark:
                _say_dark(plane, name, polar, flat)
            else:
                _beams(polar, plane, lines, down)
            # Outside the half circle, where the radii have their numbers.
            polar.text(
                0.5, 0.86 if down else 0.14, NAMES[name], transform=polar.transAxes, ha="center",
                va="bottom" if down else "top",
            )  # fmt: skip
            flat.set(xlabel=VIEWING, ylabel=NAMES[name], ylim=ylim or (0.0, None))
            flat.set_xticks(np.arange(-90, 91, 30))
            flat.spines[["top", "right"]].set_visible(False)
        lines.legend(figure, flats, legend, INSIDE)
    return figure


def _say_dark(plane: xr.Dataset, name: str, *panels: Axes) -> None:
    """Write into panels that no light went their way, and within what error."""
    text = "nothing transmitted" if name == "btdf" else "nothing reflected"
    bound = BAND * float(plane[f"{name}_stderr"].max())
    if bound > 0.0:
        text += f"\nwithin {value_label(float(f'{bound:.1g}'))}"
        text += " sr⁻¹" if "sr⁻¹" in NAMES[name] else ""
    for axes in panels:
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
        axes.set_yticks([])


def collectors(dataset: xr.Dataset, at: Mapping[str, float | str] | None = None) -> Figure:
    """Draw the principal plane as cells of several sizes see it.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of a goniophotometer with cells, without a grid or at one point of it; one wavelength.
    at : mapping, optional
        Grid labels to hold fixed.
    """
    dataset = part_at(dataset, at).isel(wavelength=0)
    counts = dataset.sizes["polar"], dataset.sizes["azimuth"]
    factors = [f for f in (9, 5, 3, 1) if not (counts[0] % f or counts[1] % (2 * f))]
    with style():
        figure, axes = subplots(figsize=(6.4, 3.9), layout="constrained")
        for factor, colour in zip(factors, colours(len(factors)), strict=True):
            plane = _with_gap(principal_plane(merged_cells(dataset, factor)))
            angle, value = plane.angle.values, plane.brdf.values
            error = BAND * plane.brdf_stderr.values
            label = f"{counts[0] // factor} × {counts[1] // factor}"
            # The larger the cells, the less noise: they lie on top.
            above = 2.0 + 0.1 * factor
            axes.fill_between(
                angle, np.maximum(value - error, 0.0), value + error, color=colour, alpha=0.25,
                lw=0, zorder=above - 0.05,
            )  # fmt: skip
            axes.plot(
                angle, value, "o-", color=colour, ms=2.0 + 0.3 * factor, lw=0.6 + 0.2 * factor,
                label=label, zorder=above,
            )  # fmt: skip
        axes.set(xlabel=VIEWING, ylabel=NAMES["brdf"], ylim=(0.0, None))
        axes.set_xticks(np.arange(-90, 91, 30))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(title="cells, polar × around", frameon=False)
    return figure


def part_at(dataset: xr.Dataset, at: Mapping[str, float | str] | None) -> xr.Dataset:
    """Return the dataset at labels of its grid; its attributes keep the angle of incidence."""
    at = at or {}
    known = {key: float(at[key]) for key in ("incidence_deg",) if key in at}
    return at_points(dataset, at).assign_attrs(known)


def plane_of(dataset: xr.Dataset) -> xr.Dataset:
    """Return the principal plane up to `STEEPEST_DEG`, with a gap where no cell looks."""
    plane = principal_plane(dataset)
    plane = plane.isel(angle=np.abs(plane.angle.values) <= STEEPEST_DEG)
    return _with_gap(plane) if dataset.attrs.get("estimator") == "cells" else plane


def _with_gap(plane: xr.Dataset) -> xr.Dataset:
    """Return a plane without values at the zenith, so that no line joins its halves."""
    if 0.0 in plane.angle.values:
        return plane
    return plane.reindex(angle=np.sort(np.append(plane.angle.values, 0.0)))


def lines_of(dataset: xr.Dataset, quantity: str) -> Lines:
    """Return the lines of a quantity over directions; one wavelength needs no words."""
    directions = ("angle", "polar", "azimuth")
    dims = [str(d) for d in dataset[quantity].dims if d not in directions]
    dims = [d for d in dims if d != "wavelength" or dataset.sizes[d] > 1]
    return Lines(dataset, dims, dashed=True)


def part_of(dataset: xr.Dataset, labels: Mapping[str, float | str]) -> xr.Dataset:
    """Return what one line shows."""
    dataset = dataset.sel(labels)
    return dataset.isel(wavelength=0) if "wavelength" in dataset.dims else dataset


def directions(angle_deg: np.ndarray, down: bool = False) -> np.ndarray:
    """Return the polar plot's angles (radians) of viewing angles, for light going up or down."""
    angle = np.radians(angle_deg)
    return np.pi - angle if down else angle


def incidence_of(line: xr.Dataset) -> float:
    """Return the angle of incidence (degrees) of a line."""
    place = line.coords.get("incidence_deg")
    return float(line.attrs["incidence_deg"] if place is None else place)


def _beams(axes: Axes, plane: xr.Dataset, lines: Lines, down: bool) -> None:
    """Draw where the light comes from, or where it would go straight on."""
    top = axes.get_ylim()[1]
    shades: dict[float, list[Colour]] = {}
    for one in lines.all:
        shades.setdefault(incidence_of(part_of(plane, one.labels)), []).append(one.colour)
    for incidence, used in shades.items():
        # Several beams have the colours of their lines.
        own = len(shades) > 1 and used.count(used[0]) == len(used)
        turned = directions(np.full(2, incidence if down else -incidence), down)
        axes.plot(turned, [0.0, top], color=used[0] if own else "black", **_beam(down))
    axes.set_ylim(0.0, top)
    told = Line2D([], [], color="black" if len(shades) == 1 else "0.5", **_beam(down))
    told.set_label("straight on" if down else "towards the source")
    axes.legend(
        handles=[told], frameon=False, loc="lower center" if down else "upper center",
        bbox_to_anchor=(0.5, 0.92) if down else (0.5, 0.08),
    )  # fmt: skip


def _beam(down: bool) -> dict[str, Any]:
    mark: dict[str, Any] = (
        {} if down else {"marker": "o", "ms": 5, "markevery": [-1], "clip_on": False}
    )
    return {"lw": 0.9, "ls": "-", **mark}


def half_circle(axes: Axes, top: float | None, down: bool = False) -> None:
    """Make polar axes a half circle of viewing angles, above the surface or below."""
    ticks = np.arange(-90, 91, 30)
    axes.set_theta_zero_location("N")  # type: ignore[attr-defined]
    axes.set_theta_direction(-1)  # type: ignore[attr-defined]
    axes.set_thetalim(*np.sort(directions(np.array([-90.0, 90.0]), down)))  # type: ignore[attr-defined]
    axes.set_ylim(0.0, top)
    axes.set_thetagrids(  # type: ignore[attr-defined]
        np.degrees(directions(ticks, down)), [f"{t}°".replace("-", "−") for t in ticks]
    )
    axes.tick_params(labelsize=9)
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.grid(color=".85", lw=0.6)
