"""Grammar of figures: panels of lines with bands of errors, their labels, notes and files.

Matplotlib is optional and its import slow, so that functions import it: experiments read the
settings of figures from the signatures of the functions that draw.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial, wraps
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

import numpy as np
import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.declarations import AXIS_UNITS
from splits.core.escaping import escape_mathtext
from splits.core.inputs import UNPOLARIZED_LIGHT, get_incident_stokes
from splits.core.keywords import ERROR_NAMES, declare_function
from splits.core.validation import expand_path
from splits.media.formatting import count_digits
from splits.media.parameters import find_whole, get_quantity, parse_impurity_parameter

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
    from matplotlib.text import Text
else:
    # Signatures are read without matplotlib.
    Axes = Figure = Any

Given = ParamSpec("Given")
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

VALUE_LABELS = {
    "surface": {"None": "smooth"},
    "ground": {"None": "open"},
    "model": {"kokhanovsky_zege_2004": "Kokhanovsky & Zege", "splits": "this model"},
    "polarized": {"0": "no", "1": "yes"},
    "opaque": {"0": "no", "1": "yes"},
    "phase_function": {"henyey_greenstein": "Henyey–Greenstein", "rayleigh": "Rayleigh"},
}
"""Labels of values of parameters in figures."""
COMMON_VALUE_LABELS = {"None": "none", "True": "yes", "False": "no", "inf": "∞"}
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
_NUMBER_PATTERN = r"\d+(?:\.\d+)?(?:e[+-]?\d+)?"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_parameter(parameter: str) -> str:
    """Return the label of a parameter, or of a parameter of a layer by its path."""
    stack, _, rest = parameter.partition(".")
    number, _, key = rest.partition(".")
    if stack == "layers" and key:
        return f"layer {number}: {format_parameter(key)}"
    if parameter == "wavelength":
        return "wavelength (nm)"
    if find_whole(parameter):
        return parameter.rpartition(".")[2]
    key, kind = parse_impurity_parameter(parameter) or (parameter, "")
    quantity = get_quantity(key)
    label = escape_mathtext(kind.replace("_", " ")) or quantity.label
    if not label:
        return escape_mathtext(parameter.replace("_", " "))
    unit = AXIS_UNITS.get(quantity.unit, quantity.unit)
    return f"{label} ({unit})" if unit else label


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
        quantity = get_quantity(parameter)
        # Fractions, or a mean and a standard deviation, are no range.
        separator = " / " if quantity.parts else ", " if quantity.mean == 0 else "–"
        sign = "−" if text.startswith("-") else ""
        return sign + separator.join(map(_format_number, re.findall(_NUMBER_PATTERN, text)))
    if match := re.fullmatch(f"({_NUMBER_PATTERN})([+-])({_NUMBER_PATTERN})j", text):
        real, sign, imaginary = match.groups()
        return f"{_format_number(real)} {sign.replace('-', '−')} {_format_number(imaginary)}i"
    return escape_mathtext(text.replace("_", " "))


def format_point(labels: Mapping[str, Any]) -> str:
    """Return the values of a point of a grid."""
    return " · ".join(format_value(value, name) for name, value in labels.items())


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
        # 24 characters fit above a small panel.
        lines.append(f"{name}:{chr(10) if len(name + value) > 24 else ' '}{value}")
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


FIGURE_METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None},
}  # fmt: skip
"""Metadata of figure files by suffix, without dates and program versions, which would differ."""
FIGURE_SUFFIXES = tuple(FIGURE_METADATA)
FALLBACK_FONTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "Source Han Sans SC", "WenQuanYi Micro Hei",
    "Microsoft YaHei", "Yu Gothic", "Malgun Gothic", "PingFang SC", "Hiragino Sans",
    "Arial Unicode MS", "Noto Sans Devanagari", "Noto Sans Thai",
)  # fmt: skip
"""Fonts for characters that DejaVu lacks."""


@contextmanager
def use_style() -> Iterator[None]:
    """Use the style of the project, with installed fonts for other scripts."""
    import matplotlib.style
    from matplotlib.font_manager import fontManager

    installed = {font.name for font in fontManager.ttflist}
    fonts = ["sans-serif", *(name for name in FALLBACK_FONTS if name in installed)]
    with matplotlib.style.context(
        [Path(__file__).with_name("paper.mplstyle"), {"font.family": fonts}]
    ):
        yield


def declare_figure(function: Callable[Given, Figure]) -> Callable[Given, Figure]:
    """Decorate a function that draws: check its declared settings, and use the style."""

    @wraps(function)
    def styled(*values: Given.args, **keywords: Given.kwargs) -> Figure:
        with use_style():
            return function(*values, **keywords)

    return declare_function(styled)


def make_figure(width: float, height: float) -> Figure:
    """Return a figure without pyplot, which needs no display and selects no backend.

    A notebook displays it as the value of a cell.

    Parameters
    ----------
    width : float
        `ONE_COLUMN_INCHES` or `TWO_COLUMNS_INCHES`.
    height : float
        Height (inches), to which notes and legends may add.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    # The canvas measures text before the figure is written.
    FigureCanvasAgg(figure)
    figure._repr_png_ = partial(_render_png, figure)  # type: ignore[attr-defined]
    return figure


def _render_png(figure: Figure) -> bytes:
    buffer = BytesIO()
    with use_style():
        figure.savefig(buffer, format="png", dpi=DPI // 2)
    return buffer.getvalue()


def make_subplots(
    rows: int = 1,
    columns: int = 1,
    *,
    height: float,
    width: float = ONE_COLUMN_INCHES,
    **settings: Any,
) -> tuple[Figure, Any]:
    """Return a figure and its axes, as `matplotlib.pyplot.subplots` does, see `make_figure`.

    Parameters
    ----------
    rows, columns : int
    height : float
        Height (inches), to which notes and legends may add.
    width : float
        `ONE_COLUMN_INCHES` or `TWO_COLUMNS_INCHES`.
    """
    figure = make_figure(width, height)
    return figure, figure.subplots(rows, columns, **settings)


def hide_empty_panels(panels: np.ndarray, xlabel: str) -> None:
    """Hide the panels of a grid without data, and label the axis of the lowest one of each column.

    Parameters
    ----------
    panels : array of matplotlib.axes.Axes, shape (rows, columns)
    xlabel : str
    """
    for axes in panels.flat:
        axes.set_visible(axes.has_data())
    for column in panels.T:
        lowest = [axes for axes in column if axes.get_visible()][-1]
        lowest.tick_params(labelbottom=True)
        lowest.set_xlabel(xlabel)


def select_evenly(size: int, max_count: int) -> np.ndarray:
    """Return evenly spaced indices of an axis, including both ends."""
    return np.unique(np.linspace(0, size - 1, min(size, max_count)).round().astype(int))


def make_axis_label(variable: xr.DataArray) -> str:
    """Return the label of an axis, on two lines if it is long."""
    label = escape_mathtext(str(variable.attrs.get("long_name", variable.name)))
    first, _, last = label.rpartition(" ")
    # 30 characters fit along an axis.
    return f"{first}\n{last}" if first and len(label) > 30 else label


def compute_axis_top(highest: float, quantity: str = "") -> float:
    """Return the upper end of an axis from zero, above 1 for fractions near 1."""
    if quantity in FRACTIONS and highest > 0.85:
        highest = max(highest, 1.0)
    return 1.05 * highest if highest > 0.0 else 1.0


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


def draw_band(
    axes: Axes, x: np.ndarray, y: np.ndarray, stderr: np.ndarray, floor: Any = -np.inf, **style: Any
) -> None:
    """Draw a band of `BAND_SIGMA` standard errors around values, cut off at a lower limit."""
    error = BAND_SIGMA * stderr
    axes.fill_between(x, np.maximum(y - error, floor), y + error, lw=0, **style)


def draw_curve(
    axes: Axes, x: np.ndarray, y: np.ndarray, stderr: np.ndarray, floor: Any = -np.inf, *,
    alpha: float = 0.3, **style: Any,
) -> None:  # fmt: skip
    """Draw a line, and its band of errors in the same colour, see `draw_band`.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    x, y, stderr : float, shape (points,)
    floor : float
        Lower limit of the band.
    alpha : float
        Opacity of the band.
    **style
        Keywords of `matplotlib.axes.Axes.plot`, among them the colour.
    """
    axes.plot(x, y, **style)
    draw_band(axes, x, y, stderr, floor, color=style["color"], alpha=alpha)


def pick_colours(count: int, parameter: str | None = None) -> list[Colour]:
    """Return distinct colours: a scale for ordered values, a palette for nominal ones."""
    if parameter not in NOMINAL_PARAMETERS:
        import matplotlib

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
        for suffix, metadata in FIGURE_METADATA.items():
            path = stem.with_name(stem.name + suffix)
            with use_style(), atomic_write(path) as temporary_path:
                figure.savefig(temporary_path, format=suffix[1:], dpi=DPI, metadata=metadata)
            paths.append(path)
            # The layout is fixed now; computing it again takes as long as drawing.
            figure.set_layout_engine("none")
    finally:
        figure.set_layout_engine(layout)
    return paths


_COMMON_CONDITIONS = {"depth_m": "depth", "ground": "ground:"}
CONDITIONS: dict[str, dict[str, str]] = {
    "snow": {
        "specific_surface_area_m2_kg": "specific surface area",
        "optical_radius_um": "optical radius",
        "grain_size_um": "grains",
        "density_kg_m3": "density",
        "saturation": "water saturation",
        "liquid_water_content": "liquid water content",
        **_COMMON_CONDITIONS,
    },
    "sand": {"porosity": "porosity", "saturation": "water saturation", **_COMMON_CONDITIONS},
    "particle_layer": {
        "refractive_index": "index",
        "optical_thickness": "optical thickness",
        "single_scattering_albedo": "single-scattering albedo",
        "ground": "ground:",
        "surface_rms_slope": "rms slope",
    },
    "stack": _COMMON_CONDITIONS,
}
"""Labels of the keywords that figures show, by kind of medium."""


def _format_condition(key: str, label: str, value: Any) -> str:
    """Return the value of a keyword with its label and its unit."""
    words = {
        "saturation": {"0": "dry", "0.0": "dry"}, "ground": {"open": "", "none": ""},
        "surface_rms_slope": {"inf": "slopes without finite rms"},
    }  # fmt: skip
    values, unit = np.atleast_1d(value), get_quantity(key).unit
    is_number = values.dtype.kind in "if"
    texts = [format_value(float(f"{x:.4g}") if is_number else str(x)) for x in values]
    unit = "" if texts == ["∞"] else AXIS_UNITS.get(unit, unit)
    return words.get(key, {}).get(str(value), f"{label} {'–'.join(texts)} {unit}".strip())


def describe_conditions(
    dataset: xr.Dataset, select: Mapping[str, float | str] | None = None, band: str = "bands"
) -> str:
    """Return the fixed conditions of a dataset and the error reached, as one line.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset shown, with the attributes of an instrument or an experiment.
    select : mapping, optional
        Labels of the grid at which the dataset was selected.
    band : str
        Name of the graphical element for errors; "" for none.

    Returns
    -------
    str
        Items contain no line breaks.  Empty for a dataset without attributes.
    """
    items = [
        *_describe_medium(dataset.attrs, dict(select or {})),
        _describe_light(dataset, dict(select or {})),
    ]
    if dataset.sizes.get("wavelength") == 1:
        items.append(f"{float(dataset.wavelength.values[0]):g} nm")
    items.append(_describe_error(dataset, band))
    text = ", ".join(item.replace(" ", "\u00a0").replace(";\u00a0", "; ") for item in items if item)
    text = text if dataset.attrs.get("medium") else ""
    return text[:1].upper() + text[1:]


def _describe_medium(attributes: Mapping[str, Any], select: dict[str, Any]) -> list[str]:
    """Return the descriptions of the medium and of the fixed labels."""
    kind = str(attributes.get("medium", ""))
    if kind not in CONDITIONS:
        return []
    values = {
        key: attributes[f"{kind}_{key}"]
        for key in CONDITIONS[kind]
        if f"{kind}_{key}" in attributes
    } | select
    # Keywords that state the same quantity.
    sizes = ("specific_surface_area_m2_kg", "optical_radius_um", "grain_size_um")
    for keys in (sizes, ("saturation", "liquid_water_content")):
        # The selected one, or the one with the fewest digits, which is the one that was written.
        given = [key for key in keys if key in values]
        shown = [key for key in given if key in select] or sorted(
            given, key=lambda key: count_digits(values[key])
        )
        values = {key: v for key, v in values.items() if key not in given or key == shown[0]}
    opaque = attributes.get(f"{kind}_opaque") == "true"
    # What is below has no effect.
    hidden: tuple[str, ...] = ()
    if opaque or attributes.get("instrument") in ("surface_map", "lens"):
        hidden = ("optical_thickness", "single_scattering_albedo", "ground")
    items = [kind.replace("_", " ")]
    for key, label in CONDITIONS[kind].items():
        if key in values and key not in hidden:
            items.append(_format_condition(key, label, values.pop(key)))
    if opaque:
        items.append("nothing below the surface")
    for unit, symbol in (("_ng_g", "ng/g"), ("_cells_ml", "cells/ml")):
        for key, amount in attributes.items():
            name = str(key).removeprefix(f"{kind}_").removesuffix(unit)
            is_selected = any(str(one).endswith(f".{name}") for one in select)
            if key == f"{kind}_{name}{unit}" and float(amount) > 0.0 and not is_selected:
                items.append(f"{name.replace('_', ' ')} {format_value(amount)} {symbol}")
    return items + [
        f"{format_parameter(key)}: {format_value(value, key)}"
        for key, value in values.items()
        if key in select and key != "incidence_deg"
    ]


def _describe_light(dataset: xr.Dataset, select: Mapping[str, Any]) -> str:
    incidence = select.get("incidence_deg", dataset.attrs.get("incidence_deg"))
    if incidence is None:
        return ""
    if str(incidence) == "diffuse":
        return "diffuse light"
    text = f"incidence {format_value(incidence)}" + ("" if isinstance(incidence, str) else "°")
    stokes = get_incident_stokes(dataset.attrs)
    if stokes != UNPOLARIZED_LIGHT:
        text += f", Stokes vector ({', '.join(f'{value:g}' for value in stokes)})"
    return text


def _describe_error(dataset: xr.Dataset, band: str) -> str:
    """Return the meaning of the bands, and the error reached."""
    texts = [f"{band}: {BAND_SIGMA:g} standard errors"] if band else []
    for key, description in ERROR_NAMES.items():
        name = f"{key}_reached"
        reached = dataset[name].max() if name in dataset else dataset.attrs.get(name)
        if reached is not None:
            texts.append(f"{description} ≤ {format_value(float(f'{float(reached):.1g}'))}")
            break
    return "; ".join(texts)


_MARGIN_INCHES = 0.05
NOTES_GID = "foot"
"""Identifier of the text of notes in a figure."""


def annotate_figure(figure: Figure, panels: Iterable[Axes], *notes: str) -> Figure:
    """Label the panels of a figure with letters, and write notes at its foot.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout.  Its height increases by that of the notes.
    panels : iterable of matplotlib.axes.Axes
        In reading order.  The letter precedes the title of a panel.
    *notes : str
        Paragraphs, wrapped at spaces; empty ones are skipped.

    Returns
    -------
    matplotlib.figure.Figure
        The same figure.
    """
    shown = [axes for axes in panels if axes.get_visible()]
    for number, axes in enumerate(shown if len(shown) > 1 else ()):
        title = axes.get_title()
        axes.set_title("")
        axes.set_title(f"({format_panel_letter(number)}) {title}".rstrip(), loc="left")
    add_notes(figure, *notes)
    return figure


def format_panel_letter(number: int) -> str:
    """Return the letter of a panel counted from 0: a to z, then aa, ab and so on."""
    rounds, rest = divmod(number, 26)
    return (format_panel_letter(rounds - 1) if rounds else "") + chr(ord("a") + rest)


def add_notes(figure: Figure, *notes: str) -> None:
    """Write notes below the panels and earlier notes; the figure height increases accordingly."""
    if not any(notes):
        return
    inches, dpi = figure.get_figwidth(), figure.dpi
    text = next((item for item in figure.texts if item.get_gid() == NOTES_GID), None)
    height, previous = figure.get_figheight(), ""
    if text is None:
        text = figure.text(
            _MARGIN_INCHES / inches, 0.0, "", va="bottom", ha="left", fontsize=SMALL_FONT_PT,
            color="0.3", linespacing=1.25, gid=NOTES_GID,
        )  # fmt: skip
        # The layout would otherwise reserve room inside the axes.
        text.set_in_layout(False)
    else:
        previous = text.get_text() + "\n"
        height -= text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    max_width_px = (inches - 2.0 * _MARGIN_INCHES) * dpi
    lines = [line for note in notes if note for line in _wrap_note(text, note, max_width_px)]
    text.set_text(previous + "\n".join(lines))
    notes_height = text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    figure.set_figheight(height + notes_height)
    fraction = notes_height / (height + notes_height)
    text.set_y(_MARGIN_INCHES / (height + notes_height))
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0.0, fraction, 1.0, 1.0 - fraction))  # type: ignore[call-arg]


def _wrap_note(text: Text, note: str, max_width_px: float) -> list[str]:
    """Return a note wrapped to a width in pixels."""
    lines = [""]
    for word in note.split(" "):
        candidate = f"{lines[-1]} {word}".strip(" ")
        text.set_text(candidate)
        if lines[-1] and text.get_window_extent().width > max_width_px:
            lines.append(word)
        else:
            lines[-1] = candidate
    return lines
