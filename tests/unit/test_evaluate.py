"""The evaluator against a made-up solver: retries, baselines, error bars, and that nothing escapes it."""

from __future__ import annotations

import dataclasses
import importlib
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from study_kit import response, scene

from solvers import METHODS, Ask, CannotRepresent, Cost, PointMass, Status
from sweep import evaluate as package_evaluate
from sweep.config import MetricSettings
from sweep.evaluate import clear_baselines, evaluate, evaluate_with_series
from sweep.metrics import metric_names
from sweep.point import Point
from sweep.space import point_key

T = np.linspace(0, 5, 501)
SHAPE = np.array([0.0, 1.0, 3.0, 2.0, 0.0])
EVALUATOR = importlib.import_module("sweep.evaluate")  # `sweep.evaluate` is the function
ASK = Ask(duration=5.0, interval=0.01)


class Solver:
    """Answers with exp(-t), halved where a sink is alive, and remembers what it was asked."""

    def __init__(self):
        self.asked = []
        self.statuses = {}  # (alive, tolerance) or alive: status
        self.nudge = 0.0

    def __call__(self, scene, ask):
        alive = any(not isinstance(device, PointMass) for device in scene.devices)
        self.asked.append((scene, ask))
        status = self.statuses.get((alive, ask.tolerance), self.statuses.get(alive, Status.OK))
        if isinstance(status, Exception):
            raise status
        size = 0.5 + self.nudge * ask.seed if alive else 1.0
        stroke = np.zeros((len(T), len(scene.devices)))
        found = response(np.outer(size * np.exp(-T), SHAPE), T, stroke=stroke, status=status)
        seconds = 1.0 if ask.tolerance is None else 10.0
        method = "dopri5" if ask.method == "auto" else ask.method
        adapts = METHODS[method].adaptive
        used = (ask.tolerance or METHODS[method].tolerance) if adapts else float("nan")
        step = ask.step or (1e-3 if METHODS[method].own_step else float("nan"))
        cost = Cost(steps=7, evaluations=49, seconds=seconds)
        return replace(found, cost=cost, method=method, tolerance=used, step=step)

    @property
    def alive(self):
        return [ask for scene, ask in self.asked if any(not isinstance(d, PointMass) for d in scene.devices)]


@pytest.fixture
def solver(monkeypatch):
    solver = Solver()
    monkeypatch.setattr(EVALUATOR, "solve", solver)
    clear_baselines()
    yield solver
    clear_baselines()


def point(ask=ASK, the_scene=None, **settings):
    the_scene = the_scene or scene()
    chosen = MetricSettings(**settings)
    return Point(
        key=point_key(the_scene, ask, chosen),
        design=3,
        environment=1,
        values={"EA": 1e6},
        scene=the_scene,
        ask=ask,
        settings=chosen,
    )


def test_a_good_point(solver):
    record = package_evaluate(point())
    assert record.trusted
    assert (record.key, record.design, record.environment, record.values) == (point().key, 3, 1, {"EA": 1e6})
    assert record.metrics["delta"] == pytest.approx(0.25)
    assert record.metrics["gamma"] == pytest.approx(0.75)
    assert list(record.metrics) == metric_names(1)
    assert (record.steps, record.evaluations, record.seconds, record.first_seconds) == (7, 49, 1.0, 0.0)
    assert (record.model, record.method, record.segments) == ("lumped", "dopri5", 4)
    assert record.tolerance > 0


def test_the_baseline_runs_once_for_all_that_share_it(solver):
    for EA in (1e5, 1e6, 1e7):
        device = dataclasses.replace(scene().devices[0], EA=EA)
        assert evaluate(point(the_scene=scene((device,)))).trusted
    assert len(solver.asked) == 4
    evaluate(point(baseline="plain"))
    evaluate(point(window=(0, 2)))
    assert len(solver.asked) == 8


def test_the_baseline_uses_the_designs_model_method_and_mesh(solver):
    evaluate(point())
    (_, first), (base, second) = solver.asked
    assert [d.kind for d in base.devices] == ["locked"]
    assert (first.model, first.method, first.segments) == ("auto", "auto", None)
    assert (second.model, second.method, second.segments) == ("lumped", "dopri5", 4)


def test_a_scene_that_is_its_own_baseline_runs_once(solver):
    record = evaluate(point(the_scene=scene(()), baseline="plain"))
    assert len(solver.asked) == 1
    assert record.metrics["delta"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    "status", [Status.ENERGY_OPEN, Status.NO_CONVERGENCE, Status.COARSE_STEP, Status.DIVERGED]
)
def test_an_untrusted_run_is_retried_once_at_a_tenth(solver, status):
    solver.statuses[True, 1e-4] = status
    record = evaluate(point(replace(ASK, tolerance=1e-4)))
    assert [ask.tolerance for ask in solver.alive] == [1e-4, pytest.approx(1e-5)]
    assert record.trusted
    assert record.tolerance == pytest.approx(1e-5)
    assert (record.first_seconds, record.seconds) == (10.0, 10.0)


def test_a_retry_that_fails_too_keeps_its_status_and_metrics(solver):
    solver.statuses[True] = Status.ENERGY_OPEN
    record = evaluate(point())
    assert len(solver.alive) == 2
    assert record.status == "ENERGY_OPEN"
    assert "lower `tolerance`" in record.message
    assert record.metrics["delta"] == pytest.approx(0.25)


def test_a_finished_run_beats_a_retry_that_broke(solver):
    solver.statuses = {(True, 1e-4): Status.ENERGY_OPEN, True: Status.TOO_MANY_STEPS}
    record = evaluate(point(replace(ASK, tolerance=1e-4)))
    assert (record.status, record.tolerance) == ("ENERGY_OPEN", 1e-4)
    assert record.metrics["delta"] == pytest.approx(0.25)


@pytest.mark.parametrize(
    "status", [Status.UNRESOLVED, Status.TOO_MANY_STEPS, Status.NO_STATIC, Status.STEP_TOO_SMALL]
)
def test_what_a_tighter_tolerance_cannot_mend_is_not_retried(solver, status):
    solver.statuses[True] = status
    record = evaluate(point())
    assert len(solver.alive) == 1
    assert record.status == status.name
    assert math.isnan(record.metrics["delta"]) == (status != Status.UNRESOLVED)


@pytest.mark.parametrize("method", ["rk2", "rk4", "genalpha"])
def test_fixed_steps_are_never_retried(solver, method):
    solver.statuses[True] = Status.ENERGY_OPEN
    record = evaluate(point(replace(ASK, method=method, step=1e-4)))
    assert len(solver.alive) == 1
    assert math.isnan(record.tolerance)


def test_a_step_of_the_mesh_is_halved_once(solver):
    solver.statuses[True] = Status.ENERGY_OPEN
    record = evaluate(point(replace(ASK, method="srkn4")))
    assert [(ask.method, ask.step) for ask in solver.alive] == [("srkn4", None), ("srkn4", 0.5e-3)]
    assert record.status == "ENERGY_OPEN"
    assert len({ask.segments for ask in solver.alive[1:]} - {None}) == 1


def test_a_failed_run_is_a_row_of_nans(solver):
    solver.statuses[True] = Status.NO_STATIC
    record = evaluate(point())
    assert len(solver.asked) == 1
    assert set(record.metrics) == set(metric_names(1))
    assert all(math.isnan(value) for value in record.metrics.values())
    assert "no static start" in record.message


def test_an_untrusted_baseline_is_said(solver):
    solver.statuses[False] = Status.ENERGY_OPEN
    record = evaluate(point())
    assert record.status == "BASELINE_FAILED"
    assert "the baseline `locked` ended ENERGY_OPEN" in record.message
    assert record.metrics["delta"] == pytest.approx(0.25)


def test_a_failed_baseline_leaves_what_needs_none(solver):
    solver.statuses[False] = Status.DIVERGED
    record = evaluate(point())
    assert record.status == "BASELINE_FAILED"
    assert math.isnan(record.metrics["delta"])
    assert record.metrics["t_settle"] > 0


def test_a_baseline_that_cannot_be_represented(solver):
    solver.statuses[False] = CannotRepresent("no locked masses here")
    assert "no locked masses here" in evaluate(point()).message


@pytest.mark.parametrize(
    "error", [ZeroDivisionError("x"), MemoryError(), ValueError("many\nlines"), RecursionError()]
)
def test_nothing_escapes(solver, error):
    solver.statuses[True] = error
    record = evaluate(point())
    assert record.status == ("MEMORY" if isinstance(error, MemoryError) else "ERROR")
    assert type(error).__name__ in record.message
    assert "\n" not in record.message
    assert all(math.isnan(value) for value in record.metrics.values())


def test_cannot_represent_is_a_status(solver):
    solver.statuses[True] = CannotRepresent("`local` has no contact: seabed")
    record = evaluate(point())
    assert (record.status, record.message) == ("CANNOT_REPRESENT", "`local` has no contact: seabed")


def test_warnings_of_a_run_stay_inside(solver, monkeypatch):
    def noisy(scene, ask):
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        np.float64(1.0) / np.float64(0.0)
        return solver(scene, ask)

    monkeypatch.setattr(EVALUATOR, "solve", noisy)
    with np.errstate(all="raise"):
        assert evaluate(point()).trusted


def test_repeats_give_half_ranges(solver):
    """Amplitudes 0.5, 0.51, 0.52: delta from 0.25 to 0.2704."""
    solver.nudge = 0.01
    record = evaluate(point(repeats=2, perturbation=1e-8, objectives=("delta", "gamma_worst", "t_first")))
    assert [(ask.seed, ask.perturbation) for ask in solver.alive] == [(0, 0.0), (1, 1e-8), (2, 1e-8)]
    assert record.metrics["delta"] == pytest.approx(0.25)
    assert record.metrics["delta_spread"] == pytest.approx((0.52**2 - 0.25) / 2)
    assert record.metrics["gamma_spread"] == pytest.approx((0.52**2 - 0.25) / 2)
    assert math.isnan(record.metrics["t_first_spread"])  # infinite in all three
    assert record.metrics["delta_ensemble"] == pytest.approx((0.25 + 0.51**2 + 0.52**2) / 3)
    assert math.isinf(record.metrics["t_first_ensemble"])


def test_a_mean_over_repeats_needs_one_that_can_be_trusted(solver, monkeypatch):
    def lonely(scene, ask):
        found = solver(scene, ask)
        return replace(found, status=Status.NO_STATIC) if ask.seed else found

    monkeypatch.setattr(EVALUATOR, "solve", lonely)
    record = evaluate(point(repeats=2, objectives=("delta_ensemble",)))
    assert record.trusted
    assert math.isnan(record.metrics["delta_ensemble"])
    assert "delta_ensemble" not in evaluate(point(repeats=0, objectives=("delta_ensemble",))).metrics


def test_series(solver):
    record, series = evaluate_with_series(point(), baselines=["locked", "plain"])
    assert record.trusted
    assert series["position"].dims == ("time", "node", "axis")
    assert series["plain_position"].dims == ("time", "plain_node", "axis")
    assert float(series["transverse"][0, 2, 0]) == pytest.approx(1.5)
    assert float(series["locked_transverse"][0, 2, 0]) == pytest.approx(3.0)
    assert float(series["G"][-1]) == pytest.approx(record.metrics["gamma"])
    assert float(series["rest_offset"][0]) == pytest.approx(0.5 * math.sin(math.radians(3.562)))
    assert series["tension"].attrs["units"] == "N"


def test_series_of_a_failed_run_are_empty(solver):
    solver.statuses[True] = ValueError("no")
    record, series = evaluate_with_series(point())
    assert record.status == "ERROR"
    assert not series.data_vars
