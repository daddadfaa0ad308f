"""Scenes of every instrument in which repeated runs show whether stated errors are right.

Seeds show scatter only.  What interpolation between refractive indices may miss is the same for all
of them, and errors hold a bound on it.  So the scenes are of one wavelength, or of two so far apart
that each is traced by itself: there the bound is 0.  Actinic flux and the shares of materials of
`splits.profile` hold a bound on what large steps of absorption do, too; it is next to nothing where
grains hardly absorb.  Of a BRDF by polynomials detail too weak for the data is dropped, and added
to the errors: runs are held against a long one, which drops less.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

import splits
from splits.analysis.errors import error_parts

Told = tuple[np.ndarray, np.ndarray]
"""Values and the errors that are stated of them, of one shape."""
Reader = Callable[[xr.Dataset], Told]

ONE = {"threads": 1}
SNOW = splits.Snow(depth_m=0.01)
SOOTY = splits.Snow(depth_m=0.01, impurities_ng_g={"black_carbon": 5000.0})
WET = splits.Snow(depth_m=0.01, saturation=0.3)
SAND = splits.Sand(depth_m=0.005)
PACK = splits.Stack([splits.Snow(density_kg_m3=150, depth_m=0.004), SNOW], ground=0.3)
HAZE = splits.Layer(
    optical_thickness=2.0, asymmetry=0.5, single_scattering_albedo=0.9, bottom_albedo=None,
    refractive_index=1.3,
)  # fmt: skip
DEEPER = splits.Snow(depth_m=0.02)
SKYLIGHT = splits.Layer(
    optical_thickness=1.0, single_scattering_albedo=0.95, phase_function="rayleigh",
    refractive_index=1.3, bottom_albedo=None, polarized=True,
)  # fmt: skip
WAVES = splits.Layer(
    refractive_index=1.33,
    depth_m=100.0,
    surface={"rms_height_m": 1.0, "wave_number_per_m": 0.1, "correlation": "gaussian", "waves": 64},
)
SKY = splits.sky("midlatitude_winter")
FAR_APART = [600.0, 1300.0]
VIEWS = {"polar_deg": [0.0, 20.0, 40.0, 60.0, 75.0], "azimuth_deg": [0.0, 60.0, 120.0, 180.0]}
FEW = {"polar_deg": [0.0, 40.0, 70.0], "azimuth_deg": [0.0, 90.0, 180.0]}


class Case(NamedTuple):
    """An instrument over a medium, many times.

    Attributes
    ----------
    instrument, medium : str
        As tables and figures name them.
    run : callable
        Takes a seed, returns a dataset.
    groups : mapping
        From the name of a group of quantities to what reads values and errors.
    seeds : int
        How often it is run.
    reference : callable, optional
        Returns a dataset to hold the others against, instead of their mean.
    """

    instrument: str
    medium: str
    run: Callable[[int], xr.Dataset]
    readers: Mapping[str, Reader]
    n_seeds: int = 200
    reference_run: Callable[[], xr.Dataset] | None = None


def stated(*names: str, **at: object) -> Reader:
    """Return what reads variables and their ``…_stderr``, at labels if there are any."""

    def read(dataset: xr.Dataset) -> Told:
        found = dataset.sel(at) if at else dataset
        values, errors = (
            np.concatenate([found[name + end].values.ravel() for name in names])
            for end in ("", "_stderr")
        )
        return values, errors

    return read


def each(*names: str, **at: object) -> dict[str, Reader]:
    """Return readers of variables by their names."""
    return {name.replace("_", " "): stated(name, **at) for name in names}


def combined(*names: str) -> Reader:
    """Return what reads means and differences over wavelengths, by groups of rays."""

    def read(dataset: xr.Dataset) -> Told:
        values, errors = [], []
        for name in names:
            count = dataset.sizes["wavelength"]
            for weights in (np.full(count, 1.0 / count), np.resize([1.0, -1.0], count)):
                weight = xr.DataArray(weights, dims="wavelength")
                scatter, missed = error_parts(dataset, name, weight)
                values.append((dataset[name] * weight).sum("wavelength").values.ravel())
                errors.append(np.hypot(scatter, missed).values.ravel())
        return np.concatenate(values), np.concatenate(errors)

    return read


def difference_of_media(dataset: xr.Dataset) -> Told:
    """Read differences between two media, by groups of rays."""
    first, second = dataset.isel(medium=0), dataset.isel(medium=1)
    groups = first.reflectance_groups.astype(float) - second.reflectance_groups.astype(float)
    return (
        (first.reflectance - second.reflectance).values,
        ((groups**2).sum("group") ** 0.5).values,
    )


def of_surfaces(dataset: xr.Dataset) -> Told:
    """Read the mean square height of all realisations, whose scatter tells its error."""
    square = dataset.rms_height.values**2
    return np.array([square.mean()]), np.array([square.std(ddof=1) / np.sqrt(square.size)])


SPECTRUM = {
    **each("reflectance", "transmittance", "absorptance"),
    "sums over wavelengths": combined("reflectance", "transmittance"),
}
ANGLES = each("brdf", "btdf", "reflectance", "transmittance")
POLARIZED = ANGLES | each("brdf_q", "brdf_u", "btdf_q", "btdf_u")
SPREAD = each("share", "mean_radius", "quantile_radius", "profile", "profile_map")
INSIDE = each("downward_irradiance", "upward_irradiance", "absorptance")
GRAIN = each(
    "single_scattering_albedo", "asymmetry_parameter", "legendre_moment", "displacement_before",
    "displacement_after", "displacement_square", "wet_share",
)  # fmt: skip
LONG = 1_000_000
"""Seed of long runs."""


def spectrum(medium, wavelengths, incidence=0.0, error=0.01, **settings):
    return lambda seed: splits.spectrophotometer(
        medium, wavelengths, incidence, error, seed, **ONE, **settings
    )


def angles(medium, wavelength, incidence, error=0.05):
    return lambda seed: splits.goniophotometer(
        medium, [wavelength], incidence, seed=seed, relative_stderr=error, **VIEWS, **ONE
    )


def expansion(name, *scene):
    """Return the case of a BRDF by polynomials."""
    run, long_run = angles(*scene), angles(*scene, error=0.01)
    return Case("goniophotometer", name, run, ANGLES, 100, lambda: long_run(LONG))


def cells(medium, wavelength, rays=30_000):
    return lambda seed: splits.goniophotometer(
        medium, [wavelength], 40.0, rays, seed, estimator="cells", cells=(3, 6), **ONE
    )


def local(medium, rays):
    return lambda seed: splits.goniophotometer(
        medium, [600.0], 40.0, rays, seed, estimator="local", **FEW, **ONE
    )


def spread(medium, wavelength, half_width):
    return lambda seed: splits.bssrdf(
        medium, [wavelength], 30.0, 20_000, seed, half_width_m=half_width, **ONE
    )


def deep(medium, wavelength, error):
    return lambda seed: splits.deep_transmittance(
        medium, [wavelength], relative_stderr=error, seed=seed, **ONE
    )


def inside(medium, wavelengths, incidence=0.0, error=0.02):
    return lambda seed: splits.profile(
        medium, wavelengths, [0.002, 0.005], incidence, error, seed, **ONE
    )


def grains(medium, wavelengths):
    return lambda seed: splits.single_scattering(medium, wavelengths, 8, 4000, seed, **ONE)


def soot(seed):
    media = {"clean": SNOW, "sooty": SOOTY}
    return splits.spectra(media, FAR_APART, 0.0, 0.004, seed, **ONE)


def rings(seed):
    return splits.lens(WAVES, [2.0, 5.0], 0.5, over="origin", realisations=100, seed=seed, rays=36)


def heights(seed):
    # A square of many wavelengths: mean squares over a smaller one are as skew as χ² of 1.
    return splits.surface_map(WAVES, 100.0, points=2, realisations=100, seed=seed)


def under_sky(medium):
    # Diffuse light takes the next seed.
    return lambda seed: splits.albedo(medium, SKY, FAR_APART, 0.005, 2 * seed, **ONE)


def views_under_sky(error):
    return lambda seed: splits.hdrf(SNOW, SKY, [600.0], error, 2 * seed, **VIEWS, **ONE)


def sunlit(seed):
    return splits.light_inside(
        SNOW, SKY, [0.003], FAR_APART, 0.02, 2 * seed, total_w_m2=500.0, **ONE
    )


_SOOT = {"jacobian": ["impurities_ng_g.black_carbon"]}
CASES = [
    Case("spectrophotometer", "snow", spectrum(SNOW, FAR_APART, error=0.004), SPECTRUM),
    Case("spectrophotometer", "wet snow, diffuse", spectrum(WET, [600.0], "diffuse"), SPECTRUM),
    Case("spectrophotometer", "pack on soil", spectrum(PACK, [900.0], 60.0), SPECTRUM),
    Case("spectrophotometer", "sand", spectrum(SAND, [600.0]), SPECTRUM),
    Case("spectrophotometer", "layer", spectrum(HAZE, [600.0], 30.0), SPECTRUM),
    Case(
        "spectrophotometer, derivatives", "sooty snow", spectrum(SOOTY, [600.0], **_SOOT),
        each("reflectance_jacobian", "transmittance_jacobian"),
    ),
    Case(
        "spectrophotometer, analog", "snow",
        spectrum(SNOW, FAR_APART, error=0.02, estimator="analog"), SPECTRUM,
    ),
    Case(
        "spectrophotometer, analog", "layer",
        spectrum(HAZE, [600.0], 30.0, estimator="analog"), SPECTRUM,
    ),
    Case("spectra", "snow", soot, SPECTRUM | {"difference of media": difference_of_media}),
    expansion("snow, 60°", SNOW, 600.0, 60.0),
    expansion("snow, 0°", SNOW, 1300.0, 0.0),
    expansion("layer, 40°", HAZE, 600.0, 40.0),
    Case("goniophotometer, cells", "snow", cells(SNOW, 1300.0), ANGLES),
    Case("goniophotometer, cells", "polarized layer", cells(SKYLIGHT, 600.0), POLARIZED),
    Case("goniophotometer, local", "layer", local(HAZE, 4000), ANGLES),
    Case("goniophotometer, local", "polarized layer", local(SKYLIGHT, 4000), POLARIZED),
    Case("bssrdf", "snow", spread(SNOW, 1300.0, 0.003), SPREAD),
    Case("bssrdf", "layer", spread(HAZE, 600.0, 1.0), SPREAD),
    Case("deep_transmittance", "snow, 10 %", deep(DEEPER, 1030.0, 0.1), each("transmittance")),
    Case("deep_transmittance", "snow, 5 %", deep(DEEPER, 1300.0, 0.05), each("transmittance"), 100),
    Case(
        "profile", "snow", inside(SNOW, [500.0], error=0.01),
        INSIDE | each("actinic_flux", "absorptance_of_material"),
    ),
    Case("profile", "pack on soil", inside(PACK, [900.0], 50.0), INSIDE),
    Case("single_scattering", "wet snow", grains(WET, FAR_APART), GRAIN),
    Case("single_scattering", "sand", grains(SAND, [600.0]), GRAIN),
    Case("lens", "waves", rings, each("contraction", "concentration")),
    Case("surface_map", "waves", heights, {"mean square height": of_surfaces}, 400),
    Case("albedo", "snow", under_sky(SNOW), each("albedo", "band_albedo")),
    Case("albedo", "pack on soil", under_sky(PACK), each("albedo", "band_albedo")),
    Case(
        "hdrf", "snow", views_under_sky(0.05), each("reflectance_factor"), 100,
        lambda: views_under_sky(0.01)(LONG),
    ),
    Case(
        "light_inside", "snow", sunlit,
        each("downward_irradiance", "upward_irradiance", "absorbed_power"), 100,
    ),
]  # fmt: skip
