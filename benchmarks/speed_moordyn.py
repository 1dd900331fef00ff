"""Seconds of one core: this program beside MoorDyn (and CableDyn), on the same scenes, in one run.

    python benchmarks/speed_moordyn.py [--repeats 2] [--duration 5]

Prints two Markdown tables: the bare cable of the study, and the same cable with Table 1's four sinks on rods. The
programs take turns, and the least CPU time of the repeats counts. Needs the `bench` extra.

What is timed. Ours: the whole call of `solve`, from the scene to the response, in processor time. MoorDyn, CableDyn:
their step calls alone, without reading the deck and without fetching positions. So what favour there is goes to them.
Decks are written from our own static mesh: the same nodes, lengths, tension, EI, clamps, water, and axial damping BA.

Sinks: `guided` masses slide across the cable (the study's), `free` ones are particles on two cords, as MoorDyn's are.
Free ones run at a tenth of the usual tolerance, without which their energy balance stays open.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from solvers import Ask, Response, Scene, solve
from sweep.config import load_scene
from sweep.peers import quiet
from sweep.space import baseline_scene

try:
    import cabledyn
    import moordyn
    from cabledyn.model import CableDyn
except ImportError as missing:
    sys.exit(f"{missing.name} is not installed; this benchmark needs the bench extra: pip install -e '.[bench]'")

SCENE = Path(__file__).parents[1] / "configs" / "bnes_optimum.yaml"
STATIONS = 20  # waveforms are compared at this many equal parts of the cable ...
SAMPLE = 2e-3  # ... and at this interval [s]
LADDER = (5e-5, 1e-4 / 3, 2.5e-5, 2e-5, 1e-5, 5e-6)  # MoorDyn's steps with sinks, the first that holds [s]
COUPLING = 1e-4  # with sinks: MoorDyn holds the end's velocity for so long [s]


class Run(NamedTuple):
    """One run of one program."""

    cpu: float  # [s]
    step: float  # [s], mean where it adapts
    evaluations: int  # right-hand sides
    x: np.ndarray  # (nt, n_node) transverse displacement from end A to end B [m]
    arc: np.ndarray  # (n_node,) [m]
    residual: float = math.nan
    status: str = ""

    @property
    def ns(self) -> float:
        """Nanoseconds for one node and one right-hand side."""
        return 1e9 * self.cpu / (self.evaluations * len(self.arc))

    def rms(self, until: float) -> float:
        """RMS of the displacement over the cable and the first seconds [m]."""
        squares = self.x[: round(until / SAMPLE) + 1] ** 2
        return math.sqrt(float(np.trapezoid(squares, self.arc, axis=1).mean()) / self.arc[-1])


# --------------------------------------------------------------------------- ours


def ours(scene: Scene, segments: int, duration: float, **ask: Any) -> Run:
    begun = time.process_time()
    r = solve(scene, Ask(duration=duration, segments=segments, interval=SAMPLE, **ask))
    cpu = time.process_time() - begun
    cost = r.cost
    x = r.signals["position"][:, :, 0] - r.signals["static_position"][:, 0]
    mean = duration / max(cost.steps, 1)
    return Run(cpu, mean, cost.evaluations, x, r.signals["arc"], r.energy_residual, r.status.name)


# --------------------------------------------------------------------------- MoorDyn


class Stretch(NamedTuple):
    """Cable between clamps and rods, or a rod, from the foot up."""

    rigid: bool
    length: float
    segments: int


def stretches(static: Response) -> list[Stretch]:
    found: list[Stretch] = []
    lengths, rigid = np.diff(static.signals["arc"]), static.signals["rigid"] > 0.5
    for length, rod in zip(lengths, rigid, strict=True):
        if found and not rod and not found[-1].rigid:
            found[-1] = Stretch(False, found[-1].length + length, found[-1].segments + 1)
        else:
            found.append(Stretch(bool(rod), float(length), 1))
    return found


def pulse(scene: Scene, t: float) -> tuple[float, float, float]:
    """Displacement, velocity, acceleration of end B along x: harmonics in a sharp window, eq. (3.4)."""
    motion: Any = scene.end_b.motion
    found = np.zeros(3)
    if t < motion.window.stop - 1e-9:
        for h in motion.harmonics:
            w = 2 * math.pi * h.frequency
            sine, cosine = math.sin(w * t + h.phase), math.cos(w * t + h.phase)
            found += h.amplitude[0] * np.array([sine, w * cosine, -(w**2) * sine])
    return found[0], found[1], found[2]


def levels(scene: Scene) -> tuple[float, float]:
    """Levels of the two ends [m]."""
    low: Any = scene.end_a.position
    high: Any = scene.end_b.position
    return low[2], high[2]


def moordyn_deck(scene: Scene, parts: list[Stretch], BA: float, step: float) -> tuple[str, float]:
    """A MoorDyn v2 deck, and the level of end B.

    Both ends are clamped to rods of finite length (rods of zero length are pins): one fixed, one on a coupled body.
    Rods inline are free, end A on top (otherwise they start with a wrong direction) and rigid: so that the cable is
    as tight as ours, end B sits lower by the stretch that they lack (0.2 mm). The devices' masses are free points,
    each on two cords of one almost massless segment.
    """
    cable, (foot, top) = scene.cable[0], levels(scene)
    strain = (top - foot) / scene.length - 1
    z, rods = foot, []
    for part in parts:
        rods += [(z + part.length, z)] if part.rigid else []
        z += part.length * (1.0 if part.rigid else 1 + strain)
    devices = sorted(scene.devices, key=lambda d: d.s)
    size = scene.length / sum(p.segments for p in parts)
    kind = f"{cable.d} {cable.mass}"
    coefficients = f"{cable.Cdn} {cable.Can}"
    line_types = [f"cable {kind} {cable.EA} {BA} {cable.EI} {coefficients} {cable.Cdt} {cable.Cat}"]
    line_types += [f"cord{i} 0.001 1e-4 {d.EA} {d.BA} 0 0 0 0 0" for i, d in enumerate(devices)]
    rod_lines = [f"1 stub Fixed 0 0 {foot} 0 0 {foot - 0.5} 1 -", "2 stub Body1 0 0 0.5 0 0 0 1 -"]
    for i, (a, b) in enumerate(rods):
        rod_lines.append(f"{i + 3} rod Free 0 0 {a:.12f} 0 0 {b:.12f} {max(1, round((a - b) / size))} -")
    points = []
    for i, (d, (a, b)) in enumerate(zip(devices, rods, strict=True)):
        points.append(f"{i + 1} Free {d.rest_offset:.12f} 0 {(a + b) / 2:.12f} {d.mass} {d.mass / scene.density} 0 0")
    lines = []
    soft = [part for part in parts if not part.rigid]
    for i, part in enumerate(soft):
        low = "R1A" if i == 0 else f"R{i + 2}A"
        high = "R2B" if i == len(soft) - 1 else f"R{i + 3}B"
        lines.append(f"{i + 1} cable {low} {high} {part.length:.12f} {part.segments} -")
    for i, d in enumerate(devices):
        for end in "AB":
            lines.append(f"{len(lines) + 1} cord{i} R{i + 3}{end} {i + 1} {d.length} 1 -")
    options = [
        "0 writeLog", f"{step * (1 + 1e-6):.9g} dtM", "1e4 CFL", "rk4 tScheme", f"{scene.g} g", f"{scene.density} rho",
        "100 WtrDpth", "0 TmaxIC", "1 disableOutput", "1 disableOutTime",
    ]  # fmt: skip
    sections = {
        "LINE TYPES": line_types, "ROD TYPES": [f"stub {kind} 0 0 0 0", f"rod {kind} {coefficients} 0 0"],
        "BODIES": [f"1 Coupled 0 0 {z:.12f} 0 0 0 1 0 1 0 0 0"], "RODS": rod_lines, "POINTS": points, "LINES": lines,
    }  # fmt: skip
    text = ["a cable between two clamps"]
    for name, rows in sections.items():
        text += [f"---------------------- {name} ----------------------", "names", "units", *rows] if rows else []
    text += ["---------------------- OPTIONS ----------------------", *options, "------- need this line -------"]
    return "\n".join(text) + "\n", z


def moordyn_run(
    scene: Scene, parts: list[Stretch], duration: float, step: float, coupling: float, BA: float | None = None
) -> Run:
    """RK4 at a fixed step; RuntimeError where it does not stay finite and small.

    MoorDyn holds the velocity of a moved end for a coupling step, so it is given the mean velocity of the step: then
    the displacement is right at the end of each.
    """
    per, count = round(SAMPLE / coupling), round(duration / SAMPLE)
    text, z = moordyn_deck(scene, parts, scene.cable[0].BA if BA is None else BA, step)
    x, v = [0.0, 0.0, z, 0.0, 0.0, 0.0], [0.0] * 6
    moved = [pulse(scene, k * coupling)[0] for k in range(count * per + 1)]
    soft = [part for part in parts if not part.rigid]
    cpu, at, rows = 0.0, 0, []
    with tempfile.TemporaryDirectory() as folder, quiet():
        deck = Path(folder) / "deck.txt"
        deck.write_text(text)
        system = moordyn.Create(str(deck))
        try:
            moordyn.Init_NoIC(system, x, v)
            lines = [(moordyn.GetLine(system, i + 1), part.segments + 1) for i, part in enumerate(soft)]
            for k in range(count + 1):
                rows.append([moordyn.GetLineNodePos(line, i)[0] for line, n in lines for i in range(n)])
                if not np.abs(rows[-1]).max() < 1.0:
                    raise RuntimeError("unstable")
                begun = time.process_time()
                for _ in range(per if k < count else 0):
                    x[0], v[0] = moved[at], (moved[at + 1] - moved[at]) / coupling
                    moordyn.Step(system, x, v, at * coupling, coupling)
                    at += 1
                cpu += time.process_time() - begun
        finally:
            moordyn.Close(system)
    arc, s = [], 0.0
    for part in parts:
        if not part.rigid:
            arc += [s + part.length * i / part.segments for i in range(part.segments + 1)]
        s += part.length
    inner = round(coupling / step)
    return Run(cpu, coupling / inner, at * inner * 4, np.array(rows), np.array(arc))


def rk4_step(scene: Scene, segments: int, BA: float) -> float:
    """95 % of RK4's largest stable step on the fastest axial mode of a uniform mesh, whole steps in a sample [s]."""
    cable, size = scene.cable[0], scene.length / segments
    omega = 2 / size * math.sqrt(cable.EA / cable.mass)
    zeta = BA * omega / (2 * cable.EA)
    fastest = omega * (zeta + math.sqrt(max(zeta**2 - 1, 0.0)))
    return SAMPLE / math.ceil(SAMPLE / (0.95 * 2.785 / max(fastest, omega)))


# --------------------------------------------------------------------------- CableDyn


def cabledyn_run(scene: Scene, elements: int, duration: float, step: float) -> Run:
    """Cubic Hermite elements and generalised-alpha; end A of its line is our end B."""
    cable, (foot, top) = scene.cable[0], levels(scene)
    deck = cabledyn.DeckModel.new(title="bare cable")
    deck.add_line_type(
        "cable", diam=cable.d, mass=cable.mass, ea=cable.EA, ba=cable.BA, ei=cable.EI, cdn=cable.Cdn, cdt=cable.Cdt,
        can=cable.Can, cat=cable.Cat,
    )  # fmt: skip
    deck.add_point(1, "Coupled", 0.0, 0.0, top)
    deck.add_point(2, "Fixed", 0.0, 0.0, foot)
    deck.add_line(1, 1, 2, "cable", length=scene.length, num_segs=elements)
    for end in "AB":
        deck.add_end_connection(1, end, "Rigid", (0, 0, -1))
    for key, value in (("dtM", step), ("TMax", duration), ("g", scene.g), ("rhoW", scene.density), ("WtrDpth", 100.0)):
        deck.options.set(key, value)
    cpu, rows, per, iterations = 0.0, [], round(SAMPLE / step), 0
    with tempfile.TemporaryDirectory() as folder, quiet():
        path = Path(folder) / "deck.dat"
        deck.save(path)
        model = CableDyn(path)
        line = model.line(1)
        rows.append(line.node_positions()[::-1, 0].copy())
        for k in range(1, round(duration / step) + 1):
            x, u, w = pulse(scene, k * step)
            q, v, a = np.array([x, 0.0, top]), np.array([u, 0.0, 0.0]), np.array([w, 0.0, 0.0])
            begun = time.process_time()
            iterations += model.step(step, q, v, a)
            cpu += time.process_time() - begun
            if k % per == 0:
                rows.append(line.node_positions()[::-1, 0].copy())
        model.close()
    return Run(cpu, step, iterations, np.array(rows), np.linspace(0, scene.length, elements + 1))


# --------------------------------------------------------------------------- tables


def least(jobs: dict[str, Callable[[], Run]], repeats: int) -> dict[str, Run]:
    """Run the jobs in turn, several times; the fastest run of each."""
    best: dict[str, Run] = {}
    for _ in range(repeats):
        for name, job in jobs.items():
            run = job()
            if name not in best or run.cpu < best[name].cpu:
                best[name] = run
    return best


def error(run: Run, truth: Run) -> float:
    """Relative rms difference of the waveforms, on meshes whose segments divide the cable into equal parts."""
    a, b = (r.x[:, :: (len(r.arc) - 1) // STATIONS] for r in (run, truth))
    return math.sqrt(float(((a - b) ** 2).sum() / (b**2).sum()))


def bare_table(scene: Scene, repeats: int) -> None:
    plain, duration = baseline_scene(scene, "plain"), 2.0
    cable = plain.cable[0]
    truth = ours(plain, 640, duration, method="genalpha", step=1.25e-4)
    jobs: dict[str, Callable[[], Run]] = {}
    for n in (80, 160):
        critical = plain.length / n * math.sqrt(cable.EA * cable.mass)
        for BA in dict.fromkeys((cable.BA, round(critical))):
            mesh = replace(plain, cable=(replace(cable, BA=float(BA)),))
            parts = [Stretch(False, plain.length, n)]
            step = rk4_step(plain, n, BA)
            jobs[f"ours | {n} | {BA:.0f}"] = lambda mesh=mesh, n=n: ours(mesh, n, duration)
            jobs[f"MoorDyn, RK4 | {n} | {BA:.0f}"] = lambda mesh=mesh, parts=parts, step=step: moordyn_run(
                mesh, parts, duration, step, step
            )
    for n, step in ((20, 2e-3), (40, 1e-3)):
        jobs[f"CableDyn | {n} | {cable.BA:.0f}"] = lambda n=n, step=step: cabledyn_run(plain, n, duration, step)
    best = least(jobs, repeats)
    print(f"Bare cable, clamped, pulse (3.4), {duration:g} s. Error against 640 segments at 0.125 ms (itself 0.6 %).\n")
    print("| program | segments | BA, N s | CPU s | beside ours | waveform error | step, us | ns per node and rhs |")
    print("|---|---|---|---|---|---|---|---|")
    for name, run in best.items():
        program, *mesh = name.split(" | ")
        own = best.get(" | ".join(["ours", *mesh]))
        ratio = f"{run.cpu / own.cpu:.1f}" if own else "-"
        ns = "-" if program == "CableDyn" else f"{run.ns:.0f}"
        print(f"| {name} | {run.cpu:.2f} | {ratio} | {error(run, truth):.1%} | {run.step * 1e6:.0f} | {ns} |")
    for n in (80, 160):
        pair = [best[f"{program} | {n} | {cable.BA:.0f}"] for program in ("MoorDyn, RK4", "ours")]
        print(f"\nMoorDyn's waveform differs from ours on the same {n} segments by {error(*pair):.2%}.", end="")
    print("\n")


def sinks_table(scene: Scene, repeats: int, duration: float) -> None:
    free = replace(scene, devices=tuple(replace(d, kind="bnes_free") for d in scene.devices))
    print(f"Table 1's sinks on rods, cords in tension only, {duration:g} s.\n")
    head = "program | devices | N | CPU s | beside ours | CPU s per simulated s | steps | energy residual"
    print(f"| {head} | status | rms x to 0.5 s, mm | rms x to {duration:g} s, mm |")
    print("|---" * 11 + "|")
    notes = []
    for n in (40, 80):
        parts = stretches(solve(scene, Ask(segments=n)))
        jobs: dict[str, Callable[[], Run]] = {
            "ours | guided": lambda n=n: ours(scene, n, duration),
            "ours | free": lambda n=n: ours(free, n, duration, tolerance=1e-5),
        }
        for step in LADDER:
            try:
                trial = moordyn_run(scene, parts, 0.5, step, COUPLING)
                half = moordyn_run(scene, parts, 0.5, step / 2, COUPLING)
                change = math.sqrt(float(((trial.x - half.x) ** 2).sum() / (half.x**2).sum()))
                if change > 0.01:
                    raise RuntimeError("not converged")
                jobs["MoorDyn, RK4 | free"] = lambda parts=parts, step=step: moordyn_run(
                    scene, parts, duration, step, COUPLING
                )
                best = least(jobs, repeats)
            except RuntimeError:
                continue
            notes.append(f"N = {n}: MoorDyn at {step * 1e6:.1f} us; half of it moves the first 0.5 s by {change:.1e}")
            break
        else:
            sys.exit("MoorDyn found no stable step")
        own = best["ours | guided"].cpu
        for name, run in best.items():
            closed = "-" if math.isnan(run.residual) else f"{run.residual:.1e}"
            print(
                f"| {name} | {n} | {run.cpu:.2f} | {run.cpu / own:.1f} | {run.cpu / duration:.2f} "
                f"| {round(duration / run.step)} | {closed} | {run.status or '-'} | {run.rms(0.5) * 1e3:.2f} "
                f"| {run.rms(duration) * 1e3:.2f} |"
            )
    print("\n" + ". ".join(notes) + ".")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--duration", type=float, default=5.0, help="of the runs with sinks [s]")
    options = parser.parse_args()
    scene = load_scene(SCENE)
    ours(scene, 20, 0.01)  # loads the kernels
    bare_table(scene, options.repeats)
    sinks_table(scene, options.repeats, options.duration)


if __name__ == "__main__":
    main()
