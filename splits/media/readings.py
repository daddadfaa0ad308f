"""Where the papers can be read two ways: every reading has a name, and one is the default.

docs/model.md says why each default was taken and what the alternatives do to reflectance.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

from splits.checks import one_of
from splits.transport.scene import ENTRY, FACETS, FATE, WRONG_SIDE, Rules

CHOICES: dict[str, tuple[str, ...]] = {
    "size_is": ("diameter", "semi_axis"),
    "struck_size": ("attenuation", "uniform"),
    "entry": tuple(ENTRY),
    "facets": tuple(FACETS),
    "wrong_side": tuple(WRONG_SIDE),
    "boundary_fresnel": ("yes", "no"),
    "grain_on_last_leg": tuple(FATE),
    "grain_across_boundary": tuple(FATE),
}


@dataclass(frozen=True)
class Readings:
    """Named readings of SPLITS and SPLITSnow.

    Parameters
    ----------
    size_is : {"diameter", "semi_axis"}
        What a grain size of SPLITSnow Table 1 means: the major axis 2b, or b.
    struck_size : {"attenuation", "uniform"}
        Size distribution of the grains that rays strike: ∝ s⁻² P(s), consistent with the
        attenuation K1 (SPLITS Eqs 20-25), or uniform like the sizes themselves.
    entry : {"uniform", "projected"}
        Entry point uniform over the surface facing the ray (SPLITS 4.3.3, SPLITSnow 3.2), or by
        projected area, as straight rays through real grains have it.
    facets : {"projected", "unweighted", "any"}
        Facet struck: facing the ray and weighted by projected area (SPLITS 4.3.4), facing it
        with equal weight, or any facet.
    wrong_side : {"lobe", "mirrored"}
        A ray that a facet sends to the wrong side of the grain's surface leaves in a cosine
        lobe (SPLITS 4.3.4) or mirrored in the surface.
    boundary_fresnel : {"yes", "no"}
        Fresnel reflection and refraction at the extended boundaries where water fills the pores
        (SPLITS 4.3.1).
    grain_on_last_leg : {"reject", "keep"}
        A new grain that lies across the leg just travelled (SPLITS 4.3.3).
    grain_across_boundary : {"reject", "keep"}
        A new grain that sticks out of the sample (SPLITS 4.3.3, SPLITSnow 3.2).  If kept, a ray
        that leaves a grain outside the sample counts as standing on the boundary there.
    """

    size_is: str = "diameter"
    struck_size: str = "attenuation"
    entry: str = "uniform"
    facets: str = "projected"
    wrong_side: str = "lobe"
    boundary_fresnel: str = "yes"
    grain_on_last_leg: str = "reject"
    grain_across_boundary: str = "reject"

    def __post_init__(self) -> None:
        for field in fields(self):
            one_of(f"readings.{field.name}", getattr(self, field.name), CHOICES[field.name])

    def rules(self, analog: bool = False) -> Rules:
        """Return the readings as kernels take them."""
        return Rules(
            entry=ENTRY[self.entry],
            facets=FACETS[self.facets],
            wrong_side=WRONG_SIDE[self.wrong_side],
            boundary_fresnel=self.boundary_fresnel == "yes",
            reject_on_last_leg=FATE[self.grain_on_last_leg],
            reject_across_boundary=FATE[self.grain_across_boundary],
            analog=analog,
        )

    def as_dict(self) -> dict[str, str]:
        """Return all readings by name."""
        return asdict(self)
