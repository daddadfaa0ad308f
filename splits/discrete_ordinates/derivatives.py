"""Derivatives of the spectra of snowpacks with respect to the parameters of the medium.

They are differences of solutions, which have no noise.  All solutions of a difference have the same
streams, so that the error of their number is that of the derivative and not of the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import InvalidValue, invalid
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    SpectrumSolution,
    add_neighbours,
    choose_trial_wavelengths,
    solve_snowpacks,
    spread_truncation,
)
from splits.discrete_ordinates.homogeneous_layer import TINY
from splits.media.medium import Medium
from splits.media.parameters import (
    INCIDENCE_KEY,
    choose_step,
    get_parameter,
    get_parameter_quantity,
    replace_parameter,
)
from splits.simulation.derivatives import compute_difference_weights

STEP_FRACTION = 1e-3
"""Step relative to the parameter."""
END_FRACTION = 0.01
"""Largest step relative to the distance from an end where the derivative is singular: 90 degrees,
and the end of a range near which reflectance depends on the square root of the distance."""
STENCILS = (
    ((-1.0, 1.0), (-2.0, 2.0)), ((0.0, 1.0, 2.0), (3.0, 4.0)), ((0.0, -1.0, -2.0), (-3.0, -4.0)),
)  # fmt: skip
"""Points of differences in steps, around the value or on one side where a range ends: those of a
rule of the second order, and the further ones of that of the fourth order."""
SOLUTION_ROUNDING = 1e-12
"""Rounding error of a solution, relative to it."""
SCALE_STEP = 1e-3
UNCHANGED = (1.0, 1.0)
SCALES = ((1.0, 1.0 + SCALE_STEP), (1.0 + SCALE_STEP, 1.0 / (1.0 + SCALE_STEP)))
"""Factors of the collisions per length and of the absorption by a grain: more absorption, and less
forward scattering, which both change the reflectance of a half-space."""
MAX_OPTICS_CHANGE = 1.0
"""Largest relative change of the optics due to their error."""


class ParameterDifference(NamedTuple):
    """Snowpacks of a difference over a parameter.

    Attributes
    ----------
    step : float
    offsets : tuple of float
        Points, in steps.
    n_near : int
        Number of the first points, which are those of the rule of the second order.
    snowpacks : sequence of GranularStack
        At the points.
    angles : sequence of float
        Angles of incidence (degrees) at the points; empty for diffuse light.
    """

    step: float
    offsets: tuple[float, ...]
    n_near: int
    snowpacks: Sequence[GranularStack]
    angles: Sequence[float]

    @classmethod
    def from_parameter(
        cls, medium: Medium, name: str, wavelength_nm: np.ndarray, incidence: float | str
    ) -> ParameterDifference:
        """Return the difference over a parameter of a medium."""
        is_angle = name == INCIDENCE_KEY
        value = float(incidence) if is_angle else get_parameter(medium, name)
        step = choose_step(name, value, STEP_FRACTION)
        end = 90.0 if is_angle else get_parameter_quantity(name).root_at
        if end is not None:
            step = min(step, END_FRACTION * abs(end - value))
        wet, error = _find_wet_layers(medium), invalid(name, value, "inside its range")
        for near, far in STENCILS:
            offsets = near + far
            points = [value + step * offset for offset in offsets]
            if is_angle:
                # The solution is an even function of the angle.
                snowpacks = [make_granular_stack(medium, wavelength_nm)] * len(points)
                return cls(step, offsets, len(near), snowpacks, points)
            try:
                media = [replace_parameter(medium, name, point) for point in points]
            except InvalidValue as outside:
                error = outside
                continue
            # Dry and wet snow have different tables, which a difference must not mix.
            if all(_find_wet_layers(one) == wet for one in media):
                angles = [] if isinstance(incidence, str) else [incidence] * len(points)
                snowpacks = [make_granular_stack(one, wavelength_nm) for one in media]
                return cls(step, offsets, len(near), snowpacks, angles)
        raise error

    def differentiate(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative from values at the points, shape (points, ...), and its error.

        The error is the change from the rule of the second order, and rounding.
        """
        points, changes = np.array(self.offsets), values - values[0]
        derivative, coarse = (
            np.tensordot(
                compute_difference_weights(points[:number]) / self.step, changes[:number], 1
            )
            for number in (points.size, self.n_near)
        )
        return derivative, np.abs(derivative - coarse) + SOLUTION_ROUNDING * values[0] / self.step


def _find_wet_layers(medium: Medium) -> list[bool]:
    return [layer.wet_fraction > 0.0 for layer in medium.scene_layers]


class SpectrumDerivatives(NamedTuple):
    """Derivatives of the spectrum of a snowpack with respect to parameters.

    Where both sides of an interface have the same saturation, the derivative with respect to one of
    the two is the mean of both sides.

    Attributes
    ----------
    snowpack : GranularStack
    differences : sequence of ParameterDifference
        Over each of the parameters.
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    """

    snowpack: GranularStack
    differences: Sequence[ParameterDifference]
    incidence: float | str

    @classmethod
    def from_medium(
        cls, medium: Medium, names: Sequence[str], wavelength_nm: np.ndarray, incidence: float | str
    ) -> SpectrumDerivatives:
        """Return the derivatives of a medium with respect to parameters."""
        differences = [
            ParameterDifference.from_parameter(medium, name, wavelength_nm, incidence)
            for name in names
        ]
        return cls(make_granular_stack(medium, wavelength_nm), differences, incidence)

    def solve(
        self, n_streams: int, wavelengths: Any = slice(None),
        scale: tuple[float, float] = UNCHANGED, incidence: float | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Return derivatives and their errors due to steps and rounding.

        Parameters
        ----------
        n_streams : int
            Number of streams in both hemispheres.
        wavelengths : int, shape (wavelengths,), or slice
            Positions of the wavelengths.
        scale : (float, float)
            See `scale_optics`, for other optics of the grains.
        incidence : float, optional
            Another angle of incidence (degrees).

        Returns
        -------
        two arrays, shape (2, parameters, wavelengths)
            Of reflectance and transmittance.
        """
        shift = 0.0 if incidence is None else incidence - float(self.incidence)
        snowpacks = [
            scale_optics(snowpack.select(wavelengths), scale)
            for one in self.differences
            for snowpack in one.snowpacks
        ]
        angles = [angle + shift for one in self.differences for angle in one.angles]
        cosines = np.cos(np.radians(angles)).reshape(len(snowpacks), -1)
        ends = np.cumsum([len(one.snowpacks) for one in self.differences])
        solutions = np.split(solve_snowpacks(snowpacks, cosines, n_streams), ends[:-1])
        pairs = [
            one.differentiate(values)
            for one, values in zip(self.differences, solutions, strict=True)
        ]
        values, errors = (np.stack(part, axis=1) for part in zip(*pairs, strict=True))
        return values, errors


def scale_optics(snowpack: GranularStack, scale: tuple[float, float]) -> GranularStack:
    """Return a snowpack with factors of the collisions and of the absorption of all grains."""
    collisions, absorption = scale
    layers = [
        layer._replace(
            collisions_per_m=collisions * layer.collisions_per_m,
            grain_absorption=absorption * layer.grain_absorption,
        )
        for layer in snowpack.layers
    ]
    return snowpack._replace(layers=layers)


def solve_derivatives(
    derivatives: SpectrumDerivatives, solution: SpectrumSolution
) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives and their errors, shape (2, parameters, wavelengths).

    The errors combine that of the number of streams, which is measured as that of the spectrum
    (`splits.discrete_ordinates.granular_stack.solve_spectrum`), those of differences, and those of
    the optics: the changes of the derivatives for changes of the absorption and of the scattering
    by the grains that change the reflectance of half-spaces by its error.

    Parameters
    ----------
    derivatives : SpectrumDerivatives
    solution : SpectrumSolution
        Of the snowpack.
    """
    n_streams, n_wavelengths = solution.n_streams, solution.optics_error.size
    values, step_error = derivatives.solve(n_streams)
    trial = choose_trial_wavelengths(n_wavelengths)
    coarse = values[..., trial]
    errors = [np.abs(coarse - derivatives.solve(2 * n_streams, trial)[0])]
    if not isinstance(derivatives.incidence, str):
        # Beside a grazing beam, where the change by more streams is not small by chance.
        cosine = np.cos(np.radians([derivatives.incidence]))
        for neighbour in add_neighbours(cosine)[1:]:
            angle = float(np.degrees(np.arccos(neighbour)))
            one, other = (
                derivatives.solve(number, trial, incidence=angle)[0]
                for number in (n_streams, 2 * n_streams)
            )
            errors[0] = np.maximum(errors[0], np.abs(one - other))
    change = _compute_optics_change(
        derivatives.snowpack.select(trial), solution.optics_error[trial]
    )
    for scale in SCALES:
        scaled, _ = derivatives.solve(n_streams, trial, scale)
        errors.append((scaled - coarse) * change / SCALE_STEP)
    # Squares of small errors would be 0.
    error = spread_truncation(np.hypot.reduce(errors), trial, n_wavelengths)
    # The derivative of a small transmittance has its relative error.
    totals = np.stack([solution.budget.reflectance[..., 0], solution.budget.transmittance[..., 0]])
    relative = solution.bound_errors(totals)[1] / np.maximum(totals[1], TINY)
    error[1] = np.hypot(error[1], values[1] * relative)
    return values, np.hypot(step_error, error)


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
        half_space = GranularStack([layer._replace(depth_m=np.asarray(np.inf))], 0.0 * error)
        before, after = (
            scale_optics(half_space, scale).solve(diffuse, 8).reflectance[..., 0]
            for scale in (UNCHANGED, SCALES[0])
        )
        slopes.append(np.abs(after - before) / SCALE_STEP)
    return np.minimum(error / np.maximum(np.max(slopes, axis=0), TINY), MAX_OPTICS_CHANGE)
