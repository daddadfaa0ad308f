"""Fitted against measured spectra."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from splits.figures.lines import Lines
from splits.figures.style import BAND, style, subplots, value_label


def fits(dataset: xr.Dataset, legend: str | None = None) -> Figure:
    """Draw measured and fitted reflectance, a column per sample, and their difference below.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.experiments.run_fit.run_fit` returns it.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    """
    dims = [str(d) for d in dataset.rmse.dims if d != "sample"]
    lines = Lines(dataset, dims)
    samples = dataset.sample.values
    highest = max(
        float(dataset.measured.max()),
        float((dataset.reflectance + BAND * dataset.reflectance_stderr).max()),
    )
    with style():
        figure, panels = subplots(
            2, len(samples), figsize=(3.4 * len(samples) + 0.8, 5.2), sharex=True, sharey="row",
            gridspec_kw={"height_ratios": [2.2, 1]}, squeeze=False,
        )  # fmt: skip
        for column, sample in enumerate(samples):
            top, bottom = panels[:, column]
            part = dataset.sel(sample=sample)
            x = part.wavelength.values
            for line in lines.all:
                one = part.sel(line.labels)
                y, error = one.reflectance.values, BAND * one.reflectance_stderr.values
                text = f"{line.text or 'model'}: {float(one.rmse):.4f}"
                top.plot(x, y, label=text, **line.look())
                top.fill_between(x, y - error, y + error, color=line.colour, alpha=0.25, lw=0)
                off = y - one.measured.values
                bottom.plot(x, off, **line.look())
                bottom.fill_between(
                    x, off - error, off + error, color=line.colour, alpha=0.25, lw=0
                )
            measured = part.measured.isel(dict.fromkeys(dims, 0)).values
            top.plot(x, measured, "ks", ms=3.5, label="measured")
            bottom.axhline(0.0, color="black", lw=0.8)
            top.set_title(value_label(sample, "sample"))
            top.set_ylim(0.0, 1.12 * highest)
            title = legend or lines.title() or "model"
            top.legend(title=f"{title}: misfit", frameon=False, fontsize=8, title_fontsize=8)
            bottom.set_xlabel("wavelength (nm)")
            for axes in (top, bottom):
                axes.spines[["top", "right"]].set_visible(False)
        panels[0, 0].set_ylabel("reflectance")
        panels[1, 0].set_ylabel("model − measured")
        figure.tight_layout()
    return figure
