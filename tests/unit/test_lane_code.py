"""The machine code of the passes over lanes: vectors as wide as the processor has them."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from llvmlite import binding
from numba import njit
from scenes import medium_scene, optics_at, passing

import splits
from splits.transport.compiling.ownership import Checked
from splits.transport.lanes import flight, rows, surface
from splits.transport.lanes.choice import features_for

ARITHMETIC = re.compile(
    r"\tv(?:add|sub|mul|fn?m(?:add|sub)\d+)([sp])s\s.*%([xyz])mm\d+(?: \{%k\d\})?(?: \{z\})?$", re.M
)
FEATURES = binding.get_host_cpu_features()
WIDEST = "z" if FEATURES.get("avx512f") else "y"

pytestmark = [
    NEEDS_JIT,
    pytest.mark.skipif(not FEATURES.get("avx2"), reason="for processors with vectors of x86"),
]


def arithmetic(function, medium):
    """Return how often sums and products of single precision stand in a pass, by kind."""
    scene, optics = medium_scene(medium), optics_at(medium, 500.0)
    compiled = njit(error_model="numpy", _nrt=False, pipeline_class=Checked)(function.py_func)
    state = np.zeros(rows.STATE, dtype=np.float32)
    state[rows.STATUS : rows.STATUS + rows.LANES] = rows.IDLE
    words = np.zeros(rows.WORDS, dtype=np.uint32)
    compiled(state, words, rows.LANES, features_for(scene, optics), passing(scene))
    (code,) = compiled.inspect_asm().values()
    return Counter(kind + width for kind, width in ARITHMETIC.findall(code))


@pytest.mark.parametrize("function", [flight.flight, surface.surface], ids=["flight", "surface"])
@pytest.mark.parametrize(
    "medium",
    [splits.Snow(), splits.Sand(texture=(0.0, 0.1, 0.9)), splits.Stack([splits.Snow()] * 2)],
    ids=["snow", "sand", "stack"],
)
def test_passes_compute_on_the_widest_vectors_two_at_a_time(function, medium):
    """Beside the vectors stands the same loop for single lanes, for numbers that they do not fill.

    There are none: lanes come in whole strides.
    """
    found = arithmetic(function, medium)
    assert found["p" + WIDEST] > 200
    assert found["p" + WIDEST] >= 2 * found["sx"]
    assert set(found) <= {"p" + WIDEST, "sx"}
