"""The output shown in README.md is that of its example."""

import re
from pathlib import Path

import pytest
from chi2 import NEEDS_JIT

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "docs/install.md"])
def test_documented_install_command_includes_the_sky_extra(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert re.search(r"^\$ pip install (.*)$", text, re.M)[1] == "'.[sky]'"


@NEEDS_JIT
def test_first_example_prints_the_documented_albedo(capsys):
    pytest.importorskip("pvlib")
    example = r"```python\n(import splits\n.*?)```\n\n```\n(.*?)```"
    program, shown = re.search(example, README.read_text(encoding="utf-8"), re.S).groups()
    exec(compile(program, "README.md", "exec"), {})
    pattern = r"broadband albedo (\S+) ± (\S+)"
    actual, documented = (
        [float(number) for number in re.search(pattern, text).groups()]
        for text in (capsys.readouterr().out, shown)
    )
    assert abs(actual[0] - documented[0]) <= 4.0 * actual[1]
    assert actual[1] == pytest.approx(documented[1], abs=0.0015)
