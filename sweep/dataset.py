"""Rows to one dataset: what ``results.nc`` holds and what notebooks, fronts and figures read."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import xarray as xr

from .config import DESIGN_QUANTITIES, Metric, Study, find_metric, split_name
from .metrics import metric_names
from .pareto import CRITERION, aggregate, aggregate_deviation, aggregates
from .plan import Plan
from .point import Record
from .space import design_quantity

ABOUT = {  # unit and meaning of a row's own fields
    "key": ("", "hash of the point's physics inputs"),
    "status": ("", "how the run ended; only OK is trusted"),
    "message": ("", "why, where it did not end well"),
    "energy_residual": ("1", "gap of the energy balance over the peak energy"),
    "nodes_per_wave": ("1", "nodes in the shortest transverse wave of the excitation"),
    "steps_per_period": ("1", "steps in the shortest period that matters"),
    "harmonics": ("1", "harmonics of a periodic response, 0 in the time domain"),
    "multiplier": ("1", "size of the largest Floquet multiplier: a periodic response is unstable above 1"),
    "steps": ("1", "time steps, or Newton iterations of harmonic balance"),
    "evaluations": ("1", "residuals or accelerations computed"),
    "seconds": ("s", "cost of the point"),
    "first_seconds": ("s", "cost of a first, untrusted attempt"),
    "model": ("", "line"),
    "method": ("", "what marched it"),
    "segments": ("1", "segments of the cable"),
    "tolerance": ("1", "local error allowed to an adaptive method"),
}
UNITS = {  # of scene fields, for design variables
    **dict.fromkeys(("EA", "rod_EA"), "N"),
    **dict.fromkeys(("BA",), "N s"),
    **dict.fromkeys(("EI", "EI2", "GJ"), "N m2"),
    **dict.fromkeys(("BI",), "N m2 s"),
    **dict.fromkeys(("s", "length", "rod", "d", "drag_diameter", "amplitude", "depth", "z"), "m"),
    **dict.fromkeys(("mass", "added_mass"), "kg"),
    **dict.fromkeys(("Can", "Cat", "Cdn", "Cdt", "friction", "side"), "1"),
    **{"k": "N/m", "c": "N s/m", "volume": "m3", "drag": "m2", "phi0": "deg", "wet_weight": "N/m"},
    **{"rods": "m", "twist": "deg", "angle": "deg", "curvature": "1/m", "inertia": "kg m", "force": "N"},
    **{"frequency": "Hz", "phase": "rad", "density": "kg/m3", "stiffness": "Pa/m"},
}


def assemble(
    study: Study,
    plan: Plan,
    rows: Mapping[str, Record],
    headers: Sequence[Mapping[str, Any]] = (),
    *,
    metrics: Iterable[str] | None = None,
    designs: slice = slice(None),
) -> xr.Dataset:
    """One dataset of planned points, by design and environment; without a row they are MISSING.

    With one environment the dimension is ``point``; with several they are ``design`` and ``environment``, and
    each metric has its mean, its worst and the quantile of its bad tail over the environments.

    Parameters
    ----------
    metrics : names of all metrics that rows have; by default those of ``rows``
    designs : a stretch of the plan's designs, so that a large file can be made piece by piece
    """
    m = len(plan.environments)
    begin, end, _ = designs.indices(len(plan.designs))
    several = m > 1
    dims = ("design", "environment") if several else ("point",)
    shape = (end - begin, m)[: len(dims)]
    records = [rows.get(key) or _missing(key) for key in plan.keys[begin * m : end * m]]
    index = dims[0]
    coordinates: dict[str, Any] = {"design": (index, np.arange(begin, end), _about("1", "number of the design"))}
    if several:
        coordinates["environment"] = ("environment", plan.environments)
    for name in study.variables:
        column = plan.designs.column(name)[begin:end]
        if study.variables[name].labels is None:
            coordinates[name] = (index, column.copy(), _variable_about(study, name))
            continue
        labels = [study.variables[name].shown(value) for value in column]
        kind = float if study.variables[name].numeric else object
        coordinates[name] = (index, np.array(labels, dtype=kind), _variable_about(study, name))
    dataset = xr.Dataset(coords=coordinates, attrs=_attributes(study, headers))
    for field in fields(Record):
        if field.name in ABOUT:
            kind = {"str": object, "int": np.int64, "float": np.float64}[str(field.type)]
            column = np.array([getattr(record, field.name) for record in records], dtype=kind)
            dataset[field.name] = (dims, column.reshape(shape), _about(*ABOUT[field.name]))
    for name in DESIGN_QUANTITIES.keys() & study.constraints.keys():
        unit, meaning, _ = DESIGN_QUANTITIES[name]
        column = np.array([design_quantity(study, values, name) for values in plan.designs[begin:end]], dtype=float)
        dataset[name] = (index, column, _about(unit, meaning))
    found = {name for record in records for name in record.metrics} if metrics is None else set(metrics)
    for name in _columns(study, found):
        column = np.array([record.metrics.get(name, np.nan) for record in records], dtype=float)
        dataset[name] = (dims, column.reshape(shape), _metric_about(name))
        if several and not name.endswith("_sd"):
            _aggregate(dataset, name, column.reshape(shape))
    for name in [str(name) for name in dataset.data_vars if several and f"{name}_sd" in dataset]:
        for how in aggregates(name):
            sd = aggregate_deviation(dataset[f"{name}_sd"].values, how)
            dataset[f"{name}_{how}_sd"] = ("design", sd, _metric_about(f"{name}_{how}_sd"))
    return dataset


def _missing(key: str) -> Record:
    return Record(key=key, design=0, environment=0, values={}, status="MISSING", message="not run yet")


def _columns(study: Study, found: set[str]) -> list[str]:
    """Every metric of the scene in declared order, then what the study asks of further runs and what else rows bring.

    A study has the columns that it asks for even where no row has: the rows of a search's generation may all be lost.
    """
    declared = metric_names(len(study.scene.devices))
    stems = [split_name(name)[0] for name in study.objectives] if study.repeats.n else []
    asked = {f"{stem}_{kind}" for stem in stems for kind in ("ensemble", "spread")}
    if study.settings.uncertainty is not None:
        asked |= {f"{name}_sd" for name in declared}
    return [*declared, *sorted((found | asked) - set(declared))]


def _aggregate(dataset: xr.Dataset, name: str, values: np.ndarray) -> None:
    """Mean, worst and quantile over the environments; a missing or failed environment leaves no aggregate."""
    about = dataset[name].attrs
    for how in aggregates(name) if about.get("direction") in ("min", "max") else ["mean"]:
        found = aggregate(values, how, about.get("direction"))
        said = f"{how} of" if how in ("mean", "worst") else f"{how[1:]} % quantile, its bad tail, of"
        dataset[f"{name}_{how}"] = ("design", found, about | {"long_name": f"{said} {about['long_name']}"})


def _about(unit: str, meaning: str) -> dict[str, str]:
    return ({"units": unit} if unit else {}) | {"long_name": meaning}


def _metric_about(name: str) -> dict[str, str]:
    metric: Metric | None = find_metric(name)
    if metric is None:
        return _about("", name)
    about = _about(metric.unit, metric.definition) | {"direction": metric.direction or "none"}
    device = re.fullmatch(rf"{metric.name}_(\d+)", name)
    if device:
        about |= {"long_name": f"{metric.definition.split(';')[0]}; device {device[1]}"}
    if name.endswith("_ensemble"):
        about |= {"long_name": f"mean of {name.removesuffix('_ensemble')} over the run and its perturbed repetitions"}
    if name.endswith("_spread"):
        about |= {
            "long_name": f"spread of {name.removesuffix('_spread')} over perturbed runs",
            "direction": "none",
        }
    if split_name(name)[1][-1:] == ("sd",):
        about |= {"long_name": f"standard uncertainty of {name.removesuffix('_sd')}", "direction": "none"}
    return about | ({"equation": metric.equation} if metric.equation else {})


def _variable_about(study: Study, name: str) -> dict[str, str]:
    paths = study.variables[name].paths(name)
    units = {UNITS.get(re.sub(r"(\[\d+\])+$", "", path).rpartition(".")[2], "") for path in paths}
    return _about(units.pop() if len(units) == 1 else "", ", ".join(paths))


def _attributes(study: Study, headers: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What a stranger needs to know about the file; nothing that differs from run to run."""
    distinct: dict[str, Mapping[str, Any]] = {
        json.dumps(header, sort_keys=True): header for header in headers
    }
    kept = [distinct[text] for text in sorted(distinct)]
    return {
        "title": study.name,
        "description": study.description,
        "study": study.text,
        "objectives": json.dumps(list(study.objectives)),
        "constraints": json.dumps({name: asdict(bound) for name, bound in study.constraints.items()}),
        "repeats": study.repeats.n,
        "criterion": CRITERION,
        "solver": ", ".join(sorted({str(header.get("solver", "")) for header in kept})),
        "versions": json.dumps([header.get("versions", {}) for header in kept]),
        "git": json.dumps([header.get("git", {}) for header in kept]),
    }
