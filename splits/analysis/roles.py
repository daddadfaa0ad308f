"""What each analysis needs: the roles that experiments of a study play in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Role:
    """What an experiment must be to play a role.

    Attributes
    ----------
    over : tuple of str
        Parameters of its grid: these and no others.
    labels : mapping
        Values that its grid must hold, by parameter.
    at_nm, band_nm : tuple of float
        Wavelengths that it must hold, and the ends of a range that it must cover (nm).
    instrument : str
    """

    axes: tuple[str, ...] = ()
    labels: Mapping[str, tuple[float | str, ...]] = field(default_factory=dict)
    at_nm: tuple[float, ...] = ()
    band_nm: tuple[float, ...] = ()
    instrument: str = "spectrophotometer"


def _directions(*over: str, **needs: object) -> Role:
    return Role(over, instrument="goniophotometer", **needs)  # type: ignore[arg-type]


_VISIBLE = (400.0, 700.0)
_SAND = (400.0, 1000.0)

SENSITIVITY_DEPTHS: Mapping[str, tuple[float | str, ...]] = {"depth_m": (0.12, 0.02)}
"""Depths for reflectance and transmittance, see `splits.analysis.sensitivity_tables.QUANTITIES`."""

SNOW = {
    "sample": Role(("density_kg_m3",), {"density_kg_m3": (450,)}),
    "thick_transmittance": Role(band_nm=(400.0, 1000.0)),
    "grain_size": Role(("grain_size_um",), band_nm=(400.0, 2500.0),
                       at_nm=(1500.0, 1800.0, 2000.0, 2250.0, 2500.0)),
    "facetness": Role(("facetness",), band_nm=(700.0, 1300.0)),
    "density": Role(("density_kg_m3",), {"density_kg_m3": (300, 450)}),
    "depth": Role(("depth_m",), at_nm=(1030.0,), band_nm=_VISIBLE),
    "grain_size_transmittance": Role(("grain_size_um",), band_nm=_VISIBLE),
    "saturation_transmittance": Role(("saturation",), band_nm=(400.0, 1450.0)),
    "density_transmittance": Role(("density_kg_m3",), at_nm=(1420.0,), band_nm=_VISIBLE),
    "aviris": Role(at_nm=(842.25, 1073.76, 1237.93)),
    "letcher": Role(("medium", "depth_m", "incidence_deg"),
                    {"depth_m": (0.34, 0.045), "incidence_deg": ("beam", "diffuse")}),
    "readings": Role(("readings",), at_nm=(842.25, 1073.76, 1237.93)),
}  # fmt: skip
"""Roles of the agreement with SPLITSnow."""

SAND = {
    "samples": Role(("medium",), band_nm=_SAND),
    "wet_colours": Role(("medium", "saturation"), band_nm=(400.0, 780.0)),
    "colours": Role(("medium",), band_nm=(400.0, 780.0)),
    "iron_oxide": Role(("iron_oxide",), band_nm=_SAND),
    "hematite_ratio": Role(("hematite_ratio",), band_nm=(480.0, 700.0)),
    "magnetite": Role(("magnetite",), band_nm=_SAND),
    "texture": Role(("texture",), band_nm=_SAND),
    "fine_fraction": Role(("texture",), band_nm=(400.0, 500.0)),
    "mineral_weight": Role(("medium", "refractive_index"), {"refractive_index": ("as modelled",)}),
    "readings": Role(("medium", "readings"), {"readings": ("default",)}),
    "size_tail": Role(("medium", "size_tail"), {"size_tail": (1e-4,)}),
}
"""Roles of the trends of SPLITS."""

ANGULAR = {
    "incidence": _directions("incidence_deg", labels={"incidence_deg": (0,)}),
    "grazing": _directions("incidence_deg"),
    "wavelength": _directions(at_nm=(600.0, 1800.0)),
    "grain_size": _directions("grain_size_um"),
    "grain_size_uniform": _directions("grain_size_um"),
    "grain_size_infrared": _directions("grain_size_um"),
    "facetness": _directions("facetness"),
    "sand": _directions("incidence_deg", labels={"incidence_deg": (60,)}),
}
"""Roles of the trends of BRDFs; a grid's finest or least faceted grains stand as the papers have
them, grain sizes from coarse to fine and facetness from low to high."""

ANISOTROPY = {"directions": _directions("readings", "saturation")}
"""Role of directions held against measured ones: models of wet sand, and samples."""

LAYER = {
    "lens": Role(instrument="lens"),
    "volume": _directions("medium", labels={"medium": ("surface only", "surface and volume")}),
    "slope_correlation": _directions("surface"),
    "polarization": _directions("polarized"),
    "multiple_reflection": _directions("polarized"),
    "band_limit": Role(("surface",)),
}
"""Roles of what is stated of rough layers."""

SURFACE_AREA = {
    "spectra": Role(("specific_surface_area_m2_kg", "incidence_deg"), band_nm=(700.0, 2400.0)),
    "field": Role(("specific_surface_area_m2_kg", "medium"), at_nm=(1310.0,)),
}
"""Roles of the surface area of snow from measured spectra."""
