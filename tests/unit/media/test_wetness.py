"""Distribution of water in sand: wet segments, their filled fraction, and films."""

from __future__ import annotations

import numpy as np
import pytest

from splits import Sand
from splits.media.grain_statistics import surface_to_volume_ratio
from splits.media.sand_composition import (
    MAX_RELATIVE_FILM_THICKNESS,
    MAX_SERIES_SATURATION,
    distribute_water,
    narrow_pore_fraction,
)

W = np.array([700.0, 1450.0])


@pytest.mark.parametrize("saturation", [0.01, 0.1, 0.4, 0.9])
def test_the_shortest_segments_fill_first(saturation):
    """Sorted exponential segments: the shortest ones with a length fraction of the saturation."""
    n_segments = 1_000_000
    segments = np.sort(-np.log((np.arange(n_segments) + 0.5) / n_segments))
    fraction = np.searchsorted(segments.cumsum() / segments.sum(), saturation) / n_segments
    assert narrow_pore_fraction(saturation) == pytest.approx(fraction, abs=2e-5)


def test_narrow_pore_fraction_increases_from_0_to_1():
    assert (narrow_pore_fraction(0.0), narrow_pore_fraction(1.0)) == (0.0, 1.0)
    assert narrow_pore_fraction(MAX_SERIES_SATURATION * 0.999999) == pytest.approx(
        narrow_pore_fraction(MAX_SERIES_SATURATION), rel=1e-5
    )
    assert narrow_pore_fraction(1e-18) == pytest.approx(np.sqrt(2e-18), rel=1e-8)
    fractions = [narrow_pore_fraction(s) for s in np.linspace(0.0, 1.0, 201)]
    assert (np.diff(fractions) > 0.0).all()


@pytest.mark.parametrize("saturation", [0.05, 0.3, 0.8])
def test_all_water_models_contain_the_same_water(saturation):
    porosity, sphericity = 0.4, 0.8
    surface = float(surface_to_volume_ratio(sphericity))
    for water_model in ("whole_pores", "narrow_pores", "film"):
        water = distribute_water(saturation, porosity, sphericity, water_model)
        on_grains = water.relative_film_thickness * surface * (1.0 - porosity) / porosity
        assert water.wet_fraction * water.filled_fraction + on_grains == pytest.approx(
            saturation, rel=1e-9
        )
        assert (
            water.relative_film_thickness <= MAX_RELATIVE_FILM_THICKNESS
            and 0.0 <= water.wet_fraction <= 1.0
        )


def test_films_are_the_outermost_coating():
    sand = Sand(saturation=0.1, partition=(0.0, 0.5, 0.5), interpretation={"water": "film"})
    grains, names = sand.make_grain_population(), sand.list_materials()
    assert names[:3] == ("air", "water", "water film")
    rows = zip(grains.types.material, grains.types.n_shells, strict=True)
    layers = [tuple(names[m] for m in row[:n]) for row, n in rows]
    assert layers == [
        ("water film", "quartz with goethite"),
        ("water film", "kaolinite with goethite", "quartz"),
    ]
    thickness = grains.types.coating_thickness
    assert (thickness[:, 0] == sand._water.relative_film_thickness).all()
    assert thickness[1, 1] == sand.relative_coating_thickness
    water = Sand(saturation=1.0).compute_refractive_indices(W)[:, 1]
    np.testing.assert_array_equal(sand.compute_refractive_indices(W)[:, 2], water)
    assert sand.wet_fraction == 0.0
    assert sand.describe()["film_thickness_per_major_axis"] == sand._water.relative_film_thickness


def test_water_above_the_film_capacity_fills_pores():
    sand = Sand(saturation=0.9, interpretation={"water": "film"})
    assert (
        sand._water.relative_film_thickness == MAX_RELATIVE_FILM_THICKNESS
        and 0.7 < sand.wet_fraction < 0.9
    )
    assert Sand(saturation=1.0, interpretation={"water": "film"}).wet_fraction == 1.0


def test_absorption_is_proportional_to_the_water_content():
    whole, narrow = (
        Sand(saturation=0.1, interpretation={"water": water_model})
        for water_model in ("whole_pores", "narrow_pores")
    )
    ratio = (
        narrow.compute_refractive_indices(W)[:, 1].imag
        / whole.compute_refractive_indices(W)[:, 1].imag
    )
    np.testing.assert_allclose(ratio * narrow.wet_fraction, whole.wet_fraction, rtol=1e-12)
    np.testing.assert_array_equal(
        narrow.compute_refractive_indices(W).real, whole.compute_refractive_indices(W).real
    )


def test_dry_and_saturated_sands_are_independent_of_the_model():
    for saturation in (0.0, 1.0):
        sands = [
            Sand(saturation=saturation, interpretation={"water": water_model})
            for water_model in ("whole_pores", "narrow_pores")
        ]
        np.testing.assert_array_equal(
            sands[0].compute_refractive_indices(W), sands[1].compute_refractive_indices(W)
        )
        assert sands[0].wet_fraction == sands[1].wet_fraction == saturation


@pytest.mark.parametrize("water_model", ["narrow_pores", "film"])
def test_other_liquids_in_partially_wet_pores_are_rejected(water_model):
    settings = {"pores": {"oil": 0.1}, "refractive_index": {"oil": 1.47}}
    with pytest.raises(
        ValueError, match=rf"pores = .*empty with interpretation\.water {water_model}"
    ):
        Sand(saturation=0.1, interpretation={"water": water_model}, **settings)
