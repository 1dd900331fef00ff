"""A scene under harmonic balance: has it a period, why not, and what its settled response shows over time."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from . import scene as sc
from .compile import kernel
from .dispatch import GRAVITY, KINETIC, N_ENERGIES, STRAIN, WATER, energies
from .methods import continuation, harmonic
from .methods.harmonic import Orbit
from .methods.march import L_WORK, N_LEDGER
from .model import Status

MOST_HARMONIC = 12  # largest ratio of a motion's frequencies to their common one
CLIMB_FROM = 0.02  # share of the amplitude at which the arc to the whole of it begins
CLIMB_POINTS = 200  # on that arc
LEDGER_SAMPLES = 256  # of a period at least


def period(scene: sc.Scene) -> tuple[float, str]:
    """Period of a scene's motion once its ramps are over [s], or NaN and the reason why it has none."""
    frequencies: list[float] = []
    moving: list[float] = []
    for name, end in (("end_a", scene.end_a), ("end_b", scene.end_b)):
        motion = end.motion
        if motion is None:
            continue
        if motion.stochastic is not None or motion.table is not None:
            kind = "stochastic" if motion.stochastic is not None else "table"
            return math.nan, f"{name}.motion.{kind} is transient motion"
        if motion.window is not None and motion.window.stop is not None:
            return math.nan, f"{name}.motion.window stops at {motion.window.stop:g} s: transient motion"
        frequencies += [h.frequency for h in motion.harmonics]
        moving += [h.frequency for h in motion.harmonics if any(h.amplitude)]
    if not frequencies:
        return math.nan, "nothing moves: no period"
    frequencies = moving or frequencies[:1]  # a term without amplitude has no say
    least = min(frequencies)
    ratios = [Fraction(f / least).limit_denominator(MOST_HARMONIC) for f in frequencies]
    common = math.lcm(*(r.denominator for r in ratios))
    if any(abs(float(r) * least / f - 1) > 1e-6 for r, f in zip(ratios, frequencies, strict=True)):
        return math.nan, f"the motion's frequencies {sorted(frequencies)} Hz have no common period"
    if max(float(r) * common for r in ratios) > MOST_HARMONIC:
        return math.nan, f"the common period of {sorted(frequencies)} Hz is more than {MOST_HARMONIC} of the shortest"
    return common / least, ""


def why_not(scene: sc.Scene, harmonics: int | None = None) -> str:
    """Why harmonic balance, with so many harmonics, cannot serve a scene; "" where it can."""
    length, reason = period(scene)
    if reason:
        return reason
    motions = [end.motion for end in (scene.end_a, scene.end_b) if end.motion]
    top = round(length * max((h.frequency for m in motions for h in m.harmonics if any(h.amplitude)), default=0.0))
    if harmonics is not None and harmonics < top:
        return f"harmonics: {harmonics}, but the motion's highest frequency is {top} times the common one"
    if scene.start.kind != "static":
        return f"start.kind: {scene.start.kind} begins a transient; a settled response has no start"
    for d, device in enumerate(scene.devices):
        if isinstance(device, sc.BNES) and device.law == "cords" and (device.phi0 > 0 or device.kind == "bnes_free"):
            return (
                f"devices[{d}].law: cords in tension only leave a dead band, where a mass that touches nothing has no "
                "unique periodic response"
            )
    return ""


def ramped(scene: sc.Scene) -> float:
    """Time at which the last ramp of the motion is over [s]."""
    windows = [e.motion.window for e in (scene.end_a, scene.end_b) if e.motion and e.motion.window]
    return max((w.start + w.ramp_up for w in windows), default=0.0)


def steady(scene: sc.Scene) -> sc.Scene:
    """The scene with its motion as it is after the ramps."""

    def settled(end: sc.End) -> sc.End:
        if end.motion is None or end.motion.window is None:
            return end
        return replace(end, motion=replace(end.motion, window=None))

    return replace(scene, end_a=settled(scene.end_a), end_b=settled(scene.end_b))


def still(scene: sc.Scene) -> sc.Scene:
    """The scene without its motion: ends at home."""
    return replace(scene, end_a=replace(scene.end_a, motion=None), end_b=replace(scene.end_b, motion=None))


def at_home(model: Any) -> None:
    """Let the model find its static state with the ends at home: a settled motion has no start, and t = 0 may find them
    anywhere on their way."""
    motion = model.static_pack.motion
    model.static_pack = model.static_pack._replace(motion=motion._replace(amplitude=0.0 * motion.amplitude))


def respond(pack: Any, omega: float, rest: np.ndarray, tolerance: float, harmonics: int | None) -> Orbit:
    """The periodic response: from rest, and where that fails along the arc of a growing amplitude, folds included."""
    found = harmonic.periodic(pack, omega, rest, tolerance, harmonics)
    if found.status != Status.NO_CONVERGENCE:
        return found

    def problem(share: float) -> tuple[Any, float]:
        motion = pack.motion
        return pack._replace(motion=motion._replace(amplitude=share * motion.amplitude)), omega

    branch = continuation.trace(
        problem, CLIMB_FROM, 1.0, rest, tolerance=1.0, harmonics=harmonics, with_stability=False, step=0.05,
        most_step=0.3, most_points=CLIMB_POINTS,
    )  # fmt: skip
    if branch.status != Status.OK or branch.points[-1].parameter != 1.0:
        return found
    return harmonic.periodic(pack, omega, rest, tolerance, harmonics, start=branch.points[-1].orbit)


class Shown(NamedTuple):
    """A settled response on an output grid."""

    q: np.ndarray  # (nt, ndof)
    v: np.ndarray
    force: np.ndarray  # (nt, nfixed)
    ledger: np.ndarray  # (nt, N_LEDGER), columns of `march`
    residual: float  # energy residual


@kernel
def sample_energies(phase, omega, q, v, a, pack, e):
    for k in range(len(phase)):
        energies(phase[k] / omega, q[k], v[k], a[k], pack, e[k])


def show(pack: Any, orbit: Orbit, t: np.ndarray, floor: float) -> Shown:
    """States, end forces and energy ledger of a periodic response at the times t [s].

    The ledger runs over one period: E(t) - E(0) = work - lost + rotation, powers integrated term by term of their own
    Fourier series. Its gap, against the peak energy, is what the left out harmonics do: they are not forced to zero by
    the balance, which sees whole periods only.
    """
    n = max(LEDGER_SAMPLES, 16 * orbit.harmonics)
    phase = 2 * math.pi * np.arange(n) / n
    e, power = _energies(pack, orbit, phase)
    kept = harmonic.series(4 * orbit.harmonics + 8, n).project @ np.column_stack([power, e])
    columns = power.shape[1]
    mean = kept[0, :columns] / math.sqrt(2)
    total = e.sum(axis=1)
    made = _grown(kept[:, :columns], phase, orbit.omega)  # work, losses, rotation since t = 0
    gap = total - total[0] - made[:, 0] + made[:, 1:-1].sum(axis=1) - made[:, -1]
    peak = max(float(e[:, 0].max()), float(np.abs(total - total[0]).max()), floor)
    drift = abs(float(mean[0] - mean[1:-1].sum() + mean[-1])) * 2 * math.pi / orbit.omega
    residual = max(float(np.abs(gap).max()), drift) / peak
    at = orbit.omega * t
    q, v, a = orbit.at(at)
    force = _end_force(pack, orbit.omega, at, q, v, a)
    ledger = np.zeros((len(t), N_LEDGER))
    energy = np.zeros((len(t), N_ENERGIES))
    sample_energies(at, orbit.omega, q, v, a, pack, energy)
    ledger[:, :L_WORK] = energy[:, [KINETIC, STRAIN, GRAVITY]]
    ledger[:, L_WORK:] = _grown(kept[:, :columns], at, orbit.omega)
    return Shown(q, v, force, ledger, residual)


def states(pack: Any, orbit: Orbit, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, q' (n, ndof) and the force at the prescribed dofs (n, nfixed) at phases w t."""
    q, v, a = orbit.at(phase)
    return q, v, _end_force(pack, orbit.omega, phase, q, v, a)


def _end_force(
    pack: Any, omega: float, phase: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    r = np.zeros_like(q)
    harmonic.sample_residual(phase, omega, q, v, a, pack, r)
    return np.ascontiguousarray(r[:, pack.fixed])


def _energies(pack: Any, orbit: Orbit, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic, strain and gravity energy, and the powers: work, then the losses and rotation, at phases."""
    q, v, a = orbit.at(phase)
    r, e = np.zeros_like(q), np.zeros((len(phase), N_ENERGIES))
    harmonic.sample_residual(phase, orbit.omega, q, v, a, pack, r)
    sample_energies(phase, orbit.omega, q, v, a, pack, e)
    work = (r[:, pack.fixed] * v[:, pack.fixed]).sum(axis=1)
    return e[:, [KINETIC, STRAIN, GRAVITY]], np.column_stack([work, e[:, WATER:]])


def _grown(kept: np.ndarray, phase: np.ndarray, omega: float) -> np.ndarray:
    """Integral from 0 of a Fourier series (2H + 1, columns), at phases."""
    h = np.arange(1, len(kept) // 2 + 1)
    cosine, sine = kept[1::2] / h[:, None], kept[2::2] / h[:, None]
    out = np.outer(phase, kept[0] / math.sqrt(2))
    # few harmonics matter; a grid of many times is taken in pieces so that the tables stay small
    for k in range(0, len(phase), 512):
        angle = np.outer(phase[k : k + 512], h)
        out[k : k + 512] += np.sin(angle) @ cosine + (1 - np.cos(angle)) @ sine
    return out / omega

