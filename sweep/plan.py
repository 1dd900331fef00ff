"""What will run: designs, points, their keys and predicted costs, written once as ``plan.json``, read by every worker.

The plan holds the designs themselves, so that workers with another scipy run the same points. It is JSON with a line
for each design and each point, read line by line into arrays: a million points take 12 bytes each, and 8 more
for each design variable.
"""

from __future__ import annotations

import errno
import heapq
import json
import os
import socket
import time
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from solvers import Response

from .config import ConfigError, Study
from .evaluate import run_trusted
from .mistakes import ABSENT, Mistake
from .point import Order, Point
from .space import baseline_model, baseline_scene, design_values, extremes, made, make_point, point_key

FORMAT = 2
READ_ATTEMPTS = 5  # of a plan that another node is replacing; network file systems close the old one
MOST_BASELINES = 100  # that a plan lists


class Keys(Sequence[str]):
    """Keys of points, 8 bytes each instead of the 65 of a string."""

    def __init__(self, numbers: np.ndarray) -> None:
        self.numbers = numbers  # (n,) uint64
        self._order: np.ndarray | None = None

    @classmethod
    def of(cls, texts: Sequence[str]) -> Keys:
        return cls(np.array([int(text, 16) for text in texts], dtype=np.uint64))

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return [f"{number:016x}" for number in self.numbers[i]]
        return f"{int(self.numbers[i]):016x}"

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Keys):
            return np.array_equal(self.numbers, other.numbers)
        return isinstance(other, Sequence) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __contains__(self, text: object) -> bool:
        return len(self.places(str(text))) > 0

    def index(self, text: str, *bounds: int) -> int:
        """First place of a key; ValueError where it has none."""
        found = self.places(text)
        if not len(found):
            raise ValueError(f"{text} is not a key of the plan")
        return int(found.min())

    def places(self, text: str) -> np.ndarray:
        """All places of a key; equal physics can stand in several designs."""
        try:
            number = np.uint64(int(text, 16))
        except (ValueError, OverflowError):
            return self.order[:0]
        begin = end = int(np.searchsorted(self.numbers, number, sorter=self.order))
        while end < len(self) and self.numbers[self.order[end]] == number:
            end += 1
        return self.order[begin:end]

    @property
    def order(self) -> np.ndarray:
        """(n,) places by rising key, equal keys by place; of the kind that numpy searches without a copy."""
        if self._order is None:
            self._order = np.argsort(self.numbers, kind="stable")
        return self._order

    def firsts(self) -> np.ndarray:
        """(n,) bool: whether a place is its key's first."""
        found = np.zeros(len(self), dtype=bool)
        found[np.unique(self.numbers, return_index=True)[1]] = True
        return found


class Designs(Sequence[dict[str, float]]):
    """Values of the design variables, one row of an array for each design."""

    def __init__(self, names: Sequence[str], values: np.ndarray) -> None:
        self.names, self.values = tuple(names), values  # (n, variables) float

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return Designs(self.names, self.values[i])
        return dict(zip(self.names, map(float, self.values[i]), strict=True))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Designs) and self.names == other.names and np.array_equal(self.values, other.values)

    __hash__ = None  # type: ignore[assignment]

    def column(self, name: str) -> np.ndarray:
        return self.values[:, self.names.index(name)]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The points of a study in the order in which they are handed out: a design's environments together."""

    study: str  # name
    text: str  # the study's YAML, without includes
    designs: Designs
    environments: list[str]
    keys: Keys  # of point i: design i // n_environment, environment i % n_environment
    ask: dict[str, Any]  # model, method, mesh, tolerance as asked
    settings: dict[str, Any]
    baselines: list[dict[str, Any]]  # the most shared ones: name, key, how many points share it
    different: int  # baselines in all
    costs: np.ndarray = field(compare=False)  # (n,) float32: predicted work of each point, 0 where none is left

    def __len__(self) -> int:
        return len(self.keys)

    def order(self, i: int) -> Order:
        """Point ``i`` as it is handed out: small, made a point where it is run."""
        design, environment = divmod(int(i), len(self.environments))
        return Order(key=self.keys[i], design=design, environment=environment, values=self.designs[design])

    def point(self, study: Study, i: int) -> Point:
        """Point ``i``, ready to run; ConfigError where the study is not the one that was planned."""
        return made(study, self.order(i))

    def points(self, study: Study, part: tuple[int, int] | None = None) -> Iterator[Point]:
        """All distinct points, or those of slice K of N."""
        return (self.point(study, i) for i in self.slice(*(part or (0, 1))))

    def slice(self, k: int, n: int) -> np.ndarray:
        """Places of slice ``k`` of ``n``, ascending: each point, the dearest first, joins the slice that is cheapest.

        Equal physics counts once. Without predictions all points cost alike, and a slice is every n-th of them.
        """
        if not (n >= 1 and 0 <= k < n):
            raise ValueError(f"part {k}/{n}: K must be 0 to N-1")
        chosen = np.flatnonzero(self.keys.firsts()).astype(np.int32)
        costs = self.costs[chosen].astype(float)
        owner = np.arange(len(chosen), dtype=np.int32) % n
        if n > 1 and len(costs) and np.ptp(costs) > 0:
            heap = [(0.0, slot) for slot in range(n)]
            for place in np.argsort(-costs, kind="stable"):
                load, slot = heap[0]
                owner[place] = slot
                heapq.heapreplace(heap, (load + costs[place], slot))
        return chosen[owner == k]


@dataclass(frozen=True)
class Orders:
    """Points of a plan in the order in which they are handed out: arrays, of which each is made when it is asked for.

    A stretch of it travels to a rank in some microseconds.
    """

    names: tuple[str, ...]  # of the design variables
    environments: int
    places: np.ndarray  # (n,) in the plan
    numbers: np.ndarray  # (n,) keys
    values: np.ndarray  # (n, variables), or those of all designs before it is cut
    whole: bool = True  # values are those of all designs

    @classmethod
    def of(cls, plan: Plan, places: np.ndarray) -> Orders:
        return cls(plan.designs.names, len(plan.environments), places, plan.keys.numbers, plan.designs.values)

    def __len__(self) -> int:
        return len(self.places)

    def batch(self, begin: int, end: int) -> Orders:
        """Orders ``begin`` to ``end``, with no more than their own values."""
        places = self.places[begin:end]
        return Orders(
            self.names, self.environments, places, self.numbers[places], self.values[places // self.environments], False
        )

    def __iter__(self) -> Iterator[Order]:
        for i, place in enumerate(map(int, self.places)):
            design, environment = divmod(place, self.environments)
            row = self.values[design if self.whole else i]
            yield Order(
                key=f"{int(self.numbers[place if self.whole else i]):016x}",
                design=design,
                environment=environment,
                values=dict(zip(self.names, row.tolist(), strict=True)),
            )


def make_plan(study: Study, limit: int | None = None) -> Plan:
    """The plan of a study; ``limit`` takes its first designs. The same study gives the same plan."""
    return plan_of(study, design_values(study, limit))


def plan_of(study: Study, table: np.ndarray) -> Plan:
    """A plan of given designs, (n_design, n_variable) values of the study's variables."""
    chosen = Designs(tuple(study.variables), table)
    name = study.settings.baseline
    numbers, bases = array("Q"), array("Q")
    for i, values in enumerate(chosen):
        for e in range(len(study.environments)):
            point = make_point(study, i, e, values)
            numbers.append(int(point.key, 16))
            base = point_key(baseline_scene(point.scene, name), baseline_model(point.ask, name))
            bases.append(int(base, 16))
    found, firsts, shared = np.unique(np.array(bases, np.uint64), return_index=True, return_counts=True)
    listed = np.lexsort((firsts, -shared))[:MOST_BASELINES]
    return Plan(
        study=study.name,
        text=study.text,
        designs=chosen,
        environments=[environment.name for environment in study.environments],
        keys=Keys(np.array(numbers, dtype=np.uint64)),
        ask=asdict(study.ask),
        settings=asdict(study.settings),
        baselines=[{"name": name, "key": f"{found[i]:016x}", "points": int(shared[i])} for i in listed],
        different=len(found),
        costs=np.ones(len(numbers), dtype=np.float32),
    )


def joined(first: Plan, second: Plan) -> Plan:
    """One plan of the designs of two plans of a study, those of the first before the others."""
    shared: Counter[str] = Counter()
    for plan in (first, second):
        shared.update({base["key"]: base["points"] for base in plan.baselines})
    name = second.settings["baseline"]
    listed = [{"name": name, "key": key, "points": n} for key, n in shared.most_common(MOST_BASELINES)]
    whole = max(first.different, second.different) <= MOST_BASELINES  # of which all are listed
    return replace(
        second,
        designs=Designs(second.designs.names, np.vstack([first.designs.values, second.designs.values])),
        keys=Keys(np.concatenate([first.keys.numbers, second.keys.numbers])),
        baselines=listed,
        different=len(shared) if whole else max(first.different, second.different),
        costs=np.concatenate([first.costs, second.costs]),
    )


# --------------------------------------------------------------------------- on disk

_HEADER = [f.name for f in fields(Plan) if f.name not in ("designs", "keys", "costs")]


def write_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan whole, under a temporary name first."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{socket.gethostname()}.{os.getpid()}")
    with temporary.open("w", encoding="utf-8") as file:
        _write(plan, file)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def _write(plan: Plan, file: TextIO) -> None:
    head = {"format": FORMAT} | {name: getattr(plan, name) for name in _HEADER} | {"variables": plan.designs.names}
    file.write("{\n")
    for name, value in head.items():
        file.write(f"{json.dumps(name)}: {json.dumps(value, ensure_ascii=False)},\n")
    file.write('"designs": [')
    for i, row in enumerate(plan.designs.values):
        file.write(("," if i else "") + "\n" + json.dumps(row.tolist(), separators=(",", ":")))
    file.write('\n],\n"points": [')
    for i, (number, cost) in enumerate(zip(plan.keys.numbers, plan.costs, strict=True)):
        file.write(("," if i else "") + f'\n["{number:016x}",{float(f"{cost:.6g}")!r}]')
    file.write("\n]\n}\n")


def read_plan(path: str | Path) -> Plan:
    """Read a plan; ConfigError where the file is not one."""
    path = Path(path)
    for attempt in range(READ_ATTEMPTS):
        try:
            with path.open(encoding="utf-8") as file:
                return _read(file)
        except FileNotFoundError:
            why = "there is no such file"
        except OSError as error:
            if error.errno == errno.ESTALE and attempt < READ_ATTEMPTS - 1:  # replaced meanwhile on another node
                time.sleep(0.2)
                continue
            why = f"cannot be read: {error.strerror or error}"
        except (ValueError, KeyError, TypeError, AttributeError, IndexError):
            why = "is not a plan of this version; remove it, and `sweep run` makes it anew"
        break
    raise ConfigError([Mistake(str(path), ABSENT, why)], str(path))


def _read(file: TextIO) -> Plan:
    head = []
    for line in file:
        if line.startswith('"designs": ['):
            break
        head.append(line)
    else:
        return _read_first_format(json.loads("".join(head)))
    content = json.loads("".join(head).rstrip().rstrip(",") + "}")
    if content.pop("format") != FORMAT:
        raise ValueError("another format")
    names = content.pop("variables")
    values, numbers, costs = array("d"), array("Q"), array("f")
    for row in _rows(file):
        if len(row) != len(names):
            raise ValueError("a design with other variables")
        values.extend(row)
    count = len(values) // max(len(names), 1) if names else 1
    if not file.readline().startswith('"points": ['):
        raise ValueError("no points")
    for key, cost in _rows(file):
        numbers.append(int(key, 16))
        costs.append(cost)
    if len(numbers) != count * len(content["environments"]):
        raise ValueError("designs and points do not agree")
    return Plan(
        designs=Designs(names, np.frombuffer(values).reshape(count, len(names)) if names else np.zeros((count, 0))),
        keys=Keys(np.frombuffer(numbers, dtype=np.uint64)),
        costs=np.frombuffer(costs, dtype=np.float32),
        **_with_tuples(content),
    )


def _rows(file: TextIO) -> Iterator[list[Any]]:
    for line in file:
        if line.startswith("]"):
            return
        yield json.loads(line.rstrip("\n").rstrip(","))
    raise ValueError("the file is cut off")


def _with_tuples(content: dict[str, Any]) -> dict[str, Any]:
    content["settings"]["objectives"] = tuple(content["settings"]["objectives"])
    if content["settings"]["window"] is not None:
        content["settings"]["window"] = tuple(content["settings"]["window"])
    return content


def _read_first_format(content: dict[str, Any]) -> Plan:
    """A plan as it was written before plans had costs: designs as tables, keys as a list."""
    if content.pop("format") != 1:
        raise ValueError("another format")
    rows, keys = content.pop("designs"), content.pop("keys")
    names = tuple(rows[0])
    values = np.array([[row[name] for name in names] for row in rows]).reshape(len(rows), len(names))
    return Plan(
        designs=Designs(names, values),
        keys=Keys.of(keys),
        different=len(content["baselines"]),
        costs=np.ones(len(keys), dtype=np.float32),
        **_with_tuples(content),
    )


# --------------------------------------------------------------------------- predicted costs


def predicted(plan: Plan, known: dict[int, float]) -> np.ndarray:
    """Work of every point, fitted to the work of some.

    The logarithm of the work is taken linear in each variable (by rank) and to have a level for each environment;
    a ridge keeps what the known points do not tell at their mean, and predictions stay within a factor of two of
    the range seen.

    Parameters
    ----------
    known : place in the plan: counted work (> 0) of points that were run

    Returns
    -------
    (n,) float32; 1 everywhere where fewer than three points are known
    """
    places = np.array([i for i, work in sorted(known.items()) if work > 0], dtype=int)
    if len(places) < 3:
        return np.ones(len(plan), dtype=np.float32)
    work = np.log([known[i] for i in places])
    ranks = np.empty((len(plan.designs), len(plan.designs.names)), dtype=np.float32)
    for j in range(len(plan.designs.names)):
        levels, where = np.unique(plan.designs.values[:, j], return_inverse=True)
        ranks[:, j] = where / max(len(levels) - 1, 1) - 0.5
    m = len(plan.environments)
    features = np.hstack([ranks[places // m], np.eye(m)[places % m] - 1 / m])
    centre = features.mean(axis=0)
    a = features - centre
    weights = np.linalg.solve(a.T @ a + 0.1 * np.eye(a.shape[1]), a.T @ (work - work.mean()))
    slopes, levels = np.split(weights, [len(plan.designs.names)])
    base = work.mean() - centre @ weights - levels.sum() / m
    found = (ranks @ slopes + base)[:, None] + levels[None, :]
    found = np.clip(found.ravel(), work.min() - np.log(2), work.max() + np.log(2))
    found[places] = work
    return np.exp(found - work.mean()).astype(np.float32)


def pilot_places(plan: Plan, count: int) -> list[int]:
    """Places of ``count`` points spread over the designs, with the environments in turn."""
    n, m = len(plan.designs), len(plan.environments)
    picked = np.unique(np.linspace(0, n - 1, min(count, n)).round().astype(int))
    return [int(design) * m + j % m for j, design in enumerate(picked)]


# --------------------------------------------------------------------------- what it will cost


@dataclass(frozen=True, kw_only=True)
class PilotRun:
    """Counted work of one design of the study."""

    label: str
    values: dict[str, float]
    response: Response

    @property
    def work(self) -> int:
        """Steps, rejected ones too, times nodes."""
        cost = self.response.cost
        return (cost.steps + cost.rejected) * (self.response.segments + 1)


def pilot(study: Study) -> list[PilotRun]:
    """Run the first design and those with every variable at its least and at its greatest."""
    chosen = extremes(study)
    points = {label: make_point(study, 0, 0, values) for label, values in chosen.items()}
    return [
        PilotRun(label=label, values=point.values, response=run_trusted(point.scene, point.ask).response)
        for label, point in points.items()
    ]
