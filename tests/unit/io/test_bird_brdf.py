"""BRDFs in the universal BRDF format, compared to its schema and its example."""

from __future__ import annotations

import json

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from constructed_results import AUTHOR, make_brdf

import splits
from splits.core.validation import InvalidValue

METADATA = {"schema", "id", "type", "timestamp", "provenance", "license", "description", "method",
            "instrumentation", "software", "sample", "environment", "data_links", "comments",
            "adhoc_section"}  # fmt: skip
"""What the schema allows."""
PARAMETER = {"name", "symbol", "description", "value", "unit", "uncertainty", "uncertainty_unit",
             "data_links", "comments", "adhoc_section"}  # fmt: skip
ANGLES = {"theta_i": 90.0, "phi_i": 360.0, "theta_r": 90.0, "phi_r": 360.0}
"""Exclusive upper bounds of angles in degrees."""


def written(tmp_path, *datasets, **keywords):
    splits.save_brdf(list(datasets), tmp_path / "snow.brdf", AUTHOR, **keywords)
    return json.loads((tmp_path / "snow.brdf").read_text(encoding="utf-8"))


def test_it_holds_what_the_format_asks_for_and_nothing_else(tmp_path):
    found = written(
        tmp_path, make_brdf(30.0), license={"type": "CC-BY-4.0", "rights_holder": "Ada"}
    )
    assert set(found) == {"metadata", "data"}
    about, data = found["metadata"], found["data"]
    needed = {"schema", "id", "type", "timestamp", "provenance", "method", "instrumentation",
              "software", "sample", "environment"}  # fmt: skip
    assert needed <= set(about) <= METADATA
    assert (about["type"], about["method"]) == ("BRDF", "simulation")
    assert (about["instrumentation"], about["environment"]) == ("NA", "NA")
    assert set(about["software"]) >= {"name", "version", "simulation_model"}
    model = about["software"]["simulation_model"]
    assert {"name", "description"} <= set(model)
    for one in model["parameters"]:
        assert {"name", "description", "value", "unit"} <= set(one) <= PARAMETER
        assert isinstance(one["value"], float)
    (asymmetry,) = [p for p in model["parameters"] if p["name"].startswith("asymmetry")]
    assert (asymmetry["value"], asymmetry["uncertainty"]) == (0.678, 0.001)
    assert model["adhoc_section"] == {
        "facetness": [0.2, 0.4],
        "interpretation_entry_point": "uniform",
    }
    assert data["BRDF"]["unit"] == data["uBRDF"]["unit"] == "sr^-1"
    assert data["wavelength_i"]["unit"] == "nm"
    count = len(data["BRDF"]["values"])
    for name, column in data.items():
        assert len(column["values"]) == count, name
    for name, below in ANGLES.items():
        assert data[name]["unit"] == "deg"
        assert all(0.0 <= value < below for value in data[name]["values"])
    for name in ("polarization_i", "polarization_r"):
        assert data[name]["notation"] == "sp" and set(data[name]["values"]) == {"u"}


def test_each_line_is_a_value_of_its_dataset(tmp_path):
    given = [make_brdf(0.0), make_brdf(60.0)]
    data = written(tmp_path, *given)["data"]
    columns = [data[n]["values"] for n in ("wavelength_i", "theta_i", "theta_r", "phi_r", "BRDF",
                                           "uBRDF")]  # fmt: skip
    lines = list(zip(*columns, strict=True))
    assert len(lines) == sum(ds.brdf.size for ds in given)
    for w, incidence, polar, azimuth, f, u in lines:
        (ds,) = [ds for ds in given if ds.attrs["incidence_deg"] == incidence]
        # 0 is the side of the source here, and forward there.
        ours = ds.sel(wavelength=w, polar=polar, azimuth=(azimuth + 180.0) % 360.0)
        assert f == pytest.approx(float(ours.brdf), rel=1e-5) and u == 0.003
    forward = [f for w, i, p, a, f, u in lines if (w, i, p, a) == (600.0, 60.0, 70.0, 180.0)]
    back = [f for w, i, p, a, f, u in lines if (w, i, p, a) == (600.0, 60.0, 70.0, 0.0)]
    assert forward > back


def test_a_polarizer_takes_its_part(tmp_path):
    ds = make_brdf(30.0)
    ds["brdf_q"], ds["brdf_q_stderr"] = 0.2 * ds.brdf, 0.5 * ds.brdf_stderr
    data = written(tmp_path, ds)["data"]
    parts = {
        state: np.array([f for f, s in zip(data["BRDF"]["values"], data["polarization_r"]["values"],
                                           strict=True) if s == state])
        for state in "usp"
    }  # fmt: skip
    # Our Q is positive along the plane that holds the normal: p.
    np.testing.assert_allclose(parts["p"], 0.6 * parts["u"], rtol=1e-5)
    np.testing.assert_allclose(parts["s"], 0.4 * parts["u"], rtol=1e-5)


def test_negative_noise_is_left_out_and_counted(tmp_path):
    ds = make_brdf(30.0)
    ds.brdf[0, 2, 1] = -0.001
    found = written(tmp_path, ds)
    assert len(found["data"]["BRDF"]["values"]) == ds.brdf.size - 1
    assert "negative: 1." in found["metadata"]["comments"]


@NEEDS_JIT
def test_what_a_goniophotometer_measures_can_be_written(tmp_path):
    beam = {"relative_stderr": 0.5, "polar_deg": [0.0, 40.0], "azimuth_deg": [0.0, 180.0]}
    for number, medium in enumerate((
        splits.Snow.natural(specific_surface_area_m2_kg=20.0, depth_m=0.02),
        splits.Stack([splits.Snow(depth_m=0.02), splits.Snow(depth_m=0.03)]),
    )):  # fmt: skip
        ds = splits.goniophotometer(medium, [1300.0], 30.0, **beam)
        splits.save_brdf(ds, tmp_path / f"{number}.json", AUTHOR)
        found = json.loads((tmp_path / f"{number}.json").read_text(encoding="utf-8"))
        parameters = found["metadata"]["software"]["simulation_model"]["parameters"]
        units = {one["name"]: one["unit"] for one in parameters}
        name = "depth_m" if number == 0 else "layers_1_mean_grain_distance_m"
        assert units[name] == "m"


@pytest.mark.parametrize(
    ("datasets", "changes", "line"),
    [
        ([], {}, "datasets = "),
        ([make_brdf(0.0), make_brdf(30.0, snow_depth_m=0.2)], {}, "datasets = 'another medium'"),
        ([make_brdf(0.0).drop_vars("brdf")], {}, "datasets = 'BRDF'"),
        (
            [make_brdf(30.0), make_brdf(30.0)],
            {},
            r"datasets = \[30.0, 30.0\]: must be of different",
        ),
        ([make_brdf(0.0)], {"path": "snow.nc"}, "path = 'snow.nc'"),
        ([make_brdf(0.0)], {"provenance": {"email": "a@b.org"}}, "provenance = .*organization"),
        ([make_brdf(0.0)], {"license": {"type": "MIT"}}, "license = .*rights_holder"),
    ],
)
def test_what_the_format_cannot_hold_is_rejected(datasets, changes, line):
    given = {"path": "snow.brdf", "provenance": AUTHOR, "license": None, **changes}
    with pytest.raises(InvalidValue, match=f"^{line}"):
        splits.save_brdf(datasets, **given)
