"""What a run says while it works and when it ends: heartbeat, grouped failures, trust, tables."""

from __future__ import annotations

import difflib
import json
import logging
import re
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from .config import Study, find_metric, split_name
from .distribute import Done
from .locks import Holder
from .pareto import allowed, barred, bars, column, excesses, share, trusted
from .plan import PilotRun, Plan
from .store import Journal, outcome

if TYPE_CHECKING:
    import xarray as xr

EVERY_SECONDS = 30.0, 600.0  # between two lines of the log: at first, and at most
EVERY_SHARE = 0.05
ROW_BYTES = 2500  # a journal's row and its share of results.nc
MOST_WRITERS = 100  # that a table lists
SETTLED, MARCHED = ("harmonics", "multiplier"), ("steps_per_period",)  # columns of harmonic balance, of a march

SUFFIXES = """Over several environments: <metric>_mean, _worst, and _qNN, the quantile below which NN % of them lie; the
bad tail is q10 where more is better and q90 where less is. With `uncertainty` in the study: <metric>_sd, its standard
uncertainty; with `repeats`: <metric>_spread of the objectives, half their range over a run and its perturbed
repetitions, and <metric>_ensemble, their mean, which may be an objective itself and has _mean, _worst and _qNN too."""

log = logging.getLogger(__name__)


def duration(seconds: float) -> str:
    """Seconds as people say them."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Progress:
    """Counts rows and logs a line each 30 s or 5 %; less often as a run gets longer, for a log of a week of lines."""

    def __init__(self, total: int) -> None:
        self.total, self.done = total, 0
        self.counts: Counter[str] = Counter()
        self._began = self._said = time.monotonic()
        self._said_at = 0
        self._first: float | None = None  # when the first row came; what went before was compiling
        self._before = 0  # rows that came with it

    def report(self, done: Done) -> None:
        if self._first is None and done.count:
            self._first, self._before = time.monotonic(), done.count
        self.done += done.count
        self.counts[outcome(done.status)] += done.count
        if outcome(done.status) == "failed":
            log.debug("%s: %s", done.status, done.message)

    def beat(self) -> None:
        """Say how far it is, if it is time."""
        now = time.monotonic()
        elapsed = now - self._said
        every = min(max((now - self._began) / 20, EVERY_SECONDS[0]), EVERY_SECONDS[1])
        far = self.done - self._said_at >= EVERY_SHARE * self.total
        if elapsed < 1.0 or not (elapsed >= every or far):
            return
        self._said, self._said_at = now, self.done
        log.info("%s", self.line())

    def line(self) -> str:
        share = 100 * self.done / max(self.total, 1)
        text = f"{self.done} of {self.total} points done ({share:.0f} %)"
        text += "".join(
            f", {self.counts[kind]} {kind}" for kind in ("failed", "untrusted") if self.counts[kind]
        )
        if self._first is not None and self._before < self.done:
            each = (time.monotonic() - self._first) / (self.done - self._before)
            text += f", {1 / each:.3g} points/s" if each > 0 else ""
            if self.done < self.total:
                text += f", about {duration(each * (self.total - self.done))} left"
        return text


# --------------------------------------------------------------------------------------------- trust

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def unnumbered(message: str) -> str:
    """A message without its numbers."""
    return _NUMBER.sub("#", message)


def grouped(pairs: Iterable[tuple[str, str]]) -> list[tuple[int, str, str]]:
    """(count, status, message) of equal failures, most frequent first; numbers in messages are ignored."""
    counts: Counter[tuple[str, str]] = Counter()
    first: dict[tuple[str, str], str] = {}
    for (status, message), n in (pairs if isinstance(pairs, Counter) else Counter(pairs)).items():
        group = (status, unnumbered(message))
        counts[group] += n
        first.setdefault(group, message)
    return [(count, group[0], first[group]) for group, count in counts.most_common()]


def trust_summary(pairs: Iterable[tuple[str, str]]) -> str:
    """How many points may be believed, and why the others may not, from each point's (status, message)."""
    groups = pairs if isinstance(pairs, Counter) else Counter(pairs)
    counts: Counter[str] = Counter()
    for (status, _), n in groups.items():
        counts[outcome(status)] += n
    total = counts.total()
    lines = [
        f"trusted    {counts['trusted']:6d} of {total} ({100 * counts['trusted'] / max(total, 1):.1f} %)"
    ]
    for kind in ("untrusted", "failed"):
        if counts[kind]:
            lines.append(f"{kind:<10} {counts[kind]:6d}")
            found = grouped(Counter({pair: n for pair, n in groups.items() if outcome(pair[0]) == kind}))
            lines += [f"    {count:6d}  {status}: {message or 'no message'}" for count, status, message in found[:8]]
            if len(found) > 8:
                lines.append(f"    {sum(count for count, _, _ in found[8:]):6d}  others")
    if counts["missing"]:
        lines.append(f"missing    {counts['missing']:6d}  not run yet")
    return "\n".join(lines)


# --------------------------------------------------------------------------------------------- tables


def number(value: Any) -> str:
    """Four digits, or the text."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], console: Console) -> str:
    """A table as text: boxed on a terminal, plain columns elsewhere."""
    cells = [[number(cell) for cell in row] for row in rows]
    if not console.is_terminal:
        text = _plain(columns, cells)
        return f"{title}\n{text}" if title else text
    made = Table(title=title or None, title_justify="left")
    for heading in columns:
        made.add_column(heading)
    for row in cells:
        made.add_row(*row)
    with console.capture() as capture:
        console.print(made)
    return capture.get().rstrip()


def _plain(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Columns of text, each as wide as its widest cell."""
    every = [columns, *rows]
    widths = [max(len(row[i]) for row in every) for i in range(len(columns))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in every]
    return "\n".join(lines)


def front_table(
    dataset: xr.Dataset,
    objectives: Sequence[str],
    chosen: Sequence[int] | np.ndarray,
    tied: Sequence[bool] | np.ndarray,
    best: int | None,
    console: Console,
) -> str:
    """The front by its first objective: key, design variables, objectives; the best point is marked."""
    broken = broken_constraints(dataset)
    if not len(chosen):
        why = f"; {broken}" if broken else ""
        return f"no trusted points that may be on a front, and so no front: `sweep status` says why{why}"
    index = "design" if "environment" in dataset.dims else "point"
    variables = [str(name) for name, c in dataset.coords.items() if c.dims == (index,) and name != "design"]
    columns = {name: column(dataset, name).values for name in objectives}
    keys = dataset["key"].values.reshape(dataset.sizes[index], -1)[:, 0]
    widths = bars(dataset, objectives)
    first = columns[objectives[0]]
    rows = [
        (
            str(keys[i])[:12],
            *(dataset[name].values[i].item() if dataset[name].dtype.kind == "f" else str(dataset[name].values[i])
              for name in variables),
            *(
                _with_bar(float(columns[name][i]), float(widths[i, j]), kind)
                for j, (name, kind) in enumerate(zip(objectives, barred(dataset, objectives), strict=True))
            ),
            "best" if i == best else "tied" if mark else "",
        )
        for i, mark in sorted(zip(chosen, tied, strict=True), key=lambda pair: float(first[pair[0]]))
    ]
    units = [f"{name} [{dataset[name].attrs.get('units', '?')}]" for name in variables]
    title = f"front: {len(rows)} of {dataset.sizes[index]} designs"
    return table(title, ("key", *units, *objectives, ""), rows, console) + (f"\n{broken}" if broken else "")


def broken_constraints(dataset: xr.Dataset) -> str:
    """How many trusted points break which constraint, and so are on no front; nothing where none does."""
    good = trusted(dataset)
    counts = {name: int(np.count_nonzero(good & ~(over <= 0))) for name, over in excesses(dataset).items()}
    said = ", ".join(f"{name} ({count})" for name, count in counts.items() if count)
    total = int(np.count_nonzero(good & ~allowed(dataset)))
    return f"left out: {total} trusted points that break {said}" if said else ""


def _with_bar(value: float, bar: float, kind: str) -> str:
    """A value with its error bar, or a question mark where that is not known."""
    return number(value) + ("" if not kind else f" ± {bar:.2g}" if np.isfinite(bar) else " ± ?")


def ties_note(
    dataset: xr.Dataset, objectives: Sequence[str], chosen: np.ndarray, tied: np.ndarray, z: float
) -> str:
    """What the error bars of a front are, which are not known, and how many points they tie."""
    kinds = dict(zip(objectives, barred(dataset, objectives), strict=True))
    widths = dict(zip(objectives, bars(dataset, objectives)[chosen].T, strict=True))
    lines = []
    for kind, words in (
        ("sd", f"standard uncertainty of {{}}: points closer than {z:g} sd of their difference are tied"),
        ("spread", "half range of {} over repeats: points closer than the sum of theirs are tied"),
        ("", "no error bars of {}: there it is not known whether points differ; `uncertainty` asks for them"),
    ):
        names = [name for name, found in kinds.items() if found == kind]
        lines += [words.format(", ".join(names))] if names else []
    means = [name for name in objectives if "ensemble" in split_name(name)[1]]
    if single := [name for name in means if kinds[name] and (kinds[name] == "sd" or share(dataset, name) == 1)]:
        said = ", ".join(single)
        lines.append(f"error bars of {said} are those of one run; their means are known better, and fewer are tied")
    if shared := [name for name in means if kinds[name] == "spread" and share(dataset, name) < 1]:
        runs = int(dataset.attrs["repeats"]) + 1
        lines.append(f"half ranges of {', '.join(shared)} are divided by sqrt({runs}), as means of {runs} runs")
    for name, found in widths.items():
        lost = int((~np.isfinite(found)).sum())
        if kinds[name] and lost:
            lines.append(f"uncertainty of {name} unknown at {lost} of {len(found)} points: these tie there with any")
    if any(kinds.values()):
        lines.append(f"{int(np.sum(tied))} of {len(tied)} points of the front are tied with a better one")
    return "\n".join(lines)


def sensitivities(found: xr.Dataset, console: Console) -> str:
    """A table of indices for each metric, and what they leave out."""
    what = {"saltelli": "blocks", "morris": "trajectories", "given": "points"}[str(found.attrs["kind"])]
    entries = [str(name) for name in found.data_vars if found[name].dims == ("metric", "variable")]
    parts = []
    for k, metric in enumerate(found["metric"].values):
        here = found.isel(metric=k)
        rows = [(str(v), *(float(here[e][j]) for e in entries)) for j, v in enumerate(found["variable"].values)]
        used = f"{int(here['complete'])} of {int(here['blocks'])} {what}"
        title = f"{metric}: {used} of a {found.attrs['sampler']} design"
        parts.append(table(title, ("variable", *(e.replace("_conf", " ±") for e in entries)), rows, console))
        parts += [f"  {sentence}" for sentence in json.loads(str(here["notes"].values))["notes"]]
        parts.append("")
    return "\n".join(parts).rstrip()


def one_point(dataset: xr.Dataset, key: str, criterion: bool = False) -> str:
    """Everything about one point: what it is and how it ended, then a table of its metrics."""
    place = np.argwhere(dataset["key"].values == key)[0]
    point = dataset.isel(dict(zip(dataset["key"].dims, place, strict=True)))
    index = "design" if "environment" in dataset.dims else "point"
    names = [str(name) for name in point.data_vars]
    metrics = [n for n in names if find_metric(n) is not None and split_name(n)[1] in ((), ("ensemble",))]
    shown = ["key", "status", "message", *(str(n) for n in point.coords)]
    shown += [n for n in names if n not in shown and _stem(n) not in metrics]
    harmonic = "method" in point and str(point["method"].values) == "harmonic"
    shown = [n for n in shown if n not in (MARCHED if harmonic else SETTLED)]
    lines = [f"criterion: {dataset.attrs['criterion']}", ""] if criterion else []
    for name in shown:
        value, about = point[name].values.item(), point[name].attrs
        if value != "" and not (name == "point" and index == "point"):
            text = f"{name:<20} {number(value)}{_unit(about):<10}".rstrip()
            lines.append(f"{text:<44}  {about.get('long_name', '')}".rstrip())
    aggregates = [kind for kind in ("mean", "worst", "q10", "q90") if any(f"{n}_{kind}" in point for n in metrics)]
    tails = [kind for kind in aggregates if kind[0] == "q"]  # one column for both: each metric has one bad tail
    heads = [kind for kind in aggregates if kind[0] != "q"] + (["bad tail"] if tails else [])
    rows = []
    for name in metrics:
        kind = next((kind for kind in ("sd", "spread") if f"{name}_{kind}" in point), "")
        value = _with_bar(point[name].item(), point[f"{name}_{kind}"].item() if kind else 0.0, kind)
        plain = [f"{name}_{kind}" for kind in heads if kind != "bad tail"]
        cells = [number(point[n].item()) if n in point else "" for n in plain]
        if tails:
            tail = next((kind for kind in tails if f"{name}_{kind}" in point), None)
            cells.append(f"{number(point[f'{name}_{tail}'].item())} ({tail})" if tail else "")
        about = point[name].attrs
        rows.append(
            (
                name,
                value,
                *cells,
                _unit(about).strip(),
                about.get("long_name", ""),
            )
        )
    return "\n".join([*lines, "", _plain(("metric", "value", *heads, "unit", "meaning"), rows)])


def _stem(name: str) -> str:
    """The metric that a column is about: ``delta`` for ``delta_mean`` and ``delta_spread_worst``."""
    return split_name(name)[0]


def _unit(about: Mapping[str, Any]) -> str:
    return "" if about.get("units", "1") == "1" else f" {about['units']}"


def no_such_key(text: str, every: Sequence[str], found: Sequence[str]) -> str:
    """What to say of a key that is nobody's, or of several points."""
    if found:
        return f"{text} is the beginning of {len(found)} keys: {', '.join(found[:5])}"
    near = difflib.get_close_matches(text, every, n=3, cutoff=0.0)
    return f"no point has the key {text}; the nearest: {', '.join(near) or 'none, there are no points'}"


# --------------------------------------------------------------------------------------------- begin, end


def about(entry: Any) -> str:
    """A catalogue entry's one-line meaning."""
    return str(getattr(entry, "meaning", entry))


def describe(study: Study, plan: Plan, pilots: Sequence[PilotRun]) -> str:
    """What would run, on what, and what it will cost; costs are those of the pilots on this machine."""
    points, search = len(plan), study.optimise
    head = (
        f"{study.name}: {len(plan.designs)} designs in {len(plan.environments)} environment"
        f"{'s' * (len(plan.environments) > 1)}, {points} points, {int(plan.keys.firsts().sum())} of them distinct"
    )
    if study.sampler is None:
        points = search.evaluations * len(plan.environments)
        head = f"{study.name}: a search, {search.evaluations} designs by {search.algorithm}, {points} points"
    lines = [
        head,
        f"variables    {', '.join(study.variables) or 'none'}",
        f"sampler      {study.sampler.kind}, seed {study.sampler.seed}" if study.sampler else "sampler      none",
        f"objectives   {', '.join(study.objectives)}",
        f"baseline     {study.settings.baseline}, {plan.different} different",
        f"time limit   {duration(study.time_limit) if study.time_limit else 'none'} for a point",
    ]
    for pilot in pilots:
        r = pilot.response
        lines += [
            f"pilot        {pilot.label}: {r.status.name}{': ' + r.message if r.message else ''}",
            f"             {r.model} by {r.method}, {r.segments} segments ({r.reason or 'as asked'})",
            f"             {r.nodes_per_wave:.3g} nodes in the shortest wave, "
            f"{_fineness(r)}, energy residual {r.energy_residual:.1e}",
            f"             {r.cost.steps} steps, {r.cost.evaluations} evaluations, {r.cost.seconds:.2f} s",
        ]
    asked = study.settings.uncertainty  # a tenth of the tolerance costs some 10^(1/5), a mesh the third power
    more = 0.0 if asked is None else asked.runs + 1.6 + asked.refine**3
    runs = round(points * (1 + study.repeats.n + more))
    seconds = [pilot.response.cost.seconds for pilot in pilots]
    work = sum(pilot.work for pilot in pilots) / max(len(pilots), 1)
    mean = sum(seconds) / max(len(seconds), 1)
    lines += [
        f"cost         about {runs * mean / 3600:.2g} core-hours: {runs} runs of {mean:.2g} s "
        f"({min(seconds, default=0):.2g} to {max(seconds, default=0):.2g} s); {runs * work:.2g} node-steps",
        f"disk         about {points * ROW_BYTES / 1e6:.1f} MB",
    ]
    return "\n".join(lines)


def _fineness(response: Any) -> str:
    """How finely a run resolves time."""
    if response.method == "harmonic":
        return f"{response.harmonics} harmonics, largest Floquet multiplier {response.multiplier:.3g}"
    return f"{response.steps_per_period:.3g} steps in the shortest period"


def ending(pairs: Iterable[tuple[str, str]], interrupted: str, results: Path | None, directory: Path) -> str:
    """The last words of a run: trust, and where it leaves off."""
    lines = [trust_summary(pairs)]
    if interrupted:
        lines.append(f"interrupted by {interrupted}: the same command goes on from here")
    elif results is not None:
        lines.append(f"results    {results}")
    else:
        lines.append(f"this slice is done; after the others: sweep merge {directory}")
    return "\n".join(lines)


def outlook(missing: int, rate: float, working: int) -> str:
    """When the missing points will be there, at a pace [points/s] of so many live runs."""
    if not missing:
        return "complete"
    if not working:
        return f"{missing} points to go; no run works on them now"
    if rate <= 0:
        return f"{missing} points to go; {working} at work, no pace yet"
    return f"{missing} points to go, {rate:.3g} points/s, about {duration(missing / rate)} left"


def writers_table(journals: Sequence[Journal], live: Sequence[Holder], now: float, console: Console) -> str:
    """Who has written rows: rank or array task, host, job, rows, failures, pace, and whether it is at work."""
    working = {holder.part for holder in live}
    rows = []
    numbers = re.compile(r"(\d+)")
    for journal in sorted(journals, key=lambda j: [int(n) if n.isdigit() else n for n in numbers.split(j.writer)]):
        part, _, rank = journal.writer.rpartition("-")
        at_work = part in working
        name = f"{part} rank {rank}".strip() if rank != "0" or not part else part
        last = duration(max(now - journal.touched, 0.0)) + " ago" if journal.rows else "-"
        pace = f"{journal.pace:.3g}" if at_work else "-"
        counts = journal.rows, journal.failed
        rows.append((name, journal.host, journal.job or "-", *counts, pace, last, "yes" if at_work else "no"))
    headings = ("writer", "host", "job", "rows", "failed", "points/s", "last row", "at work")
    shown = rows if len(rows) <= MOST_WRITERS else [row for row in rows if row[-1] == "yes"][:MOST_WRITERS]
    text = table("", headings, shown, console)
    return text if len(shown) == len(rows) else f"{text}\n... and {len(rows) - len(shown)} others"


def charted(data: xr.Dataset, console: Console) -> str:
    """The runs of a chart that are worth their seconds, and what other programs need for the same errors."""
    runs, chaotic = data.to_dataframe(), bool(data.attrs["chaotic"])
    best = runs[runs["envelope"].astype(bool)].sort_values("seconds")
    numbers = ("segments", "knob", "error", "standard_error" if chaotic else "estimated_error", "seconds")
    columns = ("model", "method", "segments", "knob", "error", "standard error" if chaotic else "estimated", "seconds")
    rows = [(r["model"], r["method"], *(number(r[name]) for name in numbers)) for _, r in best.iterrows()]
    kind = f"{data.attrs['uncertainty']:.1e}"
    if chaotic:
        kind = f"chaotic: waveforms do not converge, means of {data.attrs['ensemble']} perturbed runs are compared"
    head = f"reference  {data.attrs['reference']}\nuncertainty  {kind}"
    title = "worth their seconds" + (f"; error: largest of {data.attrs['objectives']}" if chaotic else "")
    parts = [head, table(title, columns, rows, console)]
    wrong = runs[(runs["status"] == "OK") & (runs["error"] > 3 * np.fmax(runs["estimated_error"], 0.05))]
    if len(wrong) and not chaotic:
        parts.append(f"{len(wrong)} trusted runs err by more than three times what they estimate")
    others = [_beside(rows, best) for _, rows in runs[runs["status"] == "UNCHECKED"].groupby("program")]
    lines = [line for found in others for line in found]
    if lines:
        heads = ("program", "segments", "step", "error", "seconds", "ours at that error", "times cheaper")
        parts.append(table("other programs, their best runs (no ledger: unchecked)", heads, lines, console))
    parts.append(data.attrs.get("peers", ""))
    return "\n".join(x for x in parts if x)


def _beside(theirs: Any, ours: Any) -> list[tuple[Any, ...]]:
    """The lower envelope of another program, each run beside our cheapest of at most its error."""
    found, least = [], float("inf")
    for _, run in theirs[np.isfinite(theirs["error"])].sort_values("seconds").iterrows():
        if run["error"] >= least:
            continue
        least = run["error"]
        good = ours[ours["error"] <= least]["seconds"]
        cost = float(good.min()) if len(good) else float("nan")
        words = (f"{cost:.3g}", f"{run['seconds'] / cost:.3g}") if len(good) else ("-", "-")
        cells = (f"{run['segments']:.0f}", f"{run['knob']:.3g}", f"{run['error']:.3g}", f"{run['seconds']:.3g}")
        found.append((run["program"], *cells, *words))
    return found


def audited(data: xr.Dataset, console: Console) -> str:
    """What an audit says: who ran, each metric's disagreement, the order of the designs, who stays on the front."""
    objectives = json.loads(data.attrs["objectives"])
    dim = "design" if "environment" in data.dims else "point"
    front, stays = data["on_front"].to_numpy(), data["stays"].to_numpy()
    good = ((data["status"] == "OK") & (data["study_status"] == "OK")).to_numpy().reshape(len(front), -1)
    lines = [
        f"audited    {int(front.sum())} designs of the front and {int((~front).sum())} others, {good.size} points",
        f"study      {_runs(data, 'study_')}",
        f"audit      {_runs(data, '')}",
        f"cost       {float(data['seconds'].sum()):.3g} s for {float(data['study_seconds'].sum()):.3g} s of the study",
        f"trusted    {int(good.sum())} of {good.size} points in the audit too",
    ]
    status, message = data["status"].to_numpy().ravel(), data["message"].to_numpy().ravel()
    bad = [(str(a), str(b)) for a, b in zip(status, message, strict=True) if a != "OK"]
    lines += [f"    {count:6d}  {kind}: {why or 'no message'}" for count, kind, why in grouped(bad)[:8]]
    left = good.all(axis=1) & front
    lines.append(
        f"front      {int((stays & left).sum())} of its {int(left.sum())} designs that the audit trusts stay on the "
        f"front of the audited ones; {int((stays & ~front).sum())} of the others join it"
    )
    names = [str(name) for name in data["metric"].values]
    stems = [re.sub(r"_(mean|worst)$", "", name) for name in objectives]
    first = sorted(range(len(names)), key=lambda i: (stems.index(names[i]) if names[i] in stems else len(stems), i))
    rows = [_disagreement(data.isel(metric=i), names[i]) for i in first if float(data["n"][i]) > 0]
    columns = (
        *("metric", "points", "rms", "of size", "largest", "deviation", "rms / it"),
        *("error bar", "beyond it", "rank corr.", ""),
    )
    lines += ["", table("disagreement, audit less study", columns, rows, console)]
    lines.append(
        "deviation: standard deviation over the study's trusted points. error bar: sum of both spreads over perturbed "
        "runs (`repeats`), or else 1.96 standard uncertainties of the difference (`uncertainty`)"
        + ("" if np.isfinite(data["error_bar"]).any() else ", of which this study has none") + "."
    )
    ties = data.sizes[dim] - int(np.count_nonzero(good.all(axis=1)))
    return "\n".join(lines + ([f"{ties} designs say nothing: one of their points is not trusted"] if ties else []))


def _runs(data: xr.Dataset, who: str) -> str:
    """The models, methods and meshes of some rows."""
    columns = [data[f"{who}{name}"].to_numpy().ravel() for name in ("model", "method", "segments")]
    found = Counter(zip(*columns, strict=True)).most_common(4)
    return "; ".join(f"{model} by {method}, {n} segments ({count})" for (model, method, n), count in found)


def _disagreement(row: xr.Dataset, name: str) -> tuple[Any, ...]:
    """A metric's line, with a verdict: beyond its error bar, or as large as what the designs differ by."""
    keys = ("n", "rms", "size", "largest", "deviation", "error_bar", "beyond", "rank_correlation")
    n, rms, size, largest, deviation, bar, beyond, rank = (float(row[key]) for key in keys)
    words = []
    if beyond > 0:
        words.append("beyond its error bar")
    if rms > max(deviation, 1e-9 * size):  # and not rounding alone
        words.append("exceeds the designs' spread")
    if only := int(row["one_only"]):
        words.append(f"{only} points have a number in one run only")
    share = rms / deviation if deviation > 0 else float("nan")
    shown = [f"{x:.3g}" if np.isfinite(x) else "-" for x in (largest, deviation, share, bar, beyond, rank)]
    part = f"{rms / size:.2%}" if size > 0 else "-"
    return name, f"{n:.0f}", f"{rms:.3g}", part, *shown, ", ".join(words)
