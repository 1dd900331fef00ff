"""Statics: Newton on the contract's residual with load continuation.

Newton alone lands on spurious shapes; so it starts as a damped relaxation, (K + mu W) dq = -F with mu falling as the
residual falls, which follows the way down the potential energy and ends as Newton.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from scipy.linalg import LinAlgError, cholesky_banded
from scipy.sparse import csr_array
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

from ..banded import factor, hold, substitute
from ..dispatch import backsolve, call_backsolve, call_factorise, call_tangent, drive, factorise, residual, tangent
from ..model import Status


@njit(cache=True)
def relax(t, q, pack, tolerance, most, reach):
    """Equilibrium of F(t, q, 0, 0) = 0 from q, in place; (status, iterations, largest free residual [N]).

    `reach` [m] caps the largest change of a dof in one iteration. A row without stiffness (a mass between slack
    cords) stays where it is.
    """
    n = len(q)
    zero, a, v, r = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    best, trial = np.zeros(n), np.zeros(n)
    J = np.zeros((n, 2 * pack.bw + 1))
    free = np.ones(n, np.bool_)
    for k in range(len(pack.fixed)):
        free[pack.fixed[k]] = False
    drive(t, pack, q, v, a)
    residual(t, q, zero, zero, pack, r)
    size, heavy = 0.0, 0.0
    for i in range(n):
        if free[i]:
            size = max(size, abs(r[i]))
            heavy = max(heavy, abs(r[i]) / pack.weight[i])
    mu = 10.0 * heavy / reach
    polished, last = 0, 1e300
    for it in range(most):
        if size <= tolerance:  # rounding of stiff segments bounds it: Newton goes on until its steps are small too
            if last <= 1e-6 * reach or polished == 8:
                return 0, it, size
            polished += 1
            mu = 0.0
        tangent(t, q, zero, zero, 1.0, 0.0, 0.0, pack, J)
        for i in range(n):
            if J[i, pack.bw] == 0.0:
                J[i, pack.bw] = 1e-3 * pack.weight[i]
            J[i, pack.bw] += mu * pack.weight[i]
        hold(J, pack.bw, pack.fixed)
        for i in range(n):
            best[i] = -r[i] if free[i] else 0.0
        ok = factor(J, pack.bw)
        if ok:
            substitute(J, pack.bw, best)
        big = 0.0
        for i in range(n):
            if not (abs(best[i]) <= big):
                big = abs(best[i])
        new = 1e300
        if ok and big < 1e30:
            scale = min(1.0, reach / big) if big > 0.0 else 1.0
            for i in range(n):
                trial[i] = q[i] + scale * best[i]
            residual(t, trial, zero, zero, pack, v)
            new = 0.0
            for i in range(n):
                if free[i] and not (abs(v[i]) <= new):
                    new = abs(v[i])
        if new < 1e300 and (new <= 5.0 * size or big <= (1.0 if polished > 0 and mu == 0.0 else 1e-3) * reach):
            last = big if mu == 0.0 else 1e300
            q[:] = trial
            r[:] = v
            ratio = new / size if size > 0.0 else 0.0
            mu *= min(2.0, max(0.02, ratio))
            if big < 0.1 * reach:
                mu *= 0.3
            if mu * reach < 1e-9 * heavy:
                mu = 0.0
            size = new
        else:
            mu = max(mu * 8.0, 1e-6 * heavy / reach)
    return (0, most, size) if size <= tolerance else (1, most, size)


def equilibrium(packs: Sequence[Any], q: np.ndarray, reach: float, tolerance: float) -> tuple[Status, np.ndarray, str]:
    """Static state from the guess q: at once, else through softer packs, else with load continuation.

    Parameters
    ----------
    packs : sequence of NamedTuple
        A line whose stiffness grows up to the real one, which is the last; each has a `load_factor`, 1 for the whole
        steady load.
    q : (ndof,) float [m]
    reach : float [m]
        Largest change in one iteration; the order of a segment length.
    tolerance : float [N]
        Largest residual accepted at a free dof.
    """
    real, trial = packs[-1], np.array(q)
    failed, iterations, size = relax(0.0, trial, real, tolerance, 400, reach)
    if not failed:
        return Status.OK, trial, f"{iterations} iterations, residual {size:.1e} N"
    trial = np.array(q)
    for pack in packs:  # a softer stage may stop short: the next goes on from there
        failed, iterations, size = relax(0.0, trial, pack, tolerance, 3000, reach)
    if not failed:
        return Status.OK, trial, f"reached through softer lines, residual {size:.1e} N"
    trial, load, step = np.array(q), 0.0, 0.05
    while load < 1.0:
        target = min(1.0, load + step)
        attempt = np.array(trial)
        failed, _, size = relax(0.0, attempt, real._replace(load_factor=target), tolerance, 400, reach)
        if failed:
            step *= 0.5
            if step < 1e-4:
                return Status.NO_STATIC, trial, f"residual {size:.1e} N at load factor {target:.3g}"
        else:
            trial, load, step = attempt, target, step * 1.5
    return Status.OK, trial, "reached by load continuation"


SPIN = 1e-8
RISE = 0.5  # of the loads: to here a step may raise the residual, as one that turns frames by much must
CORRECTIONS = 15  # of Newton in a load step: one that needs more has jumped to another branch


@njit(cache=True)
def newton_relaxation(t, q, pack, load, most, tolerance, mu, rise):
    """F(t, q, 0, 0) + load = 0, q in place, for a line whose rows are not forces on its unknowns.

    Newton on F plus mu dF/da (q - q_before): for mu > 0 a step of an overdamped motion (implicit Euler with the mass of
    the line as its damper), whose mu falls with the residual until it is Newton. Rows are measured in `pack.unit`,
    steps in `pack.size`. A step may raise the residual threefold, or up to `rise`. Returns (0 when converged,
    iterations, largest scaled residual).
    """
    n = len(q)
    zero, a, v, r = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    step, trial = np.zeros(n), np.zeros(n)
    J = np.zeros((n, 2 * pack.bw + 1))
    free = np.ones(n, np.bool_)
    for k in range(len(pack.fixed)):
        free[pack.fixed[k]] = False
    drive(t, pack, q, v, a)
    residual(t, q, zero, zero, pack, r)
    r += load
    size = _scaled(r, pack.unit, free)
    refused, last, stuck = 0, 1e300, 0
    for it in range(most):
        if size <= tolerance and last <= 1e-7:
            return 0, it, size
        # a line free to spin about itself has no stiffness against it: a little inertia keeps it where it is
        tangent(t, q, zero, zero, 1.0, 0.0, max(mu, SPIN * pack.rate**2), pack, J)
        hold(J, pack.bw, pack.fixed)
        ok = factorise(pack, J)
        for i in range(n):
            step[i] = -r[i] if free[i] else 0.0
        big, new = 0.0, 1e300
        if ok:
            backsolve(pack, J, step)
            for i in range(n):
                x = abs(step[i]) / pack.size[i]
                if not (x <= big):
                    big = x
        if ok and big < 1e30:
            cut = min(1.0, 0.2 / big) if big > 0.0 else 1.0
            for i in range(n):
                trial[i] = q[i] + cut * step[i]
            residual(t, trial, zero, zero, pack, v)
            v += load
            new = _scaled(v, pack.unit, free)
        if new < 1e300 and (new <= max(3.0 * size, rise) or big <= 1e-3):
            q[:] = trial
            r[:] = v
            refused = 0
            stuck = stuck + 1 if new > 0.9 * size and mu == 0.0 and size > tolerance else 0
            last = big if mu == 0.0 and size > tolerance else 1e300 if mu > 0.0 else min(big, 0.5 * last)
            mu *= min(2.0, max(0.05, 0.5 * new / size if size > 0.0 else 0.05))
            size = new
            if mu < 1e-9 * pack.rate**2 or size <= 100.0 * tolerance:
                mu = 0.0
            if stuck > 40:
                return 1, it, size
        else:
            mu = max(8.0 * mu, 1e-4 * pack.rate**2)
            refused += 1
            if refused > 30:
                return 1, it, size
    return (0, most, size) if size <= tolerance and last <= 1e-7 else (1, most, size)


@njit(cache=True)
def _scaled(r, unit, free):
    """Largest free row in its unit."""
    size = 0.0
    for i in range(len(r)):
        if free[i] and not (abs(r[i]) / unit[i] <= size):
            size = abs(r[i]) / unit[i]
    return size


def balance(pack: Any, starts: Sequence[np.ndarray], tolerance: float = 1e-10) -> tuple[Status, np.ndarray, str]:
    """Static state of a line with constraints, by Newton, load continuation and relaxation.

    A slender rod has many equilibria, and Newton from afar may land on any: a line with a loose end, which has a state
    for every share of its load, follows the branch that grows from the unloaded one. A line held at both ends has its
    shape from the start, where Newton comes first. All three ways are exact where they converge.
    """
    ways = [(way, rise) for rise in (0.0, RISE) for way in (_newton, _continued, _relaxed)]
    if len(pack.held) < 2:
        ways = [(_continued, RISE), (_newton, RISE), (_relaxed, RISE)]
    status, q, note = Status.NO_STATIC, np.array(starts[0]), ""
    for way, rise in ways:
        for start in starts:
            ok, q, note = way(pack, np.array(start), tolerance, rise)
            if ok:
                return Status.OK, q, note
    return status, q, note


def _newton(pack: Any, q: np.ndarray, tolerance: float, rise: float) -> tuple[bool, np.ndarray, str]:
    failed, iterations, size = newton_relaxation(0.0, q, pack, np.zeros(len(q)), 60, tolerance, 0.0, rise)
    return not failed, q, f"{iterations} iterations, residual {size:.1e} of the loads"


def _continued(pack: Any, q: np.ndarray, tolerance: float, rise: float) -> tuple[bool, np.ndarray, str]:
    load, step, size = 0.0, 0.1, math.nan
    if len(pack.held) < 2:  # forces and moments are in proportion
        q = np.where(pack.weight > 1e-200, q, step * q)
    while load < 1.0 and step > 1e-3:
        target = min(1.0, load + step)
        attempt, part = q.copy(), pack._replace(load_factor=target)
        failed, _, size = newton_relaxation(0.0, attempt, part, np.zeros(len(q)), CORRECTIONS, tolerance, 0.0, rise)
        if failed:
            step *= 0.5
        else:
            q, load, step = attempt, target, step * 1.5
    return load >= 1.0, q, "reached by load continuation" if load >= 1.0 else f"residual {size:.1e} of the loads"


def _relaxed(pack: Any, q: np.ndarray, tolerance: float, rise: float) -> tuple[bool, np.ndarray, str]:
    start = float(pack.rate) ** 2
    failed, iterations, size = newton_relaxation(0.0, q, pack, np.zeros(len(q)), 3000, tolerance, start, rise)
    return not failed, q, f"relaxed in {iterations} steps, residual {size:.1e} of the loads"


MODES = 8  # next to zero, among which an unstable one is looked for
NEUTRAL = 1e-6  # of the largest of these: a mode that neither grows nor is held


def growth(pack: Any, q: np.ndarray, slow: float) -> float:
    """Rate [1/s] at which a small disturbance of a static state q grows; 0 where the state is stable.

    Undamped disturbances exp(sigma t) x obey (K + sigma^2 M) x = 0 with the tangents K = dF/dq and M = dF/da. A K
    whose symmetric part has a Cholesky factor has no such sigma. Else the eigenvalues of K x = lambda M x next to zero
    are found by Arnoldi iteration on (K + s M)^-1 M, s = 0.01 `slow`^2 (which takes K's rigid motions, and the rows
    without inertia of a line with constraints): a real negative one is an instability (of a line in a steady current,
    which has no potential energy, that by which it would diverge).

    Parameters
    ----------
    slow : float [rad/s]
        The order of the line's lowest frequency.
    """
    n, bw, zero = len(q), pack.bw, np.zeros(len(q))
    K, M, J = (np.zeros((n, 2 * bw + 1)) for _ in range(3))
    call_tangent(0.0, q, zero, zero, 1.0, 0.0, 0.0, pack, K)
    if _definite(K, bw, pack.fixed):
        return 0.0
    shift = 0.01 * slow**2
    call_tangent(0.0, q, zero, zero, 0.0, 0.0, 1.0, pack, M)
    call_tangent(0.0, q, zero, zero, 1.0, 0.0, shift, pack, J)
    hold(J, bw, pack.fixed)
    if not (shift > 0.0 and call_factorise(pack, J)):
        return 0.0
    i, k = np.nonzero(M)
    inertia = csr_array((M[i, k], (i, i + k - bw)), shape=(n, n))

    def solved(x: np.ndarray) -> np.ndarray:
        y = inertia @ x
        y[pack.fixed] = 0.0
        call_backsolve(pack, J, y)
        return np.asarray(y)

    if n <= 4 * MODES:
        found = np.linalg.eigvals(np.column_stack([solved(x) for x in np.eye(n)]))
    else:
        start = np.random.default_rng(0).standard_normal(n)
        try:
            operator = LinearOperator((n, n), matvec=solved, dtype=float)
            found = eigs(operator, k=MODES, v0=start, return_eigenvectors=False, maxiter=200, tol=1e-9)
        except ArpackError as failure:  # what has converged counts
            found = getattr(failure, "eigenvalues", np.zeros(0))
    found = found[np.abs(found) > 1e-9 * np.abs(found).max(initial=0.0)]
    values = 1 / found - shift
    if not len(values):
        return 0.0
    real = values.real[np.abs(values.imag) < 1e-3 * np.abs(values.real)]
    lowest = float(real.min(initial=0.0))
    return math.sqrt(-lowest) if lowest < -max(NEUTRAL * float(np.abs(values).max()), 1e-3 * shift) else 0.0


def _definite(K: np.ndarray, bw: int, fixed: np.ndarray) -> bool:
    """Whether the symmetric part of K, prescribed dofs aside, is positive definite; K is overwritten."""
    hold(K, bw, fixed)
    n = len(K)
    lower = np.zeros((bw + 1, n))
    for m in range(min(bw, n - 1) + 1):
        lower[m, : n - m] = (K[m:, bw - m] + K[: n - m, bw + m]) / 2
    try:
        cholesky_banded(lower, lower=True, check_finite=False)
    except LinAlgError:
        return False
    return bool(np.isfinite(lower).all())
