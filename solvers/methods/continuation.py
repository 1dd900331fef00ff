"""Pseudo-arclength continuation of periodic responses (Keller 1977), through turning points, with folds located.

Unknowns (X, p): p is the frequency, the amplitude or any field of a scene. A caller gives `problem(p)`, which is
(pack, omega); nothing here knows what p means. A step goes along the tangent (dX, dp) of unit length in the product
<X, X>/size^2 + p^2/scale^2, then Newton on the balance and on the plane normal to the step, by block elimination:
two solutions with one factored Jacobian, so that a step costs what one at fixed p does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model import Status
from .floquet import Stability, stability
from .harmonic import Balance, Orbit, Work, left_out, newton, padded, periodic, reach_of

Problem = Callable[[float], tuple[Any, float]]

NEWTON = 1e-9
MOST_CORRECTIONS = 8
WANTED = 5  # corrections that keep the step
LEAST_STEP = 1e-5  # of the range of p
DIFFERENCE = 1e-6  # relative step of d/dp


@dataclass(frozen=True)
class Point:
    """A periodic response on a branch."""

    parameter: float
    orbit: Orbit
    slope: float  # dp/ds of the unit tangent: changes sign at a fold
    fold: bool = False
    stability: Stability | None = None


@dataclass(frozen=True)
class Branch:
    """Responses in the order of the arc; folds lie between the others, marked."""

    points: tuple[Point, ...]
    status: Status
    message: str

    @property
    def parameters(self) -> np.ndarray:
        return np.array([point.parameter for point in self.points])

    @property
    def folds(self) -> tuple[Point, ...]:
        return tuple(point for point in self.points if point.fold)

    @property
    def stable(self) -> np.ndarray:
        """(n,) bool; a response whose stability was not asked for counts as stable."""
        return np.array([point.stability is None or point.stability.stable for point in self.points])


class _Curve:
    """The balance as a function of (X, p)."""

    def __init__(
        self, problem: Problem, rest: np.ndarray, harmonics: int, samples: int, low: float, high: float
    ) -> None:
        self.problem, self.rest, self.harmonics, self.samples = problem, rest, harmonics, samples
        self.low, self.high, self.scale = low, high, high - low
        self.work = Work()
        self.balance: Balance
        self.p = math.nan
        self.reach: np.ndarray | None = None

    def at(self, p: float) -> Balance:
        """The balance at p; the memory of the one before is used again."""
        if p != self.p:
            pack, omega = self.problem(p)
            if self.reach is None:
                self.reach = reach_of(pack, self.rest)
                self.balance = Balance(pack, omega, self.harmonics, self.samples, self.reach, self.work)
            else:
                self.balance.move(pack, omega)
            self.p = p
        return self.balance

    def by_parameter(self, X: np.ndarray, p: float) -> np.ndarray:
        """dR/dp by central differences, one-sided at the limits: beyond them there may be no scene."""
        up, down = (min(max(p + d * self.scale, self.low), self.high) for d in (DIFFERENCE, -DIFFERENCE))
        high = self.at(up).residual(X)
        low = self.at(down).residual(X)
        return (high - low) / (up - down)

    def size(self, X: np.ndarray) -> float:
        """What changes of X are measured against: its swing, and a little of its mean."""
        return self.balance.motion(X) + 1e-6 * self.balance.size(X) + 1e-300

    def tangent(self, X: np.ndarray, p: float) -> tuple[np.ndarray, float] | None:
        """(dX/dp, p) scaled to unit length, for growing p."""
        Rp = self.by_parameter(X, p)
        balance = self.at(p)
        if not balance.factor(X):
            return None
        dX = balance.solve(-Rp)
        length = math.hypot(balance.size(dX) / self.size(X), 1 / self.scale)
        return (dX / length, 1 / length) if math.isfinite(length) else None

    def inner(self, dX: np.ndarray, dp: float, eX: np.ndarray, ep: float, size: float) -> float:
        w = self.balance.pack.weight
        return float((w[:, None] * dX * eX).sum()) / float(w.sum()) / size**2 + dp * ep / self.scale**2

    def correct(
        self, X: np.ndarray, p: float, tX: np.ndarray, tp: float
    ) -> tuple[int, np.ndarray, float, np.ndarray, float]:
        """Newton from a prediction, normal to the tangent: (corrections or 0, X, p, new tangent)."""
        size, before = self.size(X), math.inf
        for k in range(MOST_CORRECTIONS):
            if not self.low <= p <= self.high:
                break
            Rp = self.by_parameter(X, p)
            balance = self.at(p)
            R = balance.residual(X)
            if not np.isfinite(R).all() or not balance.factor(X):
                break
            both = balance.blocks.solve(np.column_stack([-R.reshape(-1), -Rp.reshape(-1)]))
            aX, bX = both[:, 0].reshape(X.shape), both[:, 1].reshape(X.shape)
            across = self.inner(bX, 1.0, tX, tp, size)
            if across == 0 or not np.isfinite(both).all():
                break
            dp = -self.inner(aX, 0.0, tX, tp, size) / across
            dX = aX + dp * bX
            change = math.hypot(balance.size(dX) / size, dp / self.scale)
            if not change < 2 * before or change > 1:
                break
            X, p, before = X + dX, p + dp, change
            if change < NEWTON or (change < 1e-6 and k + 1 >= MOST_CORRECTIONS):
                length = math.hypot(balance.size(bX) / size, 1 / self.scale)
                sign = 1.0 if self.inner(bX, 1.0, tX, tp, size) > 0 else -1.0
                return k + 1, X, p, sign * bX / length, sign / length
        return 0, X, p, tX, tp


def trace(
    problem: Problem,
    start: float,
    stop: float,
    rest: np.ndarray,
    *,
    tolerance: float = 5e-4,
    harmonics: int | None = None,
    step: float = 0.02,
    most_step: float = 0.05,
    most_points: int = 2000,
    with_stability: bool = True,
    begin: Orbit | None = None,
) -> Branch:
    """Follow the periodic response from p = `start` until p = `stop` is passed (or `start`, coming back).

    Parameters
    ----------
    problem : p -> (pack, omega [rad/s])
    rest : (ndof,) float
        Static state.
    tolerance, harmonics
        As in `harmonic.periodic`, at the start; on the way harmonics are added when the estimated error passes
        `tolerance`, unless `harmonics` is given.
    step, most_step : float
        First and largest step of the arc, where 1 is the whole range of p or a change of the motion by its own size.
    with_stability : bool
        Floquet multipliers at every point.
    begin : Orbit, optional
        Response at `start`.

    Returns
    -------
    Branch
        Points in order, folds among them; the status is OK when `stop` was reached. A pair of folds within one step is
        stepped over: `most_step` says how near they may be.
    """
    if start == stop:
        raise ValueError(f"a branch needs a range: start and stop are both {start:g}")
    low, high = min(start, stop), max(start, stop)
    pack, omega = problem(start)
    first = begin or periodic(pack, omega, rest, tolerance, harmonics)
    if first.status not in (Status.OK, Status.FEW_HARMONICS):
        return Branch((), first.status, first.message)
    curve = _Curve(problem, rest, first.harmonics, max(8 * first.harmonics, 32), low, high)
    X, p = first.X, start
    curve.at(p)
    found = curve.tangent(X, p)
    if found is None:
        return Branch((), Status.NO_CONVERGENCE, "no tangent at the start")
    tX, tp = found
    if (stop - start) * tp < 0:
        tX, tp = -tX, -tp
    points: list[Point] = []

    def put(X: np.ndarray, p: float, slope: float, fold: bool = False) -> Orbit:
        balance = curve.at(p)
        balance.factor(X)
        tail, unseen, _, _ = left_out(balance, X)
        orbit = Orbit(Status.OK, "", balance.omega, X.copy(), tail, unseen, curve.work)
        known = stability(balance.pack, orbit) if with_stability else None
        points.append(Point(p, orbit, slope, fold, known))
        return orbit

    put(X, p, tp)
    while len(points) < most_points:
        size = curve.size(X)
        X1, p1 = X + step * tX, p + step * tp
        inside = low <= p1 <= high
        used, sX, sp = 1, tX, tp
        if inside:
            used, X1, p1, sX, sp = curve.correct(X1, p1, tX, tp)
        turned = used and curve.inner(sX, sp, tX, tp, size) < 0.5  # by more than 60 degrees: the step jumped a bend
        if not used or turned:
            step *= 0.4
            if step < LEAST_STEP:
                note = f"the arc's step fell below {LEAST_STEP:g} at {p:.6g}"
                return Branch(tuple(points), Status.NO_CONVERGENCE, note)
            continue
        if not low <= p1 <= high:  # land on the limit
            end = high if p1 > high else low
            share = (end - p) / (p1 - p)
            balance = curve.at(end)
            ok, X2 = newton(balance, X + share * (X1 - X), 20)
            if not ok and step > LEAST_STEP:
                step *= 0.4
                continue
            if not ok:
                return Branch(tuple(points), Status.NO_CONVERGENCE, f"the last point, at {end:.6g}, was not found")
            put(X2, end, sp)
            note = "" if end == stop else f"the branch came back to {end:.6g}"
            return Branch(tuple(points), Status.OK, note)
        if sp * tp < 0:
            fold = _fold(curve, X, p, tX, tp, step)
            if fold is not None:
                put(fold[0], fold[1], 0.0, fold=True)
        X, p, tX, tp = X1, p1, sX, sp
        orbit = put(X, p, tp)
        if harmonics is None and orbit.tail > tolerance and orbit.harmonics < 40:
            more = orbit.harmonics + max(2, orbit.harmonics // 3)
            finer = _Curve(problem, rest, more, 8 * more, low, high)
            ok, X2 = newton(finer.at(p), padded(X, more), 20)
            found = finer.tangent(X2, p) if ok else None
            if found is not None:
                curve, X = finer, X2
                sign = 1.0 if tp * found[1] > 0 else -1.0
                tX, tp = sign * found[0], sign * found[1]
        step = min(most_step, step * min(2.0, max(0.5, (WANTED + 1) / (used + 1))))
    return Branch(tuple(points), Status.TOO_MANY_STEPS, f"{most_points} points, at {p:.6g}")


def _fold(
    curve: _Curve, X: np.ndarray, p: float, tX: np.ndarray, tp: float, step: float
) -> tuple[np.ndarray, float] | None:
    """The turning point within a step: the arc length at which dp/ds = 0, by regula falsi (Illinois)."""
    a, fa, b, fb = 0.0, tp, step, 0.0
    used, XB, pB, _, fb = curve.correct(X + step * tX, p + step * tp, tX, tp)
    best = (XB, pB) if used else None
    for _ in range(30):
        c = (a * fb - b * fa) / (fb - fa)
        used, XC, pC, _, fc = curve.correct(X + c * tX, p + c * tp, tX, tp)
        if not used:
            return best
        best = (XC, pC)
        if abs(fc) < 1e-9 * abs(tp) or abs(b - a) < 1e-12 * step:
            break
        if fc * fb < 0:
            a, fa = b, fb
        else:
            fa *= 0.5
        b, fb = c, fc
    return best
