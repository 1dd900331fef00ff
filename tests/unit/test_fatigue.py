"""Fatigue: ASTM's own example, closed forms of both curves, worst places, bending in one and two planes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from study_kit import response, scene
from test_config import mistakes, study

from solvers import Section
from sweep.config import MetricSettings, parse_study
from sweep.fatigue import (
    YEAR,
    Fatigue,
    Limits,
    bending,
    closed,
    count,
    damage_of,
    everywhere,
    most_damage,
    turning_points,
    wear,
)
from sweep.metrics import compute, summarise
from sweep.space import point_key

T = np.linspace(0, 10, 4001)
SN = Fatigue(E=1e11, m=3.0, log_a=12.0, fibre=0.02)
LIFE = Fatigue(
    curve="strain_life", E=1.2e11, strength=5e8, strength_exponent=-0.09, ductility=0.3, ductility_exponent=-0.6
)
ENDS = (scene().end_a, scene().end_b)
CABLE = scene().cable


def test_astm_e1049_example():
    """ASTM E1049-85 (2017), figure 6: -2 1 -3 5 -1 3 -4 4 -2; its table: 0.5 x 3, 1.5 x 4, 0.5 x 6, 1 x 8, 0.5 x 9."""
    found = count(np.array([-2.0, 1, -3, 5, -1, 3, -4, 4, -2]))
    table: dict[float, float] = {}
    for span, _, number in found:
        table[span] = table.get(span, 0.0) + number
    assert table == {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}
    assert {(span, mean) for span, mean, number in found if number == 1.0} == {(4.0, 1.0)}


def test_samples_between_the_peaks_change_nothing():
    peaks = np.array([-2.0, 1, -3, 5, -1, 3, -4, 4, -2])
    dense = np.interp(np.linspace(0, 8, 401), np.arange(9), peaks)
    dense = np.repeat(dense, 2)  # plateaus
    assert np.array_equal(turning_points(dense), peaks)
    assert np.array_equal(count(dense), count(peaks))
    assert count(np.array([1.0, 3.0])).tolist() == [[2.0, 2.0, 0.5]]
    assert count(np.ones(5)).shape == (0, 3)


def test_a_closed_history_has_whole_cycles():
    """Two periods of a wave with a ripple: from maximum to maximum all is paired."""
    phase = np.arange(800) / 400 * 2 * np.pi
    found = count(closed(np.sin(phase) + 0.5 * np.sin(3 * phase)))
    total = found[:, 2].sum()
    assert total == pytest.approx(6.0)  # three maxima a period
    assert total == round(total)


def test_curves():
    spans = np.array([20.0, 100.0, 400.0]) * 1e6
    assert SN.cycles(spans) == pytest.approx(1e12 / np.array([20.0, 100.0, 400.0]) ** 3)
    bent = dataclasses.replace(SN, m2=5.0, knee=1e7)
    at = 1e6 * (1e12 / 1e7) ** (1 / 3)
    assert bent.cycles(np.array([at / 2, at, 2 * at])) == pytest.approx([1e7 * 32, 1e7, 1e7 / 8])
    for curve in (SN, bent, LIFE):
        for span in (3e6, 9e7, 8e8):
            # bisection of 44 decades, 60 times, leaves rounding of 10**x alone
            assert curve.equivalent(float(curve.cycles(np.array(span)))) == pytest.approx(span, rel=1e-9)
    N = float(LIFE.cycles(np.array(6e8)))
    assert 6e8 / 2 / 1.2e11 == pytest.approx(5e8 / 1.2e11 * (2 * N) ** -0.09 + 0.3 * (2 * N) ** -0.6)
    assert SN.damage(np.array([0.0]), np.array([1.0])) == 0.0
    flat = Fatigue(E=1e11, m=0.05, log_a=100.0)  # the extremes of what is allowed overflow to infinity, and say no more
    assert flat.equivalent(1e-9) == math.inf
    assert np.isfinite(flat.cycles(spans)).all()


def test_goodman():
    given = dataclasses.replace(SN, ultimate=4e8)
    span, mean = np.array(1e8), np.array([1e8, -1e8, 4e8])
    ratio = given.damage(span, mean) / SN.damage(span, mean)
    assert ratio[:2] == pytest.approx([(4 / 3) ** 3, 1.0])
    assert ratio[2] == math.inf  # the mean alone breaks it


def waving(amplitude, tension=100.0):
    """Bending of node 2 in a plane by +-amplitude at 1 Hz, and steady tension."""
    x = np.zeros((len(T), 5))
    x[:, 2] = 0.1 * np.sin(2 * np.pi * T)
    kappa = np.zeros((len(T), 5))
    kappa[:, 2] = np.abs(amplitude * np.sin(2 * np.pi * T))  # lines give its size
    pull = np.broadcast_to(np.asarray(tension, float), (len(T),))
    return response(x, T, curvature=kappa, tension=np.repeat(pull[:, None], 4, axis=1))


def test_reversed_bending_is_one_cycle_a_period():
    """Curvature comes as a size: its turns must be found from the shape, or the range is half and the count double."""
    run = waving(0.3)
    found = wear(T, run.signals, slice(None), CABLE, ENDS, SN)
    span = 2 * 1e11 * 0.02 * 0.3
    # ten periods from zero to zero: 10 cycles less what start and end leave as halves of half the range
    assert found.cycles == pytest.approx(10.0, abs=0.51)
    assert found.damage == pytest.approx(10 * (span / 1e6) ** 3 / 1e12, rel=0.1)
    assert found.s == 2.0
    assert found.gap < 1e-3  # 400 samples a period
    assert found.per_year == pytest.approx(found.damage * YEAR / 10)
    assert found.span == pytest.approx(span, rel=0.05)  # 1 Hz is its own frequency
    settled = wear(T, run.signals, slice(None), CABLE, ENDS, SN, period=1.0)
    assert settled.damage == pytest.approx(10 * (span / 1e6) ** 3 / 1e12, rel=1e-3)
    assert settled.cycles == 10.0


def test_tension_and_bending_add_on_one_side():
    """In phase they add at one fibre: the worst one has the sum of both ranges."""
    amplitude, pull = 0.2, 1e5
    run = waving(amplitude, pull * np.sin(2 * np.pi * T))
    found = wear(T, run.signals, slice(None), CABLE, ENDS, SN, period=1.0)
    span = 2 * (1e11 * 0.02 * amplitude + 1e11 * pull / CABLE[0].EA)
    assert found.span == pytest.approx(span, rel=1e-3)
    doubled = dataclasses.replace(SN, concentration=2.0, events_per_year=10.0, design_life=20.0, design_factor=3.0)
    more = wear(T, run.signals, slice(None), CABLE, ENDS, doubled, period=1.0)
    assert more.damage == pytest.approx(8 * found.damage)
    assert more.use == pytest.approx(more.damage * 10 * 20 * 3)
    bare = dataclasses.replace(SN, tension_factor=0.0)
    assert wear(T, run.signals, slice(None), CABLE, ENDS, bare, period=1.0).span == pytest.approx(
        2 * 1e11 * 0.02 * amplitude, rel=1e-3
    )


def test_the_worst_place_is_that_of_a_search_over_all():
    """Random histories at all nodes: stopping early at the bound loses nothing."""
    draw = np.random.default_rng(3)
    x = np.cumsum(draw.standard_normal((len(T), 5)), axis=0) * 1e-3
    bent, pull = np.abs(draw.standard_normal((len(T), 5))), draw.normal(1e4, 3e3, (len(T), 4))
    run = response(x, T, curvature=bent, tension=pull)
    found = wear(T, run.signals, slice(None), CABLE, ENDS, SN)
    s, damage, cycles = everywhere(T, run.signals, CABLE, ENDS, SN)
    assert damage.max() == cycles[:, 2].sum() == found.damage
    assert (s[damage.argmax()], cycles[:, 1].sum()) == (found.s, found.cycles)
    bend = bending(run.signals, slice(None), ENDS)
    best = 0.0
    for i in range(5):
        pull = run.signals["tension"][:, [e for e in (i - 1, i) if 0 <= e < 4]].mean(axis=1)
        for side in (1, -1):
            cycles = count(1e11 * (pull / CABLE[0].EA + 0.02 * side * bend[:, i, 0]))
            best = max(best, float((cycles[:, 2] * (cycles[:, 0] / 1e6) ** 3).sum() / 1e12))
    assert found.damage == pytest.approx(best, rel=1e-12)


KNEE = dataclasses.replace(SN, m2=5.0, knee=1e6, ultimate=3e9)


@pytest.mark.parametrize("curve", [SN, LIFE, KNEE], ids=["sn", "life", "knee"])
@pytest.mark.parametrize("seed", range(8))
def test_no_count_exceeds_its_bound(curve, seed):
    draw = np.random.default_rng(seed)
    x = 1e8 * np.cumsum(draw.standard_normal(300 + seed)) * 0.1 + 3e8 * draw.standard_normal(300 + seed)
    for settled in (False, True):
        assert 0 < damage_of(x, curve, settled)[0] <= most_damage(x, curve)


def test_bending_in_space_turns_with_the_cable():
    """A helix-like wobble: size and components agree; a plane that contains the line has one component."""
    run = response(np.zeros((len(T), 5)), T, curvature=np.full((len(T), 5), 0.5))
    run.signals["position"][:, 2, 0] += 0.1 * np.cos(2 * np.pi * T)
    run.signals["position"][:, 2, 1] += 0.1 * np.sin(2 * np.pi * T)
    parts = bending(run.signals, slice(None), ENDS)
    assert np.hypot(*parts[:, 2].T) == pytest.approx(0.5, rel=1e-12)
    assert np.ptp(parts[:, 2], axis=0) == pytest.approx([1.0, 1.0], rel=1e-3)
    found = wear(T, run.signals, slice(None), CABLE, ENDS, SN, period=1.0)
    assert found.span == pytest.approx(2 * 1e11 * 0.02 * 0.5, rel=1e-3)  # any fibre goes round
    swung = response(np.zeros((len(T), 5)), T, curvature=np.full((len(T), 5), 0.5))
    angle = 1.2 * np.sin(2 * np.pi * T)[:, None]  # the whole bent line swings in its plane by 69 degrees
    along, aside = np.arange(5.0) - 2, np.array([0, 0.05, 0.2, 0.05, 0])
    swung.signals["position"][:, :, 0] = np.cos(angle) * aside + np.sin(angle) * along
    swung.signals["position"][:, :, 2] = np.cos(angle) * along - np.sin(angle) * aside
    parts = bending(swung.signals, slice(None), ENDS)
    assert parts[:, 2] == pytest.approx(np.tile(parts[0, 2], (len(T), 1)), abs=1e-9)  # bends no more, no less


def test_a_front_of_nothing_bends_nothing():
    """What runs ahead of a wave: offsets whose squares are below the least number."""
    run = waving(0.3)
    run.signals["position"][:, 3, 0] = 1e-170 * np.sin(T)
    run.signals["position"][:, 2, 0] = 1e-169
    run.signals["curvature"][:, 2] = 1e-9
    parts = bending(run.signals, slice(None), ENDS)
    assert np.abs(parts).max() <= 1e-9
    assert wear(T, run.signals, slice(None), CABLE, ENDS, SN).damage < 1e-12


def test_a_clamp_bends_the_end_node():
    run = response(np.zeros((len(T), 5)), T, curvature=np.full((len(T), 5), 0.5))
    run.signals["position"][:, 1, 0] = 0.1 * np.sin(2 * np.pi * T)
    clamped = dataclasses.replace(ENDS[0], kind="clamped", direction=(0.0, 0.0, 1.0))
    assert np.ptp(bending(run.signals, slice(None), (clamped, ENDS[1]))[:, 0, 0]) == pytest.approx(1.0)
    assert not bending(run.signals, slice(None), ENDS)[:, 0].any()


def test_within_a_rod_nothing_tires():
    """Nodes 1 and 2 are the ends of a rod: both are cable on one side; a node between two rods is not."""
    pull = np.zeros((len(T), 4))
    pull[:, 1] = 1e6 * np.sin(T)
    run = response(np.zeros((len(T), 5)), T, rigid=[0, 1, 0, 0], tension=pull)
    assert wear(T, run.signals, slice(None), CABLE, ENDS, SN).damage == 0.0
    two = (Section(length=2.0, d=0.1, mass=3.0, EA=1e6), Section(length=2.0, d=0.1, mass=3.0, EA=1e7))
    pull[:, 3] = 1e4 * np.sin(2 * np.pi * T)
    run = response(np.zeros((len(T), 5)), T, tension=np.roll(pull, 0, axis=1) * [0, 0, 0, 1])
    found = wear(T, run.signals, slice(None), two, ENDS, SN, period=1.0)
    assert (found.s, found.span) == (4.0, pytest.approx(2 * 1e11 * 1e4 / 1e7, rel=1e-3))


def test_metrics():
    settings = MetricSettings(fatigue=SN, limits=Limits(breaking_load=1e6, bend_radius=2.0))
    run, half = waving(0.3, 2e5), waving(0.15, 2e5)
    summary, base = (summarise(r, scene(devices=()), settings) for r in (half, run))
    found = compute(summary, base, 0)
    assert found["use_breaking_load"] == pytest.approx(0.2)
    assert found["use_bend_radius"] == pytest.approx(0.3)
    assert found["fatigue_ratio"] == pytest.approx(1 / 8)
    assert found["fatigue_life"] == pytest.approx(10 / YEAR / found["fatigue_damage"])
    assert found["fatigue_use"] == pytest.approx(25 / found["fatigue_life"])
    assert (found["fatigue_s"], found["fatigue_error"]) == (2.0, pytest.approx(0.0, abs=1e-3))
    unasked = compute(summarise(run, scene(devices=()), MetricSettings()), base, 0)
    names = [name for name in found if name.startswith(("fatigue_", "use_"))]
    assert len(names) == 10
    assert all(math.isnan(unasked[name]) for name in names)
    still = summarise(response(np.zeros((len(T), 5)), T), scene(devices=()), settings)
    assert compute(still, still, 0)["fatigue_damage"] == 0.0
    assert math.isnan(compute(still, still, 0)["fatigue_life"])


def test_settings_in_a_study():
    curve = {"E": "1.1e11", "m": 3, "log_a": 12}
    loaded = parse_study(study(metrics={"fatigue": curve, "limits": {"breaking_load": 1e5}}))
    assert loaded.settings.fatigue == Fatigue(E=1.1e11, m=3.0, log_a=12.0)
    assert parse_study(study(objectives=["fatigue_use"], metrics={"fatigue": curve})).objectives == ("fatigue_use",)
    keys = {point_key(loaded.scene, loaded.ask, s) for s in (loaded.settings, MetricSettings())}
    assert len(keys) == 2
    bare = dataclasses.asdict(MetricSettings())
    del bare["fatigue"], bare["limits"]
    assert "fatigue" not in str(MetricSettings(**bare).fatigue)


SN3 = {"E": 1e11, "m": 3, "log_a": 12}


@pytest.mark.parametrize(
    ("metrics", "objectives", "says"),
    [
        ({}, ["fatigue_use"], "cannot be read without `metrics.fatigue`"),
        ({"limits": {"breaking_load": 1e5}}, ["use_bend_radius"], "without `metrics.limits.bend_radius`"),
        ({"fatigue": {"m": 3, "log_a": 12}}, ["delta"], "E"),
        ({"fatigue": {"E": 1e11, "m": 3}}, ["delta"], "needs `log_a`"),
        ({"fatigue": {"E": 1e11, "m": 3, "log_a": 12, "m2": 5}}, ["delta"], "belong together"),
        ({"fatigue": {"E": 1e11, "m": 3, "log_a": 12, "ductility": 0.1}}, ["delta"], "has no `ductility`"),
        ({"fatigue": SN3 | {"m": 5, "m2": 3, "knee": 1e7}}, ["delta"], "`m2: 3` must be at least `m`, 5"),
        ({"fatigue": SN3 | {"log_a": 400}}, ["delta"], "`log_a: 400` must be -100 to 100"),
        ({"fatigue": SN3 | {"m": 0.1, "m2": 1, "knee": 1e6}}, ["delta"], "at 1e+60 MPa"),
        ({"fatigue": {"E": 1e11, "m": 3, "log_a": 12, "knee_": 1}}, ["delta"], "knee"),
    ],
)
def test_mistakes(metrics, objectives, says):
    assert says in "\n".join(map(str, mistakes(study(metrics=metrics, objectives=objectives)).values()))
