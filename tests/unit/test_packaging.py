"""Consistency of dependency lists, versions and settings."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from shipped import CONFIG

from splits.experiments import Settings

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CONDA_NAMES = {"matplotlib": "matplotlib-base"}
LOCKS = {
    name: (ROOT / name).read_text(encoding="utf-8")
    for name in ("requirements.txt", "requirements-dev.txt")
}


def parse_lower_bounds(requirements):
    """Return the lower bound of each requirement by lower-case name."""
    parts = (re.fullmatch(r"([\w.-]+?)(?:>=([\d.]+))?", text).groups() for text in requirements)
    return {name.lower(): bound for name, bound in parts}


def list_required_bounds(*extras):
    """Return the lower bounds of all requirements with the extras, by lower-case name."""
    requirements = list(PROJECT["dependencies"])
    for extra in extras:
        for text in PROJECT["optional-dependencies"][extra]:
            self_reference = re.fullmatch(re.escape(PROJECT["name"]) + r"\[([\w,]+)\]", text)
            requirements += (
                [
                    f"{n}>={b}"
                    for n, b in list_required_bounds(*self_reference[1].split(",")).items()
                ]
                if self_reference
                else [text]
            )
    return parse_lower_bounds(requirements)


def parse_version(version):
    return tuple(int(part) for part in re.findall(r"\d+", version))


def parse_pins(name):
    """Return the versions and hashes that a lock file pins."""
    entries = re.split(r"\n(?=\S)", LOCKS[name].strip())
    pinned = {}
    for entry in entries:
        head = re.match(r"([\w.-]+)==(\S+)", entry)
        assert head, f"not a pin: {entry.splitlines()[0]}"
        pinned[head[1].lower()] = (head[2], re.findall(r"--hash=sha256:[0-9a-f]{64}\b", entry))
    return pinned


def test_conda_environment_matches_the_package():
    listed = yaml.safe_load((ROOT / "environment.yml").read_text(encoding="utf-8"))["dependencies"]
    by_pip = next(entry["pip"] for entry in listed if isinstance(entry, dict))
    conda = parse_lower_bounds(entry for entry in listed if isinstance(entry, str))
    assert conda.pop("python") == PROJECT["requires-python"].removeprefix(">=")
    conda.pop("pip")
    required = list_required_bounds("workflow")
    pip_only = parse_lower_bounds(by_pip)
    assert set(pip_only) <= set(required)
    assert conda == {
        CONDA_NAMES.get(name, name): bound
        for name, bound in required.items()
        if name not in pip_only
    }
    assert pip_only == {name: required[name] for name in pip_only}


def test_conda_recipe_matches_the_package():
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    context = recipe["context"]
    assert (context["name"], context["version"]) == (PROJECT["name"], PROJECT["version"])
    assert PROJECT["requires-python"] == f">={context['python_min']}"
    python, *others = recipe["requirements"]["run"]
    assert python == "python>=${{ python_min }}"
    assert parse_lower_bounds(others) == list_required_bounds()
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {target}" for name, target in PROJECT["scripts"].items()
    ]


@pytest.mark.parametrize(
    ("name", "extras"),
    [
        ("requirements.txt", ["workflow"]),
        ("requirements-dev.txt", PROJECT["optional-dependencies"]),
    ],
)
def test_every_dependency_is_pinned_within_its_bound(name, extras):
    pinned = parse_pins(name)
    required = list_required_bounds(*extras)
    for package, bound in required.items():
        version, _ = pinned[package.replace(".", "-")]
        assert parse_version(version) >= parse_version(bound)


def test_lock_files_agree_and_every_pin_has_hashes():
    pinned, smaller = parse_pins("requirements-dev.txt"), parse_pins("requirements.txt")
    assert smaller.items() <= pinned.items()
    for name, (_, hashes) in pinned.items():
        assert hashes, f"{name} has no hash"


@pytest.mark.parametrize("lock", LOCKS.values(), ids=LOCKS)
def test_lock_files_contain_no_hosts(lock):
    assert "://" not in lock
    assert not re.search(
        r"^\s*(-i|-f|--\w*index\w*|--find-links|--trusted-host)", lock, re.MULTILINE
    )


def test_main_configuration_contains_every_setting():
    shipped = yaml.safe_load((CONFIG / "config.yaml").read_text(encoding="utf-8"))
    assert set(shipped) == set(Settings.model_fields)
    Settings.model_validate(shipped)


def test_citation_has_the_package_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert str(citation["version"]) == PROJECT["version"]
