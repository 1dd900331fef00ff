"""Figures of one design across its environments; they read the dataset of ``across``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from .labels import BASE, BASELINES, DESIGN, draw_in, label, readable

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


def _panels(found: xr.Dataset, figure: Figure | None, tail: str, x: xr.DataArray, up: str) -> tuple[Figure, Any]:
    """A panel for each environment with the lines of the baseline and the design over x, and the legend."""
    n = found.sizes["environment"]
    rows = math.ceil(n / COLUMNS)
    figure = draw_in(figure, (9.5, 1.35 * rows + 1.2))
    panels = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
    names = [name for name in ("baseline_displacement", "displacement") if f"{name}{tail}" in found]
    scaled = readable(xr.concat([found[f"{name}{tail}"] for name in names], "line").assign_attrs(units="m"))
    for e, ax in enumerate(panels.ravel()):
        if e >= n:
            ax.set_visible(False)
            continue
        for name, values in zip(names, scaled.values[:, e], strict=True):
            ours = name == "displacement"
            ax.plot(x.values, values, color=DESIGN if ours else BASE, linewidth=0.9 if ours else 1.4)
        ax.set_title(_panel(found, e), fontsize=9, pad=2)
        if e + COLUMNS >= n:
            ax.set_xlabel(label(x, str(x.name)))
            ax.tick_params(labelbottom=True)
    figure.supylabel(label(scaled, up), fontsize=10)
    figure.suptitle(_title(found), x=0.01, ha="left", fontsize=10)
    handles: list[Any] = [Line2D([], [], color=DESIGN, label="with devices")]
    if "baseline_displacement" in names:
        handles.append(Line2D([], [], color=BASE, linewidth=2, label=_base(found)))
    if not tail and float(found.attrs.get("pulse_end", 0.0)) > 0:
        handles.append(Patch(color="0.93", label="end moved"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure, panels


def plot_histories(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Displacement at the probe over time, with devices and for the baseline, a panel for each environment."""
    figure, panels = _panels(found, figure, "", found["time"], "transverse displacement")
    for ax in panels.ravel():
        if float(found.attrs.get("pulse_end", 0.0)) > 0:
            ax.axvspan(0, float(found.attrs["pulse_end"]), color="0.93", linewidth=0, zorder=0)
        ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    panels[0, 0].set_xlim(float(found["time"][0]), float(found["time"][-1]))
    return figure


def plot_spectra(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Amplitude spectra of the displacement at the probe, likewise, as far as 99 % of their squares go."""
    figure, panels = _panels(found, figure, "_amplitude", found["frequency"], "amplitude of the displacement")
    names = [name for name in ("baseline_displacement", "displacement") if f"{name}_amplitude" in found]
    energy = sum(((found[f"{name}_amplitude"].values ** 2).sum(axis=0) for name in names), np.zeros(1))
    f = found["frequency"].values
    last = int(np.searchsorted(np.cumsum(energy), 0.99 * energy.sum()))
    for ax in panels.ravel():
        ax.grid(alpha=0.25, linewidth=0.6)
    panels[0, 0].set_xlim(0.0, f[min(last + max(last // 4, 2), len(f) - 1)])
    panels[0, 0].set_ylim(bottom=0.0)
    return figure
