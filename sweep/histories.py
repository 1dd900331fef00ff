"""Figures of one point over time, along the cable and over frequency, and of the force laws of its devices.

They read the datasets that `series` makes: `reduce`, `spectrum`, `wavelet`, `orders`, `loop_of`, `responses` and
`force_laws`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator

from .labels import (
    BASE,
    BASELINES,
    BEST,
    DESIGN,
    FAIR,
    MAP,
    PINK,
    SKY,
    YELLOW,
    draw_in,
    draw_on,
    label,
    pretty_unit,
    readable,
    symbol,
)
from .series import at


def _needs(series: xr.Dataset, *names: str) -> None:
    missing = [name for name in names if name not in series]
    if missing:
        raise ValueError(f"these series hold no {', '.join(missing)}")


def base_label(series: xr.Dataset) -> str:
    name = str(series.attrs.get("baseline", ""))
    return f"baseline `{name}`: {BASELINES[name]}" if name in BASELINES else "baseline"


def design_label(series: xr.Dataset) -> str:
    return "with devices" if int(series.attrs.get("devices", 1)) else "the design, without devices"


def title(series: xr.Dataset) -> str:
    """Which point this is; an untrusted one says so."""
    parts = [f"design {series.attrs['design']}"] if "design" in series.attrs else []
    parts += [f"point {series.attrs['key']}"] if "key" in series.attrs else []
    parts += [str(series.attrs["environment"])] if "environment" in series.attrs else []
    if series.attrs.get("status", "OK") != "OK":
        parts.append(f"untrusted: {series.attrs['status']}")
    return ", ".join(parts)


def head(figure: Figure, series: xr.Dataset) -> None:
    figure.suptitle(title(series), x=0.01, ha="left", fontsize=10)


def pulse(ax: Axes, series: xr.Dataset) -> None:
    """Shade the time in which the end is moved."""
    if float(series.attrs.get("pulse_end", 0.0)) > 0:
        ax.axvspan(0, float(series.attrs["pulse_end"]), color="0.93", linewidth=0, zorder=0)


def _metric(series: xr.Dataset, name: str) -> float:
    return float(series.attrs.get(f"metric_{name}", math.nan))


def stations(series: xr.Dataset, count: int = 5) -> list[float]:
    """Arc lengths to show, from the top down: evenly along the cable, one of them moved to the probe."""
    arc = series["arc"].values
    places = list(arc[0] + (arc[-1] - arc[0]) * (np.arange(count)[::-1] + 0.5) / count)
    probe = float(series.attrs.get("probe", math.nan))
    if not math.isnan(probe):
        places[int(np.abs(np.array(places) - probe).argmin())] = probe
    return [float(s) for s in places]


def plot_history(series: xr.Dataset, figure: Figure | None = None, *, places: Sequence[float] | None = None) -> Figure:
    """Transverse displacement over time at stations along the cable, with devices and for the baseline."""
    _needs(series, "displacement", "arc")
    chosen = list(places or stations(series))
    figure = draw_in(figure, (8.0, 1.45 * len(chosen) + 1.1))
    panels = figure.subplots(len(chosen), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    t = series["time"].values
    probe = float(series.attrs.get("probe", math.nan))
    for ax, s in zip(panels, chosen, strict=True):
        pulse(ax, series)
        if "baseline_displacement" in series:
            ax.plot(t, at(series, s, "baseline_displacement"), color=BASE, linewidth=1.5)
        ax.plot(t, at(series, s), color=DESIGN, linewidth=1.0)
        text = f"s = {s:.2f} m, depth {float(at(series, s, 'depth')):.2f} m"
        ax.set_title(text + (" (probe)" if s == probe else ""), fontsize=9, pad=2)
        ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    panels[-1].set_xlabel(label(series["time"], "time"))
    panels[-1].set_xlim(t[0], t[-1])
    figure.supylabel(label(series["displacement"], "transverse displacement"), fontsize=10)
    head(figure, series)
    handles: list[Any] = [Line2D([], [], color=DESIGN, label=design_label(series))]
    if "baseline_displacement" in series:
        handles.append(Line2D([], [], color=BASE, linewidth=2, label=base_label(series)))
    if float(series.attrs.get("pulse_end", 0)) > 0:
        handles.append(Patch(color="0.93", label="end moved"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def plot_stroke(series: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Offset of each device's mass from the cable, its rest positions and its cross-well jumps."""
    moving = moving_devices(series)
    figure = draw_in(figure, (8.0, 1.75 * len(moving) + 1.0))
    panels = figure.subplots(len(moving), 1, sharex=True, squeeze=False)[:, 0]
    t = series["time"].values
    for ax, i in zip(panels, moving, strict=True):
        pulse(ax, series)
        y, y0 = series["stroke"].values[:, i], float(series["rest_offset"][i])
        at = t[series["jump"].values[:, i] > 0] if "jump" in series else np.zeros(0)
        ax.vlines(at, 0, 1, transform=ax.get_xaxis_transform(), color=BEST, linewidth=0.8, linestyles=(0, (4, 2)))
        ax.plot(t, y, color=DESIGN, linewidth=1.1)
        if y0 > 0:
            ax.hlines([-y0, y0], t[0], t[-1], color="black", linewidth=0.8, linestyles="dotted")
            for side, text in ((1, "+y0"), (-1, "-y0")):
                ax.annotate(
                    text, (1, side * y0), xycoords=ax.get_yaxis_transform(), xytext=(3, 0),
                    textcoords="offset points", va="center", fontsize=8, annotation_clip=False,
                )  # fmt: skip
        jumps = f"{len(at)} cross-well jump{'s' * (len(at) != 1)}" if y0 > 0 else "one well"
        kind = f" ({series['device_kind'].values[i]})" if "device_kind" in series else ""
        place = f" at s = {float(series['device_s'][i]):.2f} m" if "device_s" in series else ""
        ax.set_title(f"device {i + 1}{kind}{place}: {jumps}", fontsize=9, pad=2)
    panels[-1].set_xlim(t[0], t[-1])
    panels[-1].set_xlabel(label(series["time"], "time"))
    figure.supylabel(label(series["stroke"], "offset of the mass from the cable"), fontsize=10)
    head(figure, series)
    handles = [Line2D([], [], color=DESIGN, label="offset y")]
    if np.any(series["rest_offset"].values[moving] > 0):
        handles += [
            Line2D([], [], color="black", linestyle="dotted", label="rest, ±y0"),
            Line2D([], [], color=BEST, linestyle=(0, (4, 2)), linewidth=0.9, label="mid-stroke of a jump"),
        ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def moving_devices(series: xr.Dataset) -> list[int]:
    stroke = series["stroke"].values if "stroke" in series else np.zeros((1, 0))
    found = [i for i in range(stroke.shape[1]) if np.ptp(stroke[:, i]) > 0]
    if not found:
        raise ValueError("no device of this design moves relative to the cable")
    return found


def plot_envelope(series: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Least and greatest transverse displacement along the cable."""
    _needs(series, "displacement", "arc")
    ax = draw_on(ax, (5.6, 6.4))
    shapes = [("baseline_", BASE, base_label(series), 0.35), ("", DESIGN, design_label(series), 0.30)]
    for prefix, colour, text, alpha in shapes:
        if f"{prefix}displacement" not in series:
            continue
        field, arc = series[f"{prefix}displacement"], series[f"{prefix}arc"].values
        low, high = field.min("time").values, field.max("time").values
        ax.fill_betweenx(arc, low, high, color=colour, alpha=alpha, linewidth=0, label=text)
        ax.plot(low, arc, color=colour)
        ax.plot(high, arc, color=colour)
    ax.axvline(0, color="0.7", linewidth=0.7, zorder=0)
    for i, s in enumerate(series["device_s"].values if "device_s" in series else []):
        ax.plot([0], [s], marker="o", markersize=6, color="white", markeredgecolor="black")
        ax.annotate(f"{i + 1}", (0, s), xytext=(7, 0), textcoords="offset points", va="center", fontsize=9)
    if "device_s" in series:
        ax.plot([], [], "o", markersize=6, color="white", markeredgecolor="black", label="devices")
    ax.set_xlabel(label(series["displacement"], "transverse displacement, least and greatest"))
    ax.set_ylabel(label(series["arc"], "arc length from end A"))
    ax.set_ylim(float(series["arc"].min()), float(series["arc"].max()))
    ax.set_title(title(series))
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=1)
    return ax


def plot_gt(series: xr.Dataset, ax: Axes | None = None) -> Axes:
    """G(t) with its level 0.9 and t_first, and the share of the integral of x^2 that is over with t_settle."""
    _needs(series, "G")
    ax = draw_on(ax)
    t = series["time"].values
    index = series["G"].values
    ax.plot(t, index, color=DESIGN, label=f"G(t) against {base_label(series)}")
    if "share" in series:
        ax.plot(t, series["share"].values, color=FAIR, label=r"share of the design's own $\int x^2$ that is over")
    ax.axhline(0.9, color="0.4", linewidth=0.9, linestyle="dashed", label="0.9")
    first, settle = _metric(series, "t_first"), _metric(series, "t_settle")
    seconds = pretty_unit(series["time"].attrs.get("units", "s"))
    shown = np.concatenate((index, series["share"].values)) if "share" in series else index
    low, high = max(float(np.nanmin(shown)), -1.0), max(float(np.nanmax(shown)), 1.0)
    if math.isfinite(first):
        ax.plot([first, first], [low, 0.9], color=DESIGN, linestyle="dotted")
        ax.plot(
            first, 0.9, "v", color=DESIGN, label=f"{symbol('t_first')} = {first:.3f} {seconds}: G first reaches 0.9"
        )
    else:
        ax.plot([], [], " ", label=f"{symbol('t_first')} = {first}: G never reaches 0.9")
    if math.isfinite(settle):
        ax.plot([settle, settle], [low, 0.9], color=FAIR, linestyle="dotted")
        text = f"{symbol('t_settle')} = {settle:.3f} {seconds}: 90 % is over"
        ax.plot(settle, 0.9, "o", color=FAIR, label=text)
    ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    ax.set_xlim(t[0], t[-1])
    ax.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    ax.set_xlabel(label(series["time"], "time"))
    ax.set_ylabel(label(series["G"], "G, share"))
    ax.set_title(title(series))
    ax.legend(loc="upper left", bbox_to_anchor=(0, -0.16), ncols=1)
    return ax


def plot_energy(series: xr.Dataset, figure: Figure | None = None) -> Figure:
    """The energy ledger: where the work went, what is stored, and what the balance leaves open."""
    _needs(series, "work", "kinetic", "residual", "mechanical")
    figure = draw_in(figure, (8.0, 7.2))
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 1.3])
    t = series["time"].values
    parts = [("lost_water", SKY, "lost to water"), ("lost_cable", YELLOW, "lost in the cable"),
             ("lost_device", PINK, "lost in devices"), ("lost_seabed", "#B8860B", "lost to the bed"),
             ("mechanical", DESIGN, "stored")]  # fmt: skip
    shown = [(name, colour, text) for name, colour, text in parts if np.any(series[name].values != 0)]
    ends = [f"{text} ({_joules(float(series[name][-1]))})" for name, _, text in shown]
    top.stackplot(t, *(series[name].values for name, _, _ in shown), colors=[c for _, c, _ in shown],
                  labels=ends, alpha=0.85, linewidth=0)  # fmt: skip
    put_in = series["work"].values + series["rotation"].values + float(series["mechanical"][0] - series["work"][0])
    turned = float(np.abs(series["rotation"]).max()) > 0.01 * max(float(np.abs(series["work"]).max()), 1e-300)
    text = "work put in" + (", with turning added mass" if turned else "")
    top.plot(t, put_in, color="black", linewidth=1.0, linestyle="dashed", label=f"{text} ({_joules(put_in[-1])})")
    top.set_ylabel(label(series["work"], "where the work went"))
    looks = (("kinetic", DESIGN, "-"), ("strain", BEST, "-"), ("gravity", "black", "dotted"))
    names = {"kinetic": "kinetic", "strain": "strain, above static", "gravity": "weight and buoyancy, above static"}
    for name, colour, style in looks:
        middle.plot(t, series[name].values, color=colour, linestyle=style, label=names[name], linewidth=1.0)
    middle.set_ylabel(label(series["kinetic"], "stored"))
    ended = _metric(series, "t_energy")
    if math.isfinite(ended):
        text = f"{symbol('t_energy')} = {ended:.3f} s: 10 % of the peak"
        middle.axvline(ended, color="0.3", linewidth=0.9, linestyle="dashed", label=text)
    bottom.plot(t, series["residual"].values, color="black", linewidth=0.9)
    limit = 1e-3
    for level in (-limit, limit):
        bottom.axhline(level, color=BEST, linewidth=0.9, linestyle="dashed")
    reach = max(1.3 * limit, 1.1 * float(np.abs(series["residual"]).max()))
    bottom.set_ylim(-reach, reach)
    bottom.ticklabel_format(axis="y", style="plain")
    bottom.set_ylabel(label(series["residual"], "gap / peak"))
    bottom.set_title("balance: dashed lines bound what is trusted", fontsize=9, pad=2)
    bottom.set_xlabel(label(series["time"], "time"))
    bottom.set_xlim(t[0], t[-1])
    top.set_title(title(series))
    for ax in (top, middle):
        pulse(ax, series)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _joules(value: float) -> str:
    return f"{value:.3g} J"


def draw_transform(ax: Axes, transform: xr.Dataset, name: str, norm: PowerNorm) -> Any:
    """A wavelet transform over time and frequency, dashed where the record's ends weigh in; the coloured mesh."""
    t, f, edge = transform["time"].values, transform["frequency"].values, transform["edge"].values
    mesh = ax.pcolormesh(t, f, transform[name].values, norm=norm, cmap="magma_r", shading="nearest", rasterized=True)
    for side in (t[0] + edge, t[-1] - edge):
        ax.plot(side, f, color="black", linewidth=0.9, linestyle="dashed")
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    ax.set_ylim(f[0], f[-1])
    ax.set_xlim(t[0], t[-1])
    return mesh


def plot_wavelet(transform: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Morlet transform of the displacement at the probe, for the baseline and with devices, on one scale."""
    _needs(transform, "displacement")
    names = [n for n in ("baseline_displacement", "displacement") if n in transform]
    figure = draw_in(figure, (8.0, 3.1 * len(names) + 0.6))
    panels = figure.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    norm = PowerNorm(0.5, 0.0, max(float(transform[n].max()) for n in names) or 1.0)
    mesh: Any = None
    for ax, name in zip(panels, names, strict=True):
        mesh = draw_transform(ax, transform, name, norm)
        ax.set_ylabel(label(transform["frequency"]))
        which = (
            base_label(transform)
            if name.startswith("baseline")
            else f"{design_label(transform)} ({title(transform)})"
        )
        ax.set_title(f"{which}, s = {transform.attrs['s']:.2f} m", fontsize=9, pad=3)
    panels[-1].set_xlabel(label(transform["time"], "time") + ";   outside the dashed lines the record's ends weigh in")
    figure.colorbar(mesh, ax=list(panels), label=label(transform[names[0]], "|X|"), pad=0.02)
    return figure


def plot_spectrum(spectra: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Amplitude spectrum of the displacement at the probe."""
    _needs(spectra, "displacement")
    ax = draw_on(ax)
    f = spectra["frequency"].values
    energy = np.zeros(len(f))
    looks = (
        ("baseline_displacement", BASE, base_label(spectra), 1.6),
        ("displacement", DESIGN, design_label(spectra), 1.1),
    )
    for name, colour, text, width in looks:
        if name in spectra:
            ax.plot(f[1:], spectra[name].values[1:], color=colour, label=text, linewidth=width)
            energy = energy + spectra[name].values ** 2
    shown = np.flatnonzero(energy > 1e-4 * energy.max())
    last = min(2 * max(int(shown[-1]), 4), len(f) - 1) if shown.size else len(f) - 1
    peak = max(float(spectra[name].max()) for name in spectra.data_vars) or 1.0
    ax.set_yscale("log")
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("")
    ax.set_xlim(f[1], f[last])
    ax.set_ylim(peak * 1e-4, peak * 2)
    ax.set_xlabel(label(spectra["frequency"]))
    ax.set_ylabel(label(spectra["displacement"]))
    ax.grid(alpha=0.25, linewidth=0.6)
    ax.set_title(f"{title(spectra)}, s = {spectra.attrs['s']:.2f} m".lstrip(", "))
    ax.legend()
    return ax


# --------------------------------------------------------------------------- periodic responses


def plot_orders(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Harmonics of the end tension and of the displacement at the probe, as bars over multiples of the frequency."""
    _needs(found, "displacement", "order")
    shown = [name for name in ("tension", "displacement") if name in found]
    figure = draw_in(figure, (7.6, 2.7 * len(shown) + 1.0))
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    order = found["order"].values
    for ax, name in zip(panels, shown, strict=True):
        pairs = [(found[name], DESIGN, 0.0)]
        # a design without devices is often its own baseline
        if name == "displacement" and "baseline_displacement" in found and int(found.attrs.get("devices", 1)):
            pairs = [(found[name], DESIGN, -0.2), (found["baseline_displacement"], BASE, 0.2)]
        top = max(float(array.max()) for array, _, _ in pairs) or 1.0
        for array, colour, shift in pairs:
            ax.bar(order + shift, np.maximum(array.values, 1e-9 * top), 0.8 / len(pairs), color=colour)
        ax.set_yscale("log")
        ax.set_ylim(top * 1e-5, top * 3)
        ax.set_ylabel(label(found[name], "amplitude"))
        text = str(found[name].attrs["long_name"]).removeprefix("amplitude of the ")
        place = f", s = {found.attrs['s']:.2f} m" if name == "displacement" else ""
        still = abs(float(found[name].attrs["mean"])) < 1e-6 * top
        mean = "; mean 0" if still else f"; mean {_with_unit(float(found[name].attrs['mean']), found[name])}"
        rest = float(found[name].attrs["rest"])
        about = f"; {100 * rest:.2g} % not periodic" if rest > 1e-3 else ""
        ax.set_title(f"{text}{place}{mean}{about}", fontsize=9, pad=3)
        ax.grid(axis="y", alpha=0.25, linewidth=0.6)
        ax.set_axisbelow(True)
    panels[-1].set_xticks(order)
    base = 1 / float(found.attrs["period"])
    panels[-1].set_xlabel(f"{label(found['order'])}, {base:.4g} Hz")
    head(figure, found)
    if "baseline_displacement" in found and int(found.attrs.get("devices", 1)):
        handles = [Patch(color=DESIGN, label=design_label(found)), Patch(color=BASE, label=base_label(found))]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _with_unit(value: float, array: xr.DataArray) -> str:
    shown = readable(xr.DataArray(value, attrs={"units": array.attrs.get("units", "1")}))
    return f"{float(shown):.4g} {pretty_unit(shown.attrs['units'])}"


def plot_spectrum_or_orders(found: xr.Dataset, figure: Figure) -> Any:
    """Harmonics where they are known, else the spectrum."""
    if "order" in found.dims:
        return plot_orders(found, figure)
    figure.set_size_inches(7.2, 4.4)
    return plot_spectrum(found, figure.subplots())


def plot_loop(found: xr.Dataset, ax: Axes | None = None) -> Axes:
    """End tension against end displacement over one period: harmonic balance on the march's last period."""
    ax = draw_on(ax, (6.4, 5.6))
    axes: list[str] = ["", ""]
    if "march_tension" in found:
        x, y = readable(found["march_displacement"]), readable(found["march_tension"])
        axes = [label(x), label(y)]
        for i in range(x.shape[0] - 1):
            text = f"the {x.shape[0] - 1} periods before it" if i == 0 else None
            ax.plot(x.values[i], y.values[i], color=YELLOW, linewidth=0.7, alpha=0.8, label=text)
        text = f"time domain, last period{_ended(found, 'march')}"
        ax.plot(x.values[-1], y.values[-1], color=YELLOW, linewidth=4.0, label=text)
    if "tension" in found:
        x, y = readable(found["displacement"]), readable(found["tension"])
        axes = [label(x), label(y)]
        text = f"harmonic balance{_ended(found, 'harmonic')}"
        ax.plot(x.values, y.values, color=DESIGN, linewidth=1.3, label=text)
    for name, text in (("tension", "harmonic"), ("march_tension", "march")):
        if name not in found:
            ax.plot([], [], " ", label=_short(f"no {text}: {found.attrs.get(text, '')}"))
    ax.set_xlabel(axes[0])
    ax.set_ylabel(axes[1])
    gap = ""
    if "gap" in found.attrs:
        gap = f"\nlargest gap of the two: {100 * found.attrs['gap']:.2g} % of the tension's range"
    ax.set_title(f"{title(found)}, period {found.attrs['period']:.4g} s".lstrip(", ") + gap)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=1)
    return ax


def _ended(found: xr.Dataset, name: str) -> str:
    status = str(found.attrs.get(f"{name}_status", "OK"))
    return "" if status == "OK" else f" ({status})"


def _short(text: str, most: int = 90) -> str:
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


def plot_response(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Frequency response, or that along any variable: stable, unstable, folds; the study's own rows as points."""
    _needs(found, "half_range", "parameter")
    count, curves = found.sizes["panel"], found.sizes["curve"]
    columns = min(count, 2)
    rows = math.ceil(count / columns)
    figure = draw_in(figure, (max(4.6 * columns, 7.2), (3.5 if rows > 1 else 4.2) * rows + 1.5))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    colours = matplotlib.colormaps[MAP](np.linspace(0, 0.9, curves))
    half, row_half = readable(found["half_range"]), found["row_half_range"]
    row_half = row_half * {"kN": 1e-3, "mm": 1e3}.get(half.attrs["units"], 1.0)
    x, row_x = found["parameter"].values, found["row_parameter"].values
    short = False
    for p, ax in enumerate(panels[:count]):
        for k in range(curves):
            good = np.isfinite(x[p, k])
            stable = found["stable"].values[p, k][good] > 0
            a, b = x[p, k][good], half.values[p, k][good]
            for which, style in ((stable, "-"), (~stable, (0, (3, 1.5)))):
                both = which.copy()  # the stable pieces go on to the points where stability changes
                both[1:] |= which[:-1]
                both[:-1] |= which[1:]
                if not which.any():
                    continue
                ax.plot(a, np.where(both if style == "-" else which, b, np.nan), color=colours[k], linestyle=style)
            turn = found["fold"].values[p, k][good] > 0
            ax.plot(a[turn], b[turn], "D", color=BEST, markersize=5, zorder=4)
            trusted = found["row_trusted"].values[p, k] > 0
            look: Any = {"linestyle": "", "marker": "o", "markersize": 4.2, "color": colours[k]}
            ax.plot(row_x[p, k][trusted], row_half.values[p, k][trusted], **look)
            ax.plot(row_x[p, k][~trusted], row_half.values[p, k][~trusted], **look, markerfacecolor="white")
            lost = found["row_failed"].values[p, k] > 0
            if lost.any():  # an unclipped line of no points would upset the layout
                ax.plot(row_x[p, k][lost], np.zeros(np.count_nonzero(lost)), "x", color=colours[k], markersize=6,
                        transform=ax.get_xaxis_transform(), clip_on=False, zorder=5)  # fmt: skip
            if str(found["note"].values[p, k]) and a.size:
                short = True
                ax.plot(a[-1], b[-1], "|", color=colours[k], markersize=12, markeredgewidth=1.6)
        if count > 1:
            ax.set_title(str(found["environment"].values[p]), fontsize=9, pad=3)
        ax.grid(alpha=0.25, linewidth=0.6)
        if p >= count - columns:
            ax.set_xlabel(label(found["parameter"]))
            ax.xaxis.set_tick_params(labelbottom=True)
        if p % columns == 0:
            ax.set_ylabel(label(half))
    for ax in panels[count:]:
        ax.remove()
    panels[0].set_ylim(bottom=0)
    figure.suptitle(_response_title(found), x=0.01, ha="left", fontsize=10)
    handles: list[Any] = [
        Line2D([], [], color=colours[k], linewidth=2, label=str(found["others"].values[k]) or "the response")
        for k in range(curves)
    ]
    black: dict[str, Any] = {"color": "0.25"}
    handles += [
        Line2D([], [], **black, label="stable"),
        Line2D([], [], **black, linestyle=(0, (3, 1.5)), label="unstable"),
    ]
    if np.any(found["fold"].values > 0):
        handles.append(Line2D([], [], color=BEST, marker="D", markersize=5, linestyle="", label="fold"))
    dot: dict[str, Any] = {**black, "linestyle": "", "marker": "o", "markersize": 4.2}
    handles += [Line2D([], [], **dot, label="row, trusted"),
                Line2D([], [], **dot, markerfacecolor="white", label="row, untrusted")]  # fmt: skip
    if np.any(found["row_failed"].values > 0):
        handles.append(Line2D([], [], **black, linestyle="", marker="x", label="row, failed"))
    if short:
        handles.append(Line2D([], [], **black, linestyle="", marker="|", markersize=11, label="not followed further"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4 if columns == 2 else 3)
    return figure


def _response_title(found: xr.Dataset) -> str:
    here = np.isfinite(found["row_parameter"].values)
    trusted = int((found["row_trusted"].values[here] > 0).sum())
    failed = int((found["row_failed"].values[here] > 0).sum())
    parts = [f"{found.attrs.get('study', '')}: {trusted} of the {int(here.sum())} rows on these curves are trusted"]
    parts += [f"{failed} failed"] if failed else []
    curves, of = found.sizes["curve"], int(found.attrs.get("curves_of", found.sizes["curve"]))
    parts += [f"{curves} of {of} curves"] if of > curves else []
    panels, of = found.sizes["panel"], int(found.attrs.get("panels_of", found.sizes["panel"]))
    parts += [f"{panels} of {of} environments"] if of > panels else []
    return ", ".join(parts).lstrip(": ")


# --------------------------------------------------------------------------- the line at its last output time

ROD, CATENARY = "#1a1a1a", BEST
OVER = ((BASE, 5.0), (YELLOW, 3.8), (SKY, 3.0), (PINK, 2.4))  # colours and widths of what lies under the point's line


def plot_profile(found: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Shape, tension, shear and bending moment along the line at the last output time, over those of other runs.

    Rods are thick and dark, catenaries thin and red; baseline and other points lie under them, wide and pale, and
    thin where they are catenaries.
    """
    _needs(found, "last_s", "last_tension")
    prefixes = ["baseline_"] if "baseline_last_s" in found else []
    prefixes += [f"over{i}_" for i in range(1, 10) if f"over{i}_last_s" in found]
    bends = any(f"{prefix}last_moment" in found for prefix in ("", *prefixes))
    panels = [("last_away", "last_height"), ("last_middle", "last_tension")]
    panels += [("last_s", "last_shear"), ("last_s", "last_moment")] if bends else []
    figure = draw_in(figure, (9.6, (6.4 if bends else 3.4) + 0.25 * len(prefixes)))
    for ax, (across, up) in zip(figure.subplots(len(panels) // 2, 2).ravel(), panels, strict=True):
        units: list[xr.DataArray] = []
        for k, prefix in enumerate((*prefixes, "")):
            if prefix + up not in found:
                continue
            x, y, domain = found[prefix + across], found[prefix + up], found.get(f"{prefix}last_domain")
            units, count = [x, y], found.sizes[f"{prefix}last_segment"]
            for a, b, rod in _stretches(None if domain is None else domain.values, count):
                end = b if up == "last_tension" else b + 1  # tension is that of segments, the rest of nodes
                values = y.values[a:end]
                if not rod and up in ("last_shear", "last_moment"):
                    values = np.zeros_like(values)  # the joint's node belongs to the rod
                colour, width = OVER[min(k, 3)] if prefix else ((ROD, 2.2) if rod else (CATENARY, 1.3))
                ax.plot(x.values[a:end], values, color=colour, linewidth=width if rod or not prefix else 0.5 * width)
        ax.set_xlabel(label(units[0]))
        ax.set_ylabel(label(units[1]))
        ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
        if up == "last_height":
            ax.set_aspect("equal", adjustable="datalim")
            for place, name in ((0, "A"), (-1, "B")):
                where = (found[across].values[place], found[up].values[place])
                ax.annotate(name, where, xytext=(0, 7), textcoords="offset points", ha="center", fontsize=9)
    head(figure, found)
    what = ", ".join(str(found.attrs[name]) for name in ("values", "model") if found.attrs.get(name))
    kinds = set(found["last_domain"].values.tolist()) if "last_domain" in found else {1.0}
    looks = [(ROD, 2.2, "rod" if "last_domain" in found else "line", 1), (CATENARY, 1.3, "catenary", 0)]
    handles = [
        Line2D([], [], color=colour, linewidth=width, label=f"{name} ({what})" if what else name)
        for colour, width, name, kind in looks
        if kind in kinds
    ]
    for k, prefix in enumerate(prefixes):
        colour, width = OVER[min(k, 3)]
        text = base_label(found) if prefix == "baseline_" else str(found.attrs.get(f"{prefix}label", ""))
        handles.append(Line2D([], [], color=colour, linewidth=width, label=text))
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _stretches(domain: np.ndarray | None, count: int) -> list[tuple[int, int, bool]]:
    """(first segment, one past the last, whether it is a rod) of each domain; a line without domains is all rod."""
    rod = np.ones(count, dtype=bool) if domain is None else domain > 0.5
    cuts = [0, *(np.flatnonzero(np.diff(rod.astype(int))) + 1), count]
    return [(int(a), int(b), bool(rod[a])) for a, b in pairwise(cuts)]


# --------------------------------------------------------------------------- force laws


def plot_force_law(laws: xr.Dataset, figure: Figure | None = None) -> Figure:
    """Springs against tension-only cords for each initial angle, like the paper's figure 3."""
    angles = laws["phi0"].values
    figure = draw_in(figure, (3.1 * len(angles) + 0.6, 3.9))
    panels = figure.subplots(1, len(angles), sharey=True, squeeze=False)[0]
    for i, ax in enumerate(panels):
        x, y0 = laws["x"].values[i], float(laws["rest_offset"][i])
        if y0 > 0:
            ax.axvspan(-2 * y0, 0, color="0.93", linewidth=0)
            ax.plot([-2 * y0, 0], [0, 0], "o", color="black", markersize=4, zorder=4)
        ax.plot(x, laws["force"].sel(law="springs").values[i], color=YELLOW, linewidth=2.6)
        ax.plot(x, laws["force"].sel(law="cords").values[i], color=DESIGN, linewidth=1.2)
        ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
        ax.set_title(f"φ0 = {angles[i]:g}°")
        ax.set_xlabel(label(laws["x"], "x from rest"))
        ax.xaxis.set_major_locator(MaxNLocator(4))
    panels[0].set_ylabel(label(laws["force"], "force F"))
    handles = [
        Line2D([], [], color=YELLOW, linewidth=2.6, label="springs"),
        Line2D([], [], color=DESIGN, label="cords, in tension only"),
        Patch(color="0.93", label="cords slack (2 y0 wide)"),
        Line2D([], [], color="black", marker="o", markersize=4, linestyle="", label="rest positions"),
        Line2D([], [], linestyle="", label=_about_law(laws)),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def plot_force_angle(laws: xr.Dataset, ax: Axes | None = None, *, law: str = "springs") -> Axes:
    """The force law against the initial angle, like the paper's figure 2b."""
    ax = draw_on(ax, (6.4, 4.4))
    angles = laws["phi0"].values
    colours = matplotlib.colormaps[MAP](np.linspace(0, 0.92, len(angles)))
    styles = ("-", (0, (6, 1.5)), "-.", (0, (3, 1)), (0, (1, 0.8)))
    for i, angle in enumerate(angles):
        force = laws["force"].sel(law=law).values[i]
        ax.plot(
            laws["y"].values, force, color=colours[i], linestyle=styles[i % 5], label=f"φ0 = {angle:g}°", linewidth=1.7
        )
        y0 = float(laws["rest_offset"][i])
        ax.plot([-y0, y0], [0, 0], "o", color=colours[i], markersize=4)
    ax.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    ax.set_xlabel(label(laws["y"], "offset from mid-stroke, y"))
    ax.set_ylabel(label(laws["force"], f"force of the {law}, F"))
    ax.set_title(f"{_about_law(laws)}; dots: rest positions")
    ax.legend()
    return ax


def _about_law(laws: xr.Dataset) -> str:
    return f"k = {laws.attrs['k']:g} N/m, half-span {laws.attrs['half_span']:g} m"
