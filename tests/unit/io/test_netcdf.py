"""Datasets on disk: round trip, atomic writes, provenance and schema versions."""

import stat

import numpy as np
import pytest
import xarray as xr
from run_attributes import RUN_SPECIFIC_ATTRIBUTES, drop_run_specific_attributes

import splits
from splits.io.netcdf import (
    CF_CONVENTIONS,
    SCHEMA_VERSION,
    check_schema,
    make_provenance,
    select_points,
    to_netcdf_attributes,
)


def make_dataset(**changes):
    """Return a small dataset over a number, a label and wavelength."""
    values = {"reflectance": np.arange(12.0).reshape(2, 2, 3) / 12.0, **changes}
    return xr.Dataset(
        {
            name: (("depth_m", "incidence_deg", "wavelength"), v, {"units": "1"})
            for name, v in values.items()
        },
        {
            "depth_m": [0.02, 0.12],
            "incidence_deg": ["beam", "diffuse"],
            "wavelength": ("wavelength", [500.0, 600.0, 700.0], {"units": "nm"}),
        },
        to_netcdf_attributes(
            {"title": "made up", "sizes": (300, 750), "flag": True, **make_provenance()}
        ),
    )


def list_names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_datasets_are_saved_and_loaded(tmp_path):
    dataset = make_dataset()
    splits.save(dataset, tmp_path / "new" / "folder" / "made.nc")
    loaded = splits.load(tmp_path / "new" / "folder" / "made.nc")
    xr.testing.assert_equal(loaded, dataset)
    assert loaded.reflectance.attrs == dataset.reflectance.attrs
    assert set(loaded.attrs) == set(dataset.attrs)
    assert list(loaded.attrs["sizes"]) == [300, 750]
    assert list_names(tmp_path / "new" / "folder") == ["made.nc"]


def test_a_loaded_dataset_does_not_keep_its_file_open(tmp_path):
    path = tmp_path / "made.nc"
    splits.save(make_dataset(), path)
    loaded = splits.load(path)
    path.unlink()
    assert float(loaded.reflectance.sum()) == pytest.approx(5.5)


def test_files_have_default_permissions(tmp_path):
    splits.save(make_dataset(), tmp_path / "made.nc")
    (tmp_path / "plain").touch()
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("made.nc", "plain")}
    assert len(modes) == 1


@pytest.mark.parametrize("exists", [False, True])
def test_a_failed_save_keeps_the_old_file(tmp_path, monkeypatch, exists):
    path = tmp_path / "made.nc"
    if exists:
        splits.save(make_dataset(), path)

    def fail(_dataset, target, **_options):
        with open(target, "wb") as file:
            file.write(b"half a fi")
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(xr.Dataset, "to_netcdf", fail)
        with pytest.raises(OSError, match="disk full"):
            splits.save(make_dataset(reflectance=np.zeros((2, 2, 3))), path)
    assert list_names(tmp_path) == (["made.nc"] if exists else [])
    if exists:
        xr.testing.assert_equal(splits.load(path), make_dataset())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_values_are_rejected_by_name(tmp_path, value):
    values = np.zeros((2, 2, 3))
    values[1, 0, 2] = value
    with pytest.raises(ValueError, match=r"made\.nc: transmittance holds values.*not finite"):
        splits.save(make_dataset(transmittance=values), tmp_path / "made.nc")
    assert list_names(tmp_path) == []


def test_names_with_dots_are_restored_when_loaded(tmp_path):
    axes = {
        "layers.0.depth_m": ("layers.0.depth_m", [0.1, 0.2], {"units": "m", "long_name": "depth"}),
        "layers.1.surface": ("layers.1.surface", ["flat", "wavy"], {"long_name": "surface"}),
        "layers.2.ground": ("layers.2.ground", [0.3, 0.1], {"units": "1", "long_name": "ground"}),
        "layers.1.surface_mean": ("layers.1.surface", [0.0, 0.5], {"units": "1"}),
    }
    dims = ("layers.0.depth_m", "layers.1.surface", "layers.2.ground")
    attributes = {"units": "1", "long_name": "reflectance"}
    dataset = xr.Dataset(
        {"reflectance": (dims, np.zeros((2, 2, 2)), attributes)}, axes, make_provenance()
    )
    path = tmp_path / "stack.nc"
    splits.save(dataset, path)
    with xr.open_dataset(path) as file:
        assert not any("." in str(name) for name in {*file.variables, *file.dims})
        assert {"layers_0_depth_m", "layers_1_surface_label"} <= set(file.coords)
    xr.testing.assert_identical(splits.load(path), dataset)
    splits.save(splits.load(path), path)
    xr.testing.assert_identical(splits.load(path), dataset)
    splits.save(splits.load(path).drop_vars("layers.1.surface_mean"), path)
    with xr.open_dataset(path, decode_coords=False) as file:
        assert file.reflectance.attrs["coordinates"] == "layers_1_surface_label"


@pytest.mark.parametrize("name", ["made.csv", "made", "made.nc.gz", "made.NC"])
def test_other_suffixes_are_rejected_with_a_hint(tmp_path, name):
    with pytest.raises(ValueError, match=r"^path = .*: must be a name that ends in \.nc, .*to_csv"):
        splits.save(make_dataset(), tmp_path / name)
    assert list_names(tmp_path) == []


@pytest.mark.parametrize("name", ["made.nc", "made.nc4", "made.netcdf"])
def test_netcdf_suffixes_are_accepted(tmp_path, name):
    splits.save(make_dataset(), tmp_path / name)
    xr.testing.assert_equal(splits.load(tmp_path / name), make_dataset())


def test_datasets_of_other_programs_are_rejected(tmp_path):
    path = tmp_path / "foreign.nc"
    xr.Dataset({"x": ("t", [1.0, 2.0])}).to_netcdf(path)
    with pytest.raises(ValueError, match=r"foreign\.nc: not a dataset written by splits"):
        splits.load(path)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.nc"):
        splits.load(tmp_path / "nothing.nc")


def test_provenance_states_program_versions_and_time():
    attributes = make_provenance("experiment sunny")
    assert attributes["history"].startswith(f"{attributes['date_created']} splits ")
    assert attributes["history"].endswith(": experiment sunny")
    assert attributes["Conventions"] == CF_CONVENTIONS
    assert attributes["source"] == f"splits {attributes['splits_version']}"
    assert attributes["date_created"].endswith("+00:00")
    assert {"splits_commit", "python_version", "numpy_version"} <= set(attributes)


def test_attributes_are_converted_for_netcdf():
    attributes = to_netcdf_attributes(
        {"a": None, "b": True, "c": np.False_, "d": (1, 2.5), "e": "text", "f": 3}
    )
    assert [attributes[key] for key in "abcef"] == ["none", "true", "false", "text", 3]
    assert attributes["d"].tolist() == [1.0, 2.5]


def test_run_specific_attributes_are_dropped():
    dataset = make_dataset().assign_attrs(dict.fromkeys(RUN_SPECIFIC_ATTRIBUTES, 1))
    copy = drop_run_specific_attributes(dataset)
    assert not set(RUN_SPECIFIC_ATTRIBUTES) & set(copy.attrs)
    assert copy.attrs["title"] == "made up"
    assert set(RUN_SPECIFIC_ATTRIBUTES) <= set(dataset.attrs), "the original keeps them"
    xr.testing.assert_equal(copy, dataset)


def test_points_are_selected_by_numbers_and_labels():
    dataset = make_dataset()
    selected = select_points(dataset, {"depth_m": 0.12, "incidence_deg": "beam"})
    np.testing.assert_array_equal(selected.reflectance, dataset.reflectance[1, 0])
    xr.testing.assert_equal(select_points(dataset, {}), dataset)


@pytest.mark.parametrize("version", range(SCHEMA_VERSION))
def test_files_of_older_schemas_are_rejected(version, tmp_path):
    attributes = {"splits_schema": version, "splits_version": "0.1.0"}
    splits.save(xr.Dataset({"albedo": 0.5}, attrs=attributes), tmp_path / "a.nc")
    message = (
        rf"a\.nc: splits_schema = {version}: must be {SCHEMA_VERSION}; an older version of "
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
        check_schema(xr.Dataset(attrs=attributes), "a.nc")


def test_missing_schema_version_means_the_first():
    with pytest.raises(ValueError, match=r"a\.nc: splits_schema = 0: must be \d+; an older"):
        check_schema(xr.Dataset(attrs={"splits_version": "0.1.0"}), "a.nc")


def test_new_files_have_the_current_schema(tmp_path):
    assert make_provenance()["splits_schema"] == SCHEMA_VERSION
    dataset = xr.Dataset({"reflectance": ("wavelength", [0.5, 0.25])})
    splits.save(dataset, tmp_path / "a.nc")
    loaded = splits.load(tmp_path / "a.nc")
    assert loaded.attrs["splits_schema"] == SCHEMA_VERSION
    assert loaded.equals(dataset)
