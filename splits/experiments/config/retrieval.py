"""Sections `retrieve` and `retrieve_return` of an experiment file: what is retrieved from what.

The retrievals check their measurements, ranges and priors against the table.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, PlainSerializer, model_validator

from splits.core.declarations import Quantity
from splits.core.inputs import Interval, RayCount
from splits.core.validation import check_choice, check_relations, invalid, snap_to_limits
from splits.experiments.config.sections import (
    FiniteSection,
    Label,
    MeasuredFile,
    Number,
    accept_single,
)
from splits.instruments.delay_record import DelayEdges, PulseInput
from splits.retrieval.state_vector import SCALE

if TYPE_CHECKING:
    from splits.experiments.config.simulation import SimulationConfig

MIN_STDERR = 1e-6
"""Smallest relative standard error, for reflectances near 0."""
MAX_PHOTONS = 1e30
LAW_UNSUPPORTED_KEYWORDS = (
    "impurities_ng_g", "algae_cells_ml", "liquid_water_content", "saturation", "pores",
)  # fmt: skip
"""Keywords of snow that a published law does not describe, unless they are on the grid."""


class NoiseSection(FiniteSection):
    """Standard errors of measured reflectances: absolute, and relative to the value."""

    absolute: Number = Field(0.0, ge=0.0, le=1.0)
    """standard error in units of reflectance, independent at each wavelength; `independent` in
    Python"""
    relative: Number = Field(0.0, ge=0.0, le=1.0)
    """standard error as a fraction of the value, correlated over `correlation_nm`; in Python
    `stderr`, in units of reflectance"""
    correlation_nm: Number | None = Field(None, gt=0.0, le=1e5)
    """correlation length of the relative errors (nm); by default they are independent"""

    @model_validator(mode="before")
    @classmethod
    def _check_type(cls, value: Any) -> Any:
        if not isinstance(value, dict | NoiseSection):
            allowed = "a mapping such as {relative: 0.01, absolute: 0.003}, or left out"
            raise invalid("", value, allowed, "without it the misfit gives the errors")
        return value

    @model_validator(mode="after")
    def _check_noise(self) -> NoiseSection:
        check_relations(
            (
                self.absolute + self.relative > 0.0, "absolute", 0.0, "above 0, or relative",
                "no measurement is exact",
            ),
            (
                self.correlation_nm is None or self.relative, "correlation_nm",
                self.correlation_nm, "left out without relative", "absolute errors are independent",
            ),
        )  # fmt: skip
        return self

    def evaluate(self, values: np.ndarray) -> Any:
        """Return the argument `noise` of `splits.retrieve` for reflectances."""
        relative = np.maximum(self.relative * np.abs(values), MIN_STDERR)
        if self.correlation_nm is None:
            return np.hypot(self.absolute, relative)
        correlated = {"stderr": relative, "correlation_nm": self.correlation_nm}
        return correlated | ({"independent": self.absolute} if self.absolute else {})


class PriorFromSample(FiniteSection):
    """A sample that is retrieved first, with some parameters fixed."""

    sample: str
    """name of the sample"""
    fixed: dict[str, Number | str]
    """known parameters of the sample"""
    applies_to: str = ""
    """beginning of the names of the samples that use its posterior as a prior"""


class RetrieveSection(FiniteSection):
    """Measured spectra, and the parameters to retrieve with the table of the experiment."""

    measured: MeasuredFile
    """name of a file of `config/measured/`, with a column `wavelength_nm` and a column of
    reflectances (fractions, no gaps) per sample; a suffix such as `@50` of a sample's name is its
    incidence angle, which must be in the table"""
    free: dict[str, tuple[Number, Number]] | tuple[str, ...]
    """parameters to retrieve, which are axes of the grid or `scale`; a mapping also gives their
    ranges (low, high)"""
    quantity: Literal["reflectance", "reflectance_factor"] = "reflectance"
    """measured quantity; `reflectance_factor` needs a table with directions"""
    noise: NoiseSection | None = None
    """standard errors of the measurement, by default estimated from the misfit"""
    samples: tuple[str, ...] = ()
    """samples to use; by default all"""
    fixed: dict[str, Number | str] = Field({})
    """values of the other axes, and `polar_deg` and `azimuth_deg` of the measurement for a table
    with several directions"""
    prior: dict[str, tuple[Number, Number]] = Field({})
    """prior (mean, standard deviation) by parameter"""
    exclude_nm: tuple[Interval, ...] = ()
    """intervals (low, high) of wavelengths to exclude"""
    model_axis: str | None = None
    """an axis of texts whose values are alternative models; each sample is retrieved with all of
    them"""
    compare_with: Literal["kokhanovsky_zege_2004"] | None = None
    """a published law for snow, with which the parameters of the samples are also retrieved
    (Kokhanovsky and Zege 2004, as implemented in snowoptics)"""
    prior_from: Annotated[tuple[PriorFromSample, ...], accept_single(PriorFromSample)] = ()
    """a sample (`sample`), or a list of them, that is retrieved first, with the parameters of
    `fixed` known; the marginal posteriors of its other parameters are priors of all other samples,
    or of those whose names begin with `applies_to`"""
    reference_values: dict[str, dict[str, Number]] = Field({})
    """independent values by parameter and sample, shown in the figure for comparison"""


class SyntheticReturn(FiniteSection):
    """Known media, whose returns are simulated and counted as photons."""

    truth: dict[Label, dict[str, Number]]
    """values of the free parameters by sample, and of other keywords of the medium that differ from
    those of the table; `scale` is by default 1"""
    delay_s: Annotated[DelayEdges, PlainSerializer(lambda edges: edges.tolist())]
    """edges of the bins in which photons are counted (s), also as `{start, stop, step}`"""
    rays: RayCount = 200_000
    """number of rays of a return, which limits its accuracy besides the photons"""
    seed_offset: Annotated[int, Quantity("difference of seeds", low=1, high=2**31 - 1)] = 1
    """difference of the seed from that of the table; returns and table are independent"""


class RetrieveReturnSection(FiniteSection):
    """Returns of a pulse, and the parameters to retrieve with the table of the experiment."""

    free: dict[str, tuple[Number, Number]] | tuple[str, ...]
    """parameters to retrieve, which are axes of the grid or `scale`, a factor of the return for a
    pulse or a receiver of unknown power (0.2 to 5); a mapping also gives their ranges (low, high)
    """
    measured: MeasuredFile | None = None
    """name of a file of `config/measured/`, with columns `wavelength_nm`, `delay_start_s` and
    `delay_end_s` and a column per sample: counted photons with `photons`, otherwise the fraction of
    the incident light per time (s⁻¹), with its standard error in a column `…_stderr`"""
    synthetic: SyntheticReturn | None = None
    """known media instead of a file"""
    photons: Number | None = Field(None, gt=0.0, le=MAX_PHOTONS)
    """number of photons of the pulse, by which counted photons are divided and from which their
    noise follows; if it is unknown, an estimate with a free `scale`"""
    pulse: PulseInput = None
    """full width at half maximum of a Gaussian pulse (s), or its power over time; by default, the
    pulse is instantaneous"""
    samples: tuple[str, ...] = ()
    """samples of the file to use; by default all"""
    fixed: dict[str, Number | str] = Field({})
    """values of the other axes of the grid"""
    prior: dict[str, tuple[Number, Number]] = Field({})
    """prior (mean, standard deviation) by parameter"""
    reference_values: dict[str, dict[str, Number]] = Field({})
    """independent values by parameter and sample of the file, shown in the figure for comparison"""

    @model_validator(mode="after")
    def _check_source(self) -> RetrieveReturnSection:
        is_synthetic, is_measured = self.synthetic is not None, self.measured is not None
        of_file = {"samples": self.samples, "reference_values": self.reference_values}
        hint = "synthetic.truth has the samples and their values"
        check_relations(
            (
                is_synthetic != is_measured, "measured", "given" if is_measured else "left out",
                "given, or synthetic instead, not both",
            ),
            (
                is_measured or self.photons is not None, "photons", None, "given",
                "synthetic returns are counted photons",
            ),
            *(
                (is_measured or not value, key, value, "left out with synthetic", hint)
                for key, value in of_file.items()
            ),
        )  # fmt: skip
        return self

    def list_references(self) -> dict[str, dict[str, float]]:
        """Return the known values of free parameters by parameter and sample."""
        if self.synthetic is None:
            return self.reference_values
        truth = self.synthetic.truth.items()
        return {
            name: {sample: {SCALE: 1.0, **values}[name] for sample, values in truth}
            for name in self.free
        }


def check_retrieval(
    experiment: SimulationConfig, section: RetrieveSection | RetrieveReturnSection, name: str
) -> None:
    """Reject a section that names what the table of its experiment does not have."""
    instrument = experiment.instrument
    kind = "table" if isinstance(section, RetrieveSection) else "return_table"
    if instrument.kind != kind:
        raise invalid("instrument.kind", instrument.kind, f"{kind} with a section {name}")
    axes = experiment.make_axes()
    grid = [axis for axis in axes if axis not in instrument.get_views()]
    for key, names in (
        ("free", [*grid, SCALE]), ("fixed", axes), ("prior", [*grid, SCALE]),
        ("reference_values", section.free),
    ):  # fmt: skip
        for one in getattr(section, key):
            check_choice(f"{name}.{key}", one, names)
    if not isinstance(section, RetrieveSection):
        return
    quantities, model_axis = instrument.list_quantities(), section.model_axis
    texts = [axis for axis, nodes in axes.items() if isinstance(nodes[0], str)]
    check_relations(
        (
            section.quantity in quantities, "instrument.quantities", quantities,
            f"with {section.quantity}",
        ),
        (
            not instrument.get_views() or "quantity" in section.model_fields_set,
            "retrieve.quantity", None, "given: reflectance or reflectance_factor",
            "the table has directions",
        ),
        (
            model_axis in (None, *texts), "retrieve.model_axis", model_axis,
            f"one of {', '.join(texts)}" if texts else "left out: no axis is of texts",
            "an axis of the grid",
        ),
        *(
            (
                model_axis not in getattr(section, key), f"retrieve.{key}.{model_axis}", "given",
                "left out", "it is model_axis",
            )
            for key in ("fixed", "free", "reference_values")
        ),
    )  # fmt: skip
    if not section.compare_with:
        return
    key, law, medium = "retrieve.compare_with", section.compare_with, experiment.medium
    media_kind = medium.get("kind")
    unsupported = [keyword for keyword in LAW_UNSUPPORTED_KEYWORDS if medium.get(keyword)]
    if medium.get("depth_m", math.inf if media_kind == "natural_snow" else None) != math.inf:
        unsupported.append("a finite depth_m")
    if media_kind not in ("snow", "natural_snow"):
        raise invalid(key, law, "left out for media other than snow")
    if unsupported:
        hint = "it describes deep, dry snow with the parameters of the grid"
        raise invalid(key, law, f"left out with {unsupported[0]}", hint)


def check_on_grid(key: str, value: Any, nodes: tuple[Any, ...] | None) -> None:
    """Reject a value outside the range of an axis."""
    if nodes is None:
        return
    if isinstance(nodes[0], str) or isinstance(value, str):
        check_choice(key, value, [str(node) for node in nodes])
    elif not nodes[0] <= snap_to_limits(value, nodes[0], nodes[-1]) <= nodes[-1]:
        raise invalid(key, value, f"{nodes[0]:g} to {nodes[-1]:g}, the range of the grid")
