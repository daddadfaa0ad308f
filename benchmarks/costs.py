"""Costs of instruments, of irradiance profiles, of a season of snow and of a directional table.

python benchmarks/costs.py {instruments,planes,profile_errors,season,view_table}
    [--table TABLE.csv]
"""

import inspect
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from command import run_command

import splits
from splits.instruments.flux_tally import FluxTarget
from splits.instruments.irradiance_profile import simulate_flux
from splits.simulation.run_options import RunOptions

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
                     snow, [450, 600, 850, 1000, 1300], depth_m=DEPTHS_M, **PATHS, **e)),
        CostCase("radiation_profile", "max_stderr", "snow under a winter sky, five depths",
                 lambda **e: splits.radiation_profile(
                     deep, SKY, depth_m=DEPTHS_M, total_w_m2=500.0, **PATHS, **e)),
        CostCase("beam_spread", "rays", "snow, one wavelength",
                 lambda **e: splits.beam_spread(snow, [800], **e)),
        CostCase("single_scattering", "rays", "grains of snow, one wavelength",
                 lambda **e: splits.single_scattering(snow, [800], **e)),
    ]  # fmt: skip


def instruments() -> Iterator[dict[str, Any]]:
    """Processor time of every instrument at its default error, for a typical scene.

    Each case runs twice: the first run, with large errors, compiles the kernels and is not
    measured.  The time is that of all threads, so that the table does not depend on their number.
    `scene` describes the simulation, `error` the stopping criterion.
    """
    for case in make_cases():
        parameters = inspect.signature(getattr(splits, case.instrument)).parameters
        case.run(**{case.keyword: LARGE_ERRORS[case.keyword]})
        start = time.process_time()
        case.run()
        seconds = time.process_time() - start
        yield {
            "instrument": f"`{case.instrument}`",
            "scene": case.scene,
            "error": f"`{case.keyword}={parameters[case.keyword].default}`",
            "processor time (s)": f"{seconds:.2g}" if seconds < 10.0 else f"{seconds:.0f}",
        }


WAVELENGTHS_NM = np.arange(400.0, 2501.0, 10.0)
LARGE_ERROR = 0.5
LAYERS = [
    (0.03, 45, 120),
    (0.05, 35, 180),
    (0.10, 25, 250),
    (0.15, 15, 320),
    (0.20, 10, 380),
]
"""Thickness (m), specific surface area (m²/kg) and density (kg/m³) of five layers of snow."""
TOTAL_W_M2 = 500.0


def planes(numbers: tuple[int, ...] = (10, 50), rounds: int = 20) -> Iterator[dict[str, Any]]:
    """Time per ray of irradiance profiles by number of planes, relative to the spectrum alone."""
    snow = splits.Snow()

    def spectrum(seed: int) -> xr.Dataset:
        return splits.spectrophotometer(
            snow, WAVELENGTHS_NM, max_stderr=LARGE_ERROR, seed=seed, threads=1, solver="monte_carlo"
        )

    def make_profile_run(planes: int) -> Callable[[int], xr.Dataset]:
        depths = snow.depth_m * np.arange(1, planes + 1) / (planes + 1)
        return lambda seed: splits.irradiance_profile(
            snow,
            WAVELENGTHS_NM,
            depth_m=depths,
            max_stderr=LARGE_ERROR,
            seed=seed,
            threads=1,
            solver="monte_carlo",
        )

    runs = {"spectrum": spectrum, **{f"{n} planes": make_profile_run(n) for n in numbers}}
    for run in runs.values():
        run(0)
    seconds, rays = (dict.fromkeys(runs, 0.0) for _ in range(2))
    for seed in range(1, rounds + 1):
        for name, run in runs.items():
            start = time.process_time()
            rays[name] += run(seed).attrs["rays"]
            seconds[name] += time.process_time() - start
    base = seconds["spectrum"] / rays["spectrum"]
    for name, time_s in seconds.items():
        per_ray = time_s / rays[name]
        yield {"run": name, "us_per_ray": 1e6 * per_ray, "of_the_spectrum": per_ray / base}


def profile_errors(
    errors: tuple[float, ...] = (0.05, 0.02), seeds: int = 4
) -> Iterator[dict[str, Any]]:
    """Cost and errors of absorbed power and irradiance (W m⁻²) in a snowpack, by target.

    The errors include the interpolation bound; the scatter is that between seeds.  `few_minus_many`
    is the difference of the few index nodes of the first target to the many of the last.
    """
    layers = [
        splits.Snow.natural(depth_m=d, specific_surface_area_m2_kg=s, density_kg_m3=r)
        for d, s, r in LAYERS
    ]
    snowpack = splits.Stack(layers, ground=0.2)
    sky = splits.sky("midlatitude_winter").scale_to(TOTAL_W_M2)
    w = np.arange(305.0, 2496.0, 10.0)
    weights = sky.compute_weights(w, sky.make_bands(None)["broadband"])
    plane_depths = np.cumsum([d for d, *_ in LAYERS])[:-1]
    band_weights = weights / weights.sum()

    def run(target: FluxTarget, error: float, seed: int) -> xr.Dataset:
        return simulate_flux(
            snowpack, w, plane_depths, sky.zenith_deg, error, 10**8, target,
            RunOptions.start(seed, 1), **PATHS,
        )  # fmt: skip

    irradiance = FluxTarget(True, band_weights[np.newaxis])
    absorbed_power = FluxTarget(False, band_weights[np.newaxis])
    targets = {
        "irradiance by wavelength": (FluxTarget(), 1.0),
        "irradiance in the band": (irradiance, 1.0),
        "absorbed power in the band": (absorbed_power, 1.0),
        "absorbed power, to a tenth": (absorbed_power, 0.1),
    }
    by_wavelength = xr.DataArray(weights, {"wavelength": w}, ("wavelength",))
    rows: list[dict[str, Any]] = []
    for error in errors:
        for kind, (target, factor) in targets.items():
            start = time.process_time()
            runs = [run(target, factor * error, seed) for seed in range(seeds)]
            seconds = (time.process_time() - start) / seeds
            for name, i_plane in (("absorptance", 0), ("downward_irradiance", 1)):
                parts = [dataset.errors.split(name, by_wavelength) for dataset in runs]
                scatter, bound = np.sqrt(np.mean(np.square(parts)[..., i_plane], axis=0))
                values = [
                    float((by_wavelength * dataset[name][:, i_plane]).sum()) for dataset in runs
                ]
                rows.append({
                    "target": kind, "error": error, "seconds": seconds, "quantity": name,
                    "mean": np.mean(values), "stderr": np.hypot(scatter, bound), "bound": bound,
                    "scatter_of_seeds": np.std(values, ddof=1),
                })  # fmt: skip
    many = rows[-2]
    for row in rows:
        if row["target"] == next(iter(targets)) and row["quantity"] == "absorptance":
            row["few_minus_many"] = row["mean"] - many["mean"]
            row["its_stderr"] = (
                np.hypot(row["scatter_of_seeds"], many["scatter_of_seeds"]) / seeds**0.5
            )
        yield row


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


def season(
    snowpacks: int = 40,
    layers: int = 20,
    wavelengths: int = 211,
    wet: float = 0.1,
    threads: int = 0,
) -> Iterator[dict[str, Any]]:
    """Speed and memory of a season of snowpacks, compared with one snowpack at a time.

    Random layers, a fraction of which is wet, are solved by discrete ordinates: spectra under the
    sun, and the albedo under a clear sky.  CPU times do not depend on other programs that run at
    the same time.
    """
    grid = np.linspace(350.0, 2450.0, wavelengths)
    packs = make_season(snowpacks, layers, wet)
    # Tables and modules are loaded before the measurement.
    splits.spectrophotometer(make_season(2, 1, 0.5), [500.0, 600.0], "sun")
    loaded_mb = read_peak_memory()
    runs = {
        "spectra": lambda: splits.spectrophotometer(packs, grid, "sun", threads=threads or None),
        "albedo": lambda: splits.albedo(packs, "clear", grid, threads=threads or None),
    }
    results = {}
    for name, simulate in runs.items():
        start, cpu_start = time.perf_counter(), time.process_time()
        results[name] = simulate()
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu_start
        yield {
            "run": name, "snowpacks_per_s": len(packs) / seconds, "cpu_s": cpu / len(packs),
            "minutes_per_year": HOURS_PER_YEAR * seconds / len(packs) / 60,
            "streams": results[name].attrs["streams"], "memory_mb": read_peak_memory(),
            "loaded_mb": loaded_mb,
        }  # fmt: skip
    single, difference = compare_one_by_one(packs, grid, results["spectra"], 10)
    yield {"run": "spectra, one by one", "cpu_s": single, "largest_difference": difference}


VIEW_GRID = {
    "optical_radius_um": np.geomspace(40.0, 1500.0, 10),
    "incidence_deg": np.arange(0.0, 71.0, 10.0),
    "polar_deg": np.arange(0.0, 73.0, 8.0),
    "azimuth_deg": np.arange(0.0, 181.0, 15.0),
}
MIN_REFLECTANCE = 0.02
"""Smallest reflectance factor whose relative error counts."""


def view_table() -> Iterator[dict[str, Any]]:
    """Cost, size and errors of a table of natural snow with directions of observation.

    The table is that of the experiment ``snow_views``; docs/how-to/one-view.md shows the result.
    """
    start, cpu_start = time.perf_counter(), time.process_time()
    table = splits.build_table(
        splits.Snow.natural, VIEW_GRID, np.linspace(400.0, 2500.0, 211), max_stderr=0.005,
        solver="discrete_ordinates",
    ).dataset  # fmt: skip
    seconds, cpu_s = time.perf_counter() - start, time.process_time() - cpu_start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.nc"
        splits.save(table, path)
        size_mb = path.stat().st_size / 1e6
    rows = {
        "reflectance factors": f"{table.reflectance_factor.size}",
        "time (s)": f"{seconds:.0f}",
        "processor time (s)": f"{cpu_s:.0f}",
        "file (MB)": f"{size_mb:.1f}",
        "largest error of a reflectance factor": f"{table.reflectance_factor_stderr.max():.4f}",
    }
    for name in ("reflectance", "reflectance_factor", "anisotropy_factor"):
        relative = table[f"{name}_stderr"] / table[name]
        median = float(relative.where(table.reflectance > MIN_REFLECTANCE).median())
        label = f"median relative error of {name.replace('_', ' ')}s"
        rows[f"{label} where reflectance > {MIN_REFLECTANCE}"] = f"{median:.5f}"
    yield from ({"quantity": quantity, "value": value} for quantity, value in rows.items())


if __name__ == "__main__":
    run_command(instruments, planes, profile_errors, season, view_table)
