"""Grains: optical shape, laws of dense media by the rule for overlaps, and finite extent.

python benchmarks/grains.py {shapes,closest_shape,packing_rules,finite_grains} [--table TABLE.csv]
"""

import itertools
import math
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from command import run_command

import splits
from splits.analysis.theory.grain_shape import compute_optical_shape
from splits.analysis.theory.spectra import correct_dense_packing, solve_discrete_ordinates
from splits.discrete_ordinates.applicability import make_granular_stack

PROJECTED_ENTRY: dict[str, Any] = {"entry_point": "projected"}
MIRRORED_INTERPRETATION = {**PROJECTED_ENTRY, "wrong_side_ray": "mirror"}
SPHERES: dict[str, Any] = {"facetness": (0.0, 0.0, 0.0, 0.0), "sphericity": (1.0, 1.0, 1.0, 0.0)}


def make_grains(facetness: float) -> dict[str, Any]:
    """Return the parameters of grains of a single facetness."""
    return {"facetness": (facetness, facetness, facetness, 0.0)}


GRAINS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "smooth spheres": ({}, SPHERES),
    "smooth spheres, projected": (PROJECTED_ENTRY, SPHERES),
    "Table 1": ({}, {}),
    "facetness 0.05": ({}, make_grains(0.05)),
    "any facet, mirrored": ({"facet_sampling": "any", "wrong_side_ray": "mirror"}, {}),
    "projected, Table 1": (PROJECTED_ENTRY, {}),
    **{
        f"projected, facetness {f:g}": (PROJECTED_ENTRY, make_grains(f))
        for f in (0.0, 0.02, 0.05, 0.08, 0.1)
    },
    **{
        f"projected, mirrored, facetness {f:g}": (MIRRORED_INTERPRETATION, make_grains(f))
        for f in (0.05, 0.08, 0.1)
    },
    "projected, unweighted facets, facetness 0.05": (
        {**PROJECTED_ENTRY, "facet_sampling": "unweighted"}, make_grains(0.05),
    ),
    "projected, facetness 0.2, sphericity 0.45": (
        PROJECTED_ENTRY, {**make_grains(0.2), "sphericity": (0.45, 0.45, 0.45, 0.0)},
    ),
}  # fmt: skip
"""Settings that differ from the interpretation of SPLITS, and from the grains of Table 1."""

NATURAL_B, NATURAL_G = (1.68, 0.02), (0.65, 0.03)
"""Mean and standard deviation over samples of natural snow."""


def shapes(rays: int = 65_536) -> Iterator[dict[str, Any]]:
    """Optical shape parameters B and g of grains by interpretation, at 900 nm.

    Without diffraction (`splits.analysis.theory.grain_shape`), for the papers' interpretation and
    for others.  Natural snow, 33 samples in micro-tomography (Robledano et al. 2023, Nature
    Communications 14, 3955): B 1.68 ± 0.02 and g 0.65 ± 0.03.
    """
    for name, (interpretation, grains) in GRAINS.items():
        both = {"set": "splits_2007", **interpretation}
        snow = splits.Snow(saturation=0.0, interpretation=both, **grains)
        row: dict[str, Any] = {"grains": name}
        for key, one in compute_optical_shape(snow, rays=rays)._asdict().items():
            row |= {key: one.value, f"{key}_stderr": one.stderr}
        yield row


def closest_shape(rays: int = 65_536) -> Iterator[dict[str, Any]]:
    """B and g by facetness and sphericity with the interpretation ``geometric``, closest first.

    Deviations are in standard deviations of the samples of natural snow.  The closest is the shape
    of `splits.Snow.natural`.
    """
    rows = []
    for sphericity, facetness in itertools.product(
        (0.65, 0.7, 0.75, 0.8), (0.03, 0.04, 0.05, 0.06, 0.07, 0.08)
    ):
        grains = {**make_grains(facetness), "sphericity": (sphericity, sphericity, sphericity, 0.0)}
        snow = splits.Snow(saturation=0.0, interpretation="geometric", **grains)
        b, g, _ = compute_optical_shape(snow, rays=rays)
        rows.append({
            "sphericity": sphericity, "facetness": facetness, "B": b.value, "B_stderr": b.stderr,
            "g": g.value, "g_stderr": g.stderr,
            "deviation_B": (b.value - NATURAL_B[0]) / NATURAL_B[1],
            "deviation_g": (g.value - NATURAL_G[0]) / NATURAL_G[1],
        })  # fmt: skip
    yield from sorted(rows, key=lambda row: math.hypot(row["deviation_B"], row["deviation_g"]))


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


class PackingEffort(NamedTuple):
    """Standard error of reflectances, relative standard error of BRDFs, rays for mean paths."""

    stderr: float
    brdf: float
    rays: int


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
        make_snow(rule, 10.0), [1300.0], incidence, max_stderr=stderr, seed=20, solver="monte_carlo"
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
            snow,
            [1300.0],
            incidence,
            max_stderr=effort.stderr,
            seed=10 + number,
            solver="monte_carlo",
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
            snow,
            [700.0],
            incidence,
            max_stderr=effort.stderr,
            seed=30 + number,
            solver="monte_carlo",
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
    bins = splits.goniophotometer(snow, [1000.0], 0.0, rays=1000, estimator="bins").polar_deg.values
    near = [float(bins[np.abs(bins - angle).argmin()]) for angle in (30.0, 70.0)]
    means, errors = [], []
    for incidence, view in (near, near[::-1]):
        result = splits.goniophotometer(
            snow, [1000.0], incidence, relative_stderr=6.0 * effort.brdf, seed=round(incidence),
            estimator="bins",
        )  # fmt: skip
        ring = result.squeeze().sel(polar_deg=view)
        means.append(float(ring.brdf.mean()))
        # Bins count different rays, so their errors are independent.
        error = float(np.sqrt((ring.brdf_stderr**2).sum())) / ring.sizes["azimuth_deg"]
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
                snow,
                [1000.0],
                light,
                max_stderr=1e-6,
                seed=40,
                max_rays=effort.rays,
                solver="monte_carlo",
            ).squeeze()
            ratios.append(result[["absorptance", "absorptance_stderr"]] / (alpha * length))
        mean = 2.0 * ratios[0].absorptance - ratios[1].absorptance
        yield name, light, mean.item(), ratios[0].absorptance_stderr.item()


def _make_weak_index(index: float, absorption: float) -> dict[str, list[float]]:
    k = absorption * 1e-6 / (4.0 * np.pi)
    return {"wavelength_nm": [500.0, 2000.0], "n": [index, index], "k": [k, k]}


MEASURES = (measure_similarity, measure_transmittance, measure_reciprocity, measure_paths)


def packing_rules(
    densities: tuple[float, ...] = DENSITIES_KG_M3,
    stderr: float = 0.0007,
    brdf: float = 0.004,
    rays: int = 2_000_000,
) -> Iterator[dict[str, Any]]:
    """Laws of a dense medium of grains, by the rule for grains that overlap.

    The grains have the sizes and shapes of natural snow of 20 m²/kg.  Rules are the interpretations
    of grains that overlap a boundary or the previous segment (`reject`, `skip`, `keep`, the
    rest as in the set ``geometric``, which has `skip`), `point`, the set ``radiative_transfer`` of
    `splits.Snow.natural`, and the sets of the papers.  The laws:

    similarity     Reflectance of a half-space at 1300 nm minus that of the same grains at 10 kg/m³,
                   where rules have no effect: 0 at every density, for beams and for diffuse light.
    ordinates      The same minus discrete ordinates with the single scattering of the same grains,
                   and transmittance of 5 cm at 700 nm minus theirs (`correct_dense_packing`).
    reciprocity    BRDF of 5 cm at 1000 nm, averaged over azimuth, from 30° to 70°, divided by that
                   from 70° to 30°: 1.
    enhancement    Mean path in a grain under isotropic light, divided by n² times its mean chord: 1
                   in equilibrium.  It depends on the facets of the grains only, not on the rule.
    mean path      In 2 cm with weak absorption, under diffuse light, divided by 2 H (1 − f + B f):
                   1 (f the volume fraction of ice, B = n² times the enhancement; Blanco & Fournier
                   2003, Europhysics Letters 61, 168).
    mass           Path in ice of index 1, per depth and volume fraction, at normal incidence: 1.

    Rows are the laws at the largest density, and similarity at 75° at all densities.
    """
    effort = PackingEffort(stderr, brdf, rays)
    rows = [
        (rule, density, *row)
        for rule in OVERLAP_RULES
        for density in densities
        for measure in MEASURES
        for row in measure(rule, density, effort)
    ]
    results = pd.DataFrame(rows, columns=[*KEY_COLUMNS, "value", "stderr"])
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
    yield from wide[list(OVERLAP_RULES)].reset_index().to_dict("records")


RULES = {"overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep"}
MEAN_FREE_PATHS = ("pore_only", "including_grain")
WAVELENGTHS_NM = np.array([500.0, 800.0, 1030.0, 1300.0])
THICK_RATIO = 20.0
"""Depth over the largest diameter from which a layer counts as thick."""


class Comparison(NamedTuple):
    """Medium, and its comparison with paths.

    Attributes
    ----------
    group : str
    difference, stderr, bound : float, shape (2, wavelengths)
        Of reflectance and transmittance: difference from paths, its statistical error, and the
        bound due to the extent of the grains.
    """

    group: str
    difference: np.ndarray
    stderr: np.ndarray
    bound: np.ndarray


def make_medium(generator: np.random.Generator, is_sand: bool) -> Any:
    """Return random snow or sand of finite grains."""

    def draw(low: float, high: float) -> float:
        return float(np.exp(generator.uniform(np.log(low), np.log(high))))

    is_dense, is_thin = generator.uniform(size=2) < 0.5
    interpretation = {
        "set": "geometric", **RULES, "mean_free_path": str(generator.choice(MEAN_FREE_PATHS)),
    }  # fmt: skip
    settings: dict[str, Any] = {
        "depth_m": draw(0.005, 0.02 if is_thin else 1.0),
        "ground": float(generator.uniform(0.0, 0.8)) if generator.uniform() < 0.4 else None,
        "interpretation": interpretation,
    }
    if is_sand:
        silt = float(generator.uniform(0.0, 0.15))
        return splits.Sand(
            iron_oxide=draw(1e-4, 0.03), hematite_ratio=float(generator.uniform()),
            texture=(0.0, silt, 1.0 - silt),
            porosity=0.4 if is_dense else float(generator.uniform(0.4, 0.9)), **settings,
        )  # fmt: skip
    facetness = float(generator.uniform(0.1, 0.9))
    largest = draw(100.0, min(3000.0, 5e5 * settings["depth_m"]))
    return splits.Snow(
        grain_size_um=(largest / 2.5, largest),
        facetness=(facetness - 0.1, facetness + 0.1, facetness, 0.05),
        saturation=0.0,
        density_kg_m3=550.0 if is_dense else float(generator.uniform(50.0, 550.0)),
        **settings,
    )


def compare_media(number: int, error: float) -> Iterator[Comparison]:
    """Yield comparisons of media with paths to an error."""
    for seed in range(number):
        generator = np.random.default_rng(seed)
        medium = make_medium(generator, is_sand=seed % 2 == 0)
        incidence = "diffuse" if seed % 5 == 0 else float(generator.uniform(0.0, 80.0))
        solved, paths = (
            splits.spectrophotometer(medium, WAVELENGTHS_NM, incidence, **accuracy, solver=solver)
            for solver, accuracy in (
                ("discrete_ordinates", {"max_stderr": 2.0 * error}),
                ("monte_carlo", {"max_stderr": error, "seed": seed}),
            )
        )  # fmt: skip
        (layer,) = make_granular_stack(medium, WAVELENGTHS_NM, 2.0 * error).layers
        bound = layer.compute_extent_bound()
        is_thick = medium.depth_m > THICK_RATIO * medium.largest_grain_m
        depth = "thick" if is_thick else "thin"
        names = ("reflectance", "transmittance")
        difference, own, other = (
            np.stack([one[f"{name}{suffix}"].values for name in names])
            for one, suffix in ((solved - paths, ""), (solved, "_stderr"), (paths, "_stderr"))
        )
        # The stated error combines the bound with statistical errors.
        statistical = np.sqrt(np.maximum(own**2 - bound**2, 0.0))
        yield Comparison(
            f"{medium.kind}, {depth}", difference, np.hypot(statistical, other),
            np.broadcast_to(bound, difference.shape),
        )  # fmt: skip


def finite_grains(number: int = 40, stderr: float = 0.001) -> Iterator[dict[str, Any]]:
    """Largest differences between discrete ordinates and paths for grains of finite extent.

    Random dry snow and sand under the rules keep for overlapping grains, with both mean free paths:
    sizes, shapes, densities of 50 to 550 kg/m³, depths of 5 mm to 1 m, beams of 0° to 80° and
    diffuse light, with and without a ground.  Half of the media are as dense and a half as thin as
    the range allows, where differences are large.  One row for each group of media:

    largest_difference   of reflectance and transmittance, at 4 wavelengths, from those of paths
    stderr               its standard error
    bound                stated for this medium and wavelength
    worst_ratio          largest of all differences, less two standard errors, over the bound
    """
    comparisons = list(compare_media(number, stderr))
    for group in sorted({one.group for one in comparisons}):
        members = [one for one in comparisons if one.group == group]
        difference, error, bound = (
            np.concatenate([getattr(one, name).ravel() for one in members])
            for name in ("difference", "stderr", "bound")
        )
        worst = int(np.abs(difference).argmax())
        ratio = (np.abs(difference) - 2.0 * error) / bound
        row = {
            "largest_difference": difference[worst], "stderr": error[worst],
            "bound": bound[worst], "worst_ratio": max(float(ratio.max()), 0.0),
        }  # fmt: skip
        yield {"media": group, "number": len(members)} | {
            name: round(value, 4) for name, value in row.items()
        }


if __name__ == "__main__":
    run_command(shapes, closest_shape, packing_rules, finite_grains)
