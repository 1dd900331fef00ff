"""A study from YAML: what is varied, in which scene, what is asked of each run, and what counts.

``load_study`` either returns a :class:`Study` in which everything has been checked, down to the scene at both
ends of every variable's range, or raises :class:`ConfigError` with all the mistakes it could find.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import yaml
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, model_validator

import solvers
from solvers import Ask, Scene
from solvers.scene import NonNegative, Number, Positive, record
from solvers.settled import why_not

from .fatigue import Fatigue, Limits
from .fields import COUNT, SCENE, Expression, FieldError, apart, deep_merge, kind_has, lookup, parse, place
from .mend import Place, Reading, follows, match_keys, plain, read
from .mistakes import ABSENT, ConfigError, Mistake, faults, nearest, unknown_key


def _no_bool(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a whole number is wanted here, not true or false")
    return value


Count = Annotated[int, BeforeValidator(_no_bool), Field(ge=1)]
Whole = Annotated[int, BeforeValidator(_no_bool), Field(ge=0)]
Integer = Annotated[int, BeforeValidator(_no_bool)]
Fraction = Annotated[float, BeforeValidator(_no_bool), Field(ge=0, le=1, allow_inf_nan=False)]
Open = Annotated[float, BeforeValidator(_no_bool), Field(gt=0, lt=1, allow_inf_nan=False)]
Baseline = Literal["uniform", "locked", "rod_locked", "plain", "full_rod"]


# --------------------------------------------------------------------------- what counts


class Metric(NamedTuple):
    """A number read from a response and its baseline. Declared beside its function in ``sweep.metrics``."""

    name: str
    unit: str
    direction: str | None  # 'min', 'max', or None where neither is better
    definition: str
    equation: str  # of paper 003, corrected; '' where it has none
    function: Callable[..., Any]
    per_device: bool = False  # also reported for each device as <name>_1, <name>_2, ...
    needs: str = ""  # field of the study's `metrics` without which it is NaN


METRICS: dict[str, Metric] = {}  # filled by sweep.metrics, which is imported with the package

AGGREGATES = re.compile(r"mean|worst|q\d{1,2}")  # over environments: mean, worst, and quantiles (q10: 10 % lie below)
_SUFFIX = re.compile(rf"_({AGGREGATES.pattern}|ensemble|spread|sd)$")


def split_name(name: str) -> tuple[str, tuple[str, ...]]:
    """A column's metric and what is said of it: ``stroke_2_worst_sd`` is ``stroke_2`` with ``worst``, ``sd``."""
    said: list[str] = []
    while name not in METRICS and (match := _SUFFIX.search(name)):
        name = name[: match.start()]
        said.insert(0, match[1])
    return name, tuple(said)


def bad_tail(metric: Metric) -> int | None:
    """The quantile [%] that a metric has over environments by default: its bad tail, q10 where more is better, q90
    where less is; None where neither is."""
    return {"max": 10, "min": 90}.get(metric.direction or "")


def find_metric(name: str, devices: int | None = None) -> Metric | None:
    """The metric behind a result's name: ``delta``, ``stroke_2``, ``gamma_q10``, ``delta_ensemble_worst``.

    Parameters
    ----------
    devices : number of devices in the scene; without it any device number is accepted
    """
    stem = split_name(name)[0]
    if stem in METRICS:
        return METRICS[stem]
    match = re.fullmatch(r"(\w+?)_([1-9]\d*)", stem)
    if match is None or match[1] not in METRICS or not METRICS[match[1]].per_device:
        return None
    return METRICS[match[1]] if devices is None or int(match[2]) <= devices else None


class Quantity(NamedTuple):
    """A number that a design has before it is run."""

    unit: str
    definition: str
    function: Callable[[Scene], float]


DESIGN_QUANTITIES: dict[str, Quantity] = {
    "device_mass": Quantity("kg", "mass of all devices", lambda scene: sum((d.mass for d in scene.devices), 0.0)),
    "device_count": Quantity("1", "number of devices", lambda scene: float(len(scene.devices))),
}


# --------------------------------------------------------------------------- sections of the YAML


@record
class Environment:
    """A named patch on the scene: the sea, the fouling or the excitation that each design meets.

    An entry of a study may stand for several: ``seeds`` draws the scene's stochastic motions anew for each, ``grid``
    takes all combinations of the values of some fields, and both go together. See :func:`spread_out`.
    """

    name: str
    set: dict[str, Any] = Field(default_factory=dict)  # path of a field of the scene, or of the ask as ask.x: value
    grid: dict[str, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(default_factory=dict)  # path: values
    seeds: Count | Annotated[tuple[Whole, ...], Field(min_length=1)] | None = None  # 4 is [1, 2, 3, 4]


class Patch(NamedTuple):
    """What an environment sets, under examination."""

    entry: int  # in the study's list
    name: str
    set: dict[str, Any]
    places: dict[str, str]  # by field path: where the study says it


def spread_out(entry: Environment, seeds: Sequence[str]) -> list[Environment]:
    """The environments that an entry stands for: its grid's combinations, the last field fastest, each with every seed.

    Parameters
    ----------
    seeds : field paths of the seeds of the scene's stochastic motions
    """
    leaves = [re.sub(r"(\[\d+\])+$", "", path).rpartition(".")[2] for path in entry.grid]
    labels = [leaf if leaves.count(leaf) == 1 else path for leaf, path in zip(leaves, entry.grid, strict=True)]
    drawn = range(1, entry.seeds + 1) if isinstance(entry.seeds, int) else entry.seeds
    found = []
    for values in itertools.product(*entry.grid.values()):
        words = [f"{label} {value:g}" if isinstance(value, float) else f"{label} {value}"
                 for label, value in zip(labels, values, strict=True)]  # fmt: skip
        wanted = entry.set | dict(zip(entry.grid, values, strict=True))
        for seed in (None,) if drawn is None else drawn:
            more = {} if seed is None else dict.fromkeys(seeds, seed)
            name = " ".join([entry.name, *words, *([] if seed is None else [f"seed {seed}"])])
            found.append(Environment(name=name, set=wanted | more))
    return found


def _seed_paths(tree: Any) -> list[str]:
    """Field paths of the seeds of a dumped scene's stochastic motions."""
    found = []
    for end in ("end_a", "end_b"):
        motion = tree.get(end, {}).get("motion") if isinstance(tree, dict) and isinstance(tree.get(end), dict) else None
        if isinstance(motion, dict) and isinstance(motion.get("stochastic"), dict):
            found.append(f"{end}.motion.stochastic.seed")
    return found


_RANGES = ("log", "linear", "values", "integer", "choices")


@record
class Variable:
    """A design variable: one field of the scene (or ``ask.x`` of the ask) or several, over a range or a list.

    A design holds a number for each variable: its value, or the place of its value among the ``choices``.
    """

    field: str | tuple[str, ...] | None = None  # default: the variable's own key
    log: tuple[Positive, Positive] | None = None  # [lo, hi], evenly spread in the logarithm
    linear: tuple[Number, Number] | None = None  # [lo, hi]
    values: tuple[Number, ...] | None = None
    integer: tuple[Integer, Integer] | None = None  # [lo, hi], whole numbers, both ends too
    choices: tuple[Any, ...] | dict[str, Any] | None = None  # words or numbers, or named parts: {name: {kind: ...}}

    @model_validator(mode="after")
    def _one_range(self) -> Variable:
        given = [name for name in _RANGES if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                "give exactly one of `log: [lo, hi]`, `linear: [lo, hi]`, `values: [...]`, `integer: [lo, hi]`, "
                "`choices: [...]`"
            )
        ends = self.log or self.linear or self.integer
        if ends and not ends[0] < ends[1]:
            raise ValueError(f"`{given[0]}: [lo, hi]` needs lo < hi, not {ends[0]:g} and {ends[1]:g}")
        if (self.values is not None and not self.values) or (self.choices is not None and not self.choices):
            raise ValueError(f"`{given[0]}` needs at least one value")
        if isinstance(self.choices, tuple):
            if any(isinstance(choice, Mapping | list | tuple) for choice in self.choices):
                raise ValueError("`choices` that are not words or numbers need names: `choices: {name: {...}, ...}`")
            if len(set(map(str, self.choices))) < len(self.choices):
                raise ValueError("`choices` must differ")
        return self

    @property
    def options(self) -> Sequence[Any] | None:
        """What a discrete variable may set, in order; None for a range."""
        if self.integer is not None:
            return range(self.integer[0], self.integer[1] + 1)
        return tuple(self.choices.values()) if isinstance(self.choices, dict) else self.choices or self.values

    @property
    def labels(self) -> list[Any] | None:
        """Names of the choices: words, or numbers where all of them are; None without choices."""
        if self.choices is None or isinstance(self.choices, dict):
            return None if self.choices is None else list(self.choices)
        if all(isinstance(choice, int | float) and not isinstance(choice, bool) for choice in self.choices):
            return [float(choice) for choice in self.choices]
        return ["none" if choice is None else str(choice) for choice in self.choices]

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers, with which one can calculate."""
        return self.labels is None or not isinstance(self.labels[0], str)

    def paths(self, key: str) -> tuple[str, ...]:
        """The field paths that the variable sets, ``key`` being its own name."""
        if self.field is None:
            return (key,)
        return (self.field,) if isinstance(self.field, str) else tuple(self.field)

    def at(self, u: float) -> float:
        """The value at ``u`` in [0, 1], to ten digits: keys must not hang on a math library's last bit."""
        if self.options is not None:
            i = min(int(u * len(self.options)), len(self.options) - 1)
            return float(i if self.choices is not None else self.options[i])
        lo, hi = self.log or self.linear or (0.0, 0.0)
        value = lo * math.exp(u * math.log(hi / lo)) if self.log else lo + u * (hi - lo)
        return min(max(float(f"{value:.10g}"), lo), hi)

    def setting(self, value: float | str) -> Any:
        """What a design's number (or the name of a choice) sets in the fields."""
        if self.choices is None:
            return value
        assert self.labels is not None
        assert self.options is not None
        return self.options[self.labels.index(value) if isinstance(value, str) else int(value)]

    def shown(self, value: float | str) -> Any:
        """A design's number as results have it: the name of a choice."""
        return value if self.labels is None or isinstance(value, str) else self.labels[int(value)]

    def number(self, value: float | str) -> float:
        """The reverse of :meth:`shown`."""
        return float(value if self.labels is None else self.labels.index(value))

    def holds(self, value: float | str) -> bool:
        """Whether a value is in the range or on the list."""
        if self.labels is not None:
            return value in self.labels
        if isinstance(value, str):
            return False
        if self.values is not None:
            return value in self.values
        lo, hi = self.log or self.linear or self.integer or (0.0, 0.0)
        return lo <= value <= hi and (self.integer is None or float(value).is_integer())

    @property
    def tests(self) -> tuple[tuple[str, float], ...]:
        """Numbers to try on the scene, each with where it stands: the ends of the range, or all the values."""
        kind = next(name for name in _RANGES if getattr(self, name) is not None)
        if isinstance(self.choices, dict):
            return tuple((f"choices.{name}", i) for i, name in enumerate(self.choices))
        return tuple(
            (f"{kind}[{i}]", i if self.choices is not None else value) for i, value in enumerate(getattr(self, kind))
        )


@record
class Sampler:
    """How designs are drawn. ``random``, ``sobol`` and ``saltelli`` designs do not change when ``n`` grows; ``given``
    ones are those of another study's front (``file``, whose values are kept in the study), or listed.

    With d variables ``saltelli`` (for Sobol indices) has n blocks of d + 2 designs, ``morris`` (a screening) n
    trajectories of d + 1; ``sweep sensitivity`` reads both.
    """

    kind: Literal["grid", "random", "lhs", "sobol", "given", "saltelli", "morris"] = "sobol"
    n: Count | None = None  # designs; for a grid, levels of each axis; saltelli: blocks; morris: trajectories
    seed: Whole = 0
    levels: dict[str, Count] = Field(default_factory=dict)  # grid: levels of single axes
    file: str | None = None  # given: a front.nc or results.nc, relative to the study's folder
    values: dict[str, tuple[Number | str, ...]] = Field(default_factory=dict)  # given: of each variable, by design

    @model_validator(mode="after")
    def _countable(self) -> Sampler:
        if self.kind not in ("grid", "given") and self.n is None:
            raise ValueError(f"`n` is required with `kind: {self.kind}`")
        if self.kind != "given" and (self.values or self.file):
            raise ValueError("`values` and `file` belong to `kind: given`")
        if self.kind != "grid" and self.levels:
            raise ValueError("`levels` belongs to `kind: grid`")
        return self


@record
class AskSection:
    """What is asked of each run: the fields of solvers.Ask with their ranges."""

    duration: NonNegative  # [s]
    model: str = "auto"
    method: str = "auto"
    segments: Annotated[int, BeforeValidator(_no_bool), Field(ge=2)] | None = None
    accuracy: Open = 0.05
    tolerance: Positive | None = None
    checked_tolerance: Positive | None = None  # pilots' word that it does: a coarser run is check enough
    step: Positive | None = None  # [s]
    rho: Fraction = 0.8
    interval: Positive = 1e-3  # [s]
    output_from: NonNegative = 0.0  # [s]
    rho_space: Fraction = 1.0  # rod, catenary, hybrid: 1 closes the energy balance, less damps along s
    mass_scaling: Annotated[Number, Field(ge=2, le=20)] | None = None  # transverse: spans in the shortest wave kept
    rods: tuple[tuple[NonNegative, NonNegative], ...] | None = None  # hybrid: [[from, to], ...] [m]; null: adaptive
    harmonics: Annotated[int, BeforeValidator(_no_bool), Field(ge=1, le=200)] | None = None
    max_steps: Count = 20_000_000
    perturbation: NonNegative = 0.0
    seed: Whole = 0

    @model_validator(mode="after")
    def _rods_in_order(self) -> AskSection:
        places = [s for pair in self.rods or () for s in pair]
        if any(b <= a for a, b in pairwise(places)):
            raise ValueError("`rods` must be stretches [from, to] of the cable, in order and apart")
        return self


@record
class MetricsSection:
    """What the metrics are taken over and against."""

    window: tuple[Number, Number] | None = None  # [t0, t1] in s; default the whole run
    pulse_end: NonNegative = 0.0  # RMS values count from here [s]
    baseline: Baseline = "locked"
    probe: NonNegative | None = None  # arc length of a probe [m]
    limits: Limits | None = None  # breaking load and minimum bend radius
    fatigue: Fatigue | None = None  # the cable's critical layer and its curve

    @model_validator(mode="after")
    def _ordered(self) -> MetricsSection:
        if self.window is not None and not 0 <= self.window[0] < self.window[1]:
            raise ValueError("`window: [t0, t1]` needs 0 <= t0 < t1")
        return self


@record
class MetricSettings(MetricsSection):
    """All that a point's metrics depend on besides its scene and its run."""

    repeats: Whole = 0  # perturbed repetitions behind each `_spread` and `_ensemble`
    perturbation: NonNegative = 1e-9  # of their initial velocities [m/s]
    objectives: tuple[str, ...] = ()  # metrics that get a `_spread` and an `_ensemble`
    uncertainty: Uncertainty | None = None  # whether and how every metric gets its `_sd`

    @property
    def single(self) -> MetricSettings:
        """The same without any repetition: one run."""
        return replace(self, repeats=0, objectives=(), uncertainty=None)


@record
class Uncertainty:
    """Asks for the standard uncertainty of every metric, ``<metric>_sd``, and for the metric ``chaos``.

    Sensitivity: ``runs`` more runs with start velocities of ``perturbation``, every second one with a slightly
    tighter tolerance (or shorter step) as well. Numerical: a run at a tenth of the tolerance (or half the step), and
    one on a mesh ``refine`` times as fine. See ``sweep.uncertainty`` for how they are combined.
    """

    runs: Annotated[int, BeforeValidator(_no_bool), Field(ge=2)] = 4
    perturbation: Positive = 1e-9  # standard deviation of start velocities [m/s]
    refine: Annotated[float, BeforeValidator(_no_bool), Field(gt=1, le=4, allow_inf_nan=False)] = 1.5


@record
class Repeats:
    """Error bars of chaotic responses: each point is run ``n`` more times, slightly perturbed."""

    n: Whole = 0
    perturbation: Positive = 1e-9


@record
class Bound:
    """What a metric or a quantity of a design must keep to; with several environments, in each of them."""

    min: Number | None = None
    max: Number | None = None

    @model_validator(mode="after")
    def _some(self) -> Bound:
        if self.min is None and self.max is None:
            raise ValueError("give `min`, `max` or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"`min` must not be above `max`, not {self.min:g} and {self.max:g}")
        return self


@record
class OptimiseSection:
    """How ``sweep optimise`` looks for the front."""

    algorithm: Literal["nsga2", "nsga3", "gp"] = "nsga2"  # gp: Gaussian processes in place of most runs
    population: Annotated[int, BeforeValidator(_no_bool), Field(ge=4)] = 50  # designs of a generation; gp: of the first
    batch: Count = 8  # gp: designs of each later generation
    evaluations: Count = 500  # distinct designs, in all
    seed: Whole = 0
    reference: dict[str, Number] = Field(default_factory=dict)  # objective: value from which hypervolume is counted


@record
class StudyFile:
    """The layout of a study's YAML."""

    name: str = ""
    description: str = ""
    scene: Scene
    environments: tuple[Environment, ...] = ()
    variables: dict[str, Variable] = Field(default_factory=dict)
    tied: dict[str, Number | str] = Field(default_factory=dict)  # field path: expression of the variables
    sampler: Sampler | None = None
    ask: AskSection
    metrics: MetricsSection = Field(default_factory=MetricsSection)
    objectives: tuple[str, ...] = ("delta", "gamma", "t_settle")
    constraints: dict[str, Bound] = Field(default_factory=dict)  # metric, or quantity of the design: its bounds
    optimise: OptimiseSection | None = None
    repeats: Repeats = Field(default_factory=Repeats)
    uncertainty: Uncertainty | None = None
    time_limit: Positive | None = 600.0  # of one point [s], past it the row says TIMEOUT; null sets none
    memory_limit: Positive | None = None  # of one point's process [MB], past it the row says MEMORY; null: its share


@dataclass(frozen=True, kw_only=True)
class Study:
    """A checked study; see ``space`` for its designs and ``plan`` for its points."""

    name: str
    description: str = ""
    scene: Scene
    environments: tuple[Environment, ...] = (Environment(name="default"),)  # never empty
    variables: Mapping[str, Variable] = field(default_factory=dict)
    tied: Mapping[str, Expression] = field(default_factory=dict)
    sampler: Sampler | None = field(default_factory=lambda: Sampler(n=1))  # None: for `sweep optimise` alone
    ask: Ask
    settings: MetricSettings = field(default_factory=MetricSettings)
    objectives: tuple[str, ...] = ()
    constraints: Mapping[str, Bound] = field(default_factory=dict)
    optimise: OptimiseSection = field(default_factory=OptimiseSection)
    repeats: Repeats = field(default_factory=Repeats)
    time_limit: float | None = None  # [s]
    memory_limit: float | None = None  # [MB]
    text: str = ""  # the study as one YAML without includes; loads as itself

    def assignments(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """What a design sets in the scene and, as ``ask.x``, in the ask; field by field, tied fields last."""
        found: dict[str, Any] = {}
        for key, variable in self.variables.items():
            found.update(dict.fromkeys(variable.paths(key), variable.setting(values[key])))
        numbers = {key: self.variables[key].shown(value) for key, value in values.items()}
        return found | {path: expression.value(numbers) for path, expression in self.tied.items()}


# --------------------------------------------------------------------------- reading YAML


class _Loader(yaml.SafeLoader):
    """The safe loader; keys given twice are remembered instead of silently lost."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self.twice: list[tuple[Any, int]] = []

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str | int | float | bool | None):
                raise yaml.constructor.ConstructorError(
                    None, None, "a key must be a word", key_node.start_mark
                )
            if key in seen:
                self.twice.append((key, key_node.start_mark.line + 1))
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> tuple[Any, list[Mistake]]:
    """The content of a YAML file and what is wrong with its form; content ABSENT where it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        here = path.parent if path.parent.is_dir() else Path()
        others = sorted(p.name for p in here.glob("*.y*ml"))
        return ABSENT, [Mistake(str(path), ABSENT, "there is no such file", nearest(path.name, others[:20]))]
    except (OSError, UnicodeDecodeError) as error:
        reason = "it is not UTF-8 text" if isinstance(error, UnicodeDecodeError) else str(error.strerror)
        return ABSENT, [Mistake(str(path), ABSENT, f"cannot be read: {reason}")]
    return parse_yaml(text, path.name)


def parse_yaml(text: str, source: str) -> tuple[Any, list[Mistake]]:
    """As :func:`read_yaml`, from text."""
    try:
        loader = _Loader(text)
        content = loader.get_single_data()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{source}, line {mark.line + 1}, column {mark.column + 1}" if mark else source
        problem = getattr(error, "problem", None) or str(error)
        return ABSENT, [
            Mistake(where, ABSENT, f"is not YAML: {problem}", "check indentation, colons, brackets and tabs")
        ]
    except RecursionError:
        return ABSENT, [Mistake(source, ABSENT, "is nested too deeply")]
    twice = [
        Mistake(f"{source}, line {line}", ABSENT, f"key `{key}` is given twice", "keep one")
        for key, line in loader.twice
    ]
    return content, twice


def load_study(path: str | Path, designs: str | Path | None = None) -> Study:
    """Read, check and return a study; ConfigError lists every mistake in it.

    Parameters
    ----------
    designs : a front.nc or results.nc, whose designs are taken instead of the sampler's
    """
    path = Path(path)
    raw, mistakes = read_yaml(path)
    if raw is ABSENT:
        raise ConfigError(mistakes, str(path))
    if designs is not None and isinstance(raw, dict):
        raw = raw | {"sampler": {"kind": "given", "file": str(Path(designs).absolute())}}
    return parse_study(raw, folder=path.parent, source=str(path), mistakes=mistakes)


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file, or the scene of a study file."""
    path = Path(path)
    raw, mistakes = read_yaml(path)
    inner = raw.get("scene", raw) if isinstance(raw, dict) else raw
    if raw is not ABSENT:
        expanded = _expand(inner, path.parent, mistakes)
        if expanded is not ABSENT:
            scene = read(_adapter("scene"), expanded, "scene")
            mistakes += scene.mistakes
            if not mistakes:
                return scene.value
    raise ConfigError(mistakes, str(path))


def study_schema() -> dict[str, Any]:
    """JSON schema of a study's YAML, for editors."""
    schema = TypeAdapter(StudyFile).json_schema()
    include = {"type": "object", "required": ["include"], "properties": {"include": {"type": "string"}}}
    schema["properties"]["scene"] = {"anyOf": [schema["properties"]["scene"], {"type": "string"}, include]}
    return schema


# --------------------------------------------------------------------------- checking

_ADAPTERS: dict[str, TypeAdapter[Any]] = {"scene": SCENE}
_KEYS = tuple(f.name for f in fields(StudyFile))


def _adapter(name: str) -> TypeAdapter[Any]:
    if name not in _ADAPTERS:
        _ADAPTERS[name] = TypeAdapter(StudyFile.__pydantic_fields__[name].annotation)  # type: ignore[attr-defined]
    return _ADAPTERS[name]


def _expand(raw: Any, folder: Path, mistakes: list[Mistake], depth: int = 0) -> Any:
    """A scene given as a path, or as ``include`` with changes, as one mapping."""
    if isinstance(raw, str):
        raw = {"include": raw}
    if not isinstance(raw, dict) or "include" not in raw:
        return raw
    path = raw["include"]
    if not isinstance(path, str) or depth > 8:
        problem = (
            "includes itself, or nests too deeply" if isinstance(path, str) else "should be a file's path"
        )
        mistakes.append(Mistake("scene.include", path, problem))
        return ABSENT
    base, found = read_yaml(folder / path)
    mistakes.extend(m._replace(path=f"scene.include ({m.path})") for m in found)
    if base is not ABSENT and not isinstance(base, dict):
        mistakes.append(Mistake("scene.include", path, "the file does not hold a mapping of scene fields"))
        base = ABSENT
    base = _expand(base, (folder / path).parent, mistakes, depth + 1)
    changes = {key: value for key, value in raw.items() if key != "include"}
    return ABSENT if base is ABSENT else deep_merge(base, changes)


def _read_designs(raw: Any, folder: Path, mistakes: list[Mistake]) -> Any:
    """A sampler whose `file` has been read into `values`: the study then stands by itself."""
    if not isinstance(raw, dict) or raw.get("kind") != "given" or not isinstance(raw.get("file"), str):
        return raw
    path = folder / raw["file"]
    try:
        values = designs_in(path)
    except FieldError as error:
        mistakes.append(Mistake("sampler.file", raw["file"], error.problem, error.remedy))
        return ABSENT
    return {key: value for key, value in raw.items() if key != "file"} | {"values": values}


def designs_in(path: str | Path) -> dict[str, list[float | str]]:
    """Design variables of a front.nc or results.nc, design by design; FieldError where there are none."""
    import xarray as xr  # a third of a second, for this alone

    path = Path(path)
    if not path.is_file():
        there = sorted(one.name for one in path.parent.glob("*.nc")) if path.parent.is_dir() else []
        raise FieldError("there is no such file", nearest(path.name, there) or "`sweep pareto DIR` writes DIR/front.nc")
    try:
        with xr.open_dataset(path, engine="netcdf4") as dataset:
            index = "design" if "environment" in dataset.dims else "point"
            columns = {
                str(name): [value if isinstance(value, str) else float(value) for value in column.values.tolist()]
                for name, column in dataset.coords.items()
                if column.dims == (index,) and name not in ("design", "point")
            }
    except (OSError, ValueError, TypeError):
        raise FieldError("is not a file of results", "give a front.nc or a results.nc") from None
    if not columns or not all(columns.values()):
        raise FieldError("holds no designs: it has no design variables, or no points")
    return columns


def parse_study(
    raw: Any, folder: str | Path = ".", source: str = "the study", mistakes: Iterable[Mistake] = ()
) -> Study:
    """A study from the mapping that a YAML holds; ``folder`` is where relative paths start."""
    found = list(mistakes)
    try:
        raw = plain(raw)
    except RecursionError:
        raise ConfigError([*found, Mistake(source, ABSENT, "is nested too deeply")], source) from None
    if not isinstance(raw, dict):
        kind = "is empty" if raw is None else "is not a mapping of keys to values"
        raise ConfigError(
            [*found, Mistake(source, ABSENT, kind, f"a study has the keys {', '.join(_KEYS)}")], source
        )
    given: dict[str, Any] = {}
    unclear: set[str] = set()  # sections that may be given under another name
    for key, meant, sure in match_keys(raw, _KEYS):
        if key != meant:
            found.append(unknown_key(str(key), raw[key], key, _KEYS))
        if meant is not None and sure:
            given[meant] = raw[key]
        elif meant is not None:
            unclear.add(meant)
    given = {key: value for key, value in given.items() if value is not None}
    for key in ("scene", "ask"):
        if key not in given and key not in unclear:
            found.append(Mistake(key, ABSENT, "is required"))
    if "scene" in given:
        given["scene"] = _expand(given["scene"], Path(folder), found)
    if "sampler" in given:
        given["sampler"] = _read_designs(given["sampler"], Path(folder), found)
    draft = Draft(found)
    for key in _KEYS:
        if key in unclear or given.get(key) is ABSENT:
            draft.readings[key] = Reading(holes={()})
        elif key in given:
            draft.readings[key] = read(_adapter(key), given[key], key)
            found += draft.readings[key].mistakes
    _check(draft)
    if found:
        order = {key: i for i, key in enumerate(_KEYS)}
        found.sort(key=lambda mistake: order.get(re.split(r"\W", mistake.path)[0], -1))
        raise ConfigError(found, source)
    parts = {key: reading.value for key, reading in draft.readings.items()}

    objectives = tuple(parts.get("objectives", ("delta", "gamma", "t_settle")))
    repeats = parts.get("repeats", Repeats())
    metrics = parts.get("metrics", MetricsSection())
    constraints = parts.get("constraints", {})
    repeated = dict.fromkeys([*objectives, *(name for name in constraints if name != split_name(name)[0])])
    settings = MetricSettings(
        **asdict(metrics),
        repeats=repeats.n,
        perturbation=repeats.perturbation,
        objectives=tuple(repeated) if repeats.n else (),
        uncertainty=parts.get("uncertainty"),
    )
    entries = parts.get("environments") or (Environment(name="default"),)
    seeds = _seed_paths(draft.scene.tree)
    environments = tuple(one for entry in entries for one in spread_out(entry, seeds))
    if environments != entries:  # what is kept says it all
        given["environments"] = [{"name": one.name, "set": plain(one.set)} for one in environments]
    name = parts.get("name") or Path(source).stem
    return Study(
        name=name,
        description=parts.get("description", ""),
        scene=parts["scene"],
        environments=environments,
        variables=parts.get("variables", {}),
        tied={path: Expression(str(text)) for path, text in parts.get("tied", {}).items()},
        sampler=parts.get("sampler") or (None if parts.get("optimise") else Sampler(n=1)),
        ask=Ask(**asdict(parts["ask"])),
        settings=settings,
        objectives=objectives,
        constraints=constraints,
        optimise=parts.get("optimise") or OptimiseSection(),
        repeats=repeats,
        time_limit=parts.get("time_limit", 600.0),
        memory_limit=parts.get("memory_limit"),
        text=yaml.safe_dump(given | {"name": name}, sort_keys=False, allow_unicode=True),
    )


class Draft:
    """A study under examination: what each section says as far as it is understood, and the mistakes so far."""

    def __init__(self, found: list[Mistake]) -> None:
        self.found = found
        self.readings: dict[str, Reading] = {}

    def add(self, path: str, value: Any, problem: str, remedy: str = "") -> None:
        self.found.append(Mistake(path, value, problem, remedy))

    def get(self, section: str, default: Any = None) -> Any:
        """A section's content, mended; the default where it is not given or not understood."""
        value = self.readings[section].value if section in self.readings else ABSENT
        return default if value is ABSENT else value

    def sure(self, section: str, *place: str | int) -> bool:
        """Whether a value is the one that the study gives: none there is a hole left by a mistake."""
        return section not in self.readings or self.readings[section].sure(*place)

    @property
    def scene(self) -> Reading:
        return self.readings.get("scene") or Reading(holes={()})

    @property
    def outline(self) -> Any:
        """Where field paths may lead: the scene's fields, and those of the ask under ``ask``."""
        tree, ask = self.scene.outline, self.readings.get("ask")
        return tree | {"ask": ABSENT if ask is None else ask.outline} if isinstance(tree, dict) else tree

    @property
    def names(self) -> list[str] | None:
        """The variables' names, those of bad variables too; None where they are not known."""
        reading = self.readings.get("variables", Reading(raw={}))
        return [str(name) for name in reading.raw] if isinstance(reading.raw, dict) else None


@dataclass
class Sound:
    """What of a study's variables, expressions and patches can be tried on the scene."""

    variables: dict[str, Variable] = field(default_factory=dict)
    tied: dict[str, Expression] = field(default_factory=dict)
    patches: list[Patch] = field(default_factory=list)  # one for each environment, seeds apart
    left_out: set[Place] = field(default_factory=set)  # fields of the scene that the others would set


def _check(draft: Draft) -> None:
    """What no single section can know: paths, names, ranges against one another and against the scene."""
    sound = _check_paths(draft)
    _check_sampler(draft)
    _check_ask(draft)
    _check_own(draft, sound)
    _check_metrics(draft)
    _check_objectives(draft)
    _check_constraints(draft)
    _check_optimise(draft)
    if isinstance(draft.scene.tree, dict):
        _check_extremes(draft, sound)
        _check_periodic(draft, sound)


def _check_paths(draft: Draft) -> Sound:
    """That every path leads to a field, that no two set the same, and that expressions know their names."""
    sound = Sound()
    owners: dict[str, str] = {}

    def claim(path: str, where: str, value: Any) -> bool:
        try:
            if path != COUNT:
                lookup(draft.outline, path)
        except FieldError as error:
            if not _in_a_choice(draft, path):
                draft.add(where, value, error.problem, error.remedy)
                return False
        if path in owners:
            draft.add(where, value, f"`{path}` is already set by {owners[path]}")
            return False
        owners[path] = where
        return True

    for key, variable in draft.get("variables", {}).items():
        good = draft.sure("variables", key)
        written = draft.readings["variables"].raw[key]
        given = written.get("field", key) if isinstance(written, dict) else ABSENT
        paths = [path for path in (given if isinstance(given, list) else [given]) if isinstance(path, str)]
        where = f"variables.{key}" + (".field" if isinstance(written, dict) and "field" in written else "")
        fits = [claim(path, where, ABSENT if path == key else path) for path in paths]
        if given == []:
            draft.add(where, ABSENT, "needs at least one field")
        elif good and all(fits) and _can_count(draft, where, variable, paths):
            sound.variables[key] = variable
        else:
            sound.left_out |= {parse(path) for path, fit in zip(paths, fits, strict=True) if fit}
    names = draft.names
    for path, text in draft.get("tied", {}).items():
        where = f"tied.{path}"
        fits = [claim(path, where, ABSENT)]
        if draft.sure("tied", path):
            try:
                expression = Expression(str(text))
            except FieldError as error:
                draft.add(where, text, error.problem, error.remedy)
            else:
                for name in sorted(expression.names - set(names)) if names is not None else ():
                    draft.add(where, text, f"unknown name `{name}`", nearest(name, names or ()))
                for name in sorted(expression.names & sound.variables.keys()):
                    if not sound.variables[name].numeric:
                        draft.add(where, text, f"`{name}` is no number", "set the field in its `choices`")
                        fits = [False]
                if all(fits) and expression.names <= sound.variables.keys():
                    sound.tied[path] = expression
        if all(fits) and path not in sound.tied:
            sound.left_out.add(parse(path))
    _check_environments(draft, sound, dict(owners))
    return sound


def _can_count(draft: Draft, where: str, variable: Variable, paths: Sequence[str]) -> bool:
    """Whether a variable can be the number of devices, if it is to be."""
    devices = lookup(draft.outline, "devices")
    if COUNT not in paths or not isinstance(devices, list):
        return True
    numbers = [variable.setting(value) for _, value in variable.tests] if variable.options is not None else [None]
    most = len(devices)
    if all(isinstance(n, int | float) and float(n).is_integer() and 0 <= n <= most for n in numbers):
        return True
    draft.add(where, ABSENT, f"{COUNT} should be a whole number, 0 to {most}", "write `integer: [lo, hi]`")
    return False


def _in_a_choice(draft: Draft, path: str) -> bool:
    """Whether a path leads into a part that one of the variables' choices brings."""
    for key, variable in draft.get("variables", {}).items():
        choices = variable.choices.values() if isinstance(variable.choices, dict) else ()
        for outer in variable.paths(key) if choices else ():
            with suppress(FieldError, LookupError, TypeError):  # what is wrong with either path is said elsewhere
                parts, head = parse(path), parse(outer)
                lookup(draft.outline, outer)
                inner = parts[len(head)] if parts[: len(head)] == head else ""
                if any(kind_has(draft.scene.tree, outer, c, inner) for c in choices if isinstance(c, Mapping)):
                    return True
    return False


def _check_environments(draft: Draft, sound: Sound, owners: Mapping[str, str]) -> None:
    """That environments set fields which exist and which no design variable has, and have names of their own."""
    seen: set[str] = set()
    seeds = _seed_paths(draft.scene.tree)
    for i, environment in enumerate(draft.get("environments", ())):
        taken = dict(owners)
        for part, given in (("set", environment.set), ("grid", environment.grid)):
            for path, value in given.items():
                where, value = f"environments[{i}].{part}.{path}", list(value) if part == "grid" else value
                if path in taken:
                    draft.add(where, value, f"is already set by {taken[path]}")
                    continue
                try:
                    lookup(draft.outline, path)
                except FieldError as error:
                    draft.add(where, value, error.problem, error.remedy)
                else:
                    taken[path] = where
        if environment.seeds is not None and draft.sure("environments", i, "seeds"):
            where, written = f"environments[{i}].seeds", environment.seeds
            written = list(written) if isinstance(written, tuple) else written
            if isinstance(draft.scene.tree, dict) and not seeds and not draft.scene.holes:
                remedy = "give an end's `motion` a `stochastic` part, or leave `seeds` out"
                draft.add(where, written, "draws stochastic motions, of which the scene has none", remedy)
            for path in [path for path in seeds if path in taken]:
                draft.add(where, written, f"`{path}` is already set by {taken[path]}", "leave one of them out")
        sure_of = {f"environments[{i}].{part}.{path}" for part in ("set", "grid")
                   for path in getattr(environment, part) if draft.sure("environments", i, part, path)}  # fmt: skip
        good = [path for path, where in taken.items() if where in sure_of]
        sure = draft.sure("environments", i, "name") and draft.sure("environments", i, "grid")
        for spread in spread_out(environment, seeds):
            if sure and draft.sure("environments", i, "seeds"):
                if spread.name in seen:
                    draft.add(f"environments[{i}].name", spread.name, "is used twice", "give each its own name")
                seen.add(spread.name)
            wanted = {path: value for path, value in spread.set.items() if path in good}
            if wanted not in [patch.set for patch in sound.patches if patch.entry == i]:
                places = {path: taken[path] for path in wanted}
                sound.patches.append(Patch(i, spread.name, wanted, places))


def _check_sampler(draft: Draft) -> None:
    sampler, names = draft.get("sampler"), draft.names
    if sampler is not None and sampler.kind == "given":
        _check_given(draft, sampler)
        return
    if sampler is None:
        if names and not draft.readings.keys() & {"sampler", "optimise"}:
            draft.add(
                "sampler", ABSENT, "is required with `variables`", "e.g. {kind: sobol, n: 100, seed: 0}"
            )
        return
    for key in sampler.levels:
        if names is not None and key not in names:
            draft.add(f"sampler.levels.{key}", sampler.levels[key], "no such variable", nearest(key, names))
    if sampler.kind == "grid" and sampler.n is None and draft.sure("sampler"):
        for key, variable in draft.get("variables", {}).items():
            if variable.options is None and key not in sampler.levels:
                draft.add("sampler", ABSENT, f"a grid needs `n`, or `levels` for `{key}`", "e.g. n: 5")


def _check_given(draft: Draft, sampler: Sampler) -> None:
    """That given designs name the study's variables, all of them, once each, and keep to their ranges."""
    if not draft.sure("sampler", "values") or draft.names is None:
        return
    names, variables = draft.names, draft.get("variables", {})
    if sampler.n is not None:
        draft.add("sampler.n", sampler.n, "has no say over given designs", "remove it; --limit runs the first ones")
    if not sampler.values:
        draft.add("sampler", ABSENT, "given designs need `file` or `values`", "e.g. {kind: given, file: out/front.nc}")
        return
    for key in [key for key in sampler.values if key not in names]:
        draft.add(f"sampler.values.{key}", ABSENT, "the study has no such variable", nearest(key, names))
    for key in [key for key in names if key not in sampler.values]:
        draft.add("sampler.values", ABSENT, f"the given designs have no `{key}`", nearest(key, sampler.values))
    lengths = {key: len(column) for key, column in sampler.values.items()}
    if len(set(lengths.values())) > 1 or not all(lengths.values()):
        text = ", ".join(f"{key}: {n}" for key, n in lengths.items())
        draft.add("sampler.values", ABSENT, f"should have a value of each variable for each design, not {text}")
    for key, variable in variables.items():
        if not draft.sure("variables", key):
            continue
        for i, value in enumerate(sampler.values.get(key, ())):
            if not variable.holds(value):
                place, ends = f"sampler.values.{key}[{i}]", variable.log or variable.linear
                listed = [str(v) for v in variable.labels or variable.options or ()]
                allowed = f"{ends[0]:g} to {ends[1]:g}" if ends else ", ".join(listed)
                draft.add(place, value, f"is outside the variable's range, {allowed}", f"widen variables.{key}")


def _check_ask(draft: Draft) -> None:
    ask = draft.get("ask")
    if ask is None:
        return
    models = ["auto", *solvers.MODELS]
    methods = list(
        dict.fromkeys(["auto", *solvers.METHODS, "explicit", "rk2", "rk4", "genalpha", "implicit"])
    )
    if draft.sure("ask", "model") and ask.model not in models:
        draft.add("ask.model", ask.model, "no such model", nearest(ask.model, models))
    if draft.sure("ask", "method") and ask.method not in methods:
        draft.add("ask.method", ask.method, "no such method", nearest(ask.method, methods))
    if not (draft.sure("ask", "duration") and draft.sure("ask", "interval")):
        return
    if 0 < ask.duration < ask.interval:
        draft.add("ask.interval", ask.interval, f"should be at most the duration, {ask.duration:g} s")
    elif ask.duration / ask.interval > 1e7:
        draft.add(
            "ask.interval",
            ask.interval,
            "asks for more than ten million output times",
            "give a longer interval or a shorter duration",
        )
    last = min(int(ask.duration / ask.interval + 1e-9) * ask.interval, ask.duration)
    if draft.sure("ask", "output_from") and ask.output_from > last:
        draft.add("ask.output_from", ask.output_from, f"should be at most the last output time, {last:g} s")


FAMILY = tuple(name for name, line in solvers.MODELS.items() if line.constrained)  # rods, catenaries, hybrids
SCALED = tuple(name for name, line in solvers.MODELS.items() if "mass_scaling" in line.reads)


def _check_own(draft: Draft, sound: Sound) -> None:
    """What only some lines read, against the model; a model that varies is not known here."""
    ask = draft.get("ask")
    varied = {path for key, variable in sound.variables.items() for path in variable.paths(key)}
    varied |= {path for patch in sound.patches for path in patch.set} | sound.tied.keys()
    if ask is None or not draft.sure("ask", "model") or "ask.model" in varied:
        return
    if draft.sure("ask", "rods") and ask.rods is not None and ask.model != "hybrid":
        given = [list(pair) for pair in ask.rods]
        draft.add("ask.rods", given, f"only a hybrid has rods in places, not `{ask.model}`", "write `model: hybrid`")
    if "ask.mass_scaling" in varied and ask.model not in SCALED:
        problem = "does not read `ask.mass_scaling`, which is varied"
        draft.add("ask.model", ask.model, problem, f"write `model: {SCALED[0]}`")
    elif draft.sure("ask", "mass_scaling") and ask.mass_scaling is not None and ask.model not in SCALED:
        problem = f"slows free motions of {', '.join(SCALED)} alone, not of `{ask.model}`"
        draft.add("ask.mass_scaling", ask.mass_scaling, problem, f"remove it, or write `model: {SCALED[0]}`")
    if draft.sure("ask", "rho_space") and ask.rho_space != 1 and ask.model not in FAMILY:
        problem = f"damps along s in {', '.join(FAMILY)} alone, not in `{ask.model}`"
        draft.add("ask.rho_space", ask.rho_space, problem, "remove it, or name one of these models")
    elif draft.sure("ask", "rho_space") and ask.rho_space < 1 and ask.duration > 0 and "ask.duration" not in varied:
        problem = "damps along s at rest alone: in motion, what travels towards end A would grow"
        draft.add("ask.rho_space", ask.rho_space, problem, "remove it (`rho` damps in time), or write `duration: 0`")


def _check_metrics(draft: Draft) -> None:
    """The metrics' times against the run, and their places against the cable."""
    ask, metrics, scene = draft.get("ask"), draft.get("metrics"), draft.scene
    if metrics is None:
        return
    timed = ask is not None and draft.sure("ask", "duration")
    windowed = draft.sure("metrics", "window")
    window = metrics.window if windowed else None
    if timed and window and draft.sure("ask", "output_from") and window[0] < ask.output_from * (1 - 1e-12):
        where = f"begins before `ask.output_from`, {ask.output_from:g} s"
        draft.add("metrics.window", list(window), where, "give a later window or an earlier `output_from`")
    if timed and window and window[1] > ask.duration * (1 + 1e-12):
        draft.add("metrics.window[1]", window[1], f"should be at most the duration, {ask.duration:g} s")
    if draft.sure("metrics", "pulse_end") and metrics.pulse_end > 0 and windowed and (window or timed):
        end = window[1] if window else ask.duration
        if metrics.pulse_end >= end:
            draft.add(
                "metrics.pulse_end", metrics.pulse_end, f"should be less than the window's end, {end:g} s"
            )
    if metrics.probe is None or not draft.sure("metrics", "probe") or not isinstance(scene.tree, dict):
        return
    length = sum(float(section["length"]) for section in scene.tree["cable"])
    if metrics.probe > length and not follows("cable", (), scene.holes):
        draft.add("metrics.probe", metrics.probe, f"should be on the cable, 0 to {length:g} m")


def _check_objectives(draft: Draft) -> None:
    objectives = draft.get("objectives")
    if objectives is None or (not objectives and not draft.sure("objectives")):
        return
    devices = lookup(draft.scene.outline, "devices")
    count = len(devices) if isinstance(devices, list) else None
    good = [name for name, metric in METRICS.items() if metric.direction]
    for i, name in enumerate(objectives):
        if not draft.sure("objectives", i):
            continue
        where = f"objectives[{i}]"
        metric = find_metric(name, count)
        said = split_name(name)[1]
        said = said[said[:1] == ("ensemble",) :]
        if metric is None or len(said) > 1 or {"spread", "sd", "ensemble"} & set(said):
            draft.add(where, name, "unknown metric", nearest(name, good))
        elif metric.direction is None:
            problem = "neither more nor less of it is better, so it cannot be an objective"
            draft.add(where, name, problem, f"allowed: {', '.join(good)}")
        elif why := _never_known(draft, name, metric):
            draft.add(where, name, *why)
        elif said and said[0][0] == "q" and (int(said[0][1:]) > 50) != (metric.direction == "min"):
            problem = f"is the good tail: of this metric {'less' if metric.direction == 'min' else 'more'} is better"
            draft.add(where, name, problem, f"write {name.removesuffix(said[0])}q{100 - int(said[0][1:]):02d}")
        if name in objectives[:i]:
            draft.add(where, name, "is given twice")
    if not objectives:
        draft.add("objectives", ABSENT, "needs at least one metric", f"allowed: {', '.join(good)}")


def _check_constraints(draft: Draft) -> None:
    """That results will hold a number of each: no trusted point keeps a bound on a number that there is not."""
    devices = lookup(draft.scene.outline, "devices")
    count = len(devices) if isinstance(devices, list) else None
    for name in draft.get("constraints", {}):
        if name in DESIGN_QUANTITIES:
            continue
        metric = find_metric(name, count)
        if metric is None:
            draft.add(f"constraints.{name}", ABSENT, "unknown metric", nearest(name, [*METRICS, *DESIGN_QUANTITIES]))
        elif not _held(name, metric):
            remedy = f"bound `{split_name(name)[0]}`; `sweep metrics` says what may follow it"
            draft.add(f"constraints.{name}", ABSENT, "is a column that results do not have", remedy)
        elif why := _never_known(draft, name, metric):
            draft.add(f"constraints.{name}", ABSENT, *why)


def _held(name: str, metric: Metric) -> bool:
    """Whether results may have a metric's column of this name, or make it from one; see ``dataset``, ``pareto``."""
    said = split_name(name)[1]
    if said and said[-1] in ("spread", "sd"):
        stored = ["mean", "worst", f"q{bad_tail(metric)}"] if metric.direction else ["mean"]
        return len(said) == 1 or (said[-1] == "sd" and len(said) == 2 and said[0] in stored)
    said = said[said[:1] == ("ensemble",) :]
    return not said or (len(said) == 1 and said[0] != "ensemble" and (bool(metric.direction) or said[0] == "mean"))


def _never_known(draft: Draft, name: str, metric: Metric) -> tuple[str, str] | None:
    """Why a metric, or what is said of it, can have no number in this study, and the remedy; None where it can."""
    stem, said = split_name(name)
    environments, repeats = draft.get("environments", ()), draft.get("repeats")
    several = sum(len(spread_out(entry, ["seed"])) for entry in environments) > 1
    if metric.needs and not _given(draft, metric.needs):
        return f"cannot be read without `metrics.{metric.needs}`", "give it, or drop this"
    if any(AGGREGATES.fullmatch(word) for word in said) and not several and draft.sure("environments"):
        return "aggregates need at least two `environments`", ""
    if {"ensemble", "spread"} & set(said):
        if draft.sure("repeats") and not (repeats and repeats.n):
            return "is read from perturbed runs", "write e.g. `repeats: {n: 4}`"
        objectives = [split_name(one)[0] for one in draft.get("objectives", StudyFile.objectives)]
        if draft.sure("objectives") and stem not in objectives:
            return "is known of objectives only", f"add `{stem}` to the `objectives`, or drop this"
    asked = metric.name in ("chaos", "chaos_saturated") or "sd" in said
    if asked and draft.sure("uncertainty") and draft.get("uncertainty") is None:
        return "is known only from an `uncertainty` section", "e.g. uncertainty: {runs: 4}"
    return None


def _check_optimise(draft: Draft) -> None:
    section, objectives = draft.get("optimise"), draft.get("objectives", StudyFile.objectives)
    if section is None:
        return
    if draft.names == []:
        draft.add("optimise", ABSENT, "there is nothing to choose", "give the study `variables`")
    if not draft.sure("objectives"):
        return
    if section.algorithm == "nsga3" and len(objectives) < 2:
        draft.add("optimise.algorithm", "nsga3", "needs at least two objectives", "use nsga2")
    for name in section.reference:
        if name not in objectives:
            value = section.reference[name]
            draft.add(f"optimise.reference.{name}", value, "no such objective", nearest(name, objectives))
    missing = [name for name in objectives if name not in section.reference]
    if section.reference and missing:
        draft.add("optimise.reference", ABSENT, f"needs a value for {', '.join(missing)}", "or leave it out")


def _given(draft: Draft, path: str) -> bool:
    """Whether a field of the study's `metrics` is given, or may be where a mistake hides it."""
    here = draft.get("metrics")
    for name in path.split("."):
        here = getattr(here, name, None)
    return here is not None or not draft.sure("metrics", *path.split("."))


def _check_extremes(draft: Draft, sound: Sound) -> None:
    """Build the scene at both ends of every variable, the others mid-range, and in every environment.

    A variable of a part that some choices bring is tried with each of them. Devices may meet where one of them moves:
    such a design is a row that says so, and no mistake.
    """
    scene, schema = draft.scene, SCENE.json_schema()
    holes = scene.holes | sound.left_out
    Problems = dict[tuple[str, str], Mistake]  # by field path and sentence

    asked = draft.readings.get("ask") or Reading(holes={()})
    ask_schema = _adapter("ask").json_schema()

    def problems(wanted: Mapping[str, Any]) -> Problems:
        """Each thing wrong with the scene and the ask once these fields are set."""
        found: Problems = {}
        for adapter, reading, prefix, outline, changes in (
            (SCENE, scene, "", schema, apart(wanted)[0]),
            (_adapter("ask"), asked, "ask", ask_schema, apart(wanted)[1]),
        ):
            tree = plain(reading.tree)
            if not isinstance(tree, dict):
                continue
            place(tree, changes, strict=False)  # a path may lead into what a mistake has made unknown
            unclear = holes if prefix == "" else reading.holes
            try:
                good = adapter.validate_python(tree)
            except ValidationError as error:
                found |= {
                    (fault.mistake.path, fault.mistake.problem): fault.mistake
                    for fault in faults(error, tree, prefix, outline)
                    if not (fault.sentence and follows(fault.sentence, fault.at, unclear))
                }
                continue
            if prefix == "":
                length = good.length
            elif good.rods and good.rods[-1][1] > length * (1 + 1e-9) and asked.sure("rods"):
                last = f"ask.rods[{len(good.rods) - 1}][1]"
                mistake = Mistake(last, good.rods[-1][1], f"should be on the cable, 0 to {length:g} m")
                found[mistake.path, mistake.problem] = mistake
        return found

    def design(values: Mapping[str, float], patch: Mapping[str, Any]) -> Problems:
        wanted, wrong = dict(patch), {}
        for key, variable in sound.variables.items():
            wanted.update(dict.fromkeys(variable.paths(key), variable.setting(values[key])))
        numbers = {key: sound.variables[key].shown(value) for key, value in values.items()}
        for path, expression in sound.tied.items():
            try:
                wanted[path] = expression.value(numbers)
            except FieldError as error:
                wrong[f"tied.{path}", error.problem] = Mistake(f"tied.{path}", ABSENT, error.problem)
        found = {key: value for key, value in (wrong | problems(wanted)).items() if key not in own}
        return {key: value for key, value in found.items() if not (moving and "at the same place" in value.problem)}

    def say(where: str, value: Any, mistake: Mistake) -> None:
        draft.add(where, value, f"{mistake.path or 'the scene'}: {mistake.problem}", mistake.remedy)

    own = problems({})  # those of the scene and the ask themselves, which are reported
    draft.found += [m for (path, _), m in own.items() if path.startswith("ask.rods") and "on the cable" in m.problem]
    moving = any(path.endswith("].s") for key, variable in sound.variables.items() for path in variable.paths(key))
    middle = {
        key: variable.at(1.0 if COUNT in variable.paths(key) else 0.5) for key, variable in sound.variables.items()
    }
    usual = design(middle, {})
    parts = [  # every choice of a whole part, with whose fields other variables are tried
        {key: float(i)}
        for key, variable in sound.variables.items()
        for i, option in enumerate(variable.options or () if variable.choices else ())
        if isinstance(option, Mapping)
    ]
    blamed: set[tuple[str, str]] = set()
    for key, variable in sound.variables.items():
        for where, value in variable.tests:
            seen: set[tuple[str, str]] = set()
            for part in [{}, *(part for part in parts if key not in part)]:
                wrong = design(middle | part | {key: value}, {})
                known = usual if not part else usual | design(middle | part, {})
                inside = tuple(f"{path}." for path in variable.paths(key) if variable.choices)
                mine = [
                    problem
                    for problem, mistake in wrong.items()
                    if mistake.path in variable.paths(key) or mistake.path.startswith(inside)
                ]
                for problem in mine or [problem for problem in wrong if problem not in known]:
                    if problem not in seen:
                        say(f"variables.{key}.{where}", variable.shown(value), wrong[problem])
                    seen.add(problem)
                blamed.update(wrong if mine else ())
    for problem in [problem for problem in usual if problem not in blamed]:
        say("variables", ABSENT, usual[problem]._replace(path=f"mid-range, {usual[problem].path}"))
    told: set[tuple[str, Any, str]] = set()  # a value of a grid is tried with each of the other fields' values
    for patch in sound.patches:
        for problem, mistake in design(middle, patch.set).items():
            if problem in usual:
                continue
            at = patch.places.get(mistake.path, "")
            words = (at or f"environments[{patch.entry}]", repr(patch.set.get(mistake.path)), mistake.problem)
            if words in told:
                continue
            told.add(words)
            if at:
                draft.add(at, patch.set[mistake.path], mistake.problem, mistake.remedy)
            else:
                kind = "set" if all(".set." in place for place in patch.places.values()) else "grid"
                say(f"environments[{patch.entry}].{kind}", ABSENT, mistake)


def _check_periodic(draft: Draft, sound: Sound) -> None:
    """Whether harmonic balance, where it is asked for, can serve the scene mid-range and in every environment."""
    ask = draft.get("ask")
    if ask is None or ask.method != "harmonic" or draft.scene.mistakes or sound.left_out:
        return
    harmonics = ask.harmonics if draft.sure("ask", "harmonics") else None
    middle = {key: variable.at(0.5) for key, variable in sound.variables.items()}
    reasons: dict[str, list[str]] = {}  # environments by reason
    for patch in sound.patches or [Patch(-1, "", {}, {})]:
        tree = plain(draft.scene.tree)
        try:
            wanted = dict(patch.set)
            for key, variable in sound.variables.items():
                wanted.update(dict.fromkeys(variable.paths(key), variable.setting(middle[key])))
            numbers = {key: sound.variables[key].shown(value) for key, value in middle.items()}
            wanted |= {path: expression.value(numbers) for path, expression in sound.tied.items()}
            place(tree, apart(wanted)[0])
            reason = why_not(SCENE.validate_python(tree), harmonics)
        except (FieldError, ValidationError, KeyError, IndexError, TypeError):
            continue  # a mistake that is reported elsewhere
        if reason:
            reasons.setdefault(reason, []).append(patch.name)
    for reason, names in reasons.items():
        where = f"in {', '.join(names)}: " if names != [""] and len(names) < len(sound.patches) else ""
        remedy = "use `method: explicit`, or `auto`, or a scene with a settled periodic response"
        draft.add("ask.method", ask.method, f"harmonic balance cannot serve the scene: {where}{reason}", remedy)
