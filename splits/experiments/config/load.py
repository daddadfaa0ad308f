"""Loading and checking of configuration files, with one-line error messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from splits.core.declarations import MAPPING, describe_error
from splits.core.validation import ConfigError, InvalidValue, check_choice, expand_path, invalid
from splits.core.yaml import find_key, locate_message, read_yaml
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.media import SAMPLE_KEY, is_merged
from splits.experiments.config.sections import check_path
from splits.experiments.config.settings import Settings
from splits.experiments.config.simulation import SimulationConfig
from splits.media.kinds import (
    LAYERS_KEY,
    MEDIUM_CLASSES,
    NAMED_MEDIA,
    get_kind,
    iter_layers,
    read_named_medium,
)
from splits.media.parameters import ALTERNATIVES, override_keywords

SectionType = TypeVar("SectionType", bound=BaseModel)
MAX_MESSAGE_CHARS = 450
"""Largest number of characters of a message, without the name of its file."""
MAIN_FILE = "config/config.yaml"


def validate_content(model: type[SectionType], content: Any) -> SectionType:
    """Return the model of some content; raise a one-line error for invalid content."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        described = describe_error(error, content=content)
    if isinstance(described, InvalidValue) and (described.allowed, described.hint) == (MAPPING, ""):
        described.hint = suggest_mapping(described.key, described.value)
    raise described


def suggest_mapping(key: str, value: Any) -> str:
    """Return a hint for a text in place of a section, or ""."""
    if key == "medium" and value in NAMED_MEDIA:
        return f"write {key}: {{base: {value}}}"
    is_kind = key == "medium" and value in MEDIUM_CLASSES
    return f"write {key}: {{kind: {value}, …}}" if is_kind else ""


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
    with locate_errors(Path(path)):
        file, media = expand_path(path), expand_path(media_folder, "media_folder")
        measured = expand_path(measured_folder or media.parent / "measured", "measured_folder")
        given = read_yaml(file)
        content = {"name": file.stem, **given}
        _check_replaced(given)
        medium, grid = content.get("medium", {}), content.get("grid")
        if not isinstance(medium, dict):
            raise invalid("medium", medium, MAPPING, suggest_mapping("medium", medium))
        if medium:
            content["medium"] = _apply_bases(medium, "medium", media)
        if isinstance(grid, dict):
            content["grid"] = _apply_grid_bases(grid, media)
        experiment = validate_content(ExperimentConfig, content)
        for section, name in experiment.list_measured_names().items():
            if name and not (measured / name).is_file():
                available = [path.name for path in measured.glob("*.csv")]
                check_choice(
                    f"{section}.measured", name, available or [f"a CSV file in {measured}"]
                )
        return experiment


@contextmanager
def locate_errors(path: Path) -> Iterator[None]:
    """Add the file, and the line of the key, to the errors of what an experiment file describes."""
    try:
        yield
    except ConfigError:
        raise
    except (TypeError, ValueError) as error:
        raise ConfigError(locate_message(path, _to_single_line(str(error)))) from None


@contextmanager
def locate_job_errors(settings: Mapping[str, Any], name: str) -> Iterator[None]:
    """Add the file of an experiment, and the line of the key, to the errors of its job.

    The file is not a parameter of the job, which would run again if it moved.

    Parameters
    ----------
    settings : mapping
        The main configuration.
    name : str
        Name of the experiment.
    """
    try:
        yield
    except InvalidValue as error:
        folder = load_settings(dict(settings)).experiments_folder
        files = [
            path for path in _list_yaml_files(folder)
            if read_yaml(path).get("name", path.stem) == name
        ]  # fmt: skip
        with locate_errors(files[0] if files else Path(name)):
            raise error from None


def _list_yaml_files(folder: str | Path) -> list[Path]:
    """Return the YAML files below a folder, which need not exist."""
    return sorted(expand_path(folder, "folder").rglob("*.y*ml"))


def _to_single_line(text: str) -> str:
    """Return a message as one printable line of bounded length."""
    line = "".join(c if c.isprintable() else " " for c in text)
    return line if len(line) <= MAX_MESSAGE_CHARS else f"{line[: MAX_MESSAGE_CHARS - 2]} …"


def _check_replaced(content: Mapping[str, Any]) -> None:
    """Reject values of the medium and the instrument that the grid replaces at every point.

    Those of a base serve other experiments as well.
    """
    grid = content.get("grid")
    grid = grid if isinstance(grid, Mapping) else {}
    samples = grid.get(SAMPLE_KEY)
    sections = {key: content.get(key) for key in ("medium", "instrument")}
    for label, settings in samples.items() if isinstance(samples, Mapping) else ():
        sections[f"grid.{SAMPLE_KEY}.{label}"] = settings
    replacements = {ALTERNATIVES.get(key, key): key for key in grid}
    for section, settings in sections.items():
        for key, value in settings.items() if isinstance(settings, Mapping) else ():
            parameter = replacements.get(ALTERNATIVES.get(key, key))
            # Layers are given completely while a grid varies some settings; mappings are merged.
            if parameter and not (is_merged(key) or key in (LAYERS_KEY, SAMPLE_KEY)):
                hint = f"grid.{parameter} has its values"
                raise invalid(f"{section}.{key}", value, "left out", hint)


def _apply_grid_bases(grid: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a grid whose media and layers have the settings of their bases."""
    samples, stacks = grid.get(SAMPLE_KEY), grid.get(LAYERS_KEY)
    if isinstance(samples, list):
        if not all(isinstance(name, str) for name in samples):
            allowed = "names of media, or a mapping from labels to media"
            raise invalid(f"grid.{SAMPLE_KEY}", samples, allowed)
        samples = dict(zip(samples, samples, strict=True))
    replaced: dict[str, Any] = {}
    for label, sample in samples.items() if isinstance(samples, dict) else ():
        medium = {"base": sample} if isinstance(sample, str) else sample
        key = f"grid.{SAMPLE_KEY}.{label}"
        replaced.setdefault(SAMPLE_KEY, {})[label] = _apply_bases(medium, key, folder)
    for label, layers in stacks.items() if isinstance(stacks, dict) else ():
        stack = _apply_bases({LAYERS_KEY: layers}, f"grid.{LAYERS_KEY}.{label}", folder)
        replaced.setdefault(LAYERS_KEY, {})[label] = stack[LAYERS_KEY]
    return grid | replaced


def _apply_bases(medium: Any, key: str, folder: Path) -> Any:
    """Return the settings of a medium and of its layers, with those of ``base`` as defaults."""
    if not isinstance(medium, dict):
        return medium
    if "base" in medium:
        settings = {name: value for name, value in medium.items() if name != "base"}
        content = _read_base(medium["base"], f"{key}.base", folder)
        kind = get_kind(content)
        if settings.get("kind", kind) != kind:
            allowed = f"{kind}, as its base {medium['base']}"
            raise invalid(f"{key}.kind", settings["kind"], allowed, "or leave out base")
        medium = override_keywords(content, settings)
    if LAYERS_KEY not in medium:
        return medium
    layers = iter_layers(f"{key}.{LAYERS_KEY}", medium[LAYERS_KEY])
    return {**medium, LAYERS_KEY: [_apply_bases(one, name, folder) for name, one in layers]}


def _read_base(base: Any, key: str, folder: Path) -> dict[str, Any]:
    """Return the settings of a named medium, or of a file of the folder of media.

    An invalid file is rejected; errors name this file.
    """
    own_files: dict[str, Path] = {}
    for path in list_media_files(folder):
        if path.stem in own_files and path.stem == base:
            raise invalid(key, base, "the name of one file", f"{own_files[base]} and {path}")
        own_files[path.stem] = path
    check_choice(key, base, {*own_files, *NAMED_MEDIA})
    if base not in own_files:
        return read_named_medium(base)
    if base in NAMED_MEDIA:
        hint = f"the package has a medium of this name: rename {own_files[base]}"
        raise invalid(key, base, "the name of one medium only", hint)
    content = medium = read_yaml(own_files[base])
    try:
        if LAYERS_KEY in medium:
            medium = _apply_bases(medium, "medium", folder)
        # The wavelengths of its tables are unknown.
        own = {"name": "own", "medium": medium, "instrument": {"wavelength_nm": [550]}}
        validate_content(SimulationConfig, own)
    except ConfigError:
        raise
    except (TypeError, ValueError) as error:
        message = _to_single_line(str(error)).removeprefix("medium.")
        if not message.startswith("instrument."):
            raise ConfigError(locate_message(own_files[base], message)) from None
    return content


def list_media_files(folder: Path) -> list[Path]:
    """Return the files of own media in a folder, which need not exist."""
    return sorted(folder.glob("*.y*ml"))


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
    media = expand_path(media_folder, "media_folder")
    for path in list_media_files(media):
        try:
            _read_base(path.stem, f"{path}: base", media)
        except ValueError as error:
            errors.append(str(error))
    for path in _list_yaml_files(folder):
        try:
            experiment = load_experiment(path, media_folder, measured_folder)
            for table in experiment.list_table_paths():
                check_path("table", table)
        except ValueError as error:
            errors.append(str(error) if isinstance(error, ConfigError) else f"{path}: {error}")
            continue
        name = experiment.name
        if name in experiments:
            errors.append(locate_message(path, f"name = {name!r}: already taken by {files[name]}"))
        experiments[name], files[name] = experiment, path
    if errors:
        raise ConfigError("\n".join(dict.fromkeys(errors)))
    if not experiments:
        raise ConfigError(f"{folder}: no experiment file (*.yaml)")
    return experiments


def load_settings(content: dict[str, Any], *files: str) -> Settings:
    """Return the settings of the main configuration, given as a mapping.

    `files` are those of which it consists, by default ``config/config.yaml``.  Errors name the file
    and the line, unless the value comes from the command line.
    """
    try:
        return validate_content(Settings, content)
    except ValueError as error:
        raise ConfigError(_locate_setting(str(error), content, files)) from None


def select_experiments(
    settings: Settings, available: Mapping[str, ExperimentConfig], content: Any, *files: str
) -> dict[str, ExperimentConfig]:
    """Return the selected experiments; see `Settings.select_experiments` and `load_settings`."""
    try:
        return settings.select_experiments(available)
    except ConfigError as error:
        raise ConfigError(_locate_setting(str(error), content, files)) from None


def _locate_setting(message: str, content: Any, files: Sequence[str]) -> str:
    """Return the message on a key of the main configuration, with its file and line."""
    message, paths = _to_single_line(message), [Path(file) for file in files or [MAIN_FILE]]
    located = []
    for path in reversed(paths):
        keys, _ = find_key(path, message)
        given, used = read_yaml(path) if keys else {}, content
        with suppress(LookupError, TypeError):
            for key in keys:
                given, used = given[key], used[key]
        if keys and repr(given) == repr(used):
            located.append((len(keys), path))
    if located:
        return locate_message(max(located, key=lambda one: one[0])[1], message)
    return f"{paths[0]}: {message}"
