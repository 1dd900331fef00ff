"""Where a point's energy goes, between cable and devices and among modes, and where the cable tires. Reruns the point.

Symbols: y offset of a device's mass, n its slide direction, M its mass with added mass, U the energy of its cords;
u displacement from static, K and M stiffness and mass of the plain cable about its static state, eta_j = shape_j M u.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from solvers import MODELS, Response, Scene, Status, settled
from solvers.brink import tangent_at_rest
from solvers.catalogue import static_state
from solvers.devices import law_energy, law_loss
from solvers.geometry import basis_of

from .evaluate import evaluate_with_series, run_trusted
from .fatigue import MEGA, everywhere
from .metrics import LEDGER, LOSSES
from .point import Point
from .series import of_point
from .signals import Modes, modal_energies, modes, share_above
from .space import baseline_scene

FINER = 10  # outputs of a flow in one of the study's, at most: impacts last a millisecond
MOST_OUTPUTS = 60_000  # of a flow's run: some 250 MB at 100 nodes
MOST_TIMES = 2000  # of a figure
MOST_NODES = 240  # of the cable whose modes are taken
ABOVE = math.sqrt(2)  # times the excitation's highest frequency: modes further up are not forced directly
BINS = 24  # of stress ranges
CUTS = 1.0, ABOVE, 2.0, 4.0, 8.0  # of which shares are given


# --------------------------------------------------------------------------- cable and devices


def flow_of(directory: str | Path, key: str) -> xr.Dataset:
    """As :func:`flow`, of a point of a folder."""
    return of_point(Path(directory), key, f"{key}_flow", flow)


def flow(point: Point) -> xr.Dataset:
    """Energy of the cable and of each device over time, what has passed from the cable to each, and the losses.

    A device holds 1/2 M |v_host + y' n|^2 + U(y) and has lost the integral of its law's power; both together are what
    the cable has passed to it. Losses of single devices are sums over outputs (up to ``FINER`` to one of the study's)
    and stand beside the exact ledger's total: the attribute ``gap`` is their relative difference.

    Returns
    -------
    dataset with ``device_energy``, ``device_lost``, ``passed`` (time, device), ``cable_energy``, ``lost_device``,
    ``lost_water``, ``lost_cable``, ``lost_seabed``, ``work`` (time) [J]

    Raises
    ------
    ValueError
        Where no device moves, a mass is free of its slide, or the run leaves no history.
    """
    scene = point.scene
    sliding = [i for i, device in enumerate(scene.devices) if device.kind not in ("mass", "buoy", "locked")]
    if not sliding:
        raise ValueError("no device of this design moves relative to the cable")
    if any(scene.devices[i].kind == "bnes_free" for i in sliding):
        raise ValueError("the energy of a free mass (`bnes_free`) does not follow from its offset alone")
    outputs = point.ask.duration / point.ask.interval + 1
    ask = replace(point.ask, interval=point.ask.interval / max(1.0, min(FINER, MOST_OUTPUTS // outputs)))
    run = run_trusted(scene, ask).response
    if len(run.t) < 3:
        raise ValueError(f"the run of {point.key} leaves no history: {run.status.name}, {run.message}")
    stored, lost = (np.stack(x, axis=1) for x in zip(*(_device(run, scene, i) for i in sliding), strict=True))
    ledger = {name: run.signals[name] for name in LEDGER}
    mechanical = ledger["kinetic"] + ledger["strain"] + ledger["gravity"]
    cable = mechanical - (stored - stored[0]).sum(axis=1)
    every = slice(None, None, max(1, len(run.t) // MOST_TIMES))
    joule: dict[str, Any] = {"units": "J"}
    data: dict[str, Any] = {
        "device_energy": (("time", "device"), stored, joule | {"long_name": "energy stored in a device"}),
        "device_lost": (("time", "device"), lost, joule | {"long_name": "energy lost in a device"}),
        "passed": (
            ("time", "device"), stored - stored[0] + lost, joule | {"long_name": "energy passed from cable to device"}
        ),
        "cable_energy": ("time", cable, joule | {"long_name": "mechanical energy of the cable above static"}),
        **{f"lost_{name}": ("time", ledger[f"lost_{name}"], joule) for name in LOSSES},
        "work": ("time", ledger["work"], joule | {"long_name": "work put in"}),
    }  # fmt: skip
    total, summed = float(ledger["lost_device"][-1]), float(lost[-1].sum())
    about = {
        "gap": abs(summed - total) / max(total, 1e-300), "status": run.status.name,
        "pulse_end": point.settings.pulse_end, "design": point.design, "devices": len(scene.devices),
    }  # fmt: skip
    kinds = np.array([scene.devices[i].kind for i in sliding], dtype=object)
    coords = {
        "time": ("time", run.t, {"units": "s", "long_name": "time"}),
        "device": ("device", np.array(sliding) + 1), "device_kind": ("device", kinds),
    }  # fmt: skip
    return xr.Dataset(data, coords=coords, attrs=about).isel(time=every)


def _device(run: Response, scene: Scene, which: int) -> tuple[np.ndarray, np.ndarray]:
    """(nt,) energy stored in a device [J] and energy lost in it since the first output [J]."""
    device = scene.devices[which]
    t, y = run.t, run.signals["stroke"][:, which]
    speed = np.gradient(y, t)
    attached = [i for i, other in enumerate(scene.devices) if other.kind != "bnes_free"]
    pack = MODELS["lumped"].build(scene, max(20, run.segments)).pack  # for the constants of its law alone
    law = tuple(float(x) for x in pack.law[attached.index(which)])
    energy, loss = (getattr(f, "py_func", f) for f in (law_energy, law_loss))
    host, slide = _mount(run, scene, device)
    moving = host + speed[:, None] * slide
    mass = device.mass + device.added_mass
    stored = 0.5 * mass * np.einsum("ta,ta->t", moving, moving) + np.array([energy(u, law) for u in y])
    power = np.array([loss(u, w, law) for u, w in zip(y, speed, strict=True)])
    lost = np.concatenate(([0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))))
    return stored, lost


def _mount(run: Response, scene: Scene, device: Any) -> tuple[np.ndarray, np.ndarray]:
    """(nt, 3) velocity of the cable at a device, and the device's slide direction, which turns with the cable."""
    arc, x, v = (run.signals[name] for name in ("arc", "position", "velocity"))
    i = int(np.searchsorted(arc, device.s * (1 - 1e-12))) - 1
    share = (device.s - arc[i]) / (arc[i + 1] - arc[i])
    host = (1 - share) * v[:, i] + share * v[:, i + 1]
    right = int(np.searchsorted(arc, device.s * (1 + 1e-12), side="right"))
    chord = x[:, min(right, len(arc) - 1)] - x[:, i]
    chord = chord / np.linalg.norm(chord, axis=1)[:, None]
    basis = basis_of(scene)
    aim = np.array(device.direction or basis[0], dtype=float)
    if len(basis) == 2:  # across the cable in the scene's plane, on the side of `aim`, as the line turns it
        flat = chord @ basis.T
        across = np.stack([-flat[:, 1], flat[:, 0]], axis=1) @ basis
        return host, across * (1.0 if across[0] @ aim >= 0 else -1.0)
    across = aim - (chord @ aim)[:, None] * chord
    return host, across / np.linalg.norm(across, axis=1)[:, None]


# --------------------------------------------------------------------------- fatigue


def tired_of(directory: str | Path, key: str) -> xr.Dataset:
    """As :func:`tired`, of a point of a folder."""
    return of_point(Path(directory), key, f"{key}_fatigue", tired)


def tired(point: Point) -> xr.Dataset:
    """Fatigue damage along the cable, and the stress ranges behind it at the worst place; of the baseline too.

    Returns
    -------
    dataset with ``damage`` (node) over ``s``, ``cycles`` and ``done`` (bin): number of cycles of a range, and their
    damage, at the worst place; ``baseline_...`` likewise; ``range`` (bin) [MPa], the bins' middles

    Raises
    ------
    ValueError
        Where the study gives no fatigue curve, or the run leaves no history.
    """
    given = point.settings.fatigue
    if given is None:
        raise ValueError("the study gives no `metrics.fatigue`, and so there is no damage to draw")
    record, raw = evaluate_with_series(point)
    if raw.sizes.get("time", 0) < 3:
        raise ValueError(f"the run of {point.key} leaves no history: {record.status}, {record.message}")
    t = raw["time"].values
    start, stop = point.settings.window or (t[0], t[-1])
    inside = slice(int(np.searchsorted(t, start - 1e-9)), int(np.searchsorted(t, stop + 1e-9)))
    period = settled.period(point.scene)[0] if record.method == "harmonic" else math.nan
    found, cycles = xr.Dataset(), {}
    for prefix, new in (("", ""), (f"{point.settings.baseline}_", "baseline_")):
        if f"{prefix}position" not in raw:
            continue
        names = ("arc", "rigid", "tension", "position", "static_tangent", "curvature")
        signals = {name: raw[prefix + name].values for name in names}
        ends = (point.scene.end_a, point.scene.end_b)
        s, damage, cycles[new] = everywhere(t, signals, point.scene.cable, ends, given, inside, period)
        found[f"{new}s"] = (f"{new}node", s, {"units": "m", "long_name": "arc length from end A"})
        found[f"{new}damage"] = (f"{new}node", damage, {"units": "1", "long_name": "damage of the worst fibre"})
    most = max(float(each[:, 0].max(initial=0.0)) for each in cycles.values()) / MEGA
    edges = np.linspace(0, most or 1.0, BINS + 1)
    found["range"] = ("bin", (edges[1:] + edges[:-1]) / 2, {"units": "MPa", "long_name": "stress range"})
    for new, each in cycles.items():
        for name, column, text in (("cycles", 1, "cycles"), ("done", 2, "damage")):
            values = np.histogram(each[:, 0] / MEGA, edges, weights=each[:, column])[0]
            found[f"{new}{name}"] = ("bin", values, {"units": "1", "long_name": text})
    found.attrs = {
        "design": point.design, "status": record.status, "baseline": point.settings.baseline,
        "devices": len(point.scene.devices), "error": record.metrics["fatigue_error"],
        "device_s": [device.s for device in point.scene.devices],
    }  # fmt: skip
    return found


# --------------------------------------------------------------------------- modes


def modal_of(directory: str | Path, key: str) -> xr.Dataset:
    """As :func:`modal`, of a point of a folder."""
    return of_point(Path(directory), key, f"{key}_modes", modal)


def modal(point: Point) -> xr.Dataset:
    """Energy of the plain cable's modes in the motion of a point and of its baseline.

    The modes are those of the cable without devices, linearised about its static state, added mass included: one
    basis for both runs. While an end is moved, u is counted from the shape that the cable would hang in at rest with
    its end there. In a linear run of the plain cable the energies add up to the ledger's; in others they are those of
    a plain cable that moves like the run's (the attribute-free ``mechanical`` stands beside them).

    Returns
    -------
    dataset with ``modal_energy`` and ``baseline_modal_energy`` (time, mode) [J], ``mechanical`` and
    ``baseline_mechanical`` (time) [J], ``frequency`` (mode) [Hz]; ``before`` and ``after`` (above): share of the time
    integral of the modal energy that is in modes above a frequency, until the pulse's end and after it, and
    ``baseline_before``, ``baseline_after``; attribute ``cut`` [Hz], half an octave above the excitation's highest
    frequency, so that no mode above it is forced directly

    Raises
    ------
    ValueError
        Where the run leaves no history, or the plain cable has no static state or no normal modes.
    """
    record, raw = evaluate_with_series(point)
    if raw.sizes.get("time", 0) < 3:
        raise ValueError(f"the run of {point.key} leaves no history: {record.status}, {record.message}")
    line = Line(baseline_scene(point.scene, "plain"), min(raw.sizes["segment"], MOST_NODES))
    top = line.top or float(line.modes.frequency[min(2, len(line.modes.omega) - 1)])
    every = slice(None, None, max(1, raw.sizes["time"] // MOST_TIMES))
    t = raw["time"].values
    joule: dict[str, Any] = {"units": "J", "long_name": "energy of a mode"}
    hertz = {"units": "Hz", "long_name": "frequency above which energy is counted"}
    cuts = top * np.array(CUTS)
    found = xr.Dataset(
        coords={
            "time": ("time", t[every], {"units": "s", "long_name": "time"}), "above": ("above", cuts, hertz),
        },
        attrs={
            "cut": ABOVE * top, "design": point.design, "status": record.status, "baseline": point.settings.baseline,
            "pulse_end": point.settings.pulse_end, "devices": len(point.scene.devices),
        },
    )  # fmt: skip
    found["frequency"] = ("mode", line.modes.frequency, {"units": "Hz", "long_name": "frequency of the mode"})
    for prefix, new in (("", ""), (f"{point.settings.baseline}_", "baseline_")):
        if f"{prefix}position" not in raw:
            continue
        u = raw[f"{prefix}position"].values - raw[f"{prefix}static_position"].values
        energy = line.energies(raw[f"{prefix}arc"].values, u, raw[f"{prefix}velocity"].values)
        mechanical = np.sum([raw[prefix + name].values for name in ("kinetic", "strain", "gravity")], axis=0)
        found[f"{new}modal_energy"] = (("time", "mode"), energy[every].astype(np.float32), joule)
        found[f"{new}mechanical"] = ("time", mechanical[every], joule | {"long_name": "mechanical energy"})
        pulse = point.settings.pulse_end
        for name, inside in (("before", t <= pulse), ("after", t >= pulse)):
            whole = np.trapezoid(energy[inside], t[inside], axis=0)
            shares = [float(share_above(line.modes.frequency, whole[None], f)[0]) for f in cuts]
            about = {"units": "1", "long_name": f"share of the modal energy above a frequency, {name} the pulse's end"}
            found[f"{new}{name}"] = ("above", shares, about)
    return found


class Line:
    """A cable without devices, linearised about its static state; its modes, and the energies of motions in them."""

    def __init__(self, scene: Scene, segments: int) -> None:
        model = MODELS["lumped"].build(scene, segments)
        status, q, message = static_state(model)
        if status != Status.OK:
            raise ValueError(f"the plain cable has no static state: {status.name}, {message}")
        pack = model.pack
        K, M = tangent_at_rest(pack, q, 1, 0, 0), tangent_at_rest(pack, q, 0, 0, 1)
        self.fixed = np.array(pack.fixed, dtype=int)
        self.free = np.setdiff1d(np.arange(len(q)), self.fixed)
        stiff = K[np.ix_(self.free, self.free)]
        self.modes: Modes = modes(stiff, M[np.ix_(self.free, self.free)])
        self.follow = -np.linalg.solve(stiff, K[np.ix_(self.free, self.fixed)])  # static shape of a moved end
        self.arc, self.basis = model.mesh.s, model.basis
        self.index = pack.at[: model.nodes, None] + np.arange(model.dim)
        self.size = len(q)
        self.top = float(model.omega) / (2 * np.pi)  # highest frequency of the excitation [Hz], 0 for none

    def energies(self, arc: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(nt, m) [J] of displacements and velocities (nt, n, 3) at nodes at `arc`, linear between them."""
        return modal_energies(self.modes, self._moved(arc, u), self._moved(arc, v))

    def _moved(self, arc: np.ndarray, field: np.ndarray) -> np.ndarray:
        i = np.clip(np.searchsorted(arc, self.arc) - 1, 0, len(arc) - 2)
        share = ((self.arc - arc[i]) / (arc[i + 1] - arc[i]))[:, None]
        here = ((1 - share) * field[:, i] + share * field[:, i + 1]) @ self.basis.T
        q = np.zeros((len(field), self.size))
        q[:, self.index] = here
        return q[:, self.free] - q[:, self.fixed] @ self.follow.T
