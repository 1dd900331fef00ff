"""A study from plan to dataset: plan - done -> map -> journals -> results.nc -> summary."""

from __future__ import annotations

import hashlib
import importlib.metadata
import logging
import math
import platform
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from solvers import SOURCE_HASH

from . import distribute
from .config import Study
from .plan import Plan, read_plan
from .point import Record
from .report import Progress
from .store import merge, outcome, prepare, read_records, settle, study_of

PACKAGES = ("numpy", "scipy", "numba", "xarray", "pydantic")
RETRIES = ("failed", "untrusted", "timeout")

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Where and how much; what is computed stands in the study alone."""

    directory: Path
    limit: int | None = None  # run the first designs only
    part: tuple[int, int] | None = None  # (K, N): every N-th point from the K-th on
    retry: frozenset[str] = frozenset()  # of RETRIES
    any_version: bool = False
    evaluator: str = "sweep.evaluate:evaluate"
    warm_ups: tuple[str, ...] = ("solvers:warm_up",)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a run ended."""

    planned: int  # points that were this run's business
    before: int  # of them done by earlier runs
    rows: dict[str, Record] = field(default_factory=dict)  # of these points
    interrupted: str = ""  # the signal's name
    results: Path | None = None  # None for a slice or an interrupted run

    @property
    def exit_code(self) -> int:
        if self.interrupted:
            return 3
        return 1 if any(outcome(row.status) == "failed" for row in self.rows.values()) else 0

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """(status, message) of every point, MISSING ones too."""
        missing = [("MISSING", "")] * (self.planned - len(self.rows))
        return [(row.status, row.message) for row in self.rows.values()] + missing


def provenance(study: Study) -> dict[str, Any]:
    """What made the rows: the journals' header."""
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    digest = hashlib.sha256(study.text.encode()).hexdigest()[:16]
    return {
        "solver": SOURCE_HASH,
        "versions": {"python": platform.python_version(), **versions},
        "git": _git_state(),
        "study": digest,
    }


def _git_state() -> dict[str, Any]:
    """Commit of the checkout this runs from, and whether it was changed; empty when it is none."""
    house = Path(__file__).resolve().parents[1]

    def git(*words: str) -> str:
        answer = subprocess.run(["git", "-C", str(house), *words], capture_output=True, text=True, timeout=20)
        return answer.stdout.strip() if answer.returncode == 0 else ""

    try:
        commit = git("rev-parse", "HEAD") if (house / ".git").exists() else ""
        return {"commit": commit, "changed": bool(git("status", "--porcelain", "-uno"))} if commit else {}
    except (OSError, subprocess.SubprocessError):
        return {}


def to_do(keys: Iterable[str], rows: Mapping[str, Record], retry: frozenset[str] = frozenset()) -> list[str]:
    """Keys without a final row, each once, in their order."""

    def again(row: Record) -> bool:
        return outcome(row.status) in retry or row.status.lower() in retry

    return [key for key in dict.fromkeys(keys) if key not in rows or again(rows[key])]


def run(study: Study, settings: Settings, ranks: distribute.World | None = None) -> Outcome:
    """Run what is not done yet; rank 0 calls this while the other ranks ``distribute.serve``."""
    ranks = ranks or distribute.Alone()
    directory = settings.directory
    job = distribute.Job(
        directory=str(directory),
        part="" if settings.part is None else f"part{settings.part[0]}of{settings.part[1]}-",
        header=provenance(study),
        any_version=settings.any_version,
        evaluator=settings.evaluator,
        warm_ups=settings.warm_ups,
        time_limit=study.time_limit,
    )
    rows = job.store(0).rows()
    plan = prepare(study, directory, settings.limit)
    mine = _business(plan, settings)
    left = to_do(mine, rows, settings.retry)
    log.info("%d points, %d to do, on %d rank%s", len(mine), len(left), ranks.size, "s" * (ranks.size > 1))
    progress = Progress(len(left))
    points = [plan.point(study, mine[key]) for key in left]
    interrupted = distribute.map_points(points, job, ranks, progress.report, progress.beat) if points else ""
    log.info("%s", progress.line())
    rows = settle(read_records(directory))
    return Outcome(
        planned=len(mine),
        before=len(mine) - len(left),
        rows={key: rows[key] for key in mine if key in rows},
        interrupted=interrupted,
        results=merge(directory) if settings.part is None and not interrupted else None,
    )


def _business(plan: Plan, settings: Settings) -> dict[str, int]:
    """The keys that this run is to have rows for, each with its first place in the plan."""
    indices = plan.slice(*(settings.part or (0, 1)))
    end = len(plan) if settings.limit is None else settings.limit * len(plan.environments)
    found: dict[str, int] = {}
    for i in indices:
        if i < end:
            found.setdefault(plan.keys[i], i)
    return found


def rerun(directory: Path, key: str) -> tuple[Record, Record | None]:
    """Evaluate a point of a folder again, and give the new row and the stored one."""
    study = study_of(directory)
    plan = read_plan(Path(directory) / "plan.json")
    point = plan.point(study, plan.keys.index(key))
    job = distribute.Job(time_limit=study.time_limit)
    return distribute.evaluate_alone(point, job), settle(read_records(directory)).get(key)


def differences(new: Record, old: Record) -> list[str]:
    """Fields in which two rows of a point differ, bit for bit, costs in seconds aside."""
    found = []
    for name in (
        "status",
        "model",
        "method",
        "segments",
        "tolerance",
        "steps",
        "evaluations",
        "energy_residual",
    ):
        a, b = getattr(new, name), getattr(old, name)
        if not _same(a, b):
            found.append(f"{name}: {b} stored, {a} now")
    for name in sorted(new.metrics.keys() | old.metrics.keys()):
        a, b = new.metrics.get(name, math.nan), old.metrics.get(name, math.nan)
        if not _same(a, b):
            found.append(f"{name}: {b!r} stored, {a!r} now")
    return found


def _same(a: Any, b: Any) -> bool:
    return bool(a == b or (a != a and b != b))
