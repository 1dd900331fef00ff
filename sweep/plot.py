"""Figures of a study: from a dataset to axes. Nothing is computed here; `series` prepares what results do not hold.

Every ``plot_x(dataset, ax=None)`` draws into given axes, or makes a figure, and returns the axes; those of several
panels take and return a figure. Labels come from the dataset's units and the table of metrics. Figures of a single
point are in `histories`; `save_plot` draws any kind for a study's folder, without pyplot.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator

from . import pareto
from .across import across
from .across_plot import plot_histories, plot_spectra
from .flows import flow_of, modal_of, tired_of
from .histories import (
    plot_energy,
    plot_envelope,
    plot_force_angle,
    plot_force_law,
    plot_gt,
    plot_history,
    plot_loop,
    plot_profile,
    plot_response,
    plot_spectrum_or_orders,
    plot_stroke,
    plot_wavelet,
)
from .labels import BEST, DESIGN, MAP, STYLE, UP, WORDS, draw_in, draw_on, metric_label, symbol, variable_label
from .sensitivity import sensitivity_of
from .series import (
    chosen_key,
    compared,
    force_laws,
    loop_of,
    power,
    profile_of,
    responses,
    series_of,
    spectrum_or_orders,
    stroke_wavelets,
    wavelet,
)
from .signal_plots import (
    plot_compared,
    plot_fatigue,
    plot_flow,
    plot_modes,
    plot_phase,
    plot_power,
    plot_sensitivity,
    plot_stroke_wavelet,
)
from .store import open_study, outcome, write_whole

# --------------------------------------------------------------------------- the points of a study


class Points(NamedTuple):
    """A study's designs as figures need them, one entry for each."""

    kinds: np.ndarray  # trusted, untrusted, failed, missing
    values: dict[str, np.ndarray]  # objectives
    spreads: dict[str, np.ndarray]  # error bars of the objectives; 0, inf or NaN where there are none
    variables: dict[str, xr.DataArray]
    front: np.ndarray  # indices
    best: int | None

    @property
    def finite(self) -> np.ndarray:
        return np.isfinite(np.column_stack(list(self.values.values()))).all(axis=1)

    def which(self, kind: str) -> np.ndarray:
        """Indices that can be drawn."""
        return np.flatnonzero((self.kinds == kind) & self.finite)


def points_of(dataset: xr.Dataset, objectives: Sequence[str] | None = None) -> Points:
    """Sort a study's designs; ValueError where there is nothing to draw."""
    names = list(objectives or json.loads(dataset.attrs.get("objectives", "[]")))
    if not names:
        raise ValueError("the study names no objectives: give some")
    index = "design" if "environment" in dataset.dims else "point"
    status = dataset["status"].values.astype(str).reshape(dataset.sizes[index], -1)
    order = ("failed", "missing", "untrusted", "trusted")  # the worst of a design's environments stands for it
    kinds = np.array([min((outcome(s) for s in row), key=order.index) for row in status])
    found = Points(
        kinds,
        {name: pareto.column(dataset, name).values.astype(float) for name in names},
        dict(zip(names, pareto.bars(dataset, names).T, strict=True)),
        {
            str(name): _numbered(coord)
            for name, coord in dataset.coords.items()
            if coord.dims == (index,) and name not in ("design", index)
        },
        pareto.front(dataset, names),
        pareto.best(dataset, names),
    )
    if not found.which("trusted").size and not found.which("untrusted").size:
        count = f"{len(kinds)} points: " + ", ".join(
            f"{n} {kind}" for kind in order if (n := np.count_nonzero(kinds == kind))
        )
        raise ValueError(f"no point has finite {', '.join(names)} ({count})")
    return found


def _numbered(variable: xr.DataArray) -> xr.DataArray:
    """A design variable as it is drawn: words by number, with what they mean in its name."""
    if variable.dtype.kind in "fiu":
        return variable
    words, codes = np.unique(variable.values.astype(str), return_inverse=True)
    meaning = ", ".join(f"{i} {word}" for i, word in enumerate(words))
    return xr.DataArray(codes.astype(float), dims=variable.dims, name=f"{variable.name}: {meaning}")


def _is_log(values: np.ndarray) -> bool:
    return bool(values.size and np.all(values > 0) and values.max() > 100 * values.min())


def _norm(values: np.ndarray) -> Normalize:
    if _is_log(values):
        return LogNorm(float(values.min()), float(values.max()))
    return Normalize(float(np.nanmin(values)), float(np.nanmax(values)))


def _window(good: np.ndarray, doubtful: np.ndarray) -> tuple[float, float]:
    """Limits that show the trusted points, and the untrusted ones only as far as they are near."""
    shown = good if good.size else doubtful
    margin = 0.06 * float(np.ptp(shown)) or 0.1 * abs(float(shown[0])) or 0.1
    low, high = float(shown.min()) - margin, float(shown.max()) + margin
    near = doubtful[(doubtful > low - 5 * margin) & (doubtful < high + 5 * margin)]
    return min([low, *(near - margin / 3)]), max([high, *(near + margin / 3)])


def _scatter(ax: Any, points: Points, columns: list[np.ndarray], colour: np.ndarray | None, size: float) -> Any:
    """Trusted, untrusted, front and best points; the mappable of the trusted ones, or None."""
    good, doubtful = points.which("trusted"), _shown(points, columns)  # axes in space clip nothing themselves
    extra: dict[str, Any] = {"depthshade": False} if hasattr(ax, "set_zlim") else {}
    ordinary = np.setdiff1d(good, points.front)

    def draw(which: np.ndarray, **looks: Any) -> Any:
        return ax.scatter(*(c[which] for c in columns), **looks, **extra)

    def shade(which: np.ndarray) -> dict[str, Any]:
        if colour is None:
            return {"color": DESIGN}
        return {"c": colour[which], "norm": _norm(colour), "cmap": MAP}

    made = None
    if ordinary.size:
        made = draw(ordinary, s=size, linewidths=0, alpha=0.8, **shade(ordinary))
    if doubtful.size:
        draw(doubtful, s=2 * size, marker="x", color="0.45", linewidths=1.1)
    others = points.front[points.front != points.best]
    if others.size:
        made = draw(others, s=2.2 * size, edgecolors="black", linewidths=1.1, **shade(others))
    if points.best is not None:
        where = np.array([points.best])
        draw(where, s=14 * size, marker="*", color=BEST, edgecolors="black", linewidths=0.7, zorder=5)
    return made


def _error_bars(ax: Axes, points: Points, a: str, b: str) -> None:
    """Standard uncertainties, or spreads over perturbed runs, of the front's points, where the study has them."""
    for i in points.front:
        x, y = points.values[a][i], points.values[b][i]
        dx, dy = (bar if math.isfinite(bar) else 0.0 for bar in (points.spreads[a][i], points.spreads[b][i]))
        if dx > 0 or dy > 0:
            ax.errorbar(x, y, xerr=dx, yerr=dy, color="0.4", linewidth=0.9, capsize=2.5, zorder=1.5)


def _limits(points: Points, column: np.ndarray) -> tuple[float, float]:
    return _window(column[points.which("trusted")], column[points.which("untrusted")])


def _limit(ax: Any, points: Points, **columns: np.ndarray) -> None:
    for name, column in columns.items():
        getattr(ax, f"set_{name}lim")(*_limits(points, column))


def _shown(points: Points, columns: Sequence[np.ndarray]) -> np.ndarray:
    """Untrusted points within the axes."""
    found = points.which("untrusted")
    for column in columns:
        low, high = _limits(points, column)
        found = found[(column[found] >= low) & (column[found] <= high)]
    return found


def _legend(points: Points, axes_hide: int = 0) -> list[Any]:
    """Handles with counts, failed and missing points included, which no axes can show."""
    count = {kind: int(np.count_nonzero(points.kinds == kind)) for kind in set(points.kinds)}
    shown = {kind: points.which(kind).size for kind in ("trusted", "untrusted")}
    dot: dict[str, Any] = {"linestyle": "", "markersize": 6}
    handles = [Line2D([], [], marker="o", color=DESIGN, label=f"trusted ({shown['trusted']})", **dot)]
    if points.front.size:
        looks = {**dot, "markersize": 8}
        text = f"front ({points.front.size})"
        handles.append(Line2D([], [], marker="o", color=DESIGN, markeredgecolor="black", label=text, **looks))
    if points.best is not None:
        looks = {**dot, "markersize": 12}
        text = "best: nearest to the ideal"
        handles.append(Line2D([], [], marker="*", color=BEST, markeredgecolor="black", label=text, **looks))
    if shown["untrusted"]:
        text = f"untrusted ({shown['untrusted']})"
        handles.append(Line2D([], [], marker="x", color="0.45", label=text, **dot))
    blank: dict[str, Any] = {"linestyle": "", "marker": ""}
    undefined = sum(count.get(kind, 0) - shown[kind] for kind in shown)
    for number, text in (
        (undefined, "with an infinite or undefined objective"),
        (count.get("failed", 0), "failed: no metrics"),
        (count.get("missing", 0), "not run yet"),
        (axes_hide, "untrusted beyond the axes"),
    ):
        if number:
            handles.append(Line2D([], [], label=f"{number} {text}", **blank))
    return handles


def _legend_below(figure: Figure, handles: list[Any]) -> None:
    columns = max(1, int(figure.get_size_inches()[0] / 2.6))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def _grid(count: int, wide: int) -> tuple[int, int]:
    columns = min(count, wide)
    return math.ceil(count / columns), columns


def plot_front(
    dataset: xr.Dataset,
    figure: Figure | None = None,
    *,
    objectives: Sequence[str] | None = None,
    colour: str | None = None,
) -> Figure:
    """Objectives against one another, pair by pair and three in space, coloured by a design variable.

    With one objective: over each design variable. Failed points are counted in the legend.
    """
    points = points_of(dataset, objectives)
    names = list(points.values)[:4]
    if colour is not None and colour not in points.variables:
        raise ValueError(f"no design variable `{colour}`; there are {', '.join(points.variables) or 'none'}")
    colour = colour or next(iter(points.variables), None)
    shade = points.variables[colour] if colour else None
    shades = None if shade is None else shade.values.astype(float)
    if len(names) == 1:
        return plot_ea(dataset, figure, objectives=names)
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    panels = len(pairs) + (len(names) >= 3)
    rows, columns = _grid(panels, 2 if panels <= 4 else 3)
    figure = draw_in(figure, (max(4.7 * columns, 6.4), 3.9 * rows + 0.7))
    mappable = None
    for i, (a, b) in enumerate(pairs):
        ax = figure.add_subplot(rows, columns, i + 1)
        _error_bars(ax, points, a, b)
        mappable = _scatter(ax, points, [points.values[a], points.values[b]], shades, 14) or mappable
        _limit(ax, points, x=points.values[a], y=points.values[b])
        ax.set_xlabel(metric_label(a))
        ax.set_ylabel(metric_label(b, UP))
    if len(names) >= 3:
        ax3: Any = figure.add_subplot(rows, columns, panels, projection="3d")
        mappable = _scatter(ax3, points, [points.values[n] for n in names[:3]], shades, 11) or mappable
        _limit(ax3, points, **dict(zip("xyz", (points.values[n] for n in names[:3]), strict=True)))
        ax3.set_xlabel(metric_label(names[0], WORDS, "\n"), labelpad=9)
        ax3.set_ylabel(metric_label(names[1], WORDS, "\n"), labelpad=9)
        ax3.set_zlabel(metric_label(names[2], WORDS, ", "), labelpad=5)
        ax3.tick_params(pad=1, labelsize=8)
        ax3.view_init(elev=24, azim=-56)
        ax3.set_box_aspect(None, zoom=0.93)
        floor = ax3.get_zlim()[0]
        for i in points.front:
            x, y, z = (points.values[n][i] for n in names[:3])
            ax3.plot([x, x], [y, y], [floor, z], color="0.4", linewidth=0.8)
        for axis in (ax3.xaxis, ax3.yaxis, ax3.zaxis):
            axis.set_major_locator(MaxNLocator(5))
    if mappable is not None and shade is not None:
        figure.colorbar(
            mappable, ax=figure.axes, label=variable_label(shade), location="bottom", shrink=0.6, aspect=40, pad=0.03
        )
    hidden = points.which("untrusted").size - _shown(points, [points.values[n] for n in names]).size
    _legend_below(figure, _legend(points, hidden))
    return figure


def plot_ea(dataset: xr.Dataset, figure: Figure | None = None, *, objectives: Sequence[str] | None = None) -> Figure:
    """Each objective over each design variable, like the paper's figure 5."""
    points = points_of(dataset, objectives)
    if not points.variables:
        raise ValueError("the study has no design variables to draw its objectives over")
    rows, columns = len(points.values), len(points.variables)
    figure = draw_in(figure, (max(3.1 * columns + 0.8, 5.5), max(2.5 * rows + 0.8, 3.6)))
    panels = figure.subplots(rows, columns, sharex="col", sharey="row", squeeze=False)
    for i, (name, values) in enumerate(points.values.items()):
        for j, variable in enumerate(points.variables.values()):
            ax = panels[i, j]
            x = variable.values.astype(float)
            _scatter(ax, points, [x, values], None, 12)
            _limit(ax, points, y=values)
            if _is_log(x):
                ax.set_xscale("log")
                ax.set_xlim(x.min() / 1.6, x.max() * 1.6)
                ax.xaxis.set_major_locator(LogLocator(numticks=6))
            ax.grid(alpha=0.25, linewidth=0.6)
            if j == 0:
                ax.set_ylabel(metric_label(name, UP))
            if i == rows - 1:
                ax.set_xlabel(variable_label(variable))
    hidden = points.which("untrusted").size - _shown(points, list(points.values.values())).size
    _legend_below(figure, _legend(points, hidden))
    return figure


def plot_parallel(dataset: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Parallel coordinates: design variables, then objectives; the front's lines coloured by its first objective."""
    points = points_of(dataset)
    if points.finite.sum() < 2:
        raise ValueError("parallel coordinates compare designs, and only one has finite objectives")
    columns = {name: v.values.astype(float) for name, v in points.variables.items()} | points.values
    ax = draw_on(ax, (max(1.5 * len(columns) + 2, 6), 4.8))
    good, doubtful = points.which("trusted"), points.which("untrusted")
    names, heights = list(columns), []
    for i, values in enumerate(columns.values()):
        shown = values[good] if good.size else values[doubtful]
        log = _is_log(shown)
        scaled = np.log10(values) if log else values
        low, high = (np.log10(shown) if log else shown).min(), (np.log10(shown) if log else shown).max()
        span = (high - low) or 1.0
        heights.append(np.clip((scaled - low) / span, -0.06, 1.06))
        ticks = _ticks(low, high, log)
        ax.plot([i, i], [0, 1], color="black", linewidth=0.9, zorder=4)
        for tick in ticks:
            at = (tick - low) / span
            ax.plot([i - 0.025, i], [at, at], color="black", linewidth=0.9, zorder=4)
            text = f"$10^{{{tick:.0f}}}$" if log else f"{tick:.4g}"
            halo = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.75}
            ax.text(i - 0.05, at, text, ha="right", va="center", fontsize=8, bbox=halo, zorder=5)
    lines = np.column_stack(heights)
    paths = np.stack([np.broadcast_to(np.arange(len(names)), lines.shape), lines], axis=2)

    def draw(which: np.ndarray, **looks: Any) -> LineCollection:
        made = LineCollection(list(paths[which]), **looks)
        ax.add_collection(made)
        return made

    draw(np.setdiff1d(good, points.front), colors="0.72", linewidths=0.6, alpha=0.6)
    draw(doubtful, colors="0.45", linewidths=0.9, linestyles="dotted")
    first = next(iter(points.values))
    if points.front.size:
        shades = points.values[first][points.front]
        made = draw(points.front, array=shades, cmap=MAP, linewidths=1.6)
        ax.figure.colorbar(made, ax=ax, label=f"{metric_label(first, WORDS, ', ')} (front)", pad=0.02)
    if points.best is not None:
        draw(np.array([points.best]), colors=BEST, linewidths=2.8, zorder=3)
    ax.set_xlim(-0.45, len(names) - 0.85)
    ax.set_ylim(-0.08, 1.08)
    texts = [variable_label(points.variables[n]) if n in points.variables else metric_label(n, UP, "\n") for n in names]
    ax.set_xticks(range(len(names)), texts)
    ax.set_yticks([])
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    handles = [
        Line2D([], [], color="0.72", label=f"trusted ({good.size})"),
        Line2D([], [], color=matplotlib.colormaps[MAP](0.5), label=f"front ({points.front.size})", linewidth=2),
    ]
    if points.best is not None:
        handles.append(Line2D([], [], color=BEST, label="best", linewidth=2.8))
    if doubtful.size:
        text = f"untrusted ({doubtful.size})"
        handles.append(Line2D([], [], color="0.45", linestyle="dotted", label=text))
    handles += [h for h in _legend(points) if not h.get_marker() or h.get_marker() == "None"]
    ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.02), ncols=4)
    return ax


def plot_hypervolume(dataset: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Hypervolume of the front over the designs run, generation by generation of a search."""
    ax = draw_on(ax)
    shown = dataset.isel(generation=np.isfinite(dataset["hypervolume"].values))
    if not shown.sizes["generation"]:
        raise ValueError("no generation has a front yet")
    x, y = shown["evaluations"].values, shown["hypervolume"].values
    ax.plot(x, y, color=DESIGN, drawstyle="steps-post")
    ax.plot(x, y, "o", color=DESIGN, markersize=4)
    ax.annotate(f"{y[-1]:.4g}", (x[-1], y[-1]), xytext=(0, 6), textcoords="offset points", ha="right")
    ax.set_xlim(0, x[-1] * 1.03)
    ax.set_xlabel("designs run [-]")
    point = ", ".join(f"{symbol(name)} = {value:.4g}" for name, value in json.loads(dataset.attrs["reference"]).items())
    ax.set_ylabel("hypervolume [product of the objectives' units]")
    ax.set_title(f"{dataset.attrs['algorithm']}, seed {dataset.attrs['seed']}; reference {point}")
    ax.margins(y=0.1)
    ax.grid(alpha=0.25, linewidth=0.6)
    return ax


def _hypervolume(directory: Path) -> xr.Dataset:
    path = Path(directory) / "hypervolume.nc"
    if not path.is_file():
        raise ValueError("the folder is not of `sweep optimise`, or has no complete generation yet")
    with xr.open_dataset(path, engine="netcdf4") as dataset:
        return dataset.load()


def _ticks(low: float, high: float, log: bool) -> list[float]:
    slack = 1e-9 * max(abs(low), abs(high))
    if log:
        every = max(1, round((high - low) / 6))
        return [float(e) for e in range(math.ceil(low), math.floor(high) + 1, every)]
    return [float(t) for t in MaxNLocator(5).tick_values(low, high) if low - slack <= t <= high + slack]


# --------------------------------------------------------------------------- files


class Kind(NamedTuple):
    """A kind of figure: how it is drawn, from what, how large a single panel is, and what it shows."""

    draw: Callable[[xr.Dataset, Figure], Any]
    data: Callable[..., xr.Dataset]  # of a folder; where `single`, of a key too; where `over`, of other keys
    meaning: str
    dear: bool = False  # runs a study of its own, and so is not among `all`
    single: bool = False  # shows one point
    over: bool = False  # may show others over it


def _single(function: Callable[..., Axes], size: tuple[float, float]) -> Callable[[xr.Dataset, Figure], Axes]:
    def draw(dataset: xr.Dataset, figure: Figure) -> Axes:
        figure.set_size_inches(*size)
        return function(dataset, figure.subplots())

    return draw


def _series(directory: Path, key: str) -> xr.Dataset:
    found = series_of(directory, key)
    if found.sizes["time"] < 2:
        raise ValueError("the run is static, and has no history; `profile` shows the line")
    return found


PLOTS: dict[str, Kind] = {
    "front": Kind(plot_front, open_study, "objectives against one another, coloured by a design variable"),
    "parallel": Kind(_single(plot_parallel, (10, 5)), open_study, "parallel coordinates of variables and objectives"),
    "ea": Kind(plot_ea, open_study, "each objective over each design variable"),
    "hypervolume": Kind(
        _single(plot_hypervolume, (7, 4.2)), _hypervolume, "of `sweep optimise`: hypervolume over the designs run"
    ),
    "history": Kind(
        plot_history, _series, "displacement at stations along the cable, with and without devices", single=True
    ),
    "stroke": Kind(plot_stroke, _series, "offset of each device's mass, with its cross-well jumps", single=True),
    "envelope": Kind(
        _single(plot_envelope, (5.8, 6.8)), _series, "least and greatest displacement along the cable", single=True
    ),
    "gt": Kind(_single(plot_gt, (7.2, 5.4)), _series, "G(t), t_first and t_settle", single=True),
    "energy": Kind(plot_energy, _series, "the energy ledger over time", single=True),
    "wavelet": Kind(
        plot_wavelet,
        lambda d, key: wavelet(_series(d, key)),
        "Morlet transform of the probe's displacement",
        single=True,
    ),
    "spectrum": Kind(
        plot_spectrum_or_orders,
        lambda d, key: spectrum_or_orders(_series(d, key)),
        "spectrum of the probe's displacement; of a periodic response the harmonics, those of the end tension too",
        single=True,
    ),
    "power": Kind(
        _single(plot_power, (7.2, 4.4)),
        lambda d, key: power(_series(d, key)),
        "power spectral density of the probe's displacement after the pulse (Welch)",
        single=True,
    ),
    "stroke-wavelet": Kind(
        plot_stroke_wavelet,
        lambda d, key: stroke_wavelets(_series(d, key)),
        "Morlet transform of each device's offset",
        single=True,
    ),
    "phase": Kind(plot_phase, _series, "speed of each device's mass against its offset", single=True),
    "compare": Kind(
        _single(plot_compared, (8.0, 5.0)),
        compared,
        "the probe's displacement, with the baseline's and those of other points",
        single=True,
        over=True,
    ),
    "flow": Kind(plot_flow, flow_of, "energy of cable and devices, and what passes between them", single=True),
    "modes": Kind(plot_modes, modal_of, "energy of the cable's modes, and its share at high frequencies", single=True),
    "fatigue": Kind(plot_fatigue, tired_of, "fatigue damage along the cable, and its stress ranges", single=True),
    "profile": Kind(
        plot_profile,
        profile_of,
        "shape, tension, shear and bending moment along the line at its last time, over its baseline",
        single=True,
        over=True,
    ),
    "loop": Kind(
        _single(plot_loop, (6.6, 6.2)),
        loop_of,
        "end tension against end displacement, harmonic against time domain",
        single=True,
    ),
    "response": Kind(
        plot_response, responses, "periodic response along the first variable, stability and folds (slow)", dear=True
    ),
    "histories": Kind(
        plot_histories,
        across,
        "displacement at the probe in every environment, with and without devices: figure 14 (slow)",
        dear=True,
        single=True,
    ),
    "spectra": Kind(
        plot_spectra, across, "its spectra in every environment: figure 13 (slow)", dear=True, single=True
    ),
    "sensitivity": Kind(
        plot_sensitivity, sensitivity_of, "sensitivity of the objectives to each variable (see `sweep sensitivity`)",
        dear=True,
    ),
    "force-law": Kind(plot_force_law, lambda d: force_laws(), "force of a sink: springs against cords"),
    "force-angle": Kind(
        _single(plot_force_angle, (6.6, 4.6)),
        lambda d: force_laws((0.0, 2.0, 5.0, 8.0, 11.48), reach=0.02),
        "force of a sink against its initial angle",
    ),
}


def save_plot(directory: str | Path, kind: str, key: str | None = None, over: Sequence[str] = ()) -> Path:
    """Draw a kind of figure into DIR/figures, and return its path.

    Parameters
    ----------
    key : the point to show, by default the best; for figures of one point
    over : keys of points to lay over it, for the kinds that can

    Raises
    ------
    ValueError
        Where the kind is unknown or the folder has nothing to draw; one sentence says which.
    """
    if kind not in PLOTS:
        raise ValueError(f"no figure is called `{kind}`; there are {', '.join(PLOTS)}")
    entry, directory = PLOTS[kind], Path(directory)
    if key and not entry.single:
        raise ValueError("this figure shows the whole study, not one point")
    if over and not entry.over:
        able = " and ".join(f"`{name}`" for name, other in PLOTS.items() if other.over)
        raise ValueError(f"only {able} lay points over one another")
    more: list[Any] = [key or chosen_key(open_study(directory))] if entry.single else []
    data = entry.data(directory, *more, *([over] if over else []))
    with matplotlib.rc_context(STYLE):
        figure = Figure(layout="constrained")
        entry.draw(data, figure)
        return write_whole(directory / "figures" / f"{kind}.png", lambda place: figure.savefig(place, format="png"))
