"""Experiments on the snowpacks of a file, which are divided into blocks and parts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from inspect import signature
from typing import Any

import numpy as np

from splits.core.paths import expand_path
from splits.core.validation import invalid, key_prefix, unknown_key
from splits.experiments.config.albedo_instrument import Albedo
from splits.experiments.config.instrument import Instrument
from splits.experiments.config.instrument_kinds import Spectrophotometer
from splits.experiments.config.medium import list_table_paths
from splits.illumination.sky import CLEAR_SKY
from splits.instruments.snow_packs import SUN, check_pack_wavelengths
from splits.instruments.solver import MONTE_CARLO
from splits.media.snow_pack_files import read_snow_packs
from splits.media.snow_pack_input import ZENITH_KEY
from splits.media.snow_packs import SnowPacks
from splits.simulation.run_options import MAX_DATASET_VALUES

PACKS_KIND = "snow_packs"
"""Kind of the medium of a file of snowpacks."""
PACKS_PER_BLOCK, BLOCKS_PER_PART = 50, 10


def load_packs(settings: Mapping[str, Any]) -> SnowPacks:
    """Return the snowpacks of the keywords of a medium; the last files are kept in memory."""
    for key in settings:
        if key not in (names := [*signature(read_snow_packs).parameters]):
            raise unknown_key(f"medium.{key}", names)
    if "file" not in settings:
        raise invalid("medium.file", None, "given", "the file of the snowpacks")
    files = [expand_path(path) for path in list_table_paths(settings)]
    states = [(one.stat().st_mtime_ns, one.stat().st_size) for one in files if one.is_file()]
    with key_prefix("medium"):
        return _load_packs(json.dumps(settings), tuple(states))


@lru_cache(maxsize=2)
def _load_packs(settings: str, states: tuple[tuple[int, int], ...]) -> SnowPacks:
    """Return the snowpacks of settings as JSON, for a state of their files."""
    return read_snow_packs(**json.loads(settings))


def count_pack_parts(packs: SnowPacks) -> int:
    """Return the number of parts of an experiment on snowpacks, each simulated by one job."""
    return -(-len(packs) // (PACKS_PER_BLOCK * BLOCKS_PER_PART))


def check_pack_experiment(packs: SnowPacks, instrument: Instrument) -> None:
    """Reject an instrument that does not measure snowpacks, or not these.

    The error names the key.
    """
    if not isinstance(instrument, Spectrophotometer | Albedo):
        allowed = "spectrophotometer or albedo for medium.kind = 'snow_packs'"
        raise invalid("instrument.kind", instrument.kind, allowed)
    count = len(packs) * instrument.count_values()
    if count > MAX_DATASET_VALUES:
        given = f"{len(packs)} snowpacks of {instrument.count_values()} values each"
        allowed = f"at most {MAX_DATASET_VALUES} values in all"
        raise invalid("medium.file", given, allowed, "split it into several files")
    if isinstance(instrument, Spectrophotometer):
        has_solver = "solver" in instrument.model_fields_set
        if has_solver and instrument.solver == MONTE_CARLO:
            allowed = "left out, discrete_ordinates or auto for snow_packs"
            raise invalid("instrument.solver", instrument.solver, allowed)
        if instrument.estimator == "analog":
            raise invalid("instrument.estimator", "analog", "left out for snow_packs")
    if isinstance(instrument, Albedo):
        needs_sun = instrument.sky == CLEAR_SKY
    else:
        needs_sun = instrument.get_incidence() == SUN
    if needs_sun and ZENITH_KEY not in packs.dataset:
        given, hint = f"without {ZENITH_KEY}", "or give latitude_deg and longitude_deg"
        raise invalid("medium.file", given, "with the zenith angles of the sun", hint)
    is_wet = np.any(packs.to_arrays().liquid_water_content > 0.0, axis=1)
    wavelengths = instrument.get_wavelengths()
    with key_prefix("instrument"):
        check_pack_wavelengths(wavelengths, is_wet)
        packs.compute_ground_albedo(wavelengths)
