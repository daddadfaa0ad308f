"""Fluxes and absorbed light inside media, and transmission from layers to detectors."""

import numpy as np
import pytest

import splits
from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.detector_tally import compute_refracted_cosines, compute_transmission
from splits.instruments.flux_media import CHORD_ERROR, PathRatio, compute_absorption_steps
from splits.instruments.flux_tally import (
    MIN_EFFECTIVE_BATCHES,
    FluxTarget,
    allocate_flux_rays,
    bound_unsampled_light,
    estimate_rare_event_error,
    estimate_unseen_reflection,
    make_variance_terms,
)
from splits.instruments.radiation_profile import make_sky_targets
from splits.kernels.interface import compute_fresnel_mueller
from splits.kernels.records import N_BATCHES
from splits.kernels.transport.next_event import ABOVE, BELOW, DOWNWARD, UPWARD
from splits.media.stack import absorb_along_path
from splits.simulation.scene import compute_optical_constants
from splits.simulation.strata import Stratum
from splits.simulation.tally import UNSEEN_RAYS

RANDOM = np.random.default_rng(1)
ROWS = np.array([0, 1, 2, 1, 2, 3])
"""Wavelengths of the node rows: three of the first node, three of the second."""
CONTRIBUTES = np.array([[1, 1, 1, 0, 0, 0], [0, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]], dtype=bool)
"""The first node has two strata, the second has one."""
VALUES = RANDOM.random((N_BATCHES, 3, 6))


def make_uncorrelated_values():
    """Return values whose scatter is not correlated between node rows of different strata."""
    contrasts = np.linalg.qr(np.column_stack([np.ones(N_BATCHES), RANDOM.random((N_BATCHES, 3))]))
    pattern = np.array([1, 2, 2, 3, 3, 3])
    return contrasts.Q[:, np.newaxis, pattern] * RANDOM.random((3, 6))


def test_variance_terms_of_bands_add_up():
    target = FluxTarget(True, RANDOM.random((2, 4)), np.ones(2))
    terms = make_variance_terms(target, VALUES, ROWS, CONTRIBUTES)
    # The first wavelength uses one stratum of the first node, the next two use both.
    node_rows_by_strata = {(1, 0, 0): [0], (1, 1, 0): [1, 2], (0, 0, 1): [3, 4, 5]}
    columns = [
        terms.columns[(one == terms.contributes.T).all(axis=1)] for one in node_rows_by_strata
    ]
    assert [sorted(one) for one in columns] == [[0, 1]] * 3
    assert terms.variances.shape == (3, 6)
    for strata, node_rows in node_rows_by_strata.items():
        by_band = VALUES[..., node_rows] @ target.band_weights[:, ROWS[node_rows]].T
        for band in range(2):
            term = (strata == terms.contributes.T).all(axis=1) & (terms.columns == band)
            np.testing.assert_allclose(
                terms.variances[:, term], compute_batch_stderr(by_band[..., [band]]) ** 2
            )
    uncorrelated = make_uncorrelated_values()
    terms = make_variance_terms(target, uncorrelated, ROWS, CONTRIBUTES)
    by_wavelength = np.zeros((N_BATCHES, 3, 4))
    np.add.at(by_wavelength, (..., ROWS), uncorrelated)
    np.testing.assert_allclose(
        terms.sum_columns(terms.variances),
        compute_batch_stderr(target.average_over_bands(by_wavelength)) ** 2,
    )


def test_variance_terms_of_wavelengths_are_node_rows():
    terms = make_variance_terms(FluxTarget(), VALUES, ROWS, CONTRIBUTES)
    np.testing.assert_array_equal(terms.contributes, CONTRIBUTES)
    np.testing.assert_array_equal(terms.columns, ROWS)
    np.testing.assert_allclose(terms.variances, compute_batch_stderr(VALUES) ** 2)


def test_rays_are_allocated_by_variance():
    """A wavelength that uses one node only needs no rays of the other."""
    strata = [Stratum(i, None, slice(0), None, n_rays=1024, n_segments=10 * 1024) for i in range(2)]
    scatter = (
        RANDOM.standard_normal((2, N_BATCHES, 1, 3))
        * np.array([[1, 0.5, 0], [0, 0.5, 1]])[:, np.newaxis, np.newaxis]
    )
    error = scatter.sum(axis=0).std(axis=0, ddof=1).max() / np.sqrt(N_BATCHES)
    values = 0.1 + np.concatenate([scatter[0][..., :2], scatter[1][..., 1:]], axis=-1)
    contributes = np.array([[1, 1, 0, 0], [0, 0, 1, 1]], dtype=bool)
    max_variance = np.full((1, 3), (error / 2.0) ** 2)
    n_rays = allocate_flux_rays(
        FluxTarget(False), strata, values, np.array([0, 1, 1, 2]), contributes, max_variance
    )
    assert (n_rays > 1.5 * 1024).all()
    assert (n_rays < 6.0 * 1024).all()


def test_irradiances_are_optional_in_the_target():
    # Two irradiances at three depths, and absorptances of two intervals.
    quantities = RANDOM.random((N_BATCHES, 8, 4))
    np.testing.assert_array_equal(FluxTarget().select_quantities(quantities, 3), quantities)
    rows = FluxTarget(limit_irradiance=False).select_quantities(quantities, 3)
    np.testing.assert_array_equal(rows, quantities[:, [3, 6, 7]])


def test_variance_fractions_of_direct_and_diffuse_light_add_up():
    direct_fraction, weights = RANDOM.random(4), RANDOM.random((2, 4))
    direct, diffuse = make_sky_targets(direct_fraction, weights, limit_irradiance=False)
    np.testing.assert_allclose(direct.variance_fractions + diffuse.variance_fractions, 1.0)


def test_unsampled_light_is_bounded_by_the_plane_above():
    downward = np.zeros((N_BATCHES, 4, 1))
    downward[:, 0], downward[:, 1] = 1.0, 1e-6
    lower_bound = np.array([1e-3])
    expected = [1e-3, 1e-3, 4e-6, 4e-6, 4e-6]
    np.testing.assert_allclose(bound_unsampled_light(downward, lower_bound)[:, 0], expected)


def test_rare_event_error_accounts_for_few_batches():
    none, one, every = np.zeros((N_BATCHES, 1)), np.zeros((N_BATCHES, 1)), np.ones((N_BATCHES, 1))
    one[0] = 1.0
    skewed = np.full((N_BATCHES, 1), 1e-6)
    skewed[: MIN_EFFECTIVE_BATCHES - 2] = 1.0
    bound = np.array([0.01])
    assert estimate_rare_event_error(none, bound) == 0.01
    assert estimate_rare_event_error(one, bound) == np.hypot(0.01, 1.0 / N_BATCHES)
    assert estimate_rare_event_error(skewed, bound) == np.hypot(0.01, 1.0 / N_BATCHES)
    assert estimate_rare_event_error(every, bound) == 0.0


def test_upward_light_without_scatter_has_the_error_of_unseen_reflections():
    """Where all light is reflected, no ray can add to it."""
    downward = np.ones((N_BATCHES, 3, 1))
    upward = np.full((N_BATCHES, 3, 1), 1e-9)
    upward[:, 1], upward[:, 2] = 1.0, 0.5
    upward[: N_BATCHES // 2, 2] = 0.4
    error = estimate_unseen_reflection(downward, upward, np.full((3, 1), 1e-3))
    np.testing.assert_allclose(error[:, 0], [np.sqrt(UNSEEN_RAYS) * 1e-3, 0.0, 0.0], atol=1e-9)


WAVELENGTHS = np.array([900.0, 1500.0])
MEDIA = {
    "snow": splits.Snow(depth_m=0.1),
    "wet snow": splits.Snow(depth_m=0.1, saturation=0.3),
    "natural snow": splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1),
}


@pytest.mark.parametrize("name", MEDIA)
def test_steps_are_those_of_one_segment_and_one_grain(name):
    """The pore fraction of a segment is path; light that is left at its end hits a grain."""
    medium = MEDIA[name]
    absorption = compute_optical_constants(medium, WAVELENGTHS).absorption
    optical_depth, absorption_rate = compute_absorption_steps(
        medium, absorption, np.array([0.0, 0.05, 0.1])
    )
    segment, chord = medium.mean_free_path_m, medium.mean_chord_m
    wet = medium.wet_fraction
    depths = absorption[:, [0, 1, -1]] * [segment, segment, chord]
    left = np.exp(-depths)
    part = np.where(depths > 0.0, (1.0 - left) / np.maximum(depths, 1e-300), 1.0)
    reaches = (1.0 - wet) * left[:, 0] + wet * left[:, 1]
    path = segment * medium.pore_fraction * ((1.0 - wet) * part[:, 0] + wet * part[:, 1])
    path += reaches * chord * part[:, 2]
    rate = (1.0 - reaches * left[:, 2]) / path
    np.testing.assert_allclose(absorption_rate, [rate] * 2, rtol=1e-9)
    is_present = [True, wet > 0.0, True]
    np.testing.assert_allclose(optical_depth, [depths[:, is_present].max(axis=1)] * 2, rtol=1e-12)


def test_mean_chords_are_close_to_single_scattering_where_steps_are_large():
    """`CHORD_ERROR` is that of natural snow at the absorption above which chords are used."""
    medium, wavelengths = MEDIA["natural snow"], np.array([1450.0, 1500.0, 1950.0, 2500.0])
    exact = PathRatio.from_medium(medium, wavelengths, 0.005, threads=1)
    absorption = compute_optical_constants(medium, wavelengths).absorption
    optical_depth, absorption_rate = compute_absorption_steps(
        medium, absorption, np.array([0.0, 0.1])
    )
    ratio = 1.0 / (absorption_rate * exact.value)
    large = optical_depth > 0.48
    assert large.any() and (np.abs(ratio - 1.0)[large] <= CHORD_ERROR).all()
    assert (exact.relative_error < 0.01).all() and not exact.by_rays.any()


def test_ratios_of_particles_and_of_transparent_layers():
    layer = splits.ParticleLayer(optical_thickness=3.0, single_scattering_albedo=0.75, depth_m=0.5)
    ratio = PathRatio.from_medium(absorb_along_path(layer), WAVELENGTHS, 0.005, threads=1)
    np.testing.assert_allclose(ratio.value, 1.0 / (0.25 * 6.0), rtol=1e-12)
    assert (ratio.relative_error == 0.0).all() and not ratio.by_rays.any()
    clear = splits.Snow(depth_m=0.1, refractive_index={"ice": 1.31}, saturation=0.0)
    ratio = PathRatio.from_medium(clear, WAVELENGTHS, 0.005, threads=1)
    assert np.isinf(ratio.value).all() and ratio.by_rays.all()
    wet = PathRatio.from_medium(MEDIA["wet snow"], WAVELENGTHS, 0.005, threads=1)
    assert wet.by_rays[0, 0] and np.isfinite(wet.value).all()


POLAR = np.radians([0.0, 20.0, 56.3, 85.0])


def compute_fluxes(index, thickness, polarized=True, has_lower_side=True):
    """Return the transmission as energy flux: without the ratio of solid angles."""
    index = np.array(index)
    values = compute_transmission(index, np.array(thickness), POLAR, has_lower_side, polarized)
    cosine = np.sqrt(1.0 - (np.sin(POLAR) / index[:, np.newaxis]) ** 2)
    return values * (index[:, np.newaxis] ** 2 * cosine)[..., np.newaxis]


def get_factors(n1, n2, polar):
    """Return reflectances and transmittances of I + Q, I − Q, and U, for light from outside."""
    mueller = compute_fresnel_mueller(n1, n2, np.cos(polar))
    (plus, minus, real, _), (t_plus, t_minus, root, _) = mueller.reflection, mueller.transmission
    return (np.array([plus + minus, plus - minus, real]),
            np.array([t_plus + t_minus, t_plus - t_minus, root]))  # fmt: skip


def test_cosines_are_accurate_at_grazing_directions():
    polar = np.radians([89.9, 89.9999999, 89.999999999999])
    cosines = compute_refracted_cosines(np.array([1.0, 1.3]), polar)
    np.testing.assert_allclose(cosines[0], np.cos(polar), rtol=1e-15)
    np.testing.assert_allclose(cosines[1], np.sqrt(0.69 + np.cos(polar) ** 2) / 1.3, rtol=1e-14)


def test_one_layer_has_geometric_series():
    thickness = 0.3
    values = compute_fluxes([1.5], [thickness])
    for k, polar in enumerate(POLAR):
        reflected, transmitted = get_factors(1.0, 1.5, polar)
        direct = np.exp(-thickness / np.sqrt(1.0 - (np.sin(polar) / 1.5) ** 2))
        series = transmitted / (1.0 - (reflected * direct) ** 2)
        np.testing.assert_allclose(values[ABOVE, UPWARD, 0, k], series, rtol=1e-12)
        np.testing.assert_allclose(values[BELOW, DOWNWARD, 0, k], series, rtol=1e-12)
        other_side = series * reflected * direct
        np.testing.assert_allclose(values[BELOW, UPWARD, 0, k], other_side, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(
            values[ABOVE, DOWNWARD, 0, k], other_side, rtol=1e-12, atol=1e-15
        )


@pytest.mark.parametrize("polarized", [False, True])
def test_energy_leaves_clear_layers(polarized):
    values = compute_fluxes([1.33, 1.0, 1.6, 1.2], [0.0] * 4, polarized)
    np.testing.assert_allclose(values[..., :2].sum(axis=0), 1.0, rtol=1e-12)


def test_layers_of_one_index_attenuate_only():
    thickness = np.array([0.5, 1.0, 0.2])
    values = compute_fluxes([1.0, 1.0, 1.0], thickness)
    above = np.cumsum([0.0, *thickness[:-1]])
    expected = np.exp(-above[:, np.newaxis] / np.cos(POLAR))
    np.testing.assert_allclose(values[ABOVE, UPWARD, :, :, 0], expected, rtol=1e-12)
    assert (values[ABOVE, DOWNWARD] == 0.0).all() and (values[BELOW, UPWARD] == 0.0).all()


def test_a_closed_lower_side_neither_transmits_nor_reflects():
    values = compute_fluxes([1.5], [0.3], has_lower_side=False)
    assert (values[BELOW] == 0.0).all() and (values[ABOVE, DOWNWARD] == 0.0).all()
    for k, polar in enumerate(POLAR):
        _, transmitted = get_factors(1.0, 1.5, polar)
        np.testing.assert_allclose(values[ABOVE, UPWARD, 0, k], transmitted, rtol=1e-12)


def test_infinite_layers_have_no_light_from_below():
    values = compute_fluxes([1.5, 1.3], [0.3, np.inf], has_lower_side=False)
    assert np.isfinite(values).all() and (values[ABOVE, UPWARD] > 0.0)[..., :2].all()


def test_transmission_through_a_stack_is_reciprocal():
    """Light from the layer to a side equals light from that side into the layer, reversed."""
    index, thickness = [1.33, 1.6, 1.1], [0.3, 0.1, 0.7]
    values = compute_fluxes(index, thickness)
    turned = compute_fluxes(index[::-1], thickness[::-1])
    np.testing.assert_allclose(values[ABOVE, UPWARD], turned[BELOW, DOWNWARD, ::-1], rtol=1e-12)
