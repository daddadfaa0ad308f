"""Command `splits`: single experiments, versions, kernel cache and archives."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from splits.core.optional import DISTRIBUTION_NAME, import_optional
from splits.core.progress import write_line
from splits.core.validation import check_integer, expand_path, invalid

if TYPE_CHECKING:
    from splits.experiments.config.experiment import ExperimentConfig

ACCURACY_PRESETS = {"tiny": (0.05, 0.3), "draft": (0.01, 0.05), "standard": (0.002, 0.02),
              "fine": (0.001, 0.01)}  # fmt: skip
"""Maximum standard error of hemispherical values and maximum relative error of directional values.

The values are those of config/config.yaml.
"""
REPORTED_PACKAGES = (
    "numpy", "numba", "llvmlite", "xarray", "netCDF4", "pydantic", "scipy", "matplotlib",
    "snakemake",
)  # fmt: skip
"""Packages whose versions are printed by `splits versions`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments after `splits`; by default those of the command line.

    Returns
    -------
    int
        Exit status: 0, or 1 after a one-line error message.
    """
    argv = sys.argv[1:] if arguments is None else list(arguments)
    options = _make_parser().parse_args(argv, argparse.Namespace(words=argv))
    _open_standard_files()
    try:
        for name, value in vars(options).items():
            if isinstance(value, Path):
                setattr(options, name, expand_path(value, name))
        options.action(options)
    except OSError as error:
        has_filename = error.filename is not None and error.strerror
        _log(f"splits: {error.filename}: {error.strerror}" if has_filename else f"splits: {error}")
    except MemoryError as error:
        _log(f"splits: not enough memory ({error or 'allocation failed'})")
    except (ValueError, TypeError, ModuleNotFoundError) as error:
        _log(f"splits: {error}")
    else:
        return 0
    return 1


def _open_standard_files() -> None:
    """Open closed standard streams as the null device, so that no other file takes their place."""
    while (file := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(file)


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="splits",
        description="Monte Carlo reflectance and transmittance of snow, sand and rough layers.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run one experiment file and plot its figure")
    run.add_argument("file", type=Path, help="experiment file (YAML)")
    run.add_argument("--output", type=Path, default=Path(), metavar="FOLDER",
                     help="output folder (default: current folder)")  # fmt: skip
    run.add_argument("--accuracy", choices=ACCURACY_PRESETS, default="standard",
                     help="target accuracy (default: standard)")  # fmt: skip
    run.add_argument("--seed", type=int, help="seed of the random numbers (default: 1)")
    run.add_argument("--threads", type=int, help="number of threads (default: all processors)")
    run.add_argument("--media", type=Path, default=Path("config/media"), metavar="FOLDER",
                     help="folder of your media, `base: NAME` (default: config/media)")  # fmt: skip
    run.set_defaults(action=_run_experiment)

    versions = commands.add_parser(
        "versions", help="print the versions of this package and its dependencies"
    )
    versions.set_defaults(action=_print_versions)

    cache = commands.add_parser("cache", help="show the cache folders of compiled kernels")
    cache.add_argument("--clear", action="store_true", help="delete the cached kernels")
    cache.set_defaults(action=_manage_cache)

    schema = commands.add_parser(
        "schema", help="write JSON schemas, with which editors check configuration files"
    )
    schema.add_argument("folder", type=Path, nargs="?", default=Path(), metavar="FOLDER",
                        help="output folder (default: current folder)")  # fmt: skip
    schema.set_defaults(action=_write_schemas)

    unpack = commands.add_parser("unpack", help="verify an archive of results and unpack it")
    unpack.add_argument("archive", type=Path, help="zip file made by `snakemake archive`")
    unpack.add_argument("folder", type=Path, nargs="?",
                        help="new or empty target folder (default: verify only)")  # fmt: skip
    unpack.set_defaults(action=_unpack_archive)
    return parser


def _check_targets(
    experiment: ExperimentConfig, arguments: argparse.Namespace, measured: Path
) -> None:
    """Reject results that would replace an input of their experiment."""
    names = filter(None, experiment.list_measured_names().values())
    inputs = [arguments.file, *(measured / name for name in names)]
    targets = [arguments.output / Path(path).name for path in experiment.list_product_paths()]
    experiment.check_targets(targets, inputs, "set name or --output")


def _run_experiment(arguments: argparse.Namespace) -> None:
    """Run an experiment and write its dataset, figure and tables atomically."""
    import_optional("yaml", "experiments", "experiment files need")
    from splits.analysis.measured import read_spectra
    from splits.core.atomic import check_writable
    from splits.core.process import exit_on_signals
    from splits.experiments.config.load import load_experiment, locate_errors
    from splits.experiments.config.sections import Accuracy
    from splits.experiments.config.simulation import SimulationConfig
    from splits.experiments.run import write_run
    from splits.io.netcdf import load

    seed = 1 if arguments.seed is None else check_integer("--seed", arguments.seed, 0)
    threads = arguments.threads
    if threads is not None:
        check_integer("--threads", threads, 1)
    experiment = load_experiment(arguments.file, arguments.media)
    file_seed = experiment.instrument.settings.get("seed")
    if arguments.seed is not None and file_seed is not None:
        raise invalid(
            "--seed", arguments.seed, "left out", f"the file has instrument.seed = {file_seed}"
        )
    has_figure = experiment.has_figure
    if has_figure or experiment.retrieval:
        import_optional("matplotlib", "figures", "figures need")
        import_optional("seaborn", "figures", "figures need")
    measured = arguments.media.parent / "measured"
    figure_measured = experiment.figure.get("measured")
    measured_spectra = None
    if figure_measured:
        measured_spectra = read_spectra(measured / figure_measured, "figure.measured")
    _check_targets(experiment, arguments, measured)
    target = arguments.output / f"{experiment.name}.nc"
    check_writable(target)
    max_stderr, relative_stderr = ACCURACY_PRESETS[arguments.accuracy]
    accuracy = Accuracy(max_stderr=max_stderr, relative_stderr=relative_stderr)
    command = shlex.join(["splits", *map(str, arguments.words)])
    exit_on_signals("splits run", f"to resume, type: {command}")
    simulation = SimulationConfig.model_validate(experiment.dump_simulation())
    with locate_errors(arguments.file):
        block_folder = arguments.output / "blocks" / experiment.name
        write_run(simulation, accuracy, seed, block_folder, target, threads, _log)
        _print_line(target)
        if experiment.retrieval:
            _run_retrieval(experiment, target, measured, seed, threads)
            return
        if has_figure:
            from splits.experiments.config.experiment import draw_figure
            from splits.plotting import save_figure

            settings = experiment.resolve_figure() | {"measured": measured_spectra}
            figure = draw_figure(load(target), settings)
            save_figure(figure, target.with_suffix(""))
            _print_line(target.with_suffix(".png"))


def _run_retrieval(
    experiment: ExperimentConfig, path: Path, folder: Path, seed: int, threads: int
) -> None:
    """Retrieve medium parameters with a table, and write the results."""
    from splits.experiments.run_retrieve import write_retrieval, write_return_retrieval

    section, of_return = experiment.retrieve, experiment.retrieve_return
    outputs = path.with_name(f"{path.stem}_retrieved.csv"), path.with_suffix(".png")
    if section:
        write_retrieval(section, path, folder / section.measured, seed, outputs, _log)
    elif of_return:
        measured = folder / of_return.measured if of_return.measured else None
        files = path, measured
        write_return_retrieval(experiment, of_return, files, seed, outputs, threads, _log)
    for output in outputs:
        _print_line(output)


def _log(line: str) -> None:
    """Print progress or an error message to standard error."""
    write_line(line, sys.stderr)


def _print_line(line: object) -> None:
    """Print a result to standard output."""
    write_line(str(line), sys.stdout)


def _print_versions(arguments: argparse.Namespace) -> None:
    """Print the versions to include in a bug report."""
    import platform
    from importlib.metadata import PackageNotFoundError, version

    from splits.core.provenance import get_git_commit, get_package_version
    from splits.io.netcdf import SCHEMA_VERSION

    _print_line(f"{DISTRIBUTION_NAME} {get_package_version()} (commit {get_git_commit()})")
    _print_line(f"schema of datasets {SCHEMA_VERSION}")
    _print_line(f"python {platform.python_version()} on {platform.platform()}")
    for name in REPORTED_PACKAGES:
        try:
            _print_line(f"{name} {version(name)}")
        except PackageNotFoundError:
            _print_line(f"{name} not installed")


def _manage_cache(arguments: argparse.Namespace) -> None:
    """Print the content of the cache of kernels and of grains, or clear it."""
    from splits.kernels.compiler.cache import find_cache_folder

    folder = find_cache_folder()
    kernels, grains = (
        sorted(folder.glob(pattern)) if folder else [] for pattern in ("*.nbc", "grains_*.nc")
    )
    kept = [*kernels, *grains]
    size = sum(path.stat().st_size for path in kept) / 1e6
    counts = f"{len(kernels)} compiled kernels, {len(grains)} results of paths through grains"
    _print_line(f"{folder}: {counts}, {size:.1f} MB")
    if arguments.clear:
        for path in kept:
            path.unlink(missing_ok=True)
        _print_line(f"deleted {len(kept)}")


def _write_schemas(arguments: argparse.Namespace) -> None:
    """Write the JSON schemas of experiment files and of the main file."""
    from splits.experiments.config.schema import write_schemas

    for path in write_schemas(arguments.folder):
        _print_line(path)


def _unpack_archive(arguments: argparse.Namespace) -> None:
    """Verify an archive and, where a folder is given, unpack it."""
    from splits.io.unarchive import unpack_archive, verify_archive

    _print_line(
        unpack_archive(arguments.archive, arguments.folder)
        if arguments.folder
        else verify_archive(arguments.archive)
    )


if __name__ == "__main__":
    sys.exit(main())
