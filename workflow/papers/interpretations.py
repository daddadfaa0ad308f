"""Ranking of the interpretations of SPLITSnow by their misfit to its statements.

A stated number has a tolerance: the largest difference that counts as agreement.  The misfit of a
combination of interpretations is the sum over all numbers and trends of squared differences in
units of their tolerances; trends add to it only where they fail.  Apart from noise it increases
from stage to stage.  All combinations are simulated in the cheap stages; costly stages are limited
to those with the smallest sum so far (`STAGE_QUOTAS`).  A combination that was dropped may still
have a smaller misfit than the first, so the search is heuristic.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, field, fields
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtr

from splits.core.validation import check_choice, invalid, unknown_key
from splits.media import Interpretation
from splits.media.interpretations import INTERPRETATION_CHOICES, INTERPRETATION_SETS
from splits.plotting.grammar import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    annotate_figure,
    make_subplots,
    use_style,
)
from splits.plotting.lines import INDEPENDENCE_NOTE, SHIFT_COLOUR
from workflow.papers.interpretation_runs import (
    STAGES,
    STATED_NUMBERS,
    TRANSMITTANCE_FLOORS,
    WATER_TABLES,
    InterpretationRun,
    PublishedStatement,
    StatementValues,
    TargetErrors,
    get_stated_trends,
    list_extreme_pairs,
)
from workflow.papers.statements import Estimate, require_columns

MAX_SIGMA = 8.0
"""Significance (standard errors) above which the variance of a satisfied trend is set to 0, because
its formula loses all digits."""


def select_statements(
    published: pd.DataFrame, names: Iterable[str]
) -> dict[str, PublishedStatement]:
    """Return statements of numbers by name.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.  Where limits are given instead of a
        tolerance, half of their distance is the tolerance.
    names : iterable of str
        Ids in that table.
    """
    statements = {}
    for name in names:
        row = published.loc[name]
        if isinstance(row.bar, str):
            unit = abs(row.published) / 100.0 if row.bar.endswith("%") else 1.0
            tolerance = float(row.bar.rstrip("%")) * unit
        else:
            tolerance = 0.5 * (float(row.high) - float(row.low))
        statements[name] = PublishedStatement(name, str(row.place), float(row.published), tolerance)
    return statements


@dataclass(frozen=True)
class Misfit:
    """Sum of squared differences in units of the tolerances.

    Attributes
    ----------
    total : float
        Sum with the mean contribution of noise subtracted.
    stderr : float
    """

    total: float
    stderr: float

    def compute_rms(self, n_statements: int) -> tuple[float, float]:
        """Return the root-mean-square difference in tolerances per statement, and its error."""
        value = float(np.sqrt(max(self.total, 0.0) / n_statements))
        spread = self.stderr / n_statements
        return value, float(spread / (2.0 * value)) if value > 0.0 else float(np.sqrt(spread))


def compute_misfit(
    statements: Iterable[PublishedStatement], ours: Iterable[float], stderr: Iterable[float]
) -> Misfit:
    """Return the misfit of values with independent errors.

    With a difference d of error e (both in tolerances), d² is e² too large on average and has the
    variance 4 d² e² + 2 e⁴.  A trend that fails is treated alike.  A trend that is satisfied by z
    standard errors adds only to the variance, for the probability that the true value fails:
    e⁴ ((z⁴ + 6z² + 3) Φ(−z) − (z³ + 5z) φ(z)).
    """
    total, variance = 0.0, 0.0
    for statement, value, error in zip(statements, ours, stderr, strict=True):
        distance = float(statement.normalize_difference(value))
        noise = (error / statement.tolerance) ** 2
        if statement.is_trend and distance == 0.0:
            z = value / error if error > 0.0 else np.inf
            variance += noise**2 * _compute_tail_fourth_moment(z)
            continue
        total += max(distance**2 - noise, 0.0) if statement.is_trend else distance**2 - noise
        variance += 4.0 * distance**2 * noise + 2.0 * noise**2
    return Misfit(total, float(np.sqrt(variance)))


def _compute_tail_fourth_moment(z: float) -> float:
    """Return the fourth moment of a standard normal distribution beyond -z, about -z."""
    if z > MAX_SIGMA:
        return 0.0
    tail = ndtr(-z)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    polynomial = (z**4 + 6.0 * z**2 + 3.0) * tail - (z**3 + 5.0 * z) * density
    return max(float(polynomial), 0.0)


OVERLAPS_KEY = "overlaps"
"""Key of a ranking of interpretations that sets `OVERLAP_KEYS` together."""
OVERLAP_KEYS = ("overlap_with_previous_segment", "overlap_with_boundary")
"""Fields of `splits.Interpretation` for grains that overlap the last segment or a boundary."""
OVERLAP_CHOICES = {
    "reject": ("reject", "reject"),
    "keep": ("keep", "keep"),
    "skip": ("skip", "skip"),
    "segment overlap kept": ("keep", "reject"),
}
"""Values of `OVERLAPS_KEY`, and those of `OVERLAP_KEYS` for each."""
CHOICES = {
    **{field.name: INTERPRETATION_CHOICES[field.name] for field in fields(Interpretation)},
    OVERLAPS_KEY: tuple(OVERLAP_CHOICES),
}
"""Choices by keyword."""
STANDARD_STDERR = 0.002
"""Standard error of the accuracy for which the runs of a ranking are sized."""


STAGE_QUOTAS = {
    "angles": (32, 32), "transmittance": (16, 16), "facetness below": (16, 16),
    "grain size": (16, 16), "nadir": (7, 7), "grains": (7, 7), "free ranges": (7, 7),
}  # fmt: skip
"""Numbers of combinations that enter a stage: of all, and of those consistent with the text.  Named
sets always enter; other stages have no limit."""

LOG_INTERVAL = 24
"""Number of combinations between lines of progress."""
MAX_MISFIT = 100.0
"""Misfit (one difference of ten tolerances) above which a combination is dropped."""


PAPER_SETS = tuple(
    name for name in INTERPRETATION_SETS if Interpretation.from_input(name).grain_extent == "finite"
)
"""Named sets that can be ranked: in the papers, grains have a finite extent."""


class BestMatch(NamedTuple):
    """Values of all free choices of a paper with the smallest misfit for one water.

    Attributes
    ----------
    misfit : Misfit
    values : dict
        Our values and their standard errors by statement.
    floor : float
        Transmittance below which values count as 0 in all sensitivities.
    ranges : dict
        Extremes of the parameter for each statement on its sensitivity.
    """

    misfit: Misfit
    values: dict[str, tuple[float, float]]
    floor: float
    ranges: dict[str, str]


@dataclass(eq=False)
class RankedCombination:
    """An interpretation and the results of the stages simulated so far.

    Attributes
    ----------
    run : InterpretationRun
    values : dict
        Our values and standard errors, see
        `workflow.papers.interpretation_runs.StatementValues`.
    n_stages : int
        Number of stages simulated.
    min_misfit : float
        Smallest misfit so far over all waters.
    """

    run: InterpretationRun
    values: StatementValues = field(default_factory=dict)
    n_stages: int = 0
    min_misfit: float = 0.0

    @property
    def is_complete(self) -> bool:
        """Whether all stages are simulated."""
        return self.n_stages == len(STAGES)

    def describe(self, names: Iterable[str]) -> str:
        """Return the choices of some fields of the interpretation."""
        fields = self.run.interpretation.as_dict()
        return ", ".join(f"{name}: {fields[name]}" for name in names)

    def is_consistent_with(self, stated_choices: Mapping[str, str]) -> bool:
        """Return whether the interpretation agrees with the choices that a text states."""
        interpretation = self.run.interpretation
        return all(
            getattr(interpretation, name) == choice
            for name, choice in expand_overlaps(stated_choices).items()
        )

    def find_set_name(self) -> str:
        """Return the name of the set with this interpretation, or an empty string."""
        interpretation = self.run.interpretation
        return next(
            (name for name in PAPER_SETS if Interpretation.from_input(name) == interpretation), ""
        )

    def find_best_matches(self, stated: Mapping[str, PublishedStatement]) -> list[BestMatch]:
        """Return the best match for each water, over the statements simulated so far.

        The floor is common to all sensitivities, and the pair of extremes to both of a parameter.
        """
        statements = {name: stated[name] for name in stated if name in self.values}
        return [
            min(
                (
                    self._match(statements, water, floor)
                    for floor in range(len(TRANSMITTANCE_FLOORS))
                ),
                key=lambda match: match.misfit.total,
            )
            for water in range(len(WATER_TABLES))
        ]

    def _match(
        self, statements: Mapping[str, PublishedStatement], water: int, floor: int
    ) -> BestMatch:
        """Return the best match for one water and one floor."""
        rows = {name: _select_values(self.values[name], water, floor) for name in statements}
        numbers = {name: row for name, row in rows.items() if row.ndim == 1}
        sensitivities = [name for name in rows if name not in numbers]
        ranges: dict[str, str] = {}
        for parameter in dict.fromkeys(name.split("_", 2)[2] for name in sensitivities):
            names = [name for name in sensitivities if name.endswith(f"_{parameter}")]
            distance = sum(
                statements[name].normalize_difference(rows[name][0]) ** 2 for name in names
            )
            pair = int(np.argmin(distance))
            ranges |= dict.fromkeys(names, list_extreme_pairs(parameter)[pair])
            numbers |= {name: rows[name][:, pair] for name in names}
        values = {name: (float(numbers[name][0]), float(numbers[name][1])) for name in statements}
        ours, errors = ([values[name][i] for name in statements] for i in (0, 1))
        misfit = compute_misfit(statements.values(), ours, errors)
        return BestMatch(misfit, values, TRANSMITTANCE_FLOORS[floor], ranges)


def _select_values(estimate: tuple[np.ndarray, np.ndarray], water: int, floor: int) -> np.ndarray:
    """Return a value and its error, for sensitivities of all pairs; reflectance has one floor."""
    arrays = [array[water] for array in estimate]
    return np.array([a if a.ndim == 0 else a[:, min(floor, a.shape[1] - 1)] for a in arrays])


def make_ranking(
    *,
    published: pd.DataFrame,
    choices: Mapping[str, Sequence[str]],
    stated: Mapping[str, str],
    seed: int,
    max_stderr: float,
    threads: int,
    log: Callable[[str], None],
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame, Figure]:
    """Return the ranking, the statements, the best combinations without some, and the figure.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.
    choices, stated : mapping
        Choices to combine, and the unambiguous ones of the paper, see `rank_interpretations`.
    seed, max_stderr, threads, log
        Of the run of the workflow.
    """
    if not choices:
        raise invalid("options.choices", choices, "choices by keyword")
    for key, names in choices.items():
        if key not in CHOICES:
            raise unknown_key(f"options.choices.{key}", CHOICES)
        for name in names:
            check_choice(f"options.choices.{key}", name, CHOICES[key])
    for key, name in stated.items():
        if key not in choices:
            raise unknown_key(f"options.stated.{key}", choices)
        check_choice(f"options.stated.{key}", name, choices[key])
    ids = tuple(itertools.chain(*STATED_NUMBERS.values()))
    require_columns("published.published", published, ids)
    combinations, statements = rank_interpretations(
        published, choices, stated, seed, threads, max_stderr / STANDARD_STDERR, log
    )
    names = find_differing_keys(combinations)
    table = make_statement_table(combinations, statements, names)
    ranking = make_ranking_table(combinations, statements, choices, stated)
    without = make_leave_out_table(combinations, statements, names)
    return ranking, table, without, draw_interpretation_shifts(table)


def rank_interpretations(
    published: pd.DataFrame,
    choices: Mapping[str, Sequence[str]],
    stated_choices: Mapping[str, str],
    seed: int = 1,
    threads: int = 1,
    stderr_scale: float = 1.0,
    log: Callable[[str], None] = lambda line: None,
) -> tuple[list[RankedCombination], dict[str, PublishedStatement]]:
    """Simulate combinations of interpretations, dropping those with a large misfit.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.
    choices : mapping
        From fields of `splits.Interpretation` to the choices varied; ``overlaps`` sets both fields
        for overlapping grains.
    stated_choices : mapping
        Choices that the paper states unambiguously.  The best combinations that agree with them
        are simulated in all stages.
    seed : int
        Common to all runs, so that similar combinations have correlated errors.
    threads : int
    stderr_scale : float
        Multiplies the errors of all runs.
    log : callable
        Receives lines of progress.

    Returns
    -------
    combinations : list of RankedCombination
        All combinations and the named sets, in order of increasing misfit.
    stated : dict
        All statements by name.
    """
    start_time, target_errors = time.perf_counter(), TargetErrors().scale(stderr_scale)
    stated: dict[str, PublishedStatement] = {}
    for stage in STAGES:
        stated |= select_statements(published, STATED_NUMBERS.get(stage, ()))
        stated |= get_stated_trends(stage)
    interpretations = [
        Interpretation(**expand_overlaps(dict(zip(choices, item, strict=True))))
        for item in itertools.product(*choices.values())
    ]
    # Named sets may differ from all combinations in fields that are not varied.
    interpretations += [
        item for item in map(Interpretation.from_input, PAPER_SETS) if item not in interpretations
    ]
    combinations = [
        RankedCombination(InterpretationRun(item, seed, target_errors)) for item in interpretations
    ]

    def advance(item: RankedCombination) -> None:
        stage = list(STAGES)[item.n_stages]
        item.values |= STAGES[stage](item.run)
        item.n_stages += 1
        item.min_misfit = min(choice.misfit.total for choice in item.find_best_matches(stated))

    active = list(combinations)
    with ThreadPoolExecutor(threads) as pool:
        for number, stage in enumerate(STAGES):
            active.sort(key=lambda item: item.min_misfit)
            if stage in STAGE_QUOTAS:
                n_all, n_consistent = STAGE_QUOTAS[stage]
                consistent = [item for item in active if item.is_consistent_with(stated_choices)]
                named = [item for item in active if item.find_set_name()]
                selected = [*active[:n_all], *consistent[:n_consistent], *named]
                active = [item for item in active if item in selected]
            if number:
                # Combinations with a large misfit are dropped, except for the best two.
                active = [
                    item for i, item in enumerate(active)
                    if i < 2 or item.min_misfit < MAX_MISFIT or item.find_set_name()
                ]  # fmt: skip
            for done, _ in enumerate(pool.map(advance, active), start=1):
                if done % LOG_INTERVAL == 0 or done == len(active):
                    log(
                        f"interpretation: {stage}, {done} of {len(active)}; stage {number + 1} of "
                        f"{len(STAGES)}; {time.perf_counter() - start_time:.0f} s"
                    )
    return sorted(combinations, key=lambda item: (-item.n_stages, item.min_misfit)), stated


def expand_overlaps(choices: Mapping[str, str]) -> dict[str, Any]:
    """Return choices with ``overlaps`` replaced by the two fields that it sets."""
    rest = {name: choice for name, choice in choices.items() if name != OVERLAPS_KEY}
    values = OVERLAP_CHOICES[choices[OVERLAPS_KEY]] if OVERLAPS_KEY in choices else ()
    return rest | dict(zip(OVERLAP_KEYS, values, strict=bool(values)))


def find_choice(interpretation: Interpretation, name: str) -> str:
    """Return the choice of an interpretation for a key, the inverse of `expand_overlaps`."""
    fields = interpretation.as_dict()
    if name != OVERLAPS_KEY:
        return fields[name]
    values = tuple(fields[key] for key in OVERLAP_KEYS)
    return next(choice for choice, pair in OVERLAP_CHOICES.items() if pair == values)


STATEMENT_GROUPS = {
    "Table 3": ("table3",),
    "transmittance": ("transmittance",),
    "sensitivities, stated ranges": ("msi_r_grain", "msi_t_grain", "msi_r_facet", "msi_t_facet"),
    "sensitivities, free ranges": ("msi_r_sat", "msi_t_sat", "msi_r_dens", "msi_t_dens"),
    "angles": ("fig",),
}
"""Prefixes of the names of statements, by group."""


def make_ranking_table(
    combinations: Sequence[RankedCombination],
    stated: Mapping[str, PublishedStatement],
    choices: Mapping[str, Sequence[str]],
    stated_choices: Mapping[str, str],
) -> pd.DataFrame:
    """Return one row per complete combination and water, followed by the dropped combinations.

    Columns are rank (0 for dropped ones), one per choice, set (its name, if any), water, text
    (whether it agrees with the text), stages, misfit and misfit_stderr (sum of squares in units of
    the tolerances; a lower bound for dropped ones), floor (transmittance that counts as 0), rms (in
    tolerances) and worst (the statement with the largest difference).
    """
    rows = []
    for combination in combinations:
        complete = combination.is_complete
        matches = combination.find_best_matches(stated)
        order = _sort_waters(matches)
        for water in order if complete else order[:1]:
            misfit, values, floor, _ = matches[water]
            distances = {
                name: float(stated[name].normalize_difference(v)) for name, (v, _) in values.items()
            }
            worst = max(distances, key=lambda name: abs(distances[name]))
            choice_of = {key: find_choice(combination.run.interpretation, key) for key in choices}
            row = {
                **choice_of, "set": combination.find_set_name(), "water": WATER_TABLES[water],
                "stages": combination.n_stages, "misfit": misfit.total,
                "misfit_stderr": misfit.stderr, "floor": floor,
                "rms": misfit.compute_rms(len(distances))[0],
                "worst": f"{worst} ({distances[worst]:+.1f})",
                "text": combination.is_consistent_with(stated_choices), "complete": complete,
            }  # fmt: skip
            rows.append(row)
    table = pd.DataFrame(rows)
    table = table.sort_values(["complete", "stages", "misfit"], ascending=[False, False, True])
    rank = np.where(table.complete, np.arange(1, len(table) + 1), 0)
    table.insert(0, "rank", rank)
    return table.drop(columns="complete").reset_index(drop=True)


def make_statement_table(
    combinations: Sequence[RankedCombination],
    stated: Mapping[str, PublishedStatement],
    names: Sequence[str],
) -> pd.DataFrame:
    """Return one row per statement, complete combination and water, in order of misfit.

    Parameters
    ----------
    combinations, stated
        See `rank_interpretations`.
    names : sequence of str
        Fields of the interpretation that identify combinations.
    """
    rows: list[dict[str, Any]] = []
    for number, combination in enumerate(_list_complete(combinations), start=1):
        matches = combination.find_best_matches(stated)
        nearest, *_ = order = _sort_waters(matches)
        for water, (name, statement) in itertools.product(order, stated.items()):
            _, values, floor, ranges = matches[water]
            value, error = values[name]
            row = {
                "combination": number, "interpretation": combination.describe(names),
                "set": combination.find_set_name(), "water": WATER_TABLES[water],
                "nearest_water": bool(water == nearest), "statement": name,
                "place": statement.place,
                "published": "above 0" if statement.is_trend else f"{statement.published:g}",
                "ours": value, "stderr": error, "bar": statement.tolerance,
                "distance": float(statement.normalize_difference(value)),
                "between": ranges.get(name, ""),
                "floor": floor if name.startswith("msi_t") else np.nan,
            }  # fmt: skip
            rows.append(row)
    return pd.DataFrame(rows)


def make_leave_out_table(
    combinations: Sequence[RankedCombination],
    stated: Mapping[str, PublishedStatement],
    names: Sequence[str],
) -> pd.DataFrame:
    """Return the best combination for all statements, and without each group of them.

    Columns are without, first (its interpretation), misfit, misfit_stderr, second, and margin with
    margin_stderr, the difference of the two misfits, for complete combinations.
    """
    columns = ["without", "first", "misfit", "misfit_stderr", "second", "margin", "margin_stderr"]
    rows = []
    for group, prefixes in {"nothing": (), **STATEMENT_GROUPS}.items():
        statements = {
            name: statement
            for name, statement in stated.items()
            if not (prefixes and name.startswith(prefixes))
        }
        best = []
        for combination in _list_complete(combinations):
            misfits = [match.misfit for match in combination.find_best_matches(statements)]
            best.append((min(misfits, key=attrgetter("total")), combination.describe(names)))
        if len(best) > 1:
            (first, label), (second, other), *_ = sorted(best, key=lambda pair: pair[0].total)
            margin = Estimate(*astuple(second)) - Estimate(*astuple(first))
            rows.append((group, label, *astuple(first), other, *margin.to_floats()))
    return pd.DataFrame(rows, columns=columns)


def find_differing_keys(combinations: Sequence[RankedCombination]) -> list[str]:
    """Return the fields in which complete combinations differ, or the first field."""
    complete = _list_complete(combinations)
    table = pd.DataFrame([combination.run.interpretation.as_dict() for combination in complete])
    return list(table.columns[table.nunique() > 1]) or list(table.columns[:1])


def _list_complete(combinations: Sequence[RankedCombination]) -> list[RankedCombination]:
    return [combination for combination in combinations if combination.is_complete]


def _sort_waters(matches: Sequence[BestMatch]) -> list[int]:
    """Return the indices of waters in order of increasing misfit."""
    return [int(i) for i in np.argsort([match.misfit.total for match in matches])]


MAX_DISTANCE_BARS = 6.0
"""Largest difference drawn, in tolerances; larger ones are triangles at the end."""
MAX_COMPARED = 12
"""Largest number of combinations compared with the default."""


def draw_interpretation_shifts(statements: pd.DataFrame, default: str = "splitsnow_2021") -> Figure:
    """Draw the differences of the default from all statements, and the shifts of others from it.

    Parameters
    ----------
    statements : pandas.DataFrame
        See `make_statement_table`.
    default : str
        Name of the reference set; if it is not among the combinations, the nearest one is used.
    """
    table = statements[statements.nearest_water]
    parts = dict(iter(table.groupby("combination", sort=False)))
    named = table.combination[table.set == default]
    first = named.iloc[0] if len(named) else table.combination.iloc[0]
    base = parts.pop(first).set_index("statement")
    shown = dict(list(parts.items())[:MAX_COMPARED])
    rows = np.arange(len(base))
    with use_style():
        figure, panels = make_subplots(
            1, 1 + len(shown), width=TWO_COLUMNS_INCHES, height=0.6 + 0.15 * rows.size, sharey=True,
            squeeze=False, width_ratios=[2.2, *[1.0] * len(shown)],
        )  # fmt: skip
        _draw_strip(panels[0, 0], base.distance.to_numpy(), base.stderr / base.bar, "black")
        panels[0, 0].set_title("default" if len(named) else "nearest")
        panels[0, 0].set_xlabel("ours − stated (tolerances)")
        for axes, (number, part) in zip(panels[0, 1:], shown.items(), strict=True):
            part = part.set_index("statement").loc[base.index]
            shift = (part.ours - base.ours) / base.bar
            _draw_strip(
                axes, shift.to_numpy(), np.hypot(part.stderr, base.stderr) / base.bar, SHIFT_COLOUR
            )
            axes.set_title(str(number))
        if shown:
            panels[0, (1 + len(shown)) // 2].set_xlabel("shift from the default (tolerances)")
        labels = [f"{name.replace('_', ' ')} · {row.place}: {row.ours:.3g}"
                  for name, row in base.iterrows()]  # fmt: skip
        panels[0, 0].set_yticks(rows, labels, fontsize=SMALL_FONT_PT)
        panels[0, 0].set_ylim(rows.size - 0.5, -0.5)
        notes = _make_notes(base, shown, default if len(named) else "nearest")
        n_omitted = len(parts) - len(shown)
        omitted_note = f"{n_omitted} more are in the table of statements." if n_omitted else ""
        return annotate_figure(figure, panels[0], *notes, omitted_note)


def _draw_strip(axes: Axes, value: np.ndarray, error: pd.Series | np.ndarray, colour: str) -> None:
    """Draw the differences of one combination."""
    rows = np.arange(value.size)
    axes.axvline(0.0, color="black", lw=0.6, zorder=1.0)
    inside = np.abs(value) <= MAX_DISTANCE_BARS
    errors = BAND_SIGMA * np.asarray(error)
    axes.errorbar(
        value[inside], rows[inside], xerr=errors[inside], fmt="o", ms=2, color=colour,
        elinewidth=0.7, capsize=0,
    )  # fmt: skip
    for side, marker in ((-1.0, "<"), (1.0, ">")):
        outside = rows[side * value > MAX_DISTANCE_BARS]
        axes.plot(
            np.full(outside.size, side * MAX_DISTANCE_BARS), outside, marker, ms=3, color=colour
        )
    axes.set_xlim(-1.15 * MAX_DISTANCE_BARS, 1.15 * MAX_DISTANCE_BARS)
    axes.set_xticks(
        [-0.5 * MAX_DISTANCE_BARS, 0.0, 0.5 * MAX_DISTANCE_BARS],
        [f"−{0.5 * MAX_DISTANCE_BARS:g}", "", f"{0.5 * MAX_DISTANCE_BARS:g}"],
    )
    axes.tick_params(axis="x", labelsize=SMALL_FONT_PT)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", alpha=0.25)
    axes.spines["left"].set_visible(False)


def _make_notes(base: pd.DataFrame, compared: dict[int, pd.DataFrame], set_name: str) -> list[str]:
    """Return the notes on the columns and their errors."""
    reference = dict(part.split(": ") for part in base.interpretation.iloc[0].split(", "))
    lines = []
    for number, part in compared.items():
        other = dict(item.split(": ") for item in part.interpretation.iloc[0].split(", "))
        changed = [f"{key} {value}".replace("_", " ") for key, value in other.items()
                   if value != reference[key]]  # fmt: skip
        lines.append(f"{number}: {', '.join(changed) or 'the same'}")
    bars = f"error bars: {BAND_SIGMA:g} standard errors; {INDEPENDENCE_NOTE}"
    description = "; ".join(f"{key} {value}".replace("_", " ") for key, value in reference.items())
    return [
        f"Numbers after the statements: values of the default ({set_name}: {description}); {bars}.",
        "Others, nearest first, with their changes. " + "; ".join(lines) + ".",
    ]
