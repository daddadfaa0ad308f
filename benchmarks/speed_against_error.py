"""Time and error of every way to a spectrum: the papers' algorithm, weights, lanes, two theories.

One thread measures spectra of 211 wavelengths, 400-2500 nm, of four media in one run, after
warm-ups that compile every kernel used.  Methods (`splits.experiments.papers.performance.METHODS`):

papers_uniform      the papers' algorithm, absorption by coin toss, the same number of rays at
                    every wavelength, as many as the noisiest one needs: our reading of the papers,
                    which do not say how rays are shared among wavelengths
papers_adaptive     the same, but every wavelength stops by itself as soon as it has the error
one_by_one          weights instead of tosses, but still every wavelength with paths of its own
scalar              paths shared by all wavelengths, scalar kernel
lanes               the same with the lane kernel
discrete_ordinates  PythonicDISORT and
kz04                Kokhanovsky & Zege with the single-scattering properties of our own grains; for
                    orientation: their deviation is a difference of models

The first three are timed at every tenth wavelength and multiplied up to all.  The papers' algorithm
is run to the largest error and scaled to the others, time with 1/error²; for the first medium it is
also run to the smallest, to see how well that holds.  Its uniform form is never run: its time is
the time per ray at each wavelength, times the rays of the noisiest.

A reference of many more rays with another seed shows actual errors.  It is kept beside the table
as reference_*.nc until a source of the physics or the medium changes.

    python benchmarks/speed_against_error.py [TABLE.csv]

With --quick: 22 wavelengths, large errors, and a rough reference, to see that everything works;
its times are no result.
"""

# ruff: noqa: E402

from __future__ import annotations

import os

# Theories would solve their equations on all cores.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from method_table import MethodTable
from theories import THEORIES

import splits
from splits.core.paths import expand_path
from splits.experiments.papers import performance
from splits.experiments.papers.paper_tables import write_data_frame
from splits.experiments.papers.performance import (
    MEASURED,
    MEASURED_PARTLY,
    PAPER_ADAPTIVE,
    PAPER_UNIFORM,
    SCALED,
    VECTORIZED,
)
from splits.simulation.estimators import ANALOG_PILOT_RAYS

MEDIA = {
    "representative": splits.Snow(),
    "coarse wet": splits.Snow(grain_size_um=(900, 1000), saturation=0.3),
    "thin layer": splits.Snow(depth_m=0.02, grain_size_um=(100, 200), saturation=0),
    "smooth dry": splits.Snow(facetness=(0, 0, 0, 0), saturation=0),
}
SEED = 3
REFERENCE_SEED = 101
UNLIMITED_RAYS = 2**62
PHYSICS_FOLDERS = ("materials", "media", "kernels", "simulation", "instruments")


@dataclass(frozen=True)
class SpeedPlan:
    """How much to measure.

    Attributes
    ----------
    step_nm : int
    errors : tuple of float
        Largest standard errors asked for, in falling order.
    reference_stderr : float
    property_rays : int
        Rays per index node from which theories take single-scattering properties.
    repeats : int
        Runs of the methods that trace all wavelengths together, with other seeds.
    """

    step_nm: int = 10
    errors: tuple[float, ...] = (0.004, 0.002, 0.001)
    reference_stderr: float = 2e-4
    property_rays: int = 50_000
    n_repeats: int = 3

    @property
    def wavelengths(self) -> np.ndarray:
        """All wavelengths (nm)."""
        return np.arange(400.0, 2501.0, self.step_nm)

    @property
    def sparse_wavelengths(self) -> np.ndarray:
        """Every tenth of them."""
        return self.wavelengths[::10]


QUICK = SpeedPlan(100, (0.02, 0.01, 0.005), 0.002, 4_000, 1)


def time_call(
    function: Callable[..., xr.Dataset], *given: Any, **named: Any
) -> tuple[xr.Dataset, float]:
    """Return what a function returns and the time (s) it took."""
    begun = time.perf_counter()
    result = function(*given, **named)
    return result, time.perf_counter() - begun


def simulate_spectrum(
    medium: splits.Snow, wavelengths: Sequence[float] | np.ndarray, error: float, **named: Any
) -> xr.Dataset:
    """Return a spectrum that has reached an error, by default on one thread."""
    settings = {"threads": 1, "seed": SEED, "max_rays": UNLIMITED_RAYS} | named
    dataset = splits.spectrophotometer(medium, wavelengths, max_stderr=error, **settings)
    if dataset.attrs["stop_reason"] != "converged":
        raise RuntimeError(f"{error:g} was not reached")
    return dataset


def compute_source_digest(medium: splits.Snow) -> str:
    """Return a digest of everything that a reference depends on."""
    digest = hashlib.sha256(repr(medium.describe()).encode())
    package = Path(splits.__file__).parent
    for folder in PHYSICS_FOLDERS:
        for source in sorted((package / folder).rglob("*.py")):
            digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()


def load_or_compute_reference(
    name: str, medium: splits.Snow, plan: SpeedPlan, folder: Path
) -> xr.Dataset:
    """Return the reference spectrum of a medium, from a file if one is there that still holds."""
    slug = name.replace(" ", "_")
    path = folder / f"reference_{slug}_{plan.step_nm}nm_{plan.reference_stderr:g}.nc"
    wanted = compute_source_digest(medium)
    if path.exists():
        dataset = splits.load(path)
        if dataset.attrs.get("sources_sha256") == wanted:
            return dataset
    dataset = simulate_spectrum(
        medium,
        plan.wavelengths,
        plan.reference_stderr,
        kernel="vectorized",
        seed=REFERENCE_SEED,
        threads=None,
    )
    dataset.attrs["sources_sha256"] = wanted
    splits.save(dataset, path)
    return dataset


def warm_up(medium: splits.Snow, plan: SpeedPlan) -> None:
    """Compile whatever the methods need, by their first rounds."""
    for error in plan.errors:
        for kernel in ("scalar", "vectorized"):
            splits.spectrophotometer(
                medium, plan.wavelengths, max_stderr=error, kernel=kernel, max_rays=1, threads=1
            )
    simulate_spectrum(medium, [1500.0], 0.3, estimator="analog")


def simulate_one_by_one(
    medium: splits.Snow, wavelengths: np.ndarray, error: float, **named: Any
) -> tuple[xr.Dataset, np.ndarray, np.ndarray]:
    """Return the spectrum of separate runs per wavelength, their times (s) and rays."""
    # Seeds of their own, or all wavelengths would share their random numbers.
    runs = [
        time_call(simulate_spectrum, medium, [wavelength], error, seed=SEED + number, **named)
        for number, wavelength in enumerate(wavelengths)
    ]
    spectrum = xr.concat([dataset for dataset, _ in runs], "wavelength", combine_attrs="drop")
    rays = np.array([dataset.attrs["rays"] for dataset, _ in runs], dtype=float)
    return spectrum, np.array([seconds for _, seconds in runs]), rays


def time_papers(
    table: MethodTable, medium: splits.Snow, plan: SpeedPlan, include_smallest: bool
) -> None:
    """Add the papers' algorithm, run to the largest error, and to the smallest if `fully`."""
    scale = len(plan.wavelengths) / len(plan.sparse_wavelengths)
    first = plan.errors[0]
    spectrum, seconds, rays = simulate_one_by_one(
        medium, plan.sparse_wavelengths, first, estimator="analog"
    )
    add_papers(table, first, spectrum, seconds, rays, scale)
    stderr = compute_largest_stderr(spectrum)
    for error in plan.errors[1:]:
        uniform_s, uniform_rays, adaptive_s, adaptive_rays = performance.scale_paper_times(
            seconds, rays, stderr, error, ANALOG_PILOT_RAYS
        )
        for method, spent, count in (
            (PAPER_UNIFORM, uniform_s, uniform_rays),
            (PAPER_ADAPTIVE, adaptive_s, adaptive_rays),
        ):
            table.add(method, SCALED, scale * spent, scale * count, error, stderr_largest=error)
    if include_smallest:
        last = plan.errors[-1]
        add_papers(
            table,
            last,
            *simulate_one_by_one(medium, plan.sparse_wavelengths, last, estimator="analog"),
            scale,
        )


def add_papers(
    table: MethodTable,
    error: float,
    spectrum: xr.Dataset,
    seconds: np.ndarray,
    rays: np.ndarray,
    scale: float,
) -> None:
    """Add both forms of the papers' algorithm from runs that stopped by themselves."""
    shared = spectrum * xr.DataArray(np.sqrt(rays / rays.max()), dims="wavelength")
    table.add(
        PAPER_UNIFORM,
        MEASURED_PARTLY,
        scale * float((seconds / rays).sum() * rays.max()),
        scale * float(rays.max() * len(rays)),
        error,
        **performance.summarize_stated_errors(shared),
    )
    table.add(
        PAPER_ADAPTIVE,
        MEASURED_PARTLY,
        scale * seconds.sum(),
        scale * rays.sum(),
        error,
        [spectrum],
    )


def compute_largest_stderr(spectrum: xr.Dataset) -> np.ndarray:
    """Return the largest standard error of any quantity at every wavelength."""
    return np.max([spectrum[f"{name}_stderr"].values for name in performance.QUANTITIES], axis=0)


def time_weights(table: MethodTable, medium: splits.Snow, plan: SpeedPlan) -> None:
    """Add weights wavelength by wavelength, together, and together on lanes."""
    scale = len(plan.wavelengths) / len(plan.sparse_wavelengths)
    for error in plan.errors:
        spectrum, seconds, rays = simulate_one_by_one(
            medium, plan.sparse_wavelengths, error, kernel="scalar"
        )
        table.add(
            "one_by_one",
            MEASURED_PARTLY,
            scale * seconds.sum(),
            scale * rays.sum(),
            error,
            [spectrum],
        )
    for kernel in ("scalar", VECTORIZED):
        for error in plan.errors:
            runs = [
                time_call(
                    simulate_spectrum,
                    medium,
                    plan.wavelengths,
                    error,
                    kernel=kernel,
                    seed=SEED + number,
                )
                for number in range(plan.n_repeats)
            ]
            spent = float(np.median([seconds for _, seconds in runs]))
            spectra = [dataset for dataset, _ in runs]
            rays = float(np.mean([dataset.attrs["rays"] for dataset in spectra]))
            table.add(kernel, MEASURED, spent, rays, error, spectra)


def time_theories(table: MethodTable, medium: splits.Snow, plan: SpeedPlan) -> None:
    """Add both theories; their time contains the walks through single grains."""
    for method, theory in THEORIES.items():
        try:
            theory(medium, plan.sparse_wavelengths, 2)
        except ImportError as error:
            print(f"{method} left out: {error}", flush=True)
            continue
        spectrum, seconds = time_call(theory, medium, plan.wavelengths, plan.property_rays)
        table.add(method, MEASURED, seconds, plan.property_rays, spectra=[spectrum])


def measure_all(plan: SpeedPlan, media: Sequence[str], folder: Path) -> pd.DataFrame:
    """Measure, print and return the table of all media."""
    rows = []
    for name in media:
        medium = MEDIA[name]
        table = MethodTable(name, load_or_compute_reference(name, medium, plan, folder))
        warm_up(medium, plan)
        time_weights(table, medium, plan)
        time_papers(table, medium, plan, include_smallest=name == next(iter(MEDIA)))
        time_theories(table, medium, plan)
        rows += table.rows
    return performance.add_figures_of_merit(pd.DataFrame(rows))


def main() -> None:
    """Measure and print the table, and write it if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?", type=expand_path, help="CSV to write")
    parser.add_argument("--quick", action="store_true", help="a trial: coarse and rough")
    parser.add_argument("--medium", action="append", choices=MEDIA, help="these only")
    parser.add_argument(
        "--reference-stderr", type=float, help=f"default: {SpeedPlan.reference_stderr:g}"
    )
    given = parser.parse_args()
    plan = QUICK if given.quick else SpeedPlan()
    if given.reference_stderr:
        plan = replace(plan, reference_stderr=given.reference_stderr)
    media = given.medium or list(MEDIA)
    folder = given.table.parent if given.table else Path("results/benchmarks")
    table = measure_all(plan, media, folder)
    if given.table:
        write_data_frame(table, given.table)
    print("\none core; in brackets, times as a multiple of that of lanes:")
    for name in media:
        for error in plan.errors:
            print(performance.format_headline(table, name, error, len(plan.wavelengths)))
    merits = table[table.method.isin(("one_by_one", "scalar", VECTORIZED)) & table.error.notna()]
    print("\nfigures of merit, 1/(error² time), over those of the papers' algorithm:")
    for row in merits.itertuples():
        print(
            f"{row.medium}, {performance.METHODS[row.method]}, error {row.error:g}: "
            f"{row.figure_of_merit:.3g}/s, uniform {row.over_uniform:.3g}, "
            f"adaptive {row.over_adaptive:.3g}"
        )


if __name__ == "__main__":
    main()
