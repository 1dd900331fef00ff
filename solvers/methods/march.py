"""What all time methods share: the state at a step's ends, the energy ledger, the output grid, breaks.

The ledger adds up work at the prescribed dofs and the lost powers over each step, and books the jump of energy at a
break of the motion (and at the start, where an end may begin to move at once) as work:
E(t) - E(0) = work - lost + rotation, up to the residual.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compile import kernel
from ..dispatch import GRAVITY, KINETIC, N_ENERGIES, STRAIN, WATER, energies, losses

# columns of the recorded ledger
L_KINETIC, L_STRAIN, L_GRAVITY, L_WORK, L_LOST = 0, 1, 2, 3, 4  # then cable, device, seabed, rotation
N_LEDGER = 9
LEDGER = ("kinetic", "strain", "gravity", "work", "lost_water", "lost_cable", "lost_device", "lost_seabed", "rotation")
# counters
C_STEPS, C_REJECTED, C_EVALUATIONS, C_FACTORS, N_COUNTS = 0, 1, 2, 3, 4


class Ends(NamedTuple):
    """State at the start (0) and end (1) of a step; row 2 is scratch."""

    q: np.ndarray  # (3, ndof)
    v: np.ndarray  # (3, ndof)
    a: np.ndarray  # (2, ndof)
    r: np.ndarray  # (2, ndof) external force at prescribed dofs
    e: np.ndarray  # (3, N_ENERGIES)
    ledger: np.ndarray  # (2, N_LEDGER)
    peak: np.ndarray  # (3,) kinetic, |kinetic + potential above the start|, ledger gap


class Output(NamedTuple):
    """The output grid; `at[0]` is the next sample to write."""

    t: np.ndarray  # (nt,)
    q: np.ndarray  # (nt, ndof)
    v: np.ndarray  # (nt, ndof)
    f: np.ndarray  # (nt, nfixed)
    ledger: np.ndarray  # (nt, N_LEDGER)
    at: np.ndarray  # (1,) int64
    counts: np.ndarray  # (N_COUNTS,) int64


def make_ends(ndof: int) -> Ends:
    def z(n: int, rows: int = 2) -> np.ndarray:
        return np.zeros((rows, n))

    return Ends(z(ndof, 3), z(ndof, 3), z(ndof), z(ndof), z(N_ENERGIES, 3), z(N_LEDGER), np.zeros(3))


def make_output(t: np.ndarray, ndof: int, nfixed: int) -> Output:
    n = len(t)
    return Output(
        t,
        np.full((n, ndof), np.nan),
        np.full((n, ndof), np.nan),
        np.full((n, nfixed), np.nan),
        np.full((n, N_LEDGER), np.nan),
        np.zeros(1, np.int64),
        np.zeros(N_COUNTS, np.int64),
    )


@kernel
def power(r, v, fixed):
    """Work rate at the prescribed dofs [W]."""
    total = 0.0
    for k in range(len(fixed)):
        total += r[fixed[k]] * v[fixed[k]]
    return total


@kernel
def begin(t, s, pack):
    """Energies of the given start, before the prescribed dofs move; the ledger begins with them."""
    energies(t, s.q[0], s.v[0], s.a[0], pack, s.e[0])
    for m in range(N_LEDGER):
        s.ledger[0, m] = s.e[0, m] if m < L_WORK else 0.0
    s.peak[0] = s.e[0, KINETIC]
    s.peak[1] = s.e[0, KINETIC]
    s.peak[2] = 0.0
    return s.e[0, KINETIC] + s.e[0, STRAIN] + s.e[0, GRAVITY]


@kernel
def book(t, h, s, pack, start, work):
    """Extend the ledger over a step of length h.

    `start` is the energy that the run began with, `work` [J] what the moved ends put in over the step (a method knows
    it best). Losses by two Gauss points on the Hermite interpolant: not at its ends, for a power may jump there
    (a cord's damper acts only while the cord is taut).
    """
    s.ledger[1, L_WORK] = s.ledger[0, L_WORK] + work
    for m in range(L_LOST, N_LEDGER):
        s.ledger[1, m] = s.ledger[0, m]
    for k in range(2):
        x = 0.5 + (k - 0.5) / math.sqrt(3.0)
        between(x, h, s, s.q[2], s.v[2])
        losses(t + x * h, s.q[2], s.v[2], s.a[1], pack, s.e[2])
        for m in range(N_ENERGIES - WATER):
            s.ledger[1, L_LOST + m] += 0.5 * h * s.e[2, WATER + m]
    close(t, h, s, pack, start)


@kernel
def close(t, h, s, pack, start):
    """The ledger's energies at the end of a step, and its gap."""
    energies(t + h, s.q[1], s.v[1], s.a[1], pack, s.e[1])
    for m in range(3):
        s.ledger[1, m] = s.e[1, m]
    audit(s, start)


@kernel
def between(x, h, s, q, v):
    """Cubic Hermite interpolant of q and v at share x of the step."""
    h00, h10 = (1.0 + 2.0 * x) * (1.0 - x) ** 2, x * (1.0 - x) ** 2
    h01, h11 = x * x * (3.0 - 2.0 * x), x * x * (x - 1.0)
    for i in range(len(q)):
        q[i] = h00 * s.q[0, i] + h10 * h * s.v[0, i] + h01 * s.q[1, i] + h11 * h * s.v[1, i]
        v[i] = h00 * s.v[0, i] + h10 * h * s.a[0, i] + h01 * s.v[1, i] + h11 * h * s.a[1, i]


@kernel
def audit(s, start):
    """Largest gap of the ledger and the peak energies that it is measured against."""
    gap = s.ledger[1, 0] + s.ledger[1, 1] + s.ledger[1, 2] - start - s.ledger[1, L_WORK]
    for m in range(N_LEDGER - L_LOST - 1):
        gap += s.ledger[1, L_LOST + m]
    gap -= s.ledger[1, N_LEDGER - 1]
    mechanical = abs(s.ledger[1, 0] + s.ledger[1, 1] + s.ledger[1, 2] - start)
    if not (s.ledger[1, 0] <= s.peak[0]):
        s.peak[0] = s.ledger[1, 0]
    if not (mechanical <= s.peak[1]):
        s.peak[1] = mechanical
    if not (abs(gap) <= s.peak[2]):
        s.peak[2] = abs(gap)


@kernel
def copy(x, y):
    """x <- y without a temporary array."""
    for i in range(len(x)):
        x[i] = y[i]


@kernel
def advance(s):
    """The end of this step is the start of the next."""
    copy(s.q[0], s.q[1])
    copy(s.v[0], s.v[1])
    copy(s.a[0], s.a[1])
    copy(s.r[0], s.r[1])
    copy(s.e[0], s.e[1])
    copy(s.ledger[0], s.ledger[1])


@kernel
def jump(t, s, pack):
    """Book the change of energy at a break as work; s holds the right limits in row 0 when called."""
    before = s.e[0, KINETIC] + s.e[0, STRAIN] + s.e[0, GRAVITY]
    energies(t, s.q[0], s.v[0], s.a[0], pack, s.e[0])
    s.ledger[0, L_WORK] += s.e[0, KINETIC] + s.e[0, STRAIN] + s.e[0, GRAVITY] - before
    for m in range(3):
        s.ledger[0, m] = s.e[0, m]
    if not (s.e[0, KINETIC] <= s.peak[0]):
        s.peak[0] = s.e[0, KINETIC]


@kernel
def record(t, h, s, out, fixed, last):
    """Write the samples in [t, t + h): cubic Hermite in q and v, linear in force and ledger; `last` includes t + h."""
    while out.at[0] < len(out.t):
        k = out.at[0]
        x = out.t[k] - t
        if not (x < h or (last and x <= h * (1.0 + 1e-12))):
            break
        x = min(max(x / h, 0.0), 1.0)
        between(x, h, s, out.q[k], out.v[k])
        for i in range(len(fixed)):
            out.f[k, i] = (1.0 - x) * s.r[0, fixed[i]] + x * s.r[1, fixed[i]]
        for i in range(s.ledger.shape[1]):
            out.ledger[k, i] = (1.0 - x) * s.ledger[0, i] + x * s.ledger[1, i]
        out.at[0] += 1


@kernel
def norm2(x, weight):
    """Kinetic energy of a velocity error: sum of 1/2 weight x^2 [J]."""
    total = 0.0
    for i in range(len(x)):
        total += weight[i] * x[i] * x[i]
    return 0.5 * total
