"""How fine must the mesh of the study be? The bare cable of configs/bnes_study.yaml against a converged run.

    python benchmarks/mesh.py [--reference 240] [--segments 20 40 80 100 160]

Prints, per mesh: nodes in the shortest wave of the excitation, the errors of the integrals of v2 and x2 that Delta and
Gamma are made of, the error of the waveform itself, the energy residual, and seconds of one core.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from solvers import Response, solve
from sweep.config import load_study
from sweep.space import baseline_scene, points

STUDY = Path(__file__).parents[1] / "configs" / "bnes_study.yaml"


def integrals(run: Response) -> tuple[float, float]:
    """Integrals over time and length of v2 and x2, transverse."""
    s = run.signals
    lump = np.gradient(s["arc"])
    x = (s["position"] - s["static_position"])[:, :, 0]
    v = s["velocity"][:, :, 0]
    return float((v**2 @ lump).sum()), float((x**2 @ lump).sum())


def waveform(run: Response, stations: np.ndarray) -> np.ndarray:
    """Transverse displacement at common stations (nt, stations)."""
    s = run.signals
    x = (s["position"] - s["static_position"])[:, :, 0]
    return np.array([np.interp(stations, s["arc"], row) for row in x])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=int, default=240)
    parser.add_argument("--segments", type=int, nargs="+", default=[20, 40, 80, 100, 160])
    options = parser.parse_args()
    point = next(iter(points(load_study(STUDY), 1)))
    scene = baseline_scene(point.scene, "plain")
    stations = np.linspace(0, scene.length, 41)

    def run(segments: int) -> Response:
        return solve(scene, replace(point.ask, segments=segments, method="dopri5"))

    best = run(options.reference)
    v2, x2 = integrals(best)
    truth = waveform(best, stations)
    print(f"against {options.reference} segments ({best.status.name}, energy residual {best.energy_residual:.1e})\n")
    print("| N | status | nodes per wave | v2 | x2 | waveform | energy residual | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    run(options.segments[0])  # loads the kernels
    for segments in options.segments:
        r = run(segments)
        a, b = integrals(r)
        error = np.sqrt(((waveform(r, stations) - truth) ** 2).sum() / (truth**2).sum())
        print(
            f"| {segments} | {r.status.name} | {r.nodes_per_wave:.1f} | {a / v2 - 1:+.2%} | {b / x2 - 1:+.2%} "
            f"| {error:.1%} | {r.energy_residual:.1e} | {r.cost.seconds:.2f} |"
        )


if __name__ == "__main__":
    main()
