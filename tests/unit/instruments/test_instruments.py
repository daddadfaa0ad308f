"""Instruments: results, arguments, choice of the solver, infinite depths, pulses and receivers."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.core.provenance import hash_physics_sources
from splits.core.validation import InvalidValue
from splits.instruments.delay_record import (
    DEFAULT_EDGES_S,
    FWHM_PER_SIGMA,
    Pulse,
    check_delay_edges,
    check_record,
    compute_max_order,
    make_receiver,
)
from splits.instruments.solver import AUTO, DISCRETE_ORDINATES, MONTE_CARLO, choose_solver
from splits.kernels.scene import NO_MAX_ORDER
from splits.simulation.scene import build_scene

WAVES = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "correlation": "gaussian"}
ROUGH = splits.ParticleLayer(surface=WAVES, depth_m=10.0)
INSTRUMENT_CALLS = {
    "spectrophotometer": lambda medium: splits.spectrophotometer(medium, [600]),
    "goniophotometer": lambda medium: splits.goniophotometer(medium, [600]),
    "beam_spread": lambda medium: splits.beam_spread(medium, [600]),
    "single_scattering": lambda medium: splits.single_scattering(medium, [600]),
    "lens": lambda medium: splits.lens(
        medium, screen_depth_m=[1.0], radius_m=0.1, half_width_m=1.0
    ),
    "surface_map": lambda medium: splits.surface_map(medium, half_width_m=1.0),
}
SURFACE_CALLS = ("lens", "surface_map")


@pytest.mark.parametrize(
    "medium", ["snow", "layer", splits.Snow, splits.ParticleLayer, None, [600], 5]
)
@pytest.mark.parametrize("instrument", INSTRUMENT_CALLS)
def test_objects_other_than_media_are_rejected(instrument, medium):
    allowed = "ParticleLayer" if instrument in SURFACE_CALLS else "Snow"
    text = medium.__name__ if isinstance(medium, type) else repr(medium)
    message = re.escape(f"medium = {text}: must be splits.{allowed}(...)")
    with pytest.raises(ValueError, match=f"^{message}"):
        INSTRUMENT_CALLS[instrument](medium)


@pytest.mark.parametrize(
    ("instrument", "medium"),
    [
        ("single_scattering", ROUGH),
        *((name, medium) for name in SURFACE_CALLS for medium in (splits.Snow(), splits.Sand())),
    ],
)
def test_unsupported_media_are_rejected(instrument, medium):
    with pytest.raises(ValueError, match=f"^medium = '{medium.kind}': must be splits"):
        INSTRUMENT_CALLS[instrument](medium)


@pytest.mark.parametrize("medium", ["snow", "Snow", "snwo", splits.Snow])
def test_misspelt_media_get_a_suggestion(medium):
    with pytest.raises(ValueError, match=re.escape("(did you mean splits.Snow()?)")):
        splits.spectrophotometer(medium, [600])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: splits.lens(ROUGH, screen_depth_m=[1.0], radius_m=0.1),
         r"^half_width_m = None: must be given \(m\) \(half the side of the square searched"),
        (lambda: splits.goniophotometer(splits.Snow(), [600], rays=1e5),
         r"^rays = 100000\.0: must be a whole number of at least 1 \(write 100000\)"),
        (lambda: splits.spectrophotometer(splits.Snow(), [[400, 500]]),
         r"^wavelength_nm = \[\[400, 500\]\]: must be one row of numbers"),
        (lambda: splits.spectrophotometer(splits.Snow(), [600], "difuse"),
         r"^incidence_deg = 'difuse': must be an angle .*did you mean diffuse"),
        (lambda: splits.ParticleLayer(surface={"rms_height_m": 1.0, "wave_number_per_m": 1.0}),
         r"^surface\.band_limit_per_m = None: must be given .*default correlation"),
    ],
)  # fmt: skip
def test_missing_and_misspelt_arguments_get_a_hint(call, message):
    with pytest.raises(ValueError, match=message):
        call()


SOLVER_WAVELENGTHS = np.array([600.0, 1300.0])
NATURAL = splits.Snow.natural(specific_surface_area_m2_kg=20.0)
WET = splits.Snow.natural(specific_surface_area_m2_kg=20.0, liquid_water_content=0.05)


@pytest.mark.parametrize(
    ("media", "max_stderr", "solver"),
    [
        ([NATURAL], 0.002, DISCRETE_ORDINATES),
        ([NATURAL, WET], 0.002, DISCRETE_ORDINATES),
        ([NATURAL, splits.Snow()], 0.002, MONTE_CARLO),
        # Paths would not reach a smaller error either.
        ([NATURAL], 1e-6, DISCRETE_ORDINATES),
        # The balance of dry and wet pores has a larger error than the tables.
        ([NATURAL], 4e-4, DISCRETE_ORDINATES),
        ([WET], 4e-4, MONTE_CARLO),
    ],
)
def test_auto_chooses_discrete_ordinates_where_they_are_accurate_enough(media, max_stderr, solver):
    choice = choose_solver(AUTO, media, SOLVER_WAVELENGTHS, max_stderr=max_stderr)
    assert choice.solver == solver


def test_results_state_why_their_solver_was_chosen():
    shallow = splits.Snow(depth_m=0.001)
    view = {"polar_deg": [0.0], "azimuth_deg": [0.0], "relative_stderr": 0.1}
    for medium, keywords, reason in (
        (NATURAL, {}, "natural snow"),
        (NATURAL, {"solver": DISCRETE_ORDINATES}, "requested"),
        (shallow, {}, "overlap_with_boundary"),
    ):
        results = [
            splits.spectrophotometer(medium, [900.0], max_stderr=0.05, **keywords),
            splits.goniophotometer(medium, [900.0], **view, **keywords),
            splits.irradiance_profile(medium, [900.0], depth_m=[5e-4], max_stderr=0.05, **keywords),
        ]
        assert all(reason in one.attrs["solver_reason"] for one in results)


def test_discrete_ordinates_by_name_state_the_error_that_they_reach():
    spectrum = splits.spectrophotometer(
        NATURAL, SOLVER_WAVELENGTHS, max_stderr=1e-6, solver=DISCRETE_ORDINATES
    )
    assert spectrum.attrs["max_stderr_reached"] > 1e-6
    assert spectrum.attrs["stop_reason"] == "solver_error"


def test_directions_by_paths_suggest_a_finite_depth_or_discrete_ordinates():
    with pytest.raises(ValueError, match=r"depth_m = inf.*solver discrete_ordinates"):
        splits.goniophotometer(NATURAL, [500], solver=MONTE_CARLO)


PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "snow.md"
SKY = splits.sky("summit_greenland")
SNOW = splits.Snow.natural(specific_surface_area_m2_kg=20)
VIEW = {"polar_deg": [0.0], "azimuth_deg": [0.0], "relative_stderr": 0.3}
CALLS = {
    "spectrophotometer": lambda **k: splits.spectrophotometer(
        SNOW, [1300], 0.0, max_stderr=0.1, **k
    ),
    "albedo": lambda **k: splits.albedo(SNOW, SKY, [1300, 1400], max_stderr=0.1, **k),
    "irradiance_profile": lambda **k: splits.irradiance_profile(
        SNOW, [1300], depth_m=[0.01], max_stderr=0.1, **k
    ),
    "radiation_profile": lambda **k: splits.radiation_profile(
        SNOW, SKY, [1300, 1400], depth_m=[0.01], max_stderr=0.1, total_w_m2=100.0, **k
    ),
    "time_of_flight": lambda: splits.time_of_flight(SNOW, [1300], rays=100),
    "single_scattering": lambda: splits.single_scattering(SNOW, [1300], rays=1000),
    "goniophotometer": lambda **k: splits.goniophotometer(SNOW, [1300], **VIEW, **k),
    "hdrf": lambda **k: splits.hdrf(SNOW, SKY, [1300], **VIEW, **k),
    "beam_spread": lambda: splits.beam_spread(SNOW, [1300], rays=100),
}
WITHOUT_SOLVER = ("time_of_flight", "single_scattering", "beam_spread")


def read_table():
    """Return the documented statement by instrument."""
    table = re.search(r"\| function \| infinite depth \|\n.*?\n\n", PAGE.read_text("utf-8"), re.S)[
        0
    ]
    rows = [row.split("|")[1:3] for row in table.splitlines()[2:] if row]
    return {name: text.strip() for names, text in rows for name in re.findall(r"`(\w+)`", names)}


def accepts(instrument, **keywords):
    try:
        CALLS[instrument](**keywords)
    except InvalidValue as error:
        assert str(error).startswith("depth_m = inf: must be finite")
        return False
    return True


@NEEDS_JIT
@pytest.mark.parametrize("instrument", CALLS)
def test_table_of_infinite_depths_is_that_of_the_code(instrument):
    expected = read_table()[instrument]
    assert accepts(instrument) == (expected != "no")
    if instrument not in WITHOUT_SOLVER:
        assert accepts(instrument, solver="monte_carlo") == (expected == "yes")


def test_table_has_all_instruments():
    assert set(read_table()) == set(CALLS)
    tables = {"build_table", "lens", "surface_map"}
    names = {name for name in splits.__all__ if hasattr(getattr(splits, name), "__module__")}
    public = {n for n in names if getattr(splits, n).__module__.startswith("splits.instruments")}
    assert public - tables <= set(CALLS)


QUANTITIES = ("reflectance", "transmittance", "absorptance")
WAVELENGTHS = [500.0, 1030.0, 1500.0]
THIN_SNOW = splits.Snow(depth_m=0.001)


def measure(**changes):
    settings = {"wavelength_nm": WAVELENGTHS, "max_stderr": 0.5, "threads": 1, **changes}
    return splits.spectrophotometer(THIN_SNOW, **settings)


@pytest.fixture(scope="module", params=["spectral", "analog"])
def measured(request):
    return measure(estimator=request.param, incidence_deg="diffuse")


def test_variables_and_dimensions(measured):
    batches = {"reflectance_batches", "transmittance_batches"}
    values = {q + s for q in QUANTITIES for s in ("", "_stderr")}
    assert set(measured.data_vars) == values | batches
    assert all(measured[name].dims == ("wavelength",) for name in values)
    assert all(measured[name].dims == ("batch", "wavelength") for name in batches)
    np.testing.assert_array_equal(measured.wavelength, WAVELENGTHS)


def test_all_variables_have_units_and_names(measured):
    for name, variable in measured.variables.items():
        # The incidence is the text "diffuse".
        units = {"wavelength": "nm", "incidence_deg": None}.get(name, "1")
        assert variable.attrs.get("units") == units
        assert variable.attrs["long_name"]
    for quantity in QUANTITIES:
        assert measured[quantity].attrs["ancillary_variables"] == f"{quantity}_stderr"
    assert "hemispherical-hemispherical" in measured.reflectance.attrs["long_name"]


def test_attributes_record_inputs_and_provenance(measured):
    attributes = measured.attrs
    assert {f"snow_{key}" for key in THIN_SNOW.describe()} <= set(attributes)
    for key, value in {"incidence_deg": "diffuse", "max_stderr": 0.5, "seed": 1}.items():
        assert attributes[key] == value
    for key in ("Conventions", "source", "splits_version", "splits_commit", "date_created"):
        assert attributes[key]
    assert attributes["physics_sources_sha256"] == hash_physics_sources()
    assert attributes["threads"] == 1
    assert attributes["stop_reason"] == "converged" and attributes["max_stderr_reached"] <= 0.5
    assert attributes["rays"] > 0


def test_results_are_saved_and_loaded(measured, tmp_path):
    splits.save(measured, tmp_path / "measured.nc")
    loaded = splits.load(tmp_path / "measured.nc")
    assert loaded.equals(measured)
    assert set(loaded.attrs) == set(measured.attrs)
    assert json.dumps({k: str(v) for k, v in loaded.attrs.items()})


def test_a_scalar_wavelength_gives_one_value():
    spectrum = measure(wavelength_nm=500)
    assert spectrum.wavelength.values.tolist() == [500.0]
    assert spectrum.reflectance.attrs["long_name"] == "directional-hemispherical reflectance"


def test_results_are_determined_by_the_seed():
    first, repeated, other = (measure(seed=seed) for seed in (1, 1, 2))
    assert first.equals(repeated)
    assert not first.equals(other)


def test_progress_is_reported():
    reports = []
    measure(progress=reports.append)
    assert reports
    assert reports[0].target == 0.5
    assert reports[0].rays > 0


def test_the_maximum_of_rays_stops_the_run():
    stopped = measure(max_stderr=1e-6, max_rays=1)
    assert stopped.attrs["stop_reason"] == "max_rays"
    assert stopped.attrs["max_stderr_reached"] > 1e-6


def test_wavelengths_outside_the_tables_are_rejected():
    with pytest.raises(ValueError, match=r"wavelength_nm = 250\.0.*\[300, .*oscillators"):
        splits.spectrophotometer(splits.Sand(), [250.0, 500.0])


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
    edges, end = check_record(np.array([0.0, 1e-9]), math.inf, instant)
    assert edges.tolist() == [0.0, 1e-9] and end == math.inf
    edges, end = check_record(DEFAULT_EDGES_S, None, instant)
    assert edges is DEFAULT_EDGES_S and end == edges[-1]


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
        lambda: check_delay_edges("delay_s", np.linspace(0.0, 10.0, 11)),
        lambda: check_delay_edges("delay_s", [0.0, 1e300]),
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
        check_delay_edges("delay_s", [0.0, 5e-324])
