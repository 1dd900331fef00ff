"""Implicit methods on the contract's residual and tangent: generalised-alpha at fixed step, adaptive TR-BDF2.

Every stage is one Newton solve of F(t, q(x), v(x), a(x)) = 0 for x = q of the stage, with v and a linear in x.

Generalised-alpha is the first-order form of Jansen, Whiting & Hulbert (2000) applied to (q, v), as in Kadapa et al.
(2017): rho is the spectral radius at infinity; rho = 1 is the trapezoidal (box) rule, whose root at infinity is -1.
TR-BDF2 is the ESDIRK of Bank et al. (1985) with the error estimate of Hosea & Shampine (1996), measured in the energy
norm and filtered with the last Newton matrix.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..banded import hold
from ..compile import kernel
from ..dispatch import backsolve, constrained, drive, factorise, heft, residual, tangent
from ..model import Status
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

MASSLESS = 1e-200  # weights of constraint forces are below
LEAST_SHARE = 1.0 / 64.0  # of a fixed step, where Newton fails at the whole one
ROUNDING = 1e-14  # some 50 units in the last place
OK, DIVERGED, NO_CONVERGENCE = int(Status.OK), int(Status.DIVERGED), int(Status.NO_CONVERGENCE)
STEP_TOO_SMALL, TOO_MANY_STEPS = int(Status.STEP_TOO_SMALL), int(Status.TOO_MANY_STEPS)


class Work(NamedTuple):
    """Scratch of a march and its Newton solves."""

    q: np.ndarray  # (ndof,) stage values at which the residual is taken
    v: np.ndarray
    a: np.ndarray
    r: np.ndarray
    J: np.ndarray  # (ndof, 2 bw + 1)
    more: np.ndarray  # (5, ndof) what a method keeps beside
    go: np.ndarray  # (2,) step to go on with where the last march ended, 0 where it must be started; step of factors J


def make_work(ndof: int, bw: int) -> Work:
    def z() -> np.ndarray:
        return np.zeros(ndof)

    return Work(z(), z(), z(), z(), np.zeros((ndof, 2 * bw + 1)), np.zeros((5, ndof)), np.zeros(2))


@kernel
def solve_acceleration(t, q, v, a, pack, w, counts):
    """Consistent acceleration: tangent(0, 0, 1) da = -F; the prescribed ones are given. F is linear in a."""
    drive(t, pack, q, v, a)
    residual(t, q, v, a, pack, w.r)
    tangent(t, q, v, a, 0.0, 0.0, 1.0, pack, w.J)
    hold(w.J, pack.bw, pack.fixed)
    counts[C_EVALUATIONS] += 1
    counts[C_FACTORS] += 1
    if not factorise(pack, w.J):
        return False
    for i in range(len(w.r)):
        w.r[i] = -w.r[i]
    for k in range(len(pack.fixed)):
        w.r[pack.fixed[k]] = 0.0
    backsolve(pack, w.J, w.r)
    for i in range(len(a)):
        a[i] += w.r[i]
    residual(t, q, v, a, pack, w.r)
    return True


@kernel
def launch(t, h, s, pack, w, floor, counts):
    """Rates at the start of a piece, in row 0 of s; w.r is the residual there.

    A line with constraints cannot be solved for its acceleration alone: two short steps of implicit Euler give what is
    consistent, the first the velocities after a jump of the motion, the second accelerations and constraint forces.
    """
    if not constrained(pack):
        ok = solve_acceleration(t, s.q[0], s.v[0], s.a[0], pack, w, counts)
        copy(s.r[0], w.r)
        return ok
    drive(t, pack, s.q[0], s.v[0], s.a[0])
    h = 0.01 * h
    q, v = w.more[0], w.more[1]
    copy(q, s.q[0])
    copy(v, s.v[0])
    for step in range(2):
        for i in range(len(q)):
            w.q[i], w.v[i], w.a[i] = q[i] + h * v[i], v[i], 0.0
        t += h
        drive(t, pack, w.q, w.v, w.a)
        small = 1e-20 * (s.peak[0] + floor)
        for i in range(len(q)):
            small += 0.5 * pack.weight[i] * (ROUNDING * q[i] / h) ** 2
        if newton(t, 1.0, 1.0 / h, 1.0 / (h * h), pack, w, 25, small, floor, counts, True) == 0:
            return False
        for i in range(len(q)):
            if step == 1:
                s.v[0, i], s.a[0, i] = w.v[i], w.a[i]
                if pack.weight[i] < MASSLESS:
                    s.q[0, i] = w.q[i]
            q[i], v[i] = w.q[i], w.v[i]
    t -= 2.0 * h
    drive(t, pack, s.q[0], s.v[0], s.a[0])
    residual(t, s.q[0], s.v[0], s.a[0], pack, s.r[0])
    return True


@kernel
def trapezoid(h, s, fixed):
    """Work at the moved ends over a step [J]."""
    return 0.5 * h * (power(s.r[0], s.v[0], fixed) + power(s.r[1], s.v[1], fixed))


@kernel
def newton(t, dq, dv, da, pack, w, most, small, floor, counts, fresh):
    """Newton on the stage values in w; on return the change made is in w.q, w.v, w.a.

    The unknown x moves q, v, a of the residual by dq x, dv x, da x. It has converged when the velocity change of an
    iteration, in the energy norm, is below `small` [J]; `fresh` forces a new tangent at the first iteration.
    Returns the number of iterations, or 0 when it failed.
    """
    before = 1e300
    renew = fresh
    for it in range(most):
        residual(t, w.q, w.v, w.a, pack, w.r)
        counts[C_EVALUATIONS] += 1
        if renew:
            tangent(t, w.q, w.v, w.a, dq, dv, da, pack, w.J)
            hold(w.J, pack.bw, pack.fixed)
            counts[C_FACTORS] += 1
            if not factorise(pack, w.J):
                return 0
            renew = False
        for i in range(len(w.r)):
            w.r[i] = -w.r[i]
        for k in range(len(pack.fixed)):
            w.r[pack.fixed[k]] = 0.0
        backsolve(pack, w.J, w.r)
        for i in range(len(w.r)):
            w.q[i] += dq * w.r[i]
            w.v[i] += dv * w.r[i]
            w.a[i] += da * w.r[i]
        size = dv * dv * norm2(w.r, pack.weight)
        if not (size < 1e200):
            return 0
        if size <= small:
            return it + 1
        if size > 0.01 * before:  # slower than a factor 10 in velocity: the tangent is too old
            renew = True
        before = size
    return 0


@kernel
def generalised_alpha(pack, s, out, w, pieces, h, rho, floor, max_steps):
    """March at fixed step h, halved for once where constraints fail to converge. Returns a status.

    Row 0 of s.q, s.v holds the start; where w.go says so, s and w are as the last march left them, and it goes on.

    y_{n+1} = y_n + h ((1 - g) y'_n + g y'_{n+1}) for q and v; q' at n + am equals v at n + af, and F = 0 is asked at
    (q, v at n + af; v' at n + am), with am = (3 - rho)/(2 (1 + rho)), af = 1/(1 + rho), g = 1/2 + am - af.
    """
    n = len(w.q)
    am, af = 0.5 * (3.0 - rho) / (1.0 + rho), 1.0 / (1.0 + rho)
    g = 0.5 + am - af
    rate0, rate1 = w.more[0], w.more[1]  # q', which is not v in between
    given_q, given_v, given_a = w.more[2], w.more[3], w.more[4]
    start = 0.0
    step, share, rigid = h, 1.0, constrained(pack)
    going = w.go[0] > 0.0
    w.go[0] = 0.0
    for piece in range(len(pieces) - 1):
        t, stop = pieces[piece], pieces[piece + 1]
        lo, hi = np.nextafter(t, 1e300), np.nextafter(stop, -1e300)
        if piece == 0:
            start = begin(lo, s, pack)
        if not going:
            if not launch(lo, step, s, pack, w, floor, out.counts):
                return DIVERGED
            copy(rate0, s.v[0])
            jump(lo, s, pack)
        going = False
        while t < stop:
            if out.counts[C_STEPS] >= max_steps:
                return TOO_MANY_STEPS
            h = share * step
            last = False
            if t + h * (1.0 + 1e-6) >= stop:
                h = stop - t
                last = True
            ts = min(max(t + h, lo), hi)
            tf = min(max(t + af * h, lo), hi)
            drive(ts, pack, given_q, given_v, given_a)
            # predictor: v at n + 1 as at n, hence q
            dq, dv, da = af, am / (g * h), am * am / (af * g * g * h * h)
            for i in range(n):
                x = h * s.v[0, i] + 0.5 * h * h * s.a[0, i]  # guess of q_{n+1} - q_n
                if rigid and pack.weight[i] == 0.0:
                    x = 0.0  # rates of constraint forces may alternate: no guide
                rate1[i] = x / (g * h) + (g - 1.0) / g * rate0[i]
                vf = (1.0 - am) * rate0[i] + am * rate1[i]
                v1 = (vf - (1.0 - af) * s.v[0, i]) / af
                a1 = (v1 - s.v[0, i]) / (g * h) + (g - 1.0) / g * s.a[0, i]
                w.q[i] = s.q[0, i] + af * x
                w.v[i] = vf
                w.a[i] = (1.0 - am) * s.a[0, i] + am * a1
            for k in range(len(pack.fixed)):
                i = pack.fixed[k]
                w.q[i] = (1.0 - af) * s.q[0, i] + af * given_q[i]
                w.v[i] = (1.0 - af) * s.v[0, i] + af * given_v[i]
                w.a[i] = (1.0 - am) * s.a[0, i] + am * given_a[i]
            small = 1e-20 * (s.peak[0] + floor)
            for i in range(n):  # no Newton step can be smaller than what rounding makes of q
                small += 0.5 * pack.weight[i] * (dv * ROUNDING * s.q[0, i]) ** 2
            if newton(tf, dq, dv, da, pack, w, 25, small, floor, out.counts, True) == 0:
                if not rigid:
                    return NO_CONVERGENCE
                share *= 0.5  # of a constrained line: contact may cycle at one step and not at another
                out.counts[C_REJECTED] += 1
                if share < LEAST_SHARE:
                    return NO_CONVERGENCE
                continue
            share = min(1.0, 2.0 * share)
            for i in range(n):
                s.q[1, i] = s.q[0, i] + (w.q[i] - s.q[0, i]) / af
                s.v[1, i] = s.v[0, i] + (w.v[i] - s.v[0, i]) / af
                s.a[1, i] = s.a[0, i] + (w.a[i] - s.a[0, i]) / am
                rate1[i] = (s.q[1, i] - s.q[0, i]) / (g * h) + (g - 1.0) / g * rate0[i]
            for k in range(len(pack.fixed)):
                i = pack.fixed[k]
                s.q[1, i], s.v[1, i], s.a[1, i], rate1[i] = given_q[i], given_v[i], given_a[i], given_v[i]
            residual(ts, s.q[1], s.v[1], s.a[1], pack, s.r[1])
            book(t, h, s, pack, start, trapezoid(h, s, pack.fixed))
            if not (s.e[1, 0] < 1e30):
                return DIVERGED
            record(t, h, s, out, pack.fixed, last and piece == len(pieces) - 2)
            t = stop if last else t + h
            advance(s)
            copy(rate0, rate1)
            out.counts[C_STEPS] += 1
    w.go[0] = step
    return OK


@kernel
def tr_bdf2(pack, s, out, w, pieces, h, tol, h_most, h_least, floor, max_steps):
    """March with error control; arguments as in `explicit.march`. Returns a status. Goes on as `generalised_alpha`."""
    n = len(w.q)
    gamma = 2.0 - math.sqrt(2.0)
    d, wt = 0.5 * gamma, 0.25 * math.sqrt(2.0)
    e0, e1, e2 = wt - (1.0 - wt) / 3.0, wt - (3.0 * wt + 1.0) / 3.0, d - d / 3.0
    v1, a1 = w.more[0], w.more[1]  # middle stage
    gq, gv, ga = w.more[2], w.more[3], w.more[4]
    start = 0.0
    going, factored = w.go[0] > 0.0, 0.0
    if going:
        h, factored = w.go[0], w.go[1]
    w.go[0] = 0.0
    for piece in range(len(pieces) - 1):
        t, stop = pieces[piece], pieces[piece + 1]
        lo, hi = np.nextafter(t, 1e300), np.nextafter(stop, -1e300)
        if piece == 0:
            start = begin(lo, s, pack)
        if not going:
            if not launch(lo, min(h, 1e-3 * h_most), s, pack, w, floor, out.counts):
                return DIVERGED
            jump(lo, s, pack)
            if piece > 0:
                h = min(h, 0.1 * h_most)
            factored = 0.0  # step for which w.J is
        going = False
        wish = h
        while t < stop:
            if out.counts[C_STEPS] >= max_steps:
                return TOO_MANY_STEPS
            last = False
            if t + h * (1.0 + 1e-6) >= stop:
                h = stop - t
                last = True
            f = d * h
            scale = s.peak[0] + floor
            small = 1e-4 * tol * tol * scale
            ok = True
            for stage in range(2):
                ts = min(max(t + (gamma * h if stage == 0 else h), lo), hi)
                drive(ts, pack, gq, gv, ga)
                for i in range(n):
                    if stage == 0:
                        q0, v0 = s.q[0, i] + f * s.v[0, i], s.v[0, i] + f * s.a[0, i]
                        a = s.a[0, i]
                    else:
                        q0 = s.q[0, i] + h * wt * (s.v[0, i] + v1[i])
                        v0 = s.v[0, i] + h * wt * (s.a[0, i] + a1[i])
                        a = a1[i]
                    w.a[i] = a
                    w.v[i] = v0 + f * a
                    w.q[i] = q0 + f * w.v[i]
                for k in range(len(pack.fixed)):
                    i = pack.fixed[k]
                    w.q[i], w.v[i], w.a[i] = gq[i], gv[i], ga[i]
                fresh = factored != h
                factored = h
                if newton(ts, 1.0, 1.0 / f, 1.0 / (f * f), pack, w, 12, small, floor, out.counts, fresh) == 0:
                    ok = False
                    break
                if stage == 0:
                    copy(v1, w.v)
                    copy(a1, w.a)
            if not ok:
                out.counts[C_REJECTED] += 1
                factored = 0.0
                h *= 0.3
                wish = h
                if h < h_least:
                    return STEP_TOO_SMALL
                continue
            copy(s.q[1], w.q)
            copy(s.v[1], w.v)
            copy(s.a[1], w.a)
            for i in range(n):  # velocity error, filtered: J x = M e / f^2
                w.v[i] = h * (e0 * s.a[0, i] + e1 * a1[i] + e2 * w.a[i]) / (f * f)
            heft(ts, w.q, w.v, pack, w.r)
            for k in range(len(pack.fixed)):
                w.r[pack.fixed[k]] = 0.0
            backsolve(pack, w.J, w.r)
            size = math.sqrt(norm2(w.r, pack.weight) / scale) / tol
            if not (size <= 1.0):
                out.counts[C_REJECTED] += 1
                h *= max(0.2, 0.9 * size ** (-1.0 / 3.0)) if size < 1e300 else 0.1
                wish = h
                if h < h_least:
                    return STEP_TOO_SMALL
                continue
            residual(hi if last else t + h, s.q[1], s.v[1], s.a[1], pack, s.r[1])
            book(t, h, s, pack, start, trapezoid(h, s, pack.fixed))
            record(t, h, s, out, pack.fixed, last and piece == len(pieces) - 2)
            t = stop if last else t + h
            advance(s)
            out.counts[C_STEPS] += 1
            grow = min(3.0, 0.9 * max(size, 1e-6) ** (-1.0 / 3.0))
            base = max(h, wish) if last else h
            h = min(base * grow, h_most) if grow > 1.2 or grow < 0.9 else base
            wish = h
    w.go[0], w.go[1] = h, factored
    return OK
