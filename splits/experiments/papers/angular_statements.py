"""Qualitative statements of the SPLITSnow paper on the BRDF of snow (Figs 16 to 22).

Peaks and limbs are means over 60° to 75° in the principal plane, see
`splits.experiments.papers.interpretation_runs`, because the maximum of noisy values is biased.
"""

from __future__ import annotations

import itertools

import xarray as xr

from splits.experiments.papers.brdf_trends import (
    MAX_LAMBERTIAN_RANGE,
    compute_relative_range,
    get_brdf,
)
from splits.experiments.papers.estimate import Estimate
from splits.experiments.papers.interpretation_runs import (
    InterpretationRun,
    StatementValues,
    repeat_for_waters,
)

LIMB_ANGLES_DEG = (-67.5, 67.5)
"""Middle of the outermost sectors (degrees)."""


def compute_incidence_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Fig 19: nearly Lambertian at 0°, a peak at 30°, a larger one at 60°."""
    upright, tilted = (
        run.simulate_plane(600.0, incidence, run_number=number)
        for incidence, number in ((0.0, 1), (30.0, 2))
    )
    peaks = [_list_limb_contrasts(plane)[1] for plane in (tilted, run.oblique_plane)]
    return _repeat_all(
        fig19_lambertian=-(compute_relative_range(upright, 60.0) - MAX_LAMBERTIAN_RANGE),
        fig19_peak_30=peaks[0],
        fig19_peak_60=peaks[1],
        fig19_peak_grows=peaks[1] - peaks[0],
    )


def compute_nadir_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Figs 16 to 18: a nadir darker than the limbs at oblique incidence."""
    steep = run.simulate_plane([600.0, 1800.0], 69.3, run_number=3, depth_m=0.25)
    visible, infrared = (steep.isel(wavelength=[i]) for i in (0, 1))
    planes = (
        run.simulate_plane(600.0, 52.8, run_number=4, depth_m=0.25), visible,
        run.simulate_plane(600.0, 84.8, run_number=5, depth_m=0.25),
    )  # fmt: skip
    limbs = [max(_list_limb_contrasts(plane)) for plane in planes]
    return _repeat_all(
        fig16_nadir_dark=min(limbs),
        fig16_grows=min(after - before for before, after in itertools.pairwise(limbs)),
        fig17_nadir_dark=min(_list_limb_contrasts(infrared)),
        fig18_varies_more=_compute_forward_rise(infrared) - _compute_forward_rise(visible),
    )


def compute_grain_trends(run: InterpretationRun) -> StatementValues:
    """Return the trends of Figs 20 to 22: forward peaks by grain size and facetness."""
    trends = {}
    for wavelength, name, sign in (
        (600.0, "fig20_fine_least", -1.0), (1450.0, "fig21_fine_most", 1.0),
    ):  # fmt: skip
        *others, fine = (
            get_brdf(
                run.simulate_plane(
                    wavelength, 67.0, size[1] > 300, run_number=6 + i, grain_size_um=size
                ),
                LIMB_ANGLES_DEG[1],
            ).to_floats()
            for i, size in enumerate(((1500, 3000), (300, 750), (30, 300)))
        )
        excesses = [fine / other - 1.0 for other in others]
        trends[name] = min(excesses if sign > 0.0 else [-excess for excess in excesses])
    rounded, faceted = (
        _compute_forward_rise(
            run.simulate_plane(600.0, 60.0, True, run_number=9 + i, facetness=facetness)
        )
        for i, facetness in enumerate(((0, 0.2, 0.1, 0.072), (0.8, 1, 0.9, 0.072)))
    )
    others = [_compute_forward_rise(run.oblique_plane), faceted]
    return _repeat_all(**trends, fig22_rounded_varies_most=min(rounded - rise for rise in others))


def _list_limb_contrasts(plane: xr.Dataset) -> list[Estimate]:
    """Return the excess of the BRDF at each limb over the nadir, relative to the nadir."""
    nadir = get_brdf(plane, 0.0)
    return [(get_brdf(plane, angle) / nadir - 1.0).to_floats() for angle in LIMB_ANGLES_DEG]


def _compute_forward_rise(plane: xr.Dataset) -> Estimate:
    """Return the rise of the BRDF from the nadir to the forward limb, relative to its mean."""
    rise = get_brdf(plane, LIMB_ANGLES_DEG[1]) - get_brdf(plane, 0.0)
    return (rise / plane.brdf.mean("angle")).to_floats()


def _repeat_all(**trends: Estimate) -> StatementValues:
    """Return the values of trends, which do not depend on water, for all waters."""
    return {name: repeat_for_waters(*estimate.to_floats()) for name, estimate in trends.items()}
