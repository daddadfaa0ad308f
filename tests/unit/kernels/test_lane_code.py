"""The machine code of the passes over lanes: vectors as wide as the processor has them."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from llvmlite import binding
from numba import njit
from scenes import compute_optics, get_vectorized_scene, make_medium_scene

import splits
from splits.kernels.compiler.passes import RefcountCheckedCompiler
from splits.kernels.vectorized import flight, interaction, lane_state
from splits.kernels.vectorized.eligibility import select_features

ARITHMETIC = re.compile(
    r"\tv(?:add|sub|mul|fn?m(?:add|sub)\d+)([sp])s\s.*%([xyz])mm\d+(?: \{%k\d\})?(?: \{z\})?$", re.M
)
FEATURES = binding.get_host_cpu_features()
MAX_LANES = "z" if FEATURES.get("avx512f") else "y"

pytestmark = [
    NEEDS_JIT,
    pytest.mark.skipif(not FEATURES.get("avx2"), reason="for processors with vectors of x86"),
]


def count_arithmetic(function, medium):
    """Return how often sums and products of single precision stand in a pass, by kind."""
    scene, optics = make_medium_scene(medium), compute_optics(medium, 500.0)
    compiled = njit(error_model="numpy", _nrt=False, pipeline_class=RefcountCheckedCompiler)(
        function.py_func
    )
    state = np.zeros(lane_state.STATE_SIZE, dtype=np.float32)
    state[lane_state.STATUS : lane_state.STATUS + lane_state.N_LANES] = lane_state.IDLE
    words = np.zeros(lane_state.WORDS_SIZE, dtype=np.uint32)
    compiled(
        state,
        words,
        lane_state.N_LANES,
        select_features(scene, optics),
        get_vectorized_scene(scene),
    )
    (code,) = compiled.inspect_asm().values()
    return Counter(kind + width for kind, width in ARITHMETIC.findall(code))


@pytest.mark.parametrize(
    "function", [flight.run_flight_pass, interaction.run_surface_pass], ids=["flight", "surface"]
)
@pytest.mark.parametrize(
    "medium",
    [splits.Snow(), splits.Sand(texture=(0.0, 0.1, 0.9)), splits.Stack([splits.Snow()] * 2)],
    ids=["snow", "sand", "stack"],
)
def test_passes_compute_on_the_widest_vectors_two_at_a_time(function, medium):
    """Beside the vectors stands the same loop for single lanes, for numbers that they do not fill.

    There are none: lanes come in whole strides.
    """
    found = count_arithmetic(function, medium)
    assert found["p" + MAX_LANES] > 200
    assert found["p" + MAX_LANES] >= 2 * found["sx"]
    assert set(found) <= {"p" + MAX_LANES, "sx"}
