"""Error against cost: every line and method that can do a scene, over meshes and steps or tolerances.

All runs are measured against one reference, which a coarser mesh, a looser tolerance and another method check. The
meshes at the finest knob show the error in space, the knobs on the finest mesh the error in time, and the lower
envelope of the trusted runs what is worth its seconds. Other programs that are installed run beside ours.

Where the reference does not converge (chaos), no waveform is compared: each row is an ensemble of runs whose starts
differ by some 1e-9 m/s, its error the largest relative difference of the objectives' means from those of the
reference's ensemble, and `standard_error` what the sizes of both ensembles leave open of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from solvers import METHODS, MODELS, Ask, CannotRepresent, Feature, Response, Scene, Status, impacts, pilot, solve
from solvers.catalogue import can_march, can_settle, needs

from . import peers
from .config import METRICS, ConfigError, MetricSettings, load_scene, load_study, read_yaml
from .metrics import Summary, compute, summarise
from .mistakes import ABSENT, Mistake
from .space import baseline_scene, designs, make_point
from .store import write_whole

NAN = float("nan")
UNCERTAINTY = 1e-3  # wanted of the reference
TOLERANCES = (100.0, 10.0, 1.0, 0.1)  # times a method's default
STEPS = 6  # each half the last, the first a twelfth of the shortest period of the motion
MESHES = 9  # at most, each sqrt(2) times as fine as the last
COARSEST = 10  # segments
AGAIN = 0.5  # shorter runs are timed twice more, and the fastest one counts [s]
LONGEST = 20.0  # a run may take, by the last mesh's or knob's seconds [s]
ENSEMBLE = 8  # perturbed runs where waveforms do not converge
CHAOTIC_MESH = 0.01  # where devices strike no pilots run: what the reference's mesh leaves of the shortest wave's phase
OURS, UNCHECKED = "cable-sweep", "UNCHECKED"  # a program; the status of others, which keep no ledger
USUAL = ("rms", "peak_tension_top")  # objectives of a scene without a study
Say = Callable[[str], object]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One scene and what is asked of it."""

    name: str
    scene: Scene
    ask: Ask  # model, method, mesh and knobs are free
    settings: MetricSettings
    objectives: tuple[str, ...] = USUAL  # what is compared where the response is chaotic


def load_case(path: str | Path, duration: float | None = None) -> Case:
    """A study's first design, or a scene alone with a `duration` [s]; ConfigError lists every mistake."""
    path = Path(path)
    raw, mistakes = read_yaml(path)
    if raw is ABSENT:
        raise ConfigError(mistakes, str(path))
    if isinstance(raw, dict) and "scene" in raw:
        study = load_study(path)
        point = make_point(study, 0, 0, designs(study, 1)[0])
        length = point.ask.duration if duration is None else duration
        ask = replace(
            point.ask, segments=None, model="auto", method="auto", step=None, tolerance=None, checked_tolerance=None,
            mass_scaling=None, duration=length,
        )  # fmt: skip
        stems = dict.fromkeys(name.removesuffix("_mean").removesuffix("_worst") for name in study.objectives)
        return Case(
            name=study.name or path.stem, scene=point.scene, settings=point.settings, ask=ask, objectives=tuple(stems)
        )
    scene = load_scene(path)
    if duration is None:
        problem = "a scene alone does not say for how long it is to run"
        raise ConfigError([Mistake("duration", ABSENT, problem, "give --duration in s, or a study")], str(path))
    ask = Ask(duration=duration, interval=duration / 1000 if duration else 1.0)
    return Case(name=path.stem, scene=scene, ask=ask, settings=MetricSettings())


def able(case: Case) -> list[str]:
    """Lines that have what the scene needs."""
    wanted = needs(case.scene, case.ask)
    return [name for name, line in MODELS.items() if not wanted & ~line.features]


def methods_of(case: Case, model: str) -> list[str]:
    """Methods that can march a line, or settle it where the motion is periodic and the window past its ramps."""
    if case.ask.duration <= 0:
        return ["auto"]
    found = [name for name in METHODS if name != "harmonic" and can_march(model, name)]
    settles = can_settle(case.scene, case.ask) and not MODELS[model].constrained
    return [*found, "harmonic"] if settles else found


# --------------------------------------------------------------------------- the reference


class Reference(NamedTuple):
    """The converged run and how far it can be trusted."""

    response: Response
    metrics: dict[str, float]
    base: Summary | None  # of the baseline, for metrics that are ratios
    uncertainty: float  # relative, of the transverse response
    spreads: dict[str, float]  # relative differences of the metrics between the reference and its checks
    how: str
    chaotic: bool
    errors: dict[str, float]  # standard errors of the metrics, means of an ensemble where chaotic; else 0


class Ensemble(NamedTuple):
    """Metrics of runs whose starts differ slightly."""

    means: dict[str, float]
    errors: dict[str, float]  # standard errors of the means
    responses: list[Response]
    seconds: float  # of one run

    @property
    def status(self) -> str:
        """OK where every run is, else that of the first that is not."""
        return next((run.status.name for run in self.responses if not run.trusted), Status.OK.name)


def timed(scene: Scene, ask: Ask) -> tuple[Response, float]:
    """A run and the processor seconds of the whole call, from the scene to the signals."""
    begun = time.process_time()
    response = solve(scene, ask)
    return response, time.process_time() - begun


def ensemble(case: Case, ask: Ask, base: Summary | None) -> Ensemble:
    """Runs with random initial velocities of the case's `perturbation`, and the means of their metrics."""
    size = ENSEMBLE
    runs = [timed(case.scene, replace(ask, perturbation=case.settings.perturbation, seed=k + 1)) for k in range(size)]
    rows = pd.DataFrame([metrics_of(case, run, base) for run, _ in runs])
    means = {str(name): float(x) for name, x in rows.mean(skipna=False).items()}
    errors = {str(name): float(x) for name, x in (rows.std(ddof=1) / math.sqrt(size)).items()}
    return Ensemble(means, errors, [run for run, _ in runs], sum(seconds for _, seconds in runs) / size)


def metrics_of(case: Case, response: Response, base: Summary | None) -> dict[str, float]:
    """Finite metrics of a run."""
    summary = summarise(response, case.scene, case.settings)
    found = compute(summary, base, len(case.scene.devices))
    return {name: value for name, value in found.items() if name in METRICS and math.isfinite(value)}


def apart(found: dict[str, float], truth: dict[str, float]) -> dict[str, float]:
    """Relative differences of metrics; absolute where the truth is zero."""
    return {name: abs(found.get(name, NAN) - x) / (abs(x) or 1.0) for name, x in truth.items()}


def reference(case: Case, models: Sequence[str], wanted: float, say: Say = lambda text: None) -> Reference:
    """Pilots of the line with the highest order find the mesh and tolerance for `wanted`; then the mesh is made half as
    fine again and the tolerance a tenth. A mesh sqrt(2) coarser, the pilots' tolerance and another method check it.

    Raises
    ------
    ConfigError
        Where no line runs to the end.
    """
    large = [name for name in models if Feature.LARGE_MOTION in MODELS[name].features] or list(models)
    model = max(large, key=lambda name: (MODELS[name].order, not MODELS[name].constrained))
    strikes = impacts(case.scene)
    asked = max(wanted, CHAOTIC_MESH) if strikes else wanted
    first = solve(case.scene, replace(case.ask, model=model, accuracy=asked))
    if first.status not in pilot.ENDED:
        problem = f"{model} ended {first.status.name}: {first.message}"
        raise ConfigError([Mistake("scene", ABSENT, problem, "mend the scene or shorten the run")], case.name)
    say(f"pilots of the reference: {first.reason}")
    fine = replace(case.ask, model=model, method=first.method, segments=math.ceil(1.5 * first.segments))
    tolerance = first.tolerance / 10 if math.isfinite(first.tolerance) else None
    best = solve(case.scene, replace(fine, tolerance=tolerance))
    coarse = math.ceil((fine.segments or 2) / math.sqrt(2))
    checks = [(f"{coarse} segments", replace(fine, segments=coarse, tolerance=tolerance))]
    if tolerance is not None:
        checks.append(("ten times the tolerance", replace(fine, tolerance=first.tolerance)))
    for method in methods_of(case, model):
        if METHODS.get(method, METHODS["rk4"]).adaptive and method not in (first.method, "harmonic"):
            checks.append((method, replace(fine, method=method, tolerance=METHODS[method].tolerance / 10)))
    runs = [(what, solve(case.scene, ask)) for what, ask in checks]
    gaps = [pilot.gap(run, best) for _, run in runs]
    base_scene = baseline_scene(case.scene, case.settings.baseline)
    base_run = best if base_scene == case.scene else solve(base_scene, replace(fine, tolerance=tolerance))
    base = summarise(base_run, base_scene, case.settings, case.scene.cable)
    truth = metrics_of(case, best, base)
    spreads = dict.fromkeys(truth, 0.0)
    for _, run in runs:
        spreads = {name: max(spreads[name], x) for name, x in apart(metrics_of(case, run, base), truth).items()}
    how = f"{model}, {best.method}, {best.segments} segments; " + ", ".join(
        f"{what} {found:.1e}" for (what, _), found in zip(runs, gaps, strict=True)
    )
    uncertainty = max(gaps, default=NAN)
    say(f"reference: {how}")
    if not (first.chaotic or not uncertainty < pilot.CHAOTIC):
        return Reference(best, truth, base, uncertainty, spreads, how, False, dict.fromkeys(truth, 0.0))
    say(f"waveforms do not converge: means of {ENSEMBLE} runs are compared")
    many = ensemble(case, replace(fine, tolerance=tolerance), base)
    other = ensemble(case, checks[0][1], base)
    spreads = apart(other.means, many.means)
    how = f"chaotic: {ENSEMBLE} runs by {model}, {best.method}, {best.segments} segments, checked by {checks[0][0]}"
    return Reference(best, many.means, base, uncertainty, spreads, how, True, many.errors)


# --------------------------------------------------------------------------- the runs


def knobs_of(case: Case, method: str) -> list[float]:
    """Tolerances of an adaptive method, steps of a fixed-step one [s], from loose to tight; NaN at rest, and where the
    mesh gives the step."""
    if method not in METHODS or METHODS[method].own_step:
        return [NAN]
    if METHODS[method].adaptive:
        return [factor * METHODS[method].tolerance for factor in TOLERANCES]
    omega = MODELS[able(case)[0]].made(case.scene, COARSEST, case.ask).omega
    longest = 2 * math.pi / omega / 12 if omega > 0 else case.ask.duration / 200
    return [longest / 2**k for k in range(STEPS)]


def lands(method: str) -> bool:
    """Whether the steps of a method are its own to choose, so that they may end at an impact."""
    return method in METHODS and (METHODS[method].adaptive or METHODS[method].own_step)


def scan(
    case: Case, truth: Reference, models: Sequence[str], longest: float = LONGEST, say: Say = lambda text: None
) -> Iterator[dict[str, Any]]:
    """Run everything, a row each. No mesh is refined and no knob turned beyond a run of a third of `longest` [s]."""
    meshes = [round(COARSEST * math.sqrt(2) ** k) for k in range(MESHES)]
    for model in models:
        for method in methods_of(case, model):
            if truth.chaotic and not lands(method):
                continue  # their steps do not land on impacts; nothing but the mean of many would tell
            spent: dict[float, float] = {}  # seconds on the last mesh, by knob
            for segments in meshes:
                slowest = 0.0
                for knob in knobs_of(case, method)[: 3 if truth.chaotic else None]:
                    if max(spent.get(knob, 0.0), slowest) > longest / 3:
                        continue
                    row = one(case, truth, model, method, segments, knob)
                    if row is None:
                        break
                    spent[knob] = slowest = row["seconds"] * (ENSEMBLE if truth.chaotic else 1)
                    yield row
            say(f"{model}, {method}: done")


def one(
    case: Case, truth: Reference, model: str, method: str, segments: int, knob: float
) -> dict[str, Any] | None:
    """The row of a run; None where the line refuses."""
    ask = replace(case.ask, model=model, method=method, segments=segments)
    if math.isfinite(knob):
        ask = replace(ask, tolerance=knob) if METHODS[method].adaptive else replace(ask, step=knob)
    try:
        if truth.chaotic:
            return averaged(case, truth, ask, knob)
        response, seconds = timed(case.scene, ask)
    except CannotRepresent:
        return None
    for _ in range(2 if seconds < AGAIN else 0):
        response, again = timed(case.scene, ask)
        seconds = min(seconds, again)
    return measured(case, truth, OURS, model, method, segments, knob, response, seconds)


def averaged(case: Case, truth: Reference, ask: Ask, knob: float) -> dict[str, Any]:
    """The row of an ensemble: relative differences of means, and the standard errors of those differences."""
    found = ensemble(case, ask, truth.base)
    errors = apart(found.means, truth.metrics)
    sizes = {name: abs(x) or 1.0 for name, x in truth.metrics.items()}
    widths = {
        name: math.hypot(found.errors.get(name, NAN), truth.errors[name]) / sizes[name] for name in truth.metrics
    }
    first = found.responses[0]
    known = [name for name in case.objectives if math.isfinite(errors.get(name, NAN))]
    worst = max(known, key=lambda name: errors[name], default="")
    return {
        "program": OURS, "model": ask.model, "method": first.method or ask.method, "segments": ask.segments,
        "knob": knob, "status": found.status, "seconds": found.seconds, "march_seconds": first.cost.seconds,
        "error": errors.get(worst, NAN), "standard_error": widths.get(worst, NAN), "worst": worst,
        "estimated_error": NAN, "energy_residual": max(run.energy_residual for run in found.responses),
        **{f"error_{name}": x for name, x in errors.items()}, **{f"width_{name}": x for name, x in widths.items()},
    }  # fmt: skip


def measured(
    case: Case, truth: Reference, program: str, model: str, method: str, segments: int, knob: float,
    response: Response, seconds: float,
) -> dict[str, Any]:  # fmt: skip
    """A row: what ran, how it ended, its errors and its cost."""
    errors = apart(metrics_of(case, response, truth.base) if program == OURS else {}, truth.metrics)
    return {
        "program": program, "model": model, "method": response.method or method, "segments": segments, "knob": knob,
        "status": response.status.name, "seconds": seconds, "march_seconds": response.cost.seconds,
        "checking_seconds": response.cost.checking,
        "error": pilot.gap(response, truth.response), "estimated_error": response.estimated_error,
        "energy_residual": response.energy_residual, **{f"error_{name}": x for name, x in errors.items()},
    }  # fmt: skip


def scan_peers(case: Case, truth: Reference, longest: float = LONGEST, say: Say = lambda text: None) -> Iterator[Any]:
    """The rows of other programs, and for each that does not run a sentence why (a string in place of a row)."""
    if truth.chaotic:
        yield "other programs: not run: where waveforms do not converge there is nothing of theirs to compare"
        return
    ask = case.ask
    for program in peers.installed():
        why = peers.unable(case.scene, ask, program)
        if why:
            yield f"{program}: not run: {why}"
            continue
        for segments in (round(COARSEST * math.sqrt(2) ** k) for k in range(MESHES)):
            spent = 0.0
            for step in steps_of(case, program, segments):
                if spent > longest / 3:
                    break
                try:
                    response, seconds = peers.run(program, case.scene, ask, segments, step)
                except peers.PeerFailed as error:
                    say(f"{program}, {segments} segments, step {step:.3g} s: {error}")
                    continue
                spent = max(spent, seconds)
                row = measured(case, truth, program, program, response.method, segments, step, response, seconds)
                yield row | {"status": UNCHECKED}
            if spent > longest / 3:
                break
        say(f"{program}: done")


def steps_of(case: Case, program: str, segments: int) -> list[float]:
    """Steps of another program, whole in an output interval [s]: MoorDyn's largest stable one and half of it, fixed
    steps of an implicit one."""
    interval = case.ask.interval
    if program == "MoorDyn":
        longest = peers.step_of(case.scene, segments, interval)
        return [longest, longest / 2]
    return list(dict.fromkeys(interval / math.ceil(interval / knob) for knob in knobs_of(case, "genalpha")[:4]))


def envelope(table: pd.DataFrame, error: str = "error") -> pd.Series:
    """Which trusted runs no other trusted run of this program beats in both error and seconds."""
    good = (table["status"] == "OK") & np.isfinite(table[error]) & (table["program"] == OURS)
    chosen = pd.Series(False, index=table.index)
    best = math.inf
    for i in table[good].sort_values(["seconds", error]).index:
        if table.at[i, error] < best:
            chosen[i], best = True, table.at[i, error]
    return chosen


def cheapest_for(table: pd.DataFrame, wanted: float) -> pd.Series | None:
    """The cheapest trusted run of this program whose error is at most `wanted`."""
    good = table[(table["status"] == "OK") & (table["error"] <= wanted) & (table["program"] == OURS)]
    return None if good.empty else good.loc[good["seconds"].idxmin()]


# --------------------------------------------------------------------------- the whole chart


def chart(
    case: Case, directory: Path, models: Sequence[str] = (), uncertainty: float = UNCERTAINTY,
    longest: float = LONGEST, say: Say = lambda text: None,
) -> xr.Dataset:  # fmt: skip
    """Reference, runs and envelope of a case: `chart.csv`, `chart.nc` and `chart.png` in `directory`.

    Raises
    ------
    ConfigError
        Where no line can do the scene, or none of the named ones, or no run was made.
    """
    names = [name for name in able(case) if not models or name in models]
    if not names:
        problem = f"none of {', '.join(models) or 'the models'} can represent it"
        raise ConfigError([Mistake("scene", ABSENT, problem, "`sweep models` tells what each can")], case.name)
    truth = reference(case, names, uncertainty, say)
    rows = [*scan(case, truth, names, longest, say), *scan_peers(case, truth, longest, say)]
    notes = [row for row in rows if isinstance(row, str)]
    table = pd.DataFrame([row for row in rows if not isinstance(row, str)])
    if table.empty:
        problem = f"none of {', '.join(names)} could be run within {longest / 3:g} s"
        remedy = "see that it is well posed at rest: `sweep check`"
        raise ConfigError([Mistake("scene", ABSENT, problem, remedy)], case.name)
    table["envelope"] = envelope(table)
    data = xr.Dataset.from_dataframe(table.rename_axis("run"))
    units = {"seconds": "s", "march_seconds": "s", "checking_seconds": "s", "knob": "1 or s"}
    for name in data:
        data[name].attrs["units"] = units.get(str(name), "1")
    data.attrs = {
        "case": case.name, "reference": truth.how, "uncertainty": truth.uncertainty, "chaotic": int(truth.chaotic),
        "peers": "; ".join(notes), "objectives": " ".join(case.objectives),
        "ensemble": ENSEMBLE if truth.chaotic else 1,
    }  # fmt: skip
    for name, value in truth.metrics.items():
        data.attrs[f"reference_{name}"], data.attrs[f"spread_{name}"] = value, truth.spreads[name]
        if truth.chaotic:
            data.attrs[f"standard_error_{name}"] = truth.errors[name]
    directory.mkdir(parents=True, exist_ok=True)
    write_whole(directory / "chart.nc", lambda place: data.to_netcdf(place, engine="netcdf4"))
    write_whole(directory / "chart.csv", lambda place: table.to_csv(place, index=False))
    return data
