"""Colours of spectra, and proportionality of points."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import kstest
from scipy.stats import t as student_t

import splits
from splits.analysis.colour import compute_tristimulus, make_colour_table, to_cielab, to_srgb
from splits.analysis.measured import fit_proportional
from splits.plotting import draw_swatches

WAVELENGTHS = np.arange(400.0, 781.0, 10.0)


def make_dataset(values, error=0.01, names=("a", "b")):
    r = np.array([np.full(WAVELENGTHS.size, v) if np.isscalar(v) else v for v in values])
    return xr.Dataset(
        {
            "reflectance": (("medium", "wavelength"), r),
            "reflectance_stderr": (("medium", "wavelength"), np.full(r.shape, error)),
        },
        {"medium": list(names)[: len(r)], "wavelength": WAVELENGTHS},
    )


def test_perfect_white_has_the_coordinates_of_d65():
    xyz = compute_tristimulus(WAVELENGTHS, np.ones(WAVELENGTHS.size))
    # CIE 15: the white point of D65 for the 2° observer.
    np.testing.assert_allclose(xyz, [0.9504, 1.0, 1.0888], atol=5e-4)
    np.testing.assert_allclose(to_cielab(xyz), [100.0, 0.0, 0.0], atol=0.05)
    np.testing.assert_allclose(to_srgb(xyz), 1.0, atol=2e-3)


def test_lightness_of_grey_matches_its_reflectance():
    for r in (0.05, 0.184, 0.5):
        lightness, a, b = to_cielab(compute_tristimulus(WAVELENGTHS, np.full(WAVELENGTHS.size, r)))
        assert lightness == pytest.approx(116.0 * np.cbrt(r) - 16.0, abs=0.05)
        assert abs(a) < 0.1 and abs(b) < 0.1


def test_colour_table_lists_every_point_with_errors():
    red = np.where(WAVELENGTHS > 600.0, 0.5, 0.05)
    table = make_colour_table(make_dataset([0.3, red]))
    assert table.medium.tolist() == ["a", "b"]
    assert table.a[1] > 20.0 > abs(table.a[0])
    assert table.red[1] > table.green[1] > 0.0
    assert (table[["L_stderr", "a_stderr", "b_stderr"]].to_numpy() == 0.0).all()
    slope = 116.0 / 3.0 * 0.3 ** (-2.0 / 3.0) * 0.01
    assert table.L_error_bound[0] == pytest.approx(slope, rel=0.01)
    assert table.srgb.str.fullmatch("#[0-9a-f]{6}").all()


def test_errors_of_one_snowpack_and_of_many_have_the_same_parts():
    rows = {"time": [0], "layer": [0], "thickness_m": 1.0, "density_kg_m3": 300.0,
            "specific_surface_area_m2_kg": 20.0}  # fmt: skip
    packs = splits.SnowPacks(pd.DataFrame(rows))
    many = splits.spectrophotometer(packs, WAVELENGTHS, 30)
    one = splits.spectrophotometer(packs.make_stack(0), WAVELENGTHS, 30)
    names = [f"{axis}_{part}" for axis in "Lab" for part in ("stderr", "error_bound")]
    parts = [make_colour_table(dataset)[names].to_numpy() for dataset in (one, many)]
    np.testing.assert_allclose(*parts, rtol=1e-4)
    assert (parts[0][0, ::2] == 0.0).all() and (parts[0][0, 1::2] > 0.0).all()


def test_incomplete_visible_spectra_are_rejected():
    for x in (np.arange(450.0, 781.0, 10.0), np.arange(400.0, 701.0, 10.0), [400.0, 780.0]):
        with pytest.raises(ValueError, match="400 to 780 nm"):
            compute_tristimulus(np.array(x), np.full(len(x), 0.5))


def test_swatches_show_every_point():
    figure = draw_swatches(make_dataset([0.3, 0.1]))
    texts = [t.get_text() for t in figure.axes[0].texts]
    assert len(texts) == 2 and all("L*" in t for t in texts)
    deep = make_dataset([0.3, 0.1]).expand_dims(x=[1, 2], y=[1, 2])
    with pytest.raises(ValueError, match="one or two parameters"):
        draw_swatches(deep)


# --- proportionality ------------------------------------------------------------------------------


def test_slope_of_exact_points_is_recovered():
    x = np.array([0.1, 0.4, 0.9])
    line = fit_proportional(x, 1.2 * x)
    assert line.slope == pytest.approx(1.2)
    assert line.scatter == pytest.approx(0.0, abs=1e-12)


def test_slope_errors_follow_student_t():
    random = np.random.default_rng(4)
    x = np.linspace(0.1, 1.0, 12)
    lines = [fit_proportional(x, 0.8 * x + 0.1 * random.standard_normal(12)) for _ in range(400)]
    scores = [(line.slope - 0.8) / line.stderr for line in lines]
    # The slope takes one of twelve degrees of freedom.
    assert kstest(scores, student_t(11).cdf).pvalue > 0.01
    assert np.mean([line.scatter**2 for line in lines]) == pytest.approx(0.01, rel=0.1)


def test_colours_do_not_change_how_numbers_are_printed():
    make_colour_table(make_dataset([0.5]))
    assert np.get_printoptions()["legacy"] is False
