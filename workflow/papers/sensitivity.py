"""Mean sensitivity indices of snow (SPLITSnow, section 5.4, Table 2, Fig 23), also by pairs.

The mean sensitivity index (MSI; SPLITSnow section 5.4, after Hamby 1994) is the mean over
wavelengths of |y − ŷ| / max(y, ŷ) for the spectra y and ŷ at a parameter's extremes.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from splits.core.escaping import escape_mathtext
from splits.core.uncertainty import make_variable
from splits.core.validation import check_choice, invalid
from splits.experiments.config.media import make_label
from splits.io.netcdf import make_provenance, select_points, to_netcdf_attributes
from splits.plotting.grammar import (
    BAND_SIGMA,
    annotate_figure,
    make_subplots,
    pick_colours,
    use_style,
)
from workflow.papers.statements import require, require_columns

NOISE_THRESHOLD_SIGMA = 2.0
"""Threshold of the larger value, in its standard errors, for a wavelength to count."""
QUANTITY_CONDITIONS: dict[str, dict[str, Any]] = {
    "reflectance": {"depth_m": 0.12, "wavelength_nm": (400.0, 2500.0)},
    "transmittance": {"depth_m": 0.02, "wavelength_nm": (400.0, 1420.0)},
}
"""Depth and wavelengths for each quantity in SPLITSnow sections 5.2.2 and 5.4."""
COLUMNS = [
    "parameter", "quantity", "interpretation", "low", "high", "chosen", "msi", "msi_stderr",
    "msi_resolved", "resolved_fraction",
]  # fmt: skip

BY_INTERPRETATION = "_by_interpretation"
"""End of the names of runs that also vary the interpretation."""
RANGE_UNITS = {"grain_size": " µm", "density": " kg m⁻³"}
"""Units of parameters in the sentence on their ranges."""


PAIR_KEYS = ("parameter", "low", "high", "source")
SOURCES = ("paper", "ours")


def make_sensitivities(
    *,
    pairs: Mapping[str, Mapping[str, Any]],
    published: pd.DataFrame | None = None,
    **runs: xr.Dataset,
) -> tuple[pd.DataFrame, pd.DataFrame, xr.Dataset, Figure]:
    """Return the indices for all pairs of values, and a table, a dataset and a figure of a few.

    Parameters
    ----------
    pairs : mapping
        Pairs of values by the name of their run: the ``parameter`` of the grid, its values ``low``
        and ``high`` (numbers, or labels; the order has no effect), and their ``source``, the paper
        or (by default) our choice.
    published : pandas.DataFrame, optional
        Published numbers, with the rows ``msi_r_PAIR`` and ``msi_t_PAIR`` for each pair.
    **runs : xarray.Dataset
        Reflectance and transmittance over the parameter and the depth (0.12 and 0.02 m) by the
        names of the pairs, and optionally over interpretations of the papers as well, under
        ``PAIR_by_interpretation``.
    """
    pairs = {name: _check_pair(name, pair, runs) for name, pair in pairs.items()}
    names = {*pairs, *(f"{name}{BY_INTERPRETATION}" for name in pairs)}
    for name in runs:
        check_choice("inputs", name, names)
    if published is not None:
        ids = [one for name in pairs for one in list_published_names(name)]
        require_columns("published.published", published, ids)
    table = make_sensitivity_table(runs, pairs)
    chosen = select_chosen_sensitivities(table, published)
    figure = draw_sensitivity_bars(chosen, describe_ranges(pairs))
    return table, chosen.to_dataframe().reset_index(), chosen, figure


def _check_pair(
    name: str, pair: Mapping[str, Any], runs: Mapping[str, xr.Dataset]
) -> dict[str, Any]:
    """Return a pair of values with its source; reject one that its runs do not have."""
    key = f"options.pairs.{name}"
    for one in pair:
        check_choice(key, one, PAIR_KEYS)
    for one in ("parameter", "low", "high"):
        if one not in pair:
            raise invalid(key, dict(pair), f"with {one}")
    pair = {"source": "ours", **pair}
    check_choice(f"{key}.source", pair["source"], SOURCES)
    low, high = pair["low"], pair["high"]
    if make_label(key, low) == make_label(key, high):
        raise invalid(f"{key}.high", high, f"different from low = {low}")
    axes = (pair["parameter"], "depth_m")
    values = {pair["parameter"]: (low, high), "depth_m": (0.12, 0.02)}
    for run, more in ((name, ()), (f"{name}{BY_INTERPRETATION}", ("interpretation",))):
        if run in runs:
            for quantity in QUANTITY_CONDITIONS:
                require(
                    run, runs[run], quantity, (*axes, *more), values=values, band_nm=(400, 2500)
                )
        elif not more:
            raise invalid("inputs", list(runs), f"with {name}, the run of options.pairs.{name}")
    return pair


def compute_pair_sensitivity(
    dataset: xr.Dataset, parameter: str, low: Any, high: Any, quantity: str
) -> SensitivityIndex:
    """Return the mean sensitivity index of a quantity between two values of a parameter.

    Parameters
    ----------
    dataset : xarray.Dataset
        Over `parameter`, ``depth_m`` and ``wavelength``.
    parameter, low, high
        Name of the grid's dimension and two of its labels.
    quantity : {"reflectance", "transmittance"}
    """
    conditions = QUANTITY_CONDITIONS[quantity]
    part = select_points(dataset, {"depth_m": conditions["depth_m"]}).sel(
        wavelength=slice(*conditions["wavelength_nm"])
    )
    y, z = (select_points(part, {parameter: label}) for label in (low, high))
    return compute_spectral_sensitivity(y, z, quantity)


def make_sensitivity_table(
    datasets: Mapping[str, xr.Dataset], pairs: Mapping[str, Mapping[str, Any]]
) -> pd.DataFrame:
    """Return the index for every parameter, quantity, range and interpretation.

    Parameters
    ----------
    datasets, pairs : mapping
        See `make_sensitivities`.

    Returns
    -------
    pandas.DataFrame
        With `COLUMNS`.
    """
    rows = []
    for name, pair in pairs.items():
        dimension, ranges = pair["parameter"], datasets[name]
        ends = [pair["low"], pair["high"]]
        for quantity in QUANTITY_CONDITIONS:
            for labels in itertools.combinations(ranges[dimension].values, 2):
                index = compute_pair_sensitivity(ranges, dimension, *labels, quantity)
                chosen = all(any(_is_same_label(label, end) for label in labels) for end in ends)
                rows.append((name, quantity, "default", *labels, chosen, *astuple(index)))
            interpretations = datasets.get(f"{name}{BY_INTERPRETATION}")
            if interpretations is None:
                continue
            low, high = (
                next(x for x in interpretations[dimension].values if _is_same_label(x, end))
                for end in ends
            )
            # The experiment over ranges has the default interpretation.
            for label in map(str, interpretations.interpretation.values):
                if label != "default":
                    part = select_points(interpretations, {"interpretation": label})
                    index = compute_pair_sensitivity(part, dimension, low, high, quantity)
                    rows.append((name, quantity, label, low, high, False, *astuple(index)))
    return pd.DataFrame(rows, columns=COLUMNS)


def list_published_names(pair: str) -> list[str]:
    """Return the ids of the published indices of a pair, one for each quantity."""
    return [f"msi_{quantity[0]}_{pair}" for quantity in QUANTITY_CONDITIONS]


def select_chosen_sensitivities(
    table: pd.DataFrame, published: pd.DataFrame | None = None
) -> xr.Dataset:
    """Return the indices of the chosen pairs over quantity and parameter, and published ones.

    Parameters
    ----------
    table : pandas.DataFrame
        See `make_sensitivity_table`.
    published : pandas.DataFrame, optional
        See `splits.analysis.measured.read_published`, with a row for each index.
    """
    chosen = table[table.chosen].drop_duplicates(["quantity", "parameter"])
    parameters = list(chosen.parameter.unique())
    grid = chosen.set_index(["quantity", "parameter"])[["msi", "msi_stderr"]].unstack()
    index, error = (
        grid[name].loc[list(QUANTITY_CONDITIONS), parameters].to_numpy()
        for name in ("msi", "msi_stderr")
    )
    dims, label = ("quantity", "parameter"), "mean sensitivity index"
    variables = make_variable("msi", dims, index, error, label)
    if published is not None:
        values = [
            list(column)
            for column in zip(
                *(published.published[list_published_names(name)] for name in parameters),
                strict=True,
            )
        ]
        long_name = f"{label} published in SPLITSnow Table 2"
        variables |= make_variable("published", dims, np.array(values), None, long_name)
    return xr.Dataset(
        variables,
        {
            "quantity": ("quantity", list(QUANTITY_CONDITIONS), {"long_name": "quantity"}),
            "parameter": ("parameter", parameters, {"long_name": "parameter of the snow"}),
        },
        to_netcdf_attributes(
            {"title": "Mean sensitivity index of snow", **make_provenance("sensitivity")}
        ),
    )


def describe_ranges(pairs: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a sentence on the range of each parameter and its origin.

    Parameters
    ----------
    pairs : mapping
        For each parameter ``low``, ``high`` and ``source``, ``"paper"`` or ``"ours"``.
    """
    parts = []
    for origin, text in (("paper", "stated by the paper"), ("ours", "chosen here, not stated")):
        ranges = [
            f"{name.replace('_', ' ')} {_format_end(pair['low'])} to {_format_end(pair['high'])}"
            f"{RANGE_UNITS.get(name, '')}"
            for name, pair in pairs.items()
            if pair["source"] == origin
        ]
        parts += [f"{text}: {', '.join(ranges)}"] if ranges else []
    return f"Ranges {'; '.join(parts)}."


def _format_end(value: Any) -> str:
    """Return an end of a range, a number or a range of grain sizes, as text."""
    return f"{value:g}" if isinstance(value, int | float) else str(value).replace("-", "–")


def _is_same_label(value: Any, label: Any) -> bool:
    if isinstance(value, (int, float, np.number)):
        return bool(np.isclose(float(value), float(label)))
    return str(value) == make_label("", label)


def draw_sensitivity_bars(dataset: xr.Dataset, note: str = "") -> Figure:
    """Draw the mean sensitivity index of each parameter, with published values if available.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variables ``msi``, ``msi_stderr`` and optionally ``published`` over ``quantity`` and
        ``parameter``.
    note : str
        Note for the foot, such as `describe_ranges`.
    """
    with use_style():
        figure, axes = make_subplots(height=2.5)
        x = np.arange(dataset.sizes["parameter"])
        width = 0.36
        for i, quantity in enumerate(dataset.quantity.values):
            part = dataset.sel(quantity=quantity)
            positions = x + (i - 0.5) * width
            colour = pick_colours(2, "sample")[i]
            axes.bar(positions, part.msi, width, color=colour, alpha=0.85, label=str(quantity))
            axes.errorbar(
                positions,
                part.msi,
                BAND_SIGMA * part.msi_stderr,
                fmt="none",
                ecolor="black",
                elinewidth=0.8,
            )
            if "published" in part:
                axes.plot(
                    positions,
                    part.published,
                    "D",
                    color="white",
                    mec="black",
                    mew=0.7,
                    ms=4,
                    ls="none",
                    label="published" if i == 0 else None,
                )
        names = [str(p).replace("_", " ") for p in dataset.parameter.values]
        axes.set_xticks(x, list(map(escape_mathtext, names)))
        axes.set_ylabel("mean sensitivity index")
        axes.set_ylim(0, 1.05)
        figure.legend(
            *axes.get_legend_handles_labels(), frameon=False, ncols=3, loc="outside upper center"
        )
        errors = f"Error bars: {BAND_SIGMA:g} standard errors."
        return annotate_figure(figure, [axes], " ".join([escape_mathtext(note), errors]).strip())


@dataclass(frozen=True)
class SensitivityIndex:
    """A mean sensitivity index.

    Attributes
    ----------
    index : float
        MSI over all wavelengths.  Where both values are below the noise, the ratio is undefined and
        counts as 0, as for two zeros of an analog run.
    stderr : float
        Standard error; from `compute_mean_sensitivity_index` an upper bound that assumes fully
        correlated errors of all wavelengths.  It includes the effect of wavelengths near the noise
        threshold, which are counted in some runs only.
    index_resolved : float
        MSI over the wavelengths above the noise only.
    resolved_fraction : float
        Fraction of wavelengths above the noise.
    """

    index: float
    stderr: float
    index_resolved: float
    resolved_fraction: float


def compute_spectral_sensitivity(
    y: xr.Dataset, z: xr.Dataset, quantity: str, floor: float = 0.0
) -> SensitivityIndex:
    """Return the mean sensitivity index of two simulated spectra.

    Its error includes the correlation of errors along each spectrum, see `splits.core.uncertainty`.

    Parameters
    ----------
    y, z : xarray.Dataset
        Independent outputs of `splits.spectrophotometer` over ``wavelength``.
    quantity : str
        Name of the quantity, such as ``reflectance``.
    floor : float
        Value below which both spectra count as 0.
    """
    values = [
        np.asarray(spectrum[name].values, dtype=float)
        for spectrum in (y, z)
        for name in (quantity, f"{quantity}_stderr")
    ]
    is_dark = np.maximum(values[0], values[2]) < floor
    values = [np.where(is_dark, 0.0, value) for value in values]
    index = compute_mean_sensitivity_index(*values)
    larger, _, divisor, is_above_noise = _compare_with_noise(*values)
    smaller = np.minimum(values[0], values[2])
    # Derivatives of |y - z| / max: smaller/larger² by the larger value, -1/larger by the smaller.
    slope_larger, slope_smaller = smaller / divisor**2, -1.0 / divisor
    y_is_larger = values[0] >= values[2]
    variance = 0.0
    for spectrum, is_larger in ((y, y_is_larger), (z, ~y_is_larger)):
        slope = (
            np.where(is_above_noise, np.where(is_larger, slope_larger, slope_smaller), 0.0)
            / larger.size
        )
        weights = xr.DataArray(slope, dims="wavelength")
        variance += float(spectrum.errors.weighted_sum(quantity, weights)[1]) ** 2
    return replace(
        index, stderr=float(np.hypot(variance**0.5, _estimate_threshold_error(*values).mean()))
    )


def _compare_with_noise(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the larger values, their errors, nonzero divisors, and which exceed the noise."""
    larger = np.maximum(y, z)
    error = np.where(y >= z, y_stderr, z_stderr)
    is_above_noise = larger > NOISE_THRESHOLD_SIGMA * error
    return larger, error, np.where(is_above_noise, larger, 1.0), is_above_noise


def _estimate_threshold_error(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> np.ndarray:
    """Return the error due to wavelengths near the noise threshold.

    With the probability p to count, √(p (1 − p)) ≤ exp(−d²/4)/2 at a distance d from the threshold.
    """
    larger, error, _, _ = _compare_with_noise(y, y_stderr, z, z_stderr)
    limit = NOISE_THRESHOLD_SIGMA * error
    tiny = np.finfo(float).tiny
    distance = np.abs(larger - limit) / np.maximum(error, tiny)
    max_ratio = 1.0 - np.minimum(y, z) / np.maximum(np.maximum(larger, limit), tiny)
    return np.where(
        limit > 0.0, 0.5 * max_ratio * np.exp(-0.25 * np.minimum(distance, 50.0) ** 2), 0.0
    )


def compute_mean_sensitivity_index(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> SensitivityIndex:
    """Return the mean sensitivity index of two spectra.

    Parameters
    ----------
    y, z : array_like, shape (wavelengths,)
        Reflectance or transmittance at the two extremes of a parameter.
    y_stderr, z_stderr : array_like
        Their standard errors.
    """
    y, y_stderr, z, z_stderr = (
        np.asarray(array, dtype=float) for array in (y, y_stderr, z, z_stderr)
    )
    larger, error_of_larger, divisor, is_above_noise = _compare_with_noise(y, y_stderr, z, z_stderr)
    smaller = np.minimum(y, z)
    ratio = np.where(is_above_noise, (larger - smaller) / divisor, 0.0)
    # d ratio = (smaller/larger) · (relative errors in quadrature).
    error_of_smaller = np.where(y >= z, z_stderr, y_stderr)
    error = np.where(
        is_above_noise,
        np.hypot(error_of_smaller, smaller * error_of_larger / divisor) / divisor,
        0.0,
    )
    error = np.hypot(error, _estimate_threshold_error(y, y_stderr, z, z_stderr))
    resolved = float(ratio[is_above_noise].mean()) if is_above_noise.any() else 0.0
    return SensitivityIndex(
        float(ratio.mean()), float(error.mean()), resolved, float(is_above_noise.mean())
    )
