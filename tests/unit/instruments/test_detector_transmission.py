"""Transmission from layers to detectors outside, after any number of reflections at interfaces."""

from __future__ import annotations

import numpy as np
import pytest

from splits.instruments.detector_tally import compute_refracted_cosines, compute_transmission
from splits.kernels.interface import compute_fresnel_mueller
from splits.kernels.transport.next_event import ABOVE, BELOW, DOWNWARD, UPWARD

POLAR = np.radians([0.0, 20.0, 56.3, 85.0])


def compute_fluxes(index, thickness, polarized=True, has_lower_side=True):
    """Return the transmission as energy flux: without the ratio of solid angles."""
    index = np.array(index)
    values = compute_transmission(index, np.array(thickness), POLAR, has_lower_side, polarized)
    cosine = np.sqrt(1.0 - (np.sin(POLAR) / index[:, np.newaxis]) ** 2)
    return values * (index[:, np.newaxis] ** 2 * cosine)[..., np.newaxis]


def get_factors(n1, n2, polar):
    """Return reflectances and transmittances of I + Q, I − Q, and U, for light from outside."""
    mueller = compute_fresnel_mueller(n1, n2, np.cos(polar))
    (plus, minus, real, _), (t_plus, t_minus, root, _) = mueller.reflection, mueller.transmission
    return (np.array([plus + minus, plus - minus, real]),
            np.array([t_plus + t_minus, t_plus - t_minus, root]))  # fmt: skip


def test_cosines_are_accurate_at_grazing_directions():
    polar = np.radians([89.9, 89.9999999, 89.999999999999])
    cosines = compute_refracted_cosines(np.array([1.0, 1.3]), polar)
    np.testing.assert_allclose(cosines[0], np.cos(polar), rtol=1e-15)
    np.testing.assert_allclose(cosines[1], np.sqrt(0.69 + np.cos(polar) ** 2) / 1.3, rtol=1e-14)


def test_one_layer_has_geometric_series():
    thickness = 0.3
    values = compute_fluxes([1.5], [thickness])
    for k, polar in enumerate(POLAR):
        reflected, transmitted = get_factors(1.0, 1.5, polar)
        direct = np.exp(-thickness / np.sqrt(1.0 - (np.sin(polar) / 1.5) ** 2))
        series = transmitted / (1.0 - (reflected * direct) ** 2)
        np.testing.assert_allclose(values[ABOVE, UPWARD, 0, k], series, rtol=1e-12)
        np.testing.assert_allclose(values[BELOW, DOWNWARD, 0, k], series, rtol=1e-12)
        other_side = series * reflected * direct
        np.testing.assert_allclose(values[BELOW, UPWARD, 0, k], other_side, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(
            values[ABOVE, DOWNWARD, 0, k], other_side, rtol=1e-12, atol=1e-15
        )


@pytest.mark.parametrize("polarized", [False, True])
def test_energy_leaves_clear_layers(polarized):
    values = compute_fluxes([1.33, 1.0, 1.6, 1.2], [0.0] * 4, polarized)
    np.testing.assert_allclose(values[..., :2].sum(axis=0), 1.0, rtol=1e-12)


def test_layers_of_one_index_attenuate_only():
    thickness = np.array([0.5, 1.0, 0.2])
    values = compute_fluxes([1.0, 1.0, 1.0], thickness)
    above = np.cumsum([0.0, *thickness[:-1]])
    expected = np.exp(-above[:, np.newaxis] / np.cos(POLAR))
    np.testing.assert_allclose(values[ABOVE, UPWARD, :, :, 0], expected, rtol=1e-12)
    assert (values[ABOVE, DOWNWARD] == 0.0).all() and (values[BELOW, UPWARD] == 0.0).all()


def test_a_closed_lower_side_neither_transmits_nor_reflects():
    values = compute_fluxes([1.5], [0.3], has_lower_side=False)
    assert (values[BELOW] == 0.0).all() and (values[ABOVE, DOWNWARD] == 0.0).all()
    for k, polar in enumerate(POLAR):
        _, transmitted = get_factors(1.0, 1.5, polar)
        np.testing.assert_allclose(values[ABOVE, UPWARD, 0, k], transmitted, rtol=1e-12)


def test_infinite_layers_have_no_light_from_below():
    values = compute_fluxes([1.5, 1.3], [0.3, np.inf], has_lower_side=False)
    assert np.isfinite(values).all() and (values[ABOVE, UPWARD] > 0.0)[..., :2].all()


def test_transmission_through_a_stack_is_reciprocal():
    """Light from the layer to a side equals light from that side into the layer, reversed."""
    index, thickness = [1.33, 1.6, 1.1], [0.3, 0.1, 0.7]
    values = compute_fluxes(index, thickness)
    turned = compute_fluxes(index[::-1], thickness[::-1])
    np.testing.assert_allclose(values[ABOVE, UPWARD], turned[BELOW, DOWNWARD, ::-1], rtol=1e-12)
