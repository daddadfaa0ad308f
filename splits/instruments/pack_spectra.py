"""Hemispherical reflectance, transmittance and absorptance of the snowpacks of a season."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import make_variable
from splits.core.validation import check_range, invalid
from splits.instruments.pack_run import (
    DIFFUSE,
    SUN,
    PackSpectra,
    check_pack_solver,
    compute_beam_cosines,
    make_pack_dataset,
    set_incidence,
    solve_packs,
)
from splits.instruments.spectral_run import QUANTITY_LABELS
from splits.media.snow_packs import SnowPacks
from splits.simulation.run_options import RunOptions, check_wavelengths, make_wavelength_coordinate


def compute_pack_spectra(
    packs: SnowPacks, wavelength_nm: Any, incidence_deg: Any, max_stderr: Any, solver: Any,
    run: RunOptions,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `splits.spectrophotometer` for snowpacks.

    Parameters
    ----------
    packs : SnowPacks
    wavelength_nm, incidence_deg, max_stderr, solver : object
        As given by the user.
    run : RunOptions
    """
    check_pack_solver(solver)
    wavelengths = check_wavelengths(wavelength_nm)
    max_stderr = check_range("max_stderr", max_stderr, 1e-6, 0.5)
    packs, incidence = set_incidence(packs, incidence_deg)
    cosines = compute_beam_cosines(packs, incidence)
    spectra = solve_packs(packs, wavelengths, cosines, max_stderr, run)
    illumination = "hemispherical" if incidence == DIFFUSE else "directional"
    column = -1 if incidence == DIFFUSE else 0
    reflectance, transmittance = (
        values[..., column] for values in (spectra.reflectance, spectra.transmittance)
    )
    means = (reflectance, transmittance, 1.0 - reflectance - transmittance)
    variables: dict[str, Any] = {}
    dims = (packs.label, "wavelength")
    for (name, label), mean in zip(QUANTITY_LABELS.items(), means, strict=True):
        long_name = label if name == "absorptance" else f"{illumination}-{label}"
        variables |= make_variable(name, dims, mean, spectra.bound_error(mean), long_name)
    largest = max(
        np.nanmax(variables[f"{name}_stderr"][1], initial=0.0) for name in QUANTITY_LABELS
    )
    attributes = {
        **make_pack_attributes(packs, run, "Virtual spectrophotometer", "spectrophotometer"),
        "incidence_deg": "sun zenith of each snowpack" if incidence == SUN else incidence,
        **make_error_attributes(spectra, max_stderr, float(largest)),
    }
    axes = {"wavelength": make_wavelength_coordinate(wavelengths)}
    return make_pack_dataset(packs, spectra.flags, variables, axes).assign_attrs(attributes)


def check_no_paths(estimator: Any, jacobian: Any) -> None:
    """Check that options of simulations with paths are left out for snowpacks."""
    if estimator != "spectral":
        raise invalid("estimator", estimator, "left out for SnowPacks", "it needs paths")
    if np.size(jacobian):
        raise invalid("jacobian", list(jacobian), "left out for SnowPacks")


def make_pack_attributes(
    packs: SnowPacks, run: RunOptions, title: str, instrument: str
) -> dict[str, Any]:
    """Return the attributes of a dataset of snowpacks at the end of a run."""
    medium: Any = packs
    attributes = run.make_attributes(title, instrument, medium)
    # No random numbers are used.
    del attributes["seed"]
    return attributes


def make_error_attributes(
    spectra: PackSpectra, max_stderr: float, max_stderr_reached: float
) -> dict[str, Any]:
    """Return the attributes of the solver and of its errors."""
    return {
        "max_stderr": max_stderr,
        "stop_reason": "converged" if max_stderr_reached <= max_stderr else "solver_error",
        "max_stderr_reached": max_stderr_reached,
        "rays": 0,
        **spectra.attributes,
    }
