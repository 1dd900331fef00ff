"""Where each method fails on a scene: the outcome of runs over the step (or the tolerance) and a field of the scene.

Errors are those of time alone: each run is compared with a tight run on the same mesh, itself checked by a second
method. Of a chaotic scene that has a meaning only over a short time: where the two references differ by more than a
fifth of what is promised, the row says ``no reference`` and nothing is claimed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from pydantic import ValidationError

import solvers
from solvers import MODELS, Ask, CannotRepresent, Response, Scene, Status, brink
from solvers.catalogue import ENERGY_TOLERANCE, METHODS, apart, needs, static_state
from solvers.settled import period, why_not

from . import config
from .fields import ASK, FieldError, assign, bind, dump, lookup
from .mistakes import ConfigError, Mistake, faults, nearest
from .store import write_whole

GOOD, INACCURATE, FALSE_ALARM = "good", "inaccurate", "false alarm"
NO_REFERENCE, REFUSED = "no reference", "refused"
NAMES = {
    Status.ENERGY_OPEN: "energy open", Status.DIVERGED: "diverged", Status.NO_CONVERGENCE: "no convergence",
    Status.UNRESOLVED: "unresolved", Status.COARSE_STEP: "coarse step",
}  # fmt: skip
JUDGED = frozenset({GOOD, INACCURATE, FALSE_ALARM})
OF_TIME = frozenset({Status.COARSE_STEP, Status.NO_CONVERGENCE, Status.DIVERGED})  # what a right waveform contradicts
MULTIPLES = (0.05, 4.0)  # of the theoretical limit
TOLERANCES = (1e-2, 1e-8)
SERIES = (1e-2, 1e-6)  # of harmonic balance, whose tolerance counts harmonics
SHARP = 0.2  # of the promise: how well the reference must be known
SETTLING = 12  # periods after which a march has settled, checked by half as many more
ALL = (
    "rk2", "rk4", "genalpha 1", "genalpha 0.8", "genalpha 0", "dopri5", "tsit5", "srkn4", "trbdf2", "esdirk4",
    "harmonic",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Over:
    """What is mapped: a field of the scene over a range, and how the runs are made."""

    field: str = ""  # path of a field of the scene, or of the ask as `ask.x`; "" maps the steps alone
    values: tuple[float, ...] = (math.nan,)
    steps: int = 9  # points along the step or tolerance
    duration: float = 0.5  # [s]
    segments: int = 20
    models: tuple[str, ...] = ("lumped",)
    methods: tuple[str, ...] = ALL
    accuracy: float = 0.05
    most: int = 150_000  # steps of a run


def checked(over: Over) -> Over:
    """The same, or ConfigError with every mistake in it."""
    wrong = []
    for given, name, known in ((over.models, "--model", tuple(MODELS)), (over.methods, "--method", ALL)):
        wrong += [Mistake(name, x, "there is no such", nearest(x, known)) for x in given if x not in known]
    for name, value, good, rule in (
        ("--steps", over.steps, over.steps >= 2, "must be 2 or more"),
        ("--duration", over.duration, 0 < over.duration < math.inf, "must be above 0 [s]"),
        ("--segments", over.segments, 2 <= over.segments <= 400, "must be 2 to 400: eigenvalues are dense"),
        ("--accuracy", over.accuracy, 0 < over.accuracy < 1, "must lie between 0 and 1"),
        ("--range", over.values, not over.field or all(map(math.isfinite, over.values)), "is needed with --over"),
        ("--over", over.field, bool(over.field) or not any(map(math.isfinite, over.values)), "is needed with --range"),
    ):
        if not good:
            wrong.append(Mistake(name, value, rule))
    if wrong:
        raise ConfigError(wrong, "the command")
    return over


def spread(low: float, high: float, points: int) -> tuple[float, ...]:
    """Values over a range: evenly in the logarithm where it spans more than a decade above zero."""
    if points == 1 or low == high:
        return (low,)
    log = low > 0 and high > 0 and max(high / low, low / high) > 10
    found = np.geomspace(low, high, points) if log else np.linspace(low, high, points)
    return tuple(float(f"{x:.6g}") for x in found)


class Job(NamedTuple):
    """One run of the map."""

    model: str
    method: str  # one of ALL
    value: float
    setting: float  # step [s], or tolerance
    multiple: float  # of the theoretical limit; NaN for an adaptive method
    limit: float  # [s]


class Truth(NamedTuple):
    """The reference of a cell and how well it is known."""

    response: Response | None
    uncertainty: float
    note: str


def load(path: str | Path) -> tuple[Scene, config.Study | None]:
    """The scene of a study or of a scene file, and the study where it is one."""
    raw, _ = config.read_yaml(Path(path))
    if isinstance(raw, dict) and "scene" in raw and "ask" in raw:
        study = config.load_study(path)
        return study.scene, study
    return config.load_scene(path), None


def placed(scene: Scene, ask: Ask, over: Over, value: float) -> tuple[Scene, Ask]:
    """Scene and ask with the field at a value.

    Raises
    ------
    ConfigError
        Where there is no such field, or the value is out of its range.
    """
    if not over.field:
        return scene, ask
    tree = {"ask": {name: getattr(ask, name) for name in ask.__dataclass_fields__}} | dump(scene)
    try:
        lookup(tree, over.field)
        if over.field.startswith(ASK):
            assign(tree, over.field, value)
            return scene, Ask(**tree["ask"])
        return bind(scene, {over.field: value}), ask
    except FieldError as error:
        raise ConfigError([Mistake("--over", over.field, error.problem, error.remedy)], "the command") from None
    except ValidationError as error:
        wrong = [fault.mistake for fault in faults(error, tree, "", config.study_schema())]
        raise ConfigError(wrong, f"{over.field} = {value:g}") from None
    except ValueError as error:
        raise ConfigError([Mistake(over.field, value, str(error))], "the command") from None


# --------------------------------------------------------------------------------------------- limits


def limits(scene: Scene, ask: Ask, model: str) -> tuple[dict[str, float], float]:
    """Largest stable step of each method on a scene at rest [s], and the step at which its slower, transverse waves
    would reach the limit of rk4. NaN where nothing is known: no static state, or a line with constraints."""
    line = MODELS[model]
    unknown = dict.fromkeys(ALL, math.nan)
    if line.constrained or needs(scene, ask) & ~line.features:
        return unknown, math.nan
    assert ask.segments is not None  # the map's, or a run's that chose it
    built = line.made(scene, ask.segments, ask)
    if scene.start.kind == "given":
        status, rest = Status.OK, built.given()[0]
    else:
        status, rest, _ = static_state(built)
    if status != Status.OK:
        return unknown, math.nan
    lam = brink.rates(built, rest)
    found = {}
    for name in ALL:
        method, rho = split(name)
        if method != "harmonic":
            found[name] = brink.stable_step(method, lam, rho, ask.duration)
    fastest = built.fastest(rest)
    slow = max(fastest["tension"], fastest["bending"], built.omega)
    return unknown | found, math.sqrt(8.0) / slow if slow > 0 else found["rk4"]


def split(name: str) -> tuple[str, float]:
    """Method and spectral radius of a name in ALL."""
    method, _, rho = name.partition(" ")
    return method, float(rho or 0.8)


def settings_of(name: str, known: dict[str, float], slow: float, over: Over) -> list[tuple[float, float]]:
    """(setting, multiple of the unit) of a method's runs: steps about its limit, or tolerances; NaN is the mesh's step.

    An implicit method has no limit: its steps are multiples of the one that transverse waves would set.
    """
    method, _ = split(name)
    if METHODS[method].adaptive:
        low, high = SERIES if method == "harmonic" else TOLERANCES
        return [(float(x), math.nan) for x in np.geomspace(low, high, over.steps)]
    unit = known[name]
    if not 0 < unit < math.inf:
        unit = max(slow, known["rk4"]) if math.isfinite(known["rk4"]) else over.duration / 200
    unit = min(unit, over.duration / 40)
    steps = [(float(x * unit), float(x)) for x in np.geomspace(*MULTIPLES, over.steps)]
    return [(math.nan, math.nan), *steps] if METHODS[method].own_step else steps


# --------------------------------------------------------------------------------------------- runs and truth


def attempt(scene: Scene, ask: Ask) -> Response | str:
    """A run, or the sentence with which it was refused."""
    try:
        return solvers.solve(scene, ask)
    except CannotRepresent as error:
        return str(error)


def reference(scene: Scene, ask: Ask, over: Over, settled: bool = False) -> Truth:
    """A tight run by the best method, checked by another: dopri5 and TR-BDF2, or for lines with constraints TR-BDF2 and
    generalised-alpha; of a settled response two marches, one of them longer."""
    if settled:
        length = period(scene)[0]
        asks = [
            replace(ask, method="dopri5", tolerance=1e-7, duration=n * length, output_from=(n - 1) * length)
            for n in (SETTLING + SETTLING // 2, SETTLING)
        ]
    elif MODELS[ask.model].constrained:
        asks = [
            replace(ask, method="trbdf2", tolerance=1e-7),
            replace(ask, method="genalpha", rho=1.0, step=ask.duration / 4000),
        ]
    else:
        asks = [replace(ask, method="dopri5", tolerance=1e-9), replace(ask, method="trbdf2", tolerance=1e-7)]
    runs = [attempt(scene, replace(one, max_steps=over.most)) for one in asks]
    for run in runs:
        if isinstance(run, str):
            return Truth(None, math.nan, run)
        if run.status not in (Status.OK, Status.UNRESOLVED):
            return Truth(None, math.nan, f"{run.method}: {run.status.name}: {run.message}")
    best, second = runs
    assert isinstance(best, Response)
    assert isinstance(second, Response)
    if settled:  # both on one grid of phases
        best, second = (replace(x, t=x.t - x.t[0]) for x in (best, second))
    return Truth(best, apart(second, best), "")


def outcome(run: Response | str, truth: Truth, over: Over) -> tuple[str, float, float]:
    """Outcome, error and promise of a run."""
    if isinstance(run, str):
        return REFUSED, math.nan, math.nan
    promise = float(np.nanmax([over.accuracy, run.estimated_error]))
    error = math.nan if truth.response is None else apart(run, truth.response)
    if run.status == Status.OK and not run.energy_residual <= ENERGY_TOLERANCE:
        return INACCURATE, error, promise
    if truth.response is None or not truth.uncertainty <= SHARP * promise:
        named = NAMES.get(run.status, run.status.name.lower().replace("_", " "))
        return (NO_REFERENCE if run.status == Status.OK else named), math.nan, promise
    if run.status == Status.OK:
        return (GOOD if error <= promise else INACCURATE), error, promise
    if run.status in OF_TIME and error <= over.accuracy and run.energy_residual <= ENERGY_TOLERANCE:
        return FALSE_ALARM, error, promise
    return NAMES.get(run.status, run.status.name.lower().replace("_", " ")), error, promise


def jobs(over: Over, known: dict[str, float], slow: float, model: str, value: float) -> Iterator[Job]:
    for name in over.methods:
        for setting, multiple in settings_of(name, known, slow, over):
            yield Job(model, name, value, setting, multiple, known[name])


def ask_of(job: Job, ask: Ask) -> Ask:
    method, rho = split(job.method)
    if METHODS[method].adaptive:
        return replace(ask, model=job.model, method=method, tolerance=job.setting)
    step = job.setting if math.isfinite(job.setting) else None
    return replace(ask, model=job.model, method=method, rho=rho, step=step)


def cells(
    scene: Scene, over: Over, ask: Ask | None = None, said: Callable[[str], None] | None = None
) -> list[dict[str, Any]]:
    """All runs of a map, one dict each; `said` is told what goes on.

    Raises
    ------
    ConfigError
        For a field or a value that means nothing.
    """
    base = replace(
        ask or Ask(), duration=over.duration, segments=over.segments, interval=over.duration / 200, method="auto",
        output_from=0.0, accuracy=over.accuracy, step=None, tolerance=None, max_steps=over.most,
    )  # fmt: skip
    rows: list[dict[str, Any]] = []
    for value in over.values:
        here, wanted = placed(scene, base, over, value)
        for model in over.models:
            scaling = wanted.mass_scaling if "mass_scaling" in MODELS[model].reads else None
            wanted = replace(wanted, model=model, mass_scaling=scaling)
            known, slow = limits(here, wanted, model)
            truths: dict[bool, Truth] = {}
            refused: set[str] = set()
            for job in jobs(over, known, slow, model, value):
                if job.method in refused:  # once is enough: it is the scene that cannot be done
                    continue
                periodic = job.method == "harmonic"
                asked = ask_of(job, wanted)
                if periodic and not why_not(here):
                    length = period(here)[0]
                    asked = replace(asked, duration=length, interval=length / 200)
                run = attempt(here, asked)
                if periodic not in truths and not isinstance(run, str):
                    plain = replace(asked if periodic else wanted, harmonics=None, tolerance=None)
                    truths[periodic] = reference(here, plain, over, periodic)
                if isinstance(run, str):
                    refused.add(job.method)
                truth = truths.get(periodic, Truth(None, math.nan, ""))
                rows.append(_row(job, run, truth, over))
            if said is not None:
                said(f"{over.field or 'scene'} {value:g} {model}: {len(rows)} runs")
    return rows


def _row(job: Job, run: Response | str, truth: Truth, over: Over) -> dict[str, Any]:
    what, error, promise = outcome(run, truth, over)
    refused = isinstance(run, str)
    return job._asdict() | {
        "outcome": what,
        "status": "REFUSED" if isinstance(run, str) else run.status.name,
        "message": run if isinstance(run, str) else run.message,
        "error": error,
        "promise": promise,
        "uncertainty": truth.uncertainty,
        "energy_residual": math.nan if refused else run.energy_residual,  # type: ignore[union-attr]
        "estimated_error": math.nan if refused else run.estimated_error,  # type: ignore[union-attr]
        "steps": 0 if refused else run.cost.steps,  # type: ignore[union-attr]
        "seconds": 0.0 if refused else run.cost.seconds,  # type: ignore[union-attr]
    }


# --------------------------------------------------------------------------------------------- results


COLUMNS = {  # unit and meaning
    "model": ("", "line"),
    "method": ("", "method; generalised-alpha with its spectral radius at infinity"),
    "value": ("", "value of the field"),
    "setting": ("", "step [s] of a fixed-step method, tolerance of an adaptive one"),
    "multiple": ("1", "step over its unit: the limit, or for an implicit method that of transverse waves under rk4"),
    "limit": ("s", "largest stable step in theory: stability function and eigenvalues at rest; NaN where unknown"),
    "outcome": ("", "how the run compares with the reference on its mesh and with what it promised"),
    "status": ("", "how the run ended in its own words"),
    "message": ("", "its sentence"),
    "error": ("1", "relative rms difference of the displacement from the reference"),
    "promise": ("1", "the accuracy asked or the run's own estimated error, the larger"),
    "uncertainty": ("1", "relative rms difference between the reference and a second method"),
    "energy_residual": ("1", "residual of the energy balance over the peak energy"),
    "estimated_error": ("1", "the run's own estimate"),
    "steps": ("1", "steps made"),
    "seconds": ("s", "of the march"),
}


def dataset(rows: Sequence[dict[str, Any]], over: Over, scene: Scene) -> xr.Dataset:
    """The runs of a map along one dimension, `run`."""
    frame = pd.DataFrame(list(rows), columns=list(COLUMNS))
    data = {name: ("run", frame[name].to_numpy(), _about(name)) for name in COLUMNS}
    return xr.Dataset(
        data,
        attrs={
            "field": over.field, "label": label_of(over.field), "duration": over.duration, "segments": over.segments,
            "accuracy": over.accuracy,
            "scene": scene.name, "solvers": solvers.SOURCE_HASH,
            "comment": "errors are of time integration: against a tight run on the same mesh",
        },
    )  # fmt: skip


UNITS = {
    "EA": "N", "EI": "N m²", "BA": "N s", "BI": "N m² s", "mass": "kg", "length": "m", "d": "m", "wet_weight": "N/m",
    "phi0": "deg", "k": "N/m", "c": "N s/m", "g": "m/s²", "position": "m", "amplitude": "m", "frequency": "Hz",
    "velocity": "m/s", "force": "N", "stiffness": "Pa/m", "damping": "Pa s/m",
}  # fmt: skip


def label_of(field: str) -> str:
    """A field's path with its unit, which stands by its last name."""
    names = [part for part in re.split(r"[.\[\]]+", field) if part and not part.isdigit()]
    return f"{field} [{UNITS.get(names[-1], '-') if names else '-'}]"


def _about(name: str) -> dict[str, str]:
    unit, meaning = COLUMNS[name]
    return {"long_name": meaning} | ({"units": unit} if unit else {})


def summary(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Outcomes counted by method: column names and rows, the last one of all methods."""
    names = [x for x in ALL if any(row["method"] == x for row in rows)]
    first = [GOOD, INACCURATE, FALSE_ALARM]
    rest = sorted({row["outcome"] for row in rows} - set(first))
    table = []
    for name in [*names, "all"]:
        mine = [row["outcome"] for row in rows if name in ("all", row["method"])]
        table.append([name, str(len(mine)), *(str(mine.count(x)) for x in (*first, *rest))])
    return ["method", "runs", *first, *rest], table


def save(data: xr.Dataset, folder: Path) -> tuple[Path, Path]:
    """Write a map as csv and netCDF; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    frame = data.to_dataframe()
    table = write_whole(folder / "stability.csv", lambda place: frame.to_csv(place, index=False))
    return table, write_whole(folder / "stability.nc", lambda place: data.to_netcdf(place, engine="netcdf4"))


def worst(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A sentence for each run that said OK and was not, and for each that was good and was called bad."""
    return [
        f"{row['outcome']}: {row['model']}, {row['method']} at {row['setting']:.3g}, field {row['value']:g}: error "
        f"{row['error']:.2g}, promise {row['promise']:.2g}, energy residual {row['energy_residual']:.1e}, "
        f"{row['status']}: {row['message']}"
        for row in rows if row["outcome"] in (INACCURATE, FALSE_ALARM)
    ]  # fmt: skip


def false_alarms(rows: Sequence[dict[str, Any]]) -> float:
    """Share of the good runs that were called bad."""
    good = sum(row["outcome"] == GOOD for row in rows)
    alarms = sum(row["outcome"] == FALSE_ALARM for row in rows)
    return alarms / (good + alarms) if good + alarms else 0.0
