"""One look for all figures, and writing them whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

Colour = tuple[float, float, float] | str

BAND = 2.0
"""Error bands and bars reach this many standard errors to either side."""

LABELS = {
    "grain_size_um": "grain size (µm)",
    "facetness": "mean facetness",
    "sphericity": "mean sphericity",
    "saturation": "water saturation",
    "density_kg_m3": "density (kg m⁻³)",
    "temperature_c": "temperature (°C)",
    "depth_m": "depth (m)",
    "incidence_deg": "incidence (°)",
    "medium": "sample",
    "iron_oxide": "hematite and goethite by mass",
    "hematite_ratio": "hematite / iron oxide",
    "magnetite": "magnetite by mass",
    "texture": "texture",
    "refractive_index": "refractive index",
    "size_tail": "tail by mass",
}


def parameter_label(parameter: str) -> str:
    """Return how a figure names a parameter of the grid."""
    return LABELS.get(parameter, parameter.replace("_", " "))


SUFFIXES = (".png", ".svg")


@contextmanager
def style() -> Iterator[None]:
    """Draw in the project's style."""
    with plt.style.context(Path(__file__).with_name("paper.mplstyle")):
        yield


def value_label(value: object) -> str:
    """Return how a figure names a value of the grid."""
    if isinstance(value, (int, float, np.number)):
        return f"{value:g}"
    return str(value).replace("_", " ")


NOMINAL = ("medium", "refractive_index", "readings", "sample")
"""Parameters whose values have no order."""


def colours(count: int, parameter: str | None = None) -> list[tuple[float, float, float]]:
    """Return colours that can be told apart; a scale of them for few values that have an order."""
    if parameter not in NOMINAL and count <= 6:
        shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 1.0, count + 3)[1:-2])
        return [(r, g, b) for r, g, b, _ in shades.tolist()]
    import seaborn  # takes as long to import as all the rest

    return list(seaborn.color_palette("colorblind" if count <= 10 else "husl", count))


def save_figure(figure: Figure, stem: str | Path) -> list[Path]:
    """Write ``stem.png`` and ``stem.svg`` and close the figure.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    stem : path
        Without suffix.

    Returns
    -------
    list of Path
    """
    stem = Path(stem)
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = []
    for suffix in SUFFIXES:
        path = stem.with_name(stem.name + suffix)
        aside = path.with_name(f".{path.name}")
        metadata = {"Date": None} if suffix == ".svg" else {"Software": None}
        figure.savefig(aside, format=suffix[1:], dpi=200, metadata=metadata)
        os.replace(aside, path)
        paths.append(path)
    plt.close(figure)
    return paths
