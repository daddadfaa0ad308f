"""Other models and exact solutions: TARTES, asymptotic theory, and plane-parallel layers.

python benchmarks/other_models.py {albedo,soot,snowpacks,exact_layers} [--table TABLE.csv]
"""

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import snowoptics
import tartes
import xarray as xr
from command import run_command

import splits
from splits.analysis.theory.spectra import correct_dense_packing, solve_discrete_ordinates
from splits.materials.impurities import make_impurities
from splits.media.snow import NATURAL_GRAIN_SHAPE

TESTS = Path(__file__).parents[1] / "tests"
WAVELENGTHS_NM = np.array(
    [400.0, 500.0, 600.0, 700.0, 800.0, 900.0, 1000.0, 1100.0, 1200.0, 1300.0, 1500.0, 1700.0]
)
ASYMPTOTIC_NM = (700.0, 1100.0)
"""Range in which the absorption of ice is relevant, but weak enough for asymptotic theory."""


class SnowpackCase(NamedTuple):
    """Layers of (surface area, density, depth, soot in ng/g), ground if not deep, illumination."""

    layers: list[tuple[float, float, float, float]]
    ground: float | None
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
        run = splits.spectrophotometer(stack, WAVELENGTHS_NM, self.incidence, max_stderr=max_stderr)
        return run.reflectance.values, run.reflectance_stderr.values

    def compute_tartes_albedo(self, **shape: Any) -> np.ndarray:
        """Return the albedo of TARTES."""
        area, density, depth, soot = (np.array(column) for column in zip(*self.layers, strict=True))
        beam = self.incidence != "diffuse"
        return np.asarray(
            tartes.albedo(
                1e-9 * WAVELENGTHS_NM, area, density, np.where(np.isinf(depth), 1e3, depth),
                impurities=1e-9 * soot, soilalbedo=self.ground or 0.0, dir_frac=float(beam),
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
SNOWPACK_CASES = {
    **{
        f"{area:g} m2/kg, deep, {'diffuse' if light == 'diffuse' else '53°'}": SnowpackCase(
            [(area, 300.0, INFINITE_DEPTH, 0.0)], None, light
        )
        for area in (5.0, 20.0, 60.0)
        for light in (53.0, "diffuse")
    },
    **{
        f"two layers on soil, {angle:g}°": SnowpackCase(TWO_LAYERS, 0.2, angle)
        for angle in (0.0, 53.0, 75.0)
    },
    "20 m2/kg, deep, diffuse, 50 ng/g soot": SnowpackCase(
        [(20.0, 300.0, INFINITE_DEPTH, 50.0)], None, "diffuse"
    ),
    "20 m2/kg, deep, diffuse, 500 ng/g soot": SnowpackCase(
        [(20.0, 300.0, INFINITE_DEPTH, 500.0)], None, "diffuse"
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


def albedo(max_stderr: float = 0.002) -> Iterator[dict[str, Any]]:
    """Albedo of natural snow compared with TARTES and with asymptotic theory (snowoptics).

    Twelve cases of surface area, layers, soot, soil, angle and illumination.  TARTES runs with its
    default grain shape (B = n², g 0.82) and with that of `splits.media.snow` (with
    diffraction, as in TARTES, g is (1 + g)/2).  Asymptotic theory (Kokhanovsky & Zege 2004) is for
    deep clean snow with weak absorption.  The mean and the largest difference from `splits` over
    `WAVELENGTHS_NM`, and its largest standard error.
    """
    low, high = ASYMPTOTIC_NM
    for name, snowpack in SNOWPACK_CASES.items():
        simulated, error = snowpack.simulate_albedo(max_stderr)
        others = {
            "TARTES": snowpack.compute_tartes_albedo(),
            "TARTES, B and g of splits": snowpack.compute_tartes_albedo(**SPLITS_SHAPE),
        }
        asymptotic = snowpack.compute_asymptotic_albedo()
        if asymptotic is not None:
            is_weak = (low <= WAVELENGTHS_NM) & (high >= WAVELENGTHS_NM)
            others["asymptotic"] = np.where(is_weak, asymptotic, np.nan)
        for model, values in others.items():
            difference = (values - simulated)[np.isfinite(values)]
            yield {
                "case": name, "model": model, "mean_difference": difference.mean(),
                "largest": difference[np.abs(difference).argmax()], "stderr": error.max(),
            }  # fmt: skip


def soot(max_stderr: float = 0.002) -> Iterator[dict[str, Any]]:
    """Reduction of the albedo by soot at 500 nm, and the absorption per mass of soot.

    Soot within grains absorbs B times as much as between them, where it is in TARTES.
    """
    position = list(WAVELENGTHS_NM).index(500.0)
    own = make_impurities({"black_carbon": 1.0}, {})[0].compute_absorption_per_kg_ice(
        np.array([500.0])
    )
    absorption = {
        "splits": 1e9 * own[0],
        "TARTES": float(np.ravel(tartes.impurities.SootSNICAR3().MAE(5e-7))[0]),
    }
    clean = SNOWPACK_CASES["20 m2/kg, deep, diffuse"]
    clean_albedo, clean_error = clean.simulate_albedo(max_stderr)
    for amount in (50, 500):
        dirty = SNOWPACK_CASES[f"20 m2/kg, deep, diffuse, {amount} ng/g soot"]
        for where in ("ice", "pores"):
            reduced, error = dirty.simulate_albedo(max_stderr, where)
            yield {
                "soot_ng_g": amount, "model": f"splits, in {where}",
                "reduction": (clean_albedo - reduced)[position],
                "stderr": math.hypot(clean_error[position], error[position]),
                "absorption_m2_kg": absorption["splits"],
            }  # fmt: skip
        for label, shape in (("TARTES", {}), ("TARTES, B and g of splits", SPLITS_SHAPE)):
            reduction = clean.compute_tartes_albedo(**shape) - dirty.compute_tartes_albedo(**shape)
            yield {
                "soot_ng_g": amount, "model": label, "reduction": reduction[position],
                "absorption_m2_kg": absorption["TARTES"],
            }  # fmt: skip


SNOWPACK_WAVELENGTHS_NM = np.array(
    [450.0, 600.0, 750.0, 900.0, 1000.0, 1100.0, 1300.0, 1500.0, 1700.0, 2200.0]
)
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
        for i in range(len(SNOWPACK_WAVELENGTHS_NM))
    ]
    return np.array(fluxes).ravel()


def compare_snowpack(name: str, number: int, max_stderr: float) -> pd.DataFrame:
    """Return the reflectance of a snowpack by four methods, with B and g of its layers."""
    snowpack_layers = [splits.Snow(**one) for one in SNOWPACKS[name]]
    overlapping_layers = [
        splits.Snow(**one, interpretation=KEEP_OVERLAPS) for one in SNOWPACKS[name]
    ]
    grain_optics = [
        splits.single_scattering(one, SNOWPACK_WAVELENGTHS_NM, seed=10 * number + i)
        for i, one in enumerate(snowpack_layers)
    ]
    corrected_optics = [correct_dense_packing(one) for one in grain_optics]
    tables = []
    for angle in INCIDENCE_DEG:
        result, keep_result = (
            splits.spectrophotometer(
                splits.Stack(layers, ground=SOIL_ALBEDO),
                SNOWPACK_WAVELENGTHS_NM,
                angle,
                max_stderr=max_stderr,
                seed=seed,
            )
            for seed, layers in ((7, snowpack_layers), (8, overlapping_layers))
        )
        ordinates = solve_discrete_ordinates(corrected_optics, angle, ground=SOIL_ALBEDO)
        streams = compute_two_stream_albedo(snowpack_layers, corrected_optics, angle)
        table = {
            "snowpack": [name] * len(SNOWPACK_WAVELENGTHS_NM),
            "incidence": np.full(len(SNOWPACK_WAVELENGTHS_NM), angle),
            "nm": SNOWPACK_WAVELENGTHS_NM,
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


def snowpacks(max_stderr: float = 0.001) -> Iterator[dict[str, Any]]:
    """Dense snowpacks of dry snow compared with two theories that use the same single scattering.

    Discrete ordinates use the whole phase function of the grains, TARTES two streams and an
    asymmetry parameter.  Both treat grains as points; the displacement of light within them is
    included in the optical thickness (`correct_dense_packing`).  The difference to TARTES has three
    parts:

    splits − keep       effect of the rules of a dense medium, by which grains that overlap a
                        boundary or the previous segment are rejected;
    keep − ordinates    other effects of density;
    ordinates − TARTES  effect of two streams, and of an asymmetry in place of a phase function.

    With diffraction, as in TARTES, extinction is twice the cross section, the albedo is (1 + ω)/2
    and the asymmetry (1 + ω g)/(1 + ω).  The delta-Eddington approximation removes the diffraction
    peak.
    """
    for number, name in enumerate(SNOWPACKS):
        yield from compare_snowpack(name, number, max_stderr).to_dict("records")


def exact_layers(max_stderr: float = 2e-4) -> Iterator[dict[str, Any]]:
    """Particle layers compared with exact plane-parallel solutions.

    The cases and their exact values are in tests/physics/reference/plane_parallel.csv.  Fails where
    the differences are too large for the errors.
    """
    sys.path[:0] = [str(TESTS / "physics"), str(TESTS / "statistics")]
    from chi2 import judge_z
    from test_layer_exact import compare_with_reference

    start = time.perf_counter()
    z, certain = compare_with_reference(max_stderr)
    label = f"reflectance and transmittance, {certain} values certain"
    judge_z(z, label, independent=(z.size + 1) // 2)
    yield {
        "values": z.size, "certain": certain, "rms_z": np.sqrt(np.mean(z**2)),
        "largest_z": np.abs(z).max(), "seconds": time.perf_counter() - start,
    }  # fmt: skip


if __name__ == "__main__":
    run_command(albedo, soot, snowpacks, exact_layers)
