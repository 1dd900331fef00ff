"""Fatigue of the cable's critical layer: rainflow damage at the worst place of the worst fibre, over whole fields.

Axial stress of a fibre at the distance r from the neutral axis and the angle a about the cable:

    sigma(s, a, t) = SCF E (T/EA + r (k1 cos a + k2 sin a))

T tension, k1 and k2 the curvature about two material axes: the cable turns about its own axis as little as its tangent
lets it. Cycles of sigma are counted by rainflow (ASTM E1049-85, 5.4.4; the package `rainflow`), half cycles as 0.5, and
summed by Palmgren and Miner. Curves: an S-N curve of one or two slopes in the ranges, or strain-life (Basquin, Coffin
and Manson; Morrow's mean stress is left out).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from solvers.scene import End, NonNegative, Number, Positive, Section, record

NAN = float("nan")
YEAR = 365.25 * 86400.0  # [s]
MEGA = 1e6  # S-N curves are in MPa
MOST_DECADES = 100.0  # of an S-N curve's constant; those of codes have 8 to 40
ANGLES = 12  # fibres about a cable that bends in two planes
FLAT = 1e-6  # bending about the second axis, relative, below which a cable bends in one plane


@record
class Limits:
    """What the cable bears once."""

    breaking_load: Positive | None = None  # MBL [N]
    bend_radius: Positive | None = None  # MBR [m]


@record
class Fatigue:
    """A layer of the cable and its fatigue curve.

    ``sn``: N = 10**log_a (range / 1 MPa)**-m, beyond `knee` cycles with the slope `m2` of at least `m`.
    ``strain_life``: amplitude of strain = strength/E (2N)**strength_exponent + ductility (2N)**ductility_exponent.
    """

    curve: Literal["sn", "strain_life"] = "sn"
    E: Positive  # Young's modulus of the layer [Pa]
    m: Positive | None = None
    log_a: Number | None = None
    m2: Positive | None = None
    knee: Positive | None = None  # [cycles]
    strength: Positive | None = None  # fatigue strength coefficient [Pa]
    strength_exponent: Number | None = None  # below 0
    ductility: Positive | None = None  # fatigue ductility coefficient
    ductility_exponent: Number | None = None  # below 0
    fibre: NonNegative | None = None  # distance of the layer from the neutral axis [m], default d/2
    tension_factor: NonNegative | None = None  # stress of the layer per tension [Pa/N], default E/EA
    concentration: Positive = 1.0  # SCF, on the whole stress
    ultimate: Positive | None = None  # tensile strength [Pa]: Goodman's correction of tensile means; S-N only
    events_per_year: Positive | None = None  # of the window's motion; by default it goes on all year
    design_life: Positive = 25.0  # [years]
    design_factor: Positive = 1.0  # DFF

    @model_validator(mode="after")
    def _whole(self) -> Fatigue:
        wrong = []
        sn, life = ("m", "log_a"), ("strength", "strength_exponent", "ductility", "ductility_exponent")
        needed, alien = (sn, life) if self.curve == "sn" else (life, (*sn, "m2", "knee", "ultimate"))
        missing = [name for name in needed if getattr(self, name) is None]
        if missing:
            wrong.append(f"`curve: {self.curve}` needs {', '.join(f'`{name}`' for name in missing)}")
        given = [name for name in alien if getattr(self, name) is not None]
        if given:
            wrong.append(f"`curve: {self.curve}` has no {', '.join(f'`{name}`' for name in given)}")
        if (self.m2 is None) != (self.knee is None):
            wrong.append("`m2` and `knee` belong together")
        if self.m is not None and self.m2 is not None and self.m2 < self.m:
            problem = f"`m2: {self.m2:g}` must be at least `m`, {self.m:g}"
            wrong.append(f"{problem}: beyond the knee small ranges do less, not more (m: 3 goes with m2: 5)")
        if self.log_a is not None and abs(self.log_a) > MOST_DECADES:
            most = f"{-MOST_DECADES:g} to {MOST_DECADES:g}"
            wrong.append(f"`log_a: {self.log_a:g}` must be {most}: it is for ranges in MPa, not Pa")
        elif self.m is not None and self.log_a is not None and self.knee is not None:
            decades = (self.log_a - math.log10(self.knee)) / self.m
            if abs(decades) > MOST_DECADES / 2:
                wrong.append(f"`log_a` and `m` put the `knee` at 1e{decades:+.0f} MPa, beyond any stress")
        if any((getattr(self, name) or -1.0) >= 0 for name in ("strength_exponent", "ductility_exponent")):
            wrong.append("`strength_exponent` and `ductility_exponent` must be below 0")
        if wrong:
            raise ValueError("; ".join(wrong))
        return self

    def cycles(self, span: np.ndarray) -> np.ndarray:
        """Cycles to failure at stress ranges [Pa]; infinite at 0."""
        span = np.asarray(span, dtype=float)
        with np.errstate(divide="ignore", over="ignore"):
            if self.curve == "sn":
                m, a, m2, knee = self._numbers("m", "log_a", "m2", "knee")
                first = 10.0**a * (span / MEGA) ** -m
                if math.isnan(knee):
                    return first
                bend = MEGA * (10.0**a / knee) ** (1 / m)
                return np.where(span >= bend, first, knee * (span / bend) ** -m2)
            low, high = np.full(span.shape, -4.0), np.full(span.shape, 40.0)  # decades of N
            for _ in range(60):  # strain falls with N: bisection, to 4e-17 of the bracket
                middle = 0.5 * (low + high)
                above = self._strain(10.0**middle) > 0.5 * span / self.E
                low, high = np.where(above, middle, low), np.where(above, high, middle)
            return np.where(span > 0, 10.0 ** (0.5 * (low + high)), np.inf)

    def _numbers(self, *names: str) -> list[float]:
        return [NAN if getattr(self, name) is None else float(getattr(self, name)) for name in names]

    def _strain(self, N: np.ndarray) -> np.ndarray:
        strength, b, ductility, c = self._numbers(
            "strength", "strength_exponent", "ductility", "ductility_exponent"
        )
        return strength / self.E * (2 * N) ** b + ductility * (2 * N) ** c

    def damage(self, span: np.ndarray, mean: np.ndarray) -> np.ndarray:
        """Share of life that one cycle takes, 1/N; Goodman's range/(1 - mean/ultimate) where the mean is tensile."""
        span, mean = np.asarray(span, dtype=float), np.asarray(mean, dtype=float)
        if self.ultimate is not None:
            left = 1 - np.maximum(mean, 0.0) / self.ultimate
            span = np.where(left > 0, span / np.maximum(left, 1e-300), np.where(span > 0, np.inf, 0.0))
        with np.errstate(divide="ignore"):
            return 1 / self.cycles(span)

    def equivalent(self, cycles: float) -> float:
        """The stress range that fails after so many cycles [Pa]: the inverse of :meth:`cycles`."""
        if not 0 < cycles < math.inf:
            return 0.0 if cycles == math.inf else NAN
        if self.curve == "strain_life":
            return float(2 * self.E * self._strain(np.array(cycles)))
        m, a, m2, knee = self._numbers("m", "log_a", "m2", "knee")
        if cycles > knee:
            return float(MEGA * (10.0**a / knee) ** (1 / m) * (cycles / knee) ** (-1 / m2))
        with np.errstate(over="ignore"):  # of a slope near 0: infinite
            return float(MEGA * np.power(10.0**a / cycles, 1 / m))


class Wear(NamedTuple):
    """Damage at the worst place; NaN where the study gives no curve."""

    damage: float = NAN  # in `seconds`
    seconds: float = NAN  # time in which it is done [s]: the window, or the whole periods of a settled response
    cycles: float = NAN  # counted, halves as 0.5
    span: float = NAN  # 1 Hz damage-equivalent stress range [Pa]
    s: float = NAN  # arc length of the worst place [m]
    gap: float = NAN  # relative change of the damage where every other output is left out
    per_year: float = NAN  # damage a year
    use: float = NAN  # of the design life, design factor included


# --------------------------------------------------------------------------- stress


def bending(signals: Mapping[str, np.ndarray], inside: slice, ends: Sequence[End]) -> np.ndarray:
    """Curvature of the nodes about two material axes [1/m]: its size is the line's own, its direction the polyline's.

    The axes are normal to the static tangent and go with it to the tangent of the moment by the least rotation, which
    is exact for a line that stays in a plane. At a clamp the direction is that between clamp and first segment.

    Returns
    -------
    (nt, n, 2), rotated so that the first axis has most of a node's bending
    """
    x, rest = signals["position"][inside], signals["static_tangent"]
    chord = _unit(np.diff(x, axis=1))
    outer = [np.broadcast_to(_unit(np.array(e.direction or (0.0, 0.0, 0.0))), chord[:, 0].shape) for e in ends]
    before = np.concatenate([outer[0][:, None], chord], axis=1)
    after = np.concatenate([chord, outer[1][:, None]], axis=1)
    turn = _unit(np.cross(before, after)) * np.abs(signals["curvature"][inside])[..., None]
    now = _unit(before + after)
    both = rest + now
    back = np.einsum("tna,na->tn", turn, rest) / np.maximum(1 + np.einsum("tna,na->tn", now, rest), 1e-12)
    turn = turn - back[..., None] * both  # the least rotation from now to rest, of a vector normal to now
    helper = np.eye(3)[np.abs(rest).argmin(axis=1)]
    first = _unit(np.cross(rest, helper))
    axes = np.stack([first, np.cross(rest, first)], axis=1)  # (n, 2, 3)
    parts = np.einsum("tna,nka->tnk", turn, axes)
    main = np.linalg.eigh(np.einsum("tni,tnj->nij", parts, parts))[1][:, :, ::-1]
    return np.einsum("tni,nij->tnj", parts, main)


def _unit(x: np.ndarray) -> np.ndarray:
    """Vectors at length 1; 0 where they have none: a wave's front bends by 1e-200, whose square is 0."""
    size = np.sqrt(np.einsum("...a,...a->...", x, x))[..., None]
    return np.divide(x, size, out=np.zeros_like(x), where=size > 1e-14)


def fibres(
    signals: Mapping[str, np.ndarray], inside: slice, cable: Sequence[Section], ends: Sequence[End], given: Fatigue
) -> Iterator[tuple[float, Callable[[], np.ndarray]]]:
    """Arc length of a node and what makes the (nt,) stress [Pa] of a fibre there, for all nodes and fibres of cable.

    The tension of a node is the mean of its two segments', that of the cable's side beside a rigid rod.
    """
    arc, soft = signals["arc"], ~(signals["rigid"] > 0.5)
    tension, bend = signals["tension"][inside], bending(signals, inside, ends)
    edges = np.cumsum([section.length for section in cable])
    kind = np.searchsorted(edges[:-1], (arc[1:] + arc[:-1]) / 2 - arc[0], side="right")

    def stress(i: int, sides: Sequence[int], angle: float) -> np.ndarray:
        pull = np.zeros(len(tension))
        for e in sides:
            factor = given.tension_factor
            pull += tension[:, e] * (given.E / cable[kind[e]].EA if factor is None else factor) / len(sides)
        r = max(cable[kind[e]].d for e in sides) / 2 if given.fibre is None else given.fibre
        curve = bend[:, i, 0] * math.cos(angle) + bend[:, i, 1] * math.sin(angle)
        return given.concentration * (pull + given.E * r * curve)

    for i in range(len(arc)):
        sides = [e for e in (i - 1, i) if 0 <= e < len(soft) and soft[e]]  # none within a rod
        first, second = np.abs(bend[:, i]).max(axis=0, initial=0.0)
        step = math.pi if second <= FLAT * first else 2 * math.pi / ANGLES
        for angle in np.arange(0, 2 * math.pi - 1e-9, step) if sides else ():
            yield float(arc[i]), partial(stress, i, sides, angle)


# --------------------------------------------------------------------------- counting


def turning_points(x: np.ndarray) -> np.ndarray:
    """The first and last samples and all where a curve turns; plateaus count once."""
    x = x[np.concatenate(([True], np.diff(x) != 0))]
    if len(x) < 3:
        return x
    step = np.diff(x)
    return x[np.concatenate(([True], step[1:] * step[:-1] < 0, [True]))]


def count(x: np.ndarray) -> np.ndarray:
    """(n, 3) range, mean and number (1 or 0.5) of the rainflow cycles of a curve, ASTM E1049-85, 5.4.4."""
    import rainflow  # not for studies without fatigue

    points = turning_points(np.asarray(x, dtype=float)).tolist()
    found = [cycle[:3] for cycle in rainflow.extract_cycles(points)] if len(points) > 2 else []
    if len(points) == 2:  # the package wants three
        found = [(abs(points[1] - points[0]), (points[0] + points[1]) / 2, 0.5)]
    return np.array(found, dtype=float).reshape(-1, 3)


def closed(x: np.ndarray) -> np.ndarray:
    """Samples of whole periods, without the one that repeats the first, from their maximum round to it again."""
    top = int(np.argmax(x))
    return np.concatenate((x[top:], x[: top + 1]))


def most_damage(x: np.ndarray, given: Fatigue) -> float:
    """What no cycle count of a history exceeds: the highest peak with the lowest valley, the next with the next, ...

    A count gives every turn at most one cycle, so that it is a mean of pairings; of those the sorted one has the
    greatest sum of a convex function of the ranges, which 1/N is on a single slope of 1 or more and in strain-life
    (an S-N curve with a knee lies below its first slope). Means count as the greatest stress.
    """
    points = turning_points(x)
    if len(points) < 2:
        return 0.0
    up = int(points[0] < points[1])
    peaks, valleys = np.sort(points[up::2])[::-1], np.sort(points[1 - up :: 2])
    n = max(len(peaks), len(valleys))
    spans = np.full(n, np.ptp(points))
    if given.curve == "strain_life" or (given.m or 0.0) >= 1:
        peaks, valleys = (np.append(x, np.repeat(x[:1], n - len(x))) for x in (peaks, valleys))
        spans = np.maximum(np.sort(peaks)[::-1] - np.sort(valleys), 0.0)
    return float(replace(given, m2=None, knee=None).damage(spans, peaks[0]).sum())


def damage_of(x: np.ndarray, given: Fatigue, settled: bool) -> tuple[float, float]:
    """Damage of a stress history, and the number of its cycles."""
    cycles = count(closed(x) if settled else x)
    return float((cycles[:, 2] * given.damage(cycles[:, 0], cycles[:, 1])).sum()), float(cycles[:, 2].sum())


def counted(t: np.ndarray, inside: slice, period: float) -> tuple[slice, float, bool]:
    """The samples to count, their time [s], and whether they are whole periods of a settled response."""
    times = t[inside]
    step, seconds = float(times[-1] - times[0]) / (len(times) - 1), float(times[-1] - times[0])
    if math.isnan(period) or seconds < period * (1 - 1e-9):
        return inside, seconds, False
    seconds = period * math.floor(seconds / period * (1 + 1e-9))
    stop = inside.indices(len(t))[1]
    return slice(stop - max(3, round(seconds / step)), stop), seconds, True


def wear(
    t: np.ndarray,
    signals: Mapping[str, np.ndarray],
    inside: slice,
    cable: Sequence[Section],
    ends: Sequence[End],
    given: Fatigue,
    period: float = math.nan,
) -> Wear:
    """Damage at the worst node and fibre.

    Parameters
    ----------
    t : (nt,) output times [s]
    inside : the window, as indices of t
    period : of a settled response [s]: the last whole periods of the window are counted as a loop, so that no half
        cycles are left; NaN for a transient, whose window is counted as it is
    """
    if len(t[inside]) < 3:
        return Wear()
    inside, seconds, settled = counted(t, inside, period)
    bounds = [(most_damage(stress(), given), s, stress) for s, stress in fibres(signals, inside, cable, ends, given)]
    worst, where, number, history = -1.0, NAN, 0.0, np.zeros(0)
    for bound, s, stress in sorted(bounds, key=lambda entry: -entry[0]):
        if bound <= worst:  # neither this history nor any after it can do more
            break
        x = stress()
        damage, cycles = damage_of(x, given, settled)
        if damage > worst:
            worst, where, number, history = damage, s, cycles, x
    if not worst >= 0:
        return Wear()
    coarse = damage_of(history[::2], given, settled)[0]
    per_year = worst * (given.events_per_year or YEAR / seconds)
    return Wear(
        damage=worst,
        seconds=seconds,
        cycles=number,
        span=given.equivalent(seconds / worst) if worst > 0 else 0.0,
        s=where,
        gap=abs(worst - coarse) / worst if worst > 0 else 0.0,
        per_year=per_year,
        use=per_year * given.design_life * given.design_factor,
    )


def everywhere(
    t: np.ndarray,
    signals: Mapping[str, np.ndarray],
    cable: Sequence[Section],
    ends: Sequence[End],
    given: Fatigue,
    inside: slice = slice(None),
    period: float = math.nan,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Damage of the worst fibre at each node that is cable, and the cycles of the worst of all.

    Returns
    -------
    (n,) arc length [m]; (n,) damage; (m, 3) range [Pa], number and damage of the worst fibre's cycles
    """
    inside, _, settled = counted(t, inside, period)
    worst: dict[float, float] = {}
    most, history = -1.0, np.zeros(0)
    for s, stress in fibres(signals, inside, cable, ends, given):
        x = stress()
        damage = damage_of(x, given, settled)[0]
        worst[s] = max(worst.get(s, 0.0), damage)
        if damage > most:
            most, history = damage, x
    cycles = count(closed(history) if settled else history)
    each = cycles[:, 2] * given.damage(cycles[:, 0], cycles[:, 1])
    return np.array(list(worst)), np.array(list(worst.values())), np.stack([cycles[:, 0], cycles[:, 2], each], axis=1)
