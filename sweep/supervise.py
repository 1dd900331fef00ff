"""Drives one child process: one point at a time, killed at the time limit, started again when it dies.

Model code runs nowhere else. Whatever happens to the child, the point in flight ends in a row with a reason.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from .child import failed
from .point import Point, Record

START_LIMIT = 900.0  # a child that imports and compiles for longer than this is stuck [s]
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
        self, evaluator: str, warm_ups: tuple[str, ...] = (), time_limit: float | None = None
    ) -> None:
        self._functions = (evaluator, *warm_ups)
        self._limit = time_limit  # [s]
        self.point: Point | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._ready = False
        self._since = 0.0
        self._deaths = 0

    def start(self) -> None:
        """Start the process; it says "ready" when it has imported and compiled."""
        ours, theirs = Pipe()
        handles = [str(os.getpid()), str(theirs.fileno())]
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # inherited: an interrupt is the parent's to handle
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "sweep.child", *handles, *self._functions],
                stdin=subprocess.DEVNULL,
                stdout=2,
                pass_fds=[theirs.fileno()],
                env=_environment(),
            )
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            theirs.close()
        self._pipe, self._ready, self._since = ours, False, time.monotonic()

    def submit(self, point: Point) -> None:
        """Take a point; it is sent as soon as the child is ready."""
        self.point = point
        if self._process is None:
            self.start()
        elif self._ready:
            self._send()

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
        if not self._ready and elapsed > START_LIMIT:
            self.stop()
            raise CannotRun(f"the worker process was not ready after {START_LIMIT:g} s")
        if self._ready and self.point and self._limit is not None and elapsed > self._limit:
            return self._end("TIMEOUT", f"passed the time limit of {self._limit:g} s")
        return None

    def stop(self) -> None:
        """Kill the child; the point in flight is lost, and so is not in the journal."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = self.point = None
        self._ready = False

    def _send(self) -> None:
        self._since = time.monotonic()
        try:
            assert self._pipe is not None
            self._pipe.send(self.point)
        except OSError:
            pass  # it died: the next poll says so

    def _receive(self, kind: str, content: Any) -> Record | None:
        if kind == "broken":
            self.stop()
            raise CannotRun(f"the worker process cannot start: {content}")
        if kind == "ready":
            self._ready, self._deaths = True, 0
            if self.point:
                self._send()
            return None
        if not isinstance(content, Record):
            return self._end("ERROR", f"the evaluator gave a {type(content).__name__} in place of a record")
        self.point = None
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
        point, seconds = self.point, time.monotonic() - self._since
        self.stop()
        try:
            self.start()
        except OSError as error:  # the row first: without a child the next point says why
            message = f"{message}; no new worker process could be started: {error}"
        return failed(point, status, message, seconds) if point else None
