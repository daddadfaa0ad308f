"""Wet layers by discrete ordinates: equilibrium, energy, divisions, and the limit of index 1."""

from __future__ import annotations

import numpy as np
import pytest
from level_fluxes import compute_profile, join_cosines

from splits.discrete_ordinates.adding import (
    Boundary,
    Element,
    compute_budget,
    make_isotropic,
    reflect_at_bottom,
)
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab
from splits.discrete_ordinates.refraction import (
    RefractingCells,
    make_wet_boundary,
    make_wet_interface,
    refract_directions,
)

N = 16
STREAMS = Streams.from_number(N)
COSINES = np.cos(np.radians([0.0, 60.0, 85.0]))
WATER = np.array([1.33, 1.31])
"""Refractive indices at two wavelengths."""
CELLS = RefractingCells.from_index(WATER, STREAMS)
SATURATIONS = [(0.05, 0.3), (0.3, 0.05), (1e-9, 0.2), (0.4, 0.4)]


def make_optics(thickness, saturation, albedo, index=WATER, water=0.0):
    """Return a layer in which a part of the scattered light changes the pore.

    Light changes the pore so that isotropic radiance is in equilibrium, n² as strong in wet pores.
    """
    n, f, orders = index[:, np.newaxis], saturation, np.arange(N + 1)
    moments, exchange = (
        np.asarray(albedo)[:, np.newaxis] * factor * asymmetry**orders
        for factor, asymmetry in ((1.0, 0.75), (0.5, 0.5))
    )
    scattering = np.empty((index.size, 2, 2, N + 1))
    scattering[:, 0, 1] = scattering[:, 1, 0] = np.sqrt(f * (1.0 - f)) * exchange
    scattering[:, 0, 0] = moments - f * n * exchange
    scattering[:, 1, 1] = moments - (1.0 - f) / n * exchange
    extinction = np.tile([1.0, 1.0 + water], (index.size, 1))
    equilibrium = np.stack([0.0 * index + 1.0 - f, f * index**2], axis=-1)
    return LayerOptics(np.full(index.size, thickness), extinction, scattering, equilibrium)


class Stack:
    """Layers with their interfaces and boundaries; a saturation of None is one state."""

    def __init__(self, layers, saturations, ground=0.0, index=WATER):
        wet = saturations[0] is not None
        self.directions = refract_directions(COSINES, index) if wet else COSINES[np.newaxis]
        self.n_streams = (1 + wet) * STREAMS.cosines.size
        cells = RefractingCells.from_index(index, STREAMS)
        self.elements, self.isotropic = [], []
        for i, optics in enumerate(layers):
            pair = saturations[max(i - 1, 0)], saturations[i]
            if pair[0] != pair[1]:
                self.isotropic.append(self.isotropic[-1])
                self.elements.append(make_wet_interface(pair, index, cells, COSINES))
            self.isotropic.append(make_isotropic(optics, STREAMS, COSINES.size))
            slab = solve_slab(optics.truncate(N), STREAMS, self.directions)
            self.elements.append(Element.from_slab(slab, self.isotropic[-1]))
        self.isotropic.append(self.isotropic[-1])
        self.boundaries = [
            make_wet_boundary(end, index, cells, COSINES) if wet
            else Boundary.make_transparent(self.n_streams, COSINES.size)
            for end in (saturations[0], saturations[-1])
        ]  # fmt: skip
        self.cosines = join_cosines(STREAMS, self.directions)
        self.ground = np.full(index.size, ground)
        outside = self.boundaries, self.ground, self.n_streams
        self.profile = compute_profile(self.elements, self.isotropic, self.cosines, *outside)
        ends = self.isotropic[0], self.isotropic[-1]
        self.budget = compute_budget(self.elements, ends, *outside)

    @classmethod
    def from_layers(cls, layers, ground=0.0, water=0.0):
        """Return a stack of layers of thickness, saturation and albedo."""
        optics = [make_optics(*layer, water=water) for layer in layers]
        return cls(optics, [saturation for _, saturation, _ in layers], ground)

    def check_energy(self, tolerance=1e-12):
        """Check that no light is lost, in the stack and in each element."""
        budget, net = self.budget, self.profile.downward - self.profile.upward
        total = budget.reflectance + budget.transmittance + budget.absorption.sum(axis=0)
        np.testing.assert_allclose(total, 1.0, atol=tolerance)
        np.testing.assert_allclose(net[0], 1.0 - budget.reflectance, atol=tolerance)
        np.testing.assert_allclose(net[-1], budget.transmittance, atol=tolerance)
        absorption = iter(budget.absorption)
        for element, loss in zip(self.elements, net[:-1] - net[1:], strict=True):
            expected = 0.0 if element.emission is None else next(absorption)
            np.testing.assert_allclose(loss, expected, atol=tolerance)


@pytest.mark.parametrize("saturations", SATURATIONS)
def test_interfaces_keep_equilibrium(saturations):
    interface = make_wet_interface(saturations, WATER, CELLS, COSINES)
    above, below = (
        make_isotropic(make_optics(1.0, s, [1.0, 1.0]), STREAMS, COSINES.size)[..., np.newaxis]
        for s in saturations
    )
    rising = interface.reflection_above @ above + interface.transmission_up @ below
    falling = interface.reflection_below @ below + interface.transmission_down @ above
    np.testing.assert_allclose(rising, above, rtol=1e-12)
    np.testing.assert_allclose(falling, below, rtol=1e-12)


@pytest.mark.parametrize("saturation", [1e-9, 0.05, 0.5])
def test_boundaries_keep_equilibrium(saturation):
    """Isotropic light outside and inside: the same flux enters and leaves."""
    boundary = make_wet_boundary(saturation, WATER, CELLS, COSINES)
    isotropic = make_isotropic(make_optics(1.0, saturation, [1.0, 1.0]), STREAMS, COSINES.size)
    np.testing.assert_allclose(boundary.reflection + boundary.transmission, 1.0, rtol=1e-12)
    leaving = 2.0 * (boundary.transmission * isotropic**2)[:, :N].sum(axis=-1)
    np.testing.assert_allclose(leaving + boundary.outer_reflectance[:, -1], 1.0, rtol=1e-12)
    beams = boundary.shares.reshape(2, 2, -1).sum(axis=1) + boundary.outer_reflectance[:, :-1]
    np.testing.assert_allclose(beams, 1.0, rtol=1e-12)


@pytest.mark.parametrize("saturations", SATURATIONS)
@pytest.mark.parametrize("thickness", [1e-3, 3.0])
def test_white_ground_without_absorption_encloses_equilibrium(saturations, thickness):
    stack = Stack.from_layers([(thickness, s, [1.0, 1.0]) for s in saturations], ground=1.0)
    profile = stack.profile
    np.testing.assert_allclose(stack.budget.reflectance, 1.0, rtol=1e-12)
    for level, isotropic in enumerate(stack.isotropic):
        streams = (isotropic**2)[:, :N]
        flux = 2.0 * streams.sum(axis=-1)
        actinic = 4.0 * (streams / stack.cosines[:, :N]).sum(axis=-1)
        np.testing.assert_allclose(profile.downward[level, :, -1], flux, rtol=1e-12)
        np.testing.assert_allclose(profile.upward[level, :, -1], flux, rtol=1e-12)
        np.testing.assert_allclose(profile.actinic[level, :, -1], actinic, rtol=1e-12)


@pytest.mark.parametrize("ground", [0.0, 0.6])
@pytest.mark.parametrize("water", [0.0, 0.1])
def test_energy_is_conserved(water, ground):
    albedo = [0.999, 0.9]
    layers = [(0.5, 0.02, albedo), (3.0, 0.3, albedo), (2.0, 0.3, [0.9, 1.0]), (1.0, 0.1, albedo)]
    stack = Stack.from_layers(layers, ground, water)
    stack.check_energy()
    assert stack.profile.actinic.shape == (7, 2, 4)
    for values in (*stack.profile, *stack.budget):
        assert (values > -1e-13).all()


@pytest.mark.parametrize("thickness", [0.0, 1e-8, 1e4, 1e8])
@pytest.mark.parametrize("albedo", [0.0, 1.0 - 1e-12, 1.0])
def test_extremes_are_finite(thickness, albedo):
    for ground in (0.0, 1.0):
        stack = Stack.from_layers([(thickness, s, [albedo] * 2) for s in (0.05, 0.3)], ground)
        stack.check_energy()
        for values in (*stack.profile, *stack.budget):
            assert np.isfinite(values).all()


def test_divisions_do_not_change_fluxes():
    albedo, ground = [0.99, 0.8], 0.4
    merged = Stack.from_layers([(2.0, 0.1, albedo), (3.0, 0.25, albedo)], ground, water=0.05)
    parts = [(0.7, 0.1, albedo), (1.3, 0.1, albedo), (1.0, 0.25, albedo), (2.0, 0.25, albedo)]
    divided = Stack.from_layers(parts, ground, water=0.05)
    np.testing.assert_allclose(merged.budget.reflectance, divided.budget.reflectance, atol=1e-13)
    absorption = divided.budget.absorption.reshape(2, 2, 2, -1).sum(axis=1)
    np.testing.assert_allclose(merged.budget.absorption, absorption, atol=1e-13)
    for one, other in zip(merged.profile, divided.profile, strict=True):
        np.testing.assert_allclose(one, other[[0, 2, 3, 5]], atol=1e-13)


def test_fluxes_are_those_of_radiances():
    """All radiances under diffuse light as one system of equations, without reciprocity."""
    albedo = [0.99, 0.8]
    stack = Stack.from_layers(
        [(0.5, 0.1, albedo), (2.0, 0.3, albedo), (1.0, 0.3, albedo)], 0.4, water=0.05
    )
    top, bottom = stack.boundaries
    at_ground, _ = reflect_at_bottom(bottom, stack.isotropic[-1], stack.ground, N)
    n_levels = len(stack.isotropic)
    for i in range(WATER.size):
        # Radiances downwards and upwards at the levels.
        matrix = np.eye(2 * n_levels * N).reshape(2, n_levels, N, 2, n_levels, N)
        down, up = matrix
        source = np.zeros((2, n_levels, N))
        source[0, 0] = (top.transmission * stack.isotropic[0])[i, :N]
        down[0, :, 1, 0] -= np.diag(top.reflection[i, :N])
        up[-1, :, 0, -1] -= at_ground[i, :N, :N]
        for j, element in enumerate(stack.elements):
            above, below, falling, rising = (values[i, :N, :N] for values in element[:4])
            up[j, :, 0, j] -= above
            up[j, :, 1, j + 1] -= rising
            down[j + 1, :, 1, j + 1] -= below
            down[j + 1, :, 0, j] -= falling
        size = 2 * n_levels * N
        radiances = np.linalg.solve(matrix.reshape(size, size), source.ravel())
        isotropic = np.array(stack.isotropic)[:, i, :N]
        fluxes = 2.0 * isotropic * radiances.reshape(2, n_levels, N)
        expected = *fluxes.sum(axis=-1), (fluxes / stack.cosines[i, :N]).sum(axis=(0, -1))
        for actual, values in zip(stack.profile[1:], expected, strict=True):
            np.testing.assert_allclose(actual[:, i, -1], values, atol=1e-13)


def test_states_of_equal_optics_are_one_state():
    """Water of a refractive index of 1 changes nothing, at any saturation."""
    # Without a forward peak, which is only that of light that stays in its state.
    moments = np.where(np.arange(N + 1) < N, 0.75 ** np.arange(N + 1), 0.0)
    albedo, index, saturations = np.array([0.99, 0.7]), np.ones(2), [0.02, 0.3, 0.1]
    layers = [
        LayerOptics.from_albedo(np.full(2, thickness), albedo, moments)
        for thickness in (0.5, 3.0, 2.0)
    ]
    divided = []
    for optics, saturation in zip(layers, saturations, strict=True):
        parts = np.array([1.0 - saturation, saturation])
        factors = np.sqrt(np.outer(parts, parts))[..., np.newaxis]
        scattering, unit = factors * optics.scattering, np.ones((2, 1))
        divided.append(LayerOptics(optics.thickness, unit + 0.0 * parts, scattering, unit * parts))
    dry, wet = Stack(layers, [None] * 3, 0.4), Stack(divided, saturations, 0.4, index)
    for one, other in zip(dry.budget, wet.budget, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-13)
    for one, other in zip(dry.profile, wet.profile, strict=True):
        np.testing.assert_allclose(one[[0, 1, 1, 2, 2, 3]], other, atol=1e-13)


def test_transmission_without_absorption_decreases_as_inverse_thickness():
    """1/T is linear in τ, also where k² is smaller than rounding errors of the matrices.

    All coefficients are exact in binary, so that nothing is absorbed.
    """
    thickness = np.array([1e4, 1e6, 1e8, 1e10])
    optics = make_optics(1.0, 0.5, np.ones(4), np.full(4, 2.0))
    optics = optics._replace(thickness=thickness).truncate(N)
    slab = solve_slab(optics, STREAMS, np.empty((2, 0)))
    isotropic = make_isotropic(optics, STREAMS, 0)[..., np.newaxis]
    resistance = 1.0 / (np.swapaxes(isotropic, -1, -2) @ slab.transmission @ isotropic)[:, 0, 0]
    slope = np.diff(resistance) / np.diff(thickness)
    np.testing.assert_allclose(slope, slope[0], rtol=1e-9)


@pytest.mark.parametrize("water", [0.0, 1e-9, 0.1])
@pytest.mark.parametrize("albedo", [0.5, 1.0 - 1e-9, 1.0])
@pytest.mark.parametrize("thickness", [1e-8, 0.5, 80.0, 1e4])
def test_transmission_has_a_small_relative_error(thickness, albedo, water):
    """Transmission of a slab, down to the smallest numbers, is that of two halves."""
    directions = refract_directions(COSINES, WATER)
    whole, half = (
        solve_slab(make_optics(t, 0.1, [albedo] * 2, water=water).truncate(N), STREAMS, directions)
        for t in (thickness, 0.5 * thickness)
    )
    passed = np.linalg.inv(np.eye(N) - half.reflection @ half.reflection) @ half.transmission
    direct = half.direct[..., np.newaxis]
    rows = half.beam_transmission + direct * half.beam_reflection @ half.reflection
    for one, two in (
        (whole.transmission, half.transmission @ passed),
        (whole.beam_transmission, direct * half.beam_transmission + rows @ passed),
    ):
        np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-11 * two.max() + 1e-300)
