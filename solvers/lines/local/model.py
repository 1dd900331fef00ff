"""The local line as a Model: static shape, small motion about it, quantities, range of validity."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.linalg import solve_banded

from ... import scene as sc
from ...dispatch import call_drive, call_tangent, provides
from ...geometry import basis_of
from ...model import CannotRepresent, Status
from ...motion import NEVER, breaks, top_omega
from . import kernels
from .params import Local, Mesh, Shape, discretise, elements, equilibrium, make_mesh, node_angles, static_shape

provides(
    Local, drive=kernels.drive, residual=kernels.residual, tangent=kernels.tangent, accelerate=kernels.accelerate,
    energies=kernels.energies, gaps=kernels.gaps,
)  # fmt: skip

LEAST_NODES_PER_WAVE = 8.0  # as of the lumped line: the mesh is of the same order
DRIFT = 2.0  # measured: a current that moves a line by 11 % of its sag puts its tension range off by 24 %
DIRECTIONS = 16  # in which `range_error` looks for the extremes of the motion


class LocalModel:
    """A scene on about `segments` segments, moving little about its static shape.

    Unknowns are displacements (U, V) along and across the static line, not the papers' velocities and strains: see
    ``kernels``. The static shape is without current, whose drag the line carries as a small motion of its own.

    Parameters
    ----------
    scene : Scene
        In a vertical plane, both ends pinned, without devices or seabed.
    segments : int
    stretched : bool
        Keep the factors (1 + es) of the static strain, which the papers drop. Then the line is exactly the linearised
        lumped line; without them frequencies across the line are high by es/2, and forces are off by some es.

    Raises
    ------
    CannotRepresent
        With the name of the field that asks for more, or when the line is not taut at rest.
    """

    name = "local"
    n_gaps = 0

    def __init__(self, scene: sc.Scene, segments: int, stretched: bool = False) -> None:
        refuse(scene)
        self.scene = scene
        self.stretched = stretched
        self.mesh: Mesh = make_mesh(scene, segments)
        a, b = (np.array(end.position) for end in (scene.end_a, scene.end_b))
        basis = basis_of(scene)
        self.basis = basis if basis[0] @ (b - a) >= 0 else np.array([-basis[0], basis[1]])  # from A towards B
        self.segments = len(self.mesh.s) - 1
        self.nodes = len(self.mesh.s)
        ends = [scene.end_a, scene.end_b]
        self.breaks = breaks(ends)
        self.omega = top_omega(ends)
        self.offset = a - self.basis.T @ (self.basis @ a)
        self.rest: Shape = static_shape(scene, self.mesh, self.basis, stretched)
        self.angle = node_angles(self.rest.angle, np.diff(self.mesh.s))
        self.pack: Local = discretise(scene, self.mesh, self.basis, self.rest, stretched)
        self.static_pack = self.pack
        self.ndof = len(self.pack.weight)

    # ------------------------------------------------------------------------------------------ start

    def starts(self) -> list[np.ndarray]:
        """First guesses of the static state: the shape without current."""
        return [np.zeros(self.ndof)]

    def softened(self, q: np.ndarray) -> list[Local]:
        """The static pack: a line that is linear but for its drag needs no softer one."""
        return [self.static_pack]

    def settle(self, static: np.ndarray) -> None:
        """Nothing waits for the static state."""

    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """A start of kind `given` is refused by `build`."""
        raise CannotRepresent(f"start.kind: {self.scene.start.kind}; local starts from its static state")

    @property
    def static_tolerance(self) -> float:
        """A residual that is at rest: 1e-10 of the forces, or what rounding of a displacement of `reach` makes [N]."""
        scale = float(np.abs(self.rest.end_force).sum())
        return max(1e-10 * scale, 8 * float((self.pack.EA / self.pack.ds).max()) * float(np.spacing(self.reach)))

    @property
    def reach(self) -> float:
        """Largest move of a dof in one static iteration [m]."""
        return 0.5 * float(self.pack.ds.min())

    # ------------------------------------------------------------------------------------------ quantities

    def world(self, q: np.ndarray) -> np.ndarray:
        """(..., ndof) -> (..., n, 3): displacements or velocities of the nodes in world axes."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        U, V = q[..., 0::2], q[..., 1::2]
        return np.stack([U * c - V * s, U * s + V * c], axis=-1) @ self.basis

    def strains(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Dynamic strain e and angle phi of the segments (..., n - 1), or their rates."""
        four = np.stack([q[..., k : k + 2 * self.segments : 2] for k in range(4)], axis=-1)
        return (four * self.pack.De).sum(axis=-1), (four * self.pack.Dphi).sum(axis=-1)

    def observe(self, q: np.ndarray, v: np.ndarray, force: np.ndarray, static: np.ndarray) -> dict[str, np.ndarray]:
        """Signals of samples q, v (nt, ndof) with forces at the prescribed dofs (nt, nfixed)."""
        nt, p, ds = len(q), self.pack, np.diff(self.mesh.s)
        home = self.rest.x @ self.basis + self.offset
        rest = home + self.world(static)
        chord = np.concatenate([rest[1:2] - rest[:1], rest[2:] - rest[:-2], rest[-1:] - rest[-2:-1]])
        e, phi = self.strains(q)
        bend = np.zeros((nt, self.nodes))
        bend[:, 1:-1] = np.diff(self.rest.angle + phi, axis=1) * 2 / (ds[1:] + ds[:-1])
        c, s = np.cos(self.angle[[0, -1]]), np.sin(self.angle[[0, -1]])
        along, across = force[:, 0::2], force[:, 1::2]
        ends = np.stack([along * c - across * s, along * s + across * c], axis=-1) + self.rest.end_force
        chord /= np.linalg.norm(chord, axis=1)[:, None]
        return {
            "arc": self.mesh.s, "static_position": rest, "static_tangent": chord,
            "span_mass": np.array([self.scene.cable[k].mass for k in self.mesh.section]) * ds,
            "rigid": np.zeros(self.segments), "position": home + self.world(q), "velocity": self.world(v),
            "tension": self.rest.T + p.EA * e + p.BA * self.strains(v)[0], "curvature": np.abs(bend),
            "end_force": ends @ self.basis, "stroke": np.zeros((nt, 0)),
        }  # fmt: skip

    # ------------------------------------------------------------------------------------------ guards

    def inertia(self) -> tuple[np.ndarray, np.ndarray]:
        """Mass and normal added mass per metre of the segments [kg/m]."""
        S = [self.scene.cable[k] for k in self.mesh.section]
        added = np.array([self.scene.density * x.Can * math.pi / 4 * x.d**2 for x in S])
        return np.array([x.mass for x in S]), added

    def fastest(self, static: np.ndarray) -> dict[str, float]:
        """Highest angular frequencies by kind [rad/s]: axial, tension, bending; `decay` counts the damping BA."""
        p, (m, added) = self.pack, self.inertia()
        inertia = p.weight[0::2]
        stiff, damp = np.zeros(self.nodes), np.zeros(self.nodes)
        for total, value in ((stiff, p.EA), (damp, p.BA)):  # Gershgorin's bound of M^-1 K and M^-1 C
            total[:-1] += 2 * value / p.ds
            total[1:] += 2 * value / p.ds
        inner = slice(1, -1) if self.nodes > 2 else slice(None)
        square, half = (stiff / inertia)[inner], (damp / (2 * inertia))[inner]
        EI = np.array([self.scene.cable[k].EI for k in self.mesh.section])
        return {
            "axial": float(np.sqrt(square.max())),
            "decay": float(np.maximum(np.sqrt(square), half + np.sqrt(np.maximum(half**2 - square, 0))).max()),
            "tension": float((2 / p.ds * np.sqrt(self.rest.T / (m + added))).max()),
            "bending": float((4 / p.ds**2 * np.sqrt(EI / (m + added))).max()),
            "device": 0.0,
        }

    def guards(self, static: np.ndarray) -> tuple[Status, str, float]:
        """Status, sentence and nodes per shortest transverse wave of the excitation.

        The boundary layer of bending at a pinned end is told, not refused: nothing else depends on it.
        """
        T, ds, (m, added), nodes = self.rest.T, self.pack.ds, self.inertia(), math.inf
        EI = np.array([self.scene.cable[k].EI for k in self.mesh.section])
        if self.omega > 0:
            inertia = (m + added) * self.omega**2
            square = 2 * inertia / (np.sqrt(T * T + 4 * EI * inertia) + T)
            nodes = float((2 * math.pi / np.sqrt(square) / ds).min())
        if nodes < LEAST_NODES_PER_WAVE:
            few = f"{nodes:.1f} nodes in the shortest wave of the excitation; {LEAST_NODES_PER_WAVE:g} are needed"
            return Status.UNRESOLVED, few, nodes
        layer = np.sqrt(EI / T)[[0, -1]]
        coarse = (layer > 0) & (layer < ds[[0, -1]])
        note = ""
        if coarse.any():
            note = (
                f"bending decays over {layer[coarse].min():.2g} m at the ends, which segments of "
                f"{ds[[0, -1]][coarse].max():.3g} m do not resolve; at pinned ends it does not matter"
            )
        return Status.OK, note, nodes

    def validity(self, signals: dict[str, np.ndarray]) -> tuple[Status, str]:
        """Whether a run stayed where this line may go: a section that carries no compression must not go slack."""
        rope = np.array([not self.scene.cable[k].carries_compression for k in self.mesh.section])
        tension = signals["tension"]
        if not rope.any() or not len(tension):
            return Status.OK, ""
        least = np.where(rope, tension, np.inf)
        row, k = np.unravel_index(int(np.argmin(least)), least.shape)
        if least[row, k] > 0:
            return Status.OK, ""
        when = int(np.argmax((least <= 0).any(axis=1)))
        return (
            Status.CANNOT_REPRESENT,
            f"segment {int(k)} goes slack (least tension {least[row, k]:.3g} N, first slack in sample {when}): "
            "local cannot",
        )

    # ------------------------------------------------------------------------------------------ range of validity

    def extremes(self) -> np.ndarray:
        """(k, 2) displacements of end B less that of A, farthest in DIRECTIONS directions of the plane [m].

        From one period of the slowest harmonic under the full window, or from the window or table.
        """
        motions = [end.motion for end in (self.scene.end_a, self.scene.end_b) if end.motion]
        if not motions:
            return np.zeros((0, 2))
        first, last = [], []
        m = self.pack.motion
        for start, stop, up, down, _ in m.window:
            if start > -NEVER:
                first.append(start + up)
            if stop < NEVER:
                last.append(stop - down)
        start = max(first, default=0.0)
        knots = m.knot[np.abs(m.knot) < NEVER]
        turns = np.arange(DIRECTIONS) * 2 * math.pi / DIRECTIONS
        aims = np.array([np.cos(turns), np.sin(turns)])
        if len(set(m.omega.tolist())) > 1 and not len(knots):  # a beat: some time all terms point the same way
            sign = np.where(np.arange(len(m.omega)) < m.first[1], -1.0, 1.0)[:, None]
            terms = m.amplitude * sign
            return np.array([(terms * np.sign(terms @ d)[:, None]).sum(axis=0) for d in aims.T])
        period = 2 * math.pi / float(m.omega.min()) if len(m.omega) else 0.0
        stop = max(min([start + period, *last]), float(knots.max(initial=start)))
        q, v, a = np.zeros(self.ndof), np.zeros(self.ndof), np.zeros(self.ndof)
        path = []
        for t in np.concatenate([np.linspace(start, stop, 241), knots]):
            call_drive(float(t), self.pack, q, v, a)
            ends = self.world(q)[[0, -1]] @ self.basis.T
            path.append(ends[1] - ends[0])
        far = np.array(path) @ aims
        return np.array(path)[np.unique(far.argmax(axis=0))]

    def stiffness(self) -> np.ndarray:
        """(2, 2) change of the static force on end B with its place, in the plane's axes [N/m]."""
        p = self.pack
        zero = np.zeros(self.ndof)
        J = np.zeros((self.ndof, 2 * p.bw + 1))
        call_tangent(0.0, zero, zero, zero, 1.0, 0.0, 0.0, p, J)
        c, s = p.turn[1]
        into = np.array([[c, s], [-s, c]])  # (X, Z) -> (U, V) at end B
        rows, cols = np.indices(J.shape)
        cols = rows + cols - p.bw
        K = np.zeros((self.ndof, self.ndof + 2 * p.bw + 1))
        K[rows, cols % K.shape[1]] = J
        K = K[:, : self.ndof]
        end = slice(self.ndof - 2, self.ndof)
        inner = slice(2, self.ndof - 2)
        found = K[end, end].copy()
        if self.ndof > 4:
            band = np.zeros((2 * p.bw + 1, self.ndof - 4))
            for k in range(2 * p.bw + 1):  # scipy's diagonal order
                diagonal = np.diagonal(K[inner, inner], k - p.bw)
                shift = max(k - p.bw, 0)
                band[2 * p.bw - k, shift : shift + len(diagonal)] = diagonal
            found -= K[end, inner] @ solve_banded((p.bw, p.bw), band, K[inner, end].copy())
        return into.T @ found @ into

    def slack(self, signals: dict[str, np.ndarray]) -> bool:
        """Whether a section that carries no compression goes slack."""
        return self.validity(signals)[0] != Status.OK

    def drift_error(self, static: np.ndarray) -> float:
        """Estimated relative error of a static state that a current has carried off: its largest displacement over the
        sag, times DRIFT. A taut line without sag may not be carried off at all."""
        x = self.rest.x
        chord = x[-1] - x[0]
        across = np.array([-chord[1], chord[0]]) / float(np.hypot(*chord))
        sag = float(np.abs((x - x[0]) @ across).max())
        far = float(np.abs(static).max())
        return DRIFT * far / sag if far > 1e-9 * float(np.hypot(*chord)) else 0.0

    def range_error(self) -> float:
        """Estimated relative error of small motion in the scene's motion: the largest difference between the tension at
        end B of the elastic catenary (S1 on the same mesh) and this line's linear one, with its ends displaced to the
        extremes of the motion and half of them, over the range of the former. Quasi-static, without current or drag;
        0 where nothing moves, infinite where a displaced end leaves no taut catenary."""
        path = self.extremes()
        if not len(path) or not np.abs(path).max() > 0:
            return 0.0
        el = elements(self.scene, self.mesh)
        a, b = self.rest.x[0], self.rest.x[-1]
        K, F = self.stiffness(), self.rest.end_force[1]
        exact, linear = [float(np.hypot(*F))], [float(np.hypot(*F))]
        for far in path:
            guess = self.rest.angle, self.rest.H, self.rest.P
            for share in (0.5, 1.0):
                shape = equilibrium(el, a, b + share * far, guess, self.stretched)
                if shape is None or not shape.T.min() > 0:
                    return math.inf
                guess = shape.angle, shape.H, shape.P
                exact.append(float(np.hypot(*shape.end_force[1])))
                linear.append(float(np.hypot(*(F + share * K @ far))))
        return float(np.abs(np.array(exact) - linear).max() / np.ptp(exact))


def refuse(scene: sc.Scene) -> None:
    """Raises CannotRepresent for what the line has no equations for, by the name of the field."""
    for name, end in (("end_a", scene.end_a), ("end_b", scene.end_b)):
        if end.kind != "pinned":
            raise CannotRepresent(f"{name}.kind: {end.kind}; local has pinned ends only")
    if scene.devices:
        raise CannotRepresent(f"devices[0].kind: {scene.devices[0].kind}; local carries no devices")
    if scene.seabed:
        raise CannotRepresent("seabed: local has no contact; give the suspended part of the line as a scene")
    if scene.start.kind != "static":
        raise CannotRepresent(f"start.kind: {scene.start.kind}; local starts from its static state")
    if len(basis_of(scene)) == 3:
        raise CannotRepresent("end_a, end_b, water.current: not in one vertical plane; local is planar")


def build(scene: sc.Scene, segments: int) -> Any:
    """A LocalModel of the scene, with the factors (1 + es): as the amplitude falls it becomes the lumped line exactly,
    where the printed equations keep an error of the order of es."""
    return LocalModel(scene, segments, stretched=True)
