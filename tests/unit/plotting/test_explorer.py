"""The explorer: validation, and agreement of the browser with Python."""

import html
import re

import numpy as np
import pytest
import xarray as xr
from browser import NEEDS_BROWSER, page_of

from splits.core.validation import InvalidValue
from splits.plotting.explorer import page
from splits.plotting.explorer.page import ExplorerTable, compute_colour_weights, write_explorer
from splits.tables.axes import ParameterGrid
from splits.tables.comparison import list_comparison_grids, rename_comparison
from splits.tables.table import Table

AXES = {
    "optical_radius_um": np.array([30.0, 80.0, 200.0, 500.0, 1000.0, 2000.0]),
    "incidence_deg": np.array([0.0, 40.0, 70.0]),
    "impurities_ng_g.black_carbon": np.array([0.0, 50.0, 300.0, 1500.0]),
    "saturation": np.array([0.0, 0.1]),
    "wavelength": np.arange(400.0, 1301.0, 20.0),
}


def evaluate_reflectance(axes):
    """Return a snow-like reflectance over the axes of a table."""
    size, angle, soot, water, w = np.meshgrid(*axes.values(), indexing="ij", sparse=True)
    depth = np.sqrt(size / 1e4 * ((w / 700.0) ** 3 + soot / 200.0)) * (1.0 + water)
    values = np.exp(-depth * (1.0 + 2.0 * np.cos(np.radians(angle))))
    return xr.DataArray(values, axes, list(axes), attrs={"long_name": "reflectance"})


def make_explorer_table(
    path_sharing_axes="optical_radius_um, impurities_ng_g.black_carbon", is_compared=False
):
    values = evaluate_reflectance(AXES)
    variables = {"reflectance": values, "reflectance_stderr": 0.002 + 0.004 * values * (1 - values)}
    dataset = xr.Dataset(variables, attrs={"path_sharing_axes": path_sharing_axes})
    dataset.optical_radius_um.attrs = {"long_name": "radius of spheres", "units": "um"}
    names = list(AXES)[:-1]
    grid = ParameterGrid.from_mapping({name: AXES[name] for name in names})
    for name, one in list_comparison_grids(grid, names[:3] if is_compared else []).items():
        axes = {n: np.array(row) for n, row in one.items()}
        part = evaluate_reflectance(axes | {"wavelength": AXES["wavelength"]})
        renamed = rename_comparison(part.to_dataset(name="reflectance"), name)
        dataset = dataset.assign(renamed.data_vars)
    return Table(dataset)


def make_directions():
    """Return reflectance factors that depend on every axis and are interpolated exactly."""
    axes = {
        "optical_radius_um": np.array([60.0, 240.0, 960.0]), "incidence_deg": np.array([0.0, 60.0]),
        "wavelength": np.array([450.0, 1030.0]), "polar_deg": np.arange(0.0, 90.0, 2.5),
        "azimuth_deg": np.arange(0.0, 360.0, 5.0),
    }  # fmt: skip
    size, beam, w, polar, azimuth = np.meshgrid(*axes.values(), indexing="ij", sparse=True)
    folded_azimuth = np.minimum(azimuth, 360.0 - azimuth)
    values = 0.1 * np.log(size) - 0.2 * np.cos(np.radians(beam)) + 1e-4 * w
    values = values + 1e-3 * polar + 1e-4 * folded_azimuth
    variables = {"reflectance_factor": (tuple(axes), values)}
    dataset = xr.Dataset(variables, axes, {"relative_stderr_reached": 0.04})
    return dataset.assign(reflectance_factor_stderr=0.02 * dataset.reflectance_factor)


@pytest.fixture(scope="module")
def explorer_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("explorer") / "explorer.html"
    snow = make_explorer_table()
    tables = {"snow": ExplorerTable(snow, "results/data/a.nc", "Snow", make_directions()),
             "</script>": ExplorerTable(make_explorer_table("none"), "b.nc", "An awkward name"),
             "compared": ExplorerTable(make_explorer_table("none", True), "c.nc", "")}  # fmt: skip
    write_explorer(tables, path)
    return path


def test_page_is_one_file_without_network_access(explorer_file):
    text = explorer_file.read_text(encoding="utf-8")
    assert len(text) < page.MAX_PAGE_BYTES
    assert "{{" not in text
    assert not re.findall(r"(?:src|href)\s*=\s*[\"']?(?:https?:)?//|@import|fetch\(|XMLHttp", text)
    assert text.count("</script>") == 2


POINTS = [
    (30.0, 0.0, 0.0, 0.0),
    (277.0, 25.0, 120.0, 0.05),
    (1830.0, 69.0, 1400.0, 0.1),
    (45.0, 40.0, 3.0, 0.021),
]


def render_page(explorer_file, folder, number, point):
    """Return the page as rendered by a browser at a point of the table."""
    return page_of(f"{explorer_file.as_uri()}#{'/'.join(map(str, [number, *point]))}", folder)


def read_numbers(text, name):
    """Return the numbers in a data attribute of a page."""
    return np.array(re.search(rf'data-{name}="([^"]*)"', text)[1].split(), dtype=float)


@NEEDS_BROWSER
@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("point", POINTS, ids=str)
def test_browser_and_python_interpolate_equally(explorer_file, tmp_path, number, point):
    table = make_explorer_table("none", number == 2)
    expected = table.interp(**dict(zip(list(AXES)[:-1], point, strict=True)))
    text = render_page(explorer_file, tmp_path, number, point)
    actual = {name: read_numbers(text, name) for name in ("values", "errors")}
    np.testing.assert_allclose(actual["values"], expected.reflectance, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(actual["errors"], expected.reflectance_stderr, rtol=0.0, atol=2e-6)
    assert f'"optical_radius_um": {point[0]:g}' in text
    assert len(re.findall(r'type="range" id="axis\d"', text)) == 4
    # Only the first table has reflectance factors.
    assert ("data-factors" in text) == (number == 0)


LABELS = [
    "<!-- <script>", "</script><script>document.title='OWNED'</script>",
    "<img src=x onerror=\"document.title='OWNED'\">", "a < b & c", "&lt;", "{{SCRIPT}}", "a\u2028b",
    '"q" \'q\' `${1}`', "grain *size* r_",
]  # fmt: skip
"""Labels with markup, and harmless ones."""


@pytest.mark.long
@NEEDS_BROWSER
def test_browser_shows_labels_as_plain_text(tmp_path):
    path, axes = tmp_path / "explorer.html", list(AXES)[1:-1]
    tables = {}
    for number, word in enumerate(LABELS):
        labelled = make_explorer_table("none")
        name = f"own_{number}"
        labelled.dataset[axes[0]].attrs = {"long_name": word, "units": word}
        renamed = Table(labelled.dataset.rename({axes[0]: name}))
        tables[word] = ExplorerTable(renamed, f"{word}.nc", word)
    write_explorer(tables, path)
    source = path.read_text(encoding="utf-8")
    assert source.count("</script>") == 2 and source.count("<!--") == 0
    for number, word in enumerate(LABELS):
        text = render_page(path, tmp_path / "browser", number, (30.0, 40.0, 3.0, 0.021))
        shown, escaped = text.replace("&nbsp;", "\u00a0"), html.escape(word, quote=False)
        assert "<title>SPLITS explorer</title>" in shown
        labels = re.findall(r'<input type="radio" name="medium"[^>]*> (.*?)</label>', shown, re.S)
        assert [html.unescape(label) for label in labels] == LABELS
        assert f"<span>{escaped}</span>" in shown
        assert f'<p id="about">{escaped}</p>' in shown
        assert f"40 {escaped}</output>" in shown
        assert len(read_numbers(shown, "values")) == AXES["wavelength"].size


@NEEDS_BROWSER
@pytest.mark.parametrize(("size", "beam"), [(60.0, 0.0), (277.0, 25.0), (1830.0, 69.0)])
def test_browser_shows_reflectance_factors(explorer_file, tmp_path, size, beam):
    text = render_page(explorer_file, tmp_path, 0, (size, beam, 0.0, 0.0))
    actual = read_numbers(text, "factors").reshape(17, 19)
    # The initial wavelength, 620 nm, is nearer to 450 than to 1030.
    factors = make_directions().reflectance_factor.sel(wavelength=450.0)
    factors = factors.sel(
        polar_deg=np.arange(0.0, 81.0, 5.0), azimuth_deg=np.arange(0.0, 181.0, 10.0)
    )
    log_factors = np.log(factors).assign_coords(
        optical_radius_um=np.log(factors.optical_radius_um),
        incidence_deg=-np.cos(np.radians(factors.incidence_deg)),
    )
    expected = log_factors.interp(
        optical_radius_um=np.log(min(size, 960.0)), incidence_deg=-np.cos(np.radians(min(beam, 60)))
    )
    np.testing.assert_allclose(actual, np.exp(expected.values), rtol=0.0, atol=2e-5)
    assert "2 % typically, 4 % at most" in text
    assert ("nearest of 60 to 960" in text) == (size > 960.0)


def test_start_is_clean_and_dry_like_the_directions():
    axes = page._serialize_table("snow", ExplorerTable(make_explorer_table(), "a.nc", ""))["axes"]
    starts = {axis["name"]: axis["start"] for axis in axes}
    assert starts["impurities_ng_g.black_carbon"] == starts["saturation"] == 0.0
    assert starts["optical_radius_um"] == 200.0 and starts["incidence_deg"] == 40.0


@NEEDS_BROWSER
def test_browser_shows_the_colour_scale_of_the_directions(explorer_file, tmp_path):
    text = render_page(explorer_file, tmp_path, 0, (60.0, 0.0, 0.0, 0.0))
    factors = read_numbers(text, "factors")
    for name, value in (("lowest", factors.min()), ("highest", factors.max())):
        assert f'<span id="{name}">{value:.2f}</span>' in text
    assert 'id="scale" style="background: linear-gradient' in text


def test_directions_over_other_axes_are_rejected(tmp_path):
    renamed = (
        make_explorer_table()
        .dataset.isel(incidence_deg=[0, 1])
        .rename(incidence_deg="saturation_2")
    )
    uneven = np.array([0.0, 10.0, 40.0, 80.0])
    for lookup_table, factors, message in (
        (
            make_explorer_table(),
            make_directions().isel(incidence_deg=0),
            "reflectance factors over",
        ),
        (
            make_explorer_table(),
            make_directions().isel(incidence_deg=[0]),
            "at least two of directions",
        ),
        (make_explorer_table(), make_directions().sel(polar_deg=uneven), "every 5° to 80°"),
        (Table(renamed), make_directions(), "a table with incidence_deg"),
    ):
        with pytest.raises(InvalidValue, match=rf"^explorer = .*must be .*{message}"):
            write_explorer(
                {"a": ExplorerTable(lookup_table, "a.nc", "", factors)}, tmp_path / "a.html"
            )


def test_the_interpolation_error_of_directions_is_stated():
    smooth = make_directions()
    smooth["reflectance_factor"] = np.exp(smooth.reflectance_factor)
    smooth["reflectance_factor_stderr"] = 0.02 * smooth.reflectance_factor
    bumpy = smooth.copy()
    bumpy["reflectance_factor"] = smooth.reflectance_factor * (
        1.0 + 0.1 * (smooth.optical_radius_um == 240.0)
    )
    serialized = [page._serialize_directions(ds, list(AXES)) for ds in (smooth, bumpy)]
    assert (serialized[0]["error"], serialized[0]["typical"]) == pytest.approx((0.04, 0.02))
    # One node is 10 % higher: half-way to it a quarter of the difference is missed.
    interpolation_error = 0.25 * np.log(1.1)
    assert serialized[1]["error"] == pytest.approx(np.hypot(0.04, interpolation_error), rel=1e-6)
    assert 0.02 < serialized[1]["typical"] < np.hypot(0.02, interpolation_error)


def test_colour_weights_match_the_analysis():
    from splits.analysis.colour import compute_tristimulus

    w = np.arange(400.0, 781.0, 20.0)
    spectrum = 0.2 + 0.6 * (w - 400.0) / 380.0
    fine = np.arange(400.0, 781.0, 5.0)
    expected = compute_tristimulus(fine, np.interp(fine, w, spectrum))
    np.testing.assert_allclose(compute_colour_weights(w) @ spectrum, expected, rtol=1e-9)
    assert compute_colour_weights(w)[1].sum() == pytest.approx(1.0)


def test_invalid_tables_of_a_page_are_rejected(tmp_path, monkeypatch):
    labelled = make_explorer_table().dataset.assign_coords(saturation=["dry", "wet"])
    with pytest.raises(
        InvalidValue, match=r"^explorer = 'saturation': must be an axis of at least two"
    ):
        write_explorer({"a": ExplorerTable(Table(labelled), "a.nc", "")}, tmp_path / "a.html")
    monkeypatch.setattr(page, "MAX_PAGE_BYTES", 1000)
    with pytest.raises(InvalidValue, match=r"^explorer = '\d+ bytes': must be small enough"):
        write_explorer({"a": ExplorerTable(make_explorer_table(), "a.nc", "")}, tmp_path / "a.html")
    assert not list(tmp_path.iterdir())
