"""Pulses, bins of delay, receivers, and the order of scattering at which paths end."""

import math

import numpy as np
import pytest

import splits
from splits.instruments.delay_record import (
    DEFAULT_EDGES_S,
    FWHM_PER_SIGMA,
    Pulse,
    check_record,
    compute_max_order,
    make_receiver,
)
from splits.kernels.scene import NO_MAX_ORDER
from splits.simulation.scene import build_scene


def compute_moments(pulse):
    """Return the mean and the variance of a pulse."""
    middle = 0.5 * (pulse.delay_s[1:] + pulse.delay_s[:-1])
    light = np.diff(pulse.emitted)
    mean = (light * middle).sum()
    return mean, (light * (middle - mean) ** 2).sum()


def test_gaussian_pulses_have_their_width():
    mean, variance = compute_moments(Pulse.from_argument(2e-9))
    np.testing.assert_allclose(mean, 0.0, atol=1e-15)
    # A Gaussian that ends at four standard deviations.
    np.testing.assert_allclose(variance, (2e-9 / FWHM_PER_SIGMA) ** 2, rtol=2e-3)


def test_tabulated_pulses_are_centred():
    pulse = Pulse.from_argument({"delay_s": [5e-9, 6e-9, 8e-9], "power": [0.0, 3.0, 0.0]})
    mean, variance = compute_moments(pulse)
    np.testing.assert_allclose(mean, 0.0, atol=1e-14)
    # Of a triangle from 0 over 1 to 3.
    np.testing.assert_allclose(variance, (0.0 + 1.0 + 9.0 - 3.0) / 18.0 * 1e-18, rtol=1e-3)
    assert pulse.emitted[0] == 0.0 and pulse.emitted[-1] == 1.0


def test_pulses_with_fast_parts_keep_their_light():
    table = {"delay_s": [0.0, 1e-11, 2e-11, 1e-10], "power": [0.0, 10.0, 0.0, 1.0]}
    pulse = Pulse.from_argument(table)
    # Triangles of 10 and 4 units of light, at 1/10 and 11/15 of the duration.
    mean = (10.0 * 1e-11 + 4.0 * (2e-11 + 8e-11 * 2.0 / 3.0)) / 14.0
    np.testing.assert_allclose(pulse.delay_s[0], -mean, rtol=1e-6)
    np.testing.assert_allclose(np.interp(2e-11 - mean, *pulse), 10.0 / 14.0, rtol=1e-3)


def test_records_may_be_unlimited():
    instant = Pulse.from_argument(None)
    edges, end = check_record([0.0, 1e-9], math.inf, instant)
    assert edges.tolist() == [0.0, 1e-9] and end == math.inf
    edges, end = check_record(None, None, instant)
    assert edges is DEFAULT_EDGES_S and end == edges[-1]
    with pytest.raises(ValueError, match="at least two delays"):
        check_record([1e-9], math.inf, instant)


def test_receivers_look_along_the_beam():
    receiver = make_receiver(30.0, 5.0, None)
    np.testing.assert_allclose(receiver.direction, [-0.5, 0.0, math.sqrt(0.75)])
    np.testing.assert_allclose(receiver.min_cosine, math.cos(math.radians(5.0)))
    assert make_receiver("diffuse", None, None).min_cosine < -1.0


@pytest.mark.parametrize("ground", [None, 0.5])
def test_paths_end_after_the_record(ground):
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1, ground=ground)
    layers, receiver = build_scene(snow, 0.0, False).layers, make_receiver(0.0, None, None)
    orders = [compute_max_order(snow, layers, receiver, end) for end in (1e-10, 1e-9, math.inf)]
    collisions = 1e-9 * 299_792_458.0 * snow.extinction_per_m / snow.pore_fraction
    assert collisions < orders[1] < (1.6 if ground is None else 3.2) * collisions
    assert orders[0] < orders[1] < orders[2] == NO_MAX_ORDER


@pytest.mark.parametrize(
    "call",
    [
        lambda: check_record(np.linspace(0.0, 10.0, 11), None, Pulse.from_argument(None)),
        lambda: check_record([0.0, 1e300], None, Pulse.from_argument(None)),
        lambda: Pulse.from_argument(1e300),
        lambda: Pulse.from_argument(2.0),
        lambda: Pulse.from_argument({"delay_s": [0.0, 1e300], "power": [1.0, 1.0]}),
        lambda: Pulse.from_argument({"delay_s": [-5.0, 5.0], "power": [1.0, 1.0]}),
    ],
)
def test_delays_in_nanoseconds_are_refused(call):
    with pytest.raises(ValueError, match=r"must be in .*0\.001\] s \(in nanoseconds\?"):
        call()


def test_bins_have_a_width():
    with pytest.raises(ValueError, match=r"delay_s = \[0\.0, 5e-324\]: must be at least 1e-18 s"):
        check_record([0.0, 5e-324], None, Pulse.from_argument(None))
