"""The choice of mesh, tolerance and method by pilots, on made-up runs whose errors are known."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from solvers import Cost, Response, Status, pilot

T = np.linspace(0.0, 1.0, 21)
LENGTH = 10.0


def run_of(segments: int, error: float, steps: int, status: Status = Status.OK, seed: int = 0) -> Response:
    """A line along x whose motion across is sin(pi s/L) cos(4t), with `error` times another shape on top."""
    s = np.linspace(0.0, LENGTH, segments + 1)
    still = np.stack([s, 0 * s, 0 * s], axis=1)
    x = np.repeat(still[None], len(T), axis=0)
    phase = 0.0 if seed == 0 else np.random.default_rng(seed).uniform(0, 2 * math.pi)
    x[:, :, 2] += np.cos(4 * T + phase)[:, None] * np.sin(math.pi * s / LENGTH)
    x[:, :, 2] += error * np.cos(4 * T)[:, None] * np.sin(2 * math.pi * s / LENGTH)
    signals = {"arc": s, "position": x, "static_position": still}
    cost = Cost(steps=steps, evaluations=6 * steps)
    return Response(status=status, t=T, signals=signals, segments=segments, cost=cost)


class Made:
    """Runs with an error C N^-p + D knob, counted."""

    def __init__(self, space: float = 40.0, late: float = 1.0, growth: float = 0.0) -> None:
        self.space, self.late, self.growth = space, late, growth
        self.asked: list[tuple[str, int, float]] = []

    def error(self, way: pilot.Way, segments: int, knob: float) -> float:
        return self.space * segments**-way.order + (self.late * knob if math.isfinite(knob) else 0.0)

    def __call__(self, way: pilot.Way, segments: int, knob: float) -> Response:
        self.asked.append((way.method, segments, knob))
        return run_of(segments, self.error(way, segments, knob), round(100 * (segments / 10) ** self.growth))


def way(method: str = "one", **fields: Any) -> pilot.Way:
    first: dict[str, Any] = {
        "model": "line", "method": method, "order": 2.0, "price": 1.0, "knob": 1e-2, "factor": 10.0, "tune": True,
    }  # fmt: skip
    return pilot.Way(**(first | fields))


@pytest.mark.parametrize("accuracy", [5e-2, 1e-2, 1e-3])
@pytest.mark.parametrize("order", [1.5, 2.0, 4.0])
def test_pilots_meet_the_accuracy_without_waste(accuracy: float, order: float) -> None:
    """The chosen run's true error lies below what was asked, its estimate above the truth, and its mesh costs at most
    twice what the coarsest good one would: 1.9 times its segments at order 1.5, for the safety on both errors."""
    made = Made()
    line = way(order=order)
    found = pilot.refine(made, [line], accuracy, 10)
    true = made.error(line, found.segments, found.knob)
    assert true <= accuracy
    assert true <= 1.1 * found.error <= 1.1 * accuracy  # the shape of the error is not that of the motion
    assert found.segments <= max(20, 1.9 * (made.space / accuracy) ** (1 / order))
    assert found.runs == len(set(made.asked)) == len(made.asked)  # none twice


def test_tolerance_that_costs_accuracy_is_made_finer() -> None:
    """An error of half the tolerance may take a third of the accuracy, by the orders of line and method: four fifths of
    that are aimed at."""
    made = Made(late=0.5)
    found = pilot.refine(made, [way()], 1e-3, 10)
    due = 0.8 * 1e-3 / 3
    assert found.knob == pytest.approx(due / 0.5, rel=0.1)  # the motion's rms is not quite that of its shape
    assert found.late == pytest.approx(due, rel=0.1)
    assert made.error(found.way, found.segments, found.knob) <= 1e-3


def test_tolerance_between_decades_that_errs_more_than_expected_is_not_taken() -> None:
    """The error jumps between two decades: the finer one is taken."""
    made = Made(late=0.5)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        error = made.error(line, segments, knob) + (1e-3 if 1.1e-4 < knob < 1e-3 else 0.0)
        return replace(made(line, segments, knob), signals=run_of(segments, error, 100).signals)

    found = pilot.refine(attempt, [way()], 1e-3, 10)
    assert found.knob == pytest.approx(1e-4)


def test_chosen_run_judges_cheaper_ones() -> None:
    """Contact makes the ledger of a loose tolerance open on coarse meshes alone, and the error of one mesh large: the
    way there went by a finer tolerance and a finer mesh than need be."""
    made = Made(late=0.1)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        error = made.error(line, segments, knob) * (3.0 if segments == 20 else 1.0)
        run = replace(made(line, segments, knob), signals=run_of(segments, error, 100).signals)
        run = replace(run, cost=run.cost._replace(evaluations=round(run.cost.evaluations * knob**-0.25)))
        return replace(run, status=Status.ENERGY_OPEN if knob > 9e-4 and segments <= 40 else Status.OK)

    judged = pilot.refine(attempt, [way()], 1e-2, 10)
    assert judged.response.status == Status.OK
    assert judged.knob == 1e-2  # of which 1e-3 is time's error
    assert made.error(judged.way, judged.segments, judged.knob) <= judged.error <= 1e-2


def test_a_finer_mesh_judges_where_the_chosen_run_is_not_good_enough() -> None:
    """The chosen run's error leaves no room for a run at a looser tolerance; a finer mesh's does."""
    made = Made(late=0.01)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        error = made.error(line, segments, knob) + (2.2e-3 if knob > 5e-3 else 0.0)
        run = replace(made(line, segments, knob), signals=run_of(segments, error, 100).signals)
        run = replace(run, cost=run.cost._replace(evaluations=round(run.cost.evaluations * knob**-0.25)))
        return replace(run, status=Status.ENERGY_OPEN if knob > 5e-3 and segments <= 40 else Status.OK)

    judged = pilot.refine(attempt, [way()], 1e-2, 10)
    assert judged.knob == 1e-2
    assert made.error(judged.way, judged.segments, judged.knob) + 2.2e-3 <= judged.error <= 1e-2
    judges = [segments for _, segments, knob in made.asked if knob < 1e-2]
    assert max(judges) > judged.segments


def test_the_error_in_time_is_that_of_the_chosen_mesh() -> None:
    """Modes that ring on fine meshes alone: the first mesh's error in time says nothing."""
    made = Made(late=0.0)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        error = made.error(line, segments, knob) + (3.0 * knob if segments > 30 else 0.0)
        return replace(made(line, segments, knob), signals=run_of(segments, error, 100).signals)

    found = pilot.refine(attempt, [way()], 1e-2, 10)
    assert made.error(found.way, found.segments, found.knob) + 3.0 * found.knob <= 1e-2
    assert found.error <= 1e-2
    assert found.late == pytest.approx(3.0 * found.knob, rel=0.2)


def test_open_ledger_makes_the_tolerance_finer() -> None:
    made = Made(late=0.0)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        status = Status.ENERGY_OPEN if knob > 2e-5 * 100 / segments else Status.OK
        return replace(made(line, segments, knob), status=status)

    found = pilot.refine(attempt, [way()], 1e-2, 10)
    assert found.response.status == Status.OK
    assert found.knob < 2e-5 * 100 / found.segments


def test_fixed_step_is_measured_and_left() -> None:
    """Half the step tells its error, twice their difference (first order, what a kink leaves); nothing is tuned."""
    found = pilot.refine(Made(late=1.0), [way(knob=0.02, factor=2.0, tune=False)], 1e-2, 10)
    assert found.knob == 0.02
    assert found.error > found.late == pytest.approx(0.02, rel=0.1)


def test_cheapest_way_is_taken() -> None:
    """On a fine mesh the method whose steps do not grow; on a coarse one that with the cheaper step."""
    grows, steady = way("grows"), way("steady", price=20.0)

    class Two(Made):
        def __call__(self, line: pilot.Way, segments: int, knob: float) -> Response:
            self.growth = 2.0 if line.method == "grows" else 0.0
            return super().__call__(line, segments, knob)

    assert pilot.refine(Two(), [grows, steady], 0.2, 10).way.method == "grows"
    assert pilot.refine(Two(), [grows, steady], 1e-4, 10).way.method == "steady"


def test_dear_explicit_method_is_not_tried() -> None:
    made = Made()
    dear = way("dear", least_steps=lambda segments: 1e6)
    assert pilot.refine(made, [dear, way("cheap")], 1e-2, 10).way.method == "cheap"
    assert {method for method, _, _ in made.asked} == {"cheap"}


def test_a_way_that_leaves_its_range_hands_over() -> None:
    """The cheaper line runs on coarse meshes and is found out of its range on finer ones; the other one takes over."""
    made = Made(late=0.0)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        strays = line.method == "small" and segments > 20
        return replace(made(line, segments, knob), status=Status.CANNOT_REPRESENT if strays else Status.OK)

    found = pilot.refine(attempt, [way("large", price=9.0), way("small")], 1e-2, 10)
    assert found.way.method == "large"
    assert found.response.status == Status.OK


def test_waveforms_that_do_not_converge_are_called_chaotic() -> None:
    """Each tolerance gives another phase: the error is NaN, and few pilots are spent on it."""

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        return run_of(segments, 0.0, 100, seed=1 + round(-10 * math.log10(knob)))

    found = pilot.refine(attempt, [way()], 1e-2, 10)
    assert found.chaotic
    assert math.isnan(found.error)
    assert found.runs <= 8


def test_two_meshes_that_agree_by_accident_are_not_believed() -> None:
    """The first two meshes have the same large error; a third between them tells."""
    made = Made(space=40.0, late=0.0)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        return run_of(segments, 0.1, 100) if segments in (10, 20) else made(line, segments, knob)

    found = pilot.refine(attempt, [way()], 1e-2, 10)
    assert found.segments > 20
    assert made.error(found.way, found.segments, found.knob) <= 1e-2


def test_bound_on_work_ends_the_ladder() -> None:
    """Runs so dear that few are allowed: the estimate stays above what was asked, which `solve` calls UNRESOLVED."""
    made = Made(late=0.0)

    def attempt(line: pilot.Way, segments: int, knob: float) -> Response:
        return replace(made(line, segments, knob), cost=Cost(steps=100, evaluations=10**8))

    found = pilot.refine(attempt, [way()], 1e-6, 10)
    assert found.error > 1e-6
    assert len(made.asked) < 8


def test_gap_of_runs_that_cannot_be_compared() -> None:
    good = run_of(10, 0.0, 1)
    assert pilot.gap(good, good) == 0.0
    assert pilot.gap(replace(good, status=Status.DIVERGED), good) == math.inf
    assert pilot.gap(replace(good, t=T[:5]), good) == math.inf
    assert pilot.gap(run_of(10, 0.1, 1), good) == pytest.approx(0.1, rel=0.02)  # splines through 11 nodes


@pytest.mark.parametrize("p", [0.7, 1.0, 2.0, 3.3])
def test_order_seen(p: float) -> None:
    meshes = [20, 40, 100]
    apart = [a**-p - b**-p for a, b in pairwise(meshes)]
    assert pilot.order_seen(meshes, apart, 4.0) == pytest.approx(p, rel=1e-6)
    assert pilot.order_seen(meshes, apart, min(p, 0.6)) <= max(0.6, p)
