"""The elastic catenary in closed form, and the one that hangs between a scene's ends: a first shape for every line."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from . import scene as sc


def catenary(
    span: float, rise: float, length: float, w: float, EA: float, bed: bool = False
) -> tuple[float, float]:
    """Horizontal and vertical force H, V at the upper end of an elastic catenary [N].

    Parameters
    ----------
    span, rise : float [m]
        Horizontal and vertical distance of the upper from the lower end, both >= 0.
    length, w, EA : float
        Unstretched length [m], wet weight > 0 [N/m], axial stiffness [N].
    bed : bool
        A frictionless bed at the lower end's level carries what would hang below it.

    Raises
    ------
    ValueError
        When no catenary fits (no weight, or the cable neither stretches nor hangs to the ends).
    """
    if not w > 0:
        raise ValueError("a catenary needs weight")

    def ends(H: float, V: float) -> tuple[float, float]:
        if bed and V < w * length:  # part of the line rests
            hang = V / w
            x = length - hang + H / w * math.asinh(V / H) + H * length / EA
            z = H / w * (math.hypot(1, V / H) - 1) + V * V / (2 * EA * w)
            return x, z
        low = V - w * length
        x = H / w * (math.asinh(V / H) - math.asinh(low / H)) + H * length / EA
        z = H / w * (math.hypot(1, V / H) - math.hypot(1, low / H)) + length / EA * (V - w * length / 2)
        return x, z

    def vertical(H: float) -> float:
        lo, hi = -w * length, w * length
        if bed:
            lo = 0.0
        while ends(H, hi)[1] < rise:
            hi *= 2
            if hi > 1e18:
                raise ValueError("no catenary fits")
        while ends(H, lo)[1] > rise and not bed:
            lo *= 2
            if lo < -1e18:
                raise ValueError("no catenary fits")
        return float(brentq(lambda V: ends(H, V)[1] - rise, lo, hi, xtol=1e-13 * hi, rtol=8.9e-16))

    lo, hi = 1e-9 * w * length, w * length
    if ends(lo, vertical(lo))[0] > span:
        raise ValueError("the line hangs straight down: no catenary with a horizontal force")
    while ends(hi, vertical(hi))[0] < span:
        hi *= 2
        if hi > 1e15 * w * length:
            raise ValueError("no catenary fits")
    H = float(
        np.exp(
            brentq(
                lambda u: ends(math.exp(u), vertical(math.exp(u)))[0] - span,
                math.log(lo),
                math.log(hi),
                xtol=1e-15,
                rtol=8.9e-16,
            )
        )
    )
    return H, vertical(H)


def catenary_shape(
    s: np.ndarray, H: float, V: float, length: float, w: float, EA: float, bed: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """x(s), z(s) of the elastic catenary from its lower end, s unstretched [m]."""
    start = max(0.0, length - V / w) if bed else 0.0
    low = (V - w * length) if start == 0.0 else 0.0
    u = np.clip(s - start, 0.0, None)
    up = low + w * u
    x = np.minimum(s, start) * (1 + H / EA) + H / w * (np.arcsinh(up / H) - np.arcsinh(low / H)) + H * u / EA
    z = H / w * (np.hypot(1, up / H) - np.hypot(1, low / H)) + (up * up - low * low) / (2 * EA * w)
    return x, z


class Catenary(NamedTuple):
    """The elastic catenary between a scene's ends, with mean weight and stiffness."""

    H: float  # horizontal force, vertical force at the upper end [N]
    V: float
    w: float  # wet weight, positive [N/m]
    EA: float
    sign: float  # -1 for a buoyant line, which hangs upwards
    low: np.ndarray
    high: np.ndarray
    bed: bool


def catenary_of(scene: sc.Scene) -> Catenary | None:
    """None where a free end, a vertical or a weightless line leaves no catenary."""
    a, b = scene.end_a.position, scene.end_b.position
    if a is None or b is None:
        return None
    length = scene.length
    w = sum(s.length * s.wet(scene.density, scene.g) for s in scene.cable) / length
    EA = length / sum(s.length / s.EA for s in scene.cable)
    pa, pb = np.array(a), np.array(b)
    sign = 1.0 if w >= 0 else -1.0
    low, high = (pa, pb) if sign * (pb - pa)[2] >= 0 else (pb, pa)
    span, rise = float(np.hypot(*(high - low)[:2])), abs(float((high - low)[2]))
    bed = bool(scene.seabed and abs(low[2] - scene.seabed.z) < 1e-6 * length and sign > 0)
    if span < 1e-9 * length or abs(w) * length < 1e-9 * EA:
        return None
    try:
        H, V = catenary(span, rise, length, abs(w), EA, bed)
    except ValueError:
        return None
    return Catenary(H, V, abs(w), EA, sign, low, high, bed)


def hanging_shape(scene: sc.Scene, arc: np.ndarray) -> np.ndarray | None:
    """Points of the scene's elastic catenary at the arc lengths `arc` from end A, (n, 3); None where there is none."""
    found = catenary_of(scene)
    if found is None:
        return None
    flat = (found.high - found.low)[:2]
    from_a = np.array_equal(found.low, np.array(scene.end_a.position))
    s = arc if from_a else scene.length - arc
    x, z = catenary_shape(s, found.H, found.V, scene.length, found.w, found.EA, found.bed)
    return found.low + np.outer(x / np.hypot(*flat), [*flat, 0.0]) + np.outer(found.sign * z, [0.0, 0.0, 1.0])
