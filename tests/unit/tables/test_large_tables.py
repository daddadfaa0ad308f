"""Tables larger than memory: written block by block, and read on access."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import splits
from splits.experiments import run_table as module
from splits.experiments.config.settings import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.tables import table as table_module

ACCURACY = Accuracy(max_stderr=0.05, relative_stderr=0.3)
GRID = {
    "optical_radius_um": [50.0, 100.0, 200.0],
    "ground": ["open", "camborthid"],
    "impurities_ng_g.black_carbon": [0.0, 500.0],
}


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Return one table put together in memory, and written block by block."""
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
    usual, large = folder / "usual.nc", folder / "large.nc"
    module.write_table(experiment, ACCURACY, 1, folder, usual)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MAX_BYTES_IN_MEMORY", 0)
        module.write_table(experiment, ACCURACY, 1, folder, large)
    return experiment, folder, usual, large


def test_the_file_holds_the_same(both):
    _, _, usual, large = both
    a, b = splits.load(usual), splits.load(large)
    xr.testing.assert_equal(a, b)
    differ = {key for key in {*a.attrs, *b.attrs} if not np.array_equal(a.attrs[key], b.attrs[key])}
    assert differ <= {"date_created", "history", "wall_time_s"}
    assert all(a[name].attrs == b[name].attrs for name in a.variables)


def test_reading_from_the_file_gives_the_same(both, monkeypatch):
    _, _, usual, large = both
    at = {"optical_radius_um": 120.0, "ground": "camborthid", "impurities_ng_g.black_carbon": 200.0}
    whole = splits.open_table(usual).interp(**at)
    monkeypatch.setattr(table_module, "MAX_BYTES_IN_MEMORY", 0)
    table = splits.open_table(large)
    assert not table.dataset.reflectance.variable._in_memory
    xr.testing.assert_identical(table.interp(**at), whole)
    assert not table.dataset.reflectance.variable._in_memory


def test_damage_is_found(both, tmp_path):
    _, _, _, large = both
    content = bytearray(large.read_bytes())
    content[len(content) // 2] ^= 1
    damaged = tmp_path / "damaged.nc"
    damaged.write_bytes(content)
    with pytest.raises(ValueError, match="damaged, its bytes have another checksum"):
        splits.open_table(damaged)


def test_a_file_that_does_not_hold_its_blocks_does_not_appear(both, tmp_path, monkeypatch):
    experiment, folder, _, _ = both
    monkeypatch.setattr(module, "MAX_BYTES_IN_MEMORY", 0)
    monkeypatch.setattr("splits.tables.storage._write_block", lambda *_arguments: None)
    path = tmp_path / "never.nc"
    with pytest.raises(OSError, match="does not hold the table"):
        module.write_table(experiment, ACCURACY, 1, folder, path)
    assert not list(tmp_path.iterdir())
