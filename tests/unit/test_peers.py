"""Other programs in a chart: which scenes they can run, what they are told, and that they agree with ours."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from study_kit import scene as with_sink

from solvers import Ask, Current, End, Harmonic, Motion, Scene, Seabed, Section, Water, Window, pilot, solve
from sweep import peers

MOVED = Motion(harmonics=(Harmonic(amplitude=(0.3, 0, 0), frequency=0.5),), window=Window(ramp_up=2.0, shape="smooth"))
HUNG = Scene(
    cable=(Section(length=30.0, d=0.05, mass=5.0, EA=1e6, BA=2e3, Cdn=1.2, Cdt=0.1),), water=Water(),
    end_a=End(kind="pinned", position=(0, 0, -40)), end_b=End(kind="pinned", position=(25, 0, -30), motion=MOVED),
)  # fmt: skip
UP = (0.0, 0.0, 1.0)
BEAM = Scene(
    cable=(Section(length=10.0, d=0.08, mass=6.0, EA=1e6, EI=2000.0, BA=500.0, Cdn=1.2),), water=Water(),
    end_a=End(kind="clamped", position=(0, 0, -20), direction=UP),
    end_b=End(kind="clamped", position=(0, 0, -9.995), direction=UP, motion=replace(
        MOVED, harmonics=(Harmonic(amplitude=(0.01, 0, 0), frequency=1.0),))),
)  # fmt: skip
ASK = Ask(duration=4.0, interval=0.02)


@pytest.mark.parametrize(
    ("scene", "ask", "why"),
    [
        (with_sink(), ASK, "devices"),
        (replace(HUNG, seabed=Seabed(z=-50.0)), ASK, "seabed"),
        (replace(HUNG, water=Water(current=Current(z=(-50, 0), velocity=((0, 0, 0), (1, 0, 0))))), ASK, "current"),
        (replace(HUNG, end_a=replace(HUNG.end_a, motion=MOVED)), ASK, "end A"),
        (replace(HUNG, cable=HUNG.cable * 2), ASK, "sections"),
        (replace(HUNG, cable=(replace(HUNG.cable[0], wet_weight=60.0),)), ASK, "above the weight in air"),
        (replace(HUNG, water=None, cable=(replace(HUNG.cable[0], wet_weight=1.0),)), ASK, "no water"),
        (HUNG, Ask(duration=0.0), "static"),
        (HUNG, ASK, ""),
        (BEAM, ASK, ""),
    ],
)
def test_scenes_that_they_cannot_run_have_a_reason(scene, ask, why):
    found = peers.unable(scene, ask, "MoorDyn")
    assert why in found
    assert bool(why) == bool(found)


def test_one_diameter_carries_volume_drag_and_added_mass():
    """Forces per metre as the scene has them: rho pi/4 d2 Can, rho d Cdn / 2, and the wet weight."""
    cable = replace(HUNG.cable[0], wet_weight=20.0, drag_diameter=0.07, Can=0.9)
    scene = replace(HUNG, cable=(cable,))
    found = peers.line_type(scene)
    assert scene.g * (found.mass - scene.density * math.pi / 4 * found.d**2) == pytest.approx(20.0)
    assert found.d * found.Cdn == pytest.approx(0.07 * cable.Cdn)
    assert found.d * found.Cdt == pytest.approx(0.07 * cable.Cdt)
    assert found.d**2 * found.Can == pytest.approx(cable.d**2 * cable.Can)


def test_steps_are_stable_and_divide_the_output_interval():
    step = peers.step_of(HUNG, 20, 0.02)
    assert 0.02 / step == pytest.approx(round(0.02 / step))
    omega = 2 / (30.0 / 20) * math.sqrt(1e6 / 5.0)
    assert step < 2.785 / omega
    assert peers.step_of(BEAM, 160, 0.02) <= peers.step_of(BEAM, 40, 0.02) / 10  # bending: with the length squared
    with pytest.raises(ValueError, match="does not divide"):
        peers.run("MoorDyn", HUNG, ASK, 20, 0.013)


@pytest.mark.parametrize(("scene", "bound"), [(HUNG, 0.02), (BEAM, 0.03)], ids=["hung", "clamped"])
@pytest.mark.parametrize("program", peers.PEERS)
def test_they_agree_with_ours_on_scenes_that_they_can_run(program, scene, bound):
    """Waveforms at 40 segments. Lumped masses are of order 2 (on the clamped cable 8.5, 2.2, 0.6 % at 20, 40, 80)."""
    if program not in peers.installed():
        pytest.skip(f"{program} is not installed (the bench extra)")
    truth = solve(scene, replace(ASK, model="hermite", method="esdirk4", tolerance=1e-5, segments=40))
    step = peers.step_of(scene, 40, ASK.interval) if program == "MoorDyn" else 0.01
    found, seconds = peers.run(program, scene, ASK, 40, step)
    assert pilot.gap(found, truth) < bound
    assert seconds > 0


def test_a_run_that_blows_up_is_a_failure_and_no_row():
    if "MoorDyn" not in peers.installed():
        pytest.skip("MoorDyn is not installed (the bench extra)")
    with pytest.raises(peers.PeerFailed):
        peers.run("MoorDyn", BEAM, ASK, 80, 0.02)
