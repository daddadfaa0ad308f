"""Tables of the return of a pulse: interpolation, files, and arguments of other tables."""

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.core.validation import InvalidValue

pytestmark = NEEDS_JIT
AREA = "specific_surface_area_m2_kg"
GRID = {AREA: [10.0, 20.0, 40.0]}


@pytest.fixture(scope="module")
def table():
    edges = [0.0, 2e-11, 1e-10, 1e-9]
    return splits.build_table(
        splits.Snow.natural, GRID, [532.0, 1064.0], delay_s=edges, rays=500, threads=1
    )


def test_interpolated_returns_are_those_of_the_nodes_with_errors(table):
    found, node = table.interp(**{AREA: 20.0}), table.dataset.sel({AREA: 20.0})
    for name in ("return_rate", "fraction", "mean_delay"):
        expected = node[name].transpose(*found[name].dims)
        np.testing.assert_allclose(found[name], expected, rtol=1e-12)
        assert (found[f"{name}_interpolation_error"] == 0.0).all()
    between = table.interp(**{AREA: 15.0})
    assert between.return_rate.dims == ("delay_s", "wavelength")
    assert between.return_rate.attrs["units"] == "s-1"
    low, high = (table.dataset.mean_delay.sel({AREA: area}) for area in (20.0, 10.0))
    assert ((between.mean_delay > low) & (between.mean_delay < high)).all()
    assert (between.mean_delay_interpolation_error > 0.0).all()
    slope = table.derivatives([AREA], **{AREA: 15.0})
    assert slope.return_rate_jacobian.dims == ("parameter", "delay_s", "wavelength")
    assert (slope.mean_delay_jacobian < 0.0).all()


def test_a_table_is_saved_and_opened(table, tmp_path):
    splits.save(table, tmp_path / "table.nc")
    opened = splits.Table(tmp_path / "table.nc")
    assert opened.dataset.identical(table.dataset)
    assert repr(opened) == repr(table) and "delay_s: 3 from" in repr(table)
    assert opened._repr_html_().startswith("<div>")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"delay_s": [0, 1e-9], "max_stderr": 0.1}, "max_stderr = 0.1: must be left out with"),
        ({"delay_s": [0, 1e-9], "covariance": True}, "covariance = True: must be left out with"),
        ({"rays": 100}, "rays = 100: must be left out without delay_s"),
        ({"acceptance_deg": 10.0}, "acceptance_deg = 10.0: must be left out without delay_s"),
    ],
)
def test_arguments_of_another_kind_of_table_are_rejected(arguments, message):
    with pytest.raises(InvalidValue, match=f"^{message}"):
        splits.build_table(splits.Snow.natural, GRID, [532.0], **arguments)


def test_tables_of_returns_have_no_other_wavelengths_and_no_spectra(table):
    for call, message in (
        (
            lambda: table.interp(**{AREA: 15.0}, wavelength=600.0),
            "wavelength = 600.0: must be",
        ),
        (lambda: splits.retrieve(([532.0], [0.5]), table, [AREA], 0.1), "model = 'a table of ret"),
        (lambda: table.to_isofit(), "table = .*with reflectance"),
    ):
        with pytest.raises(InvalidValue, match=f"^{message}"):
            call()
