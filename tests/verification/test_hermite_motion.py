"""The Hermite line in motion: its ledger with every method, its order, its agreement with other lines and programs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from march_kit import REFERENCE, TABLES
from test_energy import SCENES
from test_transients import bare_cable

from solvers import (
    Ask,
    Current,
    End,
    Harmonic,
    Motion,
    Response,
    Scene,
    Seabed,
    Section,
    Status,
    Water,
    Window,
    solve,
)
from solvers.methods import esdirk

PLANAR = [name for name, scene in SCENES.items() if not scene.devices and "space" not in name]
FINE = (Status.OK, Status.UNRESOLVED)  # 16 elements are few for what some scenes do; that is no matter of energy


@pytest.mark.parametrize("method", ["trbdf2", "dopri5", "esdirk4"])
@pytest.mark.parametrize("name", PLANAR)
def test_ledger_closes(name: str, method: str) -> None:
    """Below the 1e-3 of a trusted run at each method's own tolerance: drag, current, bed, friction, slack, damping of
    bending, added mass that turns with the line."""
    run = solve(SCENES[name], Ask(duration=3.0, segments=16, interval=0.02, model="hermite", method=method))
    assert run.status in FINE, run.message
    assert len(run.t) == 151
    assert run.energy_residual < 1e-3


def waveform(run: Response, stations: int = 20) -> np.ndarray:
    """x at equal parts of the cable (nt, stations + 1) [m]."""
    count = len(run.signals["arc"]) - 1
    assert count % stations == 0
    return run.signals["position"][:, :: count // stations, 0] - run.signals["static_position"][:: count // stations, 0]


def error(run: Response, truth: np.ndarray) -> float:
    return math.sqrt(float(((waveform(run) - truth) ** 2).sum() / (truth**2).sum()))


def damped() -> Scene:
    """The bare cable of paper 003 with the study's BA."""
    scene = bare_cable(640)
    return replace(scene, cable=(replace(scene.cable[0], BA=1533.0),))


def test_smooth_pulse_is_of_order_4_at_least() -> None:
    """The same harmonics under a smooth window, against 60 elements: the corrected inertia makes it 5 and more; 160
    lumped segments leave 3 %, 20 elements 0.2 %. Output is cubic between the steps, some 3e-4."""
    scene = damped()
    smooth = Window(stop=0.5, ramp_up=0.25, ramp_down=0.25, shape="smooth")
    scene = replace(scene, end_b=replace(scene.end_b, motion=replace(scene.end_b.motion, window=smooth)))
    runs = {
        n: solve(scene, Ask(duration=1.0, segments=n, interval=4e-3, model="hermite", method="esdirk4", tolerance=1e-6))
        for n in (10, 15, 20, 60)
    }
    truth = waveform(runs[60])
    found = [error(runs[n], truth) for n in (10, 15, 20)]
    orders = np.diff(np.log(found)) / np.diff(np.log([1 / 10, 1 / 15, 1 / 20]))
    assert (orders > 4.0).all(), orders
    assert found[2] < 2e-3
    assert runs[60].trusted, runs[60].message


def test_sharp_pulse_is_of_order_2() -> None:
    """Eq. (3.4) starts and stops with a jump of velocity, whose waves fall off slowly: order 2, as of lumped segments,
    at a sixth of the nodes. Against MoorDyn with 640 segments, itself good to 0.6 %, 40 elements are within 1.5 %."""
    runs = {
        n: solve(damped(), Ask(duration=2.0, segments=n, interval=4e-3, model="hermite", method="esdirk4"))
        for n in (15, 20, 30, 40, 80)
    }
    truth = waveform(runs[80])
    found = [error(runs[n], truth) for n in (15, 20, 30, 40)]
    order = -np.polyfit(np.log([15, 20, 30, 40]), np.log(found), 1)[0]
    assert order == pytest.approx(2.0, abs=0.3)
    known = np.load(REFERENCE / "plain_cable.npz")["x"]
    assert error(runs[40], known) < 0.015
    assert error(runs[20], known) < 0.05
    assert runs[20].trusted, runs[20].message


def test_methods_agree_on_the_pulse() -> None:
    """Explicit and implicit marches of one mesh: the same waveform to 1 % and 0.3 %, energy booked alike."""
    ask = Ask(duration=1.0, segments=20, interval=4e-3, model="hermite")
    best = solve(damped(), replace(ask, method="dopri5"))
    for method, limit in (("trbdf2", 0.01), ("esdirk4", 0.003)):
        run = solve(damped(), replace(ask, method=method))
        assert error(run, waveform(best)) < limit
        for entry in ("kinetic", "strain", "work", "lost_water", "rotation"):
            size = np.abs(best.signals["kinetic"]).max()
            np.testing.assert_allclose(run.signals[entry], best.signals[entry], atol=0.02 * size, err_msg=entry)


def touchdown() -> Scene:
    """A line with drag, added mass, a sheared current, bending and friction on a bed, moved at a slanting clamp."""
    cable = Section(
        length=30.0, d=0.08, mass=9.0, EA=2e5, EI=50.0, BA=200.0, BI=2.0, Can=0.9, Cat=0.3, Cdn=1.1, Cdt=0.05
    )
    sway = Motion(
        harmonics=(Harmonic(amplitude=(0.5, 0, 0.3), frequency=0.4),), window=Window(ramp_up=1.0, shape="smooth")
    )
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, -10)),
        end_b=End(kind="clamped", position=(24, 0, -2), direction=(1, 0, 1), motion=sway),
        water=Water(depth=10.0, current=Current(z=(-10, 0), velocity=((0.1, 0, 0), (0.5, 0, 0)))),
        seabed=Seabed(z=-10.0, stiffness=1e4, damping=300.0, friction=0.5, friction_speed=0.1),
    )  # fmt: skip


def test_agrees_with_fine_lumped_segments() -> None:
    """60 elements against 200 lumped segments (1.3 % from 120 elements, 300 of them 0.6 %): positions to 2 % of the
    motion (rms), tension at the moved end to 1.5 % of its range, curvature at rest to 3 %."""
    ask = Ask(duration=3.0, interval=0.05)
    fine = solve(touchdown(), replace(ask, segments=200, model="lumped", method="dopri5"))
    run = solve(touchdown(), replace(ask, segments=60, model="hermite", method="esdirk4"))
    assert run.status == Status.OK, run.message
    s = fine.signals["arc"]
    place = np.stack([
        [np.interp(s, run.signals["arc"], x[:, c]) for c in (0, 2)] for x in run.signals["position"]
    ])  # fmt: skip
    truth = fine.signals["position"][:, :, [0, 2]].transpose(0, 2, 1)
    assert math.sqrt(((place - truth) ** 2).mean() / ((truth - truth[0]) ** 2).mean()) < 0.02
    pull, known = (np.linalg.norm(r.signals["end_force"][:, 1], axis=1) for r in (run, fine))
    assert np.abs(pull - known).max() < 0.015 * np.ptp(known)
    bend = np.interp(s, run.signals["arc"], run.signals["curvature"][0])
    inner = slice(4, -4)  # not at the clamp, where lumped curvature is that of half a segment
    assert np.abs(bend - fine.signals["curvature"][0])[inner].max() < 0.03 * bend.max()
    np.testing.assert_allclose(run.signals["lost_water"][-1], fine.signals["lost_water"][-1], rtol=0.01)
    np.testing.assert_allclose(run.signals["lost_seabed"][-1], fine.signals["lost_seabed"][-1], rtol=0.1)


def test_esdirk_table() -> None:
    """Row sums, stiff accuracy, order 4 and the embedded order 3 of Kennedy & Carpenter's ARK4(3)6L[2]SA."""
    A, c, e = esdirk.TABLE.A, esdirk.TABLE.c, esdirk.TABLE.e
    np.testing.assert_allclose(c, [0, 1 / 2, 83 / 250, 31 / 50, 17 / 20, 1], atol=1e-15)
    np.testing.assert_allclose(np.diag(A)[1:], esdirk.GAMMA, atol=0)
    conditions = {
        1: [(np.ones(6), 1)], 2: [(c, 2)], 3: [(c**2, 3), (A @ c, 6)],
        4: [(c**3, 4), (c * (A @ c), 8), (A @ c**2, 12), (A @ (A @ c), 24)],
    }  # fmt: skip
    for b, order in ((A[-1], 4), (A[-1] - e, 3)):
        for k in range(1, order + 1):
            for phi, gamma in conditions[k]:
                assert b @ phi == pytest.approx(1 / gamma, abs=1e-14)
    assert max(abs((A[-1] - e) @ phi - 1 / gamma) for phi, gamma in conditions[4]) > 1e-4
    assert "esdirk4" not in TABLES  # it is no explicit table


def test_periodic_response() -> None:
    """Harmonic balance on the same residual and tangent: the settled tension of a hung line in surge, as in time."""
    sway = Motion(harmonics=(Harmonic(amplitude=(0.6, 0, 0), frequency=0.2),), window=Window(ramp_up=5.0))
    cable = Section(length=40.0, d=0.1, mass=12.0, EA=1e6, EI=100.0, BA=500.0, Cdn=1.2)
    scene = Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, -30)), water=Water(),
        end_b=End(kind="pinned", position=(22, 0, -2), motion=sway),
    )  # fmt: skip
    ask = Ask(duration=30.0, output_from=25.0, segments=12, interval=0.05, model="hermite")
    settled = solve(scene, replace(ask, method="harmonic"))
    assert settled.status == Status.OK, settled.message
    march = solve(scene, replace(ask, method="esdirk4"))
    T, known = (np.linalg.norm(r.signals["end_force"][:, 1], axis=1) for r in (settled, march))
    assert np.abs(T - known).max() < 0.02 * np.ptp(known)
