"""Made-up responses and scenes with hand-computable metrics, shared by the tests of the study layer."""

from __future__ import annotations

import numpy as np

from solvers import BNES, Cost, End, Response, Scene, Section, Status, Water


def scene(devices=None, **changes):
    """A vertical cable of 4 m with one bistable sink at 1 m; y0 = 0.5 sin(phi0)."""
    devices = (BNES(s=1.0, mass=2.0, EA=1e6, BA=44.7, phi0=3.562),) if devices is None else devices
    fields = {
        "cable": (Section(length=4.0, d=0.1, mass=3.0, EA=1e6, EI=10.0),),
        "end_a": End(kind="pinned", position=(0, 0, -10)),
        "end_b": End(kind="pinned", position=(0, 0, -6)),
        "water": Water(density=1000.0),
        "devices": devices,
    }
    return Scene(**(fields | changes))


def response(
    x,
    t,
    arc=(0.0, 1.0, 2.0, 3.0, 4.0),
    v=None,
    rigid=None,
    mass=3.0,
    stroke=None,
    status=Status.OK,
    **signals,
):
    """A response whose nodes move by ``x`` (nt, node) along x, on a vertical static line."""
    arc, t, x = np.asarray(arc, float), np.asarray(t, float), np.asarray(x, float)
    n, nt = len(arc), len(t)
    static = np.zeros((n, 3))
    static[:, 2] = arc - 10
    position = np.broadcast_to(static, (nt, n, 3)).copy()
    position[:, :, 0] += x
    velocity = np.zeros((nt, n, 3))
    velocity[:, :, 0] = np.gradient(x, t, axis=0) if v is None else v
    zeros = np.zeros(nt)
    found = {
        "arc": arc,
        "static_position": static,
        "static_tangent": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "span_mass": mass * np.diff(arc),
        "rigid": np.zeros(n - 1) if rigid is None else np.asarray(rigid, float),
        "position": position,
        "velocity": velocity,
        "tension": np.full((nt, n - 1), 100.0),
        "curvature": np.zeros((nt, n)),
        "end_force": np.zeros((nt, 2, 3)),
        "stroke": np.zeros((nt, 0)) if stroke is None else np.asarray(stroke, float),
        **dict.fromkeys(
            (
                "kinetic",
                "strain",
                "gravity",
                "work",
                "lost_water",
                "lost_cable",
                "lost_device",
                "lost_seabed",
                "rotation",
            ),
            zeros,
        ),
    }
    return Response(
        status=status,
        t=t,
        signals=found | signals,
        energy_residual=1e-5,
        nodes_per_wave=20.0,
        steps_per_period=50.0,
        cost=Cost(steps=100, evaluations=700, seconds=0.25),
        model="lumped",
        method="dopri5",
        segments=n - 1,
    )
