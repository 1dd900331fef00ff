"""Equations of the local line: small planar motion about the static shape, papers 000 and 002, corrected.

Symbols: U, V tangential and normal displacement of a node from rest; e dynamic strain and phi dynamic angle of a
segment; Ts, phis, Qs = -EI phis'' tension, angle and shear at rest; W wet weight; ' along the unstretched arc s.

The papers write velocities u = U_t, v = V_t and four equations,

    m u_t        = EA e' + EI (phis' phi'' + phi' phis'') - W phi cos phis + F_t
    (m + ma) v_t = -EI phi''' + Ts phi' + EA e phis' + W phi sin phis + F_n
    e_t = u' - v phis',   phi_t = v' + u phis'

The last two are linear with coefficients constant in time: integrated from rest they are e = U' - V phis' and
phi = V' + U phis', so (U, V) are the only unknowns, of second order in time, and every method serves them. e and phi
live at the middles of segments, U and V at nodes: the staggered grid has no checkerboard mode.

With the equilibrium of the static shape the printed forces are the components of n' for the change of the force in
the line, n = (EA e - Qs phi) t + (Ts phi - EI phi'') n. So they follow from the energy

    V = int 1/2 EA e2 + 1/2 Ts phi2 + 1/2 EI phi'2 - Qs e phi  ds

up to one term: -Qs e beside Ts phi, which the papers drop with (1 + e) in the balance of moments. It is kept here:
without it the stiffness has no energy. V contains the work of gravity and of the static tension.

Corrections: tangential drag on the wetted perimeter pi d; its factor (1 + e)^1/2 is the contraction of the diameter.
Internal damping BA e_t and BI phi'_t, which the papers lack, stands beside EA e and EI phi'. F = M a - forces = 0.
"""

from __future__ import annotations

import math

from ...compile import kernel
from ...dispatch import CABLE, KINETIC, STRAIN, WATER
from ...motion import held


def drive(t, pack, q, v, a):
    """The end's displacement, turned from the vertical plane's axes into the end's tangent and normal."""
    for k in range(len(pack.held)):
        i = 2 * pack.held[k]
        c, s = pack.turn[k, 0], pack.turn[k, 1]
        x, xdot, xddot = held(t, k, pack.motion, pack.axes)
        q[i], q[i + 1] = c * x[0] + s * x[1], c * x[1] - s * x[0]
        v[i], v[i + 1] = c * xdot[0] + s * xdot[1], c * xdot[1] - s * xdot[0]
        a[i], a[i + 1] = c * xddot[0] + s * xddot[1], c * xddot[1] - s * xddot[0]


@kernel
def product(D, j, x):
    """Row j of the compatibility matrix times the four dofs of segment j."""
    k = 2 * j
    return D[j, 0] * x[k] + D[j, 1] * x[k + 1] + D[j, 2] * x[k + 2] + D[j, 3] * x[k + 3]


@kernel
def strains(q, v, pack):
    """e = U' - V phis', phi = V' + U phis' and their rates; derivatives in the turning frame are exact."""
    for j in range(len(pack.ds)):
        pack.e[j] = product(pack.De, j, q)
        pack.phi[j] = product(pack.Dphi, j, q)
        pack.edot[j] = product(pack.De, j, v)
        pack.phidot[j] = product(pack.Dphi, j, v)


@kernel
def moment(i, pack):
    """EI phi' + BI phi'_t at interior node i, between segments i - 1 and i."""
    return pack.stiff[i] * (pack.phi[i] - pack.phi[i - 1]) + pack.damp[i] * (pack.phidot[i] - pack.phidot[i - 1])


@kernel
def internal(pack, r):
    """r += the line's own forces: the gradient of V, and the internal damping."""
    segments = len(pack.ds)
    for j in range(segments):
        along = pack.ds[j] * (pack.EA[j] * pack.e[j] + pack.BA[j] * pack.edot[j] - pack.Qs[j] * pack.phi[j])
        across = pack.ds[j] * (pack.geo[j] * pack.phi[j] - pack.Qs[j] * pack.e[j])
        if len(pack.stiff) > 0:
            if j > 0:
                across += moment(j, pack)
            if j + 1 < segments:
                across -= moment(j + 1, pack)
        for m in range(4):
            r[2 * j + m] += along * pack.De[j, m] + across * pack.Dphi[j, m]


@kernel
def node_strain(i, pack):
    """Dynamic strain at a node: mean of its two segments, at an end its one segment's."""
    last = len(pack.ds)
    return 0.5 * (pack.e[max(i - 1, 0)] + pack.e[min(i, last - 1)])


@kernel
def contraction(i, pack):
    """(1 + e)^1/2 at node i."""
    return math.sqrt(max(1.0 + node_strain(i, pack), 0.0))


@kernel
def relative(i, v, pack):
    """Tangential and normal velocity of node i against the water (the current at the node's static depth)."""
    return (
        v[2 * i] - pack.load_factor * pack.stream[i, 0],
        v[2 * i + 1] - pack.load_factor * pack.stream[i, 1],
    )


@kernel
def water(v, pack, r):
    """F_t = -1/2 rho pi d Cdt |ur| ur (1 + e)^1/2, F_n = -1/2 rho d Cdn |vr| vr (1 + e)^1/2."""
    for i in range(len(pack.cn)):
        ut, un = relative(i, v, pack)
        f = contraction(i, pack)
        r[2 * i] += pack.ct[i] * abs(ut) * ut * f
        r[2 * i + 1] += pack.cn[i] * abs(un) * un * f


@kernel
def forces(q, v, pack, r):
    """r = minus all forces but inertia."""
    r[:] = 0.0
    strains(q, v, pack)
    internal(pack, r)
    water(v, pack, r)


def residual(t, q, v, a, pack, r):
    forces(q, v, pack, r)
    for i in range(len(pack.weight)):
        r[i] += pack.weight[i] * a[i]


def accelerate(t, q, v, a, pack, r):
    forces(q, v, pack, r)
    for i in range(2, len(pack.weight) - 2):
        a[i] = -r[i] / pack.weight[i]
    for k in range(len(pack.fixed)):
        i = pack.fixed[k]
        r[i] += pack.weight[i] * a[i]


@kernel
def internal_rate(cq, cv, pack, J):
    bw = pack.bw
    for j in range(len(pack.ds)):
        axial = pack.ds[j] * (cq * pack.EA[j] + cv * pack.BA[j])
        cross, geo = -pack.ds[j] * cq * pack.Qs[j], pack.ds[j] * cq * pack.geo[j]
        for m in range(4):
            along = axial * pack.De[j, m] + cross * pack.Dphi[j, m]
            across = geo * pack.Dphi[j, m] + cross * pack.De[j, m]
            for n in range(4):
                J[2 * j + m, bw + n - m] += along * pack.De[j, n] + across * pack.Dphi[j, n]
    for i in range(1, len(pack.stiff) - 1):
        k = cq * pack.stiff[i] + cv * pack.damp[i]
        if k != 0.0:
            for m in range(6):
                for n in range(6):
                    J[2 * i - 2 + m, bw + n - m] += k * bend(i, m, pack) * bend(i, n, pack)


@kernel
def bend(i, m, pack):
    """d(phi_i - phi_{i-1})/dq of the m-th of the six dofs of nodes i - 1, i, i + 1."""
    out = 0.0
    if m >= 2:
        out += pack.Dphi[i, m - 2]
    if m < 4:
        out -= pack.Dphi[i - 1, m]
    return out


@kernel
def water_rate(q, v, cq, cv, pack, J):
    bw, last = pack.bw, len(pack.ds) - 1
    strains(q, v, pack)
    for i in range(len(pack.cn)):
        ut, un = relative(i, v, pack)
        f = contraction(i, pack)
        J[2 * i, bw] += cv * 2.0 * pack.ct[i] * abs(ut) * f
        J[2 * i + 1, bw] += cv * 2.0 * pack.cn[i] * abs(un) * f
        if f == 0.0:
            continue
        slope = 0.25 * cq / f  # half of it for each of the two segments
        for side in range(2):
            j = max(i - 1, 0) if side == 0 else min(i, last)
            for n in range(4):
                J[2 * i, bw + 2 * (j - i) + n] += slope * pack.ct[i] * abs(ut) * ut * pack.De[j, n]
                J[2 * i + 1, bw + 2 * (j - i) + n - 1] += slope * pack.cn[i] * abs(un) * un * pack.De[j, n]


def tangent(t, q, v, a, cq, cv, ca, pack, J):
    J[:] = 0.0
    internal_rate(cq, cv, pack, J)
    water_rate(q, v, cq, cv, pack, J)
    for i in range(len(pack.weight)):
        J[i, pack.bw] += ca * pack.weight[i]


def energies(t, q, v, a, pack, e):
    """The strain energy is V: elastic, of the static tension and of gravity, all above the static state."""
    e[:] = 0.0
    strains(q, v, pack)
    for i in range(len(pack.weight)):
        e[KINETIC] += 0.5 * pack.weight[i] * v[i] ** 2
    for j in range(len(pack.ds)):
        x, y = pack.e[j], pack.phi[j]
        e[STRAIN] += pack.ds[j] * (0.5 * pack.EA[j] * x * x + 0.5 * pack.geo[j] * y * y - pack.Qs[j] * x * y)
        e[CABLE] += pack.ds[j] * pack.BA[j] * pack.edot[j] ** 2
    for i in range(1, len(pack.stiff) - 1):
        e[STRAIN] += 0.5 * pack.stiff[i] * (pack.phi[i] - pack.phi[i - 1]) ** 2
        e[CABLE] += pack.damp[i] * (pack.phidot[i] - pack.phidot[i - 1]) ** 2
    for i in range(len(pack.cn)):
        ut, un = relative(i, v, pack)
        f = contraction(i, pack)
        e[WATER] += f * (pack.ct[i] * abs(ut) * ut * v[2 * i] + pack.cn[i] * abs(un) * un * v[2 * i + 1])


def gaps(t, q, v, pack, g):
    pass
