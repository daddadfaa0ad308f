"""Representation of media, skies and grounds as the calls that construct them."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

import splits
from splits.illumination.bands import SpectralBand
from splits.media.ground import Ground
from splits.media.parameters import replace_parameter
from splits.media.rough_surface import RandomHeightField

WAVES = {"rms_height_m": 0.01, "wave_number_per_m": 50, "correlation": "gaussian"}
LIMITED_NORMAL = {"rms_height_m": 0.02, "wave_number_per_m": 50, "band_limit_per_m": 1000}
CALLS = [
    "Snow()",
    "Snow(specific_surface_area_m2_kg=18.3389)",
    "Snow(optical_radius_um=100, temperature_c=-10, depth_m=inf)",
    "Snow(liquid_water_content=0.1)",
    "Snow(saturation=0.1, ground='camborthid')",
    "Snow(grain_size_um=(100, 250))",
    "Snow(grain_size_um=(1000, 2500), interpretation='geometric')",
    "Snow(interpretation={'facet_sampling': 'projected'}, ground='black')",
    "Snow(refractive_index={'ice': 'warren_brandt_2008_picard_2016'}, ground=0.2)",
    "Snow(specific_surface_area_m2_kg=0.3, facetness=(0, 0, 0, 0))",
    "Snow.natural(specific_surface_area_m2_kg=40, depth_m=1, impurities_ng_g={'dust_sahara': 5})",
    "Snow.natural(optical_radius_um=163.6, saturation=0.1)",
    "Snow.natural(grain_size_um=(100, 200), refractive_index={'ice': '1.31+0j'})",
    "Sand()",
    "Sand(iron_oxide=0.02, partition=(0, 1, 0), interpretation={'water': 'film'})",
    "Sand(interpretation='geometric')",
    "ParticleLayer()",
    "ParticleLayer(optical_thickness=inf, bottom_albedo=None, polarized=True)",
    f"ParticleLayer(surface={WAVES})",
    f"RoughSurface([{WAVES}, {LIMITED_NORMAL}])",
    "Interpretation.from_input('splitsnow_2021')",
    "Interpretation.from_input({'facet_sampling': 'projected'})",
    "SandInterpretation.from_input('splits_2007')",
    "Ground.from_input('quartzipsamment')",
    "Ground.from_input(0.25)",
    "Ground.from_input('black')",
    "Stack([\n"
    "    Snow.natural(specific_surface_area_m2_kg=40, depth_m=0.1),\n"
    "    Snow.natural(optical_radius_um=200, density_kg_m3=350, depth_m=0.3),\n"
    "], ground='camborthid')",
    "Stack([\n    Snow(depth_m=0.01, interpretation='geometric'),\n"
    "    ParticleLayer(bottom_albedo=None),\n], interpretation='geometric')",
]
NAMES = {name: getattr(splits, name) for name in splits.__all__} | {
    "Ground": Ground,
    "inf": math.inf,
}


@pytest.mark.parametrize("call", CALLS)
def test_repr_is_the_constructing_call(call):
    obj = eval(call, NAMES)
    text = repr(obj)
    assert eval(text, NAMES).__class__ is obj.__class__
    assert sorted(text) == sorted(call)
    assert repr(eval(text, NAMES)) == text == repr(copy.deepcopy(obj))
    assert repr(pickle.loads(pickle.dumps(obj))) == text


def test_repr_keeps_the_surface_area_of_modified_snow():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=40, depth_m=0.1)
    assert repr(replace(snow, depth_m=1)) == (
        "Snow.natural(specific_surface_area_m2_kg=40, depth_m=1)"
    )
    assert "specific_surface_area_m2_kg=12," in repr(
        replace_parameter(snow, "specific_surface_area_m2_kg", 12)
    )
    text = repr(
        splits.Stack([splits.Snow(specific_surface_area_m2_kg=9)], interpretation="geometric")
    )
    assert "    Snow(specific_surface_area_m2_kg=9, interpretation='geometric'),\n" in text


def test_repr_of_tables_is_short():
    w = np.arange(300.0, 1001.0)
    table = {"wavelength_nm": w, "albedo": np.full(w.size, 0.2)}
    spectrum = {"wave_number_per_m": w.tolist(), "density": w.tolist()}
    for obj in (
        splits.Snow(ground=table),
        Ground.from_input(table),
        splits.Snow(refractive_index={"ice": {"wavelength_nm": w, "n": w / w, "k": 0.0 * w}}),
        splits.ParticleLayer(
            phase_function={"cosine": np.linspace(-1, 1, 900), "density": np.ones(900)}
        ),
        RandomHeightField(0.1, correlation="spectrum", spectrum=spectrum),
        splits.sky({"wavelength_nm": w, "direct": w, "diffuse": w}, zenith_deg=50),
        splits.sky("midlatitude_winter"),
        SpectralBand(w, w),
    ):
        assert "\n" not in repr(obj) and len(repr(obj)) < 200
    assert repr(splits.Snow(ground=table)) == (
        "Snow(ground={'wavelength_nm': [300, ..., 1000], 'albedo': [0.2, ..., 0.2]})"
    )


def test_repr_of_skies_names_their_source():
    assert repr(splits.sky("midlatitude_winter", 50)) == (
        "Sky('midlatitude_winter', zenith_deg=50, 305 to 3995 nm: "
        "SNICAR-ADv3 (Flanner et al. 2021))"
    )
    pytest.importorskip("pvlib")
    clear = repr(splits.sky("clear", 30, turbidity_500nm=0.2))
    assert clear.startswith("Sky('clear', zenith_deg=30, 300 to 4000 nm: Bird & Riordan")
    assert "turbidity_500nm 0.2" in clear and "\n" not in clear
