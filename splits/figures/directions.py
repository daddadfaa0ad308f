"""Where light goes: principal planes, lobes, collectors."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.analysis.directions import merged_cells, principal_plane
from splits.dataset import at_points
from splits.figures.style import BAND, Colour, colours, parameter_label, style, value_label

STEEPEST_DEG = 82.5
"""Angle from the normal up to which directions are drawn; errors are held up to there."""

NAMES = {
    "brdf": "BRDF (1/sr)",
    "btdf": "BTDF (1/sr)",
    "reflectance_factor": "bidirectional reflectance factor",
    "anisotropy_factor": "anisotropy factor",
}


def principal_planes(
    dataset: xr.Dataset,
    quantity: str = "brdf",
    at: Mapping[str, float | str] | None = None,
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw the principal plane as a polar plot and over the viewing angle, with error bands.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.goniophotometer`, or of an experiment with it.
    quantity : str
        One of `NAMES`.
    at : mapping, optional
        Grid labels to hold fixed.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    ylim : (low, high), optional
        Of the second panel, and the outer radius of the first.
    """
    plane = plane_of(_part(dataset, at))
    with style():
        figure = plt.figure(figsize=(8.8, 3.9))
        polar = figure.add_subplot(1, 2, 1, projection="polar")
        flat = figure.add_subplot(1, 2, 2)
        for axes, scale in ((polar, np.pi / 180.0), (flat, 1.0)):
            for number, (label, colour, line) in enumerate(lines_of(plane, quantity)):
                angle = scale * line.angle.values
                value, error = line[quantity].values, BAND * line[f"{quantity}_stderr"].values
                dash = DASHES[number % len(DASHES)]
                axes.plot(angle, value, color=colour, ls=dash, lw=1.4, label=label)
                axes.fill_between(
                    angle, np.maximum(value - error, 0.0), value + error,
                    color=colour, alpha=0.3, lw=0,
                )  # fmt: skip
        top = ylim[1] if ylim else None
        _half_circle(polar, top)
        _beams(polar, plane, quantity)
        flat.set(xlabel="viewing angle, forward positive (°)", ylabel=NAMES[quantity])
        flat.set_ylim(*(ylim or (0.0, None)))
        flat.set_xticks(np.arange(-90, 91, 30))
        flat.spines[["top", "right"]].set_visible(False)
        title = legend or " · ".join(parameter_label(d) for d in _dims(plane, quantity))
        if title:
            many = len(flat.get_legend_handles_labels()[0]) > 4
            place: dict[str, Any] = (
                {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if many else {}
            )
            flat.legend(title=title, frameon=False, **place)
        figure.tight_layout()
    return figure


DASHES = ("-", "--", ":", "-.")


def lobes(dataset: xr.Dataset, at: Mapping[str, float | str] | None = None) -> Figure:
    """Draw the BRDF of every angle of incidence as a surface, and its principal plane below.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of an experiment with a goniophotometer; one grid parameter and one wavelength.
    at : mapping, optional
        Grid labels to hold fixed.
    """
    dataset = _part(dataset, at)
    dataset = dataset.isel(polar=dataset.polar.values <= STEEPEST_DEG)
    whole = dataset.pad(azimuth=(0, 1), mode="wrap")
    azimuth = np.radians(np.append(dataset.azimuth.values, dataset.azimuth.values[0] + 360.0))
    plane = plane_of(dataset)
    names = [label for label, _, _ in lines_of(plane, "brdf")]
    top = 1.05 * float(dataset.brdf.max())
    with style():
        figure = plt.figure(figsize=(3.1 * len(names), 6.0))
        for column, ((label, colour, line), (_, _, lobe)) in enumerate(
            zip(lines_of(plane, "brdf"), lines_of(whole, "brdf"), strict=True)
        ):
            axes = figure.add_subplot(2, len(names), column + 1, projection="3d")
            tilt = np.radians(lobe.polar.values)[:, np.newaxis]
            radius = lobe.brdf.transpose("polar", "azimuth").values
            axes.plot_surface(
                radius * np.sin(tilt) * np.cos(azimuth),
                radius * np.sin(tilt) * np.sin(azimuth),
                radius * np.cos(tilt) * np.ones_like(azimuth),
                color=colour, rcount=40, ccount=80, lw=0, antialiased=True, shade=True,
            )  # fmt: skip
            axes.set(xlim=(-top, top), ylim=(-top, top), zlim=(0.0, top))
            axes.set_box_aspect((2, 2, 1), zoom=1.35)
            axes.set_axis_off()
            axes.view_init(elev=20, azim=-70)
            incidence = _incidence(line)
            arrow = 1.1 * top * np.array([-np.sin(incidence), 0.0, np.cos(incidence)])
            axes.plot(*np.stack([arrow, np.zeros(3)], axis=1), color="black", lw=1.0, ls="--")
            dims = " · ".join(parameter_label(d) for d in _dims(plane, "brdf"))
            axes.set_title(f"{dims}: {label}" if dims else "", y=0.92)
            flat = figure.add_subplot(2, len(names), len(names) + column + 1, projection="polar")
            angle = np.radians(line.angle.values)
            value, error = line.brdf.values, BAND * line.brdf_stderr.values
            flat.plot(angle, value, color=colour, lw=1.4)
            flat.fill_between(angle, value - error, value + error, color=colour, alpha=0.3, lw=0)
            flat.plot([-incidence, -incidence], [0.0, top], color="black", lw=1.0, ls="--")
            _half_circle(flat, top)
        figure.suptitle(NAMES["brdf"] + ", dashed: towards the source", fontsize=11)
        figure.tight_layout()
    return figure


def collectors(dataset: xr.Dataset, at: Mapping[str, float | str] | None = None) -> Figure:
    """Draw the principal plane as cells of several sizes see it.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of a goniophotometer with cells, without a grid or at one point of it; one wavelength.
    at : mapping, optional
        Grid labels to hold fixed.
    """
    dataset = _part(dataset, at).isel(wavelength=0)
    counts = dataset.sizes["polar"], dataset.sizes["azimuth"]
    factors = [f for f in (9, 5, 3, 1) if not (counts[0] % f or counts[1] % (2 * f))]
    with style():
        figure, axes = plt.subplots(figsize=(6.4, 3.9))
        for factor, colour in zip(factors, colours(len(factors)), strict=True):
            plane = principal_plane(merged_cells(dataset, factor))
            label = f"{counts[0] // factor} × {counts[1] // factor}"
            # The larger the cells, the less noise: they lie on top.
            axes.errorbar(
                plane.angle, plane.brdf, BAND * plane.brdf_stderr, color=colour, fmt="o-",
                ms=3, lw=0.6 + 0.2 * factor, capsize=2, label=label, zorder=2.0 + 0.1 * factor,
            )  # fmt: skip
        axes.set(xlabel="viewing angle, forward positive (°)", ylabel=NAMES["brdf"])
        axes.set_ylim(0.0, None)
        axes.set_xticks(np.arange(-90, 91, 30))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(title="cells, polar × around", frameon=False)
        figure.tight_layout()
    return figure


def _part(dataset: xr.Dataset, at: Mapping[str, float | str] | None) -> xr.Dataset:
    """Return the dataset at labels of its grid; its attributes keep the angle of incidence."""
    at = at or {}
    known = {key: float(at[key]) for key in ("incidence_deg",) if key in at}
    return at_points(dataset, at).assign_attrs(known)


def plane_of(dataset: xr.Dataset) -> xr.Dataset:
    """Return the principal plane up to `STEEPEST_DEG`."""
    plane = principal_plane(dataset)
    return plane.isel(angle=np.abs(plane.angle.values) <= STEEPEST_DEG)


def _dims(dataset: xr.Dataset, quantity: str) -> list[str]:
    """Return the dimensions along which lines are drawn."""
    directions = ("angle", "polar", "azimuth")
    dims = [str(d) for d in dataset[quantity].dims if d not in directions]
    return [d for d in dims if d != "wavelength" or dataset.sizes[d] > 1]


def lines_of(dataset: xr.Dataset, quantity: str) -> Iterator[tuple[str, Colour, xr.Dataset]]:
    """Yield a label, a colour and the part of the dataset for every line."""
    dims = _dims(dataset, quantity)
    if "wavelength" in dataset.dims and "wavelength" not in dims:
        dataset = dataset.isel(wavelength=0)
    combinations = list(itertools.product(*(dataset[d].values for d in dims)))
    shades = colours(len(combinations), dims[0] if dims else None)
    for labels, colour in zip(combinations, shades, strict=True):
        text = " · ".join(
            value_label(label) + (" nm" if d == "wavelength" else "")
            for d, label in zip(dims, labels, strict=True)
        )
        yield text, colour, dataset.sel(dict(zip(dims, labels, strict=True)))


def _incidence(line: xr.Dataset) -> float:
    """Return the angle of incidence (radians) of a line."""
    place = line.coords.get("incidence_deg")
    return float(np.radians(float(line.attrs["incidence_deg"] if place is None else place)))


def _beams(axes: Axes, plane: xr.Dataset, quantity: str) -> None:
    """Draw where the light comes from."""
    top = axes.get_ylim()[1]
    seen = set()
    for number, (_, colour, line) in enumerate(lines_of(plane, quantity)):
        incidence = _incidence(line)
        if incidence not in seen:
            varies = "incidence_deg" in _dims(plane, quantity)
            axes.plot(
                [-incidence, -incidence], [0.0, top], color=colour if varies else "black",
                lw=1.0, ls=DASHES[number % len(DASHES)] if varies else "-",
            )  # fmt: skip
        seen.add(incidence)
    axes.set_ylim(0.0, top)


def _half_circle(axes: Axes, top: float | None) -> None:
    axes.set_theta_zero_location("N")  # type: ignore[attr-defined]
    axes.set_theta_direction(-1)  # type: ignore[attr-defined]
    axes.set_thetalim(-np.pi / 2, np.pi / 2)  # type: ignore[attr-defined]
    axes.set_ylim(0.0, top)
    axes.set_thetagrids(np.arange(-90, 91, 30))  # type: ignore[attr-defined]
    axes.tick_params(labelsize=9)
    axes.yaxis.set_major_locator(plt.MaxNLocator(3))
    axes.grid(color=".85", lw=0.6)
