"""The section `retrieve`: validation, retrieval of samples, and the figure."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from formula_tables import W, evaluate_spectrum, make_snowlike_table
from pydantic import ValidationError

import splits
from splits.core.validation import InvalidValue
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.load import validate_content
from splits.experiments.config.retrieval import NoiseSection, RetrieveSection
from splits.experiments.run_retrieve import (
    combine_samples,
    get_fixed_values,
    make_retrieval_table,
    run_retrieve,
    select_spectra,
)
from splits.plotting.grammar import save_figure
from splits.plotting.retrieval import draw_retrievals

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
SECTION = {
    "measured": "some.csv",
    "free": [SIZE, SOOT],
    "noise": {"relative": 0.01, "absolute": 0.002, "correlation_nm": 50},
}
TABLE = {
    "name": "some",
    "medium": {"kind": "natural_snow"},
    "instrument": {"kind": "table", "wavelength_nm": [500, 900]},
    "grid": {SIZE: [50, 100], SOOT: [0, 100]},
    "retrieve": SECTION,
}


def index_by_sample(retrievals):
    """Return the retrieval results by the names of their samples."""
    return {retrieval.sample: retrieval.result for retrieval in retrievals}


def make_measured():
    """Return a table of two samples, the first of which is nearly clean."""
    return pd.DataFrame(
        {
            "wavelength_nm": [400.0, *W],
            "clean@30": [0.5, *evaluate_spectrum(150.0, 1.0)],
            "dirty@60": [0.5, *evaluate_spectrum(600.0, 400.0)],
        }
    )


def test_samples_are_retrieved_within_the_table_range():
    section = RetrieveSection.model_validate(SECTION)
    results = index_by_sample(run_retrieve(section, make_snowlike_table(), make_measured()))
    assert list(results) == ["clean@30", "dirty@60"]
    for name, size in (("clean@30", 150.0), ("dirty@60", 600.0)):
        assert results[name].dataset.sizes["wavelength"] == W.size
        assert abs(results[name].values[SIZE] - size) < 4.0 * results[name].stderr[SIZE]


def test_excluded_wavelengths_are_not_used():
    section = RetrieveSection.model_validate({**SECTION, "exclude_nm": [[650, 850]]})
    dataset = index_by_sample(run_retrieve(section, make_snowlike_table(), make_measured()))[
        "dirty@60"
    ].dataset
    assert dataset.wavelength.values.tolist() == [500, 600, 900, 1000, 1100, 1200, 1300, 1400, 1500]


def test_the_first_sample_gives_the_prior_of_others():
    table = {k: make_measured()[k] for k in ("wavelength_nm", "clean@30")}
    table["wetter@30"] = [0.5, *evaluate_spectrum(150.0, 400.0)]
    content = {**SECTION, "prior_from": {"sample": "clean@30", "fixed": {SOOT: 1.0}}}
    retrievals = run_retrieve(
        RetrieveSection.model_validate(content), make_snowlike_table(), pd.DataFrame(table)
    )
    results = index_by_sample(retrievals)
    assert list(results["clean@30"].values) == [SIZE]
    section = RetrieveSection.model_validate(SECTION)
    plain = index_by_sample(run_retrieve(section, make_snowlike_table(), pd.DataFrame(table)))
    assert results["wetter@30"].stderr[SIZE] < plain["wetter@30"].stderr[SIZE]
    assert list(combine_samples(retrievals, "some").sample.values) == ["wetter@30"]
    table["other@30"] = table["wetter@30"]
    content["prior_from"] |= {"applies_to": "other"}
    section = RetrieveSection.model_validate(content)
    selected = index_by_sample(run_retrieve(section, make_snowlike_table(), pd.DataFrame(table)))
    assert selected["wetter@30"].stderr == plain["wetter@30"].stderr
    assert selected["other@30"].stderr == results["wetter@30"].stderr


def test_every_sample_is_retrieved_with_every_model():
    """A biased model has a larger misfit, in particular at the reference values."""
    right = make_snowlike_table().dataset
    wrong = right.assign(reflectance=right.reflectance * (1.0 - 1e-4 * right.wavelength))
    dataset = xr.concat([right, wrong], xr.IndexVariable("interpretation", ["right", "wrong"]))
    content = {
        **SECTION,
        "model_axis": "interpretation",
        "reference_values": {SIZE: {"dirty@60": 600.0}},
    }
    retrievals = run_retrieve(
        RetrieveSection.model_validate(content), splits.Table(dataset), make_measured()
    )
    assert [(retrieval.model, retrieval.sample) for retrieval in retrievals] == [
        (model, sample) for model in ("right", "wrong") for sample in ("clean@30", "dirty@60")
    ]  # fmt: skip
    assert np.isnan(retrievals[0].reference_chi2)
    for retrieval in retrievals[1::2]:
        assert retrieval.reference_chi2 >= retrieval.result.dataset.attrs["chi2"] - 1e-6
    assert retrievals[3].reference_chi2 > 2.0 * retrievals[1].reference_chi2
    joined = combine_samples(retrievals, "some")
    assert joined.sizes["model"] == 2 and joined.sizes["sample"] == 2
    assert make_retrieval_table(
        retrievals, content["reference_values"]
    ).model.unique().tolist() == [
        "right",
        "wrong",
    ]


def test_tables_and_figures_show_all_samples(tmp_path):
    retrievals = run_retrieve(
        RetrieveSection.model_validate(SECTION), make_snowlike_table(), make_measured()
    )
    reference_values = {SIZE: {"clean@30": 150.0, "dirty@60": 600.0}}
    table = make_retrieval_table(retrievals, reference_values)
    assert len(table) == 4
    sizes = table[table.parameter == SIZE]
    assert sizes["reference value"].tolist() == [150.0, 600.0]
    assert (sizes["2.5 %"] < sizes["median"]).all() and (sizes["median"] < sizes["97.5 %"]).all()
    assert sizes["constrained"].tolist() == ["yes", "yes"]
    for path in save_figure(
        draw_retrievals(combine_samples(retrievals, "some"), reference_values), tmp_path / "figure"
    ):
        assert path.stat().st_size > 10_000


INVALID_SECTIONS = {
    "no noise": ({"noise": {}}, "noise.absolute"),
    "one number": ({"noise": 0.01}, r"retrieve\.noise = 0.01: must be a mapping such as"),
    "negative noise": ({"noise": {"relative": -0.1}}, "noise.relative"),
    "interval": ({"exclude_nm": [[900, 800]]}, "low < high"),
    "folder": ({"measured": "../some.csv"}, "without folders"),
}


@pytest.mark.parametrize("name", INVALID_SECTIONS)
def test_invalid_sections_are_rejected(name):
    changes, message = INVALID_SECTIONS[name]
    with pytest.raises(ValueError, match=message):
        validate_content(ExperimentConfig, {**TABLE, "retrieve": SECTION | changes})


ASYMPTOTIC_MODEL = {"compare_with": "kokhanovsky_zege_2004"}
NAMED_INTERPRETATIONS = {**TABLE["grid"], "interpretation": {"one": {}, "other": "geometric"}}
EXPERIMENT_ERRORS = {
    "models of numbers": (
        {"retrieve": {**SECTION, "model_axis": SIZE}},
        r"retrieve\.model_axis = .*no axis",
    ),
    "models and fixed": (
        {
            "grid": NAMED_INTERPRETATIONS,
            "retrieve": {
                **SECTION,
                "model_axis": "interpretation",
                "fixed": {"interpretation": "one"},
            },
        },
        r"retrieve\.fixed\.interpretation",
    ),
    "no such model axis": (
        {"grid": NAMED_INTERPRETATIONS, "retrieve": {**SECTION, "model_axis": "reading"}},
        "one of interpretation",
    ),
    "asymptotic model of sand": (
        {
            "medium": {"kind": "sand"},
            "grid": {"saturation": [0, 1], "porosity": [0.3, 0.4]},
            "retrieve": {**SECTION, **ASYMPTOTIC_MODEL, "free": ["saturation", "porosity"]},
        },
        "left out for media other than snow",
    ),
    "asymptotic model of shallow snow": (
        {
            "medium": {**TABLE["medium"], "depth_m": 0.1},
            "retrieve": {**SECTION, **ASYMPTOTIC_MODEL},
        },
        "depth_m",
    ),
    "asymptotic model of wet snow": (
        {
            "medium": {**TABLE["medium"], "liquid_water_content": 0.1},
            "retrieve": {**SECTION, **ASYMPTOTIC_MODEL},
        },
        "liquid_water_content",
    ),
    "no table": ({"instrument": {"kind": "spectrophotometer"}}, "table with a section retrieve"),
    "no such axis": ({"retrieve": {**SECTION, "free": ["depth_m"]}}, "retrieve.free"),
    "prior of an unknown parameter": (
        {"retrieve": {**SECTION, "prior": {"depth_m": [1, 1]}}},
        "retrieve.prior",
    ),
    "a figure of its own": ({"figure": {"kind": "summary"}}, "shows the retrieved parameters"),
    "transmittance only": (
        {"instrument": {**TABLE["instrument"], "quantities": ["transmittance"]}},
        "with reflectance",
    ),
}


@pytest.mark.parametrize("name", EXPERIMENT_ERRORS)
def test_invalid_experiments_are_rejected(name):
    changes, message = EXPERIMENT_ERRORS[name]
    with pytest.raises((ValidationError, InvalidValue), match=message):
        ExperimentConfig.model_validate(TABLE | changes)


SAMPLE_ERRORS = {
    "unused prefix": (
        [{"sample": "clean@30", "fixed": {SOOT: 1}, "applies_to": "dusty"}],
        r"prior_from\.applies_to",
    ),
    "twice": ([{"sample": "clean@30", "fixed": {SOOT: 1}}] * 2, "different samples"),
    "all": (
        [{"sample": s, "fixed": {SOOT: 1}} for s in ("clean@30", "dirty@60")],
        "others than those of prior_from",
    ),
}


@pytest.mark.parametrize("name", SAMPLE_ERRORS)
def test_unused_first_samples_are_rejected(name):
    prior_from, message = SAMPLE_ERRORS[name]
    section = RetrieveSection.model_validate({**SECTION, "prior_from": prior_from})
    with pytest.raises(InvalidValue, match=message):
        run_retrieve(section, make_snowlike_table(), make_measured())


def test_missing_samples_are_rejected():
    section = RetrieveSection.model_validate({**SECTION, "samples": ["snow"]})
    with pytest.raises(InvalidValue, match=r"retrieve\.samples"):
        select_spectra(section, make_measured(), W)
    with pytest.raises(InvalidValue, match="column wavelength_nm"):
        select_spectra(
            RetrieveSection.model_validate(SECTION),
            make_measured().drop(columns="wavelength_nm"),
            W,
        )
    with pytest.raises(InvalidValue, match="the range of the table"):
        select_spectra(RetrieveSection.model_validate(SECTION), make_measured(), 1100.0 + W)


RETRIEVAL_ERRORS = {
    "per cent": ({"some": 50.0}, {}, "not per cent"),
    "a gap": ({"some": np.nan}, {}, "gaps"),
    "no name": ({"Unnamed: 0": 0.5}, {}, "without a name"),
    "too few for unknown noise": ({"some": 0.5}, {"noise": None},
                                  r"^retrieve \(some\)\.noise = None: must be given"),
    "fixed and free": ({"some": 0.5}, {"fixed": {SIZE: 50, "incidence_deg": 30}},
                       rf"retrieve \(some\)\.fixed\.{SIZE}"),
    "not fixed": ({"some": 0.5}, {"free": [SIZE]}, rf"retrieve \(some\)\.fixed\.{SOOT} = None"),
    "scale only": ({"some": 0.5},
                   {"free": ["scale"], "fixed": {SIZE: 100, SOOT: 0, "incidence_deg": 30}},
                   r"free = .*at least one axis"),
    "prior outside": ({"some": 0.5}, {"prior": {SIZE: [1e6, 1.0]}}, rf"prior\.{SIZE}"),
    "first outside": ({"some": 0.5, "other": 0.5},
                      {"prior_from": {"sample": "other", "fixed": {SIZE: 1e6}}}, SIZE),
    "nothing free": ({"some": 0.5, "other": 0.5},
                     {"prior_from": {"sample": "other", "fixed": {SIZE: 100, SOOT: 0}}},
                     r"retrieve \(other\)\.free"),
}  # fmt: skip


@pytest.mark.parametrize("name", RETRIEVAL_ERRORS)
def test_retrievals_reject_what_the_table_does_not_allow(name):
    samples, changes, message = RETRIEVAL_ERRORS[name]
    fixed = {"fixed": {"incidence_deg": 30}}
    section = RetrieveSection.model_validate(SECTION | fixed | changes)
    table = pd.DataFrame({"wavelength_nm": [500.0, 900.0], **samples})
    with pytest.raises(InvalidValue, match=message):
        run_retrieve(section, make_snowlike_table(), table)


def test_unknown_noise_is_estimated_from_the_misfit():
    section = RetrieveSection.model_validate({**SECTION, "noise": None})
    for retrieval in run_retrieve(section, make_snowlike_table(), make_measured()):
        assert retrieval.result.dataset.attrs["noise"] == "found from the misfit"
        assert np.isnan(retrieval.reference_chi2)


def test_an_invalid_angle_is_rejected():
    with pytest.raises(InvalidValue, match="an angle after @"):
        table = SimpleNamespace(axes=["incidence_deg"])
        get_fixed_values(RetrieveSection.model_validate(SECTION), "snow@noon", table)


def test_noise_is_added_in_quadrature_unless_it_is_correlated():
    values = np.array([0.5, 0.1])
    independent = NoiseSection(absolute=0.003, relative=0.01).evaluate(values)
    np.testing.assert_allclose(independent, np.hypot(0.003, 0.01 * values))
    correlated = NoiseSection(absolute=0.003, relative=0.01, correlation_nm=100).evaluate(values)
    assert correlated["independent"] == 0.003
