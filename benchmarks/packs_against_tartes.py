"""Dense packs of dry snow against two theories of radiative transfer, with our single scattering.

Discrete ordinates take the grains' whole phase function; TARTES takes two streams, and two numbers
that say most of single scattering, B and g.  To both the grains are far apart.  So

    ours − ordinates    is what density does: a grain is met at its surface, and has a size;
    ordinates − TARTES  is what two streams do, and an asymmetry in place of a phase function.

With diffraction, as TARTES counts, extinction is twice that of the cross-section, g' = (1 + g)/2
and 1 − ω' = (1 − ω)/2; B follows from ω', and specific surface area from the extinction.

    python benchmarks/packs_against_tartes.py [--max-stderr 0.001]
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd
import tartes
import xarray as xr

import splits
from splits.analysis.ordinates import discrete_ordinates
from splits.instruments.scenes import constants_of

WAVELENGTHS = np.array([450.0, 600.0, 750.0, 900.0, 1000.0, 1100.0, 1300.0, 1500.0, 1700.0, 2200.0])
ICE_KG_M3 = 917.0
FINE = {"grain_size_um": (100.0, 200.0), "saturation": 0.0}
COARSE = {"grain_size_um": (400.0, 800.0), "saturation": 0.0}
PACKS = {
    "5 cm fine on 30 cm coarse": (
        [{**FINE, "density_kg_m3": 150.0, "depth_m": 0.05},
         {**COARSE, "density_kg_m3": 350.0, "depth_m": 0.3}], 0.2),
    "1 cm fine on 4 cm coarse on soil": (
        [{**FINE, "density_kg_m3": 150.0, "depth_m": 0.01},
         {**COARSE, "density_kg_m3": 350.0, "depth_m": 0.04}], 0.2),
    "2 cm of packed coarse on soil": ([{**COARSE, "density_kg_m3": 550.0, "depth_m": 0.02}], 0.2),
}  # fmt: skip
INCIDENCE = (30.0, 60.0)
W0 = 0.0611
"""Reflection of light at ice that TARTES takes for n = 1.3, see `shape_of`."""


def shape_of(snow: splits.Snow, optics: xr.Dataset) -> pd.DataFrame:
    """Return over wavelength what TARTES wants to know of snow: B, g, and surface area (m²/kg).

    Its 1 − ω' = (1 − W)/2 (1 − exp(−2/3 B c/(1 − W))), c = 24 π k/(ρ λ SSA), is solved for B.
    """
    index = constants_of(snow, WAVELENGTHS).indices[:, snow.materials().index("ice")]
    ssa = 4.0 * optics.extinction.values / snow.density_kg_m3
    left = 1.0 - W0 - 0.17 * (index.real - 1.3)
    c = 24.0 * np.pi * index.imag / (ICE_KG_M3 * WAVELENGTHS * 1e-9 * ssa)
    lost = (1.0 - optics.single_scattering_albedo.values) / left
    b = -1.5 * left / c * np.log1p(-np.minimum(lost, 1.0 - 1e-9))
    g = 0.5 * (1.0 + optics.asymmetry_parameter.values)
    return pd.DataFrame({"B": b, "g": g, "ssa": ssa, "n": index.real, "k": index.imag})


def two_streams(layers: list[splits.Snow], shapes: list[pd.DataFrame], angle: float, soil: float):
    """Return the albedo of a pack by TARTES, wavelength by wavelength: B and g depend on it."""
    density = [one.density_kg_m3 for one in layers]
    thickness = [one.depth_m for one in layers]
    return np.array(
        [
            tartes.tartes(
                wavelength * 1e-9,
                [one.ssa[i] for one in shapes],
                density,
                thickness,
                shape_parameterization="constant",
                g0=np.array([one.g[i] for one in shapes]),
                B0=np.array([one.B[i] for one in shapes]),
                refrac_index=(shapes[0].n[i], shapes[0].k[i]),
                soilalbedo=soil,
                dir_frac=1.0,
                mudir=np.cos(np.radians(angle)),
            )
            for i, wavelength in enumerate(WAVELENGTHS)
        ]
    ).ravel()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--max-stderr", type=float, default=0.001)
    given = parser.parse_args()
    rows = []
    for number, (name, (settings, soil)) in enumerate(PACKS.items()):
        layers = [splits.Snow(**one) for one in settings]
        optics = [
            splits.single_scattering(one, WAVELENGTHS, seed=10 * number + i)
            for i, one in enumerate(layers)
        ]
        shapes = [shape_of(one, o) for one, o in zip(layers, optics, strict=True)]
        for one, layer in zip(shapes, layers, strict=True):
            print(f"{name}: {layer.density_kg_m3:g} kg/m3, {one.ssa[0]:.1f} m2/kg")
            shape = one.set_axis(WAVELENGTHS.astype(int))[["B", "g"]].T
            print(shape.round(3).to_string())
        for angle in INCIDENCE:
            ordinates = discrete_ordinates(optics, angle, ground=soil)
            stack = splits.Stack(layers, ground=soil)
            ours = splits.spectrophotometer(stack, WAVELENGTHS, angle, given.max_stderr, seed=7)
            told = two_streams(layers, shapes, angle, soil)
            table = {
                "pack": name,
                "incidence": angle,
                "wavelength": WAVELENGTHS,
                "ours": ours.reflectance.values,
                "stderr": ours.reflectance_stderr.values,
                "ordinates": ordinates.reflectance.values,
                "their stderr": ordinates.reflectance_stderr.values,
                "TARTES": told,
                "ours - ordinates": (ours.reflectance - ordinates.reflectance).values,
                "ordinates - TARTES": ordinates.reflectance.values - told,
            }
            rows.append(pd.DataFrame(table))
    found = pd.concat(rows)
    print(found.round(4).to_string(index=False))
    columns = ["ours - ordinates", "ordinates - TARTES"]
    summary = found.groupby(["pack", "incidence"], sort=False)[columns].agg(["mean", "min", "max"])
    print(summary.round(4).to_string())


if __name__ == "__main__":
    main()
