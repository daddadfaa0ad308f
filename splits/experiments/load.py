"""Reading configuration files: one clear message for anything that cannot be run."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar, get_args

import pandas as pd
import yaml
from pydantic import BaseModel, ValidationError

from splits.checks import refuse, suggestion
from splits.experiments.model import ConfigError, Experiment, Settings
from splits.experiments.run_fit import check_fit
from splits.experiments.sections import Section

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
        One message that names the file, the key, the value and what is allowed.
    """
    path = Path(path)
    content = {"name": path.stem, **read_yaml(path)}
    medium = content.get("medium")
    if isinstance(medium, dict):
        content["medium"] = _with_base(medium, path, "medium", Path(media_folder))
    elif "medium" in content:
        raise ConfigError(f"{path}: medium = {medium!r}: must be a mapping")
    grid = content.get("grid")
    if isinstance(grid, dict) and isinstance(grid.get("medium"), (list, dict)):
        grid["medium"] = _samples(grid["medium"], path, Path(media_folder))
    experiment = _checked(Experiment, content, path)
    folder = Path(media_folder).parent / "measured"
    given = {"figure": experiment.figure.measured}
    given["fit"] = experiment.fit.measured if experiment.fit else None
    for section, measured in given.items():
        if measured and not (folder / measured).is_file():
            known = ", ".join(sorted(p.name for p in folder.glob("*.csv")))
            raise ConfigError(f"{path}: {section}.measured = {measured!r}: must be one of {known}")
    if experiment.fit:
        try:
            if experiment.figure.kind != "fit":
                raise refuse("figure.kind", experiment.figure.kind, "'fit' beside a section fit")
            check_fit(experiment, pd.read_csv(folder / experiment.fit.measured, comment="#"))
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from None
    return experiment


def _samples(given: Any, path: Path, folder: Path) -> dict[str, Any]:
    """Return the media of a grid by label, those given by a file's name read from that file."""
    named = {str(name): name for name in given} if isinstance(given, list) else given
    return {
        label: _with_base(
            {"base": value} if isinstance(value, str) else value,
            path,
            f"grid.medium.{label}",
            folder,
        )
        for label, value in named.items()
    }


def _with_base(medium: Any, path: Path, place: str, folder: Path) -> Any:
    """Return a medium's settings on top of those of the file that its ``base`` names."""
    if not isinstance(medium, dict) or "base" not in medium:
        return medium
    base = folder / f"{medium['base']}.yaml"
    if not base.is_file():
        known = sorted(p.stem for p in folder.glob("*.yaml"))
        hint = suggestion(medium["base"], known)
        raise ConfigError(
            f"{path}: {place}.base = {medium['base']!r}: must be one of {', '.join(known)}"
            + (f" ({hint})" if hint else "")
        )
    own = {key: value for key, value in medium.items() if key != "base"}
    return {**read_yaml(base), **own}


def load_experiments(
    folder: str | Path, media_folder: str | Path = "config/media"
) -> dict[str, Experiment]:
    """Read and check all experiment files below a folder, by name.

    Raises
    ------
    ConfigError
        For the first file that cannot be run, for a name used twice, or if there is none.
    """
    experiments: dict[str, Experiment] = {}
    files: dict[str, Path] = {}
    for path in sorted(Path(folder).rglob("*.y*ml")):
        experiment = load_experiment(path, media_folder)
        if experiment.name in experiments:
            raise ConfigError(
                f"{path}: name = {experiment.name!r}: already taken by {files[experiment.name]}"
            )
        experiments[experiment.name] = experiment
        files[experiment.name] = path
    if not experiments:
        raise ConfigError(f"{folder}: no experiment file (*.yaml)")
    return experiments


def load_settings(content: dict[str, Any], origin: str = "config/config.yaml") -> Settings:
    """Check the main configuration, given as a mapping."""
    return _checked(Settings, content, Path(origin))


def _checked(model: type[Model], content: dict[str, Any], path: Path) -> Model:
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ConfigError(f"{path}: {_message(model, first)}") from None
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from None


def _message(model: type[BaseModel], error: Any) -> str:
    """Return one line for one pydantic error: key, value, what is allowed."""
    place = [str(part) for part in error["loc"]]
    key = ".".join(part for part in place if not part[0].isupper() and part != "function-after")
    if error["type"] == "extra_forbidden":
        known = _keys_at(model, place[:-1])
        hint = suggestion(place[-1], known)
        text = f"{key}: unknown key, must be one of {', '.join(known)}"
        return text + (f" ({hint})" if hint else "")
    if error["type"] == "value_error":
        return str(error["ctx"]["error"])
    if error["type"] == "missing":
        return f"{key}: missing"
    message = error["msg"][0].lower() + error["msg"][1:]
    return f"{key} = {error['input']!r}: {message}"


def _keys_at(model: type[BaseModel], place: list[str]) -> list[str]:
    """Return the keys of the section that a location leads to."""
    for part in place:
        field = model.model_fields.get(part)
        if field is None:
            continue
        kinds = [field.annotation, *get_args(field.annotation)]
        sections = [k for k in kinds if isinstance(k, type) and issubclass(k, Section)]
        model = sections[0] if sections else model
    return list(model.model_fields)
