"""Published statements on the polarization of snow and sand, with their sources.

docs/theory/polarization.md lists which statements hold.  The degree is −Q/I in the principal plane,
positive if light is polarized perpendicular to it.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, scale_sample_size

import splits

pytestmark = NEEDS_JIT

SMALL, LARGE = (100.0, 200.0), (900.0, 1000.0)
SMOOTH, ROUGH = (0.0, 0.2, 0.1, 0.072), (0.8, 1.0, 0.9, 0.072)
BREWSTER_DEG = 52.6
"""Brewster's angle of ice: light is reflected there from one facet by twice this angle."""
FORWARD, BACKWARD = 0.0, 180.0
SIGNIFICANT = 4.0
"""Standard errors of a difference that is significant."""


class Degree(NamedTuple):
    """Degree of linear polarization, and its standard error."""

    value: float
    stderr: float

    def exceeds(self, other: Degree) -> bool:
        """Return whether the degree is significantly larger than another one."""
        return self.value - other.value > SIGNIFICANT * np.hypot(self.stderr, other.stderr)


def make_snow(size: tuple[float, float] = LARGE, facetness: tuple = SMOOTH) -> splits.Snow:
    """Return dry snow of grains of a size (µm) and facetness."""
    return splits.Snow(grain_size_um=size, facetness=facetness, saturation=0.0, depth_m=0.03)


@cache
def measure_bins(medium: splits.Snow | splits.Sand, wavelength_nm: float, rays: int) -> xr.Dataset:
    """Return the polarized BRDF in bins, for light incident at Brewster's angle."""
    return splits.goniophotometer(
        medium, [wavelength_nm], BREWSTER_DEG, stokes=True, estimator="bins", n_bins=(9, 12),
        rays=scale_sample_size(rays),
    ).squeeze("wavelength")  # fmt: skip


def compute_degree(
    medium: splits.Snow | splits.Sand,
    wavelength_nm: float,
    azimuth: float = FORWARD,
    polar_deg: tuple[float, float] = (43.0, 61.0),
    rays: int = 300_000,
) -> Degree:
    """Return the degree between two polar angles, for light incident at Brewster's angle."""
    ds = measure_bins(medium, wavelength_nm, rays).sel(
        azimuth_deg=azimuth, polar_deg=slice(*polar_deg)
    )
    weight = np.cos(np.radians(ds.polar_deg))
    intensity = float((weight * ds.brdf).sum())
    degree = -float((weight * ds.brdf_q).sum()) / intensity
    error = weight * ds.brdf * ds.brdf_dolp_stderr
    return Degree(degree, float(np.sqrt((error**2).sum())) / intensity)


def test_polarization_in_the_infrared_increases_with_grain_size():
    """Tanikawa et al. (2014): the near-infrared degree increases with grain size."""
    small, large = (compute_degree(make_snow(size), 1500.0) for size in (SMALL, LARGE))
    print(f"1500 nm: {small} for grains of 100 to 200 um, {large} for 900 to 1000 um")
    assert large.exceeds(small)


def test_light_of_an_absorbing_crust_is_mostly_polarized():
    """Tanikawa et al. (2014): melt-freeze crust near 1500 and 2000 nm in Brewster's geometry.

    The degree there is nearly 1.  Grains of 1 mm without facets still transmit some light.
    """
    crust = make_snow(facetness=(0.0,) * 4)
    degrees = [compute_degree(crust, one, rays=1_000_000) for one in (1500.0, 2000.0)]
    print(f"crust: {degrees}")
    assert all(degree.value > 0.75 for degree in degrees)
    assert max(degree.stderr for degree in degrees) < 0.02


def test_visible_light_of_snow_is_hardly_polarized_at_all_angles():
    """Tanikawa et al. (2014): the degree in the visible is low and nearly constant."""
    degrees = [
        compute_degree(make_snow(), 600.0, azimuth, polar_deg, 40_000)
        for azimuth in (FORWARD, BACKWARD)
        for polar_deg in ((0.0, 40.0), (40.0, 68.0))
    ]
    print(f"600 nm: {degrees}")
    assert all(abs(degree.value) < 0.04 + SIGNIFICANT * degree.stderr for degree in degrees)


@pytest.mark.long
def test_polarization_increases_where_snow_is_darker():
    """Umov's law, as for soils by Woessner & Hapke (1987): dark surfaces polarize more."""
    degrees = [
        compute_degree(make_snow(), wavelength, rays=1_000_000)
        for wavelength in (1030.0, 1300.0, 1500.0)
    ]
    print(f"1030, 1300, 1500 nm: {degrees}")
    assert degrees[2].exceeds(degrees[1]) and degrees[1].exceeds(degrees[0])


def test_roughness_of_grains_reduces_polarization_in_the_infrared():
    """Ottaviani (2022), Ottaviani et al. (2024): shape and roughness determine polarization."""
    smooth, rough = (
        compute_degree(make_snow(facetness=facetness), 1590.0) for facetness in (SMOOTH, ROUGH)
    )
    print(f"1590 nm: facetness 0.1 {smooth}, 0.9 {rough}")
    assert smooth.exceeds(rough)


@pytest.mark.parametrize(
    ("medium", "wavelength_nm"), [(make_snow(), 1300.0), (splits.Sand(depth_m=0.005), 450.0)]
)
def test_polarization_is_positive_forward_and_vanishes_backward(medium, wavelength_nm):
    """Maignan et al. (2009), Bréon et al. (1995): land surfaces, soils."""
    forward, backward = (
        compute_degree(medium, wavelength_nm, azimuth) for azimuth in (FORWARD, BACKWARD)
    )
    print(f"forward {forward}, backward {backward}")
    assert forward.exceeds(backward)
    assert forward.exceeds(Degree(0.0, 0.0))
    assert abs(backward.value) < 0.02 + SIGNIFICANT * backward.stderr


def test_saturated_sand_is_darker_but_not_more_polarized():
    """Curran (1981) found wet soils more polarized.  Here light leaves through smooth water."""
    dry, wet = (
        compute_degree(splits.Sand(depth_m=0.005, saturation=saturation), 450.0)
        for saturation in (0.0, 1.0)
    )
    print(f"dry {dry}, saturated {wet}")
    assert dry.exceeds(wet)


@pytest.mark.long
def test_depolarization_by_single_grains_exceeds_that_of_hexagons():
    """Liou & Lahore (1974): 0.29 computed and 0.35 measured for random hexagonal crystals."""
    for facetness in (SMOOTH, ROUGH):
        ds = splits.single_scattering(
            make_snow(facetness=facetness), [633.0], moments=2, rays=scale_sample_size(1_000_000),
            stokes=True,
        ).squeeze("wavelength")  # fmt: skip
        # The mean of directions within 10 degrees of the backward one.
        near = ds.sel(angle_deg=slice(170.0, None))
        weight = np.sin(np.radians(near.angle_deg))
        p11, p22 = (float((weight * near[name]).sum()) for name in ("P11", "P22"))
        ratio = (p11 - p22) / (p11 + p22)
        error_11, error_22 = (
            float(np.sqrt(((weight * near[f"{name}_stderr"]) ** 2).sum()))
            for name in ("P11", "P22")
        )
        # P11 and P22 come from the same rays; independent errors are a bound.
        stderr = 2.0 * np.hypot(p22 * error_11, p11 * error_22) / (p11 + p22) ** 2
        print(f"facetness {facetness[2]}: {ratio:.3f} ± {stderr:.3f}")
        assert ratio - 0.35 > 3.0 * stderr
