"""One sample under the sun and under diffuse light, mixed as a sky has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.validation import invalid
from splits.illumination.sky import Sky, sky
from splits.simulation.arguments import check_wavelengths

DEFAULT_STEP_NM = 10.0
MAX_DEFAULT_NM = 2495.0
"""Wavelengths by default end where less than a hundredth of sunlight is left."""


def as_sky(given: Sky | str | Mapping[str, Any]) -> Sky:
    """Return the sky that a user's value stands for, see `splits.sky`."""
    return given if isinstance(given, Sky) else sky(given)


def choose_wavelengths(wavelength_nm: Any, sky: Sky, min_count: int) -> np.ndarray:
    """Return the wavelengths (nm) asked for, at least so many, or those by default.

    Raises
    ------
    ValueError
        For wavelengths that the sky does not have.
    """
    if wavelength_nm is None:
        last = min(MAX_DEFAULT_NM, float(sky.wavelength_nm[-1]))
        wavelength_nm = np.arange(float(sky.wavelength_nm[0]), last + 0.5, DEFAULT_STEP_NM)
    w = check_wavelengths(wavelength_nm)
    if w.size < min_count:
        raise invalid("wavelength_nm", w.tolist(), f"at least {min_count} wavelengths")
    sky.check_coverage(w)
    return w


def mix_direct_and_diffuse(
    sky: Sky,
    wavelength_nm: np.ndarray,
    instrument: Callable[[float | str, int], xr.Dataset],
    names: Sequence[str],
) -> xr.Dataset:
    """Return what an instrument finds under a sky: values, errors, and groups if there are any.

    Parameters
    ----------
    sky : Sky
    wavelength_nm : float, shape (wavelengths,)
    instrument : callable
        Takes an incidence and 0 for the sun or 1 for diffuse light, to be added to a seed: rays of
        the sun and of the sky know nothing of each other.
    names : sequence of str
        Variables over wavelength and any other dimensions.
    """
    share = xr.DataArray(
        sky.compute_direct_fraction(wavelength_nm), {"wavelength": wavelength_nm}, ("wavelength",)
    )
    values: dict[str, Any] = {}
    groups: dict[str, list[xr.DataArray]] = {name: [] for name in names}
    squares: dict[str, Any] = dict.fromkeys(names, 0.0)
    missed: dict[str, Any] = dict.fromkeys(names, 0.0)
    ways: list[tuple[xr.DataArray, float | str]] = [
        (share, sky.zenith_deg),
        (1.0 - share, "diffuse"),
    ]
    for number, (part, incidence) in enumerate(ways):
        if not part.any():
            continue
        found = instrument(incidence, number)
        for name in names:
            values[name] = values.get(name, 0.0) + part * found[name]
            square: Any = (part * found[f"{name}_stderr"]) ** 2
            if f"{name}_batches" in found:
                groups[name].append(part * found[f"{name}_batches"])
                scatter = (groups[name][-1].astype(float) ** 2).sum("batch")
                # Both runs are interpolated between the same indices, and may miss alike.
                missed[name] = missed[name] + np.maximum(square - scatter, 0.0) ** 0.5
                square = np.minimum(scatter, square)
            squares[name] = squares[name] + square
    for name in names:
        values[f"{name}_stderr"] = (squares[name] + missed[name] ** 2) ** 0.5
        if groups[name]:
            values[f"{name}_batches"] = xr.concat(groups[name], "batch")
    return xr.Dataset(values)


def make_sky_attributes(sky: Sky) -> dict[str, Any]:
    """Return what a sky is, for a dataset's attributes."""
    facts = {"sky": sky.name, "sky_source": sky.source, "zenith_deg": sky.zenith_deg}
    return facts | ({"sky_sha256": sky.sha256} if sky.sha256 else {})
