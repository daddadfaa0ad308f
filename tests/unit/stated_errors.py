"""Variables with standard errors, and their ancillary_variables (CF conventions, 3.4)."""

import xarray as xr


def list_variables_with_errors(dataset: xr.Dataset) -> set[str]:
    """Return the variables with a standard error, which exactly these must refer to.

    Variables may also refer to a flag, where they are NaN.
    """
    names = {
        str(name).removesuffix("_stderr")
        for name in dataset.data_vars
        if str(name).endswith("_stderr")
    }
    flags = {name for name in dataset.data_vars if "flag_meanings" in dataset[name].attrs}
    named = {
        str(name): set(variable.attrs.get("ancillary_variables", "").split()) - flags
        for name, variable in dataset.data_vars.items()
    }
    assert named == {str(n): {f"{n}_stderr"} & set(dataset) for n in dataset.data_vars}
    for name in names:
        assert dataset[name].dims == dataset[f"{name}_stderr"].dims
        assert dataset[name].attrs["units"] == dataset[f"{name}_stderr"].attrs["units"]
    return names
