"""Designs, the scenes that they make, their baselines, and the keys that name them."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from importlib.util import find_spec
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from solvers import Ask, PointMass, Scene, Section

from .config import DESIGN_QUANTITIES, AskSection, ConfigError, MetricSettings, Sampler, Study
from .fields import apart, assign, bind, dump
from .mend import plain
from .mistakes import ABSENT, Mistake
from .point import Order, Point

BLOCKS = {"saltelli": 2, "morris": 1}  # designs of a block beyond one for each variable
LEVELS = 4  # values of each variable in Morris's design

# --------------------------------------------------------------------------- designs


def design_values(study: Study, limit: int | None = None) -> np.ndarray:
    """(n_design, n_variable) values of the design variables; ``limit`` takes the first designs."""
    given = study.sampler.values if study.sampler and study.sampler.kind == "given" else None
    if given is not None:
        return np.array([[var.number(v) for v in given[key]] for key, var in study.variables.items()]).T[:limit]
    samples = unit_samples(study)[:limit]
    values = np.empty(samples.shape)
    for j, variable in enumerate(study.variables.values()):
        values[:, j] = [variable.at(float(u)) for u in samples[:, j]]
    return values


def unit_samples(study: Study) -> np.ndarray:
    """Designs in the unit cube, one column for each variable.

    ``random``, ``sobol`` and ``saltelli`` give the same first designs whatever ``n``; the others depend on ``n``.

    Returns
    -------
    (n_design, n_variable) float in [0, 1)
    """
    sampler, axes = study.sampler, study.variables
    d = len(axes)
    if d == 0:
        return np.zeros((1, 0))
    if sampler is None:
        remedy = "`sweep optimise` needs none; to sweep, write e.g. {kind: sobol, n: 100, seed: 0}"
        raise ConfigError([Mistake("sampler", ABSENT, "is required to sweep", remedy)], study.name)
    if sampler.kind == "grid":
        return np.array(list(itertools.product(*_axes(study, sampler))))
    n = sampler.n or 1
    from scipy.stats import qmc  # a third of a second, that a worker does not need

    if sampler.kind in BLOCKS:
        return _blocks(study, sampler)
    rng = np.random.default_rng(sampler.seed)
    if sampler.kind == "random":
        return rng.random((n, d))
    if sampler.kind == "lhs":
        return qmc.LatinHypercube(d, seed=rng).random(n)
    with warnings.catch_warnings():  # a prefix of a Sobol sequence is wanted, balanced or not
        warnings.simplefilter("ignore", UserWarning)
        return qmc.Sobol(d, scramble=True, seed=rng).random(n)


def count_designs(study: Study) -> int:
    """How many designs the study has."""
    if not study.variables:
        return 1
    if study.sampler is None:
        return len(unit_samples(study))
    if study.sampler.kind == "given":
        return len(next(iter(study.sampler.values.values())))
    if study.sampler.kind == "grid":
        return math.prod(len(axis) for axis in _axes(study, study.sampler))
    return (study.sampler.n or 1) * (block_size(study) if study.sampler.kind in BLOCKS else 1)


def block_size(study: Study) -> int:
    """Designs that belong together: a block of Saltelli's design, a trajectory of Morris's."""
    assert study.sampler is not None
    return len(study.variables) + BLOCKS[study.sampler.kind]


def problem(variables: Iterable[str]) -> dict[str, Any]:
    """The unit cube as SALib describes it."""
    names = list(variables)
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def salib() -> None:
    """ConfigError where SALib, which sensitivity needs, is not installed."""
    if find_spec("SALib") is None:
        problem = "sensitivity needs the package SALib, which is not installed"
        raise ConfigError([Mistake("sampler.kind", ABSENT, problem, "pip install 'cable-sweep[analysis]'")])


def _blocks(study: Study, sampler: Sampler) -> np.ndarray:
    """Saltelli's design in blocks (A, A with a column of B each, B), or Morris's trajectories; n of them."""
    salib()
    what, n, seed = problem(study.variables), sampler.n or 1, sampler.seed
    with warnings.catch_warnings():  # of numbers that are no power of two
        warnings.simplefilter("ignore", UserWarning)
        if sampler.kind == "saltelli":
            from SALib.sample import sobol

            return np.asarray(sobol.sample(what, n, calc_second_order=False, seed=seed))
        from SALib.sample import morris

        return np.asarray(morris.sample(what, n, num_levels=LEVELS, seed=seed))


def _axes(study: Study, sampler: Sampler) -> list[np.ndarray]:
    """Levels of each variable in the unit cube: all that a list or whole numbers have, unless fewer are asked for."""
    axes = []
    for key, variable in study.variables.items():
        levels = sampler.levels.get(key)
        if variable.options is not None and (variable.integer is None or levels is None):
            n = len(variable.options)
            axes.append((np.arange(n) + 0.5) / n)
        else:
            n = levels or sampler.n or 1
            axes.append(np.linspace(0, 1, n) if n > 1 else np.array([0.5]))
    return axes


def designs(study: Study, limit: int | None = None) -> list[dict[str, float]]:
    """The study's designs, each the values of its variables by name; ``limit`` takes the first ones."""
    return [dict(zip(study.variables, map(float, row), strict=True)) for row in design_values(study, limit)]


def extremes(study: Study) -> dict[str, dict[str, float]]:
    """The first design, and those with every variable at its least and at its greatest, as far as they are possible.

    Without a sampler the design in the middle stands for the first.
    """
    middle = {key: variable.at(0.5) for key, variable in study.variables.items()}
    chosen = {"first": middle if study.sampler is None else designs(study, 1)[0]}
    if study.variables:
        chosen["least"] = {key: min(v for _, v in var.tests) for key, var in study.variables.items()}
        chosen["greatest"] = {key: max(v for _, v in var.tests) for key, var in study.variables.items()}
    possible = {label: values for label, values in chosen.items() if not make_point(study, 0, 0, values).problem}
    if not possible:
        problem = make_point(study, 0, 0, chosen["first"]).problem
        raise ConfigError([Mistake("variables", ABSENT, f"the first design is not possible: {problem}")], study.name)
    return possible


def design_scene(study: Study, values: Mapping[str, float], environment: int = 0) -> Scene:
    """The scene of a design in an environment, validated."""
    return bind(study.scene, apart(dict(study.environments[environment].set) | study.assignments(values))[0])


def design_ask(study: Study, values: Mapping[str, float], environment: int = 0) -> Ask:
    """What is asked of a design in an environment, validated: the study's ask, with what ``ask.x`` sets in it."""
    wanted = apart(dict(study.environments[environment].set) | study.assignments(values))[1]
    if not wanted:
        return study.ask
    tree = plain(asdict(study.ask))
    for path, value in wanted.items():
        assign(tree, path, value)
    return Ask(**asdict(TypeAdapter(AskSection).validate_python(tree)))


def make_point(study: Study, design: int, environment: int, values: Mapping[str, float]) -> Point:
    """A point ready to run, or with the reason why there can be none."""
    scene, ask, problem = study.scene, study.ask, ""
    try:
        scene, ask = design_scene(study, values, environment), design_ask(study, values, environment)
        key = point_key(scene, ask, study.settings)
    except ValueError as error:  # of the vocabulary, or of an expression
        problem = _why(error)
        wanted = {"impossible": sorted(values.items()), "environment": environment}
        key = _hashed({"scene": _as_first(dump(scene)), **wanted})
    return Point(
        key=key,
        problem=problem,
        design=design,
        environment=environment,
        values=dict(values),
        scene=scene,
        ask=ask,
        settings=study.settings,
    )


def _why(error: ValueError) -> str:
    if not isinstance(error, ValidationError):
        return str(error)
    told = (item["msg"].removeprefix("Value error, ") for item in error.errors(include_url=False))
    return "; ".join(dict.fromkeys(told))


def design_quantity(study: Study, values: Mapping[str, float], name: str) -> float:
    """A number that a design has before it is run, in the first environment; NaN for an impossible design."""
    try:
        return DESIGN_QUANTITIES[name].function(design_scene(study, values))
    except ValueError:
        return math.nan


def made(study: Study, order: Order) -> Point:
    """An order as a point, ready to run; ConfigError where the study gives it another key than the plan."""
    point = make_point(study, order.design, order.environment, order.values)
    if point.key != order.key:
        problem = f"the plan has {order.key} here, the study gives {point.key}"
        where = f"design {order.design}, environment {order.environment}"
        raise ConfigError([Mistake(where, ABSENT, problem, "the study has changed: use a new directory")])
    return point


def points(study: Study, limit: int | None = None) -> Iterator[Point]:
    """All points, environments of a design together; ``limit`` counts designs."""
    for i, values in enumerate(designs(study, limit)):
        for e in range(len(study.environments)):
            yield make_point(study, i, e, values)


# --------------------------------------------------------------------------- keys


def canonical(value: Any) -> Any:
    """Plain data in which equal physics looks equal: numbers as floats, no -0.0, nothing not given."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int | float):
        return float(value) + 0.0  # -0.0 + 0.0 is 0.0
    if isinstance(value, Mapping):
        return {
            str(k): canonical(v)
            for k, v in value.items()
            if v is not None and k not in ("name", "description")
        }
    if isinstance(value, list | tuple):
        return [None if item is None else canonical(item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return canonical(asdict(value))
    raise TypeError(f"{type(value).__name__} has no canonical form")


def point_key(scene: Scene, ask: Ask, settings: MetricSettings | None = None) -> str:
    """The name of a run: hash of all that its metrics depend on, solver version excepted.

    Names and descriptions do not count; 1e6 and 1000000 are the same. Objectives count only where repeats are
    asked for, because only then do they change what is stored.

    Returns
    -------
    16 hexadecimal digits
    """
    asked = asdict(ask)
    younger = (("output_from", 0.0), ("rho_space", 1.0), ("checked_tolerance", None))  # than the first keys
    for name, usual in younger:
        if asked[name] == usual:
            del asked[name]
    parts = {"scene": _as_first(dump(scene)), "ask": asked}
    if settings is not None:
        chosen = asdict(settings)
        if not settings.repeats:
            del chosen["repeats"], chosen["perturbation"], chosen["objectives"]
        if settings.uncertainty is None:
            del chosen["uncertainty"]
        parts["metrics"] = chosen
    return _hashed(parts)


def _hashed(parts: Mapping[str, Any]) -> str:
    text = json.dumps(canonical(parts), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _as_first(tree: dict[str, Any]) -> dict[str, Any]:
    """A dumped scene without the fields, at their defaults, that scenes did not have when keys were first made."""
    for part, names in (
        *((section, ("coupling", "curvature", "moment")) for section in tree["cable"]),
        *((tree[end], ("twist",)) for end in ("end_a", "end_b")),
    ):
        for name in names:
            if part[name] in (0.0, [0.0, 0.0, 0.0]):
                del part[name]
    return tree


# --------------------------------------------------------------------------- baselines


def baseline_scene(scene: Scene, name: str) -> Scene:
    """The scene that a design is compared with, by the baseline's name.

    ``plain``: no devices. ``uniform``: no devices, their mass and net weight spread evenly along the cable.
    ``locked``: each mass fixed at its point, no rod. ``rod_locked``: the same on the device's rigid rod.
    Fixed masses and buoys of the scene stay as they are in the last two. ``full_rod``: the same scene, run as a rod
    from end to end (:func:`baseline_model`).
    """
    if name == "full_rod":
        return scene
    if name == "plain":
        return replace(scene, devices=())
    if name == "uniform":
        return replace(scene, devices=(), cable=tuple(_loaded(scene)))
    if name not in ("locked", "rod_locked"):
        raise ValueError(f"no baseline `{name}`: uniform, locked, rod_locked, plain, full_rod")
    return replace(scene, devices=tuple(_locked(device, name == "rod_locked") for device in scene.devices))


def baseline_model(ask: Ask, name: str) -> Ask:
    """What is asked of a baseline as far as its name decides: ``full_rod`` is the line ``rod``."""
    return replace(ask, model="rod", rods=None, mass_scaling=None) if name == "full_rod" else ask


def _locked(device: Any, with_rod: bool) -> Any:
    if isinstance(device, PointMass):
        return device
    rod = device.rod_length if with_rod and device.rod_length > 0 else None
    return PointMass(
        kind="locked",
        s=device.s,
        mass=device.mass,
        volume=device.volume,
        drag=device.drag,
        added_mass=device.added_mass,
        rod=rod,
        rod_EA=device.rod_EA if rod else None,
    )


def _loaded(scene: Scene) -> Iterator[Section]:
    """The cable's sections with the devices' mass and net weight per metre of cable added."""
    if not scene.devices:
        yield from scene.cable
        return
    mass = sum(device.mass for device in scene.devices) / scene.length
    weight = sum(_net_mass(device, scene.density) for device in scene.devices) * scene.g / scene.length
    for section in scene.cable:
        yield replace(
            section,
            mass=section.mass + mass,
            volume=None,
            wet_weight=section.wet(scene.density, scene.g) + weight,
        )


def _net_mass(device: Any, density: float) -> float:
    """Mass less displaced mass; devices are neutrally buoyant by default, in water."""
    if device.volume is None:
        return 0.0 if density > 0 else device.mass
    return device.mass - density * device.volume
