"""Vectors, directions, and local frames."""

from oracle.arithmetic import fused, reciprocal_root, root
from oracle.jit import ONE, TWO, ZERO, kernel
from oracle.rng import uniform, unit_circle


@kernel
def dot(x1, x2, x3, y1, y2, y3):
    """Return the scalar product of x and y."""
    return fused(x1, y1, fused(x2, y2, x3 * y3))


@kernel
def orthonormal_basis(nx, ny, nz):
    """Return two unit vectors that complete the unit vector n to a right-handed frame.

    Branch-free construction of Duff et al. (2017), J. Comput. Graph. Tech. 6(1), listing 3.

    Returns
    -------
    tuple of 6 float
        Components of the two tangents.
    """
    sign = ONE if nz >= ZERO else -ONE
    a = -ONE / (sign + nz)
    b = nx * ny * a
    return (
        ONE + sign * nx * nx * a, sign * b, -sign * nx,
        b, sign + ny * ny * a, -ny,
    )  # fmt: skip


@kernel
def normalized(x, y, z):
    """Return (x, y, z) scaled to unit length."""
    scale = reciprocal_root(dot(x, y, z, x, y, z))
    return x * scale, y * scale, z * scale


@kernel
def around(nx, ny, nz, cos_polar, sin_polar, cos_azimuth, sin_azimuth):
    """Return the unit vector at the given polar and azimuth angles around the unit vector n."""
    ux, uy, uz, vx, vy, vz = orthonormal_basis(nx, ny, nz)
    p = sin_polar * cos_azimuth
    q = sin_polar * sin_azimuth
    return normalized(
        fused(q, vx, fused(p, ux, cos_polar * nx)),
        fused(q, vy, fused(p, uy, cos_polar * ny)),
        fused(q, vz, fused(p, uz, cos_polar * nz)),
    )


@kernel
def sample_cosine_lobe(state, nx, ny, nz):
    """Return a direction around the unit vector n with density cosθ/π (Lambert)."""
    u = uniform(state)
    c, s = unit_circle(state)
    return around(nx, ny, nz, root(u), root(ONE - u), c, s)


@kernel
def mirror(dx, dy, dz, nx, ny, nz):
    """Return the direction d mirrored in the plane with unit normal n."""
    k = TWO * dot(dx, dy, dz, nx, ny, nz)
    return dx - k * nx, dy - k * ny, dz - k * nz
