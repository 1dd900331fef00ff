"""Static shapes and forces of rods, catenaries and hybrids of both against elastica and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from elastica import (
    END_FORCE,
    LENGTH,
    MASS,
    STIFFNESS,
    WEIGHT,
    Hanging,
    boundary_layer,
    cantilever,
    greenhill,
    heavy_cantilever,
    helix,
    hybrid_suspension,
    suspension,
)
from scipy.optimize import brentq

from solvers import Ask, End, Response, Scene, Seabed, Section, Status, Water, solve
from solvers.banded import hold
from solvers.catenary import catenary
from solvers.dispatch import call_backsolve, call_factorise, call_residual, call_tangent
from solvers.lines.rod import build_rod, params

ALONG_X = (1.0, 0.0, 0.0)
CLAMP = End(kind="clamped", position=(0, 0, 0), direction=ALONG_X)


def at_rest(scene: Scene, segments: int, model: str = "rod", status: Status = Status.OK, **ask: Any) -> Response:
    response = solve(scene, Ask(model=model, segments=segments, **ask))
    assert response.status == status, response.message
    return response


def bar(**fields: Any) -> Section:
    """1 m of weightless rod with EI = 1, so stiff along itself that forces of order 1 strain it by 1e-10."""
    return Section(**{"length": 1.0, "d": 1e-3, "mass": 1e-3, "EA": 1e10, "EI": 1.0, "wet_weight": 0.0, **fields})


def hung(cable: Section, end_b: End, end_a: End = CLAMP, **fields: Any) -> Scene:
    return Scene(cable=(cable,), end_a=end_a, end_b=end_b, **fields)


def place(response: Response, node: int = -1) -> np.ndarray:
    return response.signals["position"][0, node]


def dense(J: np.ndarray, bw: int) -> np.ndarray:
    """Band storage J[i, bw + j - i] as a square matrix."""
    i, k = np.nonzero(J)
    full = np.zeros((len(J), len(J)))
    full[i, i + k - bw] = J[i, k]
    return full


def assert_second_order(errors: Any, low: float = 3.5, high: float = 4.5) -> None:
    """Each column of errors on meshes that halve falls by 4 between any two."""
    e = np.abs(np.array(errors))
    ratio = e[:-1] / e[1:]
    assert np.all((low < ratio) & (ratio < high)), f"ratios {ratio} of errors {errors}"


# ------------------------------------------------------------------------------------------ cantilevers


@pytest.mark.parametrize("alpha", [0.2, 1.0, 2.0, 10.0])
def test_dead_loaded_cantilever(alpha: float) -> None:
    """Drop and shortening of the loaded end (Bisshopp and Drucker 1945) at order 2; 2.5e-5 of L at 80 elements, which
    is what h^2 leaves where the end's slope is 1.43 rad."""
    tip, errors = cantilever(alpha), []
    for n in (20, 40, 80):
        x, y, z = place(at_rest(hung(bar(), End(kind="free", force=(0, 0, -alpha))), n))
        errors.append([-z - tip.drop, 1 - x - tip.shortening])
        assert abs(y) < 1e-12
    assert_second_order(errors, 3.9, 4.1)
    assert np.abs(errors[-1]).max() < 2.5e-5


@pytest.mark.parametrize("q", [1.0, 5.0, 10.0, 50.0])
def test_heavy_elastica(q: float) -> None:
    """Drop of a cantilever under its own weight, on the branch that grows from the straight rod; order 2. At q = 50 the
    others have drops that differ in the first digit; 5e-5 of L is left at 80 elements."""
    drop, errors = heavy_cantilever(q), []
    for n in (20, 40, 80):
        found = at_rest(hung(bar(wet_weight=q), End(kind="free")), n)
        errors.append([-place(found)[2] - drop])
        moments = found.signals["moment"][0, :, 1]
        assert np.all(np.diff(moments) < 0)  # of one sign, and falling: no loop
        assert moments[0] == pytest.approx(q * np.trapezoid(found.signals["position"][0, :, 0], dx=1 / n), rel=1e-9)
    assert_second_order(errors, 3.9, 4.1)
    assert np.abs(errors[-1]).max() < 5e-5


@pytest.mark.parametrize("rho_space", [0.8, 0.5, 0.0])
def test_damping_along_the_line_keeps_the_order(rho_space: float) -> None:
    """Generalised-alpha in space at rho < 1: the heavy cantilever at q = 10 and the dead load's at 2 keep order 2; the
    first element of a domain, which takes the box rule, and the other error terms leave ratios of 3.8 to 4.1."""
    heavy, dead, errors = heavy_cantilever(10.0), cantilever(2.0), []
    for n in (40, 80, 160):
        falls = at_rest(hung(bar(wet_weight=10.0), End(kind="free")), n, rho_space=rho_space)
        bends = at_rest(hung(bar(), End(kind="free", force=(0, 0, -2.0))), n, rho_space=rho_space)
        errors.append([-place(falls)[2] - heavy, -place(bends)[2] - dead.drop])
    assert_second_order(errors, 3.8, 4.1)
    assert np.abs(errors[-1]).max() < 2e-5


@pytest.mark.parametrize("alpha", [0.5, 2.0])
def test_bent_between_clamp_and_pin(alpha: float) -> None:
    """The cantilever's loaded end pinned where the load brings it: the pin takes that load, and hardly any other.

    h^2 leaves 2.5e-3 of it at 80 elements, most of that along the rod, which hardly gives that way.
    """
    tip = cantilever(alpha)
    there = End(kind="pinned", position=(1 - tip.shortening, 0, -tip.drop))
    found = at_rest(hung(bar(EA=1e6), there), 80)
    np.testing.assert_allclose(found.signals["end_force"][0, 1], [0, 0, -alpha], atol=4e-3 * alpha)


@pytest.mark.parametrize("twist", [0.0, 90.0])
def test_bending_about_either_axis(twist: float) -> None:
    """EI about body axis 1 and EI2 about axis 2, which is horizontal at twist 0: a load down bends about axis 2, a load
    across about axis 1, and a clamp turned by 90 degrees swaps them. As far from the elastica as an isotropic rod."""
    cable = bar(EI=1.0, EI2=2.5)
    clamp = replace(CLAMP, twist=twist)
    for force, axis, EI in (((0, 0, -2.0), 2, 2.5), ((0, 2.0, 0), 1, 1.0)):
        stiffness = EI if twist == 0.0 else 3.5 - EI
        found = at_rest(hung(cable, End(kind="free", force=force), clamp), 40)
        tip = cantilever(2.0 / stiffness)
        assert abs(place(found)[axis]) == pytest.approx(tip.drop, abs=1e-4)
        assert place(found)[0] == pytest.approx(1 - tip.shortening, abs=1e-4)
        same = at_rest(hung(bar(EI=stiffness), End(kind="free", force=force)), 40)
        np.testing.assert_allclose(place(found), place(same), atol=1e-12)


# ------------------------------------------------------------------------------------------ arcs and helices


@pytest.mark.parametrize(("segments", "turn"), [(1, 0.4), (3, 1.4), (5, 1.5), (16, 2 * math.pi), (40, 4 * math.pi)])
def test_end_moment_bends_a_rod_into_an_arc(segments: int, turn: float) -> None:
    """A pure end moment: curvature M/EI, moment and positions exact on any mesh whose elements turn by up to 0.5 rad:
    1e-12, rounding. Up to two full circles."""
    found = at_rest(hung(bar(), End(kind="free", moment=(0, -turn, 0))), segments).signals
    s = found["arc"]
    circle = np.column_stack([np.sin(turn * s) / turn, 0 * s, (1 - np.cos(turn * s)) / turn])
    np.testing.assert_allclose(found["position"][0], circle, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["curvature"][0], turn, rtol=1e-12)
    np.testing.assert_allclose(found["moment"][0], np.tile([0, -turn, 0], (len(s), 1)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(found["twist"][0], 0.0, atol=1e-12)


HELICES = [(1.2, 0.7, 0.9, 4), (2.0, 3.0, -0.5, 20), (5.0, 6.0, 0.3, 40), (3.0, 2.0, 0.0, 8)]


@pytest.mark.parametrize(("kappa", "tau", "moment", "segments"), HELICES)
def test_helix(kappa: float, tau: float, moment: float, segments: int) -> None:
    """Body curvature k = (kappa, 0, tau) all along an anisotropic rod under an end moment along the helix's axis:
    R k is constant in space, so B (k - k0) = moment k balances with k0 the intrinsic curvature. Exact on any mesh."""
    B, k = np.array([1.0, 2.0, 0.7]), np.array([kappa, 0.0, tau])
    cable = bar(EI=B[0], EI2=B[1], GJ=B[2], curvature=tuple(k - moment * k / B))
    start = params.matrix(params.end_frame(ALONG_X))
    axial = moment * start @ k
    found = at_rest(hung(cable, End(kind="free", moment=tuple(axial))), segments).signals
    shape = helix(kappa, tau, found["arc"])[0] @ start.T
    np.testing.assert_allclose(found["position"][0], shape, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["curvature"][0], kappa, rtol=1e-11)
    np.testing.assert_allclose(found["twist"][0], tau, rtol=1e-11)
    np.testing.assert_allclose(found["moment"][0], np.tile(axial, (segments + 1, 1)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(found["torque"][0], moment * tau, rtol=0, atol=1e-11)


def test_a_turn_too_large_for_an_element_is_told() -> None:
    """0.9 rad an element: the shape is exact here, but no other would be."""
    found = at_rest(hung(bar(), End(kind="free", moment=(0, -3.6, 0))), 4, status=Status.UNRESOLVED)
    assert "turns by 0.90 rad" in found.message


# ------------------------------------------------------------------------------------------ torsion


def test_distributed_twisting_moment() -> None:
    """A straight rod under a uniform moment Q along its axis: twist rate Q (L - s)/GJ; exact."""
    Q, GJ, L = 1.3, 5.0, 2.0
    cable = bar(length=L, EI=3.0, GJ=GJ, moment=(Q, 0, 0))
    found = at_rest(hung(cable, End(kind="free")), 6).signals
    np.testing.assert_allclose(found["twist"][0], Q * (L - found["arc"]) / GJ, atol=1e-14)
    np.testing.assert_allclose(found["torque"][0], Q * (L - found["arc"]), atol=1e-14)
    np.testing.assert_allclose(found["position"][0, -1], [L, 0, 0], atol=1e-12)


def test_distributed_bending_moment() -> None:
    """A small uniform moment q across a cantilever: M = q (L - s), end slope q L^2/2EI, end deflection q L^3/3EI.

    Linear theory, 1e-4 of it at a slope of 0.005; the mesh leaves (h/L)^2/4 = 4e-4 of the deflection at 25 elements.
    """
    q = 0.01
    found = at_rest(hung(bar(moment=(0, -q, 0)), End(kind="free")), 25).signals
    np.testing.assert_allclose(found["moment"][0, :, 1], -q * (1 - found["arc"]), atol=1e-6)
    assert found["position"][0, -1, 2] == pytest.approx(q / 3, rel=6e-4)


@pytest.mark.parametrize(
    ("end_b", "torque", "strained"),
    [
        (End(kind="free", force=(70.0, 0, 0)), 0.0, None),
        (End(kind="free", force=(70.0, 0, 0), moment=(0.4, 0, 0)), 0.4, None),
        (End(kind="free", force=(70.0, 0, 0), direction=ALONG_X), None, 0.0),
        (End(kind="free", force=(70.0, 0, 0), direction=ALONG_X, twist=30.0), None, math.radians(30.0) / 2.0),
    ],
    ids=["free to turn", "with a torque", "held", "turned"],
)
def test_laid_rope_under_tension(end_b: End, torque: float | None, strained: float | None) -> None:
    """T = EA e + C t, torque = C e + GJ t: strain e and twist rate t of a straight rope, C its coupling. Exact."""
    EA, GJ, C, T = 1e4, 5.0, 100.0, 70.0
    rope = Section(length=2.0, d=0.01, mass=1.0, EA=EA, EI=3.0, GJ=GJ, coupling=C, wet_weight=0.0)
    stiffness = np.array([[EA, C], [C, GJ]])
    if strained is None:
        strain, twist = np.linalg.solve(stiffness, [T, torque])
    else:
        twist, strain = strained, (T - C * strained) / EA
    found = at_rest(hung(rope, end_b), 12).signals
    np.testing.assert_allclose(found["twist"][0], twist, atol=1e-13)
    np.testing.assert_allclose(found["torque"][0], C * strain + GJ * twist, atol=1e-12)
    np.testing.assert_allclose(found["tension"][0], T, rtol=1e-13)
    np.testing.assert_allclose(found["position"][0, -1], [2.0 * (1 + strain), 0, 0], atol=1e-13)


# ------------------------------------------------------------------------------------------ boundary layers


def stretched_off_its_clamp(angle: float, T: float, EI: float, length: float) -> Scene:
    """A weightless rod pulled along x, its clamp at `angle` above it."""
    clamp = End(kind="clamped", position=(0, 0, 0), direction=(math.cos(angle), 0, math.sin(angle)))
    return hung(bar(length=length, EI=EI, EA=1e12), End(kind="free", force=(T, 0, 0)), clamp)


@pytest.mark.parametrize("angle", [0.3, 1.5])
def test_boundary_layer(angle: float) -> None:
    """Curvature at the clamp, its profile (order 2), and the length over which it decays; the rod is 12 of these long.

    The box scheme keeps EI kappa^2/2 + T cos theta, so that the clamp's curvature is exact but for the strain T/EA.
    """
    T, EI = 7.0, 0.3
    layer = boundary_layer(T, EI, angle)
    errors = []
    for n in (48, 96, 192):
        found = at_rest(stretched_off_its_clamp(angle, T, EI, 12 * layer.length), n).signals
        s, kappa = found["arc"], found["moment"][0, :, 1] / EI
        assert kappa[0] == pytest.approx(layer.curvature, rel=1e-8)
        exact = 2 / layer.length * np.sin(layer.theta(s) / 2)
        errors.append([np.abs(kappa - exact).max()])
        tail = (s > 3 * layer.length) & (s < 7 * layer.length)
        decay = -1 / np.polyfit(s[tail], np.log(kappa[tail]), 1)[0]
    assert_second_order(errors)
    assert decay == pytest.approx(layer.length, rel=2e-3)  # (h/length)^2/24 of it, and the elastica's own 1e-3


@pytest.mark.parametrize("segments", [48, 96, 192])
def test_a_rod_turns_the_short_way(segments: int) -> None:
    """A clamp 2 rad off the force: the rod turns by 2 rad and not by 2 pi - 2, whose curvature at the clamp is the same
    but for its sign, on any mesh."""
    layer = boundary_layer(7.0, 0.3, 2.0)
    found = at_rest(stretched_off_its_clamp(2.0, 7.0, 0.3, 12 * layer.length), segments).signals
    assert found["moment"][0, 0, 1] / 0.3 == pytest.approx(layer.curvature, rel=1e-8)


def test_a_layer_that_the_mesh_cannot_resolve_is_told() -> None:
    """Elements longer than sqrt(EI/T) at the clamp: UNRESOLVED, with both lengths in the message."""
    found = at_rest(stretched_off_its_clamp(0.3, 7.0, 0.3, 2.5), 6, status=Status.UNRESOLVED)
    assert "elements of 0.417 m at a clamp, where bending decays over 0.208 m" in found.message


def test_the_mesh_is_finer_at_a_clamp() -> None:
    """Where the scene's catenary tells the tension, elements grow from a quarter of the bending length, by 1.25 at
    most; a mesh that is fine enough, and a pinned end, stay as they are. So 40 segments resolve a layer of 1/300 L."""
    cable = Section(length=10.0, d=0.02, mass=1.0, EA=1e6, EI=0.05)
    clamp = End(kind="clamped", position=(8, 0, 0), direction=ALONG_X)
    pins = [End(kind="pinned", position=p) for p in ((0, 0, -3), (8, 0, 0))]
    found = at_rest(hung(cable, clamp, pins[0]), 40)
    l = np.diff(found.signals["arc"])
    layer = math.sqrt(0.05 / np.linalg.norm(found.signals["force"][0, -1]))
    assert l[-1] == pytest.approx(layer / 4, rel=0.05)
    assert l[:-1].max() == pytest.approx(0.25, rel=0.05)
    assert np.all(l[:-1] / l[1:] < 1.26)
    np.testing.assert_allclose(np.diff(at_rest(hung(cable, pins[1], pins[0]), 40).signals["arc"]), 0.25)


# ------------------------------------------------------------------------------------------ the paper's suspension

# EA makes strains of 1e-9, which the reference does not have
SUSPENDED = Section(length=LENGTH, d=1e-3, mass=MASS, EA=1e7, EI=STIFFNESS, wet_weight=WEIGHT)
HANGING = Scene(
    cable=(SUSPENDED,),
    end_a=End(kind="pinned", position=(0, 0, 0)),
    end_b=End(
        kind="free",
        direction=(math.cos(math.pi / 6), 0, -math.sin(math.pi / 6)),
        force=(END_FORCE[0], 0, END_FORCE[1]),
    ),
)


def lowest(response: Response) -> float:
    """Depth of the lowest point, from a parabola through three nodes [m]."""
    z = response.signals["position"][0, :, 2]
    i = int(z.argmin())
    second, first = (z[i + 1] - 2 * z[i] + z[i - 1]) / 2, (z[i + 1] - z[i - 1]) / 2
    return float(first**2 / (4 * second) - z[i])


def bending(response: Response) -> np.ndarray:
    """Moment, positive over the sag."""
    return -response.signals["moment"][0, :, 1]


def differences(response: Response, exact: Hanging) -> list[float]:
    """Right end's place, sag and end moment less the reference's."""
    x, _, z = place(response)
    sag, moment = lowest(response), bending(response)[-1]
    return [x - exact.x[-1], z - exact.z[-1], sag - exact.lowest()[1], moment - exact.moment[-1]]


def test_suspension() -> None:
    """Goyal and Perkins' rod of 2 m: x(L), z(L), sag, T(0), M(L), largest M and shear against a collocated elastica.

    Order 2 in the first mesh widths; at 160 elements 3e-5 m and 1e-4 of the largest moments. The forces at the ends are
    statically determined; the force at every node is the weight below it, exactly.
    """
    exact = suspension()
    errors = []
    for n in (40, 80, 160):
        found = at_rest(HANGING, n)
        errors.append([*differences(found, exact), found.signals["shear"][0, 0] - abs(exact.shear[0])])
    assert_second_order(np.array(errors)[:, [0, 1, 3, 4]], 3.9, 4.1)
    assert_second_order(np.array(errors)[1:, [2]], 3.5, 4.5)  # at 40 the parabola through three nodes shows
    assert np.abs(errors[-1][:3]).max() < 5e-5
    assert bending(found)[-1] == pytest.approx(exact.moment[-1], rel=1e-4)
    assert bending(found).max() == pytest.approx(exact.moment.max(), rel=1e-3)
    force = found.signals["force"][0]
    assert force[0, 2] == pytest.approx(END_FORCE[1] - WEIGHT * LENGTH, rel=1e-10)
    tension = np.hypot(exact.tension[0], exact.shear[0])
    assert np.linalg.norm(force[0]) == pytest.approx(tension, rel=1e-9)
    assert math.sqrt(tension**2 - found.signals["shear"][0, 0] ** 2) == pytest.approx(exact.tension[0], rel=1e-4)
    assert found.signals["shear"][0, -1] == pytest.approx(0.01, rel=1e-9)
    assert abs(bending(found)[0]) < 1e-12


@pytest.mark.parametrize("joint", [1.0, 1.5, 1.75])
def test_hybrid_suspension(joint: float) -> None:
    """A catenary up to `joint` [m], then the rod: order 2 in the right end's place, the sag and the end moment.

    The sag is the catenary's, 9.345 % deeper than the rod's, as the two references say; 0.002 % of it is left at 160.
    """
    exact, rod = hybrid_suspension(joint), suspension()
    errors = []
    for n in (40, 80, 160):
        found = at_rest(HANGING, n, "hybrid", rods=((joint, LENGTH),), accuracy=0.5)
        errors.append(differences(found, exact))
        domain = found.signals["domain"][0]
        np.testing.assert_array_equal(domain, found.signals["arc"][1:] > joint + 1e-9)
        before = found.signals["arc"] < joint + 1e-9
        for name in ("shear", "torque", "twist"):
            np.testing.assert_allclose(found.signals[name][0, before][:-1], 0.0, atol=1e-15)
        np.testing.assert_allclose(bending(found)[before], 0.0, atol=1e-12)
    assert_second_order(errors)
    assert bending(found)[-1] == pytest.approx(exact.moment[-1], rel=2e-4)
    assert 100 * (lowest(found) / rod.lowest()[1] - 1) == pytest.approx(9.345, abs=5e-3)
    if joint == 1.0:  # beyond it the rod still sags
        assert bending(found).max() == pytest.approx(exact.moment.max(), rel=1e-3)


def test_a_hybrid_says_what_its_joint_costs() -> None:
    """At the default accuracy of 5 % a sag that is 9.3 % too deep is ROD_NEEDED; left to itself the hybrid is a rod."""
    found = at_rest(HANGING, 80, "hybrid", Status.ROD_NEEDED, rods=((1.5, LENGTH),))
    assert "bending left out in catenary domains" in found.message
    alone = at_rest(HANGING, 80, "hybrid")
    assert np.all(alone.signals["domain"] == 1)
    np.testing.assert_allclose(place(alone), place(at_rest(HANGING, 80)), atol=1e-9)


# ------------------------------------------------------------------------------------------ catenaries

JUMPER = Section(length=170.0, d=0.396, mass=165.0, EA=5e8)
JUMPER_WEIGHT = (165.0 - 1000.0 * math.pi / 4 * 0.396**2) * 9.807


def jumper(EI: float, azimuth: float = 0.0) -> Scene:
    """Low and Langley (2006), hanging flexible jumper, its plane turned about z by `azimuth` degrees."""
    c, s = math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))
    low, high = (-100.0 * c, -100.0 * s, -55.0), (0.0, 0.0, -5.0)
    return Scene(
        cable=(replace(JUMPER, EI=EI),), end_a=End(kind="pinned", position=low),
        end_b=End(kind="pinned", position=high), water=Water(density=1000.0), g=9.807,
    )  # fmt: skip


def ends(response: Response) -> np.ndarray:
    """Top T, V, H and bottom T, V [kN]."""
    a, b = response.signals["end_force"][0]
    return np.array([np.linalg.norm(b), b[2], math.hypot(b[0], b[1]), np.linalg.norm(a), a[2]]) / 1e3


def test_jumper_without_bending() -> None:
    """Every end force tends to the elastic catenary's at order 2 (ratio 4 to 0.05): H 11.4723, V 45.7222, T 47.1395 kN,
    1e-5 of them at 160 elements."""
    H, V = catenary(100.0, 50.0, 170.0, JUMPER_WEIGHT, 5e8)
    low = JUMPER_WEIGHT * 170.0 - V
    exact = np.array([math.hypot(H, V), V, H, math.hypot(H, low), low]) / 1e3
    np.testing.assert_allclose(exact[:3], [47.1395, 45.7222, 11.4723], atol=5e-5)
    errors = np.array([ends(at_rest(jumper(0.0), n, "catenary")) - exact for n in (20, 40, 80, 160)])
    assert_second_order(errors, 3.95, 4.05)
    assert np.abs(errors[-1] / exact).max() < 1e-5


def test_jumper_with_bending_against_orcaflex() -> None:
    """Low and Langley (2006), OrcaFlex forces with EI = 120.8 kN m2: to half a unit of their last digit. Without
    bending H is 11.47 kN, so a bending force that is 10 % wrong fails."""
    found = ends(at_rest(jumper(120.8e3), 160))
    for value, published, digit in zip(
        found, [47.11, 45.71, 11.40, 26.6, 24.04], [0.01, 0.01, 0.01, 0.1, 0.01], strict=True
    ):
        assert abs(value - published) <= 0.501 * digit
    errors = [ends(at_rest(jumper(120.8e3), n)) for n in (20, 40, 80, 160)]
    assert_second_order(np.diff(errors, axis=0)[:, :3])


@pytest.mark.parametrize("model", ["rod", "catenary"])
def test_nothing_depends_on_the_azimuth(model: str) -> None:
    """A line between two pins in a vertical plane on any bearing: forces alike to 1e-9."""
    EI = 120.8e3 if model == "rod" else 0.0
    found = [ends(at_rest(jumper(EI, azimuth), 40, model)) for azimuth in (0.0, 37.0, 90.0)]
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-9)


OC3 = Section(length=902.2, d=0.09, mass=77.7066, wet_weight=698.094, EA=3.84243e8)
CHAIN = Section(
    length=410.0, d=0.252, mass=390.0, wet_weight=(390.0 - 1025 * math.pi / 4 * 0.252**2) * 9.80665, EA=1.674e9
)


@pytest.mark.parametrize(
    ("cable", "span", "rise", "segments"),
    [(OC3, 848.67, 250.0, 87), (CHAIN, 400.0, 50.0, 37)],
    ids=["oc3", "chain"],
)
def test_catenary_on_a_bed(cable: Section, span: float, rise: float, segments: int) -> None:
    """OC3-Hywind's line and a chain in 50 m of water, part of them at rest: H and V of the elastic catenary at order 2
    with the touchdown point on a node; a bed of 3e7 Pa/m, raised by what they sink, gives by less than 1e-5."""
    w = cable.wet(0.0, 0.0)
    H, V = catenary(span, rise, cable.length, w, cable.EA, bed=True)
    bed = Seabed(z=-320.0 + w / (3e7 * cable.d), stiffness=3e7)
    pins = [End(kind="pinned", position=p) for p in ((0, 0, -320.0), (span, 0, rise - 320.0))]
    errors = []
    for n in (segments, 2 * segments, 4 * segments):
        low, high = at_rest(hung(cable, pins[1], pins[0], seabed=bed), n, "catenary").signals["end_force"][0]
        errors.append([high[0] - H, high[2] - V])
        assert low[0] == pytest.approx(-high[0], rel=1e-8)
        assert abs(low[2]) < 5e-4 * V
    assert_second_order(errors)
    assert np.abs(errors[-1]).max() < 2e-4 * H


# ------------------------------------------------------------------------------------------ torsional buckling


def straight(T: float, M: float, ends: str, segments: int) -> tuple[params.Rod, np.ndarray]:
    """A weightless rod along x, EI = L = 1, under tension T [N] and torque M [N m]: its pack and its straight state.

    Clamped: both ends held, B turned. Pinned: both free to turn, the torque at each along x.
    """
    GJ, EA = 3.0, 1e6
    cable, there = bar(EA=EA, GJ=GJ), (1 + T / EA, 0.0, 0.0)
    end_a, end_b = replace(CLAMP), End(kind="clamped", position=there, direction=ALONG_X, twist=math.degrees(M / GJ))
    if ends == "pinned":
        end_a = End(kind="pinned", position=(0, 0, 0), moment=(-M, 0, 0))
        end_b = End(kind="pinned", position=there, moment=(M, 0, 0))
    model = build_rod(hung(cable, end_b, end_a), segments)
    pack, q, home = model.pack, np.zeros(model.ndof), params.end_frame(ALONG_X)
    for i, s in enumerate(model.s):
        q[pack.r[i]], q[pack.N[i]], q[pack.M[i]] = s * there[0], T, M
        q[pack.p[i] : pack.p[i] + 4] = params.rotated(home, M / GJ * s)
    r, zero = np.zeros(model.ndof), np.zeros(model.ndof)
    call_residual(0.0, q, zero, zero, pack, r)
    r[pack.fixed] = 0.0
    assert np.abs(r[pack.row[:, None] + np.arange(12)]).max() < 1e-9  # in balance
    return pack, q


def softness(T: float, M: float, ends: str, segments: int) -> float:
    """Stiffness against a small load across the middle of the straight twisted rod: 0 where it buckles.

    Where both ends turn freely, turning the whole rod about its axis costs nothing: that mode is left out by bordering
    the matrix with it and with the null vector of its transpose.
    """
    pack, q = straight(T, M, ends, segments)
    zero = np.zeros(len(q))
    J = np.zeros((len(q), 2 * pack.bw + 1))
    call_tangent(0.0, q, zero, zero, 1.0, 0.0, 0.0, pack, J)
    hold(J, pack.bw, pack.fixed)
    push, e = np.zeros(len(q)), segments // 2
    push[pack.row[[e - 1, e]] + 4] = 0.5
    if ends == "clamped":
        assert call_factorise(pack, J)
        call_backsolve(pack, J, push)
        return 1 / push[pack.r[e] + 1]
    turn = np.zeros(len(q))
    for p in pack.p:
        w, x, y, z = q[p : p + 4]
        turn[p : p + 4] = 0.5 * np.array([-x, w, -z, y])
    K = dense(J, pack.bw)
    assert np.abs(K @ turn).max() < 1e-9
    left = np.linalg.svd(K)[0][:, -1]
    whole = np.block([[K, left[:, None]], [turn[None], np.zeros((1, 1))]])
    return 1 / np.linalg.solve(whole, [*push, 0.0])[pack.r[e] + 1]


@pytest.mark.parametrize(
    ("ends", "T"), [("clamped", 0.0), ("clamped", 30.0), ("clamped", -15.0), ("pinned", 0.0), ("pinned", 10.0)]
)
def test_greenhill(ends: Literal["clamped", "pinned"], T: float) -> None:
    """The torque at which a straight rod loses its stiffness across: Greenhill's (1883), and that of clamped ends.

    To 1 % at 30 elements, and four times better at 60 (order 2).
    """
    exact = greenhill(T, 1.0, 1.0, ends)
    assert softness(T, 0.5 * exact, ends, 30) > 0
    found = [brentq(lambda M, n=n: softness(T, M, ends, n), 0.9 * exact, 1.1 * exact, xtol=1e-7) for n in (30, 60)]
    errors = np.array(found) / exact - 1
    assert abs(errors[0]) < 0.01
    assert_second_order(errors[:, None], 3.5, 4.5)


@pytest.mark.parametrize("twist", [170.0, 190.0, 360.0, -400.0])
def test_whole_turns_of_twist_count(twist: float) -> None:
    """A straight rod clamped at both ends carries GJ twist/L, also beyond half a turn (exact: 1e-9)."""
    cable = Section(length=10.0, d=0.05, mass=1.0, EA=1e6, EI=10.0, GJ=10.0, wet_weight=0.0)
    scene = Scene(
        cable=(cable,),
        end_a=End(kind="clamped", position=(0, 0, 0), direction=(1, 0, 0)),
        end_b=End(kind="clamped", position=(10.001, 0, 0), direction=(1, 0, 0), twist=twist),
    )
    found = solve(scene, Ask(model="rod", segments=60))
    assert found.status == Status.OK
    np.testing.assert_allclose(found.signals["torque"][0], 10.0 * np.radians(twist) / 10.0, rtol=1e-9)
