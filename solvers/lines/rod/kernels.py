"""Equations of rods and catenaries, paper 001 corrected, in configuration form, and their exact tangent.

An element between nodes j and k = j + 1 of unstretched length l asks, with D = (r_k - r_j)/l, hats for values at its
middle (or at the af point of generalised-alpha in space), and spins omega = 2 Im(p' p*)/|p|^2:

    catenary (1)-(3)    D = t + c N,  t = N/|N|                       N_k - N_j = l (m a - F)
    rod (7), (8)        D = R [(1 + e) e3 + beta th x (th x e3)]       th = l (kappa0 + B^-1 R^T M)
        (9), (10)       M_k - M_j + l (D x N + Q) = l d/dt(R J R^T omega)    N_k - N_j = l (m a - F)

th is the rotation vector from frame j to frame k, so a uniform helix is exact; beta makes the chord that of the arc.
Forces and moments keep components in space, so that a hinge (12)-(14) is: the two domains share r and N, and M = 0. The
tension T of a catenary is |N| > 0: its direction is N itself, without polar angles (4), whose singular axis is gone.

The kinematic equations C = 0 of either kind are asked as dC/dt + C/tau = 0: statics sees C = 0, the time methods see a
velocity constraint (index 2, as (7) is), and C does not drift. For a rod dC/dt is (7) itself, with the spin's mean: the
constraint force then does exactly the work that the moment equation takes, and energy closes to the order of the mesh.

Drag (19) with |v_r.t| in its tangential part, over the stretched length (22); added mass (20) per metre, split into a
normal and a tangential part; the volume is that of the unstretched cable (a stretched one gets thinner), which (22),
(23) leave open.
"""

from __future__ import annotations

import math

import numpy as np

from ...algebra import add_diagonal, add_to, axpy, dot, load, row, scale, unit
from ...banded import factor_pivoting, substitute_pivoting
from ...compile import inlined, kernel
from ...dispatch import GRAVITY, KINETIC, ROTATION, SEABED, STRAIN, WATER
from ...motion import held
from ...rotation import (
    add_spin_turn,
    arc_factor,
    cross,
    dot4,
    frame,
    load4,
    mix,
    relative,
    relative_matrices,
    rotation_vector,
    spin_matrix,
    spin_of,
    times,
)
from ...water import bed_force, current, drag


def drive(t, pack, q, v, a):
    for k in range(len(pack.held)):
        i = pack.r[pack.held[k]]
        x, xdot, xddot = held(t, k, pack.motion, pack.axes)
        for m in range(3):
            q[i + m], v[i + m], a[i + m] = x[m], xdot[m], xddot[m]
    for k in range(len(pack.guided)):
        i = pack.p[pack.guided[k]]
        x, xdot, xddot = held(t, k, pack.twist, pack.axes)
        f = 0.5 * pack.load_factor
        c, s = math.cos(f * x[2]), math.sin(f * x[2])
        home = load4(pack.home[k], 0)
        w, dw = f * xdot[2], f * xddot[2]
        p = times(home, (c, 0.0, 0.0, s))
        turn = times(home, (-s, 0.0, 0.0, c))
        for m in range(4):
            q[i + m], v[i + m], a[i + m] = p[m], w * turn[m], dw * turn[m] - w * w * p[m]


@inlined
def state4(x, k, pack):
    """The quaternion of node k in the state x."""
    return load4(x, pack.p[k])


@kernel
def between(x, at, e, w, axes):
    """(1 - w) x_j + w x_k of the nodal vectors that start at `at`."""
    return axpy(w, load(x, at[e + 1], axes), scale(1.0 - w, load(x, at[e], axes)))


@kernel
def across(x, at, e, axes):
    """x_k - x_j."""
    return axpy(-1.0, load(x, at[e], axes), load(x, at[e + 1], axes))


@inlined
def middle(q, e, w, pack):
    """Quaternion of the element's middle frame, and the sign that the far one is taken with."""
    pj, pk = state4(q, e, pack), state4(q, e + 1, pack)
    sign = 1.0 if dot4(pj, pk) >= 0.0 else -1.0
    return mix(1.0 - w, pj, w * sign, pk), sign


@inlined
def mean_spin(q, v, e, w, pack):
    """(1 - w) omega_j + w omega_k."""
    one = spin_of(state4(q, e, pack), state4(v, e, pack))
    return axpy(w, spin_of(state4(q, e + 1, pack), state4(v, e + 1, pack)), scale(1.0 - w, one))


@kernel
def acceleration_of(p, rate, second):
    """d omega/dt = 2 Im(p'' p*)/|p|^2 - (d|p|^2/dt)/|p|^2 omega."""
    return axpy(-2.0 * dot4(p, rate) / dot4(p, p), spin_of(p, rate), spin_of(p, second))


@kernel
def tensor(d1, d2, d3, J, x):
    """R diag(J) R^T x."""
    return axpy(J[0] * dot(d1, x), d1, axpy(J[1] * dot(d2, x), d2, scale(J[2] * dot(d3, x), d3)))


@kernel
def swung(x, t, m, mn, mt):
    """(m + mn) x + (mt - mn) t (t.x): mass and added mass."""
    return axpy((mt - mn) * dot(t, x), t, scale(m + mn, x))


@inlined
def relative_speed(q, v, e, w, pack):
    """Velocity relative to the water."""
    u = between(v, pack.r, e, w, pack.axes)
    if len(pack.levels) > 0:
        z = between(q, pack.r, e, w, pack.axes)[2]
        u = axpy(-pack.load_factor, current(z, pack.levels, pack.profile, pack.axes)[0], u)
    return u


@inlined
def linear_momentum(q, v, a, e, w, wd, wp, at, pack, r):
    """Eqs. (3), (10): r[at:] += wp l (m a + m_a a - F) - wd (N_k - N_j)."""
    l = pack.l[e]
    D = across(q, pack.r, e, pack.axes)
    t, chord = unit(D)
    f = swung(between(a, pack.r, e, w, pack.axes), t, pack.mass[e], pack.mn[e], pack.mt[e])
    f = axpy(-pack.load_factor, row(pack.load, e, pack.axes), f)
    if len(pack.cn) > 0:
        f = axpy(chord / l, drag(relative_speed(q, v, e, w, pack), t, pack.cn[e], pack.ct[e]), f)
    if len(pack.bed) > 0:
        x, u = between(q, pack.r, e, w, pack.axes), between(v, pack.r, e, w, pack.axes)
        push = bed_force(pack.bed[0] - x[2], u[2], pack.bed_width[e], pack.bed)
        if push > 0.0:
            rub = pack.bed[3] * push / math.sqrt(u[0] * u[0] + u[1] * u[1] + pack.bed[4] ** 2)
            f = axpy(1.0, f, (rub * u[0], rub * u[1], -push))
    add_to(r, at, wp * l, f)
    add_to(r, at, -wd, across(q, pack.N, e, pack.axes))


@inlined
def catenary_element(q, v, a, e, w, wd, wp, at, pack, r):
    """Eqs. (1)-(3) with t + c N in place of (1 + e) t."""
    l = pack.l[e]
    N, rate = between(q, pack.N, e, w, pack.axes), between(v, pack.N, e, w, pack.axes)
    t, T = unit(N)
    inverse = 1.0 / T if T > 0.0 else 1e300
    stretch = axpy(inverse + pack.give[e, 3], rate, scale(-inverse * dot(t, rate), t))  # d/dt (t + c N)
    add_to(r, at, wd, across(v, pack.r, e, pack.axes))
    add_to(r, at, -wp * l, stretch)
    add_to(r, at, wd * pack.rate, across(q, pack.r, e, pack.axes))
    add_to(r, at, -wp * pack.rate * l, axpy(pack.give[e, 3], N, t))
    linear_momentum(q, v, a, e, w, wd, wp, at + 3, pack, r)


@inlined
def rod_element(q, v, a, e, w, wd, wp, at, pack, r):
    """Eqs. (7)-(10)."""
    l, give = pack.l[e], pack.give
    p = middle(q, e, w, pack)[0]
    d1, d2, d3 = frame(p)
    c, x = relative(state4(q, e, pack), state4(q, e + 1, pack))
    th = rotation_vector(c, x)[0]
    D = scale(1.0 / l, across(q, pack.r, e, pack.axes))
    N, M = between(q, pack.N, e, w, pack.axes), between(q, pack.M, e, w, pack.axes)
    Ndot, Mdot = between(v, pack.N, e, w, pack.axes), between(v, pack.M, e, w, pack.axes)
    omega = mean_spin(q, v, e, w, pack)
    y = axpy(give[e, 3], N, scale(give[e, 4], M))  # strain = d3.y
    ydot = axpy(give[e, 3], Ndot, scale(give[e, 4], Mdot))
    strain_rate = dot(d3, ydot) + dot(y, cross(omega, d3))
    beta = arc_factor(dot(th, th))[0]
    b1, b2 = beta * th[0] * th[2], beta * th[1] * th[2]
    b3 = 1.0 + dot(d3, y) - beta * (th[0] * th[0] + th[1] * th[1])
    chord = axpy(b1, d1, axpy(b2, d2, scale(b3, d3)))
    # (7), and its integral over time
    add_to(r, at, wd, across(v, pack.r, e, pack.axes))
    add_to(r, at, -wp * l, cross(omega, D))
    add_to(r, at, -wp * l * strain_rate, d3)
    add_to(r, at, wd * pack.rate * l, D)
    add_to(r, at, -wp * pack.rate * l, chord)
    linear_momentum(q, v, a, e, w, wd, wp, at + 3, pack, r)
    # (8) as kappa of the frames, with (6)
    f = pack.load_factor
    bend1 = f * pack.natural[e, 0] + give[e, 0] * dot(d1, M)
    bend2 = f * pack.natural[e, 1] + give[e, 1] * dot(d2, M)
    twist = f * pack.natural[e, 2] + give[e, 2] * dot(d3, M) + give[e, 4] * dot(d3, N)
    r[at + 6] += wd * th[0] - wp * l * bend1
    r[at + 7] += wd * th[1] - wp * l * bend2
    r[at + 8] += wd * th[2] - wp * l * twist
    # (9)
    J = row(pack.inertia, e, pack.axes)
    one = acceleration_of(state4(q, e, pack), state4(v, e, pack), state4(a, e, pack))
    two = acceleration_of(state4(q, e + 1, pack), state4(v, e + 1, pack), state4(a, e + 1, pack))
    spin = tensor(d1, d2, d3, J, axpy(w, two, scale(1.0 - w, one)))
    spin = axpy(1.0, cross(omega, tensor(d1, d2, d3, J, omega)), spin)
    if pack.space[0] != pack.space[2]:  # the equation holds at the af point, the chord at the middle
        D = scale(1.0 + dot(d3, y), d3)
    add_to(r, at + 9, -wd, across(q, pack.M, e, pack.axes))
    add_to(r, at + 9, wp * l, axpy(-1.0, cross(D, N), axpy(-f, row(pack.moment, e, pack.axes), spin)))


@inlined
def element(q, v, a, e, w, wd, wp, at, pack, r):
    if pack.rod[e]:
        rod_element(q, v, a, e, w, wd, wp, at, pack, r)
    else:
        catenary_element(q, v, a, e, w, wd, wp, at, pack, r)


@kernel
def share(e, part, space, head, row):
    """Row, place and weights with which element e enters its own equation (part 0) and the next one's (part 1).

    Generalised-alpha in space for Y' = Phi(Y), with its nodal rates eliminated between two elements, reads
    am dY_e/l_e + (1 - am) dY_{e-1}/l_{e-1} = g Phi_e + (1 - g) Phi_{e-1}, Phi at the af point of its element. The first
    element of a domain takes the box rule, and for rho = 1 (am = g = af = 1/2) all do. -1: it does not enter.
    """
    am, af, g = space
    if part == 0:
        if head[e] or am == g:
            return row[e], 0.5, 1.0, 1.0
        return row[e], af, am, g
    if am == g or e + 1 == len(row) or head[e + 1]:
        return -1, af, am, g
    return row[e + 1], af, 1.0 - am, 1.0 - g


def residual(t, q, v, a, pack, r):
    """Elements, then frames' gauges and hinges, then the ends: r there is the external force and, twice and in
    quaternion form, the external moment."""
    r[:] = 0.0
    for e in range(len(pack.l)):
        for part in range(2):
            at, w, wd, wp = share(e, part, pack.space, pack.head, pack.row)
            if at >= 0:
                element(q, v, a, e, w, wd, wp, at, pack, r)
    last = len(pack.r) - 1
    for i in range(last + 1):
        k = pack.frame_row[i]
        if k < 0:
            continue
        p = state4(q, i, pack)
        gauge = dot4(p, state4(v, i, pack)) + 0.5 * pack.rate * (dot4(p, p) - 1.0)
        if pack.hinge[i] == 0:
            r[k] = gauge
            continue
        m = scale(float(pack.hinge[i]), load(q, pack.M[i], pack.axes))
        if i == 0 or i == last:
            m = axpy(-pack.load_factor, row(pack.end_moment, 0 if i == 0 else 1, pack.axes), m)
        x = times((0.0, m[0], m[1], m[2]), p)
        for j in range(4):
            r[k + j] = 2.0 * x[j] + gauge * p[j]
    add_to(r, pack.r[0], -1.0, load(q, pack.N[0], pack.axes))
    add_to(r, pack.r[0], -pack.load_factor, row(pack.end_force, 0, pack.axes))
    add_to(r, pack.r[last], 1.0, load(q, pack.N[last], pack.axes))
    add_to(r, pack.r[last], -pack.load_factor, row(pack.end_force, 1, pack.axes))


# ------------------------------------------------------------------------------------------------- tangent


@kernel
def add_skew(A, c, u):
    """A += c [u]x, so that A x = c u x x."""
    A[0, 1] -= c * u[2]
    A[0, 2] += c * u[1]
    A[1, 0] += c * u[2]
    A[1, 2] -= c * u[0]
    A[2, 0] -= c * u[1]
    A[2, 1] += c * u[0]


@kernel
def add_pair(A, c, u, w):
    """A += c u (x) w."""
    for m in range(3):
        A[m, 0] += c * u[m] * w[0]
        A[m, 1] += c * u[m] * w[1]
        A[m, 2] += c * u[m] * w[2]


@kernel
def put(J, bw, i, j, c, A):
    """J block (i, j) += c A, A (3, 3) or (3, 4)."""
    for m in range(A.shape[0]):
        k = bw + j - i - m
        for n in range(A.shape[1]):
            J[i + m, k + n] += c * A[m, n]


@kernel
def put_product(J, bw, i, j, A, P):
    """J block (i, j) += A P, A (3, 3), P (3, 4)."""
    for m in range(3):
        k = bw + j - i - m
        a, b, c = A[m, 0], A[m, 1], A[m, 2]
        for n in range(4):
            J[i + m, k + n] += a * P[0, n] + b * P[1, n] + c * P[2, n]


@kernel
def put_difference(J, bw, i, at, e, c, axes):
    """J row block i += c d(x_k - x_j)."""
    add_diagonal(J, bw, i, at[e + 1], c, axes)
    add_diagonal(J, bw, i, at[e], -c, axes)


@kernel
def put_mean(J, bw, i, at, e, w, c, A):
    """J row block i += c A d((1 - w) x_j + w x_k)."""
    put(J, bw, i, at[e], c * (1.0 - w), A)
    put(J, bw, i, at[e + 1], c * w, A)


@inlined
def momentum_matrices(q, v, a, cq, cv, ca, e, w, wp, pack):
    """How the linear momentum changes with the mean motion (m3[13]) and with the chord (m3[14])."""
    l = pack.l[e]
    t, chord = unit(across(q, pack.r, e, pack.axes))
    swing = pack.mt[e] - pack.mn[e]
    mean, turn = pack.m3[13], pack.m3[14]
    inertia = ca * (pack.mass[e] + pack.mn[e])
    for m in range(3):
        for n in range(3):
            mean[m, n] = ca * swing * t[m] * t[n]
            turn[m, n] = 0.0
        mean[m, m] += inertia
    wet = len(pack.cn) > 0
    if wet:
        u = relative_speed(q, v, e, w, pack)
        ut = dot(t, u)
        un = axpy(-ut, t, u)
        size = math.sqrt(dot(un, un))
        cn, ct = pack.cn[e] * chord / l, pack.ct[e] * chord / l
        inverse = 1.0 / size if size > 0.0 else 0.0
        add_drag_matrix(mean, cv, t, ut, un, size, inverse, cn, ct)
    if cq != 0.0 and (wet or swing != 0.0):
        acc = between(a, pack.r, e, w, pack.axes)
        at_t = dot(t, acc)
        twist = swing * at_t
        along = scale(swing, axpy(-at_t, t, acc))
        if wet:
            twist += ct * abs(ut) * ut - cn * size * ut
            along = axpy(2.0 * ct * abs(ut) - cn * size, un, along)
            add_pair(turn, -cn * ut * inverse, un, un)
        # d(force)/dt over the chord, which turns t by (I - t t) dD: twist (I - t t) + t (x) along
        add_pair(turn, -twist, t, t)
        add_pair(turn, 1.0, t, along)
        for m in range(3):
            turn[m, m] += twist
        c = cq * wp * l / chord if chord > 0.0 else 0.0
        for m in range(3):
            for n in range(3):
                turn[m, n] *= c
        if wet:
            push = axpy(pack.cn[e] * size, un, scale(pack.ct[e] * abs(ut) * ut, t))
            add_pair(turn, cq * wp, push, t)
            if len(pack.levels) > 0:
                z = between(q, pack.r, e, w, pack.axes)[2]
                slope = scale(-pack.load_factor * cq, current(z, pack.levels, pack.profile, pack.axes)[1])
                inner = pack.m3[15]
                for m in range(3):
                    for n in range(3):
                        inner[m, n] = 0.0
                add_drag_matrix(inner, 1.0, t, ut, un, size, inverse, cn, ct)
                for m in range(3):
                    mean[m, 2] += dot(row(inner, m, pack.axes), slope)
    for m in range(3):
        for n in range(3):
            mean[m, n] *= wp * l


@inlined
def momentum_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at, pack, J):
    """J rows of the linear momentum."""
    bw, l = pack.bw, pack.l[e]
    momentum_matrices(q, v, a, cq, cv, ca, e, w, wp, pack)
    mean, turn = pack.m3[13], pack.m3[14]
    rj, rk, Nj, Nk = pack.r[e], pack.r[e + 1], pack.N[e], pack.N[e + 1]
    for m in range(3):
        i = at + m
        k = bw - i
        for n in range(3):
            J[i, k + rj + n] += (1.0 - w) * mean[m, n] - turn[m, n]
            J[i, k + rk + n] += w * mean[m, n] + turn[m, n]
        J[i, k + Nj + m] += wd * cq
        J[i, k + Nk + m] -= wd * cq
    if len(pack.bed) > 0:
        bed_rate(q, v, cq, cv, e, w, wp * l, at, pack, J)


@kernel
def add_drag_matrix(A, c, t, ut, un, size, inverse, cn, ct):
    """A += c d(drag)/du, with u = ut t + un, size = |un| and its inverse."""
    x, y, z = c * cn * size, c * (2.0 * ct * abs(ut) - cn * size), c * cn * inverse
    for m in range(3):
        for n in range(3):
            A[m, n] += y * t[m] * t[n] + z * un[m] * un[n]
        A[m, m] += x


@inlined
def bed_rate(q, v, cq, cv, e, w, c, at, pack, J):
    """How the bed's push and friction change."""
    bw, bed = pack.bw, pack.bed
    x, u = between(q, pack.r, e, w, pack.axes), between(v, pack.r, e, w, pack.axes)
    push = bed_force(bed[0] - x[2], u[2], pack.bed_width[e], bed)
    if push <= 0.0:
        return
    rate = -pack.bed_width[e] * (cq * bed[1] + cv * bed[2])  # of the push with z
    speed = math.sqrt(u[0] * u[0] + u[1] * u[1] + bed[4] ** 2)
    for side in range(2):
        share = c * (w if side == 1 else 1.0 - w)
        j = pack.r[e + 1] if side == 1 else pack.r[e]
        J[at + 2, bw + j - at] -= share * rate
        for m in range(2):
            J[at + m, bw + j + 2 - at - m] += share * rate * bed[3] * u[m] / speed
            J[at + m, bw + j - at] += share * cv * bed[3] * push / speed
            for n in range(2):
                J[at + m, bw + j + n - at - m] -= share * cv * bed[3] * push * u[m] * u[n] / speed**3


@inlined
def catenary_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at, pack, J):
    l, bw, c = pack.l[e], pack.bw, pack.give[e, 3]
    N, rate = between(q, pack.N, e, w, pack.axes), between(v, pack.N, e, w, pack.axes)
    t, T = unit(N)
    inverse = 1.0 / T if T > 0.0 else 1e300
    along = cv + cq * pack.rate
    s = cq * inverse * inverse  # the projector (I - t t)/T turns with N
    tr = dot(t, rate)
    diagonal, pair = along * (inverse + c) - s * tr, 3.0 * s * tr - along * inverse
    rj, rk, Nj, Nk = pack.r[e], pack.r[e + 1], pack.N[e], pack.N[e + 1]
    for m in range(3):
        i = at + m
        k = bw - i
        for n in range(3):
            x = pair * t[m] * t[n] - s * (t[m] * rate[n] + rate[m] * t[n])
            if m == n:
                x += diagonal
            J[i, k + Nj + n] -= wp * l * (1.0 - w) * x
            J[i, k + Nk + n] -= wp * l * w * x
        J[i, k + rj + m] -= wd * along
        J[i, k + rk + m] += wd * along
    momentum_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at + 3, pack, J)


@inlined
def rod_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at, pack, J):
    """As `rod_element`, by the variations of the middle frame (dphi), of th, of omega and of its rate."""
    l, bw, give, tau = pack.l[e], pack.bw, pack.give, pack.rate
    m3, m34 = pack.m3, pack.m34
    p, sign = middle(q, e, w, pack)
    d1, d2, d3 = frame(p)
    D = scale(1.0 / l, across(q, pack.r, e, pack.axes))
    N, M = between(q, pack.N, e, w, pack.axes), between(q, pack.M, e, w, pack.axes)
    omega = mean_spin(q, v, e, w, pack)
    y = axpy(give[e, 3], N, scale(give[e, 4], M))
    J3 = row(pack.inertia, e, pack.axes)
    # d omega and d(omega rate) by node: U, V
    for side in range(2):
        share = w if side == 1 else 1.0 - w
        pn, vn, an = state4(q, e + side, pack), state4(v, e + side, pack), state4(a, e + side, pack)
        U, V = m34[2 * side], m34[2 * side + 1]
        spin_matrix(pn, share * cv, U)
        spin_matrix(pn, share * ca, V)
        n2, speed = dot4(pn, pn), dot4(pn, vn)
        if cv != 0.0 or cq != 0.0:
            om = spin_of(pn, vn)
            P = m34[6]
            spin_matrix(pn, share, P)
            for m in range(3):
                for k in range(4):
                    V[m, k] -= cv * (2.0 * speed / n2 * P[m, k] + share * 2.0 / n2 * om[m] * pn[k])
            if cq != 0.0:
                P[:] = 0.0
                add_spin_turn(pn, vn, share * cq, P)
                for m in range(3):
                    for k in range(4):
                        U[m, k] += P[m, k]
                        V[m, k] -= 2.0 * speed / n2 * P[m, k]
                        V[m, k] -= cq * share * om[m] * (2.0 * vn[k] / n2 - 4.0 * speed * pn[k] / n2**2)
                add_spin_turn(pn, an, share * cq, V)
    A_omega, A_third = m3[0], m3[1]
    # rows (7): omega
    A_omega[:] = 0.0
    add_skew(A_omega, wp * l, D)
    add_pair(A_omega, -wp * l, d3, cross(d3, y))
    # rows (9): omega and its rate
    T_omega, T_rate = m3[2], m3[3]
    T_omega[:] = 0.0
    T_rate[:] = 0.0
    inertia = m3[4]
    inertia[:] = 0.0
    add_pair(inertia, J3[0], d1, d1)
    add_pair(inertia, J3[1], d2, d2)
    add_pair(inertia, J3[2], d3, d3)
    for m in range(3):
        for n in range(3):
            T_rate[m, n] = wp * l * inertia[m, n]
    skew_times(T_omega, wp * l, omega, inertia)
    add_skew(T_omega, -wp * l, tensor(d1, d2, d3, J3, omega))
    for side in range(2):
        j = pack.p[e + side]
        put_product(J, bw, at, j, A_omega, m34[2 * side])
        put_product(J, bw, at + 9, j, T_omega, m34[2 * side])
        put_product(J, bw, at + 9, j, T_rate, m34[2 * side + 1])
    # forces and moments
    put_difference(J, bw, at, pack.r, e, wd * (cv + cq * tau), pack.axes)
    A_third[:] = 0.0
    add_pair(A_third, -wp * l * (cv + cq * tau), d3, d3)
    if cq != 0.0:
        add_pair(A_third, -wp * l * cq, d3, cross(omega, d3))
    put_mean(J, bw, at, pack.N, e, w, give[e, 3], A_third)
    put_mean(J, bw, at, pack.M, e, w, give[e, 4], A_third)
    momentum_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at + 3, pack, J)
    if cq == 0.0:
        return
    c, x = relative(state4(q, e, pack), state4(q, e + 1, pack))
    th = rotation_vector(c, x)[0]
    square = dot(th, th)
    beta, beta_rate = arc_factor(square)
    b1, b2 = beta * th[0] * th[2], beta * th[1] * th[2]
    b3 = 1.0 + dot(d3, y) - beta * (th[0] * th[0] + th[1] * th[1])
    chord = axpy(b1, d1, axpy(b2, d2, scale(b3, d3)))
    Ndot, Mdot = between(v, pack.N, e, w, pack.axes), between(v, pack.M, e, w, pack.axes)
    ydot = axpy(give[e, 3], Ndot, scale(give[e, 4], Mdot))
    strain_rate = dot(d3, ydot) + dot(y, cross(omega, d3))
    Phi = m34[4]
    for side in range(2):
        share = w * sign if side == 1 else 1.0 - w
        spin_matrix(p, share * cq, m34[4 + side])
    relative_matrices(state4(q, e, pack), state4(q, e + 1, pack), cq, m34[7], m34[8])
    # (7): D, dphi, th
    A = m3[5]
    A[:] = 0.0
    add_skew(A, -wp * cq, omega)
    put(J, bw, at, pack.r[e + 1], 1.0, A)
    put(J, bw, at, pack.r[e], -1.0, A)
    A_phi, A_th = m3[6], m3[7]
    A_phi[:] = 0.0
    add_skew(A_phi, wp * l * strain_rate, d3)
    add_skew(A_phi, wp * l * tau, chord)
    turned = axpy(tau, y, axpy(1.0, ydot, cross(y, omega)))
    add_pair(A_phi, -wp * l, d3, cross(d3, turned))
    A_th[:] = 0.0
    # f = beta (th th3 - square e3): df = beta (th e3 + th3 I - 2 e3 th) + (th th3 - square e3) beta' th
    for n in range(3):
        f1 = beta * (th[0] * (1.0 if n == 2 else 0.0) + (th[2] if n == 0 else 0.0)) + th[0] * th[2] * beta_rate * th[n]
        f2 = beta * (th[1] * (1.0 if n == 2 else 0.0) + (th[2] if n == 1 else 0.0)) + th[1] * th[2] * beta_rate * th[n]
        f3 = beta * (th[2] * (2.0 if n == 2 else 0.0) - 2.0 * th[n]) + (th[2] ** 2 - square) * beta_rate * th[n]
        col = axpy(f1, d1, axpy(f2, d2, scale(f3, d3)))
        for m in range(3):
            A_th[m, n] = -wp * l * tau * col[m]
    # (8): dphi, M, N
    B_phi, B_M, B_N = m3[8], m3[9], m3[10]
    B_phi[:] = 0.0
    B_M[:] = 0.0
    B_N[:] = 0.0
    for k in range(3):
        d = d1 if k == 0 else d2 if k == 1 else d3
        s = -wp * l * give[e, k]
        turn = cross(d, M)
        for m in range(3):
            B_M[k, m] = s * cq * d[m]
            B_phi[k, m] = s * turn[m]
    turn = cross(d3, N)
    for m in range(3):
        B_N[2, m] = -wp * l * give[e, 4] * cq * d3[m]
        B_phi[2, m] -= wp * l * give[e, 4] * turn[m]
    put_mean(J, bw, at + 6, pack.M, e, w, 1.0, B_M)
    put_mean(J, bw, at + 6, pack.N, e, w, 1.0, B_N)
    # (9): dphi, N, D, M
    C_phi = m3[11]
    C_phi[:] = 0.0
    one = acceleration_of(state4(q, e, pack), state4(v, e, pack), state4(a, e, pack))
    two = acceleration_of(state4(q, e + 1, pack), state4(v, e + 1, pack), state4(a, e + 1, pack))
    alpha = axpy(w, two, scale(1.0 - w, one))
    times_skew(C_phi, wp * l, inertia, alpha)
    add_skew(C_phi, -wp * l, tensor(d1, d2, d3, J3, alpha))
    inner = m3[12]
    inner[:] = 0.0
    times_skew(inner, 1.0, inertia, omega)
    add_skew(inner, -1.0, tensor(d1, d2, d3, J3, omega))
    skew_times(C_phi, wp * l, omega, inner)
    off_middle = pack.space[0] != pack.space[2]
    if off_middle:
        D = scale(1.0 + dot(d3, y), d3)
    A[:] = 0.0
    add_skew(A, -wp * l * cq, D)
    put_mean(J, bw, at + 9, pack.N, e, w, 1.0, A)
    A[:] = 0.0
    if off_middle:  # D moves with N, M and the frame, not with the chord
        push = cross(N, d3)
        add_pair(A, wp * l * cq, push, d3)
        put_mean(J, bw, at + 9, pack.N, e, w, give[e, 3], A)
        put_mean(J, bw, at + 9, pack.M, e, w, give[e, 4], A)
        add_pair(C_phi, wp * l, push, cross(d3, y))
        inner[:] = 0.0
        add_skew(inner, 1.0, D)
        skew_times(C_phi, -wp * l, N, inner)
    else:
        add_skew(A, wp * cq, N)
        put(J, bw, at + 9, pack.r[e + 1], 1.0, A)
        put(J, bw, at + 9, pack.r[e], -1.0, A)
    put_difference(J, bw, at + 9, pack.M, e, -wd * cq, pack.axes)
    for side in range(2):
        j = pack.p[e + side]
        Phi = m34[4 + side]
        put_product(J, bw, at, j, A_phi, Phi)
        put_product(J, bw, at, j, A_th, m34[7 + side])
        put_product(J, bw, at + 6, j, B_phi, Phi)
        put(J, bw, at + 6, j, wd, m34[7 + side])
        put_product(J, bw, at + 9, j, C_phi, Phi)


@kernel
def skew_times(A, c, u, B):
    """A += c [u]x B."""
    for n in range(3):
        A[0, n] += c * (u[1] * B[2, n] - u[2] * B[1, n])
        A[1, n] += c * (u[2] * B[0, n] - u[0] * B[2, n])
        A[2, n] += c * (u[0] * B[1, n] - u[1] * B[0, n])


@kernel
def times_skew(A, c, B, u):
    """A += c B [u]x."""
    for m in range(3):
        A[m, 0] += c * (B[m, 1] * u[2] - B[m, 2] * u[1])
        A[m, 1] += c * (B[m, 2] * u[0] - B[m, 0] * u[2])
        A[m, 2] += c * (B[m, 0] * u[1] - B[m, 1] * u[0])


@inlined
def element_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at, pack, J):
    if pack.rod[e]:
        rod_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at, pack, J)
    else:
        catenary_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at, pack, J)


@inlined
def frame_rate(q, v, cq, cv, i, pack, J):
    """Gauges and hinges."""
    bw, k, j = pack.bw, pack.frame_row[i], pack.p[i]
    p, pdot = state4(q, i, pack), state4(v, i, pack)
    gauge = dot4(p, pdot) + 0.5 * pack.rate * (dot4(p, p) - 1.0)
    last = len(pack.r) - 1
    if pack.hinge[i] == 0:
        for n in range(4):
            J[k, bw + j + n - k] += cq * (pdot[n] + pack.rate * p[n]) + cv * p[n]
        return
    h = float(pack.hinge[i])
    m = scale(h, load(q, pack.M[i], pack.axes))
    if i == 0 or i == last:
        m = axpy(-pack.load_factor, row(pack.end_moment, 0 if i == 0 else 1, pack.axes), m)
    for n in range(4):
        unit4 = (
            1.0 if n == 0 else 0.0, 1.0 if n == 1 else 0.0, 1.0 if n == 2 else 0.0, 1.0 if n == 3 else 0.0,
        )  # fmt: skip
        x = times((0.0, m[0], m[1], m[2]), unit4)
        g = cq * (pdot[n] + pack.rate * p[n]) + cv * p[n]
        for s in range(4):
            J[k + s, bw + j + n - k - s] += cq * 2.0 * x[s] + g * p[s] + (cq * gauge if s == n else 0.0)
        if n > 0:
            x = times(unit4, p)
            for s in range(4):
                J[k + s, bw + pack.M[i] + n - 1 - k - s] += cq * 2.0 * h * x[s]


def tangent(t, q, v, a, cq, cv, ca, pack, J):
    """Clears and fills what is read of it; the rest of the storage, most of it in catenary rows, stays as it is."""
    for i in range(len(J)):
        for m in range(pack.bw + pack.clear[i, 0] - i, pack.bw + pack.clear[i, 1] - i + 1):
            J[i, m] = 0.0
    for e in range(len(pack.l)):
        for part in range(2):
            at, w, wd, wp = share(e, part, pack.space, pack.head, pack.row)
            if at >= 0:
                element_rate(q, v, a, cq, cv, ca, e, w, wd, wp, at, pack, J)
    last = len(pack.r) - 1
    for i in range(last + 1):
        if pack.frame_row[i] >= 0:
            frame_rate(q, v, cq, cv, i, pack, J)
    add_diagonal(J, pack.bw, pack.r[0], pack.N[0], -cq, pack.axes)
    add_diagonal(J, pack.bw, pack.r[last], pack.N[last], cq, pack.axes)


def constrained(pack):
    return True


def factorise(pack, J):
    """In place without catenaries; else J stays, and the small system is factored."""
    if len(pack.small.slot) == 0:
        return factor_pivoting(J, pack.bw, pack.first, pack.low, pack.high, pack.order, pack.end, pack.largest, 1e-15)
    s = pack.small
    if not condense(pack.rod, pack.head, pack.row, pack.r, pack.N, pack.bw, pack.first, pack.high, s, J):
        return False
    # beside the inertia over a short step squared, the force that a domain ends with is a small entry of its row
    return factor_pivoting(s.J, s.bw, s.first, s.low, s.high, s.order, s.end, s.largest, 1e-30)


def backsolve(pack, J, x):
    if len(pack.small.slot) == 0:
        substitute_pivoting(J, pack.bw, pack.low, pack.order, pack.end, x)
        return
    s = pack.small
    condense_right(pack.rod, pack.head, pack.row, pack.N, pack.bw, s, J, x)
    substitute_pivoting(s.J, s.bw, s.low, s.order, s.end, s.x)
    expand(pack.rod, pack.head, pack.row, pack.r, pack.N, pack.bw, s, J, x)


@kernel
def symmetric_times(G, e, u):
    """The symmetric matrix in row e of G times u."""
    return (
        G[e, 0] * u[0] + G[e, 3] * u[1] + G[e, 4] * u[2],
        G[e, 3] * u[0] + G[e, 1] * u[1] + G[e, 5] * u[2],
        G[e, 4] * u[0] + G[e, 5] * u[1] + G[e, 2] * u[2],
    )


@kernel
def invert(J, bw, k, j, G, e):
    """G[e] = -(block (k, j) of J)^-1, which is symmetric. False where it has none."""
    c = bw + j - k
    a11, a22, a33 = -J[k, c], -J[k + 1, c], -J[k + 2, c]
    a12, a13, a23 = -J[k, c + 1], -J[k, c + 2], -J[k + 1, c + 1]
    c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
    det = a11 * c11 + a12 * c12 + a13 * c13
    if not (abs(det) > 0.0):
        return False
    f = 1.0 / det
    G[e, 0], G[e, 1], G[e, 2] = f * c11, f * (a11 * a33 - a13 * a13), f * (a11 * a22 - a12 * a12)
    G[e, 3], G[e, 4], G[e, 5] = f * c12, f * c13, f * (a12 * a13 - a11 * a23)
    return True


@kernel
def clear(A, i, start, stop):
    """A[i, start:stop] = 0, with unsigned numbers, which numba does not look for negative ones among."""
    row = np.uint64(i)
    for m in range(np.uint64(start), np.uint64(max(start, stop))):
        A[row, m] = 0.0


@kernel
def copy_row(A, i, start, J, k, first, count):
    """A[i, start : start + count] = J[k, first : first + count]."""
    row, other, into, of = np.uint64(i), np.uint64(k), np.uint64(start), np.uint64(first)
    for m in range(np.uint64(0), np.uint64(count)):
        A[row, into + m] = J[other, of + m]


@kernel
def condense(rod, head, row, r, N, bw, first, high, s, J):
    """The small system of a tangent. With x_j, x_k of the nodes of a catenary element, its rows read

        a1 r_k - a0 r_j - Y (N_j + N_k) = f        A0 r_j + A1 r_k + b (N_j - N_k) = g

    so that 2 N_j = S - D and 2 N_k = S + D with S = Y^-1 (a1 r_k - a0 r_j - f) and D = (A0 r_j + A1 r_k - g)/b. Where
    two catenary elements meet, N_k of the one is N_j of the other: three equations in the positions of three nodes.
    """
    A, cw, slot = s.J, s.bw, s.slot
    for k in range(len(s.plain)):
        i = s.plain[k]
        c = slot[i]
        start, into, of = cw + s.clear[c, 0] - c, cw + slot[first[i]] - c, bw + first[i] - i
        width = high[i] - first[i] + 1
        clear(A, c, start, into)
        copy_row(A, c, into, J, i, of, width)
        clear(A, c, into + width, cw + s.clear[c, 1] - c + 1)
    for e in range(len(row)):
        if rod[e]:
            continue
        for m in range(0 if head[e] else 3, 6):
            c = slot[row[e] + m]
            clear(A, c, cw + s.clear[c, 0] - c, cw + s.clear[c, 1] - c + 1)
    for e in range(len(row)):
        if rod[e]:
            continue
        k = row[e]
        b = J[k + 3, bw + N[e] - k - 3]
        if b == 0.0 or not invert(J, bw, k, N[e], s.pull, e):
            return False
        G = s.pull
        a0, a1 = -J[k, bw + r[e] - k], J[k, bw + r[e + 1] - k]
        near = slot[k] if head[e] else slot[row[e - 1] + 3]
        far = slot[k + 3]
        rj, rk = slot[r[e]], slot[r[e + 1]]
        half = 0.5 / b
        for m in range(3):
            if m == 0:
                u = G[e, 0], G[e, 3], G[e, 4]
            elif m == 1:
                u = G[e, 3], G[e, 1], G[e, 5]
            else:
                u = G[e, 4], G[e, 5], G[e, 2]
            i, j = near + m, far + m
            o, p, q = k + 3 + m, bw + r[e] - k - 3 - m, bw + r[e + 1] - k - 3 - m
            near_j, near_k, far_j, far_k = cw + rj - i, cw + rk - i, cw + rj - j, cw + rk - j
            for n in range(3):
                x0, x1 = 0.5 * a0 * u[n], 0.5 * a1 * u[n]
                y0, y1 = half * J[o, p + n], half * J[o, q + n]
                A[i, near_j + n] += x0 + y0
                A[i, near_k + n] += y1 - x1
                A[j, far_j + n] += y0 - x0
                A[j, far_k + n] += x1 + y1
            if head[e]:
                A[i, cw + slot[N[e]] + m - i] = 1.0
            if e + 1 == len(row) or rod[e + 1]:
                A[j, cw + slot[N[e + 1]] + m - j] = -1.0
    return True


@kernel
def condense_right(rod, head, row, N, bw, s, J, x):
    """s.x = the right side x of the small system."""
    for k in range(len(s.plain)):
        s.x[s.slot[s.plain[k]]] = x[s.plain[k]]
    for e in range(len(row)):
        if rod[e]:
            continue
        k = row[e]
        half = 0.5 / J[k + 3, bw + N[e] - k - 3]
        u = symmetric_times(s.pull, e, (x[k], x[k + 1], x[k + 2]))
        near, far = s.slot[k] if head[e] else s.slot[row[e - 1] + 3], s.slot[k + 3]
        for m in range(3):
            g = half * x[k + 3 + m]
            if head[e]:
                s.x[near + m] = g - 0.5 * u[m]
            else:
                s.x[near + m] += g - 0.5 * u[m]
            s.x[far + m] = g + 0.5 * u[m]


@kernel
def expand(rod, head, row, r, N, bw, s, J, x):
    """x = the solution, of the small one s.x and the right side that x still is."""
    y, slot = s.x, s.slot
    for e in range(len(row)):
        if rod[e] or head[e]:
            continue
        k, rj, rk = row[e], slot[r[e]], slot[r[e + 1]]
        half = 0.5 / J[k + 3, bw + N[e] - k - 3]
        a0, a1 = -J[k, bw + r[e] - k], J[k, bw + r[e + 1] - k]
        u = symmetric_times(s.pull, e, (
            a1 * y[rk] - a0 * y[rj] - x[k],
            a1 * y[rk + 1] - a0 * y[rj + 1] - x[k + 1],
            a1 * y[rk + 2] - a0 * y[rj + 2] - x[k + 2],
        ))  # fmt: skip
        for m in range(3):
            d = -x[k + 3 + m]
            o, p, q = k + 3 + m, bw + r[e] - k - 3 - m, bw + r[e + 1] - k - 3 - m
            for n in range(3):
                d += J[o, p + n] * y[rj + n] + J[o, q + n] * y[rk + n]
            x[k + m] = 0.5 * u[m] - half * d
    for i in range(len(x)):
        if slot[i] >= 0:
            x[i] = y[slot[i]]


def heft(t, q, e, pack, r):
    """r = dF/da e: the inertia of an error of velocity."""
    r[:] = 0.0
    for k in range(len(pack.l)):
        f = pack.row[k] + 3
        t3 = unit(across(q, pack.r, k, pack.axes))[0]
        x = swung(between(e, pack.r, k, 0.5, pack.axes), t3, pack.mass[k], pack.mn[k], pack.mt[k])
        add_to(r, f, pack.l[k], x)
        if pack.rod[k]:
            d1, d2, d3 = frame(middle(q, k, 0.5, pack)[0])
            spin = mean_spin(q, e, k, 0.5, pack)
            add_to(r, f + 6, pack.l[k], tensor(d1, d2, d3, row(pack.inertia, k, pack.axes), spin))


# ------------------------------------------------------------------------------------------------- energies


def energies(t, q, v, a, pack, e):
    e[:] = 0.0
    f = pack.load_factor
    for k in range(len(pack.l)):
        l = pack.l[k]
        D = across(q, pack.r, k, pack.axes)
        t3, chord = unit(D)
        x, u = between(q, pack.r, k, 0.5, pack.axes), between(v, pack.r, k, 0.5, pack.axes)
        swing = pack.mt[k] - pack.mn[k]
        ut = dot(t3, u)
        e[KINETIC] += 0.5 * l * ((pack.mass[k] + pack.mn[k]) * dot(u, u) + swing * ut * ut)
        if swing != 0.0 and chord > 0.0:
            w = across(v, pack.r, k, pack.axes)
            turning = scale(1.0 / chord, axpy(-dot(t3, w), t3, w))
            e[ROTATION] += l * swing * ut * dot(u, turning)
        e[GRAVITY] -= f * l * dot(row(pack.load, k, pack.axes), x)
        if len(pack.cn) > 0:
            push = drag(relative_speed(q, v, k, 0.5, pack), t3, pack.cn[k], pack.ct[k])
            e[WATER] += chord * dot(push, u)
        if len(pack.bed) > 0:
            depth = pack.bed[0] - x[2]
            if depth > 0.0:
                push = l * bed_force(depth, u[2], pack.bed_width[k], pack.bed)
                spring = l * pack.bed_width[k] * pack.bed[1] * depth
                square = u[0] * u[0] + u[1] * u[1]
                e[STRAIN] += 0.5 * spring * depth
                e[SEABED] += (spring - push) * u[2] + pack.bed[3] * push * square / math.sqrt(square + pack.bed[4] ** 2)
        N = between(q, pack.N, k, 0.5, pack.axes)
        if not pack.rod[k]:
            T = math.sqrt(dot(N, N))
            e[STRAIN] += 0.5 * l * pack.give[k, 3] * T * T
            if not (T >= pack.least[0]):
                pack.least[0] = T
            continue
        d1, d2, d3 = frame(middle(q, k, 0.5, pack)[0])
        M = between(q, pack.M, k, 0.5, pack.axes)
        T, torque = dot(d3, N), dot(d3, M)
        m1, m2 = dot(d1, M), dot(d2, M)
        e[STRAIN] += 0.5 * l * (
            pack.give[k, 0] * m1 * m1 + pack.give[k, 1] * m2 * m2 + pack.give[k, 2] * torque * torque
            + pack.give[k, 3] * T * T + 2.0 * pack.give[k, 4] * T * torque
        )  # fmt: skip
        omega = mean_spin(q, v, k, 0.5, pack)
        e[KINETIC] += 0.5 * l * dot(omega, tensor(d1, d2, d3, row(pack.inertia, k, pack.axes), omega))
        e[ROTATION] += f * l * dot(row(pack.moment, k, pack.axes), omega)  # a steady moment has no potential
    last = len(pack.r) - 1
    for side in range(2):
        i = 0 if side == 0 else last
        e[GRAVITY] -= f * dot(row(pack.end_force, side, pack.axes), load(q, pack.r[i], pack.axes))
        if pack.p[i] >= 0:
            spin = spin_of(state4(q, i, pack), state4(v, i, pack))
            e[ROTATION] += f * dot(row(pack.end_moment, side, pack.axes), spin)
