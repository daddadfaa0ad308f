"""Table of `speed_against_error.py`: time and deviation of each method for a spectrum."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import performance
import xarray as xr

NUMBER_COLUMNS = (
    "stderr_largest",
    "stderr_rms",
    "deviation_rms",
    "deviation_largest",
    "deviation_z",
)


class MethodTable:
    """Rows of the result, printed when they are added.

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
        **statistics: float,
    ) -> None:
        """Add a method, with the root mean square or maximum of each number over spectra."""
        statistics |= performance.combine_runs(
            [
                performance.compute_deviations(spectrum, self.reference)
                | performance.summarize_stated_errors(spectrum)
                for spectrum in spectra
            ]
        )
        row = {
            "medium": self.medium,
            "method": method,
            "how": source,
            "error": error,
            "seconds": seconds,
            "rays": round(rays),
            **{key: statistics.get(key, np.nan) for key in NUMBER_COLUMNS},
            "reference_stderr": float(
                performance.summarize_stated_errors(self.reference)["stderr_largest"]
            ),
            "wavelengths_traced": spectra[0].sizes["wavelength"] if spectra else 0,
        }
        self.rows.append(row)
        print(performance.format_row(row), flush=True)
