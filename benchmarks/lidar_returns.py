"""Path lengths and range biases of returned light.

Four tables, each a file in the folder:

lidar_slabs.csv      clear slabs: mean path of reflected and of all light over twice the depth, for
                     diffuse light and beams, above a black ground and one that reflects all light
lidar_speed.csv      clear slabs in diffuse light: part of the path in ice, mean refractive index
                     along the path, the mean by volume, and the ratios of index and of delay
lidar_range.csv      range bias of deep snow within 20 ns, by specific surface area and density
lidar_grains.csv     range bias for spheres and natural grains of 98 µm at 400 kg/m³, also for
                     straight paths through grains and a refractive index averaged by volume,
                     in addition for isotropic scattering, and in addition as sampled by the model
                     of Smith et al. (2025), with the coefficients of that model, too

    python benchmarks/lidar_returns.py [FOLDER] [--rays 100000] [--threads 2]
"""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

import splits
from splits.instruments.delay_record import SPEED_OF_LIGHT, compute_slowness

CLEAR_INDEX = 1.31
CLEAR = {"ice": CLEAR_INDEX}
RECORD_S = 20e-9
LIDAR_NM = (532.0, 1064.0)
SPHERES = {"facetness": (0.0, 0.0, 0.0, 0.1), "sphericity": (1.0, 1.0, 1.0, 0.1)}
SAMPLING_S = 0.25e-9
GAUSSIAN_S = 0.125e-9
Settings = dict[str, Any]


class Coefficients(NamedTuple):
    """Transport and absorption coefficients (1/m), and mean refractive index, of snow."""

    transport: float
    absorption: float
    index: float


MIE_SPHERES = {
    532.0: Coefficients(transport=747.7, absorption=0.02103, index=1.1359),
    1064.0: Coefficients(transport=736.4, absorption=12.93, index=1.1310),
}
"""Mie theory for spheres of 98.4 µm at 400 kg/m³, ice of 910 kg/m³: SmithB/scattering_delays."""


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


def trace_deep_snow(
    wavelengths: Any, settings: Settings, record_s: float = RECORD_S, **properties: Any
) -> xr.Dataset:
    """Return the light that deep snow reflects within the record."""
    snow = splits.Snow.natural(**properties, depth_m=math.inf)
    light = splits.time_of_flight(snow, wavelengths, **settings, delay_s=[0.0, record_s])
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
    """Yield range biases (mm) of grains, also with the simplifications of Smith et al. (2025)."""
    for wavelength in LIDAR_NM:
        for grains, shape in (("natural", {}), ("spheres", SPHERES)):
            properties = {"optical_radius_um": 98.0, "density_kg_m3": 400.0, **shape}
            light = trace_deep_snow([wavelength], settings, **properties).squeeze()
            snow = splits.Snow.natural(**properties)
            index = average_index(snow, wavelength)
            # The record of straight paths ends after the same delay.
            record = RECORD_S * light.mean_delay.item() / compute_straight_delay(light, snow, index)
            straight = trace_deep_snow([wavelength], settings, record, **properties).squeeze()
            yield {
                "wavelength_nm": wavelength, "grains": grains, "fraction": light.fraction.item(),
                "fraction_stderr": light.fraction_stderr.item(),
                "bias_mm": convert_to_range(light.mean_delay.item()),
                "bias_stderr": convert_to_range(light.mean_delay_stderr.item()),
                "bias_straight_mm": convert_to_range(compute_straight_delay(straight, snow, index)),
                **trace_isotropic(
                    compute_coefficients(snow, wavelength, index, stokes=grains == "spheres"),
                    settings,
                ),
            }  # fmt: skip
        yield {
            "wavelength_nm": wavelength, "grains": "spheres (Mie)",
            **trace_isotropic(MIE_SPHERES[wavelength], settings),
        }  # fmt: skip


def average_index(snow: Any, wavelength: float) -> float:
    """Return the mean of the group indices by volume."""
    slowness = compute_slowness(snow, np.array([wavelength]))
    per_path = slowness.value[0] / slowness.path_fractions * SPEED_OF_LIGHT
    ice = per_path[-1]
    return float(snow.porosity * per_path[0] + (1.0 - snow.porosity) * ice)


def compute_straight_delay(light: xr.Dataset, snow: Any, index: float) -> float:
    """Return the mean delay (s) for straight paths through grains."""
    path = light.path_length.sel(material="air").item() / snow.porosity
    return float(path * index / SPEED_OF_LIGHT)


def compute_coefficients(snow: Any, wavelength: float, index: float, stokes: bool) -> Coefficients:
    """Return the coefficients of snow along straight paths; `stokes` traces polarized light."""
    grains = splits.single_scattering(snow, wavelength, rays=1_000_000, stokes=stokes)
    albedo, extinction = grains.single_scattering_albedo.item(), snow.extinction_per_m
    transport = extinction * albedo * (1.0 - grains.asymmetry_parameter.item())
    return Coefficients(transport, extinction * (1.0 - albedo), index)


def trace_isotropic(snow: Coefficients, settings: Settings) -> dict[str, float]:
    """Return the fraction and bias (mm) of isotropic scattering, also from coarse samples."""
    rays = 10 * settings["rays"]
    speed = SPEED_OF_LIGHT / snow.index
    path = trace_isotropic_paths(RECORD_S * speed * snow.transport, rays) / snow.transport
    weight, delay = np.exp(-snow.absorption * path) / rays, path / speed
    mean = np.average(delay, weights=weight)
    stderr = math.sqrt(((weight * (delay - mean)) ** 2).sum()) / weight.sum()
    fine = np.arange(0.0, RECORD_S, 1e-12)
    power = np.histogram(delay, np.append(fine, RECORD_S), weights=weight)[0]
    times = np.arange(-RECORD_S, RECORD_S + 0.5 * SAMPLING_S, SAMPLING_S)
    scaled = (times[:, None] - (fine + 0.5e-12)) / GAUSSIAN_S
    gaussian = np.exp(-0.5 * scaled**2) / (math.sqrt(2.0 * math.pi) * GAUSSIAN_S)
    samples = gaussian @ power * SAMPLING_S
    return {
        "transport_per_m": snow.transport, "absorption_per_m": snow.absorption,
        "bias_isotropic_mm": convert_to_range(mean),
        "isotropic_stderr": convert_to_range(stderr),
        "fraction_isotropic": weight.sum(), "fraction_sampled": samples.sum(),
        "bias_sampled_mm": convert_to_range(np.average(times, weights=samples)),
    }  # fmt: skip


def trace_isotropic_paths(longest: float, rays: int) -> np.ndarray:
    """Return the paths (mean free paths) of light that deep clear snow reflects."""
    random = np.random.default_rng(1)
    depth, path, cosine = np.zeros(rays), np.zeros(rays), np.ones(rays)
    reflected = []
    while depth.size:
        step = random.exponential(size=depth.size)
        depth, path = depth + step * cosine, path + step
        leaves = depth <= 0.0
        reflected.append((path - depth / cosine)[leaves])
        stays = ~leaves & (path < longest)
        depth, path = depth[stays], path[stays]
        cosine = random.uniform(-1.0, 1.0, depth.size)
    paths = np.concatenate(reflected)
    return paths[paths < longest]


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
