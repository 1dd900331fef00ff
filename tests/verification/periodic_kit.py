"""What the tests of periodic responses share: scenes, their lines at rest, time domain responses."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from solvers import MODELS, Ask, End, Harmonic, Motion, Response, Scene, Section, Status, Water, Window, settled, solve
from solvers.catalogue import static_state
from solvers.methods import harmonic
from solvers.methods.harmonic import Orbit

WIDE = 0.99  # accuracy asked where a coarse mesh or a large motion of `local` is meant


class Line(NamedTuple):
    """A line at rest with the settled motion of its scene."""

    model: Any
    pack: Any
    rest: np.ndarray
    omega: float  # [rad/s]


def line(scene: Scene, segments: int, name: str = "lumped") -> Line:
    """The static state is that of the scene without motion: its ends at home."""
    still = replace(scene, end_a=replace(scene.end_a, motion=None), end_b=replace(scene.end_b, motion=None))
    status, rest, note = static_state(MODELS[name].build(still, segments))
    assert status == Status.OK, note
    model = MODELS[name].build(settled.steady(scene), segments)
    model.settle(rest)
    return Line(model, model.pack, rest, 2 * math.pi / settled.period(scene)[0])


def periodic(of: Line, tolerance: float, harmonics: int | None = None, start: Orbit | None = None) -> Orbit:
    return harmonic.periodic(of.pack, of.omega, of.rest, tolerance, harmonics, start)


def top_force(of: Line, orbit: Orbit, phase: np.ndarray) -> np.ndarray:
    """Size of the force on end B at phases w t [N]; the last prescribed dofs are its."""
    force = settled.states(of.pack, orbit, phase)[2]
    return np.linalg.norm(force[:, -of.model.dim :], axis=1)


def phases(n: int) -> np.ndarray:
    return 2 * math.pi * np.arange(n) / n


def top(run: Response) -> np.ndarray:
    """Size of the force on end B [N]."""
    return np.linalg.norm(run.signals["end_force"][:, 1], axis=1)


def orders(errors: Any, ratio: float = 2.0) -> np.ndarray:
    """Observed orders of errors under refinement by `ratio`."""
    e = np.abs(np.array(errors))
    return np.log(e[:-1] / e[1:]) / math.log(ratio)


def oc3_hung(x: float = 5.0) -> Scene:
    """Reference 27: the OC3 line with the misprinted EA free of the bed, surge x cos(2 pi t/15 s)."""
    cable = Section(
        length=902.2, d=0.09, mass=77.7066, EA=3.84243e7, BA=3.84243e5, Cdn=1.6, Cdt=1.6 / math.pi, compression=False
    )
    surge = Harmonic(amplitude=(x, 0, 0), frequency=1 / 15.0, phase=math.pi / 2)
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, -320)), water=Water(),
        end_b=End(kind="pinned", position=(848.67, 0, -70),
                  motion=Motion(harmonics=(surge,), window=Window(ramp_up=30.0, shape="smooth"))),
    )  # fmt: skip


def jumper(EI: float = 1.208e5) -> Scene:
    """Low and Langley (2006), hanging flexible jumper; surge of 10 m at 27 s."""
    cable = Section(length=170.0, d=0.396, mass=165.0, EA=5e8, EI=EI, BA=5e4, Cdn=1.0)
    surge = Harmonic(amplitude=(10.0, 0, 0), frequency=1 / 27.0)
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(-100, 0, -55)), g=9.807, water=Water(density=1000.0),
        end_b=End(kind="pinned", position=(0, 0, -5),
                  motion=Motion(harmonics=(surge,), window=Window(ramp_up=27.0, shape="smooth"))),
    )  # fmt: skip


def hose(x: float = 0.3, devices: tuple = (), **change: Any) -> Scene:
    """A vertical cable of 12 m in water under 2 kN, its upper end moved across at 1.2 Hz after a ramp of 2 s."""
    cable = Section(**{
        "length": 12.0, "d": 0.06, "mass": 5.0, "EA": 1e6, "EI": 0.0, "BA": 2e3, "Cdn": 1.2, "Cdt": 0.01,
        "compression": True, **change,
    })  # fmt: skip
    sway = Harmonic(amplitude=(x, 0, 0), frequency=1.2)
    return Scene(
        cable=(cable,), water=Water(), devices=devices, end_a=End(kind="pinned", position=(0, 0, -13.0)),
        end_b=End(kind="pinned", position=(0, 0, -13.0 + 12.0 * 1.002),
                  motion=Motion(harmonics=(sway,), window=Window(ramp_up=2.0, shape="smooth"))),
    )  # fmt: skip


@cache
def oc3(segments: int) -> Line:
    return line(oc3_hung(), segments)


def last_period(scene: Scene, segments: int, periods: int, name: str) -> Ask:
    """Of so many periods the last one, at 200 times."""
    period = settled.period(scene)[0]
    return Ask(
        duration=periods * period, output_from=(periods - 1) * period, segments=segments, model=name, accuracy=WIDE,
        interval=period / 200,
    )  # fmt: skip


def marched(scene: Scene, segments: int, periods: int, name: str = "lumped") -> Response:
    """The last of `periods` periods by dopri5, at a tolerance of 1e-6 in the energy norm."""
    run = solve(scene, replace(last_period(scene, segments, periods, name), method="dopri5", tolerance=1e-6))
    assert run.status == Status.OK, run.message
    return run


def both(scene: Scene, segments: int, periods: int, name: str = "lumped") -> tuple[Response, Response]:
    """Harmonic balance to an estimated error of 1e-4 and the time domain, on the same output grid."""
    run = solve(scene, replace(last_period(scene, segments, periods, name), method="harmonic", tolerance=1e-4))
    assert run.status == Status.OK, run.message
    return run, marched(scene, segments, periods, name)


def differences(found: Response, exact: Response) -> dict[str, float]:
    """Largest differences over time of the force on end B, positions and strokes, over their largest ranges."""
    np.testing.assert_array_equal(found.t, exact.t)
    out = {"force": float(np.abs(top(found) - top(exact)).max() / np.ptp(top(exact)))}
    for name in ("position", "stroke"):
        x, y = found.signals[name], exact.signals[name]
        if y.size:
            out[name] = float(np.abs(x - y).max() / np.ptp(y, axis=0).max())
    return out
