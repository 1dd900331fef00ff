"""Stability of a periodic response: its Floquet multipliers, from the contract's tangent alone.

A small disturbance x of the response obeys M(t) x'' + C(t) x' + K(t) x = 0 with the tangent's K, C, M along the
response. Its map over one period has the multipliers as eigenvalues: one outside the unit circle, and the response
exists but does not last. +1 is a fold, -1 a period doubling, a complex pair a Neimark-Sacker bifurcation: the strongly
modulated response of a nonlinear energy sink.

The map is applied, not formed: a period of an L-stable Runge-Kutta method of order 3 (Alexander 1977) on the banded
tangent, factored once for each stage; Arnoldi's method then finds the largest multipliers. L-stability damps axial
modes that no step resolves as if they were truly damped: they are not what makes a response unstable.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

from ..banded import factor, hold, substitute
from ..compile import kernel
from ..dispatch import tangent
from .harmonic import Orbit

GAMMA = 0.43586652150845967  # root of x^3 - 3 x^2 + 3/2 x - 1/6
A21 = (1 - GAMMA) / 2
B1, B2 = -(6 * GAMMA**2 - 16 * GAMMA + 1) / 4, (6 * GAMMA**2 - 20 * GAMMA + 5) / 4
NODES = (GAMMA, (1 + GAMMA) / 2, 1.0)
DENSE = 40  # disturbances up to which the map is formed
SEEN = 6  # multipliers that Arnoldi's method looks for
STEPS = 24  # of the shortest period that matters, at first
MATTERS = 0.1  # a harmonic with more than this share of the largest matters
MOST_STEPS = 6144  # of a period
SAFE = 0.8  # a size that stays below this with its error need not be known better
CHANGE = 2e-3  # change of the largest size on doubling the steps that is good enough
MARGIN = 1e-3  # a size within this of 1 counts as stable


@kernel
def prepare(phase, omega, q, v, a, pack, h, K, C, J):
    """Tangents at each stage, and the factored M + g h C + (g h)^2 K."""
    g = GAMMA * h
    for k in range(len(phase)):
        t = phase[k] / omega
        tangent(t, q[k], v[k], a[k], 1.0, 0.0, 0.0, pack, K[k])
        tangent(t, q[k], v[k], a[k], 0.0, 1.0, 0.0, pack, C[k])
        tangent(t, q[k], v[k], a[k], g * g, g, 1.0, pack, J[k])
        hold(J[k], pack.bw, pack.fixed)
        if not factor(J[k], pack.bw):
            return False
    return True


@kernel
def multiply(J, bw, x, y):
    """y -= J x."""
    n = len(x)
    for i in range(n):
        s = 0.0
        for j in range(max(0, i - bw), min(n - 1, i + bw) + 1):
            s += J[i, bw + j - i] * x[j]
        y[i] -= s


@kernel
def carry(K, C, J, bw, fixed, h, x, v, w):
    """Carry the disturbance (x, v) over one period in place; w: (7, n) scratch."""
    n, g = len(x), GAMMA * h
    for step in range(len(K) // 3):
        for s in range(3):
            stage = 3 * step + s
            b1, b2 = 0.0, 0.0
            if s == 1:
                b1 = A21
            elif s == 2:
                b1, b2 = B1, B2
            for i in range(n):  # w[0], w[1]: v' of the first stages, w[2], w[3]: v; here the stage without its own part
                w[4, i] = v[i] + h * (b1 * w[0, i] + b2 * w[1, i]) if s > 0 else v[i]
                own = x[i] + h * (b1 * w[2, i] + b2 * w[3, i]) if s > 0 else x[i]
                w[5, i] = own + g * w[4, i]
            right = w[6]
            for i in range(n):
                right[i] = 0.0
            multiply(C[stage], bw, w[4], right)
            multiply(K[stage], bw, w[5], right)
            for k in range(len(fixed)):
                right[fixed[k]] = 0.0
            substitute(J[stage], bw, right)
            if s < 2:
                for i in range(n):
                    w[s, i] = right[i]
                    w[2 + s, i] = w[4, i] + g * right[i]
            else:
                for i in range(n):
                    x[i] = w[5, i] + g * g * right[i]
                    v[i] = w[4, i] + g * right[i]


class Stability(NamedTuple):
    """What is known of a periodic response's stability."""

    multipliers: np.ndarray  # (k,) complex, largest first
    largest: float  # size of the largest
    error: float  # its change on the last doubling of the steps; NaN when they were given
    steps: int  # of a period

    @property
    def stable(self) -> bool:
        """False when a multiplier lies outside the unit circle, is NaN, or is not known well enough to tell."""
        if self.error > CHANGE:
            return bool(self.largest + self.error < 1)
        return bool(self.largest <= 1 + MARGIN)

    @property
    def kind(self) -> str:
        """How stability is lost: fold, period doubling or a modulation (Neimark-Sacker)."""
        if not len(self.multipliers):
            return ""
        first = complex(self.multipliers[0])
        if abs(first.imag) > 1e-3 * abs(first):
            return "modulation"
        return "fold" if first.real > 0 else "period doubling"


def stability(pack: Any, orbit: Orbit, steps: int | None = None) -> Stability:
    """Floquet multipliers of a periodic response.

    Parameters
    ----------
    steps : int, optional
        Of a period, and no others; by default they double until the largest multiplier is known well enough to say on
        which side of the unit circle it lies.
    """
    if steps is not None:
        found = _multipliers(pack, orbit, steps)
        return Stability(found, _largest(found), math.nan, steps)
    size = np.hypot(orbit.X[:, 1::2], orbit.X[:, 2::2]).max(axis=0)
    top = int(np.flatnonzero(size > MATTERS * size.max()).max(initial=0)) + 1
    n = max(STEPS * top, 2 * orbit.harmonics)
    before = _largest(_multipliers(pack, orbit, n))
    while True:
        n *= 2
        found = _multipliers(pack, orbit, n)
        largest = _largest(found)
        error = abs(largest - before)
        if n >= MOST_STEPS or not (error > CHANGE and largest + error > SAFE):  # NaN ends it too
            return Stability(found, largest, error, n)
        before = largest


def _largest(found: np.ndarray) -> float:
    return float(np.abs(found).max(initial=0.0)) if np.isfinite(found).all() else math.nan


def _multipliers(pack: Any, orbit: Orbit, steps: int) -> np.ndarray:
    h = 2 * math.pi / orbit.omega / steps
    phase = (np.arange(steps)[:, None] + np.array(NODES)).reshape(-1) * (2 * math.pi / steps)
    q, v, a = orbit.at(phase)
    ndof, bw = len(orbit.X), pack.bw
    K, C, J = (np.zeros((len(phase), ndof, 2 * bw + 1)) for _ in range(3))
    if not prepare(phase, orbit.omega, q, v, a, pack, h, K, C, J):
        return np.full(1, math.nan)
    free = np.ones(ndof, dtype=bool)
    free[pack.fixed] = False
    n, w = int(free.sum()), np.zeros((7, ndof))
    scale = np.sqrt(pack.weight[free])  # disturbances measured in energy, at omega

    def over_a_period(x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, dtype=float).reshape(-1)
        p, s = np.zeros(ndof), np.zeros(ndof)
        p[free], s[free] = x[:n] / scale, x[n:] * orbit.omega / scale
        carry(K, C, J, bw, pack.fixed, h, p, s, w)
        return np.concatenate([p[free] * scale, s[free] * scale / orbit.omega])

    if 2 * n <= DENSE:
        values = np.linalg.eigvals(np.column_stack([over_a_period(e) for e in np.eye(2 * n)]))
    else:
        start = np.random.default_rng(0).standard_normal(2 * n)
        try:
            values = eigs(
                LinearOperator((2 * n, 2 * n), matvec=over_a_period), k=SEEN, which="LM", v0=start, tol=1e-4,
                return_eigenvectors=False,
            )  # fmt: skip
        except ArpackNoConvergence:  # the one that is missing may be the largest
            values = np.linalg.eigvals(np.column_stack([over_a_period(e) for e in np.eye(2 * n)]))
    return values[np.argsort(-np.abs(values))]
