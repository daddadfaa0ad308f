"""Optical shape parameters of the model's grains by interpretation, compared with natural snow.

Prints B and g at 900 nm without diffraction (`splits.analysis.theory.grain_shape`) for the papers'
interpretation and for others, with standard errors.  Natural snow, 33 samples in micro-tomography
(Robledano et al. 2023, Nature Communications 14, 3955): B 1.68 ± 0.02 and
g 0.65 ± 0.03.

    python benchmarks/grain_shape.py [TABLE.csv] [--rays 65536] [--search]

--search finds the facetness and sphericity whose B and g, with the interpretation ``geometric``,
are closest to those of natural snow: those of `splits.Snow.natural`.
"""

import argparse
import itertools
import math
from typing import Any

import pandas as pd

import splits
from splits.analysis.theory.grain_shape import compute_optical_shape
from splits.core.escaping import write_data_frame

PROJECTED_ENTRY: dict[str, Any] = {"entry_point": "projected"}
MIRRORED_INTERPRETATION = {**PROJECTED_ENTRY, "wrong_side_ray": "mirror"}
SPHERES: dict[str, Any] = {"facetness": (0.0, 0.0, 0.0, 0.0), "sphericity": (1.0, 1.0, 1.0, 0.0)}


def make_grains(facetness: float) -> dict[str, Any]:
    """Return the parameters of grains of a single facetness."""
    return {"facetness": (facetness, facetness, facetness, 0.0)}


CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
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


def search_shapes(rays: int) -> None:
    """Print deviations of shapes from natural snow, in standard deviations of its samples."""
    best = (math.inf, "")
    for sphericity, facetness in itertools.product(
        (0.65, 0.7, 0.75, 0.8), (0.03, 0.04, 0.05, 0.06, 0.07, 0.08)
    ):
        grains = {**make_grains(facetness), "sphericity": (sphericity, sphericity, sphericity, 0.0)}
        snow = splits.Snow(saturation=0.0, interpretation="geometric", **grains)
        b, g, _ = compute_optical_shape(snow, rays=rays)
        deviations = [
            (b.value - NATURAL_B[0]) / NATURAL_B[1],
            (g.value - NATURAL_G[0]) / NATURAL_G[1],
        ]
        line = (
            f"sphericity {sphericity:g}, facetness {facetness:g}: "
            f"B {b.value:.3f} ± {b.stderr:.3f}, "
            f"g {g.value:.3f} ± {g.stderr:.3f}; "
            f"deviations {deviations[0]:+.1f} and {deviations[1]:+.1f}"
        )
        print(line, flush=True)
        best = min(best, (math.hypot(*deviations), line))
    print(f"closest: {best[1]}")


def main() -> None:
    """Print B and g of all cases, or search for the closest shape."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?")
    parser.add_argument("--rays", type=int, default=65_536)
    parser.add_argument("--search", action="store_true")
    arguments = parser.parse_args()
    if arguments.search:
        search_shapes(arguments.rays)
        return
    rows = []
    for name, (interpretation, grains) in CASES.items():
        both = {"set": "splits_2007", **interpretation}
        snow = splits.Snow(saturation=0.0, interpretation=both, **grains)
        shape = compute_optical_shape(snow, rays=arguments.rays)
        row: dict[str, Any] = {"grains": name}
        for key, one in shape._asdict().items():
            row |= {key: one.value, f"{key}_stderr": one.stderr}
        rows.append(row)
        b, g, both = shape
        print(
            f"{name:46s} B {b.value:.3f} ± {b.stderr:.3f}, g {g.value:.3f} ± {g.stderr:.3f}, "
            f"B/(1 − g) {both.value:.2f} ± {both.stderr:.2f}",
            flush=True,
        )
    if arguments.table:
        write_data_frame(pd.DataFrame(rows), arguments.table)


if __name__ == "__main__":
    main()
