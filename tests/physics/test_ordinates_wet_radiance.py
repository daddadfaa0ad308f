"""Radiances of wet layers: totals, reciprocity, divisions, limits, and errors."""

from __future__ import annotations

import numpy as np
import pytest
from test_ordinates_wet import WATER, N, Stack, make_optics

from splits.discrete_ordinates.granular_layers import (
    N_PEAK_ORDERS,
    estimate_phase_error,
    extend_forward_peak,
)
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams
from splits.discrete_ordinates.radiance import compute_bidirectional, trace_direct_light
from splits.discrete_ordinates.refraction import Geometry, PlaneLayers, compute_reflectance

COSINES = np.cos(np.radians([0.0, 60.0, 85.0]))
AZIMUTHS = np.array([0.0, 0.7, np.pi])
LAYERS = [(0.4, 0.05, [0.99, 0.7]), (0.7, 0.3, [1.0, 0.9]), (0.2, 1e-9, [0.9, 0.5])]
"""Thickness, saturation and albedo."""


def make_layers(layers, ground=0.0, index=WATER, **settings):
    optics = [make_optics(*layer, index=index, **settings) for layer in layers]
    stacked = LayerOptics(*(np.stack(values) for values in zip(*optics, strict=True)))
    saturations = [saturation for _, saturation, _ in layers]
    return PlaneLayers(stacked, np.full(index.size, ground), saturations, index)


def scatter(layers, views=COSINES, azimuths=AZIMUTHS, n_streams=N):
    """Return BRDF and BTDF of three beams."""
    geometry = Geometry(COSINES, views, azimuths)
    streams = Streams.from_number(n_streams)
    return compute_bidirectional(layers, streams, geometry, tolerance=1e-13)


@pytest.mark.parametrize("layers", [LAYERS, [(0.7, 0.05, [1.0, 0.9])]])
def test_radiances_and_direct_light_sum_to_the_totals(layers):
    """The difference is the quadrature over directions, in which light is refracted."""
    x, w = np.polynomial.legendre.leggauss(40)
    views, weights = 0.5 * (x + 1.0), 0.5 * w
    stack = Stack.from_layers(layers)
    azimuths = 2.0 * np.pi * np.arange(32) / 32
    plane = make_layers(layers)
    values = scatter(plane, views, azimuths).mean(axis=-1) @ (2.0 * np.pi * weights * views)
    direct = trace_direct_light(plane, COSINES)[0]
    for scattered, unscattered, total in (
        (values[0], direct.reflected, stack.budget.reflectance),
        (values[1], direct.transmitted, stack.budget.transmittance),
    ):
        np.testing.assert_allclose(scattered + unscattered, total[:, :-1], rtol=0.005)


def test_transmission_is_reciprocal():
    forward, backward = (scatter(make_layers(layers)) for layers in (LAYERS, LAYERS[::-1]))
    np.testing.assert_allclose(forward[0], np.swapaxes(forward[0], 1, 2), rtol=1e-9)
    np.testing.assert_allclose(forward[1], np.swapaxes(backward[1], 1, 2), rtol=1e-9)


@pytest.mark.parametrize("ground", [0.0, 0.5])
def test_divided_wet_layers_scatter_as_one(ground):
    thickness, saturation, albedo = LAYERS[1]
    parts = [(part * thickness, saturation, albedo) for part in (0.2, 0.5, 0.3)]
    one, several = (scatter(make_layers(layers, ground)) for layers in (LAYERS[1:2], parts))
    np.testing.assert_allclose(several, one, rtol=1e-9)


def test_water_of_index_1_does_not_refract():
    index = np.ones(2)
    wet = make_layers(LAYERS, 0.3, index)
    states = np.sqrt(wet.optics.equilibrium)
    mixed = np.einsum("...a,...abl,...b->...l", states, wet.optics.scattering, states)
    dry = wet.optics._replace(
        extinction=wet.optics.extinction[..., :1],
        scattering=mixed[..., np.newaxis, np.newaxis, :],
        equilibrium=np.ones((*states.shape[:-1], 1)),
    )
    expected = scatter(PlaneLayers(dry, wet.ground))
    np.testing.assert_allclose(scatter(wet), expected, rtol=1e-4)


def test_absorbing_layers_transmit_directly():
    saturation, thickness = 0.3, 0.5
    plane = make_layers([(thickness, saturation, [0.0, 0.0])])
    direct = trace_direct_light(plane, COSINES)[0]
    face = compute_reflectance(COSINES, WATER[:, np.newaxis])
    refracted = np.sqrt(1.0 - (1.0 - COSINES**2) / WATER[:, np.newaxis] ** 2)
    decay = np.exp(-thickness / refracted)
    passing = (1.0 - face) ** 2 * decay / (1.0 - (face * decay) ** 2)
    expected = (1.0 - saturation) * np.exp(-thickness / COSINES) + saturation * passing
    np.testing.assert_allclose(direct.transmitted, expected, rtol=1e-12)
    reflected = saturation * face * (1.0 + decay * passing)
    np.testing.assert_allclose(direct.reflected, reflected, rtol=1e-12)
    assert not scatter(plane).any()


@pytest.mark.parametrize("asymmetry", [0.7, 0.85, 0.95])
@pytest.mark.parametrize("has_peak", [False, True])
def test_error_of_a_phase_function_covers_the_rest_of_its_series(asymmetry, has_peak):
    cosines = np.cos(np.radians(np.arange(10.0, 181.0, 2.0)))
    moments = asymmetry ** np.arange(33)
    exact = (1.0 - asymmetry**2) / (1.0 + asymmetry**2 - 2.0 * asymmetry * cosines) ** 1.5
    values, error = estimate_phase_error(moments[np.newaxis], cosines[np.newaxis], has_peak)
    ratio = (values - exact) / error
    assert np.sqrt((ratio**2).mean()) < 1.0 and np.abs(ratio).max() < 3.0
    if has_peak:
        without, _ = estimate_phase_error(moments[np.newaxis], cosines[np.newaxis], False)
        assert np.median(np.abs(values - exact)) < 0.5 * np.median(np.abs(without - exact))


def test_forward_peak_of_wet_pores_continues_its_series():
    moments = 0.2 * 0.95 ** np.arange(N_PEAK_ORDERS)
    scattering = np.tile(moments[:33], (3, 2, 2, 1))
    extended = extend_forward_peak(scattering)
    np.testing.assert_array_equal(extended[..., :33], scattering)
    np.testing.assert_allclose(extended[:, 1, 1, :40], np.tile(moments[:40], (3, 1)), rtol=0.01)
    # The series ends at 0 without a step.
    assert (np.diff(extended[:, 1, 1]) < 0.0).all() and (extended[:, 1, 1, -1] < 1e-30).all()
    assert not extended[:, 0, :, 33:].any() and not extended[:, 1, 0, 33:].any()
