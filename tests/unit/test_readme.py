"""What README prints is what its examples print."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from chi2 import NEEDS_JIT

README = Path(__file__).parents[2] / "README.md"


def lines(text):
    """Return variables as they are printed: name, dimensions and size, and the first number."""
    found = re.findall(r"^ +\*? ?(\w+ +\([\w, ]+\) \w+ \w+) (\S+)", text, re.M)
    return [heading for heading, _ in found], [float(number) for _, number in found]


@NEEDS_JIT
def test_the_example_of_a_spectrum_prints_what_stands_below_it(capsys):
    """Its last digits may differ between processors, whose logarithms do."""
    example = r"```python\n(import splits\n(?:(?!```).)*print\(ds\)\n)```\n\n```\n(.*?)```"
    program, shown = re.search(example, README.read_text(encoding="utf-8"), re.S).groups()
    made = {}
    exec(compile(program, "README.md", "exec"), made)
    printed = capsys.readouterr().out
    assert printed.splitlines()[:5] == shown.splitlines()[:5]
    headings, first = lines(shown)
    assert headings == lines(printed)[0] and len(headings) == 9
    for heading, number in zip(headings, first, strict=True):
        name = heading.split()[0]
        if f"{name}_stderr" in made["ds"]:
            away = number - float(made["ds"][name][0])
            assert abs(away) <= 4.0 * float(made["ds"][f"{name}_stderr"][0])
    attributes = re.search(r"Attributes: \(12/\d+\)", shown)[0]
    assert attributes in printed


@NEEDS_JIT
def test_the_first_example_prints_an_albedo(capsys):
    pytest.importorskip("pvlib")
    example = r"```python\n(import splits\n.*?)```\n\n```\n(.*?)```"
    program, shown = re.search(example, README.read_text(encoding="utf-8"), re.S).groups()
    exec(compile(program, "README.md", "exec"), {})
    pattern = r"broadband albedo (\S+) ± (\S+)"
    now, then = (
        [float(number) for number in re.search(pattern, text).groups()]
        for text in (capsys.readouterr().out, shown)
    )
    assert abs(now[0] - then[0]) <= 4.0 * now[1]
    assert now[1] == pytest.approx(then[1], abs=0.0015)
