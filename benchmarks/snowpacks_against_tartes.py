"""Dense snowpacks of dry snow compared with two theories that use the same single scattering.

Discrete ordinates use the whole phase function of the grains, TARTES two streams and an asymmetry
parameter.  Both treat grains as points; the displacement of light within them is included in the
optical thickness (`correct_dense_packing`).  The difference to TARTES has three parts:

    splits − keep       effect of the rules of a dense medium, by which grains that overlap a
                        boundary or the previous segment are rejected;
    keep − ordinates    other effects of density;
    ordinates − TARTES  effect of two streams, and of an asymmetry in place of a phase function.

With diffraction, as in TARTES, extinction is twice the cross section, the albedo is (1 + ω)/2 and
the asymmetry (1 + ω g)/(1 + ω).  The delta-Eddington approximation removes the diffraction peak.
The B of the grains, 1 − ω' = 2 B γ/(ρ SSA) for weak absorption γ, is printed for comparison.

    python benchmarks/snowpacks_against_tartes.py [--max-stderr 0.001]
"""

import argparse
from typing import Any

import numpy as np
import pandas as pd
import tartes
import xarray as xr

import splits
from splits.analysis.theory.spectra import correct_dense_packing, solve_discrete_ordinates
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
    "2 cm of dense coarse": [{**COARSE_GRAINS, "density_kg_m3": 550.0, "depth_m": 0.02}],
}
SOIL_ALBEDO = 0.2
INCIDENCE_DEG = (30.0, 60.0)


def compute_shape(snow: splits.Snow, optics: xr.Dataset) -> pd.DataFrame:
    """Return B and g by wavelength, with diffraction."""
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
    """Return the albedo of a snowpack by the two-stream solver of TARTES."""
    albedo = np.stack([one.single_scattering_albedo.values for one in optics], axis=-1)
    asymmetry = np.stack([one.asymmetry_parameter.values for one in optics], axis=-1)
    extinction = np.stack([one.extinction.values for one in optics], axis=-1)
    fluxes = [
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
    return np.array(fluxes).ravel()


def compare_snowpack(name: str, number: int, max_stderr: float) -> pd.DataFrame:
    """Print B and g of the layers of a snowpack, and return its reflectance by four methods."""
    snowpack_layers = [splits.Snow(**one) for one in SNOWPACKS[name]]
    overlapping_layers = [
        splits.Snow(**one, interpretation=KEEP_OVERLAPS) for one in SNOWPACKS[name]
    ]
    grain_optics = [
        splits.single_scattering(one, WAVELENGTHS_NM, seed=10 * number + i)
        for i, one in enumerate(snowpack_layers)
    ]
    for layer, optics in zip(snowpack_layers, grain_optics, strict=True):
        print(f"{name}: {layer.density_kg_m3:g} kg/m3")
        print(compute_shape(layer, optics).T.round(3).to_string())
    corrected_optics = [correct_dense_packing(one) for one in grain_optics]
    tables = []
    for angle in INCIDENCE_DEG:
        result, keep_result = (
            splits.spectrophotometer(
                splits.Stack(layers, ground=SOIL_ALBEDO), WAVELENGTHS_NM, angle, max_stderr, seed
            )
            for seed, layers in ((7, snowpack_layers), (8, overlapping_layers))
        )
        ordinates = solve_discrete_ordinates(corrected_optics, angle, ground=SOIL_ALBEDO)
        streams = compute_two_stream_albedo(snowpack_layers, corrected_optics, angle)
        table = {
            "snowpack": [name] * len(WAVELENGTHS_NM),
            "incidence": np.full(len(WAVELENGTHS_NM), angle),
            "nm": WAVELENGTHS_NM,
            "splits": result.reflectance,
            "keep": keep_result.reflectance,
            "ordinates": ordinates.reflectance,
            "TARTES": streams,
            "splits - keep": result.reflectance - keep_result.reflectance,
            "keep - ordinates": keep_result.reflectance - ordinates.reflectance,
            "stderr": np.hypot(keep_result.reflectance_stderr, ordinates.reflectance_stderr),
            "ordinates - TARTES": ordinates.reflectance - streams,
        }
        tables.append(pd.DataFrame({key: np.asarray(value) for key, value in table.items()}))
    return pd.concat(tables)


def main() -> None:
    """Print the reflectances and a summary of their differences."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--max-stderr", type=float, default=0.001)
    arguments = parser.parse_args()
    results = pd.concat(
        compare_snowpack(name, i, arguments.max_stderr) for i, name in enumerate(SNOWPACKS)
    )
    print(results.round(4).to_string(index=False))
    differences = ["splits - keep", "keep - ordinates", "ordinates - TARTES"]
    summary = results.groupby(["snowpack", "incidence"], sort=False)[differences].agg(
        ["mean", "min", "max"]
    )
    print(summary.round(4).to_string())


if __name__ == "__main__":
    main()
