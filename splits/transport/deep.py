"""Light that gets deep: rays split where they matter, end where they do not.

Rays that reach the bottom of a deep, absorbing sample are too rare to wait for.  What a ray can be
expected to contribute falls with its weight and grows with its depth.  Where the product,
weight · exp(κ·depth), exceeds a window the ray is split into several lighter ones, and below it
Russian roulette ends it or makes it heavier, so that rays of about equal worth are present at all
depths (weight windows; Booth & Hendricks 1984, Nucl. Technol./Fusion 5, 90-100,
doi:10.13182/FST84-A23082).  Neither changes the mean; κ only decides how fast it is reached.
"""

from __future__ import annotations

import math

import numpy as np

from splits.transport.absorption import DEPTH, LIMIT, start_purse
from splits.transport.granular import (
    LOST,
    NO_LEG,
    REFLECTED,
    TRANSMITTED,
    TRAVELS,
    Window,
    follow,
    launch,
)
from splits.transport.jit import entry
from splits.transport.rng import mix64, start_stream, uniform
from splits.transport.scene import UNLIMITED

CAPACITY = 4096
"""Rays that may wait to be followed; none is split while so many do."""
UPPER = 2.0
LOWER = 0.5
MOST = 16
"""Largest number of rays that one is split into at a time."""


@entry
def families(seed, ensemble, first_ray, rays, grains, slab, rules, optics, kappa, moments, profile):
    """Follow rays and all that they are split into, and add up what each family sends through.

    Parameters
    ----------
    seed, ensemble, first_ray : int
        Name the random streams, as in `granular.batch`.
    rays : int
    grains, slab, rules, optics
        See `splits.transport.scene`; `optics.absorption` is that of the one wavelength traced.
    kappa : float
        Rate at which the window falls with depth (1/m).
    moments : float64[2, 3]
        For [reflected, transmitted]: sum, sum of squares and largest of the families' weights,
        advanced in place.
    profile : float64[2, slices]
        See `splits.transport.granular.Window`; advanced in place.

    Returns
    -------
    legs : int
        Legs traced.
    lost : bool
        Whether a ray found no grain that fits; the batch then ends early.
    """
    legs = 0
    state = np.zeros(1, dtype=np.uint64)
    length = np.zeros(optics.n.size)
    purse = np.zeros(3)
    places = np.zeros((CAPACITY, 16))
    streams = np.zeros(CAPACITY, dtype=np.uint64)
    family = np.zeros(2)
    for ray in range(first_ray, first_ray + rays):
        start_stream(state, seed, ensemble, ray)
        family[:] = 0.0
        waiting = 0
        weight = 1.0
        start_purse(purse)
        purse[LIMIT] = math.inf
        x, y, z = 0.0, 0.0, 0.0
        last_leg = NO_LEG
        fate, dx, dy, dz, pore = launch(state, slab, rules, optics)
        while True:
            while fate == TRAVELS:
                window = Window(weight, kappa, LOWER, UPPER, slab.depth, profile)
                fate, x, y, z, dx, dy, dz, last_leg, pore, spent, _ = follow(
                    state, x, y, z, dx, dy, dz, last_leg, pore,
                    grains, slab, rules, optics, length, purse, window, UNLIMITED,
                )  # fmt: skip
                legs += spent
                if fate != TRAVELS:
                    break
                worth = weight * math.exp(-purse[DEPTH] - kappa * z)
                if worth < LOWER:
                    if uniform(state) >= worth:
                        break
                    weight /= worth
                elif worth > UPPER and waiting + MOST < CAPACITY:
                    copies = min(int(worth + 0.5), MOST)
                    weight /= copies
                    for copy in range(1, copies):
                        place = places[waiting]
                        place[0], place[1], place[2] = x, y, z
                        place[3], place[4], place[5] = dx, dy, dz
                        for i in range(7):
                            place[6 + i] = last_leg[i]
                        place[13] = pore
                        place[14] = weight
                        place[15] = purse[DEPTH]
                        streams[waiting] = mix64(state[0] ^ mix64(np.uint64(copy)))
                        waiting += 1
                    # The ray itself goes on in a stream of its own, too: no two may meet.
                    state[0] = mix64(state[0] ^ mix64(np.uint64(0)))
            if fate == LOST:
                return legs, True
            if fate == REFLECTED:
                family[0] += weight * math.exp(-purse[DEPTH])
            elif fate == TRANSMITTED:
                family[1] += weight * math.exp(-purse[DEPTH])
            if waiting == 0:
                break
            waiting -= 1
            place = places[waiting]
            state[0] = streams[waiting]
            x, y, z = place[0], place[1], place[2]
            dx, dy, dz = place[3], place[4], place[5]
            last_leg = (place[6], place[7], place[8], place[9], place[10], place[11], place[12])
            pore = int(place[13])
            weight = place[14]
            purse[DEPTH] = place[15]
            fate = TRAVELS
        for side in range(2):
            moments[side, 0] += family[side]
            moments[side, 1] += family[side] ** 2
            moments[side, 2] = max(moments[side, 2], family[side])
    return legs, False
