"""The contract: a scene becomes a Model, a method marches it, a Response comes back. Read this file first.

To a method a line is a parameter pack (a NamedTuple of arrays and floats) and the verbs of ``dispatch`` on it.
To everybody else it is a ``Model``: its pack, its start, and ``observe``, which turns states into quantities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Flag, auto
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np

from .status import REMEDY, Status

__all__ = ["REMEDY", "Ask", "CannotRepresent", "Cost", "Feature", "Model", "Response", "Status"]


class Feature(Flag):
    """What a scene needs and a line can represent; ``catalogue.needs`` derives it, nobody sets it by hand."""

    NONE = 0
    BENDING = auto()
    SEABED = auto()
    DRAG = auto()
    CURRENT = auto()
    SLACK = auto()
    DEVICE = auto()
    FREE_DEVICE = auto()
    ROD = auto()
    MOTION = auto()
    TRANSIENT = auto()
    PERIODIC = auto()
    LARGE_MOTION = auto()
    SPATIAL = auto()
    TORSION = auto()
    ROTATION = auto()
    DAMPING = auto()


class CannotRepresent(ValueError):
    """A setup error: the model or method lacks a feature that a field of the scene asks for."""


def _in_order(pairs: tuple[tuple[float, float], ...] | None) -> bool:
    flat = [x for pair in pairs or () for x in pair]
    return all(len(pair) == 2 for pair in pairs or ()) and all(0 <= a < b for a, b in pairwise(flat))


@dataclass(frozen=True, kw_only=True)
class Ask:
    """What is wanted of a run. ``auto`` and None are chosen by the catalogue, and the choice is reported."""

    duration: float = 0.0  # [s]; 0 asks for the static state alone
    model: str = "auto"
    method: str = "auto"  # explicit (dopri5), rk2, rk4, genalpha, implicit (trbdf2), harmonic
    segments: int | None = None  # N, over the whole cable
    accuracy: float = 0.05  # wanted relative error of the transverse response; chooses `segments` when None
    tolerance: float | None = None  # local error of an adaptive method, in the energy norm
    checked_tolerance: float | None = None  # pilots' word that it does: a coarser run is check enough
    step: float | None = None  # of a fixed-step method [s]
    rho: float = 0.8  # generalised-alpha: spectral radius at infinity
    interval: float = 1e-3  # of the output grid [s]
    output_from: float = 0.0  # first time on it that is kept [s]
    rho_space: float = 1.0  # rod family: spectral radius at infinity along s; below 1 for statics only, see README
    mass_scaling: float | None = None  # transverse: spans a wave needs to keep its frequency; finer ones are slowed
    rods: tuple[tuple[float, float], ...] | None = None  # hybrid: where it is a rod, arc lengths [m]; None: adaptive
    harmonics: int | None = None  # of harmonic balance; None adds them until the tolerance is met
    max_steps: int = 20_000_000
    perturbation: float = 0.0  # standard deviation of random initial velocities [m/s]: error bars of chaotic responses
    seed: int = 0  # of that perturbation

    @property
    def last(self) -> float:
        """Last time of the output grid [s]."""
        if not (self.interval > 0 and 0 <= self.duration < math.inf):
            return math.inf
        return min(int(self.duration / self.interval + 1e-9) * self.interval, self.duration)

    def __post_init__(self) -> None:
        """Raises ValueError that lists every field out of its range."""
        wrong = [f"{name} = {value!r}: {rule}" for name, value, ok, rule in (
            ("duration", self.duration, 0 <= self.duration < math.inf, "must be 0 or more [s]"),
            ("segments", self.segments, self.segments is None or 1 <= self.segments <= 100_000, "must be 1 to 100000"),
            ("accuracy", self.accuracy, 0 < self.accuracy < 1, "must lie between 0 and 1"),
            ("tolerance", self.tolerance, self.tolerance is None or 0 < self.tolerance < 1, "must lie between 0 and 1"),
            ("checked_tolerance", self.checked_tolerance,
             self.checked_tolerance is None or 0 < self.checked_tolerance < 1, "must lie between 0 and 1"),
            ("step", self.step, self.step is None or 0 < self.step < math.inf, "must be above 0 [s]"),
            ("rho", self.rho, 0 <= self.rho <= 1, "must be 0 to 1"),
            ("rho_space", self.rho_space, 0 <= self.rho_space <= 1, "must be 0 to 1"),
            ("mass_scaling", self.mass_scaling, self.mass_scaling is None or 2 <= self.mass_scaling <= 20,
             "must be 2 to 20 spans per wave"),
            ("rods", self.rods, _in_order(self.rods), "pairs (from, to) [m] in order, each from < to"),
            ("interval", self.interval, 0 < self.interval < math.inf, "must be above 0 [s]"),
            ("output_from", self.output_from, 0 <= self.output_from <= self.last, "must be 0 to the last output [s]"),
            ("harmonics", self.harmonics, self.harmonics is None or 1 <= self.harmonics <= 200, "must be 1 to 200"),
            ("max_steps", self.max_steps, self.max_steps >= 1, "must be 1 or more"),
            ("perturbation", self.perturbation, 0 <= self.perturbation < math.inf, "must be 0 or more [m/s]"),
        ) if not ok]  # fmt: skip
        if wrong:
            raise ValueError("; ".join(wrong))


class Cost(NamedTuple):
    """Counted work of a run, and its seconds (the only number that depends on the machine)."""

    steps: int = 0
    rejected: int = 0
    evaluations: int = 0  # residuals or accelerations
    factorisations: int = 0
    seconds: float = 0.0  # of the march, compilation excluded
    checking: float = 0.0  # seconds of the runs at other steps or tolerances that measured the error in time


@dataclass(frozen=True, kw_only=True)
class Response:
    """What a run gives back; ``signals`` are named and described in ``quantities.QUANTITIES``."""

    status: Status
    message: str = ""
    t: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (nt,) [s]
    signals: dict[str, np.ndarray] = field(default_factory=dict)
    energy_residual: float = float("nan")  # |work - dissipated - change| / peak(kinetic + potential above static)
    nodes_per_wave: float = float("inf")  # nodes in the shortest transverse wave of the excitation
    steps_per_period: float = float("inf")  # steps in the shortest period that matters
    cost: Cost = field(default_factory=Cost)
    model: str = ""
    method: str = ""
    tolerance: float = float("nan")  # of an adaptive method
    step: float = float("nan")  # of a method with fixed steps, asked for or the mesh's [s]
    chaotic: bool = False  # pilots found that waveforms do not converge: only statistics mean something
    segments: int = 0  # N as asked or chosen; rods and devices may make the mesh differ by a few
    reason: str = ""  # why this model, method and mesh
    estimated_error: float = float("nan")  # relative, of the transverse response
    harmonics: int = 0  # of harmonic balance
    multiplier: float = float("nan")  # size of the largest Floquet multiplier: above 1 a periodic response is unstable

    @property
    def trusted(self) -> bool:
        """Status OK, which includes a closed energy ledger and both resolution guards."""
        return self.status == Status.OK


class Model(Protocol):
    """A discretised scene: what `catalogue.solve` needs of a line."""

    name: str
    pack: Any  # NamedTuple that the verbs dispatch on, with `fixed`, `weight`, `bw`, `load_factor`
    static_pack: Any  # the same with a released end still held
    breaks: tuple[float, ...]  # times at which the motion is not smooth [s]
    omega: float  # highest angular frequency of the excitation [rad/s]
    segments: int
    ndof: int
    n_gaps: int

    reach: float  # largest move of a dof in one static iteration [m]
    static_tolerance: float  # largest residual of a state at rest [N]

    def starts(self) -> list[np.ndarray]: ...  # first guesses of the static state, best first
    def softened(self, q: np.ndarray) -> list[Any]: ...  # static packs, softer first, the real one last
    def settle(self, static: np.ndarray) -> None: ...  # the static state is known
    def given(self) -> tuple[np.ndarray, np.ndarray]: ...
    def observe(self, q: np.ndarray, v: np.ndarray, force: np.ndarray, static: np.ndarray) -> dict[str, np.ndarray]: ...
    def slack(self, signals: dict[str, np.ndarray]) -> bool: ...  # does a section without compression go slack?
    def validity(self, signals: dict[str, np.ndarray]) -> tuple[Status, str]: ...  # OK, or how the run left its range
    def drift_error(self, static: np.ndarray) -> float: ...  # the same of its static state
    def range_error(self) -> float: ...  # estimated relative error of the line's kinematics in the scene's motion
    def fastest(self, static: np.ndarray) -> dict[str, float]: ...
    # a line may also have `impacts() -> (n_gaps,) rates of its cords` and `run_error(t, signals) -> error of its range`
    def guards(self, static: np.ndarray) -> tuple[Status, str, float]: ...
