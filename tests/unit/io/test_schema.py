"""Datasets of another schema version are rejected, and the message names both versions."""

from __future__ import annotations

import pytest
import xarray as xr

import splits
from splits.io import netcdf


@pytest.mark.parametrize("version", range(netcdf.SCHEMA_VERSION))
def test_files_of_older_schemas_are_rejected(version, tmp_path):
    attributes = {"splits_schema": version, "splits_version": "0.1.0"}
    splits.save(xr.Dataset({"albedo": 0.5}, attrs=attributes), tmp_path / "a.nc")
    message = (
        rf"a\.nc: splits_schema = {version}: must be {netcdf.SCHEMA_VERSION}; an older version of "
        r"the package wrote it \(0\.1\.0\): run the experiment again, or read it with that version$"
    )
    with pytest.raises(ValueError, match=message):
        splits.load(tmp_path / "a.nc")


@pytest.mark.parametrize(
    ("version", "message"),
    [
        (0, r"a\.nc: splits_schema = 0: must be \d+; an older version .* \(3\.0\): run the"),
        (99, r"a\.nc: splits_schema = 99: must be at most \d+; a newer version .* \(3\.0\)"),
        ("x", r"a\.nc: splits_schema = 'x': must be a whole number"),
        (-1, r"a\.nc: splits_schema = -1: must be a whole number"),
    ],
)
def test_other_schema_versions_are_rejected(version, message):
    attributes = {"splits_schema": version, "splits_version": "3.0"}
    with pytest.raises(ValueError, match=message):
        netcdf.check_schema(xr.Dataset(attrs=attributes), "a.nc")


def test_missing_schema_version_means_the_first():
    with pytest.raises(ValueError, match=r"a\.nc: splits_schema = 0: must be \d+; an older"):
        netcdf.check_schema(xr.Dataset(attrs={"splits_version": "0.1.0"}), "a.nc")


def test_new_files_have_the_current_schema(tmp_path):
    assert netcdf.make_provenance()["splits_schema"] == netcdf.SCHEMA_VERSION
    dataset = xr.Dataset({"reflectance": ("wavelength", [0.5, 0.25])})
    splits.save(dataset, tmp_path / "a.nc")
    loaded = splits.load(tmp_path / "a.nc")
    assert loaded.attrs["splits_schema"] == netcdf.SCHEMA_VERSION
    assert loaded.equals(dataset)
