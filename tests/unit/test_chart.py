"""The chart: what it measures against, which runs are worth their seconds, what it refuses; the mesh of a study."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
import yaml
from rich.console import Console

from solvers import METHODS, Ask, Cost, End, Harmonic, Motion, Response, Scene, Section, Status, Window, solve
from solvers.catalogue import SURE, SURER, trials_of
from sweep import chart, peers, report, resolve
from sweep.chart_plot import save_chart
from sweep.config import ConfigError, MetricSettings, parse_study
from sweep.fields import dump

STRING = Scene(
    cable=(Section(length=10.0, d=0.02, mass=1.0, EA=1e5, EI=0.0, BA=50.0, wet_weight=0.0),),
    end_a=End(kind="pinned", position=(0, 0, 0)),
    end_b=End(kind="pinned", position=(10.02, 0, 0), motion=Motion(
        harmonics=(Harmonic(amplitude=(0, 0, 0.01), frequency=1.0),), window=Window(ramp_up=1.0, shape="smooth"))),
    g=0.0,
)  # fmt: skip
GIVEN = {10: 0.0595, 80: 9.2e-4}  # errors of meshes of the string, against 80 Hermite elements at a tolerance of 1e-6
CASE = chart.Case(
    name="string", scene=STRING, ask=Ask(duration=2.0, interval=0.02), settings=MetricSettings(baseline="plain")
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    folder = tmp_path_factory.mktemp("chart")
    found = chart.chart(CASE, folder, ["lumped"], 3e-3, 0.2)
    assert {"chart.csv", "chart.nc"} <= {path.name for path in folder.iterdir()}
    with xr.open_dataset(folder / "chart.nc") as stored:
        np.testing.assert_array_equal(stored["error"].values, found["error"].values)
    return found


def test_reference_is_checked(data: xr.Dataset) -> None:
    """A coarser mesh, a looser tolerance and another method, and the largest difference is the uncertainty."""
    assert 0 < float(data.attrs["uncertainty"]) < 5e-3
    for what in ("segments", "ten times the tolerance", "lumped"):
        assert what in data.attrs["reference"]


def test_errors_fall_with_the_mesh_and_the_step(data: xr.Dataset) -> None:
    """Order 2 of lumped masses between 10 and 20 segments at the tightest tolerance, and steps that get better."""
    runs = data.to_dataframe()
    tight = runs[(runs["method"] == "dopri5") & (runs["knob"] == runs[runs["method"] == "dopri5"]["knob"].min())]
    error = dict(zip(tight["segments"], tight["error"], strict=True))
    assert 1.5 < math.log2(error[10] / error[20]) < 2.5
    stepped = runs[(runs["method"] == "genalpha") & (runs["segments"] == 40)].sort_values("knob")
    assert stepped["error"].iloc[-1] > 3 * stepped["error"].iloc[0]


def test_no_trusted_run_errs_in_time_beyond_its_promise(data: xr.Dataset) -> None:
    """`accuracy` is 0.05 here; what the mesh leaves is the error of the tightest run on it."""
    runs = data.to_dataframe()
    mesh = runs[runs["method"] == "dopri5"].groupby("segments")["error"].last()
    good = runs[(runs["status"] == "OK") & runs["segments"].isin(mesh.index)]
    assert len(good) > 10
    assert (good["error"] - mesh.loc[good["segments"]].to_numpy() <= 0.05).all()


def test_envelope() -> None:
    """Only trusted runs of this program that none beats in both; the cheapest for an accuracy lies on it."""
    table = pd.DataFrame({
        "program": ["cable-sweep"] * 4 + ["other"], "status": ["OK", "OK", "ENERGY_OPEN", "OK", "OK"],
        "seconds": [1.0, 2.0, 0.5, 3.0, 0.1], "error": [0.1, 0.2, 1e-3, 0.01, 1e-4],
    })  # fmt: skip
    assert list(chart.envelope(table)) == [True, False, False, True, False]
    found = chart.cheapest_for(table, 0.05)
    assert found is not None
    assert found["seconds"] == 3.0
    assert chart.cheapest_for(table, 1e-3) is None


def test_figure(data: xr.Dataset, tmp_path: Path) -> None:
    assert save_chart(data, tmp_path / "chart.png").stat().st_size > 10_000


def test_a_chart_at_rest(tmp_path: Path) -> None:
    """A hung string: no method marches, no panel over tolerances, and the error falls with order 2."""
    hung = replace(STRING, g=9.81, cable=(replace(STRING.cable[0], length=12.0, wet_weight=None),))
    case = replace(CASE, scene=hung, ask=Ask())
    found = chart.chart(case, tmp_path, ["lumped"], 1e-3, 0.2)
    error = dict(zip(found["segments"].values, found["error"].values, strict=True))
    assert 1.6 < math.log2(error[10] / error[20]) < 2.4  # the reference itself is good to 1e-3, a fifth of the error
    assert not np.isfinite(found["knob"]).any()
    assert save_chart(found, tmp_path / "chart.png").stat().st_size > 10_000


def test_a_chart_without_runs_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing but notes: there is no table to draw."""
    monkeypatch.setattr(chart, "scan", lambda *given: iter(["lumped: no mesh of it was quick enough"]))
    with pytest.raises(ConfigError, match="could be run within"):
        chart.chart(replace(CASE, ask=Ask()), tmp_path, ["lumped"], 1e-3, 0.2)


def test_a_slack_line_at_rest_says_so() -> None:
    """A string without weight between ends that are too close: in balance wherever it lies."""
    loose = replace(STRING, cable=(replace(STRING.cable[0], length=12.0),))
    run = solve(loose, Ask())
    assert "slack at rest" in run.message
    assert run.signals["tension"].max() == 0.0


@pytest.mark.skipif(not peers.installed(), reason="no other program is installed (the bench extra)")
def test_other_programs_run_in_the_same_chart(data: xr.Dataset) -> None:
    """Curves of their own, whose error falls with the mesh, never on our envelope, with no status that says OK."""
    runs = data.to_dataframe()
    able = [name for name in peers.installed() if not peers.unable(STRING, CASE.ask, name)]
    assert set(runs["program"]) == {chart.OURS, *able}
    for name in able:
        theirs = runs[runs["program"] == name]
        assert set(theirs["status"]) == {chart.UNCHECKED}
        assert not theirs["envelope"].any()
        fine = theirs[theirs["segments"] == theirs["segments"].max()]
        assert fine["error"].min() < 0.5 * theirs[theirs["segments"] == theirs["segments"].min()]["error"].min()
    text = report.charted(data, Console())
    assert "times cheaper" in text


def test_a_chaotic_chart_compares_means(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs called chaotic by decree (the bound is set to zero): means of three runs and their standard errors."""
    monkeypatch.setattr(chart.pilot, "CHAOTIC", 0.0)
    monkeypatch.setattr(chart, "ENSEMBLE", 3)
    monkeypatch.setattr(chart, "MESHES", 2)
    case = replace(chart.load_case(Path(__file__).parent / "tiny.yaml", 0.5), objectives=("delta", "stroke"))
    found = chart.chart(case, tmp_path, ["lumped"], 1e-2, 1.0)
    runs = found.to_dataframe()
    assert found.attrs["chaotic"] == 1
    assert set(runs["method"]) <= {"dopri5", "tsit5", "srkn4", "trbdf2", "esdirk4"}  # fixed steps do not land
    assert "not run" in found.attrs["peers"]
    row = runs.iloc[0]
    ask = replace(case.ask, model="lumped", method=row["method"], segments=int(row["segments"]), tolerance=row["knob"])
    means = chart.ensemble(case, ask, None).means["stroke"]
    truth = found.attrs["reference_stroke"]
    assert row["error_stroke"] == pytest.approx(abs(means - truth) / truth)
    assert row["error"] == max(row["error_delta"], row["error_stroke"])
    assert row["standard_error"] >= 0
    assert "means of 3 perturbed runs" in report.charted(found, Console())
    assert save_chart(found, tmp_path / "chart.png").stat().st_size > 10_000


def test_what_a_chart_refuses(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    cable, end = "cable: [{length: 1.0, d: 0.1, mass: 1.0, EA: 1.0e5}]", "end_a: {kind: pinned, position: [0, 0, 0]}"
    scene.write_text(f"{cable}\n{end}\n")
    with pytest.raises(ConfigError, match="end_b"):
        chart.load_case(scene, 1.0)
    scene.write_text(scene.read_text() + "end_b: {kind: pinned, position: [0.9, 0, 0]}\n")
    with pytest.raises(ConfigError, match="--duration"):
        chart.load_case(scene)
    with pytest.raises(ConfigError, match="no such file"):
        chart.load_case(tmp_path / "nothing.yaml", 1.0)
    with pytest.raises(ConfigError, match="sweep models"):
        chart.chart(CASE, tmp_path, ["no_such_line"])


# ------------------------------------------------------------------------------------------ the mesh of a study


def test_the_mesh_of_a_study_is_settled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pilots run once; the file in the folder serves the next call, and another study asks anew."""
    raw = {
        "name": "open", "scene": dump(STRING), "ask": {"duration": 1.0}, "metrics": {"baseline": "plain"},
        "objectives": ["rms"],
    }  # fmt: skip
    open_study = parse_study(raw)
    calls = []

    def found(asked: object) -> dict[str, object]:
        calls.append(asked)
        return {"segments": 33, "model": "lumped", "method": "dopri5", "tolerance": 1e-3, "because": {"first": "x"}}

    monkeypatch.setattr(resolve, "found_by_pilots", found)
    settled, because = resolve.resolve(open_study, tmp_path)
    again, _ = resolve.resolve(open_study, tmp_path)
    assert (settled.ask.segments, settled.ask.tolerance, because) == (33, 1e-3, {"first": "x"})
    assert again == settled
    assert len(calls) == 1
    assert json.loads((tmp_path / resolve.FILE).read_text())["ask"]["segments"] == 33
    assert parse_study(yaml.safe_load(settled.text)).ask == settled.ask
    assert resolve.resolve(settled, tmp_path) == (settled, {})


def test_points_of_a_study_are_checked_by_a_coarser_run_alone() -> None:
    """Pilots loosen the tolerance for the accuracy asked and have seen that no finer one sees more."""
    raw = {
        "name": "open", "scene": dump(STRING), "ask": {"duration": 1.0, "accuracy": 0.01, "model": "lumped"},
        "metrics": {"baseline": "plain"}, "objectives": ["rms"],
    }  # fmt: skip
    ask = resolve.resolve(parse_study(raw))[0].ask
    assert ask.tolerance == ask.checked_tolerance > METHODS[ask.method].tolerance
    assert [share for _, share in trials_of(ask, ask.method, 0)] == [1.0, SURE]
    assert [share for _, share in trials_of(replace(ask, checked_tolerance=None), ask.method, 0)] == [SURER, SURE]
    run = solve(STRING, ask)
    assert run.trusted
    assert 0.0 < run.cost.checking
    assert run.estimated_error < ask.accuracy


def test_a_tolerance_that_pilots_found_too_loose_goes_on_being_checked() -> None:
    raw = {
        "name": "open", "scene": dump(STRING), "metrics": {"baseline": "plain"}, "objectives": ["rms"],
        "ask": {"duration": 4.0, "method": "trbdf2", "tolerance": 1e-2, "accuracy": 0.01},
    }  # fmt: skip
    ask = resolve.resolve(parse_study(raw))[0].ask
    assert ask.tolerance == 1e-2
    assert ask.checked_tolerance is None
    assert not solve(STRING, ask).trusted


def test_a_straight_line_at_rest_needs_no_fine_mesh() -> None:
    run = solve(replace(STRING, end_b=replace(STRING.end_b, motion=None)), Ask())
    assert run.trusted, run.message
    assert run.segments < 100


def test_extremes_that_want_different_methods_get_that_of_the_dearest(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = {
        "name": "open", "scene": dump(STRING), "ask": {"duration": 1.0}, "metrics": {"baseline": "plain"},
        "objectives": ["rms"], "variables": {"mass": {"field": "cable[0].mass", "linear": [1.0, 2.0]}},
        "sampler": {"kind": "sobol", "n": 2, "seed": 0},
    }  # fmt: skip
    asked = []

    def made(scene: Scene, ask: Ask) -> Response:
        heavy = scene.cable[0].mass > 1.5
        method = ask.method if ask.method != "auto" else "trbdf2" if heavy else "esdirk4"
        asked.append(ask.method)
        cost = Cost(evaluations=200 if heavy else 100)
        return Response(
            status=Status.OK, model="lumped", method=method, segments=40 if heavy else 30, tolerance=1e-4, cost=cost
        )

    monkeypatch.setattr(resolve, "solve", made)
    found = resolve.found_by_pilots(parse_study(raw))
    assert (found["method"], found["segments"], found["checked_tolerance"]) == ("trbdf2", 40, 1e-4)
    assert set(asked) == {"auto", "trbdf2"}


@pytest.mark.parametrize(("segments", "said"), [(10, True), (80, False)])
def test_check_says_where_a_given_mesh_is_too_coarse(segments: int, said: bool) -> None:
    """A string of ten segments has ten nodes in its shortest wave and is 5.6 % off: no guard sees that."""
    raw = {
        "name": "given", "scene": dump(STRING), "metrics": {"baseline": "plain"}, "objectives": ["rms"],
        "ask": {"duration": 2.0, "segments": segments, "interval": 0.02},
    }  # fmt: skip
    study = parse_study(raw)
    run = solve(study.scene, study.ask)
    error = resolve.mesh_error(study, run)
    assert error is not None
    assert error == pytest.approx(GIVEN[segments], rel=0.1)  # order 2 to a few percent: 0.0589 and 9.2e-4
    assert bool(resolve.about_mesh(study, run)) == said
    assert resolve.mesh_error(parse_study(raw | {"ask": {"duration": 2.0}}), run) is None
