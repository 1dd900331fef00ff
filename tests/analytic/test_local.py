"""The local line (papers 000, 002, corrected) against closed forms, the papers' own variables and the lumped line."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq

from solvers import MODELS, Ask, Current, End, Harmonic, Motion, Response, Scene, Section, Status, Water, Window, solve
from solvers.catalogue import static_state
from solvers.catenary import catenary
from solvers.dispatch import call_drive, call_tangent
from solvers.lines.local import LocalModel
from solvers.lines.lumped import LumpedModel


def full(J: np.ndarray, bw: int) -> np.ndarray:
    """Band storage J[i, bw + j - i] as a square matrix."""
    rows, cols = np.indices(J.shape)
    cols = rows + cols - bw
    inside = (cols >= 0) & (cols < len(J))
    square = np.zeros((len(J), len(J)))
    square[rows[inside], cols[inside]] = J[inside]
    return square


def matrices(model: Any, q: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """K and M at rest, of the free dofs; a stiffness with an energy is symmetric."""
    q, zero = np.zeros(model.ndof) if q is None else q, np.zeros(model.ndof)
    free = np.setdiff1d(np.arange(model.ndof), model.pack.fixed)
    found = []
    for cq, ca in ((1.0, 0.0), (0.0, 1.0)):
        J = np.zeros((model.ndof, 2 * model.pack.bw + 1))
        call_tangent(0.0, q, zero, zero, cq, 0.0, ca, model.pack, J)
        A = full(J, model.pack.bw)
        assert np.abs(A - A.T).max() <= 1e-12 * np.abs(A).max()
        found.append(A[np.ix_(free, free)])
    return found[0], found[1]


def modes(model: Any, kind: int | None = None) -> np.ndarray:
    """Natural angular frequencies, of the dofs along (0) or across (1) a straight line alone if asked."""
    K, M = matrices(model)
    if kind is not None:
        assert np.abs(K[0::2, 1::2]).max() <= 1e-8 * np.abs(K).max()
        K, M = K[kind::2, kind::2], M[kind::2, kind::2]
    return np.sqrt(eigh(K, M, eigvals_only=True))


def top(response: Response) -> np.ndarray:
    """Size of the force on end B [N]."""
    return np.linalg.norm(response.signals["end_force"][:, 1], axis=1)


def orders(errors: Any) -> np.ndarray:
    e = np.abs(np.array(errors))
    return np.log2(e[:-1] / e[1:])


# ------------------------------------------------------------------------------------------------- statics

OC3 = Section(
    length=902.2, d=0.09, mass=77.7066, EA=3.84243e8, EI=380.0, BA=3.84243e5, wet_weight=698.094, Cdn=1.6,
    Cdt=1.6 / math.pi, compression=False,
)  # fmt: skip


def surge(x: float, period: float, ramp: float) -> Motion:
    return Motion(
        harmonics=(Harmonic(amplitude=(x, 0, 0), frequency=1 / period, phase=math.pi / 2),),
        window=Window(ramp_up=ramp, shape="smooth"),
    )


def oc3_hung(EA: float = 3.84243e7, x: float = 5.0) -> Scene:
    """Reference 27: the whole line free of the bed."""
    cable = Section(
        length=902.2, d=0.09, mass=77.7066, EA=EA, BA=3.84243e5, Cdn=1.6, Cdt=1.6 / math.pi, compression=False
    )
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, -320)), water=Water(),
        end_b=End(kind="pinned", position=(848.67, 0, -70), motion=surge(x, 15.0, 30.0)),
    )  # fmt: skip


def oc3_touchdown(EI: float = 380.0) -> tuple[Scene, float, float]:
    """The suspended part of the OC3 line on its bed, lower end at the touchdown point, with the catenary's H and V."""
    H, V = catenary(848.67, 250.0, 902.2, 698.094, 3.84243e8, bed=True)
    resting = 902.2 - V / 698.094
    cable = replace(OC3, length=902.2 - resting, EI=EI)
    foot = resting * (1 + H / OC3.EA)
    scene = Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(foot, 0, -320)), water=Water(depth=320.0),
        end_b=End(kind="pinned", position=(848.67, 0, -70)),
    )  # fmt: skip
    return scene, H, V


def jumper(EI: float = 120.8e3) -> Scene:
    """Low and Langley (2006), hanging flexible jumper; surge of 10 m at 27 s."""
    cable = Section(length=170.0, d=0.396, mass=165.0, EA=5e8, EI=EI, BA=5e4, Cdn=1.0)
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(-100, 0, -55)), g=9.807, water=Water(density=1000.0),
        end_b=End(kind="pinned", position=(0, 0, -5), motion=surge(10.0, 27.0, 27.0)),
    )  # fmt: skip


def at_rest(scene: Scene, segments: int) -> Response:
    run = solve(scene, Ask(model="local", segments=segments))
    assert run.status == Status.OK, run.message
    return run


def test_oc3_hung_converges_to_the_catenary() -> None:
    """Reference 27's line at rest: 781.710 kN at the fairlead (elastic catenary). Order 2 within 0.02: h^2 alone."""
    errors = [top(at_rest(oc3_hung(), n))[0] - 781710.195 for n in (25, 50, 100, 200, 408)]
    seen = orders(errors[:4])
    assert np.all(np.abs(seen - 2.0) < 0.02), seen
    assert abs(errors[-1]) < 2.0  # 0.34 kN at 25 segments, by h^2


def test_oc3_touchdown_converges_to_the_catenary() -> None:
    """The suspended part of the OC3 line, frictionless bed: H 736.938, V 535.727, T 911.088 kN, 134.786 m on the bed.

    1e-4 as published, order 2 within 0.05 (EI = 380 N m2 moves the forces by less than 1 N).
    """
    scene, H, V = oc3_touchdown()
    assert 902.2 - scene.length == pytest.approx(134.786, abs=1e-3)
    errors = []
    for n in (25, 50, 100, 200):
        force = at_rest(scene, n).signals["end_force"][0, 1]
        errors.append([force[0] - H, force[2] - V, math.hypot(force[0], force[2]) - math.hypot(H, V)])
    seen = np.array([orders(column) for column in np.array(errors).T])
    assert np.all(np.abs(seen - 2.0) < 0.05), seen
    found = force[0], force[2], math.hypot(force[0], force[2])
    np.testing.assert_allclose(found, [736938, 535727, 911088], rtol=1e-4)


def test_jumper_at_rest() -> None:
    """Low and Langley's jumper: the elastic catenary's five forces with order 2 within 0.02 for EI = 0; OrcaFlex's with
    bending, to half a unit of their last digit (without bending H is 11.47 kN)."""
    w = (165.0 - 1000.0 * math.pi / 4 * 0.396**2) * 9.807
    H, V = catenary(100.0, 50.0, 170.0, w, 5e8)
    exact = np.array([math.hypot(H, V), V, H, math.hypot(H, w * 170 - V), w * 170 - V]) / 1e3
    np.testing.assert_allclose(exact, [47.1395, 45.7222, 11.4723, 26.6263, 24.0280], atol=5e-5)

    def forces(EI: float, n: int) -> np.ndarray:
        a, b = LocalModel(jumper(EI), n).rest.end_force
        return np.array([np.hypot(*b), b[1], b[0], np.hypot(*a), a[1]]) / 1e3

    errors = np.array([forces(0.0, n) - exact for n in (20, 40, 80, 160)])
    for column in errors.T:
        assert np.all(np.abs(orders(column) - 2.0) < 0.02)
    found = forces(120.8e3, 160)
    for value, published, digit in zip(
        found, [47.11, 45.71, 11.40, 26.6, 24.04], [0.01, 0.01, 0.01, 0.1, 0.01], strict=True
    ):
        assert abs(value - published) <= 0.501 * digit
    steps = np.diff([forces(120.8e3, n)[2] for n in (20, 40, 80, 160)])
    assert np.all(np.abs(orders(steps) - 2.0) < 0.1)  # with bending too


def test_steady_current_is_a_small_motion() -> None:
    """A weak current's drag is carried by the line itself: end forces change as those of the lumped line, to 2 % of the
    change (its square, and (1 + es), are dropped)."""
    scene = replace(
        oc3_hung(3.84243e8),
        water=Water(current=Current(z=(-320, 0), velocity=((0.0, 0, 0), (0.4, 0, 0)))),
        end_b=End(kind="pinned", position=(848.67, 0, -70)),
    )
    still = replace(scene, water=Water())
    change = []
    for model in ("local", "lumped"):
        runs = [solve(s, Ask(model=model, segments=60)) for s in (scene, still)]
        assert all(run.status == Status.OK for run in runs)
        change.append(runs[0].signals["end_force"][0] - runs[1].signals["end_force"][0])
    assert np.abs(change[1]).max() > 500.0
    np.testing.assert_allclose(change[0], change[1], atol=0.02 * np.abs(change[1]).max())


def test_the_unresolved_boundary_layer_is_told() -> None:
    """At pinned ends bending decays over sqrt(EI/T), here 2 cm: told, and the run is OK."""
    status, note, _ = LocalModel(oc3_touchdown()[0], 100).guards(np.zeros(0))
    assert status == Status.OK
    assert "bending decays over 0.02 m at the ends" in note
    assert LocalModel(oc3_touchdown(EI=0.0)[0], 100).guards(np.zeros(0))[1] == ""


# ------------------------------------------------------------------------------------------------- frequencies


def level(tension: float = 5e4, w: float = 0.0, **section: float) -> Scene:
    """A straight line along x with next to no weight."""
    cable = Section(**{"length": 10.0, "d": 0.1, "mass": 100.0, "EA": 1e9, "wet_weight": w, **section})
    span = cable.length * (1 + tension / cable.EA)
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, -3)), end_b=End(kind="pinned", position=(span, 0, -3))
    )  # fmt: skip


@pytest.mark.parametrize("w", [0.0, 1e-3])
def test_taut_string_and_bar(w: float) -> None:
    """omega_k = (2/h) sqrt(T/m) sin(k pi/2N) across, with EA along: exactly (1e-9), for no and a tiny weight."""
    N, k = 20, np.arange(1, 20)
    model = LocalModel(level(w=w), N)
    sines = 2 / 0.5 * np.sin(k * math.pi / (2 * N))
    assert modes(model, 1) == pytest.approx(sines * math.sqrt(5e4 / 100), rel=1e-9)
    assert modes(model, 0) == pytest.approx(sines * math.sqrt(1e9 / 100), rel=1e-9)
    assert model.fastest(np.zeros(0))["axial"] == pytest.approx(4 * math.sqrt(1e9 / 100), rel=1e-12)
    assert model.fastest(np.zeros(0))["tension"] == pytest.approx(4 * math.sqrt(5e4 / 100), rel=1e-6)


def test_tensioned_beam() -> None:
    """omega_k^2 = 4 T s^2/(m h^2) + 16 EI s^4/(m h^4), s = sin(k pi/2N), exactly: 1e-8 tells a bug in EI from h^2.

    L = 10, m = 100, T = 5e4, EI = 1e5, N = 20: 7.67773162, 18.68378091, 34.58709124 rad/s. The strain of 5e-5 of
    EA = 1e9 does not enter: the papers drop (1 + es).
    """
    found = modes(LocalModel(level(EI=1e5), 20), 1)
    assert found[:3] == pytest.approx([7.67773162, 18.68378091, 34.58709124], rel=1e-8)


def test_heavy_vertical_string() -> None:
    """T = Tb + w z, Tb = w = m = L = 1, pinned: 3.78651169, 7.58157534, 11.37477503 rad/s, order 2 within 0.05."""
    errors = []
    for n in (40, 80, 160):
        EA = 1e7
        cable = Section(length=1.0, d=1e-3, mass=1.0, EA=EA, wet_weight=1.0)
        ends = [End(kind="pinned", position=(0, 0, z)) for z in (0.0, 1.0 + 1.5 / EA)]
        scene = Scene(cable=(cable,), end_a=ends[0], end_b=ends[1])
        model = LocalModel(scene, n)
        errors.append(modes(model, 1)[:3] - [3.78651169, 7.58157534, 11.37477503])
    for column in np.array(errors).T:
        assert np.all(np.abs(orders(column) - 2.0) < 0.05)


WIDE = 0.99  # accuracy asked: these runs show what small motion does outside its range too
IRVINE = {1.0: 1.040200, 4.0: 1.151823, 4 * math.pi**2: 2.0, 1000.0: 2.848264}


@pytest.mark.parametrize("square", IRVINE)
def test_irvine_sagging_cable(square: float) -> None:
    """First symmetric mode of a sagged cable, sag 1/160: Irvine's omega/pi to 0.5 % (strain 2.5e-3 at lambda^2 = 1,
    (mgl/H)^2 = 2.5e-3); antisymmetric modes stay at 2: the crossover."""
    w = 0.05
    EA = square * (1 + w**2 / 8) / w**2
    length = brentq(lambda L: catenary(1.0, 0.0, L, w, EA)[0] - 1.0, 0.9, 1.02, xtol=1e-15)
    scene = Scene(
        cable=(Section(length=length, d=0.001, mass=1.0, EA=EA),), g=w,
        end_a=End(kind="pinned", position=(0, 0, 0)), end_b=End(kind="pinned", position=(1, 0, 0)),
    )  # fmt: skip
    squares, shapes = eigh(*matrices(LocalModel(scene, 200)), subset_by_index=[0, 3])
    ratio, across = np.sqrt(squares) / math.pi, shapes[1::2]
    symmetric = np.abs(across + across[::-1]).max(axis=0) > np.abs(across - across[::-1]).max(axis=0)
    assert ratio[symmetric][0] == pytest.approx(IRVINE[square], rel=5e-3)
    assert ratio[~symmetric][0] == pytest.approx(2.0, rel=5e-3)


def test_no_checkerboard() -> None:
    """The staggered grid has no mode without stiffness, and the shortest waves are the stiffest: the highest axial
    frequency is 2 c/ds, twice that of collocated differences, where the sawtooth has frequency zero."""
    model = LocalModel(oc3_hung(), 100)
    K, M = matrices(model)
    squares, shapes = eigh(K, M)
    assert math.sqrt(squares[0]) > 0.5  # the first mode of the sagged line [rad/s]
    c, ds = math.sqrt(3.84243e7 / 77.7066), 9.022
    assert math.sqrt(squares[-1]) == pytest.approx(2 * c / ds, rel=1e-3)
    sign = np.sign(shapes[0::2, -1])
    assert np.all(sign[1:] == -sign[:-1])  # the sawtooth itself is the highest mode
    assert math.sqrt(squares[-1]) <= model.fastest(np.zeros(0))["axial"] * (1 + 1e-3)


# ------------------------------------------------------------------------------------------------- the lumped line


def lumped_modes(scene: Scene, segments: int) -> np.ndarray:
    model = LumpedModel(scene, segments)
    status, q, note = static_state(model)
    assert status == Status.OK, note
    return np.sqrt(eigh(*matrices(model, q), eigvals_only=True))


@pytest.mark.parametrize("EA", [3.84243e8, 3.84243e7])
def test_modes_are_those_of_the_lumped_line(EA: float) -> None:
    """With the factors (1 + es) it is the linearised lumped line: 50 modes to 1e-6. As the papers have it, without
    them, it is stiff across by es, so frequencies are high by es/2, and no more than es (2e-3; 2e-2 for the misprint).
    """
    scene = replace(oc3_hung(EA), water=Water(density=1025.0))
    wanted = lumped_modes(scene, 50)[:50]
    exact = modes(LocalModel(scene, 50, stretched=True))[:50]
    np.testing.assert_allclose(exact, wanted, rtol=1e-6)
    printed = LocalModel(scene, 50)
    es = float((printed.rest.T / EA).max())
    off = modes(printed)[:50] / wanted - 1
    assert np.all((off > -0.1 * es) & (off < 1.1 * es))
    assert off.max() > 0.3 * es


def use(stretched: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `local` keep the factors (1 + es), or drop them as the papers do."""
    monkeypatch.setitem(MODELS, "local", MODELS["local"]._replace(build=partial(LocalModel, stretched=stretched)))


def difference(x: float, stretched: bool, monkeypatch: pytest.MonkeyPatch, EA: float = 3.84243e7) -> float:
    """rms difference of settled end tension, local less lumped, over the rms of its change from rest."""
    use(stretched, monkeypatch)
    T = []
    for model in ("local", "lumped"):
        ask = Ask(accuracy=WIDE, duration=75.0, segments=40, interval=0.1, model=model, method="dopri5", tolerance=1e-6)
        run = solve(oc3_hung(EA, x), ask)
        assert run.status == Status.OK, run.message
        T.append((top(run) - top(run)[0])[run.t >= 45.0])
    return float(np.sqrt(((T[0] - T[1]) ** 2).mean() / (T[1] ** 2).mean()))


def test_small_motion_is_that_of_the_lumped_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """OC3 line hung free (misprinted EA), fairlead surge of 0.0125, 0.05, 0.2 m at 15 s: the relative difference of the
    settled tension falls linearly with the amplitude, for the dropped terms are of second order (within 0.1; 4e-4 to
    6e-3 seen). As the papers have it, without (1 + es), it stays at a floor of the order of es = 0.02 (0.031 seen)."""
    exact = [difference(x, True, monkeypatch) for x in (0.0125, 0.05, 0.2)]
    assert exact[0] < 8e-4
    assert np.all(np.abs(np.log(np.array(exact[1:]) / exact[:-1]) / math.log(4) - 1) < 0.1), exact
    assert 0.01 < difference(0.05, False, monkeypatch) < 0.05


# ------------------------------------------------------------------------------------------------ the papers' variables


def short_line(**change: Any) -> Scene:
    """A sagged cable with bending that the mesh resolves, drag, current and damping."""
    cable = Section(length=40.0, d=0.1, mass=20.0, EA=2e6, EI=3e4, BA=2e3, Cdn=1.2, Cdt=0.1)
    motion = Motion(
        harmonics=(Harmonic(amplitude=(0.3, 0, 0.2), frequency=0.5),), window=Window(ramp_up=2.0, shape="smooth")
    )
    fields: dict[str, Any] = {
        "cable": (cable,), "end_a": End(kind="pinned", position=(0, 0, -25)),
        "end_b": End(kind="pinned", position=(32.0, 0, -5), motion=motion),
        "water": Water(current=Current(z=(-25, 0), velocity=((0.1, 0, 0), (0.3, 0, 0)))),
    }  # fmt: skip
    return Scene(**{**fields, **change})


class Printed:
    """The semi-discrete equations for (u, v, e, phi) as printed, on a staggered grid: u, v at nodes, e, phi between."""

    def __init__(self, scene: Scene, segments: int, shear: float) -> None:
        """`shear` = 1 adds the term -Qs e of the balance of moments, which the papers drop and the line keeps."""
        model = self.model = LocalModel(scene, segments)
        cable = self.cable = scene.cable[0]
        self.ds = ds = cable.length / segments
        self.T, phis, node = model.rest.T, model.rest.angle, model.angle
        self.W = cable.wet(scene.density, scene.g)
        self.k1 = np.concatenate([[0.0], np.diff(phis) / ds, [0.0]])  # phis' at nodes, moment-free ends
        self.k2 = np.diff(self.k1) / ds  # phis'' between nodes
        self.slope = np.diff(node) / ds  # phis' between nodes
        self.c, self.s = np.cos(node), np.sin(node)
        self.shear, self.stream = -shear * cable.EI * self.k2, model.pack.stream
        rho = scene.density
        self.mass = np.array([cable.mass, cable.mass + rho * cable.Can * math.pi / 4 * cable.d**2])
        self.Ct, self.Cn = 0.5 * rho * math.pi * cable.d * cable.Cdt, 0.5 * rho * cable.d * cable.Cdn

    def fairlead(self, t: float) -> tuple[float, float]:
        """Tangential and normal velocity of end B: quintic ramp over 2 s, then 0.5 Hz."""
        x = min(t / 2.0, 1.0)
        f, df = x**3 * (10 - 15 * x + 6 * x * x), 30 * (x * (1 - x)) ** 2 / 2.0
        rate = df * math.sin(math.pi * t) + f * math.pi * math.cos(math.pi * t)
        X, Z = 0.3 * rate, 0.2 * rate
        return X * self.c[-1] + Z * self.s[-1], -X * self.s[-1] + Z * self.c[-1]

    def rate(self, t: float, y: list[np.ndarray]) -> list[np.ndarray]:
        u, v, e, phi = y
        ds, EA, EI = self.ds, self.cable.EA, self.cable.EI
        u, v = u.copy(), v.copy()
        u[0] = v[0] = 0.0
        u[-1], v[-1] = self.fairlead(t)

        def mean(x: np.ndarray) -> np.ndarray:
            return (x[1:] + x[:-1]) / 2

        et = np.diff(u) / ds - self.slope * mean(v)
        phit = np.diff(v) / ds + self.slope * mean(u)
        p1 = np.concatenate([[0.0], np.diff(phi) / ds, [0.0]])  # phi' = 0 at the ends
        p2 = np.diff(p1) / ds
        p3, inner = np.diff(p2) / ds, slice(1, -1)
        turn = self.shear * e
        N, c, s = EA * e + self.cable.BA * et, self.c[inner], self.s[inner]
        ur, vr = (u - self.stream[:, 0])[inner], (v - self.stream[:, 1])[inner]
        thin = np.sqrt(1 + mean(e))
        ut, vt = np.zeros_like(u), np.zeros_like(v)
        ut[inner] = (
            np.diff(N) / ds + EI * (self.k1[inner] * mean(p2) + p1[inner] * mean(self.k2)) - self.W * mean(phi) * c
            + self.k1[inner] * mean(turn) - self.Ct * np.abs(ur) * ur * thin
        ) / self.mass[0]  # fmt: skip
        vt[inner] = (
            -EI * p3 + mean(self.T) * p1[inner] + mean(N) * self.k1[inner] + self.W * mean(phi) * s
            - np.diff(turn) / ds - self.Cn * np.abs(vr) * vr * thin
        ) / self.mass[1]  # fmt: skip
        return [ut, vt, et, phit]

    def run(self, y: list[np.ndarray], until: float, steps: int) -> list[np.ndarray]:
        """RK4; end velocities are written at each stage."""
        h = until / steps
        for n in range(steps):
            t = n * h
            k1 = self.rate(t, y)
            k2 = self.rate(t + h / 2, [a + h / 2 * b for a, b in zip(y, k1, strict=True)])
            k3 = self.rate(t + h / 2, [a + h / 2 * b for a, b in zip(y, k2, strict=True)])
            k4 = self.rate(t + h, [a + h * b for a, b in zip(y, k3, strict=True)])
            y = [
                a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(y, k1, k2, k3, k4, strict=True)
            ]
        return y


def in_frame(model: LocalModel, x: np.ndarray) -> np.ndarray:
    """(nt, n, 3) in world axes as dofs (U, V) of the nodes (nt, ndof)."""
    flat = x @ model.basis.T
    c, s = np.cos(model.angle), np.sin(model.angle)
    return np.stack([flat[..., 0] * c + flat[..., 1] * s, flat[..., 1] * c - flat[..., 0] * s], -1).reshape(len(x), -1)


def gap_to_printed(n: int, shear: float) -> float:
    """Largest difference of u, v, e, phi after 3 s from rest in a current, each over its largest."""
    ask = Ask(accuracy=WIDE, duration=3.0, segments=n, interval=1.5, model="local", method="dopri5", tolerance=1e-8)
    run = solve(short_line(), ask)
    assert run.status == Status.OK, run.message
    printed = Printed(short_line(), n, shear)
    model = printed.model
    home = model.rest.x @ model.basis + model.offset
    e, phi = model.strains(in_frame(model, run.signals["position"] - home))
    w = in_frame(model, run.signals["velocity"])
    zero = np.zeros(n + 1)
    u, v, es, ps = printed.run([zero, zero, e[0], phi[0]], 3.0, 60 * n)
    pairs = ((u[1:-1], w[-1, 2:-2:2]), (v[1:-1], w[-1, 3:-2:2]), (es, e[-1]), (ps, phi[-1]))
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in pairs)


def test_equivalent_to_the_printed_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    """(U, V) against the papers' (u, v, e, phi) with the printed terms (EA e' + EI (..) - W phi cos phis and so on),
    from the static state in a current, by small-step RK4 in the test.

    With the one term that the line adds, -Qs e, they differ by O(ds^2) alone: order 1.77, then 1.88 (within 0.25 of 2:
    the layers at the ends are just resolved). It is worth some 1e-3 of the angle here, where the shear EI phis'' at
    the ends is 16 % of the tension, and nothing without bending.
    """
    use(False, monkeypatch)
    gaps = [gap_to_printed(n, 1.0) for n in (40, 80, 160)]
    assert np.all(np.abs(orders(gaps) - 2.0) < 0.25), gaps
    assert orders(gaps)[1] > orders(gaps)[0]
    assert gaps[-1] < 1e-3
    assert gap_to_printed(160, 0.0) < 2e-3


def test_strains_integrate_the_compatibility_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    """e = U' - V phis', phi = V' + U phis' are e_t = u' - v phis', phi_t = v' + u phis' integrated.

    The same semi-discrete line with e and phi as unknowns beside u and v, marched by RK4 in the test with the line's
    step, gives the line's trajectory after 500 steps: velocities to 1e-9, strains to 1e-6 of the largest (the line
    knows the end's displacement, here it is integrated).
    """
    use(False, monkeypatch)
    h, n = 1e-3, 24
    scene = short_line()
    run = solve(scene, Ask(accuracy=WIDE, duration=0.5, segments=n, interval=0.5, model="local", method="rk4", step=h))
    model = LocalModel(scene, n)
    p = model.pack
    start = in_frame(model, run.signals["position"][:1] - (model.rest.x @ model.basis + model.offset))[0]
    ends = [np.zeros(model.ndof) for _ in range(3)]

    def rate(t: float, w: np.ndarray, e: np.ndarray, phi: np.ndarray) -> list[np.ndarray]:
        call_drive(t, p, *ends)
        w = w.copy()
        w[p.fixed] = ends[1][p.fixed]
        et, phit = model.strains(w)
        along = p.ds * (p.EA * e + p.BA * et - p.Qs * phi)
        M = np.concatenate([[0.0], p.stiff[1:-1] * np.diff(phi), [0.0]])
        across = p.ds * (p.geo * phi - p.Qs * e) - np.diff(M)
        r = np.zeros(model.ndof)
        for m in range(4):
            r[m : m + 2 * n : 2] += along * p.De[:, m] + across * p.Dphi[:, m]
        near = np.concatenate([e[:1], (e[1:] + e[:-1]) / 2, e[-1:]])
        rel = w.reshape(-1, 2) - p.stream
        r += (np.column_stack([p.ct, p.cn]) * np.abs(rel) * rel * np.sqrt(1 + near)[:, None]).ravel()
        a = -r / p.weight
        a[p.fixed] = 0.0
        return [a, et, phit]

    y = [np.zeros(model.ndof), *model.strains(start)]
    for k in range(500):
        t = k * h
        k1 = rate(t, *y)
        k2 = rate(t + h / 2, *(a + h / 2 * b for a, b in zip(y, k1, strict=True)))
        k3 = rate(t + h / 2, *(a + h / 2 * b for a, b in zip(y, k2, strict=True)))
        k4 = rate(t + h, *(a + h * b for a, b in zip(y, k3, strict=True)))
        y = [a + h / 6 * (b + 2 * c + 2 * d + f) for a, b, c, d, f in zip(y, k1, k2, k3, k4, strict=True)]
    found = in_frame(model, run.signals["velocity"][-1:])[0][2:-2]
    np.testing.assert_allclose(y[0][2:-2], found, atol=1e-9 * np.abs(found).max())
    home = model.rest.x @ model.basis + model.offset
    e, phi = model.strains(in_frame(model, run.signals["position"][-1:] - home)[0])
    np.testing.assert_allclose(y[1], e, atol=1e-6 * np.abs(e).max())
    np.testing.assert_allclose(y[2], phi, atol=1e-6 * np.abs(phi).max())


# ------------------------------------------------------------------------------------------------- time


@pytest.mark.parametrize(("share", "stable"), [(0.98, True), (1.02, False)])
def test_rk4_at_its_brink(share: float, stable: bool) -> None:
    """h <= 2.8284/omega_max, omega_max = (2 c/ds) cos(pi/2N) of the axial sawtooth (Courant number 1.414): random
    velocities of 1e-6 m/s stay bounded at 0.98 of it and grow without bound at 1.02, in 4000 steps."""
    N = 40
    scene = replace(level(EA=1e7), water=None)
    omega = 2 / 0.25 * math.sqrt(1e7 / 100) * math.cos(math.pi / (2 * N))
    assert modes(LocalModel(scene, N))[-1] == pytest.approx(omega, rel=1e-9)
    step = share * math.sqrt(8.0) / omega
    ask = Ask(
        accuracy=WIDE, duration=4000 * step, segments=N, interval=100 * step, model="local", method="rk4", step=step,
        perturbation=1e-6,
    )  # fmt: skip
    run = solve(scene, ask)
    speed = np.abs(run.signals["velocity"]).max()
    assert run.t[-1] > 3800 * step or not stable
    assert (speed < 1e-5) if stable else not speed < 1.0


LEDGER = {"dopri5": {}, "rk4": {"step": 1e-3}, "trbdf2": {"tolerance": 2e-6}, "genalpha": {"step": 2e-3}}


@pytest.mark.parametrize("method", LEDGER)
@pytest.mark.parametrize("kind", ["free", "forced", "beam without water"])
def test_energy_ledger_closes(kind: str, method: str) -> None:
    """Work at the ends, lost power and energies agree to 1e-3 of the peak energy, the limit of trust, with bending,
    damping, drag and current, from random velocities or in forced motion. The static forces' work is in none of the
    entries, so the peak is smaller and the test stricter than for a lumped line: TR-BDF2's default of 1e-5 leaves 1e-3.
    """
    scene = short_line()
    still = End(kind="pinned", position=(32.0, 0, -5))
    change: dict[str, Any] = {"method": method, **LEDGER[method]}
    if kind == "free":
        scene = replace(scene, end_b=still)
        change["perturbation"] = 0.3
    if kind == "free" and method in ("trbdf2", "genalpha"):  # all the mesh's axial modes ring: they must be resolved
        change |= {"tolerance": 1e-6} if method == "trbdf2" else {"step": 2e-4, "rho": 1.0}
    if kind == "beam without water":
        scene = replace(scene, water=None)
    run = solve(scene, Ask(accuracy=WIDE, duration=4.0, segments=24, interval=0.05, model="local", **change))
    assert run.status == Status.OK, run.message
    assert run.energy_residual < 1e-3
    if method == "rk4":  # the step is a third of the stability limit: the highest modes ring in the free run
        assert run.energy_residual < (2e-4 if kind == "free" else 1e-5)


@pytest.mark.parametrize(
    ("method", "steps", "order"), [("rk4", (2e-3, 1e-3, 5e-4), 4.0), ("genalpha", (8e-3, 4e-3, 2e-3), 2.0)]
)
def test_energy_ledger_closes_with_the_order_of_the_method(method: str, steps: tuple[float, ...], order: float) -> None:
    """Forced motion with a smooth ramp: the residual falls with the method's order or faster (0.2 less is accepted: the
    largest of a history)."""
    scene = replace(short_line(), water=Water(), cable=(replace(short_line().cable[0], Cdn=0.0, Cdt=0.0),))
    ask = Ask(accuracy=WIDE, duration=4.0, segments=24, interval=0.5, model="local", method=method)
    found = [solve(scene, replace(ask, step=h)).energy_residual for h in steps]
    assert np.all(orders(found) > order - 0.2), found


def test_methods_agree() -> None:
    """One line, three methods: explicit and implicit end forces agree to 1e-3 of their range."""
    forces = []
    settings = {"dopri5": {"tolerance": 1e-6}, "trbdf2": {"tolerance": 1e-7}, "genalpha": {"step": 1e-3}}
    for method, change in settings.items():
        ask = Ask(accuracy=WIDE, duration=6.0, segments=24, interval=0.02, model="local", method=method, **change)
        forces.append(top(solve(short_line(), ask)))
    for other in forces[1:]:
        assert np.abs(other - forces[0]).max() < 1e-3 * np.ptp(forces[0])


# ------------------------------------------------------------------------------------------------- published lines


def test_oc3_line_in_surge() -> None:
    """Reference 27, 5 m at 15 s with the misprinted EA: 616.74 to 951.15 kN by another program (2e-4), full equations.

    Small motion at 100 segments gives 614.7 to 949.6 kN: both ends are 2 kN too low, the range is right to 1e-3, which
    is luck (the displacements are off by 6 %). Asserted is what was seen, with a factor of two.
    """
    ask = Ask(accuracy=WIDE, duration=150.0, segments=100, interval=0.05, model="local", method="dopri5")
    run = solve(oc3_hung(), ask)
    assert run.status == Status.OK, run.message
    T = top(run)[run.t >= 120.0]
    assert T.min() == pytest.approx(616.74e3, rel=7e-3)
    assert T.max() == pytest.approx(951.15e3, rel=4e-3)
    assert np.ptp(T) == pytest.approx(334.41e3, rel=5e-3)
    assert run.signals["tension"].min() > 0


def test_jumper_in_surge_is_beyond_small_motion() -> None:
    """Low and Langley's jumper, 10 m at 27 s: 41.58 to 52.24 kN published. A tenth of its span is no small motion: the
    range comes out a fifth too small (asserted: 10 to 30 %) and the mean 2 kN too high. The run itself looks right:
    only `range_error`, quasi-static, warns, with more than 5 %."""
    run = solve(jumper(), Ask(accuracy=WIDE, duration=81.0, segments=40, interval=0.1, model="local", method="dopri5"))
    assert run.status == Status.OK, run.message
    T = top(run)[run.t >= 54.0]
    assert 0.10 < 1 - np.ptp(T) / 10.66e3 < 0.30
    assert 1e3 < T.mean() - 46.71e3 < 3e3
    assert LocalModel(jumper(), 40).range_error() > 0.05


def test_range_error_grows_with_the_motion() -> None:
    """The quasi-static estimate: linear in a small amplitude without (1 + es) dropped; NaN where nothing moves or a
    displaced end leaves no catenary."""
    found = [LocalModel(oc3_hung(3.84243e8, x), 50, stretched=True).range_error() for x in (0.01, 0.1, 1.0)]
    assert np.all(np.log10(np.array(found[1:]) / found[:-1]) > 0.9), found
    still = replace(jumper(), end_b=End(kind="pinned", position=(0, 0, -5)))
    assert LocalModel(still, 20).range_error() == 0
    loose = replace(level(w=1.0), end_b=End(kind="pinned", position=(10.0005, 0, -3), motion=surge(-5.0, 10.0, 0.0)))
    assert math.isinf(LocalModel(loose, 20).range_error())
