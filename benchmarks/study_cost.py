"""What limits the study of paper 003: where the processor time of a design goes, over meshes of the `transverse` line.

    OMP_NUM_THREADS=1 python benchmarks/study_cost.py [--designs 16] [--spans 20 32 60] [--out figures]

Designs of configs/bnes_study.yaml, 5 s each, one process, one core. `march` is the time loop with its ledger; `model`
what makes a model of a scene and its start; `signals` what makes signals of states, and checks them; `metrics` their
reduction. Beside the total, what 2000 designs would take on two cores that do nothing else, and how far Delta of Table
1's sinks (mean of the ensemble) is from the finest mesh's.
"""

from __future__ import annotations

import argparse
import math
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
from sweep.metrics import Summary, compute, summarise
from sweep.space import baseline_scene, design_scene, designs

WAYS = (("tsit5", 2e-3), ("srkn4", 2e-3))
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


def ask_of(n: int, method: str, interval: float) -> Ask:
    return Ask(duration=5.0, segments=n, model="transverse", method=method, interval=interval)


def base_of(ask: Ask) -> Summary | None:
    scene = baseline_scene(STUDY.scene, "locked")
    return summarise(solve(scene, ask), scene, STUDY.settings)


def costs(count: int, n: int, method: str, interval: float) -> dict[str, Any]:
    """Mean milliseconds of a design by part, its steps, the worst ledger, statuses."""
    scenes = [design_scene(STUDY, values) for values in designs(STUDY, count)]
    ask, total, steps, worst, status = ask_of(n, method, interval), 0.0, 0, 0.0, Counter[str]()
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


def delta(n: int, members: int) -> tuple[float, float]:
    """Mean and standard error of Table 1's Delta against locked masses."""
    ask = ask_of(n, *WAYS[1])
    base, found = base_of(ask), []
    for seed in range(members):
        run = solve(STUDY.scene, replace(ask, perturbation=MEMBER, seed=seed))
        row = compute(summarise(run, STUDY.scene, STUDY.settings), base, len(STUDY.scene.devices))
        found.append(row["delta"])
    return float(np.mean(found)), float(np.std(found, ddof=1)) / math.sqrt(members)


Rows = list[tuple[int, str, float, dict[str, Any]]]  # spans, method, output grid [s], costs


def draw(rows: Rows, deltas: dict[int, tuple[float, float]], path: Path) -> None:
    import matplotlib
    from matplotlib.figure import Figure

    from sweep.labels import BASE, BEST, DESIGN, FAIR, SKY, STYLE

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        cost, error = figure.subplots(1, 2)
        bottom, x = np.zeros(len(rows)), np.arange(len(rows))
        for name, colour in (("march", DESIGN), ("signals", FAIR), ("metrics", BEST), ("model", SKY)):
            height = np.array([row[name] for *_, row in rows])
            cost.bar(x, height, 0.7, bottom=bottom, color=colour, label=name)
            bottom += height
        cost.axhline(60.0, color="k", lw=0.8)
        cost.annotate("60 s for 2000 designs on two cores", (-0.4, 60), xytext=(-0.4, 0.55 * bottom.max()), fontsize=8,
                      arrowprops={"arrowstyle": "-", "color": "0.4"})  # fmt: skip
        cost.set_xticks(x, [f"{n}\n{method}\n{1e3 * dt:g} ms" for n, method, dt, _ in rows])
        cost.set(ylabel="processor time of a design [ms]")
        cost.set_title("a  by spans, method, output grid")
        cost.legend(loc="upper left")
        n = sorted(deltas)
        mean, width = np.array([deltas[k] for k in n]).T
        error.errorbar(n, mean, width, color=DESIGN, marker="o", capsize=3)
        error.axhspan(0.95 * mean[-1], 1.05 * mean[-1], color=BASE, alpha=0.25, lw=0)
        error.set(xlabel="spans [-]", ylabel="Δ of Table 1 against locked masses [-]")
        error.set_title("b  mean, standard error; band: 5 % about the finest")
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", type=int, default=16)
    parser.add_argument("--spans", type=int, nargs="+", default=[20, 32, 60])
    parser.add_argument("--members", type=int, default=8)
    parser.add_argument("--finest", type=int, default=120, help="spans that Delta is compared with")
    parser.add_argument("--out", type=Path, help="folder of study_cost.png")
    options = parser.parse_args()
    timed(catalogue, "marched", "march")
    for name in ("observe", "run_error", "validity"):
        timed(TransverseModel, name, "signals")
    rows = []
    print("| spans | method | output grid | ms a design | march | signals | metrics | model | steps | worst ledger "
          "| status | 2000 designs on 2 cores, s |\n" + "|---" * 12 + "|")  # fmt: skip
    for n in options.spans:
        for method, interval in WAYS:
            r = costs(options.designs, n, method, interval)
            rows.append((n, method, interval, r))
            shown = " | ".join(f"{r[k]:.1f}" for k in ("total", "march", "signals", "metrics", "model"))
            print(f"| {n} | {method} | {1e3 * interval:g} ms | {shown} | {r['steps']} | {r['worst']:.1e} "
                  f"| {r['status']} | {r['total']:.0f} |", flush=True)  # fmt: skip
    print("\n| spans | Delta | standard error |\n|---|---|---|")
    deltas = {}
    for n in sorted({*options.spans, options.finest}):
        deltas[n] = delta(n, options.members)
        print(f"| {n} | {deltas[n][0]:.4f} | {deltas[n][1]:.4f} |", flush=True)
    if options.out:
        draw(rows, deltas, options.out / "study_cost.png")


if __name__ == "__main__":
    main()
