"""The supervised child: points come in over a socket, records go back. Started by ``distribute`` only.

A model that segfaults, loops for ever or is killed takes this process with it and nothing else. Messages
are length-prefixed pickles on a socket of their own, so that stray prints cannot corrupt them. The child ends
when its parent does: on Linux the kernel kills it, elsewhere it sees the closed socket at its next message.
"""

from __future__ import annotations

import ctypes
import faulthandler
import importlib
import importlib.util
import os
import signal
import sys
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from .point import Point, Record

PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """Ask the kernel to kill this process when its parent dies, whatever it is doing then."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL))
    if os.getppid() != parent:
        os._exit(0)


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


def failed(point: Point, status: str, message: str, seconds: float = 0.0) -> Record:
    """The row of a point that gave no result."""
    return Record(
        key=point.key,
        design=point.design,
        environment=point.environment,
        values=dict(point.values),
        status=status,
        message=message,
        seconds=seconds,
    )


def reason(error: BaseException) -> str:
    """One line: what was raised, and where."""
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = f" ({Path(last[0].filename).name}:{last[0].lineno})" if last else ""
    return f"{type(error).__name__}: {error}{where}"


def guarded(evaluate: Callable[[Point], Record], point: Point) -> Record:
    """Evaluate a point; whatever is raised becomes a row."""
    try:
        return evaluate(point)
    except BaseException as error:
        return failed(point, "ERROR", reason(error))


def main(argv: list[str]) -> int:
    parent, handle, evaluator, *warm_ups = argv
    die_with_parent(int(parent))
    faulthandler.enable()
    pipe = Connection(int(handle))
    try:
        evaluate = locate(evaluator)
        for warm_up in warm_ups:
            locate(warm_up)()
    except BaseException as error:
        pipe.send(("broken", reason(error)))
        return 1
    pipe.send(("ready", ""))
    while True:
        try:
            point = pipe.recv()
        except EOFError:
            return 0
        pipe.send(("record", guarded(evaluate, point)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
