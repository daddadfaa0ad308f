"""The command `splits`: one experiment without a workflow, versions, kept kernels, archives."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from splits.core.optional import import_optional
from splits.core.paths import expand_path
from splits.core.progress import write_line

if TYPE_CHECKING:
    from splits.experiments.config.experiment import ExperimentConfig

ACCURACY_PRESETS = {"tiny": (0.05, 0.3), "draft": (0.01, 0.05), "standard": (0.002, 0.02),
              "fine": (0.001, 0.01)}  # fmt: skip
"""Largest standard error of hemispherical values, and largest relative one of values by direction,
as in config/config.yaml."""
REPORTED_PACKAGES = (
    "numpy", "numba", "llvmlite", "xarray", "netCDF4", "pydantic", "scipy", "matplotlib",
    "snakemake",
)  # fmt: skip
"""Packages whose versions `splits versions` prints."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str, optional
        What stands behind `splits`; by default what the shell gave.

    Returns
    -------
    int
        Exit status: 0, or 1 after one line that says what is wrong.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    given = _make_parser().parse_args(words, argparse.Namespace(words=words))
    _open_standard_files()
    try:
        for name, value in vars(given).items():
            if isinstance(value, Path):
                setattr(given, name, expand_path(value, name))
        given.action(given)
    except OSError as error:
        named = error.filename is not None and error.strerror
        _log(f"splits: {error.filename}: {error.strerror}" if named else f"splits: {error}")
    except MemoryError as error:
        _log(f"splits: not enough memory ({error or 'no more is to be had'})")
    except (ValueError, TypeError, ModuleNotFoundError) as error:
        _log(f"splits: {error}")
    else:
        return 0
    return 1


def _open_standard_files() -> None:
    """Let standard files that are closed lead nowhere, or what is opened next would be these."""
    while (file := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(file)


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="splits", description="Light that snow, sand and rough layers send back."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run one experiment file and draw its figure")
    run.add_argument("file", type=Path, help="an experiment, YAML")
    run.add_argument("--output", type=Path, default=Path(), metavar="FOLDER",
                     help="where the dataset and the figure go (default: here)")  # fmt: skip
    run.add_argument("--accuracy", choices=ACCURACY_PRESETS, default="standard",
                     help="how exact (default: standard)")  # fmt: skip
    run.add_argument("--seed", type=int, help="of the random numbers (default: 1)")
    run.add_argument("--threads", type=int, help="default: all processors")
    run.add_argument("--media", type=Path, default=Path("config/media"), metavar="FOLDER",
                     help="where `base: NAME` finds NAME.yaml (default: config/media)")  # fmt: skip
    run.set_defaults(action=_run_experiment)

    versions = commands.add_parser("versions", help="print versions of this and what it uses")
    versions.set_defaults(action=_print_versions)

    cache = commands.add_parser("cache", help="say where compiled kernels are kept")
    cache.add_argument("--clear", action="store_true", help="delete them")
    cache.set_defaults(action=_manage_cache)

    unpack = commands.add_parser(
        "unpack", help="verify an archive of results, byte by byte, and unpack it"
    )
    unpack.add_argument("archive", type=Path, help="a zip file that `snakemake archive` made")
    unpack.add_argument("folder", type=Path, nargs="?",
                        help="where to; new or empty (default: only verify)")  # fmt: skip
    unpack.set_defaults(action=_unpack_archive)
    return parser


def _run_experiment(arguments: argparse.Namespace) -> None:
    """Run an experiment; its dataset, figure and tables appear whole or not at all."""
    import_optional("pydantic", "experiments", "experiment files need")
    import_optional("yaml", "experiments", "experiment files need")
    from splits.analysis.measured import read_spectra
    from splits.core.atomic import check_writable
    from splits.core.interrupts import exit_on_signals
    from splits.core.validation import invalid
    from splits.experiments.config.load import load_experiment
    from splits.experiments.config.settings import Accuracy
    from splits.experiments.config.simulation import SimulationConfig
    from splits.experiments.run import write_run
    from splits.experiments.run_fit import run_fit
    from splits.io.netcdf import load, save
    from splits.simulation.arguments import check_integer, check_threads

    seed = 1 if arguments.seed is None else check_integer("--seed", arguments.seed, 0)
    threads = check_threads(arguments.threads)
    experiment = load_experiment(arguments.file, arguments.media)
    own = experiment.instrument.seed
    if arguments.seed is not None and own is not None:
        raise invalid("--seed", arguments.seed, "left out", f"the file has instrument.seed = {own}")
    drawn = experiment.figure.kind != "none"
    if drawn or experiment.retrieve:
        import_optional("matplotlib", "figures", "figures need")
        import_optional("seaborn", "figures", "figures need")
    measured = arguments.media.parent / "measured"
    shown = experiment.figure.measured
    beside = [read_spectra(measured / shown, "figure.measured")] if shown else []
    target = arguments.output / f"{experiment.name}.nc"
    check_writable(target)
    max_stderr, relative_stderr = ACCURACY_PRESETS[arguments.accuracy]
    accuracy = Accuracy(max_stderr=max_stderr, relative_stderr=relative_stderr)
    again = shlex.join(["splits", *map(str, arguments.words)])
    exit_on_signals("splits run", f"to go on where it stopped, type: {again}")
    simulation = SimulationConfig.model_validate(experiment.dump_simulation())
    if experiment.fit:
        table = read_spectra(measured / experiment.fit.measured, "fit.measured")
        save(run_fit(simulation, accuracy, table, seed, threads, _log), target)
    else:
        kept = arguments.output / "blocks" / experiment.name
        write_run(simulation, accuracy, seed, kept, target, threads, _log)
    _print_line(target)
    if experiment.retrieve:
        _run_retrieval(experiment, target, measured, seed)
        return
    if experiment.fit:
        from splits.experiments.papers.paper_tables import write_table
        from splits.experiments.papers.sand_trends import make_fit_table

        parameters = arguments.output / f"{experiment.name}_parameters.csv"
        write_table(make_fit_table(load(target)), parameters)
        _print_line(parameters)
    if drawn:
        from splits.plotting import draw, save_figure

        save_figure(
            draw(load(target), experiment.resolve_figure(), *beside), target.with_suffix("")
        )
        _print_line(target.with_suffix(".png"))


def _run_retrieval(experiment: ExperimentConfig, path: Path, folder: Path, seed: int) -> None:
    """Read measured spectra of a folder in a table, and write what they tell beside it."""
    section = experiment.retrieve
    if section is None:
        return
    from splits.analysis.measured import read_spectra
    from splits.experiments.papers.paper_tables import write_table
    from splits.experiments.run_retrieve import (
        combine_samples,
        make_retrieval_table,
        run_retrieve,
    )
    from splits.plotting.retrieval import draw_retrievals
    from splits.plotting.style import save_figure
    from splits.tables.table import open_table

    measured = read_spectra(folder / section.measured, "retrieve.measured")
    found = run_retrieve(section, open_table(path), measured, seed, _log)
    table = path.with_name(f"{experiment.name}_retrieved.csv")
    write_table(make_retrieval_table(found, section.reference_values), table)
    _print_line(table)
    joined = combine_samples(found, experiment.name)
    save_figure(
        draw_retrievals(joined, section.reference_values, section.list_sample_prefixes()),
        path.with_suffix(""),
    )
    _print_line(path.with_suffix(".png"))


def _log(line: str) -> None:
    """Say how far a run is, or why it ends."""
    write_line(line, sys.stderr)


def _print_line(line: object) -> None:
    """Say what was made."""
    write_line(str(line), sys.stdout)


def _print_versions(arguments: argparse.Namespace) -> None:
    """Print what a report of a problem should hold."""
    import platform
    from importlib.metadata import PackageNotFoundError, version

    from splits.core.optional import DISTRIBUTION_NAME
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
    """Say what is kept where, or delete it."""
    from splits.kernels.compiler.cache_folders import list_cache_folders

    for folder in list_cache_folders():
        kept = sorted(folder.path.glob("*.nbc"))
        size = sum(path.stat().st_size for path in kept) / 1e6
        _print_line(f"{folder.path}: {len(kept)} compiled kernels, {size:.1f} MB")
        if arguments.clear:
            for path in kept:
                folder.remove(path.name)
            _print_line(f"deleted {len(kept)}")


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
