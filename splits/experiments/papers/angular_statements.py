"""Qualitative statements of the SPLITSnow paper on the BRDF of snow (Figs 16 to 22).

Peaks and limbs are means over 60° to 75° in the principal plane, see
`splits.experiments.papers.interpretation_runs`, because the maximum of noisy values is biased.
"""

from __future__ import annotations

import itertools

import numpy as np
import xarray as xr

from splits.experiments.papers.brdf_trends import MAX_LAMBERTIAN_RANGE
from splits.experiments.papers.interpretation_runs import (
    InterpretationRun,
    StatementValues,
    repeat_for_waters,
)

LIMB_ANGLE_DEG = 67.5
"""Middle of the outermost sector (degrees)."""

ValueWithError = tuple[float, float]
"""A value and its standard error."""


def compute_incidence_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Fig 19: nearly Lambertian at 0°, a peak at 30°, a larger one at 60°."""
    upright, tilted = (
        run.simulate_plane(600.0, 0.0, run_number=1),
        run.simulate_plane(600.0, 30.0, run_number=2),
    )
    peaks = [
        _compute_nadir_contrast(plane, LIMB_ANGLE_DEG) for plane in (tilted, run.oblique_plane)
    ]
    value, noise = _compute_sector_range(upright.sel(angle=slice(-60.0, 60.0)))
    return {
        "fig19_lambertian": repeat_for_waters(MAX_LAMBERTIAN_RANGE - value, noise),
        "fig19_peak_30": repeat_for_waters(*peaks[0]),
        "fig19_peak_60": repeat_for_waters(*peaks[1]),
        "fig19_peak_grows": repeat_for_waters(*_subtract(peaks[1], peaks[0])),
    }


def compute_nadir_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Figs 16 to 18: a nadir darker than the limbs at oblique incidence."""
    steep = run.simulate_plane([600.0, 1800.0], 69.3, run_number=3, depth_m=0.25)
    visible, infrared = (steep.isel(wavelength=[i]) for i in (0, 1))
    infrared_contrast = min(
        _compute_nadir_contrast(infrared, angle) for angle in (-LIMB_ANGLE_DEG, LIMB_ANGLE_DEG)
    )
    limbs = [
        max(_compute_nadir_contrast(plane, angle) for angle in (-LIMB_ANGLE_DEG, LIMB_ANGLE_DEG))
        for plane in (
            run.simulate_plane(600.0, 52.8, run_number=4, depth_m=0.25), visible,
            run.simulate_plane(600.0, 84.8, run_number=5, depth_m=0.25),
        )
    ]  # fmt: skip
    increases = [_subtract(b, a) for a, b in itertools.pairwise(limbs)]
    return {
        "fig16_nadir_dark": repeat_for_waters(*min(limbs)),
        "fig16_grows": repeat_for_waters(*min(increases)),
        "fig17_nadir_dark": repeat_for_waters(*infrared_contrast),
        "fig18_varies_more": repeat_for_waters(
            *_subtract(_compute_forward_rise(infrared), _compute_forward_rise(visible))
        ),
    }


def compute_grain_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Figs 20 to 22: forward peaks by grain size and facetness."""
    values = {}
    for wavelength, name, sign in (
        (600.0, "fig20_fine_least", -1.0), (1450.0, "fig21_fine_most", 1.0),
    ):  # fmt: skip
        *others, fine = (
            _get_forward_peak(
                run.simulate_plane(
                    wavelength, 67.0, size[1] > 300, run_number=6 + i, grain_size_um=size
                )
            )
            for i, size in enumerate(((1500, 3000), (300, 750), (30, 300)))
        )
        steps = [(sign * (fine[0] / o[0] - 1.0), _compute_ratio_error(fine, o)) for o in others]
        values[name] = repeat_for_waters(*min(steps))
    rounded, faceted = (
        _compute_forward_rise(
            run.simulate_plane(600.0, 60.0, True, run_number=9 + i, facetness=facetness)
        )
        for i, facetness in enumerate(((0, 0.2, 0.1, 0.072), (0.8, 1, 0.9, 0.072)))
    )
    steps = [
        _subtract(rounded, plane_rise)
        for plane_rise in (_compute_forward_rise(run.oblique_plane), faceted)
    ]
    return {**values, "fig22_rounded_varies_most": repeat_for_waters(*min(steps))}


def _get_brdf(plane: xr.Dataset, angle: float) -> ValueWithError:
    part = plane.isel(wavelength=0).sel(angle=angle)
    return float(part.brdf), float(part.brdf_stderr)


def _get_forward_peak(plane: xr.Dataset) -> ValueWithError:
    """Return the BRDF of the forward peak."""
    return _get_brdf(plane, LIMB_ANGLE_DEG)


def _compute_nadir_contrast(plane: xr.Dataset, angle: float) -> ValueWithError:
    """Return the excess of the BRDF of a direction over the nadir, relative to the nadir."""
    pair = _get_brdf(plane, angle), _get_brdf(plane, 0.0)
    return pair[0][0] / pair[1][0] - 1.0, _compute_ratio_error(*pair)


def _compute_forward_rise(plane: xr.Dataset) -> ValueWithError:
    """Return the rise of the BRDF from the nadir to the forward limb, relative to its mean."""
    mean = float(plane.isel(wavelength=0).brdf.mean())
    top, low = _get_brdf(plane, LIMB_ANGLE_DEG), _get_brdf(plane, 0.0)
    return (top[0] - low[0]) / mean, float(np.hypot(top[1], low[1])) / mean


def _compute_sector_range(plane: xr.Dataset) -> ValueWithError:
    """Return the largest difference between sectors, relative to the mean."""
    part = plane.isel(wavelength=0)
    high, low = (part.isel(angle=int(i(part.brdf.values))) for i in (np.argmax, np.argmin))
    mean = float(part.brdf.mean())
    error = float(np.hypot(float(high.brdf_stderr), float(low.brdf_stderr)))
    return float(high.brdf - low.brdf) / mean, error / mean


def _subtract(a: ValueWithError, b: ValueWithError) -> ValueWithError:
    return a[0] - b[0], float(np.hypot(a[1], b[1]))


def _compute_ratio_error(a: ValueWithError, b: ValueWithError) -> float:
    """Return the standard error of a/b."""
    return float(np.hypot(a[1], a[0] * b[1] / b[0]) / abs(b[0]))
