"""Where a time method must fail: its stability function, and the eigenvalues of a line linearised at rest.

A step h is stable when |R(h lambda)| <= 1 for all eigenvalues lambda of K + lambda C + lambda^2 M that do not grow by
themselves. For every one of the methods R follows from its table or its recursion (Hairer & Wanner, IV.2 and IV.3).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .dispatch import call_gaps, call_tangent, has
from .methods import esdirk, explicit, nystrom

TABLES: dict[str, Any] = {
    "rk2": explicit.RK2, "rk4": explicit.RK4, "dopri5": explicit.DOPRI5, "tsit5": explicit.TSIT5,
    "esdirk4": esdirk.TABLE,
}  # fmt: skip
UNDAMPED = 1e-8  # of the largest eigenvalue: real parts below come from rounding
# |h lambda| at which a stability function is looked at; the symplectic method has a window of 0.005 above pi
RAY = np.sort(np.concatenate([np.geomspace(1e-4, 12.0, 2401), np.linspace(3.16, 3.17, 21)]))
PARTNERS = np.linspace(0.0, 1.0, 9)  # of an overdamped eigenvalue: the slower one of its motion, over it


def amplification(method: str, z: np.ndarray, rho: float = 0.8) -> np.ndarray:
    """|R(z)|, the largest factor by which a step of y' = lambda y changes y, at z = h lambda.

    Parameters
    ----------
    method : 'rk2', 'rk4', 'dopri5', 'tsit5', 'srkn4', 'trbdf2', 'esdirk4', or 'genalpha'
    rho : spectral radius of 'genalpha' at infinity
    z : (...,) complex
    """
    z = np.asarray(z, dtype=complex)
    if method == "genalpha":
        return _generalised(z, rho)
    if method == "srkn4":
        return _nystrom(z)
    if method == "trbdf2":
        d, w = 1.0 - math.sqrt(0.5), 0.25 * math.sqrt(2.0)
        A = np.array([[0.0, 0.0, 0.0], [d, d, 0.0], [w, w, d]])
    else:
        A = TABLES[method].A
    stages = np.linalg.solve(np.eye(len(A)) - z[..., None, None] * A, np.ones((*z.shape, len(A), 1)))
    return np.abs(1.0 + z * (A[-1] @ stages)[..., 0])


def _generalised(z: np.ndarray, rho: float) -> np.ndarray:
    """Spectral radius of (y, h y')_n -> (y, h y')_{n+1}; see `implicit.generalised_alpha`."""
    am, af = 0.5 * (3.0 - rho) / (1.0 + rho), 1.0 / (1.0 + rho)
    g = 0.5 + am - af
    after, before = np.zeros((*z.shape, 2, 2), complex), np.zeros((*z.shape, 2, 2), complex)
    after[..., 0, :], before[..., 0, :] = (1.0, -g), (1.0, 1.0 - g)
    after[..., 1, 0], after[..., 1, 1] = -af * z, am
    before[..., 1, 0], before[..., 1, 1] = (1.0 - af) * z, am - 1.0
    return np.abs(np.linalg.eigvals(np.linalg.solve(after, before))).max(axis=-1)


def _nystrom(z: np.ndarray) -> np.ndarray:
    """Spectral radius of (y, h y')_n -> (y, h y')_{n+1} for the motion whose eigenvalues are z and its conjugate; of a
    real z, which leaves its partner open, the largest over `PARTNERS`: limits of overdamped motion are lower bounds."""
    z = z[..., None]
    partner = np.where(z.imag == 0, z.real * PARTNERS, z.conj())
    damping, stiffness = -(z + partner).real, (z * partner).real
    t, columns = nystrom.TABLE, []
    for y, v in ((1.0, 0.0), (0.0, 1.0)):
        acting = np.zeros((len(t.c), *damping.shape))
        for i, c in enumerate(t.c):
            q, u = y + c * v + np.tensordot(t.b * (c - t.c), acting, 1), v + np.tensordot(t.d[i], acting, 1)
            acting[i] = -stiffness * q - damping * u
        columns.append((y + v + np.tensordot(t.b * (1 - t.c), acting, 1), v + np.tensordot(t.b, acting, 1)))
    (a, c), (b, d) = columns
    half, det = 0.5 * (a + d), a * d - b * c
    apart = half * half - det
    real = np.abs(half) + np.sqrt(np.maximum(apart, 0.0))
    return np.asarray(np.where(apart < 0, np.sqrt(np.abs(det)), real).max(axis=-1))


def tangent_at_rest(pack: Any, q: np.ndarray, cq: float, cv: float, ca: float) -> np.ndarray:
    """(ndof, ndof) dense cq dF/dq + cv dF/dv + ca dF/da at rest in q, prescribed dofs included."""
    n, zero = len(q), np.zeros(len(q))
    J, full = np.zeros((n, 2 * pack.bw + 1)), np.zeros((n, n))
    call_tangent(0.0, q, zero, zero, float(cq), float(cv), float(ca), pack, J)
    i, k = np.nonzero(J)
    full[i, i + k - pack.bw] = J[i, k]
    return full


def linearised(pack: Any, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dense K [N/m], C [N s/m], M [kg] of the free dofs at rest in q."""
    free = np.setdiff1d(np.arange(len(q)), pack.fixed)
    K, C, M = (tangent_at_rest(pack, q, *weights)[np.ix_(free, free)] for weights in np.eye(3))
    return K, C, M


def eigenvalues(pack: Any, q: np.ndarray) -> np.ndarray:
    """(2n,) complex rates lambda of small motions exp(lambda t) about rest in q [1/s]."""
    K, C, M = linearised(pack, q)
    n = len(M)
    state = np.zeros((2 * n, 2 * n))
    state[:n, n:] = np.eye(n)
    state[n:, :n], state[n:, n:] = np.linalg.solve(M, -K), np.linalg.solve(M, -C)
    return np.linalg.eigvals(state)


def taut(model: Any, q: np.ndarray) -> np.ndarray:
    """The state q with every kink of the line's `gaps` just passed: cords taut that only touch in q."""
    if model.n_gaps == 0:
        return q
    g, moved, near = np.zeros(model.n_gaps), np.zeros(model.n_gaps), q.copy()
    zero = np.zeros(len(q))
    nudge = 1e-6 * float(np.ptp(q))
    for _ in range(8):  # cords share their mass, so that opening one may close another
        call_gaps(0.0, near, zero, model.pack, g)
        if (g > 0).all():
            break
        slope = np.zeros((model.n_gaps, len(q)))
        for i in range(len(q)):
            trial = near.copy()
            trial[i] += nudge
            call_gaps(0.0, trial, zero, model.pack, moved)
            slope[:, i] = (moved - g) / nudge
        slope[:, model.pack.fixed] = 0.0
        want = np.maximum(nudge - g, 0.0)
        near = near + np.linalg.lstsq(slope, want, rcond=1e-8)[0]
    return near


def rates(model: Any, static: np.ndarray) -> np.ndarray:
    """Eigenvalues that a march from the static state meets: there, and with all cords taut [1/s]."""
    found = [eigenvalues(model.pack, static)]
    if has(type(model.pack), "gaps") and model.n_gaps > 0:
        found.append(eigenvalues(model.pack, taut(model, static)))
    return np.concatenate(found)


def stable_step(method: str, lam: np.ndarray, rho: float = 0.8, duration: float = math.inf) -> float:
    """Largest step [s] below which no decaying or steady motion grows by more than a factor e over `duration`.

    0 where there is none (Heun's rule on an undamped oscillation over an infinite time), inf where all are stable.

    Parameters
    ----------
    lam : (n,) complex [1/s]
        Eigenvalues; those that grow by themselves are left out.
    """
    size = np.abs(lam)
    lam = lam[(size > 0) & (lam.real <= UNDAMPED * size.max())]
    lam = lam[lam.imag >= 0]
    best = math.inf
    # one ray of z for each direction of an eigenvalue; directions are rounded, so that a line has few of them
    angle = np.where(np.abs(lam.real) <= UNDAMPED * size.max(), 0.5 * math.pi, np.angle(lam))
    rays, which = np.unique(np.round(angle, 4), return_inverse=True)
    for k, direction in enumerate(rays):
        turn = np.exp(1j * direction)
        growth = np.log(amplification(method, RAY * turn, rho))
        for w in np.abs(lam[which.ravel() == k]):
            above = np.flatnonzero(growth > _allowed(RAY, w, duration))
            if not above.size or RAY[max(above[0] - 1, 0)] >= best * w:
                continue
            low, high = (float(RAY[above[0] - 1]) if above[0] > 0 else 0.0), float(RAY[above[0]])
            for _ in range(12):
                x = 0.5 * (low + high)
                over = np.log(amplification(method, np.array(x * turn), rho)) > _allowed(x, w, duration)
                low, high = (low, x) if over else (x, high)
            best = min(best, low / float(w))
    return best


def _allowed(x: Any, w: float, duration: float) -> Any:
    """Growth of ln|y| in a step h = x/w that makes a factor e over the duration; at least rounding."""
    return np.maximum(x / (w * duration), 1e-12) if math.isfinite(duration) else 1e-12
