"""Common style of figures, labels of parameters and values, and atomic writing of figures."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager

from splits.core.atomic import atomic_write
from splits.core.escaping import escape_mathtext
from splits.core.parameter_names import parse_impurity_parameter
from splits.core.paths import expand_path

Colour = tuple[float, float, float] | str
Dash = str | tuple[int, tuple[int, ...]]

BAND_SIGMA = 2.0
"""Half-width of error bands and bars in standard errors."""
ONE_COLUMN_INCHES = 3.5
TWO_COLUMNS_INCHES = 7.2
"""Widths of figures (inches): a column of a printed page (89 mm), or the page (183 mm)."""
SMALL_FONT_PT = 6.5
"""Size (points) of the smallest text; others are in `paper.mplstyle`."""
DPI = 300

PARAMETER_LABELS = {
    "wavelength": "wavelength (nm)",
    "grain_size_um": "grain size (µm)",
    "facetness": "mean facetness",
    "sphericity": "mean sphericity",
    "saturation": "water saturation",
    "liquid_water_content": "liquid water content",
    "optical_radius_um": "optical radius (µm)",
    "specific_surface_area_m2_kg": "specific surface area (m²/kg)",
    "impurities_ng_g": "impurities (ng/g)",
    "algae_cells_ml": "algae (cells/ml)",
    "impurities_in": "impurities in",
    "density_kg_m3": "density (kg m⁻³)",
    "temperature_c": "temperature (°C)",
    "depth_m": "depth (m)",
    "incidence_deg": "incidence (°)",
    "medium": "sample",
    "iron_oxide": "hematite and goethite by mass",
    "hematite_ratio": "hematite / iron oxide",
    "magnetite": "magnetite by mass",
    "partition": "pure / mixed / coated",
    "roundness": "roundness (mean, sd)",
    "size_tail": "tail by mass",
    "interpretation": "interpretation",
}
"""Labels of parameters in figures."""

VALUE_LABELS = {
    "bottom_albedo": {"None": "no bottom"},
    "surface": {"None": "smooth"},
    "ground": {"None": "open"},
    "model": {"kokhanovsky_zege_2004": "Kokhanovsky & Zege", "splits": "this model"},
    "polarized": {"0": "no", "1": "yes"},
    "opaque": {"0": "no", "1": "yes"},
    "phase_function": {"henyey_greenstein": "Henyey–Greenstein", "rayleigh": "Rayleigh"},
}
"""Labels of values of parameters in figures."""
COMMON_VALUE_LABELS = {"None": "none", "True": "yes", "False": "no", "inf": "∞"}
VALUE_SEPARATORS = {"texture": " / ", "partition": " / ", "roundness": ", "}
"""Separators of the numbers of a value that is no range."""
NOMINAL_PARAMETERS = (
    "medium",
    "refractive_index",
    "pores",
    "impurities_ng_g",
    "algae_cells_ml",
    "impurities_in",
    "interpretation",
    "sample",
    "phase_function",
    "polarized",
    "ground",
    "layers",
)
"""Parameters with unordered values."""
FRACTIONS = ("reflectance", "transmittance", "absorptance", "albedo", "band_albedo")
"""Quantities from 0 to 1."""
NEARLY_ONE = 0.85
"""Value of a fraction above which its axis shows the limit 1."""
_HEADROOM = 1.05
"""Upper end of an axis from zero, relative to the largest value."""
_NUMBER_PATTERN = r"\d+(?:\.\d+)?(?:e[+-]?\d+)?"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_parameter(parameter: str) -> str:
    """Return the label of a parameter, or of a parameter of a layer by its path."""
    stack, _, rest = parameter.partition(".")
    number, _, key = rest.partition(".")
    if stack == "layers" and key:
        return f"layer {number}: {format_parameter(key)}"
    impurity = parse_impurity_parameter(parameter)
    if impurity:
        unit = "ng/g" if impurity[0] == "impurities_ng_g" else "cells/ml"
        return escape_mathtext(f"{impurity[1].replace('_', ' ')} ({unit})")
    return PARAMETER_LABELS.get(parameter, escape_mathtext(parameter.replace("_", " ")))


def format_value(value: object, parameter: str | None = None) -> str:
    """Return the label of a value of the grid.

    Parameters
    ----------
    value : number or str
        Ranges and other tuples are labels of a grid, such as "300-750".
    parameter : str, optional
        Name of the parameter.

    Returns
    -------
    str
        A word or a number in print, such as 10⁻⁵ instead of 1e-05.
    """
    is_number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    text = f"{value:g}" if is_number else str(value)
    parameter = (parameter or "").rpartition(".")[2]
    word = VALUE_LABELS.get(parameter, {}).get(text) or COMMON_VALUE_LABELS.get(text)
    if word:
        return word
    if re.fullmatch(f"-?{_NUMBER_PATTERN}(-{_NUMBER_PATTERN})*", text):
        separator = VALUE_SEPARATORS.get(parameter, "–")
        sign = "−" if text.startswith("-") else ""
        return sign + separator.join(map(_format_number, re.findall(_NUMBER_PATTERN, text)))
    if match := re.fullmatch(f"({_NUMBER_PATTERN})([+-])({_NUMBER_PATTERN})j", text):
        real, sign, imaginary = match.groups()
        return f"{_format_number(real)} {sign.replace('-', '−')} {_format_number(imaginary)}i"
    return escape_mathtext(text.replace("_", " "))


_MAX_TITLE_CHARS = 24
"""Number of characters that fit above a small panel."""


def make_panel_title(labels: Mapping[str, float | str], legend: str | None = None) -> str:
    """Return the title of a small panel: a line per parameter, two for long ones.

    Parameters
    ----------
    labels : mapping
        Labels of the grid.
    legend : str, optional
        Name of a single varying parameter; that of the parameter by default.
    """
    lines = []
    for parameter, label in labels.items():
        name = legend if legend and len(labels) == 1 else format_parameter(parameter)
        value = format_value(label, parameter)
        lines.append(f"{name}:{chr(10) if len(name + value) > _MAX_TITLE_CHARS else ' '}{value}")
    return "\n".join(lines)


def _format_number(number: str) -> str:
    """Return a number with its power of ten in print."""
    if 0.0 < float(number) < 1e-3 and "e" not in number:
        number = f"{float(number):e}"
    mantissa, _, power = number.partition("e")
    if not power:
        return number
    tens = "10" + str(int(power)).translate(_SUPERSCRIPTS)
    return tens if float(mantissa) == 1.0 else f"{float(mantissa):g} × {tens}"


FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
FIGURE_METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None},
}  # fmt: skip
"""Metadata of figure files, without dates and program versions, for reproducible files."""
FALLBACK_FONTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "Source Han Sans SC", "WenQuanYi Micro Hei",
    "Microsoft YaHei", "Yu Gothic", "Malgun Gothic", "PingFang SC", "Hiragino Sans",
    "Arial Unicode MS", "Noto Sans Devanagari", "Noto Sans Thai",
)  # fmt: skip
"""Fonts for characters that DejaVu lacks."""


@contextmanager
def use_style() -> Iterator[None]:
    """Use the style of the project, with installed fonts for other scripts."""
    installed = {font.name for font in fontManager.ttflist}
    fonts = ["sans-serif", *(name for name in FALLBACK_FONTS if name in installed)]
    with matplotlib.style.context(
        [Path(__file__).with_name("paper.mplstyle"), {"font.family": fonts}]
    ):
        yield


class OffscreenFigure(Figure):
    """Figure without pyplot, which needs no display and selects no backend for the process.

    A notebook displays it as the value of a cell.

    Parameters
    ----------
    width : float
        `ONE_COLUMN_INCHES` or `TWO_COLUMNS_INCHES`.
    height : float
        Inches.
    """

    def __init__(self, width: float, height: float) -> None:
        super().__init__(figsize=(width, height), layout="constrained")
        # The canvas measures text before the figure is written.
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        with use_style():
            self.savefig(buffer, format="png", dpi=DPI // 2)
        return buffer.getvalue()


def make_subplots(
    rows: int = 1,
    columns: int = 1,
    *,
    height: float,
    width: float = ONE_COLUMN_INCHES,
    **settings: Any,
) -> tuple[Figure, Any]:
    """Return an `OffscreenFigure` and its axes, as `matplotlib.pyplot.subplots` does.

    Parameters
    ----------
    rows, columns : int
    height : float
        Height (inches), to which notes and legends may add.
    width : float
        `ONE_COLUMN_INCHES` or `TWO_COLUMNS_INCHES`.
    """
    figure = OffscreenFigure(width, height)
    return figure, figure.subplots(rows, columns, **settings)


def compute_axis_top(highest: float, quantity: str = "") -> float:
    """Return the upper end of an axis from zero, above 1 for fractions near 1."""
    if quantity in FRACTIONS and highest > NEARLY_ONE:
        highest = max(highest, 1.0)
    return _HEADROOM * highest if highest > 0.0 else 1.0


def start_at_zero(axes: Axes, quantity: str = "", ylim: tuple[float, float] | None = None) -> None:
    """Set the vertical axis from zero to above all lines and bands, or to given limits.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        With everything drawn.
    quantity : str
        Name of the quantity; see `FRACTIONS`.
    ylim : (low, high), optional
    """
    # Axes without data have infinite limits of data.
    highest = float(axes.dataLim.ymax) if np.isfinite(axes.dataLim.ymax) else 0.0
    axes.set_ylim(ylim or (0.0, compute_axis_top(highest, quantity)))


def pick_colours(count: int, parameter: str | None = None) -> list[Colour]:
    """Return distinct colours: a scale for ordered values, a palette for nominal ones."""
    if parameter not in NOMINAL_PARAMETERS:
        positions = np.linspace(0.05, 0.74, count) if count > 1 else np.array([0.3])
        colours = matplotlib.colormaps["viridis"](positions)
        return [(r, g, b) for r, g, b, _ in colours.tolist()]
    import seaborn  # imported here, as its import is slow

    return list(seaborn.color_palette("colorblind", count))


def save_figure(figure: Figure, stem: str | Path) -> list[Path]:
    """Write ``stem.png``, ``stem.svg`` and ``stem.pdf``, with reproducible bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    stem : path
        Path without suffix.

    Returns
    -------
    list of Path
    """
    stem = expand_path(stem, "stem")
    paths = []
    layout = figure.get_layout_engine()
    try:
        for suffix in FIGURE_SUFFIXES:
            path = stem.with_name(stem.name + suffix)
            with use_style(), atomic_write(path) as temporary_path:
                figure.savefig(
                    temporary_path, format=suffix[1:], dpi=DPI, metadata=FIGURE_METADATA[suffix]
                )
            paths.append(path)
            # The layout is fixed now; computing it again takes as long as drawing.
            figure.set_layout_engine("none")
    finally:
        figure.set_layout_engine(layout)
    return paths
