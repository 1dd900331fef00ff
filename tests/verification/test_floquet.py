"""Floquet multipliers against closed forms, Liouville's theorem, Hill's method, Mathieu's chart and the time domain."""

from __future__ import annotations

import math

import numpy as np
import pytest
from march_kit import march_oscillator
from periodic_kit import hose, line, orders, periodic
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import mathieu_a, mathieu_b

from solvers import TMD, End, Harmonic, Motion, Scene, Section, Status
from solvers.devices import LINEAR
from solvers.lines.oscillator import Oscillator, cubic_device, oscillator
from solvers.methods import floquet, harmonic
from solvers.methods.floquet import stability
from solvers.methods.harmonic import Balance, Orbit

STEPS = (48, 96, 192, 384)


def alike(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest distance of a multiplier from the nearest exact one, and the other way round."""
    apart = np.abs(found[:, None] - exact[None, :])
    return float(max(apart.min(axis=0).max(), apart.min(axis=1).max()))


# ------------------------------------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("dofs", [1, 2])
def test_linear_multipliers_are_exact(dofs: int) -> None:
    """exp(lambda T) of the eigenvalues of M x'' + C x' + K x = 0, with the order 3 of the method (within 0.1): 8e-7 at
    384 steps of a period."""
    m, c, k, M, kd, cd, omega = 1.0, 0.3, 2.0, 0.4, 1.1, 0.15, 1.1
    devices = ((M, 0.0, (LINEAR, kd, cd, 1.0, 1.0)),) if dofs == 2 else ()
    pack = oscillator(m=m, c=c, k1=k, force=((1.0, omega, 0.0),), devices=devices)
    mass = np.array([[m + M, M], [M, M]]) if dofs == 2 else np.array([[m]])
    damping, stiffness = np.diag([c, cd])[:dofs, :dofs], np.diag([k, kd])[:dofs, :dofs]
    state = np.block(
        [[np.zeros((dofs, dofs)), np.eye(dofs)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]]
    )
    exact = np.exp(np.linalg.eigvals(state) * 2 * math.pi / omega)
    orbit = harmonic.periodic(pack, omega, np.zeros(dofs), 1e-9, 1)
    errors = [alike(stability(pack, orbit, n).multipliers, exact) for n in STEPS]
    assert np.all(np.abs(orders(errors) - 3) < 0.1), orders(errors)
    assert errors[-1] < 5e-6


def duffing(omega: float = 1.2) -> tuple[Oscillator, Orbit]:
    pack = oscillator(c=0.05, k3=0.1, force=((0.18, omega, 0.0),))
    return pack, harmonic.periodic(pack, omega, np.zeros(1), 1e-9, 15)


def test_liouville() -> None:
    """The product of the multipliers is exp(-integral of the trace) = exp(-c T), whatever the orbit: order 3 (within
    0.1), 6e-7 at 384 steps."""
    pack, orbit = duffing()
    exact = math.exp(-0.05 * 2 * math.pi / 1.2)
    errors = [abs(np.prod(stability(pack, orbit, n).multipliers) - exact) for n in STEPS]
    assert np.all(np.abs(orders(errors) - 3) < 0.1), orders(errors)
    assert errors[-1] < 2e-6


def test_liouville_with_drag() -> None:
    """With quadratic drag the trace is -(c + 2 d |v|)/m and varies over the period; where v passes zero it has a kink,
    so that the error falls unevenly: 2e-4 at 192 steps, below 1e-6 at 384. Asserted is 2e-4."""
    pack = oscillator(c=0.05, d=0.4, k3=0.1, force=((0.5, 1.0, 0.0),))
    orbit = harmonic.periodic(pack, 1.0, np.zeros(1), 1e-6, 30)
    v = orbit.at(2 * math.pi * np.arange(4096) / 4096)[1][:, 0]
    exact = math.exp(-(0.05 + 0.8 * np.abs(v).mean()) * 2 * math.pi)
    assert np.prod(stability(pack, orbit, 384).multipliers) == pytest.approx(exact, rel=2e-4)


def test_hill() -> None:
    """Hill's method from the harmonic balance's own Jacobian J: disturbances exp(s t) sum z_h e^(i h w t) solve
    (J + s (c + 2 D) + s^2) z = 0, D the derivative of the series; of its 2 (2H + 1) exponents the two of least
    imaginary part. The multipliers exp(s T) to 2e-7 at 1536 steps (5e-9 seen, by order 3 from 3.2e-7 at 384)."""
    pack, orbit = duffing()
    H, omega = orbit.harmonics, orbit.omega
    balance = Balance(pack, omega, H, 4 * H + 2, harmonic.reach_of(pack, np.zeros(1)))
    balance.linearise(orbit.X)
    J, n = balance.blocks.sparse().toarray(), 2 * H + 1
    D = np.zeros((n, n))
    for h in range(1, H + 1):
        D[2 * h - 1, 2 * h], D[2 * h, 2 * h - 1] = omega * h, -omega * h
    first = 0.05 * np.eye(n) + 2 * D
    exponents = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-J, -first]]))
    two = exponents[np.argsort(np.abs(exponents.imag))[:2]]
    exact = np.exp(two * 2 * math.pi / omega)
    errors = [alike(stability(pack, orbit, n).multipliers, exact) for n in (384, 768, 1536)]
    assert np.all(np.abs(orders(errors) - 3) < 0.1), errors
    assert errors[-1] < 2e-7
    known = stability(pack, orbit)
    assert known.error < floquet.CHANGE
    assert alike(known.multipliers, exact) < 1e-3


# ------------------------------------------------------------------------------------------------- Mathieu

SWING = 0.3  # of the tension


def shaken_string(frequency: float) -> Scene:
    """Two segments of a weightless string of 500 N whose tension swings by 0.3 of it at an angular frequency."""
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=1e7, BA=1e3, wet_weight=0.0, compression=True)
    stretch = SWING * 500.0 * 10.0 / 1e7
    pull = Harmonic(amplitude=(0, 0, stretch), frequency=frequency / (2 * math.pi), phase=math.pi / 2)
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, 0)), g=0.0,
        end_b=End(kind="pinned", position=(0, 0, 10 * (1 + 500 / 1e7)), motion=Motion(harmonics=(pull,))),
    )  # fmt: skip


FIRST = 2 / 5.0 * math.sqrt(500 / 2.0) * math.sin(math.pi / 4)  # (2/h) sqrt(T/m) sin(pi/2N) [rad/s]


def edge(curve) -> float:
    """Frequency at an edge of the tongue at twice the first mode's: a = (2 w1/w)^2 = a1(q) or b1(q), q = 0.3 a/2."""
    a = brentq(lambda a: curve(1, SWING * a / 2) - a, 0.3, 2.0)
    return 2 * FIRST / math.sqrt(a)


@pytest.mark.parametrize("off", [-0.01, -0.001, 0.001, 0.01])
def test_mathieu_tongue_of_a_string(off: float) -> None:
    """A straight string under swinging tension obeys Mathieu's equation y'' + w1^2 (1 + 0.3 cos(w t)) y = 0 across it.
    Inside the tongue, 8.2625 to 9.6017 rad/s by its characteristic values, a multiplier is real and below -1 (period
    doubling); outside it is stable: told right within 0.1 % of either edge (seen, not a
    limit). Multipliers to 2e-3 of the scalar equation's: 6e-4 seen, next to an edge, where they go as a square root."""
    low, high = sorted((edge(mathieu_a), edge(mathieu_b)))
    assert (low, high) == pytest.approx((8.2625, 9.6017), abs=5e-5)
    for w, inside in ((low * (1 + off), off > 0), (high * (1 + off), off < 0)):
        of = line(shaken_string(w), 2)
        orbit = periodic(of, 1e-6, 3)
        assert orbit.status == Status.OK, orbit.message
        known = stability(of.pack, orbit)
        assert known.stable != inside
        exact = np.linalg.eigvals(
            np.column_stack([
                solve_ivp(lambda t, y, w=w: [y[1], -(FIRST**2) * (1 + SWING * math.cos(w * t)) * y[0]],
                          (0, 2 * math.pi / w), start, rtol=1e-10, atol=1e-12).y[:, -1]
                for start in ([1, 0], [0, 1])
            ])
        )  # fmt: skip
        assert alike(known.multipliers[:2], exact) < 2e-3
        if inside:
            assert known.kind == "period doubling"
            assert known.multipliers[0].real < -1


# ------------------------------------------------------------------------------------------------- nonlinear sinks


def sink(strength: float) -> Oscillator:
    """m = k = 1 with a cubic NES of 5 %, x'' + x + .. = 0.05 A cos t (Gendelman, Starosvetsky and Feldman 2008)."""
    e = 0.05
    return oscillator(force=((e * strength, 1.0, 0.0),), devices=(cubic_device(e, 4 / 3 * e, 0.2 * e),))


@pytest.mark.parametrize("strength", [0.1, 0.2, 0.3, 0.4, 0.6])
def test_strongly_modulated_response(strength: float) -> None:
    """A periodic response exists at every strength; from 0.3 on a complex pair has left the unit circle
    (Neimark-Sacker) and the sink works in bursts: the march never settles to it, and is as far off as the response is
    large. Below, the march from rest settles to it in 400 periods (exponentially, to the march's own tolerance)."""
    pack = sink(strength)
    orbit = harmonic.periodic(pack, 1.0, np.zeros(2), 1e-6)
    assert orbit.status == Status.OK, orbit.message
    known = stability(pack, orbit)
    assert known.stable == (strength < 0.25)
    grid = np.arange(0.0, 800 * math.pi, math.pi / 10)
    q = march_oscillator(pack, [0.0, 0.0], [0.0, 0.0], grid, "dopri5", tol=1e-8).q[-1000:]
    off = np.abs(q - orbit.at(grid[-1000:])[0]).max() / np.abs(orbit.at(grid)[0]).max()
    if known.stable:
        assert off < 1e-5
    else:
        assert known.kind == "modulation"
        assert abs(known.multipliers[0]) > 1.2
        assert known.multipliers[0] == pytest.approx(np.conj(known.multipliers[1]))
        assert off > 0.5


# ------------------------------------------------------------------------------------------------- cables


def test_arnoldi_finds_what_the_dense_map_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cable with a tuned mass damper: the largest multipliers by Arnoldi's method are those of the whole map (1e-3,
    its tolerance is 1e-4 of the largest), and the largest is below 1: a damped line."""
    of = line(hose(0.1, (TMD(s=5.0, mass=2.0, k=120.0, c=4.0),)), 14)
    orbit = periodic(of, 1e-2, 5)
    few = stability(of.pack, orbit, 96)
    assert len(few.multipliers) == floquet.SEEN
    monkeypatch.setattr(floquet, "DENSE", 10_000)
    every = stability(of.pack, orbit, 96)
    assert len(every.multipliers) == 2 * (len(of.rest) - len(of.pack.fixed))
    size = abs(every.multipliers[0])
    assert alike(few.multipliers[:4], every.multipliers[:4]) < 1e-3 * size
    assert few.largest == pytest.approx(every.largest, rel=1e-3)
    assert few.stable
    assert size < 1
