"""Error bars and growth rates by hand, and what the evaluator makes of them with a made-up solver."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from study_kit import response
from test_evaluate import ASK, EVALUATOR, SHAPE, T, point, solver  # noqa: F401  (a fixture)

from solvers import PointMass, Status
from sweep.config import Uncertainty
from sweep.evaluate import evaluate
from sweep.metrics import metric_names
from sweep.uncertainty import chaos, deviations, growth, parts, twin_growth

ASKED = Uncertainty(runs=4, perturbation=1e-8, refine=1.5)


def test_without_chance_the_differences_count():
    """s = 0; 0.03 of the tolerance, 0.05 of the mesh times 1.5^2/(1.5^2 - 1) = 1.8."""
    found = parts(1.0, [1.0, 1.0], 1.03, 0.95, 1.5)
    assert found == pytest.approx((0.0, 0.03, 0.09))
    assert found.total == pytest.approx(math.hypot(0.03, 0.09))


def test_what_chance_explains_is_not_counted_twice():
    """1, 3, 2, 2: s^2 = 2/3; differences up to sqrt(2) s = 1.155 say nothing of tolerance and mesh, 2 does."""
    s = math.sqrt(2 / 3)
    assert parts(1.0, [3.0, 2.0, 2.0], 2.1, 0.0, 1.5) == pytest.approx((s, 0.0, 0.0))
    assert parts(1.0, [3.0, 2.0, 2.0], 3.0, 0.0, 1.5) == pytest.approx((s, math.sqrt(4 - 4 / 3), 0.0))


def test_chance_alone_gives_the_right_width():
    """Draws of standard deviation 1 everywhere: E[s^2] = 1, and noise left in the squares adds a little and no less."""
    draws = np.random.default_rng(0).standard_normal((4000, 7))
    squares = [parts(row[0], row[1:5], row[5], row[6], 2.0).total ** 2 for row in draws]
    assert 1.0 <= np.mean(squares) <= 5.0  # 1 and twice E[max(0, d^2 - 2 s^2)], some 0.9, the second times (4/3)^2
    sensitivity = [parts(row[0], row[1:5], row[5], row[6], 2.0).sensitivity ** 2 for row in draws]
    assert np.mean(sensitivity) == pytest.approx(1.0, abs=0.05)  # 4000 draws of chi2(4)/4: standard error 0.011


@pytest.mark.parametrize("at", range(4))
def test_unknown_is_never_zero(at):
    values = [1.0, 1.0, 1.0, 1.0]
    values[at] = math.nan if at % 2 else math.inf
    assert math.isnan(parts(values[0], [values[1], 1.0], values[2], values[3], 1.5).total)


def test_a_settled_response_has_no_ensemble():
    assert parts(1.0, [], 1.03, 1.0, 1.5) == pytest.approx((0.0, 0.03, 0.0))


def test_every_metric_gets_its_own():
    rows = [{"a": 1.0, "b": 2.0}, {"a": 1.0, "b": math.nan}]
    found = deviations(rows[0], [rows[0], rows[1]], rows[0], rows[0], 2.0)
    assert found["a_sd"] == 0.0  # runs that agree to the last bit
    assert math.isnan(found["b_sd"])


# ------------------------------------------------------------------------------------------ growth


def test_growth_is_the_exponent():
    t = np.linspace(0, 4, 401)
    assert growth(t, 1e-9 * np.exp(-0.7 * t), 1.0) == pytest.approx((-0.7, False, 4.0))
    grown = growth(t, np.minimum(1e-9 * np.exp(8 * t), 0.5), 1.0)
    assert grown.rate == pytest.approx(8.0)
    assert grown.saturated
    assert grown.time == pytest.approx(math.log(1e8) / 8, abs=0.01)  # a sample


def test_growth_stops_in_the_rounding():
    t = np.linspace(0, 40, 401)
    found = growth(t, np.maximum(1e-9 * np.exp(-1.0 * t), 1e-16), 1.0)
    assert found.rate == pytest.approx(-1.0, rel=0.02)  # a sample of 0.1 s of 6.9 s
    assert not found.saturated


def test_growth_that_cannot_be_told():
    t = np.linspace(0, 4, 5)
    assert math.isnan(growth(t, np.full(5, 0.5), 1.0).rate)
    assert growth(t, np.full(5, 0.5), 1.0).saturated
    assert math.isnan(growth(t, np.zeros(5), 1.0).rate)
    assert math.isnan(growth(t, np.full(5, math.nan), 1.0).rate)
    assert math.isnan(growth(t, np.full(5, 1e-9), 0.0).rate)
    assert math.isnan(growth(t[:1], np.ones(1), 1.0).rate)


def test_chaos_of_several_twins():
    t = np.linspace(0, 4, 401)
    found = chaos([growth(t, 1e-9 * np.exp(rate * t), 1.0) for rate in (1.0, 2.0)])
    assert found["chaos"] == pytest.approx(1.5)
    assert found["chaos_sd"] == pytest.approx(0.5)
    assert found["chaos_saturated"] == 0.0
    assert math.isnan(chaos([growth(t, np.exp(t), 1e9)])["chaos_sd"])
    assert math.isnan(chaos([])["chaos"])


def test_twins_are_compared_along_the_cable():
    still = response(np.zeros((len(T), 5)), T, v=np.outer(np.ones(len(T)), SHAPE))
    other = response(np.zeros((len(T), 5)), T, v=np.outer(1 + 1e-9 * np.exp(2 * T), SHAPE))
    assert twin_growth(still, other).rate == pytest.approx(2.0)


# ------------------------------------------------------------------------------------------ the evaluator


def test_every_metric_of_a_row_has_its_deviation(solver):  # noqa: F811
    solver.nudge = 0.01
    record = evaluate(point(uncertainty=ASKED))
    assert record.trusted
    assert set(record.metrics) == {*metric_names(1), *(f"{name}_sd" for name in metric_names(1))}
    _, *members, closer, finer = solver.alive
    assert [ask.seed for ask in members] == [1, 2, 3, 4]
    assert {ask.perturbation for ask in members} == {1e-8}
    used = members[0].tolerance
    assert [ask.tolerance / used for ask in members] == pytest.approx([1, 0.98, 1, 0.96])
    assert (closer.tolerance / used, closer.perturbation) == pytest.approx((0.1, 0.0))
    assert (finer.segments, finer.tolerance) == (6, used)
    deltas = np.array([0.5, 0.51, 0.52, 0.53, 0.54]) ** 2
    assert record.metrics["delta"] == pytest.approx(0.25)
    assert record.metrics["delta_sd"] == pytest.approx(deltas.std(ddof=1))
    assert math.isnan(record.metrics["t_first_sd"])  # infinite


def test_the_baseline_is_refined_too(solver):  # noqa: F811
    evaluate(point(uncertainty=ASKED))
    bases = [ask for scene, ask in solver.asked if all(isinstance(device, PointMass) for device in scene.devices)]
    assert [ask.segments for ask in bases] == [4, 4, 6]
    assert bases[1].tolerance == pytest.approx(bases[2].tolerance / 10)


def test_a_part_that_fails_is_said_and_not_a_zero(solver, monkeypatch):  # noqa: F811
    def spoilt(scene, ask):
        found = solver(scene, ask)
        return replace(found, status=Status.UNRESOLVED) if ask.segments == 6 else found

    monkeypatch.setattr(EVALUATOR, "solve", spoilt)
    record = evaluate(point(uncertainty=ASKED))
    assert record.trusted
    assert record.metrics["delta"] == pytest.approx(0.25)
    assert math.isnan(record.metrics["delta_sd"])
    assert "the run on 6 segments ended UNRESOLVED" in record.message


def test_an_untrusted_run_is_not_repeated(solver):  # noqa: F811
    solver.statuses[True] = Status.UNRESOLVED
    record = evaluate(point(uncertainty=ASKED))
    assert len(solver.alive) == 1
    assert record.status == "UNRESOLVED"
    assert "delta_sd" not in record.metrics  # which results show as NaN


def test_fixed_steps_are_halved(solver):  # noqa: F811
    evaluate(point(replace(ASK, method="rk4", step=1e-3), uncertainty=Uncertainty(runs=2, refine=2.0)))
    _, same, shorter, half, finer = solver.alive
    assert [ask.step for ask in (same, shorter, half, finer)] == pytest.approx([1e-3, 0.98e-3, 0.5e-3, 0.25e-3])


def test_a_step_of_the_mesh_is_made_finer_too(solver):  # noqa: F811
    evaluate(point(replace(ASK, method="srkn4"), uncertainty=Uncertainty(runs=2, refine=2.0)))
    _, same, shorter, half, finer = solver.alive
    assert [ask.step for ask in (same, shorter, half)] == pytest.approx([1e-3, 0.98e-3, 0.5e-3])
    assert finer.step is None  # the finer mesh has one of its own


def test_twins_of_a_decay_are_not_chaotic(solver):  # noqa: F811
    """The made-up solver's runs differ by a share that stays: growth of a decay, -1/s."""
    solver.nudge = 1e-9
    record = evaluate(point(uncertainty=ASKED))
    assert record.metrics["chaos"] == pytest.approx(-1.0, rel=0.02)  # velocities by differences on the grid
    assert record.metrics["chaos_saturated"] == 0.0
    assert record.metrics["chaos_sd"] < 0.01


def test_keys_know_of_uncertainty_only_where_it_is_asked_for():
    assert point().key == point(uncertainty=None).key
    assert point(uncertainty=ASKED).key != point().key
    assert point(uncertainty=ASKED).key != point(uncertainty=replace(ASKED, runs=5)).key
