"""Mixing rules: Maxwell Garnett against hand computations and limits, and the linear mean."""

import numpy as np
import pytest

from splits.materials import MIXING_RULES, linear_mixing, make_refractive_index, maxwell_garnett

QUARTZ, HEMATITE = 1.55 + 0j, 3.0 + 0.5j
PAIRS = [(QUARTZ, HEMATITE), (HEMATITE, QUARTZ), (1.33 + 1e-9j, 1.2 + 2.0j), (1.56 + 5e-4j, 1.55)]
RULES = list(MIXING_RULES.values())


def test_hand_calculation_without_absorption():
    """ε_m = 4, ε_i = 16, f = ½: 4 (24 + 12) / (24 − 6) = 8."""
    assert complex(maxwell_garnett(2.0, 4.0, 0.5)) == pytest.approx(np.sqrt(8.0))
    assert complex(linear_mixing(2.0, 4.0, 0.5)) == pytest.approx(3.0)


def test_hand_calculation_with_absorption():
    """ε_m = 1, ε_i = (1 + i)² = 2i, f = 1/5: (2.8i + 1.6) / (1.6i + 2.2)."""
    epsilon = (1.6 + 2.8j) / (2.2 + 1.6j)
    assert complex(maxwell_garnett(1.0, 1.0 + 1.0j, 0.2)) ** 2 == pytest.approx(epsilon)
    assert complex(linear_mixing(1.0, 1.0 + 1.0j, 0.2)) == pytest.approx(1.0 + 0.2j)


def test_clausius_mossotti_relation():
    """(ε − ε_m)/(ε + 2ε_m) is that of the inclusions times their fraction."""
    f = np.linspace(0.0, 1.0, 11)
    matrix, inclusion = QUARTZ**2, HEMATITE**2
    epsilon = maxwell_garnett(QUARTZ, HEMATITE, f) ** 2
    expected = f * (inclusion - matrix) / (inclusion + 2.0 * matrix)
    np.testing.assert_allclose((epsilon - matrix) / (epsilon + 2.0 * matrix), expected, atol=1e-14)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("matrix", "inclusion"), PAIRS)
def test_pure_materials_keep_their_index(rule, matrix, inclusion):
    assert rule(matrix, inclusion, 0.0) == matrix
    assert complex(rule(matrix, inclusion, 1.0)) == pytest.approx(inclusion, rel=1e-12, abs=1e-12)
    assert complex(rule(matrix, matrix, 0.3)) == pytest.approx(matrix, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("matrix", "inclusion"), PAIRS)
def test_mixtures_are_passive(rule, matrix, inclusion):
    m = rule(matrix, inclusion, np.linspace(0.0, 1.0, 101))
    assert (m.real > 0.0).all() and (m.imag >= 0.0).all()


@pytest.mark.parametrize("rule", RULES)
def test_transparent_mixtures_stay_transparent(rule):
    f = np.linspace(0.0, 1.0, 101)
    m = rule(1.55, 2.4, f)
    assert (m.imag == 0.0).all()
    assert (np.diff(m.real) > 0.0).all()


def test_exchange_of_matrix_and_inclusion_is_second_order():
    """The Hashin-Shtrikman bounds coincide for equal materials."""
    for contrast, tolerance in ((0.1, 1e-4), (0.01, 1e-7)):
        inclusion_mixture = maxwell_garnett(1.5, 1.5 + contrast, 0.3)
        inverted_mixture = maxwell_garnett(1.5 + contrast, 1.5, 0.7)
        assert 0.0 < inverted_mixture.real - inclusion_mixture.real < tolerance
        assert inclusion_mixture.real == pytest.approx(
            linear_mixing(1.5, 1.5 + contrast, 0.3).real, abs=contrast**2
        )


@pytest.mark.parametrize("rule", RULES)
def test_arrays_broadcast(rule):
    w = np.array([450.0, 550.0, 650.0])
    quartz, hematite = make_refractive_index("quartz")(w), make_refractive_index("hematite")(w)
    f = np.array([[0.0], [0.02]])
    m = rule(quartz, hematite, f)
    assert m.shape == (2, 3)
    np.testing.assert_array_equal(m[0], quartz)
    assert m[1, 2] == rule(quartz[2], hematite[2], 0.02)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("fraction", [-0.1, 1.1, np.nan, [0.5, -0.1], np.inf])
def test_fractions_outside_0_to_1_are_rejected(rule, fraction):
    with pytest.raises(ValueError, match=r"fraction = .*must be in \[0, 1\]"):
        rule(QUARTZ, HEMATITE, fraction)
