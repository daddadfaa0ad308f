"""Radiances by discrete ordinates, dry and wet, against exact solutions and another program."""

import numpy as np
import pytest
from test_ordinates_snow import WATER, N, Stack, make_wet_optics

from splits.discrete_ordinates.adding import (
    Boundary,
    Element,
    compute_budget,
    compute_reflectance,
    make_isotropic,
)
from splits.discrete_ordinates.granular_layers import (
    N_PEAK_ORDERS,
    estimate_phase_error,
    extend_forward_peak,
)
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab
from splits.discrete_ordinates.radiance import (
    TRANSMITTED,
    Geometry,
    PlaneLayers,
    compute_bidirectional,
    sum_legendre,
    trace_direct_light,
)

ORDERS = 400
AZIMUTHS = np.array([0.0, 0.7, 2.0, np.pi])
STACKS = {
    "one layer": ([2.0], [0.9], [0.75], 0.0),
    "weak absorption": ([1.5], [0.999], [0.5], 0.0),
    "two layers": ([0.4, 3.0], [0.5, 0.99], [0.3, 0.8], 0.6),
    "three layers": ([0.5, 1.5, 1.0], [0.9, 0.99, 0.6], [0.3, 0.85, 0.6], 0.3),
}


def make_optics(thickness, albedo, asymmetry, orders=ORDERS):
    """Return layers with phase functions of Henyey and Greenstein."""
    moments = np.array(asymmetry)[..., np.newaxis] ** np.arange(orders)
    return LayerOptics.from_albedo(np.array(thickness, float), np.array(albedo, float), moments)


def scatter(optics, ground, cosines, n_streams=16, azimuths=AZIMUTHS, **settings):
    """Return the BRDF and the BTDF between all directions."""
    streams = Streams.from_number(n_streams)
    geometry = Geometry(np.asarray(cosines), np.asarray(cosines), np.asarray(azimuths))
    layers = PlaneLayers(optics, np.asarray(ground))
    return compute_bidirectional(layers, streams, geometry, **settings)


def reflect(*arguments, **settings):
    """Return the BRDF between all directions."""
    return scatter(*arguments, **settings)[0]


def solve_reference(thickness, albedo, asymmetry, ground, beam, streams):
    """Return cosines of PythonicDISORT and the radiances upwards and downwards.

    The irradiance is 1.
    """
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    moments = np.array(asymmetry)[..., np.newaxis] ** np.arange(ORDERS)
    cosines, *_, radiance = pydisort(
        np.cumsum(thickness), np.array(albedo), streams, moments, beam, 1.0 / beam,
        0.0, NLeg=streams, NFourier=streams, f_arr=moments[:, streams], NT_cor=True,
        BDRF_Fourier_modes=[ground] if ground else [],
    )  # fmt: skip
    upward = slice(0, streams // 2)
    downward = slice(streams // 2, None)
    bottom = radiance(np.sum(thickness), AZIMUTHS)[downward]
    return cosines[upward], radiance(0.0, AZIMUTHS)[upward], bottom


@pytest.mark.parametrize("name", STACKS)
def test_same_streams_agree_with_other_program(name):
    *layers, ground = STACKS[name]
    for beam in (0.6, 0.1, 0.999):
        cosines, expected, _ = solve_reference(*layers, ground, beam, 32)
        actual = reflect(make_optics(*layers), ground, [beam, *cosines], 32, tolerance=1e-12)
        np.testing.assert_allclose(actual[0, 1:], expected, rtol=1e-8)


@pytest.mark.parametrize(("thickness", "ground"), [(1e-3, 0.0), (1.0, 0.4), (30.0, 0.0)])
def test_transmission_agrees_with_other_program(thickness, ground):
    """Phase functions of few moments need no correction, which differs for transmitted light."""
    layers = [thickness * np.array([0.2, 0.5, 0.3]), [0.5, 0.9, 0.7], [0.3, -0.25, 0.2]]
    for beam in (0.6, 0.1, 0.999):
        cosines, reflected, transmitted = solve_reference(*layers, ground, beam, 32)
        # The other program loses digits for grazing beams.
        tolerance = 1e-7 if beam < 0.5 or thickness < 0.01 else 2e-10
        actual = scatter(make_optics(*layers), ground, [beam, *cosines], 32, tolerance=1e-13)
        np.testing.assert_allclose(actual[0, 0, 1:], reflected, rtol=tolerance)
        np.testing.assert_allclose(actual[1, 0, 1:], transmitted, rtol=tolerance)


def test_few_streams_converge_to_many():
    """Correction of single scattering decreases the error at few streams by an order."""
    *layers, ground = STACKS["three layers"]
    cosines, exact, _ = solve_reference(*layers, ground, 0.6, 64)
    selected = [4, 10, 18, 26, 31]
    optics, directions = make_optics(*layers), [0.6, *cosines[selected]]
    geometry = Geometry(np.array([0.6]), cosines[selected], AZIMUTHS)
    cosine = geometry.compute_scattering_cosines()
    errors = {}
    for n in (8, 16, 32, 48):
        corrected = reflect(optics, ground, directions, n)[0, 1:]
        truncated = sum_legendre(optics.truncate(n).scattering[:, 0, 0], cosine)
        uncorrected = compute_bidirectional(
            PlaneLayers(optics, np.array(ground)), Streams.from_number(n), geometry,
            lambda a, b, cosines, truncated=truncated: truncated,
        )[0, 0]  # fmt: skip
        errors[n] = [
            np.abs(values / exact[selected] - 1.0).max() for values in (corrected, uncorrected)
        ]
    print({n: [f"{e:.1e}" for e in pair] for n, pair in errors.items()})
    assert errors[8][0] < 0.01 and errors[8][0] < 0.1 * errors[8][1]
    assert errors[16][0] < 1e-3 and errors[16][0] < 0.1 * errors[16][1]
    assert errors[32][0] < 2e-5 and errors[32][0] < 0.1 * errors[32][1]
    assert errors[48][0] < 1e-6


def test_normal_incidence_agrees_with_van_de_hulst():
    """Van de Hulst (1980), Multiple Light Scattering, table 35: g = 0.75, ω = 0.9, τ = 2."""
    cosines = [1.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0]
    brdf = reflect(make_optics([2.0], [0.9], [0.75]), 0.0, cosines, 32)
    expected = [0.13304, 0.13856, 0.11956, 0.09411, 0.07132, 0.06180]
    np.testing.assert_allclose(np.pi * brdf[0, 1:, 0], expected, atol=1e-5)
    # All azimuths are equal.
    np.testing.assert_allclose(brdf[0], brdf[0, :, :1] * np.ones(4), rtol=1e-12)


def test_isotropic_half_space_agrees_with_functions_of_chandrasekhar():
    cosines = np.array([0.05, 0.2, 0.5, 0.8, 1.0])
    albedo = np.array([0.5, 0.9, 0.999, 1.0])
    optics = LayerOptics.from_albedo(
        np.full((1, 4), np.inf), albedo[np.newaxis], np.ones((1, 4, 1))
    )
    brdf = reflect(optics, np.zeros(4), cosines, 32, [0.0, 2.0])
    x, w = np.polynomial.legendre.leggauss(100)
    nodes, weights = 0.25 * (x + 1.0) ** 2, 0.5 * w * (x + 1.0)

    def apply(h, mu, omega):
        integral = (weights * nodes * h / (mu[:, np.newaxis] + nodes)).sum(axis=-1)
        return 1.0 / (np.sqrt(1.0 - omega) + 0.5 * omega * integral)

    for values, omega in zip(brdf, albedo, strict=True):
        h = np.ones(nodes.size)
        for _ in range(60):
            h = 0.5 * (h + apply(h, nodes, omega))
        h = apply(h, cosines, omega)
        expected = omega * np.outer(h, h) / (4.0 * np.pi * np.add.outer(cosines, cosines))
        np.testing.assert_allclose(values[..., 0], expected, rtol=1e-6)
        np.testing.assert_allclose(values[..., 1], expected, rtol=1e-6)


@pytest.mark.parametrize(("ground", "asymmetry"), [(0.3, [0.3, 0.85, 0.6]), (0.0, [0.3, 0.6, 0.5])])
def test_radiance_integrates_to_reflectance_and_transmittance(ground, asymmetry):
    thickness, albedo, *_ = STACKS["three layers"]
    n = 32
    quadrature = Streams.from_number(n)
    cosines = np.array([0.3, 0.8, *quadrature.cosines])
    optics = make_optics(thickness, albedo, asymmetry)
    azimuths = 2.0 * np.pi * np.arange(64) / 64
    values = scatter(optics, ground, cosines, n, azimuths, tolerance=1e-10)[:, :2, 2:]
    weights = 2.0 * np.pi * quadrature.weights * quadrature.cosines
    reflectance, transmittance = values.mean(axis=-1) @ weights
    slabs = solve_slab(optics.truncate(n), quadrature, cosines[np.newaxis, :2])
    isotropic = make_isotropic(optics, quadrature, 2)
    elements = Element.from_slab(slabs, isotropic).split()
    boundaries = [Boundary.make_transparent(n // 2, 2)] * 2
    budget = compute_budget(elements, isotropic[[0, -1]], boundaries, np.array(ground), n // 2)
    np.testing.assert_allclose(reflectance, budget.reflectance[:2], rtol=1e-5)
    if not ground:
        direct = trace_direct_light(PlaneLayers(optics, np.array(ground)), cosines[:2])[0]
        total = transmittance + direct.transmitted
        np.testing.assert_allclose(total, budget.transmittance[:2], rtol=1e-5)


def test_reflection_is_reciprocal_and_batched():
    cosines = [1.0, 0.85, 0.5, 0.2, 0.01]
    rng = np.random.default_rng(1)
    shape = (3, 6)
    optics = make_optics(
        rng.uniform(0.1, 5.0, shape), rng.uniform(0.5, 1.0, shape), rng.uniform(0.2, 0.9, shape)
    )
    ground = rng.uniform(0.0, 1.0, 6)
    brdf = reflect(optics, ground, cosines, tolerance=1e-12)
    assert brdf.shape == (6, 5, 5, 4)
    np.testing.assert_allclose(brdf, np.swapaxes(brdf, 1, 2), rtol=1e-12)
    for i in range(6):
        one = LayerOptics(*(values[:, i] for values in optics))
        alone = reflect(one, ground[i], cosines, tolerance=1e-12)
        np.testing.assert_allclose(brdf[i], alone, rtol=1e-11)


def test_values_of_the_phase_function_replace_its_series():
    *layers, ground = STACKS["two layers"]
    optics, streams = make_optics(*layers), Streams.from_number(16)
    geometry = Geometry(np.array([0.7]), np.array([0.3]), AZIMUTHS)
    albedo, g = (np.array(values)[:, *(np.newaxis,) * 3] for values in layers[1:])

    def evaluate(a, b, cosines):
        return albedo * (1.0 - g**2) / (1.0 + g**2 - 2.0 * g * cosines) ** 1.5

    cosine = geometry.compute_scattering_cosines(TRANSMITTED)
    series = sum_legendre(optics.scattering[..., 0, 0, :], cosine)
    np.testing.assert_allclose(series, evaluate(0, 0, cosine), rtol=1e-10)
    few = optics._replace(scattering=optics.scattering[..., :17])
    np.testing.assert_allclose(
        compute_bidirectional(PlaneLayers(few, np.array(ground)), streams, geometry, evaluate),
        compute_bidirectional(PlaneLayers(optics, np.array(ground)), streams, geometry),
        rtol=1e-10,
    )


@pytest.mark.parametrize("thickness", [1e-8, 1e-3, 1.0, 30.0])
def test_divided_layers_reflect_as_one(thickness):
    """Directions include nearly equal ones, between which transmission is interpolated."""
    cosines = np.cos(np.radians([0.0, 40.0, 40.01, 40.04, 40.2, 80.0, 89.9]))
    for albedo in (0.5, 1.0):
        whole = make_optics([thickness], [albedo], [0.7])
        parts = make_optics([0.3 * thickness, 0.7 * thickness], [albedo] * 2, [0.7] * 2)
        (brdf, btdf), expected = (scatter(o, 0.0, cosines, tolerance=1e-14) for o in (parts, whole))
        np.testing.assert_allclose(brdf, expected[0], rtol=1e-10)
        np.testing.assert_allclose(btdf, expected[1], rtol=1e-10 if thickness < 10.0 else 2e-9)
        np.testing.assert_allclose(btdf, np.swapaxes(btdf, 0, 1), rtol=1e-10)


def test_thin_layers_scatter_once():
    thickness, cosines = 1e-8, np.array([1.0, 0.5])
    both = scatter(make_optics([thickness], [0.9], [0.7]), 0.0, cosines)
    sines = np.sqrt(np.outer(1.0 - cosines**2, 1.0 - cosines**2))[..., np.newaxis]
    for sign, values in zip((-1.0, 1.0), both, strict=True):
        cosine = sines * np.cos(AZIMUTHS) + sign * np.outer(cosines, cosines)[..., np.newaxis]
        phase = (1.0 - 0.7**2) / (1.0 + 0.7**2 - 1.4 * cosine) ** 1.5
        expected = 0.9 * phase * thickness / (4.0 * np.pi * np.outer(cosines, cosines))[..., None]
        np.testing.assert_allclose(values, expected, rtol=1e-6)


@pytest.mark.parametrize("thickness", [0.0, 1e-8, 1.0, 1e8, np.inf])
@pytest.mark.parametrize("albedo", [0.0, 1.0 - 1e-12, 1.0])
def test_extremes_are_finite(thickness, albedo):
    cosines = np.cos(np.radians([0.0, 60.0, 89.9]))
    for ground in (0.0, 1.0):
        optics = make_optics([thickness] * 2, [albedo] * 2, [0.85, 0.3])
        brdf, btdf = scatter(optics, ground, cosines)
        for values in (brdf, btdf):
            assert np.isfinite(values).all()
            assert (values > -1e-16).all()
        np.testing.assert_allclose(brdf, np.swapaxes(brdf, 0, 1), rtol=1e-12, atol=1e-16)
    if albedo == 0.0 or thickness == 0.0:
        depth = 2.0 * thickness * np.add.outer(1.0 / cosines, 1.0 / cosines)
        expected = np.exp(-depth)[..., np.newaxis] * np.ones(4) / np.pi
        np.testing.assert_allclose(brdf, expected, rtol=1e-12)


COSINES = np.cos(np.radians([0.0, 60.0, 85.0]))
WET_AZIMUTHS = np.array([0.0, 0.7, np.pi])
LAYERS = [(0.4, 0.05, [0.99, 0.7]), (0.7, 0.3, [1.0, 0.9]), (0.2, 1e-9, [0.9, 0.5])]
"""Thickness, saturation and albedo."""


def make_layers(layers, ground=0.0, index=WATER, **settings):
    optics = [make_wet_optics(*layer, index=index, **settings) for layer in layers]
    stacked = LayerOptics(*(np.stack(values) for values in zip(*optics, strict=True)))
    saturations = [saturation for _, saturation, _ in layers]
    return PlaneLayers(stacked, np.full(index.size, ground), saturations, index)


def scatter_wet(layers, views=COSINES, azimuths=WET_AZIMUTHS, n_streams=N):
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
    values = scatter_wet(plane, views, azimuths).mean(axis=-1) @ (2.0 * np.pi * weights * views)
    direct = trace_direct_light(plane, COSINES)[0]
    for scattered, unscattered, total in (
        (values[0], direct.reflected, stack.budget.reflectance),
        (values[1], direct.transmitted, stack.budget.transmittance),
    ):
        np.testing.assert_allclose(scattered + unscattered, total[:, :-1], rtol=0.005)


def test_transmission_is_reciprocal():
    forward, backward = (scatter_wet(make_layers(layers)) for layers in (LAYERS, LAYERS[::-1]))
    np.testing.assert_allclose(forward[0], np.swapaxes(forward[0], 1, 2), rtol=1e-9)
    np.testing.assert_allclose(forward[1], np.swapaxes(backward[1], 1, 2), rtol=1e-9)


@pytest.mark.parametrize("ground", [0.0, 0.5])
def test_divided_wet_layers_scatter_as_one(ground):
    thickness, saturation, albedo = LAYERS[1]
    parts = [(part * thickness, saturation, albedo) for part in (0.2, 0.5, 0.3)]
    one, several = (scatter_wet(make_layers(layers, ground)) for layers in (LAYERS[1:2], parts))
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
    expected = scatter_wet(PlaneLayers(dry, wet.ground))
    np.testing.assert_allclose(scatter_wet(wet), expected, rtol=1e-4)


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
    assert not scatter_wet(plane).any()


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
