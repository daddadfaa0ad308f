"""Kinds of figures: those that fit a dataset, planes, retrievals and their maps."""

import numpy as np
import pytest
import xarray as xr
from test_annotations import read_notes
from test_figure_directions import make_dataset as make_directions
from test_figure_lines import make_dataset as make_spectra

import splits
from splits.core.validation import InvalidValue
from splits.plotting import draw
from splits.plotting.figure import FIGURES, list_figures
from splits.retrieval.retrieve import RetrievalResult

X = np.linspace(500.0, 1500.0, 11)
STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0)
RETRIEVED = {"snow_optical_radius_um": 200.0, "snow_density_kg_m3": 300.0, "medium": "snow"}


def make_retrieval(**attributes):
    """Return the result of a retrieval of two parameters, with the medium of its start."""
    names = ["optical_radius_um", "impurities_ng_g.black_carbon"]
    probabilities, rng = np.array([0.025, 0.16, 0.5, 0.84, 0.975]), np.random.default_rng(1)
    draws = np.array([151.0, 40.0]) + rng.normal(size=(500, 2))
    spectrum = np.linspace(0.9, 0.3, X.size)
    return xr.Dataset(
        {
            "quantiles": (("quantile", "parameter"), [[151.0 + n, 40.0 + n] for n in STEPS]),
            "draws": (("draw", "parameter"), draws),
            "averaging_kernel": (("parameter", "other_parameter"), np.eye(2)),
            "measured": ("wavelength", spectrum),
            "measured_stderr": ("wavelength", np.full(X.size, 0.01)),
            "fitted": ("wavelength", spectrum + 0.01),
            "fitted_stderr": ("wavelength", np.full(X.size, 0.002)),
        },
        {"parameter": names, "other_parameter": names, "quantile": probabilities, "wavelength": X},
        {"chi2": 9.0, "chi2_expected": 9.1, "degrees_of_freedom": 1.9, "quantity": "reflectance",
         "fixed_incidence_deg": 30.0, "solver": "table", **attributes},
    )  # fmt: skip


def make_map(*sizes):
    """Return the result of a retrieval for the pixels of an image."""
    dims = ("y", "x")[-len(sizes) :]
    value, flags = np.linspace(100.0, 300.0, int(np.prod(sizes))).reshape(sizes), np.zeros(sizes)
    flags.flat[0] = 1
    return xr.Dataset(
        {
            "optical_radius_um": (dims, value),
            "optical_radius_um_stderr": (dims, 0.1 * value),
            "chi2": (dims, value / 30.0, {"expected": 9}),
            "quality_flag": (dims, flags.astype(int),
                             {"flag_masks": [1, 2], "flag_meanings": "gap poor_fit"}),
        },
        {dim: np.arange(float(size)) for dim, size in zip(dims, sizes, strict=True)},
    )  # fmt: skip


DATASETS = {
    "spectra": make_spectra({"density_kg_m3": [100.0, 200.0]}),
    "one wavelength": make_spectra({"density_kg_m3": [100.0, 200.0]}, [500.0]),
    "directions": make_directions(),
    "plane": splits.select_principal_plane(make_directions()),
    "retrieval": make_retrieval(),
    "map": make_map(3, 4),
    "indices": xr.Dataset({"n": (("wavelength", "material"), np.ones((11, 1))),
                           "k": (("wavelength", "material"), np.ones((11, 1)))},
                          {"wavelength": X, "material": ["ice"]}),
}  # fmt: skip


@pytest.mark.parametrize("name", DATASETS)
def test_only_kinds_that_fit_the_dataset_are_listed_and_can_be_drawn(name):
    dataset = DATASETS[name]
    kinds = list_figures(dataset)
    for kind in kinds:
        if kind != "swatches":
            assert draw(dataset, kind=kind).axes
    others = [k for k, one in FIGURES.items() if not {*one.needs} <= dataset.variables.keys()]
    for kind in others:
        with pytest.raises(InvalidValue, match=r"^kind = ") as error:
            draw(dataset, kind=kind)
        assert f"must be one of {', '.join(sorted(kinds))}" in str(error.value)


def test_a_dataset_without_figure_is_named_in_one_line():
    with pytest.raises(InvalidValue, match="dataset = 'with a': must be one that a kind of figure"):
        draw(xr.Dataset({"a": 1.0}))


def test_one_wavelength_is_drawn_as_points():
    assert list_figures(DATASETS["one wavelength"])[0] == "points"


def test_principal_planes_are_drawn_as_those_of_all_directions():
    directions = make_directions(azimuth=np.array([0.0, 180.0]))
    figures = [draw(one, "principal_plane") for one in (directions, DATASETS["plane"])]
    lines = [[line.get_xydata() for line in figure.axes[1].lines] for figure in figures]
    np.testing.assert_array_equal(*lines)


@pytest.mark.parametrize(
    ("attributes", "conditions"),
    [
        ({}, "Retrieved: optical radius (µm): 151"),
        (RETRIEVED, "Retrieved: snow, optical radius 151 µm, density 300 kg m⁻³"),
        (RETRIEVED | {"snow_black_carbon_ng_g": 7.0, "snow_grain_size_um": [1.0, 2.0]},
         "Retrieved: snow, optical radius 151 µm, density 300 kg m⁻³, black carbon"),
    ],
)  # fmt: skip
def test_retrievals_state_the_retrieved_medium(attributes, conditions):
    notes = read_notes(draw(make_retrieval(**attributes)))
    assert notes.startswith(conditions)
    assert "incidence" in notes and "200" not in notes and " 7 ng/g" not in notes
    assert "chi2" not in notes and "lines: 16, 50 and 84 %" in notes


def test_results_of_retrievals_are_drawn_without_their_dataset():
    result = RetrievalResult(make_retrieval())
    assert read_notes(draw(result)) == read_notes(draw(result.dataset))


@pytest.mark.parametrize("sizes", [(5,), (3, 4)])
def test_maps_of_retrievals_show_parameters_misfit_and_flags(sizes):
    dataset = make_map(*sizes)
    figure = draw(dataset)
    labels = [text for axes in figure.axes for text in (axes.get_ylabel(), axes.get_xlabel())]
    assert "optical radius (µm)" in labels and "χ²" in labels
    assert f"of {dataset.chi2.size} pixels: gap 1" in read_notes(figure)
    with pytest.raises(InvalidValue, match=r"select = .*to leave one or two"):
        draw(dataset.expand_dims(scene=2, band=3))
