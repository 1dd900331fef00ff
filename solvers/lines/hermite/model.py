"""The Hermite line as a Model: discretised scene, start, quantities, guards."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from ... import scene as sc
from ...catenary import hanging_shape
from ...dispatch import call_residual, provides
from ...geometry import basis_of
from ...model import CannotRepresent, Status
from ...motion import breaks, top_omega
from . import kernels
from .params import (
    POINTS,
    Hermite,
    Mesh,
    diagonal,
    discretise,
    inertia_of,
    make_mesh,
    shapes,
    share_of_bending,
)

provides(
    Hermite, drive=kernels.drive, residual=kernels.residual, tangent=kernels.tangent, accelerate=kernels.accelerate,
    energies=kernels.energies, gaps=kernels.gaps, heft=kernels.heft,
)  # fmt: skip

LEAST_NODES_PER_WAVE = 4.0  # an element of k h = pi/2 has its waves too fast by 0.3 % (uncorrected)
LAYERS = 2.0  # an element may span this many decay lengths of bending at a clamp: its curvature is then off by 5 %
TURN = 1.2  # largest turn of the line within an element [rad]
STATIONS = 4  # samples of each element in the signals: metrics take straight lines between them
BEST = np.array([0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12)])  # where r'' of a cubic is of one order more


@njit(cache=True)
def sample(q, v, pack, h, ratio, shape, bent, position, velocity, tension, curvature):
    """Position and velocity at the stations, tension at Gauss points, signed curvature at `bent`, of states (nt, ndof).

    h : (m,) length of the elements [m], ratio : (m,) the same over the scale of the slopes; shape : (stations, 3)
    functions of r, bent : (points, 6) of its first two derivatives, on the unit element.
    """
    last = len(pack.EA) - 1
    S = pack.shape
    for k in range(len(q)):
        for e in range(last + 1):
            y, w = kernels.gather(q[k], e, pack), kernels.gather(v[k], e, pack)
            for j in range(len(shape)):
                i = e * len(shape) + j
                n, a, b = shape[j, 0], ratio[e] * shape[j, 1], ratio[e] * shape[j, 2]
                for m in range(2):
                    position[k, i, m] = y[6 + m] + n * y[m] + a * y[2 + m] + b * y[4 + m]
                    velocity[k, i, m] = w[6 + m] + n * w[m] + a * w[2 + m] + b * w[4 + m]
            if e == last:
                for m in range(2):
                    position[k, -1, m], velocity[k, -1, m] = y[6 + m] + y[m], w[6 + m] + w[m]
            less = kernels.relief(y, w, e, pack)
            for g in range(3):
                px, pz = kernels.at(y, S[e, g, 3], S[e, g, 4], S[e, g, 5])
                ux, uz = kernels.at(w, S[e, g, 3], S[e, g, 4], S[e, g, 5])
                size = math.sqrt(px * px + pz * pz)
                rate = (px * ux + pz * uz) / size if size > 0.0 else 0.0
                tension[k, e, g] = kernels.pull(e, size - 1.0, rate, pack) - kernels.p2(g) * less
            for j in range(len(bent)):
                f = ratio[e]
                px, pz = kernels.at(y, bent[j, 0], f * bent[j, 1], f * bent[j, 2])
                cx, cz = kernels.at(y, bent[j, 3], f * bent[j, 4], f * bent[j, 5])
                square = px * px + pz * pz
                curvature[k, e, j] = (px * cz - pz * cx) / (square * h[e]) if square > 0.0 else 0.0


class HermiteModel:
    """A planar scene on about `segments` cubic elements.

    Raises
    ------
    CannotRepresent
        With the name of the field, for devices and for scenes that do not lie in a vertical plane.
    """

    name = "hermite"
    n_gaps = 0

    def __init__(self, scene: sc.Scene, segments: int) -> None:
        refuse(scene)
        self.scene = scene
        self.mesh: Mesh = make_mesh(scene, segments)
        self.basis = basis_of(scene)
        self.h = np.diff(self.mesh.s)
        self.elements = len(self.h)
        self.scale = float(self.mesh.s[-1]) / self.elements
        self.segments = STATIONS * self.elements
        ends = [end for end in (scene.end_a, scene.end_b) if end.kind != "free"]
        self.breaks = breaks(ends)
        self.omega = top_omega(ends)
        positions = [end.position for end in (scene.end_a, scene.end_b) if end.position is not None]
        anchor = np.array(scene.start.shape[0] if scene.start.shape else (positions or [(0.0, 0.0, 0.0)])[0])
        self.offset = anchor - self.basis.T @ (self.basis @ anchor)
        self.pack: Hermite = discretise(scene, self.mesh, self.basis)
        self.static_pack = discretise(scene, self.mesh, self.basis, hold_free=scene.start.kind == "released")
        self.ndof = len(self.pack.weight)
        self.S = [scene.cable[k] for k in self.mesh.section]
        self.mass = np.array([x.mass for x in self.S])
        self.added = np.array([scene.density * x.Can * math.pi / 4 * x.d**2 for x in self.S])
        self.EI = np.array([x.EI for x in self.S])
        at = np.arange(STATIONS) / STATIONS
        self.stations = np.append((self.mesh.s[:-1, None] + np.outer(self.h, at)).ravel(), self.mesh.s[-1])
        self._shape = _three(at, 0)
        self._bent = np.hstack([_three(np.append(at[1:], BEST), 1), _three(np.append(at[1:], BEST), 2)])
        kernels.factor_inertia(np.zeros(self.ndof), self.pack)

    # ------------------------------------------------------------------------------------------ start

    def starts(self) -> list[np.ndarray]:
        """First guesses of the static state, best first."""
        found = [self.place(self.straight)]
        if hanging_shape(self.scene, self.mesh.s) is not None:
            found.insert(0, self.place(lambda s: hanging_shape(self.scene, s)))
        return found

    def softened(self, q: np.ndarray) -> list[Hermite]:
        """The static pack with a limit on its axial stiffness, from the size of the loads up tenfold to the real one:
        a stiff axial spring makes the valley of the energy narrow, a soft one leads to it."""
        zero, r = np.zeros(self.ndof), np.zeros(self.ndof)
        soft = self.static_pack._replace(EA=0.0 * self.static_pack.EA, yields=0.0 * self.static_pack.yields)
        call_residual(0.0, q, zero, zero, soft, r)
        limit, hardest = float(np.abs(r).sum()), float(self.static_pack.EA.max())
        packs = []
        while 0 < limit < hardest:
            EA = np.minimum(self.static_pack.EA, limit)
            packs.append(self.static_pack._replace(EA=EA, yields=self.static_pack.yields * EA / self.static_pack.EA))
            limit *= 10
        return [*packs, self.static_pack]

    def settle(self, static: np.ndarray) -> None:
        """The static state is known: correct the inertia by the share of the stiffness that its tension leaves to
        bending."""
        bending = share_of_bending(self.h, self.EI, self.static_tension(static))
        self.pack.inertia[:] = inertia_of(self.h, self.scale, self.mass + self.added, bending)
        self.pack.weight[:] = diagonal(self.pack.inertia)
        kernels.factor_inertia(static, self.pack)

    @property
    def static_tolerance(self) -> float:
        """A residual that is at rest: 1e-10 of the forces, or what rounding of the coordinates alone makes of the
        stiffest element's force [N]."""
        ends = [np.abs(e.position).max() for e in (self.scene.end_a, self.scene.end_b) if e.position] or [0.0]
        far = float(max(ends)) + self.scene.length
        rounding = float((self.pack.EA / self.h).max()) * float(np.spacing(far))
        force = max(float(np.abs(self.pack.load).sum()), 1e-9 * float(self.pack.EA.max()))
        return max(1e-10 * force, 16 * rounding)

    @property
    def reach(self) -> float:
        """Largest move of a dof in one static iteration [m]."""
        return 0.5 * float(self.h.min())

    def place(self, shape: Any) -> np.ndarray:
        """State whose nodes lie on the curve `shape`, arc lengths (n,) -> points or velocities (n, 3) [m].

        Slopes are mean ones over half an element, so that a kink at a node turns halfway.
        """
        s, total = self.mesh.s, self.mesh.s[-1]
        flat = shape(s) @ self.basis.T
        reach = np.minimum(np.append(self.h, np.inf), np.append(np.inf, self.h)) / 4
        low, high = np.maximum(s - reach, 0.0), np.minimum(s + reach, total)
        slope = (shape(high) - shape(low)) @ self.basis.T / (high - low)[:, None]
        for k, node in enumerate((0, -1)):
            c, z = self.pack.turn[k]
            slope[node] = slope[node] @ np.array([[c, -z], [z, c]])
        return np.hstack([flat, self.scale * slope]).ravel()

    def straight(self, s: np.ndarray) -> np.ndarray:
        """Points of a line between the ends, or along a clamp or the pull of a free end (n, 3)."""
        a, b, length = self.scene.end_a, self.scene.end_b, self.mesh.s[-1]
        if a.position is not None and b.position is not None:
            pa, pb = np.array(a.position), np.array(b.position)
            return pa + (pb - pa) * s[:, None] / length
        held, sign = (a, 1.0) if a.position is not None else (b, -1.0)
        if held.direction is not None:
            along = np.array(held.direction) * sign
        elif self.scene.end_b.force is not None or self.scene.end_a.force is not None:
            along = np.array((self.scene.end_b if sign > 0 else self.scene.end_a).force)
        else:
            heavy = sum(x.length * x.wet(self.scene.density, self.scene.g) for x in self.scene.cable)
            along = np.array([0.0, 0.0, -1.0 if heavy >= 0 else 1.0])
        along = along / np.linalg.norm(along)
        return np.array(held.position) + along * (s if sign > 0 else length - s)[:, None]

    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """State of a start of kind `given`."""
        start = self.scene.start
        assert start.shape is not None
        shape = np.array(start.shape)
        at = np.array(start.s) if start.s else np.linspace(0, self.scene.length, len(shape))

        def along(values: np.ndarray) -> Any:
            return lambda s: np.column_stack([np.interp(s, at, values[:, m]) for m in range(3)])

        q, v = self.place(along(shape)), np.zeros(self.ndof)
        if start.velocity:
            speed = np.array(start.velocity)
            v = self.place(along(np.repeat(speed, len(shape), axis=0) if len(speed) == 1 else speed))
        self.settle(q)
        return q, v

    # ------------------------------------------------------------------------------------------ quantities

    def observe(self, q: np.ndarray, v: np.ndarray, force: np.ndarray, static: np.ndarray) -> dict[str, np.ndarray]:
        """Signals of samples q, v (nt, ndof) with forces at the prescribed dofs (nt, nfixed), at STATIONS equal parts
        of each element; tension in the middle between them."""
        at, speed, tension, curvature = self._sampled(q, v)
        rest = self._sampled(static[None], np.zeros((1, self.ndof)))[0][0]
        slope = np.zeros((self.elements, STATIONS, 2))
        dofs = self._dofs(static)
        for j in range(STATIONS):
            slope[:, j] = np.tensordot(dofs, shapes(np.array(j / STATIONS), 1), axes=(1, 0))
        last = np.tensordot(dofs[-1], shapes(np.array(1.0), 1), axes=(0, 0))
        tangent = np.vstack([slope.reshape(-1, 2), last]) @ self.basis
        tangent /= np.linalg.norm(tangent, axis=1)[:, None]
        ends = np.zeros((len(q), 2, 3))
        k = 0
        for node, aim in zip(self.pack.held, self.pack.aim, strict=True):
            ends[:, 0 if node == 0 else 1] = force[:, k : k + 2] @ self.basis
            k += 3 if aim.any() else 2
        return {
            "arc": self.stations, "static_position": rest @ self.basis + self.offset, "static_tangent": tangent,
            "span_mass": np.repeat(self.mass * self.h / STATIONS, STATIONS), "rigid": np.zeros(self.segments),
            "position": at @ self.basis + self.offset, "velocity": speed @ self.basis, "tension": tension,
            "curvature": np.abs(curvature), "end_force": ends, "stroke": np.zeros((len(q), 0)),
        }  # fmt: skip

    def _dofs(self, q: np.ndarray) -> np.ndarray:
        """(m, 4, 2) ends and slopes (times the element's length) of each element."""
        nodes = q.reshape(-1, 2, 2).copy()
        for k, node in enumerate((0, -1)):
            c, s = self.pack.turn[k]
            nodes[node, 1] = np.array([[c, -s], [s, c]]) @ nodes[node, 1]
        dofs = np.concatenate([nodes[:-1], nodes[1:]], axis=1)
        dofs[:, 1::2] *= (self.h / self.scale)[:, None, None]
        return dofs

    def _sampled(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity (nt, k, 2), tension (nt, k - 1) and signed curvature (nt, k) at the stations."""
        nt, m = len(q), self.elements
        at, speed = np.zeros((nt, self.segments + 1, 2)), np.zeros((nt, self.segments + 1, 2))
        pull, bend = np.zeros((nt, m, 3)), np.zeros((nt, m, len(self._bent)))
        q, v = np.ascontiguousarray(q), np.ascontiguousarray(v)
        sample(q, v, self.pack, self.h, self.h / self.scale, self._shape, self._bent, at, speed, pull, bend)
        middle = (np.arange(STATIONS) + 0.5) / STATIONS
        tension = (pull @ _lagrange(POINTS, middle).T).reshape(nt, self.segments)
        if not self.pack.push.all():
            limp = np.repeat(~self.pack.push, STATIONS)
            tension[:, limp] = np.maximum(tension[:, limp], 0.0)
        curvature = np.zeros((nt, self.segments + 1))
        inner = curvature[:, :-1].reshape(nt, m, STATIONS)
        inner[:, :, 1:] = bend[:, :, : STATIONS - 1]
        best = bend[:, :, STATIONS - 1 :]
        wide = self.h[1:] + self.h[:-1]
        inner[:, 1:, 0] = (best[:, :-1, 1] * self.h[1:] + best[:, 1:, 0] * self.h[:-1]) / wide
        first = (self.mesh.s[:-1, None] + np.outer(self.h, BEST)).ravel()
        few = slice(0, 4), slice(-4, None)
        for k, (x, part) in enumerate(zip((0.0, float(self.mesh.s[-1])), few, strict=True)):
            known = best.reshape(nt, m * best.shape[2])[:, part]
            curvature[:, -k] = known @ _lagrange(first[part], np.array([x]))[0]
        return at, speed, tension, curvature

    def static_tension(self, static: np.ndarray) -> np.ndarray:
        """Mean tension of the elements in a state at rest (m,) [N]."""
        pull = self._sampled(static[None], np.zeros((1, self.ndof)))[2]
        return pull.reshape(self.elements, STATIONS).mean(axis=1)

    def slack(self, signals: dict[str, np.ndarray]) -> bool:
        """Whether a section that carries no compression goes slack."""
        limp = np.repeat(~self.pack.push, STATIONS)
        return bool(limp.any() and (signals["tension"][:, limp] <= 0).any())

    def validity(self, signals: dict[str, np.ndarray]) -> tuple[Status, str]:
        """Whether a run stayed where cubic elements follow it: none may turn by more than TURN."""
        if "curvature" not in signals or not len(signals["curvature"]):
            return Status.OK, ""
        row, k, turn = self._turn(signals["curvature"])
        if turn <= TURN:
            return Status.OK, ""
        return Status.UNRESOLVED, f"element {k} turns by {turn:.2g} rad in sample {row}; {TURN:g} is the most"

    def _turn(self, curvature: np.ndarray) -> tuple[int, int, float]:
        """Sample and element that turn most, and by how much [rad]; not a number counts as most."""
        inner = np.abs(curvature[:, :-1]).reshape(len(curvature), self.elements, STATIONS)
        turn = np.nan_to_num(inner.mean(axis=2) * self.h, nan=math.inf)
        row, k = np.unravel_index(int(np.argmax(turn)), turn.shape)
        return int(row), int(k), float(turn[row, k])

    def drift_error(self, static: np.ndarray) -> float:
        """Estimated relative error of the line's kinematics in a static state: exact here."""
        return 0.0

    def range_error(self) -> float:
        """Estimated relative error of the line's kinematics: exact here."""
        return 0.0

    # ------------------------------------------------------------------------------------------ guards

    def fastest(self, static: np.ndarray) -> dict[str, float]:
        """Highest angular frequencies by kind [rad/s]: axial, tension, bending; and `decay`, the largest size of an
        eigenvalue when the damping BA is counted. Each is the largest of a long line of equal elements, none less than
        that of any line: 6.48/h (42 in its square) along a string, 50.2/h2 (2520) across a beam."""
        tension = np.maximum(self.static_tension(static), 0.0)
        along = np.array([self.scene.density * x.Cat * math.pi / 4 * x.d**2 for x in self.S]) + self.mass
        square, half = 42.0 / self.h**2 * self.pack.EA / along, 21.0 / self.h**2 * self.pack.BA / along
        return {
            "axial": float(np.sqrt(square.max())),
            "decay": float(np.maximum(np.sqrt(square), half + np.sqrt(np.maximum(half**2 - square, 0))).max()),
            "tension": float(np.sqrt(42.0 / self.h**2 * tension / (self.mass + self.added)).max()),
            "bending": float(np.sqrt(2520.0 / self.h**4 * self.EI / (self.mass + self.added)).max()),
            "device": 0.0,
        }

    def guards(self, static: np.ndarray) -> tuple[Status, str, float]:
        """Status, sentence and nodes per shortest transverse wave of the excitation, from the static state."""
        tension = np.maximum(self.static_tension(static), 0.0)
        nodes = math.inf
        if self.omega > 0:
            inertia = (self.mass + self.added) * self.omega**2
            stiff = np.sqrt(tension**2 + 4 * self.EI * inertia) + tension
            square = 2 * inertia / np.where(stiff > 0, stiff, math.inf)
            with np.errstate(divide="ignore"):
                nodes = float((2 * math.pi / np.sqrt(square) / self.h).min())
        for end, e in ((self.scene.end_a, 0), (self.scene.end_b, -1)):
            if end.kind == "clamped" and self.EI[e] > 0 and tension[e] > 0:
                layer = math.sqrt(self.EI[e] / tension[e])
                if self.h[e] > LAYERS * layer:
                    wide = f"elements of {self.h[e]:.3g} m at a clamp, where bending decays over {layer:.3g} m"
                    return Status.UNRESOLVED, wide, nodes
        if nodes < LEAST_NODES_PER_WAVE:
            few = f"{nodes:.1f} nodes in the shortest wave of the excitation; {LEAST_NODES_PER_WAVE:g} are needed"
            return Status.UNRESOLVED, few, nodes
        _, k, turn = self._turn(self._sampled(static[None], np.zeros((1, self.ndof)))[3])
        if turn > TURN:
            return Status.UNRESOLVED, f"element {k} turns by {turn:.2g} rad at rest; {TURN:g} is the most", nodes
        slack = int(np.sum(~self.pack.push & (self.static_tension(static) <= 0)))
        return Status.OK, f"{slack} elements that carry no compression are slack at rest" if slack else "", nodes


def _three(x: np.ndarray, order: int) -> np.ndarray:
    """(n, 3) shape functions of r_1, slope 0, slope 1 on the unit element, or their derivatives."""
    found = shapes(x, order)
    return np.ascontiguousarray(np.stack([found[2], found[1], found[3]], axis=1))


def _lagrange(known: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(len(at), len(known)) weights of the values at `known` in the polynomial through them, at `at`."""
    out = np.ones((len(at), len(known)))
    for k, x in enumerate(known):
        for other in np.delete(known, k):
            out[:, k] *= (at - other) / (x - other)
    return out


def refuse(scene: sc.Scene) -> None:
    """Raises CannotRepresent for what the line has no equations for, by the name of the field."""
    if scene.devices:
        raise CannotRepresent(f"devices[0].kind: {scene.devices[0].kind}; hermite carries no devices")
    if len(basis_of(scene)) == 3:
        raise CannotRepresent("end_a, end_b, water.current: not in one vertical plane; hermite is planar")


def build(scene: sc.Scene, segments: int) -> Any:
    """A HermiteModel of the scene."""
    return HermiteModel(scene, segments)
