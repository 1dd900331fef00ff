"""Equations of the Hermite line: a cable as a curve r(s) in a vertical plane, of stretch |r'| - 1 and curvature theta'.

Symbols: s unstretched arc length, ' = d/ds; p = r', c = r'', t = p/|p|; as complex numbers p = |p| exp(i theta).

    stretch e = |p| - 1,  N = EA e + BA e_t          curvature k = theta' = Im(c/p),  M = EI k + BI k_t

per unstretched metre, so that N and M are conjugate to them and V = int 1/2 EA e2 + 1/2 EI k2 ds: the bending energy
depends on the turning alone, as that of the lumped line, 1/2 EI theta2/l. (r' x r''/|r'|^3 would be the curvature per
stretched metre.) With w = c/p2 the rates are dk = Im(dc/p - w dp) and d2k = Im(2 w/p dp dp - 2/p2 dp dc).

Elements are cubic with r and r' at their ends, continuous in both, and integrated at three Gauss points: fewer lose
the tension's share of the transverse stiffness. Three strains in each element are one more than the slopes can follow
when the line bends without stretching, which locks it where EA is far above EI/h2. So the third, of shape P2, has the
stiffness EI/h2 at most: enough for slopes that all grow alike, which stretch nothing else, to swing as fast as the
shortest waves. It costs an elastica 1e-6 at eight elements. A section that does not bend or goes slack keeps EA there.
Only the inertia of mass and normal added mass is integrated exactly, see `params.inertia_of`; what the tangential
added mass differs by turns with the line. Slopes are continuous: where EA jumps between sections the tension is off
by the jump of strain in the two elements beside it.
"""

from __future__ import annotations

import math

from ...compile import kernel
from ...dispatch import CABLE, GRAVITY, KINETIC, ROTATION, SEABED, STRAIN, WATER
from ...motion import held
from ...water import bed_force, current, drag


def drive(t, pack, q, v, a):
    for k in range(len(pack.held)):
        i = 4 * pack.held[k]
        x, xdot, xddot = held(t, k, pack.motion, pack.axes)
        for m in range(2):
            q[i + m], v[i + m], a[i + m] = x[m], xdot[m], xddot[m]
        if pack.aim[k, 0] != 0.0 or pack.aim[k, 1] != 0.0:
            q[i + 3], v[i + 3], a[i + 3] = 0.0, 0.0, 0.0


# ------------------------------------------------------------------------------------------------- elements


@kernel
def turned(x, k, c, s):
    """The two slope dofs from k in the plane's axes, from their frame (c, s)."""
    return c * x[k] - s * x[k + 1], s * x[k] + c * x[k + 1]


@kernel
def gather(x, e, pack):
    """r_1 - r_0, slope 0, slope 1 of element e, and r_0."""
    k = 4 * e
    ax, az, bx, bz = x[k + 2], x[k + 3], x[k + 6], x[k + 7]
    if e == 0:
        ax, az = turned(x, 2, pack.turn[0, 0], pack.turn[0, 1])
    if e == len(pack.EA) - 1:
        bx, bz = turned(x, k + 6, pack.turn[1, 0], pack.turn[1, 1])
    return x[k + 4] - x[k], x[k + 5] - x[k + 1], ax, az, bx, bz, x[k], x[k + 1]


@kernel
def at(y, n, a, b):
    """A field or derivative without r_0 from an element's dofs and its three shape functions, both components."""
    return n * y[0] + a * y[2] + b * y[4], n * y[1] + a * y[3] + b * y[5]


@kernel
def spread(r, e, pack, fx, fz, ax, az, bx, bz, gx, gz):
    """r += forces f on r_1, a and b on the slopes 0 and 1, and g on r_0."""
    k = 4 * e
    if e == 0:
        c, s = pack.turn[0, 0], pack.turn[0, 1]
        ax, az = c * ax + s * az, c * az - s * ax
    if e == len(pack.EA) - 1:
        c, s = pack.turn[1, 0], pack.turn[1, 1]
        bx, bz = c * bx + s * bz, c * bz - s * bx
    r[k] += gx
    r[k + 1] += gz
    r[k + 2] += ax
    r[k + 3] += az
    r[k + 4] += fx
    r[k + 5] += fz
    r[k + 6] += bx
    r[k + 7] += bz


@kernel
def pull(e, stretch, rate, pack):
    """N = EA e + BA e_t; cut at zero where the section cannot push."""
    tension = pack.EA[e] * stretch + pack.BA[e] * rate
    if not pack.push[e] and (stretch <= 0.0 or tension < 0.0):
        return 0.0
    return tension


@kernel
def third(y, w, e, pack):
    """Third Legendre component of an element's strain, (e_0 - 2 e_1 + e_2)/1.8 of its Gauss points, and its rate."""
    S = pack.shape
    c, rate = 0.0, 0.0
    for g in range(3):
        px, pz = at(y, S[e, g, 3], S[e, g, 4], S[e, g, 5])
        ux, uz = at(w, S[e, g, 3], S[e, g, 4], S[e, g, 5])
        size = math.sqrt(px * px + pz * pz)
        share = -2.0 / 1.8 if g == 1 else 1.0 / 1.8
        c += share * size
        rate += share * (px * ux + pz * uz) / size if size > 0.0 else 0.0
    return c, rate


@kernel
def relief(y, w, e, pack):
    """What an element's third strain lacks in tension, over the Legendre function P2."""
    if pack.yields[e] == 0.0:
        return 0.0
    c, rate = third(y, w, e, pack)
    return pack.yields[e] * c + pack.relents[e] * rate


@kernel
def p2(g):
    """P2 at the Gauss points."""
    return -0.5 if g == 1 else 0.4


# ------------------------------------------------------------------------------------------------- forces


@kernel
def forces(q, v, pack, r):
    """r = minus all forces but inertia."""
    for i in range(len(r)):
        r[i] = -pack.load_factor * pack.load[i]
    S = pack.shape
    bends, drags, flows, beds = len(pack.EI) > 0, len(pack.cn) > 0, len(pack.levels) > 0, len(pack.bed) > 0
    for e in range(len(pack.EA)):
        y, w = gather(q, e, pack), gather(v, e, pack)
        fx, fz, ax, az, bx, bz, gx, gz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        less = relief(y, w, e, pack)
        for g in range(3):
            ds = S[e, g, 9]
            n, na, nb = S[e, g, 3], S[e, g, 4], S[e, g, 5]
            px, pz = at(y, n, na, nb)
            ux, uz = at(w, n, na, nb)
            size = math.sqrt(px * px + pz * pz)
            inverse = 1.0 / size if size > 0.0 else 0.0
            tx, tz = px * inverse, pz * inverse
            tension = ds * (pull(e, size - 1.0, tx * ux + tz * uz, pack) - p2(g) * less)
            sx, sz = tension * tx, tension * tz
            if bends:
                m, ma, mb = S[e, g, 6], S[e, g, 7], S[e, g, 8]
                cx, cz = at(y, m, ma, mb)
                ix, iz = tx * inverse, -tz * inverse  # 1/p
                kx, kz = cx * ix - cz * iz, cx * iz + cz * ix  # c/p
                wx, wz = kx * ix - kz * iz, kx * iz + kz * ix
                moment = pack.EI[e] * kz
                if pack.BI[e] > 0.0:
                    dx, dz = at(w, m, ma, mb)
                    moment += pack.BI[e] * (dx * iz + dz * ix - wx * uz - wz * ux)
                moment *= ds
                sx -= moment * wz
                sz -= moment * wx
                hx, hz = moment * iz, moment * ix
                fx += m * hx
                fz += m * hz
                ax += ma * hx
                az += ma * hz
                bx += mb * hx
                bz += mb * hz
            fx += n * sx
            fz += n * sz
            ax += na * sx
            az += na * sz
            bx += nb * sx
            bz += nb * sz
            if drags or beds:
                n, na, nb = S[e, g, 0], S[e, g, 1], S[e, g, 2]
                vx, vz = at(w, n, na, nb)
                vx, vz = vx + w[6], vz + w[7]
                z = n * y[1] + na * y[3] + nb * y[5] + y[7]
                dx, dz = 0.0, 0.0
                if drags:
                    ux, uz = vx, vz
                    if flows:
                        stream = current(z, pack.levels, pack.profile, pack.axes)[0]
                        ux, uz = vx - pack.load_factor * stream[0], vz - pack.load_factor * stream[1]
                    dx, dz = drag((ux, uz), (tx, tz), ds * pack.cn[e], ds * pack.ct[e])
                if beds:
                    push = bed_force(pack.bed[0] - z, vz, ds * pack.width[e], pack.bed)
                    if push > 0.0:
                        dz -= push
                        dx += pack.bed[3] * push * vx / math.sqrt(vx * vx + pack.bed[4] ** 2)
                fx += n * dx
                fz += n * dz
                ax += na * dx
                az += na * dz
                bx += nb * dx
                bz += nb * dz
                gx += dx
                gz += dz
        # what acts on r_1 through r_1 - r_0 acts on r_0 with the other sign
        spread(r, e, pack, fx, fz, ax, az, bx, bz, gx - fx, gz - fz)


@kernel
def push_inertia(q, a, e, pack, r):
    """r += M a of element e."""
    dx, dz, ax, az, bx, bz, x, z = gather(a, e, pack)
    M = pack.inertia[e]
    fx = M[0, 2] * x + M[1, 2] * ax + M[2, 2] * (x + dx) + M[2, 3] * bx
    fz = M[0, 2] * z + M[1, 2] * az + M[2, 2] * (z + dz) + M[2, 3] * bz
    gx = M[0, 0] * x + M[0, 1] * ax + M[0, 2] * (x + dx) + M[0, 3] * bx
    gz = M[0, 0] * z + M[0, 1] * az + M[0, 2] * (z + dz) + M[0, 3] * bz
    hx = M[0, 1] * x + M[1, 1] * ax + M[1, 2] * (x + dx) + M[1, 3] * bx
    hz = M[0, 1] * z + M[1, 1] * az + M[1, 2] * (z + dz) + M[1, 3] * bz
    ix = M[0, 3] * x + M[1, 3] * ax + M[2, 3] * (x + dx) + M[3, 3] * bx
    iz = M[0, 3] * z + M[1, 3] * az + M[2, 3] * (z + dz) + M[3, 3] * bz
    if len(pack.swing) > 0 and pack.swing[e] != 0.0:
        y, w = gather(q, e, pack), (dx, dz, ax, az, bx, bz, x, z)
        S = pack.shape
        for g in range(3):
            px, pz = at(y, S[e, g, 3], S[e, g, 4], S[e, g, 5])
            n, na, nb = S[e, g, 0], S[e, g, 1], S[e, g, 2]
            ux, uz = at(w, n, na, nb)
            f = px * px + pz * pz
            f = S[e, g, 9] * pack.swing[e] * (px * (ux + x) + pz * (uz + z)) / f if f > 0.0 else 0.0
            sx, sz = f * px, f * pz
            fx += n * sx
            fz += n * sz
            gx += (1.0 - n) * sx
            gz += (1.0 - n) * sz
            hx += na * sx
            hz += na * sz
            ix += nb * sx
            iz += nb * sz
    spread(r, e, pack, fx, fz, hx, hz, ix, iz, gx, gz)


def residual(t, q, v, a, pack, r):
    forces(q, v, pack, r)
    for e in range(len(pack.EA)):
        push_inertia(q, a, e, pack, r)


def heft(t, q, e, pack, r):
    for i in range(len(r)):
        r[i] = 0.0
    for m in range(len(pack.EA)):
        push_inertia(q, e, m, pack, r)


# ------------------------------------------------------------------------------------------------- acceleration


@kernel
def turn_element(K, e, pack):
    """Rows and columns of the turned slopes of an element's matrix K in their frames."""
    for side in range(2):
        if (side == 0 and e != 0) or (side == 1 and e != len(pack.EA) - 1):
            continue
        c, s, i = pack.turn[side, 0], pack.turn[side, 1], 2 + 4 * side
        for j in range(8):
            x, y = K[i, j], K[i + 1, j]
            K[i, j], K[i + 1, j] = c * x + s * y, c * y - s * x
        for j in range(8):
            x, y = K[j, i], K[j, i + 1]
            K[j, i], K[j, i + 1] = c * x + s * y, c * y - s * x


@kernel
def weigh_element(q, e, factor, pack):
    """pack.K += factor M of element e, slopes not yet turned."""
    K = pack.K
    for i in range(4):
        for j in range(4):
            x = factor * pack.inertia[e, i, j]
            K[2 * i, 2 * j] += x
            K[2 * i + 1, 2 * j + 1] += x
    if len(pack.swing) == 0 or pack.swing[e] == 0.0:
        return
    y, S = gather(q, e, pack), pack.shape
    for g in range(3):
        px, pz = at(y, S[e, g, 3], S[e, g, 4], S[e, g, 5])
        f = px * px + pz * pz
        f = factor * S[e, g, 9] * pack.swing[e] / f if f > 0.0 else 0.0
        xx, xz, zz = f * px * px, f * px * pz, f * pz * pz
        for i in range(4):
            for j in range(4):
                n = shape_at(S, e, g, i) * shape_at(S, e, g, j)
                K[2 * i, 2 * j] += n * xx
                K[2 * i, 2 * j + 1] += n * xz
                K[2 * i + 1, 2 * j] += n * xz
                K[2 * i + 1, 2 * j + 1] += n * zz


@kernel
def shape_at(S, e, g, i):
    """N of dof group i: r_0, slope 0, r_1, slope 1."""
    if i == 0:
        return 1.0 - S[e, g, 0]
    return S[e, g, 1] if i == 1 else S[e, g, 0] if i == 2 else S[e, g, 2]


@kernel
def factor_inertia(q, pack):
    """Cholesky factor of M in pack.band[i, 7 + j - i], j <= i; rows and columns of prescribed dofs are identity."""
    L, K = pack.band, pack.K
    for i in range(len(L)):
        for j in range(8):
            L[i, j] = 0.0
    for e in range(len(pack.EA)):
        K[:] = 0.0
        weigh_element(q, e, 1.0, pack)
        turn_element(K, e, pack)
        for i in range(8):
            for j in range(i + 1):
                L[4 * e + i, 7 + j - i] += K[i, j]
    for k in range(len(pack.fixed)):
        i = pack.fixed[k]
        for j in range(8):
            L[i, j] = 0.0
            if i + j < len(L):
                L[i + j, 7 - j] = 0.0
        L[i, 7] = 1.0
    for i in range(len(L)):
        for j in range(max(0, i - 7), i):
            x = L[i, 7 + j - i]
            for k in range(max(0, i - 7), j):
                x -= L[i, 7 + k - i] * L[j, 7 + k - j]
            L[i, 7 + j - i] = x * L[j, 7]
        x = L[i, 7]
        for k in range(max(0, i - 7), i):
            x -= L[i, 7 + k - i] ** 2
        L[i, 7] = 1.0 / math.sqrt(x)  # its inverse


@kernel
def solve_inertia(L, x):
    """Solve with the factor, x in place."""
    n = len(L)
    for i in range(n):
        y = x[i]
        for j in range(max(0, i - 7), i):
            y -= L[i, 7 + j - i] * x[j]
        x[i] = y * L[i, 7]
    for i in range(n - 1, -1, -1):
        y = x[i] * L[i, 7]
        x[i] = y
        for j in range(max(0, i - 7), i):
            x[j] -= L[i, 7 + j - i] * y


def accelerate(t, q, v, a, pack, r):
    """M is banded and symmetric; its factor is kept where it is constant."""
    last = len(pack.EA) - 1
    forces(q, v, pack, r)
    if len(pack.swing) > 0:
        factor_inertia(q, pack)
    own = pack.X[0]  # forces at the prescribed dofs, which are six at most
    k = 0
    for i in range(len(a)):
        if k < len(pack.fixed) and pack.fixed[k] == i:
            own[k] = r[i]
            k += 1
        else:
            a[i] = 0.0
    for e in range(0, last + 1, max(last, 1)):  # the given accelerations load the elements at the ends
        push_inertia(q, a, e, pack, r)
    k = 0
    for i in range(len(a)):
        if k < len(pack.fixed) and pack.fixed[k] == i:
            r[i] = own[k]
            k += 1
        else:
            a[i] = -r[i]
    solve_inertia(pack.band, a)
    for e in range(0, last + 1, max(last, 1)):  # what a held node takes: its own row of M a
        push_inertia(q, a, e, pack, r)


# ------------------------------------------------------------------------------------------------- tangent


@kernel
def drag_rate(u, t, cn, ct):
    """d(drag)/du = cn (|un| P + un un/|un|) + 2 ct |ut| t t, as (xx, xz, zz)."""
    ut = t[0] * u[0] + t[1] * u[1]
    nx, nz = u[0] - ut * t[0], u[1] - ut * t[1]
    size = math.sqrt(nx * nx + nz * nz)
    along, across = 2.0 * ct * abs(ut) - cn * size, cn / size if size > 0.0 else 0.0
    return (
        cn * size + along * t[0] * t[0] + across * nx * nx,
        along * t[0] * t[1] + across * nx * nz,
        cn * size + along * t[1] * t[1] + across * nz * nz,
    )


@kernel
def turning_rate(u, t, a, cn, ct, swing):
    """How drag and the swing t (t.a) change as the unit tangent t turns, times its chord: (xx, xz, zx, zz)."""
    ut, at = t[0] * u[0] + t[1] * u[1], t[0] * a[0] + t[1] * a[1]
    nx, nz = u[0] - ut * t[0], u[1] - ut * t[1]
    size = math.sqrt(nx * nx + nz * nz)
    turn = ct * abs(ut) * ut - cn * size * ut + swing * at
    along = 2.0 * ct * abs(ut) - cn * size
    lx, lz = along * nx + swing * (a[0] - at * t[0]), along * nz + swing * (a[1] - at * t[1])
    across = -cn * ut / size if size > 0.0 else 0.0
    return (
        turn * (1.0 - t[0] * t[0]) + t[0] * lx + across * nx * nx,
        -turn * t[0] * t[1] + t[0] * lz + across * nx * nz,
        -turn * t[0] * t[1] + t[1] * lx + across * nx * nz,
        turn * (1.0 - t[1] * t[1]) + t[1] * lz + across * nz * nz,
    )


@kernel
def inner_rate(y, w, less, e, g, cq, cv, pack):
    """Rates of the forces on p and c with p and c at a Gauss point, per metre: (pp, pc, cp) as (xx, xz, zx, zz), cc."""
    S = pack.shape
    px, pz = at(y, S[e, g, 3], S[e, g, 4], S[e, g, 5])
    ux, uz = at(w, S[e, g, 3], S[e, g, 4], S[e, g, 5])
    size = math.sqrt(px * px + pz * pz)
    inverse = 1.0 / size if size > 0.0 else 0.0
    tx, tz = px * inverse, pz * inverse
    rate = tx * ux + tz * uz
    tension = pull(e, size - 1.0, rate, pack)
    axx, axz, azx, azz = 0.0, 0.0, 0.0, 0.0
    if pack.push[e] or tension > 0.0:
        along, across = cq * pack.EA[e] + cv * pack.BA[e], cq * (tension - p2(g) * less) * inverse
        damp = cq * pack.BA[e] * inverse
        hx, hz = along * tx + damp * (ux - rate * tx), along * tz + damp * (uz - rate * tz)
        axx = tx * hx + across * tz * tz
        axz = tx * hz - across * tx * tz
        azx = tz * hx - across * tx * tz
        azz = tz * hz + across * tx * tx
    zero = (0.0, 0.0, 0.0, 0.0)
    if len(pack.EI) == 0:
        return (axx, axz, azx, azz), zero, zero, zero
    cx, cz = at(y, S[e, g, 6], S[e, g, 7], S[e, g, 8])
    ix, iz = tx * inverse, -tz * inverse  # 1/p
    kx, kz = cx * ix - cz * iz, cx * iz + cz * ix  # c/p
    wx, wz = kx * ix - kz * iz, kx * iz + kz * ix
    # gradient of the curvature with p and c; its second rates, [[Im A, Re A], [Re A, -Im A]], with pp and pc
    gx, gz, hx, hz = -wz, -wx, iz, ix
    ax, az = 2.0 * (wx * ix - wz * iz), 2.0 * (wx * iz + wz * ix)
    bx, bz = iz * iz - ix * ix, -2.0 * ix * iz
    moment, stiff = pack.EI[e] * kz, cq * pack.EI[e] + cv * pack.BI[e]
    jx, jz, kx, kz = stiff * gx, stiff * gz, stiff * hx, stiff * hz
    if pack.BI[e] > 0.0:
        dx, dz = at(w, S[e, g, 6], S[e, g, 7], S[e, g, 8])
        moment += pack.BI[e] * (gx * ux + gz * uz + hx * dx + hz * dz)
        damp = cq * pack.BI[e]
        jx += damp * (az * ux + ax * uz + bz * dx + bx * dz)
        jz += damp * (ax * ux - az * uz + bx * dx - bz * dz)
        kx += damp * (bz * ux + bx * uz)
        kz += damp * (bx * ux - bz * uz)
    moment *= cq
    ax, az, bx, bz = moment * ax, moment * az, moment * bx, moment * bz
    return (
        (axx + gx * jx + az, axz + gx * jz + ax, azx + gz * jx + ax, azz + gz * jz - az),
        (gx * kx + bz, gx * kz + bx, gz * kx + bx, gz * kz - bz),
        (hx * jx + bz, hx * jz + bx, hz * jx + bx, hz * jz - bz),
        (hx * kx, hx * kz, hz * kx, hz * kz),
    )


@kernel
def outer_rate(q, v, a, e, g, cq, cv, ca, pack):
    """Rates of the force of water, bed and swinging mass at a Gauss point, per metre, with r (its velocity and
    acceleration) and with p: two blocks (xx, xz, zx, zz)."""
    S = pack.shape
    y, w, b = gather(q, e, pack), gather(v, e, pack), gather(a, e, pack)
    px, pz = at(y, S[e, g, 3], S[e, g, 4], S[e, g, 5])
    size = math.sqrt(px * px + pz * pz)
    inverse = 1.0 / size if size > 0.0 else 0.0
    t = (px * inverse, pz * inverse)
    n, na, nb = S[e, g, 0], S[e, g, 1], S[e, g, 2]
    vx, vz = at(w, n, na, nb)
    vx, vz = vx + w[6], vz + w[7]
    z = n * y[1] + na * y[3] + nb * y[5] + y[7]
    u, slope, cn, ct, swing = (vx, vz), pack.axes, 0.0, 0.0, 0.0
    rxx, rxz, rzx, rzz = 0.0, 0.0, 0.0, 0.0
    if len(pack.cn) > 0:
        cn, ct = pack.cn[e], pack.ct[e]
        if len(pack.levels) > 0:
            stream, slope = current(z, pack.levels, pack.profile, pack.axes)
            u = (vx - pack.load_factor * stream[0], vz - pack.load_factor * stream[1])
        dxx, dxz, dzz = drag_rate(u, t, cn, ct)
        rxx, rxz, rzx, rzz = cv * dxx, cv * dxz, cv * dxz, cv * dzz
        rxz -= cq * pack.load_factor * (dxx * slope[0] + dxz * slope[1])
        rzz -= cq * pack.load_factor * (dxz * slope[0] + dzz * slope[1])
    acc = pack.axes
    if len(pack.swing) > 0:
        swing = pack.swing[e]
        rxx += ca * swing * t[0] * t[0]
        rxz += ca * swing * t[0] * t[1]
        rzx += ca * swing * t[0] * t[1]
        rzz += ca * swing * t[1] * t[1]
        bx, bz = at(b, n, na, nb)
        acc = (bx + b[6], bz + b[7])
    if len(pack.bed) > 0:
        push = bed_force(pack.bed[0] - z, vz, pack.width[e], pack.bed)
        if push > 0.0:
            rate = -pack.width[e] * (cq * pack.bed[1] + cv * pack.bed[2])  # of the push, per change in z
            rzz -= rate
            square = vx * vx + pack.bed[4] ** 2
            speed = math.sqrt(square)
            rxz += pack.bed[3] * rate * vx / speed
            rxx += cv * pack.bed[3] * push / speed * (1.0 - vx * vx / square)
    p = (0.0, 0.0, 0.0, 0.0)
    if cq != 0.0:
        xx, xz, zx, zz = turning_rate(u, t, acc, cn, ct, swing)
        f = cq * inverse
        p = (f * xx, f * xz, f * zx, f * zz)
    return (rxx, rxz, rzx, rzz), p


@kernel
def fill(X, row, S, e, g, f, A, first):
    """X[row : row + 2] += f A (x) the shape functions of order `first`/3 at a Gauss point."""
    for j in range(3):
        n = f * S[e, g, first + j]
        k = 4 if j == 0 else 2 if j == 1 else 6
        X[row, k] += n * A[0]
        X[row, k + 1] += n * A[1]
        X[row + 1, k] += n * A[2]
        X[row + 1, k + 1] += n * A[3]


@kernel
def stiffen_element(q, v, a, e, cq, cv, ca, pack):
    """pack.K += rates of element e but those of its constant inertia. Columns of r_0 hold what r_0 has beyond -r_1."""
    K, X, S = pack.K, pack.X, pack.shape
    y, w = gather(q, e, pack), gather(v, e, pack)
    surrounded = len(pack.cn) > 0 or len(pack.bed) > 0 or len(pack.swing) > 0
    less = relief(y, w, e, pack)
    for g in range(3):
        ds = S[e, g, 9]
        X[:] = 0.0
        if cq != 0.0 or cv != 0.0:
            pp, pc, cp, cc = inner_rate(y, w, less, e, g, cq, cv, pack)
            fill(X, 2, S, e, g, ds, pp, 3)
            fill(X, 2, S, e, g, ds, pc, 6)
            fill(X, 4, S, e, g, ds, cp, 3)
            fill(X, 4, S, e, g, ds, cc, 6)
        if surrounded:
            rr, rp = outer_rate(q, v, a, e, g, cq, cv, ca, pack)
            fill(X, 0, S, e, g, ds, rr, 0)
            fill(X, 0, S, e, g, ds, rp, 3)
            for j in range(2):  # r = r_0 + ...
                X[j, 0], X[j, 1] = ds * rr[2 * j], ds * rr[2 * j + 1]
        for j in range(3):
            i = 4 if j == 0 else 2 if j == 1 else 6
            n0, n1, n2 = S[e, g, j], S[e, g, 3 + j], S[e, g, 6 + j]
            for m in range(2):
                for k in range(8):
                    K[i + m, k] += n0 * X[m, k] + n1 * X[2 + m, k] + n2 * X[4 + m, k]
        if surrounded:
            for m in range(2):
                for k in range(8):
                    K[m, k] += X[m, k]
    if pack.yields[e] > 0.0 and (cq != 0.0 or cv != 0.0):
        relieve(y, w, e, cq, cv, pack)
    for k in range(8):  # r_1 - r_0
        K[0, k] -= K[4, k]
        K[1, k] -= K[5, k]
    for k in range(8):
        K[k, 0] -= K[k, 4]
        K[k, 1] -= K[k, 5]


@kernel
def relieve(y, w, e, cq, cv, pack):
    """pack.K -= rates of the third strain's relief of tension; P2 squared over the element is h/5."""
    K, X, S = pack.K, pack.X, pack.shape
    X[:] = 0.0
    length = 0.0
    for g in range(3):  # rows 0, 1: gradient of c and of its rate
        length += 0.2 * S[e, g, 9]
        px, pz = at(y, S[e, g, 3], S[e, g, 4], S[e, g, 5])
        ux, uz = at(w, S[e, g, 3], S[e, g, 4], S[e, g, 5])
        size = math.sqrt(px * px + pz * pz)
        inverse = 1.0 / size if size > 0.0 else 0.0
        tx, tz = px * inverse, pz * inverse
        rate = tx * ux + tz * uz
        share = -2.0 / 1.8 if g == 1 else 1.0 / 1.8
        for j in range(3):
            n = share * S[e, g, 3 + j]
            k = 4 if j == 0 else 2 if j == 1 else 6
            X[0, k] += n * tx
            X[0, k + 1] += n * tz
            X[1, k] += n * (ux - rate * tx) * inverse
            X[1, k + 1] += n * (uz - rate * tz) * inverse
    along = length * (cq * pack.yields[e] + cv * pack.relents[e])
    damp = length * cq * pack.relents[e]
    for i in range(2, 8):
        for j in range(2, 8):
            K[i, j] -= X[0, i] * (along * X[0, j] + damp * X[1, j])


def tangent(t, q, v, a, cq, cv, ca, pack, J):
    J[:] = 0.0
    K = pack.K
    for e in range(len(pack.EA)):
        K[:] = 0.0
        stiffen_element(q, v, a, e, cq, cv, ca, pack)
        if ca != 0.0:
            for i in range(4):
                for j in range(4):
                    x = ca * pack.inertia[e, i, j]
                    K[2 * i, 2 * j] += x
                    K[2 * i + 1, 2 * j + 1] += x
        turn_element(K, e, pack)
        for i in range(8):
            for j in range(8):
                J[4 * e + i, 7 + j - i] += K[i, j]


# ------------------------------------------------------------------------------------------------- energies


def energies(t, q, v, a, pack, e):
    for m in range(len(e)):
        e[m] = 0.0
    S = pack.shape
    for i in range(len(q)):
        e[GRAVITY] -= pack.load_factor * pack.load[i] * q[i]
    for m in range(len(pack.EA)):
        y, w = gather(q, m, pack), gather(v, m, pack)
        e[KINETIC] += element_kinetic(w, m, pack)
        if pack.yields[m] > 0.0:
            c, rate = third(y, w, m, pack)
            length = 0.2 * (S[m, 0, 9] + S[m, 1, 9] + S[m, 2, 9])
            e[STRAIN] -= 0.5 * length * pack.yields[m] * c * c
            e[CABLE] -= length * pack.relents[m] * rate * rate
        for g in range(3):
            ds = S[m, g, 9]
            px, pz = at(y, S[m, g, 3], S[m, g, 4], S[m, g, 5])
            ux, uz = at(w, S[m, g, 3], S[m, g, 4], S[m, g, 5])
            size = math.sqrt(px * px + pz * pz)
            inverse = 1.0 / size if size > 0.0 else 0.0
            tx, tz = px * inverse, pz * inverse
            stretch, rate = size - 1.0, tx * ux + tz * uz
            if pack.push[m] or stretch > 0.0:
                e[STRAIN] += 0.5 * ds * pack.EA[m] * stretch * stretch
                e[CABLE] += ds * (pull(m, stretch, rate, pack) - pack.EA[m] * stretch) * rate
            if len(pack.EI) > 0:
                cx, cz = at(y, S[m, g, 6], S[m, g, 7], S[m, g, 8])
                ix, iz = tx * inverse, -tz * inverse
                kx, kz = cx * ix - cz * iz, cx * iz + cz * ix
                e[STRAIN] += 0.5 * ds * pack.EI[m] * kz * kz
                if pack.BI[m] > 0.0:
                    dx, dz = at(w, S[m, g, 6], S[m, g, 7], S[m, g, 8])
                    wx, wz = kx * ix - kz * iz, kx * iz + kz * ix
                    e[CABLE] += ds * pack.BI[m] * (dx * iz + dz * ix - wx * uz - wz * ux) ** 2
            if len(pack.cn) == 0 and len(pack.bed) == 0 and len(pack.swing) == 0:
                continue
            n, na, nb = S[m, g, 0], S[m, g, 1], S[m, g, 2]
            vx, vz = at(w, n, na, nb)
            vx, vz = vx + w[6], vz + w[7]
            z = n * y[1] + na * y[3] + nb * y[5] + y[7]
            if len(pack.swing) > 0:
                along, turning = tx * vx + tz * vz, inverse * (tx * uz - tz * ux)
                e[KINETIC] += 0.5 * ds * pack.swing[m] * along * along
                e[ROTATION] += ds * pack.swing[m] * along * turning * (tx * vz - tz * vx)
            if len(pack.cn) > 0:
                stream = current(z, pack.levels, pack.profile, pack.axes)[0]
                u = (vx - pack.load_factor * stream[0], vz - pack.load_factor * stream[1])
                d = drag(u, (tx, tz), ds * pack.cn[m], ds * pack.ct[m])
                e[WATER] += d[0] * vx + d[1] * vz
            if len(pack.bed) > 0 and pack.bed[0] > z:
                depth = pack.bed[0] - z
                push = bed_force(depth, vz, ds * pack.width[m], pack.bed)
                spring = ds * pack.width[m] * pack.bed[1] * depth
                e[STRAIN] += 0.5 * spring * depth
                e[SEABED] += (spring - push) * vz + pack.bed[3] * push * vx * vx / math.sqrt(
                    vx * vx + pack.bed[4] ** 2
                )


@kernel
def element_kinetic(w, m, pack):
    """1/2 v M v of an element's constant inertia."""
    dx, dz, ax, az, bx, bz, x, z = w
    M = pack.inertia[m]
    ex, ez = x + dx, z + dz
    return (
        0.5 * (M[0, 0] * (x * x + z * z) + M[1, 1] * (ax * ax + az * az))
        + 0.5 * (M[2, 2] * (ex * ex + ez * ez) + M[3, 3] * (bx * bx + bz * bz))
        + M[0, 1] * (x * ax + z * az)
        + M[0, 2] * (x * ex + z * ez)
        + M[0, 3] * (x * bx + z * bz)
        + M[1, 2] * (ax * ex + az * ez)
        + M[1, 3] * (ax * bx + az * bz)
        + M[2, 3] * (ex * bx + ez * bz)
    )


def gaps(t, q, v, pack, g):
    pass
