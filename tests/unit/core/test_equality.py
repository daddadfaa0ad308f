"""Equality and hash of inputs by value, also for copies."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

import splits
from splits.illumination.bands import SpectralBand
from splits.materials import make_refractive_index
from splits.media.ground import Ground

END_WAVELENGTHS = [200.0, 3000.0]
SOOT = {
    "ng_g": 5.0,
    "wavelength_nm": np.array(END_WAVELENGTHS),
    "absorption_m2_kg": np.array([2.0, 1.0]),
}
WAVES = {"wave_number_per_m": [0.0, 1.0, 2.0], "density": [1.0, 2.0, 0.0]}
ROUGH = {"rms_height_m": 0.01, "correlation": "spectrum", "spectrum": WAVES}
PHASE_FUNCTION = {"cosine": np.array([-1.0, 0.5, 1.0]), "density": np.array([1.0, 1.0, 2.0])}
USER_INDEX = {"wavelength_nm": END_WAVELENGTHS, "n": [1.3, 1.3], "k": [0.0, 1e-5]}


def make_stack(**changes):
    return splits.Stack([splits.Snow(depth_m=0.1), splits.Snow(),
                         splits.ParticleLayer(bottom_albedo=None)],
                        **changes)  # fmt: skip


OBJECT_FACTORIES = {
    "snow": splits.Snow,
    "snow, own ice": lambda: splits.Snow(refractive_index={"ice": USER_INDEX}, ground="black"),
    "snow, own impurity": lambda: splits.Snow(impurities_ng_g={"mine": SOOT}),
    "snow, soot": lambda: splits.Snow(impurities_ng_g={"black_carbon": 3}),
    "snow, natural": lambda: splits.Snow.natural(optical_radius_um=100, depth_m=1),
    "sand": splits.Sand,
    "sand, oil": lambda: splits.Sand(pores={"oil": 0.1}, refractive_index={"oil": 1.5}),
    "layer": splits.ParticleLayer,
    "layer, own phase function": lambda: splits.ParticleLayer(phase_function=PHASE_FUNCTION),
    "layer, rough": lambda: splits.ParticleLayer(surface=ROUGH),
    "stack": lambda: make_stack(ground=0.3),
    "stack, other interpretation": lambda: make_stack(interpretation="geometric"),
    "surface": lambda: splits.RoughSurface([ROUGH, {**ROUGH, "waves": 3}]),
    "ground": lambda: Ground.from_input(0.3),
    "ground, table": lambda: Ground.from_input(
        {"wavelength_nm": END_WAVELENGTHS, "albedo": [0.1, 0.2]}
    ),
    "interpretation": splits.Interpretation,
    "interpretation of sand": lambda: splits.SandInterpretation(mixing="linear"),
    "composition": lambda: splits.Sand().composition,
    "sizes": lambda: splits.Sand().size_distribution,
    "index": lambda: make_refractive_index("ice"),
    "index, scaled": lambda: make_refractive_index("ice", {"k_factor": 2.0}),
    "index, oscillators": lambda: make_refractive_index("goethite"),
    "index, constant": lambda: make_refractive_index("ice", 1.3 + 1e-7j),
    "index, own": lambda: make_refractive_index("ice", USER_INDEX),
    "sky": splits.sky,
    "sky, own": lambda: splits.sky(
        {"wavelength_nm": END_WAVELENGTHS, "direct": [1, 2], "diffuse": [0, 1]}, 50.0
    ),
    "band": lambda: SpectralBand.from_limits(400.0, 700.0),
}
COPY_FUNCTIONS = {
    "constructed again": lambda one, make: make(),
    "copied": lambda one, make: copy.copy(one),
    "copied deeply": lambda one, make: copy.deepcopy(one),
    "pickled": lambda one, make: pickle.loads(pickle.dumps(one)),
    "replaced": lambda one, make: replace(one),
}


@pytest.mark.parametrize("copy_method", COPY_FUNCTIONS)
@pytest.mark.parametrize("name", OBJECT_FACTORIES)
def test_equal_objects_have_equal_hashes(name, copy_method):
    original = OBJECT_FACTORIES[name]()
    copied = COPY_FUNCTIONS[copy_method](original, OBJECT_FACTORIES[name])
    assert original == copied
    assert hash(original) == hash(copied)
    assert copied in [None, original] and [None, original].index(copied) == 1
    assert {original: "found"}[copied] == "found"


def test_different_objects_are_not_equal():
    objects = [make() for make in OBJECT_FACTORIES.values()]
    assert all(one != other for i, one in enumerate(objects) for other in objects[:i])
    assert len(set(objects)) == len(objects)
    assert splits.Snow() != "snow" and splits.sky() != "midlatitude_winter"


def test_equality_is_independent_of_types_and_order():
    lists = {key: list(value) if key != "ng_g" else value for key, value in SOOT.items()}
    equivalent = {"mine": SOOT, "ash_st_helens": 4}, {"ash_st_helens": 4.0, "mine": lists}
    first, second = (splits.Snow(impurities_ng_g=amounts) for amounts in equivalent)
    assert first == second and hash(first) == hash(second)


def test_tables_are_compared_by_content(tmp_path):
    path = tmp_path / "mine.csv"

    def make_snow(absorption):
        path.write_text(f"wavelength_nm,absorption_m2_kg\n200,{absorption}\n3000,1\n")
        return splits.Snow(impurities_ng_g={"mine": {"ng_g": 5, "table": str(path)}})

    assert make_snow(2) == make_snow(2) != make_snow(3)
