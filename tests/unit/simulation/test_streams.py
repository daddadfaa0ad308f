"""Random number streams: instruments and strata use independent streams for one seed."""

from __future__ import annotations

import numpy as np

from splits.instruments.angular_tally import ORDER_CLASSES
from splits.instruments.flux_tally import FluxPathTally
from splits.simulation import random_streams
from splits.simulation.spectral_nodes import MAX_SEPARATE_NODES
from splits.simulation.tally import STRATUM_BOUNDS, PathTally, TransportTraits


def test_stream_offsets_leave_room_for_all_strata():
    offsets = sorted(value for name, value in vars(random_streams).items() if name.isupper())
    max_streams = MAX_SEPARATE_NODES * max(len(STRATUM_BOUNDS), len(ORDER_CLASSES))
    assert len(set(offsets)) == len(offsets) == 10
    assert min(np.diff(offsets)) > max_streams


def test_strata_have_different_streams():
    index, absorption, mask = np.ones(2) + 0j, np.zeros((3, 2)), np.ones(3, dtype=bool)
    traits = TransportTraits(1e3)
    streams = [
        stratum.stream
        for ensemble in (
            *(PathTally(i, index, absorption, mask, traits) for i in range(3)),
            *(
                PathTally(i, index, absorption, mask, traits._replace(analog=True))
                for i in range(3)
            ),
            *(FluxPathTally(i, index, absorption, mask, traits, 2, np.ones(2)) for i in range(3)),
        )
        for stratum in ensemble.strata
    ]
    assert len(set(streams)) == len(streams)
