"""Where the papers can be read two ways: every reading has a name, and one is the default.

docs/theory/interpretation.md says why each default was taken and what the alternatives do to reflectance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeVar

from splits.core.validation import (
    check_choice,
    invalid,
    join_names,
    reject_unknown_keywords,
    suggest_name,
)
from splits.kernels.grains.scene import (
    ENTRY_SAMPLING,
    FACET_SAMPLING,
    GRAIN_EXTENT,
    OVERLAP_RULE,
    WRONG_SIDE_RULE,
    SamplingRules,
)
from splits.materials import MIXING_RULES
from splits.media.formatting import find_differences, format_value
from splits.media.sand_composition import EXCESS_MAGNETITE_RULES
from splits.media.wetness import WATER_MODELS

INTERPRETATION_CHOICES: dict[str, tuple[str, ...]] = {
    "entry_point": tuple(ENTRY_SAMPLING),
    "facet_sampling": tuple(FACET_SAMPLING),
    "wrong_side_ray": tuple(WRONG_SIDE_RULE),
    "boundary_fresnel": ("yes", "no"),
    "overlap_with_previous_segment": tuple(OVERLAP_RULE),
    "overlap_with_boundary": tuple(OVERLAP_RULE),
    "mean_free_path": ("pore_only", "including_grain"),
    "grain_extent": tuple(GRAIN_EXTENT),
    "size_definition": ("diameter", "semi_axis"),
    "size_sampling": ("cross_section", "uniform"),
    "mixing": tuple(MIXING_RULES),
    "size_distribution": ("separates", "single"),
    "excess_magnetite": EXCESS_MAGNETITE_RULES,
    "attenuation_factor": ("solid_fraction", "as_printed"),
    "water": WATER_MODELS,
}

INTERPRETATION_SETS: dict[str, dict[str, str]] = {
    "splits_2007": {
        "entry_point": "uniform", "facet_sampling": "projected", "wrong_side_ray": "cosine_lobe",
        "overlap_with_previous_segment": "reject", "overlap_with_boundary": "reject", "mean_free_path": "pore_only",
        "grain_extent": "finite",
    },
    "splitsnow_2021": {
        "entry_point": "uniform", "facet_sampling": "any", "wrong_side_ray": "mirror",
        "overlap_with_previous_segment": "reject", "overlap_with_boundary": "reject", "mean_free_path": "pore_only",
        "grain_extent": "finite",
    },
    "geometric": {
        "entry_point": "projected", "facet_sampling": "projected", "wrong_side_ray": "mirror",
        "overlap_with_previous_segment": "skip", "overlap_with_boundary": "skip",
        "mean_free_path": "including_grain", "grain_extent": "finite",
    },
    "radiative_transfer": {
        "entry_point": "projected", "facet_sampling": "projected", "wrong_side_ray": "mirror",
        "overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep",
        "mean_free_path": "including_grain", "grain_extent": "point",
    },
}  # fmt: skip
"""Sets of readings by name; what a set does not say stays as by default."""
SET_KEY = "set"
"""Key of a mapping of readings that names the set which the others stand beside."""


def merge_interpretations(given: Sequence[Any]) -> Any:
    """Return readings given one after the other as one: a set's name replaces all before it."""
    found: Any = {}
    for one in given:
        mapping = {SET_KEY: one} if isinstance(one, str) else one
        if not isinstance(mapping, Mapping):
            return one
        found = dict(mapping) if SET_KEY in mapping else {**found, **mapping}
    return found[SET_KEY] if list(found) == [SET_KEY] else found


Kind = TypeVar("Kind", bound="TransportInterpretation")


@dataclass(frozen=True)
class TransportInterpretation:
    """Named readings of the transport that SPLITS and SPLITSnow share.

    Parameters
    ----------
    entry_point : {"uniform", "projected"}
        Entry point uniform over the surface facing the ray (SPLITS 4.3.3, SPLITSnow 3.2), or by
        projected area, as straight rays through real grains have it.
    facet_sampling : {"projected", "unweighted", "any"}
        Facet struck: facing the ray and weighted by projected area (SPLITS 4.3.4), facing it
        with equal weight, or any facet.
    wrong_side_ray : {"cosine_lobe", "mirror"}
        A ray that a facet sends to the wrong side of the grain's surface leaves in a cosine
        lobe (SPLITS 4.3.4) or mirrored in the surface.
    boundary_fresnel : {"yes", "no"}
        Fresnel reflection and refraction at the extended boundaries where water fills the pores
        (SPLITS 4.3.1).
    overlap_with_previous_segment : {"reject", "keep", "skip"}
        A new grain that lies across the last leg through pores: drawn again from the same origin,
        distance included (SPLITS 4.3.3), kept, or left out, so that the next distance counts
        from its place.
    overlap_with_boundary : {"reject", "keep", "skip"}
        A new grain that sticks out of the sample (SPLITS 4.3.3, SPLITSnow 3.2), likewise.  If
        kept, a ray that leaves a grain outside the sample counts as standing on the boundary
        there.  If skipped, grains are as rare near the boundaries as whole grains are.
    mean_free_path : {"pore_only", "including_grain"}
        The mean distance between grains is that of a leg through pores, as the papers have it, or
        that from one entry to the next, the way through the grain included.  With the latter rays
        are in grains, and in water, for as much of their way as these fill of the volume, and
        meet as many grains per metre as their surface asks for.
    grain_extent : {"finite", "point"}
        The path through a grain displaces the ray, as the papers have it, or a grain is a point
        scatterer, as radiative transfer has it.  The free path between points has the mean
        1/(𝓔 K), of which the pore space is 1 − 𝓔 under ``mean_free_path: including_grain``, and all
        of it under ``pore_only``.  A point overlaps neither a boundary nor the last leg, so the two
        rules for such grains must be "keep".
    """

    entry_point: str = "uniform"
    facet_sampling: str = "projected"
    wrong_side_ray: str = "cosine_lobe"
    boundary_fresnel: str = "yes"
    overlap_with_previous_segment: str = "reject"
    overlap_with_boundary: str = "reject"
    mean_free_path: str = "pore_only"
    grain_extent: str = "finite"

    def __post_init__(self) -> None:
        for field in fields(self):
            check_choice(
                f"interpretation.{field.name}",
                getattr(self, field.name),
                INTERPRETATION_CHOICES[field.name],
            )
        for name in ("overlap_with_previous_segment", "overlap_with_boundary"):
            rule = getattr(self, name)
            if self.grain_extent == "point" and rule != "keep":
                hint = "or grain_extent finite, as in the set geometric"
                raise invalid(f"interpretation.{name}", rule, "keep with grain_extent point", hint)

    @classmethod
    def from_input(cls: type[Kind], value: Any) -> Kind:
        """Return readings, or refuse them.

        Parameters
        ----------
        value : Interpretation, str or mapping
            The name of one of `INTERPRETATION_SETS`; or a mapping of names to choices, with the name of a set
            under ``set`` if they are to stand beside it and not beside the default.
        """
        if isinstance(value, cls):
            return value
        if isinstance(value, str):
            return cls(
                **INTERPRETATION_SETS[check_choice("interpretation", value, INTERPRETATION_SETS)]
            )
        if not isinstance(value, Mapping):
            raise invalid(
                "interpretation",
                value,
                f"a mapping of named readings, or one of {join_names(INTERPRETATION_SETS)}",
            )
        names = [f.name for f in fields(cls)]
        if SET_KEY in value:
            base = INTERPRETATION_SETS[
                check_choice(f"interpretation.{SET_KEY}", value[SET_KEY], INTERPRETATION_SETS)
            ]
            return cls.from_input(
                {**base, **{key: given for key, given in value.items() if key != SET_KEY}}
            )
        for name in value:
            if name not in names:
                raise invalid(
                    "interpretation", name, "one of " + ", ".join(names), suggest_name(name, names)
                )
        return cls(**value)

    def to_sampling_rules(self, analog: bool = False) -> SamplingRules:
        """Return the readings as kernels take them."""
        return SamplingRules(
            entry_sampling=ENTRY_SAMPLING[self.entry_point],
            facet_sampling=FACET_SAMPLING[self.facet_sampling],
            wrong_side=WRONG_SIDE_RULE[self.wrong_side_ray],
            boundary_fresnel=self.boundary_fresnel == "yes",
            segment_overlap=OVERLAP_RULE[self.overlap_with_previous_segment],
            boundary_overlap=OVERLAP_RULE[self.overlap_with_boundary],
            analog=analog,
            point_grains=GRAIN_EXTENT[self.grain_extent],
        )

    def as_dict(self) -> dict[str, str]:
        """Return all readings by name."""
        return asdict(self)

    def to_transport_dict(self) -> dict[str, str]:
        """Return the readings that SPLITS and SPLITSnow share."""
        return {field.name: getattr(self, field.name) for field in fields(TransportInterpretation)}

    def as_input(self) -> str | dict[str, str]:
        """Return the name of the set that these readings are, or those that are not by default."""
        for name, chosen in INTERPRETATION_SETS.items():
            if self == type(self)(**chosen):
                return name
        return find_differences(self, type(self)())

    def __repr__(self) -> str:
        """Return the readings on one line."""
        return f"{type(self).__name__}.from_input({format_value(self)})"


@reject_unknown_keywords
@dataclass(frozen=True, repr=False)
class Interpretation(TransportInterpretation):
    """Named readings of SPLITSnow, besides those of `TransportInterpretation`.

    By default those of the set ``splitsnow_2021``: the paper's text where it speaks without doubt
    (entry, grains across boundaries), and where it is silent or can be read two ways a
    combination that comes as near as any to 24 of its statements (docs/theory/interpretation.md).

    Parameters
    ----------
    facet_sampling, wrong_side_ray
        As in `TransportInterpretation`.
    size_definition : {"diameter", "semi_axis"}
        What a grain size of SPLITSnow Table 1 means: the major axis 2b, or b.
    size_sampling : {"cross_section", "uniform"}
        Size distribution of the grains that rays strike: ∝ s⁻² P(s), consistent with the
        attenuation K1 (SPLITS Eqs 20-25), or uniform like the sizes themselves.
    """

    facet_sampling: str = "any"
    wrong_side_ray: str = "mirror"
    size_definition: str = "diameter"
    size_sampling: str = "cross_section"


@reject_unknown_keywords
@dataclass(frozen=True, repr=False)
class SandInterpretation(TransportInterpretation):
    """Named readings of SPLITS, besides those of `TransportInterpretation`.

    With ``attenuation_factor: as_printed`` grains alone fill the volume, so ``mean_free_path`` must be "pore_only".

    Parameters
    ----------
    mixing : {"maxwell_garnett", "linear"}
        Index of a mineral with inclusions (Eq 4), or the mean of the two by volume.
    size_distribution : {"separates", "single"}
        A log-normal per soil separate (section 4.2.6), or one over silt and sand.
    excess_magnetite : {"first", "clipped"}
        More magnetite than the pure particles' share (Eq 9); see `splits.media.sand_composition`.
    attenuation_factor : {"solid_fraction", "as_printed"}
        Volume of particles per volume of sand, 1 − P, as a factor of K (section 4.2.5), or K
        as Eqs 22-24 print it, without.
    water : {"whole_pores", "narrow_pores", "film"}
        Every leg through pores is wet with the probability `saturation` (section 4.3.2); the
        shortest legs are, whose volume is `saturation`, as capillary pressure has it; or water is
        a film on all grains, which acts as a coating, up to a relative thickness of 0.05, and
        beyond that fills whole pores.  See `splits.media.wetness`.
    """

    mixing: str = "maxwell_garnett"
    size_distribution: str = "separates"
    excess_magnetite: str = "first"
    attenuation_factor: str = "solid_fraction"
    water: str = "whole_pores"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.attenuation_factor == "as_printed" and self.mean_free_path != "pore_only":
            hint = "mean chord and mean distance are both 1/K, which leaves no pores"
            raise invalid(
                "interpretation.attenuation_factor",
                self.attenuation_factor,
                "solid_fraction with this mean_free_path",
                hint,
            )
