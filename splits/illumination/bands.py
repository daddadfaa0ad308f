"""Spectral bands, given by limits, by spectral response or by the name of a sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd

from splits.core.arrays import ContentEquality, check_named_numbers
from splits.core.declarations import Quantity
from splits.core.keywords import declare_function
from splits.core.optional import import_optional
from splits.core.validation import check_choice, invalid, join_names, snap_to_limits, to_text_keys
from splits.materials.csv_table import read_csv, read_tabulated_function, to_columns

# --------------------------------------------------------------------------------------------------
# Bands of sensors: tables of pyrsr, and Gaussian responses of published centres and widths.

PYRSR_SENSORS = {
    "landsat_5": ("Landsat-5", "TM"),
    "landsat_7": ("Landsat-7", "ETM+"),
    "landsat_8": ("Landsat-8", "OLI_TIRS"),
    "landsat_9": ("Landsat-9", "OLI_TIRS"),
    "modis_aqua": ("Aqua", "MODIS"),
    "modis_terra": ("Terra", "MODIS"),
    "sentinel_2a": ("Sentinel-2A", "MSI"),
    "sentinel_2b": ("Sentinel-2B", "MSI"),
}
"""Satellite and instrument of every sensor whose responses are those of pyrsr."""
GAUSSIAN_SENSORS = (
    "emit",
    "enmap",
    "olci_sentinel_3a",
    "prisma",
    "slstr_sentinel_3a",
    "viirs_suomi_npp",
)
"""Sensors whose responses are Gaussian, with the centres and widths of sensors.csv."""
SENSORS = tuple(sorted((*PYRSR_SENSORS, *GAUSSIAN_SENSORS)))
HALF_RANGE_WIDTHS = 1.5
"""Range of a Gaussian response on either side of its centre, in widths; it is 1/512 at the ends."""
N_RESPONSE_POINTS = 37


@declare_function
def sensor_bands(name: str) -> dict[str, dict[str, np.ndarray]]:
    """Return the bands of a sensor in the form that `splits.albedo` takes.

    The responses of Landsat, MODIS and Sentinel-2 are the tables of pyrsr (extra ``sky``), which
    has bands 1 to 16 of MODIS.  The other sensors need no further package: their responses are
    Gaussian, with the centres and full widths at half maximum in ``illumination/sensors.csv``,
    which states the source of each.  Thermal bands are excluded.

    Parameters
    ----------
    name : str
        One of landsat_5, landsat_7, landsat_8, landsat_9, modis_aqua, modis_terra, sentinel_2a,
        sentinel_2b; or emit (285 bands), enmap (224), prisma (234), olci_sentinel_3a (Oa01 to
        Oa21), slstr_sentinel_3a (S1 to S6), viirs_suomi_npp (I1 to I3, M1 to M11).

    Returns
    -------
    dict
        By name, which consists of the sensor and the number of the band, so that bands of several
        sensors can be combined: ``wavelength_nm`` (nm) and ``response``, at most 1.

    Raises
    ------
    ValueError
        For an unknown sensor.
    ModuleNotFoundError
        Without pyrsr, for a sensor that needs it.

    Notes
    -----
    A Gaussian response is given at 37 wavelengths within 1.5 widths of the centre.  It is 0
    outside, where the Gaussian has 0.04 % of its area.  The measured responses of OLCI, SLSTR and
    VIIRS are closer to rectangles.  A Gaussian of the same width w (nm) has a larger variance, so
    that the mean of an albedo A over it differs by about 0.05 w² A'', where A'' is the second
    derivative with respect to wavelength.  The last VNIR bands of EnMAP and PRISMA overlap the
    first SWIR bands.  Centres and widths vary between scenes and across the swath.  For the
    analysis of a scene, use those of its metadata.

    Examples
    --------
    >>> import splits
    >>> bands = splits.sensor_bands("olci_sentinel_3a")
    >>> violet = bands["olci_sentinel_3a_Oa01"]
    >>> float(violet["wavelength_nm"][violet["response"].argmax()])
    400.0
    """
    check_choice("sensor", name, SENSORS)
    if name in GAUSSIAN_SENSORS:
        table = load_band_centres()
        offset_widths = np.linspace(-HALF_RANGE_WIDTHS, HALF_RANGE_WIDTHS, N_RESPONSE_POINTS)
        response = np.exp2(-4.0 * offset_widths**2)
        return {
            f"{name}_{row.band}": {
                "wavelength_nm": row.centre_nm + row.width_nm * offset_widths,
                "response": response.copy(),
            }
            for row in table[table.sensor == name].itertuples()
        }
    rsr = import_optional("pyrsr", "sky", "bands of this sensor need").RSR
    spectral_response = rsr(*PYRSR_SENSORS[name], no_thermal=True)
    wavelengths = np.asarray(spectral_response.rsrs_wvl, dtype=float)
    bands = {}
    for label, response in spectral_response.rsrs_norm01.items():
        # From the last zero before the first response to the first after the last.
        first, last = np.flatnonzero(response > 0.0)[[0, -1]]
        support = slice(max(first - 1, 0), last + 2)
        bands[f"{name}_{label}"] = {
            "wavelength_nm": wavelengths[support],
            "response": response[support].clip(0.0, 1.0),
        }
    return bands


@cache
def load_band_centres() -> pd.DataFrame:
    """Return the table of Gaussian bands: sensor, band, centre_nm and width_nm (nm)."""
    table = read_csv("sensors", Path(__file__).with_name("sensors.csv"))
    columns: dict[str, Any] = {name: table.get_texts(name) for name in ("sensor", "band")}
    columns |= {name: table.get_numbers(name) for name in ("centre_nm", "width_nm")}
    return pd.DataFrame(columns)


# --------------------------------------------------------------------------------------------------
# Spectral bands, given by limits, by spectral response or by the name of a sensor.

BAND_COLUMNS = ("wavelength_nm", "response")
BAND_STEP_NM = 5.0
"""Largest distance of wavelengths (nm) that are chosen for bands."""


@dataclass(frozen=True, eq=False, repr=False)
class SpectralBand(ContentEquality):
    """Spectral response of a band of a sensor.

    Attributes
    ----------
    wavelength_nm : float, shape (n,)
        Strictly increasing (nm).
    response : float, shape (n,)
        Relative response, linear between the wavelengths and 0 outside.
    sha256 : str
        SHA-256 of a user's file, otherwise empty.
    """

    wavelength_nm: np.ndarray
    response: np.ndarray
    sha256: str = ""

    @classmethod
    def from_limits(cls, low: float, high: float) -> SpectralBand:
        """Return the band with constant response from low to high (nm)."""
        return cls(np.array([low, high]), np.ones(2))

    @classmethod
    def from_input(cls, key: str, value: Any) -> SpectralBand:
        """Return the band for a user's value, after checking it.

        Parameters
        ----------
        key : str
            For messages.
        value : (float, float), mapping or path
            Its limits (nm), or a mapping of ``wavelength_nm`` and ``response``, or the path of a
            CSV file with these columns.

        Raises
        ------
        ValueError
            For a malformed band.
        """
        value = to_columns(value)
        if not isinstance(value, str | Path | Mapping):
            low, high = check_named_numbers(key, value, ("low", "high"))
            if not 0.0 < low < high:
                raise invalid(key, value, "0 < low < high (nm)")
            return cls.from_limits(low, high)
        (wavelengths, response), digest = read_tabulated_function(
            key, value, BAND_COLUMNS, "its limits (nm), or "
        )
        response = snap_to_limits(response, 0.0, np.inf)
        if response.min() < 0.0 or not response.any():
            raise invalid(
                f"{key}.response", float(response.min()), "at least 0, and not 0 everywhere"
            )
        return cls(wavelengths, response, digest)

    def __repr__(self) -> str:
        """Return the band on one line."""
        return f"SpectralBand({self.limits_nm[0]:g} to {self.limits_nm[1]:g} nm)"

    @property
    def limits_nm(self) -> tuple[float, float]:
        """First and last wavelength (nm)."""
        return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])


def as_bands(bands: Any) -> dict[str, SpectralBand]:
    """Return the bands of a user's value, after checking them."""
    if bands is None:
        return {}
    if isinstance(bands, str):
        check_choice("bands", bands, SENSORS)
        bands = sensor_bands(bands)
    if not isinstance(bands, Mapping):
        allowed = "a mapping of names to bands, or one of " + join_names(SENSORS)
        raise invalid("bands", bands, allowed)
    named = to_text_keys("bands", bands)
    return {name: SpectralBand.from_input(f"bands.{name}", band) for name, band in named.items()}


def check_bands(bands: Any) -> dict[str, SpectralBand]:
    """Return the bands of a user's value, at least one, after checking them."""
    named = as_bands(bands)
    if not named:
        raise invalid("bands", bands, "at least one band, or left out")
    return named


def choose_band_wavelengths(
    bands: Mapping[str, SpectralBand], low_nm: float = 0.0, high_nm: float = np.inf
) -> np.ndarray:
    """Return wavelengths (nm) across all bands, as far as these are within two limits (nm)."""
    limits = np.sort([band.limits_nm for band in bands.values()], axis=0)
    limits = np.clip(limits, low_nm, high_nm)
    # Sorted lows and highs: a gap is where a band begins above the ends of as many bands.
    is_start = np.concatenate([[True], limits[1:, 0] > limits[:-1, 1]])
    is_end = np.concatenate([is_start[1:], [True]])
    grids = [
        np.linspace(low, high, 1 + max(1, int(np.ceil((high - low) / BAND_STEP_NM))))
        for low, high in zip(limits[is_start, 0], limits[is_end, 1], strict=True)
    ]
    return np.unique(np.concatenate(grids))


class SpectralOperator(NamedTuple):
    """Linear operator from a spectrum to measured values, such as means over bands.

    Attributes
    ----------
    weights : float, shape (values, wavelengths)
    error_weights : float, shape (estimates, values, wavelengths)
        Weights of estimates of the error of interpolation between wavelengths, whose squares add.
    """

    weights: np.ndarray
    error_weights: np.ndarray

    @classmethod
    def from_bands(
        cls, bands: Mapping[str, SpectralBand], wavelengths: np.ndarray
    ) -> SpectralOperator:
        """Return the response-weighted means over bands, which must be within wavelengths (nm)."""
        makers = [partial(compute_response_weights, name, band) for name, band in bands.items()]
        error_weights = [compute_mean_error_weights(make, wavelengths) for make in makers]
        return cls(np.array([make(wavelengths) for make in makers]), np.stack(error_weights, 1))


RESOLVED_STEP_NM = 20.0
"""Largest step of wavelengths that resolves the absorption bands of ice, water and minerals."""


def compute_mean_error_weights(
    make_weights: Callable[..., np.ndarray], wavelengths: np.ndarray
) -> np.ndarray:
    """Return weights, shape (estimates, wavelengths), of estimates of an error, whose squares add.

    The mean is that of a spectrum that is linear between wavelengths.  A curvature within the
    intervals shows in the difference from cubics, and an edge, as of an absorption band, in that
    from a mean without every other wavelength.  The latter has four times the error, as the error
    of linear interpolation is proportional to the square of the interval.  This does not hold where
    wavelengths are so far apart that they do not resolve absorption bands: there, a value between
    them is not better known than one of them would be from the others.

    Parameters
    ----------
    make_weights : callable
        From wavelengths, and ``n_nodes`` of the polynomials between them, to the weights of the
        mean over a band; without light, these are NaN.
    wavelengths : float, shape (wavelengths,)
    """
    weights = make_weights(wavelengths)
    error_weights = np.zeros((2, wavelengths.size))
    used = np.flatnonzero(np.nan_to_num(weights))
    if used.size:
        error_weights[0] = weights - make_weights(wavelengths, n_nodes=4)
        kept = np.delete(np.arange(wavelengths.size), np.arange(used[0] + 1, used[-1], 2))
        error_weights[1] = weights / 3.0
        error_weights[1, kept] -= make_weights(wavelengths[kept]) / 3.0
    coarse, deviations = _predict_coarse_nodes(tuple(wavelengths.tolist()))
    by_node = np.nan_to_num(weights[coarse])[:, np.newaxis] * deviations
    return np.concatenate([error_weights, by_node])


@lru_cache(maxsize=16)
def _predict_coarse_nodes(wavelengths: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the wavelengths far from a neighbour, and weights of what all others predict for each.

    Returns
    -------
    nodes : int, shape (nodes,)
    deviations : float, shape (nodes, wavelengths)
        Weights of the prediction minus the value.
    """
    w = np.array(wavelengths)
    gaps = np.pad(np.diff(w), 1)
    nodes = np.flatnonzero(np.maximum(gaps[:-1], gaps[1:]) > RESOLVED_STEP_NM)
    deviations = np.zeros((nodes.size, w.size))
    for row, node in zip(deviations, nodes, strict=True):
        others = np.delete(np.arange(w.size), node)
        row[others] = interpolate_locally(w[others], w[[node]], 4)[0]
        row[node] = -1.0
    return nodes, deviations


def compute_response_weights(
    name: str, band: SpectralBand, wavelengths: np.ndarray, n_nodes: int = 2
) -> np.ndarray:
    """Return the weights of the wavelengths in the response-weighted mean over a band.

    The spectrum is interpolated by polynomials through the nearest nodes, 2 for a linear one.
    """
    nodes = snap_to_limits(band.wavelength_nm, wavelengths[0], wavelengths[-1])
    low, high = nodes[[0, -1]].tolist()
    if low < wavelengths[0] or high > wavelengths[-1]:
        allowed = f"within the table's {wavelengths[0]:g} to {wavelengths[-1]:g} nm"
        raise invalid(f"bands[{name!r}]", [low, high], allowed)
    inside = wavelengths[(wavelengths > low) & (wavelengths < high)]
    breakpoints = np.unique(np.concatenate([nodes, inside]))
    # Where spectrum and response are linear between these points, Simpson's rule is exact.
    points = np.stack(
        [breakpoints[:-1], 0.5 * (breakpoints[:-1] + breakpoints[1:]), breakpoints[1:]]
    )
    simpson = np.array([[1.0], [4.0], [1.0]]) * np.diff(breakpoints) / 6.0
    factors = np.interp(points, nodes, band.response) * simpson
    weights: np.ndarray = factors.ravel() @ interpolate_locally(
        wavelengths, points.ravel(), n_nodes
    )
    return weights / weights.sum()


def interpolate_locally(nodes: np.ndarray, points: np.ndarray, n_nodes: int) -> np.ndarray:
    """Return weights of the polynomials through the nearest nodes, shape (points, nodes)."""
    size = min(n_nodes, nodes.size)
    first = np.clip(np.searchsorted(nodes, points) - size // 2, 0, nodes.size - size)
    stencil = first[:, np.newaxis] + np.arange(size)
    distances = points[:, np.newaxis] - nodes[stencil]
    weights = np.zeros((points.size, nodes.size))
    for i in range(size):
        others = np.delete(np.arange(size), i)
        spans = nodes[stencil[:, [i]]] - nodes[stencil[:, others]]
        weights[np.arange(points.size), stencil[:, i]] = (distances[:, others] / spans).prod(axis=1)
    return weights


def _check_bands(_: str, bands: Any) -> Any:
    as_bands(bands)
    return bands


Bands = Annotated[
    Mapping[str, Any] | str | None,
    Quantity(
        "limits (nm) or spectral responses of bands by name, or the name of a sensor",
        check=_check_bands, schema={"type": ["object", "string"]},
    ),
]  # fmt: skip
