"""Statements in words on BRDFs and on rough layers."""

import numpy as np
import pytest
import xarray as xr

from splits.core.validation import InvalidValue
from workflow.papers.angles import make_brdf_trend_table
from workflow.papers.layer import make_layer_trend_table


def make_runs():
    """Return BRDFs at two incidences, of which the second has a forward peak."""
    polar, azimuth = np.arange(0.0, 90.0, 2.5), np.array([0.0, 180.0])
    value = 0.3 + 0.1 * np.sin(np.radians(polar))[:, np.newaxis] * np.cos(np.radians(azimuth))
    shape = (1, *value.shape)
    coordinates = {"incidence_deg": [0.0, 40.0], "wavelength": [600.0], "polar_deg": polar,
             "azimuth_deg": azimuth}  # fmt: skip
    values = np.stack([0.3 + 0.0 * value, value]).reshape(2, *shape)
    dataset = xr.Dataset(
        {
            "brdf": (tuple(coordinates), values),
            "brdf_stderr": (tuple(coordinates), 0.0 * values + 1e-3),
        },
        coordinates,
    )
    return dataset


def test_a_study_of_some_inputs_has_their_rows():
    dataset = make_runs()
    table = make_brdf_trend_table(incidence=dataset)
    assert table.quantity.tolist() == [
        "nearly Lambertian at 0°, 600 nm: 0.2 less the relative range within 60°",
        "forward peak above the nadir at 40°, 600 nm",
        "forward side (60°) over the nadir rises with incidence, 0°, 40°: smallest step",
    ]
    assert (table.verdict == "agrees").all()
    assert len(make_brdf_trend_table(grazing=dataset.assign_coords(incidence_deg=[20, 60]))) == 2


def test_the_peak_of_fine_grains_is_compared_with_those_of_coarser_ones():
    dataset = make_runs().rename(incidence_deg="grain_size_um")
    for sizes, verdict in (([100.0, 900.0], "agrees"), ([900.0, 100.0], "outside")):
        table = make_brdf_trend_table(grain_size=dataset.assign_coords(grain_size_um=sizes))
        assert table.verdict.tolist() == [verdict, verdict]


@pytest.mark.parametrize(
    ("key", "changes", "message"),
    [
        ("incidence", {"incidence_deg": [10.0, 40.0]}, "with incidence_deg = 0.0 on its grid"),
        ("grazing", {"wavelength": [700.0]}, "must be an experiment with wavelength 600 nm"),
        (
            "grazing",
            {"polar_deg": np.arange(1.0, 37.0)},
            "must be an experiment with the usual polar",
        ),
        ("facetness", {}, "must be an experiment over facetness"),
        ("facet", {}, r"inputs\.facet: unknown key.*did you mean facetness"),
    ],
)
def test_unsuitable_runs_are_rejected(key, changes, message):
    with pytest.raises(InvalidValue, match=message):
        make_brdf_trend_table(**{key: make_runs().assign_coords(**changes)})


def test_studies_without_runs_are_rejected():
    with pytest.raises(InvalidValue, match=r"inputs = {}: must be with one of incidence, "):
        make_brdf_trend_table()
    with pytest.raises(InvalidValue, match=r"inputs = {}: must be with one of lens, volume"):
        make_layer_trend_table()


def test_statements_on_layers_are_those_of_their_runs():
    brdf = make_runs().rename(incidence_deg="polarized")
    table = make_layer_trend_table(polarization=brdf.assign_coords(polarized=["no", "yes"]))
    assert table.place.tolist() == ["section 1"] and table.verdict.tolist() == ["agrees"]
    with pytest.raises(InvalidValue, match=r"inputs\.volume = '': .* over medium"):
        make_layer_trend_table(volume=brdf)
