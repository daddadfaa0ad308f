"""Cuts through BRDFs."""

from __future__ import annotations

import numpy as np
import xarray as xr

from splits.core.validation import invalid


def select_principal_plane(dataset: xr.Dataset) -> xr.Dataset:
    """Return the plane that holds the beam and the normal of the surface.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.goniophotometer` returns it, with azimuths 0 and 180 degrees.

    Returns
    -------
    xarray.Dataset
        Its variables over ``angle`` (degrees from the normal, positive in the direction in which
        the beam travels) instead of ``polar`` and ``azimuth``.

    Raises
    ------
    ValueError
        If an azimuth of the plane is missing.
    """
    sides = []
    for azimuth, sign in ((180.0, -1.0), (0.0, 1.0)):
        hit = np.flatnonzero(np.isclose(dataset.azimuth.values, azimuth))
        if hit.size == 0:
            raise invalid("azimuth_deg", dataset.azimuth.values.tolist(), "with 0 and 180 degrees")
        part = dataset.isel(azimuth=hit[0], drop=True)
        part = part.assign_coords(polar=sign * part.polar.values).rename(polar="angle")
        sides.append(part.isel(angle=slice(None, None, -1)) if sign < 0.0 else part)
    back, forward = sides
    # The zenith belongs to both halves; the forward one keeps it.
    back = back.isel(angle=back.angle.values < 0.0)
    plane = xr.concat([back, forward], "angle", data_vars="minimal", coords="minimal")
    about = {"units": "degree", "long_name": "angle from the normal, forward counts as positive"}
    return plane.assign_coords(angle=("angle", plane.angle.values, about))


def merge_angular_bins(dataset: xr.Dataset, factor: int) -> xr.Dataset:
    """Return what larger collectors would have seen, `factor` cells along both angles in one.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.goniophotometer` with cells of equal solid angle.
    factor : int
        Odd, a divisor of both numbers of cells: the first azimuth stays the middle of a cell.

    Returns
    -------
    xarray.Dataset
        ``brdf`` and ``brdf_stderr`` over the larger cells.

    Raises
    ------
    ValueError
        For a factor that does not fit.
    """
    polar, azimuth = dataset.sizes["polar"], dataset.sizes["azimuth"]
    if factor < 1 or factor % 2 == 0 or polar % factor or azimuth % factor:
        raise invalid("factor", factor, f"odd and a divisor of {polar} and {azimuth}")
    # The middles of cells are equally spaced in the cosine, so that it is their projected area.
    weight = np.cos(np.radians(dataset.polar))
    turned = dataset[["brdf", "brdf_stderr"]].roll(azimuth=factor // 2, roll_coords=False)
    blocks = {"polar": factor, "azimuth": factor}

    def total(values: xr.DataArray) -> xr.DataArray:
        return values.coarsen(blocks).sum()

    area = total(weight.broadcast_like(turned.brdf))
    brdf = total(weight * turned.brdf) / area
    stderr = np.sqrt(total((weight * turned.brdf_stderr) ** 2)) / area
    cosine = np.cos(np.radians(dataset.polar.values)).reshape(-1, factor).mean(axis=1)
    return xr.Dataset({"brdf": brdf, "brdf_stderr": stderr}).assign_coords(
        polar=np.degrees(np.arccos(cosine)), azimuth=dataset.azimuth.values[::factor]
    )
