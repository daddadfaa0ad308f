"""Spectra by theory, from the single-scattering properties of the grains of a medium."""

from dataclasses import replace

import numpy as np
import performance
import xarray as xr

import splits
from splits.analysis.theory.spectra import (
    compute_shape_factors,
    correct_dense_packing,
    kz04,
    propagate_errors,
    solve_discrete_ordinates,
)
from splits.core.uncertainty import Variable, make_variable

N_STREAMS = 32


def compute_discrete_ordinates(
    medium: splits.Snow, wavelengths: np.ndarray, rays: int
) -> xr.Dataset:
    """Return the spectrum by discrete ordinates, for the grains of the medium."""
    optics = splits.single_scattering(
        medium, wavelengths, N_STREAMS, rays, threads=1, wet_pores="equilibrium"
    )
    return solve_discrete_ordinates(correct_dense_packing(optics), streams=N_STREAMS)


def compute_kz04(medium: splits.Snow, wavelengths: np.ndarray, rays: int) -> xr.Dataset:
    """Return the spectrum by asymptotic theory, with B and g of the dry grains of the medium."""
    optics = splits.single_scattering(
        replace(medium, saturation=0.0), wavelengths, 1, rays, threads=1
    )
    area = medium.specific_surface_area_m2_kg
    k = medium.refractive_index["ice"](wavelengths).imag

    def theory(properties: xr.Dataset) -> np.ndarray:
        enhancement, asymmetry = compute_shape_factors(properties, area, k)
        spectrum = kz04(
            wavelengths,
            area,
            extinction_coefficient=k,
            absorption_enhancement=enhancement,
            asymmetry=asymmetry,
            density_kg_m3=medium.density_kg_m3,
            depth_m=medium.depth_m,
        )
        reflectance, transmittance = spectrum.reflectance.values, spectrum.transmittance.values
        return np.stack([reflectance, transmittance, 1.0 - reflectance - transmittance])

    values, stderr = theory(optics), propagate_errors(theory, optics)
    variables: dict[str, Variable] = {}
    for row, name in enumerate(performance.QUANTITIES):
        variables |= make_variable(name, "wavelength", values[row], stderr[row], name)
    return xr.Dataset(variables, {"wavelength": wavelengths})


THEORIES = {"discrete_ordinates": compute_discrete_ordinates, "kz04": compute_kz04}
