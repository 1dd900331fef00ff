"""Studies of rods, catenaries and hybrids: fields of the ask, keys, metrics of shape and moments, profiles."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from study_kit import response, scene
from test_config import mistakes, one, study

from solvers import Ask
from sweep.config import MetricSettings, parse_study, study_schema
from sweep.evaluate import baseline_ask, clear_baselines, evaluate, evaluate_with_series
from sweep.fields import SCENE, dump
from sweep.histories import plot_profile
from sweep.metrics import angles_turned, compute, depth, gauss_writhe, off_plane, summarise
from sweep.plan import make_plan
from sweep.point import Point
from sweep.series import at_last, point_label, reduce
from sweep.space import baseline_model, baseline_scene, design_ask, point_key, points

EVALUATOR = importlib.import_module("sweep.evaluate")  # `sweep.evaluate` is the function


def hybrid(**changes):
    """The study of test_config, as a hybrid with a varied joint; nothing of it is run."""
    raw = study(ask={"duration": 0.0, "model": "hybrid", "rods": [[1.0, 2.0], [8.0, 10.0]]})
    raw["variables"] = {"joint": {"field": "ask.rods[1][0]", "linear": [5.0, 9.0]}}
    raw |= {"tied": {}, "sampler": {"kind": "grid", "n": 3}, "metrics": {}, "objectives": ["rod_share", "sag"]}
    for path, value in changes.items():
        head, last = path.split("__") if "__" in path else (None, path)
        (raw if head is None else raw[head])[last] = value
    return raw


# --------------------------------------------------------------------------- the ask in a study


def test_a_variable_may_set_a_field_of_the_ask():
    found = list(points(parse_study(hybrid())))
    assert [point.ask.rods for point in found] == [((1.0, 2.0), (s, 10.0)) for s in (5.0, 7.0, 9.0)]
    assert len({point.key for point in found}) == 3
    assert {point.scene for point in found} == {found[0].scene}


def test_an_environment_may_set_a_field_of_the_ask():
    raw = hybrid(environments=[{"name": "coarse", "set": {"ask.segments": 20.0}}, {"name": "whole", "set": {
        "ask.model": "rod", "ask.rods": None}}], variables={})  # fmt: skip
    raw.pop("sampler")
    coarse, whole = (point.ask for point in points(parse_study(raw)))
    assert (coarse.model, coarse.segments, type(coarse.segments)) == ("hybrid", 20, int)
    assert (whole.model, whole.rods) == ("rod", None)
    assert design_ask(parse_study(study()), {"stiff": 1e5, "devices[1].k": 50.0}) == parse_study(study()).ask


def test_the_schema_knows_the_new_fields():
    schema = study_schema()
    assert {"rods", "rho_space"} <= set(schema["$defs"]["AskSection"]["properties"])
    assert {"EI2", "GJ", "coupling", "curvature", "moment", "inertia"} <= set(schema["$defs"]["Section"]["properties"])
    assert {"moment", "twist"} <= set(schema["$defs"]["End"]["properties"])


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"ask__rods": [[2.0, 1.0]], "variables": {}}, "ask.rods", "in order and apart; write e.g."),
        ({"ask__rods": [[1.0, 3.0], [2.0, 4.0]], "variables": {}}, "ask.rods", "in order and apart"),
        ({"ask__rods": [[-1.0, 3.0]], "variables": {}}, "ask.rods[0][0]", "0"),
        ({"ask__rods": [[1.0, 30.0]], "variables": {}}, "ask.rods[0][1]", "should be on the cable, 0 to 10 m"),
        ({"ask__rods": 3.0, "variables": {}}, "ask.rods", "list"),
        ({"ask__model": "rod"}, "ask.rods", "only a hybrid has rods in places, not `rod`; write `model: hybrid`"),
        ({"ask__rho_space": 2.0}, "ask.rho_space", "1"),
        ({"ask__rho_space": 0.5, "ask__duration": 1.0}, "ask.rho_space", "or write `duration: 0`"),
        ({"variables": {"joint": {"field": "ask.rod", "linear": [5, 9]}}}, "variables.joint.field", "`rods`"),
        ({"variables": {"joint": {"field": "ask.rods[2][0]", "linear": [5, 9]}}}, "variables.joint.field", "0 to 1"),
        ({"variables": {"joint": {"field": "ask.rods[1][0]", "linear": [5, 12]}}}, "variables.joint.linear[1]",
         "ask.rods: `rods` must be stretches"),
        ({"variables": {"joint": {"field": "ask.rods[1][1]", "linear": [9, 12]}}}, "variables.joint.linear[1]",
         "should be on the cable"),
        ({"environments": [{"name": "far", "set": {"ask.rods": [[3.0, 2.0], [8.0, 10.0]]}}], "variables": {}},
         "environments[0].set.ask.rods", "in order and apart"),
    ],
)  # fmt: skip
def test_mistakes_in_rods_are_named(changes, path, words):
    assert words in one(hybrid(**changes), path)


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"scene__end_a__direction": [0, 0, 1]}, "scene.end_a.direction", "a pinned end has no `direction`"),
        ({"scene__end_a__twist": 30.0}, "scene.end_a.twist", "needs a `direction` to turn about"),
        ({"scene__end_a": {"kind": "clamped", "position": [0, 0, -20], "direction": [0, 0, 1], "moment": [1, 0, 0]}},
         "scene.end_a.moment", "does nothing; remove it"),
        ({"scene__end_a": {"kind": "clamped", "position": [0, 0, -20]}}, "scene.end_a.direction", "[x, y, z]"),
        ({"scene__cable__0__coupling": 1e6}, "scene.cable[0].coupling", "release energy; lower it"),
        ({"scene__cable__0__EI": 0.0, "scene__cable__0__GJ": 10.0}, "scene.cable[0].EI", "above 0; give the bending"),
        ({"ask__rho_space": 0.5}, "ask.rho_space", "not in `auto`; remove it"),
    ],
)  # fmt: skip
def test_mistakes_in_what_rods_need_are_named(changes, path, words):
    assert words in one(study(**changes), path)


def test_mistakes_in_scene_and_ask_come_together():
    raw = hybrid(ask__rods=[[2.0, 1.0]], ask__accuracy=2.0, variables={})
    raw["scene"]["end_a"]["twist"] = 5.0
    assert set(mistakes(raw)) == {"ask.rods", "ask.accuracy", "scene.end_a.twist"}


# --------------------------------------------------------------------------- keys, baselines


def test_fields_at_their_defaults_do_not_change_a_key():
    ask, plain = Ask(duration=5.0), point_key(scene(), Ask(duration=5.0))
    tree = dump(scene())
    section = {"coupling": 0, "curvature": [0, 0, -0.0], "moment": [0, 0, 0]}
    tree["cable"][0] |= section
    tree["end_a"]["twist"] = 0
    assert point_key(SCENE.validate_python(tree), replace(ask, rho_space=1.0, rods=None)) == plain
    asked = [replace(ask, rho_space=0.5), replace(ask, rods=()), replace(ask, rods=((1.0, 2.0),))]
    tree["cable"][0] |= {"curvature": [0, 0, 0.1]}
    turned = dump(scene())
    turned["end_a"] |= {"kind": "clamped", "direction": [0, 0, 1], "twist": 10.0}
    scenes = [SCENE.validate_python(tree), SCENE.validate_python(turned)]
    assert len({plain, *(point_key(scene(), a) for a in asked), *(point_key(s, ask) for s in scenes)}) == 6


def test_the_full_rod_is_another_line_of_the_same_scene():
    scaled = Ask(duration=1.0, model="transverse", mass_scaling=3.6)
    assert baseline_model(scaled, "full_rod") == Ask(duration=1.0, model="rod")
    assert baseline_model(scaled, "plain") == scaled
    ask = Ask(model="hybrid", rods=((0.0, 2.0),))
    found = baseline_ask(ask, response(np.zeros((1, 5)), [0.0, 1.0][:1], v=np.zeros((1, 5))), "full_rod")
    assert (found.model, found.rods) == ("rod", None)
    assert baseline_scene(scene(), "full_rod") == scene()
    plan = make_plan(parse_study(hybrid(metrics={"baseline": "full_rod"})))
    assert [(base["name"], base["points"]) for base in plan.baselines] == [("full_rod", 3)]


# --------------------------------------------------------------------------- metrics

ARC = np.linspace(0, 4, 41)
U = ARC / 2 - 1


def sagging(model="hybrid", low=1.0, torque=0.0):
    """A parabola of the given depth from (0, 0, 0) to (4, 0, 0), rod from s = 2 m on, at rest."""
    n = len(ARC)
    x = np.stack([ARC, 0 * ARC, low * (U**2 - 1)], axis=1)[None]
    moment = np.zeros((1, n, 3))
    moment[0, :, 1] = np.where(ARC >= 2, -0.3 * (ARC - 2), 0.0)  # hollow upwards in the plane of x and z
    moment[0, :, 0] = torque
    force = np.zeros((1, n, 3))
    force[0, :, 0], force[0, -1] = 5.0, (3.0, 0.0, 4.0)
    shear = np.zeros((1, n))
    shear[0, -1] = 4.0
    found = response(np.zeros((1, n)), [0.0], arc=ARC, v=np.zeros((1, n)), position=x, moment=moment, force=force,
                     shear=shear, torque=np.full((1, n), -torque), twist=np.full((1, n), -0.2),
                     tension=np.full((1, n - 1), 5.0 * low),
                     domain=(np.arange(n - 1) >= 20)[None].astype(float))  # fmt: skip
    return replace(found, model=model, method="trbdf2")


def test_metrics_of_a_static_rod():
    settings = MetricSettings()
    run, base = (summarise(sagging(low=low, torque=0.4), scene(()), settings) for low in (1.0, 1.1))
    found = compute(run, base, 0)
    wanted = {
        "sag": 1.0, "out_of_plane": 0.0, "peak_moment": 0.6, "end_moment_top": math.hypot(0.6, 0.4),
        "end_moment_bottom": 0.4, "peak_torque": 0.4, "peak_twist": 0.2, "rod_share": 0.5, "writhe": 0.0,
        "turning": 2 * math.atan(0.975), "shape_error": 0.1, "tension_error": 0.5 / 5.5, "moment_error": 0.0,
        "peak_tension_top": 3.0, "peak_tension_bottom": 5.0,
    }  # fmt: skip
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    for name in ("delta", "rms", "t_settle", "rms_tension_top"):
        assert math.isnan(found[name])


def test_lines_without_moments_have_none():
    run = summarise(response(np.zeros((1, 5)), [0.0], v=np.zeros((1, 5))), scene(()), MetricSettings())
    found = compute(run, run, 0)
    for name in ("peak_moment", "end_moment_top", "end_moment_bottom", "peak_torque", "peak_twist", "rod_share"):
        assert math.isnan(found[name]), name
    assert math.isnan(found["out_of_plane"])  # its ends are one above the other
    assert found["turning"] == pytest.approx(0.0, abs=1e-7)
    assert (found["sag"], found["tension_error"]) == (0.0, 0.0)


def test_depth_is_that_of_the_curve_between_nodes():
    """A parabola is met exactly wherever its nodes lie."""
    for shift in (0.0, 0.013, 0.04):
        s = np.linspace(0, 2, 12) ** 1.1
        x = np.stack([s, 0 * s, (s - 1 - shift) ** 2], axis=1)
        assert depth(x, s) == pytest.approx((1 + shift) ** 2, rel=1e-12)
    assert depth(-x[:, ::-1], s) == pytest.approx(2**1.1)  # falls all the way


def test_loops():
    """A helix of one turn of radius 1 and a given pitch, between straight ends along its axis' direction."""
    u = np.linspace(0, 2 * np.pi, 801)
    coil = np.stack([np.cos(u), np.sin(u), 0.02 * u], axis=1)
    assert angles_turned(coil[None])[0] == pytest.approx(2 * np.pi, rel=5e-3)
    assert gauss_writhe(coil * (1, 1, 0)) == 0.0
    far = np.array([0.0, 200.0, 0.0])
    hockle = np.concatenate([[coil[0] - far], coil, [coil[-1] + far]])  # comes and goes along y: crosses itself once
    found = gauss_writhe(hockle)
    assert abs(found) == pytest.approx(1.0, abs=0.05)
    assert gauss_writhe(hockle * (1, 1, -1)) == pytest.approx(-found, rel=1e-9)  # its mirror image
    assert gauss_writhe(hockle[::-1]) == pytest.approx(found, rel=1e-9)


def test_distance_from_the_plane_turns_with_the_ends():
    x = np.array([[0.0, 0, 0], [1, 0.5, -1], [2, 0, 0]])
    c, s = math.cos(0.7), math.sin(0.7)
    turned = x @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    assert off_plane(np.stack([x, turned])) == pytest.approx(0.5)
    assert math.isnan(off_plane(np.array([[[0.0, 0, 0], [1, 0, 1], [0, 0, 2]]])))


def point(model="hybrid", **settings):
    ask, chosen = Ask(model=model), MetricSettings(**settings)
    return Point(key=point_key(scene(()), ask, chosen), design=0, environment=0, values={"joint": 1.25},
                 scene=scene(()), ask=ask, settings=chosen)  # fmt: skip


@pytest.fixture
def solved(monkeypatch):
    """A static solver whose full rod hangs a tenth deeper."""

    def solve(scene, ask):
        return sagging(ask.model, 1.1 if ask.model == "rod" else 1.0)

    monkeypatch.setattr(EVALUATOR, "solve", solve)
    clear_baselines()
    yield
    clear_baselines()


def test_a_static_point_has_a_row(solved):
    found = evaluate(point(baseline="full_rod"))
    assert (found.status, found.model) == ("OK", "hybrid")
    assert found.metrics["shape_error"] == pytest.approx(0.1)
    assert found.metrics["energy_water"] == 0.0
    assert evaluate(point(baseline="plain")).metrics["shape_error"] == 0.0  # it is its own baseline
    assert evaluate(point("rod", baseline="full_rod")).metrics["shape_error"] == 0.0


# --------------------------------------------------------------------------- profiles


def profiles(**attrs):
    """What `profile_of` makes of the made-up line and two others."""
    raw = xr.Dataset()
    signals = sagging().signals
    dims = {40: "segment", 41: "node", 3: "axis", 1: "time"}
    for name in ("arc", "position", "tension", "shear", "moment", "torque", "force", "domain"):
        raw[name] = (tuple(dims[n] for n in signals[name].shape), signals[name])
    found = xr.Dataset(at_last(raw, "", ""), attrs={"values": "joint = 2", "model": "hybrid", "status": "OK"} | attrs)
    found = found.merge(xr.Dataset(at_last(raw.drop_vars("domain"), "", "baseline_")))
    return found.assign_attrs(found.attrs | {"baseline": "full_rod"})


def test_a_profile_has_signs_in_a_plane():
    found = profiles()
    assert found["last_moment"].values[-1] == pytest.approx(0.6)  # hollow upwards
    assert found["last_shear"].values[-1] == pytest.approx(4.0)  # the part beyond pulls upwards
    assert found["last_away"].values[-1] == 4.0
    assert found["last_height"].values.min() == -1.0
    assert "baseline_last_moment" not in found


def test_a_figure_of_a_profile():
    found = profiles()
    figure = plot_profile(found, Figure(layout="constrained"))
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "height above end A [m]", "tension [N]", "shear [N]", "bending moment [N m]"]  # fmt: skip
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["rod (joint = 2, hybrid)", "catenary (joint = 2, hybrid)",
                     "baseline `full_rod`: a rod from end to end"]  # fmt: skip
    lines = {line.get_color(): line for line in figure.axes[3].lines}
    assert lines["#1a1a1a"].get_linewidth() > lines["#D55E00"].get_linewidth()
    assert not np.any(lines["#D55E00"].get_ydata())


def test_a_line_without_moments_has_two_panels():
    found = profiles().drop_vars(["last_shear", "last_moment", "last_domain"])
    figure = plot_profile(found, Figure(layout="constrained"))
    assert len(figure.axes) == 2
    assert figure.legends[0].get_texts()[0].get_text() == "line (joint = 2, hybrid)"


def test_series_of_a_static_point_hold_its_profile(solved):
    here = point(baseline="full_rod")
    record, raw = evaluate_with_series(here)
    found = reduce(raw, here, record)
    assert found["last_height"].values.min() == -1.0
    assert found["baseline_last_height"].values.min() == -1.1
    assert point_label(found) == "joint = 1.25, hybrid"
