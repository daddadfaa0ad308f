"""Reading configuration files: one clear message for anything that cannot be run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
import yaml
from pydantic import BaseModel, ValidationError

from splits.checks import one_of, refuse
from splits.experiments.messages import line_of
from splits.experiments.model import SAMPLE, ConfigError, Experiment
from splits.experiments.run_fit import check_fit
from splits.experiments.settings import Settings
from splits.experiments.unused import keywords_given, refuse_unused

Model = TypeVar("Model", bound=BaseModel)


class _UniqueKeys(yaml.SafeLoader):
    """A YAML loader that refuses a key given twice instead of forgetting the first."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.MarkedYAMLError(
                    problem=f"{key} given twice", problem_mark=node.start_mark
                )
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Writes what `_UniqueKeys` reads."""


# YAML 1.1 takes 1e5 for text, which nobody means.
for _yaml in (_UniqueKeys, _Dumper):
    _yaml.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"[-+]?(\d[\d_]*\.?\d*|\.\d+)[eE][-+]?\d+$"),
        [*"-+.0123456789"],
    )


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not YAML or is not a mapping.
    """
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), Loader=_UniqueKeys)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not text"
        raise ConfigError(f"{path}{where}: not YAML ({problem})") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of keys to values")
    return content


def yaml_of(content: dict[str, Any]) -> str:
    """Return the text that `read_yaml` takes for that content."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def load_experiment(path: str | Path, media_folder: str | Path = "config/media") -> Experiment:
    """Read and check one experiment file; its name is the file's unless it gives another.

    Parameters
    ----------
    path : path
    media_folder : path
        Where ``medium: {base: NAME}`` finds ``NAME.yaml``.

    Raises
    ------
    ConfigError
        One line that names the file, the key, the value and what is allowed.
    """
    path = Path(path)
    try:
        return _experiment(path, Path(media_folder))
    except ConfigError:
        raise
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from None


def _experiment(path: Path, media: Path) -> Experiment:
    """Return what an experiment file describes; errors need not name the file."""
    content = {"name": path.stem, **read_yaml(path)}
    given = keywords_given(content)
    medium, grid = content.get("medium", {}), content.get("grid")
    if not isinstance(medium, dict):
        raise refuse("medium", medium, "a mapping of keys to values")
    if medium:
        content["medium"] = _with_base(medium, "medium", media)
    if isinstance(grid, dict) and isinstance(grid.get(SAMPLE), (list, dict)):
        content["grid"] = grid | {SAMPLE: _samples(grid[SAMPLE], media)}
    experiment = _checked(Experiment, content)
    refuse_unused(experiment, given)
    folder = media.parent / "measured"
    tables = {"figure": experiment.figure.measured}
    tables["fit"] = experiment.fit.measured if experiment.fit else None
    for section, measured in tables.items():
        if measured and (Path(measured).is_absolute() or ".." in Path(measured).parts):
            hint = "an archive takes these; copy the table there"
            raise refuse(f"{section}.measured", measured, f"the name of a file of {folder}", hint)
        if measured and not (folder / measured).is_file():
            one_of(f"{section}.measured", measured, [p.name for p in folder.glob("*.csv")])
    if experiment.fit:
        if experiment.figure.kind != "fit":
            raise refuse("figure.kind", experiment.figure.kind, "'fit' beside a section fit")
        try:
            table = pd.read_csv(folder / experiment.fit.measured, comment="#")
        except ValueError as error:
            hint = " ".join(str(error).split())
            raise refuse(
                "fit.measured", experiment.fit.measured, "a table, by commas", hint
            ) from None
        check_fit(experiment, table)
    return experiment


def _samples(given: Any, folder: Path) -> dict[str, Any]:
    """Return the media of a grid by label, those given by a file's name read from that file."""
    if isinstance(given, list) and not all(isinstance(name, str) for name in given):
        allowed = "names of files, or a mapping from labels to media"
        raise refuse(f"grid.{SAMPLE}", given, allowed)
    named = {name: name for name in given} if isinstance(given, list) else given
    return {
        label: _with_base(
            {"base": value} if isinstance(value, str) else value, f"grid.{SAMPLE}.{label}", folder
        )
        for label, value in named.items()
    }


def _with_base(medium: Any, place: str, folder: Path) -> Any:
    """Return a medium's settings on top of those of the file that its ``base`` names."""
    if not isinstance(medium, dict) or "base" not in medium:
        return medium
    base = one_of(f"{place}.base", medium["base"], [p.stem for p in folder.glob("*.yaml")])
    own = {key: value for key, value in medium.items() if key != "base"}
    return {**read_yaml(folder / f"{base}.yaml"), **own}


def load_experiments(
    folder: str | Path, media_folder: str | Path = "config/media"
) -> dict[str, Experiment]:
    """Read and check all experiment files below a folder, by name.

    Raises
    ------
    ConfigError
        With one line for each file that cannot be run or has the name of another, or if there
        is no file.
    """
    experiments: dict[str, Experiment] = {}
    files: dict[str, Path] = {}
    refused: list[str] = []
    for path in sorted(Path(folder).rglob("*.y*ml")):
        try:
            experiment = load_experiment(path, media_folder)
        except ConfigError as error:
            refused.append(str(error))
            continue
        name = experiment.name
        if name in experiments:
            refused.append(f"{path}: name = {name!r}: already taken by {files[name]}")
        experiments[name], files[name] = experiment, path
    if refused:
        raise ConfigError("\n".join(refused))
    if not experiments:
        raise ConfigError(f"{folder}: no experiment file (*.yaml)")
    return experiments


def load_settings(content: dict[str, Any], origin: str = "config/config.yaml") -> Settings:
    """Check the main configuration, given as a mapping."""
    try:
        return _checked(Settings, content)
    except ValueError as error:
        raise ConfigError(f"{origin}: {error}") from None


def _checked(model: type[Model], content: dict[str, Any]) -> Model:
    """Return a model of the content, or refuse it in one line."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ValueError(line_of(model, error)) from None
