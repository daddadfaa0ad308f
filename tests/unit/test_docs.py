"""The documentation site: completeness, size, and self-contained pages."""

import inspect
import json
import math
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
from _numbers.gallery_images import MAX_IMAGE_BYTES, MAX_WIDTH_PX, compress_figure, write_gallery
from shipped import CONFIG

import splits
from splits.core.declarations import list_inputs
from splits.core.discovery import list_instrument_names
from splits.core.yaml import read_yaml
from splits.experiments import load_settings
from splits.experiments.config.experiment import ExperimentConfig, list_figure_inputs
from splits.experiments.config.instruments import KINDS, list_section_inputs
from splits.experiments.config.retrieval import NoiseSection, PriorFromSample, RetrieveSection
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.settings import ArchiveAuthor, Settings, Study, StudyOutput
from splits.instruments.snow_packs import RESULT_FLAGS
from splits.simulation.strata import STOP_REASONS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
IMAGES = DOCS / "gallery" / "images"

for package in ("sphinx", "latex2mathml"):
    pytest.importorskip(package, reason="comes with the extra docs")
sys.path.insert(0, str(DOCS / "_ext"))
import configuration  # noqa: E402
import gallery  # noqa: E402
import marked_numbers  # noqa: E402
import mathml  # noqa: E402


def list_pages():
    return [p for p in sorted(DOCS.rglob("*.md")) if not {"_build", "gallery"} & set(p.parts)]


# --- reference ------------------------------------------------------------------------------------


def test_every_public_name_is_documented():
    text = "".join(p.read_text(encoding="utf-8") for p in (DOCS / "reference/api").glob("*.md"))
    documented = re.findall(r"^\.\. auto(?:class|function|data):: splits\.(\w+)$", text, re.M)
    public = sorted(set(splits.__all__) - {"__version__"})
    assert public == sorted(documented)
    index = (DOCS / "reference/api/index.md").read_text(encoding="utf-8")
    assert public == sorted(re.findall(r"^   (\w+)$", index, re.M))


MODELS = [
    ExperimentConfig, RetrieveSection, NoiseSection, PriorFromSample,
    Settings, Accuracy, ArchiveAuthor, Study, StudyOutput,
]  # fmt: skip


@pytest.mark.parametrize("model", MODELS)
def test_every_configuration_key_is_described(model):
    fields = model.model_fields.items()
    assert all(field.description for key, field in fields if key != "kind")
    assert model.__doc__


def test_every_key_of_figures_is_described():
    rows = configuration.list_figure_keys()
    assert [key for key, *_ in rows] == [f"`{key}`" for key in list_figure_inputs()]
    assert all(meaning and allowed for _, meaning, _, allowed in rows)


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_of_instruments_is_described(kind):
    keys = {key: meaning for key, meaning, *_ in configuration.list_section_rows(kind)}
    assert keys.keys() == {f"`{key}`" for key in list_section_inputs(kind)}
    assert all(keys.values())


PUBLIC_NAMES = [name for of in ("media", "instruments") for name in configuration.list_names(of)]


@pytest.mark.parametrize("name", PUBLIC_NAMES)
def test_every_keyword_is_described(name):
    found, declaring = configuration.find_object(name)
    assert name.startswith("splits.") and declaring in (found, splits.Snow)
    rows = configuration.list_keywords(name)
    assert list(rows) == list(inspect.signature(found).parameters)
    for keyword, one in list_inputs(declaring).items():
        meaning, _, values, _ = rows[keyword]
        assert meaning == one.quantity.long_name and values, keyword


def test_page_of_keywords_shows_all_media_and_instruments():
    shown = {name.rpartition(".")[2] for name in PUBLIC_NAMES}
    assert {"Snow", "natural", "Sand", "ParticleLayer", "Stack", *list_instrument_names()} <= shown
    page = (DOCS / "reference" / "keywords.md").read_text(encoding="utf-8")
    assert {"media", "instruments"} == set(re.findall(r"{all-keywords} (\w+)", page))


def test_tables_of_keywords_name_public_objects():
    pattern = r"```{keywords} (.+)\n(?::only: (.+)\n)?```"
    found = [one for path in list_pages() for one in re.findall(pattern, path.read_text())]
    assert len(found) > 10
    for names, only in found:
        lines = configuration.make_keyword_table(names.split(), only.split() or None).splitlines()
        assert len(lines) == 2 + len(only.split() or configuration.list_keywords(names.split()[0]))


def test_tables_of_keys_show_known_models():
    page = (DOCS / "reference" / "configuration.md").read_text(encoding="utf-8")
    names = re.findall(r"```{config-keys} ([\w.]+)\.(\w+)\n", page)
    shown = {getattr(import_module(module), name) for module, name in names}
    assert set(MODELS[:1]) < shown and set(MODELS) & shown


def test_every_output_of_a_study_has_a_title_and_a_caption():
    for study in load_settings(read_yaml(CONFIG / "config.yaml")).studies.values():
        for file, output in study.outputs.items():
            assert file.endswith(".nc") or (output.title and output.caption), file


def test_reasons_of_stopping_and_flags_of_snowpacks_are_listed_in_their_order():
    page = (DOCS / "reference/datasets.md").read_text(encoding="utf-8")
    rows = page.partition("| `stop_reason` | meaning |")[2].partition("\n\n")[0]
    assert tuple(re.findall(r"^\| `(\w+)`", rows, re.MULTILINE)) == STOP_REASONS
    page = (DOCS / "how-to/season-of-snow.md").read_text(encoding="utf-8")
    flags = re.findall(r"^\| (\d) \| `(\w+)`", page, re.MULTILINE)
    assert {name: int(number) for number, name in flags} == RESULT_FLAGS


def test_documented_limits_and_defaults_match_the_models():
    rows = {key: others for key, _, *others in configuration.list_section_rows("goniophotometer")}
    assert rows["`target`"] == ["one of `brdf`, `btdf`", "`brdf`"]
    assert rows["`rays`"] == ["a whole number, at least 1", "—"]
    bins = "a list of 2 whole numbers (polar, azimuth), at least 1, at most 1000"
    assert rows["`n_bins`"] == [bins, "—"]
    assert rows["`stderr_scale`"] == ["a number, at least 0.01, at most 100", "`1`"]
    assert rows["`seed`"] == ["a whole number, at least 0", "—"]
    assert rows["`polar_deg`"][1] == "—"
    wavelengths, default = rows["`wavelength_nm`"]
    assert wavelengths.startswith("one or several numbers, at least 200, at most 100000; or a map")
    assert "`start`, `stop`, `step`, possibly `also`" in wavelengths
    assert default == "`{start: 400, stop: 2500, step: 10}`"
    rows = {key: others for key, _, *others in configuration.list_rows(Accuracy)}
    assert rows["`relative_stderr`"][0] == "a number, at least 0.0001, at most 0.5"
    assert rows["`max_stderr`"][1] == "required"


@pytest.mark.parametrize("name", PUBLIC_NAMES)
def test_documented_limits_match_the_declarations(name):
    found, declaring = configuration.find_object(name)
    rows = configuration.list_keywords(name)
    for keyword, one in list_inputs(declaring).items():
        quantity, (_, _, values, default) = one.quantity, rows[keyword]
        for limit in () if quantity.check else (quantity.low, quantity.high):
            shown = f" {configuration.show_number(limit)}"
            assert math.isinf(limit) or f"{values},".count(f"{shown},"), keyword
        assert values.endswith("or infinite") == quantity.infinite
        given = inspect.signature(found).parameters[keyword].default
        if isinstance(given, bool | str):
            assert default == (f"`{given}`" if isinstance(given, bool) else f'`"{given}"`')
        elif isinstance(given, int | float) and math.isfinite(given):
            assert float(default.strip("`")) == pytest.approx(given, rel=1e-5)
        assert (default == "required") == (given is inspect.Parameter.empty)


def test_declared_defaults_are_shown_as_in_files_and_in_python():
    assert configuration.list_keywords("splits.Snow.natural")["depth_m"][-1] == "infinite"
    assert configuration.list_keywords("splits.Snow.natural")["saturation"][-1] == "`0`"
    shown = configuration.list_keywords("splits.Snow")
    assert shown["grain_size_um"][1:] == (
        "µm", "a list of 2 numbers (min, max), at least 1, at most 100000", "`(300, 750)`"
    )  # fmt: skip
    assert shown["depth_m"][2] == "a number, above 0, at most 10000, or infinite"
    assert configuration.show_default((18, 72), as_yaml=True) == "`[18, 72]`"
    assert configuration.show_default(False, as_yaml=True) == "`false`"
    assert configuration.show_default("auto") == '`"auto"`'


# --- gallery --------------------------------------------------------------------------------------


def test_every_experiment_has_a_page_and_an_image():
    shown = {page.name: page for page in gallery.pages()}
    assert len(shown) == len(gallery.pages())
    for path in (CONFIG / "experiments").rglob("*.yaml"):
        page, figure = shown[path.stem], read_yaml(path).get("figure", {})
        assert path.read_text(encoding="utf-8").rstrip() in page.text()
        assert f"snakemake --cores 2 {path.stem}\n" in page.text()
        assert page.image.exists() == (figure not in ("none", {"kind": "none"})), path.stem


def test_every_figure_of_a_study_has_a_page_and_an_image():
    shown = {page.name: page for page in gallery.pages() if page.folder == gallery.STUDIES}
    studies = load_settings(read_yaml(CONFIG / "config.yaml")).studies
    for name, study in studies.items():
        for paths in study.list_product_paths(name).values():
            for path in paths:
                if path.endswith(".png"):
                    page = shown.pop(Path(path).stem)
                    assert page.image.exists() and f"--cores 2 {name}\n" in page.text()
    assert not shown


def test_gallery_images_are_small_and_used():
    image = pytest.importorskip("PIL.Image")
    names = {page.image.name for page in gallery.pages()}
    for path in IMAGES.iterdir():
        assert path.name in names
        assert path.stat().st_size <= MAX_IMAGE_BYTES
        with image.open(path) as picture:
            assert picture.width <= MAX_WIDTH_PX


def test_gallery_index_lists_every_folder():
    text = (DOCS / "gallery" / "index.md").read_text(encoding="utf-8")
    folders = re.findall(r"{gallery-tiles} (\w+)", text)
    assert sorted(folders) == sorted({page.folder for page in gallery.pages()})


def test_gallery_images_are_written_and_removed_with_figures(tmp_path):
    image = pytest.importorskip("PIL.Image")
    figures, folder = tmp_path / "figures", tmp_path / "images"
    figures.mkdir()
    for name, width in {"wide": 2 * MAX_WIDTH_PX, "narrow": 100}.items():
        image.effect_noise((width, 50), 40).save(figures / f"{name}.png")
    with pytest.raises(ValueError, match=r"gone\.png'.*must be an existing file"):
        write_gallery(figures, ["wide", "gone"], folder)
    assert not folder.exists()
    assert write_gallery(figures, ["wide", "narrow"], folder) == (
        [folder / "wide.webp", folder / "narrow.webp"],
        [],
    )
    with image.open(folder / "wide.webp") as reduced:
        assert reduced.size == (MAX_WIDTH_PX, 25)
    assert write_gallery(figures, ["narrow"], folder) == ([], [folder / "wide.webp"])
    assert [path.name for path in folder.iterdir()] == ["narrow.webp"]


def test_a_figure_that_cannot_be_compressed_is_rejected(tmp_path, monkeypatch):
    image = pytest.importorskip("PIL.Image")
    image.effect_noise((100, 100), 90).save(tmp_path / "noise.png")
    monkeypatch.setattr("_numbers.gallery_images.MAX_IMAGE_BYTES", 100)
    with pytest.raises(ValueError, match="fits into 100 bytes"):
        compress_figure(tmp_path / "noise.png")


# --- pages ----------------------------------------------------------------------------------------


def test_marks_of_numbers_are_removed_from_pages():
    source = ["| 0.8 ± 0.1<!--a.b--> | 10⁷<!--c--> |"]
    marked_numbers.without_marks(None, "page", source)
    assert source == ["| 0.8 ± 0.1 | 10⁷ |"]


def test_unknown_formulas_give_warnings(caplog):
    formula = mathml.nodes.math("", r"\frac{a}{b} \le \mathrm{e}^{-\alpha \ell}")
    assert mathml.mathml(formula, "inline").startswith("<math")
    assert not caplog.records
    for text, message in {
        r"\unheardof{x}": "unheardof is not known",
        r"x_": "MissingSuperScr",
    }.items():
        mathml.mathml(mathml.nodes.math("", text), "block")
        assert message in caplog.text
        caplog.clear()


def test_notebooks_are_stored_without_outputs():
    notebooks = sorted((DOCS / "notebooks").glob("*.ipynb"))
    assert notebooks
    for path in notebooks:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert not cell.get("outputs") and cell.get("execution_count") is None, path.name


def test_executed_pages_have_a_notebook_header():
    for path in list_pages():
        text = path.read_text(encoding="utf-8")
        if "{code-cell}" in text:
            assert text.startswith("---\nfile_format: mystnb\n"), path


def test_pages_referenced_in_sources_exist():
    folders = ("splits", "workflow", "config", "tests")
    files = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "Snakefile")]
    files += [path for folder in folders for path in (ROOT / folder).rglob("*.*")]
    suffixes = {".py", ".smk", ".rst", ".yaml", ".toml", ".md", ""}
    referenced = {
        page
        for path in files
        if path.suffix in suffixes
        for page in re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text(encoding="utf-8"))
    }
    assert len(referenced) > 10
    assert [page for page in sorted(referenced) if not (ROOT / page).exists()] == []
