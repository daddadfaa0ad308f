"""Tally of the delays of rays."""

from __future__ import annotations

import numpy as np

from splits.core.validation import invalid
from splits.instruments.angular_estimate import N_ANGULAR_BATCHES
from splits.kernels.tallies.distributions import (
    N_MOMENTS,
    DelayRecord,
    DelaySums,
    tally_delays,
)
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.strata import Stratum
from splits.simulation.tally import RAYS_PER_CHUNK, ExitTally

MAX_TALLY_VALUES = 100_000_000
"""Largest number of sums of a tally."""


def check_tally_size(n_wavelengths: int, n_bins: int, n_intervals: int = 1) -> None:
    """Check that the sums of a tally fit into memory, if two nodes serve each wavelength."""
    n_values = 2 * N_ANGULAR_BATCHES * 2 * n_wavelengths * (n_bins + n_intervals * N_MOMENTS)
    if n_values > MAX_TALLY_VALUES:
        raise invalid(
            "wavelength_nm", f"{n_wavelengths} wavelengths",
            f"at most {n_wavelengths * MAX_TALLY_VALUES // n_values} with {n_bins} bins of "
            f"delay and {n_intervals} intervals of depth",
            "use fewer bins, or several calls",
        )  # fmt: skip


class DelayTally(ExitTally):
    """Tally of exits by their delay.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    slowness : float, shape (rows, columns)
        Inverse of the group velocity along recorded paths (s/m).
    record : DelayRecord
    max_order : int
        Order of scattering that no light reaches within the record.

    Raises
    ------
    ValueError
        If the sums do not fit into memory.

    Attributes
    ----------
    histogram_sums : float, shape (batches, 2, node rows, bins)
    moment_sums : float, shape (batches, 2, node rows, intervals, 4)
    length_sums : float, shape (batches, 2, node rows, columns)
        See `splits.kernels.tallies.distributions.DelaySums`.
    """

    first_stream = 10_000_000
    rays_per_round = N_ANGULAR_BATCHES * RAYS_PER_CHUNK

    def __init__(
        self, nodes: IndexNodes, absorption: np.ndarray, slowness: np.ndarray,
        record: DelayRecord, max_order: int,
    ) -> None:  # fmt: skip
        super().__init__(nodes, absorption)
        self.slowness, self.record = slowness, record
        n_bins, n_intervals = record.edges.size - 1, int(record.interval[-1]) + 1
        shape = N_ANGULAR_BATCHES, 2, len(self.rows)
        check_tally_size(len(absorption), n_bins, n_intervals)
        self.histogram_sums = np.zeros((*shape, n_bins))
        self.moment_sums = np.zeros((*shape, n_intervals, N_MOMENTS))
        self.length_sums = np.zeros((*shape, absorption.shape[1]))
        self.values_per_row = 2 * (n_bins + n_intervals * N_MOMENTS + absorption.shape[1])
        self.add_strata((max_order,))

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> DelaySums:
        """Return the sums of a chunk of exits."""
        slowness = self.slowness[self.rows[stratum.node_rows]]
        return tally_delays(exits, crossings, stratum.absorption, slowness, self.record)

    def merge(self, stratum: Stratum, score: DelaySums) -> None:
        """Add the sums of the next chunk of a stratum."""
        batch, rows = self.get_batch(stratum, N_ANGULAR_BATCHES), stratum.node_rows
        self.histogram_sums[batch, :, rows] += score.histogram
        self.moment_sums[batch, :, rows] += score.moments
        self.length_sums[batch, :, rows] += score.lengths

    def compute_batch_histograms(self) -> np.ndarray:
        """Return the fraction of the incident light, shape (batches, 2, wavelengths, bins)."""
        return self._combine_batches(self.histogram_sums)

    def compute_batch_moments(self) -> np.ndarray:
        """Return moments (sᵏ), shape (batches, 2, wavelengths, intervals, 4)."""
        return self._combine_batches(self.moment_sums)

    def compute_batch_lengths(self) -> np.ndarray:
        """Return the recorded path lengths (m) of received light times its fraction.

        Returns
        -------
        float, shape (batches, 2, wavelengths, columns)
        """
        return self._combine_batches(self.length_sums)

    def _combine_batches(self, batch_sums: np.ndarray) -> np.ndarray:
        """Return means by batch, from sums whose third axis is the node row."""
        per_batch = np.moveaxis(batch_sums, 2, -1) / (self.count_rays() / N_ANGULAR_BATCHES)
        return np.moveaxis(self.combine_nodes(per_batch), -1, 2)
