"""Whether an experiment's figure can show what its grid holds, before anything runs."""

from __future__ import annotations

import math

from splits.checks import refuse
from splits.experiments.model import Experiment
from splits.panels import (
    HOW,
    MOST_COLUMNS,
    MOST_LINES,
    MOST_PANELS,
    MOST_ROWS,
    check_count,
    facets,
)


def check_size(experiment: Experiment) -> None:
    """Refuse a figure of more lines, rows or panels than can be read.

    Raises
    ------
    ValueError
        The message names the limit, the number and what to do.
    """
    figure = experiment.figure
    drawing = experiment.resolve_figure()
    kind, at = drawing["kind"], figure.at
    if kind == "none":
        return
    sizes = {name: len(values) for name, values in experiment.grid.items() if name not in at}
    points = math.prod(sizes.values())
    several = kind in (
        "points", "principal_plane", "hemisphere", "polarization", "lobes", "spread"
    )  # fmt: skip
    wavelengths = experiment.instrument.get_wavelengths().size if several else 1
    if kind == "spectra":
        if facets(sizes, len(figure.quantity), at) and figure.measured:
            allowed = f"left out for a figure of more than {MOST_LINES} lines"
            raise refuse("figure.measured", figure.measured, allowed, "or hold more with figure.at")
    elif kind == "points":
        check_count("points", points, MOST_ROWS, at)
        _check_wavelengths(wavelengths, MOST_LINES)
    elif kind == "swatches":
        columns, *rows = sizes.values()
        check_count("columns of colours", columns, MOST_COLUMNS, at)
        check_count("rows of colours", math.prod(rows), MOST_ROWS, at)
    elif kind == "lobes":
        _check_wavelengths(wavelengths, MOST_PANELS)
        check_count("surfaces", points * wavelengths, MOST_PANELS, at)
    elif kind == "hemisphere":
        _check_wavelengths(wavelengths, MOST_PANELS)
        maps = points * wavelengths * len(figure.quantity)
        check_count("maps", maps, MOST_PANELS, at)
    elif kind == "spread":
        _check_wavelengths(wavelengths, MOST_LINES // 2)
    elif kind in ("principal_plane", "polarization"):
        _check_wavelengths(wavelengths, MOST_LINES)
        check_count("lines", points * wavelengths, MOST_LINES, at)
    elif kind == "fit":
        check_count("lines", points, MOST_LINES, at)


def _check_wavelengths(count: int, max_count: int) -> None:
    """Refuse more wavelengths than a figure tells apart: no label of a grid holds them fixed."""
    if count > max_count:
        allowed = f"at most {max_count} wavelengths for this figure"
        raise refuse("instrument.wavelength_nm", f"{count} wavelengths", allowed, HOW)
