"""What instruments and skies make from Python follows the CF conventions, too."""

from __future__ import annotations

import pytest
import xarray as xr
from compliance import main, remarks

import splits

SNOW = splits.Snow(depth_m=0.01)
GREY_GROUND = splits.Snow(depth_m=0.01, impurities_ng_g={"black_carbon": 100})
SNOWPACK = splits.Stack([SNOW, splits.Sand(depth_m=0.004)], ground=0.3, interpretation="geometric")
SKY = "midlatitude_winter"
EXAMPLES = {
    "irradiance_profile": lambda: splits.irradiance_profile(
        SNOWPACK, [500, 900], [0.002, 0.012], max_stderr=0.2
    ),
    "deep": lambda: splits.deep_transmittance(SNOW, [500], relative_stderr=0.5),
    "single": lambda: splits.single_scattering(SNOW, [500, 900], 8, 2000),
    "several media": lambda: splits.spectrophotometer(
        {"clean": SNOW, "grey": GREY_GROUND}, [500, 900], max_stderr=0.2
    ),
    "albedo": lambda: splits.albedo(
        SNOW, SKY, [600, 650, 700], max_stderr=0.2, bands={"red": (600, 700)}
    ),
    "hdrf": lambda: splits.hdrf(SNOW, SKY, [500], 0.5, polar_deg=[0, 30], azimuth_deg=[0, 180]),
    "inside": lambda: splits.radiation_profile(
        SNOWPACK, SKY, [0.002, 0.012], [500, 900, 1200], max_stderr=0.3, total_w_m2=300.0
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_a_dataset_follows_the_cf_conventions(name, tmp_path):
    path = tmp_path / f"{name}.nc"
    splits.save(EXAMPLES[name](), path)
    assert remarks([path]) == {path: []}


def test_a_dataset_that_does_not_is_found(tmp_path, capsys):
    about = {"units": "florps", "standard_name": "no_such_name"}
    bad = xr.Dataset({"a": ("depth", [1.0, 2.0], about)}, {"depth": ("depth", [0.0, 1.0])})
    bad.to_netcdf(tmp_path / "bad.nc")
    found = "\n".join(remarks([tmp_path / "bad.nc"])[tmp_path / "bad.nc"])
    for part in ("Conventions", "title", "florps", "no_such_name", "standard_name='depth'"):
        assert part in found
    assert main([tmp_path])
    assert capsys.readouterr().out.endswith("cf:1.11: 1 datasets, 1 with remarks\n")
    assert main([tmp_path / "none"])
