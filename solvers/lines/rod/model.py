"""Rods, catenaries and hybrids of both as a Model: domains, start, quantities, guards."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from ... import scene as sc
from ...catenary import hanging_shape
from ...dispatch import provides
from ...model import Ask, CannotRepresent, Status
from ...motion import breaks, top_omega
from . import kernels
from .params import Rod, discretise, matrix, mesh_of, quaternion, rotated

provides(
    Rod, drive=kernels.drive, residual=kernels.residual, tangent=kernels.tangent, energies=kernels.energies,
    factorise=kernels.factorise, backsolve=kernels.backsolve, heft=kernels.heft, constrained=kernels.constrained,
)  # fmt: skip

LEAST_NODES_PER_WAVE = 8.0  # as the lumped line: the box scheme is of the same order, with an error half as large
LARGEST_TURN = 0.5  # of the frame over one element [rad]: its square over 24 is the error of the element
LEAST_TENSION = 1e-3  # of a catenary domain, as a share of the loads


class RodModel:
    """A scene on about `segments` elements, those where `rod` says so as rods, the others as catenaries.

    Parameters
    ----------
    rod : (m,) bool, or sequence of (from, to) arc lengths [m]
    rho : float
        Spectral radius at infinity of generalised-alpha in space: 1 is the box scheme, which closes the energy balance
        and never damps a sawtooth; lower values damp it along s.

    Raises
    ------
    CannotRepresent
        For what no line of this family has (devices, internal damping), and for what a catenary domain cannot do: hold
        a direction, carry a moment, pass on torque, bend naturally.
    """

    n_gaps = 0

    def __init__(self, scene: sc.Scene, segments: int, rod: Any, rho: float = 1.0, name: str = "rod") -> None:
        self.scene, self.asked, self.rho, self.name = scene, segments, rho, name
        self.s, self.section = mesh_of(scene, segments)
        middle = (self.s[1:] + self.s[:-1]) / 2
        if len(rod) and np.ndim(rod[0]) == 1:
            beyond = [pair for pair in rod if not 0 <= pair[0] < pair[1] <= self.s[-1] * (1 + 1e-9)]
            if beyond:
                raise CannotRepresent(f"{name}: rods {beyond} are off the cable (0 to {self.s[-1]:g} m)")
            rod = np.any([(a <= middle) & (middle <= b) for a, b in rod], axis=0)
        self.rod = np.array(rod, dtype=bool) if len(rod) else np.zeros(len(middle), dtype=bool)
        self.segments, self.nodes = len(self.s) - 1, len(self.s)
        self._refuse()
        ends = [end for end in (scene.end_a, scene.end_b) if end.kind != "free"]
        self.breaks = tuple(sorted({*breaks(ends), *self._turning()}))
        self.omega = top_omega(ends)
        self.pack: Rod = discretise(scene, self.s, self.section, self.rod, rho)
        self.static_pack = self.pack
        if scene.start.kind == "released":
            held = replace(scene, end_a=self._held(scene.end_a), end_b=self._held(scene.end_b))
            self.static_pack = discretise(held, self.s, self.section, self.rod, rho)
        self.ndof = len(self.pack.weight)

    def _turning(self) -> set[float]:
        turns = [end.twist for end in (self.scene.end_a, self.scene.end_b) if isinstance(end.twist, sc.Turn)]
        return {x for turn in turns for x in (turn.t[0], turn.t[-1])}

    @staticmethod
    def _held(end: sc.End) -> sc.End:
        if end.kind != "free" or end.position is None:
            return end
        return replace(end, kind="pinned" if end.direction is None else "clamped", force=None)

    def _refuse(self) -> None:
        scene, wrong = self.scene, []
        for k, x in enumerate(scene.cable):
            if x.BA > 0 or x.BI > 0:
                wrong.append(f"cable[{k}] has internal damping (BA, BI): use `lumped`, or numerical damping (rho < 1)")
            here = self.rod[self.section == k]
            if here.any() and x.EI > 0 and not x.carries_compression:
                wrong.append(f"cable[{k}] carries no compression, which a rod does: `compression: true`, or `lumped`")
            if here.any() and x.EI == 0:
                wrong.append(f"cable[{k}] has EI = 0: a rod needs bending stiffness; `catenary` does without")
            if not here.all() and (any(x.curvature) or any(x.moment) or x.coupling):
                wrong.append(f"cable[{k}] has curvature, moment or coupling, which only `rod` carries")
        if scene.devices:
            wrong.append("devices: use `lumped`")
        for name, end, near in (("end_a", scene.end_a, self.rod[0]), ("end_b", scene.end_b, self.rod[-1])):
            if not near and (end.direction is not None or end.moment is not None):
                wrong.append(
                    f"{name} holds a direction or takes a moment, which a catenary cannot: make it a rod there"
                )
        if self.twisted(scene) and not self.rod.all():
            wrong.append(
                "the ends twist the cable, and a catenary or a moment-free joint passes on no torque: use `rod`"
            )
        if wrong:
            raise CannotRepresent(f"{self.name}: " + "; ".join(wrong))

    @staticmethod
    def twisted(scene: sc.Scene) -> bool:
        """Whether torque reaches the cable's inside: an end is turned about its direction."""
        ends = (scene.end_a, scene.end_b)
        return any(end.twist != 0.0 for end in ends)

    @property
    def flexible(self) -> np.ndarray:
        """(n,) bool: nodes of catenary domains, joints included, where the force lies along the line."""
        return np.concatenate([[False], ~self.rod]) | np.concatenate([~self.rod, [False]])

    # ------------------------------------------------------------------------------------------ start

    reach = math.nan  # statics of this family are scaled by `pack.size` and `pack.unit`
    static_tolerance = math.nan

    def starts(self) -> list[np.ndarray]:
        """First guesses of the static state, best first."""
        shape = hanging_shape(self.scene, self.s)
        return [self.place(x) for x in (shape, self._bowed(), self._straight()) if x is not None]

    def softened(self, q: np.ndarray) -> list[Any]:
        """Continuation is by load here."""
        return [self.static_pack]

    def settle(self, static: np.ndarray) -> None:
        """Nothing depends on the static state."""

    def _straight(self) -> np.ndarray:
        a, b, s = self.scene.end_a, self.scene.end_b, self.s[:, None]
        if (
            a.position is not None
            and b.position is not None
            and (b.kind != "free" or self.scene.start.kind != "static")
        ):
            pa, pb = np.array(a.position), np.array(b.position)
            return pa + (pb - pa) * s / self.s[-1]
        from_a = a.kind != "free" or b.kind == "free"
        held, other = (a, b) if from_a else (b, a)
        along = next((np.array(x) for x in (held.direction, other.direction) if x is not None), None)
        if along is None:
            along = np.array(other.force if other.force is not None else (0.0, 0.0, -1.0))
            along = along if from_a else -along
        along = along / np.linalg.norm(along)
        return np.array(held.position) + along * (s if from_a else s - self.s[-1])

    def _bowed(self) -> np.ndarray | None:
        """An arc of the cable's length between two held ends that are nearer: about what bending alone would make."""
        a, b = self.scene.end_a, self.scene.end_b
        if not self.rod.all() or a.position is None or b.position is None or len(self.static_pack.held) < 2:
            return None
        pa, pb = np.array(a.position), np.array(b.position)
        chord = float(np.linalg.norm(pb - pa))
        if not 0 < chord < (1 - 1e-9) * self.s[-1]:
            return None
        x = (pb - pa) / chord
        # the side: that of the clamps if they lean out, else downwards
        lean = sum(sign * np.array(end.direction) for sign, end in ((1, a), (-1, b)) if end.direction is not None)
        side = np.array(lean) - x * (x @ np.array(lean)) if np.ndim(lean) else np.zeros(3)
        if np.linalg.norm(side) < 1e-9:
            side = np.array([0.0, 0.0, -1.0]) - x * -x[2]
        if np.linalg.norm(side) < 1e-9:
            side = np.array([1.0, 0.0, 0.0])
        side = side / np.linalg.norm(side)
        half = brentq(lambda h: math.sin(h) / h - chord / self.s[-1], 1e-9, math.pi - 1e-12)
        radius = self.s[-1] / (2 * half)
        angle = half * (2 * self.s / self.s[-1] - 1)
        along, out = radius * (np.sin(angle) + math.sin(half)), radius * (np.cos(angle) - math.cos(half))
        return pa + np.outer(along, x) + np.outer(out, side)

    def place(self, shape: np.ndarray) -> np.ndarray:
        """State vector with the nodes at `shape` (n, 3): frames along it with as little twist as the ends allow, forces
        that balance the weight, no moments."""
        q, pack = np.zeros(self.ndof), self.pack
        for i in range(self.nodes):
            q[pack.r[i] : pack.r[i] + 3] = shape[i]
        chord = np.diff(shape, axis=0)
        size = np.linalg.norm(chord, axis=1)
        t = chord / np.where(size > 0, size, 1.0)[:, None]
        for i, N in enumerate(self._forces(t, size)):
            q[pack.N[i] : pack.N[i] + 3] = N
        self.frames(q, shape)
        return q

    def _forces(self, t: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Internal forces (n, 3) that balance the steady loads along a shape with unit chords t: statically determined
        by a free end, else with the horizontal force of the shape's own slope, or of its stretch."""
        pack, end_a, end_b = self.pack, self.scene.end_a, self.scene.end_b
        passed = np.concatenate([[np.zeros(3)], np.cumsum(pack.load * pack.l[:, None], axis=0)])
        total = np.abs(passed).max() + 1e-12
        loose = self.scene.start.kind != "released"
        if end_b.kind == "free" and loose:
            N = np.array(end_b.force or (0, 0, 0)) + passed[-1] - passed
        elif end_a.kind == "free" and loose:
            N = -np.array(end_a.force or (0, 0, 0)) - passed
        else:
            EA = 1 / np.where(pack.give[:, 3] > 0, pack.give[:, 3], 1e-30)
            T = EA * (size / pack.l - 1)
            if float(np.median(T)) > 0.01 * total:  # taut: the stretch is the tension
                N0 = float(np.median(T)) * t[len(t) // 2]
                N = N0 + passed[len(passed) // 2] - passed
                if self.scene.start.kind == "given":  # its own strain, element by element
                    each = T[:, None] * t
                    N = np.concatenate([each[:1], (each[1:] + each[:-1]) / 2, each[-1:]])
            else:  # hanging: each half carries its weight, the rest is horizontal
                low = int(np.argmin(np.abs(t[:, 2])))
                flat = np.array([t[low, 0], t[low, 1], 0.0])
                slope = (t[-1, 2] - t[0, 2]) / max(float(np.hypot(t[-1, 0], t[-1, 1])), 0.1)
                H = total / max(abs(float(slope)), 0.1)
                N = H * flat / max(float(np.linalg.norm(flat)), 1e-9) + passed[low] - passed
        along = np.concatenate([t[:1], t[1:] + t[:-1], t[-1:]])
        along /= np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
        pull = (N * along).sum(axis=1)
        flexible = self.flexible
        slack = flexible & (pull < 0.03 * np.linalg.norm(N, axis=1) + 1e-3 * total)
        given = flexible & (self.scene.start.kind == "given")
        N[given] = (pull[:, None] * along)[given]
        N[slack] = (0.03 * np.linalg.norm(N, axis=1) + 1e-3 * total)[slack, None] * along[slack]
        return N

    def frames(self, q: np.ndarray, shape: np.ndarray) -> None:
        """Frames of all rod nodes in q: transported along the shape, the twist of two guided ends spread evenly."""
        pack = self.pack
        chord = np.diff(shape, axis=0)
        size = np.linalg.norm(chord, axis=1)
        t = np.where(size[:, None] > 0, chord, [0.0, 0.0, 1.0]) / np.where(size > 0, size, 1.0)[:, None]
        at = np.concatenate([t[:1], t[1:] + t[:-1], t[-1:]])
        at = at / np.maximum(np.linalg.norm(at, axis=1), 1e-12)[:, None]
        home = dict(zip(pack.guided.tolist(), pack.home, strict=True))
        inside = np.concatenate([[False], self.rod]) | np.concatenate([self.rod, [False]])
        start = None
        for i in range(self.nodes):
            if not inside[i]:
                start = None
                continue
            if start is None:
                first = home.get(i)
                frame = matrix(first) if first is not None else upright(at[i])
                start = i
            else:
                frame = carried(frame, at[i] if i not in home else matrix(home[i])[:, 2])
            p = quaternion(frame)
            if start != i:
                before = q[pack.p[i - 1] : pack.p[i - 1] + 4]
                p = p if p @ before >= 0 else -p
            q[pack.p[i] : pack.p[i] + 4] = p
        last = self.nodes - 1
        if 0 in home and last in home and inside.all():
            wanted = matrix(home[last])
            have = matrix(q[pack.p[last] : pack.p[last] + 4])
            angle = math.atan2(wanted[:, 0] @ have[:, 1], wanted[:, 0] @ have[:, 0])
            first, final = (_first_twist(end) for end in (self.scene.end_a, self.scene.end_b))
            for i in range(self.nodes):  # whole turns count: only the mismatch at twist 0 is taken the short way
                k, x = pack.p[i], self.s[i] / self.s[-1]
                q[k : k + 4] = rotated(q[k : k + 4], first + (angle + final - first) * x)

    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """State of a start of kind `given`; forces follow from the motion at the first step."""
        start = self.scene.start
        assert start.shape is not None
        shape = np.array(start.shape)
        at = np.array(start.s) if start.s else np.linspace(0, self.scene.length, len(shape))
        q = self.place(np.column_stack([np.interp(self.s, at, shape[:, m]) for m in range(3)]))
        v = np.zeros(self.ndof)
        if start.velocity:
            speed = np.array(start.velocity)
            speed = np.repeat(speed, len(shape), axis=0) if len(speed) == 1 else speed
            x = np.column_stack([np.interp(self.s, at, speed[:, m]) for m in range(3)])
            for i in range(self.nodes):
                v[self.pack.r[i] : self.pack.r[i] + 3] = x[i]
            self.spin_along(q, v)
        return q, v

    def spin_along(self, q: np.ndarray, v: np.ndarray) -> None:
        """Rates of the frames in v that turn with the centre line without twist."""
        pack = self.pack
        x, u = self._nodal(q, pack.r), self._nodal(v, pack.r)
        D, rate = np.diff(x, axis=0), np.diff(u, axis=0)
        omega = np.cross(D, rate) / (D * D).sum(axis=1)[:, None]
        omega = np.concatenate([omega[:1], (omega[1:] + omega[:-1]) / 2, omega[-1:]])
        at = np.flatnonzero(pack.p >= 0)
        index = pack.p[at][:, None] + np.arange(4)
        w, r, o = q[index[:, :1]], q[index[:, 1:]], omega[at]
        v[index[:, 0]] = -0.5 * (o * r).sum(axis=1)
        v[index[:, 1:]] = 0.5 * (w * o + np.cross(o, r))

    # ------------------------------------------------------------------------------------------ quantities

    @staticmethod
    def _nodal(q: np.ndarray, at: np.ndarray, count: int = 3) -> np.ndarray:
        """(..., ndof) -> (..., n, count); NaN where a node has no such unknown."""
        found = q[..., np.maximum(at, 0)[:, None] + np.arange(count)]
        return np.where((at >= 0)[:, None], found, np.nan)

    def fields(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Internal forces, moments and curvatures at the nodes, for samples q (nt, ndof).

        force, moment (nt, n, 3) in space; tension, shear, torque, curvature, twist (nt, n). In a catenary domain the
        moment, shear, torque and twist are 0 and the curvature is that of the polyline.
        """
        pack = self.pack
        force, moment = self._nodal(q, pack.N), np.nan_to_num(self._nodal(q, pack.M))
        x = self._nodal(q, pack.r)
        chord = np.diff(x, axis=1)
        t = chord / np.linalg.norm(chord, axis=2, keepdims=True)
        tension = np.linalg.norm(force, axis=2)
        shear, torque, twist = np.zeros_like(tension), np.zeros_like(tension), np.zeros_like(tension)
        curvature = np.zeros_like(tension)
        cos = np.clip((t[:, 1:] * t[:, :-1]).sum(axis=2), -1, 1)
        curvature[:, 1:-1] = 2 * np.tan(np.arccos(cos) / 2) / ((pack.l[1:] + pack.l[:-1]) / 2)
        at = np.flatnonzero(pack.p >= 0)
        if at.size:
            R = matrix(self._nodal(q, pack.p, 4)[:, at])
            third = R[..., 2]
            e = np.where(at < self.segments, at, self.segments - 1)
            e = np.where(self.rod[e], e, at - 1)  # a rod element at the node
            T = (force[:, at] * third).sum(axis=-1)
            tension[:, at], shear[:, at] = T, np.linalg.norm(force[:, at] - T[..., None] * third, axis=-1)
            m = np.einsum("tkij,tki->tkj", R, moment[:, at])
            give, natural = pack.give[e], pack.load_factor * pack.natural[e]
            torque[:, at] = m[..., 2]
            twist[:, at] = natural[:, 2] + give[:, 2] * m[..., 2] + give[:, 4] * T
            bend = natural[:, :2] + give[:, :2] * m[..., :2]
            curvature[:, at] = np.hypot(bend[..., 0], bend[..., 1])
        return {
            "force": force, "moment": moment, "tension": tension, "shear": shear, "torque": torque,
            "curvature": curvature, "twist": twist,
        }  # fmt: skip

    def element_tension(self, q: np.ndarray) -> np.ndarray:
        """(nt, m) axial force in the middle of each element [N]."""
        pack = self.pack
        N = self._nodal(q, pack.N)
        N = (N[:, 1:] + N[:, :-1]) / 2
        out = np.linalg.norm(N, axis=2)
        at = np.flatnonzero(self.rod)
        if at.size:
            P = self._nodal(q, pack.p, 4)
            a, b = P[:, at], P[:, at + 1]
            p = a + np.where((a * b).sum(axis=-1) >= 0, 1.0, -1.0)[..., None] * b
            out[:, at] = (N[:, at] * matrix(p)[..., 2]).sum(axis=-1)
        return out

    def tangents(self, x: np.ndarray) -> np.ndarray:
        """Unit tangents (n, 3) at the nodes of a shape x (n, 3)."""
        chord = np.concatenate([x[1:2] - x[:1], x[2:] - x[:-2], x[-1:] - x[-2:-1]])
        return chord / np.linalg.norm(chord, axis=1)[:, None]

    def observe(self, q: np.ndarray, v: np.ndarray, force: np.ndarray, static: np.ndarray) -> dict[str, np.ndarray]:
        """Signals of samples q, v (nt, ndof) with forces at the prescribed dofs (nt, nfixed)."""
        pack, nt = self.pack, len(q)
        rest = self._nodal(static, pack.r)
        fields = self.fields(q)
        ends = np.zeros((nt, 2, 3))
        for k, node in enumerate(pack.held):
            ends[:, 0 if node == 0 else 1] = force[:, 3 * k : 3 * k + 3]
        density = np.array([self.scene.cable[k].mass for k in self.section])
        return {
            "arc": self.s, "static_position": rest, "static_tangent": self.tangents(rest),
            "span_mass": density * np.diff(self.s), "rigid": np.zeros(self.segments),
            "position": self._nodal(q, pack.r), "velocity": self._nodal(v, pack.r),
            "tension": self.element_tension(q), "curvature": fields["curvature"], "end_force": ends,
            "stroke": np.zeros((nt, 0)), "force": fields["force"], "moment": fields["moment"],
            "shear": fields["shear"], "torque": fields["torque"], "twist": fields["twist"],
            "domain": np.repeat(self.rod[None].astype(float), nt, axis=0),
        }  # fmt: skip

    # ------------------------------------------------------------------------------------------ guards

    @property
    def force_scale(self) -> float:
        """A force that matters: that of the loads [N]."""
        return float(self.pack.size[self.pack.N[0]])

    def slack(self, signals: dict[str, np.ndarray]) -> bool:
        """Whether a catenary domain loses its tension."""
        return self._least(signals["tension"]) <= LEAST_TENSION * self.force_scale

    def _least(self, tension: np.ndarray) -> float:
        soft = tension[:, ~self.rod]
        return min(float(soft.min(initial=math.inf)), float(self.pack.least[0]))

    def validity(self, signals: dict[str, np.ndarray]) -> tuple[Status, str]:
        """A catenary has no direction without tension."""
        least, limit = self._least(signals["tension"]), LEAST_TENSION * self.force_scale
        if least <= limit:
            where = ""
            if self.rod.any():
                where = " (in a catenary domain of the hybrid)"
            return Status.ZERO_TENSION, f"tension falls to {least:.3g} N, below {limit:.3g} N{where}"
        return Status.OK, ""

    def stopped(self, q: np.ndarray) -> tuple[Status, str]:
        """Why a march stopped at the state q: a catenary that has nearly no tension turns without limit."""
        least, limit = self._least(self.element_tension(q[None])), 0.05 * self.force_scale
        if not self.rod.all() and least < limit:
            return Status.ZERO_TENSION, f"the march stopped where a catenary's tension had fallen to {least:.3g} N"
        return Status.OK, ""

    def drift_error(self, static: np.ndarray) -> float:
        """Kinematics are exact."""
        return 0.0

    def range_error(self) -> float:
        """Kinematics are exact."""
        return 0.0

    def fastest(self, static: np.ndarray) -> dict[str, float]:
        """Frequencies of waves as long as two elements [rad/s]: the scheme itself has faster ones, without limit."""
        S, l = [self.scene.cable[k] for k in self.section], np.diff(self.s)
        m = self.pack.mass + self.pack.mn
        tension = np.maximum(self.element_tension(static[None])[0], 0.0)
        EA, EI = np.array([x.EA for x in S]), np.array([x.EI for x in S]) * self.rod
        axial = float((2 / l * np.sqrt(EA / self.pack.mass)).max())
        return {
            "axial": axial, "decay": axial, "device": 0.0, "tension": float((2 / l * np.sqrt(tension / m)).max()),
            "bending": float((4 / l**2 * np.sqrt(EI / m)).max()),
        }  # fmt: skip

    def guards(self, static: np.ndarray) -> tuple[Status, str, float]:
        """Status, sentence and nodes per shortest transverse wave of the excitation, from the static state."""
        l, S = np.diff(self.s), [self.scene.cable[k] for k in self.section]
        tension = np.maximum(self.element_tension(static[None])[0], 0.0)
        m = self.pack.mass + self.pack.mn
        nodes = math.inf
        for e in range(self.segments):
            EI, T = S[e].EI * self.rod[e], tension[e]
            if self.omega == 0 or (EI == 0 and T == 0):
                continue
            inertia = m[e] * self.omega**2
            square = 2 * inertia / (math.sqrt(T * T + 4 * EI * inertia) + T)
            nodes = min(nodes, 2 * math.pi / math.sqrt(square) / l[e])
        p = self._nodal(static, self.pack.p, 4)
        for e in np.flatnonzero(self.rod).tolist():
            a, b = p[e] / np.linalg.norm(p[e]), p[e + 1] / np.linalg.norm(p[e + 1])
            turn = 2 * math.acos(min(1.0, abs(float(a @ b))))
            if turn > LARGEST_TURN:
                note = f"the frame turns by {turn:.2f} rad over the element at s = {self.s[e]:.3g} m"
                return Status.UNRESOLVED, f"{note}; {LARGEST_TURN} are the most", nodes
        ends = ((self.scene.end_a, 0), (self.scene.end_b, self.segments - 1))
        for end, e in ends:
            if end.direction is not None and self.rod[e] and tension[e] > 0:
                layer = math.sqrt(S[e].EI / tension[e])
                if l[e] > layer:
                    note = f"elements of {l[e]:.3g} m at a clamp, where bending decays over {layer:.3g} m"
                    return Status.UNRESOLVED, note, nodes
        if nodes < LEAST_NODES_PER_WAVE:
            note = f"{nodes:.1f} nodes in the shortest wave of the excitation; {LEAST_NODES_PER_WAVE:g} are needed"
            return Status.UNRESOLVED, note, nodes
        share = self.rod.mean()
        note = "" if share in (0.0, 1.0) else f"{share:.0%} rod: {self.describe()}"
        return Status.OK, note, nodes

    def resolved(self, signals: dict[str, np.ndarray], note: str) -> tuple[Status, str]:
        """The guard on the frame's turn over an element, for all samples of a run; `note` where it is good."""
        kappa, rod = signals["curvature"], signals["domain"] > 0.5
        turn = np.where(rod, np.maximum(kappa[:, 1:], kappa[:, :-1]) * np.diff(self.s), 0.0)
        k, e = np.unravel_index(turn.argmax(), turn.shape)
        if not turn[k, e] <= LARGEST_TURN:
            found = f"the frame turns by {turn[k, e]:.2f} rad over the element at s = {self.s[e]:.3g} m in the run"
            return Status.UNRESOLVED, f"{found}; {LARGEST_TURN} are the most"
        return Status.OK, note

    def describe(self) -> str:
        """The rod domains in words."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.rod.astype(int), [0]])))
        return ", ".join(f"{self.s[a]:.4g} to {self.s[b]:.4g} m" for a, b in zip(edges[::2], edges[1::2], strict=True))


def _first_twist(end: sc.End) -> float:
    """Twist of an end at the start [rad]."""
    return math.radians(end.twist.angle[0] if isinstance(end.twist, sc.Turn) else end.twist)


def upright(t: np.ndarray) -> np.ndarray:
    """A frame whose third axis is t and whose second is horizontal."""
    flat = np.cross([0.0, 0.0, 1.0], t)
    second = flat / np.linalg.norm(flat) if np.linalg.norm(flat) > 1e-9 else np.array([0.0, 1.0, 0.0])
    return np.column_stack([np.cross(second, t), second, t])


def carried(frame: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The frame turned by the shortest way until its third axis is t."""
    old = frame[:, 2]
    c = float(old @ t)
    if c < -1 + 1e-12:
        return frame @ np.diag([1.0, -1.0, -1.0])
    w = np.cross(old, t)
    K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    return (np.eye(3) + K + K @ K / (1 + c)) @ frame


def build_rod(scene: sc.Scene, segments: int, ask: Ask | None = None) -> RodModel:
    """Rod everywhere: bending and torsion."""
    return RodModel(scene, segments, np.ones(len(mesh_of(scene, segments)[1]), bool), _rho(ask), "rod")


def build_catenary(scene: sc.Scene, segments: int, ask: Ask | None = None) -> RodModel:
    """Catenary everywhere: neither bending nor torsion."""
    return RodModel(scene, segments, (), _rho(ask), "catenary")


def _rho(ask: Ask | None) -> float:
    return 1.0 if ask is None else ask.rho_space
