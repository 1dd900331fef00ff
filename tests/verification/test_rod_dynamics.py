"""Rods and catenaries in motion: frequencies, order in time and space, frames, energy, waves, loss of tension."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from periodic_kit import jumper
from scipy.optimize import brentq
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu

from solvers import (
    Ask,
    End,
    Harmonic,
    Motion,
    Response,
    Scene,
    Section,
    Start,
    Status,
    Turn,
    Window,
    solve,
)
from solvers.catalogue import limits_of, marched, static_state
from solvers.catenary import catenary
from solvers.dispatch import call_residual, call_tangent
from solvers.lines.rod import RodModel, build_catenary, build_rod
from solvers.lines.rod.params import matrix, spatial
from solvers.model import REMEDY

ALONG_X = (1.0, 0.0, 0.0)


def pinned(*position: float, **fields: Any) -> End:
    return End(kind="pinned", position=position, **fields)


def clamped(*position: float, **fields: Any) -> End:
    return End(kind="clamped", position=position, direction=ALONG_X, **fields)


# ------------------------------------------------------------------------------------------ frequencies


class Mode(NamedTuple):
    """A free oscillation about the static state."""

    rate: complex  # lambda of exp(lambda t) [1/s]
    shape: np.ndarray  # (n, 3) displacement of the nodes


def mode(model: RodModel, q: np.ndarray, near: float, guess: Callable[[np.ndarray], np.ndarray]) -> Mode:
    """The mode next to angular frequency `near` and to the vertical displacement `guess` of s/L.

    Inverse iteration with Newton's rate on the pencil K + lambda C + lambda^2 M that the tangent gives at rest: its
    kinematic rows, dC/dt + C/tau, are of order 1 in lambda, so that no eigenvalue problem in lambda^2 is left.
    """
    pack, n, zero = model.pack, model.ndof, np.zeros(model.ndof)
    free = np.setdiff1d(np.arange(n), pack.fixed)
    parts = []
    for c in np.eye(3):
        J = np.zeros((n, 2 * pack.bw + 1))
        call_tangent(0.0, q, zero, zero, *c, pack, J)
        i, k = np.nonzero(J)
        full = csc_matrix((J[i, k], (i, i + k - pack.bw)), shape=(n, n))
        parts.append((diags(1 / pack.unit) @ full @ diags(pack.size)).tocsc()[free][:, free])
    K, C, M = parts
    x, rate = np.zeros(n, complex), 1j * near
    x[pack.r + 2] = guess(model.s / model.s[-1])
    x = x[free]
    for _ in range(20):
        y = splu((K + rate * C + rate**2 * M).tocsc()).solve((C + 2 * rate * M) @ x)
        step = (x.conj() @ x) / (x.conj() @ y)
        rate, x = rate - step, y / np.abs(y).max()
        if abs(step) < 1e-12 * near:
            break
    left = K @ x + rate * (C @ x) + rate**2 * (M @ x)
    assert np.abs(left).max() < 1e-9 * np.abs(K @ x).max()
    whole = np.zeros(n, complex)
    whole[free] = pack.size[free] * x
    return Mode(complex(rate), whole[pack.r[:, None] + np.arange(3)])


def at_rest(model: RodModel) -> np.ndarray:
    status, q, note = static_state(model)
    assert status == Status.OK, note
    return q


IRVINE = {1.0: 1.040200, 4.0: 1.151823, 4 * math.pi**2: 2.0, 1000.0: 2.848264}


def sagging(square: float, w: float) -> Scene:
    """A level span of 1 with H = 1 and m g = w, Irvine's lambda^2 = `square`."""
    EA = square * (1 + w**2 / 8) / w**2
    length = brentq(lambda L: catenary(1.0, 0.0, L, w, EA)[0] - 1.0, 0.9, 1.02, xtol=1e-15)
    cable = Section(length=length, d=0.001, mass=1.0, EA=EA)
    return Scene(cable=(cable,), g=w, end_a=pinned(0, 0, 0), end_b=pinned(1, 0, 0))


@pytest.mark.parametrize("square", IRVINE)
def test_irvine_sagging_cable(square: float) -> None:
    """First symmetric and antisymmetric mode in the plane against Irvine and Caughey (1974), crossover included.

    To 0.5 %: sag 1/160 of the span leaves (mgl/H)^2 = 2.5e-3 in the theory. Neither grows nor decays: the constraints'
    return C/tau damps only what violates them.
    """
    model = build_catenary(sagging(square, 0.05), 100)
    q = at_rest(model)
    kinked = 0.0 if square < 10 else 0.5  # the hybrid shape beyond the crossover
    found = mode(model, q, IRVINE[square] * math.pi, lambda s: np.sin(math.pi * s) - kinked * np.sin(3 * math.pi * s))
    z = found.shape[:, 2]
    assert np.abs(z - z[::-1]).max() < 1e-6 * np.abs(z).max()
    assert found.rate.imag / math.pi == pytest.approx(IRVINE[square], rel=5e-3)
    assert abs(found.rate.real) < 1e-9
    other = mode(model, q, 2 * math.pi, lambda s: np.sin(2 * math.pi * s))
    z = other.shape[:, 2]
    assert np.abs(z + z[::-1]).max() < 1e-6 * np.abs(z).max()
    assert other.rate.imag / math.pi == pytest.approx(2.0, rel=5e-3)


def taut_beam(segments: int) -> RodModel:
    """Pinned, L = 10 m, m = 100 kg/m, T = 5e4 N, EI = 1e5 N m2 once stretched; hardly any rotary inertia across."""
    T, EA = 5e4, 1e9
    e = 1 + T / EA
    beam = Section(length=10 / e, mass=100 * e, EA=EA, EI=1e5 / e, d=0.1, wet_weight=0.0, inertia=(1e-6, 1e-6, 1.0))
    return build_rod(Scene(cable=(beam,), g=0.0, end_a=pinned(0, 0, -3), end_b=pinned(10, 0, -3)), segments)


def test_tensioned_beam_converges() -> None:
    """Three modes of the pinned beam against the continuum, 7.68693249, 18.79485658, 35.11617626 rad/s: order 2.

    Straight and taut, its first guess is its static state, in balance to rounding.
    """
    exact = np.array([7.68693249, 18.79485658, 35.11617626])
    errors = []
    for n in (20, 40, 80):
        model = taut_beam(n)
        q, r = model.starts()[0], np.zeros(model.ndof)
        call_residual(0.0, q, 0 * q, 0 * q, model.pack, r)
        assert np.abs(np.delete(r / model.pack.unit, model.pack.fixed)).max() < 1e-9
        found = [mode(model, q, w, lambda s, k=k: np.sin((k + 1) * math.pi * s)).rate for k, w in enumerate(exact)]
        assert np.abs(np.real(found)).max() < 1e-8
        errors.append(np.imag(found) - exact)
    ratio = np.array(errors[:-1]) / errors[1:]
    assert np.all((3.9 < ratio) & (ratio < 4.15)), ratio
    np.testing.assert_allclose(errors[-1] / exact, 0.0, atol=2e-3)


def test_a_taut_pinned_beam_has_a_static_state() -> None:
    """Both ends may turn, so that nothing holds the beam's angle about its own axis: statics must not mind."""
    at_rest(taut_beam(20))


# ------------------------------------------------------------------------------------------ marches

SWAY = (Harmonic(amplitude=(0.01, 0.03, 0.05), frequency=1.0),)
RAMPED = Motion(harmonics=SWAY, window=Window(ramp_up=0.5, shape="smooth"))
TURNED = Turn(t=(0.0, 0.25, 0.5, 0.75, 1.0), angle=(0.0, 9.0, 45.0, 81.0, 90.0))
ROD = Section(length=1.0, d=0.01, mass=0.2, EA=1e4, EI=0.05, wet_weight=0.5)
MOVED = Scene(cable=(ROD,), end_a=clamped(0, 0, 0), end_b=clamped(0.9, 0, 0.1, motion=RAMPED, twist=TURNED))


def march(scene: Scene, segments: int, model: str = "rod", **ask: Any) -> Response:
    """Generalised-alpha unless told otherwise, whatever becomes of it."""
    return solve(scene, Ask(**{"model": model, "segments": segments, "method": "genalpha", "interval": 0.05, **ask}))


def last(response: Response, stride: int = 1) -> np.ndarray:
    """Position, velocity and moment of every `stride`-th node at the end, each over its largest."""
    parts = [response.signals[name][-1, ::stride] for name in ("position", "velocity", "moment")]
    return np.array([part / np.abs(part).max() for part in parts])


def falls_by_four(errors: list[np.ndarray], low: float, high: float) -> None:
    size = np.array([np.sqrt((e**2).mean(axis=(1, 2))) for e in errors])
    ratio = size[:-1] / size[1:]
    assert np.all((low < ratio) & (ratio < high)), f"ratios {ratio} of errors {size}"


@pytest.mark.parametrize("rho", [1.0, 0.8])
def test_order_in_time(rho: float) -> None:
    """Smoothly ramped and twisted in space: root mean square errors of position, velocity and moment fall by 4 as the
    step halves. Against a step of a quarter of the last, which makes the last ratio 4.2; moments, which ring, 3.5."""
    runs = [march(MOVED, 12, duration=0.5, rho=rho, step=h) for h in (4e-3, 2e-3, 1e-3, 2.5e-4)]
    assert all(len(run.t) == 11 for run in runs), [run.message for run in runs]
    falls_by_four([last(run) - last(runs[-1]) for run in runs[:3]], 3.3, 5.0)


def test_order_in_space() -> None:
    """The same on 20, 40 and 80 elements against 160, at the same step; the reference's own error makes the last 5."""
    runs = {n: march(MOVED, n, duration=0.5, rho=0.8, step=4e-3) for n in (20, 40, 80, 160)}
    assert all(len(run.t) == 11 for run in runs.values()), [run.message for run in runs.values()]
    exact = runs[160]
    falls_by_four([last(runs[n]) - last(exact, 160 // n) for n in (20, 40, 80)], 3.3, 5.5)


def test_frames_stay_frames() -> None:
    """Both clamps turn by 720 degrees in 2 s while one also moves: frames orthonormal to rounding and never scaled;
    quaternions keep their length to 1e-3, which the gauge |p| = 1 restores; no twist builds up along the rod."""
    spin = Turn(t=(0.0, 0.5, 1.0, 1.5, 2.0), angle=(0.0, 90.0, 360.0, 630.0, 720.0))
    scene = replace(MOVED, end_a=clamped(0, 0, 0, twist=spin), end_b=clamped(0.9, 0, 0.1, motion=RAMPED, twist=spin))
    model = build_rod(scene, 24)
    q = at_rest(model)
    ask = Ask(model="rod", method="genalpha", step=4e-3, duration=2.0)
    grid = np.linspace(0.0, 2.0, 41)
    limits = limits_of(model, ask, "genalpha", model.fastest(q))
    run = marched(model, ask, "genalpha", limits, q, np.zeros(model.ndof), np.array([0.0, 0.5, 2.0]), grid)
    assert run.code == Status.OK
    p = run.out.q[:, model.pack.p[:, None] + np.arange(4)]
    R = matrix(p)
    assert np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max() < 1e-12
    assert np.abs(np.linalg.norm(p, axis=-1) - 1).max() < 1e-3
    turned = np.abs(np.einsum("tnij,nij->tn", R, R[0]) - 3).max(axis=0)  # 4 where a frame has turned by half
    assert turned.min() > 3.9
    assert np.abs(model.fields(run.out.q)["twist"]).max() < 2.0  # turned at one end only it would be 12.6 rad/m


def test_energy_closes() -> None:
    """The box rule in space and time loses nothing: what the ledger leaves is that of the mesh, of order 2, and below
    1e-3 of the peak energy at 80 elements."""
    found = []
    for n, h in ((20, 4e-3), (40, 2e-3), (80, 1e-3)):
        run = march(MOVED, n, duration=0.6, rho=1.0, step=h)
        assert len(run.t) == 13, run.message
        found.append(run.energy_residual)
    assert run.status == Status.OK, run.message
    assert found[-1] < 1e-3
    assert found[0] > 2 * found[1] > 4 * found[2]


def test_the_box_rule_goes_on() -> None:
    """rho = 1 for 1.5 s: rates of forces, which no equation holds, alternate for ever and must not end it."""
    for h in (2e-3, 1e-3):
        run = march(MOVED, 24, duration=1.5, rho=1.0, step=h)
        assert run.status in (Status.OK, Status.ENERGY_OPEN), run.message


# ------------------------------------------------------------------------------------------ waves along the line

EA, M, L, V0 = 1e6, 1.0, 100.0, 1.0  # c = 1000 m/s, v0 sqrt(EA m) = 1000 N


def snap(segments: int = 200, **ask: Any) -> tuple[Response, np.ndarray]:
    """An end of a taut catenary jumps to v0: tension above the static one over v0 sqrt(EA m), (nt, segments)."""
    slow = 1e-4  # Hz: over the run the harmonic's velocity falls by less than 1e-8
    pull = Harmonic(amplitude=(V0 / (2 * math.pi * slow), 0.0, 0.0), frequency=slow)
    cable = Section(length=L, d=0.01, mass=M, EA=EA, wet_weight=0.0, compression=True)
    scene = Scene(
        cable=(cable,), end_a=pinned(0, 0, 0), end_b=pinned(L * 1.005, 0, 0, motion=Motion(harmonics=(pull,))), g=0.0
    )
    run = march(scene, segments, "catenary", **{"duration": 0.17, "interval": 1e-3, **ask})
    assert len(run.t) == 171, run.message
    return run, (run.signals["tension"] - EA * 0.005) / (V0 * math.sqrt(EA * M))


@pytest.mark.parametrize("rho", [1.0, 0.5, 0.0])
def test_snap_plateau_and_doubling(rho: float) -> None:
    """The tension rises by v0 sqrt(EA m) behind a front at sqrt(EA/m), and by twice that behind the fixed end's echo:
    averages over the plateau to 1 %, the front's half height to 2 % (a dispersive scheme and rho < 1 smear it)."""
    run, rise = snap(rho=rho, step=7e-4)
    x = (run.signals["arc"][1:] + run.signals["arc"][:-1]) / 2
    assert rise[60, (x > 50) & (x < 90)].mean() == pytest.approx(1.0, abs=0.01)
    assert np.abs(rise[60, x < 25]).max() < 1e-4  # nothing is far ahead of the front, at 40 m
    assert rise[150, (x > 10) & (x < 40)].mean() == pytest.approx(2.0, abs=0.02)
    e = int(np.argmin(np.abs(L - x - 80.0)))
    k = int(np.argmax(rise[:, e] > 0.5))
    share = (0.5 - rise[k - 1, e]) / (rise[k, e] - rise[k - 1, e])
    assert 1e-3 * (k - 1 + share) * math.sqrt(EA / M) == pytest.approx(L - x[e], rel=0.02)


def test_snap_overshoot_falls_with_rho() -> None:
    """With a step above l/c short waves lag, and the front rings most without damping in time: 27, 25 and 20 %. With
    h = l/c the box scheme is the method of characteristics: no overshoot but for the change of l by the strain."""
    over = [snap(rho=rho, step=7e-4)[1][:95].max() - 1 for rho in (1.0, 0.5, 0.0)]
    assert over[0] > over[1] > over[2] > 0.15
    assert over[0] == pytest.approx(0.27, abs=0.02)
    exact = snap(rho=1.0, step=5e-4)[1][:95].max() - 1
    assert abs(exact) < 1e-4


def test_rho_below_one_dissipates() -> None:
    """The front's short waves lose energy where rho < 1, the more the lower; the box rule keeps all of it."""
    lost = []
    for rho in (1.0, 0.5, 0.0):
        x = snap(rho=rho, step=7e-4)[0].signals
        stored = x["kinetic"][-1] + x["strain"][-1]
        lost.append(1 - stored / x["work"][-1])
    assert abs(lost[0]) < 1e-5
    assert 1e-4 < lost[1] < lost[2] < 1e-2


def test_torsional_wave() -> None:
    """An end turned at the rate W: behind a front at sqrt(GJ/J) the torque is W sqrt(GJ J), and twice that behind the
    echo of the clamp; the rod lies askew in space and stays straight. To 2 %: the ringing of the front, averaged."""
    J, GJ, length, rate = 0.02, 8.0, 10.0, 1.0
    axis, until = np.array([1.0, 2.0, 2.0]) / 3, 1.6 * length / math.sqrt(GJ / J)
    cable = Section(
        length=length, d=0.1, mass=10.0, EA=1e7, EI=4.0, GJ=GJ, inertia=(J / 2, J / 2, J), wet_weight=0.0,
    )  # fmt: skip
    t = tuple(np.linspace(0.0, until, 9))
    turn = Turn(t=t, angle=tuple(np.degrees(rate) * np.array(t)))
    ends = [End(kind="clamped", position=tuple(x * axis), direction=tuple(axis)) for x in (0.0, 1.00001 * length)]
    scene = Scene(cable=(cable,), g=0.0, end_a=ends[0], end_b=replace(ends[1], twist=turn))
    run = march(scene, 100, step=until / 200, rho=0.5, duration=until, interval=until / 40)
    assert run.status == Status.OK, run.message
    torque, s = run.signals["torque"], run.signals["arc"]
    plateau = rate * math.sqrt(GJ * J)
    middle = torque[15, (s > 0.6 * length) & (s < 0.9 * length)]  # the front has gone 0.6 of the way
    assert middle.mean() == pytest.approx(plateau, rel=0.02)
    assert np.abs(torque[15, s < 0.25 * length]).max() < 1e-3 * plateau
    assert torque[-1, (s > 0.1 * length) & (s < 0.4 * length)].mean() == pytest.approx(2 * plateau, rel=0.02)


# ------------------------------------------------------------------------------------------ water


@pytest.mark.parametrize("model", ["catenary", "rod"])
def test_jumper_in_surge(model: str) -> None:
    """Low & Langley (2006): tension at the moved end 41.58 to 52.24 kN, mean 46.71, to 1 kN, what a figure can be read
    to. Drag makes most of that range: the same mesh of lumped masses, whose error falls as the square of the mesh like
    this one's, is met to 0.2 % of the range (without bending) and 0.1 % (with it)."""
    cable = replace(jumper().cable[0], BA=0.0)  # which rods do not have
    scene = replace(jumper(), cable=(cable,))

    def swing(model: str) -> list[float]:
        ask = Ask(model=model, segments=60, duration=81.0, output_from=54.0, interval=0.05, method="trbdf2")
        run = solve(scene, ask)
        assert run.status == Status.OK, run.message
        force = np.linalg.norm(run.signals["end_force"][:, 1], axis=1)
        return [force.min(), force.max(), force.mean()]

    found = swing(model)
    np.testing.assert_allclose(found, [41.58e3, 52.24e3, 46.71e3], atol=1e3)
    span = found[1] - found[0]
    np.testing.assert_allclose(found, swing("lumped"), atol=(2e-3 if model == "catenary" else 1e-3) * span)


# ------------------------------------------------------------------------------------------ sawtooth along s


def test_sawtooth_along_the_line() -> None:
    """Elements 20 times the bending length at clamp A: y' = -20 y in the element. With the box scheme the moment
    alternates in sign and falls by (1 - z/2)/(1 + z/2) = -9/11 an element, z = 20; with rho_space = 0.5 it follows the
    recursion of generalised-alpha after a first element by the box rule. UNRESOLVED, both."""
    rod = Section(length=2.0, d=1e-3, mass=1e-3, EA=1e8, EI=1e-4, wet_weight=0.0)  # bending length 0.01 at T = 1
    clamp = End(kind="clamped", position=(0, 0, 0), direction=(1, 0, 0.1))
    scene = Scene(cable=(rod,), end_a=clamp, end_b=End(kind="free", force=(1.0, 0, 0)))
    moments = {}
    for rho_space in (1.0, 0.5):
        run = solve(scene, Ask(model="rod", segments=10, rho_space=rho_space))
        assert run.status == Status.UNRESOLVED
        moments[rho_space] = run.signals["moment"][0, :, 1]
    box = moments[1.0][:4]
    np.testing.assert_allclose(box[1:] / box[:-1], -9 / 11, rtol=0.03)  # the other end is 10 elements away
    assert abs(moments[1.0][5]) > 0.3 * abs(moments[1.0][0])
    am, af, g = spatial(0.5)
    decay = [1.0, -9 / 11]
    for _ in range(6):
        one, two = decay[-2:]
        known = (2 * am - 1) * two + (1 - am) * one - 20 * (g * (1 - af) + (1 - g) * af) * two
        decay.append((known - 20 * (1 - g) * (1 - af) * one) / (am + 20 * g * af))
    np.testing.assert_allclose(moments[0.5][:8] / moments[0.5][0], decay, atol=4e-3)  # clamp turned by 0.1, not by 0


# ------------------------------------------------------------------------------------------ loss of tension

CHAIN = Section(length=1.0, d=0.002, mass=0.1, EA=1e3, compression=False)


def folded(segments: int, gap: float) -> Scene:
    """A chain of 1 m folded at its middle, ends side by side; end B is let go."""
    r = gap / 2
    leg = (1.0 - math.pi * r) / 2
    shape = []
    for s in np.linspace(0.0, 1.0, segments + 1):
        angle = min(max((s - leg) / r, 0.0), math.pi)
        z = -s if s <= leg else (s - 1.0 if s >= 1.0 - leg else -leg - r * math.sin(angle))
        shape.append((r - r * math.cos(angle), 0.0, z))
    return Scene(
        cable=(CHAIN,), end_a=pinned(0, 0, 0), end_b=End(kind="free"), g=9.81,
        start=Start(kind="given", shape=tuple(shape)),
    )  # fmt: skip


def assert_refused(run: Response, *allowed: Status) -> None:
    assert run.status in allowed, run.message
    assert REMEDY[run.status] in run.message


@pytest.mark.parametrize("settings", [{"step": 1e-3}, {"method": "trbdf2"}], ids=["fixed step", "error control"])
def test_a_folded_chain_is_no_catenary(settings: dict) -> None:
    """The falling part of a folded chain has no tension, so a catenary has no direction there: told, with the remedy.
    The lumped line follows the fall (test_transients)."""
    run = march(folded(50, 0.04), 50, "catenary", duration=0.3, max_steps=5000, **settings)
    assert_refused(run, Status.ZERO_TENSION)


def test_a_catenary_shaken_slack() -> None:
    """An end that moves faster than the line can fall: ZERO_TENSION, and the remedy names the models that can."""
    shake = Motion(harmonics=(Harmonic(amplitude=(0, 0, 0.3), frequency=2.0),), window=Window(ramp_up=0.5))
    chain = replace(CHAIN, EA=1e4, mass=0.2)
    scene = Scene(cable=(chain,), end_a=pinned(0, 0, 0), end_b=pinned(0.9, 0, 0.1, motion=shake))
    run = march(scene, 20, "catenary", duration=2.0, interval=0.02, method="trbdf2", max_steps=20000)
    assert_refused(run, Status.ZERO_TENSION)
    assert "lumped" in run.message
    fixed = march(scene, 20, "catenary", duration=2.0, interval=0.02, step=2e-3)
    assert fixed.status != Status.OK


@pytest.mark.parametrize("there", [(0.0, 0.0, 0.0), (0.0, 0.0, -0.5)], ids=["at one point", "below"])
def test_a_chain_hung_straight_down_has_no_static_state(there: tuple[float, float, float]) -> None:
    """Both ends on a vertical and the chain longer: its fold is a point without tension."""
    scene = Scene(cable=(CHAIN,), end_a=pinned(0, 0, 0), end_b=pinned(*there))
    assert_refused(solve(scene, Ask(model="catenary", segments=40)), Status.NO_STATIC, Status.ZERO_TENSION)


def test_a_slack_weightless_line_has_no_static_state() -> None:
    """Without weight any shape would do."""
    scene = Scene(cable=(replace(CHAIN, wet_weight=0.0),), end_a=pinned(0, 0, 0), end_b=pinned(0.9, 0, 0))
    assert_refused(solve(scene, Ask(model="catenary", segments=20)), Status.NO_STATIC, Status.ZERO_TENSION)


def test_a_strained_start_rings_as_the_lumped_line_does() -> None:
    """A taut line released with a strain of its own: tension at end A within 1 % of the lumped line's."""
    length = 10.0
    s = np.linspace(0.0, length, 41)
    strain = 0.002 + 0.0005 * np.cos(np.pi * s / length)
    x = s + np.concatenate([[0.0], np.cumsum((strain[1:] + strain[:-1]) / 2 * np.diff(s))])
    cable = Section(length=length, d=0.01, mass=1.0, EA=1e4, wet_weight=0.0, Can=0, Cdn=0)
    scene = Scene(
        cable=(cable,),
        end_a=End(kind="pinned", position=(0, 0, 0)),
        end_b=End(kind="pinned", position=(float(x[-1]), 0, 0)),
        start=Start(kind="given", shape=tuple((float(v), 0.0, 0.0) for v in x), s=tuple(s)),
    )
    ask = Ask(duration=0.2, interval=0.02, segments=80, method="genalpha", step=5e-4, rho=0.9)
    one, other = (solve(scene, replace(ask, model=name)) for name in ("lumped", "catenary"))
    assert other.status == Status.OK
    np.testing.assert_allclose(other.signals["end_force"][:, 0, 0], one.signals["end_force"][:, 0, 0], rtol=1e-2)
