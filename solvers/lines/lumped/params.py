"""Scene -> parameter pack of the lumped line: mesh, lumping, joints, devices, numbering."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ... import scene as sc
from ...devices import CORDS, LINEAR, SPRINGS
from ...motion import MotionPack, motion_pack


class Lumped(NamedTuple):
    """Discretised cable with devices; SI. n nodes (cable, then free devices), m segments (cable, then cords)."""

    axes: tuple[float, ...]  # zeros; its length is the dimension
    bw: int  # half bandwidth of the tangent
    load_factor: float  # share of the steady loads and of the current
    at: np.ndarray  # (n,) first dof of a node
    fixed: np.ndarray  # prescribed dofs
    held: np.ndarray  # nodes that are prescribed
    free: np.ndarray  # (n,) bool
    solo: np.ndarray  # (n,) bool: its acceleration depends on nobody else's
    weight: np.ndarray  # (ndof,) inertia that weighs errors [kg]
    motion: MotionPack
    mass: np.ndarray  # (n,) mass [kg], normal and tangential added mass
    mn: np.ndarray
    mt: np.ndarray
    inv_n: np.ndarray  # (n,) 1/(m + mn), 1/(m + mt)
    inv_t: np.ndarray
    load: np.ndarray  # (n, dim) steady force [N]
    left: np.ndarray  # (n,) nodes whose chord is the tangent
    right: np.ndarray
    cn: np.ndarray  # (n,) or (0,) drag constants [N s2/m2]
    ct: np.ndarray
    ei: np.ndarray  # (m,) nodes of a segment, phantoms of clamps included
    ej: np.ndarray
    rest: np.ndarray  # (m,) rest length, of real segments only
    EA: np.ndarray
    BA: np.ndarray
    push: np.ndarray  # (m,) bool: carries compression
    cord: np.ndarray  # (m,) bool: belongs to a device
    joint: np.ndarray  # (b, 2) segments of a bending joint
    stiff: np.ndarray  # (b,) EI/dl [N m]
    damp: np.ndarray  # (b,) BI/dl [N m s]
    rod: np.ndarray  # rigid segments
    rod_m: np.ndarray
    rod_mn: np.ndarray
    rod_mt: np.ndarray
    rod_cn: np.ndarray
    rod_ct: np.ndarray
    rod_inv: np.ndarray  # (rods, 3, 3) inverse masses along t, n, t x n: own a, cross, own b
    rod_device: np.ndarray  # device on the rod, -1 for none
    levels: np.ndarray  # current profile
    profile: np.ndarray
    bed: np.ndarray  # (5,) or (0,): z, stiffness, damping, friction, friction speed
    bed_width: np.ndarray  # (n,) d l [m2]
    host: np.ndarray  # (nd, 2) host nodes of an attached device
    slot: np.ndarray  # (nd,) its dof, -1 for none
    aim: np.ndarray  # (nd, dim) slide direction; in the plane its sign
    law: np.ndarray  # (nd, 5)
    dev_mass: np.ndarray
    dev_load: np.ndarray  # (nd, dim)
    dev_drag: np.ndarray  # 1/2 rho Cd A
    dev_inv: np.ndarray  # (nd, 3) inverse masses of a point host along t, n, t x n
    p: np.ndarray  # scratch: unit vectors of segments, 1/length, tangents, 1/chord, a block
    inverse: np.ndarray
    t: np.ndarray
    chord: np.ndarray
    block: np.ndarray


class Mesh(NamedTuple):
    """Nodes along the cable."""

    s: np.ndarray  # (n,) arc length [m]
    rod: np.ndarray  # (n - 1,) bool
    section: np.ndarray  # (n - 1,) section of each segment
    mount: list[tuple[int, int]]  # hosts (or cord anchors) of each device


def make_mesh(scene: sc.Scene, segments: int) -> Mesh:
    """About `segments` segments: nodes at section boundaries, devices, rod ends; a rod is one segment.

    A point-mounted free device ties its cords to nodes a half-span to each side.
    """
    ends = np.cumsum([0.0, *(section.length for section in scene.cable)])
    total = float(ends[-1])
    cuts = {round(float(x), 12) for x in ends}
    spans: list[tuple[float, float]] = []
    for device in scene.devices:
        half = device.rod_length / 2
        if half > 0:
            spans.append((device.s - half, device.s + half))
            cuts.update((round(device.s - half, 12), round(device.s + half, 12)))
        elif device.kind == "bnes_free":
            cuts.update((round(device.s - device.half_span, 12), round(device.s + device.half_span, 12)))
            cuts.add(round(device.s, 12))
        else:
            cuts.add(round(device.s, 12))
    points = sorted(x for x in cuts if -1e-9 <= x <= total + 1e-9)
    points = [x for x in points if not any(a + 1e-9 < x < b - 1e-9 for a, b in spans)]
    pieces = np.diff(points)
    mid = (np.array(points[1:]) + np.array(points[:-1])) / 2
    rigid = np.array([any(a < x < b for a, b in spans) for x in mid])
    soft = float(pieces[~rigid].sum())
    want = max(round(soft / (total / segments)), int((~rigid).sum()))
    share = np.where(rigid, 1.0, pieces / soft * want)
    count = np.where(rigid, 1, np.maximum(np.floor(share + 1e-9), 1)).astype(int)
    while count[~rigid].sum() < want:  # refine where segments are longest
        count[np.argmax(np.where(rigid, 0.0, pieces / count))] += 1
    s = [0.0]
    rod: list[bool] = []
    for k, piece in enumerate(pieces):
        s += [points[k] + piece * (m + 1) / count[k] for m in range(count[k])]
        rod += [bool(rigid[k])] * count[k]
    nodes = np.array(s)
    centre = (nodes[1:] + nodes[:-1]) / 2
    section = np.clip(np.searchsorted(ends, centre) - 1, 0, len(scene.cable) - 1)

    def near(x: float) -> int:
        return int(np.argmin(np.abs(nodes - x)))

    mount = []
    for device in scene.devices:
        half = device.rod_length / 2
        if half == 0 and device.kind == "bnes_free":
            half = device.half_span
        mount.append((near(device.s - half), near(device.s + half)))
    return Mesh(nodes, np.array(rod, dtype=bool), section, mount)


def device_wet_weight(device: Any, scene: sc.Scene) -> float:
    """Weight less buoyancy of a device [N]; neutrally buoyant in water unless a volume is given."""
    if device.volume is None:
        return 0.0 if scene.water else device.mass * scene.g
    return (device.mass - scene.density * device.volume) * scene.g


def discretise(scene: sc.Scene, mesh: Mesh, basis: np.ndarray, hold_free: bool = False) -> Lumped:
    """The pack of a scene on a mesh; `hold_free` prescribes free ends at their positions (released starts)."""
    dim, nc = len(basis), len(mesh.s)
    particles = [d for d, device in enumerate(scene.devices) if device.kind == "bnes_free"]
    attached = [d for d, device in enumerate(scene.devices) if device.kind != "bnes_free"]
    n = nc + len(particles)
    up = basis @ np.array([0.0, 0.0, 1.0])
    rho = scene.density

    # cable: lump what is per metre
    length = np.diff(mesh.s)
    S = [scene.cable[k] for k in mesh.section]
    per = {
        "mass": np.array([x.mass for x in S]),
        "mn": np.array([rho * x.Can * math.pi / 4 * x.d**2 for x in S]),
        "mt": np.array([rho * x.Cat * math.pi / 4 * x.d**2 for x in S]),
        "cn": np.array([0.5 * rho * (x.drag_diameter or x.d) * x.Cdn for x in S]),
        "ct": np.array([0.5 * rho * math.pi * (x.drag_diameter or x.d) * x.Cdt for x in S]),
        "w": np.array([x.wet(rho, scene.g) for x in S]),
        "d": np.array([x.d for x in S]),
    }
    soft = ~mesh.rod

    def lump(name: str, which: np.ndarray) -> np.ndarray:
        share = per[name] * length * which / 2
        out = np.zeros(n)
        out[: nc - 1] += share
        out[1:nc] += share
        return out

    mass, mn, mt, cn, ct = (lump(k, soft) for k in ("mass", "mn", "mt", "cn", "ct"))
    load = -np.outer(lump("w", np.ones_like(soft)), up)
    for end, node in ((scene.end_a, 0), (scene.end_b, nc - 1)):
        if end.force is not None:
            load[node] += basis @ np.array(end.force)
    left = np.concatenate([[0], np.arange(nc - 1), np.arange(nc, n)]).astype(np.int64)
    right = np.concatenate([np.arange(1, nc), [nc - 1], np.arange(nc, n)]).astype(np.int64)
    rods = np.flatnonzero(mesh.rod)
    for e in rods:
        left[e] = left[e + 1] = e
        right[e] = right[e + 1] = e + 1

    # segments, cords of free devices, joints
    EA, BA = [x.EA for x in S], [x.BA for x in S]
    push = [x.carries_compression or bool(r) for x, r in zip(S, mesh.rod, strict=True)]
    ei, ej = list(range(nc - 1)), list(range(1, nc))
    rest, cord = [float(x) for x in length], [False] * (nc - 1)
    for device, (i, _) in zip(scene.devices, mesh.mount, strict=True):
        if device.rod_length > 0 and device.rod_EA:
            EA[i] = device.rod_EA
    for m, d in enumerate(particles):
        device = scene.devices[d]
        assert isinstance(device, sc.BNES)
        node = nc + m
        mass[node] = device.mass + device.added_mass
        cn[node] = 0.5 * rho * device.drag
        load[node] = -device_wet_weight(device, scene) * up
        for anchor in mesh.mount[d]:
            ei.append(anchor)
            ej.append(node)
            rest.append(device.length)
            EA.append(device.EA)
            BA.append(device.BA)
            push.append(False)
            cord.append(True)
    real = len(rest)
    flex = np.array(
        [
            0.0 if mesh.rod[e] else (length[e] / (2 * S[e].EI) if S[e].EI > 0 else np.inf)
            for e in range(nc - 1)
        ]
    )
    give = np.array(
        [
            0.0 if mesh.rod[e] else (length[e] / (2 * S[e].BI) if S[e].BI > 0 else np.inf)
            for e in range(nc - 1)
        ]
    )
    joint, stiff, damp = [], [], []

    def add_joint(e1: int, e2: int, compliance: Any, mobility: Any) -> None:
        if 0 < compliance < np.inf:
            joint.append((e1, e2))
            stiff.append(1 / compliance)
            damp.append(1 / mobility if 0 < mobility < np.inf else 0.0)

    for i in range(nc - 2):
        add_joint(i, i + 1, flex[i] + flex[i + 1], give[i] + give[i + 1])
    phantoms: list[np.ndarray] = []
    for end, node, last in ((scene.end_a, 0, 0), (scene.end_b, nc - 1, nc - 2)):
        if end.kind == "clamped" and flex[last] < np.inf:
            assert end.direction is not None
            direction = basis @ np.array(end.direction)
            phantom = real + len(phantoms)
            phantoms.append(direction / np.linalg.norm(direction))
            ei.append(node)
            ej.append(node)
            pair = (phantom, last) if node == 0 else (last, phantom)
            add_joint(pair[0], pair[1], flex[last], give[last])
    p = np.zeros((real + len(phantoms), dim))
    p[real:] = phantoms if phantoms else np.zeros((0, dim))

    # numbering: a node's dofs, then those of the device that it hosts
    hosts = np.array([mesh.mount[d] for d in attached], dtype=np.int64).reshape(-1, 2)
    slides = [not isinstance(scene.devices[d], sc.PointMass) for d in attached]
    after = {nc + m: (mesh.mount[d][0] + mesh.mount[d][1]) // 2 for m, d in enumerate(particles)}
    at = np.zeros(n, dtype=np.int64)
    slot = np.full(len(attached), -1, dtype=np.int64)
    k = 0
    for i in range(nc):
        at[i] = k
        k += dim
        for a in range(len(attached)):
            if hosts[a, 0] == i and slides[a]:
                slot[a] = k
                k += 1
        for node, where in after.items():
            if where == i:
                at[node] = k
                k += dim
    ndof = k

    held, ends = [], []
    for end, node in ((scene.end_a, 0), (scene.end_b, nc - 1)):
        if end.kind != "free" or (hold_free and end.position is not None):
            held.append(node)
            ends.append(end)
    free = np.ones(n, dtype=bool)
    free[held] = False
    fixed = np.array([at[i] + m for i in held for m in range(dim)], dtype=np.int64)

    # attached devices
    nd = len(attached)
    law, aim = np.zeros((nd, 5)), np.zeros((nd, dim))
    dev_mass, dev_drag, dev_load = np.zeros(nd), np.zeros(nd), np.zeros((nd, dim))
    for a, d in enumerate(attached):
        device = scene.devices[d]
        dev_mass[a] = device.mass + device.added_mass
        dev_drag[a] = 0.5 * rho * device.drag
        dev_load[a] = -device_wet_weight(device, scene) * up
        if isinstance(device, sc.TMD):
            law[a] = LINEAR, device.k, device.c, 1.0, 1.0
        elif isinstance(device, sc.BNES):
            kind = CORDS if device.law == "cords" else SPRINGS
            law[a] = (
                kind,
                device.EA / device.length,
                device.BA / device.length,
                device.length,
                device.half_span,
            )
        elif isinstance(device, sc.CubicNES):
            law[a] = CORDS, device.EA / device.length, device.BA / device.length, device.length, device.length
        direction = getattr(device, "direction", None)
        if dim == 2:
            aim[a, 0] = 1.0  # turned to the given direction by the model, which knows the static tangent
        elif slides[a]:
            aim[a] = basis @ np.array(direction if direction is not None else (1.0, 0.0, 0.0))

    # inverse masses
    inv_n, inv_t = np.zeros(n), np.zeros(n)
    solo = free.copy()
    for e in rods:
        solo[[e, e + 1]] = False
    own_n, own_t = mass + mn, mass + mt
    dev_inv = np.zeros((nd, 3))
    for a in range(nd):
        i, j = hosts[a]
        if i == j:
            M = dev_mass[a]
            if slides[a]:
                solo[i] = False
                dev_inv[a] = 1 / (own_t[i] + M), 1 / own_n[i], 1 / (own_n[i] + M)
            else:
                own_n[i] += M
                own_t[i] += M
    positive = own_n > 0
    inv_n[positive], inv_t[positive] = 1 / own_n[positive], 1 / own_t[positive]
    rod_inv, rod_device = np.zeros((len(rods), 3, 3)), np.full(len(rods), -1, dtype=np.int64)
    rod_values = {name: (per[name] * length)[rods] for name in ("mass", "mn", "mt", "cn", "ct")}
    for b, e in enumerate(rods):
        M, sliding = 0.0, False
        for a in range(nd):
            if hosts[a, 0] == e and hosts[a, 1] == e + 1:
                rod_device[b], M, sliding = a, dev_mass[a], slides[a]
        for axis in range(3):  # t, n, t x n
            added, own = ("mt", own_t) if axis == 0 else ("mn", own_n)
            mu = rod_values["mass"][b] + rod_values[added][b]
            rides = 0.0 if sliding and axis == 1 else M
            two = np.array([[own[e] + mu / 3, mu / 6], [mu / 6, own[e + 1] + mu / 3]]) + rides / 4
            inv = np.linalg.inv(two)
            rod_inv[b, axis] = inv[0, 0], inv[0, 1], inv[1, 1]

    weight = np.zeros(ndof)
    for i in range(n):
        weight[at[i] : at[i] + dim] = mass[i] + mn[i]
    for b, e in enumerate(rods):
        for i in (int(e), int(e) + 1):
            weight[at[i] : at[i] + dim] += (rod_values["mass"][b] + rod_values["mn"][b]) / 2
    for a in range(nd):
        for i in hosts[a]:
            weight[at[i] : at[i] + dim] += dev_mass[a] / 2
        if slot[a] >= 0:
            weight[slot[a]] = dev_mass[a]

    bw = dim
    links = [{int(i), int(j), int(left[i]), int(right[i])} for i, j in zip(ei, ej, strict=True)]
    links += [{int(left[i]), i, int(right[i])} for i in range(n)]
    links += [{ei[x], ej[x], ei[y], ej[y]} for x, y in joint]
    for link in links:
        dofs = [at[i] for i in link]
        bw = max(bw, max(dofs) + dim - 1 - min(dofs))
    for a in range(nd):
        if slot[a] >= 0:
            group = {int(x) for i in hosts[a] for x in (left[i], i, right[i])}
            dofs = [at[i] for i in group] + [slot[a]]
            bw = max(bw, max(dofs) + dim - 1 - min(dofs))

    levels, profile = np.zeros(0), np.zeros((0, dim))
    if scene.water and scene.water.current:
        levels = np.array(scene.water.current.z)
        profile = np.ascontiguousarray(np.array(scene.water.current.velocity) @ basis.T)
    bed = np.zeros(0)
    if scene.seabed:
        b_ = scene.seabed
        bed = np.array([b_.z, b_.stiffness, b_.damping, b_.friction, b_.friction_speed])
    wet = bool(np.any(cn > 0) or np.any(ct > 0) or np.any(rod_values["cn"] > 0))

    def ints(x: Any) -> np.ndarray:
        return np.ascontiguousarray(x, dtype=np.int64)

    def floats(x: Any) -> np.ndarray:
        return np.ascontiguousarray(x, dtype=np.float64)

    return Lumped(
        axes=(0.0,) * dim,
        bw=int(bw),
        load_factor=1.0,
        at=at,
        fixed=fixed,
        held=ints(held),
        free=free,
        solo=solo,
        weight=weight,
        motion=motion_pack(ends, basis),
        mass=mass,
        mn=mn,
        mt=mt,
        inv_n=inv_n,
        inv_t=inv_t,
        load=floats(load),
        left=left,
        right=right,
        cn=cn if wet else np.zeros(0),
        ct=ct if wet else np.zeros(0),
        ei=ints(ei),
        ej=ints(ej),
        rest=floats(rest),
        EA=floats(EA),
        BA=floats(BA),
        push=np.array(push, dtype=bool),
        cord=np.array(cord, dtype=bool),
        joint=ints(joint).reshape(-1, 2),
        stiff=floats(stiff),
        damp=floats(damp),
        rod=ints(rods),
        rod_m=rod_values["mass"],
        rod_mn=rod_values["mn"],
        rod_mt=rod_values["mt"],
        rod_cn=rod_values["cn"],
        rod_ct=rod_values["ct"],
        rod_inv=rod_inv,
        rod_device=rod_device,
        levels=levels,
        profile=profile,
        bed=bed,
        bed_width=lump("d", np.ones_like(soft)) if scene.seabed else np.zeros(0),
        host=hosts,
        slot=slot,
        aim=aim,
        law=law,
        dev_mass=dev_mass,
        dev_load=dev_load,
        dev_drag=dev_drag,
        dev_inv=dev_inv,
        p=floats(p),
        inverse=np.zeros(len(p)),
        t=np.zeros((n, dim)),
        chord=np.zeros(n),
        block=np.zeros((2 * dim, 2 * dim)),
    )
