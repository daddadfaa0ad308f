"""Schema versions: older datasets are converted, newer ones are rejected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import splits
from splits.io import netcdf

OLD_VARIABLES = Path(__file__).parent / "data"


@pytest.mark.parametrize("number", range(netcdf.SCHEMA_VERSION))
def test_a_file_of_every_older_schema_is_read(number):
    found = splits.load(OLD_VARIABLES / f"schema_{number}.nc")
    assert found.attrs["splits_schema"] == netcdf.SCHEMA_VERSION
    assert found.attrs["splits_version"] == "0.1.0"
    assert found.reflectance.dims == ("wavelength",)
    assert np.isfinite(found.reflectance_stderr).all()


def test_every_older_schema_has_a_reader():
    assert sorted(netcdf.SCHEMA_MIGRATIONS) == list(range(netcdf.SCHEMA_VERSION))


def test_readers_are_applied_one_after_the_other(monkeypatch):
    steps = {
        n: lambda ds, n=n: ds.assign_attrs(seen=[*ds.attrs.get("seen", []), n]) for n in (0, 1)
    }
    monkeypatch.setattr(netcdf, "SCHEMA_MIGRATIONS", steps)
    monkeypatch.setattr(netcdf, "SCHEMA_VERSION", 2)
    assert netcdf.upgrade_schema(xr.Dataset(), "a.nc").attrs == {"seen": [0, 1], "splits_schema": 2}


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (99, r"a\.nc: splits_schema = 99: must be at most \d+; a newer version .* \(3\.0\)"),
        ("x", r"a\.nc: splits_schema = 'x': must be a whole number"),
        (-1, r"a\.nc: splits_schema = -1: must be a whole number"),
    ],
)
def test_other_numbers_are_rejected(number, said):
    attributes = {"splits_schema": number, "splits_version": "3.0"}
    with pytest.raises(ValueError, match=said):
        netcdf.upgrade_schema(xr.Dataset(attrs=attributes), "a.nc")


def test_new_files_carry_the_number():
    from splits.io.netcdf import make_provenance

    assert make_provenance()["splits_schema"] == netcdf.SCHEMA_VERSION
