"""What light inside costs: planes by ray, and errors of absorbed power by time.

First `splits.irradiance_profile` against the plain spectrum, for the same rays: wet snow of
SPLITSnow Table 1 at 211 wavelengths, one thread, by turns.  So large an error is asked for that
there is one round only.  Printed are CPU seconds per ray over those of the spectrophotometer.

Then five layers of natural snow under a sky.  Errors are asked at every wavelength of irradiances
and absorptances, as `splits.irradiance_profile` does by default, or of power absorbed in the broad
band, or of irradiances in it, as `splits.radiation_profile` does.  Printed are CPU seconds, stated
errors of the power that the top layer absorbs and of the irradiance below it (W m⁻²), the part of
the former that bounds interpolation between refractive indices, and how both scatter over seeds.
At last, the difference that interpolation makes: between as few indices as the first rule takes,
and many.

    python benchmarks/light_inside.py [--planes 10 50] [--rounds 20] [--errors 0.05 0.02]
        [--seeds 4]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

import splits
from splits.core.uncertainty import compute_error_parts
from splits.instruments.flux_stopping_rule import FluxStoppingRule
from splits.instruments.irradiance_profile import FluxRequest, simulate_flux

WAVELENGTHS_NM = np.arange(400.0, 2501.0, 10.0)
LARGE_ERROR = 0.5
LAYERS = [
    (0.03, 45, 120),
    (0.05, 35, 180),
    (0.10, 25, 250),
    (0.15, 15, 320),
    (0.20, 10, 380),
]
"""Thickness (m), specific surface area (m²/kg) and density (kg/m³) of five layers of snow."""
TOTAL_W_M2 = 500.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planes", type=int, nargs="+", default=[10, 50])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--errors", type=float, nargs="+", default=[0.05, 0.02])
    parser.add_argument("--seeds", type=int, default=4)
    given = parser.parse_args()
    report_plane_costs(given.planes, given.rounds)
    report_error_costs(given.errors, given.seeds)


def report_plane_costs(n_planes: Sequence[int], rounds: int) -> None:
    """Print the costs of a ray that so many planes note."""
    snow = splits.Snow()

    def plain(seed: int) -> xr.Dataset:
        return splits.spectrophotometer(
            snow, WAVELENGTHS_NM, max_stderr=LARGE_ERROR, seed=seed, threads=1
        )

    def inside(planes: int) -> Callable[[int], xr.Dataset]:
        depths = snow.depth_m * np.arange(1, planes + 1) / (planes + 1)
        return lambda seed: splits.irradiance_profile(
            snow, WAVELENGTHS_NM, depths, max_stderr=LARGE_ERROR, seed=seed, threads=1
        )

    runs = {"plain": plain, **{f"{n} planes": inside(n) for n in n_planes}}
    for run in runs.values():
        run(0)
    seconds, rays = (dict.fromkeys(runs, 0.0) for _ in range(2))
    for seed in range(1, rounds + 1):
        for name, run in runs.items():
            begun = time.process_time()
            rays[name] += run(seed).attrs["rays"]
            seconds[name] += time.process_time() - begun
    base = seconds["plain"] / rays["plain"]
    for name, spent in seconds.items():
        each = spent / rays[name]
        print(f"{name}: {1e6 * each:.1f} µs per ray, {each / base:.2f} times the plain spectrum")


def report_error_costs(errors: Sequence[float], seeds: int) -> None:
    """Print what errors of absorbed power and irradiance cost, by what they are asked of."""
    layers = [
        splits.Snow.natural(depth_m=d, specific_surface_area_m2_kg=s, density_kg_m3=r)
        for d, s, r in LAYERS
    ]
    pack = splits.Stack(layers, ground=0.2)
    light = splits.sky("midlatitude_winter").scale_to(TOTAL_W_M2)
    w = np.arange(305.0, 2496.0, 10.0)
    weights = light.compute_weights(w, light.make_bands(None)["broadband"])
    faces = np.cumsum([d for d, *_ in LAYERS])[:-1]
    part = weights / weights.sum()

    def run(goal: FluxStoppingRule, seed: int) -> xr.Dataset:
        asked = FluxRequest(pack, w, faces, light.zenith_deg, seed, 10**8, 1, "auto", None)
        return simulate_flux(asked.validate(), goal)

    kinds = {
        "irradiance by wavelength": lambda e: FluxStoppingRule(e),
        "irradiance in the band": lambda e: FluxStoppingRule(e, True, part[np.newaxis], np.ones(1)),
        "absorbed power in the band": lambda e: FluxStoppingRule(
            e, False, part[np.newaxis], np.ones(1)
        ),
        "absorbed power, to a tenth": lambda e: FluxStoppingRule(
            0.1 * e, False, part[np.newaxis], np.ones(1)
        ),
    }
    by_wavelength = xr.DataArray(weights, {"wavelength": w}, ("wavelength",))
    most = {}
    for error in errors:
        for kind, goal in kinds.items():
            begun = time.process_time()
            runs = [run(goal(error), seed) for seed in range(seeds)]
            print(f"{kind}, {error:g}: {(time.process_time() - begun) / seeds:.1f} s")
            for name, place in (("absorptance", 0), ("downward_irradiance", 1)):
                parts = [compute_error_parts(one, name, by_wavelength) for one in runs]
                scatter, missed = np.sqrt(np.mean(np.square(parts)[..., place], axis=0))
                values = [float((by_wavelength * one[name][:, place]).sum()) for one in runs]
                mean, apart = np.mean(values), np.std(values, ddof=1)
                print(
                    f"    {name}: {mean:.2f} ± {np.hypot(scatter, missed):.3f} W m⁻², of which "
                    f"bounds {missed:.3f}; seeds scatter by {apart:.3f}",
                    flush=True,
                )
                most[kind, error, name] = mean, apart / seeds**0.5, missed
    few, *_, many = kinds
    for error in errors:
        one, other = most[few, error, "absorptance"], most[many, min(errors), "absorptance"]
        off, doubt = one[0] - other[0], np.hypot(one[1], other[1])
        print(f"few indices ({error:g}) against many: {off:.3f} ± {doubt:.3f}, bound {one[2]:.3f}")


if __name__ == "__main__":
    main()
