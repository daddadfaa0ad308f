"""Loading and checking of configuration files, with one-line error messages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from splits.analysis.measured import WAVELENGTH_COLUMN, read_spectra
from splits.core.paths import expand_path
from splits.core.validation import check_choice, invalid
from splits.core.yaml import ConfigError, locate_message, read_yaml
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.medium import apply_bases
from splits.experiments.config.messages import validate_content
from splits.experiments.config.retrieve_checks import check_measured_spectra
from splits.experiments.config.sections import check_path
from splits.experiments.config.settings import Settings
from splits.experiments.config.simulation import SAMPLE_KEY
from splits.experiments.config.unused_settings import check_replaced_settings, check_unused_keywords
from splits.experiments.run_fit import check_fit
from splits.media.kinds import LAYERS_KEY
from splits.media.measured_inputs import override_keywords
from splits.media.named_media import NAMED_MEDIA, read_named_medium
from splits.retrieval.measurement import MAX_REFLECTANCE

MAX_MESSAGE_CHARS = 450
"""Largest number of characters of a message, without the name of its file."""


def load_experiment(
    path: str | Path,
    media_folder: str | Path = "config/media",
    measured_folder: str | Path | None = None,
) -> ExperimentConfig:
    """Read and check one experiment file.  Its name defaults to that of the file.

    Parameters
    ----------
    path : path
    media_folder : path
        Folder of own media, the files ``NAME.yaml`` to which ``medium: {base: NAME}`` may refer in
        addition to the names of `splits.list_media`.  It need not exist.
    measured_folder : path, optional
        Folder of measured tables; by default ``measured`` beside that of media.

    Raises
    ------
    ConfigError
        One line that names the file, the key, the value and the allowed values.
    """
    file = Path(path)
    try:
        file, media = expand_path(path), expand_path(media_folder, "media_folder")
        measured = expand_path(measured_folder or media.parent / "measured", "measured_folder")
        return _parse_experiment(file, media, measured)
    except ConfigError:
        raise
    except (TypeError, ValueError) as error:
        raise ConfigError(locate_message(file, _to_single_line(str(error)))) from None


def _to_single_line(text: str) -> str:
    """Return a message as one printable line of bounded length."""
    printable = "".join(c if c.isprintable() else " " for c in text)
    return (
        printable
        if len(printable) <= MAX_MESSAGE_CHARS
        else f"{printable[: MAX_MESSAGE_CHARS - 2]} …"
    )


def _parse_experiment(path: Path, media: Path, measured: Path) -> ExperimentConfig:
    """Return the experiment of a file; errors need not name the file."""
    given = read_yaml(path)
    content = {"name": path.stem, **given}
    check_replaced_settings(given)
    medium, grid = content.get("medium", {}), content.get("grid")
    if not isinstance(medium, dict):
        raise invalid("medium", medium, "a mapping of keys to values")
    if medium:
        content["medium"] = _apply_all_bases(medium, "medium", media)
    if isinstance(grid, dict) and isinstance(grid.get(SAMPLE_KEY), (list, dict)):
        grid = content["grid"] = grid | {SAMPLE_KEY: _resolve_samples(grid[SAMPLE_KEY], media)}
    if isinstance(grid, dict) and isinstance(grid.get(LAYERS_KEY), dict):
        stacks = {
            label: _apply_all_bases({LAYERS_KEY: layers}, f"grid.{LAYERS_KEY}.{label}", media)[
                LAYERS_KEY
            ]
            for label, layers in grid[LAYERS_KEY].items()
        }
        content["grid"] = grid | {LAYERS_KEY: stacks}
    experiment = validate_content(ExperimentConfig, content)
    check_unused_keywords(experiment, given)
    if experiment.figure.measured:
        _check_figure_table(
            experiment, _read_measured("figure.measured", measured, experiment.figure.measured)
        )
    if experiment.retrieve:
        section = experiment.retrieve
        table = _read_measured("retrieve.measured", measured, section.measured)
        check_measured_spectra(experiment, section, table)
    if experiment.fit:
        if experiment.figure.kind not in ("fit", "none"):
            raise invalid("figure.kind", experiment.figure.kind, "'fit' beside a section fit")
        check_fit(experiment, _read_measured("fit.measured", measured, experiment.fit.measured))
    return experiment


def _read_measured(key: str, folder: Path, name: str) -> pd.DataFrame:
    """Return a measured table; reject an unknown name or an invalid file."""
    if not (folder / name).is_file():
        available = [p.name for p in folder.glob("*.csv")]
        if not available:
            raise invalid(key, name, f"a CSV file in {folder}", "there is none")
        check_choice(key, name, available)
    return read_spectra(folder / name, key)


def _check_figure_table(experiment: ExperimentConfig, measured: pd.DataFrame) -> None:
    """Reject a measured table without the quantity of the figure, or with values in per cent."""
    key, quantity = "figure.measured", experiment.figure.quantity
    shown = [name for name in quantity if name in measured and measured[name].count()]
    if not shown:
        columns = f"{WAVELENGTH_COLUMN} and {' or '.join(quantity)}"
        raise invalid(key, experiment.figure.measured, f"a table with columns {columns}")
    for name in shown:
        bounds = [f"{name}_min", f"{name}_max"]
        if len(set(bounds) & set(measured)) == 1:
            raise invalid(key, experiment.figure.measured, f"with both {' and '.join(bounds)}")
        rows = measured[
            [bound for bound in (bounds[0], name, bounds[1]) if bound in measured]
        ].to_numpy()
        largest = np.nanmax(np.abs(rows), initial=0.0)
        if largest > MAX_REFLECTANCE:
            hint = "fractions, not per cent"
            raise invalid(f"{key} ({name})", float(largest), f"at most {MAX_REFLECTANCE:g}", hint)
        if (np.diff(rows, axis=1) < 0.0).any():
            raise invalid(
                key, experiment.figure.measured, f"with {bounds[0]} <= {name} <= {bounds[1]}"
            )


def _resolve_samples(samples: Any, folder: Path) -> dict[str, Any]:
    """Return the media of a grid by label; names are replaced by the settings of these media."""
    if isinstance(samples, list) and not all(isinstance(name, str) for name in samples):
        allowed = "names of media, or a mapping from labels to media"
        raise invalid(f"grid.{SAMPLE_KEY}", samples, allowed)
    named = {name: name for name in samples} if isinstance(samples, list) else samples
    return {
        label: _apply_all_bases(
            {"base": value} if isinstance(value, str) else value,
            f"grid.{SAMPLE_KEY}.{label}",
            folder,
        )
        for label, value in named.items()
    }


def _apply_base(medium: Any, key: str, folder: Path) -> Any:
    """Return the settings of a medium, with those of its ``base`` as defaults."""
    if not isinstance(medium, dict) or "base" not in medium:
        return medium
    base = medium["base"]
    settings = {name: value for name, value in medium.items() if name != "base"}
    content = _read_base(base, f"{key}.base", folder)
    kind = content.get("kind", "snow")
    if settings.get("kind", kind) != kind:
        hint = "or leave out base"
        raise invalid(f"{key}.kind", settings["kind"], f"{kind}, as its base {base}", hint)
    return override_keywords(content, settings)


def _read_base(base: Any, key: str, folder: Path) -> dict[str, Any]:
    """Return the settings of a named medium, or of a file of the folder of media."""
    own_files = {path.stem: path for path in folder.glob("*.y*ml")}
    check_choice(key, base, {*own_files, *NAMED_MEDIA})
    if base not in own_files:
        return read_named_medium(base)
    if base in NAMED_MEDIA:
        hint = f"the package has a medium of this name: rename {own_files[base]}"
        raise invalid(key, base, "the name of one medium only", hint)
    return read_yaml(own_files[base])


def _apply_all_bases(medium: Any, key: str, folder: Path) -> Any:
    """Return the settings of a medium, or of a stack and its layers, with their bases applied."""
    medium = _apply_base(medium, key, folder)
    return apply_bases(key, medium, lambda layer, layer_key: _apply_base(layer, layer_key, folder))


def load_experiments(
    folder: str | Path,
    media_folder: str | Path = "config/media",
    measured_folder: str | Path | None = None,
) -> dict[str, ExperimentConfig]:
    """Read and check all experiment files below a folder, by name; see `load_experiment`.

    Raises
    ------
    ConfigError
        With one line for each invalid file and for each repeated name, or if there is no file.
    """
    experiments: dict[str, ExperimentConfig] = {}
    files: dict[str, Path] = {}
    errors: list[str] = []
    for path in sorted(expand_path(folder, "folder").rglob("*.y*ml")):
        try:
            experiment = load_experiment(path, media_folder, measured_folder)
            _check_table_paths(path, experiment)
        except ConfigError as error:
            errors.append(str(error))
            continue
        name = experiment.name
        if name in experiments:
            errors.append(locate_message(path, f"name = {name!r}: already taken by {files[name]}"))
        experiments[name], files[name] = experiment, path
    if errors:
        raise ConfigError("\n".join(errors))
    if not experiments:
        raise ConfigError(f"{folder}: no experiment file (*.yaml)")
    return experiments


def _check_table_paths(path: Path, experiment: ExperimentConfig) -> None:
    """Reject paths of users' own tables that the workflow cannot use as inputs."""
    try:
        for table in experiment.list_table_paths():
            check_path("table", table)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def load_settings(content: dict[str, Any], origin: str = "config/config.yaml") -> Settings:
    """Return the settings of the main configuration, given as a mapping.

    Errors name the line of `origin`, unless the value comes from the command line.
    """
    try:
        return validate_content(Settings, content)
    except ValueError as error:
        message, path = _to_single_line(str(error)), Path(origin)
        key = re.split(r"\W", message, maxsplit=1)[0]
        given = read_yaml(path).get(key) if path.is_file() else None
        is_in_file = repr(given) == repr(content.get(key))
        message = locate_message(path, message) if is_in_file else f"{path}: {message}"
        raise ConfigError(message) from None
