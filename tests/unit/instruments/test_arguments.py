"""Invalid arguments of instruments: one message, and no errors from internal functions."""

from __future__ import annotations

import re

import pytest

import splits
from splits.simulation.spectral_tally import estimate_fixed_budget

WAVES = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "correlation": "gaussian"}
ROUGH = splits.ParticleLayer(surface=WAVES, depth_m=10.0)
INSTRUMENT_CALLS = {
    "spectrophotometer": lambda medium: splits.spectrophotometer(medium, [600]),
    "goniophotometer": lambda medium: splits.goniophotometer(medium, [600]),
    "beam_spread": lambda medium: splits.beam_spread(medium, [600]),
    "fixed_spectrum": lambda medium: estimate_fixed_budget(medium, [600], 0.0, [0], 1, 1),
    "single_scattering": lambda medium: splits.single_scattering(medium, [600]),
    "lens": lambda medium: splits.lens(medium, [1.0], 0.1, half_width_m=1.0),
    "surface_map": lambda medium: splits.surface_map(medium, 1.0),
}
SURFACE_CALLS = ("lens", "surface_map")


@pytest.mark.parametrize(
    "medium", ["snow", "layer", splits.Snow, splits.ParticleLayer, None, [600], 5]
)
@pytest.mark.parametrize("instrument", INSTRUMENT_CALLS)
def test_objects_other_than_media_are_rejected(instrument, medium):
    allowed = "ParticleLayer" if instrument in SURFACE_CALLS else "Snow"
    text = medium.__name__ if isinstance(medium, type) else repr(medium)
    message = re.escape(f"medium = {text}: must be splits.{allowed}(...)")
    with pytest.raises(ValueError, match=f"^{message}"):
        INSTRUMENT_CALLS[instrument](medium)


@pytest.mark.parametrize(
    ("instrument", "medium"),
    [
        ("single_scattering", ROUGH),
        *((name, medium) for name in SURFACE_CALLS for medium in (splits.Snow(), splits.Sand())),
    ],
)
def test_unsupported_media_are_rejected(instrument, medium):
    with pytest.raises(ValueError, match=f"^medium = '{medium.kind}': must be splits"):
        INSTRUMENT_CALLS[instrument](medium)


@pytest.mark.parametrize("medium", ["snow", "Snow", "snwo", splits.Snow])
def test_misspelt_media_get_a_suggestion(medium):
    with pytest.raises(ValueError, match=re.escape("(did you mean splits.Snow()?)")):
        splits.spectrophotometer(medium, [600])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: splits.lens(ROUGH, [1.0], 0.1),
         r"^half_width_m = None: must be given \(m\) \(half the side of the square searched"),
        (lambda: splits.goniophotometer(splits.Snow(), [600], rays=1e5),
         r"^rays = 100000\.0: must be a whole number of at least 1 \(write 100000\)"),
        (lambda: splits.spectrophotometer(splits.Snow(), [[400, 500]]),
         r"^wavelength_nm = \[\[400, 500\]\]: must be one row of numbers"),
        (lambda: splits.spectrophotometer(splits.Snow(), [600], "difuse"),
         r"^incidence_deg = 'difuse': must be an angle .*did you mean diffuse"),
        (lambda: splits.ParticleLayer(surface={"rms_height_m": 1.0, "wave_number_per_m": 1.0}),
         r"^surface\.band_limit_per_m = None: must be given .*default correlation"),
    ],
)  # fmt: skip
def test_missing_and_misspelt_arguments_get_a_hint(call, message):
    with pytest.raises(ValueError, match=message):
        call()
