"""The rod family's analytic tangent, its layout and pivoting solve, its rotations, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tangent_kit import check_tangent, dense

from solvers import (
    TMD,
    Ask,
    CannotRepresent,
    Current,
    End,
    Harmonic,
    Motion,
    Scene,
    Seabed,
    Section,
    Turn,
    Water,
    solve,
)
from solvers import rotation as turns
from solvers.banded import hold
from solvers.dispatch import call_backsolve, call_factorise, call_residual, call_tangent
from solvers.lines.rod import params
from solvers.lines.rod.model import RodModel, carried

ROD, CATENARY = [True] * 6, [False] * 6
STIFF_ENDS, STIFF_MIDDLE = [True, True, False, False, True, True], [False, False, True, True, False, False]
DOMAINS = {"rod": ROD, "catenary": CATENARY, "rod at the ends": STIFF_ENDS, "rod in the middle": STIFF_MIDDLE}

# ------------------------------------------------------------------------------------------ tangent

SECTION = Section(
    length=3.0, d=0.1, mass=10.0, EA=1e4, EI=50.0, EI2=80.0, GJ=30.0, coupling=40.0, curvature=(0.1, -0.2, 0.3),
    moment=(1.0, 2.0, -1.0), inertia=(0.5, 0.7, 1.1), Cat=0.3, Cdt=0.1,
)  # fmt: skip
SHEARED = Current(z=(-6.0, -0.5, 0.5, 2.0), velocity=((0.3, 0.1, 0), (0.5, 0.0, 0.1), (0.7, -0.3, 0), (1.0, 0, 0)))
BED = Seabed(z=-5.0, stiffness=200.0, damping=30.0, friction=0.4, friction_speed=0.3)
EVERYTHING = Scene(
    cable=(SECTION,),
    water=Water(depth=5.0, current=SHEARED),
    seabed=BED,
    end_a=End(kind="clamped", position=(0, 0, -5.0), direction=(1, 0, 0.2)),
    end_b=End(kind="free", position=(2, 0, -4.0), force=(1, 2, 3), moment=(0.3, 0.2, 0.1)),
)


def pack_of(rods: list[bool], rho: float, scene: Scene = EVERYTHING) -> params.Rod:
    """Six equal elements."""
    return params.discretise(scene, np.linspace(0, 3, 7), np.zeros(6, int), np.array(rods), rho)


def state(pack: params.Rod, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Along the bed, some nodes in it, curved and twisted by some 0.3 rad an element; no quaternion has unit length."""
    draw = np.random.default_rng(seed)
    n = len(pack.weight)
    q, v, a = 0.3 * draw.standard_normal(n), draw.standard_normal(n), draw.standard_normal(n)
    for i in range(len(pack.r)):
        place = np.array([0.4 * i, 0.1 * np.sin(i), -5.0 + 0.05 * i]) + 0.05 * draw.standard_normal(3)
        q[pack.r[i] : pack.r[i] + 3] = place
        q[pack.N[i] : pack.N[i] + 3] += [5.0, 1.0, 2.0]  # a catenary needs tension
        if pack.p[i] >= 0:
            turn = np.array([1.0, 0.2 * i, 0.1 * i, -0.1])
            q[pack.p[i] : pack.p[i] + 4] = turn + 0.1 * draw.standard_normal(4)
    return q, v, a


@pytest.mark.parametrize("rho", [1.0, 0.4])
@pytest.mark.parametrize("rods", DOMAINS.values(), ids=list(DOMAINS))
def test_tangent_matches_differences(rods: list[bool], rho: float) -> None:
    """Everything that a section can have, drag in a sheared current, bed with friction, end moment: to 3e-8 of each
    row's largest entry, which is what central differences with such steps leave (step^2 and rounding/step)."""
    pack = pack_of(rods, rho)
    check_tangent(pack, *state(pack, 1), (3e-6, 1e-5, 1.0), 3e-8)


def test_tangent_reads_every_term() -> None:
    """The state is one where each of these changes the tangent: none of the agreement above is that of zeros."""
    pack = pack_of(ROD, 0.4)
    q, v, a = state(pack, 1)

    def tangent(changed: params.Rod) -> np.ndarray:
        J = np.zeros((len(q), 2 * pack.bw + 1))
        call_tangent(0.0, q, v, a, 1.0, 1.0, 1.0, changed, J)
        return J

    whole = tangent(pack)
    compliant = pack.give.copy()
    compliant[:, 4] = 0.0
    round_bar = pack.give.copy()
    round_bar[:, 1] = round_bar[:, 0]
    for change in (
        {"give": compliant}, {"give": round_bar}, {"inertia": 0 * pack.inertia}, {"end_moment": 0 * pack.end_moment},
        {"bed": np.zeros(0)}, {"cn": 0 * pack.cn}, {"ct": 0 * pack.ct}, {"profile": 0 * pack.profile},
        {"mt": 0 * pack.mt}, {"space": (0.5, 0.5, 0.5)},
    ):  # fmt: skip
        assert np.abs(tangent(pack._replace(**change)) - whole).max() > 1e-4, list(change)


# ------------------------------------------------------------------------------------------ layout and solve


@pytest.mark.parametrize("rho", [1.0, 0.4])
@pytest.mark.parametrize("rods", DOMAINS.values(), ids=list(DOMAINS))
def test_layout(rods: list[bool], rho: float) -> None:
    """As many equations as unknowns: 12 or 6 an element, 6 for the ends, one gauge a frame, three more where a domain
    ends. Each unknown and each row is given out once, and no entry of the tangent lies outside the extents stored."""
    pack = pack_of(rods, rho)
    rod = np.array(rods)
    bends = np.concatenate([[False], rod]) | np.concatenate([rod, [False]])
    edges = int(np.abs(np.diff(np.concatenate([[0], rod.astype(int), [0]]))).sum())
    n = len(pack.weight)
    assert n == 6 * 7 + 7 * bends.sum()
    assert n == 12 * rod.sum() + 6 * (~rod).sum() + 6 + bends.sum() + 3 * edges
    assert edges == np.abs(pack.hinge).sum()
    sizes = {"r": 3, "p": 4, "N": 3, "M": 3}
    given = [at + m for k, size in sizes.items() for at in getattr(pack, k) if at >= 0 for m in range(size)]
    np.testing.assert_array_equal(np.sort(given), np.arange(n))
    rows = [pack.row[e] + m for e in range(6) for m in range(12 if rods[e] else 6)]
    rows += [pack.frame_row[i] + m for i in np.flatnonzero(bends) for m in range(4 if pack.hinge[i] else 1)]
    rows += [pack.r[i] + m for i in (0, -1) for m in range(3)]
    np.testing.assert_array_equal(np.sort(rows), np.arange(n))
    J = np.zeros((n, 2 * pack.bw + 1))
    call_tangent(0.0, *state(pack, 2), 1.0, 1.0, 1.0, pack, J)
    i, j = np.nonzero(dense(J, pack.bw))
    assert np.all(i <= pack.low[j])
    assert np.all(j <= pack.high[i])
    assert np.all(np.diff(pack.low) >= 0)


@pytest.mark.parametrize("rho", [1.0, 0.4])
@pytest.mark.parametrize("rods", DOMAINS.values(), ids=list(DOMAINS))
def test_pivoting_solve_agrees_with_lapack(rods: list[bool], rho: float) -> None:
    """Tangent of a step with the held end's dofs fixed: numpy's solution, to 1e-9 of its size (condition up to 1e6)."""
    pinned = replace(EVERYTHING, end_a=End(kind="pinned", position=(0, 0, -5)))
    pack = pack_of(rods, rho, EVERYTHING if rods[0] else pinned)
    q, v, a = state(pack, 3)
    n = len(q)
    J = np.zeros((n, 2 * pack.bw + 1))
    call_tangent(0.0, q, v, a, 1.0, 7.0, 50.0, pack, J)
    hold(J, pack.bw, pack.fixed)
    full, x = dense(J, pack.bw), np.random.default_rng(4).standard_normal(n)
    expected = np.linalg.solve(full, x)
    assert call_factorise(pack, J)
    call_backsolve(pack, J, x)
    order = pack.small.order if len(pack.small.slot) else pack.order
    assert np.any(order != np.arange(len(order)))  # rows were exchanged
    np.testing.assert_allclose(x, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("rods", "step", "left"),
    [(CATENARY, 1e-9, 1e-13), (STIFF_ENDS, 1e-7, 1e-4), (STIFF_MIDDLE, 1e-7, 1e-4), (ROD, 1e-7, 1e-4)],
    ids=["catenary", "rod at the ends", "rod in the middle", "rod"],
)
def test_a_tangent_of_a_very_short_step(rods: list[bool], step: float, left: float) -> None:
    """Steps with which a march is launched, where inertia is far larger than the entries of the forces: the solution
    meets its equations to `left` of each row's own terms. Catenaries do to rounding; rods, whose rows are scaled and
    whose columns are not, well enough for a Newton step."""
    pinned = replace(EVERYTHING, end_a=End(kind="pinned", position=(0, 0, -5)))
    pack = pack_of(rods, 1.0, EVERYTHING if rods[0] else pinned)
    q, v, a = state(pack, 3)
    J = np.zeros((len(q), 2 * pack.bw + 1))
    call_tangent(0.0, q, v, a, 1.0, 1 / step, 1 / step**2, pack, J)
    hold(J, pack.bw, pack.fixed)
    full, b = dense(J, pack.bw), np.random.default_rng(4).standard_normal(len(q))
    x = b.copy()
    assert call_factorise(pack, J)
    call_backsolve(pack, J, x)
    assert np.all(np.abs(full @ x - b) < left * (np.abs(full) @ np.abs(x) + np.abs(b)))


def test_a_singular_tangent_is_told() -> None:
    """Inertia alone, without the constraints that forces and moments answer to, has empty rows."""
    pack = pack_of(ROD, 1.0)
    q = state(pack, 1)[0]
    J = np.zeros((len(q), 2 * pack.bw + 1))
    call_tangent(0.0, q, 0 * q, 0 * q, 0.0, 0.0, 1.0, pack, J)
    assert not call_factorise(pack, J)


# ------------------------------------------------------------------------------------------ rotations


def of(p: Any) -> Rotation:
    """scipy's rotation of a quaternion (w, x, y, z) of any length."""
    return Rotation.from_quat(np.roll(np.asarray(p, dtype=float), -1))


def quaternions(count: int) -> np.ndarray:
    """Random, of lengths from about 0.5 to 3."""
    return np.random.default_rng(5).standard_normal((count, 4)) * 1.2


def test_frames_and_products() -> None:
    """Columns of the frame, products, conversions both ways: scipy's, to rounding."""
    for p, q in zip(quaternions(20), quaternions(40)[20:], strict=True):
        R = of(p).as_matrix()
        np.testing.assert_allclose(np.column_stack(turns.frame(tuple(p))), R, atol=1e-14)
        np.testing.assert_allclose(params.matrix(p), R, atol=1e-14)
        np.testing.assert_allclose(of(params.quaternion(R)).as_matrix(), R, atol=1e-14)
        product = of(turns.times(tuple(p), tuple(q))).as_matrix()
        np.testing.assert_allclose(product, (of(p) * of(q)).as_matrix(), atol=1e-14)
        about = of(p) * Rotation.from_rotvec([0, 0, 0.7])
        np.testing.assert_allclose(of(params.rotated(p, 0.7)).as_matrix(), about.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(params.matrix(quaternions(6).reshape(2, 3, 4))[1, 2], params.matrix(quaternions(6)[5]))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 9e-4, 1.1e-3, 0.09, 0.11, 1.0, 3.0])
def test_turn_between_frames(angle: float) -> None:
    """Rotation vector in body axes, on both sides of where its series takes over: to 1e-12 (the series' next term is
    y^6/7 = 2e-19; at 3 rad the arctangent loses a digit). The frames' lengths and signs do not matter."""
    axis = np.array([0.6, -0.48, 0.64])
    for p in quaternions(5):
        q = 1.7 * np.roll((of(p) * Rotation.from_rotvec(angle * axis)).as_quat(), 1)
        for sign in (1.0, -1.0):
            c, x = turns.relative(tuple(p), tuple(sign * q))
            found = turns.rotation_vector(c, x)[0]
            np.testing.assert_allclose(found, angle * axis, rtol=0, atol=1e-12)
            np.testing.assert_allclose(found, (of(p).inv() * of(q)).as_rotvec(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle", [1e-4, 0.003, 0.2, 2.0])
def test_derivative_of_the_turn(angle: float) -> None:
    """Against central differences of step 1e-5, which leave 1e-9 (rounding 1e-16/1e-5, and step^2)."""
    A, B = np.zeros((3, 4)), np.zeros((3, 4))
    for p in quaternions(3):
        q = 1.7 * np.roll((of(p) * Rotation.from_rotvec(angle * np.array([0.6, -0.48, 0.64]))).as_quat(), 1)
        turns.relative_matrices(tuple(p), tuple(q), 1.0, A, B)

        def vector(p: np.ndarray, q: np.ndarray) -> np.ndarray:
            return np.array(turns.rotation_vector(*turns.relative(tuple(p), tuple(q)))[0])

        for m, e in enumerate(1e-5 * np.eye(4)):
            np.testing.assert_allclose(A[:, m], (vector(p + e, q) - vector(p - e, q)) / 2e-5, atol=1e-8)
            np.testing.assert_allclose(B[:, m], (vector(p, q + e) - vector(p, q - e)) / 2e-5, atol=1e-8)


def test_spin() -> None:
    """Spin of a frame that turns at a known rate while its quaternion's length changes; its matrices by differences."""
    draw = np.random.default_rng(6)
    P = np.zeros((3, 4))
    for p in quaternions(5):
        omega, growth = draw.standard_normal(3), draw.standard_normal()
        rate = 0.5 * np.array(turns.times((0.0, *omega), tuple(p))) + growth * p
        np.testing.assert_allclose(turns.spin_of(tuple(p), tuple(rate)), omega, atol=1e-13)
        ahead, back = of(p + 1e-6 * rate), of(p - 1e-6 * rate)
        np.testing.assert_allclose((ahead * back.inv()).as_rotvec() / 2e-6, omega, atol=1e-8)
        turns.spin_matrix(tuple(p), 2.0, P)
        np.testing.assert_allclose(P @ rate, 2 * omega, atol=1e-13)
        P[:] = 0.0
        turns.add_spin_turn(tuple(p), tuple(rate), 3.0, P)
        for m, e in enumerate(1e-5 * np.eye(4)):
            up, down = (np.array(turns.spin_of(tuple(x), tuple(rate))) for x in (p + e, p - e))
            np.testing.assert_allclose(P[:, m], 3 * (up - down) / 2e-5, atol=1e-7)


@pytest.mark.parametrize("angle", [1e-3, 0.0999, 0.1001, 1.0, 3.0])
def test_chord_of_an_arc(angle: float) -> None:
    """(1 - sin(t/2)/(t/2))/t^2 and its derivative over t, by a series of 30 terms: to 1e-12, what the closed form keeps
    of its digits at t = 0.1."""
    beta = slope = 0.0
    term = 1.0
    for k in range(1, 31):
        term *= -1.0 / ((2 * k) * (2 * k + 1)) / 4  # (-1)^k (1/2)^2k/(2k + 1)!
        beta -= term * angle ** (2 * k - 2)
        slope -= (2 * k - 2) * term * angle ** (2 * k - 4) if k > 1 else 0.0
    found = turns.arc_factor(angle**2)
    assert found[0] == pytest.approx(beta, rel=1e-12)
    assert found[1] == pytest.approx(slope, rel=1e-8)  # rounding over t^4


def test_frames_of_ends() -> None:
    """Axis 3 along the direction, axis 2 horizontal and y for a vertical one; right-handed; transport adds no twist."""
    for direction in ((1, 0, 0), (0.3, -2.0, 1.0), (0, 0, 1), (0, 0, -3)):
        R = params.matrix(params.end_frame(direction))
        np.testing.assert_allclose(R[:, 2], np.array(direction) / np.linalg.norm(direction), atol=1e-14)
        assert abs(R[2, 1]) < 1e-14
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0)
        if direction[:2] == (0, 0):
            np.testing.assert_allclose(R[:, 1], [0, 1, 0], atol=1e-14)
        onto = np.array([0.36, 0.48, 0.8])
        turned = carried(R, onto)
        np.testing.assert_allclose(turned[:, 2], onto, atol=1e-14)
        step = Rotation.from_matrix(turned @ R.T).as_rotvec()
        assert abs(step @ onto) + abs(step @ R[:, 2]) < 1e-12


# ------------------------------------------------------------------------------------------ refusals

LINE = Section(length=10.0, d=0.02, mass=1.0, EA=1e5, EI=2.0)
PIN_A, PIN_B = End(kind="pinned", position=(0, 0, -8)), End(kind="pinned", position=(6, 0, -3))
CLAMP_B = End(kind="clamped", position=(6, 0, -3), direction=(1, 0, 0))
CURLED = replace(LINE, curvature=(0.1, 0, 0))
TWIST = Turn(t=(0.0, 1.0, 2.0, 3.0), angle=(0.0, 10.0, 20.0, 30.0))
SWAY = Motion(harmonics=(Harmonic(amplitude=(0.1, 0, 0), frequency=0.5),))


@pytest.mark.parametrize(
    ("model", "change", "ask", "words"),
    [
        ("rod", {"devices": (TMD(s=3.0, mass=1.0, k=10.0),)}, {}, "DEVICE"),
        ("rod", {"cable": (replace(LINE, BA=10.0),)}, {}, "DAMPING"),
        ("rod", {"cable": (replace(LINE, BI=10.0),)}, {}, "DAMPING"),
        ("rod", {"cable": (LINE, replace(LINE, EI=0.0, compression=True))}, {}, r"cable\[1\] has EI = 0"),
        ("catenary", {"end_b": CLAMP_B}, {}, "end_b holds a direction"),
        ("catenary", {"cable": (replace(LINE, coupling=10.0),)}, {}, "TORSION"),
        ("catenary", {"cable": (replace(LINE, moment=(0, 0, 1)),)}, {}, "ROTATION"),
        ("hybrid", {"end_b": CLAMP_B}, {"rods": ((0.0, 5.0),)}, "end_b holds a direction"),
        ("hybrid", {"cable": (CURLED,)}, {"rods": ((5.0, 10.0),)}, r"cable\[0\].*curvature"),
        ("hybrid", {"end_b": replace(CLAMP_B, twist=10.0)}, {"rods": ((5.0, 10.0),)}, "the ends twist the cable"),
        ("hybrid", {"end_b": replace(CLAMP_B, twist=TWIST)}, {"rods": ((5.0, 10.0),)}, "the ends twist the cable"),
        ("rod", {"end_b": replace(PIN_B, motion=SWAY)}, {"duration": 4.0, "method": "harmonic"}, "harmonic: rod"),
        ("rod", {"end_b": replace(PIN_B, motion=SWAY)}, {"duration": 4.0, "method": "dopri5"}, "accelerate.*rod"),
        ("rod", {}, {"duration": 1.0, "rho_space": 0.5}, r"rho_space = 0.5 damps along s at rest alone"),
    ],
    ids=[
        "device", "BA", "BI", "EI = 0", "clamped", "coupling", "moment", "hybrid clamped", "hybrid curvature",
        "hybrid twist", "hybrid turn", "harmonic", "explicit", "rho_space in motion",
    ],
)  # fmt: skip
def test_what_it_refuses(model: str, change: dict, ask: dict, words: str) -> None:
    """Refused before the run, with the field or feature in the message and models or methods that can."""
    scene = Scene(**{"cable": (LINE,), "end_a": PIN_A, "end_b": PIN_B, **change})
    with pytest.raises(CannotRepresent, match=words):
        solve(scene, Ask(model=model, segments=20, **ask))


def test_all_that_is_wrong_is_told_at_once() -> None:
    """The line itself names every field at fault, whoever builds it."""
    wrong = (replace(LINE, BA=10.0), replace(LINE, EI=0.0))
    scene = Scene(cable=wrong, end_a=PIN_A, end_b=CLAMP_B, devices=(TMD(s=3.0, mass=1.0, k=10.0),))
    with pytest.raises(CannotRepresent, match=r"cable\[0\] has internal damping.*cable\[1\] has EI = 0.*devices"):
        RodModel(scene, 20, np.ones(20, bool))
    with pytest.raises(CannotRepresent, match=r"devices.*end_b holds a direction"):
        RodModel(scene, 20, ())


def test_residual_at_held_ends_is_the_external_force() -> None:
    """By Newton: the end rows are N at B and -N at A, less the loads given there."""
    pack = pack_of(ROD, 1.0)
    q, v, a = state(pack, 7)
    r = np.zeros(len(q))
    call_residual(0.0, q, v, a, pack, r)
    np.testing.assert_allclose(r[:3], -q[pack.N[0] : pack.N[0] + 3], atol=1e-14)
    np.testing.assert_allclose(r[pack.r[-1] :][:3], q[pack.N[-1] : pack.N[-1] + 3] - [1, 2, 3], atol=1e-14)
