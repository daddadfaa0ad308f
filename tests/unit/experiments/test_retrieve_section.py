"""The section `retrieve`: validation, retrieval of samples, and the figure."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from formula_tables import W, evaluate_spectrum, make_snowlike_table
from pydantic import ValidationError

import splits
from splits.core.validation import InvalidValue
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.retrieve import NoiseSection, RetrieveSection
from splits.experiments.config.retrieve_checks import check_measured_spectra
from splits.experiments.run_retrieve import combine_samples, make_retrieval_table, run_retrieve
from splits.plotting.retrieval import draw_retrievals
from splits.plotting.style import save_figure

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
    """Return what samples tell by their names."""
    return {one.sample: one.result for one in retrievals}


def measured():
    """Return a table of two samples, the first of which is hardly dirty."""
    return pd.DataFrame(
        {
            "wavelength_nm": [400.0, *W],
            "clean@30": [0.5, *evaluate_spectrum(150.0, 1.0)],
            "dirty@60": [0.5, *evaluate_spectrum(600.0, 400.0)],
        }
    )


def test_samples_are_retrieved_where_the_table_reaches():
    section = RetrieveSection.model_validate(SECTION)
    found = index_by_sample(run_retrieve(section, make_snowlike_table(), measured()))
    assert list(found) == ["clean@30", "dirty@60"]
    for name, size in (("clean@30", 150.0), ("dirty@60", 600.0)):
        assert found[name].dataset.sizes["wavelength"] == W.size
        assert abs(found[name].values[SIZE] - size) < 4.0 * found[name].stderr[SIZE]


def test_excluded_wavelengths_do_not_count():
    section = RetrieveSection.model_validate({**SECTION, "exclude_nm": [[650, 850]]})
    found = index_by_sample(run_retrieve(section, make_snowlike_table(), measured()))[
        "dirty@60"
    ].dataset
    assert found.wavelength.values.tolist() == [500, 600, 900, 1000, 1100, 1200, 1300, 1400, 1500]


def test_the_first_sample_gives_the_prior_of_others():
    table = {k: measured()[k] for k in ("wavelength_nm", "clean@30")}
    table["wetter@30"] = [0.5, *evaluate_spectrum(150.0, 400.0)]
    given = {**SECTION, "prior_from": {"sample": "clean@30", "fixed": {SOOT: 1.0}}}
    interpretation = run_retrieve(
        RetrieveSection.model_validate(given), make_snowlike_table(), pd.DataFrame(table)
    )
    found = index_by_sample(interpretation)
    assert list(found["clean@30"].values) == [SIZE]
    section = RetrieveSection.model_validate(SECTION)
    plain = index_by_sample(run_retrieve(section, make_snowlike_table(), pd.DataFrame(table)))
    assert found["wetter@30"].stderr[SIZE] < plain["wetter@30"].stderr[SIZE]
    assert list(combine_samples(interpretation, "some").sample.values) == ["wetter@30"]
    table["other@30"] = table["wetter@30"]
    given["prior_from"] |= {"applies_to": "other"}
    section = RetrieveSection.model_validate(given)
    alone = index_by_sample(run_retrieve(section, make_snowlike_table(), pd.DataFrame(table)))
    assert alone["wetter@30"].stderr == plain["wetter@30"].stderr
    assert alone["other@30"].stderr == found["wetter@30"].stderr


def test_every_sample_is_read_with_every_model():
    """Of a model whose light is wrong the misfit is larger, and larger still at what is known."""
    right = make_snowlike_table().dataset
    wrong = right.assign(reflectance=right.reflectance * (1.0 - 1e-4 * right.wavelength))
    both = xr.concat([right, wrong], xr.IndexVariable("interpretation", ["right", "wrong"]))
    given = {
        **SECTION,
        "model_axis": "interpretation",
        "reference_values": {SIZE: {"dirty@60": 600.0}},
    }
    found = run_retrieve(RetrieveSection.model_validate(given), splits.Table(both), measured())
    assert [(one.model, one.sample) for one in found] == [
        (model, sample) for model in ("right", "wrong") for sample in ("clean@30", "dirty@60")
    ]  # fmt: skip
    assert np.isnan(found[0].reference_chi2)
    for one in found[1::2]:
        assert one.reference_chi2 >= one.result.dataset.attrs["chi2"] - 1e-6
    assert found[3].reference_chi2 > 2.0 * found[1].reference_chi2
    joined = combine_samples(found, "some")
    assert joined.sizes["model"] == 2 and joined.sizes["sample"] == 2
    assert make_retrieval_table(found, given["reference_values"]).model.unique().tolist() == [
        "right",
        "wrong",
    ]


def test_tables_and_figures_show_all_samples(tmp_path):
    found = run_retrieve(RetrieveSection.model_validate(SECTION), make_snowlike_table(), measured())
    known = {SIZE: {"clean@30": 150.0, "dirty@60": 600.0}}
    table = make_retrieval_table(found, known)
    assert len(table) == 4
    sizes = table[table.parameter == SIZE]
    assert sizes["reference value"].tolist() == [150.0, 600.0]
    assert (sizes["2.5 %"] < sizes["median"]).all() and (sizes["median"] < sizes["97.5 %"]).all()
    assert sizes["constrained"].tolist() == ["yes", "yes"]
    for path in save_figure(
        draw_retrievals(combine_samples(found, "some"), known), tmp_path / "figure"
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
    other, message = INVALID_SECTIONS[name]
    with pytest.raises((ValidationError, InvalidValue), match=message):
        RetrieveSection.model_validate(SECTION | other)


LAW = {"compare_with": "kokhanovsky_zege_2004"}
NAMED_SAMPLES = {**TABLE["grid"], "interpretation": {"one": {}, "other": "geometric"}}
EXPERIMENT_ERRORS = {
    "models of numbers": (
        {"retrieve": {**SECTION, "model_axis": SIZE}},
        r"retrieve\.model_axis = .*no axis",
    ),
    "models and at": (
        {
            "grid": NAMED_SAMPLES,
            "retrieve": {
                **SECTION,
                "model_axis": "interpretation",
                "fixed": {"interpretation": "one"},
            },
        },
        r"retrieve\.fixed\.interpretation",
    ),
    "no such model axis": (
        {"grid": NAMED_SAMPLES, "retrieve": {**SECTION, "model_axis": "reading"}},
        "one of interpretation",
    ),
    "known beyond the table": (
        {"retrieve": {**SECTION, "reference_values": {SIZE: {"some": 200}}}},
        "50 to 100",
    ),
    "first sample beyond the table": (
        {"retrieve": {**SECTION, "prior_from": {"sample": "some", "fixed": {SIZE: 10}}}},
        "50 to 100",
    ),
    "nothing left of the first": (
        {"retrieve": {**SECTION, "prior_from": {"sample": "a", "fixed": {SIZE: 60, SOOT: 0}}}},
        "not all of retrieve.free",
    ),
    "law of sand": (
        {
            "medium": {"kind": "sand"},
            "grid": {"saturation": [0, 1], "porosity": [0.3, 0.4]},
            "retrieve": {**SECTION, **LAW, "free": ["saturation", "porosity"]},
        },
        "left out for media other than snow",
    ),
    "law of shallow snow": (
        {"medium": {**TABLE["medium"], "depth_m": 0.1}, "retrieve": {**SECTION, **LAW}},
        "depth_m",
    ),
    "law of wet snow": (
        {
            "medium": {**TABLE["medium"], "liquid_water_content": 0.1},
            "retrieve": {**SECTION, **LAW},
        },
        "liquid_water_content",
    ),
    "no table": ({"instrument": {"kind": "spectrophotometer"}}, "table with a section retrieve"),
    "no such axis": ({"retrieve": {**SECTION, "free": ["depth_m"]}}, "retrieve.free"),
    "prior of what is not there": (
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
    other, message = EXPERIMENT_ERRORS[name]
    with pytest.raises((ValidationError, InvalidValue), match=message):
        ExperimentConfig.model_validate(TABLE | other)


SAMPLE_ERRORS = {
    "begins no name": (
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
    first, message = SAMPLE_ERRORS[name]
    section = RetrieveSection.model_validate({**SECTION, "prior_from": first})
    with pytest.raises(InvalidValue, match=message):
        run_retrieve(section, make_snowlike_table(), measured())


def test_missing_samples_are_rejected():
    section = RetrieveSection.model_validate({**SECTION, "samples": ["snow"]})
    with pytest.raises(InvalidValue, match=r"retrieve\.samples"):
        section.select_spectra(measured(), W)
    with pytest.raises(InvalidValue, match="column wavelength_nm"):
        RetrieveSection.model_validate(SECTION).select_spectra(
            measured().drop(columns="wavelength_nm"), W
        )
    with pytest.raises(InvalidValue, match="the range of the table"):
        RetrieveSection.model_validate(SECTION).select_spectra(measured(), 1100.0 + W)


SPECTRA = {
    "per cent": ("some", [50.0, 60.0], "not per cent"),
    "a gap": ("some", [0.5, np.nan], "gaps"),
    "no name": ("Unnamed: 0", [0.5, 0.6], "without a name"),
    "no angle": ("plain", [0.5, 0.6], "its angle in the name, plain@50"),
    "an angle beyond the table": ("some@80", [0.5, 0.6], "incidence_deg = 80"),
}


@pytest.mark.parametrize("name", SPECTRA)
def test_spectra_are_checked_before_anything_runs(name):
    sample, values, message = SPECTRA[name]
    grid = {**TABLE["grid"], "incidence_deg": [0, 60]}
    at = {} if "@" in sample or sample == "plain" else {"incidence_deg": 30}
    experiment = ExperimentConfig.model_validate(
        TABLE | {"grid": grid, "retrieve": {**SECTION, "fixed": at}}
    )
    table = pd.DataFrame({"wavelength_nm": [500.0, 900.0], sample: values})
    with pytest.raises(InvalidValue, match=message):
        check_measured_spectra(experiment, experiment.retrieve, table)


def test_without_noise_the_misfit_gives_the_errors():
    section = RetrieveSection.model_validate({**SECTION, "noise": None})
    for reading in run_retrieve(section, make_snowlike_table(), measured()):
        assert reading.result.dataset.attrs["noise"] == "found from the misfit"
        assert np.isnan(reading.reference_chi2)


def test_an_invalid_angle_is_rejected():
    with pytest.raises(InvalidValue, match="an angle after @"):
        RetrieveSection.model_validate(SECTION).get_fixed_values("snow@noon", ["incidence_deg"])


def test_noise_is_added_in_quadrature_unless_it_is_correlated():
    values = np.array([0.5, 0.1])
    plain = NoiseSection(absolute=0.003, relative=0.01).evaluate(values)
    np.testing.assert_allclose(plain, np.hypot(0.003, 0.01 * values))
    both = NoiseSection(absolute=0.003, relative=0.01, correlation_nm=100).evaluate(values)
    assert both["independent"] == 0.003


def test_too_few_wavelengths_to_estimate_the_noise_are_rejected_when_the_file_is_read():
    section = {key: value for key, value in SECTION.items() if key != "noise"}
    experiment = ExperimentConfig.model_validate(TABLE | {"retrieve": section})
    few = pd.DataFrame({"wavelength_nm": [500, 700, 900], "a": [0.9, 0.8, 0.5]})
    line = r"^retrieve \(a\)\.noise = None: must be given \(3 values are too few to estimate it"
    with pytest.raises(ValueError, match=line):
        check_measured_spectra(experiment, experiment.retrieve, few)


@pytest.mark.parametrize(
    ("section", "line"),
    [
        ({"fixed": {SIZE: 50}}, r"retrieve\.fixed\.optical_radius_um = 50.0: must be left out"),
        (
            {"free": ["scale"], "fixed": {SIZE: 50, SOOT: 0}},
            r"retrieve\.free = .*at least one para",
        ),
    ],
)
def test_errors_of_retrievals_are_raised_when_the_file_is_read(section, line):
    with pytest.raises(ValueError, match=line):
        ExperimentConfig.model_validate(TABLE | {"retrieve": SECTION | section})
