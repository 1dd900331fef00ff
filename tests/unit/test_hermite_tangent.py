"""The Hermite line's analytic tangent and mass solve, its energy, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
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
    Water,
    Window,
    solve,
)
from solvers.catalogue import cheapest
from solvers.dispatch import KINETIC, N_ENERGIES, STRAIN, call_accelerate, call_energies, call_residual, call_tangent
from solvers.lines.hermite import HermiteModel
from solvers.lines.hermite.params import Hermite


def scene(*, water: bool = True, current: bool = False, bed: bool = False, slack: bool = False) -> Scene:
    """Two sections between a slanting clamp and a moved pin."""
    cable = Section(
        length=6.0, d=0.1, mass=10.0, EA=1e6, EI=0.0 if slack else 2e3, BA=300.0, BI=0.0 if slack else 40.0,
        Can=0.9, Cat=0.2, Cdn=1.1, Cdt=0.1, compression=False if slack else None,
    )  # fmt: skip
    flow = Current(z=(-10, -5, 0), velocity=((0.1, 0, 0), (0.4, 0, 0), (1.0, 0, 0))) if current else None
    motion = Motion(harmonics=(Harmonic(amplitude=(0.1, 0, 0), frequency=0.5),), window=Window(ramp_up=0.1))
    return Scene(
        cable=(cable, replace(cable, length=4.0, mass=14.0, EA=2e6, Can=1.2)),
        end_a=End(kind="pinned", position=(0, 0, -10)) if slack else
        End(kind="clamped", position=(0, 0, -10), direction=(0.3, 0, 1)),
        end_b=End(kind="pinned", position=(2.0, 0, -0.5), motion=motion),
        water=Water(depth=9.0 if bed else None, current=flow) if water else None,
        seabed=Seabed(z=-9.0, stiffness=2e4, damping=500.0, friction=0.4, friction_speed=0.5) if bed else None,
    )  # fmt: skip


CASES = {
    "air": {"water": False},
    "water": {},
    "current": {"current": True},
    "bed": {"bed": True, "current": True},
    "slack": {"slack": True},
}


def state(model: HermiteModel, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A shape bent and strained at random, some of it slack, and fast motion."""
    draw, n = np.random.default_rng(seed), model.ndof
    q = model.place(lambda s: 1.001 * model.straight(s)) + 0.02 * draw.standard_normal(n)
    return q, 0.5 * draw.standard_normal(n), 2.0 * draw.standard_normal(n)


def lossless(model: HermiteModel) -> Hermite:
    """The model's pack without internal damping."""
    pack = model.pack
    return pack._replace(BA=0 * pack.BA, BI=0 * pack.BI, relents=0 * pack.relents)


@pytest.mark.parametrize("case", CASES)
def test_tangent_matches_differences(case: str) -> None:
    """1e-8 of each row's largest entry, what the rounding of central differences with these steps leaves (1e-9 in q and
    a, 2e-8 in v where drag is small against the rest). F is linear in a."""
    model = HermiteModel(scene(**CASES[case]), 8)
    q, v, a = state(model, 3)
    check_tangent(model.pack, q, v, a, (1e-5, 1e-4, 1.0), 1e-8)


@pytest.mark.parametrize("case", CASES)
def test_acceleration_solves_the_residual(case: str) -> None:
    """The banded Cholesky solve leaves no residual at the free dofs, and the same end force: to rounding."""
    model = HermiteModel(scene(**CASES[case]), 8)
    pack, n = model.pack, model.ndof
    q, v, _ = state(model, 4)
    a, r, check = np.zeros(n), np.zeros(n), np.zeros(n)
    a[pack.fixed] = 1.0 + np.arange(len(pack.fixed))
    call_accelerate(0.0, q, v, a, pack, r)
    call_residual(0.0, q, v, a, pack, check)
    free = np.setdiff1d(np.arange(n), pack.fixed)
    scale = np.abs(r).max()
    assert np.abs(check[free]).max() < 1e-12 * scale
    np.testing.assert_allclose(r[pack.fixed], check[pack.fixed], atol=1e-12 * scale)


def test_stiffness_and_inertia_are_symmetric() -> None:
    """An energy's Hessian and an inertia, with slopes turned at the clamp: to rounding."""
    model = HermiteModel(scene(water=False), 8)
    pack = lossless(model)
    q, v, a = state(model, 5)
    for factors in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
        J = np.zeros((model.ndof, 2 * pack.bw + 1))
        call_tangent(0.0, q, v, a, *factors, pack, J)
        A = dense(J, pack.bw)
        assert np.abs(A - A.T).max() < 1e-13 * np.abs(A).max()


def test_forces_are_the_gradient_of_the_energy() -> None:
    """Without water and damping the power of F is the rate of kinetic and strain energy less that of the loads; by
    central differences, whose error is 1e-8 at this step."""
    model = HermiteModel(scene(water=False), 8)
    pack = lossless(model)._replace(load=0 * model.pack.load)
    q, v, a = state(model, 7)
    r, up, down = np.zeros(model.ndof), np.zeros(N_ENERGIES), np.zeros(N_ENERGIES)
    call_residual(0.0, q, v, a, pack, r)
    h = 1e-6
    call_energies(0.0, q + h * v, v + h * a, a, pack, up)
    call_energies(0.0, q - h * v, v - h * a, a, pack, down)
    change = ((up - down)[STRAIN] + (up - down)[KINETIC]) / (2 * h)
    assert change == pytest.approx(float(r @ v), rel=1e-7)


def test_rigid_motion_strains_nothing() -> None:
    """Moved far away and turned as a whole, the line has the same energy to rounding of the coordinates: 1e-9."""
    model = HermiteModel(scene(water=False, slack=True), 8)
    q, v, a = state(model, 8)
    c, s = np.cos(0.7), np.sin(0.7)
    turned = (q.reshape(-1, 2, 2) @ np.array([[c, s], [-s, c]])).reshape(-1, 4)
    turned[:, :2] += [100.0, -40.0]
    found = []
    for x in (q, turned.ravel()):
        e = np.zeros(N_ENERGIES)
        call_energies(0.0, x, 0 * v, a, model.pack, e)
        found.append(e[STRAIN])
    assert found[1] == pytest.approx(found[0], rel=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"devices": (TMD(s=3.0, mass=1.0, k=10.0),)}, r"devices\[0\].kind: tmd"),
        ({"end_b": End(kind="pinned", position=(8, 3, -0.5)),
          "end_a": End(kind="clamped", position=(0, 0, -10), direction=(1, 0, 0))}, "vertical plane"),
    ],
    ids=["device", "space"],
)  # fmt: skip
def test_what_it_refuses(change: dict, words: str) -> None:
    """A scene that asks for more is refused before the run, with the field's name."""
    with pytest.raises(CannotRepresent, match=words):
        HermiteModel(replace(scene(), **change), 8)


def test_the_catalogue_knows_it() -> None:
    """Devices are refused by the feature's name before the run; the mesh is chosen by Hermite elements' own error; a
    line with constraints is not marched by esdirk4."""
    with pytest.raises(CannotRepresent, match=r"hermite cannot represent DEVICE; .*lumped"):
        solve(replace(scene(), devices=(TMD(s=3.0, mass=1.0, k=10.0),)), Ask(duration=1.0, model="hermite"))
    moved = replace(scene().end_b, motion=Motion(harmonics=(Harmonic(amplitude=(0.01, 0, 0), frequency=40.0),)))
    fast = replace(scene(), end_b=moved)
    few, many = (cheapest(fast, Ask(duration=1.0, model=model, accuracy=0.01)) for model in ("hermite", "lumped"))
    assert 2 * few.segments < many.segments
    assert few.error <= 0.01
    still = tuple(replace(x, BA=0.0, BI=0.0) for x in scene().cable)
    with pytest.raises(CannotRepresent, match="esdirk4: rod has constraints"):
        solve(replace(scene(), cable=still), Ask(duration=1.0, segments=10, model="rod", method="esdirk4"))
