"""Limits on the size of an experiment's figure, checked before anything runs."""

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
    """Reject a figure with more lines, rows or panels than are legible.

    Raises
    ------
    ValueError
        The message names the limit, the number and a remedy.
    """
    figure = experiment.figure
    section = experiment.resolve_figure()
    kind, fixed = section["kind"], figure.select
    if kind == "none":
        return
    sizes = {name: len(values) for name, values in experiment.grid.items() if name not in fixed}
    points = math.prod(sizes.values())
    has_many_wavelengths = kind in (
        "points", "principal_plane", "hemisphere", "polarization", "lobes", "spread"
    )  # fmt: skip
    wavelengths = experiment.instrument.get_wavelengths().size if has_many_wavelengths else 1
    if kind == "spectra":
        if choose_panel_parameters(sizes, len(figure.quantity), fixed) and figure.measured:
            allowed = f"left out for a figure of more than {MAX_LINES} lines"
            raise invalid(
                "figure.measured", figure.measured, allowed, "or fix more with figure.select"
            )
    elif kind == "points":
        check_count("points", points, MAX_ROWS, fixed)
        _check_wavelengths(wavelengths, MAX_LINES)
    elif kind == "swatches":
        columns, *rows = sizes.values()
        check_count("columns of colours", columns, MAX_COLUMNS, fixed)
        check_count("rows of colours", math.prod(rows), MAX_ROWS, fixed)
    elif kind == "lobes":
        _check_wavelengths(wavelengths, MAX_PANELS)
        check_count("surfaces", points * wavelengths, MAX_PANELS, fixed)
    elif kind == "hemisphere":
        _check_wavelengths(wavelengths, MAX_PANELS)
        maps = points * wavelengths * len(figure.quantity)
        check_count("maps", maps, MAX_PANELS, fixed)
    elif kind == "spread":
        _check_wavelengths(wavelengths, MAX_LINES // 2)
    elif kind in ("principal_plane", "polarization"):
        _check_wavelengths(wavelengths, MAX_LINES)
        check_count("lines", points * wavelengths, MAX_LINES, fixed)
    elif kind == "fit":
        check_count("lines", points, MAX_LINES, fixed)


def _check_wavelengths(count: int, max_count: int) -> None:
    """Reject more wavelengths than a figure can show; `figure.select` cannot reduce them."""
    if count > max_count:
        allowed = f"at most {max_count} wavelengths for this figure"
        raise invalid("instrument.wavelength_nm", f"{count} wavelengths", allowed, REDUCTION_HINT)
