"""Small copies of figures for the documentation."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from PIL import Image

from splits.core.atomic import atomic_write
from splits.core.validation import invalid

MAX_WIDTH_PX = 900
"""Largest width of an image (pixels)."""
MAX_IMAGE_BYTES = 100_000
"""Largest size of a file."""
WEBP_QUALITIES = (90, 80, 70, 60, 50, 40, 30)
IMAGE_SUFFIX = ".webp"


def write_gallery(
    figures: str | Path, names: Iterable[str], folder: str | Path
) -> tuple[list[Path], list[Path]]:
    """Write small copies of figures, and delete copies of removed figures.

    Parameters
    ----------
    figures : path
        Folder of a run's figures.
    names : iterable of str
        Names of the figures, without ``.png``.
    folder : path
        Folder of the copies, WebP files of at most `MAX_WIDTH_PX` pixels and `MAX_IMAGE_BYTES`
        bytes.

    Returns
    -------
    written, deleted : list of Path
        Unchanged copies are not written.

    Raises
    ------
    ValueError
        For a missing figure, before anything is written.
    """
    figures, folder = Path(figures), Path(folder)
    copies = {}
    for name in names:
        path = figures / f"{name}.png"
        if not path.exists():
            raise invalid("figures", str(path), "an existing file", "run snakemake --cores 2")
        copies[folder / f"{name}{IMAGE_SUFFIX}"] = compress_figure(path)
    written = [p for p, copy in copies.items() if not p.exists() or p.read_bytes() != copy]
    for path in written:
        with atomic_write(path) as temporary_path:
            temporary_path.write_bytes(copies[path])
    deleted = [path for path in sorted(folder.glob(f"*{IMAGE_SUFFIX}")) if path not in copies]
    for path in deleted:
        path.unlink()
    return written, deleted


def compress_figure(path: str | Path) -> bytes:
    """Return a figure as a WebP file of the best quality within the size limit.

    Raises
    ------
    ValueError
        For a figure that exceeds the size limit at all qualities.
    """
    with Image.open(path) as figure:
        image = figure.convert("RGB")
    if image.width > MAX_WIDTH_PX:
        height = round(image.height * MAX_WIDTH_PX / image.width)
        image = image.resize((MAX_WIDTH_PX, height), Image.Resampling.LANCZOS)
    candidates: list[dict[str, Any]] = [
        {"lossless": True},
        *({"quality": q} for q in WEBP_QUALITIES),
    ]
    for settings in candidates:
        buffer = io.BytesIO()
        image.save(buffer, "webp", method=6, **settings)
        if buffer.tell() <= MAX_IMAGE_BYTES:
            return buffer.getvalue()
    raise invalid("figures", str(path), f"an image that fits into {MAX_IMAGE_BYTES} bytes")
