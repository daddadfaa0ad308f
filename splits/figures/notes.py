"""What stands around the panels of a figure: their letters, and notes at the foot."""

from __future__ import annotations

from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from splits.figures.style import SMALLEST

_MARGIN_INCHES = 0.05
_LINE = 1.25
"""Line spacing of notes."""
FOOT = "foot"
"""What the notes' text is called in a figure."""


def finished(figure: Figure, panels: Iterable[Axes], *notes: str) -> Figure:
    """Letter the panels of a figure that has several, and write notes at its foot.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout; it grows by the height of the notes.
    panels : iterable of matplotlib.axes.Axes
        In reading order; the letter stands before a panel's title.
    *notes : str
        A paragraph each, broken at spaces; empty ones are left out.

    Returns
    -------
    matplotlib.figure.Figure
        The figure given.
    """
    shown = [axes for axes in panels if axes.get_visible()]
    for number, axes in enumerate(shown if len(shown) > 1 else ()):
        title = axes.get_title()
        axes.set_title("")
        axes.set_title(f"({letter(number)}) {title}".rstrip(), loc="left")
    add_notes(figure, *notes)
    return figure


def letter(number: int) -> str:
    """Return the letter of a panel counted from 0: a to z, then aa, ab and so on."""
    rounds, rest = divmod(number, 26)
    return (letter(rounds - 1) if rounds else "") + chr(ord("a") + rest)


def add_notes(figure: Figure, *notes: str) -> None:
    """Write notes below all else and below earlier ones; the figure grows by their height."""
    inches, dpi = figure.get_figwidth(), figure.dpi
    if not any(notes):
        return
    text = next((one for one in figure.texts if one.get_gid() == FOOT), None)
    height, earlier = figure.get_figheight(), ""
    if text is None:
        text = figure.text(
            _MARGIN_INCHES / inches, 0.0, "", va="bottom", ha="left", fontsize=SMALLEST,
            color="0.3", linespacing=_LINE, gid=FOOT,
        )  # fmt: skip
        # The layout would make room for it inside of the axes.
        text.set_in_layout(False)
    else:
        earlier = text.get_text() + "\n"
        height -= text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    widest = (inches - 2.0 * _MARGIN_INCHES) * dpi
    lines = [line for note in notes if note for line in _broken(text, note, widest)]
    text.set_text(earlier + "\n".join(lines))
    grown = text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    figure.set_figheight(height + grown)
    share = grown / (height + grown)
    text.set_y(_MARGIN_INCHES / (height + grown))
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0.0, share, 1.0, 1.0 - share))  # type: ignore[call-arg]


def _broken(text: Text, note: str, max_width_px: float) -> list[str]:
    """Return the lines of a note that are no wider than so many pixels."""
    lines = [""]
    for word in note.split(" "):
        longer = f"{lines[-1]} {word}".strip(" ")
        text.set_text(longer)
        if lines[-1] and text.get_window_extent().width > max_width_px:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
