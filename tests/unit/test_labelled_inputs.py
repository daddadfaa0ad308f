"""Labels of inputs of all public functions: any order, none that are foreign, all directions."""

import inspect
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
import xarray as xr
from labelled_inputs import DIRECTION_TABLE, NM, PACKS, make_cases, retrieve
from run_attributes import drop_run_specific_attributes

import splits

METHODS = {"SnowPacks": PACKS, "Table": DIRECTION_TABLE}
"""Classes whose methods take data, and an instance of each."""
DATA_TYPES = re.compile(
    r"\bAny\b|ndarray|xr\.|pd\.|Path|Mapping\[str, (?!.*Medium)|tuple\[|Sequence\[float\]|xarray"
)
"""Annotations of parameters that take arrays, datasets, tables, mappings or files."""
OTHER_PROGRAMS = "to_"
"""Prefix of methods that convert tables for other programs."""


def list_callables() -> dict[str, Any]:
    """Return all public functions, classes, constructors and methods that take data."""
    found = {name: getattr(splits, name) for name in splits.__all__ if name != "__version__"}
    found |= {"Snow.natural": splits.Snow.natural}
    for owner, instance in METHODS.items():
        for name in vars(type(instance)):
            is_method = callable(getattr(instance, name)) and not name.startswith(
                ("_", OTHER_PROGRAMS)
            )
            if is_method:
                found[f"{owner}.{name}"] = getattr(instance, name)
    return found


def describe_type(function: Any, annotation: Any) -> str:
    """Return the text of an annotation, with declared types in full."""
    with suppress(NameError, TypeError):
        return str(eval(annotation, vars(sys.modules[function.__module__])))
    return str(annotation)


def list_inputs() -> list[tuple[str, str]]:
    """Return all parameters that take data, as pairs of callable and parameter."""
    return [
        (name, parameter.name)
        for name, function in list_callables().items()
        for parameter in inspect.signature(function).parameters.values()
        if parameter.name != "self"
        and DATA_TYPES.search(describe_type(function, parameter.annotation))
    ]


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    return make_cases(tmp_path_factory.mktemp("labels"))


def test_every_input_has_cases(cases):
    inputs = list_inputs()
    assert len(inputs) > 100
    given = {(name, parameter) for name, (_, variants) in cases.items() for parameter in variants}
    assert given == {*inputs}


def call(name: str, arguments: dict[str, Any], parameter: str, value: Any) -> Any:
    """Return the result of a public function for a value of one of its parameters."""
    function = retrieve if name == "retrieve" else list_callables()[name]
    is_keywords = (name, parameter) == ("Table.interp", "at")
    arguments = {**arguments, **(value if is_keywords else {parameter: value})}
    result = function(**arguments)
    return [*result] if isinstance(result, Iterator) else result


def describe(medium: Any) -> list[Any]:
    """Return the content of a medium, without the checksums of files."""
    if isinstance(medium, splits.ParticleLayer):
        return [np.asarray(one) for one in medium.kernel_phase_function]
    attributes = medium.describe().items()
    content = [np.asarray(value) for key, value in sorted(attributes) if "sha256" not in key]
    index = medium.compute_refractive_indices(NM)
    content += [index[:, column] for _, column in sorted(medium.material_columns.items())]
    if hasattr(medium, "compute_added_absorption"):
        content += [np.asarray(one) for one in medium.compute_added_absorption(NM)]
    return content if medium.ground is None else [*content, medium.ground.albedo(NM)]


def assert_same(left: Any, right: Any) -> None:
    """Check that two results are equal to the bit, apart from the order of labels."""
    left, right = (getattr(one, "dataset", one) for one in (left, right))
    if isinstance(left, xr.Dataset):
        pair = []
        for dataset in (left, right):
            for dim in {*dataset.dims} & {*dataset.indexes}:
                dataset = dataset.sortby(dim)
            pair.append(drop_run_specific_attributes(dataset.transpose(*sorted(dataset.dims))))
        xr.testing.assert_equal(*pair)
        assert {*pair[0].data_vars} == {*pair[1].data_vars}
    elif isinstance(left, tuple | list):
        assert len(left) == len(right)
        for one, other in zip(left, right, strict=True):
            assert_same(one, other)
    elif hasattr(left, "compute_refractive_indices"):
        assert_same(*(describe(one) for one in (left, right)))
    elif hasattr(left, "direct"):
        assert_same(*([one.wavelength_nm, one.direct, one.diffuse] for one in (left, right)))
    elif isinstance(left, np.ndarray):
        np.testing.assert_array_equal(left, right)
    else:
        assert left == right


@pytest.mark.parametrize(("name", "parameter"), list_inputs())
def test_labels_are_obeyed_or_refused(cases, name, parameter):
    arguments, variants = cases[name]
    for one in variants[parameter]:
        base = call(name, arguments, parameter, one.value) if one.permuted else None
        for value in one.permuted:
            assert_same(call(name, arguments, parameter, value), base)
        for value in one.foreign:
            with pytest.raises((ValueError, TypeError), match=r"^\S.* = |unknown key") as error:
                call(name, arguments, parameter, value)
            assert "\n" not in str(error.value) and hasattr(error.value, "key")
        for value in one.descending:
            try:
                result = call(name, arguments, parameter, value)
            except ValueError as error:
                assert hasattr(error, "key"), error
            else:
                assert_same(result, call(name, arguments, parameter, one.value))
