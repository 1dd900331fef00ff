"""Vectors as tuples, so that one kernel reads like the paper and compiles to scalar code in 2-D and in 3-D.

``axes`` is a tuple of zeros whose length tells the compiler the dimension. Nothing here allocates.
"""

from __future__ import annotations

import math

from numba.extending import overload

from .compile import kernel


def load(x, i, axes):
    """The vector x[i : i + dim]."""


def row(x, i, axes):
    """The vector x[i, :dim]."""


def add_to(x, i, c, u):
    """x[i : i + dim] += c u."""


def dot(u, w):
    """u . w"""


def axpy(c, u, w):
    """c u + w"""


def scale(c, u):
    """c u"""


def add_outer(J, bw, i, j, c, u, w):
    """J block (i, j) += c u (x) w, band storage."""


def add_column(J, bw, i, j, c, u):
    """J column j, rows i : i + dim, += c u."""


def add_row(J, bw, i, j, c, w):
    """J row i, columns j : j + dim, += c w."""


def add_diagonal(J, bw, i, j, c, axes):
    """J block (i, j) += c I."""


def basis(k, axes):
    """The unit vector along axis k."""


def across(direction, t):
    """Unit slide direction across the unit tangent t: t turned by 90 degrees times direction[0] in the plane; in
    space the given direction with its part along t taken away."""


def binormal(t, n):
    """t x n in space, zero in the plane."""


def turn(u, w):
    """u x w: in the plane its one component, as (value, 0)."""


@overload(load)
def _load(x, i, axes):
    if len(axes) == 2:
        return lambda x, i, axes: (x[i], x[i + 1])
    return lambda x, i, axes: (x[i], x[i + 1], x[i + 2])


@overload(row)
def _row(x, i, axes):
    if len(axes) == 2:
        return lambda x, i, axes: (x[i, 0], x[i, 1])
    return lambda x, i, axes: (x[i, 0], x[i, 1], x[i, 2])


@overload(add_to)
def _add_to(x, i, c, u):
    if len(u) == 2:

        def two(x, i, c, u):
            x[i] += c * u[0]
            x[i + 1] += c * u[1]

        return two

    def three(x, i, c, u):
        x[i] += c * u[0]
        x[i + 1] += c * u[1]
        x[i + 2] += c * u[2]

    return three


@overload(dot)
def _dot(u, w):
    if len(u) == 2:
        return lambda u, w: u[0] * w[0] + u[1] * w[1]
    return lambda u, w: u[0] * w[0] + u[1] * w[1] + u[2] * w[2]


@overload(axpy)
def _axpy(c, u, w):
    if len(u) == 2:
        return lambda c, u, w: (c * u[0] + w[0], c * u[1] + w[1])
    return lambda c, u, w: (c * u[0] + w[0], c * u[1] + w[1], c * u[2] + w[2])


@overload(scale)
def _scale(c, u):
    if len(u) == 2:
        return lambda c, u: (c * u[0], c * u[1])
    return lambda c, u: (c * u[0], c * u[1], c * u[2])


@overload(add_outer)
def _add_outer(J, bw, i, j, c, u, w):
    if len(u) == 2:

        def two(J, bw, i, j, c, u, w):
            k = bw + j - i
            x, y = c * u[0], c * u[1]
            J[i, k] += x * w[0]
            J[i, k + 1] += x * w[1]
            J[i + 1, k - 1] += y * w[0]
            J[i + 1, k] += y * w[1]

        return two

    def three(J, bw, i, j, c, u, w):
        k = bw + j - i
        for m in range(3):
            x = c * u[m]
            J[i + m, k - m] += x * w[0]
            J[i + m, k + 1 - m] += x * w[1]
            J[i + m, k + 2 - m] += x * w[2]

    return three


@overload(add_column)
def _add_column(J, bw, i, j, c, u):
    if len(u) == 2:

        def two(J, bw, i, j, c, u):
            k = bw + j - i
            J[i, k] += c * u[0]
            J[i + 1, k - 1] += c * u[1]

        return two

    def three(J, bw, i, j, c, u):
        k = bw + j - i
        J[i, k] += c * u[0]
        J[i + 1, k - 1] += c * u[1]
        J[i + 2, k - 2] += c * u[2]

    return three


@overload(add_row)
def _add_row(J, bw, i, j, c, w):
    if len(w) == 2:

        def two(J, bw, i, j, c, w):
            k = bw + j - i
            J[i, k] += c * w[0]
            J[i, k + 1] += c * w[1]

        return two

    def three(J, bw, i, j, c, w):
        k = bw + j - i
        J[i, k] += c * w[0]
        J[i, k + 1] += c * w[1]
        J[i, k + 2] += c * w[2]

    return three


@overload(across)
def _across(direction, t):
    if len(t) == 2:
        return lambda direction, t: (-direction[0] * t[1], direction[0] * t[0])

    def space(direction, t):
        n = axpy(-dot(direction, t), t, direction)
        size = math.sqrt(dot(n, n))
        return scale(1.0 / size, n) if size > 0.0 else n

    return space


@overload(binormal)
def _binormal(t, n):
    if len(t) == 2:
        return lambda t, n: (0.0, 0.0)
    return lambda t, n: (t[1] * n[2] - t[2] * n[1], t[2] * n[0] - t[0] * n[2], t[0] * n[1] - t[1] * n[0])


@overload(turn)
def _turn(u, w):
    if len(u) == 2:
        return lambda u, w: (u[0] * w[1] - u[1] * w[0], 0.0)
    return lambda u, w: (u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0])


def turned(m, u):
    """m x u for a moment m as ``turn`` gives it."""


@overload(turned)
def _turned(m, u):
    if len(u) == 2:
        return lambda m, u: (-m[0] * u[1], m[0] * u[0])
    return lambda m, u: (m[1] * u[2] - m[2] * u[1], m[2] * u[0] - m[0] * u[2], m[0] * u[1] - m[1] * u[0])


@overload(add_diagonal)
def _add_diagonal(J, bw, i, j, c, axes):
    if len(axes) == 2:

        def two(J, bw, i, j, c, axes):
            J[i, bw + j - i] += c
            J[i + 1, bw + j - i] += c

        return two

    def three(J, bw, i, j, c, axes):
        J[i, bw + j - i] += c
        J[i + 1, bw + j - i] += c
        J[i + 2, bw + j - i] += c

    return three


@overload(basis)
def _basis(k, axes):
    if len(axes) == 2:
        return lambda k, axes: (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0)
    return lambda k, axes: (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)


@kernel
def unit(u):
    """u / |u| and |u|; zero where u is zero."""
    size = math.sqrt(dot(u, u))
    return scale(1.0 / size if size > 0.0 else 0.0, u), size
