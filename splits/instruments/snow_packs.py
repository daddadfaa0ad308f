"""Spectra and albedo of the snowpacks of a season, by discrete ordinates."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.inputs import DIFFUSE
from splits.core.progress import Progress, open_progress
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import invalid
from splits.discrete_ordinates.snow_packs import (
    MAX_ROWS,
    SnowPackMaterials,
    SpectraSolution,
    find_spectral_obstacle,
    find_unsupported,
    make_snow_packs,
    solve_spectra,
)
from splits.illumination.bands import SpectralBand
from splits.illumination.sky import ASTM_G173, BROADBAND, CLEAR_SKY, MAX_ZENITH_DEG, Sky, sky
from splits.instruments.sky_mixing import (
    COVERED_FRACTION,
    DIRECT_FRACTION,
    as_sky,
    choose_wavelengths,
    compute_band_error_weights,
    compute_band_weights,
    make_sky_attributes,
    make_sky_coordinate,
)
from splits.instruments.solver import DISCRETE_ORDINATES, MONTE_CARLO
from splits.io.netcdf import ANCILLARY_ATTRIBUTE
from splits.media.snow_pack_input import FLAG_NAME, LAYER_DIM, ZENITH_KEY
from splits.media.snow_packs import FLAGS, HORIZON_DEG, SnowPacks
from splits.simulation.run_options import (
    RunOptions,
    make_incidence_coordinate,
    make_wavelength_coordinate,
)
from splits.simulation.spectral_tally import QUANTITY_LABELS
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads

# --------------------------------------------------------------------------------------------------
# Spectra of the snowpacks of `splits.SnowPacks` by discrete ordinates, in parallel.

UNSUPPORTED = "unsupported"
RESULT_FLAGS = {**FLAGS, UNSUPPORTED: 5}
"""Flags of results: those of snowpacks, and one for those outside the tables of grains."""
SUN = "sun"
MAX_INCIDENCE_DEG = 89.9999
MIN_TASKS = 8
"""Smallest number of tasks for each thread, so that all of them end at about the same time."""


@dataclass(frozen=True)
class SnowPackProgress(Progress):
    """State of a run over snowpacks.

    Attributes
    ----------
    done, total : int
        Numbers of snowpacks.
    """

    done: int = 0
    total: int = 0

    def __str__(self) -> str:
        return f"{self.done} of {self.total} snowpacks, {self.seconds_left:.0f} s left"


class SnowPackSpectra(NamedTuple):
    """Spectra of all snowpacks; NaN for those without result.

    Attributes
    ----------
    reflectance, transmittance : float, shape (snowpacks, wavelengths, beams + 1)
        Under beams, and under diffuse light (last).
    error : float, shape (snowpacks, wavelengths)
    flags : int, shape (snowpacks,)
        One of `RESULT_FLAGS`.
    attributes : dict
        Solver, number of streams and largest errors.
    """

    reflectance: np.ndarray
    transmittance: np.ndarray
    error: np.ndarray
    flags: np.ndarray
    attributes: dict[str, Any]

    def bound_error(self, values: np.ndarray) -> np.ndarray:
        """Return the error of a quantity from 0 to 1, which is at most the quantity itself."""
        return np.minimum(self.error, np.maximum(values, np.finfo(float).eps))


def compute_beam_cosines(packs: SnowPacks, incidence: float | str) -> np.ndarray:
    """Return the cosines of the beams of the good snowpacks, shape (good, beams)."""
    n_good = int(packs.is_good.sum())
    if incidence == DIFFUSE:
        return np.empty((n_good, 0))
    angle: Any = incidence
    if incidence == SUN:
        zenith = packs.dataset[ZENITH_KEY].values[packs.is_good]
        angle = np.minimum(zenith, min(MAX_INCIDENCE_DEG, HORIZON_DEG))
    return np.cos(np.radians(np.broadcast_to(angle, (n_good,))))[:, np.newaxis]


def solve_snow_packs(
    packs: SnowPacks, wavelength_nm: np.ndarray, incidence: float | str, max_error: float,
    solver: str, run: RunOptions,
) -> SnowPackSpectra:  # fmt: skip
    """Return the spectra of all good snowpacks.

    Parameters
    ----------
    packs : SnowPacks
    wavelength_nm : float, shape (wavelengths,)
    incidence : float or "diffuse" or "sun"
    max_error : float
        Determines the number of streams of each snowpack.
    solver : str
        As given by the user.
    run : RunOptions

    Raises
    ------
    ValueError
        For wavelengths at which discrete ordinates apply to no snow, or another solver.
    """
    if solver == MONTE_CARLO:
        hint = "paths are for one snowpack: packs.make_stack(label)"
        raise invalid("solver", solver, f"'{DISCRETE_ORDINATES}' or 'auto' for SnowPacks", hint)
    arrays, cosines = packs.to_arrays(), compute_beam_cosines(packs, incidence)
    is_wet = np.any(arrays.liquid_water_content > 0.0, axis=1)
    for wet in np.unique(is_wet).tolist():
        obstacle = find_spectral_obstacle(wavelength_nm, wet=wet)
        if obstacle:
            hint = f"for discrete ordinates, snow {obstacle.removeprefix('it ')}"
            raise invalid("wavelength_nm", wavelength_nm.tolist(), "within the tables", hint)
    materials = SnowPackMaterials.from_wavelengths(wavelength_nm, packs.impurities)
    ground = packs.compute_ground_albedo(wavelength_nm)
    unsupported = find_unsupported(arrays, materials)
    flags = packs.dataset[FLAG_NAME].values.copy()
    flags[arrays.positions[unsupported]] = RESULT_FLAGS[UNSUPPORTED]
    parts = list(_divide(is_wet, arrays.n_layers, ~unsupported, wavelength_nm.size, run.threads))

    def solve(rows: np.ndarray) -> SpectraSolution:
        snowpacks = make_snow_packs(arrays, rows, ground[rows], materials)
        return solve_spectra(snowpacks, cosines[rows], max_error)

    shape = (len(packs), wavelength_nm.size)
    reflectance, transmittance = (np.full((*shape, cosines.shape[1] + 1), np.nan) for _ in range(2))
    error = np.full(shape, np.nan)
    largest = {"streams": 0, "truncation_error": 0.0, "optics_error": 0.0}
    done, n_ahead = 0, 2 * run.threads
    with (
        open_progress("snowpacks", run.progress) as report,
        limit_blas_threads(),
        DaemonThreadPool(run.threads) as pool,
    ):
        # Only a few parts are submitted in advance, so that few solutions wait in memory.
        jobs = deque(pool.submit(solve, rows) for rows in parts[:n_ahead])
        for number, rows in enumerate(parts):
            solution = jobs.popleft().result()
            if number + n_ahead < len(parts):
                jobs.append(pool.submit(solve, parts[number + n_ahead]))
            where = arrays.positions[rows]
            reflectance[where] = np.clip(solution.reflectance, 0.0, 1.0)
            transmittance[where] = np.clip(solution.transmittance, 0.0, 1.0)
            error[where] = solution.error
            found = (solution.n_streams, solution.truncation, solution.optics_error)
            for name, values in zip(largest, found, strict=True):
                largest[name] = max(largest[name], values.max().item())
            done += rows.size
            if report is not None:
                seconds, total = time.perf_counter() - run.start_time, sum(map(len, parts))
                left = seconds * (total - done) / done
                report(SnowPackProgress(0, np.inf, max_error, seconds, left, done, total))
    attributes = {"solver": DISCRETE_ORDINATES, **largest}
    return SnowPackSpectra(reflectance, transmittance, error, flags, attributes)


def _divide(
    is_wet: np.ndarray, n_layers: np.ndarray, chosen: np.ndarray, n_wavelengths: int, threads: int
) -> Iterator[np.ndarray]:
    """Iterate over parts of the chosen snowpacks, all dry or all wet, of one number of layers."""
    per_part = max(1, min(MAX_ROWS // n_wavelengths, chosen.sum() // (MIN_TASKS * threads)))
    for wet in (True, False):
        for number in np.unique(n_layers)[::-1]:
            group = np.flatnonzero(chosen & (is_wet == wet) & (n_layers == number))
            for start in range(0, group.size, per_part):
                yield group[start : start + per_part]


def make_snow_pack_dataset(
    packs: SnowPacks, flags: np.ndarray, variables: dict[str, Variable], axes: dict[str, Any]
) -> xr.Dataset:
    """Return a dataset over snowpacks, with their flags and zenith angles of the sun.

    Parameters
    ----------
    packs : SnowPacks
    flags : int, shape (snowpacks,)
        One of `RESULT_FLAGS`.
    variables : dict of Variable
        Over the label and other dimensions.
    axes : dict
        Coordinates of the other dimensions.
    """
    keep = [FLAG_NAME] + [ZENITH_KEY] * (ZENITH_KEY in packs.dataset)
    dataset = packs.dataset[keep].drop_vars(LAYER_DIM, errors="ignore")
    for name in map(str, {*dataset.coords} & {*variables, *axes}):
        hint = f"packs.dataset.rename({{{name!r}: 'site'}})"
        raise invalid("snowpacks", f"with the coordinate {name}", "without names of results", hint)
    attributes = {
        **dataset[FLAG_NAME].attrs,
        "flag_values": np.array(list(RESULT_FLAGS.values()), dtype=np.int8),
        "flag_meanings": " ".join(RESULT_FLAGS),
    }
    dataset[FLAG_NAME] = (packs.label, flags, attributes)
    dataset.attrs = {}
    for _, _, attributes in variables.values():
        # NaN is allowed where the flag is not 0.
        own = attributes.get(ANCILLARY_ATTRIBUTE, "")
        attributes[ANCILLARY_ATTRIBUTE] = f"{own} {FLAG_NAME}".strip()
    return dataset.assign_coords(axes).assign(variables)


# --------------------------------------------------------------------------------------------------
# Hemispherical reflectance, transmittance and absorptance of the snowpacks of a season.


def compute_snow_pack_spectra(
    packs: SnowPacks, wavelength_nm: Any, incidence_deg: Any, max_stderr: Any, solver: Any,
    run: RunOptions,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `splits.spectrophotometer` for snowpacks.

    Parameters
    ----------
    packs : SnowPacks
    wavelength_nm, incidence_deg, max_stderr, solver : object
        As given by the user.
    run : RunOptions
    """
    incidence: float | str = SUN
    if isinstance(incidence_deg, str) and incidence_deg == SUN:
        if ZENITH_KEY not in packs.dataset:
            hint = "packs.with_sun_zenith(angles) adds it"
            raise invalid("incidence_deg", SUN, f"for snowpacks with {ZENITH_KEY}", hint)
    elif np.ndim(incidence_deg):
        # Those with the sun at the horizon or below get the flag night, missing ones missing_value.
        packs = packs.with_sun_zenith(incidence_deg)
    else:
        incidence = incidence_deg
    spectra = solve_snow_packs(packs, wavelength_nm, incidence, max_stderr, solver, run)
    illumination = "hemispherical" if incidence == DIFFUSE else "directional"
    column = -1 if incidence == DIFFUSE else 0
    reflectance, transmittance = (
        values[..., column] for values in (spectra.reflectance, spectra.transmittance)
    )
    means = (reflectance, transmittance, 1.0 - reflectance - transmittance)
    variables: dict[str, Any] = {}
    dims = (packs.label, "wavelength")
    for (name, label), mean in zip(QUANTITY_LABELS.items(), means, strict=True):
        long_name = label if name == "absorptance" else f"{illumination}-{label}"
        variables |= make_variable(name, dims, mean, spectra.bound_error(mean), long_name)
    largest = max(
        np.nanmax(variables[f"{name}_stderr"][1], initial=0.0) for name in QUANTITY_LABELS
    )
    attributes = {
        **make_snow_pack_attributes(
            packs,
            run,
            "Virtual spectrophotometer",
            "spectrophotometer",
            spectra,
            max_stderr,
            float(largest),
        ),
        "incidence_deg": "sun zenith of each snowpack" if incidence == SUN else incidence,
    }
    if incidence == SUN:
        angles = make_incidence_coordinate(packs.dataset[ZENITH_KEY].values, (packs.label,))
    else:
        angles = make_incidence_coordinate(incidence)
    axes = {"wavelength": make_wavelength_coordinate(wavelength_nm), "incidence_deg": angles}
    return make_snow_pack_dataset(packs, spectra.flags, variables, axes).assign_attrs(attributes)


def make_snow_pack_attributes(
    packs: SnowPacks, run: RunOptions, title: str, instrument: str, spectra: SnowPackSpectra,
    max_stderr: float, max_stderr_reached: float,
) -> dict[str, Any]:  # fmt: skip
    """Return the attributes of a dataset of snowpacks at the end of a run, and of its errors."""
    medium: Any = packs
    attributes = run.make_attributes(title, instrument, medium)
    # No random numbers are used.
    del attributes["seed"]
    return {
        **attributes,
        "max_stderr": max_stderr,
        "stop_reason": "converged" if max_stderr_reached <= max_stderr else "solver_error",
        "max_stderr_reached": max_stderr_reached,
        "rays": 0,
        **spectra.attributes,
    }


# --------------------------------------------------------------------------------------------------
# Skies over the snowpacks of a season: one for all, or one for each zenith angle of the sun.
#
# A sky is computed for zenith angles in steps of `ZENITH_STEP_DEG`, at most `MAX_ZENITH_DEG`.  Its
# spectrum and its fraction of direct light are those of the nearest step.  The incidence of the
# sunlight on the snow is not rounded.

ZENITH_STEP_DEG = 0.05
"""Step of the zenith angle of the sun.

By rounding, a broadband albedo changes by less than 1e-4, and a spectral albedo by less than 5e-4.
"""


def make_skies(value: Any, packs: SnowPacks) -> tuple[list[Sky], np.ndarray, float | str]:
    """Return the skies over the good snowpacks for a user's value, see `splits.albedo`.

    Returns
    -------
    skies : list of Sky
    number : int, shape (good,)
        Position of the sky of each snowpack in the list.
    incidence : float or "diffuse" or "sun"
        Of the direct light.
    """
    zenith = packs.dataset[ZENITH_KEY].values if ZENITH_KEY in packs.dataset else None
    name = value if isinstance(value, str) else None
    if zenith is None and (callable(value) or name == CLEAR_SKY):
        allowed = f"a splits.Sky for snowpacks without {ZENITH_KEY}"
        raise invalid("sky", value, allowed, "or packs.with_sun_zenith(angles)")
    # These have one angle of the sun; all others are made for that of each snowpack.
    if zenith is None or isinstance(value, Sky) or name == ASTM_G173:
        one = as_sky(value)
        incidence: float | str = one.zenith_deg if one.direct.any() else DIFFUSE
        return [one], np.zeros(int(packs.is_good.sum()), dtype=int), incidence
    steps = np.minimum(zenith[packs.is_good], MAX_ZENITH_DEG) / ZENITH_STEP_DEG
    values, number = np.unique(steps.round(), return_inverse=True)
    if not values.size:
        values = np.zeros(1)
    angles = np.minimum(values * ZENITH_STEP_DEG, MAX_ZENITH_DEG).round(9).tolist()
    skies = [value(angle) if callable(value) else sky(value, angle) for angle in angles]
    for one in skies:
        if not isinstance(one, Sky):
            allowed = "a function that returns a splits.Sky"
            raise invalid("sky", type(one).__name__, allowed)
    has_sun = any(one.direct.any() for one in skies)
    return skies, number, SUN if has_sun else DIFFUSE


# --------------------------------------------------------------------------------------------------
# Spectral and band albedo of the snowpacks of a season under skies.


def compute_snow_pack_albedo(
    packs: SnowPacks, sky: Any, wavelength_nm: Any, max_stderr: Any, solver: Any, bands: Any,
    run: RunOptions,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `splits.albedo` for snowpacks.

    Parameters
    ----------
    packs : SnowPacks
    sky, wavelength_nm, max_stderr, solver, bands : object
        As given by the user.
    run : RunOptions
    """
    skies, number, incidence = make_skies(sky, packs)
    wavelengths = choose_wavelengths(wavelength_nm, skies[0], 2)
    for one in skies:
        one.check_coverage(wavelengths)
    named = skies[0].make_bands(bands)
    skies[0].check_bands(named, wavelengths)
    spectra = solve_snow_packs(packs, wavelengths, incidence, max_stderr, solver, run)
    good = np.flatnonzero(packs.is_good)
    # Without direct light there is no beam, and both columns are that of diffuse light.
    beam, diffuse = (spectra.reflectance[..., column] for column in (0, -1))
    fraction = np.full(beam.shape, np.nan)
    fraction[good] = np.array([one.compute_direct_fraction(wavelengths) for one in skies])[number]
    albedo, stderr = (
        fraction * of_beam + (1.0 - fraction) * of_diffuse
        for of_beam, of_diffuse in (
            (beam, diffuse), (spectra.bound_error(beam), spectra.bound_error(diffuse)),
        )
    )  # fmt: skip
    band_albedo, band_stderr, covered = np.full((3, len(packs), len(named)), np.nan)
    for row, one in enumerate(skies):
        members = good[number == row]
        # The broadband albedo is that of the spectrum of each sky.
        own_bands = {**named, BROADBAND: SpectralBand.from_limits(*one.wavelength_nm[[0, -1]])}
        weights, irradiance = compute_band_weights(one, own_bands, wavelengths)
        # Without light in a band its albedo is NaN.
        with np.errstate(invalid="ignore", divide="ignore"):
            covered[members] = weights.sum(axis=1) / irradiance
            weights = weights / weights.sum(axis=1, keepdims=True)
        # The errors of all wavelengths have the same causes, and add up linearly.
        band_albedo[members], common = (values[members] @ weights.T for values in (albedo, stderr))
        between = compute_band_error_weights(one, own_bands, wavelengths) @ albedo[members].T
        band_stderr[members] = np.sqrt(common**2 + (between**2).sum(axis=0).T)
    dims, band_dims = (packs.label, "wavelength"), (packs.label, "band")
    label = "albedo over a band, weighted by irradiance"
    variables: dict[str, Any] = {
        **make_variable("albedo", dims, albedo, stderr, "albedo under this sky"),
        "direct_fraction": (dims, fraction, DIRECT_FRACTION.attributes),
        **make_variable("band_albedo", band_dims, band_albedo, band_stderr, label),
        "irradiance_covered": (band_dims, covered, COVERED_FRACTION.attributes),
    }
    attributes = {
        **make_snow_pack_attributes(
            packs,
            run,
            "Albedo under a sky",
            "albedo",
            spectra,
            max_stderr,
            float(np.nanmax(stderr, initial=0.0)),
        ),
        **make_sky_attributes(skies[0], named),
    }
    if incidence == SUN:
        attributes["zenith_deg"] = "sun zenith of each snowpack"
        attributes["sky_zenith_step_deg"] = ZENITH_STEP_DEG
    axes = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "band": list(named),
        "sky": make_sky_coordinate(skies[0]),
    }
    return make_snow_pack_dataset(packs, spectra.flags, variables, axes).assign_attrs(attributes)
