"""Images of figures for the documentation: small copies, and no others."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from PIL import Image

from splits.core.atomic import atomic_write
from splits.core.validation import invalid

MAX_WIDTH_PX = 900
"""Widest image (pixels)."""
MAX_IMAGE_BYTES = 100_000
"""Largest file."""
WEBP_QUALITIES = (90, 80, 70, 60, 50, 40, 30)
IMAGE_SUFFIX = ".webp"


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
        Where the copies go, WebP files of at most `MAX_WIDTH_PX` pixels and `MAX_IMAGE_BYTES`
        bytes.

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
            raise invalid("figures", str(path), "there", "snakemake --cores 2 makes it")
        copies[folder / f"{name}{IMAGE_SUFFIX}"] = compress_figure(path)
    written = [p for p, copy in copies.items() if not p.exists() or p.read_bytes() != copy]
    for path in written:
        with atomic_write(path) as aside:
            aside.write_bytes(copies[path])
    deleted = [path for path in sorted(folder.glob(f"*{IMAGE_SUFFIX}")) if path not in copies]
    for path in deleted:
        path.unlink()
    return written, deleted


def compress_figure(path: str | Path) -> bytes:
    """Return a figure as a WebP file, as sharp as its size allows.

    Raises
    ------
    ValueError
        For a figure that no quality makes small enough.
    """
    with Image.open(path) as figure:
        image = figure.convert("RGB")
    if image.width > MAX_WIDTH_PX:
        height = round(image.height * MAX_WIDTH_PX / image.width)
        image = image.resize((MAX_WIDTH_PX, height), Image.Resampling.LANCZOS)
    every: list[dict[str, Any]] = [{"lossless": True}, *({"quality": q} for q in WEBP_QUALITIES)]
    for settings in every:
        made = io.BytesIO()
        image.save(made, "webp", method=6, **settings)
        if made.tell() <= MAX_IMAGE_BYTES:
            return made.getvalue()
    raise invalid("figures", str(path), f"an image that fits into {MAX_IMAGE_BYTES} bytes")
