"""Prescribed motion: displacement, velocity and acceleration of the held nodes, shared by the lines.

(harmonics) x window + table, per held node. Window edges without a ramp are jumps: there the methods pass a time
just left or right of the edge, so a kernel never has to know on which side it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from . import scene as sc
from .algebra import axpy, row, scale
from .compile import kernel

NEVER = 1e300


class MotionPack(NamedTuple):
    """Motion of the held nodes; ranges of harmonics and table pieces per node."""

    home: np.ndarray  # (k, dim) rest position [m]
    first: np.ndarray  # (k + 1,) range of harmonics
    amplitude: np.ndarray  # (h, dim) [m]
    omega: np.ndarray  # (h,) [rad/s]
    phase: np.ndarray  # (h,) [rad]
    window: np.ndarray  # (k, 5) start, stop, ramp up, ramp down [s], 0 cosine / 1 smooth
    piece: np.ndarray  # (k + 1,) range of table pieces
    knot: np.ndarray  # (p,) start of each piece [s]
    poly: np.ndarray  # (p, 4, dim) cubic coefficients, highest power first


@kernel
def _ramp(x, smooth):
    """Ramp, slope and curvature in its own variable x in [0, 1]."""
    if x <= 0.0:
        return 0.0, 0.0, 0.0
    if x >= 1.0:
        return 1.0, 0.0, 0.0
    if smooth > 0.5:
        return (
            x**3 * (10.0 - 15.0 * x + 6.0 * x * x),
            30.0 * (x * (1.0 - x)) ** 2,
            60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
        )
    c = math.cos(math.pi * x)
    return 0.5 * (1.0 - c), 0.5 * math.pi * math.sin(math.pi * x), 0.5 * math.pi**2 * c


@kernel
def window(t, w):
    """Window and its first two derivatives at t; zero outside [start, stop]."""
    if t < w[0] or t > w[1]:
        return 0.0, 0.0, 0.0
    f, df, ddf = 1.0, 0.0, 0.0
    if w[2] > 0.0 and t < w[0] + w[2]:
        g, dg, ddg = _ramp((t - w[0]) / w[2], w[4])
        f, df, ddf = g, dg / w[2], ddg / w[2] ** 2
    if w[3] > 0.0 and t > w[1] - w[3]:
        g, dg, ddg = _ramp((w[1] - t) / w[3], w[4])
        f, df, ddf = g, -dg / w[3], ddg / w[3] ** 2
    return f, df, ddf


@kernel
def held(t, k, m, axes):
    """Position, velocity and acceleration of held node k at t."""
    x, v, a = axes, axes, axes
    f, df, ddf = window(t, m.window[k])
    for h in range(m.first[k], m.first[k + 1]):
        om = m.omega[h]
        s, c = math.sin(om * t + m.phase[h]), math.cos(om * t + m.phase[h])
        amp = row(m.amplitude, h, axes)
        x = axpy(f * s, amp, x)
        v = axpy(df * s + f * om * c, amp, v)
        a = axpy(ddf * s + 2.0 * df * om * c - f * om * om * s, amp, a)
    lo, hi = m.piece[k], m.piece[k + 1]
    if hi > lo:
        p = lo
        while p + 1 < hi and t >= m.knot[p + 1]:
            p += 1
        u = t - m.knot[p]
        c3, c2, c1, c0 = (
            row(m.poly[p], 0, axes),
            row(m.poly[p], 1, axes),
            row(m.poly[p], 2, axes),
            row(m.poly[p], 3, axes),
        )
        x = axpy(1.0, axpy(u * u * u, c3, axpy(u * u, c2, axpy(u, c1, c0))), x)
        v = axpy(1.0, axpy(3.0 * u * u, c3, axpy(2.0 * u, c2, c1)), v)
        a = axpy(1.0, axpy(6.0 * u, c3, scale(2.0, c2)), a)
    return axpy(1.0, row(m.home, k, axes), x), v, a


def realise(
    motion: sc.Motion,
) -> tuple[list[tuple[np.ndarray, float, float]], list[tuple[np.ndarray, np.ndarray]]]:
    """Harmonics (amplitude (3,), omega, phase) and tables (t, x (n, 3)) of a motion, random terms drawn.

    Random terms: paper 003 section 4, corrected (see `scene.Stochastic`).
    """
    terms = [(np.array(h.amplitude), 2 * math.pi * h.frequency, h.phase) for h in motion.harmonics]
    tables = []
    if motion.table:
        tables.append((np.array(motion.table.t), np.array(motion.table.x)))
    if motion.stochastic:
        s, w = motion.stochastic, motion.window
        assert w is not None
        assert w.stop is not None
        draw = np.random.default_rng(s.seed)
        for multiple in s.multiples:
            size = 1 + s.amplitude_spread * draw.standard_normal()
            rate = 1 + s.frequency_spread * draw.standard_normal()
            phase = draw.uniform(0, 2 * math.pi)
            terms.append((np.array(s.amplitude) * size, 2 * math.pi * s.frequency * multiple * rate, phase))
        if s.noise_level > 0:
            n = max(math.ceil((w.stop - w.start) / s.noise_interval), 4) + 1
            t = np.linspace(w.start, w.stop, n)
            noise = s.noise_level * draw.standard_normal(n)
            noise[[0, 1, -2, -1]] = 0.0  # starts and stops at rest
            along = np.array(s.amplitude) / np.linalg.norm(s.amplitude)
            tables.append((t, noise[:, None] * along))
    return terms, tables


def motion_pack(ends: list[sc.End], basis: np.ndarray) -> MotionPack:
    """Motion of the held `ends` in the coordinates of `basis` (dim, 3)."""
    dim = len(basis)
    home, first, amp, om, ph, win, piece, knot, poly = [], [0], [], [], [], [], [0], [], []
    for end in ends:
        home.append(basis @ np.array(end.position))
        terms, tables = realise(end.motion) if end.motion else ([], [])
        w = end.motion.window if end.motion else None
        win.append(
            [w.start, NEVER if w.stop is None else w.stop, w.ramp_up, w.ramp_down, float(w.shape == "smooth")]
            if w
            else [-NEVER, NEVER, 0.0, 0.0, 0.0]
        )
        for amplitude, omega, phase in terms:
            amp.append(basis @ amplitude)
            om.append(omega)
            ph.append(phase)
        if tables:
            times = np.unique(np.concatenate([t for t, _ in tables]))
            total = np.zeros((len(times), 3))
            for t, x in tables:
                inside = CubicSpline(t, x, bc_type="clamped")(np.clip(times, t[0], t[-1]))
                total += inside
            spline = CubicSpline(times, total @ basis.T, bc_type="clamped")
            before = np.zeros((1, 4, dim))
            before[0, 3] = total[0] @ basis.T
            after = np.zeros((1, 4, dim))
            after[0, 3] = total[-1] @ basis.T
            poly.append(np.concatenate([before, np.moveaxis(spline.c, 0, 1), after]))
            knot.append(np.concatenate([[-NEVER], times]))
        first.append(len(om))
        piece.append(sum(len(k) for k in knot))
    empty = np.zeros((0, dim))
    return MotionPack(
        home=np.ascontiguousarray(home, dtype=float).reshape(-1, dim),
        first=np.array(first, dtype=np.int64),
        amplitude=np.array(amp) if amp else empty,
        omega=np.array(om, dtype=float),
        phase=np.array(ph, dtype=float),
        window=np.array(win, dtype=float).reshape(-1, 5),
        piece=np.array(piece, dtype=np.int64),
        knot=np.concatenate(knot) if knot else np.zeros(0),
        poly=np.ascontiguousarray(np.concatenate(poly)) if poly else np.zeros((0, 4, dim)),
    )


def breaks(ends: list[sc.End]) -> tuple[float, ...]:
    """Times at which a motion or one of its first two derivatives may jump [s]."""
    times: set[float] = set()
    for end in ends:
        if end.motion is None:
            continue
        w = end.motion.window
        if w:
            times.update({w.start, w.start + w.ramp_up})
            if w.stop is not None:
                times.update({w.stop, w.stop - w.ramp_down})
        for t, _ in realise(end.motion)[1]:
            times.update({float(t[0]), float(t[-1])})
    return tuple(sorted(times))


def top_omega(ends: list[sc.End]) -> float:
    """Highest angular frequency in the motions' harmonics and tables [rad/s]; 0 without motion."""
    top = 0.0
    for end in ends:
        if end.motion is None:
            continue
        terms, tables = realise(end.motion)
        top = max([top, *(omega for _, omega, _ in terms)])
        for t, x in tables:  # the frequency below which 99 % of the sampled velocity's power lies
            dt = float(np.min(np.diff(t)))
            grid = np.arange(t[0], t[-1], dt / 2)
            rate = CubicSpline(t, x, bc_type="clamped")(grid, 1)
            power = np.cumsum((np.abs(np.fft.rfft(rate, axis=0)) ** 2).sum(axis=1))
            if power[-1] > 0:
                top = max(
                    top,
                    2
                    * math.pi
                    * np.fft.rfftfreq(len(grid), dt / 2)[np.searchsorted(power, 0.99 * power[-1])],
                )
    return top
