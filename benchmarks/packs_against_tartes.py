"""Dense packs of dry snow against two theories of radiative transfer, with our single scattering.

Discrete ordinates take the grains' whole phase function; TARTES takes two streams and an asymmetry.
To both, grains are points; the way of light through them is allowed for in the optical thickness
(`correct_dense_packing`).  Four steps lead from ours to TARTES:

    ours − kept         the rules of a packed medium: grains that would reach across a boundary or
                        lie on the leg before are drawn again;
    kept − ordinates    the rest of what density does;
    ordinates − TARTES  two streams, and an asymmetry in place of a phase function.

With diffraction, as TARTES counts, extinction is twice that of the cross-section, the albedo is
(1 + ω)/2 and the asymmetry (1 + ω g)/(1 + ω).  Its delta-Eddington streams take the peak out again.
The grains' B, 1 − ω' = 2 B γ/(ρ SSA) for little absorption γ, is printed for comparison.

    python benchmarks/packs_against_tartes.py [--max-stderr 0.001]
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import pandas as pd
import tartes
import xarray as xr

import splits
from splits.analysis.theory.asymptotic import correct_dense_packing
from splits.analysis.theory.discrete_ordinates import solve_discrete_ordinates
from splits.simulation.scene import compute_optical_constants

WAVELENGTHS_NM = np.array(
    [450.0, 600.0, 750.0, 900.0, 1000.0, 1100.0, 1300.0, 1500.0, 1700.0, 2200.0]
)
ICE_KG_M3 = 917.0
KEEP_OVERLAPS = {"overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep"}
FINE_GRAINS = {"grain_size_um": (100.0, 200.0), "saturation": 0.0}
COARSE_GRAINS = {"grain_size_um": (400.0, 800.0), "saturation": 0.0}
SNOWPACKS: dict[str, list[dict[str, Any]]] = {
    "5 cm fine on 30 cm coarse": [
        {**FINE_GRAINS, "density_kg_m3": 150.0, "depth_m": 0.05},
        {**COARSE_GRAINS, "density_kg_m3": 350.0, "depth_m": 0.3},
    ],
    "1 cm fine on 4 cm coarse": [
        {**FINE_GRAINS, "density_kg_m3": 150.0, "depth_m": 0.01},
        {**COARSE_GRAINS, "density_kg_m3": 350.0, "depth_m": 0.04},
    ],
    "2 cm of packed coarse": [{**COARSE_GRAINS, "density_kg_m3": 550.0, "depth_m": 0.02}],
}
SOIL_ALBEDO = 0.2
INCIDENCE_DEG = (30.0, 60.0)


def compute_shape(snow: splits.Snow, optics: xr.Dataset) -> pd.DataFrame:
    """Return B and g over wavelength, diffraction counted."""
    gamma = compute_optical_constants(snow, WAVELENGTHS_NM).absorption[
        :, snow.list_materials().index("ice")
    ]
    ssa = 4.0 * optics.extinction.values / snow.density_kg_m3
    albedo = optics.single_scattering_albedo.values
    b = 0.5 * (1.0 - albedo) * ICE_KG_M3 * ssa / (2.0 * gamma)
    g = (1.0 + albedo * optics.asymmetry_parameter.values) / (1.0 + albedo)
    return pd.DataFrame({"B": b, "g": g}, WAVELENGTHS_NM.astype(int))


def compute_two_stream_albedo(
    layers: list[splits.Snow], optics: list[xr.Dataset], angle: float
) -> np.ndarray:
    """Return the albedo of a pack by the two streams of TARTES."""
    albedo = np.stack([one.single_scattering_albedo.values for one in optics], axis=-1)
    asymmetry = np.stack([one.asymmetry_parameter.values for one in optics], axis=-1)
    extinction = np.stack([one.extinction.values for one in optics], axis=-1)
    found = [
        tartes.two_stream_rt(
            np.array([one.depth_m for one in layers]),
            0.5 * (1.0 + albedo[i : i + 1]),
            (1.0 + albedo * asymmetry)[i : i + 1] / (1.0 + albedo[i : i + 1]),
            2.0 * extinction[i],
            bottom_albedo=np.array([SOIL_ALBEDO]),
            dir_frac=np.array([1.0]),
            mudir=float(np.cos(np.radians(angle))),
        )
        for i in range(len(WAVELENGTHS_NM))
    ]
    return np.array(found).ravel()


def compare_snowpack(name: str, number: int, max_stderr: float) -> pd.DataFrame:
    """Print the shapes of a pack's layers, and return its reflectance in four ways."""
    plain = [splits.Snow(**one) for one in SNOWPACKS[name]]
    kept = [splits.Snow(**one, interpretation=KEEP_OVERLAPS) for one in SNOWPACKS[name]]
    single = [
        splits.single_scattering(one, WAVELENGTHS_NM, seed=10 * number + i)
        for i, one in enumerate(plain)
    ]
    for layer, optics in zip(plain, single, strict=True):
        print(f"{name}: {layer.density_kg_m3:g} kg/m3")
        print(compute_shape(layer, optics).T.round(3).to_string())
    thinner = [correct_dense_packing(one) for one in single]
    tables = []
    for angle in INCIDENCE_DEG:
        ours, loose = (
            splits.spectrophotometer(
                splits.Stack(layers, ground=SOIL_ALBEDO), WAVELENGTHS_NM, angle, max_stderr, seed
            )
            for seed, layers in ((7, plain), (8, kept))
        )
        ordinates = solve_discrete_ordinates(thinner, angle, ground=SOIL_ALBEDO)
        streams = compute_two_stream_albedo(plain, thinner, angle)
        table = {
            "pack": [name] * len(WAVELENGTHS_NM),
            "incidence": np.full(len(WAVELENGTHS_NM), angle),
            "nm": WAVELENGTHS_NM,
            "ours": ours.reflectance,
            "kept": loose.reflectance,
            "ordinates": ordinates.reflectance,
            "TARTES": streams,
            "ours - kept": ours.reflectance - loose.reflectance,
            "kept - ordinates": loose.reflectance - ordinates.reflectance,
            "stderr": np.hypot(loose.reflectance_stderr, ordinates.reflectance_stderr),
            "ordinates - TARTES": ordinates.reflectance - streams,
        }
        tables.append(pd.DataFrame({key: np.asarray(value) for key, value in table.items()}))
    return pd.concat(tables)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--max-stderr", type=float, default=0.001)
    given = parser.parse_args()
    found = pd.concat(
        compare_snowpack(name, i, given.max_stderr) for i, name in enumerate(SNOWPACKS)
    )
    print(found.round(4).to_string(index=False))
    steps = ["ours - kept", "kept - ordinates", "ordinates - TARTES"]
    summary = found.groupby(["pack", "incidence"], sort=False)[steps].agg(["mean", "min", "max"])
    print(summary.round(4).to_string())


if __name__ == "__main__":
    main()
