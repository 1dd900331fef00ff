"""Bistable sinks, cubic sinks, tuned dampers, locked masses and nothing, in one table over pulse, seas and fouling.

    python benchmarks/devices.py [--segments 80] [--seas 6] [--fouled 1] [--repeats 4]
        [--keep FILE] [--csv FILE]

Masses and places are Table 1's for all: 4, 3, 4 and 4 kg, on rigid rods of 0.998 m as the paper mounts its sinks, and
at points. Environments: the paper's pulse (3.4) on the clean cable; `--seas` random seas on the clean cable
(configs/robust_stochastic.yaml); nine states of fouling (configs/biofouling.yaml) with `--fouled` seas each.

The dampers are tuned to the nominal cable: its linear modes (tangent at rest, locked masses at points, added mass
included) are fitted to the bare cable's motion after the pulse; the mode with the largest share of the integral of x^2
is the dominant one, and Den Hartog's rules for all four masses on that mode (mass ratio from its shape) give frequency
and damping. From there frequency and damping are searched on a grid for the least RMS displacement, mean of the pulse
and of a sea of their own (seed 101) on the clean cable. All four dampers share frequency and damping ratio.

Tables: the modes and the tuning; reduction of RMS displacement from 0.5 s on, of the whole cable and at the paper's
node 5, against the masses locked at points and against the bare cable in the same environment, mean ± standard
deviation over environments (of the pulse: over runs whose start velocities differ by 1e-9 m/s; what has no impacts is
not repeated), and the worst environment; Delta; each state of fouling; what detuning costs the dampers on the clean
cable. Runs are kept in `--keep` and not made again. Untrusted runs are left out, and the tables say how many.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh

from solvers import BNES, TMD, Ask, CubicNES, PointMass, Response, Scene, Status
from solvers.brink import tangent_at_rest
from solvers.catalogue import MODELS, static_state
from sweep.config import MetricSettings, load_study
from sweep.evaluate import run_trusted
from sweep.fields import bind
from sweep.metrics import NAN, Summary, along, summarise, transverse
from sweep.space import design_scene, point_key

CONFIGS = Path(__file__).parents[1] / "configs"
SEED = "end_b.motion.stochastic.seed"
PERTURBATION = 1e-9  # of the start velocities [m/s]
OWN_SEAS = (101,)  # seeds of the seas that the dampers are tuned in; the table's are 1, 2, ...
MODES = 8
FACTORS = (0.05, 0.13, 0.25, 0.4, 0.6, 0.8, 1.0, 1.2, 1.5)  # of Den Hartog's frequency, searched
RATIOS = (0.1, 0.4)  # damping ratios, searched beside Den Hartog's
DETUNED = (0.7, 0.85, 1.0, 1.15, 1.4)  # of the tuned frequency
MOUNTS = ("points", "rods")


class Case(NamedTuple):
    """An environment: the scene without devices, and what group of the table it belongs to."""

    name: str
    group: str  # pulse, seas, fouled
    scene: Scene


class Row(NamedTuple):
    """What one run gave."""

    status: str
    rms: float  # over the cable, from 0.5 s on [m]
    v2: float  # integral of m v^2 [J s]
    probe: float  # RMS at the probe [m]


# --------------------------------------------------------------------------------------------- runs


class Runner:
    """Runs, each distinct scene once, kept in a file."""

    def __init__(self, ask: Ask, settings: MetricSettings, keep: Path | None) -> None:
        self.ask, self.settings, self.keep = ask, settings.single, keep
        self.known: dict[str, Row] = {}
        self.count = 0
        if keep is not None and keep.is_file():
            self.known = {key: Row(*row) for key, row in map(json.loads, keep.read_text().splitlines())}

    def __call__(self, scene: Scene, seed: int = 0) -> Row:
        ask = replace(self.ask, perturbation=PERTURBATION if seed else 0.0, seed=seed)
        key = point_key(scene, ask, self.settings)
        if key not in self.known:
            response = run_trusted(scene, ask).response
            curves = summarise(response, scene, self.settings, scene.cable)
            self.known[key] = self.row(response, curves)
            self.count += 1
            if self.keep is not None:
                with self.keep.open("a") as file:
                    file.write(json.dumps([key, self.known[key]]) + "\n")
        return self.known[key]

    def row(self, response: Response, curves: Summary | None) -> Row:
        if curves is None or response.status != Status.OK:
            return Row(response.status.name, NAN, NAN, NAN)
        rms = curves.rms(curves.x2) / math.sqrt(curves.length)
        return Row("OK", rms, curves.integral(curves.v2), curves.rms(curves.probe2))


# --------------------------------------------------------------------------------------------- devices


def sinks(kind: str) -> tuple[Any, ...]:
    """Table 1's bistable or Table 2's cubic sinks, as the configs have them."""
    return load_study(CONFIGS / {"bnes": "bnes_optimum.yaml", "nes": "nes_plain.yaml"}[kind]).scene.devices


def locked() -> tuple[PointMass, ...]:
    return tuple(PointMass(kind="locked", s=device.s, mass=device.mass) for device in sinks("bnes"))


def dampers(frequency: float, ratio: float) -> tuple[TMD, ...]:
    """Dampers of this frequency [Hz] and damping ratio in place of the locked masses."""
    omega = 2 * math.pi * frequency
    return tuple(TMD(s=d.s, mass=d.mass, k=d.mass * omega**2, c=2 * ratio * d.mass * omega) for d in locked())


def mounted(devices: Sequence[Any], mount: str) -> tuple[Any, ...]:
    """The devices at points, or on the rods of Table 1's sinks; sinks keep their own rods."""
    if mount == "points":
        return tuple(replace(device, rod=None) for device in devices)
    rods = [device.rod_length for device in sinks("bnes")]
    keeps = (BNES, CubicNES)
    return tuple(d if isinstance(d, keeps) else replace(d, rod=rod) for d, rod in zip(devices, rods, strict=True))


# --------------------------------------------------------------------------------------------- environments


def cases(seas: int, fouled: int) -> Iterator[Case]:
    pulse = load_study(CONFIGS / "bnes_optimum.yaml").scene
    yield Case("pulse (3.4)", "pulse", replace(pulse, devices=()))
    yield from sea(range(1, seas + 1))
    study = load_study(CONFIGS / "biofouling.yaml")
    for e, environment in enumerate(study.environments):
        for seed in range(1, fouled + 1) if environment.set else ():
            scene = bind(design_scene(study, {}, e), {SEED: seed})
            yield Case(f"{environment.name}, seed {seed}", "fouled", replace(scene, devices=()))


def sea(seeds: Sequence[int]) -> Iterator[Case]:
    scene = replace(load_study(CONFIGS / "robust_stochastic.yaml").scene, devices=())
    for seed in seeds:
        yield Case(f"sea, seed {seed}", "seas", bind(scene, {SEED: seed}))


# --------------------------------------------------------------------------------------------- tuning


class Tuning(NamedTuple):
    """Modes of the nominal cable, and the dampers that they ask for."""

    frequencies: np.ndarray  # (MODES,) [Hz]
    shares: np.ndarray  # (MODES,) of the integral of x^2 after the pulse
    mode: int  # the dominant one
    ratio: float  # mass of the dampers at its shape over its modal mass
    frequency: float  # Den Hartog's [Hz]
    damping: float  # Den Hartog's ratio


def tune(scene: Scene, ask: Ask) -> Tuning:
    """The dominant mode of the bare cable after the pulse, and Den Hartog's damper for it."""
    model = MODELS["lumped"].build(replace(scene, devices=locked()), ask.segments or 80)
    status, q, note = static_state(model)
    assert status == Status.OK, note
    across = np.setdiff1d(model.pack.at, model.pack.fixed)  # the first coordinate of each node is across the cable
    K, M = (tangent_at_rest(model.pack, q, *weights)[np.ix_(across, across)] for weights in ((1, 0, 0), (0, 0, 1)))
    squares, shapes = eigh(K, M, subset_by_index=[0, MODES - 1])
    run = run_trusted(scene, ask).response
    arc, x = run.signals["arc"], transverse(run)[run.t >= 0.5, :, 0]
    inner = np.interp(arc, np.linspace(arc[0], arc[-1], len(across) + 2)[1:-1], np.arange(len(across)))
    basis = np.array([np.interp(inner, np.arange(len(across)), shape) for shape in shapes.T])
    basis[:, [0, -1]] = 0.0
    steps = np.gradient(arc)
    gram = (basis * steps) @ basis.T
    q = np.linalg.solve(gram, (basis * steps) @ x.T)  # (MODES, nt) amplitudes, least squares
    whole = float(along(transverse(run)[run.t >= 0.5], np.diff(arc), run.signals["rigid"] > 0.5).sum())
    shares = (q**2).sum(axis=1) * np.diag(gram) / whole
    mode = int(shares.argmax())
    heights = np.interp([d.s for d in locked()], arc, basis[mode])
    mu = float(sum(d.mass * h**2 for d, h in zip(locked(), heights, strict=True)))  # modal mass is 1
    own = 1 - mu  # modal mass without the locked masses, which the dampers take the place of
    mu = mu / own
    frequency = float(np.sqrt(squares[mode] / own)) / (2 * math.pi) / (1 + mu)
    damping = math.sqrt(3 * mu / (8 * (1 + mu) ** 3))
    return Tuning(np.sqrt(squares) / (2 * math.pi), shares, mode, mu, frequency, damping)


def search(run: Runner, pulse: Case, tuning: Tuning) -> list[tuple[float, float, float]]:
    """Mean of RMS over the bare cable's, frequency [Hz] and damping ratio of all dampers that were tried."""
    training = [pulse, *sea(OWN_SEAS)]
    bare = [run(case.scene).rms for case in training]
    tried = []
    for frequency in [tuning.frequency * factor for factor in FACTORS]:
        for ratio in sorted({*RATIOS, round(tuning.damping, 4)}):
            rows = [run(replace(case.scene, devices=dampers(frequency, ratio))) for case in training]
            tried.append((float(np.mean([row.rms / b for row, b in zip(rows, bare, strict=True)])), frequency, ratio))
    return tried


# --------------------------------------------------------------------------------------------- tables


class Study(NamedTuple):
    """All runs of the tables."""

    cases: list[Case]
    designs: list[tuple[str, str, tuple[Any, ...]]]  # name, mount, devices
    rows: dict[tuple[str, str], dict[str, Row]]  # by design, by case
    again: dict[tuple[str, str], list[Row]]  # perturbed repeats of the pulse
    groups: dict[str, str]  # of the cases, with their title

    def reductions(self, who: tuple[str, str], whom: tuple[str, str], cases: Sequence[Case], field: str) -> list[float]:
        """1 less the ratio of a field of two designs, case by case."""
        ours, theirs = self.rows[who], self.rows[whom]
        return [1 - getattr(ours[case.name], field) / getattr(theirs[case.name], field) for case in cases]

    def of(self, group: str) -> list[Case]:
        return [case for case in self.cases if case.group == group]


def percent(values: Sequence[float], again: Sequence[float] = ()) -> str:
    """Mean ± standard deviation in percent (of one value: over its repeats), and how many are missing."""
    good = np.array([v for v in values if math.isfinite(v)])
    if not good.size:
        return "none"
    many = good if good.size > 1 else np.array([*good, *again])
    text = f"{100 * good.mean():.1f}" + (f" ± {100 * many.std(ddof=1):.1f}" if many.size > 1 else "")
    return text if good.size == len(values) else f"{text} ({good.size} of {len(values)})"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print()


POINTS, BARE = ("locked masses", "points"), ("nothing", "-")


def show_tuning(tuning: Tuning, tried: list[tuple[float, float, float]], segments: int) -> None:
    least, frequency, ratio = min(one for one in tried if math.isfinite(one[0]))
    print(f"N = {segments}. Modes with locked masses, their shares in the bare cable's x2 after the pulse\n")
    table(["mode", *map(str, range(1, MODES + 1))], [
        ["Hz", *(f"{f:.3f}" for f in tuning.frequencies)], ["share", *(f"{s:.1%}" for s in tuning.shares)],
    ])  # fmt: skip
    print(f"Dominant: mode {tuning.mode + 1}; the dampers are {tuning.ratio:.1%} of its modal mass. Den Hartog: "
          f"{tuning.frequency:.3f} Hz, damping ratio {tuning.damping:.3f}. Best of {len(tried)} searched: "
          f"{frequency:.3f} Hz, {ratio:.3f}; RMS in the training environments {least:.3f} of the bare cable's.\n")
    heads = sorted({ratio for _, _, ratio in tried})
    by = {(f, r): value for value, f, r in tried}
    print("RMS in the training environments over the bare cable's, by frequency and damping ratio\n")
    table(["Hz", *(f"{ratio:.3f}" for ratio in heads)],
          [[f"{f:.2f}", *(f"{by[f, r]:.3f}" for r in heads)] for f in sorted({f for _, f, _ in tried})])  # fmt: skip


def show_all(study: Study, field: str, what: str) -> None:
    """Every design against locked masses and the bare cable."""
    print(f"Reduction of {what}, %: mean ± standard deviation over environments (pulse: over perturbed repeats)\n")
    rows = []
    for name, mount, _ in study.designs:
        who, cells = (name, mount), []
        for whom in (POINTS, BARE):
            for group in study.groups:
                cases = study.of(group)
                base = getattr(study.rows[whom][cases[0].name], field)
                again = [1 - getattr(row, field) / base for row in study.again[who]] if len(cases) == 1 else []
                cells.append(percent(study.reductions(who, whom, cases, field), again))
        worst = min(study.reductions(who, POINTS, study.of("seas") + study.of("fouled"), field))
        rows.append([name, mount, *cells, f"{100 * worst:.1f}"])
    heads = [f"{whom}: {title}" for whom in ("locked", "bare") for title in study.groups.values()]
    table(["devices", "mount", *heads, "locked: worst"], rows)


def show_motion(study: Study) -> None:
    """Delta, eq. (3.1) with the velocity squared, against locked masses at points."""
    print("Delta against locked masses at points: mean ± standard deviation over environments; less is better\n")
    rows = []
    for name, mount, _ in study.designs:
        cells = []
        for group in study.groups:
            values = 1 - np.array(study.reductions((name, mount), POINTS, study.of(group), "v2"))
            cells.append(f"{values.mean():.3f}" + (f" ± {values.std(ddof=1):.3f}" if len(values) > 1 else ""))
        rows.append([name, mount, *cells])
    table(["devices", "mount", *study.groups.values()], rows)


def show_fouling(study: Study) -> None:
    """Every state of growth by itself."""
    print("Reduction of RMS displacement against locked masses in the same environment, %, by state of fouling\n")
    chosen = [(name, mount) for name, mount, devices in study.designs if devices and (name, mount) != POINTS]
    states = list(dict.fromkeys(case.name.rpartition(",")[0] for case in study.of("fouled")))
    rows = []
    for state in states:
        cases = [case for case in study.of("fouled") if case.name.startswith(f"{state},")]
        rows.append([state, *(percent(study.reductions(who, POINTS, cases, "rms")) for who in chosen)])
    table(["state", *(", ".join(who) for who in chosen)], rows)


def show_detuning(study: Study, run: Runner, frequency: float, ratio: float) -> None:
    """The searched dampers at points, out of tune on the clean cable; fouling detunes them by itself."""
    print("Searched dampers at points, out of tune: reduction of RMS displacement against locked masses, %\n")
    rows = []
    for group in ("pulse", "seas"):
        title, cells = study.groups[group], []
        for factor in DETUNED:
            cases, devices = study.of(group), dampers(frequency * factor, ratio)
            ours = [run(replace(case.scene, devices=devices)).rms for case in cases]
            base = [study.rows[POINTS][case.name].rms for case in cases]
            cells.append(percent([1 - a / b for a, b in zip(ours, base, strict=True)]))
        rows.append([title, *cells])
        print(f"detuning, {title}: done ({run.count} new runs)", file=sys.stderr, flush=True)
    table(["environments", *(f"{frequency * factor:.2f} Hz (x {factor:g})" for factor in DETUNED)], rows)


def everything(run: Runner, cases: list[Case], kinds: Sequence[tuple[str, tuple[Any, ...]]], repeats: int) -> Study:
    designs = [(name, mount, mounted(devices, mount) if devices else ())
               for name, devices in kinds for mount in (MOUNTS if devices else ("-",))]  # fmt: skip
    study = Study(cases, designs, {}, {}, {
        "pulse": "pulse",
        "seas": f"{sum(case.group == 'seas' for case in cases)} clean seas",
        "fouled": f"{sum(case.group == 'fouled' for case in cases)} fouled seas",
    })  # fmt: skip
    for name, mount, devices in designs:
        study.rows[name, mount] = {case.name: run(replace(case.scene, devices=devices)) for case in cases}
        hits = repeats if any(isinstance(device, BNES | CubicNES) for device in devices) else 0
        study.again[name, mount] = [run(replace(cases[0].scene, devices=devices), k + 1) for k in range(hits)]
        print(f"{name}, {mount}: done ({run.count} new runs)", file=sys.stderr, flush=True)
    return study


def write(study: Study, path: Path) -> None:
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["devices", "mount", "environment", *Row._fields])
        for (name, mount), rows in study.rows.items():
            for case, row in rows.items():
                out.writerow([name, mount, case, *row])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--segments", type=int, default=80)
    parser.add_argument("--seas", type=int, default=6, help="random seas on the clean cable")
    parser.add_argument("--fouled", type=int, default=1, help="random seas for each state of fouling")
    parser.add_argument("--repeats", type=int, default=4, help="perturbed runs of each design in the pulse")
    parser.add_argument("--keep", type=Path, help="file of runs, written and read")
    parser.add_argument("--csv", type=Path, help="write every run of the tables to this file")
    options = parser.parse_args()
    optimum = load_study(CONFIGS / "bnes_optimum.yaml")
    run = Runner(replace(optimum.ask, segments=options.segments), optimum.settings, options.keep)
    chosen = list(cases(options.seas, options.fouled))
    tuning = tune(chosen[0].scene, run.ask)
    tried = search(run, chosen[0], tuning)
    _, frequency, ratio = min(one for one in tried if math.isfinite(one[0]))
    kinds: list[tuple[str, tuple[Any, ...]]] = [
        ("nothing", ()),
        ("locked masses", locked()),
        ("bistable sinks", sinks("bnes")),
        ("cubic sinks", sinks("nes")),
        ("dampers, Den Hartog", dampers(tuning.frequency, tuning.damping)),
        ("dampers, searched", dampers(frequency, ratio)),
    ]
    study = everything(run, chosen, kinds, options.repeats)
    show_tuning(tuning, tried, options.segments)
    show_all(study, "rms", "RMS displacement over the whole cable from 0.5 s on")
    show_all(study, "probe", "RMS displacement at the paper's node 5 from 0.5 s on")
    show_motion(study)
    show_fouling(study)
    show_detuning(study, run, frequency, ratio)
    statuses = [row.status for rows in study.rows.values() for row in rows.values()]
    print(f"{statuses.count('OK')} of {len(statuses)} runs of the tables are trusted.")
    if options.csv:
        write(study, options.csv)


if __name__ == "__main__":
    main()
