"""Retrieval from the return of a light pulse: operators, errors and messages."""

import math

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import splits
from splits.core.validation import InvalidValue
from splits.instruments.delay_record import DEFAULT_EDGES_S, Pulse
from splits.retrieval.retrieve_return import make_return_operator
from tests.statistics.chi2 import judge_z

AREA, DENSITY, DEPTH = "specific_surface_area_m2_kg", "density_kg_m3", "depth_m"
PULSE_S = 0.3e-9
PHOTONS = 5000.0
SHORT_RECORD = np.concatenate([np.linspace(0.0, 1e-9, 51), np.linspace(1.2e-9, 4e-9, 15)])
LONG_RECORD = np.concatenate([np.linspace(0.0, 0.6e-9, 31), np.linspace(0.65e-9, 4e-9, 68)])
SHORT_BINS, LONG_BINS = np.linspace(-0.3e-9, 2e-9, 24), np.linspace(-0.3e-9, 3.3e-9, 19)


def make_deep_snow(**keywords):
    return splits.Snow.natural(**{DENSITY: 350.0, "depth_m": math.inf, **keywords})


def make_shallow_snow(**keywords):
    return splits.Snow.natural(
        **{AREA: 20.0, DENSITY: 350.0, "depth_m": 0.02, "ground": 0.1, **keywords}
    )


def draw_area(generator):
    return math.exp(generator.uniform(math.log(7.0), math.log(60.0)))


CASES = {
    "area": (
        make_deep_snow, 1064.0, {AREA: np.geomspace(5.0, 80.0, 9)}, SHORT_RECORD, SHORT_BINS,
        lambda generator: {AREA: draw_area(generator)},
    ),
    "depth": (
        make_shallow_snow, 532.0, {DEPTH: np.geomspace(0.008, 0.08, 9)}, LONG_RECORD, LONG_BINS,
        lambda generator: {DEPTH: math.exp(generator.uniform(math.log(0.01), math.log(0.04)))},
    ),
    "area and density": (
        make_deep_snow, 1064.0,
        {AREA: np.geomspace(5.0, 80.0, 7), DENSITY: np.arange(100.0, 601.0, 100.0)},
        SHORT_RECORD, SHORT_BINS,
        lambda generator: {AREA: draw_area(generator), DENSITY: generator.uniform(150.0, 550.0)},
    ),
}  # fmt: skip


def count_photons(medium, wavelength_nm, edges, scale, seed):
    """Return photons of a pulse, as rates relative to the incident light, from paths of a seed."""
    light = splits.time_of_flight(
        medium, wavelength_nm, rays=100_000, seed=seed, delay_s=edges, pulse=PULSE_S
    )
    per_photon = 1.0 / (PHOTONS * np.diff(edges))
    expected = scale * light.return_rate.sel(side="reflected").values.ravel() / per_photon
    return np.random.default_rng(seed).poisson(expected) * per_photon


def compute_z(result, truth):
    """Return the normal quantiles of the true values among the draws from the posterior."""
    n_draws = result.dataset.sizes["draw"]
    below = [
        int((result.dataset.draws.sel(parameter=name) < value).sum())
        for name, value in truth.items()
    ]
    return stats.norm.ppf((np.array(below) + 0.5) / (n_draws + 1.0))


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_posteriors_contain_the_truth_as_often_as_they_state(case):
    """Synthetic returns of 40 media have normal errors of unit variance, by independent paths."""
    make, wavelength_nm, grid, record, edges, draw = CASES[case]
    table = splits.build_table(make, grid, wavelength_nm, rays=100_000, delay_s=record).dataset
    z = []
    for number in range(40):
        generator = np.random.default_rng(number)
        truth, scale = draw(generator), generator.uniform(0.5, 2.0)
        rates = count_photons(make(**truth), wavelength_nm, edges, scale, 1000 + number)
        free, noise = [*truth, "scale"], {"photons": PHOTONS}
        found = splits.retrieve_return((edges, rates), table, free, noise, pulse=PULSE_S)
        z.append(compute_z(found, {**truth, "scale": scale}))
    z = np.array(z)
    for name, row in zip(free, z.T, strict=True):
        inside = [float((np.abs(row) < limit).mean()) for limit in (1.0, 1.96)]
        print(f"{case}: {name}: mean {row.mean():.2f}, rms {np.sqrt((row**2).mean()):.2f}, "
              f"within 68 %: {inside[0]:.2f}, within 95 %: {inside[1]:.2f}")  # fmt: skip
        # Values of one table have its error in common.
        assert abs(row.mean()) < 2.6 * math.sqrt(1.0 / len(row) + 0.03)
    judge_z(z, case, independent=len(z))


@pytest.fixture(scope="module")
def table():
    """Table of deep snow of four specific surface areas."""
    return splits.build_table(
        make_deep_snow, {AREA: [10.0, 15.0, 22.0, 33.0]}, 1064.0, rays=20_000, delay_s=SHORT_RECORD
    ).dataset


def test_specific_surface_area_follows_from_a_return(table):
    rates = count_photons(make_deep_snow(**{AREA: 18.0}), 1064.0, SHORT_BINS, 1.5, seed=5)
    found = splits.retrieve_return(
        (SHORT_BINS, rates), table, [AREA, "scale"], {"photons": PHOTONS}, pulse=PULSE_S
    )
    judge_z(compute_z(found, {AREA: 18.0, "scale": 1.5}))
    assert found.constrained == {AREA: True, "scale": True}
    assert found.stderr[AREA] < 0.25 * 18.0
    dataset = found.dataset
    assert dataset.measured.dims == dataset.fitted.dims == ("wavelength", "delay_s")
    assert dataset.attrs["pulse_s"] == PULSE_S
    np.testing.assert_array_equal(dataset.measured.values.ravel(), rates)
    np.testing.assert_allclose(dataset.delay_bounds.values[:, 1], SHORT_BINS[1:])
    # Errors of bins follow from the photons that the result predicts.
    count = dataset.fitted * PHOTONS * np.diff(SHORT_BINS)
    stderr = dataset.measured_stderr * PHOTONS * np.diff(SHORT_BINS)
    np.testing.assert_allclose(stderr**2, np.maximum(count, 0.1), rtol=0.05)


def test_several_wavelengths_are_used_together():
    edges = np.linspace(0.0, 1e-9, 11)
    pair = splits.build_table(
        make_shallow_snow, {DEPTH: [0.01, 0.02, 0.04]}, [532.0, 1064.0], rays=2000, delay_s=edges
    ).dataset
    rates = pair.return_rate.sel({DEPTH: 0.02}).values
    for given in (rates, rates.ravel()):
        found = splits.retrieve_return((edges, given), pair, [DEPTH], 0.02 * rates.mean())
        np.testing.assert_allclose(found.dataset.value, 0.02, rtol=1e-3)
        np.testing.assert_array_equal(found.dataset.measured, rates)


@pytest.mark.parametrize("pulse", [None, PULSE_S])
def test_tables_predict_what_the_instrument_records(table, pulse):
    """The same paths in the bins of a measurement; light is uniform in the bins of a table."""
    edges = SHORT_RECORD[::5] if pulse is None else SHORT_BINS
    operator = make_return_operator(table, edges, Pulse.from_argument(pulse))
    predicted = operator.weights @ table.return_rate.sel({AREA: 15.0}).values.ravel()
    medium, settings = make_deep_snow(**{AREA: 15.0}), {"rays": 20_000, "delay_s": edges}
    light = splits.time_of_flight(medium, 1064.0, **settings, pulse=pulse)
    exact = light.return_rate.sel(side="reflected").values.ravel()
    tolerance = 1e-9 if pulse is None else 0.01
    np.testing.assert_allclose(predicted, exact, atol=tolerance * exact.max())
    error = operator.error_weights @ table.return_rate.sel({AREA: 15.0}).values.ravel()
    assert np.abs(error).max() < 0.03 * exact.max()


def test_points_of_a_grid_have_the_values_of_the_instrument(table):
    medium = make_deep_snow(**{AREA: 22.0})
    light = splits.time_of_flight(medium, 1064.0, rays=20_000, delay_s=SHORT_RECORD)
    light = light.sel(side="reflected")
    for name in (
        "return_rate",
        "return_rate_stderr",
        "fraction",
        "mean_delay",
        "mean_delay_stderr",
    ):
        np.testing.assert_array_equal(table[name].sel({AREA: 22.0}), light[name])
    np.testing.assert_array_equal(table.delay_bounds, light.delay_bounds)


def test_the_incidence_may_be_an_axis():
    grid = {"incidence_deg": [0.0, 60.0], DEPTH: [0.01, 0.02]}
    found = splits.build_table(
        make_shallow_snow, grid, 532.0, rays=1000, delay_s=DEFAULT_EDGES_S
    ).dataset
    oblique = splits.time_of_flight(make_shallow_snow(depth_m=0.02), 532.0, 60.0, rays=1000)
    np.testing.assert_array_equal(
        found.fraction.sel(incidence_deg=60.0, depth_m=0.02), oblique.fraction.sel(side="reflected")
    )


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"measured": 3}, "measured = 'int': must be .delays between bins"),
        ({"measured": ([0, 1e-9], [1, 2])}, "measured = 'of shape .2,.': must be 1 values for"),
        ({"measured": ([0, 1e-8], [1e9])}, "measured .delays. = 1e-08: must be up to 4e-09 s"),
        ({"measured": ([1e-9, 0], [1e9])}, "strictly increasing"),
        ({"measured": xr.Dataset()}, "measured = 'a dataset': must be with return_rate"),
        (
            {"measured": ([0.0, 1e-9], [420.0]), "noise": 20.0},
            "measured = 'of the sum 4.2e-07': must be rates in s⁻¹, .*of at least 0",
        ),
        (
            {"measured": ([0.0, 1e-9], [5e12])},
            r"measured = 'of the sum 5e\+03': .* of at most 1 \(n of N",
        ),
        ({"noise": None}, "noise = None: must be standard errors"),
        ({"noise": 0.0}, "noise = 0.0: must be standard errors above 0"),
        ({"noise": [1.0, 2.0, 3.0]}, "noise = 'of shape"),
        ({"noise": {"count": 3}}, r"noise = \['count'\]"),
        ({"noise": {"photons": 0}}, "noise.photons = 0"),
        ({"noise": {"photons": math.inf}}, "noise.photons = inf"),
        ({"table": 3}, "table = 'int': must be what splits.build_table.…, delay_s=…. returned"),
        ({"free": ["density"]}, "free.density"),
        ({"free": ["scale"]}, "fixed.specific_surface_area_m2_kg = None: must be given"),
        ({"pulse": -1.0}, "pulse = -1"),
    ],
)
def test_mistakes_in_measurements_have_one_message(table, keywords, message):
    arguments = {"measured": ([0.0, 1e-9], [9e8]), "table": table, "free": [AREA], "noise": 1e8}
    with pytest.raises(ValueError, match=message) as caught:
        splits.retrieve_return(**{**arguments, **keywords})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("free", [[AREA], [AREA, "scale"]])
def test_counts_of_photons_are_rejected_and_weak_returns_are_not(table, free):
    rates = count_photons(make_deep_snow(**{AREA: 18.0}), 1064.0, SHORT_BINS, 1.0, seed=7)
    counts = np.rint(rates * PHOTONS * np.diff(SHORT_BINS))
    hint = r"n of N incident photons in a bin of width w \(s\) have the value n/\(N w\)"
    for values in (counts, counts / np.diff(SHORT_BINS), 1e-9 * rates):
        for noise in ({"photons": PHOTONS}, np.sqrt(np.maximum(values, 1.0))):
            with pytest.raises(InvalidValue, match=hint):
                splits.retrieve_return((SHORT_BINS, values), table, free, noise, pulse=PULSE_S)
    # Nothing was counted, or one photon of few, or the signal is less than the noise.
    one = np.where(np.arange(rates.size) == 7, 1.0, 0.0) / (100.0 * np.diff(SHORT_BINS))
    for values, noise in (
        (0.0 * rates, {"photons": 3.0}),
        (one, {"photons": 100.0}),
        (1e-6 * rates, rates.max()),
        (-1e2 * rates, 1e3 * rates.max()),
    ):
        splits.retrieve_return((SHORT_BINS, values), table, free, noise, pulse=PULSE_S)


def test_a_poor_fit_without_a_pulse_has_a_warning(table):
    rates = count_photons(make_deep_snow(**{AREA: 18.0}), 1064.0, SHORT_BINS, 1.0, seed=7)
    for pulse in (None, PULSE_S):
        found = splits.retrieve_return(
            (SHORT_BINS, rates), table, [AREA], 0.01 * rates.max(), pulse=pulse
        )
        assert any("no pulse is given" in line for line in found.warnings) == (pulse is None)


def test_returns_of_the_instrument_are_accepted(table):
    edges = SHORT_RECORD[::5]
    medium = make_deep_snow(**{AREA: 15.0})
    light = splits.time_of_flight(medium, 1064.0, rays=5000, seed=3, delay_s=edges)
    reflected, noise = light.sel(side="reflected"), 0.02 * float(light.return_rate.max())
    pair = edges, reflected.return_rate.values
    expected = splits.retrieve_return(pair, table, [AREA], noise)
    for one in (reflected, reflected.squeeze(), reflected.transpose(), light.isel(side=[0])):
        assert splits.retrieve_return(one, table, [AREA], noise).values == expected.values
    in_ns = reflected.assign(return_rate=reflected.return_rate.assign_attrs(units="ns-1"))
    for wrong, message in (
        (light, "measured = 'both sides, over side, .*delay_s': must be"),
        (light.sel(side="transmitted"), "measured = 'transmitted, over delay_s'"),
        (reflected.drop_vars("delay_bounds"), "measured = 'a dataset': must be with return_rate"),
        (reflected.isel(delay_s=[0, 2]), "measured.delay_s = 'with gaps'"),
        (reflected.return_rate, "measured = 'DataArray': .*a dataset: light.sel"),
        (in_ns, "measured = 'in ns-1': must be in s-1"),
    ):
        with pytest.raises(InvalidValue, match=message):
            splits.retrieve_return(wrong, table, [AREA], noise)


def test_tables_may_be_parts_but_have_no_gaps(table):
    arguments = ([0.0, 4e-10], [1e9]), [AREA], 1e8
    part = table.sel({AREA: [15.0, 22.0]}).isel(delay_s=slice(30)).transpose(..., AREA)
    whole, found = (
        splits.retrieve_return(arguments[0], one, {AREA: (15.0, 22.0)}, arguments[2]).dataset
        for one in (table, part)
    )
    np.testing.assert_allclose(found.measured, whole.measured)
    for wrong, message in (
        (table.isel(delay_s=[0, 1, 5]), "table.delay_s = 'with gaps'"),
        (table.isel(wavelength=0), "without an axis wavelength"),
        (table.drop_vars("delay_bounds"), "table.delay_bounds = None"),
        (table.where(table.delay_s > 1e-10), "table = 'gaps in return_rate'"),
    ):
        with pytest.raises(ValueError, match=message):
            splits.retrieve_return(arguments[0], wrong, *arguments[1:])


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"grid": {}}, "grid = {}"),
        ({"grid": {DENSITY: [100.0, 1e4]}}, "grid = 'density_kg_m3 = 10000.0': must be a medium"),
        ({"make": lambda depth_m: splits.ParticleLayer(optical_thickness=1.0),
          "grid": {DEPTH: [1.0]}}, "a layer of grains"),
        ({"grid": {"incidence_deg": [0, 30]}, "incidence_deg": 30.0}, "incidence_deg = 30.0: must"),
        ({"rays": 0}, "rays = 0"),
        ({"delay_s": [1e-9]}, "at least two"),
    ],
)  # fmt: skip
def test_mistakes_in_grids_have_one_message(keywords, message):
    arguments = {
        "make": make_shallow_snow, "grid": {DEPTH: [0.01, 0.02]}, "wavelength_nm": 532.0,
        "rays": 10, "delay_s": [0.0, 1e-9],
    }  # fmt: skip
    with pytest.raises(ValueError, match=message) as caught:
        splits.build_table(**{**arguments, **keywords})
    assert "\n" not in str(caught.value)
