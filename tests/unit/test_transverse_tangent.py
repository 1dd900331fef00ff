"""The transverse line's matrices, tangent, mass solve and energy, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tangent_kit import dense

from solvers import (
    BNES,
    TMD,
    CannotRepresent,
    CubicNES,
    Current,
    End,
    Harmonic,
    Motion,
    Scene,
    Seabed,
    Section,
    Start,
    Water,
)
from solvers.dispatch import (
    GRAVITY,
    KINETIC,
    N_ENERGIES,
    STRAIN,
    WATER,
    call_accelerate,
    call_energies,
    call_residual,
    call_tangent,
)
from solvers.lines.transverse import TransverseModel, build
from solvers.lines.transverse.params import SHORT
from solvers.scene import PointMass

MOTION = Motion(harmonics=(Harmonic(amplitude=(0.05, 0, 0.01), frequency=0.5),))
ROPE = {"length": 6.0, "d": 0.1, "mass": 10.0, "EA": 1e6, "BA": 300.0, "Can": 0.9, "Cdn": 1.1, "Cdt": 0.1}
STIFF = {"EI": 600.0, "BI": 4.0}
DEVICES = (
    BNES(s=3.0, mass=2.0, EA=1e4, BA=3.0, length=0.5, phi0=6.0, law="springs", rod="cords", drag=0.05, volume=0.001),
    CubicNES(s=5.0, mass=1.5, EA=1e4, BA=2.0, drag=0.02, direction=(-1.0, 0, 0)),
    PointMass(s=7.0, mass=3.0, rod=0.6, rod_EA=1e7),
    TMD(s=8.5, mass=1.0, k=300.0, c=4.0, volume=0.002),
)


def scene(*, bends: tuple[bool, bool] = (True, True), **change) -> Scene:
    """A slanting cable of two sections with every kind of device, in a current."""
    cable = tuple(
        Section(**{**ROPE, **more, **(STIFF if bend else {"compression": True})})
        for more, bend in zip(({}, {"length": 4.0, "mass": 14.0, "EA": 2e6}), bends, strict=True)
    )
    ends = {
        "end_a": End(kind="clamped", position=(0, 0, -9), direction=(1, 0, 2)),
        "end_b": End(kind="pinned", position=(4.4, 0, 0), motion=MOTION),
    }
    current = Current(z=(-9, 0), velocity=((0.1, 0, 0), (0.6, 0, 0.1)))
    return Scene(**{"cable": cable, "water": Water(current=current), "devices": DEVICES, **ends, **change})


def state(model: TransverseModel, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    n = model.ndof
    return 0.05 * draw.standard_normal(n), 0.5 * draw.standard_normal(n), 2.0 * draw.standard_normal(n)


def whole_tangent(model: TransverseModel, q: np.ndarray, v: np.ndarray, which: int) -> np.ndarray:
    """dF/dq, dF/dv or dF/da, with the change of the mean tension that the banded tangent leaves out: g = de/dq,
    dN = pull g.dq + loss (g.dv + v.G dq)."""
    p, n = model.pack, model.ndof
    J = np.full((n, 2 * p.bw + 1), np.nan)
    call_tangent(0.0, q, v, np.zeros(n), *(float(m == which) for m in range(3)), p, J)
    g = model.dense.G @ q
    g[0], g[-1] = -1.0, 1.0
    change = (p.pull * g + p.loss * model.dense.G @ v, p.loss * g, np.zeros(n))[which]
    return dense(J, p.bw) + np.outer(g, change)


@pytest.mark.parametrize(("bends", "scaling"), [
    ((True, True), None), ((True, False), None), ((False, False), None), ((True, True), 5.0), ((False, False), 4.0),
], ids=["beam", "half", "string", "slowed beam", "slowed string"])  # fmt: skip
def test_tangent_matches_differences(bends: tuple[bool, bool], scaling: float | None) -> None:
    """To 1e-7 of each row's largest entry: central differences of 3e-6 m (1e-4 m/s, 1 m/s2 in v and a, where F is
    quadratic and linear) of a function that is cubic but for the devices' laws."""
    model = TransverseModel(scene(bends=bends), 12, scaling)
    x = list(state(model, 3))
    n = model.ndof
    for which, step in enumerate((3e-6, 1e-4, 1.0)):
        analytic, numeric = whole_tangent(model, x[0], x[1], which), np.zeros((n, n))
        for j in range(n):
            pair = []
            for sign in (1, -1):
                moved = [y.copy() for y in x]
                moved[which][j] += sign * step
                r = np.zeros(n)
                call_residual(0.0, *moved, model.pack, r)
                pair.append(r)
            numeric[:, j] = (pair[0] - pair[1]) / (2 * step)
        scale = np.abs(analytic).max(axis=1, keepdims=True)
        scale[scale == 0] = np.abs(analytic).max()
        assert (np.abs(analytic - numeric) / scale).max() < 1e-7, which


@pytest.mark.parametrize(("bends", "segments", "scaling"), [
    ((True, True), 12, None), ((False, False), 12, None), ((True, True), 12, 5.0), ((True, True), 160, None),
], ids=["beam", "string", "slowed", "by bands"])  # fmt: skip
def test_acceleration_solves_the_residual(bends: tuple[bool, bool], segments: int, scaling: float | None) -> None:
    """To rounding: no residual at the free dofs, and the same force at the ends."""
    model = TransverseModel(scene(bends=bends), segments, scaling)
    assert (len(model.pack.give) == 0) == (model.ndof > SHORT)
    q, v, a = state(model, 4)
    r, check = np.zeros(model.ndof), np.zeros(model.ndof)
    call_accelerate(0.0, q, v, a, model.pack, r)
    call_residual(0.0, q, v, a, model.pack, check)
    free = np.setdiff1d(np.arange(model.ndof), model.pack.fixed)
    assert np.abs(check[free]).max() < 1e-12 * np.abs(r).max()
    np.testing.assert_allclose(r[model.pack.fixed], check[model.pack.fixed], atol=1e-12 * np.abs(r).max())


@pytest.mark.parametrize("scaling", [None, 5.0])
def test_power_balances(scaling: float | None) -> None:
    """F.v is the rate of kinetic, strain and gravity energy plus what is lost, for any motion: central differences of
    1e-5 s of energies that are quartic in q, to 1e-8."""
    model = TransverseModel(scene(), 12, scaling)
    q, v, a = state(model, 7)
    r, e = np.zeros(model.ndof), [np.zeros(N_ENERGIES) for _ in range(3)]
    call_residual(0.0, q, v, a, model.pack, r)
    h = 1e-5
    for k, t in enumerate((h, -h, 0.0)):
        call_energies(t, q + t * v + t * t / 2 * a, v + t * a, a, model.pack, e[k])
    change = sum((e[0] - e[1])[k] for k in (KINETIC, STRAIN, GRAVITY)) / (2 * h)
    assert change + e[2][WATER:].sum() == pytest.approx(float(r @ v), rel=1e-8)


def test_mass_is_that_of_the_line_and_its_devices() -> None:
    """Moved as a rigid body across the chord, the line weighs its mass, added mass and devices, sliding masses too,
    and its linear inertia about end A is int m s2 ds: exact, both fields are in the space."""
    one = scene()
    model = TransverseModel(one, 12)
    S = one.cable
    per = [x.mass + 1025.0 * 0.9 * np.pi / 4 * 0.01 for x in S]
    rigid, turned = np.zeros(model.ndof), np.zeros(model.ndof)
    for knots, E in zip(model.mesh.knots, model.space.parts, strict=True):
        inner = np.flatnonzero(E[2 : len(knots)].any(axis=0))
        greville = np.array([knots[max(j - 2, 0) : j + 1].mean() for j in range(2, len(knots))])
        rigid[inner], turned[inner] = 1.0, greville
    m = model.mesh.mounts
    rigid[model.space.place], turned[model.space.place] = 1.0, [x.s for x in m]
    turned[model.space.turn[model.space.turn >= 0]] = 1.0
    M = model.dense.M
    assert rigid @ M @ rigid == pytest.approx(6 * per[0] + 4 * per[1] + sum(d.mass for d in DEVICES), rel=1e-12)
    about = per[0] * 6**3 / 3 + per[1] * (10**3 - 6**3) / 3 + sum(d.mass * d.s**2 for d in DEVICES)
    assert turned @ M @ turned == pytest.approx(about, rel=1e-12)
    assert np.abs(model.dense.B @ np.column_stack([rigid, turned])).max() < 1e-6
    assert turned @ model.dense.G @ turned == pytest.approx(10.0 * 10.0 / model.chord.length, rel=1e-12)


def test_static_state_is_one() -> None:
    """No residual at the free dofs but where a mass still has to find its place."""
    model = TransverseModel(scene(), 12)
    zero, r = np.zeros(model.ndof), np.zeros(model.ndof)
    call_residual(0.0, model.rest, zero, zero, model.pack, r)
    rows = np.setdiff1d(np.arange(model.ndof), [*model.pack.fixed, *model.pack.slot])
    assert np.abs(r[rows]).max() < 1e-9 * np.abs(r).max()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"end_b": End(kind="free")}, "end_b.kind: free"),
        ({"devices": (BNES(kind="bnes_free", s=3.0, mass=1.0, EA=1e5),)}, r"devices\[0\].kind: bnes_free"),
        ({"seabed": Seabed(z=-9.0)}, "seabed"),
        ({"start": Start(kind="given", shape=((0, 0, -9), (4.4, 0, 0)))}, "start.kind: given"),
        ({"end_b": End(kind="pinned", position=(4, 1, 0))}, "vertical plane"),
        ({"end_b": End(kind="pinned", position=(4.0, 0, -0.5)), "devices": (), "water": None, "g": 0.0,
          "end_a": End(kind="pinned", position=(0, 0, -9))}, "buckles"),
    ],
    ids=["free", "particle", "seabed", "given", "space", "buckled"],
)  # fmt: skip
def test_what_it_refuses(change: dict, words: str) -> None:
    """A scene that asks for more is refused before the run, with the field's name."""
    with pytest.raises(CannotRepresent, match=words):
        build(scene(**change), 12)


def test_either_way_round() -> None:
    """A line drawn from right to left is the same line, forces and offsets mirrored to rounding."""
    right = scene(devices=(PointMass(s=3.0, mass=4.0, volume=0.0),), end_a=End(kind="pinned", position=(0, 0, -9)))
    flip = Current(z=(-9, 0), velocity=((-0.1, 0, 0), (-0.6, 0, 0.1)))
    left = replace(right, water=Water(current=flip), end_b=End(kind="pinned", position=(-4.4, 0, 0)))
    found = []
    for one in (right, left):
        model = TransverseModel(one, 12)
        zero, r = np.zeros(model.ndof), np.zeros(model.ndof)
        call_residual(0.0, model.rest, zero, zero, model.pack, r)
        s = model.observe(model.rest[None], zero[None], r[model.pack.fixed][None], model.rest)
        found.append((s["end_force"][0], s["static_position"]))
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(b * [-1, 1, 1], a, atol=1e-9 * np.abs(a).max())
