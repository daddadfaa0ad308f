"""Polarized light at interfaces and of particles: Maxwell's equations, dipoles, rotations."""

import math

import mpmath as mp
import numpy as np
import pytest
from chi2 import scale_sample_size, start_random_stream
from numba import njit

from splits.kernels import interface as interface
from splits.kernels import scattering_matrix, stokes
from splits.kernels.interface import ComplexIndex, fresnel
from splits.kernels.scene import UNPOLARIZED, Stokes, Vector
from splits.kernels.stokes import rotate_reference_to

GEOMETRIES = scale_sample_size(50_000) // 1000 * 4
IDENTITY = np.eye(3)


def draw_unit_vectors(rng, n):
    x = rng.normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def draw_polarized_light(rng, pure=False):
    """Return a direction, a reference axis and q, u, v of complete or partial polarization."""
    d, e = draw_unit_vectors(rng, 2)
    e = np.cross(d, e)
    degree = 1.0 if pure else rng.random()
    return d, e / np.linalg.norm(e), degree * draw_unit_vectors(rng, 1)[0]


def make_coherency(q, u, v):
    """Return the coherency matrix, mean E E*, of light of intensity 1 in the frame (e, f)."""
    return 0.5 * np.array([[1 + q, u - 1j * v], [u + 1j * v, 1 - q]])


def make_frame(d, e):
    return np.stack([e, np.cross(d, e)], axis=1)


def compute_stokes(c, d, e):
    """Return I, Q, U, V of a coherency tensor, the mean of E E* in space."""
    (ee, ef), (_, ff) = make_frame(d, e).T @ c @ make_frame(d, e)
    return np.array([(ee + ff).real, (ee - ff).real, 2.0 * ef.real, -2.0 * ef.imag])


def to_vector(x):
    """Return a `Vector` of three numbers."""
    return Vector(*(float(c) for c in x))


def to_kernel_light(e, s):
    """Return the `Stokes` of a reference axis and q, u, v."""
    return Stokes(to_vector(e), *(float(x) for x in s))


def assert_frame(d, e, tolerance=4e-15):
    assert abs(d @ d - 1.0) < tolerance and abs(e @ e - 1.0) < tolerance and abs(d @ e) < tolerance


# --- interfaces -----------------------------------------------------------------------------------


COSINES = [*np.logspace(-12, 0, 13), *(1.0 - np.logspace(-15, -1, 8)), 0.3, 0.5, 0.7]
INDICES = [(1.0, 1.33), (1.33, 1.0), (1.0, 1.0 + 1e-9), (1.0 + 1e-9, 1.0), (1.0, 300.0), (2.4, 1.5)]


def solve_maxwell(n1, n2, d, n):
    """Return the wave vectors and fields that Maxwell's boundary conditions give.

    Tangential E and H = k × E are continuous; E is perpendicular to k.  With e^(−iωt), the
    transmitted wave decays for a wave number of positive imaginary part.

    Returns
    -------
    k_r, k_t : complex[3]
        Wave vectors of reflected and transmitted light, per wave number in vacuum.
    solve_fields : callable
        Fields E_r and E_t of an incident field.
    """
    k = n1 * d
    along = k - (k @ n) * n
    k_r = along - (k @ n) * n
    w = np.sqrt(n2 * n2 - along @ along + 0j)
    k_t = along - w * n
    tangents = np.linalg.svd(n[np.newaxis])[2][1:]

    def curl(k):
        return np.cross(k, IDENTITY).T  # k × E as a matrix

    rows = np.zeros((6, 6), dtype=complex)
    rows[0, :3], rows[1, 3:] = k_r, k_t
    rows[2:4, :3], rows[2:4, 3:] = tangents, -tangents
    rows[4:, :3], rows[4:, 3:] = tangents @ curl(k_r), -tangents @ curl(k_t)

    def solve_fields(field):
        right = np.concatenate([[0, 0], -tangents @ field, -tangents @ curl(k) @ field])
        return np.split(np.linalg.solve(rows, right), 2)

    return k_r, k_t, solve_fields


def draw_incident_light(rng, cos_i, pure):
    """Return random light and a surface normal at a given angle of incidence."""
    d, e, s = draw_polarized_light(rng, pure)
    side = np.cross(d, draw_unit_vectors(rng, 1)[0])
    side /= np.linalg.norm(side)
    return d, e, s, -cos_i * d + math.sqrt((1.0 - cos_i) * (1.0 + cos_i)) * side


def compute_reflection(d, e, s, n, n1, n2):
    """Return the reflectance of an interface and the reflected light."""
    reflectance, d, out = interface.reflect_polarized(
        to_vector(d), to_kernel_light(e, s), to_vector(n), ComplexIndex(n1, 0.0),
        ComplexIndex(n2, 0.0),
    )  # fmt: skip
    return reflectance, *to_arrays(d, out)


def compute_refraction(d, e, s, n, n1, n2):
    """Return the transmittance of an interface and the transmitted light.

    The steps are those of `sample_polarized_interface`, which samples either reflection or
    refraction.  At total reflection the incident light is returned, unpolarized.
    """
    d, n = to_vector(d), to_vector(n)
    light = interface.rotate_to_plane_of_incidence(d, to_kernel_light(e, s), n)
    fresnel_mueller = interface.compute_fresnel_mueller(n1, n2, light.cos_incidence)
    plus, minus, *_ = fresnel_mueller.transmission
    if plus == 0.0:
        return 0.0, np.array(d), np.array(e), np.zeros(3)
    _, d, out = interface._refract_light(d, n, light, fresnel_mueller)
    return plus + minus * light.q, *to_arrays(d, out)


def to_arrays(d, stokes):
    """Return direction, reference axis, and q, u, v as arrays."""
    return np.array(d), np.array(stokes.e), np.array(stokes[1:])


def rotate_linear(s, e, d, t):
    """Return q and u after a rotation of the reference axis from e to t."""
    return rotate_reference_to(to_kernel_light(e, s), to_vector(d), to_vector(t))


@pytest.mark.parametrize("indices", [(1.0, 1.33), (1.33, 1.0), (1.5, 1.33), (1.0, 1.001)], ids=str)
def test_interface_fulfils_maxwells_equations(indices):
    rng = np.random.default_rng(8)
    n1, n2 = indices
    for i in range(GEOMETRIES):
        cos_i = 1.0 if i % 20 == 0 else rng.random()
        d, e, s, n = draw_incident_light(rng, cos_i, pure=i % 2 == 0)
        k_r, k_t, solve_fields = solve_maxwell(n1, n2, d, n)
        fields = [solve_fields(side) for side in make_frame(d, e).T]
        r, t = (np.stack([f[j] for f in fields], axis=1) for j in (0, 1))

        reflectance, d2, e2, s2 = compute_reflection(d, e, s, n, n1, n2)
        assert_frame(d2, e2)
        assert d2 == pytest.approx(k_r / n1, abs=1e-13)
        expected = compute_stokes(r @ make_coherency(*s) @ r.conj().T, d2, e2)
        assert reflectance == pytest.approx(expected[0], abs=1e-13)
        assert reflectance * s2 == pytest.approx(expected[1:], abs=1e-12)

        transmittance, d2, e2, s2 = compute_refraction(d, e, s, n, n1, n2)
        assert transmittance + reflectance == pytest.approx(1.0, abs=1e-14)
        if k_t.imag.any():
            assert (reflectance, transmittance) == (1.0, 0.0)
            assert (*d2, *e2, *s2) == (*d, *e, 0.0, 0.0, 0.0)
            continue
        assert_frame(d2, e2)
        assert d2 == pytest.approx(k_t.real / n2, abs=1e-13)
        expected = compute_stokes(t @ make_coherency(*s) @ t.conj().T, d2, e2)
        flux = (k_t @ n).real / (n1 * (d @ n))
        assert transmittance == pytest.approx(flux * expected[0], abs=1e-13)
        assert s2 == pytest.approx(expected[1:] / expected[0], abs=1e-12)


@pytest.mark.parametrize("indices", INDICES, ids=str)
def test_mean_reflectance_matches_unpolarized_fresnel(indices):
    for cos_i in COSINES:
        fresnel_mueller = interface.compute_fresnel_mueller(*indices, cos_i)
        plus, minus, real, imaginary = fresnel_mueller.reflection
        t_plus, t_minus, t_root, t_imaginary = fresnel_mueller.transmission
        _, ratio, cos_t = fresnel_mueller.fresnel_result
        expected = fresnel(*indices, 0.0, cos_i)
        assert fresnel_mueller.fresnel_result.reflectance == plus
        assert plus == pytest.approx(expected[0], rel=1e-14)
        assert (ratio, cos_t) == pytest.approx(expected[1:], rel=1e-14)
        assert plus + t_plus == pytest.approx(1.0, abs=4e-15)
        assert (t_minus, t_imaginary) == (-minus, 0.0)
        # Neither reflection nor refraction depolarizes: √(R_p R_s) and √(T_p T_s).
        assert real**2 + imaginary**2 == pytest.approx((plus - minus) * (plus + minus), rel=1e-13)
        assert t_root**2 == pytest.approx((t_plus - t_minus) * (t_plus + t_minus), rel=1e-13)


@pytest.mark.parametrize("indices", INDICES, ids=str)
def test_amplitudes_match_50_digit_arithmetic(indices):
    n1, n2 = indices

    def exact(c):
        m = mp.mpf(n2) / mp.mpf(n1)
        w = mp.sqrt(m * m - 1 + c * c)
        s, p = (c - w) / (c + w), (m * m * c - w) / (m * m * c + w)
        rs, rp, product = abs(s) ** 2, abs(p) ** 2, p * mp.conj(s)
        root = mp.sqrt((1 - rs) * (1 - rp))
        return [(rp + rs) / 2, (rp - rs) / 2, product.real, product.imag,
                1 - (rp + rs) / 2, root]  # fmt: skip

    with mp.workdps(50):
        for cos_i in COSINES:
            fresnel_mueller = interface.compute_fresnel_mueller(n1, n2, cos_i)
            results = (*fresnel_mueller.reflection, *fresnel_mueller.transmission)
            values = exact(mp.mpf(cos_i))
            perturbed = exact(mp.mpf(cos_i) * (1 + mp.mpf(2) ** -52))
            for value, expected, neighbour in zip(
                (*results[:5], results[6]), values, perturbed, strict=True
            ):  # fmt: skip
                if abs(expected) < 1e-40:
                    assert abs(value) < 1e-30
                    continue
                # A relative error of 1e-12 plus the effect of one ulp of the argument.
                allowed = 1e-12 * abs(expected) + 4 * abs(neighbour - expected)
                assert abs(value - expected) < allowed, (cos_i, value, expected)


def test_no_parallel_reflection_at_brewsters_angle():
    for n1, n2 in ((1.0, 1.33), (1.33, 1.0), (1.0, 2.4)):
        d = np.array([n2, 0.0, -n1]) / math.hypot(n1, n2)
        plus, minus, *_ = interface.compute_fresnel_mueller(n1, n2, -d[2]).reflection
        assert plus + minus == pytest.approx(0.0, abs=1e-16)
        up = (0, 0, 1)
        reflectance, *_, out = compute_reflection(d, (0, 1, 0), (0, 0, 0), up, n1, n2)
        r = (n2**2 - n1**2) / (n2**2 + n1**2)
        assert reflectance == pytest.approx(0.5 * r * r, rel=1e-12)
        assert out == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)
        # Light polarized in the plane of incidence, perpendicular to y, is fully transmitted.
        transmittance, *_, out = compute_refraction(d, (0, 1, 0), (-1, 0, 0), up, n1, n2)
        assert transmittance == pytest.approx(1.0, abs=1e-15)
        assert out == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)


@pytest.mark.parametrize("k", [1e-9, 1e-3, 0.3, 3.0])
@pytest.mark.parametrize("n", [0.7, 1.0, 1.31, 3.0])
def test_absorbing_media_match_50_digit_arithmetic(n, k):
    for cos_i in COSINES:
        mueller = interface.compute_mueller(n, n - 1.0, k, cos_i)
        plus, minus, real, imaginary = mueller.reflection
        t_plus, t_minus, t_real, t_imaginary = mueller.transmission
        with mp.workdps(50):
            c, m = mp.mpf(cos_i), mp.mpc(n, k)
            w = mp.sqrt(m * m - 1 + c * c)
            s, p = (c - w) / (c + w), (m * m * c - w) / (m * m * c + w)
            ts, tp = 2 * c / (c + w), 2 * m * c / (m * m * c + w)
            rs, rp, product = abs(s) ** 2, abs(p) ** 2, p * mp.conj(s)
            phase = tp * mp.conj(ts) / abs(tp * ts)
            root = mp.sqrt((1 - rs) * (1 - rp)) * phase
            expected = [
                float(one)
                for one in ((rp + rs) / 2, (rp - rs) / 2, product.real, product.imag, root.real,
                            root.imag)
            ]  # fmt: skip
        found = (plus, minus, real, imaginary, t_real, t_imaginary)
        assert found == pytest.approx(expected, rel=1e-9, abs=3e-8)
        assert (t_plus, t_minus) == (1.0 - plus, -minus)


def test_absorption_of_0_is_the_limit_of_a_small_one():
    for n in (0.7, 1.31):
        for cos_i in (0.2, 0.5, 0.9):
            without, little = (
                interface.compute_mueller(n, n - 1.0, k, cos_i) for k in (0.0, 1e-14)
            )
            for one, other in zip(without[:2], little[:2], strict=True):
                assert tuple(one) == pytest.approx(tuple(other), abs=1e-9)


def test_phase_of_total_reflection_matches_theory():
    n1, n2 = 1.5, 1.0
    n = n2 / n1
    for theta in np.linspace(math.asin(n) + 1e-9, math.pi / 2, 40):
        sine, cosine = math.sin(theta), math.cos(theta)
        delta = 2.0 * math.atan(cosine * math.sqrt(sine**2 - n**2) / sine**2)
        out, transmission, fresnel_result = interface.compute_fresnel_mueller(n1, n2, cosine)
        assert out[:2] == (1.0, 0.0) and transmission == (0.0,) * 4
        assert fresnel_result == (1.0, 0.0, 0.0)
        assert out[2] == pytest.approx(math.cos(delta), abs=1e-9)
        assert out[3] == pytest.approx(-math.sin(delta), abs=1e-9)
        assert math.hypot(out[2], out[3]) == pytest.approx(1.0, abs=1e-15)


def test_phase_is_continuous_at_the_critical_angle():
    critical = math.sqrt(1.0 - (1.0 / 1.5) ** 2)
    for offset in np.logspace(-14, -3, 12):
        for cos_i in (critical * (1 - offset), critical * (1 + offset)):
            plus, minus, real, imaginary = interface.compute_fresnel_mueller(
                1.5, 1.0, cos_i
            ).reflection
            amplitude = math.sqrt(plus * plus - minus * minus)
            assert math.hypot(real, imaginary) == pytest.approx(amplitude, rel=1e-13)
            # Both sides approach 1 as the square root of the offset, here with a factor below 10.
            assert abs(complex(real, imaginary) - 1.0) < 10.0 * math.sqrt(offset)


def test_fresnel_rhomb_makes_circular_light():
    """Two reflections at 54°37′ in glass of index 1.51 turn light at 45° into circular light."""
    theta = math.radians(54 + 37 / 60)
    normal = np.array([0.0, 0.0, 1.0])
    d = np.array([math.sin(theta), 0.0, -math.cos(theta)])
    e = np.array([math.cos(theta), 0.0, math.sin(theta)])
    reflectance, *out = compute_reflection(d, e, (0, 1, 0), normal, 1.51, 1.0)
    assert reflectance == 1.0
    # A phase shift of one eighth of a wave.
    assert out[2] == pytest.approx([0.0, math.sqrt(0.5), math.sqrt(0.5)], abs=1e-3)
    reflectance, *out = compute_reflection(*out, -normal, 1.51, 1.0)
    assert reflectance == 1.0
    assert out[0] == pytest.approx(d, abs=1e-15)
    assert out[2] == pytest.approx([0.0, 0.0, 1.0], abs=1e-3)


@pytest.mark.parametrize("indices", [(1.0, 1.33), (1.33, 1.0)], ids=str)
def test_grazing_incidence_reflects_everything(indices):
    rng = np.random.default_rng(10)
    d, e, s, n = draw_incident_light(rng, 0.0, pure=True)
    reflectance, _, e2, s2 = compute_reflection(d, e, s, n, *indices)
    assert reflectance == pytest.approx(1.0, abs=1e-14)
    q, u = rotate_linear(s2, e2, d, e)
    assert (q, u, s2[2]) == pytest.approx(s, abs=1e-14)


def test_equal_media_have_no_interface():
    rng = np.random.default_rng(11)
    for cos_i in (0.0, 1e-9, 0.5, 1.0):
        d, e, s, n = draw_incident_light(rng, cos_i, pure=True)
        transmittance, d2, e2, s2 = compute_refraction(d, e, s, n, 1.33, 1.33)
        assert transmittance == 1.0
        assert d2 == pytest.approx(d, abs=1e-15)
        q, u = rotate_linear(s2, e2, d, e)
        assert (q, u, s2[2]) == pytest.approx(s, abs=1e-14)
        assert compute_reflection(d, e, s, n, 1.33, 1.33)[0] == 0.0


def test_stokes_vectors_stay_physical():
    rng = np.random.default_rng(12)
    for i in range(10 * GEOMETRIES):
        d, e, s, n = draw_incident_light(rng, rng.choice(COSINES), pure=i % 2 == 0)
        n1, n2 = INDICES[i % len(INDICES)]
        fractions = []
        for kernel in (compute_reflection, compute_refraction):
            fraction, d2, e2, s2 = kernel(d, e, s, n, n1, n2)
            fractions.append(fraction)
            assert -1e-15 <= fraction <= 1.0 + 1e-15
            assert_frame(d2, e2, tolerance=1e-14)
            assert np.linalg.norm(s2) <= 1.0 + 1e-15
        assert sum(fractions) == pytest.approx(1.0, abs=1e-14)


def test_sampled_interaction_is_reflection_or_refraction():
    rng = np.random.default_rng(13)
    state = start_random_stream()
    outcomes = set()
    for i in range(GEOMETRIES):
        d, e, s, n = draw_incident_light(rng, rng.random(), pure=i % 2 == 0)
        passed, *out = interface.sample_polarized_interface(
            state, to_vector(d), to_kernel_light(e, s), to_vector(n), ComplexIndex(1.33, 0.0),
            ComplexIndex(1.0, 0.0),
        )  # fmt: skip
        kernel = compute_refraction if passed else compute_reflection
        expected = np.concatenate(kernel(d, e, s, n, 1.33, 1.0)[1:])
        assert np.concatenate(to_arrays(*out)) == pytest.approx(expected, abs=1e-15)
        outcomes.add(passed)
    assert len(outcomes) == 2


# --- rotation and scattering ----------------------------------------------------------------------


RAYLEIGH = scattering_matrix.make_rayleigh()
# Rows are m12, m22, m33, m34, m44 of matrices of single particles or of sums of them.
TABLE = scattering_matrix.make_tabulated(
    [1.0, -1.0, 0.2, 0.8],
    [5.0, 1.0, 0.0, 2.0],
    [[0.0, 1.0, 1.0, 0.0, 1.0], [0.0, 0.6, -0.6, 0.0, -0.2], [0.4, 0.9, 0.3, 0.5, 0.3],
     [-0.5, 0.9, 0.6, -0.4, 0.7]],
)  # fmt: skip
MODELS = {
    "forward": scattering_matrix.make_henyey_greenstein(0.6),
    "backward": scattering_matrix.make_henyey_greenstein(-0.4),
    "Rayleigh": RAYLEIGH,
    "depolarizing": scattering_matrix.make_rayleigh(0.1),
    "table": TABLE,
}


def scatter_towards(model, d, e, s, t):
    """Return density, q, u, v, and the reference axis of light scattered towards t."""
    density, out = stokes.evaluate_polarized_scattering(
        model, to_vector(d), to_kernel_light(e, s), to_vector(t)
    )
    return np.array([density, *out[1:], *out.e])


def sample_scattering(state, model, d, e, s):
    """Return direction, reference axis, and q, u, v of a sampled scattering."""
    d, out = stokes.scatter_polarized(state, model, to_vector(d), to_kernel_light(e, s))
    return np.array(d), np.array(out.e), np.array(out[1:])


# --- rotation ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [(0, (0.6, 0.3)), (45, (0.3, -0.6)), (90, (-0.6, -0.3)), (-45, (-0.3, 0.6)), (180, (0.6, 0.3))],
)
def test_rotation_by_an_angle(degrees, expected):
    a = math.radians(degrees)
    # The light travels along z: from x towards y is from e towards d × e.
    q, u = rotate_linear((0.6, 0.3, 0.0), (1, 0, 0), (0, 0, 1), (math.cos(a), math.sin(a), 0))
    assert (q, u) == pytest.approx(expected, abs=1e-15)


def test_rotation_is_invertible():
    rng = np.random.default_rng(1)
    for _ in range(GEOMETRIES):
        d, e, (q, u, _) = draw_polarized_light(rng)
        t = np.cross(d, draw_unit_vectors(rng, 1)[0])
        t /= np.linalg.norm(t)
        q2, u2 = rotate_linear((q, u, 0.0), e, d, t)
        assert q2**2 + u2**2 == pytest.approx(q**2 + u**2, rel=1e-14)
        assert rotate_linear((q2, u2, 0.0), t, d, e) == pytest.approx((q, u), abs=1e-14)
        # The length of the new reference and its component along d have no effect.
        longer = 3.0 * t + 0.2 * d
        assert rotate_linear((q, u, 0.0), e, d, longer) == pytest.approx((q2, u2), abs=1e-13)


def test_unpolarized_light_has_a_valid_frame():
    for d in draw_unit_vectors(np.random.default_rng(2), 100):
        light = stokes.make_unpolarized(to_vector(d), UNPOLARIZED)
        assert_frame(d, np.array(light.e))
        assert light[1:] == (0.0, 0.0, 0.0)
    assert stokes.make_unpolarized(to_vector(d), None) is None


# --- scattering -------------------------------------------------------------------------------


def list_geometries(rng, d, e):
    """Yield directions: a random one, ±d, and directions next to ±d."""
    yield draw_unit_vectors(rng, 1)[0]
    for sign in (1.0, -1.0):
        yield sign * d
        for offset in (1e-12, 1e-6):
            t = sign * d + offset * (0.6 * e + 0.8 * np.cross(d, e))
            yield t / np.linalg.norm(t)


def test_rayleigh_scattering_matches_a_dipole():
    rng = np.random.default_rng(3)
    for i in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng, pure=i % 2 == 0)
        coherency = make_frame(d, e) @ make_coherency(*s) @ make_frame(d, e).T
        for t in list_geometries(rng, d, e):
            out = scatter_towards(RAYLEIGH, d, e, s, t)
            density, e2 = out[0], out[4:]
            assert_frame(t, e2)
            # The field of a dipole is the incident field projected perpendicular to t.
            projection = IDENTITY - np.outer(t, t)
            expected = compute_stokes(projection @ coherency @ projection, t, e2)
            assert density == pytest.approx(3.0 / (8.0 * math.pi) * expected[0], abs=1e-15)
            assert out[1:4] == pytest.approx(expected[1:] / expected[0], abs=1e-14 / expected[0])


def make_rotation(sigma):
    """Return the Mueller matrix of a rotation of the reference axis."""
    c, s = math.cos(2.0 * sigma), math.sin(2.0 * sigma)
    return np.array([[1, 0, 0, 0], [0, c, s, 0], [0, -s, c, 0], [0, 0, 0, 1]])


def compute_angle(e, t, d):
    return math.atan2(np.cross(e, t) @ d, e @ t)


def evaluate_matrix(model, mu):
    """Return the phase function and the normalized scattering matrix at a cosine, independently."""
    if model.kind == scattering_matrix.TABLE:
        p = np.interp(mu, model.cosines, model.density)
        elements = [np.interp(mu, model.cosines, column) / p for column in model.elements.T]
    else:
        # Rayleigh scattering with a depolarization factor of 0.1, or Henyey & Greenstein with 0.
        rho = 0.1 if model.kind == scattering_matrix.RAYLEIGH else 0.0
        delta, delta_2 = (1.0 - rho) / (1.0 + rho / 2.0), (1.0 - 2.0 * rho) / (1.0 - rho)
        p11 = 0.75 * delta * (1.0 + mu * mu) + 1.0 - delta
        p12, p22 = -0.75 * delta * (1.0 - mu * mu), 0.75 * delta * (1.0 + mu * mu)
        elements = np.array([p12, p22, 1.5 * delta * mu, 0.0, 1.5 * delta * delta_2 * mu]) / p11
        g = model.g
        p = p11 / (4.0 * math.pi)
        if model.kind == scattering_matrix.HENYEY_GREENSTEIN:
            p = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * mu) ** 1.5)
    m12, m22, m33, m34, m44 = elements
    return p, np.array([[1, m12, 0, 0], [m12, m22, 0, 0], [0, 0, m33, m34], [0, 0, -m34, m44]])


@pytest.mark.parametrize("name", ["forward", "depolarizing", "table"])
def test_scattering_equals_rotated_mueller_matrix(name):
    rng, model = np.random.default_rng(4), MODELS[name]
    for _ in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng)
        t = draw_unit_vectors(rng, 1)[0]
        before = np.cross(np.cross(d, t), d)
        theta = math.atan2(np.linalg.norm(np.cross(d, t)), d @ t)
        p, matrix = evaluate_matrix(model, math.cos(theta))
        reference = np.cross(t, draw_unit_vectors(rng, 1)[0])
        reference /= np.linalg.norm(reference)
        after = np.cross(np.cross(d, t), t)
        expected = (
            make_rotation(compute_angle(after, reference, t))
            @ matrix
            @ make_rotation(compute_angle(e, before, d))
            @ np.append(1.0, s)
        )
        out = scatter_towards(model, d, e, s, t)
        assert out[0] == pytest.approx(p * expected[0], rel=1e-12)
        q, u = rotate_linear(out[1:4], out[4:], t, reference)
        # Ratios of a table are undefined where its density is 0.
        assert (q, u, out[3]) == pytest.approx(expected[1:] / expected[0], abs=1e-11 / min(p, 1.0))


def test_rayleigh_vanishes_along_the_dipole():
    out = scatter_towards(RAYLEIGH, (0, 0, 1), (1, 0, 0), (1, 0, 0), (1, 0, 0))
    assert (out[:4] == 0.0).all()


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_density_integrates_to_1(model):
    x, weight = np.polynomial.legendre.leggauss(24)
    edges = np.array([-1.0, 0.2, 0.8, 1.0])
    half = 0.5 * np.diff(edges)[:, np.newaxis]
    mu = (edges[:-1, np.newaxis] + half * (1.0 + x)).ravel()
    weight = (half * weight).ravel()
    azimuth = 2.0 * np.pi * (np.arange(6) + 0.3) / 6
    rng = np.random.default_rng(5)
    for _ in range(3):
        d, e, s = draw_polarized_light(rng, pure=True)
        total = 0.0
        for m, w in zip(mu, weight, strict=True):
            azimuthal = make_frame(d, e) @ [np.cos(azimuth), np.sin(azimuth)]
            for t in m * d + math.sqrt(1.0 - m * m) * azimuthal.T:
                total += w * scatter_towards(model, d, e, s, t)[0]
        assert total * 2.0 * np.pi / azimuth.size == pytest.approx(1.0, rel=1e-11)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_sampled_scattering_matches_the_evaluated_density(model):
    rng = np.random.default_rng(6)
    state = start_random_stream()
    for i in range(GEOMETRIES):
        d, e, s = draw_polarized_light(rng, pure=i % 2 == 0)
        t, e2, s2 = sample_scattering(state, model, d, e, s)
        assert_frame(t, e2)
        assert np.linalg.norm(s2) <= 1.0 + 1e-15
        expected = scatter_towards(model, d, e, s, t)
        relative_density = 4.0 * math.pi * expected[0]
        assert relative_density > 0.0
        rotated = rotate_linear(s2, e2, t, expected[4:])
        assert (*rotated, s2[2]) == pytest.approx(
            expected[1:4], abs=1e-10 / min(relative_density, 1.0)
        )


@njit
def _scatter_repeatedly(state, model, n_scatterings):
    d = Vector(0.0, 0.6, 0.8)
    light = Stokes(Vector(1.0, 0.0, 0.0), 0.5, 0.3, -0.4)
    for _ in range(n_scatterings):
        d, light = stokes.scatter_polarized(state, model, d, light)
    return d, light


def test_frames_stay_orthonormal_after_many_scatterings():
    for model in (*MODELS.values(), scattering_matrix.make_henyey_greenstein(0.99)):
        d, light = _scatter_repeatedly(start_random_stream(), model, scale_sample_size(50_000))
        assert_frame(np.array(d), np.array(light.e))
        assert np.linalg.norm(light[1:]) <= 1.0 + 1e-15
