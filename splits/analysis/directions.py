"""Principal planes of BRDFs, and merging of angular bins."""

from __future__ import annotations

import numpy as np
import xarray as xr

from splits.core.inputs import POLAR_ANGLE, ResultDataset
from splits.core.keywords import declare_function
from splits.core.validation import invalid, join_names


@declare_function
def select_principal_plane(dataset: ResultDataset) -> xr.Dataset:
    """Return the principal plane, which contains the beam and the normal of the surface.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.goniophotometer` with azimuths 0 and 180 degrees.

    Returns
    -------
    xarray.Dataset
        Variables over ``angle`` (degrees from the normal, positive in the forward direction)
        instead of ``polar_deg`` and ``azimuth_deg``.

    Raises
    ------
    ValueError
        For a dataset without directions, or if an azimuth of the plane is missing.
    """
    if not {"polar_deg", "azimuth_deg"} <= {*dataset.dims}:
        allowed = "over polar_deg and azimuth_deg"
        raise invalid("dataset", f"over {join_names(map(str, dataset.dims))}", allowed)
    sides = []
    for azimuth, sign in ((180.0, -1.0), (0.0, 1.0)):
        matches = np.flatnonzero(np.isclose(dataset.azimuth_deg.values, azimuth))
        if matches.size == 0:
            raise invalid(
                "azimuth_deg", dataset.azimuth_deg.values.tolist(), "with 0 and 180 degrees"
            )
        part = dataset.isel(azimuth_deg=matches[0], drop=True)
        part = part.assign_coords(polar_deg=sign * part.polar_deg.values).rename(polar_deg="angle")
        sides.append(part.isel(angle=slice(None, None, -1)) if sign < 0.0 else part)
    back, forward = sides
    # The zenith is in both halves; the forward one keeps it.
    back = back.isel(angle=back.angle.values < 0.0)
    plane = xr.concat([back, forward], "angle", data_vars="minimal", coords="minimal")
    attributes = POLAR_ANGLE.attributes
    attributes["long_name"] += ", positive forward"
    return plane.assign_coords(angle=("angle", plane.angle.values, attributes))


def merge_angular_bins(dataset: xr.Dataset, factor: int) -> xr.Dataset:
    """Return the BRDF of larger angular bins, merged from `factor` bins along both angles.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.goniophotometer` with bins of equal solid angle.
    factor : int
        Odd divisor of both numbers of bins, so that the first azimuth stays the centre of a bin.

    Returns
    -------
    xarray.Dataset
        ``brdf`` and ``brdf_stderr`` over the larger bins.

    Raises
    ------
    ValueError
        For an invalid factor.
    """
    polar, azimuth = dataset.sizes["polar_deg"], dataset.sizes["azimuth_deg"]
    if factor < 1 or factor % 2 == 0 or polar % factor or azimuth % factor:
        raise invalid("factor", factor, f"odd and a divisor of {polar} and {azimuth}")
    # Centres of bins are equally spaced in the cosine, which is proportional to the projected area.
    weight = np.cos(np.radians(dataset.polar_deg))
    rolled = dataset[["brdf", "brdf_stderr"]].roll(azimuth_deg=factor // 2, roll_coords=False)
    blocks = {"polar_deg": factor, "azimuth_deg": factor}

    def total(values: xr.DataArray) -> xr.DataArray:
        return values.coarsen(blocks).sum()

    area = total(weight.broadcast_like(rolled.brdf))
    brdf = total(weight * rolled.brdf) / area
    stderr = np.sqrt(total((weight * rolled.brdf_stderr) ** 2)) / area
    cosine = np.cos(np.radians(dataset.polar_deg.values)).reshape(-1, factor).mean(axis=1)
    return xr.Dataset({"brdf": brdf, "brdf_stderr": stderr}).assign_coords(
        polar_deg=np.degrees(np.arccos(cosine)), azimuth_deg=dataset.azimuth_deg.values[::factor]
    )
