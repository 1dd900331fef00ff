"""What Table 1's optimum of paper 003 does, on four meshes, with rods and with point mounts, against four baselines.

    python benchmarks/table1_honesty.py [--segments 20 40 80 160] [--repeats 4] [--csv FILE]

Prints compact Markdown: mean and half range of Delta, Gamma and the settling times over the unperturbed run and
repeats whose initial velocities are perturbed by 1e-9 m/s (seeds 1 to `--repeats`, at N = 160 at most two). The rows
`masses locked` are the baselines `locked` and `rod_locked` themselves: what the mounts do without the sinks. Values of
runs that are not trusted are shown, with their status. The paper prints 0.5064, 0.5201 and 0.896 s against `uniform`.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from solvers import Ask, Response, Scene, Status
from sweep.config import Study, load_study
from sweep.evaluate import run_trusted
from sweep.metrics import Summary, compute, summarise
from sweep.space import baseline_scene, design_scene, point_key

STUDY = Path(__file__).parents[1] / "configs" / "bnes_optimum.yaml"
BASELINES = ("uniform", "locked", "rod_locked", "plain")
METRICS = ("delta", "gamma", "t_first", "t_settle", "t_energy")
PERTURBATION = 1e-9  # of the initial velocities [m/s]
TIGHT = 1e-6  # tolerance of a run whose energy balance stays open at a tenth of the usual one
FEW = 2  # repeats on meshes of 160 segments and more


class Row(NamedTuple):
    """One mesh and mount, with sinks or with locked masses."""

    segments: int
    mount: str
    devices: str
    values: dict[str, dict[str, np.ndarray]]  # baseline: metric: (runs,)
    statuses: tuple[str, ...]  # of the runs
    base_statuses: tuple[str, ...]
    residual: float  # largest energy residual of the runs and their baselines
    seconds: float  # of one run, mean


class Runner:
    """Runs, each distinct scene once: both mounts share three of the four baselines."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self.settings = replace(study.settings, repeats=0, objectives=())
        self.known: dict[str, tuple[Response, Summary | None]] = {}

    def run(self, scene: Scene, ask: Ask) -> tuple[Response, Summary | None]:
        key = point_key(scene, ask)
        if key not in self.known:
            response = run_trusted(scene, ask).response
            if response.status == Status.ENERGY_OPEN:
                response = run_trusted(scene, replace(ask, tolerance=TIGHT)).response
            self.known[key] = response, summarise(response, scene, self.settings, self.study.scene.cable)
            if ask.perturbation:
                return self.known.pop(key)  # a perturbed run is wanted once
        return self.known[key]

    def rows(self, segments: int, mount: int, repeats: int) -> Iterator[Row]:
        scene = design_scene(self.study, {}, mount)
        ask = replace(self.study.ask, segments=segments)
        bases = {name: self.run(baseline_scene(scene, name), ask) for name in BASELINES}
        name = self.study.environments[mount].name
        seeds = range(repeats + 1)
        sinks = [self.run(scene, replace(ask, perturbation=PERTURBATION if s else 0.0, seed=s)) for s in seeds]
        locked = bases["rod_locked"]  # at point mounts the same as `locked`
        for devices, runs in (("sinks", sinks), ("masses locked", [locked])):
            values = {}
            for baseline, (_, base) in bases.items():
                found = [compute(curves, base, len(scene.devices)) for _, curves in runs]
                values[baseline] = {metric: np.array([row[metric] for row in found]) for metric in METRICS}
            every = [response for response, _ in (*runs, *bases.values())]
            yield Row(
                segments,
                name,
                devices,
                values,
                tuple(response.status.name for response, _ in runs),
                tuple(response.status.name for response, _ in bases.values()),
                max(response.energy_residual for response in every),
                float(np.mean([response.cost.seconds for response, _ in runs])),
            )


def spread(values: np.ndarray, digits: int = 2) -> str:
    """Mean and half range; how many runs they are from where some are not finite."""
    good = values[np.isfinite(values)]
    if not good.size:
        return "inf" if np.isinf(values).any() else "none"
    text = f"{good.mean():.{digits}f}" + (f" ± {np.ptp(good) / 2:.{digits}f}" if values.size > 1 else "")
    return text if good.size == values.size else f"{text} ({good.size} of {values.size})"


def count(names: Sequence[str]) -> str:
    """Statuses, with their number where they differ."""
    counts = Counter(names)
    return ", ".join(name if len(counts) == 1 else f"{n} {name}" for name, n in counts.items())


def first(row: Row) -> str:
    """t_first against the four baselines, once where they agree."""
    cells = [spread(row.values[name]["t_first"]) for name in BASELINES]
    return cells[0] if len(set(cells)) == 1 else " / ".join(cells)


def show(rows: Sequence[Row]) -> None:
    head = [f"{metric} {name}" for metric in ("Delta", "Gamma") for name in BASELINES]
    print("| mount | N | " + " | ".join(head) + " |")
    print("|---" * (2 + len(head)) + "|")
    print("| paper | 20 | 0.5064 | | | | 0.5201 | | | |")
    for row in rows:
        cells = [spread(row.values[b][m], n) for m, n in (("delta", 3), ("gamma", 2)) for b in BASELINES]
        print(f"| {row.mount}, {row.devices} | {row.segments} | " + " | ".join(cells) + " |")
    print()
    head = ["t_first", "t_settle", "t_energy", "status", "status of baselines", "energy residual", "seconds a run"]
    print("| mount | N | " + " | ".join(head) + " |")
    print("|---" * (2 + len(head)) + "|")
    print("| paper | 20 | 0.896 | | | | | | |")
    for row in rows:
        cells = [first(row), *(spread(row.values["uniform"][metric]) for metric in METRICS[3:])]
        cells += [count(row.statuses), count(row.base_statuses), f"{row.residual:.1e}", f"{row.seconds:.2f}"]
        print(f"| {row.mount}, {row.devices} | {row.segments} | " + " | ".join(cells) + " |")


def write(rows: Sequence[Row], path: Path) -> None:
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["mount", "devices", "segments", "baseline", "seed", *METRICS, "status", "baseline_status"])
        for row in rows:
            for baseline, base_status in zip(BASELINES, row.base_statuses, strict=True):
                for seed, status in enumerate(row.statuses):
                    values = [f"{row.values[baseline][metric][seed]:.6g}" for metric in METRICS]
                    where = [row.mount, row.devices, row.segments, baseline, seed]
                    table.writerow([*where, *values, status, base_status])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--segments", type=int, nargs="+", default=[20, 40, 80, 160])
    parser.add_argument("--repeats", type=int, default=4, help="perturbed runs beside the unperturbed one")
    parser.add_argument("--csv", type=Path, help="write every single value to this file")
    options = parser.parse_args()
    study = load_study(STUDY)
    rows: list[Row] = []
    for segments in options.segments:
        runner = Runner(study)
        repeats = options.repeats if segments < 160 else min(options.repeats, FEW)
        for mount, environment in enumerate(study.environments):
            rows += runner.rows(segments, mount, repeats)
            print(f"N = {segments}, {environment.name}: done", file=sys.stderr, flush=True)
    names = [environment.name for environment in study.environments]
    rows.sort(key=lambda row: (names.index(row.mount), row.devices != "sinks", row.segments))
    show(rows)
    if options.csv:
        write(rows, options.csv)


if __name__ == "__main__":
    main()
