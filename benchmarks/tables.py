"""A table of 19 200 spectra of deep snow: what it costs, and whether its cells are right.

20 optical radii (30 to 2000 µm), 8 angles, 6 liquid waters, 10 amounts of soot, 2 grounds, each a
spectrum of 211 wavelengths to a standard error of 0.003.  Beside it stand single runs, TARTES and
snowoptics, each for the same snow where it knows it, per spectrum and on one core.

nodes    How many of an axis tell the others to 0.005.
plan     What a million and a hundred million spectra would take, and how well a tenth tells it.
cells    60 of them against runs of their own to 0.001 with other seeds: rms z and pooled mean.
between  200 random points between the nodes against runs of their own to 0.002.

    python benchmarks/tables.py FOLDER [--cells 60] [--between 200] [--quick]

The folder keeps the table: a second call goes on from there.  With --quick, a table of 2 × 2 × 2,
to see that everything works; its times are no result.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import splits
from splits.core.paths import expand_path
from splits.tables.axes import ParameterGrid
from splits.tables.interpolation import compute_interpolation_weights

GRID: dict[str, Any] = {
    "optical_radius_um": np.geomspace(30.0, 2000.0, 20).round(1),
    "incidence_deg": [0.0, 25.0, 40.0, 50.0, 60.0, 70.0, 78.0, 85.0],
    "liquid_water_content": [0.0, 0.01, 0.02, 0.04, 0.07, 0.1],
    "soot_ng_g": [0.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0],
    "ground": [0.2, 0.6],
}
SMALL_GRID = {name: list(row)[:2] for name, row in GRID.items()}
WAVELENGTHS_NM = np.arange(400.0, 2501.0, 10.0)
MAX_STDERR = 0.003


def make_snow(soot_ng_g: float, **point: Any) -> splits.Snow:
    """Return the snow of a point."""
    return splits.Snow.natural(impurities_ng_g={"black_carbon": soot_ng_g}, **point)


def time_call(call: Any) -> tuple[Any, float, float]:
    """Return what a call returns, its time on the clock and that of all cores (s)."""
    begun, used = time.perf_counter(), time.process_time()
    result = call()
    return result, time.perf_counter() - begun, time.process_time() - used


def report_z_scores(label: str, found: list[np.ndarray], errors: list[np.ndarray]) -> None:
    """Print how far differences lie from 0, in units of their errors."""
    off, error = np.array(found), np.array(errors)
    z = off / error
    weights = 1.0 / error**2
    pooled = float((weights * off).sum() / weights.sum())
    # Wavelengths of a cell share their rays: each cell counts as one.
    own = float(np.sqrt((weights**2 * error**2).sum() * off.shape[1]) / weights.sum())
    print(
        f"{label}: {len(z)}, rms z {np.sqrt((z**2).mean()):.3f}, pooled mean {pooled:+.5f} "
        f"± {own:.5f}; within one error {np.mean(np.abs(z) <= 1):.2f}, within two "
        f"{np.mean(np.abs(z) <= 2):.3f}; largest {np.abs(off).max():.4f}",
        flush=True,
    )


def compare_nodes(table: xr.Dataset, grid: dict[str, Any], count: int) -> None:
    """Compare random cells with runs of their own."""
    random = np.random.default_rng(11)
    points = list(ParameterGrid.from_mapping(grid).iterate_points())
    off, errors = [], []
    for number in random.choice(len(points), min(count, len(points)), replace=False):
        point = dict(points[number])
        cell = table.sel(point)
        incidence = point.pop("incidence_deg")
        own = splits.spectrophotometer(
            make_snow(**point), WAVELENGTHS_NM, incidence, 0.001, 1000 + int(number)
        )
        off.append((cell.reflectance - own.reflectance).values)
        errors.append(np.hypot(cell.reflectance_stderr, own.reflectance_stderr).values)
    report_z_scores("cells against runs of their own to 0.001", off, errors)


def compare_between_nodes(table: xr.Dataset, grid: dict[str, Any], count: int) -> None:
    """Compare the table between its nodes with runs there."""
    random, opened = np.random.default_rng(12), splits.Table(table)
    some = WAVELENGTHS_NM[::21]
    off, errors, missed = [], [], []
    for number in range(count):
        point: dict[str, Any] = {}
        for name, row in grid.items():
            low, high = float(row[0]), float(row[-1])
            u = random.uniform()
            if name == "optical_radius_um":
                point[name] = float(np.exp(np.log(low) + u * np.log(high / low)))
            else:
                point[name] = low + (u**2 if name == "soot_ng_g" else u) * (high - low)
        read = opened.interp(**point, wavelength=some)
        incidence = point.pop("incidence_deg")
        own = splits.spectrophotometer(make_snow(**point), some, incidence, 0.002, 5000 + number)
        off.append((read.reflectance - own.reflectance).values)
        errors.append(np.hypot(read.reflectance_stderr, own.reflectance_stderr).values)
        missed.append(read.reflectance_interpolation_error.values)
    report_z_scores("between nodes, against runs to 0.002", off, errors)
    print(
        f"  error of interpolation said: mean {np.mean(missed):.4f}, largest {np.max(missed):.4f}"
    )


def report_nodes_needed(table: xr.Dataset) -> None:
    """Print how many nodes of an axis tell the others to 0.005, and to what the error is then."""
    dims = [str(d) for d in table.reflectance.dims]
    noise = float(table.reflectance_stderr.mean())
    for name in dims[:-1]:
        nodes = table[name].values
        values = np.moveaxis(table.reflectance.values.astype(float), dims.index(name), 0)
        for count in range(2, nodes.size):
            kept = np.unique(np.linspace(0, nodes.size - 1, count).round().astype(int))
            left = [i for i in range(nodes.size) if i not in kept]
            off = []
            for i in left:
                w = compute_interpolation_weights(name, nodes[kept], float(nodes[i]))
                off.append(np.tensordot(w.weights, values[kept][w.nodes], 1) - values[i])
            worst = float(np.abs(off).max())
            rms = float(np.sqrt(np.mean(np.square(off))))
            if worst <= 0.005 or count == nodes.size - 1:
                print(
                    f"{name}: {count} of {nodes.size} nodes tell the others to {worst:.4f} at "
                    f"worst, {rms:.4f} rms (cells scatter by {noise:.4f})"
                )
                break


def report_plan_estimates(folder: Path, spectra: int, used: float) -> None:
    """Print what larger tables of this kind would take, and how well a tenth tells the whole.

    The time of an ensemble goes with the angles, waters and densities that it does not serve; its
    bytes are those of values and errors.
    """
    times = np.array(
        [float(splits.load(path).attrs["wall_time_s"]) for path in folder.glob("block_*.nc")]
    )
    random, count = np.random.default_rng(13), max(1, round(0.1 * times.size))
    tenths = [random.choice(times, count, replace=False).mean() * times.size for _ in range(1000)]
    off = np.std(tenths) / times.sum()
    print(
        f"an ensemble takes {times.mean():.1f} s of two cores, {times.min():.1f} to "
        f"{times.max():.1f}; {count} of {times.size}, taken at random, foretell the whole to "
        f"{100.0 * off:.0f} %"
    )
    for wanted in (1e6, 1e8):
        hours = used / spectra * wanted / 3600.0
        size = 8.0 * WAVELENGTHS_NM.size * wanted
        blocks = times.size / spectra * wanted
        print(
            f"{wanted:.0e} spectra: {hours:.3g} core-hours, {blocks:.3g} files of blocks, "
            f"{size / 1e9:.3g} GB of values and errors"
        )


def time_alternatives() -> None:
    """Print what a spectrum costs by other ways."""
    snow = make_snow(soot_ng_g=50.0, optical_radius_um=200.0)
    for error in (MAX_STDERR, 0.001):
        splits.spectrophotometer(snow, WAVELENGTHS_NM, 50.0, error, 1, threads=1)
        _, _, used = time_call(
            lambda e=error: splits.spectrophotometer(snow, WAVELENGTHS_NM, 50.0, e, 2, threads=1)
        )
        print(f"a run of its own to {error}: {used:.2f} s of one core", flush=True)
    try:
        import tartes

        def tartes_spectrum() -> Any:
            return tartes.albedo(
                WAVELENGTHS_NM * 1e-9, [15.0], [300.0], [10.0], impurities=[50e-9],
                dir_frac=1.0, sza=50.0,
            )  # fmt: skip

        tartes_spectrum()
        _, _, used = time_call(lambda: [tartes_spectrum() for _ in range(100)])
        print(f"TARTES: {used / 100:.5f} s of one core")
    except ImportError:
        print("TARTES: not installed")
    try:
        import snowoptics

        def theory() -> Any:
            sza, area = np.radians(50.0), 3.0 / (917.0 * 200e-6)
            return snowoptics.albedo_KZ04(
                WAVELENGTHS_NM * 1e-9, sza, area, impurities={"BC": 50e-9}
            )

        theory()
        _, _, used = time_call(lambda: [theory() for _ in range(100)])
        print(f"snowoptics (Kokhanovsky and Zege): {used / 100:.5f} s of one core")
    except ImportError:
        print("snowoptics: not installed")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=expand_path, help="keeps the table")
    parser.add_argument("--cells", type=int, default=60)
    parser.add_argument("--between", type=int, default=200)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    grid = SMALL_GRID if given.quick else GRID
    for water in (0.0, 0.1):
        # Kernels compiled.
        splits.spectrophotometer(
            make_snow(0.0, optical_radius_um=100.0, liquid_water_content=water),
            [500.0, 1500.0], 10.0, 0.05,
        )  # fmt: skip
    table, wall, used = time_call(
        lambda: splits.build_table(
            make_snow, grid, WAVELENGTHS_NM, max_stderr=MAX_STDERR, folder=given.folder,
            progress=True,
        )
    )  # fmt: skip
    count = ParameterGrid.from_mapping(grid).size
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"{count} spectra of {WAVELENGTHS_NM.size} wavelengths in {table.attrs['ensembles']} "
        f"ensembles, axes that share paths: {table.attrs['path_sharing_axes']}\n"
        f"{wall:.0f} s on the clock, {used:.0f} s of all cores, {1e3 * used / count:.1f} ms of one "
        f"core per spectrum, largest error {table.attrs['max_stderr_reached']:.4f}, "
        f"{table.attrs['rays']} rays, peak memory {memory:.2f} GB",
        flush=True,
    )
    splits.save(table, given.folder / "table.nc")
    time_alternatives()
    report_plan_estimates(given.folder, count, used)
    report_nodes_needed(table)
    compare_nodes(table, grid, given.cells)
    compare_between_nodes(table, grid, given.between)


if __name__ == "__main__":
    main()
