"""Particle layers compared with exact plane-parallel solutions, all rows to an error of 2e-4.

    python benchmarks/exact_layers.py [--quick]

Prints the rms and the largest deviation in standard errors, and the time; with --quick to an error
of 1e-3.  The cases and their exact values are in tests/physics/reference/plane_parallel.csv.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "physics"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "statistics"))

from chi2 import judge_z
from test_layer_limits import compare_with_reference


def main() -> None:
    """Compare all cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    start = time.perf_counter()
    z, certain = compare_with_reference(1e-3 if quick else 2e-4)
    label = f"reflectance and transmittance, {certain} values certain"
    judge_z(z, label, independent=(z.size + 1) // 2)
    seconds = time.perf_counter() - start
    print(f"{seconds:.0f} s, rms z {np.sqrt(np.mean(z**2)):.3f}", flush=True)


if __name__ == "__main__":
    main()
