"""The common evaluator: a Point goes in, a Record comes out, whatever happens in between.

Workers, the optimiser, ``show`` and notebooks all call it. The design is run, then its baseline with the same
model, method and mesh (once per process for each distinct baseline), then the metrics are read.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from solvers import QUANTITIES, Ask, CannotRepresent, Response, Scene, Status, solve
from solvers.model import REMEDY

from .config import MetricSettings, Uncertainty, split_name
from .metrics import FINISHED, Summary, compute, metric_names, settling_index, summarise, transverse
from .point import Point, Record
from .space import baseline_model, baseline_scene, point_key
from .uncertainty import JITTER, chaos, deviations, twin_growth

if TYPE_CHECKING:  # workers make records, and do not wait for what only series need
    import xarray as xr

NAN = float("nan")
RETRIED = frozenset({Status.ENERGY_OPEN, Status.NO_CONVERGENCE, Status.COARSE_STEP, Status.DIVERGED})
_MAX_BASELINES = 128


class Run(NamedTuple):
    """The response that counts, the tolerance it used, and what a first, untrusted attempt cost."""

    response: Response
    tolerance: float
    first_seconds: float


@dataclass(frozen=True)
class Baseline:
    """A baseline's curves, or why there are none."""

    summary: Summary | None
    status: Status
    message: str


_baselines: OrderedDict[str, Baseline] = OrderedDict()


def evaluate(point: Point) -> Record:
    """Run a point and its baseline and read the metrics; never raises."""
    return _guarded(point)[0]


def evaluate_with_series(point: Point, baselines: Sequence[str] | None = None) -> tuple[Record, xr.Dataset]:
    """As :func:`evaluate`, with the signals of the design and of named baselines.

    Parameters
    ----------
    baselines : names of baselines to add; by default the one of the point's settings

    Returns
    -------
    record, series
        The dataset holds every quantity of the design under its own name, ``transverse`` (displacement
        normal to the static tangent) and ``G`` against the point's baseline; those of a baseline as
        ``<baseline>_<quantity>`` with its own ``<baseline>_node`` dimension. Empty where the run failed.
    """
    record, response = _guarded(point)
    import xarray as xr

    try:
        return record, _series(
            point, response, [point.settings.baseline] if baselines is None else list(baselines)
        )
    except Exception as error:  # a figure must not cost the record
        return replace(record, message=_join(record.message, f"no series: {_say(error)}")), xr.Dataset()


def _guarded(point: Point) -> tuple[Record, Response | None]:
    if point.problem:
        return _failed(point, "IMPOSSIBLE", point.problem), None
    try:
        return _evaluate(point)
    except CannotRepresent as error:
        return _failed(point, Status.CANNOT_REPRESENT.name, str(error)), None
    except Exception as error:  # the row says what happened; the study goes on
        return _failed(point, "MEMORY" if isinstance(error, MemoryError) else "ERROR", _say(error)), None


def _failed(point: Point, status: str, message: str) -> Record:
    names = metric_names(len(point.scene.devices))
    return Record(
        key=point.key,
        design=point.design,
        environment=point.environment,
        values=dict(point.values),
        status=status,
        message=" ".join(message.split()),
        metrics=dict.fromkeys(names, NAN),
    )


def _say(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


def _join(*sentences: str) -> str:
    return "; ".join(sentence for sentence in sentences if sentence)


# --------------------------------------------------------------------------- running


def _solve(scene: Scene, ask: Ask) -> Response:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return solve(scene, ask)


def run_trusted(scene: Scene, ask: Ask) -> Run:
    """Run a scene; one that is not trusted is tried once more at a tenth of the tolerance, or at half of a step that
    the mesh gave.

    Steps that were asked for are never retried, nor is what a tighter tolerance cannot mend.
    """
    first = _solve(scene, ask)
    hopeless = first.method == "harmonic" and first.status == Status.NO_CONVERGENCE  # a tolerance does not help Newton
    own = ask.step is None and first.step > 0
    if first.status not in RETRIED or hopeless or not (first.tolerance > 0 or own):
        return Run(first, first.tolerance, 0.0)
    same = replace(ask, segments=ask.segments or first.segments)
    change = {"method": first.method, "step": first.step / 2} if own else {"tolerance": first.tolerance / 10}
    second = _solve(scene, replace(same, **change))
    if second.status in FINISHED or first.status not in FINISHED:
        return Run(second, second.tolerance if own else first.tolerance / 10, first.cost.seconds)
    return Run(first, first.tolerance, second.cost.seconds)


def baseline_ask(ask: Ask, response: Response, name: str = "") -> Ask:
    """What is asked of the baseline: the model (but for `full_rod`), method and mesh of the design, unperturbed."""
    used = replace(
        ask,
        model=response.model or ask.model,
        method=response.method or ask.method if ask.method == "auto" else ask.method,
        segments=ask.segments or response.segments or None,
        perturbation=0.0,
        seed=0,
    )
    return baseline_model(used, name)


def baseline_of(point: Point, response: Response) -> Baseline:
    """The point's baseline, computed once in this process; the design's own run where it is its baseline."""
    scene = baseline_scene(point.scene, point.settings.baseline)
    ask = baseline_ask(point.ask, response, point.settings.baseline)
    window = point.settings.single
    sections = point.scene.cable
    key = point_key(scene, ask, window) + point_key(replace(point.scene, devices=()), ask)
    if key in _baselines:
        _baselines.move_to_end(key)
        return _baselines[key]
    itself = scene == point.scene and point.ask.perturbation == 0 and ask == baseline_ask(point.ask, response)
    try:
        run = response if itself else run_trusted(scene, ask).response
        found = Baseline(summarise(run, scene, point.settings, sections), run.status, run.message)
    except CannotRepresent as error:
        found = Baseline(None, Status.CANNOT_REPRESENT, str(error))
    _baselines[key] = found
    if len(_baselines) > _MAX_BASELINES:
        _baselines.popitem(last=False)
    return found


def clear_baselines() -> None:
    """Forget the baselines computed in this process."""
    _baselines.clear()


# --------------------------------------------------------------------------- the record


def _evaluate(point: Point) -> tuple[Record, Response]:
    settings: MetricSettings = point.settings
    devices = len(point.scene.devices)
    run = run_trusted(point.scene, point.ask)
    response = run.response
    summary = summarise(response, point.scene, settings)
    status, message = response.status.name, response.message
    if response.status != Status.OK and REMEDY[response.status] not in message and "run the time" not in message:
        message = _join(message, REMEDY[response.status])
    if response.trusted and summary is None:
        status, message = "ERROR", "the run ended before the metrics' window"
    base = None
    if summary is not None:
        baseline = baseline_of(point, response)
        base = baseline.summary
        if baseline.status != Status.OK:
            why = (
                f"the baseline `{settings.baseline}` ended {baseline.status.name}: {baseline.message}".rstrip(
                    ": "
                )
            )
            message = _join(message, why)
            status = "BASELINE_FAILED" if status == "OK" else status
    metrics = compute(summary, base, devices)
    if settings.repeats and summary is not None:
        metrics |= _spreads(point, response, base, metrics)
    if settings.uncertainty is not None and summary is not None and response.trusted:
        found, why = _uncertainty(point, run, base, compute(summary, base, devices))
        metrics, message = metrics | found, _join(message, why)
    record = Record(
        key=point.key,
        design=point.design,
        environment=point.environment,
        values=dict(point.values),
        status=status,
        message=" ".join(message.split()),
        metrics=metrics,
        energy_residual=float(response.energy_residual),
        nodes_per_wave=float(response.nodes_per_wave),
        steps_per_period=float(response.steps_per_period),
        harmonics=int(response.harmonics),
        multiplier=float(response.multiplier),
        steps=int(response.cost.steps),
        evaluations=int(response.cost.evaluations),
        seconds=float(response.cost.seconds),
        first_seconds=float(run.first_seconds),
        model=response.model,
        method=response.method,
        segments=int(response.segments),
        tolerance=run.tolerance,
    )
    return record, response


def _spreads(
    point: Point, response: Response, base: Summary | None, metrics: dict[str, float]
) -> dict[str, float]:
    """Half the range of each objective over the run and its perturbed, trusted repetitions, and their mean.

    ``<metric>_ensemble`` is the mean, NaN where no repetition could be trusted: a single run's luck is no mean.
    """
    settings: MetricSettings = point.settings
    stems = [split_name(name)[0] for name in settings.objectives]
    rows = [metrics]
    for k in range(settings.repeats):
        ask = replace(point.ask, perturbation=settings.perturbation, seed=point.ask.seed + k + 1)
        again = run_trusted(point.scene, ask).response
        if again.trusted:
            rows.append(compute(summarise(again, point.scene, settings), base, len(point.scene.devices)))
    spreads = {}
    for name in dict.fromkeys(stems):
        values = np.array([row.get(name, NAN) for row in rows])
        # the settled response does not depend on the start: repeating it says nothing of its spread
        good = response.method != "harmonic" and len(rows) > 1 and bool(np.all(np.isfinite(values)))
        spreads[f"{name}_spread"] = float(np.ptp(values)) / 2 if good else NAN
        spreads[f"{name}_ensemble"] = float(np.mean(values)) if len(rows) > 1 else NAN
    return spreads


def _uncertainty(
    point: Point, run: Run, base: Summary | None, metrics: dict[str, float]
) -> tuple[dict[str, float], str]:
    """``<metric>_sd`` of every metric, ``chaos``, and what kept them from being known; see ``sweep.uncertainty``."""
    asked: Uncertainty = point.settings.uncertainty
    response, devices, plain = run.response, len(point.scene.devices), point.settings.single
    settled = response.method == "harmonic" or point.ask.duration == 0  # does not depend on the start
    fixed = not run.tolerance > 0
    same = replace(baseline_ask(point.ask, response), tolerance=point.ask.tolerance if fixed else run.tolerance)
    step = response.step if fixed and response.step > 0 else None
    same = replace(same, model=response.model, step=step)  # of the design, whatever the baseline is run as
    wrong: list[str] = []

    def again(ask: Ask, what: str) -> Response | None:
        try:
            found = _solve(point.scene, ask)
        except CannotRepresent as error:
            wrong.append(f"{what}: {error}")
            return None
        if not found.trusted:
            wrong.append(f"{what} ended {found.status.name}")
        return found if found.trusted else None

    def row(ask: Ask, what: str) -> dict[str, float]:
        found = again(ask, what)
        if found is None:
            return dict.fromkeys(metrics, NAN)
        baseline = baseline_of(replace(point, ask=ask), found)
        if baseline.status != Status.OK:
            wrong.append(f"the baseline of {what} ended {baseline.status.name}")
        sure = baseline.summary if baseline.status == Status.OK else None
        return compute(summarise(found, point.scene, plain), sure, devices)

    ensemble, growths = [], []
    for k in range(0 if settled else asked.runs):
        ask = replace(same, perturbation=asked.perturbation, seed=point.ask.seed + k + 1)
        if k % 2:
            ask = tighter(ask, 1 - JITTER * (k + 1))
        member = again(ask, f"ensemble run {k + 1}")
        if member is not None:
            ensemble.append(compute(summarise(member, point.scene, plain), base, devices))
        if member is not None and not k % 2:
            growths.append(twin_growth(response, member))
    if not settled and len(ensemble) < 2:
        ensemble = [dict.fromkeys(metrics, NAN)] * 2  # too few to tell
    close = metrics if point.ask.duration == 0 else row(tighter(same, 0.5 if fixed else 0.1), "the run in finer time")
    segments = round(asked.refine * response.segments)
    finer = segments / max(response.segments, 1)
    mesh = replace(same, segments=segments, step=point.ask.step)  # a mesh's own step is that of the finer mesh
    mesh = tighter(mesh, finer**-2 if fixed else 1.0)  # a step that is asked for must stay stable
    fine = row(mesh, f"the run on {segments} segments")
    found = deviations(metrics, ensemble, close, fine, finer) | chaos(growths)
    return found, f"uncertainty: {', '.join(wrong)}" if wrong else ""


def tighter(ask: Ask, factor: float) -> Ask:
    """The same with the tolerance, or the step of a fixed-step run, times a factor; a step that is chosen stays."""
    if ask.tolerance is not None:
        return replace(ask, tolerance=ask.tolerance * factor)
    return ask if ask.step is None else replace(ask, step=ask.step * factor)


# --------------------------------------------------------------------------- time series


def _series(point: Point, response: Response | None, names: list[str]) -> xr.Dataset:
    import xarray as xr

    if response is None or not len(response.t):
        return xr.Dataset()
    data: dict[str, Any] = {}
    _add_signals(data, response, "")
    own = summarise(response, point.scene, replace(point.settings, window=None))
    for name in names:
        scene = baseline_scene(point.scene, name)
        run = run_trusted(scene, baseline_ask(point.ask, response, name)).response
        if not len(run.t) or len(run.t) != len(response.t):
            continue
        _add_signals(data, run, f"{name}_")
        base = summarise(run, scene, replace(point.settings, window=None), point.scene.cable)
        if own is not None and base is not None:
            index = (
                ("time",),
                settling_index(own, base),
                {"units": "1", "long_name": f"G(t) against {name}"},
            )
            data[f"{name}_G"] = index
            if name == point.settings.baseline:
                data["G"] = index
    offsets = [float(getattr(device, "rest_offset", 0.0)) for device in point.scene.devices]
    data["rest_offset"] = (("device",), np.array(offsets), {"units": "m", "long_name": "rest offset y0"})
    attrs = {"key": point.key, "status": response.status.name, "baselines": " ".join(names)}
    return xr.Dataset(data, coords={"time": ("time", response.t, {"units": "s"})}, attrs=attrs)


def _add_signals(data: dict[str, Any], response: Response, prefix: str) -> None:
    shared = {"time", "axis", "end"}
    for name, array in response.signals.items():
        quantity = QUANTITIES[name]
        dims = tuple(d if d in shared else prefix + d for d in quantity.dims)
        data[prefix + name] = (dims, array, {"units": quantity.unit, "long_name": quantity.meaning})
    meaning = "displacement normal to the static tangent"
    dims = ("time", f"{prefix}node", "axis")
    data[f"{prefix}transverse"] = (dims, transverse(response), {"units": "m", "long_name": meaning})
