"""Plans: the same study makes the same plan, slices share the work, and a changed study is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from test_config import GOOD, study
from test_evaluate import EVALUATOR, Solver

from solvers import Status
from sweep.config import parse_study
from sweep.mistakes import ConfigError
from sweep.plan import make_plan, pilot, pilot_places, predicted, read_plan, write_plan
from sweep.space import points

ENVIRONMENTS = [{"name": "calm"}, {"name": "heavy", "set": {"cable[0].mass": 12}}]


def test_a_plan_lists_every_point():
    whole = parse_study(study(environments=ENVIRONMENTS))
    plan = make_plan(whole)
    assert len(plan) == 16
    assert plan.keys == [point.key for point in points(whole)]
    assert plan.environments == ["calm", "heavy"]
    assert [(p.design, p.environment) for p in plan.points(whole)][:3] == [(0, 0), (0, 1), (1, 0)]
    assert [baseline["points"] for baseline in plan.baselines] == [8, 8]


def test_the_same_study_makes_the_same_plan():
    assert make_plan(parse_study(GOOD)) == make_plan(parse_study(study()))
    assert make_plan(parse_study(GOOD), 3).keys == make_plan(parse_study(GOOD)).keys[:3]


def test_a_plan_survives_the_disk(tmp_path):
    plan = make_plan(parse_study(study(metrics={"window": [0, 1.5]}, repeats={"n": 2})))
    write_plan(plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json") == plan
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"format": 99}', '{"format": 1, "settings": {}}', "{"])
def test_what_is_no_plan_is_said(tmp_path, text):
    (tmp_path / "plan.json").write_text(text)
    with pytest.raises(ConfigError, match="not a plan"):
        read_plan(tmp_path / "plan.json")


def test_a_missing_plan_is_said(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_plan(tmp_path / "plan.json")


def test_another_study_is_refused():
    plan = make_plan(parse_study(GOOD))
    with pytest.raises(ConfigError, match="the study has changed"):
        plan.point(parse_study(study(ask={"duration": 3.0})), 0)


@pytest.mark.parametrize("n", [1, 2, 3, 20])
def test_slices_share_out_all_points_once(n):
    plan = make_plan(parse_study(GOOD))
    found = [i for k in range(n) for i in plan.slice(k, n)]
    assert sorted(found) == list(range(8))


def test_slices_share_out_the_predicted_cost():
    """By count a slice would have up to 36 of 72; the cheapest cut into three has 24 each."""
    plan = make_plan(parse_study(GOOD))
    plan.costs[:] = [1, 9, 3, 16, 1, 25, 8, 9]
    loads = [float(plan.costs[plan.slice(k, 3)].sum()) for k in range(3)]
    assert sorted(loads) == [23, 24, 25]
    assert sorted(i for k in range(3) for i in plan.slice(k, 3)) == list(range(8))


def test_equal_physics_is_in_one_slice_only():
    plan = make_plan(parse_study(GOOD))
    plan.keys.numbers[5] = plan.keys.numbers[2]
    assert sorted(i for k in range(3) for i in plan.slice(k, 3)) == [0, 1, 2, 3, 4, 6, 7]
    assert plan.keys.index(plan.keys[5]) == 2


def test_costs_survive_the_disk_and_a_first_format_is_read(tmp_path):
    plan = make_plan(parse_study(GOOD))
    plan.costs[:] = np.linspace(0.1, 7, 8, dtype=np.float32)
    write_plan(plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").costs == pytest.approx(plan.costs, rel=1e-5)
    content = json.loads((tmp_path / "plan.json").read_text())
    names = content.pop("variables")
    content["designs"] = [dict(zip(names, row, strict=True)) for row in content["designs"]]
    content["keys"] = [key for key, _ in content.pop("points")]
    content |= {"format": 1}
    del content["different"]
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert read_plan(tmp_path / "old.json") == plan


def test_costs_are_predicted_from_some_points():
    """Work that grows by a factor of 30 along one variable and doubles in the second environment, seen at 8 of 16."""
    plan = make_plan(parse_study(study(environments=ENVIRONMENTS)))
    first = plan.designs.column(plan.designs.names[0])
    rank = np.searchsorted(np.unique(first), first) / (len(np.unique(first)) - 1)
    true = np.outer(np.exp(np.log(30) * rank), [1, 2]).ravel()
    known = {i: float(true[i]) for i in pilot_places(plan, 8)}
    found = predicted(plan, known)
    ratio = found / true * (true[0] / found[0])
    assert max(ratio) / min(ratio) < 1.5  # the ridge pulls towards the mean; without predictions it is 60
    assert predicted(plan, dict(list(known.items())[:2])).tolist() == [1.0] * 16


@pytest.mark.parametrize(("k", "n"), [(2, 2), (-1, 2), (0, 0)])
def test_bad_slices_are_refused(k, n):
    with pytest.raises(ValueError, match="K must be 0 to N-1"):
        make_plan(parse_study(GOOD)).slice(k, n)


def test_pilot_counts_work(monkeypatch):
    solver = Solver()
    monkeypatch.setattr(EVALUATOR, "solve", solver)
    found = pilot(parse_study(GOOD))
    assert [run.label for run in found] == ["first", "least", "greatest"]
    assert [scene.devices[0].EA for scene, _ in solver.asked][1:] == [1e4, 5e10]
    assert [run.work for run in found] == [7 * 5] * 3
    assert all(run.response.status == Status.OK for run in found)
