"""Misfit to the statements of a paper: tolerances, effect of noise, and free choices."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.materials import make_refractive_index
from splits.media import Interpretation
from workflow.papers import interpretations as interpretation_ranking
from workflow.papers.interpretation_runs import (
    PARAMETER_EXTREMES,
    STAGES,
    STATED_NUMBERS,
    STATED_TRENDS,
    TRANSMITTANCE_FLOORS,
    WATER_TABLES,
    PublishedStatement,
    average_sectors,
    interleave_waters,
    list_extreme_pairs,
    repeat_for_waters,
)
from workflow.papers.interpretations import (
    OVERLAP_CHOICES,
    PAPER_SETS,
    STAGE_QUOTAS,
    RankedCombination,
    compute_misfit,
    expand_overlaps,
    find_choice,
    find_differing_keys,
    make_leave_out_table,
    make_ranking_table,
    make_statement_table,
    select_statements,
)

STATED_NUMBER = PublishedStatement("table3_842", "Table 3", 0.9, 0.03)
STATED_TREND = PublishedStatement("fig19_peak_60", "Fig 19", 0.0, 0.1, is_trend=True)


def test_differences_are_normalized_and_satisfied_trends_are_zero():
    assert STATED_NUMBER.normalize_difference(0.93) == pytest.approx(1.0)
    assert STATED_NUMBER.normalize_difference(0.84) == pytest.approx(-2.0)
    assert STATED_TREND.normalize_difference(0.5) == 0.0
    assert STATED_TREND.normalize_difference(-0.05) == pytest.approx(-0.5)


def test_misfit_is_unbiased_by_noise():
    random = np.random.default_rng(5)
    error, truth = 0.02, 0.95
    exact = float(STATED_NUMBER.normalize_difference(truth)) ** 2
    misfits = [
        compute_misfit([STATED_NUMBER], [value], [error])
        for value in truth + error * random.normal(size=4000)
    ]
    totals = np.array([misfit.total for misfit in misfits])
    assert totals.mean() == pytest.approx(exact, abs=4.0 * totals.std() / np.sqrt(totals.size))
    stated = np.sqrt(np.mean([misfit.stderr**2 for misfit in misfits]))
    assert stated == pytest.approx(totals.std(), rel=0.2)


def test_a_satisfied_trend_has_no_misfit():
    misfit = compute_misfit([STATED_NUMBER, STATED_TREND], [0.93, 0.2], [0.0, 0.0])
    assert misfit.total == pytest.approx(1.0) and misfit.stderr == 0.0
    assert misfit.compute_rms(2)[0] == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize("z", [0.0, 0.7, 1.5, 3.0])
def test_an_uncertain_trend_adds_to_the_error(z):
    error = 0.3
    misfit = compute_misfit([STATED_NUMBER, STATED_TREND], [0.93, z * error], [0.0, error])
    assert misfit.total == pytest.approx(1.0)
    truth = (
        z * error + error * np.random.default_rng(3).normal(size=400_000)
    ) / STATED_TREND.tolerance
    fourth = np.minimum(truth, 0.0) ** 4
    uncertainty = fourth.std() / np.sqrt(fourth.size)
    assert misfit.stderr**2 == pytest.approx(fourth.mean(), abs=4.0 * uncertainty)


def test_tolerances_are_read_from_the_table():
    table = pd.DataFrame(
        {
            "id": ["a", "b", "c"], "place": ["x"] * 3, "published": [4.0, 0.5, 0.026],
            "bar": ["3%", "0.1", np.nan], "low": [np.nan, np.nan, 0.020],
            "high": [np.nan, np.nan, 0.032],
        }
    ).set_index("id")  # fmt: skip
    statements = select_statements(table, ["a", "b", "c"])
    assert [statements[name].tolerance for name in "abc"] == pytest.approx([0.12, 0.1, 0.006])


def test_water_tables_are_interleaved():
    wavelengths = np.array([842.25, 1073.76])
    interleaved, table = interleave_waters(wavelengths)
    assert interleaved.size == 2 * len(WATER_TABLES) and (np.diff(interleaved) > 0.0).all()
    index = make_refractive_index("water", table)(interleaved).reshape(2, len(WATER_TABLES))
    coarse = make_refractive_index("water", "hale_querry_1973")(wavelengths)
    np.testing.assert_allclose(index[:, 0], coarse, rtol=1e-12)
    fine = make_refractive_index("water", "segelstein_1981")(wavelengths)
    np.testing.assert_allclose(index[:, 2], fine, rtol=1e-12)
    # Between coarse nodes of a steep table linear interpolation exceeds logarithmic interpolation.
    assert index[1, 1].imag > index[1, 0].imag > 3.0 * index[1, 2].imag


def make_free_combination(**values):
    """Return a combination with sensitivities over water tables, extreme pairs and floors."""
    combination = RankedCombination(FixedInterpretation())
    for name, rows in values.items():
        array = np.broadcast_to(np.array(rows, dtype=float), (len(WATER_TABLES), *np.shape(rows)))
        combination.values[name] = (array, np.full(array.shape, 1e-6))
    return combination


def test_free_choices_are_common_to_both_quantities():
    stated = {
        name: PublishedStatement(name, "", 0.5, 0.1) for name in ("msi_r_density", "msi_t_density")
    }
    pairs = len(list_extreme_pairs("density"))
    reflectance, transmittance = (
        np.zeros((pairs, 1)),
        np.full((pairs, len(TRANSMITTANCE_FLOORS)), 3.0),
    )
    reflectance[:2, 0], transmittance[:2, 1] = [0.5, 0.45], [0.8, 0.52]
    choice = make_free_combination(
        msi_r_density=reflectance, msi_t_density=transmittance
    ).find_best_matches(stated)[0]
    assert choice.values["msi_r_density"][0] == pytest.approx(0.45)
    assert choice.values["msi_t_density"][0] == pytest.approx(0.52)
    assert (
        choice.ranges
        == dict.fromkeys(stated, list_extreme_pairs("density")[1])
        == dict.fromkeys(stated, "100 / 400")
    )


def test_one_floor_is_common_to_all_parameters():
    names = ("msi_t_density", "msi_t_saturation")
    stated = {name: PublishedStatement(name, "", 0.5, 0.1) for name in names}
    rows = {}
    for name, best in zip(names, ([0.5, 0.6, 0.9], [0.9, 0.6, 0.5]), strict=True):
        rows[name] = np.broadcast_to(
            best, (len(list_extreme_pairs("density")), len(TRANSMITTANCE_FLOORS))
        )
    choice = make_free_combination(**rows).find_best_matches(stated)[0]
    assert choice.floor == TRANSMITTANCE_FLOORS[1] and choice.misfit.total == pytest.approx(2.0)


def test_extreme_pairs_are_named_by_their_values():
    assert list_extreme_pairs("grain_size") == ["100-200 / 900-1000"]
    assert list_extreme_pairs("facetness") == ["0-0.2 / 0.8-1"]
    assert (
        list_extreme_pairs("saturation")[:2] == ["0 / 0.1", "0 / 0.3"]
        and len(PARAMETER_EXTREMES["saturation"]) == 4
    )


def test_sectors_are_means_of_three_angles_with_correlated_errors():
    angles = np.arange(-75.0, 76.0, 7.5)
    plane = xr.Dataset(
        {"brdf": (("wavelength", "angle"), [angles**2]),
         "brdf_stderr": (("wavelength", "angle"), [np.full(angles.size, 0.3)])},
        {"wavelength": [600.0], "angle": angles},
    )  # fmt: skip
    averaged = average_sectors(plane)
    np.testing.assert_allclose(averaged.angle, np.arange(-67.5, 68.0, 22.5))
    np.testing.assert_allclose(averaged.brdf[0, -1], np.mean([60.0**2, 67.5**2, 75.0**2]))
    np.testing.assert_allclose(averaged.brdf_stderr, 0.3)


def test_overlaps_sets_both_overlap_fields():
    expanded = expand_overlaps({"entry_point": "uniform", "overlaps": "skip"})
    assert expanded == {
        "entry_point": "uniform", "overlap_with_previous_segment": "skip",
        "overlap_with_boundary": "skip",
    }  # fmt: skip
    assert expand_overlaps({"entry_point": "uniform"}) == {"entry_point": "uniform"}
    for choice in OVERLAP_CHOICES:
        interpretation = Interpretation(**expand_overlaps({"overlaps": choice}))
        assert find_choice(interpretation, "overlaps") == choice


def test_every_stage_has_statements():
    assert set(STATED_NUMBERS) | set(STATED_TRENDS) == set(STAGES) and set(STAGE_QUOTAS) <= set(
        STAGES
    )


def test_named_sets_pass_all_stages(monkeypatch):
    """Named sets are kept at any misfit, also if they differ in a field that is not varied."""

    def stage(combination):
        value = 1.0 if combination.interpretation.entry_point == "uniform" else 99.0
        return {"a": repeat_for_waters(value, 0.0)}

    monkeypatch.setattr(interpretation_ranking, "STAGES", {"first": stage, "second": stage})
    monkeypatch.setattr(interpretation_ranking, "STATED_NUMBERS", {"first": ("a",)})
    monkeypatch.setattr(interpretation_ranking, "STAGE_QUOTAS", {"second": (1, 1)})
    table = pd.DataFrame(
        {"id": ["a"], "place": ["x"], "published": [1.0], "bar": ["1"], "low": [np.nan],
         "high": [np.nan]}
    ).set_index("id")  # fmt: skip
    choices = {"entry_point": ["uniform", "projected"], "facet_sampling": ["projected", "any"]}
    ranked, stated = interpretation_ranking.rank_interpretations(
        table, choices, {"entry_point": "uniform"}
    )
    # Uniform entry with any facet equals splitsnow_2021, whose other fields are the defaults.
    assert len(ranked) == 4 + len(PAPER_SETS) - 1 and set(stated) == {"a"}
    complete = [combination for combination in ranked if combination.n_stages == 2]
    assert {combination.find_set_name() for combination in complete} == {"", *PAPER_SETS}
    assert ranked[0].min_misfit == 0.0 and ranked[-1].n_stages == 1


class FixedInterpretation:
    """A run that has an interpretation only."""

    def __init__(self, **interpretation):
        self.interpretation = Interpretation(**interpretation)


def make_combination(value, stages=10, **interpretation):
    """Return a combination whose values deviate by a multiple of the tolerance."""
    combination = RankedCombination(FixedInterpretation(**interpretation))
    combination.n_stages, combination.min_misfit = stages, value**2
    values = STATED_NUMBER.published + value * STATED_NUMBER.tolerance * np.array([2.0, 1.0, 3.0])
    combination.values = {"table3_842": (values, np.zeros(len(WATER_TABLES)))}
    return combination


def test_ranking_tables_list_all_combinations():
    stated = {"table3_842": STATED_NUMBER}
    best, second = make_combination(0.5), make_combination(1.0, entry_point="projected")
    dropped = make_combination(0.1, stages=2, facet_sampling="projected")
    combinations = [best, second, dropped]
    choices, text_choices = {"entry_point": ["uniform", "projected"], "overlaps": ["reject"]}, {
        "entry_point": "uniform"
    }  # fmt: skip
    table = make_ranking_table(combinations, stated, choices, text_choices)
    assert list(table["rank"]) == [*range(1, 7), 0]
    assert table.misfit[0] == pytest.approx(0.25) and table.water[0] == WATER_TABLES[1]
    assert list(table.text[:2]) == [True, True] and table.stages.iloc[-1] == 2
    names = find_differing_keys(combinations)
    assert names == ["entry_point"]
    statements = make_statement_table(combinations, stated, names)
    assert statements.nearest_water.sum() == 2 and len(statements) == 6
    assert set(statements.interpretation) == {"entry_point: uniform", "entry_point: projected"}
    leave_out = make_leave_out_table(combinations, stated, names)
    assert leave_out["first"].iloc[0] == "entry_point: uniform"
    assert leave_out.margin.iloc[0] == pytest.approx(0.75)


def test_tables_with_one_complete_combination_have_no_margin():
    combination = make_combination(0.5)
    assert find_differing_keys([combination, make_combination(0.1, stages=2)]) == [
        next(iter(Interpretation().as_dict()))
    ]
    leave_out = make_leave_out_table([combination], {"table3_842": STATED_NUMBER}, ["entry_point"])
    assert leave_out.empty and "margin" in leave_out
