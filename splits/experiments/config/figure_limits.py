"""Whether an experiment's figure can show what its grid holds, before anything runs."""

from __future__ import annotations

import math

from splits.core.validation import invalid
from splits.experiments.config.experiment import ExperimentConfig
from splits.plotting.panels import (
    MAX_COLUMNS,
    MAX_LINES,
    MAX_PANELS,
    MAX_ROWS,
    REDUCTION_HINT,
    check_count,
    choose_panel_parameters,
)


def check_figure_size(experiment: ExperimentConfig) -> None:
    """Refuse a figure of more lines, rows or panels than can be read.

    Raises
    ------
    ValueError
        The message names the limit, the number and what to do.
    """
    figure = experiment.figure
    drawing = experiment.resolve_figure()
    kind, at = drawing["kind"], figure.select
    if kind == "none":
        return
    sizes = {name: len(values) for name, values in experiment.grid.items() if name not in at}
    points = math.prod(sizes.values())
    several = kind in (
        "points", "principal_plane", "hemisphere", "polarization", "lobes", "spread"
    )  # fmt: skip
    wavelengths = experiment.instrument.get_wavelengths().size if several else 1
    if kind == "spectra":
        if choose_panel_parameters(sizes, len(figure.quantity), at) and figure.measured:
            allowed = f"left out for a figure of more than {MAX_LINES} lines"
            raise invalid(
                "figure.measured", figure.measured, allowed, "or hold more with figure.select"
            )
    elif kind == "points":
        check_count("points", points, MAX_ROWS, at)
        _check_wavelengths(wavelengths, MAX_LINES)
    elif kind == "swatches":
        columns, *rows = sizes.values()
        check_count("columns of colours", columns, MAX_COLUMNS, at)
        check_count("rows of colours", math.prod(rows), MAX_ROWS, at)
    elif kind == "lobes":
        _check_wavelengths(wavelengths, MAX_PANELS)
        check_count("surfaces", points * wavelengths, MAX_PANELS, at)
    elif kind == "hemisphere":
        _check_wavelengths(wavelengths, MAX_PANELS)
        maps = points * wavelengths * len(figure.quantity)
        check_count("maps", maps, MAX_PANELS, at)
    elif kind == "spread":
        _check_wavelengths(wavelengths, MAX_LINES // 2)
    elif kind in ("principal_plane", "polarization"):
        _check_wavelengths(wavelengths, MAX_LINES)
        check_count("lines", points * wavelengths, MAX_LINES, at)
    elif kind == "fit":
        check_count("lines", points, MAX_LINES, at)


def _check_wavelengths(count: int, max_count: int) -> None:
    """Refuse more wavelengths than a figure tells apart: no label of a grid holds them fixed."""
    if count > max_count:
        allowed = f"at most {max_count} wavelengths for this figure"
        raise invalid("instrument.wavelength_nm", f"{count} wavelengths", allowed, REDUCTION_HINT)
