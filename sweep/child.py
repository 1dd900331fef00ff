"""The supervised child: points come in over a socket, records go back. Started by ``supervise`` only.

A model that segfaults, loops for ever, eats memory or is killed takes this process with it and nothing else. Messages
are length-prefixed pickles on a socket of their own, so that stray prints cannot corrupt them. The child is told its
functions, imports them, says "imported", waits for "go" (the compiler's cache may still be filled by another rank),
warms up, says "ready".
It ends when its parent does: on Linux the kernel kills it, elsewhere it sees the closed socket at its next message.
"""

from __future__ import annotations

import ctypes
import faulthandler
import importlib
import importlib.util
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from .config import split_name
from .mistakes import ConfigError
from .point import Order, Point, Record
from .space import made

PR_SET_PDEATHSIG, PR_SET_NAME = 1, 15
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc
MOST_MESSAGE = 500  # characters of a row's message that are kept


def die_with_parent(parent: int) -> None:
    """Ask the kernel to kill this process when its parent dies, whatever it is doing then."""
    if sys.platform == "linux":
        kernel = ctypes.CDLL(None, use_errno=True)
        kernel.prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL))
        kernel.prctl(PR_SET_NAME, b"sweep.child")  # a fork has its parent's command line
    if os.getppid() != parent:
        os._exit(0)


def keep_memory() -> None:
    """Let freed memory stay with this process: to give the pages of a run's signals back and fault them in again at the
    next point costs short points some of their time."""
    if sys.platform == "linux":
        with suppress(AttributeError):  # another library than glibc
            mallopt = ctypes.CDLL(None).mallopt
            mallopt(M_TRIM_THRESHOLD, 256 << 20)
            mallopt(M_MMAP_THRESHOLD, 32 << 20)


def locate(name: str) -> Callable[..., Any]:
    """The function called ``package.module:function`` or ``folder/file.py:function``."""
    where, _, attribute = name.rpartition(":")
    if where.endswith(".py"):
        spec = importlib.util.spec_from_file_location(Path(where).stem, where)
        if spec is None or spec.loader is None:
            raise ImportError(f"no Python file at {where}")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    else:
        module = importlib.import_module(where)
    found: Callable[..., Any] = getattr(module, attribute)
    return found


def limit_memory(limit: float) -> None:
    """Let this process hold ``limit`` MB of data, and as much more as it has reserved and not used by now."""
    usage = memory(os.getpid())
    if usage is not None:
        resident, data = usage
        most = int((limit + max(data - resident, 0.0)) * 1e6)
        resource.setrlimit(resource.RLIMIT_DATA, (most, resource.getrlimit(resource.RLIMIT_DATA)[1]))


def memory(pid: int) -> tuple[float, float] | None:
    """Resident memory of a process that is its own, and its data segment [MB]; None where nobody can say."""
    try:
        words = [int(word) for word in Path(f"/proc/{pid}/statm").read_text().split()]
    except (OSError, ValueError):
        return None
    page = resource.getpagesize() / 1e6
    return (words[1] - words[2]) * page, words[5] * page


def brief(message: str) -> str:
    """A message fit for a row: not an array printed in full, and text that every file can hold."""
    if len(message) > MOST_MESSAGE:
        message = f"{message[: MOST_MESSAGE - 30]} ... ({len(message)} characters)"
    return message.replace("\0", " ").encode("utf-8", "replace").decode()


def failed(point: Point | Order, status: str, message: str, seconds: float = 0.0) -> Record:
    """The row of a point that gave no result."""
    return Record(
        key=point.key,
        design=point.design,
        environment=point.environment,
        values=dict(point.values),
        status=status,
        message=brief(message),
        seconds=seconds,
    )


def reason(error: BaseException) -> str:
    """One line: what was raised, and where."""
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = f" ({Path(last[0].filename).name}:{last[0].lineno})" if last else ""
    return f"{type(error).__name__}: {error}{where}"


def guarded(evaluate: Callable[[Point], Record], point: Point) -> Record:
    """Evaluate a point; whatever is raised becomes a row."""
    if point.problem:
        return failed(point, "IMPOSSIBLE", point.problem)
    try:
        record = evaluate(point)
        if isinstance(record, Record) and record.message != (message := brief(record.message)):
            record = replace(record, message=message)
        return record
    except MemoryError as error:
        return failed(point, "MEMORY", reason(error))
    except BaseException as error:
        return failed(point, "ERROR", reason(error))


def numbered(record: Record, objectives: Sequence[str]) -> Record:
    """The record, not trusted any more where it has the study's objectives and none of them is a number."""
    stems = [split_name(name)[0] for name in objectives]
    values = [record.metrics[name] for name in stems if name in record.metrics]
    if record.status == "OK" and values and all(value != value for value in values):
        return replace(record, status="ERROR", message=f"no number came out: {', '.join(stems)} are NaN")
    return record


def work(parent: int, pipe: Connection) -> int:
    """Everything a child does, for the process ``parent``; returns its exit code."""
    die_with_parent(parent)
    keep_memory()
    faulthandler.enable()
    try:
        evaluator, *warm_ups = pipe.recv()
        evaluate = locate(evaluator)
        pipe.send(("imported", ""))
        study, limit = pipe.recv()
        for warm_up in warm_ups:
            locate(warm_up)()
    except EOFError:
        return 0
    except BaseException as error:
        pipe.send(("broken", reason(error)))
        return 1
    if limit is not None:
        if (usage := memory(os.getpid())) is not None and usage[0] > limit:
            why = f"the memory limit of {limit:g} MB is less than the {usage[0]:.0f} MB that it takes without a point"
            pipe.send(("broken", why))
            return 1
        limit_memory(limit)
    pipe.send(("ready", ""))
    while True:
        try:
            point = pipe.recv()
            if isinstance(point, Order):
                point = made(study, point)
        except EOFError:
            return 0
        except ConfigError as error:
            pipe.send(("broken", str(error)))
            return 2
        record = guarded(evaluate, point)
        if study is not None and isinstance(record, Record):
            record = numbered(record, study.objectives)
        pipe.send(("record", record))


if __name__ == "__main__":
    sys.exit(work(int(sys.argv[1]), Connection(int(sys.argv[2]))))
