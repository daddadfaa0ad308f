"""Layers of particles against exact plane-parallel answers, all rows to an error of 2e-4.

    python benchmarks/exact_layers.py [--quick]

Prints the rms and the largest deviation in standard errors, and the time; --quick goes to 1e-3.
The rows and what they are compared with stand in tests/physics/reference/plane_parallel.csv.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "physics"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "statistics"))

from chi2 import judge_z
from test_layer_exact import comparisons


def main() -> None:
    """Compare all rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    begun = time.perf_counter()
    z, certain = comparisons(1e-3 if quick else 2e-4)
    label = f"reflectance and transmittance, {certain} values certain"
    judge_z(z, label, independent=(z.size + 1) // 2)
    seconds = time.perf_counter() - begun
    print(f"{seconds:.0f} s, rms z {np.sqrt(np.mean(z**2)):.3f}", flush=True)


if __name__ == "__main__":
    main()
