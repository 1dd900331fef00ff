"""Equations of the transverse line: small motion across a straight chord, quasi-static along it.

Symbols: w(s, t) offset from the chord between the ends at rest, along its normal n; u_a, u_b moves of the ends along
the chord; ' along the unstretched arc s; W the tension that weight along the chord adds to its mean, int W/EA ds = 0;
N the mean tension; e the whole stretch; c the chord over the cable's length, which makes w'/c an angle.

    (m + ma) w_tt + (EI w'' + BI w_t'')''/c2 - ((N + W) w'/c)' + D |w_t - U| (w_t - U) = load + devices
    N = pull e + loss de/dt,   e = e0 + u_b - u_a + 1/2 int w'2/c ds,   pull = 1/int ds/EA

Along the cable the wave is faster than the motion, so N + W is in equilibrium at each moment. This is von Karman's
string or beam; its energy is 1/2 pull e2 + 1/2 int EI w''2/c2 + W w'2/c ds - loads. Left out: terms of the order of
the slope squared beside 1, and inertia along the cable.

w is a sum of cubic splines: with K, G, M the matrices of bending and W, of slopes and of mass, which never change,
F = M a + (K + N G) q + C v + drag - load; rows of u_a and u_b hold the pull on the ends. Matrices are symmetric and
stored by diagonals, D[m, i] = D(i, i + m).

Where masses are scaled, M is full but for the rows of prescribed dofs, which stay those of the bands. Its inverse is
then a full matrix too, as it is on short lines, where that is quicker than to solve by bands.
"""

from __future__ import annotations

from ...compile import kernel
from ...devices import law_energy, law_force, law_gap, law_loss
from ...dispatch import CABLE, DEVICE, GRAVITY, KINETIC, STRAIN, WATER
from ...motion import held


def drive(t, pack, q, v, a):
    """The ends' displacements along the chord and its normal; clamps keep their slope."""
    for k in range(2):
        x, xdot, xddot = held(t, k, pack.motion, pack.axes)
        for m in range(2):
            i, c, s = pack.ends[k, m], pack.frame[m, 0], pack.frame[m, 1]
            q[i] = c * x[0] + s * x[1]
            v[i] = c * xdot[0] + s * xdot[1]
            a[i] = c * xddot[0] + s * xddot[1]
    for k in range(len(pack.clamp)):
        i = pack.clamp[k]
        q[i], v[i], a[i] = pack.slope[k], 0.0, 0.0


@kernel
def times(D, x, y):
    """y = D x for a symmetric band matrix."""
    n = len(x)
    for i in range(n):
        y[i] = D[0, i] * x[i]
    for m in range(1, len(D)):
        for i in range(n - m):
            y[i] += D[m, i] * x[i + m]
        for i in range(n - m):
            y[i + m] += D[m, i] * x[i]


@kernel
def multiply(A, x, y):
    """y = A x for a symmetric full matrix, four rows at a time, which the processor adds side by side."""
    n = len(x)
    whole = n - n % 4
    for i in range(n):
        y[i] = 0.0
    for j in range(0, whole, 4):
        a, b, c, d = x[j], x[j + 1], x[j + 2], x[j + 3]
        for i in range(n):
            y[i] += (A[j, i] * a + A[j + 1, i] * b) + (A[j + 2, i] * c + A[j + 3, i] * d)
    for j in range(whole, n):
        for i in range(n):
            y[i] += A[j, i] * x[j]


@kernel
def momentum(pack, x, y):
    """y = M x"""
    if len(pack.full) > 0:
        multiply(pack.full, x, y)
    else:
        times(pack.M, x, y)


@kernel
def product(x, y):
    """x.y in four partial sums, which the processor adds side by side."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    n = len(x)
    whole = n - n % 4
    for i in range(0, whole, 4):
        a += x[i] * y[i]
        b += x[i + 1] * y[i + 1]
        c += x[i + 2] * y[i + 2]
        d += x[i + 3] * y[i + 3]
    for i in range(whole, n):
        a += x[i] * y[i]
    return (a + b) + (c + d)


@kernel
def stretching(q, v, pack):
    """Stretch e and its rate; leaves the gradient of e in pack.y."""
    times(pack.G, q, pack.y)
    last = len(q) - 1
    e = pack.stretch + q[last] - q[0] + 0.5 * product(q, pack.y)
    return e, v[last] - v[0] + product(v, pack.y)


@kernel
def crossing(p, v, pack):
    """Velocity of point p against the water."""
    i = pack.first[p]
    u = -pack.load_factor * pack.stream[p]
    for m in range(pack.width[p]):
        u += pack.shape[p, m] * v[i + m]
    return u


@kernel
def water(v, pack, r):
    for p in range(len(pack.cn)):
        u = crossing(p, v, pack)
        f = pack.cn[p] * abs(u) * u
        i = pack.first[p]
        for m in range(pack.width[p]):
            r[i + m] += f * pack.shape[p, m]


@kernel
def law(d, pack):
    """A device's constants as a tuple."""
    return pack.law[d, 0], pack.law[d, 1], pack.law[d, 2], pack.law[d, 3], pack.law[d, 4]


@kernel
def device_speed(d, v, pack):
    """Velocity of a device's mass along n, against the water."""
    u = v[pack.host[d]] - pack.load_factor * pack.dev_stream[d]
    if pack.slot[d] >= 0:
        u += pack.side[d] * v[pack.slot[d]]
    return u


@kernel
def devices(q, v, pack, r):
    """Everything on a device's mass goes to its host in full and to its own row along its slide direction."""
    for d in range(len(pack.slot)):
        k = pack.slot[d]
        if pack.dev_drag[d] > 0.0:
            u = device_speed(d, v, pack)
            f = pack.dev_drag[d] * abs(u) * u
            r[pack.host[d]] += f
            if k >= 0:
                r[k] += pack.side[d] * f
        if k >= 0:
            r[k] += law_force(q[k], v[k], law(d, pack))[0]


@kernel
def forces(q, v, pack, r):
    """r = minus all forces but inertia."""
    times(pack.K, q, r)
    e, rate = stretching(q, v, pack)
    N = pack.pull * e + pack.loss * rate
    for i in range(len(r)):
        r[i] += N * pack.y[i] - pack.load_factor * pack.load[i]
    r[0] -= N
    r[len(r) - 1] += N
    if len(pack.C) > 0:
        times(pack.C, v, pack.z)
        for i in range(len(r)):
            r[i] += pack.z[i]
    water(v, pack, r)
    devices(q, v, pack, r)


def residual(t, q, v, a, pack, r):
    forces(q, v, pack, r)
    momentum(pack, a, pack.z)
    for i in range(len(r)):
        r[i] += pack.z[i]


@kernel
def solve_mass(pack, x):
    """x <- M^-1 x at the free dofs, by the factors L D L^T; those of prescribed dofs are 1."""
    bw, n = pack.bw, len(x)
    for i in range(n):
        s = x[i]
        for m in range(1, min(bw, i) + 1):
            s -= pack.lower[i, m - 1] * x[i - m]
        x[i] = s
    for i in range(n):
        x[i] *= pack.inverse[i]
    for i in range(n - 1, 0, -1):
        s = x[i]
        for m in range(1, min(bw, i) + 1):
            x[i - m] -= pack.lower[i, m - 1] * s


def accelerate(t, q, v, a, pack, r):
    forces(q, v, pack, r)
    n = len(r)
    for i in range(n):
        pack.z[i] = -r[i]
    for k in range(len(pack.fixed)):
        i = pack.fixed[k]
        if a[i] == 0.0:  # an end at rest
            continue
        for m in range(1, len(pack.M)):
            if i + m < n:
                pack.z[i + m] -= pack.M[m, i] * a[i]
            if i - m >= 0:
                pack.z[i - m] -= pack.M[m, i - m] * a[i]
    for k in range(len(pack.fixed)):
        pack.z[pack.fixed[k]] = a[pack.fixed[k]]
    if len(pack.give) > 0:
        multiply(pack.give, pack.z, a)
        for k in range(len(pack.fixed)):
            a[pack.fixed[k]] = pack.z[pack.fixed[k]]
    else:
        solve_mass(pack, pack.z)
        for i in range(n):
            a[i] = pack.z[i]
    for k in range(len(pack.fixed)):
        i = pack.fixed[k]
        r[i] += pack.M[0, i] * a[i]
        for m in range(1, len(pack.M)):
            if i + m < n:
                r[i] += pack.M[m, i] * a[i + m]
            if i - m >= 0:
                r[i] += pack.M[m, i - m] * a[i - m]


@kernel
def add_band(c, D, bw, J):
    for i in range(D.shape[1]):
        J[i, bw] += c * D[0, i]
    for m in range(1, len(D)):
        for i in range(D.shape[1] - m):
            J[i, bw + m] += c * D[m, i]
            J[i + m, bw - m] += c * D[m, i]


def tangent(t, q, v, a, cq, cv, ca, pack, J):
    """All but the change of N, which couples every dof with every other: pull y y^T cq + loss (y y^T cv + ...).

    Newton's iterations in a time step converge without it: its frequency, sqrt(pull |w''|^2/m), is that of the motion.
    """
    J[:] = 0.0
    bw = pack.bw
    e, rate = stretching(q, v, pack)
    if len(pack.full) > 0:
        for i in range(len(v)):
            for m in range(len(v)):
                J[i, bw + m - i] += ca * pack.full[i, m]
    else:
        add_band(ca, pack.M, bw, J)
    if cq != 0.0:
        add_band(cq, pack.K, bw, J)
        add_band(cq * (pack.pull * e + pack.loss * rate), pack.G, bw, J)
    if len(pack.C) > 0:
        add_band(cv, pack.C, bw, J)
    for p in range(len(pack.cn)):
        c = cv * 2.0 * pack.cn[p] * abs(crossing(p, v, pack))
        i = pack.first[p]
        for m in range(pack.width[p]):
            for n in range(pack.width[p]):
                J[i + m, bw + n - m] += c * pack.shape[p, m] * pack.shape[p, n]
    for d in range(len(pack.slot)):
        h, k = pack.host[d], pack.slot[d]
        c = cv * 2.0 * pack.dev_drag[d] * abs(device_speed(d, v, pack))
        J[h, bw] += c
        if k >= 0:
            _, stiffness, damping = law_force(q[k], v[k], law(d, pack))
            J[k, bw] += c + cq * stiffness + cv * damping
            J[h, bw + k - h] += c * pack.side[d]
            J[k, bw + h - k] += c * pack.side[d]


@kernel
def form(D, x, pack):
    """1/2 x.D x"""
    times(D, x, pack.z)
    return 0.5 * product(x, pack.z)


@kernel
def lose(rate, q, v, pack, e):
    """Lost powers, the stretch changing at `rate` [m/s]."""
    e[CABLE] = pack.loss * rate * rate
    if len(pack.C) > 0:
        e[CABLE] += 2.0 * form(pack.C, v, pack)
    for p in range(len(pack.cn)):
        u = crossing(p, v, pack)
        e[WATER] += pack.cn[p] * abs(u) * u * (u + pack.load_factor * pack.stream[p])
    for d in range(len(pack.slot)):
        k = pack.slot[d]
        if pack.dev_drag[d] > 0.0:
            u = device_speed(d, v, pack)
            e[WATER] += pack.dev_drag[d] * abs(u) * u * (u + pack.load_factor * pack.dev_stream[d])
        if k >= 0:
            e[DEVICE] += law_loss(q[k], v[k], law(d, pack))


def losses(t, q, v, a, pack, e):
    e[:] = 0.0
    lose(stretching(q, v, pack)[1], q, v, pack, e)


def energies(t, q, v, a, pack, e):
    e[:] = 0.0
    x, rate = stretching(q, v, pack)
    momentum(pack, v, pack.z)
    e[KINETIC] = 0.5 * product(v, pack.z)
    e[STRAIN] = form(pack.B, q, pack) + 0.5 * pack.pull * x * x
    e[GRAVITY] = form(pack.W, q, pack) - pack.load_factor * product(pack.load, q)
    lose(rate, q, v, pack, e)
    for d in range(len(pack.slot)):
        if pack.slot[d] >= 0:
            e[STRAIN] += law_energy(q[pack.slot[d]], law(d, pack))


def gaps(t, q, v, pack, g):
    m = 0
    for d in range(len(pack.slot)):
        k = pack.slot[d]
        if k >= 0:
            g[m] = law_gap(q[k], v[k], law(d, pack))
            m += 1


def heft(t, q, e, pack, r):
    momentum(pack, e, r)
