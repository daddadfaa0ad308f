"""Local estimation for phase functions with a narrow peak, against discrete ordinates."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from chi2 import (
    NEEDS_JIT,
    SIGNIFICANCE,
    compare_results,
    compute_p_of_values,
    compute_z_bound,
    draw_samples,
    judge_p,
    judge_z,
    uniform_cdf,
)
from scipy import integrate, stats

import splits
from splits.kernels import phase_function
from splits.kernels.phase_function import evaluate_phase_function

pytestmark = pytest.mark.long

NM = [700.0]
SEEDS = 24
SIDES = ("brdf", "btdf")
POLAR = [30.0, 60.0, 82.0, 87.0]
STREAMS = 192


def read_cloud_phase_function() -> dict[str, list[float]]:
    """Return the phase function of cloud C.1, which exceeds 130/sr within half a degree."""
    file = Path(__file__).with_name("reference") / "cloud_c1.csv"
    table = pd.read_csv(file, comment="#").sort_values("angle_deg", ascending=False)
    cosine = np.cos(np.radians(table.angle_deg.to_numpy()))
    cosine[[0, -1]] = -1.0, 1.0
    return {"cosine": cosine.tolist(), "density": table.density_per_sr.tolist()}


def compute_legendre_moments(layer: splits.ParticleLayer, count: int = 1000) -> np.ndarray:
    """Return Legendre moments of the phase function, which is linear between its nodes."""
    if isinstance(layer.phase_function, str):
        return layer.asymmetry ** np.arange(count)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    low, high = (
        layer.kernel_phase_function.cosines[:-1, np.newaxis],
        layer.kernel_phase_function.cosines[1:, np.newaxis],
    )
    x = (0.5 * (high + low) + 0.5 * (high - low) * nodes).ravel()
    density = np.interp(x, layer.kernel_phase_function.cosines, layer.kernel_phase_function.density)
    weighted_density = math.pi * ((high - low) * weights).ravel() * density
    previous, current, moments = np.ones_like(x), x, [weighted_density.sum(), weighted_density @ x]
    for order in range(2, count):
        previous, current = (
            current,
            ((2 * order - 1) * x * current - (order - 1) * previous) / order,
        )
        moments.append(weighted_density @ current)
    return np.array(moments) / moments[0]


def solve_discrete_ordinates(layer: splits.ParticleLayer) -> dict[str, np.ndarray]:
    """Return BRDF and BTDF under light from the zenith by discrete ordinates."""
    ordinates = pytest.importorskip("PythonicDISORT")
    moments = compute_legendre_moments(layer)
    with pytest.warns(UserWarning, match="close to 1"):
        solution = ordinates.pydisort(
            layer.optical_thickness, 1.0 - 1e-9, STREAMS, moments[np.newaxis], 1.0 - 1e-9, 1.0, 0.0,
            NLeg=STREAMS, NFourier=1, f_arr=moments[STREAMS], NT_cor=True,
        )  # fmt: skip
    radiance = ordinates.subroutines.interpolate(solution[-1], NT_cor="eval")
    cosine = np.cos(np.radians(POLAR))
    return {
        "brdf": radiance(cosine, 0.0, 0.0).ravel(),
        "btdf": radiance(-cosine, layer.optical_thickness, 0.0).ravel(),
    }


def make_cloud(phase: dict | float, thickness: float) -> splits.ParticleLayer:
    """Return a conservative cloud with a tabulated phase function or an asymmetry."""
    kind = {"phase_function": phase} if isinstance(phase, dict) else {"asymmetry": phase}
    return splits.ParticleLayer(
        optical_thickness=thickness, single_scattering_albedo=1.0, refractive_index=1.0,
        ground=None, **kind,
    )  # fmt: skip


def judge_seeds(layer: splits.ParticleLayer, rays: int) -> None:
    """Fail if the scatter of seeds or their medians disagree with the exact result."""
    runs = [
        splits.goniophotometer(
            layer,
            NM,
            0.0,
            rays=rays,
            seed=seed,
            estimator="next_event",
            polar_deg=POLAR,
            azimuth_deg=[0.0],
        )
        for seed in range(SEEDS)
    ]
    expected = np.concatenate(list(solve_discrete_ordinates(layer).values()))
    value, stderr = (
        np.array(
            [np.concatenate([run[name + end].values.ravel() for name in SIDES]) for run in runs]
        )
        for end in ("", "_stderr")
    )
    z = (value - expected) / stderr
    rms, median = np.sqrt((z**2).mean(axis=0)), np.median(value, axis=0) / expected
    report = f"{SIDES} at {POLAR}: rms z {rms.round(2)}, medians {median.round(3)}"
    print(report)
    # Directions use the same paths, so each is tested at a level that keeps 1 % for all.
    level = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / expected.size)
    low, high = np.sqrt(stats.chi2.ppf([0.5 * level, 1.0 - 0.5 * level], SEEDS) / SEEDS)
    assert low <= rms.min() and rms.max() <= high, report
    assert np.abs(z).max() <= compute_z_bound(z.size), report
    n_below = (value < expected).sum(axis=0)
    assert min(stats.binomtest(int(n), SEEDS).pvalue for n in n_below) >= level, report


@NEEDS_JIT
def test_stated_errors_of_a_thin_cloud():
    judge_seeds(make_cloud(read_cloud_phase_function(), 4.0), 12_000)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize(
    ("phase", "thickness", "rays"),
    [("cloud", 64.0, 20_000), (0.85, 8.0, 40_000), (0.95, 8.0, 40_000)],
)
def test_stated_errors_of_thick_clouds(phase, thickness, rays):
    judge_seeds(
        make_cloud(read_cloud_phase_function() if phase == "cloud" else phase, thickness), rays
    )


@NEEDS_JIT
@pytest.mark.parametrize(
    "settings",
    [
        {"refractive_index": 1.34, "ground": None, "asymmetry": 0.8},
        {"refractive_index": 1.5, "ground": None, "asymmetry": 0.7, "polarized": True},
        {"refractive_index": 1.34, "ground": 0.8, "asymmetry": 0.7, "polarized": True},
        {"refractive_index": 1.2, "ground": None, "asymmetry": -0.8, "polarized": True},
        {"refractive_index": 1.0, "ground": 0.6, "asymmetry": 0.8},
        {"optical_thickness": math.inf, "single_scattering_albedo": 0.9, "asymmetry": 0.8},
    ],
)
def test_results_are_independent_of_the_peak_threshold(settings, monkeypatch):
    layer = splits.ParticleLayer(**{"optical_thickness": 1.0, **settings})
    runs = []
    for seed, limits in enumerate(((math.inf, 1.0), (0.0, 0.1))):
        monkeypatch.setattr(phase_function, "PEAK_THRESHOLD_PER_SR", limits[0])
        monkeypatch.setattr(phase_function, "PEAK_BASE_PER_SR", limits[1])
        runs.append(
            splits.goniophotometer(
                layer, NM, 40.0, rays=100_000, seed=seed, estimator="next_event",
                polar_deg=[0.0, 45.0, 82.0],
                azimuth_deg=[0.0, 120.0],
            )
        )  # fmt: skip
    for name in (name for name in runs[0] if name.startswith(("brdf", "btdf"))):
        if not name.endswith("_stderr"):
            judge_z(compare_results(*runs, name), name, independent=1)


@NEEDS_JIT
@pytest.mark.parametrize("asymmetry", [0.99, 0.999])
def test_narrow_peaks_agree_with_bins(asymmetry):
    """Next-event estimates are averaged over bins, which have equal steps of the cosine."""
    layer, n_polar, first, last = make_cloud(asymmetry, 10.0), 600, 2, 10
    bins = splits.goniophotometer(
        layer, NM, 0.0, rays=400_000, seed=1, estimator="bins", n_bins=(n_polar, 1)
    ).isel(polar_deg=slice(first, last))
    nodes, weights = np.polynomial.legendre.leggauss(3)
    cosine = 1.0 - (np.arange(first, last)[:, np.newaxis] + 0.5 * (nodes + 1.0)) / n_polar
    polar = np.degrees(np.arccos(cosine.ravel()))
    local = splits.goniophotometer(
        layer,
        NM,
        0.0,
        rays=40_000,
        seed=2,
        estimator="next_event",
        azimuth_deg=[0.0],
        polar_deg=polar,
    )
    # By projected solid angle.
    weights = weights * cosine / (weights * cosine).sum(axis=1, keepdims=True)
    value, stderr = (
        (local[name].values.reshape(cosine.shape) * weights).sum(axis=1)
        for name in ("btdf", "btdf_stderr")
    )
    error = np.hypot(stderr, bins.btdf_stderr.values.ravel())
    # The errors of the nodes of a bin add up as if they were fully correlated.
    z = (value - bins.btdf.values.ravel()) / error
    judge_z(z, f"g = {asymmetry}", independent=1, bound_added=True)


PEAKED_PHASES = {
    "cloud": {"phase_function": read_cloud_phase_function()},
    **{f"g {g}": {"asymmetry": g} for g in (0.92, 0.95, -0.95, 0.99, 0.995, 0.999, -0.999)},
}


def make_peaked_phase(name):
    return splits.ParticleLayer(**PEAKED_PHASES[name]).kernel_phase_function


@pytest.mark.parametrize("name", PEAKED_PHASES)
def test_peak_fraction_is_the_light_above_the_base(name):
    phase, base = make_peaked_phase(name), phase_function.PEAK_BASE_PER_SR
    # Dense where 1 − |µ| is small.
    distance = np.concatenate([[0.0], np.geomspace(1e-12, 2.0, 40_001)])
    cosine = 1.0 - distance[::-1] if phase.g > 0.0 else distance - 1.0
    density = np.array([evaluate_phase_function(phase, x) for x in cosine])
    above = 2.0 * np.pi * np.trapezoid(np.maximum(density - base, 0.0), cosine)
    peak = phase_function.separate_peak(phase)
    assert peak.fraction == pytest.approx(above, rel=2e-5)
    wide = density * [phase_function.compute_wide_fraction(peak, phase, x) for x in cosine]
    np.testing.assert_allclose(wide, np.minimum(density, base), rtol=1e-12)


@pytest.mark.parametrize("name", PEAKED_PHASES)
def test_cosines_in_the_peak_have_the_density_above_the_base(name):
    phase = make_peaked_phase(name)
    peak, sign = phase_function.separate_peak(phase), math.copysign(1.0, phase.g)
    cosines = draw_samples(phase_function.sample_peak_cosine, 40_000, peak)
    # Classes of equal probability, from the integral on a grid that is dense near the peak.
    distance = np.concatenate([[0.0], np.geomspace(1e-12, 2.0, 40_001)])
    density = np.array([evaluate_phase_function(phase, sign * (1.0 - x)) for x in distance])
    above = np.maximum(density - peak.base, 0.0)
    cumulative = integrate.cumulative_trapezoid(above, distance, initial=0.0)
    u = np.interp(1.0 - sign * cosines, distance, cumulative / cumulative[-1])
    judge_p({name: compute_p_of_values(u, uniform_cdf)})


def test_wide_phase_functions_have_no_peak():
    for settings in ({"asymmetry": 0.9}, {"phase_function": "rayleigh"}):
        phase = splits.ParticleLayer(**settings).kernel_phase_function
        assert phase_function.separate_peak(phase) is None


@pytest.mark.parametrize("rest", [0.0, 1e-9])
def test_peaks_with_nearly_all_light_are_rejected(rest):
    narrow = {"cosine": [-1.0, 0.99999, 1.0], "density": [rest, rest, 1.0]}
    layer = splits.ParticleLayer(phase_function=narrow)
    with pytest.raises(ValueError, match=r"estimator = 'next_event'.*more than 99%"):
        splits.goniophotometer(
            layer, NM, estimator="next_event", polar_deg=[0.0], azimuth_deg=[0.0]
        )
