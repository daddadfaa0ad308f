"""CPU time and error of every way to a spectrum of natural snow, on one core in one run.

Spectra of 211 wavelengths, 400-2500 nm, of two snowpacks under a beam of 53°:

ordinates      `splits.spectrophotometer(..., solver="discrete_ordinates")`, to three errors
paths          the same with solver="monte_carlo", to three errors
table          `splits.Table.interp` in a table of the half-space over grain size, by ordinates
PythonicDISORT discrete ordinates of another package, with the same grains
TARTES         two streams, with the shape of the grains of `splits.Snow.natural`
snowoptics     asymptotic theory (Kokhanovsky & Zege 2004), for a half-space

Deviations are from discrete ordinates with 64 streams.  Those of TARTES and snowoptics are
differences of models.  For point grains of snow of Table 1 and of sand, the first call of discrete
ordinates traces paths through single grains, and the next ones read the result of the first.

    python benchmarks/solvers.py [TABLE.csv [FIGURE.png]]
"""

# ruff: noqa: E402

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import PythonicDISORT
import snowoptics
import tartes
import xarray as xr
from matplotlib.figure import Figure

import splits
from splits.discrete_ordinates import grains
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.media.snow import NATURAL_GRAIN_SHAPE
from splits.plotting.grammar import (
    TWO_COLUMNS_INCHES,
    annotate_figure,
    make_subplots,
    pick_colours,
    use_style,
)
from splits.plotting.lines import place_legend_above

WAVELENGTHS_NM = np.arange(400.0, 2501.0, 10.0)
TRACED_WAVELENGTHS_NM = np.arange(400.0, 1501.0, 10.0)
INCIDENCE_DEG = 53.0
COSINES = np.array([np.cos(np.radians(INCIDENCE_DEG))])
SOIL_ALBEDO = 0.2
SNOWPACKS = {
    "half-space": splits.Stack([splits.Snow.natural(specific_surface_area_m2_kg=20)]),
    "three layers on soil": splits.Stack(
        [
            splits.Snow.natural(
                specific_surface_area_m2_kg=area, density_kg_m3=density, depth_m=depth
            )
            for area, density, depth in ((45, 120, 0.03), (25, 250, 0.1), (12, 350, 0.2))
        ],
        ground=SOIL_ALBEDO,
    ),
}
PATH_ERRORS = (0.004, 0.002, 0.001)
N_REPEATS = 5
REFERENCE_STREAMS = 64
TABLE_RADII_UM = np.geomspace(30.0, 1000.0, 12)
MARKERS = {
    "ordinates": "o", "paths": "s", "table": "^", "PythonicDISORT": "D", "TARTES": "v",
    "snowoptics": "P",
}  # fmt: skip
OTHER_MODELS = ("TARTES", "snowoptics")


def time_call(function: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """Return the result of a function, and the shortest CPU time of some calls (s)."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        result = function()
        times.append(time.process_time() - start)
    return result, min(times)


def list_ways(medium: splits.Stack) -> Iterator[tuple[str, str, Callable[[], Any], int]]:
    """Yield the name, the setting, the function and the repeats of every way."""

    def simulate(**settings: object) -> xr.Dataset:
        return splits.spectrophotometer(
            medium, WAVELENGTHS_NM, INCIDENCE_DEG, threads=1, **settings
        )

    for error in (0.002, 1e-4, 1e-5):
        yield "ordinates", f"error {error:g}", lambda error=error: simulate(
            max_stderr=error, solver="discrete_ordinates"
        ), N_REPEATS  # fmt: skip
    for error in PATH_ERRORS:
        yield "paths", f"error {error:g}", lambda error=error: simulate(
            max_stderr=error, solver="monte_carlo"
        ), 1  # fmt: skip
    for streams in (8, 16):
        yield "PythonicDISORT", f"{streams} streams", lambda streams=streams: solve_pydisort(
            medium, streams
        ), 1  # fmt: skip
    if medium.is_semi_infinite:
        yield "table", "12 sizes", make_table_look_up(), N_REPEATS
    yield "TARTES", "two streams", lambda: solve_tartes(medium), N_REPEATS
    if medium.is_semi_infinite:
        yield "snowoptics", "asymptotic", solve_snowoptics, N_REPEATS


def make_table_look_up() -> Callable[[], xr.Dataset]:
    """Return a function that interpolates the spectrum of the half-space in a table."""
    grid = {"optical_radius_um": TABLE_RADII_UM}
    table = splits.build_table(
            splits.Snow.natural, grid, WAVELENGTHS_NM, INCIDENCE_DEG, threads=1,
            solver="discrete_ordinates",
        )  # fmt: skip
    (snow,) = SNOWPACKS["half-space"].layers
    return lambda: table.interp(optical_radius_um=snow.optical_radius_um)


def solve_pydisort(medium: splits.Stack, streams: int) -> np.ndarray:
    """Return the albedo by PythonicDISORT, with the same single scattering."""
    snowpack = make_granular_stack(medium, WAVELENGTHS_NM)
    optics = [one.compute_optics(streams + 1)
              for one in snowpack.layers]  # fmt: skip
    albedo = []
    for row, ground in enumerate(snowpack.ground):
        extinction = np.array([one.extinction[row, 0] for one in optics])
        depth = np.array([min(float(one.thickness[row]), 1e3) for one in optics])
        scattering = np.array([one.scattering[row, 0, 0] for one in optics])
        moments = scattering / scattering[:, :1]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _, up, *_ = PythonicDISORT.pydisort(
                np.cumsum(extinction * depth), np.minimum(scattering[:, 0] / extinction, 1 - 1e-9),
                streams, moments, COSINES[0], 1.0 / COSINES[0], 0.0, only_flux=True,
                f_arr=np.maximum(moments[:, streams], 0.0),
                BDRF_Fourier_modes=[ground] if ground else [],
            )  # fmt: skip
        albedo.append(float(up(0.0)))
    return np.array(albedo)


def solve_tartes(medium: splits.Stack) -> np.ndarray:
    """Return the albedo of TARTES, with the B and g of the grains."""
    shape, layers = NATURAL_GRAIN_SHAPE, medium.layers
    return tartes.albedo(
        WAVELENGTHS_NM * 1e-9,
        SSA=[one.specific_surface_area_m2_kg for one in layers],
        density=[one.density_kg_m3 for one in layers],
        thickness=[min(one.depth_m, 1e3) for one in layers],
        shape_parameterization="constant", B0=shape.absorption_enhancement,
        g0=0.5 * (1.0 + shape.asymmetry_parameter), refrac_index="p2016",
        soilalbedo=0.0 if medium.is_semi_infinite else SOIL_ALBEDO,
        dir_frac=1.0, sza=INCIDENCE_DEG,
    )  # fmt: skip


def solve_snowoptics() -> np.ndarray:
    """Return the albedo of a half-space of 20 m²/kg by asymptotic theory."""
    shape = NATURAL_GRAIN_SHAPE
    return snowoptics.albedo_KZ04(
        WAVELENGTHS_NM * 1e-9, np.radians(INCIDENCE_DEG), 20.0, r_difftot=0.0, ni="p2016",
        B=shape.absorption_enhancement, g=0.5 * (1.0 + shape.asymmetry_parameter),
    )  # fmt: skip


def measure_ways() -> pd.DataFrame:
    """Return one row for each snowpack and way, with its time and deviations."""
    rows = []
    for name, medium in SNOWPACKS.items():
        reference = make_granular_stack(medium, WAVELENGTHS_NM).solve(COSINES, REFERENCE_STREAMS)
        expected = reference.reflectance[:, 0]
        for way, setting, function, repeats in list_ways(medium):
            function()
            result, seconds = time_call(function, repeats)
            stated, albedo = np.nan, result
            if isinstance(result, xr.Dataset):
                albedo, stated = result.reflectance.values, float(result.reflectance_stderr.max())
            difference = np.abs(albedo - expected)
            rows.append({
                "snowpack": name, "way": way, "setting": setting, "milliseconds": 1e3 * seconds,
                "stderr_largest": stated,
                "deviation_rms": np.sqrt((difference**2).mean()),
                "deviation_largest": difference.max(),
            })  # fmt: skip
    return pd.DataFrame(rows)


def draw_ways(table: pd.DataFrame) -> Figure:
    """Draw the largest deviation against time; open markers are other models of snow."""
    with use_style():
        # Other media have times only.
        table = table[table.deviation_largest.notna()]
        names = list(dict.fromkeys(table.snowpack))
        figure, panels = make_subplots(
            1, len(names), width=TWO_COLUMNS_INCHES, height=2.9, sharex=True, sharey=True
        )
        colours = dict(zip(MARKERS, pick_colours(len(MARKERS), "sample"), strict=True))
        for name, axes in zip(names, panels, strict=True):
            for way, marker in MARKERS.items():
                rows = table[(table.snowpack == name) & (table.way == way)]
                axes.plot(
                    rows.milliseconds, rows.deviation_largest, marker, color=colours[way], ls="-",
                    lw=1.0, ms=5, mfc="white" if way in OTHER_MODELS else colours[way], label=way,
                )  # fmt: skip
            axes.set(title=name, xscale="log", yscale="log", xlabel="time on one core (ms)")
            axes.grid(which="major", alpha=0.3)
        panels[0].set_ylabel("largest deviation of the reflectance")
        place_legend_above(figure, panels[0].get_legend_handles_labels()[0], None)
        return annotate_figure(figure, panels, "Open markers: other models of snow.")


def measure_traced_grains() -> pd.DataFrame:
    """Return one row for each medium of other grains and way, with its CPU time."""
    points = "radiative_transfer"
    media = {
        "snow of Table 1": splits.Snow(saturation=0.0, interpretation=points),
        "sand": splits.Sand(depth_m=0.01, interpretation=points),
    }
    rows = []
    for name, medium in media.items():

        def simulate(solver: str, error: float = 0.002, medium: object = medium) -> np.ndarray:
            return splits.spectrophotometer(
                medium,
                TRACED_WAVELENGTHS_NM,
                INCIDENCE_DEG,
                max_stderr=error,
                threads=1,
                solver=solver,
            ).reflectance.values

        with tempfile.TemporaryDirectory() as folder:
            # Loads the kernels before times are taken.
            simulate("discrete_ordinates", 0.1), simulate("monte_carlo", 0.1)
            grains.find_cache_folder = lambda folder=folder: Path(folder)
            for way, solver, repeats in (
                ("ordinates, first call", "discrete_ordinates", 1),
                ("ordinates, next calls", "discrete_ordinates", N_REPEATS),
                ("paths", "monte_carlo", 1),
            ):
                _, seconds = time_call(lambda solver=solver: simulate(solver), repeats)
                rows.append({
                    "snowpack": name, "way": way, "setting": "error 0.002",
                    "milliseconds": 1e3 * seconds,
                })  # fmt: skip
    return pd.DataFrame(rows)


def main() -> None:
    """Print the table, and write it and its figure if files are given."""
    parser = argparse.ArgumentParser(description="Time and error of every way to a spectrum.")
    parser.add_argument("table", nargs="?", help="CSV file")
    parser.add_argument("figure", nargs="?", help="PNG file")
    arguments = parser.parse_args()
    table = pd.concat([measure_ways(), measure_traced_grains()])
    print(table.to_string(index=False, float_format="%.3g"))
    if arguments.table:
        table.to_csv(arguments.table, index=False, float_format="%.4g")
    if arguments.figure:
        figure = draw_ways(table)
        figure.savefig(arguments.figure, dpi=200, metadata={"Software": None})


if __name__ == "__main__":
    main()
