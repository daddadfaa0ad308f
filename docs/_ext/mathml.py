"""Rendering of formulas as MathML, which browsers display without scripts."""

from __future__ import annotations

import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

LOG = logging.getLogger(__name__)
LEFT_OVER = re.compile(r"\\[A-Za-z]+")
"""LaTeX commands that the converter does not support and copies to its output."""
UPRIGHT = re.compile(r'(?:<mi mathvariant="normal">[A-Za-z]</mi>)+')
ONE_UPRIGHT = re.compile(r"<mi>&#x000([0-9A-F]{2});</mi>")
"""Output of the converter for several upright letters, and for a single one."""


def mathml(node: nodes.Element, display: str) -> str:
    """Return a formula as MathML; unsupported formulas cause a warning."""
    text = node.astext()
    try:
        output = convert(text, display=display)
    except Exception as error:  # the converter raises errors of many types
        LOG.warning("formula %r: %s: %s", text, type(error).__name__, error, location=node)
        return ""
    if unknown := LEFT_OVER.search(output):
        LOG.warning("formula %r: %s is not known", text, unknown[0], location=node)
    return upright(output)


def upright(output: str) -> str:
    """Return MathML with words as text, since browsers set single letters in italics."""
    output = ONE_UPRIGHT.sub(lambda letter: f"<mtext>{chr(int(letter[1], 16))}</mtext>", output)
    return UPRIGHT.sub(lambda match: f"<mtext>{re.sub('<[^>]*>', '', match[0])}</mtext>", output)


def inline(self: HTML5Translator, node: nodes.math) -> None:
    """Write an inline formula."""
    self.body.append(mathml(node, "inline"))
    raise nodes.SkipNode


def block(self: HTML5Translator, node: nodes.math_block) -> None:
    """Write a display formula, with its number if it has a label."""
    self.body.append(self.starttag(node, "div", CLASS="math"))
    self.body.append(f'<div class="formula">{mathml(node, "block")}</div>')
    if node["number"]:
        self.body.append(f'<span class="eqno">({node["number"]})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
