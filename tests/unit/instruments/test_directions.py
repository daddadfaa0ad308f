"""Directional tallies, linear polarization, and instruments for rough surfaces."""

import numpy as np
import pytest
import xarray as xr
from experiment_jobs import COARSE

import splits
from splits.analysis.directions import merge_angular_bins, select_principal_plane
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.load import validate_content
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.instruments.angular_estimate import (
    MAX_POWER_RATIO,
    VARIANCE_PENALTY,
    estimate_truncation_error,
    make_direction_grid,
    select_terms,
)
from splits.instruments.angular_tallies import (
    MAX_ANGLE_STDERR_DEG,
    compute_bin_centres,
    compute_linear_polarization,
)
from splits.kernels.records import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
    make_basis,
)
from splits.kernels.tallies.distributions import (
    evaluate_basis_at,
    tally_angular_bins,
    tally_expansion,
)
from splits.plotting import draw

DEGREE = 24


def make_quadrature(polar=40, azimuth=64):
    """Return directions and weights that integrate over projected solid angle."""
    x, w = np.polynomial.legendre.leggauss(polar)
    mu, phi = np.meshgrid(
        0.5 * (x + 1.0), np.arange(azimuth) * 2.0 * np.pi / azimuth, indexing="ij"
    )
    weights = (0.5 * w[:, np.newaxis] * mu * 2.0 * np.pi / azimuth).ravel()
    sine = np.sqrt(1.0 - mu**2)
    directions = np.stack([sine * np.cos(phi), sine * np.sin(phi), mu], axis=-1).reshape(-1, 3)
    return directions, weights


def test_basis_is_orthonormal_over_projected_solid_angle():
    directions, weights = make_quadrature()
    values = evaluate_basis_at(make_basis(DEGREE), directions)
    product = (values * weights[:, np.newaxis]).T @ values
    assert np.abs(product - np.eye(len(product))).max() < 1e-12


def test_basis_functions_are_jacobi_polynomials():
    from scipy.special import eval_jacobi

    basis = make_basis(DEGREE)
    directions, _ = make_quadrature(7, 5)
    values = evaluate_basis_at(basis, directions)
    mu, phi = directions[:, 2], np.arctan2(directions[:, 1], directions[:, 0])
    row = 0
    for m, n_terms in enumerate(basis.n_per_m):
        for i in range(n_terms):
            expected = (
                (1.0 - mu) ** (0.5 * m) * np.cos(m * phi) * eval_jacobi(i, m, 1, 2.0 * mu - 1)
            )
            assert values[:, row] == pytest.approx(basis.norms[row] * expected, rel=1e-9, abs=1e-9)
            assert basis.degrees[row] == m + 2 * i
            row += 1
    assert row == basis.norms.size


def test_only_the_constant_term_has_an_integral():
    directions, weights = make_quadrature()
    values = evaluate_basis_at(make_basis(DEGREE), directions)
    integrals = weights @ values
    assert integrals[0] == pytest.approx(np.sqrt(np.pi), rel=1e-13)
    assert np.abs(integrals[1:]).max() < 1e-12


def make_exit_rows(directions, sides, orders, lengths):
    rows = allocate_exits(len(directions), 3)
    rows[:, EXIT_SIDE] = sides
    rows[:, EXIT_ORDER] = orders
    rows[:, EXIT_WEIGHT] = 1.0
    rows[:, EXIT_DIRECTION : EXIT_DIRECTION + 3] = directions
    rows[:, EXIT_LENGTH:] = lengths
    return rows


DIRECTIONS = np.array(
    [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.6, 0.0, -0.8], [0.0, -0.6, 0.8], [0.8, 0.0, 0.6]]
)
SIDES = [0, 0, 1, -1, 0]
ORDERS = [0, 1, 3, 1, 5]
ABSORPTION = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 100.0]])
LENGTHS = np.array([0.0, 0.0, 0.01])


def test_expansion_tally_by_side_order_and_wavelength():
    basis = make_basis(4)
    rows = make_exit_rows(DIRECTIONS, SIDES, ORDERS, LENGTHS)
    sums, unscattered = tally_expansion(rows, ABSORPTION, np.array([2, 4, 100]), basis)
    values = evaluate_basis_at(basis, DIRECTIONS)
    transmittance = np.array([1.0, np.exp(-1.0)])
    assert unscattered == pytest.approx(np.array([transmittance, [0.0, 0.0]]))
    for j, (ray, side) in enumerate(((1, 0), (2, 1), (4, 0))):
        assert sums[j, side] == pytest.approx(np.outer(transmittance, values[ray]))
        assert not sums[j, 1 - side].any()


def test_angular_bins_have_equal_projected_solid_angles():
    rows = make_exit_rows(DIRECTIONS, SIDES, ORDERS, LENGTHS)
    sums, unscattered = tally_angular_bins(rows, ABSORPTION, 5, 8, -1)
    transmittance = np.array([1.0, np.exp(-1.0)])
    assert unscattered[0, 0] == pytest.approx(transmittance)
    assert unscattered[1, 0] == pytest.approx(transmittance**2)
    # cos 0.8 and 0.6 lie in the fifth and fourth of five equal bins.
    assert sums[0, 0, :, 4, 0] == pytest.approx(transmittance)
    assert sums[0, 0, :, 3, 0] == pytest.approx(transmittance)
    assert sums[1, 1, :, 4, 0] == pytest.approx(transmittance**2)
    assert sums[0].sum() == pytest.approx(3.0 * transmittance.sum())
    polar, azimuth = compute_bin_centres((5, 8))
    assert np.cos(np.radians(polar)) == pytest.approx([0.9, 0.7, 0.5, 0.3, 0.1])
    assert azimuth.tolist() == [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]


def draw_coefficients(signal, noise, n_batches=64, seed=1):
    """Return coefficients of batches whose mean has the given noise."""
    random = np.random.default_rng(seed)
    scatter = random.normal(size=(n_batches, signal.size)) * noise * np.sqrt(n_batches)
    return signal + scatter


def test_noise_terms_are_not_selected():
    basis = make_basis(DEGREE)
    signal = np.zeros(basis.norms.size)
    signal[0] = 1.0
    counts = [
        select_terms(draw_coefficients(signal, 0.01, seed=seed), basis, False).sum()
        for seed in range(50)
    ]
    # The constant term and its neighbours, except for rare fluctuations.
    assert np.median(counts) == 4
    assert max(counts) < 40


def test_significant_terms_are_selected():
    basis = make_basis(DEGREE)
    signal = np.zeros(basis.norms.size)
    rows = {(m, i): row for row, (m, i) in enumerate(list_pairs(basis))}
    for m, i in ((0, 0), (0, 3), (1, 1), (4, 0)):
        signal[rows[m, i]] = 1.0
    coefficients = draw_coefficients(signal, 0.01)
    keep = select_terms(coefficients, basis, False)
    assert all(keep[rows[pair]] for pair in ((0, 0), (0, 3), (1, 1), (4, 0)))
    assert keep.sum() < 40
    keep_normal = select_terms(coefficients, basis, True)
    assert all(m == 0 for (m, _), row in rows.items() if keep_normal[row])
    assert VARIANCE_PENALTY > 1.0


def list_pairs(basis):
    return [(m, i) for m, n_terms in enumerate(basis.n_per_m) for i in range(n_terms)]


def evaluate_brdf(polar, azimuth):
    values = np.cos(np.radians(polar))[:, np.newaxis] + 0.01 * np.arange(len(azimuth))
    stderr = np.full(values.shape, 0.1)
    data = {
        "brdf": (("polar_deg", "azimuth_deg"), values),
        "brdf_stderr": (("polar_deg", "azimuth_deg"), stderr),
    }
    return xr.Dataset(data, {"polar_deg": polar, "azimuth_deg": azimuth})


def test_principal_plane_runs_from_backward_to_forward():
    dataset = evaluate_brdf(np.array([0.0, 30.0, 60.0]), np.array([0.0, 90.0, 180.0]))
    plane = select_principal_plane(dataset)
    assert plane.angle.values.tolist() == [-60.0, -30.0, 0.0, 30.0, 60.0]
    cosine = np.cos(np.radians([60.0, 30.0, 0.0, 30.0, 60.0]))
    assert plane.brdf.values == pytest.approx(cosine + np.array([0.02, 0.02, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match=r"azimuth_deg = .*with 0 and 180 degrees"):
        select_principal_plane(dataset.isel(azimuth_deg=[0, 1]))


def test_merged_bins_are_weighted_means():
    polar, azimuth = compute_bin_centres((6, 12))
    dataset = evaluate_brdf(polar, azimuth)
    merged = merge_angular_bins(dataset, 3)
    weight = np.cos(np.radians(polar))[:, np.newaxis]
    assert merged.brdf.shape == (2, 4)
    first = (weight * dataset.brdf.values)[:3][:, [11, 0, 1]].sum() / (3.0 * weight[:3].sum())
    assert float(merged.brdf[0, 0]) == pytest.approx(first)
    assert merged.azimuth_deg.values.tolist() == [0.0, 90.0, 180.0, 270.0]
    assert (merged.brdf_stderr < 0.1).all()
    with pytest.raises(ValueError, match="factor = 2: must be odd"):
        merge_angular_bins(dataset, 2)


def compute_truncated_power(ratio, per_noise, seed):
    """Return the truncation error above degree 24 of a power spectrum with a given decay.

    The power decreases by `ratio` every four degrees.  That of the last four is `per_noise` times
    its noise.
    """
    basis = make_basis(DEGREE)
    angles = make_direction_grid(np.array([0.0, 30.0, 60.0, 80.0]), np.array([0.0, 180.0]), basis)
    rng = np.random.default_rng(seed)
    amplitude = ratio ** (0.5 * (basis.degrees / 4.0)) * rng.choice([-1.0, 1.0], basis.degrees.size)
    fine = basis.degrees > DEGREE - 4
    error = np.sqrt((amplitude[fine] ** 2).sum() / np.sqrt(2.0 * fine.sum()) / per_noise)
    batches = amplitude + 8.0 * error * rng.standard_normal((64, amplitude.size))
    return estimate_truncation_error(np.stack([batches, batches], axis=1), False, angles)


def test_truncation_error_is_not_inflated_by_noise():
    seeds = range(40)
    precise, noisy = (
        [compute_truncated_power(0.25, signal_to_noise, seed).max() for seed in seeds]
        for signal_to_noise in (1e6, 6.0)
    )
    assert 0.0 < np.mean(noisy) < 1.5 * np.mean(precise)
    # A power spectrum without decay gives a large estimate.
    assert compute_truncated_power(1.0, 1e6, 0).max() > MAX_POWER_RATIO / (1.0 - MAX_POWER_RATIO)


STDERR = 0.01
DOUBLE_ANGLE = 0.7
N_DRAWS = 100_000


def draw_estimates(degree, seed):
    """Return estimates from Q and U with noise, of light of an intensity of 1."""
    rng = np.random.default_rng(seed)
    q, u = (
        degree * component + STDERR * rng.standard_normal(N_DRAWS)
        for component in (np.cos(DOUBLE_ANGLE), np.sin(DOUBLE_ANGLE))
    )
    mean = np.stack([np.ones(N_DRAWS), q, u])
    stderr = np.full_like(mean, STDERR) * [[0.0], [1.0], [1.0]]
    return compute_linear_polarization(mean, stderr, np.zeros((3, N_DRAWS)))


@pytest.mark.parametrize("degree_in_errors", [2.0, 3.0, 5.0, 20.0])
def test_the_bias_is_removed(degree_in_errors):
    estimate = draw_estimates(degree_in_errors * STDERR, 1)
    bias = estimate.degree.mean() / STDERR - degree_in_errors
    # √(Q² + U²) has a bias of 0.5 errors / the degree in errors.
    assert abs(bias) < 0.1
    assert estimate.degree.std() == pytest.approx(estimate.degree_stderr.mean(), rel=0.05)
    difference = (np.degrees(DOUBLE_ANGLE) / 2.0 - estimate.angle + 90.0) % 180.0 - 90.0
    z = difference / estimate.angle_stderr
    assert abs(z.mean()) < 5.0 / np.sqrt(N_DRAWS)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.1)


def test_unpolarized_light_is_within_the_error():
    estimate = draw_estimates(0.0, 2)
    assert estimate.degree.mean() == pytest.approx(STDERR, rel=0.02)
    assert estimate.angle_stderr.max() == MAX_ANGLE_STDERR_DEG
    assert ((estimate.angle >= 0.0) & (estimate.angle < 180.0)).all()


def test_noise_that_the_intensity_shares_cancels():
    """Q is exactly -I/5 in every sample: its degree has no error."""
    intensity, error = np.array([2.0]), np.array([0.3])
    zero = np.zeros(1)
    mean = np.stack([intensity, -0.2 * intensity, zero])
    stderr = np.stack([error, 0.2 * error, zero])
    estimate = compute_linear_polarization(mean, stderr, np.stack([-0.2 * error**2, zero, zero]))
    assert estimate.degree == pytest.approx(0.2)
    assert estimate.degree_stderr == pytest.approx(0.0, abs=1e-9)
    assert estimate.angle == pytest.approx(90.0)
    independent = compute_linear_polarization(mean, stderr, np.zeros((3, 1)))
    assert independent.degree_stderr == pytest.approx(0.2 * 0.15 * np.sqrt(2.0))


def test_no_light_has_no_known_polarization():
    zero = np.zeros((3, 1))
    estimate = compute_linear_polarization(zero, zero, zero)
    assert estimate.degree == 0.0 and estimate.degree_stderr == 1.0
    assert estimate.angle_stderr == MAX_ANGLE_STDERR_DEG


@pytest.mark.parametrize("value", [5e-324, 1e-200, 1e-12])
def test_noise_far_above_the_polarization_leaves_finite_values(value):
    mean, stderr = np.array([[1.0], [value], [0.0]]), np.full((3, 1), 0.1)
    estimate = compute_linear_polarization(mean, stderr, np.zeros((3, 1)))
    assert all(np.isfinite(one).all() for one in estimate)


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, 22.5, 45.0, 100.0])
def test_errors_do_not_depend_on_the_reference(angle_deg):
    """Light of rays of one direction of polarization, some of them depolarized.

    The degree scatters, and the direction does not.
    """
    degree, scatter = 0.4, 0.02
    cos, sin = np.cos(2.0 * np.radians(angle_deg)), np.sin(2.0 * np.radians(angle_deg))
    mean = np.array([[1.0], [degree * cos], [degree * sin]])
    stderr = scatter * np.abs([[0.0], [cos], [sin]])
    covariance = np.array([[0.0], [0.0], [scatter**2 * cos * sin]])
    estimate = compute_linear_polarization(mean, stderr, covariance)
    assert estimate.degree == pytest.approx(degree)
    assert estimate.degree_stderr == pytest.approx(scatter)
    assert estimate.angle == pytest.approx(angle_deg)
    assert estimate.angle_stderr == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("intensity", [0.0, 5e-324, 1e-200, 1e-99])
def test_hardly_any_light_leaves_finite_values(intensity):
    mean = intensity * np.array([[1.0], [0.5], [-0.5]])
    for stderr in (0.0, 1e-6):
        estimate = compute_linear_polarization(mean, np.full((3, 1), stderr), np.zeros((3, 1)))
        assert all(np.isfinite(one).all() for one in estimate)


WAVES = {"rms_height_m": 1.0, "wave_number_per_m": 0.1, "waves": 8, "correlation": "gaussian"}
WATER = splits.ParticleLayer(refractive_index=1.34, depth_m=100.0, surface=WAVES)


def test_a_flat_surface_does_not_focus():
    ds = splits.lens(
        WATER,
        screen_depth_m=[1.0, 10.0],
        radius_m=2.0,
        centre_on="origin",
        waves=[(0.0, 1.0, 0.0, 0.0)],
    )
    assert ds.contraction.values == pytest.approx(1.0, abs=1e-12)
    assert ds.concentration.values == pytest.approx(1.0, abs=1e-12)
    assert ds.detected_fraction.values == pytest.approx(1.0)


def test_crests_focus_and_troughs_defocus():
    crest, trough = (
        splits.lens(
            WATER,
            screen_depth_m=[20.0],
            radius_m=0.5,
            centre_on=centre,
            half_width_m=50.0,
            realizations=20,
        )
        for centre in ("crest", "trough")
    )
    for ds, sign in ((crest, 1.0), (trough, -1.0)):
        above = float(ds.concentration[0] - 1.0) * sign
        assert above > 3.0 * float(ds.concentration_stderr[0])


def test_one_realization_has_no_standard_error():
    ds = splits.lens(WATER, screen_depth_m=[5.0], radius_m=0.5, centre_on="origin", rays=12)
    assert "contraction_stderr" not in ds and ds.attrs["rays"] == 12


def test_surface_maps_have_the_expected_slopes():
    ds = splits.surface_map(WATER, half_width_m=200.0, points=81, realizations=200, seed=3)
    assert ds.height.shape == (81, 81)
    expected = WATER.surface.rms_slope()
    squares = ds.rms_slope.values**2
    stderr = squares.std(ddof=1) / np.sqrt(squares.size)
    assert abs(squares.mean() - expected**2) < 4.0 * stderr


def test_smooth_layers_are_rejected():
    for call in (lambda m: splits.lens(m, screen_depth_m=[1.0], radius_m=1.0, centre_on="origin"),
                 lambda m: splits.surface_map(m, half_width_m=1.0)):  # fmt: skip
        with pytest.raises(ValueError, match="surface = None"):
            call(splits.ParticleLayer())


LAYER = {"kind": "particle_layer", "depth_m": 100.0, "surface": WAVES}


@pytest.mark.parametrize(
    ("instrument", "grid"),
    [
        ({"kind": "surface_map", "half_width_m": 50.0, "realizations": 5}, {}),
        (
            {"kind": "lens", "radius_m": 1.0, "screen_depth_m": [5, 20, 40], "centre_on": "origin"},
            {"refractive_index": [1.34, 1.5]},
        ),
        ({"kind": "goniophotometer", "wavelength_nm": [550], "rays": 10_000}, {}),
        ({"wavelength_nm": [550]}, {"single_scattering_albedo": [0.5, 0.9]}),
    ],
)
def test_experiments_with_layers_run_and_are_drawn(instrument, grid):
    select = {name: str(values[0]) for name, values in grid.items()}
    kind = instrument.get("kind", "spectrophotometer")
    figure = {"select": select} if kind in ("surface_map", "lens") else {}
    figure |= {"kind": "points"} if kind == "spectrophotometer" else {}
    experiment = ExperimentConfig(
        name="made", medium=LAYER, instrument=instrument, grid=grid, figure=figure
    )
    accuracy = Accuracy(max_stderr=0.05, relative_stderr=0.3)
    dataset = run(experiment, accuracy, seed=1, threads=1)
    assert dataset.attrs["experiment"] == "made"
    assert draw(dataset, **experiment.resolve_figure()).axes


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"medium": {"kind": "particle_layer"},
          "instrument": {"kind": "surface_map", "half_width_m": 1}},
         "medium.surface = None: must be given for a map"),
        ({"instrument": {"kind": "surface_map", "half_width_m": 1}},
         "medium = 'snow': must be splits.ParticleLayer"),
        ({"medium": LAYER, "instrument": {"kind": "lens", "radius_m": 1}}, "screen_depth_m"),
        ({"medium": LAYER, "instrument": {"kind": "goniophotometer", "estimator": "next_event"}},
         "expansion or bins"),
        ({"medium": LAYER, "instrument": {"radius_m": 1}}, "left out for spectrophotometer"),
        ({"medium": {"kind": "particle_layer", "density_kg_m3": 3}}, "density_kg_m3"),
        ({"medium": {"kind": "particle_layer", "optical_thickness": "inf"}}, ".inf in YAML"),
        ({"medium": LAYER, "instrument": {"kind": "surface_map", "half_width_m": 1},
          "grid": {"refractive_index": [1.3, 1.5]}}, "select = "),
        ({"figure": {"quantity": "brdf"}}, "figure.quantity = 'brdf'"),
        ({"medium": {"kind": "particle_layer",
                     "surface": {"rms_height_m": 1, "wave_number_per_m": 1}}},
         "band_limit_per_m"),
    ],
)  # fmt: skip
def test_invalid_experiments_are_rejected(content, message):
    with pytest.raises((ValueError, TypeError), match=message):
        experiment = validate_content(ExperimentConfig, {"name": "made", **content})
        draw(run(experiment, COARSE, threads=1), **experiment.resolve_figure())
