"""Declared inputs: messages of mistakes, limits of all declarations, and declared classes."""

import copy
import dataclasses
import inspect
import math
import pickle
import re
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import TypeAdapter

import splits
from splits.core.declarations import (
    Quantity,
    alternative,
    declare_class,
    list_inputs,
    other_constructor,
)
from splits.core.discovery import load_instruments
from splits.core.validation import InvalidValue, short_repr
from splits.experiments import load_experiment
from splits.media.interpretations import SandInterpretation
from splits.media.kinds import MEDIUM_CLASSES
from splits.media.rough_surface import RandomHeightField

NAMES = {
    **{name: getattr(splits, name) for name in (*load_instruments(), "Snow", "Sand", "Stack")},
    "Interpretation": splits.Interpretation, "SandInterpretation": SandInterpretation,
    "RandomHeightField": RandomHeightField,
    "np": np, "math": math,
}  # fmt: skip

# --------------------------------------------------------------------------------------------------
# Mistakes.
CALLS = {
    "Snow(density_kg_m3=2750)":
        "density_kg_m3 = 2750: must be in [1e-12, 916.9) kg/m3 (ice at -1 °C has 916.9)",
    "Snow(density_kg_m3=5e-324)":
        "density_kg_m3 = 5e-324: must be in [1e-12, 916.9) kg/m3 (ice at -1 °C has 916.9)",
    'Snow(density_kg_m3="300 kg/m3")':
        "density_kg_m3 = '300 kg/m3': must be in [1e-12, 916.9) kg/m3 (this is text, not a "
        "number)",
    "Snow(density_kg_m3=[200, 300])":
        "density_kg_m3 = [200, 300]: must be in [1e-12, 916.9) kg/m3 (one number, not several)",
    "Snow(density_kg_m3=np.ma.masked)": "density_kg_m3 = masked: must be in [1e-12, 916.9) kg/m3",
    "Snow(temperature_c=268.15)":
        "temperature_c = 268.15: must be in [-40, 0] °C (in kelvin? write -5)",
    "Snow(depth_m=-math.inf)": "depth_m = -inf: must be in (0, 10000] m",
    'Snow(depth_m="inf")':
        "depth_m = 'inf': must be in (0, 10000] m (infinite is .inf in YAML, math.inf in Python)",
    "Snow(saturation=5)": "saturation = 5: must be in [0, 1] (in per cent? write 0.05)",
    "Snow(saturation=np.nan)": "saturation = nan: must be in [0, 1]",
    "Snow(saturation=np.bool_(True))": "saturation = True: must be in [0, 1]",
    "Snow(grain_size_um=500)": "grain_size_um = 500: must be 2 numbers (min, max)",
    "Snow(grain_size_um=(750, 300))":
        "grain_size_um = (750, 300): must be 1 <= min <= max <= 100000 micrometres",
    "Snow(grain_size_um=(0.5, 300))":
        "grain_size_um = (0.5, 300): must be 1 <= min <= max <= 100000 micrometres (in "
        "millimetres? write 500)",
    "Snow(grain_size_um=(1, 2000))": "grain_size_um = (1, 2000): must be max <= 1000 min",
    "Snow(grain_size_um=np.ma.masked_array([300.0, 750.0], [True, False]))":
        "grain_size_um (min) = masked: must be a finite number",
    "Snow(facetness=np.ma.masked)":
        "facetness = masked: must be 4 numbers (min, max, mean, sd)",
    "Snow(facetness=0.3)": "facetness = 0.3: must be 4 numbers (min, max, mean, sd)",
    "Snow(facetness=(0.4, 0.2, 0.3, 0.1))":
        "facetness = (0.4, 0.2, 0.3, 0.1): must be 0 <= min <= mean <= max <= 1 (min, max, "
        "mean, sd)",
    "Snow(facetness=(0.2, 0.4, 0.3, -0.1))": "facetness (sd) = -0.1: must be in [0, 1]",
    "Snow(sphericity=(0.05, 0.9, 0.8, 0.1))":
        "sphericity = (0.05, 0.9, 0.8, 0.1): must be 0.1 <= min <= mean <= max <= 1 (min, max, "
        "mean, sd)",
    'Snow(sphericity=("0.6", 0.9, 0.8, 0.1))':
        "sphericity (min) = '0.6': must be a finite number (write 0.6, without quotes)",
    "Snow(specific_surface_area_m2_kg=0.02)":
        "specific_surface_area_m2_kg = 0.02: must be in [0.2, 2000] m2/kg (about 60 for fresh "
        "snow, 10 for old snow, 3 for melting snow)",
    "Snow(specific_surface_area_m2_kg=20, optical_radius_um=100)":
        "optical_radius_um = 100: must be left out where specific_surface_area_m2_kg is given "
        "(they set the same field)",
    "Snow(optical_radius_um=0.1)":
        "optical_radius_um = 0.1: must be in [1.63595, 16359.5] µm (in millimetres? write 100)",
    "Snow(optical_radius_um=None, liquid_water_content=5)":
        "liquid_water_content = 5: must be in [0, 0.700076] (in per cent? write 0.05; volume of "
        "water per volume of snow, at most that of its pores)",
    'Snow(impurities_ng_g={"soot": 50})':
        "impurities_ng_g = 'soot': must be one of … (did you mean black_carbon?)",
    'Snow(impurities_ng_g={"black_carbon": np.nan})':
        "impurities_ng_g.black_carbon = nan: must be in [0, 1e+08]",
    'Snow(impurities_in="grains")': "impurities_in = 'grains': must be one of ice, pores",
    'Snow(ground="gras")':
        "ground = 'gras': must be open, black, an albedo from 0 to 1, a mapping of "
        "wavelength_nm and albedo, the name of a soil or a .csv file (soils: quartzipsamment, "
        "torripsamment, camborthid)",
    "Snow(ground=1.5)": "ground = 1.5: must be in [0, 1]",
    "Snow(refractive_index=1.31)": "refractive_index = 1.31: must be a mapping by material",
    'Snow(interpretation="projected")':
        "interpretation = 'projected': must be one of geometric, radiative_transfer, "
        "splits_2007, splitsnow_2021",
    'Snow(interpretation={1: "keep"})':
        "interpretation.1: unknown key, must be one of …",
    'Snow(interpretation={"entry_point": "projekted"})':
        "interpretation.entry_point = 'projekted': must be one of projected, uniform (did you "
        "mean projected?)",
    "Snow.natural()":
        "specific_surface_area_m2_kg = None: must be given, or optical_radius_um (m2/kg: 40 and "
        "more for fresh snow, 10 for old snow, 3 for melting snow)",
    "Snow.natural(20)": "20: must have a keyword, such as specific_surface_area_m2_kg=20",
    "Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=0.25)":
        "density_kg_m3 = 0.25: must be in [10, 916.9) kg/m3 (in g/cm3? write 250; ice at -1 °C "
        "has 916.9)",
    'Interpretation(grain_extent="points")':
        "grain_extent = 'points': must be one of finite, point (did you mean point?)",
    "Sand(magnetite=0.995)":
        "magnetite = 0.995: must be in [0, 0.99] (the sum of all mass fractions is 1)",
    'Sand(iron_oxide="1e-2")':
        "iron_oxide = '1e-2': must be in [0, 1] (write 0.01, without quotes)",
    "Sand(partition=(0.5, 0.5, 0.5))":
        "partition = (0.5, 0.5, 0.5): must be three numbers of at least 0 that add up to 1 "
        "(these make 1.5; YAML has no 1/3, write 0.3333333333)",
    "Sand(partition=(0.5, 0.5))":
        "partition = (0.5, 0.5): must be 3 numbers (pure, mixed, coated)",
    "Sand(texture=(0.0, 0.3, 0.7))":
        "texture = (0.0, 0.3, 0.7): must be silt + 1.5 clay at most 0.15 (more is not a sand)",
    "Sand(texture=(0.0, 0.1, 0.8))":
        "texture = (0.0, 0.1, 0.8): must be three fractions (clay, silt, sand) that add up to 1",
    "Sand(porosity=42.5)": "porosity = 42.5: must be in (0, 1) (in per cent? write 0.425)",
    "Sand(roundness=(0.5,))": "roundness = (0.5,): must be 2 numbers (mean, sd)",
    "Sand(roundness=(1.1, 0.1))": "roundness (mean) = 1.1: must be in [0, 1]",
    "Sand(relative_coating_thickness=0.06)":
        "relative_coating_thickness = 0.06: must be in (0, 0.05] (coatings are treated as flat "
        "slabs, so they must be thin)",
    "Sand(size_tail=True)": "size_tail = True: must be in [1e-06, 0.01]",
    "Sand(size_tail=0.1)": "size_tail = 0.1: must be in [1e-06, 0.01]",
    "Sand(porositi=0.4)": "porositi: unknown key, must be one of … (did you mean porosity?)",
    "Stack(Snow())": "layers = Snow(): must be a list of media, top first",
    "Stack([])": "layers = '0 layers': must be 1 to 200",
    "Stack([Snow(depth_m=math.inf), Snow()])":
        "layers[0].depth_m = inf: must be finite (only the lowest layer may be infinite)",
    'Stack(layers=[Snow()], interpretation="geometrical")':
        "interpretation = 'geometrical': must be one of geometric, radiative_transfer, "
        "splits_2007, splitsnow_2021 (did you mean geometric?)",
    "RandomHeightField(0.01)":
        "wave_number_per_m = None: must be given (1/m) (the inverse of the correlation length)",
    "RandomHeightField(wave_number_per_m=1.0)": "rms_height_m = None: must be given",
    "RandomHeightField(0.01, 10.0, band_limit_per_m=0.001)":
        "band_limit_per_m = 0.001: must be at least 0.01 1/m",
    'RandomHeightField(0.01, 10.0, waves=64.0, correlation="gaussian")':
        "waves = 64.0: must be a whole number from 1 to 100000 (write 64)",
    'RandomHeightField(0.01, 10.0, "gauss")':
        "correlation = 'gauss': must be one of exponential, exponential_printed, gaussian, "
        "spectrum (did you mean gaussian?)",
    "spectrophotometer([500], Snow())":
        "wavelength_nm = Snow(): must be numbers in nanometres (the order is "
        "spectrophotometer(medium, wavelength_nm))",
    "spectrophotometer(Snow(), [0.5])":
        "wavelength_nm = 0.5: must be in [200, 100000] nm (in micrometres? write 500)",
    "spectrophotometer(Snow(), [500, np.nan])":
        "wavelength_nm = nan: must be numbers in nanometres (number 2 of 2 is masked, NaN or "
        "missing)",
    "spectrophotometer(Snow(), [600, 500])":
        "wavelength_nm = [600.0, 500.0]: must be strictly increasing (numbers 1 and 2 of 2)",
    'spectrophotometer(Snow(), [500], "30")':
        "incidence_deg = '30': must be an angle in degrees, or diffuse (write 30, without "
        "quotes)",
    "spectrophotometer(Snow(), [500], 95)": "incidence_deg = 95: must be in [0, 89.9999] degrees",
    "spectrophotometer(Snow(), [500], [0, 30])":
        "incidence_deg = [0, 30]: must be an angle in degrees, or diffuse (one call for each "
        "angle, or an experiment with a grid)",
    'spectrophotometer(Snow(), [500], "difuse")':
        "incidence_deg = 'difuse': must be an angle in degrees, or diffuse (did you mean "
        "diffuse?)",
    "spectrophotometer(Snow(), [500], 0, 0.01)":
        "0.01: must have a keyword, such as max_stderr=0.01",
    "spectrophotometer(Snow(), [500], max_stderr=0)": "max_stderr = 0: must be in [1e-06, 0.5]",
    "spectrophotometer(Snow(), [500], seed=1.0)":
        "seed = 1.0: must be a whole number of at least 0 (write 1)",
    'spectrophotometer(Snow(), [500], solver="ordinates")':
        "solver = 'ordinates': must be one of auto, discrete_ordinates, monte_carlo (did you "
        "mean discrete_ordinates?)",
    "spectrophotometer(Snow(), [500], stokes=[1, 2, 0, 0])":
        "stokes = [1, 2, 0, 0]: must be I > 0 and √(Q² + U² + V²) at most I",
    "spectrophotometer(Snow(), [500], sza=30)":
        "sza: unknown key, must be one of … (did you mean incidence_deg?)",
    "goniophotometer(Snow(), [500], polar_deg=[30, 0])":
        "polar_deg = [30.0, 0.0]: must be strictly increasing (numbers 1 and 2 of 2)",
    "goniophotometer(Snow(), [500], polar_deg=90)": "polar_deg = 90.0: must be in [0, 90) degrees",
    "goniophotometer(Snow(), [500], azimuth_deg=[-5, 5])":
        "azimuth_deg = -5.0: must be in [0, 360) degrees (write 355)",
    'goniophotometer(Snow(), [500], estimator="bins", polar_deg=[0, 30])':
        "polar_deg = [0.0, 30.0]: must be left out with bins (n_bins sets their number)",
    "goniophotometer(Snow(), [500], n_bins=(18, 72))":
        "n_bins = (18, 72): must be left out without estimator = bins",
    'goniophotometer(Snow(), [500], estimator="bins", n_bins=(18, 0))':
        "n_bins = (18, 0): must be two whole numbers from 1 to 1000",
    "time_of_flight(Snow(), [900], delay_s=[0.0, 1.0])":
        "delay_s = 1.0: must be in [-0.001, 0.001] s (in nanoseconds? multiply by 1e-9)",
    "time_of_flight(Snow(), [900], delay_s=[0.0])":
        "delay_s = [0.0]: must be at least two delays, the edges of bins",
    "time_of_flight(Snow(), [900], acceptance_deg=np.ma.masked)":
        "acceptance_deg = masked: must be in (0, 90] degrees",
    'albedo(Snow(), "overcat", [500])': "sky = 'overcat': must be one of …",
    'beam_spread(Snow(), [500], "diffuse")':
        "incidence_deg = 'diffuse': must be an angle (this instrument takes a beam)",
    "irradiance_profile(Snow(), [500], depth_m=[0.2])":
        "depth_m = 0.2: must be in (0, 0.12) m (top and bottom are always included)",
    "irradiance_profile(Snow(), [500], depth_m=[])":
        "depth_m = []: must be numbers in metres, at least one",
    "spectrophotometer(Snow(), [])":
        "wavelength_nm = []: must be numbers in nanometres, at least one",
    "spectrophotometer(Snow(), [500, 500])":
        "wavelength_nm = [500.0, 500.0]: must be strictly increasing (numbers 1 and 2 of 2)",
    'spectrophotometer(Snow(), "green")':
        "wavelength_nm = 'green': must be numbers in nanometres (this is text, not a number)",
    "spectrophotometer(Snow(), [500, 1e6])":
        "wavelength_nm = 1000000.0: must be in [200, 100000] nm",
    "spectrophotometer(Snow(), [500], -1)": "incidence_deg = -1: must be in [0, 89.9999] degrees",
    "spectrophotometer(Snow(), [500], None)":
        "incidence_deg = None: must be in [0, 89.9999] degrees",
    "spectrophotometer(Snow(), [500], seed=2**63)":
        "seed = 9223372036854775808: must be a whole number from 0 to 9223372036854775807",
    "spectrophotometer(Snow(), [500], threads=0)":
        "threads = 0: must be a whole number of at least 1",
    'spectrophotometer(Snow(), [500], estimator="spektral")':
        "estimator = 'spektral': must be one of analog, spectral (did you mean spectral?)",
    'spectrophotometer(Snow(), [500], kernel="vector")':
        "kernel = 'vector': must be one of auto, scalar, vectorized (did you mean vectorized?)",
    'goniophotometer(Snow(), [500], target="brfd")':
        "target = 'brfd': must be one of brdf, btdf (did you mean brdf?)",
    "goniophotometer(Snow(), [500], azimuth_deg=[])":
        "azimuth_deg = []: must be numbers in degrees, at least one",
    'goniophotometer(Snow(), [500], estimator="bins", n_bins=7)':
        "n_bins = 7: must be two whole numbers from 1 to 1000",
    "lens(Snow(), radius_m=1, screen_depth_m=[2.0, 1.0])":
        "screen_depth_m = [2.0, 1.0]: must be strictly increasing (numbers 1 and 2 of 2)",
    'lens(Snow(), radius_m=1, screen_depth_m=["deep"])':
        "screen_depth_m = 'deep': must be numbers in metres (this is text, not a number)",
    "lens(Snow(), radius_m=0, screen_depth_m=[1.0])": "radius_m = 0: must be in (0, 1e+06] m",
    'lens(Snow(), radius_m=1, screen_depth_m=[1.0], centre_on="valley")':
        "centre_on = 'valley': must be one of crest, origin, trough",
    "lens(Snow(), radius_m=1, screen_depth_m=[1.0], rays=2)":
        "rays = 2: must be a whole number of at least 3",
    "lens(Snow(), radius_m=1, screen_depth_m=[1.0], half_width_m=0.0)":
        "half_width_m = 0.0: must be in [1e-09, 1e+06] m",
}  # fmt: skip
"""Messages of calls; … stands for names."""

SECTIONS = {
    "instrument: goniophotometer":
        "line 1: instrument = 'goniophotometer': must be a mapping of keys to values (write "
        "instrument: {kind: goniophotometer, …})",
    "instrument: {kind: brdf}":
        "line 1: instrument.kind = 'brdf': must be one of … (did you mean goniophotometer?)",
    "instrument: {kind: gonio}": "line 1: instrument.kind = 'gonio': must be one of …",
    "instrument: {solver: }":
        "line 1: instrument.solver = None: must be one of auto, discrete_ordinates, monte_carlo",
    "instrument: {wavelength_nm: }":
        "line 1: instrument.wavelength_nm = None: must be numbers in nanometres",
    "instrument: {wavelength_nm: visible}":
        "line 1: instrument.wavelength_nm = 'visible': must be numbers in nanometres (this is "
        "text, not a number)",
    "instrument: {wavelength_nm: {start: 400, stop: 500}}":
        "line 1: instrument.wavelength_nm.step = None: must be given (start, stop and step give "
        "evenly spaced values)",
    "instrument: {wavelength_nm: {start: 400, stop: 505, step: 10}}":
        "line 1: instrument.wavelength_nm.stop = 505.0: must be a whole number of steps from "
        "start, such as 500 or 510",
    "instrument: {wavelength_nm: {start: 400, end: 500, step: 10}}":
        "line 1: instrument.wavelength_nm.end: unknown key, must be one of start, stop, step, "
        "also (did you mean stop?)",
    "instrument: {wavelength_nm: {start: 400, stop: 500, step: 10, also: x}}":
        "line 1: instrument.wavelength_nm.also = 'x': must be numbers in nanometres (this is "
        "text, not a number)",
    "instrument: {incidence_deg: [0, 60]}":
        "line 1: instrument.incidence_deg = [0, 60]: must be one angle or diffuse (several "
        "values belong under grid)",
    "instrument: {incidence_deg: sun}":
        "line 1: instrument.incidence_deg = 'sun': must be an angle in degrees, or diffuse",
    "instrument: {incidence_deg: 30}\ngrid: {incidence_deg: [0, 60]}":
        "line 1: instrument.incidence_deg = 30: must be left out (grid.incidence_deg has its "
        "values)",
    "instrument: {radius_m: 3}":
        "line 1: instrument.radius_m = 3: must be left out for spectrophotometer (it belongs to "
        "lens)",
    "instrument: {stderr_scale: '2'}":
        "line 1: instrument.stderr_scale = '2': must be in [0.01, 100] (write 2, without quotes)",
    "instrument: {point_stderr_scale: [1, 2, 3]}\ngrid: {depth_m: [0.1, 0.2]}":
        "line 1: instrument.point_stderr_scale = [1, 2, 3]: must be 2 numbers, one for each "
        "point of the grid",
    "instrument: {seed: -1}": "line 1: instrument.seed = -1: must be a whole number of at least 0",
    "instrument: {kind: goniophotometer, rays: 1000, stderr_scale: 2}":
        "line 1: instrument.stderr_scale = 2: must be left out with rays (the number of rays is "
        "fixed there, not the error)",
    "instrument: {kind: goniophotometer, estimator: bins, azimuth_deg: [0, 30]}":
        "line 1: instrument.azimuth_deg = [0, 30]: must be left out with bins (n_bins sets "
        "their number)",
    "instrument: {kind: goniophotometer, n_bins: [18, 72]}":
        "line 1: instrument.n_bins = [18, 72]: must be left out without estimator = bins",
    "instrument: {kind: table, polar_deg: 30}":
        "line 1: instrument.azimuth_deg = None: must be given (polar_deg needs it)",
    "instrument: {kind: table, quantities: []}\ngrid: {depth_m: [0.1, 0.2]}":
        "line 1: instrument.quantities = []: must be a list of different reflectance or "
        "transmittance",
    "instrument: {kind: table}": "grid = {}: must be a mapping from parameters to lists of values",
    "instrument: {kind: lens, radius_m: 0.1}":
        "line 1: instrument.screen_depth_m = None: must be given (depths of the screens (m))",
    "instrument: {kind: time_of_flight, depths_m: [0.1]}":
        "line 1: instrument.depths_m: unknown key, must be one of … (did you mean depth_m?)",
    "instrument: {kind: beam_spread}\ngrid: {depth_m: [0.1, 0.2]}":
        "line 1: instrument.half_width_m = None: must be given where there is a grid (all maps "
        "have the same axes)",
    "instrument: {kind: refractive_index}\ngrid: {depth_m: [0.1, 0.2]}":
        "line 2: grid = {'depth_m': ['0.1', '0.2']}: must be of one value for refractive_index",
    "instrument: {kind: albedo}":
        "line 1: instrument.sky = 'clear': must be astm_g173 or a sky of SNICAR, such as "
        "midlatitude_winter (only snowpacks of a file have the zenith angle of the sun that it "
        "needs)",
    "instrument: {kind: albedo, sky: [500]}":
        "line 1: instrument.sky = [500]: must be one of astm_g173, clear, high_mountain, "
        "midlatitude_winter, midlatitude_winter_cloudy, subarctic_summer, "
        "subarctic_summer_cloudy, summit_greenland",
    "instrument: {kind: albedo, sky: overcast}":
        "line 1: instrument.sky = 'overcast': must be one of … (did you mean "
        "midlatitude_winter_cloudy?)",
    "instrument: {kind: irradiance_profile}":
        "line 1: instrument.depth_m = None: must be given (depths, besides those of top and "
        "bottom (m))",
    "medium: {kind: natural_snow, ssa: 20}":
        "line 1: medium.ssa: unknown key, must be one of … (did you mean "
        "specific_surface_area_m2_kg?)",
    "medium: {density_kg_m3: [200, 300]}":
        "line 1: medium.density_kg_m3 = [200, 300]: must be in [1e-12, 916.9) kg/m3 (several "
        "values belong under grid)",
    "medium: {interpretation: {boundary_fresnel: maybe}}":
        "line 1: medium.interpretation.boundary_fresnel = 'maybe': must be one of no, yes",
    "medium: {kind: stack, layers: [{depth_m: -1}]}":
        "line 1: medium.layers.0.depth_m = -1: must be in (0, 10000] m (or infinite: .inf in "
        "YAML, math.inf in Python)",
    "medium: {kind: sand, saturation: .nan}": "line 1: medium.saturation = nan: must be in [0, 1]",
    "grid: {density_kg_m3: [100, 2000]}":
        "line 1: grid.density_kg_m3 = 2000: must be in [1e-12, 916.9) kg/m3 (ice at -1 °C has "
        "916.9)",
    "grid: {density: [100, 200]}":
        "line 1: grid.density: unknown key, must be one of … (did you mean density_kg_m3?)",
}  # fmt: skip
"""Messages of experiment files, after the path; … stands for names."""


def elide_names(message):
    """Return a message without the names that are allowed, if they are many."""
    short = re.sub(r"must be one of .*?(?= \(did|$)", "must be one of …", message)
    return short if len(message) > 190 else message


@pytest.mark.parametrize("call", CALLS)
def test_mistakes_in_calls_give_one_line(call):
    with pytest.raises((ValueError, TypeError)) as error:
        eval(call, NAMES)
    assert elide_names(str(error.value)) == CALLS[call]


@pytest.mark.parametrize("text", SECTIONS)
def test_mistakes_in_files_give_one_line(text, tmp_path):
    path = tmp_path / "made.yaml"
    path.write_text(f"{text}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(str(path))) as error:
        load_experiment(path)
    message = str(error.value).removeprefix(str(path)).lstrip(",: ")
    assert elide_names(message) == SECTIONS[text]


# --------------------------------------------------------------------------------------------------
# Limits of all numbers.


def list_numbers():
    """Return all declared numbers whose limits do not depend on other inputs, by name."""
    owners = (*MEDIUM_CLASSES.values(), RandomHeightField, *load_instruments().values())
    inputs = {(name, one.quantity): one for cls in owners for name, one in list_inputs(cls).items()}
    return [
        pytest.param(name, one, id=name)
        for (name, quantity), one in inputs.items()
        if quantity.check is None and math.isfinite(max(quantity.low, -quantity.high))
    ]


@pytest.mark.parametrize(("name", "declared"), list_numbers())
def test_numbers_are_checked_by_their_declaration(name, declared):
    quantity = declared.quantity
    is_whole = "integer" in str(declared.adapter.json_schema())
    refused = [True, np.True_, "0.3", "x", math.nan, np.ma.masked, [0.5], 0.5j, np.timedelta64(1)]
    for limit, away, is_open in (
        (quantity.low, -1, quantity.open_low), (quantity.high, 1, quantity.open_high),
    ):  # fmt: skip
        if not math.isfinite(limit):
            continue
        refused.append(
            int(limit) + away if is_whole else limit + away * (1e-6 * abs(limit) or 1e-6)
        )
        if is_open:
            refused.append(limit)
        elif is_whole:
            assert declared.check(name, np.int64(limit)) == limit
        else:
            rounded = limit + away * 1e-13 * abs(limit)
            for value in (limit, np.float64(limit), np.array(limit), rounded):
                checked = declared.check(name, value)
                assert checked == limit and type(checked) is float
    for value in refused:
        with pytest.raises(InvalidValue) as error:
            declared.check(name, value)
        assert str(error.value).startswith(f"{name} = {short_repr(value)}: must be ")


# --------------------------------------------------------------------------------------------------
# Declared classes.

Width = Annotated[float, Quantity("width", "m", low=0.0, high=9.0, open_low=True, infinite=True)]
Count = Annotated[int, Quantity("number of sides", low=1, high=9)]
Colour = Annotated[Literal["red", "blue"], Quantity("colour")]
Flag = Annotated[bool, Quantity("whether it is open")]
Area = Annotated[float, Quantity("area", "m2", low=0.0)]


@declare_class
class Box:
    """Box with a width or an area."""

    width_m: Width = 1.0
    sides: Count | None = None
    colour: Colour = "red"
    is_open: Flag = False
    area_m2: Area = alternative(replaces="width_m", compute="_compute_area", default=None)

    def __post_init__(self, area: Any) -> None:
        if area is not None:
            object.__setattr__(self, "width_m", math.sqrt(area))

    def _compute_area(self):
        return self.width_m**2

    @other_constructor({"colour": "blue"})
    def blue(cls, keywords):
        """Return a blue box."""
        return {"colour": "blue", **keywords}


def test_alternatives_are_keywords_and_properties():
    box = Box(area_m2=4)
    assert (box.width_m, box.area_m2, Box(3).area_m2) == (2.0, 4.0, 9.0)
    assert Box.ALTERNATIVES == {"area_m2": "width_m"}
    assert Box(1, None, "red", False, area_m2=None).width_m == 1.0
    for wrong in (lambda: Box(1, area_m2=4), lambda: box.__replace__(width_m=1, area_m2=4)):
        with pytest.raises(InvalidValue, match="area_m2 = 4: must be left out where width_m"):
            wrong()
    with pytest.raises(AttributeError):
        box.width_m = 3.0


def test_inputs_of_declared_classes_are_strict():
    assert Box(math.inf).width_m == math.inf and type(Box(np.float32(2)).width_m) is float
    assert Box(sides=np.int8(3)).sides == 3 and Box(is_open=np.True_).is_open is True
    for keywords in ({"sides": 2.0}, {"is_open": "yes"}, {"is_open": 1}, {"colour": True}):
        with pytest.raises(InvalidValue, match=f"^{next(iter(keywords))} = "):
            Box(**keywords)
    for values in ((1, 2, "red", False, 5), (1, 2, "red", False, 5, 6)):
        with pytest.raises(TypeError, match="too many positional"):
            Box(*values)
    with pytest.raises(TypeError, match="multiple values for argument 'width_m'"):
        Box(1, width_m=2)


def test_other_constructors_have_the_signature_of_the_class():
    assert (Box.blue().colour, Box.blue(colour="red").colour) == ("blue", "red")
    parameters = inspect.signature(Box.blue).parameters
    assert list(inspect.signature(Box).parameters) == list(list_inputs(Box))
    assert next(iter(parameters)) == "area_m2" and set(parameters) == set(list_inputs(Box))
    assert {one.kind for one in parameters.values()} == {inspect.Parameter.KEYWORD_ONLY}
    assert parameters["colour"].default == "blue" and parameters["width_m"].default == 1.0
    assert Box.blue.__doc__ == "Return a blue box."
    with pytest.raises(TypeError, match=r"^3: must have a keyword, such as area_m2=3$"):
        Box.blue(3)
    with pytest.raises(TypeError, match=r"^width: unknown key, .*did you mean width_m"):
        Box.blue(width=3)


NATURAL = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.5)
OBJECTS = [
    (splits.Snow(density_kg_m3=300), {"optical_radius_um": 200}),
    (NATURAL, {"liquid_water_content": 0.02}),
    (splits.Sand(texture=(0, 0.1, 0.9), ground=0.3), {"porosity": 0.4}),
    (splits.Stack([NATURAL, NATURAL]), {"ground": "black"}),
    (RandomHeightField(0.01, 10.0, "gaussian"), {"waves": 3}),
    (splits.Interpretation.from_input("geometric"), {"entry_point": "uniform"}),
    (SandInterpretation(mixing="linear"), {"water": "film"}),
]


@pytest.mark.parametrize(("made", "change"), OBJECTS, ids=lambda one: type(one).__name__)
def test_declared_objects_are_values(made, change):
    for same in (
        copy.copy(made), copy.deepcopy(made), pickle.loads(pickle.dumps(made)),
        eval(repr(made), NAMES), made.__replace__(),
    ):  # fmt: skip
        assert same == made and hash(same) == hash(made) and repr(same) == repr(made)
    replaced = made.__replace__(**change)
    ((name, value),) = change.items()
    assert type(replaced) is type(made) and replaced != made
    found = getattr(replaced, name)
    assert (found == pytest.approx(value)) if isinstance(value, float) else value in (
        found, getattr(found, "name", None), round(found) if isinstance(found, float) else None
    )  # fmt: skip
    with pytest.raises(AttributeError):
        setattr(made, name, value)
    others = {field.name for field in dataclasses.fields(made)} - {
        name, type(made).ALTERNATIVES.get(name),
    }  # fmt: skip
    assert all(getattr(replaced, one) == getattr(made, one) for one in others)


# --------------------------------------------------------------------------------------------------
# Inputs of functions, and JSON schemas.


def test_inputs_of_functions_are_those_with_a_quantity():
    inputs = list_inputs(splits.albedo)
    undeclared = {"medium", "progress"}
    names = [one for one in inspect.signature(splits.albedo).parameters if one not in undeclared]
    assert list(inputs) == names
    assert repr(inputs["wavelength_nm"].quantity) == "wavelength in vacuum (nm)"
    defaults = {name: one.default for name, one in inputs.items() if one.has_default}
    assert defaults["max_stderr"] == 0.005 and "bands" not in defaults and "sky" not in defaults
    assert inputs["bands"].check("bands", None) is None


@pytest.mark.parametrize(
    ("name", "schema"),
    [
        ("width_m", {"type": "number", "exclusiveMinimum": 0.0, "description": "width (m)"}),
        (
            "sides",
            {
                "anyOf": [
                    {"type": "integer", "minimum": 1, "maximum": 9,
                     "description": "number of sides"},
                    {"type": "null"},
                ]
            },
        ),
        ("colour", {"type": "string", "enum": ["red", "blue"], "description": "colour"}),
        ("is_open", {"type": "boolean", "description": "whether it is open"}),
    ],
)  # fmt: skip
def test_schemas_describe_what_is_allowed(name, schema):
    assert list_inputs(Box)[name].adapter.json_schema() == schema


def test_own_checks_have_own_schemas():
    def check(key, value):
        if value != "x":
            raise InvalidValue(key, value, "x")
        return value.upper()

    for schema, expected in (({"const": "x"}, {"const": "x"}), (None, {"type": "number"})):
        adapter = TypeAdapter(Annotated[float, Quantity("letter", check=check, schema=schema)])
        assert adapter.json_schema() == {"description": "letter", **expected}
        assert adapter.validate_python("x", context="key") == "X"
