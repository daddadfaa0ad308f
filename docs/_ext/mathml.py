"""Formulas of the documentation as MathML, which browsers show without a script."""

from __future__ import annotations

import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

LOG = logging.getLogger(__name__)
LEFT_OVER = re.compile(r"\\[A-Za-z]+")
"""A command that the converter does not know stands in its answer as it was written."""
UPRIGHT = re.compile(r'(?:<mi mathvariant="normal">[A-Za-z]</mi>)+')
ONE_UPRIGHT = re.compile(r"<mi>&#x000([0-9A-F]{2});</mi>")
"""Upright letters as the converter writes several of them, and one alone."""


def mathml(node: nodes.Element, display: str) -> str:
    """Return a formula as MathML; one that is not understood is a warning."""
    text = node.astext()
    try:
        made = convert(text, display=display)
    except Exception as error:  # of many kinds, none of them the converter's own
        LOG.warning("formula %r: %s: %s", text, type(error).__name__, error, location=node)
        return ""
    if unknown := LEFT_OVER.search(made):
        LOG.warning("formula %r: %s is not known", text, unknown[0], location=node)
    return upright(made)


def upright(made: str) -> str:
    """Return MathML with words as words: browsers slant every letter that stands for itself."""
    made = ONE_UPRIGHT.sub(lambda found: f"<mtext>{chr(int(found[1], 16))}</mtext>", made)
    return UPRIGHT.sub(lambda f: f"<mtext>{re.sub('<[^>]*>', '', f[0])}</mtext>", made)


def inline(self: HTML5Translator, node: nodes.math) -> None:
    """Write a formula in a line of text."""
    self.body.append(mathml(node, "inline"))
    raise nodes.SkipNode


def block(self: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on lines of its own, with its number beside it where it has a label."""
    self.body.append(self.starttag(node, "div", CLASS="math"))
    self.body.append(f'<div class="formula">{mathml(node, "block")}</div>')
    if node["number"]:
        self.body.append(f'<span class="eqno">({node["number"]})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the renderer to Sphinx."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
