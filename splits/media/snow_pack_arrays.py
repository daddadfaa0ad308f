"""Snowpacks as arrays of the same number of layers, for solvers of many snowpacks at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.media.measured_inputs import SURFACE_AREA_KEY
from splits.media.snow_pack_input import (
    DENSITY_KEY,
    IMPURITIES_KEY,
    LAYER_FLAG_NAME,
    TEMPERATURE_KEY,
    THICKNESS_KEY,
    WATER_KEY,
    ZENITH_KEY,
)
from splits.media.snow_pack_quality import LAYER_FLAGS


class SnowPackArrays(NamedTuple):
    """Good snowpacks as arrays of the same number of layers, without NaN.

    Layers below the last one of a snowpack have thickness 0 and its other properties.

    Attributes
    ----------
    positions : int, shape (good,)
        Positions of the good snowpacks along the dimension of the dataset.
    n_layers : int, shape (good,)
        Number of layers present.
    thickness_m, density_kg_m3, specific_surface_area_m2_kg, temperature_c, liquid_water_content
        Properties of the layers, float, shape (good, layers).
    impurities_ng_g : dict of float, shape (good, layers)
        Mass of impurities per mass of ice (ng/g) by type.
    sun_zenith_deg : float, shape (good,), or None
    """

    positions: np.ndarray
    n_layers: np.ndarray
    thickness_m: np.ndarray
    density_kg_m3: np.ndarray
    specific_surface_area_m2_kg: np.ndarray
    temperature_c: np.ndarray
    liquid_water_content: np.ndarray
    impurities_ng_g: dict[str, np.ndarray]
    sun_zenith_deg: np.ndarray | None

    @classmethod
    def from_dataset(
        cls, dataset: xr.Dataset, positions: np.ndarray, label: str, impurities: tuple[str, ...]
    ) -> SnowPackArrays:
        """Return the snowpacks at positions along the label of a checked dataset."""
        rows = dataset.isel({label: positions})
        is_present = rows[LAYER_FLAG_NAME].values == LAYER_FLAGS["present"]
        n_layers = is_present.sum(axis=1)
        depth = int(n_layers.max(initial=0))
        # Below the last layer, its properties are repeated.
        source = np.minimum(np.arange(depth), n_layers[:, np.newaxis] - 1)

        def fill(name: str) -> np.ndarray:
            return np.take_along_axis(rows[name].values, source, axis=1)

        return cls(
            positions,
            n_layers,
            np.where(is_present[:, :depth], fill(THICKNESS_KEY), 0.0),
            fill(DENSITY_KEY),
            fill(SURFACE_AREA_KEY),
            fill(TEMPERATURE_KEY),
            fill(WATER_KEY),
            {kind: fill(f"{IMPURITIES_KEY}.{kind}") for kind in impurities},
            rows[ZENITH_KEY].values if ZENITH_KEY in rows else None,
        )
