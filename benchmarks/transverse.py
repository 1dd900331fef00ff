"""What the transverse line costs and how far it goes, beside the planar lumped line.

    python benchmarks/transverse.py chart [--out figures]    error against processor time, bare and with devices
    python benchmarks/transverse.py ensemble [--members 8]   statistics of Table 1's chaotic response, both lines
    python benchmarks/transverse.py range                    error against converged lumped lines, and its estimates
    python benchmarks/transverse.py study [--designs 60]     designs of configs/bnes_study.yaml: cost, ledger, status

All in one process on one core, both lines in turn, processor time of `solve` (build, statics, march, output), the best
of two runs after one that compiles; the error is the rms of the offset over nodes and times, over its rms.

`chart`: the bare cable of reference 25 over 2 s against `tests/reference/plain_cable.npz` (MoorDyn, 640 segments, good
to 0.6 %), and Table 1's devices on rods: cost of 5 s against the error of the first 0.1 s, against 320 lumped segments
(later the response to impacts is chaotic, and means are what can be compared). `ensemble`: Delta, Gamma and the share
of the energy lost in devices against `locked` masses, mean and standard error over small random initial velocities.
`range`: smooth motions against lumped lines extrapolated from two meshes, whose own error is some 1e-3 and less.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solvers import MODELS, Ask, End, Harmonic, Motion, Response, Scene, Section, Water, Window, catalogue, solve
from sweep.config import load_study
from sweep.metrics import compute, summarise
from sweep.space import baseline_scene, design_scene, designs

ROOT = Path(__file__).parents[1]
STUDY = load_study(ROOT / "configs" / "bnes_study.yaml")
MEMBER = 1e-6  # m/s: perturbation of an ensemble's members


def bare() -> Scene:
    """The cable of reference 25."""
    scene, length, pull = STUDY.scene, 18.8, 500.0
    foot, top = (0.0, 0.0, -5 - length * (1 + pull / 9e6)), (0.0, 0.0, -5.0)
    return replace(
        scene, cable=(replace(scene.cable[0], length=length),), devices=(), end_a=replace(scene.end_a, position=foot),
        end_b=replace(scene.end_b, position=top),
    )  # fmt: skip


def offsets(run: Response, s: np.ndarray) -> np.ndarray:
    """(nt, len(s)) horizontal position at arc lengths."""
    arc = run.signals["arc"]
    return np.array([np.interp(s, arc, x) for x in run.signals["position"][:, :, 0]])


def relative(x: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(x - exact) / np.linalg.norm(exact))


def timed(scene: Scene, ask: Ask) -> float:
    """Processor time of the faster of two runs [s]."""
    best = math.inf
    for _ in range(2):
        begun = time.process_time()
        solve(scene, ask)
        best = min(best, time.process_time() - begun)
    return best


# ------------------------------------------------------------------------------------------------- chart


SPANS = (20, 24, 32, 40, 60, 80)
SCALED = "transverse, srkn4, masses scaled to 3.6"
LINES: dict[str, tuple[tuple[int, ...], dict[str, Any]]] = {
    "transverse": (SPANS, {"model": "transverse"}),
    SCALED: (SPANS, {"model": "transverse", "method": "srkn4", "mass_scaling": 3.6}),
    "lumped": ((40, 80, 160), {"model": "lumped"}),
}  # fmt: skip


def chart(out: Path | None) -> None:
    file = np.load(ROOT / "tests" / "reference" / "plain_cable.npz")
    t, x = file["t"].astype(float), file["x"].astype(float)
    plain = Ask(duration=float(t[-1]), interval=float(t[1] - t[0]), method="dopri5", accuracy=0.9)
    s = np.linspace(0, STUDY.scene.length, 41)
    early = Ask(duration=0.1, interval=1e-3, method="dopri5", accuracy=0.9)
    fine = solve(STUDY.scene, replace(early, model="lumped", segments=320, tolerance=1e-5))
    cases = {
        "bare cable, 2 s": (bare(), plain, np.linspace(0, 18.8, x.shape[1]), x, 2.0),
        "Table 1's devices, 5 s": (STUDY.scene, early, s, offsets(fine, s), 5.0),
    }
    rows: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for name, (scene, ask, places, exact, long) in cases.items():
        print(f"{name}\n| line | N | status | error | CPU s | steps | energy residual |\n|---|---|---|---|---|---|---|")
        rows[name] = {line: [] for line in LINES}
        for line, (meshes, change) in LINES.items():
            for n in meshes:
                asked = replace(ask, segments=n, **change)
                run = solve(scene, asked)
                cost = timed(scene, replace(asked, duration=long, interval=1e-3))
                error = relative(offsets(run, places), exact)
                rows[name][line].append((cost, error))
                print(f"| {line} | {n} | {run.status.name} | {error:.4f} | {cost:.3f} | {run.cost.steps} "
                      f"| {run.energy_residual:.1e} |", flush=True)  # fmt: skip
        gains = ", ".join(f"{gain(rows[name], line):.0f} times {line}" for line in rows[name] if line != "lumped")
        print(f"at equal error lumped costs {gains}\n")
    if out:
        draw(rows, out / "transverse.png")


def gain(curves: dict[str, list[tuple[float, float]]], line: str) -> float:
    """Cost of the finest lumped mesh over that of a line at its error, between meshes by power laws."""
    cost, error = np.log(np.array(curves[line])).T
    dear, reached = curves["lumped"][-1]
    return float(dear / np.exp(np.interp(-math.log(reached), -error, cost)))


def draw(rows: dict[str, dict[str, list[tuple[float, float]]]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(rows), figsize=(10, 4), layout="constrained")
    for ax, (name, curves) in zip(axes, rows.items(), strict=True):
        for model, points in curves.items():
            ax.loglog(*np.array(points).T, "o-", label=model)
        ax.set(title=name, xlabel="processor time [s]", ylabel="relative error of the offset")
        ax.grid(True, which="both", alpha=0.3)
        ax.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


# ------------------------------------------------------------------------------------------------- ensemble


def ensemble(members: int) -> None:
    scene, base = STUDY.scene, baseline_scene(STUDY.scene, "locked")
    names = ("delta", "gamma", "energy_share_device", "rms_reduction")
    print(f"| line | N | {' | '.join(names)} | CPU s | status |\n|---|---|{'---|' * (len(names) + 2)}")
    meshes = {"lumped": (80, 160), "transverse": (24, 40, 60, 120), SCALED: (32, 40, 60)}
    for line, n in ((line, n) for line, given in meshes.items() for n in given):
        ask = replace(Ask(duration=5.0, segments=n, method="dopri5"), **LINES[line][1])
        still = summarise(solve(base, ask), base, STUDY.settings)
        found, cost, status = [], 0.0, Counter[str]()
        for seed in range(members):
            begun = time.process_time()
            run = solve(scene, replace(ask, perturbation=MEMBER, seed=seed))
            cost += time.process_time() - begun
            status[run.status.name] += 1
            row = compute(summarise(run, scene, STUDY.settings), still, len(scene.devices))
            found.append([row[x] for x in names])
        mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / math.sqrt(members)
        cells = " | ".join(f"{a:.4f} ± {b:.4f}" for a, b in zip(mean, error, strict=True))
        print(f"| {line} | {n} | {cells} | {cost / members:.3f} | {dict(status)} |", flush=True)


# ------------------------------------------------------------------------------------------------- range


def smooth(amplitude: float, frequency: float, along: np.ndarray) -> Motion:
    term = Harmonic(amplitude=tuple(amplitude * along), frequency=frequency)
    ramps = {"ramp_up": 1 / frequency, "ramp_down": 1 / frequency}
    return Motion(harmonics=(term,), window=Window(start=0.0, stop=4 / frequency, shape="smooth", **ramps))


def beam(amplitude: float, frequency: float) -> Scene:
    """The study's cable, bare, with less axial damping, so that its lumped line is quick to converge."""
    scene = STUDY.scene
    end = replace(scene.end_b, motion=smooth(amplitude, frequency, np.array([1.0, 0, 0])))
    return replace(scene, devices=(), cable=(replace(scene.cable[0], BA=300.0),), end_b=end)


def pulse(size: float) -> Scene:
    """Reference 25 with ramps of 0.1 s at the edges of the pulse, its amplitudes times `size`."""
    scene = replace(bare(), cable=(replace(bare().cable[0], BA=300.0),))
    motion = scene.end_b.motion
    assert motion is not None
    terms = tuple(replace(h, amplitude=tuple(size * x for x in h.amplitude)) for h in motion.harmonics)
    ramps = Window(start=0.0, stop=0.5, ramp_up=0.1, ramp_down=0.1, shape="smooth")
    return replace(scene, end_b=replace(scene.end_b, motion=replace(motion, harmonics=terms, window=ramps)))


def string(amplitude: float, frequency: float, sag: float = 0.0, slant: float = 0.0, EA: float = 2e6,
           along: bool = False) -> Scene:  # fmt: skip
    """30 m of rope at some 2 kN between pins, with a sag of a share of its length, moved across or along its chord."""
    T, L = 2000.0, 30.0
    t = np.array([math.cos(slant), 0.0, math.sin(slant)])
    n = np.array([-t[2], 0.0, t[0]])
    cable = Section(length=L, d=0.05, mass=5.0, EA=EA, compression=True, Can=1.0, Cdn=1.2, Cdt=0.01,
                    wet_weight=max(8 * T * sag / L, 1e-9))  # fmt: skip
    a = np.array([0.0, 0.0, -40.0])
    b = a + t * L * (1 + T / EA - 8 / 3 * sag**2)
    moved = End(kind="pinned", position=tuple(b), motion=smooth(amplitude, frequency, t if along else n))
    return Scene(cable=(cable,), water=Water(), end_a=End(kind="pinned", position=tuple(a)), end_b=moved)


SCENES = {
    "study cable, 2 Hz, 0.01 m": (beam(0.01, 2.0), 2.5, 80), "2 Hz, 0.1 m": (beam(0.1, 2.0), 2.5, 80),
    "2 Hz, 0.3 m": (beam(0.3, 2.0), 2.5, 80), "2 Hz, 1 m": (beam(1.0, 2.0), 2.5, 80),
    "8 Hz, 0.01 m": (beam(0.01, 8.0), 1.0, 160), "8 Hz, 0.03 m": (beam(0.03, 8.0), 1.0, 160),
    "pulse (3.4), ramped": (pulse(1.0), 1.5, 160), "three times it": (pulse(3.0), 1.5, 160),
    "string, 0.5 Hz, 0.3 m": (string(0.3, 0.5), 8.0, 80), "0.5 Hz, 2 m": (string(2.0, 0.5), 8.0, 80),
    "2 Hz, 0.3 m of string": (string(0.3, 2.0), 3.0, 80),
    "soft string, 1 Hz, 0.05 m": (string(0.05, 1.0, EA=1e5), 5.0, 80),
    "soft string, 1 Hz, 0.3 m": (string(0.3, 1.0, EA=1e5), 5.0, 80),
    "sag 1/200": (string(0.1, 0.5, 0.005), 8.0, 80), "sag 1/50": (string(0.1, 0.5, 0.02), 8.0, 80),
    "sag 1/20": (string(0.1, 0.5, 0.05), 8.0, 80), "sag 1/10": (string(0.1, 0.5, 0.1), 8.0, 80),
    "sag 1/50, slant 40 deg": (string(0.1, 0.5, 0.02, 0.7), 8.0, 80),
    "sag 1/20, slant 40 deg": (string(0.1, 0.5, 0.05, 0.7), 8.0, 80),
    "sag 1/50, 1 cm along": (string(0.01, 0.5, 0.02, along=True), 8.0, 80),
    "sag 1/50, 5 cm along": (string(0.05, 0.5, 0.02, along=True), 8.0, 80),
    "sag 1/330, 3 mm along, 1 Hz": (string(0.003, 1.0, 0.003, along=True), 6.0, 80),
}  # fmt: skip


def normal(run: Response, across: np.ndarray) -> np.ndarray:
    """(nt, 41) offsets from rest across the chord, at equal arc lengths."""
    s = run.signals["arc"]
    x = (run.signals["position"] - run.signals["static_position"]) @ across
    return np.array([np.interp(np.linspace(0, s[-1], 41), s, row) for row in x])


def ranges() -> None:
    catalogue._in_range = lambda *_: None  # here it is asked how wrong the line is where it would be refused
    print("| scene | error | estimate before | after the run |\n|---|---|---|---|")
    for name, (scene, duration, n) in SCENES.items():
        ask = Ask(duration=duration, interval=duration / 400, method="dopri5", accuracy=0.999)
        model = MODELS["transverse"].build(scene, 80)
        across = model.chord.frame[1] @ model.basis
        one, two = (
            normal(solve(scene, replace(ask, model="lumped", segments=k, tolerance=3e-5)), across) for k in (n, 2 * n)
        )
        run = solve(scene, replace(ask, model="transverse", segments=80, tolerance=1e-5))
        error = relative(normal(run, across), (4 * two - one) / 3)
        after = model.run_error(run.t, run.signals)
        print(f"| {name} | {error:.4f} | {model.range_error():.4f} | {after:.4f} |", flush=True)


# ------------------------------------------------------------------------------------------------- study


def study(count: int) -> None:
    scenes = [design_scene(STUDY, values) for values in designs(STUDY, count)]
    print("| N | CPU s a design, mean (largest) | of it the march's wall s | steps | largest energy residual | status "
          "| 2000 designs on 2 cores, s |\n|---|---|---|---|---|---|---|")  # fmt: skip
    for n in (20, 24, 32):
        ask = Ask(duration=5.0, segments=n, model="transverse", method="dopri5")
        base = summarise(solve(baseline_scene(scenes[0], "locked"), ask), scenes[0], STUDY.settings)
        cost, march, steps, worst, status = [], 0.0, 0, 0.0, Counter[str]()
        for scene in scenes:
            begun = time.process_time()
            run = solve(scene, ask)
            compute(summarise(run, scene, STUDY.settings), base, len(scene.devices))
            cost.append(time.process_time() - begun)
            march, steps = march + run.cost.seconds, steps + run.cost.steps
            worst = max(worst, run.energy_residual)
            status[run.status.name] += 1
        mean = float(np.mean(cost))
        print(f"| {n} | {mean:.3f} ({max(cost):.3f}) | {march / count:.3f} | {steps // count} | {worst:.1e} "
              f"| {dict(status)} | {mean * 1000:.0f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("chart", "ensemble", "range", "study"))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--members", type=int, default=8)
    parser.add_argument("--designs", type=int, default=60)
    options = parser.parse_args()
    if options.what == "chart":
        chart(options.out)
    elif options.what == "ensemble":
        ensemble(options.members)
    elif options.what == "range":
        ranges()
    else:
        study(options.designs)
