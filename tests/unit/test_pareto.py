"""Fronts by hand: who is on them, who must not be, which point is best, and which are tied."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import sweep  # noqa: F401  (fills the table of metrics)
from sweep.pareto import CRITERION, best, column, eligible, front, significant


def results(status=None, **columns):
    n = len(next(iter(columns.values())))
    data = {name: ("point", np.array(values, dtype=float)) for name, values in columns.items()}
    data["status"] = ("point", np.array(status or ["OK"] * n, dtype=object))
    return xr.Dataset(data)


def test_directions_count():
    """delta down, gamma up: 0, 1, 3 are not beaten; 2 is beaten by 1, 4 by 0."""
    found = results(delta=[0.2, 0.5, 0.6, 0.9, 0.3], gamma=[0.1, 0.5, 0.4, 0.9, 0.0])
    assert front(found, ["delta", "gamma"]).tolist() == [0, 1, 3]
    assert front(found, ["delta"]).tolist() == [0]
    assert front(found, ["gamma"]).tolist() == [3]


@pytest.mark.parametrize("status", ["ENERGY_OPEN", "UNRESOLVED", "BASELINE_FAILED", "ERROR", "MISSING"])
def test_untrusted_points_are_on_no_front(status):
    found = results(delta=[0.0, 0.5, 0.6], gamma=[1.0, 0.5, 0.4], status=[status, "OK", "OK"])
    assert front(found, ["delta", "gamma"]).tolist() == [1]
    assert best(found, ["delta", "gamma"]) == 1


def test_undefined_objectives_are_on_no_front():
    found = results(delta=[np.nan, 0.5, 0.1], t_first=[1.0, 2.0, np.inf])
    assert eligible(found, ["delta", "t_first"]).tolist() == [1]
    assert front(found, ["delta", "t_first"]).tolist() == [1]


def test_nothing_trusted_is_no_front():
    found = results(delta=[0.1], gamma=[0.1], status=["ERROR"])
    assert front(found, ["delta", "gamma"]).size == 0
    assert best(found, ["delta", "gamma"]) is None
    assert significant(found, ["delta", "gamma"]).size == 0


def test_equal_points_stay_on_the_front_together():
    found = results(delta=[0.3, 0.3, 0.4], gamma=[0.5, 0.5, 0.4])
    assert front(found, ["delta", "gamma"]).tolist() == [0, 1]


def test_best_is_nearest_to_the_ideal():
    """Scaled to the front: (0, 1), (0.4, 0.3), (1, 0); distances 1, 0.5, 1."""
    found = results(delta=[0.0, 0.4, 1.0], t_settle=[10.0, 3.0, 0.0], gamma=[0.5, 0.5, 0.5])
    assert best(found, ["delta", "t_settle"]) == 1
    assert best(found, ["delta", "t_settle", "gamma"]) == 1
    assert "distance to the ideal" in CRITERION


def test_front_of_many_matches_the_definition():
    rng = np.random.default_rng(0)
    a, b, c = rng.random((3, 200))
    found = results(delta=a, gamma=b, t_settle=c)
    values = np.column_stack([a, -b, c])
    expected = [
        i
        for i in range(200)
        if not np.any(np.all(values <= values[i], axis=1) & np.any(values < values[i], axis=1))
    ]
    assert front(found, ["delta", "gamma", "t_settle"]).tolist() == expected


def test_points_within_their_error_bars_are_tied():
    """1 and 2 differ by 0.02 in both, with bars of 0.015 each; 0 and 3 stand apart."""
    bars = {"delta_spread": [0.015] * 4, "gamma_spread": [0.015] * 4}
    found = results(delta=[0.0, 0.30, 0.32, 1.0], gamma=[0.0, 0.60, 0.62, 1.0], **bars)
    assert front(found, ["delta", "gamma"]).tolist() == [0, 1, 2, 3]
    kept = significant(found, ["delta", "gamma"])
    assert kept.tolist() == [True, False, True, True] or kept.tolist() == [True, True, False, True]
    assert kept[list(front(found, ["delta", "gamma"])).index(best(found, ["delta", "gamma"]))]
    without = found.drop_vars(list(bars))
    assert significant(without, ["delta", "gamma"]).all()


def test_one_bar_too_small_is_no_tie():
    found = results(
        delta=[0.30, 0.32], gamma=[0.60, 0.70], delta_spread=[0.05, 0.05], gamma_spread=[0.01, 0.01]
    )
    assert significant(found, ["delta", "gamma"]).tolist() == [True, True]


def test_several_environments():
    data = xr.Dataset(
        {
            "delta": (("design", "environment"), [[0.2, 0.4], [0.1, 0.9], [0.0, 0.0]]),
            "gamma": (("design", "environment"), [[0.5, 0.7], [0.9, 0.1], [1.0, 1.0]]),
            "status": (
                ("design", "environment"),
                np.array([["OK"] * 2, ["OK"] * 2, ["OK", "ERROR"]], object),
            ),
        }
    )
    assert column(data, "delta").values == pytest.approx([0.3, 0.5, 0.0])
    assert column(data, "delta_worst").values == pytest.approx([0.4, 0.9, 0.0])
    assert column(data, "gamma_worst").values == pytest.approx([0.5, 0.1, 1.0])
    assert front(data, ["delta", "gamma"]).tolist() == [0]


def test_what_cannot_be_an_objective_is_said():
    found = results(jumps=[1.0])
    with pytest.raises(ValueError, match="neither more nor less"):
        front(found, ["jumps"])
    with pytest.raises(ValueError, match="no metric `speed`"):
        front(found, ["speed"])
    with pytest.raises(ValueError, match="hold no metric `delta`"):
        front(found, ["delta"])
