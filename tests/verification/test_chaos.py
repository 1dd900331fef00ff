"""Growth of twins against variational equations: a forced Duffing oscillator, a linear one, and the study's cable."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from march_kit import march_oscillator

from solvers import solve
from solvers.lines.oscillator import oscillator
from solvers.model import Status
from sweep.config import load_study
from sweep.space import baseline_scene, design_scene
from sweep.uncertainty import Growth, growth, twin_growth

C, STIFF, FORCE, OMEGA = 0.05, 1.0, 7.5, 1.0  # Ueda's oscillator, x'' + 0.05 x' + x^3 = 7.5 cos t: chaotic
CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def ueda(force: float = FORCE) -> object:
    return oscillator(m=1.0, c=C, k1=0.0, k3=STIFF, force=((force, OMEGA, 0.0),))


def twins(pack: object, q: float, v: float, last: float, apart: float = 1e-9) -> tuple[np.ndarray, ...]:
    """Times, displacement of the first, and the distance of twins that start `apart` in velocity."""
    grid = np.linspace(0.0, last, round(last / 0.01) + 1)
    one, other = (
        march_oscillator(pack, [q], [v + shift], grid, "dopri5", tol=1e-14) for shift in (0.0, apart)
    )
    assert one.status == other.status == Status.OK
    return grid, one.q[:, 0], np.hypot(one.q - other.q, one.v - other.v)[:, 0], np.hypot(one.q, one.v)[:, 0]


def tangent_growth(t: np.ndarray, x: np.ndarray, last: float) -> float:
    """ln |y(last)|/|y(0)| of y'' + C y' + 3 x(t)^2 y = 0 along a run, from y = (0, 1): classical Runge-Kutta over two
    output intervals each, rescaled at each. Its error, (0.02 x 7/s)^5/120 a step, is 4e-3 of ln |y| over 180 s."""
    y, total, h = np.array([0.0, 1.0]), 0.0, float(t[2] - t[0])
    for i in range(0, round(last / h) * 2, 2):
        first, middle, end = (np.array([[0.0, 1.0], [-3 * STIFF * x[i + j] ** 2, -C]]) for j in range(3))
        k1 = first @ y
        k2 = middle @ (y + h / 2 * k1)
        k3 = middle @ (y + h / 2 * k2)
        k4 = end @ (y + h * k3)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        size = float(np.linalg.norm(y))
        total, y = total + math.log(size), y / size
    return total


def test_chaotic_duffing_grows_as_its_variation_does() -> None:
    """Within 3 %: the difference is a tenth of the motion at the end, where the tangent is off by some such share of
    ln(1e8) = 18; the march and the spline are better. The literature has 0.10 to 0.11 per second for this oscillator;
    windows of some 180 s scatter about it.
    """
    rates, exact = [], []
    for q, v in ((2.5, 0.0), (1.0, 1.0), (-2.0, 0.5)):
        t, x, gap, size = twins(ueda(), q, v, 300.0)
        found = growth(t, gap, float(size.max()))
        assert found.saturated
        rates.append(found.rate)
        exact.append(tangent_growth(t, x, found.time) / found.time)
    assert rates == pytest.approx(exact, rel=0.03)
    assert np.mean(rates) == pytest.approx(0.105, rel=0.3)


def test_a_regular_duffing_does_not_grow() -> None:
    """The same oscillator pushed weakly settles on its period: differences die, at the rate of the variation. To 2 %:
    the march's own errors, 1e-7 of the motion, beside a difference that falls from 1e-6 to 1e-8."""
    t, x, gap, size = twins(ueda(0.2), 0.0, 0.0, 300.0, apart=1e-6)
    found = growth(t, gap, float(size.max()))
    assert not found.saturated
    assert found.rate < -0.01
    assert found.rate == pytest.approx(tangent_growth(t, x, found.time) / found.time, rel=0.02)


def test_a_linear_oscillator_decays_at_its_rate() -> None:
    """m = k = 1, c = 0.2: exactly c/2 but for the phase within a period: ln(2)/60 s at most."""
    pack = oscillator(c=0.2, k1=1.0, force=((1.0, 0.7, 0.0),))
    t, _, gap, size = twins(pack, 0.0, 0.0, 60.0, apart=1e-3)
    found: Growth = growth(t, gap, float(size.max()))
    assert found.rate == pytest.approx(-0.1, abs=math.log(2) / 60)


def test_impacts_are_chaotic_and_locked_masses_are_not() -> None:
    """Table 1's sinks on a coarse mesh: the difference grows e-fold each 0.1 s or faster; with the masses locked it
    decays by the water's drag. Numbers at N = 100 are in docs/robustness.md."""
    study = load_study(CONFIGS / "bnes_optimum.yaml")
    ask = replace(study.ask, segments=40, duration=2.0)
    scene = design_scene(study, {}, 0)
    found = {}
    for name, case in (("sinks", scene), ("locked", baseline_scene(scene, "locked"))):
        one, other = (solve(case, replace(ask, perturbation=shift, seed=1)) for shift in (0.0, 1e-9))
        found[name] = twin_growth(one, other)
    assert found["sinks"].saturated
    assert found["sinks"].rate > 10.0
    assert not found["locked"].saturated
    assert found["locked"].rate < 0.0
