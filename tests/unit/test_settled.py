"""Which scenes have a settled response, what `auto` makes of them, and how the answer comes back."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solvers import (
    BNES,
    MODELS,
    Ask,
    CannotRepresent,
    CubicNES,
    Current,
    End,
    Feature,
    Harmonic,
    Motion,
    Response,
    Scene,
    Seabed,
    Section,
    Start,
    Status,
    Stochastic,
    Table,
    Water,
    Window,
    response_curve,
    settled,
    solve,
)
from solvers.catalogue import cheapest
from solvers.methods import floquet
from solvers.methods.floquet import Stability
from solvers.methods.harmonic import Orbit

ROPE = Section(length=12.0, d=0.06, mass=5.0, EA=1e6, BA=2e3, Cdn=1.2, Cdt=0.01, compression=True)


def term(frequency: float = 1.0, x: float = 0.1, phase: float = 0.0) -> Harmonic:
    return Harmonic(amplitude=(x, 0, 0), frequency=frequency, phase=phase)


def rope(*terms: Harmonic, end_b: dict[str, Any] | None = None, **change: Any) -> Scene:
    """A cable of 12 m under 2 kN, from the bottom up, its upper end moved."""
    motion = None if end_b is None and not terms else Motion(**{"harmonics": terms, **(end_b or {})})
    fields: dict[str, Any] = {
        "cable": (ROPE,), "water": Water(), "end_a": End(kind="pinned", position=(0, 0, -13)),
        "end_b": End(kind="pinned", position=(0, 0, -13 + 12 * 1.002), motion=motion),
    }  # fmt: skip
    return Scene(**{**fields, **change})


def sagged(x: float, phase: float = 0.0, **motion: Any) -> Scene:
    """A heavy cable that sags between its ends, moved at 0.5 Hz."""
    scene = rope(term(0.5, x, phase), end_b=motion, cable=(replace(ROPE, mass=20.0),))
    return replace(scene, end_a=End(kind="pinned", position=(-8, 0, -8.4)))


SPECTRUM = Stochastic(amplitude=(0.1, 0, 0), frequency=1.0, seed=1)
TABLE = Table(t=(0, 1, 2, 3), x=((0, 0, 0), (0.1, 0, 0), (0, 0, 0), (0, 0, 0)))


# ------------------------------------------------------------------------------------------------- the period


@pytest.mark.parametrize(
    ("frequencies", "period"),
    [((0.8,), 1.25), ((0.5, 1.0), 2.0), ((0.6, 0.4), 5.0), ((0.1, 0.2, 0.3), 10.0), ((1 / 3, 1 / 2), 6.0),
     ((0.1, 1.2), 10.0), ((1.0, 1.0), 1.0)],
)  # fmt: skip
def test_the_common_period(frequencies: tuple[float, ...], period: float) -> None:
    """The least time that is a whole number of every term's periods, up to 12 of the shortest: rounding."""
    found, why = settled.period(rope(*(term(f) for f in frequencies)))
    assert found == pytest.approx(period, rel=1e-12)
    assert why == ""


def test_both_ends_count() -> None:
    """End A at 0.4 Hz and end B at 0.6 Hz: 5 s."""
    scene = rope(term(0.6))
    scene = replace(scene, end_a=replace(scene.end_a, motion=Motion(harmonics=(term(0.4),))))
    assert settled.period(scene)[0] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (rope(), "nothing moves: no period"),
        (rope(term(1.0), term(math.sqrt(2))), "frequencies [1.0, 1.4142135623730951] Hz have no common period"),
        (rope(term(1.0), term(1.001)), "have no common period"),
        (rope(term(0.1), term(1.3)), "the common period of [0.1, 1.3] Hz is more than 12 of the shortest"),
        (rope(term(1.1), term(1.3)), "more than 12 of the shortest"),
        (rope(term(), end_b={"window": Window(stop=4.0)}), "end_b.motion.window stops at 4 s: transient motion"),
        (rope(end_b={"table": TABLE}), "end_b.motion.table is transient motion"),
        (rope(term(), end_b={"table": TABLE}), "end_b.motion.table is transient motion"),
        (rope(end_b={"stochastic": SPECTRUM, "window": Window(stop=4.0)}), "end_b.motion.stochastic is transient"),
    ],
    ids=["still", "incommensurate", "nearly", "13 to 1", "11 to 13", "stop", "table", "both", "stochastic"],
)
def test_why_there_is_no_period(scene: Scene, words: str) -> None:
    """NaN and a reason that names the field; harmonic balance is refused with it, before the run, and `auto` takes the
    time domain."""
    period, why = settled.period(scene)
    assert math.isnan(period)
    assert words in why
    assert settled.why_not(scene) == why
    with pytest.raises(CannotRepresent, match=re.escape(f"harmonic: {why}; methods that can: dopri5, tsit5, rk4")):
        cheapest(scene, Ask(duration=5.0, method="harmonic", segments=12))
    assert cheapest(scene, Ask(duration=5.0, segments=12)).method == "dopri5"


def sink(**change: Any) -> BNES:
    return BNES(**{"s": 5.0, "mass": 2.0, "EA": 1e5, **change})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"devices": (CubicNES(s=3.0, mass=1.0, EA=1e4), sink())}, "devices[1].law: cords in tension only leave"),
        ({"devices": (sink(kind="bnes_free", phi0=0.0),)}, "devices[0].law: cords in tension only leave a dead band"),
        ({"start": Start(kind="given", shape=((0, 0, -13), (0, 0, -0.976)))}, "start.kind: given begins a transient"),
    ],
    ids=["cords", "free", "given"],
)
def test_what_has_no_settled_response(change: dict[str, Any], words: str) -> None:
    """A mass that touches nothing may be anywhere in its dead band; a given start begins a transient."""
    assert words in settled.why_not(rope(term(), **change))
    assert settled.why_not(rope(term())) == ""


@pytest.mark.parametrize("change", [{"law": "springs"}, {"phi0": 0.0}], ids=["springs", "taut cords"])
def test_devices_that_settle(change: dict[str, Any]) -> None:
    """Springs have no dead band, and cords without slack at mid-stroke have none either."""
    assert settled.why_not(rope(term(), devices=(sink(**change),))) == ""


def test_as_many_harmonics_as_the_motion_has() -> None:
    """Fewer than the highest frequency over the common one cannot even move the end: refused by name."""
    scene = rope(term(0.5), term(2.0))
    assert settled.why_not(scene, 4) == ""
    assert settled.why_not(scene, 3).startswith("harmonics: 3, but the motion's highest frequency is 4 times")
    with pytest.raises(CannotRepresent, match="harmonics: 3, but"):
        cheapest(scene, Ask(duration=5.0, method="harmonic", harmonics=3, segments=12))


def test_ramps() -> None:
    """The last end of a ramp, wherever its window starts; `steady` takes the windows away and leaves the phase."""
    scene = rope(term(), end_b={"window": Window(start=1.0, ramp_up=2.0)})
    assert settled.ramped(scene) == 3.0
    assert settled.ramped(rope(term())) == 0.0
    motion = settled.steady(scene).end_b.motion
    assert motion is not None
    assert motion.window is None
    assert motion.harmonics == scene.end_b.motion.harmonics


# ------------------------------------------------------------------------------------------------- what `auto` takes


def chosen(scene: Scene, **ask: Any) -> str:
    return cheapest(scene, Ask(**{"duration": 10.0, "segments": 12, **ask})).method


def test_auto_takes_harmonic_balance_where_it_can() -> None:
    """A periodic scene, its ramps over before the output begins, a whole period of it, no bed, no fixed step."""
    scene = rope(term())
    ramp = rope(term(), end_b={"window": Window(ramp_up=4.0)})
    bed = replace(scene, water=Water(depth=20.0), seabed=Seabed(z=-20.0))
    assert chosen(scene) == "harmonic"
    assert "periodic: its settled response" in cheapest(scene, Ask(duration=10.0, segments=12)).reason
    assert chosen(ramp) == "dopri5"
    assert chosen(ramp, output_from=3.9) == "dopri5"
    assert chosen(ramp, output_from=4.0) == "harmonic"
    assert chosen(bed) == "dopri5"
    assert chosen(bed, method="harmonic") == "harmonic"  # as asked
    assert chosen(scene, step=0.01) == "genalpha"
    assert chosen(scene, duration=0.5) == "dopri5"  # less than a period
    assert chosen(scene, method="explicit") == "dopri5"
    assert chosen(rope()) == "dopri5"


def test_the_response_of_auto_says_so() -> None:
    """A run that `auto` gives to harmonic balance: method, harmonics, multiplier, grid."""
    run = solve(rope(term()), Ask(duration=2.0, segments=12, interval=0.01, output_from=1.0))
    assert run.status == Status.OK, run.message
    assert run.method == "harmonic"
    assert run.harmonics >= 3
    assert 0 < run.multiplier < 1
    assert run.estimated_error >= 0
    np.testing.assert_allclose(run.t, 1.0 + 0.01 * np.arange(101), atol=1e-12)
    position = run.signals["position"]
    assert position.shape[0] == 101
    np.testing.assert_allclose(position[0], position[-1], atol=1e-9)  # 1 Hz: the same a period later
    np.testing.assert_allclose(position[:, -1, 0], 0.1 * np.sin(2 * math.pi * run.t), atol=1e-12)


@pytest.mark.parametrize("how", ["unstable", "not found", "too few"])
def test_auto_falls_back_to_the_time_domain(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the periodic response is unstable, not found or not good enough the time domain runs and says why; asked
    for by name, harmonic balance tells and stays."""
    if how == "unstable":
        known = Stability(np.array([-1.2 + 0j]), 1.2, 0.0, 48)
        monkeypatch.setattr(floquet, "stability", lambda pack, orbit: known)
        status, words = Status.UNSTABLE, "Floquet multiplier of size 1.2 (period doubling)"
    elif how == "not found":

        def lost(pack: Any, omega: float, rest: np.ndarray, *_: Any) -> Orbit:
            return Orbit(Status.NO_CONVERGENCE, "no periodic response found", omega, np.zeros((len(rest), 7)))

        monkeypatch.setattr(settled, "respond", lost)
        status, words = Status.NO_CONVERGENCE, "no periodic response found"
    else:
        status, words = Status.FEW_HARMONICS, "3 harmonics leave an estimated error of"
    ask = Ask(duration=2.0, segments=12, interval=0.01, harmonics=3 if how == "too few" else None)
    run = solve(rope(term()), ask)
    assert run.status == Status.OK, run.message
    assert run.method == "dopri5"
    assert f"harmonic balance gave {status.name}: {words}" in run.reason
    assert run.harmonics == 0
    named = solve(rope(term()), replace(ask, method="harmonic"))
    assert named.status == status
    assert not named.trusted
    assert named.method == "harmonic"
    assert words in named.message


# ------------------------------------------------------------------------------------------------- the answer


SETTLES = [name for name, line in MODELS.items() if Feature.PERIODIC in line.features and not line.constrained]


@pytest.mark.parametrize("phase", [0.0, math.pi / 2], ids=["sine", "cosine"])
@pytest.mark.parametrize("model", SETTLES)
def test_static_state_is_with_the_ends_at_home(model: str, phase: float) -> None:
    """A motion that is not at home at t = 0 does not move the static state: static positions of harmonic balance and of
    the time domain with a ramp are the same to rounding. So then are the settled positions (5e-6 m, 1e-4 of the motion)
    and the energies above the static state, whose zero shows in every sample (5e-4; the march leaves 1.5e-4).
    """
    ramp = Window(ramp_up=4.0, shape="smooth")
    scene = sagged(0.05, phase, window=ramp)
    ask = Ask(duration=80.0, output_from=78.0, segments=12, interval=0.01, model=model, accuracy=0.9)
    runs: list[Response] = []
    for change in ({"method": "harmonic"}, {"method": "dopri5", "tolerance": 1e-6}):
        runs.append(solve(scene, replace(ask, **change)))
        assert runs[-1].status == Status.OK, runs[-1].message
    a, b = (run.signals for run in runs)
    np.testing.assert_allclose(a["static_position"], b["static_position"], atol=1e-9)
    np.testing.assert_allclose(a["position"], b["position"], atol=5e-6)
    for name in ("strain", "gravity"):
        np.testing.assert_allclose(a[name], b[name], atol=5e-4 * np.abs(b[name]).max())


def test_output_from_only_trims() -> None:
    """In the time domain: the same march, its output from then on, equal bit for bit."""
    ask = Ask(duration=1.0, segments=12, interval=0.01, method="dopri5")
    whole, late = solve(rope(term()), ask), solve(rope(term()), replace(ask, output_from=0.6))
    assert whole.status == late.status == Status.OK
    assert (whole.cost.steps, len(whole.t), len(late.t)) == (late.cost.steps, 101, 41)
    np.testing.assert_array_equal(late.t, whole.t[60:])
    assert late.energy_residual == whole.energy_residual
    for name, signal in whole.signals.items():
        expected = signal[60:] if signal.shape[:1] == (101,) else signal
        np.testing.assert_array_equal(late.signals[name], expected, err_msg=name)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"output_from": 2.5}, "output_from = 2.5: must be 0 to the last output"),
        ({"output_from": -0.1}, "output_from = -0.1: must be 0"),
        ({"harmonics": 0}, "harmonics = 0: must be 1 to 200"),
        ({"harmonics": 201}, "harmonics = 201: must be 1 to 200"),
        ({"harmonics": 0, "output_from": 3.0}, "output_from = 3.0: .*; harmonics = 0"),
    ],
)
def test_what_ask_refuses(change: dict[str, Any], words: str) -> None:
    """Every field out of its range, by name."""
    with pytest.raises(ValueError, match=words):
        Ask(duration=2.0, **change)
    assert Ask(duration=2.0, output_from=2.0, harmonics=200).harmonics == 200


# ------------------------------------------------------------------------------------------------- local


def test_local_is_refused_out_of_its_range() -> None:
    """By name, with the estimate, the limit and who can, before the run."""
    with pytest.raises(CannotRepresent, match=r"local is for small motion: .*above `accuracy` 0\.05.*lumped"):
        solve(sagged(0.5), Ask(duration=4.0, segments=16, model="local", method="harmonic"))


def test_local_and_lumped_settle_alike_at_small_amplitude() -> None:
    """Harmonic balance of both lines at 2 and 4 mm: the end tensions differ by a share of their range that is of first
    order in the motion (ratio 2 within 0.1; 0.0097 and 0.0194 seen), and both are OK."""
    gaps = []
    for x in (0.002, 0.004):
        T = []
        for model in ("local", "lumped"):
            ask = Ask(duration=2.0, segments=16, interval=0.01, model=model, method="harmonic", tolerance=1e-4)
            run = solve(sagged(x), ask)
            assert run.status == Status.OK, run.message
            T.append(np.linalg.norm(run.signals["end_force"][:, 1], axis=1))
        gaps.append(float(np.abs(T[0] - T[1]).max() / np.ptp(T[1])))
    assert gaps[0] < 0.015
    assert gaps[1] / gaps[0] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("method", ["explicit", "harmonic"])
def test_an_interval_that_rounds_above_the_duration(method: str) -> None:
    """3 x 0.1 s is more than 0.3 s in floating point: the run ends well all the same, at 0.3 s."""
    run = solve(rope(term(10.0, 0.01)), Ask(duration=0.3, interval=0.1, segments=12, method=method, accuracy=0.5))
    assert len(run.t) == 4
    assert run.t[-1] == 0.3
    assert "stopped" not in run.message


def shaken(stretch: float, slow: float = 1e-4) -> Scene:
    """A taut cable in air whose end moves along it at twice its first frequency, and a little at a twelfth of that."""
    length, mass, EA = 50.0, 10.0, 1e6
    f = math.sqrt(0.01 * EA / mass) / (2 * length)
    cable = Section(length=length, d=0.05, mass=mass, EA=EA, BA=2e3, compression=True)
    along = (Harmonic(amplitude=(0, 0, stretch), frequency=2 * f), Harmonic(amplitude=(0, 0, slow), frequency=f / 6))
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, -1.01 * length)), g=0.01,
        end_b=End(kind="pinned", position=(0, 0, 0), motion=Motion(harmonics=along)),
    )  # fmt: skip


def test_parametric_resonance_is_unstable_and_auto_marches() -> None:
    """Tension shaken at twice the first frequency: the straight line is a periodic response, and what disturbs it grows
    by 1.243 a period, as in a march of 400 s. The period is twelve of the shaking, which the steps must resolve.
    """
    scene = shaken(0.02)
    ask = Ask(duration=settled.period(scene)[0], segments=12, interval=0.1)
    run = solve(scene, replace(ask, method="harmonic"))
    assert run.status == Status.UNSTABLE
    assert run.multiplier == pytest.approx(1.243, abs=0.003)
    weak = solve(shaken(0.004), replace(ask, method="harmonic"))
    assert weak.status == Status.OK
    assert weak.multiplier == pytest.approx(1.0, abs=1e-3)
    auto = solve(scene, ask)
    assert auto.method == "dopri5"
    assert "harmonic balance gave UNSTABLE" in auto.reason


@pytest.mark.parametrize("speed", [1.0, 2.5])
@pytest.mark.parametrize("duration", [0.0, 2.0])
def test_local_is_refused_where_a_current_carries_it_off(speed: float, duration: float) -> None:
    """The static shape of `local` is that without current: at 1 m/s the range of the tension is 24 % off."""
    scene = replace(sagged(0.05), water=Water(current=Current(z=(0.0,), velocity=((speed, 0, 0),))))
    with pytest.raises(CannotRepresent, match=r"local is for small motion: the drift in the current"):
        solve(scene, Ask(duration=duration, segments=12, model="local", interval=0.1))


def test_local_sees_the_whole_of_a_beat() -> None:
    """Two terms that cancel at t = 0 add up half a beat later: the range is that of their sum."""
    apart = (term(0.5, 0.4), term(0.55, 0.4, math.pi))
    scene = replace(sagged(0.1), end_b=replace(sagged(0.1).end_b, motion=Motion(harmonics=apart)))
    one = MODELS["local"].build(sagged(0.8), 12).range_error()
    assert MODELS["local"].build(scene, 12).range_error() == pytest.approx(one, rel=1e-9)


def test_a_branch_may_begin_where_its_field_does() -> None:
    """Drag from 0: nothing is asked of the scene outside the range; a branch without range is a mistake."""
    scene = sagged(0.05)

    def at(value: float) -> Scene:
        return replace(scene, cable=(replace(scene.cable[0], Cdt=value),))

    curve = response_curve(at, 0.0, 0.3, Ask(duration=2.0, segments=12), with_stability=False)
    assert curve.status == Status.OK, curve.message
    assert curve.parameter[[0, -1]] == pytest.approx([0.0, 0.3])
    with pytest.raises(ValueError, match="a branch needs a range"):
        response_curve(at, 0.1, 0.1, Ask(duration=2.0, segments=12))


def test_a_branch_trusts_no_coarse_mesh() -> None:
    """Ten times the frequency on a mesh as asked: the points say that they are not to be trusted."""

    def at(value: float) -> Scene:
        return (
            sagged(0.01)
            if value == 0.5
            else replace(sagged(0.01), end_b=replace(sagged(0.01).end_b, motion=Motion(harmonics=(term(value, 0.01),))))
        )

    curve = response_curve(at, 0.5, 5.0, Ask(duration=2.0, segments=12), with_stability=False)
    assert curve.trusted[0]
    assert not curve.trusted[-1]
