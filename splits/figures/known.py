"""What measured spectra tell, against what is known otherwise: a panel of a figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from splits.analysis.proportion import proportion
from splits.escaping import escape_mathtext
from splits.figures.style import SMALLEST, colours, parameter_label, value_label

FEWEST = 3
"""Samples from which on a slope is told."""
MARKERS = "os^D"
"""Of models, against what is known."""
ASIDE = 0.012
"""How far models' points stand beside each other there, as a part of the axis."""


def against(
    axes: Axes, dataset: xr.Dataset, name: str, reference: Mapping[str, float], prefix: str
) -> Axes:
    """Draw what was found of a parameter against what is known of it, models side by side."""
    samples = shown(dataset, reference, prefix)
    x = np.array([reference[s] for s in samples])
    top = highest = float(x.max())
    models = models_of(dataset)
    for number, (model, colour) in enumerate(models):
        own = dataset.sel(model=model, sample=samples)
        aside = x + (number - 0.5 * (len(models) - 1)) * ASIDE * top
        part = own.quantiles.sel(parameter=name).transpose("quantile", "sample")
        widest, low, y, high, most = part.values
        if not np.isfinite(y).all():
            continue
        for ends, width in (((widest, most), 0.6), ((low, high), 2.0)):
            axes.vlines(aside, *ends, color=colour, lw=width)
        told = [value_label(model, "model")] if model else []
        if len(samples) >= FEWEST:
            line = proportion(x, y)
            told.append(f"slope {line.slope:.2f} ± {line.stderr:.2f}")
            told.append(f"scatter {line.scatter:.2g}")
            misfit = own.chi2_where_known.values
            if model and np.isfinite(misfit).all():
                expected = float(own.chi2_expected.sum())
                told.append(f"χ² {misfit.sum():.0f} of {expected:.0f}")
        marker = MARKERS[number % len(MARKERS)]
        axes.plot(aside, y, marker, color=colour, ms=3, label="\n".join(told) or None)
        highest = max(highest, float(most.max()))
    top = 1.08 * highest
    axes.plot([0.0, top], [0.0, top], color="black", lw=0.6)
    axes.set_title(escape_mathtext(prefix.strip()) or "against what is known")
    axes.set_xlabel(f"{parameter_label(name)}, known")
    axes.set_ylabel(f"{parameter_label(name)}, retrieved")
    axes.set_xlim(0.0, top)
    axes.set_ylim(0.0, top)
    axes.set_aspect("equal", anchor="W")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5))
    if any(not str(handle.get_label()).startswith("_") for handle in axes.get_lines()):
        axes.legend(frameon=False, fontsize=SMALLEST, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def shown(dataset: xr.Dataset, reference: Mapping[str, float], prefix: str) -> list[str]:
    """Return the samples of a group of which something is known."""
    return [s for s in reference if s in dataset.sample.values and s.startswith(prefix)]


def models_of(dataset: xr.Dataset) -> list[tuple[str, Any]]:
    """Return the names of the models, with their colours."""
    names = list(map(str, dataset.model.values))
    return list(zip(names, colours(len(names), "medium") if len(names) > 1 else colours(1),
                    strict=True))  # fmt: skip
