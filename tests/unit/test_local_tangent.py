"""The local line's analytic tangent and mass solve, its energy, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tangent_kit import check_tangent, dense

from solvers import TMD, CannotRepresent, Current, End, Harmonic, Motion, Scene, Seabed, Section, Start, Status, Water
from solvers.dispatch import KINETIC, N_ENERGIES, STRAIN, call_accelerate, call_energies, call_residual, call_tangent
from solvers.lines.local import LocalModel, build

ROPE = {"length": 7.0, "d": 0.1, "mass": 10.0, "EA": 1e6, "BA": 300.0, "Can": 0.9, "Cdn": 1.1, "Cdt": 0.1}
MOTION = Motion(harmonics=(Harmonic(amplitude=(0.1, 0, 0.05), frequency=0.5),))


def scene(*, bending: bool, flow: bool, **change) -> Scene:
    """A sagged cable of two sections, moved at its upper end."""
    stiff = {"EI": 60.0, "BI": 4.0} if bending else {}
    cable = (Section(**ROPE, **stiff), Section(**{**ROPE, "length": 4.0, "mass": 14.0, "EA": 2e6, "Cat": 0.3}, **stiff))
    current = Current(z=(-6, -3, 0), velocity=((0.1, 0, 0), (0.4, 0, 0.1), (1.0, 0, 0))) if flow else None
    ends = {
        "end_a": End(kind="pinned", position=(0, 0, -6)),
        "end_b": End(kind="pinned", position=(8.0, 0, -0.5), motion=MOTION),
    }
    return Scene(**{"cable": cable, "water": Water(current=current), **ends, **change})


def state(model: LocalModel, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacements that strain the line by some 0.05, so that (1 + e)^1/2 shows, and fast motion."""
    draw = np.random.default_rng(seed)
    n = model.ndof
    return 0.03 * draw.standard_normal(n), 0.5 * draw.standard_normal(n), 2.0 * draw.standard_normal(n)


@pytest.mark.parametrize("flow", [False, True], ids=["still", "current"])
@pytest.mark.parametrize("bending", [False, True], ids=["rope", "beam"])
def test_tangent_matches_differences(bending: bool, flow: bool) -> None:
    """To 1e-7 of each row's largest entry: central differences with steps of 1e-4 of a function that is piecewise
    quadratic but for (1 + e)^1/2, and linear in a."""
    model = LocalModel(scene(bending=bending, flow=flow), 11)
    check_tangent(model.pack, *state(model, 3), (1e-4, 1e-4, 1.0), 1e-7)


def test_strain_in_the_drag_is_in_the_tangent() -> None:
    """The derivative of the drag's (1 + e)^1/2 alone, which the stiffness hides: EA, T, EI taken away."""
    model = LocalModel(scene(bending=True, flow=True), 11)
    p = model.pack
    bare = p._replace(EA=0 * p.EA, geo=0 * p.geo, Qs=0 * p.Qs, stiff=0 * p.stiff)
    q, v, a = state(model, 5)
    J = np.zeros((model.ndof, 2 * p.bw + 1))
    call_tangent(0.0, q, v, a, 1.0, 0.0, 0.0, bare, J)
    way, up, down = np.random.default_rng(6).standard_normal(model.ndof), np.zeros(model.ndof), np.zeros(model.ndof)
    call_residual(0.0, q + 1e-5 * way, v, a, bare, up)
    call_residual(0.0, q - 1e-5 * way, v, a, bare, down)
    slope = dense(J, p.bw) @ way
    assert np.abs(slope).max() > 1.0
    np.testing.assert_allclose((up - down) / 2e-5, slope, atol=1e-7 * np.abs(slope).max())


@pytest.mark.parametrize("bending", [False, True], ids=["rope", "beam"])
def test_acceleration_solves_the_residual(bending: bool) -> None:
    """To rounding: no residual at the free dofs, and the same force at the ends."""
    model = LocalModel(scene(bending=bending, flow=True), 11)
    pack, n = model.pack, model.ndof
    q, v, a = state(model, 4)
    r, check = np.zeros(n), np.zeros(n)
    call_accelerate(0.0, q, v, a, pack, r)
    call_residual(0.0, q, v, a, pack, check)
    free = np.setdiff1d(np.arange(n), pack.fixed)
    assert np.abs(check[free]).max() < 1e-12 * np.abs(r).max()
    np.testing.assert_allclose(r[pack.fixed], check[pack.fixed], atol=1e-12 * np.abs(r).max())


def test_forces_are_the_gradient_of_the_energy() -> None:
    """Without water and damping the energies' derivative along any motion is the power of F; quadratic, so exact."""
    model = LocalModel(scene(bending=True, flow=False, water=None), 11)
    pack = model.pack._replace(BA=0 * model.pack.BA, damp=0 * model.pack.damp)
    q, v, a = state(model, 7)
    r, up, down = np.zeros(model.ndof), np.zeros(N_ENERGIES), np.zeros(N_ENERGIES)
    call_residual(0.0, q, v, a, pack, r)
    h = 1e-3
    call_energies(0.0, q + h * v, v + h * a, a, pack, up)
    call_energies(0.0, q - h * v, v - h * a, a, pack, down)
    change = ((up - down)[STRAIN] + (up - down)[KINETIC]) / (2 * h)
    assert change == pytest.approx(float(r @ v), rel=1e-10)


def test_a_translation_strains_nothing() -> None:
    """Exact derivatives in the turning frame: moving all nodes alike leaves e = phi = 0 to rounding."""
    model = LocalModel(scene(bending=False, flow=False), 11)
    c, s = np.cos(model.angle), np.sin(model.angle)
    for x, z in ((1.0, 0.0), (0.0, 1.0)):
        q = np.column_stack([x * c + z * s, z * c - x * s]).ravel()
        e, phi = model.strains(q)
        assert max(np.abs(e).max(), np.abs(phi).max()) < 1e-14
        np.testing.assert_allclose(model.world(q), np.tile([x, 0.0, z], (model.nodes, 1)), atol=1e-14)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"end_a": End(kind="clamped", position=(0, 0, -6), direction=(1, 0, 0))}, "end_a.kind: clamped"),
        ({"end_b": End(kind="free")}, "end_b.kind: free"),
        ({"devices": (TMD(s=3.0, mass=1.0, k=10.0),)}, r"devices\[0\].kind: tmd"),
        ({"seabed": Seabed(z=-6.0)}, "seabed"),
        ({"start": Start(kind="given", shape=((0, 0, -6), (8, 0, -0.5)))}, "start.kind: given"),
        ({"end_b": End(kind="pinned", position=(8, 3, -0.5), motion=MOTION)}, "vertical plane"),
        ({"end_b": End(kind="pinned", position=(0, 0, 4.9))}, "segment 0 has a tension of -"),
    ],
    ids=["clamped", "free", "device", "seabed", "given", "space", "slack at rest"],
)
def test_what_it_refuses(change: dict, words: str) -> None:
    """A scene that asks for more is refused before the run, with the field's name."""
    with pytest.raises(CannotRepresent, match=words):
        build(scene(bending=False, flow=False, **change), 11)


def test_a_run_that_goes_slack_is_told() -> None:
    """`validity` names the segment, unless the section carries compression."""
    rope = LocalModel(scene(bending=False, flow=False), 11)
    signals = {"tension": np.ones((3, rope.segments))}
    assert rope.validity(signals) == (Status.OK, "")
    signals["tension"][1, 4] = -2.0
    status, words = rope.validity(signals)
    assert status == Status.CANNOT_REPRESENT
    assert "segment 4 goes slack" in words
    beam = LocalModel(scene(bending=True, flow=False), 11)
    assert beam.validity(signals)[0] == Status.OK


def test_either_way_round() -> None:
    """A line drawn from right to left, and one that floats up, are the same line: forces mirrored to rounding."""
    right = scene(bending=True, flow=False)
    left = replace(right, end_b=End(kind="pinned", position=(-8.0, 0, -0.5)))
    up = replace(
        right, end_a=End(kind="pinned", position=(0, 0, 6)),
        end_b=End(kind="pinned", position=(8, 0, 0.5)),
        cable=tuple(replace(s, wet_weight=-s.wet(right.density, right.g)) for s in right.cable),
    )  # fmt: skip
    found = []
    for one in (right, left, up):
        model = LocalModel(one, 11)
        zero = np.zeros((1, model.ndof))
        found.append(model.observe(zero, zero, np.zeros((1, 4)), zero[0])["end_force"][0])
    np.testing.assert_allclose(found[1], found[0] * [-1, 1, 1], rtol=1e-9)
    np.testing.assert_allclose(found[2], found[0] * [1, 1, -1], rtol=1e-9)
