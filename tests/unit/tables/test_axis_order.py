"""Tables and other results converted by xarray and pandas: sorted or rejected."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from formula_tables import make_snowlike_table

import splits
from splits.analysis.theory.phase_function import to_eradiate
from splits.core.validation import InvalidValue
from splits.tables.axes import ParameterGrid
from splits.tables.return_table import TITLE as RETURN_TITLE

SIZE, SOOT, ANGLE = "optical_radius_um", "impurities_ng_g.black_carbon", "incidence_deg"
FIXED = {SIZE: 300.0, SOOT: 50.0, ANGLE: 33.0}


@pytest.fixture(scope="module")
def dataset():
    return make_snowlike_table().dataset


def shuffle(ds):
    random = np.random.default_rng(1)
    return ds.isel({name: random.permutation(ds.sizes[name]) for name in ds.dims})


def convert_through_pandas(ds):
    return ds.to_dataframe().to_xarray().assign_attrs(ds.attrs)


def to_object_labels(ds):
    return ds.assign_coords({ANGLE: (ANGLE, ds[ANGLE].values.astype(object))})


CONVERSIONS = {
    "unchanged": lambda ds: ds,
    "one axis descends": lambda ds: ds.sortby(ANGLE, ascending=False),
    "all axes descend": lambda ds: ds.sortby(list(ds.dims), ascending=False),
    "shuffled": shuffle,
    "transposed": lambda ds: ds.transpose("wavelength", ...),
    "through pandas": convert_through_pandas,
    "numbers as objects": to_object_labels,
    "whole numbers": lambda ds: ds.assign_coords({ANGLE: ds[ANGLE].astype(int)}),
    "several of these": lambda ds: convert_through_pandas(shuffle(ds)).transpose("wavelength", ...),
}


@pytest.mark.parametrize("conversion", CONVERSIONS)
def test_table_results_are_independent_of_axis_order(conversion, dataset):
    original, converted = splits.Table(dataset), splits.Table(CONVERSIONS[conversion](dataset))
    for evaluate in (
        lambda table: table.interp(**FIXED),
        lambda table: table.interp(**FIXED, wavelength=[777.0]),
        lambda table: table.derivatives([SIZE, SOOT], **FIXED),
        lambda table: table.to_isofit(**{SOOT: 0.0}),
    ):
        expected, actual = evaluate(original), evaluate(converted)
        xr.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-15)
    assert converted.axes[-1] == "wavelength" and set(converted.axes) == set(original.axes)


@pytest.mark.parametrize("conversion", ["all axes descend", "shuffled", "transposed"])
def test_table_files_may_have_any_axis_order(conversion, dataset, tmp_path, monkeypatch):
    splits.save(CONVERSIONS[conversion](dataset), tmp_path / "table.nc")
    expected = splits.Table(dataset).interp(**FIXED)
    for limit in (2**28, 1):
        monkeypatch.setattr("splits.tables.table.MAX_BYTES_IN_MEMORY", limit)
        actual = splits.open_table(tmp_path / "table.nc").interp(**FIXED)
        xr.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-15)


def test_subsets_of_a_table_are_interpolated(dataset):
    point = {name: value for name, value in FIXED.items() if name != ANGLE}
    subset = splits.Table(dataset.isel({ANGLE: 1, "wavelength": [4, 2]}))
    expected = splits.Table(dataset).interp(**FIXED | {ANGLE: 30.0}, wavelength=[700.0, 900.0])
    np.testing.assert_allclose(subset.interp(**point).reflectance, expected.reflectance, rtol=1e-9)


INVALID_TABLES = {
    "no dataset": (
        lambda ds: ds.reflectance,
        "table = 'DataArray': must be what splits.build_table",
    ),
    "a path": (lambda ds: "table.nc", r"table = 'str': must be .*splits.open_table\(…\) takes"),
    "a table": (splits.Table, "table = 'Table': must be"),
    "another dataset": (lambda ds: ds.drop_attrs(), "table = 'a dataset': must be"),
    "a table of returns": (
        lambda ds: xr.Dataset({"return_rate": 0.0}, attrs={"title": RETURN_TITLE}),
        "table = 'Table of returns': must be .*splits.retrieve_return takes a table of returns",
    ),
    "values alone": (lambda ds: ds[["reflectance"]], "with a quantity and its error"),
    "one wavelength": (lambda ds: ds.isel(wavelength=0), r"over wavelength \(select a list"),
    "no values of an axis": (lambda ds: ds.drop_vars(ANGLE), f"table.{ANGLE} = None: must be"),
    "gaps": (lambda ds: ds.reindex({ANGLE: [0.0, 10.0]}), "table.reflectance = nan: must be a num"),
    "a gap in an axis": (lambda ds: ds.assign_coords({ANGLE: [0.0, np.nan, 60.0]}),
                         f"table.{ANGLE} = .*: must be numbers, or texts"),
    "a node twice": (lambda ds: ds.isel({ANGLE: [0, 0, 1]}), f"table.{ANGLE} = .*different values"),
}  # fmt: skip


@pytest.mark.parametrize("name", INVALID_TABLES)
def test_incomplete_tables_are_rejected_on_construction(name, dataset):
    change, message = INVALID_TABLES[name]
    with pytest.raises(InvalidValue, match=message):
        splits.Table(change(dataset))


ORDERS = {
    "descending": lambda ds: ds.sortby("order", ascending=False),
    "transposed": lambda ds: ds.transpose(),
}


@NEEDS_JIT
@pytest.mark.parametrize("function", [splits.phase_function, splits.with_diffraction, to_eradiate])
def test_moments_may_have_any_order(function):
    optics = splits.single_scattering(splits.Snow(), [500, 900], moments=64, rays=1000)
    for change in ORDERS.values():
        xr.testing.assert_equal(function(change(optics)), function(optics))
    with pytest.raises(InvalidValue, match=r"optics.order = \[0, 2, 4, .*: must be 0, 1, 2"):
        function(optics.isel(order=slice(0, None, 2)))


@pytest.mark.parametrize("name", ["reflectance", "reflectance_stderr", "wavelength", "batch", ""])
def test_axes_have_names_of_their_own(name):
    with pytest.raises(InvalidValue, match=r"grid = .*must be names that no quantity"):
        ParameterGrid.from_mapping({name: [0.0, 1.0]})


def test_names_of_media_and_bands_are_texts_of_files():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    with pytest.raises(InvalidValue, match="must be texts that files in UTF-8 hold"):
        splits.spectrophotometer({"\ud800": snow}, [500.0])
