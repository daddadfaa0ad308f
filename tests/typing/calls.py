"""Right and wrong calls of public functions, as mypy sees them: unused `ignore` comments fail."""

from typing import assert_type

import numpy as np
import xarray as xr

import splits

# Media.
snow = splits.Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=300.0)
assert_type(snow, splits.Snow)
assert_type(snow.specific_surface_area_m2_kg, float)
sand = splits.Sand(iron_oxide=0.01, ground="black")
stack = splits.Stack([snow, splits.Snow(depth_m=0.1)], ground=0.2)
layer = splits.ParticleLayer(optical_thickness=2.0, surface={"rms_height_m": 0.1})
splits.Snow(density=300)  # type: ignore[call-arg]
splits.Snow(density_kg_m3="300")  # type: ignore[arg-type]
splits.Snow(impurities_in="water")  # type: ignore[arg-type]
splits.Sand(partition=(0.5, 0.5))  # type: ignore[arg-type]
splits.ParticleLayer(polarized="yes")  # type: ignore[arg-type]
splits.Stack()  # type: ignore[call-arg]
splits.Interpretation(entry_point="middle")  # type: ignore[arg-type]
snow.depth_m = 0.2  # type: ignore[misc]

# Instruments.
spectrum = splits.spectrophotometer(snow, range(400, 2501, 10), 30, max_stderr=0.01, seed=2)
assert_type(spectrum, xr.Dataset)
splits.spectrophotometer({"a": snow, "b": snow}, np.array([500.0]), "diffuse", stokes=[1, 0, 0, 0])
splits.goniophotometer(layer, 500, 45.0, polar_deg=[0, 30], azimuth_deg=[0, 180], rays=10_000)
splits.albedo(stack, "midlatitude_winter", bands={"visible": (400, 700)})
splits.hdrf(snow, splits.sky("midlatitude_winter"), [500, 600])
splits.beam_spread(snow, 500, rays=1000)
splits.time_of_flight(snow, 1064, pulse=1e-9, depth_m=[0.1])
splits.irradiance_profile(snow, [500, 600], depth_m=[0.1, 0.2])
splits.radiation_profile(snow, "midlatitude_winter", depth_m=[0.1], total_w_m2=400.0)
splits.single_scattering(snow, [500, 600], moments=16)
splits.surface_map(layer, half_width_m=3.0)
splits.lens(layer, screen_depth_m=[1.0], radius_m=0.1)
splits.spectrophotometer(snow)  # type: ignore[call-arg]
splits.spectrophotometer(snow, "500")  # type: ignore[arg-type]
splits.spectrophotometer(snow, 500, 30, 0.01)  # type: ignore[call-arg]
splits.spectrophotometer(snow, 500, solver="mc")  # type: ignore[arg-type]
splits.spectrophotometer([500], snow)  # type: ignore[arg-type]
splits.goniophotometer(snow, 500, stderr=0.1)  # type: ignore[call-arg]
splits.goniophotometer(snow, 500, estimator="histogram")  # type: ignore[arg-type]
splits.beam_spread(snow, 500, "diffuse")  # type: ignore[arg-type]
splits.irradiance_profile(snow, 500)  # type: ignore[call-arg]
splits.single_scattering(layer, 500)  # type: ignore[arg-type]
splits.surface_map(snow, half_width_m=1.0)  # type: ignore[arg-type]
splits.time_of_flight(snow, 1064, depths_m=[0.1])  # type: ignore[call-arg]
splits.albedo(snow, sky=3)  # type: ignore[arg-type]
