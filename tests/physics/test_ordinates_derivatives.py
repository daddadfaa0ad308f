"""Derivatives by discrete ordinates with respect to the parameters of snow."""

from collections.abc import Callable

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results

import splits
from splits.core.validation import InvalidValue
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.derivatives import SpectrumDerivatives
from splits.discrete_ordinates.granular_stack import solve_snowpacks
from splits.media.parameters import get_parameter, list_parameters, replace_parameter

N = 8
WAVELENGTHS = np.array([350.0, 500.0, 800.0, 1030.0, 1300.0, 1800.0, 2250.0])


def extrapolate(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Return the derivative at 0 by Richardson's extrapolation, of the sixth order."""
    first, second, third = (
        (function(h) - function(-h)) / (2.0 * h) for h in (step, step / 2.0, step / 4.0)
    )
    fine, finer = (4.0 * second - first) / 3.0, (4.0 * third - second) / 3.0
    return (16.0 * finer - fine) / 15.0


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
    found, _ = SpectrumDerivatives.from_medium(medium, names, WAVELENGTHS, incidence).solve(N)
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


def test_spectrophotometer_returns_derivatives():
    medium = make_random_snowpack(2)
    names = ["layers.0.impurities_ng_g.dust_sahara", "incidence_deg", "ground", "layers.0.depth_m"]
    runs = [
        splits.spectrophotometer(medium, WAVELENGTHS, 30, solver=solver, jacobian=names)
        for solver in ("discrete_ordinates", "auto")
    ]
    for run in runs:
        assert run.parameter.values.tolist() == names
        assert run.parameter_method.values.tolist() == ["finite_difference"] * len(names)
        assert run.reflectance_jacobian.dims == ("parameter", "wavelength")
        assert (run.reflectance_jacobian_stderr > 0.0).any()
    assert runs[0].transmittance_jacobian.equals(runs[1].transmittance_jacobian)
    plain = splits.spectrophotometer(medium, WAVELENGTHS, 30, solver="auto")
    assert plain.reflectance.equals(runs[0].reflectance)


@pytest.mark.parametrize("name", ["black_carbon", "dust_sahara"])
def test_amounts_of_clean_snow_have_one_sided_differences(name):
    """Reflectance is nearly linear in small amounts; the step follows from the declared scale."""
    parameter = f"impurities_ng_g.{name}"
    snow = splits.Snow.natural(optical_radius_um=150)
    found, error = SpectrumDerivatives.from_medium(snow, [parameter], WAVELENGTHS, 30.0).solve(N)
    changed = replace_parameter(snow, parameter, 1e-3)
    expected = (solve_medium(changed, 30.0, N) - solve_medium(snow, 30.0, N)) / 1e-3
    np.testing.assert_allclose(found[0, 0], expected[0], rtol=0.02, atol=1e-9)
    assert (error[0, 0] < 0.01 * np.abs(found[0, 0]).max()).all()


def test_snowpacks_that_are_solved_together_have_the_same_spectra():
    base = make_random_snowpack(1)
    media = [replace_parameter(base, "ground", value) for value in (0.1, 0.5, 0.9)]
    for incidence in (60.0, "diffuse"):
        cosines = np.full((3, 0 if incidence == "diffuse" else 1), 0.5)
        snowpacks = [make_granular_stack(medium, WAVELENGTHS) for medium in media]
        together = solve_snowpacks(snowpacks, cosines, N)
        for medium, found in zip(media, together, strict=True):
            np.testing.assert_allclose(found, solve_medium(medium, incidence, N), rtol=1e-12)


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
    exact, _ = SpectrumDerivatives.from_medium(medium, names, WAVELENGTHS, 60.0).solve(64)
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
