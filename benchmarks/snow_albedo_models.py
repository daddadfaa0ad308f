"""Albedo of natural snow compared with TARTES and with asymptotic theory (snowoptics).

Twelve cases of surface area, layers, soot, soil, angle and illumination.  TARTES runs twice, with
its default grain shape (B = n², g 0.82) and with that of `splits.media.snow` (with
diffraction, as in TARTES, g is (1 + g)/2).  Asymptotic theory (Kokhanovsky & Zege 2004) is for deep
clean snow with weak absorption.

Printed are the mean and the largest difference from `splits` over `WAVELENGTHS_NM`, with its
standard error, and the reduction of the albedo by soot at 500 nm.  Soot within grains absorbs B
times as much as between them, where it is in TARTES.

    python benchmarks/snow_albedo_models.py [TABLE.csv] [--max-stderr 0.002]
"""

import argparse
import math
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import snowoptics
import tartes

import splits
from splits.core.escaping import write_data_frame
from splits.materials.impurities import make_impurities
from splits.media.snow import NATURAL_GRAIN_SHAPE

WAVELENGTHS_NM = np.array(
    [400.0, 500.0, 600.0, 700.0, 800.0, 900.0, 1000.0, 1100.0, 1200.0, 1300.0, 1500.0, 1700.0]
)
ASYMPTOTIC_NM = (700.0, 1100.0)
"""Range in which the absorption of ice is relevant, but weak enough for asymptotic theory."""


class SnowpackCase(NamedTuple):
    """Layers of (surface area, density, depth, soot in ng/g) over a ground, and illumination."""

    layers: list[tuple[float, float, float, float]]
    ground: float
    incidence: float | str

    def simulate_albedo(
        self, max_stderr: float, impurities_in: str = "ice"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the reflectance by `splits` and its error, with soot in ice or in pores."""
        layers = [
            splits.Snow.natural(
                specific_surface_area_m2_kg=area, density_kg_m3=density, depth_m=depth,
                impurities_ng_g={"black_carbon": soot} if soot else {}, impurities_in=impurities_in,
            )
            for area, density, depth, soot in self.layers
        ]  # fmt: skip
        stack = splits.Stack(layers, ground=self.ground)
        run = splits.spectrophotometer(stack, WAVELENGTHS_NM, self.incidence, max_stderr)
        return run.reflectance.values, run.reflectance_stderr.values

    def compute_tartes_albedo(self, **shape: Any) -> np.ndarray:
        """Return the albedo of TARTES."""
        area, density, depth, soot = (np.array(column) for column in zip(*self.layers, strict=True))
        beam = self.incidence != "diffuse"
        return np.asarray(
            tartes.albedo(
                1e-9 * WAVELENGTHS_NM, area, density, np.where(np.isinf(depth), 1e3, depth),
                impurities=1e-9 * soot, soilalbedo=self.ground, dir_frac=float(beam),
                sza=float(self.incidence) if beam else 0.0, **shape,
            )
        )  # fmt: skip

    def compute_asymptotic_albedo(self) -> np.ndarray | None:
        """Return the albedo of asymptotic theory if the snowpack is deep and clean."""
        area, _, depth, soot = self.layers[0]
        if math.isfinite(depth) or soot:
            return None
        shape = {"B": NATURAL_GRAIN_SHAPE.absorption_enhancement, "g": ASYMMETRY_WITH_DIFFRACTION}
        if self.incidence == "diffuse":
            return np.asarray(snowoptics.albedo_diffuse_KZ04(1e-9 * WAVELENGTHS_NM, area, **shape))
        angle = math.radians(float(self.incidence))
        return np.asarray(
            snowoptics.albedo_direct_KZ04(1e-9 * WAVELENGTHS_NM, angle, area, **shape)
        )


ASYMMETRY_WITH_DIFFRACTION = 0.5 * (1.0 + NATURAL_GRAIN_SHAPE.asymmetry_parameter)
INFINITE_DEPTH = math.inf
TWO_LAYERS = [(40.0, 150.0, 0.05, 0.0), (12.0, 350.0, 0.2, 0.0)]
CASES = {
    **{
        f"{area:g} m2/kg, deep, {'diffuse' if light == 'diffuse' else '53°'}": SnowpackCase(
            [(area, 300.0, INFINITE_DEPTH, 0.0)], 0.0, light
        )
        for area in (5.0, 20.0, 60.0)
        for light in (53.0, "diffuse")
    },
    **{
        f"two layers on soil, {angle:g}°": SnowpackCase(TWO_LAYERS, 0.2, angle)
        for angle in (0.0, 53.0, 75.0)
    },
    "20 m2/kg, deep, diffuse, 50 ng/g soot": SnowpackCase(
        [(20.0, 300.0, INFINITE_DEPTH, 50.0)], 0.0, "diffuse"
    ),
    "20 m2/kg, deep, diffuse, 500 ng/g soot": SnowpackCase(
        [(20.0, 300.0, INFINITE_DEPTH, 500.0)], 0.0, "diffuse"
    ),
    "two sooty layers on soil, diffuse": SnowpackCase(
        [(*one[:3], 50.0) for one in TWO_LAYERS], 0.2, "diffuse"
    ),
}
SPLITS_SHAPE = {
    "shape_parameterization": "constant",
    "B0": NATURAL_GRAIN_SHAPE.absorption_enhancement,
    "g0": ASYMMETRY_WITH_DIFFRACTION,
}


def compare_models(name: str, max_stderr: float) -> pd.DataFrame:
    """Print the differences of the other models from `splits`, and return all albedos."""
    snowpack = CASES[name]
    albedo, error = snowpack.simulate_albedo(max_stderr)
    table = pd.DataFrame({"case": name, "nm": WAVELENGTHS_NM, "splits": albedo, "stderr": error})
    table["TARTES"] = snowpack.compute_tartes_albedo()
    table["TARTES, B and g of splits"] = snowpack.compute_tartes_albedo(**SPLITS_SHAPE)
    asymptotic = snowpack.compute_asymptotic_albedo()
    if asymptotic is not None:
        weakly_absorbing = (ASYMPTOTIC_NM[0] <= WAVELENGTHS_NM) & (
            ASYMPTOTIC_NM[1] >= WAVELENGTHS_NM
        )
        table["asymptotic"] = np.where(weakly_absorbing, asymptotic, np.nan)
    summaries = []
    for model in table.columns[4:]:
        difference = (table[model] - table.splits).dropna()
        summaries.append(
            f"{model} {difference.mean():+.3f} "
            f"(up to {difference.iloc[difference.abs().argmax()]:+.3f})"
        )
    print(f"{name:40s} ± {error.max():.3f}: {'; '.join(summaries)}", flush=True)
    return table


def report_soot(tables: dict[str, pd.DataFrame], max_stderr: float) -> None:
    """Print the reduction of the albedo by soot at 500 nm, and the absorption per mass of soot."""
    clean = tables["20 m2/kg, deep, diffuse"].set_index("nm").loc[500.0]
    for amount in ("50", "500"):
        name = f"20 m2/kg, deep, diffuse, {amount} ng/g soot"
        dirty = tables[name].set_index("nm").loc[500.0]
        reduction = {
            n: clean[n] - dirty[n] for n in ("splits", "TARTES", "TARTES, B and g of splits")
        }
        pores = CASES[name].simulate_albedo(max_stderr, "pores")[0][
            list(WAVELENGTHS_NM).index(500.0)
        ]
        reduction["splits, in pores"] = clean.splits - pores
        error = math.hypot(clean.stderr, dirty.stderr)
        summary = ", ".join(f"{label} {value:.4f}" for label, value in reduction.items())
        print(f"{amount} ng/g soot at 500 nm: {summary} (splits ± {error:.4f})")
    absorption = (
        make_impurities({"black_carbon": 1.0}, {})[0].compute_absorption_per_kg_ice(
            np.array([500.0])
        )[0]
        * 1e9
    )
    tartes_absorption = float(np.ravel(tartes.impurities.SootSNICAR3().MAE(5e-7))[0])
    print(
        f"absorption per mass at 500 nm: splits {absorption:.0f} m2/kg, "
        f"TARTES {tartes_absorption:.0f} m2/kg"
    )


def main() -> None:
    """Print all comparisons, and write the table if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?")
    parser.add_argument("--max-stderr", type=float, default=0.002)
    arguments = parser.parse_args()
    tables = {name: compare_models(name, arguments.max_stderr) for name in CASES}
    report_soot(tables, arguments.max_stderr)
    if arguments.table:
        write_data_frame(pd.concat(tables.values()), arguments.table)


if __name__ == "__main__":
    main()
