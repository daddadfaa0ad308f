"""Random streams: what different instruments draw with one seed has nothing in common."""

from __future__ import annotations

import numpy as np

from splits.instruments.angular_tally import ORDER_CLASSES
from splits.instruments.flux_tally import FluxPathTally
from splits.simulation import random_streams
from splits.simulation.spectral_nodes import MAX_SEPARATE_NODES
from splits.simulation.tally import STRATUM_BOUNDS, PathTally, TransportTraits


def test_every_instrument_has_room_for_its_levels():
    firsts = sorted(value for name, value in vars(random_streams).items() if name.isupper())
    most = MAX_SEPARATE_NODES * max(len(STRATUM_BOUNDS), len(ORDER_CLASSES))
    assert len(set(firsts)) == len(firsts) == 10
    assert min(np.diff(firsts)) > most


def test_levels_are_numbered_apart():
    index, absorption, served = np.ones(2) + 0j, np.zeros((3, 2)), np.ones(3, dtype=bool)
    manner = TransportTraits(1e3)
    numbers = [
        level.stream
        for ensemble in (
            *(PathTally(i, index, absorption, served, manner) for i in range(3)),
            *(
                PathTally(i, index, absorption, served, manner._replace(analog=True))
                for i in range(3)
            ),
            *(FluxPathTally(i, index, absorption, served, manner, 2, np.ones(2)) for i in range(3)),
        )
        for level in ensemble.strata
    ]
    assert len(set(numbers)) == len(numbers)
