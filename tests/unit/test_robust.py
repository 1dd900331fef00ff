"""Robustness: environments that stand for many, aggregates over them, a front run in other environments, ties."""

from __future__ import annotations

import importlib
import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import yaml
from rich.console import Console
from test_cli import folder, here, sweep  # noqa: F401  (fixtures)
from test_config import GOOD, mistakes, study

import sweep as package
from sweep.across import across
from sweep.config import Environment, bad_tail, find_metric, load_study, parse_study, split_name, spread_out
from sweep.dataset import assemble
from sweep.evaluate import clear_baselines
from sweep.pareto import (
    aggregate,
    aggregate_deviation,
    aggregates,
    barred,
    column,
    deviations,
    excesses,
    significant,
    spreads,
)
from sweep.plan import make_plan
from sweep.point import Record
from sweep.report import front_table, one_point, ties_note
from sweep.space import count_designs, design_scene, designs, points
from sweep.store import prepare

TINY = Path(__file__).parent / "tiny.yaml"
SEA = {"amplitude": [0.02, 0, 0], "frequency": 2.0, "seed": 9}
GRID = {"cable[0].d": [0.05, 0.06], "cable[0].mass": [4.0, 5.0, 6.0]}


def tiny(**changes):
    """The tiny study in a random sea."""
    raw = yaml.safe_load(TINY.read_text())
    raw["scene"]["end_b"]["motion"] = {"stochastic": SEA, "window": {"stop": 0.5, "ramp_up": 0.1, "ramp_down": 0.1}}
    return raw | changes


# ------------------------------------------------------------------------------------------ environments


def test_a_grid_and_seeds_stand_for_many():
    found = parse_study(tiny(environments=[{"name": "clean"}, {"name": "fouled", "grid": GRID, "seeds": [3, 7]}]))
    names = [environment.name for environment in found.environments]
    assert names[:3] == ["clean", "fouled d 0.05 mass 4 seed 3", "fouled d 0.05 mass 4 seed 7"]
    assert names[3] == "fouled d 0.05 mass 5 seed 3"
    assert len(names) == len(set(names)) == 13
    last = design_scene(found, designs(found, 1)[0], 12)
    assert (last.cable[0].d, last.cable[0].mass, last.end_b.motion.stochastic.seed) == (0.06, 6.0, 7)
    first = design_scene(found, designs(found, 1)[0], 0)
    assert first.end_b.motion.stochastic.seed == 9


def test_a_number_of_seeds_counts_from_one():
    found = parse_study(tiny(environments=[{"name": "sea", "seeds": 3}]))
    seeds = [environment.set["end_b.motion.stochastic.seed"] for environment in found.environments]
    assert seeds == [1, 2, 3]


def test_what_is_kept_says_it_all_and_keys_are_those_of_a_list_by_hand():
    short = parse_study(tiny(environments=[{"name": "sea", "seeds": 2}, {"name": "fouled", "grid": GRID}]))
    again = parse_study(yaml.safe_load(short.text))
    assert again.environments == short.environments
    assert again.text == short.text
    path = "end_b.motion.stochastic.seed"
    byhand = [{"name": f"s{k}", "set": {path: k}} for k in (1, 2)]
    byhand += [{"name": f"{d} {m}", "set": {"cable[0].d": d, "cable[0].mass": m}} for d in GRID["cable[0].d"]
               for m in GRID["cable[0].mass"]]  # fmt: skip
    long = parse_study(tiny(environments=byhand))
    assert [point.key for point in points(short, 1)] == [point.key for point in points(long, 1)]


def test_equal_leaves_are_named_by_their_paths():
    entry = Environment(name="a", grid={"devices[0].mass": (1.0,), "cable[0].mass": (2.0,)})
    assert [one.name for one in spread_out(entry, [])] == ["a devices[0].mass 1 cable[0].mass 2"]


def test_all_mistakes_of_environments_at_once():
    entries = [
        {"name": "a", "grid": {"cable[0].dd": [1], "devices[0].EA": [1.0], "cable[0].mass": []}},
        {"name": "b", "grid": {"cable[0].d": [0.05, -1]}, "seeds": 0},
        {"name": "c", "set": {"cable[0].d": 0.1}, "grid": {"cable[0].d": [0.1]}, "seed": 4},
        {"name": "d", "set": {"end_b.motion.stochastic.seed": 4}, "seeds": 2},
        {"name": "e seed 1"},
        {"name": "e", "seeds": 2},
    ]
    found = mistakes(tiny(environments=entries))
    assert set(found) == {
        "environments[0].grid.cable[0].dd", "environments[0].grid.devices[0].EA", "environments[0].grid.cable[0].mass",
        "environments[1].grid.cable[0].d", "environments[1].seeds", "environments[2].grid.cable[0].d",
        "environments[2].seed", "environments[3].seeds", "environments[5].name",
    }  # fmt: skip
    assert "did you mean `d`" in str(found["environments[0].grid.cable[0].dd"])
    assert "already set by variables.EA1.field" in str(found["environments[0].grid.devices[0].EA"])
    assert "greater than 0" in str(found["environments[1].grid.cable[0].d"])


def test_seeds_need_a_random_sea():
    found = mistakes(study(environments=[{"name": "sea", "seeds": 2}]))
    assert list(found) == ["environments[0].seeds"]
    assert "`stochastic`" in str(found["environments[0].seeds"])


# ------------------------------------------------------------------------------------------ aggregates


def test_names_come_apart():
    assert split_name("stroke_2_worst_sd") == ("stroke_2", ("worst", "sd"))
    assert split_name("gamma_q10") == ("gamma", ("q10",))
    assert split_name("rms_probe") == ("rms_probe", ())
    assert find_metric("stroke_2_q90").name == "stroke"
    assert [bad_tail(find_metric(name)) for name in ("gamma", "delta", "jumps")] == [10, 90, None]


def test_quantiles_are_linear_and_of_the_bad_tail():
    """0, 1, 2, 3, 4: 10 % lie below 0.4."""
    values = np.array([[4.0, 0.0, 2.0, 1.0, 3.0]])
    assert aggregate(values, "q10", "max") == pytest.approx([0.4])
    assert aggregate(values, "q90", "min") == pytest.approx([3.6])
    assert aggregate(values, "mean", "min") == pytest.approx([2.0])
    assert (aggregate(values, "worst", "min"), aggregate(values, "worst", "max")) == ([4.0], [0.0])
    assert aggregates("gamma") == ["mean", "worst", "q10"]
    assert aggregates("delta") == ["mean", "worst", "q90"]
    assert aggregates("jumps") == ["mean"]


@pytest.mark.parametrize("how", ["mean", "worst", "q10", "q90"])
def test_a_missing_environment_leaves_no_aggregate(how):
    assert np.isnan(aggregate(np.array([[1.0, math.nan, 2.0]]), how, "min"))[0]


def test_infinite_settling_times_have_quantiles():
    values = np.array([[1.0, 2.0, math.inf, math.inf], [1.0, 2.0, 3.0, 4.0]])
    assert aggregate(values, "q90", "min") == pytest.approx([math.inf, 3.7])
    assert aggregate(values, "q25", "min")[0] == 2.0  # between 1 and 2, of which no linear share is taken here


def test_the_deviation_of_a_mean_is_bounded_by_the_mean_deviation():
    """Whatever their correlation: errors that go together reach it, others stay below."""
    sds = np.array([[1.0, 3.0]])
    assert aggregate_deviation(sds, "mean") == [2.0]
    assert aggregate_deviation(sds, "worst") == [3.0]
    draws = np.random.default_rng(0).standard_normal((20000, 2))
    for together in (0.0, 0.5, 1.0):
        other = together * draws[:, 0] + math.sqrt(1 - together**2) * draws[:, 1]
        pair = np.column_stack([draws[:, 0], 3 * other])
        assert pair.mean(axis=1).std() <= 2.0 * 1.02  # 20000 draws: standard error 0.5 %


def rows(values, sds=None):
    """Rows of the tiny study in three seas: gamma, and delta = 1 - gamma, by design."""
    found = parse_study(tiny(environments=[{"name": "sea", "seeds": 3}], objectives=["gamma_q10", "delta_worst"]))
    plan = make_plan(found, len(values))
    records = {}
    for i, point in enumerate(points(found, len(values))):
        value = values[i // 3][i % 3]
        metrics = {"gamma": value, "delta": 1 - value}
        if sds is not None:
            metrics |= {"gamma_sd": sds[i // 3][i % 3], "delta_sd": sds[i // 3][i % 3]}
        records[point.key] = Record(key=point.key, design=0, environment=0, values={}, status="OK", metrics=metrics)
    return assemble(found, plan, records)


def test_results_hold_aggregates_with_their_meaning():
    data = rows([[0.1, 0.2, 0.6], [0.3, 0.3, 0.3]], [[0.1, 0.2, 0.3]] * 2)
    assert data["gamma_mean"].values == pytest.approx([0.3, 0.3])
    assert data["gamma_q10"].values == pytest.approx([0.12, 0.3])
    assert data["gamma_worst"].values == pytest.approx([0.1, 0.3])
    assert data["delta_q90"].values == pytest.approx([0.88, 0.7])
    assert (data["gamma_q10"].attrs["direction"], data["gamma_q10"].attrs["units"]) == ("max", "1")
    assert data["gamma_q10"].attrs["long_name"].startswith("10 % quantile, its bad tail, of")
    assert data["gamma_mean_sd"].values == pytest.approx([0.2, 0.2])
    assert data["gamma_q10_sd"].values == pytest.approx([0.3, 0.3])
    assert data["gamma_mean_sd"].attrs["long_name"] == "standard uncertainty of gamma_mean"
    assert "gamma_q10_mean" not in data
    assert "gamma_sd_mean" not in data
    assert column(data, "gamma_q25").values == pytest.approx([0.15, 0.3])  # on demand
    assert deviations(data, ["gamma_q10", "delta_mean"]) == pytest.approx(np.array([[0.3, 0.2]] * 2))


def test_show_has_the_bad_tail_and_the_deviation():
    key = str(rows([[0.1, 0.2, 0.6]])["key"].values[0, 0])
    text = one_point(rows([[0.1, 0.2, 0.6]], [[0.1, math.nan, 0.3]]), key)
    line = next(line for line in text.splitlines() if line.startswith("gamma"))
    assert line.split()[:7] == ["gamma", "0.1", "±", "0.1", "0.3", "0.1", "0.12"]
    assert "(q10)" in line
    assert "± ?" in one_point(rows([[0.1, 0.2, 0.6]], [[math.nan] * 3]), key)
    repeated = rows([[0.1, 0.2, 0.6]])
    repeated["gamma_ensemble"] = repeated["gamma"] + 0.05
    line = next(line for line in one_point(repeated, key).splitlines() if line.startswith("gamma_ensemble"))
    assert line.split()[1] == "0.15"


@pytest.mark.parametrize(
    ("objective", "words"),
    [
        ("delta_q10", "write delta_q90"),
        ("gamma_q95", "write gamma_q05"),
        ("delta_sd", "unknown metric"),
        ("delta_worst_mean", "unknown metric"),
        ("jumps_q10", "neither more nor less"),
        ("chaos_mean", "`uncertainty` section"),
    ],
)
def test_objectives_that_mean_nothing(objective, words):
    raw = tiny(environments=[{"name": "sea", "seeds": 3}], objectives=["gamma", objective])
    found = mistakes(raw)
    assert list(found) == ["objectives[1]"]
    assert words in str(found["objectives[1]"])


def test_one_environment_has_no_tail():
    found = mistakes(tiny(environments=[{"name": "sea", "seeds": 1}], objectives=["gamma_q10"]))
    assert "at least two `environments`" in str(found["objectives[0]"])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fatigue_use", "without `metrics.fatigue`"),
        ("use_breaking_load", "without `metrics.limits.breaking_load`"),
        ("rms_probe", "without `metrics.probe`"),
        ("chaos", "`uncertainty` section"),
        ("chaos_saturated", "`uncertainty` section"),
        ("delta_sd", "`uncertainty` section"),
        ("delta_worst", "at least two `environments`"),
        ("delta_q80", "at least two `environments`"),
        ("delta_ensemble", "perturbed runs"),
        ("delta_worst_mean", "results do not have"),
        ("delta_sd_worst", "results do not have"),
        ("delta_q80_sd", "results do not have"),
        ("jumps_worst", "results do not have"),
        ("delt", "unknown metric"),
    ],
)
def test_bounds_on_numbers_that_there_will_never_be(name, words):
    raw = tiny(constraints={"gamma": {"min": 0.0}, name: {"max": 1.0}})
    found = mistakes(raw)
    assert list(found) == [f"constraints.{name}"]
    assert words in str(found[f"constraints.{name}"])


def test_spreads_are_of_objectives():
    found = mistakes(tiny(objectives=["gamma"], repeats={"n": 2}, constraints={"delta_spread": {"max": 0.1}}))
    assert "add `delta` to the `objectives`" in str(found["constraints.delta_spread"])


def test_bounds_on_numbers_that_there_are():
    """Every kind of name that the check lets pass has a number in results whose rows have all of theirs."""
    names = ["delta", "delta_mean", "delta_worst", "delta_q80", "delta_q10", "delta_sd", "delta_q90_sd", "jumps_mean",
             "delta_ensemble", "delta_ensemble_q80", "delta_spread", "fatigue_use", "use_breaking_load", "chaos_worst",
             "jumps_mean_sd", "rms_probe"]  # fmt: skip
    metrics = {"fatigue": {"E": 1e11, "m": 3, "log_a": 12}, "limits": {"breaking_load": 1e5}, "probe": 1.0}
    found = parse_study(tiny(
        environments=[{"name": "sea", "seeds": 3}], objectives=["delta"], repeats={"n": 2}, uncertainty={},
        metrics=metrics, constraints={name: {"max": 0.5} for name in names},
    ))  # fmt: skip
    plan = make_plan(found, 1)
    columns = [str(name) for name, c in assemble(found, plan, {}).data_vars.items() if "direction" in c.attrs]
    own = [name for name in columns if not set(split_name(name)[1]) & {"mean", "worst", "q10", "q90"}]
    records = {key: Record(key=key, design=0, environment=0, values={}, status="OK", metrics=dict.fromkeys(own, v))
               for key, v in zip(plan.keys, (0.1, 0.3, 0.9), strict=True)}  # fmt: skip
    over = excesses(assemble(found, plan, records))
    assert list(over) == [f"{name} <= 0.5" for name in names]
    assert np.isfinite(list(over.values())).all(), over
    worst, mean, tail = 0.9 - 0.5, 1.3 / 3 - 0.5, 0.3 + 0.6 * 0.6 - 0.5  # 0.8 of two steps: 0.6 of the second
    expected = {"delta": worst, "delta_mean": mean, "delta_worst": worst, "delta_q80": tail, "delta_ensemble_q80": tail}
    assert {name: over[f"{name} <= 0.5"][0] for name in expected} == pytest.approx(expected)


# ------------------------------------------------------------------------------------------ ties


def results(**columns):
    n = len(next(iter(columns.values())))
    data = {name: ("point", np.array(values, dtype=float)) for name, values in columns.items()}
    data["status"] = ("point", np.array(["OK"] * n, object))
    data["key"] = ("point", np.array([f"k{i}" for i in range(n)], object))
    return xr.Dataset(data)


def test_ties_go_by_the_deviation_of_the_difference():
    """0.1 and 0.1 are hypot = 0.1414: 0.2 apart is within 1.96 of them, and not within 1."""
    found = results(delta=[0.3, 0.5], gamma=[0.5, 0.6], delta_sd=[0.1, 0.1], gamma_sd=[0.1, 0.1])
    assert significant(found, ["delta", "gamma"]).sum() == 1
    assert significant(found, ["delta", "gamma"], z=1.0).all()
    spread = found.assign(delta_spread=("point", [0.0, 0.0]))
    assert barred(spread, ["delta", "gamma"]) == ["sd", "sd"]  # which says more than half a range
    assert significant(spread, ["delta", "gamma"]).sum() == 1


def test_an_unknown_deviation_ties_and_is_said():
    found = results(delta=[0.3, 0.9], gamma=[0.5, 0.6], delta_sd=[math.nan, 0.1], gamma_sd=[0.1, 0.1])
    kept = significant(found, ["delta", "gamma"])
    assert kept.sum() == 1
    chosen = np.array([0, 1])
    note = ties_note(found, ["delta", "gamma"], chosen, ~kept, 1.96)
    assert "standard uncertainty of delta, gamma: points closer than 1.96 sd" in note
    assert "uncertainty of delta unknown at 1 of 2 points" in note
    assert "1 of 2 points of the front are tied" in note
    table = front_table(found, ["delta", "gamma"], chosen, ~kept, 0, Console(force_terminal=False))
    assert "0.3 ± ?" in table
    assert "0.5 ± 0.1" in table


def test_a_mean_of_runs_is_known_better_than_one():
    """Half ranges of 0.03 tie 0.30 and 0.34 of single runs; of means of 4 runs they are 0.015, and do not."""
    bars = {"delta_spread": [0.03, 0.03], "gamma_spread": [0.3, math.nan]}
    found = results(delta=[0.3, 0.34], delta_ensemble=[0.3, 0.34], gamma_ensemble=[0.5, 0.6], **bars)
    known, chosen = found.assign_attrs(repeats=3), np.array([0, 1])
    assert spreads(known, ["delta", "delta_ensemble"])[0] == pytest.approx([0.03, 0.015])
    names = ["delta_ensemble", "gamma_ensemble"]
    assert significant(found, names).sum() == 1
    assert significant(known, names).all()
    note = ties_note(known, names, chosen, np.array([False, False]), 1.96)
    assert "half ranges of delta_ensemble, gamma_ensemble are divided by sqrt(4), as means of 4 runs" in note
    assert "uncertainty of gamma_ensemble unknown at 1 of 2 points" in note
    assert "those of one run" not in note
    assert "error bars of delta_ensemble, gamma_ensemble are those of one run" in ties_note(
        found, names, chosen, np.array([False, True]), 1.96
    )
    sds = known.assign(delta_sd=("point", [0.03, 0.03]))
    assert "error bars of delta_ensemble are those of one run" in ties_note(
        sds, names, chosen, np.array([False, True]), 1.96
    )
    table = front_table(known, names, chosen, np.array([False, False]), 0, Console(force_terminal=False))
    assert "0.34 ± 0.015" in table
    assert "0.5 ± 0.15" in table
    assert "0.6 ± ?" in table


def test_without_error_bars_nothing_is_claimed():
    found = results(delta=[0.3, 0.31], gamma=[0.5, 0.51])
    assert significant(found, ["delta", "gamma"]).all()
    note = ties_note(found, ["delta", "gamma"], np.array([0, 1]), np.array([False, False]), 1.96)
    assert note.startswith("no error bars of delta, gamma")
    assert "tied with a better one" not in note


# ------------------------------------------------------------------------------------------ given designs


def given(**values):
    return tiny(sampler={"kind": "given", "values": values})


def test_given_designs_are_the_designs():
    found = parse_study(given(EA1=[1e4, 12345.678901234567, 1e3]))
    assert [one["EA1"] for one in designs(found)] == [1e4, 12345.678901234567, 1e3]
    assert count_designs(found) == 3
    assert [one["EA1"] for one in designs(found, 2)] == [1e4, 12345.678901234567]
    assert parse_study(yaml.safe_load(found.text)).text == found.text


def test_all_mistakes_of_given_designs_at_once():
    raw = GOOD | {"sampler": {"kind": "given", "n": 2, "values": {"stif": [1e5], "stiff": [1e6, 1e20]}}}
    found = mistakes(raw)
    assert {"sampler.n", "sampler.values.stif", "sampler.values.stiff[1]"} <= set(found)
    text = str(found["sampler.values"])
    assert "no `devices[1].k`" in text or "for each design" in text
    assert "outside the variable's range" in str(found["sampler.values.stiff[1]"])


def test_a_front_that_is_not_there(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(yaml.safe_dump(tiny()))
    (tmp_path / "front.nc").write_text("no netCDF")
    for name, words in (("fron.nc", "did you mean `front.nc`"), ("front.nc", "not a file of results")):
        with pytest.raises(package.ConfigError) as caught:
            load_study(path, tmp_path / name)
        assert words in str(caught.value)


def test_a_front_is_run_in_other_environments(here, folder, tmp_path):  # noqa: F811
    """The front of the tiny study in two seas: the same designs to the last bit, resumed from what is there."""
    assert here("pareto", folder).returncode == 0
    path, out = tmp_path / "seas.yaml", tmp_path / "out"
    raw = tiny(environments=[{"name": "sea", "seeds": 2}], objectives=["delta_q90", "gamma_mean"])
    raw["scene"]["end_b"]["motion"]["stochastic"]["multiples"] = [1.0]  # ten segments resolve 2 Hz and no more
    path.write_text(yaml.safe_dump(raw))
    words = ("run", path, "--out", out, "--designs", folder / "front.nc")
    first = sweep(*words, "--limit", 1)
    assert first.returncode == 0, first.stderr
    ended = sweep(*words)
    assert ended.returncode == 0, ended.stderr
    with xr.open_dataset(folder / "front.nc") as front, xr.open_dataset(out / "results.nc") as data:
        assert data["EA1"].values.tolist() == front["EA1"].values.tolist()
        assert data.sizes["environment"] == 2
        assert f"{2 * (front.sizes['point'] - 1)} to do" in ended.stderr
        assert (data["status"] == "OK").all()
        assert np.isfinite(data["delta_q90"].values).all()
    assert load_study(out / "study.yaml").text == load_study(path, folder / "front.nc").text  # it stands by itself
    shown = here("pareto", out)
    assert shown.returncode == 0, shown.stderr
    assert "delta_q90" in shown.stdout


# ------------------------------------------------------------------------------------------ figures 13 and 14


def test_a_design_across_its_environments(tmp_path, monkeypatch):
    from test_series import fake_solve

    monkeypatch.setattr(importlib.import_module("sweep.evaluate"), "solve", fake_solve)
    clear_baselines()
    found = parse_study(tiny(environments=[{"name": "sea", "seeds": 3}]))
    prepare(found, tmp_path)
    key = make_plan(found).keys[4]  # the second design's second sea
    data = across(tmp_path, key)
    assert data["environment"].values.tolist() == ["sea seed 1", "sea seed 2", "sea seed 3"]
    assert data["displacement"].values == pytest.approx(0.5 * data["baseline_displacement"].values, abs=1e-6)
    assert data.attrs["design"] == 1
    peak = data["frequency"].values[int(data["displacement_amplitude"].values[0].argmax())]
    assert peak == pytest.approx(2.0, abs=0.3)  # the made-up response has 2 Hz; bins of 1/4 Hz
    assert (tmp_path / "series" / f"{key}.nc").is_file()
    clear_baselines()


def test_one_environment_is_no_comparison(tmp_path):
    prepare(load_study(TINY), tmp_path)
    with pytest.raises(ValueError, match="one environment"):
        across(tmp_path, make_plan(load_study(TINY)).keys[0])
