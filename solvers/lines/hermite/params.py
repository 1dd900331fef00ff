"""Scene -> parameter pack of the Hermite line: mesh, shape functions, consistent loads and inertia."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ... import scene as sc
from ...motion import MotionPack, motion_pack

BAND = 7  # half bandwidth: the eight dofs of an element
THIRD = 1.0  # stiffness of an element's third strain in EI/h2, as far as that is below EA
POINTS = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)])  # Gauss points of [0, 1] and their weights
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


class Hermite(NamedTuple):
    """Discretised cable; SI. n nodes, m = n - 1 elements.

    Dofs of node i are 4 i ... 4 i + 3: x, z, and the two components of `scale` times its slope dr/ds, so that all are
    lengths. The slope of a clamped end is written along and across the clamp.
    """

    axes: tuple[float, ...]  # two zeros
    bw: int  # half bandwidth of the tangent
    load_factor: float  # share of the steady loads and of the current
    fixed: np.ndarray  # prescribed dofs
    held: np.ndarray  # nodes that are prescribed
    aim: np.ndarray  # (held, 2) unit vector of the clamp, zero at a pin
    turn: np.ndarray  # (2, 2) cos and sin of the frame of the first and last node's slope
    weight: np.ndarray  # (ndof,) inertia that weighs errors: the diagonal of the consistent mass [kg]
    motion: MotionPack
    load: np.ndarray  # (ndof,) steady force, consistent [N]
    shape: np.ndarray  # (m, 3, 10) at Gauss points: N of r_1, slopes 0 and 1; the same of ' and ''; weight [m]
    inertia: np.ndarray  # (m, 4, 4) mass with normal added mass, of one component [kg]
    swing: np.ndarray  # (m,) tangential less normal added mass [kg/m]; (0,) where they are equal everywhere
    EA: np.ndarray  # (m,)
    BA: np.ndarray
    EI: np.ndarray  # (m,), or (0,) where nothing bends
    BI: np.ndarray
    yields: np.ndarray  # (m,) part of EA [N] and of BA [N s] that an element's third strain does without
    relents: np.ndarray
    push: np.ndarray  # (m,) bool: carries compression
    cn: np.ndarray  # (m,) or (0,) drag constants [N s2/m3]
    ct: np.ndarray
    levels: np.ndarray  # current profile
    profile: np.ndarray
    bed: np.ndarray  # (5,) or (0,): z, stiffness, damping, friction, friction speed
    width: np.ndarray  # (m,) diameter on the bed [m]
    band: np.ndarray  # (ndof, 8) Cholesky factor of the inertia, kept where that does not turn with the line
    K: np.ndarray  # (8, 8) scratch: matrix of an element
    X: np.ndarray  # (6, 8) scratch: rates at a Gauss point


class Mesh(NamedTuple):
    """Nodes along the cable; elements are equal within a section."""

    s: np.ndarray  # (n,) arc length [m]
    section: np.ndarray  # (n - 1,) section of each element


def make_mesh(scene: sc.Scene, segments: int) -> Mesh:
    """About `segments` elements, nodes at the boundaries of sections, more where elements are longest."""
    lengths = np.array([x.length for x in scene.cable])
    want = max(segments, len(lengths))
    count = np.maximum(np.floor(lengths / lengths.sum() * want + 1e-9), 1).astype(int)
    while count.sum() < want:
        count[np.argmax(lengths / count)] += 1
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    parts = [np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(pairwise(edges), count, strict=True)]
    return Mesh(np.concatenate([[0.0], *parts]), np.repeat(np.arange(len(lengths)), count))


def shapes(x: np.ndarray, order: int = 0) -> np.ndarray:
    """(4, ...) cubic Hermite functions of r_0, r_0', r_1, r_1' on [0, 1], or their derivatives of order 1 or 2."""
    if order == 0:
        return np.array([1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2])
    if order == 1:
        return np.array([6 * x**2 - 6 * x, 1 - 4 * x + 3 * x**2, 6 * x - 6 * x**2, 3 * x**2 - 2 * x])
    return np.array([12 * x - 6, 6 * x - 4, 6 - 12 * x, 6 * x - 2])


def inertia_of(h: np.ndarray, scale: float, mass: np.ndarray, bending: np.ndarray) -> np.ndarray:
    """(m, 4, 4) consistent mass of elements of length h with `mass` per metre, corrected for the dispersion of bending.

    Cubic elements raise a beam's eigenvalues by the relative amount (k h)^4/720, whatever the ends: their static
    solution is exact at the nodes, so that the error is that of the inertia's load. A mass of m h^4/720 on the second
    derivatives takes it away and leaves -(k h)^6/25000; m h^6/22000 less on the third takes that away and a little
    more, which keeps eigenvalues to 1e-5 up to k h = 1.5 and to 2e-4 at 2. `bending` is the share of the stiffness
    that bending has in waves of k h = 1: a string's dispersion is only (k h)^6/41000, and needs no correction.
    """
    x, w = np.polynomial.legendre.leggauss(4)
    x, w = (x + 1) / 2, w / 2
    plain, curved = (shapes(x) * w) @ shapes(x).T, (shapes(x, 2) * w) @ shapes(x, 2).T
    third = np.array([12.0, 6.0, -12.0, 6.0])
    correction = curved / 720.0 - np.outer(third, third) / 22000.0
    slope = np.stack([np.ones_like(h), h / scale, np.ones_like(h), h / scale], axis=1)
    whole = plain + bending[:, None, None] * correction
    return np.ascontiguousarray((mass * h)[:, None, None] * whole * slope[:, :, None] * slope[:, None, :])


def share_of_bending(h: np.ndarray, EI: np.ndarray, tension: np.ndarray) -> np.ndarray:
    """EI k^2/(T + EI k^2) at k h = 1."""
    pull = np.maximum(tension, 0.0) * h**2
    return np.where(EI > 0, EI / np.where(EI > 0, EI + pull, 1.0), 0.0)


def diagonal(inertia: np.ndarray) -> np.ndarray:
    """(ndof,) diagonal of the assembled mass [kg]."""
    out = np.zeros((len(inertia) + 1, 4))
    own = np.repeat(np.diagonal(inertia, axis1=1, axis2=2), 2, axis=1)
    out[:-1] += own[:, :4]
    out[1:] += own[:, 4:]
    return out.ravel()


def discretise(scene: sc.Scene, mesh: Mesh, basis: np.ndarray, hold_free: bool = False) -> Hermite:
    """The pack of a scene on a mesh; `hold_free` prescribes free ends at their positions (released starts)."""
    h, rho, n = np.diff(mesh.s), scene.density, len(mesh.s)
    m, scale = n - 1, float(mesh.s[-1]) / (len(mesh.s) - 1)
    S = [scene.cable[k] for k in mesh.section]
    up = basis @ np.array([0.0, 0.0, 1.0])

    def floats(x: Any) -> np.ndarray:
        return np.ascontiguousarray(x, dtype=np.float64)

    # Gauss points: r = r_0 + N_2 (r_1 - r_0) + slopes, so that rounding of a far origin does not strain the line
    slope = h / scale
    shape = np.zeros((m, 3, 10))
    for order in range(3):
        for k, j in enumerate((2, 1, 3)):
            shape[:, :, 3 * order + k] = shapes(POINTS, order)[j] / h[:, None] ** order
            if j != 2:
                shape[:, :, 3 * order + k] *= slope[:, None]
    shape[:, :, 9] = h[:, None] * WEIGHTS

    wet = np.array([x.wet(rho, scene.g) for x in S])
    load = np.zeros((n, 4))
    for e in range(m):
        share = wet[e] * h[e] * np.array([0.5, slope[e] / 12, 0.5, -slope[e] / 12])
        load[e : e + 2] -= (share[:, None] * up).reshape(2, 4)
    ends = ((scene.end_a, 0), (scene.end_b, m))
    for end, node in ends:
        if end.force is not None:
            load[node, :2] += basis @ np.array(end.force)

    turn = np.array([[1.0, 0.0], [1.0, 0.0]])
    held, aim, fixed, moved = [], [], [], []
    for k, (end, node) in enumerate(ends):
        clamp = np.zeros(2)
        if end.kind == "clamped":
            clamp = basis @ np.array(end.direction)
            clamp /= np.linalg.norm(clamp)
            turn[k] = clamp
            x, z = load[node, 2:]
            load[node, 2:] = clamp[0] * x + clamp[1] * z, clamp[0] * z - clamp[1] * x
        if end.kind != "free" or (hold_free and end.position is not None):
            held.append(node)
            moved.append(end)
            aim.append(clamp)
            fixed += [4 * node, 4 * node + 1]
            if end.kind == "clamped":
                fixed.append(4 * node + 3)

    mass = np.array([x.mass for x in S])
    area = np.array([math.pi / 4 * x.d**2 for x in S])
    normal, along = (rho * area * c for c in (np.array([x.Can for x in S]), np.array([x.Cat for x in S])))
    EI, BI = np.array([x.EI for x in S]), np.array([x.BI for x in S])
    bends = bool(np.any(EI > 0) or np.any(BI > 0))
    EA, push = np.array([x.EA for x in S]), np.array([x.carries_compression for x in S], dtype=bool)
    third = np.where((EI > 0) & push, np.minimum(THIRD * EI / h**2, EA), EA)
    thick = np.array([x.drag_diameter or x.d for x in S])
    cn = 0.5 * rho * thick * np.array([x.Cdn for x in S])
    ct = 0.5 * rho * math.pi * thick * np.array([x.Cdt for x in S])
    drags = bool(np.any(cn > 0) or np.any(ct > 0))
    inertia = inertia_of(h, scale, mass + normal, share_of_bending(h, EI, np.zeros(m)))
    levels, profile = np.zeros(0), np.zeros((0, 2))
    if scene.water and scene.water.current:
        levels = floats(scene.water.current.z)
        profile = floats(np.array(scene.water.current.velocity) @ basis.T)
    bed = np.zeros(0)
    if scene.seabed:
        b = scene.seabed
        bed = np.array([b.z, b.stiffness, b.damping, b.friction, b.friction_speed])
    none = np.zeros(0)
    relents = (1 - third / EA) * np.array([x.BA for x in S])
    return Hermite(
        axes=(0.0, 0.0), bw=BAND, load_factor=1.0, fixed=np.array(fixed, dtype=np.int64),
        held=np.array(held, dtype=np.int64), aim=floats(aim).reshape(-1, 2), turn=turn, weight=diagonal(inertia),
        motion=motion_pack(moved, basis), load=floats(load.ravel()), shape=shape, inertia=inertia,
        swing=floats(along - normal) if np.any(along != normal) else none, EA=floats(EA),
        BA=floats([x.BA for x in S]), EI=floats(EI) if bends else none.copy(), BI=floats(BI) if bends else none.copy(),
        yields=floats(EA - third), relents=floats(relents), push=push, cn=floats(cn) if drags else none.copy(),
        ct=floats(ct) if drags else none.copy(), levels=levels, profile=profile, bed=bed,
        width=floats([x.d for x in S]), band=np.zeros((4 * n, BAND + 1)), K=np.zeros((8, 8)), X=np.zeros((6, 8)),
    )  # fmt: skip
