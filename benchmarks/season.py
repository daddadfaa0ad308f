"""Speed and memory of the spectra of a season of snowpacks, compared with one snowpack at a time.

A season of random layers is simulated by discrete ordinates: spectra under the sun, and the albedo
under a clear sky.  Results are compared with those of single snowpacks.  CPU times do not depend on
other programs that run at the same time.

    python benchmarks/season.py [--snowpacks 40] [--layers 20] [--wavelengths 211] [--wet 0.1]
"""

import argparse
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import splits

HOURS_PER_YEAR = 8760
RANGES = {
    "thickness_m": (0.01, 0.1), "density_kg_m3": (80.0, 450.0),
    "specific_surface_area_m2_kg": (8.0, 60.0), "temperature_c": (-20.0, 0.0),
    "impurities_ng_g.black_carbon": (0.0, 50.0),
}  # fmt: skip


def make_season(n_packs: int, n_layers: int, wet_fraction: float) -> splits.SnowPacks:
    """Return random snowpacks over ground of albedo 0.2; some have a wet top layer."""
    rng = np.random.default_rng(1)
    dims = ("time", "layer")
    values = {name: rng.uniform(*limits, (n_packs, n_layers)) for name, limits in RANGES.items()}
    values["liquid_water_content"] = np.zeros((n_packs, n_layers))
    values["liquid_water_content"][: round(wet_fraction * n_packs), 0] = 0.03
    times = pd.date_range("2024-02-01", periods=n_packs, freq="h")
    dataset = xr.Dataset({name: (dims, one) for name, one in values.items()}, {"time": times})
    zenith = rng.uniform(30.0, 89.0, n_packs)
    return splits.SnowPacks(dataset, ground=0.2).with_sun_zenith(zenith)


def measure(run: Callable[[], Any]) -> tuple[Any, float, float]:
    """Return the result of a function, with the elapsed and the CPU time (s)."""
    start, cpu = time.perf_counter(), time.process_time()
    result = run()
    return result, time.perf_counter() - start, time.process_time() - cpu


def read_peak_memory() -> float:
    """Return the largest memory of this process so far (MB)."""
    unit = 1e-6 if sys.platform == "darwin" else 1e-3
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def compare_one_by_one(
    packs: splits.SnowPacks, wavelengths: np.ndarray, result: xr.Dataset, number: int
) -> tuple[float, float]:
    """Return the CPU time per snowpack (s) and the largest difference for some single snowpacks."""
    chosen = np.unique(np.linspace(0, len(packs) - 1, number).astype(int))
    difference, start = 0.0, time.process_time()
    for position in chosen:
        label = packs.dataset.time.values[position]
        zenith = float(packs.dataset.sun_zenith_deg[position])
        stack = packs.make_stack(pd.Timestamp(label))
        one = splits.spectrophotometer(stack, wavelengths, zenith, solver="discrete_ordinates")
        gap = abs(one.reflectance.values - result.reflectance.values[position]).max()
        difference = max(difference, float(gap))
    return (time.process_time() - start) / chosen.size, difference


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--snowpacks", type=int, default=40)
    parser.add_argument("--layers", type=int, default=20)
    parser.add_argument("--wavelengths", type=int, default=211)
    parser.add_argument("--wet", type=float, default=0.1, help="fraction with a wet top layer")
    parser.add_argument("--threads", type=int, default=None)
    arguments = parser.parse_args()
    wavelengths = np.linspace(350.0, 2450.0, arguments.wavelengths)
    packs = make_season(arguments.snowpacks, arguments.layers, arguments.wet)
    # Tables and modules are loaded before the measurement.
    splits.spectrophotometer(make_season(2, 1, 0.5), [500.0, 600.0], "sun")
    loaded_mb = read_peak_memory()
    runs = {
        "spectra": lambda: splits.spectrophotometer(
            packs, wavelengths, "sun", threads=arguments.threads
        ),
        "albedo": lambda: splits.albedo(packs, "clear", wavelengths, threads=arguments.threads),
    }
    print(f"{packs}, {wavelengths.size} wavelengths")
    cpu_per_pack = {}
    for name, run in runs.items():
        result, seconds, cpu = measure(run)
        cpu_per_pack[name] = cpu / len(packs)
        print(
            f"{name}: {len(packs) / seconds:.1f} snowpacks/s, {cpu / len(packs):.4f} s of CPU per "
            f"snowpack; a year of hours: {HOURS_PER_YEAR * seconds / len(packs) / 60:.1f} min, "
            f"{HOURS_PER_YEAR * cpu / len(packs) / 60:.1f} min of CPU; "
            f"{result.attrs['streams']} streams"
        )
        if name == "spectra":
            spectra = result
    print(f"memory: {read_peak_memory():.0f} MB, of which {loaded_mb:.0f} MB before")
    single, difference = compare_one_by_one(packs, wavelengths, spectra, 10)
    ratio = single / cpu_per_pack["spectra"]
    print(f"one by one: {single:.4f} s of CPU per snowpack, {ratio:.1f} times as long")
    print(f"largest difference: {difference:.1e}")


if __name__ == "__main__":
    main()
