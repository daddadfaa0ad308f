"""Combination of simulations under direct and diffuse light for the illumination by a sky."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import check_wavelengths
from splits.core.keywords import REACHED_ATTRIBUTES
from splits.core.uncertainty import (
    Variable,
    make_variable,
)
from splits.core.validation import invalid
from splits.illumination.bands import SpectralBand, compute_mean_error_weights
from splits.illumination.sky import Sky, sky
from splits.instruments.solver import DISCRETE_ORDINATES
from splits.simulation.strata import STOP_REASONS

DIRECT_FRACTION = Quantity("fraction of direct sunlight", "1")
COVERED_FRACTION = Quantity("fraction of the band's light within the wavelengths", "1")
DEFAULT_STEP_NM = 10.0
MAX_DEFAULT_NM = 2495.0
"""Last wavelength by default: less than a hundredth of sunlight lies above it."""


def as_sky(value: Any) -> Sky:
    """Return the sky for a user's value, see `splits.sky`."""
    return value if isinstance(value, Sky) else sky(value)


def choose_wavelengths(wavelength_nm: Any, sky: Sky, min_count: int) -> np.ndarray:
    """Return the requested wavelengths (nm), at least `min_count`, or those by default.

    Raises
    ------
    ValueError
        For wavelengths outside the spectrum of the sky.
    """
    if wavelength_nm is None:
        last = min(MAX_DEFAULT_NM, float(sky.wavelength_nm[-1]))
        wavelength_nm = np.arange(float(sky.wavelength_nm[0]), last + 0.5, DEFAULT_STEP_NM)
    wavelengths = check_wavelengths("wavelength_nm", wavelength_nm)
    if wavelengths.size < min_count:
        raise invalid("wavelength_nm", wavelengths.tolist(), f"at least {min_count} wavelengths")
    sky.check_coverage(wavelengths)
    return wavelengths


def mix_direct_and_diffuse(
    sky: Sky,
    wavelength_nm: np.ndarray,
    instrument: Callable[[float | str, int], xr.Dataset],
    names: Sequence[str],
    direct_fraction: xr.DataArray | None = None,
) -> xr.Dataset:
    """Return the results of an instrument under a sky: values, errors, and batch deviations if any.

    The attributes give the rays of both runs, the larger of their errors, and the more severe of
    the reasons why they stopped.

    Parameters
    ----------
    sky : Sky
    wavelength_nm : float, shape (wavelengths,)
    instrument : callable
        Takes an incidence and 0 for the sun or 1 for diffuse light, to be added to a seed, so that
        both runs are independent.
    names : sequence of str
        Variables over wavelength and any other dimensions.
    direct_fraction : xarray.DataArray, optional
        Over wavelength and any of these dimensions; by default that of the sky.
    """
    if direct_fraction is None:
        direct_fraction = xr.DataArray(
            sky.compute_direct_fraction(wavelength_nm),
            {"wavelength": wavelength_nm},
            ("wavelength",),
        )
    components: list[tuple[xr.DataArray, float | str]] = [
        (direct_fraction, sky.zenith_deg),
        (1.0 - direct_fraction, "diffuse"),
    ]
    runs = [
        # The mixture has the incidence of neither.
        (fraction, instrument(incidence, number).drop_vars("incidence_deg", errors="ignore"))
        for number, (fraction, incidence) in enumerate(components)
        if fraction.any()
    ]
    variables: dict[str, Any] = {}
    for name in names:
        means, variances, bounds, deviations = ([] for _ in range(4))
        for fraction, dataset in runs:
            means.append(fraction * dataset[name])
            variance: Any = (fraction * dataset[f"{name}_stderr"]) ** 2
            if f"{name}_batches" in dataset:
                deviations.append(fraction * dataset[f"{name}_batches"])
                scatter = (deviations[-1].astype(float) ** 2).sum("batch")
                bounds.append(np.maximum(variance - scatter, 0.0) ** 0.5)
                variance = np.minimum(scatter, variance)
            elif dataset.attrs.get("solver") == DISCRETE_ORDINATES:
                bounds.append(variance**0.5)
                variance = 0.0 * variance
            variances.append(variance)
        # Both runs use the same index nodes, or tables: their errors are correlated.
        stderr = (sum(variances) + sum(bounds) ** 2) ** 0.5
        variables |= {name: sum(means), f"{name}_stderr": stderr}
        if deviations:
            variables[f"{name}_batches"] = xr.concat(deviations, "batch")
    attributes = [dataset.attrs for _, dataset in runs]
    reached: dict[str, Any] = {
        name: max(float(one[name]) for one in attributes)
        for name in REACHED_ATTRIBUTES
        if name in attributes[0]
    }
    reached |= {
        # With "auto", both runs may differ in their solver.
        "solver": " and ".join(dict.fromkeys(str(one["solver"]) for one in attributes)),
        "stop_reason": max((one["stop_reason"] for one in attributes), key=STOP_REASONS.index),
        "rays": sum(one["rays"] for one in attributes),
    }
    return xr.Dataset(variables, {"sky": make_sky_coordinate(sky)}, reached)


def compute_band_weights(
    sky: Sky, bands: Mapping[str, SpectralBand], wavelength_nm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the irradiance of bands at wavelengths, and over the whole spectrum of the sky.

    Returns
    -------
    weights : float, shape (bands, wavelengths)
        See `splits.illumination.sky.Sky.compute_weights`.
    band_irradiance : float, shape (bands,)
    """
    weights, all_weights = (
        np.array([sky.compute_weights(wavelengths, band) for band in bands.values()])
        for wavelengths in (wavelength_nm, sky.wavelength_nm)
    )
    return weights, all_weights.sum(axis=1)


def compute_band_error_weights(
    sky: Sky, bands: Mapping[str, SpectralBand], wavelength_nm: np.ndarray
) -> np.ndarray:
    """Return weights of the errors of means over bands, shape (estimates, bands, wavelengths).

    See `compute_band_weights`, and `splits.illumination.bands.compute_mean_error_weights`.
    """

    def make_weights(band: SpectralBand, wavelengths: np.ndarray, n_nodes: int = 2) -> np.ndarray:
        weights = sky.compute_weights(wavelengths, band, n_nodes)
        # Without light in a band its albedo is NaN.
        with np.errstate(invalid="ignore"):
            return weights / weights.sum()

    return np.stack([
        compute_mean_error_weights(partial(make_weights, band), wavelength_nm)
        for band in bands.values()
    ], axis=1)  # fmt: skip


def average_over_bands(
    spectrum: xr.Dataset, name: str, sky: Sky, bands: Mapping[str, SpectralBand], long_name: str
) -> dict[str, Variable]:
    """Return means of a quantity over bands, their errors, and the part of light that is covered.

    Parameters
    ----------
    spectrum : xarray.Dataset
        Quantity over ``wavelength`` and other dimensions, with its error, and deviations if any.
    name : str
        Name of the quantity; that of the means begins with ``band_``.
    sky : Sky
    bands : mapping of SpectralBand
    long_name : str
    """
    weights, band_irradiance = compute_band_weights(sky, bands, spectrum.wavelength.values)
    normalized = xr.DataArray(
        weights / weights.sum(axis=1, keepdims=True),
        {"wavelength": spectrum.wavelength},
        ("band", "wavelength"),
    )
    dims = tuple("band" if dim == "wavelength" else str(dim) for dim in spectrum[name].dims)
    label = f"{long_name} over a band, weighted by irradiance"
    rows = compute_band_error_weights(sky, bands, spectrum.wavelength.values)
    between = (xr.DataArray(rows, normalized.coords, ("estimate", *normalized.dims))
               * spectrum[name]).sum("wavelength")  # fmt: skip
    mean, error = spectrum.errors.weighted_sum(name, normalized)
    values, stderr = (
        one.transpose(*dims).values
        for one in (
            mean,
            (error**2 + (between**2).sum("estimate")) ** 0.5,
        )
    )
    by_batch = None
    if f"{name}_batches" in spectrum:
        deviations = (normalized * spectrum[f"{name}_batches"]).sum("wavelength")
        by_batch = deviations.transpose("batch", *dims).values
    means = make_variable(f"band_{name}", dims, values, stderr, label, deviations=by_batch)
    return means | make_coverage_variable(weights, band_irradiance)


def make_coverage_variable(weights: np.ndarray, band_irradiance: np.ndarray) -> dict[str, Variable]:
    """Return the fraction of the light of bands that is covered, see `compute_band_weights`."""
    covered = weights.sum(axis=1) / band_irradiance
    return {"irradiance_covered": ("band", covered, COVERED_FRACTION.attributes)}


def make_sky_coordinate(sky: Sky) -> Variable:
    """Return the coordinate of the name of a sky, which variables keep, and retrievals check."""
    return (), np.array(sky.name), {"long_name": "sky"}


def make_sky_attributes(sky: Sky, bands: Mapping[str, SpectralBand]) -> dict[str, Any]:
    """Return the attributes of a sky, and of bands."""
    files: dict[str, Sky | SpectralBand] = {"sky": sky}
    files |= {f"band_{name}": band for name, band in bands.items()}
    hashes = {f"{name}_sha256": one.sha256 for name, one in files.items() if one.sha256}
    return {"sky": sky.name, "sky_source": sky.source, "zenith_deg": sky.zenith_deg, **hashes}
