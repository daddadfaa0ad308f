"""Packs so deep that paths in them have no end: a cut, and a ground that stands for what is below.

Where little is absorbed, light wanders through a deep pack for ten thousand grains, and comes back.
Far below the surface it is diffuse, and what the rest of the pack does with it is known from
diffusion theory: F↓ and F↑ are φ/4 ± J/2, and φ obeys D φ″ = μ φ (Ishimaru 1978, Wave Propagation
and Scattering in Random Media, chapter 9).  So rays are traced down to a cut only.  A ground there
sends back what the rest would, and keeps what that absorbs or lets through, at every wavelength.

What theory may miss is stated: `THEORY_UNCERTAINTY` of what the rest keeps, times the chance that light from the
cut leaves at the top.  The cut lies so deep that this is a part of the error asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.validation import invalid
from splits.kernels.grains.scene import DRY_PORE, WET_PORE
from splits.media.ground import Ground
from splits.media.medium import GranularMedium, Medium, compute_absorption
from splits.media.stack import Stack
from splits.media.stacked_particle_layer import StackedParticleLayer
from splits.simulation.diffusion import (
    DiffusiveSubstrate,
    diffuse_reflectance,
    effective_mean_free_path,
)
from splits.simulation.grain_optics import (
    GRAIN_RAYS_PER_CHUNK,
    GrainOpticsRequest,
    compute_material_constants,
    estimate_pilot_optics,
    pool_optics_by_type,
)
from splits.simulation.path_tally import PathSharingMedia
from splits.simulation.scene import OpticalConstants
from splits.simulation.truncated_medium import (
    ERROR_BUDGET_FRACTION,
    THEORY_UNCERTAINTY,
    TruncatedMedium,
)

MIN_DEPTH_MFP = 600.0
"""Mean distances between grains below which no pack is cut: it is traced in no time."""
MAX_DECAY_EXPONENT = 5.0
"""Light that decays by more than exp(−REACH) down to the cut, at all wavelengths, asks for none."""
MIN_DEPTH_IN_D = 30.0
"""Least depth of a cut in units of D, a third of the way on which light forgets its direction."""
PILOT_MARGIN = 2.0
"""How far beyond a limit a rough look has to be for no better one to be taken."""
MIN_TRANSPORT_FACTOR = 0.01
"""Least 1 − ωg of grains among which light gets diffuse before it has gone far."""
OPTICS_RAYS_PER_TYPE = GRAIN_RAYS_PER_CHUNK
"""To measure what each type of grain does: asymmetry to 2 %, far better than `THEORY_UNCERTAINTY`."""
OPTICS_PILOT_RAYS = 256
"""To see roughly what they do, far better than `PILOT_MARGIN`; of rare dark grains too little is seen,
and then a better look is taken."""


class _DiffusionProperties(NamedTuple):
    """How light diffuses among grains, at every wavelength.

    Attributes
    ----------
    coalbedo : float
        Share that a grain absorbs.
    transport_factor : float
        1 − g, and the loss besides: 1 − ωg where little is lost.
    diffusion_coefficient : float
        D (m).
    decay_rate : float
        By which light decays on its way down (1/m).
    """

    coalbedo: np.ndarray
    transport_factor: np.ndarray
    diffusion_coefficient: np.ndarray
    decay_rate: np.ndarray

    @classmethod
    def from_optics(cls, optics: xr.Dataset) -> _DiffusionProperties:
        """Return it for grains that do this to light, see `pool_optics_by_type`."""
        step = effective_mean_free_path(optics)
        loss = np.maximum(1.0 - optics.single_scattering_albedo.values, 0.0)
        turn = 1.0 - optics.asymmetry_parameter.values + loss
        diffusion = step / (3.0 * np.maximum(turn, np.finfo(float).tiny))
        return cls(loss, turn, diffusion, np.sqrt(loss / step / diffusion))

    def compute_truncation_depth(
        self, lowest_layer: Any, max_stderr: float, undisturbed_depth_m: float = 0.0
    ) -> float:
        """Return how far below the top of its layer a cut has to lie (m), see `truncate_deep_medium`."""
        # What the cut misses is at most DOUBT/4 of the light that reaches it, 4 D over its depth.
        needed = THEORY_UNCERTAINTY / (ERROR_BUDGET_FRACTION * max_stderr)
        farthest = float(self.diffusion_coefficient.max())
        # So far above it, light has the directions that it would have without a cut.
        margin = max(MIN_DEPTH_IN_D * farthest, 2.0 * lowest_layer.largest_grain_m)
        return max(farthest * needed, undisturbed_depth_m + margin)

    def compute_regularized_rate(self, truncation_depth_m: float) -> np.ndarray:
        """Return the rate (1/m), almost 0 where nothing is absorbed: that says the same, no 0/0."""
        return np.maximum(self.decay_rate, 1e-9 / truncation_depth_m)

    def is_truncation_worthwhile(
        self, lowest_layer: Any, max_stderr: float, margin: float = 1.0
    ) -> bool:
        """Return whether a layer that ends is worth a cut, or may be if this is off by a margin."""
        height = self.compute_truncation_depth(lowest_layer, max_stderr)
        deep = lowest_layer.depth_m * margin >= 4.0 * height
        return bool(
            self.transport_factor.min() * margin >= MIN_TRANSPORT_FACTOR
            and deep
            and (self.decay_rate * height).min() <= MAX_DECAY_EXPONENT * margin
        )


def truncate_deep_medium(
    path_sharing: PathSharingMedia,
    wavelengths: np.ndarray,
    max_stderr: float,
    seed: int,
    threads: int,
    undisturbed_depth_m: float = 0.0,
) -> TruncatedMedium | None:
    """Return packs cut where that serves the error asked for, None where they are traced as such.

    Parameters
    ----------
    path_sharing : PathSharingMedia
        Media that share paths.
    wavelengths : float, shape (wavelengths,)
        nm.
    max_stderr, seed, threads
        As for the spectrophotometer.
    undisturbed_depth_m : float
        Depth (m) in the lowest layer above which light has to be as without a cut.

    Raises
    ------
    ValueError
        For a pack without end whose lowest layer is not of grains.
    """
    lowest = [_get_lowest_layer(medium) for medium in path_sharing.media]
    part = lowest[0]
    if not isinstance(part, GranularMedium):
        return None
    depth = float(part.depth_m)
    if depth * part.make_grain_population().attenuation < MIN_DEPTH_MFP:
        return None
    if any(one.pores or "air" in one.refractive_index for one in lowest):
        # The rest of a pack is reckoned for pores of water and of air of index 1.
        if math.isinf(depth):
            raise invalid("depth_m", depth, "finite where pores hold other media or other air")
        return None
    finite = _make_layer_finite(lowest[0]) if math.isinf(depth) else part
    constants = _combine_constants(lowest, path_sharing.size_ratios, wavelengths)
    plan = GrainOpticsRequest(1, OPTICS_RAYS_PER_TYPE, seed, threads, "equilibrium")
    if not math.isinf(depth):
        look = estimate_pilot_optics(finite, constants, plan._replace(n_rays=OPTICS_PILOT_RAYS))
        looks = _split_by_medium(look, len(lowest))
        if not any(
            _DiffusionProperties.from_optics(one).is_truncation_worthwhile(
                part, max_stderr, PILOT_MARGIN
            )
            for one in looks
        ):
            return None
    optics = _split_by_medium(pool_optics_by_type(finite, constants, plan), len(lowest))
    return _truncate(path_sharing, wavelengths, optics, max_stderr, undisturbed_depth_m)


def _make_layer_finite(layer: Any) -> Any:
    """Return a layer that ends, as scenes need one."""
    return replace(layer, depth_m=1.0)


def _combine_constants(
    layers: Sequence[GranularMedium], size_ratios: np.ndarray, wavelengths: np.ndarray
) -> OpticalConstants:
    """Return what lowest layers are to light, one after the other, in units of the first's size."""
    found = [compute_material_constants(one, wavelengths) for one in layers]
    return OpticalConstants(
        np.concatenate([one.indices for one in found]),
        np.concatenate([s * one.absorption for one, s in zip(found, size_ratios, strict=True)]),
    )


def _split_by_medium(optics: xr.Dataset, n_media: int) -> list[xr.Dataset]:
    """Return parts of what grains do, which hold for one medium after the other."""
    parts = {name: np.split(one.values, n_media) for name, one in optics.data_vars.items()}
    return [xr.Dataset({n: ("row", part[i]) for n, part in parts.items()}) for i in range(n_media)]


def _truncate(
    path_sharing: PathSharingMedia, wavelengths: np.ndarray, optics: Sequence[xr.Dataset], max_stderr: float,
    undisturbed_depth_m: float,
) -> TruncatedMedium | None:  # fmt: skip
    """Return what `truncate_deep_medium` returns, for lowest layers of such optics."""
    media, scales = path_sharing
    found = [_DiffusionProperties.from_optics(one) for one in optics]
    part = _get_lowest_layer(media[0])
    if math.isinf(part.depth_m):
        if min(one.transport_factor.min() for one in found) < MIN_TRANSPORT_FACTOR:
            raise invalid("depth_m", math.inf, "finite", "these grains hardly turn light")
    elif not any(one.is_truncation_worthwhile(part, max_stderr) for one in found):
        return None
    height = max(
        one.compute_truncation_depth(part, max_stderr, undisturbed_depth_m) for one in found
    )
    rests = [
        _SubstrateResponse.from_diffusion(medium, scale, one, wavelengths, height)
        for medium, scale, one in zip(media, scales, found, strict=True)
    ]
    # Media that share paths all have a ground, or none.
    least = np.finfo(float).tiny if len(media) > 1 else 0.0
    sent = [
        _compute_albedo_below_interface(
            rest.reflected_fraction,
            compute_material_constants(_get_lowest_layer(m), wavelengths).indices,
            _get_lowest_layer(m),
            o,
        )
        for m, rest, o in zip(media, rests, optics, strict=True)
    ]
    grounds = [_make_ground(wavelengths, np.maximum(one, least)) for one in sent]
    return TruncatedMedium(
        tuple(
            _truncate_lowest_layer(m, s * height, g)
            for m, s, g in zip(media, scales, grounds, strict=True)
        ),
        height,
        np.stack([rest.transmitted_fraction for rest in rests]),
        np.stack([rest.conservative for rest in rests]),
        np.stack([rest.escape_probability for rest in rests]),
        np.stack([ground.optical_depth(wavelengths) for ground in grounds]),
        _compute_semi_infinite_depth(*_select_least_attenuated(found, height), max_stderr),
    )


def _get_lowest_layer(medium: Medium) -> Any:
    """Return the lowest layer."""
    return medium.layers[-1] if isinstance(medium, Stack) else medium


def _truncate_lowest_layer(medium: Medium, depth_m: float, ground: Ground) -> Medium:
    """Return a pack whose lowest layer is cut, over a ground."""
    part = replace(_get_lowest_layer(medium), depth_m=depth_m)
    if isinstance(medium, Stack):
        return replace(medium, layers=(*medium.layers[:-1], part), ground=ground)
    return replace(part, ground=ground)  # type: ignore[no-any-return]


class _SubstrateResponse(NamedTuple):
    """What the part of a pack below its cut does, at every wavelength; see `TruncatedMedium`.

    Attributes
    ----------
    reflected_fraction : float
        Share that it sends back.
    passed, clear, escape
        As of a `TruncatedMedium`.
    """

    reflected_fraction: np.ndarray
    transmitted_fraction: np.ndarray
    conservative: np.ndarray
    escape_probability: np.ndarray

    @classmethod
    def from_diffusion(
        cls,
        medium: Medium,
        size_ratio: float,
        properties: _DiffusionProperties,
        wavelengths: np.ndarray,
        truncation_depth_m: float,
    ) -> _SubstrateResponse:
        """Return it for a pack of a size among whose grains light diffuses so."""
        depth = float(_get_lowest_layer(medium).depth_m) / size_ratio
        rate, diffusion = (
            properties.compute_regularized_rate(truncation_depth_m),
            properties.diffusion_coefficient,
        )
        below = Ground.from_input(medium.ground)  # type: ignore[union-attr]
        open_below = below is None or math.isinf(depth)
        albedo = np.zeros_like(rate) if open_below else below.albedo(wavelengths)  # type: ignore[union-attr]
        rest = DiffusiveSubstrate(
            rate * diffusion,
            rate * (depth - truncation_depth_m),
            0.5 * (1.0 - albedo) / (1.0 + albedo),
        )
        clear = properties.coalbedo <= 0.0
        sent = np.where(
            clear & (math.isinf(depth) | (albedo == 1.0)), 1.0, rest.compute_reflected_fraction()
        )
        passed = np.where(clear & (sent < 1.0), 1.0, rest.compute_transmitted_fraction())
        arriving = 1.0 / (1.0 + 0.75 * truncation_depth_m / (diffusion * 3.0))
        escape = arriving / (arriving + 1.0 - sent)
        dark_above = _has_absorption_above(medium, wavelengths)
        return cls(sent, passed, (passed == 1.0) & ~dark_above, escape)


def _has_absorption_above(medium: Medium, wavelengths: np.ndarray) -> np.ndarray:
    """Tell at which wavelengths a layer above the lowest one may absorb."""
    if not isinstance(medium, Stack):
        return np.zeros(wavelengths.size, dtype=bool)
    above = len(medium.list_materials()) - len(medium.scene_layers[-1].list_materials())
    absorption = compute_absorption(
        medium, medium.compute_refractive_indices(wavelengths), wavelengths
    )
    pale = [
        p.layer.single_scattering_albedo < 1.0
        for p in medium.scene_layers
        if isinstance(p, StackedParticleLayer)
    ]
    dark = (absorption[:, :above] > 0.0).any(axis=1)
    return np.asarray(dark | any(pale))


def _select_least_attenuated(
    properties: Sequence[_DiffusionProperties], truncation_depth_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return rate (1/m) and D (m) of the medium that light gets deepest in, by wavelength."""
    rate, diffusion = (
        np.stack(x)
        for x in (
            [one.compute_regularized_rate(truncation_depth_m) for one in properties],
            [f.diffusion_coefficient for f in properties],
        )
    )
    clearest = rate.argmin(axis=0), np.arange(rate.shape[1])
    return rate[clearest], diffusion[clearest]


def _compute_semi_infinite_depth(
    decay_rate: np.ndarray, diffusion_coefficient: np.ndarray, max_stderr: float
) -> float:
    """Return the least depth (m) over a black ground that is as bright as any."""
    depths = np.geomspace(1e-4, 1e4, 1601)[:, np.newaxis]
    black = np.full_like(decay_rate, 0.5)
    shallow = DiffusiveSubstrate(
        decay_rate * diffusion_coefficient, decay_rate * depths, black
    ).compute_reflected_fraction()
    endless = DiffusiveSubstrate(
        decay_rate * diffusion_coefficient, np.full_like(decay_rate, np.inf), black
    ).compute_reflected_fraction()
    far = np.abs(endless - shallow).max(axis=1) > max_stderr
    return float(depths[min(far.sum(), len(depths) - 1), 0])


def _compute_albedo_below_interface(
    reflected_fraction: np.ndarray,
    indices: np.ndarray,
    lowest_layer: GranularMedium,
    optics: xr.Dataset,
) -> np.ndarray:
    """Return the albedo of a ground that, below the face of wet pores, sends back so much.

    A face keeps diffuse light of wet pores from leaving, more than it keeps that from outside from
    entering: by n², as reciprocity asks for.
    """
    if (
        not lowest_layer.wet_fraction
        or not lowest_layer.interpretation.to_sampling_rules(False).boundary_fresnel
    ):
        return reflected_fraction
    index = indices.real
    n = index[:, WET_PORE] / index[:, DRY_PORE]
    outer = diffuse_reflectance(n)
    inner = 1.0 - (1.0 - outer) / n**2
    wet = optics.wet_fraction.values
    out, back = 1.0 - wet * inner, 1.0 - float(lowest_layer.wet_fraction) * outer
    # What the ground keeps, in units of what reaches the face from within, is to be 1 − sent.
    kept = 1.0 - reflected_fraction
    albedo: np.ndarray = np.clip((out - kept) / (out - kept * (1.0 - back)), 0.0, 1.0)
    return albedo


def _make_ground(wavelengths: np.ndarray, albedo: np.ndarray) -> Ground:
    """Return the ground that stands for the rest of a pack."""
    name = "rest of the pack"
    if wavelengths.size == 1:
        return Ground(name, "diffusion theory", albedo)
    return Ground(name, "diffusion theory", albedo, wavelengths)
