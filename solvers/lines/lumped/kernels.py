"""Equations of the lumped-mass line, paper 003 section 2.1 corrected, in the plane or in space.

Symbols: r, v, a of a node; d = r_j - r_i of a segment, p = d/|d|, l its rest length; t the node tangent (2.1.2);
c = p1.p2 at a bending joint; n the slide direction of a device, y its offset. F = M a - forces = 0.

Corrections: tension along the segment's own unit vector (2.1.3, 2.1.4); bending from the energy
V = 1/2 EI kappa^2 dl, kappa = 2 tan(theta/2)/dl (2.1.6-2.1.10), so V = (2 EI/dl) (1 - c)/(1 + c); a cord's damper acts
only while it is taut; the device's reaction acts along n, which turns with the cable (2.2.1).
"""

from __future__ import annotations

import math

from ...algebra import (
    across,
    add_column,
    add_diagonal,
    add_outer,
    add_row,
    add_to,
    axpy,
    basis,
    binormal,
    dot,
    load,
    row,
    scale,
    turn,
    turned,
    unit,
)
from ...compile import kernel
from ...devices import law_energy, law_force, law_gap, law_loss
from ...dispatch import CABLE, DEVICE, GRAVITY, KINETIC, ROTATION, SEABED, STRAIN, WATER
from ...motion import held
from ...water import add_drag_rate, add_turning, bed_force, current, drag

# Gauss points and half-weights of the drag on a rigid rod, whose velocity is linear between its ends
GAUSS = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))


def drive(t, pack, q, v, a):
    for k in range(len(pack.held)):
        i = pack.at[pack.held[k]]
        x, xdot, xddot = held(t, k, pack.motion, pack.axes)
        for m in range(len(pack.axes)):
            q[i + m], v[i + m], a[i + m] = x[m], xdot[m], xddot[m]


# ------------------------------------------------------------------------------------------------- forces


@kernel
def axial(q, v, pack, r):
    """Eqs. (2.1.3), (2.1.4): N = EA strain + BA strain rate along the segment; cut at zero where it cannot push."""
    for e in range(len(pack.rest)):
        i, j = pack.at[pack.ei[e]], pack.at[pack.ej[e]]
        d = axpy(-1.0, load(q, i, pack.axes), load(q, j, pack.axes))
        w = axpy(-1.0, load(v, i, pack.axes), load(v, j, pack.axes))
        p, size = unit(d)
        stretch = size / pack.rest[e] - 1.0
        tension = pack.EA[e] * stretch + pack.BA[e] * dot(p, w) / pack.rest[e]
        if not pack.push[e] and (stretch <= 0.0 or tension < 0.0):
            tension = 0.0
        pack.inverse[e] = 1.0 / size if size > 0.0 else 0.0
        for m in range(len(pack.axes)):
            pack.p[e, m] = p[m]
        add_to(r, j, tension, p)
        add_to(r, i, -tension, p)


@kernel
def bending(v, pack, r):
    """r += dV/dr of V = 2 k (1 - c)/(1 + c) at each joint, and its damping moment BI/dl (omega_2 - omega_1).

    Clamps are joints with a fixed phantom segment. In the plane the moment's rate is exact; in space omega = p x dp/dt
    leaves out the twist, an error of the order of the joint's angle.
    """
    for b in range(len(pack.joint)):
        e1, e2 = pack.joint[b, 0], pack.joint[b, 1]
        p1, p2 = row(pack.p, e1, pack.axes), row(pack.p, e2, pack.axes)
        c = dot(p1, p2)
        slope = -4.0 * pack.stiff[b] / (1.0 + c) ** 2
        g1 = scale(slope * pack.inverse[e1], axpy(-c, p1, p2))
        g2 = scale(slope * pack.inverse[e2], axpy(-c, p2, p1))
        if pack.damp[b] > 0.0:
            moment = joint_moment(v, b, pack)
            g1 = axpy(-pack.inverse[e1], turned(moment, p1), g1)
            g2 = axpy(pack.inverse[e2], turned(moment, p2), g2)
        add_to(r, pack.at[pack.ej[e1]], 1.0, g1)
        add_to(r, pack.at[pack.ei[e1]], -1.0, g1)
        add_to(r, pack.at[pack.ej[e2]], 1.0, g2)
        add_to(r, pack.at[pack.ei[e2]], -1.0, g2)


@kernel
def joint_moment(v, b, pack):
    """Damping moment of a joint, (BI/dl) (p2 x dp2/dt - p1 x dp1/dt)."""
    e1, e2 = pack.joint[b, 0], pack.joint[b, 1]
    w1 = axpy(-1.0, load(v, pack.at[pack.ei[e1]], pack.axes), load(v, pack.at[pack.ej[e1]], pack.axes))
    w2 = axpy(-1.0, load(v, pack.at[pack.ei[e2]], pack.axes), load(v, pack.at[pack.ej[e2]], pack.axes))
    spin1 = scale(pack.inverse[e1], turn(row(pack.p, e1, pack.axes), w1))
    spin2 = scale(pack.inverse[e2], turn(row(pack.p, e2, pack.axes), w2))
    return scale(pack.damp[b], axpy(-1.0, spin1, spin2))


@kernel
def surroundings(q, v, pack, r):
    """Steady loads, drag and seabed at the nodes; leaves each node's tangent and 1/chord in the pack."""
    top = len(pack.axes) - 1
    for i in range(len(pack.at)):
        k = pack.at[i]
        left, right = load(q, pack.at[pack.left[i]], pack.axes), load(q, pack.at[pack.right[i]], pack.axes)
        t, chord = unit(axpy(-1.0, left, right))
        pack.chord[i] = 1.0 / chord if chord > 0.0 else 0.0
        for m in range(len(pack.axes)):
            pack.t[i, m] = t[m]
        add_to(r, k, -pack.load_factor, row(pack.load, i, pack.axes))
        if len(pack.cn) > 0:
            u = load(v, k, pack.axes)
            if len(pack.levels) > 0:
                u = axpy(-pack.load_factor, current(q[k + top], pack.levels, pack.profile, pack.axes)[0], u)
            add_to(r, k, 1.0, drag(u, t, pack.cn[i], pack.ct[i]))
        if len(pack.bed) > 0:
            depth = pack.bed[0] - q[k + top]
            push = bed_force(depth, v[k + top], pack.bed_width[i], pack.bed)
            if push > 0.0:
                r[k + top] -= push
                speed = math.sqrt(slide_speed(v, k, top) + pack.bed[4] ** 2)
                for m in range(top):
                    r[k + m] += pack.bed[3] * push * v[k + m] / speed


@kernel
def slide_speed(v, k, top):
    """Squared horizontal speed."""
    total = 0.0
    for m in range(top):
        total += v[k + m] ** 2
    return total


@kernel
def rod_drag(q, v, pack, r):
    """Drag on rigid rods, whose velocity is linear between their ends: two Gauss points."""
    top = len(pack.axes) - 1
    for b in range(len(pack.rod)):
        i, j = pack.at[pack.ei[pack.rod[b]]], pack.at[pack.ej[pack.rod[b]]]
        t = row(pack.p, pack.rod[b], pack.axes)
        for g in range(2):
            x = GAUSS[g]
            z = (1.0 - x) * q[i + top] + x * q[j + top]
            stream = current(z, pack.levels, pack.profile, pack.axes)[0]
            u = axpy(
                -pack.load_factor,
                stream,
                axpy(x, load(v, j, pack.axes), scale(1.0 - x, load(v, i, pack.axes))),
            )
            f = drag(u, t, 0.5 * pack.rod_cn[b], 0.5 * pack.rod_ct[b])
            add_to(r, i, 1.0 - x, f)
            add_to(r, j, x, f)


@kernel
def host_state(x, d, pack):
    """Mean over a device's two hosts (twice the same one for a point mount)."""
    i, j = pack.at[pack.host[d, 0]], pack.at[pack.host[d, 1]]
    return scale(0.5, axpy(1.0, load(x, i, pack.axes), load(x, j, pack.axes)))


@kernel
def slide(d, pack):
    """Tangent of the host and slide direction of device d (zero for a device that cannot slide)."""
    t = row(pack.t, pack.host[d, 0], pack.axes)
    if pack.slot[d] < 0:
        return t, pack.axes
    return t, across(row(pack.aim, d, pack.axes), t)


@kernel
def row5(x, d):
    """A device's constants as a tuple."""
    return x[d, 0], x[d, 1], x[d, 2], x[d, 3], x[d, 4]


@kernel
def device_push(q, v, d, n, pack):
    """Drag less wet weight of device d's mass [N], before inertia."""
    push = scale(-pack.load_factor, row(pack.dev_load, d, pack.axes))
    if pack.dev_drag[d] > 0.0:
        u = host_state(v, d, pack)
        if len(pack.levels) > 0:
            z = host_state(q, d, pack)[len(pack.axes) - 1]
            u = axpy(-pack.load_factor, current(z, pack.levels, pack.profile, pack.axes)[0], u)
        if pack.slot[d] >= 0:
            u = axpy(v[pack.slot[d]], n, u)
        push = axpy(pack.dev_drag[d] * math.sqrt(dot(u, u)), u, push)
    return push


@kernel
def devices(q, v, pack, r):
    """Eq. (2.2.1): everything on a device's mass goes to its hosts in full and to its own row along n; its cords pull
    along n only, so the host feels them through the mass."""
    for d in range(len(pack.slot)):
        k = pack.slot[d]
        n = slide(d, pack)[1]
        push = device_push(q, v, d, n, pack)
        add_to(r, pack.at[pack.host[d, 0]], 0.5, push)
        add_to(r, pack.at[pack.host[d, 1]], 0.5, push)
        if k >= 0:
            r[k] += dot(n, push) + law_force(q[k], v[k], row5(pack.law, d))[0]


@kernel
def forces(q, v, pack, r):
    """r = minus all forces but inertia, in the order of eq. (2.1.11)."""
    r[:] = 0.0
    axial(q, v, pack, r)
    bending(v, pack, r)
    surroundings(q, v, pack, r)
    rod_drag(q, v, pack, r)
    devices(q, v, pack, r)


# ------------------------------------------------------------------------------------------------- inertia


@kernel
def swung(x, t, m, mn, mt):
    """(m + mn) x + (mt - mn) t (t.x): mass and added mass, normal mn and tangential mt."""
    return axpy((mt - mn) * dot(t, x), t, scale(m + mn, x))


@kernel
def rod_share(x, i, j, k, axes):
    """Consistent share of end k of a rod in a linear field: (2 x_k + x_other)/6."""
    xi, xj = load(x, i, axes), load(x, j, axes)
    if k == 0:
        return scale(1.0 / 6.0, axpy(2.0, xi, xj))
    return scale(1.0 / 6.0, axpy(2.0, xj, xi))


@kernel
def inertia(a, pack, r):
    """r += M a: nodes, rods (consistent mass: the exact rotary inertia of a slender rod), devices."""
    for i in range(len(pack.at)):
        k = pack.at[i]
        t = row(pack.t, i, pack.axes)
        add_to(r, k, 1.0, swung(load(a, k, pack.axes), t, pack.mass[i], pack.mn[i], pack.mt[i]))
    for b in range(len(pack.rod)):
        i, j = pack.at[pack.ei[pack.rod[b]]], pack.at[pack.ej[pack.rod[b]]]
        t = row(pack.p, pack.rod[b], pack.axes)
        for k in range(2):
            share = rod_share(a, i, j, k, pack.axes)
            add_to(r, i if k == 0 else j, 1.0, swung(share, t, pack.rod_m[b], pack.rod_mn[b], pack.rod_mt[b]))
    for d in range(len(pack.slot)):
        k = pack.slot[d]
        n = slide(d, pack)[1]
        push = scale(pack.dev_mass[d], host_state(a, d, pack))
        if k >= 0:
            push = axpy(pack.dev_mass[d] * a[k], n, push)
            r[k] += dot(n, push)
        add_to(r, pack.at[pack.host[d, 0]], 0.5, push)
        add_to(r, pack.at[pack.host[d, 1]], 0.5, push)


def residual(t, q, v, a, pack, r):
    forces(q, v, pack, r)
    inertia(a, pack, r)


@kernel
def in_frame(f, t, n, along, sliding, rest):
    """A tensor that is diagonal in the frame (t, n, t x n), applied to f."""
    return axpy((along - rest) * dot(t, f), t, axpy((sliding - rest) * dot(n, f), n, scale(rest, f)))


def accelerate(t, q, v, a, pack, r):
    """M is diagonal in each node's frame; rods couple two ends, a sliding mass is eliminated: all in closed form."""
    forces(q, v, pack, r)
    for i in range(len(pack.at)):
        k = pack.at[i]
        if pack.solo[i]:
            f, tan = load(r, k, pack.axes), row(pack.t, i, pack.axes)
            x = axpy((pack.inv_n[i] - pack.inv_t[i]) * dot(tan, f), tan, scale(-pack.inv_n[i], f))
            for m in range(len(pack.axes)):
                a[k + m] = x[m]
    for b in range(len(pack.rod)):
        i, j = pack.ei[pack.rod[b]], pack.ej[pack.rod[b]]
        tan = row(pack.p, pack.rod[b], pack.axes)
        fi, fj = scale(-1.0, load(r, pack.at[i], pack.axes)), scale(-1.0, load(r, pack.at[j], pack.axes))
        n = pack.axes
        d = pack.rod_device[b]
        if d >= 0 and pack.slot[d] >= 0:
            n = slide(d, pack)[1]
            fi, fj = axpy(0.5 * r[pack.slot[d]], n, fi), axpy(0.5 * r[pack.slot[d]], n, fj)
        inv = pack.rod_inv[b]
        xi = axpy(
            1.0,
            in_frame(fi, tan, n, inv[0, 0], inv[1, 0], inv[2, 0]),
            in_frame(fj, tan, n, inv[0, 1], inv[1, 1], inv[2, 1]),
        )
        xj = axpy(
            1.0,
            in_frame(fi, tan, n, inv[0, 1], inv[1, 1], inv[2, 1]),
            in_frame(fj, tan, n, inv[0, 2], inv[1, 2], inv[2, 2]),
        )
        for m in range(len(pack.axes)):
            a[pack.at[i] + m], a[pack.at[j] + m] = xi[m], xj[m]
    for d in range(len(pack.slot)):
        k = pack.slot[d]
        if k < 0:
            continue
        tan, n = slide(d, pack)
        i = pack.host[d, 0]
        if pack.host[d, 1] == i and pack.free[i]:
            f = axpy(r[k], n, scale(-1.0, load(r, pack.at[i], pack.axes)))
            x = in_frame(f, tan, n, pack.dev_inv[d, 0], pack.dev_inv[d, 1], pack.dev_inv[d, 2])
            for m in range(len(pack.axes)):
                a[pack.at[i] + m] = x[m]
        a[k] = -r[k] / pack.dev_mass[d] - dot(n, host_state(a, d, pack))
    for h in range(len(pack.held)):  # what a held node takes: its own row of M a
        i = pack.held[h]
        k = pack.at[i]
        add_to(
            r,
            k,
            1.0,
            swung(load(a, k, pack.axes), row(pack.t, i, pack.axes), pack.mass[i], pack.mn[i], pack.mt[i]),
        )
        for d in range(len(pack.slot)):
            if pack.host[d, 0] == i:
                push = scale(pack.dev_mass[d], load(a, k, pack.axes))
                if pack.slot[d] >= 0:
                    push = axpy(pack.dev_mass[d] * a[pack.slot[d]], slide(d, pack)[1], push)
                add_to(r, k, 1.0, push)


# ------------------------------------------------------------------------------------------------- tangent


@kernel
def axial_rate(q, v, cq, cv, pack, J):
    for e in range(len(pack.rest)):
        i, j = pack.at[pack.ei[e]], pack.at[pack.ej[e]]
        p, size = unit(axpy(-1.0, load(q, i, pack.axes), load(q, j, pack.axes)))
        w = axpy(-1.0, load(v, i, pack.axes), load(v, j, pack.axes))
        l = pack.rest[e]
        stretch = size / l - 1.0
        tension = pack.EA[e] * stretch + pack.BA[e] * dot(p, w) / l
        inverse = 1.0 / size if size > 0.0 else 0.0
        pack.inverse[e] = inverse
        for m in range(len(pack.axes)):
            pack.p[e, m] = p[m]
        if not pack.push[e] and (stretch <= 0.0 or tension < 0.0):
            continue
        along = cq * (pack.EA[e] / l - tension * inverse) + cv * pack.BA[e] / l
        across = cq * tension * inverse
        w = scale(cq * pack.BA[e] / l * inverse, axpy(-dot(w, p), p, w))
        for m in range(2):
            for n in range(2):
                x, y = (i if m == 0 else j), (i if n == 0 else j)
                sign = 1.0 if m == n else -1.0
                add_outer(J, pack.bw, x, y, sign * along, p, p)
                add_diagonal(J, pack.bw, x, y, sign * across, pack.axes)
                if pack.BA[e] > 0.0:
                    add_outer(J, pack.bw, x, y, sign, p, w)


@kernel
def bending_rate(v, cq, cv, pack, J):
    """Hessian of V and the rate of the damping moment, per pair of segments; K is a (2 dim, 2 dim) scratch block."""
    dim = len(pack.axes)
    K = pack.block
    for b in range(len(pack.joint)):
        e1, e2 = pack.joint[b, 0], pack.joint[b, 1]
        p1, p2 = row(pack.p, e1, pack.axes), row(pack.p, e2, pack.axes)
        c = dot(p1, p2)
        s1, s2 = pack.inverse[e1], pack.inverse[e2]
        slope, curve = -4.0 * pack.stiff[b] / (1.0 + c) ** 2, 8.0 * pack.stiff[b] / (1.0 + c) ** 3
        u1, u2 = axpy(-c, p1, p2), axpy(-c, p2, p1)
        for m in range(dim):
            for n in range(dim):
                one = 1.0 if m == n else 0.0
                p11, p22, p12 = one - p1[m] * p1[n], one - p2[m] * p2[n], p1[m] * u2[n]
                K[m, n] = (
                    cq * s1 * s1 * (curve * u1[m] * u1[n] - slope * (p1[m] * u1[n] + u1[m] * p1[n] + c * p11))
                )
                K[dim + m, dim + n] = (
                    cq * s2 * s2 * (curve * u2[m] * u2[n] - slope * (p2[m] * u2[n] + u2[m] * p2[n] + c * p22))
                )
                K[m, dim + n] = cq * s1 * s2 * (curve * u1[m] * u2[n] + slope * (p22 - p12))
                K[dim + n, m] = K[m, dim + n]
        if pack.damp[b] > 0.0:
            bending_damping_rate(v, cq, cv, b, pack, K)
        for s in range(4):
            x = pack.at[
                pack.ei[e1] if s == 0 else pack.ej[e1] if s == 1 else pack.ei[e2] if s == 2 else pack.ej[e2]
            ]
            for w in range(4):
                y = pack.at[
                    pack.ei[e1]
                    if w == 0
                    else pack.ej[e1]
                    if w == 1
                    else pack.ei[e2]
                    if w == 2
                    else pack.ej[e2]
                ]
                sign = 1.0 if (s + w) % 2 == 0 else -1.0
                for m in range(dim):
                    for n in range(dim):
                        J[x + m, pack.bw + y + n - x - m] += sign * K[s // 2 * dim + m, w // 2 * dim + n]


@kernel
def bending_damping_rate(v, cq, cv, b, pack, K):
    """K += cq d/dd + cv d/dw of h_s = sign_s (moment x p_s)/|d_s|, column by column."""
    dim = len(pack.axes)
    moment = joint_moment(v, b, pack)
    for s in range(2):
        e = pack.joint[b, s]
        inverse, p = pack.inverse[e], row(pack.p, e, pack.axes)
        sign = -1.0 if s == 0 else 1.0
        w = axpy(-1.0, load(v, pack.at[pack.ei[e]], pack.axes), load(v, pack.at[pack.ej[e]], pack.axes))
        for n in range(dim):
            x = basis(n, pack.axes)
            spin = scale(cv * inverse, turn(p, x))  # rate of p x w / |d|
            spin = axpy(-cq * inverse * inverse, axpy(2.0 * p[n], turn(p, w), turn(w, x)), spin)
            change = scale(sign * pack.damp[b], spin)
            for o in range(2):
                eo = pack.joint[b, o]
                po, io = row(pack.p, eo, pack.axes), pack.inverse[eo]
                so = -1.0 if o == 0 else 1.0
                h = scale(so * io, turned(change, po))
                if o == s:
                    own = axpy(-2.0 * p[n], turned(moment, p), turned(moment, x))
                    h = axpy(so * cq * io * io, own, h)
                for m in range(dim):
                    K[o * dim + m, s * dim + n] += h[m]


@kernel
def surroundings_rate(q, v, a, cq, cv, ca, pack, J):
    top = len(pack.axes) - 1
    for i in range(len(pack.at)):
        k = pack.at[i]
        L, R = pack.at[pack.left[i]], pack.at[pack.right[i]]
        t, chord = unit(axpy(-1.0, load(q, L, pack.axes), load(q, R, pack.axes)))
        inverse = 1.0 / chord if chord > 0.0 else 0.0
        for m in range(len(pack.axes)):
            pack.t[i, m] = t[m]
        pack.chord[i] = inverse
        add_diagonal(J, pack.bw, k, k, ca * (pack.mass[i] + pack.mn[i]), pack.axes)
        add_outer(J, pack.bw, k, k, ca * (pack.mt[i] - pack.mn[i]), t, t)
        u, cn, ct = load(v, k, pack.axes), 0.0, 0.0
        if len(pack.cn) > 0:
            cn, ct = pack.cn[i], pack.ct[i]
            stream, slope = current(q[k + top], pack.levels, pack.profile, pack.axes)
            u = axpy(-pack.load_factor, stream, u)
            add_drag_rate(J, pack.bw, k, k, cv, u, t, cn, ct, pack.axes)
            if cq != 0.0 and len(pack.levels) > 1:
                add_column(J, pack.bw, k, k + top, -cq * pack.load_factor, drag_push(u, slope, t, cn, ct))
        if cq != 0.0:
            swing = pack.mt[i] - pack.mn[i]
            add_turning(J, pack.bw, k, L, R, cq, inverse, t, u, load(a, k, pack.axes), cn, ct, swing)
        if len(pack.bed) > 0:
            bed_rate(q, v, cq, cv, k, top, pack.bed_width[i], pack, J)


@kernel
def drag_push(u, x, t, cn, ct):
    """d(drag)/du applied to x."""
    ut, xt = dot(t, u), dot(t, x)
    un = axpy(-ut, t, u)
    size = math.sqrt(dot(un, un))
    y = axpy(cn * size, axpy(-xt, t, x), scale(2.0 * ct * abs(ut) * xt, t))
    return axpy(cn * dot(un, x) / size if size > 0.0 else 0.0, un, y)


@kernel
def bed_rate(q, v, cq, cv, k, top, width, pack, J):
    depth, bw = pack.bed[0] - q[k + top], pack.bw
    push = bed_force(depth, v[k + top], width, pack.bed)
    if push <= 0.0:
        return
    rate = -width * (cq * pack.bed[1] + cv * pack.bed[2])  # of the push, per change in z
    J[k + top, bw] -= rate
    square = slide_speed(v, k, top) + pack.bed[4] ** 2
    speed = math.sqrt(square)
    for m in range(top):
        J[k + m, bw + top - m] += pack.bed[3] * rate * v[k + m] / speed
        for n in range(top):
            one = 1.0 if m == n else 0.0
            J[k + m, bw + n - m] += cv * pack.bed[3] * push / speed * (one - v[k + m] * v[k + n] / square)


@kernel
def rod_rate(q, v, a, cq, cv, ca, pack, J):
    top = len(pack.axes) - 1
    bw = pack.bw
    for b in range(len(pack.rod)):
        i, j = pack.at[pack.ei[pack.rod[b]]], pack.at[pack.ej[pack.rod[b]]]
        t, inverse = row(pack.p, pack.rod[b], pack.axes), pack.inverse[pack.rod[b]]
        m, mn, mt = pack.rod_m[b], pack.rod_mn[b], pack.rod_mt[b]
        for s in range(2):
            x = i if s == 0 else j
            for w in range(2):
                y = i if w == 0 else j
                share = 1.0 / 3.0 if s == w else 1.0 / 6.0
                add_diagonal(J, bw, x, y, ca * share * (m + mn), pack.axes)
                add_outer(J, bw, x, y, ca * share * (mt - mn), t, t)
            if cq != 0.0:
                add_turning(
                    J,
                    bw,
                    x,
                    i,
                    j,
                    cq,
                    inverse,
                    t,
                    pack.axes,
                    rod_share(a, i, j, s, pack.axes),
                    0.0,
                    0.0,
                    mt - mn,
                )
        cn, ct = 0.5 * pack.rod_cn[b], 0.5 * pack.rod_ct[b]
        for g in range(2):
            x = GAUSS[g]
            z = (1.0 - x) * q[i + top] + x * q[j + top]
            stream, slope = current(z, pack.levels, pack.profile, pack.axes)
            u = axpy(
                -pack.load_factor,
                stream,
                axpy(x, load(v, j, pack.axes), scale(1.0 - x, load(v, i, pack.axes))),
            )
            for s in range(2):
                ks, ws = (i, 1.0 - x) if s == 0 else (j, x)
                for w in range(2):
                    kw, ww = (i, 1.0 - x) if w == 0 else (j, x)
                    add_drag_rate(J, bw, ks, kw, cv * ws * ww, u, t, cn, ct, pack.axes)
                    if cq != 0.0 and len(pack.levels) > 1:
                        f = drag_push(u, slope, t, cn, ct)
                        add_column(J, bw, ks, kw + top, -cq * pack.load_factor * ws * ww, f)
                if cq != 0.0:
                    add_turning(J, bw, ks, i, j, cq * ws, inverse, t, u, pack.axes, cn, ct, 0.0)


@kernel
def devices_rate(q, v, a, cq, cv, ca, pack, J):
    top = len(pack.axes) - 1
    bw = pack.bw
    for d in range(len(pack.slot)):
        k, M = pack.slot[d], pack.dev_mass[d]
        h = pack.host[d, 0]
        t, n = slide(d, pack)
        ydot, yddot = 0.0, 0.0
        if k >= 0:
            ydot, yddot = v[k], a[k]
        # D = drag rate; the push is M (a_h + n yddot) - W + drag(v_h + n ydot - stream)
        stream, slope = pack.axes, pack.axes
        u = pack.axes
        size = 0.0
        c = pack.dev_drag[d]
        if c > 0.0:
            z = host_state(q, d, pack)[top]
            stream, slope = current(z, pack.levels, pack.profile, pack.axes)
            u = axpy(ydot, n, axpy(-pack.load_factor, stream, host_state(v, d, pack)))
            size = math.sqrt(dot(u, u))
        push = axpy(M, axpy(yddot, n, host_state(a, d, pack)), device_push(q, v, d, n, pack))
        Dn = device_drag_rate(u, n, size, c)
        Dslope = scale(-pack.load_factor, device_drag_rate(u, slope, size, c))
        for s in range(2):
            x = pack.at[pack.host[d, s]]
            for w in range(2):
                y = pack.at[pack.host[d, w]]
                add_diagonal(J, bw, x, y, 0.25 * (ca * M + cv * c * size), pack.axes)
                if size > 0.0:
                    add_outer(J, bw, x, y, 0.25 * cv * c / size, u, u)
                    add_column(J, bw, x, y + top, 0.25 * cq, Dslope)
            if k >= 0:
                add_column(J, bw, x, k, 0.5 * ca * M, n)
                add_column(J, bw, x, k, 0.5 * cv, Dn)
                add_row(J, bw, k, x, 0.5 * ca * M, n)
                add_row(J, bw, k, x, 0.5 * cv, Dn)
                J[k, bw + x + top - k] += 0.5 * cq * dot(n, Dslope)
        if k < 0:
            continue
        _, stiffness, damping = law_force(q[k], v[k], row5(pack.law, d))
        J[k, bw] += ca * M + cv * (damping + dot(n, Dn)) + cq * stiffness
        if cq == 0.0:
            continue
        # turning of n: dn = -(t (x) n + tilt b (x) b) dt, dt = (I - t t) (dr_R - dr_L)/chord
        bi = binormal(t, n)
        tilt = across_tilt(row(pack.aim, d, pack.axes), t)
        Qt = axpy(M * yddot, t, scale(ydot, device_drag_rate(u, t, size, c)))
        Qb = axpy(M * yddot, bi, scale(ydot, device_drag_rate(u, bi, size, c)))
        for side in range(2):
            y = pack.at[pack.right[h]] if side == 0 else pack.at[pack.left[h]]
            f = cq * pack.chord[h] if side == 0 else -cq * pack.chord[h]
            for s in range(2):
                x = pack.at[pack.host[d, s]]
                add_outer(J, bw, x, y, -0.5 * f, Qt, n)
                add_outer(J, bw, x, y, -0.5 * f * tilt, Qb, bi)
            add_row(J, bw, k, y, -f * (dot(t, push) + dot(n, Qt)), n)
            add_row(J, bw, k, y, -f * tilt * (dot(bi, push) + dot(n, Qb)), bi)


@kernel
def device_drag_rate(u, x, size, c):
    """d(c |u| u)/du applied to x."""
    if size == 0.0:
        return scale(0.0, x)
    return axpy(c * dot(u, x) / size, u, scale(c * size, x))


@kernel
def across_tilt(aim, t):
    """How far a given slide direction leans along the cable: (aim.t)/|aim across t|; zero in the plane."""
    if len(t) == 2:
        return 0.0
    along = dot(aim, t)
    over = axpy(-along, t, aim)
    size = math.sqrt(dot(over, over))
    return along / size if size > 0.0 else 0.0


def tangent(t, q, v, a, cq, cv, ca, pack, J):
    J[:] = 0.0
    axial_rate(q, v, cq, cv, pack, J)
    bending_rate(v, cq, cv, pack, J)
    surroundings_rate(q, v, a, cq, cv, ca, pack, J)
    rod_rate(q, v, a, cq, cv, ca, pack, J)
    devices_rate(q, v, a, cq, cv, ca, pack, J)


# ------------------------------------------------------------------------------------------------- energies


@kernel
def segment_energies(q, v, pack, e):
    for s in range(len(pack.rest)):
        i, j = pack.at[pack.ei[s]], pack.at[pack.ej[s]]
        p, size = unit(axpy(-1.0, load(q, i, pack.axes), load(q, j, pack.axes)))
        pack.inverse[s] = 1.0 / size if size > 0.0 else 0.0
        for m in range(len(pack.axes)):
            pack.p[s, m] = p[m]
        l = pack.rest[s]
        stretch = size / l - 1.0
        if not pack.push[s] and stretch <= 0.0:
            continue
        rate = dot(p, axpy(-1.0, load(v, i, pack.axes), load(v, j, pack.axes))) / l
        tension = pack.EA[s] * stretch + pack.BA[s] * rate
        if not pack.push[s] and tension < 0.0:
            tension = 0.0
        e[STRAIN] += 0.5 * pack.EA[s] * stretch * stretch * l
        e[DEVICE if pack.cord[s] else CABLE] += (tension - pack.EA[s] * stretch) * rate * l
    for b in range(len(pack.joint)):
        c = dot(row(pack.p, pack.joint[b, 0], pack.axes), row(pack.p, pack.joint[b, 1], pack.axes))
        e[STRAIN] += 2.0 * pack.stiff[b] * (1.0 - c) / (1.0 + c)
        if pack.damp[b] > 0.0:
            moment = joint_moment(v, b, pack)
            e[CABLE] += dot(moment, moment) / pack.damp[b]


@kernel
def spin(x, inverse, t):
    """Rate of a unit tangent whose chord changes at x."""
    return scale(inverse, axpy(-dot(t, x), t, x))


@kernel
def node_energies(q, v, pack, e):
    top = len(pack.axes) - 1
    for i in range(len(pack.at)):
        k = pack.at[i]
        L, R = pack.at[pack.left[i]], pack.at[pack.right[i]]
        t, chord = unit(axpy(-1.0, load(q, L, pack.axes), load(q, R, pack.axes)))
        inverse = 1.0 / chord if chord > 0.0 else 0.0
        pack.chord[i] = inverse
        for m in range(len(pack.axes)):
            pack.t[i, m] = t[m]
        x = load(v, k, pack.axes)
        swing = pack.mt[i] - pack.mn[i]
        vt = dot(t, x)
        e[KINETIC] += 0.5 * ((pack.mass[i] + pack.mn[i]) * dot(x, x) + swing * vt * vt)
        if swing != 0.0:
            turning = spin(axpy(-1.0, load(v, L, pack.axes), load(v, R, pack.axes)), inverse, t)
            e[ROTATION] += swing * vt * dot(x, turning)
        e[GRAVITY] -= pack.load_factor * dot(row(pack.load, i, pack.axes), load(q, k, pack.axes))
        if len(pack.cn) > 0:
            stream = current(q[k + top], pack.levels, pack.profile, pack.axes)[0]
            u = axpy(-pack.load_factor, stream, x)
            e[WATER] += dot(drag(u, t, pack.cn[i], pack.ct[i]), x)
        if len(pack.bed) > 0:
            depth = pack.bed[0] - q[k + top]
            if depth > 0.0:
                push = bed_force(depth, v[k + top], pack.bed_width[i], pack.bed)
                spring = pack.bed_width[i] * pack.bed[1] * depth
                square = slide_speed(v, k, top)
                e[STRAIN] += 0.5 * spring * depth
                e[SEABED] += (spring - push) * v[k + top] + pack.bed[3] * push * square / math.sqrt(
                    square + pack.bed[4] ** 2
                )


@kernel
def rod_energies(q, v, pack, e):
    top = len(pack.axes) - 1
    for b in range(len(pack.rod)):
        i, j = pack.at[pack.ei[pack.rod[b]]], pack.at[pack.ej[pack.rod[b]]]
        t = row(pack.p, pack.rod[b], pack.axes)
        vi, vj = load(v, i, pack.axes), load(v, j, pack.axes)
        m, swing = pack.rod_m[b] + pack.rod_mn[b], pack.rod_mt[b] - pack.rod_mn[b]
        ti, tj = dot(t, vi), dot(t, vj)
        e[KINETIC] += (
            m * (dot(vi, vi) + dot(vi, vj) + dot(vj, vj)) + swing * (ti * ti + ti * tj + tj * tj)
        ) / 6.0
        turning = spin(axpy(-1.0, vi, vj), pack.inverse[pack.rod[b]], t)
        si, sj = dot(turning, vi), dot(turning, vj)
        e[ROTATION] += swing * (2.0 * ti * si + ti * sj + tj * si + 2.0 * tj * sj) / 6.0
        for g in range(2):
            x = GAUSS[g]
            z = (1.0 - x) * q[i + top] + x * q[j + top]
            w = axpy(x, vj, scale(1.0 - x, vi))
            u = axpy(-pack.load_factor, current(z, pack.levels, pack.profile, pack.axes)[0], w)
            e[WATER] += dot(drag(u, t, 0.5 * pack.rod_cn[b], 0.5 * pack.rod_ct[b]), w)


@kernel
def device_energies(q, v, pack, e):
    for d in range(len(pack.slot)):
        k, M = pack.slot[d], pack.dev_mass[d]
        h = pack.host[d, 0]
        t, n = slide(d, pack)
        w = host_state(v, d, pack)
        weight = scale(pack.load_factor, row(pack.dev_load, d, pack.axes))
        e[GRAVITY] -= dot(weight, host_state(q, d, pack))
        push = axpy(1.0, device_push(q, v, d, n, pack), weight)  # drag alone
        if k >= 0:
            x = axpy(
                -1.0, load(v, pack.at[pack.left[h]], pack.axes), load(v, pack.at[pack.right[h]], pack.axes)
            )
            turning = spin(x, pack.chord[h], t)
            bi = binormal(t, n)
            tilt = across_tilt(row(pack.aim, d, pack.axes), t)
            ndot = axpy(-dot(n, turning), t, scale(-tilt * dot(bi, turning), bi))
            e[ROTATION] += M * v[k] * dot(w, ndot) - q[k] * dot(weight, ndot)
            w = axpy(v[k], n, w)
            e[GRAVITY] -= q[k] * dot(weight, n)
            e[STRAIN] += law_energy(q[k], row5(pack.law, d))
            e[DEVICE] += law_loss(q[k], v[k], row5(pack.law, d))
        e[KINETIC] += 0.5 * M * dot(w, w)
        e[WATER] += dot(push, w)


def energies(t, q, v, a, pack, e):
    e[:] = 0.0
    segment_energies(q, v, pack, e)
    node_energies(q, v, pack, e)
    rod_energies(q, v, pack, e)
    device_energies(q, v, pack, e)


def gaps(t, q, v, pack, g):
    m = 0
    for d in range(len(pack.slot)):
        if pack.slot[d] >= 0:
            g[m] = law_gap(q[pack.slot[d]], v[pack.slot[d]], row5(pack.law, d))
            m += 1
    for s in range(len(pack.rest)):
        if pack.cord[s]:
            i, j = pack.at[pack.ei[s]], pack.at[pack.ej[s]]
            p, size = unit(axpy(-1.0, load(q, i, pack.axes), load(q, j, pack.axes)))
            w = axpy(-1.0, load(v, i, pack.axes), load(v, j, pack.axes))
            stretch = size / pack.rest[s] - 1.0
            pull = stretch + pack.BA[s] / pack.EA[s] * dot(p, w) / pack.rest[s]
            g[m] = pull if not (stretch <= pull) else stretch
            m += 1
