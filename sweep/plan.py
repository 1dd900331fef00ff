"""What will run: designs, points and their keys, written once as ``plan.json`` and read by every worker.

The plan holds the designs themselves, so that workers with another scipy run the same points.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from solvers import Response

from .config import ConfigError, Study
from .evaluate import run_trusted
from .mistakes import ABSENT, Mistake
from .point import Point
from .space import baseline_model, baseline_scene, designs, make_point, point_key

FORMAT = 1


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The points of a study in the order in which they are handed out: a design's environments together."""

    study: str  # name
    text: str  # the study's YAML, without includes
    designs: list[dict[str, float]]
    environments: list[str]
    keys: list[str]  # of point i: design i // n_environment, environment i % n_environment
    ask: dict[str, Any]  # model, method, mesh, tolerance as asked
    settings: dict[str, Any]
    baselines: list[dict[str, Any]]  # distinct ones: name, key, how many points share it

    def __len__(self) -> int:
        return len(self.keys)

    def point(self, study: Study, i: int) -> Point:
        """Point ``i``, ready to run; ConfigError where the study is not the one that was planned."""
        design, environment = divmod(i, len(self.environments))
        point = make_point(study, design, environment, self.designs[design])
        if point.key != self.keys[i]:
            problem = f"the plan has {self.keys[i]} here, the study gives {point.key}"
            raise ConfigError(
                [Mistake(f"point {i}", ABSENT, problem, "the study has changed: use a new directory")]
            )
        return point

    def points(self, study: Study, part: tuple[int, int] | None = None) -> Iterator[Point]:
        """All points, or those of slice K of N."""
        return (self.point(study, i) for i in self.slice(*(part or (0, 1))))

    def slice(self, k: int, n: int) -> range:
        """Indices of slice ``k`` of ``n``: every n-th point, so that slices cost alike."""
        if not (n >= 1 and 0 <= k < n):
            raise ValueError(f"part {k}/{n}: K must be 0 to N-1")
        return range(k, len(self.keys), n)


def make_plan(study: Study, limit: int | None = None) -> Plan:
    """The plan of a study; ``limit`` takes its first designs. The same study gives the same plan."""
    chosen = designs(study, limit)
    keys: list[str] = []
    name = study.settings.baseline
    shared: dict[str, int] = {}
    for i, values in enumerate(chosen):
        for e in range(len(study.environments)):
            point = make_point(study, i, e, values)
            keys.append(point.key)
            base = point_key(baseline_scene(point.scene, name), baseline_model(point.ask, name))
            shared[base] = shared.get(base, 0) + 1
    return Plan(
        study=study.name,
        text=study.text,
        designs=chosen,
        environments=[environment.name for environment in study.environments],
        keys=keys,
        ask=asdict(study.ask),
        settings=asdict(study.settings),
        baselines=[{"name": name, "key": key, "points": n} for key, n in shared.items()],
    )


def write_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan whole, under a temporary name first."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with temporary.open("w", encoding="utf-8") as file:
        json.dump({"format": FORMAT, **asdict(plan)}, file, indent=1, ensure_ascii=False)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def read_plan(path: str | Path) -> Plan:
    """Read a plan; ConfigError where the file is not one."""
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.pop("format") != FORMAT:
            raise KeyError
        content["settings"]["objectives"] = tuple(content["settings"]["objectives"])
        if content["settings"]["window"] is not None:
            content["settings"]["window"] = tuple(content["settings"]["window"])
        return Plan(**content)
    except FileNotFoundError:
        raise ConfigError([Mistake(str(path), ABSENT, "there is no such file")], str(path)) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise ConfigError([Mistake(str(path), ABSENT, "is not a plan of this version")], str(path)) from None


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
    chosen = {"first": designs(study, 1)[0]}
    if study.variables:
        chosen["least"] = {key: min(v for _, v in var.tests) for key, var in study.variables.items()}
        chosen["greatest"] = {key: max(v for _, v in var.tests) for key, var in study.variables.items()}
    points = {label: make_point(study, 0, 0, values) for label, values in chosen.items()}
    return [
        PilotRun(label=label, values=point.values, response=run_trusted(point.scene, point.ask).response)
        for label, point in points.items()
    ]
