"""Does `auto` meet the accuracy asked, and at what price? Every regular scene, against a converged run of its own.

    python benchmarks/regular.py [--only NAME ...] [--out DIR]

A scene is regular where waveforms converge; it says so in its head, `# Regular: 60 s, accuracies to 1e-4.`: how long it
is run, and the tightest accuracy that is worth its seconds here. For each of 1e-2, 1e-3, 1e-4 down to that one: what
`auto` chose by its pilots, the error that it estimated and the true one (rms of the transverse response, relative,
against a converged run that a coarser mesh, a looser tolerance and another method check), the processor seconds of the
chosen run and of the pilots, and the cheapest trusted combination of line, method, mesh and tolerance that meets the
accuracy among those of `sweep chart` (lines of the rod family left out: they are dearer; no run longer than what `auto`
took). Both are timed alike, as runs with everything given, the least of three, without those that check a loose
tolerance (pilots have made them); of the chart the six whose march took the fewest seconds.
"""

from __future__ import annotations

import argparse
import math
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from solvers import METHODS, MODELS, Ask, Response, catalogue, pilot, solve
from sweep import chart

ROOT = Path(__file__).parents[1] / "configs"
MARK = re.compile(r"^# Regular: ([\d.]+) s, accuracies to (1e-\d)\.", re.MULTILINE)
ACCURACIES = (1e-2, 1e-3, 1e-4)
MARGIN = 3.0  # the reference is asked for the tightest accuracy over this
BAR = 2.0  # times the cheapest
CANDIDATES = 6  # of the chart that are timed again


class Regular(NamedTuple):
    """A scene that says that it is regular."""

    path: Path
    duration: float
    tightest: float


def regular() -> list[Regular]:
    """Scenes, and studies of one, with the mark."""
    found = []
    for path in sorted([*(ROOT / "scenes").glob("*.yaml"), ROOT / "plain_cable.yaml"]):
        mark = MARK.search(path.read_text(encoding="utf-8"))
        if mark:
            found.append(Regular(path, float(mark[1]), float(mark[2])))
    return found


def as_chosen(ask: Ask, run: Response) -> Ask:
    """What pilots chose, asked for by name."""
    tolerance = run.tolerance if math.isfinite(run.tolerance) and ask.duration > 0 else None
    method = run.method if ask.duration > 0 else "auto"
    return replace(ask, model=run.model, method=method, segments=run.segments, tolerance=tolerance)


def seconds_of(case: chart.Case, ask: Ask) -> float:
    """Least processor time of three runs, or of one that is long."""
    best = math.inf
    choice = catalogue.cheapest(case.scene, ask)
    for _ in range(3):
        begun = time.process_time()
        catalogue.run(case.scene, ask, choice, False)
        best = min(best, time.process_time() - begun)
        if best > 5:
            break
    return best


def as_charted(ask: Ask, row: pd.Series) -> Ask:
    """What a row of the chart was asked."""
    ask = replace(ask, model=row["model"], method=row["method"], segments=int(row["segments"]), accuracy=0.05)
    if not math.isfinite(row["knob"]):
        return ask
    return replace(ask, tolerance=row["knob"]) if METHODS[row["method"]].adaptive else replace(ask, step=row["knob"])


def measure(scene: Regular) -> tuple[list[dict[str, Any]], pd.DataFrame]:
    """A row for each accuracy, and the chart's runs."""
    case = chart.load_case(scene.path, scene.duration)
    if scene.duration > 0:
        case = replace(case, ask=replace(case.ask, interval=scene.duration / 600))
    models = [name for name in chart.able(case) if not MODELS[name].constrained] or chart.able(case)
    truth = chart.reference(case, models, scene.tightest / MARGIN, lambda text: print(f"  {text}", flush=True))
    rows = []
    for accuracy in (a for a in ACCURACIES if a >= 0.99 * scene.tightest):
        ask = replace(case.ask, accuracy=accuracy)
        begun = time.process_time()
        run = solve(case.scene, ask)
        piloting = time.process_time() - begun
        rows.append({
            "scene": scene.path.stem, "accuracy": accuracy, "status": run.status.name,
            "choice": f"{run.model}, {run.method}, {run.segments}, {run.tolerance:.0e}",
            "estimated": run.estimated_error, "true": pilot.gap(run, truth.response), "reference": truth.uncertainty,
            "seconds": seconds_of(case, replace(as_chosen(ask, run), accuracy=0.05)), "piloting": piloting,
        })  # fmt: skip
        print(f"  {rows[-1]}", flush=True)
    longest = 3 * max(row["seconds"] for row in rows)
    table = pd.DataFrame(list(chart.scan(case, truth, models, longest)))
    good = table[(table["status"] == "OK") & (table["program"] == chart.OURS)]
    timed: dict[Any, float] = {}
    what = "march_seconds" if scene.duration > 0 else "seconds"
    for row in rows:
        able = good[good["error"] <= row["accuracy"]].nsmallest(CANDIDATES, what)
        if able.empty:
            row |= {"cheapest": "none found", "least": math.nan, "ratio": math.nan}
            continue
        timed |= {k: seconds_of(case, as_charted(case.ask, able.loc[k])) for k in able.index if k not in timed}
        which = min(able.index, key=timed.__getitem__)
        best = able.loc[which]
        knob = f", {best['knob']:.0e}" if math.isfinite(best["knob"]) else ""
        row |= {
            "cheapest": f"{best['model']}, {best['method']}, {best['segments']}{knob}", "least": timed[which],
            "ratio": row["seconds"] / timed[which],
        }  # fmt: skip
    return rows, table


def printed(rows: list[dict[str, Any]]) -> None:
    """Markdown."""
    print("| scene | asked | auto: line, method, segments, tolerance | status | estimated | true | reference good to "
          "| s | cheapest of the chart | s | times it | pilots, s |")  # fmt: skip
    print("|---" * 12 + "|")
    for r in rows:
        print(f"| {r['scene']} | {r['accuracy']:.0e} | {r['choice']} | {r['status']} | {r['estimated']:.1e} "
              f"| {r['true']:.1e} | {r['reference']:.0e} | {r['seconds']:.3f} | {r['cheapest']} | {r['least']:.3f} "
              f"| {r['ratio']:.2f} | {r['piloting']:.1f} |")  # fmt: skip
    met = [r for r in rows if r["true"] <= r["accuracy"] + r["reference"]]
    near = [r for r in rows if not r["ratio"] > BAR]
    print(f"\n{len(met)} of {len(rows)} meet the accuracy; {len(near)} of {len(rows)} cost at most {BAR:g} times the "
          "cheapest of the chart.")  # fmt: skip


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """True and estimated error over the accuracy asked, and seconds beside the cheapest."""
    import matplotlib
    from matplotlib.figure import Figure

    from sweep.labels import BASE, BEST, DESIGN, FAIR, PINK, SKY, STYLE, YELLOW

    names = list(dict.fromkeys(r["scene"] for r in rows))
    looks = dict(zip(names, zip((DESIGN, BEST, FAIR, YELLOW, PINK, SKY, BASE), "osD^vP*", strict=False), strict=False))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.8), layout="constrained")
        error, cost = figure.subplots(1, 2)
        for name, (colour, marker) in looks.items():
            mine = [r for r in rows if r["scene"] == name]
            x = [r["accuracy"] for r in mine]
            error.plot(x, [r["true"] for r in mine], color=colour, marker=marker, label=name)
            error.plot(x, [r["estimated"] for r in mine], color=colour, marker=marker, mfc="none", ls=":")
            cost.plot(x, [r["ratio"] for r in mine], color=colour, marker=marker)
        span = [0.7 * min(ACCURACIES), 1.4 * max(ACCURACIES)]
        error.plot(span, span, color="k", lw=0.8)
        cost.axhline(BAR, color="k", lw=0.8)
        error.set(xscale="log", yscale="log", xlabel="accuracy asked [-]", ylabel="relative error [-]")
        error.set_title("a  true (full) and estimated (hollow)")
        cost.set(xscale="log", xlabel="accuracy asked [-]", ylabel="seconds over the cheapest [-]", ylim=(0, None))
        cost.set_title("b  cost beside the cheapest of the chart")
        figure.legend(loc="outside lower center", ncols=6)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[], help="scenes, by the names of their files")
    parser.add_argument("--out", type=Path, help="folder of regular.png, regular.csv and a chart of each scene")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for scene in regular():
        if options.only and scene.path.stem not in options.only:
            continue
        print(f"{scene.path.stem}, {scene.duration:g} s", flush=True)
        found, table = measure(scene)
        rows += found
        if options.out:
            options.out.mkdir(parents=True, exist_ok=True)
            table.to_csv(options.out / f"{scene.path.stem}.csv", index=False)
    print()
    printed(rows)
    if options.out:
        pd.DataFrame(rows).to_csv(options.out / "regular.csv", index=False)
        draw(rows, options.out / "regular.png")


if __name__ == "__main__":
    main()
