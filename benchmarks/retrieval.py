"""Retrievals of spectra whose truth is known: coverage, bias, what is not told; speed of maps.

    python benchmarks/retrieval.py FOLDER [--snows 1000] [--sands 300] [--pixels 500]

Truths are drawn evenly in the coordinates of the retrieval (the logarithm of a size, the root of
an amount) and simulated with random numbers of their own, not read from the table.  The measured
spectra have noise of 1 % and 0.003, independent between wavelengths, and are off by what their
own simulation is, some 0.001, whose covariance retrievals are told.  FOLDER keeps all of these.
Bounds are those that twelve shares stay within with a probability of 99 % (Šidák).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import binom

import splits
from splits.core.paths import expand_path
from splits.instruments.shared_spectra import simulate_spectra
from splits.instruments.spectral_run import SpectralRequest
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector
from splits.simulation.path_reuse import group_by_shared_paths
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
    SIZE: "logarithm", SOOT: "root", WATER: "root", "iron_oxide": "logarithm",
    "hematite_ratio": "root", "saturation": "root",
}  # fmt: skip
RELATIVE_NOISE, NOISE_FLOOR = 0.01, 0.003
INTERVAL_PROBABILITY = 0.99 ** (1.0 / 12.0)
"""Probability that chance keeps each of twelve shares within its bounds."""
TRUTH_STDERR = 0.001
"""What a truth's own simulation is off by at most."""


class SimulatedSpectra(NamedTuple):
    """Simulated spectra, and how far groups of their rays take them off."""

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
    """Return a table that a file keeps."""
    if not path.exists():
        begun = time.process_time()
        found = splits.build_table(
            make, grid, wavelengths_nm, incidence, max_stderr=error, covariance=True
        )
        splits.save(found, path)
        print(f"{path.name}: {time.process_time() - begun:.0f} s of CPU", flush=True)
    return splits.open_table(path)


def draw_truths(
    random: np.random.Generator, ranges: dict[str, Any], count: int
) -> dict[str, np.ndarray]:
    """Return truths, drawn evenly in coordinates."""
    found = {}
    for name, (low, high) in ranges.items():
        ends = apply_axis_transform(AXIS_SCALES[name], np.array([low, high]))
        at = ends[0] + random.random(count) * (ends[1] - ends[0])
        kind = AXIS_SCALES[name]
        found[name] = np.exp(at) if kind == "logarithm" else at**2 if kind == "root" else at
    return found


def load_or_simulate_spectra(
    path: Path, media: list[Any], wavelengths_nm: np.ndarray, incidence: float, seed: int
) -> SimulatedSpectra:
    """Return spectra of media, those that share paths from one ensemble; a file keeps them."""
    if path.exists():
        kept = np.load(path)
        return SimulatedSpectra(kept["values"], kept["groups"])
    run = SpectralRequest.from_arguments(
        wavelengths_nm, incidence, TRUTH_STDERR, seed, 20_000_000, None, "auto"
    )
    values: list[Any] = [None] * len(media)
    groups: list[Any] = [None] * len(media)
    for members in group_by_shared_paths(media, wavelengths_nm):
        spectra = simulate_spectra(members.path_sharing, run)
        for place, which in zip(members.positions, members.media_indices, strict=True):
            values[place] = spectra[which].reflectance.values
            groups[place] = spectra[which].reflectance_batches.values
    found = SimulatedSpectra(np.array(values), np.array(groups))
    np.savez(path, **found._asdict())
    return found


def report_coverage(label: str, names: list[str], results: list[Any], truths: np.ndarray) -> None:
    """Print coverage with binomial bounds, bias, and how often each was not told."""
    many = len(results)
    quantiles = np.stack([one.dataset.quantiles.values for one in results])
    told = np.stack([one.dataset.constrained.values for one in results]).astype(bool)
    misfit = np.mean(
        [one.dataset.attrs["chi2"] / one.dataset.attrs["chi2_expected"] for one in results]
    )
    print(f"{label}: {many} spectra, chi2 {misfit:.2f} of 1 expected")
    for i, name in enumerate(names):
        truth = truths[:, i]
        # The truth's rank in the posterior: its normal score is z, whatever the shape.
        line = [f"  {name:32}"]
        for low, high, share in ((1, 3, 0.68), (0, 4, 0.95)):
            inside = (quantiles[:, low, i] <= truth) & (truth <= quantiles[:, high, i])
            bounds = (
                binom.ppf(
                    [0.5 - 0.5 * INTERVAL_PROBABILITY, 0.5 + 0.5 * INTERVAL_PROBABILITY],
                    many,
                    share,
                )
                / many
            )
            line.append(
                f"{inside.mean():.3f} within {share:.0%} ({bounds[0]:.3f} to {bounds[1]:.3f})"
            )
        ranks = np.array([(one.dataset.draws.values[:, i] < t).mean()
                          for one, t in zip(results, truth, strict=True)])  # fmt: skip
        off = (ranks.mean() - 0.5) * np.sqrt(12.0 * many)
        line.append(
            f"mean rank off by {off:+.1f} of its errors, not told {1 - told[:, i].mean():.2f}"
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
    """Retrieve synthetic snow: size, water and soot, under three angles."""
    random = np.random.default_rng(20)
    names, found, truths = [SIZE, WATER, SOOT], [], []
    each = -(-count // (len(ANGLES_DEG) * n_waters))
    for number, angle in enumerate(np.repeat(ANGLES_DEG, n_waters)):
        truth = draw_truths(random, SNOW_TRUTH, each)
        truth[WATER][:] = truth[WATER][0]
        media = [make_snow(**{n: float(truth[n][i]) for n in names}) for i in range(each)]
        path = folder / f"snow_{each}_{number}.npz"
        spectra = load_or_simulate_spectra(
            path, media, SNOW_WAVELENGTHS_NM, float(angle), 1000 + number
        )
        for i, pair in enumerate(zip(*spectra, strict=True)):
            measured, noise = add_noise(random, *pair)
            at = {"incidence_deg": float(angle)}
            found.append(
                splits.retrieve((SNOW_WAVELENGTHS_NM, measured), table, SNOW_TRUTH, noise, fixed=at)
            )
            truths.append([truth[n][i] for n in names])
    report_coverage("snow", names, found, np.array(truths))


def retrieve_sand(folder: Path, table: splits.Table, count: int) -> None:
    """Retrieve synthetic sand: iron oxide, hematite, water."""
    random = np.random.default_rng(21)
    names, found = list(SAND_TRUTH), []
    truth = draw_truths(random, SAND_TRUTH, count)
    for i in range(count):
        sand = splits.Sand(**{n: float(truth[n][i]) for n in names})
        own = load_or_simulate_spectra(
            folder / f"sand_{count}_{i}.npz", [sand], SAND_WAVELENGTHS_NM, 0.0, 2000 + i
        )
        measured, noise = add_noise(random, own.values[0], own.batches[0])
        found.append(splits.retrieve((SAND_WAVELENGTHS_NM, measured), table, SAND_TRUTH, noise))
    report_coverage("sand", names, found, np.stack([truth[n] for n in names], axis=1))


def retrieve_maps(table: splits.Table, pixels: int) -> None:
    """Retrieve a map made from the table, with noise of 1 %."""
    random = np.random.default_rng(22)
    names, at = [SIZE, WATER, SOOT], {"incidence_deg": 45.0}
    plain = Measurement.from_input(
        (SNOW_WAVELENGTHS_NM, np.full(SNOW_WAVELENGTHS_NM.size, 0.5)), RELATIVE_NOISE
    )
    model = TableForwardModel(
        table, plain, StateVector.from_ranges(SNOW_TRUTH, None, get_table_ranges(table)), at
    )
    places = random.random((pixels * pixels, len(names)))
    truth = model.state_vector.to_physical(places)
    cube = model.evaluate(places) + RELATIVE_NOISE * random.standard_normal(
        (len(places), SNOW_WAVELENGTHS_NM.size)
    )
    image = xr.DataArray(cube.reshape(pixels, pixels, -1), {"wavelength": SNOW_WAVELENGTHS_NM},
                         ("y", "x", "wavelength"))  # fmt: skip
    splits.retrieve_map(image[:2], table, SNOW_TRUTH, RELATIVE_NOISE, fixed=at)
    begun = time.perf_counter(), time.process_time()
    found = splits.retrieve_map(image, table, SNOW_TRUTH, RELATIVE_NOISE, fixed=at)
    clock, cpu = time.perf_counter() - begun[0], time.process_time() - begun[1]
    print(f"map of {pixels} by {pixels} pixels: {clock:.1f} s, {len(places) / cpu:.0f} spectra per "
          f"second of a core, flagged {(found.flags.values > 0).mean():.3f}")  # fmt: skip
    for i, name in enumerate(names):
        stderr = found[f"{name}_stderr"].values.ravel()
        off = (found[name].values.ravel() - truth[:, i]) / stderr
        inside = (np.abs(off) < 1.0).mean()
        print(f"  {name}: within one error {inside:.3f}, median {np.median(off):+.3f}", flush=True)


def main() -> None:
    """Make tables, retrieve."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=expand_path)
    parser.add_argument("--snows", type=int, default=1000)
    parser.add_argument("--sands", type=int, default=300)
    parser.add_argument("--pixels", type=int, default=500)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    if given.snows:
        of_snow = load_or_build_table(
            given.folder / "snow.nc", make_snow, SNOW_GRID, SNOW_WAVELENGTHS_NM, 0.002
        )
        retrieve_maps(of_snow, given.pixels)
        retrieve_snow(given.folder, of_snow, given.snows)
    if given.sands:
        of_sand = load_or_build_table(
            given.folder / "sand.nc", splits.Sand, SAND_GRID, SAND_WAVELENGTHS_NM, 0.002
        )
        retrieve_sand(given.folder, of_sand, given.sands)


if __name__ == "__main__":
    main()
