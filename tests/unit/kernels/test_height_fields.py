"""Rough surfaces: invalid input, correlations and slopes."""

import math

import numpy as np
import pytest
import yaml
from rough_surfaces import GAUSSIAN, SPECTRUM, TABLE, TABULATED
from scipy import integrate, special

from splits.kernels.rough_surface import realization
from splits.media.rough_surface import HEIGHT_SPECTRA, RandomHeightField, RoughSurface

INVALID_SURFACES = [
    ("rms_height_m", -0.1, "in [0, 1e+06] m"),
    ("rms_height_m", "1e-1", "write 0.1, without quotes"),
    ("wave_number_per_m", 0.0, "in [1e-09, 1e+09] 1/m"),
    ("wave_number_per_m", None, "given (1/m)"),
    ("correlation", "gausian", "did you mean gaussian?"),
    ("waves", 0, "a whole number from 1 to 100000"),
    ("waves", 100_001, "a whole number from 1 to 100000"),
    ("waves", 8.0, "a whole number from 1 to 100000"),
    ("waves", True, "a whole number from 1 to 100000"),
    ("band_limit_per_m", 0.0, "at least 0.001 1/m"),
    ("band_limit_per_m", float("nan"), "at least 0.001 1/m"),
    ("band_limit_per_m", None, "give the largest wave number of the surface, or infinity"),
    ("spectrum", TABLE, 'left out unless correlation is "spectrum"'),
]
INVALID_TABLES = [
    (None, "spectrum = None: must be a mapping"),
    ({"wave_number_per_m": [1.0, 2.0]}, "must be a mapping"),
    (TABLE | {"density": [1.0, 2.0]}, "3 wave_number_per_m, 2 density"),
    (TABLE | {"density": [1.0, "x", 2.0]}, "spectrum.density = 'x': must be numbers"),
    (TABLE | {"density": [1.0, -1.0, 2.0]}, "spectrum.density = -1.0: must be at least 0"),
    (TABLE | {"density": [0.0, 0.0, 0.0]}, "spectrum.density = .*0 or more"),
    (TABLE | {"wave_number_per_m": [1.0, 1.0, 2.0]}, "spectrum.wave_number_per_m = .*increasing"),
    ({"wave_number_per_m": [1.0], "density": [1.0]}, "at least 2"),
]


@pytest.mark.parametrize(("key", "value", "allowed"), INVALID_SURFACES)
def test_invalid_values_are_rejected_with_key_and_range(key, value, allowed):
    valid = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "band_limit_per_m": 10.0}
    with pytest.raises(ValueError, match=f"^{key} = ") as error:
        RandomHeightField(**valid | {key: value})
    assert repr(value) in str(error.value) and allowed in str(error.value)


@pytest.mark.parametrize(("table", "message"), INVALID_TABLES)
def test_invalid_spectra_are_rejected(table, message):
    with pytest.raises(ValueError, match=message):
        RandomHeightField(0.1, correlation="spectrum", spectrum=table)


@pytest.mark.parametrize("key", ["wave_number_per_m", "band_limit_per_m"])
def test_spectrum_excludes_scale_and_band_limit(key):
    with pytest.raises(ValueError, match=rf"{key} = 1.0: must be left out"):
        RandomHeightField(**SPECTRUM | {key: 1.0})


def test_errors_name_the_field():
    with pytest.raises(ValueError, match=r"^surface\[1\]\.waves = 0"):
        RoughSurface([GAUSSIAN, GAUSSIAN | {"waves": 0}])
    with pytest.raises(ValueError, match=r"^surface\.waves = 0"):
        RoughSurface(GAUSSIAN | {"waves": 0})
    with pytest.raises(ValueError, match="did you mean rms_height_m"):
        RoughSurface({"rms_heigth_m": 1.0})
    with pytest.raises(ValueError, match=r"surface\.rms_height_m = None"):
        RoughSurface({"waves": 3})
    for invalid in ("sea", 3.0, []):
        with pytest.raises(ValueError, match=r"^surface = .*one field, or a list of fields"):
            RoughSurface.from_input(invalid)


def test_surfaces_are_made_from_yaml():
    text = """
    - {rms_height_m: 11.25, wave_number_per_m: 0.025, waves: 500, band_limit_per_m: .inf}
    - {rms_height_m: 0.2, wave_number_per_m: 3, correlation: gaussian}
    """
    surface = RoughSurface.from_input(yaml.safe_load(text))
    assert RoughSurface.from_input(surface) is surface
    assert surface == RoughSurface(surface.fields)
    assert surface.rms_height_m == pytest.approx(math.hypot(11.25, 0.2), rel=1e-15)
    attributes = surface.describe()
    assert attributes["waves"] == [500, 64]
    assert attributes["band_limit_per_m"] == [math.inf, math.inf]
    assert attributes["correlation"] == "exponential, gaussian"
    assert attributes["rms_slope"] == math.inf
    assert RoughSurface(SPECTRUM).describe()["spectrum_density"] == TABLE["density"]
    with pytest.raises(AttributeError):
        surface.fields = ()


@pytest.mark.parametrize("name", HEIGHT_SPECTRA)
@pytest.mark.parametrize("limit", [0.5, 3.0, 10.0])
def test_expectations_match_the_sampled_wave_numbers(name, limit):
    field = RandomHeightField(0.3, 2.0, name, band_limit_per_m=2.0 * limit)
    height_fields = RoughSurface(field).make_height_fields()

    def sample_wave_number(u):
        return realization.wave_number_quantile(height_fields, 0, u)

    # Probability 1 gives the band limit.
    assert sample_wave_number(1.0) == pytest.approx(2.0 * limit, rel=1e-6)
    for r in (0.0, 0.3, 2.0):
        mean = integrate.quad(
            lambda u, r=r: special.j0(sample_wave_number(u) * r), 0, 1, limit=2000
        )[0]
        assert field.compute_correlation(r) == pytest.approx(mean, abs=1e-8)
    square = integrate.quad(lambda u: sample_wave_number(u) ** 2, 0, 1, limit=2000)[0]
    assert RoughSurface(field).rms_slope() == pytest.approx(0.3 * math.sqrt(square), rel=1e-8)


@pytest.mark.parametrize("name", HEIGHT_SPECTRA)
def test_a_large_band_limit_equals_none(name):
    r = np.array([0.0, 0.1, 1.0, 3.0])
    limited, unlimited = (
        RandomHeightField(1.0, 2.0, name, band_limit_per_m=limit).compute_correlation(r)
        for limit in (2e5, math.inf)
    )
    # The limit truncates a fraction k0/limit of the spectrum of exp(−k0 r).
    np.testing.assert_allclose(limited, unlimited, atol=1.1e-5)


def test_printed_correlation_is_not_exponential():
    assert RoughSurface(TABULATED).correlation(10.0) == pytest.approx(0.7615975857, abs=1e-9)
    assert RoughSurface(TABULATED).rms_slope() == math.inf


def test_correlation_and_slope_of_a_gaussian_spectrum():
    k = np.linspace(0.0, 14.0, 2001)
    field = RandomHeightField(
        0.5, correlation="spectrum",
        spectrum={"wave_number_per_m": k, "density": np.exp(-0.25 * k * k)},
    )  # fmt: skip
    r = np.array([[0.0, 0.5], [1.0, 2.0]])
    np.testing.assert_allclose(RoughSurface(field).correlation(r), np.exp(-r * r), atol=3e-6)
    assert RoughSurface(field).rms_slope() == pytest.approx(1.0, rel=1e-4)


def test_zero_density_is_not_sampled():
    table = {"wave_number_per_m": [0, 1, 2, 3, 4, 5], "density": [0, 0, 1, 0, 0, 0]}
    quantiles = RandomHeightField(1.0, correlation="spectrum", spectrum=table).wave_number_quantiles
    assert 1.0 <= quantiles[0] < 1.01 and 2.99 < quantiles[-1] <= 3.0
    assert (np.diff(quantiles) > 0.0).all()


def test_fields_superpose():
    r = np.array([0.0, 0.1, 1.0])
    one, other = RoughSurface(TABULATED), RoughSurface(GAUSSIAN)
    sum_of_fields = RoughSurface([TABULATED, GAUSSIAN])
    fractions = np.array([4.0, 0.25]) / 4.25
    np.testing.assert_allclose(
        sum_of_fields.correlation(r),
        fractions @ [one.correlation(r), other.correlation(r)],
        rtol=1e-14,
    )
    plane = RoughSurface(GAUSSIAN | {"rms_height_m": 0})
    assert (plane.correlation(r) == 1.0).all() and plane.rms_slope() == 0.0
