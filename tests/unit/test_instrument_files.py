"""Instruments are found by their files, and listed for type checkers in the stub."""

import subprocess
import sys

import pytest

import splits
import splits.instruments
from splits.core import discovery

NEW_INSTRUMENT = '''"""Number of layers of a medium."""

from __future__ import annotations

import xarray as xr

from splits.core.keywords import declare_function
from splits.media.medium import Medium


@declare_function
def layer_counter(medium: Medium) -> xr.Dataset:
    """Count the layers of a medium."""
    return xr.Dataset({"layers": len(medium.scene_layers)})
'''


def test_the_stub_lists_all_instruments():
    names = set(discovery.list_instrument_names())
    assert names < set(splits.__all__)
    assert {name for name in splits.__all__ if discovery.is_instrument(name)} == names


def test_a_new_file_is_an_instrument(tmp_path, monkeypatch):
    (tmp_path / "layer_counter.py").write_text(NEW_INSTRUMENT, encoding="utf-8")
    monkeypatch.setattr(discovery, "FOLDER", tmp_path)
    monkeypatch.setattr(
        splits.instruments, "__path__", [*splits.instruments.__path__, str(tmp_path)]
    )
    discovery.list_instrument_names.cache_clear()
    try:
        assert "layer_counter" in dir(splits)
        assert splits.layer_counter(splits.Snow()).layers == 1
        with pytest.raises(TypeError, match="medum: unknown key"):
            splits.layer_counter(medum=splits.Snow())
    finally:
        sys.modules.pop("splits.instruments.layer_counter", None)
        discovery.list_instrument_names.cache_clear()


SPECTRUM = "splits.spectrophotometer(splits.Snow.natural(optical_radius_um=100), [500, 900])"


@pytest.mark.parametrize(
    ("use", "module"),
    [
        ("dir(splits)", "splits.instruments"),
        ("splits.albedo", "splits.instruments.lens"),
        (SPECTRUM, "numba"),
    ],
)
def test_only_what_is_used_is_imported(use, module):
    program = f"import sys, splits; {use}; print('{module}' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert result.stdout.strip() == "False", result.stderr


@pytest.mark.parametrize("name", ["scene_layers", "make_grain_population", "list_interfaces"])
def test_names_of_media_are_those_that_users_need(name):
    snow = splits.Snow()
    assert name not in dir(snow) and hasattr(snow, name)
    assert {"density_kg_m3", "optical_radius_um", "porosity", "describe"} < set(dir(snow))
    assert {"polarized", "single_scattering_albedo"} < set(dir(splits.ParticleLayer()))
