"""Reading configuration files: one clear message for anything that cannot be run."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from pydantic import BaseModel, ValidationError

from splits.analysis.measured import WAVELENGTH, read_spectra
from splits.checks import one_of, refuse
from splits.experiments.check_retrieve import check_spectra
from splits.experiments.figure_sizes import check_size
from splits.experiments.messages import line_of
from splits.experiments.model import Experiment
from splits.experiments.run_fit import check_fit
from splits.experiments.settings import Settings
from splits.experiments.simulation import SAMPLE
from splits.experiments.stacks import LAYERS, with_bases
from splits.experiments.texts import check_path
from splits.experiments.unused import keywords_given, refuse_replaced, refuse_unused
from splits.experiments.yaml_files import ConfigError, read_yaml
from splits.media.measured_inputs import on_top
from splits.paths import expand_path
from splits.retrieval.measurement import PER_CENT

Model = TypeVar("Model", bound=BaseModel)

LONGEST = 450
"""Characters of a message, the name of its file left out."""


def load_experiment(
    path: str | Path,
    media_folder: str | Path = "config/media",
    measured_folder: str | Path | None = None,
) -> Experiment:
    """Read and check one experiment file; its name is the file's unless it gives another.

    Parameters
    ----------
    path : path
    media_folder : path
        Where ``medium: {base: NAME}`` finds ``NAME.yaml``.
    measured_folder : path, optional
        Where measured tables are; by default ``measured`` beside the media.

    Raises
    ------
    ConfigError
        One line that names the file, the key, the value and what is allowed.
    """
    try:
        path, media = expand_path(path), expand_path(media_folder, "media_folder")
        measured = expand_path(measured_folder or media.parent / "measured", "measured_folder")
        return _experiment(path, media, measured)
    except ConfigError:
        raise
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{path}: {_line(str(error))}") from None


def _line(text: str) -> str:
    """Return a message on one line of bounded length, whatever a user's words in it are."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    return plain if len(plain) <= LONGEST else f"{plain[: LONGEST - 2]} …"


def _experiment(path: Path, media: Path, measured: Path) -> Experiment:
    """Return what an experiment file describes; errors need not name the file."""
    content = {"name": path.stem, **read_yaml(path)}
    refuse_replaced(content)
    given = keywords_given(content)
    medium, grid = content.get("medium", {}), content.get("grid")
    if not isinstance(medium, dict):
        raise refuse("medium", medium, "a mapping of keys to values")
    if medium:
        content["medium"] = _whole(medium, "medium", media)
    if isinstance(grid, dict) and isinstance(grid.get(SAMPLE), (list, dict)):
        grid = content["grid"] = grid | {SAMPLE: _samples(grid[SAMPLE], media)}
    if isinstance(grid, dict) and isinstance(grid.get(LAYERS), dict):
        whole = {
            label: _whole({LAYERS: layers}, f"grid.{LAYERS}.{label}", media)[LAYERS]
            for label, layers in grid[LAYERS].items()
        }
        content["grid"] = grid | {LAYERS: whole}
    experiment = _checked(Experiment, content)
    refuse_unused(experiment, given)
    check_size(experiment)
    if experiment.figure.measured:
        _check_drawn(experiment, _measured("figure.measured", measured, experiment.figure.measured))
    if experiment.retrieve:
        name = experiment.retrieve.measured
        check_spectra(experiment, _measured("retrieve.measured", measured, name))
    if experiment.fit:
        if experiment.figure.kind not in ("fit", "none"):
            raise refuse("figure.kind", experiment.figure.kind, "'fit' beside a section fit")
        check_fit(experiment, _measured("fit.measured", measured, experiment.fit.measured))
    return experiment


def _measured(key: str, folder: Path, name: str) -> pd.DataFrame:
    """Return a measured table, or refuse its name or what the file holds."""
    if not (folder / name).is_file():
        there = [p.name for p in folder.glob("*.csv")]
        if not there:
            raise refuse(key, name, f"a CSV file in {folder}", "there is none")
        one_of(key, name, there)
    return read_spectra(folder / name, key)


def _check_drawn(experiment: Experiment, measured: pd.DataFrame) -> None:
    """Refuse a measured table that does not hold, as shares, what the figure shows beside it."""
    key, quantity = "figure.measured", experiment.figure.quantity
    drawn = [name for name in quantity if name in measured and measured[name].count()]
    if not drawn:
        columns = f"{WAVELENGTH} and {' or '.join(quantity)}"
        raise refuse(key, experiment.figure.measured, f"a table with columns {columns}")
    for name in drawn:
        ends = [f"{name}_min", f"{name}_max"]
        if len(set(ends) & set(measured)) == 1:
            raise refuse(key, experiment.figure.measured, f"with both {' and '.join(ends)}")
        rows = measured[[end for end in (ends[0], name, ends[1]) if end in measured]].to_numpy()
        largest = np.nanmax(np.abs(rows), initial=0.0)
        if largest > PER_CENT:
            hint = "shares, not per cent"
            raise refuse(f"{key} ({name})", float(largest), f"at most {PER_CENT:g}", hint)
        if (np.diff(rows, axis=1) < 0.0).any():
            raise refuse(key, experiment.figure.measured, f"with {ends[0]} <= {name} <= {ends[1]}")


def _samples(given: Any, folder: Path) -> dict[str, Any]:
    """Return the media of a grid by label, those given by a file's name read from that file."""
    if isinstance(given, list) and not all(isinstance(name, str) for name in given):
        allowed = "names of files, or a mapping from labels to media"
        raise refuse(f"grid.{SAMPLE}", given, allowed)
    named = {name: name for name in given} if isinstance(given, list) else given
    return {
        label: _whole(
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
    content = read_yaml(folder / f"{base}.yaml")
    kind = content.get("kind", "snow")
    if own.get("kind", kind) != kind:
        hint = "without a base it has values of its own"
        raise refuse(f"{place}.kind", own["kind"], f"{kind}, as its base {base}", hint)
    return on_top(content, own)


def _whole(medium: Any, key: str, folder: Path) -> Any:
    """Return a medium, or a stack and all of its layers, on top of the bases they name."""
    medium = _with_base(medium, key, folder)
    return with_bases(key, medium, lambda layer, here: _with_base(layer, here, folder))


def load_experiments(
    folder: str | Path,
    media_folder: str | Path = "config/media",
    measured_folder: str | Path | None = None,
) -> dict[str, Experiment]:
    """Read and check all experiment files below a folder, by name; see `load_experiment`.

    Raises
    ------
    ConfigError
        With one line for each file that cannot be run or has the name of another, or if there
        is no file.
    """
    experiments: dict[str, Experiment] = {}
    files: dict[str, Path] = {}
    refused: list[str] = []
    for path in sorted(expand_path(folder, "folder").rglob("*.y*ml")):
        try:
            experiment = load_experiment(path, media_folder, measured_folder)
            _check_tables(path, experiment)
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


def _check_tables(path: Path, experiment: Experiment) -> None:
    """Refuse users' own tables that the workflow could not take for its inputs."""
    try:
        for table in experiment.list_table_paths():
            check_path("table", table)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def load_settings(content: dict[str, Any], origin: str = "config/config.yaml") -> Settings:
    """Check the main configuration, given as a mapping."""
    try:
        return _checked(Settings, content)
    except ValueError as error:
        raise ConfigError(f"{origin}: {_line(str(error))}") from None


def _checked(model: type[Model], content: dict[str, Any]) -> Model:
    """Return a model of the content, or refuse it in one line."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ValueError(line_of(model, error)) from None
