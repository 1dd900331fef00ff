"""Rods, catenaries and hybrids of both: seconds of one core, errors, and the front of a snap.

    python benchmarks/rod.py [--only 1,2,3,4,5,6,7] [--repeats 5] [--out docs/figures]

Prints Markdown tables:

1. a step of the hybrid (a quarter of it rod) beside one of the pure rod, on the hanging wire of configs/suspension.yaml
   with its end A shaken gently, same mesh and step; and what the hybrid's static state is off by;
2. the pure rod's step beside one assembly of residual and tangent and one banded LU;
3. a step against the number of nodes for rod, hybrid and catenary: the wire hung from two pins;
4. the static error of a hybrid against its share of rod, and what the program says of it;
5. domains that follow the motion beside the pure rod, on configs/touchdown.yaml;
6. the overshoot behind the front of a snap, by method, spectral radius and Courant number;
7. the order in the step and in the element, on a rod moved and twisted smoothly in space.

Seconds are processor time but for those of table 5, which says which, compilation excluded, the least of several
repeats; what is compared takes turns, so that a busy machine slows both. Iterations are those of Newton's method; each
is one residual and one solution. A table whose scene is not there is skipped with a sentence. `--out` also draws
tables 4 and 6.
"""

# ruff: noqa: E402 (threads are set before numpy is imported)

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import math
import platform
import re
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy.linalg.lapack import dgbtrf

from solvers import (
    Ask,
    End,
    Harmonic,
    Motion,
    Response,
    Scene,
    Section,
    Status,
    Turn,
    Window,
    catalogue,
    solve,
)
from solvers.banded import hold
from solvers.dispatch import backsolve, factorise, residual, tangent
from solvers.lines.rod import RodModel
from sweep.config import load_scene

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "analytic"))
from elastica import suspension

SUSPENSION, TOUCHDOWN = ROOT / "configs" / "suspension.yaml", ROOT / "configs" / "touchdown.yaml"
LENGTH, JOINT = 2.0, 1.5  # of the hanging wire [m]
FREQUENCY, STEP, STEPS, RHO = 0.5, 0.005, 200, 0.8  # of its shaking [Hz], [s]
LINES: dict[str, tuple[tuple[float, float], ...]] = {
    "rod": ((0.0, LENGTH),), "hybrid": ((JOINT, LENGTH),), "catenary": (),
}  # fmt: skip


# --------------------------------------------------------------------------- output


def head(*columns: str) -> None:
    print("| " + " | ".join(columns) + " |")
    print("|---" * len(columns) + "|")


def row(*cells: Any) -> None:
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def percent(x: float) -> str:
    return f"{100 * x:.3g} %"


# --------------------------------------------------------------------------- the hanging wire


def shaken(end: End, amplitude: float) -> End:
    """The end moved along x and z, ramped over 1 s."""
    harmonic = Harmonic(amplitude=(amplitude, 0.0, amplitude), frequency=FREQUENCY)
    return replace(end, motion=Motion(harmonics=(harmonic,), window=Window(ramp_up=1.0, shape="smooth")))


def wire(amplitude: float) -> Scene:
    """The wire of the study, pinned at A and guided at B, its end A shaken."""
    scene = load_scene(SUSPENSION)
    return replace(scene, end_a=shaken(scene.end_a, amplitude))


def between_pins(amplitude: float) -> Scene:
    """The same wire hung from two pins 1.2 m apart, which a catenary can hold too."""
    scene = wire(amplitude)
    return replace(scene, end_b=End(kind="pinned", position=(1.2, 0.0, 0.0)))


class Steps(NamedTuple):
    """What a fixed step costs."""

    us: float
    iterations: float  # each
    tangents: float

    @property
    def work(self) -> str:
        return f"{self.iterations:.2f}, {self.tangents:.2f}"


def resting(model: RodModel) -> np.ndarray:
    status, q, note = catalogue.static_state(model)
    if status != Status.OK:
        sys.exit(f"no static state: {note}")
    return q


def side_by_side(models: dict[str, RodModel], steps: int, repeats: int) -> dict[str, Steps]:
    """Steps of generalised-alpha from rest; the models take turns."""
    rest = {name: resting(model) for name, model in models.items()}
    ask = Ask(model="rod", method="genalpha", step=STEP, rho=RHO, duration=steps * STEP)
    best: dict[str, Steps] = {}
    for _ in range(repeats):
        for name, model in models.items():
            limits = catalogue.limits_of(model, ask, "genalpha", model.fastest(rest[name]))
            pieces, grid = np.array([0.0, ask.duration]), np.array([0.0, ask.duration])
            begun = time.process_time()
            run = catalogue.marched(model, ask, "genalpha", limits, rest[name], np.zeros(model.ndof), pieces, grid)
            seconds = time.process_time() - begun
            if run.code != Status.OK:
                sys.exit(f"{name} stopped: {run.code.name}")
            count, _, evaluations, factors = run.out.counts
            found = Steps(1e6 * seconds / count, evaluations / count, factors / count)
            best[name] = min(best.get(name, found), found)
    return best


# --------------------------------------------------------------------------- static errors


def lowest(signals: dict[str, np.ndarray]) -> float:
    """Depth of the lowest point, from a parabola through three nodes [m]."""
    z = signals["position"][0, :, 2]
    i = int(z.argmin())
    second, first = (z[i + 1] - 2 * z[i] + z[i - 1]) / 2, (z[i + 1] - z[i - 1]) / 2
    return float(first**2 / (4 * second) - z[i])


class Wire(NamedTuple):
    """What is asked of the hanging wire at rest."""

    sag: float  # m
    sag_moment: float  # the largest that opens upwards [N m]
    end_moment: float  # at B [N m]
    moment: np.ndarray  # N m
    tension: np.ndarray  # N


def hanging(signals: dict[str, np.ndarray]) -> Wire:
    moment = -signals["moment"][0, :, 1]
    return Wire(lowest(signals), float(moment.max()), float(moment[-1]), moment, signals["tension"][0])


class Errors(NamedTuple):
    """Relative; of all tensions and of all moments, the largest error over the largest value."""

    sag: float
    sag_moment: float
    end_moment: float
    moment: float
    tension: float


def errors(found: Wire, truth: Wire) -> Errors:
    parts = (getattr(found, k) / getattr(truth, k) - 1 for k in ("sag", "sag_moment", "end_moment"))
    along = (
        np.abs(getattr(found, k) - getattr(truth, k)).max() / np.abs(getattr(truth, k)).max()
        for k in ("moment", "tension")
    )
    return Errors(*parts, *map(float, along))


def at_rest(segments: int, joint: float, accuracy: float = 0.01) -> Response:
    """The wire with its rod from `joint` on."""
    rods = ((joint, LENGTH),) if joint > 0 else None
    model = "hybrid" if joint > 0 else "rod"
    return solve(load_scene(SUSPENSION), Ask(model=model, rods=rods, segments=segments, accuracy=accuracy))


# --------------------------------------------------------------------------- 1. hybrid and rod


def hybrid_and_rod(options: argparse.Namespace) -> None:
    print(
        f"1. Hanging wire, end A shaken at {FREQUENCY:g} Hz, {STEPS} steps of {1e3 * STEP:g} ms, rho {RHO:g}: hybrid "
        f"with rod beyond {JOINT:g} m ({1 - JOINT / LENGTH:.0%}) beside the pure rod.\n"
    )
    head(
        "nodes", "amplitude, mm", "rod, us/step", "its iterations, tangents", "hybrid, us/step",
        "its iterations, tangents", "ratio", "ratio of residual + tangent + LU + solution",
        "error of sag", "of end moment", "of tension",
    )  # fmt: skip
    for segments, amplitude in ((100, 0.001), (100, 0.02), (160, 0.001), (200, 0.001), (400, 0.001)):
        off = errors(*(hanging(at_rest(segments, joint).signals) for joint in (JOINT, 0.0)))
        models = {k: RodModel(wire(amplitude), segments, LINES[k]) for k in ("rod", "hybrid")}
        found = side_by_side(models, STEPS, options.repeats)
        rod, hybrid = found["rod"], found["hybrid"]
        whole = {k: parts_of(model, options.repeats).all for k, model in models.items()}
        row(
            segments + 1, f"{1e3 * amplitude:g}", f"{rod.us:.0f}", rod.work, f"{hybrid.us:.0f}", hybrid.work,
            f"{rod.us / hybrid.us:.2f}", f"{whole['rod'] / whole['hybrid']:.2f}",
            percent(off.sag), percent(off.end_moment), percent(off.tension),
        )  # fmt: skip
    print()


# --------------------------------------------------------------------------- 2. one step


@njit
def _residuals(n, t, q, v, a, pack, r):
    for _ in range(n):
        residual(t, q, v, a, pack, r)


@njit
def _tangents(n, t, q, v, a, cq, cv, ca, pack, J):
    for _ in range(n):
        tangent(t, q, v, a, cq, cv, ca, pack, J)


@njit
def _copies(n, J0, J):
    for _ in range(n):
        J[:] = J0


@njit
def _factors(n, J0, pack, J):
    for _ in range(n):
        J[:] = J0
        factorise(pack, J)


@njit
def _solutions(n, pack, J, x):
    for _ in range(n):
        backsolve(pack, J, x)


class Parts(NamedTuple):
    """Microseconds of the parts of a Newton iteration."""

    residual: float
    tangent: float
    factors: float
    lapack: float  # the same matrix by dgbtrf
    solution: float

    @property
    def assembly_and_factors(self) -> float:
        return self.residual + self.tangent + self.factors

    @property
    def all(self) -> float:
        return self.assembly_and_factors + self.solution


def least_us(job: Callable[..., Any], count: int, repeats: int, *arguments: Any) -> float:
    job(1, *arguments)  # compiles
    best = math.inf
    for _ in range(repeats):
        begun = time.process_time()
        job(count, *arguments)
        best = min(best, time.process_time() - begun)
    return 1e6 * best / count


def parts_of(model: RodModel, repeats: int, count: int = 50) -> Parts:
    """Parts of an iteration near the static state, at the step's own coefficients."""
    q, pack, n = resting(model), model.pack, model.ndof
    v, a, r = np.zeros(n), np.zeros(n), np.zeros(n)
    af, am = 1 / (1 + RHO), 0.5 * (3 - RHO) / (1 + RHO)
    g = 0.5 + am - af
    c = af, am / (g * STEP), am * am / (af * g * g * STEP * STEP)
    J = np.zeros((n, 2 * pack.bw + 1))
    assembly = least_us(_residuals, count, repeats, 0.0, q, v, a, pack, r)
    tangents = least_us(_tangents, count, repeats, 0.0, q, v, a, *c, pack, J)
    hold(J, pack.bw, pack.fixed)
    first = J.copy()
    factors = least_us(_factors, count, repeats, first, pack, J) - least_us(_copies, count, repeats, first, J.copy())
    solution = least_us(_solutions, count, repeats, pack, J, np.zeros(n))
    index = np.arange(n)
    below, above = int((pack.low - index).max()), int((pack.high - index).max())
    band = np.zeros((2 * below + above + 1, n), order="F")
    for i, j in zip(*np.nonzero(first), strict=True):
        k = i + j - pack.bw
        band[below + above + i - k, k] = first[i, j]

    def lapack(count: int) -> None:
        for _ in range(count):
            dgbtrf(band, below, above)

    return Parts(assembly, tangents, factors, least_us(lapack, count, repeats), solution)


def one_step(options: argparse.Namespace) -> None:
    print(
        "2. The pure rod's step (table 1's, 1 mm) beside one residual, one tangent and one banded LU with row "
        "exchanges; LAPACK's dgbtrf of the same matrix, copy included, for comparison.\n"
    )
    head(
        "nodes", "unknowns", "residual, us", "tangent, us", "LU, us", "dgbtrf, us", "solution, us", "step, us",
        "iterations, tangents", "step / (residual + tangent + LU)",
    )  # fmt: skip
    for segments in (100, 400):
        model = RodModel(wire(0.001), segments, LINES["rod"])
        parts = parts_of(model, options.repeats)
        step = side_by_side({"rod": model}, STEPS, options.repeats)["rod"]
        again = parts_of(model, options.repeats)
        parts = Parts(*map(min, parts, again))
        row(
            segments + 1, model.ndof, *(f"{x:.0f}" for x in parts), f"{step.us:.0f}", step.work,
            f"{step.us / parts.assembly_and_factors:.2f}",
        )  # fmt: skip
    print()


# --------------------------------------------------------------------------- 3. nodes


def by_nodes(options: argparse.Namespace) -> None:
    print(f"3. The wire between two pins, end A shaken by 1 mm: a step of {1e3 * STEP:g} ms against the mesh.\n")
    columns = [f"{name}, {what}" for name in LINES for what in ("us/step", "us/node", "iterations, tangents")]
    head("nodes", *columns, "rod / hybrid", "rod / catenary")
    for segments in (100, 200, 400, 800, 1600):
        models = {name: RodModel(between_pins(0.001), segments, rods) for name, rods in LINES.items()}
        found = side_by_side(models, max(40, 20000 // segments), min(options.repeats, 3))
        cells = [(f"{x.us:.0f}", f"{x.us / (segments + 1):.2f}", x.work) for x in found.values()]
        ratios = (f"{found['rod'].us / found[name].us:.2f}" for name in ("hybrid", "catenary"))
        row(segments + 1, *(cell for three in cells for cell in three), *ratios)
    print()


# --------------------------------------------------------------------------- 4. error and share


JOINTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.4, 1.5, 1.6, 1.75, 1.9)  # m, nodes of the mesh
MESH, ACCURACY = 160, 0.01


def by_share(options: argparse.Namespace) -> None:
    rod = hanging(at_rest(MESH, 0.0).signals)
    exact = suspension()
    s = np.linspace(0, LENGTH, MESH + 1)
    tension = np.interp((s[1:] + s[:-1]) / 2, exact.s, exact.tension)
    moment = np.interp(s, exact.s, exact.moment)
    own = errors(rod, Wire(exact.lowest()[1], exact.moment.max(), exact.moment[-1], moment, tension))
    print(
        f"4. Hanging wire at rest, {MESH} elements, rod from the joint to end B: errors against the pure rod of the "
        f"same mesh, whose own against an elastica are {percent(own.sag)} of the sag, {percent(own.sag_moment)} and "
        f"{percent(own.end_moment)} of the moments, {percent(own.tension)} of the tension. Asked: {ACCURACY:.0%}. The "
        "estimate is the worst of shape, tension and moment, each over its largest.\n"
    )
    head(
        "joint, m", "share of rod", "sag", "largest moment of the sag", "end moment", "moment, of the largest",
        "tension, of the largest", "estimated", "status",
    )  # fmt: skip
    shares, found, said = [], [], []
    for joint in JOINTS:
        run = at_rest(MESH, joint, ACCURACY)
        if not run.signals:
            row(f"{joint:g}", *[""] * 7, f"{run.status.name}: {run.message}")
            continue
        off = errors(hanging(run.signals), rod)
        shares.append(float(run.signals["domain"].mean()))
        found.append(off)
        said.append(run.estimated_error)
        row(f"{joint:g}", f"{shares[-1]:.0%}", *map(percent, off), percent(said[-1]), run.status.name)
    alone = solve(load_scene(SUSPENSION), Ask(model="hybrid", segments=MESH, accuracy=ACCURACY))
    print(f"\nWith its domains left to the program: {alone.signals['domain'].mean():.0%} rod, {alone.status.name}.\n")
    if options.out:
        draw_errors(options.out, np.array(shares), np.abs(found), np.array(said))


# --------------------------------------------------------------------------- 5. domains that follow


def departure(signals: dict[str, np.ndarray]) -> float:
    """Largest distance of a node from the chord at rest, by component [m]."""
    x = signals["static_position"]
    return float(np.abs(x - (x[0] + (x[-1] - x[0]) * np.linspace(0, 1, len(x))[:, None])).max())


def following(options: argparse.Namespace) -> None:
    if not TOUCHDOWN.exists():
        print(f"5. Skipped: no configs/{TOUCHDOWN.name}.\n")
        return
    scene = load_scene(TOUCHDOWN)
    print(
        "5. Line from a clamp over the bed to a moving end (configs/touchdown.yaml), 400 elements, 40 s, accuracy 1 %: "
        "the hybrid's domains follow the motion. Errors over all times and nodes against the pure rod, over its "
        "largest tension, moment and departure from the chord. Wall-clock seconds of the call of solve and of its "
        "march.\n"
    )
    head(
        "method", "rod: solve, s", "rod: march, s", "hybrid: solve, s", "hybrid: march, s", "ratio of solve",
        "ratio of march", "ratio of solve in processor time", "mean share of rod", "changes", "error of tension",
        "of moment", "of shape", "estimated", "steps: rod, hybrid", "iterations", "tangents", "status: rod, hybrid",
    )  # fmt: skip
    for how in ({"method": "genalpha", "step": 0.01, "rho": RHO}, {"method": "trbdf2"}):
        ask = Ask(accuracy=ACCURACY, segments=400, duration=40.0, interval=0.1, **how)
        runs: dict[str, Response] = {}
        wall, march, processor = (dict.fromkeys(("rod", "hybrid"), math.inf) for _ in range(3))
        for model in wall:
            solve(scene, replace(ask, model=model, duration=0.5))  # loads the kernels
        for _ in range(min(options.repeats, 2)):
            for model in wall:
                begun, used = time.perf_counter(), time.process_time()
                runs[model] = solve(scene, replace(ask, model=model))
                wall[model] = min(wall[model], time.perf_counter() - begun)
                processor[model] = min(processor[model], time.process_time() - used)
                march[model] = min(march[model], runs[model].cost.seconds)
        rod, hybrid = runs["rod"], runs["hybrid"]
        a, b = rod.signals, hybrid.signals
        if len(rod.t) != len(hybrid.t):
            row(how["method"], f"{rod.status.name}: {rod.message}; {hybrid.status.name}: {hybrid.message}")
            continue
        tension, moment = (np.abs(b[k] - a[k]).max() / np.abs(a[k]).max() for k in ("tension", "moment"))
        shape = np.abs(b["position"] - a["position"]).max() / departure(a)
        changes = re.search(r"(\d+) changes", hybrid.reason)
        x, y = rod.cost, hybrid.cost
        row(
            how["method"] + (f", {how['step']:g} s" if "step" in how else ""),
            f"{wall['rod']:.2f}", f"{march['rod']:.2f}", f"{wall['hybrid']:.2f}", f"{march['hybrid']:.2f}",
            f"{wall['rod'] / wall['hybrid']:.2f}", f"{march['rod'] / march['hybrid']:.2f}",
            f"{processor['rod'] / processor['hybrid']:.2f}",
            f"{b['domain'].mean():.0%}", changes[1] if changes else "?", percent(tension), percent(moment),
            percent(shape), percent(hybrid.estimated_error), f"{x.steps}, {y.steps}",
            f"{x.evaluations}, {y.evaluations}", f"{x.factorisations}, {y.factorisations}",
            f"{rod.status.name}, {hybrid.status.name}",
        )  # fmt: skip
    print()


# --------------------------------------------------------------------------- 6. a snap


EA, MASS, SPAN, SPEED, TAUT = 1e6, 1.0, 100.0, 1.0, 0.005  # c = 1000 m/s, a plateau of 1000 N
ELEMENTS, UNTIL = 200, 0.095  # the echo starts at 0.1 s
COURANT, RADII = (0.5, 1.0, 2.0, 5.0), (1.0, 0.8, 0.5, 0.0)


def snap(model: str, **ask: Any) -> tuple[float, Response]:
    """An end of a taut line jumps to 1 m/s: the largest rise of tension over v sqrt(EA m), less 1."""
    slow = 1e-4  # Hz: over the run the harmonic's velocity is constant
    jump = Motion(harmonics=(Harmonic(amplitude=(SPEED / (2 * math.pi * slow), 0.0, 0.0), frequency=slow),))
    cable = Section(length=SPAN, d=0.01, mass=MASS, EA=EA, wet_weight=0.0, compression=True)
    far = End(kind="pinned", position=(SPAN * (1 + TAUT), 0.0, 0.0), motion=jump)
    scene = Scene(cable=(cable,), end_a=End(kind="pinned", position=(0.0, 0.0, 0.0)), end_b=far, g=0.0)
    run = solve(scene, Ask(model=model, segments=ELEMENTS, duration=UNTIL, interval=5e-4, **ask))
    if len(run.t) < round(UNTIL / 5e-4):
        return math.nan, run
    return float((run.signals["tension"].max() - EA * TAUT) / (SPEED * math.sqrt(EA * MASS)) - 1), run


def snaps(options: argparse.Namespace) -> None:
    l, c = SPAN / ELEMENTS, math.sqrt(EA / MASS)
    print(
        f"6. An end of a taut line of {ELEMENTS} elements jumps to {SPEED:g} m/s: overshoot of the tension behind the "
        "front, before its echo, by Courant number (step times wave speed over element).\n"
    )
    head("line", "method", "rho", *(f"Courant {x:g}" for x in COURANT))
    found: dict[tuple[str, float], list[float]] = {}
    for line, rho in ((line, rho) for line in ("catenary", "lumped") for rho in RADII):
        both = [snap(line, method="genalpha", step=x * l / c, rho=rho) for x in COURANT]
        found[line, rho] = [over for over, _ in both]
        row(line, "genalpha", f"{rho:g}", *(percent(over) if abs(over) < 10 else run.status.name for over, run in both))
    print()
    head("line", "method", "tolerance", "overshoot", "steps", "mean Courant number")
    free = {}
    for line, method, tolerance in (
        ("catenary", "trbdf2", 1e-3), ("catenary", "trbdf2", 1e-4), ("catenary", "trbdf2", 1e-5),
        ("lumped", "trbdf2", 1e-5), ("lumped", "dopri5", 1e-4), ("lumped", "dopri5", 1e-6),
    ):  # fmt: skip
        over, run = snap(line, method=method, tolerance=tolerance)
        courant = UNTIL / max(run.cost.steps, 1) * c / l
        free[line, method, tolerance] = courant, over
        row(line, method, f"{tolerance:.0e}", percent(over), run.cost.steps, f"{courant:.2f}")
    print()
    if options.out:
        draw_snaps(options.out, found, free)


# --------------------------------------------------------------------------- 7. orders


def twisted() -> Scene:
    """A clamped rod whose far clamp is moved in space and turned by 90 degrees, smoothly."""
    cable = Section(length=1.0, d=0.01, mass=0.2, EA=1e4, EI=0.05, wet_weight=0.5)
    sway = Motion(
        harmonics=(Harmonic(amplitude=(0.01, 0.03, 0.05), frequency=1.0),), window=Window(ramp_up=0.5, shape="smooth")
    )
    along, turn = (1.0, 0.0, 0.0), Turn(t=(0.0, 0.25, 0.5, 0.75, 1.0), angle=(0.0, 9.0, 45.0, 81.0, 90.0))
    near = End(kind="clamped", position=(0.0, 0.0, 0.0), direction=along)
    far = End(kind="clamped", position=(0.9, 0.0, 0.1), direction=along, motion=sway, twist=turn)
    return Scene(cable=(cable,), end_a=near, end_b=far)


def last(run: Response, stride: int = 1) -> list[np.ndarray]:
    """Position, velocity and moment of every `stride`-th node at the end, each over its largest."""
    parts = (run.signals[name][-1, ::stride] for name in ("position", "velocity", "moment"))
    return [part / np.abs(part).max() for part in parts]


def orders(options: argparse.Namespace) -> None:
    print(
        "7. A rod moved and twisted smoothly, after 0.5 s: root mean square errors over the largest value, and the "
        "order between the last two.\n"
    )
    head("refined", "against", "position", "velocity", "moment", "order of each")

    def run(segments: int, step: float) -> Response:
        ask = Ask(model="rod", method="genalpha", segments=segments, step=step, rho=RHO, duration=0.5, interval=0.05)
        return solve(twisted(), ask)

    steps, sizes = (4e-3, 2e-3, 1e-3), (20, 40, 80)
    truth, fine = last(run(12, 1.25e-4)), run(320, 4e-3)
    for name, against, pairs in (
        ("step 4, 2, 1 ms, 12 elements", "0.125 ms", [(last(run(12, h)), truth) for h in steps]),
        ("20, 40, 80 elements, 4 ms", "320", [(last(run(n, 4e-3)), last(fine, 320 // n)) for n in sizes]),
    ):
        off = np.array([[float(np.sqrt(((x - y) ** 2).mean())) for x, y in zip(*two, strict=True)] for two in pairs])
        order = np.log2(off[-2] / off[-1])
        row(name, against, *(", ".join(f"{x:.1e}" for x in k) for k in off.T), ", ".join(f"{x:.2f}" for x in order))
    print()


# --------------------------------------------------------------------------- figures

BLUE, RED, GREEN, YELLOW, PINK, BLACK = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#000000"


def draw_errors(folder: Path, shares: np.ndarray, found: np.ndarray, said: np.ndarray) -> None:
    """Errors of table 4 and the program's estimate against the share of rod."""
    import matplotlib
    from matplotlib.figure import Figure

    from sweep.labels import STYLE

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        ax = figure.subplots()
        names = (
            "sag",
            "largest moment of the sag",
            "moment at the guided end",
            "any moment, of the largest",
            "tension",
        )
        for name, values, colour, mark in zip(names, found.T, (BLUE, RED, GREEN, PINK, YELLOW), "osvD^", strict=True):
            ax.semilogy(100 * shares, 100 * values, color=colour, marker=mark, markersize=4, label=name)
        ax.semilogy(100 * shares, 100 * said, color=BLACK, linestyle="--", marker="x", label="estimated by the program")
        ax.axhline(100 * ACCURACY, color="0.6", linewidth=0.8)
        ax.text(0, 100 * ACCURACY, " asked", color="0.4", va="bottom", ha="left", fontsize=9)
        ax.set_xlim(0, 100)
        ax.set_xlabel("share of the wire that is a rod, at the guided end [%]")
        ax.set_ylabel("error against the rod from end to end [%]")
        ax.legend()
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(folder / "rod_error.png")


def draw_snaps(
    folder: Path, found: dict[tuple[str, float], list[float]], free: dict[tuple[str, str, float], Any]
) -> None:
    """Overshoots of table 6."""
    import matplotlib
    from matplotlib.figure import Figure

    from sweep.labels import STYLE

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 3.8), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        colours = dict(zip(RADII, (BLUE, GREEN, YELLOW, RED), strict=True))
        marks = dict(zip(RADII, "ov^s", strict=True))
        for ax, line in zip(axes, ("catenary", "lumped"), strict=True):
            for rho in RADII:
                over = 100 * np.array(found[line, rho])
                ax.semilogx(COURANT, over, color=colours[rho], marker=marks[rho], markersize=4, label=f"ρ = {rho:g}")
            for method, mark, colour in (("trbdf2", "*", PINK), ("dopri5", "D", BLACK)):
                at = [(x, 100 * y) for (a, b, _), (x, y) in free.items() if (a, b) == (line, method)]
                if at:
                    x, y = np.array(at).T
                    ax.semilogx(x, y, color=colour, marker=mark, linestyle="none", label=f"{method}, mean step")
            ax.set_title("catenary: box scheme in s" if line == "catenary" else "lumped masses")
            ax.set_xticks((0.02, 0.1, 0.5, 1, 2, 5), ["0.02", "0.1", "0.5", "1", "2", "5"])
            ax.set_xlim(0.015, 6.5)
            ax.minorticks_off()
            ax.set_xlabel("Courant number: step · wave speed / element [1]")
            ax.legend()
        axes[0].set_ylabel("overshoot of the tension behind the front [%]")
        axes[0].set_ylim(bottom=min(0.0, axes[0].get_ylim()[0]))
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(folder / "rod_snap.png")


# --------------------------------------------------------------------------- all


TABLES = {
    1: hybrid_and_rod, 2: one_step, 3: by_nodes, 4: by_share, 5: following, 6: snaps, 7: orders,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="tables, for example 1,2")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, help="folder of the figures rod_error.png and rod_snap.png")
    options = parser.parse_args()
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    chip = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), platform.processor())
    print(f"{chip}, one core; numpy {np.__version__}, Python {platform.python_version()}.\n")
    for number in [int(x) for x in options.only.split(",") if x] or list(TABLES):
        TABLES[number](options)


if __name__ == "__main__":
    main()
