"""One map over points for serial runs, MPI ranks and array slices. The only file that imports mpi4py.

No rank runs model code, not even in a serial run: each drives one supervised child and appends the rows
to a journal of its own. Rank 0 also hands out the points, as orders (key and design variables), in chunks that last
for a while; children make scenes of them. It never blocks: it polls its child and messages in turn, and so do the
others, because a blocking receive would burn the core that the child computes on.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from solvers import CACHE

from .config import Study
from .plan import Orders
from .point import Order, Point, Record
from .store import Store, open_store
from .supervise import SIGNALS, CannotRun, Child

GRACE = {"SIGUSR1": 60.0}  # a point in flight may finish within this time of a signal [s] ...
SHORT = 5.0  # ... and within this of the others: SLURM kills 30 s after SIGTERM
IMPATIENT = 1.0  # a second Ctrl-C after this ends a run at once; a launcher passes the first one on twice [s]
POLL = 0.002  # how long a rank with something to do sleeps between looks [s]
CHUNK_SECONDS, CHUNK = 0.5, 1024  # a chunk lasts for so long, and holds no more points
NEWS, ALIVE = 0.5, 10.0  # how often a rank tells of its rows, or that it lives [s]
AHEAD = 1.0  # points shorter than this are fetched before they are needed [s]
LAST_WORDS = 2.0  # a launcher that is told to abort drops what it has not yet passed on of stderr [s]
SILENCE = 300.0  # a rank that says nothing for longer is dead or hangs [s]
WARM = 120.0  # the others wait no longer for the first of them to fill the compiler's cache [s]
RANK_MEMORY = 300.0  # that a rank itself takes [MB]
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
    memory_limit: float | None = None  # of one point's process [MB]
    study: Study | None = None  # of which orders are made points
    turn: int | None = None  # of the run, the same for all ranks
    silence: float = SILENCE
    batches: bool = False  # ranks and children stay for the next batch of points, and rank 0 is sent every row

    def store(self, rank: int) -> Store:
        known = self.any_version or self.turn is not None  # then rank 0 has seen to it
        return open_store(self.directory, f"{self.part}{rank}", self.header, any_version=known, turn=self.turn)

    def child(self, here: int = 0) -> Child:
        """A child, one of so many on this node (0: the environment may know)."""
        limits = self.time_limit, self.memory_limit or memory_share(here)
        return Child(self.evaluator, self.warm_ups, *limits, study=self.study)


@dataclass(frozen=True)
class Done:
    """What the heartbeat needs of finished points."""

    status: str
    message: str
    seconds: float  # of one of them
    count: int = 1


def memory_share(here: int = 0) -> float | None:
    """What a worker may use where the study does not say [MB]: its share of the job's or the machine's memory.

    ``here`` is how many share the node; 0 takes what the launcher's environment says.
    """
    cores = _count("SLURM_CPUS_PER_TASK") or 1
    if limit := _count("SLURM_MEM_PER_CPU") * cores:
        share = float(limit)
    else:
        names = ("SLURM_NTASKS_PER_NODE", "MPI_LOCALNRANKS", "OMPI_COMM_WORLD_LOCAL_SIZE")
        here = here or next(filter(None, map(_count, names)), 1)
        try:
            share = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
        except (ValueError, OSError):
            return None
        share = 0.9 * min(share, _count("SLURM_MEM_PER_NODE") or share) / here
    return round(max(share - RANK_MEMORY, share / 2))


# --------------------------------------------------------------------------------------------- interrupts


class Interrupt:
    """Set by SIGINT, SIGTERM and SIGUSR1: hand out no more, let the points in flight end within ``GRACE``."""

    def __init__(self) -> None:
        self.name = ""
        self.end = self.since = 0.0  # of the grace, by the monotonic clock

    def set(self, name: str) -> None:
        now = time.monotonic()
        self.since = self.since if self.name else now
        end = now + GRACE.get(name, SHORT)
        self.end = min(self.end, end) if self.name else end  # a SIGTERM after a SIGUSR1 is in more of a hurry
        self.name = self.name or name

    def __bool__(self) -> bool:
        return bool(self.name)

    @property
    def overdue(self) -> bool:
        return bool(self.name) and time.monotonic() > self.end


@contextmanager
def interruptible(interrupt: Interrupt | None = None) -> Iterator[Interrupt]:
    """Turn the signals that ask a job to end into a flag, a given one if somebody listens already."""
    if interrupt is not None:
        yield interrupt
        return
    interrupt = Interrupt()

    def handle(number: int, frame: FrameType | None) -> None:
        impatient = number == signal.SIGINT and interrupt.name and time.monotonic() - interrupt.since > IMPATIENT
        interrupt.set(signal.Signals(number).name)
        if impatient:
            raise KeyboardInterrupt

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
    local: int  # rank among those of this node
    here: int  # how many they are; 0 where nobody has counted
    hung: bool  # a rank does not answer: closing MPI would wait for it for ever

    def send(self, to: int, message: Any) -> None: ...
    def receive(self) -> tuple[int, Any] | None: ...
    def finish(self) -> None: ...
    def abort(self, code: int) -> None: ...


class Alone:
    """A world of one."""

    rank, size, local, here, hung = 0, 1, 0, 0, False

    def send(self, to: int, message: Any) -> None:
        raise AssertionError("nobody to send to")

    def receive(self) -> tuple[int, Any] | None:
        return None

    def finish(self) -> None:
        pass

    def abort(self, code: int) -> None:
        raise AssertionError("nobody to abort")


class Mpi:
    """COMM_WORLD."""

    def __init__(self, MPI: Any) -> None:
        self._mpi, self._comm = MPI, MPI.COMM_WORLD
        self.rank, self.size = self._comm.rank, self._comm.size
        node = self._comm.Split_type(MPI.COMM_TYPE_SHARED, self.rank)
        self.local, self.here = node.rank, node.size
        self.hung = False
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

    def abort(self, code: int) -> None:
        """End all ranks, those too that do not answer, once the launcher has had time to pass on what was said."""
        sys.stdout.flush()
        sys.stderr.flush()
        time.sleep(LAST_WORDS)
        self._comm.Abort(code)


def world() -> World:
    """The ranks this process belongs to; ``CannotRun`` when a launcher started copies that are strangers."""
    name, launched = max(((name, _count(name)) for name in SIZES), key=lambda pair: pair[1])
    if launched <= 1 and "mpi4py" not in sys.modules:  # an array task too: some MPIs end a process they did not start
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

    def __init__(self, job: Job, ranks: World, interrupt: Interrupt, report: Callable[[Done], None]) -> None:
        self.store = job.store(ranks.rank)
        self.store.open()
        self.child = job.child(ranks.here)
        self.queue: deque[Point | Order] = deque()
        self.interrupt, self.report = interrupt, report
        self.rows = 0
        self.kept: list[Record] | None = [] if job.batches else None  # rows that nobody was told

    @property
    def busy(self) -> bool:
        """Whether there is anything left to do here."""
        return bool(self.queue) or self.child.point is not None

    def step(self, timeout: float) -> None:
        """Keep the child at work, and wait at most ``timeout`` for a row."""
        if self.interrupt:
            self.queue.clear()
            self.child.drop()
        if self.interrupt.overdue:
            self.child.stop()
        self.feed()
        record = self.child.poll(timeout)
        if record is None:
            self.store.tick()
        else:
            done = Done(record.status, record.message, self.child.took)
            self.feed()  # the child works on while the row is written
            self.store.append(record)
            self.rows += 1
            if self.kept is not None:
                self.kept.append(record)
            self.report(done)

    def feed(self) -> None:
        """Give the child its next point, and where points are short the one after it."""
        while self.queue and (self.child.point is None or (self.child.ahead is None and 0 < self.child.took < AHEAD)):
            self.child.submit(self.queue.popleft())

    def close(self) -> None:
        self.child.stop()
        self.store.close()


def warm(mark: bool = False) -> bool:
    """Whether a rank of this node, or of all where the cache is shared, has filled the compiler's cache."""
    path = Path(CACHE) / "warm"
    with suppress(OSError):
        if mark:
            path.touch()
        return path.exists()
    return True  # no cache can be kept: there is nothing to wait for


def map_points(
    points: Sequence[Point | Order] | Orders,
    job: Job,
    ranks: World,
    report: Callable[[Done], None] = lambda done: None,
    beat: Callable[[], None] = lambda: None,
    interrupt: Interrupt | None = None,
) -> str:
    """Evaluate ``points`` over all ranks; rank 0 calls this while the others ``serve``.

    Every row is in a journal before ``report`` hears of it; ``beat`` is called often. ``interrupt`` is that of a caller
    who listens to signals already. Returns the name of the signal that stopped it early, or "". Raises ``CannotRun``
    or ``StoreError`` when all have stopped.
    """
    with interruptible(interrupt) as heard:
        return _Leader(points, job, ranks, heard, report, beat).run()


class Crew:
    """One batch of points after another over the same ranks and children; rank 0 has it while the others ``serve``.

    Use it as a context, with a job whose ``batches`` is set; ``report`` and ``beat`` as in :func:`map_points`.
    """

    def __init__(
        self,
        job: Job,
        ranks: World,
        report: Callable[[Done], None] = lambda done: None,
        beat: Callable[[], None] = lambda: None,
    ) -> None:
        self._given = job, ranks, report, beat
        self._signals: AbstractContextManager[Interrupt] = interruptible()
        self._leader: _Leader | None = None

    def __enter__(self) -> Crew:
        job, ranks, report, beat = self._given
        interrupt = self._signals.__enter__()
        try:
            self._leader = _Leader([], job, ranks, interrupt, report, beat)
        except BaseException:
            self._signals.__exit__(None, None, None)
            raise
        return self

    def map(self, points: Sequence[Point | Order] | Orders) -> tuple[list[Record], str]:
        """The rows of a batch in any order, each in a journal by now, and the signal that cut it short or ""."""
        assert self._leader is not None
        return self._leader.batch(points)

    def __exit__(self, kind: object, *error: object) -> None:
        try:
            if self._leader is not None:
                self._leader.part(failed=kind is not None)
        finally:
            self._signals.__exit__(None, None, None)


def evaluate_alone(point: Point, job: Job) -> Record:
    """Evaluate one point in a child of its own, exactly as a run does."""
    child = job.child()
    try:
        child.submit(point)
        while (record := child.poll(0.5)) is None:
            pass
        return record
    finally:
        child.stop()


class _Queue:
    """Points that nobody has yet."""

    def __init__(self, points: Sequence[Point | Order] | Orders) -> None:
        self._points = points
        self._taken = 0

    def __len__(self) -> int:
        return len(self._points) - self._taken

    def take(self, most: int) -> Sequence[Point | Order] | Orders:
        begin = self._taken
        self._taken = min(begin + most, len(self._points))
        if isinstance(self._points, Orders):
            return self._points.batch(begin, self._taken)
        return self._points[begin : self._taken]


class _Leader:
    """Rank 0: works like everybody else, and hands out the points."""

    def __init__(
        self,
        points: Sequence[Point | Order] | Orders,
        job: Job,
        ranks: World,
        interrupt: Interrupt,
        report: Callable[[Done], None],
        beat: Callable[[], None],
    ) -> None:
        self.queue = _Queue(points)
        self.job, self.ranks, self.interrupt, self.report, self.beat = job, ranks, interrupt, report, beat
        self.mean = 0.0  # seconds of a point, over the last hundred or so
        self.worker = _Worker(job, ranks, interrupt, self.count)
        self.working: set[int] = set()  # ranks that have a job and have not said goodbye
        self.begun = False
        self.hungry: list[int] = []  # ranks that wait for the next batch
        self.rows: list[Record] = []  # of this batch
        self.heard: dict[int, float] = {}  # when each of them spoke last

    def run(self) -> str:
        try:
            self.begin()
            self.work(lambda: not self.working)
        finally:
            self.worker.close()
        return self.interrupt.name

    def batch(self, points: Sequence[Point | Order] | Orders) -> tuple[list[Record], str]:
        """As ``run``, and everybody stays for the next batch."""
        self.queue, self.rows = _Queue(points), []
        self.begin()
        hungry, self.hungry = self.hungry, []
        for rank in hungry:
            self.ranks.send(rank, ("points", self.chunk()))
        self.work(lambda: len(self.rows) >= len(points) or bool(self.interrupt and not self.working))
        return self.rows, self.interrupt.name

    def part(self, failed: bool = False) -> None:
        """There is no other batch, or something went wrong between two of them."""
        try:
            if failed:
                self.interrupt.set("a failure")
                self.call_off()
                return
            self.job = replace(self.job, batches=False)
            for rank in self.hungry:
                self.ranks.send(rank, ("points", []))
            self.work(lambda: not self.working)
        finally:
            self.worker.close()

    def begin(self) -> None:
        """The first points start the children and the other ranks."""
        if self.begun or not self.queue or self.interrupt:
            return
        self.begun = True
        with self.failing():
            self.worker.child.start()
            self.tell_others("job", self.job)
            self.first()

    def work(self, ended: Callable[[], bool]) -> None:
        with self.failing():
            while not ended() or self.worker.busy or (self.queue and not self.interrupt):
                if not self.worker.busy or (not self.worker.queue and 0 < self.mean < AHEAD):
                    self.feed()
                self.turn(min(max(self.mean / 10, POLL), 25 * POLL) if self.working else 0.1)
                if self.interrupt and self.working:
                    self.call_off()

    @contextmanager
    def failing(self) -> Iterator[None]:
        """What goes wrong here is told to the others before it is raised."""
        try:
            yield
        except BaseException:
            self.interrupt.set("a failure")
            with suppress(Silent):  # the failure is what there is to say; ``hung`` keeps it in mind
                self.call_off()
            raise

    def first(self) -> None:
        """The first point alone: it fills the compiler's cache, which the other children then read."""
        self.feed()
        began = None
        while self.worker.busy and self.ranks.size > 1:
            self.turn(POLL)
            if began is None and self.worker.child.ready:
                began = time.monotonic()
            if began is not None and time.monotonic() - began > WARM:
                break
        if self.ranks.size > 1:
            warm(mark=True)
        self.tell_others("go", None)

    def count(self, done: Done) -> None:
        share = max(done.count / 100, 0.02)
        self.mean += (done.seconds - self.mean) * (min(share, 1.0) if self.mean else 1.0)
        self.report(done)

    def feed(self) -> None:
        if not self.interrupt:
            self.worker.queue.extend(self.queue.take(1 + (0 < self.mean < AHEAD and len(self.queue) > self.ranks.size)))

    def turn(self, timeout: float) -> None:
        self.worker.step(timeout)
        if self.worker.kept:
            self.rows += self.worker.kept
            self.worker.kept.clear()
        self.listen()
        self.beat()

    def tell_others(self, kind: str, content: object) -> None:
        if kind == "job":
            self.working = set(range(1, self.ranks.size))
            self.heard = dict.fromkeys(self.working, time.monotonic())
        for rank in self.working:
            self.ranks.send(rank, (kind, content))

    def listen(self) -> None:
        while (letter := self.ranks.receive()) is not None:
            rank, (kind, content) = letter
            self.heard[rank] = time.monotonic()
            if kind == "done":
                for done in content:
                    self.count(done)
            elif kind == "rows":
                self.rows += content
            elif kind == "ask" and self.job.batches and not len(self.queue) and not self.interrupt:
                self.hungry.append(rank)
            elif kind == "ask":
                self.ranks.send(rank, ("points", self.chunk()))
            elif kind == "interrupted":
                self.interrupt.set(content)
            elif kind in ("bye", "broken"):
                self.working.discard(rank)
                if kind == "broken":
                    text, resumable = content
                    raise CannotRun(f"rank {rank}: {text}", resumable)
        oldest = min((self.heard[rank] for rank in self.working), default=time.monotonic())
        if time.monotonic() - oldest > self.job.silence:
            silent = sorted(rank for rank in self.working if self.heard[rank] == oldest)
            raise self.silent(silent[0], f"has been silent for {self.job.silence:.0f} s")

    def silent(self, rank: int, how: str) -> Silent:
        self.ranks.hung = True
        return Silent(f"rank {rank} {how}: it is dead or hangs")

    def chunk(self) -> Sequence[Point | Order] | Orders:
        """As many points as last for a while; fewer near the end, so that nobody is left with the last ones."""
        if self.interrupt:
            return []
        lasting = CHUNK_SECONDS / self.mean if self.mean > 0 else 1
        return self.queue.take(int(max(1, min(lasting, CHUNK, len(self.queue) / (4 * self.ranks.size)))))

    def call_off(self) -> None:
        """Tell the others to stop, and wait until they have: a point in flight has its grace to end."""
        self.tell_others("stop", self.interrupt.name)
        while self.working and time.monotonic() < self.interrupt.end + SHORT:
            try:
                self.turn(POLL)
            except Silent:
                break
            except Exception:
                continue
        deaf, self.working = sorted(self.working), set()
        if deaf:
            raise self.silent(deaf[0], "did not end when it was told to")


class Silent(CannotRun):
    """A rank does not answer; all that is written is safe, and the job can only be aborted."""

    def __init__(self, text: str) -> None:
        super().__init__(f"{text}. The run is given up; the same command goes on from here.", resumable=True)


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
    """A rank above 0 with a job: asks for more while it still has points, so as never to wait."""

    def __init__(self, job: Job, ranks: World, interrupt: Interrupt) -> None:
        self.ranks, self.interrupt = ranks, interrupt
        self.worker = _Worker(job, ranks, interrupt, self.note)
        self.news: Counter[tuple[str, str]] = Counter()  # rows that rank 0 has not heard of
        self.seconds: defaultdict[tuple[str, str], float] = defaultdict(float)
        self.told = time.monotonic()
        self.more = True  # rank 0 may have points for us
        self.asked = False
        self.going = False  # rank 0 has filled the compiler's cache
        self.since = 0.0
        self.low = 0  # ask for more at so many points

    def run(self) -> None:
        told = False
        self.worker.child.start()
        try:
            while self.more or self.worker.busy:
                if self.interrupt and not told:
                    told = True
                    self.ranks.send(0, ("interrupted", self.interrupt.name))
                enough = len(self.worker.queue) > self.low if self.worker.child.took < AHEAD else self.worker.busy
                if self.going and self.more and not self.asked and not enough:
                    self.asked = True
                    self.ranks.send(0, ("ask", None))
                self.worker.step(POLL if self.asked or not self.going else 10 * POLL)
                self.listen()
                self.tell()
        finally:
            self.worker.close()
        self.tell(last=True)

    def note(self, done: Done) -> None:
        self.news[done.status, done.message] += 1
        self.seconds[done.status, done.message] += done.seconds
        if self.worker.rows == 1:
            warm(mark=True)

    def tell(self, last: bool = False) -> None:
        """Send what was done, or a sign of life, now and then."""
        every = NEWS * max(1.0, self.ranks.size / 256) if self.news else ALIVE
        if self.worker.kept and not self.worker.busy:
            every = 0.0  # the next batch waits for these rows
        if last or time.monotonic() - self.told > every:
            self.told = time.monotonic()
            if self.worker.kept:
                self.ranks.send(0, ("rows", list(self.worker.kept)))
                self.worker.kept.clear()
            rows = [Done(*pair, self.seconds[pair] / n, n) for pair, n in self.news.items()]
            self.ranks.send(0, ("done", rows))
            self.news.clear()
            self.seconds.clear()

    def listen(self) -> None:
        while (letter := self.ranks.receive()) is not None:
            kind, content = letter[1]
            if kind == "go":
                self.since = time.monotonic()
            elif kind == "points":
                self.asked = False
                self.more = len(content) > 0 and self.more
                self.low = len(content) // 4
                self.worker.queue.extend(content)
            elif kind == "stop":
                self.interrupt.set(content)
                self.more = False
            elif kind == "quit":  # rank 0 could not wait for the point in flight
                self.more = False
                raise _Dismissed(int(content))
        if self.since and not self.going:  # on another node, with a cache of its own, one rank goes first
            self.going = self.ranks.local == 0 or warm() or time.monotonic() - self.since > WARM
            if self.going:
                self.worker.child.go()


def dismiss(ranks: World, code: int) -> None:
    """Rank 0's last word: every rank closes MPI and ends, or is ended where one of them does not answer."""
    if ranks.hung:
        ranks.abort(code)
    for rank in range(1, ranks.size):
        ranks.send(rank, ("quit", code))
    ranks.finish()
