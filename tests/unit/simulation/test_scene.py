"""Scenes: signatures of paths by every field, and the Stokes vector of the incident light."""

import math

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.core.declarations import list_inputs
from splits.core.validation import InvalidValue
from splits.experiments.config.instruments import Instrument
from splits.kernels.scene import Scene
from splits.simulation import shared_paths
from splits.simulation.scene import IncidentPolarization, build_scene, check_stokes
from splits.simulation.shared_paths import compute_path_signature

GRAINS_AND_PARTICLES = splits.Stack(
    [
        splits.ParticleLayer(optical_thickness=1.0, ground=None),
        splits.Snow(depth_m=0.1, pores={"oil": 0.1}, refractive_index={"oil": 1.4}),
    ]
)
INFINITE = {"specific_surface_area_m2_kg": 20.0, "depth_m": math.inf}


def alter(value):
    """Yield named tuples with one field altered, or another value."""
    if hasattr(value, "_fields"):
        for name, item in zip(value._fields, value, strict=True):
            for other in alter(item):
                yield value._replace(**{name: other})
    else:
        yield 0.5 if value is None else np.asarray(value) + 1


@pytest.mark.parametrize("field", Scene._fields)
def test_every_field_of_a_scene_enters_the_signature(monkeypatch, field):
    scene = build_scene(GRAINS_AND_PARTICLES, 0.0, False)
    signature = compute_path_signature(GRAINS_AND_PARTICLES)
    for other in alter(getattr(scene, field)):
        altered = scene._replace(**{field: other})
        monkeypatch.setattr(shared_paths, "build_scene", lambda *_, altered=altered: altered)
        assert compute_path_signature(GRAINS_AND_PARTICLES)[0] != signature[0]


def test_the_ground_below_a_finite_layer_is_part_of_its_signature():
    finite = INFINITE | {"depth_m": 1.0}
    over_soil = splits.Snow.natural(**finite, ground=0.3)
    assert compute_path_signature(over_soil) != compute_path_signature(
        splits.Snow.natural(**finite)
    )


def test_lengths_count_in_mean_free_paths():
    coarse, fine = (
        compute_path_signature(splits.Snow.natural(specific_surface_area_m2_kg=area, depth_m=depth))
        for area, depth in ((20.0, 0.1), (40.0, 0.05))
    )
    assert coarse[0] == fine[0]
    assert coarse[1] == pytest.approx(2.0 * fine[1])


@pytest.mark.parametrize("altered", [{"refractive_index": 1.4}, {"polarized": True}])
def test_particles_and_their_matrix_must_be_the_same(altered):
    plain, other = splits.ParticleLayer(), splits.ParticleLayer(**altered)
    assert compute_path_signature(plain) != compute_path_signature(other)


SNOW = splits.Snow()
LAYER = splits.ParticleLayer(ground=None)
POLARIZED = splits.ParticleLayer(polarized=True, phase_function="rayleigh", ground=None)
STOKES = list_inputs(splits.spectrophotometer)["stokes"]


@pytest.mark.parametrize("stokes", [False, np.False_, np.array(False), xr.DataArray(False)])
def test_polarization_is_off_by_default(stokes):
    assert STOKES.check("stokes", stokes) is False
    assert check_stokes(STOKES.check("stokes", stokes), SNOW, 0.0) is None
    assert check_stokes(STOKES.check("stokes", stokes), POLARIZED, 0.0) == IncidentPolarization()


@pytest.mark.parametrize(
    ("stokes", "expected"),
    [
        (True, (0.0, 0.0, 0.0)),
        (np.True_, (0.0, 0.0, 0.0)),
        ((2, 1, 0, -1), (0.5, 0.0, -0.5)),
        (np.array([1.0, 0.6, 0.8, 0.0]), (0.6, 0.8, 0.0)),
        (pd.Series([1, 0, 0, 1]), (0.0, 0.0, 1.0)),
        (np.array([0.5, 0.3, 0.4, 0.0], dtype="f4"), pytest.approx((0.6, 0.8, 0.0))),
    ],
)
def test_stokes_vectors_are_relative_to_the_intensity(stokes, expected):
    for medium in (SNOW, POLARIZED, splits.Stack([POLARIZED, SNOW])):
        assert check_stokes(STOKES.check("stokes", stokes), medium, 30.0) == expected


@pytest.mark.parametrize(
    ("stokes", "medium", "incidence", "message"),
    [
        ("yes", SNOW, 0.0, "stokes = 'yes'"),
        (1, SNOW, 0.0, "stokes"),
        ((1, 0, 0), SNOW, 0.0, "must be true, false, or I, Q, U, V"),
        ((1, 0, 0, np.nan), SNOW, 0.0, "stokes"),
        ((0, 0, 0, 0), SNOW, 0.0, "I > 0"),
        ((1, 1, 0, 0.1), SNOW, 0.0, "at most I"),
        ((1, 1, 0, 0), SNOW, "diffuse", "true for diffuse light"),
        (True, LAYER, 0.0, "polarized = False: must be true with stokes"),
        ((1, 1, 0, 0), splits.Stack([SNOW, LAYER]), 0.0, r"layers\[1\].polarized = False"),
    ],
)
def test_messages(stokes, medium, incidence, message):
    with pytest.raises(InvalidValue, match=message):
        check_stokes(STOKES.check("stokes", stokes), medium, incidence)


def test_the_reference_is_perpendicular_to_the_beam_in_the_plane_of_incidence():
    for angle in (0.0, 40.0, 89.0):
        light = IncidentPolarization(1.0, 0.0, 0.0).make_stokes(angle)
        theta = np.radians(angle)
        direction = np.array([np.sin(theta), 0.0, -np.cos(theta)])
        assert np.dot(light.e, direction) == pytest.approx(0.0, abs=1e-15)
        assert light.e.y == 0.0 and np.linalg.norm(light.e) == pytest.approx(1.0)


@pytest.mark.parametrize("value", ["yes", "true", 1, 0.0, ["1", 0, 0, 0], [True, 0, 0, 0], [1, 0]])
def test_settings_are_as_strict_as_arguments(value):
    settings = {"kind": "goniophotometer", "wavelength_nm": [550], "estimator": "bins"}
    with pytest.raises(ValueError, match="must be true, false, or I, Q, U, V"):
        Instrument.from_content(settings | {"stokes": value})
    for accepted in (True, [1, 0.5, 0, 0]):
        assert Instrument.from_content(settings | {"stokes": accepted}).get("stokes")


def test_false_of_numpy_leaves_the_solver_alone():
    natural = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.3)
    ds = splits.spectrophotometer(
        natural, [1000.0], stokes=np.False_, solver="discrete_ordinates", max_stderr=0.01
    )
    assert ds.attrs["solver"] == "discrete_ordinates" and "incident_stokes" not in ds.attrs
    with pytest.raises(InvalidValue, match="polarization needs paths"):
        splits.spectrophotometer(natural, [1000.0], stokes=True, solver="discrete_ordinates")
    with pytest.raises(InvalidValue, match="must be bins with stokes"):
        splits.goniophotometer(SNOW, [1000.0], stokes=True)
