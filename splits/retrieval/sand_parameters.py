"""The parameters of a sand that a fit varies and reports: unit cube, keywords.

Every point of the cube is a sand that SPLITS Table 2 allows.  The simplex of partitions and the
triangle of textures each take two coordinates; where light responds to the logarithm of a
parameter rather than to the parameter, so does the coordinate.
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
``coated_fraction`` the coated part of the others, ``fines`` silt + 1.5 clay, and ``clay`` the mass
fraction of clay, which besides cannot exceed fines/1.5.  Clay of less than Sand's ``size_tail``
is as good as none."""

RANGE_LIMITS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(DEFAULT_RANGES, (0.0, 1.0)),
    "fines": (0.0, 0.15),
    "clay": (0.0, 0.1),
}
"""What ranges must stay within."""

LOGARITHMIC_PARAMETERS = ("iron_oxide", "magnetite", "clay")
"""Parameters whose coordinate is logarithmic: a little of them does much."""
_ZERO_START_SLOPE_RATIO = 100.0
"""Ratio of the slopes at both ends of a geometric coordinate that begins at 0."""

FITTED_KEYWORDS = ("iron_oxide", "hematite_ratio", "magnetite", "partition", "texture")
"""Keywords of `splits.Sand` that a fit decides."""


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
        Of the coordinates.
    state_vector : StateVector
        The coordinates themselves.
    ranges : dict

    Raises
    ------
    ValueError
        For a range or keyword that cannot be taken.
    """

    def __init__(
        self, base: Mapping[str, Any], ranges: Mapping[str, tuple[float, float]] | None = None
    ) -> None:
        self.fixed_keywords = dict(base)
        for key in self.fixed_keywords:
            if key in FITTED_KEYWORDS:
                raise invalid(
                    key, self.fixed_keywords[key], "left out", "the fit decides it; see ranges"
                )
        self.ranges = resolve_ranges(ranges or {})
        self.names = tuple(self.ranges)
        unit = ParameterRange(0.0, 1.0, "itself")
        self.state_vector = StateVector.from_ranges(
            self.names, None, dict.fromkeys(self.names, unit)
        )
        for corner in itertools.product((0.0, 1.0), repeat=len(self.names)):
            try:
                self.to_sand(np.array(corner))
            except ValueError as error:
                raise ValueError(f"ranges: a sand within them cannot be: {error}") from None

    def to_keywords(self, coordinates: np.ndarray) -> dict[str, Any]:
        """Return the keywords of the sand at a point of the cube, those that are fixed included.

        Parameters
        ----------
        coordinates : float, shape (coordinates,)
            Each 0 to 1, in the order of `names`.
        """
        u = dict(zip(self.names, np.asarray(coordinates, dtype=float), strict=True))

        def at(name: str, most: float = np.inf) -> float:
            low, high = self.ranges[name]
            high = min(high, most)
            bend = (
                (high / low if low > 0.0 else _ZERO_START_SLOPE_RATIO)
                if name in LOGARITHMIC_PARAMETERS
                else 1.0
            )
            part = u[name] if bend == 1.0 else (bend ** u[name] - 1.0) / (bend - 1.0)
            return float(min(max(low + part * (high - low), low), high))

        pure = at("pure")
        coated = (1.0 - pure) * at("coated_fraction")
        mixed = max(1.0 - pure - coated, 0.0)
        fines = at("fines")
        clay = at("clay", fines / 1.5)
        silt = max(fines - 1.5 * clay, 0.0)
        return {
            **self.fixed_keywords,
            "iron_oxide": at("iron_oxide"),
            "hematite_ratio": at("hematite_ratio"),
            "magnetite": at("magnetite"),
            "partition": (pure, mixed, coated),
            "texture": (clay, silt, 1.0 - clay - silt),
        }

    def to_sand(self, coordinates: np.ndarray) -> Sand:
        """Return the sand at a point of the cube."""
        return Sand(**self.to_keywords(coordinates))

    def to_parameters(self, coordinates: np.ndarray) -> dict[str, float]:
        """Return the parameters at a point of the cube, one number under each name."""
        found = self.to_keywords(coordinates)
        parts = zip(("pure", "mixed", "coated"), found["partition"], strict=True)
        return {
            **{name: found[name] for name in ("iron_oxide", "hematite_ratio", "magnetite")},
            **{f"partition_{name}": value for name, value in parts},
            **dict(zip(("clay", "silt", "sand"), found["texture"], strict=True)),
        }


def resolve_ranges(given: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return `DEFAULT_RANGES` with those given instead, or refuse them."""
    ranges = dict(DEFAULT_RANGES)
    for name, values in given.items():
        if name not in DEFAULT_RANGES:
            allowed = "one of " + ", ".join(DEFAULT_RANGES)
            raise invalid("ranges", name, allowed, suggest_name(name, DEFAULT_RANGES))
        low, high = check_named_numbers(
            f"ranges.{name}", values, ("low", "high"), RANGE_LIMITS[name]
        )
        for end, value in (("low", low), ("high", high)):
            check_range(f"ranges.{name} ({end})", value, *RANGE_LIMITS[name])
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
    """A parameter that was fitted.

    Attributes
    ----------
    value : float
        A mass fraction, or hematite's part of the iron oxide.
    stderr : float
        Its standard error, the root mean square of how far it may be off.
    constrained : bool
        Whether that, in ranks among all sands of the ranges, is below half of what not having
        measured at all would leave.
    """

    value: float
    stderr: float
    constrained: bool


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """The sand found.

    Attributes
    ----------
    parameters : dict of FittedParameter
        iron_oxide, hematite_ratio, magnetite, partition_pure, partition_mixed,
        partition_coated, clay, silt, sand.
    settings : dict
        Keywords of `splits.Sand` for that sand, the fixed ones included.
    rmse, rmse_stderr : float
        Root mean square misfit of `spectrum`, and what simulation noise adds to or takes from it
        at most (one standard error).
    wavelength_nm, measured, modelled, modelled_stderr : float, shape (wavelengths,)
    spectrum : xarray.Dataset
        The last simulation, as `splits.spectrophotometer` returns it.
    names : tuple of str
        Of the coordinates, see `DEFAULT_RANGES`.
    coordinates, coordinates_stderr : float, shape (coordinates,)
        Place in the unit cube; one in the middle of its range that light does not depend on has
        the error 1/√12.
    correlation : float, shape (coordinates, coordinates)
    alternatives : list of (float, dict)
        Misfit and parameters of the sands that each descent of the first stage ended at, best
        first: values far apart at nearly the same misfit mean that there are several answers.
        Their misfits are of few rays; `rmse` is not.
    evaluations : int
        Sands simulated.
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
        """Return the misfit, and every parameter with its error in a line of its own."""
        lines = [f"misfit {self.rmse:.4f} ± {self.rmse_stderr:.4f}"]
        for name, one in self.parameters.items():
            told = "told by the spectrum" if one.constrained else "not told"
            lines.append(f"{name:16} {one.value:.4f} ± {one.stderr:.4f}  {told}")
        return "\n".join(lines)
