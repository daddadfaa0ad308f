"""Surface area of snow from spectra: known values are retrieved, with errors and flags."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.analysis.theory.spectra import kz04
from workflow.papers.surface_area import (
    AREA,
    FIELD_WAVELENGTH_NM,
    FIT_WINDOWS_NM,
    PUBLISHED_ALBEDO_LAWS,
    draw_area_law,
    draw_fitted_spectra,
    fit_surface_area,
    is_in_windows,
    make_field_table,
    make_overlay_table,
    retrieve_surface_areas,
)

AREAS = np.array([2.5, 4.0, 6.0, 9.0, 13.0, 20.0, 30.0, 45.0, 70.0])
WAVELENGTHS = np.arange(600.0, 2401.0, 20.0)
N_BATCHES = 8


def compute_reflectance(areas=AREAS, wavelengths=WAVELENGTHS):
    """Return reflectance by asymptotic theory."""
    return np.stack([kz04(wavelengths, area).reflectance.values for area in areas])


def make_dataset(angles=(30.0, 60.0), noise=0.0, seed=1):
    """Return a dataset as of an experiment, with batch deviations of the given noise."""
    exact = compute_reflectance()
    random = np.random.default_rng(seed)
    batches = noise / np.sqrt(N_BATCHES) * random.normal(size=(N_BATCHES, *exact.shape))
    dims, spectrum_dims = (AREA, "incidence_deg", "wavelength"), (AREA, "wavelength")
    table = xr.Dataset(
        {
            "reflectance": (spectrum_dims, exact + batches.sum(axis=0)),
            "reflectance_stderr": (spectrum_dims, np.sqrt((batches**2).sum(axis=0))),
            "reflectance_batches": (("batch", *spectrum_dims), batches),
        },
        {AREA: AREAS, "wavelength": WAVELENGTHS},
    )
    return table.expand_dims(incidence_deg=list(angles)).transpose("batch", *dims)


def make_measured(**areas):
    """Return spectra of the given areas at 60° and other wavelengths, 10 % too bright."""
    wavelengths = np.arange(400.0, 2501.0, 5.0)
    columns = {
        f"{name}@60": 1.1 * compute_reflectance([area], wavelengths)[0]
        for name, area in areas.items()
    }
    return pd.DataFrame({"wavelength_nm": wavelengths, **columns})


@pytest.mark.parametrize("area", [2.5, 5.0, 17.3, 60.0, 70.0])
def test_known_surface_areas_are_retrieved(area):
    fit = fit_surface_area(AREAS, compute_reflectance(), 0.9 * compute_reflectance([area])[0])
    assert fit.area == pytest.approx(area, rel=2e-3)
    assert fit.scale == pytest.approx(0.9, rel=1e-3)
    assert fit.rmse < 1e-3


def test_a_spectrum_outside_the_grid_is_flagged():
    table = retrieve_surface_areas(make_dataset(), make_measured(inside=20.0, outside=150.0))
    flags = table.set_index(["spectrum", "window"]).at_the_end
    assert not flags["inside@60"].any() and flags["outside@60"]["all"]


def test_stated_errors_match_the_scatter_between_runs():
    spectra = make_measured(one=16.0)
    tables = [
        retrieve_surface_areas(make_dataset(noise=0.001, seed=seed), spectra) for seed in range(60)
    ]
    for window in FIT_WINDOWS_NM:
        rows = [table[table.window == window].iloc[0] for table in tables]
        for name in ("area", "scale"):
            values = np.array([row[name] for row in rows])
            stated = np.sqrt(np.mean([row[f"{name}_stderr"] ** 2 for row in rows]))
            # With 60 runs and 8 batches the standard error of the ratio is 0.1.
            assert 0.7 < values.std(ddof=1) / stated < 1.3, (window, name)


def test_errors_without_batches_bound_all_errors_of_the_model():
    """As of discrete ordinates, whose errors are correlated in an unknown way."""
    spectra, random = make_measured(one=16.0), np.random.default_rng(4)
    table = make_dataset()
    table["reflectance_stderr"] = table.reflectance_stderr + 0.001
    stated = retrieve_surface_areas(table, spectra).set_index("window")
    signs = [1.0, -1.0, *random.choice([-1.0, 1.0], (20, WAVELENGTHS.size)),
             np.sign(WAVELENGTHS - 1000.0), np.sign(WAVELENGTHS - 1500.0)]  # fmt: skip
    for sign in signs:
        changed = table.assign(
            reflectance=table.reflectance + 0.001 * sign,
            reflectance_stderr=0.0 * table.reflectance_stderr,
        )
        result = retrieve_surface_areas(changed, spectra).set_index("window")
        for name in ("area", "scale"):
            change = np.abs(result[name] - stated[name])
            assert (change <= 1.05 * stated[f"{name}_stderr"]).all()
            assert (result[f"{name}_stderr"] == 0.0).all()
    assert (stated.area_stderr < 1.0).all() and (stated.scale_stderr < 0.01).all()


def test_overlay_has_the_fitted_scale_and_wavelengths():
    dataset, spectra = make_dataset(), make_measured(a=16.0)
    table = make_overlay_table(dataset, spectra, retrieve_surface_areas(dataset, spectra))
    assert list(table.wavelength_nm) == list(WAVELENGTHS)
    used = table[table.fitted]
    assert used.difference.abs().max() < 2e-3
    assert set(used.wavelength_nm) == set(
        WAVELENGTHS[is_in_windows(WAVELENGTHS, FIT_WINDOWS_NM["all"])]
    )
    assert not table.fitted[table.wavelength_nm == 1400.0].any()
    assert draw_fitted_spectra(table).axes


def test_a_spectrum_at_a_missing_angle_is_rejected():
    with pytest.raises(ValueError, match=r"column = 'a@60': must be .* ends with @10 or @20"):
        retrieve_surface_areas(make_dataset([10.0, 20.0]), make_measured(a=16.0))


def test_published_laws_are_listed_with_the_model():
    values = {
        name: ((AREA, "wavelength"), np.full((AREAS.size, 1), value))
        for name, value in {"reflectance": 0.3, "reflectance_stderr": 0.01}.items()
    }
    dataset = xr.Dataset(values, {AREA: AREAS, "wavelength": [FIELD_WAVELENGTH_NM]})
    table = make_field_table({"spheres": dataset})
    assert list(dict.fromkeys(table.snow)) == ["spheres", *PUBLISHED_ALBEDO_LAWS]
    law = table[table.snow == next(iter(PUBLISHED_ALBEDO_LAWS))]
    assert law.reflectance.is_monotonic_increasing and law.stderr.isna().all()
    assert draw_area_law(table).axes
