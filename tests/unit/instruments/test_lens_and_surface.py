"""Instruments for rough surfaces, and experiments with them."""

from __future__ import annotations

import numpy as np
import pytest
from experiment_jobs import COARSE

import splits
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.messages import validate_content
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.plotting import draw

WAVES = {"rms_height_m": 1.0, "wave_number_per_m": 0.1, "waves": 8, "correlation": "gaussian"}
WATER = splits.ParticleLayer(refractive_index=1.34, depth_m=100.0, surface=WAVES)


def test_a_flat_surface_does_not_focus():
    ds = splits.lens(WATER, [1.0, 10.0], 2.0, centre_on="origin", waves=[(0.0, 1.0, 0.0, 0.0)])
    assert ds.contraction.values == pytest.approx(1.0, abs=1e-12)
    assert ds.concentration.values == pytest.approx(1.0, abs=1e-12)
    assert ds.detected_fraction.values == pytest.approx(1.0)


def test_crests_focus_and_troughs_defocus():
    crest, trough = (
        splits.lens(WATER, [20.0], 0.5, centre_on=centre, half_width_m=50.0, realizations=20)
        for centre in ("crest", "trough")
    )
    for ds, sign in ((crest, 1.0), (trough, -1.0)):
        above = float(ds.concentration[0] - 1.0) * sign
        assert above > 3.0 * float(ds.concentration_stderr[0])


def test_one_realization_has_no_standard_error():
    ds = splits.lens(WATER, [5.0], 0.5, centre_on="origin", rays=12)
    assert "contraction_stderr" not in ds and ds.attrs["rays"] == 12


def test_surface_maps_have_the_expected_slopes():
    ds = splits.surface_map(WATER, 200.0, points=81, realizations=200, seed=3)
    assert ds.height.shape == (81, 81)
    expected = WATER.surface.rms_slope()
    squares = ds.rms_slope.values**2
    stderr = squares.std(ddof=1) / np.sqrt(squares.size)
    assert abs(squares.mean() - expected**2) < 4.0 * stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([-1.0], 1.0), "screen_depth_m"),
        (([2.0, 1.0], 1.0), "screen_depth_m"),
        ((["deep"], 1.0), "screen_depth_m"),
        (([1.0], 0.0), "radius_m"),
        (([1.0], 1.0, {"centre_on": "valley"}), "centre_on"),
        (([1.0], 1.0, {"rays": 2}), "rays"),
        (([1.0], 1.0, {"centre_on": "origin", "waves": [(1.0, 2.0)]}), "waves"),
        (([1.0], 1.0, {"half_width_m": 0.0}), "half_width_m"),
    ],
)
def test_invalid_lens_arguments_are_rejected(arguments, message):
    depths, radius, *options = arguments
    settings = {"half_width_m": 5.0, **(options[0] if options else {})}
    with pytest.raises(ValueError, match=message):
        splits.lens(WATER, depths, radius, **settings)


def test_smooth_layers_are_rejected():
    for call in (lambda m: splits.lens(m, [1.0], 1.0, centre_on="origin"),
                 lambda m: splits.surface_map(m, 1.0)):  # fmt: skip
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
    assert draw(dataset, experiment.resolve_figure()).axes


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
          "grid": {"refractive_index": [1.3, 1.5]}}, "figure.select"),
        ({"figure": {"quantity": "brdf"}}, "figure.quantity = 'brdf'"),
        ({"medium": {"kind": "particle_layer",
                     "surface": {"rms_height_m": 1, "wave_number_per_m": 1}}},
         "band_limit_per_m"),
    ],
)  # fmt: skip
def test_invalid_experiments_are_rejected(content, message):
    with pytest.raises((ValueError, TypeError), match=message):
        experiment = validate_content(ExperimentConfig, {"name": "made", **content})
        draw(run(experiment, COARSE, threads=1), experiment.resolve_figure())
