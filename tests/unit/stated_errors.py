"""Variables with standard errors, and their ancillary_variables (CF conventions, 3.4)."""

from __future__ import annotations

import xarray as xr


def list_variables_with_errors(dataset: xr.Dataset) -> set[str]:
    """Return the variables with a standard error, which exactly these must refer to."""
    names = {
        str(name).removesuffix("_stderr")
        for name in dataset.data_vars
        if str(name).endswith("_stderr")
    }
    named = {
        str(name): variable.attrs["ancillary_variables"]
        for name, variable in dataset.data_vars.items()
        if "ancillary_variables" in variable.attrs
    }
    assert named == {name: f"{name}_stderr" for name in names}
    for name in names:
        assert dataset[name].dims == dataset[f"{name}_stderr"].dims
        assert dataset[name].attrs["units"] == dataset[f"{name}_stderr"].attrs["units"]
    return names
