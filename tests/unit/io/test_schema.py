"""Datasets of another layout than that of this version are refused, with both numbers."""

from __future__ import annotations

import pytest
import xarray as xr

import splits
from splits.io import netcdf


@pytest.mark.parametrize("number", range(netcdf.SCHEMA_VERSION))
def test_a_file_of_an_older_schema_is_refused(number, tmp_path):
    attributes = {"splits_schema": number, "splits_version": "0.1.0"}
    splits.save(xr.Dataset({"albedo": 0.5}, attrs=attributes), tmp_path / "a.nc")
    said = (
        rf"a\.nc: splits_schema = {number}: must be {netcdf.SCHEMA_VERSION}; an older version of "
        r"the package wrote it \(0\.1\.0\): run the experiment again, or read it with that version$"
    )
    with pytest.raises(ValueError, match=said):
        splits.load(tmp_path / "a.nc")


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (0, r"a\.nc: splits_schema = 0: must be \d+; an older version .* \(3\.0\): run the"),
        (99, r"a\.nc: splits_schema = 99: must be at most \d+; a newer version .* \(3\.0\)"),
        ("x", r"a\.nc: splits_schema = 'x': must be a whole number"),
        (-1, r"a\.nc: splits_schema = -1: must be a whole number"),
    ],
)
def test_other_numbers_are_refused(number, said):
    attributes = {"splits_schema": number, "splits_version": "3.0"}
    with pytest.raises(ValueError, match=said):
        netcdf.check_schema(xr.Dataset(attrs=attributes), "a.nc")


def test_a_dataset_without_a_number_is_of_the_first_schema():
    with pytest.raises(ValueError, match=r"a\.nc: splits_schema = 0: must be \d+; an older"):
        netcdf.check_schema(xr.Dataset(attrs={"splits_version": "0.1.0"}), "a.nc")


def test_new_files_carry_the_number_and_are_read(tmp_path):
    assert netcdf.make_provenance()["splits_schema"] == netcdf.SCHEMA_VERSION
    dataset = xr.Dataset({"reflectance": ("wavelength", [0.5, 0.25])})
    splits.save(dataset, tmp_path / "a.nc")
    found = splits.load(tmp_path / "a.nc")
    assert found.attrs["splits_schema"] == netcdf.SCHEMA_VERSION
    assert found.equals(dataset)
