"""Who works in a folder: one lock file for each part, made and broken under a gate.

``flock`` holds nothing between the nodes of many network file systems, so a lock is a file: DIR/locks/<part>.lock,
which names host, process, job and part. Its holder touches it every ``BEAT`` seconds. Taking a lock happens within
a gate (``mkdir`` is atomic everywhere). Parts of one cut of one study may work side by side; anything else in the
same folder is refused. A lock is stale, and is broken, when its process is gone (same host), when SLURM does not
know its job any more or it is an earlier turn of this very job, or when it was not touched for ``STALE`` seconds by
the clock of the file server: clocks of nodes differ, and are never compared with one another. A suspended job keeps
its lock.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import socket
import subprocess
import threading
import time
import uuid
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from .store import StoreError, complaint, job_name

BEAT = 15.0  # how often a holder touches its lock [s]
STALE = 150.0  # a lock that was not touched for so long is nobody's [s]
GATE_STALE = 60.0  # nobody is in the gate for longer [s]
ANSWER = 20.0  # that SLURM may take [s]
HELD_STATES = {"SUSPENDED", "STOPPED"}  # the job lives, and cannot touch its lock
LIVE_STATES = {"RUNNING", "COMPLETING", "CONFIGURING", "STAGE_OUT", "SIGNALING", "RESIZING"} | HELD_STATES

log = logging.getLogger(__name__)


class Busy(StoreError):
    """Another run works in the folder."""


@dataclass(frozen=True)
class Holder:
    """Who holds a lock."""

    host: str
    boot: str  # of the host: process numbers begin anew with it
    space: str  # of process numbers: containers of one host have their own
    pid: int
    started: str  # of the process, in clock ticks since boot: numbers are used again
    job: str
    turn: int  # of the job: SLURM_RESTART_COUNT
    part: str  # "" for the whole study, part2of8
    study: str  # digest
    token: str = ""
    cluster: str = ""  # SLURM's name for it: job numbers are each cluster's own
    user: int = -1  # SLURM may hide the jobs of others

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}" + (f", job {self.job}" if self.job else "")


def myself(part: str, study: str) -> Holder:
    return Holder(
        host=socket.gethostname(),
        boot=_boot(),
        space=_space(),
        pid=os.getpid(),
        started=_started(os.getpid()),
        job=job_name(),
        turn=int(os.environ.get("SLURM_RESTART_COUNT") or 0),
        part=part,
        study=study,
        token=uuid.uuid4().hex,
        cluster=os.environ.get("SLURM_CLUSTER_NAME", ""),
        user=os.getuid(),
    )


def _boot() -> str:
    with suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    return ""


def _space() -> str:
    with suppress(OSError):
        return os.readlink("/proc/self/ns/pid")
    return ""


def _started(pid: int) -> str:
    """When a process began, or "" where there is none or nobody can say."""
    with suppress(OSError, IndexError):
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return "" if words[0] in "ZX" else words[19]
    return ""


class Lock:
    """A held lock; ``release`` gives it back, ``lost`` says whether somebody else took it."""

    def __init__(self, path: Path, holder: Holder) -> None:
        self.path, self.holder = path, holder
        self.lost = False
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True, name="lock")
        self._thread.start()

    def _beat(self) -> None:
        while not self._end.wait(BEAT):
            try:
                if not self._mine():
                    self.lost = True
                    return
                os.utime(self.path)
            except (OSError, ValueError, TypeError):  # a sick file server may come back before the lock is stale
                continue

    def _mine(self) -> bool:
        """Whether the file is there and is this run's; OSError where that cannot be seen now."""
        try:
            return _parse(self.path.read_text(encoding="utf-8")).token == self.holder.token
        except FileNotFoundError:
            return False

    def release(self) -> None:
        self._end.set()
        self._thread.join()
        with suppress(OSError, ValueError, TypeError):
            if self._mine():
                self.path.unlink()


def acquire(directory: str | Path, part: str, study: str) -> Lock:
    """Lock a part of a folder ("" for all of it) for a study's digest; Busy where another run excludes it."""
    folder = Path(directory) / "locks"
    me = myself(part, study)
    path = folder / f"{part or 'whole'}.{study[:8]}.lock"
    with complaint(folder):
        folder.mkdir(parents=True, exist_ok=True)
        gate = _enter(folder)
        try:
            now = server_clock(folder)
            others = [p for p in sorted(folder.glob("*.lock")) if p == path or _excludes(p.name, path.name)]
            known = [found for p in others if (found := _read(p)) and found.user == me.user]
            states = _states(found.job for found in known if _same_cluster(found, me))
            for other in others:
                _clear(other, me, now, states)
            temporary = folder / f".{me.token}"
            try:
                with temporary.open("w", encoding="utf-8") as file:
                    json.dump(asdict(me), file)
                    file.flush()
                    os.fsync(file.fileno())
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
        finally:
            with suppress(OSError):
                gate.rmdir()
    return Lock(path, me)


def holders(directory: str | Path) -> list[Holder]:
    """Who works in a folder now, as far as can be seen from here; nothing is changed."""
    folder = Path(directory) / "locks"
    me, now, found = myself("", ""), server_clock(folder), []
    for path in sorted(folder.glob("*.lock")):
        holder = _read(path)
        with suppress(OSError):
            if holder and not _stale(holder, path, me, now, {}):
                found.append(holder)
    return found


def server_clock(folder: Path) -> float:
    """The time by the clock that stamps files in a folder; this machine's where nothing may be written there."""
    probe = folder / f".clock-{socket.gethostname()}-{os.getpid()}-{threading.get_ident()}"
    try:
        probe.touch()
        try:
            return probe.stat().st_mtime
        finally:
            probe.unlink()
    except OSError:
        return time.time()


def _excludes(one: str, other: str) -> bool:
    """Whether two locks' names cannot stand side by side: other study, other number of slices, or the whole."""

    def cut(name: str) -> tuple[str, str]:
        part, study, _ = name.split(".")
        return part.rpartition("of")[2] if part != "whole" else "whole", study

    return "whole" in (cut(one)[0], cut(other)[0]) or cut(one) != cut(other)


def _enter(folder: Path) -> Path:
    """Go through the gate, which is taken for some milliseconds at a time."""
    gate = folder / "gate"
    waited = time.monotonic()
    while True:
        try:
            gate.mkdir()
            return gate
        except FileExistsError:
            with suppress(OSError):
                found = gate.stat()
                if server_clock(folder) - found.st_mtime > GATE_STALE and _open_left(gate, found):
                    continue
        if time.monotonic() - waited > 5 * GATE_STALE:
            raise Busy(f"{gate} stays closed: remove it if nobody is starting a run there")
        time.sleep(0.02)


def _open_left(gate: Path, seen: os.stat_result) -> bool:
    """Open a gate that a killed run has left closed, unless somebody else has done so and gone in meanwhile."""
    aside = gate.with_name(f"gate-{uuid.uuid4().hex}")
    gate.rename(aside)
    found = aside.stat()
    if (found.st_ino, found.st_mtime_ns) != (seen.st_ino, seen.st_mtime_ns):
        aside.rename(gate)
        return False
    aside.rmdir()
    log.warning("%s was left closed by a killed run and is opened", gate)
    return True


def _clear(path: Path, me: Holder, now: float, states: Mapping[str, set[str]]) -> None:
    """Break a stale lock, or raise Busy."""
    holder = _read(path)
    try:
        age = now - path.stat().st_mtime
    except FileNotFoundError:
        return
    if holder is None and age < STALE:
        raise Busy(f"{path} cannot be read; wait {STALE - age:.0f} s, or remove it if nobody is running there")
    why = _stale(holder, path, me, now, states) if holder else "it is torn"
    if not why:
        what = "all of" if not holder or not holder.part else f"{holder.part} of"
        same = holder and holder.study == me.study
        study = "this study" if same else "another form of this study, or another --limit,"
        raise Busy(
            f"{path.parent.parent} is in use: {holder} runs {what} {study} there. Wait for it, stop it, or use another "
            f"folder. If it is dead, its lock goes stale in {max(STALE - age, 0):.0f} s."
        )
    log.warning("the lock of %s is broken: %s", holder, why)
    path.unlink(missing_ok=True)


def _stale(holder: Holder, path: Path, me: Holder, now: float, states: Mapping[str, set[str]]) -> str:
    """Why a lock is nobody's, or nothing; ``states`` are what SLURM says of jobs."""
    if holder.boot and (holder.boot, holder.space) == (me.boot, me.space):
        return "" if _started(holder.pid) == holder.started else "its process is gone"
    age = now - path.stat().st_mtime
    if holder.host == me.host and holder.boot != me.boot and age > 3 * BEAT:  # or two hosts of one name
        return "its host was started anew"
    if holder.job and holder.job == me.job and holder.turn < me.turn and _same_cluster(holder, me):
        return "it is of an earlier turn of this job"
    if holder.job in states and holder.user == me.user and _same_cluster(holder, me):
        if not states[holder.job] & LIVE_STATES:
            return f"job {holder.job} does not run any more"
        if states[holder.job] & HELD_STATES:
            return ""
    return f"it was not touched for {age:.0f} s" if age > STALE else ""


def _same_cluster(one: Holder, other: Holder) -> bool:
    """Whether job numbers mean the same; outside a job nobody says which cluster this is."""
    return not one.cluster or not other.cluster or one.cluster == other.cluster


def _states(jobs: Iterable[str]) -> dict[str, set[str]]:
    """What SLURM says of jobs, a set without members where it is sure that one is not there; no answer is no proof."""
    wanted = sorted({job for job in jobs if job})
    if not wanted or shutil.which("squeue") is None:
        return {}
    # one question, also for a thousand tasks; asked by number, a job that ended long ago would make it an error
    form = ["squeue", "-h", "-r", "-u", str(os.getuid()), "-o", "%i %T"]
    try:
        ended = subprocess.run(form, capture_output=True, text=True, timeout=ANSWER, check=False)
    except (OSError, subprocess.SubprocessError):
        return {}
    if ended.returncode:
        return {}
    found: dict[str, set[str]] = {job: set() for job in wanted}
    for words in map(str.split, ended.stdout.splitlines()):
        if len(words) == 2 and words[0] in found:
            found[words[0]].add(words[1])
    return found


def _parse(text: str) -> Holder:
    return Holder(**json.loads(text))


def _read(path: Path) -> Holder | None:
    try:
        return _parse(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return None

