"""Requirements of each kind of study on its input experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class StudyInput:
    """Requirements on an input experiment.

    Attributes
    ----------
    axes : tuple of str
        Parameters of its grid, exactly.
    labels : mapping
        Values that its grid must contain, by parameter.
    at_nm, band_nm : tuple of float
        Wavelengths that it must contain, and the ends of a range that it must cover (nm).
    instrument : str
    """

    axes: tuple[str, ...] = ()
    labels: Mapping[str, tuple[float | str, ...]] = field(default_factory=dict)
    at_nm: tuple[float, ...] = ()
    band_nm: tuple[float, ...] = ()
    instrument: str = "spectrophotometer"


def _make_goniophotometer_input(*over: str, **needs: object) -> StudyInput:
    return StudyInput(over, instrument="goniophotometer", **needs)  # type: ignore[arg-type]


_VISIBLE_NM = (400.0, 700.0)
_SAND_RANGE_NM = (400.0, 1000.0)

SENSITIVITY_DEPTHS_M: Mapping[str, tuple[float | str, ...]] = {"depth_m": (0.12, 0.02)}
"""Depths of `splits.experiments.papers.sensitivity_table.QUANTITY_CONDITIONS`."""

OVERLAPS_KEY = "overlaps"
"""Key of a ranking of interpretations that sets `OVERLAP_KEYS` together."""
OVERLAP_KEYS = ("overlap_with_previous_segment", "overlap_with_boundary")
"""Fields of `splits.Interpretation` for grains that overlap the last segment or a boundary."""
OVERLAP_CHOICES = {
    "reject": ("reject", "reject"),
    "keep": ("keep", "keep"),
    "skip": ("skip", "skip"),
    "segment overlap kept": ("keep", "reject"),
}
"""Values of `OVERLAPS_KEY`, and those of `OVERLAP_KEYS` for each."""

SNOW_INPUTS = {
    "sample": StudyInput(("density_kg_m3",), {"density_kg_m3": (450,)}),
    "thick_transmittance": StudyInput(band_nm=(400.0, 1000.0)),
    "grain_size": StudyInput(("grain_size_um",), band_nm=(400.0, 2500.0),
                       at_nm=(1500.0, 1800.0, 2000.0, 2250.0, 2500.0)),
    "facetness": StudyInput(("facetness",), band_nm=(700.0, 1300.0)),
    "density": StudyInput(("density_kg_m3",), {"density_kg_m3": (300, 450)}),
    "depth": StudyInput(("depth_m",), at_nm=(1030.0,), band_nm=_VISIBLE_NM),
    "grain_size_transmittance": StudyInput(("grain_size_um",), band_nm=_VISIBLE_NM),
    "saturation_transmittance": StudyInput(("saturation",), band_nm=(400.0, 1450.0)),
    "density_transmittance": StudyInput(("density_kg_m3",), at_nm=(1420.0,), band_nm=_VISIBLE_NM),
    "aviris": StudyInput(at_nm=(842.25, 1073.76, 1237.93)),
    "letcher": StudyInput(("medium", "depth_m", "incidence_deg"),
                    {"depth_m": (0.34, 0.045), "incidence_deg": ("beam", "diffuse")}),
    "interpretation": StudyInput(("interpretation",), at_nm=(842.25, 1073.76, 1237.93)),
}  # fmt: skip
"""Inputs of the comparison with SPLITSnow."""

SAND_INPUTS = {
    "samples": StudyInput(("medium",), band_nm=_SAND_RANGE_NM),
    "wet_colours": StudyInput(("medium", "saturation"), band_nm=(400.0, 780.0)),
    "colours": StudyInput(("medium",), band_nm=(400.0, 780.0)),
    "iron_oxide": StudyInput(("iron_oxide",), band_nm=_SAND_RANGE_NM),
    "hematite_ratio": StudyInput(("hematite_ratio",), band_nm=(480.0, 700.0)),
    "magnetite": StudyInput(("magnetite",), band_nm=_SAND_RANGE_NM),
    "texture": StudyInput(("texture",), band_nm=_SAND_RANGE_NM),
    "fine_fraction": StudyInput(("texture",), band_nm=(400.0, 500.0)),
    "mineral_weight": StudyInput(
        ("medium", "refractive_index"), {"refractive_index": ("as modelled",)}
    ),
    "interpretation": StudyInput(("medium", "interpretation"), {"interpretation": ("default",)}),
    "size_tail": StudyInput(("medium", "size_tail"), {"size_tail": (1e-4,)}),
}
"""Inputs of the trends of SPLITS."""

BRDF_INPUTS = {
    "incidence": _make_goniophotometer_input("incidence_deg", labels={"incidence_deg": (0,)}),
    "grazing": _make_goniophotometer_input("incidence_deg"),
    "wavelength": _make_goniophotometer_input(at_nm=(600.0, 1800.0)),
    "grain_size": _make_goniophotometer_input("grain_size_um"),
    "grain_size_uniform": _make_goniophotometer_input("grain_size_um"),
    "grain_size_infrared": _make_goniophotometer_input("grain_size_um"),
    "facetness": _make_goniophotometer_input("facetness"),
    "sand": _make_goniophotometer_input("incidence_deg", labels={"incidence_deg": (60,)}),
}
"""Inputs of the trends of BRDFs.  Values are in the order of the papers: grain sizes from coarse to
fine, facetness from low to high."""

ANISOTROPY_INPUTS = {"directions": _make_goniophotometer_input("interpretation", "saturation")}
"""Input of the comparison with measured directions: interpretations of wet sand."""

LAYER_INPUTS = {
    "lens": StudyInput(instrument="lens"),
    "volume": _make_goniophotometer_input(
        "medium", labels={"medium": ("surface only", "surface and volume")}
    ),
    "slope_correlation": _make_goniophotometer_input("surface"),
    "polarization": _make_goniophotometer_input("polarized"),
    "multiple_reflection": _make_goniophotometer_input("polarized"),
    "band_limit": StudyInput(("surface",)),
}
"""Inputs of the statements on rough layers."""

SURFACE_AREA_INPUTS = {
    "spectra": StudyInput(
        ("specific_surface_area_m2_kg", "incidence_deg"), band_nm=(700.0, 2400.0)
    ),
    "field": StudyInput(("specific_surface_area_m2_kg", "medium"), at_nm=(1310.0,)),
}
"""Inputs of the retrieval of the specific surface area of snow from measured spectra."""
