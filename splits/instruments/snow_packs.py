"""Snowpacks of a season under instruments: sun and sky of each, solution in parts, flags."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from splits.core.inputs import DIFFUSE
from splits.core.progress import Progress, open_progress
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import invalid
from splits.discrete_ordinates.granular_stack import CUTOFF_SHARE
from splits.discrete_ordinates.snow_packs import (
    MAX_ROWS,
    SnowPackMaterials,
    SpectraSolution,
    find_unsupported,
    make_snow_packs,
    solve_spectra,
)
from splits.illumination.bands import SpectralBand
from splits.illumination.sky import ASTM_G173, BROADBAND, CLEAR_SKY, MAX_ZENITH_DEG, Sky, sky
from splits.instruments.sky_mixing import (
    COVERED_FRACTION,
    as_sky,
    compute_band_error_weights,
    compute_band_weights,
)
from splits.instruments.solver import AUTO, MONTE_CARLO, REQUESTED, SolverChoice, choose_solver
from splits.io.netcdf import ANCILLARY_ATTRIBUTE
from splits.media.snow import MAX_SURFACE_AREA_M2_KG, Snow
from splits.media.snow_pack_input import FLAG_NAME, LAYER_DIM, WATER_KEY, ZENITH_KEY
from splits.media.snow_packs import FLAG_LABEL, FLAGS, SnowPacks, describe_flags
from splits.simulation.run_options import RunOptions
from splits.simulation.spectral_tally import SpectralEstimate
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads

UNSUPPORTED = "unsupported"
RESULT_FLAGS = {**FLAGS, UNSUPPORTED: 5}
"""Flags of results: those of snowpacks, and one for those outside the tables of grains."""
SUN = "sun"
SUN_OF_EACH = "sun zenith of each snowpack"
PACK_DIM = "snowpack"
"""Dimension of snowpacks before their labels are assigned."""
MAX_INCIDENCE_DEG = 89.9999
MIN_TASKS = 8
"""Smallest number of tasks for each thread, so that all of them end at about the same time."""

# --------------------------------------------------------------------------------------------------
# Solution of all good snowpacks by discrete ordinates, in parallel parts.


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


def choose_incidence(packs: SnowPacks, incidence_deg: Any) -> tuple[SnowPacks, float | str]:
    """Return snowpacks with the sun of each, and their incidence: an angle, "diffuse" or "sun".

    Snowpacks with the sun at the horizon or below get the flag night, those without it
    missing_value.
    """
    if np.ndim(incidence_deg):
        return packs.with_sun_zenith(incidence_deg), SUN
    if isinstance(incidence_deg, str) and incidence_deg == SUN and ZENITH_KEY not in packs.dataset:
        hint = "packs.with_sun_zenith(angles) adds it"
        raise invalid("incidence_deg", SUN, f"for snowpacks with {ZENITH_KEY}", hint)
    return packs, incidence_deg


def choose_pack_solver(solver: str, packs: SnowPacks, wavelength_nm: np.ndarray) -> SolverChoice:
    """Return the solver of snowpacks, as for the finest snow, wet and dry as these are.

    Raises
    ------
    ValueError
        For wavelengths at which discrete ordinates apply to no snow, or another solver.
    """
    if solver == MONTE_CARLO:
        hint = "paths are for one snowpack: packs.make_stack(label)"
        raise invalid("solver", solver, "'discrete_ordinates' or 'auto' for SnowPacks", hint)
    water = packs.dataset[WATER_KEY].values[packs.is_good]
    finest = [
        Snow.natural(
            specific_surface_area_m2_kg=MAX_SURFACE_AREA_M2_KG,
            liquid_water_content=1e-3 if is_wet else 0.0,
        )
        for is_wet in np.unique(np.any(water > 0.0, axis=1))
    ]
    choice = choose_solver(AUTO, finest, wavelength_nm)
    if choice.solver == MONTE_CARLO:
        hint = f"for discrete ordinates, snow{choice.reason.partition(': it')[2]}"
        raise invalid("wavelength_nm", wavelength_nm.tolist(), "within the tables", hint)
    return choice if solver == AUTO else choice._replace(reason=REQUESTED)


def solve_snow_packs(
    packs: SnowPacks, wavelength_nm: np.ndarray, incidence: float | str, max_error: float,
    run: RunOptions, *, only_reflectance: bool = False,
) -> tuple[SpectraSolution, np.ndarray]:  # fmt: skip
    """Return the spectra of all snowpacks, NaN for those without result, and their flags.

    Parameters
    ----------
    packs : SnowPacks
    wavelength_nm : float, shape (wavelengths,)
    incidence : float or "diffuse" or "sun"
    max_error : float
        Determines the number of streams of each snowpack.
    run : RunOptions
    only_reflectance : bool
        Whether layers that are not seen from above may be left out; transmittances are then 0.

    Returns
    -------
    solution : SpectraSolution
    flags : int, shape (snowpacks,)
        One of `RESULT_FLAGS`.
    """
    good, positions = packs.select_good(), np.flatnonzero(packs.is_good)
    layers = {str(n): one.values for n, one in good.data_vars.items() if LAYER_DIM in one.dims}
    n_layers, ground = good.n_layers.values, packs.compute_ground_albedo(wavelength_nm)
    angles: Any = [] if incidence == DIFFUSE else [incidence]
    if incidence == SUN:
        angles = np.minimum(good[ZENITH_KEY].values, MAX_INCIDENCE_DEG)[:, np.newaxis]
    cosines = np.cos(np.radians(np.broadcast_to(angles, (positions.size, np.shape(angles)[-1]))))
    materials = SnowPackMaterials.from_wavelengths(wavelength_nm, packs.impurities)
    unsupported = find_unsupported(layers, materials)
    flags = packs.dataset[FLAG_NAME].values.copy()
    flags[positions[unsupported]] = RESULT_FLAGS[UNSUPPORTED]
    is_wet = np.any(layers[WATER_KEY] > 0.0, axis=1)
    parts = list(_divide(is_wet, n_layers, ~unsupported, wavelength_nm.size, run.threads))

    def solve(rows: np.ndarray) -> SpectraSolution:
        part = {name: values[rows] for name, values in layers.items()}
        stack = make_snow_packs(part, n_layers[rows[0]], ground[rows], materials)
        cutoff = CUTOFF_SHARE * max_error if only_reflectance else 0.0
        return solve_spectra(stack._replace(cutoff=cutoff), cosines[rows], max_error)

    shape = (len(packs), wavelength_nm.size)
    n_beams = cosines.shape[1] + 1
    whole = SpectraSolution(
        np.full((*shape, n_beams), np.nan), np.full((*shape, n_beams), np.nan),
        np.zeros(len(packs), dtype=int), np.full(shape, np.nan), np.full(shape, np.nan),
    )  # fmt: skip
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
            for values, of_part in zip(whole, solution, strict=True):
                values[positions[rows]] = of_part
            done += rows.size
            if report is not None:
                seconds, total = time.perf_counter() - run.start_time, sum(map(len, parts))
                left = seconds * (total - done) / done
                report(SnowPackProgress(0, np.inf, max_error, seconds, left, done, total))
    return whole, flags


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


def make_pack_estimate(solution: SpectraSolution, column: int) -> SpectralEstimate:
    """Return a solution in the form of simulations, for one beam or for diffuse light (−1)."""
    reflectance, transmittance = (
        np.clip(values[..., column], 0.0, 1.0).ravel()
        for values in (solution.reflectance, solution.transmittance)
    )
    mean = np.stack([reflectance, transmittance, 1.0 - reflectance - transmittance])
    # A quantity from 0 to 1 is not wrong by more than itself.
    stderr = np.minimum(solution.error.ravel(), np.maximum(mean, np.finfo(float).eps))
    attributes = describe_solution(solution)
    return SpectralEstimate.from_solution(mean, stderr, attributes)


def describe_solution(solution: SpectraSolution) -> dict[str, Any]:
    """Return the largest number of streams, and the largest errors, as attributes."""
    return {
        "streams": int(solution.n_streams.max()),
        "truncation_error": float(np.nanmax(solution.truncation, initial=0.0)),
        "optics_error": float(np.nanmax(solution.optics_error, initial=0.0)),
    }


def label_snow_packs(result: xr.Dataset, packs: SnowPacks, flags: np.ndarray) -> xr.Dataset:
    """Return a result over `PACK_DIM` with the labels, flags and zenith angles of snowpacks.

    Parameters
    ----------
    result : xarray.Dataset
    packs : SnowPacks
    flags : int, shape (snowpacks,)
        One of `RESULT_FLAGS`.
    """
    keep = [FLAG_NAME] + [ZENITH_KEY] * (ZENITH_KEY in packs.dataset)
    dataset = packs.dataset[keep].drop_vars(LAYER_DIM, errors="ignore")
    for name in map(str, {*dataset.coords} & {*result.variables}):
        hint = f"packs.dataset.rename({{{name!r}: 'site'}})"
        raise invalid("snowpacks", f"with the coordinate {name}", "without names of results", hint)
    attributes = describe_flags(FLAG_LABEL, RESULT_FLAGS)
    dataset[FLAG_NAME] = (packs.label, flags, dataset[FLAG_NAME].attrs | attributes)
    if packs.label != PACK_DIM:
        result = result.rename_dims({PACK_DIM: packs.label})
    for variable in result.data_vars.values():
        # NaN is allowed where the flag is not 0.
        own = variable.attrs.get(ANCILLARY_ATTRIBUTE, "")
        variable.attrs[ANCILLARY_ATTRIBUTE] = f"{own} {FLAG_NAME}".strip()
    result.attrs.pop("seed", None)  # No random numbers are used.
    dataset.attrs = result.attrs
    return dataset.assign_coords(result.coords).assign(result.data_vars)


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


def make_skies(value: Any, packs: SnowPacks) -> tuple[list[Sky], list[np.ndarray], float | str]:
    """Return the skies over the good snowpacks for a user's value, see `splits.albedo`.

    Returns
    -------
    skies : list of Sky
    members : list of int, shape (snowpacks,)
        Positions of the snowpacks under each of them.
    incidence : float or "diffuse" or "sun"
        Of the direct light.
    """
    good = np.flatnonzero(packs.is_good)
    zenith = packs.dataset[ZENITH_KEY].values if ZENITH_KEY in packs.dataset else None
    name = value if isinstance(value, str) else None
    if zenith is None and (callable(value) or name == CLEAR_SKY):
        allowed = f"a splits.Sky for snowpacks without {ZENITH_KEY}"
        raise invalid("sky", value, allowed, "or packs.with_sun_zenith(angles)")
    # These have one angle of the sun; all others are made for that of each snowpack.
    if zenith is None or isinstance(value, Sky) or name == ASTM_G173:
        one = as_sky(value)
        incidence: float | str = one.zenith_deg if one.direct.any() else DIFFUSE
        return [one], [good], incidence
    steps = np.minimum(zenith[good], MAX_ZENITH_DEG) / ZENITH_STEP_DEG
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
    members = [good[number == row] for row in range(len(skies))]
    return skies, members, SUN if has_sun else DIFFUSE


# --------------------------------------------------------------------------------------------------
# Means over bands, by the sky of each snowpack.


def average_over_pack_bands(
    spectrum: xr.Dataset, skies: Sequence[Sky], members: Sequence[np.ndarray],
    bands: Mapping[str, SpectralBand],
) -> dict[str, Variable]:  # fmt: skip
    """Return the albedos of snowpacks over bands, see `splits.instruments.sky_mixing`.

    Parameters
    ----------
    spectrum : xarray.Dataset
        With ``albedo`` and its error over `PACK_DIM` and ``wavelength``.
    skies : sequence of Sky
    members : sequence of int, shape (snowpacks,)
        Positions of the snowpacks under each of the skies.
    bands : mapping of SpectralBand
    """
    albedo, stderr, wavelengths = (
        spectrum[name].values for name in ("albedo", "albedo_stderr", "wavelength")
    )
    means, errors, covered = np.full((3, len(albedo), len(bands)), np.nan)
    for one, rows in zip(skies, members, strict=True):
        # The broadband albedo is that of the spectrum of each sky.
        own_bands = {**bands, BROADBAND: SpectralBand.from_limits(*one.wavelength_nm[[0, -1]])}
        weights, irradiance = compute_band_weights(one, own_bands, wavelengths)
        # Without light in a band its albedo is NaN.
        with np.errstate(invalid="ignore", divide="ignore"):
            covered[rows] = weights.sum(axis=1) / irradiance
            weights = weights / weights.sum(axis=1, keepdims=True)
        # The errors of all wavelengths have the same causes, and add up linearly.
        means[rows], common = (values[rows] @ weights.T for values in (albedo, stderr))
        between = compute_band_error_weights(one, own_bands, wavelengths) @ albedo[rows].T
        errors[rows] = np.sqrt(common**2 + (between**2).sum(axis=0).T)
    dims, label = (PACK_DIM, "band"), "albedo over a band, weighted by irradiance"
    variables = make_variable("band_albedo", dims, means, errors, label)
    return variables | {"irradiance_covered": (dims, covered, COVERED_FRACTION.attributes)}
