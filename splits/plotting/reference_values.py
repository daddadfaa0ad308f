"""What measured spectra tell, against what is known otherwise: a panel of a figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from splits.analysis.anisotropy import fit_proportional
from splits.core.escaping import escape_mathtext
from splits.plotting.style import SMALL_FONT_PT, format_parameter, format_value, pick_colours

MIN_SLOPE_SAMPLES = 3
"""Samples from which on a slope is told."""
MODEL_MARKERS = "os^D"
"""Of models, against what is known."""
MODEL_OFFSET = 0.012
"""How far models' points stand beside each other there, as a part of the axis."""


def draw_against_reference(
    axes: Axes, dataset: xr.Dataset, name: str, reference: Mapping[str, float], prefix: str
) -> Axes:
    """Draw what was found of a parameter against what is known of it, models side by side."""
    samples = select_referenced_samples(dataset, reference, prefix)
    x = np.array([reference[s] for s in samples])
    top = highest = float(x.max())
    models = get_model_colours(dataset)
    for number, (model, colour) in enumerate(models):
        own = dataset.sel(model=model, sample=samples)
        aside = x + (number - 0.5 * (len(models) - 1)) * MODEL_OFFSET * top
        part = own.quantiles.sel(parameter=name).transpose("quantile", "sample")
        widest, low, y, high, most = part.values
        if not np.isfinite(y).all():
            continue
        for ends, width in (((widest, most), 0.6), ((low, high), 2.0)):
            axes.vlines(aside, *ends, color=colour, lw=width)
        told = [format_value(model, "model")] if model else []
        if len(samples) >= MIN_SLOPE_SAMPLES:
            line = fit_proportional(x, y)
            told.append(f"slope {line.slope:.2f} ± {line.stderr:.2f}")
            told.append(f"scatter {line.scatter:.2g}")
            misfit = own.chi2_at_reference.values
            if model and np.isfinite(misfit).all():
                expected = float(own.chi2_expected.sum())
                told.append(f"χ² {misfit.sum():.0f} of {expected:.0f}")
        marker = MODEL_MARKERS[number % len(MODEL_MARKERS)]
        axes.plot(aside, y, marker, color=colour, ms=3, label="\n".join(told) or None)
        highest = max(highest, float(most.max()))
    top = 1.08 * highest
    axes.plot([0.0, top], [0.0, top], color="black", lw=0.6)
    axes.set_title(escape_mathtext(prefix.strip()) or "against what is known")
    axes.set_xlabel(f"{format_parameter(name)}, known")
    axes.set_ylabel(f"{format_parameter(name)}, retrieved")
    axes.set_xlim(0.0, top)
    axes.set_ylim(0.0, top)
    axes.set_aspect("equal", anchor="W")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5))
    if any(not str(handle.get_label()).startswith("_") for handle in axes.get_lines()):
        axes.legend(
            frameon=False, fontsize=SMALL_FONT_PT, loc="upper left", bbox_to_anchor=(1.0, 1.0)
        )
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def select_referenced_samples(
    dataset: xr.Dataset, reference: Mapping[str, float], prefix: str
) -> list[str]:
    """Return the samples of a group of which something is known."""
    return [s for s in reference if s in dataset.sample.values and s.startswith(prefix)]


def get_model_colours(dataset: xr.Dataset) -> list[tuple[str, Any]]:
    """Return the names of the models, with their colours."""
    names = list(map(str, dataset.model.values))
    return list(
        zip(
            names,
            pick_colours(len(names), "medium") if len(names) > 1 else pick_colours(1),
            strict=True,
        )
    )
