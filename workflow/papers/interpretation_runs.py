"""Simulations of the statements of SPLITSnow for an interpretation of the paper and several waters.

All waters are simulated in one run.  Their refractive indices differ mainly in absorption, which is
evaluated exactly along shared paths, so additional waters need no additional rays.

Stages are ordered from cheap to costly.  Each is a set of statements (numbers of tables and
figures, qualitative trends) and the runs that give our values.  Peaks and limbs of BRDFs are means
over 60° to 75° in the principal plane, because the maximum of noisy values is biased.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.core.keywords import nest_runs
from splits.instruments.goniophotometer import goniophotometer
from splits.instruments.solver import MONTE_CARLO
from splits.instruments.spectrophotometer import spectrophotometer
from splits.materials.library import load_dataset
from splits.materials.refractive_index import TabulatedIndex
from splits.media import Interpretation, Snow
from workflow.papers.angles import MAX_LAMBERTIAN_RANGE, compute_relative_range, get_brdf
from workflow.papers.sensitivity import compute_spectral_sensitivity
from workflow.papers.statements import Estimate

TREND_TOLERANCE = 0.1
"""Tolerance of a trend, relative to the compared quantity (nadir BRDF, height of a peak)."""


@dataclass(frozen=True)
class PublishedStatement:
    """A number or trend that a paper states.

    Attributes
    ----------
    name, place : str
        Its id, and its place in the paper.
    published : float
        The number, or 0 for a trend, which is satisfied by positive values.
    tolerance : float
        Above 0.
    is_trend : bool
        Whether only values below `published` add to the misfit.
    """

    name: str
    place: str
    published: float
    tolerance: float
    is_trend: bool = False

    def normalize_difference(self, ours: np.ndarray | float) -> np.ndarray:
        """Return the signed difference in units of the tolerance; 0 for a satisfied trend."""
        difference = (np.asarray(ours, dtype=float) - self.published) / self.tolerance
        return np.minimum(difference, 0.0) if self.is_trend else difference


WATER_TABLES = ("hale_querry_1973", "hale_querry_1973, linear in k", "segelstein_1981")
"""Tables of water.  Of the four that the paper cites, that of Hale & Querry is available; it is
coarse, so the interpolation between its rows matters.  Segelstein's compilation represents the
finer ones."""

StatementValues = dict[str, tuple[np.ndarray, np.ndarray]]
"""Our values and standard errors by statement, over waters; for sensitivities also over pairs of
extremes and floors."""

_WATER_OFFSET_NM = 1e-3
"""Offset between the wavelengths of successive waters (nm)."""

ANGLE_STEP_DEG = 7.5
ANGLES_PER_SECTOR = 3
"""Step of angles in the principal plane up to 75°, and number of angles in a sector of 22.5°."""
MAX_BRDF_RAYS = 1_000_000
"""Largest number of rays of a BRDF, since lobes of coarse absorbing grains may stay unresolved."""


class TargetErrors(NamedTuple):
    """Target standard errors: absolute for hemispherical values, relative for BRDFs."""

    bands: float = 0.006
    transmittance: float = 0.002
    reflectances: float = 0.012
    transmittances: float = 0.005
    brdf: float = 0.05
    lobes: float = 0.03

    def scale(self, factor: float) -> TargetErrors:
        """Return the errors multiplied by a factor, at most 0.5 each."""
        return TargetErrors(*(min(factor * error, 0.5) for error in self))


@dataclass(frozen=True)
class InterpretationRun:
    """Simulations of the snow of Table 1 for one interpretation.

    Attributes
    ----------
    interpretation : Interpretation
    seed : int
    errors : TargetErrors
    """

    interpretation: Interpretation
    seed: int
    errors: TargetErrors

    def make_snow(self, **settings: Any) -> Snow:
        """Return the snow of Table 1 with some settings changed."""
        return Snow(interpretation=self.interpretation, **settings)

    def simulate_spectra(
        self, wavelength_nm: Any, error: float, incidence: float = 0.0, run_number: int = 0,
        **settings: Any,
    ) -> list[xr.Dataset]:  # fmt: skip
        """Return hemispherical spectra for each water.

        Runs with different numbers are independent, as their comparison assumes.
        """
        wavelengths, table = interleave_waters(np.asarray(wavelength_nm, dtype=float))
        snow = self.make_snow(refractive_index={"water": table}, **settings)
        spectra = spectrophotometer(
            snow,
            wavelengths,
            incidence,
            max_stderr=error,
            seed=self.seed + run_number,
            solver=MONTE_CARLO,
            threads=1,
        )
        return [
            spectra.isel(wavelength=slice(water, None, len(WATER_TABLES)))
            for water in range(len(WATER_TABLES))
        ]

    def simulate_plane(
        self, wavelength_nm: float | list[float], incidence: float, lobes: bool = False,
        run_number: int = 0, **settings: Any,
    ) -> xr.Dataset:  # fmt: skip
        """Return the BRDF in the principal plane by sector, for the first water.

        Runs with different numbers are independent.
        """
        error = self.errors.lobes if lobes else self.errors.brdf
        # The ranking uses the errors that the runs reach, whatever ends them.
        with nest_runs():
            run = goniophotometer(
                self.make_snow(**settings),
                np.atleast_1d(wavelength_nm),
                incidence,
                seed=self.seed + run_number,
                relative_stderr=error,
                solver=MONTE_CARLO,
                azimuth_deg=[0.0, 180.0],
                polar_deg=np.arange(0.0, 76.0, ANGLE_STEP_DEG),
                threads=1,
                max_rays=MAX_BRDF_RAYS,
            )
        return average_sectors(select_principal_plane(run))

    @cached_property
    def oblique_plane(self) -> xr.Dataset:
        """BRDF of the snow of Table 1 at an incidence of 60°, which several figures use."""
        return self.simulate_plane(600.0, 60.0)


def interleave_waters(wavelength_nm: np.ndarray) -> tuple[np.ndarray, dict[str, list[float]]]:
    """Return interleaved wavelengths (nm) of all waters, and their refractive indices."""
    wavelengths = (
        wavelength_nm[:, np.newaxis] + _WATER_OFFSET_NM * np.arange(len(WATER_TABLES))
    ).ravel()
    hale = cast(TabulatedIndex, load_dataset("water", "hale_querry_1973"))
    linear = [np.interp(wavelength_nm, hale.wavelength_nm, y) for y in (hale.n, hale.k)]
    index = np.stack(
        [
            hale(wavelength_nm),
            linear[0] + 1j * linear[1],
            load_dataset("water", "segelstein_1981")(wavelength_nm),
        ],
        axis=1,
    ).ravel()
    table = {"wavelength_nm": wavelengths, "n": index.real, "k": index.imag}
    return wavelengths, {name: column.tolist() for name, column in table.items()}


def average_sectors(plane: xr.Dataset) -> xr.Dataset:
    """Return means over sectors of 22.5° around -67.5°, -45°, ... 67.5°.

    Fixed sectors represent peaks and limbs, because the maximum of noisy values is biased.  Errors
    within a sector are assumed to be fully correlated.
    """
    parts = plane[["brdf", "brdf_stderr"]].coarsen(angle=ANGLES_PER_SECTOR)
    return parts.mean().assign_coords(wavelength=plane.wavelength)


def repeat_for_waters(value: float, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a value that does not depend on water and its error, both of shape (waters,)."""
    return np.full(len(WATER_TABLES), value), np.full(len(WATER_TABLES), error)


TABLE3_WAVELENGTHS_NM = {"table3_842": 842.25, "table3_1074": 1073.76, "table3_1238": 1237.93}
PARAMETER_EXTREMES: dict[str, tuple[Any, ...]] = {
    "grain_size": ((100, 200), (900, 1000)),
    "facetness": ((0, 0.2, 0.1, 0.072), (0.8, 1, 0.9, 0.072)),
    "saturation": (0.0, 0.1, 0.3, 1.0),
    "density": (100.0, 200.0, 400.0, 450.0),
}
"""Extremes of parameters for sensitivities (section 5.4).  The paper does not state those of
saturation and density, so any two of these values are considered."""

SNOW_KEYWORDS = {
    "grain_size": "grain_size_um", "facetness": "facetness", "saturation": "saturation",
    "density": "density_kg_m3",
}  # fmt: skip
SENSITIVITY_SPECTRA = {
    "r": ("reflectance", 0.12, np.arange(400.0, 2501.0, 50.0)),
    "t": ("transmittance", 0.02, np.arange(400.0, 1421.0, 30.0)),
}
"""Quantity, depth (m) and wavelengths (nm) of the sensitivities."""


TRANSMITTANCE_FLOORS = (0.0, 0.005, 0.02)
"""Transmittances below which values may have counted as 0 in a sensitivity.  The paper states no
threshold, and the ratio of two small values is large."""
LIMB_ANGLES_DEG = (-67.5, 67.5)
"""Middle of the outermost sectors of a principal plane (degrees)."""


def _compute_grain_distance(run: InterpretationRun) -> StatementValues:
    distance = run.make_snow(density_kg_m3=450.0).mean_grain_distance_m
    return {"grain_distance": repeat_for_waters(distance, 0.0)}


def _compute_table3(run: InterpretationRun) -> StatementValues:
    spectra = run.simulate_spectra(
        list(TABLE3_WAVELENGTHS_NM.values()), run.errors.bands, 62.3, depth_m=0.25
    )
    value, error = (
        np.array([spectrum[name].values for spectrum in spectra]).T
        for name in ("reflectance", "reflectance_stderr")
    )
    return dict(zip(TABLE3_WAVELENGTHS_NM, zip(value, error, strict=True), strict=True))


def _compute_max_transmittance(run: InterpretationRun) -> StatementValues:
    """Return the largest transmittance, at the wavelengths where snow absorbs least (Fig 7)."""
    spectra = run.simulate_spectra(np.arange(400.0, 501.0, 20.0), run.errors.transmittance)
    best = [
        Estimate.from_dataset(s, "transmittance")
        .isel(wavelength=int(s.transmittance.argmax("wavelength")))
        .to_floats()
        for s in spectra
    ]
    value, error = np.transpose(best)
    return {"transmittance_max": (value, error)}


def _make_sensitivity_stage(
    parameters: Sequence[str], letters: Sequence[str]
) -> Callable[[InterpretationRun], StatementValues]:
    """Return the stage that computes sensitivity indices, shape (waters, pairs, floors)."""

    def compute(run: InterpretationRun) -> StatementValues:
        values: StatementValues = {}
        for parameter, letter in itertools.product(parameters, letters):
            quantity, depth, wavelengths = SENSITIVITY_SPECTRA[letter]
            error = getattr(run.errors, f"{quantity}s")
            spectra = []
            for number, extreme in enumerate(PARAMETER_EXTREMES[parameter], start=1):
                settings = {SNOW_KEYWORDS[parameter]: extreme, "depth_m": depth}
                run_spectra = run.simulate_spectra(wavelengths, error, 0.0, number, **settings)
                spectra.append(run_spectra)
            floors = TRANSMITTANCE_FLOORS[: None if quantity == "transmittance" else 1]
            indices = _compute_sensitivity_indices(spectra, quantity, floors)
            values[f"msi_{letter}_{parameter}"] = indices
        return values

    return compute


def list_extreme_pairs(parameter: str) -> list[str]:
    """Return the labels of the pairs of extremes of a parameter, in the order of the indices."""

    def format_extreme(value: Any) -> str:
        limits = np.atleast_1d(value)[:2]
        return "-".join(f"{limit:g}" for limit in limits)

    return [
        f"{format_extreme(low)} / {format_extreme(high)}"
        for low, high in itertools.combinations(PARAMETER_EXTREMES[parameter], 2)
    ]


def _compute_sensitivity_indices(
    ends: Sequence[list[xr.Dataset]], quantity: str, floors: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices between all pairs of spectra, shape (waters, pairs, floors)."""
    pairs = list(itertools.combinations(ends, 2))
    value = np.empty((2, len(WATER_TABLES), len(pairs), len(floors)))
    for w, p, f in np.ndindex(value.shape[1:]):
        y, z = (end[w] for end in pairs[p])
        index = compute_spectral_sensitivity(y, z, quantity, floors[f])
        value[:, w, p, f] = index.index, index.stderr
    return value[0], value[1]


def _compute_incidence_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Fig 19: nearly Lambertian at 0°, a peak at 30°, a larger one at 60°."""
    upright, tilted = (
        run.simulate_plane(600.0, incidence, run_number=number)
        for incidence, number in ((0.0, 1), (30.0, 2))
    )
    peaks = [_list_limb_contrasts(plane)[1] for plane in (tilted, run.oblique_plane)]
    return _repeat_all(
        fig19_lambertian=-(compute_relative_range(upright, 60.0) - MAX_LAMBERTIAN_RANGE),
        fig19_peak_30=peaks[0],
        fig19_peak_60=peaks[1],
        fig19_peak_grows=peaks[1] - peaks[0],
    )


def _compute_nadir_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Figs 16 to 18: a nadir darker than the limbs at oblique incidence."""
    steep = run.simulate_plane([600.0, 1800.0], 69.3, run_number=3, depth_m=0.25)
    visible, infrared = (steep.isel(wavelength=[i]) for i in (0, 1))
    planes = (
        run.simulate_plane(600.0, 52.8, run_number=4, depth_m=0.25), visible,
        run.simulate_plane(600.0, 84.8, run_number=5, depth_m=0.25),
    )  # fmt: skip
    limbs = [max(_list_limb_contrasts(plane)) for plane in planes]
    return _repeat_all(
        fig16_nadir_dark=min(limbs),
        fig16_grows=min(after - before for before, after in itertools.pairwise(limbs)),
        fig17_nadir_dark=min(_list_limb_contrasts(infrared)),
        fig18_varies_more=_compute_forward_rise(infrared) - _compute_forward_rise(visible),
    )


def _compute_grain_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Figs 20 to 22: forward peaks by grain size and facetness."""
    trends = {}
    for wavelength, name, sign in (
        (600.0, "fig20_fine_least", -1.0), (1450.0, "fig21_fine_most", 1.0),
    ):  # fmt: skip
        *others, fine = (
            get_brdf(
                run.simulate_plane(
                    wavelength, 67.0, size[1] > 300, run_number=6 + i, grain_size_um=size
                ),
                LIMB_ANGLES_DEG[1],
            ).to_floats()
            for i, size in enumerate(((1500, 3000), (300, 750), (30, 300)))
        )
        excesses = [fine / other - 1.0 for other in others]
        trends[name] = min(excesses if sign > 0.0 else [-excess for excess in excesses])
    rounded, faceted = (
        _compute_forward_rise(
            run.simulate_plane(600.0, 60.0, True, run_number=9 + i, facetness=facetness)
        )
        for i, facetness in enumerate(((0, 0.2, 0.1, 0.072), (0.8, 1, 0.9, 0.072)))
    )
    others = [_compute_forward_rise(run.oblique_plane), faceted]
    return _repeat_all(**trends, fig22_rounded_varies_most=min(rounded - rise for rise in others))


def _list_limb_contrasts(plane: xr.Dataset) -> list[Estimate]:
    """Return the excess of the BRDF at each limb over the nadir, relative to the nadir."""
    nadir = get_brdf(plane, 0.0)
    return [(get_brdf(plane, angle) / nadir - 1.0).to_floats() for angle in LIMB_ANGLES_DEG]


def _compute_forward_rise(plane: xr.Dataset) -> Estimate:
    """Return the rise of the BRDF from the nadir to the forward limb, relative to its mean."""
    rise = get_brdf(plane, LIMB_ANGLES_DEG[1]) - get_brdf(plane, 0.0)
    return (rise / plane.brdf.mean("angle")).to_floats()


def _repeat_all(**trends: Estimate) -> StatementValues:
    """Return the values of trends, which do not depend on water, for all waters."""
    return {name: repeat_for_waters(*estimate.to_floats()) for name, estimate in trends.items()}


STAGES: dict[str, Callable[[InterpretationRun], StatementValues]] = {
    "distance": _compute_grain_distance,
    "table 3": _compute_table3,
    "facetness": _make_sensitivity_stage(("facetness",), ("r",)),
    "angles": _compute_incidence_trends,
    "transmittance": _compute_max_transmittance,
    "facetness below": _make_sensitivity_stage(("facetness",), ("t",)),
    "grain size": _make_sensitivity_stage(("grain_size",), ("r", "t")),
    "nadir": _compute_nadir_trends,
    "grains": _compute_grain_trends,
    "free ranges": _make_sensitivity_stage(("saturation", "density"), ("r", "t")),
}
"""Runs in order of decreasing information per cost; each gives our values of some statements."""

STATED_NUMBERS = {
    "distance": ("grain_distance",),
    "table 3": tuple(TABLE3_WAVELENGTHS_NM),
    "facetness": ("msi_r_facetness",),
    "transmittance": ("transmittance_max",),
    "facetness below": ("msi_t_facetness",),
    "grain size": ("msi_r_grain_size", "msi_t_grain_size"),
    "free ranges": (
        "msi_r_saturation", "msi_t_saturation", "msi_r_density", "msi_t_density",
    ),
}  # fmt: skip
"""Published numbers by stage, under their ids in the table of published numbers."""

STATED_TRENDS = {
    "angles": ("fig19_lambertian", "fig19_peak_30", "fig19_peak_60", "fig19_peak_grows"),
    "nadir": ("fig16_nadir_dark", "fig16_grows", "fig17_nadir_dark", "fig18_varies_more"),
    "grains": ("fig20_fine_least", "fig21_fine_most", "fig22_rounded_varies_most"),
}
"""Trends by stage; their names begin with the figure of the paper."""


def get_stated_trends(stage: str) -> dict[str, PublishedStatement]:
    """Return the trends of a stage."""
    return {
        name: PublishedStatement(name, f"Fig {name[3:5]}", 0.0, TREND_TOLERANCE, is_trend=True)
        for name in STATED_TRENDS.get(stage, ())
    }
