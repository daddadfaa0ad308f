"""Studies of sensitivities: mean and Sobol indices, and the most informative bands of tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from splits.core.provenance import RETRIEVAL_SOURCES, hash_sources
from splits.core.validation import check_choice, invalid, unknown_key
from splits.experiments.config.grid import make_label
from splits.experiments.config.retrieve_checks import check_on_grid
from splits.experiments.config.sections import ConfigSection
from splits.experiments.papers.sensitivity_table import list_published_names
from splits.experiments.studies.study import (
    Experiments,
    Files,
    Inputs,
    Study,
    StudyProduct,
    StudyRun,
)
from splits.experiments.studies.study_files import PUBLISHED_TABLE
from splits.experiments.studies.study_input import StudyInput, check_input
from splits.illumination.bands import SENSORS

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

DEPTHS_M: Mapping[str, tuple[float | str, ...]] = {"depth_m": (0.12, 0.02)}
"""Depths of `splits.experiments.papers.sensitivity_table.QUANTITY_CONDITIONS`."""
BAND_NM = (400.0, 2500.0)


class SensitivityPair(ConfigSection):
    """Two values of a parameter between which the sensitivity of a spectrum is computed.

    `experiment` varies the parameter, and `interpretation_experiment` the interpretation of the
    papers as well.  `source` is the origin of the two values: the paper, or our choice.
    """

    parameter: str = Field(description="parameter that varies")
    experiment: str = Field(description="experiment over the parameter and the depth")
    interpretation_experiment: str | None = Field(
        None, description="experiment that also varies the interpretations of the papers"
    )
    low: float | str = Field(
        description="one end of the range: a number, or the label of a value that is no number"
    )
    high: float | str = Field(description="the other end; the order has no effect")
    source: Literal["paper", "ours"] = Field(
        "ours", description="who chose the two values; the figure indicates this"
    )

    def list_experiments(self) -> list[str]:
        """Return the names of its experiments."""
        return [name for name in (self.experiment, self.interpretation_experiment) if name]

    def check(self, key: str, available: Experiments) -> None:
        """Reject experiments that do not meet the requirements."""
        if make_label(key, self.low) == make_label(key, self.high):
            raise invalid(f"{key}.high", self.high, f"different from low = {self.low}")
        axes, labels = (self.parameter, "depth_m"), {self.parameter: (self.low, self.high)}
        for name, more in (("experiment", ()), ("interpretation_experiment", ("interpretation",))):
            if (used := getattr(self, name)) in available:
                required = StudyInput((*axes, *more), {**labels, **DEPTHS_M}, band_nm=BAND_NM)
                check_input(f"{key}.{name}", available[used], required)


class SensitivityStudy(Study):
    """Mean sensitivity indices of spectra to parameters."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Mean sensitivity index for all pairs of values",
            "Mean sensitivity index for every pair of simulated values and for every "
            "interpretation of the papers. In the index msi, wavelengths where both spectra are "
            "below two standard errors contribute 0; msi_resolved excludes them; resolved_fraction "
            "is the fraction of the other wavelengths.",
        ),
        "chosen": StudyProduct(
            "{study}_chosen",
            "Mean sensitivity indices",
            "The values of the figure, and the published ones.",
            place="Table 2",
        ),
        "data": StudyProduct("{study}_index", folder="data", suffixes=(".nc",)),
        "figure": StudyProduct.make_figure(
            "{study}_index",
            "Mean sensitivity indices",
            "Mean sensitivity index of reflectance (12 cm, 400-2500 nm) and transmittance (2 cm, "
            "400-1420 nm). Error bars extend over two standard errors to either side. Standard "
            "errors include the correlation of errors between wavelengths. The paper does not "
            "state the extremes of saturation and density: those used here are in the "
            "configuration, and the table of sensitivities has the index for others.",
            place="Fig 23",
        ),
    }
    FILES: ClassVar = {"published": PUBLISHED_TABLE}
    OPTIONAL_FILES: ClassVar = True
    MESSAGE: ClassVar = "Computing mean sensitivity indices"

    kind: Literal["sensitivity"]
    pairs: dict[str, SensitivityPair] = Field(description="pairs of values by name; see below")
    files: Files = Field({})

    def list_experiments(self) -> list[str]:
        """Return the names of the experiments of the study, without repetition."""
        names = [name for pair in self.pairs.values() for name in pair.list_experiments()]
        return list(dict.fromkeys(names))

    def check_inputs(self, available: Experiments) -> None:
        """Reject experiments that do not meet the requirements."""
        if not self.pairs:
            raise invalid("pairs", self.pairs, "at least one pair")
        for name, pair in self.pairs.items():
            pair.check(f"pairs.{name}", available)

    def list_required_values(self, key: str) -> tuple[str, ...]:
        """Return the ids of the published indices of all pairs."""
        return tuple(name for pair in self.pairs for name in list_published_names(pair))

    def make(self, run: StudyRun) -> None:
        """Make the tables, the dataset and the figure."""
        from splits import save
        from splits.experiments.papers.sensitivity_table import (
            describe_ranges,
            make_sensitivity_table,
            select_chosen_sensitivities,
        )
        from splits.plotting import draw_sensitivity_bars

        pairs = {name: pair.model_dump() for name, pair in self.pairs.items()}
        datasets = {name: run.load(name) for name in self.list_experiments()}
        table = make_sensitivity_table(datasets, pairs)
        published = run.read("published") if run.files else None
        chosen = select_chosen_sensitivities(table, published)
        run.write_table("table", table)
        run.write_table("chosen", chosen.to_dataframe().reset_index())
        save(chosen, run.outputs["data"][0])
        run.save_figure("figure", draw_sensitivity_bars(chosen, describe_ranges(pairs)))


class TableStudy(Study):
    """Study of tables with any names, which are titles."""

    inputs: Inputs

    def list_parameters(
        self, seed: int, max_stderr: float, experiments: Experiments
    ) -> dict[str, Any]:
        """Return the seed, and a digest of the sources."""
        return {"seed": seed, "program": hash_sources(RETRIEVAL_SOURCES)}

    def check_inputs(self, available: Experiments) -> None:
        """Reject experiments that are no tables over two numeric parameters or more."""
        if not self.inputs:
            raise invalid("inputs", self.inputs, "at least one experiment by name")
        if len({key.replace("_", " ") for key in self.inputs}) < len(self.inputs):
            hint = "underscores are shown as spaces"
            raise invalid("inputs", list(self.inputs), "names that differ", hint)
        for key, name in self.inputs.items():
            if name not in available:
                continue
            experiment = available[name]
            is_table = "reflectance" in getattr(experiment.instrument, "quantities", ())
            has_views = getattr(experiment.instrument, "polar_deg", None) is not None
            axes = experiment.make_axes().values if is_table and not has_views else ()
            numeric_axes = [row for row in axes if len(row) > 1 and not isinstance(row[0], str)]
            if len(numeric_axes) < 2:
                raise invalid(
                    f"inputs.{key}", name, "a table of reflectance over two parameters or more"
                )


def concatenate_tables(results: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Return results by name as rows of one table."""
    import pandas as pd

    rows = [ds.to_dataframe().reset_index().assign(table=name) for name, ds in results.items()]
    return pd.concat(rows, ignore_index=True)


class SobolStudy(TableStudy):
    """Sobol indices by wavelength of the parameters of tables; study inputs are titles."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Sobol indices by wavelength",
            "The values of the figure. Parameters are uniform between low and high.",
        ),
        "figure": StudyProduct.make_figure(
            "{study}",
            "Sobol indices by wavelength",
            "Sobol indices of reflectance for tables of simulations. The first-order index is "
            "the fraction of the variance that is due to one parameter alone. The total index "
            "includes its interactions with other parameters. Parameters are independent and "
            "uniform over their ranges, in the coordinate in which reflectance is closest to "
            "linear (the logarithm of a size, the square root of an amount). Standard errors are "
            "those of sampling, from 16 repetitions.",
        ),
    }
    MESSAGE: ClassVar = "Computing Sobol indices of tables"

    kind: Literal["sobol"]

    def make(self, run: StudyRun) -> None:
        """Make the table and the figure."""
        import splits
        from splits.plotting.sensitivity import draw_sobol_indices
        from splits.tables.axes import list_numeric_axes

        indices = {}
        for key, name in self.inputs.items():
            table = splits.open_table(run.datasets[name])
            free = list_numeric_axes(table.dataset, table.axes[:-1])
            seed = run.parameters["seed"]
            indices[key.replace("_", " ")] = splits.sobol_indices(table, free, seed=seed)
        run.write_table("table", concatenate_tables(indices))
        run.save_figure("figure", draw_sobol_indices(indices))


class BandsStudy(TableStudy):
    """Most informative bands for the axes of tables, in order; study inputs are titles."""

    PRODUCTS: ClassVar = {
        "table": StudyProduct(
            "{study}",
            "Most informative bands",
            "The values of the figure: information in bits, and the spread.",
        ),
        "figure": StudyProduct.make_figure(
            "{study}",
            "Most informative bands",
            "Most informative bands for tables of simulations: the band with the largest "
            "information on all parameters, then the band that adds most to it, and so on "
            "(information in bits, after Rodgers 1996), with the stated noise of each band. The "
            "spread is the posterior standard deviation of a parameter divided by the prior one, "
            "in the coordinate in which reflectance is closest to linear.",
        ),
    }
    MESSAGE: ClassVar = "Selecting the most informative bands"

    kind: Literal["bands"]
    bands: str | None = Field(
        None, description="sensor whose bands are candidates; by default every wavelength"
    )
    noise: float = Field(0.01, gt=0.0, le=1.0, description="standard error of a band")
    n_bands: int = Field(5, ge=1, description="number of bands to select")
    fixed: dict[str, float | str] = Field(
        {}, description="known values of axes, for the tables that have these axes"
    )

    def check_keys(self, available: Experiments, studies: Mapping[str, Study]) -> None:
        """Reject unknown sensors, fixed values outside the axes, and text axes not fixed."""
        if self.bands is not None:
            check_choice("bands", self.bands, SENSORS)
        used = [available[n] for n in self.inputs.values() if n in available]
        rows = {name: row for one in used for name, row in zip(*one.make_axes(), strict=True)}
        for name, value in self.fixed.items() if used else ():
            if name not in rows:
                raise unknown_key(f"fixed.{name}", rows)
            check_on_grid(f"fixed.{name}", value, rows[name])
        for name, row in rows.items():
            if isinstance(row[0], str) and len(row) > 1 and name not in self.fixed:
                raise invalid(f"fixed.{name}", "nothing", f"one of {', '.join(map(str, row))}")

    def make(self, run: StudyRun) -> None:
        """Make the table and the figure."""
        import splits
        from splits.plotting.sensitivity import draw_band_selection
        from splits.tables.axes import list_numeric_axes

        selections = {}
        for key, name in self.inputs.items():
            table = splits.open_table(run.datasets[name])
            fixed = {n: value for n, value in self.fixed.items() if n in table.axes}
            free = [n for n in list_numeric_axes(table.dataset, table.axes[:-1]) if n not in fixed]
            bands = self.bands or table.dataset.wavelength.values
            selections[key.replace("_", " ")] = splits.select_bands(
                table, bands, free, self.noise, self.n_bands, fixed=fixed,
                seed=run.parameters["seed"],
            )  # fmt: skip
        run.write_table("table", concatenate_tables(selections))
        conditions = ", ".join(f"{n} {v}" for n, v in self.fixed.items())
        note = f"Noise {self.noise:g}" + (f", at {conditions}" if conditions else "")
        run.save_figure("figure", draw_band_selection(selections, note))
