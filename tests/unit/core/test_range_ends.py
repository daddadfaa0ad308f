"""Values outside a range by rounding are set to its limit; others are rejected."""

from __future__ import annotations

import math

import numpy as np
import pytest
from array_inputs import FIXED, SIZE, SOOT, TABLE, user_index
from chi2 import NEEDS_JIT
from formula_tables import W, evaluate_spectrum, make_table

import splits
from splits.analysis.colour import covers_visible
from splits.core.validation import InvalidValue, check_range, snap_to_limits
from splits.materials import make_refractive_index
from splits.simulation.run_options import check_direction_angles, check_wavelengths

NARROW_TABLE = make_table(
    lambda size, _: evaluate_spectrum(size, 0.0),
    {SIZE: [50.0, 100.0], "incidence_deg": [30.0, 60.0]},
)
SKY = {"wavelength_nm": [400.0, 800.0], "direct": [1.0, 1.0], "diffuse": [1.0, 1.0]}
MEASURED = (W, evaluate_spectrum(200.0, 64.0))


def interp(table=TABLE, **point):
    return table.interp(**point).reflectance.values


def shift_relative(value, error):
    """Return a value with a relative error, or with an error of 1e-3 of that at 0."""
    return value * (1.0 + error) if value else 1e-3 * error


RANGE_ENDS = {
    "Snow.saturation": (lambda x: splits.Snow(saturation=x).saturation, 1.0, 1),
    "Snow.saturation low": (lambda x: splits.Snow(saturation=x).saturation, 0.0, -1),
    "Snow.temperature_c": (lambda x: splits.Snow(temperature_c=x).temperature_c, -40.0, -1),
    "Snow.depth_m": (lambda x: splits.Snow(depth_m=x).depth_m, 1e4, 1),
    "Snow.facetness": (lambda x: splits.Snow(facetness=(0, x, 0.5, 0.1)).facetness[1], 1.0, 1),
    "Snow.grain_size_um": (lambda x: splits.Snow(grain_size_um=(x, 50)).grain_size_um[0], 1.0, -1),
    "Snow.ground": (lambda x: splits.Snow(ground=x).ground.albedo_values, 1.0, 1),
    "ground.albedo": (
        lambda x: splits.Snow(
            ground={"wavelength_nm": [300, 900], "albedo": [x, 0]}).ground.albedo_values,
        1.0, 1),
    "Sand.roundness": (lambda x: splits.Sand(roundness=(x, 0.1)).roundness[0], 1.0, 1),
    "Sand.partition": (lambda x: splits.Sand(partition=(0, x, 0)).partition[1], 1.0, 1),
    "Sand.texture": (lambda x: splits.Sand(texture=(x, 0, 1)).texture[0], 0.0, -1),
    "ParticleLayer.asymmetry": (lambda x: splits.ParticleLayer(asymmetry=x).asymmetry, 0.999, 1),
    "ParticleLayer.phase_function": (
        lambda x: splits.ParticleLayer(
            phase_function={"cosine": [x, 1], "density": [1, 1]}).kernel_phase_function.cosines,
        -1.0, 1),
    "refractive_index": (lambda x: make_refractive_index("quartz")(x), 198.0, -1),
    "user index": (lambda x: user_index()[0][0] and make_refractive_index("ice", {
        "wavelength_nm": [400, 800], "n": [1.3, 1.4], "k": [0, 0]})(x), 800.0, 1),
    "wavelength_nm": (check_wavelengths, 200.0, -1),
    "polar_deg": (lambda x: check_direction_angles("polar_deg", [x], 90.0), 0.0, -1),
    "sky": (lambda x: splits.sky(SKY, 50).compute_direct_fraction(np.array([x])), 800.0, 1),
    "zenith_deg": (lambda x: splits.sky(SKY, x).zenith_deg, 89.0, 1),
    "Table.interp": (lambda x: interp(NARROW_TABLE, incidence_deg=x, **{SIZE: 60}), 30.0, -1),
    "Table.interp root": (lambda x: interp(**FIXED | {SOOT: x, SIZE: 60}), 0.0, -1),
    "Table.interp wavelength": (
        lambda x: interp(**FIXED, wavelength=x, **{SIZE: 60}), 1500.0, 1),
    "Table.derivatives": (
        lambda x: NARROW_TABLE.derivatives(
            [SIZE], incidence_deg=60, **{SIZE: x}).reflectance_jacobian,
        50.0, -1),
    "Table.interp bands": (
        lambda x: TABLE.interp(bands={"a": (x, 600)}, **FIXED, **{SIZE: 60}).band_reflectance,
        500.0, -1),
    "retrieve": (
        lambda x: splits.retrieve(
            ([x, 700], [0.9, 0.8]), TABLE, [SIZE], 0.1, fixed=FIXED).values[SIZE],
        500.0, -1),
    "retrieve fixed": (
        lambda x: splits.retrieve(
            MEASURED, TABLE, [SIZE], 0.1, fixed={SOOT: 64.0, "sza": x}).values[SIZE], 60.0, 1),
    "retrieve free": (
        lambda x: splits.retrieve(MEASURED, TABLE, {SIZE: (x, 800)}, 0.1, fixed=FIXED).values[SIZE],
        40.0, -1),
    "retrieve prior": (
        lambda x: splits.retrieve(
            MEASURED, TABLE, [SIZE], 0.1, fixed=FIXED, prior={SIZE: (x, 200)}).values[SIZE],
        2000.0, 1),
}  # fmt: skip
"""The result for a value, the end of its range, and the side of this end."""


@pytest.mark.parametrize("name", RANGE_ENDS)
def test_rounding_errors_at_range_ends_are_snapped(name):
    call, end, side = RANGE_ENDS[name]
    sign = side * math.copysign(1.0, end) if end else side
    error = 4.0 * np.finfo(float).eps if end else 1e-10
    rounded, outside = shift_relative(end, sign * error), shift_relative(end, sign * 1e-6)
    assert rounded != end
    np.testing.assert_array_equal(call(rounded), call(end))
    with pytest.raises(InvalidValue) as error_info:
        call(outside)
    assert "\n" not in str(error_info.value)


def test_angles_rounded_by_their_cosine_are_accepted():
    """The cosine and its inverse change the last digit of the angle."""
    angle = math.degrees(math.acos(math.cos(math.radians(30.0))))
    assert angle != 30.0
    for table in (NARROW_TABLE, TABLE):
        point = {SIZE: 60.0} if table is NARROW_TABLE else {SIZE: 60.0, SOOT: 64.0}
        np.testing.assert_allclose(
            interp(table, sza=angle, **point),
            interp(table, sza=30.0, **point),
            rtol=1e-12,
        )


def test_values_inside_a_range_are_unchanged():
    inside = np.array([1e-300, 1e-15, 1.0 - 1e-12, 1.0])
    np.testing.assert_array_equal(snap_to_limits(inside, 0.0, 1.0), inside)
    assert check_range("x", 1e-300, 0.0, 1.0, open_low=True) == 1e-300
    for open_end in (-1e-15, 0.0, 1.0, 1.0 + 1e-15):
        with pytest.raises(InvalidValue):
            check_range("x", open_end, 0.0, 1.0, open_low=True, open_high=True)
    np.testing.assert_array_equal(snap_to_limits([math.nan, -math.inf, math.inf], 0.0, math.inf),
                                  [math.nan, -math.inf, math.inf])  # fmt: skip


@NEEDS_JIT
def test_rounded_bottom_depth_is_rejected():
    """Otherwise an interval would be as thin as a rounding error."""
    for thickness, depth in ((0.3, 0.1 + 0.2), (0.1 + 0.2, 0.3)):
        with pytest.raises(InvalidValue, match="top and bottom are always included"):
            splits.irradiance_profile(splits.Snow(depth_m=thickness), [500.0], [depth])


def test_visible_range_is_covered_up_to_rounding():
    w = np.linspace(400.0, 780.0, 39)
    assert covers_visible(w)
    assert covers_visible(np.nextafter(w, 800.0)) and covers_visible(np.nextafter(w, 0.0))
    assert not covers_visible(w + 1.0) and not covers_visible(w[::2])
