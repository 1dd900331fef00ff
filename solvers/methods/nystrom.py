"""Symplectic Runge-Kutta-Nystrom of order 4: what impacts ring in the fastest modes is kept, at long steps.

Blanes & Moan, J. Comput. Appl. Math. 142 (2002) 313, the scheme SRKN6b: kicks b and drifts a in turn. What nothing
damps keeps its energy for good: the fastest mode to 2e-4 of it at h omega = 1.6, where an explicit Runge-Kutta pair of
order 5 must stop at 0.3 to 0.5 not to damp it.

Forces that depend on velocity take no part in that, for a kick's velocity is none at the kick's time. Each stage has
them from v_0 + h sum_j d_ij a_j instead. Order 4 asks of d, whose rows add up to c_i, that

    sum b d c = 1/6,  sum b c (d c) = 1/8,  sum b d c^2 = 1/12,  sum b d e = 1/24,  sum b d d c = 1/24

with e_i = sum_j b_j (c_i - c_j), which in a symplectic method is not c^2/2 (Hairer, Norsett & Wanner, II.14, with such
e). Of the many d that do, this is one by which a ringing line loses what it should: the rate at which light damping
takes energy from an oscillator, and sum b v^2, which drag goes with, are right to 3e-4 at h omega = 1.6. The last stage
has such a velocity too, so that the end of the step is evaluated once more: seven evaluations in a step.

The step is fixed but where a cord is taut or is about to be: there is no embedded error. Steps land on every break of
the motion, and on the kinks that the line names in ``gaps``. Samples between steps are those of `march.record`, on a
cubic: of the fastest mode, and of it alone, they miss up to two per cent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compile import kernel
from ..dispatch import N_ENERGIES, WATER, accelerate, drive, gaps, losses
from ..model import Status
from .explicit import first_kink
from .march import (
    C_EVALUATIONS,
    C_REJECTED,
    C_STEPS,
    L_LOST,
    L_WORK,
    N_LEDGER,
    advance,
    begin,
    close,
    copy,
    jump,
    power,
    record,
)

OK, DIVERGED, TOO_MANY_STEPS = int(Status.OK), int(Status.DIVERGED), int(Status.TOO_MANY_STEPS)
NEAR = 0.9  # of the way to a kink that a stage saw, for the next try


class Table(NamedTuple):
    """Drifts, kicks, times and velocities of the stages; the first is y_n, the last at the time of y_{n+1}."""

    a: np.ndarray  # (s - 1,)
    b: np.ndarray  # (s,)
    c: np.ndarray  # (s,)
    d: np.ndarray  # (s, s)


def _table() -> Table:
    b = [0.0829844064174052, 0.396309801498368, -0.0390563049223486]
    a = [0.245298957184271, 0.604872665711080]
    a, b = [*a, 0.5 - sum(a)], [*b, 1.0 - 2.0 * sum(b)]
    a, b = [*a, *a[::-1]], [*b, *b[-2::-1]]
    d = np.zeros((7, 7))
    for i, row in enumerate(
        [
            [],
            [0.245298957184271],
            [-0.3392627046367871, 1.189434327532138],
            [-0.02668926148599405, 0.44461534818634113, 0.08207391329965291],
            [0.37502727696869925, 0.10605744126791425, -0.0034475698680458177, -0.32780877126391866],
            [-0.07053335354090638, 0.6619173045045922, 0.028695971789182408, 0.23187108126897685, -0.09724996120611606],
            [0.24137629251744308, 0.41212365470964035, 0.33247674158725954, -0.020329075715985277, -0.07658848395354237,
             0.11094087085518464],
        ]
    ):  # fmt: skip
        d[i, : len(row)] = row
    return Table(np.array(a), np.array(b), np.append(0.0, np.cumsum(a)), d)


TABLE = _table()


class Work(NamedTuple):
    """Scratch of the march."""

    a: np.ndarray  # (stages, ndof) accelerations
    q: np.ndarray  # (ndof,)
    v: np.ndarray  # after the kicks
    u: np.ndarray  # at the stage's time
    r: np.ndarray
    before: np.ndarray  # (n_gaps,) at the start of the step
    g: np.ndarray
    sign: np.ndarray


def make_work(ndof: int, n_gaps: int) -> Work:
    def z(n: int) -> np.ndarray:
        return np.zeros(n)

    return Work(np.zeros((len(TABLE.c), ndof)), z(ndof), z(ndof), z(ndof), z(ndof), z(n_gaps), z(n_gaps),
                np.zeros(n_gaps, dtype=bool))  # fmt: skip


@kernel
def stages(t, h, lo, hi, pack, s, w, table, h_taut):
    """From row 0 of s to row 1 by a step h: the work at the prescribed dofs [J], and h. Or, where a stage saw a cord
    turn taut or slack in a step longer than such a cord allows, the next step to try, which ends before that."""
    n, last = len(w.q), len(table.a)
    copy(w.q, s.q[0])
    copy(w.a[0], s.a[0])
    for i in range(n):
        w.v[i] = s.v[0, i] + table.b[0] * h * w.a[0, i]
    work = table.b[0] * h * power(s.r[0], s.v[0], pack.fixed)
    for m in range(1, last + 1):
        kick, drift = table.b[m] * h, table.a[m - 1] * h
        for i in range(n):
            w.q[i] += drift * w.v[i]
            w.u[i] = s.v[0, i]
        for p in range(m):
            weight = h * table.d[m, p]
            for i in range(n):
                w.u[i] += weight * w.a[p, i]
        ts = min(max(t + table.c[m] * h, lo), hi)
        drive(ts, pack, w.q, w.u, w.a[m])
        if len(w.g) > 0:
            gaps(ts, w.q, w.u, pack, w.g)
            for k in range(len(w.g)):
                if (w.g[k] > 0.0) != w.sign[k] and h > 1.001 * h_taut[k]:
                    share = table.c[m] * w.before[k] / (w.before[k] - w.g[k])
                    return work, max(h_taut[k], NEAR * h * share if share > 0.0 else 0.0)
        accelerate(ts, w.q, w.u, w.a[m], pack, w.r)
        work += kick * power(w.r, w.u, pack.fixed)
        for i in range(n):
            w.v[i] += kick * w.a[m, i]
        for k in range(len(pack.fixed)):
            w.v[pack.fixed[k]] = w.u[pack.fixed[k]]
    copy(s.q[1], w.q)
    copy(s.v[1], w.v)
    drive(min(t + h, hi), pack, s.q[1], s.v[1], s.a[1])
    accelerate(min(t + h, hi), s.q[1], s.v[1], s.a[1], pack, s.r[1])
    return work, h


@kernel
def book(t, h, s, w, pack, start, work):
    """As `march.book`, for steps in which the fastest mode turns by two radians: losses by three Gauss points on the
    interpolant of degree 5 of the positions; two on a cubic of the velocities would miss a tenth of what it loses."""
    s.ledger[1, L_WORK] = s.ledger[0, L_WORK] + work
    for m in range(L_LOST, N_LEDGER):
        s.ledger[1, m] = s.ledger[0, m]
    for k in range(3):
        x = 0.5 + (k - 1.0) * math.sqrt(0.15)
        within(x, h, s, w.q, w.u)
        losses(t + x * h, w.q, w.u, s.a[1], pack, s.e[2])
        weight = h * (4.0 / 9.0 if k == 1 else 5.0 / 18.0)
        for m in range(N_ENERGIES - WATER):
            s.ledger[1, L_LOST + m] += weight * s.e[2, WATER + m]
    close(t, h, s, pack, start)


@kernel
def within(x, h, s, q, v):
    """Hermite interpolant of degree 5 of the positions at share x of the step, and its velocity."""
    y = 1.0 - x
    p1, p0 = x**3 * (10.0 - 15.0 * x + 6.0 * x * x), y**3 * (10.0 - 15.0 * y + 6.0 * y * y)
    q1, q0 = -h * x**3 * y * (4.0 - 3.0 * x), h * y**3 * x * (4.0 - 3.0 * y)
    r1, r0 = 0.5 * h * h * x**3 * y * y, 0.5 * h * h * y**3 * x * x
    d = 30.0 * x * x * y * y / h
    e1, e0 = -x * x * (12.0 - 28.0 * x + 15.0 * x * x), -y * y * (12.0 - 28.0 * y + 15.0 * y * y)
    f1, f0 = h * x * x * (1.5 - 4.0 * x + 2.5 * x * x), -h * y * y * (1.5 - 4.0 * y + 2.5 * y * y)
    for i in range(len(q)):
        q[i] = (p0 * s.q[0, i] + q0 * s.v[0, i] + r0 * s.a[0, i]
                + p1 * s.q[1, i] + q1 * s.v[1, i] + r1 * s.a[1, i])  # fmt: skip
        v[i] = (d * (s.q[1, i] - s.q[0, i]) + e0 * s.v[0, i] + f0 * s.a[0, i]
                + e1 * s.v[1, i] + f1 * s.a[1, i])  # fmt: skip


@kernel
def march(pack, s, out, w, pieces, table, h_most, h_taut, max_steps):
    """March at step `h_most`, at most `h_taut` where a gap is positive or changes its sign; other arguments as in
    `explicit.march`. Returns a status."""
    n, n_gaps = len(w.q), len(w.g)
    start = 0.0
    for piece in range(len(pieces) - 1):
        t, stop = pieces[piece], pieces[piece + 1]
        lo, hi = np.nextafter(t, 1e300), np.nextafter(stop, -1e300)
        if piece == 0:
            start = begin(lo, s, pack)
        drive(lo, pack, s.q[0], s.v[0], s.a[0])
        accelerate(lo, s.q[0], s.v[0], s.a[0], pack, s.r[0])
        out.counts[C_EVALUATIONS] += 1
        jump(lo, s, pack)
        most = h_most  # of the next try
        landing = False
        while t < stop:
            if out.counts[C_STEPS] >= max_steps:
                return TOO_MANY_STEPS
            h = most
            if n_gaps > 0:
                gaps(t, s.q[0], s.v[0], pack, w.before)
                for k in range(n_gaps):
                    w.sign[k] = w.before[k] > 0.0
                    if w.sign[k] and h > h_taut[k] and not landing:
                        h = h_taut[k]
            last = False
            if t + h * (1.0 + 1e-6) >= stop:
                h = stop - t
                last = True
            work, most = stages(t, h, lo, hi, pack, s, w, table, h_taut)
            out.counts[C_EVALUATIONS] += len(table.c)  # at most: a try that a stage ends takes fewer
            if most < h:
                landing = False
                out.counts[C_REJECTED] += 1
                continue
            if n_gaps > 0 and not landing:
                x = first_kink(t, h, s, pack, w.sign, w.g, w.q, w.u)
                if 1e-3 < x < 0.999:  # step again, to just beyond the kink
                    most = h * x * (1.0 + 1e-9)
                    landing = True
                    out.counts[C_REJECTED] += 1
                    continue
            size = power(s.r[1], s.v[1], pack.fixed)
            for i in range(n):
                size += abs(s.v[1, i])
            if not (size < 1e30):
                return DIVERGED
            book(t, h, s, w, pack, start, work)
            if not (s.e[1, 0] < 1e30):
                return DIVERGED
            end = stop if last else t + h
            record(t, h, s, out, pack.fixed, last and piece == len(pieces) - 2)
            t = end
            advance(s)
            out.counts[C_STEPS] += 1
            most, landing = h_most, False
    return OK
