"""Small transmittances by discrete ordinates, and their relative errors."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.grain_tabulation import N_RAYS, TableAxes, tabulate_grains
from splits.discrete_ordinates.grains import Axis
from splits.discrete_ordinates.granular_stack import OPTICS_SHARE
from splits.discrete_ordinates.profiles import find_similarity_error
from splits.simulation.grain_optics import GRAIN_RAYS_PER_CHUNK
from splits.simulation.run_options import RunOptions

BEAM = np.array([1.0])
WAVELENGTHS = np.array([800.0, 1030.0, 1300.0])
SNOWS = {
    "dry": {"specific_surface_area_m2_kg": 20},
    "dirty": {"specific_surface_area_m2_kg": 20, "impurities_ng_g": {"black_carbon": 100}},
    "wet": {"specific_surface_area_m2_kg": 15, "liquid_water_content": 0.05},
}


@pytest.mark.parametrize("kind", SNOWS)
@pytest.mark.parametrize("depth_m", [0.05, 0.2])
def test_relative_errors_cover_the_number_of_streams(kind, depth_m):
    snow = splits.Snow.natural(depth_m=depth_m, **SNOWS[kind])
    found = splits.spectrophotometer(snow, WAVELENGTHS, 0.0, solver="discrete_ordinates")
    fine = make_granular_stack(snow, WAVELENGTHS).solve(BEAM, 64).transmittance[:, 0]
    difference = np.abs(found.transmittance.values - fine)
    assert (difference <= found.transmittance_stderr).all()
    small = found.where(found.transmittance < 1e-3, drop=True)
    relative = small.transmittance_stderr / small.transmittance
    assert small.transmittance.size and (relative < 0.2).all()
    assert (relative > 1e-4).all()


@pytest.mark.parametrize("kind", SNOWS)
def test_thick_layers_attenuate_light_exponentially(kind):
    """Halves joined by adding transmit as the whole, and equal layers attenuate equally."""
    depths = 0.2 * np.arange(2, 5)
    pieces = [splits.Snow.natural(depth_m=depth, **SNOWS[kind]) for depth in (*depths, 0.2)]
    one, two, three, half = (
        make_granular_stack(piece, WAVELENGTHS).solve(BEAM, 16).transmittance[:, 0]
        for piece in pieces
    )
    np.testing.assert_allclose(one * three / two**2, 1.0, rtol=1e-9)
    joined = make_granular_stack(splits.Stack([pieces[-1]] * 2), WAVELENGTHS).solve(BEAM, 16)
    np.testing.assert_allclose(joined.transmittance[:, 0], one, rtol=1e-12)
    assert (half > one).all()


@NEEDS_JIT
@pytest.mark.slow
def test_errors_agree_with_the_scatter_between_tables():
    """Transmittances of 10⁻⁷ to 10⁻¹³ with tables of few rays, over the error of so few rays."""
    rays, z = 20 * GRAIN_RAYS_PER_CHUNK, []
    natural = splits.Snow.natural(optical_radius_um=100.0)
    for number, wavelength in enumerate((1030.0, 1300.0)):
        snow = splits.Snow.natural(depth_m=0.1, **SNOWS["dry"])
        pack = make_granular_stack(snow, np.array([wavelength]))
        (layer,) = pack.layers
        q = layer.grain_absorption / (1.0 + layer.grain_absorption)
        axes = TableAxes(
            Axis(layer.contrast), Axis(np.zeros(1)), Axis(np.append(0.0, q)), layer.water_index
        )
        expected = np.log(pack.solve(BEAM, 8).transmittance[0, 0])
        error = find_similarity_error(layer.contrast, False)[0] * np.sqrt(N_RAYS / rays)
        error *= OPTICS_SHARE * (1.0 + abs(expected))
        for seed in range(12):
            run = RunOptions.from_arguments(100 * number + seed)
            table = tabulate_grains(natural, axes, 17, rays, run)
            other = pack._replace(layers=[layer._replace(grains=table)])
            found = np.log(other.solve(BEAM, 8).transmittance[0, 0])
            z.append((found - expected) / error)
    judge_z(z, "transmittances of tables")
