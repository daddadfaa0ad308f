"""Public functions that take arrays of numbers, each as a function of one of its arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from formula_tables import W, snowlike, spectrum
from test_phase_functions_by_angle import optics

import splits
from splits.experiments.fit import check_measured
from splits.lookup.axes import Axes
from splits.materials import refractive_index
from splits.phase_functions import for_eradiate

NM = [400.0, 800.0, 1600.0]
PARTS = [0.25, 0.5, 0.125]
BANDS = {"blue": (500, 600), "red": (600, 700), "infrared": (800, 900)}
SIZE, DIRT = "optical_radius_um", "impurities_ng_g.black_carbon"
AT = {"incidence_deg": 30.0, DIRT: 64.0}
SNOW, LAYER = splits.Snow(depth_m=0.005), splits.Layer(optical_thickness=0.125)
DULL = splits.Layer(single_scattering_albedo=0.5, bottom_albedo=0.0)
SKY = {"wavelength_nm": NM, "direct": PARTS, "diffuse": PARTS}
SEA = splits.Layer(
    surface={"rms_height_m": 1.0, "wave_number_per_m": 0.125, "correlation": "gaussian"},
    depth_m=100.0,
)
TABLE = snowlike()
FEW = {"max_stderr": 0.5, "threads": 1}
SEEN = spectrum(200.0, 64.0).astype(np.float16).astype(float)


class Case(NamedTuple):
    """A function of one array, and the values to call it with, which half precision holds.

    Attributes
    ----------
    call : callable
        Returns a dataset, or what `numpy.asarray` takes.
    values : list
    one : bool
        Whether a single number is taken, too, perhaps for all.
    labels : list or None
        What values may be labelled by; None where nothing stands beside them.
    runs : bool
        Whether it traces rays.
    """

    call: Callable[[Any], Any]
    values: list[Any]
    one: bool = False
    labels: list[Any] | None = None
    runs: bool = False


def refracting(**changes):
    given = {"wavelength_nm": NM, "n": [1.25, 1.5, 1.75], "k": [0.0, 0.0, 0.0]} | changes
    index = splits.Snow(refractive_index={"ice": given}).refractive_index["ice"]
    return index.wavelength_nm, index.n, index.k


def dirty(**changes):
    given = {"ng_g": 8.0, "wavelength_nm": NM, "absorption_m2_kg": PARTS} | changes
    return splits.Snow(impurities_ng_g={"mine": given}).describe()["mine_absorption_m2_kg"]


def phase(**changes):
    given = {"cosine": [-1.0, 0.0, 1.0], "density": PARTS} | changes
    return splits.Layer(phase_function=given).kernel_phase_function.quantiles


def spectral(**changes):
    given = {"wave_number_per_m": [0.0, 1.0, 2.0], "density": PARTS} | changes
    surface = {"rms_height_m": 1.0, "correlation": "spectrum", "spectrum": given}
    return splits.RoughSurface(surface).fields[0].quantiles


def sky(**changes):
    found = splits.sky(SKY | changes, 50.0)
    return found.wavelength_nm, found.direct, found.diffuse


def ground(medium, **changes):
    return medium(ground={"wavelength_nm": NM, "albedo": PARTS} | changes).ground.albedo_values


def retrieved(measured=(W, SEEN), noise=0.0625, **more):
    return splits.retrieve(measured, TABLE, [SIZE], noise, at=AT, **more).dataset


def retrieved_of(noise):
    alike = {"stderr": noise, "correlation_nm": 128.0}
    return retrieved(noise=alike)


def mapped(image):
    values = xr.DataArray(image, {"wavelength": W}, "wavelength").expand_dims("y")
    return splits.retrieve_map(values, TABLE, [SIZE], 0.0625, at=AT)


def chosen(bands=W, noise=0.0625):
    return splits.best_bands(TABLE, bands, [SIZE], noise, 2, at=AT).drop_vars("band")


def labelled_sky(name, values):
    light = splits.Sky(
        **{"name": "mine", "source": "me", "zenith_deg": 50.0} | SKY | {name: values}
    )
    return light.direct, light.diffuse


UP, TWO = [0.0, 32.0, 64.0], [400.0, 800.0]
SHADES = [0.25, 0.5, 0.5]
CASES = {
    # Media.
    "Snow ground.wavelength_nm": Case(lambda a: ground(splits.Snow, wavelength_nm=a), NM),
    "Snow ground.albedo": Case(lambda a: ground(splits.Snow, albedo=a), PARTS, labels=NM),
    "Sand ground.albedo": Case(lambda a: ground(splits.Sand, albedo=a), PARTS, labels=NM),
    "Stack ground.albedo": Case(
        lambda a: ground(lambda **g: splits.Stack([SNOW], **g), albedo=a), PARTS, labels=NM),
    "Snow refractive_index.wavelength_nm": Case(lambda a: refracting(wavelength_nm=a), NM),
    "Snow refractive_index.n": Case(lambda a: refracting(n=a), [1.25, 1.5, 1.75], labels=NM),
    "Snow refractive_index.k": Case(lambda a: refracting(k=a), PARTS, True, NM),
    "Snow impurities": Case(lambda a: dirty(absorption_m2_kg=a), PARTS, labels=NM),
    "Snow impurities.wavelength_nm": Case(lambda a: dirty(wavelength_nm=a), NM),
    "Snow facetness": Case(
        lambda a: splits.Snow(facetness=a).facetness, [0.25, 0.5, 0.375, 0.125],
        labels=["min", "max", "mean", "sd"]),
    "Snow grain_size_um": Case(
        lambda a: splits.Snow(grain_size_um=a).grain_size_um, [64.0, 128.0], labels=["min", "max"]),
    "Sand texture": Case(
        lambda a: splits.Sand(texture=a).texture, [0.0, 0.125, 0.875],
        labels=["clay", "silt", "sand"]),
    "Sand partition": Case(
        lambda a: splits.Sand(partition=a).partition, [0.25, 0.5, 0.25],
        labels=["pure", "mixed", "coated"]),
    "Layer phase_function.cosine": Case(lambda a: phase(cosine=a), [-1.0, 0.0, 1.0]),
    "Layer phase_function.density": Case(
        lambda a: phase(density=a), PARTS, labels=[-1.0, 0.0, 1.0]),
    "RoughSurface wave_number": Case(lambda a: spectral(wave_number_per_m=a), [0.0, 1.0, 2.0]),
    "RoughSurface density": Case(lambda a: spectral(density=a), PARTS, labels=[0.0, 1.0, 2.0]),
    "RoughSurface correlation": Case(SEA.surface.correlation, UP, one=True),
    "refractive_index": Case(refractive_index("ice"), NM, one=True),
    # Skies.
    "sky wavelength_nm": Case(lambda a: sky(wavelength_nm=a), NM),
    "sky direct": Case(lambda a: sky(direct=a), PARTS, labels=NM),
    "sky diffuse": Case(lambda a: sky(diffuse=a), PARTS, labels=NM),
    "Sky direct": Case(lambda a: labelled_sky("direct", a), PARTS, labels=NM),
    "albedo": Case(lambda a: splits.albedo(DULL, splits.sky(SKY, 50.0), a, **FEW), TWO, runs=True),
    "albedo bands": Case(
        lambda a: splits.albedo(
            DULL, splits.sky(SKY, 50.0), NM, **FEW,
            bands={"mine": {"wavelength_nm": NM, "response": a}}),
        PARTS, labels=NM, runs=True),
    "hdrf": Case(
        lambda a: splits.hdrf(DULL, splits.sky(SKY, 50.0), a, 0.5, threads=1, polar_deg=UP,
                              azimuth_deg=[0.0]), [800.0], one=True, runs=True),
    "light_inside": Case(
        lambda a: splits.light_inside(SNOW, splits.sky(SKY, 50.0), a, NM, **FEW),
        [0.0009765625, 0.001953125], one=True, runs=True),
    # Instruments.
    "spectrophotometer": Case(
        lambda a: splits.spectrophotometer(DULL, a, **FEW), NM, one=True, runs=True),
    "spectra": Case(lambda a: splits.spectra({"one": SNOW}, a, **FEW), NM, one=True, runs=True),
    "goniophotometer wavelength_nm": Case(
        lambda a: splits.goniophotometer(DULL, a, relative_stderr=0.5, threads=1, polar_deg=UP,
                                         azimuth_deg=[0.0]), [800.0], one=True, runs=True),
    "goniophotometer polar_deg": Case(
        lambda a: splits.goniophotometer(DULL, [800.0], relative_stderr=0.5, threads=1,
                                         polar_deg=a, azimuth_deg=[0.0]), UP, one=True, runs=True),
    "goniophotometer azimuth_deg": Case(
        lambda a: splits.goniophotometer(DULL, [800.0], relative_stderr=0.5, threads=1,
                                         polar_deg=UP, azimuth_deg=a), UP, one=True, runs=True),
    "bssrdf": Case(
        lambda a: splits.bssrdf(DULL, a, rays=100, half_width_m=1.0, threads=1), NM, one=True,
        runs=True),
    "deep_transmittance": Case(
        lambda a: splits.deep_transmittance(SNOW, a, relative_stderr=0.5, threads=1), [800.0],
        one=True, runs=True),
    "profile": Case(
        lambda a: splits.profile(SNOW, [800.0], a, **FEW), [0.0009765625, 0.001953125], one=True,
        runs=True),
    "single_scattering": Case(
        lambda a: splits.single_scattering(SNOW, a, moments=2, rays=2, threads=1), NM, one=True,
        runs=True),
    "lens screen_depth_m": Case(
        lambda a: splits.lens(SEA, a, 1.0, over="origin", rays=3), [1.0, 2.0], one=True, runs=True),
    "lens waves": Case(
        lambda a: splits.lens(SEA, [1.0], 1.0, over="origin", rays=3, waves=a),
        [[0.0625, 1.0, 0.5, 0.0], [0.125, 0.5, 0.0, 1.0]], runs=True),
    # Tables.
    "table wavelength_nm": Case(
        lambda a: splits.table(lambda saturation: SNOW, {"saturation": [0.0]}, a, **FEW), NM,
        one=True, runs=True),
    "table grid": Case(lambda a: Axes.from_mapping({"depth_m": a}).values, UP),
    "Table.interp": Case(
        lambda a: TABLE.interp(**AT, **{SIZE: 128.0}, wavelength=a), [512.0, 1024.0], one=True),
    # Retrievals.
    "retrieve wavelengths": Case(lambda a: retrieved((a, SEEN)), W.tolist()),
    "retrieve values": Case(lambda a: retrieved((W, a)), SEEN.tolist(), labels=W.tolist()),
    "retrieve noise": Case(lambda a: retrieved(noise=a), [0.0625] * 5 + [0.125] * 6,
                           True, W.tolist()),
    "retrieve covariance": Case(lambda a: retrieved(noise=a), np.diag([0.015625] * 11).tolist(),
                                True),
    "retrieve stderr": Case(retrieved_of, [0.0625] * 5 + [0.125] * 6, True, W.tolist()),
    "retrieve bands": Case(
        lambda a: retrieved(a, bands=BANDS), SHADES, labels=list(BANDS)),
    "retrieve noise of bands": Case(
        lambda a: retrieved(SHADES, a, bands=BANDS), [0.0625, 0.125, 0.25], True, list(BANDS)),
    "retrieve free": Case(
        lambda a: splits.retrieve((W, SEEN), TABLE, {SIZE: a}, 0.0625, at=AT).dataset,
        [64.0, 512.0], labels=["low", "high"]),
    "retrieve prior": Case(
        lambda a: retrieved(prior={SIZE: a}), [128.0, 64.0],
        labels=["mean", "standard deviation"]),
    "best_bands": Case(lambda a: chosen(bands=a), [512.0, 1024.0]),
    "best_bands noise": Case(
        lambda a: chosen(noise=a), [0.0625] * 5 + [0.125] * 6, True, W.tolist()),
    "sobol_indices free": Case(
        lambda a: splits.sobol_indices(TABLE, {SIZE: a, DIRT: (0.0, 512.0)}, points=64,
                                       at={"incidence_deg": 30.0}),
        [64.0, 512.0], labels=["low", "high"]),
    "fit": Case(lambda a: check_measured(a, np.array(NM)), PARTS, labels=NM),
    # Single grains, and files of other programs.
    "phase_function": Case(lambda a: splits.phase_function(optics(), a), UP, one=True),
    "for_eradiate": Case(
        lambda a: for_eradiate(optics(), a), np.linspace(0.0, 180.0, 721).tolist()),
}  # fmt: skip
