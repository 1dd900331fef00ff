"""Audit of a study: its front and a random sample of its points, run again with the next costlier model.

Points go through the same supervised child and evaluator as the study's, into journals of their own in DIR/audit; the
study's rows are read and never touched. What both say of each metric, of the order of the designs, and of the front is
in DIR/audit.nc.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from solvers import METHODS, MODELS, Ask, Feature, Scene
from solvers.catalogue import can_march, needs

from . import distribute, locks, pareto
from . import run as running
from .config import ConfigError, Study, find_metric, split_name
from .dataset import assemble
from .mistakes import Mistake
from .plan import Designs, Keys, Plan, read_plan
from .point import Point
from .report import Progress
from .space import point_key
from .store import (
    StoreError,
    last_turn,
    open_study,
    read_headers,
    read_records,
    same_version,
    settle,
    study_of,
    write_whole,
)

SAMPLE = 8  # trusted designs beside the front
COSTLIER = {  # what each line leaves out, the next one has; the others are audited by themselves, finer
    "transverse": ("hermite", "lumped"),
    "local": ("lumped",),
    "catenary": ("hybrid", "rod"),
    "hybrid": ("rod",),
}
FINER = 2  # times the segments, where the line stays
LOWER_ORDER = 4  # times the segments, where the next line is of a lower order: its mesh error must not be the audit's
TIGHTER = 10.0  # the tolerance is divided by this where the line stays; a fixed step by FINER

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """How much is audited, and by what; None is the next costlier."""

    sample: int = SAMPLE
    seed: int = 0
    model: str | None = None
    segments: int | None = None


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How an audit ended."""

    data: xr.Dataset | None  # None where it was interrupted
    interrupted: str = ""

    @property
    def exit_code(self) -> int:
        if self.data is None:
            return 3
        return 1 if not bool((self.data["status"] == "OK").all()) else 0


# --------------------------------------------------------------------------- by what


def next_model(scene: Scene, ask: Ask, used: str) -> str:
    """The next costlier line that has what the scene needs; `used` itself where there is none."""
    wanted = needs(scene, ask)
    return next((name for name in COSTLIER.get(used, ()) if not wanted & ~MODELS[name].features), used)


def costlier(scene: Scene, ask: Ask, row: dict[str, Any], wanted: Wanted) -> Ask:
    """What an audit asks in place of `ask`.

    Parameters
    ----------
    row : `model`, `method`, `segments`, `tolerance` that the study's point used

    Raises
    ------
    ConfigError
        For a model that is none, or that cannot represent the scene.
    """
    used, method, n, tolerance = row["model"], row["method"], int(row["segments"]), float(row["tolerance"])
    model = wanted.model or next_model(scene, ask, used)
    able = [name for name, line in MODELS.items() if not needs(scene, ask) & ~line.features]
    if model not in able:
        problem = "there is no such model" if model not in MODELS else "it cannot represent the study's scene"
        raise ConfigError([Mistake("--model", model, problem, f"take one of {', '.join(able)}")])
    if model == used:
        tight = None if math.isnan(tolerance) else tolerance / TIGHTER
        step = None if ask.step is None else ask.step / FINER
        return replace(
            ask, model=model, method=method, segments=wanted.segments or FINER * n, tolerance=tight, step=step,
            harmonics=None, checked_tolerance=None, mass_scaling=None,
        )  # fmt: skip
    line = MODELS[model]
    falls = line.order < MODELS[used].order
    settles = method == "harmonic" and Feature.PERIODIC in line.features and not line.constrained
    marches = METHODS.get(method) is not None and method in line.marched and can_march(model, method)
    fixed = ask.step is not None and method in METHODS and not METHODS[method].own_step
    if not (settles or marches or (fixed and can_march(model, method))):
        method = next(name for name in (*line.marched, "trbdf2") if can_march(model, name))
    default = METHODS[method].tolerance if METHODS[method].adaptive else None
    tight = default if default is None or math.isnan(tolerance) or method != row["method"] else min(default, tolerance)
    return replace(
        ask, model=model, method=method, segments=wanted.segments or (LOWER_ORDER if falls else 1) * n,
        tolerance=tight, checked_tolerance=None, step=None if default is not None else ask.step, harmonics=None,
        rods=None if model == "rod" else ask.rods, mass_scaling=None,
    )  # fmt: skip


# --------------------------------------------------------------------------- what


def picked(data: xr.Dataset, objectives: Sequence[str], wanted: Wanted) -> tuple[np.ndarray, np.ndarray]:
    """Designs of the front and a random sample of the other trusted ones: their indices, ascending, and which of them
    are on the front."""
    front = pareto.front(data, objectives)
    others = np.setdiff1d(pareto.eligible(data, objectives), front)
    chance = np.random.default_rng(wanted.seed)
    sample = chance.choice(others, min(wanted.sample, len(others)), replace=False)
    both = np.sort(np.concatenate([front, sample])).astype(int)
    return both, np.isin(both, front)


def audit_points(study: Study, plan: Plan, data: xr.Dataset, designs: np.ndarray, wanted: Wanted) -> list[Point]:
    """The points of some designs, environments together, as the costlier model runs them."""
    m, found = len(plan.environments), []
    fields = {name: data[name].to_numpy().reshape(-1, m) for name in ("model", "method", "segments", "tolerance")}
    for design in designs:
        for e in range(m):
            point = plan.point(study, int(design) * m + e)
            row = {name: values[design, e] for name, values in fields.items()}
            ask = costlier(point.scene, point.ask, row, wanted)
            found.append(replace(point, ask=ask, key=point_key(point.scene, ask, point.settings)))
    return found


# --------------------------------------------------------------------------- the audit


def audit(directory: str | Path, wanted: Wanted, ranks: distribute.World | None = None) -> Ended:
    """Run what is missing of an audit and compare; rank 0 calls this while the other ranks ``distribute.serve``.

    Raises
    ------
    ConfigError, StoreError
        For a folder without trusted points, a model that cannot do the scene, rows of other solvers in DIR/audit.
    """
    ranks, directory = ranks or distribute.Alone(), Path(directory)
    study, data = study_of(directory), open_study(directory)
    plan = read_plan(directory / "plan.json")
    objectives = json.loads(data.attrs["objectives"])
    designs, on_front = picked(data, objectives, wanted)
    if not len(designs):
        raise StoreError("there is no trusted point to audit: `sweep status` says why")
    points = audit_points(study, plan, data, designs, wanted)
    folder, header = directory / "audit", running.provenance(study)
    folder.mkdir(exist_ok=True)
    lock = locks.acquire(folder, "", header["study"])
    try:
        same_version(folder, header["solver"], read_headers(folder))
        done = settle(read_records(folder))
        left = list({point.key: point for point in points if point.key not in done}.values())
        log.info("%d designs, %d points, %d to do", len(designs), len(points), len(left))
        interrupted = ""
        if left:
            job = running.job_of(study, running.Settings(directory=folder), header, "", last_turn(folder) + 1)
            progress = Progress(len(left))
            interrupted = distribute.map_points(left, job, ranks, progress.report, progress.beat)
            log.info("%s", progress.line())
        if interrupted:
            return Ended(data=None, interrupted=interrupted)
        rows = settle(read_records(folder))
        part = replace(
            plan, designs=Designs(plan.designs.names, plan.designs.values[designs]),
            keys=Keys.of([point.key for point in points]), costs=np.ones(len(points), dtype=np.float32),
        )  # fmt: skip
        fine = assemble(study, part, rows, read_headers(folder))
        found = compared(data, fine, designs, on_front, objectives)
        found.attrs |= {"audit_seed": wanted.seed, "audit_sample": wanted.sample}
        write_whole(directory / "audit.nc", lambda place: found.to_netcdf(place, engine="netcdf4"))
        return Ended(data=found)
    finally:
        lock.release()


def compared(
    data: xr.Dataset, fine: xr.Dataset, designs: np.ndarray, on_front: np.ndarray, objectives: Sequence[str]
) -> xr.Dataset:
    """The audit's rows beside the study's (`study_...`), a table over metrics, and who stays on the front.

    Over the points that are trusted in both: `n` of them have a number in both, `one_only` in one; `rms` and `largest`
    difference; `size`, the study's own root mean square; `deviation`, the standard deviation over all trusted points of
    the study; `error_bar`, the mean sum of the spreads over perturbed runs, where there are `repeats`, or else 1.96
    standard uncertainties of the difference, where there is `uncertainty`, and how many differ `beyond` theirs;
    `rank_correlation` (Spearman's). `stays`: of the audited designs alone, those on the front by the audit.
    """
    dim = "design" if "environment" in data.dims else "point"
    coarse = data.isel({dim: designs})
    names = [str(name) for name in fine.data_vars if str(name) in data and _is_metric(str(name), fine, data)]
    both = ((fine["status"] == "OK").to_numpy() & (coarse["status"] == "OK").to_numpy()).ravel()
    every = (data["status"] == "OK").to_numpy().ravel()
    rows = [disagreement(name, coarse, fine, both, data[name].to_numpy().ravel()[every]) for name in names]
    found = fine.assign_coords(design=(dim, data["design"].to_numpy()[designs]))
    for name in [*names, "status", "model", "method", "segments", "tolerance", "seconds", "key"]:
        found[f"study_{name}"] = (fine[name].dims, coarse[name].to_numpy(), dict(coarse[name].attrs))
    left = np.flatnonzero(np.isin(np.arange(len(designs)), pareto.eligible(fine, objectives)))
    stays = np.zeros(len(designs), dtype=bool)
    if len(left):
        stays[left[pareto.front(fine.isel({dim: left}), objectives)]] = True
    found["on_front"] = (dim, on_front, {"long_name": "on the study's front"})
    found["stays"] = (dim, stays, {"long_name": "on the front of the audited designs, by the audit"})
    found = found.assign_coords(metric=("metric", names))
    for key, meaning in ABOUT.items():
        found[key] = ("metric", np.array([row[key] for row in rows]), {"long_name": meaning})
    return found


ABOUT = {
    "n": "points trusted in both, with a number in both",
    "one_only": "points trusted in both, with a number in one",
    "rms": "root mean square difference, audit less study",
    "largest": "largest difference",
    "size": "root mean square of the study's values",
    "deviation": "standard deviation over the study's trusted points",
    "error_bar": "mean sum of both spreads over perturbed runs, or 1.96 sd of the difference; NaN without either",
    "beyond": "points that differ by more than their error bar; NaN without one",
    "rank_correlation": "Spearman's, study against audit; NaN for fewer than three points or a constant",
}


def _is_metric(name: str, fine: xr.Dataset, data: xr.Dataset) -> bool:
    metric = find_metric(name)
    same = "status" in data and data[name].dims == data["status"].dims and fine[name].dims == fine["status"].dims
    return metric is not None and same and not {"spread", "sd"} & set(split_name(name)[1])


def disagreement(
    name: str, coarse: xr.Dataset, fine: xr.Dataset, both: np.ndarray, every: np.ndarray
) -> dict[str, float]:
    """The row of a metric: see :func:`compared`."""
    a, b = coarse[name].to_numpy().astype(float).ravel()[both], fine[name].to_numpy().astype(float).ravel()[both]
    known = np.isfinite(a) & np.isfinite(b)
    gap, every = b[known] - a[known], every[np.isfinite(every)]
    row = {
        "n": float(known.sum()), "one_only": float((np.isfinite(a) != np.isfinite(b)).sum()),
        "rms": float(np.sqrt((gap**2).mean())) if gap.size else math.nan,
        "largest": float(np.abs(gap).max()) if gap.size else math.nan,
        "size": float(np.sqrt((a[known] ** 2).mean())) if gap.size else math.nan,
        "deviation": float(every.std()) if every.size > 1 else math.nan,
        "error_bar": math.nan, "beyond": math.nan, "rank_correlation": rank_correlation(a[known], b[known]),
    }  # fmt: skip
    stem = split_name(name)[0]
    bars_of = [f"{stem}_{kind}" for kind in ("spread", "sd")]
    if bar := next((one for one in bars_of if one in coarse and one in fine), ""):
        ours, theirs = (x[bar].to_numpy().astype(float).ravel()[both][known] for x in (coarse, fine))
        spread = bar.endswith("_spread")
        bars = pareto.share(coarse, name) * (ours + theirs) if spread else pareto.Z * np.hypot(ours, theirs)
        if np.isfinite(bars).any():
            row["error_bar"] = float(np.nanmean(bars))
            row["beyond"] = float((np.abs(gap) > bars).sum())
    return row


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's coefficient; NaN for fewer than three points or a constant."""
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return math.nan
    from scipy.stats import spearmanr  # a third of a second

    return float(spearmanr(a, b).statistic)
