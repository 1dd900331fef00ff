"""From a study to SLURM jobs: pilots, predicted costs, rendered scripts, an array or ranks, and a merge job after them.

The scripts in ``slurm/`` work by hand; here their headers are filled in with the site's options and written to
DIR/jobs, so that what ran can be read later. Jobs run DIR/study.yaml, not the file that the user goes on editing.
"""

from __future__ import annotations

import getpass
import json
import logging
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from solvers.scene import record

from . import distribute, locks
from .config import ConfigError, Study, read_yaml
from .mistakes import ABSENT, Mistake, translate
from .plan import Orders, Plan, pilot_places, predicted, read_plan, write_plan
from .point import Record
from .report import duration
from .resolve import resolve
from .run import Settings, job_of, provenance, to_do
from .store import Replay, StoreError, complaint, prepare, same_version, write_whole
from .supervise import CannotRun

TEMPLATES = Path(__file__).resolve().parents[1] / "slurm"
OURS = ("array", "ntasks", "dependency", "parsable", "wrap", "job-name", "output", "signal", "requeue", "open-mode")
FILES_A_TASK = 3  # journal, log, lock
OTHER_FILES = 12  # plan, study, results, scripts
SAMPLE = 500  # rows that predictions are fitted to, at most

log = logging.getLogger(__name__)


@record
class Site:
    """What every job of a cluster is submitted with: slurm/site.yaml."""

    options: dict[str, str | int | bool | None] = Field(default_factory=dict)  # long options of sbatch
    setup: tuple[str, ...] = ()  # shell lines before the run: modules, environments
    launch: str = "mpirun"  # starts the ranks
    node_cache: bool = False  # compiled kernels on each node's own disk
    max_array: int | None = Field(default=None, ge=1)  # tasks of one array, where scontrol cannot say
    max_files: int | None = Field(default=None, ge=1)  # that a study may make, by quota


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is to be submitted: an array of tasks without MPI, or one job of ranks, which may search for the front."""

    array: int | None = None
    ranks: int | None = None
    options: Mapping[str, str] = field(default_factory=dict)  # of the command line; they win over the site's
    pilots: int = 8
    extra: Sequence[str] = ()  # options for `sweep run`, or `sweep optimise`
    search: bool = False  # `sweep optimise` in place of `sweep run`


@dataclass(frozen=True, kw_only=True)
class Script:
    """A rendered job script, and how it is submitted."""

    name: str
    text: str
    options: list[str]  # of this submission
    words: list[str]  # the script's arguments


# --------------------------------------------------------------------------------------------- the site


def load_site(path: Path | None) -> Site:
    """Read slurm/site.yaml (here, or beside the program), or none; ConfigError lists every mistake in it."""
    if path is None:
        path = next((p for p in (Path("slurm/site.yaml"), TEMPLATES / "site.yaml") if p.is_file()), None)
        if path is None:
            return Site()
    raw, mistakes = read_yaml(path)
    if raw is ABSENT or mistakes:
        raise ConfigError(mistakes, str(path))
    adapter = TypeAdapter(Site)
    try:
        site = adapter.validate_python(raw or {})
    except ValidationError as error:
        raise ConfigError(translate(error, raw, "", adapter.json_schema()), str(path)) from None
    found = [mistake for name, value in site.options.items() for mistake in _option_mistakes(name, value)]
    found += [
        Mistake(f"setup[{i}]", line, "is more than one line", "one line each")
        for i, line in enumerate(site.setup)
        if "\n" in line
    ]
    if found:
        raise ConfigError(found, str(path))
    return site


def _option_mistakes(name: str, value: object) -> list[Mistake]:
    where = f"options.{name}"
    if not re.fullmatch(r"[a-z][a-z0-9-]*", name):
        return [Mistake(where, value, "is not a long option of sbatch", "write partition, not -p or --partition")]
    if name in OURS:
        return [Mistake(where, value, "is set by `sweep submit` itself", "leave it out")]
    if name == "time" and not isinstance(value, str) and value is not None:
        return [Mistake(where, value, "YAML reads 12:00:00 as a number", 'put it in quotes: "12:00:00"')]
    if isinstance(value, str) and not re.fullmatch(r"[^\s#]+", value):
        return [Mistake(where, value, "has a blank or a line break in it", "one word")]
    return []


# --------------------------------------------------------------------------------------------- scripts


def render(name: str, site: Site, options: Mapping[str, object]) -> str:
    """A template of slurm/ with its #SBATCH lines and its place for the site's setup filled in."""
    folder = next((p for p in (TEMPLATES, Path("slurm")) if (p / f"{name}.sbatch").is_file()), None)
    if folder is None:
        raise StoreError(f"there is no slurm/{name}.sbatch here: run `sweep submit` in the checkout of cable-sweep")
    wanted = {key: value for key, value in options.items() if value is not None and value is not False}
    lines, at = [], 0
    for line in (folder / f"{name}.sbatch").read_text(encoding="utf-8").splitlines():
        option = re.match(r"##?SBATCH --([a-z-]+)", line)
        if option and (option[1] in options or line.startswith("##")):
            continue
        if line.startswith("export PATH="):  # what the scripts do by hand
            continue
        if line.startswith("# site:"):
            lines += _setup(site)
            continue
        lines.append(line)
        if option:
            at = len(lines)
    lines[at:at] = [f"#SBATCH --{key}" + ("" if value is True else f"={_word(value)}") for key, value in wanted.items()]
    return "\n".join(lines) + "\n"


def _word(value: object) -> str:
    return f'"{value}"' if re.search(r"\s", str(value)) else str(value)


def _setup(site: Site) -> list[str]:
    """Shell lines that make ``python -m sweep`` the one that submitted, unless the site says how."""
    usual = (f"export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH",)
    lines = list(site.setup or usual)
    if site.node_cache:
        lines.append('export CABLE_SWEEP_CACHE="${TMPDIR:-/tmp}/cable-sweep-$(id -un)"')
    return [*lines, f"LAUNCH={shlex.quote(site.launch)}"]


def scripts(study: str, directory: Path, request: Request, site: Site, limit: int) -> list[Script]:
    """The scripts of a request: arrays of at most ``limit`` tasks, or one job; the merge job last."""
    options = {**site.options, **request.options}

    def text(name: str, given: Mapping[str, object]) -> str:
        log_name = "%x-%A_%a.log" if name == "array" else "%x-%j.log"
        output = str((directory / "logs" / log_name).absolute())
        return render(name, site, {"job-name": re.sub(r"[^\w.-]+", "-", study), "output": output, **given})

    words = [str((directory / "study.yaml").absolute()), str(directory.absolute()), *request.extra]
    if request.array:
        body = text("array", options)
        found = [
            Script(
                name="array",
                text=body,
                options=[
                    f"--array=0-{min(limit, request.array - first) - 1}",
                    f"--export=ALL,SWEEP_FIRST={first},SWEEP_OF={request.array}",
                ],
                words=words,
            )
            for first in range(0, request.array, limit)
        ]
    else:
        name = "optimise" if request.search else "mpi"
        found = [Script(name=name, text=text(name, options), options=[f"--ntasks={request.ranks}"], words=words)]
    alone = {name: value for name, value in options.items() if not name.startswith(("ntasks", "nodes", "time"))}
    last = ["--dependency=afterany:{jobs}", "--kill-on-invalid-dep=yes"]
    return [*found, Script(name="merge", text=text("merge", alone), options=last, words=words[1:2])]


# --------------------------------------------------------------------------------------------- costs


def plan_costs(study: Study, settings: Settings, pilots: int) -> tuple[Plan, int, float]:
    """Write the costs of the points that are left into the plan, fitted to rows; pilots are run where there are few.

    Points that are done cost nothing, so that slices share what is left. Pilots are points of the study, and their
    rows are kept. Returns the plan, how many points are left, and seconds per unit of cost (NaN without rows).
    """
    directory, study = settings.directory, resolve(study, settings.directory)[0]
    header = provenance(study)
    lock = locks.acquire(directory, "", header["study"])
    try:
        plan = prepare(study, directory, settings.limit)
        replay = Replay(directory, plan.keys)
        if not settings.any_version:
            same_version(directory, header["solver"], replay.headers)
        chosen = np.array(pilot_places(plan, pilots), dtype=int)
        if len(chosen) and np.count_nonzero(replay.status) < len(chosen):
            chosen = to_do(np.unique(replay.firsts(slice(None))[chosen]), replay)
            log.info("%d pilots; their rows are kept", len(chosen))
            job = job_of(study, settings, header, "pilot", replay.turn + 1)
            if signal := distribute.map_points(Orders.of(plan, chosen), job, distribute.Alone()):
                raise CannotRun(f"interrupted by {signal}: nothing was submitted", resumable=True)
            replay = Replay(directory, plan.keys)
        seen = np.flatnonzero(replay.status)
        seen = seen[np.unique(np.linspace(0, len(seen) - 1, SAMPLE).astype(int))] if len(seen) > SAMPLE else seen
        rows = {replay.place(record.key): record for record in replay.records(seen)}
        plan.costs[:] = predicted(plan, {place: work(row) for place, row in rows.items() if place is not None})
        spent = sum(row.seconds + row.first_seconds for row in rows.values())
        cost = float(plan.costs[seen].sum())
        mine = plan.slice(0, 1)
        left = to_do(mine, replay, settings.retry)
        plan.costs[np.setdiff1d(mine, left)] = 0.0
        write_whole(directory / "plan.json", lambda place: write_plan(plan, place))
        return plan, len(left), spent / cost if cost > 0 else float("nan")
    finally:
        lock.release()


def work(row: Record) -> float:
    """Counted work of a row: evaluations (or steps) times nodes. Seconds would differ from machine to machine."""
    return float((row.evaluations or row.steps) * (row.segments + 1))


# --------------------------------------------------------------------------------------------- submitting


def submit(study: Study, settings: Settings, request: Request, site: Site, dry_run: bool = False) -> list[str]:
    """Submit a study, or only show how; returns what to tell the user."""
    directory = settings.directory
    said: list[str] = []
    if not dry_run:
        _need_slurm()
        _not_queued(directory)
        _room(directory, (request.array or request.ranks or 1), site)
    if request.search:
        if not dry_run:
            write_whole(directory / "study.yaml", lambda place: place.write_text(study.text, encoding="utf-8"))
    elif not dry_run:
        plan, left, pace = plan_costs(study, settings, request.pilots)
        if not left:
            return [f"nothing is left to run; sweep merge {directory}"]
        request = _no_idle(request, left, said)
        said += _forecast(plan, request, pace)
    elif (directory / "plan.json").is_file():
        said += _forecast(read_plan(directory / "plan.json"), request, float("nan"))
    limit = site.max_array or _max_array() or max(request.array or 1, 1)
    ready = scripts(study.name, directory, request, site, limit)
    return said + (_shown(ready, directory) if dry_run else _sent(ready, directory))


def _no_idle(request: Request, left: int, said: list[str]) -> Request:
    """No more tasks than points."""
    tasks = request.array or request.ranks or 1
    if tasks <= left:
        return request
    said.append(f"{left} points are left: {left} tasks instead of {tasks}")
    changed = {"array": left} if request.array else {"ranks": left}
    return Request(**{**vars(request), **changed})


def _forecast(plan: Plan, request: Request, pace: float) -> list[str]:
    """How long the dearest task will take, by the plan's costs."""
    n = request.array or 1
    loads = [float(plan.costs[plan.slice(k, n)].sum()) for k in range(n)] if n <= 1000 else []
    if not loads or not np.isfinite(pace):
        return []
    longest = max(loads) * pace / (request.ranks or 1)
    text = f"about {sum(loads) * pace / 3600:.2g} core-hours; the longest task some {duration(longest)}"
    return [f"{text} (by the pilots' seconds here)"]


def _shown(ready: Sequence[Script], directory: Path) -> list[str]:
    said = []
    for script in ready:
        said += [f"# ---- {directory / 'jobs' / script.name}.sbatch", script.text]
    said += [shlex.join(_command(script, directory, ["<job>"])) for script in ready]
    return said


def _write(text: str, place: Path) -> None:
    place.write_text(text, encoding="utf-8")


def _command(script: Script, directory: Path, jobs: Sequence[str]) -> list[str]:
    options = [option.format(jobs=":".join(jobs)) for option in script.options]
    return ["sbatch", "--parsable", *options, str(directory / "jobs" / f"{script.name}.sbatch"), *script.words]


def _sent(ready: Sequence[Script], directory: Path) -> list[str]:
    book = directory / "jobs" / "submitted.jsonl"
    for name in ("jobs", "logs"):
        with complaint(directory / name):
            (directory / name).mkdir(parents=True, exist_ok=True)
    for script in ready:
        write_whole(directory / "jobs" / f"{script.name}.sbatch", partial(_write, script.text))
    jobs: list[str] = []
    for script in ready:
        ended = subprocess.run(_command(script, directory, jobs), capture_output=True, text=True, check=False)
        if ended.returncode:
            undo = f" Already submitted: {', '.join(jobs)} (scancel {' '.join(jobs)} takes them back)." if jobs else ""
            raise StoreError(f"sbatch refused the {script.name} job: {ended.stderr.strip()}.{undo}")
        jobs.append(ended.stdout.strip().partition(";")[0])
        try:
            with book.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"job": jobs[-1], "kind": script.name, "at": time.time()}) + "\n")
        except OSError as error:
            undo = f"scancel {' '.join(jobs)} takes back what is submitted already"
            raise StoreError(f"cannot write {book}: {error.strerror or error}; {undo}") from error
    return [
        f"submitted {', '.join(jobs[:-1])}, and {jobs[-1]} to merge after them",
        f"follow it: sweep status {directory}; logs in {directory / 'logs'}",
    ]


# --------------------------------------------------------------------------------------------- what the site allows


def _need_slurm() -> None:
    if shutil.which("sbatch") is None:
        raise StoreError("there is no sbatch here: use a login node, or --dry-run to see the scripts")


def _not_queued(directory: Path) -> None:
    """Refuse a second submission while jobs of the first wait or run: the plan is theirs."""
    path = directory / "jobs" / "submitted.jsonl"
    if not path.is_file():
        return
    ours = set()
    for line in path.read_text(encoding="utf-8").splitlines():
        with suppress(ValueError, KeyError, TypeError):  # a line that a full disk has torn
            ours.add(json.loads(line)["job"])
    ended = subprocess.run(
        ["squeue", "-h", "-u", getpass.getuser(), "-o", "%F"], capture_output=True, text=True, check=False
    )
    if ended.returncode:
        raise StoreError(f"squeue does not answer: {ended.stderr.strip()}")
    if waiting := sorted(ours & set(ended.stdout.split())):
        raise locks.Busy(
            f"jobs {', '.join(waiting)} of {directory} are still in the queue. "
            f"Wait for them, or scancel {' '.join(waiting)}."
        )


def _room(directory: Path, tasks: int, site: Site) -> None:
    """Refuse to make more files than the file system or the quota has room for; their number hangs on tasks only."""
    needed = FILES_A_TASK * tasks + OTHER_FILES
    there = next(p for p in (directory, *directory.absolute().parents) if p.is_dir())
    stat = os.statvfs(there)
    free = stat.f_favail if stat.f_files else None  # some file systems do not count
    used = sum(len(files) for _, _, files in os.walk(directory))
    quota = site.max_files and site.max_files - used
    for allowed, why in ((free, f"{there} has room for"), (quota, "site.yaml allows")):
        if allowed is not None and needed > allowed:
            raise StoreError(f"{tasks} tasks make up to {needed} files, and {why} {allowed} more: submit fewer tasks")


def _max_array() -> int | None:
    """MaxArraySize: no index of an array may reach it."""
    if shutil.which("scontrol") is None:
        return None
    ended = subprocess.run(["scontrol", "show", "config"], capture_output=True, text=True, check=False)
    found = re.search(r"^MaxArraySize\s*=\s*(\d+)", ended.stdout, re.MULTILINE)
    return int(found[1]) if found and int(found[1]) > 0 else None
