"""Figures of refractive indices: of a medium, and of the layers of a stack."""

from __future__ import annotations

import numpy as np
import xarray as xr

from splits.plotting import draw_refractive_indices


def make_dataset(materials):
    """Return refractive indices with a given n for each material."""
    n = np.array([[index, index] for index in materials.values()]).T
    axes = {"wavelength": [500.0, 900.0], "material": list(materials)}
    dims = ("wavelength", "material")
    return xr.Dataset({"n": (dims, n), "k": (dims, np.full(n.shape, 1e-6))}, axes)


def list_legend_labels(materials):
    """Return the labels of the legend."""
    figure = draw_refractive_indices(make_dataset(materials))
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_materials_common_to_layers_are_shown_once():
    stack = {
        "layers.0.air": 1.0,
        "layers.0.ice": 1.31,
        "layers.1.ice": 1.31,
        "layers.1.water": 1.33,
    }
    assert list_legend_labels(stack) == ["ice", "water"]


def test_materials_that_differ_between_layers_have_labels():
    assert list_legend_labels({"layers.0.ice": 1.3, "layers.1.ice": 1.4}) == [
        "layer 0: ice", "layer 1: ice",
    ]  # fmt: skip


def test_figures_without_materials_have_no_legend():
    assert list_legend_labels({"layers.0.air": 1.0, "layers.0.matrix": 1.5}) == []
