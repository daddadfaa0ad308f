"""Arguments of media and instruments: accepted types, and explained errors."""

from __future__ import annotations

import inspect
import itertools

import numpy as np
import pytest
import xarray as xr

import splits
from splits.core.keywords import reject_unknown_keywords
from splits.core.validation import check_integer, check_number, short_repr
from splits.simulation.run_options import check_beam_angle, check_incidence, check_wavelengths


@pytest.mark.parametrize("value", [30, 30.0, np.float32(30), np.array(30.0), xr.DataArray(30.0)])
def test_all_scalar_types_are_accepted(value):
    assert check_incidence(value) == check_beam_angle(value) == 30.0
    assert check_wavelengths(500.0 + 0 * value).tolist() == [500.0]
    assert splits.Snow(density_kg_m3=value * 10).density_kg_m3 == 300.0
    if not isinstance(value, float | np.float32) and np.asarray(value).dtype.kind == "i":
        assert check_integer("rays", value, 1) == 30


@pytest.mark.parametrize("value", [3, np.int64(3), np.array(3)])
def test_all_integer_types_are_accepted(value):
    assert check_integer("rays", value, 1) == 3


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("500", "wavelength_nm = '500': must be numbers in nanometres (write 500, "),
        (["500"], "wavelength_nm = '500': must be numbers in nanometres (write 500"),
        (np.array(["500"]), "wavelength_nm = '500': must be numbers in nanometres (write 500"),
        ([None], "wavelength_nm = None: must be numbers in nanometres"),
        (None, "wavelength_nm = None: must be numbers in nanometres"),
        (0.5, "wavelength_nm = 0.5: must be in [200, 100000] nm (in micrometres? write 500)"),
        ([0.4, 0.5], "wavelength_nm = 0.4: must be in [200, 100000] nm (in micrometres? "),
        (150, "wavelength_nm = 150.0: must be in [200, 100000] nm"),
        ([], "wavelength_nm = []: must be numbers in nanometres, at least one"),
        ([500, np.nan], "wavelength_nm = nan: must be numbers in nanometres"),
        ([10**400], "wavelength_nm = 1000"),
        ([[400, 500]], "wavelength_nm = [[400, 500]]: must be one row of numbers in nanometres"),
        ({"start": 400}, "wavelength_nm = {'start': 400}: must be numbers in nanometres"),
        (itertools.count(300), "must be at most 20000 numbers"),
    ],
)  # fmt: skip
def test_invalid_wavelengths_are_explained(value, message):
    with pytest.raises(ValueError) as error:
        check_wavelengths(value)
    assert str(error.value).startswith(message) or str(error.value).endswith(message)


def test_unsorted_wavelengths_are_reported_by_the_first_pair():
    values = [*range(400, 2500, 2), 2400]
    with pytest.raises(ValueError) as error:
        check_wavelengths(values)
    assert str(error.value) == (
        "wavelength_nm = [2498.0, 2400.0]: must be strictly increasing (numbers 1050 and 1051 of "
        "1051)"
    )


@pytest.mark.parametrize(
    ("value", "hint"),
    [
        ([0, 30], "one call for each angle, or an experiment with a grid"),
        (np.array([0.0, 30.0]), "one call for each angle, or an experiment with a grid"),
        ("30", "write 30, without quotes"),
        ("difuse", "did you mean diffuse?"),
    ],
)
def test_invalid_angles_get_a_hint(value, hint):
    for call in (
        lambda: splits.spectrophotometer(splits.Snow(), [500], value),
        lambda: splits.goniophotometer(splits.Snow(), [500], value),
    ):
        with pytest.raises(ValueError, match=r"^incidence_deg = ") as error:
            call()
        assert str(error.value).endswith(f"({hint})")


@pytest.mark.parametrize(
    ("medium", "keyword", "message"),
    [
        (splits.Snow, "grain_size", "(did you mean grain_size_um?)"),
        (splits.Snow, "ssa", "must be one of grain_size_um, facetness, sphericity, saturation"),
        (splits.Sand, "irn_oxide", "(did you mean iron_oxide?)"),
        (splits.ParticleLayer, "optical_depth", "must be one of optical_thickness"),
        (splits.Interpretation, "entri", "(did you mean entry_point?)"),
        (splits.SandInterpretation, "mixin", "(did you mean mixing?)"),
    ],
)
def test_unknown_keywords_are_reported_with_valid_ones(medium, keyword, message):
    with pytest.raises(TypeError, match=f"^{keyword}: unknown key") as error:
        medium(**{keyword: 1})
    assert message in str(error.value)


def test_media_keep_their_signatures():
    import inspect

    assert list(inspect.signature(splits.Snow).parameters)[:2] == ["grain_size_um", "facetness"]
    assert reject_unknown_keywords.__doc__


def test_values_in_messages_are_short_and_one_line():
    assert short_repr(list(range(10_000))) == "[0, 1, 2, 3, 4, 5, 6, 7, ...]"
    assert short_repr({"b": 1, "a": 2}) == "{'b': 1, 'a': 2}"
    assert short_repr(np.float64(1.5)) == "1.5"
    assert len(short_repr("x" * 10_000)) < 100
    assert "\n" not in short_repr(np.zeros((50, 50)))
    with pytest.raises(ValueError, match=r"^x = 1000") as error:
        check_number("x", 10**400)
    assert len(str(error.value)) < 200


def test_too_many_wavelengths_for_memory_are_rejected():
    wavelengths = np.arange(300.0, 10_300.0)
    with pytest.raises(ValueError, match=r"^wavelength_nm = '10000 wavelengths': must be at most"):
        splits.goniophotometer(splits.Snow(), wavelengths[:10_000])


def test_too_many_independent_wavelengths_are_rejected():
    wavelengths = np.arange(400.0, 2500.0, 0.5)
    with pytest.raises(ValueError, match=r"^wavelength_nm = '4200 wavelengths': must be at most"):
        splits.spectrophotometer(splits.Snow(), wavelengths, max_stderr=1e-6, max_rays=1)


@pytest.mark.parametrize(
    ("instrument", "misspelt", "suggestion"),
    [
        (splits.spectrophotometer, "incidence", "incidence_deg"),
        (splits.goniophotometer, "relative_error", "relative_stderr"),
        (splits.irradiance_profile, "depths_m", "depth_m"),
        (splits.single_scattering, "ray", "rays"),
        (splits.albedo, "band", "bands"),
    ],
)
def test_misspelt_arguments_of_instruments_get_a_suggestion(instrument, misspelt, suggestion):
    with pytest.raises(TypeError, match=rf"^{misspelt}: unknown key.*did you mean {suggestion}\?"):
        instrument(splits.Snow(), [500.0], **{misspelt: 1})
    assert suggestion in inspect.signature(instrument).parameters
