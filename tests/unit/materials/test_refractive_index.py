"""Refractive indices: specifications, datasets, and mixtures."""

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from splits.experiments import ExperimentConfig
from splits.materials import (
    MIXING_RULES,
    ConstantIndex,
    absorption_coefficient,
    linear_mixing,
    list_datasets,
    make_refractive_index,
    maxwell_garnett,
)
from splits.media import Snow

TABULATED = ("ice", "water", "hematite", "magnetite")
NAMED = [(material, name) for material in TABULATED for name in list_datasets(material)]
TABLE = {"wavelength_nm": [400.0, 800.0, 1600.0], "n": [1.3, 1.4, 1.2], "k": [1e-8, 1e-4, 1e-2]}
CSV = "# made up\nwavelength_nm, n, k\n400, 1.3, 1e-8\n800, 1.4, 1e-4\n1600, 1.2, 1e-2\n"
# Rows as printed in the sources of the tables: wavelength (nm), n, k.
PUBLISHED = [
    ("ice", "warren_brandt_2008", 600.0, 1.3094, 5.73e-9),
    ("ice", "warren_brandt_2008", 1000.0, 1.3015, 1.62e-6),
    ("water", "hale_querry_1973", 500.0, 1.335, 1.0e-9),
    ("water", "hale_querry_1973", 1000.0, 1.327, 2.89e-6),
    ("hematite", "querry_1985_ordinary", 550.0, 3.318, 0.498),
    ("hematite", "querry_1985_extraordinary", 650.0, 2.753, 0.103),
    ("magnetite", "querry_1985", 700.0, 2.355, 0.124),
]


@pytest.mark.parametrize(("material", "name"), NAMED)
def test_datasets_are_exact_at_their_nodes(material, name):
    table = make_refractive_index(material, name)
    index = table(table.wavelength_nm)
    np.testing.assert_allclose(index.real, table.n, rtol=1e-14)
    np.testing.assert_allclose(index.imag, table.k, rtol=1e-12)
    assert table.name == name
    assert re.search(r"\b(19|20)\d\d\b", table.source), "the source names a year"


@pytest.mark.parametrize(("material", "name", "wavelength", "n", "k"), PUBLISHED)
def test_datasets_contain_published_rows(material, name, wavelength, n, k):
    index = complex(make_refractive_index(material, name)(wavelength))
    assert index.real == pytest.approx(n, abs=6e-4)
    assert index.imag == pytest.approx(k, rel=5e-3)


@pytest.mark.parametrize("material", TABULATED)
def test_default_is_the_first_dataset(material):
    assert make_refractive_index(material) is make_refractive_index(
        material, list_datasets(material)[0]
    )


@pytest.mark.parametrize(("material", "name"), NAMED)
def test_interpolation_is_linear_in_log_wavelength(material, name):
    table = make_refractive_index(material, name)
    w, n, k = table.wavelength_nm, table.n, table.k
    index = table(np.sqrt(w[1:] * w[:-1]))
    np.testing.assert_allclose(index.real, 0.5 * (n[1:] + n[:-1]), rtol=1e-12)
    np.testing.assert_allclose(index.imag, np.sqrt(k[1:] * k[:-1]), rtol=1e-10)


def test_k_is_interpolated_linearly_next_to_zero():
    table = make_refractive_index("ice", {**TABLE, "k": [0.0, 1e-4, 1e-2]})
    assert table(400.0).imag == 0.0
    assert table(np.sqrt(400.0 * 800.0)).imag == pytest.approx(0.5e-4)
    assert table(np.sqrt(800.0 * 1600.0)).imag == pytest.approx(1e-3)


def test_picard_differs_from_warren_below_600_nm_only():
    warren, picard = (make_refractive_index("ice", name) for name in list_datasets("ice"))
    long = np.linspace(600.0, 4000.0, 500)
    np.testing.assert_array_equal(picard(long), warren(long))
    short = np.linspace(320.0, 599.0, 200)
    np.testing.assert_allclose(picard(short).real, warren(short).real, atol=3e-4)
    blue = np.linspace(380.0, 440.0, 20)
    assert (picard(blue).imag > 2.0 * warren(blue).imag).all()


@pytest.mark.parametrize(("material", "name"), NAMED)
def test_wavelengths_outside_a_dataset_are_rejected(material, name):
    table = make_refractive_index(material, name)
    low, high = table.wavelength_nm[[0, -1]]
    for outside in (low * 0.99, high * 1.01, np.nan):
        with pytest.raises(ValueError, match="wavelength_nm") as error:
            table([low, outside])
        for text in (name, f"{low:g}", f"{high:g}", repr(float(outside))):
            assert text in str(error.value)


@pytest.mark.parametrize(
    "spec",
    [
        1.31 + 1e-7j,
        "1.31+1e-7j",
        "1.31 + 1e-7j",
        {"n": 1.31, "k": 1e-7},
        ConstantIndex(1.31 + 1e-7j),
    ],
)
def test_constants_in_every_spelling(spec):
    index = make_refractive_index("ice", spec)([400.0, 5000.0])
    np.testing.assert_array_equal(index, np.full(2, 1.31 + 1e-7j))


def test_constants_are_named_by_value_by_default():
    assert ConstantIndex(1.31 + 1e-7j).name == "1.31+1e-07j"
    assert ConstantIndex(1.31 + 1e-7j, "made up").name == "made up"


@pytest.mark.parametrize("spec", [1.33, "1.33", {"n": 1.33}, np.float64(1.33)])
def test_constants_without_absorption(spec):
    assert make_refractive_index("water", spec)(500.0) == 1.33


@pytest.mark.parametrize("kind", [str, Path])
def test_mappings_and_csv_files_are_equivalent(tmp_path, kind):
    path = tmp_path / "made_up.csv"
    path.write_text(CSV)
    wavelengths = np.linspace(400.0, 1600.0, 50)
    mapping, file = make_refractive_index("ice", TABLE), make_refractive_index("ice", kind(path))
    np.testing.assert_array_equal(file(wavelengths), mapping(wavelengths))
    assert file.name == "made_up.csv"
    with pytest.raises(ValueError, match=r"made_up\.csv"):
        file(399.0)


@pytest.mark.parametrize(
    "change",
    [
        {"wavelength_nm": [800.0, 400.0, 1600.0]},
        {"wavelength_nm": [400.0, 400.0, 1600.0]},
        {"wavelength_nm": [-400.0, 800.0, 1600.0]},
        {"wavelength_nm": [400.0, 800.0, np.inf]},
        {"n": [1.3, 0.0, 1.2]},
        {"n": [1.3, 1.4]},
        {"n": [1.3, np.nan, 1.2]},
        {"k": [1e-8, -1e-4, 1e-2]},
        {"wavelength_nm": [400.0], "n": [1.3], "k": [0.0]},
    ],
)
def test_malformed_tables_are_rejected(change):
    with pytest.raises(ValueError, match=r"refractive_index(\[ice\]| \(user table for ice\))"):
        make_refractive_index("ice", {**TABLE, **change})


@pytest.mark.parametrize(
    "spec",
    [
        "warren_brandt_2007", "1.3-1e-3j", "-1.3", 0.0, 1.3 - 0.1j, complex("nan"), True, [1.3, 0],
        {"k": 1e-3}, {"n": 1.3, "kappa": 0}, {"n": "ice"}, {"n": 1.3, "k": -1e-3},
        {**TABLE, "n": [1.3, "dense", 1.2]}, "missing.csv",
    ],
)  # fmt: skip
def test_invalid_specifications_are_rejected(spec):
    with pytest.raises(ValueError, match="refractive_index"):
        make_refractive_index("ice", spec)


def test_a_misspelt_dataset_gets_a_suggestion():
    with pytest.raises(ValueError, match="did you mean hale_querry_1973"):
        make_refractive_index("water", "hale_query_1973")
    with pytest.raises(ValueError, match=r"one of goethite, hematite, ice, .*, water"):
        list_datasets("sand")


@pytest.mark.parametrize(("material", "name"), NAMED)
def test_k_factor_scales_k_only(material, name):
    table = make_refractive_index(material, name)
    scaled = make_refractive_index(material, {"dataset": name, "k_factor": 2.5})
    w = table.wavelength_nm[::7]
    np.testing.assert_array_equal(scaled(w).real, table(w).real)
    np.testing.assert_allclose(scaled(w).imag, 2.5 * table(w).imag, rtol=1e-15)
    assert scaled.name == f"{name}, k x 2.5"
    assert table.source in scaled.source
    with pytest.raises(ValueError, match=f"the range of {name}"):
        scaled(1.0)


def test_factor_and_dataset_are_optional():
    assert make_refractive_index("water", {"k_factor": 0.5}).name == "hale_querry_1973, k x 0.5"
    name = "segelstein_1981"
    assert make_refractive_index("water", {"dataset": name}) is make_refractive_index("water", name)


@pytest.mark.parametrize(
    ("spec", "texts"),
    [
        ({"k_factor": 0.0}, ["[ice].k_factor = 0.0", "above 0"]),
        ({"k_factor": -1}, ["[ice].k_factor = -1", "above 0"]),
        ({"k_factor": np.inf}, ["[ice].k_factor = inf", "above 0"]),
        ({"k_factor": "half"}, ["[ice].k_factor = 'half'", "above 0"]),
        ({"k_factor": True}, ["[ice].k_factor = True", "above 0"]),
        ({"dataset": "warren_brandt"}, ["[ice].dataset = 'warren_brandt'", "did you mean"]),
        ({"dataset": ["warren_brandt_2008"]}, ["[ice].dataset", "one of"]),
        ({"k_factor": 2.0, "n": 1.3}, ["refractive_index[ice] = {", "dataset and k_factor"]),
        ({"k_facto": 2.0}, ["refractive_index[ice] = {'k_facto': 2.0}", "k_factor"]),
    ],
)
def test_invalid_factors_and_datasets_are_rejected(spec, texts):
    with pytest.raises(ValueError, match="must be") as error:
        make_refractive_index("ice", spec)
    for text in texts:
        assert text in str(error.value)


@pytest.mark.parametrize("spec", [None, "quartz", 1.5, {"n": 1.5}])
def test_unknown_materials_are_rejected(spec):
    with pytest.raises(ValueError, match=r"material = 'quarz'.*did you mean quartz"):
        make_refractive_index("quarz", spec)


@pytest.mark.parametrize(
    "text",
    [
        "wavelength_nm, n\n400, 1.3\n800, 1.3\n",
        "wavelength_nm, n, k\n400, 1.3, little\n800, 1.3, 0\n",
        "wavelength_nm, n, k\n400, 1.3, 0\n800, 1.3, 0, 0, 0\n",
        "",
    ],
)
def test_a_csv_file_without_its_columns_is_rejected(tmp_path, text):
    path = tmp_path / "other.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"other\.csv.*wavelength_nm, n, k"):
        make_refractive_index("ice", str(path))


def test_absorption_coefficient_is_four_pi_k_over_wavelength():
    alpha = absorption_coefficient(np.array([1.31 + 1e-6j]), np.array([1000.0]))
    assert alpha == pytest.approx(4e-6 * np.pi / 1e-6)


def test_user_tables_are_identified_by_content(tmp_path):
    path = tmp_path / "my_ice.csv"
    path.write_text("wavelength_nm,n,k\n400,1.32,2e-9\n1000,1.30,2e-6\n")
    attributes = Snow(refractive_index={"ice": path}).describe()
    assert attributes["refractive_index_ice"] == "my_ice.csv"
    assert (
        attributes["refractive_index_ice_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    )
    assert "refractive_index_water_sha256" not in attributes
    assert not any(str(tmp_path) in str(value) for value in attributes.values())
    grid = {"refractive_index": {"mine": {"ice": str(path)}}}
    instrument = {"wavelength_nm": [500.0]}
    experiment = ExperimentConfig(name="mine", instrument=instrument, grid=grid)
    assert str(tmp_path) not in experiment.dump_configuration()
    assert attributes["refractive_index_ice_sha256"] in experiment.dump_configuration()
    assert experiment.list_table_paths() == [str(path)]


# --- mixtures -------------------------------------------------------------------------------------


QUARTZ, HEMATITE = 1.55 + 0j, 3.0 + 0.5j
PAIRS = [(QUARTZ, HEMATITE), (HEMATITE, QUARTZ), (1.33 + 1e-9j, 1.2 + 2.0j), (1.56 + 5e-4j, 1.55)]
RULES = list(MIXING_RULES.values())


def test_hand_calculation_without_absorption():
    """ε_m = 4, ε_i = 16, f = ½: 4 (24 + 12) / (24 − 6) = 8."""
    assert complex(maxwell_garnett(2.0, 4.0, 0.5)) == pytest.approx(np.sqrt(8.0))
    assert complex(linear_mixing(2.0, 4.0, 0.5)) == pytest.approx(3.0)


def test_hand_calculation_with_absorption():
    """ε_m = 1, ε_i = (1 + i)² = 2i, f = 1/5: (2.8i + 1.6) / (1.6i + 2.2)."""
    epsilon = (1.6 + 2.8j) / (2.2 + 1.6j)
    assert complex(maxwell_garnett(1.0, 1.0 + 1.0j, 0.2)) ** 2 == pytest.approx(epsilon)
    assert complex(linear_mixing(1.0, 1.0 + 1.0j, 0.2)) == pytest.approx(1.0 + 0.2j)


def test_clausius_mossotti_relation():
    """(ε − ε_m)/(ε + 2ε_m) is that of the inclusions times their fraction."""
    f = np.linspace(0.0, 1.0, 11)
    matrix, inclusion = QUARTZ**2, HEMATITE**2
    epsilon = maxwell_garnett(QUARTZ, HEMATITE, f) ** 2
    expected = f * (inclusion - matrix) / (inclusion + 2.0 * matrix)
    np.testing.assert_allclose((epsilon - matrix) / (epsilon + 2.0 * matrix), expected, atol=1e-14)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("matrix", "inclusion"), PAIRS)
def test_pure_materials_keep_their_index(rule, matrix, inclusion):
    assert rule(matrix, inclusion, 0.0) == matrix
    assert complex(rule(matrix, inclusion, 1.0)) == pytest.approx(inclusion, rel=1e-12, abs=1e-12)
    assert complex(rule(matrix, matrix, 0.3)) == pytest.approx(matrix, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("matrix", "inclusion"), PAIRS)
def test_mixtures_are_passive(rule, matrix, inclusion):
    m = rule(matrix, inclusion, np.linspace(0.0, 1.0, 101))
    assert (m.real > 0.0).all() and (m.imag >= 0.0).all()


@pytest.mark.parametrize("rule", RULES)
def test_transparent_mixtures_stay_transparent(rule):
    f = np.linspace(0.0, 1.0, 101)
    m = rule(1.55, 2.4, f)
    assert (m.imag == 0.0).all()
    assert (np.diff(m.real) > 0.0).all()


def test_exchange_of_matrix_and_inclusion_is_second_order():
    """The Hashin-Shtrikman bounds coincide for equal materials."""
    for contrast, tolerance in ((0.1, 1e-4), (0.01, 1e-7)):
        inclusion_mixture = maxwell_garnett(1.5, 1.5 + contrast, 0.3)
        inverted_mixture = maxwell_garnett(1.5 + contrast, 1.5, 0.7)
        assert 0.0 < inverted_mixture.real - inclusion_mixture.real < tolerance
        assert inclusion_mixture.real == pytest.approx(
            linear_mixing(1.5, 1.5 + contrast, 0.3).real, abs=contrast**2
        )


@pytest.mark.parametrize("rule", RULES)
def test_arrays_broadcast(rule):
    w = np.array([450.0, 550.0, 650.0])
    quartz, hematite = make_refractive_index("quartz")(w), make_refractive_index("hematite")(w)
    f = np.array([[0.0], [0.02]])
    m = rule(quartz, hematite, f)
    assert m.shape == (2, 3)
    np.testing.assert_array_equal(m[0], quartz)
    assert m[1, 2] == rule(quartz[2], hematite[2], 0.02)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("fraction", [-0.1, 1.1, np.nan, [0.5, -0.1], np.inf])
def test_fractions_outside_0_to_1_are_rejected(rule, fraction):
    with pytest.raises(ValueError, match=r"fraction = .*must be in \[0, 1\]"):
        rule(QUARTZ, HEMATITE, fraction)
