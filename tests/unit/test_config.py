"""Reading a study: what is understood, and that every mistake is found and said in the user's words."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import yaml

import sweep  # noqa: F401  (fills the table of metrics)
from sweep.config import load_scene, load_study, parse_study, study_schema
from sweep.fields import Expression, FieldError, lookup, parse
from sweep.mistakes import ConfigError

CONFIGS = Path(__file__).parents[2] / "configs"

GOOD = yaml.safe_load("""
name: small
scene:
  cable: [{length: 10, d: 0.1, mass: 10, EA: 1e6, EI: 100}]
  end_a: {kind: pinned, position: [0, 0, -20]}
  end_b: {kind: pinned, position: [0, 0, -10]}
  water: {density: 1025}
  devices:
    - {kind: bnes, s: 3, mass: 2, EA: 1e6, BA: 44.7}
    - {kind: tmd, s: 6, mass: 2, k: 100}
variables:
  stiff: {field: "devices[0].EA", log: [1e4, 5e10]}
  devices[1].k: {linear: [10, 200]}
tied: {"devices[0].BA": "sqrt(0.002 * stiff)", "devices[1].c": "devices[1].k / 100"}
sampler: {kind: sobol, n: 8, seed: 1}
ask: {duration: 2.0, segments: 20}
metrics: {pulse_end: 0.5}
objectives: [delta, gamma]
""")


def study(**changes):
    raw = copy.deepcopy(GOOD)
    for path, value in changes.items():
        *head, last = path.split("__")
        here = raw
        for part in head:
            here = here[int(part)] if part.isdigit() else here[part]
        here[int(last) if isinstance(here, list) else last] = value
    return raw


def mistakes(raw):
    with pytest.raises(ConfigError) as caught:
        parse_study(raw)
    text = str(caught.value)
    assert "pydantic" not in text
    assert "Traceback" not in text
    return {mistake.path: mistake for mistake in caught.value.mistakes}


def one(raw, path):
    found = mistakes(raw)
    assert list(found) == [path], found
    return str(found[path])


# --------------------------------------------------------------------------- good ones


def test_a_good_study():
    found = parse_study(GOOD)
    assert found.scene.cable[0].EA == 1e6  # PyYAML reads 1e6 as text
    assert found.variables["stiff"].log == (1e4, 5e10)
    assert found.ask.segments == 20
    assert found.settings.baseline == "locked"
    assert [environment.name for environment in found.environments] == ["default"]
    assert found.assignments({"stiff": 5e8, "devices[1].k": 50.0}) == pytest.approx(
        {"devices[0].EA": 5e8, "devices[1].k": 50.0, "devices[0].BA": 1000.0, "devices[1].c": 0.5}
    )


def test_the_kept_text_is_the_study():
    found = parse_study(GOOD)
    again = parse_study(yaml.safe_load(found.text))
    assert again.scene == found.scene
    assert again.text == found.text


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_study_loads(path):
    found = load_study(path)
    assert found.name == path.stem
    lines = path.read_text().splitlines()
    assert [line.split(":")[0] for line in lines[:3]] == ["# Question", "# Command", "# Expected"]
    assert f"configs/{path.name}" in lines[1]


@pytest.mark.parametrize("path", sorted((CONFIGS / "scenes").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_scene_loads(path):
    assert load_scene(path).length > 0


def test_the_study_scene_is_the_papers():
    """The default scene: 88.93 kg, 500 N, masses of 4.5, 3.4, 4.5, 4.5 %, 0.08 kg/m wet."""
    scene = load_study(CONFIGS / "bnes_study.yaml").scene
    (cable,) = scene.cable
    assert cable.length * cable.mass == pytest.approx(88.93, abs=0.005)
    stretch = (scene.end_b.position[2] - scene.end_a.position[2]) / cable.length - 1
    assert cable.EA * stretch == pytest.approx(500.0, rel=1e-6)
    assert cable.mass - 1025 * 3.14159265 / 4 * cable.d**2 == pytest.approx(0.08, abs=0.001)
    assert [1 - device.s / cable.length for device in scene.devices] == pytest.approx(
        [0.10, 0.37, 0.63, 0.90]
    )
    assert [device.mass for device in scene.devices] == [4, 3, 4, 4]
    assert [device.BA / (0.002 * device.EA) ** 0.5 for device in scene.devices] == pytest.approx(
        [1] * 4, rel=1e-3
    )
    assert [device.rod_length for device in scene.devices] == pytest.approx([0.998068] * 4, rel=1e-6)
    assert scene.devices[0].rest_offset == pytest.approx(0.03106, abs=1e-5)


def test_includes_merge(tmp_path):
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "a.yaml").write_text(yaml.safe_dump(GOOD["scene"]))
    raw = study(
        scene={"include": "scenes/a.yaml", "water": {"depth": 30}, "devices": GOOD["scene"]["devices"][:1]}
    )
    raw |= {"variables": {}, "tied": {}}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(raw))
    found = load_study(tmp_path / "s.yaml")
    assert (found.scene.water.density, found.scene.water.depth) == (1025, 30)
    assert len(found.scene.devices) == 1
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(raw | {"scene": "scenes/a.yaml"}))
    assert len(load_study(tmp_path / "s.yaml").scene.devices) == 2


def test_schema_for_editors():
    schema = study_schema()
    assert set(schema["properties"]) >= {"scene", "variables", "sampler", "ask", "metrics", "objectives"}


# --------------------------------------------------------------------------- all mistakes at once


def test_all_mistakes_at_once():
    raw = study(
        smapler={},
        scene__cable__0__d=-1,
        scene__devices__0__EAA=3,
        scene__end_a__kind="pined",
        variables__stiff={"log": [0, 5]},
        ask__duration="long",
        metrics__baseline="lokced",
        objectives=["delta", "gama"],
        repeats={"n": -1},
        time_limit=0,
    )
    found = mistakes(raw)
    assert set(found) == {
        "smapler",
        "scene.cable[0].d",
        "scene.devices[0].EAA",
        "scene.end_a.kind",
        "variables.stiff.log[0]",
        "variables.stiff",
        "ask.duration",
        "metrics.baseline",
        "objectives[1]",
        "repeats.n",
        "time_limit",
    }
    assert "greater than 0" in str(found["scene.cable[0].d"])
    assert "-1" in str(found["scene.cable[0].d"])
    for path, word in {
        "smapler": "sampler",
        "scene.devices[0].EAA": "EA",
        "scene.end_a.kind": "pinned",
        "metrics.baseline": "locked",
        "objectives[1]": "gamma",
    }.items():
        assert f"did you mean `{word}`?" in found[path].remedy
    assert "11 mistakes" in str(ConfigError(found.values()))


WRONG = """
nme: dozens
scene:
  cable: [{length: 10, d: -0.1, mass: 10, EA: 1e6, EI: 100}]
  end_a: {kind: clamped, position: [0, x, -20]}
  end_b: {kind: pinned, position: [0, 0, -10], force: [1, 0, 0]}
  watr: {density: -5}
  devices:
    - {kind: bnes, s: 3, mass: 2, EA: 1e6, BAA: 44.7}
    - {kind: tmd, s: 60, mass: 2, k: 100}
    - {kind: bnse, s: 5, mass: 2, EEA: 1e6}
    - {s: 7, mass: 2}
environments:
  - {name: a, set: {"cable[0].dd": 1}}
  - {name: a, set: {"cable[0].mass": -1, "water.density": 0}}
  - {nam: c}
variables:
  EA1: {field: "devices[0].EAx", log: [1e4, 5e10]}
  EA9: {field: "devices[9].EA", log: [1e4, 5e10]}
  m: {field: "devices[1].mass", linear: [-1, 5]}
  bad: {field: "devices[0].BB", log: [0, 1]}
  water.density: {log: [1000, 10]}
tied: {"devices[0].BA": "sqrt(0.002 * EA5)", "devices[1].c": "m *", "devices[1].q": 1}
sampler: {kind: sobl, n: 0, levels: {EA7: 3}}
ask: {durration: 2.0, segments: 1, model: lumpd, interval: 3}
metrics: {baseline: lokced, probe: 70, window: [3, 1]}
objectives: [delta, gama, jumps]
repeats: {n: -1}
"""


def test_no_mistake_hides_another():
    """Dozens of them in every section: each is reported, once, and nothing that only follows from another."""
    with pytest.raises(ConfigError) as caught:
        parse_study(yaml.safe_load(WRONG))
    assert sorted(mistake.path for mistake in caught.value.mistakes) == sorted(
        [
            "nme",
            "scene.cable[0].d",
            "scene.end_a.position[1]",
            "scene.end_a.direction",
            "scene.end_b.force",
            "scene.watr",
            "scene.watr.density",
            "scene.devices[0].BAA",
            "scene.devices[1].s",
            "scene.devices[2].kind",
            "scene.devices[2].EEA",
            "scene.devices[3].kind",
            "environments[0].set.cable[0].dd",
            "environments[1].name",
            "environments[1].set.cable[0].mass",
            "environments[1].set.water.density",
            "environments[2].nam",
            "variables.EA1.field",
            "variables.EA9.field",
            "variables.m.linear[0]",
            "variables.bad.log[0]",
            "variables.bad.field",
            "variables.water.density.log",
            "tied.devices[0].BA",
            "tied.devices[1].c",
            "tied.devices[1].q",
            "sampler.kind",
            "sampler.n",
            "sampler.levels.EA7",
            "ask.durration",
            "ask.segments",
            "ask.model",
            "ask.interval",
            "metrics.baseline",
            "metrics.probe",
            "metrics.window",
            "objectives[1]",
            "objectives[2]",
            "repeats.n",
        ]
    )


@pytest.mark.parametrize(
    ("changes", "path"),
    [
        ({"scene__cable__0__length": "long"}, "scene.cable[0].length"),  # the devices may be on it
        ({"scene__devices__0__s": "x"}, "scene.devices[0].s"),
        ({"scene__cable": []}, "scene.cable"),
        ({"scene__end_a__kind": "fixed"}, "scene.end_a.kind"),
        ({"scene__end_a": 7}, "scene.end_a"),
        ({"scene__devices__0": {"s": 3, "mass": 2}}, "scene.devices[0].kind"),  # its fields are not known
        ({"scene__start": {"kind": "released", "velocity": 3}}, "scene.start.velocity"),
        ({"scene": "nowhere.yaml"}, "scene.include (nowhere.yaml)"),
        ({"variables__stiff__log": ["x", 1]}, "variables.stiff.log[0]"),
        ({"variables": 3}, "variables"),
        ({"environments": 3, "objectives": ["delta_worst"]}, "environments"),
        ({"ask__duration": -1, "metrics": {"window": [0, 3]}}, "ask.duration"),
        ({"tied": {"devices[1].c": [1]}}, "tied.devices[1].c"),
        ({"variables__devices[1].k": {"linear": [-1, 10]}}, "variables.devices[1].k.linear[0]"),  # tied c too
    ],
)
def test_what_only_follows_is_not_reported(changes, path):
    assert list(mistakes(study(**changes))) == [path]


@pytest.mark.parametrize(
    ("scene", "path", "words"),
    [
        (
            {"devices__0__s": 0.5, "devices__0__rod": 2},
            "devices[0].s",
            "= 0.5: is off the cable (0 to 10 m); move the device",
        ),
        (
            {"devices__0__s": 0.5, "devices__0__rod": 1},
            "devices[0].s",
            "= 0.5: a rod must leave cable between itself and the end",
        ),
        ({"devices__1__s": 3}, "devices[1].s", "= 3: is at the same place as `devices[0]`"),
        (
            {"end_a": {"kind": "free"}, "end_b": {"kind": "free"}},
            "start.kind",
            "use kind `given` or `released`",
        ),
        (
            {"end_a": {"kind": "clamped", "direction": [0, 0, 1]}},
            "end_a.position",
            "write `position: [x, y, z]`",
        ),
        (
            {"end_a__force": [1, 0, 0]},
            "end_a.force",
            "= [1, 0, 0]: only a free end takes a `force`; remove it",
        ),
        (
            {"end_a": {"kind": "clamped", "position": [0, 0, 0], "direction": [0, 0, 0]}},
            "end_a.direction",
            "zero",
        ),
        ({"water__depth": 30, "seabed": {"z": -20}}, "seabed.z", "= -20: `seabed.z` must be minus"),
        ({"cable__0__volume": 1, "cable__0__wet_weight": 5}, "cable[0].wet_weight", "= 5: give `volume` or"),
        ({"end_b__motion": {}}, "end_b.motion", "needs `harmonics`"),
        ({"start": {"shape": [[0, 0, 0]] * 2}}, "start.shape", "`kind: given`"),
        (
            {"devices__0__kind": "bnes_free", "devices__0__law": "springs"},
            "devices[0].law",
            "= 'springs': a free",
        ),
        ({"devices__1__rod": "cords"}, "devices[1].rod", "give a length here"),
        ({"water__current": {"z": [0, -1], "velocity": [[0, 0, 0]] * 2}}, "water.current.z", "must increase"),
    ],
)
def test_fields_that_contradict_one_another(scene, path, words):
    raw = study(**{f"scene__{key}": value for key, value in scene.items()})
    assert words in one(raw, f"scene.{path}")


@pytest.mark.parametrize(
    ("change", "path", "words"),
    [
        ({"scene__devices__0__kind": "bness"}, "scene.devices[0].kind", "did you mean `bnes`?"),
        ({"scene__devices__0": {"s": 3, "mass": 1}}, "scene.devices[0].kind", "is required"),
        ({"scene__devices__0__mass": True}, "scene.devices[0].mass", "not true or false"),
        ({"scene__devices__0__EA": float("nan")}, "scene.devices[0].EA", "greater than 0"),
        ({"scene__end_a__position": [float("nan"), 0, 0]}, "scene.end_a.position[0]", "finite"),
        ({"scene__devices__0__rod": "rope"}, "scene.devices[0].rod", "allowed: cords"),
        ({"scene__devices__1__s": 3}, "scene.devices[1].s", "must not touch"),
        ({"scene__devices__1__s": 30}, "scene.devices[1].s", "= 30: is off the cable (0 to 10 m); move"),
        ({"scene__end_a__position": [0, 0]}, "scene.end_a.position[2]", "is required"),
        (
            {"scene__end_a__direction": [0, 0, 1]},
            "scene.end_a.direction",
            "a pinned end has no `direction`",
        ),
        ({"scene__cable": []}, "scene.cable", "at least 1"),
        ({"variables__stiff__log": [1e4, -1]}, "variables.stiff.log[1]", "greater than 0"),
        ({"variables__stiff__log": [5, 5]}, "variables.stiff.log", "lo < hi"),
        ({"variables__stiff__linear": [1, 2]}, "variables.stiff", "exactly one"),
        ({"variables__stiff__field": "devices[0].EB"}, "variables.stiff.field", "did you mean `EA`?"),
        ({"variables__stiff__field": "devices[7].EA"}, "variables.stiff.field", "entries 0 to 1"),
        ({"variables__stiff__field": "devices.EA"}, "variables.stiff.field", "no fields"),
        ({"variables__stiff__field": "devices[0]EA["}, "variables.stiff.field", "not a field path"),
        ({"variables__stiff__field": "water.current.z"}, "variables.stiff.field", "not given in the scene"),
        ({"variables__stiff__field": "devices[1].k"}, "variables.devices[1].k", "already set"),
        (
            {"variables__extra": {"field": "devices[0].phi0", "linear": [0, 95]}},
            "variables.extra.linear[1]",
            "less than 90",
        ),
        (
            {"variables__extra": {"field": "devices[1].s", "linear": [5, 12]}},
            "variables.extra.linear[1]",
            "off the cable",
        ),
        ({"tied": {"devices[0].BA": "sqrt(stif)"}}, "tied.devices[0].BA", "did you mean `stiff`?"),
        ({"tied": {"devices[0].BA": "sqrt(stiff"}}, "tied.devices[0].BA", "not arithmetic"),
        ({"tied": {"devices[0].BA": "__import__('os')"}}, "tied.devices[0].BA", "unknown function"),
        ({"tied": {"devices[0].BB": "stiff"}}, "tied.devices[0].BB", "did you mean `BA`?"),
        ({"sampler__kind": "sobl"}, "sampler.kind", "did you mean `sobol`?"),
        ({"sampler__n": 0}, "sampler.n", "greater than or equal to 1"),
        ({"sampler__n": True}, "sampler.n", "not true or false"),
        ({"sampler": {"kind": "lhs"}}, "sampler.n", "`n` is required"),
        (
            {"sampler": {"kind": "grid", "levels": {"stif": 3}, "n": 2}},
            "sampler.levels.stif",
            "did you mean `stiff`?",
        ),
        ({"sampler": None}, "sampler", "is required"),
        ({"ask": None}, "ask", "is required"),
        ({"ask__segments": 1}, "ask.segments", "greater than or equal to 2"),
        ({"ask__rho": 1.5}, "ask.rho", "less than or equal to 1"),
        ({"ask__mass_scaling": 1.0, "ask__model": "transverse"}, "ask.mass_scaling", "greater than or equal to 2"),
        ({"ask__mass_scaling": 3.6, "ask__model": "lumped"}, "ask.mass_scaling", "transverse alone, not of `lumped`"),
        ({"variables__extra": {"field": "ask.mass_scaling", "linear": [3, 5]}, "ask__model": "lumped"}, "ask.model",
         "does not read `ask.mass_scaling`, which is varied; write `model: transverse`"),
        ({"ask__mass_scaling": 3.6, "ask__model": "auto"}, "ask.mass_scaling", "or write `model: transverse`"),
        ({"ask__model": "lumpd"}, "ask.model", "did you mean `lumped`?"),
        ({"ask__interval": 3.0}, "ask.interval", "at most the duration"),
        ({"metrics__window": [0, 3]}, "metrics.window[1]", "at most the duration, 2 s"),
        ({"metrics__window": [1, 1]}, "metrics.window", "t0 < t1"),
        ({"metrics__pulse_end": 2.0}, "metrics.pulse_end", "less than the window's end"),
        ({"metrics__probe": 11}, "metrics.probe", "0 to 10 m"),
        ({"objectives": ["jumps"]}, "objectives[0]", "neither more nor less"),
        ({"objectives": ["stroke_3"]}, "objectives[0]", "unknown metric"),
        ({"objectives": ["gamma_worst"]}, "objectives[0]", "at least two `environments`"),
        ({"objectives": ["delta", "delta"]}, "objectives[1]", "twice"),
        ({"objectives": []}, "objectives", "at least one"),
        (
            {"environments": [{"name": "a", "set": {"cable[0].dd": 1}}]},
            "environments[0].set.cable[0].dd",
            "did you mean `d`?",
        ),
        (
            {"environments": [{"name": "a", "set": {"cable[0].d": -1}}]},
            "environments[0].set.cable[0].d",
            "greater than 0",
        ),
        (
            {"environments": [{"name": "a", "set": {"devices[0].EA": 1}}]},
            "environments[0].set.devices[0].EA",
            "already set",
        ),
        ({"environments": [{"name": "a"}, {"name": "a"}]}, "environments[1].name", "used twice"),
    ],
)
def test_each_mistake_is_named(change, path, words):
    assert words in one(study(**change), path)


def test_tied_values_out_of_range_are_blamed_on_the_variable():
    found = mistakes(study(tied={"devices[0].BA": "1 - stiff / 1e9"}))
    assert list(found) == ["variables.stiff.log[1]"]
    assert "devices[0].BA" in str(found["variables.stiff.log[1]"])


# --------------------------------------------------------------------------- files


def file_mistake(tmp_path, text):
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_study(tmp_path / "s.yaml")
    return str(caught.value)


def test_missing_file_names_its_neighbour(tmp_path):
    (tmp_path / "study.yaml").write_text("name: x")
    with pytest.raises(ConfigError, match=r"no such file; did you mean `study.yaml`\?"):
        load_study(tmp_path / "stduy.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [1, 2\nb: 3", "is not YAML"),
        ("\tname: x", "is not YAML"),
        ("", "is empty"),
        ("- 1\n- 2", "not a mapping"),
        ("just words", "not a mapping"),
        ("name: a\nname: b", "line 2: key `name` is given twice"),
        ("? {a: b}\n: c", "is not YAML"),
        ("a: !!python/object/apply:os.system [ls]", "is not YAML"),
        ("scene: scenes/none.yaml\nask: {duration: 1}", "there is no such file"),
        ("scene: 7\nask: {duration: 1}", "scene = 7: should be a mapping"),
        ("1: 2\nscene: null", "unknown key"),
        ("scene: s.yaml\nask: {duration: 1}", "unknown key"),
        ("scene: {include: s.yaml}\nask: {duration: 1}", "unknown key"),
    ],
)
def test_bad_files(tmp_path, text, words):
    assert words in file_mistake(tmp_path, text)


def test_a_scene_that_includes_itself(tmp_path):
    (tmp_path / "loop.yaml").write_text("include: loop.yaml")
    assert "includes itself" in file_mistake(tmp_path, "scene: loop.yaml\nask: {duration: 1}")


# --------------------------------------------------------------------------- harmonic balance

SHAKEN = {"harmonics": [{"amplitude": [0.01, 0, 0], "frequency": 1.0}]}
SECOND = {"amplitude": [0, 0, 0.01], "frequency": 2.0}


def shaken(**changes):
    """The study under harmonic balance, its sink without a dead band."""
    usual = {"scene__end_b__motion": SHAKEN, "scene__devices__0__law": "springs", "ask__method": "harmonic"}
    return study(**(usual | changes))


def test_a_periodic_study():
    assert parse_study(shaken()).ask.method == "harmonic"
    late = shaken(scene__end_b__motion=SHAKEN | {"window": {"ramp_up": 1.5}}, ask__output_from=0.5)
    assert parse_study(late).ask.output_from == 0.5  # before the ramp's end: the rows show the settled response anyway


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scene__end_b__motion": None}, "nothing moves"),
        ({"scene__end_b__motion": SHAKEN | {"window": {"stop": 1.0}}}, "stops at 1 s"),
        ({"scene__devices__0__law": "cords"}, "devices[0].law: cords in tension only leave a dead band"),
        ({"scene__start": {"kind": "released"}}, "start.kind: released begins a transient"),
        ({"scene__end_b__motion": {"harmonics": [*SHAKEN["harmonics"], SECOND]}, "ask__harmonics": 1}, "is 2 times"),
    ],
)
def test_harmonic_balance_says_what_it_cannot_serve(changes, words):
    text = one(shaken(**changes), "ask.method")
    assert words in text
    assert "ask.method = 'harmonic'" in text
    assert "`method: explicit`" in text


def test_harmonic_balance_among_other_mistakes():
    found = mistakes(study(ask__method="harmonic", sampler__n=0, objectives=["delta", "gama"]))
    assert set(found) == {"ask.method", "sampler.n", "objectives[1]"}


def test_environments_that_harmonic_balance_cannot_serve():
    """The device's law stands in the environments: only one of them leaves a dead band."""
    rough = {"name": "cords", "set": {"devices[0].law": "cords"}}
    text = one(shaken(environments=[{"name": "springs"}, rough]), "ask.method")
    assert "in cords: devices[0].law" in text
    mended = shaken(environments=[{"name": "springs", "set": {"devices[0].law": "springs"}}])
    mended["scene"]["devices"][0]["law"] = "cords"
    parse_study(mended)


# --------------------------------------------------------------------------- paths and expressions


def test_paths():
    assert parse("end_b.motion.harmonics[0].frequency") == ("end_b", "motion", "harmonics", 0, "frequency")
    assert lookup({"a": [{"b": 3}]}, "a[0].b") == 3
    for bad in ("", "a..b", "[0]", "a[x]", "a[-1]", "a.b.", "a b"):
        with pytest.raises(FieldError):
            parse(bad)


def test_expressions():
    names = {"EA1": 5.384e8, "f": 2.0}
    assert Expression("sqrt(0.002 * EA1)").value(names) == pytest.approx(1037.69, rel=1e-5)
    assert Expression("4*(2*pi*f)**2").value(names) == pytest.approx(631.6547, rel=1e-6)
    assert Expression("-max(1, f, 3) + min(4, f) - log(exp(1))").value(names) == -2.0
    assert Expression("7").names == frozenset()


@pytest.mark.parametrize(
    "text", ["[1]", "{1}", "f if f else 1", "'a'", "lambda: 1", "f @ f", "True", "f(1)", "", "f;f"]
)
def test_expressions_refuse_everything_else(text):
    with pytest.raises(FieldError):
        Expression(text)


def test_fields_are_names_that_the_study_must_know():
    assert Expression("f.real + devices[0].EA").names == {"f.real", "devices[0].EA"}


@pytest.mark.parametrize("text", ["1/(f-2)", "sqrt(-f)", "(-8)**0.5", "9.0**9**9", "exp(1e6)", "log(0)"])
def test_expressions_that_have_no_value(text):
    with pytest.raises(FieldError):
        Expression(text).value({"f": 2.0})
