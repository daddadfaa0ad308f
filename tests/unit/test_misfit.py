"""Misfit to what a paper states: distances in bars, what noise adds, and free choices."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from splits.analysis.misfit import Statement, misfit, numbers_stated
from splits.experiments.published_snow import NUMBERS, STAGES, TRENDS, WATERS, beside
from splits.experiments.rank_readings import TAKEN, Combination, chosen, spelt_out
from splits.experiments.ranking_tables import left_out, ranking, statements, telling
from splits.materials import refractive_index
from splits.media import Readings

NUMBER = Statement("table3_842", "Table 3", 0.9, 0.03)
TREND = Statement("fig19_peak_60", "Fig 19", 0.0, 0.1, trend=True)


def test_distances_are_in_bars_and_trends_count_where_they_fail():
    assert NUMBER.distance(0.93) == pytest.approx(1.0)
    assert NUMBER.distance(0.84) == pytest.approx(-2.0)
    assert TREND.distance(0.5) == 0.0
    assert TREND.distance(-0.05) == pytest.approx(-0.5)


def test_noise_adds_nothing_on_average():
    random = np.random.default_rng(5)
    error, truth = 0.02, 0.95
    exact = float(NUMBER.distance(truth)) ** 2
    found = [
        misfit([NUMBER], [value], [error]) for value in truth + error * random.normal(size=4000)
    ]
    totals = np.array([one.total for one in found])
    assert totals.mean() == pytest.approx(exact, abs=4.0 * totals.std() / np.sqrt(totals.size))
    stated = np.sqrt(np.mean([one.stderr**2 for one in found]))
    assert stated == pytest.approx(totals.std(), rel=0.2)


def test_a_trend_that_holds_adds_nothing():
    one = misfit([NUMBER, TREND], [0.93, 0.2], [0.0, 0.3])
    assert one.total == pytest.approx(1.0) and one.stderr == 0.0
    assert one.rms(2)[0] == pytest.approx(np.sqrt(0.5))


def test_bars_are_those_of_the_table():
    table = pd.DataFrame(
        {
            "id": ["a", "b", "c"], "place": ["x"] * 3, "published": [4.0, 0.5, 0.026],
            "bar": ["3%", "0.1", np.nan], "low": [np.nan, np.nan, 0.020],
            "high": [np.nan, np.nan, 0.032],
        }
    ).set_index("id")  # fmt: skip
    found = numbers_stated(table, ["a", "b", "c"])
    assert [found[name].bar for name in "abc"] == pytest.approx([0.12, 0.1, 0.006])


def test_waters_stand_side_by_side():
    wavelengths = np.array([842.25, 1073.76])
    places, table = beside(wavelengths)
    assert places.size == 2 * len(WATERS) and (np.diff(places) > 0.0).all()
    made = refractive_index("water", table)(places).reshape(2, len(WATERS))
    hale = refractive_index("water", "hale_querry_1973")(wavelengths)
    np.testing.assert_allclose(made[:, 0], hale, rtol=1e-12)
    finer = refractive_index("water", "segelstein_1981")(wavelengths)
    np.testing.assert_allclose(made[:, 2], finer, rtol=1e-12)
    # Between coarse rows of a steep table a straight line lies above the logarithm's.
    assert made[1, 1].imag > made[1, 0].imag > 3.0 * made[1, 2].imag


def test_what_is_free_is_chosen_for_both_quantities_together():
    stated = {name: Statement(name, "", 0.5, 0.1) for name in ("msi_r_density", "msi_t_density")}
    shape = (len(WATERS), 2, 1)
    reflectance = np.zeros(shape)
    reflectance[:, 0], reflectance[:, 1] = 0.5, 0.45
    transmittance = np.zeros((len(WATERS), 2, 2))
    transmittance[:, 0], transmittance[:, 1] = [0.9, 0.8], [0.7, 0.52]
    found = {
        "msi_r_density": (reflectance, 0.01 * np.ones(shape)),
        "msi_t_density": (transmittance, np.ones(transmittance.shape)),
        "other": (np.ones(len(WATERS)), np.ones(len(WATERS))),
    }
    got = chosen(found, stated)
    np.testing.assert_allclose(got["msi_r_density"][0], 0.45)
    np.testing.assert_allclose(got["msi_t_density"][0], 0.52)
    np.testing.assert_allclose(got["other"][0], 1.0)


def test_boundaries_stand_for_both_kinds_of_grains_that_do_not_fit():
    found = spelt_out({"entry": "uniform", "boundaries": "skip"})
    assert found == {
        "entry": "uniform", "grain_on_last_leg": "skip", "grain_across_boundary": "skip",
    }  # fmt: skip


def test_every_stage_states_something():
    assert set(NUMBERS) | set(TRENDS) == set(STAGES) and set(TAKEN) <= set(STAGES)


class Told:
    """In place of a trial."""

    def __init__(self, **readings):
        self.readings = Readings(**readings)


def combination(value, stages=10, **readings):
    """Return a combination whose values are all so far off, in bars."""
    one = Combination(Told(**readings))
    one.added = [np.full(len(WATERS), value**2)] * stages
    away = NUMBER.published + value * NUMBER.bar * np.array([2.0, 1.0, 3.0])
    one.values = {"table3_842": (away, np.zeros(len(WATERS)))}
    return one


def test_tables_of_a_ranking():
    stated = {"table3_842": NUMBER}
    near, far = combination(0.5), combination(1.0, entry="projected")
    dropped = combination(0.1, stages=2, facets="projected")
    all_ = [near, far, dropped]
    choices, text = {"entry": ["uniform", "projected"], "boundaries": ["reject"]}, {
        "entry": "uniform"
    }  # fmt: skip
    table = ranking(all_, stated, choices, text)
    assert list(table["rank"]) == [*range(1, 7), 0]
    assert table.misfit[0] == pytest.approx(0.25) and table.water[0] == WATERS[1]
    assert list(table.text[:2]) == [True, True] and table.stages.iloc[-1] == 2
    names = telling(all_)
    assert names == ["entry"]
    listed = statements(all_, stated, names)
    assert listed.nearest_water.sum() == 2 and len(listed) == 6
    assert set(listed.readings) == {"entry: uniform", "entry: projected"}
    without = left_out(all_, stated, names)
    assert without["first"].iloc[0] == "entry: uniform"
    assert without.margin.iloc[0] == pytest.approx(0.75)
