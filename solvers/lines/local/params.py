"""Scene -> parameter pack of the local line: mesh, static shape (S1, S3), compatibility matrix."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_banded

from ... import scene as sc
from ...catenary import catenary_of
from ...model import CannotRepresent
from ...motion import MotionPack, motion_pack


class Local(NamedTuple):
    """Discretised line; SI. n nodes, n - 1 segments; dofs (U, V) of node i are 2 i and 2 i + 1."""

    axes: tuple[float, ...]  # two zeros
    bw: int  # half bandwidth of the tangent
    load_factor: float  # share of the current
    fixed: np.ndarray  # (4,) prescribed dofs
    held: np.ndarray  # (2,) nodes that are prescribed
    turn: np.ndarray  # (2, 2) cos and sin of the static angle there
    weight: np.ndarray  # (2 n,) m and m + ma of each node [kg]: the whole mass matrix
    motion: MotionPack  # displacement of the ends
    De: np.ndarray  # (n - 1, 4) e of a segment from its four dofs [1/m]
    Dphi: np.ndarray  # (n - 1, 4) phi of a segment from its four dofs [1/m]
    ds: np.ndarray  # (n - 1,) unstretched length [m]
    EA: np.ndarray  # (n - 1,)
    BA: np.ndarray
    geo: np.ndarray  # (n - 1,) energy of turning: Ts, or Ts (1 + es) [N]
    Qs: np.ndarray  # (n - 1,) static shear force [N]
    stiff: np.ndarray  # (n,) EI/dl at interior nodes [N m], or (0,)
    damp: np.ndarray  # (n,) BI/dl [N m s], or (0,)
    cn: np.ndarray  # (n,) or (0,) drag constants [N s2/m2]
    ct: np.ndarray
    stream: np.ndarray  # (n, 2) current along and across the line [m/s]
    e: np.ndarray  # scratch of segments
    phi: np.ndarray
    edot: np.ndarray
    phidot: np.ndarray


class Mesh(NamedTuple):
    """Nodes along the cable; segments are equal within a section."""

    s: np.ndarray  # (n,) arc length [m]
    section: np.ndarray  # (n - 1,) section of each segment


class Shape(NamedTuple):
    """The static shape without current, in the vertical plane (along, up)."""

    angle: np.ndarray  # (n - 1,) of segments [rad]
    T: np.ndarray  # (n - 1,) tension [N]
    Q: np.ndarray  # (n - 1,) shear force [N]
    H: float  # horizontal force in the line, along the plane's first axis [N]
    P: float  # vertical force in the first segment [N]
    x: np.ndarray  # (n, 2) position of the nodes [m]
    end_force: np.ndarray  # (2, 2) external force on ends A and B, half-segments included [N]


class Elements(NamedTuple):
    """What S1 reads: per segment, and per node."""

    ds: np.ndarray
    EA: np.ndarray
    wet: np.ndarray  # (n,) wet weight of the nodes [N]
    stiff: np.ndarray  # (n,) EI/dl, zero at the ends (phi' = 0 there) and without bending [N m]


def make_mesh(scene: sc.Scene, segments: int) -> Mesh:
    """About `segments` segments, nodes at the boundaries of sections, finer where segments are longest."""
    lengths = np.array([x.length for x in scene.cable])
    want = max(segments, len(lengths))
    count = np.maximum(np.floor(lengths / lengths.sum() * want + 1e-9), 1).astype(int)
    while count.sum() < want:
        count[np.argmax(lengths / count)] += 1
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    parts = [np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(pairwise(edges), count, strict=True)]
    return Mesh(np.concatenate([[0.0], *parts]), np.repeat(np.arange(len(lengths)), count))


def to_nodes(share: np.ndarray) -> np.ndarray:
    """Half of what a segment has to each of its nodes."""
    return (np.concatenate([share, [0.0]]) + np.concatenate([[0.0], share])) / 2


def joints(ds: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Value over length at interior nodes, half-segments in series; zero at the ends and beside a segment without."""
    with np.errstate(divide="ignore"):
        give = np.where(value > 0, ds / 2 / np.where(value > 0, value, 1.0), np.inf)
    return np.concatenate([[0.0], 1 / (give[:-1] + give[1:]), [0.0]])


def elements(scene: sc.Scene, mesh: Mesh) -> Elements:
    """Weights and stiffnesses on the mesh."""
    S = [scene.cable[k] for k in mesh.section]
    ds = np.diff(mesh.s)
    wet = np.array([x.wet(scene.density, scene.g) for x in S])
    return Elements(ds, np.array([x.EA for x in S]), to_nodes(wet * ds), joints(ds, np.array([x.EI for x in S])))


# ------------------------------------------------------------------------------------------------- statics


def forces_in(angle: np.ndarray, H: float, P: float, wet: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tension and shear of the segments: the force in the line has the components H and P + the weight so far."""
    up = P + np.concatenate([[0.0], np.cumsum(wet[1:-1])])
    c, s = np.cos(angle), np.sin(angle)
    return H * c + up * s, up * c - H * s


def shape_of(angle: np.ndarray, H: float, P: float, el: Elements, start: np.ndarray) -> Shape:
    """S3: the static shape from its solution."""
    T, Q = forces_in(angle, H, P, el.wet)
    step = (el.ds * (1 + T / el.EA))[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    x = np.concatenate([start[None], start + np.cumsum(step, axis=0)])
    high = P + float(el.wet[1:-1].sum()) + float(el.wet[-1])
    return Shape(angle, T, Q, H, P, x, np.array([[-H, el.wet[0] - P], [H, high]]))


def equilibrium(
    el: Elements, start: np.ndarray, stop: np.ndarray, guess: tuple[np.ndarray, float, float], stretched: bool = False
) -> Shape | None:
    """S1: static equilibrium with bending between two points, by Newton from a guess; None where it fails.

    R1 = EI phi' phi'' + T' - W sin phi and R2 = -EI phi''' + T phi' - W cos phi are the components along and across
    the line of N' + w = 0, N = T t + Q n, Q = -EI phi''. On nodes between segments that balance says that the force
    in the line has a constant horizontal part H and a vertical part that grows by the nodes' weights: this eliminates
    T and Q, and leaves Q(phi, H, P) + EI phi'' = 0 on the segments, tridiagonal in phi, with phi' = 0 at the ends,
    bordered by the closure sum ds (1 + T/EA) (cos phi, sin phi) = stop - start for H and P.
    """
    (angle, H, P), n = (np.array(guess[0]), guess[1], guess[2]), len(el.ds)
    span, B = stop - start, el.stiff
    size, length = float(np.abs(el.wet).sum() + abs(H) + abs(P)), float(el.ds.sum())

    def balance(angle: np.ndarray, H: float, P: float) -> tuple[np.ndarray, np.ndarray, float]:
        T, Q = forces_in(angle, H, P, el.wet)
        arm = el.ds * (1 + T / el.EA) if stretched else el.ds
        M = np.concatenate([[0.0], B[1:-1] * np.diff(angle), [0.0]])
        turn = arm * Q + np.diff(M)
        flat = el.ds * (1 + T / el.EA)
        close = np.array([flat @ np.cos(angle), flat @ np.sin(angle)]) - span
        return turn, close, float(np.abs(turn / el.ds).max()) / size + float(np.abs(close).max()) / length

    turn, close, error = balance(angle, H, P)
    for _ in range(60):
        if error < 1e-15:
            break
        T, Q = forces_in(angle, H, P, el.wet)
        c, s, arm = np.cos(angle), np.sin(angle), (1 + T / el.EA)
        lever = arm if stretched else np.ones(n)
        bend = float(stretched) * Q / el.EA  # d(lever)/dT times Q
        band = np.zeros((3, n))
        band[1] = el.ds * (bend * Q - lever * T) - B[1:] - B[:-1]
        band[0, 1:] = band[2, :-1] = B[1:-1]
        border = np.column_stack([el.ds * (bend * c - lever * s), el.ds * (bend * s + lever * c)])
        rows = np.array([el.ds * (Q / el.EA * c - arm * s), el.ds * (Q / el.EA * s + arm * c)])
        ratio = el.ds / el.EA
        corner = np.array([[ratio @ (c * c), ratio @ (c * s)], [ratio @ (c * s), ratio @ (s * s)]])
        try:
            inner = solve_banded((1, 1), band, np.column_stack([border, -turn]))
            dHP = np.linalg.solve(corner - rows @ inner[:, :2], -close - rows @ inner[:, 2])
        except (np.linalg.LinAlgError, ValueError):
            return None
        dangle = inner[:, 2] - inner[:, :2] @ dHP
        share = min(1.0, 0.5 / max(float(np.abs(dangle).max()), 1e-300))
        for _ in range(12):
            trial = angle + share * dangle, H + share * dHP[0], P + share * dHP[1]
            found = balance(*trial)
            if found[2] < error or found[2] < 1e-13:
                break
            share /= 2
        else:
            break
        stuck = found[2] >= error
        (angle, H, P), (turn, close, error) = trial, found
        if stuck:
            break
    return shape_of(angle, H, P, el, start) if error < 1e-11 else None


def first_guess(scene: sc.Scene, el: Elements, span: np.ndarray) -> tuple[np.ndarray, float, float]:
    """The elastic catenary, or where there is none the straight line between the ends."""
    found = catenary_of(scene)
    if found is None:
        chord = float(np.hypot(*span))
        pull = (chord / float(el.ds.sum()) - 1) * float(el.ds.sum() / (el.ds / el.EA).sum())
        H, P = pull * span[0] / chord, pull * span[1] / chord - float(el.wet[1:-1].sum()) / 2
        return np.full(len(el.ds), np.arctan2(span[1], span[0])), H, P
    end = found.sign * found.V
    upper_is_b = not np.array_equal(found.high, np.array(scene.end_a.position))
    P = end - float(el.wet[1:].sum()) if upper_is_b else float(el.wet[0]) - end
    up = P + np.concatenate([[0.0], np.cumsum(el.wet[1:-1])])
    return np.arctan2(up, found.H), found.H, P


def static_shape(scene: sc.Scene, mesh: Mesh, basis: np.ndarray, stretched: bool) -> Shape:
    """S1 and S3. Raises CannotRepresent where there is no taut static shape."""
    el = elements(scene, mesh)
    start, stop = (basis @ np.array(end.position) for end in (scene.end_a, scene.end_b))
    guess = first_guess(scene, el, stop - start)
    shape = equilibrium(el, start, stop, guess, stretched)
    for share in (0.0, 1e-3, 1e-2, 0.1, 0.3, 1.0) if shape is None else ():  # bending by and by
        softer = equilibrium(el._replace(stiff=share * el.stiff), start, stop, guess, stretched)
        if softer is not None:
            guess = softer.angle, softer.H, softer.P
        shape = softer
    if shape is None:
        raise CannotRepresent("cable: no static shape was found between the ends, and local moves about one")
    if not shape.T.min() > 0:
        k = int(shape.T.argmin())
        raise CannotRepresent(
            f"cable: segment {k} has a tension of {shape.T[k]:.3g} N at rest, and local cannot go slack"
        )
    return shape


def node_angles(angle: np.ndarray, ds: np.ndarray) -> np.ndarray:
    """Static angle at the nodes: between segments interpolated, beyond the last extrapolated."""
    if len(angle) == 1:
        return np.repeat(angle, 2)
    inner = (ds[1:] * angle[:-1] + ds[:-1] * angle[1:]) / (ds[1:] + ds[:-1])
    slope = np.diff(angle) * 2 / (ds[1:] + ds[:-1])
    return np.concatenate([[angle[0] - slope[0] * ds[0] / 2], inner, [angle[-1] + slope[-1] * ds[-1] / 2]])


# ------------------------------------------------------------------------------------------------- the pack


def compatibility(angle: np.ndarray, at_node: np.ndarray, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """e = U' - V phis' and V' + U phis' of each segment, from U, V of its two nodes.

    The differences are those of the displacement vector, taken in the segment's frame: (d_2 - d_1)/ds with
    d = U t + V n in each node's own frame. To second order this is the papers' form; a translation strains nothing.
    """
    first, second = at_node[:-1] - angle, at_node[1:] - angle
    De = np.column_stack([-np.cos(first), np.sin(first), np.cos(second), -np.sin(second)])
    Dphi = np.column_stack([-np.sin(first), -np.cos(first), np.sin(second), np.cos(second)])
    return De / ds[:, None], Dphi / ds[:, None]


def current_at(scene: sc.Scene, z: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Current at the levels z in the plane (n, 2)."""
    if scene.water is None or scene.water.current is None:
        return np.zeros((len(z), 2))
    flow = scene.water.current
    speed = np.array(flow.velocity)
    return np.column_stack([np.interp(z, flow.z, speed[:, m]) for m in range(3)]) @ basis.T


def discretise(scene: sc.Scene, mesh: Mesh, basis: np.ndarray, shape: Shape, stretched: bool) -> Local:
    """The pack of a scene on a mesh about its static shape.

    `stretched` keeps the factors (1 + es) that the papers drop: phi = (V' + U phis')/(1 + es).
    """
    ds, rho = np.diff(mesh.s), scene.density
    S = [scene.cable[k] for k in mesh.section]
    at_node = node_angles(shape.angle, ds)
    De, Dphi = compatibility(shape.angle, at_node, ds)
    EA = np.array([x.EA for x in S])
    grown = 1 + shape.T / EA if stretched else np.ones(len(ds))
    mass = to_nodes(ds * [x.mass for x in S])
    area = np.array([math.pi / 4 * x.d**2 for x in S])
    added_n, added_t = (to_nodes(rho * ds * area * c) for c in ([x.Can for x in S], [x.Cat for x in S]))
    width = np.array([x.drag_diameter or x.d for x in S])
    cn = to_nodes(0.5 * rho * ds * width * [x.Cdn for x in S])
    ct = to_nodes(0.5 * rho * ds * math.pi * width * [x.Cdt for x in S])
    wet = bool(np.any(cn > 0) or np.any(ct > 0))
    stiff, damp = (joints(ds, np.array(x)) for x in ([x.EI for x in S], [x.BI for x in S]))
    bends = bool(np.any(stiff > 0) or np.any(damp > 0))
    c, s = np.cos(at_node), np.sin(at_node)
    flow = current_at(scene, shape.x[:, 1], basis)
    stream = np.column_stack([c * flow[:, 0] + s * flow[:, 1], c * flow[:, 1] - s * flow[:, 0]])
    motion = motion_pack([scene.end_a, scene.end_b], basis)
    last = len(mesh.s) - 1

    def floats(x: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(x, dtype=np.float64)

    def scratch() -> np.ndarray:
        return np.zeros(len(ds))

    none = np.zeros(0)
    return Local(
        axes=(0.0, 0.0), bw=5 if bends else 3, load_factor=1.0,
        fixed=np.array([0, 1, 2 * last, 2 * last + 1], dtype=np.int64), held=np.array([0, last], dtype=np.int64),
        turn=floats(np.column_stack([c, s])[[0, -1]]),
        weight=floats(np.column_stack([mass + added_t, mass + added_n]).ravel()),
        motion=motion._replace(home=np.zeros_like(motion.home)), De=floats(De), Dphi=floats(Dphi / grown[:, None]),
        ds=floats(ds), EA=floats(EA), BA=floats(np.array([x.BA for x in S])), geo=floats(shape.T * grown),
        Qs=floats(shape.Q), stiff=floats(stiff) if bends else none, damp=floats(damp) if bends else none.copy(),
        cn=floats(cn) if wet else none.copy(), ct=floats(ct) if wet else none.copy(), stream=floats(stream),
        e=scratch(), phi=scratch(), edot=scratch(), phidot=scratch(),
    )  # fmt: skip
