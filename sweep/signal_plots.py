"""Figures of frequencies and of the flow of energy, from what `series` and `flows` prepare."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from .histories import base_label, design_label, draw_transform, head, moving_devices, pulse, title
from .labels import BASE, BEST, DESIGN, FAIR, PINK, SKY, STYLE, YELLOW, draw_in, draw_on, label, metric_unit
from .store import write_whole

DEVICES = (DESIGN, BEST, FAIR, PINK, YELLOW, SKY)
OVER = (BEST, FAIR, PINK, YELLOW, SKY)
DASHES: Any = ("-", (0, (6, 1.5)), (0, (3, 1)), "-.", (0, (1, 0.8)))


def plot_stroke_wavelet(transform: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Morlet transform of each device's offset, on one scale, like the paper's figure 11."""
    names = [str(name) for name in transform.data_vars if str(name).startswith("stroke_")]
    columns = min(len(names), 2)
    rows = math.ceil(len(names) / columns)
    figure = draw_in(figure, (4.6 * columns + 1.2, 2.9 * rows + 0.6))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    norm = PowerNorm(0.5, 0.0, max(float(transform[n].max()) for n in names) or 1.0)
    mesh: Any = None
    for ax, name in zip(panels, names, strict=False):
        mesh = draw_transform(ax, transform, name, norm)
        ax.set_title(transform[name].attrs["which"], fontsize=9, pad=3)
    for k, ax in enumerate(panels):
        if k >= len(names):
            ax.remove()
            continue
        if k % columns == 0:
            ax.set_ylabel(label(transform["frequency"]))
        if k + columns >= len(names):
            ax.set_xlabel(label(transform["time"], "time"))
            ax.xaxis.set_tick_params(labelbottom=True)
    figure.colorbar(mesh, ax=list(panels[: len(names)]), label=label(transform[names[0]], "|X|"), pad=0.02)
    figure.suptitle(f"{title(transform)}; outside the dashed lines the record's ends weigh in", x=0.01, ha="left",
                    fontsize=10)  # fmt: skip
    return figure


def plot_power(spectra: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Power spectral density of the displacement at the probe, with devices and for the baseline."""
    ax = draw_on(ax)
    f, most = spectra["frequency"].values, 0.0
    looks = (("baseline_displacement", BASE, base_label(spectra), 1.8),
             ("displacement", DESIGN, design_label(spectra), 1.1))  # fmt: skip
    for name, colour, text, width in looks:
        if name in spectra:
            ax.plot(f[1:], spectra[name].values[1:], color=colour, label=text, linewidth=width)
            most = max(most, float(spectra[name][1:].max()))
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("")
    ax.set_ylim(1e-7 * most or 1e-12, 3 * most or 1.0)
    seen = np.zeros(len(f), dtype=bool)
    for array in spectra.data_vars.values():
        seen |= array.values > 1e-7 * most
    ax.set_xlim(f[1], f[np.flatnonzero(seen)[-1]] if seen.any() else f[-1])
    ax.set_xlabel(label(spectra["frequency"]))
    ax.set_ylabel(label(spectra["displacement"]))
    ax.grid(alpha=0.25, linewidth=0.6)
    ax.set_title(f"{title(spectra)}, s = {spectra.attrs['s']:.2f} m, from {spectra.attrs['start']:.3g} s on")
    ax.legend(loc="lower left")
    return ax


def plot_compared(found: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Displacement at the probe: baseline, the point, and other points over it."""
    ax = draw_on(ax, (8.0, 4.2))
    pulse(ax, found)
    t = found["time"].values
    if "baseline_displacement" in found:
        ax.plot(t, found["baseline_displacement"].values, color=BASE, linewidth=1.8, label=base_label(found))
    k = 1
    while f"over{k}_displacement" in found:
        array = found[f"over{k}_displacement"]
        ax.plot(found[f"over{k}_time"].values, array.values, color=OVER[(k - 1) % len(OVER)],
                linestyle=DASHES[k % len(DASHES)], label=array.attrs["which"])  # fmt: skip
        k += 1
    ax.plot(t, found["displacement"].values, color=DESIGN, label=found["displacement"].attrs["which"])
    ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel(label(found["time"], "time"))
    ax.set_ylabel(label(found["displacement"], "transverse displacement"))
    ax.set_title(f"{title(found)}, s = {found.attrs['s']:.2f} m")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=1)
    return ax


def plot_phase(series: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Speed of each device's mass against its offset; rest positions as dots, the start as a cross."""
    which = moving_devices(series)
    columns = min(len(which), 2)
    rows = math.ceil(len(which) / columns)
    figure = draw_in(figure, (4.2 * columns, 3.2 * rows + 0.7))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    t = series["time"].values
    for ax, i in zip(panels, which, strict=False):
        y, y0 = series["stroke"].values[:, i], float(series["rest_offset"][i])
        ax.plot(1e3 * y, np.gradient(y, t), color=DESIGN, linewidth=0.6)
        ax.plot(1e3 * y[0], 0, "x", color=BEST, markersize=8, markeredgewidth=1.6)
        if y0 > 0:
            ax.plot([-1e3 * y0, 1e3 * y0], [0, 0], "o", color="black", markersize=4, zorder=4)
        kind = f" ({series['device_kind'].values[i]})" if "device_kind" in series else ""
        ax.set_title(f"device {i + 1}{kind}", fontsize=9, pad=3)
        ax.set_xlabel("offset y [mm]")
        ax.set_ylabel("speed y' [m/s]")
        ax.grid(alpha=0.25, linewidth=0.6)
    for ax in panels[len(which) :]:
        ax.remove()
    head(figure, series)
    handles = [Line2D([], [], color=BEST, marker="x", linestyle="", markeredgewidth=1.6, label="start")]
    if np.any(series["rest_offset"].values[which] > 0):
        handles.append(Line2D([], [], color="black", marker="o", markersize=4, linestyle="", label="rest, ±y0"))
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def plot_flow(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Stored energy of cable and devices; what has passed to each device; where it was lost."""
    figure = draw_in(figure, (8.6, 8.4))
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    t = found["time"].values
    devices = found["device_energy"].values.sum(axis=1)
    top.plot(t, found["cable_energy"].values, color=BASE, linewidth=1.6, label="cable")
    top.plot(t, devices, color=DESIGN, label="all devices")
    top.set_ylabel("stored energy [J]")
    top.set_title(title(found))
    for k, (i, kind) in enumerate(zip(found["device"].values, found["device_kind"].values, strict=True)):
        last, lost = (float(found[name].values[-1, k]) for name in ("passed", "device_lost"))
        looks: Any = {"color": DEVICES[k % len(DEVICES)], "linestyle": DASHES[k % len(DASHES)]}
        text = f"{i} ({kind}): {last:.3g} J, {lost:.3g} J lost"
        middle.plot(t, found["passed"].values[:, k], label=text, **looks)
    middle.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    middle.set_ylabel("passed from the cable\nto each device [J]")
    total = float(found["lost_device"][-1])
    middle.set_title(f"sum of the devices' losses {float(found['device_lost'].values[-1].sum()):.4g} J, "
                     f"ledger {total:.4g} J", fontsize=9, pad=2)  # fmt: skip
    for name, colour, text in (("lost_water", SKY, "to water"), ("lost_cable", YELLOW, "in the cable"),
                               ("lost_device", DESIGN, "in devices"), ("lost_seabed", FAIR, "to the bed")):  # fmt: skip
        if np.any(found[name].values != 0):
            bottom.plot(t, found[name].values, color=colour, label=f"{text} ({float(found[name][-1]):.3g} J)")
    bottom.plot(t, found["work"].values, color="black", linestyle="dashed", label="work put in")
    bottom.set_ylabel("lost since t = 0 [J]")
    bottom.set_xlabel(label(found["time"]))
    bottom.set_xlim(t[0], t[-1])
    for ax in (top, middle, bottom):
        pulse(ax, found)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def plot_modes(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Energy of the plain cable's modes over time, and how much of it is above the excitation's frequencies."""
    maps = [(new, text) for new, text in (("baseline_", base_label(found)), ("", design_label(found)))
            if f"{new}modal_energy" in found]  # fmt: skip
    figure = draw_in(figure, (8.0, 2.6 * len(maps) + 4.6))
    panels = figure.subplots(len(maps) + 2, 1, sharex=True, height_ratios=[1.25] * len(maps) + [1, 1])
    t, f, cut = found["time"].values, found["frequency"].values, float(found.attrs["cut"])
    energy = {new: found[f"{new}modal_energy"].values for new, _ in maps}
    most = max(float(e.max()) for e in energy.values()) or 1.0
    kept = [np.cumsum(e.sum(axis=0)) <= 0.9999 * e.sum() for e in energy.values()]
    shown = np.flatnonzero((f > 0) & (np.any(kept, axis=0) | (np.arange(len(f)) < 6)))
    mesh: Any = None
    for ax, (new, text) in zip(panels, maps, strict=False):
        values = np.maximum(energy[new][:, shown].T, 1e-6 * most)
        mesh = ax.pcolormesh(t, np.arange(len(shown) + 1) + 0.5, values[:, :-1], norm=LogNorm(1e-6 * most, most),
                             cmap=matplotlib.colormaps["magma_r"], shading="flat", rasterized=True)  # fmt: skip
        ax.axhline(np.count_nonzero(f[shown] <= cut) + 0.5, color=DESIGN, linewidth=1.0, linestyle="dashed")
        ax.set_ylabel("mode: frequency [Hz]")
        places = np.unique(np.linspace(0, len(shown) - 1, min(6, len(shown))).round().astype(int))
        ax.set_yticks(places + 1, [f"{i + 1}: {f[shown[i]]:.3g}" for i in places])
        ax.set_title(text, fontsize=9, pad=3)
    figure.colorbar(mesh, ax=list(panels[: len(maps)]), label="energy of a mode [J]", pad=0.02)
    share, above = panels[-2:]
    texts = []
    for new, _ in maps:
        e, high = energy[new], f > cut
        total, part = e.sum(axis=1), e[:, high].sum(axis=1)
        ratio = np.divide(part, total, out=np.full(len(t), np.nan), where=total > 1e-6 * total.max())
        colour, width = (BASE, 1.6) if new else (DESIGN, 1.0)
        before, after = (
            100 * float(found[f"{new}{name}"].sel(above=cut, method="nearest")) for name in ("before", "after")
        )
        texts.append(f"{'baseline' if new else 'design'} {before:.3g} % in the pulse, {after:.3g} % after it")
        share.plot(t, 100 * ratio, color=colour, linewidth=width)
        above.plot(t, np.maximum(part, 1e-12), color=colour, linewidth=width)
        above.plot(t, np.maximum(total, 1e-12), color=colour, linewidth=width, linestyle="dotted")
    if "mechanical" in found:
        above.plot(t, np.maximum(found["mechanical"].values, 1e-12), color=BEST, linewidth=0.9, linestyle="dashed")
    share.set_ylim(0, 100)
    share.set_ylabel(f"above {cut:.3g} Hz [%]")
    share.set_title("; ".join(texts), fontsize=9, pad=3)
    above.set_yscale("log")
    biggest = max(float(e.sum(axis=1).max()) for e in energy.values()) or 1.0
    above.set_ylim(1e-4 * biggest, 2 * biggest)
    above.set_ylabel("energy [J]")
    above.set_xlabel(label(found["time"]))
    above.set_xlim(t[0], t[-1])
    for ax in (share, above):
        pulse(ax, found)
    head(figure, found)
    handles = [Line2D([], [], color=BASE, linewidth=2, label="baseline"), Line2D([], [], color=DESIGN, label="design"),
               Line2D([], [], color="0.3", label=f"modes above {cut:.3g} Hz"),
               Line2D([], [], color="0.3", linestyle="dotted", label="all modes"),
               Line2D([], [], color=BEST, linestyle="dashed", label="ledger of the design, with devices")]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def plot_fatigue(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Damage along the cable, and number and damage of the cycles of each stress range at the worst place."""
    figure = draw_in(figure, (9.6, 4.6))
    place, ranges = figure.subplots(1, 2)
    lower = ranges.twinx()
    ranges.spines["right"].set_visible(True)
    bins = found["range"].values
    width = (bins[1] - bins[0]) if len(bins) > 1 else 1.0
    handles: list[Any] = []
    for new, text, colour in (("baseline_", base_label(found), BASE), ("", design_label(found), DESIGN)):
        if f"{new}damage" not in found:
            continue
        place.plot(found[f"{new}damage"].values, found[f"{new}s"].values, color=colour, marker="o", markersize=2.5)
        shift = 0.0 if not new else -0.2 * width
        lower.bar(bins + shift + 0.1 * width, found[f"{new}done"].values, 0.4 * width, color=colour, alpha=0.45)
        ranges.plot(bins, np.where(found[f"{new}cycles"] > 0, found[f"{new}cycles"], np.nan), color=colour, marker=".")
        handles.append(Line2D([], [], color=colour, label=text))
    for s in np.atleast_1d(found.attrs.get("device_s", [])):
        place.axhline(float(s), color="0.85", linewidth=0.8, zorder=0)
    place.set_xscale("log")
    place.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    place.xaxis.set_major_formatter("{x:.0e}")
    place.xaxis.set_minor_formatter("")
    place.set_xlabel("damage of the worst fibre [-]")
    place.set_ylabel("arc length from end A [m]")
    ranges.set_yscale("log")
    ranges.set_xlabel("stress range [MPa]")
    ranges.set_ylabel("lines: number of cycles [-]")
    lower.set_ylabel("bars: their damage [-]")
    ranges.set_title("cycles at the worst place", fontsize=9, pad=3)
    error = float(found.attrs["error"])
    place.set_title(f"every other output left out: {100 * error:.2g} %", fontsize=9, pad=3)
    head(figure, found)
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


# --------------------------------------------------------------------------- sensitivity


def plot_sensitivity(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Indices of each variable for each metric, with their intervals; of a screening mu* against sigma."""
    names, variables = found["metric"].values, found["variable"].values
    columns = min(len(names), 3)
    rows = math.ceil(len(names) / columns)
    screening = found.attrs["kind"] == "morris"
    wide = max(3.6, 0.75 * len(variables) + 1.2)
    figure = draw_in(figure, (max(wide * columns, 5.0), (3.4 if screening else 3.1) * rows + 0.7))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    place = np.arange(len(variables))
    for k, (ax, name) in enumerate(zip(panels, names, strict=False)):
        here = found.isel(metric=k)
        what = {"saltelli": "blocks", "morris": "trajectories", "given": "points"}[str(found.attrs["kind"])]
        used = f"{int(here['complete'])} of {int(here['blocks'])} {what}"
        ax.set_title(f"{name}, {used}", fontsize=9, pad=3)
        if screening:
            x, y = here["mu_star"].values, here["sigma"].values
            ax.errorbar(x, y, xerr=here["mu_star_conf"].values, fmt="o", color=DESIGN, ecolor="0.5", capsize=2.5)
            for j, variable in enumerate(variables):
                if np.isfinite(x[j]):
                    ax.annotate(str(variable), (x[j], y[j]), xytext=(5, 5), textcoords="offset points", fontsize=9)
            unit = metric_unit(str(name))
            ax.set_xlabel(f"mean size of the effect, μ* [{unit}]")
            ax.set_ylabel(f"its standard deviation, σ [{unit}]")
            ax.set_xlim(left=0)
            ax.set_ylim(bottom=0)
        else:
            looks = [("S1", -0.17, DESIGN, "o"), ("ST", 0.17, BEST, "s")] if "ST" in found else [("S1", 0, DESIGN, "o")]
            for entry, shift, colour, marker in looks:
                ax.errorbar(place + shift, here[entry].values, yerr=here[f"{entry}_conf"].values, fmt=marker,
                            color=colour, ecolor=colour, elinewidth=1.0, capsize=3)  # fmt: skip
            ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
            ax.set_xticks(place, [str(v) for v in variables], rotation=30 if len(variables) > 4 else 0)
            ax.set_xlim(-0.6, len(variables) - 0.4)
            ax.set_ylabel("share of the variance [-]")
        if not np.isfinite(here["variance"].values):
            ax.text(0.5, 0.5, "no indices", transform=ax.transAxes, ha="center", color="0.4")
    for ax in panels[len(names) :]:
        ax.remove()
    figure.suptitle(f"{found.attrs.get('study', '')}: sensitivity, {found.attrs['sampler']} design", x=0.01, ha="left",
                    fontsize=10)  # fmt: skip
    if not screening:
        handles = [Line2D([], [], color=DESIGN, marker="o", linestyle="", label="S1: alone")]
        if "ST" in found:
            text = "ST: with all interactions"
            handles.append(Line2D([], [], color=BEST, marker="s", linestyle="", label=text))
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def save_sensitivity(found: xr.Dataset, path: Path) -> Path:
    """Draw the indices into a file."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(layout="constrained")
        plot_sensitivity(found, figure)
        return write_whole(path, lambda place: figure.savefig(place, format="png"))
