"""Modal energies and the flow into devices against the ledger of real runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import Ask, solve
from solvers.scene import TMD, CubicNES, End, Harmonic, Motion, PointMass, Scene, Section, Water, Window
from sweep.config import MetricSettings
from sweep.flows import Line, flow, modal
from sweep.point import Point

SECTION = Section(length=10.0, d=0.05, mass=5.0, EA=1e6, EI=1500.0)


def scene(amplitude: float, devices: tuple = (), **water: float) -> Scene:
    """A taut cable whose upper end is shaken for half a second."""
    window = Window(stop=0.5, ramp_up=0.2, ramp_down=0.2)
    motion = Motion(harmonics=(Harmonic(amplitude=(amplitude, 0, 0), frequency=2.0),), window=window)
    return Scene(
        cable=(SECTION,),
        end_a=End(kind="pinned", position=(0, 0, -12)),
        end_b=End(kind="clamped", position=(0, 0, -1.98), direction=(0, 0, 1), motion=motion),
        water=Water(density=1025.0) if not water else None,
        devices=devices,
    )


def point(of: Scene, **ask: float) -> Point:
    nothing: dict = {"key": "k", "design": 0, "environment": 0, "values": {}}
    asked = Ask(**({"duration": 2.0, "segments": 20, "interval": 2e-3} | ask))
    return Point(**nothing, scene=of, ask=asked, settings=MetricSettings(pulse_end=0.5, baseline="plain"))


def test_parseval_in_a_linear_run():
    """A hair's breadth of motion: modal energies add up to the ledger's, at every time after the pulse.

    What is left: products of the motion (amplitude/length, 1e-5), and drag's damping within a step.
    """
    still = scene(1e-5)
    run = solve(still, Ask(duration=2.0, segments=20, interval=2e-3, tolerance=1e-6))
    assert run.trusted
    line = Line(still, 20)
    signals = run.signals
    energy = line.energies(
        signals["arc"], signals["position"] - signals["static_position"], signals["velocity"]
    ).sum(axis=1)
    ledger = signals["kinetic"] + signals["strain"] + signals["gravity"]
    after = run.t >= 0.5
    assert energy[after] == pytest.approx(ledger[after], rel=1e-4)
    assert energy[-1] > 0.01 * energy.max()
    # bending and the clamp raise the bare string by pi^2 EI/2TL^2 + sqrt(EI/T)/L = 12 %
    tension = float(signals["tension"][0].mean())
    string = np.sqrt(tension / (5.0 + 1025 * np.pi / 4 * 0.05**2)) / 20
    assert string < line.modes.frequency[0] < 1.3 * string
    assert line.top == pytest.approx(2.0)


def test_modal_energies_of_a_point():
    found = modal(point(scene(0.02, (PointMass(kind="mass", s=4.0, mass=3.0),))))
    assert found["modal_energy"].dims == found["baseline_modal_energy"].dims == ("time", "mode")
    assert found.attrs["cut"] == pytest.approx(2 * np.sqrt(2))
    plain = found["baseline_modal_energy"].sum("mode").values
    after = found["time"].values > 0.5
    # 20 mm on 10 m: the tension changes with the square of the slope, some parts in a hundred of the energy
    assert plain[after] == pytest.approx(found["baseline_mechanical"].values[after], rel=0.1)
    for name in ("before", "after", "baseline_before", "baseline_after"):
        assert np.all(np.diff(found[name].values) <= 0)  # less above a higher frequency
        assert 0 < float(found[name][0]) < 1


@pytest.mark.parametrize(
    "device",
    [TMD(s=6.0, mass=2.0, k=300.0, c=8.0), CubicNES(s=6.0, mass=2.0, EA=2e5, BA=300.0, length=0.3)],
    ids=["tmd", "nes"],
)
def test_flow_into_a_device(device):
    """Its losses are the ledger's; what has passed to it is the work of the force that moves its mass."""
    p = point(scene(0.05, (device,)))
    found = flow(p)
    assert found.attrs["gap"] < 5e-3  # trapezoids at 0.2 ms of speeds by differences
    passed, lost = (found[name].values[:, 0] for name in ("passed", "device_lost"))
    assert lost[-1] == pytest.approx(float(found["lost_device"][-1]), rel=5e-3)
    assert passed[-1] > 0.9 * lost[-1] > 0
    run = solve(p.scene, replace(p.ask, interval=p.ask.interval / 10))
    arc = run.signals["arc"]
    i = int(np.argmin(np.abs(arc - 6.0)))
    host = run.signals["velocity"][:, i, [0, 2]]
    chord = run.signals["position"][:, i + 1] - run.signals["position"][:, i - 1]
    chord = chord[:, [0, 2]] / np.linalg.norm(chord, axis=1)[:, None]
    across = np.stack([chord[:, 1], -chord[:, 0]], axis=1)
    speed = np.gradient(run.signals["stroke"][:, 0], run.t)
    force = 2.0 * np.gradient(host, run.t, axis=0) + 2.0 * np.gradient(speed, run.t)[:, None] * across
    power = (force * host).sum(axis=1)
    work = np.concatenate(([0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(run.t))))
    every = slice(None, None, max(1, len(run.t) // 2000))
    # the turning of the slide direction does work too, of the order of slope squared; and differences at kinks
    assert passed == pytest.approx(work[every], abs=0.03 * np.abs(work).max())


def test_a_bistable_sink_on_a_rod_loses_what_the_ledger_says():
    from sweep.config import load_study
    from sweep.space import points

    study = load_study(Path(__file__).parents[1] / "unit" / "tiny.yaml")
    found = flow(next(points(study, 1)))
    assert found.attrs["gap"] < 0.05  # impacts of a millisecond, outputs of one
    whole = found["cable_energy"] + found["device_energy"].sum("device")
    assert float(whole[0]) == pytest.approx(0.0, abs=1e-9)


def test_without_a_device_that_moves():
    with pytest.raises(ValueError, match="no device of this design moves"):
        flow(point(scene(0.02)))
