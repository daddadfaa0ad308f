"""Pages of the gallery, one per experiment and per figure of a study, and their tiles.

The pages are written below docs/gallery/ before Sphinx reads the folder, from config/ and from
docs/gallery/images/, which `snakemake update_docs` fills from a run.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from splits.core.yaml import dump_yaml, read_yaml
from splits.experiments.config.load import load_settings
from splits.media.kinds import NAMED_MEDIA_FOLDER

ROOT = Path(__file__).parents[2]
EXPERIMENTS = ROOT / "config" / "experiments"
GALLERY = ROOT / "docs" / "gallery"
STUDIES = "studies"


@dataclass(frozen=True)
class Page:
    """A page of the gallery."""

    folder: str
    name: str
    title: str
    caption: str
    target: str
    """Target of snakemake."""
    files: dict[str, str] = field(default_factory=dict)
    """Content of YAML and TOML files by title."""

    @property
    def image(self) -> Path:
        """Path of the image, which may not exist."""
        return GALLERY / "images" / f"{self.name}.webp"

    def text(self) -> str:
        """Return the page in MyST Markdown."""
        parts = [f"# {self.title}"]
        if self.image.exists():
            # With a width, Sphinx links the image to its full size.
            parts.append(
                f"```{{image}} ../images/{self.image.name}\n:alt: {self.title}\n:width: 100%\n```"
            )
        parts.append(self.caption)
        parts.append(f"```console\n$ snakemake --cores 2 {self.target}\n```")
        parts += [
            f"{name}:\n\n```{_get_language(name)}\n{text.rstrip()}\n```"
            for name, text in self.files.items()
        ]
        return "\n\n".join(part for part in parts if part) + "\n"


def _get_language(title: str) -> str:
    return "toml" if title.endswith(".toml`") else "yaml"


@functools.cache
def pages() -> list[Page]:
    """Return the pages of all experiments of config/, and of the figures of its studies."""
    return [_experiment(path) for path in sorted(EXPERIMENTS.rglob("*.yaml"))] + _studies()


def _experiment(path: Path) -> Page:
    content = read_yaml(path)
    name = str(content.get("name", path.stem))
    files = {f"`{path.relative_to(ROOT).as_posix()}`": path.read_text(encoding="utf-8")}
    base = content.get("medium", {}).get("base")
    if base:
        base_file = NAMED_MEDIA_FOLDER / f"{base}.toml"
        label = f"Base medium `{base_file.relative_to(ROOT).as_posix()}`"
        files[label] = base_file.read_text(encoding="utf-8")
    title, caption = (str(content.get(key, "")).strip() for key in ("title", "caption"))
    if content.get("figure") == "none" or content.get("figure", {}).get("kind") == "none":
        caption += "\n\nThis experiment has no figure."
    return Page(path.parent.name, name, title or name, caption, name, files)


def _studies() -> list[Page]:
    study_pages = []
    settings = load_settings(read_yaml(ROOT / "config" / "config.yaml"))
    for name, study in settings.studies.items():
        content = study.model_dump(mode="json", exclude_unset=True, exclude={"outputs"})
        content |= {"outputs": {file: {} for file in study.outputs}} if study.outputs else {}
        section = dump_yaml({"studies": {name: content}})
        files = {"In `config/config.yaml`": section}
        for file, output in study.outputs.items():
            if file.endswith(".png"):
                stem = file.removesuffix(".png")
                study_pages.append(Page(STUDIES, stem, output.title, output.caption, name, files))
    return study_pages


def write_pages(app: Sphinx) -> None:
    """Write all changed pages, and delete those of removed experiments."""
    pages.cache_clear()
    page_of = {GALLERY / page.folder / f"{page.name}.md": page for page in pages()}
    for path in GALLERY.glob("*/*.md"):
        if path not in page_of:
            path.unlink()
    for path, page in page_of.items():
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != page.text():
            path.write_text(page.text(), encoding="utf-8")


class Tiles(SphinxDirective):
    """``{gallery-tiles} FOLDER``: the pages of a folder as images with their titles."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the tiles and a table of contents for the sidebar."""
        folder = self.arguments[0]
        folder_pages = [page for page in pages() if page.folder == folder]
        lines = ["````{container} gallery"]
        for page in folder_pages:
            picture = f"![](images/{page.image.name})" if page.image.exists() else ""
            lines.append(f"- [{picture} {page.title}]({folder}/{page.name}.md)")
            self.env.note_dependency(str(page.image))
        lines += ["````", "", "```{toctree}", ":hidden:", ""]
        lines += [f"{page.title} <{folder}/{page.name}>" for page in folder_pages] + ["```"]
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive, and the writing of pages before Sphinx reads documents."""
    app.connect("builder-inited", write_pages)
    app.add_directive("gallery-tiles", Tiles)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
