"""Titles, captions and notes in the report are escaped and shown unchanged."""

from __future__ import annotations

import html
import json
import re

import pytest
from browser import NEEDS_BROWSER, page_of

pytestmark = pytest.mark.slow

SECRET = "content of a file that is not a result"
TITLES = {"hostile": "</script><b>t", "innocent": "*half"}
CAPTIONS = {
    "hostile": """A.

.. raw:: html
   :file: secret.txt

.. include:: secret.txt

.. raw:: html

   <img src=x onerror="document.title='OWNED'">""",
    "innocent": "r_ and |y| and `tick and a<b & c*, 2*3 = 6 [1]_ {x} &lt;\n\n- a list? 1. no",
}
SHOW_CAPTION_SCRIPT = """<script>
const waiting = setInterval(() => {{
  if (!app.showResultInfo) return;
  clearInterval(waiting);
  app.showResultInfo("results/tiny/figures/{name}.png");
}}, 50);
</script></body>"""
"""Script that opens the caption of a figure after the report has loaded."""
NOTES = {"hostile": "<!-- <script> of a note", "innocent": "$5 {y}"}


@pytest.fixture(scope="module")
def report(make_project, tmp_path_factory):
    """Return the path of the report of two experiments."""
    project = make_project(tmp_path_factory.mktemp("words"))
    (project.folder / "secret.txt").write_text(SECRET, encoding="utf-8")
    for name, title in TITLES.items():
        content = {
            "title": title, "caption": CAPTIONS[name], "figure": {"note": NOTES[name]},
            "instrument": {"kind": "refractive_index", "wavelength_nm": [500, 900]},
        }  # fmt: skip
        project.put(name, json.dumps(content))
    for arguments in (["--cores", 2], ["--report", "report.html"]):
        run = project.snakemake(*arguments, *TITLES)
        assert run.code == 0, run.text
        assert "(ERROR/" not in run.text and "(WARNING/" not in run.text
    return project.folder / "report.html"


def read_results(text):
    """Return the entries of result files in the script of the report, by experiment."""
    found = json.loads(re.search(r"var results = (\{.*?\});\s*</script>", text, re.S)[1])
    return {path.rpartition("/")[2].partition(".")[0]: one for path, one in found.items()}


def test_captions_are_escaped_in_the_report(report):
    text = report.read_text(encoding="utf-8")
    assert SECRET not in text
    results = read_results(text)
    assert set(results) == set(TITLES)
    for name, result in results.items():
        assert "system-message" not in result["caption"]
        assert set(re.findall(r"<(\w+)", result["caption"])) == {"p", "strong"}
        caption = html.unescape(re.sub("<[^>]*>", "", result["caption"]))
        expected = f"{TITLES[name]}. {CAPTIONS[name]} "
        assert " ".join(caption.split()).startswith(" ".join(expected.split()))
        assert "<" not in result["job_properties"]["params"]


@NEEDS_BROWSER
@pytest.mark.parametrize("name", TITLES)
def test_browser_shows_captions_unchanged(report, tmp_path, name):
    text = report.read_text(encoding="utf-8")
    path = tmp_path / "report.html"
    before, _, after = text.rpartition("</body>")
    path.write_text(before + SHOW_CAPTION_SCRIPT.format(name=name) + after, encoding="utf-8")
    page = page_of(path.as_uri(), tmp_path / "browser", 20_000)
    assert re.search(r"<title>Snakemake Report</title>", page)
    assert re.search(r'id="loading-screen" style="display: none;"', page)
    shown = html.unescape(re.sub("<[^>]*>", "", page[page.index('<div id="app">') :]))
    expected = f"{TITLES[name]}. {CAPTIONS[name]}"
    assert " ".join(expected.split()) in " ".join(shown.split())
