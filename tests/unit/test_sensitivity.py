"""Sensitivity on Ishigami's function, whose indices are known; with failed rows; and what must not be silent."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import xarray as xr
import yaml
from rich.console import Console
from test_config import study

from sweep import report, space
from sweep.config import ConfigError, parse_study
from sweep.sensitivity import indices
from sweep.signal_plots import save_sensitivity
from sweep.space import block_size, count_designs, designs, unit_samples

S1 = np.array([0.3139, 0.4424, 0.0])  # Ishigami's with a = 7, b = 0.1 (Homma and Saltelli, 1996)
ST = np.array([0.5576, 0.4424, 0.2437])
AXES = ("end_a.position[0]", "end_a.position[1]", "end_b.position[0]")


def drawn(kind, n, seed=0):
    variables = {f"x{i + 1}": {"field": path, "linear": [-math.pi, math.pi]} for i, path in enumerate(AXES)}
    return parse_study(study(variables=variables, tied={}, sampler={"kind": kind, "n": n, "seed": seed}))


def results(made, function=None, lost=None, gone="DIVERGED"):
    """Rows of a study whose `delta` is a function of its designs; those in `lost` failed."""
    x = np.array([list(values.values()) for values in designs(made)])
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    y = y if function is None else function(x)
    status = np.full(len(y), "OK", dtype=object)
    if lost is not None:
        status[lost(x)], y[lost(x)] = gone, np.nan
    data = {"delta": ("point", y), "status": ("point", status), "gamma": ("point", 0 * y)}
    return xr.Dataset(data | {"t_first": ("point", np.where(y > 0, np.inf, y))})


def notes(found, k=0):
    return json.loads(str(found["notes"].values[k]))["notes"]


def test_designs_come_in_blocks():
    made = drawn("saltelli", 8)
    u = unit_samples(made)
    assert (block_size(made), count_designs(made)) == (5, 40) == (5, len(u))
    for a, *mixed, b in u.reshape(8, 5, 3):
        for j, row in enumerate(mixed):
            assert row == pytest.approx(np.where(np.arange(3) == j, b, a))
    assert designs(drawn("saltelli", 32))[:40] == designs(made)  # a longer study begins with the shorter
    assert designs(made) == designs(drawn("saltelli", 8)) != designs(drawn("saltelli", 8, seed=1))


def test_trajectories_change_one_variable_at_a_time():
    made = drawn("morris", 6)
    u = unit_samples(made)
    assert (block_size(made), count_designs(made), len(u)) == (4, 24, 24)
    assert set(np.round(np.unique(u) * 3, 9)) <= {0, 1, 2, 3}
    steps = np.diff(u.reshape(6, 4, 3), axis=1)
    assert np.all(np.count_nonzero(steps, axis=2) == 1)


def test_ishigami():
    """1024 blocks: the estimators' standard errors are some 0.03; the intervals of 95 % say so themselves."""
    made = drawn("saltelli", 1024)
    found = indices(made, results(made), ["delta"])
    assert found["S1"].values[0] == pytest.approx(S1, abs=0.04)
    assert found["ST"].values[0] == pytest.approx(ST, abs=0.04)
    assert np.all(np.abs(found["ST"].values[0] - ST) < 2 * found["ST_conf"].values[0] + 0.005)
    assert 0 < float(found["S1_conf"].max()) < 0.15
    assert (int(found["blocks"][0]), int(found["complete"][0]), notes(found)) == (1024, 1024, [])


def test_ishigami_with_failed_rows():
    """5 % of the points lost at random cost 1 - 0.95^5 = 23 % of the blocks, and the indices their digits only."""
    made = drawn("saltelli", 1024)
    chance = np.random.default_rng(4).random(count_designs(made)) < 0.05
    found = indices(made, results(made, lost=lambda x: chance), ["delta"])
    assert found["S1"].values[0] == pytest.approx(S1, abs=0.05)
    assert found["ST"].values[0] == pytest.approx(ST, abs=0.05)
    assert int(found["complete"][0]) == pytest.approx(1024 * 0.95**5, abs=60)
    assert int(found["points_left_out"][0]) == chance.sum()
    (said,) = notes(found)  # scattered points do not cluster
    assert f"{chance.sum()} DIVERGED" in said
    assert f"{1024 - int(found['complete'][0])} of 1024 blocks" in said


def test_nothing_but_whole_blocks_counts():
    """The indices are those of the complete blocks alone, to the last digit."""
    made = drawn("saltelli", 64)
    whole = results(made)
    broken = results(made, lost=lambda x: np.isin(np.arange(len(x)), [7, 133]))
    some = indices(made, broken, ["delta"])
    kept = np.delete(np.arange(320).reshape(64, 5), [1, 26], axis=0).ravel()
    from SALib.analyze import sobol

    expected = sobol.analyze(
        space.problem("abc"), whole["delta"].values[kept], calc_second_order=False, num_resamples=10, seed=0
    )
    assert some["S1"].values[0] == pytest.approx(expected["S1"], rel=1e-12)
    assert int(some["complete"][0]) == 62


def test_points_that_fail_together_are_told():
    made = drawn("saltelli", 256)
    found = indices(made, results(made, lost=lambda x: x[:, 1] > 2.6, gone="TIMEOUT"), ["delta"])
    assert any("cluster along x2" in sentence for sentence in notes(found))
    assert "TIMEOUT" in notes(found)[0]
    again = indices(drawn("morris", 60), results(drawn("morris", 60), lost=lambda x: x[:, 0] > 3.0), ["delta"])
    assert any("cluster along x1" in sentence for sentence in notes(again))


@pytest.mark.parametrize("seed", range(6))
def test_points_that_fail_by_chance_are_not_called_a_cluster(seed):
    made = drawn("saltelli", 128)
    chance = np.random.default_rng(seed).random(count_designs(made)) < 0.08
    assert len(notes(indices(made, results(made, lost=lambda x: chance), ["delta"]))) == 1


def test_screening():
    """Effects of 3 x1, and of x2 in a product: mu* = 3 x the range, sigma of the interacting ones alone."""
    made = drawn("morris", 40)
    found = indices(made, results(made, lambda x: 3 * x[:, 0] + x[:, 1] * x[:, 2]), ["delta"])
    assert float(found["mu_star"][0, 0]) == pytest.approx(6 * math.pi)
    assert float(found["sigma"][0, 0]) == pytest.approx(0.0, abs=1e-9)
    assert np.all(found["sigma"].values[0, 1:] > 5)
    lost = np.isin(np.arange(160), [3, 4, 9])
    made_less = indices(made, results(made, lambda x: 3 * x[:, 0], lost=lambda x: lost), ["delta"])
    assert int(made_less["complete"][0]) == 37
    assert float(made_less["mu_star"][0, 0]) == pytest.approx(6 * math.pi)
    assert float(made_less["mu_star"][0, 1]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kind", ["sobol", "random", "lhs"])
def test_any_random_design_gives_first_order_indices(kind):
    """RBD-FAST of 1500 points, 5 % of them lost; its bias and scatter are some 0.05."""
    made = drawn(kind, 1500)
    chance = np.random.default_rng(1).random(1500) < 0.05
    found = indices(made, results(made, lost=lambda x: chance), ["delta"])
    assert found["S1"].values[0] == pytest.approx(S1, abs=0.08)
    assert "ST" not in found
    assert f"{chance.sum()} of 1500 points left out" in notes(found)[0]


def test_nothing_is_silently_zero():
    made = drawn("saltelli", 32)
    found = indices(made, results(made, lost=lambda x: np.arange(len(x)) % 6 == 0), ["delta", "gamma", "t_first"])
    assert np.isnan(found["S1"].values).all()
    assert np.isnan(found["ST_conf"].values).all()
    assert "the least" in notes(found, 0)[-1]
    assert "does not vary" in notes(indices(made, results(made), ["gamma"]))[-1]
    assert "infinite or undefined" in notes(found, 2)[0]
    untrusted = results(made)
    untrusted["status"].values[0] = "ENERGY_OPEN"
    assert int(indices(made, untrusted, ["delta"])["complete"][0]) == 31


def test_several_environments_and_a_study_half_done():
    made = drawn("saltelli", 64)
    one = results(made)
    two = xr.Dataset(
        {
            "delta": (("design", "environment"), np.stack([one["delta"].values, 3 * one["delta"].values], axis=1)),
            "status": (("design", "environment"), np.full((320, 2), "OK", dtype=object)),
        }
    )
    expected = indices(made, one, ["delta"])["S1"].values
    assert indices(made, two, ["delta"])["S1"].values == pytest.approx(expected)
    two["status"].values[8, 1] = "TIMEOUT"
    assert int(indices(made, two, ["delta"])["complete"][0]) == 63
    part = indices(made, one.isel(point=slice(0, 203)), ["delta"])
    assert (int(part["blocks"][0]), int(part["complete"][0])) == (40, 40)


def test_what_has_no_indices_says_so(monkeypatch):
    made = drawn("saltelli", 32)
    with pytest.raises(ValueError, match="no metric `delt`"):
        indices(made, results(made), ["delt"])
    grid = parse_study(study(sampler={"kind": "grid", "n": 3}))
    with pytest.raises(ValueError, match="a grid has no sensitivity indices"):
        indices(grid, results(made), ["delta"])
    front = {"kind": "given", "values": {key: [0.1, 0.2, 0.3] for key in ("x1", "x2", "x3")}}
    listed = parse_study(yaml.safe_load(made.text) | {"sampler": front})
    with pytest.raises(ValueError, match="given designs have no sensitivity indices"):
        indices(listed, results(listed), ["delta"])
    monkeypatch.setattr(space, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"needs the package SALib.*\n?.*cable-sweep\[analysis\]"):
        designs(made)


def test_table_and_figures(tmp_path):
    made, screen = drawn("saltelli", 64), drawn("morris", 20)
    found = indices(made, results(made, lost=lambda x: x[:, 1] > 3.0), ["delta", "gamma"])
    text = report.sensitivities(found, Console())
    assert "blocks of a saltelli design" in text
    assert "x2" in text
    assert "left out" in text
    assert "no indices" in text
    assert save_sensitivity(found, tmp_path / "a.png").stat().st_size > 10_000
    screened = indices(screen, results(screen), ["delta"])
    assert "trajectories" in report.sensitivities(screened, Console())
    assert save_sensitivity(screened, tmp_path / "b.png").stat().st_size > 10_000
    found.to_netcdf(tmp_path / "c.nc")
