"""Processor time of every instrument at its default error, for a typical scene.

    python benchmarks/instrument_costs.py [TABLE.csv]

Each case runs twice: the first run, with large errors, compiles the kernels and is not measured.
The time is that of all threads, so that the table does not depend on their number.
The column `scene` describes the simulation, the column `error` the stopping criterion.
"""

import argparse
import inspect
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import pandas as pd

import splits
from splits.core.escaping import write_data_frame

SPECTRUM_NM = range(400, 2501, 10)
SKY = "midlatitude_winter"
PATHS = {"solver": "monte_carlo"}
DEPTHS_M = [0.01, 0.02, 0.05, 0.1, 0.2]
LARGE_ERRORS = {"max_stderr": 0.1, "relative_stderr": 0.5, "rays": 1000}
"""Accuracy of the first run, by keyword."""


class CostCase(NamedTuple):
    """An instrument, the keyword of its accuracy, a description of the scene, and the call."""

    instrument: str
    keyword: str
    scene: str
    run: Callable[..., Any]


def make_cases() -> list[CostCase]:
    """Return the cases, one for each row of the table."""
    deep = splits.Snow.natural(specific_surface_area_m2_kg=20)
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.5)
    sand, layer = splits.Sand(), splits.ParticleLayer()
    return [
        CostCase("spectrophotometer", "max_stderr", "snow, 211 wavelengths",
                 lambda **e: splits.spectrophotometer(snow, SPECTRUM_NM, **PATHS, **e)),
        CostCase("spectrophotometer", "max_stderr", "sand, 61 wavelengths",
                 lambda **e: splits.spectrophotometer(sand, range(400, 1001, 10), **e)),
        CostCase("spectrophotometer", "max_stderr", "particle layer under a rough surface",
                 lambda **e: splits.spectrophotometer(layer, [600], **e)),
        CostCase("albedo", "max_stderr", "snow under a winter sky",
                 lambda **e: splits.albedo(deep, SKY, **PATHS, **e)),
        CostCase("goniophotometer", "relative_stderr", "snow, one wavelength, 2592 directions",
                 lambda **e: splits.goniophotometer(snow, [865], 60.0, **PATHS, **e)),
        CostCase("hdrf", "relative_stderr", "snow under a winter sky, one wavelength",
                 lambda **e: splits.hdrf(snow, SKY, [865], **PATHS, **e)),
        CostCase("irradiance_profile", "max_stderr", "snow, five wavelengths, five depths",
                 lambda **e: splits.irradiance_profile(
                     snow, [450, 600, 850, 1000, 1300], DEPTHS_M, **PATHS, **e)),
        CostCase("radiation_profile", "max_stderr", "snow under a winter sky, five depths",
                 lambda **e: splits.radiation_profile(
                     deep, SKY, DEPTHS_M, total_w_m2=500.0, **PATHS, **e)),
        CostCase("beam_spread", "rays", "snow, one wavelength",
                 lambda **e: splits.beam_spread(snow, [800], **e)),
        CostCase("single_scattering", "rays", "grains of snow, one wavelength",
                 lambda **e: splits.single_scattering(snow, [800], **e)),
    ]  # fmt: skip


def measure(case: CostCase) -> dict[str, Any]:
    """Return the row of a case."""
    error = inspect.signature(getattr(splits, case.instrument)).parameters[case.keyword].default
    case.run(**{case.keyword: LARGE_ERRORS[case.keyword]})
    start = time.process_time()
    case.run()
    seconds = time.process_time() - start
    return {
        "instrument": f"`{case.instrument}`",
        "scene": case.scene,
        "error": f"`{case.keyword}={error}`",
        "processor time (s)": f"{seconds:.2g}" if seconds < 10.0 else f"{seconds:.0f}",
    }


def main() -> None:
    """Print the rows, and write the table if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?")
    arguments = parser.parse_args()
    rows = []
    for case in make_cases():
        rows.append(measure(case))
        print(*rows[-1].values(), sep="  ", flush=True)
    if arguments.table:
        write_data_frame(pd.DataFrame(rows), arguments.table)


if __name__ == "__main__":
    main()
