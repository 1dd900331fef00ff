"""ESDIRK of order 4 on the contract's residual and tangent, adaptive.

ARK4(3)6L[2]SA of Kennedy & Carpenter (2003), implicit part: six stages of which the first is the end of the last step,
stiffly accurate and L-stable, with an embedded formula of order 3. As in `implicit`, every stage is one Newton solve
for x = q of the stage, with v and a linear in x; the matrix is the same in all stages and kept from step to step. It
is for lines whose motion is smooth between breaks and whose tangents are dear: where TR-BDF2, of order 2, takes a
thousand short steps to follow the transverse waves, it takes a hundred.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..banded import hold
from ..compile import kernel
from ..dispatch import backsolve, drive, factorise, heft, residual, tangent
from .implicit import DIVERGED, OK, STEP_TOO_SMALL, TOO_MANY_STEPS, launch
from .implicit import Work as Newton
from .implicit import make_work as make_newton
from .march import (
    C_EVALUATIONS,
    C_FACTORS,
    C_REJECTED,
    C_STEPS,
    advance,
    begin,
    book,
    copy,
    jump,
    norm2,
    power,
    record,
)

GAMMA = 0.25
STAGES = 6
A = np.array([
    [0, 0, 0, 0, 0, 0],
    [1 / 4, 1 / 4, 0, 0, 0, 0],
    [8611 / 62500, -1743 / 31250, 1 / 4, 0, 0, 0],
    [5012029 / 34652500, -654441 / 2922500, 174375 / 388108, 1 / 4, 0, 0],
    [15267082809 / 155376265600, -71443401 / 120774400, 730878875 / 902184768, 2285395 / 8070912, 1 / 4, 0],
    [82889 / 524892, 0, 15625 / 83664, 69875 / 102672, -2260 / 8211, 1 / 4],
])  # fmt: skip
B_HAT = np.array([
    4586570599 / 29645900160, 0, 178811875 / 945068544, 814220225 / 1159782912, -3700637 / 11593932, 61727 / 225920,
])  # fmt: skip


class Table(NamedTuple):
    """Butcher table with predictors."""

    A: np.ndarray  # (6, 6)
    c: np.ndarray  # (6,)
    e: np.ndarray  # (6,) b - b_hat
    guess: np.ndarray  # (6, 6) weights of the stages before in the first guess of a stage's acceleration


def _table() -> Table:
    """The guess is the polynomial of degree 2 at most through the last stages before."""
    c = A.sum(axis=1)
    guess = np.zeros((STAGES, STAGES))
    for i in range(1, STAGES):
        known = list(range(max(0, i - 3), i))
        for j in known:
            guess[i, j] = math.prod((c[i] - c[k]) / (c[j] - c[k]) for k in known if k != j)
    return Table(A, c, A[-1] - B_HAT, guess)


TABLE = _table()


class Work(NamedTuple):
    """Scratch of a march."""

    newton: Newton
    kv: np.ndarray  # (6, ndof) velocities and accelerations of the stages
    ka: np.ndarray
    drift: np.ndarray  # (ndof,) acceleration at the end of the last step less that at its start, over its length
    seen: np.ndarray  # (2,) by how much an iteration shrinks the velocity's change; power at the prescribed dofs [W]


def make_work(ndof: int, bw: int) -> Work:
    stages = np.zeros((STAGES, ndof))
    return Work(make_newton(ndof, bw), stages, stages.copy(), np.zeros(ndof), np.ones(2))


@kernel
def solve_stage(t, f, pack, w, seen, most, small, counts, fresh):
    """Newton on the stage values in w, moved by x, x/f, x/f^2; as `implicit.newton`, but it ends when the error that is
    left, the last change times rate/(1 - rate), is below `small` in the energy norm. False where it fails."""
    dv, da = 1.0 / f, 1.0 / (f * f)
    before = -1.0
    renew = fresh
    for _ in range(most):
        residual(t, w.q, w.v, w.a, pack, w.r)
        counts[C_EVALUATIONS] += 1
        if renew:
            tangent(t, w.q, w.v, w.a, 1.0, dv, da, pack, w.J)
            hold(w.J, pack.bw, pack.fixed)
            counts[C_FACTORS] += 1
            if not factorise(pack, w.J):
                return False
            renew = False
            seen[0] = 0.1
            before = -1.0
        seen[1] = power(w.r, w.v, pack.fixed)
        for i in range(len(w.r)):
            w.r[i] = -w.r[i]
        for k in range(len(pack.fixed)):
            w.r[pack.fixed[k]] = 0.0
        backsolve(pack, w.J, w.r)
        for i in range(len(w.r)):
            w.q[i] += w.r[i]
            w.v[i] += dv * w.r[i]
            w.a[i] += da * w.r[i]
        size = dv * math.sqrt(norm2(w.r, pack.weight))
        if not (size < 1e100):
            return False
        if before > 0.0:
            seen[0] = max(0.3 * seen[0], size / before)
            if seen[0] > 0.2:  # the matrix is too old
                renew = True
        if seen[0] < 0.9 and size * seen[0] <= (1.0 - seen[0]) * small:
            return True
        before = size
    return False


@kernel
def march(pack, s, out, w, table, pieces, h, tol, h_most, h_least, floor, max_steps):
    """March with error control; arguments as in `explicit.march`. Returns a status."""
    n, u = len(w.drift), w.newton
    gq, gv, ga = u.more[2], u.more[3], u.more[4]
    kv, ka = w.kv, w.ka
    start = 0.0
    for piece in range(len(pieces) - 1):
        t, stop = pieces[piece], pieces[piece + 1]
        lo, hi = np.nextafter(t, 1e300), np.nextafter(stop, -1e300)
        if piece == 0:
            start = begin(lo, s, pack)
        if not launch(lo, h, s, pack, u, floor, out.counts):
            return DIVERGED
        jump(lo, s, pack)
        if piece > 0:
            h = min(h, 0.1 * h_most)
        wish = h
        factored = 0.0  # step for which u.J is
        for i in range(n):
            w.drift[i] = 0.0
        while t < stop:
            if out.counts[C_STEPS] >= max_steps:
                return TOO_MANY_STEPS
            last = False
            if t + h * (1.0 + 1e-6) >= stop:
                h = stop - t
                last = True
            f = 0.25 * h
            scale = s.peak[0] + floor
            small = 0.05 * tol * math.sqrt(scale)
            copy(kv[0], s.v[0])
            copy(ka[0], s.a[0])
            work = h * table.A[5, 0] * power(s.r[0], s.v[0], pack.fixed)
            ok = True
            for stage in range(1, 6):
                ts = min(max(t + table.c[stage] * h, lo), hi)
                drive(ts, pack, gq, gv, ga)
                for i in range(n):
                    x, y, a = 0.0, 0.0, 0.0
                    for k in range(stage):
                        x += table.A[stage, k] * kv[k, i]
                        y += table.A[stage, k] * ka[k, i]
                        a += table.guess[stage, k] * ka[k, i]
                    if stage == 1:
                        a += table.c[1] * h * w.drift[i]
                    u.a[i] = a
                    u.v[i] = s.v[0, i] + h * y + f * a
                    u.q[i] = s.q[0, i] + h * x + f * u.v[i]
                for k in range(len(pack.fixed)):
                    i = pack.fixed[k]
                    u.q[i], u.v[i], u.a[i] = gq[i], gv[i], ga[i]
                fresh = factored != h
                factored = h
                if not solve_stage(ts, f, pack, u, w.seen, 10, small, out.counts, fresh):
                    ok = False
                    break
                copy(kv[stage], u.v)
                copy(ka[stage], u.a)
                if stage < 5:
                    work += h * table.A[5, stage] * w.seen[1]
            if not ok:
                out.counts[C_REJECTED] += 1
                factored = 0.0
                h *= 0.3
                wish = h
                if h < h_least:
                    return STEP_TOO_SMALL
                continue
            copy(s.q[1], u.q)
            copy(s.v[1], u.v)
            copy(s.a[1], u.a)
            for i in range(n):  # velocity error, filtered: J x = M e / f^2
                y = 0.0
                for k in range(6):
                    y += table.e[k] * ka[k, i]
                u.v[i] = h * y / (f * f)
            heft(t + h, u.q, u.v, pack, u.r)
            for k in range(len(pack.fixed)):
                u.r[pack.fixed[k]] = 0.0
            backsolve(pack, u.J, u.r)
            size = math.sqrt(norm2(u.r, pack.weight) / scale) / tol
            if not (size <= 1.0):
                out.counts[C_REJECTED] += 1
                h *= max(0.2, 0.9 * size ** (-0.25)) if size < 1e300 else 0.1
                wish = h
                if h < h_least:
                    return STEP_TOO_SMALL
                continue
            residual(hi if last else t + h, s.q[1], s.v[1], s.a[1], pack, s.r[1])
            work += h * table.A[5, 5] * power(s.r[1], s.v[1], pack.fixed)
            book(t, h, s, pack, start, work)
            if not (s.e[1, 0] < 1e30):
                return DIVERGED
            record(t, h, s, out, pack.fixed, last and piece == len(pieces) - 2)
            for i in range(n):
                w.drift[i] = (s.a[1, i] - s.a[0, i]) / h
            t = stop if last else t + h
            advance(s)
            out.counts[C_STEPS] += 1
            grow = min(3.0, 0.9 * max(size, 1e-6) ** (-0.25))
            base = max(h, wish) if last else h
            h = min(base * grow, h_most) if grow > 1.2 or grow < 0.9 else base
            wish = h
    return OK
