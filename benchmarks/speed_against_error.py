"""Time and error of all methods for a spectrum: the papers' algorithm, weights, and two theories.

Spectra of 211 wavelengths, 400-2500 nm, of four media are computed on one thread in one run, after
warm-ups that compile all kernels.  Methods (`performance.METHODS`):

papers_uniform      the papers' algorithm with analog absorption and the same number of rays at
                    every wavelength, that of the noisiest one; this is an interpretation, because
                    the papers do not state the number of rays per wavelength
papers_adaptive     the same, but every wavelength stops when it reaches the error
one_by_one          weights instead of analog absorption, with separate paths for every wavelength
scalar              the same paths for all wavelengths, scalar kernel
vectorized          the same paths for all wavelengths, vectorized kernel
discrete_ordinates  with the single-scattering properties of the grains
kz04                Kokhanovsky & Zege with the single-scattering properties of the grains

The deviation of the two theories is a difference between models.  The first three methods are
timed at every tenth wavelength, and the times scaled to all.  The papers' algorithm is run to the
largest error, and its time scaled to the others with 1/error²; for the first medium it is also run
to the smallest error, to test this scaling.  Its uniform form is never run: its time is the time
per ray at each wavelength, times the rays of the noisiest.

Actual errors are deviations from a reference with many more rays and another seed.  It is kept
beside the table as reference_*.nc until a source of the physics or the medium changes.

    python benchmarks/speed_against_error.py [TABLE.csv]

With --short, one medium, larger errors and a reference that is accurate enough for these take less
than a minute.  With --quick, 22 wavelengths, large errors and a rough reference test that the
program runs; its times are not meaningful.
"""

# ruff: noqa: E402

import os

# The solvers of the theories would use all cores.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import hashlib
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import performance
import xarray as xr
from performance import (
    MEASURED,
    MEASURED_PARTLY,
    PAPER_ADAPTIVE,
    PAPER_UNIFORM,
    SCALED,
    VECTORIZED,
)

import splits
from splits.analysis.theory.spectra import (
    compute_shape_factors,
    correct_dense_packing,
    kz04,
    propagate_errors,
    solve_discrete_ordinates,
)
from splits.core.escaping import write_data_frame
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import expand_path
from splits.simulation.spectral_tally import ANALOG_PILOT_RAYS

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
    """Size of the benchmark.

    Attributes
    ----------
    step_nm : int
    errors : tuple of float
        Requested largest standard errors, decreasing.
    reference_stderr : float
    property_rays : int
        Rays per index node for the single-scattering properties.
    n_repeats : int
        Runs with other seeds of the methods that trace all wavelengths together.
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


SHORT = SpeedPlan(
    errors=(0.016, 0.008, 0.004), reference_stderr=0.001, property_rays=20_000, n_repeats=1
)
QUICK = SpeedPlan(100, (0.02, 0.01, 0.005), 0.002, 4_000, 1)


N_STREAMS = 32


def compute_discrete_ordinates(
    medium: splits.Snow, wavelengths: np.ndarray, rays: int
) -> xr.Dataset:
    """Return the spectrum by discrete ordinates, for the grains of the medium."""
    optics = splits.single_scattering(
        medium, wavelengths, moments=N_STREAMS, rays=rays, threads=1, wet_pores="equilibrium"
    )
    return solve_discrete_ordinates(correct_dense_packing(optics), streams=N_STREAMS)


def compute_kz04(medium: splits.Snow, wavelengths: np.ndarray, rays: int) -> xr.Dataset:
    """Return the spectrum by asymptotic theory, with B and g of the dry grains of the medium."""
    optics = splits.single_scattering(
        replace(medium, saturation=0.0), wavelengths, moments=1, rays=rays, threads=1
    )
    area = medium.specific_surface_area_m2_kg
    k = medium.refractive_index["ice"](wavelengths).imag

    def theory(properties: xr.Dataset) -> np.ndarray:
        enhancement, asymmetry = compute_shape_factors(properties, area, k)
        spectrum = kz04(
            wavelengths,
            area,
            extinction_coefficient=k,
            absorption_enhancement=enhancement,
            asymmetry=asymmetry,
            density_kg_m3=medium.density_kg_m3,
            depth_m=medium.depth_m,
        )
        reflectance, transmittance = spectrum.reflectance.values, spectrum.transmittance.values
        return np.stack([reflectance, transmittance, 1.0 - reflectance - transmittance])

    values, stderr = theory(optics), propagate_errors(theory, optics)
    variables: dict[str, Variable] = {}
    for row, name in enumerate(performance.QUANTITIES):
        variables |= make_variable(name, "wavelength", values[row], stderr[row], name)
    return xr.Dataset(variables, {"wavelength": wavelengths})


THEORIES = {"discrete_ordinates": compute_discrete_ordinates, "kz04": compute_kz04}


NUMBER_COLUMNS = (
    "stderr_largest",
    "stderr_rms",
    "deviation_rms",
    "deviation_largest",
    "deviation_z",
)


class MethodTable:
    """Rows of the result, printed when they are added.

    Parameters
    ----------
    medium : str
    reference : xarray.Dataset
    """

    def __init__(self, medium: str, reference: xr.Dataset) -> None:
        self.medium = medium
        self.reference = reference
        self.rows: list[dict[str, Any]] = []

    def add(
        self,
        method: str,
        source: str,
        seconds: float,
        rays: float,
        error: float = np.nan,
        spectra: Sequence[xr.Dataset] = (),
        **statistics: float,
    ) -> None:
        """Add a method, with the root mean square or maximum of each number over spectra."""
        statistics |= performance.combine_runs(
            [
                performance.compute_deviations(spectrum, self.reference)
                | performance.summarize_stated_errors(spectrum)
                for spectrum in spectra
            ]
        )
        row = {
            "medium": self.medium,
            "method": method,
            "how": source,
            "error": error,
            "seconds": seconds,
            "rays": round(rays),
            **{key: statistics.get(key, np.nan) for key in NUMBER_COLUMNS},
            "reference_stderr": float(
                performance.summarize_stated_errors(self.reference)["stderr_largest"]
            ),
            "wavelengths_traced": spectra[0].sizes["wavelength"] if spectra else 0,
        }
        self.rows.append(row)
        print(performance.format_row(row), flush=True)


def time_call(
    function: Callable[..., xr.Dataset], *positional: Any, **keywords: Any
) -> tuple[xr.Dataset, float]:
    """Return the result of a function and its time (s)."""
    start = time.perf_counter()
    result = function(*positional, **keywords)
    return result, time.perf_counter() - start


def simulate_spectrum(
    medium: splits.Snow, wavelengths: Sequence[float] | np.ndarray, error: float, **keywords: Any
) -> xr.Dataset:
    """Return a spectrum of a given error, by default on one thread."""
    settings = {"threads": 1, "seed": SEED, "max_rays": UNLIMITED_RAYS} | keywords
    dataset = splits.spectrophotometer(medium, wavelengths, max_stderr=error, **settings)
    if dataset.attrs["stop_reason"] != "converged":
        raise RuntimeError(f"error {error:g} was not reached")
    return dataset


def compute_source_digest(medium: splits.Snow) -> str:
    """Return a digest of the medium and the sources that a reference depends on."""
    digest = hashlib.sha256(repr(medium.describe()).encode())
    package = Path(splits.__file__).parent
    for folder in PHYSICS_FOLDERS:
        for source in sorted((package / folder).rglob("*.py")):
            digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()


def load_or_compute_reference(
    name: str, medium: splits.Snow, plan: SpeedPlan, folder: Path
) -> xr.Dataset:
    """Return the reference spectrum of a medium, from a file if that is up to date."""
    slug = name.replace(" ", "_")
    path = folder / f"reference_{slug}_{plan.step_nm}nm_{plan.reference_stderr:g}.nc"
    digest = compute_source_digest(medium)
    if path.exists():
        dataset = splits.load(path)
        if dataset.attrs.get("sources_sha256") == digest:
            return dataset
    dataset = simulate_spectrum(
        medium,
        plan.wavelengths,
        plan.reference_stderr,
        kernel="vectorized",
        seed=REFERENCE_SEED,
        threads=None,
    )
    dataset.attrs["sources_sha256"] = digest
    splits.save(dataset, path)
    return dataset


def warm_up(medium: splits.Snow, plan: SpeedPlan) -> None:
    """Compile the kernels of all methods."""
    with warnings.catch_warnings():
        # One ray does not reach the error.
        warnings.simplefilter("ignore", UserWarning)
        for error in plan.errors:
            for kernel in ("scalar", "vectorized"):
                splits.spectrophotometer(
                    medium, plan.wavelengths, max_stderr=error, kernel=kernel, max_rays=1, threads=1
                )
    simulate_spectrum(medium, [1500.0], 0.3, estimator="analog")


def simulate_one_by_one(
    medium: splits.Snow, wavelengths: np.ndarray, error: float, **keywords: Any
) -> tuple[xr.Dataset, np.ndarray, np.ndarray]:
    """Return the spectrum of separate runs per wavelength, their times (s) and rays."""
    # Different seeds, so that wavelengths have independent random numbers.
    runs = [
        time_call(simulate_spectrum, medium, [wavelength], error, seed=SEED + number, **keywords)
        for number, wavelength in enumerate(wavelengths)
    ]
    spectrum = xr.concat([dataset for dataset, _ in runs], "wavelength", combine_attrs="drop")
    rays = np.array([dataset.attrs["rays"] for dataset, _ in runs], dtype=float)
    return spectrum, np.array([seconds for _, seconds in runs]), rays


def time_papers(
    table: MethodTable, medium: splits.Snow, plan: SpeedPlan, include_smallest: bool
) -> None:
    """Add the papers' algorithm, run to the largest and, if wanted, to the smallest error."""
    scale = len(plan.wavelengths) / len(plan.sparse_wavelengths)
    largest = plan.errors[0]
    spectrum, seconds, rays = simulate_one_by_one(
        medium, plan.sparse_wavelengths, largest, estimator="analog"
    )
    add_papers(table, largest, spectrum, seconds, rays, scale)
    stderr = compute_largest_stderr(spectrum)
    for error in plan.errors[1:]:
        uniform_s, uniform_rays, adaptive_s, adaptive_rays = performance.scale_paper_times(
            seconds, rays, stderr, error, ANALOG_PILOT_RAYS
        )
        for method, total_s, count in (
            (PAPER_UNIFORM, uniform_s, uniform_rays),
            (PAPER_ADAPTIVE, adaptive_s, adaptive_rays),
        ):
            table.add(method, SCALED, scale * total_s, scale * count, error, stderr_largest=error)
    if include_smallest:
        smallest = plan.errors[-1]
        add_papers(
            table,
            smallest,
            *simulate_one_by_one(medium, plan.sparse_wavelengths, smallest, estimator="analog"),
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
    """Add both forms of the papers' algorithm from runs that stopped at each wavelength."""
    uniform_spectrum = spectrum * xr.DataArray(np.sqrt(rays / rays.max()), dims="wavelength")
    table.add(
        PAPER_UNIFORM,
        MEASURED_PARTLY,
        scale * float((seconds / rays).sum() * rays.max()),
        scale * float(rays.max() * len(rays)),
        error,
        **performance.summarize_stated_errors(uniform_spectrum),
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
    """Add weights for single wavelengths, and for all with the scalar and vectorized kernel."""
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
            time_s = float(np.median([seconds for _, seconds in runs]))
            spectra = [dataset for dataset, _ in runs]
            rays = float(np.mean([dataset.attrs["rays"] for dataset in spectra]))
            table.add(kernel, MEASURED, time_s, rays, error, spectra)


def time_theories(table: MethodTable, medium: splits.Snow, plan: SpeedPlan) -> None:
    """Add both theories; their time includes that of the single-scattering properties."""
    for method, theory in THEORIES.items():
        try:
            theory(medium, plan.sparse_wavelengths, 2)
        except ImportError as error:
            print(f"{method} skipped: {error}", flush=True)
            continue
        spectrum, seconds = time_call(theory, medium, plan.wavelengths, plan.property_rays)
        table.add(method, MEASURED, seconds, plan.property_rays, spectra=[spectrum])


def measure_all(plan: SpeedPlan, media: Sequence[str], folder: Path) -> pd.DataFrame:
    """Compute, print and return the table of all media."""
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
    """Print the table, and write it if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?", type=expand_path, help="CSV to write")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--short", action="store_true", help="one medium, larger errors")
    size.add_argument("--quick", action="store_true", help="test run: few wavelengths")
    parser.add_argument("--medium", action="append", choices=MEDIA, help="only these media")
    parser.add_argument(
        "--reference-stderr", type=float, help=f"default: {SpeedPlan.reference_stderr:g}"
    )
    arguments = parser.parse_args()
    plan = SHORT if arguments.short else QUICK if arguments.quick else SpeedPlan()
    if arguments.reference_stderr:
        plan = replace(plan, reference_stderr=arguments.reference_stderr)
    media = arguments.medium or list(MEDIA)[: 1 if arguments.short else None]
    folder = arguments.table.parent if arguments.table else Path("results/benchmarks")
    table = measure_all(plan, media, folder)
    if arguments.table:
        write_data_frame(table, arguments.table)
    print("\none core; in brackets, times relative to the vectorized kernel:")
    for name in media:
        for error in plan.errors:
            print(performance.format_headline(table, name, error, len(plan.wavelengths)))
    merits = table[table.method.isin(("one_by_one", "scalar", VECTORIZED)) & table.error.notna()]
    print("\nfigures of merit, 1/(error² time), relative to those of the papers' algorithm:")
    for row in merits.itertuples():
        print(
            f"{row.medium}, {performance.METHODS[row.method]}, error {row.error:g}: "
            f"{row.figure_of_merit:.3g}/s, uniform {row.over_uniform:.3g}, "
            f"adaptive {row.over_adaptive:.3g}"
        )


if __name__ == "__main__":
    main()
