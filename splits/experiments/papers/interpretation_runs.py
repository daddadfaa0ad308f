"""Simulations of the snow of SPLITSnow's Table 1 for an interpretation and several waters.

All waters are simulated in one run.  Their refractive indices differ mainly in absorption, which is
evaluated exactly along shared paths, so additional waters need no additional rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.core.convergence import nest_runs
from splits.instruments import goniophotometer, spectrophotometer
from splits.instruments.solver import MONTE_CARLO
from splits.materials.library import load_dataset
from splits.materials.refractive_index import TabulatedIndex
from splits.media import Interpretation, Snow

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
            error,
            self.seed + run_number,
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
