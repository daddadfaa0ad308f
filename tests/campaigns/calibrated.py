"""Cases of every instrument for comparing stated errors with the scatter of repeated runs.

Repeated seeds show statistical scatter only.  The error of interpolation between refractive indices
is the same for all seeds, and stated errors include a bound on it.  So the cases have one
wavelength, or two so far apart that each is traced alone, for which the bound is 0.  Actinic flux
and the absorptance of materials of `splits.irradiance_profile` also include a bound for large steps
of absorption, which is negligible for weakly absorbing grains.  The truncation error of a BRDF
expansion is included in the stated errors; those runs are compared with a long run, which truncates
less.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

import splits

ValuesAndErrors = tuple[np.ndarray, np.ndarray]
"""Values and their stated errors, of one shape."""
Reader = Callable[[xr.Dataset], ValuesAndErrors]

ONE_THREAD = {"threads": 1}
SNOW = splits.Snow(depth_m=0.01)
SOOTY = splits.Snow(depth_m=0.01, impurities_ng_g={"black_carbon": 5000.0})
WET = splits.Snow(depth_m=0.01, saturation=0.3)
SAND = splits.Sand(depth_m=0.005)
SNOWPACK = splits.Stack([splits.Snow(density_kg_m3=150, depth_m=0.004), SNOW], ground=0.3)
SCATTERING_LAYER = splits.ParticleLayer(
    optical_thickness=2.0, asymmetry=0.5, single_scattering_albedo=0.9, ground=None,
    refractive_index=1.3,
)  # fmt: skip
POLARIZED_LAYER = splits.ParticleLayer(
    optical_thickness=1.0, single_scattering_albedo=0.95, phase_function="rayleigh",
    refractive_index=1.3, ground=None, polarized=True,
)  # fmt: skip
ROUGH_LAYER = splits.ParticleLayer(
    refractive_index=1.33,
    depth_m=100.0,
    surface={"rms_height_m": 1.0, "wave_number_per_m": 0.1, "correlation": "gaussian", "waves": 64},
)
SKY = splits.sky("midlatitude_winter")
DISTANT_WAVELENGTHS_NM = [600.0, 1300.0]
VIEW_DIRECTIONS = {
    "polar_deg": [0.0, 20.0, 40.0, 60.0, 75.0],
    "azimuth_deg": [0.0, 60.0, 120.0, 180.0],
}
FEW_DIRECTIONS = {"polar_deg": [0.0, 40.0, 70.0], "azimuth_deg": [0.0, 90.0, 180.0]}


class CalibrationCase(NamedTuple):
    """Repeated runs of an instrument over a medium.

    Attributes
    ----------
    instrument, medium : str
        Labels in tables and figures.
    run : callable
        Returns the dataset of a seed.
    readers : mapping
        For each set of quantities, a function that returns its values and errors.
    n_seeds : int
        Number of runs.
    reference_run : callable, optional
        Returns a dataset with which runs are compared, instead of their mean.
    """

    instrument: str
    medium: str
    run: Callable[[int], xr.Dataset]
    readers: Mapping[str, Reader]
    n_seeds: int = 200
    reference_run: Callable[[], xr.Dataset] | None = None


def read_stated(*names: str, **selection: object) -> Reader:
    """Return a reader of variables and their ``…_stderr``, at the labels of a selection."""

    def read(dataset: xr.Dataset) -> ValuesAndErrors:
        selected = dataset.sel(selection) if selection else dataset
        values, errors = (
            np.concatenate([selected[name + end].values.ravel() for name in names])
            for end in ("", "_stderr")
        )
        return values, errors

    return read


def make_readers(*names: str, **at: object) -> dict[str, Reader]:
    """Return a reader for each variable, by its name."""
    return {name.replace("_", " "): read_stated(name, **at) for name in names}


def read_combined(*names: str) -> Reader:
    """Return a reader of means and differences over wavelengths, with correlated errors."""

    def read(dataset: xr.Dataset) -> ValuesAndErrors:
        values, errors = [], []
        for name in names:
            count = dataset.sizes["wavelength"]
            for weights in (np.full(count, 1.0 / count), np.resize([1.0, -1.0], count)):
                weight = xr.DataArray(weights, dims="wavelength")
                scatter, bound = dataset.errors.split(name, weight)
                values.append((dataset[name] * weight).sum("wavelength").values.ravel())
                errors.append(np.hypot(scatter, bound).values.ravel())
        return np.concatenate(values), np.concatenate(errors)

    return read


def read_media_difference(dataset: xr.Dataset) -> ValuesAndErrors:
    """Return differences between two media, with errors from batches of rays."""
    first, second = dataset.isel(medium=0), dataset.isel(medium=1)
    batches = first.reflectance_batches.astype(float) - second.reflectance_batches.astype(float)
    return (
        (first.reflectance - second.reflectance).values,
        ((batches**2).sum("batch") ** 0.5).values,
    )


def read_mean_square_height(dataset: xr.Dataset) -> ValuesAndErrors:
    """Return the mean square height over realizations, with the standard error of the mean."""
    square = dataset.rms_height.values**2
    return np.array([square.mean()]), np.array([square.std(ddof=1) / np.sqrt(square.size)])


SPECTRUM_READERS = {
    **make_readers("reflectance", "transmittance", "absorptance"),
    "sums over wavelengths": read_combined("reflectance", "transmittance"),
}
ANGULAR_READERS = make_readers("brdf", "btdf", "reflectance", "transmittance")
POLARIZED_READERS = ANGULAR_READERS | make_readers("brdf_q", "brdf_u", "btdf_q", "btdf_u")
SPREAD_READERS = make_readers(
    "fraction", "mean_radius", "quantile_radius", "profile", "profile_map"
)
DELAY_READERS = make_readers(
    "return_rate", "fraction", "mean_delay", "delay_spread", "path_length", side="reflected"
)
PROFILE_READERS = make_readers("downward_irradiance", "upward_irradiance", "absorptance")
GRAIN_READERS = make_readers(
    "single_scattering_albedo", "asymmetry_parameter", "legendre_moment",
    "displacement_along_incident", "displacement_along_exit",
    "mean_square_displacement", "wet_fraction",
)  # fmt: skip
LONG_RUN_SEED = 1_000_000
"""Seed of the long reference runs."""


def make_spectrum_run(medium, wavelengths, incidence=0.0, error=0.01, **settings):
    return lambda seed: splits.spectrophotometer(
        medium, wavelengths, incidence, max_stderr=error, seed=seed, **ONE_THREAD, **settings
    )


def make_angular_run(medium, wavelength, incidence, error=0.05):
    return lambda seed: splits.goniophotometer(
        medium,
        [wavelength],
        incidence,
        seed=seed,
        relative_stderr=error,
        **VIEW_DIRECTIONS,
        **ONE_THREAD,
    )


def make_expansion_case(name, *scene):
    """Return the case of a BRDF by expansion."""
    run, long_run = make_angular_run(*scene), make_angular_run(*scene, error=0.01)
    return CalibrationCase(
        "goniophotometer", name, run, ANGULAR_READERS, 100, lambda: long_run(LONG_RUN_SEED)
    )


def make_bins_run(medium, wavelength, rays=30_000):
    return lambda seed: splits.goniophotometer(
        medium,
        [wavelength],
        40.0,
        rays=rays,
        seed=seed,
        estimator="bins",
        n_bins=(3, 6),
        **ONE_THREAD,
    )


def make_next_event_run(medium, rays):
    return lambda seed: splits.goniophotometer(
        medium,
        [600.0],
        40.0,
        rays=rays,
        seed=seed,
        estimator="next_event",
        **FEW_DIRECTIONS,
        **ONE_THREAD,
    )


def make_spread_run(medium, wavelength, half_width):
    return lambda seed: splits.beam_spread(
        medium, [wavelength], 30.0, rays=20_000, seed=seed, half_width_m=half_width, **ONE_THREAD
    )


def run_delays(seed):
    delays = [0.0, 1e-12, 1e-11, 1e-10, 1e-9]
    return splits.time_of_flight(
        SNOW, [1300.0], 30.0, rays=20_000, seed=seed, delay_s=delays, **ONE_THREAD
    )


def make_profile_run(medium, wavelengths, incidence=0.0, error=0.02):
    return lambda seed: splits.irradiance_profile(
        medium,
        wavelengths,
        incidence,
        depth_m=[0.002, 0.005],
        max_stderr=error,
        seed=seed,
        **ONE_THREAD,
    )


def make_grain_run(medium, wavelengths):
    return lambda seed: splits.single_scattering(
        medium, wavelengths, moments=8, rays=4000, seed=seed, **ONE_THREAD
    )


def run_soot(seed):
    media = {"clean": SNOW, "sooty": SOOTY}
    return splits.spectrophotometer(
        media, DISTANT_WAVELENGTHS_NM, 0.0, max_stderr=0.004, seed=seed, **ONE_THREAD
    )


def run_lens(seed):
    return splits.lens(
        ROUGH_LAYER,
        screen_depth_m=[2.0, 5.0],
        radius_m=0.5,
        centre_on="origin",
        realizations=100,
        seed=seed,
        rays=36,
    )


def run_surface_map(seed):
    # A square of many wavelengths: the mean square over a small one has a skewed distribution.
    return splits.surface_map(
        ROUGH_LAYER, half_width_m=100.0, points=2, realizations=100, seed=seed
    )


def make_albedo_run(medium):
    # Diffuse light uses the next seed.
    return lambda seed: splits.albedo(
        medium, SKY, DISTANT_WAVELENGTHS_NM, max_stderr=0.005, seed=2 * seed, **ONE_THREAD
    )


def make_hdrf_run(error):
    return lambda seed: splits.hdrf(
        SNOW, SKY, [600.0], relative_stderr=error, seed=2 * seed, **VIEW_DIRECTIONS, **ONE_THREAD
    )


def run_radiation_profile(seed):
    return splits.radiation_profile(
        SNOW,
        SKY,
        # So close that the error between them, which all seeds share, is negligible.
        [600.0, 610.0],
        depth_m=[0.003],
        max_stderr=0.02,
        seed=2 * seed,
        total_w_m2=500.0,
        **ONE_THREAD,
    )


_SOOT_JACOBIAN = {"jacobian": ["impurities_ng_g.black_carbon"]}
CASES = [
    CalibrationCase(
        "spectrophotometer",
        "snow",
        make_spectrum_run(SNOW, DISTANT_WAVELENGTHS_NM, error=0.004),
        SPECTRUM_READERS,
    ),
    CalibrationCase(
        "spectrophotometer",
        "wet snow, diffuse",
        make_spectrum_run(WET, [600.0], "diffuse"),
        SPECTRUM_READERS,
    ),
    CalibrationCase(
        "spectrophotometer",
        "snowpack on soil",
        make_spectrum_run(SNOWPACK, [900.0], 60.0),
        SPECTRUM_READERS,
    ),
    CalibrationCase(
        "spectrophotometer", "sand", make_spectrum_run(SAND, [600.0]), SPECTRUM_READERS
    ),
    CalibrationCase(
        "spectrophotometer",
        "layer",
        make_spectrum_run(SCATTERING_LAYER, [600.0], 30.0),
        SPECTRUM_READERS,
    ),
    CalibrationCase(
        "spectrophotometer, derivatives",
        "sooty snow",
        make_spectrum_run(SOOTY, [600.0], **_SOOT_JACOBIAN),
        make_readers("reflectance_jacobian", "transmittance_jacobian"),
    ),
    CalibrationCase(
        "spectrophotometer, analog",
        "snow",
        make_spectrum_run(SNOW, DISTANT_WAVELENGTHS_NM, error=0.02, estimator="analog"),
        SPECTRUM_READERS,
    ),
    CalibrationCase(
        "spectrophotometer, analog",
        "layer",
        make_spectrum_run(SCATTERING_LAYER, [600.0], 30.0, estimator="analog"),
        SPECTRUM_READERS,
    ),
    CalibrationCase(
        "spectrophotometer, several media",
        "snow",
        run_soot,
        SPECTRUM_READERS | {"difference of media": read_media_difference},
    ),
    make_expansion_case("snow, 60°", SNOW, 600.0, 60.0),
    make_expansion_case("snow, 0°", SNOW, 1300.0, 0.0),
    make_expansion_case("layer, 40°", SCATTERING_LAYER, 600.0, 40.0),
    CalibrationCase("goniophotometer, bins", "snow", make_bins_run(SNOW, 1300.0), ANGULAR_READERS),
    CalibrationCase(
        "goniophotometer, bins",
        "polarized layer",
        make_bins_run(POLARIZED_LAYER, 600.0),
        POLARIZED_READERS,
    ),
    CalibrationCase(
        "goniophotometer, next_event",
        "layer",
        make_next_event_run(SCATTERING_LAYER, 4000),
        ANGULAR_READERS,
    ),
    CalibrationCase(
        "goniophotometer, next_event",
        "polarized layer",
        make_next_event_run(POLARIZED_LAYER, 4000),
        POLARIZED_READERS,
    ),
    CalibrationCase("beam_spread", "snow", make_spread_run(SNOW, 1300.0, 0.003), SPREAD_READERS),
    CalibrationCase(
        "beam_spread", "layer", make_spread_run(SCATTERING_LAYER, 600.0, 1.0), SPREAD_READERS
    ),
    CalibrationCase("time_of_flight", "snow", run_delays, DELAY_READERS),
    CalibrationCase(
        "irradiance_profile",
        "snow",
        make_profile_run(SNOW, [500.0], error=0.01),
        PROFILE_READERS | make_readers("actinic_flux", "absorptance_of_material"),
    ),
    CalibrationCase(
        "irradiance_profile",
        "snowpack on soil",
        make_profile_run(SNOWPACK, [900.0], 50.0),
        PROFILE_READERS,
    ),
    CalibrationCase(
        "single_scattering", "wet snow", make_grain_run(WET, DISTANT_WAVELENGTHS_NM), GRAIN_READERS
    ),
    CalibrationCase("single_scattering", "sand", make_grain_run(SAND, [600.0]), GRAIN_READERS),
    CalibrationCase("lens", "waves", run_lens, make_readers("contraction", "concentration")),
    CalibrationCase(
        "surface_map",
        "waves",
        run_surface_map,
        {"mean square height": read_mean_square_height},
        400,
    ),
    CalibrationCase("albedo", "snow", make_albedo_run(SNOW), make_readers("albedo", "band_albedo")),
    CalibrationCase(
        "albedo",
        "snowpack on soil",
        make_albedo_run(SNOWPACK),
        make_readers("albedo", "band_albedo"),
    ),
    CalibrationCase(
        "hdrf",
        "snow",
        make_hdrf_run(0.05),
        make_readers("reflectance_factor"),
        100,
        lambda: make_hdrf_run(0.01)(LONG_RUN_SEED),
    ),
    CalibrationCase(
        "radiation_profile",
        "snow",
        run_radiation_profile,
        make_readers("downward_irradiance", "upward_irradiance", "absorbed_power"),
        100,
    ),
]
