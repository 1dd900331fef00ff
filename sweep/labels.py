"""How figures look and speak: colours safe for the colour-blind, and labels from units and the table of metrics."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .config import find_metric, split_name

DESIGN, BASE, BEST, FAIR = "#0072B2", "#8c8c8c", "#D55E00", "#009E73"  # Okabe and Ito; grey for baselines
YELLOW, PINK, SKY = "#E69F00", "#CC79A7", "#56B4E9"
MAP = "viridis"
STYLE: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.2,
    "axes.grid": False,
    "savefig.dpi": 130,
}
SYMBOLS = {
    "delta": "Δ",
    "gamma": "Γ",
    "t_first": r"$t_\mathrm{first}$",
    "t_settle": r"$t_\mathrm{settle}$",
    "t_energy": r"$t_\mathrm{energy}$",
}
BASELINES = {
    "plain": "without devices",
    "uniform": "masses spread along the cable",
    "locked": "masses locked at their points",
    "rod_locked": "rods and locked masses",
    "full_rod": "a rod from end to end",
}


def pretty_unit(unit: str) -> str:
    """``1/m`` and ``N m2`` as they are read; ``-`` for a pure number."""
    if unit in ("", "1"):
        return "-"
    return unit.replace("2", "²").replace("3", "³").replace("^0.5", "$^{1/2}$")


def label(array: xr.DataArray, text: str | None = None) -> str:
    """A quantity's name (or ``text``) and its unit."""
    return f"{text or array.attrs.get('long_name', array.name)} [{pretty_unit(array.attrs.get('units', '1'))}]"


def readable(array: xr.DataArray) -> xr.DataArray:
    """Thousands of newtons in kN and less than a decimetre in mm; anything else as it is."""
    unit = array.attrs.get("units")
    largest = float(np.nanmax(np.abs(array.values), initial=0.0))
    if unit == "N" and largest >= 2000:
        return (array / 1000).assign_attrs(array.attrs | {"units": "kN"})
    if unit == "m" and largest < 0.1:
        return (array * 1000).assign_attrs(array.attrs | {"units": "mm"})
    return array


def variable_label(variable: xr.DataArray) -> str:
    """A design variable's name and unit."""
    return label(variable, str(variable.name))


def symbol(name: str) -> str:
    """A metric as it is written in a figure."""
    stem, said = split_name(name)
    return ", ".join([SYMBOLS.get(stem, stem.replace("_", " ")), *said])


ACROSS, UP, WORDS = ("← better", "better →"), ("↓ better", "↑ better"), ("less is better", "more is better")


def metric_label(name: str, better: tuple[str, str] = ACROSS, between: str = "   ") -> str:
    """A metric's symbol and unit from METRICS, and which way is better (``better`` says it for less and more)."""
    metric = find_metric(name)
    if metric is None:
        return name
    way = {"min": better[0], "max": better[1]}.get(metric.direction or "")
    text = f"{symbol(name)} [{pretty_unit(metric.unit)}]"
    return f"{text}{between}{way}" if way else text


def metric_unit(name: str) -> str:
    """A metric's unit as it is read."""
    metric = find_metric(name)
    return "-" if metric is None else pretty_unit(metric.unit)


def draw_in(figure: Figure | None, size: tuple[float, float]) -> Figure:
    """The given figure, or a new one, at this size [inch]."""
    if figure is None:
        from matplotlib import pyplot

        figure = pyplot.figure(layout="constrained")
    figure.set_size_inches(*size)
    return figure


def draw_on(ax: Axes | None, size: tuple[float, float] = (7.0, 4.2)) -> Axes:
    """The given axes, or those of a new figure."""
    return draw_in(None, size).subplots() if ax is None else ax
