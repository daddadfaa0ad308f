"""Damaged datasets: one-line errors for every kind of damage."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import netCDF4
import numpy as np
import pytest
import xarray as xr

import splits
from splits.io.netcdf import (
    DamagedFileError,
    exit_if_damaged,
    make_provenance,
    to_netcdf_attributes,
)

VALUES = np.linspace(0.1, 0.9, 24).reshape(2, 3, 4)


def make_dataset(name="first"):
    """Return a dataset over text labels, unsorted numbers and wavelength."""
    return xr.Dataset(
        {
            "reflectance": (("medium", "depth_m", "wavelength"), VALUES, {"units": "1"}),
            "rays": ((), 4096, {"units": "1"}),
        },
        {
            "medium": ["dune", "beach"],
            "depth_m": [3.0, 1.0, 2.0],
            "wavelength": ("wavelength", [500.0, 600.0, 700.0, 800.0], {"units": "nm"}),
        },
        to_netcdf_attributes(
            {"title": f"made up: {name}", "experiment": name, **make_provenance()}
        ),
    )


def flip_bit(path, position):
    content = bytearray(path.read_bytes())
    content[position] ^= 0x10
    path.write_bytes(content)


def flip_data(path):
    flip_bit(path, path.read_bytes().index(VALUES[0].tobytes()) + 6)


def flip_header(path):
    flip_bit(path, 12)


def flip_text(path):
    flip_bit(path, path.read_bytes().index(b"made up"))


def flip_label(path):
    flip_bit(path, path.read_bytes().index(b"beach"))


def truncate(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def zero_fill(path):
    half = path.stat().st_size // 2
    path.write_bytes(path.read_bytes()[:half] + bytes(path.stat().st_size - half))


def zero_block(path):
    content = bytearray(path.read_bytes())
    content[2000:2200] = bytes(200)
    path.write_bytes(content)


def empty_file(path):
    path.write_bytes(b"")


def write_text(path):
    path.write_text("this is no netCDF\n")


def change_attribute(path):
    with netCDF4.Dataset(path, "a") as file:
        file.title = "made up: second"


def change_values(path):
    with netCDF4.Dataset(path, "a") as file:
        file["reflectance"][0, 0, 0] += 1e-12


def delete_variable(path):
    with xr.open_dataset(path) as file:
        remaining = file.load().drop_vars("rays")
    remaining.to_netcdf(path)


DAMAGE_FUNCTIONS = {
    damage.__name__: damage
    for damage in (
        flip_data, flip_header, flip_text, flip_label, truncate, zero_fill, zero_block, empty_file,
        write_text,
    )
}  # fmt: skip


def copy(path):
    xr.load_dataset(path).to_netcdf(path)


def compress(path):
    xr.load_dataset(path).to_netcdf(path, encoding={"reflectance": {"zlib": True}})


def pack_as_integers(path):
    packing = {"dtype": "int16", "scale_factor": 1e-4, "add_offset": 0.5, "_FillValue": -32768}
    xr.load_dataset(path).to_netcdf(path, encoding={"reflectance": packing})


def store_as_netcdf3(path):
    xr.load_dataset(path).to_netcdf(path, format="NETCDF3_64BIT")


def join(path):
    xr.concat([xr.load_dataset(path)] * 2, "sample").to_netcdf(path)


def add_variable(path):
    xr.Dataset({"noise": ("wavelength", np.ones(4))}).to_netcdf(path, mode="a")


CHANGE_FUNCTIONS = {
    change.__name__: change
    for change in (
        change_attribute, change_values, delete_variable, copy, compress, pack_as_integers,
        store_as_netcdf3, join, add_variable,
    )
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGE_FUNCTIONS)
def test_damage_is_reported_in_one_line(tmp_path, damage):
    path = tmp_path / "made.nc"
    splits.save(make_dataset(), path)
    DAMAGE_FUNCTIONS[damage](path)
    with pytest.raises(ValueError, match="damaged") as error:
        splits.load(path)
    line = str(error.value)
    assert line.startswith(f"{path}: damaged, ")
    assert line.endswith(" (delete it, and run again what made it)")
    assert "\n" not in line


@pytest.mark.parametrize("change", CHANGE_FUNCTIONS)
def test_files_changed_by_other_programs_are_read_with_a_warning(tmp_path, change):
    path = tmp_path / "made.nc"
    splits.save(make_dataset(), path)
    CHANGE_FUNCTIONS[change](path)
    with pytest.warns(UserWarning, match=r"made\.nc: has no checksum.*changed it") as warned:
        loaded = splits.load(path)
    assert len(warned) == 1
    expected = VALUES if change != "join" else np.stack([VALUES, VALUES])
    np.testing.assert_allclose(loaded.reflectance, expected, rtol=0, atol=1e-4)
    assert loaded.medium.values.tolist() == ["dune", "beach"]
    splits.save(loaded, path)
    xr.testing.assert_equal(splits.load(path), loaded)


@pytest.mark.parametrize("damage", ["flip_data", "truncate", "zero_fill", "empty_file"])
def test_damage_of_a_copy_by_another_program_is_detected(tmp_path, damage):
    path = tmp_path / "made.nc"
    splits.save(make_dataset(), path)
    copy(path)
    DAMAGE_FUNCTIONS[damage](path)
    with pytest.raises(ValueError, match=r"made\.nc: damaged, "):
        splits.load(path)


@pytest.mark.parametrize("damage", ["flip_text", "truncate", "write_text"])
def test_a_job_with_damaged_input_ends_with_one_line(tmp_path, damage):
    path, sound = tmp_path / "made.nc", tmp_path / "sound.nc"
    for name in (path, sound):
        splits.save(make_dataset(), name)
    exit_if_damaged([str(sound), "config/none.csv"])
    DAMAGE_FUNCTIONS[damage](path)
    with pytest.raises(SystemExit) as exit_status:
        exit_if_damaged([str(sound), str(path)])
    line = exit_status.value.code
    assert line.startswith(f"{path}: damaged, ") and line.endswith(", and run again)")
    assert "\n" not in line


def test_damage_errors_are_pickled():
    error = pickle.loads(pickle.dumps(DamagedFileError("a.nc", "the file is empty")))
    assert str(error).startswith("a.nc: damaged, the file is empty (")


def test_any_flipped_bit_is_detected(tmp_path):
    path = tmp_path / "made.nc"
    splits.save(make_dataset(), path)
    original = path.read_bytes()
    for position in np.random.default_rng(1).choice(len(original), 300, replace=False):
        flip_bit(path, position)
        with pytest.raises(ValueError, match=r"made\.nc: damaged, "):
            splits.load(path)
        path.write_bytes(original)


def test_modified_datasets_can_be_saved_again(tmp_path):
    splits.save(make_dataset(), tmp_path / "made.nc")
    subset = splits.load(tmp_path / "made.nc").isel(medium=[1]).assign_attrs(note="a part")
    splits.save(subset, tmp_path / "part.nc")
    xr.testing.assert_identical(splits.load(tmp_path / "part.nc"), subset)


def test_threads_save_and_load_concurrently(tmp_path):
    def save_and_load(number):
        path = tmp_path / f"made{number % 4}.nc"
        splits.save(make_dataset(), path)
        return splits.load(path)

    with ThreadPoolExecutor(4) as pool:
        for loaded in pool.map(save_and_load, range(16)):
            xr.testing.assert_equal(loaded, make_dataset())


def test_permission_errors_are_not_reported_as_damage(tmp_path, monkeypatch):
    path = tmp_path / "made.nc"
    splits.save(make_dataset(), path)

    def deny(*_arguments):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("builtins.open", deny)
    with pytest.raises(PermissionError):
        splits.load(path)
