"""Layers of the package, and what its modules import."""

import ast
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

import splits

ROOT = Path(__file__).parents[2]
LAYERS = (
    "core", "kernels", "io", "materials", "illumination", "media", "simulation",
    "discrete_ordinates", "instruments", "tables", "analysis", "retrieval", "plotting",
    "experiments", "cli", "__main__",
)  # fmt: skip
"""Packages from the lowest to the highest layer."""
INNER_LAYERS = {
    "kernels": (
        "compiler", "scene", "records", "scattering_matrix", "arithmetic", "rng", "interpolation",
        "phase_function", "stokes", "interface", "rays", "tallies", "rough_surface", "grains",
        "transport", "vectorized",
    ),
    "experiments": ("config", "report"),
}  # fmt: skip


def list_module_files() -> dict[str, Path]:
    """Return the files of all modules of the package by dotted name."""
    files = (ROOT / "splits").rglob("*.py")
    names = {".".join(p.relative_to(ROOT).with_suffix("").parts): p for p in files}
    return {name.removesuffix(".__init__"): path for name, path in names.items()}


def collect_imports() -> dict[str, set[str]]:
    """Return the modules of the package that each of them imports, anywhere in its source."""
    files = list_module_files()
    imported: dict[str, set[str]] = defaultdict(set)
    for module, path in files.items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
                names = [name if name in files else node.module for name in names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            imported[module] |= {name for name in names if name in files and name != module}
    return imported


IMPORTS = collect_imports()


def test_every_package_belongs_to_a_layer():
    packages = {module.split(".")[1] for module in list_module_files() if "." in module}
    assert packages == set(LAYERS)


@pytest.mark.parametrize(
    ("parent", "layers"),
    [("splits", LAYERS), *((f"splits.{name}", inner) for name, inner in INNER_LAYERS.items())],
)
def test_packages_import_lower_layers_only(parent, layers):
    def layer(module: str) -> int | None:
        rest = module.removeprefix(f"{parent}.").split(".")
        return layers.index(rest[0]) if module != parent and rest[0] in layers else None

    upward = [
        f"{module} imports {other}"
        for module, others in IMPORTS.items() if module.startswith(f"{parent}.")
        for other in others if other.startswith(f"{parent}.")
        if None not in (low := layer(module), high := layer(other)) and high > low
    ]  # fmt: skip
    assert not upward


def test_no_circular_imports():
    try:
        TopologicalSorter(IMPORTS).prepare()
    except CycleError as error:
        pytest.fail(f"circular: {error.args[1]}")


KERNELS = ("grains", "transport", "vectorized")
"""Packages of `splits.kernels` that implement the same steps of a history, under the same names."""


def collect_definitions(kind: type[ast.stmt]) -> dict[str, list[str]]:
    """Return the modules in which each public definition of a kind is, by its name."""
    modules_by_name = defaultdict(list)
    for module, path in list_module_files().items():
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, kind) and not node.name.startswith("_"):
                modules_by_name[node.name].append(module)
    return modules_by_name


def test_classes_are_defined_once():
    assert not {
        name: modules for name, modules in collect_definitions(ast.ClassDef).items() if modules[1:]
    }


def test_functions_are_defined_once_except_kernel_steps():
    def is_step(modules: list[str]) -> bool:
        kernels = [module.split(".")[2] for module in modules if module.count(".") > 2]
        return len(set(kernels)) == len(modules) and set(kernels) <= set(KERNELS)

    repeated = {name: m for name, m in collect_definitions(ast.FunctionDef).items() if m[1:]}
    assert not {name: modules for name, modules in repeated.items() if not is_step(modules)}


# --- imports --------------------------------------------------------------------------------------


PACKAGE = Path(splits.__file__).parent
SCRIPTS = [path for folder in ("benchmarks", "workflow", "tests/campaigns")
           for path in sorted((ROOT / folder).rglob("*.py"))]  # fmt: skip


def list_imports(path):
    """Yield the packages that a module imports when it is imported."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


def test_scipy_is_imported_by_no_module():
    """scipy.stats doubles the import time."""
    importing = [path for path in PACKAGE.rglob("*.py") if "scipy" in list_imports(path)]
    assert importing == []


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_names_that_scripts_import_exist(path):
    """No other test imports most of these scripts."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "splits":
            module = import_module(node.module)
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                assert hasattr(module, alias.name) or submodule in list_module_files(), alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "splits":
                    import_module(alias.name)
