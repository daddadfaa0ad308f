"""Tables larger than memory: written block by block, and read on access."""

import numpy as np
import pytest
import xarray as xr

import splits
from splits.experiments import run_table as module
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.tables import blocks as blocks_module
from splits.tables import table as table_module

ACCURACY = Accuracy(max_stderr=0.05, relative_stderr=0.3)
GRID = {
    "optical_radius_um": [50.0, 100.0, 200.0],
    "ground": ["open", "camborthid"],
    "impurities_ng_g.black_carbon": [0.0, 500.0],
}


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Return the files of one table, written from memory and block by block."""
    folder = tmp_path_factory.mktemp("large")
    experiment = SimulationConfig.model_validate(
        {
            "name": "some",
            "medium": {"kind": "natural_snow", "depth_m": 0.05},
            "instrument": {
                "kind": "table", "wavelength_nm": [500, 700, 1000], "covariance": "keep",
                "quantities": ["reflectance"],
            },
            "grid": GRID,
        }
    )  # fmt: skip
    in_memory, blockwise = folder / "usual.nc", folder / "large.nc"
    module.write_table(experiment, ACCURACY, 1, folder, in_memory)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MAX_BYTES_IN_MEMORY", 0)
        module.write_table(experiment, ACCURACY, 1, folder, blockwise)
    return experiment, folder, in_memory, blockwise


def test_blockwise_file_equals_the_one_from_memory(tables):
    _, _, in_memory, blockwise = tables
    a, b = splits.load(in_memory), splits.load(blockwise)
    xr.testing.assert_equal(a, b)
    differ = {key for key in {*a.attrs, *b.attrs} if not np.array_equal(a.attrs[key], b.attrs[key])}
    assert differ <= {"date_created", "history", "wall_time_s"}
    assert all(a[name].attrs == b[name].attrs for name in a.variables)


def test_interpolation_from_the_file_is_identical(tables, monkeypatch):
    _, _, in_memory, blockwise = tables
    point = {
        "optical_radius_um": 120.0,
        "ground": "camborthid",
        "impurities_ng_g.black_carbon": 200.0,
    }
    expected = splits.Table(in_memory).interp(**point)
    monkeypatch.setattr(table_module, "MAX_BYTES_IN_MEMORY", 0)
    table = splits.Table(blockwise)
    assert not table.dataset.reflectance.variable._in_memory
    xr.testing.assert_identical(table.interp(**point), expected)
    assert not table.dataset.reflectance.variable._in_memory


@pytest.mark.parametrize(
    "solver",
    ["monte_carlo", pytest.param("discrete_ordinates", marks=pytest.mark.long)],
)
def test_tables_with_directions_are_written_block_by_block(tmp_path, monkeypatch, solver):
    experiment = SimulationConfig.model_validate(
        {
            "name": "some",
            "medium": {"kind": "natural_snow"},
            "instrument": {
                "kind": "table", "wavelength_nm": [500, 1000], "solver": solver,
                "polar_deg": [0, 40], "azimuth_deg": [0, 90, 180],
                "quantities": ["reflectance", "anisotropy_factor", "diffuse_reflectance_factor"],
            },
            "grid": {"optical_radius_um": [50.0, 200.0], "incidence_deg": [0.0, 60.0]},
        }
    )  # fmt: skip
    accuracy = Accuracy(max_stderr=0.2, relative_stderr=0.3)
    in_memory, blockwise = tmp_path / "usual.nc", tmp_path / "large.nc"
    for part in range(2):
        module.run_part(experiment, accuracy, 1, tmp_path, part)
    module.write_table(experiment, accuracy, 1, tmp_path, in_memory)
    monkeypatch.setattr(module, "MAX_BYTES_IN_MEMORY", 0)
    module.write_table(experiment, accuracy, 1, tmp_path, blockwise)
    usual, large = splits.load(in_memory), splits.load(blockwise)
    xr.testing.assert_equal(usual, large)
    assert usual.reflectance.dims == ("optical_radius_um", "incidence_deg", "wavelength")
    assert usual.diffuse_reflectance_factor.dims == ("optical_radius_um", "polar_deg", "wavelength")
    assert not usual.isnull().to_array().any()
    monkeypatch.setattr(table_module, "MAX_BYTES_IN_MEMORY", 0)
    view = splits.Table(blockwise).at_view(20.0, 120.0)
    found = view.interp(optical_radius_um=100.0, incidence_deg=30.0)
    assert (found.anisotropy_factor_stderr > 0.0).all()


def test_damage_is_detected(tables, tmp_path):
    _, _, _, blockwise = tables
    content = bytearray(blockwise.read_bytes())
    content[len(content) // 2] ^= 1
    damaged = tmp_path / "damaged.nc"
    damaged.write_bytes(content)
    with pytest.raises(ValueError, match="damaged, the checksum of its bytes differs"):
        splits.Table(damaged)


def test_incomplete_files_are_not_kept(tables, tmp_path, monkeypatch):
    experiment, folder, _, _ = tables
    monkeypatch.setattr(module, "MAX_BYTES_IN_MEMORY", 0)
    iterate, calls = blocks_module._iterate_points, []

    def skip_writing(*arguments):
        calls.append(arguments)
        return iterate(*arguments) if len(calls) > 1 else iter(())

    monkeypatch.setattr(blocks_module, "_iterate_points", skip_writing)
    path = tmp_path / "never.nc"
    with pytest.raises(OSError, match="does not hold the table"):
        module.write_table(experiment, ACCURACY, 1, folder, path)
    assert not list(tmp_path.iterdir())
