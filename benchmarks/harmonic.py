"""Seconds of one core: harmonic balance beside the time domain, MoorDyn and dense solvers, on one hung line.

    python benchmarks/harmonic.py [--quick] [--only 1,2,3,4,5,6] [--repeats 3] [--limit 90]

The line of configs/scenes/oc3_hung.yaml, 50 segments (51 nodes), surge 5 m at 15 s, with both axial stiffnesses: the
right one and the one misprinted in the papers. Prints Markdown tables:

1. one point by ten harmonics, with its estimated and its true error;
2. a frequency-amplitude sweep of 200 points, from rest and warm;
3. the project's time domain, run until it has settled to the same error;
4. MoorDyn, likewise (needs the `bench` extra);
5. harmonic balance without analytic blocks: finite differences and a dense LU, scipy.optimize.root, mousai;
6. the cost of one Newton step by the number of nodes.

Errors are those of the last period against 40 harmonics on the same mesh: the largest difference over time of the end
force, relative to its range, and of a position, relative to the largest range of one. Seconds are processor time, the
least of several repeats. What is timed is the method alone, on a line already built and at rest, unless a row says
otherwise. The motion is a sine: it differs from the scene's by a quarter of a period. Packages that are missing are
skipped with a sentence.
"""

# ruff: noqa: E402 (threads are set before numpy is imported)

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import contextlib
import functools
import itertools
import math
import platform
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from scipy.linalg import lu_factor, lu_solve
from scipy.optimize import root

from solvers import Ask, Scene, Status, catalogue, settled, solve
from solvers.dispatch import call_accelerate, call_drive
from solvers.methods import floquet, harmonic
from solvers.methods.harmonic import Balance, Orbit, from_rest, periodic, reach_of, sample_tangent, series
from solvers.motion import motion_pack
from sweep.config import load_scene
from sweep.peers import quiet

CONFIG = Path(__file__).parents[1] / "configs" / "oc3_hung.yaml"
RIGHT, MISPRINTED = 3.84243e8, 3.84243e7  # EA [N]
SEGMENTS, HARMONICS, TOLERANCE, MANY = 50, 10, catalogue.METHODS["harmonic"].tolerance, 40
AMPLITUDE, PERIOD = 5.0, 15.0
AMPLITUDES, PERIODS = np.linspace(0.5, 5.0, 10), np.linspace(8.0, 27.0, 20)
SAMPLED = tuple(itertools.product((1.0, 2.5, 4.0), (10.0, 14.0, 19.0, 25.0)))  # of the sweep: (amplitude, period)
SHOWN = 128  # times of a period that are compared
RAMPS = (0.5, 1.0, 2.0)  # of the time domain [periods]
LONGEST = 12  # periods simulated at most
TOLERANCES = {"dopri5": (1e-2, 1e-3, 1e-4, 1e-5), "trbdf2": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)}


# --------------------------------------------------------------------------- the line


class Line(NamedTuple):
    """The line, built and at rest."""

    model: Any
    rest: np.ndarray

    def at(self, amplitude: float, period: float) -> tuple[Any, float]:
        """Its pack with another motion, and the angular frequency."""
        moved = settled.steady(scene_at(self.model.scene, amplitude, period))
        ends = [end for end in (moved.end_a, moved.end_b) if end.kind != "free"]
        return self.model.pack._replace(motion=motion_pack(ends, self.model.basis)), 2 * math.pi / period


def scene_at(scene: Scene, amplitude: float, period: float, ramp: float | None = None) -> Scene:
    """The scene with another surge, ramped over so many seconds."""
    motion: Any = scene.end_b.motion
    surge = replace(motion.harmonics[0], amplitude=(amplitude, 0.0, 0.0), frequency=1 / period, phase=0.0)
    window = motion.window if ramp is None else replace(motion.window, ramp_up=ramp)
    return replace(scene, end_b=replace(scene.end_b, motion=replace(motion, harmonics=(surge,), window=window)))


@functools.cache
def scene_of(EA: float) -> Scene:
    scene = load_scene(CONFIG)
    return replace(scene, cable=(replace(scene.cable[0], EA=EA),))


@functools.cache
def line_of(EA: float, segments: int = SEGMENTS) -> Line:
    model = catalogue.MODELS["lumped"].build(scene_at(scene_of(EA), AMPLITUDE, PERIOD), segments)
    status, rest, note = catalogue.static_state(model)
    if status != Status.OK:
        sys.exit(f"no static state: {note}")
    return Line(model, rest)


class Waves(NamedTuple):
    """Settled period: end force (nt,) and node positions (nt, n_node, dim)."""

    force: np.ndarray
    position: np.ndarray


def waves(line: Line, pack: Any, orbit: Orbit) -> Waves:
    q, v, force = settled.states(pack, orbit, 2 * math.pi * np.arange(SHOWN) / SHOWN)
    signals = line.model.observe(q, v, force, line.rest)
    return Waves(np.linalg.norm(signals["end_force"][:, 1], axis=1), signals["position"])


class Errors(NamedTuple):
    force: float
    position: float

    def within(self, other: Errors) -> bool:
        return self.force <= other.force and self.position <= other.position

    def __str__(self) -> str:
        return f"{self.force:.1e} | {self.position:.1e}"


def errors(found: Waves, truth: Waves) -> Errors:
    force = np.abs(found.force - truth.force).max() / np.ptp(truth.force)
    position = np.abs(found.position - truth.position).max() / np.ptp(truth.position, axis=0).max()
    return Errors(float(force), float(position))


@functools.cache
def truth_of(EA: float, amplitude: float = AMPLITUDE, period: float = PERIOD) -> tuple[Orbit, Waves]:
    """The response with 40 harmonics."""
    line = line_of(EA)
    pack, omega = line.at(amplitude, period)
    orbit = periodic(pack, omega, line.rest, TOLERANCE, MANY)
    return orbit, waves(line, pack, orbit)


@functools.cache
def ten_of(EA: float, amplitude: float, period: float) -> tuple[Orbit, Errors]:
    """The response with ten harmonics, and its true error."""
    line = line_of(EA)
    pack, omega = line.at(amplitude, period)
    orbit = periodic(pack, omega, line.rest, TOLERANCE, HARMONICS)
    return orbit, errors(waves(line, pack, orbit), truth_of(EA, amplitude, period)[1])


# --------------------------------------------------------------------------- time


def least(job: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Least processor seconds of some runs, and what the last gave."""
    best, found = math.inf, None
    for _ in range(repeats):
        begun = time.process_time()
        found = job()
        best = min(best, time.process_time() - begun)
    return best, found


def head(*columns: str) -> None:
    print("| " + " | ".join(columns) + " |")
    print("|---" * len(columns) + "|")


def row(*cells: Any) -> None:
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


# --------------------------------------------------------------------------- 1. one point


def one_point(options: argparse.Namespace) -> None:
    print(f"One point, {AMPLITUDE:g} m at {PERIOD:g} s.\n")
    head(
        "EA, N", "harmonics", "start", "ms", "with Floquet, ms", "multiplier", "iterations", "Jacobians",
        "estimated error", "error of end force", "error of positions",
    )  # fmt: skip
    for EA in (RIGHT, MISPRINTED):
        line, truth = line_of(EA), truth_of(EA)
        pack, omega = line.at(AMPLITUDE, PERIOD)
        below, _ = line.at(0.9 * AMPLITUDE, PERIOD)
        neighbour = periodic(below, omega, line.rest, TOLERANCE, HARMONICS)
        for count, start in ((HARMONICS, None), (HARMONICS, neighbour), (None, None)):
            job = functools.partial(periodic, pack, omega, line.rest, TOLERANCE, count, start)
            seconds, orbit = least(job, options.repeats)
            check, known = least(functools.partial(floquet.stability, pack, orbit), options.repeats)
            row(
                f"{EA:.5g}", orbit.harmonics if count else f"{orbit.harmonics}, chosen", "4.5 m" if start else "rest",
                ms(seconds), ms(seconds + check), f"{known.largest:.2g}", orbit.work.iterations,
                orbit.work.factorisations, f"{orbit.tail:.1e}", errors(waves(line, pack, orbit), truth[1]),
            )  # fmt: skip
    a, b = (truth_of(EA)[0].tail for EA in (RIGHT, MISPRINTED))
    print(f"\nThe reference, {MANY} harmonics, has estimated errors of {a:.1e} and {b:.1e}.\n")


# --------------------------------------------------------------------------- 2. the sweep


class Sweep(NamedTuple):
    orbits: dict[tuple[int, int], Orbit]  # by amplitude and period
    seconds: dict[tuple[int, int], float]

    @property
    def total(self) -> float:
        return sum(self.seconds.values())

    def mean(self, grid: list[np.ndarray]) -> float:
        """Seconds of a point among those of the sample that lie on the grid."""
        places = {(a, p): (i, j) for i, a in enumerate(grid[0]) for j, p in enumerate(grid[1])}
        return float(np.mean([self.seconds[places[point]] for point in SAMPLED if point in places]))


def least_sweep(job: Callable[[], Sweep], repeats: int) -> Sweep:
    """The least seconds of each point over some sweeps."""
    runs = [job() for _ in range(repeats)]
    return Sweep(runs[0].orbits, {k: min(run.seconds[k] for run in runs) for k in runs[0].seconds})


def swept_from_rest(line: Line, grid: list[np.ndarray], count: int | None) -> Sweep:
    sweep = Sweep({}, {})
    for (i, amplitude), (j, period) in itertools.product(enumerate(grid[0]), enumerate(grid[1])):
        begun = time.process_time()
        sweep.orbits[i, j] = periodic(*line.at(amplitude, period), line.rest, TOLERANCE, count)
        sweep.seconds[i, j] = time.process_time() - begun
    return sweep


def swept_warm(line: Line, grid: list[np.ndarray], count: int | None, order: int) -> Sweep:
    """Each from its neighbour: up the amplitudes, a period on, down again.

    The start is extrapolated from up to `order + 1` responses along the amplitude; where the period before shows what
    that extrapolation lacks, it is added. Order 0 starts from the neighbour as it is.
    """
    sweep, last = Sweep({}, {}), None
    found = sweep.orbits
    for j, period in enumerate(grid[1]):
        around = range(len(grid[0]))
        for i in around if j % 2 == 0 else reversed(around):
            begun, start = time.process_time(), None
            if last is not None:
                start = replace(last, X=predicted(found, grid[0], i, j, order) if order else last.X)
            orbit = periodic(*line.at(grid[0][i], period), line.rest, TOLERANCE, count, start)
            found[i, j], last = orbit, orbit if solved(orbit) else None
            sweep.seconds[i, j] = time.process_time() - begun
    return sweep


def solved(orbit: Orbit) -> bool:
    return orbit.status in (Status.OK, Status.FEW_HARMONICS)


def predicted(found: dict[tuple[int, int], Orbit], amplitudes: np.ndarray, i: int, j: int, order: int) -> np.ndarray:
    """A start for the response at amplitude i and period j from those found before."""
    side = -1 if j % 2 == 0 else 1
    known = [k for k in range(i + side, i + side * (order + 2), side) if (k, j) in found]

    def at(k: int, j: int) -> np.ndarray:
        return harmonic.padded(found[k, j].X, most)

    def along(j: int) -> np.ndarray:
        shares = (math.prod((amplitudes[i] - amplitudes[m]) / (amplitudes[k] - amplitudes[m]) for m in known if m != k)
                  for k in known)  # fmt: skip
        return sum((share * at(k, j) for share, k in zip(shares, known, strict=True)), start=np.zeros(()))

    most = max(orbit.harmonics for orbit in found.values())
    if not known:  # the first of a period
        return 2 * at(i, j - 1) - at(i, j - 2) if j > 1 and order > 0 else at(i, j - 1)
    lack = at(i, j - 1) - along(j - 1) if j > 0 else 0.0
    before = at(i, j - 2) - along(j - 2) if j > 1 and order > 1 else lack
    return along(j) + 2 * lack - before


def grid_of(options: argparse.Namespace) -> list[np.ndarray]:
    return [AMPLITUDES[1::3], PERIODS[2::4]] if options.quick else [AMPLITUDES, PERIODS]


def sweeps(options: argparse.Namespace) -> None:
    grid = grid_of(options)
    points = len(grid[0]) * len(grid[1])
    print(
        f"Sweep of {points} points: {len(grid[0])} amplitudes from {grid[0][0]:g} to {grid[0][-1]:g} m, "
        f"{len(grid[1])} periods from {grid[1][0]:g} to {grid[1][-1]:g} s.\n"
    )
    head(
        "EA, N", "harmonics", "start", "s", "of it in points that failed, s", "ms of a median point",
        "Jacobians of a median point", "converged", f"estimated error below {TOLERANCE:g}", "median", "largest",
    )  # fmt: skip
    for EA in (RIGHT, MISPRINTED):
        line = line_of(EA)
        for count in (HARMONICS, None):
            ways: list[tuple[str, Callable[[], Sweep]]] = [
                ("rest", functools.partial(swept_from_rest, line, grid, count)),
                ("neighbour", functools.partial(swept_warm, line, grid, count, 0)),
                ("predicted", functools.partial(swept_warm, line, grid, count, 2)),
            ]
            for name, job in ways:
                sweep = least_sweep(job, min(2, options.repeats))
                good = [o for o in sweep.orbits.values() if solved(o)]
                tails = np.array([o.tail for o in good])
                failed = sum(sweep.seconds[k] for k, o in sweep.orbits.items() if not o.tail <= 0.01)
                row(
                    f"{EA:.5g}", count or f"{np.median([o.harmonics for o in good]):.0f} (median), chosen", name,
                    f"{sweep.total:.2f}", f"{failed:.2f}", ms(float(np.median(list(sweep.seconds.values())))),
                    f"{np.median([o.work.factorisations for o in good]):.0f}", f"{len(good)} of {points}",
                    (tails <= TOLERANCE).sum(), f"{np.median(tails):.1e}", f"{tails.max():.1e}",
                )  # fmt: skip
        if not options.quick:
            seconds, answers = least(functools.partial(asked, EA, grid), 1)
            ok = sum(r.status == Status.OK for r in answers)
            row(
                f"{EA:.5g}", "chosen", "`solve`, all of it", f"{seconds:.2f}", "", ms(seconds / points), "",
                f"{sum(bool(r.signals) for r in answers)} of {points}", f"status OK: {ok}", "", "",
            )  # fmt: skip
    print(
        "\n`solve`: as a study asks for it, with model, statics, Floquet multipliers and output; its ms are of a mean "
        "point. Failed: no convergence, or an estimated error above 0.01.\n"
    )


def asked(EA: float, grid: list[np.ndarray]) -> list[Any]:
    found = []
    for period in grid[1]:
        ask = Ask(duration=period, segments=SEGMENTS, method="harmonic", interval=period / SHOWN)
        for amplitude in grid[0]:
            found.append(solve(settled.steady(scene_at(scene_of(EA), amplitude, period)), ask))
    return found


# --------------------------------------------------------------------------- 3. our own time domain


class Run(NamedTuple):
    """A run of the time domain: waves of each period, seconds, and what it was."""

    waves: list[Waves]
    seconds: float
    trusted: bool
    name: str = ""
    periods: int = 0
    error: Errors = Errors(math.inf, math.inf)


def marched(
    EA: float, amplitude: float, period: float, method: str, tolerance: float, ramp: float, periods: int, last: bool
) -> Run:
    """The march alone, from rest; all periods or the last."""
    scene = scene_at(scene_of(EA), amplitude, period, ramp * period)
    model = catalogue.MODELS["lumped"].build(scene, SEGMENTS)
    rest = line_of(EA).rest
    model.settle(rest)
    ask = Ask(
        duration=periods * period, segments=SEGMENTS, method=method, tolerance=tolerance, interval=period / SHOWN,
        output_from=(periods - 1) * period if last else 0.0,
    )  # fmt: skip
    choice = catalogue.Choice("lumped", method, SEGMENTS, "", 0.0)
    common = {"model": "lumped", "method": method, "segments": SEGMENTS}
    begun = time.process_time()
    r = catalogue.march(model, ask, choice, rest, rest.copy(), np.zeros_like(rest), common)
    seconds = time.process_time() - begun
    found = []
    if len(r.t) > 1:
        force, x = np.linalg.norm(r.signals["end_force"][:, 1], axis=1), r.signals["position"]
        found = [Waves(force[k : k + SHOWN], x[k : k + SHOWN]) for k in range(0, len(r.t) - SHOWN, SHOWN)]
    return Run(found, seconds, r.trusted)


class Best(NamedTuple):
    """The cheapest run at all, and the cheapest whose energy ledger closes."""

    any: Run | None
    trusted: Run | None


def cheapest_march(EA: float, amplitude: float, period: float, goal: Errors, repeats: int) -> dict[str, Best]:
    """The cheapest settled run of each method that is as good as `goal`."""
    truth, best = truth_of(EA, amplitude, period)[1], {}
    for method, tolerances in TOLERANCES.items():
        runs: list[Run] = []
        for tolerance, ramp in itertools.product(tolerances, RAMPS):
            args = (EA, amplitude, period, method, tolerance, ramp)
            whole = march_errors(*args)
            good = [k + 1 for k, e in enumerate(whole) if k + 1 > ramp and e.within(goal)]
            if not good:
                continue
            trial = marched(*args, good[0], True)
            for _ in range(repeats - 1):
                again = marched(*args, good[0], True)
                trial = again if again.seconds < trial.seconds else trial
            name = f"{method} {tolerance:g} | {ramp:g}"
            runs.append(trial._replace(name=name, periods=good[0], error=errors(trial.waves[-1], truth)))
        runs.sort(key=lambda run: run.seconds)
        best[method] = Best(next(iter(runs), None), next((run for run in runs if run.trusted), None))
    return best


@functools.cache
def march_errors(
    EA: float, amplitude: float, period: float, method: str, tolerance: float, ramp: float
) -> list[Errors]:
    """Errors of each period of a long run."""
    truth = truth_of(EA, amplitude, period)[1]
    run = marched(EA, amplitude, period, method, tolerance, ramp, LONGEST, False)
    return [errors(w, truth) for w in run.waves]


def time_domain(options: argparse.Namespace) -> None:
    print(f"Our own time domain, settled to the error of ten harmonics; {AMPLITUDE:g} m at {PERIOD:g} s.\n")
    head(
        "EA, N", "method, tolerance", "ramp, periods", "periods", "energy ledger", "ms", "error of end force",
        "error of positions", "beside ten harmonics from rest", "beside a warm start",
    )  # fmt: skip
    for EA in (RIGHT, MISPRINTED):
        goal = ten_of(EA, AMPLITUDE, PERIOD)[1]
        rest, warm = rest_and_warm(EA, options)
        for found in cheapest_march(EA, AMPLITUDE, PERIOD, goal, options.repeats).values():
            for run in dict.fromkeys(r.name for r in found if r):
                r = next(r for r in found if r and r.name == run)
                row(
                    f"{EA:.5g}", r.name, r.periods, "closed" if r.trusted else "open", ms(r.seconds), r.error,
                    f"{r.seconds / rest:.1f}", f"{r.seconds / warm:.1f}",
                )  # fmt: skip
        r = marched(EA, AMPLITUDE, PERIOD, "dopri5", 1e-4, 2.0, 10, True)
        again = marched(EA, AMPLITUDE, PERIOD, "dopri5", 1e-4, 2.0, 10, True)
        seconds, error = min(r.seconds, again.seconds), errors(r.waves[-1], truth_of(EA)[1])
        row(
            f"{EA:.5g}", "as the config asks | 2", 10, "closed" if r.trusted else "open", ms(seconds), error,
            f"{seconds / rest:.1f}", f"{seconds / warm:.1f}",
        )  # fmt: skip
    print(
        "\nTwo rows of a method: the cheapest run at all, and the cheapest that the program itself would trust, as if "
        "tolerance, ramp and the time to settle were known. The config asks for 150 s by dopri5 at 1e-4.\n"
    )
    sampled(options)


def rest_and_warm(EA: float, options: argparse.Namespace) -> tuple[float, float]:
    """Seconds of one point by ten harmonics, from rest and from nine tenths of the amplitude."""
    line = line_of(EA)
    pack, omega = line.at(AMPLITUDE, PERIOD)
    below = periodic(*line.at(0.9 * AMPLITUDE, PERIOD), line.rest, TOLERANCE, HARMONICS)
    job = functools.partial(periodic, pack, omega, line.rest, TOLERANCE, HARMONICS)
    return least(job, options.repeats)[0], least(functools.partial(job, below), options.repeats)[0]


def sampled(options: argparse.Namespace) -> None:
    chosen = SAMPLED[::4] if options.quick else SAMPLED
    points = len(AMPLITUDES) * len(PERIODS)
    print(
        f"The sweep by the time domain: {len(chosen)} of the {points} points, times {points}. For each point the "
        "cheapest method, tolerance, ramp and number of periods, as if they were known.\n"
    )
    head(
        "EA, N", "goal", "s, cheapest", "s, cheapest with closed ledger", "points that reach it", "with closed ledger",
        "beside ten harmonics from rest", "beside the warm sweep", "with closed ledger",
    )  # fmt: skip
    for EA in (RIGHT, MISPRINTED):
        cold, warm = hot_and_cold(EA, options, points)
        for name, floor in (("the error of ten harmonics", 0.0), (f"that, or {TOLERANCE:g} where it is less", 1.0)):
            spent: list[list[float]] = [[], []]
            for amplitude, period in chosen:
                ten = ten_of(EA, amplitude, period)[1]
                goal = Errors(*(max(e, floor * TOLERANCE) for e in ten))
                best = cheapest_march(EA, amplitude, period, goal, 1 if options.quick else 2)
                for k in range(2):
                    costs = [found[k].seconds for found in best.values() if found[k]]  # type: ignore[union-attr]
                    if costs:
                        spent[k].append(min(costs))
            total = [points * float(np.mean(s)) if s else math.nan for s in spent]
            row(
                f"{EA:.5g}", name, f"{total[0]:.1f}", f"{total[1]:.1f}", f"{len(spent[0])} of {len(chosen)}",
                f"{len(spent[1])} of {len(chosen)}", f"{total[0] / cold:.1f}", f"{total[0] / warm:.1f}",
                f"{total[1] / warm:.1f}",
            )  # fmt: skip
    print("\nTen harmonics: seconds of the same points within the sweeps from rest and warm, scaled alike.\n")


def hot_and_cold(EA: float, options: argparse.Namespace, points: int) -> tuple[float, float]:
    """Seconds of so many points like the sampled ones by ten harmonics: from rest, and in a warm sweep."""
    line, grid = line_of(EA), grid_of(options)
    grid = [grid[0], grid[1][grid[1] >= SAMPLED[0][1]]]
    jobs = functools.partial(swept_from_rest, line, grid, HARMONICS), functools.partial(swept_warm, line, grid, 10, 2)
    cold, warm = (points * least_sweep(job, options.repeats).mean(grid) for job in jobs)
    return cold, warm


# --------------------------------------------------------------------------- 4. MoorDyn


def moordyn_deck(scene: Scene, step: float) -> str:
    cable = scene.cable[0]
    a: Any = scene.end_a.position
    b: Any = scene.end_b.position
    text = [
        "a line hung between two points", "--- LINE TYPES ---", "names", "units",
        f"cable {cable.d} {cable.mass} {cable.EA} {cable.BA} 0 {cable.Cdn} {cable.Can} {cable.Cdt} {cable.Cat}",
        "--- POINTS ---", "names", "units",
        f"1 Fixed {a[0]} {a[1]} {a[2]} 0 0 0 0", f"2 Coupled {b[0]} {b[1]} {b[2]} 0 0 0 0",
        "--- LINES ---", "names", "units", f"1 cable 1 2 {cable.length} {SEGMENTS} -",
        "--- OPTIONS ---", "0 writeLog", f"{step * (1 + 1e-6):.9g} dtM", "1e4 CFL", "rk4 tScheme", f"{scene.g} g",
        f"{scene.density} rho", "1000 WtrDpth", "0 TmaxIC", "1 disableOutput", "1 disableOutTime",
        "--- need this line ---",
    ]  # fmt: skip
    return "\n".join(text) + "\n"


def moordyn_run(EA: float, amplitude: float, period: float, per: int, ramp: float, periods: int) -> Run:
    """RK4 with `per` steps in each shown interval; RuntimeError where it does not stay finite.

    MoorDyn holds the velocity of a moved end for a coupling step, which is its own step here, and is given the mean
    velocity of the step. It starts from its own catenary.
    """
    import moordyn

    scene = scene_of(EA)
    step = period / SHOWN / per
    t = np.arange(periods * SHOWN * per + 1) * step
    share = np.where(t < ramp * period, 0.5 * (1 - np.cos(math.pi * t / (ramp * period))), 1.0)
    home: Any = scene.end_b.position
    moved = home[0] + amplitude * share * np.sin(2 * math.pi * t / period)
    speed = np.diff(moved) / step
    x, v = list(home), [0.0, 0.0, 0.0]
    force, position = np.zeros(periods * SHOWN), np.zeros((periods * SHOWN, SEGMENTS + 1, 3))
    with tempfile.TemporaryDirectory() as folder, quiet():
        deck = Path(folder) / "deck.txt"
        deck.write_text(moordyn_deck(scene, step))
        system = moordyn.Create(str(deck))
        try:
            moordyn.Init_NoIC(system, x, v)
            line, at, seconds, f = moordyn.GetLine(system, 1), 0, 0.0, (0.0, 0.0, 0.0)
            for k in range(periods * SHOWN):
                force[k] = math.hypot(f[0], f[2])
                for i in range(SEGMENTS + 1):
                    position[k, i] = moordyn.GetLineNodePos(line, i)
                if not np.abs(position[k]).max() < 1e4:
                    raise RuntimeError("unstable")
                begun = time.process_time()
                for _ in range(per):
                    x[0], v[0] = moved[at], speed[at]
                    f = moordyn.Step(system, x, v, t[at], step)
                    at += 1
                seconds += time.process_time() - begun
        finally:
            moordyn.Close(system)
    found = [Waves(force[k : k + SHOWN], position[k : k + SHOWN]) for k in range(0, periods * SHOWN, SHOWN)]
    return Run(found, seconds, True)


def cheapest_moordyn(EA: float, amplitude: float, period: float, goal: float, repeats: int) -> Run | None:
    """Largest step that holds, and the ramp that settles first to the goal, which positions alone must meet."""
    truth, cable, best = truth_of(EA, amplitude, period)[1], scene_of(EA).cable[0], None
    fastest = 2 * SEGMENTS / cable.length * math.sqrt(EA / cable.mass)
    for ramp in RAMPS:
        for per in range(max(1, math.floor(period / SHOWN * fastest / 3.2)), 200):
            try:
                run = moordyn_run(EA, amplitude, period, per, ramp, LONGEST)
            except RuntimeError:
                continue
            found = [errors(w, truth) for w in run.waves]
            good = [k + 1 for k, e in enumerate(found) if k + 1 > ramp and e.position <= goal]
            if good and found[-1].position <= goal:
                break
        else:
            continue
        runs = [moordyn_run(EA, amplitude, period, per, ramp, good[0]) for _ in range(repeats)]
        run = min(runs, key=lambda run: run.seconds)
        name = f"{ramp:g} | {1e3 * period / SHOWN / per:.1f}"
        run = run._replace(name=name, periods=good[0], error=errors(run.waves[-1], truth))
        best = run if best is None or run.seconds < best.seconds else best
    return best


def beside_moordyn(options: argparse.Namespace) -> None:
    try:
        import moordyn  # noqa: F401
    except ImportError:
        print("MoorDyn is not installed (the `bench` extra): skipped.\n")
        return
    print(f"MoorDyn, RK4, settled to the error of ten harmonics; {AMPLITUDE:g} m at {PERIOD:g} s.\n")
    head(
        "EA, N", "ramp, periods", "step, ms", "periods", "ms", "error of end force", "error of positions",
        "beside ten harmonics from rest", "beside a warm start",
    )  # fmt: skip
    for EA in (RIGHT, MISPRINTED):
        goal = ten_of(EA, AMPLITUDE, PERIOD)[1].position
        rest, warm = rest_and_warm(EA, options)
        run = cheapest_moordyn(EA, AMPLITUDE, PERIOD, goal, options.repeats)
        if run is None:
            row(f"{EA:.5g}", "no step holds", *[""] * 7)
        else:
            times = f"{run.seconds / rest:.1f}", f"{run.seconds / warm:.1f}"
            row(f"{EA:.5g}", run.name, run.periods, ms(run.seconds), run.error, *times)
    chosen = SAMPLED[::4] if options.quick else SAMPLED
    points = len(AMPLITUDES) * len(PERIODS)
    print(f"\nThe sweep by MoorDyn: {len(chosen)} of the {points} points, times {points}.\n")
    head("EA, N", "s", "points that reach the error", "beside the sweep from rest", "beside the warm sweep")
    for EA in (RIGHT, MISPRINTED):
        spent = []
        for amplitude, period in chosen:
            goal = max(ten_of(EA, amplitude, period)[1].position, TOLERANCE)
            run = cheapest_moordyn(EA, amplitude, period, goal, 1)
            spent += [run.seconds] if run else []
        total = points * float(np.mean(spent)) if spent else math.nan
        cold, warm = hot_and_cold(EA, options, points)
        row(f"{EA:.5g}", f"{total:.1f}", f"{len(spent)} of {len(chosen)}", f"{total / cold:.1f}", f"{total / warm:.1f}")
    print(
        f"\nThe goal is that of positions alone (in the sweep {TOLERANCE:g} where ten harmonics are better): MoorDyn's "
        "end force lags by a part of a step.\n"
    )


# --------------------------------------------------------------------------- 5. without analytic blocks


class Dense(Balance):
    """The same balance with a full Jacobian by finite differences and a dense LU; Newton and the rest are ours."""

    def factor(self, X: np.ndarray) -> bool:
        self.work.factorisations += 1
        base, n = self.residual(X), X.size
        J, x = np.empty((n, n), order="F"), X.copy()
        flat = x.reshape(-1)
        for k in range(n):
            kept, d = flat[k], 1e-6 * max(1.0, abs(flat[k]))
            flat[k] += d
            J[:, k] = (self.residual(x) - base).reshape(-1) / d
            flat[k] = kept
        if self.brake:  # the same added damping
            order = np.repeat(np.arange(self.harmonics + 1), 2)[1:]
            for i in np.flatnonzero(~self.held):
                at, size = i * self.nh, self.brake * self.omega**2 * float(self.pack.weight[i])
                for h in range(1, self.harmonics + 1):
                    J[at + 2 * h - 1, at + 2 * h] += size * order[2 * h]
                    J[at + 2 * h, at + 2 * h - 1] -= size * order[2 * h]
        self.lu = lu_factor(J, overwrite_a=True, check_finite=False)
        return bool(np.isfinite(self.lu[0]).all())

    def solve(self, R: np.ndarray) -> np.ndarray:
        return lu_solve(self.lu, R.reshape(-1), check_finite=False).reshape(self.ndof, self.nh)


class Full(Balance):
    """The same balance with the analytic Jacobian in one dense LU: what the block structure gains."""

    def factor(self, X: np.ndarray) -> bool:
        self.linearise(X)
        self.work.factorisations += 1
        self.lu = lu_factor(self.blocks.sparse().toarray(order="F"), overwrite_a=True, check_finite=False)
        return bool(np.isfinite(self.lu[0]).all())

    solve = Dense.solve


class OutOfTime(Exception):
    """The processor seconds allowed are spent."""


def projected(line: Line, pack: Any, omega: float, count: int, limit: float) -> tuple[Callable[..., Any], np.ndarray]:
    """The projected residual as a function of a flat vector, scaled by the tension, and the state at rest."""
    balance = Balance(pack, omega, count, max(8 * count, 32), reach_of(pack, line.rest))
    start = np.zeros((balance.ndof, balance.nh))
    start[:, 0] = math.sqrt(2) * line.rest
    force = np.ones((balance.ndof, 1))
    free = ~balance.held
    force[free] = 1e-6
    begun = time.process_time()

    def f(x: np.ndarray) -> np.ndarray:
        if time.process_time() - begun > limit:
            raise OutOfTime
        return (force * balance.residual(x.reshape(start.shape))).reshape(-1)

    return f, start.reshape(-1)


def by_root(line: Line, method: str, limit: float) -> tuple[float, str, np.ndarray | None]:
    """scipy.optimize.root on the projected residual, from rest: seconds, what came of it, the solution."""
    pack, omega = line.at(AMPLITUDE, PERIOD)
    f, x = projected(line, pack, omega, HARMONICS, limit)
    begun = time.process_time()
    how: dict[str, Any] = {"tol": 1e-9} if method == "hybr" else {"tol": 1e-7, "options": {"maxiter": 10**6}}
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = root(f, x, method=method, **how)
    except OutOfTime:
        return time.process_time() - begun, "out of time", None
    except ValueError as wrong:
        return time.process_time() - begun, f"failed: {wrong}", None
    seconds, left = time.process_time() - begun, float(np.abs(f(found.x)).max())
    return seconds, "converged" if left < 1e-5 else f"stopped with {1e6 * left:.1e} N left", found.x


def by_mousai(line: Line, limit: float) -> tuple[float, str, np.ndarray | None]:
    """mousai.hb_time, collocation at 2 H + 1 times and Newton-Krylov, from rest."""
    import mousai

    pack, omega = line.at(AMPLITUDE, PERIOD)
    n, fixed = len(line.rest), pack.fixed
    held = np.zeros(n, dtype=bool)
    held[fixed] = True
    scratch = np.zeros((5, n))
    begun = time.process_time()

    def acceleration(x: np.ndarray, v: np.ndarray, params: dict[str, Any]) -> np.ndarray:
        if time.process_time() - begun > limit:
            raise OutOfTime
        q, u, a, r, _ = scratch
        t = float(params["cur_time"])
        call_drive(t, pack, q, u, a)
        q[~held], u[~held] = x, v
        call_accelerate(t, q, u, a, pack, r)
        return a[~held][:, None].copy()

    x = np.repeat(line.rest[~held][:, None], 2 * HARMONICS + 1, axis=1)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), contextlib.redirect_stdout(None):
            warnings.simplefilter("ignore")
            _, x, e, _, _ = mousai.hb_time(
                acceleration, x0=x, omega=omega, num_harmonics=HARMONICS, f_tol=1e-6, maxiter=200
            )
    except OutOfTime:
        return time.process_time() - begun, "out of time", None
    except Exception as wrong:
        name = type(wrong).__name__
        return time.process_time() - begun, f"no convergence ({name})", None
    left = float(np.abs(e).max())
    return time.process_time() - begun, "converged" if left < 1e-4 else f"stopped with {left:.1e} m/s^2 left", x


def without_blocks(options: argparse.Namespace) -> None:
    print(
        f"Ten harmonics from rest without analytic blocks; {AMPLITUDE:g} m at {PERIOD:g} s, EA = {RIGHT:.5g} N, "
        f"at most {options.limit:g} s each.\n"
    )
    head("how", "nodes", "unknowns", "result", "s", "beside ours", "end force differs from ours by")
    sizes = (2, 5, 10, 25) if options.quick else (2, 5, 10, 25, SEGMENTS)
    ways: list[tuple[str, Callable[[Line], Any]]] = [
        ("analytic Jacobian, dense LU", lambda line: by_class(line, Full)),
        ("finite differences, dense LU", lambda line: by_class(line, Dense)),
        ("scipy root, hybr", lambda line: by_root(line, "hybr", options.limit)),
        ("scipy root, krylov", lambda line: by_root(line, "krylov", options.limit)),
    ]
    try:
        import mousai  # noqa: F401

        ways.append(("mousai.hb_time", lambda line: by_mousai(line, options.limit)))
        note = ""
    except ImportError:
        note = "mousai is not installed: skipped.\n"
    for name, way in ways:
        for segments in sizes if "LU" not in name else sizes[-1:]:
            line = line_of(RIGHT, segments)
            pack, omega = line.at(AMPLITUDE, PERIOD)
            own, orbit = least(
                functools.partial(periodic, pack, omega, line.rest, TOLERANCE, HARMONICS), options.repeats
            )
            seconds, result, x = way(line)
            apart = "-"
            if x is not None and result == "converged":
                X = of_samples(line, pack, x, omega) if name.startswith("mousai") else x.reshape(orbit.X.shape)
                apart = f"{errors(waves(line, pack, replace(orbit, X=X)), waves(line, pack, orbit)).force:.1e}"
            times = f"{seconds / own:.0f}" if result == "converged" else "-"
            row(name, segments + 1, orbit.X.size, result, f"{seconds:.2f}", times, apart)
            if result != "converged":
                break
    print(f"\n{note}")


def by_class(line: Line, kind: type[Balance]) -> tuple[float, str, np.ndarray | None]:
    pack, omega = line.at(AMPLITUDE, PERIOD)
    balance = kind(pack, omega, HARMONICS, 8 * HARMONICS, reach_of(pack, line.rest))
    start = np.zeros((balance.ndof, balance.nh))
    start[:, 0] = math.sqrt(2) * line.rest
    begun = time.process_time()
    converged, X = from_rest(balance, start)
    note = "converged" if converged else "no convergence"
    return time.process_time() - begun, note, X


def of_samples(line: Line, pack: Any, x: np.ndarray, omega: float) -> np.ndarray:
    """Fourier coefficients of all dofs from the free dofs' samples."""
    at = series(HARMONICS, 2 * HARMONICS + 1)
    q = np.zeros((len(at.phase), len(line.rest)))
    held = np.zeros(len(line.rest), dtype=bool)
    held[pack.fixed] = True
    scratch = np.zeros((2, len(line.rest)))
    for k, phase in enumerate(at.phase):
        call_drive(phase / omega, pack, q[k], *scratch)
    q[:, ~held] = x.T
    return np.ascontiguousarray((at.project @ q).T)


# --------------------------------------------------------------------------- 6. one Newton step


def one_step(options: argparse.Namespace) -> None:
    print(f"One Newton step of ten harmonics, EA = {RIGHT:.5g} N, ms.\n")
    head(
        "nodes", "unknowns", "sampling K, C, M", "assembly of blocks", "LU", "solution", "residual", "all",
        "us a node", "dense LU",
    )  # fmt: skip
    sizes = (51, 102) if options.quick else (51, 102, 204, 408)
    for nodes in sizes:
        line = line_of(RIGHT, nodes - 1)
        pack, omega = line.at(AMPLITUDE, PERIOD)
        orbit = periodic(pack, omega, line.rest, TOLERANCE, HARMONICS)
        b, X, repeats = Balance(pack, omega, HARMONICS, 8 * HARMONICS, reach_of(pack, line.rest)), orbit.X, 20
        b.factor(X)
        states = b.states(X, b.few)
        sample = functools.partial(sample_tangent, b.few.phase, omega, *states, pack, *b.band)
        calls = sample, *(functools.partial(call, X) for call in (b.linearise, b.factor, b.solve, b.residual))
        sampling, linearise, both, solution, residual = (least(call, repeats)[0] for call in calls)
        full = ""
        if nodes <= 102 and not options.quick:
            b.linearise(X)
            A = b.blocks.sparse().toarray(order="F")
            full = ms(least(functools.partial(lu_factor, A, check_finite=False), 2)[0])
        whole = both + solution + residual
        row(
            nodes, X.size, ms(sampling), ms(linearise - sampling), ms(both - linearise), ms(solution), ms(residual),
            ms(whole), f"{1e6 * whole / nodes:.0f}", full,
        )  # fmt: skip
    print()


# --------------------------------------------------------------------------- all


TABLES = {
    1: one_point, 2: sweeps, 3: time_domain, 4: beside_moordyn, 5: without_blocks, 6: one_step,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer points and sizes")
    parser.add_argument("--only", default="", help="tables, for example 1,2")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--limit", type=float, default=90.0, help="of a solver without blocks [s]")
    options = parser.parse_args()
    only = [int(x) for x in options.only.split(",") if x] or list(TABLES)
    chip = next((x.split(":")[1].strip() for x in cpu_lines() if x.startswith("model name")), platform.processor())
    print(
        f"{chip}, {os.cpu_count()} cores, of which one is used: BLAS threads = {os.environ['OPENBLAS_NUM_THREADS']}; "
        f"numpy {np.__version__}, scipy {scipy.__version__}, Python {platform.python_version()}.\n"
    )
    for EA in (RIGHT, MISPRINTED):
        line = line_of(EA)
        for count in (3, HARMONICS, MANY):
            floquet.stability(line.at(1.0, PERIOD)[0], periodic(*line.at(1.0, PERIOD), line.rest, TOLERANCE, count))
        for method in TOLERANCES:  # loads the kernels
            marched(EA, 1.0, PERIOD, method, 1e-3, 0.5, 1, False)
    for number in only:
        TABLES[number](options)


def cpu_lines() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


if __name__ == "__main__":
    main()
