"""The brink of every method on both sides: theory against closed forms, and runs at 0.95 and 1.05 of the limit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from brink_kit import LINES, L, N, h, taut

from solvers import BNES, Ask, End, Response, Scene, Section, Status, brink, solve
from solvers.catalogue import Limits, marched, static_state
from solvers.lines.lumped import LumpedModel
from solvers.lines.transverse import TransverseModel
from solvers.model import REMEDY

# ------------------------------------------------------------------------------------------- stability functions


@pytest.mark.parametrize(
    ("method", "real", "imaginary"),
    [("rk2", 2.0, 0.0), ("rk4", 2.7853, 2.8284), ("dopri5", 3.3066, None), ("trbdf2", math.inf, math.inf),
     ("esdirk4", math.inf, math.inf), ("srkn4", None, 3.1634)],
)
def test_limits_on_the_axes(method, real, imaginary):
    """Hairer & Wanner, IV.2, to the digits given; Heun's rule has none on the imaginary axis: what rounding leaves."""
    if real is not None:
        assert brink.stable_step(method, np.array([-10.0 + 0j])) * 10 == pytest.approx(real, rel=1e-4)
    if imaginary is not None:
        found = brink.stable_step(method, np.array([10j, -10j])) * 10
        assert found == pytest.approx(imaginary, rel=1e-4, abs=0.05 if method == "rk2" else None)


def test_growth_of_heun():
    """|R(iy)|^2 = 1 + y^4/4, so that a factor e over a time T is reached at h = (8/(T w^4))^(1/3), as h w -> 0."""
    y = np.array([0.1, 0.5, 1.0])
    np.testing.assert_allclose(brink.amplification("rk2", 1j * y) ** 2, 1 + y**4 / 4, rtol=1e-12)
    found = brink.stable_step("rk2", np.array([10j]), duration=100.0)
    assert found == pytest.approx((8 / (100 * 10.0**4)) ** (1 / 3), rel=0.01)


@pytest.mark.parametrize(("method", "limit"), [("rk2", 0.764), ("rk4", 1.064)])
def test_damping_beyond_critical(method, limit):
    """zeta = 1.5: rates -0.382 and -2.618, of which the faster cuts the limit; three digits are given."""
    assert brink.stable_step(method, np.array([-0.381966 + 0j, -2.618034 + 0j])) == pytest.approx(limit, abs=5e-4)


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.5, 0.0])
def test_generalised_alpha_has_no_limit(rho):
    """|R| <= 1 in the whole left half plane and rho at infinity; rho = 1 is 1 on all of the imaginary axis."""
    angle = np.linspace(0.5, 1.0, 21) * math.pi
    z = np.geomspace(1e-3, 1e6, 60)[:, None] * np.exp(1j * angle)
    assert brink.amplification("genalpha", z, rho).max() < 1 + 1e-9
    far = brink.amplification("genalpha", np.array([-1e9 + 0j]), rho)
    assert far == pytest.approx(rho, abs=1e-3)
    if rho == 1:
        np.testing.assert_allclose(brink.amplification("genalpha", 1j * np.geomspace(0.1, 1e4, 9), 1.0), 1.0, rtol=1e-9)
    assert brink.stable_step("genalpha", np.array([1e3j, -1e3 + 0j]), rho) == math.inf


@pytest.mark.parametrize("name", LINES)
def test_eigenvalues_of_a_line(name):
    """The largest frequency of the linearised line is that of the lattice: 1e-9; of the device, which is not alone but
    on a string, 1e-3. `fastest`, a bound, is at most 2 % above."""
    scene, omega = LINES[name]
    model = LumpedModel(scene, N)
    _, rest, _ = static_state(model)
    lam = brink.rates(model, rest)
    assert np.abs(lam).max() == pytest.approx(omega, rel=1e-3 if name == "device" else 1e-9)
    assert np.abs(lam.real).max() < 1e-6 * omega
    assert omega * (1 - 1e-3) <= max(model.fastest(rest).values()) < 1.02 * omega


def test_a_cord_counts_though_it_only_touches():
    """Tension-only cords at rest are not yet taut: their wall is in the eigenvalues all the same, and it is
    sqrt(2 k (1/M + 1/m_h)) sin(phi0), 1 %: the cable's own stiffness is 1e-3 of the wall's."""
    sink = BNES(s=5.0, mass=1.0, EA=1e6, phi0=10.0, law="cords")
    scene = taut(100.0, EA=1e3, devices=(sink,))
    model = LumpedModel(scene, N)
    _, rest, _ = static_state(model)
    omega = math.sqrt(2 * 2e6 * (1 / 1.0 + 1 / (2.0 * h))) * math.sin(math.radians(10.0))
    assert np.abs(brink.eigenvalues(model.pack, brink.taut(model, rest))).max() == pytest.approx(omega, rel=0.01)
    assert np.abs(brink.rates(model, rest)).max() == pytest.approx(omega, rel=0.01)


# ------------------------------------------------------------------------------------------- runs at the brink

STEPS = 2500
SPRINGS = BNES(s=5.0, mass=1.0, EA=1e6, BA=150.0, phi0=10.0, law="springs")
DAMPED = {  # what gives Heun's rule a limit: a few per cent of critical damping at the top, or more than critical
    "axial": taut(100.0, BA=11.0),
    "bending": taut(0.0, EI=1e5, BI=3.0, BA=11.0, compression=True),
    "device": taut(100.0, EA=1e3, BA=5.0, devices=(SPRINGS,)),
    "decay": taut(100.0, BA=700.0),
}
UNDAMPED = {name: scene for name, (scene, _) in LINES.items()}
CASES = [
    *(("rk4", name, scene) for name, scene in UNDAMPED.items()),
    *((method, f"{name}, damped", scene) for method in ("rk2", "rk4") for name, scene in DAMPED.items()),
]


def shaken(scene: Scene, method: str, step: float, steps: int = STEPS, **ask) -> Response:
    """From rest with random velocities of 1e-6 m/s, small enough for nothing to be nonlinear."""
    wanted = Ask(
        duration=steps * step, interval=steps * step / 100, segments=N, method=method, step=step, perturbation=1e-6,
    )  # fmt: skip
    return solve(scene, replace(wanted, **ask))


def limit_of(scene: Scene, method: str) -> float:
    model = LumpedModel(scene, N)
    _, rest, _ = static_state(model)
    lam = brink.rates(model, rest)
    rough = math.sqrt(8) / np.abs(lam).max()
    return brink.stable_step(method, lam, duration=STEPS * rough)


@pytest.mark.parametrize(("method", "name", "scene"), CASES, ids=[f"{m}-{n}" for m, n, _ in CASES])
def test_both_sides_of_the_limit(method, name, scene):
    """2500 steps. At 0.95 of the limit the energy never rises above a factor e^2 of the start, Heun's allowance for
    what nothing damps. At 1.05 it grows by 1e6 or to infinity, and the run ends with a Status and its remedy.

    That the calm run may say COARSE_STEP or ENERGY_OPEN is right: it is stable, not accurate in its highest modes.
    """
    limit = limit_of(scene, method)
    assert 0 < limit < math.inf
    calm = shaken(scene, method, 0.95 * limit)
    kinetic = calm.signals["kinetic"]
    assert len(kinetic) == 101
    assert kinetic.max() < math.e**2 * kinetic[0]
    assert calm.status in (Status.OK, Status.COARSE_STEP, Status.ENERGY_OPEN), calm.message
    wild = shaken(scene, method, 1.05 * limit)
    assert wild.status in (Status.DIVERGED, Status.ENERGY_OPEN), wild.message
    assert REMEDY[wild.status] in wild.message
    assert wild.status == Status.DIVERGED or wild.signals["kinetic"].max() > 1e6 * kinetic[0]


@pytest.mark.parametrize("name", [name for name in UNDAMPED if name != "device"])  # which shortens steps itself
def test_both_sides_of_the_symplectic_limit(name):
    """As above. Its first limit, 3.163, is a window of 0.005 in which few modes lie and grow slowly; a line is lost
    beyond 5.03, where the highest mode grows by more than two in a step."""
    limit = limit_of(UNDAMPED[name], "srkn4")
    calm = shaken(UNDAMPED[name], "srkn4", 0.95 * limit)
    assert calm.signals["kinetic"].max() < math.e**2 * calm.signals["kinetic"][0]
    wild = shaken(UNDAMPED[name], "srkn4", 1.05 * 5.04 / 3.1634 * limit)
    assert wild.status in (Status.DIVERGED, Status.ENERGY_OPEN), wild.message
    assert REMEDY[wild.status] in wild.message


@pytest.mark.parametrize("method", ["rk4", "srkn4"])
def test_both_sides_of_the_limit_with_scaled_masses(method):
    """A wave of four spans has the highest frequency left, (2 pi/4h)^2 sqrt(EI/m): in closed form, and 5.7 times longer
    steps than without. Below the limit calm, above it lost, as above."""
    scene = taut(0.0, EI=1e5, compression=True)
    line = {"model": "transverse", "mass_scaling": 4.0}
    model = TransverseModel(scene, N, 4.0)
    limit = (2.8284 if method == "rk4" else 3.1634) / ((math.pi / 2 / h) ** 2 * math.sqrt(1e5 / 2.0))
    assert brink.stable_step(method, brink.rates(model, model.rest)) == pytest.approx(limit, rel=2e-4)
    assert limit * TransverseModel(scene, N).spectrum()[-1] > 5.7 * (2.8284 if method == "rk4" else 3.1634)
    calm = shaken(scene, method, 0.95 * limit, **line)
    assert calm.signals["kinetic"].max() < math.e**2 * calm.signals["kinetic"][0]
    wild = shaken(scene, method, 1.05 * limit * (1.0 if method == "rk4" else 5.04 / 3.1634), **line)
    assert wild.status in (Status.DIVERGED, Status.ENERGY_OPEN), wild.message
    assert REMEDY[wild.status] in wild.message


@pytest.mark.parametrize("name", UNDAMPED)
def test_dormand_prince_at_a_fixed_step(name):
    """The pair's limit on the imaginary axis is 1.0, far below rk4's, for R(iy) leaves the unit circle there by little:
    over 2500 steps the limit is where the growth is e. What `march` is given when the error control is off."""
    model = LumpedModel(UNDAMPED[name], N)
    _, rest, _ = static_state(model)
    lam = brink.rates(model, rest)
    found = []
    for share in (0.95, 1.3):
        step = share * brink.stable_step("dopri5", lam, duration=STEPS / np.abs(lam).max())
        stop = STEPS * step
        v = 1e-6 * np.random.default_rng(0).standard_normal(model.ndof)
        limits = Limits(step, 0.0, 1.0, 0.0, np.full(model.n_gaps, math.inf), 1e-12)
        ask = Ask(duration=stop, method="dopri5")
        run = marched(model, ask, "dopri5", limits, rest, v, np.array([0.0, stop]), np.linspace(0, stop, 101))
        found.append(float(np.nanmax(run.out.ledger[:, 0])) if run.code == Status.OK else math.inf)
        start = float(run.out.ledger[0, 0])
    assert found[0] < math.e**2 * start
    assert found[1] > 1e3 * start


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.0])
@pytest.mark.parametrize("name", ["axial", "bending", "device"])
def test_generalised_alpha_far_beyond(name, rho):
    """A hundred times the limit of rk4: 2500 steps without growth. Stable is not accurate, and the run says so."""
    scene, omega = LINES[name]
    run = shaken(scene, "genalpha", 100 * math.sqrt(8) / omega, rho=rho)
    kinetic = run.signals["kinetic"]
    assert len(kinetic) == 101
    assert kinetic.max() <= kinetic[0] * (1 + 1e-6)
    assert run.status in (Status.COARSE_STEP, Status.ENERGY_OPEN), run.message
    assert REMEDY[run.status] in run.message


def test_the_limit_of_a_sagging_clamped_line():
    """No closed form: eigenvalues about a static state that is neither straight nor of one tension."""
    cable = Section(length=L, d=0.05, mass=2.0, EA=1e5, EI=100.0, BA=5.0, wet_weight=20.0)
    ends = (End(kind="clamped", position=(0, 0, 0), direction=(1, 0, -0.5)),
            End(kind="clamped", position=(9, 0, 1), direction=(1, 0, 0.5)))  # fmt: skip
    scene = Scene(cable=(cable,), end_a=ends[0], end_b=ends[1])
    limit = limit_of(scene, "rk4")
    calm, wild = (shaken(scene, "rk4", share * limit) for share in (0.95, 1.05))
    assert calm.signals["kinetic"].max() < math.e**2 * calm.signals["kinetic"][0]
    assert wild.status in (Status.DIVERGED, Status.ENERGY_OPEN)
