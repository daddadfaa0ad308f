"""Model of the instrument for the albedo of the snowpacks of a file."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator

from splits.core.validation import check_choice, invalid
from splits.experiments.config.instrument import SpectralInstrument, WavelengthGrid
from splits.illumination.bands import as_bands
from splits.illumination.sky import CLEAR_SKY, list_sky_names
from splits.media.medium import Medium

SKIES = (CLEAR_SKY, *list_sky_names())


def _check_bands(bands: Any) -> Any:
    as_bands(bands)
    return bands


class Albedo(SpectralInstrument):
    """Albedo of the snowpacks of a file under skies, for their zenith angles of the sun."""

    FIGURES: ClassVar = ("season",)

    kind: Literal["albedo"]
    wavelength_nm: WavelengthGrid | tuple[float, ...] = WavelengthGrid(
        start=300, stop=2490, step=10
    )
    """vacuum wavelengths (nm), increasing, by default 300 to 2490 in steps of 10"""
    sky: Annotated[str, AfterValidator(lambda x: check_choice("", x, SKIES))] = CLEAR_SKY
    """sky, see `splits.sky`: `clear`, or one of the skies of SNICAR"""
    bands: Annotated[dict[str, tuple[float, float]] | str | None, AfterValidator(_check_bands)] = (
        None
    )
    """limits of bands (nm) by name, or the name of a sensor; the broadband albedo is always
    computed"""

    def check_medium(self, medium: Medium) -> None:
        """Reject a medium other than a file of snowpacks."""
        hint = "splits.albedo accepts other media in Python"
        raise invalid("medium.kind", medium.kind, "snow_packs for instrument.kind = 'albedo'", hint)
