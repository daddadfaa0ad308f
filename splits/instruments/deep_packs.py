"""Packs so deep that paths in them have no end: a cut, and a ground that stands for what is below.

Where little is absorbed, light wanders through a deep pack for ten thousand grains, and comes back.
Far below the surface it is diffuse, and what the rest of the pack does with it is known from
diffusion theory: F↓ and F↑ are φ/4 ± J/2, and φ obeys D φ″ = μ φ (Ishimaru 1978, Wave Propagation
and Scattering in Random Media, chapter 9).  So rays are traced down to a cut only.  A ground there
sends back what the rest would, and keeps what that absorbs or lets through, at every wavelength.

What theory may miss is stated: `DOUBT` of what the rest keeps, times the chance that light from the
cut leaves at the top.  The cut lies so deep that this is a part of the error asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.checks import refuse
from splits.diffusion import Rest, diffuse_reflectance, scattering_mean_step
from splits.instruments.cut import DOUBT, SHARE, Cut
from splits.instruments.grain_optics import (
    BATCH,
    Plan,
    materials_of,
    pooled_by_type,
    roughly,
)
from splits.instruments.scenes import Constants
from splits.instruments.shared_paths import Family
from splits.media.granular import GranularMedium, absorption_of
from splits.media.ground import Ground
from splits.media.particles import ParticleLayer
from splits.media.stack import Stack
from splits.media.turbid import Medium
from splits.transport.grains.scene import DRY_PORE, WET_PORE

LEAST = 600.0
"""Mean distances between grains below which no pack is cut: it is traced in no time."""
REACH = 5.0
"""Light that decays by more than exp(−REACH) down to the cut, at all wavelengths, asks for none."""
DIFFUSE = 30.0
"""Least depth of a cut in units of D, a third of the way on which light forgets its direction."""
CLEARLY = 2.0
"""How far beyond a limit a rough look has to be for no better one to be taken."""
LEAST_TURN = 0.01
"""Least 1 − ωg of grains among which light gets diffuse before it has gone far."""
RAYS = BATCH
"""To measure what each type of grain does: asymmetry to 2 %, far better than `DOUBT`."""
ROUGHLY = 256
"""To see roughly what they do, far better than `CLEARLY`; of rare dark grains too little is seen,
and then a better look is taken."""


class _Diffusing(NamedTuple):
    """How light diffuses among grains, at every wavelength.

    Attributes
    ----------
    loss : float
        Share that a grain absorbs.
    turn : float
        1 − g, and the loss besides: 1 − ωg where little is lost.
    diffusion : float
        D (m).
    rate : float
        By which light decays on its way down (1/m).
    """

    coalbedo: np.ndarray
    transport_factor: np.ndarray
    diffusion_coefficient: np.ndarray
    decay_rate: np.ndarray

    @classmethod
    def from_optics(cls, optics: xr.Dataset) -> _Diffusing:
        """Return it for grains that do this to light, see `pooled_by_type`."""
        step = scattering_mean_step(optics)
        loss = np.maximum(1.0 - optics.single_scattering_albedo.values, 0.0)
        turn = 1.0 - optics.asymmetry_parameter.values + loss
        diffusion = step / (3.0 * np.maximum(turn, np.finfo(float).tiny))
        return cls(loss, turn, diffusion, np.sqrt(loss / step / diffusion))

    def compute_truncation_depth(self, lowest_layer: Any, max_stderr: float, undisturbed_depth_m: float = 0.0) -> float:
        """Return how far below the top of its layer a cut has to lie (m), see `cut_of`."""
        # What the cut misses is at most DOUBT/4 of the light that reaches it, 4 D over its depth.
        needed = DOUBT / (SHARE * max_stderr)
        farthest = float(self.diffusion_coefficient.max())
        # So far above it, light has the directions that it would have without a cut.
        margin = max(DIFFUSE * farthest, 2.0 * lowest_layer.largest_grain_m)
        return max(farthest * needed, undisturbed_depth_m + margin)

    def compute_regularized_rate(self, truncation_depth_m: float) -> np.ndarray:
        """Return the rate (1/m), almost 0 where nothing is absorbed: that says the same, no 0/0."""
        return np.maximum(self.decay_rate, 1e-9 / truncation_depth_m)

    def is_truncation_worthwhile(self, lowest_layer: Any, max_stderr: float, margin: float = 1.0) -> bool:
        """Return whether a layer that ends is worth a cut, or may be if this is off by a margin."""
        height = self.compute_truncation_depth(lowest_layer, max_stderr)
        deep = lowest_layer.depth_m * margin >= 4.0 * height
        return bool(
            self.transport_factor.min() * margin >= LEAST_TURN
            and deep
            and (self.decay_rate * height).min() <= REACH * margin
        )


def cut_of(
    path_sharing: Family,
    wavelengths: np.ndarray,
    max_stderr: float,
    seed: int,
    threads: int,
    undisturbed_depth_m: float = 0.0,
) -> Cut | None:
    """Return packs cut where that serves the error asked for, None where they are traced as such.

    Parameters
    ----------
    family : Family
        Media that share paths.
    wavelengths : float, shape (wavelengths,)
        nm.
    max_stderr, seed, threads
        As for the spectrophotometer.
    within_m : float
        Depth (m) in the lowest layer above which light has to be as without a cut.

    Raises
    ------
    ValueError
        For a pack without end whose lowest layer is not of grains.
    """
    lowest = [_lowest(medium) for medium in path_sharing.media]
    part = lowest[0]
    if not isinstance(part, GranularMedium):
        return None
    depth = float(part.depth_m)
    if depth * part.make_grain_population().attenuation < LEAST:
        return None
    if any(one.pores or "air" in one.refractive_index for one in lowest):
        # The rest of a pack is reckoned for pores of water and of air of index 1.
        if math.isinf(depth):
            raise refuse("depth_m", depth, "finite where pores hold other media or other air")
        return None
    finite = _shallow(lowest[0]) if math.isinf(depth) else part
    constants = _constants(lowest, path_sharing.size_ratios, wavelengths)
    plan = Plan(1, RAYS, seed, threads, "equilibrium")
    if not math.isinf(depth):
        look = roughly(finite, constants, plan._replace(n_rays=ROUGHLY))
        looks = _by_medium(look, len(lowest))
        if not any(_Diffusing.from_optics(one).is_truncation_worthwhile(part, max_stderr, CLEARLY) for one in looks):
            return None
    optics = _by_medium(pooled_by_type(finite, constants, plan), len(lowest))
    return _cut(path_sharing, wavelengths, optics, max_stderr, undisturbed_depth_m)


def _shallow(layer: Any) -> Any:
    """Return a layer that ends, as scenes need one."""
    return replace(layer, depth_m=1.0)


def _constants(
    layers: Sequence[GranularMedium], size_ratios: np.ndarray, wavelengths: np.ndarray
) -> Constants:
    """Return what lowest layers are to light, one after the other, in units of the first's size."""
    found = [materials_of(one, wavelengths) for one in layers]
    return Constants(
        np.concatenate([one.indices for one in found]),
        np.concatenate([s * one.absorption for one, s in zip(found, size_ratios, strict=True)]),
    )


def _by_medium(optics: xr.Dataset, n_media: int) -> list[xr.Dataset]:
    """Return parts of what grains do, which hold for one medium after the other."""
    parts = {name: np.split(one.values, n_media) for name, one in optics.data_vars.items()}
    return [xr.Dataset({n: ("row", part[i]) for n, part in parts.items()}) for i in range(n_media)]


def _cut(
    path_sharing: Family, wavelengths: np.ndarray, optics: Sequence[xr.Dataset], max_stderr: float,
    undisturbed_depth_m: float,
) -> Cut | None:  # fmt: skip
    """Return what `cut_of` returns, for lowest layers of such optics."""
    media, scales = path_sharing
    found = [_Diffusing.from_optics(one) for one in optics]
    part = _lowest(media[0])
    if math.isinf(part.depth_m):
        if min(one.transport_factor.min() for one in found) < LEAST_TURN:
            raise refuse("depth_m", math.inf, "finite", "these grains hardly turn light")
    elif not any(one.is_truncation_worthwhile(part, max_stderr) for one in found):
        return None
    height = max(one.compute_truncation_depth(part, max_stderr, undisturbed_depth_m) for one in found)
    rests = [
        _Rested.from_diffusion(medium, scale, one, wavelengths, height)
        for medium, scale, one in zip(media, scales, found, strict=True)
    ]
    # Media that share paths all have a ground, or none.
    least = np.finfo(float).tiny if len(media) > 1 else 0.0
    sent = [
        _through_face(rest.reflected_fraction, materials_of(_lowest(m), wavelengths).indices, _lowest(m), o)
        for m, rest, o in zip(media, rests, optics, strict=True)
    ]
    grounds = [_ground(wavelengths, np.maximum(one, least)) for one in sent]
    return Cut(
        tuple(_shorter(m, s * height, g) for m, s, g in zip(media, scales, grounds, strict=True)),
        height,
        np.stack([rest.transmitted_fraction for rest in rests]),
        np.stack([rest.conservative for rest in rests]),
        np.stack([rest.escape_probability for rest in rests]),
        np.stack([ground.optical_depth(wavelengths) for ground in grounds]),
        _enough(*_clearest(found, height), max_stderr),
    )


def _lowest(medium: Medium) -> Any:
    """Return the lowest layer."""
    return medium.layers[-1] if isinstance(medium, Stack) else medium


def _shorter(medium: Medium, depth_m: float, ground: Ground) -> Medium:
    """Return a pack whose lowest layer is cut, over a ground."""
    part = replace(_lowest(medium), depth_m=depth_m)
    if isinstance(medium, Stack):
        return replace(medium, layers=(*medium.layers[:-1], part), ground=ground)
    return replace(part, ground=ground)  # type: ignore[no-any-return]


class _Rested(NamedTuple):
    """What the part of a pack below its cut does, at every wavelength; see `Cut`.

    Attributes
    ----------
    sent : float
        Share that it sends back.
    passed, clear, escape
        As of a `Cut`.
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
        properties: _Diffusing,
        wavelengths: np.ndarray,
        truncation_depth_m: float,
    ) -> _Rested:
        """Return it for a pack of a size among whose grains light diffuses so."""
        depth = float(_lowest(medium).depth_m) / size_ratio
        rate, diffusion = properties.compute_regularized_rate(truncation_depth_m), properties.diffusion_coefficient
        below = Ground.from_input(medium.ground)  # type: ignore[union-attr]
        open_below = below is None or math.isinf(depth)
        albedo = np.zeros_like(rate) if open_below else below.albedo(wavelengths)  # type: ignore[union-attr]
        rest = Rest(
            rate * diffusion, rate * (depth - truncation_depth_m), 0.5 * (1.0 - albedo) / (1.0 + albedo)
        )
        clear = properties.coalbedo <= 0.0
        sent = np.where(clear & (math.isinf(depth) | (albedo == 1.0)), 1.0, rest.compute_reflected_fraction())
        passed = np.where(clear & (sent < 1.0), 1.0, rest.compute_transmitted_fraction())
        arriving = 1.0 / (1.0 + 0.75 * truncation_depth_m / (diffusion * 3.0))
        escape = arriving / (arriving + 1.0 - sent)
        dark_above = _absorbing_above(medium, wavelengths)
        return cls(sent, passed, (passed == 1.0) & ~dark_above, escape)


def _absorbing_above(medium: Medium, wavelengths: np.ndarray) -> np.ndarray:
    """Tell at which wavelengths a layer above the lowest one may absorb."""
    if not isinstance(medium, Stack):
        return np.zeros(wavelengths.size, dtype=bool)
    above = len(medium.list_materials()) - len(medium.scene_layers[-1].list_materials())
    absorption = absorption_of(medium, medium.compute_refractive_indices(wavelengths), wavelengths)
    pale = [
        p.layer.single_scattering_albedo < 1.0 for p in medium.scene_layers if isinstance(p, ParticleLayer)
    ]
    dark = (absorption[:, :above] > 0.0).any(axis=1)
    return np.asarray(dark | any(pale))


def _clearest(properties: Sequence[_Diffusing], truncation_depth_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return rate (1/m) and D (m) of the medium that light gets deepest in, by wavelength."""
    rate, diffusion = (
        np.stack(x) for x in ([one.compute_regularized_rate(truncation_depth_m) for one in properties], [f.diffusion_coefficient for f in properties])
    )
    clearest = rate.argmin(axis=0), np.arange(rate.shape[1])
    return rate[clearest], diffusion[clearest]


def _enough(decay_rate: np.ndarray, diffusion_coefficient: np.ndarray, max_stderr: float) -> float:
    """Return the least depth (m) over a black ground that is as bright as any."""
    depths = np.geomspace(1e-4, 1e4, 1601)[:, np.newaxis]
    black = np.full_like(decay_rate, 0.5)
    shallow = Rest(decay_rate * diffusion_coefficient, decay_rate * depths, black).compute_reflected_fraction()
    endless = Rest(decay_rate * diffusion_coefficient, np.full_like(decay_rate, np.inf), black).compute_reflected_fraction()
    far = np.abs(endless - shallow).max(axis=1) > max_stderr
    return float(depths[min(far.sum(), len(depths) - 1), 0])


def _through_face(
    reflected_fraction: np.ndarray, indices: np.ndarray, lowest_layer: GranularMedium, optics: xr.Dataset
) -> np.ndarray:
    """Return the albedo of a ground that, below the face of wet pores, sends back so much.

    A face keeps diffuse light of wet pores from leaving, more than it keeps that from outside from
    entering: by n², as reciprocity asks for.
    """
    if not lowest_layer.wet_fraction or not lowest_layer.interpretation.to_sampling_rules(False).boundary_fresnel:
        return reflected_fraction
    index = indices.real
    n = index[:, WET_PORE] / index[:, DRY_PORE]
    outer = diffuse_reflectance(n)
    inner = 1.0 - (1.0 - outer) / n**2
    wet = optics.wet_share.values
    out, back = 1.0 - wet * inner, 1.0 - float(lowest_layer.wet_fraction) * outer
    # What the ground keeps, in units of what reaches the face from within, is to be 1 − sent.
    kept = 1.0 - reflected_fraction
    albedo: np.ndarray = np.clip((out - kept) / (out - kept * (1.0 - back)), 0.0, 1.0)
    return albedo


def _ground(wavelengths: np.ndarray, albedo: np.ndarray) -> Ground:
    """Return the ground that stands for the rest of a pack."""
    name = "rest of the pack"
    if wavelengths.size == 1:
        return Ground(name, "diffusion theory", albedo)
    return Ground(name, "diffusion theory", albedo, wavelengths)
