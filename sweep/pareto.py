"""The front of a study over its trusted points, the point nearest to the ideal, and which points are tied."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import xarray as xr
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

from .config import find_metric, stem

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


def column(dataset: xr.Dataset, name: str) -> xr.DataArray:
    """A metric over points or designs; over several environments its mean, or its ``_worst`` if so named."""
    if name in dataset and "environment" not in dataset[name].dims:
        return dataset[name]
    short = name.removesuffix("_mean").removesuffix("_worst")
    if name == short and f"{short}_mean" in dataset:
        return dataset[f"{short}_mean"]
    if short not in dataset:
        raise ValueError(f"the results hold no metric `{name}`")
    values = dataset[short]
    if name.endswith("_worst"):
        worst = values.max if direction(short) == "min" else values.min
        return worst("environment", skipna=False)
    return values.mean("environment", skipna=False)


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

    With several environments the worst of them counts. NaN where there is no number.
    """
    found = {}
    for name, bound in json.loads(dataset.attrs.get("constraints", "{}")).items():
        for side, sign in (("min", -1.0), ("max", 1.0)):
            if bound[side] is not None:
                values = dataset[name] if name in dataset else xr.full_like(dataset["status"], np.nan, dtype=float)
                over = sign * (values - bound[side])
                if "environment" in over.dims:
                    over = over.max("environment", skipna=False)
                found[f"{name} {'>=' if side == 'min' else '<='} {bound[side]:g}"] = over.to_numpy()
    return found


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


def spreads(dataset: xr.Dataset, objectives: Sequence[str]) -> np.ndarray:
    """(n, n_objective) half range of each objective over perturbed repetitions: 0 where none were asked for, inf where
    they were asked for and none could be trusted (such a point is tied with every other)."""
    n = len(trusted(dataset))
    found = np.zeros((n, len(objectives)))
    for j, name in enumerate(objectives):
        if f"{stem(name)}_spread" in dataset:
            spread = dataset[f"{stem(name)}_spread"]
            if "environment" in spread.dims:
                spread = spread.max("environment", skipna=False)
            found[:, j] = np.nan_to_num(spread.to_numpy().astype(float), nan=np.inf)
    return found


def significant(
    dataset: xr.Dataset, objectives: Sequence[str], among: np.ndarray | None = None
) -> np.ndarray:
    """(n_front,) bool: False for a point tied with a better one.

    Two points of the front are tied when in every objective they differ by no more than the sum of their
    spreads. Of tied points the one nearest to the ideal stands for the others.
    """
    chosen = front(dataset, objectives) if among is None else np.asarray(among)
    if not chosen.size:
        return np.zeros(0, dtype=bool)
    values, widths = costs(dataset, objectives)[chosen], spreads(dataset, objectives)[chosen]
    span = np.ptp(values, axis=0)
    scaled = (values - values.min(axis=0)) / np.where(span > 0, span, 1.0)
    order = np.argsort(np.linalg.norm(scaled, axis=1), kind="stable")
    kept: list[int] = []
    for i in order:
        gaps = np.abs(values[kept] - values[i])
        if not np.any(np.all(gaps <= widths[kept] + widths[i], axis=1)):
            kept.append(int(i))
    found = np.zeros(len(chosen), dtype=bool)
    found[kept] = True
    return found
