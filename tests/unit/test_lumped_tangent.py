"""Analytic tangents against central differences, in the plane and in space, term by term and all together."""

from __future__ import annotations

import numpy as np
import pytest
from tangent_kit import check_tangent

from solvers import BNES, TMD, Current, End, Harmonic, Motion, PointMass, Scene, Seabed, Section, Water, Window
from solvers.dispatch import call_accelerate, call_residual
from solvers.lines.lumped import LumpedModel


def scene(spatial: bool, *, rods: bool, devices: bool, bed: bool, current: bool, slack: bool) -> Scene:
    y = 0.3 if spatial else 0.0
    cable = Section(
        length=10.0, d=0.1, mass=10.0, EA=1e6, EI=0.0 if slack else 2e3, BA=300.0, BI=0.0 if slack else 40.0,
        Can=0.9, Cat=0.2, Cdn=1.1, Cdt=0.1, compression=False if slack else None,
    )  # fmt: skip
    rod = 0.9 if rods else None
    aim = (0.8, 0.6, 0.0) if spatial else None
    kit = (
        BNES(s=2.5, mass=3.0, EA=1e5, BA=50.0, rod=rod, drag=0.1, volume=1e-3, direction=aim),
        PointMass(s=4.2, mass=2.0, volume=0.0, drag=0.05),
        TMD(s=6.0, mass=2.5, k=300.0, c=5.0, volume=0.0, rod=rod, direction=aim),
        BNES(kind="bnes_free", s=8.2, mass=1.5, EA=1e5, BA=20.0, drag=0.02, volume=1e-3, rod=rod, direction=aim),
    )
    ends = {
        "end_a": End(kind="pinned", position=(0, 0, -10)) if slack else
        End(kind="clamped", position=(0, 0, -10), direction=(0, 0, 1)),
        "end_b": End(kind="pinned", position=(2.0, y, -0.5), motion=Motion(
            harmonics=(Harmonic(amplitude=(0.1, 0.05 if spatial else 0, 0), frequency=0.5),),
            window=Window(ramp_up=0.1))),
    }  # fmt: skip
    flow = Current(z=(-10, -5, 0), velocity=((0.1, y, 0), (0.4, -y, 0), (1.0, y, 0))) if current else None
    return Scene(
        cable=(cable,), water=Water(depth=9.0 if bed else None, current=flow), devices=kit if devices else (),
        seabed=Seabed(z=-9.0, stiffness=2e4, damping=500.0, friction=0.4, friction_speed=0.5) if bed else None, **ends,
    )  # fmt: skip


CASES = {
    "bare": {"rods": False, "devices": False, "bed": False, "current": False, "slack": False},
    "slack": {"rods": False, "devices": False, "bed": False, "current": False, "slack": True},
    "current": {"rods": False, "devices": False, "bed": False, "current": True, "slack": False},
    "bed": {"rods": False, "devices": False, "bed": True, "current": False, "slack": False},
    "points": {"rods": False, "devices": True, "bed": False, "current": False, "slack": False},
    "rods": {"rods": True, "devices": True, "bed": False, "current": False, "slack": False},
    "all": {"rods": True, "devices": True, "bed": True, "current": True, "slack": False},
}


@pytest.mark.parametrize("spatial", [False, True], ids=["plane", "space"])
@pytest.mark.parametrize("case", CASES)
def test_tangent_matches_differences(case: str, spatial: bool) -> None:
    """1e-6 of each row's largest entry, away from kinks; steps of 1e-6 in q, 1e-4 in v, 1 in a (F is linear in a)."""
    model = LumpedModel(scene(spatial, **CASES[case]), 12)
    assert model.dim == (3 if spatial else 2) or case == "bare"
    pack, n = model.pack, model.ndof
    draw = np.random.default_rng(3)
    q = model.place(model.straight() * 1.001) + 0.02 * draw.standard_normal(n)
    v, a = 0.5 * draw.standard_normal(n), 2.0 * draw.standard_normal(n)
    check_tangent(pack, q, v, a, (1e-6, 1e-4, 1.0), 1e-6)


@pytest.mark.parametrize("spatial", [False, True], ids=["plane", "space"])
@pytest.mark.parametrize("case", CASES)
def test_acceleration_solves_the_residual(case: str, spatial: bool) -> None:
    """The closed-form mass solve leaves no residual at the free dofs, and the same end force."""
    model = LumpedModel(scene(spatial, **CASES[case]), 12)
    pack, n = model.pack, model.ndof
    draw = np.random.default_rng(4)
    q = model.place(model.straight()) + 0.02 * draw.standard_normal(n)
    v, a, r, check = 0.5 * draw.standard_normal(n), np.zeros(n), np.zeros(n), np.zeros(n)
    a[pack.fixed] = 1.0 + draw.standard_normal(len(pack.fixed))
    call_accelerate(0.0, q, v, a, pack, r)
    call_residual(0.0, q, v, a, pack, check)
    free = np.setdiff1d(np.arange(n), pack.fixed)
    scale = np.abs(r).max()
    assert np.abs(check[free]).max() < 1e-12 * scale
    np.testing.assert_allclose(r[pack.fixed], check[pack.fixed], atol=1e-12 * scale)
