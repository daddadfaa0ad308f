"""Spectral irradiance of skies on a horizontal surface: direct sunlight and diffuse light."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from splits.core.arrays import ContentEquality, check_array_range
from splits.core.declarations import Quantity
from splits.core.keywords import declare_function
from splits.core.optional import import_optional
from splits.core.validation import (
    InvalidValue,
    check_range,
    check_relations,
    invalid,
    suggest_name,
)
from splits.illumination.bands import SpectralBand, as_bands, interpolate_locally
from splits.materials.csv_table import (
    is_csv_path,
    read_numeric_csv,
    read_tabulated_function,
    to_columns,
)
from splits.materials.refractive_index import check_wavelength_range

SKY_COLUMNS = ("wavelength_nm", "direct", "diffuse")
BROADBAND = "broadband"
MAX_ZENITH_DEG = 89.0


@dataclass(frozen=True, eq=False, repr=False)
class Sky(ContentEquality):
    """Light on a horizontal surface.

    Attributes
    ----------
    name, source : str
    zenith_deg : float
        Polar angle of the sun.
    wavelength_nm : float, shape (n,)
        Strictly increasing (nm).
    direct, diffuse : float, shape (n,)
        Spectral irradiance (W m⁻² nm⁻¹); for albedos only ratios matter.
    relative : bool
        Whether irradiances are in arbitrary units.
    sha256 : str
        SHA-256 of a user's file, otherwise empty.
    """

    name: str
    source: str
    zenith_deg: float
    wavelength_nm: np.ndarray
    direct: np.ndarray
    diffuse: np.ndarray
    sha256: str = ""
    relative: bool = False

    def __post_init__(self) -> None:
        put = partial(object.__setattr__, self)
        zenith = check_range("zenith_deg", self.zenith_deg, 0.0, MAX_ZENITH_DEG, "degrees")
        put("zenith_deg", zenith)
        columns = {key: getattr(self, key) for key in SKY_COLUMNS}
        spectra, _ = read_tabulated_function("sky", columns, SKY_COLUMNS)
        for key, values in zip(SKY_COLUMNS, spectra, strict=True):
            put(key, check_array_range(f"sky.{key}", values, 0.0, np.inf))
        if not self.total.any():
            raise invalid("sky", "0 everywhere", "light at some wavelength")

    def __repr__(self) -> str:
        """Return the sky on one line."""
        first, last = self.wavelength_nm[[0, -1]]
        limits = f"{first:g} to {last:g} nm"
        return f"Sky({self.name!r}, zenith_deg={self.zenith_deg:g}, {limits}: {self.source})"

    @property
    def total(self) -> np.ndarray:
        """Sum of direct and diffuse irradiance."""
        return self.direct + self.diffuse

    def scale_to(self, total_w_m2: float | None) -> Sky:
        """Return this sky scaled to an irradiance over all its wavelengths (W m⁻²).

        Raises
        ------
        ValueError
            If the irradiance is out of range, or missing for a sky in relative units.
        """
        if total_w_m2 is None:
            if self.relative:
                hint = f"irradiances of {self.name} are relative"
                raise invalid(
                    "total_w_m2", None, "given: the irradiance of all light (W m-2)", hint
                )
            return self
        total = check_range("total_w_m2", total_w_m2, 0.0, 1e5, "W m-2", open_low=True)
        weights = self.compute_weights(self.wavelength_nm, self.make_bands(None)[BROADBAND])
        factor = total / weights.sum()
        return replace(
            self, direct=factor * self.direct, diffuse=factor * self.diffuse, relative=False
        )

    def check_coverage(self, wavelength_nm: np.ndarray) -> None:
        """Check that wavelengths (nm) are within the spectrum of this sky."""
        first, last = self.wavelength_nm[[0, -1]]
        check_wavelength_range(wavelength_nm, first, last, f"the sky {self.name}")

    def compute_direct_fraction(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the fraction of direct sunlight by wavelength (nm)."""
        self.check_coverage(wavelength_nm)
        direct, total = (
            np.interp(wavelength_nm, self.wavelength_nm, values)
            for values in (self.direct, self.total)
        )
        # Without light the fraction has no effect.
        return np.divide(direct, total, out=np.zeros_like(total), where=total > 0.0)

    def make_bands(self, bands: Any) -> dict[str, SpectralBand]:
        """Return the bands of a user's value, after the broadband one.

        Raises
        ------
        ValueError
            For a malformed band, or one with the name of the broadband one.
        """
        user_bands = as_bands(bands)
        if BROADBAND in user_bands:
            raise invalid(
                f"bands.{BROADBAND}",
                user_bands[BROADBAND].limits_nm,
                "left out: it is always included",
            )
        return {BROADBAND: SpectralBand.from_limits(*self.wavelength_nm[[0, -1]]), **user_bands}

    def check_bands(self, bands: Mapping[str, SpectralBand], wavelength_nm: np.ndarray) -> None:
        """Check that all bands have light within the wavelengths (nm)."""
        for name, band in bands.items():
            if not self.compute_weights(wavelength_nm, band).any():
                first, last = wavelength_nm[[0, -1]]
                allowed = f"bands with light between {first:g} and {last:g} nm"
                hint = "give more wavelengths, or only some bands of a sensor"
                raise invalid(f"bands.{name}", band.limits_nm, allowed, hint)

    def compute_weights(
        self, wavelength_nm: np.ndarray, band: SpectralBand, n_nodes: int = 2
    ) -> np.ndarray:
        """Return the irradiance of a band by wavelength (nm), as weights for an average.

        An albedo is assumed to be 0 outside the wavelengths, and between them the polynomial
        through the nearest ones, 2 for a linear one.  Weights are the integrals of irradiance times
        response times the weights of these polynomials.
        """
        low, high = band.limits_nm
        nodes = np.concatenate([wavelength_nm, self.wavelength_nm, band.wavelength_nm])
        inside = (nodes >= max(low, wavelength_nm[0])) & (nodes <= min(high, wavelength_nm[-1]))
        nodes = np.unique(nodes[inside])
        if nodes.size < 2 or wavelength_nm.size < 2:
            return np.zeros(wavelength_nm.size)
        # Where all three factors are linear between nodes, Simpson's rule is exact.
        nodes = np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
        step = nodes[2::2] - nodes[:-2:2]
        simpson = np.zeros(nodes.size)
        for points, coefficient in (
            (slice(0, -2, 2), 1.0),
            (slice(1, -1, 2), 4.0),
            (slice(2, None, 2), 1.0),
        ):
            simpson[points] += coefficient * step / 6.0
        integrand = simpson * np.interp(nodes, self.wavelength_nm, self.total)
        integrand *= np.interp(nodes, band.wavelength_nm, band.response)
        return np.asarray(integrand @ interpolate_locally(wavelength_nm, nodes, n_nodes))


# --------------------------------------------------------------------------------------------------
# Spectra of skies: tables of SNICAR, clear skies, the ASTM standard, and those of users.

CLOUDY_SUFFIX = "_cloudy"
"""Suffix of the names of skies whose light is all diffuse."""
CLEAR_SKY = "clear"
ASTM_G173 = "astm_g173"
SNICAR_ZENITH_DEG = 60.0
"""Polar angle of the sun in the clear skies of SNICAR."""
ZENITH_REQUIREMENT = "given: the polar angle of the sun in degrees"
ASTM_ZENITH_DEG, ASTM_TILT_DEG = 48.19, 37.0
"""Polar angle of the sun, and tilt of the surface, in ASTM G173."""
ATMOSPHERE = {
    "pressure_pa": 101_325.0,
    "precipitable_water_cm": 1.0,
    "ozone_atm_cm": 0.3,
    "turbidity_500nm": 0.1,
    "ground_albedo": 0.8,
}
"""Default parameters of a clear sky other than the sun."""

SunZenith = Annotated[
    float | None,
    Quantity("polar angle of the sun", "degree", low=0.0, high=MAX_ZENITH_DEG),
]
Pressure = Annotated[float | None, Quantity("air pressure", "Pa", low=3e4, high=1.1e5)]
WaterColumn = Annotated[float | None, Quantity("precipitable water", "cm", low=0.0, high=10.0)]
OzoneColumn = Annotated[float | None, Quantity("column of ozone", "atm cm", low=0.0, high=1.0)]
Turbidity = Annotated[
    float | None, Quantity("optical thickness of the aerosol at 500 nm", low=0.0, high=2.0)
]
GroundAlbedo = Annotated[
    float | None,
    Quantity("albedo of the ground, whose light the sky scatters back", low=0.0, high=1.0),
]


@cache
def _load_snicar_skies() -> pd.DataFrame:
    return read_numeric_csv("skies", Path(__file__).with_name("skies.csv"))


def list_sky_names() -> tuple[str, ...]:
    """Return the names of the skies that need no other arguments."""
    return tuple(name for name in _load_snicar_skies().columns if name != "wavelength_nm")


@declare_function
def sky(
    spectrum: Any = "midlatitude_winter",
    zenith_deg: SunZenith = None,
    *,
    pressure_pa: Pressure = None,
    precipitable_water_cm: WaterColumn = None,
    ozone_atm_cm: OzoneColumn = None,
    turbidity_500nm: Turbidity = None,
    ground_albedo: GroundAlbedo = None,
) -> Sky:
    """Return the spectral irradiance of a sky.

    Parameters
    ----------
    spectrum : str, mapping, DataFrame or path
        One of the skies of SNICAR, see `list_sky_names`: clear ones, for which all light counts as
        direct and the spectrum is that of the sun at 60°, or cloudy ones, all diffuse.  ``"clear"``
        is a clear sky for any position of the sun and ``"astm_g173"`` the standard of that name;
        both need pvlib (extra ``sky``).  Or a mapping of ``wavelength_nm``, ``direct`` and
        ``diffuse`` (W m⁻² nm⁻¹), lists; a DataFrame with these columns, or the path of a CSV file.
    zenith_deg : float, optional
        Polar angle of the sun, 0 to 89 degrees.  Skies of SNICAR have 60 by default, and
        ``astm_g173`` is for 48.19 only; other skies with direct light require it.
    pressure_pa, precipitable_water_cm, ozone_atm_cm : float, optional
        State of the atmosphere, for ``"clear"`` only (Bird & Riordan 1986); `ATMOSPHERE` contains
        the defaults.
    turbidity_500nm, ground_albedo : float, optional
        For ``"clear"`` only: optical thickness of the aerosol, and albedo of the ground, whose
        light the sky scatters back; 0.8 by default, for snow.

    Raises
    ------
    ValueError
        For an unknown name, a malformed table or a value outside its range.
    TypeError
        For an unknown keyword.
    ModuleNotFoundError
        Without pvlib where it is needed.
    """
    spectrum = to_columns(spectrum)
    # The comparison of an array with a string gives an array.
    name = spectrum if isinstance(spectrum, str) else ""
    given = (pressure_pa, precipitable_water_cm, ozone_atm_cm, turbidity_500nm, ground_albedo)
    named = zip(ATMOSPHERE, given, strict=True)
    atmosphere = {key: value for key, value in named if value is not None}
    key = "zenith_deg"
    check_relations(
        (
            name != ASTM_G173 or zenith_deg is None, key, zenith_deg, "left out",
            f"{ASTM_G173} is for {ASTM_ZENITH_DEG}°",
        ),
        (
            name != CLEAR_SKY or zenith_deg is not None, key, None, ZENITH_REQUIREMENT,
            f'splits.sky("{CLEAR_SKY}", zenith_deg=50)',
        ),
        *(
            (name == CLEAR_SKY, own, value, "left out", f"it applies to the sky {CLEAR_SKY} only")
            for own, value in atmosphere.items()
        ),
    )  # fmt: skip
    if name == CLEAR_SKY and zenith_deg is not None:
        # After Bird & Riordan (1986).
        parameters = ATMOSPHERE | atmosphere
        compute_air_mass = import_optional(
            "pvlib.atmosphere", "sky", "clear skies need"
        ).get_relative_airmass
        spectra = import_optional("pvlib.spectrum", "sky", "clear skies need").spectrl2(
            apparent_zenith=zenith_deg,
            aoi=zenith_deg,
            surface_tilt=0.0,
            ground_albedo=parameters["ground_albedo"],
            surface_pressure=parameters["pressure_pa"],
            relative_airmass=compute_air_mass(zenith_deg, model="kasten1966"),
            precipitable_water=parameters["precipitable_water_cm"],
            ozone=parameters["ozone_atm_cm"],
            aerosol_turbidity_500nm=parameters["turbidity_500nm"],
            dayofyear=80,
        )
        direct, diffuse = (np.ravel(spectra[key]) for key in ("dni", "dhi"))
        direct = np.maximum(direct, 0.0) * np.cos(np.radians(zenith_deg))
        description = ", ".join(f"{name} {value:g}" for name, value in parameters.items())
        source = f"Bird & Riordan (1986), by pvlib: {description}"
        wavelengths = np.ravel(spectra["wavelength"])
        return Sky(CLEAR_SKY, source, zenith_deg, wavelengths, direct, np.maximum(diffuse, 0.0))
    if name == ASTM_G173:
        # The standard gives the beam, and the light on a surface tilted towards the sun; the
        # difference is taken as diffuse.
        spectrum = import_optional("pvlib.spectrum", "sky", "the standard sky needs")
        table = spectrum.get_reference_spectra(standard="ASTM G173-03")
        beam, tilted = table["direct"].to_numpy(), table["global"].to_numpy()
        cos_tilted = np.cos(np.radians(ASTM_ZENITH_DEG - ASTM_TILT_DEG))
        diffuse = np.maximum(tilted - beam * cos_tilted, 0.0)
        direct = beam * np.cos(np.radians(ASTM_ZENITH_DEG))
        wavelengths = table.index.to_numpy(dtype=float)
        return Sky(
            ASTM_G173, "ASTM G173-03, by pvlib", ASTM_ZENITH_DEG, wavelengths, direct, diffuse
        )
    polar_angle = SNICAR_ZENITH_DEG if zenith_deg is None else zenith_deg
    if isinstance(spectrum, Mapping | Path) or is_csv_path(name):
        columns, digest = read_tabulated_function("sky", spectrum, SKY_COLUMNS)
        name = "table" if isinstance(spectrum, Mapping) else Path(spectrum).name
        wavelengths, direct, diffuse = columns
        user_sky = Sky(name, "given by the user", polar_angle, wavelengths, direct, diffuse)
        if zenith_deg is None and user_sky.direct.any():
            hint = "splits.sky(…, zenith_deg=50): this sky has direct light"
            raise invalid(key, None, ZENITH_REQUIREMENT, hint)
        content = np.stack([user_sky.wavelength_nm, user_sky.direct, user_sky.diffuse])
        return replace(user_sky, sha256=digest or hashlib.sha256(content.tobytes()).hexdigest())
    if name not in list_sky_names():
        raise _make_sky_error("sky", spectrum)
    table = _load_snicar_skies()
    irradiance = table[name].to_numpy()
    light = (irradiance, np.zeros_like(irradiance))
    return Sky(
        name,
        "SNICAR-ADv3 (Flanner et al. 2021)",
        polar_angle,
        table["wavelength_nm"].to_numpy(),
        *(light[::-1] if name.endswith(CLOUDY_SUFFIX) else light),
        relative=True,
    )


def _make_sky_error(key: str, value: object) -> InvalidValue:
    """Return the error of a value that is no sky."""
    known = [*list_sky_names(), CLEAR_SKY, ASTM_G173]
    allowed = "one of " + ", ".join(known) + ", a mapping or a .csv file"
    return invalid(key, value, allowed, suggest_name(value, known))


def _check_sky(key: str, value: Any) -> Any:
    """Return a sky of a user after checking its name, if it is one."""
    known = (*list_sky_names(), CLEAR_SKY, ASTM_G173)
    is_other = not (isinstance(to_columns(value), Sky | Mapping | Path) or callable(value))
    if is_other and not (isinstance(value, str) and (value in known or is_csv_path(value))):
        raise _make_sky_error(key, value)
    return value


SkyInput = Annotated[
    Sky | str | Mapping[str, Any] | Callable[[float], Sky],
    Quantity(
        "sky: clear, or one of the skies of SNICAR, see `splits.sky`",
        check=_check_sky, schema={"type": ["string", "object"]},
    ),
]  # fmt: skip
