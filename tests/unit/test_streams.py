"""Random streams: what different instruments draw with one seed has nothing in common."""

from __future__ import annotations

import numpy as np

from splits.instruments import streams
from splits.instruments.directional import CLASSES
from splits.instruments.ensemble import LEVELS, Ensemble, Manner
from splits.instruments.nodes import MOST_APART
from splits.instruments.planes import Planes


def test_every_instrument_has_room_for_its_levels():
    firsts = sorted(value for name, value in vars(streams).items() if name.isupper())
    most = MOST_APART * max(len(LEVELS), len(CLASSES))
    assert len(set(firsts)) == len(firsts) == 10
    assert min(np.diff(firsts)) > most


def test_levels_are_numbered_apart():
    index, absorption, served = np.ones(2) + 0j, np.zeros((3, 2)), np.ones(3, dtype=bool)
    manner = Manner(1e3)
    numbers = [
        level.stream
        for ensemble in (
            *(Ensemble(i, index, absorption, served, manner) for i in range(3)),
            *(
                Ensemble(i, index, absorption, served, manner._replace(analog=True))
                for i in range(3)
            ),
            *(Planes(i, index, absorption, served, manner, 2, np.ones(2)) for i in range(3)),
        )
        for level in ensemble.levels
    ]
    assert len(set(numbers)) == len(numbers)
