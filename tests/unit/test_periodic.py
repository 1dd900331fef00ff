"""Periodic responses made ready for figures: harmonics, loops and curves, of scenes with a handful of nodes."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
import yaml

import sweep  # noqa: F401  (fills the table of metrics)
from solvers import Ask, Status, solve
from sweep.config import parse_study
from sweep.plan import make_plan
from sweep.report import one_point
from sweep.run import Settings, run
from sweep.series import loop, loop_of, orders, responses
from sweep.space import make_point
from sweep.store import StoreError, open_study

RAW = yaml.safe_load("""
name: shaken
scene:
  cable: [{length: 20, d: 0.1, mass: 12, EA: 1e6, Cdn: 1.2, BA: 2e3}]
  end_a: {kind: pinned, position: [0, 0, -20]}
  end_b:
    kind: pinned
    position: [14, 0, -8]
    motion: {harmonics: [{amplitude: [0.05, 0, 0], frequency: 0.25}], window: {ramp_up: 4}}
  water: {density: 1025}
variables:
  frequency: {field: "end_b.motion.harmonics[0].frequency", linear: [0.2, 0.3]}
  amplitude: {field: "end_b.motion.harmonics[0].amplitude[0]", values: [0.05, 0.2]}
sampler: {kind: grid, n: 2}
ask: {duration: 40, segments: 16, interval: 0.05, output_from: 20, method: harmonic}
metrics: {window: [20, 40], baseline: plain}
objectives: [peak_tension_top]
""")


def study(**ask):
    raw = copy.deepcopy(RAW)
    raw["ask"] |= ask
    return parse_study(raw)


def waves(T=0.7, interval=0.05, wild=0.0):
    """A signal with three harmonics on a grid that does not divide its period."""
    t = np.arange(100, 301) * interval
    phase = 2 * np.pi * t / T
    x = 3.0 + 2.0 * np.cos(phase - 1.0) + 0.1 * np.sin(3 * phase) + wild * np.sin(0.37 * phase)
    data = {
        "displacement": (("time", "node"), np.outer(x, [1.0, 1.0])),
        "tension": ("time", 10 * x),
        "arc": ("node", [0.0, 1.0]),
    }
    about = {"period": T, "harmonics": 5, "method": "harmonic", "ramped": 0.0}
    return xr.Dataset(data, coords={"time": ("time", t)}, attrs=about)


def test_harmonics_are_exact_on_any_grid():
    found = orders(waves())
    assert found["displacement"].values == pytest.approx([2.0, 0, 0.1, 0, 0], abs=1e-12)
    assert found["tension"].values == pytest.approx([20.0, 0, 1.0, 0, 0], abs=1e-10)
    assert found["tension"].attrs["mean"] == pytest.approx(30.0)
    assert found["tension"].attrs["rest"] < 1e-12
    assert found.attrs["periods"] == 14  # ten seconds


def test_what_is_not_periodic_is_said():
    assert 0.05 < orders(waves(wild=0.3))["displacement"].attrs["rest"] < 0.3


@pytest.mark.parametrize(("about", "match"), [({"period": np.nan}, "no period"), ({"period": 30.0}, "no whole period"),
                                              ({"ramped": 14.9}, "no whole period")])  # fmt: skip
def test_no_harmonics_is_a_sentence(about, match):
    with pytest.raises(ValueError, match=match):
        orders(waves().assign_attrs(about))


def test_a_loop_of_both_methods():
    """Harmonic balance and the settled march are the same loop, whatever the study's own method and grid."""
    point = make_point(study(method="explicit", interval=0.4), 0, 0, {"frequency": 0.3, "amplitude": 0.2})
    found = loop(point)
    assert found["tension"].shape == (401,)
    assert found["march_tension"].shape == (8, 401)
    assert np.abs(found["displacement"]).max() == pytest.approx(0.2, rel=1e-4)
    assert found["displacement"].values == pytest.approx(found["march_displacement"].values[-1], abs=1e-9)
    assert found.attrs["gap"] < 0.01
    assert found.attrs["harmonic_status"] == found.attrs["march_status"] == "OK"
    harmonic = solve(point.scene, replace(point.ask, method="harmonic", interval=0.01))
    pull = np.linalg.norm(harmonic.signals["end_force"][:, 1], axis=1)
    assert float(found["tension"].max()) == pytest.approx(pull.max(), rel=1e-4)


def test_a_loop_that_cannot_be_drawn():
    still = make_point(study(), 0, 0, {"frequency": 0.3, "amplitude": 0.2})
    still = replace(still, scene=replace(still.scene, end_b=replace(still.scene.end_b, motion=None)))
    with pytest.raises(ValueError, match="no loop to draw: nothing moves"):
        loop(still)
    with pytest.raises(ValueError, match=r"the run's 2 s hold no period of 3.333 s"):
        loop(make_point(replace(study(), ask=Ask(duration=2.0)), 0, 0, {"frequency": 0.3, "amplitude": 0.2}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The study, run."""
    place = tmp_path_factory.mktemp("shaken")
    run(study(), Settings(directory=place))
    return place


def test_a_response_passes_through_the_rows(folder):
    found = responses(folder)
    assert found["half_range"].dims == ("panel", "curve", "along")
    assert found["others"].values.tolist() == ["amplitude = 0.05 m", "amplitude = 0.2 m"]
    assert found["row_trusted"].values.all()
    for k in range(2):
        x = found["parameter"].values[0, k]
        good = np.isfinite(x)
        assert (x[good].min(), x[good].max()) == pytest.approx((0.2, 0.3))
        assert found["stable"].values[0, k][good].all()
        at = np.interp(found["row_parameter"].values[0, k], x[good], found["half_range"].values[0, k][good])
        assert found["row_half_range"].values[0, k] == pytest.approx(at, rel=2e-3)
    again = responses(folder)
    xr.testing.assert_identical(again, found)  # kept


def test_the_row_of_a_periodic_response(folder):
    dataset = open_study(folder)
    text = one_point(dataset, str(dataset["key"].values[0]))
    assert "harmonics " in text
    assert "multiplier " in text
    assert "steps_per_period" not in text
    marched = dataset.assign(method=("point", ["dopri5"] * dataset.sizes["point"]))
    text = one_point(marched, str(dataset["key"].values[0]))
    assert "multiplier" not in text
    assert "steps_per_period" in text


def test_loops_are_kept_with_their_point(folder):
    key = make_plan(study()).keys[1]
    found = loop_of(folder, key)
    assert found.attrs["key"] == key
    assert (folder / "series" / f"{key}_loop.nc").is_file()
    xr.testing.assert_identical(loop_of(folder, key), found)


def test_the_same_yaml_by_both_methods():
    """A window of whole periods after the ramp: peak, least and RMS agree."""
    scene = make_point(study(), 0, 0, {"frequency": 0.25, "amplitude": 0.2}).scene
    runs = [solve(scene, replace(study().ask, method=method)) for method in ("harmonic", "explicit")]
    assert [run.status for run in runs] == [Status.OK, Status.OK]
    pulls = [np.linalg.norm(run.signals["end_force"][:, 1], axis=1) for run in runs]
    assert len(pulls[0]) == len(pulls[1]) == 401
    for reduce in (np.max, np.min, np.std):
        assert reduce(pulls[0]) == pytest.approx(reduce(pulls[1]), abs=2e-3 * np.ptp(pulls[1]))


def test_an_empty_folder_is_a_sentence(tmp_path):
    with pytest.raises((ValueError, StoreError)):
        responses(tmp_path)
