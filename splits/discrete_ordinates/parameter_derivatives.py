"""Derivatives of the spectra of snowpacks with respect to the parameters of the medium.

A parameter changes the properties of layers (depth, collisions, absorption), of the ground, or the
direction of the beam.  These changes are differences of properties, which are simple functions of
the parameters.  The derivatives of the optics then follow from the table of the grains by complex
steps, without cancellation (Squire & Trapp 1998, SIAM Review 40, 110), and those of the solution
from `splits.discrete_ordinates.derivatives`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import InvalidValue, invalid
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.derivatives import compute_gradient
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    SpectrumSolution,
    add_neighbours,
    choose_trial_wavelengths,
    load_natural_grains,
    spread_truncation,
)
from splits.discrete_ordinates.homogeneous_layer import TINY, LayerOptics, Streams
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, get_parameter, replace_parameter
from splits.simulation.derivatives import compute_difference_weights

PROPERTY_STENCILS = ((-1.0, 1.0), (0.0, 1.0, 2.0), (0.0, -1.0, -2.0))
"""Points of differences in steps: around the value, or on one side where a range ends."""
COMPLEX_STEP = 1e-30
_VARYING_FIELDS = ("collisions_per_m", "contrast", "grain_absorption", "pore_absorption")


class StepSizes(NamedTuple):
    """Steps of parameters for differences.

    Attributes
    ----------
    relative, smallest : float
        Step relative to the parameter, and the smallest step.
    relative_amount : float
        Step of impurities and algae, relative to the amount.
    smallest_amounts : dict of str to float
        Smallest steps of these, by keyword.
    """

    relative: float
    smallest: float
    relative_amount: float
    smallest_amounts: Mapping[str, float]

    def choose(self, name: str, value: float) -> float:
        """Return the step of a parameter."""
        for key, smallest in self.smallest_amounts.items():
            if key in name.split("."):
                return max(self.relative_amount * abs(value), smallest)
        return max(self.relative * abs(value), self.smallest)


PROPERTY_STEPS = StepSizes(1e-5, 1e-7, 0.1, {"impurities_ng_g": 1.0, "algae_cells_ml": 1e3})
"""Steps for differences of properties; absorption is linear in amounts."""


class OpticsScale(NamedTuple):
    """Factors of the optics of grains, to see how their errors change derivatives.

    Attributes
    ----------
    collisions, absorption : float
        Of the collisions per length, and of the absorption by a grain.
    """

    collisions: float = 1.0
    absorption: float = 1.0

    def apply(self, layer: GranularLayer) -> GranularLayer:
        """Return a layer, or derivatives of its properties, with other optics."""
        return layer._replace(
            collisions_per_m=self.collisions * layer.collisions_per_m,
            grain_absorption=self.absorption * layer.grain_absorption,
        )

    def apply_to_stack(self, snowpack: GranularStack, wavelengths: Any) -> GranularStack:
        """Return a snowpack at some of its wavelengths with other optics of all grains."""
        selected = snowpack.select(wavelengths)
        return selected._replace(layers=[self.apply(layer) for layer in selected.layers])


ALL, UNCHANGED = slice(None), OpticsScale()
"""All wavelengths, and the optics as they are."""


class Tangent(NamedTuple):
    """Derivatives of the properties of a dry snowpack with respect to a parameter.

    Attributes
    ----------
    layers : dict of int to GranularLayer
        Derivatives of the properties of the layers that depend on it, by number.
    ground : float
        Derivative of the albedo of the ground.
    incidence : float
        Derivative of the angle of incidence (degrees).
    """

    layers: dict[int, GranularLayer]
    ground: float = 0.0
    incidence: float = 0.0

    @classmethod
    def from_parameter(cls, medium: Medium, name: str, wavelength_nm: np.ndarray) -> Tangent:
        """Return the derivatives with respect to a parameter of a medium."""
        if name == INCIDENCE_KEY:
            return cls({}, incidence=1.0)
        if name == "ground":
            return cls({}, ground=1.0)
        step = PROPERTY_STEPS.choose(name, get_parameter(medium, name))
        offsets, media = sample_media(medium, name, step, PROPERTY_STENCILS)
        weights = compute_difference_weights(np.array(offsets)) / step
        layers = {}
        for number, same in enumerate(medium.scene_layers):
            versions: list[Any] = [one.scene_layers[number] for one in media]
            if all(version is same for version in versions):
                continue
            grains = load_natural_grains(wet=False)
            properties = [
                GranularLayer.from_medium(version, wavelength_nm, grains) for version in versions
            ]
            changes: dict[str, Any] = {
                name: combine_differences(
                    weights, np.array([getattr(one, name) for one in properties])
                )
                for name in GranularLayer._fields[:7]
            }
            layers[number] = properties[0]._replace(**changes)
        return cls(layers)


class DryDerivatives(NamedTuple):
    """Derivatives of a dry snowpack with respect to parameters.

    Attributes
    ----------
    snowpack : GranularStack
    tangents : sequence of Tangent
        With respect to each of the parameters.
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    """

    snowpack: GranularStack
    tangents: Sequence[Tangent]
    incidence: float | str

    @classmethod
    def from_medium(
        cls, medium: Medium, names: Sequence[str], wavelength_nm: np.ndarray, incidence: float | str
    ) -> DryDerivatives:
        """Return the derivatives of a medium with respect to parameters."""
        tangents = [Tangent.from_parameter(medium, name, wavelength_nm) for name in names]
        return cls(make_granular_stack(medium, wavelength_nm), tangents, incidence)

    def solve(
        self, n_streams: int, wavelengths: Any = ALL, scale: OpticsScale = UNCHANGED,
        incidence: float | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Return derivatives and their errors due to steps, which are 0.

        Parameters
        ----------
        n_streams : int
            Number of streams in both hemispheres.
        wavelengths : int, shape (wavelengths,), or slice
            Positions of the wavelengths.
        scale : OpticsScale
            For other optics of the grains.
        incidence : float, optional
            For another angle of incidence (degrees).

        Returns
        -------
        two arrays, shape (2, parameters, wavelengths)
            Of reflectance and transmittance.
        """
        beam = self.incidence if incidence is None else incidence
        snowpack = scale.apply_to_stack(self.snowpack, wavelengths)
        layers = [layer.compute_optics(n_streams + 1) for layer in snowpack.layers]
        optics = LayerOptics(*(np.stack(field) for field in zip(*layers, strict=True)))
        angle = 0.0 if isinstance(beam, str) else np.radians(beam)
        cosine = None if isinstance(beam, str) else float(np.cos(angle))
        streams, ground = Streams.from_number(n_streams), snowpack.ground
        _, gradient = compute_gradient(optics.truncate(n_streams), streams, ground, cosine)
        by_degree = -np.sin(angle) * np.pi / 180.0
        derivatives = []
        for tangent in self.tangents:
            derivative = tangent.ground * gradient.ground
            derivative = derivative + tangent.incidence * by_degree * gradient.cosine
            for number, change in tangent.layers.items():
                selected = scale.apply(change.select(..., wavelengths))
                by_optics = differentiate_optics(snowpack.layers[number], selected, n_streams)
                derivative = derivative + gradient.differentiate(number, by_optics)
            derivatives.append(derivative)
        values = np.stack(derivatives, axis=1)
        return values, np.zeros_like(values)


def differentiate_optics(
    layer: GranularLayer, tangent: GranularLayer, n_streams: int
) -> LayerOptics:
    """Return the derivatives of the optics of a dry layer, after truncation.

    The derivative of a real analytic function is Im f(x + iε)/ε, with an error of the order of ε².

    Parameters
    ----------
    layer : GranularLayer
    tangent : GranularLayer
        Derivatives of its properties.
    n_streams : int
    """
    shifted = {
        name: getattr(layer, name) + 1j * COMPLEX_STEP * getattr(tangent, name)
        for name in _VARYING_FIELDS
    }
    optics = layer._replace(**shifted).compute_optics(n_streams + 1).truncate(n_streams)
    return LayerOptics(
        np.asarray(tangent.depth_m),
        optics.extinction.imag / COMPLEX_STEP,
        optics.scattering.imag / COMPLEX_STEP,
        np.zeros_like(layer.grain_absorption),
    )


def sample_media(
    medium: Medium, name: str, step: float, stencils: Sequence[tuple[float, ...]]
) -> tuple[tuple[float, ...], list[Medium]]:
    """Return the first points, in steps, for which the medium exists, and the media there.

    Dry and wet snow have different tables, and a difference must not mix them.
    """
    value, wet = get_parameter(medium, name), _find_wet_layers(medium)
    error = invalid(name, value, "inside its range")
    for offsets in stencils:
        try:
            media = [replace_parameter(medium, name, value + step * x) for x in offsets]
        except InvalidValue as one:
            error = one
            continue
        if all(_find_wet_layers(one) == wet for one in media):
            return offsets, media
    raise error


def _find_wet_layers(medium: Medium) -> list[bool]:
    layers: Any = medium.scene_layers
    return [layer.wet_fraction > 0.0 for layer in layers]


def combine_differences(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return a difference of values along the first dimension; constant ones may be infinite."""
    change = np.subtract(values, values[:1], out=np.zeros(values.shape), where=values != values[:1])
    combined: np.ndarray = np.tensordot(weights, change, 1)
    return combined


# --------------------------------------------------------------------------------------------------
# Derivatives of spectra with respect to parameters, with errors; differences for wet snow.

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

    def solve(
        self, n_streams: int, wavelengths: Any, scale: OpticsScale, shift: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative and its error, each of shape (2, wavelengths).

        The rule of five points has the fourth order; its error is the change from the rule of three
        points, and rounding.  `shift` is added to the angles of incidence (degrees).
        """
        solutions = []
        for number, snowpack in enumerate(self.snowpacks):
            cosines = np.cos(np.radians(np.array(self.angles[number : number + 1]) + shift))
            budget = scale.apply_to_stack(snowpack, wavelengths).solve(cosines, n_streams)
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

    def solve(
        self, n_streams: int, wavelengths: Any = ALL, scale: OpticsScale = UNCHANGED,
        incidence: float | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Return derivatives and their errors due to steps, see `DryDerivatives.solve`."""
        shift = 0.0 if incidence is None else incidence - float(self.incidence)
        parts = [one.solve(n_streams, wavelengths, scale, shift) for one in self.differences]
        values, errors = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
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
    coarse, n_streams = values[..., trial], solution.n_streams
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
    few = derivatives.snowpack.select(trial)
    change = _compute_optics_change(few, solution.optics_error[trial])
    for scale in SCALES:
        scaled, _ = derivatives.solve(n_streams, trial, scale)
        errors.append((scaled - coarse) * change / SCALE_STEP)
    # Squares of small errors would be 0.
    combined = np.hypot.reduce(errors)
    error = spread_truncation(combined, trial, solution.optics_error.size)
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
