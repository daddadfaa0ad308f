"""Single scattering by grains of one material, as a function of refractive index and absorption.

What a grain does to light depends on its size only through the absorption of its material times
its mean chord 1/K,

    x = α/K,    q = x/(1 + x),

so one table serves all sizes and wavelengths.  It holds the moments M_l of the light that leaves a
grain,

    M_l = ⟨w P_l(cosΘ)⟩,    w = exp(−α L),    M_l(x) = M_l(0) − q E_l(q),

where M_0 is the single-scattering albedo and E_l is smooth for weak and for strong absorption.  In
wet snow, light enters the grain from a dry or a wet pore and leaves into one of the two, and M_l
depends on both and on the saturation.  Interpolation is polynomial, between the nodes of Chebyshev.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

MAX_ABSORPTION = 200.0
"""Largest x; about that of ice at 2000 nm for a specific surface area of 0.25 m²/kg."""


class Axis(NamedTuple):
    """Axis of a table: nodes of Chebyshev, at both ends and between.

    Attributes
    ----------
    nodes : float, shape (nodes,)
        Increasing.
    """

    nodes: np.ndarray

    @classmethod
    def from_limits(cls, low: float, high: float, number: int) -> Axis:
        """Return an axis of a number of nodes."""
        position = 0.5 - 0.5 * np.cos(np.pi * np.arange(number) / (number - 1))
        return cls(low + (high - low) * position)

    def contains(self, values: np.ndarray) -> np.ndarray:
        """Return whether values are on the axis."""
        inside: np.ndarray = (values >= self.nodes[0]) & (values <= self.nodes[-1])
        return inside

    def compute_weights(self, values: np.ndarray) -> np.ndarray:
        """Return the weights of the nodes in polynomial interpolation, shape (values, nodes).

        Barycentric formula (Berrut & Trefethen 2004, SIAM Review 46, 501).
        """
        if self.nodes.size == 1:
            return np.ones((values.size, 1))
        signs = (-1.0) ** np.arange(self.nodes.size)
        signs[[0, -1]] *= 0.5
        difference = values[:, np.newaxis] - self.nodes
        exact = difference == 0.0
        weights = signs / np.where(exact, 1.0, difference)
        hits = exact.any(axis=1)
        weights[hits] = exact[hits]
        normalized: np.ndarray = weights / weights.sum(axis=1, keepdims=True)
        return normalized


class GrainTable(NamedTuple):
    """Moments of the light that grains scatter, over contrast, saturation and absorption.

    Attributes
    ----------
    contrast : Axis
        n − 1, with the refractive index n of the grains relative to air.
    saturation : Axis
        Fraction of wet pores; one node, 0, for dry grains.
    absorption : Axis
        q.
    moments : float, shape (contrasts, saturations, 2, 2, orders)
        M_l(0) for light from a dry or wet pore: into any pore, and into a wet pore per saturation;
        of dry grains (contrasts, 1, 1, 1, orders), into any pore.
    slopes : float, shape (contrasts, saturations, 2, 2, absorptions, orders)
        E_l, likewise.
    stderr : float, shape (contrasts, absorptions)
        Standard error of a reflectance due to that of the moments, see `grain_tabulation`.
    water : float, shape (contrasts,)
        Refractive index of water in wet pores.
    """

    contrast: Axis
    saturation: Axis
    absorption: Axis
    moments: np.ndarray
    slopes: np.ndarray
    stderr: np.ndarray
    water: np.ndarray

    @property
    def n_orders(self) -> int:
        """Number of known moments."""
        return self.moments.shape[-1]

    @property
    def n_states(self) -> int:
        """Number of kinds of pores: 2 with wet ones."""
        return self.moments.shape[2]

    def select(self, wavelengths: object) -> GrainTable:
        """Return the table, which holds for all wavelengths."""
        return self

    def compute_moments(
        self, contrast: np.ndarray, absorption: np.ndarray, saturation: float, orders: int
    ) -> np.ndarray:
        """Return the moments M_l, shape (..., values, pores, pores, orders).

        Parameters
        ----------
        contrast : float, shape (values,)
            n − 1, within the table.
        absorption : float, shape (..., values)
            x, within the table.
        saturation : float
            Fraction of wet pores; not used for dry grains.
        orders : int
            Number of moments, which are 0 beyond those of the table.
        """
        by_contrast = self.contrast.compute_weights(contrast)
        by_saturation = self.saturation.compute_weights(np.array([saturation]))[0]
        q = absorption / (1.0 + absorption)
        by_absorption = self.absorption.compute_weights(q.ravel()).reshape(*q.shape, -1)
        n_known, n_pores = min(orders, self.moments.shape[-1]), self.moments.shape[2]
        without, slopes = (
            np.tensordot(by_saturation, values[..., :n_known], (0, 1))
            for values in (self.moments, self.slopes)
        )
        slopes = np.moveaxis(slopes, 3, 1).reshape(len(slopes), by_absorption.shape[-1], -1)
        # The contrast is common to the leading dimensions: first a table for each contrast.
        by_value = np.tensordot(by_contrast, slopes, 1)
        by_value = (by_absorption[..., np.newaxis, :] @ by_value)[..., 0, :]
        known = by_contrast @ without.reshape(len(without), -1) - q[..., np.newaxis] * by_value
        moments = np.zeros((*q.shape, n_pores, n_pores, orders), dtype=known.dtype)
        moments[..., :n_known] = known.reshape(*q.shape, n_pores, n_pores, n_known)
        return moments

    def interpolate_stderr(self, contrast: np.ndarray, absorption: np.ndarray) -> np.ndarray:
        """Return the standard errors of a reflectance, shape (..., values), at the next nodes.

        A half-space of grains without absorption reflects all light, whatever their moments.  The
        error at this node is therefore that of no other layer, and not used.
        """
        q = absorption / (1.0 + absorption)
        row, column = (
            np.searchsorted(axis.nodes, values).clip(first, axis.nodes.size - 1)
            for first, axis, values in ((0, self.contrast, contrast), (1, self.absorption, q))
        )
        stderr: np.ndarray = self.stderr[row, column]
        return stderr

    def to_dataset(self) -> xr.Dataset:
        """Return the table as a dataset."""
        variables = {
            "moment": (("contrast", "saturation", "pore", "exit_pore", "order"), self.moments),
            "slope": (
                ("contrast", "saturation", "pore", "exit_pore", "absorption", "order"),
                self.slopes,
            ),
            "reflectance_stderr": (("contrast", "absorption"), self.stderr),
            "water_index": ("contrast", self.water),
        }
        names = ("contrast", "saturation", "absorption")
        axes = {name: getattr(self, name).nodes for name in names}
        return xr.Dataset(variables, axes)

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset) -> GrainTable:
        """Return the table in a dataset."""
        contrast, saturation, absorption = (
            Axis(dataset[name].values) for name in ("contrast", "saturation", "absorption")
        )
        names = ("moment", "slope", "reflectance_stderr", "water_index")
        arrays = (dataset[name].values.astype(float) for name in names)
        return cls(contrast, saturation, absorption, *arrays)
