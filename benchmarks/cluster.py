"""What a cluster costs: overhead of ranks, a dispatcher with 64 workers, scaling to 1024, memory of rank 0.

    python benchmarks/cluster.py overhead [--repeats 5]    2000 points that sleep 20 ms, on 2 ranks (needs mpirun)
    python benchmarks/cluster.py dispatch [--workers 64]   the real leader, workers simulated at 1 ms a point
    python benchmarks/cluster.py scaling [--out figures]   discrete events to 1024 workers, fed with measured times
    python benchmarks/cluster.py memory [--points 1000000] plan, replay of the journals, stream into results.nc
"""

from __future__ import annotations

import argparse
import heapq
import json
import os
import pickle
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sweep import distribute, store, supervise
from sweep.config import parse_study, parse_yaml
from sweep.distribute import Done, Interrupt, Job
from sweep.plan import Designs, Keys, Orders, Plan, make_plan, read_plan, write_plan
from sweep.point import Record

SPAN, LEAST = 60.0, 50  # of a simulated run: seconds, and points of a worker
ROOT = Path(__file__).resolve().parents[1]
TINY = ROOT / "tests" / "unit" / "tiny.yaml"
FAKES = str(ROOT / "tests" / "unit" / "fakes.py")


# --------------------------------------------------------------------------------------------- overhead


def overhead(points: int, seconds: float, ranks: int, repeats: int) -> None:
    """Wall time of the map (children started, rows in journals) over the ideal, and of the whole command."""
    ideal = points * seconds / ranks
    maps, wholes = [], []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "mpi4py", __file__, "rank", folder, str(points), str(seconds)]
            began = time.perf_counter()
            one = os.environ | {"OMP_NUM_THREADS": "1"}  # as the job scripts have it
            command = ["mpirun", "-n", str(ranks), *command]
            ended = subprocess.run(command, capture_output=True, text=True, check=True, env=one)
            wholes.append((time.perf_counter() - began) / ideal)
            found = json.loads(ended.stdout)
            maps.append(found["wall"] / ideal)
            assert found["rows"] == points
            print(f"map {maps[-1]:.3f} of the ideal {ideal:.0f} s, whole command {wholes[-1]:.3f}", flush=True)
    print(f"median of {repeats}: map {statistics.median(maps):.3f}, whole command {statistics.median(wholes):.3f}")


def rank(folder: str, points: int, seconds: float) -> int:
    """One rank of the benchmark; rank 0 prints what it measured."""
    supervise.fork_spare()
    ranks = distribute.world()
    if ranks.rank > 0:
        return distribute.serve(ranks)
    job = Job(directory=folder, header={"solver": "none"}, evaluator=f"{FAKES}:evaluate", warm_ups=(), time_limit=10.0)
    orders = [_sleep(i, seconds) for i in range(points)]
    began = time.perf_counter()
    distribute.map_points(orders, job, ranks)
    wall = time.perf_counter() - began
    rows = len(store.read_records(Path(folder)))
    distribute.dismiss(ranks, 0)
    print(json.dumps({"wall": wall, "rows": rows}))
    return 0


def _sleep(i: int, seconds: float) -> Any:
    sys.path.insert(0, str(Path(FAKES).parent))
    import fakes

    return fakes.make(i, "good", seconds)


# --------------------------------------------------------------------------------------------- dispatch


class Simulated:
    """A world whose workers are simulated: each answers by the wall clock as if it took ``seconds`` a point.

    Messages are pickled and unpickled as MPI would; ``spent`` is the time that the leader was given work.
    """

    rank, local, here, hung = 0, 0, 0, False

    def __init__(self, workers: int, seconds: float) -> None:
        self.size = workers + 1
        self.seconds = seconds
        self.due: list[tuple[float, int, int, bytes]] = []
        self.count = self.taken = 0
        self.free = dict.fromkeys(range(1, self.size), 0.0)  # when each will have done what it has
        self.worked = dict.fromkeys(range(1, self.size), 0.0)
        self.ended = 0.0

    def _say(self, at: float, rank: int, letter: Any) -> None:
        self.count += 1
        heapq.heappush(self.due, (at, self.count, rank, pickle.dumps(letter)))

    def send(self, to: int, message: Any) -> None:
        kind, content = pickle.loads(pickle.dumps(message))
        now = time.perf_counter()
        if kind == "go":
            self._say(now, to, ("ask", None))
        elif kind == "points" and content:
            begin = max(now, self.free[to])
            lasting = len(content) * self.seconds
            self.free[to], self.worked[to] = begin + lasting, self.worked[to] + lasting
            self.ended = max(self.ended, self.free[to])
            self._say(begin + 0.75 * lasting, to, ("ask", None))
            self._say(begin + lasting, to, ("done", [Done("OK", "", self.seconds, len(content))]))
        elif kind == "points":
            self._say(max(now, self.free[to]), to, ("bye", None))
        elif kind == "stop":
            self._say(now, to, ("bye", None))

    def receive(self) -> tuple[int, Any] | None:
        if not self.due or self.due[0][0] > time.perf_counter():
            return None
        self.taken += 1
        _, _, rank, letter = heapq.heappop(self.due)
        return rank, pickle.loads(letter)

    def finish(self) -> None:
        pass

    def abort(self, code: int) -> None:
        raise AssertionError


class _Idle:
    """In place of rank 0's own worker: it takes no part, so that what is measured is the handing out."""

    def __init__(self) -> None:
        self.child = self
        self.busy, self.ready, self.queue = False, True, deque[Any]()

    def start(self) -> None:
        pass

    def step(self, timeout: float) -> None:
        time.sleep(min(timeout, distribute.POLL))

    def close(self) -> None:
        pass


class _Dispatcher(distribute._Leader):
    """The leader without points of its own."""

    spent = 0.0  # on letters, without the looks that find none

    def feed(self) -> None:
        pass

    def listen(self) -> None:
        before, began = self.ranks.taken, time.process_time()
        super().listen()
        if self.ranks.taken > before:
            self.spent += time.process_time() - began


def dispatch(workers: int, seconds: float, span: float) -> dict[str, float]:
    """The real leader hands out a study's orders; how busy does it keep the workers, and what does that cost it?"""
    plan = _plan(int(workers * span / seconds), 4)
    world = Simulated(workers, seconds)

    orders = Orders.of(plan, np.arange(len(plan), dtype=np.int32))
    leader = _Dispatcher(orders, Job(), world, Interrupt(), lambda done: None, lambda: None)
    leader.worker = _Idle()  # type: ignore[assignment]
    began = time.perf_counter()
    leader.run()
    wall = world.ended - began
    busy = sum(world.worked.values()) / (workers * wall)
    return {"points": len(plan), "wall": wall, "busy": busy, "spent": leader.spent, "letters": world.count}


def _plan(points: int, variables: int) -> Plan:
    """A plan of made-up keys and designs."""
    rng = np.random.default_rng(1)
    study = parse_study(parse_yaml(TINY.read_text(), "tiny")[0])
    return replace(
        make_plan(study, 1),
        designs=Designs([f"v{j}" for j in range(variables)], rng.random((points, variables))),
        keys=Keys(rng.integers(0, 2**63, points, dtype=np.uint64)),
        costs=np.ones(points, dtype=np.float32),
    )


# --------------------------------------------------------------------------------------------- scaling


@dataclass(frozen=True)
class Measured:
    """Seconds that were measured: of points, of the leader for each order and letter, of a rank for each row."""

    points: np.ndarray
    order: float
    letter: float
    row: float
    travel: float


def measure(points: int = 24) -> Measured:
    """Run times of a study's designs in a child, the leader's costs with simulated workers, a rank's cost of a row."""
    study = parse_study(parse_yaml((ROOT / "configs" / "bnes_study.yaml").read_text(), "bnes")[0], ROOT / "configs")
    plan = make_plan(study, points)
    job = Job(study=study)
    taken: list[float] = []
    orders = Orders.of(plan, np.arange(points))
    distribute.map_points(orders, job, distribute.Alone(), lambda done: taken.append(done.seconds))
    few, many = (dispatch(16, seconds, 4.0) for seconds in (0.25, 0.002))  # letters for each order, orders for a letter
    a = np.array([[r["points"], r["letters"]] for r in (few, many)], dtype=float)
    order, letter = np.linalg.solve(a, [r["spent"] for r in (few, many)])
    with tempfile.TemporaryDirectory() as folder:
        part = store.DiskStore(Path(folder), "0")
        metrics = {f"m{i}": i / 7 for i in range(40)}
        record = Record(key="0" * 16, design=0, environment=0, values={}, status="OK", metrics=metrics)
        began = time.perf_counter()
        for _ in range(2000):
            part.append(record)
        row = (time.perf_counter() - began) / 2000
        part.close()
    return Measured(np.array(taken[1:]), max(order, 1e-7), max(letter, 1e-6), row, distribute.POLL)


def simulate(workers: int, times: np.ndarray, measured: Measured, rng: np.random.Generator) -> float:
    """Busy share of the workers, by discrete events: one leader, chunks and letters as the real one has them.

    A worker asks when a quarter of its chunk is left (points under a second) or when it has none; the leader takes
    letters one by one, each for its measured time; a letter travels and waits for the next look for POLL.
    """
    mean, done, work, leader = float(times.mean()), 0, 0.0, 0.0
    n = int(workers * max(SPAN / mean, LEAST))
    quick = mean < distribute.AHEAD
    free = np.zeros(workers)
    asks = [(0.0, w) for w in range(workers)]
    heapq.heapify(asks)
    while asks:
        at, w = heapq.heappop(asks)
        leader = max(leader, at + measured.travel)
        size = int(max(1, min(distribute.CHUNK_SECONDS / mean, distribute.CHUNK, (n - done) / (4 * (workers + 1)))))
        chunk = rng.choice(times, min(size, n - done))
        work += chunk.sum()
        chunk += measured.row
        # the ask, its answer, and what the worker tells of its rows each NEWS seconds
        tells = max(chunk.sum() / (distribute.NEWS * max(1.0, workers / 256)), 1.0 if len(chunk) else 0.0)
        leader += (2 + min(tells, len(chunk))) * measured.letter + len(chunk) * measured.order
        if not len(chunk):
            continue
        done += len(chunk)
        begin = max(free[w], leader + measured.travel)
        free[w] = begin + chunk.sum()
        heapq.heappush(asks, (begin + (chunk[: len(chunk) - len(chunk) // 4].sum() if quick else chunk.sum()), w))
    return float(work / (workers * free.max()))


def scaling(out: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    measured = measure()
    t = measured.points
    print(f"points of bnes_study: {t.mean():.3g} s ({t.min():.3g} to {t.max():.3g}), {len(t)} designs")
    print(f"leader: {1e6 * measured.order:.2f} us an order, {1e6 * measured.letter:.0f} us a letter")
    print(f"a rank: {1e6 * measured.row:.0f} us a row")
    counts = [1, 2, 4, 8, 16, 32, 64, 96, 192, 384, 768, 1024, 2048, 4096]
    figure, ax = plt.subplots(figsize=(6.4, 4))
    print("\n| mean time of a point | 96 workers | 1024 workers | knee: busy below 0.9 at |")
    print("|---|---|---|---|")
    for mean in (float(t.mean()), 0.1, 0.02, 0.005, 0.001):
        times = t * (mean / t.mean())
        busy = [simulate(n, times, measured, np.random.default_rng(3)) for n in counts]
        knee = next((n for n, b in zip(counts, busy, strict=True) if b < 0.9), None)
        label = f"{mean:.2g} s (the study)" if mean == t.mean() else f"{1e3 * mean:g} ms"
        at = dict(zip(counts, busy, strict=True))
        print(f"| {label} | {at[96]:.3f} | {at[1024]:.3f} | {knee or 'none up to 4096'} |")
        (line,) = ax.plot(counts, busy, marker="o", markersize=3, label=label)
        if knee and knee > 1:
            place = {"xytext": (-6, -13), "textcoords": "offset points"}
            ax.annotate(f"{knee}", (knee, at[knee]), color=line.get_color(), **place)
    ax.axhline(0.9, color="0.7", lw=0.8, zorder=0)
    ax.set(xscale="log", xlabel="workers", ylabel="busy share of the workers", ylim=(0.4, 1.05))
    ax.set_xticks([1, 8, 64, 96, 1024, 4096], ["1", "8", "64", "96", "1024", "4096"], minor=False)
    ax.minorticks_off()
    ax.legend(title="mean time of a point", frameon=False, loc="lower left")
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "scaling.png", dpi=130, bbox_inches="tight")
    print(f"\n{out / 'scaling.png'}; figures on the curves: workers from which on less than 0.9 of them are busy")


# --------------------------------------------------------------------------------------------- memory


def memory(points: int, variables: int) -> None:
    """Peak memory of rank 0 beyond that of a tiny study, for each point: plan, replay, orders, and the merge."""
    with tempfile.TemporaryDirectory() as folder:
        _write_folder(Path(folder), points, variables)
        size = sum(path.stat().st_size for path in Path(folder).rglob("*"))
        print(f"{points} points, {variables} variables, {size / 1e6:.0f} MB of plan and journals", flush=True)
        for what in ("run", "merge"):
            found = {}
            for n in (1000, points):
                with tempfile.TemporaryDirectory() as other:
                    place = Path(folder)
                    if n != points:
                        place = Path(other)
                        _write_folder(place, n, variables)
                    command = [sys.executable, __file__, "replay", what, str(place)]
                    found[n] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
            extra = found[points]["peak"] - found[1000]["peak"]
            base = found[1000]["peak"] / 1e6
            text = f"{what:6s} {extra / (points - 1000):.1f} bytes a point ({extra / 1e6:.0f} MB beyond {base:.0f})"
            print(f"{text}, {found[points]['seconds']:.0f} s", flush=True)


def _write_folder(folder: Path, points: int, variables: int) -> None:
    """A study's folder with a row for every point but each tenth, in four journals, written as runs write them."""
    raw = parse_yaml(TINY.read_text(), "tiny")[0]
    raw["sampler"]["n"] = points
    raw["variables"] = {f"v{j}": {"field": f"cable[0].{name}", "linear": [1.0, 2.0]} for j, name in enumerate(
        ("mass", "BA", "EI", "d", "EA")[:variables])}
    del raw["tied"]
    study = parse_study(raw)
    plan = replace(_plan(points, variables), text=study.text)
    (folder / "study.yaml").write_text(study.text)
    write_plan(plan, folder / "plan.json")
    (folder / "parts").mkdir()
    header = json.dumps({"header": {"solver": "none"}}) + "\n" + json.dumps(
        {"start": {"turn": 1, "host": "h", "job": "", "at": 0.0}}) + "\n"
    journals = [(folder / "parts" / f"journal-{k}.jsonl").open("wb") for k in range(4)]
    for journal in journals:
        journal.write(header.encode())
    metrics = {"delta": 0.5, "gamma": 0.25}
    for i in range(points):
        if i % 10:
            order = plan.order(i)
            row = Record(key=order.key, design=i, environment=0, values={}, status="OK", metrics=metrics)
            journals[i % 4].write(store.to_line(row, float(i)))
    for journal in journals:
        journal.close()


def replay(what: str, folder: Path) -> None:
    """In a process of its own: what rank 0 does with a folder; prints the peak of resident memory."""
    from sweep.run import to_do

    began = time.perf_counter()
    if what == "merge":
        store.merge(folder)
    else:
        plan = read_plan(folder / "plan.json")
        found = store.Replay(folder, plan.keys)
        left = to_do(plan.slice(0, 1), found)
        del found
        queue = distribute._Queue(Orders.of(plan, left[np.argsort(-plan.costs[left], kind="stable")]))
        handed = 0
        while len(queue):
            handed += len(queue.take(distribute.CHUNK))
        assert handed == len(left)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"peak": peak, "seconds": time.perf_counter() - began}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["overhead", "dispatch", "scaling", "memory", "rank", "replay"])
    parser.add_argument("words", nargs="*")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--workers", type=int, default=64)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--variables", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path("figures"))
    options = parser.parse_args()
    if options.what == "overhead":
        overhead(2000, 0.02, 2, options.repeats)
    elif options.what == "rank":
        sys.exit(rank(options.words[0], int(options.words[1]), float(options.words[2])))
    elif options.what == "dispatch":
        found = dispatch(options.workers, 0.001, 10.0)
        busy, pace, cost = 100 * found["busy"], found["points"] / found["wall"], 1e6 * found["spent"] / found["points"]
        print(f"{found['points']} points of 1 ms on {options.workers} simulated workers, busy {busy:.1f} % of the time")
        print(f"{pace:.0f} points/s; leader {cost:.2f} us of processor time a point, {found['letters']} letters")
    elif options.what == "scaling":
        scaling(options.out)
    elif options.what == "memory":
        memory(options.points, options.variables)
    else:
        replay(options.words[0], Path(options.words[1]))


if __name__ == "__main__":
    main()
