"""Generated experiment files: each is run or refused in one line, and what is run is sound.

Short by default.  The campaign proper is ``make campaign``, or

    CAMPAIGN=10000,300 python -m pytest -s tests/campaigns

files read and experiments run; a third number is the seed (default 1).  The seed alone does not
settle which files come: Hypothesis also draws constants from the sources that it finds.  So files
are generated until enough of them were read and accepted, however many that takes.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import generated
import matplotlib
import numpy as np
import odd
import pytest
from chi2 import NEEDS_JIT
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from splits.experiments import ConfigError
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.load import load_experiment
from splits.experiments.config.settings import Accuracy
from splits.experiments.run import run
from splits.plotting import draw

CAMPAIGN = os.environ.get("CAMPAIGN", "300,10")
N_FILES, N_RUNS, SEED = (*map(int, CAMPAIGN.split(",")), 1)[:3]
MAX_BATCHES = 50
"""More than luck can ask for: a tenth to a half of the files of a batch are accepted."""
NOT_ACCEPTED = ("refused", "a fit, not run")
MAX_LINE_CHARS = 500
TIME_LIMIT_S = 20.0
"""Of CPU time, for reading one file: what takes so long will not end for longer input."""
TINY_ACCURACY = Accuracy(max_stderr=0.3, relative_stderr=0.5, max_rays=2000)
MEDIA = Path(__file__).parents[2] / "config" / "media"


class TimeLimitExceeded(BaseException):
    """Reading a file takes too long; no `Exception`, so that nothing on the way catches it."""


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
    """Return (verdict, text) of generated texts: all of them, not only up to the first failure.

    At least `count` texts, and more until `accepted` of them are accepted, up to `MAX_BATCHES`
    times `count`.
    """
    found: list[tuple] = []

    def is_enough() -> bool:
        taken = sum(verdict not in NOT_ACCEPTED for verdict, _ in found)
        return len(found) >= count and taken >= min_accepted

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
                found.append((judge(text), text))

        collect()
        if is_enough():
            return found
    told = f"{min_accepted} accepted of {count} or more, up to {len(found)}"
    raise AssertionError(f"{told}: generated files are hardly accepted any more")


def report_verdicts(found: list[tuple], accepted_verdicts: tuple[str, ...]) -> str:
    """Print how often each verdict was given; return the worst with the shortest text of each."""
    shortest: dict[str, str] = {}
    counts: dict[str, int] = {}
    for verdict, text in sorted(found, key=lambda pair: len(pair[1])):
        counts[verdict] = counts.get(verdict, 0) + 1
        shortest.setdefault(verdict, text)
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    print(f"{len(found)} generated: {told}")
    bad = [verdict for verdict in counts if verdict not in accepted_verdicts]
    return "\n".join(f"{counts[v]} × {v}: {shortest[v][:1000]!r}" for v in bad)


def write_text(text: str, folder: Path) -> Path:
    path = folder / "generated.yaml"
    # Half a surrogate pair is no text: such a file is bytes that are not UTF-8.
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


def locate_error(error: BaseException) -> str:
    """Return the kind of an error and the line of the package that it comes from."""
    trace, inner = error.__traceback__, ""
    while trace:
        code = trace.tb_frame.f_code
        if "splits" in code.co_filename:
            inner = f"{Path(code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return f"{type(error).__name__} at {inner}"


def make_reading_judge(folder: Path) -> Callable[[str], str]:
    """Return the judge of a text that is read as an experiment file."""

    def judge(text: str) -> str:
        path = write_text(text, folder)
        try:
            with time_limit(TIME_LIMIT_S):
                load_experiment(path, MEDIA)
        except ConfigError as error:
            line = str(error).replace(str(folder), "")
            if len(line.splitlines()) != 1 or not line.isprintable():
                return "not one line"
            return "refused" if len(line) < MAX_LINE_CHARS else "a long line"
        except (Exception, TimeLimitExceeded) as error:
            return locate_error(error)
        return "accepted"

    return judge


def test_every_file_is_accepted_or_refused_in_one_line(tmp_path):
    begun = time.perf_counter()
    found = judge_each(odd.file_texts(), N_FILES, N_FILES // 20, make_reading_judge(tmp_path))
    bad = report_verdicts(found, ("accepted", "refused"))
    print(f"{time.perf_counter() - begun:.0f} s")
    assert not bad, bad


@pytest.mark.parametrize("share", [1, 20])
def test_files_are_generated_until_enough_are_accepted(share):
    """Whatever is drawn, one of 20 being accepted or all, the number that is judged is the same."""

    def judge(number: int) -> str:
        return "accepted" if number % share == 0 else "refused"

    found = judge_each(st.integers(0, 10**6), 10, 10, judge)
    assert sum(verdict == "accepted" for verdict, _ in found) == 10


def test_files_that_are_never_accepted_are_no_luck():
    with pytest.raises(AssertionError, match=r"1 accepted of 10 or more, up to [45]"):
        judge_each(st.integers(0, 10**6), 10, 1, lambda _: "refused")


# --- runs -------------------------------------------------------------------------------------


def limit_rays(experiment: ExperimentConfig) -> ExperimentConfig:
    """Return an experiment that takes few rays and not the tenth part of a second a point."""
    instrument = experiment.instrument
    most = {"rays": 1000, "realizations": 3}
    given = {key: getattr(instrument, key) for key in most}
    less = {key: min(value, most[key]) for key, value in given.items() if value is not None}
    if instrument.kind == "beam_spread" or instrument.estimator == "bins":
        less["rays"] = min(given["rays"] or 1000, 1000)
    return experiment.model_copy(update={"instrument": instrument.model_copy(update=less)})


def find_invalid_numbers(dataset) -> str:
    """Return what is wrong with the numbers of a dataset, or nothing."""
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
    """Return the judge of a text that is read, run and drawn."""

    def judge(text: str) -> str:
        try:
            experiment = load_experiment(write_text(text, folder), MEDIA)
        except ConfigError:
            return "refused"
        try:
            if experiment.fit:
                return "a fit, not run"
            dataset = run(limit_rays(experiment), TINY_ACCURACY, threads=1)
            with matplotlib.rc_context({"figure.max_open_warning": 0}):
                figure = draw(dataset, experiment.resolve_figure())
                figure.canvas.draw()
                figure.clear()
        except Exception as error:
            if "missing from font" not in str(error):
                return f"{locate_error(error)}: {error}"
            # What the machine's fonts lack is drawn as a box, and matplotlib says so.
            return find_invalid_numbers(dataset) or "sound, a letter in no font"
        return find_invalid_numbers(dataset) or "sound"

    return judge


@NEEDS_JIT
def test_what_is_accepted_runs_and_is_sound(tmp_path):
    matplotlib.use("Agg")
    begun = time.perf_counter()
    texts = generated.valid_contents().map(generated.to_file_text)
    found = judge_each(texts, N_RUNS, N_RUNS, make_running_judge(tmp_path))
    fine = (*NOT_ACCEPTED, "sound", "sound, a letter in no font")
    bad = report_verdicts(found, fine)
    print(f"{time.perf_counter() - begun:.0f} s")
    assert not bad, bad
