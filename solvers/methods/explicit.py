"""Explicit Runge-Kutta: fixed step, and an embedded pair with error control in the energy norm.

A method is its table. The same kernel runs all of them; steps land on every break of the motion, and on the kinks
that the line names in ``gaps`` (a cord that turns taut or slack).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compile import kernel
from ..dispatch import accelerate, drive, gaps
from ..model import Status
from .march import (
    C_EVALUATIONS,
    C_REJECTED,
    C_STEPS,
    advance,
    begin,
    between,
    book,
    copy,
    jump,
    norm2,
    power,
    record,
)

OK, DIVERGED = int(Status.OK), int(Status.DIVERGED)
STEP_TOO_SMALL, TOO_MANY_STEPS = int(Status.STEP_TOO_SMALL), int(Status.TOO_MANY_STEPS)


class Table(NamedTuple):
    """Butcher table; `e` = b - b_hat, all zero without an embedded method. The last stage is y_{n+1} (FSAL)."""

    A: np.ndarray  # (s, s)
    c: np.ndarray  # (s,)
    e: np.ndarray  # (s,)
    order: int


class Work(NamedTuple):
    """Scratch of the march."""

    kv: np.ndarray  # (stages, ndof) stage velocities and accelerations
    ka: np.ndarray
    q: np.ndarray  # (ndof,)
    v: np.ndarray
    r: np.ndarray
    err: np.ndarray
    g: np.ndarray  # (n_gaps,)
    sign: np.ndarray


def make_work(table: Table, ndof: int, n_gaps: int) -> Work:
    def z() -> np.ndarray:
        return np.zeros(ndof)

    stages = len(table.c)
    return Work(np.zeros((stages, ndof)), np.zeros((stages, ndof)), z(), z(), z(), z(), np.zeros(n_gaps),
                np.zeros(n_gaps, dtype=bool))


def _table(rows: list[list[float]], b: list[float], b_hat: list[float] | None, order: int) -> Table:
    """Append b as a last, first-same-as-last stage."""
    s = len(b) + 1
    A = np.zeros((s, s))
    for i, line in enumerate([*rows, b]):
        A[i, : len(line)] = line
    e = np.zeros(s)
    if b_hat is not None:
        e = np.append(b, 0.0) - np.array(b_hat)
    return Table(A, A.sum(axis=1), e, order)


RK2 = _table([[], [1.0]], [0.5, 0.5], None, 2)  # Heun
RK4 = _table([[], [0.5], [0, 0.5], [0, 0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6], None, 4)
DOPRI5 = _table(  # Dormand & Prince (1980), 5(4)
    [
        [],
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
    ],
    [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    [5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40],
    5,
)
TSIT5 = _table(  # Tsitouras, Comput. Math. Appl. 62 (2011) 770, 5(4)
    [
        [],
        [0.161],
        [-0.008480655492356989, 0.335480655492357],
        [2.8971530571054935, -6.359448489975075, 4.3622954328695815],
        [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525],
        [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383],
    ],
    [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774],
    [
        0.09646076681806523 + 0.00178001105222577714, 0.01 + 0.0008164344596567469,
        0.4798896504144996 - 0.007880878010261995, 1.379008574103742 + 0.1447110071732629,
        -3.290069515436081 - 0.5823571654525552, 2.324710524099774 + 0.45808210592918697, -1 / 66,
    ],
    5,
)  # fmt: skip


def ring_loss(table: Table) -> float:
    """Share of an oscillation's energy, over (h omega)^6, that a step of a pair of order 5 loses: 2 c6 - 1/360, where
    R(z) = 1 + z + ... + z^5/120 + c6 z^6; its sign is that of a loss."""
    x = np.ones(len(table.c))
    for _ in range(5):
        x = table.A @ x
    return float(2 * (table.A[-1] @ x) - 1 / 360)


@kernel
def first_kink(t, h, s, pack, sign, g, q, v):
    """Share of the step at which the earliest of its kinks lies; 2 when no gap changed sign."""
    gaps(t + h, s.q[1], s.v[1], pack, g)
    changed = False
    for k in range(len(g)):
        if (g[k] > 0.0) != sign[k]:
            changed = True
    if not changed:
        return 2.0
    lo, hi = 0.0, 1.0
    for _ in range(24):
        x = 0.5 * (lo + hi)
        between(x, h, s, q, v)
        gaps(t + x * h, q, v, pack, g)
        same = True
        for k in range(len(g)):
            if (g[k] > 0.0) != sign[k]:
                same = False
        if same:
            lo = x
        else:
            hi = x
    return hi


@kernel
def march(pack, s, out, w, pieces, table, h, tol, h_most, h_least, h_taut, floor, max_steps):
    """March over the smooth pieces of the motion; fixed step h where tol = 0.

    Parameters
    ----------
    pack : NamedTuple
        A line.
    s : Ends
        Row 0 of q, v holds the initial state.
    out : Output
    w : Work
    pieces : (np + 1,) float [s]
        Start, breaks, end.
    h, h_most, h_least : float [s]
        First (or fixed), largest and smallest step.
    h_taut : (n_gaps,) float [s]
        Largest step of an adaptive march while a gap is positive: an impact is short, and resolved. Each gap has its
        own: a soft cord, taut for long, does not ask for the steps of a stiff one.
    tol : float
        Allowed local velocity error in the energy norm, relative to the peak kinetic energy: sqrt(K(e)/K_peak).
    floor : float [J]
        Kinetic energy below which errors are absolute.

    Returns
    -------
    status : int
    """
    n, stages, n_gaps = len(w.q), len(table.c), len(w.g)
    kv, ka, q, v, r, err, g, sign = w.kv, w.ka, w.q, w.v, w.r, w.err, w.g, w.sign
    adaptive = tol > 0.0
    old = 1.0
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
        if n_gaps > 0:
            gaps(lo, s.q[0], s.v[0], pack, g)
            for k in range(n_gaps):
                sign[k] = g[k] > 0.0
        if adaptive and piece > 0:
            h = min(h, 0.1 * h_most)
        landing = False
        wish = h
        while t < stop:
            if out.counts[C_STEPS] >= max_steps:
                return TOO_MANY_STEPS
            if adaptive:
                for k in range(n_gaps):
                    if sign[k] and h > h_taut[k]:
                        h = h_taut[k]
            last = False
            if t + h * (1.0 + 1e-6) >= stop:
                h = stop - t
                last = True
            work = h * table.A[stages - 1, 0] * power(s.r[0], s.v[0], pack.fixed)
            copy(kv[0], s.v[0])
            copy(ka[0], s.a[0])
            for m in range(1, stages):
                for i in range(n):
                    x, y = 0.0, 0.0
                    for p in range(m):
                        x += table.A[m, p] * kv[p, i]
                        y += table.A[m, p] * ka[p, i]
                    q[i] = s.q[0, i] + h * x
                    v[i] = s.v[0, i] + h * y
                ts = min(max(t + table.c[m] * h, lo), hi)
                drive(ts, pack, q, v, ka[m])
                accelerate(ts, q, v, ka[m], pack, r)
                copy(kv[m], v)
                if m < stages - 1:  # the last stage is the end of the step, of weight zero
                    work += h * table.A[stages - 1, m] * power(r, v, pack.fixed)
            out.counts[C_EVALUATIONS] += stages - 1
            copy(s.q[1], q)
            copy(s.v[1], v)
            copy(s.a[1], ka[stages - 1])
            copy(s.r[1], r)
            if adaptive:
                for i in range(n):
                    x = 0.0
                    for p in range(stages):
                        x += table.e[p] * ka[p, i]
                    err[i] = h * x
                for k in range(len(pack.fixed)):
                    err[pack.fixed[k]] = 0.0
                size = math.sqrt(norm2(err, pack.weight) / (s.peak[0] + floor)) / tol
                if not (size <= 1.0):
                    out.counts[C_REJECTED] += 1
                    h *= max(0.2, 0.9 * size ** (-1.0 / table.order)) if size < 1e300 else 0.1
                    wish = h
                    landing = False
                    if h < h_least:
                        return STEP_TOO_SMALL
                    continue
                grow = 0.9 * max(size, 1e-8) ** (-0.7 / table.order) * max(old, 1e-8) ** (0.4 / table.order)
                grow = min(5.0, max(0.2, grow))
                if n_gaps > 0 and not landing:
                    x = first_kink(t, h, s, pack, sign, g, q, v)
                    if 1e-3 < x < 0.999:  # step again, to just beyond the kink (at the brink the step is short anyway)
                        wish = h
                        h *= x * (1.0 + 1e-9)
                        landing = True
                        out.counts[C_REJECTED] += 1
                        continue
                old = size
            else:
                grow = 1.0
                total = power(s.r[1], s.v[1], pack.fixed)
                for i in range(n):
                    total += abs(v[i])
                if not (total < 1e30):
                    return DIVERGED
            book(t, h, s, pack, start, work)
            if not (s.e[1, 0] < 1e30):
                return DIVERGED
            end = stop if last else t + h
            record(t, h, s, out, pack.fixed, last and piece == len(pieces) - 2)
            t = end
            if n_gaps > 0:
                gaps(t, s.q[1], s.v[1], pack, g)
                for k in range(n_gaps):
                    sign[k] = g[k] > 0.0
            advance(s)
            out.counts[C_STEPS] += 1
            if adaptive:
                if landing:
                    h = wish
                    landing = False
                else:
                    h = min(h * grow, h_most) if not last else min(max(h, wish) * grow, h_most)
                    wish = h
            else:
                h = wish
    return OK
