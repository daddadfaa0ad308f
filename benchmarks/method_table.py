"""The table of `speed_against_error.py`: what a way to a spectrum took, and how far off it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.experiments.papers import performance

NUMBER_COLUMNS = (
    "stderr_largest",
    "stderr_rms",
    "deviation_rms",
    "deviation_largest",
    "deviation_z",
)


class MethodTable:
    """Rows of the result, printed as they come.

    Parameters
    ----------
    medium : str
    reference : xarray.Dataset
    """

    def __init__(self, medium: str, reference: xr.Dataset) -> None:
        self.medium = medium
        self.reference = reference
        self.rows: list[dict[str, Any]] = []

    def add(
        self,
        method: str,
        source: str,
        seconds: float,
        rays: float,
        error: float = np.nan,
        spectra: Sequence[xr.Dataset] = (),
        **facts: float,
    ) -> None:
        """Add a method; of several spectra, the root mean square or largest of each number."""
        facts |= performance.combine_runs(
            [
                performance.compute_deviations(one, self.reference)
                | performance.summarize_stated_errors(one)
                for one in spectra
            ]
        )
        row = {
            "medium": self.medium,
            "method": method,
            "how": source,
            "error": error,
            "seconds": seconds,
            "rays": round(rays),
            **{key: facts.get(key, np.nan) for key in NUMBER_COLUMNS},
            "reference_stderr": float(
                performance.summarize_stated_errors(self.reference)["stderr_largest"]
            ),
            "wavelengths_traced": spectra[0].sizes["wavelength"] if spectra else 0,
        }
        self.rows.append(row)
        print(performance.format_row(row), flush=True)
