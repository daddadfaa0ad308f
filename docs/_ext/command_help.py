"""Sphinx directive for the help of the package's commands, run when the site is built."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

LOG = logging.getLogger(__name__)
ENTRY = "splits.cli"
CODE = f"import sys; from {ENTRY} import main; sys.argv[0] = 'splits'; sys.exit(main())"


class CommandHelp(SphinxDirective):
    """``{command-help} SUBCOMMAND``: output of ``splits SUBCOMMAND --help``."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the command and its output."""
        if find_spec(ENTRY) is None:
            return []
        command = [*self.arguments, "--help"]
        environment = {"COLUMNS": "80", "NO_COLOR": "1", "TERM": "dumb"}
        result = subprocess.run(
            [sys.executable, "-c", CODE, *command],
            capture_output=True, text=True, env=os.environ | environment, check=False,
        )  # fmt: skip
        if result.returncode:
            LOG.warning("%s: %s", command, result.stderr, location=self.get_location())
        text = f"$ splits {' '.join(command)}\n{result.stdout}"
        return [nodes.literal_block(text, text, language="console")]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
