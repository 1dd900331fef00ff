"""One map over points for serial runs, MPI ranks and array slices. The only file that imports mpi4py.

No rank runs model code, not even in a serial run: each drives one supervised child and appends the rows
to a journal of its own. Rank 0 also hands out the points. It never blocks: it polls its child and messages
in turn, and so do the others, because a blocking receive would burn the core that the child computes on.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, Protocol

from .point import Point, Record
from .store import Store, open_store
from .supervise import SIGNALS, CannotRun, Child

GRACE = 5.0  # a point in flight may finish within this time of an interrupt [s]
POLL = 0.002  # how long a rank with something to do sleeps between looks [s]
CHUNK = 16  # most points handed out at once
TAG = 7
SIZES = ("SLURM_NTASKS", "PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MPI_LOCALNRANKS", "MV2_COMM_WORLD_SIZE")


@dataclass(frozen=True, kw_only=True)
class Job:
    """What every rank needs to work: where rows go, what makes them, how long a point may take."""

    directory: str | None = None  # None keeps the rows in memory (serial runs only)
    part: str = ""  # prefix of the journals' names: one for each slice of a job array
    header: Mapping[str, Any] = field(default_factory=dict)
    any_version: bool = False
    evaluator: str = "sweep.evaluate:evaluate"
    warm_ups: tuple[str, ...] = ("solvers:warm_up",)
    time_limit: float | None = None  # of one point [s]

    def store(self, rank: int) -> Store:
        return open_store(self.directory, f"{self.part}{rank}", self.header, any_version=self.any_version)


@dataclass(frozen=True)
class Done:
    """What the heartbeat needs of a finished point."""

    status: str
    message: str
    seconds: float


# --------------------------------------------------------------------------------------------- interrupts


class Interrupt:
    """Set by SIGINT, SIGTERM and SIGUSR1: hand out no more, let the points in flight end within ``GRACE``."""

    def __init__(self) -> None:
        self.name = ""
        self.at = 0.0

    def set(self, name: str) -> None:
        if not self.name:
            self.name, self.at = name, time.monotonic()

    def __bool__(self) -> bool:
        return bool(self.name)

    @property
    def overdue(self) -> bool:
        return bool(self.name) and time.monotonic() - self.at > GRACE


@contextmanager
def interruptible() -> Iterator[Interrupt]:
    """Turn the signals that ask a job to end into a flag."""
    interrupt = Interrupt()

    def handle(number: int, frame: FrameType | None) -> None:
        interrupt.set(signal.Signals(number).name)

    before = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# --------------------------------------------------------------------------------------------- ranks


class World(Protocol):
    """What the map needs of MPI: rank, size, and messages that never block."""

    rank: int
    size: int

    def send(self, to: int, message: Any) -> None: ...
    def receive(self) -> tuple[int, Any] | None: ...
    def finish(self) -> None: ...


class Alone:
    """A world of one."""

    rank, size = 0, 1

    def send(self, to: int, message: Any) -> None:
        raise AssertionError("nobody to send to")

    def receive(self) -> tuple[int, Any] | None:
        return None

    def finish(self) -> None:
        pass


class Mpi:
    """COMM_WORLD."""

    def __init__(self, MPI: Any) -> None:
        self._mpi, self._comm = MPI, MPI.COMM_WORLD
        self.rank, self.size = self._comm.rank, self._comm.size
        self._sent: list[Any] = []

    def send(self, to: int, message: Any) -> None:
        self._sent = [request for request in self._sent if not request.test()[0]]
        self._sent.append(self._comm.isend(message, to, TAG))

    def receive(self) -> tuple[int, Any] | None:
        status = self._mpi.Status()
        if not self._comm.iprobe(self._mpi.ANY_SOURCE, TAG, status):
            return None
        return status.source, self._comm.recv(None, status.source, TAG)

    def finish(self) -> None:
        """Close MPI here, so that an exit code other than 0 is an exit code and not an abort."""
        for request in self._sent:
            request.wait()
        if not self._mpi.Is_finalized():
            self._mpi.Finalize()


def world() -> World:
    """The ranks this process belongs to; ``CannotRun`` when a launcher started copies that are strangers."""
    name, launched = max(((name, _count(name)) for name in SIZES), key=lambda pair: pair[1])
    if launched == 0 and "mpi4py" not in sys.modules:
        return Alone()
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        if launched > 1:
            raise CannotRun(_strangers(name, launched, f"mpi4py cannot be loaded here ({error})")) from None
        return Alone()
    if MPI.COMM_WORLD.size == 1 and launched > 1:
        raise CannotRun(_strangers(name, launched, "MPI sees only one"))
    return Mpi(MPI)


def _count(name: str) -> int:
    text = os.environ.get(name, "")
    return int(text) if text.isdigit() else 0


def _strangers(name: str, launched: int, why: str) -> str:
    return (
        f"{launched} processes were asked for ({name}={launched}) but {why}: each would run the whole study. "
        "Use the mpirun of mpi4py's own MPI (`pip install mpich` brings one), `srun --mpi=pmi2`, or one task."
    )


# --------------------------------------------------------------------------------------------- the map


class _Worker:
    """A rank's child, its queue and its journal."""

    def __init__(self, job: Job, rank: int, interrupt: Interrupt, report: Callable[[Done], None]) -> None:
        self.store = job.store(rank)
        self.child = Child(job.evaluator, job.warm_ups, job.time_limit)
        self.queue: deque[Point] = deque()
        self.interrupt, self.report = interrupt, report

    @property
    def busy(self) -> bool:
        """Whether there is anything left to do here."""
        return bool(self.queue) or self.child.point is not None

    def step(self, timeout: float) -> None:
        """Keep the child at work, and wait at most ``timeout`` for a row."""
        if self.interrupt:
            self.queue.clear()
        if self.interrupt.overdue:
            self.child.stop()
        if self.queue and self.child.point is None:
            self.child.submit(self.queue.popleft())
        record = self.child.poll(timeout)
        if record is not None:
            self.store.append(record)
            self.report(Done(record.status, record.message, record.seconds))

    def close(self) -> None:
        self.child.stop()
        self.store.close()


def map_points(
    points: list[Point],
    job: Job,
    ranks: World,
    report: Callable[[Done], None] = lambda done: None,
    beat: Callable[[], None] = lambda: None,
) -> str:
    """Evaluate ``points`` over all ranks; rank 0 calls this while the others ``serve``.

    Every row is in a journal before ``report`` hears of it; ``beat`` is called often. Returns the name of
    the signal that stopped it early, or "". Raises ``CannotRun`` or ``StoreError`` when all have stopped.
    """
    with interruptible() as interrupt:
        return _Leader(points, job, ranks, interrupt, report, beat).run()


def evaluate_alone(point: Point, job: Job) -> Record:
    """Evaluate one point in a child of its own, exactly as a run does."""
    child = Child(job.evaluator, job.warm_ups, job.time_limit)
    try:
        child.submit(point)
        while (record := child.poll(0.5)) is None:
            pass
        return record
    finally:
        child.stop()


class _Leader:
    """Rank 0: works like everybody else, and hands out the points."""

    def __init__(
        self,
        points: list[Point],
        job: Job,
        ranks: World,
        interrupt: Interrupt,
        report: Callable[[Done], None],
        beat: Callable[[], None],
    ) -> None:
        self.queue = deque(points)
        self.job, self.ranks, self.interrupt, self.report, self.beat = job, ranks, interrupt, report, beat
        self.worker = _Worker(job, 0, interrupt, report)
        self.working: set[int] = set()  # ranks that have a job and have not said goodbye

    def run(self) -> str:
        try:
            # The first point alone: it fills the compiler's cache, which the other children then read.
            self.feed()
            while self.worker.busy:
                self.turn(0.1)
            if self.queue and not self.interrupt:
                self.tell_others("job", self.job)
            while self.working or self.worker.busy or (self.queue and not self.interrupt):
                if not self.worker.busy:
                    self.feed()
                self.turn(POLL if self.working else 0.1)
                if self.interrupt and self.working:
                    self.call_off()
        except BaseException:
            self.interrupt.set("a failure")
            self.call_off()
            raise
        finally:
            self.worker.close()
        return self.interrupt.name

    def feed(self) -> None:
        if self.queue and not self.interrupt:
            self.worker.queue.append(self.queue.popleft())

    def turn(self, timeout: float) -> None:
        self.worker.step(timeout)
        self.listen()
        self.beat()

    def tell_others(self, kind: str, content: object) -> None:
        if kind == "job":
            self.working = set(range(1, self.ranks.size))
        for rank in self.working:
            self.ranks.send(rank, (kind, content))

    def listen(self) -> None:
        while (letter := self.ranks.receive()) is not None:
            rank, (kind, content) = letter
            if kind == "done":
                self.report(content)
            elif kind == "ask":
                self.ranks.send(rank, ("points", self.chunk()))
            elif kind == "interrupted":
                self.interrupt.set(content)
            else:
                self.working.discard(rank)
                if kind == "broken":
                    text, resumable = content
                    raise CannotRun(f"rank {rank}: {text}", resumable)

    def chunk(self) -> list[Point]:
        """Small near the end, so that nobody is left with the last ones."""
        size = 0 if self.interrupt else max(1, min(CHUNK, len(self.queue) // (8 * self.ranks.size)))
        return [self.queue.popleft() for _ in range(min(size, len(self.queue)))]

    def call_off(self) -> None:
        """Tell the others to stop, and wait until they have: a point in flight has ``GRACE`` to end."""
        self.tell_others("stop", self.interrupt.name)
        while self.working and time.monotonic() - self.interrupt.at < 2 * GRACE:
            with suppress(Exception):  # whatever fails now, the others must still hear the end
                self.turn(POLL)
        self.working.clear()


def serve(ranks: World) -> int:
    """Every rank but 0: work for rank 0 until it says "quit"; returns the exit code that it gives."""
    with interruptible() as interrupt:
        while True:
            letter = ranks.receive()
            if letter is None:
                time.sleep(POLL)
                continue
            kind, content = letter[1]
            if kind == "quit":
                ranks.finish()
                return int(content)
            if kind == "job":
                try:
                    _Follower(content, ranks, interrupt).run()
                    ranks.send(0, ("bye", None))
                except _Dismissed as dismissed:
                    ranks.finish()
                    return dismissed.code
                except Exception as error:
                    ranks.send(0, ("broken", (str(error), getattr(error, "resumable", False))))


class _Dismissed(Exception):
    """Rank 0 has ended while a point was still in flight here."""

    def __init__(self, code: int) -> None:
        super().__init__(f"dismissed with exit code {code}")
        self.code = code


class _Follower:
    """A rank above 0 with a job: asks for points while its last one is in flight, so as never to wait."""

    def __init__(self, job: Job, ranks: World, interrupt: Interrupt) -> None:
        self.ranks, self.interrupt = ranks, interrupt
        self.worker = _Worker(job, ranks.rank, interrupt, lambda done: ranks.send(0, ("done", done)))
        self.more = True  # rank 0 may have points for us
        self.asked = False

    def run(self) -> None:
        told = False
        try:
            while self.more or self.worker.busy:
                if self.interrupt and not told:
                    told = True
                    self.ranks.send(0, ("interrupted", self.interrupt.name))
                if self.more and not self.asked and not self.worker.queue:
                    self.asked = True
                    self.ranks.send(0, ("ask", None))
                self.worker.step(POLL if self.asked else 10 * POLL)
                self.listen()
        finally:
            self.worker.close()

    def listen(self) -> None:
        while (letter := self.ranks.receive()) is not None:
            kind, content = letter[1]
            if kind == "points":
                self.asked = False
                self.more = bool(content) and self.more
                self.worker.queue.extend(content)
            elif kind == "stop":
                self.interrupt.set(content)
                self.more = False
            elif kind == "quit":  # rank 0 could not wait for the point in flight
                self.more = False
                raise _Dismissed(int(content))


def dismiss(ranks: World, code: int) -> None:
    """Rank 0's last word: every rank closes MPI and ends."""
    for rank in range(1, ranks.size):
        ranks.send(rank, ("quit", code))
    ranks.finish()
