"""A block of a table: what one ensemble of paths tells of all points that it serves."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.dataset import load, provenance, save
from splits.instruments.cut import Cut
from splits.instruments.ensemble import GROUPS
from splits.instruments.progress import Report
from splits.instruments.shared_paths import Family
from splits.instruments.spectral_run import SIDES, Run
from splits.lookup.plan import Ensemble

DIGEST = "table_digest"


class Order(NamedTuple):
    """How a table is to be measured.

    Attributes
    ----------
    run : Run
        But for the incidence, which is each ensemble's own.
    quantities : tuple of str
        Of `SIDES`.
    covariance : bool
        Whether deviations by group of rays are kept.
    """

    run: Run
    quantities: tuple[str, ...]
    covariance: bool


class Cuts:
    """Cuts of deep packs, which do not depend on the incidence: each family's is kept."""

    def __init__(self) -> None:
        self._family: Family | None = None
        self._cut: Cut | None = None

    def of(self, run: Run, family: Family) -> Cut | None:
        """Return the cut of a family; that of the last one asked for is at hand."""
        if family is not self._family:
            self._family, self._cut = family, run.cut(family)
        return self._cut


def measure(
    ensemble: Ensemble, order: Order, cuts: Cuts, digest: str, progress: Report = None
) -> xr.Dataset:
    """Return a block: values and errors over ``point`` and ``wavelength``.

    Parameters
    ----------
    ensemble : Ensemble
    order : Order
    cuts : Cuts
    digest : str
        Of all that decides the table's numbers.
    progress : callable, optional
    """
    begun = time.perf_counter()
    run = order.run._replace(incidence=ensemble.incidence)
    cut = cuts.of(run, ensemble.family)
    found = run.estimated_above(cut, ensemble.family, progress=progress).result
    shape = (len(ensemble.family.media), run.wavelengths.size)
    variables: dict[str, Any] = {}
    for side in order.quantities:
        row = SIDES.index(side)
        for name, table in ((side, found.mean), (f"{side}_stderr", found.stderr)):
            values = table[row].reshape(shape)[ensemble.which]
            variables[name] = (("point", "wavelength"), values.astype(np.float32))
        if order.covariance:
            groups = found.groups[:, row].reshape(GROUPS, *shape)[:, ensemble.which]
            variables[f"{side}_groups"] = (
                ("group", "point", "wavelength"), groups.astype(np.float32),
            )  # fmt: skip
    facts = {
        **provenance("block of a table"),
        DIGEST: digest,
        "ensemble": ensemble.number,
        "rays": found.rays,
        "max_stderr_reached": float(found.stderr.max()),
        "interpolation_error_bound": float(found.bias.max()),
        "kernel": found.kernel,
        "stopped_by": "error" if found.converged else "rays",
        "wall_time_s": round(time.perf_counter() - begun, 3),
    }
    places = ("point", ensemble.places, {"long_name": "place in the table"})
    return xr.Dataset(variables, {"point": places, "wavelength": run.wavelengths}, facts)


def block_file(folder: Path, number: int, digest: str) -> Path:
    """Return where a block is kept; one of another digest has another place."""
    return folder / f"block_{number:06d}_{digest[:16]}.nc"


def kept(folder: Path, number: int, digest: str) -> xr.Dataset | None:
    """Return a block that was kept, None where there is none, or one that is of no use."""
    path = block_file(folder, number, digest)
    if not path.exists():
        return None
    try:
        block = load(path)
    except ValueError:
        # Damaged, or of another program: it is measured again, and written over.
        return None
    return block if block.attrs.get(DIGEST) == digest else None


def keep(block: xr.Dataset, folder: Path) -> None:
    """Write a block, whole or not at all."""
    save(block, block_file(folder, int(block.attrs["ensemble"]), block.attrs[DIGEST]))
