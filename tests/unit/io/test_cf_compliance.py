"""Datasets of instruments and skies follow the CF conventions."""

import pytest
import xarray as xr
from compliance import collect_remarks, main

import splits

SNOW = splits.Snow(depth_m=0.01)
GREY_GROUND = splits.Snow(depth_m=0.01, impurities_ng_g={"black_carbon": 100})
STACK = splits.Stack([SNOW, splits.Sand(depth_m=0.004)], ground=0.3, interpretation="geometric")
SKY = "midlatitude_winter"
EXAMPLES = {
    "irradiance_profile": lambda: splits.irradiance_profile(
        STACK, [500, 900], depth_m=[0.002, 0.012], max_stderr=0.2
    ),
    "single": lambda: splits.single_scattering(SNOW, [500, 900], moments=8, rays=2000),
    "several media": lambda: splits.spectrophotometer(
        {"clean": SNOW, "grey": GREY_GROUND}, [500, 900], max_stderr=0.2
    ),
    "albedo": lambda: splits.albedo(
        SNOW, SKY, [600, 650, 700], max_stderr=0.2, bands={"red": (600, 700)}
    ),
    "hdrf": lambda: splits.hdrf(
        SNOW, SKY, [500], relative_stderr=0.5, polar_deg=[0, 30], azimuth_deg=[0, 180]
    ),
    "inside": lambda: splits.radiation_profile(
        STACK,
        SKY,
        [500, 900, 1200],
        depth_m=[0.002, 0.012],
        max_stderr=0.3,
        total_w_m2=300.0,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_datasets_follow_the_cf_conventions(name, tmp_path):
    path = tmp_path / f"{name}.nc"
    splits.save(EXAMPLES[name](), path)
    assert collect_remarks([path]) == {path: []}


def test_violations_of_the_cf_conventions_are_found(tmp_path, capsys):
    attributes = {"units": "florps", "standard_name": "no_such_name"}
    invalid = xr.Dataset({"a": ("depth", [1.0, 2.0], attributes)}, {"depth": ("depth", [0.0, 1.0])})
    invalid.to_netcdf(tmp_path / "bad.nc")
    remarks = "\n".join(collect_remarks([tmp_path / "bad.nc"])[tmp_path / "bad.nc"])
    for text in ("Conventions", "title", "florps", "no_such_name", "standard_name='depth'"):
        assert text in remarks
    assert main([tmp_path])
    assert capsys.readouterr().out.endswith("cf:1.11: 1 datasets, 1 with remarks\n")
    assert main([tmp_path / "none"])
