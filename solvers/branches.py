"""Frequency responses: periodic responses along one field of a scene, through turning points, with stability."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import scene as sc
from . import settled
from .catalogue import METHODS, MODELS, bending_matters, cheapest, static_state, without_bending
from .methods import continuation
from .methods.continuation import Branch
from .methods.harmonic import series
from .model import Ask, CannotRepresent, Status
from .motion import motion_pack, top_omega

SAMPLES = 96  # of a period, for the extremes


@dataclass(frozen=True, kw_only=True)
class ResponseCurve:
    """Extremes of the periodic responses along a branch, in the order of the arc."""

    parameter: np.ndarray  # (n,)
    omega: np.ndarray  # (n,) [rad/s]
    displacement: np.ndarray  # (n,) half the largest range of a coordinate of a cable node [m]
    tension: np.ndarray  # (n, 2) least and largest force on end B [N]
    stroke: np.ndarray  # (n, nd) half range of each device [m]
    multiplier: np.ndarray  # (n,) size of the largest Floquet multiplier
    stable: np.ndarray  # (n,) bool
    trusted: np.ndarray  # (n,) bool: series long enough, mesh fine enough, line within its range
    fold: np.ndarray  # (n,) bool: turning points
    branch: Branch
    status: Status  # OK when the whole range was followed
    message: str


def response_curve(
    scene_at: Callable[[float], sc.Scene], start: float, stop: float, ask: Ask, **how: Any
) -> ResponseCurve:
    """Follow the periodic response from one value of a parameter to another.

    Parameters
    ----------
    scene_at : value -> Scene
        For example ``lambda f: replace(scene, ...)``; frequency and amplitude of the motion are cheapest, for the line
        is then built once.
    start, stop : float
        Range of the parameter.
    ask : Ask
        Model, segments, tolerance and harmonics.
    how
        Passed to `continuation.trace`: step, most_step, most_points, with_stability.

    Raises
    ------
    CannotRepresent
        Where harmonic balance cannot serve the scene.
    """
    first = scene_at(start)
    reason = settled.why_not(first)
    if reason:
        raise CannotRepresent(f"harmonic: {reason}")
    asked = replace(ask, method="harmonic", duration=max(ask.duration, 1.0))
    choice = max((cheapest(scene, asked) for scene in (first, scene_at(stop))), key=lambda choice: choice.segments)
    limp = not bending_matters(first, choice.segments)

    def made(value: float) -> sc.Scene:
        scene = settled.steady(scene_at(value))
        return without_bending(scene) if limp else scene

    base = made(start)
    model = MODELS[choice.model].build(base, choice.segments)
    settled.at_home(model)
    for value in (start, stop):
        error = MODELS[choice.model].build(made(value), choice.segments).range_error()
        if not error <= ask.accuracy:
            raise CannotRepresent(
                f"{choice.model} is for small motion: at {value:g} its estimated error is {error:.2g}, "
                f"above `accuracy` {ask.accuracy:g}"
            )
    status, static, note = static_state(model)
    if status != Status.OK:
        raise CannotRepresent(f"no static state at the start: {note}")
    bare = settled.still(base)

    def problem(value: float) -> tuple[Any, float]:
        scene = made(value)
        omega = 2 * math.pi / settled.period(scene)[0]
        if settled.still(scene) == bare:
            ends = [end for end in (scene.end_a, scene.end_b) if end.kind != "free"]
            return model.pack._replace(motion=motion_pack(ends, model.basis)), omega
        other = MODELS[choice.model].build(scene, choice.segments)
        other.settle(static)
        return other.pack, omega

    tolerance = METHODS["harmonic"].tolerance if ask.tolerance is None else ask.tolerance
    branch = continuation.trace(
        problem, start, stop, static, tolerance=tolerance, harmonics=ask.harmonics, **how
    )
    points = branch.points
    n = len(points)
    displacement, tension, omega = np.zeros(n), np.zeros((n, 2)), np.zeros(n)
    stroke = np.zeros((n, len(base.devices)))
    trusted = np.zeros(n, dtype=bool)
    phase = series(1, SAMPLES).phase
    for k, point in enumerate(points):
        pack = problem(point.parameter)[0]
        signals = model.observe(*settled.states(pack, point.orbit, phase), static)
        force = np.linalg.norm(signals["end_force"][:, 1], axis=1)
        displacement[k] = np.ptp(signals["position"], axis=0).max() / 2
        tension[k] = force.min(), force.max()
        stroke[k] = np.ptp(signals["stroke"], axis=0) / 2
        omega[k] = point.orbit.omega
        scene = made(point.parameter)
        model.omega = top_omega([end for end in (scene.end_a, scene.end_b) if end.kind != "free"])
        sound = model.guards(static)[0] == Status.OK and model.validity(signals)[0] == Status.OK
        trusted[k] = sound and point.orbit.tail <= tolerance
    return ResponseCurve(
        parameter=branch.parameters, omega=omega, displacement=displacement, tension=tension, stroke=stroke,
        multiplier=np.array([math.nan if p.stability is None else p.stability.largest for p in points]),
        stable=branch.stable, trusted=trusted,
        fold=np.array([p.fold for p in points], dtype=bool), branch=branch, status=branch.status,
        message=branch.message,
    )  # fmt: skip

