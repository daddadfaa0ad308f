"""Path lengths and range biases of returned light.

Four tables, each a file in the folder:

lidar_slabs.csv      clear slabs: mean path of reflected and of all light over twice the depth, for
                     diffuse light and beams, above a black ground and one that reflects all light
lidar_speed.csv      clear slabs in diffuse light: part of the path in ice, mean refractive index
                     along the path, the mean by volume, and the ratios of index and of delay
lidar_range.csv      range bias of deep snow within 20 ns, by specific surface area and density
lidar_grains.csv     range bias for spheres and natural grains of 98 µm at 400 kg/m³, and the bias
                     for straight paths through grains and a refractive index averaged by volume

    python benchmarks/lidar_returns.py [FOLDER] [--rays 100000] [--threads 2]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import splits
from splits.instruments.delay_record import SPEED_OF_LIGHT
from splits.instruments.slowness import compute_slowness

CLEAR_INDEX = 1.31
CLEAR = {"ice": CLEAR_INDEX}
RECORD_S = 20e-9
LIDAR_NM = (532.0, 1064.0)
SPHERES = {"facetness": (0.0, 0.0, 0.0, 0.1), "sphericity": (1.0, 1.0, 1.0, 0.1)}
Settings = dict[str, Any]


def average_sides(slab: xr.Dataset, name: str) -> tuple[float, float]:
    """Return the mean of a quantity over all light of a clear slab, and its standard error."""
    fraction, value = slab.fraction.values, np.nan_to_num(slab[name].values)
    error = np.nan_to_num(slab[f"{name}_stderr"].values)
    # The fractions of both sides add up to 1.
    exchange = (value[0] - value[1]) * slab.fraction_stderr.values[0]
    stderr = math.hypot(*(fraction * error), exchange)
    return float(fraction @ value), stderr


def compute_transport_length(snow: Any) -> float:
    """Return the mean free path (m) after which light has lost its direction."""
    grains = splits.single_scattering(snow, LIDAR_NM[0], rays=200_000)
    return 1.0 / (snow.extinction_per_m * (1.0 - grains.asymmetry_parameter.item()))


def trace_slabs(settings: Settings) -> Iterator[dict[str, Any]]:
    """Yield the mean paths of light in clear slabs at the speed of light in vacuum and in ice."""
    properties = {"specific_surface_area_m2_kg": 20.0, "density_kg_m3": 300.0}
    for depth in (0.02, 0.1):
        for light in ("diffuse", 0.0, 60.0):
            for ground in (0.0, 1.0):
                snow = splits.Snow.natural(
                    **properties, depth_m=depth, ground=ground, refractive_index=CLEAR
                )
                slab = splits.time_of_flight(
                    snow, LIDAR_NM[0], light, **settings, delay_s=[0.0, 1e-10], end_s=math.inf
                ).squeeze()
                slab = slab.assign(path=slab.path_length.sum("material"))
                errors = (slab.path_length_stderr**2).sum("material") ** 0.5
                slab = slab.assign(path_stderr=errors)
                reflected = slab.sel(side="reflected")
                every, stderr = average_sides(slab, "path")
                yield {
                    "depth_mm": 1e3 * depth,
                    "transport_lengths": depth / compute_transport_length(snow),
                    "light": light if light == "diffuse" else f"{light:.0f}°",
                    "ground": ground,
                    "reflected": reflected.fraction.item(),
                    "path_reflected": reflected.path.item() / (2.0 * depth),
                    "stderr_reflected": reflected.path_stderr.item() / (2.0 * depth),
                    "path_all": every / (2.0 * depth),
                    "stderr_all": stderr / (2.0 * depth),
                    "delay_all": average_sides(slab, "mean_delay")[0]
                    * SPEED_OF_LIGHT / (2.0 * depth),
                }  # fmt: skip


def trace_speeds(settings: Settings) -> Iterator[dict[str, Any]]:
    """Yield the part of the path in ice, and the mean refractive indices along it and by volume."""
    for density in (100.0, 200.0, 300.0, 400.0, 500.0, 600.0):
        snow = splits.Snow.natural(
            specific_surface_area_m2_kg=20.0, density_kg_m3=density, depth_m=0.02,
            refractive_index=CLEAR,
        )  # fmt: skip
        slab = splits.time_of_flight(
            snow, LIDAR_NM[0], "diffuse", **settings, delay_s=[0.0, 1e-10], end_s=math.inf
        ).squeeze()
        ice_slab = slab.assign(
            {f"ice{s}": slab[f"path_length{s}"].sel(material="ice") for s in ("", "_stderr")}
        )
        ice, stderr = average_sides(ice_slab, "ice")
        path = float((slab.fraction * slab.path_length.sum("material")).sum())
        delay = average_sides(slab, "mean_delay")[0]
        volume = 1.0 - snow.porosity
        index, mean_index = delay * SPEED_OF_LIGHT / path, 1.0 + (CLEAR_INDEX - 1.0) * volume
        squared = volume * CLEAR_INDEX**2
        yield {
            "density_kg_m3": density, "ice_by_volume": volume, "ice_of_path": ice / path,
            "stderr": stderr / path, "ice_by_squared_index": squared / (squared + 1.0 - volume),
            "index_of_path": index, "index_by_volume": mean_index,
            "index_ratio": index / mean_index,
            "delay_ratio": delay * SPEED_OF_LIGHT / 0.04 / mean_index,
        }  # fmt: skip


def trace_deep_snow(wavelengths: Any, settings: Settings, **properties: Any) -> xr.Dataset:
    """Return the light that deep snow reflects within the record."""
    snow = splits.Snow.natural(**properties, depth_m=math.inf)
    light = splits.time_of_flight(snow, wavelengths, **settings, delay_s=[0.0, RECORD_S])
    return light.sel(side="reflected")


def trace_ranges(settings: Settings) -> Iterator[dict[str, Any]]:
    """Yield range biases (mm) by specific surface area and density."""
    for area in (5.0, 10.0, 20.0, 40.0, 80.0):
        for density in (150.0, 350.0, 550.0):
            properties = {"specific_surface_area_m2_kg": area, "density_kg_m3": density}
            light = trace_deep_snow(LIDAR_NM, settings, **properties)
            row = dict(properties)
            for wavelength in LIDAR_NM:
                one = light.sel(wavelength=wavelength)
                row[f"bias_{wavelength:.0f}nm_mm"] = convert_to_range(one.mean_delay.item())
                row[f"stderr_{wavelength:.0f}nm"] = convert_to_range(one.mean_delay_stderr.item())
            yield row


def trace_grains(settings: Settings) -> Iterator[dict[str, Any]]:
    """Yield range biases (mm) of two shapes, also for straight paths and an index by volume."""
    for wavelength in LIDAR_NM:
        for grains, shape in (("natural", {}), ("spheres", SPHERES)):
            properties = {"optical_radius_um": 98.0, "density_kg_m3": 400.0, **shape}
            light = trace_deep_snow([wavelength], settings, **properties).squeeze()
            snow = splits.Snow.natural(**properties)
            slowness = compute_slowness(snow, np.array([wavelength]))
            per_path = slowness.value[0] / slowness.path_fractions
            pores = snow.porosity
            straight = light.path_length.sel(material="air").item() / pores
            index = pores * per_path[0] + (1.0 - pores) * per_path[len(light.material) - 1]
            yield {
                "wavelength_nm": wavelength, "grains": grains, "fraction": light.fraction.item(),
                "fraction_stderr": light.fraction_stderr.item(),
                "bias_mm": convert_to_range(light.mean_delay.item()),
                "bias_stderr": convert_to_range(light.mean_delay_stderr.item()),
                "bias_straight_mm": convert_to_range(straight * index),
            }  # fmt: skip


def convert_to_range(delay_s: float) -> float:
    """Return the apparent depth (mm) of a delay."""
    return 0.5e3 * SPEED_OF_LIGHT * delay_s


TABLES = {
    "lidar_slabs": trace_slabs, "lidar_speed": trace_speeds, "lidar_range": trace_ranges,
    "lidar_grains": trace_grains,
}  # fmt: skip


def main() -> None:
    """Print the tables, and write them if a folder is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", help="folder of the CSV files")
    parser.add_argument("--rays", type=int, default=100_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--tables", nargs="+", choices=list(TABLES), default=list(TABLES))
    arguments = parser.parse_args()
    settings = {"rays": arguments.rays, "threads": arguments.threads}
    for name in arguments.tables:
        table = pd.DataFrame(list(TABLES[name](settings)))
        print(f"{name}\n{table.to_string(index=False, float_format='%.4f')}\n")
        if arguments.folder:
            path = Path(arguments.folder) / f"{name}.csv"
            table.to_csv(path, index=False, float_format="%.4g", lineterminator="\n")


if __name__ == "__main__":
    main()
