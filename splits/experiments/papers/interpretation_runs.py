"""Snow of SPLITSnow's Table 1 under any set of readings, with several waters at once.

Waters stand side by side in one run: their tables differ in absorption, which is exact along shared
paths, so that each costs no rays of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.instruments import goniophotometer, spectrophotometer
from splits.materials.library import load_dataset
from splits.materials.refractive_index import TabulatedIndex
from splits.media import Interpretation, Snow

WATER_TABLES = ("hale_querry_1973", "hale_querry_1973, linear in k", "segelstein_1981")
"""Tables of water.  Of the four that the paper cites, Hale & Querry's is at hand; it is coarse, and
how one goes between its rows matters.  Segelstein's compilation stands for the finer ones."""

StatementValues = dict[str, tuple[np.ndarray, np.ndarray]]
"""Ours and its standard error by name of the statement: over waters, and of sensitivities over
pairs of extremes and floors besides."""

_WATER_OFFSET_NM = 1e-3
"""Distance of the places at which waters stand side by side."""

ANGLE_STEP_DEG = 7.5
ANGLES_PER_SECTOR = 3
"""Angles of the principal plane up to 75°, and how many of them one sector averages: 22.5°."""
MAX_BRDF_RAYS = 1_000_000
"""Rays of a BRDF, for lobes of coarse dark grains that no rays resolve."""


class TargetErrors(NamedTuple):
    """Standard errors of the runs: of hemispherical values, and relative ones of BRDFs."""

    bands: float = 0.006
    transmittance: float = 0.002
    reflectances: float = 0.012
    transmittances: float = 0.005
    brdf: float = 0.05
    lobes: float = 0.03

    def scale(self, factor: float) -> TargetErrors:
        """Return errors so many times as large, of which no run makes more than 0.5."""
        return TargetErrors(*(min(factor * error, 0.5) for error in self))


@dataclass(frozen=True)
class InterpretationRun:
    """Snow of Table 1 under one set of readings.

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
        """Return snow of Table 1 with some settings of its own."""
        return Snow(interpretation=self.interpretation, **settings)

    def simulate_spectra(
        self, wavelength_nm: Any, error: float, incidence: float = 0.0, run_number: int = 0,
        **settings: Any,
    ) -> list[xr.Dataset]:  # fmt: skip
        """Return hemispherical values with each water.

        Runs of different numbers are independent, as what compares them takes them to be.
        """
        places, table = interleave_waters(np.asarray(wavelength_nm, dtype=float))
        snow = self.make_snow(refractive_index={"water": table}, **settings)
        found = spectrophotometer(snow, places, incidence, error, self.seed + run_number, threads=1)
        return [
            found.isel(wavelength=slice(w, None, len(WATER_TABLES)))
            for w in range(len(WATER_TABLES))
        ]

    def simulate_plane(
        self, wavelength_nm: float | list[float], incidence: float, lobes: bool = False,
        run_number: int = 0, **settings: Any,
    ) -> xr.Dataset:  # fmt: skip
        """Return the BRDF in the principal plane by sector, with the first water.

        Runs of different numbers are independent.
        """
        error = self.errors.lobes if lobes else self.errors.brdf
        run = goniophotometer(
            self.make_snow(**settings), np.atleast_1d(wavelength_nm), incidence, seed=self.seed + run_number,
            relative_stderr=error, azimuth_deg=[0.0, 180.0],
            polar_deg=np.arange(0.0, 76.0, ANGLE_STEP_DEG), threads=1, max_rays=MAX_BRDF_RAYS,
        )  # fmt: skip
        return average_sectors(select_principal_plane(run))

    @cached_property
    def oblique_plane(self) -> xr.Dataset:
        """BRDF of Table 1's snow under 60°, which several figures share."""
        return self.simulate_plane(600.0, 60.0)


def interleave_waters(wavelength_nm: np.ndarray) -> tuple[np.ndarray, dict[str, list[float]]]:
    """Return wavelengths (nm) at which each water stands, and a table of water that has them."""
    places = (
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
    table = {"wavelength_nm": places, "n": index.real, "k": index.imag}
    return places, {name: column.tolist() for name, column in table.items()}


def average_sectors(plane: xr.Dataset) -> xr.Dataset:
    """Return means over sectors of 22.5° around -67.5°, -45°, ... 67.5°.

    Fixed sectors stand for peaks and limbs, because the brightest of many noisy angles is brighter
    than the light is.  Errors of angles in one sector are taken to go together.
    """
    parts = plane[["brdf", "brdf_stderr"]].coarsen(angle=ANGLES_PER_SECTOR)
    return parts.mean().assign_coords(wavelength=plane.wavelength)


def repeat_for_waters(value: float, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a value that no water moves and its error, both of shape (waters,)."""
    return np.full(len(WATER_TABLES), value), np.full(len(WATER_TABLES), error)
