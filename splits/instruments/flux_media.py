"""Media in the form in which fluxes are traced: of finite depth, and with absorption along paths.

A semi-infinite medium is traced to a truncation depth, below which diffusion theory replaces the
rest (`splits.simulation.deep_medium`).  Each wavelength is then estimated twice: with the
absorptance of the rest from theory, and with a larger one by the uncertainty of the theory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.core.validation import format_limit, invalid
from splits.discrete_ordinates.applicability import (
    find_obstacle,
    find_profile_obstacle,
    find_table_obstacle,
    make_granular_stack,
)
from splits.discrete_ordinates.grains import GrainTable
from splits.discrete_ordinates.granular_layers import GranularLayer, compute_replicate_error
from splits.discrete_ordinates.granular_stack import find_similarity_error
from splits.kernels.scene import DRY_PORE, MATRIX
from splits.media.ground import BLACK_OPTICAL_DEPTH, Ground
from splits.media.medium import Layer, Medium
from splits.media.particle_layer import CLEARANCE_SIGMA
from splits.media.stack import absorb_along_path
from splits.simulation.deep_medium import THEORY_UNCERTAINTY, truncate_deep_medium
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import (
    OpticalConstants,
    compute_material_constants,
    compute_optical_constants,
    compute_path_fractions,
    make_height_fields,
)
from splits.simulation.shared_paths import PathSharingMedia

# --------------------------------------------------------------------------------------------------
# Path lengths of light inside a medium for the light absorbed there, and their errors.
#
# In a layer all of whose light loses the same part per metre of path, the path length follows from
# the absorbed light, which is known from the irradiances around it.  Elsewhere rays give the path
# per absorbed light, on the assumption that their weights decrease evenly between two planes.

MAX_PATH_EXCESS = 0.25
"""Largest relative error of the path per absorbed light of rays, above which mean chords have
`CHORD_ERROR`."""
CHORD_ERROR = 0.15
"""Relative error of the path per absorbed light by mean chords, compared with that of the single
scattering of natural snow, where steps are large."""


def compute_absorption_steps(
    medium: Medium, absorption: np.ndarray, planes_m: np.ndarray
) -> list[np.ndarray]:
    """Return the steps in which weights decrease inside a medium.

    Parameters
    ----------
    medium : Medium
    absorption : float, shape (wavelengths, columns)
        1/m; see `splits.simulation.scene.OpticalConstants`.
    planes_m : float, shape (intervals + 1,)
        Depths between which intervals lie (m).

    Returns
    -------
    optical_depth : float, shape (intervals, wavelengths)
        Largest optical depth of a mean step: through a grain, or through a pore from one grain to
        the next.
    absorption_rate : float, shape (intervals, wavelengths)
        Smallest fraction of the light absorbed in steps, per metre of path in grains and pores, in
        the layers of an interval.
    """
    layers = medium.scene_layers
    columns = np.cumsum([len(layer.list_materials()) for layer in layers])
    by_layer = zip(layers, np.split(absorption, columns, axis=1), strict=False)
    steps = np.stack([compute_layer_steps(*one) for one in by_layer], axis=1)
    in_interval = find_layers_between(layers, planes_m)
    return [
        np.array([reduce(table[inside], axis=0) for inside in in_interval])
        for table, reduce in zip(steps, (np.max, np.min), strict=True)
    ]


def find_layers_between(layers: Sequence[Layer], planes_m: np.ndarray) -> np.ndarray:
    """Return whether each layer is in each interval between planes, shape (intervals, layers)."""
    bottoms = np.cumsum([float(layer.depth_m) for layer in layers])
    begin, end = planes_m[:-1, np.newaxis], planes_m[1:, np.newaxis]
    return (begin < bottoms) & (end > np.append(0.0, bottoms[:-1]))


def compute_layer_steps(medium: Layer, absorption: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps in a layer by wavelength; 0 where particles absorb along paths.

    They are the optical depth and the absorption rate of `compute_absorption_steps`.
    The mean segment between two grains is that of a ray in the pore space.  A ray crosses some
    three thicknesses of a coating on its way in and out; the chord of a sphere is two thirds of the
    diameter.
    """
    if not medium.has_grains:
        return np.zeros(len(absorption)), absorption[:, MATRIX]
    grains = medium.make_grain_population()
    segment, types = 1.0 / grains.collision_coefficient, grains.types
    type_fractions = np.diff(grains.type_cdf, prepend=0.0)
    grain_depths, pore_depths = [], []
    for grain_type in np.flatnonzero(type_fractions > 0.0):
        n_coatings = types.n_shells[grain_type] - 1
        materials, thicknesses = types.material[grain_type], types.coating_thickness[grain_type]
        coating = absorption[:, materials[:n_coatings]] @ thicknesses[:n_coatings]
        core = absorption[:, materials[n_coatings]]
        depth = medium.mean_chord_m * (core + 4.5 * coating)
        grain_depths.append((type_fractions[grain_type], depth))
    dry_fraction = 1.0 - medium.wet_fraction - sum(medium.pores.values())
    for pore, fraction in enumerate([dry_fraction, medium.wet_fraction, *medium.pores.values()]):
        if fraction > 0.0:
            pore_depths.append((fraction, segment * absorption[:, pore]))
    in_pore, pore_part = _average_losses(pore_depths)
    in_grain, grain_part = _average_losses(grain_depths)
    # Of the light in a pore, that which is not absorbed reaches a grain.
    absorbed = in_pore + (1.0 - in_pore) * in_grain
    path = segment * medium.pore_fraction * pore_part
    path += (1.0 - in_pore) * medium.mean_chord_m * grain_part
    largest = np.max([depth for _, depth in pore_depths + grain_depths], axis=0)
    return largest, absorbed / path


def _average_losses(depths: Sequence[tuple[float, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean absorbed light, and the mean path by weight over the length of a step.

    Light that decreases by exp(−d) along a length has the path (1 − exp(−d))/d of this length.

    Parameters
    ----------
    depths : sequence of (fraction, float (wavelengths,))
        Fractions of the steps, and their optical depths.
    """
    fractions, depth = (np.array(values) for values in zip(*depths, strict=True))
    absorbed = -np.expm1(-depth)
    part = np.divide(absorbed, depth, out=np.ones_like(depth), where=depth > 0.0)
    return fractions @ absorbed, fractions @ part


class PathRatio(NamedTuple):
    """Path length of light over its absorptance in each layer, of shape (layers, wavelengths).

    Attributes
    ----------
    value : float
        Metres; infinite where nothing absorbs.
    relative_error : float
    by_rays : bool
        Whether the ratio of the rays of a run is more accurate than the value, which is that of
        mean chords; the error is that of rays.
    """

    value: np.ndarray
    relative_error: np.ndarray
    by_rays: np.ndarray

    @classmethod
    def from_medium(
        cls, medium: Medium, wavelength_nm: np.ndarray, max_stderr: float, threads: int
    ) -> PathRatio:
        """Return the ratio for a medium whose particles absorb along paths.

        Parameters
        ----------
        medium : Medium
        wavelength_nm : float, shape (wavelengths,)
        max_stderr : float
            For paths through single grains, see `make_granular_stack`.
        threads : int
            For these paths.
        """
        ratios = [
            _compute_layer_ratio(layer, wavelength_nm, max_stderr, threads)
            for layer in medium.scene_layers
        ]
        return cls(*map(np.stack, zip(*ratios, strict=True)))

    def find_largest_error(self, medium: Medium, planes_m: np.ndarray) -> np.ndarray:
        """Return the largest relative error of the layers in intervals between planes.

        The shape is (intervals, wavelengths).
        """
        inside = find_layers_between(medium.scene_layers, planes_m)
        return np.array([self.relative_error[one].max(axis=0) for one in inside])


def _compute_layer_ratio(
    layer: Layer, wavelength_nm: np.ndarray, max_stderr: float, threads: int
) -> PathRatio:
    """Return the ratio of a layer by wavelength.

    In dry point grains of one material, a metre of recorded path has κ (1 − ω) losses in grains,
    where 1/α metres of path in them are one loss (`splits.discrete_ordinates.profiles`).  Rays
    assume that weights decrease evenly.  They decrease in steps of optical depth d, so that a path
    by weight may be d/(1 − exp(−d)) times as long; above a limit, mean chords are closer.
    """
    absorption = compute_material_constants(layer, wavelength_nm).absorption
    optical_depth, absorption_rate = compute_layer_steps(layer, absorption)
    with np.errstate(divide="ignore"):
        value = 1.0 / absorption_rate
    if not layer.has_grains:
        return PathRatio(value, np.zeros_like(value), np.isinf(value))
    excess = _compute_path_excess(optical_depth)
    by_rays = excess <= MAX_PATH_EXCESS
    error = np.where(by_rays, excess, CHORD_ERROR)
    absorbs = absorption[:, -1] > 0.0
    absorbing = wavelength_nm[absorbs]
    if (
        layer.wet_fraction > 0.0
        or not absorbs.any()
        or find_obstacle(layer)
        or find_profile_obstacle(layer, absorbing)
    ):
        return PathRatio(value, error, by_rays)
    stack = make_granular_stack(layer, absorbing, max_stderr, threads)
    if find_table_obstacle(layer, stack, absorbing):
        return PathRatio(value, error, by_rays)
    (optics,) = stack.layers

    def compute(layers: Sequence[GranularLayer]) -> np.ndarray:
        (one,) = layers
        extinction, scattering = (values[..., 0] for values in one.compute_optics(1)[1:3])
        loss = extinction - scattering[..., 0, 0]
        in_grains = loss - one.pore_absorption[..., DRY_PORE]
        return (layer.pore_fraction + in_grains / absorption[absorbs, -1]) / loss

    value[absorbs] = compute([optics])
    if isinstance(optics.grains, GrainTable):
        in_pores = 1.0 - 1.0 / (absorption[absorbs, -1] * value[absorbs])
        error[absorbs] = in_pores * find_similarity_error(optics.contrast, is_wet=False)
    else:
        error[absorbs] = compute_replicate_error([optics], compute) / value[absorbs]
    return PathRatio(value, error, by_rays & ~absorbs)


def _compute_path_excess(optical_depth: np.ndarray) -> np.ndarray:
    """Return the relative excess of a path over one along which weights decrease evenly."""
    d = np.maximum(optical_depth, 1e-9)
    return d / -np.expm1(-d) - 1.0


def bound_material_absorptance_error(
    optical_depth: np.ndarray,
    absorptance: np.ndarray,
    total_absorptance: np.ndarray,
    unscored_absorptance: np.ndarray,
) -> np.ndarray:
    """Return a bound on the error of the absorptances of materials.

    It follows from the effect of steps on paths (see `PathRatio`), and is at most
    the total absorptance; an excess of one material is a deficit of the others.

    Parameters
    ----------
    optical_depth : float, shape (intervals, wavelengths)
        Of steps, see `compute_absorption_steps`.
    absorptance : float, shape (intervals, materials, wavelengths)
        Absorptance of each material.
    total_absorptance, unscored_absorptance : float, shape (intervals, wavelengths)
        Absorptance of all materials, and its part that no path scores.
    """
    total = np.maximum(total_absorptance, 0.0)[:, np.newaxis]
    exchangeable = np.minimum(
        absorptance, np.maximum(total_absorptance[:, np.newaxis] - absorptance, 0.0)
    )
    excess = _compute_path_excess(optical_depth)[:, np.newaxis] * exchangeable
    return np.minimum(excess + unscored_absorptance[:, np.newaxis], total)


# --------------------------------------------------------------------------------------------------
# Media in the form in which fluxes are traced: of finite depth, and with absorption along paths.


class TracedMedium(NamedTuple):
    """A medium in the form in which it is traced.

    Attributes
    ----------
    medium : Medium
    constants : OpticalConstants
        For each wavelength; with truncation, then for each with a more absorbing substrate.
    n_wavelengths : int
    planes_m : float, shape (planes,)
        Top, requested depths, and bottom or the end of tracing.
    semi_infinite : bool
        Whether the medium continues below that.
    truncated : bool
        Whether diffusion theory replaces the part below.
    material_columns : dict of str to int
        Columns of the materials, by name.
    path_ratio : PathRatio
        Of its layers, at each wavelength.
    """

    medium: Medium
    constants: OpticalConstants
    n_wavelengths: int
    planes_m: np.ndarray
    semi_infinite: bool
    truncated: bool
    material_columns: dict[str, int]
    path_ratio: PathRatio

    @property
    def edges_m(self) -> np.ndarray:
        """Edges of the intervals (m)."""
        return np.append(self.planes_m[:-1], np.inf) if self.semi_infinite else self.planes_m

    @property
    def path_fractions(self) -> np.ndarray:
        """Path over recorded length, see `splits.simulation.scene.compute_path_fractions`."""
        fractions = compute_path_fractions(self.medium)
        n_grounds = self.constants.absorption.shape[1] - fractions.size
        return np.pad(fractions, (0, n_grounds), constant_values=1.0)

    def is_absorbing(self) -> np.ndarray:
        """Return at which wavelengths the lowest layer absorbs, shape (wavelengths,)."""
        return np.isfinite(self.path_ratio.value[-1])


def prepare_medium(
    medium: Medium,
    wavelengths: np.ndarray,
    depths_m: Sequence[float] | np.ndarray,
    max_stderr: float,
    run: RunOptions,
) -> TracedMedium:
    """Return a medium in the form in which it is traced for fluxes at depths.

    Parameters
    ----------
    medium : Medium
    wavelengths : float, shape (wavelengths,)
        nm.
    depths_m : sequence of float
        In the medium (m).
    max_stderr : float
        As for the spectrophotometer.
    run : RunOptions
    """
    height_fields = make_height_fields(medium)
    if height_fields is not None:
        min_depth = CLEARANCE_SIGMA * float(np.linalg.norm(height_fields.rms_height))
        if depths_m[0] < min_depth:
            hint = f"{CLEARANCE_SIGMA:g} standard deviations of the surface's height"
            limit = format_limit(min_depth, depths_m[0])
            raise invalid("depth_m", float(depths_m[0]), f"at least {limit} m", hint)
    if medium.opaque:
        raise invalid("opaque", True, "false", "all light is absorbed at the surface")
    finite, truncation = medium, None
    if medium.is_semi_infinite:
        lowest = medium.lowest_layer
        depth_above = float(sum(layer.depth_m for layer in medium.scene_layers[:-1]))
        undisturbed_depth = max(0.0, depths_m[-1] - depth_above)
        truncation = truncate_deep_medium(
            PathSharingMedia.from_media([medium]), wavelengths, max_stderr, run, undisturbed_depth
        )
        if truncation is not None:
            finite = truncation.path_sharing.media[0]
        elif not lowest.has_grains:
            depth = lowest.compute_truncation_depth(undisturbed_depth)
            finite = medium.truncate(depth, Ground.from_input(1.0))
    end_m, traced = float(finite.depth_m), absorb_along_path(finite)
    constants = compute_optical_constants(traced, wavelengths)
    # A ground of a semi-infinite medium is the one that replaces the rest.
    truncated = truncation is not None and traced.reflecting_ground is not None
    if truncated:
        # Those with a substrate more absorbing by `THEORY_UNCERTAINTY` follow.
        indices, absorption = (np.concatenate([table, table]) for table in constants)
        absorbed = -(1.0 + THEORY_UNCERTAINTY) * np.expm1(-constants.absorption[:, -1])
        depth = -np.log(np.maximum(1.0 - absorbed, math.exp(-700.0)))
        absorption[wavelengths.size :, -1] = np.where(absorbed < 1.0, depth, BLACK_OPTICAL_DEPTH)
        constants = OpticalConstants(indices, absorption)
    planes = np.array([0.0, *depths_m, end_m])
    return TracedMedium(
        traced, constants, wavelengths.size, planes, medium.is_semi_infinite, truncated,
        medium.material_columns,
        PathRatio.from_medium(traced, wavelengths, max_stderr, run.threads),
    )  # fmt: skip
