"""Images of figures for the documentation: small copies, and no others."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from PIL import Image

from splits.checks import refuse
from splits.files import whole

WIDTH = 900
"""Widest image (pixels)."""
BYTES = 100_000
"""Largest file."""
QUALITIES = (90, 80, 70, 60, 50, 40, 30)
SUFFIX = ".webp"


def write_gallery(
    figures: str | Path, names: Iterable[str], folder: str | Path
) -> tuple[list[Path], list[Path]]:
    """Write small copies of figures, and delete those of figures that there are no more.

    Parameters
    ----------
    figures : path
        Folder of a run's figures.
    names : iterable of str
        Names of the figures, without ``.png``.
    folder : path
        Where the copies go, WebP files of at most `WIDTH` pixels and `BYTES` bytes.

    Returns
    -------
    written, deleted : list of Path
        Copies that are as they were are not written.

    Raises
    ------
    ValueError
        For a figure that is not there, before anything is written.
    """
    figures, folder = Path(figures), Path(folder)
    copies = {}
    for name in names:
        path = figures / f"{name}.png"
        if not path.exists():
            raise refuse("figures", str(path), "there", "snakemake --cores 2 makes it")
        copies[folder / f"{name}{SUFFIX}"] = small(path)
    written = [p for p, copy in copies.items() if not p.exists() or p.read_bytes() != copy]
    for path in written:
        with whole(path) as aside:
            aside.write_bytes(copies[path])
    deleted = [path for path in sorted(folder.glob(f"*{SUFFIX}")) if path not in copies]
    for path in deleted:
        path.unlink()
    return written, deleted


def small(path: str | Path) -> bytes:
    """Return a figure as a WebP file, as sharp as its size allows.

    Raises
    ------
    ValueError
        For a figure that no quality makes small enough.
    """
    with Image.open(path) as figure:
        image = figure.convert("RGB")
    if image.width > WIDTH:
        height = round(image.height * WIDTH / image.width)
        image = image.resize((WIDTH, height), Image.Resampling.LANCZOS)
    every: list[dict[str, Any]] = [{"lossless": True}, *({"quality": q} for q in QUALITIES)]
    for settings in every:
        made = io.BytesIO()
        image.save(made, "webp", method=6, **settings)
        if made.tell() <= BYTES:
            return made.getvalue()
    raise refuse("figures", str(path), f"an image that fits into {BYTES} bytes")
