"""Scattering matrices as inputs: forms, expansions, and messages."""

import time

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits import ParticleLayer
from splits.core.validation import InvalidValue
from splits.kernels.phase_function import evaluate_scattering_ratios
from splits.kernels.scattering_matrix import make_rayleigh
from splits.media.particle_layer import COEFFICIENTS, ELEMENTS, ScatteringMatrix, sum_expansion

ANGLE = np.linspace(0.0, 180.0, 91)
MU = np.cos(np.radians(ANGLE))
RAYLEIGH = {
    "angle_deg": ANGLE, "P11": 0.75 * (1.0 + MU**2), "P12": -0.75 * (1.0 - MU**2),
    "P33": 1.5 * MU, "P34": 0.0 * MU,
}  # fmt: skip
EXPANSION = dict(
    zip(
        COEFFICIENTS,
        [[1.0, 0.0, 0.5], [0.0, 0.0, 3.0], [0.0] * 3, [0.0, 1.5, 0.0],
         [0.0, 0.0, np.sqrt(1.5)], [0.0] * 3],
        strict=True,
    )
)  # fmt: skip


def write_libradtran(path, **changes):
    """Write Rayleigh scattering in the form of libRadtran, with decreasing angles."""
    matrix = {**RAYLEIGH, **changes}
    elements = np.stack([matrix[name][::-1] for name in ELEMENTS[:4]])[np.newaxis, np.newaxis]
    dims = ("nlam", "nreff", "nphamat", "nthetamax")
    theta = np.broadcast_to(ANGLE[::-1], elements.shape)
    dataset = xr.Dataset({
        "theta": (dims, theta.astype("f4")), "phase": (dims, elements.astype("f4")),
        "ntheta": (dims[:3], np.full((1, 1, 4), ANGLE.size)),
    })  # fmt: skip
    dataset.to_netcdf(path)
    return dataset


def test_all_forms_are_the_same_matrix(tmp_path):
    frame = pd.DataFrame(RAYLEIGH)
    frame.to_csv(tmp_path / "matrix.csv", index=False)
    pd.DataFrame(EXPANSION).to_csv(tmp_path / "expansion.csv", index=False)
    dataset = write_libradtran(tmp_path / "matrix.nc")
    forms = [
        RAYLEIGH, frame, frame[::-1], frame.set_index("angle_deg"), tmp_path / "matrix.csv",
        tmp_path / "matrix.nc", str(tmp_path / "matrix.nc"), dataset, EXPANSION,
        tmp_path / "expansion.csv", xr.Dataset.from_dataframe(frame.set_index("angle_deg")),
    ]  # fmt: skip
    for form in forms:
        matrix = ScatteringMatrix.from_input(form)
        for column, name in enumerate(ELEMENTS):
            expected = RAYLEIGH.get(name, RAYLEIGH["P33" if name == "P44" else "P11"])
            found = np.interp(ANGLE, matrix.angle_deg, matrix.elements[:, column])
            assert found == pytest.approx(expected, abs=2e-6)


def test_libradtran_has_the_opposite_sign_of_circular_polarization(tmp_path):
    p33 = 0.8 * RAYLEIGH["P33"]
    p34 = 0.2 * p33 * np.sin(np.radians(ANGLE)) ** 2
    dataset = write_libradtran(tmp_path / "matrix.nc", P33=p33, P34=p34)
    matrix = ScatteringMatrix.from_input(dataset)
    found = np.interp(ANGLE, matrix.angle_deg, matrix.elements[:, ELEMENTS.index("P34")])
    assert found == pytest.approx(-p34, abs=2e-6)


def test_tabulated_rayleigh_scattering_has_the_analytic_ratios():
    layer = ParticleLayer(scattering_matrix=EXPANSION)
    analytic, table = make_rayleigh(), layer.kernel_phase_function
    assert table.g == pytest.approx(0.0, abs=1e-6)
    for mu in np.linspace(-1.0, 1.0, 23):
        found, expected = (evaluate_scattering_ratios(one, mu) for one in (table, analytic))
        assert found == pytest.approx(expected, abs=2e-4)


def test_layers_keep_their_matrix():
    layer = ParticleLayer(scattering_matrix=RAYLEIGH)
    again = eval(repr(ParticleLayer(scattering_matrix={
        key: np.round(value[::45], 6) for key, value in RAYLEIGH.items()
    })), {"ParticleLayer": ParticleLayer})  # fmt: skip
    assert again.scattering_matrix.angle_deg.tolist() == [0.0, 90.0, 180.0]
    assert layer == ParticleLayer(scattering_matrix=pd.DataFrame(RAYLEIGH))
    described = layer.describe()
    assert described["phase_function"] == "scattering_matrix"
    assert described["matrix_P12"].tolist() == RAYLEIGH["P12"].tolist()


def test_units_of_matrices_are_arbitrary():
    """Powers of two keep every digit."""
    for scale in (2.0**-300, 2.0**300):
        scaled = {
            key: value if key == "angle_deg" else scale * value for key, value in RAYLEIGH.items()
        }
        one, other = (
            ParticleLayer(scattering_matrix=matrix).kernel_phase_function
            for matrix in (RAYLEIGH, scaled)
        )
        for values, expected in zip(other, one, strict=True):
            assert np.array_equal(values, expected)


def test_many_coefficients_are_summed_by_recurrence():
    """The functions of each order, against Jacobi polynomials, and 1000 orders."""
    special = pytest.importorskip("scipy.special")
    n = 40
    random = np.random.default_rng(1).normal(size=(6, n))
    angle, elements = sum_expansion(random)
    mu, order = np.cos(np.radians(angle)), np.arange(2, n)
    norm = 0.25 * np.sqrt((order + 1.0) * (order + 2.0) / (order * (order - 1.0)))
    d02 = norm * (1.0 - mu[:, None] ** 2) * special.eval_jacobi(order - 2, 2, 2, mu[:, None])
    d22 = (0.5 + 0.5 * mu[:, None]) ** 2 * special.eval_jacobi(order - 2, 0, 4, mu[:, None])
    d2m2 = (0.5 - 0.5 * mu[:, None]) ** 2 * special.eval_jacobi(order - 2, 4, 0, mu[:, None])
    alpha2, alpha3 = random[1:3, 2:]
    p11, p12, p33, p34, p22, p44 = elements.T
    for found, expected in (
        (p11, np.polynomial.legendre.legval(mu, random[0])),
        (p44, np.polynomial.legendre.legval(mu, random[3])),
        (p12, -d02 @ random[4, 2:]), (p34, -d02 @ random[5, 2:]),
        (p22 + p33, d22 @ (alpha2 + alpha3)), (p22 - p33, d2m2 @ (alpha2 - alpha3)),
    ):  # fmt: skip
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11)
    many = np.zeros((6, 1000))
    many[0] = (2.0 * np.arange(1000) + 1.0) * 0.9 ** np.arange(1000)
    begin = time.process_time()
    angle, elements = sum_expansion(many)
    assert time.process_time() - begin < 10.0
    g, mu = 0.9, np.cos(np.radians(angle))
    exact = (1.0 - g**2) / (1.0 + g**2 - 2.0 * g * mu) ** 1.5
    np.testing.assert_allclose(elements[:, 0], exact, rtol=1e-9, atol=1e-9)


TOO_LARGE = {**RAYLEIGH, "P12": 1.5 * RAYLEIGH["P11"]}
MESSAGES = [
    ({key: RAYLEIGH[key] for key in ("angle_deg", "P11")}, "missing P12, P33, P34"),
    ({**RAYLEIGH, "P13": MU}, "unknown P13"),
    ({key: value[:-1] for key, value in RAYLEIGH.items()}, "must be from 0 to 180 degrees"),
    ({**RAYLEIGH, "P34": MU[:-1]}, "columns of the same length"),
    ({**RAYLEIGH, "P11": -RAYLEIGH["P11"]}, "P11 = -1.5"),
    ({**RAYLEIGH, "P12": RAYLEIGH["P12"] * np.nan}, "scattering_matrix.P12"),
    (TOO_LARGE, "a sum of matrices of single particles"),
    ({**RAYLEIGH, "P44": -RAYLEIGH["P33"]}, "a sum of matrices of single particles"),
    ({**EXPANSION, "alpha5": [0.0] * 3}, "alpha1"),
    ({**EXPANSION, "alpha2": [0.0] * 2}, "lists of the same length"),
    ({key: value if key == "angle_deg" else 1e308 * value for key, value in RAYLEIGH.items()},
     "P11 = 1.5e+308: must be numbers from 0 to 1e100"),
    ({key: value if key == "angle_deg" else 1e-320 * value for key, value in RAYLEIGH.items()},
     "one of them at least 1e-100"),
    ({**EXPANSION, "alpha1": [1e308, 0.0, 1e308]}, "alpha1 = 1e+308: must be in [-1e+100, 1e+100]"),
    ({**EXPANSION, "beta1": [0.0, 0.0, -1e301]}, "beta1 = -1e+301"),
    ({**EXPANSION, "alpha1": [5e-324, 0.0, 0.0]}, "P11 = 5e-324: must be numbers"),
    ("no_such_file.csv", "an existing CSV file"),
    ("no_such_file.nc", "a netCDF file"),
    (3.0, "columns angle_deg"),
]  # fmt: skip


@pytest.mark.parametrize(("value", "message"), MESSAGES)
def test_invalid_matrices_have_a_message(value, message):
    with pytest.raises(ValueError, match="scattering_matrix") as error:
        ParticleLayer(scattering_matrix=value)
    assert message in str(error.value)


def test_several_wavelengths_have_a_hint(tmp_path):
    dataset = write_libradtran(tmp_path / "matrix.nc")
    two = xr.concat([dataset, dataset], "nlam")
    with pytest.raises(ValueError, match="select one"):
        ParticleLayer(scattering_matrix=two)


def test_a_phase_function_alone_does_not_polarize():
    table = {"cosine": [-1.0, 1.0], "density": [1.0, 2.0]}
    assert not ParticleLayer(phase_function=table).polarized
    with pytest.raises(ValueError, match="polarized = True: must be with scattering_matrix"):
        ParticleLayer(phase_function=table, polarized=True)


def test_repacked_files_of_libradtran_are_the_same_matrix(tmp_path):
    """A fill value makes whole numbers floats, and rows that are shorter end with fill values."""
    dataset = write_libradtran(tmp_path / "matrix.nc")
    expected = ScatteringMatrix.from_input(dataset).elements
    longer = dataset.pad(nthetamax=(0, 5))
    for one in (dataset, longer, dataset.transpose(*[*dataset.theta.dims][::-1])):
        path = tmp_path / "repacked.nc"
        one.assign(ntheta=one.ntheta.astype(int)).to_netcdf(
            path, encoding={"ntheta": {"_FillValue": -1}}
        )
        np.testing.assert_array_equal(ScatteringMatrix.from_input(path).elements, expected)
    for number in (1, ANGLE.size + 1, -1, 2.5):
        changed = dataset.assign(ntheta=dataset.ntheta * 0 + number)
        with pytest.raises(InvalidValue, match=r"scattering_matrix.ntheta = .*whole number from 2"):
            ScatteringMatrix.from_input(changed)
