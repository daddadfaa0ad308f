"""Distribution of the water in wet sand: whole pores, narrow pores or films on the grains.

SPLITS section 4.3.2 samples for every path segment whether it lies in water, with a probability
equal to the wet fraction of the pore volume.  In a real sand, capillary pressure drains wide pores
first (Haines 1930, J. Agric. Sci. 20, 97-116, doi:10.1017/S002185960008864X).  The first water
collects at grain contacts and wets a much larger fraction of the grain surface than of the pore
volume.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.media.grain_statistics import surface_to_volume_ratio

WATER_MODELS = ("whole_pores", "narrow_pores", "film")
"""Water by volume of pores, in the shortest path segments, or in films on the grains."""
MAX_RELATIVE_FILM_THICKNESS = 0.05
"""Relative thickness up to which a film is treated as a flat slab."""
MAX_SERIES_SATURATION = 1e-6
"""Saturation up to which a series gives the wet fraction."""
N_NEWTON_STEPS = 40
"""Number of Newton steps; about ten suffice close to full saturation."""


class WaterDistribution(NamedTuple):
    """Distribution of the water in the pore space.

    Attributes
    ----------
    wet_fraction : float
        Probability that a path segment through the pores begins and ends in water.
    filled_fraction : float
        Mean length of water along such a segment, per mean length of all segments.
    relative_film_thickness : float
        Thickness of the film on every grain, per major axis.
    """

    wet_fraction: float
    filled_fraction: float
    relative_film_thickness: float


def distribute_water(
    saturation: float, porosity: float, sphericity: float, water_model: str
) -> WaterDistribution:
    """Return the distribution of the water in a sand.

    Parameters
    ----------
    saturation : float
        Volume of water per volume of pores, 0 to 1.
    porosity : float
    sphericity : float
        Mean sphericity of the grains.
    water_model : {"whole_pores", "narrow_pores", "film"}
        Path segments wet at random by volume; all segments shorter than a threshold wet; or films
        on the grains up to `MAX_RELATIVE_FILM_THICKNESS`, with the rest in whole pores.
    """
    if water_model == "narrow_pores" and saturation > 0.0:
        wet_fraction = narrow_pore_fraction(saturation)
        return WaterDistribution(wet_fraction, saturation / wet_fraction, 0.0)
    if water_model == "film":
        # Thin film: its volume is surface area times thickness.
        per_thickness = float(surface_to_volume_ratio(sphericity)) * (1.0 - porosity) / porosity
        film_thickness = min(saturation / per_thickness, MAX_RELATIVE_FILM_THICKNESS)
        free_fraction = max(1.0 - film_thickness * per_thickness, 0.0)
        if free_fraction == 0.0:
            return WaterDistribution(0.0, 1.0, film_thickness)
        # The remaining water fills whole pores of the space left by the films.
        return WaterDistribution(
            max(1.0 - (1.0 - saturation) / free_fraction, 0.0), free_fraction, film_thickness
        )
    return WaterDistribution(saturation, 1.0, 0.0)


def narrow_pore_fraction(saturation: float) -> float:
    """Return the fraction of path segments that are wet if water fills the shortest ones.

    Segment lengths are exponential.  Segments shorter than x mean lengths make up a fraction
    f = 1 − e⁻ˣ of all segments and a fraction S = 1 − (1 + x) e⁻ˣ of their total length, which is
    the saturation.

    Parameters
    ----------
    saturation : float
        Saturation S, 0 to 1.

    Returns
    -------
    float
        Fraction f; about √(2 S) for small S, 1 at S = 1.

    Examples
    --------
    >>> [round(narrow_pore_fraction(s), 3) for s in (0.0, 0.1, 0.5, 1.0)]
    [0.0, 0.412, 0.813, 1.0]
    """
    if saturation >= 1.0:
        return 1.0
    # For small S, x = √(2S) + 2S/3; otherwise Newton's method, from above where S is concave.
    x = math.sqrt(2.0 * saturation) + 2.0 * saturation / 3.0
    if saturation > MAX_SERIES_SATURATION:
        x = max(x, -math.log1p(-saturation))
        for _ in range(N_NEWTON_STEPS):
            dry_fraction = math.exp(-x)
            x += (saturation - 1.0 + (1.0 + x) * dry_fraction) / (x * dry_fraction)
    return -math.expm1(-x)
