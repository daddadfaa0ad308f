"""Command line of the programs of benchmarks/: each function computes the rows of one table."""

import argparse
from collections.abc import Callable, Iterable, Mapping
from inspect import getdoc, signature
from typing import Any

import pandas as pd

from splits.core.escaping import write_data_frame
from splits.core.validation import expand_path

Benchmark = Callable[..., Iterable[Mapping[str, Any]]]


def run_command(*benchmarks: Benchmark) -> None:
    """Print the table of the benchmark that the command line names, and write it to ``--table``.

    The keywords of a function with a default are its options: a flag for False, and several values
    for a tuple.
    """
    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers(required=True, metavar="benchmark")
    for benchmark in benchmarks:
        text = getdoc(benchmark) or ""
        command = commands.add_parser(
            benchmark.__name__, help=text.partition("\n")[0], description=text,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        command.set_defaults(benchmark=benchmark)
        command.add_argument("--table", type=expand_path, help="CSV file to write")
        for name, parameter in signature(benchmark).parameters.items():
            option, default = f"--{name.replace('_', '-')}", parameter.default
            if isinstance(default, bool):
                command.add_argument(option, action="store_true")
            elif isinstance(default, tuple):
                command.add_argument(option, nargs="+", type=type(default[0]), default=default)
            else:
                command.add_argument(option, type=type(default), default=default)
    options = vars(parser.parse_args())
    benchmark, path = options.pop("benchmark"), options.pop("table")
    table = pd.DataFrame(list(benchmark(**options)))
    print(table.to_string(index=False, float_format="{:.4g}".format))
    if path:
        write_data_frame(table, path)
