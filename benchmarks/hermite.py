"""Error of the waveform against seconds of one core: Hermite elements, lumped segments, MoorDyn, CableDyn, in one run.

    python benchmarks/hermite.py [--repeats 2]

The bare cable of paper 003 between clamps (reference 25 of `tests/reference`), pulse (3.4), 2 s. The error is the rms
difference of the transverse displacement over 20 equal parts of the cable and all of the 2 s, every 2 ms, against our
own reference: 260 Hermite elements, checked against twice the mesh and against another method, which give its
uncertainty. Programs take turns and the least processor time of the repeats counts. What is timed: ours the whole call
of `solve`, from the scene to the response; MoorDyn, CableDyn their step calls alone. Needs the `bench` extra.

MoorDyn runs with the axial damping BA = l sqrt(EA m) of its own mesh, which is its cheapest: with the others' 1533 N s
it takes four times the steps on 160 segments. How far the reference moves with BA is printed.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from speed_moordyn import SAMPLE, STATIONS, Run, Stretch, cabledyn_run, error, moordyn_run, rk4_step

from solvers import Ask, End, Harmonic, Motion, Scene, Section, Status, Water, Window, solve

DURATION = 2.0
BA = 1533.0
TARGETS = (0.05, 0.01)
AIMS = {"MoorDyn": (10.0, 30.0), "CableDyn": (5.0, 10.0)}


def bare_cable(BA: float = BA) -> Scene:
    """Reference 25: 18.8 m with its top 5 m deep, pretension 500 N, (3.4) at the top."""
    length, EA = 18.8, 9e6
    cable = Section(length=length, d=0.076, mass=4.73, EA=EA, EI=11710.0, BA=BA, Cdt=0.008)
    pulse = Motion(
        harmonics=tuple(Harmonic(amplitude=(0.01, 0.0, 0.0), frequency=f) for f in (2.0, 4.0, 8.0)),
        window=Window(stop=0.5),
    )
    low, up = (0.0, 0.0, -5.0 - length * (1 + 500.0 / EA)), (0.0, 0.0, 1.0)
    return Scene(
        cable=(cable,), end_a=End(kind="clamped", position=low, direction=up), water=Water(),
        end_b=End(kind="clamped", position=(0.0, 0.0, -5.0), direction=up, motion=pulse),
    )  # fmt: skip


def ours(model: str, segments: int, scene: Scene | None = None, **ask: Any) -> Run:
    scene = scene or bare_cable()
    begun = time.process_time()
    r = solve(scene, Ask(duration=DURATION, segments=segments, interval=SAMPLE, model=model, **ask))
    cpu = time.process_time() - begun
    if len(r.t) != round(DURATION / SAMPLE) + 1:
        raise RuntimeError(f"{model} {segments} {ask}: {r.message}")
    x, arc = r.signals["position"][:, :, 0] - r.signals["static_position"][:, 0], r.signals["arc"]
    per = math.gcd(len(arc) - 1, STATIONS)
    if per != STATIONS:
        raise ValueError(f"{segments} segments do not meet the {STATIONS} stations")
    steps = max(r.cost.steps, 1)
    return Run(cpu, DURATION / steps, r.cost.evaluations, x, arc, r.energy_residual, r.status.name)


def moordyn_step(scene: Scene, segments: int, BA: float) -> float:
    """The step of `rk4_step`, or on fine meshes 80 % of the limit of bending, 2.828 l^2/4 sqrt((m + ma)/EI) [s]."""
    cable, size = scene.cable[0], scene.length / segments
    inertia = cable.mass + scene.density * math.pi / 4 * cable.d**2 * cable.Can
    bending = 0.8 * 2.828 * size**2 / 4 * math.sqrt(inertia / cable.EI)
    return min(rk4_step(scene, segments, BA), SAMPLE / math.ceil(SAMPLE / bending))


class Case(NamedTuple):
    """A run to be timed."""

    program: str
    name: str
    job: Callable[[], Run]


def cases(scene: Scene) -> Iterable[Case]:
    def own(model: str, n: int, method: str, **ask: Any) -> Case:
        what = ", ".join(f"{k} {x:g}" for k, x in ask.items())
        return Case(f"{model}, {method}", f"{n} | {what}", lambda: ours(model, n, method=method, **ask))

    for n in (15, 20, 25, 30, 40, 50, 60):
        for tolerance in (1e-3, 3e-4, 1e-4, 3e-5):
            yield own("hermite", n, "esdirk4", tolerance=tolerance)
    for n, tolerance in ((15, 1e-3), (20, 1e-3), (20, 3e-4), (20, 1e-4), (30, 1e-4), (40, 1e-4), (50, 1e-4)):
        yield own("hermite", n, "trbdf2", tolerance=tolerance)
    for n in (15, 20, 30):
        yield own("hermite", n, "dopri5", tolerance=1e-4)
    for n, step in ((20, 1e-3), (20, 5e-4), (30, 5e-4), (40, 2.5e-4), (50, 2e-4)):
        yield own("hermite", n, "genalpha", step=step, rho=1.0)
    for n in (80, 160):
        yield own("lumped", n, "dopri5", tolerance=1e-4)
    for n, tolerance in ((160, 3e-4), (320, 3e-4), (480, 1e-4)):
        yield own("lumped", n, "esdirk4", tolerance=tolerance)
    yield own("lumped", 160, "trbdf2", tolerance=1e-4)
    yield own("lumped", 320, "genalpha", step=2.5e-4, rho=1.0)
    cable = scene.cable[0]
    for n in (80, 160, 320, 480):
        critical = scene.length / n * math.sqrt(cable.EA * cable.mass)
        step = moordyn_step(scene, n, critical)
        parts = [Stretch(False, scene.length, n)]
        yield Case("MoorDyn", f"{n} | RK4, step {step:.3g}", lambda parts=parts, step=step, BA=critical: moordyn_run(
            scene, parts, DURATION, step, step, BA))  # fmt: skip
    for n, step in ((20, 2e-3), (40, 1e-3), (40, 5e-4), (60, 2.5e-4)):
        yield Case("CableDyn", f"{n} | step {step:g}", lambda n=n, step=step: cabledyn_run(scene, n, DURATION, step))


def reference() -> Run:
    """260 elements, and what else says how far it is right."""
    truth = ours("hermite", 260, method="esdirk4", tolerance=2e-5)
    print(f"Reference: 260 Hermite elements, esdirk4 at 2e-5, ledger {truth.residual:.1e}, {truth.cpu:.0f} s.\n")
    print("| against | difference | seconds |\n|---|---|---|")
    others = {
        "520 elements": lambda: ours("hermite", 520, method="esdirk4", tolerance=2e-5),
        "generalised-alpha, rho = 1, 12.5 us": lambda: ours("hermite", 260, method="genalpha", step=1.25e-5, rho=1.0),
        "BA of 320 segments, 383 N s, tolerance 1e-4": lambda: ours(
            "hermite", 260, bare_cable(383.0), method="esdirk4", tolerance=1e-4
        ),
    }
    worst = 0.0
    for name, job in others.items():
        run = job()
        if "BA" not in name:  # which is another scene
            worst = max(worst, error(run, truth))
        print(f"| {name} | {error(run, truth):.3%} | {run.cpu:.0f} |", flush=True)
    print(f"\nUncertainty of the reference: {worst:.2%}.\n")
    return truth


def cost_at(target: float, points: list[tuple[float, float]]) -> tuple[float, str]:
    """Seconds on the lower envelope of (error, seconds) at an error, between and beyond points by a power law."""
    front: list[tuple[float, float]] = []
    for e, s in sorted(points, key=lambda p: p[1]):
        if not front or e < front[-1][0]:
            front.append((e, s))
    x, y = np.log([e for e, _ in front])[::-1], np.log([s for _, s in front])[::-1]
    if len(front) == 1:
        return float("nan"), "one point"
    if math.log(target) < x[0]:
        slope = (y[1] - y[0]) / (x[1] - x[0])
        return math.exp(y[0] + slope * (math.log(target) - x[0])), "extrapolated"
    if math.log(target) > x[-1]:
        return math.exp(y[-1]), "its cheapest run, which is better"
    return math.exp(float(np.interp(math.log(target), x, y))), ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    scene = bare_cable()
    for model in ("hermite", "lumped"):  # load the kernels
        for method in ("esdirk4", "trbdf2", "dopri5", "genalpha"):
            step = {"step": 1e-4} if method == "genalpha" else {}
            solve(scene, Ask(duration=0.01, segments=20, model=model, method=method, **step))
    truth = reference()
    best: dict[tuple[str, str], Run] = {}
    for _ in range(options.repeats):
        for case in cases(scene):
            key = case.program, case.name
            try:
                run = case.job()
            except RuntimeError as failure:
                print(f"{case.program}, {case.name}: {failure}\n", flush=True)
                continue
            if key not in best or run.cpu < best[key].cpu:
                best[key] = run
    print("| program | segments | settings | error | CPU s | energy residual | status |\n|---|---|---|---|---|---|---|")
    for (program, name), run in best.items():
        closed = "-" if math.isnan(run.residual) else f"{run.residual:.1e}"
        print(f"| {program} | {name} | {error(run, truth):.2%} | {run.cpu:.3f} | {closed} | {run.status or '-'} |")
    envelope(best, truth)


def envelope(best: dict[tuple[str, str], Run], truth: Run) -> None:
    """Seconds at equal error, and ratios to the Hermite line's."""
    points: dict[str, list[tuple[float, float]]] = {}
    for (program, _), run in best.items():
        at = error(run, truth), run.cpu
        for group in {program, program.split(",")[0]}:
            points.setdefault(group, []).append(at)
        if program.startswith("hermite") and run.status == Status.OK.name:
            points.setdefault("hermite, trusted", []).append(at)
    print("\n| seconds at an error of | 5 % | | 1 % | |\n|---|---|---|---|---|")
    costs: dict[str, list[float]] = {}
    for group, known in sorted(points.items()):
        found = [cost_at(target, known) for target in TARGETS]
        costs[group] = [x for x, _ in found]
        print(f"| {group} | " + " | ".join(f"{x:.3f} | {how}" for x, how in found) + " |")
    print("\n| times cheaper than | 5 % | aim | 1 % | aim |\n|---|---|---|---|---|")
    for line in ("hermite", "hermite, trusted"):
        for peer, aims in AIMS.items():
            ratios = [theirs / mine for theirs, mine in zip(costs[peer], costs[line], strict=True)]
            row = " | ".join(f"{x:.1f} | {aim:g}" for x, aim in zip(ratios, aims, strict=True))
            print(f"| {peer}, by {line} | {row} |")


if __name__ == "__main__":
    main()
