"""Generated experiment files are rejected in one line, or run and give valid results.

Short by default.  The campaign proper is ``make campaign``, or

    CAMPAIGN=10000,300 python -m pytest -s tests/campaigns

with the numbers of files read and of experiments run; a third number is the seed (default 1).  The
files also depend on constants that Hypothesis samples from the sources that it finds.  So files are
generated until enough of them were read and accepted.
"""

import os
import signal
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import generated
import matplotlib
import numpy as np
import odd
import pytest
from chi2 import NEEDS_JIT
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from shipped import CONFIG

from splits.core.validation import ConfigError, InvalidValue
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.load import load_experiment
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.plotting import draw

CAMPAIGN = os.environ.get("CAMPAIGN", "300,10")
N_FILES, N_RUNS, SEED = (*map(int, CAMPAIGN.split(",")), 1)[:3]
MAX_BATCHES = 50
"""Upper bound that is not reached: a tenth to a half of the files of a batch are accepted."""
MAX_LINE_CHARS = 500
TIME_LIMIT_S = 20.0
"""Limit of CPU time for reading one file."""
TINY_ACCURACY = Accuracy(max_stderr=0.3, relative_stderr=0.5, max_rays=2000)
MEDIA = CONFIG / "media"


class TimeLimitExceeded(BaseException):
    """Reading a file takes too long; no `Exception`, so that no handler catches it."""


@contextmanager
def time_limit(seconds: float):
    def stop(*_):
        raise TimeLimitExceeded

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def judge_each(
    strategy: st.SearchStrategy, count: int, min_accepted: int, judge: Callable[[str], str]
) -> list[tuple]:
    """Return (verdict, text) of all generated texts, including those after a failure.

    At least `count` texts are judged, and more until `min_accepted` of them are accepted, up to
    `MAX_BATCHES` times `count`.
    """
    verdicts: list[tuple] = []

    def is_enough() -> bool:
        n_accepted = sum(verdict != "rejected" for verdict, _ in verdicts)
        return len(verdicts) >= count and n_accepted >= min_accepted

    for batch in range(MAX_BATCHES):

        @seed(SEED + batch)
        @settings(
            max_examples=count,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(strategy)
        def collect(text: str) -> None:
            if not is_enough():
                verdicts.append((judge(text), text))

        collect()
        if is_enough():
            return verdicts
    message = f"{min_accepted} accepted of {count} or more, up to {len(verdicts)}"
    raise AssertionError(f"{message}: generated files are hardly accepted any more")


def report_verdicts(verdicts: list[tuple], accepted_verdicts: tuple[str, ...]) -> str:
    """Print the number of each verdict; return those not accepted with their shortest texts."""
    shortest: dict[str, str] = {}
    counts: dict[str, int] = {}
    for verdict, text in sorted(verdicts, key=lambda pair: len(pair[1])):
        counts[verdict] = counts.get(verdict, 0) + 1
        shortest.setdefault(verdict, text)
    summary = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    print(f"{len(verdicts)} generated: {summary}")
    bad = [verdict for verdict in counts if verdict not in accepted_verdicts]
    return "\n".join(f"{counts[v]} × {v}: {shortest[v][:1000]!r}" for v in bad)


def write_text(text: str, folder: Path) -> Path:
    path = folder / "generated.yaml"
    # A lone surrogate gives bytes that are not valid UTF-8.
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


def locate_error(error: BaseException) -> str:
    """Return the type of an error and the line of the package that raised it."""
    trace, inner = error.__traceback__, ""
    while trace:
        code = trace.tb_frame.f_code
        if "splits" in code.co_filename:
            inner = f"{Path(code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return f"{type(error).__name__} at {inner}"


def make_reading_judge(folder: Path) -> Callable[[str], str]:
    """Return a function that reads a text as an experiment file and returns a verdict."""

    def judge(text: str) -> str:
        path = write_text(text, folder)
        try:
            with time_limit(TIME_LIMIT_S):
                load_experiment(path, MEDIA)
        except ConfigError as error:
            line = str(error).replace(str(folder), "")
            if len(line.splitlines()) != 1 or not line.isprintable():
                return "not one line"
            return "rejected" if len(line) < MAX_LINE_CHARS else "a long line"
        except (Exception, TimeLimitExceeded) as error:
            return locate_error(error)
        return "accepted"

    return judge


def test_every_file_is_accepted_or_rejected_in_one_line(tmp_path):
    start = time.perf_counter()
    verdicts = judge_each(odd.file_texts(), N_FILES, N_FILES // 20, make_reading_judge(tmp_path))
    bad = report_verdicts(verdicts, ("accepted", "rejected"))
    print(f"{time.perf_counter() - start:.0f} s")
    assert not bad, bad


@pytest.mark.parametrize("files_per_accepted", [1, 20])
def test_files_are_generated_until_enough_are_accepted(files_per_accepted):
    """The number of accepted files does not depend on the fraction that is accepted."""

    def judge(number: int) -> str:
        return "accepted" if number % files_per_accepted == 0 else "rejected"

    verdicts = judge_each(st.integers(0, 10**6), 10, 10, judge)
    assert sum(verdict == "accepted" for verdict, _ in verdicts) == 10


def test_files_that_are_never_accepted_raise_an_error():
    with pytest.raises(AssertionError, match=r"1 accepted of 10 or more, up to [45]"):
        judge_each(st.integers(0, 10**6), 10, 1, lambda _: "rejected")


# --- runs -------------------------------------------------------------------------------------


def limit_rays(experiment: ExperimentConfig) -> ExperimentConfig:
    """Return the experiment with few rays, which takes less than 0.1 s per point."""
    instrument = experiment.instrument
    limits = {"rays": 1000, "realizations": 3}
    current = {key: instrument.get(key) for key in limits}
    reduced = {key: min(value, limits[key]) for key, value in current.items() if value is not None}
    if instrument.kind == "beam_spread" or instrument.get("estimator") == "bins":
        reduced["rays"] = min(current["rays"] or 1000, 1000)
    settings = {**instrument.settings, **reduced}
    return experiment.model_copy(update={"instrument": replace(instrument, settings=settings)})


def find_invalid_numbers(dataset) -> str:
    """Return a description of the first invalid variable of a dataset, or an empty string."""
    for name, variable in dataset.data_vars.items():
        values = variable.values
        if values.dtype.kind != "f":
            continue
        if not np.isfinite(values).all():
            return f"{name} not finite"
        if str(name).endswith("_stderr") and values.min(initial=0.0) < 0.0:
            return f"{name} negative"
    return ""


def make_running_judge(folder: Path) -> Callable[[str], str]:
    """Return a function that reads, runs and draws a text, and returns a verdict."""

    def judge(text: str) -> str:
        try:
            experiment = load_experiment(write_text(text, folder), MEDIA)
        except ConfigError:
            return "rejected"
        try:
            dataset = run(limit_rays(experiment), TINY_ACCURACY, threads=1)
            with matplotlib.rc_context({"figure.max_open_warning": 0}):
                figure = draw(dataset, **experiment.resolve_figure())
                figure.canvas.draw()
                figure.clear()
        except InvalidValue as error:
            # Instruments and figures check what they are given.
            return "rejected" if len(str(error).splitlines()) == 1 else "not one line"
        except Exception as error:
            if "missing from font" not in str(error):
                return f"{locate_error(error)}: {error}"
            # Matplotlib warns of letters that are missing in the fonts of the machine.
            return find_invalid_numbers(dataset) or "valid, letter missing in fonts"
        return find_invalid_numbers(dataset) or "valid"

    return judge


@NEEDS_JIT
def test_accepted_experiments_run_with_valid_results(tmp_path):
    matplotlib.use("Agg")
    start = time.perf_counter()
    texts = generated.valid_contents().map(generated.to_file_text)
    verdicts = judge_each(texts, N_RUNS, N_RUNS, make_running_judge(tmp_path))
    accepted_verdicts = ("rejected", "valid", "valid, letter missing in fonts")
    bad = report_verdicts(verdicts, accepted_verdicts)
    print(f"{time.perf_counter() - start:.0f} s")
    assert not bad, bad
