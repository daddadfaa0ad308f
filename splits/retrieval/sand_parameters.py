"""Parameters of a sand in a fit, and their unit cube of coordinates.

Every point of the cube is a sand within the ranges of SPLITS Table 2.  Partitions and textures have
two coordinates each.  The coordinate is logarithmic where reflectance depends on the logarithm of
the parameter.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_named_numbers
from splits.core.validation import check_range, invalid, suggest_name
from splits.media import Sand
from splits.retrieval.state_vector import ParameterRange, StateVector

DEFAULT_RANGES: dict[str, tuple[float, float]] = {
    "iron_oxide": (0.0005, 0.05),
    "hematite_ratio": (0.0, 1.0),
    "magnetite": (0.0, 0.3),
    "pure": (0.0, 1.0),
    "coated_fraction": (0.0, 1.0),
    "fines": (0.005, 0.15),
    "clay": (1e-4, 0.1),
}
"""Default ranges, SPLITS Table 2: ``pure`` is the mass fraction of pure particles,
``coated_fraction`` the coated fraction of the others, ``fines`` silt + 1.5 clay, and ``clay`` the
mass fraction of clay, limited to fines/1.5.  Clay below the ``size_tail`` of `splits.Sand` is
negligible."""

RANGE_LIMITS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(DEFAULT_RANGES, (0.0, 1.0)),
    "fines": (0.0, 0.15),
    "clay": (0.0, 0.1),
}
"""Limits of the ranges."""

LOGARITHMIC_PARAMETERS = ("iron_oxide", "magnetite", "clay")
"""Parameters with a logarithmic coordinate, since small amounts have a large effect."""
_ZERO_START_SLOPE_RATIO = 100.0
"""Ratio of the slopes at both ends of a geometric coordinate that starts at 0."""

FITTED_KEYWORDS = ("iron_oxide", "hematite_ratio", "magnetite", "partition", "texture")
"""Keywords of `splits.Sand` that a fit varies."""


class UnitCube:
    """The unit cube of coordinates, one for every range.

    Parameters
    ----------
    fixed_keywords : mapping
        Keywords of `splits.Sand` that stay fixed.
    ranges : mapping, optional
        (low, high) by name, instead of those of `DEFAULT_RANGES`.

    Attributes
    ----------
    names : tuple of str
        Names of the coordinates.
    state_vector : StateVector
        State vector of the coordinates.
    ranges : dict

    Raises
    ------
    ValueError
        For an invalid range or keyword.
    """

    def __init__(
        self,
        fixed_keywords: Mapping[str, Any],
        ranges: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.fixed_keywords = dict(fixed_keywords)
        for key in self.fixed_keywords:
            if key in FITTED_KEYWORDS:
                raise invalid(
                    key, self.fixed_keywords[key], "left out", "the fit varies it; see ranges"
                )
        self.ranges = resolve_ranges(ranges or {})
        self.names = tuple(self.ranges)
        unit = ParameterRange(0.0, 1.0, "identity")
        self.state_vector = StateVector.from_ranges(
            self.names, None, dict.fromkeys(self.names, unit)
        )
        for corner in itertools.product((0.0, 1.0), repeat=len(self.names)):
            try:
                self.to_sand(np.array(corner))
            except ValueError as error:
                raise ValueError(f"ranges: must contain valid sands only: {error}") from None

    def to_keywords(self, coordinates: np.ndarray) -> dict[str, Any]:
        """Return the keywords of the sand at a point of the cube, including the fixed ones.

        Parameters
        ----------
        coordinates : float, shape (coordinates,)
            Each 0 to 1, in the order of `names`.
        """
        coordinate_of = dict(zip(self.names, np.asarray(coordinates, dtype=float), strict=True))

        def interpolate(name: str, maximum: float = np.inf) -> float:
            low, high = self.ranges[name]
            high = min(high, maximum)
            slope_ratio = (
                (high / low if low > 0.0 else _ZERO_START_SLOPE_RATIO)
                if name in LOGARITHMIC_PARAMETERS
                else 1.0
            )
            fraction = (
                coordinate_of[name]
                if slope_ratio == 1.0
                else (slope_ratio ** coordinate_of[name] - 1.0) / (slope_ratio - 1.0)
            )
            return float(min(max(low + fraction * (high - low), low), high))

        pure = interpolate("pure")
        coated = (1.0 - pure) * interpolate("coated_fraction")
        mixed = max(1.0 - pure - coated, 0.0)
        fines = interpolate("fines")
        clay = interpolate("clay", fines / 1.5)
        silt = max(fines - 1.5 * clay, 0.0)
        return {
            **self.fixed_keywords,
            "iron_oxide": interpolate("iron_oxide"),
            "hematite_ratio": interpolate("hematite_ratio"),
            "magnetite": interpolate("magnetite"),
            "partition": (pure, mixed, coated),
            "texture": (clay, silt, 1.0 - clay - silt),
        }

    def to_sand(self, coordinates: np.ndarray) -> Sand:
        """Return the sand at a point of the cube."""
        return Sand(**self.to_keywords(coordinates))

    def to_parameters(self, coordinates: np.ndarray) -> dict[str, float]:
        """Return the parameters at a point of the cube by name."""
        keywords = self.to_keywords(coordinates)
        partition = zip(("pure", "mixed", "coated"), keywords["partition"], strict=True)
        return {
            **{name: keywords[name] for name in ("iron_oxide", "hematite_ratio", "magnetite")},
            **{f"partition_{name}": value for name, value in partition},
            **dict(zip(("clay", "silt", "sand"), keywords["texture"], strict=True)),
        }


def resolve_ranges(given: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return `DEFAULT_RANGES` with given ones replaced; reject invalid ranges."""
    ranges = dict(DEFAULT_RANGES)
    for name, values in given.items():
        if name not in DEFAULT_RANGES:
            allowed = "one of " + ", ".join(DEFAULT_RANGES)
            raise invalid("ranges", name, allowed, suggest_name(name, DEFAULT_RANGES))
        low, high = check_named_numbers(
            f"ranges.{name}", values, ("low", "high"), RANGE_LIMITS[name]
        )
        for bound, value in (("low", low), ("high", high)):
            check_range(f"ranges.{name} ({bound})", value, *RANGE_LIMITS[name])
        if not low < high:
            raise invalid(f"ranges.{name}", values, "low < high")
        ranges[name] = (low, high)
    if 1.5 * ranges["clay"][0] > ranges["fines"][0]:
        raise invalid(
            "ranges.clay (low)",
            ranges["clay"][0],
            f"at most {ranges['fines'][0] / 1.5:g}",
            "all clay counts 1.5 times among the fines",
        )
    return ranges


@dataclass(frozen=True)
class FittedParameter:
    """A fitted parameter and its error.

    Attributes
    ----------
    value : float
        A mass fraction, or the fraction of hematite in the iron oxide.
    stderr : float
        Standard error, the root-mean-square deviation of the posterior from the value.
    constrained : bool
        Whether the error, in ranks among all sands of the ranges, is below half of that without a
        measurement.
    """

    value: float
    stderr: float
    constrained: bool


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """Result of a fit of a sand.

    Attributes
    ----------
    parameters : dict of FittedParameter
        iron_oxide, hematite_ratio, magnetite, partition_pure, partition_mixed,
        partition_coated, clay, silt, sand.
    settings : dict
        Keywords of `splits.Sand` for the fitted sand, including the fixed ones.
    rmse, rmse_stderr : float
        Root-mean-square misfit of `spectrum`, and an upper bound of its standard error from
        simulation noise.
    wavelength_nm, measured, modelled, modelled_stderr : float, shape (wavelengths,)
    spectrum : xarray.Dataset
        Final simulation, see `splits.spectrophotometer`.
    names : tuple of str
        Names of the coordinates, see `DEFAULT_RANGES`.
    coordinates, coordinates_stderr : float, shape (coordinates,)
        Coordinates in the unit cube.  The error of an unconstrained one in the middle of its range
        is 1/√12.
    correlation : float, shape (coordinates, coordinates)
    alternatives : list of (float, dict)
        Misfit and parameters of the minima of the first stage, best first.  Different values at
        nearly the same misfit indicate several solutions.  These misfits, unlike `rmse`, are from
        few rays.
    evaluations : int
        Number of sands simulated.
    seconds : float
        Wall time.
    """

    parameters: dict[str, FittedParameter]
    settings: dict[str, Any]
    rmse: float
    rmse_stderr: float
    wavelength_nm: np.ndarray
    measured: np.ndarray
    modelled: np.ndarray
    modelled_stderr: np.ndarray
    spectrum: xr.Dataset
    names: tuple[str, ...]
    coordinates: np.ndarray
    coordinates_stderr: np.ndarray
    correlation: np.ndarray
    alternatives: list[tuple[float, dict[str, float]]]
    evaluations: int
    seconds: float

    def __repr__(self) -> str:
        """Return the misfit, and one line per parameter with its error."""
        lines = [f"misfit {self.rmse:.4f} ± {self.rmse_stderr:.4f}"]
        for name, parameter in self.parameters.items():
            note = "constrained" if parameter.constrained else "not constrained"
            lines.append(f"{name:16} {parameter.value:.4f} ± {parameter.stderr:.4f}  {note}")
        return "\n".join(lines)
