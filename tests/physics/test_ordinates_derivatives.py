"""Derivatives by discrete ordinates: optics of layers, and parameters of snow."""

from collections.abc import Callable

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results

import splits
from splits.core.validation import InvalidValue
from splits.discrete_ordinates.adding import Boundary, Element, compute_budget, make_isotropic
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.derivatives import (
    Gradient,
    compute_gradient,
    differentiate_impedances,
    divide_impedances,
)
from splits.discrete_ordinates.homogeneous_layer import (
    LayerOptics,
    Streams,
    compute_impedances,
    solve_slab,
)
from splits.discrete_ordinates.parameter_derivatives import DryDerivatives
from splits.media.parameters import get_parameter, list_parameters, replace_parameter

N = 8
STREAMS = Streams.from_number(N)
COSINES = {
    "normal": 1.0,
    "oblique": 0.6,
    "stream": float(STREAMS.cosines[1]),
    "89 degrees": np.cos(np.radians(89.0)),
    "diffuse": None,
}
CONSERVATIVE = (-30.0, -20.0)
"""Exponents of an absorption that is lost by rounding."""
KINDS = ("thickness", "extinction", "absorption", *range(N))


def extrapolate(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Return the derivative at 0 by Richardson's extrapolation, of the sixth order."""
    first, second, third = (
        (function(h) - function(-h)) / (2.0 * h) for h in (step, step / 2.0, step / 4.0)
    )
    fine, finer = (4.0 * second - first) / 3.0, (4.0 * third - second) / 3.0
    return (16.0 * finer - fine) / 15.0


def solve(optics: LayerOptics, ground: np.ndarray, cosine: float | None) -> np.ndarray:
    """Return the reflectance and the transmittance of layers."""
    cosines = np.array([] if cosine is None else [cosine])
    layers = [LayerOptics(*(field[i] for field in optics)) for i in range(len(optics.thickness))]
    isotropic = [make_isotropic(layer, STREAMS, cosines.size) for layer in layers]
    elements = [
        Element.from_slab(solve_slab(layer, STREAMS, cosines[np.newaxis]), vector)
        for layer, vector in zip(layers, isotropic, strict=True)
    ]
    faces = (Boundary.make_transparent(N // 2, cosines.size),) * 2
    budget = compute_budget(elements, (isotropic[0], isotropic[-1]), faces, ground, N // 2)
    return np.stack([budget.reflectance[..., 0], budget.transmittance[..., 0]])


def make_random_layers(seed: int, absorption: tuple[float, float]) -> LayerOptics:
    """Return one to four layers, thin or thick, or conservative, at six wavelengths."""
    generator = np.random.default_rng(seed)
    shape = (int(generator.integers(1, 5)), 6)
    thickness = 10.0 ** generator.uniform(-3.0, 2.5, shape)
    albedo = 1.0 - 10.0 ** generator.uniform(*absorption, shape)
    asymmetry = generator.uniform(0.3, 0.85, (*shape, 1))
    return LayerOptics.from_albedo(thickness, albedo, asymmetry ** np.arange(N + 1)).truncate(N)


def scale(optics: LayerOptics, layer: int, kind: str | int, factor: float) -> LayerOptics:
    """Return optics with one property of a layer times a factor.

    Scattering of order 0 changes at constant absorption.
    """
    thickness, extinction, scattering, equilibrium = (field.copy() for field in optics)
    change = factor - 1.0
    order0 = optics.scattering[layer, :, 0, 0, 0]
    if kind == "thickness":
        thickness[layer] *= factor
    elif kind == "extinction":
        extinction[layer] *= factor
        scattering[layer] *= factor
    elif kind == "absorption":
        extinction[layer, :, 0] += change * (optics.extinction[layer, :, 0] - order0)
    else:
        scattering[layer, :, 0, 0, kind] *= factor
        extinction[layer, :, 0] += change * order0 * (kind == 0)
    return LayerOptics(thickness, extinction, scattering, equilibrium)


def differentiate(gradient: Gradient, optics: LayerOptics, layer: int, kind) -> np.ndarray:
    """Return the derivative with respect to the logarithm of a property of a layer."""
    doubled = scale(optics, layer, kind, 2.0)
    tangent = LayerOptics(
        *(np.where(new == old, 0.0, new - np.where(np.isinf(old), 0.0, old))[layer]
          for new, old in zip(doubled, optics, strict=True))
    )  # fmt: skip
    return gradient.differentiate(layer, tangent)


def check_gradient(optics: LayerOptics, cosine: float | None, kinds=KINDS) -> None:
    """Compare all derivatives of layers over a ground with differences."""
    ground = np.linspace(0.0, 0.9, optics.thickness.shape[1])
    values, gradient = compute_gradient(optics, STREAMS, ground, cosine)
    np.testing.assert_allclose(values, solve(optics, ground, cosine), atol=1e-9)
    for layer in range(len(optics.thickness)):
        for kind in kinds:
            if kind == "thickness" and np.isinf(optics.thickness[layer]).any():
                continue
            expected = extrapolate(
                lambda x, layer=layer, kind=kind: solve(
                    scale(optics, layer, kind, np.exp(x)), ground, cosine
                ),
                0.02,
            )
            derivative = differentiate(gradient, optics, layer, kind)
            tolerance = 1e-6 * max(np.abs(expected).max(), 1e-4)
            np.testing.assert_allclose(derivative, expected, rtol=0.0, atol=tolerance)
    expected = extrapolate(lambda x: solve(optics, ground + x, cosine), 0.01)
    tolerance = 1e-6 * max(np.abs(expected).max(), 1e-4)
    np.testing.assert_allclose(gradient.ground, expected, rtol=0.0, atol=tolerance)
    if cosine is None:
        assert not gradient.cosine.any()
    elif cosine < 1.0:
        expected = extrapolate(lambda x: solve(optics, ground, cosine * (1.0 + x)), 0.01)
        tolerance = 1e-6 * np.abs(expected).max()
        np.testing.assert_allclose(cosine * gradient.cosine, expected, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("light", COSINES)
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.long) for n in range(1, 4))]
)
def test_gradient_of_random_layers(light, seed):
    check_gradient(make_random_layers(seed, (-7.0, -0.3)), COSINES[light])


@pytest.mark.parametrize("light", COSINES)
def test_gradient_above_a_half_space(light):
    optics = make_random_layers(5, (-4.0, -0.3))
    optics.thickness[-1] = np.inf
    check_gradient(optics, COSINES[light])


@pytest.mark.parametrize("light", COSINES)
def test_gradient_of_conservative_layers(light):
    optics = make_random_layers(6, CONSERVATIVE)
    kinds = tuple(kind for kind in KINDS if kind != "absorption")
    check_gradient(optics, COSINES[light], kinds)


def test_conservative_half_space_has_no_derivative_with_respect_to_scattering():
    optics = make_random_layers(7, CONSERVATIVE)
    optics.thickness[-1] = np.inf
    _, gradient = compute_gradient(optics, STREAMS, np.zeros(6), 0.6)
    for layer in range(len(optics.thickness)):
        for kind in ("extinction", *range(N)):
            derivative = differentiate(gradient, optics, layer, kind)
            np.testing.assert_allclose(derivative, 0.0, atol=1e-9)


@pytest.mark.parametrize("order", [0, 1])
def test_gradient_with_degenerate_eigenvalues(order):
    """Scattering of few orders leaves most modes at the rates of the streams, as a beam may be."""
    albedo = np.full((2, 6), 1e-9) if order == 0 else np.full((2, 6), 0.7)
    moments = np.zeros((2, 6, N + 1))
    moments[..., 0] = 1.0
    thickness = np.stack([np.logspace(-2.0, 1.5, 6)] * 2)
    optics = LayerOptics.from_albedo(thickness, albedo, moments).truncate(N)
    kinds = ("thickness", "extinction", "absorption", 0)
    for cosine in (COSINES["stream"], COSINES["stream"] * (1.0 + 1e-9)):
        check_gradient(optics, cosine, kinds)


def test_divided_differences_are_accurate():
    """Against the quotient in extended precision, for near, equal and distant pairs."""
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("without extended precision")
    base = np.array([1e-8, 1e-3, 0.05, 0.2, 0.21, 1.0, 5.0, 40.0])
    k = np.sort(np.concatenate([base, base * (1.0 + 1e-3)]))
    for thickness in (1e-6, 0.1, 1.0, 30.0):
        exact = k.astype(np.longdouble)
        tanh = np.tanh(0.5 * exact * thickness)
        for kind, found in enumerate(divide_impedances(k, np.array([thickness]))):
            g = exact * tanh if kind == 0 else exact / tanh
            off = ~np.eye(k.size, dtype=bool)
            quotient = ((g[:, None] - g) / np.where(off, exact[:, None] ** 2 - exact**2, 1.0))[off]
            # Rounding of the quotient itself.
            noise = 1e-18 * (g[:, None] + g)[off] / np.abs(exact[:, None] ** 2 - exact**2)[off]
            assert (np.abs(found[off] - quotient) <= 1e-11 * np.abs(quotient) + noise).all()


def test_divided_differences_of_equal_rates_are_derivatives():
    k, thickness = np.array([0.01, 0.3, 2.0]), np.array([1.5])
    found = divide_impedances(k, thickness)
    for kind in (0, 1):
        expected = extrapolate(
            lambda x, kind=kind: compute_impedances(np.sqrt(k**2 * (1.0 + x)), thickness)[kind],
            0.02,
        )
        np.testing.assert_allclose(np.diag(found[kind]) * k**2, expected, rtol=1e-8, atol=1e-13)
        expected = extrapolate(
            lambda x, kind=kind: compute_impedances(k, thickness * (1.0 + x))[kind], 0.02
        )
        slope = differentiate_impedances(k, thickness)[kind] * thickness
        np.testing.assert_allclose(slope, expected, rtol=1e-8)


WAVELENGTHS = np.array([350.0, 500.0, 800.0, 1030.0, 1300.0, 1800.0, 2250.0])


def make_random_snowpack(seed: int, is_wet: bool = False) -> splits.Stack:
    """Return a snowpack of one to four layers."""
    generator = np.random.default_rng(seed)

    def draw(low: float, high: float) -> float:
        return float(np.exp(generator.uniform(np.log(low), np.log(high))))

    n_layers = int(generator.integers(1, 5))
    is_deep = seed % 3 == 0
    layers = [
        splits.Snow.natural(
            specific_surface_area_m2_kg=draw(3.0, 80.0),
            density_kg_m3=float(generator.uniform(50.0, 550.0)),
            temperature_c=float(generator.uniform(-19.0, -11.0)),
            liquid_water_content=float(generator.uniform(0.01, 0.05)) * is_wet,
            impurities_ng_g={"black_carbon": draw(1.0, 500.0)},
            **({} if is_deep and number == n_layers - 1 else {"depth_m": draw(0.002, 0.3)}),
        )
        for number in range(n_layers)
    ]
    ground = None if is_deep else float(generator.uniform(0.1, 0.8))
    return splits.Stack(layers, ground=ground)


def list_smooth_parameters(medium: splits.Stack) -> list[str]:
    """Return the parameters for which dry or wet snow has derivatives."""
    names = []
    for name in list_parameters(medium):
        key = name.split(".")[-1]
        layer = medium.layers[int(name.split(".")[1])] if "." in name else None
        is_dry = layer is not None and layer.saturation == 0.0
        if key in ("facetness", "sphericity", "snow_algae"):
            continue
        if key in ("saturation", "liquid_water_content") and is_dry:
            continue
        if np.isfinite(get_parameter(medium, name)):
            names.append(name)
    return names


def solve_medium(medium: splits.Stack, incidence: float | str, n_streams: int) -> np.ndarray:
    cosines = np.array([] if incidence == "diffuse" else [np.cos(np.radians(incidence))])
    budget = make_granular_stack(medium, WAVELENGTHS).solve(cosines, n_streams)
    return np.stack([budget.reflectance[..., 0], budget.transmittance[..., 0]])


def extrapolate_parameter(
    medium: splits.Stack, name: str, incidence: float | str, n_streams: int
) -> np.ndarray:
    """Return the derivative with respect to a parameter by differences."""
    if name == "incidence_deg":
        return extrapolate(lambda x: solve_medium(medium, incidence + x, n_streams), 0.2)
    value = get_parameter(medium, name)
    return extrapolate(
        lambda x: solve_medium(replace_parameter(medium, name, value + x), incidence, n_streams),
        0.01 * abs(value),
    )


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.long) for n in range(1, 8))]
)
@pytest.mark.parametrize("incidence", [0.0, 53.0, 89.0, "diffuse"])
def test_every_parameter_of_dry_snow(seed, incidence):
    medium = make_random_snowpack(seed)
    names = list_smooth_parameters(medium)
    names += [] if incidence in ("diffuse", 0.0) else ["incidence_deg"]
    found, _ = DryDerivatives.from_medium(medium, names, WAVELENGTHS, incidence).solve(N)
    for number, name in enumerate(names):
        expected = extrapolate_parameter(medium, name, incidence, N)
        value = 1.0 if name == "incidence_deg" else abs(get_parameter(medium, name))
        tolerance = 1e-6 * max(np.abs(expected).max(), 1e-4 / value)
        np.testing.assert_allclose(found[:, number], expected, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("seed", [pytest.param(n, marks=pytest.mark.long) for n in (1, 3)])
def test_wet_snow_has_differences(seed):
    medium = make_random_snowpack(seed, is_wet=True)
    names = [*list_smooth_parameters(medium), "incidence_deg"]
    run = splits.spectrophotometer(
        medium, WAVELENGTHS, 40, solver="discrete_ordinates", jacobian=names
    )
    assert set(run.parameter_method.values) == {"finite_difference"}
    for number, name in enumerate(names):
        expected = extrapolate_parameter(medium, name, 40.0, run.attrs["streams"])
        tolerance = 1e-6 * max(np.abs(expected).max(), 1e-4)
        found = run.reflectance_jacobian.values[number]
        np.testing.assert_allclose(found, expected[0], rtol=0.0, atol=tolerance)


def test_spectrophotometer_returns_analytic_derivatives():
    medium = make_random_snowpack(2)
    names = ["layers.0.impurities_ng_g.dust_sahara", "incidence_deg", "ground", "layers.0.depth_m"]
    runs = [
        splits.spectrophotometer(medium, WAVELENGTHS, 30, solver=solver, jacobian=names)
        for solver in ("discrete_ordinates", "auto")
    ]
    for run in runs:
        assert run.parameter.values.tolist() == names
        assert run.parameter_method.values.tolist() == ["analytic"] * len(names)
        assert run.reflectance_jacobian.dims == ("parameter", "wavelength")
        assert (run.reflectance_jacobian_stderr > 0.0).any()
    assert runs[0].transmittance_jacobian.equals(runs[1].transmittance_jacobian)
    plain = splits.spectrophotometer(medium, WAVELENGTHS, 30, solver="auto")
    assert plain.reflectance.equals(runs[0].reflectance)


@pytest.mark.parametrize("name", ["facetness", "liquid_water_content"])
def test_parameters_that_leave_dry_natural_snow_are_rejected(name):
    snow = splits.Snow.natural(optical_radius_um=150)
    with pytest.raises(InvalidValue, match=f"{name} changes"):
        splits.spectrophotometer(snow, [500.0], solver="discrete_ordinates", jacobian=[name])


def test_error_covers_other_numbers_of_streams():
    medium = make_random_snowpack(1)
    names = list_smooth_parameters(medium)
    run = splits.spectrophotometer(
        medium, WAVELENGTHS, 60, solver="discrete_ordinates", jacobian=names
    )
    exact, _ = DryDerivatives.from_medium(medium, names, WAVELENGTHS, 60.0).solve(64)
    for side, quantity in enumerate(("reflectance", "transmittance")):
        difference = np.abs(run[f"{quantity}_jacobian"].values - exact[side])
        # Derivatives of a millionth of the largest ones decide nothing.
        negligible = 1e-6 * np.abs(exact[side]).max(axis=1, keepdims=True)
        assert (difference <= 1.5 * run[f"{quantity}_jacobian_stderr"].values + negligible).all()


@NEEDS_JIT
def test_impurities_agree_with_paths():
    snow = splits.Snow.natural(
        optical_radius_um=150, depth_m=0.02, density_kg_m3=200, ground=0.3,
        impurities_ng_g={"black_carbon": 200},
    )  # fmt: skip
    names = ["impurities_ng_g.black_carbon", "ground"]
    paths, ordinates = (
        splits.spectrophotometer(
            snow, [450.0, 850.0, 1250.0], 30, max_stderr=0.002, solver=solver, jacobian=names
        )
        for solver in ("monte_carlo", "discrete_ordinates")
    )
    z = compare_results(ordinates, paths, "reflectance_jacobian", "transmittance_jacobian")
    assert np.abs(z).max() < 4.0, z


def test_stacks_of_dry_and_wet_layers_have_derivatives():
    def make(depth=0.01):
        dry = splits.Snow.natural(specific_surface_area_m2_kg=40.0, depth_m=depth)
        keywords = {"specific_surface_area_m2_kg": 15.0, "liquid_water_content": 0.03}
        return splits.Stack([dry, splits.Snow.natural(**keywords, depth_m=0.02)], ground=0.3)

    def measure(stack, **settings):
        return splits.spectrophotometer(
            stack, [600.0, 1030.0, 1300.0], 53.0, solver="discrete_ordinates", **settings
        )

    names = ["ground", "layers.0.depth_m", "layers.1.liquid_water_content"]
    result = measure(make(), jacobian=names)
    assert (result.parameter_method == "finite_difference").all()
    high, low = (measure(make(0.01 + step)).reflectance.values for step in (1e-5, -1e-5))
    np.testing.assert_allclose(result.reflectance_jacobian[1], (high - low) / 2e-5, rtol=1e-3)


def test_differences_do_not_mix_dry_and_wet_snow():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0, liquid_water_content=2e-5)
    jacobian = {"jacobian": ["liquid_water_content"], "solver": "discrete_ordinates"}
    result = splits.spectrophotometer(snow, [1200.0], **jacobian)
    more = splits.Snow.natural(specific_surface_area_m2_kg=20.0, liquid_water_content=1e-3)
    expected = splits.spectrophotometer(more, [1200.0], **jacobian).reflectance_jacobian
    np.testing.assert_allclose(result.reflectance_jacobian, expected, rtol=0.2)
