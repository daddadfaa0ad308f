"""Array arguments of all public functions: gaps, labels, and types other than doubles."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from array_inputs import CASES, FIXED, SIZE, TABLE, retrieve_image
from chi2 import NEEDS_JIT
from constructed_results import make_optics
from formula_tables import W
from run_attributes import drop_run_specific_attributes

import splits
from splits.core.validation import InvalidValue
from splits.retrieval.maps import FLAGS

EQUIVALENT_INPUTS = {
    "read-only": lambda a: np.lib.stride_tricks.as_strided(a, writeable=False),
    "float16": lambda a: a.astype(np.float16),
    "big-endian": lambda a: a.astype(">f8"),
    "every other": lambda a: np.repeat(a, 2, axis=0)[::2],
    "DataArray": xr.DataArray,
    "objects": lambda a: a.astype(object),
}
"""Conversions to equivalent array types."""


def replace_first(a, value, dtype):
    changed = a.astype(dtype)
    changed.flat[0] = value
    return changed


INVALID_INPUTS = {
    "masked": lambda a: np.ma.masked_array(a, np.arange(a.size).reshape(a.shape) == 0),
    "all masked": lambda a: np.ma.masked_array(a, True),
    "NaN": lambda a: replace_first(a, np.nan, float),
    "infinite": lambda a: replace_first(a, np.inf, float),
    "NA": lambda a: replace_first(a, pd.NA, object),
    "nullable": lambda a: pd.array([None, *a[1:]], dtype="Float64") if a.ndim == 1 else [pd.NA],
    "truth": lambda a: np.ones(a.shape, dtype=bool),
    "truth among numbers": lambda a: [True, *a.tolist()[1:]],
    "date": lambda a: a.astype("datetime64[ns]"),
    "duration": lambda a: a.astype("timedelta64[ns]"),
    "text": lambda a: a.astype(str),
    "complex": lambda a: a.astype(complex),
    "set": lambda a: set(a.ravel().tolist()),
}
"""Conversions to invalid input."""

LABELLED = {name: case for name, case in CASES.items() if case.labels}
NON_ARRAYS = {
    "Progress", "ProgressBar", "Interpretation", "SandInterpretation", "__version__", "list_media",
    "load", "load_medium", "read_caaml", "read_crocus",
    "read_snow_packs", "save", "sensor_bands", "surface_map", "draw",
    "make_colour_table", "select_principal_plane",
}  # fmt: skip
"""Public names without array arguments, and those of datasets."""
DATASET_CALLS = {"with_diffraction", "retrieve_map", "SnowPacks", "Table"}
"""Functions whose arrays are within datasets, tested separately below."""


def list_case_names(cases, runs=False):
    marks = {True: [NEEDS_JIT], False: []}
    return [
        pytest.param(case, id=name, marks=marks[runs and case.runs]) for name, case in cases.items()
    ]


def assert_same(left, right):
    if isinstance(left, xr.Dataset):
        xr.testing.assert_identical(
            drop_run_specific_attributes(left), drop_run_specific_attributes(right)
        )
    else:
        for a, b in zip(np.atleast_1d(left), np.atleast_1d(right), strict=True):
            np.testing.assert_array_equal(a, b)


def test_all_public_functions_are_covered():
    covered = {name.split()[0].partition(".")[0] for name in CASES} | DATASET_CALLS
    assert covered >= set(splits.__all__) - NON_ARRAYS
    assert not covered & NON_ARRAYS


@pytest.mark.long
@pytest.mark.parametrize("case", list_case_names(CASES, runs=True))
def test_equivalent_inputs_give_the_same_result(case):
    values = np.array(case.values)
    native = case.call(values)
    assert_same(native, case.call(case.values))
    for form in EQUIVALENT_INPUTS.values():
        assert_same(native, case.call(form(values)))


@pytest.mark.parametrize("case", list_case_names(CASES, runs=True))
def test_zero_dimensional_arrays_are_scalars_or_rejected(case):
    first = np.array(case.values).ravel()[:1]
    if case.one:
        assert_same(case.call(float(first[0])), case.call(first.reshape(())))
        return
    with pytest.raises(InvalidValue) as error:
        case.call(np.array(case.values).ravel()[0].reshape(()))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", INVALID_INPUTS)
@pytest.mark.parametrize("case", list_case_names(CASES))
def test_gaps_and_non_numbers_are_rejected_in_one_line(case, kind):
    if case is CASES["build_table grid"] and kind == "text":
        pytest.skip("an axis may have texts")
    with pytest.raises(InvalidValue) as error:
        case.call(INVALID_INPUTS[kind](np.array(case.values)))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("case", list_case_names(LABELLED, runs=True))
def test_labelled_values_are_matched_by_label(case):
    native = case.call(case.values)
    series = pd.Series(case.values, case.labels)
    for labelled in (series, series[::-1], series.rename_axis("x").to_xarray()[::-1]):
        assert_same(native, case.call(labelled))
    other_labels = [f"other {i}" for i in range(len(case.values))]
    for labels in (
        other_labels,
        [*case.labels[1:], 3.0],
        pd.date_range("2020", periods=len(other_labels)),
    ):
        with pytest.raises(InvalidValue, match=r"values at .*must be values at") as error:
            case.call(pd.Series(case.values, labels))
        assert "\n" not in str(error.value)


def test_columns_of_one_frame_are_matched():
    frame = pd.DataFrame({"w": [300.0, 400.0, 800.0, 1600.0], "a": [0.1, 0.2, 0.3, 0.4]})
    subset = frame[frame.w > 300.0]
    for w, a in (
        (subset.w, subset.a),
        (subset.w, subset.a[::-1]),
        (subset.w.to_numpy(), subset.a.to_list()),
    ):
        ground = splits.Snow(ground={"wavelength_nm": w, "albedo": a}).ground
        assert ground.albedo_values.tolist() == [0.2, 0.3, 0.4]
    with pytest.raises(InvalidValue, match=r"ground.albedo = 'values at \[1, 2, 3\]'"):
        splits.Snow(ground={"wavelength_nm": subset.w.to_list(), "albedo": subset.a})


def test_a_covariance_is_matched_along_both_axes():
    errors = np.linspace(0.01, 0.03, W.size)
    table = pd.DataFrame(np.diag(errors**2), W, W)
    measured = (W, np.full(W.size, 0.5))
    expected = splits.retrieve(measured, TABLE, [SIZE], errors, fixed=FIXED).dataset
    reordered = splits.retrieve(
        measured, TABLE, [SIZE], table.iloc[::-1, ::-1], fixed=FIXED
    ).dataset
    assert_same(expected, reordered)
    with pytest.raises(InvalidValue, match=r"noise = .values at"):
        splits.retrieve(measured, TABLE, [SIZE], table.set_axis(W + 1.0, axis=1), fixed=FIXED)


@pytest.mark.parametrize("kind", ["masked", "NaN", "NA", "infinite"])
def test_maps_flag_gaps_of_every_kind(kind):
    values = np.full(W.size, 0.5)
    result = retrieve_image(INVALID_INPUTS[kind](values))
    assert result.quality_flag.values.tolist() == [FLAGS["gap"]]
    assert np.isnan(result[SIZE]).all()


@pytest.mark.parametrize("form", EQUIVALENT_INPUTS)
def test_maps_accept_all_equivalent_inputs(form):
    values = np.full(W.size, 0.5)
    assert_same(retrieve_image(values), retrieve_image(EQUIVALENT_INPUTS[form](values)))


@pytest.mark.parametrize("kind", ["truth", "date", "text", "complex"])
def test_maps_of_non_numbers_are_rejected(kind):
    with pytest.raises(InvalidValue, match="image = "):
        retrieve_image(INVALID_INPUTS[kind](np.full(W.size, 0.5)))


def test_weights_along_a_spectrum_are_matched():
    w, dims = [500.0, 600.0, 700.0], ("wavelength",)
    batches = (("batch", *dims), np.full((2, 3), 0.01))
    values = {"r": (dims, [0.5, 0.6, 0.7]), "r_stderr": (dims, [0.1, 0.2, 0.3])}
    dataset = xr.Dataset({**values, "r_batches": batches}, {"wavelength": w})
    weights = xr.DataArray([1.0, -2.0, 3.0], {"wavelength": w}, dims)
    sums = [dataset.errors.weighted_sum("r", order) for order in (weights, weights[::-1])]
    for one, other in zip(*sums, strict=True):
        assert_same(one.to_dataset(name="sum"), other.to_dataset(name="sum"))
    for invalid in (
        weights.assign_coords(wavelength=[500.0, 600.0, 800.0]),
        weights.where(weights > 0),
    ):
        with pytest.raises(InvalidValue, match="weights = "):
            dataset.errors.weighted_sum("r", invalid)[1]


def make_table(form, dataset):
    return splits.Table(dataset.copy(data={n: form(v.values) for n, v in dataset.items()}))


@pytest.mark.parametrize("form", EQUIVALENT_INPUTS)
def test_tables_accept_all_equivalent_inputs(form):
    dataset = TABLE.dataset.astype(np.float16)
    results = [
        make_table(convert, dataset).interp(**FIXED, **{SIZE: 100.0})
        for convert in (np.array, EQUIVALENT_INPUTS[form])
    ]
    assert_same(*results)


def make_snowpack(form, values):
    """Return the specific surface area of a snowpack whose variables are arrays of one type."""
    names = ("thickness_m", "density_kg_m3", "specific_surface_area_m2_kg")
    arrays = {name: (("time", "layer"), form(np.array(values))) for name in names}
    return splits.SnowPacks(xr.Dataset(arrays)).dataset


@pytest.mark.parametrize("form", sorted(set(EQUIVALENT_INPUTS) - {"DataArray"}))
def test_snowpacks_accept_all_equivalent_inputs(form):
    values = [[16.0, 32.0], [64.0, 128.0]]
    assert_same(make_snowpack(np.array, values), make_snowpack(EQUIVALENT_INPUTS[form], values))


@pytest.mark.parametrize("kind", ["truth", "date", "text", "complex"])
def test_snowpacks_of_non_numbers_are_rejected(kind):
    with pytest.raises(InvalidValue):
        make_snowpack(INVALID_INPUTS[kind], [[16.0, 32.0]])


GAP_CALLS = {
    "Table": lambda ds: splits.Table(ds).interp(**FIXED, **{SIZE: 40.0}),
    "retrieve": lambda ds: splits.retrieve(
        (W, np.full(W.size, 0.5)), splits.Table(ds), [SIZE], 0.1, fixed=FIXED
    ),
    "with_diffraction": lambda _: splits.with_diffraction(make_optics(albedo=np.nan)),
    "phase_function": lambda _: splits.phase_function(make_optics(albedo=np.nan), [0.0]),
}


@pytest.mark.parametrize("name", GAP_CALLS)
def test_datasets_with_gaps_are_rejected(name):
    with_gaps = TABLE.dataset.where(TABLE.dataset[SIZE] > 40.0)
    with pytest.raises(
        InvalidValue, match=r"gaps in .*masked, NaN or missing|a number at every node"
    ):
        GAP_CALLS[name](with_gaps)


@pytest.mark.parametrize("value", [np.ma.masked, pd.NA, np.nan, np.True_, np.datetime64(1, "ns"),
                                   np.timedelta64(1, "ns"), pd.NaT])  # fmt: skip
def test_gaps_are_rejected_as_scalars(value):
    for call in (
        lambda: splits.Snow(saturation=value),
        lambda: splits.Snow(ground=value),
        lambda: splits.Snow(refractive_index={"ice": value}),
        lambda: splits.ParticleLayer(optical_thickness=value),
        lambda: splits.Snow(grain_size_um=(value, 100.0)),
        lambda: splits.spectrophotometer(splits.Snow(), 500.0, value),
        lambda: splits.spectrophotometer(splits.Snow(), 500.0, seed=value),
        lambda: splits.goniophotometer(splits.Snow(), 500.0, estimator="bins", n_bins=(4, value)),
        lambda: splits.sky("clear", value),
        lambda: TABLE.interp(incidence_deg=value),
    ):
        with pytest.raises(InvalidValue) as error:
            call()
        assert "\n" not in str(error.value)


def test_input_arrays_are_not_modified():
    """Values that are clipped to the end of a range are clipped in a copy."""
    cosine = np.array([-1.0 - 1e-12, 0.0, 1.0])
    splits.ParticleLayer(phase_function={"cosine": cosine, "density": [1.0, 1.0, 1.0]})
    assert cosine[0] != -1.0
