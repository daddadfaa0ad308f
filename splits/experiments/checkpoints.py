"""Cache of the simulated points of an experiment's grid, from which an interrupted run resumes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.experiments.config.media import identify_by_content, replace_table_paths
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.io.netcdf import load, save


class PointCache:
    """Folder of simulated points, each in a file named by the digest of all inputs of its values.

    Points of another accuracy, seed or medium have other names, so they never collide.  The folder
    need not exist; `files` are the files of the points requested so far.
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
        """Return points that share paths, or None if the file of any is missing or damaged."""
        files = self._get_files(indices)
        try:
            # A damaged file is simulated again and overwritten.
            return [load(file) for file in files] if all(map(Path.exists, files)) else None
        except ValueError:
            return None

    def save(self, indices: Sequence[int], points: Iterable[xr.Dataset]) -> list[xr.Dataset]:
        """Write points that share paths, and return them as `load` would.

        Reading the files gives attributes the same types as in a resumed run.
        """
        files = self._get_files(indices)
        for file, point in zip(files, points, strict=True):
            save(point, file)
        return [load(file) for file in files]

    def delete(self) -> None:
        """Delete the files of the requested points, and the folder if it is then empty."""
        for file in self.files:
            file.unlink(missing_ok=True)
        for folder in (self.folder, self.folder.parent):
            with suppress(OSError):
                folder.rmdir()

    def _get_files(self, indices: Sequence[int]) -> list[Path]:
        """Return the files of points that share paths; each name depends on all of these points."""
        shared_keys = [self._point_keys[index] for index in indices]
        text = json.dumps([*self._common_key, shared_keys], sort_keys=True, default=repr)
        digest = hashlib.sha256(text.encode()).hexdigest()[:32]
        files = [self.folder / f"point_{digest}_{number}.nc" for number in range(len(indices))]
        self.files += [file for file in files if file not in self.files]
        return files
