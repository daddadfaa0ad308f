"""Polarization by grains: scattering matrices, dilute packs, energy."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, compare_results, judge_z, scale_sample_size
from scattering_matrices import compute_sphere_matrix

import splits
from splits.media.particle_layer import ELEMENTS

NM = [600.0]
PROJECTED = {"entry_point": "projected"}
SPHERES = splits.Snow(
    facetness=(0.0,) * 4, sphericity=(1.0, 1.0, 1.0, 0.0), saturation=0.0, density_kg_m3=1.0,
    interpretation=PROJECTED,
)  # fmt: skip
FACETED = splits.Snow(saturation=0.0, density_kg_m3=1.0, interpretation=PROJECTED)
SAND = splits.Sand(porosity=0.999, interpretation=PROJECTED)
STOKES = ("", "_q", "_u", "_v")
MEDIA = {
    "spheres": replace(SPHERES, refractive_index={"ice": 1.31}), "snow": FACETED, "sand": SAND,
}  # fmt: skip


@cache
def compute_optics(name: str) -> xr.Dataset:
    """Return moments and scattering matrix of a medium."""
    return splits.single_scattering(
        MEDIA[name], NM, moments=2, rays=200_000, stokes=True
    ).squeeze("wavelength")  # fmt: skip


@NEEDS_JIT
@pytest.mark.long
def test_matrix_of_smooth_spheres_is_that_of_geometric_optics():
    ds = splits.single_scattering(
        MEDIA["spheres"], NM, moments=2, rays=2_000_000, stokes=True
    ).squeeze("wavelength")  # fmt: skip
    exact = compute_sphere_matrix(1.31, ds.angle_deg.values)
    for name, expected in zip(ELEMENTS, exact, strict=True):
        if name == "P34":
            # Without total reflection, no phase differs.
            assert np.abs(ds[name]).max() < 1e-8
            continue
        stderr = ds[f"{name}_stderr"].values
        z = (ds[name].values - expected)[stderr > 0.0] / stderr[stderr > 0.0]
        # Errors from 32 batches are uncertain by 13 %.
        judge_z(z, f"sphere, {name}", independent=z.size // 2)


def compute_asymmetry(ds):
    """Return the mean cosine of P11, whose values are means with linear functions of the cosine."""
    cosines = np.cos(np.radians(ds.angle_deg.values))
    width = np.append(-np.diff(cosines), 0.0) + np.append(0.0, -np.diff(cosines))
    return 0.25 * float(np.sum(width * cosines * ds.P11.values))


@NEEDS_JIT
@pytest.mark.parametrize("name", MEDIA)
def test_moments_and_matrix_of_a_dataset_are_of_the_same_light(name):
    """Polarization changes g of smooth spheres of n = 1.31 from 0.7816 to 0.7850."""
    ds = compute_optics(name)
    g, stderr = float(ds.asymmetry_parameter), float(ds.asymmetry_parameter_stderr)
    # The rays of the matrix are as many, but others.
    assert abs(compute_asymmetry(ds) - g) < 4.0 * np.sqrt(2.0) * stderr
    if name == "spheres":
        assert abs(g - 0.7850) < 4.0 * stderr + 5e-5
        scalar = splits.single_scattering(MEDIA[name], NM, moments=2, rays=200_000)
        assert abs(scalar.asymmetry_parameter.item() - 0.7816) < 4.0 * stderr + 5e-5


@NEEDS_JIT
@pytest.mark.parametrize("name", ["snow", "sand"])
def test_matrices_of_grains_have_their_symmetries(name):
    """At 0° and 180°, by symmetry about the direction; bounds of elements; normalization."""
    ds = compute_optics(name)
    cosines = np.cos(np.radians(ds.angle_deg.values[::-1]))
    assert 0.5 * np.trapezoid(ds.P11.values[::-1], cosines) == pytest.approx(1.0, abs=1e-9)
    z = []
    for angle, sign in ((0.0, 1.0), (180.0, -1.0)):
        at = ds.sel(angle_deg=angle)
        z += [float(at[name] / at[f"{name}_stderr"]) for name in ("P12", "P34")]
        z.append(float((at.P22 - sign * at.P33) / np.hypot(at.P22_stderr, at.P33_stderr)))
    judge_z(np.array(z), "symmetries", independent=4)
    splits.ParticleLayer(scattering_matrix=ds)
    for name in ELEMENTS[1:]:
        assert (np.abs(ds[name]) <= ds.P11 + 5.0 * (ds[f"{name}_stderr"] + ds.P11_stderr)).all()


def make_pair(medium: splits.Snow | splits.Sand) -> tuple:
    """Return a dilute pack of optical thickness 1, and the layer of particles of its matrix."""
    ds = splits.single_scattering(
        medium, NM, moments=2, rays=scale_sample_size(4_000_000), stokes=True
    ).squeeze("wavelength")
    layer = splits.ParticleLayer(
        optical_thickness=1.0, refractive_index=1.0, ground=None, scattering_matrix=ds,
        single_scattering_albedo=min(float(ds.single_scattering_albedo), 1.0), polarized=True,
    )  # fmt: skip
    return replace(medium, depth_m=1.0 / float(ds.extinction)), layer


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("medium", [SPHERES, FACETED, SAND], ids=["spheres", "snow", "sand"])
@pytest.mark.parametrize("stokes", [True, (1, 0.5, -0.4, 0.6)], ids=["natural", "polarized"])
def test_dilute_packs_are_layers_of_particles_of_their_matrix(medium, stokes):
    """I, Q, U and V in 60 bins above and below."""
    bins = {"estimator": "bins", "n_bins": (6, 10), "rays": 1_000_000}
    pack, layer = make_pair(medium)
    traced = splits.goniophotometer(pack, NM, 40.0, stokes=stokes, **bins)
    expected = splits.goniophotometer(layer, NM, 40.0, seed=2, stokes=stokes, **bins)
    z = []
    for function in ("brdf", "btdf"):
        for suffix in STOKES:
            name = f"{function}{suffix}"
            # Spheres reflect no light totally: V is that of rounding.
            if np.abs(expected[name]).max() >= 1e-9:
                z.append(compare_results(traced, expected, name))
                print(f"{name}: rms z {np.sqrt(np.mean(z[-1] ** 2)):.2f}")
    family = np.concatenate(z)
    judge_z(family, "dilute pack")
    assert 0.85 < np.sqrt(np.mean(family**2)) < 1.15


@pytest.mark.long
@NEEDS_JIT
def test_particles_polarize_light_above_grains():
    """A stack of a Rayleigh layer above a dilute pack is one of two layers of particles."""
    air = splits.ParticleLayer(
        optical_thickness=0.5, single_scattering_albedo=1.0, refractive_index=1.0,
        ground=None, phase_function="rayleigh", polarized=True,
    )  # fmt: skip
    bins = {"estimator": "bins", "n_bins": (4, 8), "rays": 1_000_000}
    traced, expected = (
        splits.goniophotometer(splits.Stack([air, lower]), NM, 60.0, seed=seed, **bins)
        for seed, lower in enumerate(make_pair(SPHERES), start=1)
    )
    for name in (f"{function}{suffix}" for function in ("brdf", "btdf") for suffix in STOKES[:3]):
        judge_z(compare_results(traced, expected, name), f"particles above grains, {name}")


@NEEDS_JIT
@pytest.mark.parametrize(
    "medium",
    [
        splits.Snow(depth_m=0.005, refractive_index={"ice": 1.31, "water": 1.33}),
        splits.Snow(depth_m=0.005, interpretation={"wrong_side_ray": "mirror"}),
        splits.Sand(depth_m=0.005),
        splits.Stack(
            [splits.Snow(depth_m=0.003), splits.Sand(depth_m=0.002)],
            ground=0.4,
            interpretation="radiative_transfer",
        ),
    ],
    ids=["clear", "mirror", "sand", "stack"],
)
def test_light_is_never_more_than_fully_polarized(medium):
    bins = {"estimator": "bins", "n_bins": (3, 8), "rays": scale_sample_size(100_000)}
    polarized, scalar = (
        splits.goniophotometer(medium, NM, 60.0, seed=seed, stokes=stokes, **bins)
        for seed, stokes in ((1, True), (2, False))
    )
    for function in ("brdf", "btdf") if "btdf" in polarized else ("brdf",):
        part = sum(polarized[f"{function}{suffix}"] ** 2 for suffix in STOKES[1:])
        assert (np.sqrt(part) <= polarized[function] * (1.0 + 1e-9)).all()
    if medium.refractive_index["ice"] == 1.31 if isinstance(medium, splits.Snow) else False:
        total = polarized.reflectance + polarized.transmittance
        assert float(total[0]) == pytest.approx(1.0, abs=2e-5)
    # Polarization changes reflectances by less than a percent.
    difference = polarized.reflectance - scalar.reflectance
    stderr = np.hypot(polarized.reflectance_stderr, scalar.reflectance_stderr)
    assert (np.abs(difference) < 4.0 * stderr + 0.01 * scalar.reflectance).all()


def test_bits_of_scalar_results_do_not_depend_on_polarization():
    """The scalar kernel without polarization is compiled from the same functions."""
    snow = splits.Snow(depth_m=0.002)
    bins = {"estimator": "bins", "n_bins": (2, 4), "rays": 2048, "kernel": "scalar"}
    one, two = (splits.goniophotometer(snow, NM, 30.0, stokes=False, **bins) for _ in range(2))
    assert (one.brdf == two.brdf).all() and "brdf_q" not in one


@pytest.mark.parametrize(
    ("medium", "keywords", "message"),
    [
        (splits.Snow(), {"stokes": True}, "estimator = 'expansion': must be bins with stokes"),
        (splits.Snow(), {"stokes": "yes", "estimator": "bins"}, "stokes = 'yes'"),
        (splits.ParticleLayer(), {"stokes": True, "estimator": "bins"}, "polarized = False"),
        (splits.Snow(), {"stokes": True, "estimator": "next_event"}, "estimator = 'next_event'"),
    ],
)
def test_impossible_requests_have_a_message(medium, keywords, message):
    with pytest.raises(ValueError, match="must be") as error:
        splits.goniophotometer(medium, NM, 30.0, rays=10, **keywords)
    assert message in str(error.value)
