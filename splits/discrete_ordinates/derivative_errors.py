"""Derivatives of spectra with respect to parameters, with errors; differences for wet snow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    SpectrumSolution,
    add_neighbours,
    choose_trial_wavelengths,
    spread_truncation,
)
from splits.discrete_ordinates.integrals import TINY
from splits.discrete_ordinates.parameter_derivatives import (
    DryDerivatives,
    OpticsScale,
    StepSizes,
    combine_differences,
    sample_media,
)
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, get_parameter
from splits.simulation.finite_differences import compute_difference_weights

STEPS = StepSizes(1e-3, 1e-5, 3e-3, {"impurities_ng_g": 0.01, "algae_cells_ml": 10.0})
"""Steps for differences of solutions."""
INCIDENCE_STEP = 0.02
"""Step of the angle of incidence (degrees)."""
STENCILS = tuple(
    tuple(point + shift for point in (-2.0, -1.0, 0.0, 1.0, 2.0)) for shift in (0.0, 2.0, -2.0)
)
"""Points of differences in steps: around the value, or on one side where a range ends."""
SOLUTION_ROUNDING = 1e-12
"""Rounding error of a solution."""
SCALE_STEP = 1e-3
SCALES = (
    OpticsScale(1.0, 1.0 + SCALE_STEP),
    OpticsScale(1.0 + SCALE_STEP, 1.0 / (1.0 + SCALE_STEP)),
)
"""More absorption, and less forward scattering: both change the reflectance of a half-space."""
MAX_OPTICS_CHANGE = 1.0
"""Largest relative change of the optics due to their error."""


class SolutionDifference(NamedTuple):
    """Difference of solutions over a parameter.

    Attributes
    ----------
    offsets : tuple of float
        Points, in steps.
    step : float
    snowpacks : sequence of GranularStack
        At the points.
    angles : sequence of float
        Angles of incidence (degrees) at the points; empty for diffuse light.
    """

    offsets: tuple[float, ...]
    step: float
    snowpacks: Sequence[GranularStack]
    angles: Sequence[float]

    @classmethod
    def from_parameter(
        cls, medium: Medium, name: str, wavelength_nm: np.ndarray, incidence: float | str
    ) -> SolutionDifference:
        """Return the difference over a parameter of a medium."""
        if name == INCIDENCE_KEY:
            # The solution is an even function of the angle.
            offsets, value = STENCILS[0], float(incidence)
            step = min(INCIDENCE_STEP, 0.25 * (90.0 - value))
            snowpacks = [make_granular_stack(medium, wavelength_nm)] * len(offsets)
            return cls(offsets, step, snowpacks, [value + step * x for x in offsets])
        step = STEPS.choose(name, get_parameter(medium, name))
        offsets, media = sample_media(medium, name, step, STENCILS)
        angles = [] if isinstance(incidence, str) else [incidence] * len(offsets)
        return cls(
            offsets, step, [make_granular_stack(one, wavelength_nm) for one in media], angles
        )

    def solve(self, n_streams: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative and its error, each of shape (2, wavelengths).

        The rule of five points has the fourth order; its error is the change from the rule of three
        points, and rounding.
        """
        solutions = []
        for number, snowpack in enumerate(self.snowpacks):
            cosines = np.cos(np.radians(np.array(self.angles[number : number + 1])))
            budget = snowpack.solve(cosines, n_streams)
            solutions.append(np.stack([budget.reflectance[..., 0], budget.transmittance[..., 0]]))
        points, values = np.array(self.offsets), np.array(solutions)
        nearest = np.sort(np.argsort(np.abs(points), kind="stable")[:3])
        derivative, coarse = (
            combine_differences(compute_difference_weights(points[rows]) / self.step, values[rows])
            for rows in (slice(None), nearest)
        )
        return derivative, np.abs(derivative - coarse) + SOLUTION_ROUNDING / self.step


class WetDerivatives(NamedTuple):
    """Derivatives of a wet snowpack with respect to parameters, by differences of solutions.

    Where both sides of an interface have the same saturation, the derivative with respect to one of
    the two is the mean of both sides.

    Attributes
    ----------
    snowpack : GranularStack
    differences : sequence of SolutionDifference
        Over each of the parameters.
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    """

    snowpack: GranularStack
    differences: Sequence[SolutionDifference]
    incidence: float | str

    @classmethod
    def from_medium(
        cls, medium: Medium, names: Sequence[str], wavelength_nm: np.ndarray, incidence: float | str
    ) -> WetDerivatives:
        """Return the derivatives of a medium with respect to parameters."""
        differences = [
            SolutionDifference.from_parameter(medium, name, wavelength_nm, incidence)
            for name in names
        ]
        return cls(make_granular_stack(medium, wavelength_nm), differences, incidence)

    def select(self, wavelengths: np.ndarray) -> WetDerivatives:
        """Return the derivatives at some of the wavelengths."""
        differences = [
            one._replace(snowpacks=[version.select(wavelengths) for version in one.snowpacks])
            for one in self.differences
        ]
        return WetDerivatives(self.snowpack.select(wavelengths), differences, self.incidence)

    def move_beam(self, incidence: float) -> WetDerivatives:
        """Return the derivatives for another angle of incidence (degrees)."""
        shift = incidence - float(self.incidence)
        differences = [
            one._replace(angles=[angle + shift for angle in one.angles]) for one in self.differences
        ]
        return self._replace(differences=differences, incidence=incidence)

    def scale_optics(self, scale: OpticsScale) -> WetDerivatives:
        """Return the derivatives for other optics of the grains."""
        differences = [
            one._replace(snowpacks=[scale.apply_to_layers(version) for version in one.snowpacks])
            for one in self.differences
        ]
        return self._replace(snowpack=scale.apply_to_layers(self.snowpack), differences=differences)

    def solve(self, n_streams: int) -> tuple[np.ndarray, np.ndarray]:
        """Return derivatives and their errors due to steps, as those of dry snow."""
        parts = zip(*(one.solve(n_streams) for one in self.differences), strict=True)
        values, errors = (np.stack(part, axis=1) for part in parts)
        return values, errors


def solve_derivatives(
    derivatives: DryDerivatives | WetDerivatives, solution: SpectrumSolution
) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives and their errors, shape (2, parameters, wavelengths).

    The errors combine that of the number of streams, which is measured as that of the spectrum
    (`splits.discrete_ordinates.granular_stack.solve_spectrum`), those of differences, and those of
    the optics: the changes of the derivatives for changes of the absorption and of the scattering
    by the grains that change the reflectance of half-spaces by its error.

    Parameters
    ----------
    derivatives : DryDerivatives or WetDerivatives
    solution : SpectrumSolution
        Of the snowpack.
    """
    values, step_error = derivatives.solve(solution.n_streams)
    trial = choose_trial_wavelengths(solution.optics_error.size)
    few, coarse = derivatives.select(trial), values[..., trial]
    errors = [_measure_truncation(few, coarse, solution.n_streams)]
    change = _compute_optics_change(few.snowpack, solution.optics_error[trial])
    for scale in SCALES:
        scaled, _ = few.scale_optics(scale).solve(solution.n_streams)
        errors.append((scaled - coarse) * change / SCALE_STEP)
    # Squares of small errors would be 0.
    combined = np.hypot.reduce(errors)
    error = spread_truncation(combined, trial, solution.optics_error.size)
    # The derivative of a small transmittance has its relative error.
    totals = np.stack([solution.budget.reflectance[..., 0], solution.budget.transmittance[..., 0]])
    relative = solution.bound_errors(totals)[1] / np.maximum(totals[1], TINY)
    error[1] = np.hypot(error[1], values[1] * relative)
    return values, np.hypot(step_error, error)


def _measure_truncation(
    derivatives: DryDerivatives | WetDerivatives, coarse: np.ndarray, n_streams: int
) -> np.ndarray:
    """Return the change of derivatives by twice as many streams, or beside a grazing beam.

    Parameters
    ----------
    derivatives : DryDerivatives or WetDerivatives
    coarse : float, shape (2, parameters, wavelengths)
        With `n_streams`.
    n_streams : int
    """
    change = np.abs(coarse - derivatives.solve(2 * n_streams)[0])
    if isinstance(derivatives.incidence, str):
        return change
    cosine = np.cos(np.radians([derivatives.incidence]))
    for neighbour in add_neighbours(cosine)[1:]:
        beside = derivatives.move_beam(float(np.degrees(np.arccos(neighbour))))
        one, other = (beside.solve(number)[0] for number in (n_streams, 2 * n_streams))
        change = np.maximum(change, np.abs(one - other))
    return change


def _compute_optics_change(snowpack: GranularStack, error: np.ndarray) -> np.ndarray:
    """Return the relative change of the optics that changes reflectances by their error.

    Of the half-spaces of the layers, the one whose reflectance changes most counts: that of grains
    that absorb nearly all light hardly depends on them.

    Parameters
    ----------
    snowpack : GranularStack
    error : float, shape (wavelengths,)
    """
    slopes, diffuse = [], np.zeros(0)
    for layer in snowpack.layers:
        half_space = layer._replace(depth_m=np.asarray(np.inf))
        versions = (half_space, SCALES[0].apply(half_space))
        before, after = (
            GranularStack([one], 0.0 * error).solve(diffuse, 8).reflectance[..., 0]
            for one in versions
        )
        slopes.append(np.abs(after - before) / SCALE_STEP)
    change: np.ndarray = np.minimum(
        error / np.maximum(np.max(slopes, axis=0), TINY), MAX_OPTICS_CHANGE
    )
    return change
