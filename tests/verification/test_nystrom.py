"""The symplectic method: its conditions, what it keeps, where it is stable, and how it meets an impact."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from march_kit import march_oscillator
from scipy.interpolate import BPoly
from test_ringing import CABLE, SINK

from solvers import Ask, Status, solve
from solvers.brink import amplification, stable_step
from solvers.catalogue import SWING, SWING_REACH
from solvers.lines.oscillator import oscillator
from solvers.methods import nystrom
from solvers.methods.march import make_ends

T = nystrom.TABLE


def test_order_conditions():
    """To order 4 for y'' = f(y, y'), the velocities of the stages having weights of their own: to rounding."""
    b, c, d = T.b, T.c, T.d
    a = np.tril(b * (c[:, None] - c[None, :]), -1)
    e = a.sum(axis=1)
    assert c[-1] == pytest.approx(1.0, abs=1e-15)
    assert np.all(np.triu(d) == 0)
    np.testing.assert_allclose(d.sum(axis=1), c, atol=1e-15)
    conditions = [
        (np.ones(7), 1), (c, 2), (c**2, 3), (e, 6), (c**3, 4), (c * e, 8), (a @ c, 24),  # of y'' = f(y)
        (d @ c, 6), (c * (d @ c), 8), (d @ c**2, 12), (d @ e, 24), (d @ (d @ c), 24),
    ]  # fmt: skip
    for phi, gamma in conditions:
        assert b @ phi == pytest.approx(1 / gamma, abs=1e-15)
    assert abs(b @ c**4 - 1 / 5) > 1e-5  # and not of order 5


def test_what_damping_takes():
    """Light damping c takes energy at the rate c v^2, and sum b v^2 over phases is the mean square of the velocity: to
    3e-4 at the length of step that lines are given."""
    c, zeta = T.c, 1e-6
    for x, limit in ((0.5, 1e-5), (1.0, 2e-4), (SWING, 3e-4)):
        z = x * (-zeta + 1j * math.sqrt(1 - zeta**2))
        assert -math.log(float(amplification("srkn4", np.array(z)))) / (x * zeta) == pytest.approx(1.0, abs=limit)
        square = 0.0
        for q, v in ((1.0, 0.0), (0.0, x)):
            acting: list[float] = []
            for i in range(7):
                place = q + c[i] * v + sum(T.b[j] * (c[i] - c[j]) * acting[j] for j in range(i))
                square += T.b[i] * (v + sum(T.d[i, j] * acting[j] for j in range(i))) ** 2
                acting.append(-x * x * place)
        assert square / x**2 == pytest.approx(1.0, abs=limit)


def test_symplectic():
    """Kicks and drifts read the same from both ends; the map of an undamped oscillator has determinant 1 and, below the
    limit, size 1."""
    assert T.a.tolist() == T.a[::-1].tolist()
    assert T.b.tolist() == T.b[::-1].tolist()
    x = np.linspace(0.1, 3.1, 31)
    np.testing.assert_allclose(amplification("srkn4", 1j * x), 1.0, atol=1e-13)


def test_energy_of_an_oscillation_stays():
    """A hundred thousand steps at the length that lines are given: the energy swings by 2e-4 and goes nowhere."""
    grid = np.arange(100_001) * SWING
    run = march_oscillator(oscillator(), [1.0], [0.0], grid, "srkn4", step=SWING)
    energy = run.ledger[:, 0] + run.ledger[:, 1]
    assert np.ptp(energy) / energy[0] < 2e-4
    assert abs(energy[-1000:].mean() / energy[:1000].mean() - 1) < 1e-6
    assert run.gap < 2e-4


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.5])
def test_step_of_an_oscillator_is_the_amplification(damping):
    """The march and the theory are two programs: growth over a step as computed from both, also in the window that a
    symplectic method has just above pi."""
    for step in (1.0, 2.0, 3.0, 3.165):
        motion = march_oscillator(oscillator(c=2 * damping), [1.0], [0.0], np.arange(3) * step, "srkn4", step=step)
        state = np.stack([motion.q[:, 0], motion.v[:, 0]], axis=1)
        other = march_oscillator(oscillator(c=2 * damping), [0.0], [1.0], np.arange(2) * step, "srkn4", step=step)
        matrix = np.array([state[1], [other.q[1, 0], other.v[1, 0]]]).T
        np.testing.assert_allclose(matrix @ state[1], state[2], atol=1e-12)
        z = step * (-damping + 1j * math.sqrt(1 - damping**2))
        found = float(np.abs(np.linalg.eigvals(matrix)).max())
        assert found == pytest.approx(float(amplification("srkn4", np.array(z))), abs=1e-7)  # a double eigenvalue


def test_both_sides_of_the_limit():
    """What nothing damps: bounded at 3.16 and 3.18, growing in the window between, which is where the limit is said to
    be; lost for good above 5.03."""

    def largest(step: float) -> float:
        run = march_oscillator(oscillator(), [1.0], [0.0], np.arange(5001) * step, "srkn4", step=step)
        return float(np.abs(run.q).max()) if run.status == Status.OK else math.inf

    limit = stable_step("srkn4", np.array([1j, -1j]))
    assert limit == pytest.approx(3.1635, abs=2e-3)
    assert largest(0.95 * limit) < 2
    assert largest(3.1652) > 1e3
    assert largest(3.18) < 20  # close to a window an oscillation swings far, and comes back
    assert largest(1.05 * 5.04) == math.inf


@pytest.mark.parametrize("damping", [*np.linspace(0.0, 1.2, 25), 1.5, 2.0, 4.0, 10.0])
def test_own_step_is_stable(damping):
    """At every share of critical damping, overdamped motion with both of its rates included."""
    root = np.sqrt(complex(damping**2 - 1))
    step = min(SWING, SWING_REACH / abs(damping + root))
    q, v = np.eye(2)
    ends = [march_oscillator(oscillator(c=2 * damping), [q[k]], [v[k]], np.array([0.0, step]), "srkn4", step=step)
            for k in range(2)]  # fmt: skip
    matrix = np.array([[run.q[1, 0] for run in ends], [run.v[1, 0] for run in ends]])
    assert np.abs(np.linalg.eigvals(matrix)).max() < 1 + 1e-9


@pytest.mark.parametrize(("damping", "limit"), [(0.2, 4.10), (0.5, 4.383), (1.0, 2.048)])
def test_limit_with_damping(damping, limit):
    """|lambda| = 1 at shares of critical damping; lines are given SWING, below all of them. As printed."""
    z = -damping + 1j * math.sqrt(max(1 - damping**2, 0.0))
    assert stable_step("srkn4", np.array([z])) == pytest.approx(limit, abs=5e-3)
    assert limit > SWING


def test_interpolant():
    """Degree 5 through positions, velocities and accelerations, and its derivative, as scipy has them: to rounding."""
    s, h, rng = make_ends(3), 0.7, np.random.default_rng(0)
    for k in range(2):
        s.q[k], s.v[k], s.a[k] = rng.normal(size=(3, 3))
    known = BPoly.from_derivatives([0, h], [[s.q[k], s.v[k], s.a[k]] for k in range(2)])
    q, v = np.zeros(3), np.zeros(3)
    for x in (0.0, 0.2, 0.5, 0.9, 1.0):
        nystrom.within(x, h, s, q, v)
        np.testing.assert_allclose(q, known(x * h), atol=1e-14)
        np.testing.assert_allclose(v, known.derivative()(x * h), atol=1e-13)


ASK = Ask(duration=1.0, model="transverse", segments=24)
PLAIN = replace(CABLE, cable=tuple(replace(x, BI=0.0) for x in CABLE.cable))  # nothing damps what rings


def test_impacts_at_long_steps():
    """A line whose sink strikes and rings, without BI: a third of the steps of `tsit5`, of seven evaluations for six,
    and a closed ledger. `auto` takes it there; with BI, which would set its step, `dopri5`."""
    short = solve(PLAIN, replace(ASK, method="tsit5"))
    own = solve(PLAIN, replace(ASK, method="srkn4"))
    assert own.trusted, own.message
    assert own.cost.steps < 0.5 * short.cost.steps
    assert own.energy_residual < 5e-4  # half of what is trusted
    assert (solve(PLAIN, ASK).method, solve(CABLE, ASK).method) == ("srkn4", "dopri5")


def test_before_chaos_the_waveform_is_that_of_a_tight_run():
    """0.3 s, some impacts: within 1e-3 of `dopri5` at a tolerance of 1e-8."""
    early = replace(ASK, duration=0.3, interval=2e-3)
    truth = solve(CABLE, replace(early, method="dopri5", tolerance=1e-8))
    run = solve(CABLE, replace(early, method="srkn4"))
    assert run.trusted
    x, y = (r.signals["position"] - r.signals["static_position"] for r in (run, truth))
    assert np.sqrt(((x - y) ** 2).mean() / (y**2).mean()) < 1e-3


def test_a_step_that_is_asked_for_is_checked():
    """Up to the mesh's own it is known to be right; a longer one is compared with half of it. Far too long: not OK."""
    ask = replace(ASK, method="srkn4", duration=0.3, interval=2e-3)
    step = solve(PLAIN, ask).step
    assert step > 0
    assert solve(PLAIN, replace(ask, step=step)).cost.checking == 0.0
    longer = solve(PLAIN, replace(ask, step=1.3 * step))
    assert longer.cost.checking > 0.0
    wild = solve(PLAIN, replace(ask, step=4 * step))
    assert wild.status in (Status.DIVERGED, Status.ENERGY_OPEN)


@pytest.mark.parametrize("share", [0.1, 1.5, 6.0])
def test_a_damper_of_any_size_is_resolved(share):
    """Cords whose damping is a share of critical, which alone would ask for shorter steps than their stiffness: within
    1e-2 of a tight run, or not OK."""
    BA = share * math.sqrt(2 * SINK.EA * SINK.length * SINK.mass) / math.sin(math.radians(SINK.phi0))
    scene = replace(PLAIN, devices=(replace(SINK, BA=BA),))
    early = replace(ASK, duration=0.3, interval=2e-3, accuracy=0.01)
    truth = solve(scene, replace(early, method="dopri5", tolerance=1e-8))
    run = solve(scene, replace(early, method="srkn4"))
    assert run.trusted, run.message
    x, y = (r.signals["position"] - r.signals["static_position"] for r in (run, truth))
    assert np.sqrt(((x - y) ** 2).mean() / (y**2).mean()) < 1e-2


def test_pilots_without_a_mesh():
    """Named without `segments` on a scene without impacts: pilots compare it with half of each mesh's step."""
    smooth = replace(PLAIN, devices=())
    run = solve(smooth, replace(ASK, method="srkn4", segments=None))
    assert run.trusted, run.message
    assert run.method == "srkn4"
    assert 0 < run.estimated_error < 0.05


def test_auto_falls_back_where_it_fails():
    """A light sliding mass with large drag, of which its step knows nothing: `tsit5` runs, and the reason tells."""
    light = replace(PLAIN, devices=(replace(SINK, mass=0.01, drag=100.0),))
    run = solve(light, replace(ASK, duration=0.2))
    assert run.trusted, run.message
    assert run.method == "tsit5"
    assert "srkn4 gave" in run.reason
