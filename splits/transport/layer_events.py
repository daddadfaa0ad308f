"""What becomes of a ray in a layer at the surface, the floor and the particles."""

from __future__ import annotations

import math

from splits.transport.absorption import ROULETTE_BELOW, ROULETTE_SURVIVAL
from splits.transport.encounters import meet_face, only_reflected, reflect_diffusely, scatter
from splits.transport.granular import ABSORBED, REFLECTED, TRANSMITTED, TRAVELS
from splits.transport.jit import kernel
from splits.transport.layer_legs import Ray, ended, moved, once_more, weighing
from splits.transport.local import listen_bottom, listen_particle
from splits.transport.march import cleared
from splits.transport.rng import uniform
from splits.transport.turbid import OPEN
from splits.transport.vectors import UP, scaled


@kernel
def _roulette(state, weight):
    """Return the weight of a ray after Russian roulette, 0 if it ended there."""
    if weight >= ROULETTE_BELOW:
        return weight
    if weight == 0.0 or uniform(state) > ROULETTE_SURVIVAL:
        return 0.0
    return weight / ROULETTE_SURVIVAL


@kernel
def _crossed(state, ray, normal, layer):
    """Return a ray that is reflected or refracted at a facet of the surface."""
    if layer.extinction == math.inf:
        # What enters an opaque layer need not be followed.
        back = only_reflected(ray.d, ray.stokes, normal, layer.n)
        past = weighing(ray.past, ray.past.weight * back.share)
        return moved(ray, back.d, back.stokes, past, TRAVELS)
    near, far = (layer.n, 1.0) if ray.inside else (1.0, layer.n)
    against = scaled(-1.0 if ray.inside else 1.0, normal)
    meeting = meet_face(state, ray.d, ray.stokes, against, near, far)
    inside = ray.inside != meeting.passed
    return Ray(ray.place, meeting.d, meeting.stokes, inside, ray.past, TRAVELS)


@kernel
def at_surface(state, ray, normal, layer, surface, most):
    """Return a ray after a meeting with the surface."""
    if surface is None:
        ray = _crossed(state, ray, normal, layer)
        return ended(ray, TRAVELS if ray.inside else REFLECTED)
    if ray.past.order == most:
        return ended(ray, ABSORBED)
    ray = _crossed(state, ray, normal, layer)
    past = once_more(ray.past)
    if layer.extinction == math.inf and past.order > 1:
        past = weighing(past, _roulette(state, past.weight))
        if past.weight == 0.0:
            return ended(ray, ABSORBED)
    d = cleared(ray.d, scaled(-1.0 if ray.inside else 1.0, normal))
    return moved(ray, d, ray.stokes, past, TRAVELS)


@kernel
def at_floor(state, ray, layer, detectors, most):
    """Return a ray after a meeting with the open face or with the bottom."""
    if layer.bottom == OPEN:
        meeting = meet_face(state, ray.d, ray.stokes, UP, layer.n, 1.0)
        fate = TRANSMITTED if meeting.passed else TRAVELS
        return moved(ray, meeting.d, meeting.stokes, ray.past, fate)
    if detectors is not None:
        listen_bottom(detectors, layer, ray.past.weight * layer.bottom)
    if uniform(state) >= layer.bottom:
        return ended(ray, TRANSMITTED)
    if ray.past.order == most:
        return ended(ray, ABSORBED)
    after = reflect_diffusely(state, UP, ray.stokes)
    return moved(ray, after.d, after.stokes, once_more(ray.past), TRAVELS)


@kernel
def at_particle(state, ray, layer, phase, detectors, most):
    """Return a ray after a meeting with a particle."""
    if ray.past.order == most:
        return ended(ray, ABSORBED)
    past = once_more(ray.past)
    if layer.analog:
        if uniform(state) >= layer.albedo:
            return ended(ray, ABSORBED)
    else:
        past = weighing(past, past.weight * layer.albedo)
        if detectors is not None:
            listen_particle(detectors, layer, phase, moved(ray, ray.d, ray.stokes, past, TRAVELS))
        past = weighing(past, _roulette(state, past.weight))
        if past.weight == 0.0:
            return ended(ray, ABSORBED)
    after = scatter(state, phase, ray.d, ray.stokes)
    return moved(ray, after.d, after.stokes, past, TRAVELS)
