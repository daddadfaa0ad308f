"""Effect of polarization on the asymmetry parameter and the reflectance of grains, by facetness.

Light that a facet reflects or transmits is polarized, and the next facet reflects it as polarized
light.  Without `stokes`, each facet receives unpolarized light.  The table has both:

    python benchmarks/polarization_by_facetness.py [FILE] [--rays 2000000] [--threads 2]

It is docs/theory/polarization_by_facetness.csv.
"""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

import splits

WAVELENGTH_NM = 1310.0
SPHERE = (1.0, 1.0, 1.0, 0.0)
GRAINS: dict[str, dict[str, Any]] = {
    f"spheres, facetness {value:g}": {"sphericity": SPHERE, "facetness": (value, value, value, 0.0)}
    for value in (0.0, 0.05, 0.1, 0.2)
}
GRAINS["natural snow"] = {}


def compare_polarization(rays: int, max_stderr: float, threads: int) -> Iterator[dict[str, Any]]:
    """Yield the asymmetry parameter and the reflectance of deep snow without and with polarization.

    Parameters
    ----------
    rays : int
        Through single grains.
    max_stderr : float
        Of reflectances.
    threads : int
    """
    for name, shape in GRAINS.items():
        snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0, **shape)
        row: dict[str, Any] = {"grains": name}
        for label, stokes in (("scalar", False), ("polarized", True)):
            grains = splits.single_scattering(
                snow, WAVELENGTH_NM, 2, rays, threads=threads, stokes=stokes
            )
            spectrum = splits.spectrophotometer(
                snow, [WAVELENGTH_NM], "diffuse", max_stderr, stokes=stokes, threads=threads,
                solver="monte_carlo",
            )  # fmt: skip
            row |= {
                f"g_{label}": grains.asymmetry_parameter.item(),
                f"R_{label}": spectrum.reflectance.item(),
            }
            errors = grains.asymmetry_parameter_stderr, spectrum.reflectance_stderr
            row |= {f"{q}_stderr": e.item() for q, e in zip(("g", "R"), errors, strict=True)}
        row["g_change"] = row["g_polarized"] - row["g_scalar"]
        row["R_change"] = row["R_polarized"] - row["R_scalar"]
        # Both runs have the same error.
        yield {name: value for name, value in row.items() if not name.endswith("_stderr")} | {
            "g_error": math.sqrt(2.0) * row["g_stderr"], "R_error": math.sqrt(2.0) * row["R_stderr"]
        }  # fmt: skip


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    default = Path(__file__).parents[1] / "docs" / "theory" / "polarization_by_facetness.csv"
    parser.add_argument("file", nargs="?", type=Path, default=default)
    parser.add_argument("--rays", type=int, default=2_000_000)
    parser.add_argument("--max-stderr", type=float, default=0.0005)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    rows = []
    for row in compare_polarization(arguments.rays, arguments.max_stderr, arguments.threads):
        rows.append(row)
        print(row, flush=True)
        pd.DataFrame(rows).to_csv(arguments.file, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
