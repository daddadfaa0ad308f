"""Requirements of studies on their experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from splits.core.validation import invalid
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.instruments import Goniophotometer
from splits.experiments.config.media import make_label, to_coordinate_values


@dataclass(frozen=True)
class StudyInput:
    """Requirements on an input experiment.

    Attributes
    ----------
    axes : tuple of str
        Parameters of its grid, exactly.
    labels : mapping
        Values that its grid must contain, by parameter.
    at_nm, band_nm : tuple of float
        Wavelengths that it must contain, and the ends of a range that it must cover (nm).
    instrument : str
    """

    axes: tuple[str, ...] = ()
    labels: Mapping[str, tuple[float | str, ...]] = field(default_factory=dict)
    at_nm: tuple[float, ...] = ()
    band_nm: tuple[float, ...] = ()
    instrument: str = "spectrophotometer"


def make_goniophotometer_input(*axes: str, **requirements: Any) -> StudyInput:
    """Return the requirements on an experiment with a goniophotometer."""
    return StudyInput(axes, instrument="goniophotometer", **requirements)


def check_input(name: str, experiment: ExperimentConfig, required: StudyInput) -> None:
    """Reject an experiment that does not meet the requirements of an input."""
    instrument, grid = experiment.instrument, experiment.grid

    def make_error(allowed: str) -> ValueError:
        return invalid(name, experiment.name, allowed)

    if instrument.kind != required.instrument or experiment.fit:
        raise make_error(f"an experiment with a {required.instrument}")
    if set(grid) != set(required.axes) or any(len(grid[key]) < 2 for key in required.axes):
        grid_rule = f"over {' and '.join(required.axes)}, two values or more each"
        raise make_error(f"an experiment {grid_rule if required.axes else 'without a grid'}")
    for key, labels in required.labels.items():
        for label in labels:
            if not _has_value(grid[key], label):
                raise make_error(f"an experiment with {key} = {label} on its grid")
    wavelengths = instrument.get_wavelengths()
    for wavelength in required.at_nm:
        if not np.isclose(wavelengths, wavelength).any():
            raise make_error(f"an experiment with wavelength {wavelength:g} nm")
    if required.band_nm and (
        wavelengths[0] > required.band_nm[0] or wavelengths[-1] < required.band_nm[-1]
    ):
        low, high = required.band_nm
        raise make_error(f"an experiment over wavelengths from {low:g} to {high:g} nm")
    if isinstance(instrument, Goniophotometer) and (
        instrument.polar_deg or instrument.estimator == "bins"
    ):
        raise make_error("an experiment with the usual polar_deg")


def _has_value(values: Mapping[str, Any], target: float | str) -> bool:
    """Return whether the coordinate of a grid has a value: a number, or else a label."""
    coordinate = to_coordinate_values(values)
    if coordinate.dtype.kind == "f":
        return not isinstance(target, str) and bool(np.isclose(coordinate, target).any())
    return make_label("", target) in values
