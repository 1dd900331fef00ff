"""Which variables matter: Sobol indices and Morris screening that survive failed runs and say what they left out.

A design of kind `saltelli` is made of blocks of d + 2 points (A; A with one column of B, d times; B), one of kind
`morris` of trajectories of d + 1. An index needs whole blocks: a block with a point that failed, is not trusted, or has
no finite metric is left out as a whole, for that metric. Nothing is put in its place. What is left is a smaller design
of the same kind, whose indices are unbiased as long as points do not fail where the metric is special; whether they
cluster in a variable is tested. Any other random design gives first-order indices alone (RBD-FAST), of single points.
The estimators are SALib's (Saltelli 2010 and Jansen; Campolongo; Tarantola and Plischke), with bootstrap intervals.
"""

from __future__ import annotations

import json
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from .config import Study, find_metric
from .pareto import column
from .space import LEVELS, block_size, problem, salib, unit_samples
from .store import open_study, outcome, searched, study_of

LEAST = {"saltelli": 16, "morris": 4, "given": 64}  # blocks or points, below which indices mean nothing
RESAMPLES = 200
CONFIDENCE = 0.95
RISK = 0.01  # of calling failed points clustered where they are not, over all variables
MANY = 10  # distinct values, from which a variable counts as continuous
INDICES = {
    "saltelli": ("S1", "S1_conf", "ST", "ST_conf"),
    "given": ("S1", "S1_conf"),
    "morris": ("mu_star", "mu_star_conf", "mu", "sigma"),
}
MEANING = {
    "S1": "share of the variance that the variable explains alone",
    "ST": "share of the variance that is left when all others are known",
    "mu_star": "mean size of the effect of crossing the variable's range",
    "mu": "mean effect of crossing the variable's range",
    "sigma": "standard deviation of that effect: interactions and curvature",
}


class Left(NamedTuple):
    """What the indices of a metric do without."""

    blocks: int  # of all
    complete: int
    points: int  # that cannot be used
    reasons: dict[str, int]  # status, or what else: how many
    clusters: dict[str, float]  # variable: chance of such a cluster by luck


def sensitivity_of(directory: str | Path, names: Sequence[str] = ()) -> xr.Dataset:
    """As :func:`indices`, of a folder; by default for the study's objectives. ValueError for the folder of a search."""
    if searched(directory):
        raise ValueError(
            f"{directory} holds a search, which chooses its designs: `sweep run` the study with "
            "`sampler: {kind: saltelli, n: 64}` in a folder of its own"
        )
    study, results = study_of(directory), open_study(directory)
    return indices(study, results, names or study.objectives)


def indices(study: Study, results: xr.Dataset, names: Sequence[str], seed: int = 0) -> xr.Dataset:
    """Sensitivity of metrics to the study's variables.

    Parameters
    ----------
    results : of `open_study`; several environments count as their mean, and a design must be trusted in all
    seed : of the bootstrap

    Returns
    -------
    dataset over ``metric`` and ``variable`` with S1, ST (saltelli), S1 (other random designs) or mu_star, mu, sigma
    (morris), half widths of their 95 % intervals as ``..._conf``, ``blocks``, ``complete``, ``points_left_out``
    (metric), ``variance`` of the metric over what is used, and ``notes`` (metric), JSON of :class:`Left` and sentences

    Raises
    ------
    ValueError
        Where the design has no variables, is a grid or given, a metric is unknown, or SALib is not installed.
    """
    sampler = study.sampler
    if sampler is None or not study.variables:
        raise ValueError("the study has no design to take indices from: it needs `variables` and a `sampler`")
    if sampler.kind == "grid":
        raise ValueError("a grid has no sensitivity indices: use `kind: saltelli` or `morris`, or a random design")
    if sampler.kind == "given":
        raise ValueError(
            "given designs have no sensitivity indices: they are not drawn at random. Use `kind: saltelli` or `morris`"
        )
    kind = sampler.kind if sampler.kind in ("saltelli", "morris") else "given"
    salib()
    index = "design" if "environment" in results.dims else "point"
    count = results.sizes[index]
    x = unit_samples(study)[:count]
    variables = list(study.variables)
    rows: dict[str, Any] = {name: np.full((len(names), len(variables)), np.nan) for name in INDICES[kind]}
    left, notes, variance = [], [], np.full(len(names), np.nan)
    for k, name in enumerate(names):
        if find_metric(name) is None:
            raise ValueError(f"no metric `{name}`: `sweep metrics` lists them")
        y = column(results, name).values.astype(float)
        used, why = _usable(results["status"].values.reshape(count, -1), y)
        size = block_size(study) if kind != "given" else 1
        whole = np.asarray(used[: count // size * size].reshape(-1, size).all(axis=1))
        rest = Left(len(whole), int(whole.sum()), int((~used).sum()), why, _clusters(x, used, variables))
        kept = np.flatnonzero(np.repeat(whole, size))
        said = sentences(rest, kind)
        if rest.complete < LEAST[kind]:
            said.append(f"no indices: {rest.complete} are left, and {LEAST[kind]} are the least")
        elif np.ptp(y[kept]) <= 1e-12 * np.abs(y[kept]).max():
            said.append("no indices: the metric does not vary")
        else:
            variance[k] = float(np.var(y[kept]))
            for entry, values in _analysed(kind, variables, x[kept], y[kept], seed).items():
                rows[entry][k] = values
        left.append(rest)
        notes.append(json.dumps({"left": rest._asdict(), "notes": said}))
    about = {"metric": list(names), "variable": variables}
    data: dict[str, Any] = {
        entry: (("metric", "variable"), values, _about(entry, names)) for entry, values in rows.items()
    }
    data |= {
        "blocks": ("metric", [one.blocks for one in left]),
        "complete": ("metric", [one.complete for one in left]),
        "points_left_out": ("metric", [one.points for one in left]),
        "variance": ("metric", variance),
        "notes": ("metric", np.array(notes, dtype=object)),
    }
    return xr.Dataset(data, coords=about, attrs={"kind": kind, "sampler": sampler.kind, "study": study.name})


def _about(entry: str, names: Sequence[str]) -> dict[str, str]:
    stem = entry.removesuffix("_conf")
    text = MEANING[stem] if stem == entry else f"half width of the {CONFIDENCE:.0%} interval of {stem}"
    return {"units": "1" if stem in ("S1", "ST") else "of the metric", "long_name": text}


def _usable(status: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    """Which designs have a trusted, finite metric, and why the others have not."""
    good = np.array([all(outcome(str(s)) == "trusted" for s in row) for row in status])
    used = good & np.isfinite(y)
    why = Counter(next(str(s) for s in row if outcome(str(s)) != "trusted") for row in status[~good])
    undefined = int((good & ~used).sum())
    return used, dict(why.most_common()) | ({"infinite or undefined": undefined} if undefined else {})


def _clusters(x: np.ndarray, used: np.ndarray, variables: Sequence[str]) -> dict[str, float]:
    """Variables along which the designs left out are not spread like the others, and the chance of that by luck.

    Designs of a block share coordinates. So each distinct coordinate counts once, as left out where a design with it
    is, and both groups are compared by Kolmogorov and Smirnov's test; the few values of a screening or a discrete
    variable by chi-square over the designs.
    """
    from scipy.stats import chi2_contingency, ks_2samp

    found: dict[str, float] = {}
    if used.all() or not used.any():
        return found
    for j, name in enumerate(variables):
        values, group = np.unique(x[:, j], return_inverse=True)
        lost = np.bincount(group, ~used)
        if len(values) > MANY:
            if not (lost > 0).any() or (lost > 0).all():
                continue
            chance = float(ks_2samp(values[lost > 0], values[lost == 0]).pvalue)
        elif len(values) > 1:
            chance = float(chi2_contingency(np.stack([lost, np.bincount(group, used)])).pvalue)
        else:
            continue
        if chance < RISK / len(variables):
            found[name] = chance
    return found


def sentences(left: Left, kind: str) -> list[str]:
    """What was left out, and what that does to the indices."""
    what = {"saltelli": "blocks", "morris": "trajectories", "given": "points"}[kind]
    found = []
    if left.complete < left.blocks:
        why = ", ".join(f"{n} {reason}" for reason, n in left.reasons.items())
        held = f"{left.points} point{'s' * (left.points != 1)} that cannot be used ({why})"
        found.append(f"{left.blocks - left.complete} of {left.blocks} {what} left out, for {held}")
    if left.clusters:
        where = ", ".join(f"{name} (p = {chance:.1g})" for name, chance in left.clusters.items())
        found.append(f"those points cluster along {where}: the indices are those of the rest of the design space")
    return found


def _analysed(kind: str, variables: Sequence[str], x: np.ndarray, y: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    from SALib.analyze import morris, rbd_fast, sobol

    what: Any = problem(variables)
    common: Any = {"num_resamples": RESAMPLES, "conf_level": CONFIDENCE, "seed": seed}
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        if kind == "saltelli":
            made = sobol.analyze(what, y, calc_second_order=False, **common)
        elif kind == "morris":
            made = morris.analyze(what, x, y, num_levels=LEVELS, **common)
        else:
            made = rbd_fast.analyze(what, x, y, **common)
    return {name: np.array(np.ma.filled(made[name], np.nan), dtype=float) for name in INDICES[kind]}
