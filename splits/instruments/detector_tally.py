"""Tally of next-event detectors: sums of batches, and the resulting BRDF and BTDF."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from splits.core.uncertainty import ErrorTarget
from splits.core.validation import invalid
from splits.instruments.angular_estimate import AngularEstimate, AngularTally, compute_anisotropy
from splits.instruments.angular_tallies import make_stokes_variables
from splits.kernels.interface import compute_fresnel_mueller
from splits.kernels.phase_function import separate_peak
from splits.kernels.scene import Scene
from splits.kernels.transport.history import trace_to_detectors
from splits.kernels.transport.next_event import ABOVE, BELOW, Detectors
from splits.media.medium import Medium, ParticleMedium
from splits.simulation.scene import get_ground_albedo
from splits.simulation.spectral_nodes import make_separate_nodes
from splits.simulation.strata import Evaluation, StoppingRule, Stratum
from splits.simulation.tally import LOST_MESSAGE, RAYS_PER_CHUNK, allow_for_unseen_rays

# --------------------------------------------------------------------------------------------------
# Next-event estimation: every scattering contributes to each view direction.
#
# Budak & Grimailo 2020, Eqs 4-5 (local estimation): the radiance on a circle above the layer,
# without collectors of finite size.  Errors come from the scatter of batches of rays.

NEGLIGIBLE_PROBABILITY = 1e-16
"""Probability of more successive scatterings into a peak than are stored."""
MAX_PEAK_FRACTION = 0.99
"""Largest probability of scattering into a peak: above it, light needs hundreds of scatterings to
change its direction."""


def get_detected_layers(medium: Medium) -> tuple[ParticleMedium, ...]:
    """Return the particle layers of a medium whose light reaches detectors along known paths.

    Raises
    ------
    ValueError
        For grains, for a rough surface, for the ground of a stack or one that depends on
        wavelength, for narrow phase functions in a stack, and for a phase function that is nearly
        all peak.
    """
    layers = tuple(layer for layer in medium.scene_layers if not layer.has_grains)
    if len(layers) < len(medium.scene_layers):
        raise _reject_estimator("for grains")
    if layers[0].make_height_fields() is not None:
        hint = "no single path leads through it to a given direction; bins have Stokes parameters"
        raise _reject_estimator("under a rough surface", hint)
    peaks = [separate_peak(layer.kernel_phase_function) for layer in layers]
    if any(peak is not None and peak.fraction > MAX_PEAK_FRACTION for peak in peaks):
        hint = f"more than {MAX_PEAK_FRACTION:.0%} of the scattered light goes into a narrow peak"
        raise _reject_estimator("for this phase_function", hint)
    if len(layers) > 1 and any(peak is not None for peak in peaks):
        raise _reject_estimator("for this phase_function", "narrow peaks require a single layer")
    if medium.reflecting_ground is not None and get_ground_albedo(medium) is None:
        is_stack = medium.lowest_layer is not medium
        kind = "the ground of a stack" if is_stack else "a ground that depends on wavelength"
        raise _reject_estimator(f"over {kind}")
    return layers


def _reject_estimator(circumstances: str, hint: str = "") -> Exception:
    """Return the error that this estimator is not possible in some circumstances."""
    return invalid("estimator", "next_event", f"expansion or bins {circumstances}", hint)


def make_detectors(
    layers: Sequence[ParticleMedium], scene: Scene, polar: np.ndarray, azimuth: np.ndarray
) -> Detectors:
    """Return detectors on a grid of directions, azimuth running fastest.

    Parameters
    ----------
    layers : sequence of ParticleMedium
        See `get_detected_layers`.
    scene : Scene
    polar, azimuth : float
        Degrees, of the directions outside.
    """
    index, lowest = np.array([layer.refractive_index for layer in layers]), layers[-1]
    outer_polar, azimuth_rad = np.radians(np.meshgrid(polar, azimuth, indexing="ij")).reshape(2, -1)
    plane = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1)
    sine = (np.sin(outer_polar) / index[:, np.newaxis])[..., np.newaxis]
    cosine = compute_refracted_cosines(index, outer_polar)[..., np.newaxis]
    thickness = -np.diff(scene.layers.boundaries) * scene.layers.collision_coefficient
    is_open = scene.ground_contact is None and scene.opaque is None
    has_lower_side = is_open and math.isfinite(thickness[-1])
    transmission = compute_transmission(
        index, thickness, outer_polar, has_lower_side, scene.stokes is not None
    )
    peak = separate_peak(lowest.kernel_phase_function)
    orders = 0 if peak is None else math.log(NEGLIGIBLE_PROBABILITY) / math.log(peak.fraction)
    return Detectors(
        np.concatenate([sine * plane, cosine], axis=2),
        plane,
        transmission,
        lowest.refractive_index,
        float(thickness[-1]),
        has_lower_side,
        np.zeros((2, len(plane), 4)),
        lowest.kernel_phase_function,
        peak,
        0.0 if peak is None else peak.fraction * lowest.single_scattering_albedo,
        np.zeros((1 + math.ceil(orders), 3)),
    )


def compute_refracted_cosines(index: np.ndarray, outer_polar: np.ndarray) -> np.ndarray:
    """Return the cosines in media of indices, at least 1, of directions outside (rad).

    The sum has no cancellation at grazing directions.

    Returns
    -------
    float, shape (media, detectors)
    """
    squared = (index[:, np.newaxis] ** 2 - 1.0) + np.cos(outer_polar) ** 2
    return np.sqrt(squared) / index[:, np.newaxis]


def compute_transmission(
    index: np.ndarray,
    thickness: np.ndarray,
    outer_polar: np.ndarray,
    has_lower_side: bool,
    polarized: bool,
) -> np.ndarray:
    """Return the transmission from the boundaries of layers to directions outside.

    At an interface, light that is parallel and perpendicular to the plane of incidence, and U and
    V, are reflected and refracted independently.  Light that arrives upwards at the upper boundary
    of layer l, or downwards at the lower one, is transmitted to the detectors as

        u_l = R_l t_l d_l + T_l t_(l−1) u_(l−1),    d_l = R_(l+1) t_l u_l + T_(l+1) t_(l+1) d_(l+1),

    with the direct transmittance t of a layer, and T_0 in place of the second term for detectors
    above (T of the lowest interface for those below).  The solution sums all reflections.

    Parameters
    ----------
    index, thickness : float, shape (layers,)
        Refractive indices, at least 1, and vertical optical thicknesses.
    outer_polar : float, shape (detectors,)
        Polar angles of the directions outside (rad).
    has_lower_side : bool
        Whether the lowest interface transmits and reflects; otherwise it does neither.
    polarized : bool
        Otherwise all light is reflected like unpolarized light.

    Returns
    -------
    float, shape (2, 2, layers, detectors, 3)
        See `splits.kernels.transport.next_event.Detectors`.
    """
    n_layers = len(index)
    # No light from a direction outside is totally reflected, as no index is less than 1.
    media = np.array([1.0, *index, 1.0])
    cosine = compute_refracted_cosines(media, outer_polar)
    reflectance, transmittance = np.zeros((2, n_layers + 1, len(outer_polar), 3))
    for j, k in np.ndindex(n_layers + has_lower_side, len(outer_polar)):
        mueller = compute_fresnel_mueller(media[j], media[j + 1], cosine[j, k])
        plus, minus, real, _ = mueller.reflection
        reflectance[j, k] = [plus + minus, plus - minus, real] if polarized else plus
        plus, minus, root, _ = mueller.transmission
        transmittance[j, k] = [plus + minus, plus - minus, root] if polarized else plus
    direct = np.exp(-thickness[:, np.newaxis] / cosine[1:-1])[..., np.newaxis]
    up, down = range(n_layers), range(n_layers, 2 * n_layers)
    system = np.zeros((len(outer_polar), 3, 2 * n_layers, 2 * n_layers)) + np.eye(2 * n_layers)
    source = np.zeros((len(outer_polar), 3, 2 * n_layers, 2))
    system[..., up, down] = np.moveaxis(-reflectance[:-1] * direct, 0, -1)
    system[..., down, up] = np.moveaxis(-reflectance[1:] * direct, 0, -1)
    inner = transmittance[1:-1]
    system[..., up[1:], up[:-1]] = np.moveaxis(-inner * direct[:-1], 0, -1)
    system[..., down[:-1], down[1:]] = np.moveaxis(-inner * direct[1:], 0, -1)
    source[..., up[0], ABOVE] = transmittance[0]
    source[..., down[-1], BELOW] = transmittance[-1]
    solution = np.linalg.solve(system, source).reshape(-1, 3, 2, n_layers, 2)
    # dΩ inside/dΩ outside = cosθ/(n² cosθ'); a BRDF is per outer cosine.
    solid_angle_ratio = 1.0 / (media**2 * cosine.T)[:, 1:-1].T
    return np.transpose(solution, (4, 2, 3, 0, 1)) * solid_angle_ratio[..., np.newaxis]


# --------------------------------------------------------------------------------------------------
# Tally of next-event detectors: sums of batches, and the resulting BRDF and BTDF.

PILOT_BATCHES = 128
"""Batches of the first round."""
_EMPTY_PILOTS = 64
"""Multiple of the first round without any light after which a run ends."""


class DetectorTally(AngularTally):
    """Sums over batches of rays of their contributions to detectors.

    A batch is a chunk of rays; the layer is the same at all wavelengths.

    Parameters
    ----------
    layers : sequence of ParticleMedium
        See `get_detected_layers`.
    scene : Scene
    detectors : Detectors
    target : ErrorTarget
    n_wavelengths : int

    Raises
    ------
    ValueError
        For the transmitted side of a medium whose lower boundary is not open.

    Attributes
    ----------
    sums, sums_of_squares, max_scores : float, shape (values,)
        Sums, sums of squares, and the score of largest magnitude of a batch, with its sign: of
        detectors [side, direction, Stokes parameter], then of [reflected, transmitted][all light,
        unscattered light].
    sums_of_products : float, shape (2, directions, 3)
        Of the scores of I and Q, I and U, and Q and U.
    """

    first_stream = 7_000_000

    def __init__(
        self,
        layers: Sequence[ParticleMedium],
        scene: Scene,
        detectors: Detectors,
        target: ErrorTarget,
        n_wavelengths: int,
    ) -> None:
        if target.side == 1 and not detectors.has_lower_side:
            allowed = "brdf with estimator = next_event"
            raise invalid("target", "btdf", allowed, "the lower boundary is not open")
        indices = [layer.compute_refractive_indices(np.zeros(1)) for layer in layers]
        index = np.concatenate(indices, axis=1)
        super().__init__(make_separate_nodes(index), np.zeros(index.shape))
        self.detectors, self.shape = detectors, detectors.sums.shape
        self.target, self.n_wavelengths = target, n_wavelengths
        self.has_lower_side, self.polarized = detectors.has_lower_side, scene.stokes is not None
        # Light that reaches the ground has other angles than at detectors outside.
        self.undefined_variables = () if self.has_lower_side else ("btdf",)
        scatters = any(one.single_scattering_albedo * one.extinction_per_m > 0.0 for one in layers)
        self.no_signal = scene.opaque is not None or not (scatters or scene.ground_albedo)
        conservative = all(layer.single_scattering_albedo == 1.0 for layer in layers)
        self.lossless = conservative and scene.ground_albedo == 1.0
        self.values_per_row = math.prod(self.shape) + 4
        self.sums, self.sums_of_squares, self.max_scores = np.zeros((3, self.values_per_row))
        self.sums_of_products = np.zeros((*self.shape[:2], 3))
        # For forward-peaked phase functions few events dominate the estimate.
        g = max(abs(layer.kernel_phase_function.g) for layer in layers)
        self.pilot_rays = RAYS_PER_CHUNK * int(
            PILOT_BATCHES * np.clip((1.0 + g) / (1.0 - g) ** 2 / 64.0, 1.0, 64.0)
        )
        self.add_strata()

    def plan_first_round(self, stop: StoppingRule) -> np.ndarray:
        """Return the rays of the first round, at least two batches."""
        return np.maximum(super().plan_first_round(stop), 2 * RAYS_PER_CHUNK)

    def trace_chunk(
        self, seed: int, scene: Scene, stratum: Stratum, first_ray: int
    ) -> tuple[np.ndarray, int]:
        """Trace a batch of rays, and return its mean contributions and the segments traced.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        detectors = self.detectors._replace(
            sums=np.zeros_like(self.detectors.sums),
            peak_directions=np.zeros_like(self.detectors.peak_directions),
        )
        totals = np.zeros((2, 2))
        work = np.array([stratum.stream, first_ray, self.rays_per_chunk, stratum.max_order])
        scene = scene._replace(detectors=detectors)
        result = trace_to_detectors(seed, work, scene, stratum.optics, totals)
        if result.lost:
            raise RuntimeError(LOST_MESSAGE)
        sums = np.concatenate([detectors.sums.ravel(), totals.ravel()])
        return sums / self.rays_per_chunk, int(result.n_segments[0])

    def merge(self, stratum: Stratum, score: np.ndarray) -> None:
        """Add the score of the next batch."""
        self.sums += score
        self.sums_of_squares += score**2
        detected, _ = self._split(score)
        self.sums_of_products += _multiply_pairs(detected)
        self.max_scores = np.where(np.abs(score) > np.abs(self.max_scores), score, self.max_scores)

    def make_estimate(self) -> AngularEstimate:
        """Return BRDF and BTDF, the same at all wavelengths."""
        *detectors, totals, total_errors = self._estimate_detectors()
        shape = (2, self.n_wavelengths, self.shape[1])
        mean, stderr, stopping_error = (
            np.broadcast_to(one[:, np.newaxis, :, 0], shape) for one in detectors
        )
        fraction, unscattered, error, unscattered_error = (
            np.repeat(one[:, np.newaxis], self.n_wavelengths, axis=1)
            for one in (*totals, *total_errors)
        )
        return AngularEstimate(
            mean, stderr, stopping_error, fraction, error, unscattered, unscattered_error,
            np.zeros(shape[:2], dtype=int), np.zeros(shape),
            *compute_anisotropy(mean[0], stderr[0], fraction[0]),
        )  # fmt: skip

    def make_stokes(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the variables of polarized light, see `make_stokes_variables`."""
        if not self.polarized:
            return {}
        mean, stderr, *_ = self._estimate_detectors()
        n_batches = self.n_rays // RAYS_PER_CHUNK
        batch_mean, _ = self._split(self.sums / n_batches)
        product = self.sums_of_products / n_batches
        covariance = (product - _multiply_pairs(batch_mean)) / n_batches
        shape = (4, 2, self.n_wavelengths, self.shape[1])
        by_component = [
            np.broadcast_to(np.moveaxis(one, -1, 0)[:, :, np.newaxis], (one.shape[-1], *shape[1:]))
            for one in (mean, stderr, covariance)
        ]
        return make_stokes_variables(*by_component)

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest relative error, infinite as long as no light reached the detectors."""
        estimate = self.make_estimate()
        if self.no_signal or estimate.mean[self.target.side].any():
            error = estimate.compute_max_error(self.target, use_stopping_error=True)
            return Evaluation(error, estimate)
        gave_up = self.n_rays >= _EMPTY_PILOTS * self.pilot_rays
        return Evaluation(np.inf, estimate, "no_light" if gave_up else "")

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the rays with which the largest relative error is the requested one."""
        n_batches = self.n_rays // RAYS_PER_CHUNK
        wanted = 1.05 * (evaluation.error / stop.max_error) ** 2 * n_batches
        return RAYS_PER_CHUNK * np.array([np.floor(wanted)])

    def _estimate_detectors(self) -> tuple[np.ndarray, ...]:
        """Return means, errors and errors for the stopping rule, and the hemispherical quantities.

        One more batch with the largest score so far is included; for the stopping rule, its scatter
        is computed about the mean without it, so that no run stops on batches that agree by chance.
        Where nothing was scored, the error is that of one ray, except where no signal is possible,
        or no light can be lost.

        Returns
        -------
        mean, stderr, stopping_error : float, shape (2, detectors, 4)
        totals, total_errors : float, shape (2, 2)
            [all light, unscattered light][reflected, transmitted].
        """
        n_batches = self.n_rays // RAYS_PER_CHUNK
        batch_mean = self.sums / n_batches
        mean_square = (self.sums_of_squares + self.max_scores**2) / (n_batches + 1)
        centres = (self.sums + self.max_scores) / (n_batches + 1), batch_mean
        errors = (
            np.sqrt(np.maximum(mean_square - centre**2, 0.0) / n_batches) for centre in centres
        )
        (mean, hemispherical_mean), (stderr, hemispherical_stderr), (stopping_error, _) = (
            self._split(values) for values in (batch_mean, *errors)
        )
        if not self.no_signal:
            unscored = mean[..., 0] == 0.0
            unscored[1] &= self.has_lower_side
            stderr[unscored] = stopping_error[unscored] = 1.0 / (np.pi * self.n_rays)
        if not self.lossless:
            hemispherical_stderr = np.sqrt(
                allow_for_unseen_rays(hemispherical_stderr**2, 1.0 / self.n_rays**2)
            )
        return mean, stderr, stopping_error, hemispherical_mean.T, hemispherical_stderr.T

    def _split(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values of detectors, and the hemispherical ones."""
        n_scores = math.prod(self.shape)
        return values[:n_scores].reshape(self.shape), values[n_scores:].reshape(2, 2)


def _multiply_pairs(stokes: np.ndarray) -> np.ndarray:
    """Return the products of I and Q, I and U, and Q and U, along the last axis."""
    return stokes[..., [0, 0, 1]] * stokes[..., [1, 2, 2]]
