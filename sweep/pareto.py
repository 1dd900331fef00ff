"""The front of a study over its trusted points, the point nearest to the ideal, and which points are tied."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from .config import AGGREGATES, bad_tail, find_metric, split_name

if TYPE_CHECKING:  # it and pymoo take half a second that ranks do not need
    import xarray as xr

Z = 1.96  # differences below Z standard deviations are ties: 95 % of a normal distribution
CRITERION = (
    "smallest Euclidean distance to the ideal point over the trusted front, each objective scaled to [0, 1] "
    "between its best and worst value on that front"
)


def direction(name: str) -> str:
    """'min' or 'max'; ValueError for what cannot be an objective."""
    metric = find_metric(name)
    if metric is None:
        raise ValueError(f"no metric `{name}`: `sweep metrics` lists them")
    if metric.direction is None:
        raise ValueError(f"`{name}` cannot be an objective: neither more nor less of it is better")
    return metric.direction


def aggregates(name: str) -> list[str]:
    """What results hold of a metric over several environments: mean, worst and the quantile of its bad tail."""
    metric = find_metric(name)
    tail = bad_tail(metric) if metric else None
    return ["mean"] if tail is None else ["mean", "worst", f"q{tail}"]


def aggregate(values: np.ndarray, how: str, better: str | None) -> np.ndarray:
    """A metric over the environments: (n, m) to (n,). NaN where one of them is missing, failed or undefined.

    Parameters
    ----------
    how : ``mean``; ``worst``, the largest where less is better and else the smallest; ``qNN``, the quantile below which
        NN % of the environments lie, linear between them. The bad tail is q90 where less is better, q10 where more is.
    better : 'min' or 'max': what of the metric is better
    """
    with np.errstate(invalid="ignore"):
        if how == "mean":
            return np.asarray(values.mean(axis=1))
        if how == "worst":
            return np.asarray(values.max(axis=1) if better == "min" else values.min(axis=1))
        found = np.quantile(values, int(how[1:]) / 100, axis=1)
        if np.isinf(values).any():  # between two numbers of which one is infinite: the worse
            worse = np.quantile(values, int(how[1:]) / 100, axis=1, method="higher" if better == "min" else "lower")
            found = np.where(np.isinf(values).any(axis=1), worse, found)
    return np.where(np.isnan(values).any(axis=1), np.nan, found)


def aggregate_deviation(deviations: np.ndarray, how: str) -> np.ndarray:
    """An estimate of the standard uncertainty of an aggregate: (n, m) of the environments to (n,).

    For the mean their mean, which it is where their errors go together, as those of a mesh do, and which it stays below
    where they do not. For the worst and for quantiles the largest, which is no bound: which environment is the worst is
    itself uncertain, and a maximum of noisy numbers is also biased.
    """
    return np.asarray(deviations.mean(axis=1) if how == "mean" else deviations.max(axis=1))


def column(dataset: xr.Dataset, name: str) -> xr.DataArray:
    """A metric over points or designs; over several environments its mean, or its ``_worst`` or ``_q10``."""
    if name in dataset and "environment" not in dataset[name].dims:
        return dataset[name]
    stem, said = split_name(name)
    if said[:1] == ("ensemble",):
        stem, said = f"{stem}_ensemble", said[1:]
    if not said and f"{stem}_mean" in dataset:
        return dataset[f"{stem}_mean"]
    if stem not in dataset or len(said) > 1 or not all(AGGREGATES.fullmatch(word) for word in said):
        raise ValueError(f"the results hold no metric `{name}`")
    values = dataset[stem]
    if "environment" not in values.dims:
        raise ValueError(f"`{name}` is over environments, and the results have one")
    how = said[0] if said else "mean"
    better = None if how == "mean" else direction(stem)
    return values.isel(environment=0, drop=True).copy(data=aggregate(values.values, how, better))


def trusted(dataset: xr.Dataset) -> np.ndarray:
    """(n,) bool: status OK, in every environment."""
    good = dataset["status"] == "OK"
    return (good.all("environment") if "environment" in good.dims else good).to_numpy()


def costs(dataset: xr.Dataset, objectives: Sequence[str]) -> np.ndarray:
    """(n, n_objective) with every objective turned so that less is better; NaN where there is none."""
    signs = [1.0 if direction(name) == "min" else -1.0 for name in objectives]
    return np.column_stack(
        [
            sign * column(dataset, name).to_numpy().astype(float)
            for sign, name in zip(signs, objectives, strict=True)
        ]
    )


def excesses(dataset: xr.Dataset) -> dict[str, np.ndarray]:
    """Each constraint of the study, as ``stroke <= 0.3``: (n,) by how much it is broken; at most 0 where it is kept.

    With several environments the worst of them counts, and of an aggregate over them its one number. NaN where there
    is no number.
    """
    found = {}
    for name, bound in json.loads(dataset.attrs.get("constraints", "{}")).items():
        for side, sign in (("min", -1.0), ("max", 1.0)):
            if bound[side] is not None:
                over = sign * (_bounded(dataset, name) - bound[side])
                if "environment" in over.dims:
                    over = over.max("environment", skipna=False)
                found[f"{name} {'>=' if side == 'min' else '<='} {bound[side]:g}"] = over.to_numpy()
    return found


def _bounded(dataset: xr.Dataset, name: str) -> xr.DataArray:
    """What a constraint bounds: a column, or an aggregate that is none; NaN where results have neither."""
    if name in dataset:
        return dataset[name]
    with suppress(ValueError):
        return column(dataset, name)
    return (dataset["status"] == "OK") * np.nan


def allowed(dataset: xr.Dataset) -> np.ndarray:
    """(n,) bool: every constraint of the study is kept; one without a number is not."""
    kept = np.ones(len(trusted(dataset)), dtype=bool)
    for over in excesses(dataset).values():
        kept &= over <= 0
    return kept


def eligible(dataset: xr.Dataset, objectives: Sequence[str]) -> np.ndarray:
    """Indices of points that may be on a front: trusted, every objective finite, no constraint broken."""
    finite = np.isfinite(costs(dataset, objectives)).all(axis=1)
    return np.flatnonzero(trusted(dataset) & finite & allowed(dataset))


def front(dataset: xr.Dataset, objectives: Sequence[str]) -> np.ndarray:
    """Indices (along ``point`` or ``design``) of the non-dominated trusted points, in order."""
    candidates = eligible(dataset, objectives)
    if not candidates.size:
        return candidates
    values = costs(dataset, objectives)[candidates]
    from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

    first = NonDominatedSorting().do(values, only_non_dominated_front=True)
    return np.sort(candidates[np.asarray(first, dtype=int)])


def best(dataset: xr.Dataset, objectives: Sequence[str], among: np.ndarray | None = None) -> int | None:
    """Index of the point on the front that meets :data:`CRITERION`; None without trusted points."""
    chosen = front(dataset, objectives) if among is None else np.asarray(among)
    if not chosen.size:
        return None
    values = costs(dataset, objectives)[chosen]
    ideal, span = values.min(axis=0), np.ptp(values, axis=0)
    scaled = (values - ideal) / np.where(span > 0, span, 1.0)
    return int(chosen[np.argmin(np.linalg.norm(scaled, axis=1))])


def deviations(dataset: xr.Dataset, objectives: Sequence[str]) -> np.ndarray:
    """(n, n_objective) standard uncertainty of each objective; NaN where it is not known, or was not asked for.

    Of an ``_ensemble`` it is that of one run, of which its mean has the numerical part and less of the chance: too many
    points are tied rather than too few.
    """
    found = np.full((len(trusted(dataset)), len(objectives)), np.nan)
    for j, name in enumerate(objectives):
        stem, words = split_name(name)
        if f"{stem}_sd" in dataset:
            known = dataset[f"{stem}_sd"]
            values = known.values.astype(float)
            if "environment" in known.dims:
                values = aggregate_deviation(values, next((word for word in words if word != "ensemble"), "mean"))
            found[:, j] = values
    return found


def spreads(dataset: xr.Dataset, objectives: Sequence[str]) -> np.ndarray:
    """(n, n_objective) half range of each objective over perturbed repetitions: 0 where none were asked for, inf where
    they were asked for and none could be trusted (such a point is tied with every other).

    Of an ``_ensemble``, the mean of n + 1 runs, it is divided by sqrt(n + 1), as a mean's deviation is, where results
    say how many repetitions n the study asks for. It is a little small where some of them were not trusted.
    """
    n = len(trusted(dataset))
    found = np.zeros((n, len(objectives)))
    for j, name in enumerate(objectives):
        stem = split_name(name)[0]
        if f"{stem}_spread" in dataset:
            spread = dataset[f"{stem}_spread"]
            if "environment" in spread.dims:
                spread = spread.max("environment", skipna=False)
            found[:, j] = share(dataset, name) * np.nan_to_num(spread.to_numpy().astype(float), nan=np.inf)
    return found


def share(dataset: xr.Dataset, name: str) -> float:
    """The error bar of a metric over that of one run: 1/sqrt(n + 1) for an ``_ensemble`` of a run and n repetitions."""
    repeats = int(dataset.attrs.get("repeats", 0)) if "ensemble" in split_name(name)[1] else 0
    return float((repeats + 1) ** -0.5)


def barred(dataset: xr.Dataset, objectives: Sequence[str]) -> list[str]:
    """Where each objective's error bar is from: ``sd``, ``spread``, or '' where it has none and ties are not known."""
    stems = [split_name(name)[0] for name in objectives]
    return [next((kind for kind in ("sd", "spread") if f"{stem}_{kind}" in dataset), "") for stem in stems]


def bars(dataset: xr.Dataset, objectives: Sequence[str]) -> np.ndarray:
    """(n, n_objective) the error bars that :func:`barred` names; 0, inf or NaN where there are none."""
    kinds = np.array(barred(dataset, objectives)) == "sd"
    return np.where(kinds, deviations(dataset, objectives), spreads(dataset, objectives))


def significant(
    dataset: xr.Dataset, objectives: Sequence[str], among: np.ndarray | None = None, z: float = Z
) -> np.ndarray:
    """(n_front,) bool: False for a point tied with a better one.

    Two points of the front are tied when in every objective they differ by no more than ``z`` standard deviations of
    their difference, z sqrt(sd_a^2 + sd_b^2); where results hold no ``_sd`` but a ``_spread``, by the sum of their
    spreads. A point whose error bar was asked for and is not known is tied with every other in that objective; an
    objective without error bars ties no points. Of tied points the one nearest to the ideal stands for the others.
    """
    chosen = front(dataset, objectives) if among is None else np.asarray(among)
    if not chosen.size:
        return np.zeros(0, dtype=bool)
    values, widths = costs(dataset, objectives)[chosen], spreads(dataset, objectives)[chosen]
    normal = np.array([kind == "sd" for kind in barred(dataset, objectives)])
    sds = np.nan_to_num(deviations(dataset, objectives)[chosen], nan=np.inf)
    span = np.ptp(values, axis=0)
    scaled = (values - values.min(axis=0)) / np.where(span > 0, span, 1.0)
    order = np.argsort(np.linalg.norm(scaled, axis=1), kind="stable")
    kept: list[int] = []
    for i in order:
        gaps = np.abs(values[kept] - values[i])
        near = np.where(normal, z * np.hypot(sds[kept], sds[i]), widths[kept] + widths[i])
        if not np.any(np.all(gaps <= near, axis=1)):
            kept.append(int(i))
    found = np.zeros(len(chosen), dtype=bool)
    found[kept] = True
    return found
