"""Laws of a dense medium of grains, by the rule for grains that overlap.

    python benchmarks/packing_rules.py [--quick] [TABLE.csv]

The grains have the sizes and shapes of natural snow of 20 m²/kg.  Rules are the interpretations of
grains that overlap a boundary or the previous segment (`reject`, `skip`, `keep`, the
rest as in the set ``geometric``, which has `skip`), `point`, the set ``radiative_transfer`` of
`splits.Snow.natural`, and the sets of the papers.  The laws:

similarity     Reflectance of a half-space at 1300 nm minus that of the same grains at 10 kg/m³,
               where rules have no effect: 0 at every density, for beams and for diffuse light.
ordinates      The same minus discrete ordinates with the single scattering of the same grains, and
               transmittance of 5 cm at 700 nm minus theirs (`correct_dense_packing`).
reciprocity    BRDF of 5 cm at 1000 nm, averaged over azimuth, from 30° to 70°, divided by that from
               70° to 30°: 1.
enhancement    Mean path in a grain under isotropic light, divided by n² times its mean chord: 1 in
               equilibrium.  It depends on the facets of the grains only, not on the rule.
mean path      In 2 cm with weak absorption, under diffuse light, divided by 2 H (1 − f + B f): 1
               (f the volume fraction of ice, B = n² times the enhancement; Blanco & Fournier 2003,
               Europhysics Letters 61, 168).
mass           Path in ice of index 1, per depth and volume fraction, at normal incidence: 1.

Every number is printed with its standard error.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import splits
from splits.analysis.theory.spectra import correct_dense_packing, solve_discrete_ordinates
from splits.core.escaping import write_data_frame

GEOMETRIC = "geometric"
OVERLAP_RULES: dict[str, Any] = {
    rule: {"set": GEOMETRIC, "overlap_with_previous_segment": rule, "overlap_with_boundary": rule}
    for rule in ("reject", "skip", "keep")
} | {
    "point": "radiative_transfer",
    "splits_2007": "splits_2007",
    "splitsnow_2021": "splitsnow_2021",
}
DENSITIES_KG_M3 = (10.0, 100.0, 300.0, 500.0, 550.0)
INCIDENCES_DEG: tuple[float | str, ...] = (0.0, 30.0, 60.0, 75.0, 80.0, "diffuse")
ICE_INDEX = 1.31
KEY_COLUMNS = ("rule", "density_kg_m3", "law", "light")
ZERO_LAWS = ("similarity", "ordinates R", "ordinates T")
"""Laws with expected value 0; that of the others is 1."""
WEAK_ABSORPTION_PER_M = 0.03
"""Absorption coefficient (1/m) of all materials for the mean path."""


@dataclass(frozen=True)
class PackingEffort:
    """Standard error of reflectances, relative standard error of BRDFs, rays for mean paths."""

    stderr: float = 0.0007
    brdf: float = 0.004
    rays: int = 2_000_000


def make_snow(rule: str, density: float, **settings: Any) -> splits.Snow:
    """Return natural snow under a rule."""
    return splits.Snow.natural(
        specific_surface_area_m2_kg=20.0,
        density_kg_m3=density,
        interpretation=OVERLAP_RULES[rule],
        **settings,
    )


@cache
def reflect_dilute(rule: str, incidence: float | str, stderr: float) -> xr.Dataset:
    """Return the spectrum of the dilute half-space."""
    return splits.spectrophotometer(
        make_snow(rule, 10.0), [1300.0], incidence, stderr, 20, solver="monte_carlo"
    )


def measure_similarity(
    rule: str, density: float, effort: PackingEffort
) -> Iterator[tuple[Any, ...]]:
    """Yield reflectances of a half-space minus the dilute one and minus discrete ordinates."""
    snow = make_snow(rule, density)
    deep = make_snow(rule, density, depth_m=1e4 / density)
    optics = correct_dense_packing(splits.single_scattering(deep, [1300.0], rays=500_000))
    for number, incidence in enumerate(INCIDENCES_DEG):
        result = splits.spectrophotometer(
            snow, [1300.0], incidence, effort.stderr, 10 + number, solver="monte_carlo"
        )
        other = reflect_dilute(rule, incidence, effort.stderr)
        theory = solve_discrete_ordinates(optics, incidence)
        for law, expected in (("similarity", other), ("ordinates R", theory)):
            difference = (result.reflectance - expected.reflectance).item()
            error = np.hypot(result.reflectance_stderr, expected.reflectance_stderr).item()
            yield law, incidence, difference, error


def measure_transmittance(
    rule: str, density: float, effort: PackingEffort
) -> Iterator[tuple[Any, ...]]:
    """Yield transmittances minus discrete ordinates."""
    snow = make_snow(rule, density, depth_m=0.05)
    optics = correct_dense_packing(splits.single_scattering(snow, [700.0], rays=500_000))
    for number, incidence in enumerate((0.0, 75.0)):
        result = splits.spectrophotometer(
            snow, [700.0], incidence, effort.stderr, 30 + number, solver="monte_carlo"
        )
        theory = solve_discrete_ordinates(optics, incidence)
        difference = (result.transmittance - theory.transmittance).item()
        error = np.hypot(result.transmittance_stderr, theory.transmittance_stderr).item()
        yield "ordinates T", incidence, difference, error


def measure_reciprocity(
    rule: str, density: float, effort: PackingEffort
) -> Iterator[tuple[Any, ...]]:
    """Yield the ratio of azimuthally averaged BRDFs from 30° to 70° and back, by angular bins."""
    snow = make_snow(rule, density, depth_m=0.05)
    bins = splits.goniophotometer(snow, [1000.0], 0.0, 1000, estimator="bins").polar.values
    near = [float(bins[np.abs(bins - angle).argmin()]) for angle in (30.0, 70.0)]
    means, errors = [], []
    for incidence, view in (near, near[::-1]):
        result = splits.goniophotometer(
            snow, [1000.0], incidence, relative_stderr=6.0 * effort.brdf, seed=round(incidence),
            estimator="bins",
        )  # fmt: skip
        ring = result.squeeze().sel(polar=view)
        means.append(float(ring.brdf.mean()))
        # Bins count different rays, so their errors are independent.
        error = float(np.sqrt((ring.brdf_stderr**2).sum())) / ring.sizes["azimuth"]
        errors.append(error / means[-1])
    ratio = means[0] / means[1]
    yield "reciprocity", "30-70", ratio, ratio * float(np.hypot(*errors))


def measure_paths(rule: str, density: float, effort: PackingEffort) -> Iterator[tuple[Any, ...]]:
    """Yield the ratios of the mean path, and of the path in ice of index 1, to their laws."""
    weakly_absorbing = make_snow(rule, density, depth_m=0.02)
    fraction, depth = weakly_absorbing.ice_fraction, weakly_absorbing.depth_m
    indices = {"ice": _make_weak_index(ICE_INDEX, WEAK_ABSORPTION_PER_M)}
    optics = splits.single_scattering(
        make_snow(rule, density, depth_m=depth, refractive_index=indices), [1000.0], moments=1,
        rays=1_000_000,
    ).squeeze()  # fmt: skip
    per_path = weakly_absorbing.attenuation_per_m / (WEAK_ABSORPTION_PER_M * ICE_INDEX**2)
    enhancement = per_path * (1.0 - optics.single_scattering_albedo.item())
    error = per_path * optics.single_scattering_albedo_stderr.item()
    yield "enhancement", "diffuse", enhancement, error
    law = 2.0 * depth * (1.0 - fraction + enhancement * ICE_INDEX**2 * fraction)
    for name, light, index, in_air, length in (
        ("mean path", "diffuse", ICE_INDEX, 1.0, law), ("mass", 0.0, 1.0, 0.0, depth * fraction),
    ):  # fmt: skip
        # Absorptance divided by the coefficient is too small by <L²>/2 times the coefficient.  Two
        # runs with the same paths and different coefficients eliminate this.
        ratios = []
        for alpha in (WEAK_ABSORPTION_PER_M, 2.0 * WEAK_ABSORPTION_PER_M):
            indices = {
                "ice": _make_weak_index(index, alpha),
                "air": _make_weak_index(1.0, in_air * alpha),
            }
            snow = make_snow(rule, density, depth_m=depth, refractive_index=indices)
            result = splits.spectrophotometer(
                snow, [1000.0], light, 1e-6, 40, max_rays=effort.rays, solver="monte_carlo"
            ).squeeze()
            ratios.append(result[["absorptance", "absorptance_stderr"]] / (alpha * length))
        mean = 2.0 * ratios[0].absorptance - ratios[1].absorptance
        yield name, light, mean.item(), ratios[0].absorptance_stderr.item()


def _make_weak_index(index: float, absorption: float) -> dict[str, list[float]]:
    k = absorption * 1e-6 / (4.0 * np.pi)
    return {"wavelength_nm": [500.0, 2000.0], "n": [index, index], "k": [k, k]}


MEASURES = (measure_similarity, measure_transmittance, measure_reciprocity, measure_paths)


def main() -> None:
    """Print all results, and write the summary table if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?")
    parser.add_argument("--quick", action="store_true", help="larger errors, two densities")
    arguments = parser.parse_args()
    effort = PackingEffort(0.004, 0.03, 100_000) if arguments.quick else PackingEffort()
    densities = (10.0, 500.0) if arguments.quick else DENSITIES_KG_M3
    rows = []
    for rule in OVERLAP_RULES:
        for density in densities:
            rows += [
                (rule, density, *row) for one in MEASURES for row in one(rule, density, effort)
            ]
            print(f"{rule} at {density:g} kg/m3 done", flush=True)
    result = pd.DataFrame(rows, columns=[*KEY_COLUMNS, "value", "stderr"])
    table = make_summary_table(result)
    if arguments.table:
        write_data_frame(table, arguments.table)
    print(result.round(4).to_string(index=False))
    print(table.to_string(index=False))


def make_summary_table(results: pd.DataFrame) -> pd.DataFrame:
    """Return, by rule, the laws at the largest density, and similarity at 75° at all densities."""
    densest = results.density_kg_m3 == results.density_kg_m3.max()
    selected = results[densest | ((results.law == "similarity") & (results.light == 75.0))].copy()
    selected["value"] = [
        f"{row.value:+.3f} ± {row.stderr:.3f}" if row.law in ZERO_LAWS else
        f"{row.value:.3f} ± {row.stderr:.3f}"
        for row in selected.itertuples()
    ]  # fmt: skip
    wide = selected.pivot_table(
        "value", ["law", "light", "density_kg_m3"], "rule", aggfunc="first", sort=False
    )
    return wide[list(dict.fromkeys(results.rule))].reset_index()


if __name__ == "__main__":
    main()
