"""BRDFs in the universal BRDF format, compared with its schema and its example."""

from __future__ import annotations

import json

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from constructed_results import AUTHOR, make_brdf

import splits
from splits.core.validation import InvalidValue

ALLOWED_METADATA = {
    "schema", "id", "type", "timestamp", "provenance", "license", "description", "method",
    "instrumentation", "software", "sample", "environment", "data_links", "comments",
    "adhoc_section",
}  # fmt: skip
"""Entries of the metadata that the schema allows."""
PARAMETER = {"name", "symbol", "description", "value", "unit", "uncertainty", "uncertainty_unit",
             "data_links", "comments", "adhoc_section"}  # fmt: skip
ANGLES = {"theta_i": 90.0, "phi_i": 360.0, "theta_r": 90.0, "phi_r": 360.0}
"""Exclusive upper bounds of angles in degrees."""


def write_brdf(tmp_path, *datasets, **keywords):
    splits.save_brdf(list(datasets), tmp_path / "snow.brdf", AUTHOR, **keywords)
    return json.loads((tmp_path / "snow.brdf").read_text(encoding="utf-8"))


def test_files_have_the_required_and_allowed_entries(tmp_path):
    content = write_brdf(
        tmp_path, make_brdf(30.0), license={"type": "CC-BY-4.0", "rights_holder": "Ada"}
    )
    assert set(content) == {"metadata", "data"}
    metadata, data = content["metadata"], content["data"]
    required = {"schema", "id", "type", "timestamp", "provenance", "method", "instrumentation",
              "software", "sample", "environment"}  # fmt: skip
    assert required <= set(metadata) <= ALLOWED_METADATA
    assert (metadata["type"], metadata["method"]) == ("BRDF", "simulation")
    assert (metadata["instrumentation"], metadata["environment"]) == ("NA", "NA")
    assert set(metadata["software"]) >= {"name", "version", "simulation_model"}
    assert set(metadata["sample"]) >= {
        "name", "type", "dimensions", "shape", "zero_azimuth_location",
    }  # fmt: skip
    model = metadata["software"]["simulation_model"]
    assert {"name", "description"} <= set(model)
    for parameter in model["parameters"]:
        assert {"name", "description", "value", "unit"} <= set(parameter) <= PARAMETER
        assert isinstance(parameter["value"], float)
    (asymmetry,) = [p for p in model["parameters"] if p["name"].startswith("asymmetry")]
    assert (asymmetry["value"], asymmetry["uncertainty"]) == (0.678, 0.001)
    assert model["adhoc_section"] == {
        "facetness": [0.2, 0.4],
        "interpretation_entry_point": "uniform",
    }
    assert data["BRDF"]["unit"] == data["uBRDF"]["unit"] == "sr^-1"
    assert data["wavelength_i"]["unit"] == "nm"
    n_lines = len(data["BRDF"]["values"])
    for name, column in data.items():
        assert len(column["values"]) == n_lines, name
    for name, upper in ANGLES.items():
        assert data[name]["unit"] == "deg"
        assert all(0.0 <= value < upper for value in data[name]["values"])
    for name in ("polarization_i", "polarization_r"):
        assert data[name]["notation"] == "sp" and set(data[name]["values"]) == {"u"}


def test_each_line_is_a_value_of_a_dataset(tmp_path):
    datasets = [make_brdf(0.0), make_brdf(60.0)]
    data = write_brdf(tmp_path, *datasets)["data"]
    columns = [data[n]["values"] for n in ("wavelength_i", "theta_i", "theta_r", "phi_r", "BRDF",
                                           "uBRDF")]  # fmt: skip
    lines = list(zip(*columns, strict=True))
    assert len(lines) == sum(ds.brdf.size for ds in datasets)
    for w, incidence, polar, azimuth, f, u in lines:
        (ds,) = [ds for ds in datasets if ds.attrs["incidence_deg"] == incidence]
        # Azimuth 0 is on the side of the source in the format, and forward in the dataset.
        expected = ds.sel(wavelength=w, polar=polar, azimuth=(azimuth + 180.0) % 360.0)
        assert f == pytest.approx(float(expected.brdf), rel=1e-5) and u == 0.003
    forward = [f for w, i, p, a, f, u in lines if (w, i, p, a) == (600.0, 60.0, 70.0, 180.0)]
    backward = [f for w, i, p, a, f, u in lines if (w, i, p, a) == (600.0, 60.0, 70.0, 0.0)]
    assert forward > backward


def test_polarized_incidence_is_rejected(tmp_path):
    """The format has no Stokes vector of the incident light."""
    ds = make_brdf(30.0).assign_attrs(incident_stokes=[1.0, 0.0, 1.0, 0.0])
    with pytest.raises(InvalidValue, match="of unpolarized incident light"):
        write_brdf(tmp_path, ds)


def test_polarized_brdfs_are_fractions_of_the_total(tmp_path):
    ds = make_brdf(30.0)
    ds["brdf_q"], ds["brdf_q_stderr"] = 0.2 * ds.brdf, 0.5 * ds.brdf_stderr
    data = write_brdf(tmp_path, ds)["data"]
    brdf = {
        state: np.array([f for f, s in zip(data["BRDF"]["values"], data["polarization_r"]["values"],
                                           strict=True) if s == state])
        for state in "usp"
    }  # fmt: skip
    # Q is positive for polarization in the plane that contains the normal: p.
    np.testing.assert_allclose(brdf["p"], 0.6 * brdf["u"], rtol=1e-5)
    np.testing.assert_allclose(brdf["s"], 0.4 * brdf["u"], rtol=1e-5)


def test_negative_values_are_omitted_and_counted(tmp_path):
    ds = make_brdf(30.0)
    ds.brdf[0, 2, 1] = -0.001
    content = write_brdf(tmp_path, ds)
    assert len(content["data"]["BRDF"]["values"]) == ds.brdf.size - 1
    assert "negative: 1." in content["metadata"]["comments"]


@NEEDS_JIT
def test_goniophotometer_results_can_be_written(tmp_path):
    settings = {"relative_stderr": 0.5, "polar_deg": [0.0, 40.0], "azimuth_deg": [0.0, 180.0]}
    for number, medium in enumerate((
        splits.Snow.natural(specific_surface_area_m2_kg=20.0, depth_m=0.02),
        splits.Stack([splits.Snow(depth_m=0.02), splits.Snow(depth_m=0.03)]),
    )):  # fmt: skip
        ds = splits.goniophotometer(medium, [1300.0], 30.0, **settings)
        splits.save_brdf(ds, tmp_path / f"{number}.json", AUTHOR)
        content = json.loads((tmp_path / f"{number}.json").read_text(encoding="utf-8"))
        parameters = content["metadata"]["software"]["simulation_model"]["parameters"]
        units = {parameter["name"]: parameter["unit"] for parameter in parameters}
        name = "depth_m" if number == 0 else "layers_1_mean_grain_distance_m"
        assert units[name] == "m"


@pytest.mark.parametrize(
    ("datasets", "changes", "message"),
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
def test_unsupported_datasets_are_rejected(datasets, changes, message):
    arguments = {"path": "snow.brdf", "provenance": AUTHOR, "license": None, **changes}
    with pytest.raises(InvalidValue, match=f"^{message}"):
        splits.save_brdf(datasets, **arguments)
