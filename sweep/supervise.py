"""Drives one child process: one point at a time, killed at its limits, started again when it dies.

Model code runs nowhere else. Whatever happens to the child, the point in flight ends in a row with a reason. The
first child of a run is a fork of a process that has imported everything (``fork_spare``): importing takes seconds.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import traceback
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

from .child import failed, memory, work
from .point import Order, Point, Record

START_LIMIT = 900.0  # a child that imports and compiles for longer than this is stuck [s]
LOOK = 0.1  # how often the child's memory is looked at [s]
START_ATTEMPTS = 3  # children in a row that may die before they are ready
LAUNCHERS = ("PMI", "MPI", "OMPI_", "PMIX", "SLURM_", "HYDRA", "HYDI", "PRTE", "I_MPI", "MV2_")
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)  # the rank's to handle; its child is deaf to them


class CannotRun(RuntimeError):
    """The workers cannot work; ``resumable`` where what stopped them may pass."""

    def __init__(self, text: str, resumable: bool = False) -> None:
        super().__init__(text)
        self.resumable = resumable


def _environment() -> dict[str, str]:
    """This environment without the launcher's variables, one thread for each numerical library."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHERS)}
    house = str(Path(__file__).resolve().parents[1])
    kept["PYTHONPATH"] = os.pathsep.join([house, kept["PYTHONPATH"]] if kept.get("PYTHONPATH") else [house])
    return kept | dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


class _Process(Protocol):
    """What is needed of a process, forked or started."""

    pid: int

    def kill(self) -> None: ...
    def wait(self) -> int: ...


class _Fork:
    """A forked child of this process, and our end of its socket."""

    def __init__(self, pid: int, pipe: Connection) -> None:
        self.pid, self.pipe = pid, pipe
        self._code: int | None = None

    def kill(self) -> None:
        if self._code is None:  # else the number may be another's by now
            os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> int:
        if self._code is None:
            self._code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self._code


_spares: list[_Fork] = []


def fork_spare() -> bool:
    """Fork a child for the next ``Child`` to take, from this process as it is: with all that it has imported.

    Only a process of one thread that has not begun MPI may be forked, and one whose libraries have one thread each, as
    those of a child that is started have; returns whether it was done.
    """
    alone = sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1
    if not alone or "mpi4py.MPI" in sys.modules:
        return False
    ours, theirs = Pipe()
    parent = os.getpid()
    sys.stdout.flush()
    sys.stderr.flush()
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # inherited: an interrupt is the parent's to handle
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            _leave_home(theirs.fileno())
            code = work(parent, theirs)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    theirs.close()
    _spares.append(_Fork(pid, ours))
    return True


def _leave_home(socket: int) -> None:
    """Make a fork what a started child is: its own environment, no input, no files but its socket, and prints that go
    to stderr, wherever those of the parent went (a notebook, a test)."""
    environment = _environment()
    for name in os.environ.keys() - environment.keys():
        del os.environ[name]
    os.environ.update(environment)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.stdout, sys.stderr = (os.fdopen(handle, "w", buffering=1, closefd=False) for handle in (1, 2))
    for handle in map(int, os.listdir("/proc/self/fd")):
        if handle > 2 and handle != socket:
            with suppress(OSError):  # that of the listing itself
                os.close(handle)


def _ending(code: int) -> str:
    if code >= 0:
        return f"the worker process ended with exit code {code}"
    try:
        return f"the worker process was killed by signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"the worker process was killed by signal {-code}"


class Child:
    """One child process, one point at a time; ``poll`` always comes back with a record in the end."""

    def __init__(
        self,
        evaluator: str,
        warm_ups: tuple[str, ...] = (),
        time_limit: float | None = None,
        memory_limit: float | None = None,
        study: Any = None,
    ) -> None:
        self._functions = (evaluator, *warm_ups)
        self._limit = time_limit  # [s]
        self._memory = memory_limit  # [MB]
        self._study = study  # of which orders are made points
        self._looked = 0.0
        self._dropped = False
        self.took = 0.0  # by the last point, from its sending to its record [s]
        self._imported = self._going = False
        self.point: Point | Order | None = None
        self.ahead: Point | Order | None = None  # lies in the child's socket: short points do not wait for the next
        self._process: _Process | None = None
        self._pipe: Connection | None = None
        self._ready = False
        self._since = 0.0
        self._deaths = 0

    @property
    def ready(self) -> bool:
        """Whether it has imported and compiled."""
        return self._ready

    def start(self) -> None:
        """Start the process, or take the spare one; it imports, and waits for ``go``."""
        spare = _spares.pop() if _spares else None
        self._process, self._pipe = (spare, spare.pipe) if spare else self._started()
        self._ready, self._imported, self._since = False, False, time.monotonic()
        self._put(self._functions)

    def _started(self) -> tuple[_Process, Connection]:
        ours, theirs = Pipe()
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # inherited: an interrupt is the parent's to handle
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "sweep.child", str(os.getpid()), str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=2,
                pass_fds=[theirs.fileno()],
                env=_environment(),
            )
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            theirs.close()
        return process, ours

    def go(self) -> None:
        """Let the child compile, or load from the compiler's cache; for good, also after it has died."""
        if not self._going:
            self._going = True
            if self._imported:
                self._send((self._study, self._memory))

    def submit(self, point: Point | Order) -> None:
        """Take a point; it is sent as soon as the child is ready. One more may be taken while one is in flight."""
        self.go()
        if self.point is not None:
            self.ahead = point
            if self._ready:
                self._put(point)
            return
        self.point = point
        if self._process is None:
            self.start()
        elif self._ready:
            self._send(point)

    def drop(self) -> None:
        """Do not begin the point ahead: the child ends with the one in flight."""
        self._dropped = self._dropped or self.ahead is not None
        self.ahead = None

    def poll(self, timeout: float) -> Record | None:
        """Wait at most ``timeout`` for the record of the point in flight."""
        if self._pipe is None:
            time.sleep(timeout)
            return None
        try:
            letter = self._pipe.recv() if self._pipe.poll(timeout) else None
        except (EOFError, OSError):
            return self._died()
        except Exception as error:  # what came was no pickle of ours
            return self._end("CRASHED", f"the worker process sent nonsense: {error}")
        if letter is not None:
            return self._receive(*letter)
        elapsed = time.monotonic() - self._since
        if not self._ready and (self._going or not self._imported) and elapsed > START_LIMIT:
            self.stop()
            raise CannotRun(f"the worker process was not ready after {START_LIMIT:g} s")
        if self._ready and self.point and self._limit is not None and elapsed > self._limit:
            return self._end("TIMEOUT", f"passed the time limit of {self._limit:g} s")
        return self._look() if self.point and self._ready else None

    def _look(self) -> Record | None:
        """End a point whose process has more memory than it may."""
        now = time.monotonic()
        if self._memory is None or self._process is None or now - self._looked < LOOK:
            return None
        self._looked = now
        usage = memory(self._process.pid)
        if usage is not None and usage[0] > self._memory:
            return self._end("MEMORY", f"passed the memory limit of {self._memory:g} MB")
        return None

    def stop(self) -> None:
        """Kill the child; the point in flight is lost, and so is not in the journal."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = self.point = self.ahead = None
        self._ready = self._dropped = False

    def _send(self, content: Any) -> None:
        self._since = time.monotonic()
        self._put(content)

    def _put(self, content: Any) -> None:
        try:
            assert self._pipe is not None
            self._pipe.send(content)
        except OSError:
            pass  # it died: the next poll says so

    def _receive(self, kind: str, content: Any) -> Record | None:
        if kind == "broken":
            doing = "go on" if self._ready else "start"
            self.stop()
            raise CannotRun(f"the worker process cannot {doing}: {content}")
        if kind == "imported":
            self._imported = True
            if self._going:
                self._send((self._study, self._memory))
            return None
        if kind == "ready":
            self._ready, self._deaths = True, 0
            for point in (self.point, self.ahead):
                if point is not None:
                    self._send(point)
            return None
        if not isinstance(content, Record):
            return self._end("ERROR", f"the evaluator gave a {type(content).__name__} in place of a record")
        if content.status == "MEMORY":  # a process that met its limit is not to be trusted with another point
            why = f"passed the memory limit of {self._memory:g} MB" if self._memory else content.message
            return self._end("MEMORY", why)
        now = time.monotonic()
        self.point, self.ahead, self.took, self._since = self.ahead, None, now - self._since, now
        if self._dropped:
            self.stop()
        return content

    def _died(self) -> Record | None:
        assert self._process is not None
        self._process.kill()  # it may have closed the socket and live on
        why = _ending(self._process.wait())
        if self._ready:
            return self._end("CRASHED", why)
        self._deaths += 1
        if self._deaths >= START_ATTEMPTS:
            self.stop()
            raise CannotRun(f"{why} before it was ready, {START_ATTEMPTS} times")
        self.start()
        return None

    def _end(self, status: str, message: str) -> Record | None:
        """Record the point in flight as lost, and begin again with a fresh child."""
        point, ahead, seconds = self.point, self.ahead, time.monotonic() - self._since
        self.took = seconds
        self.stop()
        self.point = ahead  # it was not begun
        try:
            self.start()
        except OSError as error:  # the row first: without a child the next point says why
            message = f"{message}; no new worker process could be started: {error}"
        return failed(point, status, message, seconds) if point else None
