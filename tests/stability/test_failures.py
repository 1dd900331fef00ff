"""Every known failure by name: it is detected, it has a Status and a sentence, and what the sentence recommends works.

Each test runs one scene twice or more: as it fails, and by the recommended way.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solvers import (
    BNES,
    METHODS,
    Ask,
    CannotRepresent,
    CubicNES,
    End,
    Harmonic,
    Motion,
    Response,
    Scene,
    Section,
    Start,
    Status,
    Water,
    Window,
    pilot,
    response_curve,
    solve,
)
from solvers.model import REMEDY


def fails(run: Response, *allowed: Status) -> None:
    """Not trusted, for one of these reasons, and the sentence ends with the remedy."""
    assert run.status in allowed, f"{run.status.name}: {run.message}"
    assert REMEDY[run.status] in run.message


def works(run: Response) -> None:
    assert run.status == Status.OK, f"{run.status.name}: {run.message}"
    assert run.energy_residual < 1e-3


def pinned(*position: float, **fields: Any) -> End:
    return End(kind="pinned", position=position, **fields)


def shake(x: float, z: float, frequency: float, ramp: float = 0.0) -> Motion:
    window = Window(ramp_up=ramp, shape="smooth") if ramp else None
    return Motion(harmonics=(Harmonic(amplitude=(x, 0, z), frequency=frequency),), window=window)


# ------------------------------------------------------------------------------------------- snap and slack

CHAIN = Section(length=10.0, d=0.02, mass=1.0, EA=1e5, BA=50.0, Cdn=1.5, Cdt=0.1, compression=False)


def snapping() -> Scene:
    """A chain with a sag of 1.7 m, shaken faster than it can fall: slack, then taut at a stroke, in each period."""
    return Scene(
        cable=(CHAIN,), water=Water(), end_a=pinned(0, 0, -10),
        end_b=pinned(8.5, 0, -6.5, motion=shake(0.25, 0.35, 0.9, 0.5)),
    )  # fmt: skip


def test_snap_and_slack() -> None:
    """Implicit steps of a fiftieth of the period jump over the snaps: Newton fails or the energy does not close.
    Explicit steps with error control, at a tolerance tighter than a taut cable needs, take each snap as it comes."""
    ask = Ask(duration=2.0, segments=20, interval=5e-3)
    for rho in (1.0, 0.8):
        bad = solve(snapping(), replace(ask, method="genalpha", step=1 / 45, rho=rho))
        fails(bad, Status.NO_CONVERGENCE, Status.ENERGY_OPEN)
    good = solve(snapping(), replace(ask, method="explicit", tolerance=1e-6))
    works(good)
    tension = good.signals["tension"]
    assert (tension == 0).any()
    assert tension.max() > 10 * tension[0].max()


def test_harmonic_balance_with_slack() -> None:
    """Harmonics of max(0, T) fall off as 1/h^2 only, or Newton does not converge; the sentence says that the line is
    slack and to run the time domain, which does."""
    ask = Ask(duration=6 / 0.9, segments=16, output_from=5 / 0.9, interval=0.01)
    bad = solve(snapping(), replace(ask, method="harmonic"))
    assert bad.status in (Status.FEW_HARMONICS, Status.NO_CONVERGENCE), bad.message
    assert "slack" in bad.message
    assert "time domain" in bad.message
    works(solve(snapping(), replace(ask, method="explicit", tolerance=1e-6)))


# ------------------------------------------------------------------------------------------- negative tension


def strut(EI: float, compression: bool = True, segments: int = 40) -> tuple[Scene, Ask]:
    """A line of 10 m with its ends 2 mm too near (-20 N), disturbed in the shortest wave of 20 segments."""
    cable = Section(
        length=10.0, d=0.05, mass=2.0, EA=1e5, EI=EI, wet_weight=0.0, Can=0.0, Cdn=0.0, compression=compression
    )
    far = 10.0 * (1 - 20.0 / 1e5)
    i = np.arange(segments + 1) / segments
    start = Start(
        kind="given", shape=tuple((far * x, 0.0, 0.0) for x in i),
        velocity=tuple((0.0, 0.0, 1e-6 * math.sin(19 * math.pi * x)) for x in i),
    )  # fmt: skip
    scene = Scene(cable=(cable,), g=0.0, start=start, end_a=pinned(0, 0, 0), end_b=pinned(far, 0, 0))
    return scene, Ask(duration=0.6, segments=segments, interval=2e-3, method="explicit", tolerance=1e-6)


def test_negative_tension_without_bending() -> None:
    """The shortest wave grows at (2/l) sqrt(|T|/m): halving the mesh doubles it, so that no mesh is fine enough. The
    run says UNRESOLVED, and what to give the cable; both cures work on the same scene, with the same start.

    2 %: the wave is not quite the shortest one. With EI the growth is at most |T|/(2 sqrt(EI m)) = 1/s.
    """
    found = []
    for segments in (20, 40):
        i = np.arange(segments + 1)
        scene, ask = strut(0.0, segments=segments)
        mode = tuple((0.0, 0.0, 1e-9 * (-1) ** k * math.sin(math.pi * k / segments)) for k in i)
        scene = replace(scene, start=replace(scene.start, velocity=mode))
        run = solve(scene, replace(ask, duration=24 / segments))
        fails(run, Status.UNRESOLVED)
        assert "`EI`" in run.message
        assert "`compression: false`" in run.message
        speed = np.abs(run.signals["velocity"][:, :, 2]).max(axis=1)
        late = (run.t > 0.3 * run.t[-1]) & (speed < 1e-3)
        found.append(float(np.polyfit(run.t[late], np.log(speed[late]), 1)[0]))
    assert found[0] == pytest.approx(4.0 * math.sqrt(10.0), rel=0.02)
    assert found[1] / found[0] == pytest.approx(2.0, rel=0.02)
    scene, ask = strut(EI=50.0)
    stiff = solve(scene, replace(ask, duration=1.0))
    works(stiff)
    assert np.abs(stiff.signals["velocity"][:, :, 2]).max() < 1e-6 * math.e ** (20.0 / (2 * math.sqrt(50.0 * 2.0)))
    scene, ask = strut(EI=0.0, compression=False)
    works(solve(scene, ask))


# ------------------------------------------------------------------------------------------- catenaries without tension

ROPE = Section(length=1.0, d=0.002, mass=0.2, EA=1e4, compression=False)


def test_zero_tension_catenary() -> None:
    """An end moved faster than the line can fall: a catenary has no direction there and says so, by name, and which
    models have one. The lumped line of the same scene goes slack and closes its energy."""
    scene = Scene(
        cable=(replace(ROPE, BA=2.0),), end_a=pinned(0, 0, 0), end_b=pinned(0.9, 0, 0.1, motion=shake(0, 0.3, 2.0, 0.5))
    )
    dry = replace(scene, cable=(ROPE,))
    ask = Ask(duration=0.8, segments=20, interval=0.01, max_steps=20_000)
    bad = solve(dry, replace(ask, model="catenary", method="trbdf2"))
    fails(bad, Status.ZERO_TENSION)
    assert "lumped" in bad.message
    good = solve(scene, replace(ask, model="lumped", method="explicit", max_steps=1_000_000))
    works(good)
    assert (good.signals["tension"] == 0).any()


def folded(segments: int, gap: float = 0.04, BA: float = 0.1) -> Scene:
    """A chain of 1 m folded at its middle, ends side by side; end B is let go."""
    r = gap / 2
    leg = (1.0 - math.pi * r) / 2
    shape = []
    for s in np.linspace(0.0, 1.0, segments + 1):
        angle = min(max((s - leg) / r, 0.0), math.pi)
        z = -s if s <= leg else (s - 1.0 if s >= 1.0 - leg else -leg - r * math.sin(angle))
        shape.append((r - r * math.cos(angle), 0.0, z))
    chain = Section(length=1.0, d=0.002, mass=0.1, EA=1e3, BA=BA, compression=False)
    return Scene(
        cable=(chain,), end_a=pinned(0, 0, 0), end_b=End(kind="free"), g=9.81,
        start=Start(kind="given", shape=tuple(shape)),
    )  # fmt: skip


def test_folded_chain() -> None:
    """The falling leg has no tension: ZERO_TENSION for a catenary. The lumped line falls to 0.8 L when the closed form
    does, faster than freely, within 2 %: the fold is 4 cm wide."""
    ask = Ask(duration=0.3, segments=50, interval=2e-3, max_steps=500_000)
    bad = solve(folded(50, BA=0.0), replace(ask, model="catenary", method="trbdf2", max_steps=5000))
    fails(bad, Status.ZERO_TENSION)
    good = solve(folded(50), replace(ask, duration=0.36, model="lumped", method="explicit"))
    works(good)
    fall = -good.signals["position"][:, -1, 2]
    u = np.linspace(0.0, math.sqrt(0.8), 4001)
    middle = (u[1:] + u[:-1]) / 2  # t = int 2 sqrt((1 - u^2)/(g (2 - u^2))) du, x = u^2
    exact = float((2 * np.sqrt((1 - middle**2) / (9.81 * (2 - middle**2)))).sum() * (u[1] - u[0]))
    assert np.interp(0.8, fall, good.t) == pytest.approx(exact, rel=0.02)
    assert exact < math.sqrt(2 * 0.8 / 9.81)


# ------------------------------------------------------------------------------------------- sawtooth of the box method


def test_sawtooth_in_space() -> None:
    """The box scheme over elements 20 bending lengths long: the moment changes sign from node to node. UNRESOLVED, with
    the remedy; with elements of half a bending length it decays without changing sign."""
    rod = Section(length=0.4, d=1e-3, mass=1e-3, EA=1e8, EI=1e-4, wet_weight=0.0)  # bending length 0.01 at T = 1
    clamp = End(kind="clamped", position=(0, 0, 0), direction=(1, 0, 0.1))
    scene = Scene(cable=(rod,), end_a=clamp, end_b=End(kind="free", force=(1.0, 0, 0)))
    coarse = solve(scene, Ask(model="rod", segments=4))
    fails(coarse, Status.UNRESOLVED)
    moment = coarse.signals["moment"][0, :-1, 1]
    assert np.all(moment[1:] * moment[:-1] < 0)
    fine = solve(scene, Ask(model="rod", segments=80))
    works(fine)
    moment = fine.signals["moment"][0, :, 1]
    near = np.abs(moment) > 1e-6 * np.abs(moment).max()
    assert len(set(np.sign(moment[near]))) == 1


def plucked() -> Scene:
    """A taut line of 100 m whose middle is displaced along it by 2 cm and let go: waves at 1000 m/s."""
    cable = Section(length=100.0, d=0.01, mass=1.0, EA=1e6, wet_weight=0.0, compression=True)
    s = np.linspace(0.0, 100.0, 41)
    x = 1.005 * s + 0.02 * np.exp(-(((s - 50) / 5) ** 2))
    start = Start(kind="given", shape=tuple((float(v), 0.0, 0.0) for v in x))
    return Scene(cable=(cable,), g=0.0, start=start, end_a=pinned(0, 0, 0), end_b=pinned(float(x[-1]), 0, 0))


def sawtooth(run: Response) -> float:
    """Share of the velocity that alternates from step to step: rms of the second difference over four, of the rms."""
    v = run.signals["velocity"][1:, :, 0]
    return float(np.sqrt((np.diff(v, 2, axis=0) ** 2).mean()) / 4 / np.sqrt((v**2).mean()))


def test_sawtooth_in_time() -> None:
    """Steps eight times l/c with rho = 1, whose root at infinity is -1: most of the velocity alternates from step to
    step and does not decay. The run says that its steps are too coarse or its energy open; rho = 0.5 damps the sawtooth
    at the same step, and says what that costs; the explicit method, the remedy, has none and is trusted."""
    step = 8 * 2.5 / 1000
    ask = Ask(duration=60 * step, segments=40, interval=step)
    box = solve(plucked(), replace(ask, method="genalpha", rho=1.0, step=step))
    fails(box, Status.COARSE_STEP, Status.ENERGY_OPEN)
    damped = solve(plucked(), replace(ask, method="genalpha", rho=0.5, step=step))
    fails(damped, Status.COARSE_STEP, Status.ENERGY_OPEN)
    good = solve(plucked(), replace(ask, method="explicit", interval=2e-4, duration=0.2))
    works(good)
    assert sawtooth(box) > 0.7
    late = [float(np.abs(run.signals["velocity"][-10:]).max()) for run in (box, damped)]
    assert late[0] > 10 * late[1]
    assert sawtooth(good) < 0.05


# ------------------------------------------------------------------------------------------- harmonic balance


def string(frequency: float) -> Scene:
    """A taut string in air with little damping whose stretch makes it a Duffing oscillator: folds near its first mode,
    0.79 Hz."""
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=2e4, EI=200.0, BI=30.0, BA=50.0, wet_weight=0.0, compression=True)
    return Scene(
        cable=(cable,), g=0.0, end_a=pinned(0, 0, 0),
        end_b=pinned(0, 0, 10 * (1 + 500 / 2e4), motion=shake(0.02, 0, frequency)),
    )  # fmt: skip


def test_harmonic_balance_at_a_fold() -> None:
    """Between two folds three responses exist. The middle one is UNSTABLE by a real multiplier above 1, each fold has
    one at +1 and is marked; the arc passes both; and the time domain settles on the lower response there."""
    ask = Ask(segments=8, harmonics=5, tolerance=5e-2, accuracy=0.2)
    curve = response_curve(string, 0.70, 1.3, ask, step=0.05, most_step=0.2)
    assert curve.status == Status.OK, curve.message
    assert curve.fold.sum() == 2
    upper, lower = np.flatnonzero(curve.fold)
    assert np.all(~curve.stable[upper + 2 : lower - 1])
    np.testing.assert_allclose(curve.multiplier[curve.fold], 1.0, atol=5e-3)
    assert curve.multiplier[upper + 2 : lower - 1].min() > 1
    middle = 0.5 * (curve.parameter[upper] + curve.parameter[lower])
    low = float(np.interp(middle, curve.parameter[lower:], curve.displacement[lower:]))
    high = float(np.interp(middle, curve.parameter[: upper + 1], curve.displacement[: upper + 1]))
    assert high > 1.5 * low
    n = 150
    ramped = string(middle)
    motion = replace(ramped.end_b.motion, window=Window(ramp_up=20 / middle, shape="smooth"))
    ramped = replace(ramped, end_b=replace(ramped.end_b, motion=motion))
    march = Ask(
        duration=n / middle, output_from=(n - 1) / middle, interval=1 / (middle * 50), segments=8, method="explicit"
    )
    good = solve(ramped, march)
    works(good)
    settled = float(np.ptp(good.signals["position"], axis=0).max() / 2)
    assert settled == pytest.approx(low, rel=0.05)


def sink(amplitude: float) -> Scene:
    """The scene of configs/nes_periodic.yaml on a coarse mesh: a cubic sink on the first mode of the study's cable."""
    cable = Section(length=18.8016, d=0.076, mass=4.73, EA=9e6, EI=11710.0, BA=1533.0, Cdt=0.008)
    clamp = {"kind": "clamped", "direction": (0, 0, 1)}
    return Scene(
        cable=(cable,), water=Water(depth=25.0), end_a=End(position=(0, 0, -25), **clamp),
        devices=(CubicNES(s=9.4008, mass=8.0, EA=2e3, BA=240.0, length=0.5),),
        end_b=End(position=(0, 0, -6.197355466666667), motion=shake(amplitude, 0, 0.42, 5.0), **clamp),
    )  # fmt: skip


def test_harmonic_balance_in_strongly_modulated_response() -> None:
    """A periodic response exists, and a pair of multipliers has left the unit circle: UNSTABLE, by modulation, with the
    remedy. The time domain is trusted and beats: the sink's stroke swells and shrinks by more than 20 %."""
    ask = Ask(duration=80.0, output_from=40.0, interval=0.05, segments=20)
    bad = solve(sink(0.008), replace(ask, method="harmonic"))
    fails(bad, Status.UNSTABLE)
    assert bad.multiplier > 1.01
    assert "modulation" in bad.message
    good = solve(sink(0.008), replace(ask, method="explicit"))
    works(good)
    stroke = np.abs(good.signals["stroke"][:, 0])
    per = round(1 / 0.42 / 0.05)
    peaks = stroke[: len(stroke) // per * per].reshape(-1, per).max(axis=1)
    assert peaks.max() > 1.2 * peaks.min()


def test_harmonic_balance_with_tension_only_cords() -> None:
    """A dead band leaves no unique periodic response: refused before the run, by the field, with the methods that can;
    the first of them does."""
    cords = BNES(s=9.4008, mass=4.0, EA=1e6, BA=45.0)
    scene = replace(sink(0.004), devices=(cords,))
    ask = Ask(duration=3.0, segments=20, interval=0.01)
    with pytest.raises(CannotRepresent, match=r"devices\[0\]\.law: cords .*methods that can: dopri5"):
        solve(scene, replace(ask, method="harmonic"))
    works(solve(scene, replace(ask, method="dopri5")))


# ------------------------------------------------------------------------------------------- methods where they fail


def ringing() -> tuple[Scene, Ask]:
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=1e5, wet_weight=0.0, compression=True)
    jerk = Motion(harmonics=(Harmonic(amplitude=(0, 0, 2e-3), frequency=3.0),))
    scene = Scene(cable=(cable,), g=0.0, end_a=pinned(0, 0, 0), end_b=pinned(0, 0, 10 * (1 + 500 / 1e5), motion=jerk))
    return scene, Ask(duration=2.0, segments=20, interval=1e-2)


def test_heun_without_damping() -> None:
    """Heun's rule has no stable step on an oscillation: at 0.7 of what 2/omega would promise it is gone, at 0.12
    its energy grows by (1 + z^4/4) a step and is open. RK4 at the longer step is trusted."""
    scene, ask = ringing()
    omega = 2 / 0.5 * math.sqrt(1e5 / 2.0)
    fails(solve(scene, replace(ask, method="rk2", step=0.7 * 2 / omega)), Status.DIVERGED, Status.ENERGY_OPEN)
    fails(solve(scene, replace(ask, method="rk2", step=0.12 * 2 / omega)), Status.ENERGY_OPEN)
    works(solve(scene, replace(ask, method="rk4", step=0.5 * 2 / omega)))


def study_sinks() -> Scene:
    scene = sink(0.004)
    pulse = Motion(
        harmonics=tuple(Harmonic(amplitude=(0.01, 0, 0), frequency=f) for f in (2.0, 4.0, 8.0)), window=Window(stop=0.5)
    )
    cords = tuple(BNES(s=s, mass=4.0, EA=1e9, BA=1414.0, rod="cords") for s in (16.92, 6.957))
    return replace(scene, devices=cords, end_b=replace(scene.end_b, motion=pulse))


@pytest.mark.parametrize("step", [1e-3, 5e-4])
def test_the_box_rule_with_impacts(step: float) -> None:
    """rho = 1 on cords of 1 GN: each impact excites what the rule never damps. Its energy is open, or a finer step has
    another waveform; the explicit method, which lands on impacts, is trusted."""
    ask = Ask(duration=1.0, segments=40, interval=1e-3)
    fails(
        solve(study_sinks(), replace(ask, method="genalpha", rho=1.0, step=step)),
        Status.ENERGY_OPEN, Status.COARSE_STEP, Status.NO_CONVERGENCE,
    )  # fmt: skip
    works(solve(study_sinks(), replace(ask, method="explicit")))


def test_an_element_too_long_for_the_boundary_layer() -> None:
    """At a clamp bending decays over sqrt(EI/T) = 0.1 m: segments of 0.5 m miss it, and say so with both lengths;
    with 0.08 m the run is trusted."""
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=1e6, EI=50.0, BA=200.0, wet_weight=0.0)
    clamp = {"kind": "clamped", "direction": (0, 0, 1)}
    scene = Scene(
        cable=(cable,), g=0.0, end_a=End(position=(0, 0, 0), **clamp),
        end_b=End(position=(0, 0, 10 * (1 + 5000 / 1e6)), motion=shake(0.01, 0, 2.0), **clamp),
    )  # fmt: skip
    ask = Ask(duration=0.3, model="lumped", method="explicit", interval=1e-2)
    bad = solve(scene, replace(ask, segments=20))
    fails(bad, Status.UNRESOLVED)
    assert "segments of 0.5 m at a clamp, where bending decays over 0.1 m" in bad.message
    works(solve(scene, replace(ask, segments=125)))


# ------------------------------------------------------------------------------------------- errors in time


def swinging() -> tuple[Scene, Ask]:
    """A string without damping, shaken for two seconds and left to swing for forty."""
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=1e5, wet_weight=0.0, compression=True)
    push = replace(shake(0.02, 0, 0.5), window=Window(stop=2.0, ramp_up=0.5, ramp_down=0.5, shape="smooth"))
    scene = Scene(cable=(cable,), g=0.0, end_a=pinned(0, 0, 0), end_b=pinned(0, 0, 10.05, motion=push))
    return scene, Ask(duration=60.0, segments=16, interval=0.1)


@pytest.mark.parametrize("rho", [1.0, 0.8])
def test_a_closed_ledger_is_not_a_right_waveform(rho: float) -> None:
    """Generalised-alpha shifts the frequency by -(omega h)^2/12 and more and keeps the energy: after many periods the
    waveform is off by more than 5 % with a residual below 1e-3. A finer run tells: COARSE_STEP, with an estimate that
    is right within a fifth; half the step or less is trusted."""
    scene, ask = swinging()
    exact = solve(scene, replace(ask, method="explicit", tolerance=1e-7))

    def error(run: Response) -> float:
        x, y = (r.signals["position"] - r.signals["static_position"] for r in (run, exact))
        return float(np.sqrt(((x - y) ** 2).mean() / (y**2).mean()))

    bad = solve(scene, replace(ask, method="genalpha", rho=rho, step=9e-3))
    fails(bad, Status.COARSE_STEP)
    assert bad.energy_residual < 1e-3
    assert error(bad) > ask.accuracy
    assert bad.estimated_error == pytest.approx(error(bad), rel=0.2)
    good = solve(scene, replace(ask, method="genalpha", rho=rho, step=4e-3))
    works(good)
    assert error(good) < ask.accuracy
    assert good.cost.checking > 0


@pytest.mark.parametrize(("method", "true"), [("trbdf2", 0.018), ("esdirk4", 0.0105)])
def test_a_default_tolerance_is_checked_where_local_errors_may_add_up(method: str, true: float) -> None:
    """What a minute of swinging makes of a default tolerance is enough for 5 %; asked for less, a finer run tells.
    Pilots' word for the tolerance does not silence it."""
    scene, ask = swinging()
    exact = solve(scene, replace(ask, method="explicit", tolerance=1e-7))
    usual = solve(scene, replace(ask, method=method))
    works(usual)
    assert pilot.gap(usual, exact) == pytest.approx(true, rel=0.05)
    assert usual.estimated_error == pytest.approx(true, rel=0.3)
    works(solve(scene, replace(ask, method=method, accuracy=2 * true)))
    asked = replace(ask, method=method, accuracy=0.5 * true)
    for word in (None, METHODS[method].tolerance):
        bad = solve(scene, replace(asked, checked_tolerance=word))
        fails(bad, Status.COARSE_STEP)
        assert bad.energy_residual < 1e-3
        assert bad.estimated_error == pytest.approx(true, rel=0.3)
    finer = solve(scene, replace(asked, tolerance=METHODS[method].tolerance / 10))
    works(finer)
    assert pilot.gap(finer, exact) < 0.5 * true


def test_few_steps_at_a_default_tolerance_need_no_check() -> None:
    scene, ask = swinging()
    short = solve(scene, replace(ask, method="trbdf2", duration=10.0))
    works(short)
    assert short.cost.checking == 0.0
    assert short.tolerance * short.cost.steps < 0.5 * ask.accuracy


def barely_pushed() -> tuple[Scene, Ask]:
    """A hung line without damping, pushed by a tenth of a millimetre in periods of 14 s, that swings on for 540 s:
    steps of error control would be longer than a twentieth of that period."""
    cable = Section(length=40.0, d=0.015, mass=3.4, EA=1.1e4, wet_weight=23.0, compression=True)
    push = Motion(
        harmonics=(Harmonic(amplitude=(-1.4e-4, 0, 0), frequency=0.07),),
        window=Window(stop=107.0, ramp_up=7.0, ramp_down=7.0, shape="smooth"),
    )
    scene = Scene(cable=(cable,), end_a=pinned(0, 0, 0), end_b=pinned(36, 0, 0, motion=push))
    return scene, Ask(duration=540.0, segments=24, interval=2.0)


@pytest.mark.parametrize(
    ("method", "times", "true"),
    [("esdirk4", 1.0, 0.104), ("esdirk4", 10.0, 0.60), ("esdirk4", 100.0, 0.57), ("trbdf2", 1.0, 0.111)],
)
def test_steps_at_their_longest_are_no_controlled_ones(method: str, times: float, true: float) -> None:
    """Two tolerances whose steps are both the longest allowed would agree and be wrong: the longest step goes with
    the tolerance, and a run of such steps is always compared."""
    scene, ask = barely_pushed()
    exact = solve(scene, replace(ask, method="explicit", tolerance=1e-8))
    asked = replace(ask, method=method, tolerance=times * METHODS[method].tolerance)
    bad = solve(scene, asked)
    fails(bad, Status.COARSE_STEP, Status.ENERGY_OPEN)
    assert pilot.gap(bad, exact) == pytest.approx(true, rel=0.05)
    works(solve(scene, replace(asked, tolerance=0.1 * METHODS[method].tolerance)))


def test_pilots_see_steps_at_their_longest() -> None:
    scene, ask = barely_pushed()
    run = solve(scene, replace(ask, segments=None))
    works(run)
    fine = replace(ask, model=run.model, segments=2 * run.segments, method="explicit", tolerance=1e-8)
    assert pilot.gap(run, solve(scene, fine)) < 1.1 * run.estimated_error < ask.accuracy


def test_a_loose_tolerance_with_impacts() -> None:
    """Four sinks, 0.6 s: with a tolerance above its own dopri5 closes its energy and has another waveform, and so has
    TR-BDF2, which does not land on impacts. Both are compared with a tenth of the tolerance and say COARSE_STEP."""
    scene = study_sinks()
    table = zip((16.92144, 11.845008, 6.956592, 1.88016), (4.0, 3.0, 4.0, 4.0), (5.384e8, 7.293e9, 1.067e9, 1.067e9),
                strict=True)  # fmt: skip
    sinks = tuple(BNES(s=s, mass=m, EA=EA, BA=math.sqrt(0.002 * EA), rod="cords") for s, m, EA in table)
    scene = replace(scene, devices=sinks)
    ask = Ask(duration=0.6, segments=40, interval=3e-3)
    for method, tolerance in (("dopri5", 1.78e-3), ("trbdf2", 5.62e-5)):
        bad = solve(scene, replace(ask, method=method, tolerance=tolerance))
        fails(bad, Status.COARSE_STEP)
        assert bad.energy_residual < 1e-3
    works(solve(scene, replace(ask, method="explicit")))
