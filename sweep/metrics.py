"""Every metric of a study, once: its unit, direction, definition, equation of paper 003, and function.

A response is first reduced to a :class:`Summary`, a few curves over the output grid; metrics are read from
the summaries of the design and of its baseline. x is the displacement from the static position, projected on
the plane normal to the static tangent. Integrals along the cable run over interior nodes with the mass (or
length) of the plain cable: half of each neighbouring segment, and on rigid rods the exact integral of the
linear field, so that they do not depend on the mesh. Integrals in time are trapezoids on the output grid
within the window.

A metric that cannot be defined is NaN; only ``t_first`` may be infinite. A static run (duration 0) has one output
time, which is its window: what needs a span of time is NaN, and peaks are the static values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from solvers import Response, Scene, Status, settled
from solvers.scene import End, Section

from .config import METRICS, Metric, MetricSettings
from .fatigue import Limits, Wear, wear

NAN = float("nan")
LOSSES = ("device", "water", "cable", "seabed")
LEDGER = ("kinetic", "strain", "gravity", "work", *(f"lost_{name}" for name in LOSSES), "rotation")
FINISHED = frozenset(
    {
        Status.OK, Status.UNRESOLVED, Status.COARSE_STEP, Status.ENERGY_OPEN, Status.FEW_HARMONICS, Status.UNSTABLE,
        Status.ROD_NEEDED,
    }
)  # fmt: skip


NOTHING = np.zeros(0)


@dataclass(frozen=True, kw_only=True)
class Profile:
    """The line at one time; arrays are empty where the line has no such quantity."""

    arc: np.ndarray = field(default_factory=lambda: NOTHING)  # (n,) arc length of the nodes [m]
    position: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3) [m]
    tension: np.ndarray = field(default_factory=lambda: NOTHING)  # (n - 1,) axial force in mid-segment [N]
    moment: np.ndarray = field(default_factory=lambda: NOTHING)  # (n,) size of the bending moment [N m]


class Peaks(NamedTuple):
    """Largest values in the window; NaN where the line has no such quantity."""

    moment: float = NAN  # bending moment of any node [N m]
    end_a: float = NAN  # moment at end A [N m]
    end_b: float = NAN
    torque: float = NAN  # of any node, its size [N m]
    twist: float = NAN  # of any node, its size [rad/m]
    out_of_plane: float = NAN  # [m]
    turning: float = NAN  # [rad]
    rod: float = NAN  # mean share of rod [1]


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The curves of one run that the metrics need, within the window."""

    t: np.ndarray  # (nt,) output times in the window [s]
    pulse_end: float  # [s]
    length: float  # of the cable [m]
    v2: np.ndarray  # (nt,) integral of m |x'|^2 along the cable [J]
    x2: np.ndarray  # (nt,) integral of |x|^2 along the cable [m3]
    probe2: np.ndarray  # (nt,) |x|^2 at the probe [m2]; NaN without one
    strain: np.ndarray  # (nt,) strain energy above static [J]
    mechanical: np.ndarray  # (nt,) kinetic, strain and potential energy above static [J]
    top: np.ndarray  # (nt,) magnitude of the force on end B [N]
    bottom: np.ndarray  # (nt,) magnitude of the force on end A [N]
    curvature: float  # largest in the window [1/m]
    lost: tuple[float, float, float, float]  # to devices, water, cable, seabed at the window's end [J]
    strokes: np.ndarray  # (nd,) travel of each device [m]
    jumps: np.ndarray  # (nd,) cross-well jumps of each device
    end: Profile = field(default_factory=lambda: Profile())  # at the window's end
    peaks: Peaks = field(default_factory=lambda: Peaks())
    tension: float = NAN  # largest in the window [N]
    limits: Limits = field(default_factory=Limits)
    wear: Wear = field(default_factory=lambda: Wear())

    def integral(self, curve: np.ndarray, after: float = -math.inf) -> float:
        """Trapezoid of a curve over the window, or over its part after a time."""
        inside = self.t >= after - 1e-9
        if np.count_nonzero(inside) < 2:
            return NAN
        return float(np.trapezoid(curve[inside], self.t[inside]))

    def running(self, curve: np.ndarray) -> np.ndarray:
        """Trapezoid of a curve from the window's start to each output time."""
        steps = 0.5 * (curve[1:] + curve[:-1]) * np.diff(self.t)
        return np.concatenate(([0.0], np.cumsum(steps)))

    def rms(self, curve2: np.ndarray) -> float:
        """Root of the mean of a squared curve from the pulse's end on."""
        after = max(self.pulse_end, float(self.t[0]) if self.t.size else 0.0)
        span = float(self.t[-1]) - after if self.t.size else 0.0
        return math.sqrt(self.integral(curve2, after) / span) if span > 0 else NAN


# --------------------------------------------------------------------------- from a response to its curves


def summarise(
    response: Response, scene: Scene, settings: MetricSettings, sections: Sequence[Section] | None = None
) -> Summary | None:
    """The curves behind the metrics; None where the run did not reach the end of the window.

    Parameters
    ----------
    scene : the scene that was run; its devices' rest offsets define the jumps
    sections : the plain cable, where that of the run carries spread masses (baseline ``uniform``)
    """
    t, signals = response.t, response.signals
    start, stop = settings.window or (0.0, float(t[-1]) if len(t) else 0.0)
    slack = 1e-9 + (0.5 * float(t[1] - t[0]) if len(t) > 1 else 0.0)  # the grid ends within half an interval
    if response.status not in FINISHED or not len(t) or t[-1] < stop - slack:
        return None
    inside = slice(int(np.searchsorted(t, start - 1e-9)), int(np.searchsorted(t, stop + 1e-9)))
    x, v = transverse(response, "position", inside), transverse(response, "velocity", inside)
    arc, rigid = signals["arc"], signals["rigid"] > 0.5
    mass = signals["span_mass"] if sections is None else span_mass(arc, sections)
    probe2 = np.full(len(x), NAN)
    if settings.probe is not None:
        probe2 = _square(_between(x, arc, settings.probe))
    stroke = _columns(signals.get("stroke"), len(t))
    device, water, cable, seabed = (float(signals[f"lost_{name}"][inside.stop - 1]) for name in LOSSES)
    return Summary(
        t=t[inside],
        pulse_end=settings.pulse_end,
        length=float(arc[-1] - arc[0]),
        v2=along(v, mass, rigid),
        x2=along(x, np.diff(arc), rigid),
        probe2=probe2,
        strain=signals["strain"][inside],
        mechanical=(signals["kinetic"] + signals["strain"] + signals["gravity"])[inside],
        top=end_pull(signals, scene.end_b, 1)[inside],
        bottom=end_pull(signals, scene.end_a, 0)[inside],
        curvature=float(np.abs(signals["curvature"][inside]).max(initial=0.0)),
        lost=(device, water, cable, seabed),
        strokes=np.ptp(stroke[inside], axis=0) if len(x) else np.zeros(stroke.shape[1]),
        jumps=np.array(
            [
                count_jumps(
                    stroke[:, i], getattr(scene.devices[i], "rest_offset", 0.0), inside.start, inside.stop
                )
                for i in range(min(stroke.shape[1], len(scene.devices)))
            ],
            dtype=float,
        ),
        end=profile(response, inside.stop - 1),
        peaks=_peaks(response, inside),
        tension=float(signals["tension"][inside].max(initial=-math.inf)),
        limits=settings.limits or Limits(),
        wear=_wear(response, scene, settings, inside),
    )


def _wear(response: Response, scene: Scene, settings: MetricSettings, inside: slice) -> Wear:
    if settings.fatigue is None:
        return Wear()
    period = settled.period(scene)[0] if response.method == "harmonic" else NAN
    ends = (scene.end_a, scene.end_b)
    return wear(response.t, response.signals, inside, scene.cable, ends, settings.fatigue, period)


def profile(response: Response, at: int = -1) -> Profile:
    """The line at an output time, by its index."""
    signals = response.signals
    nothing = np.zeros((len(response.t), 0))
    return Profile(
        arc=signals["arc"],
        position=signals["position"][at],
        tension=signals.get("tension", nothing)[at],
        moment=bending(signals, slice(at, at + 1 or None))[0] if "moment" in signals else NOTHING,
    )


def bending(signals: Mapping[str, np.ndarray], inside: slice) -> np.ndarray:
    """(nt, n) size of the moment across the cable [N m]."""
    return np.sqrt(np.maximum(_square(signals["moment"][inside]) - signals["torque"][inside] ** 2, 0.0))


def _peaks(response: Response, inside: slice) -> Peaks:
    signals = response.signals
    x = signals["position"][inside]
    if not len(x):
        return Peaks()
    found = Peaks(out_of_plane=off_plane(x), turning=float(angles_turned(x).max(initial=0.0)))
    if "moment" in signals:
        ends = np.sqrt(_square(signals["moment"][inside][:, [0, -1]])).max(axis=0)
        found = found._replace(moment=float(bending(signals, inside).max()), end_a=float(ends[0]), end_b=float(ends[1]))
    for name in ("torque", "twist"):
        if name in signals:
            found = found._replace(**{name: float(np.abs(signals[name][inside]).max())})
    if "domain" in signals:
        lengths = np.diff(signals["arc"])
        found = found._replace(rod=float((signals["domain"][inside] @ lengths).mean() / lengths.sum()))
    return found


def off_plane(x: np.ndarray) -> float:
    """Largest distance of a node from the vertical plane through the ends [m]; NaN where they are one above the other.

    Parameters
    ----------
    x : (nt, n, 3) positions
    """
    span = x[:, -1, :2] - x[:, 0, :2]
    wide = np.linalg.norm(span, axis=1)
    if not len(x) or wide.min() == 0.0:  # as most vertical cables have it at rest
        return NAN
    if wide.min() <= 1e-6 * float(np.abs(x - x[:, :1]).max(initial=0.0)):
        return NAN
    normal = np.stack([-span[:, 1], span[:, 0]], axis=1) / wide[:, None]
    return float(np.abs(np.einsum("tna,ta->tn", x[:, :, :2] - x[:, :1, :2], normal)).max())


def angles_turned(x: np.ndarray) -> np.ndarray:
    """(nt,) sum of the angles between neighbouring segments [rad]: 2 pi and more where there is a loop."""
    chord = np.diff(x, axis=1)
    chord /= np.maximum(np.sqrt(_square(chord)), 1e-300)[..., None]
    return 2 * np.arcsin(np.minimum(np.sqrt(_square(np.diff(chord, axis=1))) / 2, 1.0)).sum(axis=1)


def gauss_writhe(x: np.ndarray) -> float:
    """Writhe of a polyline (n, 3): Gauss's integral over all pairs of segments, exactly (Klenin and Langowski, 2000).

    How many times the line crosses itself, with sign, on the average over all directions of view: a hockle adds
    about 1 or -1, a line in a plane has 0.
    """
    a, b = x[:-1], x[1:]
    if len(x) < 4 or np.linalg.svd(x - x.mean(axis=0), compute_uv=False)[2] <= 1e-9 * np.ptp(x, axis=0).max():
        return 0.0
    total = 0.0
    for i in range(len(a) - 2):
        r13, r14, r23, r24 = a[i + 2 :] - a[i], b[i + 2 :] - a[i], a[i + 2 :] - b[i], b[i + 2 :] - b[i]
        normals = [np.cross(p, q) for p, q in ((r13, r14), (r14, r24), (r24, r23), (r23, r13))]
        n1, n2, n3, n4 = (n / np.maximum(np.sqrt(_square(n)), 1e-300)[:, None] for n in normals)
        angles = [np.arcsin(np.clip((p * q).sum(axis=1), -1, 1)) for p, q in ((n1, n2), (n2, n3), (n3, n4), (n4, n1))]
        side = np.sign((np.cross(b[i + 2 :] - a[i + 2 :], b[i] - a[i]) * r13).sum(axis=1))
        total += float((np.sum(angles, axis=0) * side).sum())
    return total / (2 * math.pi)


def depth(x: np.ndarray, arc: np.ndarray) -> float:
    """How far a line (n, 3) hangs below its end A, 0 where it nowhere does [m]: a parabola through the lowest nodes."""
    fall = x[0, 2] - x[:, 2]
    i = int(fall.argmax())
    if not 0 < i < len(fall) - 1:
        return float(fall[i])
    back, on = (fall[i] - fall[i - 1]) / (arc[i] - arc[i - 1]), (fall[i + 1] - fall[i]) / (arc[i + 1] - arc[i])
    bend = (back - on) / (arc[i + 1] - arc[i - 1])  # half the curvature of the parabola
    slope = back - bend * (arc[i] - arc[i - 1])  # at node i
    return float(fall[i] + (slope**2 / (4 * bend) if bend > 0 else 0.0))


def end_tension(force: np.ndarray, end: End, outward: float) -> np.ndarray:
    """(nt,) tension at an end [N]: along the clamp's direction, else the size of the force, which has no shear."""
    if end.kind != "clamped" or end.direction is None:
        return np.sqrt(_square(force))
    direction = np.array(end.direction)
    return outward * force @ (direction / np.linalg.norm(direction))


def end_pull(signals: Mapping[str, np.ndarray], end: End, at: int) -> np.ndarray:
    """(nt,) tension at end A (`at` 0) or B (1) [N]: a rod's own, whose ends have shear, else :func:`end_tension`."""
    if "shear" not in signals:
        return end_tension(signals["end_force"][:, at], end, (-1.0, 1.0)[at])
    force, x = signals["force"][:, -at], signals["position"]
    chord = (x[:, -1] - x[:, -2]) if at else (x[:, 1] - x[:, 0])
    size = np.sqrt(np.maximum(_square(force) - signals["shear"][:, -at] ** 2, 0.0))
    return np.sign(np.einsum("ta,ta->t", force, chord)) * size


def transverse(response: Response, name: str = "position", inside: slice = slice(None)) -> np.ndarray:
    """Displacement (or velocity) of the nodes, projected normal to the static tangent.

    Returns
    -------
    (nt, n_node, 3) float [m] or [m/s]
    """
    tangent = response.signals["static_tangent"]
    field = response.signals[name][inside]
    field = field - response.signals["static_position"] if name == "position" else field.copy()
    shift = field[:, :, 0] * tangent[:, 0]
    for axis in range(1, field.shape[2]):
        shift += field[:, :, axis] * tangent[:, axis]
    for axis in range(field.shape[2]):  # one plane at a time: no temporary of the full size
        field[:, :, axis] -= shift * tangent[:, axis]
    return field


def along(field: np.ndarray, weight: np.ndarray, rigid: np.ndarray) -> np.ndarray:
    """Integral of |field|^2 along the cable over interior nodes, at each time.

    Half of each segment's weight at each of its ends; on a rigid segment, where the field is linear, exactly
    weight (a.a + a.b + b.b)/3.

    Parameters
    ----------
    field : (nt, n_node, 3)
    weight : (n_segment,) mass [kg] or length [m] of each segment
    rigid : (n_segment,) bool
    """
    nodal = np.zeros(len(weight) + 1)
    share = np.where(rigid, 1 / 3, 1 / 2) * weight
    nodal[:-1] += share
    nodal[1:] += share
    nodal[0] = nodal[-1] = 0.0
    total = _square(field) @ nodal
    for i in np.flatnonzero(rigid):
        total += weight[i] / 3 * np.einsum("ta,ta->t", field[:, i], field[:, i + 1])
    return total


def span_mass(arc: np.ndarray, sections: Sequence[Section]) -> np.ndarray:
    """Mass of the plain cable between nodes at the arc lengths ``arc`` [kg]."""
    lengths = np.cumsum([0.0, *(section.length for section in sections)])
    masses = np.cumsum([0.0, *(section.length * section.mass for section in sections)])
    return np.diff(np.interp(arc, lengths, masses))


def count_jumps(y: np.ndarray, y0: float, start: int = 0, stop: int | None = None) -> int:
    """Cross-well jumps: passages from beyond +y0 to beyond -y0 or back.

    A stiff cord throws the mass back within less than an output interval, so that no sample need lie beyond
    y0. At each turning point the flights before and after are therefore extended to where they meet. The well
    at t = 0 is that of the mass's side; jumps count when they end among the samples start to stop.

    Parameters
    ----------
    y : (nt,) offset of the mass from its host [m]
    y0 : rest offset [m]; 0 for a device without two wells
    """
    if not y0 > 0 or len(y) < 2:
        return 0
    reach = np.abs(y)
    rise = reach[1:-1] - reach[:-2]
    fall = reach[1:-1] - reach[2:]
    turn = (rise >= 0) & (fall >= 0)
    reach[1:-1] += np.where(turn, 0.5 * np.abs(rise - fall), 0.0)
    well = np.where(reach >= y0 * (1 - 1e-9), np.sign(y), 0.0)
    well[0] = np.sign(y[0])
    at = np.flatnonzero(well)
    ends = at[1:][np.diff(well[at]) != 0]
    return int(np.count_nonzero((ends >= start) & (ends < (len(y) if stop is None else stop))))


def _square(field: np.ndarray) -> np.ndarray:
    """Squared size of vectors, one component at a time: quicker than sums over a last axis of three."""
    total = field[..., 0] * field[..., 0]
    for axis in range(1, field.shape[-1]):
        total += field[..., axis] * field[..., axis]
    return total


def _columns(stroke: np.ndarray | None, nt: int) -> np.ndarray:
    return np.zeros((nt, 0)) if stroke is None else stroke.reshape(nt, -1)


def _between(field: np.ndarray, arc: np.ndarray, s: float) -> np.ndarray:
    """The field at arc length s, linear between nodes."""
    i = int(np.clip(np.searchsorted(arc, s) - 1, 0, len(arc) - 2))
    share = (s - arc[i]) / (arc[i + 1] - arc[i])
    return (1 - share) * field[:, i] + share * field[:, i + 1]


# --------------------------------------------------------------------------- the table


Function = Callable[[Summary, Summary], Any]


def metric(
    unit: str,
    direction: str | None,
    definition: str,
    equation: str = "",
    per_device: bool = False,
    needs: str = "",
) -> Callable[[Function], Function]:
    """Enter the decorated function into METRICS under its own name."""

    def enter(function: Function) -> Function:
        name = function.__name__
        METRICS[name] = Metric(name, unit, direction, definition, equation, function, per_device, needs)
        return function

    return enter


def _ratio(a: float, b: float) -> float:
    return a / b if b > 0 else NAN


@metric("1", "min", "integral of m |x'|^2 over that of the baseline", "(3.1), velocity squared")
def delta(run: Summary, base: Summary) -> float:
    return _ratio(run.integral(run.v2), base.integral(base.v2))


@metric("1", "max", "1 minus integral of |x|^2 over that of the baseline", "(3.2), a displacement index")
def gamma(run: Summary, base: Summary) -> float:
    return 1 - _ratio(run.integral(run.x2), base.integral(base.x2))


@metric("1", "min", "time integral of the strain energy above static over that of the baseline")
def strain_ratio(run: Summary, base: Summary) -> float:
    return _ratio(run.integral(run.strain), base.integral(base.strain))


def settling_index(run: Summary, base: Summary) -> np.ndarray:
    """G(t) of eq. (3.3) with the square: 1 - ratio of running integrals; 0 while the baseline is at rest."""
    if len(run.t) != len(base.t):
        return np.full(len(run.t), NAN)
    ours, theirs = run.running(run.x2), base.running(base.x2)
    moving = theirs > 1e-12 * theirs[-1]
    return np.where(moving, 1 - ours / np.where(moving, theirs, 1.0), 0.0)


@metric("s", "min", "first time with G >= 0.9, inf if there is none", "(3.3) literally, with the square")
def t_first(run: Summary, base: Summary) -> float:
    index = settling_index(run, base)
    if len(index) < 2 or not np.all(np.isfinite(index)) or not base.integral(base.x2) > 0:
        return NAN
    reached = np.flatnonzero(index >= 0.9)
    if not reached.size:
        return math.inf
    i = int(reached[0])
    return _crossing(run.t, index, i, 0.9)


@metric(
    "s",
    "min",
    "first time after which at most 10 % of the integral of |x|^2 remains",
    "(3.3), default definition",
)
def t_settle(run: Summary, base: Summary) -> float:
    total = run.running(run.x2)
    if len(total) < 2 or not total[-1] > 0:
        return NAN
    i = int(np.argmax(total >= 0.9 * total[-1]))
    return _crossing(run.t, total, i, 0.9 * total[-1])


@metric(
    "s",
    "min",
    "time after which the mechanical energy stays at most 10 % of its peak, NaN if it does not",
    "(3.3)",
)
def t_energy(run: Summary, base: Summary) -> float:
    energy = run.mechanical
    peak = float(energy.max(initial=0.0))
    if not peak > 0 or energy[-1] > 0.1 * peak:
        return NAN
    last = int(np.flatnonzero(energy > 0.1 * peak)[-1])
    return _crossing(run.t, energy, last + 1, 0.1 * peak)


def _crossing(t: np.ndarray, curve: np.ndarray, i: int, level: float) -> float:
    """Time between samples i - 1 and i at which a curve passes a level."""
    if i == 0 or curve[i] == curve[i - 1]:
        return float(t[i])
    share = (level - curve[i - 1]) / (curve[i] - curve[i - 1])
    return float(t[i - 1] + min(max(share, 0.0), 1.0) * (t[i] - t[i - 1]))


@metric("m", "min", "RMS of |x| over the cable's length and over time from the pulse's end on")
def rms(run: Summary, base: Summary) -> float:
    return run.rms(run.x2) / math.sqrt(run.length)


@metric("1", "max", "1 minus rms over that of the baseline", "section 4")
def rms_reduction(run: Summary, base: Summary) -> float:
    return 1 - _ratio(run.rms(run.x2), base.rms(base.x2))


@metric("m", "min", "RMS of |x| at the probe from the pulse's end on; NaN without a probe", needs="probe")
def rms_probe(run: Summary, base: Summary) -> float:
    return run.rms(run.probe2)


@metric("1", "max", "1 minus rms_probe over that of the baseline", "section 4", needs="probe")
def rms_probe_reduction(run: Summary, base: Summary) -> float:
    return 1 - _ratio(run.rms(run.probe2), base.rms(base.probe2))


@metric("N", "min", "largest tension at end B in the window, on the output grid")
def peak_tension_top(run: Summary, base: Summary) -> float:
    return float(run.top.max()) if run.top.size else NAN


@metric("N", "min", "largest tension at end A in the window, on the output grid")
def peak_tension_bottom(run: Summary, base: Summary) -> float:
    return float(run.bottom.max()) if run.bottom.size else NAN


@metric("N", "max", "smallest tension at end B in the window, on the output grid")
def least_tension_top(run: Summary, base: Summary) -> float:
    return float(run.top.min()) if run.top.size else NAN


@metric("N", "max", "smallest tension at end A in the window, on the output grid")
def least_tension_bottom(run: Summary, base: Summary) -> float:
    return float(run.bottom.min()) if run.bottom.size else NAN


def _fluctuation(run: Summary, curve: np.ndarray) -> float:
    span = float(run.t[-1] - run.t[0]) if run.t.size else 0.0
    if not span > 0:
        return NAN
    mean = run.integral(curve) / span
    return math.sqrt(run.integral((curve - mean) ** 2) / span)


@metric("N", "min", "RMS of the tension at end B about its mean over the window")
def rms_tension_top(run: Summary, base: Summary) -> float:
    return _fluctuation(run, run.top)


@metric("N", "min", "RMS of the tension at end A about its mean over the window")
def rms_tension_bottom(run: Summary, base: Summary) -> float:
    return _fluctuation(run, run.bottom)


@metric("1/m", "min", "largest curvature of any node in the window")
def peak_curvature(run: Summary, base: Summary) -> float:
    return run.curvature


@metric(
    "m",
    "min",
    "travel of a device's mass, largest less smallest offset; the largest of all devices",
    "",
    True,
)
def stroke(run: Summary, base: Summary) -> np.ndarray:
    return run.strokes


@metric(
    "1", None, "cross-well jumps, from beyond +y0 to beyond -y0 or back; the sum over all devices", "", True
)
def jumps(run: Summary, base: Summary) -> np.ndarray:
    return run.jumps


@metric("J", None, "energy lost in the devices by the window's end")
def energy_device(run: Summary, base: Summary) -> float:
    return run.lost[0]


@metric("J", None, "energy lost to the water by the window's end")
def energy_water(run: Summary, base: Summary) -> float:
    return run.lost[1]


@metric("J", None, "energy lost in the cable by the window's end")
def energy_cable(run: Summary, base: Summary) -> float:
    return run.lost[2]


@metric("1", "max", "share of the devices in all energy lost by the window's end")
def energy_share_device(run: Summary, base: Summary) -> float:
    return _ratio(run.lost[0], sum(run.lost))


@metric("m", "min", "largest depth below end A, which is the lower or anchored one, at the window's end")
def sag(run: Summary, base: Summary) -> float:
    return depth(run.end.position, run.end.arc) if run.end.arc.size else NAN


@metric("m", "min", "largest distance of a node from the vertical plane through the ends in the window")
def out_of_plane(run: Summary, base: Summary) -> float:
    return run.peaks.out_of_plane


@metric("N m", "min", "largest bending moment of any node in the window; NaN without moments, as for lumped masses")
def peak_moment(run: Summary, base: Summary) -> float:
    return run.peaks.moment


@metric("N m", "min", "largest moment at end B in the window, torque included; NaN without moments")
def end_moment_top(run: Summary, base: Summary) -> float:
    return run.peaks.end_b


@metric("N m", "min", "largest moment at end A in the window, torque included; NaN without moments")
def end_moment_bottom(run: Summary, base: Summary) -> float:
    return run.peaks.end_a


@metric("N m", "min", "largest torque of any node in the window; NaN without torsion")
def peak_torque(run: Summary, base: Summary) -> float:
    return run.peaks.torque


@metric("rad/m", "min", "largest twist rate of any node in the window; NaN without torsion")
def peak_twist(run: Summary, base: Summary) -> float:
    return run.peaks.twist


@metric("rad", "min", "largest sum of the angles between segments in the window: a loop adds 2 pi")
def turning(run: Summary, base: Summary) -> float:
    return run.peaks.turning


@metric("1", None, "writhe at the window's end: crossings with sign, averaged over all views; a hockle adds 1 or -1")
def writhe(run: Summary, base: Summary) -> float:
    return gauss_writhe(run.end.position) if run.end.arc.size else NAN


@metric("1", "min", "share of rod in the cable's length, mean over the window; NaN for lines without domains")
def rod_share(run: Summary, base: Summary) -> float:
    return run.peaks.rod


@metric("m", "min", "largest distance between run and baseline at equal arc length, at the window's end")
def shape_error(run: Summary, base: Summary) -> float:
    if not (run.end.arc.size and base.end.arc.size):
        return NAN
    theirs = np.stack([np.interp(run.end.arc, base.end.arc, base.end.position[:, k]) for k in range(3)], axis=1)
    return float(np.sqrt(_square(run.end.position - theirs)).max())


@metric("1", "min", "largest difference of tension from the baseline's at equal arc length, at the window's end, over "
        "the baseline's largest")  # fmt: skip
def tension_error(run: Summary, base: Summary) -> float:
    a, b = run.end, base.end
    if not (a.tension.size and b.tension.size):
        return NAN
    return _gap((a.arc[1:] + a.arc[:-1]) / 2, a.tension, (b.arc[1:] + b.arc[:-1]) / 2, b.tension)


@metric("1", "min", "largest difference of bending moment from the baseline's, likewise; NaN without moments")
def moment_error(run: Summary, base: Summary) -> float:
    a, b = run.end, base.end
    return _gap(a.arc, a.moment, b.arc, b.moment) if a.moment.size and b.moment.size else NAN


def _gap(s: np.ndarray, ours: np.ndarray, at: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference of two curves over s, over the second one's largest size."""
    return _ratio(float(np.abs(ours - np.interp(s, at, theirs)).max()), float(np.abs(theirs).max()))


@metric("1/s", "min", "growth rate of the difference to twins that start a billionth apart, until it is as large as a "
        "tenth of the motion or the run ends: above 0 it is chaotic; known with `uncertainty` alone")  # fmt: skip
def chaos(run: Summary, base: Summary) -> float:
    return NAN


@metric("1", None, "share of the twins whose difference grew to a tenth of the motion; known with `uncertainty` alone")
def chaos_saturated(run: Summary, base: Summary) -> float:
    return NAN


# --------------------------------------------------------------------------- strength and fatigue


@metric("1", "min", "largest tension of any segment in the window over the breaking load; NaN without "
        "`metrics.limits.breaking_load`", needs="limits.breaking_load")  # fmt: skip
def use_breaking_load(run: Summary, base: Summary) -> float:
    return run.tension / (run.limits.breaking_load or NAN)


@metric("1", "min", "largest curvature in the window times the minimum bend radius; NaN without "
        "`metrics.limits.bend_radius`", needs="limits.bend_radius")  # fmt: skip
def use_bend_radius(run: Summary, base: Summary) -> float:
    return run.curvature * (run.limits.bend_radius or NAN)


def _tires(unit: str, direction: str | None, definition: str) -> Callable[[Function], Function]:
    return metric(unit, direction, f"{definition}; NaN without `metrics.fatigue`", needs="fatigue")


@_tires("1", "min", "rainflow damage in the window (a settled response: its whole periods) at the worst fibre of the "
        "worst node; half cycles count half")  # fmt: skip
def fatigue_damage(run: Summary, base: Summary) -> float:
    return run.wear.damage


@_tires("1", "min", "fatigue_damage over that of the baseline, at the worst place of each")
def fatigue_ratio(run: Summary, base: Summary) -> float:
    return _ratio(run.wear.damage, base.wear.damage)


@_tires("year", "max", "life at that damage, the window's motion all year round or `events_per_year` times; NaN "
        "without damage")  # fmt: skip
def fatigue_life(run: Summary, base: Summary) -> float:
    return _ratio(1.0, run.wear.per_year)


@_tires("1", "min", "design life times design factor over fatigue_life: above 1 the cable fails too early")
def fatigue_use(run: Summary, base: Summary) -> float:
    return run.wear.use


@_tires("Pa", "min", "damage-equivalent stress range: at 1 Hz over the window it does the same damage")
def fatigue_range(run: Summary, base: Summary) -> float:
    return run.wear.span


@_tires("1", None, "rainflow cycles in the window at the worst place")
def fatigue_cycles(run: Summary, base: Summary) -> float:
    return run.wear.cycles


@_tires("m", None, "arc length of the worst place")
def fatigue_s(run: Summary, base: Summary) -> float:
    return run.wear.s


@_tires("1", "min", "relative change of fatigue_damage where every other output is left out: small where the outputs "
        "resolve the peaks")  # fmt: skip
def fatigue_error(run: Summary, base: Summary) -> float:
    return run.wear.gap


# --------------------------------------------------------------------------- all of them


def metric_names(devices: int) -> list[str]:
    """Names of all metrics of a scene with this many devices, per-device ones after their total."""
    names = []
    for name, entry in METRICS.items():
        names.append(name)
        names.extend(f"{name}_{i + 1}" for i in range(devices if entry.per_device else 0))
    return names


def compute(run: Summary | None, base: Summary | None, devices: int) -> dict[str, float]:
    """All metrics of a run against its baseline; NaN where either is missing and needed.

    Parameters
    ----------
    run, base : summaries, or None for a run that did not finish
    devices : number of devices in the scene
    """
    found = dict.fromkeys(metric_names(devices), NAN)
    if run is None:
        return found
    nothing = _blank(run) if base is None else base
    with np.errstate(all="ignore"):
        for name, entry in METRICS.items():
            value = entry.function(run, nothing)
            if not entry.per_device:
                found[name] = _plain(name, value)
                continue
            total = np.max(value, initial=-math.inf) if name == "stroke" else np.sum(value)
            found[name] = _plain(name, total)
            found.update({f"{name}_{i + 1}": _plain(name, v) for i, v in enumerate(value)})
    return found


def _plain(name: str, value: float) -> float:
    value = float(value)
    return value if math.isfinite(value) or (name == "t_first" and value > 0) else NAN


def _blank(run: Summary) -> Summary:
    """A baseline that is not there: every curve NaN."""
    gap = np.full(len(run.t), NAN)
    return Summary(
        t=run.t,
        pulse_end=run.pulse_end,
        length=run.length,
        v2=gap,
        x2=gap,
        probe2=gap,
        strain=gap,
        mechanical=gap,
        top=gap,
        bottom=gap,
        curvature=NAN,
        lost=(NAN,) * 4,
        strokes=run.strokes,
        jumps=run.jumps,
    )
