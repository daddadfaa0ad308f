"""Cost, size and errors of a table of natural snow with directions of observation.

Usage: python benchmarks/directional_table.py [CSV]

The table is that of the experiment ``snow_views``.  The default output is the table of
docs/how-to/one-view.md.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

import splits

OUTPUT = Path("docs/how-to/directional_table.csv")
GRID = {
    "optical_radius_um": np.geomspace(40.0, 1500.0, 10),
    "incidence_deg": np.arange(0.0, 71.0, 10.0),
    "polar_deg": np.arange(0.0, 73.0, 8.0),
    "azimuth_deg": np.arange(0.0, 181.0, 15.0),
}
WAVELENGTHS = np.linspace(400.0, 2500.0, 211)
MIN_VALUE = 0.02
"""Smallest reflectance factor whose relative error counts."""


def measure_file_size(table: xr.Dataset) -> int:
    """Return the size of the file of a table in bytes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.nc"
        splits.save(table, path)
        return path.stat().st_size


def compute_median_relative_error(table: xr.Dataset, name: str) -> float:
    """Return the median relative error of a quantity where the reflectance is not small."""
    relative = table[f"{name}_stderr"] / table[name]
    return float(relative.where(table.reflectance > MIN_VALUE).median())


def main(output: Path) -> None:
    """Build the table and write its cost."""
    start, processor = time.perf_counter(), time.process_time()
    table = splits.build_table(
        splits.Snow.natural, GRID, WAVELENGTHS, max_stderr=0.005, solver="discrete_ordinates"
    )
    wall_s, cpu_s = time.perf_counter() - start, time.process_time() - processor
    rows = {
        "reflectance factors": f"{table.reflectance_factor.size}",
        "time (s)": f"{wall_s:.0f}",
        "processor time (s)": f"{cpu_s:.0f}",
        "file (MB)": f"{measure_file_size(table) / 1e6:.1f}",
        "largest error of a reflectance factor": f"{table.reflectance_factor_stderr.max():.4f}",
    }
    for name in ("reflectance", "reflectance_factor", "anisotropy_factor"):
        label = (
            f"median relative error of {name.replace('_', ' ')}s where reflectance > {MIN_VALUE}"
        )
        rows[label] = f"{compute_median_relative_error(table, name):.5f}"
    frame = pd.DataFrame({"quantity": rows.keys(), "value": rows.values()})
    frame.to_csv(output, index=False)
    print(frame.to_string(index=False))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUTPUT)
