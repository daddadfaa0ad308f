"""Machine code of the vectorized passes: SIMD instructions of the full vector width."""

import re
from collections import Counter

import pytest
from chi2 import NEEDS_JIT
from llvmlite import binding
from numba import njit
from scenes import compute_optics, make_medium_scene

import splits
from splits.kernels.compiler.jit import RefcountCheckedCompiler
from splits.kernels.vectorized import lanes, passes
from splits.kernels.vectorized.trace import allocate_lanes, select_features

ARITHMETIC = re.compile(
    r"\tv(?:add|sub|mul|fn?m(?:add|sub)\d+)([sp])s\s.*%([xyz])mm\d+(?: \{%k\d\})?(?: \{z\})?$", re.M
)
FEATURES = binding.get_host_cpu_features()
MAX_LANES = "z" if FEATURES.get("avx512f") else "y"

pytestmark = [
    NEEDS_JIT,
    pytest.mark.skipif(not FEATURES.get("avx2"), reason="needs x86 processors with AVX2"),
]


@njit
def allocate_idle_lanes():
    return allocate_lanes()


def count_arithmetic(function, medium):
    """Return the numbers of arithmetic instructions of a pass, by precision and vector width."""
    scene, optics = make_medium_scene(medium), compute_optics(medium, 500.0)
    kernel = njit(error_model="numpy", _nrt=False, pipeline_class=RefcountCheckedCompiler)(
        function.py_func
    )
    kernel(
        allocate_idle_lanes(),
        lanes.N_LANES,
        select_features(scene, optics),
        scene.rules,
    )
    (code,) = kernel.inspect_asm().values()
    return Counter(kind + width for kind, width in ARITHMETIC.findall(code))


@pytest.mark.parametrize(
    "function", [passes.run_flight_pass, passes.run_surface_pass], ids=["flight", "surface"]
)
@pytest.mark.parametrize(
    "medium",
    [splits.Snow(), splits.Sand(texture=(0.0, 0.1, 0.9)), splits.Stack([splits.Snow()] * 2)],
    ids=["snow", "sand", "stack"],
)
def test_passes_use_the_widest_vectors(function, medium):
    """The compiler unrolls the vector loop twice and adds a scalar remainder loop.

    The remainder loop is never executed, as the number of lanes is a multiple of the width.
    """
    counts = count_arithmetic(function, medium)
    assert counts["p" + MAX_LANES] > 200
    assert counts["p" + MAX_LANES] >= 2 * counts["sx"]
    assert set(counts) <= {"p" + MAX_LANES, "sx"}
