"""What README prints is what its first example prints."""

from __future__ import annotations

import re
from pathlib import Path

from chi2 import NEEDS_JIT

README = Path(__file__).parents[2] / "README.md"


@NEEDS_JIT
def test_the_first_example_prints_what_stands_below_it(capsys):
    program, shown = re.search(
        r"```python\n(import splits\n.*?)```\n\n```\n(.*?)\n    \.\.\.\n```",
        README.read_text(),
        re.S,
    ).groups()
    exec(compile(program, "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith(shown)
