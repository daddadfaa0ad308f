"""Cost of irradiance profiles: time per ray by number of planes, and errors by target.

First, `splits.irradiance_profile` is compared with the spectrophotometer for the same rays: wet
snow of SPLITSnow Table 1 at 211 wavelengths, one thread, in alternation.  The error is so large
that there is only one round.  Printed are CPU times per ray relative to the spectrophotometer.

Second, five layers of natural snow under a sky.  The target is the error of irradiances and
absorptances at every wavelength, as by default in `splits.irradiance_profile`, of power absorbed in
the broadband, or of irradiances in it, as in `splits.radiation_profile`.  Printed are CPU times,
stated errors of the power absorbed in the top layer and of the irradiance below it (W m⁻²), the
interpolation bound included in them, and the scatter between seeds.

Third, the effect of interpolation: the difference between the few index nodes of the first target
and the many of the last.

    python benchmarks/irradiance_profile_cost.py [--planes 10 50] [--rounds 20] [--errors 0.05 0.02]
        [--seeds 4]
"""

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

import splits
from splits.core.uncertainty import compute_error_parts
from splits.instruments.flux_tally import FluxTarget
from splits.instruments.profiles import FluxRequest, simulate_flux
from splits.simulation.run_options import RunOptions

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
    """Print all three parts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planes", type=int, nargs="+", default=[10, 50])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--errors", type=float, nargs="+", default=[0.05, 0.02])
    parser.add_argument("--seeds", type=int, default=4)
    arguments = parser.parse_args()
    report_plane_costs(arguments.planes, arguments.rounds)
    report_error_costs(arguments.errors, arguments.seeds)


def report_plane_costs(n_planes: Sequence[int], rounds: int) -> None:
    """Print times per ray by number of planes."""
    snow = splits.Snow()

    def spectrum(seed: int) -> xr.Dataset:
        return splits.spectrophotometer(
            snow, WAVELENGTHS_NM, max_stderr=LARGE_ERROR, seed=seed, threads=1, solver="monte_carlo"
        )

    def make_profile_run(planes: int) -> Callable[[int], xr.Dataset]:
        depths = snow.depth_m * np.arange(1, planes + 1) / (planes + 1)
        return lambda seed: splits.irradiance_profile(
            snow,
            WAVELENGTHS_NM,
            depths,
            max_stderr=LARGE_ERROR,
            seed=seed,
            threads=1,
            solver="monte_carlo",
        )

    runs = {"spectrum": spectrum, **{f"{n} planes": make_profile_run(n) for n in n_planes}}
    for run in runs.values():
        run(0)
    seconds, rays = (dict.fromkeys(runs, 0.0) for _ in range(2))
    for seed in range(1, rounds + 1):
        for name, run in runs.items():
            start = time.process_time()
            rays[name] += run(seed).attrs["rays"]
            seconds[name] += time.process_time() - start
    base = seconds["spectrum"] / rays["spectrum"]
    for name, time_s in seconds.items():
        per_ray = time_s / rays[name]
        print(f"{name}: {1e6 * per_ray:.1f} µs per ray, {per_ray / base:.2f} times the spectrum")


def report_error_costs(errors: Sequence[float], seeds: int) -> None:
    """Print times and errors of absorbed power and irradiance, by target."""
    layers = [
        splits.Snow.natural(depth_m=d, specific_surface_area_m2_kg=s, density_kg_m3=r)
        for d, s, r in LAYERS
    ]
    snowpack = splits.Stack(layers, ground=0.2)
    sky = splits.sky("midlatitude_winter").scale_to(TOTAL_W_M2)
    w = np.arange(305.0, 2496.0, 10.0)
    weights = sky.compute_weights(w, sky.make_bands(None)["broadband"])
    plane_depths = np.cumsum([d for d, *_ in LAYERS])[:-1]
    band_weights = weights / weights.sum()

    def run(target: FluxTarget, error: float, seed: int) -> xr.Dataset:
        request = FluxRequest.from_arguments(
            snowpack, w, plane_depths, sky.zenith_deg, error, 10**8
        )
        return simulate_flux(request, target, RunOptions.from_arguments(seed, 1))

    irradiance = FluxTarget(True, band_weights[np.newaxis])
    absorbed_power = FluxTarget(False, band_weights[np.newaxis])
    targets = {
        "irradiance by wavelength": (FluxTarget(), 1.0),
        "irradiance in the band": (irradiance, 1.0),
        "absorbed power in the band": (absorbed_power, 1.0),
        "absorbed power, to a tenth": (absorbed_power, 0.1),
    }
    by_wavelength = xr.DataArray(weights, {"wavelength": w}, ("wavelength",))
    results = {}
    for error in errors:
        for kind, (target, factor) in targets.items():
            start = time.process_time()
            runs = [run(target, factor * error, seed) for seed in range(seeds)]
            print(f"{kind}, {error:g}: {(time.process_time() - start) / seeds:.1f} s")
            for name, i_plane in (("absorptance", 0), ("downward_irradiance", 1)):
                parts = [compute_error_parts(dataset, name, by_wavelength) for dataset in runs]
                scatter, bound = np.sqrt(np.mean(np.square(parts)[..., i_plane], axis=0))
                values = [
                    float((by_wavelength * dataset[name][:, i_plane]).sum()) for dataset in runs
                ]
                mean, seed_scatter = np.mean(values), np.std(values, ddof=1)
                print(
                    f"    {name}: {mean:.2f} ± {np.hypot(scatter, bound):.3f} W m⁻², including "
                    f"bounds {bound:.3f}; scatter of seeds {seed_scatter:.3f}",
                    flush=True,
                )
                results[kind, error, name] = mean, seed_scatter / seeds**0.5, bound
    few, *_, many = targets
    for error in errors:
        few_result, many_result = (
            results[few, error, "absorptance"],
            results[many, min(errors), "absorptance"],
        )
        difference, stderr = few_result[0] - many_result[0], np.hypot(few_result[1], many_result[1])
        print(
            f"few nodes ({error:g}) against many: {difference:.3f} ± {stderr:.3f}, "
            f"bound {few_result[2]:.3f}"
        )


if __name__ == "__main__":
    main()
