"""The Hermite line at rest and its natural frequencies against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.special import jn_zeros

from solvers import Ask, Current, End, Response, Scene, Seabed, Section, Start, Status, Water, solve
from solvers.catalogue import static_state
from solvers.catenary import catenary
from solvers.dispatch import call_tangent
from solvers.lines.hermite import HermiteModel


def at_rest(scene: Scene, elements: int, status: Status = Status.OK) -> Response:
    response = solve(scene, Ask(segments=elements, model="hermite"))
    assert response.status == status, response.message
    return response


def modes(scene: Scene, elements: int, axis: int) -> np.ndarray:
    """Natural angular frequencies of the motion along one axis of the plane, lowest first."""
    model = HermiteModel(scene, elements)
    status, q, note = static_state(model)
    assert status == Status.OK, note
    zero, found, n, bw = np.zeros(model.ndof), [], model.ndof, model.pack.bw
    free = np.setdiff1d(np.arange(axis, n, 2), model.pack.fixed)
    for cq, ca in ((1.0, 0.0), (0.0, 1.0)):
        J = np.zeros((n, 2 * bw + 1))
        call_tangent(0.0, q, zero, zero, cq, 0.0, ca, model.pack, J)
        padded = np.zeros((n, n + 2 * bw))
        for i in range(n):
            padded[i, i : i + 2 * bw + 1] = J[i]
        found.append(padded[:, bw : bw + n][np.ix_(free, free)])
    return np.sqrt(np.maximum(eigh(*found, eigvals_only=True), 0.0))


def level(cable: Section, span: float, **fields: Any) -> Scene:
    """A straight cable along x between two pins, without weight."""
    ends = [End(kind="pinned", position=(x, 0.0, -3.0)) for x in (0.0, span)]
    return Scene(cable=(cable,), end_a=ends[0], end_b=ends[1], **{"g": 0.0, **fields})


def stretched(T: float, length: float, m: float, EA: float, EI: float = 0.0) -> Section:
    """A section whose mass, length and EI are those given once it is stretched by T; EI theta'^2 is per unstretched."""
    e = 1 + T / EA
    return Section(length=length / e, mass=m * e, EA=EA, EI=EI / e, d=0.1, wet_weight=0.0)


# ------------------------------------------------------------------------------------------- frequencies


def test_taut_string() -> None:
    """omega_k = k pi/L sqrt(T/m): order 6, as of every cubic element that is continuous in its slope; in water m gains
    the normal added mass."""
    T, m, L = 5e4, 20.0, 12.0
    exact = np.arange(1, 4) * math.pi / L * math.sqrt(T / m)
    errors = np.array([modes(level(stretched(T, L, m, 5e6), L), n, 1)[:3] / exact - 1 for n in (4, 8, 16)])
    orders = np.log2(np.abs(errors[:-1] / errors[1:]))
    assert (orders[1] > 5.5).all()
    assert np.abs(errors[1]).max() < 3e-5
    string = stretched(T, L, m, 5e6)
    added = 1000.0 * math.pi / 4 * 0.1**2 / 1.01
    wet = modes(level(string, L, water=Water(density=1000.0)), 16, 1)[:3]
    np.testing.assert_allclose(wet, exact * math.sqrt(m / (m + added)), rtol=1e-6)


def test_tensioned_beam() -> None:
    """omega^2 = (T k^2 + EI k^4)/m, pinned: order 4, and with the corrected inertia ten times below the (k h)^4/1440 of
    cubic elements. 7.68693249, 18.79485658, 35.11617626 rad/s are the first."""
    T, EI, m, L = 5e4, 1e5, 100.0, 10.0
    k = np.arange(1, 6) * math.pi / L
    exact = np.sqrt((T * k**2 + EI * k**4) / m)
    np.testing.assert_allclose(exact[:3], [7.68693249, 18.79485658, 35.11617626], atol=6e-9)
    scene = level(stretched(T, L, m, 1e10, EI), L)
    errors = np.array([modes(scene, n, 1)[:5] / exact - 1 for n in (16, 32, 64)])
    assert (np.log2(np.abs(errors[1] / errors[2])) > 3.0).all()
    assert np.log2(np.abs(errors[1] / errors[2]))[:2] == pytest.approx(4.0, abs=0.2)
    assert np.abs(errors[0, 4]) < 0.1 * (k[4] * L / 16) ** 4 / 1440
    plain = np.abs(errors[1]) / ((k * L / 32) ** 4 / 1440)
    assert plain.max() < 1.0


@pytest.mark.parametrize("upper", ["a", "b"])
def test_hanging_chain(upper: str) -> None:
    """L = 1 m, g = 9.81: omega_k = j_0k/2 sqrt(g/L), a singular end without tension; EA stretches it by 1e-7."""
    exact = jn_zeros(0, 3) / 2 * math.sqrt(9.81)
    chain = Section(length=1.0, d=0.01, mass=1.0, EA=1e8)
    ends = {"end_a": End(kind="free"), "end_b": End(kind="free")}
    ends[f"end_{upper}"] = End(kind="pinned", position=(0.0, 0.0, 0.0))
    found = modes(Scene(cable=(chain,), g=9.81, **ends), 16, 0)[:3]
    np.testing.assert_allclose(found, exact, rtol=3e-7)


def test_clamped_beam() -> None:
    """Slanting clamps at both ends, whose slopes are held in their own frames: beta L = 4.730041, 7.853205."""
    EI, m, L = 2e4, 30.0, 8.0
    c, s = math.cos(0.6), math.sin(0.6)
    ends = [End(kind="clamped", position=(L * x * c, 0.0, L * x * s), direction=(c, 0.0, s)) for x in (0, 1)]
    beam = Section(length=L, d=0.1, mass=m, EA=1e9, EI=EI, wet_weight=0.0)
    model = HermiteModel(Scene(cable=(beam,), end_a=ends[0], end_b=ends[1], g=0.0), 8)
    q, zero, n, bw = model.starts()[0], np.zeros(model.ndof), model.ndof, model.pack.bw
    free, found = np.setdiff1d(np.arange(n), model.pack.fixed), []
    for cq, ca in ((1.0, 0.0), (0.0, 1.0)):
        J = np.zeros((n, 2 * bw + 1))
        call_tangent(0.0, q, zero, zero, cq, 0.0, ca, model.pack, J)
        padded = np.zeros((n, n + 2 * bw))
        for i in range(n):
            padded[i, i : i + 2 * bw + 1] = J[i]
        found.append(padded[:, bw : bw + n][np.ix_(free, free)])
    omega = np.sqrt(eigh(*found, eigvals_only=True))[:2]
    exact = (np.array([4.730040745, 7.853204624]) / L) ** 2 * math.sqrt(EI / m)
    np.testing.assert_allclose(omega, exact, rtol=4e-5)


# ------------------------------------------------------------------------------------------- catenaries


def test_jumper_without_bending() -> None:
    """Low and Langley (2006), EI = 0, on another bearing than x: forces of the elastic catenary, order 4."""
    weight = (165.0 - 1000.0 * math.pi / 4 * 0.396**2) * 9.807
    cable = Section(length=170.0, d=0.396, mass=165.0, EA=5e8)
    ends = [End(kind="pinned", position=x) for x in ((-60.0, -80.0, -55.0), (0.0, 0.0, -5.0))]
    scene = Scene(cable=(cable,), end_a=ends[0], end_b=ends[1], water=Water(density=1000.0), g=9.807)
    H, V = catenary(100.0, 50.0, 170.0, weight, 5e8)
    exact = np.array([[-H, V - weight * 170.0], [H, V]])
    exact[0, 1] = weight * 170.0 - V
    errors = []
    for n in (10, 20, 40):
        force = at_rest(scene, n).signals["end_force"][0]
        flat = np.column_stack([force[:, :2] @ [0.6, 0.8], force[:, 2]])
        np.testing.assert_allclose(force[:, :2] @ [-0.8, 0.6], 0.0, atol=1e-9 * H)
        errors.append(flat - exact)
    errors = np.abs(errors)
    assert (np.log2(errors[1] / errors[2]) > 3.8).all()
    assert errors[2].max() < 1e-6 * H
    tension = at_rest(scene, 40).signals["tension"][0]
    assert tension[[0, -1]] == pytest.approx([26.6263e3, 47.1395e3], rel=1e-2)  # half a station inside the ends


def test_jumper_with_bending() -> None:
    """OrcaFlex's forces with EI = 120.8 kN m2, by 20 elements: to half a unit of their last digit."""
    cable = Section(length=170.0, d=0.396, mass=165.0, EA=5e8, EI=120.8e3)
    ends = [End(kind="pinned", position=x) for x in ((-100.0, 0.0, -55.0), (0.0, 0.0, -5.0))]
    run = at_rest(Scene(cable=(cable,), end_a=ends[0], end_b=ends[1], water=Water(density=1000.0), g=9.807), 20)
    a, b = run.signals["end_force"][0] / 1e3
    found = np.linalg.norm(b), b[2], b[0], np.linalg.norm(a), a[2]
    for value, published, digit in zip(found, (47.11, 45.71, 11.40, 26.6, 24.04), (0.01, 0.01, 0.01, 0.1, 0.01),
                                       strict=True):  # fmt: skip
        assert abs(value - published) <= 0.501 * digit


def test_oc3_on_the_bed() -> None:
    """H = 736.938, V = 535.727, T = 911.088 kN: the bed of 1e9 Pa/m gives by nothing, the touchdown point lies in an
    element, whose contact three points weigh: 2e-4 with 40 elements, a fifth of what 40 lumped segments leave."""
    section = Section(length=902.2, d=0.09, mass=77.7066, wet_weight=698.094, EA=3.84243e8)
    stiffness = 1e7
    scene = Scene(
        cable=(section,), end_a=End(kind="pinned", position=(0.0, 0.0, -320.0)), water=Water(),
        end_b=End(kind="pinned", position=(848.67, 0.0, -70.0)),
        seabed=Seabed(z=-320.0 + 698.094 / (stiffness * 0.09), stiffness=stiffness),
    )  # fmt: skip
    run = at_rest(scene, 40)
    _, b = run.signals["end_force"][0] / 1e3
    np.testing.assert_allclose([b[0], b[2], np.linalg.norm(b)], [736.938, 535.727, 911.088], rtol=2e-4)


# ------------------------------------------------------------------------------------------- elastica


def cantilever(alpha: float, q: float) -> Scene:
    """A horizontal cantilever, L = EI = 1, tip load alpha and weight q; EA = 1e9 stretches it by less than 1e-7 and
    would lock an element whose strains could not follow its bending."""
    beam = Section(length=1.0, d=0.01, mass=1.0, wet_weight=q, EA=1e9, EI=1.0)
    tip = End(kind="free", force=(0.0, 0.0, -alpha))
    clamp = End(kind="clamped", position=(0.0, 0.0, 0.0), direction=(1.0, 0.0, 0.0))
    return Scene(cable=(beam,), end_a=clamp, end_b=tip)


@pytest.mark.parametrize(
    ("alpha", "tip"),
    [
        (0.2, (0.06636448, 0.00264655)), (1.0, (0.30172077, 0.05643324)),
        (2.0, (0.49345748, 0.16064172)), (10.0, (0.81060902, 0.55499560)),
    ],
)  # fmt: skip
def test_cantilever_with_a_dead_load(alpha: float, tip: tuple[float, float]) -> None:
    """Bisshopp and Drucker's elastica: drop and shortening within 1e-5 with 8 elements and 3e-6 with 16, which is what
    400 lumped segments reach. Were the line locked, 8 elements would leave 1e-3 to 2e-4."""
    for n, limit in ((8, 1e-5), (16, 3e-6)):
        x, _, z = at_rest(cantilever(alpha, 0.0), n).signals["position"][0, -1]
        assert [-z, 1 - x] == pytest.approx(tip, abs=limit)


@pytest.mark.parametrize(("q", "drop"), [(1.0, 0.1234714), (5.0, 0.4959050), (10.0, 0.7001997), (50.0, 0.9079171)])
def test_heavy_elastica_from_a_cold_start(q: float, drop: float) -> None:
    """A cantilever under its own weight, from the straight line onto the right branch: 1e-5 with 16 elements."""
    z = at_rest(cantilever(0.0, q), 16).signals["position"][0, -1, 2]
    assert -z == pytest.approx(drop, abs=1e-5)


@pytest.mark.parametrize("turn", [0.1, 0.5, 0.8])
def test_boundary_layer_at_a_clamp(turn: float) -> None:
    """kappa(0) = 2 sin(turn/2)/lambda and tan(theta/4) = tan(turn/4) exp(-s/lambda), lambda = sqrt(EI/T) = 0.2 m: the
    curvature at the clamp within 5 % by elements of two decay lengths, the longest allowed, and 0.5 % by half one."""
    layer = 0.2

    def layered(elements: int) -> Response:
        cable = Section(length=3.2, d=0.01, mass=1.0, wet_weight=0.0, EA=1e8, EI=40.0)
        clamp = End(kind="clamped", position=(0, 0, 0), direction=(math.cos(turn), 0.0, math.sin(turn)))
        pull = End(kind="free", force=(1000.0, 0.0, 0.0))
        return at_rest(Scene(cable=(cable,), end_a=clamp, end_b=pull, g=0.0), elements)

    exact = 2 / layer * math.sin(turn / 2)
    for elements, limit in ((8, 0.05), (32, 5e-3)):
        assert layered(elements).signals["curvature"][0, 0] == pytest.approx(exact, rel=limit)
    found = layered(32).signals
    s, shape = found["arc"], np.diff(found["position"][0], axis=0)
    theta = 4 * np.arctan(math.tan(turn / 4) * np.exp(-(s[1:] + s[:-1]) / 2 / layer))
    np.testing.assert_allclose(np.arctan2(shape[:, 2], shape[:, 0]), theta, atol=2e-3 * turn)


# ------------------------------------------------------------------------------------------- honesty


def test_what_elements_cannot_resolve_is_said() -> None:
    """A clamp's boundary layer, and a turn that no cubic follows: UNRESOLVED with the numbers."""
    cable = Section(length=3.0, d=0.01, mass=1.0, wet_weight=0.0, EA=1e8, EI=40.0)
    clamp = End(kind="clamped", position=(0, 0, 0), direction=(1.0, 0.0, 0.1))
    scene = Scene(cable=(cable,), end_a=clamp, end_b=End(kind="free", force=(1000.0, 0.0, 0.0)), g=0.0)
    run = at_rest(scene, 7, Status.UNRESOLVED)
    assert "0.429 m at a clamp" in run.message
    assert "0.2 m" in run.message
    rope = Section(length=10.0, d=0.02, mass=2.0, EA=1e6, EI=0.1)
    ends = [End(kind="pinned", position=(x, 0.0, 0.0)) for x in (0.0, 1.0)]
    run = at_rest(Scene(cable=(rope,), end_a=ends[0], end_b=ends[1]), 10, Status.UNRESOLVED)
    assert "rad" in run.message


def test_sections_of_unequal_stiffness() -> None:
    """Slopes are continuous, strains of unequal sections are not: end forces agree with fine lumped segments to 1e-4
    all the same, and the difference falls with the mesh (order 1)."""
    parts = tuple(Section(length=x, d=0.05, mass=m, EA=EA, EI=10.0)
                  for x, m, EA in ((37.0, 12.0, 4e6), (11.0, 15.0, 1e6), (52.0, 9.0, 2e6)))  # fmt: skip
    ends = [End(kind="pinned", position=x) for x in ((0.0, 0.0, -60.0), (70.0, 0.0, -5.0))]
    flow = Current(z=(-60.0, 0.0), velocity=((0.1, 0, 0), (0.8, 0, 0)))
    scene = Scene(cable=parts, end_a=ends[0], end_b=ends[1], water=Water(current=flow))
    fine = [solve(scene, Ask(segments=n, model="lumped")).signals["end_force"][0] for n in (400, 800)]
    truth = (4 * fine[1] - fine[0]) / 3  # Richardson
    size = np.linalg.norm(truth[1])
    errors = [np.abs(at_rest(scene, n).signals["end_force"][0] - truth).max() / size for n in (20, 40)]
    assert errors[0] < 1e-4
    assert errors[1] < 0.7 * errors[0]


def test_starts() -> None:
    """A given polyline keeps its points and strain; a released end is held until it is let go."""
    cable = Section(length=5.0, d=0.05, mass=3.0, EA=1e5)
    pin = End(kind="pinned", position=(0, 0, 0))
    given = Scene(
        cable=(cable,), end_a=pin, end_b=End(kind="free"),
        start=Start(kind="given", shape=((0, 0, 0), (5.05, 0, 0)), velocity=((0, 0, 0), (0, 0, 2.0))),
    )  # fmt: skip
    run = solve(given, Ask(duration=1e-3, segments=8, model="hermite", method="dopri5"))
    np.testing.assert_allclose(run.signals["tension"][0], 1e5 * 0.01, rtol=1e-9)
    np.testing.assert_allclose(run.signals["velocity"][0, :, 2], np.linspace(0, 2, 33), atol=1e-12)
    released = Scene(
        cable=(cable,), end_a=pin, end_b=End(kind="free", position=(3.0, 0, 0)), start=Start(kind="released")
    )
    run = solve(released, Ask(duration=0.3, segments=16, model="hermite", method="dopri5", interval=0.01))
    z = run.signals["position"][:, -1, 2]
    np.testing.assert_allclose(run.signals["position"][0, -1], [3.0, 0.0, 0.0], atol=1e-9)
    assert z[-1] < -0.3
