"""The lumped line as a Model: discretised scene, start, quantities, guards."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from ... import scene as sc
from ...algebra import axpy, dot, load, row, unit
from ...catenary import hanging_shape
from ...devices import LINEAR, contact_rates
from ...dispatch import call_residual, provides
from ...geometry import basis_of
from ...model import CannotRepresent, Status
from ...motion import breaks, top_omega
from . import kernels
from .params import Lumped, Mesh, device_wet_weight, discretise, make_mesh

provides(
    Lumped, drive=kernels.drive, residual=kernels.residual, tangent=kernels.tangent, accelerate=kernels.accelerate,
    energies=kernels.energies, gaps=kernels.gaps,
)  # fmt: skip

LEAST_NODES_PER_WAVE = 8.0  # a lumped line's wave speed is then low by some 3-5 %


@njit(cache=True)
def section_forces(q, v, pack, tension, curvature):
    """Tension of each cable segment and curvature at each cable node, for samples q, v (nt, ndof)."""
    segments = tension.shape[1]
    for k in range(len(q)):
        for e in range(segments):
            i, j = pack.at[pack.ei[e]], pack.at[pack.ej[e]]
            p, size = unit(axpy(-1.0, load(q[k], i, pack.axes), load(q[k], j, pack.axes)))
            w = axpy(-1.0, load(v[k], i, pack.axes), load(v[k], j, pack.axes))
            stretch = size / pack.rest[e] - 1.0
            N = pack.EA[e] * stretch + pack.BA[e] * dot(p, w) / pack.rest[e]
            if not pack.push[e] and (stretch <= 0.0 or N < 0.0):
                N = 0.0
            tension[k, e] = N
            for m in range(len(pack.axes)):
                pack.p[e, m] = p[m]
        for i in range(segments + 1):  # kappa = 2 tan(theta/2)/dl, clamps against their direction
            if i == 0 or i == segments:
                other = pack.clamp[0] if i == 0 else pack.clamp[1]
                if other < 0:
                    continue
                c = dot(row(pack.p, 0 if i == 0 else segments - 1, pack.axes), row(pack.p, other, pack.axes))
            else:
                c = dot(row(pack.p, i - 1, pack.axes), row(pack.p, i, pack.axes))
            curvature[k, i] = 2.0 * math.sqrt(max(0.0, (1.0 - c) / max(1.0 + c, 1e-300))) / pack.dl[i]


class Sampled(NamedTuple):
    """The part of a pack that `section_forces` reads."""

    axes: tuple[float, ...]
    at: np.ndarray
    ei: np.ndarray
    ej: np.ndarray
    rest: np.ndarray
    EA: np.ndarray
    BA: np.ndarray
    push: np.ndarray
    dl: np.ndarray  # (n,) length over which a node's joint bends [m]
    clamp: np.ndarray  # (2,) phantom segment of ends A and B, -1 without a clamp
    p: np.ndarray


class LumpedModel:
    """A scene on a lumped mesh of about `segments` segments."""

    name = "lumped"

    def __init__(self, scene: sc.Scene, segments: int) -> None:
        self.scene = scene
        self.mesh: Mesh = make_mesh(scene, segments)
        self.basis = basis_of(scene)
        self.dim = len(self.basis)
        self.segments = len(self.mesh.s) - 1
        self.nodes = len(self.mesh.s)
        ends = [end for end in (scene.end_a, scene.end_b) if end.kind != "free"]
        self.breaks = breaks(ends)
        self.omega = top_omega(ends)
        anchor = next(
            (e.position for e in (scene.end_a, scene.end_b) if e.position is not None), (0.0, 0.0, 0.0)
        )
        if scene.start.shape:
            anchor = scene.start.shape[0]
        self.offset = np.array(anchor) - self.basis.T @ (self.basis @ np.array(anchor))
        self.pack: Lumped = discretise(scene, self.mesh, self.basis)
        self.static_pack = discretise(scene, self.mesh, self.basis, hold_free=scene.start.kind == "released")
        self.n_gaps = int((self.pack.slot >= 0).sum() + self.pack.cord.sum())
        self.ndof = len(self.pack.weight)

    # ------------------------------------------------------------------------------------------ start

    def starts(self) -> list[np.ndarray]:
        """First guesses of the static state, best first."""
        shape = hanging_shape(self.scene, self.mesh.s)
        return [self.place(x) for x in (shape, self.straight()) if x is not None]

    def settle(self, static: np.ndarray) -> None:
        """The static state is known: aim the slide directions by it."""
        self._aim(static[self.pack.at[: self.nodes, None] + np.arange(self.dim)])

    @property
    def static_tolerance(self) -> float:
        """A residual that is at rest: 1e-10 of the forces, or what rounding of the coordinates alone makes of the
        stiffest segment's force [N]."""
        ends = [np.abs(e.position).max() for e in (self.scene.end_a, self.scene.end_b) if e.position] or [0.0]
        far = float(max(ends)) + self.scene.length
        rounding = float((self.pack.EA / self.pack.rest).max()) * float(np.spacing(far))
        return max(1e-10 * self.force_scale, 8 * rounding)

    @property
    def reach(self) -> float:
        """Largest move of a dof in one static iteration [m]."""
        return 0.5 * float(self.pack.rest.min())

    @property
    def force_scale(self) -> float:
        """A force that matters in the static state [N]."""
        weight = np.abs(self.pack.load).sum() + np.abs(self.pack.dev_load).sum()
        return max(weight, 1e-9 * float(self.pack.EA.max()))

    def softened(self, q: np.ndarray) -> list[Lumped]:
        """The static pack with a limit on its axial stiffness, from the size of the loads up tenfold to the real one:
        a stiff axial spring makes the valley of the energy narrow, a soft one leads to it."""
        zero, r = np.zeros(self.ndof), np.zeros(self.ndof)
        call_residual(0.0, q, zero, zero, self.static_pack._replace(EA=0.0 * self.static_pack.EA), r)
        limit, hardest = float(np.abs(r).sum()), float(self.static_pack.EA.max())
        packs = []
        while 0 < limit < hardest:
            packs.append(self.static_pack._replace(EA=np.minimum(self.static_pack.EA, limit)))
            limit *= 10
        return [*packs, self.static_pack]

    def place(self, shape: np.ndarray) -> np.ndarray:
        """State vector with the cable's nodes at `shape` (n, 3), devices at rest."""
        q = np.zeros(self.ndof)
        flat = shape @ self.basis.T
        for i in range(self.nodes):
            q[self.pack.at[i] : self.pack.at[i] + self.dim] = flat[i]
        self._aim(flat)
        particle = self.nodes
        slide = 0
        for device, (i, j) in zip(self.scene.devices, self.mesh.mount, strict=True):
            if device.kind == "bnes_free":
                q[self.pack.at[particle] : self.pack.at[particle] + self.dim] = self._particle(
                    flat, device, i, j
                )
                particle += 1
                continue
            if isinstance(device, sc.BNES):
                q[self.pack.slot[slide]] = device.side * device.rest_offset
            slide += 1
        return q

    def _tangent(self, flat: np.ndarray, node: int) -> np.ndarray:
        chord = flat[self.pack.right[node]] - flat[self.pack.left[node]]
        return chord / np.linalg.norm(chord)

    def _particle(self, flat: np.ndarray, device: sc.BNES, i: int, j: int) -> np.ndarray:
        """A free mass starts where both its cords just touch, on its side."""
        middle, chord = (flat[i] + flat[j]) / 2, flat[j] - flat[i]
        size = float(np.linalg.norm(chord))
        if self.dim == 2:
            across = np.array([-chord[1], chord[0]]) / size
            aim = self.basis @ np.array(device.direction) if device.direction else np.array([1.0, 0.0])
            across *= 1.0 if across @ aim >= 0 else -1.0
        else:
            aim = np.array(device.direction if device.direction else (1.0, 0.0, 0.0))
            across = aim - chord * (aim @ chord) / size**2
            across /= np.linalg.norm(across)
        offset = math.sqrt(max(device.length**2 - (size / 2) ** 2, 0.0))
        return middle + device.side * offset * across

    def _aim(self, flat: np.ndarray) -> None:
        """Turn each slide direction to its given side; in the plane only its sign is left to choose."""
        attached = [(d, device) for d, device in enumerate(self.scene.devices) if device.kind != "bnes_free"]
        for a, (d, device) in enumerate(attached):
            if self.pack.slot[a] < 0:
                continue
            t = self._tangent(flat, int(self.pack.host[a, 0]))
            given = getattr(device, "direction", None)
            if self.dim == 2:
                aim = self.basis @ np.array(given) if given else np.array([1.0, 0.0])
                turned = np.array([1.0 if -t[1] * aim[0] + t[0] * aim[1] >= 0 else -1.0, 0.0])
            else:
                turned = np.array(given or ((1.0, 0.0, 0.0) if abs(t[0]) < 0.9 else (0.0, 1.0, 0.0)))
                if abs(turned @ t) > 0.985 * np.linalg.norm(turned):
                    raise CannotRepresent(f"devices[{d}].direction lies along the cable: a device slides across it")
            for pack in (self.pack, self.static_pack):
                pack.aim[a] = turned

    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """State of a start of kind `given`."""
        start = self.scene.start
        assert start.shape is not None
        shape = np.array(start.shape)
        at = np.array(start.s) if start.s else np.linspace(0, self.scene.length, len(shape))
        points = np.column_stack([np.interp(self.mesh.s, at, shape[:, m]) for m in range(3)])
        q, v = self.place(points), np.zeros(self.ndof)
        if start.velocity:
            speed = np.array(start.velocity)
            speed = np.repeat(speed, len(shape), axis=0) if len(speed) == 1 else speed
            flat = np.column_stack([np.interp(self.mesh.s, at, speed[:, m]) for m in range(3)]) @ self.basis.T
            for i in range(self.nodes):
                v[self.pack.at[i] : self.pack.at[i] + self.dim] = flat[i]
            particle = self.nodes
            for device, (i, j) in zip(self.scene.devices, self.mesh.mount, strict=True):
                if device.kind == "bnes_free":
                    v[self.pack.at[particle] : self.pack.at[particle] + self.dim] = (flat[i] + flat[j]) / 2
                    particle += 1
        return q, v

    def straight(self) -> np.ndarray:
        """A line between the ends, or along a clamp or the pull of a free end (n, 3)."""
        a, b = self.scene.end_a, self.scene.end_b
        s = self.mesh.s[:, None]
        if a.position is not None and b.position is not None:
            pa, pb = np.array(a.position), np.array(b.position)
            return pa + (pb - pa) * s / self.mesh.s[-1]
        held, sign = (a, 1.0) if a.position is not None else (b, -1.0)
        if held.direction is not None:
            along = np.array(held.direction) * sign
        elif self.scene.end_b.force is not None or self.scene.end_a.force is not None:
            along = np.array((self.scene.end_b if sign > 0 else self.scene.end_a).force)
        else:
            heavy = sum(x.length * x.wet(self.scene.density, self.scene.g) for x in self.scene.cable)
            heavy += sum(device_wet_weight(d, self.scene) for d in self.scene.devices)
            along = np.array([0.0, 0.0, -1.0 if heavy >= 0 else 1.0])
        along = along / np.linalg.norm(along)
        distance = s if sign > 0 else self.mesh.s[-1] - s
        return np.array(held.position) + along * distance

    # ------------------------------------------------------------------------------------------ quantities

    def shape(self, q: np.ndarray) -> np.ndarray:
        """(..., ndof) -> (..., n, 3) positions or velocities (without offset) of the cable's nodes."""
        index = self.pack.at[: self.nodes, None] + np.arange(self.dim)
        return q[..., index] @ self.basis

    def observe(
        self, q: np.ndarray, v: np.ndarray, force: np.ndarray, static: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Signals of samples q, v (nt, ndof) with forces at the prescribed dofs (nt, nfixed)."""
        nt = len(q)
        rest = self.shape(static)
        flat = static[self.pack.at[: self.nodes, None] + np.arange(self.dim)]
        tangent = np.array([self._tangent(flat, i) for i in range(self.nodes)]) @ self.basis
        tension, curvature = np.zeros((nt, self.segments)), np.zeros((nt, self.nodes))
        section_forces(np.ascontiguousarray(q), np.ascontiguousarray(v), self._sampled(), tension, curvature)
        ends = np.zeros((nt, 2, 3))
        for k, node in enumerate(self.pack.held):
            ends[:, 0 if node == 0 else 1] = force[:, k * self.dim : (k + 1) * self.dim] @ self.basis
        density = np.array([self.scene.cable[k].mass for k in self.mesh.section])
        return {
            "arc": self.mesh.s, "static_position": rest + self.offset, "static_tangent": tangent,
            "span_mass": density * np.diff(self.mesh.s), "rigid": self.mesh.rod.astype(float),
            "position": self.shape(q) + self.offset, "velocity": self.shape(v), "tension": tension,
            "curvature": curvature, "end_force": ends, "stroke": self._strokes(q),
        }  # fmt: skip

    def slack(self, signals: dict[str, np.ndarray]) -> bool:
        """Whether a segment that carries no compression goes slack."""
        limp = ~self.pack.push[: self.segments]
        return bool(limp.any() and (signals["tension"][:, limp] <= 0).any())

    def validity(self, signals: dict[str, np.ndarray]) -> tuple[Status, str]:
        """Nothing that a run does leaves this line's range."""
        return Status.OK, ""

    def drift_error(self, static: np.ndarray) -> float:
        """Estimated relative error of the line's kinematics in a static state: exact here."""
        return 0.0

    def range_error(self) -> float:
        """Estimated relative error of the line's kinematics: exact here."""
        return 0.0

    def _sampled(self) -> Sampled:
        p = self.pack
        soft = np.diff(self.mesh.s) * ~self.mesh.rod / 2
        dl = np.concatenate([soft, [0.0]]) + np.concatenate([[0.0], soft])
        clamp, phantom = [-1, -1], len(p.rest)
        for k, end in enumerate((self.scene.end_a, self.scene.end_b)):
            section = self.scene.cable[self.mesh.section[0 if k == 0 else -1]]
            if end.kind == "clamped" and section.EI > 0:
                clamp[k] = phantom
                phantom += 1
        return Sampled(p.axes, p.at, p.ei, p.ej, p.rest, p.EA, p.BA, p.push, dl, np.array(clamp), p.p.copy())

    def _strokes(self, q: np.ndarray) -> np.ndarray:
        """Offset of each device's mass along its slide direction; 0 for a mass that is fixed."""
        out = np.zeros((len(q), len(self.scene.devices)))
        particle, a = self.nodes, 0
        if not len(q):  # a run that ended before its first sample
            return out
        for d, (device, (i, j)) in enumerate(zip(self.scene.devices, self.mesh.mount, strict=True)):
            if device.kind == "bnes_free":
                x, y, z = (q[:, self.pack.at[k] : self.pack.at[k] + self.dim] for k in (i, j, particle))
                offset, chord = z - (x + y) / 2, y - x
                along = chord / np.linalg.norm(chord, axis=1)[:, None]
                aim = self.basis @ np.array(device.direction or (1.0, 0.0, 0.0))
                if self.dim == 2:
                    side = 1.0 if -along[0, 1] * aim[0] + along[0, 0] * aim[1] >= 0 else -1.0
                    out[:, d] = side * (-along[:, 1] * offset[:, 0] + along[:, 0] * offset[:, 1])
                else:
                    across = offset - along * (offset * along).sum(axis=1)[:, None]
                    out[:, d] = np.linalg.norm(across, axis=1) * np.sign(across @ aim)
                particle += 1
                continue
            if self.pack.slot[a] >= 0:
                out[:, d] = q[:, self.pack.slot[a]]
            a += 1
        return out

    # ------------------------------------------------------------------------------------------ guards

    def fastest(self, static: np.ndarray) -> dict[str, float]:
        """Highest angular frequencies by kind [rad/s]: axial, tension, bending, device; `decay`, the largest size of
        an eigenvalue when the axial damping BA is counted (beyond critical damping it grows as 1/l^2), and `struck`,
        that of a device with its damper."""
        p, S = self.pack, [self.scene.cable[k] for k in self.mesh.section]
        l, soft = np.diff(self.mesh.s), ~self.mesh.rod
        m = np.array([x.mass for x in S])
        added = np.array([self.scene.density * x.Can * math.pi / 4 * x.d**2 for x in S])
        tension = np.maximum(self.static_tension(static), 0.0)
        EI = np.array([x.EI for x in S])
        # axial: Gershgorin's bound of M^-1 K and M^-1 C, node by node; exact in the limit of many equal segments
        inertia = np.array(p.mass[: self.nodes] + p.mt[: self.nodes])
        for e, mass in zip(p.rod, p.rod_m + p.rod_mt, strict=True):
            inertia[[e, e + 1]] += mass / 6  # the least eigenvalue of a rod's consistent mass
        for (i, j), mass in zip(p.host, p.dev_mass, strict=True):
            inertia[i] += mass if i == j else 0.0
        stiff, damp = np.zeros(self.nodes), np.zeros(self.nodes)
        for total, value in ((stiff, p.EA), (damp, p.BA)):
            each = 2 * value[: self.segments] / l
            total[:-1] += each
            total[1:] += each
        free = p.free[: self.nodes] & (inertia > 0)
        if not free.any():
            free, stiff, inertia = np.ones(1, dtype=bool), np.zeros(1), np.ones(1)
        square, half = stiff[free] / inertia[free], damp[: len(free)][free] / (2 * inertia[free])
        out = {
            "axial": float(np.sqrt(square.max())),
            "decay": float(np.maximum(np.sqrt(square), half + np.sqrt(np.maximum(half**2 - square, 0))).max()),
            "tension": float((2 / l * np.sqrt(tension / (m + added)))[soft].max()),
            "bending": float((4 / l**2 * np.sqrt(EI / (m + added)))[soft].max()),
            "device": 0.0, "struck": 0.0,
        }  # fmt: skip
        found = []
        for a in range(len(p.slot)):
            if p.slot[a] < 0:
                continue
            i, j = p.host[a]
            mh = p.weight[p.at[i]] + (p.weight[p.at[j]] if i != j else 0.0) - p.dev_mass[a]
            found.append(contact_rates(p.law[a], 1 / p.dev_mass[a] + 1 / mh))
        for e in np.flatnonzero(p.cord):
            mh, M = p.weight[p.at[p.ei[e]]], p.weight[p.at[p.ej[e]]]
            pair = (LINEAR, 2 * p.EA[e] / p.rest[e], 2 * p.BA[e] / p.rest[e], 1.0, 1.0)
            found.append(contact_rates(pair, 1 / M + 1 / mh))
        if found:
            out["device"], out["struck"] = (max(rates) for rates in zip(*found, strict=True))
        return out

    def static_tension(self, static: np.ndarray) -> np.ndarray:
        """Tension of the cable's segments in a state at rest [N]."""
        tension, curvature = np.zeros((1, self.segments)), np.zeros((1, self.nodes))
        section_forces(static[None], np.zeros((1, self.ndof)), self._sampled(), tension, curvature)
        return tension[0]

    def guards(self, static: np.ndarray) -> tuple[Status, str, float]:
        """Status, sentence and nodes per shortest transverse wave of the excitation, from the static state."""
        l, soft = np.diff(self.mesh.s), ~self.mesh.rod
        S = [self.scene.cable[k] for k in self.mesh.section]
        tension = self.static_tension(static)
        pushed = self.pack.push[: self.segments] & soft & (tension < -1e-9 * self.pack.EA[: self.segments])
        limp = pushed & np.array([x.EI == 0 for x in S])
        if limp.any():  # grows as k sqrt(|T|/m): the shorter the wave, the faster
            return (
                Status.UNRESOLVED,
                f"{int(limp.sum())} segments are compressed, by up to {-tension[limp].min():.3g} N, and do not bend: "
                "no mesh resolves what buckles; give the cable an `EI`, or `compression: false`",
                math.nan,
            )
        tension = np.maximum(tension, 0.0)
        nodes = math.inf
        for e in np.flatnonzero(soft):
            EI, T = S[e].EI, tension[e]
            if self.omega == 0 or (EI == 0 and T == 0):
                continue
            m = S[e].mass + self.scene.density * S[e].Can * math.pi / 4 * S[e].d ** 2
            inertia = m * self.omega**2
            square = 2 * inertia / (math.sqrt(T * T + 4 * EI * inertia) + T)
            nodes = min(nodes, 2 * math.pi / math.sqrt(square) / l[e])
        for end, last in ((self.scene.end_a, 0), (self.scene.end_b, self.segments - 1)):
            if end.kind == "clamped" and S[last].EI > 0 and tension[last] > 0:
                layer = math.sqrt(S[last].EI / tension[last])
                if l[last] > layer:
                    return (
                        Status.UNRESOLVED,
                        f"segments of {l[last]:.3g} m at a clamp, where bending decays over {layer:.3g} m",
                        nodes,
                    )
        if nodes < LEAST_NODES_PER_WAVE:
            return (
                Status.UNRESOLVED,
                f"{nodes:.1f} nodes in the shortest wave of the excitation; {LEAST_NODES_PER_WAVE:g} "
                "are needed",
                nodes,
            )
        slack = int(np.sum(~self.pack.push[: self.segments] & (self.static_tension(static) <= 0)))
        note = f"{slack} segments that carry no compression are slack at rest" if slack else ""
        return Status.OK, note, nodes


def build(scene: sc.Scene, segments: int) -> Any:
    """A LumpedModel of the scene."""
    return LumpedModel(scene, segments)
