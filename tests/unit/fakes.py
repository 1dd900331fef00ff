"""Evaluators that misbehave on purpose, and a run of them: ``mpirun -n P python -m mpi4py fakes.py DIR POINTS``."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from sweep import distribute
from sweep.point import Point, Record

HERE = os.path.abspath(__file__)
MODES = ("good", "segfault", "exit", "loop", "raise", "print", "kill", "quit", "eat", "nan")


def make(number: int, mode: str = "good", seconds: float = 0.0) -> Point:
    nothing: Any = None
    values = {"x": number / 7, "mode": float(MODES.index(mode)), "seconds": seconds}
    return Point(
        key=f"{number:04d}",
        design=number,
        environment=0,
        values=values,
        scene=nothing,
        ask=nothing,
        settings=None,
    )


def evaluate(point: Point) -> Record:
    """Do what the point's mode says."""
    mode = MODES[int(point.values["mode"])]
    time.sleep(point.values["seconds"])
    if mode in ("segfault", "kill"):
        os.kill(os.getpid(), signal.SIGSEGV if mode == "segfault" else signal.SIGKILL)
    if mode == "exit":
        os._exit(3)
    if mode == "quit":
        sys.exit(4)
    if mode == "loop":
        while True:
            pass
    if mode == "raise":
        raise ValueError("on purpose")
    if mode == "print":
        print("stray text on stdout", flush=True)
        os.write(1, b"more of it\n")
    if mode == "eat":
        leap = bytearray(5_000_000_000)  # 5 GB that are not touched: the kernel's limit on data ends it here
        eaten = [leap, *(bytearray(b"x" * 50_000_000) for _ in range(100))]  # and touched, where nobody limits data
        return Record(key=point.key, design=0, environment=0, values={}, status="OK", message=str(len(eaten)))
    x = point.values["x"]
    if mode == "nan":
        x = float("nan")
    metrics = {"delta": x / 3, "gamma": float("inf") if x > 1 else x**0.5, "t_first": float("nan")}
    return Record(
        key=point.key, design=point.design, environment=0, values=point.values, status="OK", metrics=metrics
    )


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file of this process may grow beyond ``size`` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def evaluate_unlimited(point: Point) -> Record:
    """As ``evaluate``, in a process whose data segment nobody limits."""
    resource.setrlimit(resource.RLIMIT_DATA, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    return evaluate(point)


def planned(point: Point) -> Record:
    """As ``evaluate``, for points of a study: FAKE_MODES says what the designs do in turn, FAKE_SECONDS how long.

    FAKE_HOLD=N:PATH lets designs from the N-th on wait until there is a file of that name: tests need not be quick.
    With FAKE_FREE=1 a process begins with one that does not: each rank writes a row, whoever took the others.
    """
    first, _, gate = os.environ.get("FAKE_HOLD", "").partition(":")
    if os.environ.pop("FAKE_FREE", "") != "1":
        while gate and point.design >= int(first) and not os.path.exists(gate):
            time.sleep(0.02)
    modes = os.environ.get("FAKE_MODES", "good").split(",")
    values = {"x": point.design / 7, "mode": float(MODES.index(modes[point.design % len(modes)]))}
    values["seconds"] = float(os.environ.get("FAKE_SECONDS", "0"))
    found = evaluate(replace(point, values=values))
    return replace(found, environment=point.environment, values=point.values)


def costly(point: Point) -> Record:
    """As ``planned``, with a work that doubles from each design to the next but one."""
    return replace(planned(point), evaluations=100 * 2 ** (point.design // 2), segments=9, seconds=0.1)


def known_front(point: Point) -> Record:
    """Two objectives with a known front over ``x`` and ``y`` in [0, 1]: gamma = 1 - sqrt(delta) at y = 0 (as ZDT1).
    The stroke is x + y, 0.2 less in each further environment.

    FAKE_BAD: designs whose x is in the middle of so many parts of [0, 1] fail, are untrusted with objectives that would
    be on any front, or have NaN beside such an objective, in turn. FAKE_SECONDS as in ``planned``.
    """
    time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
    x, y = point.values["x"], point.values["y"]
    g = 1 + 9 * y
    metrics = {"delta": x, "rms": g * (1 - (x / g) ** 0.5), "stroke": x + y - 0.2 * point.environment}
    parts = int(os.environ.get("FAKE_BAD", "0"))
    status, place = "OK", x * parts % 1
    if parts and 0.25 < place < 0.5:
        status = ("DIVERGED", "UNRESOLVED", "OK")[int(x * parts) % 3]
        metrics = dict.fromkeys(metrics, float("nan") if status == "DIVERGED" else -9999.0)
        if status == "OK":
            metrics["delta"] = float("nan")
    return Record(
        key=point.key, design=point.design, environment=point.environment, values=point.values, status=status,
        metrics=metrics,
    )  # fmt: skip


def parts_costs(kind: str, count: float, mass: float) -> tuple[float, float]:
    """Objectives of a scene of parts: what is heavy is calm, what is little is cheap."""
    calm = {"bnes": 1.0, "tmd": 1.5, "locked": 3.0}[kind]
    return calm + 0.5 * (2 - count) + 1 / mass, {"bnes": 3.0, "tmd": 2.0, "locked": 1.0}[kind] * count + mass


def parts(point: Point) -> Record:
    """``parts_costs`` of the scene that the point really has."""
    devices = point.scene.devices
    delta, rms = parts_costs(devices[0].kind, len(devices), devices[0].mass)
    return Record(
        key=point.key, design=point.design, environment=point.environment, values=point.values, status="OK",
        metrics={"delta": delta, "rms": rms},
    )  # fmt: skip


def tell(point: Point) -> Record:
    """What the environment holds of launchers and threads."""
    found = [
        f"{name}={os.environ[name]}"
        for name in ("PMI_RANK", "SLURM_JOB_ID", "OMPI_COMM_WORLD_SIZE", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
        if name in os.environ
    ]
    return Record(key=point.key, design=0, environment=0, values={}, status="OK", message=" ".join(found))


def talk(point: Point) -> Record:
    raise ValueError("x" * 1_000_000)


def who(point: Point) -> Record:
    """The process that evaluates."""
    return Record(key=point.key, design=0, environment=0, values={}, status="OK", message=str(os.getpid()))


def die() -> None:
    """A warm-up that takes the process with it."""
    os._exit(5)


def main(directory: str, count: str, seconds: str = "0.01", *modes: str) -> int:
    ranks = distribute.world()
    if f"full-{ranks.rank}" in modes:  # this rank's disk fills up
        resource.setrlimit(resource.RLIMIT_FSIZE, (1500, resource.RLIM_INFINITY))
    modes = tuple(mode for mode in modes if mode in MODES)
    if ranks.rank > 0:
        return distribute.serve(ranks)
    points = [make(i, modes[i % len(modes)] if modes else "good", float(seconds)) for i in range(int(count))]
    job = distribute.Job(
        directory=directory,
        header={"solver": "fake"},
        evaluator=f"{HERE}:evaluate",
        warm_ups=(),
        time_limit=3.0,  # a busy machine may keep a good point waiting
    )
    code = 2
    try:
        done = job.store(0).rows()
        left = [point for point in points if point.key not in done]
        print(f"{len(left)} of {len(points)} to do on {ranks.size} ranks", flush=True)
        code = 3 if distribute.map_points(left, job, ranks) else 0
    except distribute.CannotRun as error:
        print(error, file=sys.stderr)
        code = 3 if error.resumable else 2
    finally:
        distribute.dismiss(ranks, code)
    return code


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
