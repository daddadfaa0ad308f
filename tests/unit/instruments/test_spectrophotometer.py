"""The public spectrophotometer function: results, attributes and invalid arguments."""

from __future__ import annotations

import json

import numpy as np
import pytest

import splits
from splits.core.provenance import hash_physics_sources

QUANTITIES = ("reflectance", "transmittance", "absorptance")
WAVELENGTHS = [500.0, 1030.0, 1500.0]
THIN_SNOW = splits.Snow(depth_m=0.001)
INVALID_CALLS = [
    ("wavelength_nm", 100, "in [200, 100000] nm"),
    ("wavelength_nm", [500, 1e6], "in [200, 100000] nm"),
    ("wavelength_nm", [], "numbers in nanometres, at least one"),
    ("wavelength_nm", [600.0, 500.0], "strictly increasing"),
    ("wavelength_nm", [500.0, 500.0], "strictly increasing"),
    ("wavelength_nm", [500.0, float("nan")], "numbers in nanometres"),
    ("wavelength_nm", "green", "numbers in nanometres"),
    ("incidence_deg", 90, "in [0, 89.9999] degrees"),
    ("incidence_deg", -1, "in [0, 89.9999] degrees"),
    ("incidence_deg", None, "in [0, 89.9999] degrees"),
    ("incidence_deg", "difuse", "did you mean diffuse?"),
    ("max_stderr", 0, "in [1e-06, 0.5]"),
    ("max_stderr", 0.6, "in [1e-06, 0.5]"),
    ("seed", -1, "a whole number of at least 0"),
    ("seed", True, "a whole number of at least 0"),
    ("seed", 1.0, "a whole number of at least 0"),
    ("seed", 2**63, "a whole number from 0 to 9223372036854775807"),
    ("max_rays", 0, "a whole number of at least 1"),
    ("threads", 0, "a whole number of at least 1"),
    ("estimator", "spektral", "did you mean spectral?"),
    ("kernel", "vector", "did you mean vectorized?"),
]


def measure(**changes):
    settings = {"wavelength_nm": WAVELENGTHS, "max_stderr": 0.5, "threads": 1, **changes}
    return splits.spectrophotometer(THIN_SNOW, **settings)


@pytest.fixture(scope="module", params=["spectral", "analog"])
def measured(request):
    return measure(estimator=request.param, incidence_deg="diffuse")


def test_variables_and_dimensions(measured):
    batches = {"reflectance_batches", "transmittance_batches"}
    values = {q + s for q in QUANTITIES for s in ("", "_stderr")}
    assert set(measured.data_vars) == values | batches
    assert all(measured[name].dims == ("wavelength",) for name in values)
    assert all(measured[name].dims == ("batch", "wavelength") for name in batches)
    np.testing.assert_array_equal(measured.wavelength, WAVELENGTHS)


def test_energy_is_conserved(measured):
    total = sum(measured[quantity] for quantity in QUANTITIES)
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    for quantity in QUANTITIES:
        assert ((measured[quantity] >= 0.0) & (measured[quantity] <= 1.0)).all()
        assert (measured[f"{quantity}_stderr"] >= 0.0).all()
    assert measured.attrs["max_stderr_reached"] <= 0.5


def test_all_variables_have_units_and_names(measured):
    for name, variable in measured.variables.items():
        assert variable.attrs["units"] == ("nm" if name == "wavelength" else "1")
        assert variable.attrs["long_name"]
    for quantity in QUANTITIES:
        assert measured[quantity].attrs["ancillary_variables"] == f"{quantity}_stderr"
    assert "hemispherical-hemispherical" in measured.reflectance.attrs["long_name"]


def test_attributes_record_inputs_and_provenance(measured):
    attributes = measured.attrs
    assert {f"snow_{key}" for key in THIN_SNOW.describe()} <= set(attributes)
    for key, value in {"incidence_deg": "diffuse", "max_stderr": 0.5, "seed": 1}.items():
        assert attributes[key] == value
    for key in ("Conventions", "source", "splits_version", "splits_commit", "date_created"):
        assert attributes[key]
    assert attributes["physics_sources_sha256"] == hash_physics_sources()
    assert attributes["threads"] == 1
    assert attributes["stop_reason"] == "converged"
    assert attributes["rays"] > 0


def test_results_are_saved_and_loaded(measured, tmp_path):
    splits.save(measured, tmp_path / "measured.nc")
    loaded = splits.load(tmp_path / "measured.nc")
    assert loaded.equals(measured)
    assert set(loaded.attrs) == set(measured.attrs)
    assert json.dumps({k: str(v) for k, v in loaded.attrs.items()})


def test_a_scalar_wavelength_gives_one_value():
    spectrum = measure(wavelength_nm=500)
    assert spectrum.wavelength.values.tolist() == [500.0]
    assert spectrum.reflectance.attrs["long_name"] == "directional-hemispherical reflectance"


def test_results_are_determined_by_the_seed():
    first, repeated, other = (measure(seed=seed) for seed in (1, 1, 2))
    assert first.equals(repeated)
    assert not first.equals(other)


def test_progress_is_reported():
    reports = []
    measure(progress=reports.append)
    assert reports
    assert reports[0].target == 0.5
    assert reports[0].rays > 0


def test_the_maximum_of_rays_stops_the_run():
    stopped = measure(max_stderr=1e-6, max_rays=1)
    assert stopped.attrs["stop_reason"] == "max_rays"
    assert stopped.attrs["max_stderr_reached"] > 1e-6


@pytest.mark.parametrize(("key", "value", "allowed"), INVALID_CALLS)
def test_invalid_arguments_are_rejected_with_key_and_range(key, value, allowed):
    with pytest.raises(ValueError, match=f"^{key} = ") as error:
        measure(**{key: value})
    assert allowed in str(error.value)
    assert "\n" not in str(error.value)


def test_wavelengths_outside_the_tables_are_rejected():
    with pytest.raises(ValueError, match=r"wavelength_nm = 250\.0.*\[300, .*oscillators"):
        splits.spectrophotometer(splits.Sand(), [250.0, 500.0])
