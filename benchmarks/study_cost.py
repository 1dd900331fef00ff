"""What the study of paper 003 costs and how good it is, over meshes of the `transverse` line, masses scaled or not.

    OMP_NUM_THREADS=1 python benchmarks/study_cost.py [--designs 16] [--spans 20 32 40 60] [--out figures]

Designs of configs/bnes_study.yaml, 5 s each, one process, one core. `march` is the time loop with its ledger; `model`
what makes a model of a scene and its start; `signals` what makes signals of states, and checks them; `metrics` their
reduction. Beside the total, what 2000 designs would take on two cores that do nothing else.

Errors are those of Delta and Gamma, against locked masses: means of some perturbed runs of each of the first designs,
against those of the finest mesh without scaling.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from transverse import MEMBER, STUDY

from solvers import Ask, catalogue, solve
from solvers.lines.transverse import TransverseModel
from sweep.child import keep_memory
from sweep.metrics import Summary, compute, summarise
from sweep.space import baseline_scene, design_scene, designs

WAYS = (("tsit5", None), ("srkn4", None), ("srkn4", 3.6))  # methods, spans per wave by which masses are scaled
Way = tuple[str, float | None]
spent: Counter[str] = Counter()


def timed(owner: Any, name: str, label: str) -> None:
    """Add the processor time of a function to `spent`."""
    inner: Callable[..., Any] = getattr(owner, name)

    def outer(*args: Any, **named: Any) -> Any:
        begun = time.process_time()
        try:
            return inner(*args, **named)
        finally:
            spent[label] += time.process_time() - begun

    setattr(owner, name, outer)


def ask_of(n: int, way: Way) -> Ask:
    return Ask(duration=5.0, segments=n, model="transverse", method=way[0], interval=2e-3, mass_scaling=way[1])


def base_of(ask: Ask) -> Summary | None:
    scene = baseline_scene(STUDY.scene, "locked")
    return summarise(solve(scene, ask), scene, STUDY.settings)


def costs(count: int, n: int, way: Way) -> dict[str, Any]:
    """Mean milliseconds of a design by part, its steps, the worst ledger, statuses."""
    scenes = [design_scene(STUDY, values) for values in designs(STUDY, count)]
    ask, total, steps, worst, status = ask_of(n, way), 0.0, 0, 0.0, Counter[str]()
    base = base_of(ask)
    spent.clear()
    for scene in scenes:
        begun = time.process_time()
        run = solve(scene, ask)
        middle = time.process_time()
        compute(summarise(run, scene, STUDY.settings), base, len(scene.devices))
        end = time.process_time()
        total, steps, worst = total + end - begun, steps + run.cost.steps, max(worst, run.energy_residual)
        spent["metrics"] += end - middle
        status[run.status.name] += 1
    parts = {name: 1e3 * spent[name] / count for name in ("march", "signals", "metrics")}
    whole = 1e3 * total / count
    return {"total": whole, **parts, "model": whole - sum(parts.values()), "steps": steps // count, "worst": worst,
            "status": dict(status)}  # fmt: skip


def ensembles(count: int, n: int, way: Way, members: int) -> tuple[np.ndarray, np.ndarray]:
    """(2, count) Delta and Gamma of each of the first designs, the mean of its members, and their standard deviation;
    members that are not trusted are left out."""
    ask, found = ask_of(n, way), []
    base = base_of(ask)
    for values in designs(STUDY, count):
        scene, rows = design_scene(STUDY, values), []
        for seed in range(members):
            run = solve(scene, replace(ask, perturbation=MEMBER, seed=seed))
            if run.trusted:
                row = compute(summarise(run, scene, STUDY.settings), base, len(scene.devices))
                rows.append((row["delta"], row["gamma"]))
        found.append((np.mean(rows, axis=0), np.std(rows, axis=0, ddof=1)))
    mean, spread = np.array(found).transpose(1, 2, 0)
    return mean, spread


Costs = dict[tuple[int, Way], dict[str, Any]]  # by spans and way
Errors = dict[tuple[int, Way], tuple[float, float]]  # rms and largest


def label_of(way: Way) -> str:
    return way[0] if way[1] is None else f"{way[0]}, masses scaled to {way[1]:g}"


def draw(rows: Costs, errors: Errors, path: Path) -> None:
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, NullLocator

    from sweep.labels import BASE, BEST, DESIGN, FAIR, SKY, STYLE

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        cost, error = figure.subplots(1, 2)
        bottom, x = np.zeros(len(rows)), np.arange(len(rows))
        for name, colour in (("march", DESIGN), ("signals", FAIR), ("metrics", BEST), ("model", SKY)):
            height = np.array([row[name] for row in rows.values()])
            cost.bar(x, height, 0.7, bottom=bottom, color=colour, label=name)
            bottom += height
        cost.axhline(60.0, color="k", lw=0.8, label="60 s for 2000 designs on two cores")
        names = [f"{n} {way[0]}{' scaled' * (way[1] is not None)}" for n, way in rows]
        cost.set_xticks(x, names, rotation=60, ha="right", fontsize=8)
        cost.set(ylabel="processor time of a design [ms]")
        cost.set_title("a  cost by spans and method")
        cost.legend(loc="upper left")
        for way, marker in ((WAYS[1], "o"), (WAYS[2], "s")):
            mine = sorted(n for n, other in errors if other == way and (n, way) in rows)
            times, sizes = [rows[n, way]["total"] for n in mine], [100 * errors[n, way][0] for n in mine]
            error.plot(times, sizes, marker=marker, color=BASE if way[1] is None else DESIGN, label=label_of(way))
            for n, time_, size in zip(mine, times, sizes, strict=True):
                error.annotate(str(n), (time_, size), xytext=(5, 4), textcoords="offset points", fontsize=8)
        error.axhline(5.0, color="0.5", lw=0.8, ls="--")
        error.axvline(60.0, color="k", lw=0.8)
        error.set(xscale="log", yscale="log", xlabel="processor time of a design [ms]", ylabel="error of Δ, rms [%]")
        for axis, ticks in ((error.xaxis, (30, 60, 100, 200)), (error.yaxis, (3, 5, 10, 15))):
            axis.set_major_locator(FixedLocator(ticks))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_locator(NullLocator())
        error.set_ylim(top=2.5 * error.get_ylim()[1])
        error.set_title("b  error against cost, by spans")
        error.legend(loc="upper right")
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", type=int, default=16)
    parser.add_argument("--spans", type=int, nargs="+", default=[20, 32, 40, 60])
    parser.add_argument("--judged", type=int, default=12, help="designs whose Delta is compared")
    parser.add_argument("--members", type=int, default=8)
    parser.add_argument("--finest", type=int, default=120, help="spans that Delta is compared with")
    parser.add_argument("--out", type=Path, help="folder of study_cost.png")
    options = parser.parse_args()
    keep_memory()  # as the children of a run do
    timed(catalogue, "marched", "march")
    for name in ("observe", "run_error", "validity"):
        timed(TransverseModel, name, "signals")
    rows: Costs = {}
    print("| spans | method | ms a design | march | signals | metrics | model | steps | worst ledger "
          "| status | 2000 designs on 2 cores, s |\n" + "|---" * 11 + "|")  # fmt: skip
    for n in options.spans:
        for way in WAYS:
            r = rows[n, way] = costs(options.designs, n, way)
            shown = " | ".join(f"{r[k]:.1f}" for k in ("total", "march", "signals", "metrics", "model"))
            print(f"| {n} | {label_of(way)} | {shown} | {r['steps']} | {r['worst']:.1e} | {r['status']} "
                  f"| {r['total']:.0f} |", flush=True)  # fmt: skip
    true, spread = ensembles(options.judged, options.finest, WAYS[1], options.members)
    print()
    for name, values, each in zip(("Delta", "Gamma"), true, spread, strict=True):
        print(f"{options.finest} spans: {name} of {options.judged} designs {values.mean():.4f}, their deviation "
              f"{values.std(ddof=1):.4f}, that of {options.members} members {each.mean():.4f}")  # fmt: skip
    print("\n| spans | method | error of Delta, rms | largest | mean | deviation of members | error of Gamma, rms "
          "| deviation of members |\n" + "|---" * 8 + "|")  # fmt: skip
    errors: Errors = {}
    for n in options.spans:
        for way in WAYS[1:]:
            mean, spread = ensembles(options.judged, n, way, options.members)
            off, gamma = mean[0] / true[0] - 1, float(np.sqrt(np.mean((mean[1] - true[1]) ** 2)))
            errors[n, way] = float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())
            print(f"| {n} | {label_of(way)} | {errors[n, way][0]:.3f} | {errors[n, way][1]:.3f} | {off.mean():+.3f} "
                  f"| {spread[0].mean():.4f} | {gamma:.3f} | {spread[1].mean():.3f} |", flush=True)  # fmt: skip
    if options.out:
        draw(rows, errors, options.out / "study_cost.png")


if __name__ == "__main__":
    main()
