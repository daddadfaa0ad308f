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
from splits.instruments.absorption_steps import PathRatio
from splits.media.absorbing_matrix_layer import absorb_along_path
from splits.media.ground import BLACK_OPTICAL_DEPTH, Ground
from splits.media.medium import Medium
from splits.media.particle_layer import CLEARANCE_SIGMA
from splits.simulation.deep_medium import THEORY_UNCERTAINTY, truncate_deep_medium
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import (
    OpticalConstants,
    compute_optical_constants,
    compute_path_fractions,
    make_height_fields,
)
from splits.simulation.shared_paths import PathSharingMedia


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
        constants = _append_darker_ground(constants)
    planes = np.array([0.0, *depths_m, end_m])
    return TracedMedium(
        traced, constants, wavelengths.size, planes, medium.is_semi_infinite, truncated,
        medium.material_columns,
        PathRatio.from_medium(traced, wavelengths, max_stderr, run.threads),
    )  # fmt: skip


def _append_darker_ground(constants: OpticalConstants) -> OpticalConstants:
    """Return the constants and those with a substrate more absorbing by `THEORY_UNCERTAINTY`."""
    indices, absorption = (np.concatenate([table, table]) for table in constants)
    absorbed = -(1.0 + THEORY_UNCERTAINTY) * np.expm1(-constants.absorption[:, -1])
    optical_depth = -np.log(np.maximum(1.0 - absorbed, math.exp(-700.0)))
    absorption[len(absorbed) :, -1] = np.where(absorbed < 1.0, optical_depth, BLACK_OPTICAL_DEPTH)
    return OpticalConstants(indices, absorption)
