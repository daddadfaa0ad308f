"""Points of an experiment's grid that are kept while others are still to be measured."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.experiments.config.medium import identify_by_content, replace_table_paths
from splits.experiments.config.settings import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.io.netcdf import load, save


class PointCache:
    """A folder of points that were measured, each in a file named after what decides its numbers.

    So points at another accuracy, of another seed or of another medium have other files, and none
    takes the place of another.

    Parameters
    ----------
    folder : path
        Need not exist.
    experiment : SimulationConfig
    accuracy : Accuracy
    seed : int

    Attributes
    ----------
    files : list of Path
        Files of the points asked for so far.
    """

    def __init__(
        self, folder: Path, experiment: SimulationConfig, accuracy: Accuracy, seed: int
    ) -> None:
        self.folder, self.files = folder, list[Path]()
        instrument = experiment.instrument.model_dump(mode="json")
        kind = experiment.medium.get("kind", "snow")
        self._common_key = [hash_physics_sources(), instrument, accuracy.model_dump(), seed, kind]
        self._point_keys = [
            (replace_table_paths(settings, identify_by_content), incidence)
            for _, settings, incidence in experiment.iter_settings()
        ]

    def load(self, indices: Sequence[int]) -> list[xr.Dataset] | None:
        """Return the points that share paths, or None if not all of them are there and sound."""
        found = []
        for file in self._get_files(indices):
            if not file.exists():
                return None
            try:
                found.append(load(file))
            except ValueError:
                # Damaged: it is measured again, and written over.
                return None
        return found

    def save(self, indices: Sequence[int], points: Iterable[xr.Dataset]) -> list[xr.Dataset]:
        """Write points that share paths, and return them as `load` would.

        Attributes of one number differ in a file: points of a resumed run must not from others.
        """
        files = self._get_files(indices)
        for file, point in zip(files, points, strict=True):
            save(point, file)
        return [load(file) for file in files]

    def delete(self) -> None:
        """Delete the files of the points asked for, and the folder if it holds no others."""
        for file in self.files:
            file.unlink(missing_ok=True)
        for folder in (self.folder, self.folder.parent):
            with suppress(OSError):
                folder.rmdir()

    def _get_files(self, indices: Sequence[int]) -> list[Path]:
        """Return where points are kept, whose numbers depend on all that share their paths."""
        together = [self._point_keys[place] for place in indices]
        text = json.dumps([*self._common_key, together], sort_keys=True, default=repr)
        digest = hashlib.sha256(text.encode()).hexdigest()[:32]
        files = [self.folder / f"point_{digest}_{number}.nc" for number in range(len(indices))]
        self.files += [file for file in files if file not in self.files]
        return files
