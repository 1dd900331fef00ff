"""Designs, keys and baseline scenes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from study_kit import scene
from test_config import GOOD, study

from solvers import BNES, Ask, PointMass
from sweep.config import MetricSettings, parse_study
from sweep.fields import SCENE, bind, dump
from sweep.space import baseline_scene, design_scene, designs, point_key, points


def sampled(**sampler):
    return designs(parse_study(study(sampler=sampler)))


@pytest.mark.parametrize("kind", ["sobol", "random"])
def test_a_longer_study_begins_with_the_shorter(kind):
    assert sampled(kind=kind, n=37, seed=5)[:11] == sampled(kind=kind, n=11, seed=5)
    assert sampled(kind=kind, n=4, seed=5) != sampled(kind=kind, n=4, seed=6)


@pytest.mark.parametrize("kind", ["sobol", "random", "lhs"])
def test_samples_fill_the_range_in_the_right_measure(kind):
    """Half of the designs lie below the geometric middle of a log range; same seed, same designs."""
    found = sampled(kind=kind, n=512, seed=2)
    stiff = np.array([values["stiff"] for values in found])
    k = np.array([values["devices[1].k"] for values in found])
    assert stiff.min() >= 1e4
    assert stiff.max() <= 5e10
    assert np.mean(stiff < np.sqrt(1e4 * 5e10)) == pytest.approx(0.5, abs=0.05)
    assert np.mean(k < 105) == pytest.approx(0.5, abs=0.05)
    assert found == sampled(kind=kind, n=512, seed=2)


def test_latin_hypercube_has_one_design_in_each_stratum():
    k = np.array([values["devices[1].k"] for values in sampled(kind="lhs", n=64, seed=0)])
    assert sorted(((k - 10) / 190 * 64).astype(int)) == list(range(64))


def test_grid():
    found = sampled(kind="grid", n=3, levels={"stiff": 2})
    assert len(found) == 6
    assert sorted({values["stiff"] for values in found}) == [1e4, 5e10]
    assert sorted({values["devices[1].k"] for values in found}) == [10, 105, 200]


def test_values_are_taken_as_they_are():
    raw = study(variables={"stiff": {"field": "devices[0].EA", "values": [1e5, "1e7", 3e6]}}, tied={})
    raw["sampler"] = {"kind": "grid"}
    assert [values["stiff"] for values in designs(parse_study(raw))] == [1e5, 1e7, 3e6]
    raw["sampler"] = {"kind": "random", "n": 50}
    assert {values["stiff"] for values in designs(parse_study(raw))} == {1e5, 1e7, 3e6}


def test_no_variables_make_one_design():
    found = list(points(parse_study(study(variables={}, tied={}, sampler=None))))
    assert [(point.design, point.environment, point.values) for point in found] == [(0, 0, {})]


def test_limit_is_a_prefix():
    whole = parse_study(GOOD)
    assert [point.key for point in points(whole, 3)] == [point.key for point in points(whole)][:3]


def test_designs_reach_the_scene():
    raw = study(
        variables__stiff={"field": ["devices[0].EA", "cable[0].EA"], "log": [1e4, 1e8]},
        environments=[
            {"name": "a"},
            {"name": "b", "set": {"cable[0].d": 0.2, "end_b.position": [0, 1, -10]}},
        ],
    )
    found = design_scene(parse_study(raw), {"stiff": 4.5e6, "devices[1].k": 50.0}, 1)
    assert found.devices[0].EA == found.cable[0].EA == 4.5e6
    assert found.devices[0].BA == pytest.approx(np.sqrt(0.002 * 4.5e6))
    assert found.devices[1].k == 50
    assert found.cable[0].d == 0.2
    assert found.end_b.position == (0, 1, -10)
    assert len({point.key for point in points(parse_study(raw))}) == 16


def test_whole_numbers_stay_whole():
    found = bind(scene(), {"devices[0].side": -1.0})
    assert found.devices[0].side == -1


# --------------------------------------------------------------------------- keys


def key(**changes):
    tree = dump(scene()) | changes
    return point_key(SCENE.validate_python(tree), Ask(duration=5.0))


def test_equal_physics_has_equal_keys():
    cable = dump(scene())["cable"][0]
    spellings = [1e6, 1000000, "1e6", "1000000.0"]
    assert len({key(cable=[cable | {"EA": value}]) for value in spellings}) == 1
    end = dump(scene())["end_a"]
    assert key(end_a=end | {"position": [-0.0, 0, -10]}) == key(end_a=end | {"position": [0, 0.0, "-1e1"]})
    assert key(name="one") == key(name="another")
    assert len(key()) == 16


def test_different_physics_has_different_keys():
    base = scene()
    scenes = [
        base,
        bind(base, {"cable[0].EA": 1e6 * (1 + 1e-15)}),
        bind(base, {"devices[0].side": -1}),
        bind(base, {"devices[0].rod": "cords"}),
        bind(base, {"devices": []}),
        bind(base, {"g": 9.81}),
    ]
    asks = [Ask(duration=5.0), Ask(duration=5.0, segments=40), Ask(duration=5.0, model="lumped"),
            Ask(duration=5.0, mass_scaling=4.0)]  # fmt: skip
    settings = [None, MetricSettings(), MetricSettings(pulse_end=0.5), MetricSettings(repeats=2)]
    found = {point_key(s, asks[0], settings[0]) for s in scenes}
    found |= {point_key(base, a, settings[0]) for a in asks}
    found |= {point_key(base, asks[0], m) for m in settings}
    assert len(found) == len(scenes) + len(asks) - 1 + len(settings) - 1


def test_a_key_is_the_same_tomorrow():
    """A pinned value: a change of the recipe orphans every finished row, and must be meant."""
    assert key() == "a8c7ae3a13afc394"


def test_objectives_count_only_with_repeats():
    ask = Ask(duration=1.0)
    one, two = MetricSettings(objectives=("delta",)), MetricSettings(objectives=("gamma",))
    assert point_key(scene(), ask, one) == point_key(scene(), ask, two)
    one, two = (dataclasses.replace(s, repeats=3) for s in (one, two))
    assert point_key(scene(), ask, one) != point_key(scene(), ask, two)


# --------------------------------------------------------------------------- baselines


DEVICES = (
    BNES(s=1.0, mass=2.0, EA=1e6, phi0=3.0, length=0.3, rod="cords", rod_EA=5e6, drag=0.1, added_mass=0.4),
    PointMass(kind="buoy", s=2.0, mass=1.0, volume=0.003),
    BNES(s=3.0, mass=4.0, EA=1e7),
)


def test_plain():
    assert baseline_scene(scene(DEVICES), "plain") == scene(())


def test_locked_keeps_masses_where_they_are():
    found = baseline_scene(scene(DEVICES), "locked").devices
    assert [(d.s, d.mass) for d in found] == [(1, 2), (2, 1), (3, 4)]
    assert [d.kind for d in found] == ["locked", "buoy", "locked"]
    assert [d.rod for d in found] == [None, None, None]
    assert (found[0].drag, found[0].added_mass) == (0.1, 0.4)


def test_rod_locked_keeps_rods_too():
    found = baseline_scene(scene(DEVICES), "rod_locked").devices
    assert [d.rod_length for d in found] == pytest.approx([0.6 * np.cos(np.radians(3)), 0, 0])
    assert found[0].rod_EA == 5e6


def test_a_baseline_forgets_the_cords():
    stiff = bind(scene(DEVICES), {"devices[0].EA": 1e9, "devices[0].BA": 3.0, "devices[2].side": -1})
    for name in ("plain", "uniform", "locked", "rod_locked"):
        assert baseline_scene(stiff, name) == baseline_scene(scene(DEVICES), name)


def test_uniform_keeps_mass_and_weight():
    """7 kg on 4 m; the sinks are neutrally buoyant, the buoy lifts 2 kg: -0.5 kg/m of net weight."""
    found = baseline_scene(scene(DEVICES), "uniform")
    (loaded,), (bare,) = found.cable, scene().cable
    assert found.devices == ()
    assert loaded.mass == pytest.approx(bare.mass + 7 / 4)
    bare_weight = (3.0 - 1000 * np.pi / 4 * 0.01) * 9.80665
    assert bare.wet(1000, 9.80665) == pytest.approx(bare_weight)
    assert loaded.wet(1000, 9.80665) == pytest.approx(bare_weight - 0.5 * 9.80665)
    assert loaded.volume is None


def test_unknown_baseline():
    with pytest.raises(ValueError, match="uniform, locked, rod_locked, plain"):
        baseline_scene(scene(), "none")
