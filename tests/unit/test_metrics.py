"""Metrics against signals whose integrals are known in closed form.

Tolerances: a trapezoid of step h on a smooth curve of time scale 1 is off by h^2/12 ~ 1e-7 at h = 1e-3; 1e-6
leaves room, and is far from the 1 % that wrong physics would show.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from study_kit import response, scene

from solvers import BNES, PointMass, Section, Status
from sweep.config import METRICS, MetricSettings, find_metric, split_name
from sweep.metrics import along, compute, count_jumps, metric_names, settling_index, span_mass, summarise

T = np.linspace(0, 5, 5001)
DECAY = np.exp(-T)
SHAPE = np.array([0.0, 1.0, 3.0, 2.0, 0.0])
NOTHING = scene(devices=())


def measured(x, base, settings=None, design=NOTHING, **signals):
    settings = settings or MetricSettings()
    run = summarise(response(x, T, **signals), design, settings)
    against = summarise(response(base, T), design, settings)
    return compute(run, against, len(design.devices))


def test_delta_and_gamma_are_ratios_of_squares():
    """Half the amplitude and twice the rate of decay: integrals of x^2 go by 1/4 1/2, of v^2 by 1/4 2."""
    x, base = np.outer(0.5 * DECAY**2, SHAPE), np.outer(DECAY, SHAPE)
    run = summarise(response(x, T, v=np.outer(-(DECAY**2), SHAPE)), NOTHING, MetricSettings())
    against = summarise(response(base, T, v=np.outer(-DECAY, SHAPE)), NOTHING, MetricSettings())
    found = compute(run, against, 0)
    tail = (1 - math.exp(-20)) / (1 - math.exp(-10))
    assert found["delta"] == pytest.approx(0.5 * tail, rel=1e-6)
    assert found["gamma"] == pytest.approx(1 - 0.125 * tail, rel=1e-6)
    assert found["rms_reduction"] == pytest.approx(1 - math.sqrt(0.125 * tail), rel=1e-6)


def test_curves_carry_mass_and_length():
    """Sum of squares 1 + 9 + 4 = 14 at nodes 1 m apart, 3 kg/m."""
    summary = summarise(
        response(np.outer(DECAY, SHAPE), T, v=np.outer(-DECAY, SHAPE)), NOTHING, MetricSettings()
    )
    assert summary.x2[0] == pytest.approx(14.0)
    assert summary.v2[0] == pytest.approx(42.0)
    assert compute(summary, summary, 0)["rms"] == pytest.approx(
        math.sqrt(14 * (1 - math.exp(-10)) / 2 / 5 / 4), rel=1e-6
    )


def test_ends_do_not_count():
    """An end that moves a metre adds nothing: only interior nodes do."""
    moved = SHAPE.copy()
    moved[-1] = 1.0
    found = measured(np.outer(DECAY, moved), np.outer(DECAY, SHAPE))
    assert found["gamma"] == pytest.approx(0.0, abs=1e-12)


def test_displacement_along_the_cable_does_not_count():
    still = response(np.zeros((len(T), 5)), T)
    still.signals["position"][:, :, 2] += np.outer(DECAY, SHAPE)
    still.signals["velocity"][:, :, 2] += np.outer(DECAY, SHAPE)
    summary = summarise(still, NOTHING, MetricSettings())
    assert summary.x2.max() < 1e-20
    assert summary.v2.max() < 1e-20


def test_displacement_is_normal_to_a_slanted_cable():
    """At 30 degrees from vertical a horizontal metre is cos 30 across the cable: 3/4 of the square."""
    tangent = np.tile([math.sin(math.pi / 6), 0.0, math.cos(math.pi / 6)], (5, 1))
    summary = summarise(
        response(np.outer(DECAY, SHAPE), T, static_tangent=tangent), NOTHING, MetricSettings()
    )
    assert summary.x2[0] == pytest.approx(14 * 0.75)


def test_rigid_rods_are_integrated_exactly():
    """A line x = s from 0 to 4 with a rod from 1 to 3: the rod's integral of s^2 is 26/3, mesh or no mesh."""
    arc = np.array([0.0, 1.0, 3.0, 4.0])
    field = np.zeros((1, 4, 3))
    field[0, :, 0] = arc
    total = along(field, np.diff(arc), np.array([False, True, False]))
    assert total[0] == pytest.approx(26 / 3 + 0.5 * 1 + 0.5 * 9)
    split = np.array([0.0, 1.0, 1.5, 2.4, 3.0, 4.0])
    field = np.zeros((1, 6, 3))
    field[0, :, 1] = split
    total = along(field, np.diff(split), np.array([False, True, True, True, False]))
    assert total[0] == pytest.approx(26 / 3 + 0.5 * 1 + 0.5 * 9)


def test_metrics_do_not_depend_on_the_mesh():
    """A half sine on 10, 20 and 40 segments."""
    found = []
    for n in (10, 20, 40):
        arc = np.linspace(0, 4, n + 1)
        x = np.outer(DECAY, np.sin(np.pi * arc / 4))
        found.append(summarise(response(x, T, arc=arc), NOTHING, MetricSettings()).x2[0])
    assert found == pytest.approx([2.0] * 3, rel=1e-12)  # the trapezoid is exact on a whole period of sin^2


def test_window_limits_the_integrals():
    settings = MetricSettings(window=(1.0, 2.0))
    x, base = np.outer(DECAY**2, SHAPE), np.outer(DECAY, SHAPE)
    found = measured(x, base, settings)
    expected = (math.exp(-4) - math.exp(-8)) / 4 / ((math.exp(-2) - math.exp(-4)) / 2)
    assert found["gamma"] == pytest.approx(1 - expected, rel=1e-5)


def test_rms_counts_from_the_end_of_the_pulse():
    """Before 0.5 s the design is ten times the baseline, afterwards half of it."""
    factor = np.where(T < 0.5 - 1e-9, 10.0, 0.5)
    found = measured(
        np.outer(factor * DECAY, SHAPE), np.outer(DECAY, SHAPE), MetricSettings(pulse_end=0.5, probe=2.5)
    )
    assert found["rms_reduction"] == pytest.approx(0.5, rel=1e-9)
    assert found["rms_probe_reduction"] == pytest.approx(0.5, rel=1e-9)
    probe = 0.5 * 2.5 * math.sqrt((math.exp(-1) - math.exp(-10)) / 2 / 4.5)
    assert found["rms_probe"] == pytest.approx(probe, rel=1e-6)


def test_no_probe_is_nan():
    found = measured(np.outer(DECAY, SHAPE), np.outer(DECAY, SHAPE))
    assert math.isnan(found["rms_probe"])
    assert math.isnan(found["rms_probe_reduction"])


def test_settling_times():
    """x^2 = exp(-2t): 90 % of its integral to 5 s is reached at -ln(0.1 + 0.9 exp(-10))/2."""
    found = measured(
        np.outer(DECAY, SHAPE),
        np.outer(np.ones_like(T), SHAPE),
        kinetic=0.25 * DECAY**2,
        strain=0.5 * DECAY**2,
        gravity=0.25 * DECAY**2,
    )
    assert found["t_settle"] == pytest.approx(-math.log(0.1 + 0.9 * math.exp(-10)) / 2, abs=1e-6)
    assert found["t_energy"] == pytest.approx(math.log(10) / 2, abs=1e-6)


def test_t_first_is_the_literal_definition_with_the_square():
    """Design exp(-t), baseline 1: G = 1 - (1 - exp(-2t))/(2t) = 0.9 at the root of 1 - exp(-2t) = 0.2 t."""
    found = measured(np.outer(DECAY, SHAPE), np.outer(np.ones_like(T), SHAPE))
    t = 5.0
    for _ in range(100):
        t = (1 - math.exp(-2 * t)) / 0.2
    assert t == pytest.approx(4.9998, abs=1e-3)
    assert found["t_first"] == pytest.approx(t, abs=1e-5)


def test_t_first_is_infinite_when_g_never_gets_there():
    found = measured(np.outer(DECAY, SHAPE), np.outer(DECAY, SHAPE))
    assert found["t_first"] == math.inf


def test_g_ends_at_gamma():
    settings = MetricSettings()
    run = summarise(response(np.outer(DECAY**2, SHAPE), T), NOTHING, settings)
    base = summarise(response(np.outer(DECAY, SHAPE), T), NOTHING, settings)
    index = settling_index(run, base)
    assert index[0] == 0.0
    assert index[-1] == pytest.approx(compute(run, base, 0)["gamma"], rel=1e-12)


def test_t_energy_is_nan_while_energy_stays():
    found = measured(np.outer(DECAY, SHAPE), np.outer(DECAY, SHAPE), kinetic=np.ones_like(T))
    assert math.isnan(found["t_energy"])


def test_end_forces():
    """3-4-5: top force 5 (1 + sin) has mean 5 and RMS 5/sqrt(2) about it."""
    wave = 1 + np.sin(2 * np.pi * T)
    force = np.zeros((len(T), 2, 3))
    force[:, 1, 0], force[:, 1, 2] = 3 * wave, 4 * wave
    force[:, 0, 2] = -2.0
    found = measured(np.outer(DECAY, SHAPE), np.outer(DECAY, SHAPE), end_force=force)
    assert found["peak_tension_top"] == pytest.approx(10.0, rel=1e-9)
    assert found["least_tension_top"] == pytest.approx(0.0, abs=1e-9)
    assert found["rms_tension_top"] == pytest.approx(5 / math.sqrt(2), rel=1e-6)
    assert found["peak_tension_bottom"] == pytest.approx(2.0)
    assert found["rms_tension_bottom"] == pytest.approx(0.0, abs=1e-12)


def test_energies_curvature_and_strain():
    curvature = np.zeros((len(T), 5))
    curvature[2000, 3] = -0.7
    found = measured(
        np.outer(DECAY, SHAPE),
        np.outer(DECAY, SHAPE),
        curvature=curvature,
        lost_device=3 * T,
        lost_water=T,
        lost_cable=0.5 * T,
        lost_seabed=0.5 * T,
    )
    assert found["peak_curvature"] == pytest.approx(0.7)
    assert (found["energy_device"], found["energy_water"], found["energy_cable"]) == pytest.approx(
        (15, 5, 2.5)
    )
    assert found["energy_share_device"] == pytest.approx(0.6)
    settings = MetricSettings()
    run = summarise(response(np.outer(DECAY, SHAPE), T, strain=2 * DECAY), NOTHING, settings)
    base = summarise(response(np.outer(DECAY, SHAPE), T, strain=5 * DECAY), NOTHING, settings)
    assert compute(run, base, 0)["strain_ratio"] == pytest.approx(0.4)


def test_strokes_and_jumps_of_each_device():
    devices = (
        BNES(s=1.0, mass=2.0, EA=1e6),
        PointMass(s=2.0, mass=1.0),
        BNES(s=3.0, mass=2.0, EA=1e6, phi0=6.0),
    )
    y0 = [device.rest_offset for device in (devices[0], devices[2])]
    y = np.zeros((len(T), 3))
    y[:, 0] = 1.2 * y0[0] * np.cos(np.pi * T)  # wells alternate: jumps at 1, 2, 3, 4, 5 s
    y[:, 2] = y0[1] * (1 + 0.3 * np.sin(np.pi * T))  # stays in its well
    found = measured(np.outer(DECAY, SHAPE), np.outer(DECAY, SHAPE), design=scene(devices=devices), stroke=y)
    assert [found["jumps"], found["jumps_1"], found["jumps_2"], found["jumps_3"]] == [5, 5, 0, 0]
    assert found["stroke_1"] == pytest.approx(2.4 * y0[0])
    assert found["stroke_2"] == 0
    assert found["stroke_3"] == pytest.approx(0.6 * y0[1], rel=1e-6)
    assert found["stroke"] == found["stroke_1"]


def test_a_jump_needs_the_far_wall():
    """To -0.99 y0 and back is no jump; to -y0 is one, and coming back another."""
    y0, up = 0.03, np.linspace(0, 1, 101)

    def swing(depth):
        down = 1 - (1 + depth) * (1 - np.cos(np.pi * up)) / 2
        return y0 * np.concatenate([down, down[::-1], [1.01, 1.02]])

    assert count_jumps(swing(0.99), y0) == 0
    assert count_jumps(swing(1.01), y0) == 2
    assert count_jumps(np.full(10, 0.05), 0.0) == 0


def test_bounces_between_samples_are_found():
    """A mass at constant speed between its walls, thrown back at once, touches them between samples."""
    y0, period = 0.031, 0.1707
    t = np.arange(0, 5, 1e-3)
    y = y0 * (1 - 4 * np.abs((t / period) % 1 - 0.5) * 1.0) * -1  # triangle wave from +y0 at t = 0
    assert np.abs(y[1:]).max() < y0
    assert count_jumps(y, y0) == int(5 / (period / 2))


def test_jumps_count_within_the_window():
    y = 0.04 * np.cos(np.pi * T)[:, None]
    design = scene()
    found = measured(
        np.outer(DECAY, SHAPE),
        np.outer(DECAY, SHAPE),
        MetricSettings(window=(2.5, 5.0)),
        design=design,
        stroke=y,
    )
    assert found["jumps"] == 3


def test_spread_masses_do_not_count():
    """Baseline `uniform` runs a heavier cable; the mass of the plain one counts."""
    plain = (Section(length=2.0, d=0.1, mass=3.0, EA=1e6), Section(length=2.0, d=0.1, mass=5.0, EA=1e6))
    assert span_mass(np.array([0.0, 1.0, 2.5, 4.0]), plain) == pytest.approx([3.0, 3 + 2.5, 7.5])
    heavy = response(np.outer(DECAY, SHAPE), T, v=np.outer(DECAY, SHAPE), mass=10.0)
    summary = summarise(heavy, NOTHING, MetricSettings(), NOTHING.cable)
    assert summary.v2[0] == pytest.approx(42.0)


@pytest.mark.parametrize("status", [Status.DIVERGED, Status.NO_STATIC, Status.TOO_MANY_STEPS])
def test_failed_runs_have_no_metrics(status):
    assert summarise(response(np.outer(DECAY, SHAPE), T, status=status), NOTHING, MetricSettings()) is None
    found = compute(None, None, 2)
    assert set(found) == set(metric_names(2))
    assert all(math.isnan(value) for value in found.values())


def test_a_run_that_ends_before_the_window_has_no_metrics():
    short = response(np.outer(DECAY, SHAPE)[:100], T[:100])
    assert summarise(short, NOTHING, MetricSettings(window=(0, 5))) is None


def test_without_a_baseline_only_ratios_are_missing():
    run = summarise(response(np.outer(DECAY, SHAPE), T), NOTHING, MetricSettings())
    found = compute(run, None, 0)
    for name in ("delta", "gamma", "strain_ratio", "t_first", "rms_reduction"):
        assert math.isnan(found[name])
    assert found["t_settle"] > 0
    assert found["rms"] > 0


def test_every_metric_is_described():
    for name, entry in METRICS.items():
        assert name == entry.name
        assert entry.direction in ("min", "max", None)
        assert entry.unit
        assert entry.definition
    assert find_metric("stroke_2") is METRICS["stroke"]
    assert find_metric("stroke_3", devices=2) is None
    assert find_metric("gamma_worst") is METRICS["gamma"]
    assert find_metric("delta_spread") is METRICS["delta"]
    assert find_metric("delta_ensemble_worst") is METRICS["delta"]
    names = ("delta", "gamma_ensemble", "stroke_2_mean")
    assert [split_name(name)[0] for name in names] == ["delta", "gamma", "stroke_2"]
    assert find_metric("delta_2") is None
