"""Rotations as quaternions p = (w, x, y, z) of any length, for kernels: only the direction of p matters.

A state keeps four numbers for a frame and adds to them like any other unknown; every frame is made from p/|p|, so it
is orthonormal to rounding whatever an integrator does to |p|. Spins are spatial: delta theta = 2 Im(delta p p*)/|p|^2.
"""

from __future__ import annotations

import math

from .algebra import axpy, dot, scale
from .compile import kernel


@kernel
def load4(x, i):
    """The quaternion x[i : i + 4]."""
    return x[i], x[i + 1], x[i + 2], x[i + 3]


@kernel
def cross(u, w):
    """u x w in space."""
    return u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]


@kernel
def times(a, b):
    """The product a b of two quaternions."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel
def dot4(a, b):
    """a . b of two quaternions."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@kernel
def mix(c, a, d, b):
    """c a + d b of two quaternions."""
    return c * a[0] + d * b[0], c * a[1] + d * b[1], c * a[2] + d * b[2], c * a[3] + d * b[3]


@kernel
def frame(p):
    """The three axes of the frame p, orthonormal."""
    w, x, y, z = p
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)),
        (s * (x * y - w * z), 1.0 - s * (x * x + z * z), s * (y * z + w * x)),
        (s * (x * z + w * y), s * (y * z - w * x), 1.0 - s * (x * x + y * y)),
    )


@kernel
def spin_of(p, rate):
    """Spin 2 Im(rate p*)/|p|^2 of the frame p whose quaternion changes at `rate`."""
    c = 2.0 / dot4(p, p)
    u, b = (p[1], p[2], p[3]), (rate[1], rate[2], rate[3])
    return scale(c, axpy(-rate[0], u, axpy(p[0], b, cross(u, b))))


@kernel
def spin_matrix(p, c, P):
    """P (3, 4) = c d(spin)/d(rate): -v in the first column, w I + [v]x in the others, times 2/|p|^2."""
    c = c * 2.0 / dot4(p, p)
    w, x, y, z = c * p[0], c * p[1], c * p[2], c * p[3]
    P[0, 0], P[0, 1], P[0, 2], P[0, 3] = -x, w, -z, y
    P[1, 0], P[1, 1], P[1, 2], P[1, 3] = -y, z, w, -x
    P[2, 0], P[2, 1], P[2, 2], P[2, 3] = -z, -y, x, w


@kernel
def add_spin_turn(p, rate, c, P):
    """P (3, 4) += c d(spin of `rate`)/dp."""
    s = c * 2.0 / dot4(p, p)
    a, b0, b1, b2 = s * rate[0], s * rate[1], s * rate[2], s * rate[3]
    w = spin_of(p, rate)
    P[0, 0] += b0
    P[1, 0] += b1
    P[2, 0] += b2
    P[0, 1] -= a
    P[1, 2] -= a
    P[2, 3] -= a
    P[0, 2] += b2
    P[0, 3] -= b1
    P[1, 1] -= b2
    P[1, 3] += b0
    P[2, 1] += b1
    P[2, 2] -= b0
    for k in range(3):
        for m in range(4):
            P[k, m] -= w[k] * s * p[m]


@kernel
def relative(p, q):
    """The turn from frame p to frame q as (real part, rotation vector), the vector in the axes of either."""
    c = dot4(p, q)
    x = axpy(p[0], (q[1], q[2], q[3]), scale(-q[0], (p[1], p[2], p[3])))
    x = axpy(-1.0, cross((p[1], p[2], p[3]), (q[1], q[2], q[3])), x)
    if c < 0.0:
        c, x = -c, scale(-1.0, x)
    return c, x


@kernel
def rotation_vector(c, x):
    """Rotation vector theta of the quaternion (c, x), c >= 0, of any length; and its f = theta/x."""
    size = math.sqrt(dot(x, x))
    y = size / c if c > 0.0 else 1e300
    f = 2.0 / c * (1.0 - y * y / 3.0 + y**4 / 5.0) if y < 1e-3 else 2.0 * math.atan2(size, c) / size
    return scale(f, x), f


@kernel
def relative_matrices(p, q, scale_by, A, B):
    """A, B (3, 4) = scale_by d(theta)/dp and d(theta)/dq of the turn from p to q."""
    sign = 1.0 if dot4(p, q) >= 0.0 else -1.0
    c, x = relative(p, q)
    f = rotation_vector(c, x)[1]
    square, n = dot(x, x), c * c + dot(x, x)
    y = square / (c * c) if c > 0.0 else 1e300
    along = 2.0 / c**3 * (-2.0 / 3.0 + 0.8 * y - 6.0 / 7.0 * y * y) if y < 1e-5 else (2.0 * c / n - f) / square
    # d(theta) = (f I + along x x) dx - 2/n x dc, with x = sign (p0 qv - q0 pv - pv x qv), c = sign p.q
    for side in range(2):
        M = A if side == 0 else B
        for m in range(4):
            e = (1.0 if m == 0 else 0.0, 1.0 if m == 1 else 0.0, 1.0 if m == 2 else 0.0, 1.0 if m == 3 else 0.0)
            a, b = (e, q) if side == 0 else (p, e)
            dc = sign * dot4(a, b)
            dx = axpy(a[0], (b[1], b[2], b[3]), scale(-b[0], (a[1], a[2], a[3])))
            dx = scale(sign, axpy(-1.0, cross((a[1], a[2], a[3]), (b[1], b[2], b[3])), dx))
            s = along * dot(x, dx) - 2.0 / n * dc
            for k in range(3):
                M[k, m] = scale_by * (f * dx[k] + s * x[k])


@kernel
def arc_factor(square):
    """beta = (1 - sin(t/2)/(t/2))/t^2 and its derivative over t, for t^2 = square: the chord of an arc of angle t is
    sin(t/2)/(t/2) of its length."""
    if square < 1e-2:
        return (
            1.0 / 24.0 - square / 1920.0 + square**2 / 322560.0 - square**3 / 92897280.0,
            -1.0 / 960.0 + square / 80640.0 - square**2 / 15482880.0,
        )
    t = math.sqrt(square)
    s = math.sin(0.5 * t) / (0.5 * t)
    slope = (math.cos(0.5 * t) - s) / t  # ds/dt
    return (1.0 - s) / square, (-slope / square - 2.0 * (1.0 - s) / (square * t)) / t
