"""Where the water of a wet sand is: in whole pores, in the narrowest ones, or on the grains.

SPLITS section 4.3.2 draws for every leg whether it runs in water, with the probability that a
volume of pores is wet.  In a real sand capillary pressure drains wide pores first (Haines 1930, J.
Agric. Sci. 20, 97-116, doi:10.1017/S002185960008864X): the first water lies where grains touch, and
wets far more of their surface than of the pores' volume.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.media.grain_statistics import surface_to_volume_ratio

WATER_MODELS = ("whole_pores", "narrow_pores", "film")
"""Readings: of legs drawn by volume, of the shortest legs, on the grains."""
MAX_RELATIVE_FILM_THICKNESS = 0.05
"""Relative thickness up to which a film counts as a flat slab."""
MAX_SERIES_SATURATION = 1e-6
"""Saturation up to which a series says which legs are wet."""
N_NEWTON_STEPS = 40
"""Steps, of which some ten do where least water is missing."""


class WaterDistribution(NamedTuple):
    """Where water is.

    Attributes
    ----------
    wet_fraction : float
        Probability that a leg through pores begins and ends in water.
    filled_fraction : float
        Water along such a leg, as a part of the mean length of all legs.
    relative_film_thickness : float
        Thickness of a film on every grain per major axis.
    """

    wet_fraction: float
    filled_fraction: float
    relative_film_thickness: float


def distribute_water(
    saturation: float, porosity: float, sphericity: float, water_model: str
) -> WaterDistribution:
    """Return where the water of a sand is.

    Parameters
    ----------
    saturation : float
        Volume of water per volume of pores, 0 to 1.
    porosity : float
    sphericity : float
        Mean sphericity of the grains.
    water_model : {"whole_pores", "narrow_pores", "film"}
        Of legs drawn by volume; of all legs shorter than some length; on the grains up to
        `MAX_RELATIVE_FILM_THICKNESS`, and the rest in whole pores.
    """
    if water_model == "narrow_pores" and saturation > 0.0:
        share = narrow_pore_fraction(saturation)
        return WaterDistribution(share, saturation / share, 0.0)
    if water_model == "film":
        # Thin: its volume is surface times thickness.
        per_thickness = float(surface_to_volume_ratio(sphericity)) * (1.0 - porosity) / porosity
        film = min(saturation / per_thickness, MAX_RELATIVE_FILM_THICKNESS)
        room = max(1.0 - film * per_thickness, 0.0)
        if room == 0.0:
            return WaterDistribution(0.0, 1.0, film)
        # What films leave of the pores fills with the rest.
        return WaterDistribution(max(1.0 - (1.0 - saturation) / room, 0.0), room, film)
    return WaterDistribution(saturation, 1.0, 0.0)


def narrow_pore_fraction(saturation: float) -> float:
    """Return the share of legs that are wet where water fills the shortest ones.

    Legs are exponential.  Of those shorter than x mean legs, the share of all is f = 1 − e⁻ˣ, and
    that of the length, which is the saturation, S = 1 − (1 + x) e⁻ˣ.

    Parameters
    ----------
    saturation : float
        0 to 1.

    Returns
    -------
    float
        √(2 S) where S is small, 1 at 1.

    Examples
    --------
    >>> [round(narrowest(s), 3) for s in (0.0, 0.1, 0.5, 1.0)]
    [0.0, 0.412, 0.813, 1.0]
    """
    if saturation >= 1.0:
        return 1.0
    # Where S is small, x = √(2S) + 2S/3; elsewhere Newton's method, from above where S bends down.
    x = math.sqrt(2.0 * saturation) + 2.0 * saturation / 3.0
    if saturation > MAX_SERIES_SATURATION:
        x = max(x, -math.log1p(-saturation))
        for _ in range(N_NEWTON_STEPS):
            dry = math.exp(-x)
            x += (saturation - 1.0 + (1.0 + x) * dry) / (x * dry)
    return -math.expm1(-x)
