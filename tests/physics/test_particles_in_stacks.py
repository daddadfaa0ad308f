"""Layers of small particles in stacks: the layer's own kernel, cuts, ground, coin tosses."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z

import splits

TABLE = {"cosine": [-1.0, 0.0, 0.5, 1.0], "density": [0.3, 0.1, 0.4, 2.0]}
LAYERS = {
    "forward": {"optical_thickness": 5.0, "single_scattering_albedo": 0.95, "asymmetry": 0.75,
                "refractive_index": 1.3},
    "rayleigh": {"optical_thickness": 2.0, "phase_function": "rayleigh", "refractive_index": 1.0},
    "table": {"optical_thickness": 1.0, "phase_function": TABLE, "refractive_index": 1.5,
              "single_scattering_albedo": 0.6},
    "dark": {"optical_thickness": 3.0, "single_scattering_albedo": 0.0, "refractive_index": 1.33},
}  # fmt: skip
LID = splits.ParticleLayer(
    optical_thickness=1.0, refractive_index=1.31, bottom_albedo=None, depth_m=0.01
)
SNOW = splits.Snow(depth_m=0.006, saturation=0.0)
SAND = splits.Sand(depth_m=0.004, interpretation="splitsnow_2021")
WAVELENGTHS = [500.0, 900.0]


def measured(medium, incidence, seed, **settings):
    """Return R, T and A, and their errors, shape (2, 3, wavelengths)."""
    wavelengths = settings.pop("wavelengths", [550.0])
    ds = splits.spectrophotometer(medium, wavelengths, incidence, 0.002, seed, **settings)
    names = ("reflectance", "transmittance", "absorptance")
    return np.array([[ds[name] for name in names], [ds[f"{name}_stderr"] for name in names]])


def apart(one, other):
    """Return the differences of two measurements in units of their errors, where these can err."""
    error = np.hypot(one[1], other[1])
    told = error > 0.0
    assert (one[0][~told] == other[0][~told]).all()
    return ((one[0] - other[0])[told] / error[told]).ravel()


def cut(settings, pieces):
    """Return a layer of particles in so many unequal pieces."""
    shares = np.geomspace(1.0, 20.0, pieces)
    shares /= shares.sum()
    thickness = settings["optical_thickness"]
    return splits.Stack(
        [
            splits.ParticleLayer(
                **{**settings, "optical_thickness": share * thickness}, bottom_albedo=None,
                depth_m=share,
            )
            for share in shares
        ]
    )  # fmt: skip


@pytest.mark.parametrize("name", LAYERS)
def test_a_layer_in_a_stack_is_that_layer(name):
    """Whole, and cut."""
    layer = splits.ParticleLayer(**LAYERS[name], bottom_albedo=None)
    z = []
    for number, incidence in enumerate((0.0, 60.0, "diffuse")):
        own = measured(layer, incidence, 10 * number)
        for pieces in (1, 2, 3, 7):
            stack = cut(LAYERS[name], pieces)
            z.append(apart(measured(stack, incidence, 10 * number + pieces), own))
    judge_z(np.concatenate(z), name, independent=3, bound_added=True)


def test_a_cut_layer_has_the_brdf_of_the_whole():
    view = {"polar_deg": [15.0, 45.0, 70.0], "azimuth_deg": [0.0, 90.0, 180.0], "rays": 200_000}
    layer = splits.ParticleLayer(**LAYERS["forward"], bottom_albedo=None)
    whole = splits.goniophotometer(layer, 550.0, 40.0, **view)
    z = []
    for pieces in (2, 3, 7):
        part = splits.goniophotometer(
            cut(LAYERS["forward"], pieces), 550.0, 40.0, seed=pieces, **view
        )
        error = np.hypot(part.brdf_stderr, whole.brdf_stderr)
        z.append(((part.brdf - whole.brdf) / error).values.ravel())
    judge_z(np.concatenate(z), independent=3, bound_added=True)


def test_light_goes_to_and_fro_between_a_lid_on_snow_on_sand_and_the_ground():
    pack = [LID, SNOW, SAND]
    light = {"wavelengths": WAVELENGTHS}
    (r, t, _), (dr, dt, _) = measured(splits.Stack(pack), 40.0, 1, **light)
    (r2, t2, _), (dr2, dt2, _) = measured(splits.Stack(pack[::-1]), "diffuse", 2, **light)
    z = []
    for seed, albedo in enumerate((0.1, 0.5, 0.9, 1.0), start=3):
        found = measured(splits.Stack(pack, ground=albedo), 40.0, seed, **light)
        series = 1.0 / (1.0 - albedo * r2)
        expected = r + t * albedo * t2 * series
        one, other = dr + dt * albedo * t2 * series, dt2 * albedo * t * series
        error = np.hypot(one, other + dr2 * t * t2 * (albedo * series) ** 2)
        z.append((found[0, 0] - expected) / np.hypot(error, found[1, 0]))
    judge_z(np.concatenate(z), independent=4, bound_added=True)


def test_nothing_is_lost_where_nothing_absorbs():
    clear = splits.Snow(
        depth_m=0.003, saturation=0.2, refractive_index={"ice": 1.31, "water": 1.33}
    )
    white = splits.ParticleLayer(
        optical_thickness=4.0, single_scattering_albedo=1.0, refractive_index=1.4,
        bottom_albedo=None, depth_m=0.01,
    )  # fmt: skip
    for ground in (None, 1.0):
        stack = splits.Stack([clear, white, clear], ground=ground)
        found = measured(stack, 70.0, 4)[0]
        assert found[:2].sum() == pytest.approx(1.0, abs=1e-12)
        assert found[2] == pytest.approx(0.0, abs=1e-12)


def test_coin_tosses_and_weights_agree():
    stack = splits.Stack([LID, SNOW], ground=0.3)
    light = {"wavelengths": WAVELENGTHS}
    one, other = (
        measured(stack, 30.0, 5, **light),
        measured(stack, 30.0, 6, estimator="analog", **light),
    )
    judge_z(apart(one, other), independent=1, bound_added=True)


def test_particles_in_a_matrix_like_the_pores_obey_beer():
    """Light may go on into the snow below without a face; grains refused there change nothing."""
    haze = {"optical_thickness": 0.7, "bottom_albedo": None, "depth_m": 0.005}
    thin = splits.Snow(saturation=0.0, depth_m=0.0008)
    z = []
    for incidence in (0.0, 60.0):
        without_face, with_face = (
            measured(
                splits.Stack([splits.ParticleLayer(**haze, refractive_index=n), thin]),
                incidence,
                seed,
            )
            for seed, n in ((21, 1.0), (22, 1.0 + 1e-9))
        )
        z.append(apart(without_face, with_face))
    judge_z(np.concatenate(z), independent=2, bound_added=True)


@pytest.mark.parametrize("thickness", [0.0, 1e-6])
def test_light_gets_out_of_a_clear_plate_on_wet_snow(thickness):
    """Steep light comes in from wet pores; dry ones, and the air, would keep it for ever."""
    plate = splits.ParticleLayer(
        optical_thickness=thickness, refractive_index=1.5, bottom_albedo=None, depth_m=0.01
    )
    clear = {"refractive_index": {"ice": 1.31, "water": 1.33}}
    snow = splits.Snow(depth_m=0.004, saturation=0.3, **clear)
    one = measured(splits.Stack([plate, snow]), 30.0, 40)
    assert one[0, 2] == pytest.approx(0.0, abs=1e-12)
    other = measured(splits.Stack([plate, snow]), 30.0, 41, estimator="analog")
    judge_z(apart(one, other), independent=1, bound_added=True)


def test_a_matrix_has_faces_whatever_the_pores_reading():
    """Dry snow has no face of its own, so that the reading says nothing about it."""
    plate = splits.ParticleLayer(
        optical_thickness=0.1, refractive_index=1.5, bottom_albedo=None, depth_m=0.01
    )
    z = []
    for number, interpretation in enumerate(({}, {"boundary_fresnel": "no"})):
        snow = splits.Snow(depth_m=0.004, saturation=0.0, interpretation=interpretation)
        z.append(measured(splits.Stack([plate, snow], ground=0.1), 30.0, 30 + number))
    judge_z(apart(*z), independent=1, bound_added=True)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, r"layers\[0\].bottom_albedo = 0.5: must be left out"),
        ({"bottom_albedo": None, "polarized": True}, r"layers\[0\].polarized = True"),
        ({"bottom_albedo": None, "opaque": True}, r"layers\[0\].opaque = True"),
        ({"bottom_albedo": None, "optical_thickness": np.inf}, "must be finite"),
    ],
)  # fmt: skip
def test_what_a_layer_of_a_stack_cannot_have_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        splits.Stack([splits.ParticleLayer(**settings)])


def test_only_the_top_of_a_stack_is_rough():
    waves = {"rms_height_m": 1e-3, "wave_number_per_m": 1.0, "waves": 4, "correlation": "gaussian"}
    rough = splits.ParticleLayer(bottom_albedo=None, surface=waves)
    assert splits.Stack([rough, LID]).depth_m == 1.01
    with pytest.raises(ValueError, match=r"layers\[1\].surface = .*: must be left out"):
        splits.Stack([LID, rough])


def test_lanes_know_no_particles():
    with pytest.raises(ValueError, match="not for particle layers"):
        splits.spectrophotometer(splits.Stack([LID, SNOW]), 500.0, kernel="vectorized")
