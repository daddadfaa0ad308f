"""Interpretation of the papers: named choices where their text is ambiguous.

docs/theory/interpretation.md gives the reason for each default and the effect of the alternatives
on reflectance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal, Self, get_args, get_type_hints

from splits.core.arrays import ContentEquality
from splits.core.declarations import Quantity, declare_class
from splits.core.validation import check_choice, invalid, join_names, key_prefix, to_text_keys
from splits.kernels.scene import (
    ENTRY_SAMPLING,
    FACET_SAMPLING,
    GRAIN_EXTENT,
    OVERLAP_RULE,
    WRONG_SIDE_RULE,
    SamplingRules,
)
from splits.media.formatting import find_differences, format_input

INTERPRETATION_SETS: dict[str, dict[str, str]] = {
    "splits_2007": {
        "entry_point": "uniform", "facet_sampling": "projected", "wrong_side_ray": "cosine_lobe",
        "overlap_with_previous_segment": "reject", "overlap_with_boundary": "reject",
        "mean_free_path": "pore_only", "grain_extent": "finite",
    },
    "splitsnow_2021": {
        "entry_point": "uniform", "facet_sampling": "any", "wrong_side_ray": "mirror",
        "overlap_with_previous_segment": "reject", "overlap_with_boundary": "reject",
        "mean_free_path": "pore_only", "grain_extent": "finite",
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
"""Named sets of choices; keys that a set omits keep their defaults."""
SET_KEY = "set"
"""Key of a mapping that names the set which the other keys modify."""


def merge_interpretations(given: Sequence[Any]) -> Any:
    """Merge interpretations given in sequence; the name of a set replaces all before it."""
    merged: Any = {}
    for value in given:
        mapping = {SET_KEY: value} if isinstance(value, str) else value
        if not isinstance(mapping, Mapping):
            return value
        merged = dict(mapping) if SET_KEY in mapping else {**merged, **mapping}
    return merged[SET_KEY] if list(merged) == [SET_KEY] else merged


@declare_class
class TransportInterpretation(ContentEquality):
    """Interpretation of the transport model common to SPLITS and SPLITSnow.

    Parameters
    ----------
    entry_point : {"uniform", "projected"}
        Sampling of the entry point: uniform over the surface facing the ray (SPLITS 4.3.3,
        SPLITSnow 3.2), or by projected area, as for straight rays through real grains.
    facet_sampling : {"projected", "unweighted", "any"}
        Sampling of the facet that is hit: facing the ray and weighted by projected area (SPLITS
        4.3.4), facing the ray with equal weight, or any facet.
    wrong_side_ray : {"cosine_lobe", "mirror"}
        Treatment of a ray that a tilted facet scatters to the wrong side of the surface of the
        grain: its direction is sampled from a cosine lobe on the correct side (SPLITS 4.3.4), or
        mirrored in the surface.
    boundary_fresnel : {"yes", "no"}
        Fresnel reflection and refraction at the boundaries of the sample where water fills the
        pores (SPLITS 4.3.1).
    overlap_with_previous_segment : {"reject", "keep", "skip"}
        Treatment of a sampled grain that overlaps the previous path segment through the pores.  It
        is sampled again from the same origin, with a new distance (SPLITS 4.3.3); accepted; or
        skipped, so that the next distance starts at its position.
    overlap_with_boundary : {"reject", "keep", "skip"}
        Treatment of a sampled grain that overlaps a boundary of the sample (SPLITS 4.3.3, SPLITSnow
        3.2), with the same choices.  With "keep", a ray that leaves a grain outside the sample is
        placed on the boundary.  With "skip", the number density of grains near the boundaries is
        reduced to that of the grains that fit there.
    mean_free_path : {"pore_only", "including_grain"}
        The mean distance between grains is the length of a path segment through the pores, as in
        the papers, or the distance from one entry to the next, including the path through the
        grain.  With the latter, the fractions of path length in grains and in water equal their
        volume fractions, and the number of collisions per metre agrees with the surface area.
    grain_extent : {"finite", "point"}
        The path through a grain displaces the ray, as in the papers, or grains are point
        scatterers, as in radiative transfer.  The mean free path between point grains is 1/(𝓔 K).
        The fraction of it that is pore space is 1 − 𝓔 under ``mean_free_path: including_grain`` and
        1 under ``pore_only``.  Point grains overlap neither a boundary nor the previous segment, so
        both overlap rules must be "keep".
    """

    entry_point: Literal["uniform", "projected"] = "uniform"
    facet_sampling: Literal["projected", "unweighted", "any"] = "projected"
    wrong_side_ray: Literal["cosine_lobe", "mirror"] = "cosine_lobe"
    boundary_fresnel: Literal["yes", "no"] = "yes"
    overlap_with_previous_segment: Literal["reject", "keep", "skip"] = "reject"
    overlap_with_boundary: Literal["reject", "keep", "skip"] = "reject"
    mean_free_path: Literal["pore_only", "including_grain"] = "pore_only"
    grain_extent: Literal["finite", "point"] = "finite"

    def __post_init__(self) -> None:
        rules = {
            "overlap_with_previous_segment": self.overlap_with_previous_segment,
            "overlap_with_boundary": self.overlap_with_boundary,
        }
        for name, rule in rules.items():
            if self.grain_extent == "point" and rule != "keep":
                hint = "or grain_extent finite, as in the set geometric"
                raise invalid(name, rule, "keep with grain_extent point", hint)

    @classmethod
    def from_input(cls, value: Any) -> Self:
        """Return the interpretation for a user's input.

        Parameters
        ----------
        value : Interpretation, str or mapping
            The name of one of `INTERPRETATION_SETS`, or a mapping of names to choices.  The key
            ``set`` of a mapping names the set that the other keys modify, in place of the default.

        Raises
        ------
        ValueError
            For an unknown name or choice.
        """
        if isinstance(value, cls):
            return value
        given = {SET_KEY: value} if isinstance(value, str) else value
        if not isinstance(given, Mapping):
            allowed = f"a mapping of named choices, or one of {join_names(INTERPRETATION_SETS)}"
            raise invalid("interpretation", value, allowed)
        given = to_text_keys("interpretation", given)
        if SET_KEY in given:
            key = "interpretation" if isinstance(value, str) else f"interpretation.{SET_KEY}"
            name = check_choice(key, given[SET_KEY], INTERPRETATION_SETS)
            own_choices = {key: choice for key, choice in given.items() if key != SET_KEY}
            given = {**INTERPRETATION_SETS[name], **own_choices}
        with key_prefix("interpretation"):
            return cls(**given)

    def to_sampling_rules(self, analog: bool = False) -> SamplingRules:
        """Return the sampling rules in the form the kernels take."""
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
        """Return all choices by name."""
        return asdict(self)

    def as_input(self) -> str | dict[str, str]:
        """Return the name of the matching set, or the choices that differ from the defaults."""
        for name, choices in INTERPRETATION_SETS.items():
            if self == type(self)(**dict[str, Any](choices)):
                return name
        return find_differences(self, type(self)())

    def __repr__(self) -> str:
        """Return the call that constructs the interpretation, on one line."""
        return f"{type(self).__name__}.from_input({format_input(self)})"


@declare_class
class Interpretation(TransportInterpretation):
    """Interpretation of SPLITSnow, in addition to that of `TransportInterpretation`.

    The default is the set ``splitsnow_2021``.  It follows the text of the paper where that is
    unambiguous (entry point, overlap with boundaries).  The other choices are a combination that
    agrees with 24 statements of the paper as well as any other, within the errors
    (docs/theory/interpretation.md).

    Parameters
    ----------
    facet_sampling, wrong_side_ray
        As in `TransportInterpretation`.
    size_definition : {"diameter", "semi_axis"}
        Meaning of a grain size of SPLITSnow Table 1: the major axis 2b, or b.
    size_sampling : {"cross_section", "uniform"}
        Size distribution of the grains that rays hit: ∝ s⁻² P(s), consistent with the attenuation
        K1 (SPLITS Eqs 20-25), or uniform like P(s).
    """

    facet_sampling: Literal["projected", "unweighted", "any"] = "any"
    wrong_side_ray: Literal["cosine_lobe", "mirror"] = "mirror"
    size_definition: Literal["diameter", "semi_axis"] = "diameter"
    size_sampling: Literal["cross_section", "uniform"] = "cross_section"


@declare_class
class SandInterpretation(TransportInterpretation):
    """Interpretation of SPLITS, in addition to that of `TransportInterpretation`.

    With ``attenuation_factor: as_printed`` the solid fraction is taken as 1, so ``mean_free_path``
    must be "pore_only".

    Parameters
    ----------
    mixing : {"maxwell_garnett", "linear"}
        Refractive index of a mineral with inclusions: Maxwell Garnett (Eq 4), or the mean of the
        two indices by volume.
    size_distribution : {"separates", "single"}
        One log-normal distribution per soil separate (section 4.2.6), or a single one for all
        separates.
    excess_magnetite : {"first", "clipped"}
        Treatment of more magnetite than the fraction of pure grains (Eq 9); see
        `splits.media.sand_composition`.
    attenuation_factor : {"solid_fraction", "as_printed"}
        Whether the volume of grains per volume of sand, 1 − P, multiplies K (section 4.2.5), or
        K is that of Eqs 22-24 as printed.
    water : {"whole_pores", "narrow_pores", "film"}
        Every path segment through the pores is wet with the probability `saturation` (section
        4.3.2); or the shortest segments are wet, up to a total length fraction of `saturation`, as
        capillary pressure fills narrow pores first; or water is a film on all grains, treated as a
        coating, up to a relative thickness of 0.05, and the rest fills whole pores.  See
        `splits.media.sand_composition`.
    """

    mixing: Literal["maxwell_garnett", "linear"] = "maxwell_garnett"
    size_distribution: Literal["separates", "single"] = "separates"
    excess_magnetite: Literal["first", "clipped"] = "first"
    attenuation_factor: Literal["solid_fraction", "as_printed"] = "solid_fraction"
    water: Literal["whole_pores", "narrow_pores", "film"] = "whole_pores"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.attenuation_factor == "as_printed" and self.mean_free_path != "pore_only":
            raise invalid(
                "attenuation_factor", self.attenuation_factor,
                "solid_fraction with this mean_free_path",
                "mean chord and mean distance are both 1/K, which leaves no pore space",
            )  # fmt: skip


INTERPRETATION_SCHEMA = {"anyOf": [{"enum": list(INTERPRETATION_SETS)}, {"type": "object"}]}
InterpretationInput = Annotated[
    Any,
    Quantity(
        "interpretation of the papers",
        check=lambda _, value: Interpretation.from_input(value),
        schema=INTERPRETATION_SCHEMA,
    ),
]
SandInterpretationInput = Annotated[
    Any,
    Quantity(
        "interpretation of the papers",
        check=lambda _, value: SandInterpretation.from_input(value),
        schema=INTERPRETATION_SCHEMA,
    ),
]
INTERPRETATION_CHOICES: dict[str, tuple[str, ...]] = {
    name: get_args(hint)
    for kind in (Interpretation, SandInterpretation)
    for name, hint in get_type_hints(kind).items()
    if get_args(hint)
}
"""Choices by name."""
