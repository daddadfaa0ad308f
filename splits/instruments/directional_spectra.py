"""Simulation of reflectance factors and reflectances together, of media that share paths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.error_target import ErrorTarget
from splits.instruments.angular_estimate import AngularEstimate
from splits.instruments.angular_truncation import make_direction_grid
from splits.instruments.expansion_tally import MAX_DEGREE, ExpansionTally
from splits.instruments.goniophotometer import INTERPOLATION_FRACTION
from splits.instruments.spectral_run import MAX_ATTEMPTS, SpectralRequest
from splits.kernels.tallies.distributions import make_basis
from splits.simulation.deep_medium import ERROR_BUDGET_FRACTION, THEORY_UNCERTAINTY, TruncatedMedium
from splits.simulation.engine import simulate
from splits.simulation.scene import build_scene
from splits.simulation.shared_paths import PathSharingMedia, SpectralRows
from splits.simulation.spectral_nodes import choose_nodes
from splits.simulation.strata import StoppingRule

MAX_ESCAPE_FACTOR = 1.25
"""Radiance of light that escapes from a great depth, over that of isotropic light of equal flux:
(2 + 3 µ)/4 at the normal (diffusion theory)."""


class DirectionalSimulation(NamedTuple):
    """Result of a simulation.

    Attributes
    ----------
    estimate : AngularEstimate
        Rows are the wavelengths of one medium after the other.
    rays : int
    stop_reason : str
    """

    estimate: AngularEstimate
    rays: int
    stop_reason: str


def simulate_directions(
    path_sharing: PathSharingMedia,
    truncation: TruncatedMedium | None,
    request: SpectralRequest,
    polar_deg: np.ndarray,
    azimuth_deg: np.ndarray,
    target: ErrorTarget,
) -> DirectionalSimulation:
    """Return reflectance factors to an absolute error, with the reflectance of the same paths.

    Parameters
    ----------
    path_sharing : PathSharingMedia
    truncation : TruncatedMedium or None
        Their truncation.
    request : SpectralRequest
        `max_stderr` applies to the target.
    polar_deg, azimuth_deg : float, shape (angles,)
    target : ErrorTarget
        With absolute errors.
    """
    traced = path_sharing if truncation is None else truncation.path_sharing
    rows = SpectralRows.from_media(traced, request.wavelengths)
    above_truncation = (1.0 - (MAX_ESCAPE_FACTOR * ERROR_BUDGET_FRACTION) ** 2) ** 0.5
    max_error = request.max_stderr * (1.0 if truncation is None else above_truncation)
    directions = make_direction_grid(polar_deg, azimuth_deg, make_basis(MAX_DEGREE))
    scene = build_scene(traced.media[0], request.incidence, False)
    for _ in range(MAX_ATTEMPTS):
        nodes = choose_nodes(rows.index, rows.interfaces, INTERPOLATION_FRACTION * max_error)
        tally = ExpansionTally(nodes, rows.absorption, directions, request.incidence, target)
        evaluation = simulate(scene, tally, StoppingRule(max_error, request.max_rays), request.run)
        estimate: AngularEstimate = evaluation.estimate
        if truncation is None:
            break
        estimate = _add_truncation_error(estimate, truncation)
        reached = estimate.compute_max_error(target) <= request.max_stderr
        if reached or evaluation.stop_reason != "converged":
            break
        max_error *= 0.5
    return DirectionalSimulation(estimate, tally.n_rays, evaluation.stop_reason)


def _add_truncation_error(
    estimate: AngularEstimate, truncation: TruncatedMedium
) -> AngularEstimate:
    """Return an estimate with the error of the light from below the truncation depth."""
    n_media = truncation.path_sharing.n_reported
    entering = estimate.hemispherical[0, 1]
    error = THEORY_UNCERTAINTY * entering * truncation.escape_probability[:n_media].ravel()
    hemispherical = estimate.hemispherical.copy()
    hemispherical[1, 0] = np.hypot(hemispherical[1, 0], error)
    by_direction = MAX_ESCAPE_FACTOR / np.pi * error[:, np.newaxis]
    stderr = estimate.stderr.copy()
    stderr[0] = np.hypot(stderr[0], by_direction)
    # Missing light changes the reflectance of the anisotropy factor, too.
    relative = (error / np.maximum(hemispherical[0, 0], np.finfo(float).tiny))[:, np.newaxis]
    change = np.maximum(MAX_ESCAPE_FACTOR, estimate.anisotropy) * np.minimum(relative, 1.0)
    return estimate._replace(
        stderr=stderr,
        hemispherical=hemispherical,
        anisotropy_stderr=np.hypot(estimate.anisotropy_stderr, change),
    )
