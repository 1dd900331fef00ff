"""Figures of one design across its environments; they read the dataset of ``across``."""

from __future__ import annotations

import math
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from .labels import BASE, BASELINES, DESIGN, MAP, draw_in, label, readable

COLUMNS = 2  # of panels


def _title(found: xr.Dataset) -> str:
    parts = [f"design {found.attrs['design']}", f"s = {found.attrs['s']:.2f} m"]
    left = int(found.attrs.get("left_out", 0))
    return ", ".join([*parts, *([f"{left} more environments not shown"] if left else [])])


def _base(found: xr.Dataset) -> str:
    name = str(found.attrs.get("baseline", ""))
    return f"baseline `{name}`: {BASELINES[name]}" if name in BASELINES else "baseline"


def _panel(found: xr.Dataset, e: int) -> str:
    reduction, status = float(found["rms_probe_reduction"][e]), str(found["status"].values[e])
    text = str(found["environment"].values[e])
    text += "" if math.isnan(reduction) else f": RMS {abs(reduction):.0%} {'less' if reduction >= 0 else 'more'}"
    return text if status == "OK" else f"{text} (untrusted: {status})"


def plot_histories(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Displacement at the probe over time, with devices and for the baseline, a panel for each environment."""
    n = found.sizes["environment"]
    rows = math.ceil(n / COLUMNS)
    figure = draw_in(figure, (9.5, 1.35 * rows + 1.2))
    panels = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
    t = found["time"].values
    columns = {name: readable(found[name]) for name in ("baseline_displacement", "displacement") if name in found}
    for e, ax in enumerate(panels.ravel()):
        if e >= n:
            ax.set_visible(False)
            continue
        if float(found.attrs.get("pulse_end", 0.0)) > 0:
            ax.axvspan(0, float(found.attrs["pulse_end"]), color="0.93", linewidth=0, zorder=0)
        for name, array in columns.items():
            ours = name == "displacement"
            ax.plot(t, array.values[e], color=DESIGN if ours else BASE, linewidth=0.9 if ours else 1.3)
        ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
        ax.set_title(_panel(found, e), fontsize=9, pad=2)
        if e + COLUMNS >= n:
            ax.set_xlabel(label(found["time"], "time"))
            ax.tick_params(labelbottom=True)
    panels[0, 0].set_xlim(t[0], t[-1])
    figure.supylabel(label(columns["displacement"], "transverse displacement"), fontsize=10)
    figure.suptitle(_title(found), x=0.01, ha="left", fontsize=10)
    handles: list[Any] = [Line2D([], [], color=DESIGN, label="with devices")]
    if "baseline_displacement" in columns:
        handles.append(Line2D([], [], color=BASE, linewidth=2, label=_base(found)))
    if float(found.attrs.get("pulse_end", 0.0)) > 0:
        handles.append(Patch(color="0.93", label="end moved"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def plot_spectra(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Amplitude spectra at the probe of all environments, for the baseline and with devices."""
    names = [name for name in ("baseline_displacement", "displacement") if f"{name}_amplitude" in found]
    figure = draw_in(figure, (8.6, 2.9 * len(names) + 1.6))
    panels = figure.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    columns = {name: readable(found[f"{name}_amplitude"]) for name in names}
    f = found["frequency"].values
    energy = sum((found[f"{name}_amplitude"].values ** 2).sum(axis=0) for name in names)
    shown = np.flatnonzero(energy > 1e-3 * np.max(energy))
    last = min(int(1.3 * max(int(shown[-1]), 4)) + 1, len(f) - 1) if shown.size else len(f) - 1
    n = found.sizes["environment"]
    colours = matplotlib.colormaps[MAP](np.linspace(0, 0.93, n))
    styles: Any = ("-", "--", ":")
    for ax, (name, array) in zip(panels, columns.items(), strict=True):
        for e in range(n):
            heights = array.values[e, 1 : last + 1]
            ax.plot(f[1 : last + 1], heights, color=colours[e], linestyle=styles[e % 3], linewidth=1.2)
        ax.set_title("with devices" if name == "displacement" else _base(found), fontsize=9, pad=3)
        ax.set_ylabel(label(array, "amplitude"))
        ax.grid(alpha=0.25, linewidth=0.6)
    panels[-1].set_xlim(f[1], f[last])
    panels[-1].set_ylim(bottom=0)
    panels[-1].set_xlabel(label(found["frequency"]))
    figure.suptitle(_title(found), x=0.01, ha="left", fontsize=10)
    handles = [
        Line2D([], [], color=colours[e], linestyle=styles[e % 3], label=str(name))
        for e, name in enumerate(found["environment"].values)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure
