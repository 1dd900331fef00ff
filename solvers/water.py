"""Drag, current and the push of the seabed, shared by the lines: Morison's quadratic drag relative to the water.

Normal 1/2 rho d Cdn |u_n| u_n, tangential 1/2 rho pi d Cdt |u_t| u_t per metre; paper 003 eq. (2.1.11), D_n and D_t.
"""

from __future__ import annotations

import math

from .algebra import add_diagonal, add_outer, axpy, dot, row, scale
from .compile import kernel


@kernel
def current(z, levels, profile, axes):
    """Velocity of the water at level z and its gradient in z; zero without a profile."""
    n = len(levels)
    if n == 0:
        return axes, axes
    if not (z > levels[0]):
        return row(profile, 0, axes), axes
    for i in range(1, n):
        if z < levels[i]:
            lo, hi = row(profile, i - 1, axes), row(profile, i, axes)
            slope = scale(1.0 / (levels[i] - levels[i - 1]), axpy(-1.0, lo, hi))
            return axpy(z - levels[i - 1], slope, lo), slope
    return row(profile, n - 1, axes), axes


@kernel
def drag(u, t, cn, ct):
    """Force on the water [N] of a piece with unit tangent t moving at u relative to it (t = 0: the same all round)."""
    ut = dot(t, u)
    un = axpy(-ut, t, u)
    return axpy(cn * math.sqrt(dot(un, un)), un, scale(ct * abs(ut) * ut, t))


@kernel
def add_drag_rate(J, bw, i, j, c, u, t, cn, ct, axes):
    """J block (i, j) += c d(drag)/du = c (cn (|un| P + un un/|un|) + 2 ct |ut| t t)."""
    ut = dot(t, u)
    un = axpy(-ut, t, u)
    size = math.sqrt(dot(un, un))
    add_diagonal(J, bw, i, j, c * cn * size, axes)
    add_outer(J, bw, i, j, c * (2.0 * ct * abs(ut) - cn * size), t, t)
    if size > 0.0:
        add_outer(J, bw, i, j, c * cn / size, un, un)


@kernel
def add_turning(J, bw, i, left, right, c, inverse, t, u, a, cn, ct, swing):
    """J row block i: how drag and added mass change as the tangent t = (r_right - r_left) * inverse turns.

    ``swing`` is tangential minus normal added mass times the acceleration a's share; c multiplies everything.
    """
    ut, at = dot(t, u), dot(t, a)
    un, an = axpy(-ut, t, u), axpy(-at, t, a)
    size = math.sqrt(dot(un, un))
    c = c * inverse
    turn = c * (ct * abs(ut) * ut - cn * size * ut + swing * at)
    along = axpy(2.0 * ct * abs(ut) - cn * size, un, scale(swing, an))
    across = -c * cn * ut / size if size > 0.0 else 0.0
    for side in range(2):
        j = right if side == 0 else left
        sign = 1.0 if side == 0 else -1.0
        # turn (I - t t) + t (x) along + across un (x) un
        for k in range(len(t)):
            J[i + k, bw + j - i] += sign * turn
        add_outer(J, bw, i, j, -sign * turn, t, t)
        add_outer(J, bw, i, j, sign * c, t, along)
        add_outer(J, bw, i, j, sign * across, un, un)


@kernel
def bed_force(depth, vz, width, bed):
    """Normal force d l (k depth - c dz/dt) of the bed = (z, k, c, mu, v0), never pulling."""
    if depth <= 0.0:
        return 0.0
    push = width * (bed[1] * depth - bed[2] * vz)
    return 0.0 if push < 0.0 else push
