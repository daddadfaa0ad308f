"""Study that ranks combinations of interpretations by their misfit to the statements of a paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from itertools import chain
from typing import Any, ClassVar, Literal

from pydantic import Field

from splits.core.provenance import hash_physics_sources
from splits.core.validation import check_choice, invalid, unknown_key
from splits.experiments.papers.overlap_choices import OVERLAP_CHOICES, OVERLAPS_KEY
from splits.experiments.papers.snow_statements import STATED_NUMBERS
from splits.experiments.studies.study import Experiments, Files, Study, StudyProduct, StudyRun
from splits.experiments.studies.study_files import PUBLISHED_TABLE
from splits.media.interpretations import INTERPRETATION_CHOICES, Interpretation

CHOICES = {
    **{field.name: INTERPRETATION_CHOICES[field.name] for field in fields(Interpretation)},
    OVERLAPS_KEY: tuple(OVERLAP_CHOICES),
}
"""Choices by keyword."""
STANDARD_STDERR = 0.002
"""Standard error of the accuracy for which the runs of a ranking are sized."""


class InterpretationStudy(Study):
    """Combinations of interpretations, ranked by their misfit."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Ranking of combinations of interpretations",
            "Misfit of every combination, with its rank.",
        ),
        "statements": StudyProduct(
            "{study}_statements",
            "Statements by combination of interpretations",
            "Every number and trend for each combination of interpretations that was simulated in "
            "all stages, with its standard error and its difference from the paper in units of the "
            "tolerance.",
        ),
        "without": StudyProduct(
            "{study}_without",
            "Best combination without a group of statements",
            "Best combination of interpretations if a group of statements is excluded, and the "
            "difference between its misfit and that of the second best.",
        ),
        "figure": StudyProduct.make_figure(
            "{study}",
            "All combinations of interpretations",
            "Combinations of interpretations compared with 24 statements of SPLITSnow; "
            "docs/theory/interpretation.md lists the statements that are not used. The misfit is "
            "the sum of squared differences in units of the tolerances of the table of agreement. "
            "A trend contributes only if it is violated, with a tolerance of a tenth of the "
            "compared quantity. The statements are evaluated in stages. Combinations with rank 0 "
            "were dropped after the first stages, because their misfit was larger than that of the "
            "others.",
        ),
    }
    FILES: ClassVar = {
        "published": PUBLISHED_TABLE._replace(required=tuple(chain(*STATED_NUMBERS.values())))
    }
    MESSAGE: ClassVar = "Ranking the interpretations of the paper"
    USES_ALL_THREADS: ClassVar = True

    kind: Literal["interpretation"]
    files: Files
    choices: dict[str, tuple[str, ...]] = Field(
        description="choices to combine, by keyword",
        json_schema_extra={
            "properties": {key: {"items": {"enum": [*names]}} for key, names in CHOICES.items()},
            "additionalProperties": False,
        },
    )
    stated: dict[str, str] = Field({}, description="unambiguous choices of the paper")

    def list_parameters(
        self, seed: int, max_stderr: float, experiments: Experiments
    ) -> dict[str, Any]:
        """Return seed and accuracy of its simulations."""
        return {
            "seed": seed,
            "stderr_scale": max_stderr / STANDARD_STDERR,
            "physics": hash_physics_sources(),
        }

    def check_keys(self, available: Experiments, studies: Mapping[str, Study]) -> None:
        """Reject unknown choices."""
        if not self.choices:
            raise invalid("choices", self.choices, "choices by keyword")
        for key, choices in self.choices.items():
            if key not in CHOICES:
                raise unknown_key(f"choices.{key}", CHOICES)
            for choice in choices:
                check_choice(f"choices.{key}", choice, CHOICES[key])
        for key, choice in self.stated.items():
            if key not in self.choices:
                raise unknown_key(f"stated.{key}", self.choices)
            check_choice(f"stated.{key}", choice, self.choices[key])

    def make(self, run: StudyRun) -> None:
        """Make the tables and the figure."""
        from splits.experiments.papers.interpretation_ranking import rank_interpretations
        from splits.experiments.papers.interpretation_tables import (
            find_differing_keys,
            make_leave_out_table,
            make_ranking_table,
            make_statement_table,
        )
        from splits.plotting import draw_interpretation_shifts

        choices, seed = self.choices, run.parameters["seed"]
        combinations, stated = rank_interpretations(
            run.read("published"), choices, self.stated, seed, run.threads,
            run.parameters["stderr_scale"], run.log,
        )  # fmt: skip
        names = find_differing_keys(combinations)
        table = make_statement_table(combinations, stated, names)
        ranking = make_ranking_table(combinations, stated, choices, self.stated)
        run.write_table("table", ranking)
        run.write_table("statements", table)
        run.write_table("without", make_leave_out_table(combinations, stated, names))
        run.save_figure("figure", draw_interpretation_shifts(table))
