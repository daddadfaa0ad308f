"""Sensitivities to parameters, and their tables."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import compute_z_bound
from stated_errors import list_variables_with_errors

from splits.core.validation import InvalidValue
from workflow.papers.sensitivity import (
    NOISE_THRESHOLD_SIGMA,
    QUANTITY_CONDITIONS,
    compute_mean_sensitivity_index,
    compute_pair_sensitivity,
    make_sensitivities,
    make_sensitivity_table,
    select_chosen_sensitivities,
)


def test_equal_spectra_have_no_sensitivity():
    s = compute_mean_sensitivity_index([0.5, 0.2], [0.01, 0.01], [0.5, 0.2], [0.01, 0.01])
    assert (s.index, s.index_resolved, s.resolved_fraction) == (0.0, 0.0, 1.0)


def test_index_is_the_mean_relative_difference():
    s = compute_mean_sensitivity_index([1.0, 0.2, 0.3], [0, 0, 0], [0.5, 0.8, 0.3], [0, 0, 0])
    assert s.index == pytest.approx((0.5 + 0.75 + 0.0) / 3)
    assert s.stderr == 0.0


def test_index_is_symmetric():
    y, e, z, f = [0.9, 0.1, 0.0], [0.01, 0.02, 0.01], [0.3, 0.4, 0.2], [0.03, 0.01, 0.02]
    assert compute_mean_sensitivity_index(y, e, z, f) == compute_mean_sensitivity_index(z, f, y, e)


def test_values_below_the_noise_are_ignored():
    s = compute_mean_sensitivity_index([0.8, 1e-3], [1e-3, 1e-3], [0.4, 0.0], [1e-3, 1e-3])
    assert s.index == pytest.approx(0.25)
    assert s.index_resolved == pytest.approx(0.5)
    assert s.resolved_fraction == 0.5


def test_index_is_zero_below_the_noise():
    s = compute_mean_sensitivity_index([1e-3, 0.0], [1e-3, 0.0], [0.0, 0.0], [1e-3, 0.0])
    assert (s.index, s.index_resolved, s.resolved_fraction) == (0.0, 0.0, 0.0)
    zero = compute_mean_sensitivity_index([0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    assert zero.stderr == 0.0


def test_index_of_a_vanishing_spectrum_is_one():
    s = compute_mean_sensitivity_index([0.5, 0.4], [1e-3, 1e-3], [0.0, 0.0], [1e-3, 1e-3])
    assert s.index == 1.0


def test_values_at_the_noise_threshold_are_unresolved():
    for factor, resolved in ((1.0, 0.0), (1.001, 1.0)):
        assert (
            compute_mean_sensitivity_index(
                [NOISE_THRESHOLD_SIGMA * factor], [1.0], [0.0], [1.0]
            ).resolved_fraction
            == resolved
        )


def test_error_matches_the_scatter_of_noisy_pairs():
    rng = np.random.default_rng(5)
    y, e, z, f = 0.6, 0.006, 0.4, 0.008
    ratios = [
        compute_mean_sensitivity_index([y + e * a], [e], [z + f * b], [f]).index
        for a, b in rng.standard_normal((4000, 2))
    ]
    stderr = compute_mean_sensitivity_index([y], [e], [z], [f]).stderr
    # The relative standard error of the standard deviation of 4000 values is 1/√8000.
    assert np.std(ratios) == pytest.approx(stderr, rel=compute_z_bound(1) / 8000**0.5)


@pytest.mark.parametrize("ratio", [0.0, 0.5])
@pytest.mark.parametrize("mean", [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0])
def test_error_is_an_upper_bound_near_the_noise(mean, ratio):
    rng = np.random.default_rng(9)
    samples = np.maximum(rng.normal((mean, ratio * mean), 1.0, (2000, 2)), 0.0)
    results = [compute_mean_sensitivity_index([y], [1.0], [z], [1.0]) for y, z in samples]
    stated = np.sqrt(np.mean([s.stderr**2 for s in results]))
    # The relative standard error of the standard deviation of 2000 values is 1/√4000.
    assert np.std([s.index for s in results]) < stated * (1.0 + compute_z_bound(18) / 4000**0.5)


def test_error_above_the_noise_is_that_of_the_ratio():
    y, e, z, f = 0.8, 0.1, 0.4, 0.05
    exact = np.hypot(f / y, z * e / y**2)
    assert compute_mean_sensitivity_index([y], [e], [z], [f]).stderr == pytest.approx(
        exact, rel=1e-4
    )


# --- tables ---------------------------------------------------------------------------------------


WAVELENGTHS = np.array([400.0, 1000.0, 1500.0, 2500.0])
PAIR = {"parameter": "saturation", "low": 0, "high": 1}


def make_spectra(scale, dimension, labels):
    """Return reflectance scale[i] and half of it as transmittance over two depths."""
    values = np.asarray(scale)[:, np.newaxis, np.newaxis] * np.ones((1, 2, len(WAVELENGTHS)))
    dims = (dimension, "depth_m", "wavelength")
    variables = {"reflectance": values, "transmittance": 0.5 * values}
    variables |= {f"{name}_stderr": np.full_like(values, 1e-3) for name in QUANTITY_CONDITIONS}
    coordinates = {dimension: labels, "depth_m": [0.12, 0.02], "wavelength": WAVELENGTHS}
    return xr.Dataset({name: (dims, v) for name, v in variables.items()}, coordinates)


def test_pairs_use_the_published_depth_and_wavelengths():
    dataset = make_spectra([0.8, 0.4], "saturation", [0.0, 1.0])
    dataset.reflectance[0, 1] = 0.0
    assert compute_pair_sensitivity(
        dataset, "saturation", 0, 1, "reflectance"
    ).index == pytest.approx(0.5)
    dataset.transmittance[1, 1, 2:] = 0.0
    assert compute_pair_sensitivity(
        dataset, "saturation", 0, 1, "transmittance"
    ).index == pytest.approx(0.5)


def test_sensitivity_table_has_one_chosen_row_per_quantity():
    ranges = make_spectra([0.8, 0.6, 0.4], "saturation", [0.0, 0.5, 1.0])
    interpretation = xr.concat(
        [make_spectra([0.8, 0.2], "saturation", [0.0, 1.0])] * 3,
        dim=pd.Index(["default", "a", "b"], name="interpretation"),
    )
    table = make_sensitivity_table(
        {"saturation": ranges, "saturation_by_interpretation": interpretation}, {"saturation": PAIR}
    )
    assert len(table) == 2 * (3 + 2)
    chosen = table[table.chosen]
    assert sorted(chosen.quantity) == sorted(QUANTITY_CONDITIONS)
    np.testing.assert_allclose(chosen.msi, 0.5)
    np.testing.assert_allclose(table[table.interpretation == "a"].msi, 0.75)

    published = pd.DataFrame(
        {"published": [0.4, 0.6]}, index=["msi_r_saturation", "msi_t_saturation"]
    )
    dataset = select_chosen_sensitivities(table, published)
    np.testing.assert_allclose(dataset.msi, 0.5)
    assert dataset.published.sel(quantity="transmittance", parameter="saturation") == 0.6
    assert all(v.attrs["long_name"] and v.attrs["units"] for v in dataset.data_vars.values())
    assert list_variables_with_errors(dataset) == {"msi"}


@pytest.mark.parametrize("densities", [[100.0, 300.0, 500.0], [500.0, 300.0, 100.0]])
@pytest.mark.parametrize("ends", [(100, 500), (500, 100)])
def test_the_order_of_the_ends_of_a_pair_has_no_effect(densities, ends):
    rng = np.random.default_rng(1)
    dataset = make_spectra(rng.random(3), "density_kg_m3", densities)
    pairs = {"density": {"parameter": "density_kg_m3", "low": ends[0], "high": ends[1]}}
    several = dataset.expand_dims(interpretation=["default", "other"])
    table, chosen, index, figure = make_sensitivities(
        pairs=pairs, density=dataset, density_by_interpretation=several
    )
    rows = table[table.chosen]
    assert len(rows) == len(chosen) == 2
    assert {*rows.low, *rows.high} == {100.0, 500.0}
    other = table[table.interpretation == "other"]
    np.testing.assert_allclose(other.msi, rows.msi)
    assert index.sizes == {"quantity": 2, "parameter": 1} and figure.axes


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ({"low": 0.0, "high": 0.0}, r"options\.pairs\.wet\.high = 0.*: must be different from low"),
        ({"low": "0", "high": 1}, "inputs.wet = .*with saturation = 0 on its grid"),
        ({"low": 0, "high": 0.7}, "with saturation = 0.7 on its grid"),
        ({"low": 0}, r"options\.pairs\.wet = .*: must be with high"),
        (
            {"low": 0, "high": 1, "sauce": "paper"},
            "wet = 'sauce'.*did you mean source",
        ),
        (
            {"low": 0, "high": 1, "source": "papers"},
            "source = 'papers': must be one of",
        ),
    ],
)
def test_invalid_pairs_are_rejected(pair, message):
    dataset = make_spectra([0.8, 0.6, 0.4], "saturation", [0.0, 0.5, 1.0])
    pairs = {"wet": {"parameter": "saturation", **pair}}
    with pytest.raises(InvalidValue, match=message):
        make_sensitivities(pairs=pairs, wet=dataset)


def test_runs_and_published_numbers_of_all_pairs_are_required():
    dataset = make_spectra([0.8, 0.4], "saturation", [0.0, 1.0])
    pairs = {"wet": PAIR}
    with pytest.raises(InvalidValue, match=r"inputs = \[\]: must be with wet"):
        make_sensitivities(pairs=pairs)
    with pytest.raises(InvalidValue, match="inputs = 'dry': must be one of"):
        make_sensitivities(pairs=pairs, wet=dataset, dry=dataset)
    published = pd.DataFrame({"published": [0.4]}, index=["msi_r_wet"])
    with pytest.raises(InvalidValue, match="a table with msi_t_wet"):
        make_sensitivities(pairs=pairs, wet=dataset, published=published)
