"""What SPLITSnow's paper states about its model, simulated under any set of readings.

Stages from cheap to costly, each a set of statements (numbers of the tables and figures, trends in
words) and the runs that give our values.  Waters stand side by side in one run: their tables differ
in absorption, which is exact along shared paths, so that each costs no rays of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import xarray as xr

from splits.analysis.angular_trends import LAMBERTIAN
from splits.analysis.directions import principal_plane
from splits.analysis.misfit import TREND_BAR, Statement
from splits.analysis.sensitivity import spectra_sensitivity
from splits.instruments import goniophotometer, spectrophotometer
from splits.materials.datasets import dataset
from splits.materials.kinds import Tabulated
from splits.media import Readings, Snow

Values = dict[str, tuple[np.ndarray, np.ndarray]]
"""Ours and its standard error by name of the statement, both of shape (waters,)."""

WATERS = ("hale_querry_1973", "hale_querry_1973, linear in k", "segelstein_1981")
"""Tables of water.  Of the four that the paper cites, Hale & Querry's is at hand; it is coarse, and
how one goes between its rows matters.  Segelstein's compilation stands for the finer ones."""

_BESIDE_NM = 1e-3
"""Distance of the places at which waters stand side by side."""

TABLE3_NM = {"table3_842": 842.25, "table3_1074": 1073.76, "table3_1238": 1237.93}
RANGES: dict[str, tuple[Any, ...]] = {
    "grain_size": ((100, 200), (900, 1000)),
    "facetness": ((0, 0.2, 0.1, 0.072), (0.8, 1, 0.9, 0.072)),
    "saturation": (0.0, 0.1, 0.3, 1.0),
    "density": (100.0, 200.0, 400.0, 450.0),
}
"""Extremes between which sensitivities are taken (section 5.4).  The paper does not say those of
saturation and density: any two of these values may have been meant."""

KEYWORDS = {
    "grain_size": "grain_size_um", "facetness": "facetness", "saturation": "saturation",
    "density": "density_kg_m3",
}  # fmt: skip
SPECTRA = {
    "r": ("reflectance", 0.12, np.arange(400.0, 2501.0, 50.0)),
    "t": ("transmittance", 0.02, np.arange(400.0, 1421.0, 30.0)),
}
"""Quantity, depth (m) and wavelengths behind the sensitivities."""


FLOORS = (0.0, 0.005, 0.02)
"""Transmittances that may have counted as none in a sensitivity: the paper does not say, and where
two of them are small their ratio is large."""
MOST_RAYS = 1_000_000
"""Rays of a BRDF, for lobes of coarse dark grains that no rays resolve."""


class Errors(NamedTuple):
    """Standard errors of the runs: of hemispherical values, and relative ones of BRDFs."""

    bands: float = 0.006
    transmittance: float = 0.002
    reflectances: float = 0.012
    transmittances: float = 0.005
    brdf: float = 0.08
    lobes: float = 0.04

    def times(self, factor: float) -> Errors:
        """Return errors so many times as large, of which no run makes more than 0.5."""
        return Errors(*(min(factor * error, 0.5) for error in self))


@dataclass(frozen=True)
class Trial:
    """Snow of Table 1 under one set of readings.

    Attributes
    ----------
    readings : Readings
    seed : int
    errors : Errors
    """

    readings: Readings
    seed: int
    errors: Errors

    def snow(self, **settings: Any) -> Snow:
        """Return snow of Table 1 with some settings of its own."""
        return Snow(readings=self.readings, **settings)

    def spectra(
        self, wavelength_nm: Any, error: float, incidence: float = 0.0, **settings: Any
    ) -> list[xr.Dataset]:
        """Return hemispherical values with each water."""
        places, table = beside(np.asarray(wavelength_nm, dtype=float))
        snow = self.snow(refractive_index={"water": table}, **settings)
        found = spectrophotometer(snow, places, incidence, error, self.seed, threads=1)
        return [found.isel(wavelength=slice(w, None, len(WATERS))) for w in range(len(WATERS))]

    def plane(
        self, wavelength_nm: float | list[float], incidence: float, lobes: bool = False,
        **settings: Any,
    ) -> xr.Dataset:  # fmt: skip
        """Return the BRDF in the principal plane, with the first water."""
        error = self.errors.lobes if lobes else self.errors.brdf
        run = goniophotometer(
            self.snow(**settings), np.atleast_1d(wavelength_nm), incidence, seed=self.seed,
            relative_stderr=error, azimuth_deg=[0.0, 180.0],
            polar_deg=np.arange(0.0, 83.0, 7.5), threads=1, max_rays=MOST_RAYS,
        )  # fmt: skip
        return principal_plane(run)

    @cached_property
    def oblique(self) -> xr.Dataset:
        """BRDF of Table 1's snow under 60°, which several figures share."""
        return self.plane(600.0, 60.0)

    @cached_property
    def steep(self) -> xr.Dataset:
        """BRDF of 25 cm of snow under 69.3° at 600 and 1800 nm."""
        return self.plane([600.0, 1800.0], 69.3, depth_m=0.25)


def beside(wavelength_nm: np.ndarray) -> tuple[np.ndarray, dict[str, list[float]]]:
    """Return wavelengths (nm) at which each water stands, and a table of water that has them."""
    places = (wavelength_nm[:, np.newaxis] + _BESIDE_NM * np.arange(len(WATERS))).ravel()
    hale = cast(Tabulated, dataset("water", "hale_querry_1973"))
    linear = [np.interp(wavelength_nm, hale.wavelength_nm, y) for y in (hale.n, hale.k)]
    index = np.stack(
        [
            hale(wavelength_nm),
            linear[0] + 1j * linear[1],
            dataset("water", "segelstein_1981")(wavelength_nm),
        ],
        axis=1,
    ).ravel()
    table = {"wavelength_nm": places, "n": index.real, "k": index.imag}
    return places, {name: column.tolist() for name, column in table.items()}


def _distance(trial: Trial) -> Values:
    return {"grain_distance": _same(trial.snow(density_kg_m3=450.0).mean_grain_distance_m, 0.0)}


def _table3(trial: Trial) -> Values:
    spectra = trial.spectra(list(TABLE3_NM.values()), trial.errors.bands, 62.3, depth_m=0.25)
    both = [
        np.array([one[name].values for one in spectra])
        for name in ("reflectance", "reflectance_stderr")
    ]
    return {name: (both[0][:, i], both[1][:, i]) for i, name in enumerate(TABLE3_NM)}


def _transmittance(trial: Trial) -> Values:
    """Return the largest transmittance, where snow absorbs least (Fig 7)."""
    spectra = trial.spectra(np.arange(400.0, 501.0, 20.0), trial.errors.transmittance)
    best = [one.isel(wavelength=int(one.transmittance.values.argmax())) for one in spectra]
    value, error = (
        np.array([float(one[name]) for one in best])
        for name in ("transmittance", "transmittance_stderr")
    )
    return {"transmittance_max": (value, error)}


def _sensitivities(parameters: Sequence[str], letters: Sequence[str]) -> Callable[[Trial], Values]:
    """Return the stage that takes indices: arrays of shape (waters, pairs, floors)."""

    def measured(trial: Trial) -> Values:
        found: Values = {}
        for parameter, letter in itertools.product(parameters, letters):
            quantity, depth, places = SPECTRA[letter]
            error = getattr(trial.errors, f"{quantity}s")
            ends = [
                trial.spectra(places, error, **{KEYWORDS[parameter]: value, "depth_m": depth})
                for value in RANGES[parameter]
            ]
            floors = FLOORS if quantity == "transmittance" else FLOORS[:1]
            found[f"msi_{letter}_{parameter}"] = _indices(ends, quantity, floors)
        return found

    return measured


def _indices(
    ends: Sequence[list[xr.Dataset]], quantity: str, floors: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices between all pairs of spectra, shape (waters, pairs, floors)."""
    pairs = list(itertools.combinations(ends, 2))
    value = np.empty((2, len(WATERS), len(pairs), len(floors)))
    for w, p, f in np.ndindex(value.shape[1:]):
        y, z = (end[w] for end in pairs[p])
        index = spectra_sensitivity(y, z, quantity, floors[f])
        value[:, w, p, f] = index.index, index.stderr
    return value[0], value[1]


def _incidence(trial: Trial) -> Values:
    """Return the trends of Fig 19: nearly Lambertian at 0°, a peak at 30°, a larger one at 60°."""
    upright, tilted = trial.plane(600.0, 0.0), trial.plane(600.0, 30.0)
    inner = upright.sel(angle=slice(-60.0, 60.0)).isel(wavelength=0)
    value, noise = _spread(inner)
    peaks = [_peak(plane) for plane in (tilted, trial.oblique)]
    return {
        "fig19_lambertian": _same(LAMBERTIAN - value, noise),
        "fig19_peak_30": _same(*peaks[0]),
        "fig19_peak_60": _same(*peaks[1]),
        "fig19_peak_grows": _same(*_difference(peaks[1], peaks[0])),
    }


def _nadir(trial: Trial) -> Values:
    """Return the trends of Figs 16 to 18: where light falls steeply the nadir is dark."""
    bright, dark = (trial.steep.isel(wavelength=[i]) for i in (0, 1))
    sides = [_side(dark, angle) for angle in (-60.0, 60.0)]
    darker = min(sides, key=lambda side: side[0])
    limbs = [
        _limb(plane)
        for plane in (
            trial.plane(600.0, 52.8, depth_m=0.25), bright,
            trial.plane(600.0, 84.8, depth_m=0.25),
        )
    ]  # fmt: skip
    grows = [_difference(b, a) for a, b in itertools.pairwise(limbs)]
    return {
        "fig16_nadir_dark": _same(*min(limbs)),
        "fig16_grows": _same(*min(grows)),
        "fig17_nadir_dark": _same(*darker),
        "fig18_varies_more": _same(*_difference(_range(dark), _range(bright))),
    }


def _grains(trial: Trial) -> Values:
    """Return the trends of Figs 20 to 22: forward peaks by grain size and facetness."""
    shown = {}
    for place, name, sign in (
        (600.0, "fig20_fine_least", -1.0), (1450.0, "fig21_fine_most", 1.0),
    ):  # fmt: skip
        *others, fine = (
            _top(trial.plane(place, 67.0, lobes=size[1] > 300, grain_size_um=size))
            for size in ((1500, 3000), (300, 750), (30, 300))
        )
        steps = [(sign * (fine[0] / o[0] - 1.0), _ratio_error(fine, o)) for o in others]
        shown[name] = _same(*min(steps))
    faceted = [
        _range(trial.plane(600.0, 60.0, lobes=True, facetness=facetness)) for facetness in (
            (0, 0.2, 0.1, 0.072), (0.8, 1, 0.9, 0.072))
    ]  # fmt: skip
    middle = _range(trial.oblique)
    steps = [_difference(faceted[0], other) for other in (middle, faceted[1])]
    return {**shown, "fig22_rounded_varies_most": _same(*min(steps))}


STAGES: dict[str, Callable[[Trial], Values]] = {
    "distance": _distance,
    "table 3": _table3,
    "facetness": _sensitivities(("facetness",), ("r",)),
    "angles": _incidence,
    "transmittance": _transmittance,
    "facetness below": _sensitivities(("facetness",), ("t",)),
    "grain size": _sensitivities(("grain_size",), ("r", "t")),
    "nadir": _nadir,
    "grains": _grains,
    "free ranges": _sensitivities(("saturation", "density"), ("r", "t")),
}
"""Runs in the order in which they tell most for their cost; each gives our values of some
statements."""

NUMBERS = {
    "distance": ("grain_distance",),
    "table 3": tuple(TABLE3_NM),
    "facetness": ("msi_r_facetness",),
    "transmittance": ("transmittance_max",),
    "facetness below": ("msi_t_facetness",),
    "grain size": ("msi_r_grain_size", "msi_t_grain_size"),
    "free ranges": (
        "msi_r_saturation", "msi_t_saturation", "msi_r_density", "msi_t_density",
    ),
}  # fmt: skip
"""Published numbers by stage, under their ids in the table of published numbers."""

TRENDS: Mapping[str, Mapping[str, str]] = {
    "angles": {
        "fig19_lambertian": "Fig 19", "fig19_peak_30": "Fig 19", "fig19_peak_60": "Fig 19",
        "fig19_peak_grows": "Fig 19",
    },
    "nadir": {
        "fig16_nadir_dark": "Fig 16", "fig16_grows": "Fig 16", "fig17_nadir_dark": "Fig 17",
        "fig18_varies_more": "Fig 18",
    },
    "grains": {
        "fig20_fine_least": "Fig 20", "fig21_fine_most": "Fig 21",
        "fig22_rounded_varies_most": "Fig 22",
    },
}  # fmt: skip
"""Trends by stage, and where the paper states them."""


def trends_stated(stage: str) -> dict[str, Statement]:
    """Return the trends of a stage."""
    return {
        name: Statement(name, place, 0.0, TREND_BAR, trend=True)
        for name, place in TRENDS.get(stage, {}).items()
    }


def _same(value: float, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a value that no water moves."""
    return np.full(len(WATERS), value), np.full(len(WATERS), error)


def _peak(plane: xr.Dataset) -> tuple[float, float]:
    """Return the forward peak's height above the nadir, in units of the nadir."""
    return _over_nadir(plane, plane.angle.sel(angle=slice(45.0, 82.5)).values)


def _limb(plane: xr.Dataset) -> tuple[float, float]:
    """Return the same of the brightest angle beyond 45° on either side."""
    return _over_nadir(plane, plane.angle.values[np.abs(plane.angle.values) >= 45.0])


def _side(plane: xr.Dataset, angle: float) -> tuple[float, float]:
    return _over_nadir(plane, np.array([angle]))


def _over_nadir(plane: xr.Dataset, angles: np.ndarray) -> tuple[float, float]:
    part = plane.isel(wavelength=0)
    some, nadir = part.sel(angle=angles), part.sel(angle=0.0)
    top = some.isel(angle=int(np.argmax(some.brdf.values)))
    pair = [(float(at.brdf), float(at.brdf_stderr)) for at in (top, nadir)]
    return pair[0][0] / pair[1][0] - 1.0, _ratio_error(*pair)


def _top(plane: xr.Dataset) -> tuple[float, float]:
    """Return the BRDF at the forward peak."""
    part = plane.isel(wavelength=0).sel(angle=slice(45.0, 82.5))
    top = part.isel(angle=int(np.argmax(part.brdf.values)))
    return float(top.brdf), float(top.brdf_stderr)


def _range(plane: xr.Dataset) -> tuple[float, float]:
    """Return the range of the BRDF within 75° in units of its mean."""
    return _spread(plane.isel(wavelength=0).sel(angle=slice(-75.0, 75.0)))


def _spread(part: xr.Dataset) -> tuple[float, float]:
    """Return the largest difference along angles in units of the mean."""
    ends = [part.isel(angle=int(i(part.brdf.values))) for i in (np.argmax, np.argmin)]
    mean = float(part.brdf.mean())
    value = float(ends[0].brdf - ends[1].brdf) / mean
    return value, float(np.hypot(float(ends[0].brdf_stderr), float(ends[1].brdf_stderr))) / mean


def _difference(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    return a[0] - b[0], float(np.hypot(a[1], b[1]))


def _ratio_error(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Return the error of a/b."""
    return float(a[0] / b[0] * np.hypot(a[1] / a[0], b[1] / b[0]))
