"""The reference solutions against published digits, and against a second way of solving each."""

from __future__ import annotations

import math

import numpy as np
import pytest
from elastica import (
    END_FORCE,
    LENGTH,
    STIFFNESS,
    WEIGHT,
    boundary_layer,
    cantilever,
    folded_chain,
    greenhill,
    heavy_cantilever,
    helix,
    hybrid_suspension,
    internal_force,
    irvine,
    suspension,
)
from numpy.polynomial import chebyshev
from scipy.integrate import quad, simpson, solve_bvp, solve_ivp
from scipy.linalg import eig, expm

HALF = 0.5001  # half a unit of the last digit given


@pytest.mark.parametrize(
    ("alpha", "tip"),
    [
        (0.2, (0.06636448, 0.00264655, 0.09963616)),
        (1.0, (0.30172077, 0.05643324, 0.46135195)),
        (2.0, (0.49345748, 0.16064172, 0.78174983)),
        (10.0, (0.81060902, 0.55499560, 1.43028554)),
    ],
)
def test_cantilever_digits(alpha: float, tip: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(cantilever(alpha), tip, rtol=0, atol=HALF * 1e-8)


@pytest.mark.parametrize("alpha", [1e-2, 3.0, 30.0])
def test_cantilever_satisfies_its_equation(alpha: float) -> None:
    """Integrated from the free end with the slope found: level at the clamp, with the same drop and shortening."""
    tip = cantilever(alpha)
    path = solve_ivp(
        lambda s, y: [y[1], -alpha * math.cos(y[0]), math.sin(y[0]), math.cos(y[0])],
        (0.0, 1.0),
        [tip.slope, 0.0, 0.0, 0.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    )
    np.testing.assert_allclose(path.y[[0, 2, 3], -1], [0.0, tip.drop, 1 - tip.shortening], rtol=0, atol=1e-10)


def test_heavy_cantilever_digits() -> None:
    found = [heavy_cantilever(q) for q in (1.0, 5.0, 10.0, 50.0)]
    np.testing.assert_allclose(found, [0.1234714, 0.4959050, 0.7001997, 0.9079171], rtol=0, atol=HALF * 1e-7)
    assert heavy_cantilever(1e-3) == pytest.approx(1e-3 / 8, rel=1e-6)  # the linear beam's q / 8


def test_heavy_cantilever_by_collocation() -> None:
    """The boundary-value problem, continued in q from the straight rod."""
    s, y = np.linspace(0, 1, 21), np.zeros((3, 21))
    for q in (1.0, 3.0, 5.0, 10.0, 20.0):
        found = solve_bvp(
            lambda s, y, q=q: np.stack([y[1], -q * (1 - s) * np.cos(y[0]), np.sin(y[0])]),
            lambda a, b: np.array([a[0], b[1], a[2]]),
            s,
            y,
            tol=1e-9,
            max_nodes=20_000,
        )
        assert found.success
        s, y = found.x, found.y
        assert heavy_cantilever(q) == pytest.approx(y[2, -1], abs=1e-9)


def test_suspension_digits() -> None:
    line = suspension()
    at, sag = line.lowest()
    assert (line.x[-1], sag) == pytest.approx((1.761849, 0.401365), abs=HALF * 1e-6)
    assert at == pytest.approx(0.8765, abs=HALF * 1e-4)
    assert line.tension[0] == pytest.approx(8.301873e-3, abs=HALF * 1e-9)
    assert line.moment[-1] == pytest.approx(-2.015395e-3, abs=HALF * 1e-9)
    assert line.moment.max() == pytest.approx(3.2560e-4, abs=HALF * 1e-8)
    assert line.shear[-1] == pytest.approx(0.01, abs=1e-12)
    assert line.tension[-1] == pytest.approx(0.0, abs=1e-12)
    assert (line.moment[0], line.kink) == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("EI_scale", [0.1, 1.0, 30.0])
def test_suspension_in_equilibrium(EI_scale: float) -> None:
    """Moments of the whole line about the pin, and dM/ds = -shear between the points."""
    line = suspension(EI_scale)
    weight = WEIGHT * simpson(line.x, x=line.s)
    whole = line.moment[-1] + line.x[-1] * END_FORCE[1] - line.z[-1] * END_FORCE[0] - weight
    assert whole == pytest.approx(0.0, abs=1e-9 * weight)
    step = line.s[2] - line.s[0]
    np.testing.assert_allclose(np.diff(line.moment[::2]), -step / 6 * simpson_sums(line.shear), rtol=0, atol=1e-11)


def simpson_sums(y: np.ndarray) -> np.ndarray:
    """Simpson's rule times 6 over the step, over each two intervals of y (odd number of points)."""
    return y[:-2:2] + 4 * y[1:-1:2] + y[2::2]


def test_suspension_by_shooting() -> None:
    """Integrated from the pin with the angle found there. The far end multiplies an error there by about 1e5."""
    line = suspension()

    def slope(s: float, y: np.ndarray) -> list[float]:
        fx, fz = internal_force(np.array(s))
        c, n = math.cos(y[0]), math.sin(y[0])
        return [y[1], (fx * n - fz * c) / STIFFNESS, c, n]

    path = solve_ivp(slope, (0, LENGTH), [line.theta[0], 0, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13)
    end = [line.theta[-1], line.moment[-1] / STIFFNESS, line.x[-1], line.z[-1]]
    np.testing.assert_allclose(path.y[:, -1], end, rtol=0, atol=1e-5)


def test_hybrid_suspension() -> None:
    """A hinge beyond the lowest point leaves the catenary's sag, 9.34 % too large, wherever it is."""
    rod = suspension()
    sag, moment = rod.lowest()[1], rod.moment[-1]
    lines = {joint: hybrid_suspension(joint) for joint in (1.0, 1.25, 1.5, 1.75)}
    for joint, line in lines.items():
        assert 100 * (line.lowest()[1] / sag - 1) == pytest.approx(9.345, abs=HALF * 1e-3)
        at = np.flatnonzero(line.s == joint)
        assert len(at) == 2
        assert line.theta[at[1]] - line.theta[at[0]] == pytest.approx(line.kink, abs=1e-14)
        np.testing.assert_allclose(line.moment[: at[1] + 1], 0.0, atol=1e-14)
        np.testing.assert_allclose(line.shear[: at[0] + 1], 0.0, atol=1e-14)
        np.testing.assert_allclose(np.hypot(line.tension, line.shear), np.hypot(*internal_force(line.s)), rtol=1e-12)
        for part in (slice(None, at[1]), slice(at[1], None)):
            s, x, z, theta = line.s[part], line.x[part], line.z[part], line.theta[part]
            run = [simpson(np.cos(theta), x=s), simpson(np.sin(theta), x=s)]
            np.testing.assert_allclose([x[-1] - x[0], z[-1] - z[0]], run, rtol=0, atol=1e-9)
    assert 100 * (lines[1.5].moment[-1] / moment - 1) == pytest.approx(0.6, abs=HALF * 0.1)
    assert 100 * (lines[1.75].moment[-1] / moment - 1) == pytest.approx(-9.5, abs=HALF * 0.1)
    assert math.degrees(lines[1.75].kink) == pytest.approx(-37, abs=HALF)


def buckling_torques(T: float, kind: str, n: int = 28) -> np.ndarray:
    """Positive torques (rising) of EI y'''' - i M y''' - T y'' = 0 with EI = L = 1, in Chebyshev's T_0..T_n."""
    x = chebyshev.chebpts1(n - 3)

    def rows(order: int, at: np.ndarray) -> np.ndarray:
        """Derivatives of T_0..T_n over the unit length at points of [-1, 1]."""
        return chebyshev.chebval(at, 2**order * chebyshev.chebder(np.eye(n + 1), order)).T

    ends = np.array([-1.0, 1.0])
    second, twist = {
        "clamped": (rows(1, ends), np.zeros((2, n + 1))),
        "axial": (rows(2, ends), 1j * rows(1, ends)),
        "tangential": (rows(2, ends), np.zeros((2, n + 1))),
    }[kind]
    left = np.concatenate([rows(4, x) - T * rows(2, x), rows(0, ends), second])
    right = np.concatenate([1j * rows(3, x), np.zeros((2, n + 1)), twist])
    with np.errstate(all="ignore"):
        M = eig(left, right, right=False)
    M = M[np.isfinite(M) & (np.abs(M) < 100)]
    return np.sort(M.real[(np.abs(M.imag) < 1e-5) & (M.real > 1e-3)])


@pytest.mark.parametrize("T", [-30.0, -8.0, -1.0, 0.0, 1e-3, 4.999, 5.001, 60.0, 300.0])
def test_greenhill_clamped(T: float) -> None:
    assert greenhill(T, 1.0, 1.0, "clamped") == pytest.approx(buckling_torques(T, "clamped")[0], rel=1e-7)


@pytest.mark.parametrize("kind", ["axial", "tangential"])
@pytest.mark.parametrize("T", [-8.0, -1.0, 1e-3, 60.0])
def test_greenhill_pinned(T: float, kind: str) -> None:
    """Both directions of the torque at the ends give Greenhill's value."""
    assert greenhill(T, 1.0, 1.0, "pinned") == pytest.approx(buckling_torques(T, kind)[0], rel=1e-7)


def test_greenhill_digits_and_units() -> None:
    assert greenhill(0.0, 1.0, 1.0, "clamped") == pytest.approx(8.9868, abs=HALF * 1e-4)
    assert greenhill(0.0, 1.0, 1.0, "pinned") == pytest.approx(2 * math.pi, rel=1e-14)
    assert greenhill(7.0 * 3 / 4, 3.0, 2.0, "clamped") == pytest.approx(1.5 * greenhill(7.0, 1.0, 1.0, "clamped"))
    assert greenhill(1e4, 1.0, 1.0, "clamped") > greenhill(1e4, 1.0, 1.0, "pinned") > 200.0
    assert greenhill(-4 * math.pi**2 + 1e-6, 1.0, 1.0, "clamped") < 1e-2  # Euler's load of the clamped rod
    with pytest.raises(ValueError, match="without torque"):
        greenhill(-40.0, 1.0, 1.0, "clamped")
    with pytest.raises(ValueError, match="without torque"):
        greenhill(-10.0, 1.0, 1.0, "pinned")


@pytest.mark.parametrize(("kappa", "tau"), [(0.0, 0.0), (1.3, 0.0), (0.0, -0.7), (2.0, 0.9), (1e-4, 2e-4)])
def test_helix(kappa: float, tau: float) -> None:
    """Frame by the matrix exponential of the whole motion; position by the same."""
    s = np.array([0.0, 1e-3, 0.04, 0.7, 5.0])
    positions, frames = helix(kappa, tau, s)
    assert positions.shape == (5, 3)
    assert frames.shape == (5, 3, 3)
    twist = np.zeros((4, 4))
    twist[:3, :3] = np.cross(np.eye(3), np.array([kappa, 0.0, tau])).T @ -np.eye(3)
    twist[2, 3] = 1.0
    np.testing.assert_allclose(twist[:3, :3] @ [0, 0, 1], np.cross([kappa, 0, tau], [0, 0, 1]), atol=0)
    for i, at in enumerate(s):
        motion = expm(twist * at)
        np.testing.assert_allclose(frames[i], motion[:3, :3], rtol=0, atol=1e-13)
        np.testing.assert_allclose(positions[i], motion[:3, 3], rtol=0, atol=1e-13)


def test_folded_chain() -> None:
    L, g = 3.0, 9.81
    x = L * np.array([0.0, 1e-10, 0.3, 0.9, 1.0])
    fall = folded_chain(x, L, g, mu=0.2)
    assert folded_chain(L, L, g).time / math.sqrt(2 * L / g) == pytest.approx(0.8472131, abs=HALF * 1e-7)
    for i in (2, 3):
        far = quad(lambda r: 2 * r / folded_chain(r * r, L, g).speed, 0.0, math.sqrt(x[i]), epsabs=1e-13)[0]
        assert fall.time[i] == pytest.approx(far, rel=1e-10)
    assert fall.time[1] == pytest.approx(math.sqrt(2 * x[1] / g), rel=1e-9)  # at first it falls freely
    np.testing.assert_allclose(fall.tension[0], 0.2 * g * L / 2)  # half the chain hangs there
    assert np.all(np.isinf([fall.speed[-1], fall.tension[-1]]))
    # the support and gravity change the momentum of the falling part, mu v (L - x) / 2 downwards
    d = 1e-4
    near = folded_chain(np.array([x[2] - d, x[2] + d]), L, g, mu=0.2)
    push = np.diff(0.2 * near.speed * (L - np.array([x[2] - d, x[2] + d])) / 2) / np.diff(near.time)
    assert 0.2 * L * g - fall.tension[2] == pytest.approx(push[0], rel=1e-6)


def test_irvine_digits() -> None:
    found = [irvine(lam2) for lam2 in (1.0, 4.0, 4 * math.pi**2, 1000.0)]
    np.testing.assert_allclose(found, [1.040200, 1.151823, 2.0, 2.848264], rtol=0, atol=HALF * 1e-6)
    assert irvine(0.0) == 1.0
    assert irvine(1e-8) == pytest.approx(1.0, abs=1e-8)
    assert irvine(1e9) == pytest.approx(2.8606, abs=HALF * 1e-4)  # inextensible


@pytest.mark.parametrize("dtheta", [-2.5, 1e-3, 1.0, 3.1])
def test_boundary_layer(dtheta: float) -> None:
    T, EI = 7.0, 0.3
    layer = boundary_layer(T, EI, dtheta)
    assert layer.curvature == pytest.approx(2 * math.sqrt(T / EI) * math.sin(dtheta / 2), rel=1e-14)
    s = np.linspace(0, 8 * layer.length, 81)
    path = solve_ivp(  # backwards, where errors decay
        lambda s, y: [y[1], T / EI * math.sin(y[0])],
        (s[-1], 0.0),
        [layer.theta(s[-1]), -2 / layer.length * math.sin(layer.theta(s[-1]) / 2)],
        method="DOP853",
        t_eval=s[::-1],
        rtol=1e-12,
        atol=1e-14,
    )
    np.testing.assert_allclose(path.y[0, ::-1], layer.theta(s), rtol=0, atol=1e-8)
    assert -path.y[1, -1] == pytest.approx(layer.curvature, rel=1e-8)
    assert float(layer.theta(np.array(0.0))) == pytest.approx(dtheta, rel=1e-14)
