"""Scene -> parameter pack of the rod family: mesh, domains, layout of unknowns and equations, ends."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ... import scene as sc
from ...catenary import catenary_of
from ...motion import MotionPack, motion_pack

GUIDED = 1e-300  # a weight without weight: see `Rod.weight`
PER_LAYER, GROWTH = 4.0, 1.25  # elements in a bending length at a clamp, and the ratio of their lengths
ROD, CATENARY = 12, 6  # equations of an element: the order of each system in s


class Small(NamedTuple):
    """The system that is factored where there are catenary elements: all but the forces inside their domains, which an
    element's own equations give. Without catenaries, and for the two-step rule in space, arrays of length zero."""

    slot: np.ndarray  # (ndof,) number of an unknown, and of the row with its number, in the small system; -1 without
    plain: np.ndarray  # rows that go over as they are
    bw: int
    low: np.ndarray  # (n,) extents, as those of `Rod`
    high: np.ndarray
    first: np.ndarray
    clear: np.ndarray
    order: np.ndarray  # scratch
    end: np.ndarray
    largest: np.ndarray
    J: np.ndarray  # (n, 2 bw + 1)
    x: np.ndarray  # (n,)
    pull: np.ndarray  # (m, 6) force per stretch of an element: 11, 22, 33, 12, 13, 23


class Rod(NamedTuple):
    """A line of rod and catenary domains, SI. n nodes, m = n - 1 elements.

    Unknowns of a node: position r, internal force N (on the face towards larger s, components in space), and in a rod
    domain the frame's quaternion p and the internal moment M. Every node keeps them in the order r, p, N, M, the last
    one in the order N, M, r, p: so the first and last rows are those of the ends, and all others are in the order of s.
    """

    axes: tuple[float, ...]  # three zeros
    bw: int  # half bandwidth of the storage, fill of the row exchanges included where it is factored in place
    load_factor: float  # share of the steady loads, of the current and of intrinsic curvature and end twist
    rate: float  # 1/tau of the constraints' return [1/s]
    space: tuple[float, float, float]  # am, af, g of generalised-alpha in space
    fixed: np.ndarray  # prescribed dofs
    weight: np.ndarray  # (ndof,) inertia that weighs errors of velocity; 0 where a rate may alternate and guides nobody
    unit: np.ndarray  # (ndof,) typical size of each row
    size: np.ndarray  # (ndof,) typical size of each unknown
    first: np.ndarray  # (ndof,) extents of the matrix: see banded.factor_pivoting
    low: np.ndarray
    high: np.ndarray
    clear: np.ndarray  # (ndof, 2) columns that the tangent, and factors in place, read in each row
    order: np.ndarray  # scratch of the factors
    end: np.ndarray
    largest: np.ndarray
    r: np.ndarray  # (n,) first dof of r, p, N, M of a node; p and M are -1 outside the rod domains
    p: np.ndarray
    N: np.ndarray
    M: np.ndarray
    row: np.ndarray  # (m,) first row of an element
    frame_row: np.ndarray  # (n,) row of a node's gauge (inside a domain) or of its moment (four rows), -1 without
    hinge: np.ndarray  # (n,) -1 where a rod domain starts, +1 where it ends, 0 elsewhere
    rod: np.ndarray  # (m,) bool: rod or catenary
    head: np.ndarray  # (m,) bool: first of its domain
    l: np.ndarray  # (m,) unstretched length [m]
    mass: np.ndarray  # (m,) [kg/m], normal and tangential added mass
    mn: np.ndarray
    mt: np.ndarray
    load: np.ndarray  # (m, 3) steady force [N/m]
    moment: np.ndarray  # (m, 3) steady moment [N m/m]
    give: np.ndarray  # (m, 5) compliances 1/EI1, 1/EI2, twist per torque, strain per tension, twist per tension
    natural: np.ndarray  # (m, 3) intrinsic curvature and twist, body axes [1/m]
    inertia: np.ndarray  # (m, 3) rotary, body axes [kg m]
    cn: np.ndarray  # (m,) or (0,) drag constants per metre
    ct: np.ndarray
    levels: np.ndarray  # current profile
    profile: np.ndarray
    bed: np.ndarray  # (5,) or (0,)
    bed_width: np.ndarray  # (m,) d [m]
    end_force: np.ndarray  # (2, 3) [N]
    end_moment: np.ndarray  # (2, 3) [N m]
    held: np.ndarray  # nodes whose position is prescribed
    motion: MotionPack
    guided: np.ndarray  # nodes whose frame is prescribed
    home: np.ndarray  # (guided, 4) their frames at twist 0
    twist: MotionPack  # their twist, in the third component [rad]
    least: np.ndarray  # (1,) least tension seen in a catenary domain [N]
    small: Small
    m3: np.ndarray  # scratch
    m34: np.ndarray


def mesh_of(scene: sc.Scene, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Arc lengths of the nodes (n,) and the section of each element (m,): about `segments`, section by section, and
    finer towards an end that holds a direction where these could not resolve its boundary layer."""
    lengths = np.array([x.length for x in scene.cable])
    counts = np.maximum(np.round(segments * lengths / lengths.sum()).astype(int), 1)
    start = np.concatenate([[0.0], np.cumsum(lengths)])
    parts = [np.linspace(start[k], start[k + 1], counts[k] + 1) for k in range(len(counts))]
    layers = bending_layers(scene)
    if layers[0] > 0:
        parts[0] = _graded(parts[0], layers[0])
    if layers[1] > 0:
        parts[-1] = start[-1] + start[-2] - _graded(start[-1] + start[-2] - parts[-1][::-1], layers[1])[::-1]
        parts[-1][[0, -1]] = start[-2:]
    section = np.concatenate([np.full(len(part) - 1, k) for k, part in enumerate(parts)])
    return np.concatenate([[0.0], *(part[1:] for part in parts)]), section


def bending_layers(scene: sc.Scene) -> tuple[float, float]:
    """Bending lengths sqrt(EI/T) at the ends that hold a direction, 0 elsewhere; T estimated before statics [m]."""
    found = catenary_of(scene)
    out = []
    for end, section, at in ((scene.end_a, scene.cable[0], 0), (scene.end_b, scene.cable[-1], 1)):
        if end.direction is None or section.EI == 0 or found is None:
            out.append(0.0)
            continue
        low_is_a = np.array_equal(found.low, np.array(scene.end_a.position))
        upper = (at == 1) == low_is_a
        V = found.V if upper else max(found.V - found.w * scene.length, 0.0 if found.bed else -math.inf)
        out.append(math.sqrt(section.EI / math.hypot(found.H, V)))
    return out[0], out[1]


def _graded(s: np.ndarray, layer: float) -> np.ndarray:
    """Nodes s with elements that grow by GROWTH from PER_LAYER in `layer` at the first node to those of s."""
    l, h = float(s[1] - s[0]), layer / PER_LAYER
    if h >= l:
        return s
    sizes = [h]
    while sizes[-1] * GROWTH < l and sum(sizes) < 0.5 * (s[-1] - s[0]):
        sizes.append(sizes[-1] * GROWTH)
    fine = s[0] + np.concatenate([[0.0], np.cumsum(sizes)])
    rest = max(round((s[-1] - fine[-1]) / l), 1)
    return np.concatenate([fine[:-1], np.linspace(fine[-1], s[-1], rest + 1)])


def end_frame(direction: Any) -> np.ndarray:
    """Quaternion of an end's frame at twist 0: axis 3 along `direction`, axis 2 horizontal (y for a vertical one)."""
    third = np.array(direction, dtype=float) / np.linalg.norm(direction)
    flat = np.cross([0.0, 0.0, 1.0], third)
    second = flat / np.linalg.norm(flat) if np.linalg.norm(flat) > 1e-9 else np.array([0.0, 1.0, 0.0])
    return quaternion(np.column_stack([np.cross(second, third), second, third]))


def quaternion(R: np.ndarray) -> np.ndarray:
    """Unit quaternion (4,) of a rotation matrix whose columns are the frame's axes."""
    K = np.array([
        [R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
        [R[2, 1] - R[1, 2], R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
        [R[0, 2] - R[2, 0], R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], R[1, 2] + R[2, 1]],
        [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1]],
    ])  # fmt: skip
    values, vectors = np.linalg.eigh(K)
    found = vectors[:, np.argmax(values)]
    return found if found[np.argmax(np.abs(found))] > 0 else -found


def matrix(p: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) of any length; columns are the frame's axes."""
    w, x, y, z = np.moveaxis(p / np.linalg.norm(p, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rotated(p: np.ndarray, angle: float) -> np.ndarray:
    """The frame p turned by `angle` [rad] about its third axis."""
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    w, x, y, z = p
    return np.array([c * w - s * z, c * x + s * y, c * y - s * x, c * z + s * w])


class _Angle(NamedTuple):
    """What `motion_pack` reads of an end, for its twist."""

    position: tuple[float, float, float]
    motion: Any


def _twist(end: sc.End) -> _Angle:
    if not isinstance(end.twist, sc.Turn):
        return _Angle((0.0, 0.0, math.radians(end.twist)), None)
    x = tuple((0.0, 0.0, math.radians(a)) for a in end.twist.angle)
    return _Angle((0.0, 0.0, 0.0), sc.Motion(table=sc.Table(t=end.twist.t, x=x)))


class Layout(NamedTuple):
    """Where the unknowns and equations are."""

    at: dict[str, np.ndarray]
    row: np.ndarray
    frame_row: np.ndarray
    hinge: np.ndarray
    head: np.ndarray
    first: np.ndarray
    low: np.ndarray
    high: np.ndarray
    bw: int
    ndof: int
    clear: np.ndarray
    small: Small


def lay_out(rod: np.ndarray, two_step: bool) -> Layout:
    """Numbers of unknowns and rows for elements of kind `rod` (m,); `two_step`: they also read the one before."""
    m = len(rod)
    n = m + 1
    bends = np.zeros(n, dtype=bool)
    bends[:-1] |= rod
    bends[1:] |= rod
    hinge = np.zeros(n, dtype=np.int64)
    left, right = np.concatenate([[False], rod]), np.concatenate([rod, [False]])
    hinge[right & ~left], hinge[left & ~right] = -1, 1
    head = np.concatenate([[True], rod[1:] != rod[:-1]])
    at = {k: np.full(n, -1, dtype=np.int64) for k in "rpNM"}
    k = 0
    for i in range(n):
        for name, count in (("r", 3), ("p", 4), ("N", 3), ("M", 3)) if i < m else (
            ("N", 3), ("M", 3), ("r", 3), ("p", 4),
        ):  # fmt: skip
            if name in "rN" or bends[i]:
                at[name][i] = k
                k += count
    ndof = k
    row, frame_row = np.zeros(m, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    k = 3
    for i in range(n):
        if i == m:
            k += 3  # the force at the far end comes before its moment
        if bends[i]:
            frame_row[i] = k
            k += 4 if hinge[i] else 1
        if i < m:
            row[i] = k
            k += ROD if rod[i] else CATENARY
    assert k == ndof
    first = np.array([min(at[x][i] for x in "rpNM" if at[x][i] >= 0) for i in range(n)])
    last = np.concatenate([first[1:], [ndof]]) - 1
    blocks: list[tuple[int, int, int, int]] = [(0, 3, first[0], last[0] + 1)]
    blocks.append((ndof - 3 - (4 if bends[-1] else 0), ndof, first[-1], ndof))
    for i in np.flatnonzero(bends).tolist():
        blocks.append((frame_row[i], frame_row[i] + (4 if hinge[i] else 1), first[i], last[i] + 1))
    for e in range(m):
        start = e - 1 if two_step and not head[e] else e
        blocks.append((row[e], row[e] + (ROD if rod[e] else CATENARY), first[start], last[e + 1] + 1))
    begin, low, high = extents(blocks, ndof)
    if rod.all() or two_step:
        small, clear = _small(np.zeros(0, dtype=np.int64), [], [], m), read_by_factors(low, high)
        bw = width(low, high)
    else:
        small, clear = _condensed(rod, head, at, row, first, last, blocks, ndof), np.column_stack([begin, high])
        index = np.arange(ndof)  # no fill here
        bw = int(max((high - index).max(), (index - begin).max()))
    return Layout(at, row, frame_row, hinge, head, begin, low, high, bw, ndof, clear, small)


def extents(blocks: list[tuple[int, int, int, int]], n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """first, low, high as `banded.factor_pivoting` wants them, of a matrix with entries in `blocks` (rows from, to,
    columns from, to)."""
    first, low, high = np.arange(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    for r0, r1, c0, c1 in blocks:
        first[r0:r1] = np.minimum(first[r0:r1], c0)
        high[r0:r1] = np.maximum(high[r0:r1], c1 - 1)
        low[c0:c1] = np.maximum(low[c0:c1], r1 - 1)
    return first, np.maximum.accumulate(low), high


def width(low: np.ndarray, high: np.ndarray) -> int:
    """Half bandwidth of the storage for factors with row exchanges."""
    index = np.arange(len(low))
    return int((low - index).max() + (high - index).max() + 1) if len(low) else 0


def _condensed(
    rod: np.ndarray, head: np.ndarray, at: dict[str, np.ndarray], row: np.ndarray, first: np.ndarray,
    last: np.ndarray, blocks: list[tuple[int, int, int, int]], ndof: int,
) -> Small:  # fmt: skip
    """Without the forces inside catenary domains and the kinematic rows that give them, which have their numbers."""
    m = len(rod)
    kept = np.ones(ndof, dtype=bool)
    inner = np.flatnonzero(~rod & ~head)
    for e in inner:
        assert at["N"][e] == row[e]
        kept[row[e] : row[e] + 3] = False
    slot = np.where(kept, np.cumsum(kept) - 1, -1)
    plain = kept.copy()
    less = []
    for e in np.flatnonzero(~rod):
        plain[row[e] : row[e] + 6] = False
        k = slot[row[e] + 3]
        stop = slot[at["r"][e + 2]] + 3 if e + 1 < m and not rod[e + 1] else slot[last[e + 1]] + 1
        less.append((k, k + 3, slot[first[e]], stop))
        if head[e]:
            k = slot[row[e]]
            less.append((k, k + 3, slot[first[e]], slot[at["r"][e + 1]] + 3))
    less += [(slot[a], slot[b - 1] + 1, slot[c], slot[d - 1] + 1) for a, b, c, d in blocks if plain[a]]
    return _small(slot, np.flatnonzero(plain), less, m)


def _small(slot: np.ndarray, plain: Any, blocks: list[tuple[int, int, int, int]], elements: int) -> Small:
    n = int(slot.max()) + 1 if len(slot) else 0
    first, low, high = extents(blocks, n)
    bw = width(low, high)
    clear = read_by_factors(low, high) if n else np.zeros((0, 2), dtype=np.int64)
    return Small(
        slot.astype(np.int64), np.array(plain, dtype=np.int64), bw, low, high, first, clear,
        np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros((n, 2 * bw + 1)), np.zeros(n),
        np.zeros((elements if n else 0, 6)),
    )  # fmt: skip


def read_by_factors(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(ndof, 2) first and last column that `banded.factor_pivoting` may read in each row slot, fill included."""
    n = len(low)
    first = np.searchsorted(low, np.arange(n))
    return np.ascontiguousarray(np.column_stack([first, np.maximum.accumulate(high)[low]]), dtype=np.int64)


def spatial(rho: float) -> tuple[float, float, float]:
    """am, af, g of generalised-alpha (Jansen, Whiting & Hulbert 2000) with spectral radius rho at infinity."""
    am, af = 0.5 * (3.0 - rho) / (1.0 + rho), 1.0 / (1.0 + rho)
    return am, af, 0.5 + am - af


def discretise(scene: sc.Scene, s: np.ndarray, section: np.ndarray, rod: np.ndarray, rho: float) -> Rod:
    """The pack of a scene on nodes s (n,), elements of kind `rod` (m,), spectral radius `rho` in space."""
    lay = lay_out(rod, rho < 1.0)
    n, ndof, density = len(s), lay.ndof, scene.density
    S = [scene.cable[k] for k in section]
    l = np.diff(s)

    def per(f: Any) -> np.ndarray:
        return np.array([f(x) for x in S], dtype=float)

    area = per(lambda x: density * math.pi / 4 * x.d**2)
    mass, mn, mt = per(lambda x: x.mass), area * per(lambda x: x.Can), area * per(lambda x: x.Cat)
    wet = per(lambda x: x.wet(density, scene.g))
    load = np.outer(wet, [0.0, 0.0, -1.0])
    give = np.zeros((n - 1, 5))
    for e, x in enumerate(S):
        if x.EI > 0:
            det = x.EA * x.torsion - x.coupling**2
            give[e] = 1 / x.EI, 1 / (x.EI2 or x.EI), x.EA / det, x.torsion / det, -x.coupling / det
        else:
            give[e, 3] = 1 / x.EA
    solid = np.outer(mass * per(lambda x: x.d) ** 2 / 16, [1.0, 1.0, 2.0])
    inertia = np.array([solid[e] if x.inertia is None else x.inertia for e, x in enumerate(S)])
    ends = (scene.end_a, scene.end_b)
    held = [k for k, end in zip((0, n - 1), ends, strict=True) if end.kind != "free"]
    guided = [k for k, end in zip((0, n - 1), ends, strict=True) if not end.turns and lay.at["p"][k] >= 0]
    fixed = [lay.at["r"][k] + m for k in held for m in range(3)] + [
        lay.at["p"][k] + m for k in guided for m in range(4)
    ]
    by_node = dict(zip((0, n - 1), ends, strict=True))
    total = float(scene.length)
    pull = [float(np.linalg.norm(end.force)) for end in ends if end.force]
    bent = float(np.max([x.EI for x in S])) / total**2
    force = max(float(np.abs(wet) @ l), *pull, bent) if pull else max(float(np.abs(wet) @ l), bent)
    force = force if force > 0 else 1e-6 * float(min(x.EA for x in S))
    heavy = float((mass + mn) @ l)
    tau = 0.1 * math.sqrt(heavy * total / force)
    weight, unit, size = np.zeros(ndof), np.ones(ndof), np.ones(ndof)
    each = np.zeros(n)
    each[:-1] += l / 2
    each[1:] += l / 2
    for i in range(n):
        e = min(i, n - 2)
        r, p, N, M = (lay.at[k][i] for k in "rpNM")
        weight[r : r + 3] = (mass[e] + mn[e]) * each[i]
        size[r : r + 3], size[N : N + 3] = total, force
        if not (rod[e] and rod[max(i - 1, 0)]):
            weight[N : N + 3] = GUIDED  # a catenary's force has a rate of its own
        if p >= 0:
            weight[p : p + 4] = 4 * inertia[e].mean() * each[i]
            size[M : M + 3] = force * total
            k = lay.frame_row[i]
            unit[k : k + (4 if lay.hinge[i] else 1)] = force * total if lay.hinge[i] else 1 / tau
    unit[:3], unit[lay.at["r"][-1] : lay.at["r"][-1] + 3] = force, force
    for e in range(n - 1):
        k = lay.row[e]
        unit[k : k + 3], unit[k + 3 : k + 6] = l[e] / tau, force
        if rod[e]:
            unit[k + 6 : k + 9], unit[k + 9 : k + 12] = 1.0, force * total
    levels, profile = np.zeros(0), np.zeros((0, 3))
    if scene.water and scene.water.current:
        levels = np.array(scene.water.current.z)
        profile = np.ascontiguousarray(scene.water.current.velocity, dtype=float)
    bed = np.zeros(0)
    if scene.seabed:
        b = scene.seabed
        bed = np.array([b.z, b.stiffness, b.damping, b.friction, b.friction_speed])
    cn = per(lambda x: 0.5 * density * (x.drag_diameter or x.d) * x.Cdn)
    ct = per(lambda x: 0.5 * density * math.pi * (x.drag_diameter or x.d) * x.Cdt)
    wetted = bool((cn > 0).any() or (ct > 0).any())

    def floats(x: Any, *shape: int) -> np.ndarray:
        return np.ascontiguousarray(x, dtype=np.float64).reshape(shape or np.shape(x))

    def ints(x: Any) -> np.ndarray:
        return np.ascontiguousarray(x, dtype=np.int64)

    return Rod(
        axes=(0.0, 0.0, 0.0), bw=lay.bw, load_factor=1.0, rate=1.0 / tau, space=spatial(rho), fixed=ints(fixed),
        weight=weight, unit=unit, size=size, first=ints(lay.first), low=ints(lay.low), high=ints(lay.high),
        clear=ints(lay.clear), small=lay.small,
        order=np.zeros(ndof, dtype=np.int64), end=np.zeros(ndof, dtype=np.int64), largest=np.zeros(ndof),
        r=lay.at["r"], p=lay.at["p"], N=lay.at["N"], M=lay.at["M"], row=lay.row, frame_row=lay.frame_row,
        hinge=lay.hinge, rod=np.array(rod, dtype=bool), head=np.array(lay.head, dtype=bool), l=floats(l),
        mass=mass, mn=mn, mt=mt, load=floats(load), moment=floats([x.moment for x in S]), give=give,
        natural=floats([x.curvature for x in S]), inertia=floats(inertia), cn=cn if wetted else np.zeros(0),
        ct=ct if wetted else np.zeros(0), levels=levels, profile=profile, bed=bed, bed_width=per(lambda x: x.d),
        end_force=floats([end.force or (0, 0, 0) for end in ends]),
        end_moment=floats([end.moment or (0, 0, 0) for end in ends]), held=ints(held),
        motion=motion_pack([by_node[k] for k in held], np.eye(3)), guided=ints(guided),
        home=floats([end_frame(by_node[k].direction) for k in guided], len(guided), 4),
        twist=motion_pack([_twist(by_node[k]) for k in guided], np.eye(3)),  # type: ignore[misc]
        least=np.full(1, np.inf), m3=np.zeros((16, 3, 3)), m34=np.zeros((16, 3, 4)),
    )  # fmt: skip
