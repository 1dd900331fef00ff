"""One oscillator with its devices: the yardstick whose answers are known.

Symbols: x displacement of the main mass m; y offset of a device's mass M from it. Unknowns (x, y, ...):

    m x'' + sum M (x'' + y'') + c x' + d |x'| x' + k1 x + k3 x^3 = sum F cos(Omega t + phase)
    M (x'' + y'') + F_d(y, y') + kappa y^3 = 0

F_d is a law of ``devices``. k1 < 0 < k3 makes the main mass bistable; an array of length zero: no device, or
no force. As on a cable, a device's force reaches the main mass through the inertia of the device's mass.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compile import kernel
from ..devices import LINEAR, law_energy, law_force, law_gap, law_loss
from ..dispatch import CABLE, DEVICE, KINETIC, STRAIN, WATER, provides


class Oscillator(NamedTuple):
    """Parameter pack; SI. nd devices, h terms of the force."""

    bw: int  # half bandwidth of the tangent
    load_factor: float  # share of the force
    fixed: np.ndarray  # (0,) no dof is prescribed
    weight: np.ndarray  # (1 + nd,) inertia that weighs errors [kg]
    main: np.ndarray  # (5,) m [kg], c [N s/m], d [N s2/m2], k1 [N/m], k3 [N/m3]
    amplitude: np.ndarray  # (h,) F [N]
    omega: np.ndarray  # (h,) Omega [rad/s]
    phase: np.ndarray  # (h,) [rad]
    dev_mass: np.ndarray  # (nd,) M [kg]
    cubic: np.ndarray  # (nd,) kappa [N/m3]
    law: np.ndarray  # (nd, 5) kind, k, c, l0, a


def oscillator(
    m: float = 1.0,
    c: float = 0.0,
    d: float = 0.0,
    k1: float = 1.0,
    k3: float = 0.0,
    force: tuple[tuple[float, float, float], ...] = (),
    devices: tuple[tuple[float, float, tuple[float, float, float, float, float]], ...] = (),
) -> Oscillator:
    """The pack.

    Parameters
    ----------
    m, c, d, k1, k3 : float
        Mass, linear damping, quadratic drag, stiffness and cubic stiffness of the main mass.
    force : ((F [N], Omega [rad/s], phase [rad]), ...)
    devices : ((M [kg], kappa [N/m3], law), ...)
        Mass, cubic stiffness and force law of each.
    """
    terms = np.array(force, dtype=float).reshape(-1, 3)
    mass = np.array([x[0] for x in devices], dtype=float)
    return Oscillator(
        bw=len(mass),
        load_factor=1.0,
        fixed=np.zeros(0, dtype=np.int64),
        weight=np.concatenate([[float(m)], mass]),
        main=np.array([m, c, d, k1, k3], dtype=float),
        amplitude=terms[:, 0].copy(),
        omega=terms[:, 1].copy(),
        phase=terms[:, 2].copy(),
        dev_mass=mass,
        cubic=np.array([x[1] for x in devices], dtype=float),
        law=np.array([x[2] for x in devices], dtype=float).reshape(-1, 5),
    )


def cubic_device(mass: float, kappa: float, c: float) -> tuple[float, float, tuple[float, float, float, float, float]]:
    """A device of `oscillator` with force kappa y^3 + c y'."""
    return mass, kappa, (LINEAR, 0.0, c, 1.0, 1.0)


@kernel
def pushed(t, pack):
    """Force on the main mass [N]."""
    total = 0.0
    for h in range(len(pack.amplitude)):
        total += pack.amplitude[h] * math.cos(pack.omega[h] * t + pack.phase[h])
    return pack.load_factor * total


@kernel
def constants(d, pack):
    """The law of device d as a tuple."""
    law = pack.law
    return law[d, 0], law[d, 1], law[d, 2], law[d, 3], law[d, 4]


@kernel
def main_of(pack):
    """m, c, d, k1, k3 as a tuple."""
    return pack.main[0], pack.main[1], pack.main[2], pack.main[3], pack.main[4]


@kernel
def forces(t, q, v, pack, r):
    """r = minus all forces but inertia, a device's in its own row only."""
    _, c, d, k1, k3 = main_of(pack)
    x, xdot = q[0], v[0]
    r[0] = c * xdot + d * abs(xdot) * xdot + k1 * x + k3 * x**3 - pushed(t, pack)
    for i in range(len(pack.dev_mass)):
        y = q[1 + i]
        r[1 + i] = law_force(y, v[1 + i], constants(i, pack))[0] + pack.cubic[i] * y**3


def drive(t, pack, q, v, a):
    pass


def residual(t, q, v, a, pack, r):
    forces(t, q, v, pack, r)
    r[0] += pack.main[0] * a[0]
    for i in range(len(pack.dev_mass)):
        inertia = pack.dev_mass[i] * (a[0] + a[1 + i])
        r[0] += inertia
        r[1 + i] += inertia


def tangent(t, q, v, a, cq, cv, ca, pack, J):
    m, c, d, k1, k3 = main_of(pack)
    bw = pack.bw
    J[:] = 0.0
    J[0, bw] = ca * m + cv * (c + 2.0 * d * abs(v[0])) + cq * (k1 + 3.0 * k3 * q[0] ** 2)
    for i in range(len(pack.dev_mass)):
        k, M = 1 + i, ca * pack.dev_mass[i]
        _, stiffness, damping = law_force(q[k], v[k], constants(i, pack))
        J[0, bw] += M
        J[0, bw + k] = M
        J[k, bw - k] = M
        J[k, bw] = M + cv * damping + cq * (stiffness + 3.0 * pack.cubic[i] * q[k] ** 2)


def accelerate(t, q, v, a, pack, r):
    """Rows subtracted: m x'' = sum F_d - f, and y'' = -F_d/M - x''."""
    forces(t, q, v, pack, r)
    total = -r[0]
    for i in range(len(pack.dev_mass)):
        total += r[1 + i]
    a[0] = total / pack.main[0]
    for i in range(len(pack.dev_mass)):
        a[1 + i] = -r[1 + i] / pack.dev_mass[i] - a[0]


def energies(t, q, v, a, pack, e):
    """The force counts as the water's: its power is a negative loss to water."""
    m, c, d, k1, k3 = main_of(pack)
    e[:] = 0.0
    x, xdot = q[0], v[0]
    e[KINETIC] = 0.5 * m * xdot**2
    e[STRAIN] = 0.5 * k1 * x**2 + 0.25 * k3 * x**4
    e[CABLE] = c * xdot**2
    e[WATER] = (d * abs(xdot) * xdot - pushed(t, pack)) * xdot
    for i in range(len(pack.dev_mass)):
        y, ydot = q[1 + i], v[1 + i]
        e[KINETIC] += 0.5 * pack.dev_mass[i] * (xdot + ydot) ** 2
        e[STRAIN] += law_energy(y, constants(i, pack)) + 0.25 * pack.cubic[i] * y**4
        e[DEVICE] += law_loss(y, ydot, constants(i, pack))


def gaps(t, q, v, pack, g):
    for i in range(len(g)):
        g[i] = law_gap(q[1 + i], v[1 + i], constants(i, pack))


provides(
    Oscillator,
    drive=drive,
    residual=residual,
    tangent=tangent,
    accelerate=accelerate,
    energies=energies,
    gaps=gaps,
)
