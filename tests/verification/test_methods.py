"""Time methods: identities of their tables, order, stability at infinity, breaks; plane against space."""

from __future__ import annotations

import math

import numpy as np
import pytest
from march_kit import TABLES, march_oscillator

from solvers import (
    BNES,
    Ask,
    Current,
    End,
    Harmonic,
    Motion,
    PointMass,
    Scene,
    Seabed,
    Section,
    Status,
    Water,
    Window,
    solve,
)
from solvers.lines.oscillator import cubic_device, oscillator

# ------------------------------------------------------------------------------------------- tables


def trees(A: np.ndarray, c: np.ndarray) -> dict[int, list[tuple[np.ndarray, float]]]:
    """Order conditions sum b_i phi_i = 1/gamma by order (Hairer, Norsett & Wanner, II.2): all 17 trees to order 5."""
    one = np.ones_like(c)
    return {
        1: [(one, 1)],
        2: [(c, 2)],
        3: [(c**2, 3), (A @ c, 6)],
        4: [(c**3, 4), (c * (A @ c), 8), (A @ c**2, 12), (A @ (A @ c), 24)],
        5: [
            (c**4, 5), (c**2 * (A @ c), 10), ((A @ c) ** 2, 20), (c * (A @ c**2), 15), (A @ c**3, 20),
            (c * (A @ (A @ c)), 30), (A @ (c * (A @ c)), 40), (A @ (A @ c**2), 60), (A @ (A @ (A @ c)), 120),
        ],
    }  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_table_identities(name):
    """Row sums, explicitness, first-same-as-last, and every order condition up to the order: to rounding."""
    table = TABLES[name]
    A, c, e = table.A, table.c, table.e
    b = A[-1]
    assert np.all(np.triu(A) == 0)
    np.testing.assert_allclose(A.sum(axis=1), c, atol=1e-15)
    assert c[-1] == pytest.approx(1.0, abs=1e-15)
    conditions = trees(A, c)
    for order in range(1, table.order + 1):
        for phi, gamma in conditions[order]:
            assert b @ phi == pytest.approx(1 / gamma, abs=2e-14)  # tsit5 is printed to 16 digits
    if table.order < 5:
        assert any(abs(b @ phi - 1 / gamma) > 1e-3 for phi, gamma in conditions[table.order + 1])
    if name in ("dopri5", "tsit5"):  # the embedded formula is of order 4 and no more
        b_hat = b - e
        for order in range(1, 5):
            for phi, gamma in conditions[order]:
                assert b_hat @ phi == pytest.approx(1 / gamma, abs=2e-14)
        assert max(abs(b_hat @ phi - 1 / gamma) for phi, gamma in conditions[5]) > 1e-5
    else:
        assert not e.any()


# ------------------------------------------------------------------------------------------- order

NONLINEAR = oscillator(c=0.1, k3=0.7, force=((0.4, 1.7, 0.3),), devices=(cubic_device(0.3, 0.8, 0.05),))
SPAN = np.array([0.0, 4.0])


def end(method: str, **settings) -> np.ndarray:
    run = march_oscillator(NONLINEAR, [0.6, -0.2], [0.1, 0.4], SPAN, method, **settings)
    assert run.status == Status.OK
    return np.concatenate([run.q[-1], run.v[-1]])


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    return end("dopri5", step=4 / 3000)


@pytest.mark.parametrize(
    ("method", "order", "steps", "settings"),
    [
        ("rk2", 2, (200, 400, 800), {}),
        ("rk4", 4, (50, 100, 200), {}),
        ("dopri5", 5, (30, 60, 120), {}),
        ("srkn4", 4, (40, 80, 160), {}),
        ("genalpha", 2, (200, 400, 800), {"rho": 1.0}),
        ("genalpha", 2, (200, 400, 800), {"rho": 0.5}),
        ("genalpha", 2, (200, 400, 800), {"rho": 0.0}),
    ],
)
def test_order_of_a_fixed_step(method, order, steps, settings, exact):
    """Halving the step of a smooth forced nonlinear problem: the error falls by 2^order, +-0.2 before the limit."""
    errors = [np.abs(end(method, step=4 / n, **settings) - exact).max() for n in steps]
    observed = np.log2(errors[-2] / errors[-1])
    assert observed == pytest.approx(order, abs=0.2)


def test_order_of_tsit5(exact):
    """Over four halvings, +-0.2: terms of order 5 and 6 cancel near 50 steps here, where single slopes mean nothing."""
    first, last = (np.abs(end("tsit5", step=4 / n) - exact).max() for n in (30, 480))
    assert np.log2(first / last) / 4 == pytest.approx(5, abs=0.2)


@pytest.mark.parametrize(
    ("method", "order", "tolerances", "least"),
    [("dopri5", 5, (1e-8, 1e-11), 1e-10), ("trbdf2", 2, (1e-4, 1e-8), 1e-5)],
)
def test_order_of_an_adaptive_method(method, order, tolerances, least, exact):
    """Error against the number of steps between two tolerances; +-20 %, for steps are chosen, not halved."""
    found = []
    for tol in tolerances:
        run = march_oscillator(NONLINEAR, [0.6, -0.2], [0.1, 0.4], SPAN, method, tol=tol)
        found.append((run.steps, np.abs(np.concatenate([run.q[-1], run.v[-1]]) - exact).max()))
    (n0, e0), (n1, e1) = found
    assert math.log(e0 / e1) / math.log(n1 / n0) == pytest.approx(order, rel=0.2)
    assert e1 < least


# ------------------------------------------------------------------------------------------- linear behaviour


@pytest.mark.parametrize(("rho", "error"), [(1.0, -8.3e-4), (0.5, -1.1e-3), (0.0, -3.3e-3)])
def test_frequency_error_of_generalised_alpha(rho, error):
    """At omega dt = 0.1; two digits are given, so 5 %. For rho = 1 it is -(omega dt)^2/12, the trapezoidal rule."""
    n = 4000
    run = march_oscillator(oscillator(), [1.0], [0.0], np.arange(n + 1) * 0.1, "genalpha", step=0.1, rho=rho)
    angle = np.unwrap(np.arctan2(-run.v[:, 0], run.q[:, 0]))
    slope = np.polyfit(run.t, angle, 1)[0]
    assert slope - 1 == pytest.approx(error, rel=0.05)
    size = np.hypot(run.q[-1, 0], run.v[-1, 0])
    if rho == 1.0:
        assert size == pytest.approx(1.0, abs=1e-9)  # it neither damps nor grows
    else:
        assert size < 1.0


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.5, 0.0])
def test_spectral_radius_at_infinity(rho):
    """omega dt = 1e6: velocities shrink by rho a step, with alternating sign (rho = 1: a sawtooth for ever).

    The root at infinity is double, so n rho^n: the ratio at n is rho (1 + 1/n); rho = 0 is gone after some steps.
    """
    n = 30
    run = march_oscillator(oscillator(k1=1e12), [1.0], [0.0], np.arange(n + 1.0), "genalpha", step=1.0, rho=rho)
    assert run.status == Status.OK
    q = run.q[:, 0]
    if rho == 0.0:
        assert np.abs(q[4:]).max() < 1e-6
        return
    ratio = q[n] / q[n - 1]
    assert -ratio == pytest.approx(rho, rel=1.5 / n)
    assert np.all(q[1:-1] * q[2:] < 0)


def test_tr_bdf2_is_l_stable():
    """One step of 1 s on omega = 1e3, 1e4, 1e5 rad/s: what is left falls as 1/(omega dt)^2; trapezoid leaves it all."""
    left = []
    for omega in (1e3, 1e4, 1e5):
        pack = oscillator(k1=omega**2)
        run = march_oscillator(pack, [1.0], [0.0], np.array([0.0, 1.0]), "trbdf2", step=1.0, tol=1e9)
        assert run.steps == 1
        left.append(abs(run.q[-1, 0]))
        trapezoid = march_oscillator(pack, [1.0], [0.0], np.array([0.0, 1.0]), "genalpha", step=1.0, rho=1.0)
        assert abs(trapezoid.q[-1, 0]) == pytest.approx(1.0, rel=1e-3)
    assert left[0] < 1e-4
    np.testing.assert_allclose([left[1] / left[0], left[2] / left[1]], 1e-2, rtol=0.01)


@pytest.mark.parametrize("z", [0.1, 0.5])
def test_rk2_has_no_stable_step_on_an_oscillation(z):
    """|R(iz)|^2 = 1 + z^4/4 for every second-order Runge-Kutta method of two stages: exact energy growth."""
    n = 200
    run = march_oscillator(oscillator(), [1.0], [0.0], np.arange(n + 1) * z, "rk2", step=z)
    energy = run.ledger[:, :3].sum(axis=1)
    assert energy[-1] / energy[0] == pytest.approx((1 + z**4 / 4) ** n, rel=1e-9)


# ------------------------------------------------------------------------------------------- breaks


def string(motion: Motion) -> Scene:
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=2e4, wet_weight=0.0)
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, 0)),
        end_b=End(kind="pinned", position=(0, 0, 11), motion=motion),
    )  # fmt: skip


def test_steps_land_on_breaks_of_the_motion():
    """A velocity that jumps at t = 0 and at 0.1234567 s, a step that fits neither: RK4 keeps its order 4.

    A step across the jump would leave an error of order 1. The energy that the jump puts in is booked as work.
    """
    motion = Motion(harmonics=(Harmonic(amplitude=(0.05, 0, 0), frequency=3.0),), window=Window(stop=0.1234567))
    settings = {"duration": 0.4, "segments": 10, "interval": 0.4}
    best = solve(string(motion), Ask(method="rk4", step=1.25e-4, **settings))
    errors = []
    for step in (4e-3, 2e-3, 1e-3):
        run = solve(string(motion), Ask(method="rk4", step=step, **settings))
        assert run.energy_residual < 1e-3, run.message
        errors.append(np.abs(run.signals["position"][-1] - best.signals["position"][-1]).max())
    order = math.log2(errors[-2] / errors[-1])
    assert order == pytest.approx(4.0, abs=0.4)
    assert best.signals["position"][-1, -1, 0] == 0.0  # home again, exactly


def test_output_does_not_depend_on_the_grid():
    """Steps are chosen by error, not by the output: samples at common times are the same to the last bit."""
    motion = Motion(harmonics=(Harmonic(amplitude=(0.05, 0, 0), frequency=3.0),))
    fine, coarse = (
        solve(string(motion), Ask(method="dopri5", duration=0.3, segments=10, interval=dt)) for dt in (1e-3, 0.1)
    )
    assert fine.cost.steps == coarse.cost.steps
    np.testing.assert_array_equal(fine.signals["position"][::100], coarse.signals["position"])


# ------------------------------------------------------------------------------------------- plane and space


def mooring(turn: float = 0.0, out_of_plane: float = 0.0) -> Scene:
    """A line with everything in it, in a vertical plane turned about z; a current across it makes it spatial."""
    x, y = math.cos(turn), math.sin(turn)
    cable = Section(
        length=30.0, d=0.08, mass=9.0, EA=2e5, EI=50.0, BA=200.0, BI=2.0, Can=0.9, Cat=0.3, Cdn=1.1, Cdt=0.05
    )
    stream = ((0.1 * x, 0.1 * y, 0.0), (0.5 * x - out_of_plane * y, 0.5 * y + out_of_plane * x, 0.0))
    sway = Harmonic(amplitude=(0.5 * x, 0.5 * y, 0.3), frequency=0.4)
    return Scene(
        cable=(cable,), end_a=End(kind="pinned", position=(0, 0, -10)),
        end_b=End(kind="clamped", position=(24 * x, 24 * y, -2), direction=(x, y, 1),
                  motion=Motion(harmonics=(sway,), window=Window(ramp_up=1.0))),
        water=Water(depth=10.0, current=Current(z=(-10, 0), velocity=stream)),
        seabed=Seabed(z=-10.0, stiffness=1e4, damping=300.0, friction=0.5, friction_speed=0.1),
        devices=(
            BNES(s=14.0, mass=3.0, EA=2e4, BA=10.0, rod=0.9, direction=(0, 0, 1), drag=0.05, volume=1e-3),
            PointMass(s=19.0, mass=4.0, volume=1e-3, drag=0.1),
            BNES(kind="bnes_free", s=24.0, mass=2.0, EA=2e4, BA=10.0, direction=(x, y, 0)),
        ),
    )  # fmt: skip


@pytest.mark.parametrize(("method", "settings"), [("rk4", {"step": 5e-4}), ("genalpha", {"step": 2e-3})])
def test_plane_equals_space(method, settings):
    """The same scene in two coordinates and in three (a current of 1e-9 m/s across it): same motion to 1e-6 m."""
    ask = Ask(duration=2.0, segments=20, interval=0.05, method=method, **settings)
    plane, space = solve(mooring(), ask), solve(mooring(out_of_plane=1e-9), ask)
    assert len(plane.t) == len(space.t) == 41, (plane.message, space.message)
    for name, size in (("position", 1.0), ("velocity", 1.0), ("stroke", 1.0), ("tension", 1e4), ("kinetic", 100.0)):
        np.testing.assert_allclose(plane.signals[name], space.signals[name], atol=1e-6 * size, err_msg=name)
    np.testing.assert_allclose(plane.signals["end_force"], space.signals["end_force"], atol=1e-2)


def test_nothing_depends_on_the_azimuth():
    """The plane turned by 37 degrees: tensions to rounding, positions turn with it."""
    ask = Ask(duration=1.0, segments=20, interval=0.05, method="rk4", step=5e-4)
    angle = math.radians(37.0)
    here, there = solve(mooring(), ask), solve(mooring(angle), ask)
    c, s = math.cos(angle), math.sin(angle)
    turned = here.signals["position"] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(there.signals["position"], turned, atol=1e-8)
    np.testing.assert_allclose(there.signals["tension"], here.signals["tension"], atol=1e-4)
