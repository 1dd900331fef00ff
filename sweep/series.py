"""Histories of one point, made ready for figures: rerun with its baseline, reduced, kept in DIR/series/<key>.nc.

Symbols: x displacement normal to the static tangent, in the plane of the motion; G(t) eq. (3.3) of paper 003 with
the square; omega_c the Morlet wavelet's centre. Fourier and wavelet transforms and the force laws of figures 2b
and 3 are here too, as datasets, because figures compute nothing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from solvers import SOURCE_HASH, Scene
from solvers.devices import CORDS, SPRINGS, law_force

from .evaluate import evaluate_with_series
from .metrics import LOSSES, along, count_jumps
from .pareto import best
from .plan import read_plan
from .point import Point, Record
from .store import StoreError, outcome, study_of, write_whole

CENTRE = 6.0  # omega_c of the Morlet wavelet: about six oscillations under its bell
LEDGER = ("kinetic", "strain", "gravity", "work", *(f"lost_{name}" for name in LOSSES), "rotation")
PAPER_SINK = {"k": 2e4, "half_span": 0.05}  # of paper 003's figures 2b and 3 [N/m], [m]


# --------------------------------------------------------------------------- a point of a folder


def chosen_key(dataset: xr.Dataset) -> str:
    """The key of the best point; without trusted points, of the first that has metrics."""
    objectives = json.loads(dataset.attrs.get("objectives", "[]"))
    keys = dataset["key"].values.reshape(dataset["key"].shape[0], -1)
    index = best(dataset, objectives) if objectives else None
    if index is not None:
        return str(keys[index, 0])
    kinds = np.array([outcome(str(status)) for status in dataset["status"].values.ravel()])
    for kind in ("trusted", "untrusted"):
        found = np.flatnonzero(kinds == kind)
        if found.size:
            return str(keys.ravel()[found[0]])
    raise ValueError("no point has metrics yet, and so there is no history to draw: `sweep status` says why")


def series_of(directory: str | Path, key: str) -> xr.Dataset:
    """The histories of a point, from DIR/series or from a new run of the point and its baseline.

    Raises
    ------
    ValueError
        Where the folder has no such point or its run gives no history; the text says why.
    """
    directory = Path(directory)
    path = directory / "series" / f"{key}.nc"
    if path.is_file():
        with xr.open_dataset(path, engine="netcdf4") as known:
            if known.attrs.get("solver") == SOURCE_HASH:
                return known.load()
    study, plan = study_of(directory), read_plan(directory / "plan.json")
    if key not in plan.keys:
        raise ValueError(f"{directory} has no point {key}")
    index = plan.keys.index(key)
    point = plan.point(study, index)
    point = replace(point, settings=replace(point.settings, repeats=0))
    record, raw = evaluate_with_series(point)
    if not raw.sizes.get("time", 0):
        raise ValueError(f"the run of {key} leaves no history: {record.status}, {record.message}")
    series = reduce(raw, point, record)
    series.attrs |= {"key": key, "solver": SOURCE_HASH}
    if len(plan.environments) > 1:
        series.attrs["environment"] = plan.environments[index % len(plan.environments)]
    packed = {str(name): {"zlib": True} for name, array in series.data_vars.items() if array.ndim > 1}
    with suppress(StoreError):  # a folder that may only be read still gives figures
        write_whole(path, lambda place: series.to_netcdf(place, engine="netcdf4", encoding=packed))
    return series


def reduce(raw: xr.Dataset, point: Point, record: Record) -> xr.Dataset:
    """What the figures read of `evaluate_with_series`' dataset, some megabytes instead of a hundred.

    Returns
    -------
    dataset with ``displacement`` (time, node) and ``baseline_displacement`` (time, baseline_node) along one
    sideways direction, ``arc`` and ``depth`` of the nodes, ``stroke`` and ``jump`` (1 where the passage of
    mid-stroke ends in the other well) of the devices, the energy ledger with its ``residual``, ``G``, ``share``
    (of the integral of x^2 that is over), and the record's metrics as attributes ``metric_<name>``
    """
    settings, t = point.settings, raw["time"].values
    sideways = directions(raw)
    kept = {name: raw[name] for name in (*LEDGER, "arc", "stroke", "rest_offset", "G") if name in raw}
    found = xr.Dataset(kept, coords={"time": raw["time"]})
    about = {"units": "m", "long_name": "displacement normal to the static tangent"}
    found["displacement"] = (("time", "node"), _project(raw["transverse"].values, sideways), about)
    found["depth"] = ("node", -raw["static_position"].values[:, 2], {"units": "m", "long_name": "static depth"})
    name = settings.baseline
    if f"{name}_transverse" in raw:
        arc = raw[f"{name}_arc"].values
        nearest = np.abs(raw["arc"].values[None] - arc[:, None]).argmin(axis=1)
        field = _project(raw[f"{name}_transverse"].values, sideways[nearest])
        found["baseline_arc"] = ("baseline_node", arc, raw["arc"].attrs)
        found["baseline_displacement"] = (("time", "baseline_node"), field, about)
    found["share"] = (
        "time",
        _share(raw, settings.window),
        {"units": "1", "long_name": "share of the integral of |x|^2 that is over"},
    )
    _add_energy(found)
    _add_devices(found, point.scene)
    found.attrs = {
        "status": record.status,
        "baseline": name,
        "probe": math.nan if settings.probe is None else settings.probe,
        "pulse_end": settings.pulse_end,
        "design": point.design,
        "devices": len(point.scene.devices),
        **{f"metric_{metric}": value for metric, value in record.metrics.items()},
    }
    if settings.window is not None:
        found.attrs["window"] = list(settings.window)
    assert len(t) == found.sizes["time"]
    return found


def directions(raw: xr.Dataset) -> np.ndarray:
    """(n_node, 3) unit vectors across the cable, in the plane in which it hangs and mostly moves.

    b, the direction in which motion and static tangents are least present, is normal to that plane.
    """
    tangent, field = raw["static_tangent"].values, raw["transverse"].values
    motion = np.einsum("tna,tnb->ab", field, field)
    turning = tangent.T @ tangent
    spread = turning / np.trace(turning) + motion / max(float(np.trace(motion)), 1e-300)
    normal = np.linalg.eigh(spread)[1][:, 0]
    across = np.cross(normal, tangent)
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
    mean = across.mean(axis=0)
    return across * (np.sign(mean[np.abs(mean).argmax()]) or 1.0)


def _project(field: np.ndarray, across: np.ndarray) -> np.ndarray:
    return np.einsum("tna,na->tn", field, across).astype(np.float32)


def _share(raw: xr.Dataset, window: tuple[float, float] | None) -> np.ndarray:
    """Running integral of |x|^2 over its whole, within the window; NaN outside."""
    t = raw["time"].values
    start, stop = window or (t[0], t[-1])
    inside = (t >= start - 1e-9) & (t <= stop + 1e-9)
    x2 = along(raw["transverse"].values, np.diff(raw["arc"].values), raw["rigid"].values > 0.5)[inside]
    running = np.concatenate(([0.0], np.cumsum(0.5 * (x2[1:] + x2[:-1]) * np.diff(t[inside]))))
    found = np.full(len(t), np.nan)
    found[inside] = running / running[-1] if running.size and running[-1] > 0 else np.nan
    return found


def _add_energy(found: xr.Dataset) -> None:
    mechanical = found["kinetic"] + found["strain"] + found["gravity"]
    lost = sum((found[f"lost_{name}"] for name in LOSSES), xr.zeros_like(mechanical))
    gap = mechanical - mechanical[0] - (found["work"] - found["work"][0]) + lost - lost[0]
    gap = gap - (found["rotation"] - found["rotation"][0])
    peak = max(float(mechanical.max()), 1e-300)
    found["mechanical"] = mechanical.assign_attrs(units="J", long_name="mechanical energy above static")
    found["residual"] = (gap / peak).assign_attrs(units="1", long_name="gap of the energy balance over the peak energy")


def _add_devices(found: xr.Dataset, scene: Scene) -> None:
    if "stroke" not in found or not found.sizes.get("device", 0):
        return
    stroke, offset = found["stroke"].values, found["rest_offset"].values
    jump = np.zeros(stroke.shape, dtype=np.int8)
    for i, y0 in enumerate(offset):
        jump[jump_samples(stroke[:, i], float(y0)), i] = 1
    found["jump"] = (("time", "device"), jump, {"units": "1", "long_name": "mid-stroke on the way to a jump"})
    places = [device.s for device in scene.devices]
    found["device_s"] = ("device", places, {"units": "m", "long_name": "arc length of a device's centre"})
    found["device_kind"] = ("device", np.array([device.kind for device in scene.devices], dtype=object))


def jump_samples(y: np.ndarray, y0: float) -> list[int]:
    """Samples right after the passages of mid-stroke that the metric `jumps` counts as cross-well jumps."""
    turns = [*(np.flatnonzero(np.diff(np.sign(y)) != 0) + 1), len(y)]
    return [int(a) for a, b in pairwise(turns) if count_jumps(y, y0, a, b)]


# --------------------------------------------------------------------------- frequencies


def at(series: xr.Dataset, s: float, name: str = "displacement") -> np.ndarray:
    """A quantity of the nodes at the arc length s, linear between nodes."""
    arc = series["baseline_arc" if name.startswith("baseline_") else "arc"].values
    i = int(np.clip(np.searchsorted(arc, s) - 1, 0, len(arc) - 2))
    share = (s - arc[i]) / (arc[i + 1] - arc[i])
    values = series[name].values.astype(float)
    return (1 - share) * values[..., i] + share * values[..., i + 1]


def _at_probe(series: xr.Dataset) -> xr.Dataset:
    """Displacement at the probe, or at mid-length without one; the place is in the attributes."""
    arc, s = series["arc"].values, float(series.attrs.get("probe", math.nan))
    s = float(0.5 * (arc[0] + arc[-1])) if math.isnan(s) else s
    names = [name for name in ("displacement", "baseline_displacement") if name in series]
    data = {name: ("time", at(series, s, name)) for name in names}
    return xr.Dataset(data, coords={"time": series["time"]}, attrs=series.attrs | {"s": s})


def _uniform(probe: xr.Dataset) -> tuple[np.ndarray, float]:
    t = probe["time"].values
    if len(t) < 16:
        raise ValueError(f"{len(t)} samples are too few for frequencies")
    return t, float(t[-1] - t[0]) / (len(t) - 1)


def spectrum(series: xr.Dataset) -> xr.Dataset:
    """Amplitude |X(f)| of the displacement at the probe: one-sided FFT of the whole run, times 2/n."""
    probe = _at_probe(series)
    t, dt = _uniform(probe)
    about = {"units": "m", "long_name": "amplitude of the displacement"}
    data = {
        str(name): ("frequency", 2 / len(t) * np.abs(np.fft.rfft(x.values - x.values.mean())), about)
        for name, x in probe.data_vars.items()
    }
    axis = ("frequency", np.fft.rfftfreq(len(t), dt), {"units": "Hz", "long_name": "frequency"})
    return xr.Dataset(data, coords={"frequency": axis}, attrs=probe.attrs)


def wavelet(series: xr.Dataset, lines: int = 120, columns: int = 600) -> xr.Dataset:
    """Modulus of the Morlet transform of the displacement at the probe, from 3/T to where its energy ends."""
    probe = _at_probe(series)
    t, dt = _uniform(probe)
    amplitudes = spectrum(series)
    energy = sum((amplitudes[name].values ** 2 for name in amplitudes.data_vars), np.zeros(1))
    share = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    lowest = 3 / float(t[-1] - t[0])
    top = 1.5 * float(amplitudes["frequency"].values[np.searchsorted(share, 0.999).clip(0, len(share) - 1)])
    f = np.geomspace(lowest, min(max(top, 10 * lowest), 0.5 / dt), lines)
    every = max(1, math.ceil(len(t) / columns))
    about = {"units": "m s^0.5", "long_name": "modulus of the Morlet transform of the displacement"}
    data: dict[str, Any] = {
        str(name): (("frequency", "time"), np.abs(morlet(x.values, dt, f))[:, ::every], about)
        for name, x in probe.data_vars.items()
    }
    axis = ("frequency", f, {"units": "Hz", "long_name": "frequency"})
    data["edge"] = ("frequency", math.sqrt(2) * CENTRE / (2 * math.pi * f), {"units": "s", "long_name": "reach"})
    times = ("time", t[::every], probe["time"].attrs)
    return xr.Dataset(data, coords={"frequency": axis, "time": times}, attrs=probe.attrs)


def morlet(x: np.ndarray, dt: float, frequency: np.ndarray) -> np.ndarray:
    """X(omega, t) = sqrt(omega/omega_c) int x(s) conj(psi((s - t) omega/omega_c)) ds, eq. (3.6) made a wavelet.

    psi(tau) = pi^-1/4 exp(i omega_c tau - tau^2/2). Zeros outside the record.

    Parameters
    ----------
    x : (nt,) samples, dt apart
    frequency : (nf,) [Hz]

    Returns
    -------
    (nf, nt) complex, unit of x times s^0.5
    """
    n = 1 << (2 * len(x) - 1).bit_length()
    spectrum_of_x = np.fft.fft(x, n)
    omega = 2 * np.pi * np.fft.fftfreq(n, dt)
    found = np.empty((len(frequency), len(x)), dtype=complex)
    for i, f in enumerate(frequency):
        scale = CENTRE / (2 * np.pi * f)
        bell = np.pi**-0.25 * math.sqrt(2 * np.pi) * np.exp(-0.5 * (scale * omega - CENTRE) ** 2)
        found[i] = np.fft.ifft(spectrum_of_x * math.sqrt(scale) * bell)[: len(x)]
    return found


# --------------------------------------------------------------------------- force laws


def force_laws(
    phi0: Sequence[float] = (0.0, 2.0, 11.48),
    *,
    k: float = PAPER_SINK["k"],
    half_span: float = PAPER_SINK["half_span"],
    reach: float | None = None,
) -> xr.Dataset:
    """Static force of a sink over its displacement x from rest, with springs and with tension-only cords.

    Eq. (2.2.2): y = x + a tan(phi0), natural length l0 = a/cos(phi0). The cords' dead band is 2 y0 wide.

    Parameters
    ----------
    phi0 : initial angles [deg]
    k : stiffness of one spring or cord [N/m]
    half_span : a [m]
    reach : how far y goes to each side [m]; by default 1.6 of the largest y0, or a/3 where all are 0
    """
    angles = np.radians(np.asarray(phi0, dtype=float))
    y0 = half_span * np.tan(angles)
    far = reach or 1.6 * float(y0.max()) or half_span / 3
    y = np.linspace(-far, far, 401)
    body = getattr(law_force, "py_func", law_force)  # as Python: a few thousand calls are not worth compiling
    force = np.array(
        [
            [[body(u, 0.0, (law, k, 0.0, half_span / math.cos(a), half_span))[0] for u in y] for a in angles]
            for law in (SPRINGS, CORDS)
        ]
    )
    return xr.Dataset(
        {
            "force": (("law", "phi0", "y"), force, {"units": "N", "long_name": "force on the mass, towards rest"}),
            "x": (("phi0", "y"), y - y0[:, None], {"units": "m", "long_name": "displacement from rest"}),
            "rest_offset": ("phi0", y0, {"units": "m", "long_name": "rest offset y0"}),
        },
        coords={
            "law": ["springs", "cords"],
            "phi0": ("phi0", np.asarray(phi0, dtype=float), {"units": "deg", "long_name": "initial angle"}),
            "y": ("y", y, {"units": "m", "long_name": "offset from mid-stroke"}),
        },
        attrs={"k": k, "half_span": half_span},
    )
