"""Scene -> parameter pack of the transverse line: chord, splines, matrices, devices."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import eigh

from ... import scene as sc
from ...devices import CORDS, LINEAR, SPRINGS
from ...motion import MotionPack, motion_pack

DEGREE = 3
GAUSS, SHARE = np.polynomial.legendre.leggauss(4)  # exact for products of two cubics
WATER, PART = np.polynomial.legendre.leggauss(1)  # drag is smooth over a span
SHORT = 128  # most dofs whose masses are inverted once and for all, not solved for by bands (see kernels.accelerate)
ROD = np.array([-1.0, 1.0]) / math.sqrt(3.0)  # two points on a rod, as of the lumped line


class Transverse(NamedTuple):
    """Discretised line; SI. Matrices by diagonals, D[m, i] = D(i, i + m); dofs: u_a, those of the splines, u_b."""

    axes: tuple[float, ...]  # two zeros
    bw: int
    load_factor: float  # share of the steady loads and of the current
    fixed: np.ndarray  # prescribed dofs
    held: np.ndarray  # (2,) ends that are prescribed
    weight: np.ndarray  # (ndof,) inertia that weighs errors: 1/2 sum weight e2 is at least 1/2 e.M e
    motion: MotionPack  # displacement of the ends
    frame: np.ndarray  # (2, 2) chord and normal in the plane's axes
    ends: np.ndarray  # (2, 2) dofs u, w of ends A and B
    clamp: np.ndarray  # dofs of held slopes, and their values
    slope: np.ndarray
    M: np.ndarray  # (bw + 1, ndof) mass, added mass and devices [kg]
    K: np.ndarray  # (bw + 1, ndof) B + W [N/m]
    B: np.ndarray  # bending int EI phi'' phi''/c2
    W: np.ndarray  # weight along the chord int W phi' phi'/c
    G: np.ndarray  # int phi' phi'/c [1/m]
    C: np.ndarray  # bending's damping int BI phi'' phi''/c2, or (0, ndof)
    full: np.ndarray  # (ndof, ndof) M with what slows unresolved motions, or (0, 0) where nothing does
    lower: np.ndarray  # (ndof, bw) factors of M at the free dofs
    inverse: np.ndarray  # (ndof,)
    give: np.ndarray  # (ndof, ndof) inverse of M at the free dofs in their place, or (0, 0)
    load: np.ndarray  # (ndof,) steady forces [N]
    pull: float  # 1/int ds/EA [N/m]
    loss: float  # int BA/EA2 ds pull2 [N s/m]
    stretch: float  # chord less unstretched length [m]
    first: np.ndarray  # (np,) drag points: first dof, shape functions, constants [N s2/m2], current along n [m/s]
    width: np.ndarray  # (np,) and how many
    shape: np.ndarray  # (np, most of them)
    cn: np.ndarray  # (np,) or (0,)
    stream: np.ndarray
    host: np.ndarray  # (nd,) dof of a device's host
    slot: np.ndarray  # (nd,) its own dof, -1 for none
    side: np.ndarray  # (nd,) slide direction along n, 1 or -1
    law: np.ndarray  # (nd, 5)
    dev_drag: np.ndarray  # (nd,) 1/2 rho Cd A
    dev_stream: np.ndarray  # (nd,) current along n [m/s]
    y: np.ndarray  # scratch
    z: np.ndarray


class Mount(NamedTuple):
    """A place where pieces of cable meet, with or without a device: a point, or a rigid rod of a length above 0."""

    s: float  # centre [m]
    length: float
    device: int  # -1 for none


class Mesh(NamedTuple):
    """Mounts (the ends first and last), and the pieces of cable between them as knots along s."""

    mounts: list[Mount]
    knots: list[np.ndarray]
    section: list[int]  # of each piece


class Chord(NamedTuple):
    """The straight line between the ends at rest, in the scene's plane."""

    start: np.ndarray  # (2,) end A [m]
    frame: np.ndarray  # (2, 2) unit vectors along and across
    length: float
    up: np.ndarray  # (2,) the vertical in them


def chord_of(scene: sc.Scene, basis: np.ndarray) -> Chord:
    """The chord of a scene whose ends have positions."""
    a, b = (basis @ np.array(end.position) for end in (scene.end_a, scene.end_b))
    length = float(np.hypot(*(b - a)))
    t = (b - a) / length
    frame = np.array([t, [-t[1], t[0]]])
    return Chord(a, frame, length, frame @ basis @ np.array([0.0, 0.0, 1.0]))


def make_mesh(scene: sc.Scene, segments: int) -> Mesh:
    """About `segments` spans over the cable, in pieces cut at sections' boundaries, devices and rods."""
    edges = np.cumsum([0.0, *(x.length for x in scene.cable)])
    mounts = {round(float(x), 12): Mount(float(x), 0.0, -1) for x in edges}
    for d, device in enumerate(scene.devices):
        mounts[round(device.s, 12)] = Mount(device.s, device.rod_length, d)
    rods = [m for m in mounts.values() if m.length > 0]
    found = sorted(m for m in mounts.values() if m in rods or all(abs(m.s - r.s) > r.length / 2 for r in rods))
    target, knots, section = scene.length / segments, [], []
    for one, other in pairwise(found):
        a, b = one.s + one.length / 2, other.s - other.length / 2
        knots.append(np.linspace(a, b, max(1, round((b - a) / target)) + 1))
        section.append(int(np.clip(np.searchsorted(edges, (a + b) / 2) - 1, 0, len(scene.cable) - 1)))
    return Mesh(found, knots, section)


class Space(NamedTuple):
    """Numbering of a spline space, and the B-splines of each piece in terms of the dofs."""

    ndof: int
    place: np.ndarray  # (mounts,) dof of w
    turn: np.ndarray  # (mounts,) dof of a mount's own slope, -1 where each side has its own
    slot: np.ndarray  # (mounts,) dof of a sliding mass, -1 for none
    parts: list[np.ndarray]  # (spans + 3, ndof) of each piece


def number(scene: sc.Scene, mesh: Mesh) -> Space:
    """Dofs: u_a; of each mount w, slope and sliding mass; of each piece its inner splines; u_b.

    A rod and a point between two pieces that bend have one slope; a piece without bending has its own at each end.
    """
    bends = [scene.cable[k].EI > 0 for k in mesh.section]
    mounts, pieces = len(mesh.mounts), len(mesh.knots)
    place, turn, slot = (np.full(mounts, -1, dtype=np.int64) for _ in range(3))
    sides = np.full((mounts, 2), -1, dtype=np.int64)  # slopes that a piece sees to the left and right of a mount
    inner, k = [], 1
    for j, mount in enumerate(mesh.mounts):
        near = [bends[j - 1] if j > 0 else None, bends[j] if j < pieces else None]
        shared = [bool(x) for x in near]
        if mount.length == 0 and not all(x for x in near if x is not None):
            shared = [False, False]
        if near[0] is not None and not shared[0]:
            sides[j, 0], k = k, k + 1
        place[j], k = k, k + 1
        if mount.length > 0 or any(shared):
            turn[j], k = k, k + 1
        if mount.device >= 0 and not isinstance(scene.devices[mount.device], sc.PointMass):
            slot[j], k = k, k + 1
        if near[1] is not None and not shared[1]:
            sides[j, 1], k = k, k + 1
        sides[j, shared] = turn[j]
        if j < pieces:
            inner.append(np.arange(k, k + len(mesh.knots[j]) - 2))
            k += len(inner[-1])
    parts = []
    for j, knots in enumerate(mesh.knots):
        E = np.zeros((len(knots) + 2, k + 1))
        E[np.arange(2, len(knots)), inner[j]] = 1.0
        for end, sign in ((0, 1), (1, -1)):
            here, h = j + end, knots[1] - knots[0] if end == 0 else knots[-1] - knots[-2]
            row = E[-end]
            row[place[here]] = 1.0
            if mesh.mounts[here].length > 0:
                row[turn[here]] = sign * mesh.mounts[here].length / 2
            E[-3 * end + 1] = row
            E[-3 * end + 1, sides[here, 1 - end]] += sign * h / DEGREE
        parts.append(E)
    return Space(k + 1, place, turn, slot, parts)


def basis_functions(knots: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
    """(len(x), spans + 3) derivatives of the cubic B-splines on the knots, not to be written to."""
    return _basis_functions(knots.tobytes(), x.tobytes(), order)


@lru_cache(maxsize=64)  # the designs of a study have the same pieces
def _basis_functions(knots: bytes, x: bytes, order: int) -> np.ndarray:
    k = np.frombuffer(knots)
    t = np.concatenate([k[:1].repeat(DEGREE), k, k[-1:].repeat(DEGREE)])
    found = np.asarray(BSpline(t, np.eye(len(k) + 2), DEGREE)(np.frombuffer(x), order))
    found.flags.writeable = False
    return found


class Loads(NamedTuple):
    """What weight and current do, per metre and at devices; along and across the chord."""

    grid: np.ndarray  # arc lengths [m]
    along: np.ndarray  # W on the grid, jumps at devices left out [N]
    jumps: list[tuple[float, float]]  # where, by how much W falls
    shift: float

    def W(self, s: np.ndarray) -> np.ndarray:
        """Tension that loads along the chord add to the mean."""
        out = np.interp(s, self.grid, self.along) + self.shift
        for at, size in self.jumps:
            out = out - size * (s > at)
        return out


def stream_at(scene: sc.Scene, chord: Chord, basis: np.ndarray, s: np.ndarray) -> np.ndarray:
    """(len(s), 2) current along and across the chord [m/s]."""
    if scene.water is None or scene.water.current is None:
        return np.zeros((len(s), 2))
    height = (chord.start + np.outer(s / scene.length * chord.length, chord.frame[0])) @ basis[:, 2]
    flow = scene.water.current
    speed = np.array(flow.velocity)
    return np.column_stack([np.interp(height, flow.z, speed[:, m]) for m in range(3)]) @ basis.T @ chord.frame.T


def device_wet_weight(device: Any, scene: sc.Scene) -> float:
    """Weight less buoyancy of a device [N]; neutrally buoyant in water unless a volume is given."""
    if device.volume is None:
        return 0.0 if scene.water else device.mass * scene.g
    return (device.mass - scene.density * device.volume) * scene.g


def section_at(scene: sc.Scene, s: np.ndarray) -> list[sc.Section]:
    edges = np.cumsum([x.length for x in scene.cable])
    return [scene.cable[k] for k in np.minimum(np.searchsorted(edges, s), len(edges) - 1)]


def compliance(scene: sc.Scene, mesh: Mesh, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1/EA and BA/EA2 of the intervals [a, b], which lie in one section or rod each."""
    middle = (a + b) / 2
    S = section_at(scene, middle)
    EA, BA = np.array([x.EA for x in S]), np.array([x.BA for x in S])
    for mount in mesh.mounts:
        stiff = scene.devices[mount.device].rod_EA if mount.device >= 0 else None
        if mount.length > 0 and stiff:
            EA[np.abs(middle - mount.s) < mount.length / 2] = stiff
    return 1 / EA, BA / EA**2


def cuts_of(scene: sc.Scene, mesh: Mesh) -> np.ndarray:
    """Arc lengths of everything that begins or ends, knots included."""
    rods = [x for m in mesh.mounts for x in (m.s - m.length / 2, m.s, m.s + m.length / 2)]
    edges = np.cumsum([x.length for x in scene.cable])
    return np.unique(np.round(np.concatenate([[0.0], rods, edges, *mesh.knots]), 12))


def loads_of(scene: sc.Scene, mesh: Mesh, chord: Chord, basis: np.ndarray) -> Loads:
    """W' = -(load along the chord), with int W/EA ds = 0."""
    cuts = cuts_of(scene, mesh)
    a, b = cuts[:-1], cuts[1:]
    S = section_at(scene, (a + b) / 2)
    ut = stream_at(scene, chord, basis, (a + b) / 2)[:, 0]
    rub = np.array([0.5 * scene.density * math.pi * (x.drag_diameter or x.d) * x.Cdt for x in S])
    force = rub * np.abs(ut) * ut - np.array([x.wet(scene.density, scene.g) for x in S]) * chord.up[0]
    W = np.concatenate([[0.0], -np.cumsum(force * (b - a))])
    hung = [(m.s, scene.devices[m.device]) for m in mesh.mounts if m.device >= 0]
    jumps = [(s, -device_wet_weight(device, scene) * float(chord.up[0])) for s, device in hung]
    loads = Loads(cuts, W, [x for x in jumps if x[1] != 0.0], 0.0)
    give = compliance(scene, mesh, a, b)[0]
    mean = (loads.W((a + b) / 2) * give * (b - a)).sum() / (give * (b - a)).sum()  # W is linear in each interval
    return loads._replace(shift=-float(mean))


def diagonals(D: np.ndarray, bw: int) -> np.ndarray:
    """A dense symmetric matrix by diagonals."""
    out = np.zeros((bw + 1, len(D)))
    for m in range(bw + 1):
        out[m, : len(D) - m] = np.diagonal(D, m)
    return out


class Matrices(NamedTuple):
    """Dense, before they are packed."""

    M: np.ndarray
    B: np.ndarray
    W: np.ndarray
    G: np.ndarray
    C: np.ndarray
    load: np.ndarray
    shape: np.ndarray  # (np, ndof) of the drag points
    at: np.ndarray  # (np,) arc lengths
    cn: np.ndarray


def slide_side(device: Any, chord: Chord, basis: np.ndarray) -> float:
    """1 where a device slides along the chord's normal, -1 against it."""
    given = getattr(device, "direction", None)
    aim = basis @ np.array(given) if given else np.array([1.0, 0.0])
    return 1.0 if chord.frame[1] @ aim >= 0 else -1.0


def assemble(
    scene: sc.Scene, mesh: Mesh, space: Space, chord: Chord, basis: np.ndarray, loads: Loads
) -> Matrices:
    """Matrices by four Gauss points a span; a rod is a rigid body with the dofs w and slope of its centre."""
    n, rho = space.ndof, scene.density
    M, B, W, G, C = (np.zeros((n, n)) for _ in range(5))
    load, shape, at, cn = np.zeros(n), [], [], []

    def drags(s: np.ndarray, weight: np.ndarray, rows: np.ndarray) -> None:
        S = section_at(scene, s)
        value = np.array([0.5 * rho * (x.drag_diameter or x.d) * x.Cdn for x in S]) * weight
        at.append(s)
        cn.append(value)
        shape.append(rows)

    for knots, k, E in zip(mesh.knots, mesh.section, space.parts, strict=True):
        S, h, middle = scene.cable[k], np.diff(knots), (knots[1:] + knots[:-1]) / 2
        x = (middle[:, None] + h[:, None] / 2 * GAUSS).ravel()
        weight = (h[:, None] / 2 * SHARE).ravel()
        value, slope, bend = (basis_functions(knots, x, order) @ E for order in range(3))
        added = rho * S.Can * math.pi / 4 * S.d**2
        M += (S.mass + added) * (value.T * weight) @ value
        G += (slope.T * weight) @ slope
        W += (slope.T * (weight * loads.W(x))) @ slope
        curved = (bend.T * weight) @ bend
        B += S.EI * curved
        C += S.BI * curved
        load -= S.wet(rho, scene.g) * chord.up[1] * weight @ value
        x = (middle[:, None] + h[:, None] / 2 * WATER).ravel()
        drags(x, (h[:, None] / 2 * PART).ravel(), basis_functions(knots, x, 0) @ E)
    for mount, w, turn, slot in zip(mesh.mounts, space.place, space.turn, space.slot, strict=True):
        a, b = mount.s - mount.length / 2, mount.s + mount.length / 2
        edges = np.cumsum([0.0, *(x.length for x in scene.cable)])
        cuts = np.array([a, *edges[(edges > a) & (edges < b)], b]) if mount.length > 0 else np.zeros(0)
        for lo, hi in pairwise(cuts):  # a rod may replace cable of two sections
            S, x = section_at(scene, np.array([(lo + hi) / 2]))[0], (lo + hi) / 2 + (hi - lo) / 2 * GAUSS
            rows = np.zeros((len(x), n))
            rows[:, w], rows[:, turn] = 1.0, x - mount.s
            weight = (hi - lo) / 2 * SHARE
            M += (S.mass + rho * S.Can * math.pi / 4 * S.d**2) * (rows.T * weight) @ rows
            G[turn, turn] += hi - lo
            W[turn, turn] += weight @ loads.W(x)
            load -= S.wet(rho, scene.g) * chord.up[1] * weight @ rows
            x, rows = (lo + hi) / 2 + (hi - lo) / 2 * ROD, np.zeros((2, n))
            rows[:, w], rows[:, turn] = 1.0, x - mount.s
            drags(x, np.full(2, (hi - lo) / 2), rows)
        if mount.device >= 0:
            device = scene.devices[mount.device]
            heavy, pull = device.mass + device.added_mass, -device_wet_weight(device, scene) * chord.up[1]
            which = np.zeros(n)
            which[w] = 1.0
            if slot >= 0:
                which[slot] = slide_side(device, chord, basis)
            M += heavy * np.outer(which, which)
            load += pull * which
    long = chord.length / scene.length  # an angle is w' over the stretch along the chord
    B, C, W, G = B / long**2, C / long**2, W / long, G / long
    load[0], load[-1] = loads.W(np.zeros(1))[0], -loads.W(np.array([scene.length]))[0]
    return Matrices(M, B, W, G, C, load, np.concatenate(shape), np.concatenate(at), np.concatenate(cn))


def law_of(device: Any) -> tuple[float, float, float, float, float]:
    """Constants of `devices.law_force`."""
    if isinstance(device, sc.TMD):
        return LINEAR, device.k, device.c, 1.0, 1.0
    k, c = device.EA / device.length, device.BA / device.length
    if isinstance(device, sc.CubicNES):
        return CORDS, k, c, device.length, device.length
    return CORDS if device.law == "cords" else SPRINGS, k, c, device.length, device.half_span


def free_of(n: int, fixed: Any) -> tuple[np.ndarray, ...]:
    """Rows and columns of the dofs that are not prescribed, to index a matrix by."""
    free = np.ones(n, dtype=bool)
    free[fixed] = False
    return np.ix_(free, free)


def inverse_of(M: np.ndarray, inside: tuple[np.ndarray, ...]) -> np.ndarray:
    """Inverse of the free dofs' part of a mass matrix in its place, zeros elsewhere."""
    give = np.zeros(M.shape)
    give[inside] = np.linalg.inv(M[inside])
    return (give + give.T) / 2


def weights(M: np.ndarray) -> np.ndarray:
    """(ndof,) diagonal matrix that is nowhere below M."""
    size = np.sqrt(np.where(np.diagonal(M) > 0, np.diagonal(M), 1.0))
    return np.asarray(np.diagonal(M) * float(np.linalg.eigvalsh(M / np.outer(size, size))[-1]))


def slowed(pack: Transverse, dense: Matrices, N: float, highest: float) -> tuple[Transverse, Matrices]:
    """The line at tension N with every free motion above the frequency `highest` [rad/s] slowed to it, the others and
    all stiffness left as they are: selective mass scaling (Olovsson, Simonsson & Unosson, Int. J. Numer. Meth. Engng 63
    (2005) 1436) by the motions themselves.

    With K x = w2 M x and x M x = 1 for each of them, M grows by the sum of (w2/highest2 - 1) M x (M x).
    """
    inside, n = free_of(len(dense.M), pack.fixed), len(dense.M)
    w2, shapes = eigh((dense.B + dense.W + N * dense.G)[inside], dense.M[inside])
    fast = w2 > highest**2
    heavy = dense.M[inside] @ shapes[:, fast]
    M = dense.M.copy()
    M[inside] += (heavy * (w2[fast] / highest**2 - 1)) @ heavy.T
    pack = pack._replace(bw=n - 1, weight=np.ascontiguousarray(weights(M)), full=M, give=inverse_of(M, inside))
    return pack, dense._replace(M=M)


def discretise(
    scene: sc.Scene, mesh: Mesh, space: Space, chord: Chord, basis: np.ndarray, loads: Loads, dense: Matrices
) -> Transverse:
    """The pack of a scene on a mesh."""
    n, rho = space.ndof, scene.density
    tied = (dense.M != 0) | (dense.G != 0) | (dense.B != 0)
    bw = max(int(np.abs(np.subtract(*np.nonzero(tied))).max()), 1)
    for rows in dense.shape:
        bw = max(bw, int(np.ptp(np.flatnonzero(rows))))

    fixed, clamp, slope = [0], [], []
    for end, piece, mount in ((scene.end_a, 0, 0), (scene.end_b, -1, -1)):
        fixed.append(int(space.place[mount]))
        if end.kind == "clamped" and scene.cable[mesh.section[piece]].EI > 0:
            across, along = (float(chord.frame[m] @ basis @ np.array(end.direction)) for m in (1, 0))
            clamp.append(int(space.turn[mount]))
            slope.append(across / along)
    fixed = sorted([*fixed, *clamp, n - 1])

    inside = free_of(n, fixed)
    L = np.eye(n)
    L[inside] = np.linalg.cholesky(dense.M[inside])
    pivot = np.diagonal(L)
    lower = np.zeros((n, bw))
    for m in range(1, bw + 1):
        lower[m:, m - 1] = np.diagonal(L / pivot, -m)

    cuts = cuts_of(scene, mesh)
    give, late = compliance(scene, mesh, cuts[:-1], cuts[1:])
    pull = 1 / float(give @ np.diff(cuts))
    wet = dense.cn > 0
    ends = np.array([np.flatnonzero(row)[[0, -1]] for row in dense.shape[wet]], dtype=np.int64).reshape(-1, 2)
    first, width = ends[:, 0].copy(), ends[:, 1] - ends[:, 0] + 1
    shape = np.zeros((len(first), int(width.max(initial=0))))
    for row, k, many, out in zip(dense.shape[wet], first, width, shape, strict=True):
        out[:many] = row[k : k + many]
    own = [(j, scene.devices[m.device]) for j, m in enumerate(mesh.mounts) if m.device >= 0]
    slides = space.slot[[j for j, _ in own]]

    def floats(x: Any) -> np.ndarray:
        return np.ascontiguousarray(x, dtype=np.float64)

    return Transverse(
        axes=(0.0, 0.0), bw=bw, load_factor=1.0, fixed=np.array(fixed, dtype=np.int64),
        held=np.array([0, 1], dtype=np.int64), weight=floats(weights(dense.M)),
        motion=motion_pack([scene.end_a, scene.end_b], basis)._replace(home=np.zeros((2, 2))),
        frame=floats(chord.frame),
        ends=np.array([[0, space.place[0]], [n - 1, space.place[-1]]], dtype=np.int64),
        clamp=np.array(clamp, dtype=np.int64), slope=floats(slope), M=diagonals(dense.M, bw),
        K=diagonals(dense.B + dense.W, bw), B=diagonals(dense.B, bw), W=diagonals(dense.W, bw),
        G=diagonals(dense.G, bw), C=diagonals(dense.C, bw) if dense.C.any() else np.zeros((0, n)),
        full=np.zeros((0, 0)), lower=lower, inverse=floats(1 / pivot**2),
        give=inverse_of(dense.M, inside) if n <= SHORT else np.zeros((0, 0)), load=dense.load, pull=pull,
        loss=float(late @ np.diff(cuts)) * pull**2, stretch=chord.length - scene.length, first=first,
        width=width, shape=shape, cn=floats(dense.cn[wet]),
        stream=floats(stream_at(scene, chord, basis, dense.at[wet])[:, 1]),
        host=np.array(space.place[[j for j, _ in own]], dtype=np.int64), slot=np.array(slides, dtype=np.int64),
        side=floats([slide_side(x, chord, basis) for _, x in own]),
        law=floats([law_of(x) if k >= 0 else (0.0,) * 5 for (_, x), k in zip(own, slides, strict=True)]).reshape(-1, 5),
        dev_drag=floats([0.5 * rho * x.drag for _, x in own]),
        dev_stream=floats(stream_at(scene, chord, basis, np.array([x.s for _, x in own]))[:, 1]),
        y=np.zeros(n), z=np.zeros(n),
    )  # fmt: skip
