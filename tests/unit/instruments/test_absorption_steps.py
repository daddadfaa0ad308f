"""Path per absorbed light of layers: steps in which weights decrease, and single scattering."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.instruments.flux_media import CHORD_ERROR, PathRatio, compute_absorption_steps
from splits.media.stack import absorb_along_path
from splits.simulation.scene import compute_optical_constants

WAVELENGTHS = np.array([900.0, 1500.0])
MEDIA = {
    "snow": splits.Snow(depth_m=0.1),
    "wet snow": splits.Snow(depth_m=0.1, saturation=0.3),
    "natural snow": splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1),
}


@pytest.mark.parametrize("name", MEDIA)
def test_steps_are_those_of_one_segment_and_one_grain(name):
    """The pore fraction of a segment is path; light that is left at its end hits a grain."""
    medium = MEDIA[name]
    absorption = compute_optical_constants(medium, WAVELENGTHS).absorption
    steps = compute_absorption_steps(medium, absorption, np.array([0.0, 0.05, 0.1]))
    segment, chord = medium.mean_free_path_m, medium.mean_chord_m
    wet = medium.wet_fraction
    depths = absorption[:, [0, 1, -1]] * [segment, segment, chord]
    left = np.exp(-depths)
    part = np.where(depths > 0.0, (1.0 - left) / np.maximum(depths, 1e-300), 1.0)
    reaches = (1.0 - wet) * left[:, 0] + wet * left[:, 1]
    path = segment * medium.pore_fraction * ((1.0 - wet) * part[:, 0] + wet * part[:, 1])
    path += reaches * chord * part[:, 2]
    rate = (1.0 - reaches * left[:, 2]) / path
    np.testing.assert_allclose(steps.absorption_rate, [rate] * 2, rtol=1e-9)
    is_present = [True, wet > 0.0, True]
    np.testing.assert_allclose(
        steps.optical_depth, [depths[:, is_present].max(axis=1)] * 2, rtol=1e-12
    )


def test_mean_chords_are_close_to_single_scattering_where_steps_are_large():
    """`CHORD_ERROR` is that of natural snow at the absorption above which chords are used."""
    medium, wavelengths = MEDIA["natural snow"], np.array([1450.0, 1500.0, 1950.0, 2500.0])
    exact = PathRatio.from_medium(medium, wavelengths, 0.005, threads=1)
    absorption = compute_optical_constants(medium, wavelengths).absorption
    steps = compute_absorption_steps(medium, absorption, np.array([0.0, 0.1]))
    ratio = 1.0 / (steps.absorption_rate * exact.value)
    large = steps.optical_depth > 0.48
    assert large.any() and (np.abs(ratio - 1.0)[large] <= CHORD_ERROR).all()
    assert (exact.relative_error < 0.01).all() and not exact.by_rays.any()


def test_ratios_of_particles_and_of_transparent_layers():
    layer = splits.ParticleLayer(optical_thickness=3.0, single_scattering_albedo=0.75, depth_m=0.5)
    ratio = PathRatio.from_medium(absorb_along_path(layer), WAVELENGTHS, 0.005, threads=1)
    np.testing.assert_allclose(ratio.value, 1.0 / (0.25 * 6.0), rtol=1e-12)
    assert (ratio.relative_error == 0.0).all() and not ratio.by_rays.any()
    clear = splits.Snow(depth_m=0.1, refractive_index={"ice": 1.31}, saturation=0.0)
    ratio = PathRatio.from_medium(clear, WAVELENGTHS, 0.005, threads=1)
    assert np.isinf(ratio.value).all() and ratio.by_rays.all()
    wet = PathRatio.from_medium(MEDIA["wet snow"], WAVELENGTHS, 0.005, threads=1)
    assert wet.by_rays[0, 0] and np.isfinite(wet.value).all()
