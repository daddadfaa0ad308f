"""Words that figures and reports show: what can be set, and what cannot."""

from __future__ import annotations

from splits.checks import refuse

LONGEST_LABEL = 80
LONGEST_TITLE = 200
LONGEST_CAPTION = 5000


def check_text(key: str, value: str, max_chars: int, multiline: bool = False) -> str:
    """Return a text of one line, or of several, or refuse what cannot be printed.

    Parameters
    ----------
    key, value : str
    longest : int
        Largest number of characters.
    lines : bool
        Whether it may have several lines.
    """
    if len(value) > max_chars:
        raise refuse(key, value, f"at most {max_chars} characters")
    plain = value.replace("\n", "").replace("\t", "") if multiline else value
    if not plain.isprintable():
        raise refuse(key, value, "text without control characters or line breaks")
    return value


def check_path(key: str, value: str) -> str:
    """Return the path of a folder or file, or refuse one that the workflow reads as a pattern."""
    if not value.isprintable() or set(value) & set("{}<>"):
        allowed = "a path without { } < > and control characters"
        raise refuse(key, value, allowed, "Snakemake takes braces for wildcards")
    return value


def check_mathematics(key: str, value: str) -> str:
    """Return a text that may hold formulas between dollar signs, or refuse what cannot be set."""
    # One dollar sign alone is a dollar sign.
    dollars = value.count("$") - value.count(r"\$")
    if dollars < 2 or dollars % 2:
        return value
    from matplotlib.mathtext import MathTextParser  # a figure's job loads it anyway

    try:
        MathTextParser("path").parse(value)
    except (ValueError, RuntimeError):
        hint = r"write \$ for a dollar sign"
        raise refuse(key, value, "text that matplotlib can set", hint) from None
    return value
