"""Table 1's sinks over five seconds: this program's cheapest line beside MoorDyn, on meshes of equal error, in one run.

    python benchmarks/table1_moordyn.py [--segments 80] [--spans 20 32] [--repeats 3]

The error of a mesh is that of the bare cable of reference 25, 2 s after its pulse, against
`tests/reference/plain_cable.npz` (MoorDyn, 640 segments, good to 0.6 %): with sinks the response is chaotic, and no
waveform tells. Then both run Table 1's four sinks on rods: ours `transverse` with guided masses, called through `solve`
from the scene to the response; MoorDyn its free masses on cords, its step calls alone, at the longest of its steps that
stays finite and that half of it confirms over the first 0.5 s to 1 %. Processor seconds of one core, the least of the
repeats (MoorDyn runs once).
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
from speed_moordyn import COUPLING, LADDER, SCENE, Run, moordyn_run, rk4_step, stretches
from transverse import ROOT, bare, offsets, relative

from solvers import Ask, Scene, solve
from sweep import peers
from sweep.config import load_scene

DURATION = 5.0


def mesh_errors(segments: int, spans: list[int]) -> dict[str, float]:
    """Waveform errors of the bare cable, relative: MoorDyn's mesh and ours."""
    file = np.load(ROOT / "tests" / "reference" / "plain_cable.npz")
    t, x = file["t"].astype(float), file["x"].astype(float)
    scene, places = bare(), np.linspace(0, 18.8, x.shape[1])
    ask = Ask(duration=float(t[-1]), interval=float(t[1] - t[0]))
    step = min(peers.step_of(scene, segments, ask.interval), rk4_step(scene, segments, scene.cable[0].BA))
    step = ask.interval / math.ceil(ask.interval / step)
    theirs = peers.run("MoorDyn", scene, ask, segments, step)[0]
    found = {"MoorDyn": relative(offsets(theirs, places), x)}
    for n in spans:
        own = solve(scene, Ask(
            duration=ask.duration, interval=ask.interval, model="transverse", method="tsit5", segments=n, accuracy=0.9))
        found[f"ours {n}"] = relative(offsets(own, places), x)
    return found


def beside(scene: Scene, segments: int) -> tuple[Run, float]:
    """MoorDyn with sinks at its longest good step, and how far half of it moves the first 0.5 s."""
    parts = stretches(solve(scene, Ask(segments=segments)))
    for step in LADDER:
        try:
            trial, half = (moordyn_run(scene, parts, 0.5, h, COUPLING) for h in (step, step / 2))
            change = math.sqrt(float(((trial.x - half.x) ** 2).sum() / (half.x**2).sum()))
            if change <= 0.01:
                return moordyn_run(scene, parts, DURATION, step, COUPLING), change
        except RuntimeError:
            continue
    raise SystemExit("MoorDyn found no stable step")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--segments", type=int, default=80, help="of MoorDyn")
    parser.add_argument("--spans", type=int, nargs="+", default=[20, 32], help="of ours")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    scene = load_scene(SCENE)
    errors = mesh_errors(options.segments, options.spans)
    theirs, change = beside(scene, options.segments)
    print("| program | mesh | its error, bare cable | CPU s of 5 s with sinks | times | energy residual | status |")
    print("|---|---|---|---|---|---|---|")
    print(f"| MoorDyn, RK4 | {options.segments} segments | {errors['MoorDyn']:.1%} | {theirs.cpu:.2f} | | - | - |")
    for n in options.spans:
        ask = Ask(duration=DURATION, interval=2e-3, model="transverse", method="tsit5", segments=n)
        best = math.inf
        for _ in range(options.repeats):
            begun = time.process_time()
            run = solve(scene, ask)
            best = min(best, time.process_time() - begun)
        print(f"| transverse, tsit5 | {n} spans | {errors[f'ours {n}']:.1%} | {best:.3f} | {theirs.cpu / best:.0f} "
              f"| {run.energy_residual:.1e} | {run.status.name} |")  # fmt: skip
    print(f"\nMoorDyn at {theirs.step * 1e6:.1f} us; half of it moves the first 0.5 s by {change:.1e}.")


if __name__ == "__main__":
    main()
