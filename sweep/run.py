"""A study from plan to dataset: plan - done -> map -> journals -> results.nc -> summary."""

from __future__ import annotations

import hashlib
import importlib.metadata
import logging
import math
import os
import platform
import shutil
import subprocess
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from solvers import CACHE, SOURCE_HASH

from . import distribute, locks
from .config import Study
from .plan import Orders, Plan
from .point import Record
from .report import Progress, unnumbered
from .resolve import resolve
from .store import (
    Replay,
    StoreError,
    contents,
    job_name,
    jobs_begun,
    merge,
    outcome,
    prepare,
    read_records,
    same_version,
    settle,
)
from .supervise import CannotRun

PACKAGES = ("numpy", "scipy", "numba", "xarray", "pydantic")
RETRIES = ("failed", "untrusted", "timeout", "memory")
FRUITLESS = 3  # turns of a job that may end in a row without a point
OLD_CACHE = 14.0  # kernels of other versions that were not used for so long are removed [days]

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
    groups: Counter[tuple[str, str]] = field(default_factory=Counter)  # (status, message) of these points, MISSING too
    interrupted: str = ""  # the signal's name
    results: Path | None = None  # None for a slice or an interrupted run

    @property
    def exit_code(self) -> int:
        if self.interrupted:
            return 3
        return 1 if any(outcome(status) == "failed" for status, _ in self.groups) else 0


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


def to_do(business: np.ndarray, replay: Replay, retry: frozenset[str] = frozenset()) -> np.ndarray:
    """Those of the places that have no final row; a job that was requeued retries none of its own rows."""
    status = replay.status[business]
    again = np.array([outcome(name) in retry or name.lower() in retry for name in replay.names])[status]
    if restarts() and job_name() in replay.began:
        again &= replay.turns[business] < replay.began[job_name()]
    return business[again | (status == 0)]


def run(study: Study, settings: Settings, ranks: distribute.World | None = None) -> Outcome:
    """Run what is not done yet; rank 0 calls this while the other ranks ``distribute.serve``."""
    with distribute.interruptible() as interrupt:
        return _run(study, settings, ranks or distribute.Alone(), interrupt)


def _run(study: Study, settings: Settings, ranks: distribute.World, interrupt: distribute.Interrupt) -> Outcome:
    directory = settings.directory
    begun(directory)
    study = resolve(study, directory)[0]
    header = provenance(study)
    part = "" if settings.part is None else f"part{settings.part[0]}of{settings.part[1]}"
    lock = locks.acquire(directory, part, lock_digest(header, settings))
    try:
        clean_caches()
        plan = prepare(study, directory, settings.limit)
        replay = Replay(directory, plan.keys)
        if not settings.any_version:
            same_version(directory, header["solver"], replay.headers)
        fruitful(replay, part)
        mine = _business(plan, settings)
        left = to_do(mine, replay, settings.retry)
        before, turn = len(mine) - len(left), replay.turn + 1
        del replay
        log.info("%d points, %d to do, on %d rank%s", len(mine), len(left), ranks.size, "s" * (ranks.size > 1))
        interrupted = ""
        if len(left):
            plan.point(study, left[0])  # ConfigError here rather than in every child
            job = job_of(study, settings, header, part, turn)
            dearest = np.argsort(-plan.costs[left], kind="stable")  # long points last would be waited for
            progress = Progress(len(left))

            def beat() -> None:
                progress.beat()
                if lock.lost:
                    raise StoreError(f"{lock.path} was removed, or taken by another run: this one stops")

            orders = Orders.of(plan, left[dearest])
            del dearest, left
            interrupted = distribute.map_points(orders, job, ranks, progress.report, beat, interrupt)
            log.info("%s", progress.line())
        replay = Replay(directory, plan.keys)
        # whichever slice ends last makes the file: a merge job that depends on requeued tasks may come too early
        over = settings.part is None or not len(to_do(plan.slice(0, 1), replay))
        groups = tally(replay, mine)
        del replay
        return Outcome(
            planned=len(mine),
            before=before,
            groups=groups,
            interrupted=interrupted,
            results=merge(directory) if over and not interrupted else None,
        )
    finally:
        lock.release()


def job_of(study: Study, settings: Settings, header: Mapping[str, Any], part: str, turn: int) -> distribute.Job:
    """What the ranks need to work on a part of a study ("" for all of it)."""
    return distribute.Job(
        directory=str(settings.directory),
        part=f"{part}-" if part else "",
        header=header,
        any_version=settings.any_version,
        evaluator=settings.evaluator,
        warm_ups=settings.warm_ups,
        time_limit=study.time_limit,
        memory_limit=study.memory_limit,
        study=study,
        turn=turn,
    )


def _business(plan: Plan, settings: Settings) -> np.ndarray:
    """The places of the plan that this run is to have rows for, equal physics once."""
    places = plan.slice(*(settings.part or (0, 1)))
    end = len(plan) if settings.limit is None else settings.limit * len(plan.environments)
    return places[places < end]


def restarts() -> int:
    """How often SLURM has started this job again."""
    text = os.environ.get("SLURM_RESTART_COUNT", "0")
    return int(text) if text.isdigit() else 0


def lock_digest(header: Mapping[str, Any], settings: Settings) -> str:
    """What slices must agree on to work side by side: the study, and how much of it is planned."""
    if settings.limit is None:
        return str(header["study"])
    return hashlib.sha256(f"{header['study']} {settings.limit}".encode()).hexdigest()[:16]


def fruitful(replay: Replay, part: str) -> None:
    """Refuse to requeue for ever a job whose turns end before any of its points does, or before it begins."""
    mine = [journal for journal in replay.journals if journal.writer.rpartition("-")[0] == part]
    since = max((journal.fruitful for journal in mine), default=0)  # journals of ranks there were once stand still
    since = max(since, replay.began.get(job_name(), 1) - 1)
    if restarts() and len({turn for journal in mine for turn in journal.idle if turn > since}) >= FRUITLESS:
        raise CannotRun(
            f"job {job_name()}: {FRUITLESS} turns in a row ended before any point did. Points take longer than the "
            "job's time limit: raise --time, or set a `time_limit` in the study, and submit again."
        )


def begun(directory: Path) -> None:
    """Refuse to requeue for ever a job that never comes so far as to write: its launcher fails, or there is no room."""
    if restarts() >= FRUITLESS and job_name() not in jobs_begun(directory):
        raise CannotRun(
            f"job {job_name()} was started {restarts() + 1} times and never began to write: put right what its log "
            "says (a full disk, `launch` or `setup` of site.yaml), and submit again."
        )


def tally(replay: Replay, places: np.ndarray) -> Counter[tuple[str, str]]:
    """(status, message) of the places, counted; messages of points that are not trusted only, equal but for numbers
    the first of them: a million failures may each name a time of their own."""
    codes, counts = np.unique(replay.status[places], return_counts=True)
    groups = Counter(
        {
            (replay.names[code], ""): int(count)
            for code, count in zip(codes, counts, strict=True)
            if outcome(replay.names[code]) in ("trusted", "missing")
        }
    )
    told = np.array([outcome(name) in ("failed", "untrusted") for name in replay.names])
    first: dict[tuple[str, str], str] = {}
    for record in replay.records(places[told[replay.status[places]]]):
        message = first.setdefault((record.status, unnumbered(record.message)), record.message)
        groups[record.status, message] += 1
    return groups


def clean_caches(days: float = OLD_CACHE) -> list[Path]:
    """Remove folders of kernels compiled from other sources that nobody has used for a while."""
    mine = Path(CACHE)
    removed = []
    with suppress(OSError):
        mine.mkdir(parents=True, exist_ok=True)
        os.utime(mine)
        for folder in mine.parent.glob("numba-*"):
            if folder != mine and time.time() - folder.stat().st_mtime > days * 86400:
                shutil.rmtree(folder, ignore_errors=True)
                removed.append(folder)
    return removed


def rerun(directory: Path, key: str) -> tuple[Record, Record | None]:
    """Evaluate a point of a folder again, and give the new row and the stored one."""
    study, plan = contents(directory)
    point = plan.point(study, plan.keys.index(key))
    job = distribute.Job(time_limit=study.time_limit, memory_limit=study.memory_limit)
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
