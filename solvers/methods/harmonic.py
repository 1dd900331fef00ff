"""Harmonic balance: the periodic response of any line, from its residual and tangent alone (papers 000, 002).

Every dof is a Fourier series with orthonormal terms, q(t) = q0/sqrt(2) + sum_h qc_h cos(h w t) + qs_h sin(h w t): the
mean is q0/sqrt(2). Unknowns X[i, :] = (q0, qc_1, qs_1, qc_2, ...): node-major, harmonics innermost. The residual is
sampled over a period and projected on the terms (alternating frequency-time). Its Jacobian couples term a of dof i
with term b of dof j through the Fourier coefficients of K(t), C(t), M(t) up to order 2H: Toeplitz plus Hankel
blocks. Blocks couple neighbours along the cable only, so one LU costs the number of nodes.

Discrete sums are exact for these products, so that the blocks are the exact derivative of a residual sampled at the
same times; the residual itself is sampled at more.
Samples alias what lies above their count: `Balance.error` samples again at twice as many times and says what it finds
there in the units of the solution, as it does for the harmonics that the series leaves out.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import get_blas_funcs, get_lapack_funcs
from scipy.sparse import bmat, csc_matrix, diags, identity
from scipy.sparse.linalg import splu

from .. import banded
from ..compile import kernel
from ..dispatch import call_tangent, drive, residual, tangent
from ..model import Status

LADDER = (3, 5, 8, 12, 16, 22, 30, 40)  # harmonics tried in turn
NEWTON = 1e-9  # a Newton step this small, relative to the motion, ends the iteration
ROUNDING = 2e-14  # the same relative to the coordinates themselves: what rounding leaves
STILL = 1e-7  # a swing below this share of the coordinates or forces themselves is none
CHORD = 0.1  # a step that shrinks by this factor under an old Jacobian keeps it
CARRIED = 5e-7  # the same under a neighbour's Jacobian with Broyden's updates: a thousandth of the usual tolerance
PACE = 0.5  # a step that shrinks less than by this under it asks for a Jacobian of its own
MOST_CARRIED = 15
MOST_ITERATIONS = 40
LEAST_DAMPING = 1e-3
BRAKES = (3.0, 1.0)  # damping added to the Jacobian in the first steps from rest, in units of inertia times omega
LEAST_SHARE = 1e-3  # of the amplitude: smallest step of the continuation from rest
SMALL = 64  # rows of a block up to which its solution is compiled here, not LAPACK's
FEWEST = 12  # times of a period that a mean tangent needs
MOST_SAMPLES = 4096  # of a period
MOST_MISSED = 2  # rungs of the ladder that may fail
MOST_FALLS = 10  # failed steps of that continuation
MOST_FALLBACK = 20_000  # unknowns up to which Levenberg-Marquardt is tried


# ------------------------------------------------------------------------------------------------- series


class Series(NamedTuple):
    """Values of the terms at samples of one period, and their first two derivatives by the phase."""

    phase: np.ndarray  # (n,) in [0, 2 pi)
    value: np.ndarray  # (n, 2H + 1)
    rate: np.ndarray
    bend: np.ndarray
    project: np.ndarray  # (2H + 1, n) samples -> coefficients


def terms(harmonics: int, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The terms and their first two derivatives by the phase, each (n, 2 H + 1)."""
    h = np.arange(1, harmonics + 1)
    angle = np.outer(phase, h)
    out = [np.zeros((len(phase), 2 * harmonics + 1)) for _ in range(3)]
    c, s = np.cos(angle), np.sin(angle)
    out[0][:, 0] = 1 / math.sqrt(2)
    out[0][:, 1::2], out[0][:, 2::2] = c, s
    out[1][:, 1::2], out[1][:, 2::2] = -h * s, h * c
    out[2][:, 1::2], out[2][:, 2::2] = -h * h * c, -h * h * s
    return out[0], out[1], out[2]


@functools.lru_cache(maxsize=64)
def series(harmonics: int, samples: int, shift: float = 0.0) -> Series:
    """Equidistant samples, the first at `shift` of a sampling interval. Kept: not to be written to."""
    phase = 2 * math.pi * (np.arange(samples) + shift) / samples
    value, rate, bend = terms(harmonics, phase)
    return Series(phase, value, rate, bend, 2 / samples * np.ascontiguousarray(value.T))


def padded(X: np.ndarray, harmonics: int) -> np.ndarray:
    """The same series with another number of harmonics."""
    out = np.zeros((len(X), 2 * harmonics + 1))
    n = min(out.shape[1], X.shape[1])
    out[:, :n] = X[:, :n]
    return out


# ------------------------------------------------------------------------------------------------- kernels


@kernel
def sample_drive(phase, omega, pack, q, v, a):
    for k in range(len(phase)):
        drive(phase[k] / omega, pack, q[k], v[k], a[k])


@kernel
def sample_residual(phase, omega, q, v, a, pack, r):
    for k in range(len(phase)):
        residual(phase[k] / omega, q[k], v[k], a[k], pack, r[k])


@kernel
def sample_tangent(phase, omega, q, v, a, pack, K, C, M):
    for k in range(len(phase)):
        t = phase[k] / omega
        tangent(t, q[k], v[k], a[k], 1.0, 0.0, 0.0, pack, K[k])
        tangent(t, q[k], v[k], a[k], 0.0, 1.0, 0.0, pack, C[k])
        tangent(t, q[k], v[k], a[k], 0.0, 0.0, 1.0, pack, M[k])


@kernel
def place_blocks(K, C, M, omega, bw, held, block, first, size, D, L, U, pad, buffer):
    """Band entries' Fourier coefficients (ndof, 2 bw + 1, 4H + 1: cos 0..2H, then sin 1..2H) -> blocks, column-major.

    Row term a, column term b: <cos a, f cos b> = (Fc|a-b| + Fc(a+b))/2 and its kin, F twice the mean of f cos, f sin.
    A column cos b stands for q cos, v -b w sin, a -b^2 w^2 cos.
    """
    n, orders = K.shape[0], K.shape[2] // 2 // 2
    top = 2 * orders  # order of the highest coefficient
    nh = 2 * orders + 1
    buffer[:] = 0.0
    for i in range(n):
        bi = block[i]
        row = (i - first[bi]) * nh
        if held[i]:
            for x in range(nh):
                buffer[D[bi] + (row + x) * size[bi] + row + x] = 1.0
            continue
        for m in range(2 * bw + 1):
            j = i + m - bw
            if j < 0 or j >= n:
                continue
            still, turns, swings = True, False, False
            for x in range(K.shape[2]):
                if K[i, m, x] != 0.0:
                    still = False
                if C[i, m, x] != 0.0:
                    turns = True
                if M[i, m, x] != 0.0:
                    swings = True
            if still and not turns and not swings:
                continue
            bj = block[j]
            if bj > bi + 1 or bj < bi - 1:
                return False
            base = D[bi] if bj == bi else (L[bi] if bj < bi else U[bi])
            column = (j - first[bj]) * nh
            high = size[bi]
            k, c, mm = K[i, m], C[i, m], M[i, m]
            for b in range(orders + 1):
                w, ww = omega * b, (omega * b) ** 2
                fb = math.sqrt(0.5) if b == 0 else 1.0
                for a in range(orders + 1):
                    f = fb * (math.sqrt(0.5) if a == 0 else 1.0)
                    d, s = abs(a - b), a + b
                    # G = K - b^2 w^2 M
                    gd, gs = k[d] - ww * mm[d], k[s] - ww * mm[s]
                    hd = 0.0 if d == 0 else k[top + d] - ww * mm[top + d]
                    hs = 0.0 if s == 0 else k[top + s] - ww * mm[top + s]
                    cd, cs = c[d], c[s]
                    ed = 0.0 if d == 0 else c[top + d]
                    es = 0.0 if s == 0 else c[top + s]
                    if b > a:  # sin is odd: <cos a, f sin b> wants Fs(b - a)
                        ba, eba = hd, ed
                    else:
                        ba, eba = -hd, -ed
                    # T[f]: cc, cs, sc, ss; the rate's columns: cos b -> -b w sin b, sin b -> b w cos b
                    cc = 0.5 * (gd + gs) - w * 0.5 * (es + eba)
                    css = 0.5 * (hs + ba) + w * 0.5 * (cd + cs)
                    scc = 0.5 * (hs - ba) - w * 0.5 * (cd - cs)
                    ss = 0.5 * (gd - gs) + w * 0.5 * (es - eba)
                    ra = row if a == 0 else row + 2 * a - 1
                    cb = column if b == 0 else column + 2 * b - 1
                    buffer[base + cb * high + ra] = f * cc
                    if a > 0:
                        buffer[base + cb * high + ra + 1] = f * scc
                    if b > 0:
                        buffer[base + (cb + 1) * high + ra] = f * css
                    if a > 0 and b > 0:
                        buffer[base + (cb + 1) * high + ra + 1] = f * ss
        # a row without stiffness, such as that of a mass between slack cords, keeps its mean
        at = D[bi] + row * size[bi] + row
        if abs(buffer[at]) < pad[i]:
            buffer[at] = pad[i]
    return True


@kernel
def sweep_blocks(D, L, U, size, start, pivots, buffer, x):
    """Solve with the factored blocks in place, one right-hand side: LAPACK's calls would cost more than their work."""
    last = len(size) - 1
    for k in range(last + 1):
        m, at = size[k], start[k]
        if k > 0:
            before = start[k - 1]
            for j in range(size[k - 1]):
                c, column = x[before + j], L[k] + j * m
                for i in range(m):
                    x[at + i] -= buffer[column + i] * c
        for i in range(m):
            p = pivots[at + i]
            if p != i:
                x[at + i], x[at + p] = x[at + p], x[at + i]
        for j in range(m):
            c, column = x[at + j], D[k] + j * m
            for i in range(j + 1, m):
                x[at + i] -= buffer[column + i] * c
        for j in range(m - 1, -1, -1):
            column = D[k] + j * m
            c = x[at + j] / buffer[column + j]
            x[at + j] = c
            for i in range(j):
                x[at + i] -= buffer[column + i] * c
    for k in range(last - 1, -1, -1):
        m, at, after = size[k], start[k], start[k + 1]
        for j in range(size[k + 1]):
            c, column = x[after + j], U[k] + j * m
            for i in range(m):
                x[at + i] -= buffer[column + i] * c


@kernel
def answer_harmonics(K, C, M, omega, first, bw, fixed, right, J, x, ends):
    """Answers to harmonics from `first` on by the mean K, C, M: right (harmonics, ndof) complex is overwritten; the
    forces that the fixed dofs then take are in ends (harmonics, nfixed)."""
    n = len(K)
    for k in range(len(right)):
        w = omega * (first + k)
        for i in range(n):
            for m in range(2 * bw + 1):
                J[i, m] = complex(K[i, m] - w * w * M[i, m], w * C[i, m])
            x[i] = right[k, i]
        for f in range(len(fixed)):
            x[fixed[f]] = 0.0
            ends[k, f] = right[k, fixed[f]]
        banded.hold(J, bw, fixed)
        if not banded.factor(J, bw):
            return False
        banded.substitute(J, bw, x)
        for f in range(len(fixed)):
            i = fixed[f]
            for j in range(max(0, i - bw), min(n - 1, i + bw) + 1):
                m = bw + j - i
                ends[k, f] -= complex(K[i, m] - w * w * M[i, m], w * C[i, m]) * x[j]
        for i in range(n):
            right[k, i] = x[i]
    return True


# ------------------------------------------------------------------------------------------------- blocks


class Blocks:
    """Block tridiagonal LU: blocks of dofs that reach no further than the next one, LAPACK inside."""

    def __init__(self, reach: np.ndarray, nh: int) -> None:
        """`reach[i]`: the last dof that row or column i couples with."""
        n = len(reach)
        best: list[int] = []
        for head in range(1, min(n, int(reach[0]) + 1) + 1):
            cuts = [0, head]
            while cuts[-1] < n:
                cuts.append(max(int(reach[: cuts[-1]].max()) + 1, cuts[-1] + 1))
            if not best or (np.diff(cuts) ** 3).sum() < (np.diff(best) ** 3).sum():
                best = cuts
        first, dofs = np.array(best[:-1]), np.diff(best)
        self.first, self.size = first.astype(np.int64), (dofs * nh).astype(np.int64)
        self.block = np.repeat(np.arange(len(dofs)), dofs).astype(np.int64)
        self.start = np.concatenate([[0], np.cumsum(self.size)]).astype(np.int64)
        m = self.size
        low = np.concatenate([[0], m[1:] * m[:-1]])
        up = np.concatenate([m[:-1] * m[1:], [0]])
        self.D = np.concatenate([[0], np.cumsum(m * m)]).astype(np.int64)
        self.L = (self.D[-1] + np.concatenate([[0], np.cumsum(low)])).astype(np.int64)
        self.U = (self.L[-1] + np.concatenate([[0], np.cumsum(up)])).astype(np.int64)
        self.buffer = np.zeros(int(self.U[-1]))
        b = range(len(m))
        self.d = [self._view(self.D, k, m[k], m[k]) for k in b]
        self.l = [self._view(self.L, k, m[k], m[k - 1]) if k else None for k in b]
        self.u = [self._view(self.U, k, m[k], m[k + 1]) if k + 1 < len(m) else None for k in b]
        self._getrf, self._getrs = get_lapack_funcs(("getrf", "getrs"), dtype=np.float64)
        (self._gemm,) = get_blas_funcs(("gemm",), dtype=np.float64)
        self._pivots: list[np.ndarray] = []
        self._swaps = np.zeros(int(self.start[-1]), dtype=np.int64)

    def _view(self, at: np.ndarray, k: int, rows: int, columns: int) -> np.ndarray:
        return self.buffer[at[k] : at[k] + rows * columns].reshape(columns, rows).T

    def factor(self) -> bool:
        """LU in place; False when a block is singular or not a number."""
        self._pivots = []
        for k, d in enumerate(self.d):
            if k:
                self._gemm(-1.0, self.l[k], self.u[k - 1], 1.0, d, overwrite_c=True)
            _, pivots, info = self._getrf(d, overwrite_a=True)
            if info != 0 or not math.isfinite(d[-1, -1]):
                return False
            self._pivots.append(pivots)
            self._swaps[self.start[k] : self.start[k + 1]] = pivots
            if self.u[k] is not None:
                self._getrs(d, pivots, self.u[k], overwrite_b=True)
        return True

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution for right-hand sides (n,) or (n, m)."""
        if right.ndim == 1 and self.size.max() <= SMALL:
            x = right.copy()
            sweep_blocks(self.D, self.L, self.U, self.size, self.start, self._swaps, self.buffer, x)
            return x
        x = np.asfortranarray(right if right.ndim == 2 else right[:, None])
        parts = [x[self.start[k] : self.start[k + 1]] for k in range(len(self.d))]
        found: list[np.ndarray] = []
        for k, d in enumerate(self.d):
            y = parts[k] if k == 0 else parts[k] - self.l[k] @ found[-1]
            found.append(self._getrs(d, self._pivots[k], y)[0])
        for k in range(len(self.d) - 2, -1, -1):
            found[k] -= self.u[k] @ found[k + 1]
        out = np.concatenate(found)
        return out if right.ndim == 2 else out[:, 0]

    def sparse(self) -> csc_matrix:
        """The whole matrix, before it is factored."""
        rows: list[list[Any]] = [[None] * len(self.d) for _ in self.d]
        for k, d in enumerate(self.d):
            rows[k][k] = csc_matrix(d)
            if k:
                rows[k][k - 1] = csc_matrix(self.l[k])
            if self.u[k] is not None:
                rows[k][k + 1] = csc_matrix(self.u[k])
        return csc_matrix(bmat(rows))


# ------------------------------------------------------------------------------------------------- balance


@dataclass
class Work:
    """Counted work of a solution."""

    iterations: int = 0
    evaluations: int = 0  # residuals at one time
    factorisations: int = 0


@dataclass(frozen=True)
class Orbit:
    """A periodic response and what is known of its error."""

    status: Status
    message: str
    omega: float  # [rad/s]
    X: np.ndarray  # (ndof, 2H + 1)
    tail: float = math.nan  # missing harmonics, relative to the motion's largest, estimated
    unseen: float = math.nan  # force left over at unseen times, relative to the force that swings
    work: Work = field(default_factory=Work)
    balance: Balance | None = field(default=None, repr=False, compare=False)  # its memory serves a neighbour again

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "balance": None}

    @property
    def harmonics(self) -> int:
        return self.X.shape[1] // 2

    def at(self, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q, q', q'' at phases w t; each (n, ndof)."""
        value, rate, bend = terms(self.harmonics, phase)
        X = np.ascontiguousarray(self.X.T)
        return value @ X, self.omega * rate @ X, self.omega**2 * bend @ X


class Balance:
    """The balance of one line over one period with a given number of harmonics.

    Parameters
    ----------
    pack : NamedTuple
        The line; its motion has the period 2 pi/omega.
    omega : float [rad/s]
    harmonics : int
    samples : int
        Of the residual over a period; the Jacobian takes the fewest that are exact for a cubic force, 4 H + 2.
    share : float
        Of the swing of the prescribed dofs: below 1 in the continuation from rest.
    """

    def __init__(
        self, pack: Any, omega: float, harmonics: int, samples: int, reach: np.ndarray, work: Work | None = None
    ) -> None:
        self.pack, self.omega, self.harmonics, self.samples = pack, float(omega), harmonics, samples
        self.ndof, self.nh = len(pack.weight), 2 * harmonics + 1
        self.work = Work() if work is None else work
        self.reach, self.blocks = reach, Blocks(reach, self.nh)
        self.own = self.factored = False  # are the blocks' factors those of this motion; are there any
        self.held = np.zeros(self.ndof, dtype=np.bool_)
        self.held[pack.fixed] = True
        self.pad = 1e-9 * omega**2 * pack.weight
        few = series(harmonics, max(4 * harmonics + 2, 16))
        self.few, n = few, len(few.phase)
        order = np.arange(1, 2 * harmonics + 1)
        angle = np.outer(few.phase, order)
        self.spectrum = 2 / n * np.hstack([np.ones((n, 1)), np.cos(angle), np.sin(angle)])
        self.band = np.zeros((3, n, self.ndof, 2 * pack.bw + 1))
        self.resample(samples)
        self.share = 1.0
        self.brake = 0.0  # added damping weight * omega * brake of the Jacobian alone: quadratic drag has none at rest

    def move(self, pack: Any, omega: float) -> None:
        """Another line of the same build, or another frequency."""
        self.pack, self.omega = pack, float(omega)
        self.pad = 1e-9 * self.omega**2 * pack.weight
        self.swing = targets(pack, self.omega, self.many)
        self.own, self.share, self.brake = False, 1.0, 0.0

    def serves(self, pack: Any, harmonics: int) -> bool:
        """Whether the factors at hand may be a neighbour's: same build, as many harmonics."""
        mine = self.pack
        alike = type(mine) is type(pack) and mine.bw == pack.bw and len(mine.weight) == len(pack.weight)
        return self.factored and harmonics == self.harmonics and alike and np.array_equal(mine.fixed, pack.fixed)

    def resample(self, samples: int) -> None:
        """Take the residual at another number of times."""
        self.samples = samples
        self.many = series(self.harmonics, samples)
        self.r = np.zeros((samples, self.ndof))
        self.swing = targets(self.pack, self.omega, self.many)

    @property
    def target(self) -> np.ndarray:
        """Series of the prescribed dofs, (nfixed, 2H + 1)."""
        out = self.share * self.swing
        out[:, 0] = self.swing[:, 0]
        return out

    def states(self, X: np.ndarray, at: Series) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        XT = np.ascontiguousarray(X.T)
        return at.value @ XT, self.omega * (at.rate @ XT), self.omega**2 * (at.bend @ XT)

    def forces(self, X: np.ndarray) -> np.ndarray:
        """The projected residual in all rows, (ndof, 2H + 1)."""
        q, v, a = self.states(X, self.many)
        sample_residual(self.many.phase, self.omega, q, v, a, self.pack, self.r)
        self.work.evaluations += self.samples
        return np.ascontiguousarray((self.many.project @ self.r).T)

    def residual(self, X: np.ndarray) -> np.ndarray:
        """What Newton brings to zero: forces at the free dofs, q - target at the prescribed ones."""
        R = self.forces(X)
        fixed = self.pack.fixed
        R[fixed] = X[fixed] - self.target
        return R

    def linearise(self, X: np.ndarray) -> None:
        """Blocks of dR/dX at X."""
        q, v, a = self.states(X, self.few)
        K, C, M = self.band
        sample_tangent(self.few.phase, self.omega, q, v, a, self.pack, K, C, M)
        n, shape = len(self.few.phase), (self.ndof, K.shape[2], 4 * self.harmonics + 1)
        Kf, Cf, Mf = (np.dot(x.reshape(n, -1).T, self.spectrum).reshape(shape) for x in (K, C, M))
        omega, bw = self.omega, self.pack.bw
        Cf[:, bw, 0] += 2 * self.brake * omega * self.pack.weight
        b = self.blocks
        args = (b.block, b.first, b.size, b.D, b.L, b.U, self.pad, b.buffer)
        if not place_blocks(Kf, Cf, Mf, omega, bw, self.held, *args):  # dofs touch that did not touch at rest
            self.blocks = b = Blocks(np.minimum(np.arange(self.ndof) + bw, self.ndof - 1), self.nh)
            args = (b.block, b.first, b.size, b.D, b.L, b.U, self.pad, b.buffer)
            place_blocks(Kf, Cf, Mf, omega, bw, self.held, *args)

    def factor(self, X: np.ndarray) -> bool:
        self.linearise(X)
        self.work.factorisations += 1
        self.factored = self.own = self.blocks.factor()
        return self.factored

    def mean(self, X: np.ndarray) -> list[np.ndarray]:
        """Mean K, C, M over the period: at the last Jacobian, or where that is a neighbour's from a few times at X."""
        if self.own:
            return [x.mean(axis=0) for x in self.band]
        every = max(1, len(self.few.phase) // FEWEST)
        q, v, a = (np.ascontiguousarray(x[::every]) for x in self.states(X, self.few))
        K, C, M = (x[: len(q)] for x in self.band)
        sample_tangent(np.ascontiguousarray(self.few.phase[::every]), self.omega, q, v, a, self.pack, K, C, M)
        return [x.mean(axis=0) for x in (K, C, M)]

    def solve(self, R: np.ndarray) -> np.ndarray:
        """dX with (dR/dX) dX = R."""
        return self.blocks.solve(R.reshape(-1)).reshape(self.ndof, self.nh)

    def size(self, dX: np.ndarray) -> float:
        """Root mean square of a change over dofs (by their inertia) and time, in metres or the like."""
        return math.sqrt(max(float(self.pack.weight @ (dX * dX).sum(axis=1)) / float(self.pack.weight.sum()), 0.0))

    def motion(self, X: np.ndarray) -> float:
        """Size of the swing about the mean: what changes are measured against."""
        return self.size(X[:, 1:])


def targets(pack: Any, omega: float, at: Series) -> np.ndarray:
    """Fourier coefficients of the prescribed dofs, (nfixed, 2H + 1)."""
    n, ndof = len(at.phase), len(pack.weight)
    q, v, a = np.zeros((n, ndof)), np.zeros((n, ndof)), np.zeros((n, ndof))
    sample_drive(at.phase, omega, pack, q, v, a)
    return np.ascontiguousarray((at.project @ q[:, pack.fixed]).T)


def reach_of(pack: Any, q: np.ndarray) -> np.ndarray:
    """The last dof that each dof couples with, from the pattern of the tangent at a scattered state near q."""
    n, w = len(q), 2 * pack.bw + 1
    draw = np.random.default_rng(0)
    found = np.zeros((n, w), dtype=bool)
    J = np.zeros((n, w))
    for _ in range(3):
        near = [1e-3 * draw.standard_normal(n) for _ in range(3)]
        for k in range(3):
            c = [float(m == k) for m in range(3)]
            call_tangent(0.0, q + near[0], near[1], near[2], c[0], c[1], c[2], pack, J)
            found |= J != 0.0
    i, m = np.nonzero(found)
    reach = np.arange(n)
    j = i + m - pack.bw
    np.maximum.at(reach, i, j)
    np.maximum.at(reach, j, i)  # the pattern of a column counts as its row's
    return reach


# ------------------------------------------------------------------------------------------------- solution


def newton(balance: Balance, X: np.ndarray, most: int = MOST_ITERATIONS) -> tuple[bool, np.ndarray]:
    """Damped Newton with the natural monotonicity test (Deuflhard), and chord steps while they contract fast.

    Returns whether the last step was below `NEWTON` of the motion, and the last X.
    """
    R = balance.residual(X)
    damping = 1.0
    for _ in range(most):
        if not np.isfinite(R).all() or not balance.factor(X):
            return False, X
        balance.work.iterations += 1
        dX = balance.solve(-R)
        size = balance.size(dX)
        if not size < 1e30:
            return False, X
        while True:  # accept the step when a second one with the same Jacobian is smaller
            trial = X + damping * dX
            R = balance.residual(trial)
            small = NEWTON * balance.motion(trial) + ROUNDING * balance.size(trial)
            if damping == 1.0 and size <= small:
                return True, trial
            next_dX = balance.solve(-R)
            next_size = balance.size(next_dX)
            if next_size <= (1 - damping / 4) * size:
                break
            damping /= 2 if next_size < 4 * size else 4
            if damping < LEAST_DAMPING:
                return False, X
        X = trial
        damping = min(1.0, 2 * damping) if next_size > 0.5 * size * (1 - damping) else 1.0
        while next_size <= CHORD * size:
            X, size = X + next_dX, next_size
            R = balance.residual(X)
            if size <= small:
                return True, X
            next_dX = balance.solve(-R)
            next_size = balance.size(next_dX)
    return False, X


def carried(balance: Balance, X: np.ndarray) -> tuple[bool, np.ndarray]:
    """Broyden's method from the factored Jacobian of a neighbour, steps kept instead of a matrix (Kelley 1995, 7.3).

    Returns whether the last step was below `CARRIED` of the motion, and the best X: where steps shrink too slowly, a
    Jacobian of its own is worth its price.
    """
    weight = balance.pack.weight[:, None]
    step, before, steps, norms = balance.solve(-balance.residual(X)), math.inf, [], []
    for _ in range(MOST_CARRIED):
        size = balance.size(step)
        if not size < PACE * before:
            return False, X + step if size < before else X
        X, before = X + step, size
        balance.work.iterations += 1
        if size <= CARRIED * balance.motion(X):
            return True, X
        steps.append(step)
        norms.append(float((weight * step * step).sum()))
        step = balance.solve(-balance.residual(X))
        for k in range(len(steps) - 1):
            step = step + steps[k + 1] * (float((weight * steps[k] * step).sum()) / norms[k])
        step = step / (1 - float((weight * steps[-1] * step).sum()) / norms[-1])
    return False, X


def from_rest(balance: Balance, X: np.ndarray) -> tuple[bool, np.ndarray]:
    """Newton at the whole amplitude, else continuation in the amplitude from rest, else Levenberg-Marquardt.

    Quadratic drag has no damping at rest, so that the first linear answer would be that of a bare line at resonance:
    two steps with an added damping in the Jacobian lead to where drag takes over.
    """
    rest = X
    for brake in BRAKES:
        balance.brake = brake
        step = balance.solve(-balance.residual(X)) if balance.factor(X) else np.zeros_like(X)
        X = X + step if np.isfinite(step).all() else X
    balance.brake = 0.0
    converged, X = newton(balance, X, 30)
    if not converged:
        converged, X = grown(balance, rest)
    if not converged and X.size <= MOST_FALLBACK:
        converged, X = levenberg_marquardt(balance, X)
    return converged, X


def grown(balance: Balance, X: np.ndarray) -> tuple[bool, np.ndarray]:
    """Continuation in the amplitude of the prescribed motion from rest; on failure, as far as it came."""
    share, step, fallen = 0.0, 0.1, 0
    before: tuple[float, np.ndarray] | None = None
    while share < 1.0 and len(balance.pack.fixed):
        balance.share = min(1.0, share + step)
        guess = X
        if before is not None:  # along the secant
            guess = X + (X - before[1]) * ((balance.share - share) / (share - before[0]))
        converged, found = newton(balance, guess, 15)
        if converged:
            before, X, share, step = (share, X), found, balance.share, 1.5 * step
        else:
            step, fallen = step / 3, fallen + 1
            if step < LEAST_SHARE or fallen > MOST_FALLS:
                break
    balance.share = 1.0
    return share >= 1.0, X


def levenberg_marquardt(balance: Balance, X: np.ndarray, most: int = 15) -> tuple[bool, np.ndarray]:
    """The fallback of paper 000: least |R|^2 with a growing trust; rows scaled by the Jacobian's at the start.

    (J'J + mu D) dX = -J'R as one sparse system [[I, J], [J', -mu D]], which does not square J's condition.
    """
    mu, scale, converged = 1e-3, None, False
    for _ in range(most):
        balance.linearise(X)
        J = balance.blocks.sparse()
        if scale is None:
            scale = 1 / np.maximum(np.sqrt(np.asarray(J.multiply(J).sum(axis=1)).ravel()), 1e-300)
        J = diags(scale) @ J
        R = scale * balance.residual(X).reshape(-1)
        balance.work.iterations += 1
        balance.work.factorisations += 1
        n, norm = len(R), float(R @ R)
        D = diags(np.maximum(np.asarray(J.multiply(J).sum(axis=0)).ravel(), 1e-12))
        for _ in range(30):
            system = bmat([[identity(n), J], [J.T, -mu * D]], format="csc")
            try:
                dX = splu(system).solve(np.concatenate([-R, np.zeros(n)]))[n:].reshape(X.shape)
            except RuntimeError:  # singular
                dX = np.full(X.shape, math.nan)
            new = scale * balance.residual(X + dX).reshape(-1) if np.isfinite(dX).all() else np.full(n, math.inf)
            if float(new @ new) < norm:
                break
            mu = max(4 * mu, 1e-12)
        else:
            return False, X
        X, mu = X + dX, mu / 5 if float(new @ new) < 0.5 * norm else mu
        if mu < 1e-9 or balance.size(dX) < 1e-3 * balance.motion(X):
            converged, found = newton(balance, X, 10)
            if converged:
                return True, found
    return False, X


def left_out(balance: Balance, X: np.ndarray) -> tuple[float, float, np.ndarray, float]:
    """Error of what the series leaves out: (missing motion, relative; force left over at unseen times, relative; the
    series with the missing harmonics added as far as they are known; the part of the first that is aliasing).

    The residual is taken at twice as many times, none of them used before. Its harmonics up to H (aliasing) are
    answered by the last Jacobian, those up to 2 H + 2 by the mean K, C, M; the sum of the answers, and the end forces
    that they make, are what is missing, relative to half the largest range of a dof and of a force. The mean tangent
    finds some half of what is missing (measured: 0.36 to 0.81), so that the number is about right for whole ranges.
    """
    pack, H, omega = balance.pack, balance.harmonics, balance.omega
    dense = series(2 * H + 2, 2 * max(balance.samples, 4 * H + 8), shift=0.37)
    value, rate, bend = (x[:, : balance.nh] for x in (dense.value, dense.rate, dense.bend))
    q, v, a = balance.states(X, Series(dense.phase, value, rate, bend, dense.project))
    r = np.zeros((len(dense.phase), balance.ndof))
    sample_residual(dense.phase, omega, q, v, a, pack, r)
    balance.work.evaluations += len(dense.phase)
    fixed, free = pack.fixed, ~balance.held
    R = (dense.project @ r).T
    swing = max(float(_swing(q).max()), STILL * float(np.abs(q).max()), 1e-300)
    aliased = R[:, : balance.nh].copy()
    aliased[fixed] = 0.0
    missing = np.abs(balance.solve(aliased)).max(axis=1)
    alias = float(missing.max()) / swing
    first, more = H + 1, padded(X, 2 * H + 2)
    answer = R[:, 2 * first - 1 :: 2].T - 1j * R[:, 2 * first :: 2].T
    ends = np.zeros((len(answer), len(fixed)), dtype=complex)
    scratch = np.zeros((balance.ndof, 2 * pack.bw + 1), dtype=complex), np.zeros(balance.ndof, dtype=complex)
    if not answer_harmonics(*balance.mean(X), omega, first, pack.bw, fixed, answer, *scratch, ends):
        answer[:] = math.inf
    missing += np.abs(answer).sum(axis=0)
    more[:, 2 * first - 1 :: 2], more[:, 2 * first :: 2] = -answer.real.T, answer.imag.T
    motion = float(missing.max()) / swing
    ends_r = r[:, fixed] if len(fixed) else np.zeros((1, 1))
    scale = max(float(np.abs(ends_r - ends_r.mean(axis=0)).max()), STILL * float(np.abs(ends_r).max()))
    if scale > 0:
        motion = max(motion, float(np.abs(ends).sum(axis=0).max()) / scale)
    few = slice(0, len(r), 4)
    inertia = np.zeros_like(r[few])
    sample_residual(dense.phase[few].copy(), omega, q[few].copy(), v[few].copy(), np.zeros_like(inertia), pack, inertia)
    scale = max(scale, float(np.abs(inertia - inertia.mean(axis=0)).max()), 1e-300)
    return motion, float(np.abs(r[:, free]).max(initial=0.0)) / scale, more, alias


def _swing(x: np.ndarray) -> np.ndarray:
    return np.ptp(x, axis=0) / 2


def periodic(
    pack: Any,
    omega: float,
    rest: np.ndarray,
    tolerance: float,
    harmonics: int | None = None,
    start: Orbit | None = None,
) -> Orbit:
    """The periodic response of a line whose motion has the angular frequency omega.

    Parameters
    ----------
    rest : (ndof,) float
        State about which the motion is sought: the static one.
    tolerance : float
        Largest estimated error of motion and end force, relative to their swing.
    harmonics : int, optional, at least the highest in the motion
        As many and no more; by default they grow along `LADDER` until the estimate is below `tolerance`.
    start : Orbit, optional
        A neighbour's response to start from instead of rest; its Jacobian is used again while steps shrink fast.

    Where several responses exist, as above a fold, this is the one that Newton reaches from there;
    `continuation.trace` follows them all. The status is OK, FEW_HARMONICS (with the last response) or NO_CONVERGENCE.
    """
    work, kept = Work(), None if start is None else start.balance
    reach = reach_of(pack, rest) if kept is None or len(kept.reach) != len(rest) else kept.reach
    top = _top_harmonic(pack, omega)
    ladder = [h for h in LADDER if h >= top and (harmonics is None or h < harmonics)]
    if harmonics is not None:
        ladder = [*ladder[::2], harmonics]
    if not ladder:
        ladder = [top]
    if start is not None:
        ladder = [h for h in ladder if h >= start.harmonics] or ladder[-1:]
        X = padded(start.X, ladder[0])
    else:
        X = np.zeros((len(rest), 2 * ladder[0] + 1))
        X[:, 0] = math.sqrt(2) * rest
    found, missed = Orbit(Status.NO_CONVERGENCE, "", omega, X, work=work), 0
    for tries, H in enumerate(ladder):
        lost, converged = found.status != Status.OK, False
        if kept is not None and kept.serves(pack, H):
            balance, kept = kept, None
            balance.work = work
            balance.move(pack, omega)
            if balance.samples != max(8 * H, 32):
                balance.resample(max(8 * H, 32))
            converged, X = carried(balance, padded(X, H))
        else:
            balance = Balance(pack, omega, H, max(8 * H, 32), reach, work)
        if not converged and (tries or start is not None):
            converged, X = newton(balance, padded(X, H))
        if not converged and lost:
            converged, X = from_rest(balance, padded(math.sqrt(2) * rest[:, None], H))
        if not converged and lost and tries + 1 < min(2, len(ladder)):
            continue
        if not converged and lost:
            note = f"no periodic response found from rest with up to {H} harmonics"
            return Orbit(Status.NO_CONVERGENCE, note, omega, X, work=work)
        if not converged and missed < MOST_MISSED and tries + 1 < len(ladder):  # a longer series may be easier
            missed, X = missed + 1, found.X
            continue
        if not converged:
            note = f"no convergence with {H} harmonics; {found.harmonics} leave an estimated error of {found.tail:.1e}"
            return Orbit(Status.FEW_HARMONICS, note, omega, found.X, found.tail, found.unseen, work, found.balance)
        tail, unseen, more, aliased = left_out(balance, X)
        while aliased > 0.1 * tolerance and balance.samples < MOST_SAMPLES:
            balance.resample(2 * balance.samples)
            converged, finer = newton(balance, X)
            if not converged:
                break
            X = finer
            tail, unseen, more, aliased = left_out(balance, X)
        found = Orbit(Status.OK, "", omega, X, tail, unseen, work, balance)
        if tail <= tolerance and harmonics is None:
            break
        X = more
    if not found.tail <= tolerance:
        note = f"{found.harmonics} harmonics leave an estimated error of {found.tail:.1e} above {tolerance:g}"
        return Orbit(Status.FEW_HARMONICS, note, omega, found.X, found.tail, found.unseen, work, found.balance)
    return found


def _top_harmonic(pack: Any, omega: float) -> int:
    """Highest harmonic in the prescribed motion."""
    swing = np.abs(targets(pack, omega, series(LADDER[-1], 4 * LADDER[-1])))
    if not swing.size:
        return 1
    big = np.flatnonzero(swing[:, 1:].max(axis=0) > 1e-9 * swing[:, 1:].max())
    return int(big.max(initial=0) // 2 + 1)
