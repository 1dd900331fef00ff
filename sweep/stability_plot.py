"""The figure of a stability map: for each method the outcome over the field's value and the step, with its limit."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .labels import BASE, BEST, DESIGN, FAIR, PINK, SKY, STYLE, YELLOW
from .store import write_whole

LOOKS = {  # outcome: colour, marker; what is drawn last lies on top
    "refused": (BASE, "_"),
    "no reference": (BASE, "o"),
    "unresolved": (SKY, "D"),
    "good": (FAIR, "o"),
    "energy open": (YELLOW, "s"),
    "coarse step": (PINK, "P"),
    "no convergence": ("#000000", "1"),
    "diverged": (BEST, "x"),
    "false alarm": (DESIGN, "^"),
    "inaccurate": ("#000000", "*"),
}
OTHER = (DESIGN, "d")


def _places(values: np.ndarray) -> tuple[np.ndarray, str]:
    """Where values of the field stand on the axis, and its scale: a place for each where no scale parts them."""
    if len(values) > 1 and np.all(values > 0) and values.max() > 10 * values.min():
        return values, "log"
    gaps = np.diff(np.sort(values))
    if len(values) > 1 and gaps.min() > 0.02 * np.ptp(values):
        return values, "linear"
    return np.arange(len(values), dtype=float), "places"


def draw_map(data: xr.Dataset, figure: Figure) -> Figure:
    """A panel for each method (and line): step or tolerance over the field's value."""
    table = data.to_dataframe()
    panels = list(dict.fromkeys(zip(table["model"], table["method"], strict=True)))
    panels = [p for p in panels if np.isfinite(_of(table, p)["setting"]).any()]
    columns = min(3 if len(panels) in (5, 6) else 4, len(panels))
    rows = -(-len(panels) // columns)
    figure.set_size_inches(3.1 * columns + 0.6, 2.7 * rows + 1.0)
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
    values = table["value"].fillna(0.0).drop_duplicates().to_numpy(dtype=float)
    places, scale = _places(values)
    at = dict(zip(values, places, strict=True))
    shown: dict[str, tuple[str, str]] = {}
    for ax, panel in zip(axes.flat, panels, strict=False):
        mine = _of(table, panel)
        for name in (*LOOKS, *sorted(set(mine["outcome"]) - LOOKS.keys())):
            rows_of = mine[mine["outcome"] == name]
            if rows_of.empty:
                continue
            colour, marker = shown.setdefault(name, LOOKS.get(name, OTHER))
            x = [at[v] for v in rows_of["value"].fillna(0.0)]
            ax.scatter(x, rows_of["setting"], color=colour, marker=marker, s=30, linewidths=1.3)
        _limit(ax, mine, at, scale)
        ax.set_yscale("log")
        if scale == "log":
            ax.set_xscale("log")
        elif scale == "places":
            ax.set_xticks(places, [f"{v:.6g}" for v in values], rotation=40, ha="right")
        ax.set_title(panel[1] if len(set(table["model"])) == 1 else f"{panel[0]}, {panel[1]}")
        ax.set_ylabel("step [s]" if np.isfinite(mine["multiple"]).any() else "tolerance [-]")
    for ax in axes.flat[len(panels) :]:
        ax.set_visible(False)
    for ax in axes.flat[max(len(panels) - columns, 0) : len(panels)]:  # the lowest of each column
        ax.tick_params(labelbottom=True)
        ax.set_xlabel(data.attrs["label"] if data.attrs["field"] else "the scene as it is")
    handles = [
        Line2D([], [], color=colour, marker=marker, ls="none", label=f"{name} ({(table['outcome'] == name).sum()})")
        for name, (colour, marker) in shown.items()
    ]
    handles.append(Line2D([], [], color="k", lw=1.2, label="limit in theory"))
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    return figure


def _of(table: pd.DataFrame, panel: tuple[str, str]) -> pd.DataFrame:
    return table[(table["model"] == panel[0]) & (table["method"] == panel[1])]


def _limit(ax: Axes, mine: pd.DataFrame, at: dict[float, float], scale: str) -> None:
    """The limit over the field, within the steps that were tried."""
    if not np.isfinite(mine["multiple"]).any():  # tolerances are no steps
        return
    first = mine.assign(value=mine["value"].fillna(0.0)).groupby("value")["limit"].first()
    first = first[np.isfinite(first) & (first > 0)]
    if first.empty:
        return
    x = np.array([at[v] for v in first.index])
    order = np.argsort(x)
    if len(x) == 1 or scale == "places":  # steps: nothing is known in between
        half = 0.4 if scale == "places" else 0.02 * max(1.0, abs(float(x[0])))
        ax.hlines(first.to_numpy(), x - half, x + half, color="k", lw=1.2)
    else:
        ax.plot(x[order], first.to_numpy()[order], color="k", lw=1.2)


def save_map(data: xr.Dataset, path: Path) -> Path:
    """Draw a map into a file."""
    with matplotlib.rc_context(STYLE):
        figure = draw_map(data, Figure(layout="constrained"))
        return write_whole(path, lambda place: figure.savefig(place, format="png"))
