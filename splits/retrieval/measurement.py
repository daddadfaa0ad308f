"""Measurements: reflectances over wavelengths or bands, and their noise covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import align_to_labels, as_float_array, check_increasing, find_labels
from splits.core.inputs import check_wavelengths
from splits.core.labels import check_nanometres, convert_units
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    check_range,
    check_relations,
    invalid,
    short_repr,
)
from splits.illumination.bands import SpectralBand, as_bands
from splits.tables.axes import ALL_QUANTITIES, AZIMUTH, POLAR, fold_azimuths

MAX_REFLECTANCE = 2.0
"""Reflectance factor above which values are assumed to be in per cent."""
LABEL_TOLERANCE = 1e-6
"""Relative difference of labels that are equal, for coordinates in single precision."""
NOISE_KEYS = ("stderr", "correlation_nm", "independent")
UNKNOWN_NOISE_STDERR = 1.0
"""Standard error of all values for unknown noise: equal weights, and large enough to dominate."""
MAX_NOISE_STDERR = 1.0
"""Limit of the standard errors of reflectances; larger ones carry no information."""
NOISE_HINT = "in per cent, or of counts? write those of reflectances, such as 0.02 for 2 %"


class Measurement(NamedTuple):
    """A measured spectrum.

    Attributes
    ----------
    values : float, shape (n,)
    wavelength_nm : float, shape (n,)
        Wavelengths; for bands, their mean wavelengths.
    covariance : float, shape (n, n)
        Covariance of the noise.
    bands : dict of SpectralBand
        By name; empty for a spectrum.
    noise_known : bool
        Whether the noise is known; otherwise the covariance only gives equal weights.
    """

    values: np.ndarray
    wavelength_nm: np.ndarray
    covariance: np.ndarray
    bands: dict[str, SpectralBand]
    noise_known: bool = True

    @classmethod
    def from_input(cls, measured: Any, noise: Any, bands: Any = None) -> Measurement:
        """Return a measurement from user input; reject invalid input.

        Parameters
        ----------
        measured : xarray.DataArray, pandas.Series or pair of array_like
            Over ``wavelength`` (nm), or (wavelengths, reflectances); one value per band for bands.
        noise : float, array_like, mapping or None
            None for unknown noise.  One standard error or one per value, or their covariance
            matrix; or a mapping of ``stderr`` and ``correlation_nm`` (errors of wavelengths a
            distance d apart have the correlation e^(−d/correlation_nm)), and optionally additional
            ``independent`` standard errors.
        bands : mapping or str, optional
            As for `splits.albedo`, in the order of the values.

        Raises
        ------
        ValueError
            For gaps, values in per cent, noise that is not above 0, or inconsistent sizes.
        """
        spectral_bands = as_bands(bands)
        wavelength, values = (
            _read_bands(measured, spectral_bands) if spectral_bands else _read_spectrum(measured)
        )
        places = [f"in band {name}" for name in spectral_bands] or [
            f"at {one:g} nm" for one in wavelength
        ]
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            hint = "masked, NaN or missing: leave those out"
            found = f"{gaps.size} gaps, the first {places[gaps[0]]}"
            raise invalid("measured", found, "numbers", hint)
        covariance = (
            UNKNOWN_NOISE_STDERR**2 * np.eye(values.size)
            if noise is None
            else _make_covariance("noise", noise, wavelength, list(spectral_bands))
        )
        if isinstance(measured, xr.DataArray | pd.Series | pd.DataFrame) and not spectral_bands:
            # Labels may be in any order, also of noise that is in their order.
            order = np.argsort(wavelength)
            values, covariance = values[order], covariance[np.ix_(order, order)]
            wavelength = check_increasing("measured (wavelengths)", wavelength[order])
        largest, allowed = values[np.abs(values).argmax()].item(), f"at most {MAX_REFLECTANCE:g}"
        is_fraction, hint = abs(largest) <= MAX_REFLECTANCE, "a fraction, not per cent"
        check_relations((is_fraction, "measured", largest, allowed, hint))
        return cls(values, wavelength, covariance, spectral_bands, noise is not None)


def check_conditions(key: str, measured: Any, conditions: Mapping[str, Any]) -> None:
    """Check that coordinates of measured values are the conditions of the model.

    Parameters
    ----------
    key : str
        Key named in error messages.
    measured : object
        Only coordinates of xarray are checked, other than those of dimensions.
    conditions : mapping
        Value by name, or a list of one value.
    """
    coordinates: Mapping[Any, Any] = (
        measured.coords if isinstance(measured, xr.DataArray | xr.Dataset) else {}
    )
    for name in [name for name in conditions if name in coordinates]:
        values, expected = coordinates[name].values, conditions[name]
        if name == AZIMUTH and values.dtype.kind in "biuf":
            values, expected = fold_azimuths(values), fold_azimuths(expected)
        if name not in measured.dims and not is_same_label(values, expected):
            found = np.unique(coordinates[name].values).tolist()
            hint = f"the model has {name} = {short_repr(expected)}, see fixed"
            hint += "; give the parts with one value each" if len(found) > 1 else ""
            raise invalid(f"{key}.{name}", found, short_repr(expected), hint)


def check_modelled_quantity(
    key: str, measured: Any, quantity: str, conditions: Mapping[str, Any]
) -> None:
    """Check that a measurement is of the quantity of a model, under its light and from its view.

    Parameters
    ----------
    key : str
        Key named in error messages.
    measured : object
        The name of a DataArray, a Series or a column may not be that of another quantity
        (`NAMED_QUANTITIES`), and coordinates of a DataArray may not be conditions that the model
        does not have.
    quantity : str
    conditions : mapping
        See `check_conditions`, which is called first.
    """
    check_conditions(key, measured, conditions)
    names = measured.columns if isinstance(measured, pd.DataFrame) else [
        getattr(measured, "name", "")
    ]  # fmt: skip
    name = str(names[0]).removeprefix("band_")
    coordinates = measured.coords if isinstance(measured, xr.DataArray) else {}
    modelled = {*conditions, *(["sky"] if "diffuse_fraction" in conditions else ())}
    check_relations(
        (
            quantity in NAMED_QUANTITIES.get(name, [quantity]), f"{key}.name", name, quantity,
            f"the model gives the {quantity}, with which no other quantity is compared",
        ),
        *(
            (
                False, f"{key}.{one}", np.unique(coordinates[one].values).tolist(), "left out",
                f"the model has {without}; {key}.drop_vars({one!r}) neglects that",
            )
            for one, without in UNMODELLED_CONDITIONS.items() if one in {*coordinates} - modelled
        ),
    )  # fmt: skip


NAMED_QUANTITIES = {
    **{name: [name] for name in ALL_QUANTITIES},
    "reflectance": ["reflectance", "reflectance_factor"],
    "albedo": ["reflectance"],
    **{name: [] for name in ("absorptance", "brdf", "btdf", "mean_grain_distance")},
}
"""Quantities of a model with which a result of a name is compared; other names are of users."""
UNMODELLED_CONDITIONS = {
    "sky": "light of one incidence, not of a sky",
    POLAR: "no direction of observation",
    AZIMUTH: "no direction of observation",
}
"""Coordinates of results that a model may not have, with what it has instead."""


def is_same_label(values: Any, expected: Any) -> bool:
    """Return whether values are all equal to another, within the rounding of floats."""
    values, expected = np.asarray(values), np.asarray(expected)
    if values.dtype.kind in "biuf" and expected.dtype.kind in "biuf":
        if expected.size > 1 and values.shape != expected.shape:
            return False
        return bool(np.allclose(values, expected, rtol=LABEL_TOLERANCE, atol=0.0))
    return bool((values.astype(str) == expected.astype(str)).all())


def _read_bands(measured: Any, bands: Mapping[str, SpectralBand]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean wavelengths (nm) and the reflectances of bands; reject invalid ones."""
    values = np.atleast_1d(align_to_labels("measured", measured, list(bands), allow_gaps=True))
    found, allowed = f"{values.size} values", f"{len(bands)}, one for each band"
    check_relations((values.shape == (len(bands),), "measured", found, allowed))
    means = []
    for band in bands.values():
        wavelength = np.linspace(*band.limits_nm, 501)
        response = np.interp(wavelength, band.wavelength_nm, band.response)
        means.append((wavelength * response).sum() / response.sum())
    return np.array(means), values


def _read_spectrum(measured: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return wavelengths (nm) and reflectances; reject invalid ones."""
    allowed = "a DataArray over wavelength, a Series, or (wavelengths, reflectances)"
    if isinstance(measured, pd.DataFrame):
        hint = "choose one: frame['name'], with wavelengths (nm) for an index"
        found = f"a DataFrame of {measured.shape[1]} columns"
        check_relations((measured.shape[1] == 1, "measured", found, allowed, hint))
        measured = measured.iloc[:, 0]
    if isinstance(measured, xr.DataArray):
        is_spectrum = measured.dims == ("wavelength",) and "wavelength" in measured.coords
        found = f"over {', '.join(map(str, measured.dims))}"
        check_relations((is_spectrum, "measured", found, allowed))
        check_nanometres("measured", measured.wavelength)
        numbers = as_float_array("measured", measured, allow_gaps=True)
        numbers = convert_units("measured", numbers, measured.attrs.get("units"), "1")
        pair: Any = (measured.wavelength.values, numbers)
    elif isinstance(measured, pd.Series):
        is_default = isinstance(measured.index, pd.RangeIndex) and measured.index.start == 0
        hint = "pandas.read_csv(file, index_col=0)['name'], if the first column has them"
        check_relations(
            (
                not is_default, "measured", "a Series with a default index",
                "one over wavelengths (nm)", hint,
            )
        )  # fmt: skip
        pair = (measured.index.to_numpy(), measured.to_numpy())
    elif isinstance(measured, tuple | list) and len(measured) == 2:
        pair = measured
    else:
        raise invalid("measured", type(measured).__name__, allowed)
    has_labels = isinstance(measured, xr.DataArray | pd.Series)
    wavelength = check_wavelengths("measured (wavelengths)", pair[0], is_sorted=not has_labels)
    values = align_to_labels("measured", pair[1], wavelength, find_labels(pair[0]), allow_gaps=True)
    sizes = f"{wavelength.size} wavelengths, {values.size} values"
    allowed = "the same number of wavelengths and values"
    check_relations((values.shape == wavelength.shape, "measured", sizes, allowed))
    return wavelength, values


def _make_covariance(
    key: str, noise: Any, wavelength_nm: np.ndarray, bands: Sequence[str]
) -> np.ndarray:
    """Return the covariance of noise, in the order of wavelengths or bands.

    A mapping has noise that is correlated between nearby wavelengths.
    """
    n_values = wavelength_nm.size
    if isinstance(noise, Mapping):
        is_complete = {"stderr", "correlation_nm"} <= set(noise) <= {*NOISE_KEYS}
        allowed = " and ".join(NOISE_KEYS[:2])
        check_relations((is_complete, "noise", sorted(map(str, noise)), allowed))
        length = check_range(
            "noise.correlation_nm", noise["correlation_nm"], 0.0, 1e5, open_low=True
        )
        allowed = f"one standard error or {n_values} of them"
        check_relations((np.ndim(noise["stderr"]) <= 1, "noise.stderr", "a matrix", allowed))
        stderr = np.sqrt(
            np.diag(_make_covariance("noise.stderr", noise["stderr"], wavelength_nm, bands))
        )
        covariance = correlate_errors(stderr, wavelength_nm, length)
        if "independent" in noise:
            independent = noise["independent"]
            covariance += _make_covariance("noise.independent", independent, wavelength_nm, bands)
        return covariance
    allowed = f"standard errors in (0, 1), one or {n_values} of them, or their covariance"
    # A default index is no wavelength, but bands may be given in their order.
    labels = [bands] if bands else [wavelength_nm]
    values = align_to_labels(
        key, noise, *labels, allowed=allowed, ignore_default_labels=bool(bands)
    )
    if values.shape == (n_values, n_values):
        is_symmetric = np.allclose(values, values.T, rtol=ROUNDING_TOLERANCE, atol=0.0)
        largest, limit = float(np.diag(values).max()), MAX_NOISE_STDERR**2
        check_relations(
            (is_symmetric, key, "a matrix that is not symmetric", allowed),
            (
                np.linalg.eigvalsh(values)[0] > 0.0, key, "a matrix that is not positive definite",
                allowed,
            ),
            (largest < limit, key, f"a variance of {largest:g}", f"below {limit:g}", NOISE_HINT),
        )  # fmt: skip
        return values
    is_valid = (values > 0.0) & (values < MAX_NOISE_STDERR)
    wrong = next(iter(values[~is_valid].tolist()), 1.0)
    hint = "no measurement is without noise" if wrong <= 0.0 else NOISE_HINT
    check_relations(
        (values.shape in ((), (n_values,)), key, f"of shape {values.shape}", allowed),
        (is_valid.all(), key, wrong, allowed, hint),
    )
    return np.diag(np.broadcast_to(values, (n_values,)) ** 2)


def correlate_errors(stderr: np.ndarray, wavelength_nm: np.ndarray, length: float) -> np.ndarray:
    """Return the covariance of errors whose correlation at a distance d (nm) is e^(−d/length)."""
    distance = np.abs(wavelength_nm[:, np.newaxis] - wavelength_nm)
    covariance: np.ndarray = np.exp(-distance / length) * stderr[:, np.newaxis] * stderr
    return covariance
