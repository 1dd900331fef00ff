"""Fatigue of real runs: harmonic balance against a march, and one line against another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from solvers import Ask, solve
from solvers.scene import End, Harmonic, Motion, Scene, Section, Water, Window
from sweep.config import MetricSettings, load_study
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


def test_lines_agree_on_the_damage():
    """Splines in offset against cubic elements in position: two discretisations, two codes, one damage."""
    study = load_study(Path(__file__).parents[2] / "configs" / "plain_cable.yaml")
    motion = study.scene.end_b.motion
    assert motion is not None
    smooth = replace(motion, window=Window(stop=0.5, ramp_up=0.2, ramp_down=0.2, shape="smooth"))
    scene = replace(study.scene, devices=(), end_b=replace(study.scene.end_b, motion=smooth))
    settings = MetricSettings(fatigue=Fatigue(E=1.15e11, m=3.0, log_a=11.0, fibre=0.02))
    found = []
    for model in ("hermite", "transverse"):
        run = solve(scene, Ask(duration=1.0, model=model, segments=40))
        assert run.trusted
        summary = summarise(run, scene, settings)
        assert summary is not None
        found.append(summary.wear)
    # 0.3 % apart over 2 s (lumped segments, of order 2: -2.5 % at 80, -1.5 % at 100)
    assert found[0].damage == pytest.approx(found[1].damage, rel=0.01)
    assert found[0].s == found[1].s == 0.0  # the lower clamp
