"""Does energy scatter to high frequencies, and what does it: the sinks, their mass or their rods?

    python benchmarks/scattering.py

Share of the modal energy (integrated over time, after the pulse) in modes of the plain cable above a frequency, for the
sinks of `configs/sinks_compared.yaml` and four baselines; energies at 2 s; chaos as the range over perturbed runs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from solvers import warm_up
from sweep import load_study
from sweep.flows import modal
from sweep.point import Point
from sweep.space import points

STUDY = Path(__file__).parents[1] / "configs" / "sinks_compared.yaml"
BASELINES = ("plain", "uniform", "locked", "rod_locked")
RUNS = 4  # perturbed ones of each sink


def main() -> None:
    warm_up()
    study = load_study(STUDY)
    print("share of the modal energy after the pulse above a frequency, %; energy at 2 s, all and above the cut, J\n")
    for k, (environment, point) in enumerate(zip(study.environments, points(study), strict=True)):
        runs = [modal(asked(point, seed, "uniform")) for seed in range(RUNS + 1)]
        if k == 0:
            above = " | ".join(f"{f:.4g} Hz" for f in runs[0]["above"].values)
            print(f"| run | {above} | all | above {runs[0].attrs['cut']:.4g} Hz |")
            print("| --- " * (runs[0].sizes["above"] + 3) + "|")
            for baseline in BASELINES:
                print(line(baseline, modal(asked(point, 0, baseline))), flush=True)
        shares = np.stack([100 * run["after"].values for run in runs])
        middle, half = shares.mean(axis=0), np.ptp(shares, axis=0) / 2
        cells = " | ".join(f"{m:.1f} ± {h:.1f}" for m, h in zip(middle, half, strict=True))
        whole, high = zip(*(energies(run, "") for run in runs), strict=True)
        print(f"| {environment.name} sinks | {cells} | {np.mean(whole):.2f} | {np.mean(high):.2f} |", flush=True)


def asked(point: Point, seed: int, baseline: str) -> Point:
    ask = replace(point.ask, interval=1e-3, perturbation=1e-9 if seed else 0.0, seed=seed)
    return replace(point, ask=ask, settings=replace(point.settings, repeats=0, baseline=baseline))


def energies(run: xr.Dataset, prefix: str) -> tuple[float, float]:
    here = run[f"{prefix}modal_energy"].sel(time=2.0, method="nearest").values
    return float(here.sum()), float(here[run["frequency"].values > run.attrs["cut"]].sum())


def line(name: str, run: xr.Dataset) -> str:
    shares = " | ".join(f"{100 * x:.1f}" for x in run["baseline_after"].values)
    return f"| {name} | {shares} | " + " | ".join(f"{e:.2f}" for e in energies(run, "baseline_")) + " |"


if __name__ == "__main__":
    main()
