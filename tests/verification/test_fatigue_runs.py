"""Fatigue of a settled response: by harmonic balance and by a march it takes the same years."""

from __future__ import annotations

import pytest

from solvers import Ask, solve
from solvers.scene import End, Harmonic, Motion, Scene, Section, Water
from sweep.config import MetricSettings
from sweep.fatigue import Fatigue
from sweep.metrics import compute, summarise


def test_settled_damage_is_that_of_a_march():
    terms = (
        Harmonic(amplitude=(0.05, 0, 0.005), frequency=0.5),
        Harmonic(amplitude=(0.03, 0, 0), frequency=1.0, phase=0.4),
    )
    scene = Scene(
        cable=(Section(length=10.0, d=0.05, mass=5.0, EA=1e6, EI=1500.0, BA=2e3),),
        end_a=End(kind="pinned", position=(0, 0, -12)),
        end_b=End(kind="clamped", position=(0, 0, -1.96), direction=(0, 0, 1), motion=Motion(harmonics=terms)),
        water=Water(density=1025.0),
    )
    settings = MetricSettings(fatigue=Fatigue(E=1e11, m=3.0, log_a=11.0, fibre=0.02))
    balance = solve(scene, Ask(duration=2.0, method="harmonic", segments=24, interval=0.005))
    march = solve(scene, Ask(duration=40.0, method="explicit", output_from=20.0, segments=24, interval=0.005))
    assert balance.trusted
    assert march.trusted
    one, ten = (summarise(run, scene, settings) for run in (balance, march))
    assert one is not None
    assert ten is not None
    assert one.wear.seconds == pytest.approx(2.0)
    years = [compute(run, None, 0)["fatigue_life"] for run in (one, ten)]
    # the march leaves its residue as half cycles, here of one period in ten; both resolve their peaks to 1e-3
    assert years[0] == pytest.approx(years[1], rel=0.1)
    assert years[0] < years[1]
    assert one.wear.s == ten.wear.s
    assert max(one.wear.gap, ten.wear.gap) < 0.01
