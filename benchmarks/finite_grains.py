"""Largest differences between discrete ordinates and paths for grains of finite extent.

Random dry snow and sand under the rules keep for overlapping grains, with both mean free paths:
sizes, shapes, densities of 50 to 550 kg/m³, depths of 5 mm to 1 m, beams of 0° to 80° and diffuse
light, with and without a ground.  Half of the media are as dense and a half as thin as the range
allows, where differences are large.  One row for each group of media:

largest_difference   of reflectance and transmittance, at 4 wavelengths, from those of paths
stderr               its standard error
bound                stated for this medium and wavelength
worst_ratio          largest of all differences, less two standard errors, over the bound

    python benchmarks/finite_grains.py [TABLE.csv] [--number 40] [--stderr 0.001]
"""

import argparse
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

import splits
from splits.discrete_ordinates.applicability import make_granular_stack

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
            splits.spectrophotometer(medium, WAVELENGTHS_NM, incidence, *accuracy, solver=solver)
            for solver, accuracy in (
                ("discrete_ordinates", (2.0 * error,)), ("monte_carlo", (error, seed)),
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


def summarize(comparisons: list[Comparison]) -> pd.DataFrame:
    """Return one row for each group."""
    rows = []
    for group in sorted({one.group for one in comparisons}):
        members = [one for one in comparisons if one.group == group]
        difference, stderr, bound = (
            np.concatenate([getattr(one, name).ravel() for one in members])
            for name in ("difference", "stderr", "bound")
        )
        worst = int(np.abs(difference).argmax())
        ratio = (np.abs(difference) - 2.0 * stderr) / bound
        rows.append({
            "media": group, "number": len(members),
            "largest_difference": difference[worst], "stderr": stderr[worst],
            "bound": bound[worst], "worst_ratio": max(float(ratio.max()), 0.0),
        })  # fmt: skip
    return pd.DataFrame(rows)


def main() -> None:
    """Print the table, and write it if a file is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?", help="CSV file")
    parser.add_argument("--number", type=int, default=40)
    parser.add_argument("--stderr", type=float, default=0.001)
    arguments = parser.parse_args()
    table = summarize(list(compare_media(arguments.number, arguments.stderr)))
    print(table.to_string(index=False, float_format="%.4f"))
    if arguments.table:
        table.to_csv(arguments.table, index=False, float_format="%.4f", lineterminator="\n")


if __name__ == "__main__":
    main()
