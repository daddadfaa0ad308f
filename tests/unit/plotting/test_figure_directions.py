"""Figures of directional quantities: principal planes, maps, lobes, polarization."""

import io

import numpy as np
import pytest
import xarray as xr

from splits.plotting import (
    draw_bin_sizes,
    draw_hemispheres,
    draw_lobes,
    draw_polarization,
    draw_principal_planes,
)
from splits.plotting.grammar import ONE_COLUMN_INCHES, TWO_COLUMNS_INCHES

POLAR = np.arange(0.0, 90.0, 5.0)
AZIMUTH = np.arange(0.0, 360.0, 30.0)


def make_dataset(
    grid=None, polar=POLAR, estimator="expansion", wavelength=(600.0,), azimuth=AZIMUTH
):
    """Return forward-peaked BRDFs, and BTDFs of half their size."""
    coords = {
        **{k: np.array(v) for k, v in (grid or {}).items()},
        "wavelength": np.array(wavelength), "polar_deg": polar, "azimuth_deg": azimuth,
    }  # fmt: skip
    shape = tuple(len(v) for v in coords.values())
    forward = np.sin(np.radians(polar))[:, np.newaxis] * np.cos(np.radians(azimuth))
    values = np.broadcast_to(0.3 + 0.1 * forward, shape)
    factors = {"brdf": 1.0, "btdf": 0.5, "brdf_q": -0.2, "brdf_dolp": 0.5, "brdf_aolp": 300.0}
    variables = {}
    for name, factor in factors.items():
        variables[name] = (tuple(coords), factor * values)
        variables[f"{name}_stderr"] = (tuple(coords), np.full(shape, 1e-3))
    attributes = {"incidence_deg": 40.0, "estimator": estimator}
    return xr.Dataset(variables, coords, attributes)


PLANE = {"azimuth": np.array([0.0, 90.0, 180.0, 270.0])}
"""Azimuths of the principal plane and across it, too few for a map."""


def list_map_axes(figure):
    """Return the panels that are maps."""
    return [axes for axes in figure.axes if axes.get_xlabel().startswith("forward")]


def test_incident_beam_is_labelled():
    figure = draw_principal_planes(make_dataset())
    polar = figure.axes[0]
    beam = polar.lines[-1]
    np.testing.assert_allclose(beam.get_xdata(), np.radians(-40.0))
    (text,) = polar.get_legend().get_texts()
    assert text.get_text() == "towards the source"
    assert "BRDF (sr⁻¹)" in [t.get_text() for t in polar.texts]


def test_incident_beams_have_the_colours_of_their_lines():
    dataset = make_dataset({"incidence_deg": [0.0, 30.0, 60.0]}, **PLANE)
    polar, flat = draw_principal_planes(dataset).axes
    *_, one, two, three = polar.lines
    assert np.degrees(two.get_xdata()[0]) == pytest.approx(-30.0)
    assert [b.get_color() for b in (one, two, three)] == [c.get_color() for c in flat.lines]


def test_transmitted_light_points_down():
    up, down = draw_principal_planes(make_dataset(**PLANE), ["brdf", "btdf"]).axes[::2]
    for polar, sign in ((up, 1.0), (down, -1.0)):
        angle, radius = polar.lines[0].get_data()
        # Angles count from the top of the plot, clockwise.
        assert (sign * np.cos(angle) >= 0.0).all()
        # Forward is to the right in both halves.
        right = np.sin(angle) > 0.5
        assert radius[right].mean() > radius[np.sin(angle) < -0.5].mean()
        ends = (-90.0, 90.0) if sign > 0.0 else (90.0, 270.0)
        assert (polar.get_thetamin(), polar.get_thetamax()) == pytest.approx(ends)
    (text,) = down.get_legend().get_texts()
    assert text.get_text() == "straight on"
    np.testing.assert_allclose(down.lines[-1].get_xdata(), np.radians(180.0 - 40.0))


def test_every_requested_quantity_has_panels():
    figure = draw_principal_planes(make_dataset(**PLANE), ["brdf", "btdf"])
    assert [axes.get_ylabel() for axes in figure.axes[1::2]] == ["BRDF (sr⁻¹)", "BTDF (sr⁻¹)"]
    brdf, btdf = (axes.lines[0].get_ydata() for axes in figure.axes[1::2])
    np.testing.assert_allclose(btdf, 0.5 * brdf)


def test_panels_state_that_nothing_is_transmitted():
    dataset = make_dataset(**PLANE)
    dataset["btdf"] = 0.0 * dataset.btdf
    figure = draw_principal_planes(dataset, ["btdf"])
    for axes in figure.axes:
        message = "nothing transmitted\nwithin 0.002 sr⁻¹"
        assert message in [text.get_text() for text in axes.texts]
        assert not axes.collections, "no band fills the panel"
    dataset["btdf_stderr"] = 0.0 * dataset.btdf
    flat = draw_principal_planes(dataset, ["btdf"]).axes[1]
    assert [text.get_text() for text in flat.texts] == ["nothing transmitted"]
    for axes in draw_principal_planes(dataset).axes:
        assert not any("nothing" in text.get_text() for text in axes.texts)


BIN_CENTERS = np.degrees(np.arccos((np.arange(18) + 0.5) / 18.0))[::-1]


def test_lines_of_bins_do_not_cross_the_zenith():
    dataset = make_dataset(polar=BIN_CENTERS, estimator="bins", **PLANE)
    for figure in (draw_principal_planes(dataset), draw_polarization(dataset)):
        for axes in figure.axes:
            angle, value = axes.lines[0].get_data()
            gap = np.flatnonzero(np.isnan(value))
            assert gap.size == 1 and angle[gap[0]] == 0.0
    for estimator in ("expansion", "next_event"):
        line = (
            draw_principal_planes(make_dataset(polar=BIN_CENTERS, estimator=estimator))
            .axes[1]
            .lines[0]
        )
        assert np.isfinite(line.get_ydata()).all()


def test_lines_of_bin_sizes_break_at_the_zenith():
    fine = make_dataset(polar=BIN_CENTERS, estimator="bins", azimuth=np.arange(0.0, 360.0, 10.0))
    figure = draw_bin_sizes(fine)
    axes = figure.axes[0]
    assert len(axes.lines) == len(list_map_axes(figure)) == 3
    for line in axes.lines:
        angle, value = line.get_data()
        assert np.isnan(value[angle == 0.0]).all() and np.isfinite(value[angle != 0.0]).all()
    order = [line.get_zorder() for line in axes.lines]
    assert order == sorted(order, reverse=True), "large bins come first and lie on top"


def test_a_bin_at_the_zenith_leaves_no_gap():
    line = draw_principal_planes(make_dataset(estimator="bins")).axes[1].lines[0]
    assert np.isfinite(line.get_ydata()).all()


def test_lobes_of_a_black_sample_have_no_extent():
    dataset = make_dataset()
    dataset["brdf"] = 0.0 * dataset.brdf
    figure = draw_lobes(dataset)
    assert figure.axes[0].get_xlim() == (-1.0, 1.0)


def test_titles_of_lobes_do_not_overlap():
    grid = {"grain_size_um": ["100-200", "800-1200"], "iron_oxide": [0.01, 0.02, 0.03]}
    figure = draw_lobes(make_dataset(grid, wavelength=(600.0, 1300.0)))
    figure.draw_without_rendering()
    titles = [axes._left_title for axes in figure.axes if ":" in axes.get_title(loc="left")]
    assert len(titles) == 12
    assert titles[0].get_text().splitlines() == [
        "(a) grain size (µm): 100–200", "hematite and goethite by mass:", "0.01",
        "wavelength (nm): 600",
    ]  # fmt: skip
    boxes = [title.get_window_extent() for title in titles]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    assert all(box.x0 >= 0.0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_degree_of_polarization_is_undefined_without_light():
    dataset = make_dataset()
    dataset["brdf"] = dataset.brdf.where(dataset.polar_deg < 60.0, 0.0)
    right = draw_polarization(dataset).axes[1]
    angle, degree = right.lines[0].get_data()
    np.testing.assert_allclose(degree[np.abs(angle) < 60.0], 0.2)
    assert np.isnan(degree[np.abs(angle) >= 60.0]).all()


def test_polarized_incidence_has_the_degree_without_sign():
    dataset = make_dataset()
    assert draw_polarization(dataset).axes[1].get_ylabel().endswith("−Q/I")
    dataset.attrs |= {"incident_stokes": [1.0, 0.0, 1.0, 0.0], "medium": "snow"}
    figure = draw_polarization(dataset)
    assert figure.axes[1].get_ylabel() == "degree of polarization"
    plane = dataset.sel(azimuth_deg=0.0, wavelength=600.0)
    angle, degree = figure.axes[1].lines[0].get_data()
    forward = angle > 1.0
    expected = np.interp(angle[forward], plane.polar_deg, plane.brdf_dolp)
    np.testing.assert_allclose(degree[forward], expected)
    assert any(
        "Stokes vector (1, 0, 1, 0)" in text.get_text().replace("\xa0", " ")
        for text in figure.texts
    )


def test_maps_of_the_degree_show_the_direction_of_polarization():
    """Lines are in the plane of the normal for angles of 0, and along the horizon for 90."""
    for angle, is_radial in ((0.0, True), (90.0, False)):
        dataset = make_dataset()
        dataset["brdf_aolp"] = xr.full_like(dataset.brdf, angle)
        axes = list_map_axes(draw_hemispheres(dataset, ["brdf_dolp"]))[0]
        lines = [line for line in axes.lines if len(line.get_xdata()) == 2]
        assert lines
        for line in lines:
            ends = line.get_ydata() * np.exp(1j * line.get_xdata())
            middle = ends.mean()
            turn = (ends[1] - ends[0]) / middle
            assert abs(turn.imag if is_radial else turn.real) < 1e-9


def test_legend_of_many_lines_lies_outside_the_panels():
    grid = {"incidence_deg": np.arange(0.0, 90.0, 10.0), "density_kg_m3": [200.0, 400.0]}
    figure = draw_principal_planes(make_dataset(grid))
    figure.draw_without_rendering()
    (legend,) = figure.legends
    # A row of panels for each density.
    assert len(figure.axes) == 4 and len(legend.get_texts()) == 9
    box = legend.get_window_extent()
    assert not any(box.overlaps(axes.get_window_extent()) for axes in figure.axes)
    assert box.x1 <= figure.bbox.x1 + 1.0 and box.y0 >= 0.0


@pytest.mark.parametrize(
    ("sizes", "rows"), [((3, 5), 3), ((5, 3), 3), ((2, 3), 1), ((15, 1), 1), ((9, 6), 1)]
)
def test_many_lines_have_rows_of_panels(sizes, rows):
    grid = {
        "saturation": np.linspace(0.0, 1.0, sizes[0]),
        "density_kg_m3": np.linspace(100.0, 500.0, sizes[1]),
    }
    figure = draw_principal_planes(make_dataset(grid))
    polar = [axes for axes in figure.axes if axes.name == "polar"]
    assert len(polar) == rows
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    named = [title for title in titles if "saturation" in title or "density" in title]
    assert len(named) == (rows if rows > 1 else 0)


def test_more_lines_than_can_be_told_apart_are_rejected():
    grid = {"saturation": np.linspace(0.0, 1.0, 9), "density_kg_m3": np.linspace(100.0, 500.0, 8)}
    with pytest.raises(ValueError, match=r"select.*at most 60 lines of 72"):
        draw_principal_planes(make_dataset(grid))


def test_maps_are_shown_for_few_grid_points_only():
    for count, expected in ((1, 1), (4, 4), (5, 0)):
        grid = {"density_kg_m3": 100.0 * np.arange(1, count + 1)}
        figure = draw_principal_planes(make_dataset(grid))
        assert len(list_map_axes(figure)) == expected
        assert figure.get_figwidth() == TWO_COLUMNS_INCHES
        figure.draw_without_rendering()
    assert not list_map_axes(draw_principal_planes(make_dataset(**PLANE)))


@pytest.mark.parametrize("count", [1, 5, 24])
def test_maps_share_a_scale_and_mark_the_beam(count):
    dataset = make_dataset({"density_kg_m3": np.arange(1.0, 1.0 + count)})
    figure = draw_hemispheres(dataset)
    figure.draw_without_rendering()
    assert figure.get_figwidth() == (ONE_COLUMN_INCHES if count == 1 else TWO_COLUMNS_INCHES)
    maps = list_map_axes(figure)
    assert len(maps) == count
    assert len({axes.collections[0].norm for axes in maps}) == 1
    for axes in maps:
        (mirror, source) = (line for line in axes.lines if line.get_marker() in "Do")
        np.testing.assert_allclose(mirror.get_xydata(), [[0.0, 40.0]])
        np.testing.assert_allclose(source.get_xydata(), [[np.pi, 40.0]])
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_a_map_shows_forward_directions_on_the_right():
    mesh = list_map_axes(draw_hemispheres(make_dataset()))[0].collections[0]
    azimuth = mesh.get_coordinates()[..., 0]
    middle = 0.5 * (azimuth[1:, 1:] + azimuth[1:, :-1])
    values = mesh.get_array()
    assert values[np.cos(middle) > 0.5].mean() > values[np.cos(middle) < -0.5].mean()


def test_interpretations_are_shown_as_shifts_from_the_default():
    dataset = make_dataset({"interpretation": ["a", "default", "b"]})
    dataset["brdf"] = dataset.brdf + xr.DataArray([0.1, 0.0, -0.1], dims="interpretation")
    figure = draw_principal_planes(dataset)
    default, one, other = figure.axes
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["(a) default", "(b) a", "(c) b"]
    assert default.lines[0].get_ydata().max() > 0.3
    np.testing.assert_allclose(one.lines[0].get_ydata(), 0.1, atol=1e-12)
    np.testing.assert_allclose(other.lines[0].get_ydata(), -0.1, atol=1e-12)


def test_colour_bar_beside_several_quantities_fits():
    dataset = make_dataset(wavelength=np.arange(400.0, 1440.0, 100.0))
    # Matplotlib would warn of panels without area.
    draw_principal_planes(dataset, ["brdf", "btdf"]).savefig(io.BytesIO())
