"""The report: complete, escaped, without dead links, and equal to the tables of the results."""

import base64
import csv
import html
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
from browser import NEEDS_BROWSER, page_of
from shipped import CONFIG

from splits.core.yaml import read_yaml
from splits.experiments import load_experiment, load_experiments, load_settings
from splits.experiments.config.experiment import PAPERS, parse_place
from splits.experiments.report.contents import make_report_contents
from splits.experiments.report.page import (
    VERDICTS,
    compare_papers,
    make_cell,
    read_table,
    write_report,
)

image = pytest.importorskip("PIL.Image")
pytest.importorskip("jinja2")
ROOT = Path(__file__).parents[3]
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="10" height="5"></svg>'
STATEMENTS = [
    {"id": "a", "quantity": "a < b & c", "place": "Fig 9", "published": "0.5", "ours": "0.51234",
     "stderr": "0.0123", "bar": "±0.1", "verdict": "agrees"},
    {"id": "b", "quantity": "trend", "place": "Fig 8", "published": "", "ours": "-1.25e-07",
     "stderr": "2.5e-08", "bar": "above 3 standard errors", "verdict": "outside"},
    {"id": "c", "quantity": "curve", "place": "section 5.2, Fig 10", "published": "0.0177",
     "ours": "", "stderr": "", "bar": "", "verdict": "not reproducible: <no numbers>"},
    {"id": "d", "quantity": "noisy", "place": "Table 2", "published": "3", "ours": "2.5",
     "stderr": "1", "bar": "±0.1", "verdict": "not resolved at this accuracy"},
    {"id": "e", "quantity": "sand", "place": "SPLITS Fig 11", "published": "", "ours": "0.25",
     "stderr": "0", "bar": "above 0", "verdict": "agrees"},
    {"id": "measured", "quantity": "RMSE", "place": "a journal", "published": "", "ours": "0.01",
     "stderr": "0.001", "bar": "at most 0.03", "verdict": "agrees"},
]  # fmt: skip
LONG = [{"name": f"row {i}", "x": str(i / 7), "x_stderr": "0.01", "srgb": "#8c5d43"}
        for i in range(30)]  # fmt: skip
HOSTILE = {
    "name": "hostile",
    "title": "<script>alert(1)</script> Größe 雪",
    "caption": "{{x}} {% raw %} </script>\n\n<img src=x onerror=alert(2)>",
    "instrument": {"kind": "refractive_index", "wavelength_nm": [500, 900]},
}
SPEED = [f"benchmarks/speed_against_error_short{end}"
         for end in (".csv", "_times.csv", ".png", ".svg")]  # fmt: skip


class Page(HTMLParser):
    """Elements of a page, with the content of tables."""

    def __init__(self, path):
        super().__init__()
        self.ids, self.links, self.images, self.scripts = [], [], [], 0
        self.numbers, self.headings, self._open = [], [], None
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag, attributes):
        """Collect identifiers, links, images and numbers."""
        values = dict(attributes)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [values["href"]] if "href" in values else []
        self.images += [values] if tag == "img" and "src" in values else []
        self.scripts += tag == "script"
        self.numbers += [float(values["value"])] if tag == "data" else []
        self._open = tag if re.fullmatch(r"h\d", tag) else None
        self.headings += [""] if self._open else []

    def handle_endtag(self, tag):
        """End a heading."""
        self._open = None if tag == self._open else self._open

    def handle_data(self, data):
        """Collect the text of headings."""
        if self._open:
            self.headings[-1] += data


def write_rows(path, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def write_products(folder, paths, statements):
    """Write small files in place of the results."""
    for path in map(folder.joinpath, paths):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".csv":
            write_rows(path, STATEMENTS if path.name in statements else LONG)
        elif path.suffix == ".png":
            image.new("RGB", (1050, 600), "blue").save(path)
        else:
            path.write_text(SVG, encoding="utf-8")


@pytest.fixture(scope="module")
def shipped():
    """Return settings, experiments and studies of the package, and an experiment of a user."""
    folder = CONFIG
    settings = load_settings(read_yaml(folder / "config.yaml"))
    experiments = load_experiments(folder / "experiments", folder / "media", folder / "measured")
    return settings, experiments


@pytest.fixture(scope="module")
def report(shipped, tmp_path_factory):
    """Return the page on all experiments and studies, its contents, and the paths it shows."""
    settings, experiments = shipped
    folder = tmp_path_factory.mktemp("results")
    (folder / "hostile.yaml").write_text(json.dumps(HOSTILE), encoding="utf-8")
    own = load_experiment(folder / "hostile.yaml", CONFIG / "media")
    experiments = {**experiments, "hostile": own}
    contents = make_report_contents(settings, experiments, settings.studies, SPEED, explorer=True)
    paths = [path for one in experiments.values() for path in one.list_product_paths()]
    for name, study in settings.studies.items():
        paths += [path for made in study.list_product_paths(name).values() for path in made]
    write_products(folder, [*paths, SPEED[0], *SPEED[2:], "explorer.html"], {"agreement.csv"})
    times = {"medium": "snow", "this package (s)": 2, "uniform (s)": 800, "ratio": 400}
    write_rows(folder / SPEED[1], [times])
    for name in ("angular_trends", "layer_trends", "sand_trends"):
        write_rows(folder / "tables" / f"{name}.csv", [STATEMENTS[1]])
    write_report(contents, folder / "report.html")
    return Page(folder / "report.html"), contents, paths, folder


def test_every_product_is_linked(report):
    page, _, paths, _ = report
    assert {path for path in paths if path not in page.links} == set()
    assert {"explorer.html", "data/", "figures/", "tables/"} <= set(page.links)


def test_no_link_is_dead(report):
    page, _, _, folder = report
    assert len(page.ids) == len(set(page.ids))
    for link in page.links:
        target = link[1:] in page.ids if link.startswith("#") else (folder / link).exists()
        assert target, link


def test_every_image_decodes_and_is_embedded(report):
    page = report[0]
    assert len(page.images) > 100
    for one in page.images:
        kind, _, data = one["src"].partition(";base64,")
        content = base64.b64decode(data, validate=True)
        if kind == "data:image/svg+xml":
            assert ElementTree.fromstring(content).tag.endswith("svg")
        else:
            image.open(io.BytesIO(content)).load()
        assert "alt" in one


def test_page_loads_nothing(report):
    text = report[0].text
    assert not re.findall(r"(?:src|href)\s*=\s*[\"']?(?:https?:)?//|@import|fetch\(|XMLHttp", text)
    assert "url(" not in text


def test_texts_of_users_are_shown_unchanged(report):
    page = report[0]
    assert page.scripts == 1
    assert HOSTILE["title"] in page.headings
    for paragraph in HOSTILE["caption"].split("\n\n"):
        assert f"<p>{html.escape(paragraph)}</p>" in page.text
    assert "alert(1)</script>" not in page.text and "<img src=x" not in page.text


def test_numbers_are_those_of_the_tables(report):
    page, contents, _, folder = report
    tables = [
        path for section in contents.sections for item in section.items for path in item.tables
    ]
    assert len(tables) > 15
    expected = []
    for path in tables:
        with open(folder / path, encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                cells = [row.get(key) for key in ("published", "ours", "stderr", "x", "x_stderr")]
                expected += [float(cell) for cell in cells if cell and float(cell)]
    expected += [2.0, 800.0, 400.0]
    assert sorted(number for number in page.numbers if number) == sorted(expected)


def test_statements_are_counted_by_paper(report):
    _, contents, _, folder = report
    comparisons = {one.key: one for one in compare_papers(contents.sections, folder)}
    assert list(comparisons) == [*PAPERS, "measured"]
    counts = {
        key: [one.counts[verdict] for verdict in VERDICTS] for key, one in comparisons.items()
    }
    # Each of the other three comparisons has the second statement.
    assert counts["splitsnow_2021"] == [1, 2, 0, 1, 1]
    assert counts["splits_2007"] == [1, 1, 0, 0, 0]
    assert counts["budak_grimailo_2020"] == [0, 1, 0, 0, 0]
    assert counts["measured"] == [1, 0, 0, 0, 0]
    places = comparisons["splitsnow_2021"].places
    assert [one.label for one in places] == ["Figure 8", "Figure 9", "Figure 10", "Table 2"]
    assert places[0].figure == "experiment-fig08_grain_size"


def test_figures_are_in_the_order_of_the_papers(report):
    page = report[0]
    numbers = [[]]
    for heading in page.headings:
        if heading in ("Figures", "Tables"):
            numbers.append([])
        if match := re.match(r"Figure (\d+)", heading):
            numbers[-1].append(int(match[1]))
    papers = [part for part in numbers if part]
    assert papers == [sorted(part) for part in papers] and len(papers) == len(PAPERS)
    assert set(range(5, 25)) == set(papers[1])


def test_experiments_on_papers_name_their_figures(shipped):
    for name, experiment in shipped[1].items():
        assert (experiment.group == "papers") == (experiment.reproduces is not None)
        if match := re.match(r"(?:sand_|layer_)?fig(\d+b?)_", name):
            assert experiment.reproduces.place == f"Fig {match[1].lstrip('0')}"


def test_report_of_an_experiment_without_figure(tmp_path):
    content = {**HOSTILE, "name": "bare", "figure": "none"}
    (tmp_path / "bare.yaml").write_text(json.dumps(content), encoding="utf-8")
    experiment = load_experiment(tmp_path / "bare.yaml", CONFIG / "media")
    settings = load_settings({"accuracies": {"standard": {"max_stderr": 0.01}}})
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "bare.nc").touch()
    write_report(make_report_contents(settings, {"bare": experiment}, []), tmp_path / "r.html")
    page = Page(tmp_path / "r.html")
    assert not [one for one in page.images if one["src"]]
    assert "data/bare.nc" in page.links and "comparison" not in page.ids
    assert "Results of splits" in page.headings


MEASURE = """<script>
const frame = document.querySelector("iframe");
frame.onload = () => {{
  const page = frame.contentDocument, root = page.documentElement;
  const overflow = root.scrollWidth - root.clientWidth;
  page.querySelector("a.zoom").click();
  const open = page.getElementById("large").open;
  document.title = `overflow ${{overflow}}, open ${{open}}`;
}};
frame.srcdoc = {page};
</script>"""


@NEEDS_BROWSER
@pytest.mark.parametrize("width", [1400, 390])
def test_page_fits_the_window_and_opens_figures(report, tmp_path, width):
    # A window cannot be as narrow as that of a phone, but a frame can.
    text = json.dumps(report[0].text).replace("<", "\\u003c")
    frame = f'<!doctype html><iframe width="{width}" height="800"></iframe>'
    path = tmp_path / "frame.html"
    path.write_text(frame + MEASURE.format(page=text), encoding="utf-8")
    page = page_of(path.as_uri(), tmp_path / "browser")
    assert "<title>overflow 0, open true</title>" in page, page[:500]


@pytest.mark.parametrize(
    ("value", "stderr", "shown", "exponent"),
    [
        ("0.896085", "0.00177914", ["0.8961", "0.0018"], ""),
        ("-0.004", "0.02", ["−0.004", "0.020"], ""),
        ("1.9075e-07", "2.02137e-07", ["1.9", "2.0"], "⁻⁷"),
        ("0.123456", "", ["0.1235"], ""),
        ("1237.93", "", ["1237.93"], ""),
        ("2.5e-06", "0", ["2.5·10⁻⁶"], ""),
        ("96.6236", "nan", ["96.62"], ""),
    ],
)
def test_numbers_are_rounded_by_their_errors(value, stderr, shown, exponent):
    cell = str(make_cell(value, stderr))
    pairs = re.findall(r'<data value="(.*?)">(.*?)</data>', cell)
    assert pairs == [*zip([value, stderr], shown, strict=False)]
    assert re.findall(r"\)·10(.*?)</td>", cell) == [exponent] * bool(exponent)


def test_columns_of_errors_are_joined_with_their_values(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("depth_m,model,stderr,b_stderr,b\n1,2,0.1,0.2,text\n", encoding="utf-8")
    table = read_table(path)
    assert table.columns == ["depth (m)", "model", "b"]
    assert re.findall(r'value="(.*?)"', table.rows[0][1]) == ["2", "0.1"]
    assert table.rows[0][2] == "<td>text</td>"
    path.write_text("", encoding="utf-8")
    assert read_table(path).n_rows == 0


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("Fig 8", "Figure 8"), ("Figs 7, 10", "Figure 7"), ("section 2.1, Fig 6", "Figure 6"),
        ("Fig 24b", "Figure 24b"), ("Table 3", "Table 3"), ("section 5.2.2", "Section 5.2.2"),
        ("Eq 3", "Equation 3"), ("The Cryosphere 16, 4343", "The Cryosphere 16, 4343"), ("", ""),
    ],
)  # fmt: skip
def test_places_are_parsed(text, label):
    assert parse_place(text).label == label
