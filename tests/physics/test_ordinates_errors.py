"""Stated errors of discrete ordinates where they could be too small by chance or by a rule."""

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z

import splits
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.derivatives import SpectrumDerivatives, solve_derivatives
from splits.discrete_ordinates.grain_tabulation import N_RAYS, TableAxes, tabulate_grains
from splits.discrete_ordinates.grains import Axis
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    compute_optics_error,
    find_seen_layers,
    load_natural_grains,
    solve_spectrum,
)
from splits.discrete_ordinates.snow_packs import solve_spectra
from splits.simulation.grain_optics import GRAIN_RAYS_PER_CHUNK
from splits.simulation.run_options import RunOptions

GRAZING = [88.3, 88.7, 89.2, 89.5, 89.74, 89.9, 89.96]
VERY_WET = {
    "specific_surface_area_m2_kg": 20.0, "density_kg_m3": 300.0, "liquid_water_content": 0.32,
}  # fmt: skip


def make_snow(**changes):
    return splits.Snow.natural(**{"specific_surface_area_m2_kg": 20.0, **changes})


def solve(medium, wavelengths, incidence, error, **keywords):
    return splits.spectrophotometer(
        medium,
        wavelengths,
        incidence,
        max_stderr=error,
        solver="discrete_ordinates",
        threads=1,
        **keywords,
    )


def make_transparent(k, **changes):
    return make_snow(refractive_index={"ice": complex(1.31, k)}, **changes)


@pytest.mark.parametrize("instrument", ["spectrophotometer", "goniophotometer"])
def test_transparent_layers_have_the_error_of_weakly_absorbing_ones(instrument):
    def compute_error(k):
        medium = make_transparent(k, depth_m=0.006)
        if instrument == "spectrophotometer":
            found = solve(medium, [500.0], 0.0, 1e-6)
            assert found.attrs["stop_reason"] == "solver_error"
            return found.reflectance_stderr
        return splits.goniophotometer(
            medium, [500.0], 0.0, relative_stderr=1e-4, polar_deg=[30.0], azimuth_deg=[0.0],
            solver="discrete_ordinates",
        ).reflectance_stderr  # fmt: skip

    none, weak = (float(compute_error(k).max()) for k in (0.0, 1e-30))
    assert none == pytest.approx(weak, rel=1e-6)
    assert none > 2e-5


def test_transparent_half_spaces_reflect_all_light():
    found = solve(make_transparent(0.0), [500.0], 30.0, 1e-6)
    assert found.reflectance.item() == pytest.approx(1.0, abs=1e-6)
    assert found.reflectance_stderr.item() < 1e-6


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("depth_m", [0.003, 0.006, 0.03])
def test_errors_of_transparent_layers_agree_with_the_scatter_between_tables(depth_m):
    rays, beam = 20 * GRAIN_RAYS_PER_CHUNK, np.array([1.0])
    natural = splits.Snow.natural(optical_radius_um=100.0)
    snowpack = make_granular_stack(make_transparent(0.0, depth_m=depth_m), np.array([500.0]))
    (layer,) = snowpack.layers
    axes = TableAxes(
        Axis(layer.contrast), Axis(np.zeros(1)), Axis(np.array([0.0, 0.01])), layer.water_index
    )
    solution = solve_spectrum(snowpack, beam, 1.0)
    expected = snowpack.solve(beam, 8).reflectance[0, 0]
    error = solution.optics_error[0] * np.sqrt(N_RAYS / rays)
    z = []
    for seed in range(12):
        table = tabulate_grains(natural, axes, 17, rays, RunOptions.start(300 + seed))
        other = snowpack._replace(layers=[layer._replace(grains=table)])
        z.append((other.solve(beam, 8).reflectance[0, 0] - expected) / error)
    # The error is that of the beam for which it is largest.
    judge_z(z, "reflectances of transparent layers", bound_added=True)


@pytest.mark.parametrize("depth_m", [0.01, np.inf])
@pytest.mark.parametrize("wavelength", [600.0, 1300.0, 1616.0, 2310.0])
def test_one_wavelength_at_grazing_incidence(wavelength, depth_m):
    """The change with twice as many streams is small by chance at some angles."""
    snowpack = make_granular_stack(make_snow(depth_m=depth_m), np.array([wavelength]))
    ratios = []
    for angle in GRAZING:
        cosine = np.cos(np.radians([angle]))
        fine = snowpack.solve(cosine, 128)
        for max_error in (0.02, 0.002, 0.001, 0.0005):
            solution = solve_spectrum(snowpack, cosine, max_error)
            for name in ("reflectance", "transmittance"):
                one, other = (getattr(each, name)[0, 0] for each in (solution.budget, fine))
                ratios.append((one - other) / (solution.truncation[0] + 1e-6))
    assert np.abs(ratios).max() < 2.5
    assert np.sqrt(np.mean(np.square(ratios))) < 1.2


def test_many_snowpacks_have_the_errors_of_each():
    """Grazing beams beside steep ones."""
    angles, wavelengths = np.array([10.0, 88.7, 89.74]), np.array([600.0, 2310.0])
    cosines = np.cos(np.radians(angles))[:, np.newaxis]
    one = make_granular_stack(make_snow(), wavelengths)
    (layer,) = one.layers
    repeated = {
        name: np.repeat(getattr(layer, name)[np.newaxis], angles.size, axis=0)
        for name in ("depth_m", "collisions_per_m", "wet_fraction", "grain_absorption",
                     "pore_absorption")
    }  # fmt: skip
    many = GranularStack([layer._replace(**repeated)], np.zeros((angles.size, 2)))
    together = solve_spectra(many, cosines, 1e-3)
    for number, cosine in enumerate(cosines):
        alone = solve_spectrum(one, cosine, 1e-3)
        assert together.n_streams[number] == alone.n_streams
        np.testing.assert_allclose(together.truncation[number], alone.truncation, rtol=1e-6)


@pytest.mark.parametrize("incidence", [20.0, 89.5, "diffuse"])
@pytest.mark.parametrize("water", [0.0, 0.05])
def test_transmittances_below_1e_30(incidence, water):
    """Errors of the logarithm above 1 are not proportional to the transmittance."""
    found = []
    for wavelength in (1500.0, 1960.0, 2077.78, 2390.0):
        for depth in (0.1, 0.3, 1.0):
            snow = make_snow(depth_m=depth, liquid_water_content=water)
            few, many = (solve(snow, [wavelength], incidence, error) for error in (0.05, 1e-6))
            if not 0.0 < float(few.transmittance.item()) < 1e-30:
                continue
            found.append(abs(compare_results(few, many, "transmittance").item()))
    assert len(found) >= 4
    assert max(found) < 3.0


def test_transmitted_radiance_and_derivatives_below_1e_30():
    depth, wavelength = 0.3, [2077.78]
    snow = make_snow(depth_m=depth)
    few, many = (
        splits.goniophotometer(
            snow, wavelength, 20.0, relative_stderr=error, polar_deg=[0.0, 40.0],
            azimuth_deg=[0.0, 90.0], solver="discrete_ordinates",
        )
        for error in (0.05, 1e-4)
    )  # fmt: skip
    assert (few.btdf < 1e-30).all() and (few.btdf > 0.0).any()
    assert (np.abs(compare_results(few, many, "btdf")) <= 3.0).all()
    names = ["specific_surface_area_m2_kg", "depth_m"]
    few, many = (solve(snow, wavelength, 20.0, error, jacobian=names) for error in (0.05, 1e-6))
    assert (np.abs(compare_results(few, many, "transmittance_jacobian")) <= 3.0).all()


@pytest.mark.parametrize("angle", [0.0, 5.0, 20.0, 60.0])
def test_very_wet_snow_hardly_depends_on_the_number_of_streams(angle):
    """In wet pores, the forward peak has moments beyond those of the table."""
    snowpack = make_granular_stack(splits.Snow.natural(**VERY_WET), np.array([500.0, 1150.0]))
    cosine = np.cos(np.radians([angle]))
    reference = snowpack.solve(cosine, 32).reflectance
    for n_streams in (16, 24, 48, 64, 128):
        np.testing.assert_allclose(
            snowpack.solve(cosine, n_streams).reflectance, reference, atol=1.5e-4
        )


@pytest.mark.parametrize("depth_m", [0.03, np.inf])
def test_derivatives_of_very_wet_snow(depth_m):
    snow, wavelengths = splits.Snow.natural(**VERY_WET, depth_m=depth_m), np.array([500.0, 1150.0])
    snowpack = make_granular_stack(snow, wavelengths)
    for angle in (20.0, 53.0, 75.0):
        cosine = np.cos(np.radians([angle]))
        names = ["incidence_deg", "liquid_water_content"]
        derivatives = SpectrumDerivatives.from_medium(snow, names, wavelengths, angle)
        fine, _ = derivatives.solve(96)
        for max_error in (0.002, 0.0002):
            values, errors = solve_derivatives(
                derivatives, solve_spectrum(snowpack, cosine, max_error)
            )
            assert (np.abs(values - fine) <= 1.5 * errors + 1e-12).all()


@pytest.mark.parametrize("water", [0.0, 0.1])
def test_derivatives_at_grazing_incidence(water):
    snow, names = make_snow(liquid_water_content=water), ["specific_surface_area_m2_kg"]
    for wavelength in (900.0, 1271.0):
        snowpack = make_granular_stack(snow, np.array([wavelength]))
        for angle in GRAZING[2::2]:
            derivatives = SpectrumDerivatives.from_medium(
                snow, names, np.array([wavelength]), angle
            )
            fine, _ = derivatives.solve(96)
            for max_error in (0.01, 0.001):
                solution = solve_spectrum(snowpack, np.cos(np.radians([angle])), max_error)
                values, errors = solve_derivatives(derivatives, solution)
                assert (np.abs(values - fine) <= 2.5 * errors + 1e-12).all()


def test_anisotropy_factors_have_the_error_of_their_reflectance():
    """The BRDF changes little by chance in some directions, where the reflectance does not."""
    for wavelength, incidence in ((1600.0, 86.7), (1300.0, 80.0), (700.0, 85.0)):
        few, many = (
            splits.goniophotometer(
                make_snow(), [wavelength], incidence, relative_stderr=error,
                polar_deg=[0.0, 30.0, 60.0, 80.0, 89.0], azimuth_deg=[0.0, 45.0, 90.0, 180.0],
                solver="discrete_ordinates",
            )
            for error in (0.01, 1e-3)
        )  # fmt: skip
        assert (np.abs(compare_results(few, many, "anisotropy_factor")) <= 3.0).all()


@NEEDS_JIT
@pytest.mark.slow
def test_wet_snow_between_the_saturations_of_the_table():
    """Reflectances change with saturation as those of paths at the same saturations.

    Paths have the same random numbers at all saturations, and little noise in differences.
    """
    contrast, q = np.array([0.34]), np.array([0.0, 0.03, 0.1])
    kept, rays = load_natural_grains(wet=True), 300 * GRAIN_RAYS_PER_CHUNK
    saturations = np.array([0.14, 0.2, 0.3, 0.38])
    water = kept.contrast.compute_weights(contrast) @ kept.water
    axes = TableAxes(Axis(contrast), Axis(saturations), Axis(q), water)
    natural = splits.Snow.natural(optical_radius_um=100.0)
    traced = tabulate_grains(natural, axes, 17, rays, RunOptions.start(7))
    stack = make_granular_stack(make_snow(liquid_water_content=0.1), np.full(2, 1150.0))
    (layer,) = stack.layers

    def reflect(table, saturation):
        grains = layer._replace(
            contrast=np.repeat(contrast, 2), water_index=np.repeat(water, 2), grains=table,
            grain_absorption=q[1:] / (1.0 - q[1:]), pore_absorption=np.zeros((2, 2)),
            wet_fraction=np.asarray(saturation),
        )  # fmt: skip
        snow = stack._replace(layers=[grains])
        return snow.solve(np.array([0.5]), 8).reflectance, compute_optics_error(snow)

    difference, errors = [], []
    for number, saturation in enumerate(saturations):
        part = slice(number, number + 1)
        direct = traced._replace(
            saturation=Axis(saturations[part]), moments=traced.moments[:, part],
            slopes=traced.slopes[:, part],
        )  # fmt: skip
        found, error = reflect(kept, saturation)
        difference.append(found - reflect(direct, saturation)[0])
        errors.append(error[:, np.newaxis])
    first, *between, last = difference
    for number, change in enumerate(between, start=1):
        weight = (saturations[number] - 0.14) / (0.38 - 0.14)
        assert (np.abs(change - (1.0 - weight) * first - weight * last) <= errors[number]).all()


def test_errors_of_differences_cover_more_streams():
    # Errors of both media are nearly equal, but not fully correlated: their difference is no error.
    soot = {"black_carbon": 100.0}
    media = {
        name: splits.Snow.natural(specific_surface_area_m2_kg=20.0, impurities_ng_g=impurities)
        for name, impurities in (("clean", {}), ("sooty", soot))
    }
    wavelengths = np.arange(400.0, 1300.0, 100.0)
    few, many = (
        splits.spectrophotometer(
            media, wavelengths, 60.0, max_stderr=error, solver="discrete_ordinates"
        )
        for error in (0.002, 2e-6)
    )
    change, stderr = few.errors.difference("reflectance", "clean", "sooty")
    deviation = np.abs(change - many.errors.difference("reflectance", "clean", "sooty")[0])
    assert (deviation < 3.0 * stderr).all()
    errors = few.reflectance_stderr
    np.testing.assert_allclose(
        stderr, np.hypot(errors.sel(medium="clean"), errors.sel(medium="sooty"))
    )


@pytest.mark.parametrize("water", [0.0, 0.02])
@pytest.mark.parametrize("incidence", [20.0, 84.0, "diffuse"])
def test_layers_that_are_not_seen_change_less_than_the_cutoff(water, incidence):
    layers = [
        splits.Snow.natural(
            specific_surface_area_m2_kg=area, density_kg_m3=density, depth_m=0.03,
            liquid_water_content=water, impurities_ng_g={"black_carbon": soot},
        )
        for area, density, soot in zip(
            np.linspace(50.0, 6.0, 12), np.linspace(120.0, 450.0, 12), np.tile([0.0, 3e3], 6),
            strict=True,
        )
    ]  # fmt: skip
    wavelengths = np.array([350.0, 500.0, 800.0, 1100.0, 1500.0, 2200.0])
    stack = make_granular_stack(splits.Stack(layers, ground=0.9), wavelengths)
    cosines = np.array([] if incidence == "diffuse" else [np.cos(np.radians(incidence))])
    complete = stack.solve(cosines, 8).reflectance
    for cutoff in (1e-2, 1e-4, 1e-6):
        cut = stack._replace(cutoff=cutoff)
        seen = find_seen_layers(cut.compute_optics(9).truncate(8), cutoff)
        assert seen[0].all() and not seen[-1].all()
        # Once a layer is not seen, none below it is.
        assert (seen[:-1] | ~seen[1:]).all()
        error = np.abs(cut.solve(cosines, 8).reflectance - complete).max()
        assert 0.0 < error < cutoff
