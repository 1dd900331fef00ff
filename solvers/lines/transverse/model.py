"""The transverse line as a Model: static shape, quantities, range of validity."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq

from ... import scene as sc
from ...devices import contact_rates
from ...dispatch import call_residual, provides
from ...geometry import basis_of
from ...model import Ask, CannotRepresent, Status
from ...motion import breaks, top_omega
from . import kernels
from .params import (
    Transverse,
    assemble,
    basis_functions,
    chord_of,
    compliance,
    discretise,
    loads_of,
    make_mesh,
    number,
    section_at,
    slowed,
)

provides(
    Transverse, drive=kernels.drive, residual=kernels.residual, tangent=kernels.tangent, accelerate=kernels.accelerate,
    energies=kernels.energies, losses=kernels.losses, gaps=kernels.gaps, heft=kernels.heft,
)  # fmt: skip

LEAST_SPANS_PER_WAVE = 3.0  # the frequency of a cubic spline's wave is then high by (k h)^4/1440, some 1.3 %
MOST_SLOWED = 0.12  # share of the kinetic energy: beyond it waveforms are some 5 % off (test_transverse_runs.py)
SAMPLES = 500  # that tell it
AXIAL = 4.0  # measured on the same scenes: the plain estimate is up to 3 times too small
SLOPES = 3.0  # measured: errors of 0.7 (motion) to 2.5 (sag) times the mean squared slope, benchmarks/transverse.py


class TransverseModel:
    """A scene on about `segments` spans of cubic splines.

    Parameters
    ----------
    scene : Scene
        In a vertical plane, both ends held, without seabed or free devices.
    segments : int
    mass_scaling : float or None
        Spans per wave that a free motion must have somewhere on the line to keep its frequency. Inertia slows the
        others to the highest one that has: they would set the step of explicit methods, and should carry little.

    Raises
    ------
    CannotRepresent
        With the name of the field that asks for more, or when the line buckles at rest.
    """

    name = "transverse"

    def __init__(self, scene: sc.Scene, segments: int, mass_scaling: float | None = None) -> None:
        refuse(scene)
        self.scene = scene
        self.basis = basis_of(scene)
        self.mesh = make_mesh(scene, segments)
        self.chord = chord_of(scene, self.basis)
        self.space = number(scene, self.mesh)
        self.loads = loads_of(scene, self.mesh, self.chord, self.basis)
        self.dense = assemble(scene, self.mesh, self.space, self.chord, self.basis, self.loads)
        self.pack = discretise(scene, self.mesh, self.space, self.chord, self.basis, self.loads, self.dense)
        self.static_pack = self.pack
        self.segments = sum(len(x) - 1 for x in self.mesh.knots)
        self.ndof = self.space.ndof
        self.n_gaps = int((self.pack.slot >= 0).sum())
        ends = [scene.end_a, scene.end_b]
        self.breaks = breaks(ends)
        self.omega = top_omega(ends)
        a = np.array(scene.end_a.position)
        self.offset = a - self.basis.T @ (self.basis @ a)
        self._sample()
        self.rest = self._static()
        self.mass_scaling = mass_scaling
        plain = self.dense.M
        if mass_scaling is not None:
            self.pack, self.dense = slowed(self.pack, self.dense, self.tension(self.rest), self.resolved(mass_scaling))
            self.static_pack = self.pack
        self.added = self.dense.M - plain  # (ndof, ndof) inertia that is the scaling's own [kg]

    def _sample(self) -> None:
        """Nodes and what turns a state into their offset, slope and curvature: knots, and rods' ends."""
        s: list[np.ndarray] = []
        w: list[np.ndarray] = []
        slope: list[np.ndarray] = []
        bend: list[np.ndarray] = []
        rigid: list[bool] = []
        for knots, E in zip(self.mesh.knots, self.space.parts, strict=True):
            if s and knots[0] > s[-1][-1]:
                rigid.append(True)
            elif s:  # a point: curvature is that of the right
                for rows in (s, w, slope, bend):
                    rows[-1] = rows[-1][:-1]
            s.append(knots)
            slope.append(basis_functions(knots, knots, 1) @ E)
            w.append(basis_functions(knots, knots, 0) @ E)
            bend.append(basis_functions(knots, knots, 2) @ E)
            rigid += [False] * (len(knots) - 1)
        self.s = np.concatenate(s)
        self.to_w, self.to_slope, self.to_bend = (np.concatenate(x) for x in (w, slope, bend))
        self.rigid = np.array(rigid)

    # ------------------------------------------------------------------------------------------ start

    def _static(self) -> np.ndarray:
        """Equilibrium. For a given mean tension the line is linear, and its length falls as the tension grows: one
        unknown. Sliding masses are left where their cords hold them; their weight hangs on the line."""
        p, d = self.pack, self.dense
        q, r = np.zeros(self.ndof), np.zeros(self.ndof)
        call_residual(0.0, q, q, q, p, r)
        q[p.clamp] = p.slope
        free = np.ones(self.ndof, dtype=bool)
        free[p.fixed] = False
        free[p.slot[p.slot >= 0]] = False
        K, G = (x[free] for x in (d.B + d.W, d.G))
        Kf, Gf, load = K[:, free], G[:, free], -r[free]
        least = -float(eigh(Kf, Gf, eigvals_only=True, subset_by_index=[0, 0])[0])  # where it buckles

        def excess(N: float) -> float:
            q[free] = np.linalg.solve(Kf + N * Gf, load - (K + N * G)[:, p.clamp] @ p.slope)
            return p.pull * (p.stretch + 0.5 * float(q @ d.G @ q)) - N

        size = max(abs(least), abs(p.pull * p.stretch), 1e-9 * float(np.abs(load).sum()))
        low, high = least + 1e-9 * size, max(p.pull * p.stretch, 0.0) + size
        while excess(high) > 0:
            high *= 2
        if not excess(low) > 0:
            raise CannotRepresent(f"cable: the chord between its ends is {-p.stretch:.3g} m shorter and buckles it")
        excess(float(brentq(excess, low, high, xtol=1e-14 * size, rtol=1e-14)))
        for device, k in zip(self._mounted(), p.slot, strict=True):
            if k >= 0 and isinstance(device, sc.BNES):
                q[k] = device.side * device.rest_offset
        return q

    def _mounted(self) -> list[Any]:
        """Devices in the order of the pack."""
        return [self.scene.devices[m.device] for m in self.mesh.mounts if m.device >= 0]

    def starts(self) -> list[np.ndarray]:
        """The static state, solved for at the start."""
        return [self.rest.copy()]

    def softened(self, q: np.ndarray) -> list[Transverse]:
        """The static pack: the start is its solution."""
        return [self.static_pack]

    def settle(self, static: np.ndarray) -> None:
        """Nothing waits for the static state."""

    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """A start of kind `given` is refused by `build`."""
        raise CannotRepresent(f"start.kind: {self.scene.start.kind}; transverse starts from its static state")

    @property
    def static_tolerance(self) -> float:
        """A residual that is at rest: 1e-10 of the forces, or what rounding of `reach` makes of the stiffness [N]."""
        stiff = float(self.pack.K[0].max() + self.pack.G[0].max() * abs(self.tension(self.rest)))
        scale = float(np.abs(self.pack.load).sum()) + abs(self.tension(self.rest))
        return max(1e-10 * scale, 8 * stiff * float(np.spacing(self.reach)))

    @property
    def reach(self) -> float:
        """Largest move of a dof in one static iteration [m]."""
        return 0.5 * float(min(np.diff(x).min() for x in self.mesh.knots))

    def tension(self, q: np.ndarray) -> float:
        """Mean tension of a state at rest [N]."""
        e = self.pack.stretch + q[-1] - q[0] + 0.5 * q @ self.dense.G @ q
        return float(self.pack.pull * e)

    # ------------------------------------------------------------------------------------------ quantities

    def observe(self, q: np.ndarray, v: np.ndarray, force: np.ndarray, static: np.ndarray) -> dict[str, np.ndarray]:
        """Signals of samples q, v (nt, ndof) with forces at the prescribed dofs (nt, nfixed).

        Along the chord the nodes move with the ends, linearly between them; what the slope squared adds is left out.
        """
        p, ds = self.pack, np.diff(self.s)
        span = self.basis.T @ self.chord.frame.T  # (3, 2) chord and normal in space
        y = q @ self.dense.G
        e = p.stretch + q[:, -1] - q[:, 0] + 0.5 * np.einsum("ti,ti->t", q, y)
        rate = v[:, -1] - v[:, 0] + np.einsum("ti,ti->t", v, y)
        W = self.loads.W((self.s[1:] + self.s[:-1]) / 2)
        N = self.tension(static) + W
        give = compliance(self.scene, self.mesh, self.s[:-1], self.s[1:])[0]
        slope = self.to_slope @ static
        flat = 1 + N * give - (slope[1:] ** 2 + slope[:-1] ** 2) / 4
        x = np.concatenate([[0.0], np.cumsum(flat * ds)])
        x *= self.chord.length / x[-1]
        home = self.offset + np.column_stack([x, np.zeros(len(x))]) @ span.T + self.chord.start @ self.basis
        along = np.column_stack([1 - self.s / self.s[-1], self.s / self.s[-1]])
        tangent = np.column_stack([np.ones(len(slope)), slope]) / np.sqrt(1 + slope**2)[:, None]
        at = np.searchsorted(p.fixed, p.ends)

        def world(x: np.ndarray, start: np.ndarray) -> np.ndarray:
            w, out = x @ self.to_w.T, np.empty((len(x), *start.shape))
            u = x[:, [0, -1]] @ along.T if x[:, [0, -1]].any() else None
            for axis in range(3):  # one plane at a time: no temporary of the full size
                np.multiply(w, span[axis, 1], out=out[..., axis])
                if u is not None:
                    out[..., axis] += u * span[axis, 0]
                out[..., axis] += start[:, axis]
            return out

        return {
            "arc": self.s, "static_position": world(static[None], home)[0], "static_tangent": tangent @ span.T,
            "span_mass": np.array([x.mass for x in section_at(self.scene, (self.s[1:] + self.s[:-1]) / 2)]) * ds,
            "rigid": self.rigid.astype(float), "position": world(q, home), "velocity": world(v, np.zeros_like(home)),
            "tension": (p.pull * e + p.loss * rate)[:, None] + W, "curvature": np.abs(q @ self.to_bend.T),
            "end_force": force[:, at] @ span.T, "stroke": self._strokes(q),
        }  # fmt: skip

    def _strokes(self, q: np.ndarray) -> np.ndarray:
        """Offset of each device's mass along its slide direction; 0 for a mass that is fixed."""
        out = np.zeros((len(q), len(self.scene.devices)))
        for mount, k in zip((m for m in self.mesh.mounts if m.device >= 0), self.pack.slot, strict=True):
            if k >= 0:
                out[:, mount.device] = q[:, k]
        return out

    # ------------------------------------------------------------------------------------------ guards

    def slack(self, signals: dict[str, np.ndarray]) -> bool:
        """Whether a section that carries no compression goes slack."""
        rope = np.array([not x.carries_compression for x in section_at(self.scene, (self.s[1:] + self.s[:-1]) / 2)])
        return bool(rope.any() and (signals["tension"][:, rope] <= 0).any())

    def validity(self, signals: dict[str, np.ndarray]) -> tuple[Status, str]:
        """Whether a run stayed where this line may go: a section that carries no compression must not go slack."""
        if not self.slack(signals):
            return Status.OK, ""
        least = signals["tension"].min()
        return Status.CANNOT_REPRESENT, f"the cable goes slack (least tension {least:.3g} N): transverse cannot"

    def scaling_harm(self, v: np.ndarray) -> tuple[Status, str]:
        """Whether motions that the scaling slows stayed small in a run with the velocities v (nt, ndof)."""
        v = v[:: 1 + len(v) // SAMPLES]
        own, all_ = (float(np.einsum("ti,ti->", v @ M, v)) for M in (self.added, self.dense.M))
        if not own > MOST_SLOWED * all_:
            return Status.OK, ""
        share = f"{own / all_:.0%} of the kinetic energy is inertia that `mass_scaling` adds"
        return Status.UNRESOLVED, f"{share}; {MOST_SLOWED:.0%} is the most: what moves is slowed"

    # ------------------------------------------------------------------------------------------ range of validity

    def drift_error(self, static: np.ndarray) -> float:
        """Estimated relative error of the static state: SLOPES times its mean squared slope."""
        return SLOPES * self._slope2(static)

    def _slope2(self, q: np.ndarray) -> float:
        """Mean squared angle to the chord."""
        return float(q @ self.dense.G @ q) / self.scene.length

    def _axial(self) -> tuple[float, float]:
        """Time of an axial wave from end to end [s], and mean mass with added mass per metre [kg/m]."""
        S, length = self.scene.cable, self.scene.length
        slow = sum(x.length * math.sqrt(x.mass / x.EA) for x in S)
        added = [self.scene.density * x.Can * math.pi / 4 * x.d**2 for x in S]
        return slow, sum(x.length * (x.mass + a) for x, a in zip(S, added, strict=True)) / length

    def range_error(self) -> float:
        """Estimated relative error of the line in the scene's motion, before the run.

        Each harmonic of an end, of amplitude A across the chord, makes waves of wave number k and slope k A, stiffened
        by their own stretch: (EI + EA A2/4) k4 + T k2 = m omega2. Their slope squared costs SLOPES times it; the
        inertia along the cable that is left out costs (k L)2 (k A)2/16 of the offsets, and 1/2 (omega L/c)2 times
        AXIAL of those that a motion along the chord makes. Resonance is not foreseen: `run_error` knows.
        """
        slow, m = self._axial()
        p, length = self.pack, self.scene.length
        EI = max(x.EI for x in self.scene.cable)
        T = max(self.tension(self.rest), 0.0)
        bend = math.sqrt(float(np.mean((self.to_bend @ self.rest) ** 2)))
        slopes = self._slope2(self.rest)
        inertial = along = across = late = 0.0
        for amplitude, omega in zip(*self._terms(), strict=True):
            u, w = np.abs(p.frame @ amplitude)
            inertia = m * omega**2
            stiff = EI + p.pull * length * w**2 / 4
            if w > 0:
                k2 = 2 * inertia / (math.sqrt(T * T + 4 * stiff * inertia) + T)
                slopes += k2 * w**2 / 2
                inertial += (k2 * length * w) ** 2 / 16
            across += w
            along += u * p.pull * bend / inertia
            late = max(late, 0.5 * (omega * slow) ** 2 if u > 0 else 0.0)
        share = along / (along + across) if along > 0 else 0.0
        return SLOPES * slopes + inertial + AXIAL * min(late, 1.0) * share

    def _terms(self) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes (h, 2) and angular frequencies of the ends' motion; a table counts as its largest offset and
        speed."""
        motion = self.pack.motion
        amplitude, omega = list(motion.amplitude), [float(x) for x in motion.omega]
        for first, last in pairwise(motion.piece):
            if last <= first:
                continue
            c = motion.poly[first:last]
            size = np.abs(c[:, 3]).max(axis=0)
            if size.max() > 0:
                amplitude.append(size)
                omega.append(float(np.hypot(*c[:, 2].T).max() / np.hypot(*size)))
        return np.array(amplitude).reshape(-1, 2), np.array(omega)

    def run_error(self, t: np.ndarray, signals: dict[str, np.ndarray]) -> float:
        """Estimated relative error of the line in a run, from its signals at the times t.

        SLOPES times the largest of the mean squared slopes over the line, which the tension tells; and the offsets that
        the left-out part of the tension would make, over those that there are: the change of tension times the rms
        curvature, less what lies below the axial wave (at most 1/2 (omega L/c)2 of it is wrong, at most all), over
        the inertia m omega2, or that of the lowest mode. A slope that is uneven along the cable counts as a change of
        tension too: what it would make without the axial wave. AXIAL is the measured margin.
        """
        if len(t) < 16:
            return 0.0
        p, home = self.pack, signals["static_position"]
        span = self.basis.T @ self.chord.frame.T
        w = signals["position"] @ span[:, 1] - home @ span[:, 1]
        u = (signals["position"][:, [0, -1]] - home[[0, -1]]) @ span[:, 0]
        N = signals["tension"][:, 0] - self.loads.W((self.s[1:2] + self.s[:1]) / 2)
        slope2 = 2 * (N / p.pull - p.stretch - (u[:, 1] - u[:, 0])) / self.scene.length
        size = math.sqrt(float(np.mean(w**2)))
        slopes = SLOPES * max(float(slope2.mean()), self._slope2(self.rest))
        if not size > 0:
            return slopes
        slow, m = self._axial()
        omega = 2 * math.pi * np.fft.rfftfreq(len(t), float(t[-1] - t[0]) / (len(t) - 1))
        ds = np.diff(self.s)
        local = np.diff(w, axis=1)
        local /= ds
        local *= local
        local -= (local @ ds / ds.sum())[:, None]
        local *= local
        give = 1 / (p.pull * self.scene.length)
        uneven = 0.5 / give * np.sqrt(local @ ds / ds.sum())
        push = (N - N.mean() + uneven) * np.sqrt(np.mean(signals["curvature"] ** 2, axis=1))
        wrong = np.fft.rfft(push) * np.minimum(0.5 * (omega * slow) ** 2, 1.0)
        wrong /= m * np.maximum(omega, self.spectrum()[0]) ** 2
        power = np.abs(wrong) ** 2
        rms = math.sqrt(2 * float(power.sum())) / len(t)
        return slopes + AXIAL * rms / size

    def _sections(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of each interval between nodes: length [m], EI [N m2], mass with added mass [kg/m], tension at rest [N]."""
        middle = (self.s[1:] + self.s[:-1]) / 2
        S = section_at(self.scene, middle)
        m = np.array([x.mass + self.scene.density * x.Can * math.pi / 4 * x.d**2 for x in S])
        T = np.maximum(self.tension(self.rest) + self.loads.W(middle), 0.0)
        return np.diff(self.s), np.array([x.EI for x in S]), m, T

    def resolved(self, spans: float) -> float:
        """Highest angular frequency of a wave that has so many spans somewhere on the line [rad/s]."""
        h, EI, m, T = self._sections()
        k2 = (2 * math.pi / (spans * h)) ** 2
        return math.sqrt(float(((EI * k2 + T) * k2 / m)[~self.rigid].max()))

    def spectrum(self) -> np.ndarray:
        """Angular frequencies of the free line with its masses, tension as at rest [rad/s]."""
        free = np.ones(self.ndof, dtype=bool)
        free[self.pack.fixed] = False
        free[self.pack.slot[self.pack.slot >= 0]] = False
        d = self.dense
        K = (d.B + d.W + self.tension(self.rest) * d.G)[np.ix_(free, free)]
        return np.sqrt(np.maximum(eigh(K, d.M[np.ix_(free, free)], eigvals_only=True), 0.0))

    def fastest(self, static: np.ndarray) -> dict[str, float]:
        """Highest angular frequencies by kind [rad/s]; none is axial, and tension's is within bending's. `decay` is the
        largest size of an eigenvalue when the damping BI is counted."""
        top = float(self.spectrum()[-1])
        damped = max((x.BI / x.EI for x in self.scene.cable if x.EI > 0), default=0.0)
        half = damped * top**2 / 2
        return {
            "axial": 0.0, "tension": 0.0, "bending": top, "device": float(self.impacts().max(initial=0.0)),
            "decay": max(top, half + math.sqrt(max(half**2 - top**2, 0.0))),
        }  # fmt: skip

    def impacts(self, damped: bool = False) -> np.ndarray:
        """(n_gaps,) highest angular frequency of each sliding mass on its springs or taut cords [rad/s]; or the size of
        its largest eigenvalue when their dampers are counted."""
        p, free = self.pack, np.ones(self.ndof, dtype=bool)
        free[p.fixed] = False
        light = np.zeros((self.ndof, self.ndof))
        light[np.ix_(free, free)] = np.linalg.inv(self.dense.M[np.ix_(free, free)])
        return np.array([
            contact_rates(law, light[slot, slot])[damped] for law, slot in zip(p.law, p.slot, strict=True) if slot >= 0
        ])  # fmt: skip

    def guards(self, static: np.ndarray) -> tuple[Status, str, float]:
        """Status, sentence and spans per shortest wave of the excitation."""
        h, EI, m, T = self._sections()
        spans = math.inf
        if self.omega > 0:
            inertia = m * self.omega**2
            with np.errstate(divide="ignore"):
                wave = 2 * math.pi / np.sqrt(2 * inertia / (np.sqrt(T * T + 4 * EI * inertia) + T))
            spans = float((wave / h)[~self.rigid].min())
        least = max(LEAST_SPANS_PER_WAVE, self.mass_scaling or 0.0)
        if spans < least:
            why = ", or `mass_scaling` slows it" if least > LEAST_SPANS_PER_WAVE else ""
            few = f"{spans:.1f} spans in the shortest wave of the excitation; {least:g} are needed{why}"
            return Status.UNRESOLVED, few, spans
        for end, k in ((self.scene.end_a, 0), (self.scene.end_b, -1)):
            if end.kind == "clamped" and EI[k] > 0 and T[k] > 0 and h[k] > math.sqrt(EI[k] / T[k]):
                layer = math.sqrt(EI[k] / T[k])
                coarse = f"spans of {h[k]:.3g} m at a clamp, where bending decays over {layer:.3g} m"
                return Status.UNRESOLVED, coarse, spans
        return Status.OK, "", spans


def refuse(scene: sc.Scene) -> None:
    """Raises CannotRepresent for what the line has no equations for, by the name of the field."""
    for name, end in (("end_a", scene.end_a), ("end_b", scene.end_b)):
        if end.kind == "free":
            raise CannotRepresent(f"{name}.kind: free; transverse has a chord between two held ends")
    for d, device in enumerate(scene.devices):
        if device.kind == "bnes_free":
            raise CannotRepresent(f"devices[{d}].kind: bnes_free; transverse has masses that slide across it only")
    if scene.seabed:
        raise CannotRepresent("seabed: transverse has no contact")
    if scene.start.kind != "static":
        raise CannotRepresent(f"start.kind: {scene.start.kind}; transverse starts from its static state")
    if len(basis_of(scene)) == 3:
        raise CannotRepresent("end_a, end_b, water.current, devices: not in one vertical plane; transverse is planar")


def build(scene: sc.Scene, segments: int, ask: Ask | None = None) -> Any:
    """A TransverseModel of the scene."""
    return TransverseModel(scene, segments, ask.mass_scaling if ask else None)
