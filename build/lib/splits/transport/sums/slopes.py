"""How sums of weights change with what absorbs: derivatives of the very sums of `tally`.

A ray's weight is exp(−Σ α·length), so its derivative is minus itself times Σ α′·length, for every
change α′ of absorption coefficients at once and from the same path lengths.
"""

from __future__ import annotations

import numpy as np

from splits.transport.compiling.jit import ONE, ZERO, borrower, entry, owner
from splits.transport.numerics.elementary import exponential
from splits.transport.sums.notes import NOTE_LENGTH, NOTE_RAY, NOTE_WEIGHT
from splits.transport.sums.tally import BLOCK, EXIT_LENGTH, EXIT_SIDE, EXIT_WEIGHT, weigh


@entry
def slopes(exits, notes, absorption, changes, ground):
    """Add up derivatives of the weights of rays, in the order of their rows.

    Parameters
    ----------
    exits : float64[rays, columns]
    notes : float64[notes, columns]
        Of these rays, ray by ray, `NOTE_RAY` counting from the first of them.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m); of a ground −ln of its albedo.
    changes : float64[parameters, wavelengths, materials]
        Their derivatives.
    ground : int
        Column of the ground, see `scene.Scene`.

    Returns
    -------
    float32[blocks, 2, parameters, wavelengths]
        Derivatives of Σ weight, reflected and transmitted, of every `BLOCK` successive rays; what
        the ground keeps counts as transmitted.
    """
    wavelengths, materials = absorption.shape
    parameters = changes.shape[0]
    alpha = np.empty((materials, wavelengths), dtype=np.float32)
    more = np.empty((parameters, materials, wavelengths), dtype=np.float32)
    for material in range(materials):
        for i in range(wavelengths):
            alpha[material, i] = absorption[i, material]
            for p in range(parameters):
                more[p, material, i] = changes[p, i, material]
    rays = exits.shape[0]
    blocks = np.zeros((-(-rays // BLOCK), 2, parameters, wavelengths), dtype=np.float32)
    weight = np.empty(wavelengths, dtype=np.float32)
    first = 0
    for j in range(rays):
        sums = blocks[j // BLOCK]
        side = int(exits[j, EXIT_SIDE])
        if side >= 0:
            lengths = exits[j, EXIT_LENGTH:]
            weigh(lengths, exits[j, EXIT_WEIGHT], alpha, weight)
            for p in range(parameters):
                _fall(lengths, weight, more[p], sums[side, p])
        first = _kept(notes, first, j, alpha, more, ground, sums[1])
    return blocks


@borrower
def _fall(lengths, weight, more, total):
    """Take from `total` what a weight loses, float32[wavelengths]."""
    for material in range(more.shape[0]):
        leg = np.float32(lengths[material])
        if leg > ZERO:
            for i in range(weight.size):
                total[i] -= weight[i] * (more[material, i] * leg)


@owner
def _kept(notes, first, ray, alpha, more, ground, totals):
    """Add what the ground keeps of a ray, and return its first note's successor."""
    weight = np.empty(alpha.shape[1], dtype=np.float32)
    sent = np.empty_like(weight)
    while first < notes.shape[0] and notes[first, NOTE_RAY] == ray:
        lengths = notes[first, NOTE_LENGTH:]
        weigh(lengths, notes[first, NOTE_WEIGHT], alpha, weight)
        # It keeps weight·(1 − a), a = exp(−α), and a falls by a·α′.
        for i in range(weight.size):
            sent[i] = weight[i] * exponential(-alpha[ground, i])
            weight[i] -= sent[i]
        for p in range(totals.shape[0]):
            _fall(lengths, weight, more[p], totals[p])
            for i in range(weight.size):
                totals[p, i] += sent[i] * more[p, ground, i] * ONE
        first += 1
    return first
