"""Spectra of many snowpacks at once, each with as many streams as one snowpack would have."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.granular_stack import (
    N_TRIAL_WAVELENGTHS,
    STREAM_NUMBERS,
    GranularStack,
    Truncation,
    choose_trial_wavelengths,
    compute_optics_error,
    compute_slab_error,
    solve_spectrum,
    spread_truncation,
)

MAX_ROWS = 4096
"""Largest number of spectra times wavelengths of one solution."""
MAX_BYTES = 150_000_000
"""Approximate memory of one solution."""
WORKING_MATRICES = 25
"""Matrices of one layer that exist at the same time while it is solved."""


class SpectraSolution(NamedTuple):
    """Spectra of snowpacks, for the beams and for diffuse light (last).

    Attributes
    ----------
    reflectance, transmittance : float, shape (snowpacks, wavelengths, beams + 1)
    n_streams : int, shape (snowpacks,)
    truncation : float, shape (snowpacks, wavelengths)
        Error due to the number of streams.
    optics_error : float, shape (snowpacks, wavelengths)
        Error due to the tables of single scattering, and to the balance of wet and dry pores.
    """

    reflectance: np.ndarray
    transmittance: np.ndarray
    n_streams: np.ndarray
    truncation: np.ndarray
    optics_error: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Error of reflectance and transmittance, shape (snowpacks, wavelengths)."""
        error: np.ndarray = np.hypot(self.truncation, self.optics_error)
        return error

    @classmethod
    def make_empty(cls, n_snowpacks: int, n_wavelengths: int, n_values: int) -> SpectraSolution:
        """Return arrays to be filled."""
        reflectance, transmittance = np.empty((2, n_snowpacks, n_wavelengths, n_values))
        truncation, optics_error = np.empty((2, n_snowpacks, n_wavelengths))
        n_streams = np.zeros(n_snowpacks, dtype=int)
        return cls(reflectance, transmittance, n_streams, truncation, optics_error)


def solve_spectra(
    snowpacks: GranularStack, cosines: np.ndarray, max_error: float
) -> SpectraSolution:
    """Return the spectra of several snowpacks of the same number of layers.

    Dry snowpacks are solved together, wet ones one by one.

    Parameters
    ----------
    snowpacks : GranularStack
        All dry or all wet, along the first dimension.
    cosines : float, shape (snowpacks, beams)
    max_error : float
        See `splits.discrete_ordinates.granular_stack.solve_spectrum`.
    """
    n_snowpacks, n_wavelengths = snowpacks.ground.shape
    result = SpectraSolution.make_empty(n_snowpacks, n_wavelengths, cosines.shape[-1] + 1)
    if snowpacks.is_wet:
        for number in range(n_snowpacks):
            one = solve_spectrum(snowpacks.select(slice(None), number), cosines[number], max_error)
            result.reflectance[number] = one.budget.reflectance
            result.transmittance[number] = one.budget.transmittance
            result.n_streams[number] = one.n_streams
            result.truncation[number] = one.truncation
            result.optics_error[number] = one.optics_error
        return result
    result.optics_error[:] = compute_optics_error(snowpacks)
    _choose_streams(snowpacks, cosines, max_error, result)
    for n_streams in np.unique(result.n_streams):
        group = np.flatnonzero(result.n_streams == n_streams)
        for rows, columns in _split(group, n_wavelengths, len(snowpacks.layers), n_streams):
            part = snowpacks.select(columns, rows)
            budget = part.solve(cosines[rows, np.newaxis], int(n_streams))
            result.reflectance[rows, columns] = budget.reflectance
            result.transmittance[rows, columns] = budget.transmittance
    slab_error = compute_slab_error(snowpacks, result.reflectance, result.transmittance)
    result.optics_error[:] = np.hypot(result.optics_error, slab_error)
    return result


def _choose_streams(
    snowpacks: GranularStack, cosines: np.ndarray, max_error: float, result: SpectraSolution
) -> None:
    """Set the number of streams and the truncation error of dry snowpacks."""
    n_wavelengths, n_layers = snowpacks.ground.shape[1], len(snowpacks.layers)
    trial = choose_trial_wavelengths(n_wavelengths)
    pending = np.arange(len(snowpacks.ground))
    for n_streams in STREAM_NUMBERS:
        failed = []
        for rows, columns in _split(pending, trial.size, n_layers, 2 * n_streams):
            # All trial wavelengths of a snowpack are in the same part.
            part = snowpacks.select(trial[columns], rows)
            beams = cosines[rows, np.newaxis]
            difference = Truncation.measure(part, beams, n_streams).largest
            result.truncation[rows] = spread_truncation(difference, trial, n_wavelengths)
            result.n_streams[rows] = n_streams
            failed.append(rows[difference.max(axis=-1) > 0.5 * max_error])
        pending = np.concatenate(failed)
        if not pending.size:
            break


def _split(
    positions: np.ndarray, n_wavelengths: int, n_layers: int, n_streams: int
) -> Iterator[tuple[np.ndarray, slice]]:
    """Iterate over parts of limited memory, as positions of snowpacks and a slice of wavelengths.

    Up to `N_TRIAL_WAVELENGTHS` wavelengths are never divided.
    """
    n_rows = min(MAX_ROWS, MAX_BYTES // estimate_bytes(n_layers, n_streams))
    n_columns = min(n_wavelengths, max(n_rows, N_TRIAL_WAVELENGTHS))
    n_snowpacks = max(1, n_rows // n_columns)
    for start in range(0, positions.size, n_snowpacks):
        for first in range(0, n_wavelengths, n_columns):
            columns = slice(first, first + n_columns)
            yield positions[start : start + n_snowpacks], columns


def estimate_bytes(n_layers: int, n_streams: int) -> int:
    """Return the memory of one wavelength of a dry snowpack while it is solved (bytes)."""
    n_radiances = n_streams // 2 + 1
    per_layer = 2 * n_radiances**2 + 2 * n_streams + 3 * n_radiances
    return 8 * (n_layers * per_layer + WORKING_MATRICES * n_radiances**2)
