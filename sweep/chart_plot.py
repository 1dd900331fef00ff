"""The figure of a chart: error against seconds with its envelope, error in space, error in time."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .chart import OURS, UNCHECKED
from .labels import BASE, BEST, DESIGN, FAIR, PINK, SKY, STYLE, YELLOW
from .store import write_whole

COLOURS = (DESIGN, BEST, FAIR, YELLOW, PINK, SKY, "#000000", BASE)
MARKERS = "osD^vP*X<>"


def _looks(table: pd.DataFrame) -> dict[str, dict[tuple[str, str], str]]:
    """A colour for each line (or program), a marker for each method."""
    models, methods = list(dict.fromkeys(table["model"])), list(dict.fromkeys(table["method"]))
    pairs = dict.fromkeys(zip(table["model"], table["method"], strict=True))
    return {
        "color": {pair: COLOURS[models.index(pair[0]) % len(COLOURS)] for pair in pairs},
        "marker": {pair: MARKERS[methods.index(pair[1]) % len(MARKERS)] for pair in pairs},
    }


def draw_chart(data: xr.Dataset, figure: Figure) -> Figure:
    """Panels: error against seconds, error against segments, and in motion error against tolerance or step."""
    table = data.to_dataframe()
    table = table[np.isfinite(table["error"])]
    looks, chaotic = _looks(table), bool(data.attrs["chaotic"])
    uncertainty = widest(data) if chaotic else float(data.attrs["uncertainty"])
    moves = bool(table["knob"].notna().any())
    cost, space, *late = figure.subplots(1, 3 if moves else 2, sharey=True)
    for pair, rows in table.groupby(["model", "method"], sort=False):
        look = {"color": looks["color"][pair], "marker": looks["marker"][pair], "ms": 4.5, "ls": "none"}
        ours = (rows["program"] == OURS).all()
        good = rows[rows["status"].isin(["OK", UNCHECKED])]
        bad = rows[~rows["status"].isin(["OK", UNCHECKED])]
        cost.plot(good["seconds"], good["error"], label=", ".join(pair), **look | ({} if ours else {"ms": 7, "mew": 0}))
        cost.plot(bad["seconds"], bad["error"], **look, mfc="none", alpha=0.45)
        if chaotic:
            width = good["standard_error"]
            cost.errorbar(good["seconds"], good["error"], width, ls="none", color=look["color"], lw=0.8, capsize=2)
        tight = rows.loc[rows.groupby("segments")["knob"].idxmin()] if rows["knob"].notna().any() else rows
        space.plot(tight["segments"], tight["error"], **look | {"ls": "-", "lw": 0.8})
        fine = rows[rows["segments"] == rows["segments"].max()]
        for ax in late:
            ax.plot(fine["knob"], fine["error"], **look | {"ls": "-", "lw": 0.8})
    best = table[table["envelope"].astype(bool)].sort_values("seconds")
    cost.step(best["seconds"], best["error"], where="post", color="k", lw=1.4, zorder=0, label="worth their seconds")
    if not chaotic:
        slopes(space, table)
    axes = (cost, space, *late)
    for ax, words in zip(axes, ("processor time [s]", "segments [-]", "tolerance [-] or step [s]"), strict=False):
        ax.set(xscale="log", yscale="log", xlabel=words)
        ax.axhspan(ax.get_ylim()[0], uncertainty, color="0.9", zorder=-1)
    what = "objectives' ensemble means, largest" if chaotic else "transverse response"
    cost.set_ylabel(f"error of the {what} [-]")
    cost.set_title("a  cost (hollow: not trusted)")
    space.set_title("b  in space" + ", at the finest knob" * moves)
    for ax in late:
        ax.set_title("c  in time, on the finest mesh")
    figure.legend(*cost.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def widest(data: xr.Dataset) -> float:
    """Largest relative standard error of the reference's objectives: what an ensemble of its size can tell."""
    return max((
        data.attrs[f"standard_error_{name}"] / (abs(data.attrs[f"reference_{name}"]) or 1.0)
        for name in data.attrs["objectives"].split() if f"standard_error_{name}" in data.attrs
    ), default=0.0)  # fmt: skip


def slopes(ax: Axes, table: pd.DataFrame) -> None:
    """Orders 2 and 4 beside the curves."""
    n = np.array([table["segments"].min(), table["segments"].max()], dtype=float)
    top = float(table["error"].max())
    for order in (2, 4):
        ax.plot(n, top * (n / n[0]) ** -order, ls=":", color="0.5", lw=0.8)
        ax.annotate(f"order {order}", (n[0] * 1.6, top * 1.6**-order), color="0.4", fontsize=8)
    ax.set_ylim(0.3 * float(table["error"].min()), 2 * top)


def save_chart(data: xr.Dataset, path: Path) -> Path:
    """Draw a chart into a file."""
    with matplotlib.rc_context(STYLE):
        figure = draw_chart(data, Figure(figsize=(11, 5), layout="constrained"))
        return write_whole(path, lambda place: figure.savefig(place, format="png"))
