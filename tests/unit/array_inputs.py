"""Public functions that take arrays of numbers, each as a function of one of its arrays."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from constructed_results import make_optics
from formula_tables import W, evaluate_spectrum, make_snowlike_table

import splits
from splits.analysis.theory.phase_function import to_eradiate
from splits.materials import make_refractive_index
from splits.tables.axes import ParameterGrid

NM = [400.0, 800.0, 1600.0]
PARAMETERS = [0.25, 0.5, 0.125]
BANDS = {"blue": (500, 600), "red": (600, 700), "infrared": (800, 900)}
SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0, SOOT: 64.0}
SNOW, LAYER = splits.Snow(depth_m=0.005), splits.ParticleLayer(optical_thickness=0.125)
GREY_LAYER = splits.ParticleLayer(single_scattering_albedo=0.5, ground=0.0)
SKY = {"wavelength_nm": NM, "direct": PARAMETERS, "diffuse": PARAMETERS}
SEA = splits.ParticleLayer(
    surface={"rms_height_m": 1.0, "wave_number_per_m": 0.125, "correlation": "gaussian"},
    depth_m=100.0,
)
TABLE = make_snowlike_table()
FEW_WAVELENGTHS = {"max_stderr": 0.5, "threads": 1}
DELAYS, RATES = [0.0, 1.0, 2.0, 3.0], [0.75, 0.375, 0.25]
MEASURED = evaluate_spectrum(200.0, 64.0).astype(np.float16).astype(float)


class ArrayCase(NamedTuple):
    """A function of one array, and values for it that are exact in half precision.

    Attributes
    ----------
    call : callable
        Returns a dataset or an array-like.
    values : list
    one : bool
        Whether a single number is accepted, too.
    labels : list or None
        Labels of the values; None where values are not matched by labels.
    runs : bool
        Whether it traces rays.
    """

    call: Callable[[Any], Any]
    values: list[Any]
    one: bool = False
    labels: list[Any] | None = None
    runs: bool = False


def user_index(**changes):
    table = {"wavelength_nm": NM, "n": [1.25, 1.5, 1.75], "k": [0.0, 0.0, 0.0]} | changes
    index = splits.Snow(refractive_index={"ice": table}).refractive_index["ice"]
    return index.wavelength_nm, index.n, index.k


def make_dirty_snow(**changes):
    table = {"ng_g": 8.0, "wavelength_nm": NM, "absorption_m2_kg": PARAMETERS} | changes
    return splits.Snow(impurities_ng_g={"mine": table}).describe()["mine_absorption_m2_kg"]


def make_phase(**changes):
    table = {"cosine": [-1.0, 0.0, 1.0], "density": PARAMETERS} | changes
    return splits.ParticleLayer(phase_function=table).kernel_phase_function.cdf


def quantiles(**changes):
    table = {"wave_number_per_m": [0.0, 1.0, 2.0], "density": PARAMETERS} | changes
    surface = {"rms_height_m": 1.0, "correlation": "spectrum", "spectrum": table}
    return splits.RoughSurface(surface).fields[0].wave_number_quantiles


def make_sky(**changes):
    made = splits.sky(SKY | changes, 50.0)
    return made.wavelength_nm, made.direct, made.diffuse


def user_ground(medium, **changes):
    return medium(ground={"wavelength_nm": NM, "albedo": PARAMETERS} | changes).ground.albedo_values


def retrieve_spectrum(measured=(W, MEASURED), noise=0.0625, **keywords):
    return splits.retrieve(measured, TABLE, [SIZE], noise, fixed=FIXED, **keywords).dataset


def retrieve_correlated(noise):
    correlated = {"stderr": noise, "correlation_nm": 128.0}
    return retrieve_spectrum(noise=correlated)


def retrieve_image(image):
    values = xr.DataArray(image, {"wavelength": W}, "wavelength").expand_dims("y")
    return splits.retrieve_map(values, TABLE, [SIZE], 0.0625, fixed=FIXED)


def make_labelled_sky(name, values):
    labelled = splits.Sky(
        **{"name": "mine", "source": "me", "zenith_deg": 50.0} | SKY | {name: values}
    )
    return labelled.direct, labelled.diffuse


def make_return_table():
    """Return a table of returns that decay faster for small grains."""
    delay, size = np.array([0.5, 1.5, 2.5]), np.geomspace(32.0, 512.0, 5)
    rate = np.exp(-delay * (64.0 / size[:, np.newaxis]) ** 0.5)[:, np.newaxis]
    dims = SIZE, "wavelength", "delay_s"
    return xr.Dataset(
        {"return_rate": (dims, rate), "return_rate_stderr": (dims, 1e-4 * rate)},
        {
            SIZE: size, "wavelength": [532.0], "delay_s": delay,
            "delay_bounds": (("delay_s", "bounds"), [[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]]),
        },
        {"path_sharing_axes": "none"},
    )  # fmt: skip


def retrieve_return(measured=(DELAYS, RATES), noise=0.0625):
    return splits.retrieve_return(measured, make_return_table(), [SIZE], noise).dataset


POLAR, TWO_NM = [0.0, 32.0, 64.0], [400.0, 800.0]
BAND_VALUES = [0.25, 0.5, 0.5]
CASES = {
    # Media.
    "Snow ground.wavelength_nm": ArrayCase(lambda a: user_ground(splits.Snow, wavelength_nm=a), NM),
    "Snow ground.albedo": ArrayCase(lambda a: user_ground(splits.Snow, albedo=a), PARAMETERS,
                                    labels=NM),
    "Sand ground.albedo": ArrayCase(lambda a: user_ground(splits.Sand, albedo=a), PARAMETERS,
                                    labels=NM),
    "Stack ground.albedo": ArrayCase(
        lambda a: user_ground(lambda **g: splits.Stack([SNOW], **g), albedo=a), PARAMETERS,
        labels=NM),
    "Snow refractive_index.wavelength_nm": ArrayCase(lambda a: user_index(wavelength_nm=a),
                                                     NM),
    "Snow refractive_index.n": ArrayCase(lambda a: user_index(n=a), [1.25, 1.5, 1.75],
                                         labels=NM),
    "Snow refractive_index.k": ArrayCase(lambda a: user_index(k=a), PARAMETERS, True, NM),
    "Snow impurities": ArrayCase(lambda a: make_dirty_snow(absorption_m2_kg=a), PARAMETERS,
                                 labels=NM),
    "Snow impurities.wavelength_nm": ArrayCase(lambda a: make_dirty_snow(wavelength_nm=a), NM),
    "Snow facetness": ArrayCase(
        lambda a: splits.Snow(facetness=a).facetness, [0.25, 0.5, 0.375, 0.125],
        labels=["min", "max", "mean", "sd"]),
    "Snow grain_size_um": ArrayCase(
        lambda a: splits.Snow(grain_size_um=a).grain_size_um, [64.0, 128.0], labels=["min", "max"]),
    "Sand texture": ArrayCase(
        lambda a: splits.Sand(texture=a).texture, [0.0, 0.125, 0.875],
        labels=["clay", "silt", "sand"]),
    "Sand partition": ArrayCase(
        lambda a: splits.Sand(partition=a).partition, [0.25, 0.5, 0.25],
        labels=["pure", "mixed", "coated"]),
    "ParticleLayer phase_function.cosine": ArrayCase(lambda a: make_phase(cosine=a),
                                                     [-1.0, 0.0, 1.0]),
    "ParticleLayer phase_function.density": ArrayCase(
        lambda a: make_phase(density=a), PARAMETERS, labels=[-1.0, 0.0, 1.0]),
    "RoughSurface wave_number": ArrayCase(lambda a: quantiles(wave_number_per_m=a),
                                          [0.0, 1.0, 2.0]),
    "RoughSurface density": ArrayCase(lambda a: quantiles(density=a), PARAMETERS,
                                      labels=[0.0, 1.0, 2.0]),
    "RoughSurface correlation": ArrayCase(SEA.surface.correlation, POLAR, one=True),
    "refractive_index": ArrayCase(make_refractive_index("ice"), NM, one=True),
    # Skies.
    "sky wavelength_nm": ArrayCase(lambda a: make_sky(wavelength_nm=a), NM),
    "sky direct": ArrayCase(lambda a: make_sky(direct=a), PARAMETERS, labels=NM),
    "sky diffuse": ArrayCase(lambda a: make_sky(diffuse=a), PARAMETERS, labels=NM),
    "Sky direct": ArrayCase(lambda a: make_labelled_sky("direct", a), PARAMETERS, labels=NM),
    "albedo": ArrayCase(lambda a: splits.albedo(GREY_LAYER, splits.sky(SKY, 50.0), a,
                                                **FEW_WAVELENGTHS), TWO_NM, runs=True),
    "albedo bands": ArrayCase(
        lambda a: splits.albedo(
            GREY_LAYER, splits.sky(SKY, 50.0), NM, **FEW_WAVELENGTHS,
            bands={"mine": {"wavelength_nm": NM, "response": a}}),
        PARAMETERS, labels=NM, runs=True),
    "hdrf": ArrayCase(
        lambda a: splits.hdrf(GREY_LAYER, splits.sky(SKY, 50.0), a, relative_stderr=0.5, threads=1,
                              polar_deg=POLAR,
                              azimuth_deg=[0.0]), [800.0], one=True, runs=True),
    "radiation_profile": ArrayCase(
        lambda a: splits.radiation_profile(SNOW, splits.sky(SKY, 50.0), NM, depth_m=a,
                                           **FEW_WAVELENGTHS),
        [0.0009765625, 0.001953125], one=True, runs=True),
    # Instruments.
    "spectrophotometer": ArrayCase(
        lambda a: splits.spectrophotometer(GREY_LAYER, a, **FEW_WAVELENGTHS), NM, one=True,
        runs=True),
    "spectrophotometer several": ArrayCase(
        lambda a: splits.spectrophotometer({"one": SNOW}, a, **FEW_WAVELENGTHS), NM, one=True,
        runs=True),
    "goniophotometer wavelength_nm": ArrayCase(
        lambda a: splits.goniophotometer(GREY_LAYER, a, relative_stderr=0.5, threads=1,
                                         polar_deg=POLAR,
                                         azimuth_deg=[0.0]), [800.0], one=True, runs=True),
    "goniophotometer polar_deg": ArrayCase(
        lambda a: splits.goniophotometer(GREY_LAYER, [800.0], relative_stderr=0.5, threads=1,
                                         polar_deg=a, azimuth_deg=[0.0]), POLAR, one=True,
        runs=True),
    "goniophotometer azimuth_deg": ArrayCase(
        lambda a: splits.goniophotometer(GREY_LAYER, [800.0], relative_stderr=0.5, threads=1,
                                         polar_deg=POLAR, azimuth_deg=a), POLAR, one=True,
        runs=True),
    "beam_spread": ArrayCase(
        lambda a: splits.beam_spread(GREY_LAYER, a, rays=100, half_width_m=1.0, threads=1), NM,
        one=True,
        runs=True),
    "time_of_flight": ArrayCase(
        lambda a: splits.time_of_flight(SNOW, a, rays=2, threads=1), NM, one=True, runs=True),
    "time_of_flight delay_s": ArrayCase(
        lambda a: splits.time_of_flight(SNOW, 800.0, rays=2, threads=1, delay_s=a),
        [2.0**-14, 2.0**-13], runs=True),
    "time_of_flight depths_m": ArrayCase(
        lambda a: splits.time_of_flight(SNOW, 800.0, rays=2, threads=1, depth_m=a),
        [0.0009765625, 0.001953125], one=True, runs=True),
    "irradiance_profile": ArrayCase(
        lambda a: splits.irradiance_profile(SNOW, [800.0], depth_m=a, **FEW_WAVELENGTHS),
        [0.0009765625, 0.001953125], one=True,
        runs=True),
    "single_scattering": ArrayCase(
        lambda a: splits.single_scattering(SNOW, a, moments=2, rays=2, threads=1), NM, one=True,
        runs=True),
    "compute_mie_matrix wavelength_nm": ArrayCase(
        lambda a: splits.compute_mie_matrix(a, 1.5, radius_um=0.125), NM, one=True),
    "compute_mie_matrix radius_um": ArrayCase(
        lambda a: splits.compute_mie_matrix([800.0], 1.5, radius_um=a, number_density=PARAMETERS),
        [0.125, 0.25, 0.5]),
    "compute_mie_matrix number_density": ArrayCase(
        lambda a: splits.compute_mie_matrix([800.0], 1.5, radius_um=[0.125, 0.25, 0.5],
                                            number_density=a), PARAMETERS,
        labels=[0.125, 0.25, 0.5]),
    "compute_mie_matrix angle_deg": ArrayCase(
        lambda a: splits.compute_mie_matrix([800.0], 1.5, radius_um=0.125, angle_deg=a), POLAR,
        one=True),
    "lens screen_depth_m": ArrayCase(
        lambda a: splits.lens(SEA, screen_depth_m=a, radius_m=1.0, centre_on="origin", rays=3),
        [1.0, 2.0], one=True,
        runs=True),
    "lens waves": ArrayCase(
        lambda a: splits.lens(SEA, screen_depth_m=[1.0], radius_m=1.0, centre_on="origin", rays=3,
                              waves=a),
        [[0.0625, 1.0, 0.5, 0.0], [0.125, 0.5, 0.0, 1.0]], runs=True),
    # Tables.
    "build_table wavelength_nm": ArrayCase(
        lambda a: splits.build_table(lambda saturation: SNOW, {"saturation": [0.0]}, a,
                                     **FEW_WAVELENGTHS).dataset, NM,
        one=True, runs=True),
    "build_table delay_s": ArrayCase(
        lambda a: splits.build_table(lambda saturation: SNOW, {"saturation": [0.0]}, 800.0,
                                            rays=2, threads=1, delay_s=a).dataset,
        [2.0**-14, 2.0**-13], runs=True),
    "build_table grid": ArrayCase(lambda a: ParameterGrid.from_mapping({"depth_m": a})["depth_m"],
                                  POLAR),
    "Table.interp": ArrayCase(
        lambda a: TABLE.interp(**FIXED, **{SIZE: 128.0}, wavelength=a), [512.0, 1024.0], one=True),
    # Retrievals.
    "retrieve wavelengths": ArrayCase(lambda a: retrieve_spectrum((a, MEASURED)), W.tolist()),
    "retrieve values": ArrayCase(lambda a: retrieve_spectrum((W, a)), MEASURED.tolist(),
                                 labels=W.tolist()),
    "retrieve noise": ArrayCase(lambda a: retrieve_spectrum(noise=a), [0.0625] * 5 + [0.125] * 6,
                           True, W.tolist()),
    "retrieve covariance": ArrayCase(lambda a: retrieve_spectrum(noise=a),
                                     np.diag([0.015625] * 11).tolist(),
                                True),
    "retrieve stderr": ArrayCase(retrieve_correlated, [0.0625] * 5 + [0.125] * 6, True, W.tolist()),
    "retrieve bands": ArrayCase(
        lambda a: retrieve_spectrum(a, bands=BANDS), BAND_VALUES, labels=list(BANDS)),
    "retrieve noise of bands": ArrayCase(
        lambda a: retrieve_spectrum(BAND_VALUES, a, bands=BANDS), [0.0625, 0.125, 0.25], True,
        list(BANDS)),
    "retrieve free": ArrayCase(
        lambda a: splits.retrieve((W, MEASURED), TABLE, {SIZE: a}, 0.0625, fixed=FIXED).dataset,
        [64.0, 512.0], labels=["low", "high"]),
    "retrieve prior": ArrayCase(
        lambda a: retrieve_spectrum(prior={SIZE: a}), [128.0, 64.0],
        labels=["mean", "standard deviation"]),
    "retrieve_return delays": ArrayCase(lambda a: retrieve_return((a, RATES)), DELAYS),
    "retrieve_return values": ArrayCase(lambda a: retrieve_return((DELAYS, a)), RATES),
    "retrieve_return noise": ArrayCase(
        lambda a: retrieve_return(noise=a), [0.0625, 0.125, 0.25], one=True),
    # Single grains, and files of other programs.
    "phase_function": ArrayCase(lambda a: splits.phase_function(make_optics(), a), POLAR, one=True),
    "for_eradiate": ArrayCase(
        lambda a: to_eradiate(make_optics(), a), np.linspace(0.0, 180.0, 721).tolist()),
}  # fmt: skip
