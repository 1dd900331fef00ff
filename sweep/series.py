"""Histories of one point, made ready for figures: rerun with its baseline, reduced, kept in DIR/series/<key>.nc.

Symbols: x displacement normal to the static tangent, in the plane of the motion; G(t) eq. (3.3) of paper 003 with
the square; T the period of a scene's motion. Spectra and wavelet transforms (of `signals`) and the force laws of
figures 2b and 3 are here too, as datasets, because figures compute nothing. So are periodic
responses: their harmonics, a loop of tension against displacement, and how they depend on a design variable.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from solvers import SOURCE_HASH, Ask, CannotRepresent, Response, Scene, settled
from solvers.branches import ResponseCurve, response_curve
from solvers.devices import CORDS, SPRINGS, law_force
from solvers.methods.harmonic import terms

from .config import Study
from .evaluate import evaluate_with_series, run_trusted
from .metrics import LEDGER, LOSSES, along, count_jumps, end_pull, off_plane
from .pareto import best
from .plan import Plan, read_plan
from .point import Point, Record
from .signals import cone, density, morlet
from .space import design_scene
from .store import StoreError, open_study, outcome, study_of, write_whole

PAPER_SINK = {"k": 2e4, "half_span": 0.05}  # of paper 003's figures 2b and 3 [N/m], [m]
MOST_ORDERS = 15  # harmonics that a figure shows
PER_PERIOD = 400  # samples of a loop
LOOPS = 8  # last periods of a march that are kept, at most
CURVES, PANELS, MOST_POINTS = 6, 4, 400  # of a frequency response, at most
HARMONICS = 8, 16  # of such a curve: as many as its rows have, but at least and at most these
LAYOUT = 3  # of the files in DIR/series; raised when they hold something new


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

    def made(point: Point) -> xr.Dataset:
        record, raw = evaluate_with_series(point)
        if not raw.sizes.get("time", 0):
            raise ValueError(f"the run of {key} leaves no history: {record.status}, {record.message}")
        return reduce(raw, point, record)

    return of_point(Path(directory), key, key, made)


def of_point(directory: Path, key: str, name: str, make: Callable[[Point], xr.Dataset]) -> xr.Dataset:
    """What `make` makes of a point, kept under a name; with the point's key, design and environment."""

    def made() -> xr.Dataset:
        study, plan = study_of(directory), read_plan(directory / "plan.json")
        if key not in plan.keys:
            raise ValueError(f"{directory} has no point {key}")
        index = plan.keys.index(key)
        point = plan.point(study, index)
        found = make(replace(point, settings=point.settings.single))
        found.attrs |= {"key": key, "design": point.design}
        if len(plan.environments) > 1:
            found.attrs["environment"] = plan.environments[index % len(plan.environments)]
        return found

    return _kept(directory / "series" / f"{name}.nc", made)


def _kept(path: Path, make: Callable[[], xr.Dataset], **stamp: str) -> xr.Dataset:
    """The dataset in a file, or a new one where this solver and `stamp` have not made it yet."""
    stamp |= {"solver": SOURCE_HASH, "layout": str(LAYOUT)}
    if path.is_file():
        with xr.open_dataset(path, engine="netcdf4") as known:
            if all(known.attrs.get(name) == value for name, value in stamp.items()):
                return known.load()
    found = make()
    found.attrs |= stamp
    packed = {
        str(name): {"zlib": True}
        for name, array in found.data_vars.items()
        if array.ndim > 1 and array.dtype.kind in "fib"
    }
    with suppress(StoreError):  # a folder that may only be read still gives figures
        write_whole(path, lambda place: found.to_netcdf(place, engine="netcdf4", encoding=packed))
    return found


def reduce(raw: xr.Dataset, point: Point, record: Record) -> xr.Dataset:
    """What the figures read of `evaluate_with_series`' dataset, some megabytes instead of a hundred.

    Returns
    -------
    dataset with ``displacement`` (time, node) and ``baseline_displacement`` (time, baseline_node) along one
    sideways direction, ``arc`` and ``depth`` of the nodes, ``stroke`` and ``jump`` (1 where the passage of
    mid-stroke ends in the other well) of the devices, the energy ledger with its ``residual``, ``G``, ``share``
    (of the integral of x^2 that is over), ``tension`` at end B, and the record's metrics as attributes
    ``metric_<name>``; ``period`` is NaN where the motion has none; ``last_...`` and ``baseline_last_...`` as
    :func:`at_last` makes them
    """
    settings, t = point.settings, raw["time"].values
    sideways = directions(raw)
    kept = {name: raw[name] for name in (*LEDGER, "arc", "stroke", "rest_offset", "G") if name in raw}
    found = xr.Dataset(kept, coords={"time": raw["time"]})
    about = {"units": "m", "long_name": "displacement normal to the static tangent"}
    found["displacement"] = (("time", "node"), _project(raw["transverse"].values, sideways), about)
    found["depth"] = ("node", -raw["static_position"].values[:, 2], {"units": "m", "long_name": "static depth"})
    pull = end_pull({str(name): array.values for name, array in raw.data_vars.items()}, point.scene.end_b, 1)
    found["tension"] = ("time", pull, {"units": "N", "long_name": "tension at end B"})
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
    for prefix in ("", f"{name}_"):
        if f"{prefix}position" in raw:
            found.update(at_last(raw, prefix, "" if not prefix else "baseline_"))
    found.attrs = {
        "values": ", ".join(f"{name} = {value:.4g}" for name, value in point.values.items()),
        "model": record.model,
        "status": record.status,
        "baseline": name,
        "probe": math.nan if settings.probe is None else settings.probe,
        "pulse_end": settings.pulse_end,
        "design": point.design,
        "devices": len(point.scene.devices),
        "method": record.method,
        "harmonics": record.harmonics,
        "period": settled.period(point.scene)[0],
        "ramped": settled.ramped(point.scene),
        **{f"metric_{metric}": value for metric, value in record.metrics.items()},
    }
    if settings.window is not None:
        found.attrs["window"] = list(settings.window)
    assert len(t) == found.sizes["time"]
    return found


def at_last(raw: xr.Dataset, prefix: str, new: str) -> dict[str, Any]:
    """The line at the last output time: shape, tension and, of rods and catenaries, shear, bending moment and domain.

    ``away`` and ``height`` are counted from end A, ``away`` level towards end B. Of a line in a vertical plane shear
    and moment have signs: the moment is positive where the line is hollow upwards, the shear where the part beyond s
    pulls upwards across the line on the part before it. Of a line in space they are sizes.
    """
    def last(name: str) -> np.ndarray:
        return np.asarray(raw[prefix + name].values[-1], dtype=float)

    x = last("position")
    x = x - x[0]
    span = x[-1, :2]
    wide = float(np.linalg.norm(span))
    level = np.array([*(span / wide if wide > 1e-6 * np.abs(x).max() else (1.0, 0.0)), 0.0])
    node, segment = (f"{new}last_{name}" for name in ("node", "segment"))
    arc = raw[f"{prefix}arc"].values
    found: dict[str, Any] = {
        "s": (node, arc, {"units": "m", "long_name": "arc length s from end A"}),
        "middle": (segment, (arc[1:] + arc[:-1]) / 2, {"units": "m", "long_name": "arc length s from end A"}),
        "away": (node, x @ level, {"units": "m", "long_name": "level distance from end A"}),
        "height": (node, x[:, 2], {"units": "m", "long_name": "height above end A"}),
        "tension": (segment, last("tension"), {"units": "N", "long_name": "tension"}),
    }
    if f"{prefix}domain" in raw:
        shear, moment = last("shear"), last("moment")
        size = np.sqrt(np.maximum((moment**2).sum(axis=1) - last("torque") ** 2, 0.0))
        if off_plane(x[None]) <= 1e-6 * np.abs(x).max():
            aside = np.cross(level, [0.0, 0.0, 1.0])
            chord = np.gradient(x, arc, axis=0)
            shear = shear * np.sign((last("force") * np.cross(aside, chord)).sum(axis=1))
            size = size * np.sign(moment @ aside)
        found["shear"] = (node, shear, {"units": "N", "long_name": "shear"})
        found["moment"] = (node, size, {"units": "N m", "long_name": "bending moment"})
        found["domain"] = (segment, last("domain"), {"units": "1", "long_name": "1 where it is a rod"})
    return {f"{new}last_{name}": array for name, array in found.items()}


def profile_of(directory: str | Path, key: str, over: Sequence[str] = ()) -> xr.Dataset:
    """A point's line at its last output time, and those of its baseline and of other points to lay over it.

    Returns
    -------
    dataset with ``last_s``, ``last_tension``, ... of the point as :func:`at_last` makes them, ``baseline_last_...``
    where the baseline is another run, and ``over1_last_...`` and so on; ``over1_label`` and so on in the attributes
    """
    series = series_of(directory, key)
    found = series[[name for name in series.data_vars if "last_" in str(name)]].drop_vars("time", errors="ignore")
    same = all(np.array_equal(found[f"baseline_last_{x}"], found[f"last_{x}"]) for x in ("away", "height", "tension")
               if f"baseline_last_{x}" in found)  # fmt: skip
    if same:
        found = found.drop_vars([name for name in found.data_vars if str(name).startswith("baseline_")])
    for i, other in enumerate(over, 1):
        theirs = series_of(directory, other)
        names = {str(name): f"over{i}_{name}" for name in theirs.data_vars if str(name).startswith("last_")}
        dims = {name: f"over{i}_{name}" for name in ("last_node", "last_segment")}
        found = found.merge(theirs[list(names)].drop_vars("time", errors="ignore").rename(names | dims))
        found.attrs[f"over{i}_label"] = point_label(theirs)
    return found


def point_label(series: xr.Dataset) -> str:
    """A point in words: its values, environment and model."""
    attrs = series.attrs
    parts = [str(attrs.get(name, "")) for name in ("values", "environment", "model")]
    return ", ".join(part for part in parts if part) or f"point {attrs.get('key', '')}"


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
    return _amplitudes(_at_probe(series), "displacement")


def _amplitudes(signals: xr.Dataset, what: str) -> xr.Dataset:
    t, dt = _uniform(signals)
    about = {"units": "m", "long_name": f"amplitude of the {what}"}
    data = {
        str(name): ("frequency", 2 / len(t) * np.abs(np.fft.rfft(x.values - x.values.mean())), about)
        for name, x in signals.data_vars.items()
    }
    axis = ("frequency", np.fft.rfftfreq(len(t), dt), {"units": "Hz", "long_name": "frequency"})
    return xr.Dataset(data, coords={"frequency": axis}, attrs=signals.attrs)


def wavelet(series: xr.Dataset, lines: int = 120, columns: int = 600) -> xr.Dataset:
    """Modulus of the Morlet transform of the displacement at the probe, from 3/T to where its energy ends."""
    return _transformed(_at_probe(series), "displacement", lines, columns)


def stroke_wavelets(series: xr.Dataset, lines: int = 120, columns: int = 600) -> xr.Dataset:
    """As :func:`wavelet`, of the offset of each device that moves, about its mean (paper 003, figure 11)."""
    strokes = series["stroke"].values if "stroke" in series else np.zeros((2, 0))
    moving = [i for i in range(strokes.shape[1]) if np.ptp(strokes[:, i]) > 0]
    if not moving:
        raise ValueError("no device of this design moves relative to the cable")
    data = {f"stroke_{i + 1}": ("time", strokes[:, i] - strokes[:, i].mean()) for i in moving}
    made = xr.Dataset(data, coords={"time": series["time"]}, attrs=series.attrs)
    kinds = series["device_kind"].values if "device_kind" in series else [""] * strokes.shape[1]
    found = _transformed(made, "offset", lines, columns)
    for i in moving:
        found[f"stroke_{i + 1}"].attrs["which"] = f"device {i + 1} ({kinds[i]})"
    return found


def _transformed(signals: xr.Dataset, what: str, lines: int, columns: int) -> xr.Dataset:
    t, dt = _uniform(signals)
    amplitudes = _amplitudes(signals, what)
    energy = sum((amplitudes[name].values ** 2 for name in amplitudes.data_vars), np.zeros(1))
    share = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    lowest = 3 / float(t[-1] - t[0])
    top = 1.5 * float(amplitudes["frequency"].values[np.searchsorted(share, 0.999).clip(0, len(share) - 1)])
    f = np.geomspace(lowest, min(max(top, 10 * lowest), 0.5 / dt), lines)
    every = max(1, math.ceil(len(t) / columns))
    about = {"units": "m s^0.5", "long_name": f"modulus of the Morlet transform of the {what}"}
    data: dict[str, Any] = {
        str(name): (("frequency", "time"), np.abs(morlet(x.values, dt, f))[:, ::every], dict(about))
        for name, x in signals.data_vars.items()
    }
    axis = ("frequency", f, {"units": "Hz", "long_name": "frequency"})
    data["edge"] = ("frequency", cone(f), {"units": "s", "long_name": "reach of the record's ends"})
    times = ("time", t[::every], signals["time"].attrs)
    return xr.Dataset(data, coords={"frequency": axis, "time": times}, attrs=signals.attrs)


def power(series: xr.Dataset) -> xr.Dataset:
    """Power spectral density (Welch) of the displacement at the probe, after the pulse where half a second is left."""
    probe = _at_probe(series)
    t, dt = _uniform(probe)
    start = float(series.attrs.get("pulse_end", 0.0))
    start = start if t[-1] - start >= max(0.5, 64 * dt) else float(t[0])
    after = t >= start - 1e-9
    about = {"units": "m2/Hz", "long_name": "power spectral density of the displacement"}
    data, f = {}, np.zeros(0)
    for name, x in probe.data_vars.items():
        f, p = density(x.values[after], dt)
        data[str(name)] = ("frequency", p, about)
    axis = ("frequency", f, {"units": "Hz", "long_name": "frequency"})
    return xr.Dataset(data, coords={"frequency": axis}, attrs=probe.attrs | {"start": start})


def compared(directory: str | Path, key: str, over: Sequence[str] = ()) -> xr.Dataset:
    """Displacement at the probe of a point, of its baseline and of other points (paper 003, figure 12).

    Returns
    -------
    dataset with ``displacement``, ``baseline_displacement`` (time), and ``over1_displacement`` (over1_time) and so on,
    each named by its ``which``
    """
    series = series_of(directory, key)
    found = _at_probe(series)
    found["displacement"].attrs |= {"units": "m", "which": point_label(series)}
    for i, other in enumerate(over, 1):
        theirs = series_of(directory, other)
        probe = _at_probe(theirs)["displacement"].rename(time=f"over{i}_time")
        found[f"over{i}_displacement"] = probe.assign_attrs(units="m", which=point_label(theirs))
    return found


# --------------------------------------------------------------------------- periodic responses


def orders(series: xr.Dataset) -> xr.Dataset:
    """Amplitudes of the harmonics of the tension at end B and of the displacement at the probe.

    The Fourier series of the motion's period T is fitted to the samples of the last whole periods by least squares:
    exact for a response that repeats itself, whether or not the output times divide T. ``rest`` is the root mean
    square of what it leaves, over that of the oscillation: a response that is not periodic, or not settled, has one.

    Raises
    ------
    ValueError
        Where the motion has no period, or no whole one of the settled response was kept.
    """
    probe, T = _at_probe(series), float(series.attrs.get("period", math.nan))
    if math.isnan(T):
        raise ValueError("the motion of this point has no period, and its response no harmonics")
    t = probe["time"].values
    whole = math.floor((t[-1] - max(t[0], float(series.attrs.get("ramped", 0.0)))) / T * (1 + 1e-9))
    last = t > t[-1] - whole * T * (1 - 1e-9)
    phase = 2 * np.pi * t[last] / T
    most = min(int(series.attrs.get("harmonics") or MOST_ORDERS), (np.count_nonzero(last) // max(whole, 1) - 1) // 2)
    if whole < 1 or most < 1:
        raise ValueError(f"the outputs hold no whole period of {T:.4g} s after the ramps with three samples or more")
    made = terms(most, phase)[0]
    shown = min(most, MOST_ORDERS)
    data: dict[str, Any] = {}
    fields = {str(name): array.values for name, array in probe.data_vars.items()}
    if "tension" in series:
        fields = {"tension": series["tension"].values} | fields
    for name, samples in fields.items():
        values = samples[last].astype(float)
        found = np.linalg.lstsq(made, values, rcond=None)[0]
        about = {
            "units": "N" if name == "tension" else "m",
            "long_name": "amplitude of the " + ("tension at end B" if name == "tension" else "transverse displacement"),
            "mean": float(found[0]) / math.sqrt(2),
            "rest": float(np.std(values - made @ found) / max(np.std(values), 1e-300)),
        }
        data[name] = ("order", np.hypot(found[1 : 2 * shown : 2], found[2 : 2 * shown + 1 : 2]), about)
    axis = ("order", np.arange(1, shown + 1), {"units": "1", "long_name": "multiple of the base frequency"})
    return xr.Dataset(data, coords={"order": axis}, attrs=probe.attrs | {"periods": whole})


def spectrum_or_orders(series: xr.Dataset) -> xr.Dataset:
    """Harmonics where harmonic balance made the response; a spectrum of the whole run for any other."""
    return orders(series) if series.attrs.get("method") == "harmonic" else spectrum(series)


def loop_of(directory: str | Path, key: str) -> xr.Dataset:
    """End tension and end displacement of a point over one period, by harmonic balance and by the time domain.

    Returns
    -------
    dataset with ``tension`` and ``displacement`` (phase) of harmonic balance, ``march_tension`` and
    ``march_displacement`` (march_period, phase) of the last periods of an explicit march, the last one last; what a
    run does not give is left out, and the attributes ``harmonic`` and ``march`` say how each ended

    Raises
    ------
    ValueError
        Where the motion has no period, or neither run gives one.
    """
    return of_point(Path(directory), key, f"{key}_loop", loop)


def loop(point: Point) -> xr.Dataset:
    """As :func:`loop_of`, of a point."""
    scene, ask = point.scene, point.ask
    T, reason = settled.period(scene)
    if reason:
        raise ValueError(f"no loop to draw: {reason}")
    if T > ask.duration * (1 + 1e-9):
        raise ValueError(f"no loop to draw: the run's {ask.duration:g} s hold no period of {T:.4g} s")
    kept = max(1, min(LOOPS, int((ask.duration - max(settled.ramped(scene), 0.0)) / T + 1e-9)))
    # a duration of whole periods must not fall short of its last output by rounding
    grid = replace(ask, duration=ask.duration * (1 + 1e-12), interval=T / PER_PERIOD, perturbation=0.0)
    found = xr.Dataset(attrs={"period": T, "devices": len(scene.devices)})
    end = 0 if scene.end_b.motion is None else 1
    for prefix, method, periods in (("", "harmonic", 1), ("march_", "explicit", kept)):
        # outputs end with the run; the first of them is a multiple of the interval
        start = max(0.0, ask.duration - (periods + 1.5 / PER_PERIOD) * T)
        asked = replace(grid, method=method, output_from=start, step=None)
        name = prefix.rstrip("_") or "harmonic"
        try:
            run = run_trusted(scene, asked).response
        except CannotRepresent as error:
            found.attrs[name] = " ".join(str(error).split())
            continue
        found.attrs[name] = f"{run.status.name}{': ' + run.message if run.message else ''}"
        found.attrs[f"{name}_status"] = run.status.name
        if len(run.t) <= periods * PER_PERIOD or run.t[-1] < ask.duration - 1.5 * grid.interval:
            continue  # it ended early
        pull, way = _at_end(run, scene, end)
        dims = ("phase",) if method == "harmonic" else ("march_period", "phase")
        for quantity, values, unit, meaning in (
            ("tension", pull, "N", f"tension at end {'AB'[end]}"),
            ("displacement", way, "m", f"displacement of end {'AB'[end]}"),
        ):
            last = values[-periods * PER_PERIOD - 1 :]
            rows = np.stack([last[i * PER_PERIOD : (i + 1) * PER_PERIOD + 1] for i in range(periods)])
            about = {"units": unit, "long_name": meaning}
            found[prefix + quantity] = (dims, rows[0] if method == "harmonic" else rows, about)
    if not found.data_vars:
        raise ValueError(f"no loop to draw: harmonic balance gave {found.attrs['harmonic']}; "
                         f"the time domain gave {found.attrs['march']}")  # fmt: skip
    if "tension" in found and "march_tension" in found:  # both end at the same time
        gap = float(np.abs(found["tension"] - found["march_tension"][-1]).max())
        found.attrs["gap"] = gap / max(float(np.ptp(found["march_tension"].values)), 1e-300)
    found.attrs["status"] = found.attrs.get("harmonic_status", "OK")
    return found


def _at_end(run: Response, scene: Scene, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Tension [N] at an end and its displacement along the direction in which it moves most [m]."""
    which = (scene.end_a, scene.end_b)[end]
    node = (0, -1)[end]
    origin = run.signals["static_position"][node] if which.position is None else np.array(which.position)
    way = run.signals["position"][:, node] - origin
    axis = np.linalg.svd(way, full_matrices=False)[2][0]
    axis = axis * (np.sign(axis[np.abs(axis).argmax()]) or 1.0)
    return end_pull(run.signals, which, end), way @ axis


# --------------------------------------------------------------------------- responses over a design variable


def responses(directory: str | Path) -> xr.Dataset:
    """Periodic responses along the study's first variable, by arclength, and the study's own rows.

    A curve for each of up to six values of the other variables, in each of up to four environments. ``half_range`` is
    that of the largest device stroke where there are devices that move, else of the tension at end B.

    Returns
    -------
    dataset with ``parameter``, ``half_range``, ``stable``, ``trusted``, ``fold`` (panel, curve, along), NaN or False
    past a curve's end; ``row_parameter``, ``row_half_range``, ``row_trusted`` (panel, curve, row) of the results;
    ``others`` (curve) the values of the other variables, ``note`` (panel, curve) where a curve was not followed
    through, ``environment`` (panel)

    Raises
    ------
    ValueError
        Where the study has no variable, or harmonic balance cannot serve its scene.
    """
    directory = Path(directory)
    study, plan = study_of(directory), read_plan(directory / "plan.json")
    results = open_study(directory)
    rows = hashlib.sha256(" ".join(map(str, results["status"].values.ravel())).encode()).hexdigest()
    return _kept(directory / "series" / "response.nc", lambda: _responses(study, plan, results), rows=rows)


def _responses(study: Study, plan: Plan, results: xr.Dataset) -> xr.Dataset:
    if not study.variables:
        raise ValueError("the study has no variable to follow a response along")
    first, *others = study.variables
    tests = [value for _, value in study.variables[first].tests]
    low, high = min(tests), max(tests)
    if not low < high:
        raise ValueError(f"`{first}` has one value, and a response is followed along a range")
    combinations = sorted({tuple(design[name] for name in others) for design in plan.designs})
    picks = np.unique(np.linspace(0, len(combinations) - 1, min(CURVES, len(combinations))).round().astype(int))
    chosen = [combinations[i] for i in picks]
    panels = min(len(plan.environments), PANELS)
    moving = any(device.kind not in ("mass", "buoy", "locked") for device in study.scene.devices)
    curves: dict[tuple[int, int], tuple[ResponseCurve | None, str]] = {}
    for panel in range(panels):
        for k, values in enumerate(chosen):
            fixed = dict(zip(others, values, strict=True))
            on = [i for i, design in enumerate(plan.designs) if all(design[n] == v for n, v in fixed.items())]
            used = results["harmonics"].values.reshape(len(plan.designs), -1)[on, panel]
            harmonics = study.ask.harmonics or int(np.clip(used.max(initial=0), *HARMONICS))
            curves[panel, k] = _followed(study, first, (low, high), fixed, panel, harmonics)
    longest = max((len(c.parameter) for c, _ in curves.values() if c is not None), default=0)
    if not longest:
        raise ValueError(f"no response could be followed: {next(iter(curves.values()))[1]}")
    shape = (panels, len(chosen), longest)
    parameter, half = np.full(shape, np.nan), np.full(shape, np.nan)
    flags = {name: np.zeros(shape, dtype=np.int8) for name in ("stable", "trusted", "fold")}
    for at, (curve, _) in curves.items():
        if curve is None:
            continue
        n = len(curve.parameter)
        parameter[at][:n] = curve.parameter
        half[at][:n] = curve.stroke.max(axis=1) if moving else np.ptp(curve.tension, axis=1) / 2
        for name, values in flags.items():
            values[at][:n] = getattr(curve, name)
    rows = _rows(plan, results, first, others, chosen, panels, moving)
    unit = results[first].attrs.get("units", "1") if first in results else "1"
    meaning = "stroke, half range" if moving else "tension at end B, half range"
    about = {"units": "m" if moving else "N", "long_name": meaning}
    dims, row_dims = ("panel", "curve", "along"), ("panel", "curve", "row")
    names = [", ".join(f"{n} = {v:.4g}{_unit_of(results, n)}" for n, v in zip(others, c, strict=True)) for c in chosen]
    return xr.Dataset(
        {
            "parameter": (dims, parameter, {"units": unit, "long_name": first}),
            "half_range": (dims, half, about),
            **{name: (dims, values) for name, values in flags.items()},
            "row_parameter": (row_dims, rows[0], {"units": unit, "long_name": first}),
            "row_half_range": (row_dims, rows[1], about),
            "row_trusted": (row_dims, rows[2].astype(np.int8)),
            "row_failed": (row_dims, rows[3].astype(np.int8)),
            "others": ("curve", np.array(names, dtype=object)),
            "note": (dims[:2], np.array([[curves[p, k][1] for k in range(shape[1])] for p in range(panels)], object)),
            "environment": ("panel", np.array(plan.environments[:panels], dtype=object)),
        },
        attrs={"study": study.name, "curves_of": len(combinations), "panels_of": len(plan.environments)},
    )


def _unit_of(results: xr.Dataset, name: str) -> str:
    unit = results[name].attrs.get("units", "1") if name in results else "1"
    return "" if unit in ("1", "") else f" {unit}"


def _followed(
    study: Study,
    first: str,
    limits: tuple[float, float],
    fixed: Mapping[str, float],
    environment: int,
    harmonics: int,
) -> tuple[ResponseCurve | None, str]:
    """The response along a variable, from its least value or, where none is found there, from its greatest."""
    ask = Ask(
        duration=1.0, model=study.ask.model, segments=study.ask.segments, accuracy=study.ask.accuracy,
        tolerance=study.ask.tolerance if study.ask.method == "harmonic" else None, harmonics=harmonics,
    )  # fmt: skip

    def scene_at(value: float) -> Scene:
        return design_scene(study, {**fixed, first: value}, environment)

    for start, stop in (limits, limits[::-1]):
        try:
            curve = response_curve(scene_at, start, stop, ask, most_points=MOST_POINTS)
        except CannotRepresent as error:
            return None, " ".join(str(error).split())
        if len(curve.parameter):
            break
    return (curve if len(curve.parameter) else None), curve.message


def _rows(
    plan: Plan, results: xr.Dataset, first: str, others: Sequence[str], chosen: Sequence[tuple[float, ...]],
    panels: int, moving: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """The rows on each curve: values of the first variable, half ranges, trusted, failed; (panel, curve, row)."""
    on = [[i for i, d in enumerate(plan.designs) if tuple(d[n] for n in others) == values] for values in chosen]
    shape = (panels, len(chosen), max(len(found) for found in on))
    x, y = np.full(shape, np.nan), np.full(shape, np.nan)
    trusted, failed = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    size = len(plan.designs)

    def column(name: str) -> np.ndarray:
        return results[name].values.reshape(size, -1)

    half = column("stroke") / 2 if moving else (column("peak_tension_top") - column("least_tension_top")) / 2
    status = column("status")
    for panel in range(panels):
        for k, found in enumerate(on):
            for r, i in enumerate(found):
                x[panel, k, r], y[panel, k, r] = plan.designs[i][first], half[i, panel]
                trusted[panel, k, r] = outcome(str(status[i, panel])) == "trusted"
                failed[panel, k, r] = outcome(str(status[i, panel])) == "failed"
    return x, y, trusted, failed


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
