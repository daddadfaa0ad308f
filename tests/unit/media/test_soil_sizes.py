"""Sizes by soil separate: SPLITS section 4.2.6, Eqs 19-25, and invalid textures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate, stats

from splits import Sand
from splits.media.grain_statistics import N_TABLE_POINTS
from splits.media.sand_composition import TruncatedLogNormal, make_size_distribution

LIMITS = {"clay": (5e-8, 2e-6), "silt": (2e-6, 5e-5), "sand": (5e-5, 2e-3)}
TAIL = 1e-4
TEXTURES = {
    "Table 5": (0.0, 0.15, 0.85),
    "sand alone": (0.0, 0.0, 1.0),
    "all three": (0.01, 0.135, 0.855),
    "no silt": (0.1, 0.0, 0.9),
}
# Clay slightly above the tail: the log-normal is so wide that only its slope remains.
SMALL_CLAY_TEXTURES = {
    gap: (TAIL * (1.0 + gap), 0.0, 1.0 - TAIL * (1.0 + gap)) for gap in (1e-14, 1e-9, 1e-3)
}
ALL_TEXTURES = {**TEXTURES, **SMALL_CLAY_TEXTURES}


def evaluate_density(piece: TruncatedLogNormal, s):
    """Return f_g(s) of Eq 19."""
    score = (np.log(s) - piece.log_mean) / piece.log_sd
    return np.exp(-0.5 * score**2) / (piece.log_sd * np.sqrt(2.0 * np.pi))


def integrate_power(piece: TruncatedLogNormal, power: float):
    """Return ∫ s^power f_g(s) ds over the piece, by adaptive quadrature in sections."""
    edges = np.geomspace(piece.min_size_m, piece.max_size_m, 9)
    return sum(
        integrate.quad(
            lambda s: s**power * evaluate_density(piece, s), a, b, epsabs=0.0, epsrel=1e-11
        )[0]
        for a, b in pairwise(edges)
    )


@pytest.mark.parametrize("name", TEXTURES)
def test_separates_have_the_cumulative_mass_at_their_limits(name):
    texture = TEXTURES[name]
    bounds = np.clip([TAIL, *np.cumsum(texture)], TAIL, 1.0 - TAIL)
    pieces = make_size_distribution(texture).separates
    present = [i for i, mass in enumerate(texture) if mass > 0.0]
    assert [(p.min_size_m, p.max_size_m) for p in pieces] == [
        list(LIMITS.values())[i] for i in present
    ]
    for piece, i in zip(pieces, present, strict=True):
        normal = stats.norm(piece.log_mean, piece.log_sd)
        assert normal.cdf(np.log(piece.min_size_m)) == pytest.approx(bounds[i], rel=1e-9)
        assert normal.cdf(np.log(piece.max_size_m)) == pytest.approx(bounds[i + 1], rel=1e-9)
        assert piece.mass_fraction == pytest.approx(texture[i], rel=1e-12)
    assert sum(p.mass_fraction for p in pieces) == pytest.approx(1.0, abs=1e-15)


def test_silt_and_sand_of_table_5_match_hand_calculation():
    """Scores Φ⁻¹ of 1e-4, 0.15 and 1 − 1e-4, from tables of the normal distribution."""
    low, middle = -3.719016485455709, -1.0364333894937898
    silt, sand = make_size_distribution((0.0, 0.15, 0.85)).separates
    assert silt.log_sd == pytest.approx(np.log(25.0) / (middle - low), rel=1e-12)
    assert silt.log_mean == pytest.approx(np.log(2e-6) - silt.log_sd * low, rel=1e-12)
    assert sand.log_sd == pytest.approx(np.log(40.0) / (-low - middle), rel=1e-12)
    assert sand.log_mean == pytest.approx(np.log(2e-3) + sand.log_sd * low, rel=1e-12)


@pytest.mark.parametrize("name", TEXTURES)
def test_mean_inverse_size_matches_eq_23(name):
    sizes = make_size_distribution(TEXTURES[name])
    for piece in sizes.separates:
        exact = integrate_power(piece, -2.0) / integrate_power(piece, -1.0)
        assert piece.mean_inverse_size_per_m == pytest.approx(exact, rel=1e-9)
        assert 1.0 / piece.max_size_m < piece.mean_inverse_size_per_m < 1.0 / piece.min_size_m
    expected = sum(
        p.mass_fraction * integrate_power(p, -2.0) / integrate_power(p, -1.0)
        for p in sizes.separates
    )
    assert sizes.size_attenuation_per_m == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", TEXTURES)
def test_masses_of_eq_20_match_the_texture(name):
    """Each separate has its mass between its limits; the outermost ones lack the tail."""
    texture = TEXTURES[name]
    for piece in make_size_distribution(texture).separates:
        assert integrate_power(piece, -1.0) == pytest.approx(piece.mass_fraction, abs=2.0001 * TAIL)
    total = sum(integrate_power(p, -1.0) for p in make_size_distribution(texture).separates)
    assert total == pytest.approx(1.0 - 2.0 * TAIL, rel=1e-9)


@pytest.mark.parametrize("name", TEXTURES)
def test_hit_sizes_of_a_separate_follow_eq_25(name):
    for piece in make_size_distribution(TEXTURES[name]).separates:
        median = float(piece.compute_hit_sizes(np.array([0.5]))[0])
        total = integrate_power(piece, -2.0)
        below = integrate.quad(
            lambda x, p=piece: np.exp(-x) * evaluate_density(p, np.exp(x)),
            np.log(piece.min_size_m),
            np.log(median),
        )[0]
        assert below / total == pytest.approx(0.5, abs=1e-6)
        assert piece.compute_hit_sizes(np.array([0.0, 1.0])) == pytest.approx(
            [piece.min_size_m, piece.max_size_m]
        )


@pytest.mark.parametrize("name", ALL_TEXTURES)
@pytest.mark.parametrize("pieces", ["separates", "single"])
def test_hit_sizes_decrease_monotonically(name, pieces):
    if (name, pieces) == ("sand alone", "single"):
        with pytest.raises(
            ValueError, match=r"interpretation\.size_distribution = 'single'.*one separate alone"
        ):
            make_size_distribution(ALL_TEXTURES[name], TAIL, pieces)
        return
    sizes = make_size_distribution(ALL_TEXTURES[name], TAIL, pieces)
    table = sizes.tabulate_hit_inverse_sizes()
    assert table.shape == (N_TABLE_POINTS,)
    assert np.isfinite(table).all() and (np.diff(table) > 0.0).all()
    largest, smallest = 1.0 / table[[0, -1]]
    assert largest == pytest.approx(sizes.largest_m) == pytest.approx(2e-3)
    assert smallest >= sizes.separates[0].min_size_m * (1.0 - 1e-12)


@pytest.mark.parametrize("gap", SMALL_CLAY_TEXTURES)
def test_clay_slightly_above_the_tail(gap):
    """A very wide log-normal is uniform in log size: ∫ s⁻² ds over ∫ s⁻¹ ds, up to a slope.

    The score changes by gap·tail/φ(score) over the separate, and f_g by score times that.
    """
    sizes = make_size_distribution(SMALL_CLAY_TEXTURES[gap])
    clay, sand = sizes.separates
    low, high = LIMITS["clay"]
    expected = (1.0 / low - 1.0 / high) / np.log(high / low)
    assert np.isfinite([clay.log_mean, clay.log_sd, clay.mean_inverse_size_per_m]).all()
    assert clay.mean_inverse_size_per_m == pytest.approx(expected, rel=gap + 1e-9)
    assert clay.mass_fraction == pytest.approx(
        TAIL, rel=2e-3
    ) and sand.mass_fraction == pytest.approx(1.0 - TAIL)
    median = float(clay.compute_hit_sizes(np.array([0.5]))[0])
    assert median == pytest.approx(2.0 / (1.0 / low + 1.0 / high), rel=1e-3)


def test_clay_below_the_tail_is_omitted():
    for clay in (0.0, 0.5 * TAIL, TAIL):
        sizes = make_size_distribution((clay, 0.0, 1.0 - clay))
        (sand,) = sizes.separates
        assert (sand.min_size_m, sand.max_size_m) == LIMITS["sand"] and sand.mass_fraction == 1.0
        assert sizes.size_attenuation_per_m == pytest.approx(
            make_size_distribution((0.0, 0.0, 1.0)).size_attenuation_per_m, rel=1e-4
        )
    assert len(make_size_distribution((TAIL, 0.0, 1.0 - TAIL), tail_mass=1e-5).separates) == 2


@pytest.mark.parametrize("texture", [(0.0, 0.15, 0.85), (0.01, 0.135, 0.855), (0.1, 0.0, 0.9)])
def test_one_log_normal_over_all_separates(texture):
    """Shirazi & Boersma 1984: mass-weighted mean and deviation of ln of the separate centres."""
    middle = np.log([1e-6, 26e-6, 1.025e-3])
    mean = np.dot(texture, middle)
    (piece,) = make_size_distribution(texture, size_model="single").separates
    assert piece.log_mean == pytest.approx(mean, rel=1e-12)
    assert piece.log_sd == pytest.approx(np.sqrt(np.dot(texture, (middle - mean) ** 2)), rel=1e-9)
    assert (piece.min_size_m, piece.max_size_m) == (5e-8 if texture[0] else 2e-6, 2e-3)
    assert piece.mass_fraction == 1.0
    exact = integrate_power(piece, -2.0) / integrate_power(piece, -1.0)
    assert piece.mean_inverse_size_per_m == pytest.approx(exact, rel=1e-9)


def test_finer_soils_attenuate_more():
    by_texture = [(0.0, 0.0, 1.0), (0.0, 0.05, 0.95), (0.0, 0.15, 0.85), (0.01, 0.135, 0.855)]
    attenuation = [make_size_distribution(texture).size_attenuation_per_m for texture in by_texture]
    assert (np.diff(attenuation) > 0.0).all()


@pytest.mark.parametrize(
    ("texture", "message"),
    [
        ((0.0, 0.2, 0.8), r"silt \+ 1.5 clay at most 0.15"),
        ((0.11, 0.0, 0.89), r"silt \+ 1.5 clay at most 0.15"),
        ((0.0, 0.1, 0.8), "add up to 1"),
        ((-0.1, 0.2, 0.9), "add up to 1"),
        ((0.1, 0.9), r"3 numbers \(clay, silt, sand\)"),
    ],
)
def test_textures_other_than_sand_are_rejected(texture, message):
    with pytest.raises(ValueError, match=rf"^texture.*{message}") as error:
        Sand(texture=texture)
    assert repr(texture) in str(error.value)


def test_other_invalid_textures_are_rejected():
    for tail in (1e-7, 0.02):
        with pytest.raises(ValueError, match=rf"^size_tail = {tail}: must be in \[1e-06, 0.01\]"):
            make_size_distribution((0.0, 0.15, 0.85), tail)
    with pytest.raises(
        ValueError, match=r"^interpretation.size_distribution = 'single': .*'separates'"
    ):
        make_size_distribution((0.0, 0.0, 1.0), size_model="single")
    make_size_distribution((0.1, 0.0, 0.9))
    make_size_distribution((0.0, 0.15 + 1e-10, 0.85 - 1e-10))
