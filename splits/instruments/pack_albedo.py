"""Spectral and band albedo of the snowpacks of a season under skies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import check_range
from splits.illumination.bands import SpectralBand
from splits.instruments.pack_run import (
    check_pack_solver,
    compute_beam_cosines,
    make_pack_dataset,
    solve_packs,
)
from splits.instruments.pack_skies import PackSkies
from splits.instruments.pack_spectra import make_error_attributes, make_pack_attributes
from splits.media.snow_packs import SnowPacks
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate


def compute_pack_albedo(
    packs: SnowPacks, sky: Any, wavelength_nm: Any, max_stderr: Any, solver: Any, bands: Any,
    run: RunOptions,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `splits.albedo` for snowpacks.

    Parameters
    ----------
    packs : SnowPacks
    sky, wavelength_nm, max_stderr, solver, bands : object
        As given by the user.
    run : RunOptions
    """
    check_pack_solver(solver)
    max_stderr = check_range("max_stderr", max_stderr, 1e-6, 0.5)
    skies = PackSkies.from_input(sky, packs)
    wavelengths = skies.choose_wavelengths(wavelength_nm)
    named = skies.skies[0].make_bands(bands)
    skies.skies[0].check_bands(named, wavelengths)
    cosines = compute_beam_cosines(packs, skies.incidence)
    spectra = solve_packs(packs, wavelengths, cosines, max_stderr, run)
    good = np.flatnonzero(packs.is_good)
    # Without direct light there is no beam, and both columns are that of diffuse light.
    beam, diffuse = (spectra.reflectance[..., column] for column in (0, -1))
    fraction = np.full(beam.shape, np.nan)
    fraction[good] = skies.compute_direct_fraction(wavelengths)
    albedo, stderr = (
        fraction * of_beam + (1.0 - fraction) * of_diffuse
        for of_beam, of_diffuse in (
            (beam, diffuse), (spectra.bound_error(beam), spectra.bound_error(diffuse)),
        )
    )  # fmt: skip
    dims = (packs.label, "wavelength")
    direct_attributes = {"long_name": "fraction of direct sunlight", "units": "1"}
    variables: dict[str, Any] = {
        **make_variable("albedo", dims, albedo, stderr, "albedo under this sky"),
        "direct_fraction": (dims, fraction, direct_attributes),
    }
    variables |= _average_over_bands(packs, skies, named, wavelengths, (albedo, stderr))
    attributes = {
        **make_pack_attributes(packs, run, "Albedo under a sky", "albedo"),
        **skies.make_attributes(),
        **make_error_attributes(spectra, max_stderr, float(np.nanmax(stderr, initial=0.0))),
    }
    attributes |= {f"band_{name}_sha256": one.sha256 for name, one in named.items() if one.sha256}
    axes = {"wavelength": make_wavelength_coordinate(wavelengths), "band": list(named)}
    return make_pack_dataset(packs, spectra.flags, variables, axes).assign_attrs(attributes)


def _average_over_bands(
    packs: SnowPacks,
    skies: PackSkies,
    bands: Mapping[str, SpectralBand],
    wavelength_nm: np.ndarray,
    spectra: tuple[np.ndarray, np.ndarray],
) -> dict[str, Variable]:
    """Return the albedo of every band, its error, and the fraction of its light that is covered.

    Parameters
    ----------
    packs, skies, bands, wavelength_nm
        See `compute_pack_albedo`.
    spectra : two of float, shape (snowpacks, wavelengths)
        Albedo and its error.
    """
    good = np.flatnonzero(packs.is_good)
    weights, error_weights, covered = skies.compute_band_weights(bands, wavelength_nm)
    # The errors of all wavelengths have the same causes, and add up linearly.
    albedo, stderr, irradiance_covered = np.full((3, len(packs), len(bands)), np.nan)
    irradiance_covered[good] = covered[skies.number]
    for number in range(len(skies.skies)):
        rows = good[skies.number == number]
        albedo[rows], stderr[rows] = (values[rows] @ weights[number].T for values in spectra)
        between = error_weights[number] @ spectra[0][rows].T
        stderr[rows] = np.sqrt(stderr[rows] ** 2 + (between**2).sum(axis=0).T)
    dims = (packs.label, "band")
    label = "albedo over a band, weighted by irradiance"
    attributes = {"long_name": "fraction of the band's light within the wavelengths", "units": "1"}
    return {
        **make_variable("band_albedo", dims, albedo, stderr, label),
        "irradiance_covered": (dims, irradiance_covered, attributes),
    }
