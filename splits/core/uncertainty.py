"""Standard errors of spectra: dataset variables, batch statistics and error propagation.

A spectrophotometer traces paths at a few refractive indices.  Errors at wavelengths estimated from
the same paths are correlated; others are independent.  Each dataset therefore holds the deviation
of every wavelength in each of the `N_BATCHES` batches of rays (``…_batches``).
A quantity that is linear in the spectrum has the same linear combination of deviations, and their
squares add up to its variance.  The rest of the standard error is a bound on the interpolation
error between refractive indices.  That error is similar at neighbouring wavelengths and independent
at distant ones, so bounds add up linearly along each interval of weights of one sign, and intervals
in quadrature.  `ErrorTarget` is what the requested error of an angular distribution applies to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps, find_labels, match_labels
from splits.core.keywords import declare_function
from splits.core.validation import check_choice, invalid

Variable = tuple[str | tuple[str, ...], np.ndarray, dict[str, str]]
"""Dimensions, values and attributes, as `xarray.Dataset` takes them."""


def make_variable(
    name: str,
    dims: str | tuple[str, ...],
    values: np.ndarray,
    stderr: np.ndarray | None,
    long_name: str,
    units: str = "1",
    deviations: np.ndarray | None = None,
) -> dict[str, Variable]:
    """Return a variable, its standard error and its deviations by batch of rays, by name.

    Parameters
    ----------
    name, dims, values, long_name, units
    stderr : float, optional
        Standard error ``…_stderr``.
    deviations : float, shape (batches, ...), optional
        Deviations ``…_batches``, stored in single precision; a solution without noise has none.
    """
    attrs = {"long_name": long_name, "units": units}
    variables: dict[str, Variable] = {name: (dims, values, attrs)}
    if stderr is not None:
        error_attrs = {**attrs, "long_name": f"standard error of {long_name}"}
        attrs["ancillary_variables"] = f"{name}_stderr"
        variables[f"{name}_stderr"] = (dims, stderr, error_attrs)
    if deviations is not None and len(deviations):
        by_batch = ("batch", dims) if isinstance(dims, str) else ("batch", *dims)
        batch_attrs = {
            "long_name": f"deviation of {long_name} by batch of rays",
            "units": units,
            "comment": "sums of products over batches are covariances, without the allowance for "
            "interpolation between refractive indices in the standard error",
        }
        variables[f"{name}_batches"] = (by_batch, deviations.astype(np.float32), batch_attrs)
    return variables


def compute_batch_stderr(batch_means: np.ndarray) -> np.ndarray:
    """Return the standard error of the mean of batches of rays."""
    return batch_means.std(axis=0, ddof=1) / np.sqrt(len(batch_means))


def compute_leave_one_out_means(batch_means: np.ndarray) -> np.ndarray:
    """Return the means over all batches but one; batches are along the first axis."""
    return (batch_means.sum(axis=0) - batch_means) / (len(batch_means) - 1)


def compute_jackknife_stderr(leave_one_out: np.ndarray) -> np.ndarray:
    """Return the jackknife standard error of leave-one-out estimates (Efron 1982)."""
    n = len(leave_one_out)
    return np.sqrt((n - 1) / n * ((leave_one_out - leave_one_out.mean(axis=0)) ** 2).sum(axis=0))


_VARIANCE_ROUNDING = 1e-6
"""Relative rounding error of a variance from deviations in single precision."""


@xr.register_dataset_accessor("errors")
class Errors:
    """Combinations of the values of a result, with their standard errors: ``dataset.errors``.

    Errors at wavelengths that share rays are correlated, and so are those of media that share
    paths.  The methods use the deviations by batch of rays (``…_batches``).  A result without them,
    such as one by discrete ordinates, has no known correlation: bounds are returned for it.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of an instrument: a quantity with ``…_stderr`` over ``wavelength`` and any other
        dimensions, and possibly with ``…_batches``, also over ``batch``.

    Examples
    --------
    >>> import splits
    >>> ds = splits.spectrophotometer(splits.Snow.natural(optical_radius_um=100), [500, 600, 700])
    >>> value, stderr = ds.errors.mean("reflectance", 550, 700)
    >>> bool(stderr < 0.002)
    True
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = dataset

    @declare_function
    def weighted_sum(
        self, quantity: str, weights: xr.DataArray
    ) -> tuple[xr.DataArray, xr.DataArray]:
        """Return a weighted sum over wavelength, and its standard error.

        Parameters
        ----------
        quantity : str
            Name of the quantity, such as ``reflectance``.
        weights : xarray.DataArray
            Weights of any sign, over ``wavelength`` and any other dimensions.

        Returns
        -------
        sum, stderr : xarray.DataArray
            Over all other dimensions; NaN where a value of non-zero weight is missing.

        Raises
        ------
        ValueError
            For weights with gaps, or at other wavelengths than those of the result.
        """
        weights = self._match(weights)
        total = _sum_weighted(weights, self.dataset[quantity])
        return total, (sum(part**2 for part in self.split(quantity, weights))) ** 0.5

    @declare_function
    def split(self, quantity: str, weights: xr.DataArray) -> tuple[xr.DataArray, xr.DataArray]:
        """Return the statistical error of a weighted sum over wavelength, and a bound on the rest.

        Parameters
        ----------
        quantity, weights
            As for `weighted_sum`.

        Returns
        -------
        statistical, bound : xarray.DataArray
            Standard deviation between runs with different seeds, and bound on the rest of the
            error, such as that of interpolation between refractive indices.  Without batches, the
            first is 0, and the bound is the sum of errors times absolute weights, which holds for
            any correlation.
        """
        weights, stderr = self._match(weights), self.dataset[f"{quantity}_stderr"]
        if f"{quantity}_batches" not in self.dataset:
            upper_bound = _sum_weighted(abs(weights), stderr)
            return xr.zeros_like(upper_bound), upper_bound
        deviations = self.dataset[f"{quantity}_batches"].astype(float)
        bound = compute_remaining_error(stderr, deviations)
        statistical = (_sum_weighted(weights, deviations) ** 2).sum("batch", skipna=False) ** 0.5
        weighted_bound = (abs(weights) * bound).where(weights != 0.0, 0.0)
        interpolation = xr.apply_ufunc(
            _sum_same_sign_intervals,
            *xr.broadcast(weights, weighted_bound),
            input_core_dims=[["wavelength"]] * 2,
        )
        return statistical, interpolation

    def _match(self, weights: xr.DataArray) -> xr.DataArray:
        """Return weights in the order of the wavelengths of the result."""
        check_no_gaps("weights", weights)
        labels = find_labels(weights, weights.get_axis_num("wavelength"))
        order = match_labels("weights", labels, [self.dataset.wavelength])
        return weights.isel(wavelength=order)

    @declare_function
    def make_band_weights(self, low: float, high: float) -> xr.DataArray:
        """Return the weights over wavelength of the mean over a band.

        Parameters
        ----------
        low, high : float
            Limits of the band (nm).

        Raises
        ------
        ValueError
            If the result has no wavelength in the band.
        """
        wavelength = self.dataset.wavelength
        inside = (wavelength >= low) & (wavelength <= high)
        if not inside.any():
            limits = " to ".join(f"{limit:g}" for limit in wavelength.values[[0, -1]])
            raise invalid("wavelength", f"{limits} nm", f"some in {low:g} to {high:g} nm")
        return (inside / inside.sum()).drop_attrs()

    @declare_function
    def mean(self, quantity: str, low: float, high: float) -> tuple[xr.DataArray, xr.DataArray]:
        """Return the mean of a quantity over a band, and its standard error.

        Parameters
        ----------
        quantity : str
        low, high : float
            Limits of the band (nm).

        Returns
        -------
        mean, stderr : xarray.DataArray
            Over all dimensions but ``wavelength``; NaN if any value in the band is.
        """
        weights = self.make_band_weights(low, high)
        inside = self.dataset[quantity].isel(wavelength=weights.values > 0.0)
        mean = inside.mean("wavelength", skipna=False).drop_attrs()
        return mean, self.weighted_sum(quantity, weights)[1].transpose(*mean.dims).drop_attrs()

    @declare_function
    def difference(
        self, quantity: str, one: str, other: str, dim: str = "medium"
    ) -> tuple[xr.DataArray, xr.DataArray]:
        """Return the difference between two media, and its standard error.

        The statistical errors of media that share paths are strongly correlated and largely cancel
        in each batch.  The interpolation between refractive indices is also the same, so the bound
        of the difference is the difference of their bounds.  Without batches, the correlation is
        not known: both errors are added in quadrature, a bound for any positive correlation.

        Parameters
        ----------
        quantity : str
            Name of the quantity, such as ``reflectance`` or ``band_albedo``.
        one, other : str
            Labels of minuend and subtrahend along `dim`.
        dim : str

        Returns
        -------
        difference, stderr : xarray.DataArray
            Over all other dimensions.

        Raises
        ------
        ValueError
            For an unknown label, or a quantity without error.
        """
        dataset = self.dataset
        if f"{quantity}_stderr" not in dataset:
            raise invalid("quantity", quantity, "one with a standard error", "such as reflectance")
        check_choice("dim", dim, map(str, dataset[quantity].dims))
        labels = [str(label) for label in np.atleast_1d(dataset[dim].values)]
        selections = [
            dataset.sel({dim: check_choice(argument, label, labels)}, drop=True)
            for argument, label in (("one", one), ("other", other))
        ]
        difference = (selections[0][quantity] - selections[1][quantity]).drop_attrs()
        stderrs = [selection[f"{quantity}_stderr"] for selection in selections]
        variance = sum(stderr**2 for stderr in stderrs)
        if f"{quantity}_batches" in dataset:
            deviations = [one[f"{quantity}_batches"].astype(float) for one in selections]
            bounds = [
                np.maximum(stderr**2 - (deviation**2).sum("batch"), 0.0) ** 0.5
                for stderr, deviation in zip(stderrs, deviations, strict=True)
            ]
            correlated = ((deviations[0] - deviations[1]) ** 2).sum("batch")
            variance = correlated + (bounds[0] - bounds[1]) ** 2
        return difference, (variance**0.5).drop_attrs()


def compute_remaining_error(stderr: xr.DataArray, deviations: xr.DataArray) -> xr.DataArray:
    """Return the part of standard errors that the deviations by batch do not contain.

    Parameters
    ----------
    stderr : xarray.DataArray
    deviations : xarray.DataArray
        In double precision, also over ``batch``.
    """
    excess_variance = stderr**2 - (deviations**2).sum("batch", skipna=False)
    is_rounding = excess_variance <= _VARIANCE_ROUNDING * stderr**2
    return excess_variance.where(~is_rounding, 0.0) ** 0.5


def _sum_same_sign_intervals(weights: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return sums of parts over intervals of one sign of weights, added in quadrature."""
    last_nonzero = np.where(weights != 0.0, np.arange(weights.shape[-1]), 0)
    signs = np.sign(
        np.take_along_axis(weights, np.maximum.accumulate(last_nonzero, axis=-1), axis=-1)
    )
    interval = np.cumsum(np.diff(signs, axis=-1, prepend=signs[..., :1]) != 0.0, axis=-1)
    total = np.zeros(parts.shape[:-1])
    for number in range(int(interval.max()) + 1):
        total += np.where(interval == number, parts, 0.0).sum(axis=-1) ** 2
    return np.sqrt(total)


def _sum_weighted(weights: xr.DataArray, values: xr.DataArray) -> xr.DataArray:
    """Return a weighted sum over wavelength; NaN only if a value of non-zero weight is NaN."""
    return (weights * values).where(weights != 0.0, 0.0).sum("wavelength", skipna=False)


MIN_REFERENCE_FRACTION = 0.05
"""Fraction of an isotropic distribution below which the error is relative to that fraction."""


class ErrorTarget(NamedTuple):
    """What the requested error of a BRDF or BTDF applies to.

    Attributes
    ----------
    side : int
        0 reflected, 1 transmitted.
    direction_mask : bool, shape (directions,)
    absolute : bool
        Whether the error is that of the reflectance factor, instead of a relative one.
    """

    side: int
    direction_mask: np.ndarray
    absolute: bool = False

    def compute_reference(self, values: np.ndarray, scattered: np.ndarray) -> np.ndarray:
        """Return what errors of a BRDF or BTDF are divided by (1/sr), in the shape of the values.

        It is the value, or 1/20 of that of an isotropic distribution, whichever is larger; for
        absolute errors, the BRDF of a perfect diffuser.

        Parameters
        ----------
        values : float, shape (..., directions)
            1/sr.
        scattered : float, shape (...)
            Reflectance or transmittance of scattered light.
        """
        if self.absolute:
            return np.full_like(values, 1.0 / np.pi)
        isotropic = np.expand_dims(scattered, -1) / np.pi
        return np.maximum(values, MIN_REFERENCE_FRACTION * isotropic)
