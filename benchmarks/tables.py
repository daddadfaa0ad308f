"""Cost and accuracy of a table of 9600 spectra of deep snow.

20 optical radii (30 to 2000 µm), 8 angles, 6 liquid water contents and 10 amounts of soot, each a
spectrum of 211 wavelengths to a standard error of 0.003, by discrete ordinates or by paths.  The
time per spectrum on one core is compared with single runs, TARTES and snowoptics, for similar snow.

plan     Estimated cost of 10⁶ and 10⁸ spectra.
axes     Number of nodes of each axis from which the others are interpolated within 0.005.
nodes    60 nodes compared with independent paths to 0.001: rms z and pooled mean difference.
between  200 random points between nodes compared with runs to 0.002 by the solver.

    python benchmarks/tables.py FOLDER [--solver auto] [--nodes 60] [--between 200] [--quick]

The table is kept in the folder, from which a second call continues.  With --quick, a table of
2 × 2 × 2 tests that the program runs; its times are not meaningful.
"""

import argparse
import resource
import time
from typing import Any

import numpy as np
import xarray as xr

import splits
from splits.core.validation import expand_path
from splits.tables.axes import ParameterGrid
from splits.tables.interpolation import compute_interpolation_weights

GRID: dict[str, Any] = {
    "optical_radius_um": np.geomspace(30.0, 2000.0, 20).round(1),
    "incidence_deg": [0.0, 25.0, 40.0, 50.0, 60.0, 70.0, 78.0, 85.0],
    "liquid_water_content": [0.0, 0.01, 0.02, 0.04, 0.07, 0.1],
    "soot_ng_g": [0.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0],
}
SMALL_GRID = {name: list(row)[:2] for name, row in GRID.items()}
WAVELENGTHS_NM = np.arange(400.0, 2501.0, 10.0)
MAX_STDERR = 0.003
NODE_STDERR = 0.001
"""Requested error of the paths with which nodes are compared."""
MIN_VALUE = 5.0
"""Smallest compared reflectance, in units of this error: paths stop on their own variance, and miss
rare light where nearly all of it is absorbed."""


def make_snow(soot_ng_g: float, **point: Any) -> splits.Snow:
    """Return the snow of a point."""
    impurities = {"black_carbon": soot_ng_g}
    return splits.Snow.natural(impurities_ng_g=impurities, **point)


def time_call(call: Any) -> tuple[Any, float, float]:
    """Return the result of a call, its wall time and its processor time (s)."""
    wall_begun, cpu_begun = time.perf_counter(), time.process_time()
    result = call()
    return result, time.perf_counter() - wall_begun, time.process_time() - cpu_begun


def report_z_scores(label: str, differences: list[np.ndarray], errors: list[np.ndarray]) -> None:
    """Print statistics of differences in units of their standard errors."""
    difference, error = np.concatenate(differences), np.concatenate(errors)
    z = difference / error
    weights = 1.0 / error**2
    pooled = float((weights * difference).sum() / weights.sum())
    # Wavelengths of a spectrum use the same rays, so each spectrum counts once.
    pooled_error = float(np.sqrt(weights.sum() * z.size / len(errors)) / weights.sum())
    print(
        f"{label}: {len(errors)}, rms z {np.sqrt((z**2).mean()):.3f}, pooled mean {pooled:+.5f} "
        f"± {pooled_error:.5f}; within one error {np.mean(np.abs(z) <= 1):.2f}, within two "
        f"{np.mean(np.abs(z) <= 2):.3f}; largest {np.abs(difference).max():.4f}",
        flush=True,
    )


def compare_nodes(table: xr.Dataset, grid: dict[str, Any], count: int) -> None:
    """Compare random nodes with independent runs."""
    random = np.random.default_rng(11)
    points = list(ParameterGrid.from_mapping(grid).iterate_points())
    differences, errors = [], []
    for number in random.choice(len(points), min(count, len(points)), replace=False):
        point = dict(points[number])
        node = table.sel(point)
        incidence = point.pop("incidence_deg")
        run = splits.spectrophotometer(
            make_snow(**point),
            WAVELENGTHS_NM,
            incidence,
            max_stderr=NODE_STDERR,
            seed=1000 + int(number),
            solver="monte_carlo",
        )
        is_compared = node.reflectance.values >= MIN_VALUE * NODE_STDERR
        differences.append((node.reflectance - run.reflectance).values[is_compared])
        error = np.hypot(node.reflectance_stderr, run.reflectance_stderr)
        errors.append(error.values[is_compared])
    report_z_scores(f"nodes, against independent paths to {NODE_STDERR}", differences, errors)


def compare_between_nodes(table: xr.Dataset, grid: dict[str, Any], count: int, solver: str) -> None:
    """Compare the table between its nodes with runs by a solver."""
    random, interpolator = np.random.default_rng(12), splits.Table(table)
    wavelengths = WAVELENGTHS_NM[::21]
    differences, errors, stated = [], [], []
    for number in range(count):
        point: dict[str, Any] = {}
        for name, row in grid.items():
            low, high = float(row[0]), float(row[-1])
            u = random.uniform()
            if name == "optical_radius_um":
                point[name] = float(np.exp(np.log(low) + u * np.log(high / low)))
            else:
                point[name] = low + (u**2 if name == "soot_ng_g" else u) * (high - low)
        interpolated = interpolator.interp(**point, wavelength=wavelengths)
        incidence = point.pop("incidence_deg")
        run = splits.spectrophotometer(
            make_snow(**point),
            wavelengths,
            incidence,
            max_stderr=0.002,
            seed=5000 + number,
            solver=solver,
        )
        differences.append((interpolated.reflectance - run.reflectance).values)
        errors.append(np.hypot(interpolated.reflectance_stderr, run.reflectance_stderr).values)
        stated.append(interpolated.reflectance_interpolation_error.values)
    report_z_scores("between nodes, against runs to 0.002", differences, errors)
    print(f"  stated interpolation error: mean {np.mean(stated):.4f}, largest {np.max(stated):.4f}")


def report_nodes_needed(table: xr.Dataset) -> None:
    """Print the number of nodes of each axis from which the others follow within 0.005."""
    dims = [str(d) for d in table.reflectance.dims]
    noise = float(table.reflectance_stderr.mean())
    for name in dims[:-1]:
        nodes = table[name].values
        values = np.moveaxis(table.reflectance.values.astype(float), dims.index(name), 0)
        for count in range(2, nodes.size):
            kept = np.unique(np.linspace(0, nodes.size - 1, count).round().astype(int))
            omitted = [i for i in range(nodes.size) if i not in kept]
            differences = []
            for i in omitted:
                w = compute_interpolation_weights(name, nodes[kept], float(nodes[i]))
                differences.append(np.tensordot(w.weights, values[kept][w.nodes], 1) - values[i])
            largest = float(np.abs(differences).max())
            rms = float(np.sqrt(np.mean(np.square(differences))))
            if largest <= 0.005 or count == nodes.size - 1:
                print(
                    f"{name}: {count} of {nodes.size} nodes give the others within "
                    f"{largest:.4f}, {rms:.4f} rms (mean standard error {noise:.4f})"
                )
                break


def report_plan_estimates(spectra: int, cpu_s: float) -> None:
    """Print the estimated cost of larger tables; the size is that of values and errors."""
    for n_spectra in (1e6, 1e8):
        hours = cpu_s / spectra * n_spectra / 3600.0
        size = 8.0 * WAVELENGTHS_NM.size * n_spectra
        print(
            f"{n_spectra:.0e} spectra: {hours:.3g} core-hours, {size / 1e9:.3g} GB of values and "
            "errors"
        )


def time_alternatives() -> None:
    """Print the time of a spectrum by other methods."""
    snow = make_snow(soot_ng_g=50.0, optical_radius_um=200.0)
    for solver in ("discrete_ordinates", "monte_carlo"):
        for error in (MAX_STDERR, 0.001):
            splits.spectrophotometer(
                snow, WAVELENGTHS_NM, 50.0, max_stderr=error, seed=1, threads=1, solver=solver
            )
            _, _, cpu_s = time_call(
                lambda e=error, s=solver: splits.spectrophotometer(
                    snow, WAVELENGTHS_NM, 50.0, max_stderr=e, seed=2, threads=1, solver=s
                )
            )
            print(f"single run by {solver} to {error}: {cpu_s:.3f} s of one core", flush=True)
    try:
        import tartes

        def tartes_spectrum() -> Any:
            return tartes.albedo(
                WAVELENGTHS_NM * 1e-9, [15.0], [300.0], [10.0], impurities=[50e-9],
                dir_frac=1.0, sza=50.0,
            )  # fmt: skip

        tartes_spectrum()
        _, _, cpu_s = time_call(lambda: [tartes_spectrum() for _ in range(100)])
        print(f"TARTES: {cpu_s / 100:.5f} s of one core")
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
        _, _, cpu_s = time_call(lambda: [theory() for _ in range(100)])
        print(f"snowoptics (Kokhanovsky and Zege): {cpu_s / 100:.5f} s of one core")
    except ImportError:
        print("snowoptics: not installed")


def main() -> None:
    """Build the table and print all parts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=expand_path, help="where the table is kept")
    solvers = ("auto", "discrete_ordinates", "monte_carlo")
    parser.add_argument("--solver", choices=solvers, default="auto")
    parser.add_argument("--nodes", type=int, default=60)
    parser.add_argument("--between", type=int, default=200)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    grid = SMALL_GRID if arguments.quick else GRID
    for water in (0.0, 0.1):
        # The first runs compile.
        splits.spectrophotometer(
            make_snow(0.0, optical_radius_um=100.0, liquid_water_content=water),
            [500.0, 1500.0], 10.0, max_stderr=0.05, solver="monte_carlo",
        )  # fmt: skip
    table, wall_s, cpu_s = time_call(
        lambda: splits.build_table(
            make_snow, grid, WAVELENGTHS_NM, max_stderr=MAX_STDERR, folder=arguments.folder,
            progress=True, solver=arguments.solver,
        ).dataset
    )  # fmt: skip
    count = ParameterGrid.from_mapping(grid).size
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"{count} spectra of {WAVELENGTHS_NM.size} wavelengths in {table.attrs['ensembles']} "
        f"ensembles, axes that share paths: {table.attrs['path_sharing_axes']}\n"
        f"{wall_s:.0f} s wall time, {cpu_s:.0f} s processor time, "
        f"{1e3 * cpu_s / count:.1f} ms of one core per spectrum, "
        f"largest error {table.attrs['max_stderr_reached']:.4f}, "
        f"{table.attrs['rays']} rays, peak memory {memory:.2f} GB",
        flush=True,
    )
    splits.save(table, arguments.folder / "table.nc")
    time_alternatives()
    report_plan_estimates(count, cpu_s)
    report_nodes_needed(table)
    compare_nodes(table, grid, arguments.nodes)
    compare_between_nodes(table, grid, arguments.between, arguments.solver)


if __name__ == "__main__":
    main()
