"""Hybrids whose domains follow the motion, and a cable that pops into a loop: configs/touchdown.yaml and hockle.yaml
on coarser meshes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from solvers import (
    Ask,
    End,
    Harmonic,
    Motion,
    Response,
    Scene,
    Seabed,
    Section,
    Status,
    Turn,
    Water,
    Window,
    needs,
    solve,
)
from solvers.catalogue import March, cheapest, limits_of, marched, static_state
from solvers.lines.rod import RodModel, domains
from solvers.methods.march import C_STEPS
from solvers.model import Feature

SWELL = Motion(
    harmonics=(Harmonic(amplitude=(1.0, 0.0, 0.5), frequency=0.1),), window=Window(ramp_up=10.0, shape="smooth")
)
JUMPER = Scene(
    cable=(Section(length=150.0, d=0.1, mass=20.0, EA=1e8, EI=200.0, Cdn=1.2, Cdt=0.02),),
    water=Water(depth=60.0),
    seabed=Seabed(z=-60.0, stiffness=1e4, friction=0.3, friction_speed=0.05),
    end_a=End(kind="clamped", position=(0, 0, -58), direction=(1, 0, 1)),
    end_b=End(kind="pinned", position=(115, 0, -5), motion=SWELL),
)


@lru_cache
def jumper(model: str, accuracy: float = 0.01, duration: float = 15.0, interval: float = 0.1) -> Response:
    """15 s of the jumper in a swell of 10 s."""
    return solve(
        JUMPER,
        Ask(
            model=model, accuracy=accuracy, segments=200, duration=duration, interval=interval, method="genalpha",
            step=0.02, rho=0.8,
        ),
    )  # fmt: skip


def error(name: str) -> float:
    """Largest difference of a signal from the full rod's, over its largest size."""
    ours, theirs = jumper("hybrid").signals[name], jumper("rod").signals[name]
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


def test_domains_follow_the_motion_within_the_accuracy_asked() -> None:
    """At most 1 % in tension, moment and shape, at every sample and node, with less than half a rod."""
    run = jumper("hybrid")
    assert run.status == Status.OK, run.message
    assert run.signals["domain"].mean() < 0.5
    assert "changes of domains" in run.reason
    moved = np.diff(run.signals["domain"], axis=0)
    assert np.abs(moved).sum() > 0, "domains never changed: the scene tests nothing"
    assert error("tension") < 0.01
    assert error("moment") < 0.01
    sag = float(np.ptp(jumper("rod").signals["position"][0, :, 2]))
    assert np.abs(run.signals["position"] - jumper("rod").signals["position"]).max() < 0.01 * sag


def test_the_estimate_covers_the_error() -> None:
    """One Newton step of the full rod from the hybrid's state says at least half of the largest error."""
    worst = max(error("tension"), error("moment"))
    assert jumper("hybrid").estimated_error > 0.5 * worst


def test_windows_leave_no_seam() -> None:
    """Samples, ledger and times of a run in windows are those of one run: no gap, no jump beyond the estimate."""
    run, whole = jumper("hybrid"), jumper("rod")
    np.testing.assert_allclose(run.t, whole.t)
    assert run.energy_residual < 1e-3
    scale = np.abs(whole.signals["work"]).max()
    for name in ("work", "lost_water", "lost_seabed", "kinetic"):
        assert np.all(np.isfinite(run.signals[name]))
        assert np.abs(run.signals[name] - whole.signals[name]).max() < 0.02 * scale, name


@pytest.mark.parametrize("method", ["genalpha", "trbdf2"])
def test_a_march_goes_on_where_it_ended(method: str) -> None:
    """Half a second in two marches is that in one: to rounding by fixed steps; by TR-BDF2 without a new start, which
    costs 10 steps and more, and to its own tolerance."""
    model = RodModel(JUMPER, 60, ((0.0, 30.0),))
    status, q, note = static_state(model)
    assert status == Status.OK, note
    ask = Ask(model="hybrid", method=method, step=0.02 if method == "genalpha" else None, duration=40.0)
    limits, still = limits_of(model, ask, method, model.fastest(q)), np.zeros(model.ndof)

    def march(start: float, stop: float, before: March | None = None) -> March:
        cut = np.array([start, stop])
        found = marched(model, ask, method, limits, q, still, cut, cut, before)
        assert found.code == Status.OK
        return found

    whole, half = march(0.0, 2.0), march(0.0, 1.0)
    first = int(half.out.counts[C_STEPS])
    rest = march(1.0, 2.0, half)
    steps = first + int(rest.out.counts[C_STEPS])
    assert whole.out.counts[C_STEPS] <= steps <= whole.out.counts[C_STEPS] + 2
    moved = np.abs(whole.ends.q[0] - q)[model.pack.r[:, None] + np.arange(3)].max()
    off = np.abs(rest.ends.q[0] - whole.ends.q[0])[model.pack.r[:, None] + np.arange(3)].max()
    assert off < (1e-9 if method == "genalpha" else 1e-2) * moved


def test_late_output_is_the_same() -> None:
    """`output_from` cuts the record, not the run."""
    ask = Ask(model="hybrid", accuracy=0.01, segments=100, duration=6.0, interval=0.1, method="genalpha", step=0.02)
    full, late = solve(JUMPER, ask), solve(JUMPER, replace(ask, output_from=3.0))
    assert late.t[0] == pytest.approx(3.0)
    keep = full.t >= 3.0 - 1e-9
    np.testing.assert_allclose(late.signals["tension"], full.signals["tension"][keep], rtol=1e-9)
    np.testing.assert_allclose(late.signals["work"], full.signals["work"][keep], rtol=1e-9)


def test_a_coarser_accuracy_takes_less_rod() -> None:
    """Hysteresis and padding apart, the share of rod falls with the accuracy asked."""
    fine = solve(JUMPER, Ask(model="hybrid", accuracy=0.01, segments=200)).signals["domain"].mean()
    rough = solve(JUMPER, Ask(model="hybrid", accuracy=0.2, segments=200)).signals["domain"].mean()
    assert rough < 0.7 * fine


def test_too_little_rod_is_said() -> None:
    """A domain that ends inside the clamp's boundary layer (0.3 m) is ROD_NEEDED, with the estimate in the message."""
    found = solve(JUMPER, Ask(model="hybrid", rods=((0.0, 0.3),), segments=400))
    assert found.status == Status.ROD_NEEDED
    assert "estimated error" in found.message


def test_a_change_of_domains_keeps_balance() -> None:
    """`carry_over` keeps positions and the frames that both have; new frames have no twist."""
    one = RodModel(JUMPER, 100, ((0.0, 20.0),))
    two = RodModel(JUMPER, 100, ((0.0, 60.0),))
    q = one.starts()[0]
    p, _ = domains.carry_over(one, two, q, np.zeros(one.ndof))
    np.testing.assert_array_equal(p[two.pack.r[:, None] + np.arange(3)], q[one.pack.r[:, None] + np.arange(3)])
    both = np.flatnonzero((one.pack.p >= 0) & (two.pack.p >= 0))
    np.testing.assert_array_equal(
        p[two.pack.p[both][:, None] + np.arange(4)], q[one.pack.p[both][:, None] + np.arange(4)]
    )
    frames = p[two.pack.p[two.pack.p >= 0][:, None] + np.arange(4)]
    np.testing.assert_allclose(np.linalg.norm(frames, axis=1), 1.0, atol=1e-12)


# ------------------------------------------------------------------------------------------------- torsion


def hockle(turns: float = 8.0, seconds: float = 20.0) -> Scene:
    """A slack cable, four metres between clamps three apart; end B turns."""
    x = np.linspace(0.0, 1.0, 9)
    angle = 360 * turns * (3 * x**2 - 2 * x**3)
    return Scene(
        cable=(Section(length=4.0, d=0.01, mass=0.1, wet_weight=0.05, EA=1e4, EI=0.02, GJ=0.015, Cdt=0.1),),
        water=Water(),
        end_a=End(kind="clamped", position=(0, 0, -10), direction=(1, 0, 0)),
        end_b=End(
            kind="clamped", position=(3, 0, -10), direction=(1, 0, 0),
            twist=Turn(t=tuple(seconds * x), angle=tuple(angle)),
        ),
    )  # fmt: skip


@lru_cache
def twisted() -> Response:
    """26 s of the hockle, 160 elements."""
    return solve(
        hockle(),
        Ask(model="rod", segments=160, duration=26.0, interval=0.1, method="genalpha", step=0.01, rho=0.5),
    )


def test_a_twisted_slack_cable_pops_into_a_loop() -> None:
    """It leaves its plane, the tangent turns back on itself (a loop), and the torque then drops by more than a third
    although the end still turns. Before that it follows the twist: GJ times turns over the length, within 15 %."""
    run = twisted()
    s = run.signals
    assert np.abs(s["position"][:, :, 1]).max() > 0.2
    assert np.diff(s["position"][:, :, 0], axis=1).min() < 0.0, "no element points back: no loop"
    torque = np.abs(s["torque"]).mean(axis=1)
    peak = int(np.argmax(torque))
    assert 10.0 < run.t[peak] < 20.0
    assert torque[-1] < 0.67 * torque[peak]
    early = int(np.searchsorted(run.t, 4.0))
    x = run.t[early] / 20.0
    straight = 0.015 * 2 * math.pi * 8 * (3 * x**2 - 2 * x**3) / 4.0
    assert torque[early] == pytest.approx(straight, rel=0.15)


def test_the_loop_closes_its_energy_balance_or_says_so() -> None:
    """The pop is fast and tight: at 160 elements the ledger gap is some 1e-3 to 1e-2, and the status tells."""
    run = twisted()
    assert (run.status == Status.OK) == (run.energy_residual <= 1e-3)
    assert run.energy_residual < 1e-2


def test_a_loop_that_the_mesh_cannot_follow_is_unresolved() -> None:
    """With 24 elements the loop turns by more than half a radian in one, though the start does not: the mesh is at
    fault, and the message says so, not that of an open ledger."""
    ask = Ask(model="rod", segments=24, duration=20.0, interval=0.1, method="genalpha", step=0.01, rho=0.5)
    run = solve(hockle(), ask)
    assert run.status == Status.UNRESOLVED
    assert "in the run" in run.message
    assert "segments" in run.message


def test_the_step_budget_is_that_of_the_whole_run() -> None:
    """Windows share `max_steps`; a run that needs 300 steps and may take 60 says so."""
    ask = Ask(model="hybrid", accuracy=0.01, segments=100, duration=6.0, interval=0.1, method="genalpha", step=0.02)
    found = solve(JUMPER, replace(ask, max_steps=60))
    assert found.status == Status.TOO_MANY_STEPS
    assert found.cost.steps <= 60


def test_auto_takes_a_hybrid_where_rotations_matter() -> None:
    """A turned end is beyond the lumped line; a thin boundary layer at a clamp is too thin for its segments. At rest
    the whole line is a rod: looking for domains would cost more."""
    assert Feature.TORSION in needs(hockle())
    rest, moved = Ask(segments=80), Ask(segments=80, duration=1.0)
    assert (cheapest(hockle(), rest).model, cheapest(hockle(), moved).model) == ("rod", "hybrid")
    assert "rotations matter" in cheapest(hockle(), moved).reason
    run = solve(hockle(), replace(rest, model="hybrid"))
    assert run.signals["domain"].all(), "torque passes no joint"
    rest, moved = Ask(segments=100), Ask(segments=100, duration=1.0)
    assert (cheapest(JUMPER, rest).model, cheapest(JUMPER, moved).model) == ("rod", "hybrid")
    assert "bending decays" in solve(JUMPER, rest).reason
