"""Whole numbers, words and whole parts as design variables; the number of devices; constraints."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import yaml
from fakes import planned
from rich.console import Console
from test_config import mistakes, one, study

from solvers import BNES, TMD, PointMass
from sweep import pareto, report
from sweep.config import parse_study
from sweep.dataset import assemble
from sweep.evaluate import evaluate
from sweep.plan import make_plan
from sweep.plot import points_of
from sweep.space import count_designs, designs, extremes, make_point

ROOT = Path(__file__).parents[2]
KINDS = {
    "bnes": {},
    "tmd": {"kind": "tmd", "k": 50.0, "c": 1.0},
    "locked": {"kind": "locked"},
}
DEVICES = {  # a kind with fields of its own, a place, and how many there are
    "kind": {"field": "devices[0]", "choices": KINDS},
    "EA": {"field": "devices[0].EA", "log": [1e4, 1e8]},
    "k": {"field": "devices[0].k", "linear": [10, 100]},
    "s": {"field": "devices[0].s", "linear": [1, 5]},
    "count": {"field": "devices.count", "integer": [1, 2]},
}


def chosen(variables=DEVICES, tied=None, **changes):
    return study(variables=variables, tied=tied or {}, **changes)


def point(values, variables=DEVICES, **changes):
    return make_point(parse_study(chosen(variables, **changes)), 0, 0, values)


BASE = {"kind": "bnes", "EA": 1e5, "k": 20.0, "s": 2.0, "count": 2}


def test_a_choice_is_laid_over_what_stands_there():
    first = point(BASE).scene.devices[0]
    assert (type(first), first.s, first.EA, first.mass) == (BNES, 2.0, 1e5, 2.0)
    first = point(BASE | {"kind": "tmd"}).scene.devices[0]
    assert (type(first), first.s, first.k, first.c, first.mass) == (TMD, 2.0, 20.0, 1.0, 2.0)
    first = point(BASE | {"kind": "locked"}).scene.devices[0]
    assert (type(first), first.kind, first.s) == (PointMass, "locked", 2.0)


def test_fields_that_a_choice_does_not_have_are_idle_and_make_no_other_key():
    tuned = point(BASE | {"kind": "tmd"})
    assert tuned.key == point(BASE | {"kind": "tmd", "EA": 1e7}).key != point(BASE | {"kind": "tmd", "k": 30.0}).key
    assert point(BASE).key == point(BASE | {"k": 30.0}).key != point(BASE | {"EA": 1e7}).key


def test_the_number_of_devices_keeps_the_first():
    assert [d.kind for d in point(BASE).scene.devices] == ["bnes", "tmd"]
    assert [d.kind for d in point(BASE | {"count": 1}).scene.devices] == ["bnes"]


def test_a_device_can_be_left_out():
    second = {"field": "devices[1]", "choices": {"tmd": {}, "none": None}}
    variables = {"second": second, "k": {"field": "devices[1].k", "linear": [1, 9]}}
    assert len(point({"second": "tmd", "k": 2.0}, variables).scene.devices) == 2
    assert len(point({"second": "none", "k": 2.0}, variables).scene.devices) == 1


def test_numbers_stand_for_choices_in_designs():
    variables = {"law": {"field": "devices[0].law", "choices": ["cords", "springs"]}}
    one_way = point({"law": 1.0}, variables)
    assert one_way.scene.devices[0].law == "springs"
    assert one_way.key == point({"law": "springs"}, variables).key


@pytest.mark.parametrize("kind", ["sobol", "random", "lhs"])
def test_samplers_take_every_whole_number_and_choice(kind):
    found = designs(parse_study(chosen(sampler={"kind": kind, "n": 60, "seed": 1})))
    assert {values["count"] for values in found} == {1.0, 2.0}
    assert {values["kind"] for values in found} == {0.0, 1.0, 2.0}


def test_a_grid_has_them_all_or_as_many_as_asked_for():
    law = {"field": "devices[0].law", "choices": ["cords", "springs"]}
    variables = {"segments": {"field": "ask.segments", "integer": [10, 20]}, "law": law}
    whole = parse_study(chosen(variables, sampler={"kind": "grid"}))
    assert count_designs(whole) == len(designs(whole)) == 22
    some = parse_study(chosen(variables, sampler={"kind": "grid", "levels": {"segments": 3}}))
    assert sorted({values["segments"] for values in designs(some)}) == [10, 15, 20]
    assert count_designs(some) == 6
    assert make_point(some, 0, 0, designs(some)[0]).ask.segments == 10


def test_words_and_whole_numbers_are_coordinates(tmp_path):
    made = parse_study(chosen(sampler={"kind": "sobol", "n": 8, "seed": 1}))
    plan = make_plan(made)
    rows = {p.key: planned(p) for p in plan.points(made)}
    dataset = assemble(made, plan, rows)
    assert set(dataset["kind"].values) <= set(KINDS)
    assert [list(KINDS).index(name) for name in dataset["kind"].values] == list(plan.designs.column("kind"))
    assert set(dataset["count"].values) == {1, 2}
    dataset.to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc") as again:
        assert list(again["kind"].values) == list(dataset["kind"].values)
    table = report.front_table(dataset, ["delta", "gamma"], [0], [False], 0, Console())
    assert str(dataset["kind"].values[0]) in table
    drawn = points_of(dataset).variables["kind"]
    assert drawn.dtype.kind == "f"
    assert "0 " in str(drawn.name)


def test_the_example_of_the_readme_is_a_study():
    text = (ROOT / "README.md").read_text().partition("```yaml\nvariables")[2]
    raw = yaml.safe_load("variables" + text.partition("```")[0])
    base = yaml.safe_load((ROOT / "configs/bnes_optimise.yaml").read_text())
    base |= {"tied": {}, "objectives": ["delta", "gamma"]} | raw
    made = parse_study(base, ROOT / "configs")
    designs = [{"EA": 1e6, "at": 3.0, "count": 2, "kind": i} for i in range(4)]
    kinds = [make_point(made, 0, 0, values).scene.devices[0].kind for values in designs]
    assert kinds == ["bnes", "tmd", "locked", "bnes"]  # without the first device the second is the first


# --------------------------------------------------------------------------- what cannot be


def test_devices_that_meet_are_a_row_that_says_so():
    variables = {"a": {"field": "devices[0].s", "linear": [1, 9]}, "b": {"field": "devices[1].s", "linear": [1, 9]}}
    made = parse_study(chosen(variables))
    met = make_point(made, 0, 0, {"a": 4.0, "b": 4.0})
    assert "same place" in met.problem
    assert met.key != make_point(made, 0, 0, {"a": 5.0, "b": 5.0}).key
    row = evaluate(met)
    assert (row.status, "same place" in row.message, row.trusted) == ("IMPOSSIBLE", True, False)
    assert all(np.isnan(value) for value in row.metrics.values())
    assert set(extremes(made)) == {"first"}  # least and greatest put both at the same place


def test_all_mistakes_in_choices_and_constraints_are_listed():
    raw = chosen(
        variables={
            "a": {"field": "cable[0].compression", "choices": [True, "perhaps"]},
            "b": {"field": "devices[0]", "choices": {"tmd": {"kind": "tmd", "k": -1}}},
            "c": {"field": "devices[1].k", "integer": [3, 2]},
            "d": {"field": "devices[1].c", "choices": [{"c": 1}]},
            "e": {"field": "devices.count", "integer": [1, 2], "log": [1, 2]},
        },
        constraints={"stroke": {}, "strok": {"max": 1}, "delta": {"min": 2, "max": 1}, "gamma_ensemble": {"min": 0}},
        optimise={"algorithm": "nsga4", "reference": {"delta": 1}},
    )
    found = mistakes(raw)
    expected = {
        "variables.a.choices[1]", "variables.b.choices.tmd", "variables.c.integer", "variables.d", "variables.e",
        "constraints.stroke", "constraints.strok", "constraints.delta", "constraints.gamma_ensemble",
        "optimise.algorithm",
    }  # fmt: skip
    assert {path for path in expected if not any(p.startswith(path) for p in found)} == set(), found


def test_fields_of_a_choice_are_tried_with_it():
    """k of the tuned mass is idle in the middle of the study, and is found wrong all the same."""
    variables = dict(DEVICES, k={"field": "devices[0].k", "linear": [-5, 100]})
    assert "k" in one(chosen(variables), "variables.k.linear[0]")
    assert "no field" in one(chosen(dict(DEVICES, k={"field": "devices[0].kk", "linear": [1, 2]})), "variables.k.field")


def test_there_are_no_more_devices_than_the_scene_has():
    for wrong in ({"integer": [1, 3]}, {"linear": [0.5, 1.5]}, {"choices": ["one", "two"]}):
        variables = {"n": {"field": "devices.count", **wrong}}
        assert "0 to 2" in one(chosen(variables), "variables.n.field")


def test_words_are_no_numbers():
    said = one(chosen(tied={"devices[1].c": "kind / 2"}), "tied.devices[1].c")
    assert "`kind` is no number" in said


def test_an_optimisation_needs_no_sampler_and_its_reference_all_objectives():
    assert parse_study(chosen(sampler=None, optimise={"seed": 3})).sampler is None
    assert "needs a value for gamma" in one(chosen(optimise={"reference": {"delta": 1}}), "optimise.reference")
    assert "sampler" in one(chosen(sampler=None), "sampler")


# --------------------------------------------------------------------------- constraints


def made_up(**columns):
    count = len(next(iter(columns.values())))
    data = {name: ("point", np.array(values, float)) for name, values in columns.items()}
    return xr.Dataset(data | {"status": ("point", np.array(["OK"] * count, dtype=object))})


def bounded(dataset, **bounds):
    full = {name: {"min": None, "max": None} | bound for name, bound in bounds.items()}
    return dataset.assign_attrs(constraints=json.dumps(full), objectives='["delta", "gamma"]')


def test_a_point_that_breaks_a_constraint_is_on_no_front():
    free = made_up(delta=[0.1, 0.2, 0.3, 0.4], gamma=[0.1, 0.2, 0.3, 0.2], stroke=[0.5, 0.3, 0.2, np.nan])
    assert list(pareto.front(free, ["delta", "gamma"])) == [0, 1, 2]
    dataset = bounded(free, stroke={"max": 0.3})
    assert list(pareto.front(dataset, ["delta", "gamma"])) == [1, 2]
    assert list(pareto.allowed(dataset)) == [False, True, True, False]  # without a number nobody knows
    assert report.broken_constraints(dataset) == "left out: 2 trusted points that break stroke <= 0.3 (2)"
    assert list(pareto.front(bounded(free, stroke={"min": 0.25}), ["delta", "gamma"])) == [0, 1]
    assert list(pareto.front(bounded(free, nothing={"min": 0}), ["delta", "gamma"])) == []


def test_the_worst_environment_keeps_the_constraint():
    values = {"stroke": [[0.1, 0.4], [0.2, 0.3]], "delta": [[1, 1], [1, 1]], "gamma": [[1, 1], [1, 1]]}
    dims = ("design", "environment")
    dataset = xr.Dataset({name: (dims, np.array(v, float)) for name, v in values.items()})
    dataset["status"] = (dims, np.full((2, 2), "OK", dtype=object))
    assert list(pareto.allowed(bounded(dataset, stroke={"max": 0.3}))) == [False, True]


def test_quantities_of_a_design_are_constraints_too():
    made = parse_study(chosen(sampler={"kind": "sobol", "n": 8, "seed": 1}, constraints={"device_mass": {"max": 3}}))
    plan = make_plan(made)
    rows = {p.key: planned(p) for p in plan.points(made)}
    dataset = assemble(made, plan, rows)
    assert dataset["device_mass"].attrs["units"] == "kg"
    assert list(pareto.allowed(dataset)) == list(dataset["count"].values == 1)
