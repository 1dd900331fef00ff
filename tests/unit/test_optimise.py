"""The search for a front: on problems with known fronts, with failures, constraints, kills and other versions."""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import fakes
import numpy as np
import pytest
import xarray as xr
import yaml
from pymoo.problems import get_problem
from pymoo.util.ref_dirs import get_reference_directions
from typer.testing import CliRunner

from sweep import cli, distribute, open_study, optimise, pareto, run, store
from sweep.child import guarded, locate, numbered
from sweep.config import parse_study
from sweep.optimise import CURVE, Evolution, Surrogate, progress_of, volume
from sweep.plan import read_plan
from sweep.sensitivity import sensitivity_of
from sweep.space import made
from sweep.store import OtherVersion, StoreError, read_records
from sweep.supervise import CannotRun

HERE = Path(__file__).parent
COST = ["seconds", "first_seconds"]
STUDY = yaml.safe_load((HERE / "known.yaml").read_text())
IDEAL = 1.1**2 - 1 / 3  # under 1 - sqrt(x) lies 1/3


def study(**changes):
    raw = json.loads(json.dumps(STUDY))
    raw["optimise"] |= changes.pop("optimise", {})
    return parse_study(raw | changes)


class InProcess:
    """Stands for a crew: the same store, without a child."""

    def __init__(self, job, ranks, report=None, beat=None):
        self.job = job

    def __enter__(self):
        self.store = self.job.store(0)
        self.store.open()
        return self

    def map(self, orders):
        evaluator = locate(self.job.evaluator)
        found = []
        for order in orders:
            found.append(numbered(guarded(evaluator, made(self.job.study, order)), self.job.study.objectives))
            self.store.append(found[-1])
        return found, ""

    def __exit__(self, *error):
        self.store.close()


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(distribute, "Crew", InProcess)
    monkeypatch.setattr(run, "_git_state", lambda: {})
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def search(study, out, evaluator="known_front", evaluations=None, **settings):
    chosen = run.Settings(directory=out, evaluator=f"{fakes.HERE}:{evaluator}", warm_ups=(), **settings)
    return optimise.optimise(study, chosen, evaluations)


def curve(out):
    with xr.open_dataset(out / CURVE) as data:
        return data.load()


def results(out):
    return open_study(out).drop_vars(COST)


# --------------------------------------------------------------------------- known fronts


@pytest.mark.parametrize(
    ("algorithm", "evaluations", "share"),
    # shares of the ideal volume that were reached were 0.84, 0.84 and 0.99; a random search gets 0.5 with 112 designs
    [("nsga2", 112, 0.7), ("nsga3", 112, 0.7), ("gp", 48, 0.95)],
)
def test_a_known_front_is_found(quick, tmp_path, algorithm, evaluations, share):
    made_study = study(optimise={"algorithm": algorithm, "evaluations": evaluations})
    ended = search(made_study, tmp_path)
    data = curve(tmp_path)
    volumes = data["hypervolume"].values
    assert np.all(np.diff(volumes) >= 0)
    assert share * IDEAL < volumes[-1] < IDEAL
    assert data["evaluations"].values[-1] == evaluations == ended.planned
    dataset = results(tmp_path)
    assert dataset.sizes["point"] == len(set(dataset["key"].values)) == evaluations
    front = pareto.front(dataset, made_study.objectives)
    costs = pareto.costs(dataset, made_study.objectives)
    assert volume(costs[front], np.array([1.1, 1.1])) == pytest.approx(volumes[-1], rel=1e-12)  # the same points
    assert len(front) == data["front"].values[-1]
    assert progress_of(tmp_path).ended == "the budget is spent"


@pytest.mark.parametrize("name", ["zdt1", "dtlz2"])
def test_hypervolumes_of_problems_of_pymoo(name):
    """zdt1: 1.1^2 - 1/3; the octant of dtlz2's sphere leaves 1.1^3 - pi/6. Finite fronts fall a little short."""
    if name == "zdt1":
        front, exact, points = get_problem("zdt1").pareto_front(n_pareto_points=20_000), IDEAL, 1e-3
    else:
        front = get_problem("dtlz2").pareto_front(get_reference_directions("das-dennis", 3, n_partitions=60))
        exact, points = 1.1**3 - np.pi / 6, 2e-2
    found = volume(front, np.full(front.shape[1], 1.1))
    assert exact * (1 - points) < found < exact


def test_points_beyond_the_reference_count_nothing():
    assert volume(np.array([[2.0, 0.0]]), np.ones(2)) == 0 == volume(np.zeros((0, 2)), np.ones(2))
    assert volume(np.array([[0.5, 0.5], [2.0, 0.0], [0.0, 5.0]]), np.ones(2)) == pytest.approx(0.25)


def test_a_reference_that_is_not_given_is_that_of_the_first_generation(quick, tmp_path):
    made_study = study(optimise={"reference": {}, "evaluations": 32})
    search(made_study, tmp_path)
    first = pareto.costs(results(tmp_path), made_study.objectives)[:16]
    reference = json.loads(curve(tmp_path).attrs["reference"])
    expected = first.max(axis=0) + 0.1 * np.ptp(first, axis=0)
    assert [reference["delta"], reference["rms"]] == pytest.approx(expected)
    search(made_study, tmp_path, evaluations=64)
    assert json.loads(curve(tmp_path).attrs["reference"]) == reference


# --------------------------------------------------------------------------- failures, constraints


@pytest.mark.parametrize("algorithm", ["nsga2", "nsga3", "gp"])
def test_rows_that_are_not_trusted_reach_neither_the_algorithm_nor_the_front(quick, tmp_path, monkeypatch, algorithm):
    """Designs that fail, are untrusted with marvellous objectives, or give NaN; a third of all."""
    told = []
    kind = Surrogate if algorithm == "gp" else Evolution
    before = kind.tell

    def spy(self, good, costs, excess):
        told.append((good.copy(), costs.copy(), excess.copy()))
        before(self, good, costs, excess)
        if algorithm != "gp" and self.algorithm.is_initialized:
            values = self.algorithm.pop.get("F").astype(float)
            assert np.isfinite(values).all()
            assert values.min() >= 0

    monkeypatch.setattr(kind, "tell", spy)
    monkeypatch.setenv("FAKE_BAD", "7")
    evaluations = 30 if algorithm == "gp" else 64
    made_study = study(optimise={"algorithm": algorithm, "evaluations": evaluations})
    ended = search(made_study, tmp_path)
    assert ended.exit_code == 1
    dataset = results(tmp_path)
    bad = (dataset["status"].values != "OK") | ~np.isfinite(dataset["delta"].values)
    assert 0.1 < bad.mean() < 0.6
    assert bad.sum() > np.count_nonzero(dataset["status"].values == "DIVERGED") > 0
    assert not bad[pareto.front(dataset, made_study.objectives)].any()
    good = np.concatenate([answer[0] for answer in told])
    assert list(good) == list(~bad[: len(good)])
    assert curve(tmp_path)["untrusted"].values.sum() == np.count_nonzero(dataset["status"].values != "OK")


def test_a_first_generation_of_failures_is_drawn_again(quick, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_BAD", "1")  # x in [0.25, 0.5] diverges
    raw = {"x": {"field": "devices[0].drag", "linear": [0.26, 0.52]}, "y": STUDY["variables"]["y"]}
    made_study = study(variables=raw, optimise={"population": 4, "evaluations": 40})
    search(made_study, tmp_path)
    dataset = results(tmp_path)
    assert dataset.sizes["point"] == 40
    assert (dataset["status"].values == "DIVERGED").any()
    assert len(pareto.front(dataset, made_study.objectives))


def test_constraints_on_metrics(quick, tmp_path):
    """stroke = x + y must be at least 0.6: the front is x + y = 0.6 and then y = 0."""
    made_study = study(constraints={"stroke": {"min": 0.6}})
    search(made_study, tmp_path)
    dataset = results(tmp_path)
    assert (dataset["stroke"].values < 0.6).any()  # they were run, and told with the amount
    front = pareto.front(dataset, made_study.objectives)
    assert len(front) > 3
    assert (dataset["stroke"].values[front] >= 0.6).all()
    last = dataset["stroke"].values[-16:]
    assert np.mean(last >= 0.6) > 0.6  # the search has learnt it: 0.58 of the square, and its better half, break it
    assert curve(tmp_path)["left_out"].values.sum() == np.count_nonzero(dataset["stroke"].values < 0.6)


def test_a_constraint_holds_in_every_environment(quick, tmp_path):
    """stroke is x + y on the clean cable, 0.2 less on the fouled one, at least 0.6 on both: the front is at 0.8."""
    cables = [{"name": "clean"}, {"name": "fouled", "set": {"cable[0].mass": 5.0}}]
    made_study = study(
        environments=cables, objectives=["delta_worst", "rms"], constraints={"stroke": {"min": 0.6}},
        optimise={"reference": {"delta_worst": 1.1, "rms": 1.1}},
    )  # fmt: skip
    search(made_study, tmp_path)
    dataset = results(tmp_path)
    assert dict(dataset.sizes) == {"design": 112, "environment": 2}
    sums = dataset["x"].values + dataset["y"].values
    assert dataset["stroke"].values == pytest.approx(np.column_stack([sums, sums - 0.2]))
    front = pareto.front(dataset, made_study.objectives)
    assert len(front) > 3
    assert (sums[front] >= 0.8 - 1e-12).all()
    assert ((sums >= 0.6) & (sums < 0.8)).any()  # these keep the bound on the clean cable alone, and are left out
    assert curve(tmp_path)["left_out"].values.sum() == np.count_nonzero(dataset["stroke"].values.min(axis=1) < 0.6)
    assert np.mean(sums[-16:] >= 0.8) > 0.4  # the search has learnt it: 0.68 of the square break it


def test_a_search_for_means_over_repetitions_lives_through_a_generation_without_any(quick, tmp_path, monkeypatch):
    """Rows that fail have no `delta_ensemble`: no column would be left where all of a generation do."""
    monkeypatch.setenv("FAKE_BAD", "1")  # x in [0.25, 0.5] diverges
    raw = {"x": {"field": "devices[0].drag", "linear": [0.26, 0.49]}, "y": STUDY["variables"]["y"]}
    names = ["delta_ensemble", "rms_ensemble"]
    section = {"population": 4, "evaluations": 12, "reference": {}}
    made_study = study(variables=raw, objectives=names, repeats={"n": 2}, optimise=section)
    search(made_study, tmp_path)
    dataset = results(tmp_path)
    assert set(dataset["status"].values) == {"DIVERGED"}
    assert not len(pareto.front(dataset, names))
    assert np.isnan(curve(tmp_path)["hypervolume"].values).all()
    said = CliRunner().invoke(cli.app, ["pareto", str(tmp_path)])
    assert said.exit_code == 0, said.output
    assert "no trusted points" in said.output
    (tmp_path / "results.nc").unlink()  # from the journals, as while it runs
    assert CliRunner().invoke(cli.app, ["pareto", str(tmp_path)]).exit_code == 0


def test_a_search_has_no_sensitivity_indices(quick, tmp_path):
    """Its study may have a sampler as well, whose designs are not those of the folder."""
    search(study(sampler={"kind": "random", "n": 100}), tmp_path, evaluations=20)
    with pytest.raises(ValueError, match="holds a search, which chooses its designs"):
        sensitivity_of(tmp_path)
    said = CliRunner().invoke(cli.app, ["sensitivity", str(tmp_path)])
    assert isinstance(said.exception, StoreError)  # which the command's entry tells in a sentence


PARTS = {
    "kind": {
        "field": "devices[0]",
        "choices": {"bnes": {}, "tmd": {"kind": "tmd", "k": 50.0}, "locked": {"kind": "locked"}},
    },
    "EA": {"field": "devices[0].EA", "values": [1e4, 1e5]},
    "count": {"field": "devices.count", "integer": [1, 2]},
    "mass": {"field": "devices[0].mass", "integer": [1, 4]},
}


@pytest.mark.parametrize("algorithm", ["nsga2", "nsga3", "gp"])
def test_a_space_of_parts_is_searched_to_its_end_and_each_physics_run_once(quick, tmp_path, algorithm):
    """48 combinations, of which 32 differ: EA is idle but for bnes. The front is that of all of them."""
    made_study = study(variables=PARTS, optimise={"algorithm": algorithm, "population": 8, "evaluations": 500})
    search(made_study, tmp_path, "parts")
    dataset = results(tmp_path)
    assert dataset.sizes["point"] == 32
    assert progress_of(tmp_path).ended == "no new design is left"
    assert len(read_records(tmp_path)) == len(set(dataset["key"].values)) == 32
    front = pareto.front(dataset, made_study.objectives)
    found = {(str(dataset["kind"].values[i]), dataset["count"].values[i], dataset["mass"].values[i]) for i in front}
    every = itertools.product(("bnes", "tmd", "locked"), (1, 2), (1, 2, 3, 4))
    costs = {design: fakes.parts_costs(*design) for design in every}
    best = {a for a, c in costs.items() if not any(d[0] <= c[0] and d[1] <= c[1] and d != c for d in costs.values())}
    assert found == best


def test_bounds_on_a_design_cost_no_run(quick, tmp_path):
    made_study = study(
        variables=PARTS, constraints={"device_mass": {"max": 3}}, optimise={"population": 8, "evaluations": 500}
    )
    search(made_study, tmp_path, "parts")
    dataset = results(tmp_path)
    assert dataset["device_mass"].values.max() <= 3
    assert dataset.sizes["point"] == 4 * (3 + 2)  # bnes twice for its EA; 1 to 3 kg alone, 1 to 2 kg with the second


def test_devices_that_meet_are_never_run(quick, tmp_path):
    places = {name: {"field": f"devices[{i}].s", "integer": [1, 3]} for i, name in enumerate("xy")}
    search(study(variables=places, optimise={"population": 4}), tmp_path)
    dataset = results(tmp_path)
    assert dataset.sizes["point"] == 6
    assert (dataset["x"].values != dataset["y"].values).all()


# --------------------------------------------------------------------------- resume


@pytest.mark.parametrize("algorithm", ["nsga2", "nsga3", "gp"])
def test_more_evaluations_go_on_as_if_they_had_been_asked_for_at_once(quick, tmp_path, monkeypatch, algorithm):
    monkeypatch.setenv("FAKE_BAD", "7")
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    last = 45 if algorithm == "gp" else 70
    made_study = study(optimise={"algorithm": algorithm, "evaluations": last})
    search(made_study, whole)
    for evaluations in (5, 21, 40, last):  # cuts within generations
        search(made_study, parts, evaluations=evaluations)
        assert open_study(parts).sizes["point"] == evaluations
    assert len(read_records(parts)) == last
    xr.testing.assert_identical(results(parts), results(whole))
    assert curve(parts)["hypervolume"].values[-1] == curve(whole)["hypervolume"].values[-1]


def test_a_longer_budget_in_the_study_is_the_same_search(quick, tmp_path):
    search(study(optimise={"evaluations": 20}), tmp_path / "a")
    search(study(optimise={"evaluations": 40}), tmp_path / "a")
    search(study(optimise={"evaluations": 40}), tmp_path / "b")
    xr.testing.assert_identical(*(results(tmp_path / name).drop_attrs() for name in "ab"))  # headers name both texts
    assert len(read_records(tmp_path / "a")) == 40


def _study_file(place, **section):
    path = place / "known.yaml"
    path.write_text(yaml.safe_dump(STUDY | {"optimise": STUDY["optimise"] | section}))
    return path


def command(path, out, *launcher):
    mpi = ["-m", "mpi4py"] if launcher else []
    return [*launcher, sys.executable, *mpi, "-m", "fake_sweep", "optimise", str(path), "--out", str(out)]


def environment(seconds="0"):
    path = f"{HERE}:{HERE.parents[1]}"
    return os.environ | {
        "PYTHONPATH": path, "FAKE_EVALUATOR": "known_front", "FAKE_SECONDS": seconds, "FAKE_BAD": "7"
    }  # fmt: skip


def test_killed_and_resumed_it_finds_the_same_front(quick, tmp_path, monkeypatch):
    """SIGKILL of the real command, twice, in the middle of generations; then undisturbed to the end."""
    path = _study_file(tmp_path, evaluations=64)
    out = tmp_path / "killed"
    for rows in (6, 30):
        process = subprocess.Popen(command(path, out), env=environment("0.05"), stderr=subprocess.DEVNULL)
        while len(read_records(out)) < rows:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
    killed = len(read_records(out))
    assert 30 <= killed < 64
    assert not progress_of(out).ended
    ended = subprocess.run(command(path, out), env=environment(), capture_output=True, text=True, check=False)
    assert ended.returncode == 1, ended.stderr  # some designs failed, as they should
    assert "64 of 64 evaluations by nsga2: the budget is spent" in ended.stdout
    monkeypatch.setenv("FAKE_BAD", "7")
    search(study(optimise={"evaluations": 64}), tmp_path / "undisturbed")
    assert len(read_records(out)) == 64  # none twice
    left, right = results(out), results(tmp_path / "undisturbed")
    xr.testing.assert_identical(left.drop_attrs(), right.drop_attrs())
    xr.testing.assert_identical(curve(out), curve(tmp_path / "undisturbed"))
    said = CliRunner().invoke(cli.app, ["pareto", str(out)])
    assert said.exit_code == 0, said.output
    assert CliRunner().invoke(cli.app, ["plot", str(out), "hypervolume"]).exit_code == 0
    assert (out / "figures" / "hypervolume.png").is_file()
    status = CliRunner().invoke(cli.app, ["status", str(out), "--missing"])
    assert status.exit_code == 0, status.output
    assert "the budget is spent" in status.output


def test_a_search_that_is_not_over_is_missing_something(quick, tmp_path, monkeypatch):
    search(study(), tmp_path, evaluations=20)
    known = json.loads((tmp_path / store.SEARCH).read_text())
    (tmp_path / store.SEARCH).write_text(json.dumps(known | {"ended": "", "evaluations": 40}))
    status = CliRunner().invoke(cli.app, ["status", str(tmp_path), "--missing"])
    assert (status.exit_code, "20 points to go" in status.output) == (3, True), status.output


# --------------------------------------------------------------------------- what is refused


def test_another_version_of_pymoo_is_refused_unless_told(quick, tmp_path):
    search(study(), tmp_path, evaluations=20)
    known = json.loads((tmp_path / store.SEARCH).read_text())
    known["versions"]["pymoo"] = "0.5.0"
    (tmp_path / store.SEARCH).write_text(json.dumps(known))
    with pytest.raises(OtherVersion, match=r"pymoo 0\.5\.0.*--force-version"):
        search(study(), tmp_path, evaluations=30)
    search(study(), tmp_path, evaluations=30, any_version=True)
    known = json.loads((tmp_path / store.SEARCH).read_text())
    assert known["versions"]["pymoo"] == importlib.metadata.version("pymoo")


def test_designs_that_are_not_those_of_the_store_are_refused(quick, tmp_path, monkeypatch):
    search(study(), tmp_path, evaluations=20)
    before = optimise.Gate.draw
    monkeypatch.setattr(optimise.Gate, "draw", lambda self, n, *rest: before(self, n, np.random.default_rng(99)))
    with pytest.raises(OtherVersion, match="other designs"):
        search(study(), tmp_path, evaluations=30)


def test_another_seed_starts_anew_and_keeps_the_rows(quick, tmp_path):
    search(study(), tmp_path, evaluations=20)
    search(study(optimise={"seed": 7}), tmp_path, evaluations=20)
    assert len(read_records(tmp_path)) == 40
    assert len(read_plan(tmp_path / "plan.json").designs) == 20


def test_sweeps_and_searches_have_folders_of_their_own(quick, tmp_path):
    search(study(), tmp_path / "a", evaluations=4)
    swept = replace(study(), sampler=parse_study(STUDY | {"sampler": {"kind": "random", "n": 3}}).sampler)
    settings = run.Settings(directory=tmp_path / "a", evaluator=f"{fakes.HERE}:known_front", warm_ups=())
    with pytest.raises(StoreError, match="sweep optimise"):
        run.run(swept, settings)
    store.prepare(swept, tmp_path / "b")
    with pytest.raises(StoreError, match="holds a sweep"):
        search(study(), tmp_path / "b")


def test_without_sklearn_a_sentence_says_what_to_install(quick, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn", None)
    with pytest.raises(CannotRun, match=r"pip install 'cable-sweep\[analysis\]'"):
        search(study(optimise={"algorithm": "gp"}), tmp_path)
