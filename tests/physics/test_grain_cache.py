"""Kept results of paths through single grains; `tests/unit/io/test_cache.py` tests the files."""

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.discrete_ordinates import grains
from splits.discrete_ordinates.grains import MIN_RAYS, load_grains, trace_grains
from splits.kernels.compiler import cache

WAVELENGTHS = np.array([1300.0])
SNOW = splits.Snow(interpretation="radiative_transfer", saturation=0.0)
RAYS = MIN_RAYS // 16


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder for the results."""
    monkeypatch.setattr(cache, "find_cache_folder", lambda: tmp_path)
    return tmp_path


@pytest.fixture
def traced(monkeypatch):
    """Return the digests of the grains that are traced."""
    digests = []

    def count(scene, constants, nodes, rays, digest, threads):
        digests.append(digest)
        return trace_grains(scene, constants, nodes, rays, digest, threads)

    monkeypatch.setattr(grains, "trace_grains", count)
    return digests


def load(snow=SNOW, **settings):
    return load_grains(snow, WAVELENGTHS, **{"rays": RAYS, "threads": 1, **settings})


@NEEDS_JIT
def test_grains_are_traced_once(folder, traced):
    first, second = load(), load(threads=2)
    assert len(traced) == 1 and len(list(folder.glob("grains_*.nc"))) == 1
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, two)
    # Depth, density, ground and the absorption of pores have no effect on grains.
    load(splits.Snow(
        interpretation="radiative_transfer", saturation=0.0, depth_m=0.5, ground=0.2,
        density_kg_m3=100.0, impurities_ng_g={"black_carbon": 50.0}, impurities_in="pores",
    ))  # fmt: skip
    assert len(traced) == 1
    load(splits.Snow(interpretation="radiative_transfer", saturation=0.0, temperature_c=-1.0,
                     impurities_ng_g={"black_carbon": 50.0}))  # fmt: skip
    load(splits.Snow(interpretation="radiative_transfer", saturation=0.1))
    load(rays=2 * RAYS)
    assert len(set(traced)) == 4
