"""Reference solutions of inextensible rods and cables, by numpy and scipy alone: nothing of the solvers is used.

Plane problems lie in x (along) and z (up) unless a function says otherwise; theta is the tangent's angle,
x' = cos theta, z' = sin theta, and the bending moment is M = EI dtheta/ds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from scipy.integrate import solve_bvp, solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipkinc, ellipkm1

# ----------------------------------------------------------------------------------------------- cantilevers


class Tip(NamedTuple):
    """Free end of a cantilever: transverse drop / L, shortening of the projection / L, slope [rad]."""

    drop: float
    shortening: float
    slope: float


def cantilever(alpha: float) -> Tip:
    """Clamped rod with a dead end load P across its undeformed axis, alpha = P L^2 / (EI) > 0.

    theta'' = -alpha cos theta, theta(0) = 0, theta'(1) = 0, in the elliptic integrals of Bisshopp and Drucker,
    "Large deflection of cantilever beams", Q. Appl. Math. 3 (1945) 272-275. The root is sought in the logarithm of
    pi/2 - theta(1), which falls as exp(-sqrt(alpha)). Relative accuracy 1e-12; the shortening, a difference from 1,
    has 1e-15 absolute.
    """

    def modulus(left: float) -> tuple[float, float]:
        k = math.cos(left / 2)
        return k * k, math.asin(min(1.0, 1 / (k * math.sqrt(2))))

    def gap(log_left: float) -> float:
        left = math.exp(log_left)
        m, phi = modulus(left)
        return float(ellipkm1(math.sin(left / 2) ** 2) - ellipkinc(phi, m)) - math.sqrt(alpha)

    left = math.exp(brentq(gap, -300.0, math.log(math.pi / 2), xtol=1e-15))
    m, phi = modulus(left)
    drop = 1 - 2 * float(ellipe(m) - ellipeinc(phi, m)) / math.sqrt(alpha)
    return Tip(drop, 1 - math.sqrt(2 * math.cos(left) / alpha), math.pi / 2 - left)


def heavy_cantilever(q: float) -> float:
    """Drop of the free end / L of a rod clamped horizontally under its own weight w per length, q = w L^3 / (EI) > 0.

    With eta = q^(1/3) times the distance from the free end / L, the angle below the horizontal obeys
    theta'' = -eta cos theta, theta' = 0 at the free end. One integration from a chosen end slope to the first zero
    of theta gives the q of that slope on the branch that starts straight; later zeros are the other branches.
    The slope is sought in the logit of theta / (pi/2). Absolute accuracy 1e-10.
    """
    end = q ** (1 / 3)

    def clamp(eta: float, y: np.ndarray) -> float:
        return math.pi / 2 - y[0]

    clamp.terminal = True  # type: ignore[attr-defined]

    def fall(logit: float) -> tuple[float, float]:
        """How far theta is from 0 at the clamp (negative where it was met before), and the drop so far / L."""
        start = (math.pi / 2) / (1 + math.exp(logit))  # pi/2 - theta
        path = solve_ivp(
            lambda eta, y: [y[1], eta * math.sin(y[0]), math.cos(y[0])],
            (0.0, end),
            [start, 0.0, 0.0],
            method="DOP853",
            rtol=1e-13,
            atol=[1e-13 * start, 1e-13 * start, 1e-13],
            events=clamp,
        )
        assert path.success, path.message
        early = end - path.t[-1]
        return (-early if early > 0 else math.pi / 2 - path.y[0, -1]), path.y[2, -1] / end

    logit = brentq(lambda p: fall(p)[0], -30.0, 100.0, xtol=1e-13)
    return float(fall(logit)[1])


# ----------------------------------------------------------------------------- a rod hung from a pin and a clamp


class Hanging(NamedTuple):
    """A hanging line in its plane; every array is along s.

    s [m] from the left end, x, z [m], theta [rad] the tangent's angle above the x axis. The force with which the
    part beyond s pulls on the part before it is tension t + shear n [N], t = (cos theta, sin theta),
    n = (-sin theta, cos theta); moment = EI dtheta/ds [N m], so dmoment/ds = -shear. kink [rad] is the jump of
    theta over the hinge in the direction of s, 0 without one.
    """

    s: np.ndarray
    x: np.ndarray
    z: np.ndarray
    theta: np.ndarray
    tension: np.ndarray
    shear: np.ndarray
    moment: np.ndarray
    kink: float

    def lowest(self) -> tuple[float, float]:
        """Arc length and depth below the left end of the lowest point [m]: an end, or theta = 0 between the points."""
        keep = np.concatenate([[True], np.diff(self.s) > 0])  # a hinge is stored twice
        z = CubicHermiteSpline(self.s[keep], self.z[keep], np.sin(self.theta[keep]))
        s = np.append(z.derivative().roots(extrapolate=False), self.s[[0, -1]])
        at = s[np.argmin(z(s))]
        return float(at), float(-z(at))


LENGTH, DIAMETER, MASS = 2.0, 1e-3, math.pi / 4 * 1e-3  # m, m, kg/m
STIFFNESS = 5 * math.pi / 64 * 1e-3  # N m2
WEIGHT = (MASS - 1.0 * math.pi / 4 * DIAMETER**2) * 9.8  # N/m in a fluid of 1.0 kg/m3
END_ANGLE = -math.pi / 6
END_FORCE = 0.01 * np.array([math.sin(math.pi / 6), math.cos(math.pi / 6)])  # N, normal to the end's tangent


def internal_force(s: np.ndarray) -> np.ndarray:
    """Force [N] (2, ...) of the part beyond s on the part before it: the statics leave nothing unknown in it."""
    s = np.asarray(s, dtype=float)
    return np.stack([np.full(s.shape, END_FORCE[0]), END_FORCE[1] - WEIGHT * (LENGTH - s)])


def hanging(s: np.ndarray, y: np.ndarray, EI: float, kink: float = 0.0) -> Hanging:
    """The line from theta, curvature, x and z (4, n) at s (n,); EI [N m2]."""
    theta, curvature, x, z = y
    fx, fz = internal_force(s)
    tension, shear = fx * np.cos(theta) + fz * np.sin(theta), fz * np.cos(theta) - fx * np.sin(theta)
    return Hanging(s, x, z, theta, tension, shear, EI * curvature, kink)


def rod(start: float, corner: tuple[float, float], EI_scale: float, points: int) -> tuple[np.ndarray, np.ndarray]:
    """The rod from a moment-free end at arc length `start` and (x, z) = corner [m] to the clamp: s and y (4, n).

    EI theta'' = n_x sin theta - n_z cos theta, collocated to 1e-10. The stiffness goes from the cable's with a
    boundary layer at the clamp to the wanted one by factors of at most 4.
    """
    s = np.linspace(start, LENGTH, 401)
    EI = STIFFNESS * EI_scale
    fx, fz = internal_force(s)
    slack = np.arctan2(fz, fx)
    layer = math.sqrt(STIFFNESS / float(np.hypot(fx, fz).mean()))
    theta = slack + (END_ANGLE - slack[-1]) * np.exp((s - LENGTH) / layer)
    y = np.stack([theta, np.gradient(theta, s), *(corner[0] + s - start, np.full_like(s, corner[1]))])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[1], b[0] - END_ANGLE, a[2] - corner[0], a[3] - corner[1]])

    steps = 1 + math.ceil(abs(math.log(EI_scale, 4)))
    for stiffness in STIFFNESS * np.geomspace(1.0, EI_scale, steps):

        def slope(s: np.ndarray, y: np.ndarray, stiffness: float = stiffness) -> np.ndarray:
            fx, fz = internal_force(s)
            c, n = np.cos(y[0]), np.sin(y[0])
            return np.stack([y[1], (fx * n - fz * c) / stiffness, c, n])

        tol = 1e-10 if stiffness == EI else 1e-6
        found = solve_bvp(slope, ends, s, y, tol=tol, max_nodes=100_000)
        assert found.success, found.message
        s, y = found.x, found.y
    s = np.linspace(start, LENGTH, points)
    return s, found.sol(s)


def suspension(EI_scale: float = 1.0, points: int = 2001) -> Hanging:
    """Inextensible rod of 2 m, 1 mm thick, hung in a fluid; `points` stored, equally spaced.

    Left end (s = 0) pinned without moment at the origin. At the right end, free in position, the tangent is held 30
    degrees below the horizontal, (cos 30, -sin 30) in the direction of s, and a force of 0.01 N pulls along the normal
    (sin 30, cos 30), so the tension there is 0 and the shear +0.01 N. EI = 5 pi / 64 * 1e-3 N m2 times EI_scale.
    The moment is positive over the sag (concave upwards) and negative at the right end.
    """
    s, y = rod(0.0, (0.0, 0.0), EI_scale, points)
    return hanging(s, y, STIFFNESS * EI_scale)


def hybrid_suspension(joint: float, EI_scale: float = 1.0, points: int = 2001) -> Hanging:
    """The same line with a catenary without bending stiffness for s < joint [m] (0 < joint < 2), then the rod.

    A hinge without moment joins them: the force passes whole, along the catenary's tangent, and theta jumps by
    `kink`. Each part has `points` points; the hinge is the last of the first and the first of the second.
    """
    s = np.linspace(0.0, joint, points)
    fx, fz = internal_force(s)
    theta = np.arctan2(fz, fx)
    x = fx[0] / WEIGHT * (np.arcsinh(fz / fx) - math.asinh(fz[0] / fx[0]))
    z = (np.hypot(fx, fz) - math.hypot(fx[0], fz[0])) / WEIGHT
    cable = hanging(s, np.stack([theta, np.zeros_like(s), x, z]), 0.0)
    beyond = hanging(*rod(joint, (x[-1], z[-1]), EI_scale, points), STIFFNESS * EI_scale)
    fields = ("s", "x", "z", "theta", "tension", "shear", "moment")
    both = {name: np.concatenate([getattr(cable, name), getattr(beyond, name)]) for name in fields}
    return Hanging(**both, kink=float(beyond.theta[0] - theta[-1]))


# ------------------------------------------------------------------------------------------ torsional buckling


def clamped_determinant(M: float, T: float) -> float:
    """Boundary determinant of the clamped rod with EI = L = 1, without its roots that are no buckling.

    y = c1 + c2 x + c3 exp(i a1 x) + c4 exp(i a2 x), a = mu +- nu, mu = M / 2, nu^2 = mu^2 - T: the determinant of
    y = y' = 0 at both ends is nu T^2 D with D = (cos nu - cos mu - (T / 2) sin nu / nu) / T^2. With
    c(p) = cos sqrt p that is Taylor's remainder, D = -int_0^1 (1 - t) c''(nu^2 + t T) dt, which also holds at T = 0.
    """

    def second(p: np.ndarray) -> np.ndarray:
        """c''(p)."""
        r = np.sqrt(np.abs(p).astype(complex) * np.sign(p))
        near = np.abs(p) < 1e-2
        r = np.where(near, 1.0, r)
        far = ((np.sin(r) - r * np.cos(r)) / (4 * r**3)).real
        return np.where(near, (1 - p / 10 + p**2 / 280 - p**3 / 15120 + p**4 / 1330560) / 12, far)

    mu2 = (M / 2) ** 2
    nu2 = mu2 - T
    if abs(T) > 5:
        nu = np.sqrt(complex(nu2))
        return float((np.cos(nu) - math.cos(M / 2) - T / 2 * np.sinc(nu / math.pi)).real / T**2)
    t, weight = np.polynomial.legendre.leggauss(30)
    t = (1 + t) / 2
    return float(-(weight / 2 * (1 - t)) @ second(nu2 + t * T))


def greenhill(T: float, EI: float, L: float, ends: Literal["pinned", "clamped"]) -> float:
    """Smallest torque M [N m] that buckles a straight isotropic rod of length L [m] and EI [N m2] under tension T [N].

    For the deflection y = y1 + i y2 about the axis, the cross-section's moment is i EI y'' + M y' (bending, and the
    tilt of the torque, which stays M along the tangent of an isotropic rod), so that with the constant transverse
    force V: EI y''' - i M y'' - T y' + V = 0, and EI y'''' - i M y''' - T y'' = 0. Tension stabilises. The result
    is where an adjacent equilibrium appears; the buckled shape turns with the sign of M.

    "pinned": y = 0 at both ends, which turn freely. The torque is axial: its vector stays along the undeformed axis,
    so the transverse moment i EI y'' + M y' vanishes. Then V = 0, y = exp(i a1 x) - exp(i a2 x), a1 - a2 = 2 pi / L and
    (M / (2 EI))^2 = T / EI + (pi / L)^2 (Greenhill, Proc. IMechE 34 (1883) 182-225). A torque along the end's own
    tangent (y'' = 0 there) gives the same value, for y'' then solves the same problem.
    "clamped": y = y' = 0 at both ends, one of which may slide along the axis (T is a dead load) and turn about it; the
    torque's direction does not matter there. At T = 0, tan u = u with u = M L / (2 EI): 8.9868 EI / L.

    ValueError where the compression -T alone buckles the rod.
    """
    tau = T * L * L / EI
    hold = math.pi**2 if ends == "pinned" else 4 * math.pi**2
    if tau <= -hold:
        raise ValueError(f"the rod buckles without torque at T = {-hold * EI / L**2:.6g}")
    if ends == "pinned":
        return 2 * EI / L * math.sqrt(tau + math.pi**2)
    # The clamped rod's y' vanishes at the ends and has no mean: one constraint on Dirichlet's problem, whose values
    # nu^2 = (M L / (2 EI))^2 - tau are pi^2, (2 pi)^2, ..., so by interlacing nu^2 lies between the first two.
    low = max(math.pi**2, -tau)
    grid = 2 * np.sqrt(np.linspace(low, 4 * math.pi**2, 400) + tau)
    for a, b in pairwise(grid):
        if clamped_determinant(a, tau) < 0 <= clamped_determinant(b, tau):
            return EI / L * float(brentq(clamped_determinant, a, b, args=(tau,), xtol=1e-13))
    raise AssertionError("no root between the bounds")


# ------------------------------------------------------------------------------------------------------- helix


def helix(kappa: float, tau: float, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Uniform rod in space: positions (n, 3) [m] and frames (n, 3, 3) at s (n,) [m].

    Column j of a frame R is body axis j in space, R(0) = 1, the tangent is axis 3, and R' = R K with K the cross
    product matrix of the constant body curvature (kappa, 0, tau) [1/m]: axis 3 turns towards minus axis 2 for
    kappa > 0, axis 1 towards axis 2 for tau > 0. Rodrigues' formula and its integral; a circular helix of radius
    kappa / w^2 and pitch 2 pi tau / w^2, w^2 = kappa^2 + tau^2.
    """
    s = np.asarray(s, dtype=float)[:, None, None]
    K = np.array([[0.0, -tau, 0.0], [tau, 0.0, -kappa], [0.0, kappa, 0.0]])
    a = math.hypot(kappa, tau) * s
    first = np.sinc(a / math.pi)  # sin a / a
    second = np.sinc(a / (2 * math.pi)) ** 2 / 2  # (1 - cos a) / a^2
    small = np.abs(a) < 0.1
    b = np.where(small, 1.0, a)
    third = np.where(small, (1 - a**2 / 20 * (1 - a**2 / 42 * (1 - a**2 / 72))) / 6, (b - np.sin(b)) / b**3)
    frames = np.eye(3) + first * s * K + second * s**2 * (K @ K)
    positions = (s * np.eye(3) + second * s**2 * K + third * s**3 * (K @ K))[:, :, 2]
    return positions, frames


# ------------------------------------------------------------------------------------------------ folded chain


class Fall(NamedTuple):
    """Speed of the falling end [m/s], time since the release [s] and tension at the support [N], each like x."""

    speed: np.ndarray
    time: np.ndarray
    tension: np.ndarray


def folded_chain(x: np.ndarray | float, L: float, g: float, mu: float = 1.0) -> Fall:
    """Folded chain of length L [m] and mu [kg/m], its ends level, one let go and fallen by x [m], 0 <= x <= L.

    Energy kept, inextensible, fold of no width (Calkin and March, Am. J. Phys. 57 (1989) 154-157):
    v^2 = g x (2 L - x) / (L - x), tension mu g (2 L^2 + 2 L x - 3 x^2) / (4 (L - x)); both grow without bound at
    x = L. With x = L (1 - cos phi) the time is sqrt(L / g) int_0^phi sqrt(cos u) du, and with u = pi/2 - r^2 the
    integrand 2 r sqrt(sin r^2) is smooth; the whole fall takes 0.8472131 sqrt(2 L / g).
    """
    x = np.asarray(x, dtype=float)
    with np.errstate(divide="ignore"):
        speed = np.sqrt(g * x * (2 * L - x) / (L - x))
        tension = mu * g * (2 * L**2 + 2 * L * x - 3 * x**2) / (4 * (L - x))
    phi = 2 * np.arcsin(np.sqrt(x / (2 * L)))
    u, weight = np.polynomial.legendre.leggauss(40)
    top = math.sqrt(math.pi / 2)
    low = np.sqrt(np.maximum(math.pi / 2 - phi, 0.0))
    half = phi / (top + low) / 2  # half the interval of r, without its cancellation
    r = low[..., None] + half[..., None] * (1 + u)
    time = math.sqrt(L / g) * half * ((2 * r * np.sqrt(np.sin(r * r))) @ weight)
    return Fall(speed, time, tension)


# ---------------------------------------------------------------------------------------- cables under tension


def irvine(lam2: float) -> float:
    """First symmetric in-plane frequency of a shallow cable over that of the taut string, for Irvine's lambda^2 >= 0.

    tan v = v - 4 v^3 / lambda^2, v = omega_bar / 2; root between pi/2 (string) and 4.4934 (inextensible, tan v = v);
    returns omega_bar / pi. Irvine and Caughey, Proc. R. Soc. A 341 (1974) 299-315.
    """
    if lam2 == 0:
        return 1.0
    rigid = brentq(lambda v: math.sin(v) - v * math.cos(v), 4.0, 4.6, xtol=1e-15)

    def f(v: float) -> float:
        return lam2 * (math.sin(v) - v * math.cos(v)) + 4 * v**3 * math.cos(v)

    return 2 / math.pi * float(brentq(f, math.pi / 2, rigid, xtol=1e-15))


class Layer(NamedTuple):
    """End curvature [1/m], decay length [m] and angle theta(s) [rad] off the far direction, s [m] from the end."""

    curvature: float
    length: float
    theta: Callable[[np.ndarray], np.ndarray]


def boundary_layer(T: float, EI: float, dtheta: float) -> Layer:
    """Semi-infinite weightless rod under tension T [N] whose end is held dtheta [rad] off the far direction.

    EI theta'' = T sin theta, theta(0) = dtheta, |dtheta| < 2 pi, theta -> 0: theta' = -2 sqrt(T / EI) sin(theta / 2)
    and tan(theta / 4) = tan(dtheta / 4) exp(-s / sqrt(EI / T)). `curvature` is -theta'(0), of the sign of dtheta.
    """
    length = math.sqrt(EI / T)
    start = math.tan(dtheta / 4)

    def theta(s: np.ndarray) -> np.ndarray:
        return 4 * np.arctan(start * np.exp(-np.asarray(s, dtype=float) / length))

    return Layer(2 / length * math.sin(dtheta / 2), length, theta)
