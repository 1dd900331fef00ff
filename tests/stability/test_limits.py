"""Every method at its brink, ill-posed lines, extreme inputs: what must grow grows, every end has a Status."""

from __future__ import annotations

import math

import numpy as np
import pytest
from brink_kit import LINES, L, N, taut

from solvers import BNES, Ask, End, Harmonic, Motion, Response, Scene, Section, Start, Status, Water, Window, solve
from solvers.lines.lumped import LumpedModel
from solvers.lines.oscillator import Oscillator, oscillator
from solvers.methods import explicit, implicit
from solvers.methods.march import make_ends, make_output

TABLES = {"rk2": explicit.RK2, "rk4": explicit.RK4, "dopri5": explicit.DOPRI5}
NO_GAPS = np.zeros(0)


def fixed(pack: Oscillator, method: str, step: float, steps: int, q: float = 1.0, v: float = 0.5) -> tuple[int, float]:
    """Status, and what is left of the state after `steps` fixed steps."""
    out, s = make_output(np.array([0.0, steps * step]), 1, 0), make_ends(1)
    s.q[0], s.v[0] = q, v
    work = explicit.make_work(TABLES[method], 1, 0)
    pieces = np.array([0.0, steps * step])
    code = explicit.march(pack, s, out, work, pieces, TABLES[method], step, 0.0, 1.0, 0.0, NO_GAPS, 1e-12, 10 * steps)
    return code, float(np.hypot(out.q[-1, 0], out.v[-1, 0]))


# ------------------------------------------------------------------------------------------- the methods' own limits


@pytest.mark.parametrize(("method", "limit"), [("rk2", 2.0), ("rk4", 2.7853), ("dopri5", 3.3066)])
def test_limit_on_the_real_axis(method, limit):
    """v' = -c v: decays at 0.95 of the limit, grows at 1.05 (closed forms of the stability polynomials)."""
    pack = oscillator(m=1.0, c=1.0, k1=0.0)
    run = [fixed(pack, method, share * limit, 300, q=0.0) for share in (0.95, 1.05)]
    out = [abs(x[1]) for x in run]
    assert out[0] < 1.0  # q has come to rest at v0/c = 0.5
    assert not out[1] < 1e3


@pytest.mark.parametrize(("method", "limit"), [("rk4", math.sqrt(8.0))])
def test_limit_on_the_imaginary_axis(method, limit):
    """An undamped oscillator: RK4 to 2.8284; RK2 never (see the verification tests)."""
    assert fixed(oscillator(), method, 0.95 * limit, 1000)[1] < 1.2
    assert not fixed(oscillator(), method, 1.05 * limit, 1000)[1] < 1e3


@pytest.mark.parametrize(("method", "limit"), [("rk2", 0.764), ("rk4", 1.064)])
def test_damping_beyond_critical_cuts_the_limit(method, limit):
    """zeta = 1.5: the faster root is 2.618 omega, so limits are 2/2.618 and 2.7853/2.618."""
    pack = oscillator(c=3.0)
    assert fixed(pack, method, 0.95 * limit, 400)[1] < 1e-3
    assert not fixed(pack, method, 1.05 * limit, 400)[1] < 1e3


# ------------------------------------------------------------------------------------------- limits of a line

def brink(scene: Scene, omega: float, share: float, periods: float = 60.0) -> Response:
    """RK4 at a share of 2.8284/omega from a tiny random start."""
    step = share * math.sqrt(8.0) / omega
    steps = round(periods * 2 * math.pi / omega / step)
    ask = Ask(duration=steps * step, segments=N, method="rk4", step=step, interval=step, perturbation=1e-6)
    return solve(scene, ask)


@pytest.mark.parametrize("name", LINES)
def test_explicit_limit_of_a_line(name):
    """Bounded at 0.95 of 2.8284/omega_max, growing without bound at 1.05: axial, tension, bending, device.

    Kinetic energy of the tiny start (1e-6 m/s): RK4 takes some away at 0.95; at 1.05 it grows by 1.3 a step.
    """
    scene, omega = LINES[name]
    calm = brink(scene, omega, 0.95)
    kinetic = calm.signals["kinetic"]
    assert calm.status not in (Status.DIVERGED, Status.NO_CONVERGENCE), calm.message
    assert kinetic.max() < 4 * kinetic[0]
    wild = brink(scene, omega, 1.05)
    assert wild.status != Status.OK
    assert wild.status == Status.DIVERGED or wild.signals["kinetic"].max() > 1e6 * kinetic[0]


@pytest.mark.parametrize("name", ["axial", "tension", "bending", "device"])
def test_fastest_knows_the_limit(name):
    """`fastest` promises at least the true highest frequency, and is not far off where its kind is the highest."""
    scene, omega = LINES[name]
    model = LumpedModel(scene, N)
    found = model.fastest(model.place(model.straight()))
    assert max(found.values()) >= omega * (1 - 1e-3)
    assert found[name] == pytest.approx(omega, rel=0.02)


# ------------------------------------------------------------------------------------------- ill-posed lines


def growth(segments: int, EI: float, mode: int) -> float:
    """Rate at which a transverse mode of a line compressed by 200 N grows [1/s], from a start in that mode."""
    cable = Section(length=L, d=0.05, mass=2.0, EA=1e6, EI=EI, wet_weight=0.0, Can=0.0, Cdn=0.0, compression=True)
    far = L * (1 - 200.0 / 1e6)
    i = np.arange(segments + 1)
    start = Start(
        kind="given",
        shape=tuple((far * k / segments, 0.0, 0.0) for k in i),
        velocity=tuple((0.0, 0.0, 1e-8 * math.sin(math.pi * mode * k / segments)) for k in i),
    )
    scene = Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, 0)), g=0.0, start=start,
        end_b=End(kind="pinned", position=(far, 0, 0)),
    )  # fmt: skip
    duration = 10.0 / (CAP if EI > 0 else 2 * segments)
    ask = Ask(duration=duration, segments=segments, method="dopri5", interval=duration / 100, tolerance=1e-6)
    run = solve(scene, ask)
    speed = np.abs(run.signals["velocity"][:, :, 2]).max(axis=1)
    late = slice(50, 100)
    return float(np.polyfit(run.t[late], np.log(speed[late]), 1)[0])


K7 = 7 * math.pi / L  # the wave number that grows fastest, sqrt(|T|/2 EI), made the seventh mode's
EI7 = 200.0 / (2 * K7**2)
CAP = 200.0 / (2 * math.sqrt(EI7 * 2.0))


def test_compression_without_bending_is_ill_posed():
    """Negative tension grows as k sqrt(|T|/m): with EI = 0 halving the mesh doubles the growth of its shortest wave.

    1e-2: the segments' shortening by 2e-4 and what is left of the decaying half of the start.
    """
    rates = [growth(n, 0.0, n - 1) for n in (20, 40)]
    exact = [2 * n / L * math.sqrt(200.0 / 2.0) * math.sin((n - 1) * math.pi / (2 * n)) for n in (20, 40)]
    np.testing.assert_allclose(rates, exact, rtol=0.01)
    assert rates[1] / rates[0] == pytest.approx(2.0, rel=0.01)


def test_bending_caps_the_growth():
    """EI > 0: no wave grows faster than |T|/(2 sqrt(EI m)), on any mesh; shorter and longer ones grow more slowly.

    The fastest wave's own rate is stationary in k, so a mesh changes it by O((k h)^4): 1 %.
    """
    rates = [growth(n, EI7, 7) for n in (40, 80)]
    np.testing.assert_allclose(rates, CAP, rtol=0.01)
    assert growth(80, EI7, 9) < 0.9 * CAP
    assert growth(80, EI7, 3) < 0.9 * CAP
    short = growth(40, 0.0, 39), growth(40, EI7, 39)
    assert short[1] < 0.1 * CAP < short[0]  # the mesh's shortest wave: a vibration with bending, explosive without


# ------------------------------------------------------------------------------------------- the study's cable


def study(segments_EA: float, kind: str = "bnes", law: str = "cords") -> Scene:
    """The study's cable with two sinks of Table 1's masses and damper rule d = sqrt(0.002 EA)."""
    cable = Section(length=18.8016, d=0.076, mass=4.73, EA=9e6, EI=11710.0, BA=1533.0, Cdt=0.008)
    pulse = Motion(
        harmonics=tuple(Harmonic(amplitude=(0.01, 0, 0), frequency=f) for f in (2.0, 4.0, 8.0)),
        window=Window(stop=0.5),
    )
    sinks = tuple(
        BNES(kind=kind, s=s, mass=4.0, EA=segments_EA, BA=math.sqrt(0.002 * segments_EA), law=law,
             rod="cords" if kind == "bnes" else None)
        for s in (16.92, 6.957)
    )  # fmt: skip
    return Scene(
        cable=(cable,), water=Water(depth=25.0), devices=sinks,
        end_a=End(kind="clamped", position=(0, 0, -25), direction=(0, 0, 1)),
        end_b=End(kind="clamped", position=(0, 0, -6.197355466666667), direction=(0, 0, 1), motion=pulse),
    )  # fmt: skip


@pytest.mark.parametrize("EA", [1e4, 1e6, 1e8, 5.384e8, 7.293e9, 5e10])
def test_any_cord_runs_and_closes(EA):
    """Cord stiffness over the whole range of a study, 1e4 to 5e10 N, 40 segments: masses cross from wall to wall many
    times, the energy closes to 1e-3, and a stiffer wall costs no more steps.
    """
    run = solve(study(EA), Ask(duration=2.0, segments=40, method="dopri5"))
    assert run.status == Status.OK, run.message
    assert run.energy_residual < 1e-3
    stroke = run.signals["stroke"]
    wall = 0.5 * math.sin(math.radians(3.562))
    # a stiff wall throws the mass back between two samples: at 3 m/s it is seen up to 1.5 mm, 5 % of y0, before it
    assert stroke[:, 0].min() < -0.95 * wall
    if EA >= 1e8:  # a wall: what a mass of 4 kg at 3 m/s pushes it in by is less than 5 % of the stroke
        assert np.abs(stroke).max() < 1.05 * wall
    assert run.cost.steps < 6000


@pytest.mark.parametrize("EA", [1e4, 1e8, 5e10])
def test_any_cord_of_a_free_mass_closes_at_a_tighter_tolerance(EA):
    """A free mass strikes along its cords, without the factor sin(phi0): a tenth of the tolerance, as a retry takes."""
    run = solve(study(EA, "bnes_free"), Ask(duration=1.0, segments=40, method="dopri5", tolerance=1e-5))
    assert run.status == Status.OK, run.message
    assert run.energy_residual < 1e-3


@pytest.mark.parametrize("EA", [1e9, 1e10])
@pytest.mark.parametrize("method", ["rk2", "rk4", "genalpha"])
def test_a_fixed_step_of_1_ms_is_not_trusted(method, EA):
    """With stiff cords such runs gave numbers that looked like any other (Delta between 2 and 47 000)."""
    run = solve(study(EA), Ask(duration=1.0, segments=40, method=method, step=1e-3))
    assert not run.trusted
    assert run.message


# ------------------------------------------------------------------------------------------- nonsense in, Status out


@pytest.mark.parametrize("method", ["rk4", "dopri5", "genalpha", "trbdf2"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e200])
def test_a_state_that_is_not_a_number_ends_with_a_status(method, bad):
    """NaN, infinity and numbers whose cube overflows never end as OK and never hang."""
    pack = oscillator(k3=1.0)
    out, s = make_output(np.array([0.0, 1.0]), 1, 0), make_ends(1)
    s.q[0], s.v[0] = bad, 0.0
    pieces = np.array([0.0, 1.0])
    limits = (1e-2, 1e-6, 0.1, 1e-12, 1e-12, 10_000)
    if method in TABLES:
        work = explicit.make_work(TABLES[method], 1, 0)
        limits = limits if method == "dopri5" else (1e-2, 0.0, *limits[2:])
        code = explicit.march(pack, s, out, work, pieces, TABLES[method], *limits[:4], NO_GAPS, *limits[4:])
    elif method == "trbdf2":
        code = implicit.tr_bdf2(pack, s, out, implicit.make_work(1, 0), pieces, *limits)
    else:
        code = implicit.generalised_alpha(pack, s, out, implicit.make_work(1, 0), pieces, 1e-2, 0.8, 1e-12, 10_000)
    assert Status(code) not in (Status.OK, Status.TOO_MANY_STEPS)


EXTREMES = {
    "a step of an hour": ({}, {"method": "rk4", "step": 3600.0, "duration": 7200.0, "interval": 3600.0}),
    "genalpha over hours": ({}, {"method": "genalpha", "step": 3600.0, "duration": 7200.0, "interval": 3600.0}),
    "stiff as nothing else": ({"EA": 1e18}, {"method": "dopri5", "max_steps": 2000}),
    "soft as nothing else": ({"EA": 1e-6}, {"method": "dopri5", "max_steps": 2000}),
    "light": ({"mass": 1e-12, "Can": 0.0}, {"method": "dopri5", "max_steps": 2000}),
    "thick drag": ({"Cdn": 1e12}, {"method": "dopri5", "max_steps": 2000}),
    "overdamped": ({"BA": 1e15}, {"method": "dopri5", "max_steps": 2000}),
    "overdamped, implicit": ({"BA": 1e15}, {"method": "trbdf2", "max_steps": 500}),
    "bending of a girder": ({"EI": 1e15}, {"method": "trbdf2", "max_steps": 500}),
    "no budget": ({}, {"method": "dopri5", "max_steps": 3}),
    "one segment": ({}, {"method": "dopri5", "segments": 1}),
    "duration between samples": ({}, {"method": "dopri5", "duration": 0.0105}),
}


@pytest.mark.parametrize("name", EXTREMES)
def test_extreme_inputs_end_with_a_status(name):
    """Whatever goes wrong in a run is a Status with a remedy, never an exception, a hang or a NaN that passes as OK."""
    section, ask = EXTREMES[name]
    given = {"length": 10.0, "d": 0.05, "mass": 3.0, "EA": 1e6, **section}
    motion = Motion(harmonics=(Harmonic(amplitude=(0.1, 0, 0), frequency=1.0),))
    scene = Scene(
        cable=(Section(**given),), water=Water(), end_a=End(kind="pinned", position=(0, 0, -20)),
        end_b=End(kind="pinned", position=(5, 0, -12), motion=motion),
    )  # fmt: skip
    run = solve(scene, Ask(**{"duration": 0.01, "segments": 10, **ask}))
    assert isinstance(run.status, Status)
    if run.status == Status.OK:
        assert np.isfinite(run.signals["position"]).all()
    else:
        assert run.message


def test_a_duration_between_output_times_is_not_a_failure():
    """10.6 ms sampled every 1 ms: the samples that fit, Status OK."""
    scene = taut(1e3)
    for duration in (0.0104, 0.0106):
        run = solve(scene, Ask(duration=duration, segments=10, method="dopri5", perturbation=1e-3))
        assert run.status == Status.OK, run.message
        assert len(run.t) in (11, 12)
