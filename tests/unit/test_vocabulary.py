"""Words that this project has given up in favour of the field's terms occur nowhere."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLACES = ("splits", "workflow", "docs", "config", "Snakefile", "README.md", "CONTRIBUTING.md")
SUFFIXES = {".py", ".pyi", ".smk", ".md", ".rst", ".yaml", ".ipynb", ".html", ".js", ""}
FORBIDDEN = {
    "segment": r"\blegs?\b",
    "weight, roulette state": r"\bpurses?\b",
    "ray": r"\bfliers?\b",
    "grain ceiling": r"\bbrims?\b",
    "rough top": r"\broofs?\b",
    "interpretation": r"\breadings\b|\b(a|an|the|this|one|each|another|which) reading\b",
    "analog absorption": r"\bcoin toss(es)?\b",
    "detect, record": r"\b(listens?|listened|hears?|heard)\b",
    "indicate, determine": r"\b(told|tells?)\b(?!\()",
    "reflect": r"\bsen(ds?|t) back\b",
    "are correlated": r"\bgo together\b",
    "is proportional to": r"\bgoes with\b",
    "layered medium, snowpack": r"\b(snow|the|an?|this|these|all|deep|thick|of) packs?\b|^pack\b",
    "semi-infinite": r"\bendless\b",
    "n, the number": r"\bso many\b",
    "use, are estimated from": r"\bdraws? on\b",
    "reject": r"\b(refuses?|refused|refusals?)\b",
    "name the actor": r"\b(nobody|somebody|whoever|whosoever)\b",
    "in proportion, cheaply": r"\b(a good deal|at next to no cost)\b",
}
"""The field's term and a regular expression of the words that it takes the place of."""


def list_files() -> list[Path]:
    """Return the tracked text files of the package, its workflow, configuration and documents."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", *PLACES],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    paths = [ROOT / name for name in listed]
    return [path for path in paths if path.suffix in SUFFIXES and path.is_file()]


@pytest.mark.parametrize("term", FORBIDDEN)
def test_the_term_of_the_field_is_used(term):
    pattern = re.compile(FORBIDDEN[term], re.IGNORECASE)
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:80]}"
        for path in list_files()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if pattern.search(line)
    ]
    assert not found, f"use {term}: {len(found)} lines\n" + "\n".join(found[:20])


def test_definitions_that_documents_name_exist():
    missing = []
    for path in list_files():
        if path.suffix not in {".md", ".ipynb"}:
            continue
        for file, name in re.findall(
            r"`(?:splits/)?([a-z_/]+\.py): (\w+)`", path.read_text("utf-8")
        ):
            source = next(
                (one for one in (ROOT / file, ROOT / "splits" / file) if one.is_file()), None
            )
            pattern = rf"^(?:@.*\n)*(?:def|class) {name}\b|^{name}\b"
            if not source or not re.search(pattern, source.read_text("utf-8"), re.M):
                missing.append(f"{path.relative_to(ROOT)}: {file}: {name}")
    assert not missing


def test_source_files_that_documents_name_exist():
    missing = [
        f"{path.relative_to(ROOT)}: {file}"
        for path in list_files()
        if path.suffix in {".md", ".ipynb"}
        # The first line of a code block, a comment, names a file that the page adds.
        for file in re.findall(
            r"(?<!# )(?<![\w/])((?:[a-z_]+/)+[a-z_]+\.py)\b", path.read_text("utf-8")
        )
        if not any((folder / file).is_file() for folder in (ROOT, ROOT / "splits"))
    ]
    assert not missing
