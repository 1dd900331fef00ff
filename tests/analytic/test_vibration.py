"""Natural frequencies of the lumped line against closed forms.

Generalised eigenvalues of the tangent at rest.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import jn_zeros, jv, yv

from solvers import End, Harmonic, Motion, PointMass, Scene, Section, Status, Water
from solvers.catalogue import static_state
from solvers.catenary import catenary
from solvers.dispatch import call_tangent
from solvers.lines.lumped import LumpedModel


def full(J: np.ndarray, bw: int) -> np.ndarray:
    """Band storage J[i, bw + j - i] as a square matrix."""
    rows, cols = np.indices(J.shape)
    cols = rows + cols - bw
    inside = (cols >= 0) & (cols < len(J))
    square = np.zeros((len(J), len(J)))
    square[rows[inside], cols[inside]] = J[inside]
    return square


def matrices(model: LumpedModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K and M at rest, whole, and the free dofs."""
    status, q, note = static_state(model)
    assert status == Status.OK, note
    zero = np.zeros(model.ndof)
    found = []
    for cq, ca in ((1.0, 0.0), (0.0, 1.0)):
        J = np.zeros((model.ndof, 2 * model.pack.bw + 1))
        call_tangent(0.0, q, zero, zero, cq, 0.0, ca, model.pack, J)
        found.append(full(J, model.pack.bw))
    for A in found:  # an energy's Hessian and an inertia are symmetric
        assert np.abs(A - A.T).max() <= 1e-12 * np.abs(A).max()
    return found[0], found[1], np.setdiff1d(np.arange(model.ndof), model.pack.fixed)


def modes(scene: Scene, segments: int, axis: int | None = None) -> np.ndarray:
    """Natural angular frequencies, lowest first.

    Of the dofs along one axis of the model alone if one is named.
    """
    model = LumpedModel(scene, segments)
    K, M, free = matrices(model)
    if axis is not None:
        chosen = np.intersect1d(free, model.pack.at + axis)
        others = np.setdiff1d(free, chosen)
        assert np.abs(K[np.ix_(chosen, others)]).max(initial=0.0) <= 1e-9 * np.abs(K).max()
        free = chosen
    squares = eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0.0))


def orders(errors: list[float]) -> np.ndarray:
    e = np.abs(np.array(errors))
    return np.log2(e[:-1] / e[1:])


def assert_second_order(errors: list[Any], low: float = 1.95, high: float = 2.05) -> None:
    seen = orders(errors)
    assert np.all((low < seen) & (seen < high)), f"orders {seen} of errors {errors}"


def level(
    cable: Section | tuple[Section, ...], span: float, *, clamped: bool = False, **fields: Any
) -> Scene:
    """A straight cable along x without weight, pinned or clamped at both ends."""
    ends: dict[str, Any] = {"kind": "pinned"}
    if clamped:
        ends = {"kind": "clamped", "direction": (1.0, 0.0, 0.0)}
    sections = cable if isinstance(cable, tuple) else (cable,)
    return Scene(
        cable=sections,
        end_a=End(position=(0.0, 0.0, -3.0), **ends),
        end_b=End(position=(span, 0.0, -3.0), **ends),
        **{"g": 0.0, **fields},
    )


def in_space(scene: Scene) -> Scene:
    """The same scene in three dimensions: its upper end would move out of the plane, but not at t = 0."""
    aside = Motion(harmonics=(Harmonic(amplitude=(0.3, 1.0, 0.0), frequency=0.01),))
    return replace(scene, end_b=replace(scene.end_b, motion=aside))


def stretched(T: float, length: float, m: float, EA: float, **fields: Any) -> Section:
    """A section whose mass, length and EI are those given once it is stretched by T.

    The line lumps mass per unstretched metre and has the bending energy EI theta^2/2l, l unstretched; in the
    stretched length h = l (1 + e) the dispersion relations hold with m l = m' h and EI/l = EI'/h.
    """
    e = 1 + T / EA
    EI = fields.pop("EI", 0.0) / e
    return Section(length=length / e, mass=m * e, EA=EA, EI=EI, **{"d": 0.1, "wet_weight": 0.0, **fields})


# ------------------------------------------------------------------------------------ exact on the mesh


@pytest.mark.parametrize("wet", [False, True], ids=["air", "water"])
def test_taut_string_is_exact(wet: bool) -> None:
    """omega_k = (2/h) sqrt(T/m) sin(k pi/2N) for every k, across; with EA for T along.

    Rounding: 1e-8 of T/EA = 0.01. In water m gains rho pi d^2/4 times Can across and Cat along.
    """
    T, m, L, N, EA = 5e4, 20.0, 12.0, 16, 5e6
    string = stretched(T, L, m, EA, d=0.2, Can=0.8, Cat=0.3)
    scene = level(string, L, water=Water(density=1000.0) if wet else None)
    h, k = L / N, np.arange(1, N)
    added = 1000.0 * math.pi / 4 * 0.2**2 * (1 + T / EA) ** -1 if wet else 0.0
    wave = 2 / h * np.sin(k * math.pi / (2 * N))
    found = modes(scene, N, axis=1)
    np.testing.assert_allclose(found, wave * math.sqrt(T / (m + 0.8 * added)), rtol=1e-8)
    along = modes(scene, N, axis=0)
    np.testing.assert_allclose(along, wave * math.sqrt(EA * (1 + T / EA) / (m + 0.3 * added)), rtol=1e-8)


def test_tensioned_beam_is_exact() -> None:
    """Pinned.

    Omega_k^2 = 4 T s^2/(m h^2) + 16 EI s^4/(m h^4), s = sin(k pi/2N), for every k but those that the end's
    joint alters: none, a pin has no joint. To 1e-8; the first three as given, to their last digit.
    """
    T, EI, m, L, N = 5e4, 1e5, 100.0, 10.0, 20
    beam = stretched(T, L, m, 1e9, EI=EI)
    h, s = L / N, np.sin(np.arange(1, N) * math.pi / (2 * N))
    exact = np.sqrt(4 * T * s**2 / (m * h**2) + 16 * EI * s**4 / (m * h**4))
    np.testing.assert_allclose(exact[:3], [7.67773162, 18.68378091, 34.58709124], atol=6e-9)
    for axis, scene in ((1, level(beam, L)), (1, in_space(level(beam, L))), (2, in_space(level(beam, L)))):
        np.testing.assert_allclose(modes(scene, N, axis), exact, rtol=1e-8)


def test_tensioned_beam_converges() -> None:
    """The same beam against the continuum, 7.68693249, 18.79485658, 35.11617626 rad/s: order 2."""
    beam = stretched(5e4, 10.0, 100.0, 1e9, EI=1e5)
    exact = [7.68693249, 18.79485658, 35.11617626]
    errors = np.array([modes(level(beam, 10.0), n, axis=1)[:3] - exact for n in (20, 40, 80)])
    for column in errors.T:
        assert_second_order(list(column))


# ------------------------------------------------------------------------------------ strings with weight


def test_hanging_chain() -> None:
    """L = 1 m, g = 9.81: omega_k = j_0k/2 sqrt(g/L) = 3.76606739, 8.64469611, 13.55213578 rad/s; order 2.

    EA = 1e7 times the weight stretches it by 1e-7. Hung by its upper end B, and by A with the slope turned.
    """
    exact = jn_zeros(0, 3) / 2 * math.sqrt(9.81)
    np.testing.assert_allclose(exact, [3.76606739, 8.64469611, 13.55213578], atol=6e-9)
    chain = Section(length=1.0, d=0.01, mass=1.0, EA=1e8)
    pin, free = End(kind="pinned", position=(0.0, 0.0, 0.0)), End(kind="free")
    for ends in ({"end_a": free, "end_b": pin}, {"end_a": pin, "end_b": free}):
        scene = Scene(cable=(chain,), g=9.81, **ends)
        errors = np.array([modes(scene, n, axis=0)[:3] - exact for n in (40, 80, 160)])
        for column in errors.T:
            assert_second_order(list(column), 1.9, 2.1)
        np.testing.assert_allclose(errors[-1] / exact, 0.0, atol=1e-3)


def test_heavy_vertical_string() -> None:
    """T = Tb + w z, pinned at both ends, Tb = w = m = L = 1: 3.78651169, 7.58157534, 11.37477503 rad/s.

    Order 2. Exactly, J0(a) Y0(b) = J0(b) Y0(a) with a, b = 2 omega sqrt(T)/w... at T = 1 and 2. EA = 1e6
    keeps strain at 1e-6.
    """

    def frequency(x: float) -> float:
        a, b = 2 * x, 2 * x * math.sqrt(2.0)
        return float(jv(0, a) * yv(0, b) - jv(0, b) * yv(0, a))

    known = [3.78651169, 7.58157534, 11.37477503]
    exact = [brentq(frequency, x - 0.1, x + 0.1, xtol=1e-13) for x in known]
    np.testing.assert_allclose(exact, known, atol=6e-9)
    EA = 1e7
    string = Section(length=1.0, d=0.01, mass=1.0, EA=EA)
    top = 1.0 + (1.0 + 0.5) / EA
    scene = Scene(
        cable=(string,),
        g=1.0,
        end_a=End(kind="pinned", position=(0.0, 0.0, 0.0)),
        end_b=End(kind="pinned", position=(0.0, 0.0, top)),
    )
    errors = np.array([modes(scene, n, axis=0)[:3] - exact for n in (20, 40, 80)])
    for column in errors.T:
        assert_second_order(list(column), 1.9, 2.1)


IRVINE = {1.0: 1.040200, 4.0: 1.151823, 4 * math.pi**2: 2.0, 1000.0: 2.848264}


def sagging(square: float, w: float) -> tuple[Scene, float, float]:
    """A level span of 1 with H = 1 and m g = w, Irvine's lambda^2 = `square`.

    With H and the true lambda^2.
    """
    EA = square * (1 + w**2 / 8) / w**2
    length = brentq(lambda L: catenary(1.0, 0.0, L, w, EA)[0] - 1.0, 0.9, 1.02, xtol=1e-15)
    cable = Section(length=length, d=0.001, mass=1.0, EA=EA)
    scene = Scene(
        cable=(cable,),
        g=w,
        end_a=End(kind="pinned", position=(0.0, 0.0, 0.0)),
        end_b=End(kind="pinned", position=(1.0, 0.0, 0.0)),
    )
    return scene, 1.0, square


@pytest.mark.parametrize("square", IRVINE)
def test_irvine_sagging_cable(square: float) -> None:
    """First symmetric mode in the plane, omega l/pi sqrt(m/H): tan(w/2) = w/2 - (4/lambda^2) (w/2)^3.

    Sag 1/160 of the span leaves (mgl/H)^2 = 2.5e-3 in the theory; lambda^2 = 1 has a strain of 2.5e-3: 0.2 %,
    not the 0.5 % that is asked. Antisymmetric modes stay at 2: the crossover.
    """
    theory = IRVINE[square]
    x = theory * math.pi / 2
    if square != 4 * math.pi**2:
        assert math.tan(x) == pytest.approx(x - 4 / square * x**3, rel=1e-3)
    scene, *_ = sagging(square, 0.05)
    model = LumpedModel(scene, 200)
    K, M, free = matrices(model)
    squares, shapes = eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], subset_by_index=[0, 3])
    ratio = np.sqrt(squares) / math.pi
    upward = shapes[1::2]  # free dofs are x, z in turn
    symmetric = np.abs(upward + upward[::-1]).max(axis=0) > np.abs(upward - upward[::-1]).max(axis=0)
    assert ratio[symmetric][0] == pytest.approx(theory, rel=2e-3)
    assert ratio[~symmetric][0] == pytest.approx(2.0, rel=2e-3)


def test_sagging_cable_swings_out_of_its_plane() -> None:
    """Out of the plane the sag does not stiffen.

    Omega l sqrt(m/H) = pi, to (mgl/H)^2 = 2.5e-3 (1e-3 seen).
    """
    scene, *_ = sagging(1000.0, 0.05)
    assert modes(in_space(scene), 100, axis=1)[0] == pytest.approx(math.pi, rel=1e-3)


# ------------------------------------------------------------------------------------ beams and their ends


def hermite(
    lengths: np.ndarray, EI: np.ndarray, m: np.ndarray, T: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """K and M of a tensioned Euler-Bernoulli beam, cubic elements; dofs (y, slope) per node."""
    n = 2 * (len(lengths) + 1)
    K, M = np.zeros((n, n)), np.zeros((n, n))
    for e, (l, stiff, mass) in enumerate(zip(lengths, EI, m, strict=True)):
        at = slice(2 * e, 2 * e + 4)
        K[at, at] += (stiff / l**3) * np.array(
            [
                [12, 6 * l, -12, 6 * l],
                [6 * l, 4 * l * l, -6 * l, 2 * l * l],
                [-12, -6 * l, 12, -6 * l],
                [6 * l, 2 * l * l, -6 * l, 4 * l * l],
            ]
        )
        K[at, at] += (T / (30 * l)) * np.array(
            [
                [36, 3 * l, -36, 3 * l],
                [3 * l, 4 * l * l, -3 * l, -l * l],
                [-36, -3 * l, 36, -3 * l],
                [3 * l, -l * l, -3 * l, 4 * l * l],
            ]
        )
        M[at, at] += (mass * l / 420) * np.array(
            [
                [156, 22 * l, 54, -13 * l],
                [22 * l, 4 * l * l, 13 * l, -3 * l * l],
                [54, 13 * l, 156, -22 * l],
                [-13 * l, -3 * l * l, -22 * l, 4 * l * l],
            ]
        )
    return K, M


def test_finite_elements_are_right() -> None:
    """The reference elements of this file: pinned tensioned beam, 40 of them, to (kh)^4/720 = 2e-6."""
    K, M = hermite(np.full(40, 0.25), np.full(40, 1e5), np.full(40, 100.0), 5e4)
    free = np.setdiff1d(np.arange(len(K)), [0, 80])
    found = np.sqrt(eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], eigvals_only=True))
    np.testing.assert_allclose(found[:3], [7.68693249, 18.79485658, 35.11617626], rtol=2e-6)


BETA = {
    "clamped": (4.7300407449, 7.8532046241, 10.9956078380),
    "propped": (3.9266023120, 7.0685827456, 10.2101761228),
    "cantilever": (1.8751040687, 4.6940911330, 7.8547574382),
}


@pytest.mark.parametrize("ends", BETA)
def test_beam_with_clamped_ends(ends: str) -> None:
    """Euler-Bernoulli, omega = (beta L)^2 sqrt(EI/m L^4): the clamp's half-segment joint keeps order 2."""
    beam = Section(length=2.0, d=0.01, mass=3.0, wet_weight=0.0, EA=1e6, EI=50.0)
    clamp = End(kind="clamped", position=(0.0, 0.0, 0.0), direction=(1.0, 0.0, 0.0))
    other = {
        "clamped": replace(clamp, position=(2.0, 0.0, 0.0)),
        "propped": End(kind="pinned", position=(2.0, 0.0, 0.0)),
        "cantilever": End(kind="free"),
    }[ends]
    exact = np.array(BETA[ends]) ** 2 * math.sqrt(50.0 / (3.0 * 2.0**4))
    scene = Scene(cable=(beam,), end_a=clamp, end_b=other, g=0.0)
    errors = np.array([modes(scene, n, axis=1)[:3] - exact for n in (40, 80, 160)])
    for column in errors.T:
        assert_second_order(list(column), 1.9, 2.1)
    assert np.abs(errors[-1] / exact).max() < 2e-3


PARTS = (
    Section(length=1.0, d=0.01, mass=2.0, wet_weight=0.0, EA=1e7, EI=30.0),
    Section(length=0.75, d=0.01, mass=8.0, wet_weight=0.0, EA=1e7, EI=90.0),
    Section(length=1.25, d=0.01, mass=1.0, wet_weight=0.0, EA=1e7, EI=15.0),
)


def test_beam_of_sections() -> None:
    """Three sections clamped at both ends against finite elements.

    Joints in series keep order 2 where EI jumps.
    """
    lengths = np.repeat([x.length / 20 for x in PARTS], 20)
    K, M = hermite(lengths, np.repeat([x.EI for x in PARTS], 20), np.repeat([x.mass for x in PARTS], 20))
    inner = slice(2, len(K) - 2)
    exact = np.sqrt(eigh(K[inner, inner], M[inner, inner], eigvals_only=True))[:3]
    errors = np.array([modes(level(PARTS, 3.0, clamped=True), n, axis=1)[:3] - exact for n in (24, 48, 96)])
    for column in errors.T:
        assert_second_order(list(column), 1.85, 2.15)
    assert np.abs(errors[-1] / exact).max() < 3e-3


# ------------------------------------------------------------------------------------ rods


def rigid_span(T: float, device: float) -> np.ndarray:
    """Frequencies of a pinned tensioned beam, L = 6, EI = 200, m = 4, whose span from 1.5 to 2.5 is rigid and
    carries a point mass at its middle: the span's element follows from its two ends' motion as a rigid
    body's.
    """
    lengths = np.concatenate([np.full(30, 0.05), [1.0], np.full(70, 0.05)])
    K, M = hermite(lengths, np.full(101, 200.0), np.full(101, 4.0), T)
    middle = np.array([0.5, 1 / 8, 0.5, -1 / 8])
    at = slice(60, 64)
    M[at, at] += device * np.outer(middle, middle)
    n = len(K)
    tie = np.zeros((n, n - 2))
    tie[:62, :62] = np.eye(62)  # y and slope at the span's left end stand for the whole span
    tie[62, 60], tie[62, 61], tie[63, 61] = 1.0, 1.0, 1.0
    tie[64:, 62:] = np.eye(n - 64)
    K, M = tie.T @ K @ tie, tie.T @ M @ tie
    free = np.setdiff1d(np.arange(n - 2), [0, n - 4])
    return np.sqrt(eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], eigvals_only=True))[:4]


@pytest.mark.parametrize("T", [0.0, 300.0])
@pytest.mark.parametrize("device", [1e-9, 7.0])
def test_rod_in_a_beam(T: float, device: float) -> None:
    """A rod of 1 m in a pinned beam of 6 m is a rigid span that carries moments: finite elements, order 2.

    Without the rod's stiffness some frequency would be lower by more than 10 %. In the plane and out of it.
    """
    EA = 3e7
    e = 1 + T / EA
    beam = Section(length=6.0 / e, d=0.1, mass=4.0 * e, wet_weight=0.0, EA=EA, EI=200.0 / e)
    rod = PointMass(s=2.0 / e, mass=device, volume=0.0, rod=1.0 / e)
    scene = level(beam, 6.0, devices=(rod,))
    exact = rigid_span(T, device)
    errors = np.array([modes(scene, n, axis=1)[:4] - exact for n in (24, 48, 96)])
    for column in errors.T:
        assert_second_order(list(column), 1.85, 2.15)
    assert np.abs(errors[-1] / exact).max() < 2e-3
    point = replace(rod, rod=None)
    assert (modes(level(beam, 6.0, devices=(point,)), 96, axis=1)[:4] / exact).min() < 0.9
    np.testing.assert_allclose(
        modes(in_space(scene), 24, axis=1)[:4], modes(scene, 24, axis=1)[:4], rtol=1e-9
    )


@pytest.mark.parametrize("wet", [False, True], ids=["air", "water"])
def test_rod_on_two_strings(wet: bool) -> None:
    """A slender rod between two light strings of length l under T.

    It heaves at 2T/(m L l) and turns at (6/l + 12/L) T/(m L), its rotary inertia being m L^3/12; exact, one
    segment for each string. No moment passes a joint between a rod and a cable without EI. In water the rod's
    normal added mass counts.
    """
    T, L, l, m, EA = 2e3, 1.2, 0.5, 15.0, 2e8
    e = 1 + T / EA
    light = Section(length=l / e, d=1e-6, mass=1e-9, wet_weight=0.0, EA=EA)
    heavy = Section(length=L / e, d=0.1, mass=m * e, wet_weight=0.0, EA=EA, Can=0.9)
    rod = PointMass(s=(l + L / 2) / e, mass=1e-9, volume=0.0, rod=L / e)
    scene = level((light, heavy, light), 2 * l + L, devices=(rod,), water=Water() if wet else None)
    inertia = m * L + (0.9 * 1025.0 * math.pi / 4 * 0.1**2 * L / e if wet else 0.0)
    exact = np.sqrt([2 * T / (inertia * l), (6 / l + 12 / L) * T / inertia])
    np.testing.assert_allclose(modes(scene, 3, axis=1), exact, rtol=1e-6)


def test_device_on_a_rod_adds_no_rotary_inertia() -> None:
    """A point mass at a rod's middle slows the heave of the same rod, by sqrt(1 + M/m L), not its turning."""
    T, L, l, m, EA = 2e3, 1.2, 0.5, 15.0, 2e8
    e = 1 + T / EA
    light = Section(length=l / e, d=1e-6, mass=1e-9, wet_weight=0.0, EA=EA)
    heavy = Section(length=L / e, d=0.1, mass=m * e, wet_weight=0.0, EA=EA)

    def found(mass: float) -> np.ndarray:
        rod = PointMass(s=(l + L / 2) / e, mass=mass, volume=0.0, rod=L / e)
        return modes(level((light, heavy, light), 2 * l + L, devices=(rod,)), 3, axis=1)

    np.testing.assert_allclose(found(9.0) / found(1e-9), [1 / math.sqrt(1 + 9.0 / (m * L)), 1.0], rtol=1e-9)


def test_point_mass_on_a_string() -> None:
    """A mass M amid a taut string: cot(x/2) = (M/2 m L) x, x = omega L sqrt(m/T) (symmetric modes); order 2.

    The antisymmetric ones, x = 2 k pi, do not see it: exact on the mesh.
    """
    T, L, m, M = 1e4, 8.0, 2.0, 10.0
    string = stretched(T, L, m, 1e9)
    scene = level(string, L, devices=(PointMass(s=string.length / 2, mass=M, volume=0.0),))

    def balance(y: float) -> float:
        return math.cos(y / 2) - M / (2 * m * L) * y * math.sin(y / 2)

    unit = math.sqrt(T / m) / L
    exact = [
        brentq(balance, lo, hi, xtol=1e-13) * unit for lo, hi in ((0.1, math.pi), (2 * math.pi, 3 * math.pi))
    ]
    errors = []
    for n in (20, 40, 80):
        seen = modes(scene, n, axis=1)
        errors.append(seen[[0, 2]] - exact)
        swing = 2 * n * math.sin(math.pi / n) * unit
        assert seen[1] == pytest.approx(swing, rel=1e-8)
    for column in np.array(errors).T:
        assert_second_order(list(column))


def test_buoy_adds_its_added_mass_and_not_its_volume() -> None:
    """A body's inertia is mass and added mass; its displaced volume only lifts.

    Heavy light string, rigid mass mode.
    """
    T, l, EA = 2e3, 0.5, 2e8
    e = 1 + T / EA
    light = Section(length=2 * l / e, d=1e-6, mass=1e-9, wet_weight=0.0, EA=EA)
    for volume in (0.0, 0.02):
        buoy = PointMass(kind="buoy", s=l / e, mass=6.0, added_mass=5.0, volume=volume)
        found = modes(level(light, 2 * l, devices=(buoy,), water=Water()), 2, axis=1)
        np.testing.assert_allclose(found, math.sqrt(2 * T / (11.0 * l)), rtol=1e-6)
