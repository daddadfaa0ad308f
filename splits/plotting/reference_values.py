"""Panel of retrieved parameters against reference values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from splits.analysis.measured import fit_proportional
from splits.core.escaping import escape_mathtext
from splits.plotting.style import SMALL_FONT_PT, format_parameter, format_value, pick_colours

MIN_SLOPE_SAMPLES = 3
"""Smallest number of samples for a fitted slope."""
MODEL_MARKERS = "os^D"
"""Markers of models."""
MODEL_OFFSET = 0.012
"""Horizontal offset between the points of models, relative to the axis."""


def draw_against_reference(
    axes: Axes, dataset: xr.Dataset, name: str, reference: Mapping[str, float], prefix: str
) -> Axes:
    """Draw retrieved values of a parameter against reference values, for all models."""
    samples = select_referenced_samples(dataset, reference, prefix)
    x = np.array([reference[s] for s in samples])
    top = highest = float(x.max())
    models = get_model_colours(dataset)
    for number, (model, colour) in enumerate(models):
        part_of_model = dataset.sel(model=model, sample=samples)
        shifted = x + (number - 0.5 * (len(models) - 1)) * MODEL_OFFSET * top
        quantiles = part_of_model.quantiles.sel(parameter=name).transpose("quantile", "sample")
        lowest_value, low, y, high, highest_value = quantiles.values
        if not np.isfinite(y).all():
            continue
        for limits, width in (((lowest_value, highest_value), 0.6), ((low, high), 2.0)):
            axes.vlines(shifted, *limits, color=colour, lw=width)
        labels = [format_value(model, "model")] if model else []
        if len(samples) >= MIN_SLOPE_SAMPLES:
            line = fit_proportional(x, y)
            labels.append(f"slope {line.slope:.2f} ± {line.stderr:.2f}")
            labels.append(f"scatter {line.scatter:.2g}")
            misfit = part_of_model.chi2_at_reference.values
            if model and np.isfinite(misfit).all():
                expected = float(part_of_model.chi2_expected.sum())
                labels.append(f"χ² {misfit.sum():.0f} of {expected:.0f}")
        marker = MODEL_MARKERS[number % len(MODEL_MARKERS)]
        axes.plot(shifted, y, marker, color=colour, ms=3, label="\n".join(labels) or None)
        highest = max(highest, float(highest_value.max()))
    top = 1.08 * highest
    axes.plot([0.0, top], [0.0, top], color="black", lw=0.6)
    axes.set_title(escape_mathtext(prefix.strip()) or "against reference values")
    axes.set_xlabel(f"{format_parameter(name)}, reference")
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
    """Return the samples with a prefix that have reference values."""
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
