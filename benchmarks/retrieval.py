"""Retrievals of simulated spectra: coverage, bias, unconstrained parameters, and speed of maps.

    python benchmarks/retrieval.py FOLDER [--snows 1000] [--sands 300] [--pixels 500]

True values are sampled uniformly in the coordinates of the retrieval (the logarithm of a size, the
root of an amount) and simulated with independent random numbers, not interpolated in the table.
The measured spectra have noise of 1 % and 0.003, independent between wavelengths, and the
statistical error of their simulation, about 0.001; its covariance is input of the retrieval.
Tables and spectra are kept in FOLDER.  Twelve coverages are all within the printed bounds with a
probability of 99 % (Šidák).
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import binom

import splits
from splits.core.validation import expand_path
from splits.instruments.spectrophotometer import SpectralRequest, simulate_spectra
from splits.retrieval.forward_model import TableModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector
from splits.simulation.run_options import RunOptions
from splits.simulation.shared_paths import group_by_shared_paths
from splits.tables.interpolation import apply_axis_transform

SIZE, WATER, SOOT = "optical_radius_um", "liquid_water_content", "impurities_ng_g.black_carbon"
SNOW_WAVELENGTHS_NM = np.arange(400.0, 2401.0, 25.0)
SAND_WAVELENGTHS_NM = np.arange(400.0, 1001.0, 20.0)
ANGLES_DEG = [0.0, 45.0, 65.0]
SNOW_GRID: dict[str, Any] = {
    SIZE: np.geomspace(40.0, 1800.0, 10), "incidence_deg": ANGLES_DEG,
    WATER: [0.0, 0.01, 0.03, 0.06, 0.1, 0.15], SOOT: [0, 5, 20, 60, 150, 300, 500],
}  # fmt: skip
SNOW_TRUTH = {SIZE: (50.0, 1500.0), WATER: (0.0, 0.15), SOOT: (0.0, 500.0)}
SAND_GRID: dict[str, Any] = {
    "iron_oxide": [0.001, 0.003, 0.01, 0.02, 0.04], "hematite_ratio": [0.0, 0.1, 0.3, 0.6, 1.0],
    "saturation": [0.0, 0.1, 0.3, 0.6, 1.0],
}  # fmt: skip
SAND_TRUTH = {"iron_oxide": (0.001, 0.04), "hematite_ratio": (0.0, 1.0), "saturation": (0.0, 1.0)}
AXIS_SCALES = {
    SIZE: "logarithm", SOOT: "square_root", WATER: "square_root", "iron_oxide": "logarithm",
    "hematite_ratio": "square_root", "saturation": "square_root",
}  # fmt: skip
RELATIVE_NOISE, NOISE_FLOOR = 0.01, 0.003
INTERVAL_PROBABILITY = 0.99 ** (1.0 / 12.0)
"""Probability of each of twelve coverages to be within its bounds."""
TRUTH_STDERR = 0.001
"""Largest standard error of the simulation of a true spectrum."""


class SimulatedSpectra(NamedTuple):
    """Simulated spectra, and their deviations by batch of rays."""

    values: np.ndarray
    batches: np.ndarray


def make_snow(**settings: Any) -> splits.Snow:
    """Return deep natural snow."""
    soot = settings.pop(SOOT)
    return splits.Snow.natural(impurities_ng_g={"black_carbon": soot}, **settings)


def load_or_build_table(
    path: Path, make: Callable[..., Any], grid: dict[str, Any], wavelengths_nm: np.ndarray,
    error: float, incidence: float = 0.0,
) -> splits.Table:  # fmt: skip
    """Return a table from a file, which is built first if it does not exist."""
    if not path.exists():
        start = time.process_time()
        table = splits.build_table(
            make, grid, wavelengths_nm, incidence, max_stderr=error, covariance=True
        ).dataset
        splits.save(table, path)
        print(f"{path.name}: {time.process_time() - start:.0f} s of CPU", flush=True)
    return splits.Table(path)


def sample_truths(
    random: np.random.Generator, ranges: dict[str, Any], count: int
) -> dict[str, np.ndarray]:
    """Sample true values uniformly in the coordinates of the retrieval."""
    values = {}
    for name, (low, high) in ranges.items():
        ends = apply_axis_transform(AXIS_SCALES[name], np.array([low, high]))
        coordinates = ends[0] + random.random(count) * (ends[1] - ends[0])
        kind = AXIS_SCALES[name]
        values[name] = (
            np.exp(coordinates)
            if kind == "logarithm"
            else coordinates**2
            if kind == "square_root"
            else coordinates
        )
    return values


def load_or_simulate_spectra(
    path: Path, media: list[Any], wavelengths_nm: np.ndarray, incidence: float, seed: int
) -> SimulatedSpectra:
    """Return spectra of media from a file, or simulate them, with shared paths where possible."""
    if path.exists():
        kept = np.load(path)
        return SimulatedSpectra(kept["values"], kept["batches"])
    request = SpectralRequest(
        wavelengths_nm, incidence, TRUTH_STDERR, 20_000_000, RunOptions.start(seed)
    )
    values: list[Any] = [None] * len(media)
    batches: list[Any] = [None] * len(media)
    for group in group_by_shared_paths(media, wavelengths_nm):
        spectra = simulate_spectra(group.path_sharing, request)
        for position, medium_index in zip(group.positions, group.media_indices, strict=True):
            values[position] = spectra[medium_index].reflectance.values
            batches[position] = spectra[medium_index].reflectance_batches.values
    simulated = SimulatedSpectra(np.array(values), np.array(batches))
    np.savez(path, **simulated._asdict())
    return simulated


def report_coverage(label: str, names: list[str], results: list[Any], truths: np.ndarray) -> None:
    """Print coverage with binomial bounds, bias, and the unconstrained fraction by parameter."""
    n_spectra = len(results)
    quantiles = np.stack([one.dataset.quantiles.values for one in results])
    constrained = np.stack([one.dataset.constrained.values for one in results]).astype(bool)
    misfit = np.mean(
        [one.dataset.attrs["chi2"] / one.dataset.attrs["chi2_expected"] for one in results]
    )
    print(f"{label}: {n_spectra} spectra, chi2 {misfit:.2f} of 1 expected")
    for i, name in enumerate(names):
        truth = truths[:, i]
        # The rank of the true value in the posterior is uniform for any shape of the posterior.
        line = [f"  {name:32}"]
        for low, high, coverage in ((1, 3, 0.68), (0, 4, 0.95)):
            inside = (quantiles[:, low, i] <= truth) & (truth <= quantiles[:, high, i])
            bounds = (
                binom.ppf(
                    [0.5 - 0.5 * INTERVAL_PROBABILITY, 0.5 + 0.5 * INTERVAL_PROBABILITY],
                    n_spectra,
                    coverage,
                )
                / n_spectra
            )
            line.append(
                f"{inside.mean():.3f} within {coverage:.0%} ({bounds[0]:.3f} to {bounds[1]:.3f})"
            )
        ranks = np.array([(one.dataset.draws.values[:, i] < t).mean()
                          for one, t in zip(results, truth, strict=True)])  # fmt: skip
        rank_z = (ranks.mean() - 0.5) * np.sqrt(12.0 * n_spectra)
        line.append(
            f"mean rank deviates by {rank_z:+.1f} standard errors, "
            f"unconstrained {1 - constrained[:, i].mean():.2f}"
        )
        print(", ".join(line), flush=True)


def add_noise(
    random: np.random.Generator, spectrum: np.ndarray, batches: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a measured spectrum and the covariance of its noise."""
    noise = np.hypot(RELATIVE_NOISE * spectrum, NOISE_FLOOR)
    measured = spectrum + noise * random.standard_normal(spectrum.size)
    return measured, batches.T @ batches + np.diag(noise**2)


def retrieve_snow(folder: Path, table: splits.Table, count: int, n_waters: int = 3) -> None:
    """Retrieve size, water and soot of simulated snow at three angles of incidence."""
    random = np.random.default_rng(20)
    names, results, truths = [SIZE, WATER, SOOT], [], []
    n_per_angle = -(-count // (len(ANGLES_DEG) * n_waters))
    for number, angle in enumerate(np.repeat(ANGLES_DEG, n_waters)):
        truth = sample_truths(random, SNOW_TRUTH, n_per_angle)
        truth[WATER][:] = truth[WATER][0]
        media = [make_snow(**{n: float(truth[n][i]) for n in names}) for i in range(n_per_angle)]
        path = folder / f"snow_{n_per_angle}_{number}.npz"
        spectra = load_or_simulate_spectra(
            path, media, SNOW_WAVELENGTHS_NM, float(angle), 1000 + number
        )
        for i, pair in enumerate(zip(*spectra, strict=True)):
            measured, noise = add_noise(random, *pair)
            fixed = {"incidence_deg": float(angle)}
            results.append(
                splits.retrieve(
                    (SNOW_WAVELENGTHS_NM, measured), table, SNOW_TRUTH, noise, fixed=fixed
                )
            )
            truths.append([truth[n][i] for n in names])
    report_coverage("snow", names, results, np.array(truths))


def retrieve_sand(folder: Path, table: splits.Table, count: int) -> None:
    """Retrieve iron oxide, hematite and water of simulated sand."""
    random = np.random.default_rng(21)
    names, results = list(SAND_TRUTH), []
    truth = sample_truths(random, SAND_TRUTH, count)
    for i in range(count):
        sand = splits.Sand(**{n: float(truth[n][i]) for n in names})
        simulated = load_or_simulate_spectra(
            folder / f"sand_{count}_{i}.npz", [sand], SAND_WAVELENGTHS_NM, 0.0, 2000 + i
        )
        measured, noise = add_noise(random, simulated.values[0], simulated.batches[0])
        results.append(splits.retrieve((SAND_WAVELENGTHS_NM, measured), table, SAND_TRUTH, noise))
    report_coverage("sand", names, results, np.stack([truth[n] for n in names], axis=1))


def retrieve_maps(table: splits.Table, pixels: int) -> None:
    """Retrieve a map simulated with the table, with noise of 1 %."""
    random = np.random.default_rng(22)
    names, fixed = [SIZE, WATER, SOOT], {"incidence_deg": 45.0}
    measurement = Measurement.from_input(
        (SNOW_WAVELENGTHS_NM, np.full(SNOW_WAVELENGTHS_NM.size, 0.5)), RELATIVE_NOISE
    )
    model = TableModel(
        table,
        measurement,
        StateVector.from_ranges(SNOW_TRUTH, None, get_table_ranges(table)),
        fixed,
    )
    states = random.random((pixels * pixels, len(names)))
    truth = model.state_vector.to_physical(states)
    cube = model.evaluate(states) + RELATIVE_NOISE * random.standard_normal(
        (len(states), SNOW_WAVELENGTHS_NM.size)
    )
    image = xr.DataArray(cube.reshape(pixels, pixels, -1), {"wavelength": SNOW_WAVELENGTHS_NM},
                         ("y", "x", "wavelength"))  # fmt: skip
    splits.retrieve_map(image[:2], table, SNOW_TRUTH, RELATIVE_NOISE, fixed=fixed)
    start = time.perf_counter(), time.process_time()
    result = splits.retrieve_map(image, table, SNOW_TRUTH, RELATIVE_NOISE, fixed=fixed)
    clock, cpu = time.perf_counter() - start[0], time.process_time() - start[1]
    print(f"map of {pixels} by {pixels} pixels: {clock:.1f} s, {len(states) / cpu:.0f} spectra per "
          f"second of a core, flagged {(result.quality_flag.values > 0).mean():.3f}")  # fmt: skip
    for i, name in enumerate(names):
        stderr = result[f"{name}_stderr"].values.ravel()
        z = (result[name].values.ravel() - truth[:, i]) / stderr
        inside = (np.abs(z) < 1.0).mean()
        print(
            f"  {name}: within one standard error {inside:.3f}, median {np.median(z):+.3f}",
            flush=True,
        )


def main() -> None:
    """Build tables and print the results of retrievals."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=expand_path)
    parser.add_argument("--snows", type=int, default=1000)
    parser.add_argument("--sands", type=int, default=300)
    parser.add_argument("--pixels", type=int, default=500)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    if arguments.snows:
        snow_table = load_or_build_table(
            arguments.folder / "snow.nc", make_snow, SNOW_GRID, SNOW_WAVELENGTHS_NM, 0.002
        )
        retrieve_maps(snow_table, arguments.pixels)
        retrieve_snow(arguments.folder, snow_table, arguments.snows)
    if arguments.sands:
        sand_table = load_or_build_table(
            arguments.folder / "sand.nc", splits.Sand, SAND_GRID, SAND_WAVELENGTHS_NM, 0.002
        )
        retrieve_sand(arguments.folder, sand_table, arguments.sands)


if __name__ == "__main__":
    main()
