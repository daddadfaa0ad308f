"""Variants of labelled inputs, and arguments of all public functions that take them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from array_inputs import (
    BAND_VALUES,
    BANDS,
    FIXED,
    MEASURED,
    SEA,
    SIZE,
    SNOW,
    TABLE,
    make_return_table,
)
from constructed_results import make_optics
from direction_tables import make_direction_dataset
from formula_tables import W

import splits


class Variants(NamedTuple):
    """A value of a parameter, and others with the same or with other labels.

    Attributes
    ----------
    value : object
    permuted : list
        The same content with labels in another order; results are the same to the bit.
    foreign : list
        Values with labels that belong to nothing; they are refused.
    descending : list
        Values whose coordinates descend; they are obeyed, with the same result, or refused.
    """

    value: Any
    permuted: Sequence[Any] = ()
    foreign: Sequence[Any] = ()
    descending: Sequence[Any] = ()

    def map(self, change: Callable[[Any], Any]) -> Variants:
        """Return the variants within another value."""
        lists = ([change(one) for one in row] for row in self[1:])
        return Variants(change(self.value), *lists)


def axis(*values: float) -> Variants:
    """Return the variants of increasing numbers without labels."""
    return Variants([*values], descending=[[*values][::-1], np.array(values)[::-1]])


def named(values: list[Any], labels: list[Any]) -> Variants:
    """Return the variants of numbers with names or other labels."""
    series = pd.Series(values, labels)
    others = [f"other {number}" for number in range(len(labels))]
    permuted = [series, series[::-1], series.rename_axis("x").to_xarray()[::-1]]
    return Variants(values, permuted, [series.set_axis(others)])


def names(**values: Any) -> Variants:
    """Return the variants of a mapping whose keys are names."""
    return Variants(values, [dict(reversed(values.items()))], [{**values, "foreign": 0.1}])


def columns(*, frame: bool = True, **values: list[float]) -> Variants:
    """Return the variants of columns, matched by the values of the first one, also as a frame."""
    first, *others = values
    permuted: list[Any] = [dict(reversed(values.items()))]
    permuted += [pd.DataFrame(values)] * frame
    foreign: list[Any] = []
    for name in others:
        column = named(values[name], values[first])
        permuted += [{**values, name: one} for one in column.permuted]
        foreign += [{**values, name: one} for one in column.foreign]
    descending: list[Any] = [{name: row[::-1] for name, row in values.items()}]
    descending += [pd.DataFrame(values)[::-1]] * frame
    foreign.append({**values, "foreign": values[first]})
    return Variants(values, permuted, foreign, descending)


def labelled(data: Any, *foreign: Any, required: str = "wavelength") -> Variants:
    """Return the variants of an object of xarray or pandas, with foreign ones given.

    An object of xarray without a required dimension is foreign, too.
    """
    if isinstance(data, pd.Series):
        return Variants(data, [data[::-1], data.to_xarray()[::-1]], [*foreign])
    dims = [str(dim) for dim in data.dims if dim in data.indexes]
    reverse = [{dim: slice(None, None, -1)} for dim in dims]
    renamed = [data.rename({required: "foreign"})] if required in data.dims else []
    return Variants(
        data, [data.isel(one) for one in reverse] + [data.transpose(*[*data.dims][::-1])],
        [*renamed, *foreign],
    )  # fmt: skip


def csv_file(folder: Path, **values: list[Any]) -> Variants:
    """Return the variants of a CSV file, all of the same name."""
    frame = pd.DataFrame(values)
    frames = (
        frame, frame[[*frame.columns][::-1]], frame.rename(columns={next(iter(values)): "foreign"}),
        frame[::-1],
    )  # fmt: skip
    paths = []
    for number, one in enumerate(frames):
        (folder / str(number)).mkdir()
        paths.append(folder / str(number) / "mine.csv")
        one.to_csv(paths[-1], index=False)
    value, permuted, foreign, descending = paths
    return Variants(value, [permuted], [foreign], [descending])


def netcdf_file(folder: Path, variants: Variants) -> Variants:
    """Return the variants of a netCDF file of another program."""

    def write(dataset: xr.Dataset) -> Path:
        path = folder / f"{len([*folder.iterdir()])}.nc"
        dataset.to_netcdf(path)
        return path

    return variants.map(write)


TIMES = pd.date_range("2024-02-01", periods=3, freq="D")


def make_dataset() -> xr.Dataset:
    """Return snowpacks of two layers at three times."""
    values = {
        "thickness_m": [[0.1, 0.4], [0.2, 0.3], [0.05, 0.5]],
        "density_kg_m3": [[120.0, 300.0], [150.0, 310.0], [200.0, 320.0]],
        "specific_surface_area_m2_kg": [[40.0, 15.0], [30.0, 14.0], [25.0, 12.0]],
    }
    variables = {name: (("time", "layer"), np.array(rows)) for name, rows in values.items()}
    sun = {"sun_zenith_deg": ("time", [50.0, 60.0, 70.0])}
    return xr.Dataset({**variables, **sun}, {"time": TIMES, "layer": [0, 1]})


NM, ALBEDOS = [400.0, 800.0, 1600.0], [0.25, 0.5, 0.125]
SPECTRUM = columns(wavelength_nm=NM, albedo=ALBEDOS)
SERIES = pd.Series(ALBEDOS, pd.Index(NM, name="wavelength"))
SKY = columns(wavelength_nm=NM, direct=ALBEDOS, diffuse=ALBEDOS)
NATURAL = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.05)
SKY_OF_NATURAL = splits.sky({"wavelength_nm": NM, "direct": ALBEDOS, "diffuse": ALBEDOS}, 50.0)
QUICK = {"max_stderr": 0.5, "threads": 1}
DIRECTIONS = {
    "relative_stderr": 0.5, "threads": 1, "polar_deg": [0.0, 30.0], "azimuth_deg": [0.0, 90.0],
}  # fmt: skip
FEW_RAYS = {"rays": 2, "threads": 1}
PACKS = splits.SnowPacks(make_dataset())
BY_TIME = pd.Series([0.1, 0.2, 0.3], pd.DatetimeIndex(TIMES, name="time"))
OTHER_TIMES = BY_TIME.set_axis(TIMES + pd.Timedelta("1h")).rename_axis("time")
DIRECTION_TABLE = splits.Table(make_direction_dataset())
RETURNS = make_return_table()
DELAYS, RATES = [0.0, 1.0, 2.0, 3.0], [0.75, 0.375, 0.25]
RETURN = RETURNS.isel({SIZE: 2}, drop=True)[["return_rate", "delay_bounds"]].assign_attrs(
    title="a return"
)
ANGLES = np.linspace(0.0, 180.0, 19).tolist()
COSINES = np.cos(np.radians(ANGLES))
RAYLEIGH = {
    "angle_deg": ANGLES, "P11": (0.75 * (1 + COSINES**2)).tolist(),
    "P12": (-0.75 * (1 - COSINES**2)).tolist(), "P33": (1.5 * COSINES).tolist(),
    "P34": [0.0] * len(ANGLES),
}  # fmt: skip


def make_libradtran() -> Variants:
    """Return the variants of a scattering matrix in the form of libRadtran."""
    dims = ("nlam", "nreff", "nphamat", "nthetamax")
    rows = np.array([RAYLEIGH[name] for name in ("P11", "P12", "P33", "P34")])
    theta = np.broadcast_to(ANGLES, (1, 1, *rows.shape))
    data = xr.Dataset({
        "theta": (dims, theta), "phase": (dims, rows[np.newaxis, np.newaxis]),
        "ntheta": (dims[:3], np.full((1, 1, 4), len(ANGLES))),
    })  # fmt: skip
    return Variants(
        data, [data.transpose(*dims[::-1])], [data.drop_vars("theta")],
        [data.isel(nthetamax=slice(None, None, -1))],
    )  # fmt: skip


def make_crocus() -> xr.Dataset:
    """Return an output of Crocus with a coordinate of its layers."""
    dims = ("time", "snow_layer")
    values = {"SNOWDZ": 0.1, "RSN_VEG": 200.0, "SNOWSSA": 20.0, "SNOWLIQ": 0.0}
    step = np.arange(6.0).reshape(3, 2)
    data = xr.Dataset(
        {name: (dims, value * (1.0 + 0.1 * step)) for name, value in values.items()},
        {"time": TIMES, "snow_layer": [1, 2]},
    )
    data.SNOWLIQ.attrs["units"] = "kg m-3"
    return data


def make_layer_table() -> dict[str, list[Any]]:
    """Return a table of snowpacks, a row per layer."""
    frame = make_dataset().to_dataframe().reset_index()
    frame["time"] = frame.time.dt.strftime("%Y-%m-%dT%H:%M")
    return frame.to_dict("list")


def retrieve(bands: Any = None, **changes: Any) -> Any:
    """Return a retrieval from the table of formulas; `bands` come with their values."""
    if bands is not None:
        changes["bands"], changes["measured"] = bands
    arguments = {
        "measured": (W, MEASURED), "model": TABLE, "free": [SIZE], "noise": 0.0625, "fixed": FIXED,
    }  # fmt: skip
    return splits.retrieve(**(arguments | changes))


MEASURED_ARRAY = xr.DataArray(MEASURED, {"wavelength": W}, ("wavelength",), name="measured")
FOREIGN_WAVELENGTHS = MEASURED_ARRAY.assign_coords(wavelength=W + 5000.0)
OTHER_SUN = MEASURED_ARRAY.assign_coords(incidence_deg=60.0)
IMAGE = MEASURED_ARRAY.expand_dims(y=[1, 2], x=[5, 6]).copy()
NOISE = named(np.linspace(0.05, 0.1, W.size).tolist(), W.tolist())
LIGHT = xr.DataArray(RATES, {"delay_s": [0.5, 1.5, 2.5]}, ("delay_s",), name="light")


def make_cases(folder: Path) -> dict[str, Any]:
    """Return the arguments of public functions by name, of which `Variants` are tested.

    Each function has base arguments and, by parameter, a list of variants, which is empty for
    parameters without labels, such as names, positions and files with a test of their own.
    """

    def new(name: str) -> Path:
        (folder / name).mkdir()
        return folder / name

    ground_file = csv_file(new("ground"), wavelength_nm=NM, albedo=ALBEDOS)
    ground = [SPECTRUM, labelled(SERIES), labelled(SERIES.to_xarray()), ground_file]
    index = {"wavelength_nm": NM, "n": [1.25, 1.5, 1.75], "k": ALBEDOS}
    indices = [columns(**index), csv_file(new("index"), **index)]
    cross_section = {"wavelength_nm": NM, "absorption_m2_kg": ALBEDOS}
    impurities = [
        columns(**cross_section).map(
            lambda one: {"mine": {**one, "ng_g": 5} if isinstance(one, Mapping) else
                         {**one.to_dict("list"), "ng_g": 5}}
        ),
        csv_file(new("impurity"), **cross_section).map(
            lambda one: {"mine": {"ng_g": 5, "table": str(one)}}
        ),
        names(black_carbon=5.0, dust_sahara=10.0),
    ]  # fmt: skip
    shape = named([0.25, 0.5, 0.375, 0.125], ["min", "max", "mean", "sd"])
    fluids = names(brine=0.2, oil=0.3)
    fluid_index = {"brine": 1.35, "oil": 1.5}
    wet = {"pores": fluids.value, "refractive_index": fluid_index}
    snow = {
        "grain_size_um": [named([64.0, 128.0], ["min", "max"])],
        "facetness": [shape], "sphericity": [shape],
        "refractive_index": [one.map(lambda table: {"ice": table, **fluid_index})
                             for one in indices],
        "ground": ground, "impurities_ng_g": impurities,
        "algae_cells_ml": [names(snow_algae=10.0, ice_algae=20.0)],
        "pores": [fluids],
    }  # fmt: skip
    matrix = xr.Dataset.from_dataframe(pd.DataFrame(RAYLEIGH).set_index("angle_deg"))
    matrices = [
        columns(**RAYLEIGH), labelled(matrix, required="angle_deg"),
        csv_file(new("matrix"), **RAYLEIGH),
        netcdf_file(new("cdf"), labelled(matrix, required="angle_deg")), make_libradtran(),
        netcdf_file(new("libradtran"), make_libradtran()),
    ]  # fmt: skip
    spectrum = columns(frame=False, wave_number_per_m=[0.0, 1.0, 2.0], density=ALBEDOS)
    surface = spectrum.map(
        lambda one: {"rms_height_m": 1.0, "correlation": "spectrum", "spectrum": one}
    )
    place = {SIZE: 150.0, "incidence_deg": 30.0, "polar_deg": 20.0, "azimuth_deg": 30.0}
    bands = columns(wavelength_nm=NM, response=ALBEDOS).map(lambda one: {"mine": one})
    skies = [SKY, csv_file(new("sky"), **SKY.value)]
    per_pack = [
        labelled(BY_TIME, OTHER_TIMES),
        labelled(BY_TIME.to_xarray(), OTHER_TIMES.to_xarray()),
    ]
    over_both = BY_TIME.to_xarray() * xr.DataArray(
        [1.0, 2.0], {"wavelength": [400.0, 1600.0]}, ("wavelength",)
    )
    pack_ground = [*ground, *per_pack, labelled(over_both)]
    data = make_dataset()
    table = TABLE.dataset
    optics = make_optics(noise=1e-3)
    pulse = columns(delay_s=[0.0, 1e-4, 3e-4], power=ALBEDOS)
    return {
        "Snow": (wet, {**snow, "interpretation": []}),
        "Snow.natural": ({"grain_size_um": (64.0, 128.0), "depth_m": 0.05, **wet},
                         {**snow, "interpretation": []}),
        "Sand": ({**wet, "interpretation": {"water": "whole_pores"}}, {
            "interpretation": [],
            "partition": [named([0.25, 0.5, 0.25], ["pure", "mixed", "coated"])],
            "texture": [named([0.0, 0.125, 0.875], ["clay", "silt", "sand"])],
            "roundness": [], "sphericity": [shape],
            "refractive_index": [one.map(lambda table: {"quartz": table, **fluid_index})
                                 for one in indices],
            "ground": ground, "pores": [fluids],
        }),
        "ParticleLayer": ({"depth_m": 100.0}, {
            "surface": [surface], "scattering_matrix": matrices,
            "phase_function": [columns(frame=False, cosine=[-1.0, 0.0, 1.0], density=ALBEDOS)],
            "ground": ground,
        }),
        "RoughSurface": ({}, {"fields": [surface]}),
        "Stack": ({"layers": [SNOW]}, {"ground": ground, "layers": []}),
        "Sky": ({"name": "mine", "source": "me", "zenith_deg": 50.0, **SKY.value}, {
            "wavelength_nm": [axis(*NM)], "direct": [named(ALBEDOS, NM)],
            "diffuse": [named(ALBEDOS, NM)],
        }),
        "sky": ({"zenith_deg": 50.0}, {"spectrum": skies}),
        "SnowPacks": ({"data": data}, {
            "data": [labelled(data, required="layer"), columns_of_layers(data)],
            "ground": pack_ground,
        }),
        "SnowPacks.with_sun_zenith": ({}, {"sun_zenith_deg": per_pack}),
        "SnowPacks.with_ground": ({}, {"ground": pack_ground}),
        "SnowPacks.make_stack": ({"label": TIMES[0]}, {"ground": ground}),
        "SnowPacks.iterate_stacks": ({}, {"ground": ground}),
        "SnowPacks.compute_ground_albedo": ({}, {"wavelength_nm": []}),
        "read_snow_packs": ({}, {
            "file": [csv_file(new("packs"), **make_layer_table()).map(str),
                     netcdf_file(new("nc"), labelled(data, required="layer")).map(str),
                     netcdf_file(new("crocus"), labelled(make_crocus(),
                                                         required="snow_layer")).map(str)],
            "ground": [],
        }),
        "read_crocus": ({}, {
            "source": [labelled(make_crocus(), required="snow_layer"),
                       netcdf_file(new("crocus_file"),
                                   labelled(make_crocus(), required="snow_layer"))],
            "impurities": [],
        }),
        "read_caaml": ({}, {"path": []}),
        "load": ({}, {"path": []}),
        "load_medium": ({}, {"name": [], "keywords": []}),
        "save": ({}, {"dataset": [], "path": []}),
        **dict.fromkeys(("make_colour_table", "select_principal_plane"),
                        ({}, {"dataset": []})),
        "draw": ({}, {"dataset": [], "settings": []}),
        "Table": ({}, {"dataset": [labelled(table)]}),
        "Table.at_view": ({"polar_deg": 20.0, "azimuth_deg": 30.0}, {
            "diffuse_fraction": [named([0.25, 0.5], [500.0, 900.0])]}),
        "Table.fix_view": ({}, {"at": [names(polar_deg=20.0, azimuth_deg=30.0)]}),
        "Table.locate": ({}, {"point": []}),
        "Table.complete_point": ({}, {"at": [names(**place)]}),
        "Table.interp": (place, {"at": [names(**place)], "bands": [
            columns(wavelength_nm=[500.0, 900.0], response=[0.25, 0.5]).map(
                lambda one: {"mine": one})]}),
        "Table.derivatives": ({"names": [SIZE]}, {"at": []}),
        "Table.deviations": ({}, {"at": []}),
        "Table.interpolation_errors": ({}, {"at": []}),
        "spectrophotometer": ({"medium": NATURAL, "wavelength_nm": NM, **QUICK}, {
            "wavelength_nm": [axis(*NM)], "incidence_deg": [], "stokes": []}),
        "albedo": ({"medium": NATURAL, "sky": SKY_OF_NATURAL, "wavelength_nm": NM, **QUICK}, {
            "sky": [], "wavelength_nm": [axis(*NM)],
            "bands": [bands, names(blue=(400, 500), red=(600, 700))._replace(foreign=[])]}),
        "hdrf": ({"medium": NATURAL, "sky": SKY_OF_NATURAL, "wavelength_nm": NM, **DIRECTIONS}, {
            "sky": [], "wavelength_nm": [axis(*NM)], "polar_deg": [axis(0.0, 30.0)],
            "azimuth_deg": [axis(0.0, 90.0)], "bands": [bands]}),
        "goniophotometer": ({"medium": NATURAL, "wavelength_nm": NM, **DIRECTIONS}, {
            "wavelength_nm": [axis(*NM)], "polar_deg": [axis(0.0, 30.0)],
            "azimuth_deg": [axis(0.0, 90.0)], "n_bins": [], "stokes": []}),
        "radiation_profile": (
            {"medium": NATURAL, "sky": SKY_OF_NATURAL, "depth_m": [0.01], "wavelength_nm": NM,
             **QUICK},
            {"sky": [], "depth_m": [axis(0.01, 0.02)], "wavelength_nm": [axis(*NM)],
             "bands": [bands]}),
        "irradiance_profile": (
            {"medium": NATURAL, "wavelength_nm": NM, "depth_m": [0.01], **QUICK},
            {"wavelength_nm": [axis(*NM)], "depth_m": [axis(0.01, 0.02)]}),
        "beam_spread": ({"medium": SNOW, **FEW_RAYS}, {"wavelength_nm": [axis(*NM)]}),
        "single_scattering": ({"medium": SNOW, **FEW_RAYS}, {"wavelength_nm": [axis(*NM)]}),
        "time_of_flight": ({"medium": SNOW, "wavelength_nm": NM, **FEW_RAYS}, {
            "wavelength_nm": [axis(*NM)], "delay_s": [axis(0.0, 1e-4, 4e-4)],
            "depth_m": [axis(0.001, 0.002)],
            "pulse": [pulse._replace(value=None, permuted=[])]}),
        "build_table": ({"make": lambda saturation: NATURAL, "grid": {"saturation": [0.0]},
                         "wavelength_nm": NM, **QUICK}, {
            "grid": [Variants(None, descending=[{"saturation": [1.0, 0.0]}])],
            "wavelength_nm": [axis(*NM)], "bands": [bands], "folder": [],
            "delay_s": [axis(0.0, 1e-4, 4e-4)._replace(permuted=[], descending=[])]}),
        "lens": ({"medium": SEA, "screen_depth_m": [1.0], "radius_m": 1.0, "centre_on": "origin",
                  "rays": 3}, {"screen_depth_m": [axis(1.0, 2.0)], "waves": []}),
        "compute_mie_matrix": (
            {"wavelength_nm": [400.0, 800.0], "index": 1.5, "radius_um": [0.125, 0.25],
             "number_density": [0.25, 0.5], "angle_deg": [0.0, 90.0]},
            {"wavelength_nm": [axis(400.0, 800.0)], "radius_um": [axis(0.125, 0.25)],
             "number_density": [named([0.25, 0.5], [0.125, 0.25])],
             "index": [named([1.25, 1.5], [400.0, 800.0])], "angle_deg": [axis(0.0, 90.0)]}),
        "phase_function": ({"optics": optics, "angle_deg": [0.0, 90.0]}, {
            "optics": [labelled(optics)], "angle_deg": [axis(0.0, 90.0)]}),
        "with_diffraction": ({}, {"optics": [labelled(optics)]}),
        "retrieve": ({}, {
            "measured": [
                labelled(MEASURED_ARRAY, FOREIGN_WAVELENGTHS, OTHER_SUN),
                labelled(MEASURED_ARRAY.to_series(), FOREIGN_WAVELENGTHS.to_series()),
                named(MEASURED.tolist(), W.tolist()).map(lambda one: (W, one)),
                Variants((W, MEASURED), descending=[(W[::-1], MEASURED[::-1])]),
            ],
            "noise": [NOISE, named([0.05] * W.size, W.tolist()).map(
                lambda one: {"stderr": one, "correlation_nm": 100.0})],
            "free": [named([64.0, 512.0], ["low", "high"]).map(lambda one: {SIZE: one})],
            "prior": [named([128.0, 64.0], ["mean", "standard deviation"]).map(
                lambda one: {SIZE: one})],
            "fixed": [names(**FIXED)], "model": [], "bands": [bands_of_retrieval()],
        }),
        "retrieve_map": ({"image": IMAGE, "table": TABLE, "free": [SIZE], "noise": 0.0625,
                          "fixed": FIXED}, {
            "image": [labelled(IMAGE, IMAGE.assign_coords(wavelength=W + 5000.0),
                               IMAGE.assign_coords(incidence_deg=60.0))],
            # Images in bands have their own tests (test_retrieval_in_bands.py).
            "bands": [], "noise": [NOISE], "fixed": [names(**FIXED)],
            "free": [named([64.0, 512.0], ["low", "high"]).map(lambda one: {SIZE: one})],
            "prior": [named([128.0, 64.0], ["mean", "standard deviation"]).map(
                lambda one: {SIZE: one})],
        }),
        "retrieve_return": (
            {"measured": (DELAYS, RATES), "table": RETURNS, "free": [SIZE], "noise": 0.0625}, {
                "measured": [
                    labelled(RETURN, RETURN.assign_coords(wavelength=[1064.0]),
                             RETURN.assign_attrs(acceptance_deg=5.0),
                             RETURN.assign_attrs(pulse_s=1e-3)),
                    labelled(LIGHT, LIGHT.assign_coords(delay_s=[1.5, 2.5, 3.5]),
                             LIGHT.assign_coords(wavelength=1064.0)).map(
                        lambda one: (DELAYS, one)),
                    Variants((DELAYS, RATES), descending=[(DELAYS[::-1], RATES[::-1])]),
                ],
                "table": [labelled(RETURNS)],
                "noise": [named([0.05, 0.1, 0.2], [0.5, 1.5, 2.5])],
                "pulse": [pulse._replace(value=None, permuted=[])],
                "free": [named([64.0, 512.0], ["low", "high"]).map(lambda one: {SIZE: one})],
                "prior": [named([128.0, 64.0], ["mean", "standard deviation"]).map(
                    lambda one: {SIZE: one})],
                "fixed": [],
            }),
    }  # fmt: skip


def columns_of_layers(data: xr.Dataset) -> Variants:
    """Return the variants of a table of snowpacks with a row for each layer."""
    frame = data.to_dataframe().reset_index()
    return Variants(
        frame, [frame[::-1], frame[[*frame.columns][::-1]], frame.set_index(["time", "layer"])],
        [frame.rename(columns={"thickness_m": "foreign"})],
    )  # fmt: skip


def bands_of_retrieval() -> Variants:
    """Return the variants of bands with their values, as a pair."""
    return named(BAND_VALUES, [*BANDS]).map(lambda one: (BANDS, one))
